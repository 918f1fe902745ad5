"""Plan the rest of a task from the present state: the scenario as seen from now, and its event MILP."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario, Robot
from impact_envs.stl import Always, And, Formula, In, Trace, robustness_signal
from impact_envs.stl.progression import progress_formula
from planners.free_flyer.nominal.event_grid import find_halt
from planners.free_flyer.nominal.planner import Ambition, make_free_flyer_plan
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands
from planners.plan import Plan

RESERVES = replace(Reserves().halved(), thrust=0.7, interior=0.01)
AMBITION = Ambition(enough=0.2, robustness_gap=0.05, effort_gap=0.1, rounds=1, joint=0.85, thrust=0.9, thorough=False)
STILL = 5e-3  # below this an object counts as at rest [m/s]
FORGIVEN = 0.02  # by which an estimate may be outside of what holds always [m]
INSIDE = 5e-3  # how far it is then put inside [m]
GRAZE = 0.05  # closing speed of bodies in contact that an estimate may invent [m/s]
SWEEPS = 4  # over all bodies and areas, until nothing overlaps
Past = tuple[np.ndarray, Mapping[str, np.ndarray]]  # times, shape (n,) [s]; body to its positions, each (n, 2) [m]


@dataclass(frozen=True)
class Rest:
    """Hold what of a formula is left to be done.

    Args:
        parts: conjuncts that are left, in time since now.
        violated: conjuncts that the past has violated; what always holds stays among the parts if it holds now.
    """

    parts: tuple[Formula, ...]
    violated: tuple[str, ...]


def plan_remaining(
    scenario: FreeFlyerScenario,
    now: float,
    positions: Mapping[str, np.ndarray],
    velocities: Mapping[str, np.ndarray],
    past: Past,
    time_limit: float = 2.0,
    impacts: int | None = None,
    reserves: Reserves = RESERVES,
    solver: str = "highs",
) -> Plan:
    """Plan the rest of a task, who hits what included, from the present state.

    Unless the time limit is hit, the plan does not depend on how long anything takes.

    Args:
        scenario: the whole task; only believed physics are read.
        now: on a control step [s].
        positions: of every body, each shape (2,) [m].
        velocities: of every body, each shape (2,) [m/s].
        past: where the bodies have been.
        time_limit: wall time [s].
        impacts: that remain in the plan so far: tried first, then one more, then fewer; from none up without.
        reserves: what the plan keeps in hand.
        solver: as for `make_free_flyer_plan`.

    Returns:
        A validated plan of `make_remaining_scenario`, in time since now.

    Raises:
        InputError: nothing remains, or the formula's rest cannot be said.
        Infeasible: no plan.
        SolverFailed: out of time, or the plan failed the check.
    """
    rest = make_remaining_scenario(scenario, now, positions, velocities, past)
    return plan_rest(rest, impacts, time_limit, reserves, solver)


def plan_rest(
    rest: FreeFlyerScenario,
    impacts: int | None = None,
    time_limit: float = 2.0,
    reserves: Reserves = RESERVES,
    solver: str = "highs",
) -> Plan:
    """Plan what `make_remaining_scenario` made; as `plan_remaining`."""
    kept = replace(reserves, wall=_find_wall(rest, reserves))
    return make_free_flyer_plan(rest, None, time_limit, solver, kept, replace(AMBITION, expected=impacts))


def make_remaining_scenario(
    scenario: FreeFlyerScenario,
    now: float,
    positions: Mapping[str, np.ndarray],
    velocities: Mapping[str, np.ndarray],
    past: Past,
) -> FreeFlyerScenario:
    """Make the scenario of what is left of a task, in time that starts now.

    The formula is progressed by the past. States are taken as they are, but that bodies do not overlap, are within
    the world, and within areas by whose edge they are missed by no more than an estimate may be wrong.

    Args:
        scenario: the whole task.
        now: on a control step [s].
        positions: of every body, each shape (2,) [m].
        velocities: of every body, each shape (2,) [m/s].
        past: where the bodies have been; the last sample is the present one.

    Returns:
        The scenario, with starts, velocities, horizon and formula of its own.

    Raises:
        InputError: nothing remains, or the formula's rest cannot be said.
    """
    parts = progress_specification(scenario, now, past).parts
    places = {name: np.array(positions[name], dtype=float) for name in scenario.bodies}
    speeds = {name: _read_velocity(scenario, name, velocities[name]) for name in scenario.bodies}
    for _ in range(SWEEPS):
        _settle(scenario, parts, places)
    _brake(scenario, places, speeds)
    values: dict[str, object] = {
        "horizon": round(scenario.horizon - now, 9),
        "formula": " & ".join(f"({part})" for part in parts) or _write_true(scenario),
    }
    for name in scenario.bodies:
        key = f"{'robots' if name in scenario.robots else 'objects'}.{name}"
        values[f"{key}.start"] = tuple(float(x) for x in places[name])
        values[f"{key}.start_velocity"] = tuple(float(x) for x in speeds[name])
    return scenario.override(values)


def progress_specification(scenario: FreeFlyerScenario, now: float, past: Past) -> Rest:
    """Return what of a scenario's formula is left to be done, conjunct by conjunct.

    Args:
        scenario: the whole task.
        now: on a control step [s].
        past: where the bodies have been; the last sample is the present one.

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
    violated: list[str] = []
    for part in _split(scenario.specification.expand(scenario.bodies)):
        if isinstance(part, Always) and not part.child.is_temporal:
            found, missed = _progress_always(part, trace, now)
        else:
            found = progress_formula(part, trace)
            missed = found is False
        if isinstance(found, Formula):
            left.append(found)
        if missed:
            violated.append(str(part))
    return Rest(tuple(left), tuple(violated))


