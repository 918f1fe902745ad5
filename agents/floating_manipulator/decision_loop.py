"""Physics, sensors, formula, reward and expert of many manipulators, each until its next correction, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from agents.decisions import PATIENCE
from agents.progress import ADVANCE, ANSWER, BEGIN, OBSERVE, REST, Progress
from impact_envs.compiled import announce, bind, compiled
from impact_envs.floating_manipulator.batch import ManipulatorBatch
from impact_envs.floating_manipulator.step import Output, run_range
from impact_envs.floating_manipulator.worlds import Arena, Memory, StepScratch, Worlds
from impact_envs.stl.compiled_formula import CompiledFormula
from planners.floating_manipulator import world_loop
from planners.floating_manipulator.expert_batch import FloatingManipulatorExpertBatch
from planners.floating_manipulator.world_loop import CONTROL, CORRECT, START, run_experts
from planners.floating_manipulator.world_memory import ExpertMemory, ExpertScratch, ExpertTable

RATE = 50_000  # control periods in a second, about
LOOK = world_loop.OBSERVE


class FloatingManipulatorLoop:
    """The compiled loop of floating manipulators, see `Decisions`.

    Args:
        batch: the worlds.
        experts: theirs.
        output: that the worlds write to.
        progress: how far they are.
    """

    def __init__(
        self, batch: ManipulatorBatch, experts: FloatingManipulatorExpertBatch, output: Output, progress: Progress
    ) -> None:
        announce(run_until_due)
        self._batch, self._experts, self._output, self._progress = batch, experts, output, progress
        self._bind()

    def run(self, thread: int, first: int, end: int) -> None:
        """Run the worlds from first to before end until they rest; for PATIENCE, about."""
        self._call(*self._collect(thread), int(PATIENCE * RATE), first, end)

    def forget(self, worlds: np.ndarray) -> None:
        """Nothing is done outside of compiled code."""

    def poll(self, k: int) -> None:
        """Nothing is done outside of compiled code."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_call"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def _bind(self) -> None:
        self._call = bind(run_until_due, *self._collect(0), 0, 0, 0)  # of no world

    def _collect(self, thread: int) -> tuple[Any, ...]:
        """Return what every call takes."""
        world, expert = self._batch.collect(thread), self._experts.collect(thread)
        return *world, self._output, *expert, self._progress, self._batch.scenario.steps


@compiled
def find_part(todo: int) -> int:
    """Return what the expert of a world does next, as `run_experts` calls it."""
    if todo == BEGIN:
        return START
    if todo == ANSWER:
        return CORRECT
    return LOOK if todo == OBSERVE else CONTROL


@compiled
def run_until_due(
    arena: Arena,
    worlds: Worlds,
    memory: Memory,
    formula: CompiledFormula,
    scratch: StepScratch,
    output: Output,
    table: ExpertTable,
    expert: ExpertMemory,
    options: np.ndarray,
    expert_scratch: ExpertScratch,
    at: Progress,
    horizon: int,
    left: int,
    first: int,
    end: int,
) -> None:
    """Run each world to its next awaited correction, or to its end.

    Args:
        arena, worlds, memory, formula, scratch, output: as ``run_range`` takes them.
        table, expert, options, expert_scratch: as ``run_experts`` takes them.
        at: how far the worlds are.
        horizon: control periods at which the formula is decided: nothing is observed there any more.
        left: control periods that may be run in this call, all worlds together; who calls can be interrupted then.
        first, end: range of worlds.
    """
    for k in range(first, end):
        while at.todo[k] != REST:
            progress = worlds.progress[k]
            if at.todo[k] == ADVANCE and left == 0:
                return
            part = find_part(at.todo[k])
            run_experts(table, expert, options, expert_scratch, at.joint, at.corrections, at.actions, part, k, k + 1)
            if part == START:
                at.todo[k] = OBSERVE
            elif part == CORRECT:
                at.todo[k] = ADVANCE
            elif part == LOOK:
                rests = progress.steps >= arena.last or expert.state[k].is_awaited
                at.todo[k] = REST if rests else ADVANCE
            else:
                left -= 1
                run_range(arena, worlds, memory, formula, scratch, output, at.actions, at.each, k, k + 1)
                total = 0.0
                for agent in range(output.rewards.shape[1]):
                    total += output.rewards[k, agent]
                at.rewards[k] += total
                at.steps[k] += 1
                decided = progress.overflow + progress.lost > 0 or progress.steps >= horizon
                at.todo[k] = REST if decided else OBSERVE
