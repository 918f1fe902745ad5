"""Plan a free-flyer scenario: most robustness with fewest impacts, then least effort, smooth motions, a check."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Budget
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.diagnosis import find_relaxation
from planners.free_flyer.nominal.effort import RELATIVE_GAP, EffortOptimum, minimise_effort, read_events
from planners.free_flyer.nominal.effort import ROUNDS as EFFORT_ROUNDS
from planners.free_flyer.nominal.event_grid import build_event_grid
from planners.free_flyer.nominal.event_sequence import Hitter, Word, compute_impacts, make_object_curve
from planners.free_flyer.nominal.sequence_search import restrict_to_object, search_words
from planners.free_flyer.nominal.smoothing import QUICK_ROUNDS, ROUNDS, smooth_motions
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.formula_rows import add_demands
from planners.free_flyer.specification.requirement import Demands, read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound
from planners.free_flyer.validation import check_plan
from planners.mixed_integer import Model
from planners.plan import Plan
from planners.solvers import check_solver, solve

TOLERANCE = 1e-6  # [m]
PIECES = (1, 2)  # per leg; two let robots go round corners
DIAGNOSIS = 20.0  # for finding what to loosen, at most [s]
LEAST = 1e-3  # robustness worth the name [m]
HALVINGS = 2  # of the reserves, where a task leaves no room for them
WORDS = 3  # sequences of hitting robots tried at each of the TURNS
TURNS = (1.0, 1.5)  # of the time for starting and stopping, when motions prove too quick to be smoothed


@dataclass(frozen=True)
class Ambition:
    """Hold how far a plan is improved, and what of it is proven.

    Args:
        enough: share of the bound of the robustness from which on other numbers of impacts are not tried; half of
            it once a plan has failed, if not thorough.
        robustness_gap: to which the greatest robustness is proven.
        effort_gap: to which the least effort is proven.
        rounds: of outer approximation of the effort, at most.
        joint: share of their robustness that several objects keep when their flights are straightened.
        thrust: share of the thrust that smooth motions may use; that of the reserves without.
        expected: number of impacts to try first, then one more, then fewer; from none up without.
        thorough: whether all wishes and words are gone through, and what to loosen is said where there is no plan.
    """

    enough: float = 1.0
    robustness_gap: float = 1e-6
    effort_gap: float = RELATIVE_GAP
    rounds: int = EFFORT_ROUNDS
    joint: float = 1.0
    thrust: float | None = None
    expected: int | None = None
    thorough: bool = True

    def numbers(self, fewest: int, most: int) -> list[int]:
        """Return numbers of impacts in the order in which they are tried."""
        every = range(fewest, most + 1)
        if self.expected is None:
            return list(every)
        last = self.expected + 1
        return sorted((k for k in every if k <= last), key=lambda k: (k < last - 1, abs(k - last + 1)))


@dataclass(frozen=True)
class RobustnessOptimum:
    """Hold the result of stage A.

    Args:
        impacts: fewest impacts that attain the robustness.
        pieces: pieces per leg that robots need.
        rho: greatest robustness [m].
        bound: what no plan of any kind can exceed [m].
        words: who hits what, least effort first; open if empty.
        effort_bound: that no word goes below [m^2/s].
        events: that attain it, of any effort, for when there is no time for the least; one object only.
    """

    impacts: int
    pieces: int
    rho: float
    bound: float
    words: tuple[Word, ...] = ()
    effort_bound: float = 0.0
    events: EffortOptimum | None = None


def make_free_flyer_plan(
    scenario: FreeFlyerScenario,
    max_impacts: int | None = None,
    time_limit: float = 60.0,
    solver: str = "highs",
    reserves: Reserves = Reserves(),  # noqa: B008 - frozen
    ambition: Ambition = Ambition(),
) -> Plan:
    """Plan by lexicographic optimisation: robustness, number of impacts, effort; then smooth and check.

    A task that leaves no room for the reserves is planned with half of them, then with a quarter.

    Args:
        scenario: any numbers of robots and objects; only believed physics are read. An object that is no disc is
            planned as the disc round it; who executes the plan hits it through its centre (see pilot).
        max_impacts: greatest number of impacts tried; as many as 6, and 3 for every further object without.
        time_limit: wall time for all stages [s].
        solver: "highs", or one of `planners.solvers.SOLVERS` that is installed.
        reserves: speed, time and distance kept in hand for the execution.
        ambition: how far the plan is improved, and what of it is proven.

    Returns:
        A plan that the independent simulation has confirmed.

    Raises:
        InputError: bad numbers, or a scenario or formula of an unsupported form.
        Infeasible: no plan within max_impacts, or none that can be smoothed; says what to loosen, and by how much.
        SolverFailed: a solver stopped early, or the plan failed the check.

    Source: Verhagen & Tumova, Sec. IV-B, on a grid of events.
    """
    if max_impacts is None:
        max_impacts = 3 + 3 * len(scenario.objects)
    _check_arguments(scenario, max_impacts, time_limit)
    discs = {name: item.model_copy(update={"vertices": None}) for name, item in scenario.objects.items()}
    scenario = scenario.model_copy(update={"objects": discs})
    check_solver(solver)
    budget = Budget(time_limit, solver)
    demands = read_demands(scenario, reserves.wall)
    failure: PlanningError | None = None
    smallest = reserves
    for _ in range(HALVINGS + 1):
        try:
            with budget.stage("robustness"):
                search = maximise_robustness if len(scenario.objects) == 1 else maximise_jointly
                optimum = search(scenario, demands, max_impacts, reserves, budget, ambition=ambition)
            return _plan_events(scenario, demands, optimum, reserves, budget, ambition)
        except PlanningError as error:
            failure = failure or error
        if budget.left <= 0.0:
            break
        smallest, reserves = reserves, replace(reserves.halved(), underway=1.0)
        ambition = ambition if ambition.thorough else replace(ambition, enough=0.5 * ambition.enough)
    assert failure is not None
    if not isinstance(failure, Infeasible) or not ambition.thorough:
        raise failure
    found = find_relaxation(
        scenario, demands, max_impacts, LEAST, smallest, min(max(budget.left, 5.0), DIAGNOSIS), solver
    )
    if not found:
        raise failure
    remedy = f"a plan would exist with {' and '.join(str(relaxation) for relaxation in found)}"
    raise Infeasible(failure.problem, failure.status, remedy)


def maximise_robustness(
    scenario: FreeFlyerScenario,
    demands: Demands,
    max_impacts: int,
    reserves: Reserves,
    budget: Budget,
    fewest: int = 0,
    ambition: Ambition = Ambition(),
) -> RobustnessOptimum:
    """Return the greatest robustness and the fewest impacts that attain it (stage A).

    Every number of impacts is solved to proven optimality or infeasibility (as far as the time limit lets it),
    until one attains the geometric bound, which holds for every number. Legs in several pieces are for numbers
    infeasible without, and for the first number with a plan that does not attain the bound.

    Args:
        scenario: what to plan.
        demands: its demands.
        max_impacts: greatest number of impacts tried.
        reserves: what the plan keeps in hand.
        budget: time and solver.
        fewest: least number of impacts tried.
        ambition: what is enough.

    Returns:
        The optimum.

    Raises:
        Infeasible: no plan within max_impacts.
        SolverFailed: out of time.
    """
    ceiling = compute_geometric_bound(scenario, demands, budget.solver)
    problem = f"plan of {scenario.name}"
    if ceiling < LEAST:
        status = f"fixed starts, goals and areas leave a robustness of {ceiling:.3g} m at best"
        raise Infeasible(problem, status, "move them, or relax the formula")
    best: RobustnessOptimum | None = None
    for impacts, pieces in itertools.product(ambition.numbers(fewest, max_impacts), PIECES):
        if best is not None and pieces > best.pieces and impacts > best.impacts:
            continue
        if best is not None and not ambition.thorough and impacts > best.impacts + 1:
            break
        try:
            grid = build_event_grid(scenario, impacts, (best.rho if best else LEAST, ceiling), reserves, pieces)
            choices = add_demands(grid, demands, scenario.control_period, passing=True)
            grid.model.objective = -grid.rho
            # Once there is a plan, looking for a more robust one with more impacts must leave time to finish it.
            share = 0.25 if ambition.thorough else 0.5
            limit = budget.left if best is None else share * budget.limit - budget.elapsed
            point = partial(_solve_point, grid.model, limit, ambition.robustness_gap, budget.solver)
            x = solve_apart(grid, scenario, reserves, point)
            rho = grid.rho.value(x)
        except Infeasible:
            continue
        except SolverFailed:
            if best is None:
                raise
            break
        if best is None or rho > best.rho + TOLERANCE:
            events = read_events(scenario, grid, choices, x) if len(scenario.objects) == 1 else None
            rho = ceiling if ceiling - rho <= TOLERANCE else rho
            best = RobustnessOptimum(impacts, pieces, rho, ceiling, events=events)
        if best.rho >= ambition.enough * ceiling:
            break
    if best is None:
        status = f"proven infeasible with up to {max_impacts} impacts and the planner's reserves"
        raise Infeasible(problem, status, "allow more impacts or time, move the areas, or relax the formula")
    return best


def maximise_jointly(
    scenario: FreeFlyerScenario,
    demands: Demands,
    max_impacts: int,
    reserves: Reserves,
    budget: Budget,
    ambition: Ambition = Ambition(),
) -> RobustnessOptimum:
    """Return the optimum for several objects, from those of each object alone.

    What the objects attain alone bounds what they attain together, in robustness and in number of impacts. A word
    that attains both bounds is looked for first; only if there is none are all words open (see `maximise_robustness`).

    Args:
        scenario: what to plan.
        demands: its demands.
        max_impacts: greatest number of impacts tried.
        reserves: what the plan keeps in hand.
        budget: time and solver.
        ambition: what is enough.

    Returns:
        The optimum.

    Raises:
        Infeasible: no plan within max_impacts.
        SolverFailed: out of time.
    """
    ceiling = compute_geometric_bound(scenario, demands, budget.solver)
    rho, pieces = ceiling, 1
    hits: list[tuple[float, Hitter]] = []
    single = replace(ambition, expected=None)
    for name in scenario.objects:
        alone = restrict_to_object(scenario, name)
        if alone is None:
            continue
        own = read_demands(alone, reserves.wall)
        optimum = maximise_robustness(alone, own, max_impacts, reserves, budget, ambition=single)
        rho, pieces = min(rho, optimum.rho), max(pieces, optimum.pieces)
        shape = optimum.impacts, optimum.pieces
        events = optimum.events if not ambition.thorough else None
        if events is None:
            events = minimise_effort(alone, own, shape, optimum.rho, reserves, [], budget.left, solver=budget.solver)
        hits += zip(events.sequence.times[1:-1], events.sequence.hitters, strict=True)
    seed = tuple(hitter for _, hitter in sorted(hits))
    if len(seed) <= max_impacts:
        shape, kept = (len(seed), pieces), ambition.joint * rho
        found = search_words(
            scenario,
            demands,
            shape,
            kept,
            reserves,
            seed,
            lambda: budget.left / 2,
            budget.solver,
            ambition.thorough,
        )
        if found.words:
            return RobustnessOptimum(len(seed), pieces, rho, ceiling, found.words, found.bound)
    fewest = len(seed) if ambition.expected is None else min(len(seed), ambition.expected)
    return maximise_robustness(scenario, demands, max_impacts, reserves, budget, fewest, ambition)


def _solve_point(model: Model, time_limit: float, gap: float, solver: str) -> np.ndarray:
    return solve(model, time_limit, gap, solver).x


def _plan_events(
    scenario: FreeFlyerScenario,
    demands: Demands,
    optimum: RobustnessOptimum,
    reserves: Reserves,
    budget: Budget,
    ambition: Ambition,
) -> Plan:
    """Try sequences of robots in the order of their effort until one passes smoothing and the check.

    Out of time, the events of stage A have to do, whatever their effort.
    """
    failure: PlanningError | None = None
    rounds = ROUNDS if ambition.thorough else QUICK_ROUNDS
    share = ambition.joint if len(scenario.objects) > 1 else 1.0
    shape, rho = (optimum.impacts, optimum.pieces), max(LEAST, share * optimum.rho - reserves.interior)
    for turn in TURNS:
        slower = replace(reserves, turn=turn * reserves.turn, slack=turn * reserves.slack)
        slower = slower if turn == 1.0 else replace(slower, underway=1.0)
        # Stage A did not know of the slack.
        kept = rho if ambition.thorough else max(LEAST, rho / turn)
        smooth = slower if ambition.thrust is None else replace(slower, thrust=ambition.thrust)
        forbidden: list[Word] = []
        for word in optimum.words[:WORDS] or (None,) * WORDS:
            try:
                with budget.stage("effort"):
                    limit = budget.left / 2
                    events = minimise_effort(
                        scenario,
                        demands,
                        shape,
                        kept,
                        slower,
                        forbidden,
                        limit,
                        word,
                        budget.solver,
                        ambition.effort_gap,
                        ambition.rounds,
                        ambition.thorough,
                    )
            except PlanningError as error:
                failure = failure or error
                if word is None:
                    break
                continue
            try:
                return _finish(scenario, optimum, kept, events, smooth, budget, rounds)
            except PlanningError as error:
                failure = failure or error
                if word is None:
                    forbidden.append(events.sequence.hitters)
    assert failure is not None
    if isinstance(failure, Infeasible) or optimum.events is None:
        raise failure
    return _finish(scenario, optimum, optimum.rho, optimum.events, reserves, budget, rounds)


def _finish(
    scenario: FreeFlyerScenario,
    optimum: RobustnessOptimum,
    rho: float,
    events: EffortOptimum,
    reserves: Reserves,
    budget: Budget,
    rounds: int = ROUNDS,
) -> Plan:
    """Smooth the motions, check the plan, and put what the independent simulation measured into it."""
    sequence = events.sequence
    with budget.stage("smoothing"):
        impacts = compute_impacts(scenario, sequence)
        curves = smooth_motions(scenario, sequence, impacts, events.needs, rho, reserves, rounds)
    plan = Plan(
        scenario=scenario.name,
        objective="robustness",
        horizon=scenario.horizon,
        robustness=rho,
        bound=optimum.bound,
        gap=optimum.bound - rho,
        effort=events.effort,
        effort_bound=(optimum.effort_bound if optimum.words else events.bound) or None,
        impacts=impacts,
        robots=curves,
        objects={name: make_object_curve(sequence, name) for name in scenario.objects},
        solve_seconds=0.0,
        stage_seconds={},
        validated=False,
    )
    with budget.stage("validation"):
        measured = check_plan(scenario, plan)
    gap = max(0.0, optimum.bound - measured) / max(1.0, abs(optimum.bound))
    return replace(
        plan,
        robustness=measured,
        gap=gap if gap > TOLERANCE else 0.0,
        solve_seconds=budget.elapsed,
        stage_seconds=dict(budget.stages),
        validated=True,
    )


def _check_arguments(scenario: FreeFlyerScenario, max_impacts: int, time_limit: float) -> None:
    if max_impacts < 0:
        raise InputError(f"max_impacts is {max_impacts}, it must not be negative")
    if not time_limit > 0:
        raise InputError(f"time_limit is {time_limit} s, it must be positive")
    if not scenario.objects:
        raise InputError(f"{scenario.name}: objects: this planner takes at least one, got none")
