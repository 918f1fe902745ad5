"""The impacts of least path cost that bear a given deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.cones import solve_cones
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.robust.box_grid import BoxGrid
from planners.free_flyer.robust.box_sequence import BoxSequence, make_tube, tighten
from planners.free_flyer.robust.task import RobustTask
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import Requirement
from planners.free_flyer.specification.selection import Choices
from planners.mixed_integer import Affine, evaluate
from planners.path_cost import PieceCost, add_path_cost, measure_path_cost
from planners.plan import Tube
from planners.solvers import solve


@dataclass(frozen=True)
class RobustEvents:
    """Hold the impacts of least path cost.

    Args:
        sequence: the impacts, with tight boxes.
        needs: what the formula demands of them; its alternatives are chosen.
        tube: boxes that hold the object.
        cost: J of the motions if nothing deviates [m^2/s].
        bound: proven lower bound of J; None on a constant grid [m^2/s].
        word: robot that hits at every event of the grid; empty where none hits.
    """

    sequence: BoxSequence
    needs: tuple[Requirement, ...]
    tube: Tube
    cost: float
    bound: float | None
    word: tuple[str, ...]


def minimise_robust_cost(
    task: RobustTask, size: GridSize, delta: float, forbidden: Sequence[tuple[str, ...]], time_limit: float
) -> RobustEvents:
    r"""Return the impacts of least path cost that bear a deviation.

    J = sum over legs and axes of D^2 / T between the centres of boxes, as tangent planes
    D^2 / T >= 2 q D - q^2 T in the mixed-integer problem and exactly in the cone program for its integers. On a
    constant grid, which has more events than needed, the number of impacts is minimised first.

    Args:
        task: what is asked.
        size: of the grid.
        delta: deviation to bear [m/s].
        forbidden: words that are excluded.
        time_limit: of the mixed-integer solution [s].

    Returns:
        The impacts, their cost and its bound; any impacts, if the time is too short for cheap ones.

    Raises:
        Infeasible: no such impacts.
        SolverFailed: out of time.
    """
    grid, choices = task.build(size, delta)
    for word in forbidden:
        _forbid(grid, word)
    if task.segments is not None:
        grid.model.objective = sum((hit for hits in grid.hits for hit in hits.values()), Affine({}))
        fewest = solve(grid.model, time_limit, solver=task.solver).x
        costs = add_path_cost(grid.model, grid.displacements(), task.options.tangents)
        x = np.concatenate([fewest, np.zeros(len(grid.model.lower) - len(fewest))])
        return _read_events(task, grid, choices, solve_cones(grid.model, x, costs), None)
    costs = add_path_cost(grid.model, grid.displacements(), task.options.tangents)
    try:
        relaxed = solve(grid.model, time_limit, task.options.cost_gap, task.solver)
        found, bound = relaxed.x, max(0.0, relaxed.bound)
    except SolverFailed:
        # Out of time, any impacts that bear the deviation are better than none; no path costs less than nothing.
        found, bound = _find_impacts(task, size, delta, forbidden, time_limit), 0.0
        found = np.concatenate([found, np.zeros(len(grid.model.lower) - len(found))])
    x = _solve_on_steps(task, size, delta, grid, found, costs)
    return _read_events(task, grid, choices, x, bound)


def _find_impacts(
    task: RobustTask, size: GridSize, delta: float, forbidden: Sequence[tuple[str, ...]], time_limit: float
) -> np.ndarray:
    """Return a solution of the grid at any path cost."""
    grid, _ = task.build(size, delta)
    for word in forbidden:
        _forbid(grid, word)
    return solve(grid.model, time_limit, solver=task.solver).x


def _forbid(grid: BoxGrid, word: tuple[str, ...]) -> None:
    pairs = zip(grid.hits, word, strict=True)
    same = [hits[name] if name else 1.0 - sum(hits.values(), Affine({})) for hits, name in pairs]
    grid.model.require(sum(same, Affine({})) - (len(same) - 1.0))


def _solve_on_steps(
    task: RobustTask,
    size: GridSize,
    delta: float,
    grid: BoxGrid,
    x: np.ndarray,
    costs: list[PieceCost],
) -> np.ndarray:
    """Return the point of least cost, for given integers, whose impacts fall on control steps.

    The environment samples there. Rounding would move the boxes out of their areas, so another problem chooses among
    the steps near the best times.
    """
    period = task.scenario.control_period
    times = evaluate(grid.times[grid.pieces : -1 : grid.pieces], solve_cones(grid.model, x, costs))
    stepped, _ = task.build(size, delta)
    model, steps = stepped.model, task.options.steps
    add_path_cost(model, stepped.displacements(), task.options.tangents)
    for i in np.flatnonzero(model.integer):
        model.lower[i] = model.upper[i] = float(round(x[i]))
    for time, step in zip(stepped.times[grid.pieces : -1 : grid.pieces], np.round(times / period), strict=True):
        model.require_equal(time - model.variable(step - steps, step + steps, integer=True) * period)
    try:
        found = solve(model, np.inf, task.options.cost_gap, task.solver).x
    except Infeasible:
        status = f"no impacts on control steps within {steps * period:g} s of the best times"
        raise Infeasible(grid.model.name, status, "shorten the control period") from None
    ends = np.round(np.round(np.cumsum(evaluate(stepped.legs, found)) / period) * period, 9)
    for leg, duration in zip(grid.legs, np.diff(ends, prepend=0.0), strict=True):
        (column,) = leg.coefficients  # type: ignore[union-attr]
        grid.model.lower[column] = grid.model.upper[column] = float(duration)
    return solve_cones(grid.model, x, costs)


def _read_events(task: RobustTask, grid: BoxGrid, choices: Choices, x: np.ndarray, bound: float | None) -> RobustEvents:
    """Return the impacts in numbers, without the boundaries of a constant grid at which nobody hits."""
    legs = evaluate(grid.legs, x)
    times = np.concatenate([[0.0], np.round(np.cumsum(legs), 9)])
    times[-1] = task.scenario.horizon
    boxes = np.array([[evaluate(box.lower, x), evaluate(box.upper, x)] for box in grid.boxes])
    commands = np.array([evaluate(move, x) for move in grid.moves]) / np.diff(times)[1:, None, None]
    hitters = [next((name for name, hit in hits.items() if hit.value(x) > 0.5), "") for hits in grid.hits]
    hit = np.flatnonzero(hitters)
    knots = {name: np.array([evaluate(box.center, x) for box in boxes]) for name, boxes in grid.stands.items()}
    at = np.linspace(0.0, len(legs), grid.count + 1)
    knot_times = np.interp(at, np.arange(len(times)), times)
    sequence = BoxSequence(
        times=times[[0, *(hit + 1), -1]],
        object=grid.object,
        hitters=tuple(hitters[k] for k in hit),
        boxes=boxes[[0, *(hit + 1), -1]],
        commands=commands[hit],
        knot_times=knot_times,
        knots=knots,
        delta=float(evaluate(grid.delta, x)),
        points=task.conditions.points,
    )
    sequence = tighten(sequence)
    tube = _read_tube(times, boxes, grid, x) if grid.velocities else make_tube(sequence)
    needs = choices.read(x, knot_times)
    return RobustEvents(sequence, needs, tube, compute_robust_cost(sequence), bound, tuple(hitters))


def _read_tube(times: np.ndarray, boxes: np.ndarray, grid: BoxGrid, x: np.ndarray) -> Tube:
    """Return the boxes of a constant grid, one segment between each two boundaries."""
    velocities = np.array([[evaluate(box.lower, x), evaluate(box.upper, x)] for box in grid.velocities])
    ends = [np.concatenate([part, velocities], axis=2) for part in (boxes[:-1], boxes[1:])]
    states = [np.stack([part.mean(axis=1), 0.5 * (part[:, 1] - part[:, 0])], axis=1) for part in ends]
    return Tube(times, *(np.stack([part[:, 0], np.maximum(part[:, 1], 0.0)], axis=1) for part in states))


def compute_robust_cost(sequence: BoxSequence) -> float:
    """Return J = sum over legs and axes of D^2 / T of all bodies, the object in the centres of its boxes [m^2/s].

    Args:
        sequence: tight impacts.
    """
    total = measure_path_cost(sequence.centers, sequence.times)
    return float(sum((measure_path_cost(knots, sequence.knot_times) for knots in sequence.knots.values()), total))
