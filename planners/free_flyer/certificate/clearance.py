"""Checks of gaps over continuous time: between bodies, to the world's edges and to solid obstacles."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from fractions import Fraction

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.certificate.area import Face, make_faces
from planners.free_flyer.certificate.check import Check, Found, Tolerances, check_least, find_least
from planners.free_flyer.certificate.claim import Claim, Motion
from planners.free_flyer.certificate.motion import ONE, measure_root
from planners.free_flyer.certificate.polynomial import Range, combine, square
from planners.free_flyer.certificate.search import Effort, Measure
from planners.free_flyer.certificate.track import Cell, list_cells


def check_clearance(claim: Claim, scenario: FreeFlyerScenario, tolerances: Tolerances) -> list[Check]:
    """Return the checks that nothing touches but at planned impacts.

    Pairs with planned impacts touch at these, and must not overlap at any time; others must not touch at all.

    Args:
        claim: of a plan for the scenario.
        scenario: radii, edges and obstacles.
        tolerances: see Tolerances.
    """
    least, effort = -tolerances.length, tolerances.effort
    meeting = {(impact.robot, impact.object) for impact in claim.impacts}
    pairs = list(itertools.combinations(scenario.bodies, 2))
    others = [pair for pair in pairs if pair not in meeting]
    known = [pair for pair in pairs if pair in meeting]
    return [
        *check_least("gap to the world's edges", "m", least, _list_edges(claim, scenario, effort)),
        *check_least("gap to solid obstacles", "m", least, _list_obstacles(claim, scenario, effort)),
        *check_least("gap of bodies that never meet", "m", least, _list_gaps(claim, scenario, others, effort)),
        *check_least("gap of bodies with impacts", "m", least, _list_gaps(claim, scenario, known, effort)),
    ]


def list_distances(first: Motion, second: Motion, start: Fraction, end: Fraction) -> Iterator[Cell]:
    """Yield the squared distance of two bodies' centres between all breakpoints of their paths.

    Args:
        first, second: motions of the bodies.
        start, end: of the time [s].
    """
    for cell in list_cells([*first.position, *second.position], start, end):
        x0, y0, x1, y1 = cell.parts
        squares = [square(combine(pair, [ONE, -ONE], Fraction(0))) for pair in ((x0, x1), (y0, y1))]
        yield Cell(cell.start, cell.end, (combine(squares, [ONE, ONE], Fraction(0)),))


def _list_gaps(
    claim: Claim, scenario: FreeFlyerScenario, pairs: Sequence[tuple[str, str]], effort: Effort
) -> Iterator[Found]:
    for first, second in pairs:
        touching = Fraction(scenario.body(first).radius) + Fraction(scenario.body(second).radius)
        cells = list_distances(claim.paths[first], claim.paths[second], Fraction(0), claim.horizon)
        found = find_least(f"{first} and {second}", cells, measure_root, effort)
        yield Found(found.amount - touching, found.where)


def _list_edges(claim: Claim, scenario: FreeFlyerScenario, effort: Effort) -> Iterator[Found]:
    (x0, y0), (x1, y1) = scenario.world.lower, scenario.world.upper
    faces = make_faces([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    for name in scenario.bodies:
        for face in faces:
            cells = _list_slacks(claim.paths[name], [face], claim.horizon)
            found = find_least(name, cells, _measure_deepest([face]), effort)
            yield Found(found.amount - Fraction(scenario.body(name).radius), found.where)


def _list_obstacles(claim: Claim, scenario: FreeFlyerScenario, effort: Effort) -> Iterator[Found]:
    """Yield how far bodies keep behind a face of each obstacle: past a corner they may be farther from it."""
    for area, obstacle in scenario.obstacles.items():
        faces = make_faces(obstacle.corners)
        for name in scenario.bodies if obstacle.solid else ():
            cells = _list_slacks(claim.paths[name], faces, claim.horizon)
            found = find_least(f"{name} and {area}", cells, _measure_outside(faces), effort)
            yield Found(found.amount - Fraction(scenario.body(name).radius), found.where)


def _list_slacks(motion: Motion, faces: Sequence[Face], horizon: Fraction) -> Iterator[Cell]:
    for cell in list_cells(motion.position, Fraction(0), horizon):
        yield Cell(cell.start, cell.end, tuple(face.make_part(*cell.parts) for face in faces))


def _measure_deepest(faces: Sequence[Face]) -> Measure:
    """Return the measure of how far a point is inside all faces [m]."""

    def measure(ranges: Sequence[Range]) -> Range:
        bounds = [face.bound(part) for face, part in zip(faces, ranges, strict=True)]
        return min(low for low, _ in bounds), min(high for _, high in bounds)

    return measure


def _measure_outside(faces: Sequence[Face]) -> Measure:
    """Return the measure of how far a point is outside the farthest face [m]."""
    inside = _measure_deepest(faces)

    def measure(ranges: Sequence[Range]) -> Range:
        low, high = inside(ranges)
        return -high, -low

    return measure
