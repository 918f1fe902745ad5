"""What ``--render`` asks for: a film of an episode, its last frame, or a window with keys."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.scenario import Scenario

FPS = 30.0  # of films and windows, about
GIF_FPS = 15.0  # a GIF holds every frame's changes whole: half as many frames are half the file
PACE = 3.0  # times real time, where nobody asks for a speed
LONGEST_WAIT = (
    0.15  # share of the horizon that is shown in a second at the most, so that a short episode is seen slowly
)
HOLD = 2.0  # for which a film and a window stay at the end, with the verdict [s]
WINDOW = "human"
OnKey = Callable[[str, bool], None]


class Viewer:
    """Show an episode while it is played.

    The end of a ``with`` statement finishes the film or closes the window.

    Args:
        target: human, or a file ending in .mp4, .gif or .png (the last frame).
        scenario: where.
        speed: time shown in one second; None chooses 3 times real time, less for a short episode.
        caption: over the pictures.
        on_key: called with the name of a key of which a window knows nothing, and whether it is pressed or let go.

    Attributes:
        note: at the lower edge of a window.
        path: of the film; None of a window.

    Raises:
        InputError: another file, a folder that is missing, or a speed that is not above zero.
    """

    def __init__(
        self, target: str, scenario: Scenario, speed: float | None, caption: str, on_key: OnKey | None = None
    ) -> None:
        from impact_envs.picture.film import SUFFIXES, Film

        if speed is not None and not 0.0 < speed < float("inf"):
            raise InputError(f"--speed {speed:g} is no speed; choices: numbers above 0; 1 is real time")
        self.speed = speed or min(PACE, LONGEST_WAIT * scenario.horizon)
        self.caption, self.note, self._on_key, self._stack = caption, "", on_key, ExitStack()
        # Whole control periods between frames; their number per second then gives exactly the speed that is shown.
        rate = GIF_FPS if target.lower().endswith(".gif") else FPS
        self._every = max(1, round(self.speed / rate / scenario.control_period))
        self._film: Film | None = None
        self._window: Any = None
        self.path = None if target == WINDOW else Path(target)
        if self.path is None:
            return
        suffix = self.path.suffix.lower()
        if suffix not in SUFFIXES:
            raise InputError(
                f"--render {target}: {choices(target, (WINDOW, *(f'a file ending in {s}' for s in SUFFIXES)))}"
            )
        fps = min(self.speed / (self._every * scenario.control_period), 60.0)
        self._film = Film(target, fps, HOLD)
        if suffix == ".png":
            self._every = scenario.steps

    def __enter__(self) -> Viewer:
        if self._film is not None:
            self._stack.enter_context(self._film)
        return self

    def __exit__(self, *reason: Any) -> None:
        self._stack.__exit__(*reason)

    def add(self, env: Any) -> None:
        """Show the present step.

        Args:
            env: an ImpactEnv with a ``render_mode``, after reset or a step.
        """
        over = not env.agents
        if self._film is not None:
            if env.steps % self._every == 0 or over:
                self._film.add(env.render())
            return
        if self._window is None:
            self._window = env.make_renderer(WINDOW, speed=self.speed, on_key=self._on_key)
            self._stack.callback(self._window.close)
        self._window.draw(replace(env.make_frame(), note=self.note), last=over)
        if over:
            self._window.hold(HOLD)


def find_followed(policy: Any) -> Any:
    """Return the plan that a policy follows, None without one."""
    return getattr(getattr(policy, "expert", policy), "plan", None)


def sample_curves(policy: Any) -> dict[str, Any]:
    """Return the curves of the plan a policy follows, as polylines."""
    plan = find_followed(policy)
    if plan is None:
        return {}
    times = np.linspace(0.0, plan.horizon, 400)
    curves = plan.robots | plan.objects
    return {name: np.array([curve.position(t) for t in times]) for name, curve in curves.items()}
