"""Why a scenario has no plan: the smallest relaxation that gives it one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from planners.errors import PlanningError
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.task import NominalTask
from planners.free_flyer.specification.grid import GridSize
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
    """

    part: str
    amount: float

    def __str__(self) -> str:
        if self.part.startswith("speed of "):
            return f"{self.amount:.2g} m more per leg within reach of {self.part.removeprefix('speed of ')}"
        return f"'{self.part}' loosened by {self.amount:.2g} m"


def find_relaxation(
    task: NominalTask, max_impacts: int, rho: float, time_limit: float, pieces: int = 1
) -> tuple[Relaxation, ...]:
    """Return the parts of a scenario that together need the least loosening for a plan to exist.

    Every conjunct and the speed of every body gets a slack variable; the sum of all slacks is least, over the numbers
    of impacts that the time limit admits. Times and distances between bodies stay as they are.

    Args:
        task: without a plan.
        max_impacts: greatest number of impacts tried.
        rho: robustness that is wanted [m].
        time_limit: wall time [s].
        pieces: per leg.

    Returns:
        What to loosen, most first; empty if no relaxation was found, or none is needed.
    """
    best: dict[str, float] = {}
    least = float("inf")
    for impacts in range(max_impacts + 1):
        try:
            grid, _ = task.build(GridSize(impacts, pieces, passing=True), (rho, rho), elastic=True)
            model = grid.model
            model.objective = sum(model.slacks.values(), Affine({}))
            limit = time_limit / (max_impacts + 1)
            point = partial(_solve_point, model, limit, task.solver)
            x = solve_apart(grid, task.scenario, task.reserves, point)
        except PlanningError:
            continue
        total = model.objective.value(x)
        if total < 0.9 * least:
            least = total
            best = {part: slack.value(x) for part, slack in model.slacks.items()}
    # Conjuncts are told as the user wrote them, and lengths in the user's units.
    said = {text: task.frame.leave_formula(text) for text in task.demands.conjuncts}
    found = [
        Relaxation(said.get(part, part), amount * task.frame.length)
        for part, amount in best.items()
        if amount > NEGLIGIBLE
    ]
    return tuple(sorted(found, key=lambda relaxation: -relaxation.amount))


def _solve_point(model: Model, time_limit: float, solver: str) -> np.ndarray:
    return solve(model, time_limit, GAP, solver).x
