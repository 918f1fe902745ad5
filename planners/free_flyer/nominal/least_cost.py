"""Stage B: the events of least path cost at a given robustness."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.budget import read_clock
from planners.cones import solve_cones
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.event_grid import EventGrid
from planners.free_flyer.nominal.event_sequence import EventSequence, Word, own_events
from planners.free_flyer.nominal.task import CostOptions, NominalTask, Wish
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import Requirement
from planners.free_flyer.specification.selection import Choices
from planners.mixed_integer import Affine, Model, Solution, evaluate
from planners.path_cost import PieceCost, add_path_cost, compute_path_cost, measure_path_cost
from planners.solvers import compute_lower_bound, solve

NOISE = 1e-9  # of robustness [m] and costs [m^2/s]


@dataclass(frozen=True)
class CostOptimum:
    """Hold the events of least path cost.

    Args:
        sequence: the events.
        needs: what the formula demands of them; its alternatives are chosen.
        cost: J of the sequence [m^2/s].
        bound: proven lower bound of J [m^2/s].
    """

    sequence: EventSequence
    needs: tuple[Requirement, ...]
    cost: float
    bound: float


def minimise_path_cost(
    task: NominalTask,
    size: GridSize,
    rho: float,
    options: CostOptions,
    time_limit: float,
    word: Word | None = None,
    forbidden: Sequence[Word] = (),
) -> CostOptimum:
    r"""Return the events of least path cost that keep a robustness.

    J = sum over legs and axes of D^2 / T; D^2 / T >= 2 q D - q^2 T for every q is linear in (D, T). The
    integers of this relaxation go into the exact second-order cone program. Areas are reached at events,
    where the execution aims, and avoided with a reserve, wherever the robustness leaves room for it.

    Args:
        task: what is asked.
        size: of the grid; wishes decide about passing.
        rho: robustness to keep [m].
        options: how closely the least cost is approached.
        time_limit: of all mixed-integer solutions together [s].
        word: who hits what; None: anybody anything.
        forbidden: words that are excluded.

    Returns:
        The events, their cost and its bound under the wishes that could be kept.

    Raises:
        Infeasible: no such events.
        SolverFailed: out of time.
    """
    failure: PlanningError | None = None
    deadline = read_clock() + time_limit
    weights = options.weights if len(task.scenario.objects) > 1 else options.weights[:1]
    for wish, weight in itertools.product(options.wishes, weights):
        left = deadline - read_clock()
        if failure is not None and left <= 0.0:
            break
        # One wish that takes long leaves half of the time to the next one.
        limit = time_limit if options.together else 0.5 * left
        try:
            problem = build_cost_problem(task, size, rho, wish, options, limit, word, forbidden)
            problem.deadline = deadline if options.together else read_clock() + limit
            return problem.solve(weight, options.gap)
        except Infeasible as error:
            failure = error
        except SolverFailed as error:
            if options.together:
                raise
            failure = failure or error
    assert failure is not None
    raise failure


def build_cost_problem(
    task: NominalTask,
    size: GridSize,
    rho: float,
    wish: Wish,
    options: CostOptions,
    time_limit: float,
    word: Word | None = None,
    forbidden: Sequence[Word] = (),
) -> CostProblem:
    """Build the problem of the events of least path cost that keep a robustness.

    Args:
        task, size, rho, options, word, forbidden: as for `minimise_path_cost`.
        wish: what the plan should do for its execution.
        time_limit: of each mixed-integer solution [s].

    Raises:
        Infeasible: the variable bounds alone exclude every such plan.
    """
    size = replace(size, passing=not wish.at_events)
    grid, choices = task.build(size, (rho - NOISE, rho), word, task.reserves.avoid if wish.far else 0.0)
    costs = add_path_cost(grid.model, grid.displacements(), options.tangents)
    for excluded in forbidden:
        same = [grid.hits[k][pair] for k, pair in enumerate(excluded)]
        grid.model.require(sum(same, Affine({})) - (len(same) - 1.0))
    return CostProblem(task, grid, choices, costs, time_limit, options)


@dataclass(eq=False)
class CostProblem:
    """Hold a grid whose objective is the path cost as tangent planes, of which solutions add more.

    Args:
        task: what is asked.
        grid: gets rows for distances where solutions need them.
        choices: alternatives of the formula.
        costs: of all pieces.
        time_limit: of each mixed-integer solution [s].
        options: how closely the least cost is approached.
        deadline: of the clock of limits, for all of them [s].
        bound: of the cost, proven so far [m^2/s].
        nodes: of branch and bound in each solution; None: any number.
        pauses: of the solver in each solution, which is then given up if it is not proven; None: any number.
    """

    task: NominalTask
    grid: EventGrid
    choices: Choices
    costs: list[PieceCost]
    time_limit: float
    options: CostOptions
    deadline: float = np.inf
    bound: float = 0.0
    nodes: int | None = None
    pauses: int | None = None

    def relax(self, nodes: int = 0) -> tuple[float, np.ndarray | None]:
        """Return a lower bound of the cost from the rows added so far, see `compute_lower_bound`."""
        return compute_lower_bound(self.grid.model, self._find_time_left(), nodes, self.task.solver, self.task.work)

    def solve(self, weight: float, gap: float) -> CostOptimum:
        """Return the best of some rounds of outer approximation, each of which tightens the bound.

        Args:
            weight: of the objects' costs where several objects' flights have to be straightened.
            gap: to which the least cost is proven, relative.

        Raises:
            Infeasible: no such events.
            SolverFailed: out of time.
        """
        if len(self.grid.objects) > 1:
            self._straighten_flights(weight)
        best, least = None, np.inf
        for _ in range(self.options.rounds):
            try:
                x, relaxed = self._solve_round(gap)
            except SolverFailed:
                if best is None:
                    raise
                break  # out of time for a closer approximation
            found = compute_path_cost(self.costs, x)
            if found < least - NOISE:
                best, least = x, found
            if least - self.bound <= gap * least:
                break
            self._add_tangents(x, relaxed)
        assert best is not None
        return read_events(self.task, self.grid, self.choices, best, self.bound)

    def _find_time_left(self) -> float:
        """Return the time left for a solution [s]."""
        left = self.deadline - read_clock()
        if left <= 0.0:
            raise SolverFailed(self.grid.model.name, "time limit reached", "raise the time limit")
        return min(self.time_limit, left)

    def _solve_model(self, gap: float) -> Solution:
        """Return the solution of the grid's model; where pauses are limited, only a proven one.

        Raises:
            Infeasible: there is none.
            SolverFailed: the limits do not suffice.
        """
        task, limit = self.task, self._find_time_left()
        found = solve(self.grid.model, limit, gap, task.solver, (), task.work, self.nodes, self.pauses)
        if self.pauses is not None and found.objective - found.bound > 1.01 * gap * abs(found.objective) + NOISE:
            raise SolverFailed(self.grid.model.name, "its least cost is not proven", "raise the limits")
        return found

    def _solve_round(self, gap: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the exact optimum for the integers of the relaxation, and the relaxation's, each shape (n,)."""
        relaxed = np.empty(0)

        def solve_once() -> np.ndarray:
            nonlocal relaxed
            found = self._solve_model(gap / 2)
            self.bound, relaxed = max(self.bound, found.bound), found.x
            return solve_cones(self.grid.model, relaxed, self.costs)

        x = solve_apart(self.grid, self.task.scenario, self.task.reserves, solve_once)
        return x, relaxed

    def _straighten_flights(self, weight: float) -> None:
        """Keep objects straight and uniform between their own events, in the word of the best point without that.

        Where another object's event divides a flight, the shares of time and way before it are both fixed to what that
        point has: then the rows are linear, and all times and places stay free. A greater weight of the objects' costs
        makes that point nearly straight already. The bound holds for these shares only.
        """
        grid, model = self.grid, self.grid.model
        cost = model.objective
        weights = [weight if part.body in grid.objects else 1.0 for part in self.costs]
        model.objective = sum((part.cost * w for part, w in zip(self.costs, weights, strict=True)), Affine({}))

        def solve_bent() -> np.ndarray:
            return self._solve_model(self.options.straightening_gap).x

        x = solve_apart(grid, self.task.scenario, self.task.reserves, solve_bent)
        model.objective = cost
        for hits in grid.hits:
            for hit in hits.values():
                _fix(model, hit, round(float(evaluate(hit, x))))
        for name in grid.objects:
            straighten_flight(grid, name, read_word(grid, x), evaluate(grid.times[:: grid.pieces], x))

    def _add_tangents(self, x: np.ndarray, relaxed: np.ndarray) -> None:
        """Add the tangent planes at a point and at the relaxed one, and their mirror images."""
        for part in self.costs:
            known = [(abs(part.move.value(point)), part.duration.value(point)) for point in (x, relaxed)]
            speeds = {round(move / duration, 6) for move, duration in known if duration > 0.0}
            for speed in speeds - {0.0}:
                part.add_tangents(self.grid.model, speed)


