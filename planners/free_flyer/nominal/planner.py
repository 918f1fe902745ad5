"""Plan a free-flyer scenario: most robustness with fewest impacts, then least path cost, smooth motions, a check."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Budget, Work
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.frame import Frame, find_frame
from planners.free_flyer.nominal.diagnosis import find_relaxation
from planners.free_flyer.nominal.event_sequence import EventSequence, Word, compute_impacts, make_object_curve
from planners.free_flyer.nominal.least_cost import CostOptimum, minimise_path_cost
from planners.free_flyer.nominal.leg_times import Wait, find_waits
from planners.free_flyer.nominal.robustness import (
    MANY,
    TOLERANCE,
    RobustnessOptimum,
    maximise_jointly,
    maximise_robustness,
)
from planners.free_flyer.nominal.screening import screen_task
from planners.free_flyer.nominal.smoothing import smooth_motions
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.verdict import Trial, judge_trials
from planners.free_flyer.nominal.ways import count_pieces
from planners.free_flyer.nominal.word_grid import solve_word_grid
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.central_hit import compute_shape_error
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.validation import Tolerances, validate_plan
from planners.plan import Plan
from planners.solvers import check_solver


def make_free_flyer_plan(
    scenario: FreeFlyerScenario,
    max_impacts: int | None = None,
    time_limit: float = 60.0,
    solver: str = "highs",
    reserves: Reserves = Reserves(),  # noqa: B008 - frozen
    options: PlanOptions = PlanOptions(),  # noqa: B008 - frozen
    work: Work | None = None,
) -> Plan:
    """Plan by lexicographic optimisation: robustness, number of impacts, path cost; then smooth and check.

    A task that leaves no room for the reserves is planned with half of them, then with a quarter; one whose margin of
    speed costs much of the robustness, with half of that margin.

    Args:
        scenario: any numbers of robots and objects; only believed physics are read. A polygon takes as much room as
            the disc around it; it is hit through its centre or, where no such plan is good enough, as that disc.
        max_impacts: greatest number of impacts tried; default: 6, and 3 for every further object.
        time_limit: wall time for all stages [s].
        solver: of mixed-integer models, a key of `planners.solvers.SOLVERS`.
        reserves: speed, time and distance kept in hand for the execution.
        options: how far the plan is improved, and what of it is proven.
        work: that is counted and limited, if any is.

    Returns:
        A plan that the independent simulation has confirmed.

    Raises:
        InputError: bad numbers, or a scenario or formula of an unsupported form.
        Infeasible: no plan within max_impacts, or none that can be smoothed; says what to loosen, and by how much.
        SolverFailed: a solver stopped early, or the plan failed the check.
        OutOfWork: the work allowed did not suffice.

    Source: Verhagen & Tumova, Sec. IV-B, on a grid of events.
    """
    if max_impacts is None:
        max_impacts = 3 + 3 * len(scenario.objects)
    _check_arguments(scenario, max_impacts, time_limit)
    check_solver(solver)
    read_demands(scenario, reserves.wall)  # formulas are refused in the user's words
    frame = find_frame(scenario)
    # Wall time depends on the machine; the work done until it is over is told along with it.
    work = work or Work()
    plan = _plan_in_frame(frame.enter(scenario), max_impacts, time_limit, solver, reserves, options, work, frame)
    if not frame.is_users:
        plan = frame.leave(plan)
        validate_plan(scenario, plan, Tolerances().scaled(frame.length))
    return plan


def _plan_in_frame(
    scenario: FreeFlyerScenario,
    max_impacts: int,
    time_limit: float,
    solver: str,
    reserves: Reserves,
    options: PlanOptions,
    work: Work | None,
    frame: Frame,
) -> Plan:
    """Plan with objects that are hit through their centres or, where no such plan is good enough, as discs."""
    discs = {name: item.model_copy(update={"vertices": None}) for name, item in scenario.objects.items()}
    disc_scenario = scenario.model_copy(update={"objects": discs})
    if not scenario.has_polygons:
        return _plan_task(scenario, max_impacts, Budget(time_limit), solver, reserves, options, work, frame)
    if options.central is not None:
        # Half of the time each: what cannot be hit through its centre is found out late.
        time_limit = 0.5 * time_limit
        try:
            brief = replace(options, diagnosis=0.0)
            plan = _plan_task(scenario, max_impacts, Budget(time_limit), solver, reserves, brief, work, frame)
            if plan.robustness >= options.central:
                return replace(plan, shape_error=compute_shape_error(scenario, plan.impacts, plan.horizon))
        except PlanningError:
            pass
    plan = _plan_task(disc_scenario, max_impacts, Budget(time_limit), solver, reserves, options, work, frame)
    return replace(plan, shape_error=compute_shape_error(scenario, plan.impacts, plan.horizon))


def _plan_task(
    scenario: FreeFlyerScenario,
    max_impacts: int,
    budget: Budget,
    solver: str,
    reserves: Reserves,
    options: PlanOptions,
    work: Work | None,
    frame: Frame,
) -> Plan:
    """Climb the ladder of attempts until one gives a plan, see `_list_attempts`."""
    demands = read_demands(scenario, reserves.wall)
    task = NominalTask(scenario, demands, reserves, solver, work, frame)
    if options.expected is not None:
        max_impacts = min(max_impacts, options.expected + 1)
    trials: list[Trial] = []
    best: Plan | None = None
    for halvings, pieces in _list_attempts(task, options, trials):
        if trials and budget.left <= 0.0:
            break
        if best is not None and pieces != options.pieces:
            continue
        tried = replace(options, pieces=pieces, enough=options.enough * (1.0 if options.thorough else 0.5**halvings))
        climber = _Climber(_halve_reserves(task, halvings), max_impacts, budget, tried, hurry=best is not None)
        try:
            plan = climber.climb()
        except PlanningError as error:
            trials.append(Trial(halvings, pieces, error, climber.rho))
            continue
        if best is None or plan.robustness > best.robustness:
            best = plan
        if not options.thorough or climber.rho is None or plan.robustness >= options.satisfying * climber.rho:
            break
        trials.append(Trial(halvings, pieces, climber.failure, climber.rho))
    if best is not None:
        return best
    if not options.thorough:
        failure = trials[0].error
        assert failure is not None
        raise failure
    hardest = _halve_reserves(task, max(trial.halvings for trial in trials))
    complete = budget.left > 0.0
    verdict = judge_trials(trials, hardest, max_impacts, budget, complete)
    raise _explain(verdict, hardest, max_impacts, budget, options)


def _list_attempts(
    task: NominalTask, options: PlanOptions, trials: Sequence[Trial]
) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Yield how often reserves are halved, and the numbers of pieces per leg, in the order in which they are tried.

    Legs get more pieces where the event grid has no plan without: first as many as the shortest ways round obstacles
    have, with each of the reserves; when these have failed as well, all other numbers.
    """
    needed = count_pieces(task.scenario, task.demands, task.reserves.wall) if options.thorough else None
    more = range(max(options.pieces) + 1, options.most_pieces + 1) if options.thorough else ()
    first = [pieces for pieces in more if needed is not None and needed <= pieces <= needed + 1]
    first = first if needed is not None and needed > max(options.pieces) else []
    for halvings in range(options.halvings + 1):
        yield halvings, options.pieces
        if trials and trials[-1].rho is None:
            yield from ((halvings, (pieces,)) for pieces in first)
    if all(trial.rho is None for trial in trials):
        rest = [pieces for pieces in more if pieces not in first]
        yield from itertools.product(range(options.halvings + 1), ((pieces,) for pieces in rest))


