"""Experts of many worlds: one compiled call observes or controls all of them."""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled
from planners.free_flyer.options import Options
from planners.free_flyer.pilot import adopt_world, control_world, observe_world, start_world
from planners.free_flyer.progress import Progress
from planners.free_flyer.reoptimisation import Program
from planners.free_flyer.script import END, Script
from planners.free_flyer.tracking import Workspace

# What to do with the worlds.
START, OBSERVE, CONTROL, ACT, ADOPT = range(5)


@compiled
def run_experts(
    script: tuple,
    progress: tuple,
    options: tuple,
    workspace: tuple,
    program: tuple,
    joint: np.ndarray,
    actions: np.ndarray,
    due: np.ndarray,
    phase: int,
    c: int,
    first: int,
    end: int,
) -> None:
    """Start, observe or control the worlds from first to before end; plain tuples pass three times faster from Python.

    Args:
        script, progress, options, workspace, program: the fields of Script, Progress, Options, Workspace, Program.
        joint: everything measured once, shape (N, 7 n + r + 3).
        actions: written by CONTROL and ACT, shape (N, r, 3).
        due: object whose coming impact's correction is due, or END, written by START and OBSERVE, shape (N,).
        phase: START, OBSERVE, CONTROL; ACT: observe and control, and start where time is 0; ADOPT: go on with a new
            script.
        c: thread.
        first, end: range of worlds.
    """
    script_, progress_ = Script(*script), Progress(*progress)
    options_, workspace_, program_ = Options(*options), Workspace(*workspace), Program(*program)
    clock = joint.shape[1] - 3
    for k in range(first, end):
        if phase == START or (phase == ACT and joint[k, clock] == 0.0):
            start_world(script_, progress_, options_, k)
            due[k] = END
        if phase == ADOPT:
            adopt_world(script_, progress_, k)
        if phase in (OBSERVE, ACT):
            due[k] = observe_world(script_, progress_, options_, program_, c, k, joint)
        if phase in (CONTROL, ACT):
            control_world(script_, progress_, options_, workspace_, c, k, actions)
