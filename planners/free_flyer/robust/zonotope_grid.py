"""The paper's grid: segments of equal duration, each with a box of the object's positions and velocities."""

from __future__ import annotations

import itertools

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.box_grid import BoxGrid, ObjectLegs, PositionBox, make_grid
from planners.free_flyer.robust.conditions import Conditions
from planners.mixed_integer import Affine, Model


def build_zonotope_grid(
    scenario: FreeFlyerScenario,
    segments: int,
    delta: float | None,
    conditions: Conditions,
    reserves: Reserves,
) -> BoxGrid:
    r"""Build the model of all motions with impacts on a grid of N equal segments, for bodies without extent.

    With dt = T / N and the box [p] x [v] of an axis at the start of a segment, the next one holds, from every
    vertex, (p + v dt, v) without an impact and (p + (u_p +- delta) dt, u_p +- delta) with one, where the velocity
    u_p wanted after it depends on the end p of the interval. The intervals of position and velocity forget how
    they belong together, so the spread grows at every boundary. For equal masses and e = 1 (m4 = 0) this is as exact as
    all 16 vertices, for u does not depend on the velocity before.

    Args:
        scenario: one object, any number of robots.
        segments: number N >= 2 of segments.
        delta: permissible deviation; None makes it the objective, to be maximised [m/s].
        conditions: final velocity, initial box and margin; the gap is dt.
        reserves: what the plan keeps in hand.

    Returns:
        The grid.

    Source: Verhagen & Tumova, Eqs. (16)-(20). Their published code allows no impact at the last boundary: a Python
    index -1 couples it to the first box, which is a point.
    """
    model = Model(f"zonotope grid of {scenario.name} with {segments} segments")
    name = next(iter(scenario.objects))
    body, step = scenario.objects[name], scenario.horizon / segments
    wanted = model.variable(0.0, body.speed_limit) if delta is None else delta
    legs, caps = [step] * segments, [0.0, *[body.speed_limit] * (segments - 1)]
    grid = make_grid(model, scenario, ObjectLegs(legs, caps), wanted, conditions, reserves, turning=False)
    if isinstance(wanted, Affine):
        model.objective = -wanted
    velocities = grid.velocities
    velocities.append(PositionBox(np.zeros(2), np.zeros(2)))
    for segment in range(1, segments):
        fastest = np.full(2, body.speed_limit)
        velocities.append(PositionBox(model.vector(-fastest, fastest), model.vector(-fastest, fastest)))
        hit = sum(grid.hits[segment - 1].values(), Affine({}))
        model.require(hit - 1.0)
        _add_segment_rows(grid, segment, step, velocities, hit)
        _add_velocity_rows(grid, scenario, segment, step, velocities[segment - 1])
    if body.rest:
        for row in (*(velocities[-1].upper), *(-velocities[-1].lower)):
            model.require(row - conditions.final_velocity)
    return grid


def _add_segment_rows(grid: BoxGrid, segment: int, step: float, velocities: list[PositionBox], hit: Affine) -> None:
    """Require all vertices of the box at a boundary to be in the boxes of the next segment and at its end."""
    model, here, there = grid.model, grid.boxes[segment], grid.boxes[segment + 1]
    before, now = velocities[segment - 1 : segment + 1]
    for d in range(2):
        model.require(now.lower[d] - before.lower[d], unless=hit)
        model.require(before.upper[d] - now.upper[d], unless=hit)
        model.require(there.lower[d] - (here.lower[d] + now.lower[d] * step), unless=hit)
        model.require(here.upper[d] + now.upper[d] * step - there.upper[d], unless=hit)
        for end, move in zip((here.lower[d], here.upper[d]), grid.moves[segment - 1][:, d], strict=True):
            spread = grid.delta * step
            model.require(there.lower[d] - (end + move - spread), unless=1.0 - hit)
            model.require(end + move + spread - there.upper[d], unless=1.0 - hit)
            model.require(now.lower[d] * step - (move - spread), unless=1.0 - hit)
            model.require(move + spread - now.upper[d] * step, unless=1.0 - hit)


def _add_velocity_rows(
    grid: BoxGrid, scenario: FreeFlyerScenario, segment: int, step: float, before: PositionBox
) -> None:
    """Bound the velocities v_R^- = (u - m4 v_O^-) / m3 and m1 v_R^- + m2 v_O^- of a robot that hits."""
    for name, hit in grid.hits[segment - 1].items():
        robot, body = scenario.robots[name], scenario.objects[grid.object]
        m1, m2, m3, m4 = compute_mass_fractions(robot.mass, body.mass, scenario.believed.restitution)
        for d, end, v, sign in itertools.product(range(2), range(2), (before.lower, before.upper), (1.0, -1.0)):
            minus = (grid.moves[segment - 1][end, d] * (1.0 / step) - v[d] * m4) * (1.0 / m3)
            for velocity in (minus, minus * m1 + v[d] * m2):
                grid.model.require(velocity * sign - robot.speed_limit, unless=1.0 - hit)
