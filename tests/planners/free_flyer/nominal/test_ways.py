"""Ways round obstacles: shortest ways, legs of as many pieces as they need, and what is said where there is none."""

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.budget import Work
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.ways import count_pieces, find_way
from planners.free_flyer.specification.requirement import read_demands
from tests.planners.free_flyer.plans import load


def _body(start: tuple[float, float], **more: object) -> dict[str, object]:
    return {"start": start, "mass": 10.0, "inertia": 0.2, "radius": 0.2, "speed_limit": 0.5} | more


def _wall(lower: tuple[float, float], upper: tuple[float, float]) -> dict[str, object]:
    return {"lower": lower, "upper": upper, "solid": True}


def _maze(gap: float) -> FreeFlyerScenario:
    """Return two walls with open ends between a robot and its object: the robot turns four corners."""
    return build_scenario(
        {
            "name": "maze",
            "domain": "free_flyer",
            "formula": "F[0,200] pop in goal & G[0,200] all not in upper & G[0,200] all not in lower",
            "horizon": 200.0,
            "control_period": 0.1,
            "world": {"lower": (0.0, 0.0), "upper": (10.0, 10.0)},
            "robots": {"snap": _body((1.0, 9.0), force_limit=1.5, torque_limit=0.5)},
            "objects": {"pop": _body((5.0, 2.0), rest=False)},
            "regions": {"goal": {"lower": (7.0, 1.0), "upper": (9.0, 3.0)}},
            "obstacles": {
                "upper": _wall((0.0, 6.7), (10.0 - gap, 7.0)),
                "lower": _wall((2.0, 4.2), (10.0, 4.5)),
            },
            "believed": {"restitution": 0.8},
        },
        source="maze",
    )


def test_the_shortest_way_turns_at_the_grown_corners_of_walls() -> None:
    scenario = _maze(2.0)
    demands = read_demands(scenario, 0.05)
    needs = [need for need in demands.predicates.values() if need.kind == "avoid" and need.body == "snap"]
    way = find_way(np.array([1.0, 9.0]), np.array([5.0, 2.0]), needs, np.full(2, 0.25), np.full(2, 9.75))
    corners = [[1.0, 9.0], [8.25, 7.25], [8.25, 6.45], [1.75, 4.75], [1.75, 3.95], [5.0, 2.0]]
    np.testing.assert_allclose(way, corners, atol=1e-9)
    assert count_pieces(scenario, demands, 0.05) == 5


def test_a_wall_from_edge_to_edge_leaves_no_way() -> None:
    scenario = _maze(0.3)
    assert count_pieces(scenario, read_demands(scenario, 0.05), 0.05) is None


def test_a_maze_is_planned_with_as_many_pieces_as_its_way_has() -> None:
    plan = make_free_flyer_plan(_maze(2.0))
    assert plan.robustness == pytest.approx(1.0, abs=1e-5)
    assert plan.bound == pytest.approx(1.0, abs=1e-6)
    assert len(plan.impacts) == 1
    assert plan.validated


def test_a_proof_names_the_restrictions_it_holds_for() -> None:
    hurried = load("throw_and_catch", horizon=13.0, formula="G[13,13] pop in goal")
    with pytest.raises(Infeasible) as error:
        make_free_flyer_plan(hurried, max_impacts=2)
    text = str(error.value)
    assert text.startswith("plan of throw_and_catch: proven infeasible with up to 2 impacts, 6 straight pieces a leg")
    assert "a quarter of the planner's reserves: 0.05 m between bodies, 0.05 m from walls" in text


@pytest.mark.parametrize(("gap", "told"), [(0.3, "it needs 0.4 m;"), (0.45, "it needs 0.5 m (with a quarter of the")])
def test_a_robot_that_cannot_come_to_its_object_is_named_at_once(gap: float, told: str) -> None:
    work = Work()
    with pytest.raises(
        Infeasible, match="no robot can reach pop to hit it: the way of snap is closed by upper, the widest gap"
    ) as error:
        make_free_flyer_plan(_maze(gap), work=work)
    assert told in str(error.value)
    assert work.done == 0.0


def test_out_of_time_nothing_is_proven_and_the_limit_is_named() -> None:
    with pytest.raises(SolverFailed, match=r"no plan found, and none excluded, within the time limit of 0.01 s"):
        make_free_flyer_plan(_maze(2.0), time_limit=0.01)
