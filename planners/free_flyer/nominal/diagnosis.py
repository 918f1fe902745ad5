"""Why a scenario has no plan: the smallest relaxation that gives it one, tried before it is said."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from impact_envs.errors import InputError
from impact_envs.stl import Predicate
from planners.budget import Budget, read_clock
from planners.errors import Infeasible, PlanningError
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.climber import Climber
from planners.free_flyer.nominal.object_way import find_most_impacts
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.ways import count_pieces
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.loosening import list_conjuncts, loosen, soften
from planners.free_flyer.specification.requirement import Demands, read_demands
from planners.mixed_integer import Affine, Model
from planners.solvers import solve

GAP = 0.05  # to which the smallest relaxation is found, relative
NEGLIGIBLE = 1e-4  # relaxations that are not worth a word [m]


@dataclass(frozen=True)
class Relaxation:
    """Hold what to loosen.

    Args:
        part: conjunct of the formula, or "speed of" a body.
        amount: by how much [m]; of a speed: additional way on one leg [m].
        given_up: whether so much leaves nothing of the conjunct.
    """

    part: str
    amount: float
    given_up: bool = False

    def __str__(self) -> str:
        if self.part.startswith("speed of "):
            return f"{self.amount:.2g} m more per leg within reach of {self.part.removeprefix('speed of ')}"
        if self.given_up:
            return f"'{self.part}' given up"
        return f"'{self.part}' loosened by {self.amount:.2g} m"


def find_relaxation(
    task: NominalTask,
    max_impacts: int,
    rho: float,
    time_limit: float,
    pieces: int = 1,
    weights: Sequence[float] | None = None,
) -> tuple[Relaxation, ...]:
    """Return the parts of a scenario that together need the least loosening for a plan to exist.

    Every conjunct and the speed of every body gets a slack variable; the weighted sum of all slacks is least, over the
    numbers of impacts that the time limit admits. Times and distances between bodies stay as they are, and solid
    obstacles still stop bodies. An area to avoid is never loosened by more than it is deep.

    Args:
        task: without a plan.
        max_impacts: greatest number of impacts tried.
        rho: robustness that is wanted [m].
        time_limit: wall time [s].
        pieces: per leg.
        weights: of the conjuncts; speeds then stay as they are. None: all count the same, speeds too.

    Returns:
        What to loosen, most first; empty if no relaxation was found, or none is needed.
    """
    soft, demands = soften(task.scenario, task.reserves.wall)
    prices = dict(zip(demands.conjuncts, weights or itertools.repeat(1.0), strict=False))
    soft_task = replace(task, scenario=soft, demands=demands)
    best: dict[str, float] = {}
    least, end = float("inf"), read_clock() + time_limit
    for impacts in range(max_impacts + 1):
        limit = (end - read_clock()) / (max_impacts + 1 - impacts)
        if limit <= 0.0 or least < NEGLIGIBLE:
            break
        try:
            size = GridSize(impacts, pieces, passing=True)
            grid, _ = soft_task.build(size, (rho, rho), elastic=True, loose_speeds=weights is None)
            model = grid.model
            model.objective = sum((slack * prices.get(part, 1.0) for part, slack in model.slacks.items()), Affine({}))
            point = partial(_solve_point, model, limit, task.solver)
            x = solve_apart(grid, task.scenario, task.reserves, point)
        except PlanningError:
            continue
        total = model.objective.value(x)
        if total < 0.9 * least:
            least = total
            best = {part: slack.value(x) for part, slack in model.slacks.items()}
    return tuple(sorted(_tell(task, demands, best), key=lambda relaxation: -relaxation.amount))


def list_amounts(task: NominalTask, found: Sequence[Relaxation]) -> list[float]:
    """Return by how much each conjunct of a task's formula is loosened, in their order, in the user's units [m]."""
    wanted = {relaxation.part: relaxation.amount for relaxation in found}
    told = [task.frame.leave_formula(str(conjunct)) for conjunct in list_conjuncts(task.scenario)]
    return [wanted.get(text, 0.0) for text in told]


def _tell(task: NominalTask, demands: Demands, amounts: dict[str, float]) -> Iterator[Relaxation]:
    """Yield what is loosened: conjuncts as the user wrote them, lengths in the user's units."""
    length = task.frame.length
    for part, amount in amounts.items():
        if amount > NEGLIGIBLE:
            deepest = _measure_depth(demands, part)
            said = task.frame.leave_formula(part) if part in demands.conjuncts else part
            yield Relaxation(said, min(amount, deepest) * length, amount >= deepest - NEGLIGIBLE)


def _measure_depth(demands: Demands, part: str) -> float:
    """Return by how much a conjunct is loosened until nothing is left of it [m]: it only asks to avoid areas."""
    if part not in demands.conjuncts:
        return math.inf
    leaves = [node for node in demands.conjuncts[part].walk() if isinstance(node, Predicate)]
    depths = [demands.predicates[leaf].depth for leaf in leaves]
    return max((math.inf if depth is None else depth for depth in depths), default=math.inf)


def _solve_point(model: Model, time_limit: float, solver: str) -> np.ndarray:
    return solve(model, time_limit, GAP, solver).x


def explain_failure(
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
    few = max_impacts < find_most_impacts(task.scenario)  # somebody chose fewer
    more = f"allow more impacts (--max-impacts {max_impacts + 1} or more); " * few
    return Infeasible(failure.problem, failure.status, f"{more}{exists} with {' and '.join(map(str, found))}")


def _try_remedy(task: NominalTask, found: Sequence[Relaxation], max_impacts: int, options: PlanOptions) -> bool:
    """Return whether the task has a plan once its formula is loosened by what was found, and a little more."""
    amounts = list_amounts(task, found)
    if sum(amount > 0.0 for amount in amounts) < len(found):
        return False  # it takes faster robots
    room = options.remedy_room
    try:
        loose = loosen(task.scenario, [a / task.frame.length + room if a > 0.0 else 0.0 for a in amounts])
        tried = replace(task, scenario=loose, demands=read_demands(loose, task.reserves.wall))
        Climber(tried, max_impacts, Budget(options.diagnosis), replace(options, thorough=False, few=None)).climb()
    except (PlanningError, InputError):
        return False
    return True
