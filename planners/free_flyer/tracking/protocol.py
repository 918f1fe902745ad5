"""What a tracker is: an object that returns the inputs with which one robot follows its reference."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np

from impact_envs.errors import InputError
from planners.errors import SolverFailed
from planners.free_flyer.tracking.mpc import Workspace, view_task
from planners.free_flyer.tracking.problem import STAGES, TrackingProblem, TrackingTask


@runtime_checkable
class Tracker(Protocol):
    """Follow the references of the robots of one world; an object serves one expert at a time."""

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        """Start an episode: build what is not built yet, and forget the last episode.

        Args:
            problems: robot to what stays the same of its tracking problem; the same object for all episodes.
        """

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        """Return the robot's inputs from now on.

        Args:
            robot: its name.
            task: what it has to track; its arrays are only valid during the call.

        Returns:
            Inputs [Fx, Fy, torque] of one to ten stages in the body frame, shape (n, 3) [N, N, N m]. The first is
            applied, within the robot's limits; the others are what is flown where later solves fail.

        Raises:
            SolverFailed: there is no solution; the expert falls back, and counts that it does.
        """


def call_tracker(tracker: Tracker, robot: str, workspace: Workspace, c: int) -> None:
    """Solve the tracking problem in row c of a workspace by a tracker; ``solution`` and ``solved`` are written.

    Inputs that are not finite are no solution.

    Raises:
        InputError: the tracker returned an array of another shape.
    """
    workspace.solved[c] = 0
    try:
        inputs = np.asarray(tracker.track(robot, view_task(workspace, c)), dtype=float)
    except SolverFailed:
        return
    if inputs.ndim != 2 or inputs.shape[1] != 3 or not 1 <= len(inputs) <= STAGES:
        raise InputError(
            f"tracker {type(tracker).__name__} returned inputs of shape {inputs.shape}; "
            f"(n, 3) with n from 1 to {STAGES} is needed"
        )
    if np.isfinite(inputs).all():
        workspace.solution[c, : inputs.size] = inputs.ravel()
        workspace.solved[c] = len(inputs)
