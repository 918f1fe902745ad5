"""Plan for the greatest deviation of the object's velocity after its impacts that a task can bear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.bezier import Curve
from planners.budget import Budget
from planners.errors import Infeasible, PlanningError
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.box_grid import Conditions
from planners.free_flyer.robust.box_sequence import HullSequence, compute_arrival, compute_contacts
from planners.free_flyer.robust.deviation_search import DeviationOptimum, RobustTask, maximise_deviation
from planners.free_flyer.robust.effort import RobustEvents, minimise_robust_effort
from planners.free_flyer.robust.monte_carlo import check_responses
from planners.free_flyer.robust.response import Responses, follow_responses
from planners.free_flyer.robust.response_smoothing import make_responses
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound
from planners.free_flyer.validation import SUBSTEPS, compute_robustness
from planners.plan import Plan, PlannedImpact
from planners.solvers import check_solver

HALVINGS = 2  # of the reserves, where a task leaves no room for them
# By what legs are slower to start and stop, and room beyond contact points to come to a halt in [m], when motions
# prove too quick to be smoothed.
CALMER = ((1.0, 0.0), (1.25, 0.05), (1.5, 0.1))
MORE_WORDS = 2  # other sequences of hitting robots that are tried then
SHARES = (1.0, 0.75, 0.5)  # of the share of the deviation, where no motions bear it


def make_impact_robust_plan(
    scenario: FreeFlyerScenario,
    *,
    max_impacts: int = 6,
    time_limit: float = 60.0,
    solver: str = "highs",
    time_grid: int | None = None,
    share: float = 0.8,
    gap: float | None = None,
    final_velocity: float | None = None,
    initial: tuple[float, float] | None = None,
    margin: float = 0.0,
    points: bool = False,
    runs: int = 200,
    seed: int = 0,
    reserves: Reserves = Reserves(),  # noqa: B008 - frozen
) -> Plan:
    r"""Plan by lexicographic optimisation: permissible deviation, then effort at a share of it, smooth and check.

    The deviation delta is the greatest such that, with robots that know where the object is and how fast once it
    has been hit, the task succeeds whatever is added to the object's velocity after each impact, up to delta per
    axis. Between impacts the object's boxes grow by delta times the time; robots hit it towards the next box from
    wherever in the box it is. `deviation_bound` is proven for plans of this family: boxes per axis, velocities
    wanted that are affine in the position, legs of robots within the reserves, every robot on one side of the
    object throughout, at least one and at most `max_impacts` impacts (fewer if a quarter of the time limit ended
    the search). Where it equals what the last leg alone allows, it holds for any number of impacts.

    Robots are discs: contact points, clearances, the robot's own deviation by momentum and the room to come to a
    halt are part of the plan; limits hold on control points of the four curves of every robot, and the
    simulation of the closed loop confirms them in between. With `points` bodies have no extent, as in the paper:
    robots may pass through the object, and only the object's velocity deviates.

    Args:
        scenario: one disc object and any number of robots; only believed physics are read.
        max_impacts: greatest number of impacts tried.
        time_limit: wall time for all stages [s].
        solver: of mixed-integer models, a key of `planners.solvers.SOLVERS`.
        time_grid: number of segments of the paper's constant grid, on which boxes are taken anew at every boundary;
            implies `points`.
        share: of the greatest deviation that the plan is made for; three quarters and half of it
            are tried where motions fail.
        gap: least time between impacts and after the last one; None: that of the scenario, or of the reserves [s].
        final_velocity: greatest speed per axis at the horizon of an object that rests; None: the scenario's [m/s].
        initial: half widths of the box the object starts in; None: the scenario's [m].
        margin: robustness kept by the boxes and promised in every run [m].
        points: plan for bodies without extent.
        runs: simulated runs of the closed loop.
        seed: of their randomness.
        reserves: speed, time and distance kept in hand for the execution.

    Returns:
        A plan that the simulation of the closed loop has confirmed.

    Raises:
        InputError: bad numbers, more than one object, or a formula of an unsupported form.
        Infeasible: no plan bears any deviation, or none that does can be smoothed.
        SolverFailed: a solver stopped early, or the plan failed the check.

    Source: Verhagen & Tumova, Sec. IV-C, Eqs. (16)-(20), with continuous times.
    """
    _check_arguments(scenario, max_impacts, time_limit, time_grid, share, runs)
    points = points or time_grid is not None
    scenario = _shrink(scenario) if points else scenario
    check_solver(solver)
    budget = Budget(time_limit, solver)
    body = next(iter(scenario.objects.values()))
    if gap is None:
        gap = scenario.impact_gap or reserves.times(scenario.horizon)[1]
    final_velocity = body.final_speed if final_velocity is None else final_velocity
    initial = body.start_uncertainty if initial is None else initial
    conditions = Conditions(gap, final_velocity, initial, margin, points, gather=not points)
    _check_conditions(scenario, conditions)
    _check_formula(scenario, reserves)
    for last in [False] * HALVINGS + [True]:
        task = RobustTask(scenario, read_demands(scenario, reserves.wall), conditions, reserves, time_grid, solver)
        try:
            with budget.stage("deviation"):
                optimum = maximise_deviation(task, max_impacts, time_limit - budget.elapsed)
            break
        except Infeasible:
            if last:
                raise
            reserves = reserves.halved()
    return _plan_responses(task, optimum, share, runs, seed, budget)


def _plan_responses(
    task: RobustTask, optimum: DeviationOptimum, share: float, runs: int, seed: int, budget: Budget
) -> Plan:
    """Try calmer and calmer plans, then other sequences of robots, until one can be smoothed and passes the check."""
    failure: PlanningError | None = None
    for less in SHARES:
        failed: list[tuple[str, ...]] = []
        # Robots on a constant grid turn in no time, as in the paper: nothing makes them calmer.
        same = CALMER if task.segments is None else CALMER[:1]
        for number, (slower, room) in enumerate((*same, *CALMER[:MORE_WORDS])):
            calm = _calm(task, slower, room)
            forbidden = failed if number >= len(same) else []
            delta, left = less * share * optimum.delta, budget.limit - budget.elapsed
            try:
                with budget.stage("effort"):
                    events = minimise_robust_effort(calm, optimum.shape, delta, forbidden, 0.2 * left)
                failed.append(events.word)
                return _finish(task, optimum, events, runs, seed, budget)
            except PlanningError as error:
                failure = failure or error
    assert failure is not None
    raise failure


def _calm(task: RobustTask, slower: float, room: float) -> RobustTask:
    reserves = replace(task.reserves, turn=slower * task.reserves.turn, thrust=task.reserves.thrust / slower)
    return replace(task, conditions=replace(task.conditions, room=room, gather=True), reserves=reserves)


def _finish(
    task: RobustTask, optimum: DeviationOptimum, events: RobustEvents, runs: int, seed: int, budget: Budget
) -> Plan:
    scenario, sequence, margin = task.scenario, events.sequence, task.conditions.margin
    with budget.stage("smoothing"):
        responses = make_responses(scenario, sequence, events.needs, margin, task.reserves)
    with budget.stage("validation"):
        # Impacts fall on samples: on control steps, or on boundaries of the constant grid.
        segments = task.segments or 1
        samples = segments * int(np.ceil(scenario.horizon / segments / scenario.control_period - 1e-9))
        check_responses(responses, margin, runs, seed, samples)
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
        effort=events.effort,
        effort_bound=events.bound,
        impacts=_make_impacts(scenario, sequence),
        robots=robots,
        objects=objects,
        solve_seconds=budget.elapsed,
        stage_seconds=dict(budget.stages),
        validated=True,
        deviation=sequence.delta,
        deviation_bound=optimum.bound,
        tubes={sequence.object: events.tube},
        responses={name: responses.curves(name) for name in scenario.robots},
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


def _make_impacts(scenario: FreeFlyerScenario, sequence: HullSequence) -> tuple[PlannedImpact, ...]:
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


def _shrink(scenario: FreeFlyerScenario) -> FreeFlyerScenario:
    """Return the scenario with bodies that are points."""
    point = {"radius": 0.0}
    robots = {name: robot.model_copy(update=point) for name, robot in scenario.robots.items()}
    objects = {name: body.model_copy(update=point) for name, body in scenario.objects.items()}
    return scenario.model_copy(update={"robots": robots, "objects": objects})


def _check_arguments(
    scenario: FreeFlyerScenario, max_impacts: int, time_limit: float, time_grid: int | None, share: float, runs: int
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
    if not 0.0 < share <= 1.0:
        raise InputError(f"share is {share}, it must be above 0 and at most 1")
    if runs < 1:
        raise InputError(f"runs is {runs}, it must be at least 1")


def _check_formula(scenario: FreeFlyerScenario, reserves: Reserves) -> None:
    for predicate, need in read_demands(scenario, reserves.wall).predicates.items():
        if len(need.bodies) > 1:
            wish = "this objective takes predicates about one body"
            raise InputError(f"{scenario.name}: formula: '{predicate}' is not supported; {wish}")


def _check_conditions(scenario: FreeFlyerScenario, conditions: Conditions) -> None:
    if not 0.0 < conditions.gap < scenario.horizon:
        limits = f"above 0 and below the horizon {scenario.horizon} s"
        raise InputError(f"gap (impact_gap) is {conditions.gap} s, it must be {limits}")
    for key, values in (
        ("final_velocity", (conditions.final_velocity,)),
        ("initial", conditions.initial),
        ("margin", (conditions.margin,)),
    ):
        if not all(np.isfinite(value) and value >= 0.0 for value in values):
            raise InputError(f"{key} is {list(values)}, it must not be negative")
    name, body = next(iter(scenario.objects.items()))
    for d, half in enumerate(conditions.initial):
        inset = body.radius + half
        if not scenario.world.lower[d] + inset <= body.start[d] <= scenario.world.upper[d] - inset:
            box = list(conditions.initial)
            raise InputError(f"initial (start_uncertainty) is {box} m, {name} would start outside the world")
