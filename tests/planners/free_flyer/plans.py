"""Scenarios, plans and worlds made by hand, for tests of the free-flyers' expert."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from impact_envs import load_scenario
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.bezier import Curve
from planners.free_flyer.belief.options import EXPERT, Options, make_record
from planners.free_flyer.belief.plan_table import make_plan_table
from planners.free_flyer.belief.world_memory import NOBODY, make_world_memory
from planners.free_flyer.closed_loop.world_loop import look_ahead, start_world
from planners.free_flyer.next_impact.bookkeeping import take_contact
from planners.free_flyer.next_impact.rest_qp import make_rest_qp
from planners.plan import Plan, PlannedImpact

OPTIONS = make_record(EXPERT)[0]

K = 1  # the world that is played, of three
Hit = tuple[float, str, str, tuple[float, float]]  # time, robot, object, place


def load(name: str, **changes: Any) -> FreeFlyerScenario:
    """Return a shipped scenario with some values changed."""
    scenario = load_scenario(name)
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario.override(changes) if changes else scenario


def load_open(formula: str, objects: Mapping[str, tuple[float, float]], horizon: float = 100.0) -> FreeFlyerScenario:
    """Return two robots and free objects at their starts, without walls near by."""
    scenario = load("throw_and_catch")
    item = scenario.objects["pop"].model_dump() | {"rest": False}
    return scenario.override(
        {
            "world.lower": [-200, -200],
            "world.upper": [200, 200],
            "objects": {name: item | {"start": start} for name, start in objects.items()},
            "horizon": horizon,
            "formula": formula,
        }
    )


def plan_impact(
    time: float,
    robot: str,
    item: str,
    position: Sequence[float],
    normal: Sequence[float] = (1.0, 0.0),
    before: Sequence[float] = (0.0, 0.0),
    after: Sequence[float] = (0.1, 0.0),
) -> PlannedImpact:
    """Return an impact in which the robot's part is left open; before, after: velocity of the object [m/s]."""
    zero = np.zeros(2)
    place, n, minus, plus = (np.array(vector, float) for vector in (position, normal, before, after))
    return PlannedImpact(time, robot, item, place, zero, n, zero, zero, minus, plus)


def make_plan(
    scenario: FreeFlyerScenario,
    impacts: Iterable[PlannedImpact] = (),
    robots: Mapping[str, Curve] | None = None,
    objects: Mapping[str, Curve] | None = None,
) -> Plan:
    """Return a plan with impacts; bodies without a curve rest where they start."""
    still = {name: Curve([0.0, scenario.horizon], [[scenario.body(name).start]]) for name in scenario.bodies}
    numbers = dict.fromkeys(("robustness", "bound", "gap", "effort", "solve_seconds"), 0.0)
    return Plan(
        scenario=scenario.name,
        objective="robustness",
        horizon=scenario.horizon,
        effort_bound=None,
        impacts=tuple(impacts),
        robots={name: (robots or {}).get(name, still[name]) for name in scenario.robots},
        objects={name: (objects or {}).get(name, still[name]) for name in scenario.objects},
        stage_seconds={},
        validated=False,
        **numbers,
    )


def make_straight_plan(scenario: FreeFlyerScenario, hits: Iterable[Hit], side: float = 1.0) -> Plan:
    """Return a plan in which objects fly straight from hit to hit, stay after the last one, and robots rest.

    side: -1 mirrors the places at the x-axis.
    """
    impacts, curves, every = [], {}, list(hits)
    for name in scenario.objects:
        mine = sorted(hit for hit in every if hit[2] == name)
        points = np.array([hit[3] for hit in mine]) * [1.0, side]
        points = np.vstack([points[:1], points, points[-1:]])
        times = np.array([0.0, *(hit[0] for hit in mine), scenario.horizon])
        velocity = np.diff(points, axis=0) / np.diff(times)[:, None]
        for k, (time, robot, _, _) in enumerate(mine):
            change = velocity[k + 1] - velocity[k]
            normal = change / np.hypot(*change) if change.any() else (1.0, 0.0)
            impacts.append(plan_impact(time, robot, name, points[k + 1], normal, velocity[k], velocity[k + 1]))
        curves[name] = Curve(times, np.stack([points[:-1], points[1:]], axis=1))
    return make_plan(scenario, sorted(impacts, key=lambda impact: impact.time), objects=curves)


def set_fields(record: Any, **values: Any) -> None:
    """Write fields of a record."""
    for name, value in values.items():
        record[name] = value


def set_estimate(
    filters: np.ndarray, position: Sequence[float], velocity: Sequence[float] = (0.0, 0.0), drift: Any = 0.0
) -> None:
    """Let an estimate be exact."""
    filters[()] = 0.0
    set_fields(filters, position=position, velocity=velocity, drift=drift)


class World:
    """World K of three at the start of a plan, played step by step."""

    def __init__(self, scenario: FreeFlyerScenario, plan: Plan, options: Options = EXPERT) -> None:
        self.options, self.table = options, make_plan_table(scenario.as_believed(), plan)
        self.memory, self.qp = make_world_memory(self.table, 3), make_rest_qp(3)
        start_world(self.table, self.memory, make_record(options)[0], K)
        self.strike, self.hit, self.course = self.memory.strike[K], self.memory.hit[K], self.memory.course[K]
        self.clock, self.place = self.memory.clock[K, : len(plan.impacts)], self.memory.place[K]

    def count(self, name: str) -> int:
        return int(self.memory.counts[name][K])

    def see(self, body: int, position: Sequence[float], velocity: Sequence[float] = (0.0, 0.0)) -> None:
        """Let a body's estimate be exact."""
        set_estimate(self.memory.filter[K, body, ...], position, velocity)

    def contact(self, robot: int, body: int, now: float) -> None:
        """Let a robot feel a contact."""
        self.memory.touch[K] = NOBODY
        self.memory.touch[K, robot] = body
        take_contact(self.table, self.memory, OPTIONS, K, robot, now)

    def look(self, now: float) -> None:
        """Look ahead in thread 1."""
        self.memory.time[K] = now
        look_ahead(self.table, self.memory, make_record(self.options)[0], self.qp, 1, K, now)
