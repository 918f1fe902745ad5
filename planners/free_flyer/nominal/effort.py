"""Stage B: the events of least effort at a given robustness."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.cones import solve_cones
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.event_grid import EventGrid, build_event_grid
from planners.free_flyer.nominal.event_sequence import EventSequence, Word, own_events
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.formula_rows import add_demands
from planners.free_flyer.specification.requirement import Demands, Requirement
from planners.free_flyer.specification.selection import Choices
from planners.mixed_integer import Affine, Model, evaluate
from planners.solvers import compute_lower_bound, solve

TANGENTS = 12  # perspective cuts per sign
RELATIVE_GAP = 0.01
COARSE_GAP = 0.05
WEIGHTS = (1.0, 3.0, 10.0)  # of objects' effort while flights are still bent; the first one that lets them straighten
Share = tuple[str, Affine, Affine, Affine]  # body, effort e >= D^2 / T, move D, duration T of a piece along an axis
ROUNDS = 4  # of outer approximation, at most
# Reach areas at events only; keep the reserve from areas to avoid. In the order they are given up.
WISHES = ((True, True), (True, False), (False, True), (False, False))
QUICK_WISHES, QUICK_WEIGHTS = (WISHES[0], WISHES[-1]), WEIGHTS[1:2]


@dataclass(frozen=True)
class EffortOptimum:
    """Hold the events of least effort.

    Args:
        sequence: the events.
        needs: what the formula demands of them, with the choices it leaves made.
        effort: J of the sequence [m^2/s].
        bound: proven lower bound of J [m^2/s].
    """

    sequence: EventSequence
    needs: tuple[Requirement, ...]
    effort: float
    bound: float


def minimise_effort(
    scenario: FreeFlyerScenario,
    demands: Demands,
    shape: tuple[int, int],
    rho: float,
    reserves: Reserves,
    forbidden: Sequence[Word],
    time_limit: float,
    word: Word | None = None,
    solver: str = "highs",
    gap: float = RELATIVE_GAP,
    rounds: int = ROUNDS,
    thorough: bool = True,
) -> EffortOptimum:
    r"""Return the events of least effort that keep a robustness.

    J = sum over legs and axes of D^2 / T; D^2 / T >= 2 q D - q^2 T for every q is linear in (D, T). The
    integers of this relaxation go into the exact second-order cone program. Areas are reached at events,
    where the execution aims, and avoided with a reserve, wherever the robustness leaves room for it.

    Args:
        scenario: what to plan.
        demands: its demands.
        shape: number of impacts, and of pieces per leg.
        rho: robustness to keep [m].
        reserves: what the plan keeps in hand.
        forbidden: words that are excluded.
        time_limit: of each mixed-integer solution, and of them all if not thorough [s].
        word: who hits what; open without.
        solver: of mixed-integer models.
        gap: to which the least effort is proven.
        rounds: of outer approximation, at most.
        thorough: whether all wishes and weights are gone through.

    Returns:
        The events, their effort and its bound under these wishes.

    Raises:
        Infeasible: no such events.
        SolverFailed: out of time.
    """
    failure: Infeasible | None = None
    deadline = np.inf if thorough else time.perf_counter() + time_limit
    wishes, weights = (WISHES, WEIGHTS) if thorough else (QUICK_WISHES, QUICK_WEIGHTS)
    for wish, weight in itertools.product(wishes, weights if len(scenario.objects) > 1 else WEIGHTS[:1]):
        try:
            problem = build_effort_problem(
                scenario, demands, shape, rho, reserves, time_limit, wish, word, solver, forbidden, rounds=rounds
            )
            problem.deadline = deadline
            return problem.solve(weight, gap)
        except Infeasible as error:
            failure = error
    assert failure is not None
    raise failure


def build_effort_problem(
    scenario: FreeFlyerScenario,
    demands: Demands,
    shape: tuple[int, int],
    rho: float,
    reserves: Reserves,
    time_limit: float,
    wish: tuple[bool, bool],
    word: Word | None = None,
    solver: str = "highs",
    forbidden: Sequence[Word] = (),
    tangents: int = TANGENTS,
    rounds: int = ROUNDS,
) -> EffortProblem:
    """Build the problem of the events of least effort that keep a robustness.

    Args:
        scenario: what to plan.
        demands: its demands.
        shape: number of impacts, and of pieces per leg.
        rho: robustness to keep [m].
        reserves: what the plan keeps in hand.
        time_limit: of each mixed-integer solution [s].
        wish: one of `WISHES`.
        word: who hits what; open without.
        solver: of mixed-integer models.
        forbidden: words that are excluded.
        tangents: at first, per sign.
        rounds: of outer approximation, at most.

    Raises:
        Infeasible: the variable bounds alone exclude every such plan.
    """
    at_events, far = wish
    grid = build_event_grid(scenario, shape[0], (rho - 1e-9, rho), reserves, shape[1], word)
    choices = add_demands(
        grid, demands, scenario.control_period, passing=not at_events, reserve=reserves.avoid if far else 0.0
    )
    shares = _add_effort(grid, tangents)
    for excluded in forbidden:
        same = [grid.hits[k][pair] for k, pair in enumerate(excluded)]
        grid.model.require(sum(same, Affine({})) - (len(same) - 1.0))
    return EffortProblem(scenario, grid, choices, shares, reserves, time_limit, solver, rounds)


@dataclass(eq=False)
class EffortProblem:
    """Hold a grid with its effort as tangent planes, of which solutions add more.

    Args:
        scenario: what to plan.
        grid: gets distances where they are needed.
        choices: that the formula leaves.
        shares: of the effort.
        reserves: what the plan keeps in hand.
        time_limit: of each mixed-integer solution [s].
        solver: of mixed-integer models.
        rounds: of outer approximation, at most.
        deadline: of `time.perf_counter` for all of them [s].
        bound: of the effort, proven so far [m^2/s].
    """

    scenario: FreeFlyerScenario
    grid: EventGrid
    choices: Choices
    shares: list[Share]
    reserves: Reserves
    time_limit: float
    solver: str
    rounds: int
    deadline: float = np.inf
    bound: float = 0.0

    def relax(self, nodes: int = 0) -> tuple[float, np.ndarray | None]:
        """Return a lower bound of the effort, without the distances not added yet (see `compute_lower_bound`)."""
        return compute_lower_bound(self.grid.model, self._find_left(), nodes, self.solver)

    def _find_left(self) -> float:
        """Return the time left for a solution [s]."""
        left = self.deadline - time.perf_counter()
        if left <= 0.0:
            raise SolverFailed(self.grid.model.name, "time limit reached", "raise the time limit")
        return min(self.time_limit, left)

    def solve(self, weight: float = 1.0, gap: float = RELATIVE_GAP) -> EffortOptimum:
        """Return the best of some rounds of outer approximation, each of which tightens the bound.

        Args:
            weight: of the objects' effort where several objects' flights have to be straightened.
            gap: to which the least effort is proven.

        Raises:
            Infeasible: no such events.
            SolverFailed: out of time.
        """
        if len(self.grid.objects) > 1:
            self._straighten(weight)
        best, effort = None, np.inf
        for _ in range(self.rounds):
            x = solve_apart(self.grid, self.scenario, self.reserves, partial(self._solve_round, gap))
            found = _compute_effort(self.shares, x)
            if found < effort - 1e-9:
                best, effort = x, found
            if effort - self.bound <= gap * effort:
                break
            self._add_tangents(x)
        assert best is not None
        return read_events(self.scenario, self.grid, self.choices, best, self.bound)

    def _solve_round(self, gap: float) -> np.ndarray:
        relaxed = solve(self.grid.model, self._find_left(), gap / 2, self.solver)
        self.bound = max(self.bound, relaxed.bound)
        self._relaxed = relaxed.x
        return solve_cones(self.grid.model, relaxed.x, [share for _, *share in self.shares])

    def _straighten(self, weight: float) -> None:
        """Keep objects straight and uniform between their own events, in the word of the best point without that.

        Where another object's event divides a flight, the shares of time and way before it are both what that point
        has: rows are then linear, and all times and places stay free. Weighing the objects' effort more makes that
        point nearly straight itself. The bound holds for these shares only.
        """
        grid, model = self.grid, self.grid.model
        effort = model.objective
        weights = [weight if name in grid.objects else 1.0 for name, *_ in self.shares]
        model.objective = sum((share * w for (_, share, *_), w in zip(self.shares, weights, strict=True)), Affine({}))
        x = solve_apart(
            grid, self.scenario, self.reserves, lambda: solve(model, self._find_left(), COARSE_GAP, self.solver).x
        )
        model.objective = effort
        for hits in grid.hits:
            for hit in hits.values():
                _fix(model, hit, round(float(evaluate(hit, x))))
        times, word = grid.times[:: grid.pieces], read_word(grid, x)
        moments = evaluate(times, x)
        for name in grid.objects:
            path = np.array(grid.path(name), dtype=object)
            own = own_events(word, name)
            # Up to its first own event, one that moves at the start is on its ray.
            for a, b in itertools.pairwise(own[1:] if name in grid.moving else own):
                for k in range(a + 1, b):
                    share = (moments[k] - moments[a]) / (moments[b] - moments[a])
                    for values in (path[:, 0], path[:, 1], times):
                        miss = values[k] - values[a] - (values[b] - values[a]) * share
                        if isinstance(miss, Affine):
                            model.require_equal(miss)

    def _add_tangents(self, x: np.ndarray) -> None:
        """Add the tangent planes at a point and at the relaxed one, and their mirror images."""
        for _, effort, move, duration in self.shares:
            speeds = {round(abs(move.value(point)) / duration.value(point), 6) for point in (x, self._relaxed)}
            for speed in speeds - {0.0}:
                for slope in (speed, -speed):
                    self.grid.model.require(move * (2 * slope) - duration * slope**2 - effort)


def _add_effort(grid: EventGrid, tangents: int) -> list[Share]:
    """Add e >= D^2 / T for every moving piece and axis as tangent planes; the objective is the sum of e."""
    shares = []
    total = Affine({})
    for name, knots in grid.knots.items():
        # An object's pieces share one velocity, so its legs count whole.
        stride = grid.pieces if name in grid.objects else 1
        for start in range(0, grid.count, stride):
            fastest = grid.fastest(name, start)
            duration = grid.times[start + stride] - grid.times[start] + Affine({})
            for step in knots[start + stride] - knots[start] if fastest > 0.0 else ():
                move = step + Affine({})
                effort = grid.model.variable(0.0, fastest**2 * grid.model.limits(duration)[1])
                for q in fastest * np.arange(1, tangents + 1) / tangents:
                    for slope in (q, -q):
                        grid.model.require(move * (2 * slope) - duration * slope**2 - effort)
                shares.append((name, effort, move, duration))
                total = total + effort
    grid.model.objective = total
    return shares


def read_events(
    scenario: FreeFlyerScenario, grid: EventGrid, choices: Choices, x: np.ndarray, bound: float = 0.0
) -> EffortOptimum:
    """Return the events of a point of the grid's model.

    Args:
        scenario: what is planned.
        grid: meaning of the point.
        choices: that the formula leaves.
        x: the point, shape (n,).
        bound: proven lower bound of the effort [m^2/s].
    """
    sequence = _read_sequence(scenario, grid, x)
    needs = choices.read(x, sequence.knot_times(grid.count + 1))
    return EffortOptimum(sequence, needs, _measure_effort(sequence), bound)


def _read_sequence(scenario: FreeFlyerScenario, grid: EventGrid, x: np.ndarray) -> EventSequence:
    """Return the events, with impact times on control steps and knots on micrometres.

    An area reached at an impact is then reached at a sample of the environment, and points that the
    optimal robustness leaves no freedom are met exactly. The first impact of an object that moves at the start keeps
    its time, for the place depends on it.
    """
    period, word = scenario.control_period, read_word(grid, x)
    times = evaluate(grid.times, x)[:: grid.pieces]
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
    return EventSequence(times, paths, {name: knots[name] for name in scenario.robots}, word)


def read_word(grid: EventGrid, x: np.ndarray) -> Word:
    """Return who hits what at a point of the grid's model, shape (n,)."""
    return tuple(max(hits, key=lambda pair: float(evaluate(hits[pair], x))) for hits in grid.hits)


def _fix(model: Model, variable: Affine | float, value: float) -> None:
    """Set both bounds of a variable."""
    if isinstance(variable, Affine):
        (index,) = variable.coefficients
        model.lower[index] = model.upper[index] = value


def _compute_effort(shares: Sequence[Share], x: np.ndarray) -> float:
    return sum(move.value(x) ** 2 / duration.value(x) for *_, move, duration in shares)


def _measure_effort(sequence: EventSequence) -> float:
    bodies = [*sequence.paths.values(), *sequence.knots.values()]
    durations = [np.diff(sequence.knot_times(len(knots)))[:, None] for knots in bodies]
    moves = [np.diff(knots, axis=0) for knots in bodies]
    return float(sum(np.sum(move**2 / spans) for move, spans in zip(moves, durations, strict=True)))
