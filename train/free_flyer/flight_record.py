"""What is remembered of free-flyers' episode for its picture: replans, events, and the motion in a plan's form."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import Impact
from impact_envs.rollout import Episode, Policy
from planners.bezier import Curve
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.world_memory import COUNTERS
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.tracking.course import evaluate_course
from planners.plan import Plan, PlannedImpact

WAY = 9  # samples of a way that a replan counts on
SIGNALS = ("x", "y", "vx", "vy")
Hit = tuple[Impact, str, str]  # robot, object


class Expectation(NamedTuple):
    """What a replan counted on.

    Attributes:
        robot, object: who is to hit what.
        way: time, x, y of the object from the replan to the impact, shape (n, 3) [s, m, m].
    """

    robot: str
    object: str
    way: np.ndarray


class FlightRecord:
    """Watch what the expert of an episode does inside; of another policy there is nothing to see.

    Args:
        scenario: where.
        policy: that plays.

    Attributes:
        scenario: where.
        expert: that is watched, None for another policy.
        plan: that the policy follows, None without one.
        events: time [s] and name, of `world_memory.COUNTERS`, of whatever the expert counted.
        replans: time [s] and robot whose course was planned anew, to an impact or back to the plan.
        expectations: one per replan to an impact.
        courses: robot to time, x, y, vx, vy that it was to have at each control step, shape (T, 5) [s, m, m/s].
    """

    def __init__(self, scenario: FreeFlyerScenario, policy: Policy) -> None:
        self.scenario = scenario
        expert = getattr(policy, "expert", policy)
        self.expert = expert if isinstance(expert, FreeFlyerExpert) else None
        self.plan: Plan | None = self.expert.plan if self.expert else None
        self._clear()

    def add(self, env: Any) -> None:
        """Take a sample.

        Args:
            env: an ImpactEnv after reset or a step.
        """
        if env.steps == 0:
            self._clear()
        elif self.expert:
            self._add_step(self.expert, self.scenario)

    @property
    def courses(self) -> dict[str, np.ndarray]:
        """Return what each robot was to do, shape (T, 5)."""
        return {name: np.array(rows) for name, rows in self._courses.items()}

    def _clear(self) -> None:
        self.events: list[tuple[float, str]] = []
        self.replans: list[tuple[float, str]] = []
        self.expectations: list[Expectation] = []
        self._counts = np.zeros(len(COUNTERS), np.int64)
        self._courses: dict[str, list[tuple[float, ...]]] = {}

    def _add_step(self, expert: FreeFlyerExpert, scenario: FreeFlyerScenario) -> None:
        table, memory = expert.table, expert.memory
        now, robots = float(memory.time[0]), list(scenario.robots)
        counts = np.array(memory.counts[0].tolist())
        grown, self._counts = counts - self._counts, counts
        self.events += [(now, name) for name, n in zip(COUNTERS, grown, strict=True) for _ in range(n)]
        curves = memory.flown[0] if len(table.response) else table.coefficients
        for r, name in enumerate(robots):
            course = memory.course[0, r]
            motion = evaluate_course(course, table.breaks, curves, r, now)
            self._courses.setdefault(name, []).append((now, *motion[:4]))
            if course["since"] == now < course["until"]:
                self.replans.append((now, name))
        for o, (name, strike) in enumerate(zip(scenario.objects, memory.strike[0], strict=True)):
            if strike["replanned_at"] != now:
                continue
            times = np.linspace(now, strike["time"], WAY)
            way = [(t, *extrapolate_flight(memory, 0, table.robots + o, t)[:2]) for t in times]
            self.expectations.append(Expectation(robots[strike["robot"]], name, np.array(way)))


def convert_episode(scenario: FreeFlyerScenario, episode: Episode) -> Plan:
    """Return an executed motion in the form of a plan: lines between samples, impacts of robots on objects.

    Args:
        scenario: where.
        episode: what happened; impacts of other bodies are left out.
    """
    curves, horizon = {}, float(episode.times[-1])
    for name in scenario.bodies:
        points = np.stack([episode.signals[f"{name}.x"], episode.signals[f"{name}.y"]], axis=1)
        curves[name] = Curve(episode.times, np.stack([points[:-1], points[1:]], axis=1))
    impacts = []
    for hit, robot, target in list_hits(scenario, episode):
        sides = [
            [curves[name].velocity(hit.time + step, "right") for step in (-episode.period, episode.period)]
            for name in (robot, target)
        ]
        (robot_minus, robot_plus), (object_minus, object_plus) = sides
        normal = np.array(hit.normal) * (1.0 if hit.a == robot else -1.0)
        place, contact = locate(episode, target, hit.time), locate(episode, robot, hit.time)
        vectors = (place, contact, normal, robot_minus, robot_plus, object_minus, object_plus)
        impacts.append(PlannedImpact(min(hit.time, horizon), robot, target, *vectors))
    rho = episode.robustness
    robots = {name: curves[name] for name in scenario.robots}
    objects = {name: curves[name] for name in scenario.objects}
    return Plan(
        episode.scenario,
        "robustness",
        horizon,
        rho,
        rho,
        0.0,
        0.0,
        None,
        tuple(impacts),
        robots,
        objects,
        0.0,
        {},
        False,
    )


def locate(episode: Episode, body: str, time: float) -> np.ndarray:
    """Return where a body is at an impact, shape (2,) [m]: on from the sample before, as its velocity jumps."""
    k = min(int(time / episode.period), len(episode.times) - 1)
    x, y, vx, vy = (episode.signals[f"{body}.{signal}"][k] for signal in SIGNALS)
    return np.array([x, y]) + (time - episode.times[k]) * np.array([vx, vy])


def list_hits(scenario: FreeFlyerScenario, episode: Episode) -> list[Hit]:
    """Return impacts of robots on objects, with the names of both."""
    hits = []
    for hit in episode.impacts:
        for robot, target in ((hit.a, hit.b), (hit.b, hit.a)):
            if robot in scenario.robots and target in scenario.objects:
                hits.append((hit, robot, target))
    return hits


def list_others(episode: Episode, hits: Sequence[Hit]) -> list[Impact]:
    """Return impacts on walls and obstacles, of robots on robots and of objects on objects."""
    struck = {id(hit) for hit, _, _ in hits}
    return [hit for hit in episode.impacts if id(hit) not in struck]
