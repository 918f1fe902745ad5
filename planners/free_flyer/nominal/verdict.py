"""What is said of a task without a plan: proven, with every restriction named, or not found, with what was tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planners.budget import Budget, count_things, get_clock
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.attempt import Attempt
from planners.free_flyer.nominal.object_way import find_most_impacts
from planners.free_flyer.nominal.task import NominalTask

SHARES = {0: "all", 1: "half", 2: "a quarter"}  # of the reserves that are left when they were halved so often


@dataclass(frozen=True)
class Trial:
    """Hold an attempt without a plan.

    Args:
        attempt: what was tried.
        error: why there is no plan, or only one of less robustness; None: only the event grid knows.
        rho: robustness of sequences of impacts that exist, but have no smooth motions; None: none were found [m].
    """

    attempt: Attempt
    error: PlanningError | None
    rho: float | None = None

    @property
    def is_proof(self) -> bool:
        """Return whether the event grid is proven to have no such plan."""
        return self.rho is None and not self.attempt.few and isinstance(self.error, Infeasible)


def judge_trials(
    trials: Sequence[Trial], task: NominalTask, max_impacts: int, budget: Budget, complete: bool
) -> PlanningError:
    """Return what attempts without a plan say about the task.

    Args:
        trials: in their order.
        task: with the least reserves tried.
        max_impacts: greatest number of impacts tried.
        budget: time.
        complete: whether nothing was left to try.

    Returns:
        `Infeasible` if all attempts are proofs, else `SolverFailed`.
    """
    problem, most = f"plan of {task.scenario.name}", max(max(trial.attempt.pieces) for trial in trials)
    full = [trial for trial in trials if not trial.attempt.few]  # few impacts prove nothing of many
    exists = any(trial.rho is not None for trial in trials)
    if complete and full and not exists and all(trial.is_proof for trial in full):
        status = f"proven infeasible {_name_size(max_impacts, most)}"
        remedy = "allow more impacts (--max-impacts) or time, move the areas, or relax the formula"
        return Infeasible(problem, f"{status} and {describe_reserves(task, trials[-1].attempt.halvings)}", remedy)
    late = budget.left <= 0.0 or any(trial.error and "time limit" in trial.error.status for trial in trials)
    done = "" if task.work is None else f" ({task.work.done:.0f} units of work done)"
    limit = f"the time limit of {budget.limit:g} s{done}" if late else "these numbers of impacts, pieces and reserves"
    if get_clock().stopped:
        limit = f"the {budget.seconds:.3g} s until it was interrupted{done}"
    tried = f"{_name_size(max_impacts, most)} and {_name_reserves(trials)}"
    status = (
        f"no plan found, and none excluded, within {limit}: tried {tried}; {_describe_failures(trials, task, late)}"
    )
    more = f"allow more impacts (--max-impacts {max_impacts + 1} or more)"
    few = max_impacts < find_most_impacts(task.scenario)  # somebody chose fewer
    remedy = f"raise the time limit (--time-limit){f', {more}' * few}" if late else f"{more} or a longer horizon"
    return SolverFailed(problem, status, f"{remedy}, give robots more thrust, or relax the formula")


def _name_size(impacts: int, pieces: int) -> str:
    return f"with up to {count_things(impacts, 'impact')}, {count_things(pieces, 'straight piece')} a leg"


def describe_share(halvings: int) -> str:
    """Return which share of the reserves is left when they were halved so often, in words."""
    return SHARES.get(halvings, f"1/{2**halvings}")


def describe_reserves(task: NominalTask, halvings: int) -> str:
    """Return the reserves that a plan must keep, in words and in the user's units."""
    reserves, length = task.reserves, task.frame.length
    first, gap, last = reserves.times(task.scenario.horizon)
    return (
        f"{describe_share(halvings)} of the planner's reserves: {reserves.clearance * length:.3g} m between bodies, "
        f"{reserves.wall * length:.3g} m from walls, {reserves.run_up * length:.3g} m behind a robot that hits, "
        f"impacts that move an object by {reserves.push * length:.3g} m or more, "
        f"{first:.3g} s before, {gap:.3g} s between and "
        f"{last:.3g} s after impacts, robots' legs at {100 * reserves.speed:.0f} % of the speed limit, or what they "
        f"reach within {reserves.turn:g} s"
    )


def _name_reserves(trials: Sequence[Trial]) -> str:
    names = list(dict.fromkeys(describe_share(trial.attempt.halvings) for trial in trials))
    return f"{' or '.join(names)} of the planner's reserves"


def _describe_failures(trials: Sequence[Trial], task: NominalTask, late: bool) -> str:
    rough = [trial.rho for trial in trials if trial.rho is not None]
    if rough:
        best = max(rough) * task.frame.length
        why = (
            "no smooth motions were found for them in time" if late else "robots are not quick enough for their motions"
        )
        return f"impacts of robustness {best:.3g} m exist, but {why}"
    if any(trial.is_proof for trial in trials):
        return "the numbers that could be decided are infeasible"
    return "none of the numbers of impacts could be decided"