def _halve_reserves(task: NominalTask, times: int) -> NominalTask:
    for _ in range(times):
        task = replace(task, reserves=replace(task.reserves.halved(), underway=1.0))
    return task


# By so much a path cost may be below its bound, because impact times are rounded to control steps.
DISPROOF = 1e-3


@dataclass
class _Climber:
    """Hold one attempt.

    Args:
        task: with its reserves.
        max_impacts: greatest number of impacts.
        budget: time.
        options: with the numbers of pieces per leg.
        hurry: there is a plan already, so nothing slow is tried.
        rho: greatest robustness of the event grid, once it is known [m].
        failure: of the best motions, where less robust ones were found.
    """

    task: NominalTask
    max_impacts: int
    budget: Budget
    options: PlanOptions
    hurry: bool = False
    rho: float | None = None
    failure: PlanningError | None = None

    def climb(self) -> Plan:
        """Return a plan.

        Raises:
            PlanningError: there is none.
        """
        task, options, budget = self.task, self.options, self.budget
        if options.screen:
            with budget.stage("screening"):
                screen_task(task, self.max_impacts, options)
        search = maximise_robustness if len(task.scenario.objects) == 1 else maximise_jointly
        with budget.stage("robustness"):
            # An attempt leaves time for the next one.
            share = options.attempt_share if len(task.scenario.objects) == 1 else options.joint_share
            part = Budget(budget.left * share)
            optimum = search(task, self.max_impacts, part, options)
            self.rho = optimum.rho
            budget.news = f"robustness {optimum.rho:.4g} m of at most {optimum.bound:.4g} m"
            quick = quicken_legs(task, optimum, search, part, options)
        if quick is not None:
            try:
                return _plan_events(*quick, [], budget, options)
            except PlanningError:
                pass  # the plan with all reserves is left
        rough: list[Word] = []
        try:
            if self.hurry and optimum.events is not None:
                rough.append(optimum.events.sequence.hitters)
                raise SolverFailed("smoothing", "there is a plan already", "raise the time limit")
            if optimum.events is not None and (optimum.size.pieces > MANY or optimum.words):
                return _plan_long_ways(task, optimum, optimum.events, rough, budget, options)
            return _plan_events(task, optimum, rough, budget, options)
        except PlanningError as error:
            self.failure = error
            if not options.thorough:
                raise
        return _plan_patiently(task, optimum, rough, self.failure, budget, options)


