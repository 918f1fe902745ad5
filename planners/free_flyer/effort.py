"""Stage B: the events of least effort at a given robustness."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.cones import solve_cones
from planners.errors import Infeasible
from planners.free_flyer.clearance_rows import solve_apart
from planners.free_flyer.event_grid import EventGrid, build_event_grid
from planners.free_flyer.events import EventSequence, Word, own_events
from planners.free_flyer.formula_rows import add_requirements
from planners.free_flyer.requirement import Requirement
from planners.free_flyer.reserves import Reserves
from planners.mixed_integer import Affine, Model, evaluate, solve_mixed_integer

TANGENTS = 12  # perspective cuts per sign
RELATIVE_GAP = 0.01
ROUNDS = 4  # of outer approximation, at most
# Reach areas at events only; keep the reserve from areas to avoid. In the order they are given up.
WISHES = ((True, True), (True, False), (False, True), (False, False))


@dataclass(frozen=True)
class EffortOptimum:
    """Hold the events of least effort.

    Args:
        sequence: the events.
        effort: J of the sequence [m^2/s].
        bound: proven lower bound of J [m^2/s].
    """

    sequence: EventSequence
    effort: float
    bound: float


def minimise_effort(
    scenario: FreeFlyerScenario,
    needs: Sequence[Requirement],
    shape: tuple[int, int],
    rho: float,
    reserves: Reserves,
    forbidden: Sequence[Word],
    time_limit: float,
    word: Word | None = None,
) -> EffortOptimum:
    r"""Return the events of least effort that keep a robustness.

    J = sum over legs and axes of D^2 / T; D^2 / T >= 2 q D - q^2 T for every q is linear in (D, T). The
    integers of this relaxation go into the exact second-order cone program. Areas are reached at events,
    where the execution aims, and avoided with a reserve, wherever the robustness leaves room for it.

    Args:
        scenario: what to plan.
        needs: its requirements.
        shape: number of impacts, and of pieces per leg.
        rho: robustness to keep [m].
        reserves: what the plan keeps in hand.
        forbidden: words that are excluded.
        time_limit: of each mixed-integer solution [s].
        word: who hits what; open without.

    Returns:
        The events, their effort and its bound under these wishes.

    Raises:
        Infeasible: no such events.
        SolverFailed: out of time.
    """
    failure: Infeasible | None = None
    for wish in WISHES:
        try:
            grid = build_effort_grid(scenario, needs, shape, rho, reserves, wish, word)
            return _EffortProblem(scenario, grid, reserves, forbidden, time_limit).solve()
        except Infeasible as error:
            failure = error
    assert failure is not None
    raise failure


def build_effort_grid(
    scenario: FreeFlyerScenario,
    needs: Sequence[Requirement],
    shape: tuple[int, int],
    rho: float,
    reserves: Reserves,
    wish: tuple[bool, bool],
    word: Word | None = None,
) -> EventGrid:
    """Build the grid of all events that keep a robustness, without effort.

    Args:
        scenario: what to plan.
        needs: its requirements.
        shape: number of impacts, and of pieces per leg.
        rho: robustness to keep [m].
        reserves: what the plan keeps in hand.
        wish: one of `WISHES`.
        word: who hits what; open without.

    Raises:
        Infeasible: the variable bounds alone exclude every such plan.
    """
    at_events, far = wish
    wanted = [replace(need, reserve=reserves.avoid) if far and need.kind == "avoid" else need for need in needs]
    grid = build_event_grid(scenario, shape[0], (rho - 1e-9, rho), reserves, shape[1], word)
    add_requirements(grid, wanted, scenario.control_period, passing=not at_events)
    return grid


class _EffortProblem:
    """A grid with its effort as tangent planes, of which solutions add more."""

    def __init__(
        self,
        scenario: FreeFlyerScenario,
        grid: EventGrid,
        reserves: Reserves,
        forbidden: Sequence[Word],
        time_limit: float,
    ) -> None:
        self.scenario, self.grid, self.reserves, self.time_limit = scenario, grid, reserves, time_limit
        self.shares = add_effort(grid, TANGENTS)
        self.bound = 0.0
        for excluded in forbidden:
            same = [grid.hits[k][pair] for k, pair in enumerate(excluded)]
            grid.model.require(sum(same, Affine({})) - (len(same) - 1.0))

    def solve(self) -> EffortOptimum:
        """Return the best of some rounds of outer approximation, each of which tightens the bound."""
        best, effort = None, np.inf
        for _ in range(ROUNDS):
            x = solve_apart(self.grid, self.scenario, self.reserves, self._solve_round)
            found = _compute_effort(self.shares, x)
            if found < effort - 1e-9:
                best, effort = x, found
            if effort - self.bound <= RELATIVE_GAP * effort:
                break
            self._add_tangents(x)
        assert best is not None
        bound = self.bound
        if len(self.grid.objects) > 1:
            best = self._straighten(best)
        sequence = _read_sequence(self.scenario, self.grid, best)
        return EffortOptimum(sequence, _measure_effort(sequence), bound)

    def _solve_round(self) -> np.ndarray:
        relaxed = solve_mixed_integer(self.grid.model, self.time_limit, RELATIVE_GAP / 2)
        self.bound = max(self.bound, relaxed.bound)
        self._relaxed = relaxed.x
        return solve_cones(self.grid.model, relaxed.x, self.shares)

    def _straighten(self, x: np.ndarray) -> np.ndarray:
        """Solve again with objects straight and uniform between their own events.

        Where another object's event divides a flight, the shares of time and way before it are both what the point
        has: rows are then linear, and all times and places stay free.
        """
        grid, model = self.grid, self.grid.model
        for hits in grid.hits:
            for hit in hits.values():
                _fix(model, hit, round(float(evaluate(hit, x))))
        times, word = grid.times[:: grid.pieces], read_word(grid, x)
        moments = evaluate(times, x)
        for name in grid.objects:
            path = np.array(grid.path(name), dtype=object)
            for a, b in itertools.pairwise(own_events(word, name)):
                for k in range(a + 1, b):
                    share = (moments[k] - moments[a]) / (moments[b] - moments[a])
                    for values in (path[:, 0], path[:, 1], times):
                        miss = values[k] - values[a] - (values[b] - values[a]) * share
                        if isinstance(miss, Affine):
                            model.require_equal(miss)
        return solve_apart(grid, self.scenario, self.reserves, self._solve_round)

    def _add_tangents(self, x: np.ndarray) -> None:
        """Add the tangent planes at a point and at the relaxed one, and their mirror images."""
        for effort, move, duration in self.shares:
            speeds = {round(abs(move.value(point)) / duration.value(point), 6) for point in (x, self._relaxed)}
            for speed in speeds - {0.0}:
                for slope in (speed, -speed):
                    self.grid.model.require(move * (2 * slope) - duration * slope**2 - effort)


def add_effort(grid: EventGrid, tangents: int) -> list[tuple[Affine, Affine, Affine]]:
    """Add e >= D^2 / T for every moving piece and axis as tangent planes; the objective is the sum of e.

    Args:
        grid: gets variables, rows and the objective.
        tangents: per sign.

    Returns:
        Expressions (e, D, T) of every piece and axis.
    """
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
                shares.append((effort, move, duration))
                total = total + effort
    grid.model.objective = total
    return shares


def _read_sequence(scenario: FreeFlyerScenario, grid: EventGrid, x: np.ndarray) -> EventSequence:
    """Return the events, with impact times on control steps and knots on micrometres.

    An area reached at an impact is then reached at a sample of the environment, and points that the
    optimal robustness leaves no freedom are met exactly.
    """
    period = scenario.control_period
    times = evaluate(grid.times, x)[:: grid.pieces]
    times[1:-1] = np.round(np.round(times[1:-1] / period) * period, 9)
    knots = {name: np.round(evaluate(points, x), 6) for name, points in grid.knots.items()}
    for name in scenario.bodies:
        knots[name][0] = scenario.body(name).start
    paths = {name: knots[name][:: grid.pieces] for name in grid.objects}
    return EventSequence(times, paths, {name: knots[name] for name in scenario.robots}, read_word(grid, x))


def read_word(grid: EventGrid, x: np.ndarray) -> Word:
    """Return who hits what at a point of the grid's model, shape (n,)."""
    return tuple(max(hits, key=lambda pair: float(evaluate(hits[pair], x))) for hits in grid.hits)


def _fix(model: Model, variable: Affine | float, value: float) -> None:
    """Set both bounds of a variable."""
    if isinstance(variable, Affine):
        (index,) = variable.coefficients
        model.lower[index] = model.upper[index] = value


def _compute_effort(shares: Sequence[tuple[Affine, Affine, Affine]], x: np.ndarray) -> float:
    return sum(move.value(x) ** 2 / duration.value(x) for _, move, duration in shares)


def _measure_effort(sequence: EventSequence) -> float:
    bodies = [*sequence.paths.values(), *sequence.knots.values()]
    durations = [np.diff(sequence.knot_times(len(knots)))[:, None] for knots in bodies]
    moves = [np.diff(knots, axis=0) for knots in bodies]
    return float(sum(np.sum(move**2 / spans) for move, spans in zip(moves, durations, strict=True)))
