"""Events of a plan in numbers, and what Eq. (5) says about the impacts between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from planners.bezier import Curve
from planners.errors import Infeasible
from planners.free_flyer.reserves import Reserves
from planners.plan import PlannedImpact

Hitter = tuple[str, str]  # robot, object
Word = tuple[Hitter, ...]  # who hits what, in the order of time
ANYBODY = ""  # stands in a word for whichever robot it is


@dataclass(frozen=True)
class EventSequence:
    """Hold numbers for the events of a plan: who hits what, when and where.

    Args:
        times: t_0 = 0, impact times, t_{K+1} = T, shape (K+2,) [s].
        paths: object name to its positions at these times, each shape (K+2, 2) [m].
        knots: robot name to its positions, every leg cut into n pieces, each shape (n (K+1) + 1, 2) [m].
        hitters: names of robot and object of each impact.
        moments: of the robots' knots, shape (n (K+1) + 1,) [s]; None: pieces of a leg are equally long.
    """

    times: np.ndarray
    paths: dict[str, np.ndarray]
    knots: dict[str, np.ndarray]
    hitters: Word
    moments: np.ndarray | None = None

    def knot_times(self, count: int) -> np.ndarray:
        """Return the times of so many knots, equally many on every leg, shape (count,) [s]."""
        if self.moments is not None and count == len(self.moments):
            return self.moments
        return np.interp(np.linspace(0, len(self.times) - 1, count), np.arange(len(self.times)), self.times)


def own_events(word: Word, name: str) -> list[int]:
    """Return the numbers of the events that change an object's velocity, and of both ends: within 0 .. K+1.

    Args:
        word: who hits what at each impact.
        name: of the object.
    """
    return [0, *(k for k, (_, struck) in enumerate(word, start=1) if struck == name), len(word) + 1]


def find_own(word: Word, name: str) -> list[int]:
    """Return the numbers of an object's impacts in a word, from 0."""
    return [k for k, (_, struck) in enumerate(word) if struck == name]


def make_object_curve(sequence: EventSequence, name: str) -> Curve:
    """Return an object's curve: straight and uniform between its own events.

    Args:
        sequence: events.
        name: of the object.

    Returns:
        A curve of degree 1.
    """
    own = own_events(sequence.hitters, name)
    points = sequence.paths[name][own]
    return Curve(sequence.times[own], np.stack([points[:-1], points[1:]], axis=1))


def compute_impacts(scenario: FreeFlyerScenario, sequence: EventSequence) -> tuple[PlannedImpact, ...]:
    r"""Return the impacts that send the object along its path.

    v_R^- = (v_O^+ - m4 v_O^-) / m3 and v_R^+ = m1 v_R^- + m2 v_O^-; the impulse is along
    n = (v_O^+ - v_O^-) / |v_O^+ - v_O^-|, so discs touch at p_O - (r_R + r_O) n. The relative velocity
    v_R^- - v_O^- is along n as well: Eq. (6) for discs and Eq. (5) for points then agree.

    Args:
        scenario: masses, radii and believed restitution.
        sequence: events.

    Returns:
        One planned impact per event.

    Raises:
        Infeasible: an impact would not change the object's velocity.

    Source: Verhagen & Tumova, Eqs. (5), (6).
    """
    impacts = []
    for k, (name, struck) in enumerate(sequence.hitters, start=1):
        robot, body, e = scenario.robots[name], scenario.objects[struck], scenario.believed.restitution
        own, path = own_events(sequence.hitters, struck), sequence.paths[struck]
        before, after = own[own.index(k) - 1], own[own.index(k) + 1]
        minus, plus = (
            (path[b] - path[a]) / (sequence.times[b] - sequence.times[a]) for a, b in ((before, k), (k, after))
        )
        m1, m2, m3, m4 = compute_mass_fractions(robot.mass, body.mass, e)
        change = float(np.linalg.norm(plus - minus))
        if change < 1e-3:
            raise Infeasible("impact inversion", f"impact {k} changes nothing", "allow fewer impacts")
        normal = (plus - minus) / change
        robot_minus = (plus - m4 * minus) / m3
        impacts.append(
            PlannedImpact(
                time=float(sequence.times[k]),
                robot=name,
                object=struck,
                position=path[k],
                contact=path[k] - (robot.radius + body.radius) * normal,
                normal=normal,
                robot_minus=robot_minus,
                robot_plus=m1 * robot_minus + m2 * minus,
                object_minus=minus,
                object_plus=plus,
            )
        )
    return tuple(impacts)


