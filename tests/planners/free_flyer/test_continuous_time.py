"""Continuous robustness is below that of any samples, and hardly below that of very many."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from impact_envs.scenario import load_scenario
from planners.bezier import Curve
from planners.free_flyer.continuous_time import compute_continuous_robustness
from planners.free_flyer.validation import compute_robustness
from planners.plan import Plan

HORIZON = 20.0  # [s]


def make_world(formula: str):
    """Return throw_and_catch with another formula and a short horizon."""
    return load_scenario("throw_and_catch").override({"formula": formula, "horizon": HORIZON}).as_believed()


def make_random_plan(world, seed: int) -> Plan:
    """Return a plan of random smooth robots, and an object that flies straight with one turn on a control step."""
    rng = np.random.default_rng(seed)
    lower, upper = np.array(world.world.lower), np.array(world.world.upper)
    times = np.array([0.0, 4.03, 11.17, HORIZON])  # no instants of any sampling
    curves = {}
    for name in world.robots:
        points = rng.uniform(lower, upper, (3, 6, 2))
        for k in (1, 2):  # place, velocity and acceleration go on
            before, h, g = points[k - 1], times[k] - times[k - 1], times[k + 1] - times[k]
            points[k, 0] = before[5]
            points[k, 1] = before[5] + (before[5] - before[4]) * g / h
            bend = (before[5] - 2.0 * before[4] + before[3]) * (g / h) ** 2
            points[k, 2] = bend + 2.0 * points[k, 1] - points[k, 0]
        curves[name] = Curve(times, points)
    corners = rng.uniform(lower, upper, (3, 2))
    flights = {
        name: Curve(np.array([0.0, 7.3, HORIZON]), np.stack([corners[:-1], corners[1:]], 1)) for name in world.objects
    }
    return Plan(
        world.name, "robustness", HORIZON, 0.0, 0.0, 0.0, 0.0, None, (), curves, flights, 0.0, {}, False
    )  # fmt: skip


def sample(world, plan: Plan, per_second: int) -> float:
    """Return the robustness of so many samples a second."""
    times = np.linspace(0.0, HORIZON, round(HORIZON * per_second) + 1)
    return compute_robustness(world, times, {n: c.position(times) for n, c in (plan.robots | plan.objects).items()})


@pytest.mark.parametrize(
    "formula",
    [
        "G[0,20] snap not in goal",
        "G[0,20] distance(snap, crackle) >= 0.1",
        "G[2,17] (snap.x - crackle.y <= 1 & distance(snap, pop) <= 3)",
        "F[0,15] G[0,5] pop in goal",
        "G[0,15] F[0,5] snap in goal",
        "(snap not in goal) U[3,20] (crackle in goal)",
        "not ((snap in goal) U[3,20] (crackle not in goal))",
        "G[0,20] (snap in goal -> crackle not in goal)",
    ],
)
def test_it_is_a_bound_close_to_many_samples(formula):
    world = make_world(formula)
    for seed in range(4):
        plan = make_random_plan(world, seed)
        found, many = compute_continuous_robustness(world, plan), sample(world, plan, 1000)
        assert found is not None
        assert found <= many + 1e-9
        # Between two instants of 20 ms bodies move by some centimetres here; accelerations of some m/s² bend them less.
        assert found >= many - (2e-3 if formula.startswith("G[0,20] d") else 5e-2)


def test_corners_are_seen_between_samples():
    """A robot passes a corner of a square at 45 degrees: it is nearest in the middle between two control steps."""
    world = make_world("G[0,20] snap not in goal")
    plan = make_random_plan(world, 0)
    (x, y), speed = world.regions["goal"].upper, 1.0
    # From below right to above left, its distance to the corner is the same along both faces at 10.05 s.
    off = 0.3
    ends = [np.array([x + off, y + off]) + np.array([-1.0, 1.0]) * speed * (t - 10.05) for t in (0.0, HORIZON)]
    robots = plan.robots | {"snap": Curve(np.array([0.0, HORIZON]), np.stack(ends)[None])}
    plan = dataclasses.replace(plan, robots=robots)
    assert compute_continuous_robustness(world, plan) == pytest.approx(off, abs=1e-9)
    assert sample(world, plan, 10) == pytest.approx(off + 0.05, abs=1e-9)


def test_speeds_have_no_such_bound():
    world = make_world("G[0,20] speed(pop) <= 1")
    assert compute_continuous_robustness(world, make_random_plan(world, 0)) is None
