"""Physics, sensors, formula, reward and expert of many pairs of arms, each until its next correction, compiled."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from agents.decisions import PATIENCE
from agents.progress import ADVANCE, ANSWER, BEGIN, OBSERVE, REST, Progress
from impact_envs.compiled import announce, compiled
from impact_envs.dual_arm.batch import DualArmBatch
from impact_envs.dual_arm.step import Output, run_worlds
from impact_envs.interface.threads import APART
from planners.dual_arm import world_loop
from planners.dual_arm.expert_batch import DualArmExpertBatch
from planners.dual_arm.world_loop import run_experts

RATE = 10_000  # control periods in a second, about
LOOK, CONTROL = world_loop.OBSERVE, world_loop.CONTROL


class DualArmLoop:
    """The compiled loop of two arms and a box, see `Decisions`.

    Args:
        batch: the worlds.
        experts: theirs.
        output: that the worlds write to.
        progress: how far they are.
    """

    def __init__(self, batch: DualArmBatch, experts: DualArmExpertBatch, output: Output, progress: Progress) -> None:
        announce(run_until_due)
        self._batch, self._experts, self._output, self._progress = batch, experts, output, progress

    def run(self, thread: int, first: int, end: int) -> None:
        """Run the worlds from first to before end until they rest; for PATIENCE, about."""
        world = *self._batch.collect(), tuple(self._output)
        limits = self._batch.last, self._batch.scenario.steps, int(PATIENCE * RATE)
        cast(Any, run_until_due)(
            *world, *self._experts.arrays, tuple(self._progress), *limits, APART * thread, first, end
        )

    def forget(self, worlds: np.ndarray) -> None:
        """Forget the episodes of some worlds, a mask, shape (N,)."""
        self._experts.forget_worlds(worlds)

    def poll(self, k: int) -> None:
        """Nothing is done outside of compiled code."""


@compiled
def run_until_due(
    plants: np.ndarray,
    worlds: np.ndarray,
    clock: np.ndarray,
    rules: np.ndarray,
    tasks: np.ndarray,
    scratch: tuple,
    formula: tuple,
    memory: tuple,
    output: tuple,
    law: np.ndarray,
    expert_rules: np.ndarray,
    heights: np.ndarray,
    weights: np.ndarray,
    control: np.ndarray,
    expert: np.ndarray,
    expert_scratch: np.ndarray,
    progress: tuple,
    last: int,
    horizon: int,
    left: int,
    thread: int,
    first: int,
    end: int,
) -> None:
    """Run each world to its next awaited correction, or to its end.

    Args:
        plants, worlds, clock, rules, tasks, scratch, formula, memory, output: as ``run_worlds`` takes them.
        law, expert_rules, heights, weights, control, expert, expert_scratch: as ``run_experts`` takes them.
        progress: the fields of Progress.
        last: control periods after which an episode is over.
        horizon: control periods at which the formula is decided: nothing is observed there any more.
        left: control periods that may be run in this call, all worlds together; who calls can be interrupted then.
        thread: whose scratch.
        first, end: range of worlds.
    """
    at, rewards = Progress(*progress), Output(*output).rewards
    for k in range(first, end):
        if at.todo[k] == BEGIN:
            at.todo[k] = OBSERVE
        elif at.todo[k] == ANSWER:
            expert[k].answer[0], expert[k].answer[1] = at.corrections[k, 0], at.corrections[k, 1]
            expert[k].awaiting = 0
            at.todo[k] = ADVANCE
        while at.todo[k] != REST:
            if at.todo[k] == ADVANCE and left == 0:
                return
            part = LOOK if at.todo[k] == OBSERVE else CONTROL
            arrays = law, expert_rules, heights, weights, control, expert, expert_scratch, at.joint, at.actions
            run_experts(*arrays, part, thread, k, k + 1)
            if part == LOOK:
                at.todo[k] = REST if tasks[k].steps >= last or expert[k].awaiting else ADVANCE
                continue
            left -= 1
            run_worlds(
                plants, worlds, clock, rules, tasks, scratch, formula, memory, output, at.actions, at.each, thread, k,
                k + 1,
            )  # fmt: skip
            at.rewards[k] += 0.0 + rewards[k, 0] + rewards[k, 1]
            at.steps[k] += 1
            at.todo[k] = REST if tasks[k].lost > 0 or tasks[k].steps >= horizon else OBSERVE