def straighten_flight(grid: EventGrid, name: str, word: Word, moments: np.ndarray, rests: bool = False) -> None:
    """Fix the shares of time and way of an object's legs between its own events.

    Args:
        grid: gets the rows.
        name: of the object.
        word: who hits what.
        moments: of the events, which the shares are taken from, shape (K + 2,) [s].
        rests: whether the object rests before its first and after its last own event, so that nothing is fixed there.
    """
    times = grid.times[:: grid.pieces]
    path, own = np.array(grid.path(name), dtype=object), own_events(word, name)
    # An object that moves at the start is on its ray up to its first own event.
    own = own[1:] if name in grid.moving or rests else own
    for a, b in itertools.pairwise(own[:-1] if rests else own):
        for k in range(a + 1, b):
            share = (moments[k] - moments[a]) / (moments[b] - moments[a])
            for values in (path[:, 0], path[:, 1], times):
                miss = values[k] - values[a] - (values[b] - values[a]) * share
                if isinstance(miss, Affine):
                    grid.model.require_equal(miss)


def read_events(task: NominalTask, grid: EventGrid, choices: Choices, x: np.ndarray, bound: float = 0.0) -> CostOptimum:
    """Return the events of a point of the grid's model.

    Args:
        task: what is asked.
        grid: meaning of the point.
        choices: alternatives of the formula.
        x: the point, shape (n,).
        bound: proven lower bound of the cost [m^2/s].
    """
    sequence = _read_sequence(task, grid, x)
    needs = choices.read(x, sequence.knot_times(grid.count + 1))
    bodies = [*sequence.paths.values(), *sequence.knots.values()]
    cost = sum(measure_path_cost(knots, sequence.knot_times(len(knots))) for knots in bodies)
    return CostOptimum(sequence, needs, float(cost), bound)


