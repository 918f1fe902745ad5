"""Checks of how bodies move between impacts: starts, ends, smooth pieces, straight flight, speed and force."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from fractions import Fraction

from impact_envs.free_flyer.schema import FreeFlyerScenario, Object, Robot
from planners.free_flyer.certificate.check import Check, Found, Tolerances, check_least, check_most, find_most
from planners.free_flyer.certificate.claim import Claim
from planners.free_flyer.certificate.polynomial import Range, combine, root_above, root_below, square
from planners.free_flyer.certificate.track import Cell, Track, derive, find_value, list_cells

ONE = Fraction(1)


def check_motion(claim: Claim, scenario: FreeFlyerScenario, tolerances: Tolerances) -> list[Check]:
    """Return the checks of starts, ends, continuity, free flight and limits.

    Args:
        claim: of a plan for the scenario.
        scenario: starts, goals and limits as they are believed.
        tolerances: see Tolerances.
    """
    most = tolerances.length, tolerances.velocity
    return [
        *check_most("start position", "m", most[0], _list_starts(claim, scenario, "position", "start")),
        *check_most("start velocity", "m/s", most[1], _list_starts(claim, scenario, "velocity", "start_velocity")),
        *check_most("goal position", "m", most[0], _list_goals(claim, scenario)),
        *check_most("rest at the horizon", "m/s", most[1], _list_rests(claim, scenario)),
        *check_most("jumps of position", "m", most[0], _list_jumps(claim, scenario, "position")),
        *check_most("jumps of velocity without impact", "m/s", most[1], _list_jumps(claim, scenario, "velocity")),
        *check_most("bends of objects in flight", "m/s", most[1], _list_bends(claim, scenario)),
        *check_least("speed left to its limit", "m/s", Fraction(0), _list_speeds(claim, scenario, tolerances)),
        *check_least("force left to its limit", "N", Fraction(0), _list_forces(claim, scenario, tolerances)),
    ]


def list_hits(claim: Claim, name: str) -> list[Fraction]:
    """Return the instants of a body's planned impacts [s]."""
    return [impact.time for impact in claim.impacts if name in (impact.robot, impact.object)]


def find_excess(values: Sequence[Fraction], wanted: Sequence[Fraction]) -> Fraction:
    """Return the greatest difference of two vectors per axis."""
    return max(abs(value - want) for value, want in zip(values, wanted, strict=True))


def _get(claim: Claim, name: str, kind: str) -> tuple[Track, Track]:
    motion = claim.paths[name]
    return motion.position if kind == "position" else motion.velocity


def _list_starts(claim: Claim, scenario: FreeFlyerScenario, kind: str, key: str) -> Iterator[Found]:
    for name in scenario.bodies:
        values = [find_value(track, Fraction(0)) for track in _get(claim, name, kind)]
        wanted = [Fraction(number) for number in getattr(scenario.body(name), key)]
        yield Found(find_excess(values, wanted), f"{name} at 0 s")


def _list_goals(claim: Claim, scenario: FreeFlyerScenario) -> Iterator[Found]:
    for name, robot in scenario.robots.items():
        if robot.goal is not None:
            values = [find_value(track, claim.horizon) for track in claim.paths[name].position]
            yield Found(find_excess(values, [Fraction(number) for number in robot.goal]), name)


def _list_rests(claim: Claim, scenario: FreeFlyerScenario) -> Iterator[Found]:
    """Yield how fast bodies are at the horizon that must rest there.

    Objects that are never hit, or whose velocities after impacts deviate, may keep their `final_speed`.
    """
    for name in scenario.bodies:
        body = scenario.body(name)
        speed = max(abs(find_value(track, claim.horizon, after=False)) for track in claim.paths[name].velocity)
        if isinstance(body, Object):
            if not body.rest:
                continue
            if claim.deviation is not None or not list_hits(claim, name):
                speed = max(speed - Fraction(body.final_speed), Fraction(0))
        yield Found(speed, name)


def _list_jumps(claim: Claim, scenario: FreeFlyerScenario, kind: str) -> Iterator[Found]:
    """Yield the jumps at breakpoints; of velocities those that belong to no planned impact of the body."""
    for name in scenario.bodies:
        hits = list_hits(claim, name) if kind == "velocity" else []
        for track in _get(claim, name, kind):
            yield Found(Fraction(0), name)
            for before, after in itertools.pairwise(track):
                if after.start not in hits:
                    where = f"{name} at {float(after.start):.6g} s"
                    yield Found(abs(after.values[0] - before.values[-1]), where)


def _list_bends(claim: Claim, scenario: FreeFlyerScenario) -> Iterator[Found]:
    """Yield by how much the velocity of an object may change within a piece: by coefficients that differ."""
    for name in scenario.objects:
        for track in claim.paths[name].velocity:
            for piece in track:
                yield Found(max(piece.values) - min(piece.values), f"{name} after {float(piece.start):.6g} s")


def _list_speeds(claim: Claim, scenario: FreeFlyerScenario, tolerances: Tolerances) -> Iterator[Found]:
    """Yield what is left to the speed limit per axis; of an object its start velocity, which no plan can change."""
    for name in scenario.bodies:
        body = scenario.body(name)
        limit = Fraction(max(body.speed_limit, *map(abs, body.start_velocity))) * (1 + tolerances.share)
        for track in claim.paths[name].velocity:
            cells = list_cells([track], Fraction(0), claim.horizon)
            found = find_most(name, cells, _measure_size, tolerances.effort)
            yield Found(limit - found.amount, found.where)


def _list_forces(claim: Claim, scenario: FreeFlyerScenario, tolerances: Tolerances) -> Iterator[Found]:
    """Yield what is left to the force limit; a force within the circle is possible at any heading."""
    for name, robot in scenario.robots.items():
        assert isinstance(robot, Robot)
        tracks = [derive(track) for track in claim.paths[name].velocity]
        cells = [_square_sum(cell) for cell in list_cells(tracks, Fraction(0), claim.horizon)]
        found = find_most(name, cells, measure_root, tolerances.effort)
        limit = Fraction(robot.force_limit) * (1 + tolerances.share)
        yield Found(limit - Fraction(robot.mass) * found.amount, found.where)


def _square_sum(cell: Cell) -> Cell:
    """Return the sum of the squares of a cell's parts, of equal degree."""
    squares = [square(part) for part in cell.parts]
    return Cell(cell.start, cell.end, (combine(squares, [ONE] * len(squares), Fraction(0)),))


def _measure_size(ranges: Sequence[Range]) -> Range:
    ((low, high),) = ranges
    return max(low, -high, Fraction(0)), max(high, -low)


def measure_root(ranges: Sequence[Range]) -> Range:
    """Return bounds of the root of a sum of squares, the only part."""
    ((low, high),) = ranges
    return root_below(max(low, Fraction(0))), root_above(max(high, Fraction(0)))
