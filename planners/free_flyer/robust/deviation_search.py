"""Search for the greatest deviation: a mixed-integer problem for every deviation tried, linear ones in between."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from impact_envs.stl import Always, And, Predicate
from planners.budget import read_clock
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.robust.task import RobustTask
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import Demands, Requirement
from planners.mixed_integer import Model, evaluate
from planners.solvers import solve


@dataclass(frozen=True)
class DeviationOptimum:
    """Hold the result of the search.

    Args:
        size: of the grid that bears most.
        delta: greatest deviation found [m/s].
        bound: proven upper bound of it, over the numbers of impacts allowed; where time ended the search before all of
            them were tried, what no plan with any number can exceed [m/s].
    """

    size: GridSize
    delta: float
    bound: float


def maximise_deviation(task: RobustTask, max_impacts: int, time_limit: float) -> DeviationOptimum:
    """Return the greatest deviation over numbers of impacts; more impacts count only if they bear a fifth more.

    A plan for a deviation bears every smaller one, so one deviation that is proven infeasible bounds all above it.
    Numbers of impacts are compared roughly; once one has a plan, the others share a quarter of the time limit. Then
    the best is searched closely. The search ends early where a fifth more would exceed what no plan with any number
    of impacts can bear: its last leg alone spreads the object by the gap times the deviation. On a constant grid the
    deviation is a variable of one mixed-integer problem.

    Args:
        task: what is asked.
        max_impacts: greatest number of impacts tried.
        time_limit: wall time [s].

    Returns:
        The optimum.

    Raises:
        Infeasible: proven that not even the smallest deviation that counts is borne.
        SolverFailed: out of time.
    """
    start, options = read_clock(), task.options.deviation
    if task.segments is not None:
        return _solve_grid(task, task.segments, time_limit)
    ceiling = compute_ceiling(task)
    for pieces, passing in options.families:
        best: DeviationOptimum | None = None
        bounds: dict[GridSize, float] = {}
        untried = 0.0
        for impacts in range(1, max_impacts + 1):
            size, wanted = GridSize(impacts, pieces, passing), best.delta * (1.0 + options.worth) if best else 0.0
            if wanted >= ceiling:
                break
            left = (0.25 if best else 1.0) * time_limit - (read_clock() - start)
            try:
                delta, bounds[size] = search_deviation(task, size, wanted, ceiling, options.rough_gap, left)
            except SolverFailed:
                if best is None:
                    raise
                untried = ceiling
                break
            if delta > wanted:
                best = DeviationOptimum(size, delta, bounds[size])
        if best is not None:
            left = time_limit - (read_clock() - start)
            with suppress(SolverFailed):
                delta, bound = search_deviation(task, best.size, best.delta, best.bound, options.gap, left)
                bounds[best.size] = bound
                best = DeviationOptimum(best.size, delta, bound)
            return replace(best, bound=max(untried, *bounds.values()))
    status = f"proven that no plan with up to {max_impacts} impacts bears a deviation of {options.smallest:g} m/s"
    raise Infeasible(f"plan of {task.scenario.name}", status, "allow more impacts or time, or relax the formula")


def search_deviation(
    task: RobustTask, size: GridSize, known: float, high: float, gap: float, time_limit: float
) -> tuple[float, float]:
    """Return the greatest deviation of one size of grid and its proven bound.

    If a deviation is feasible, its integers are fixed and the best deviation for them is bisected in linear problems.
    The next one tried is by the gap above that: the search ends when it is infeasible. Proofs are what takes time, so
    none is made of a deviation that the last one will cover.

    Args:
        task: what is asked.
        size: of the grid.
        known: deviation to exceed [m/s].
        high: known upper bound [m/s].
        gap: to which the deviation is proven, relative.
        time_limit: wall time [s].

    Returns:
        The deviation, which is `known` if the size bears no more, and its bound [m/s].

    Raises:
        SolverFailed: out of time before anything was found.
    """
    start = read_clock()
    low, options = known, task.options.deviation
    target = min(known * (1.0 + options.gap) or options.smallest, high)
    while True:
        try:
            grid, _ = task.build(size, target)
            x = solve(grid.model, time_limit - (read_clock() - start), solver=task.solver).x
        except Infeasible:
            high = target
        except SolverFailed:
            if low == known:
                raise
            return low, high
        else:
            low = _improve(task, size, x, target, high)
        if low == 0.0 or high <= low * (1.0 + gap) + 1e-12:
            return low, high
        target = min(low * (1.0 + gap), high)


def _improve(task: RobustTask, size: GridSize, x: np.ndarray, low: float, high: float) -> float:
    """Return the greatest deviation, to half the finest gap, that the same integers bear."""
    while high - low > 0.5 * task.options.deviation.gap * low:
        middle = 0.5 * (low + high)
        try:
            solve(_fix_integers(task.build(size, middle)[0].model, x), np.inf, solver=task.solver)
            low = middle
        except Infeasible:
            high = middle
    return low


def _fix_integers(model: Model, x: np.ndarray) -> Model:
    for i in np.flatnonzero(model.integer):
        model.lower[i] = model.upper[i] = float(round(x[i]))
        model.integer[i] = False
    return model


def compute_ceiling(task: RobustTask) -> float:
    """Return a deviation that no plan with any number of impacts can exceed.

    After the last impact the deviation spreads the place of the object by at least the gap times itself, and its
    velocity by itself.

    Args:
        task: what is asked.

    Returns:
        Upper bound of the deviation [m/s].
    """
    scenario, conditions = task.scenario, task.conditions
    name, body = next(iter(scenario.objects.items()))
    model = Model(f"ceiling of {scenario.name}")
    fastest = min(conditions.final_velocity, body.speed_limit) if body.rest else body.speed_limit
    delta = model.variable(0.0, fastest)
    center = model.vector(np.array(scenario.world.lower), np.array(scenario.world.upper))
    for need in _list_last_stays(task.demands, name, scenario.horizon):
        for face, bound in zip(need.faces, need.bounds, strict=True):
            model.require(face @ center + delta * (conditions.gap * float(np.abs(face).sum())) - bound)
    model.objective = -delta
    return -solve(model, np.inf, solver=task.solver).objective


def _list_last_stays(demands: Demands, name: str, horizon: float) -> Iterator[Requirement]:
    """Yield the areas in which the formula holds an object at the horizon."""
    for formula in demands.conjuncts.values():
        parts = [(formula, 0.0)]
        while parts:
            part, end = parts.pop()
            if isinstance(part, Always):
                parts.append((part.child, end + part.interval[1]))
            elif isinstance(part, And):
                parts += [(child, end) for child in part.operands]
            elif isinstance(part, Predicate) and end >= horizon:
                need = demands.predicates[part]
                if need.kind == "stay" and need.bodies == (name,):
                    yield need


def _solve_grid(task: RobustTask, segments: int, time_limit: float) -> DeviationOptimum:
    size = GridSize(segments - 1)
    grid, _ = task.build(size, None)
    solution = solve(grid.model, time_limit, solver=task.solver)
    delta = float(evaluate(grid.delta, solution.x))
    return DeviationOptimum(size, delta, max(delta, -solution.bound))
