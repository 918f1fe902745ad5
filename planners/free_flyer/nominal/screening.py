"""Quick proofs that a task has no plan: by places, times and speeds alone, or even where nothing is in the way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_envs.stl import Predicate
from planners.budget import count_things, read_clock
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.frame import find_frame
from planners.free_flyer.impossibility.reach import Kept
from planners.free_flyer.impossibility.reason import find_impossibility
from planners.free_flyer.nominal.attempt import Attempt
from planners.free_flyer.nominal.several_objects.sequence_search import restrict_to_object
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.verdict import describe_share
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import Demands, read_demands
from planners.free_flyer.specification.robustness_bound import compute_bounds, compute_geometric_bound
from planners.solvers import solve


def refuse_impossible(task: NominalTask, max_impacts: int, options: PlanOptions) -> None:
    """Raise if places, times and speeds alone tell why a task has no plan.

    What no plan of any kind can do is told first, then what none can do that keeps the least of the reserves.

    Args:
        task: in the user's units, with all reserves.
        max_impacts: greatest number of impacts.
        options: how far reserves are cut.

    Raises:
        Infeasible: no plan; says why, with names and numbers.
    """
    problem, scenario, length = f"plan of {task.scenario.name}", task.scenario, find_frame(task.scenario).length
    least = Attempt((1,), options.halvings).cut_reserves(task, options).reserves
    first, gap, _ = least.times(scenario.horizon)
    kept = Kept(least.wall * length, min(first, gap) if scenario.starts_moving else first)
    share = describe_share(options.halvings)
    in_hand = (
        f" (with {share} of the planner's reserves: {kept.wall:.3g} m from walls, {kept.first:.3g} s before impacts)"
    )
    for reserves, told in ((Kept(), ""), (kept, in_hand)):
        why = find_impossibility(scenario, task.demands, max_impacts, reserves)
        if why is not None:
            raise Infeasible(problem, f"proven infeasible: {why.reason}{told}", why.remedy)


def refuse_low_bound(task: NominalTask, options: PlanOptions) -> None:
    """Raise if fixed starts, goals and areas leave some conjunct of a formula less than the least robustness.

    Raises:
        Infeasible: no plan; names the conjunct.
    """
    for text, bound in compute_bounds(task.scenario, task.demands, task.solver).items():
        if bound < options.least:
            said, most = task.frame.leave_formula(text), bound * task.frame.length + 0.0
            disc = " with polygons as the discs around them" if task.scenario.has_polygons else ""
            told = f"fixed starts, goals and areas{disc} allow '{said}' a robustness of {most:.3g} m at most"
            status = f"proven infeasible: {told}, and plans have {options.least * task.frame.length:.3g} m or more"
            raise Infeasible(f"plan of {task.scenario.name}", status, "move them, or relax the formula")


def exclude_size(task: NominalTask, size: GridSize, rho: tuple[float, float], time_limit: float) -> None:
    """Raise if there is no plan of a size even where nothing is in the way.

    Without the rows that keep bodies away from areas and from each other a model has a point if there is a plan; it has
    hardly an alternative to branch on. Times, ways and speeds alone exclude most sizes that have no plan.

    Args:
        task: what is asked.
        size: of the grid.
        rho: least and greatest robustness [m].
        time_limit: of the solution [s].

    Raises:
        Infeasible: no plan.
    """
    free = [predicate for predicate, need in task.demands.predicates.items() if need.kind != "stay"]
    easy = replace(task, demands=replace(_drop_predicates(task.demands, free), solids=()))
    grid, _ = easy.build(size, rho)
    try:
        solve(grid.model, time_limit, math.inf, task.solver, work=task.work, nodes=task.easy_nodes)
    except SolverFailed:  # nothing is proven
        return


def _drop_predicates(demands: Demands, dropped: Sequence[Predicate]) -> Demands:
    """Return demands of which some predicates hold everywhere."""
    free = {"kind": "stay", "faces": np.zeros((0, 2)), "bounds": np.zeros(0), "others": {}}
    freed = {one: replace(demands.predicates[one], **free) for one in dropped}  # type: ignore[arg-type]
    return replace(demands, predicates={**demands.predicates, **freed})


def find_excluded_object(task: NominalTask, max_impacts: int, least: float, time_limit: float) -> str | None:
    """Return an object that is proven to have no plan, even where it is alone and nothing is in the way of robots.

    Robots that pass through everything fly straight, so the proof holds for any number of pieces per leg and wherever
    the other objects are. What is asked of robots is left out.

    Args:
        task: several objects that start at rest, with the least reserves of which the proof is to tell.
        max_impacts: greatest number of impacts.
        least: robustness that a plan must have [m].
        time_limit: of all proofs together [s].

    Returns:
        Its name; None: none is proven.
    """
    end = read_clock() + time_limit
    for name in task.scenario.objects:
        scenario = restrict_to_object(task.scenario, name)
        if scenario is None:
            continue
        demands = read_demands(scenario, task.reserves.wall)
        ceiling = compute_geometric_bound(scenario, demands, task.solver)
        alone = _free_robots(replace(task, scenario=scenario, demands=demands, proof_nodes=task.alone_nodes))
        if is_excluded(alone, 1, max_impacts, (least, ceiling), end - read_clock()):
            return name
    return None


def _free_robots(task: NominalTask) -> NominalTask:
    """Return the task of one object whose robots pass through everything, and of which nothing is asked."""
    (name,), demands = task.scenario.objects, task.demands
    others = [one for one, need in demands.predicates.items() if not set(need.bodies) <= {name}]
    freed = _drop_predicates(demands, others)
    return replace(task, demands=replace(freed, solids=tuple(need for need in demands.solids if need.body == name)))


def is_size_excluded(task: NominalTask, size: GridSize, rho: tuple[float, float], time_limit: float) -> bool:
    """Return whether the only object is proven to have no plan of a size even with nothing in the way of robots.

    Args:
        task: what is asked.
        size: of the grid, with one piece a leg: robots that pass through everything fly straight.
        rho: least and greatest robustness [m].
        time_limit: of the solution [s].
    """
    try:
        grid, _ = _free_robots(task).build(size, rho)
        solve(grid.model, time_limit, math.inf, task.solver, work=task.work, nodes=task.easy_nodes)
    except Infeasible:
        return True
    except SolverFailed:  # nothing is proven
        pass
    return False


def is_excluded(task: NominalTask, pieces: int, max_impacts: int, rho: tuple[float, float], time_limit: float) -> bool:
    """Return whether a task is proven to have no plan with so many pieces per leg, within a limit of nodes and time.

    Args:
        task: what is asked, with the least reserves of which the proof is to tell.
        pieces: per leg.
        max_impacts: greatest number of impacts.
        rho: least and greatest robustness of a plan [m].
        time_limit: of all proofs together [s].
    """
    if rho[1] < rho[0]:
        return True
    end = read_clock() + time_limit
    for impacts in range(max_impacts + 1):
        if read_clock() >= end:
            return False
        try:
            grid, _ = task.build(GridSize(impacts, pieces, passing=True), rho)
            solve(grid.model, end - read_clock(), math.inf, task.solver, work=task.work, nodes=task.proof_nodes)
        except Infeasible:
            continue
        except SolverFailed:  # nothing is proven
            pass
        return False
    return True


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
    status = f"proven infeasible with up to {count_things(max_impacts, 'impact')} and the planner's reserves"
    raise Infeasible(f"plan of {task.scenario.name}", status, "allow more impacts or time, or relax the formula")
