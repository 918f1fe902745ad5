"""A plan's responses are flown: affine in where the object will be, the plan itself without a deviation."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from impact_envs import InputError, load_scenario, parallel_env, rollout, vector_env
from impact_envs.rollout import Episode
from planners import make_expert, make_expert_batch
from planners import make_plan as plan_scenario
from planners.bezier import Curve
from planners.free_flyer.belief.options import EXPERT
from planners.free_flyer.belief.plan_table import PlanTable, make_plan_table, read_tube
from planners.free_flyer.next_impact.aim import choose_desired_velocity
from planners.free_flyer.next_impact.bookkeeping import learn_from_hits
from planners.free_flyer.next_impact.desired_velocity import is_answered, is_settled
from planners.free_flyer.next_impact.response import find_place, respond, write_curve
from planners.free_flyer.tracking.course import evaluate_course, evaluate_curve
from planners.plan import Plan, PlannedResponse, Tube
from tests.planners.free_flyer.plans import OPTIONS, K, World, load, make_plan, plan_impact, set_fields

NAME, SNAP, CRACKLE, POP, SEED = "throw_and_catch", 0, 1, 2, 1_000_000
FIRST, SECOND, START, END = 10.0, 20.0, 12.0, 28.0
CENTRE, HALF, GAIN = np.array([0.5, 2.25]), np.array([0.2, 0.1]), np.array([-0.06, -0.03])
# Of crackle's curves: change of position per place in the box, where it responds [m].
GAINS = np.array([[0.3, -0.1], [0.05, 0.2]])
TWIST = np.array([0.02, -0.01])
TIMES = np.array([0.0, 6.0, START, 16.0, SECOND, 24.0, END, 30.0])


def make_responding_plan() -> Plan:
    """Snap hits first; crackle hits second and responds to the place there."""
    scenario = load(NAME)
    hits = [
        plan_impact(FIRST, "snap", "pop", (0.5, 1.5), (0.0, 1.0), after=(0.0, 0.075)),
        plan_impact(SECOND, "crackle", "pop", CENTRE, (0.0, -1.0), (0.0, 0.075), (0.01, 0.02)),
    ]
    base = np.linspace([0.0, 3.25], [0.3, 2.9], 6 * (len(TIMES) - 1)).reshape(-1, 6, 2)
    bump = np.zeros((len(TIMES) - 1, 6, 1))
    bump[2:6] = np.array([[0, 0, 0, 1, 1, 1], [1] * 6, [1] * 6, [1, 1, 1, 0, 0, 0]])[..., None]
    curves = tuple(
        Curve(TIMES, base + bump * (GAINS @ [vx, vy] + vx * vy * TWIST)) for vx in (-1.0, 1.0) for vy in (-1.0, 1.0)
    )
    still = Curve([0.0, 30.0], np.tile([0.0, 0.5], (1, 6, 1)))
    plan = make_plan(scenario, hits, robots={"crackle": Curve(TIMES, base), "snap": still})
    places = np.array([[0.5, 1.5, 0, 0], [0.5, 1.5, 0, 0.075], [*CENTRE, 0.01, 0.02], [0.6, 2.45, 0, 0]])
    widths = np.array([[0.0] * 4, [0.0, 0.0, 0.02, 0.02], [*HALF, 0.01, 0.01], [0.2, 0.2, 0.0, 0.0]])
    boxes = np.stack([places, widths], axis=1)
    answers = (
        PlannedResponse(0.0, 30.0, 4.0, 12.0, np.zeros(2)),
        PlannedResponse(START, END, 16.0, 24.0, GAIN),
    )
    tube = Tube(np.array([0.0, FIRST, SECOND, 30.0]), boxes[:-1], boxes[1:])
    return replace(
        plan,
        deviation=0.01,
        tubes={"pop": tube},
        responses={"snap": (still,) * 4, "crackle": curves},
        planned_responses=answers,
    )


def make_world(at: np.ndarray) -> World:
    """Return a world in which snap has hit and pop will be there at the second impact."""
    world = World(load(NAME), make_responding_plan())
    velocity = (at - [0.5, 1.5]) / (SECOND - FIRST)
    world.see(POP, (0.5, 1.5), velocity)
    world.contact(SNAP, POP, FIRST)
    world.memory.time[K] = FIRST + 2.0
    world.see(POP, [0.5, 1.5] + 2.0 * velocity, velocity)
    return world


def fly(table: PlanTable, curves: np.ndarray, times: np.ndarray) -> np.ndarray:
    return np.array([evaluate_curve(table.breaks, curves, CRACKLE, t, False)[:2] for t in times])


PLACES = [(0.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.3, -0.7), (-1.0, 1.0)]


@pytest.mark.parametrize("d", PLACES)
def test_the_curve_is_the_plans_plus_gains_times_the_deviation(d: tuple[float, float]) -> None:
    world = World(load(NAME), make_responding_plan())
    write_curve(world.table, world.memory, K, 1, *d)
    times = np.linspace(0.0, 30.0, 301)
    planned, flown = (fly(world.table, curves, times) for curves in (world.table.coefficients, world.memory.flown[K]))
    far = GAINS @ d + d[0] * d[1] * TWIST
    full = (times >= 16.0) & (times <= 24.0)
    np.testing.assert_allclose((flown - planned)[full], np.tile(far, (full.sum(), 1)), atol=1e-12)
    before = (times <= START) | (times >= END)
    np.testing.assert_array_equal(flown[before], planned[before])


def test_without_a_deviation_it_is_the_plans_bit_for_bit() -> None:
    world = World(load(NAME), make_responding_plan())
    write_curve(world.table, world.memory, K, 1, 0.4, -0.9)
    assert not np.array_equal(world.memory.flown[K], world.table.coefficients)
    write_curve(world.table, world.memory, K, 1, 0.0, 0.0)
    np.testing.assert_array_equal(world.memory.flown[K], world.table.coefficients)


@pytest.mark.parametrize(("d", "place"), [((0.5, -0.5), (0.5, -0.5)), ((3.0, 0.2), (1.0, 0.2))])
def test_the_place_is_that_of_the_flight_in_the_box(d: tuple[float, float], place: tuple[float, float]) -> None:
    world = make_world(CENTRE + d * HALF)
    np.testing.assert_allclose(find_place(world.table, world.memory, K, 0, 1), place, atol=1e-9)


def test_the_object_gets_the_velocity_of_its_place() -> None:
    d = np.array([0.5, -0.8])
    world = make_world(CENTRE + d * HALF)
    assert is_answered(world.table, world.memory, OPTIONS, K, 0)
    wish = choose_desired_velocity(world.table, world.memory, OPTIONS, K, 0)
    np.testing.assert_allclose(wish, np.array([0.01, 0.02]) + GAIN * d * HALF, atol=1e-9)


def test_a_course_goes_over_to_the_response_without_a_jump() -> None:
    d = (0.5, -0.8)
    world = make_world(CENTRE + d * HALF)
    course, table, now = world.course[CRACKLE], world.table, float(world.memory.time[K])
    before = evaluate_course(course, table.breaks, world.memory.flown[K], CRACKLE, now)
    respond(table, world.memory, OPTIONS, K, CRACKLE, now)
    assert world.count("responded") == 1
    after = evaluate_course(course, table.breaks, world.memory.flown[K], CRACKLE, now)
    np.testing.assert_allclose(after, before, atol=1e-12)
    late = now + EXPERT.response.rejoin + 1.0
    there = evaluate_course(course, table.breaks, world.memory.flown[K], CRACKLE, late)[:2]
    np.testing.assert_allclose(there, fly(table, world.memory.flown[K], np.array([late]))[0], atol=1e-9)
    respond(table, world.memory, OPTIONS, K, CRACKLE, now + 0.5)
    assert world.count("responded") == 1  # nothing has changed


@pytest.mark.parametrize("how", ["out of its box", "at another time"])
def test_what_the_plan_does_not_promise_is_not_answered(how: str) -> None:
    world = make_world(CENTRE + [1.2 if how == "out of its box" else 0.5, 0.0] * HALF)
    if how == "at another time":
        world.clock[1] += 0.5
    assert not is_answered(world.table, world.memory, OPTIONS, K, 0)
    respond(world.table, world.memory, OPTIONS, K, CRACKLE, float(world.memory.time[K]))
    np.testing.assert_array_equal(world.memory.flown[K], world.table.coefficients)


@pytest.mark.parametrize(("share", "promised"), [(0.9, True), (1.3, False)])
def test_a_deviation_beyond_the_plans_ends_its_promise(share: float, promised: bool) -> None:
    world = make_world(CENTRE)
    off = share * world.table.deviation * np.array([0.2, -1.0])
    set_fields(world.hit[0], is_pending=True, is_answered=True, time=FIRST, watched_at=math.inf)
    world.hit[0]["aim"] = world.memory.filter["velocity"][K, POP] + off
    learn_from_hits(world.table, world.memory, OPTIONS, K, FIRST + 2.0)
    assert is_answered(world.table, world.memory, OPTIONS, K, 0) == promised


def test_a_flight_that_is_known_at_once_is_answered_at_once() -> None:
    world, soon = make_world(CENTRE), FIRST + 0.1
    world.memory.time[K], velocity = soon, world.memory.filter["velocity"][K, POP].copy()
    world.see(POP, [0.5, 1.5] + 0.1 * velocity, velocity)
    assert is_settled(world.table, world.memory, OPTIONS, K, 0, soon)
    world.memory.filter["P_vv"][K, POP] = 0.01**2  # 10 cm at the impact
    assert not is_settled(world.table, world.memory, OPTIONS, K, 0, soon)
    assert is_settled(world.table, world.memory, OPTIONS, K, 0, FIRST + EXPERT.timing.settle)


@cache
def plan_robustly() -> Plan:
    return plan_scenario(NAME, "impact_uncertainty")


def list_vertices() -> Iterator[tuple[int, tuple[float, float]]]:
    yield from enumerate([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])


def test_at_the_vertices_of_a_box_the_planned_curves_are_flown() -> None:
    plan, scenario = plan_robustly(), load(NAME)
    world, k = World(scenario, plan), len(plan.impacts) - 1
    robot, one = plan.impacts[k].robot, plan.planned_responses[k]
    r, curves = list(scenario.robots).index(robot), plan.responses[robot]
    for v, d in list_vertices():
        write_curve(world.table, world.memory, K, k, *d)
        for t in np.linspace(one.start + 0.1, one.end - 0.1, 40):
            flown = evaluate_curve(world.table.breaks, world.memory.flown[K], r, t, False)[:2]
            mean = sum(curve.position(t) for curve in curves) / 4
            np.testing.assert_allclose(flown - plan.robots[robot].position(t), curves[v].position(t) - mean, atol=1e-9)


def fly_batch(plan: Plan, share: float, worlds: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Fly a plan in many worlds with a share of its deviation; return robustness and how far outside its tube pop got.

    Half of the worlds have deviations at the corners of the box.
    """
    scenario = load_scenario(NAME).override({"true.impact_deviation": share * float(plan.deviation or 0.0)})
    envs, experts = vector_env(scenario, num_envs=worlds), make_expert_batch(scenario, worlds, plan)
    joint, infos = envs.reset(seed=SEED)
    outside, pop = np.zeros(worlds), parallel_env(scenario).task.joint_layout["pop"].start
    for step in range(1, scenario.steps + 1):
        joint, *_, infos = envs.step(experts.act(joint))
        if step < scenario.steps:
            centre, half = read_tube(plan.tubes["pop"], np.array([step * scenario.control_period]))
            outside = np.maximum(outside, (np.abs(joint[:, pop : pop + 2] - centre) - half).max(axis=1))
    return np.array(infos["robustness"]), outside