def _split(formula: Formula) -> Iterator[Formula]:
    """Return the conjuncts of a formula, also of what always holds."""
    if isinstance(formula, And):
        for operand in formula.operands:
            yield from _split(operand)
    elif isinstance(formula, Always):
        for part in _split(formula.child):
            yield Always(formula.interval, part)
    else:
        yield formula


def _progress_always(part: Always, trace: Trace, now: float) -> tuple[Formula | bool, bool]:
    """Return what is left of what always holds, and whether it was violated: what still holds now is worth keeping."""
    found = progress_formula(part, trace, FORGIVEN)
    violated = found is False
    if violated and part.interval[1] > now:
        found = Always((0.0, round(part.interval[1] - now, 9)), part.child)
    if isinstance(found, Always) and found.interval[0] == 0.0:
        present = float(robustness_signal(part.child, trace)[-1])
        if present < -FORGIVEN:
            return False, True
    return found, violated


def _write_true(scenario: FreeFlyerScenario) -> str:
    """Return a formula that holds wherever bodies are."""
    return f"G[0,0] {scenario.agents[0]}.x >= {scenario.world.lower[0] - 2.0 * scenario.world.diagonal:g}"


def _read_velocity(scenario: FreeFlyerScenario, name: str, velocity: np.ndarray) -> np.ndarray:
    """Return the velocity of a robot within its limit, and of an object nil where it is within an estimate's error."""
    body, found = scenario.body(name), np.array(velocity, dtype=float)
    if isinstance(body, Robot):
        return np.clip(found, -body.speed_limit, body.speed_limit)
    return found if np.linalg.norm(found) > STILL else np.zeros(2)


def _settle(scenario: FreeFlyerScenario, parts: tuple[Formula, ...], places: dict[str, np.ndarray]) -> None:
    """Move bodies into the areas that hold now and into the world, then apart; robots rather than objects."""
    for part in parts:
        if isinstance(part, Always) and part.interval[0] == 0.0 and isinstance(part.child, In):
            _put_inside(scenario, part.child, places)
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


def _put_inside(scenario: FreeFlyerScenario, predicate: In, places: dict[str, np.ndarray]) -> None:
    """Put a body that misses an area by less than is forgiven a little inside of it, or out of one to avoid."""
    H, b = scenario.areas[predicate.area].halfspaces()
    beyond = H @ places[predicate.body] - b
    if predicate.negated:
        if -FORGIVEN <= beyond.max() < INSIDE:
            places[predicate.body] = places[predicate.body] + (INSIDE - beyond.max()) * H[beyond.argmax()]
        return
    for face, bound in zip(H, b, strict=True):
        excess = float(face @ places[predicate.body] - bound)
        if -INSIDE < excess <= FORGIVEN:
            places[predicate.body] = places[predicate.body] - (excess + INSIDE) * face


def _brake(scenario: FreeFlyerScenario, places: Mapping[str, np.ndarray], speeds: dict[str, np.ndarray]) -> None:
    """Take from robots the closing speed that they cannot lose before they touch, if it may be an estimate's error."""
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
            if most < closing <= most + GRAZE:
                speeds[name] = speeds[name] - (closing - most) * normal


def _find_wall(scenario: FreeFlyerScenario, reserves: Reserves) -> float:
    """Return the distance to keep from solid obstacles: the reserve, or what the starts leave of it [m]."""
    gaps = [reserves.wall]
    for name in scenario.bodies:
        body = scenario.body(name)
        halt = find_halt(body, reserves) if isinstance(body, Robot) else np.array(body.start)
        for obstacle in scenario.obstacles.values():
            H, b = obstacle.halfspaces()
            if obstacle.solid:
                gaps += [float((H @ place - b).max()) - body.radius for place in (np.array(body.start), halt)]
    return max(0.0, min(gaps))
