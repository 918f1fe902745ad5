"""A quick proof that a task has no plan: not even one in which bodies pass through each other."""

from __future__ import annotations

import math

from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound
from planners.solvers import solve


def screen_task(task: NominalTask, max_impacts: int, options: PlanOptions) -> None:
    """Raise if a task is proven to have no plan.

    The model of all plans of a size, without distances and with objects that may change their velocity while another
    one is hit, has a point if there is a plan; two pieces per leg allow all that one does. Most tasks of which nothing
    is left to save are told by that, before the objects are planned one by one and their sequences compared.

    Args:
        task: what is asked.
        max_impacts: greatest number of impacts tried.
        options: of the search.

    Raises:
        Infeasible: no plan.
        OutOfWork: no more work is allowed.
    """
    ceiling = max(compute_geometric_bound(task.scenario, task.demands, task.solver), options.least)
    for impacts in options.order_numbers(0, max_impacts):
        size = GridSize(impacts, max(options.pieces), passing=True)
        try:
            grid, _ = task.build(size, (options.least, ceiling))
            solve(grid.model, math.inf, math.inf, task.solver, work=task.work)
        except Infeasible:
            continue
        except SolverFailed:  # nothing is proven within the nodes allowed
            return
        return
    status = f"proven infeasible with up to {max_impacts} impacts and the planner's reserves"
    raise Infeasible(f"plan of {task.scenario.name}", status, "allow more impacts or time, or relax the formula")
