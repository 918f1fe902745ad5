"""Why a scenario has no plan: the smallest relaxation that gives it one."""

from __future__ import annotations

from dataclasses import dataclass

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.errors import PlanningError
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.event_grid import build_event_grid
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.formula_rows import add_demands
from planners.free_flyer.specification.requirement import Demands
from planners.mixed_integer import Affine
from planners.solvers import solve

GAP = 0.05  # to which the smallest relaxation is found
NEGLIGIBLE = 1e-4  # [m]


@dataclass(frozen=True)
class Relaxation:
    """Hold what to loosen.

    Args:
        part: conjunct of the formula, or speed of a body.
        amount: by how much [m]; of a speed: further than it goes on one leg.
    """

    part: str
    amount: float

    def __str__(self) -> str:
        if self.part.startswith("speed of "):
            return f"{self.amount:.2g} m more per leg within reach of {self.part.removeprefix('speed of ')}"
        return f"'{self.part}' loosened by {self.amount:.2g} m"


def find_relaxation(
    scenario: FreeFlyerScenario,
    demands: Demands,
    max_impacts: int,
    rho: float,
    reserves: Reserves,
    time_limit: float,
    solver: str = "highs",
) -> tuple[Relaxation, ...]:
    """Return the parts of a scenario that together need the least loosening for a plan to exist.

    Every conjunct and the speed of every body gets a slack variable; the sum of all is least, over the numbers of
    impacts that the time limit admits. Times and distances between bodies stay as they are.

    Args:
        scenario: without a plan.
        demands: its demands.
        max_impacts: greatest number of impacts tried.
        rho: robustness that is wanted [m].
        reserves: what the plan keeps in hand.
        time_limit: wall time [s].
        solver: of mixed-integer models.

    Returns:
        What to loosen, most first; nothing if no relaxation was found, or none is needed.
    """
    best: dict[str, float] = {}
    least = float("inf")
    for impacts in range(max_impacts + 1):
        try:
            grid = build_event_grid(scenario, impacts, (rho, rho), reserves, elastic=True)
            add_demands(grid, demands, scenario.control_period, passing=True)
            model = grid.model
            model.objective = sum(model.slacks.values(), Affine({}))
            limit = time_limit / (max_impacts + 1)
            x = solve_apart(grid, scenario, reserves, lambda: solve(model, limit, GAP, solver).x)  # noqa: B023
        except PlanningError:
            continue
        total = model.objective.value(x)
        if total < 0.9 * least:
            least = total
            best = {part: slack.value(x) for part, slack in model.slacks.items()}
    found = [Relaxation(part, amount) for part, amount in best.items() if amount > NEGLIGIBLE]
    return tuple(sorted(found, key=lambda relaxation: -relaxation.amount))
