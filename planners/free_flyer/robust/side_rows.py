"""Rows of the box grid for bodies with radii: every robot stays on one side of the object."""

from __future__ import annotations

import itertools

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.box_grid import HALF_ANGLE, BoxGrid, PositionBox
from planners.free_flyer.specification.direction import AXES
from planners.mixed_integer import Affine

# Velocities along the direction of an impact, as shares of the object's greatest speed; one of them lies between the
# velocities before and after it.
LEVELS = (0.0, -0.3, 0.3, -0.6, 0.6)
COARSE = 1e-3  # so that a rounded fixed start or goal still counts as clear of a side [m]


def add_side_rows(grid: BoxGrid, scenario: FreeFlyerScenario, reserves: Reserves) -> None:
    """Let every robot choose one side of the object for the whole plan; it hits the object from there only.

    Otherwise it keeps its distance. The robot is then never in the object's way, does not overtake it, and its contact
    point is a smooth function of the object's place.

    Args:
        grid: gets the rows.
        scenario: with the radii.
        reserves: what the plan keeps in hand.

    Raises:
        Infeasible: the variable bounds alone exclude every side.
    """
    for sides in grid.sides.values():
        grid.model.require_equal(sum(sides, Affine({})) - 1.0)
    spans = [_add_span(grid, k) for k in range(len(grid.moves))]
    for event in range(len(grid.hits)):
        _add_cone_rows(grid, spans, event, _compute_least_push(grid, scenario, reserves))
    for robot, sides in grid.sides.items():
        _add_clearance_rows(grid, scenario, (robot, grid.object), sides, reserves)
    for pair in itertools.combinations(scenario.robots, 2):
        sides = [grid.model.binary() for _ in AXES]
        grid.model.require_equal(sum(sides, Affine({})) - 1.0)
        _add_clearance_rows(grid, scenario, pair, sides, reserves)


def _compute_least_push(grid: BoxGrid, scenario: FreeFlyerScenario, reserves: Reserves) -> Affine | float:
    """Return the least change of the object's velocity at which the bodies part, whatever the deviation [m/s].

    They part at e (m_R + m_O) / ((1 + e) m_R) |v^+ - v^-|, less delta of the object and m_O / m_R delta of the robot.
    """
    e = max(scenario.believed.restitution, 1e-3)
    return grid.delta * ((1.0 + e) / e) + reserves.push_speed


def _add_span(grid: BoxGrid, leg: int) -> PositionBox:
    """Return the box of all displacements wanted on a moving leg."""
    first, second = grid.moves[leg]
    if all(one is other for one, other in zip(first, second, strict=True)):
        return PositionBox(first, first)
    bounds = np.array([grid.model.limits(entry) for entry in first]).T
    lower, upper = grid.model.vector(*bounds), grid.model.vector(*bounds)
    for move, d in itertools.product((first, second), range(2)):
        grid.model.require(lower[d] - move[d])
        grid.model.require(move[d] - upper[d])
    return PositionBox(lower, upper)


def _add_cone_rows(grid: BoxGrid, spans: list[PositionBox], event: int, push: Affine | float) -> None:
    """Constrain every impulse to a cone around the direction of the hitting robot's side, and away from zero.

    If for some velocity w along the direction v^+ - w and w - v^- are in a cone, so is v^+ - v^-. Each of them, times
    the duration of its leg, is linear.
    """
    model = grid.model
    before, after = grid.legs[event], grid.legs[event + 1]
    # Before the first impact the object rests, and w = 0 is the best choice.
    shift_before, shift_after = _add_shifts(grid, event) if event else (Affine({}), Affine({}))
    for (robot, hit), (i, a) in itertools.product(grid.hits[event].items(), enumerate(AXES)):
        unless = 2.0 - hit - grid.sides[robot][i]
        for g in (a[::-1] - np.tan(HALF_ANGLE) * a, -a[::-1] - np.tan(HALF_ANGLE) * a):
            model.require(spans[event].support(g) - shift_after * (g @ a), unless=unless)
            if event:
                deviation = before * (grid.delta * float(np.abs(g).sum()))  # type: ignore[operator]
                model.require(spans[event - 1].support(-g) + deviation + shift_before * (g @ a), unless=unless)
        if event:
            row = spans[event - 1].support(a) + before * (grid.delta + push) - shift_before  # type: ignore[operator]
            model.require(row, unless=unless)
        else:
            model.require(spans[0].support(-a) + after * push, unless=unless)  # type: ignore[operator]


def _add_shifts(grid: BoxGrid, event: int) -> tuple[Affine, Affine]:
    """Return the durations before and after an impact, each times the same one of the velocities of `LEVELS`.

    Durations are split into one part per velocity, of which all but one are zero: products without a big M.
    """
    model, fastest = grid.model, max(grid.caps)
    chosen = [model.binary() for _ in LEVELS]
    model.require_equal(sum(chosen, Affine({})) - 1.0)
    shifts = []
    for duration in grid.legs[event : event + 2]:
        longest = model.limits(duration)[1]
        parts = [model.variable(0.0, longest) for _ in LEVELS]
        for part, choice in zip(parts, chosen, strict=True):
            model.require(part - choice * longest)
        model.require_equal(sum(parts, Affine({})) - duration)
        shifts.append(sum((part * (level * fastest) for part, level in zip(parts, LEVELS, strict=True)), Affine({})))
    return shifts[0], shifts[1]


def _add_clearance_rows(
    grid: BoxGrid, scenario: FreeFlyerScenario, pair: tuple[str, str], sides: list[Affine], reserves: Reserves
) -> None:
    """Keep the second body beyond the first along the axis of the chosen side, except at their own impacts.

    Boxes that are apart along an axis at both ends of a piece are apart in between.
    """
    first, second = (grid.knots[name] for name in pair)
    touching = scenario.body(pair[0]).radius + scenario.body(pair[1]).radius
    far = touching + reserves.clearance
    for knot in range(grid.count + 1):
        hit = grid.hits_at(knot).get(pair[0], 0.0) if pair[1] == grid.object else 0.0
        for side, axis in zip(sides, AXES, strict=True):
            apart = -(first[knot].support(axis) + second[knot].support(-axis))
            wanted = touching + reserves.wall if knot == grid.count else far
            if not isinstance(apart, Affine):
                # Fixed ends may be closer; diagonal neighbours count as clear of both axes.
                wanted = min(max(apart, touching * np.sqrt(0.5) - COARSE), far)
            grid.model.require(wanted - apart + Affine({}), unless=1.0 - side + hit)
