"""Search for the greatest deviation: a mixed-integer problem for every number tried, convex ones in between."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Always, And, Predicate
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.box_grid import Conditions, HullGrid, build_hull_grid
from planners.free_flyer.robust.side_rows import add_side_rows
from planners.free_flyer.robust.zonotope_grid import build_zonotope_grid
from planners.free_flyer.specification.formula_rows import add_demands
from planners.free_flyer.specification.requirement import Demands, Requirement
from planners.free_flyer.specification.selection import Choices
from planners.mixed_integer import Model, evaluate
from planners.solvers import solve

TOLERANCE = 2e-3  # of the greatest deviation, relative
ROUGH = 0.1  # the same while numbers of impacts are compared
WORTH = 0.2  # what more impacts have to bring, relative
SMALLEST = 1e-4  # deviation that counts [m/s]
FAMILIES = ((1, False), (2, True))  # pieces per leg, and whether areas may be reached between impacts


@dataclass(frozen=True)
class RobustTask:
    """Hold what is asked of a plan that bears deviations.

    Args:
        scenario: one object, any number of robots.
        demands: of the formula and of solid obstacles.
        conditions: what a deviation refers to.
        reserves: what the plan keeps in hand.
        segments: number of segments of the paper's constant grid; None: times of impacts are free.
        solver: of mixed-integer models.
    """

    scenario: FreeFlyerScenario
    demands: Demands
    conditions: Conditions
    reserves: Reserves
    segments: int | None = None
    solver: str = "highs"

    def build(self, shape: Shape, delta: float | None) -> HullGrid:
        """Return the model of plans of a shape for a deviation [m/s], formula included.

        Raises:
            Infeasible: the variable bounds alone exclude every plan.
        """
        return self.build_choices(shape, delta)[0]

    def build_choices(self, shape: Shape, delta: float | None) -> tuple[HullGrid, Choices]:
        """Return the model, and what reads from its solutions how the formula holds in them."""
        scenario, conditions, reserves = self.scenario, self.conditions, self.reserves
        if self.segments is not None:
            grid = build_zonotope_grid(scenario, self.segments, delta, conditions, reserves)
        else:
            assert delta is not None
            grid = build_hull_grid(scenario, shape.impacts, delta, conditions, reserves, shape.pieces)
        if not conditions.points:
            add_side_rows(grid, scenario, reserves)
        return grid, add_demands(grid, self.demands, scenario.control_period, shape.passing)


@dataclass(frozen=True)
class Shape:
    """Hold the size of a grid.

    Args:
        impacts: number of impacts; of a constant grid, of boundaries.
        pieces: number of pieces per leg.
        passing: whether areas may be reached between impacts.
    """

    impacts: int
    pieces: int = 1
    passing: bool = False


@dataclass(frozen=True)
class DeviationOptimum:
    """Hold the result of the search.

    Args:
        shape: of the grid that bears most.
        delta: greatest deviation found [m/s].
        bound: proven upper bound of it, over the numbers of impacts tried [m/s].
    """

    shape: Shape
    delta: float
    bound: float


def maximise_deviation(task: RobustTask, max_impacts: int, time_limit: float) -> DeviationOptimum:
    """Return the greatest deviation over numbers of impacts, where more impacts have to bring a fifth more.

    What bears a deviation bears every smaller one, so one deviation proven infeasible bounds all above it.
    Numbers of impacts are compared roughly, those beyond the first that serves in a quarter of the time limit;
    then the best is bisected. The search ends early where a fifth more would exceed what no plan with any number of
    impacts can bear: its last leg alone spreads the object by the gap times the deviation. On a constant grid the
    deviation is a variable of one mixed-integer problem.

    Args:
        task: what is asked.
        max_impacts: greatest number of impacts tried.
        time_limit: wall time [s].

    Returns:
        The optimum.

    Raises:
        Infeasible: proven that no deviation of `SMALLEST` is borne.
        SolverFailed: out of time.
    """
    start = time.perf_counter()
    if task.segments is not None:
        return _solve_grid(task, task.segments, time_limit)
    ceiling = compute_ceiling(task)
    for pieces, passing in FAMILIES:
        best: DeviationOptimum | None = None
        bounds: dict[Shape, float] = {}
        for impacts in range(1, max_impacts + 1):
            shape, wanted = Shape(impacts, pieces, passing), best.delta * (1.0 + WORTH) if best else 0.0
            if wanted >= ceiling:
                break
            left = (0.25 if best else 1.0) * time_limit - (time.perf_counter() - start)
            try:
                delta, bounds[shape] = search_deviation(task, shape, wanted, ceiling, ROUGH, left)
            except SolverFailed:
                if best is None:
                    raise
                break
            if delta > wanted:
                best = DeviationOptimum(shape, delta, bounds[shape])
        if best is not None:
            left = time_limit - (time.perf_counter() - start)
            with suppress(SolverFailed):
                delta, bounds[best.shape] = search_deviation(task, best.shape, best.delta, best.bound, TOLERANCE, left)
                best = DeviationOptimum(best.shape, delta, bounds[best.shape])
            return replace(best, bound=max(bounds.values()))
    status = f"proven that no plan with up to {max_impacts} impacts bears a deviation of {SMALLEST:g} m/s"
    raise Infeasible(f"plan of {task.scenario.name}", status, "allow more impacts or time, or relax the formula")


def search_deviation(
    task: RobustTask, shape: Shape, known: float, high: float, tolerance: float, time_limit: float
) -> tuple[float, float]:
    """Return the greatest deviation of one shape and its proven bound, by bisection.

    Where a number is feasible, the integers found are kept and the best deviation for them is bisected in
    linear problems. Numbers just above the best known and halfway to the bound take turns: the first end the
    search once they are infeasible.

    Args:
        task: what is asked.
        shape: of the grid.
        known: deviation beyond which to look [m/s].
        high: known upper bound [m/s].
        tolerance: relative.
        time_limit: wall time [s].

    Returns:
        The deviation, `known` if the shape brings nothing, and its bound [m/s].

    Raises:
        SolverFailed: out of time before anything was found.
    """
    start = time.perf_counter()
    low, near = known, True
    target = min(known * (1.0 + TOLERANCE) or SMALLEST, high)
    while True:
        try:
            grid = task.build(shape, target)
            x = solve(grid.model, time_limit - (time.perf_counter() - start), solver=task.solver).x
        except Infeasible:
            high = target
        except SolverFailed:
            if low == known:
                raise
            return low, high
        else:
            low = _improve(task, shape, x, target, high, tolerance)
        if low == 0.0 or high <= low * (1.0 + tolerance) + 1e-12:
            return low, high
        near = not near
        target = min(low * (1.0 + tolerance), high) if near else 0.5 * (low + high)


def _improve(task: RobustTask, shape: Shape, x: np.ndarray, low: float, high: float, tolerance: float) -> float:
    """Return the greatest deviation, up to half the tolerance, that the same integers bear."""
    while high - low > 0.5 * tolerance * low:
        middle = 0.5 * (low + high)
        try:
            solve(_fix_integers(task.build(shape, middle).model, x), np.inf, solver=task.solver)
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

    After the last impact the object spreads by gap times the deviation at least, and its velocity by the
    deviation.

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
    """Return the areas that conjuncts of the formula hold an object in at the horizon."""
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
    shape = Shape(segments - 1)
    grid = task.build(shape, None)
    solution = solve(grid.model, time_limit, solver=task.solver)
    delta = float(evaluate(grid.delta, solution.x))
    return DeviationOptimum(shape, delta, max(delta, -solution.bound))
