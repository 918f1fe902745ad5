"""From impacts to a checked plan: events of least path cost, smooth motions, more time for legs that are too quick."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from planners.budget import Budget, get_clock
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.event_sequence import EventSequence, Word, compute_impacts, make_object_curve
from planners.free_flyer.nominal.least_cost import CostOptimum, minimise_path_cost
from planners.free_flyer.nominal.leg_times import Correction, find_rooms, find_waits
from planners.free_flyer.nominal.robustness import TOLERANCE, RobustnessOptimum
from planners.free_flyer.nominal.several_objects.composition import add_corrections
from planners.free_flyer.nominal.smoothing import smooth_motions
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.word_grid import WordGrid, solve_word_grid
from planners.free_flyer.validation import validate_plan
from planners.plan import Plan

# By so much a path cost may be below its bound, because impact times are rounded to control steps.
DISPROOF = 1e-3


def plan_long_ways(
    task: NominalTask,
    optimum: RobustnessOptimum,
    events: CostOptimum,
    rough: list[Word],
    budget: Budget,
    options: PlanOptions,
) -> Plan:
    """Smooth the events that were found along with the robustness, then look whether others cost less."""
    try:
        plan = _finish(task, optimum, optimum.rho, events, budget, options)
    except PlanningError:
        rough.append(events.sequence.hitters)
        return plan_events(task, optimum, rough, budget, options)
    try:
        other = plan_events(task, optimum, [], budget, replace(options, words=1, turns=options.turns[:1]))
    except PlanningError:
        return plan
    return other if other.effort < plan.effort and other.robustness >= plan.robustness - TOLERANCE else plan


def plan_found(
    task: NominalTask, optimum: RobustnessOptimum, events: CostOptimum, budget: Budget, options: PlanOptions
) -> Plan:
    """Smooth the events that were found along with the robustness."""
    return _finish(task, optimum, optimum.rho, events, budget, options)


def plan_events(
    task: NominalTask, optimum: RobustnessOptimum, rough: list[Word], budget: Budget, options: PlanOptions
) -> Plan:
    """Try words in the order of their path cost until the plan of one can be smoothed and passes the check.

    Out of time, the events of stage A are used, whatever their cost. Words without smooth motions are added to those
    that are rough.
    """
    failure: PlanningError | None = None
    share = options.joint if len(task.scenario.objects) > 1 else 1.0
    rho = max(options.least, share * optimum.rho - task.reserves.interior)
    for turn in options.turns:
        slower = _slow_down(task, turn)
        # Stage A did not know of the slack.
        kept = rho if options.thorough else max(options.least, rho / turn)
        forbidden: list[Word] = []
        for word in optimum.words[: options.words] or (None,) * options.words:
            try:
                with budget.stage("effort"):
                    # Where this takes long, the events of stage A are left, and time to make the most of them.
                    limit = budget.left / (4 if options.thorough else 2)
                    events = minimise_path_cost(slower, optimum.size, kept, options.cost, limit, word, forbidden)
            except PlanningError as error:
                failure = failure or error
                if word is None:
                    break
                continue
            try:
                return _finish(slower, optimum, kept, events, budget, options)
            except PlanningError as error:
                failure = failure or error
                rough.append(events.sequence.hitters)
                if word is None:
                    forbidden.append(events.sequence.hitters)
    assert failure is not None
    if isinstance(failure, Infeasible) or optimum.events is None:
        raise failure
    rough.append(optimum.events.sequence.hitters)
    return _finish(task, optimum, optimum.rho, optimum.events, budget, replace(options, thrust=None))


def plan_patiently(
    task: NominalTask,
    optimum: RobustnessOptimum,
    rough: Sequence[Word],
    failure: PlanningError,
    budget: Budget,
    options: PlanOptions,
) -> Plan:
    """Give hasty legs more time and impacts more room, then keep less robustness, until motions can be smoothed.

    Args:
        task: what is asked.
        optimum: of the event grid.
        rough: sequences that have no smooth motions.
        failure: of these motions.
        budget: time.
        options: factors and shares.

    Raises:
        PlanningError: the failure, if this does not help.
    """
    words = list(dict.fromkeys(rough))
    for _ in range(options.words):
        for word in words:
            try:
                return correct_word(task, optimum, word, budget, options)
            except PlanningError:
                if budget.left <= 0.0:
                    raise failure from None
        # A sequence of less robustness may have more time.
        try:
            with budget.stage("effort"):
                limit, tried = 0.25 * budget.left, list(dict.fromkeys((*rough, *words)))
                rho = max(options.least, options.less[-1] * optimum.rho)
                events = minimise_path_cost(task, optimum.size, rho, options.cost, limit, forbidden=tried)
        except PlanningError:
            break
        rough, words = tried, [events.sequence.hitters]
    raise failure


def plan_composed(
    task: NominalTask, optimum: RobustnessOptimum, found: WordGrid, budget: Budget, options: PlanOptions
) -> Plan:
    """Plan objects that are moved one after another, each time with more time or room where motions are hasty.

    Raises:
        PlanningError: no motions can be smoothed.
    """

    def solve_patiently(corrections: Sequence[Correction]) -> WordGrid:
        return add_corrections(found, corrections, max(budget.left, 0.0)) if corrections else found

    def read_cheapest(grid: WordGrid, rho: float) -> CostOptimum:
        return grid.reduce_cost(rho)

    return _wait_longer(task, optimum, solve_patiently, read_cheapest, budget, options)


def correct_word(
    task: NominalTask, optimum: RobustnessOptimum, word: Word, budget: Budget, options: PlanOptions
) -> Plan:
    """Plan one sequence of impacts again and again, each time with more time or room where motions are hasty.

    Raises:
        PlanningError: that does not help.
    """
    size, bounds = replace(optimum.size, passing=True), (options.least, optimum.bound)

    def solve_patiently(corrections: Sequence[Correction]) -> WordGrid:
        patient = replace(task, corrections=(*task.corrections, *corrections))
        return solve_word_grid(patient, size, bounds, 0.25 * budget.left, options.robustness_gap, word)

    def read_cheapest(grid: WordGrid, rho: float) -> CostOptimum:
        if len(task.scenario.objects) == 1:
            return grid.reduce_cost(rho)
        return minimise_path_cost(grid.task, size, rho, options.cost, 0.25 * budget.left, word)

    return _wait_longer(task, optimum, solve_patiently, read_cheapest, budget, options)


def _wait_longer(
    task: NominalTask,
    optimum: RobustnessOptimum,
    solve_patiently: Callable[[Sequence[Correction]], WordGrid],
    read_cheapest: Callable[[WordGrid, float], CostOptimum],
    budget: Budget,
    options: PlanOptions,
) -> Plan:
    """Plan again and again, each time with more time or room where motions are hasty.

    Args:
        task: what is asked.
        optimum: of the event grid.
        solve_patiently: returns the most robust point with least times between events and room for impacts.
        read_cheapest: returns the events of least path cost that keep a robustness.
        budget: time.
        options: factors and shares.

    Raises:
        PlanningError: that does not help.
    """
    best: Plan | None = None
    failure: PlanningError = Infeasible("smoothing", "no leg is hasty", "allow more impacts")
    corrections: dict[tuple[object, ...], Correction] = {}
    for factor in options.patience:
        if budget.left <= 0.0:
            break
        try:
            with budget.stage("robustness"):
                found = solve_patiently(tuple(corrections.values()))
        except PlanningError as error:
            failure = failure if corrections else error
            break
        last: EventSequence | None = None
        for share in options.less:
            rho = max(options.least, share * found.rho)
            if budget.left <= 0.0 or (best is not None and rho <= best.robustness):
                break
            try:
                with budget.stage("effort"):
                    events = read_cheapest(found, rho)
                last = last or events.sequence
                best = _finish(found.task, optimum, rho, events, budget, options)
                if share == 1.0:
                    return best  # more time does not make it more robust
                break
            except PlanningError as error:
                failure = error
        if last is None:
            break
        impacts = compute_impacts(task.scenario, last)
        hasty: tuple[Correction, ...] = find_waits(task.scenario, last, impacts, task.reserves, factor, every=True)
        cramped: tuple[Correction, ...] = find_rooms(task.scenario, impacts, task.reserves, factor)
        corrections |= {correction.key: correction for correction in (*hasty, *cramped)}
    if best is None:
        raise failure
    return best


def _slow_down(task: NominalTask, turn: float) -> NominalTask:
    """Return the task with more time for starting and stopping."""
    reserves = replace(task.reserves, turn=turn * task.reserves.turn, slack=turn * task.reserves.slack)
    return replace(task, reserves=reserves if turn == 1.0 else replace(reserves, underway=1.0))


def _finish(
    task: NominalTask,
    optimum: RobustnessOptimum,
    rho: float,
    events: CostOptimum,
    budget: Budget,
    options: PlanOptions,
) -> Plan:
    """Smooth the motions, check the plan, and store in it what the independent simulation measured."""
    scenario, sequence, reserves = task.scenario, events.sequence, task.reserves
    if get_clock().stopped:
        raise SolverFailed("smoothing", "interrupted", "raise the time limit")
    if options.thrust is not None:
        reserves = replace(reserves, thrust=options.thrust)
    with budget.stage("smoothing"):
        impacts = compute_impacts(scenario, sequence)
        curves = smooth_motions(scenario, sequence, impacts, events.needs, rho, reserves, options.smoothing, task.work)
    plan = Plan(
        scenario=scenario.name,
        objective="robustness",
        horizon=scenario.horizon,
        robustness=rho,
        bound=optimum.bound,
        gap=optimum.bound - rho,
        effort=events.cost,
        effort_bound=_read_cost_bound(optimum, events),
        impacts=impacts,
        robots=curves,
        objects={name: make_object_curve(sequence, name) for name in scenario.objects},
        solve_seconds=0.0,
        stage_seconds={},
        validated=False,
    )
    with budget.stage("validation"):
        measured = validate_plan(scenario, plan)
    gap = max(0.0, optimum.bound - measured) / max(1.0, abs(optimum.bound))
    return replace(
        plan,
        robustness=measured,
        gap=gap if gap > TOLERANCE else 0.0,
        solve_seconds=budget.seconds,
        stage_seconds=dict(budget.stages),
        validated=True,
    )


def _read_cost_bound(optimum: RobustnessOptimum, events: CostOptimum) -> float | None:
    """Return the proven lower bound of the path cost [m^2/s]; None: there is none, or the events disprove it."""
    bound = optimum.cost_bound if optimum.words else events.bound
    # Solvers of mixed-integer problems err at times: rows hold, and a bound is proven, within tolerances only.
    return min(bound, float(events.cost)) if 0.0 < bound <= events.cost * (1.0 + DISPROOF) else None
