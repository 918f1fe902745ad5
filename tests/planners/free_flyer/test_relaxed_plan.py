"""What is given up is little, is the cheaper of two, and the plan of what is left passes the check."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_envs.errors import InputError, ScenarioError
from impact_envs.scenario import load_scenario
from impact_envs.stl import parse
from planners.free_flyer.nominal.diagnosis import Relaxation, find_relaxation
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.remaining import make_remaining_scenario
from planners.free_flyer.nominal.task import NominalTask
from planners.free_flyer.relaxed_plan import make_relaxed_plan
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.loosening import loosen, soften
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.validation import validate_plan


def make_world(**values):
    return load_scenario("throw_and_catch").override(values).as_believed()


def test_a_goal_out_of_reach_is_missed_by_its_distance():
    world = make_world()
    found = make_relaxed_plan(world, max_impacts=0)
    assert [one.conjunct for one in found.given_up] == ["G[30,30] pop in goal"]
    assert found.given_up[0].missed == pytest.approx(0.5, abs=1e-6)  # pop at y = 1.5, goal from y = 2
    assert found.robustness == pytest.approx(-0.5, abs=1e-6)
    assert validate_plan(found.scenario, found.plan) > 0.0
    assert found.bound == pytest.approx(0.5, abs=1e-3)  # without impacts it stays where it is


@pytest.mark.slow
def test_what_a_ball_has_no_time_for_is_given_up_and_no_more():
    """4 m to fly, at most 0.3 m/s from 3.19 s on (both axes of a robot push) to 10 s: it misses 1.96 m at least."""
    world = make_world()
    ball, robot = world.objects["pop"].model_dump(), world.robots["snap"].model_dump()
    fields = {field: getattr(world, field) for field in type(world).model_fields}
    fields |= {
        "formula": "F[0,10] pop in dock",
        "horizon": 60.0,
        "world": {"lower": [0.0, 0.0], "upper": [8.0, 4.0]},
        "objects": {"pop": ball | {"start": [2.0, 2.0]}},
        "robots": {"snap": robot | {"start": [1.0, 2.0], "goal": None, "force_limit": 1.5, "speed_limit": 0.3}},
        "regions": {"dock": {"lower": [6.0, 1.5], "upper": [7.0, 2.5]}},
    }
    fields["objects"]["pop"]["speed_limit"] = 0.3
    found = make_relaxed_plan(type(world)(**fields))
    assert found.bound == pytest.approx(4.0 - 0.3 * (10.0 - 3.19), abs=0.01)
    assert found.given_up[0].missed < 3.0


def test_nothing_is_given_up_where_there_is_a_plan():
    found = make_relaxed_plan(make_world())
    assert found.given_up == ()
    assert found.robustness == pytest.approx(0.25, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("in_file", "weights", "given_up"),
    [((), (10.0, 1.0), 1), ((), (1.0, 10.0), 0), ((10.0, 1.0), (), 1), ((10.0, 1.0), (1.0, 10.0), 0)],
)
def test_the_cheaper_conjunct_is_given_up(in_file, weights, given_up):
    conjuncts = ["G[30,30] pop in goal", "G[0,30] pop not in goal"]
    found = make_relaxed_plan(make_world(formula=" & ".join(conjuncts), weights=in_file), weights)
    assert [one.conjunct for one in found.given_up] == [conjuncts[given_up]]
    assert found.given_up[0].missed < 0.05


def test_weights_fit_the_conjuncts():
    with pytest.raises(InputError, match="2 weights for 1 conjuncts"):
        make_relaxed_plan(make_world(), (1.0, 2.0))
    with pytest.raises(InputError, match="weight 0: a positive number"):
        make_relaxed_plan(make_world(), (0.0,))


def test_weights_of_a_scenario_price_its_own_conjuncts():
    with pytest.raises(ScenarioError, match=r"weights: 2 for 1 conjuncts of the formula: G\[30,30\] pop in goal$"):
        make_world(weights=(1.0, 2.0))
    with pytest.raises(ScenarioError, match=r"weights\.0 = 0: input should be greater than 0$"):
        make_world(weights=(0,))
    priced = make_world(weights=(2.0,))
    assert priced.suite("short").weights == (2.0,)
    # What is recorded of a scenario without weights is what it was before there were any.
    assert "weights" in priced.model_dump_json()
    assert "weights" not in make_world().model_dump_json()


def test_weights_change_no_plan_of_a_task_that_has_one():
    plain, priced = make_free_flyer_plan(make_world()), make_free_flyer_plan(make_world(weights=(2.0,)))
    assert replace(priced, solve_seconds=0.0, stage_seconds={}) == replace(plain, solve_seconds=0.0, stage_seconds={})


def test_what_is_left_of_a_task_with_weights_has_none():
    world = make_world(formula="G[0,0.5] snap.x <= 9 & F[0,30] pop in goal", weights=(1.0, 2.0))
    places = {name: np.array(world.body(name).start) for name in world.bodies}
    past = np.linspace(0.0, 1.0, 11), {name: np.tile(place, (11, 1)) for name, place in places.items()}
    left = make_remaining_scenario(world, 1.0, places, dict.fromkeys(world.bodies, np.zeros(2)), past)
    assert (len(left.specification.conjuncts()), left.weights) == (1, ())


def test_areas_grow_and_shrink_and_bounds_move():
    formula = "F[0,30] pop in goal & G[0,30] snap not in goal & G[0,30] distance(snap, pop) >= 0.3"
    world = make_world(formula=formula)
    loose = loosen(world, [0.1, 0.2, 0.05])
    text = str(loose.specification)
    assert text.endswith("distance(snap, pop) >= 0.25")
    before, wide, narrow = (loose.regions[name] for name in ("goal", "goal_1", "goal_2_out"))
    np.testing.assert_allclose(np.subtract(before.lower, wide.lower), 0.1)
    np.testing.assert_allclose(np.subtract(narrow.lower, before.lower), 0.2)
    assert "F[0,30] pop in goal_1" in text
    assert parse(text) == loose.specification


def test_an_area_that_is_gone_asks_for_nothing():
    world = make_world(formula="F[0,30] pop in goal & G[0,30] snap not in goal")
    assert str(loosen(world, [0.0, 9.0]).specification) == "F[0,30] pop in goal"
    with pytest.raises(InputError, match="nothing is left"):
        loosen(make_world(formula="G[0,30] snap not in goal"), [9.0])


def test_faces_of_polygons_move_by_the_amount():
    corners = [[0.2, 3.0], [1.0, 3.2], [0.6, 4.0]]
    world = load_scenario("throw_and_catch")
    tables = {"vertices": corners}
    fields = {field: getattr(world, field) for field in type(world).model_fields}
    world = type(world)(**fields | {"regions": {"goal": tables}})
    loose = loosen(world.as_believed(), [0.3])
    (H, b), (G, c) = world.regions["goal"].halfspaces(), loose.regions["goal_1"].halfspaces()
    for face, bound in zip(H, b, strict=True):
        k = int(np.argmax(G @ face))
        assert G[k] @ face == pytest.approx(1.0)
        assert c[k] == pytest.approx(bound + 0.3)


@pytest.mark.parametrize("solid", [False, True])
def test_solid_obstacles_still_stop_bodies_and_none_is_loosened_by_more_than_its_depth(solid):
    """A box of 0.4 m stands on the goal: it cannot be loosened by more than 0.2 m, then it is given up."""
    block = {"lower": [0.3, 2.4], "upper": [0.7, 2.8], "solid": solid}
    world = load_scenario("throw_and_catch")
    fields = {field: getattr(world, field) for field in type(world).model_fields}
    goal = {"lower": [0.4, 2.5], "upper": [0.6, 2.7]}
    formula = "G[30,30] pop in goal & G[0,30] all not in block"
    world = type(world)(**fields | {"obstacles": {"block": block}, "regions": {"goal": goal}, "formula": formula})
    demands = soften(world, Reserves().wall)[1]
    depths = [need.depth for need in demands.predicates.values() if need.kind == "avoid"]
    assert depths == pytest.approx([0.2] * len(world.bodies))
    assert len(demands.solids) == (len(world.bodies) if solid else 0)
    task = NominalTask(world, read_demands(world, Reserves().wall), Reserves())
    found = find_relaxation(task, 2, 1e-3, 60.0)
    assert found
    assert all(one.amount <= 0.2 + 1e-6 for one in found if "block" in one.part)
    if solid:
        assert found[0].part == "G[30,30] pop in goal"


def test_what_is_gone_is_told_as_given_up():
    assert str(Relaxation("G[0,9] a not in b", 0.3, given_up=True)) == "'G[0,9] a not in b' given up"
