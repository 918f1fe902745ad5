"""How far the worlds of a compiled loop from decision to decision are; each domain's loop reads and writes it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# What is to be done with a world: nothing; start its expert; take the correction; observe; control and step; ask
# Python whether a new plan is wanted or there, and then observe.
REST, BEGIN, ANSWER, OBSERVE, ADVANCE, POLL = range(6)
STEP = 1  # of every domain's ``run_range``


class Progress(NamedTuple):
    """How far N worlds are.

    Attributes:
        todo: of REST ... POLL, shape (N,).
        corrections: taken by ANSWER, in [-1, 1], shape (N, correction size).
        rewards: summed over agents and control periods since they were taken, shape (N,) [m].
        steps: control periods since the last start or answer, shape (N,).
        joint: everything measured once, shape (N, joint size).
        actions: of the agents, shape (N, ...).
        each: STEP of every world, as ``run_range`` reads it, shape (N,).
    """

    todo: np.ndarray
    corrections: np.ndarray
    rewards: np.ndarray
    steps: np.ndarray
    joint: np.ndarray
    actions: np.ndarray
    each: np.ndarray


def make_progress(joint: np.ndarray, action_shape: tuple[int, ...], size: int) -> Progress:
    """Make the progress of N worlds that rest.

    Args:
        joint: that the worlds write their measurements to, shape (N, joint size).
        action_shape: of one world's actions.
        size: of a correction.
    """
    count = len(joint)
    return Progress(
        todo=np.full(count, REST),
        corrections=np.zeros((count, size)),
        rewards=np.zeros(count),
        steps=np.zeros(count, np.int64),
        joint=joint,
        actions=np.zeros((count, *action_shape)),
        each=np.full(count, STEP),
    )
