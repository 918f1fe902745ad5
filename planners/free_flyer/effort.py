"""Stage B: the events of least effort at a given robustness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.cones import solve_cones
from planners.errors import Infeasible
from planners.free_flyer.event_grid import EventGrid, build_event_grid
from planners.free_flyer.events import EventSequence
from planners.free_flyer.formula_rows import add_requirements
from planners.free_flyer.requirement import Requirement
from planners.free_flyer.reserves import Reserves
from planners.mixed_integer import Affine, evaluate, solve_mixed_integer

TANGENTS = 12  # perspective cuts per sign
RELATIVE_GAP = 0.01


@dataclass(frozen=True)
class EffortOptimum:
    """Hold the events of least effort.

    Args:
        sequence: the events.
        effort: J of the sequence [m^2/s].
        bound: proven lower bound of J [m^2/s].
    """

    sequence: EventSequence
    effort: float
    bound: float


def minimise_effort(
    scenario: FreeFlyerScenario,
    needs: Sequence[Requirement],
    shape: tuple[int, int],
    rho: float,
    reserves: Reserves,
    forbidden: Sequence[tuple[str, ...]],
    time_limit: float,
) -> EffortOptimum:
    r"""Return the events of least effort that keep a robustness.

    J = sum over legs and axes of D^2 / T; D^2 / T >= 2 q D - q^2 T for every q is linear in (D, T). The
    integers of this relaxation go into the exact second-order cone program. Areas are reached at events,
    where the execution aims, and avoided with a reserve, wherever the robustness leaves room for it.

    Args:
        scenario: what to plan.
        needs: its requirements.
        shape: number of impacts, and of pieces per leg.
        rho: robustness to keep [m].
        reserves: what the plan keeps in hand.
        forbidden: sequences of hitting robots that are excluded.
        time_limit: of each mixed-integer solution [s].

    Returns:
        The events, their effort and its bound under these wishes.

    Raises:
        Infeasible: no such events.
        SolverFailed: out of time.
    """
    far = [replace(need, reserve=reserves.avoid) if need.kind == "avoid" else need for need in needs]
    failure: Infeasible | None = None
    for passing, wanted in ((False, far), (False, needs), (True, far), (True, needs)):
        try:
            grid = build_event_grid(scenario, shape[0], (rho - 1e-9, rho), reserves, shape[1])
            add_requirements(grid, wanted, scenario.control_period, passing)
            return _solve(scenario, grid, forbidden, time_limit)
        except Infeasible as error:
            failure = error
    assert failure is not None
    raise failure


def _solve(
    scenario: FreeFlyerScenario, grid: EventGrid, forbidden: Sequence[tuple[str, ...]], time_limit: float
) -> EffortOptimum:
    shares = _add_effort(grid)
    for word in forbidden:
        same = [grid.hits[k][name] for k, name in enumerate(word)]
        grid.model.require(sum(same, Affine({})) - (len(same) - 1.0))
    relaxed = solve_mixed_integer(grid.model, time_limit, RELATIVE_GAP)
    x = solve_cones(grid.model, relaxed.x, shares)
    sequence = _read_sequence(scenario, grid, x)
    return EffortOptimum(sequence, _compute_effort(sequence), max(0.0, relaxed.bound))


def _add_effort(grid: EventGrid) -> list[tuple[Affine, Affine, Affine]]:
    """Add e >= D^2 / T for every moving piece and axis as tangent planes; the objective is the sum of e."""
    shares = []
    total = Affine({})
    for name, knots in grid.knots.items():
        # The object's pieces share one velocity, so its legs count whole.
        stride = grid.pieces if name == grid.object else 1
        for start in range(0, grid.count, stride):
            fastest = grid.caps[start] if name == grid.object else grid.speeds[name]
            duration = grid.times[start + stride] - grid.times[start] + Affine({})
            for step in knots[start + stride] - knots[start] if fastest > 0.0 else ():
                move = step + Affine({})
                effort = grid.model.variable(0.0, fastest**2 * grid.model.limits(duration)[1])
                for q in fastest * np.arange(1, TANGENTS + 1) / TANGENTS:
                    for slope in (q, -q):
                        grid.model.require(move * (2 * slope) - duration * slope**2 - effort)
                shares.append((effort, move, duration))
                total = total + effort
    grid.model.objective = total
    return shares


def _read_sequence(scenario: FreeFlyerScenario, grid: EventGrid, x: np.ndarray) -> EventSequence:
    """Return the events, with impact times on control steps and knots on micrometres.

    An area reached at an impact is then reached at a sample of the environment, and points that the
    optimal robustness leaves no freedom are met exactly.
    """
    period = scenario.control_period
    times = evaluate(grid.times, x)[:: grid.pieces]
    times[1:-1] = np.round(np.round(times[1:-1] / period) * period, 9)
    knots = {name: np.round(evaluate(points, x), 6) for name, points in grid.knots.items()}
    for name in scenario.bodies:
        knots[name][0] = scenario.body(name).start
    path = knots[grid.object][:: grid.pieces]
    hitters = tuple(max(hits, key=lambda robot: hits[robot].value(x)) for hits in grid.hits)
    return EventSequence(times, grid.object, path, {name: knots[name] for name in scenario.robots}, hitters)


def _compute_effort(sequence: EventSequence) -> float:
    bodies = [sequence.path, *sequence.knots.values()]
    durations = [np.diff(sequence.knot_times(len(knots)))[:, None] for knots in bodies]
    moves = [np.diff(knots, axis=0) for knots in bodies]
    return float(sum(np.sum(move**2 / spans) for move, spans in zip(moves, durations, strict=True)))
