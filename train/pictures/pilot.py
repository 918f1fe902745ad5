"""A person as a policy: the keys that are held are one robot's action."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.rollout import Diagnostics, Policy

# Keys of each number of an action, first for +1, then for -1.
AXES = (("right", "left"), ("up", "down"), ("a", "d"), ("w", "s"), ("r", "f"), ("t", "g"))
NEXT, GENTLE = "tab", "left shift"
GENTLE_SHARE = 0.25  # of the action, while its key is held
HELP = "arrows push, a d turn, Shift gently, Tab next"


class Pilot:
    """Fly one robot at a time by keys; another policy moves the rest.

    Args:
        sizes: robot to the size of its action.
        others: the other robots' policy.
        robot: flown first; None is the first one.

    Attributes:
        robot: that is flown.

    Raises:
        InputError: an unknown robot, or an action with more numbers than there are keys.
    """

    name = "person"

    def __init__(self, sizes: Mapping[str, int], others: Policy, robot: str | None = None) -> None:
        if robot is not None and robot not in sizes:
            raise InputError(f"robot '{robot}' is unknown; {choices(robot, sizes)}")
        if max(sizes.values()) > len(AXES):
            raise InputError(f"an action of {max(sizes.values())} numbers has no keys; there are keys for {len(AXES)}")
        self._sizes, self._others = dict(sizes), others
        self.robot = robot or next(iter(sizes))
        self._held: set[str] = set()

    def press(self, key: str, pressed: bool) -> None:
        """Take a key that is pressed or let go."""
        if key == NEXT and pressed:
            names = list(self._sizes)
            self.robot = names[(names.index(self.robot) + 1) % len(names)]
        (self._held.add if pressed else self._held.discard)(key)

    def reset(self, seed: int) -> None:
        """Begin an episode; keys that are held stay held."""
        self._others.reset(seed)

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the others' actions, and of the robot that is flown what the keys say, in [-1, 1]."""
        axes: Sequence[tuple[str, str]] = AXES[: self._sizes[self.robot]]
        push = np.array([float(plus in self._held) - float(minus in self._held) for plus, minus in axes])
        return self._others.act(observations) | {self.robot: push * (GENTLE_SHARE if GENTLE in self._held else 1.0)}

    def diagnostics(self) -> Diagnostics:
        """Return the others' diagnostics."""
        return self._others.diagnostics()
