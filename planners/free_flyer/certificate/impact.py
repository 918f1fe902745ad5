"""Checks of impacts: contact, momentum, restitution, tangential velocity, and the file's table of them.

With n = p_object - p_robot and relative velocity u = v_robot - v_object, an impact of discs without friction keeps
momentum and all velocities across n, and turns u . n into -e u . n. Only |n| is irrational; it is bounded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.certificate.check import Check, Found, Tolerances, check_least, check_most
from planners.free_flyer.certificate.claim import Claim, ClaimedImpact, Motion, Point
from planners.free_flyer.certificate.motion import find_excess, list_hits
from planners.free_flyer.certificate.polynomial import root_above, root_below
from planners.free_flyer.certificate.track import Track, find_value

FAR = Fraction(10**9)  # stands for a distance that could not be told: centres on one point have no normal


@dataclass(frozen=True)
class Collision:
    """An impact as the curves have it.

    Attributes:
        impact: as the file tells it.
        apart: from the robot's centre to the object's [m].
        robot_minus, robot_plus, object_minus, object_plus: velocities just before and after [m/s].
        robot_position, object_position: of the centres [m].
    """

    impact: ClaimedImpact
    robot_position: Point
    object_position: Point
    robot_minus: Point
    robot_plus: Point
    object_minus: Point
    object_plus: Point

    @property
    def apart(self) -> Point:
        """Return the vector from the robot's centre to the object's, along the normal [m]."""
        return _subtract(self.object_position, self.robot_position)

    @property
    def shortest(self) -> Fraction:
        """Return a lower bound of the distance of the centres [m]."""
        return root_below(_dot(self.apart, self.apart))

    def along(self, vector: Point) -> Fraction:
        """Return an upper bound of a vector's size along the normal, zero where it is zero."""
        return abs(_dot(vector, self.apart)) / self.shortest if self.shortest > 0 else FAR

    def across(self, vector: Point) -> Fraction:
        """Return an upper bound of a vector's size across the normal, zero where it is zero."""
        return abs(_cross(self.apart, vector)) / self.shortest if self.shortest > 0 else FAR

    def __str__(self) -> str:
        return f"{self.impact.robot} on {self.impact.object} at {float(self.impact.time):.6g} s"


def check_impacts(claim: Claim, scenario: FreeFlyerScenario, tolerances: Tolerances) -> list[Check]:
    """Return the checks of all planned impacts; none for a plan without.

    Args:
        claim: of a plan for the scenario.
        scenario: masses, radii and restitution as they are believed.
        tolerances: see Tolerances.
    """
    collisions = [
        found
        for impact in claim.impacts
        if (found := _find_collision(claim, impact)) is not None and _find_rival(claim, impact) >= tolerances.time
    ]

    def find(measure: Callable[[Collision], Fraction]) -> Iterable[Found]:
        return [Found(measure(collision), str(collision)) for collision in collisions]

    e = Fraction(scenario.believed.restitution)
    lengths, speeds = tolerances.length, tolerances.velocity
    checks = [
        *check_most("impacts between pieces", "s", Fraction(0), _list_instants(claim)),
        *check_least("impacts of one body apart", "s", tolerances.time, _list_rivals(claim)),
        *check_most("contact at impacts", "m", lengths, find(lambda one: _miss_contact(one, scenario))),
        *check_least("approach at impacts", "m/s", speeds, find(_find_approach)),
        *check_most("restitution", "m/s", speeds, find(lambda one: _miss_restitution(one, e))),
        *check_most("momentum", "m/s", speeds, find(lambda one: _miss_momentum(one, scenario))),
        *check_most("tangential velocities", "m/s", speeds, find(_miss_tangent)),
        *check_most("places in the table of impacts", "m", lengths, find(_miss_places)),
        *check_most("velocities in the table of impacts", "m/s", speeds, find(_miss_velocities)),
    ]
    if scenario.believed.friction > 0.0:
        slips = find(lambda one: _find_slip(one, scenario))
        checks += check_most("sliding at impacts, where friction would act", "m/s", speeds, slips)
    return checks


def _find_collision(claim: Claim, impact: ClaimedImpact) -> Collision | None:
    """Return what the curves do at an impact, None if one has no breakpoint there."""
    both = claim.paths[impact.robot], claim.paths[impact.object]
    if any(_find_breakpoint(motion, impact.time) != impact.time for motion in both):
        return None
    places = [_evaluate(motion.position, impact.time, True) for motion in both]
    speeds = [_evaluate(motion.velocity, impact.time, after) for motion in both for after in (False, True)]
    return Collision(impact, *places, *speeds)