def quicken_legs(
    task: NominalTask,
    optimum: RobustnessOptimum,
    search: Callable[..., RobustnessOptimum],
    budget: Budget,
    options: PlanOptions,
) -> tuple[NominalTask, RobustnessOptimum] | None:
    """Return the task with less margin of speed and its optimum, if that margin costs much of the robustness.

    No more impacts are tried than the optimum has.
    """
    if not options.thorough or optimum.rho >= options.deep * optimum.bound:
        return None
    quick = replace(task, reserves=task.reserves.quickened())
    try:
        found = search(quick, optimum.size.impacts, Budget(budget.left / 2), options)
    except PlanningError:
        return None
    return (quick, found) if found.rho >= options.deeper * optimum.rho else None


def _explain(
    failure: PlanningError, task: NominalTask, max_impacts: int, budget: Budget, options: PlanOptions
) -> PlanningError:
    """Return the failure of a task; if it is infeasible, the remedy says what to loosen."""
    if not isinstance(failure, Infeasible) or not options.diagnosis:
        return failure
    limit = min(max(budget.left, 0.25 * options.diagnosis), options.diagnosis)
    pieces = min(count_pieces(task.scenario, task.demands, task.reserves.wall) or 1, options.most_pieces)
    found = find_relaxation(task, max_impacts, options.least, limit, pieces)
    if not found:
        return failure
    remedy = f"a plan would exist with {' and '.join(str(relaxation) for relaxation in found)}"
    return Infeasible(failure.problem, failure.status, remedy)


def _plan_long_ways(
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
        return _plan_events(task, optimum, rough, budget, options)
    try:
        other = _plan_events(task, optimum, [], budget, replace(options, words=1, turns=options.turns[:1]))
    except PlanningError:
        return plan
    return other if other.effort < plan.effort and other.robustness >= plan.robustness - TOLERANCE else plan


def _plan_events(
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


def _plan_patiently(
    task: NominalTask,
    optimum: RobustnessOptimum,
    rough: Sequence[Word],
    failure: PlanningError,
    budget: Budget,
    options: PlanOptions,
) -> Plan:
    """Give hasty legs more time, then keep less robustness, until the motions of a sequence can be smoothed.

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
                return _plan_word(task, optimum, word, budget, options)
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


def _plan_word(task: NominalTask, optimum: RobustnessOptimum, word: Word, budget: Budget, options: PlanOptions) -> Plan:
    """Plan one sequence of impacts again and again, each time with more time on the legs that are hasty.

    Raises:
        PlanningError: that does not help.
    """
    best: Plan | None = None
    failure: PlanningError = Infeasible("smoothing", "no leg is hasty", "allow more impacts")
    waits: dict[tuple[int, int], Wait] = {}
    size, bounds = replace(optimum.size, passing=True), (options.least, optimum.bound)
    for factor in options.patience:
        patient, limit = replace(task, waits=tuple(waits.values())), 0.25 * budget.left
        if limit <= 0.0:
            break
        try:
            with budget.stage("robustness"):
                found = solve_word_grid(patient, size, bounds, limit, options.robustness_gap, word)
        except PlanningError as error:
            failure = failure if waits else error
            break
        last: EventSequence | None = None
        for share in options.less:
            rho = max(options.least, share * found.rho)
            if best is not None and rho <= best.robustness:
                break
            try:
                with budget.stage("effort"):
                    if len(task.scenario.objects) == 1:
                        events = found.reduce_cost(rho)
                    else:
                        events = minimise_path_cost(patient, size, rho, options.cost, limit, word)
                last = last or events.sequence
                best = _finish(patient, optimum, rho, events, budget, options)
                if share == 1.0:
                    return best  # more time does not make it more robust
                break
            except PlanningError as error:
                failure = error
        if last is None:
            break
        impacts = compute_impacts(task.scenario, last)
        hasty = find_waits(task.scenario, last, impacts, task.reserves, factor)
        waits |= {(wait.first, wait.second): wait for wait in hasty}
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
        solve_seconds=budget.elapsed,
        stage_seconds=dict(budget.stages),
        validated=True,
    )


def _read_cost_bound(optimum: RobustnessOptimum, events: CostOptimum) -> float | None:
    """Return the proven lower bound of the path cost [m^2/s]; None: there is none, or the events disprove it."""
    bound = optimum.cost_bound if optimum.words else events.bound
    # Solvers of mixed-integer problems err at times: rows hold, and a bound is proven, within tolerances only.
    return min(bound, float(events.cost)) if 0.0 < bound <= events.cost * (1.0 + DISPROOF) else None


def _check_arguments(scenario: FreeFlyerScenario, max_impacts: int, time_limit: float) -> None:
    if max_impacts < 0:
        raise InputError(f"max_impacts is {max_impacts}, it must not be negative")
    if not time_limit > 0:
        raise InputError(f"time_limit is {time_limit} s, it must be positive")
    if not scenario.objects:
        raise InputError(f"{scenario.name}: objects: this planner takes at least one, got none")
