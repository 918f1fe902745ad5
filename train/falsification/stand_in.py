"""A cheaper policy that searches in another one's place; what it finds counts where the other one fails as well.

An expert that does not plan anew, for example, plays the very episodes of the one that does up to the moment at which
a new plan is taken over, and plays them in a tenth of the time. It misses worlds in which a new plan does harm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from impact_envs.errors import InputError
from train.evaluation.case import EXPERT, Case, check_settings
from train.falsification.arena import Arena, Played
from train.falsification.counterexample import minimise


@dataclass(frozen=True)
class ReplayOptions:
    """Say which failures of a stand-in the policy itself plays again.

    Attributes:
        causes: for each counterexample that is wanted, the most frequent ones; more than one, for the policy itself may
            fail by another cause, or not at all.
        each: failures of each cause, the mildest ones; one of them as mild as the stand-in still fails, too.
    """

    causes: int = 2
    each: int = 4


def make_stand_in(case: Case, policy: str, settings: Mapping[str, Any]) -> Case:
    """Return the case of a policy's stand-in: the same world, plan and policy, with other options of its expert.

    Args:
        case: of the policy.
        policy: its name.
        settings: ``expert.NAME`` to value.

    Raises:
        InputError: a name that is not the expert's, or a value that does not fit.
    """
    for name in settings:
        if not name.startswith(EXPERT):
            raise InputError(
                f"--stand-in {name}: give options of the expert, {EXPERT}NAME=VALUE; the world stays the same"
            )
    made = replace(case, settings={**case.settings, **settings})
    check_settings(made, [policy])
    return made


def replay_failures(
    arena: Arena, stand_in: Arena, played: Played, most: int, options: ReplayOptions = ReplayOptions()
) -> Played:
    """Play the mildest failures of a stand-in's most frequent causes with the policy itself, and return its episodes.

    Args:
        arena: of the policy.
        stand_in: of its stand-in.
        played: episodes of the stand-in's search.
        most: counterexamples that are wanted.
        options: how many are played.
    """
    causes, counts = np.unique(played.causes[~played.success].astype(str), return_counts=True)
    frequent = causes[np.argsort(-counts, kind="stable")][: options.causes * most]
    distances = np.abs(played.places - arena.worlds.nominal).sum(axis=1)
    groups = [np.flatnonzero((played.causes == cause) & ~played.success) for cause in frequent]
    groups = [rows[np.argsort(distances[rows], kind="stable")][: options.each] for rows in groups]
    if not groups:
        return Played(*(column[:0] for column in played))
    first, every = np.array([rows[0] for rows in groups]), np.concatenate(groups)
    milder = minimise(stand_in, played.places[first], played.seeds[first])
    places = np.concatenate([milder, played.places[every]])
    return arena.play(places, np.concatenate([played.seeds[first], played.seeds[every]]))
