"""Physics, sensors, formula, reward and expert of many worlds, each until its next awaited correction, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.dual_arm.step import Memory, Output, Scratch, step_task
from impact_envs.stl.compiled_formula import CompiledFormula
from planners.dual_arm.reference import ImpactMap
from planners.dual_arm.world_loop import control_world, read_world

# What is to be done with a world: nothing; observe; control and step.
REST, OBSERVE, ADVANCE = range(3)


class Progress(NamedTuple):
    """How far N worlds are.

    Attributes:
        todo: of REST, OBSERVE, ADVANCE, shape (N,).
        rewards: summed over arms and control periods since it was set to zero, shape (N,) [m].
        steps: control periods since it was set to zero, shape (N,).
        actions: of the arms, shape (N, 2, 3).
    """

    todo: np.ndarray
    rewards: np.ndarray
    steps: np.ndarray
    actions: np.ndarray


def make_progress(count: int) -> Progress:
    """Make the progress of worlds that rest."""
    return Progress(np.full(count, REST), np.zeros(count), np.zeros(count, np.int64), np.zeros((count, 2, 3)))


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
    habits: np.ndarray,
    heights: np.ndarray,
    weights: np.ndarray,
    controls: np.ndarray,
    experts: np.ndarray,
    room: np.ndarray,
    progress: tuple,
    horizon: int,
    left: int,
    c: int,
    first: int,
    end: int,
) -> None:
    """Run each world from first to before end to its next awaited correction, or to its end.

    Args:
        plants, worlds, clock, rules, tasks, scratch, formula, memory, output: as ``run_worlds`` takes them.
        law, habits, heights, weights, controls, experts, room: the first arguments of ``run_experts``.
        progress: the fields of Progress.
        horizon: control periods at which the formula is decided: nothing is observed there any more.
        left: control periods that may be run in this call, all worlds together; who calls can be interrupted then.
        c: thread.
        first, end: range of worlds.
    """
    work, parsed, kept, shown = Scratch(*scratch), CompiledFormula(*formula), Memory(*memory), Output(*output)
    at, impact_map = Progress(*progress), ImpactMap(heights, weights, law[0].rho)
    for k in range(first, end):
        while at.todo[k] != REST:
            if at.todo[k] == OBSERVE:
                read_world(law[0], habits[0], controls[k], experts[k], shown.joint[k])
                over = tasks[k].steps >= rules[0].last
                at.todo[k] = REST if over or experts[k].awaiting > 0 else ADVANCE
                continue
            if left == 0:
                return
            left -= 1
            actions = at.actions[k]
            control_world(law[0], habits[0], impact_map, controls[k], experts[k], room[c], actions)
            step_task(plants, worlds, clock[0], work, parsed, rules[0], tasks, kept, shown, c, k, at.actions)
            at.rewards[k] += shown.rewards[k, 0] + shown.rewards[k, 1]
            at.steps[k] += 1
            at.todo[k] = REST if tasks[k].lost > 0 or tasks[k].steps >= horizon else OBSERVE
