"""All that benchmarks/engine.py times, and what each includes and leaves out."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from engine_parts.ours import Episode, Setting, make_compiled, make_gpu, make_pettingzoo, make_vector
from engine_parts.peers import SUBSTEPS, make_pymunk, make_simple_spread, make_vmas

from impact_envs.errors import InputError


class Method(NamedTuple):
    """A way to step worlds.

    Attributes:
        name: in tables.
        make: of setting, batch size and number of steps; raises ImportError or InputError where it cannot run.
        largest: batch size that is measured.
        wall: its rate counts wall time, for several threads do the work.
        note: what its step includes, and how its physics differ from ours.
    """

    name: str
    make: Callable[[Setting, int, int], Episode]
    largest: int
    wall: bool
    note: str


COMPILED, VECTOR, PETTINGZOO = "ours, compiled step", "ours, vector_env", "ours, PettingZoo"
VMAS, PYMUNK, SPREAD = "VMAS transport", "pymunk model, PettingZoo", "simple_spread, PettingZoo"
BARE_PYMUNK = "pymunk, bare"
SETTINGS = (Setting("2+1", "corridor", 2, 1), Setting("4+3", "crew", 4, 3))


def make_methods(looped: int, largest: int) -> tuple[Method, ...]:
    """Return all methods in the order in which they take turns.

    Args:
        looped: largest batch of what loops over worlds in Python.
        largest: of all others.
    """
    cores = len(os.sched_getaffinity(0))
    ours = "physics, joint observation, reward, STL robustness"
    spread = (
        "mpe2: physics, observations, reward. Other physics: soft penalty contacts of robots, Euler steps of 0.1 s, "
        "nothing to move, no walls, no formula; actions in [0, 1]"
    )
    return (
        Method(COMPILED, make_compiled, largest, False, f"one call of the compiled function: {ours}"),
        Method(BARE_PYMUNK, make_pymunk, looped, False, f"physics alone, {SUBSTEPS} substeps, impacts to the substep"),
        Method(VECTOR, partial(make_vector, threads=1), largest, False, f"{ours}, infos; one thread"),
        Method(
            VMAS,
            make_vmas,
            largest,
            False,
            "physics, observations, reward; torch float32, one thread. Other physics: contacts are penalty forces in "
            "one step of 0.1 s, no restitution; boxes as packages, drag, no walls; no formula",
        ),
        Method(f"{VECTOR}, {cores} cores", partial(make_vector, threads=cores), largest, True, "the same; wall time"),
        Method(PETTINGZOO, partial(make_pettingzoo, engine="exact"), 1, False, f"{ours}, each robot's observation"),
        Method(
            PYMUNK,
            partial(make_pettingzoo, engine="pymunk"),
            looped,
            False,
            "the same environment on our model in Python that splits control periods at impacts and leaves lasting "
            "contacts to pymunk",
        ),
        Method(SPREAD, make_simple_spread, looped, False, spread),
        Method("ours, GPU", make_gpu, largest, True, f"{ours}; float32 kept, float64 arithmetic; wall time"),
    )


def check_settings(names: tuple[str, ...], hold: int) -> list[Setting]:
    """Return the settings of these names.

    Raises:
        InputError: one is unknown.
    """
    known = {setting.name: setting for setting in SETTINGS}
    for name in names:
        if name not in known:
            raise InputError(f"setting '{name}' is unknown; choices: {', '.join(known)}")
    return [known[name]._replace(hold=hold) for name in names]
