"""Plan for the greatest deviation of the object's velocity after its impacts that a task can bear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.bezier import Curve
from planners.budget import Budget
from planners.errors import Infeasible, PlanningError
from planners.free_flyer.frame import Frame, find_frame
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.box_sequence import NARROW, BoxSequence, compute_arrival, compute_contacts
from planners.free_flyer.robust.conditions import Conditions, check_conditions, make_conditions
from planners.free_flyer.robust.deviation_search import DeviationOptimum, maximise_deviation
from planners.free_flyer.robust.least_cost import RobustEvents, minimise_robust_cost
from planners.free_flyer.robust.monte_carlo import check_responses
from planners.free_flyer.robust.response import Responses, follow_responses
from planners.free_flyer.robust.response_smoothing import make_responses
from planners.free_flyer.robust.task import RobustOptions, RobustTask
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound
from planners.free_flyer.validation import SUBSTEPS, compute_robustness
from planners.plan import Plan, PlannedImpact, PlannedResponse
from planners.solvers import check_solver


def make_impact_robust_plan(
    scenario: FreeFlyerScenario,
    *,
    max_impacts: int = 6,
    time_limit: float = 60.0,
    solver: str = "highs",
    time_grid: int | None = None,
    conditions: Conditions | None = None,
    reserves: Reserves = Reserves(),  # noqa: B008 - frozen
    options: RobustOptions = RobustOptions(),  # noqa: B008 - frozen
) -> Plan:
    r"""Plan by lexicographic optimisation: permissible deviation, then path cost at a share of it, smooth and check.

    Up to delta per axis is added to the object's velocity after each impact, and the robots learn its position and
    velocity once it has been hit. The permissible deviation is the greatest delta for which the task still succeeds.
    Between impacts the object's boxes grow by delta times the time; from any place in its box, robots hit it towards
    the next box. `deviation_bound` is proven for plans of this family: boxes per axis, wanted velocities that are
    affine in the position, legs of robots within the reserves, every robot on one side of the object throughout, at
    least one and at most `max_impacts` impacts. Where a quarter of the time limit ended the search before all of them
    were tried, it is what the last leg alone allows, which holds for any number of impacts.

    Robots are discs: contact points, clearances, the robot's own deviation by momentum and the room to come to a halt
    are part of the plan. Limits hold on control points of the four curves of every robot; the simulation of the closed
    loop confirms them in between. With `Conditions.points` bodies have no extent, as in the paper: robots may pass
    through the object, and only the object's velocity deviates.

    Args:
        scenario: one disc object and any number of robots; only believed physics are read.
        max_impacts: greatest number of impacts tried.
        time_limit: wall time for all stages [s].
        solver: of mixed-integer models, a key of `planners.solvers.SOLVERS`.
        time_grid: number of segments of the paper's constant grid, with new boxes at every boundary; implies points.
        conditions: what a deviation refers to, for robots of 0.2 m; default: `make_conditions`.
        reserves: speed, time and distance kept in hand for the execution.
        options: how far the plan is improved, and how it is checked.

    Returns:
        A plan that the simulation of the closed loop has confirmed.

    Raises:
        InputError: bad numbers, more than one object, or a formula of an unsupported form.
        Infeasible: no plan bears any deviation, or none that does can be smoothed.
        SolverFailed: a solver stopped early, or the plan failed the check.

    Source: Verhagen & Tumova, Sec. IV-C, Eqs. (16)-(20), with continuous times.
    """
    _check_arguments(scenario, max_impacts, time_limit, time_grid, options)
    check_solver(solver)
    _check_formula(scenario, reserves)
    frame = Frame()
    if conditions is None:
        frame = find_frame(scenario)
        scenario = frame.enter(scenario)
        # Nobody flies the paper's points.
        kept = reserves if time_grid is None else replace(reserves, tracking=0.0)
        conditions = make_conditions(scenario, kept)
    if time_grid is not None:
        conditions = replace(conditions, points=True)
    if conditions.points:
        conditions, scenario = replace(conditions, gather=False), _shrink(scenario)
    budget = Budget(time_limit)
    check_conditions(scenario, conditions)
    demands = read_demands(scenario, reserves.wall)
    task = RobustTask(scenario, demands, conditions, reserves, time_grid, solver, options)
    for last in [False] * options.halvings + [True]:
        try:
            with budget.stage("deviation"):
                optimum = maximise_deviation(task, max_impacts, time_limit - budget.elapsed)
            break
        except Infeasible:
            if last:
                raise
            task = replace(task, reserves=task.reserves.halved())
    return frame.leave(_plan_responses(task, optimum, budget))


def _plan_responses(task: RobustTask, optimum: DeviationOptimum, budget: Budget) -> Plan:
    """Try calmer and calmer plans, then other sequences of robots, until one can be smoothed and passes the check."""
    failure: PlanningError | None = None
    options = task.options
    for less in options.smaller_shares:
        failed: list[tuple[str, ...]] = []
        # On a constant grid robots turn in no time, as in the paper, so no plan is calmer.
        same = options.calmer if task.segments is None else options.calmer[:1]
        for number, (slower, room) in enumerate((*same, *options.calmer[: options.more_words])):
            calm = _make_calmer(task, slower, room)
            forbidden = failed if number >= len(same) else []
            delta, left = less * options.share * optimum.delta, budget.limit - budget.elapsed
            try:
                with budget.stage("effort"):
                    events = minimise_robust_cost(calm, optimum.size, delta, forbidden, 0.2 * left)
                failed.append(events.word)
                return _finish(task, optimum, events, budget)
            except PlanningError as error:
                failure = failure or error
    assert failure is not None
    raise failure


def _make_calmer(task: RobustTask, slower: float, room: float) -> RobustTask:
    reserves = replace(task.reserves, turn=slower * task.reserves.turn, thrust=task.reserves.thrust / slower)
    return replace(task, conditions=replace(task.conditions, room=room, gather=True), reserves=reserves)


def _finish(task: RobustTask, optimum: DeviationOptimum, events: RobustEvents, budget: Budget) -> Plan:
    """Smooth the motions, check them by simulation, and store in the plan what the simulation measured."""
    scenario, sequence, margin, options = task.scenario, events.sequence, task.conditions.margin, task.options
    with budget.stage("smoothing"):
        responses = make_responses(scenario, sequence, events.needs, margin, task.reserves, options.response)
    with budget.stage("validation"):
        # Impacts fall on samples: on control steps, or on boundaries of the constant grid.
        segments = task.segments or 1
        samples = segments * int(np.ceil(scenario.horizon / segments / scenario.control_period - 1e-9))
        check_responses(responses, margin, options.runs, options.seed, samples)
        robots, objects = _make_nominal(responses)
        times = np.linspace(0.0, scenario.horizon, samples * SUBSTEPS + 1)
        positions = {name: curve.position(times) for name, curve in (robots | objects).items()}
        rho = compute_robustness(scenario, times, positions)
    bound = max(rho, compute_geometric_bound(scenario, task.demands, task.solver))
    return Plan(
        scenario=scenario.name,
        objective="impact_uncertainty",
        horizon=scenario.horizon,
        robustness=rho,
        bound=bound,
        gap=(bound - rho) / max(1.0, abs(bound)),
        effort=events.cost,
        effort_bound=events.bound,
        impacts=_make_impacts(scenario, sequence),
        robots=robots,
        objects=objects,
        solve_seconds=budget.seconds,
        stage_seconds=dict(budget.stages),
        validated=True,
        deviation=sequence.delta,
        deviation_bound=optimum.bound,
        tubes={sequence.object: events.tube},
        responses={name: responses.curves(name) for name in scenario.robots},
        planned_responses=_plan_intervals(responses),
    )


def _make_nominal(responses: Responses) -> tuple[dict[str, Curve], dict[str, Curve]]:
    """Return the curves of robots and object if nothing deviates."""
    sequence = responses.sequence
    path = sequence.centers
    nothing = np.zeros((1, len(sequence.hitters), 2))
    robots = {}
    for name in responses.scenario.robots:
        robots[name] = Curve(responses.times, follow_responses(responses, name, path[None, 1:-1], nothing)[0])
    return robots, {sequence.object: Curve(sequence.times, np.stack([path[:-1], path[1:]], axis=1))}


def _make_impacts(scenario: FreeFlyerScenario, sequence: BoxSequence) -> tuple[PlannedImpact, ...]:
    impacts = []
    for k, name in enumerate(sequence.hitters, start=1):
        position = sequence.centers[k]
        before = compute_arrival(sequence, k, position, sequence.centers[k - 1])
        after = sequence.command(k, position)
        contact = compute_contacts(scenario, sequence, k, position, before, after)
        impacts.append(
            PlannedImpact(
                time=float(sequence.times[k]),
                robot=name,
                object=sequence.object,
                position=position,
                contact=contact.robot,
                normal=contact.normal,
                robot_minus=contact.minus,
                robot_plus=contact.plus,
                object_minus=before,
                object_plus=after,
            )
        )
    return tuple(impacts)


def _plan_intervals(responses: Responses) -> tuple[PlannedResponse, ...]:
    """Return when which responses hold, and the velocity that is wanted, for every impact."""
    sequence, times = responses.sequence, responses.times
    intervals = {one.impact: one for mine in responses.intervals.values() for one in mine}
    planned = []
    for k in range(1, len(sequence.hitters) + 1):
        width = 2.0 * sequence.halves[k]
        wide = width > NARROW
        rise = sequence.commands[k - 1, 1] - sequence.commands[k - 1, 0]
        one, gain = intervals[k], np.where(wide, rise / np.where(wide, width, 1.0), 0.0)
        leave, join = float(times[one.before]), float(times[one.after])
        planned.append(PlannedResponse(one.start, one.end, leave, join, gain))
    return tuple(planned)


def _shrink(scenario: FreeFlyerScenario) -> FreeFlyerScenario:
    """Return the scenario with bodies that are points."""
    point = {"radius": 0.0}
    robots = {name: robot.model_copy(update=point) for name, robot in scenario.robots.items()}
    objects = {name: body.model_copy(update=point) for name, body in scenario.objects.items()}
    return scenario.model_copy(update={"robots": robots, "objects": objects})


def _check_arguments(
    scenario: FreeFlyerScenario, max_impacts: int, time_limit: float, time_grid: int | None, options: RobustOptions
) -> None:
    if len(scenario.objects) != 1:
        raise InputError(f"{scenario.name}: this objective takes one object, got {len(scenario.objects)}")
    for name, body in scenario.objects.items():
        if body.vertices is not None:
            raise InputError(f"{scenario.name}: objects.{name}: this planner takes disc objects, got a polygon")
    if scenario.starts_moving:
        raise InputError(f"{scenario.name}: start_velocity: this objective takes bodies that start at rest")
    if max_impacts < 1:
        raise InputError(f"max_impacts is {max_impacts}, it must be at least 1")
    if not time_limit > 0:
        raise InputError(f"time_limit is {time_limit} s, it must be positive")
    if time_grid is not None and time_grid < 2:
        raise InputError(f"time_grid is {time_grid}, it must be at least 2 segments")
    if not 0.0 < options.share <= 1.0:
        raise InputError(f"share is {options.share}, it must be above 0 and at most 1")
    if options.runs < 1:
        raise InputError(f"runs is {options.runs}, it must be at least 1")


def _check_formula(scenario: FreeFlyerScenario, reserves: Reserves) -> None:
    for predicate, need in read_demands(scenario, reserves.wall).predicates.items():
        if len(need.bodies) > 1:
            wish = "this objective takes predicates about one body"
            raise InputError(f"{scenario.name}: formula: '{predicate}' is not supported; {wish}")
