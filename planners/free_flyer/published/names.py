"""Names of a published plan's bodies as a scenario's: given, equal, or told by roles and starts."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.published.curve import PublishedPlan

APART = 1e-3  # by which the sum of distances of another assignment must be greater [m]
MOST = 7  # bodies of a kind whose assignments are all compared


def match_names(
    published: PublishedPlan, scenario: FreeFlyerScenario, given: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the scenario's name of every body of a plan.

    Objects are those that impacts alone move, robots all others. Where the names of a kind are not the scenario's, its
    bodies are assigned by their starts: the sum of the distances is least.

    Args:
        published: the plan.
        scenario: whose names are wanted.
        given: plan's name to scenario's name, of some bodies.

    Returns:
        Plan's name to scenario's name; where the numbers of bodies differ, names stay as they are.

    Raises:
        InputError: a given name is unknown or taken twice, or starts do not tell who is who.
    """
    names = dict(given or {})
    for old, new in names.items():
        if old not in published.bodies:
            raise InputError(f"rename {old}={new}: the plan has no body '{old}'; {choices(old, published.bodies)}")
        if new not in scenario.bodies:
            known = choices(new, scenario.bodies)
            raise InputError(f"rename {old}={new}: scenario {scenario.name} has no body '{new}'; {known}")
    kinds = (published.objects, tuple(scenario.objects)), (published.robots, tuple(scenario.robots))
    for found, known_names in kinds:
        left = [name for name in found if name not in names]
        open_ = [name for name in known_names if name not in names.values()]
        if set(left) == set(open_) or len(left) != len(open_):
            names |= {name: name for name in left}
        else:
            names |= _assign_by_starts(published, scenario, left, open_)
    taken: dict[str, str] = {}
    for old, new in names.items():
        if new in taken:
            raise InputError(
                f"'{taken[new]}' and '{old}' of the plan would both be '{new}' of scenario {scenario.name}"
            )
        taken[new] = old
    return names


def rename_bodies(published: PublishedPlan, names: Mapping[str, str]) -> PublishedPlan:
    """Return a plan with other names of its bodies, in its labels too.

    Args:
        published: the plan.
        names: old to new, of all bodies.
    """
    known = {**names, "none": "none"}
    return PublishedPlan(
        {
            names[name]: replace(body, other_names=tuple(known[other] for other in body.other_names))
            for name, body in published.bodies.items()
        },
        {names[name]: tube for name, tube in published.zonotopes.items()},
    )


def _assign_by_starts(
    published: PublishedPlan, scenario: FreeFlyerScenario, left: list[str], known: list[str]
) -> dict[str, str]:
    """Return the assignment of equally many bodies with the least sum of distances between starts."""
    if len(left) == 1:
        return {left[0]: known[0]}
    pairs = f"{', '.join(left)} of the plan are {', '.join(known)} of scenario {scenario.name}"
    if len(left) > MOST:
        raise InputError(f"too many bodies to tell by their starts how {pairs}; say it with --rename")
    starts = np.array([published.bodies[name].position(0.0) for name in left])
    places = np.array([scenario.body(name).start for name in known])
    distances = np.linalg.norm(starts[:, None] - places, axis=2)
    rows = np.arange(len(left))
    orders = sorted(itertools.permutations(rows), key=lambda order: float(distances[rows, order].sum()))
    best, second = (float(distances[rows, order].sum()) for order in orders[:2])
    if second - best < APART:
        raise InputError(f"starts do not tell how {pairs}; say it with --rename")
    return {name: known[k] for name, k in zip(left, orders[0], strict=True)}
