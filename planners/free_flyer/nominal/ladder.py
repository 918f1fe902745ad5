"""Climb the ladder of attempts: which reserves, pieces and searches are tried in which order, and when it ends."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Budget, Work, get_clock
from planners.errors import Infeasible, PlanningError
from planners.free_flyer.frame import Frame
from planners.free_flyer.nominal.attempt import Attempt
from planners.free_flyer.nominal.climber import Climber
from planners.free_flyer.nominal.diagnosis import explain_failure
from planners.free_flyer.nominal.object_way import count_turns
from planners.free_flyer.nominal.screening import find_excluded_object, is_excluded
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.verdict import Trial, describe_reserves, judge_trials
from planners.free_flyer.nominal.ways import count_pieces
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound
from planners.plan import Plan


def climb_ladder(
    scenario: FreeFlyerScenario,
    max_impacts: int,
    budget: Budget,
    solver: str,
    reserves: Reserves,
    options: PlanOptions,
    work: Work | None,
    frame: Frame,
) -> Plan:
    """Climb the ladder of attempts until one gives a plan, see `list_attempts`."""
    demands = read_demands(scenario, reserves.wall)
    task = NominalTask(scenario, demands, reserves, solver, work, frame)
    if options.expected is not None:
        max_impacts = min(max_impacts, options.expected + 1)
    trials: list[Trial] = []
    best: Plan | None = None
    several = len(scenario.objects) > 1
    excluded: dict[tuple[int, ...], bool] = {}
    climbers: dict[Attempt, Climber] = {}
    for attempt in list_attempts(task, options, trials):
        if trials and budget.left <= 0.0:
            break
        if _exclude_pieces(task, attempt, trials, excluded, max_impacts, budget, options):
            continue
        shallow = best is not None and best.robustness < options.deep * best.bound
        if best is not None and not attempt.may_improve(several, shallow):
            continue
        tried = attempt.choose_options(options)
        if best is not None and not several:
            tried = replace(tried, least=max(options.least, best.robustness))
        full = replace(attempt, brief=False)
        climber = Climber(attempt.cut_reserves(task, options), max_impacts, budget, tried, hurry=best is not None)
        climber.brief, climber.guided = attempt.brief and not several, attempt.guided
        before = climbers.get(full)
        if not several and before is not None and before.optimum is not None and before.optimum.complete:
            climber.optimum = before.optimum
        climbers[full] = climber
        # What a brief attempt could not tell, this one does.
        trials[:] = [trial for trial in trials if trial.attempt != replace(full, brief=True)]
        try:
            plan = climber.climb()
        except PlanningError as error:
            trials.append(Trial(attempt, error, climber.rho))
            _exclude_object(task, attempt, trials, max_impacts, budget, options)
            continue
        if best is None or plan.robustness > best.robustness:
            best = plan
        shallow = bool(attempt.simple) and best.robustness < options.deep * best.bound
        if attempt.brief and climber.optimum is not None and not climber.optimum.complete:
            shallow = best.robustness < options.deep * best.bound
        satisfying = climber.rho is None or plan.robustness >= options.satisfying * climber.rho
        if not options.thorough or (satisfying and not shallow):
            if climber.brief and best is plan:
                best = _improve_plan(plan, climber, options)
            break
        trials.append(Trial(attempt, climber.failure, climber.rho))
    if best is None and get_clock().stopped and options.haste:
        best = _plan_hastily([*climbers.values()][-options.hasty :])
    if best is not None:
        return best
    if not options.thorough:
        failure = trials[0].error
        assert failure is not None
        raise failure
    hardest = max((trial.attempt for trial in trials), key=Attempt.rank)
    least = hardest.cut_reserves(task, options)
    complete = budget.left > 0.0
    verdict = judge_trials(_drop_undecided(trials) or trials, least, max_impacts, budget, complete)
    # What to loosen is told within a few seconds more than there were.
    options = replace(options, diagnosis=min(options.diagnosis, max(budget.left, options.haste)))
    raise explain_failure(verdict, least, max_impacts, budget, options)


def _improve_plan(plan: Plan, climber: Climber, options: PlanOptions) -> Plan:
    """Return a more robust plan with as much in reserve, or the plan of a brief attempt, if it leaves nothing open."""
    optimum, budget = climber.optimum, climber.budget
    if optimum is None or optimum.complete or plan.robustness >= options.enough * plan.bound or budget.left <= 0.0:
        return plan
    longer = replace(climber.options, pauses=None, least=max(options.least, plan.robustness))
    longest = options.improve_share * budget.limit
    again = Climber(climber.task, climber.max_impacts, budget, longer, brief=True, longest=longest)
    again.fewest = optimum.size.impacts
    with suppress(PlanningError):
        other = again.climb()
        return other if other.robustness > plan.robustness else plan
    return plan


def _plan_hastily(climbers: Sequence[Climber]) -> Plan | None:
    """Return a plan with the latest impacts of attempts that were interrupted, if there are smooth motions for them."""
    for climber in reversed(climbers):
        with suppress(PlanningError):
            return climber.plan_hastily()
    return None


def _exclude_object(
    task: NominalTask, attempt: Attempt, trials: Sequence[Trial], max_impacts: int, budget: Budget, options: PlanOptions
) -> None:
    """Raise if one of several objects is proven to have no plan even alone.

    It is tried once, where the first attempt has told that some object needs more than few impacts.

    Raises:
        Infeasible: proven, for any number of pieces a leg and the least of all reserves.
    """
    scenario = task.scenario
    if not options.thorough or len(scenario.objects) == 1 or scenario.starts_moving or budget.left <= 0.0:
        return
    if len(trials) > 1 or trials[0].rho is not None or not isinstance(trials[0].error, Infeasible):
        return
    least = attempt.cut_to_least(task, options)
    with budget.stage("screening"):
        name = find_excluded_object(least, max_impacts, options.least, options.proof_share * budget.left)
    if name is None:
        return
    way = f"{name} has no plan with up to {max_impacts} impacts, not even alone and with nothing in the way of robots"
    status = f"proven infeasible: {way}, and {describe_reserves(least, options.halvings)}"
    failure = Infeasible(f"plan of {scenario.name}", status, "allow more time, move the areas, or relax the formula")
    raise explain_failure(failure, least, max_impacts, budget, options)


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
    if attempt.slanted or attempt.guided:
        return False
    scenario, pieces = task.scenario, attempt.pieces
    alone = len(scenario.objects) == 1 and not scenario.starts_moving
    decided = trials if attempt.brief else _drop_undecided(trials)
    if not options.thorough or not alone or not decided or not all(trial.is_proof for trial in decided):
        return False
    if pieces not in excluded:
        least = attempt.cut_to_least(task, options)
        with budget.stage("screening"):
            limit, most = options.proof_share * budget.left, max(pieces)
            # So many pieces allow all that half or a third of them do.
            tried = [number for number in pieces if number == most or most % number]
            rho = options.least, compute_geometric_bound(scenario, least.demands, least.solver)
            excluded[pieces] = all(is_excluded(least, number, max_impacts, rho, limit) for number in tried)
        if excluded[pieces]:
            status = f"proven infeasible with up to {max_impacts} impacts and the least of the planner's reserves"
            failure = Infeasible(f"plan of {scenario.name}", status, "allow more impacts or time")
            trials.append(Trial(Attempt(pieces, options.halvings), failure))
    return excluded[pieces]


def _drop_undecided(trials: Sequence[Trial]) -> list[Trial]:
    """Return the attempts but for brief ones that found no impacts and excluded none."""
    return [one for one in trials if one.is_proof or one.rho is not None or not one.attempt.brief]


def list_attempts(task: NominalTask, options: PlanOptions, trials: Sequence[Trial]) -> Iterator[Attempt]:
    """Yield the attempts in the order in which they are made.

    Several objects are first tried with few impacts and each of the reserves, briefly at first: to exclude all the
    other numbers takes long where the reserves leave no room. Of these attempts those come first in which objects are
    moved as each would be alone, or one after another: that takes seconds, and less reserves often suffice where longer
    sequences would have to be searched with all of them. Where the event grid has no plan, robots whose thrust limits
    their legs may take longer to become faster. Legs get more pieces where it has no plan without: first as many as the
    shortest ways round obstacles have, with each of the reserves; when these have failed as well, all other numbers.

    One object is first tried briefly with each of the reserves, for the same reason, and then with bodies that may pass
    each other at a slant: with the least reserves, and with those for which the brief attempts proved nothing. Where
    its shortest way turns, hits near these turns are tried before that; where it turns often, first of all.
    """
    needed = count_pieces(task.scenario, task.demands, task.reserves.wall) if options.thorough else None
    more = range(max(options.pieces) + 1, options.most_pieces + 1) if options.thorough else ()
    first = [pieces for pieces in more if needed is not None and needed <= pieces <= needed + 1]
    first = first if needed is not None and needed > max(options.pieces) else []
    several = options.thorough and options.few is not None and len(task.scenario.objects) > 1
    kinds = [Attempt(options.pieces)]
    turns = count_turns(task.scenario, task.demands, task.reserves.wall) if options.thorough else 0
    if several:
        # Where an object alone needs more impacts than few, what is simple is tried with any number of them.
        simple = Attempt(options.pieces, few=True, simple=True)
        kinds = [replace(simple, brief=True), simple, replace(simple, few=False), replace(simple, simple=False), *kinds]
    elif options.thorough and len(task.scenario.objects) == 1:
        kinds = [Attempt(options.pieces, brief=True), *kinds]
    for kind, halvings in itertools.product(kinds, range(options.halvings + 1)):
        attempt, last = replace(kind, halvings=halvings), halvings == options.halvings
        if kind.simple and not kind.few and not _needs_many(halvings, trials):
            continue
        if kind.brief and turns >= options.many_turns:
            yield from _list_guided(task, options, halvings)
        yield from _skip_proven(attempt, trials)
        if trials and trials[-1].rho is None:
            if options.thorough and attempt.is_slow(task) and not kind.simple:
                yield from _skip_proven(replace(attempt, brisk=True), trials)
            for number in first:
                longer = replace(attempt, pieces=(number,), brief=kind.brief and several)
                if not any(trial.attempt == longer for trial in trials):
                    yield from _skip_proven(longer, trials)
        if last and kind.simple and not kind.brief and all(trial.rho is None for trial in trials):
            # Half of the reserves more often suffice than robots that take longer to become faster.
            slow = (replace(kind, halvings=less) for less in range(options.halvings + 1))
            yield from (replace(one, brisk=True) for one in slow if one.is_slow(task))
        if last and kind.brief and not several:
            if 0 < turns < options.many_turns:
                for less in range(options.halvings + 1):
                    yield from _list_guided(task, options, less)
            slants = [replace(kind, halvings=less, pieces=options.slanted_pieces) for less in range(halvings, -1, -1)]
            proven = {trial.attempt.halvings for trial in trials if trial.is_proof} - {halvings}
            yield from (replace(one, slanted=True) for one in slants if one.halvings not in proven)
    if len(task.scenario.objects) == 1 or all(trial.rho is None for trial in trials):
        rest = [(pieces,) for pieces in more if pieces not in first]
        for halvings, pieces in itertools.product(range(options.halvings + 1), rest):
            attempt = Attempt(pieces, halvings)
            yield from (attempt, replace(attempt, brisk=True)) if attempt.is_slow(task) else (attempt,)


def _list_guided(task: NominalTask, options: PlanOptions, halvings: int) -> Iterator[Attempt]:
    """Yield the attempts in which the only object is hit near the turns of its shortest way."""
    attempt = Attempt(options.guided_pieces, halvings, brief=True, guided=True)
    yield attempt
    if attempt.is_slow(task):
        yield replace(attempt, brisk=True)


def _needs_many(halvings: int, trials: Sequence[Trial]) -> bool:
    """Return whether some object alone has no plan with few impacts and so much of the reserves."""
    alone = [trial for trial in trials if trial.attempt.few and trial.attempt.simple]
    return any(one.attempt.halvings == halvings and isinstance(one.error, Infeasible) for one in alone)


def _skip_proven(attempt: Attempt, trials: Sequence[Trial]) -> Iterator[Attempt]:
    """Yield the attempt, unless a shorter one has shown that it fails: more time does not change that."""
    before = replace(attempt, brief=True) if attempt.simple is None else replace(attempt, simple=True)
    known = [trial for trial in trials if trial.attempt == before and isinstance(trial.error, Infeasible)]
    if attempt == before or not any(attempt.simple is False or trial.is_proof for trial in known):
        yield attempt
