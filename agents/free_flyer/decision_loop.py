"""Physics, sensors, formula, reward and expert of many worlds, each until its next awaited correction, compiled."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from agents.decisions import PATIENCE
from agents.progress import ADVANCE, ANSWER, BEGIN, OBSERVE, POLL, REST, Progress
from impact_envs.compiled import announce, compiled
from impact_envs.free_flyer.batch import Batch
from impact_envs.free_flyer.sensing import Sensing
from impact_envs.free_flyer.step import Memory, Output, Rules, run_range
from impact_envs.free_flyer.worlds import LOST, OVERFLOW, STEPS, Arena, Scratch, Worlds
from impact_envs.interface.threads import APART
from impact_envs.stl.compiled_formula import CompiledFormula
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.world_memory import NO_OBJECT, WorldMemory
from planners.free_flyer.closed_loop.world_loop import control_world, correct_impact, observe_world, start_world
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from planners.free_flyer.next_impact.rest_qp import RestQP
from planners.free_flyer.tracking.mpc import Workspace

RATE = 100_000  # control periods in a second, about


class FreeFlyerLoop:
    """The compiled loop of free-flyers, see `Decisions`; worlds whose plan is made anew follow tables of their own.

    Args:
        batch: the worlds.
        experts: theirs.
        output: that the worlds write to.
        progress: how far they are.
    """

    def __init__(self, batch: Batch, experts: FreeFlyerExpertBatch, output: Output, progress: Progress) -> None:
        announce(run_until_due)
        self._batch, self._experts, self._output, self._progress = batch, experts, output, progress
        # When a world is polled next [s]: inf for never, NaN where nobody plans in the background.
        self._wake = np.full(batch.count, np.inf if experts.plans_anew else np.nan)

    def run(self, thread: int, first: int, end: int) -> None:
        """Run the worlds from first to before end until they rest or are to be polled; for PATIENCE, about."""
        world, expert = (*self._batch.arrays, tuple(self._output)), (*self._experts.tables, self._experts.due)
        limits = self._batch.scenario.steps, int(PATIENCE * RATE)
        for plan, *ends in self._experts.split_worlds(first, end):
            arguments = *world, tuple(plan), *expert, tuple(self._progress), self._wake, *limits, APART * thread, *ends
            cast(Any, run_until_due)(*arguments)

    def forget(self, worlds: np.ndarray) -> None:
        """Forget the plans of their own and the questions of some worlds, a mask, shape (N,)."""
        for k in np.flatnonzero(worlds).tolist():
            self._experts.forget_world(k)
        self._wake[worlds] += np.inf  # not where it is NaN

    def poll(self, k: int) -> None:
        """Let world k ask for a new plan, or take one over."""
        self._experts.poll_plan(k)
        self._wake[k] = self._experts.find_wake(k)


@compiled
def must_poll(memory: WorldMemory, wake: np.ndarray, k: int) -> bool:
    """Return whether Python is to look after the background planner before world k observes."""
    now = memory.time[k]
    return now >= wake[k] or (not math.isnan(wake[k]) and 0.0 <= memory.wanted[k] <= now)


@compiled
def run_until_due(
    arena: tuple,
    worlds: tuple,
    scratch: tuple,
    log: np.ndarray,
    formula: tuple,
    sensing: tuple,
    rules: tuple,
    memory: tuple,
    output: tuple,
    plan: tuple,
    expert: tuple,
    options: np.ndarray,
    workspace: tuple,
    qp: tuple,
    due: np.ndarray,
    progress: tuple,
    wake: np.ndarray,
    horizon: int,
    left: int,
    c: int,
    first: int,
    end: int,
) -> None:
    """Run each world to its next awaited correction, to its end, or to where the background planner is asked.

    Args:
        arena, worlds, scratch, log, formula, sensing, rules, memory, output: as ``run_tuples`` takes them.
        plan, expert, options, workspace, qp, due: as ``run_experts`` takes them.
        progress: the fields of Progress.
        wake: when a world is polled next, NaN where nobody plans in the background, shape (N,) [s].
        horizon: control periods at which the formula is decided: nothing is observed there any more.
        left: control periods that may be run in this call, all worlds together; who calls can be interrupted then.
        c: thread.
        first, end: range of worlds.
    """
    worlds_, rules_, output_ = Worlds(*worlds), Rules(*rules), Output(*output)
    arena_, scratch_, formula_ = Arena(*arena), Scratch(*scratch), CompiledFormula(*formula)
    sensing_, memory_, plan_ = Sensing(*sensing), Memory(*memory), PlanTable(*plan)
    expert_, options_ = WorldMemory(*expert), options[0]
    workspace_, qp_, at = Workspace(*workspace), RestQP(*qp), Progress(*progress)
    for k in range(first, end):
        if at.todo[k] == BEGIN:
            start_world(plan_, expert_, options_, k)
            due[k], at.todo[k] = NO_OBJECT, OBSERVE
        elif at.todo[k] == ANSWER:
            due[k] = correct_impact(plan_, expert_, options_, k, due[k], at.corrections)
            at.todo[k] = ADVANCE if due[k] == NO_OBJECT else REST
        while at.todo[k] == OBSERVE or at.todo[k] == ADVANCE:
            if at.todo[k] == OBSERVE:
                due[k] = observe_world(plan_, expert_, options_, qp_, c, k, at.joint)
                over = worlds_.counter[k, STEPS] >= rules_.last
                at.todo[k] = REST if over or due[k] != NO_OBJECT else ADVANCE
                continue
            if left == 0:
                return
            left -= 1
            control_world(plan_, expert_, options_, workspace_, c, k, at.actions)
            run_range(
                arena_, worlds_, scratch_, log, formula_, sensing_, rules_, memory_, output_, at.actions, at.each, c, k,
                k + 1,
            )  # fmt: skip
            total = 0.0
            for r in range(output_.rewards.shape[1]):
                total += output_.rewards[k, r]
            at.rewards[k] += total
            at.steps[k] += 1
            failed = worlds_.counter[k, OVERFLOW] + worlds_.counter[k, LOST] > 0
            if failed or worlds_.counter[k, STEPS] >= horizon:
                at.todo[k] = REST
            else:
                at.todo[k] = POLL if must_poll(expert_, wake, k) else OBSERVE
