"""The impacts of least effort that bear a given deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.cones import solve_cones
from planners.errors import Infeasible
from planners.free_flyer.robust.box_grid import HullGrid
from planners.free_flyer.robust.box_sequence import HullSequence, make_tube, tighten
from planners.free_flyer.robust.deviation_search import RobustTask, Shape
from planners.free_flyer.specification.requirement import Requirement
from planners.free_flyer.specification.selection import Choices
from planners.mixed_integer import Affine, evaluate
from planners.plan import Tube
from planners.solvers import solve

TANGENTS = 12  # perspective cuts per sign
RELATIVE_GAP = 0.05
STEPS = 10  # control steps by which impacts may move to fall on one


@dataclass(frozen=True)
class RobustEvents:
    """Hold the impacts of least effort.

    Args:
        sequence: the impacts, with tight boxes.
        needs: what the formula demands of them, with the choices it leaves made.
        tube: boxes that hold the object.
        effort: J of the motions if nothing deviates [m^2/s].
        bound: proven lower bound of J; None on a constant grid [m^2/s].
        word: robot that hits at every event of the grid; empty where none does.
    """

    sequence: HullSequence
    needs: tuple[Requirement, ...]
    tube: Tube
    effort: float
    bound: float | None
    word: tuple[str, ...]


def minimise_robust_effort(
    task: RobustTask, shape: Shape, delta: float, forbidden: Sequence[tuple[str, ...]], time_limit: float
) -> RobustEvents:
    r"""Return the impacts of least effort that bear a deviation.

    J = sum over legs and axes of D^2 / T between the middles of boxes, as tangent planes
    D^2 / T >= 2 q D - q^2 T in the mixed-integer problem and exactly in the cone program for its integers. On a
    constant grid, which has impacts to spare, the fewest impacts come first.

    Args:
        task: what is asked.
        shape: of the grid.
        delta: deviation to bear [m/s].
        forbidden: words that are excluded.
        time_limit: of the mixed-integer solution [s].

    Returns:
        The impacts, their effort and its bound.

    Raises:
        Infeasible: no such impacts.
        SolverFailed: out of time.
    """
    grid, choices = task.build_choices(shape, delta)
    for word in forbidden:
        _forbid(grid, word)
    if task.segments is not None:
        grid.model.objective = sum((hit for hits in grid.hits for hit in hits.values()), Affine({}))
        fewest = solve(grid.model, time_limit, solver=task.solver).x
        shares = _add_effort(grid)
        x = np.concatenate([fewest, np.zeros(len(grid.model.lower) - len(fewest))])
        return _read_events(task, grid, choices, solve_cones(grid.model, x, shares), None)
    shares = _add_effort(grid)
    relaxed = solve(grid.model, time_limit, RELATIVE_GAP, task.solver)
    x = _solve_on_steps(task, shape, delta, grid, relaxed.x, shares)
    return _read_events(task, grid, choices, x, max(0.0, relaxed.bound))


def _forbid(grid: HullGrid, word: tuple[str, ...]) -> None:
    pairs = zip(grid.hits, word, strict=True)
    same = [hits[name] if name else 1.0 - sum(hits.values(), Affine({})) for hits, name in pairs]
    grid.model.require(sum(same, Affine({})) - (len(same) - 1.0))


def _solve_on_steps(
    task: RobustTask,
    shape: Shape,
    delta: float,
    grid: HullGrid,
    x: np.ndarray,
    shares: list[tuple[Affine, Affine, Affine]],
) -> np.ndarray:
    """Return the point of least effort, given integers, whose impacts fall on control steps.

    The environment samples there. Rounding would move the boxes out of their areas, so the steps next to the best
    times are integers of another problem.
    """
    period = task.scenario.control_period
    times = evaluate(grid.times[grid.pieces : -1 : grid.pieces], solve_cones(grid.model, x, shares))
    stepped = task.build(shape, delta)
    _add_effort(stepped)
    model = stepped.model
    for i in np.flatnonzero(model.integer):
        model.lower[i] = model.upper[i] = float(round(x[i]))
    for time, step in zip(stepped.times[grid.pieces : -1 : grid.pieces], np.round(times / period), strict=True):
        model.require_equal(time - model.variable(step - STEPS, step + STEPS, integer=True) * period)
    try:
        found = solve(model, np.inf, RELATIVE_GAP, task.solver).x
    except Infeasible:
        status = f"no impacts on control steps within {STEPS * period:g} s of the best times"
        raise Infeasible(grid.model.name, status, "shorten the control period") from None
    ends = np.round(np.round(np.cumsum(evaluate(stepped.legs, found)) / period) * period, 9)
    for leg, duration in zip(grid.legs, np.diff(ends, prepend=0.0), strict=True):
        (column,) = leg.coefficients  # type: ignore[union-attr]
        grid.model.lower[column] = grid.model.upper[column] = float(duration)
    return solve_cones(grid.model, x, shares)


def _add_effort(grid: HullGrid) -> list[tuple[Affine, Affine, Affine]]:
    """Add e >= D^2 / T for every moving piece and axis as tangent planes; the objective is the sum of e."""
    shares, total = [], Affine({})
    for name, boxes in {**grid.stands, grid.object: grid.knots[grid.object]}.items():
        # The object's pieces share one velocity, so its legs count whole.
        stride = grid.pieces if name == grid.object else 1
        for start in range(0, grid.count, stride):
            fastest = grid.caps[start // grid.pieces] if name == grid.object else grid.speeds[name]
            duration = grid.duration(start) * float(stride) + Affine({})
            for step in boxes[start + stride].center - boxes[start].center if fastest > 0.0 else ():
                move = step + Affine({})
                effort = grid.model.variable(0.0, fastest**2 * grid.model.limits(duration)[1])
                for q in fastest * np.arange(1, TANGENTS + 1) / TANGENTS:
                    for slope in (q, -q):
                        grid.model.require(move * (2 * slope) - duration * slope**2 - effort)
                shares.append((effort, move, duration))
                total = total + effort
    grid.model.objective = total
    return shares


def _read_events(
    task: RobustTask, grid: HullGrid, choices: Choices, x: np.ndarray, bound: float | None
) -> RobustEvents:
    """Return the impacts in numbers; boundaries of a constant grid at which nobody hits are none."""
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
    sequence = HullSequence(
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
    return RobustEvents(sequence, needs, tube, compute_robust_effort(sequence), bound, tuple(hitters))


def _read_tube(times: np.ndarray, boxes: np.ndarray, grid: HullGrid, x: np.ndarray) -> Tube:
    """Return the boxes of a constant grid, anew at each boundary."""
    velocities = np.array([[evaluate(box.lower, x), evaluate(box.upper, x)] for box in grid.velocities])
    ends = [np.concatenate([part, velocities], axis=2) for part in (boxes[:-1], boxes[1:])]
    states = [np.stack([part.mean(axis=1), 0.5 * (part[:, 1] - part[:, 0])], axis=1) for part in ends]
    return Tube(times, *(np.stack([part[:, 0], np.maximum(part[:, 1], 0.0)], axis=1) for part in states))


def compute_robust_effort(sequence: HullSequence) -> float:
    """Return J = sum over legs and axes of D^2 / T of all bodies, the object in the middles of its boxes [m^2/s].

    Args:
        sequence: tight impacts.
    """
    total = np.sum(np.diff(sequence.centers, axis=0) ** 2 / np.diff(sequence.times)[:, None])
    for knots in sequence.knots.values():
        total += np.sum(np.diff(knots, axis=0) ** 2 / np.diff(sequence.knot_times)[:, None])
    return float(total)
