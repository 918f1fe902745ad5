"""Plan a free-flyer scenario: most robustness with fewest impacts, then least path cost, smooth motions, a check."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Budget, Work
from planners.errors import PlanningError
from planners.free_flyer.frame import Frame, find_frame
from planners.free_flyer.nominal.ladder import climb_ladder
from planners.free_flyer.nominal.object_way import find_most_impacts
from planners.free_flyer.nominal.screening import refuse_impossible, refuse_low_bound
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.central_hit import compute_shape_error
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.validation import Tolerances, validate_plan
from planners.plan import Plan
from planners.solvers import check_solver


def make_free_flyer_plan(
    scenario: FreeFlyerScenario,
    max_impacts: int | None = None,
    time_limit: float = 60.0,
    solver: str = "highs",
    reserves: Reserves = Reserves(),  # noqa: B008 - frozen
    options: PlanOptions = PlanOptions(),  # noqa: B008 - frozen
    work: Work | None = None,
    proof: float = 0.0,
) -> Plan:
    """Plan by lexicographic optimisation: robustness, number of impacts, path cost; then smooth and check.

    A task that leaves no room for the reserves is planned with half of them, then with a quarter; one whose margin of
    speed costs much of the robustness, with half of that margin.

    Args:
        scenario: any numbers of robots and objects; only believed physics are read. A polygon takes as much room as
            the disc around it; it is hit through its centre or, where no such plan is good enough, as that disc.
        max_impacts: greatest number of impacts tried; default: 6, and 3 for every further object, or as many as the
            shortest ways of objects need with a hit at every turn.
        time_limit: wall time for all stages [s].
        solver: of mixed-integer models, a key of `planners.solvers.SOLVERS`.
        reserves: speed, time and distance kept in hand for the execution.
        options: how far the plan is improved, and what of it is proven.
        work: that is counted and limited, if any is.
        proof: more time, for a closer bound of the path cost of several objects; the plan stays the same [s].

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
        max_impacts = find_most_impacts(scenario)
    _check_arguments(scenario, max_impacts, time_limit, proof)
    check_solver(solver)
    if proof:
        options, time_limit = replace(options, search=replace(options.search, proof=proof)), time_limit + proof
    demands = read_demands(scenario, reserves.wall)  # formulas are refused in the user's words
    scenario = scenario.model_copy(update={"weights": ()})  # nothing is given up, and sub-tasks have other conjuncts
    frame = find_frame(scenario)
    if options.thorough and options.reasons:
        refuse_impossible(NominalTask(scenario, demands, reserves, solver), max_impacts, options)
        inside = frame.enter(scenario)
        refuse_low_bound(
            NominalTask(inside, read_demands(inside, reserves.wall), reserves, solver, None, frame), options
        )
    # Wall time depends on the machine; the work done until it is over is told along with it.
    work = work or Work()
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
        return climb_ladder(scenario, max_impacts, Budget(time_limit), solver, reserves, options, work, frame)
    central: Plan | None = None
    if options.central is not None:
        # Half of the time each: what cannot be hit through its centre is found out late.
        time_limit = 0.5 * time_limit
        with suppress(PlanningError):
            brief = replace(options, diagnosis=0.0)
            central = climb_ladder(scenario, max_impacts, Budget(time_limit), solver, reserves, brief, work, frame)
    if central is None or central.robustness < (options.central or 0.0):
        try:
            plan = climb_ladder(disc_scenario, max_impacts, Budget(time_limit), solver, reserves, options, work, frame)
        except PlanningError as error:
            if central is None:
                status = f"{error.status}; polygons as the discs around them"
                raise type(error)(error.problem, status, error.remedy) from error
            plan = central  # less robustness before none
    else:
        plan = central
    return replace(plan, shape_error=compute_shape_error(scenario, plan.impacts, plan.horizon))


def _check_arguments(scenario: FreeFlyerScenario, max_impacts: int, time_limit: float, proof: float) -> None:
    if max_impacts < 0:
        raise InputError(f"max_impacts is {max_impacts}, it must not be negative")
    if not time_limit > 0:
        raise InputError(f"time_limit is {time_limit} s, it must be positive")
    if not proof >= 0:
        raise InputError(f"proof is {proof} s, it must not be negative")
    if proof and len(scenario.objects) < 2:
        raise InputError(f"proof is {proof} s: is for several objects; the path cost of one is proven without")
    if not scenario.objects:
        raise InputError(f"{scenario.name}: objects: this planner takes at least one, got none")