def _read_sequence(task: NominalTask, grid: EventGrid, x: np.ndarray) -> EventSequence:
    """Return the events, with impact times on control steps and knots on micrometres.

    An area reached at an impact is then reached at a sample of the environment, and points that the
    optimal robustness leaves no freedom are met exactly. The first impact of an object that moves at the start keeps
    its time, for its place depends on it.
    """
    scenario, word = task.scenario, read_word(grid, x)
    period, times = scenario.control_period, evaluate(grid.times, x)[:: grid.pieces]
    first = {name: own_events(word, name)[1] for name in grid.objects}
    steps = [k for k in range(1, len(times) - 1) if k not in [first[name] for name in grid.moving]]
    times[steps] = np.round(np.round(times[steps] / period) * period, 9)
    knots = {name: np.round(evaluate(points, x), 6) for name, points in grid.knots.items()}
    for name in scenario.bodies:
        knots[name][0] = grid.knots[name][0]
    paths = {name: knots[name][:: grid.pieces] for name in grid.objects}
    for name, last in first.items():
        body = scenario.objects[name]
        paths[name][: last + 1] = np.array(body.start) + times[: last + 1, None] * np.array(body.start_velocity)
    moments = None
    if grid.free:
        moments = evaluate(grid.times, x)
        moments[:: grid.pieces] = times
        moments = np.maximum.accumulate(np.minimum(moments, np.repeat(times, grid.pieces)[grid.pieces - 1 :]))
    return EventSequence(times, paths, {name: knots[name] for name in scenario.robots}, word, moments)


def read_word(grid: EventGrid, x: np.ndarray) -> Word:
    """Return who hits what at a point of the grid's model, shape (n,)."""
    return tuple(max(hits, key=lambda pair: float(evaluate(hits[pair], x))) for hits in grid.hits)


def _fix(model: Model, variable: Affine | float, value: float) -> None:
    """Set both bounds of a variable."""
    if isinstance(variable, Affine):
        (index,) = variable.coefficients
        model.lower[index] = model.upper[index] = value
