"""What published plans say of their impacts, and how far that is from the impact law."""

from __future__ import annotations

import numpy as np

from impact_envs.errors import InputError, choices
from planners.free_flyer.published.curve import JUMP, PublishedBody, PublishedPlan
from planners.plan import PlannedImpact


def read_impacts(plan: PublishedPlan) -> tuple[PlannedImpact, ...]:
    """Return the impacts that the labels state, with the velocities of the curves.

    Args:
        plan: published bodies are points, so position and contact agree and the change of the object's velocity gives
            the normal; where they differ, they give the normal.

    Returns:
        Impacts in the order of time.

    Raises:
        InputError: a label of one body has no match in the other body's, or an impact has no direction.
    """
    found, met = [], 0
    for name in plan.objects:
        body = plan.bodies[name]
        for joint in range(len(body.h)):
            robot = body.impact_partner(joint)
            if robot is not None:
                found.append(_read_impact(plan, robot, name, joint))
    for robot in plan.robots:
        met += sum(plan.bodies[robot].impact_partner(k) is not None for k in range(len(plan.bodies[robot].h)))
    if met != len(found):
        raise InputError(f"robots are labelled with {met} impacts, objects with {len(found)}")
    return tuple(sorted(found, key=lambda impact: impact.time))


def read_deviation(plan: PublishedPlan) -> float | None:
    """Return the permissible deviation delta of an object's velocity after an impact.

    The box after an impact holds +- delta in both axes, and more where the velocity before it was uncertain;
    delta is therefore the least half width of velocity after any impact.

    Args:
        plan: with boxes of its objects.

    Returns:
        delta [m/s]; None without boxes or impacts.

    Source: Verhagen & Tumova, Eqs. (17), (18).
    """
    widths = [
        tube.start[joint + 1, 1, 2:].min()
        for name, tube in plan.zonotopes.items()
        for joint in range(len(tube.start) - 1)
        if plan.bodies[name].impact_partner(joint) is not None
    ]
    return float(min(widths)) if widths else None


def _read_impact(plan: PublishedPlan, robot: str, name: str, joint: int) -> PlannedImpact:
    """Return the impact of a robot where a curve of an object ends."""
    body, time = plan.bodies[name], float(plan.bodies[name].h[joint, -1])
    if robot not in plan.robots:
        raise InputError(f"{name}: other_names: curve {joint + 1} names '{robot}'; {choices(robot, plan.robots)}")
    hitter = plan.bodies[robot]
    meets = [k for k, end in enumerate(hitter.h[:-1, -1]) if abs(end - time) <= JUMP]
    meets = [k for k in meets if hitter.impact_partner(k) == name]
    if not meets or joint + 1 == len(body.h):
        raise InputError(f"{name} is hit by {robot} at {time} s, but {robot} has no impact with {name} then")
    joints = ((hitter, meets[0]), (body, joint))
    velocities = [_end_velocity(one, k + after, after) for one, k in joints for after in (0, 1)]
    position, contact = body.r[joint, -1, :2], hitter.r[meets[0], -1, :2]
    apart = float(np.abs(position - contact).max())
    direction = position - contact if apart > JUMP else velocities[3] - velocities[2]
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise InputError(f"impact of {robot} on {name} at {time} s changes no velocity")
    return PlannedImpact(time, robot, name, position, contact, direction / length, *velocities)


def _end_velocity(body: PublishedBody, k: int, start: int) -> np.ndarray:
    """Return the velocity at the start (1) or end (0) of a curve, shape (2,)."""
    edge = slice(0, 2) if start else slice(-2, None)
    return np.diff(body.r[k, edge, :2], axis=0)[0] / np.diff(body.h[k, edge])[0]
