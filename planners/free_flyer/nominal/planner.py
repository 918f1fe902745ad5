"""Plan a free-flyer scenario: most robustness with fewest impacts, then least path cost, smooth motions, a check."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Budget, Work
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.frame import Frame, find_frame
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.diagnosis import find_relaxation
from planners.free_flyer.nominal.event_sequence import Hitter, Word, compute_impacts, make_object_curve
from planners.free_flyer.nominal.least_cost import CostOptimum, minimise_path_cost, read_events
from planners.free_flyer.nominal.screening import screen_task
from planners.free_flyer.nominal.sequence_search import restrict_to_object, search_words
from planners.free_flyer.nominal.smoothing import smooth_motions
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.central_hit import compute_shape_error
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound
from planners.free_flyer.validation import Tolerances, validate_plan
from planners.mixed_integer import Model
from planners.plan import Plan
from planners.solvers import check_solver, solve

TOLERANCE = 1e-6  # of the robustness: solvers stop within this of the optimum [m]


@dataclass(frozen=True)
class RobustnessOptimum:
    """Hold the result of stage A.

    Args:
        size: fewest impacts that attain the robustness, and the pieces per leg that robots need for it.
        rho: greatest robustness [m].
        bound: what no plan of any kind can exceed [m].
        words: who hits what, least path cost first; empty: anybody anything.
        cost_bound: no word has a smaller path cost [m^2/s].
        events: that attain the robustness at any path cost, for when there is no time for the least; one object only.
    """

    size: GridSize
    rho: float
    bound: float
    words: tuple[Word, ...] = ()
    cost_bound: float = 0.0
    events: CostOptimum | None = None


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
    """Plan with the reserves, with half of them, then with a quarter."""
    task = tightest = NominalTask(scenario, read_demands(scenario, reserves.wall), reserves, solver, work, frame)
    if options.expected is not None:
        max_impacts = min(max_impacts, options.expected + 1)
    failure: PlanningError | None = None
    enough = options.enough
    for _ in range(options.halvings + 1):
        tried = replace(options, enough=enough)
        try:
            if options.screen:
                with budget.stage("screening"):
                    screen_task(task, max_impacts, options)
            with budget.stage("robustness"):
                search = maximise_robustness if len(scenario.objects) == 1 else maximise_jointly
                optimum = search(task, max_impacts, budget, tried)
                quick = quicken_legs(task, optimum, search, budget, tried)
            if quick is not None:
                try:
                    return _plan_events(*quick, budget, tried)
                except PlanningError:
                    pass  # the plan with all reserves is left
            return _plan_events(task, optimum, budget, tried)
        except PlanningError as error:
            failure = failure or error
        if budget.left <= 0.0:
            break
        tightest, task = task, replace(task, reserves=replace(task.reserves.halved(), underway=1.0))
        enough = enough if options.thorough else 0.5 * enough
    assert failure is not None
    raise _explain(failure, tightest, max_impacts, budget, options)


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
    if not isinstance(failure, Infeasible) or not options.thorough or not options.diagnosis:
        return failure
    limit = min(max(budget.left, 0.25 * options.diagnosis), options.diagnosis)
    found = find_relaxation(task, max_impacts, options.least, limit)
    if not found:
        return failure
    remedy = f"a plan would exist with {' and '.join(str(relaxation) for relaxation in found)}"
    return Infeasible(failure.problem, failure.status, remedy)


def maximise_robustness(
    task: NominalTask, max_impacts: int, budget: Budget, options: PlanOptions, fewest: int = 0
) -> RobustnessOptimum:
    """Return the greatest robustness and the fewest impacts that attain it (stage A).

    Every number of impacts is solved to proven optimality or infeasibility (as far as the time limit allows), until
    one attains the geometric bound, which holds for every number. Legs of several pieces are tried for numbers that
    are infeasible without them, and for the first number whose plan does not attain the bound.

    Args:
        task: what is asked.
        max_impacts: greatest number of impacts tried.
        budget: time.
        options: when to stop.
        fewest: least number of impacts tried.

    Raises:
        Infeasible: no plan within max_impacts.
        SolverFailed: out of time.
    """
    ceiling = compute_geometric_bound(task.scenario, task.demands, task.solver)
    problem = f"plan of {task.scenario.name}"
    if ceiling < options.least:
        status = f"fixed starts, goals and areas allow a robustness of {ceiling * task.frame.length:.3g} m at most"
        raise Infeasible(problem, status, "move them, or relax the formula")
    best: RobustnessOptimum | None = None
    for impacts, pieces in itertools.product(options.order_numbers(fewest, max_impacts), options.pieces):
        if best is not None and pieces > best.size.pieces and impacts > best.size.impacts:
            continue
        if best is not None and not options.thorough and impacts > best.size.impacts + 1:
            break
        # Once there is a plan, the search for a more robust one with more impacts must leave time to finish it.
        share = 0.25 if options.thorough else 0.5
        limit = budget.left if best is None else share * budget.limit - budget.elapsed
        least = options.least if best is None else best.rho
        try:
            found = _solve_size(task, GridSize(impacts, pieces, passing=True), (least, ceiling), limit, options)
        except Infeasible:
            continue
        except SolverFailed:
            if best is None:
                raise
            break
        if best is None or found.rho > best.rho + TOLERANCE:
            best = replace(found, rho=ceiling) if ceiling - found.rho <= TOLERANCE else found
        if best.rho >= options.enough * ceiling:
            break
    if best is None:
        status = f"proven infeasible with up to {max_impacts} impacts and the planner's reserves"
        raise Infeasible(problem, status, "allow more impacts or time, move the areas, or relax the formula")
    return best


def _solve_size(
    task: NominalTask, size: GridSize, rho: tuple[float, float], time_limit: float, options: PlanOptions
) -> RobustnessOptimum:
    """Return the greatest robustness, between two numbers, of plans of one size."""
    grid, choices = task.build(size, rho)
    grid.model.objective = -grid.rho
    point = partial(_solve_point, task, grid.model, time_limit, options.robustness_gap)
    x = solve_apart(grid, task.scenario, task.reserves, point)
    events = read_events(task, grid, choices, x) if len(task.scenario.objects) == 1 else None
    return RobustnessOptimum(size, grid.rho.value(x), rho[1], events=events)


def _solve_point(task: NominalTask, model: Model, time_limit: float, gap: float) -> np.ndarray:
    return solve(model, time_limit, gap, task.solver, work=task.work).x


def maximise_jointly(task: NominalTask, max_impacts: int, budget: Budget, options: PlanOptions) -> RobustnessOptimum:
    """Return the optimum for several objects, starting from those of each object alone.

    What the objects attain alone bounds what they attain together, in robustness and in number of impacts. First a
    word is sought that attains both bounds; only if there is none are all words open (see `maximise_robustness`).

    Args:
        task, max_impacts, budget, options: as for `maximise_robustness`.

    Raises:
        Infeasible: no plan within max_impacts.
        SolverFailed: out of time.
    """
    ceiling = compute_geometric_bound(task.scenario, task.demands, task.solver)
    rho, pieces = ceiling, 1
    hits: list[tuple[float, Hitter]] = []
    for name in task.scenario.objects:
        alone = restrict_to_object(task.scenario, name)
        if alone is None:
            continue
        own = replace(task, scenario=alone, demands=read_demands(alone, task.reserves.wall))
        optimum = maximise_robustness(own, max_impacts, budget, replace(options, expected=None))
        rho, pieces = min(rho, optimum.rho), max(pieces, optimum.size.pieces)
        events = optimum.events
        if events is None or options.thorough:
            events = minimise_path_cost(own, optimum.size, optimum.rho, options.cost, budget.left)
        hits += zip(events.sequence.times[1:-1], events.sequence.hitters, strict=True)
    seed = tuple(hitter for _, hitter in sorted(hits))
    if len(seed) <= max_impacts:
        size = GridSize(len(seed), pieces)
        found = search_words(task, size, options.joint * rho, seed, lambda: budget.left / 2, options)
        if found.words:
            return RobustnessOptimum(size, rho, ceiling, found.words, found.bound)
    fewest = len(seed) if options.expected is None else min(len(seed), options.expected)
    return maximise_robustness(task, max_impacts, budget, options, fewest)


def _plan_events(task: NominalTask, optimum: RobustnessOptimum, budget: Budget, options: PlanOptions) -> Plan:
    """Try words in the order of their path cost until the plan of one can be smoothed and passes the check.

    Out of time, the events of stage A are used, whatever their cost.
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
                    limit = budget.left / 2
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
                if word is None:
                    forbidden.append(events.sequence.hitters)
    assert failure is not None
    if isinstance(failure, Infeasible) or optimum.events is None:
        raise failure
    return _finish(task, optimum, optimum.rho, optimum.events, budget, replace(options, thrust=None))


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
        effort_bound=(optimum.cost_bound if optimum.words else events.bound) or None,
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


def _check_arguments(scenario: FreeFlyerScenario, max_impacts: int, time_limit: float) -> None:
    if max_impacts < 0:
        raise InputError(f"max_impacts is {max_impacts}, it must not be negative")
    if not time_limit > 0:
        raise InputError(f"time_limit is {time_limit} s, it must be positive")
    if not scenario.objects:
        raise InputError(f"{scenario.name}: objects: this planner takes at least one, got none")
