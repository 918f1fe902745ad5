"""Plan a free-flyer scenario: most robustness with fewest impacts, then least effort, smooth motions, a check."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.event_grid import EventGrid, Reserves, build_event_grid
from planners.free_flyer.requirement import Requirement, compute_geometric_bound, read_requirements
from planners.free_flyer.smoothing import EventSequence, compute_impacts, make_object_curve, smooth_motions
from planners.free_flyer.validation import check_plan
from planners.mixed_integer import Affine, evaluate, solve_cones, solve_mixed_integer
from planners.plan import Plan

OBJECTIVES = ("robustness",)
TOLERANCE = 1e-6  # of robustness [m], and of rounded positions [m]
TANGENTS = 12  # perspective cuts per sign
EFFORT_GAP = 0.01
PIECES = (1, 2)  # per leg; two let robots go round corners
ATTEMPTS = 4  # sequences of impacts tried until one can be smoothed


@dataclass(frozen=True)
class _Optimum:
    impacts: int
    pieces: int
    rho: float
    bound: float


@dataclass
class _Clock:
    """Measure stages and what is left of the time limit."""

    limit: float
    start: float = field(default_factory=time.perf_counter)
    stages: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.stages[name] = self.stages.get(name, 0.0) + time.perf_counter() - start

    @property
    def elapsed(self) -> float:
        """Return the time since the planner was called [s]."""
        return time.perf_counter() - self.start

    @property
    def left(self) -> float:
        """Return the time left [s]."""
        return self.limit - self.elapsed


def make_free_flyer_plan(
    scenario: FreeFlyerScenario,
    objective: str = "robustness",
    max_impacts: int = 6,
    time_limit: float = 60.0,
    reserves: Reserves = Reserves(),  # noqa: B008 - frozen
) -> Plan:
    """Plan by lexicographic optimisation: robustness, number of impacts, effort; then smooth and check.

    Args:
        scenario: one disc object and any number of robots; only believed physics are read.
        objective: "robustness".
        max_impacts: greatest number of impacts tried.
        time_limit: wall time for all stages [s].
        reserves: speed, time and distance kept in hand for the execution.

    Returns:
        A plan that the independent simulation has confirmed.

    Raises:
        InputError: unknown objective, bad numbers, or a scenario or formula of an unsupported form.
        Infeasible: no plan within max_impacts, or none that can be smoothed.
        SolverFailed: a solver stopped early, or the plan failed the check.

    Source: Verhagen & Tumova, Sec. IV-B, in the event-grid formulation.
    """
    _check_arguments(scenario, objective, max_impacts, time_limit)
    clock = _Clock(time_limit)
    needs = read_requirements(scenario, reserves.wall)
    with clock.stage("robustness"):
        optimum = maximise_robustness(scenario, needs, max_impacts, reserves, clock)
    return _plan_sequence(scenario, needs, optimum, reserves, clock)


def maximise_robustness(
    scenario: FreeFlyerScenario,
    needs: Sequence[Requirement],
    max_impacts: int,
    reserves: Reserves,
    clock: _Clock,
) -> _Optimum:
    """Return the greatest robustness and the fewest impacts that reach it, with proof (stage A).

    Stops at the first number of impacts that attains the geometric bound, which holds for every number.

    Args:
        scenario: what to plan.
        needs: its requirements.
        max_impacts: greatest number of impacts tried.
        reserves: what the plan keeps in hand.
        clock: the time limit.

    Returns:
        Number of impacts, robustness [m] and bound [m].

    Raises:
        Infeasible: no plan within max_impacts.
        SolverFailed: out of time.
    """
    ceiling = compute_geometric_bound(scenario, needs)
    best, bound = _Optimum(-1, 1, -np.inf, ceiling), -np.inf
    for impacts, pieces in itertools.product(range(max_impacts + 1) if ceiling >= 0.0 else (), PIECES):
        try:
            grid = build_event_grid(scenario, needs, impacts, (max(0.0, best.rho), ceiling), reserves, pieces)
            grid.model.objective = -grid.rho
            solution = solve_mixed_integer(grid.model, clock.left)
        except Infeasible:
            continue
        except SolverFailed:
            if best.impacts < 0:
                raise
            return replace(best, bound=ceiling)
        bound = max(bound, min(ceiling, -solution.bound))
        if -solution.objective > best.rho + TOLERANCE:
            best = _Optimum(impacts, pieces, _snap(-solution.objective, ceiling), bound)
        if best.rho >= ceiling:
            return replace(best, bound=ceiling)
    if best.impacts < 0:
        status = f"proven infeasible with up to {max_impacts} impacts"
        raise Infeasible(f"plan of {scenario.name}", status, "allow more impacts or time, or relax the formula")
    return replace(best, bound=max(best.rho, bound))


def minimise_effort(
    scenario: FreeFlyerScenario,
    needs: Sequence[Requirement],
    optimum: _Optimum,
    reserves: Reserves,
    forbidden: Sequence[tuple[str, ...]],
    passing: bool,
    time_limit: float,
) -> tuple[EventSequence, float, float]:
    r"""Return the events of least effort at the optimal robustness (stage B).

    J = sum over legs and axes of D^2 / T; D^2 / T >= 2 q D - q^2 T for every q is linear in (D, T). The
    integers of this relaxation go into the exact second-order cone program.

    Args:
        scenario: what to plan.
        needs: its requirements.
        optimum: number of impacts and robustness to keep.
        reserves: what the plan keeps in hand.
        forbidden: sequences of hitting robots that are excluded.
        passing: whether areas may be reached between knots.
        time_limit: of the mixed-integer solver [s].

    Returns:
        The events, their effort and its lower bound [m^2/s].

    Raises:
        Infeasible: no such events.
        SolverFailed: out of time.
    """
    rho = (optimum.rho - 1e-9, optimum.rho)
    grid = build_event_grid(scenario, needs, optimum.impacts, rho, reserves, optimum.pieces, passing)
    shares = _add_effort(grid)
    for word in forbidden:
        same = [grid.hits[k][name] for k, name in enumerate(word)]
        grid.model.require(np.sum(same) - (len(same) - 1.0))
    relaxed = solve_mixed_integer(grid.model, time_limit, EFFORT_GAP)
    x = solve_cones(grid.model, relaxed.x, shares)
    sequence = _read_sequence(scenario, grid, x)
    return sequence, _effort(sequence), max(0.0, relaxed.bound)


def _plan_sequence(
    scenario: FreeFlyerScenario,
    needs: tuple[Requirement, ...],
    optimum: _Optimum,
    reserves: Reserves,
    clock: _Clock,
) -> Plan:
    """Try sequences in the order of their effort until one passes smoothing and the check."""
    forbidden: list[tuple[str, ...]] = []
    failure: PlanningError | None = None
    effort_bound = None
    for _ in range(ATTEMPTS):
        try:
            with clock.stage("effort"):
                found = _minimise_with_reserve(scenario, needs, optimum, reserves, forbidden, clock)
        except PlanningError as error:
            raise failure or error from None
        sequence, effort, bound = found
        effort_bound = bound if effort_bound is None else effort_bound
        try:
            with clock.stage("smoothing"):
                impacts = compute_impacts(scenario, sequence)
                curves = smooth_motions(scenario, sequence, impacts, needs, optimum.rho, reserves)
            plan = Plan(
                scenario=scenario.name,
                objective="robustness",
                horizon=scenario.horizon,
                robustness=optimum.rho,
                bound=optimum.bound,
                gap=0.0,
                effort=effort,
                effort_bound=effort_bound,
                impacts=impacts,
                robots=curves,
                objects={sequence.object: make_object_curve(sequence)},
                solve_seconds=0.0,
                stage_seconds={},
                validated=False,
            )
            with clock.stage("validation"):
                rho = check_plan(scenario, plan)
            return _sign(plan, rho, clock)
        except PlanningError as error:
            failure = failure or error
            if not sequence.hitters:
                raise
            forbidden.append(sequence.hitters)
    assert failure is not None
    raise failure


def _minimise_with_reserve(
    scenario: FreeFlyerScenario,
    needs: tuple[Requirement, ...],
    optimum: _Optimum,
    reserves: Reserves,
    forbidden: Sequence[tuple[str, ...]],
    clock: _Clock,
) -> tuple[EventSequence, float, float]:
    """Keep what helps the execution where the optimal robustness leaves room for it.

    Areas are better reached at knots, where the execution aims, and avoided with a reserve.
    """
    far = tuple(replace(need, reserve=reserves.avoid) if need.kind == "avoid" else need for need in needs)
    failure: Infeasible | None = None
    for passing, wanted in ((False, far), (False, needs), (True, far), (True, needs)):
        try:
            return minimise_effort(scenario, wanted, optimum, reserves, forbidden, passing, clock.left / 2)
        except Infeasible as error:
            failure = error
    assert failure is not None
    raise failure


def _sign(plan: Plan, rho: float, clock: _Clock) -> Plan:
    """Put what the independent simulation measured into the plan."""
    gap = max(0.0, plan.bound - rho) / max(1.0, abs(plan.bound))
    return plan.replace(
        robustness=rho,
        gap=0.0 if gap <= TOLERANCE else gap,
        solve_seconds=clock.elapsed,
        stage_seconds=dict(clock.stages),
        validated=True,
    )


def _add_effort(grid: EventGrid) -> list[tuple[Affine, Affine, Affine]]:
    """Add e >= D^2 / T for every moving leg and axis as tangent planes; the objective is the sum of e."""
    shares, total = [], Affine({})
    for name, knots in grid.knots.items():
        # The object's pieces share one velocity, so its legs count whole.
        stride = grid.pieces if name == grid.object else 1
        for start in range(0, grid.count, stride):
            fastest = grid.caps[start] if name == grid.object else grid.speeds[name]
            duration = grid.times[start + stride] - grid.times[start] + Affine({})
            for step in knots[start + stride] - knots[start] if fastest > 0.0 else ():
                move = step + Affine({})
                effort = grid.model.variable(0.0, fastest**2 * grid.model.limits(duration)[1])
                for q in fastest * np.arange(1, TANGENTS + 1) / TANGENTS:
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
    hitters = tuple(max(hits, key=lambda robot: hits[robot].value(x)) for hits in grid.hits)
    robots = {name: knots[name] for name in scenario.robots}
    return EventSequence(times, grid.object, knots[grid.object][:: grid.pieces], robots, hitters)


def _effort(sequence: EventSequence) -> float:
    bodies = [sequence.path, *sequence.knots.values()]
    durations = [np.diff(sequence.knot_times(len(knots)))[:, None] for knots in bodies]
    moves = [np.diff(knots, axis=0) for knots in bodies]
    return float(sum(np.sum(move**2 / spans) for move, spans in zip(moves, durations, strict=True)))


def _snap(rho: float, ceiling: float) -> float:
    return ceiling if abs(ceiling - rho) <= TOLERANCE else rho


def _check_arguments(
    scenario: FreeFlyerScenario, objective: str, max_impacts: int, time_limit: float
) -> None:
    if objective not in OBJECTIVES:
        raise InputError(f"objective '{objective}' is unknown; {choices(objective, OBJECTIVES)}")
    if max_impacts < 0 or time_limit <= 0:
        raise InputError(f"max_impacts {max_impacts} and time_limit {time_limit} s must not be negative or zero")
    if len(scenario.objects) != 1:
        raise InputError(f"{scenario.name}: this planner takes one object, got {len(scenario.objects)}")
    for name, body in scenario.objects.items():
        if body.vertices is not None:
            raise InputError(f"{scenario.name}: objects.{name}: this planner takes disc objects, got a polygon")
