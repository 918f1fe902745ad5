"""Plan a free-flyer scenario: most robustness with fewest impacts, then least path cost, smooth motions, a check."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Budget, Clock, Work, get_clock, use_clock
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.frame import Frame, find_frame
from planners.free_flyer.nominal.attempt import Attempt
from planners.free_flyer.nominal.diagnosis import Relaxation, find_relaxation, list_amounts
from planners.free_flyer.nominal.event_sequence import Word
from planners.free_flyer.nominal.finishing import (
    correct_word,
    plan_composed,
    plan_events,
    plan_long_ways,
    plan_patiently,
)
from planners.free_flyer.nominal.robustness import MANY, RobustnessOptimum, maximise_robustness
from planners.free_flyer.nominal.screening import is_excluded, screen_task
from planners.free_flyer.nominal.several_objects.joint_robustness import maximise_jointly
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.verdict import Trial, judge_trials
from planners.free_flyer.nominal.ways import count_pieces
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.central_hit import compute_shape_error
from planners.free_flyer.specification.loosening import loosen
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
    proof: float = 0.0,
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
        proof: more time, for a closer bound of the path cost of several objects; the plan stays the same [s].

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
    _check_arguments(scenario, max_impacts, time_limit, proof)
    check_solver(solver)
    if proof:
        options, time_limit = replace(options, search=replace(options.search, proof=proof)), time_limit + proof
    read_demands(scenario, reserves.wall)  # formulas are refused in the user's words
    scenario = scenario.model_copy(update={"weights": ()})  # nothing is given up, and sub-tasks have other conjuncts
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
    central: Plan | None = None
    if options.central is not None:
        # Half of the time each: what cannot be hit through its centre is found out late.
        time_limit = 0.5 * time_limit
        with suppress(PlanningError):
            brief = replace(options, diagnosis=0.0)
            central = _plan_task(scenario, max_impacts, Budget(time_limit), solver, reserves, brief, work, frame)
    if central is None or central.robustness < (options.central or 0.0):
        try:
            plan = _plan_task(disc_scenario, max_impacts, Budget(time_limit), solver, reserves, options, work, frame)
        except PlanningError:
            if central is None:
                raise
            plan = central  # less robustness before none
    else:
        plan = central
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
    excluded: dict[tuple[int, ...], bool] = {}
    for attempt in _list_attempts(task, options, trials):
        if trials and budget.left <= 0.0:
            break
        if _exclude_pieces(task, attempt, trials, excluded, max_impacts, budget, options):
            continue
        shallow = best is not None and best.robustness < options.deep * best.bound
        if best is not None and not attempt.may_improve(len(scenario.objects) > 1, shallow):
            continue
        enough = options.enough * (1.0 if options.thorough else 0.5**attempt.halvings)
        few = options.few if attempt.few else None
        tried = replace(options, pieces=attempt.pieces, enough=enough, few=few, simple=attempt.simple)
        if options.thorough and (attempt.brisk or attempt.halvings):
            tried = replace(tried, enough_alone=options.enough_less)
        climber = _Climber(attempt.cut_reserves(task, options), max_impacts, budget, tried, hurry=best is not None)
        try:
            plan = climber.climb()
        except PlanningError as error:
            trials.append(Trial(attempt, error, climber.rho))
            continue
        if best is None or plan.robustness > best.robustness:
            best = plan
        shallow = bool(attempt.simple) and best.robustness < options.deep * best.bound
        satisfying = climber.rho is None or plan.robustness >= options.satisfying * climber.rho
        if not options.thorough or (satisfying and not shallow):
            break
        trials.append(Trial(attempt, climber.failure, climber.rho))
    if best is not None:
        return best
    if not options.thorough:
        failure = trials[0].error
        assert failure is not None
        raise failure
    hardest = max((trial.attempt for trial in trials), key=lambda attempt: (attempt.halvings, attempt.brisk))
    least = hardest.cut_reserves(task, options)
    complete = budget.left > 0.0
    verdict = judge_trials(trials, least, max_impacts, budget, complete)
    raise _explain(verdict, least, max_impacts, budget, options)


def _exclude_pieces(
    task: NominalTask,
    attempt: Attempt,
    trials: list[Trial],
    excluded: dict[tuple[int, ...], bool],
    max_impacts: int,
    budget: Budget,
    options: PlanOptions,
) -> bool:
    """Return whether no attempt with so many pieces has a plan; a proof for the least reserves is added to the trials.

    It is tried once for every number of pieces, and where all attempts so far were proofs: a task without a plan is
    then told by one model instead of six, and there is time for every number of pieces.
    """
    scenario, pieces = task.scenario, attempt.pieces
    alone = len(scenario.objects) == 1 and not scenario.starts_moving
    if not options.thorough or not alone or not trials or not all(trial.is_proof for trial in trials):
        return False
    if pieces not in excluded:
        least = attempt.cut_to_least(task, options)
        with budget.stage("screening"):
            limit, most = options.proof_share * budget.left, max(pieces)
            # So many pieces allow all that half or a third of them do.
            tried = [number for number in pieces if number == most or most % number]
            excluded[pieces] = all(is_excluded(least, number, max_impacts, options.least, limit) for number in tried)
        if excluded[pieces]:
            status = f"proven infeasible with up to {max_impacts} impacts and the least of the planner's reserves"
            failure = Infeasible(f"plan of {scenario.name}", status, "allow more impacts or time")
            trials.append(Trial(Attempt(pieces, options.halvings), failure))
    return excluded[pieces]


def _list_attempts(task: NominalTask, options: PlanOptions, trials: Sequence[Trial]) -> Iterator[Attempt]:
    """Yield the attempts in the order in which they are made.

    Several objects are first tried with few impacts and each of the reserves: to exclude all the other numbers takes
    long where the reserves leave no room. Of these attempts those come first in which objects are moved as each would
    be alone, or one after another: that takes seconds, and less reserves often suffice where longer sequences would
    have to be searched with all of them. Where the event grid has no plan, robots whose thrust limits their legs may
    take longer to become faster. Legs get more pieces where it has no plan without: first as many as the shortest ways
    round obstacles have, with each of the reserves; when these have failed as well, all other numbers.
    """
    needed = count_pieces(task.scenario, task.demands, task.reserves.wall) if options.thorough else None
    more = range(max(options.pieces) + 1, options.most_pieces + 1) if options.thorough else ()
    first = [pieces for pieces in more if needed is not None and needed <= pieces <= needed + 1]
    first = first if needed is not None and needed > max(options.pieces) else []
    several = options.thorough and options.few is not None and len(task.scenario.objects) > 1
    kinds = [(True, True), (True, False), (False, None)] if several else [(False, None)]
    for (few, simple), halvings in itertools.product(kinds, range(options.halvings + 1)):
        attempt = Attempt(options.pieces, halvings, few, simple=simple)
        yield from _skip_proven(attempt, trials)
        if trials and trials[-1].rho is None:
            if options.thorough and attempt.is_slow(task):
                yield from _skip_proven(replace(attempt, brisk=True), trials)
            for number in first:
                yield from _skip_proven(replace(attempt, pieces=(number,)), trials)
    if all(trial.rho is None for trial in trials):
        rest = [(pieces,) for pieces in more if pieces not in first]
        for halvings, pieces in itertools.product(range(options.halvings + 1), rest):
            attempt = Attempt(pieces, halvings)
            yield from (attempt, replace(attempt, brisk=True)) if attempt.is_slow(task) else (attempt,)


def _skip_proven(attempt: Attempt, trials: Sequence[Trial]) -> Iterator[Attempt]:
    """Yield the attempt, unless some object has no plan even alone: what takes longer does not change that."""
    before = replace(attempt, simple=True)
    known = [trial for trial in trials if trial.attempt == before and isinstance(trial.error, Infeasible)]
    if attempt.simple is not False or not known:
        yield attempt


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
            part = budget.share(self._find_time_to_search())
            optimum = search(task, self.max_impacts, part, options)
            self.rho = optimum.rho
            quick = None if optimum.found else quicken_legs(task, optimum, search, part, options)
        try:
            return self._finish(optimum, quick)
        except PlanningError:
            clock = get_clock()
            if not clock.stopped or not options.haste:
                raise
        # The search was interrupted; its impacts are worth a few seconds more.
        with use_clock(Clock(clock.read)):
            return plan_events(task, optimum, [], budget.share(options.haste), replace(options, thorough=False))

    def _find_time_to_search(self) -> float:
        """Return how long this attempt may look for impacts [s]."""
        options, left = self.options, self.budget.left
        if len(self.task.scenario.objects) == 1:
            return options.attempt_share * left
        if options.simple and left > options.kept * self.budget.limit:
            return options.simple_share * (left - options.kept * self.budget.limit)
        return options.joint_share * left

    def _finish(self, optimum: RobustnessOptimum, quick: tuple[NominalTask, RobustnessOptimum] | None) -> Plan:
        """Return a plan with the impacts that were found."""
        task, options, budget = self.task, self.options, self.budget
        if optimum.found is not None:
            return plan_composed(task, optimum, optimum.found, budget, options)
        if quick is not None:
            try:
                return plan_events(*quick, [], budget, options)
            except PlanningError:
                pass  # the plan with all reserves is left
        rough: list[Word] = []
        plans: list[Plan] = []
        try:
            if self.hurry and optimum.events is not None:
                rough.append(optimum.events.sequence.hitters)
                raise SolverFailed("smoothing", "there is a plan already", "raise the time limit")
            if optimum.events is not None and (optimum.size.pieces > MANY or optimum.words):
                return plan_long_ways(task, optimum, optimum.events, rough, budget, options)
            if options.thorough and optimum.events is not None:
                return plan_events(task, optimum, rough, budget, replace(options, words=1, turns=options.turns[:1]))
            return plan_events(task, optimum, rough, budget, options)
        except PlanningError as error:
            self.failure = error
            if not options.thorough:
                raise
        if self.hurry:
            with suppress(PlanningError):
                plans.append(plan_patiently(task, optimum, rough, self.failure, budget, options))
        elif not optimum.words and optimum.events is not None:
            # Where the motions are too quick, what they need is soon known; other sequences take longer to find.
            word = rough[0] if rough else optimum.events.sequence.hitters
            with suppress(PlanningError):
                plans.append(correct_word(task, optimum, word, budget, options))
            if not plans:
                with suppress(PlanningError):
                    plans.append(plan_events(task, optimum, rough, budget, options))
        if max((plan.robustness for plan in plans), default=0.0) < options.satisfying * optimum.rho:
            plans += self._plan_fewer(optimum)
        if not plans and self.hurry:
            raise self.failure
        if not plans:
            plans.append(plan_patiently(task, optimum, rough, self.failure, budget, options))
        return max(plans, key=lambda plan: plan.robustness)

    def _plan_fewer(self, optimum: RobustnessOptimum) -> list[Plan]:
        """Return the most robust plan with fewer impacts than a sequence that is too quick, if there is one."""
        hasty = replace(self.options, words=1, turns=self.options.turns[:1])
        for other in optimum.fewer:
            rough: list[Word] = []
            with suppress(PlanningError):
                return [plan_events(self.task, other, rough, self.budget, hasty)]
            for word in rough[:1]:
                with suppress(PlanningError):
                    return [correct_word(self.task, other, word, self.budget, self.options)]
        return []


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
        found = search(quick, optimum.size.impacts, budget.share(budget.left / 2), options)
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
    exists = "a plan exists" if _try_remedy(task, found, max_impacts, options) else "impacts would exist"
    return Infeasible(failure.problem, failure.status, f"{exists} with {' and '.join(map(str, found))}")


def _try_remedy(task: NominalTask, found: Sequence[Relaxation], max_impacts: int, options: PlanOptions) -> bool:
    """Return whether the task has a plan once its formula is loosened by what was found, and a little more."""
    amounts = list_amounts(task, found)
    if sum(amount > 0.0 for amount in amounts) < len(found):
        return False  # it takes faster robots
    room = options.remedy_room
    try:
        loose = loosen(task.scenario, [a / task.frame.length + room if a > 0.0 else 0.0 for a in amounts])
        tried = replace(task, scenario=loose, demands=read_demands(loose, task.reserves.wall))
        _Climber(tried, max_impacts, Budget(options.diagnosis), replace(options, thorough=False, few=None)).climb()
    except (PlanningError, InputError):
        return False
    return True


def _check_arguments(scenario: FreeFlyerScenario, max_impacts: int, time_limit: float, proof: float) -> None:
    if max_impacts < 0:
        raise InputError(f"max_impacts is {max_impacts}, it must not be negative")
    if not time_limit > 0:
        raise InputError(f"time_limit is {time_limit} s, it must be positive")
    if not proof >= 0:
        raise InputError(f"proof is {proof} s, it must not be negative")
    if proof and len(scenario.objects) < 2:
        raise InputError(f"proof is {proof} s: is for several objects; the path cost of one is proven without")
    if not scenario.objects:
        raise InputError(f"{scenario.name}: objects: this planner takes at least one, got none")