def compute_impact_caps(
    scenario: FreeFlyerScenario, name: str, impacts: int, reserves: Reserves, own: Sequence[int] | None = None
) -> dict[str, list[float]]:
    r"""Return, per robot, the greatest speed per axis that an object may have before and after each impact by it.

    A leg between impacts with |v^-|, |v^+| <= c per axis needs robot velocities v_R^- = (v^+ - m4 v^-) / m3
    and v_R^+ = m1 v_R^- + m2 v^-, which keep |v_R| <= v_max if
    c <= v_max / max((1 + |m4|) / m3, |m1| / m3 + |m2 - m1 m4 / m3|).
    The only object is as fast as it starts before the first impact, and at rest after the last one if it has to be.
    Where several objects share the impacts, whose is the first or last is open, and the least of these speeds holds.

    Args:
        scenario: masses, restitution and speed limits.
        name: of the object.
        impacts: number K of impacts.
        reserves: what the plan keeps in hand.
        own: numbers of the impacts on this object, from 0, where they are known; None: all of the only object's, else
            unknown.

    Returns:
        Robot to K speeds [m/s].

    Source: Verhagen & Tumova, Eq. (5), solved for the robot's velocities.
    """
    body = scenario.objects[name]
    start = max(map(abs, body.start_velocity))
    if own is None:
        own = range(impacts if len(scenario.objects) == 1 else 0)
    caps = {}
    for hitter, robot in scenario.robots.items():
        m1, m2, m3, m4 = compute_mass_fractions(robot.mass, body.mass, scenario.believed.restitution)
        limit, through = reserves.cruise(robot), abs(m2 - m1 * m4 / m3)
        at_impact = [limit / max((1 + abs(m4)) / m3, abs(m1) / m3 + through)] * impacts
        if own:
            room = (limit - abs(m4) / m3 * start) / (1 / m3), (limit - through * start) / max(abs(m1) / m3, 1e-9)
            at_impact[own[0]] = max(0.0, min(room))
            if len(own) > 1 and body.rest:
                at_impact[own[-1]] = limit / max(abs(m4) / m3, through, 1e-9)
        caps[hitter] = at_impact
    return caps


def compute_speed_caps(
    scenario: FreeFlyerScenario,
    name: str,
    impacts: int,
    reserves: Reserves,
    word: Word | None = None,
    sharp: bool = False,
) -> list[float]:
    """Return the greatest speed per axis of every leg of an object, whoever of those who may hit it does.

    Args:
        scenario, name, impacts, reserves: as for `compute_impact_caps`.
        word: who hits what at each impact; None: anybody anything.
        sharp: whether the word tells which impacts are an object's first and last, see `find_own`.

    Returns:
        K + 1 speeds [m/s]; zero where the object rests. One that moves at the start may go on as fast on any leg, if
        it is not the only one.
    """
    known = find_own(word, name) if sharp and word is not None else None
    body, each = scenario.objects[name], compute_impact_caps(scenario, name, impacts, reserves, known)
    start = max(map(abs, body.start_velocity))
    at_impact = [max(caps) for caps in zip(*each.values(), strict=True)]
    own = {
        k: at_impact[k] if robot == ANYBODY else each[robot][k]
        for k, (robot, struck) in enumerate(word or ())
        if struck == name
    }
    for k in range(impacts if own else 0):
        # Between two impacts of its own the object keeps its speed.
        before, after = [i for i in own if i <= k][-1:], [i for i in own if i >= k][:1]
        at_impact[k] = min(own[i] for i in (*before, *after))
    moving = [min(body.speed_limit, *at_impact[k : k + 2]) for k in range(impacts)]
    caps = [start, *moving[:-1], 0.0 if body.rest else moving[-1]] if impacts else [start]
    return [max(cap, start) for cap in caps] if len(scenario.objects) > 1 else caps