def test_the_environment_confirms_what_the_plan_promises() -> None:
    robustness, outside = fly_batch(plan_robustly(), 1.0)
    assert robustness.min() > 0.0
    assert robustness.min() < 2e-3  # corners of the box need all that the plan has
    assert outside.max() < 2e-4


def test_beyond_the_deviation_that_the_plan_bears_nothing_is_promised() -> None:
    robustness, outside = fly_batch(plan_robustly(), 1.2)
    assert outside.max() > 0.01
    assert robustness.min() < 0.0


def fly_plan(plan: Plan, respond: bool = True) -> Episode:
    scenario = load_scenario(NAME).override({"true.impact_deviation": 0.01})
    return rollout(parallel_env(scenario), make_expert(scenario, plan, options={"respond": respond}), SEED)


def test_switched_off_or_in_a_plan_of_version_1_nothing_responds() -> None:
    plan = plan_robustly()
    content = json.loads(plan.to_json())
    assert content.pop("version") == 2
    assert len(content.pop("planned_responses")) == len(plan.impacts)
    old = Plan.from_json(json.dumps(content))
    assert old == replace(plan, planned_responses=())
    assert len(make_plan_table(load(NAME), old).response) == 0
    assert len(make_plan_table(load(NAME), plan, respond=False).response) == 0
    off, without, on = fly_plan(plan, respond=False), fly_plan(old), fly_plan(plan)
    for name, values in off.signals.items():
        np.testing.assert_array_equal(values, without.signals[name])
    assert any(not np.array_equal(values, on.signals[name]) for name, values in off.signals.items())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 3}, "version 3 is unknown; choices: 1 to 2"),
        ({"planned_responses": []}, None),
        ({"responses": {}}, "0 responses of snap, expected 4"),
        ({"tubes": {}}, "responses to pop, which has no tube"),
    ],
)
def test_responses_that_do_not_fit_are_one_line(change: dict[str, object], message: str | None) -> None:
    content = json.loads(make_responding_plan().to_json()) | change
    if message is None:
        assert not Plan.from_json(json.dumps(content)).planned_responses
        return
    with pytest.raises(InputError, match=message) as found:
        Plan.from_json(json.dumps(content))
    assert "\n" not in str(found.value)


def test_times_in_order_and_two_gains_are_needed() -> None:
    for arguments in (
        (5.0, 4.0, 1.0, 2.0, [0.0, 0.0]),
        (0.0, 4.0, 1.0, 2.0, [0.0]),
        (0.0, 4.0, 1.0, 2.0, [math.nan, 0]),
    ):
        with pytest.raises(InputError):
            PlannedResponse(*arguments)  # type: ignore[arg-type]
