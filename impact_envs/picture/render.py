"""One renderer for every domain: frames in, a window or RGB arrays out."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.interface.shape import Shape
from impact_envs.picture.film import SUFFIXES, Film
from impact_envs.picture.frame import Frame, Mark
from impact_envs.picture.painter import ARROW, Painter
from impact_envs.picture.window import Window

__all__ = ["MODES", "SUFFIXES", "Film", "Frame", "Mark", "Renderer"]

MODES = ("human", "rgb_array")


class Renderer:
    """Show frames of one world in a window, or return them as arrays.

    Args:
        lower: lower corner of what is shown of the world (x, y) [m].
        upper: upper corner of it (x, y) [m].
        shapes: what the world and its bodies look like.
        mode: "human" shows a window, "rgb_array" returns arrays and needs no display.
        size: width and height of the picture [px]; None chooses them from the shape of the world.
        fps: most frames per second shown in a window.
        speed: time shown in a window in one second; 1 is real time.
        arrow: an arrow is as long as its change of velocity moves a body in this time [s].
        on_key: called with the name of a key of which the window knows nothing, and whether it is pressed or let go.

    Raises:
        InputError: unknown mode, empty world, or a size too small to draw in.
    """

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        shapes: Sequence[Shape],
        mode: str = "rgb_array",
        size: tuple[int, int] | None = None,
        fps: float = 60.0,
        speed: float = 1.0,
        arrow: float = ARROW,
        on_key: Callable[[str, bool], None] | None = None,
    ) -> None:
        if mode not in MODES:
            raise InputError(f"render mode '{mode}' is unknown: {choices(mode, MODES)}")
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # pygame greets on standard output
        self.mode = mode
        self._painter = Painter(lower, upper, shapes, size, arrow)
        self._window = Window(self._painter.size, fps, speed, on_key) if mode == "human" else None

    def draw(self, frame: Frame, last: bool = False) -> np.ndarray | None:
        """Draw one frame; a window passes over one that would be seen too short.

        Args:
            frame: poses and overlays of this instant.
            last: the window shows it in any case.

        Returns:
            A new array, shape (height, width, 3) uint8, in mode "rgb_array"; None in mode "human".

        Raises:
            InputError: a body with a shape has no pose, or mode "human" finds no display.
            KeyboardInterrupt: the user closed the window.
        """
        if self._window is not None:
            if last or self._window.is_due(frame.time):
                self._window.show(self._painter.paint(replace(frame, speed=self._window.speed)), frame.time)
            return None
        picture = self._painter.paint(frame)
        width, height = picture.get_size()
        # One straight copy: a view with the axes as pygame has them would be copied pixel by pixel.
        return np.array(picture.get_view("0"), dtype=np.uint8).reshape(height, width, 3)

    def hold(self, seconds: float) -> None:
        """Leave the window as it is for a while, or until the user closes it."""
        if self._window is not None:
            self._window.hold(seconds)

    def close(self) -> None:
        """Close the window, if there is one; drawing again opens a new one."""
        if self._window is not None:
            self._window.close()