def _find_breakpoint(motion: Motion, time: Fraction) -> Fraction:
    """Return the inner breakpoint of a curve that is nearest to an instant; far away if it has none."""
    return min((piece.start for piece in motion.x[1:]), key=lambda start: abs(start - time), default=FAR)


def _evaluate(tracks: tuple[Track, Track], time: Fraction, after: bool) -> Point:
    return find_value(tracks[0], time, after), find_value(tracks[1], time, after)


def _list_instants(claim: Claim) -> Iterator[Found]:
    for impact in claim.impacts:
        for name in (impact.robot, impact.object):
            off = abs(_find_breakpoint(claim.paths[name], impact.time) - impact.time)
            yield Found(off, f"{name} at {float(impact.time):.6g} s")


def _list_rivals(claim: Claim) -> Iterator[Found]:
    for impact in claim.impacts:
        yield Found(_find_rival(claim, impact), f"{impact.robot} on {impact.object} at {float(impact.time):.6g} s")


def _find_rival(claim: Claim, impact: ClaimedImpact) -> Fraction:
    """Return the time to the next impact of either body: which of two at once is first, nobody can tell."""
    times = [hit for name in (impact.robot, impact.object) for hit in list_hits(claim, name)]
    gaps = sorted(abs(time - impact.time) for time in times)
    return min(gaps[2:], default=claim.horizon)  # the impact itself is in both bodies' lists


def _miss_contact(one: Collision, scenario: FreeFlyerScenario) -> Fraction:
    touching = Fraction(scenario.body(one.impact.robot).radius) + Fraction(scenario.body(one.impact.object).radius)
    squared = _dot(one.apart, one.apart)
    return max(root_above(squared) - touching, touching - root_below(squared))


def _find_approach(one: Collision) -> Fraction:
    """Return a lower bound of the approaching speed where it is positive, an upper one where it is not."""
    closing = _dot(_subtract(one.robot_minus, one.object_minus), one.apart)
    longest = root_above(_dot(one.apart, one.apart))
    return closing / longest if longest > 0 else -FAR


def _miss_restitution(one: Collision, e: Fraction) -> Fraction:
    before = _subtract(one.robot_minus, one.object_minus)
    after = _subtract(one.robot_plus, one.object_plus)
    return one.along((after[0] + e * before[0], after[1] + e * before[1]))


def _miss_momentum(one: Collision, scenario: FreeFlyerScenario) -> Fraction:
    """Return the momentum that is lost or gained over the smaller mass [m/s]."""
    masses = [Fraction(scenario.body(name).mass) for name in (one.impact.robot, one.impact.object)]
    changes = _subtract(one.robot_plus, one.robot_minus), _subtract(one.object_plus, one.object_minus)
    gained = [masses[0] * one + masses[1] * other for one, other in zip(*changes, strict=True)]
    return max(map(abs, gained)) / min(masses)


def _miss_tangent(one: Collision) -> Fraction:
    changes = _subtract(one.robot_plus, one.robot_minus), _subtract(one.object_plus, one.object_minus)
    return max(map(one.across, changes))


def _find_slip(one: Collision, scenario: FreeFlyerScenario) -> Fraction:
    """Return an upper bound of the surfaces' relative speed across the normal."""
    item = scenario.objects[one.impact.object]
    spin = Fraction(item.start_rate) * Fraction(item.radius)
    slip = _cross(one.apart, _subtract(one.robot_minus, one.object_minus))
    longest = root_above(_dot(one.apart, one.apart))
    if one.shortest <= 0:
        return FAR
    return max(abs(slip / length + spin) for length in (one.shortest, longest))


def _miss_places(one: Collision) -> Fraction:
    told = one.impact.vectors
    squared = _dot(one.apart, one.apart)
    places = max(find_excess(told["position"], one.object_position), find_excess(told["contact"], one.robot_position))
    ends = [(one.apart[0] / length, one.apart[1] / length) for length in _bound_length(squared)]
    return max(places, *(find_excess(told["normal"], end) for end in ends))


def _bound_length(squared: Fraction) -> tuple[Fraction, ...]:
    below = root_below(squared)
    return (below, root_above(squared)) if below > 0 else (1 / FAR,)


def _miss_velocities(one: Collision) -> Fraction:
    names = ("robot_minus", "robot_plus", "object_minus", "object_plus")
    return max(find_excess(one.impact.vectors[name], getattr(one, name)) for name in names)


def _subtract(left: Point, right: Point) -> Point:
    return left[0] - right[0], left[1] - right[1]


def _dot(left: Point, right: Point) -> Fraction:
    return left[0] * right[0] + left[1] * right[1]


def _cross(left: Point, right: Point) -> Fraction:
    return left[0] * right[1] - left[1] * right[0]
