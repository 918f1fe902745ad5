"""Plan the rest of a task from the present state: the scenario as seen from now, and its plan."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario, Robot
from impact_envs.stl import Always, And, Formula, In, Trace, robustness_signal
from impact_envs.stl.progression import progress_formula
from planners.budget import Work
from planners.free_flyer.frame import find_frame
from planners.free_flyer.nominal.event_grid import find_halt
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.task import CostOptions, PlanOptions, Wish, WordSearchOptions
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands
from planners.plan import Plan
from planners.spline_rows import SmoothingOptions

# Good enough, within the second or two after which a new plan is of use.
RESERVES = replace(Reserves().halved(), thrust=0.7, interior=0.01)
OPTIONS = PlanOptions(
    enough=0.2,
    robustness_gap=0.05,
    joint=0.85,
    thrust=0.9,
    thorough=False,
    screen=True,
    central=None,  # nothing is said of how objects have turned
    cost=CostOptions(gap=0.1, rounds=1, weights=(3.0,), wishes=(Wish(True, True), Wish(False, False)), together=True),
    search=WordSearchOptions(evaluations=8, improve=False),
    smoothing=SmoothingOptions(rounds=3),
)
Past = tuple[np.ndarray, Mapping[str, np.ndarray]]  # times, shape (n,) [s]; body to its positions, each (n, 2) [m]


@dataclass(frozen=True)
class Repair:
    """Choose how far an estimated state may be changed, so that it is a start the planner accepts.

    Args:
        still: speed below which an object counts as at rest, for no estimate is exactly zero [m/s].
        forgiven: distance by which an estimate may be outside of an area that always holds a body [m].
        inside: distance to which such a body is put inside the area [m].
        graze: closing speed of bodies in contact that may be an error of the estimate [m/s].
        sweeps: number of passes over all bodies and areas.
    """

    still: float = 5e-3
    forgiven: float = 0.02
    inside: float = 5e-3
    graze: float = 0.05
    sweeps: int = 4


def plan_rest(
    rest: FreeFlyerScenario,
    impacts: int | None = None,
    work: Work | None = None,
    reserves: Reserves = RESERVES,
) -> Plan:
    """Plan the rest of a task, who hits what included; by HiGHS, and whatever time it takes, so always the same plan.

    Args:
        rest: from `make_remaining_scenario`.
        impacts: number of impacts to try first, then one more, then fewer; default: count up from zero.
        work: that is counted and limited; default: as much as it takes.
        reserves: what the plan keeps in hand.

    Returns:
        A validated plan, in time since now.

    Raises:
        Infeasible: no plan.
        SolverFailed: a solver stopped early, or the plan failed the check.
        OutOfWork: the work allowed did not suffice.
    """
    kept = replace(reserves, wall=_find_wall(find_frame(rest).enter(rest), reserves))
    options = replace(OPTIONS, expected=impacts)
    return make_free_flyer_plan(rest, time_limit=math.inf, reserves=kept, options=options, work=work)


def make_remaining_scenario(
    scenario: FreeFlyerScenario,
    now: float,
    positions: Mapping[str, np.ndarray],
    velocities: Mapping[str, np.ndarray],
    past: Past,
    repair: Repair = Repair(),
) -> FreeFlyerScenario:
    """Make the scenario of what is left of a task, in time that starts now.

    The formula is progressed by the past. States are changed only where bodies overlap, are outside the world, or miss
    an area by less than an estimate may be wrong.

    Args:
        scenario: the whole task.
        now: on a control step [s].
        positions: of every body, each shape (2,) [m].
        velocities: of every body, each shape (2,) [m/s].
        past: where the bodies have been; the last sample is the present one.
        repair: how far the state may be changed.

    Returns:
        The scenario, with starts, velocities, horizon and formula of its own.

    Raises:
        InputError: nothing remains, or the formula's rest cannot be said.
    """
    parts = progress_specification(scenario, now, past, repair)
    places = {name: np.array(positions[name], dtype=float) for name in scenario.bodies}
    speeds = {name: _read_velocity(scenario, name, velocities[name], repair) for name in scenario.bodies}
    for _ in range(repair.sweeps):
        _project_places(scenario, parts, places, repair)
    _slow_robots(scenario, places, speeds, repair)
    values: dict[str, object] = {
        "horizon": round(scenario.horizon - now, 9),
        "formula": " & ".join(f"({part})" for part in parts) or _write_true(scenario),
        "weights": (),
    }
    for name in scenario.bodies:
        key = f"{'robots' if name in scenario.robots else 'objects'}.{name}"
        values[f"{key}.start"] = tuple(float(x) for x in places[name])
        values[f"{key}.start_velocity"] = tuple(float(x) for x in speeds[name])
    return scenario.override(values)


def progress_specification(
    scenario: FreeFlyerScenario, now: float, past: Past, repair: Repair = Repair()
) -> tuple[Formula, ...]:
    """Return what is left of a scenario's formula: its remaining conjuncts, in time since now.

    A conjunct that the past has decided is left out, but for an "always" that holds now.

    Args:
        scenario: the whole task.
        now: on a control step [s].
        past: where the bodies have been; the last sample is the present one.
        repair: by how much the present state may miss areas that always hold.

    Raises:
        InputError: nothing remains, or the formula's rest cannot be said.
    """
    read_demands(scenario, 0.0)  # predicates about anything but positions are refused
    period, steps = scenario.control_period, round(now / scenario.control_period)
    if abs(steps * period - now) > 1e-6 or not 0 <= steps < scenario.steps:
        raise InputError(f"now is {now:g} s, it must be a control step before the horizon {scenario.horizon:g} s")
    times, tracks = past
    grid = period * np.arange(steps + 1)
    signals = {
        f"{name}.{axis}": np.interp(grid, times, np.asarray(tracks[name])[:, k])
        for name in scenario.bodies
        for k, axis in enumerate("xy")
    }
    trace = Trace(signals, period, scenario.areas, scenario.bodies)
    left: list[Formula] = []
    for part in _list_conjuncts(scenario.specification.expand(scenario.bodies)):
        if isinstance(part, Always) and not part.child.is_temporal:
            found = _progress_always(part, trace, now, repair)
        else:
            found = progress_formula(part, trace)
        if isinstance(found, Formula):
            left.append(found)
    return tuple(left)


def _list_conjuncts(formula: Formula) -> Iterator[Formula]:
    """Yield the conjuncts of a formula; "always" is distributed over its conjuncts."""
    if isinstance(formula, And):
        for operand in formula.operands:
            yield from _list_conjuncts(operand)
    elif isinstance(formula, Always):
        for part in _list_conjuncts(formula.child):
            yield Always(formula.interval, part)
    else:
        yield formula


def _progress_always(part: Always, trace: Trace, now: float, repair: Repair) -> Formula | bool:
    """Return what is left of an "always"; one that the past violated is kept if it holds now."""
    found = progress_formula(part, trace, repair.forgiven)
    if found is False and part.interval[1] > now:
        found = Always((0.0, round(part.interval[1] - now, 9)), part.child)
    if isinstance(found, Always) and found.interval[0] == 0.0:
        present = float(robustness_signal(part.child, trace)[-1])
        if present < -repair.forgiven:
            return False
    return found


def _write_true(scenario: FreeFlyerScenario) -> str:
    """Return a formula that holds wherever bodies are."""
    return f"G[0,0] {scenario.agents[0]}.x >= {scenario.world.lower[0] - 2.0 * scenario.world.diagonal:g}"


def _read_velocity(scenario: FreeFlyerScenario, name: str, velocity: np.ndarray, repair: Repair) -> np.ndarray:
    """Return a velocity: a robot's within its limit, an object's zero where it may be an error of the estimate."""
    body, found = scenario.body(name), np.array(velocity, dtype=float)
    if isinstance(body, Robot):
        return np.clip(found, -body.speed_limit, body.speed_limit)
    return found if np.linalg.norm(found) > repair.still else np.zeros(2)


def _project_places(
    scenario: FreeFlyerScenario, parts: tuple[Formula, ...], places: dict[str, np.ndarray], repair: Repair
) -> None:
    """Project bodies into their current areas and the world, then separate overlaps, moving robots first."""
    for part in parts:
        if isinstance(part, Always) and part.interval[0] == 0.0 and isinstance(part.child, In):
            _project_into_area(scenario, part.child, places, repair)
    for name in scenario.bodies:
        inset = scenario.body(name).radius
        places[name] = np.clip(
            places[name], np.array(scenario.world.lower) + inset, np.array(scenario.world.upper) - inset
        )
        for obstacle in scenario.obstacles.values():
            H, b = obstacle.halfspaces()
            beyond = H @ places[name] - b
            if obstacle.solid and beyond.max() < inset:
                places[name] = places[name] + (inset + 1e-9 - beyond.max()) * H[beyond.argmax()]
    for first, second in itertools.combinations(scenario.bodies, 2):
        offset = places[second] - places[first]
        apart = float(np.linalg.norm(offset))
        short = scenario.body(first).radius + scenario.body(second).radius + 1e-9 - apart
        if short > 0.0:
            normal = offset / apart if apart > 0.0 else np.array([1.0, 0.0])
            share = 1.0 if first in scenario.robots and second in scenario.objects else 0.5
            places[first] = places[first] - share * short * normal
            places[second] = places[second] + (1.0 - share) * short * normal


def _project_into_area(
    scenario: FreeFlyerScenario, predicate: In, places: dict[str, np.ndarray], repair: Repair
) -> None:
    """Move a body that misses an area by little a short way inside, or out of an area to avoid."""
    H, b = scenario.areas[predicate.area].halfspaces()
    beyond = H @ places[predicate.body] - b
    if predicate.negated:
        if -repair.forgiven <= beyond.max() < repair.inside:
            places[predicate.body] = places[predicate.body] + (repair.inside - beyond.max()) * H[beyond.argmax()]
        return
    for face, bound in zip(H, b, strict=True):
        excess = float(face @ places[predicate.body] - bound)
        if -repair.inside < excess <= repair.forgiven:
            places[predicate.body] = places[predicate.body] - (excess + repair.inside) * face


def _slow_robots(
    scenario: FreeFlyerScenario, places: Mapping[str, np.ndarray], speeds: dict[str, np.ndarray], repair: Repair
) -> None:
    """Reduce a closing speed that a robot cannot lose before contact, where it may be an error of the estimate."""
    for name, robot in scenario.robots.items():
        strength = RESERVES.acceleration(robot)
        for other in scenario.bodies:
            offset = places[other] - places[name]
            apart = float(np.linalg.norm(offset))
            if other == name or apart == 0.0:
                continue
            normal = offset / apart
            closing = float((speeds[name] - speeds[other]) @ normal)
            gap = max(0.0, apart - robot.radius - scenario.body(other).radius)
            most = float(np.sqrt(2.0 * strength * gap))
            if most < closing <= most + repair.graze:
                speeds[name] = speeds[name] - (closing - most) * normal


def _find_wall(scenario: FreeFlyerScenario, reserves: Reserves) -> float:
    """Return the distance to keep from solid obstacles: the reserve, or less where bodies start closer [m]."""
    gaps = [reserves.wall]
    for name in scenario.bodies:
        body = scenario.body(name)
        halt = find_halt(body, reserves) if isinstance(body, Robot) else np.array(body.start)
        for obstacle in scenario.obstacles.values():
            H, b = obstacle.halfspaces()
            if obstacle.solid:
                gaps += [float((H @ place - b).max()) - body.radius for place in (np.array(body.start), halt)]
    return max(0.0, min(gaps))
