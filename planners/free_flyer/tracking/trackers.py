"""The trackers that a user can choose by name; solvers are loaded when a tracker that needs them is made."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from impact_envs.errors import InputError, choices
from planners.errors import SolverFailed
from planners.free_flyer.tracking.mpc import make_workspace, solve_tracking
from planners.free_flyer.tracking.problem import TrackingProblem, TrackingTask
from planners.free_flyer.tracking.protocol import Tracker

COMPILED = ("mpc", "lqr")
TRACKERS = (*COMPILED, "casadi", "cvxpy", "published")
OWN = "own"  # what Options.tracker says of a user's object


def find_tracker(chosen: str | Tracker) -> tuple[str, Tracker | None]:
    """Return the name and the object of a tracker; compiled ones need none.

    Args:
        chosen: a name of `TRACKERS`, or an object.

    Raises:
        InputError: an unknown name, or an object that is no tracker.
    """
    if not isinstance(chosen, str):
        if not isinstance(chosen, Tracker):
            raise InputError(
                f"tracker = {chosen!r} has no reset and track; choices: {', '.join(TRACKERS)}, or a Tracker"
            )
        return OWN, chosen
    if chosen == "casadi":
        from planners.free_flyer.tracking.casadi_mpc import CasadiTracker

        return chosen, CasadiTracker()
    if chosen == "cvxpy":
        from planners.free_flyer.tracking.cvxpy_mpc import CvxpyTracker

        return chosen, CvxpyTracker()
    if chosen == "published":
        from planners.free_flyer.tracking.published_mpc import PublishedTracker

        return chosen, PublishedTracker()
    check_tracker(chosen)
    return chosen, None


def check_tracker(name: str, many: bool = False) -> None:
    """Raise unless there is a tracker of this name; none is made.

    Args:
        name: of the tracker.
        many: whether it is to follow many worlds.

    Raises:
        InputError: an unknown name, or one that follows one world.
    """
    if name not in TRACKERS:
        raise InputError(f"tracker '{name}' is unknown; {choices(name, COMPILED if many else TRACKERS)}")
    if many and name not in COMPILED:
        raise InputError(f"tracker '{name}' follows one world; experts of many worlds take {' or '.join(COMPILED)}")


def check_compiled(chosen: str | Tracker) -> str:
    """Return the name of a compiled tracker.

    Raises:
        InputError: it is none.
    """
    name, tracker = find_tracker(chosen)
    if tracker is not None:
        label = type(tracker).__name__ if name == OWN else f"'{name}'"
        raise InputError(f"tracker {label} follows one world; experts of many worlds take {' or '.join(COMPILED)}")
    return name


class MpcTracker:
    """The compiled MPC as an object: to call it in a tracker of one's own, or to compare others with it."""

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        """See `Tracker.reset`."""
        self._rows = {robot: problem.row for robot, problem in problems.items()}
        self._workspace = make_workspace()

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        """See `Tracker.track`."""
        for column, value in zip(self._workspace, task, strict=False):
            column[0] = value
        if not solve_tracking(self._workspace, 0, self._rows[robot]):
            raise SolverFailed(
                "tracking MPC", "not solved within the Newton steps", "check the state and the reference"
            )
        return self._workspace.solution[0].reshape(-1, 3).copy()
