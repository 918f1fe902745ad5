"""Physics, sensors, formula, reward and expert of many worlds, each until its next awaited correction, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.free_flyer.sensing import Sensing
from impact_envs.free_flyer.step import STEP, Memory, Output, Rules, run_range
from impact_envs.free_flyer.worlds import LOST, OVERFLOW, STEPS, Arena, Scratch, Worlds
from impact_envs.stl.compiled_formula import CompiledFormula
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.world_memory import NO_OBJECT, WorldMemory
from planners.free_flyer.closed_loop.world_loop import control_world, correct_impact, observe_world, start_world
from planners.free_flyer.next_impact.rest_qp import RestQP
from planners.free_flyer.tracking.mpc import Workspace

# What is to be done with a world: nothing; start its expert; take the correction; observe; control and step; ask
# Python whether a new plan is wanted or there, and then observe.
REST, BEGIN, ANSWER, OBSERVE, ADVANCE, POLL = range(6)


class Progress(NamedTuple):
    """How far N worlds are.

    Attributes:
        todo: of REST ... POLL, shape (N,).
        due: object whose coming impact's correction is due, or NO_OBJECT, shape (N,).
        corrections: taken by ANSWER, in [-1, 1], shape (N, 2).
        wake: when POLL is next, inf for never, NaN where there is no background planner, shape (N,) [s].
        rewards: summed over robots and control periods since it was set to zero, shape (N,) [m].
        steps: control periods since it was set to zero, shape (N,).
        joint: everything measured once, shape (N, joint size).
        actions: of the robots, shape (N, r, 3).
        each: STEP of every world, as ``run_range`` reads it, shape (N,).
    """

    todo: np.ndarray
    due: np.ndarray
    corrections: np.ndarray
    wake: np.ndarray
    rewards: np.ndarray
    steps: np.ndarray
    joint: np.ndarray
    actions: np.ndarray
    each: np.ndarray


def make_progress(due: np.ndarray, joint: np.ndarray, robots: int, size: int) -> Progress:
    """Make the progress of N worlds that rest.

    Args:
        due: of the experts, shape (N,).
        joint: that the worlds write their measurements to, shape (N, joint size).
        robots: of a world.
        size: of a correction.
    """
    count = len(due)
    return Progress(
        todo=np.full(count, REST),
        due=due,
        corrections=np.zeros((count, size)),
        wake=np.full(count, np.inf),
        rewards=np.zeros(count),
        steps=np.zeros(count, np.int64),
        joint=joint,
        actions=np.zeros((count, robots, 3)),
        each=np.full(count, STEP),
    )


@compiled
def must_poll(memory: WorldMemory, progress: Progress, k: int) -> bool:
    """Return whether Python is to look after the background planner before world k observes."""
    now = memory.time[k]
    return now >= progress.wake[k] or (progress.wake[k] == progress.wake[k] and 0.0 <= memory.wanted[k] <= now)


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
    progress: tuple,
    horizon: int,
    left: int,
    c: int,
    first: int,
    end: int,
) -> None:
    """Run each world to its next awaited correction, to its end, or to where the background planner is asked.

    Args:
        arena, worlds, scratch, log, formula, sensing, rules, memory, output: as ``run_tuples`` takes them.
        plan, expert, options, workspace, qp: as ``run_experts`` takes them.
        progress: the fields of Progress.
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
            at.due[k], at.todo[k] = NO_OBJECT, OBSERVE
        elif at.todo[k] == ANSWER:
            at.due[k] = correct_impact(plan_, expert_, options_, k, at.due[k], at.corrections)
            at.todo[k] = ADVANCE if at.due[k] == NO_OBJECT else REST
        while at.todo[k] == OBSERVE or at.todo[k] == ADVANCE:
            if at.todo[k] == OBSERVE:
                at.due[k] = observe_world(plan_, expert_, options_, qp_, c, k, at.joint)
                over = worlds_.counter[k, STEPS] >= rules_.last
                at.todo[k] = REST if over or at.due[k] != NO_OBJECT else ADVANCE
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
                at.todo[k] = POLL if must_poll(expert_, at, k) else OBSERVE
