"""What a permissible deviation refers to: gap between impacts, first and last box of the object, extent of bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.reserves import Reserves


@dataclass(frozen=True)
class Conditions:
    """Hold what a permissible deviation refers to.

    Args:
        gap: least time between impacts, and after the last one [s].
        final_velocity: greatest speed per axis at the horizon of an object that has to rest [m/s].
        initial: half widths of the box the object starts in [m].
        margin: robustness that the boxes keep [m].
        points: bodies have no extent: robots meet the object's centre, may pass through it, and may use their full
            speed at impacts.
        room: distance beyond its contact points within which a robot must not leave its areas, to come to a halt [m].
        gather: the motions of a robot between two consecutive hits of its own must be able to meet in one point.
    """

    gap: float
    final_velocity: float = 0.05
    initial: tuple[float, float] = (0.0, 0.0)
    margin: float = 0.0
    points: bool = False
    room: float = 0.0
    gather: bool = True


def make_conditions(
    scenario: FreeFlyerScenario,
    reserves: Reserves = Reserves(),  # noqa: B008 - frozen
) -> Conditions:
    """Return what a deviation refers to in a scenario; change it by `dataclasses.replace`.

    Args:
        scenario: of one object; says gap, final velocity and the box in which the object starts.
        reserves: give the margin, and the gap where the scenario does not.
    """
    body = next(iter(scenario.objects.values()))
    gap = scenario.impact_gap or reserves.times(scenario.horizon)[1]
    return Conditions(gap, body.final_speed, body.start_uncertainty, reserves.tracking)


def check_conditions(scenario: FreeFlyerScenario, conditions: Conditions) -> None:
    """Check that conditions fit a scenario of one object.

    Raises:
        InputError: a number is negative, or the object could start outside the world.
    """
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
