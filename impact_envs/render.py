"""One renderer for every domain: frames in, a window, RGB arrays or a film out."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.painter import Frame, Painter
from impact_envs.shape import Shape

if TYPE_CHECKING:
    import pygame

MODES = ("human", "rgb_array")
SUFFIXES = (".mp4", ".gif", ".png")


class Renderer:
    """Show frames of one world in a window, or return them as arrays.

    Args:
        world_lower: lower corner of the world box (x, y) [m].
        world_upper: upper corner of the world box (x, y) [m].
        shapes: what the world and its bodies look like.
        mode: "human" shows a window, "rgb_array" returns arrays and needs no display.
        size: width and height of the picture [px]; None chooses them from the shape of the world.
        fps: most frames per second shown in a window.

    Raises:
        InputError: unknown mode, empty world, or a size too small to draw in.
    """

    def __init__(
        self,
        world_lower: Sequence[float],
        world_upper: Sequence[float],
        shapes: Sequence[Shape],
        mode: str = "rgb_array",
        size: tuple[int, int] | None = None,
        fps: float = 60.0,
    ) -> None:
        if mode not in MODES:
            raise InputError(f"render mode '{mode}' is unknown: {choices(mode, MODES)}")
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # pygame greets on standard output
        self.mode = mode
        self._painter, self._fps = Painter(world_lower, world_upper, shapes, size), fps
        self._window: pygame.Surface | None = None

    def draw(self, frame: Frame) -> np.ndarray | None:
        """Draw one frame.

        Args:
            frame: poses and overlays of this instant.

        Returns:
            A new array, shape (height, width, 3) uint8, in mode "rgb_array"; None in mode "human".

        Raises:
            InputError: a body with a shape has no pose, or mode "human" finds no display.
            KeyboardInterrupt: the user closed the window.
        """
        import pygame

        picture = self._painter.paint(frame)
        if self.mode == "rgb_array":
            return np.ascontiguousarray(pygame.surfarray.array3d(picture).swapaxes(0, 1))
        self._show(picture)
        return None

    def close(self) -> None:
        """Close the window, if there is one; drawing again opens a new one."""
        if self._window is not None:
            import pygame

            pygame.display.quit()
            self._window = None

    def _show(self, picture: pygame.Surface) -> None:
        import pygame

        if self._window is None:
            pygame.display.init()
            if pygame.display.get_driver() == "offscreen":  # SDL's silent last resort
                pygame.display.quit()
                raise InputError("render mode 'human' finds no display; choices without one: rgb_array")
            self._window, self._clock = pygame.display.set_mode(picture.get_size()), pygame.time.Clock()
            pygame.display.set_caption("impact_envs")
        if pygame.event.get(pygame.QUIT):
            self.close()
            raise KeyboardInterrupt("window closed")
        self._window.blit(picture, (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)


def save_video(frames: Iterable[np.ndarray], path: str | Path, fps: float) -> Path:
    """Write frames to a film.

    Args:
        frames: pictures of one size, each shape (height, width, 3) uint8.
        path: file to write; its suffix decides the format, .mp4 (H.264), .gif (endless loop) or .png (the last frame).
        fps: frames per second.

    Returns:
        The path written.

    Raises:
        InputError: unknown suffix, missing directory, or no frames.
    """
    import imageio.v2 as imageio

    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"video '{path}' has suffix '{path.suffix}': {choices(path.suffix, SUFFIXES)}")
    if not path.parent.is_dir():
        raise InputError(f"video '{path}': directory '{path.parent}' does not exist")
    pictures = iter(frames)
    first = next(pictures, None)
    if first is None:
        raise InputError(f"video '{path}': there are no frames to write")
    if path.suffix.lower() == ".png":
        *_, last = itertools.chain([first], pictures)
        imageio.imwrite(path, last)
        return path
    if path.suffix.lower() == ".gif":
        options: dict[str, Any] = {"duration": 1000.0 / fps, "loop": 0}
    else:  # H.264 wants even sides, which a macro block of 2 ensures
        options = {"fps": fps, "codec": "libx264", "quality": 8, "macro_block_size": 2}
    writer: Any = imageio.get_writer(path, **options)
    with writer:
        for picture in itertools.chain([first], pictures):
            writer.append_data(picture)
    return path
