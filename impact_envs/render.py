"""One renderer for every domain: frames in, a window, RGB arrays or a film out."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.file import replace_file
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


class Film:
    """Write frames to a file as they come; its suffix decides the format.

    Args:
        path: file to write: .mp4 (H.264), .gif (endless loop) or .png (the last frame).
        fps: frames per second.

    The end of a ``with`` statement closes it; an exception leaves no file.

    Raises:
        InputError: unknown suffix, or missing directory.
    """

    def __init__(self, path: str | Path, fps: float) -> None:
        self.path, self._fps = Path(path), fps
        self._file, self._encoded = ExitStack(), io.BytesIO()
        self.suffix = self.path.suffix.lower()
        self._writer: Any = None
        self._last: np.ndarray | None = None
        if self.suffix not in SUFFIXES:
            raise InputError(f"video '{path}' has suffix '{self.path.suffix}': {choices(self.path.suffix, SUFFIXES)}")
        if not self.path.parent.is_dir():
            raise InputError(f"video '{path}': directory '{self.path.parent}' does not exist")

    def add(self, picture: np.ndarray) -> None:
        """Append a frame.

        Args:
            picture: shape (height, width, 3) uint8, of the same size every time.

        Raises:
            InputError: the file cannot be written.
        """
        self._last = picture
        if self.suffix != ".png":
            try:
                self._writer = self._writer or self._open()
                self._writer.append_data(picture)
            except BaseException:
                self.__exit__(*sys.exc_info())
                raise

    def close(self) -> Path:
        """Finish the file.

        Returns:
            The path written.

        Raises:
            InputError: no frame was added, or the file cannot be written.
        """
        if self._last is None:
            raise InputError(f"video '{self.path}': there are no frames to write")
        if self.suffix == ".png":
            import imageio.v2 as imageio

            with replace_file(self.path) as partial:
                imageio.imwrite(partial, self._last)
        elif self._writer is not None:
            with self._file:
                writer, self._writer = self._writer, None
                writer.close()
                if self.suffix == ".gif":
                    self._partial.write_bytes(self._encoded.getvalue())
                # The encoder is a process of its own, which tells nobody that the disk was full.
                if self.suffix == ".mp4" and self._partial.is_file() and not _is_whole(self._partial):
                    raise OSError("the encoder stopped early; is the disk full?")
        return self.path

    def __enter__(self) -> Film:
        return self

    def __exit__(self, *reason: Any) -> None:
        if reason[0] is None:
            self.close()
            return
        writer, self._writer = self._writer, None
        if writer is not None:
            with suppress(OSError):
                writer.close()
        self._file.__exit__(*reason)

    def _open(self) -> Any:
        import imageio.v2 as imageio

        self._partial = self._file.enter_context(replace_file(self.path))
        if self.suffix == ".gif":
            # In memory: after a full disk, imageio would go on trying, and print every failure.
            return imageio.get_writer(self._encoded, format=".gif", duration=1000.0 / self._fps, loop=0)
        # H.264 wants even sides, which a macro block of 2 ensures.
        return imageio.get_writer(self._partial, fps=self._fps, codec="libx264", quality=8, macro_block_size=2)


def _is_whole(path: Path) -> bool:
    """Return whether an MP4 file ends where its last box ends, and has the box that lists its frames."""
    place, kinds, size = 0, set(), path.stat().st_size
    with path.open("rb") as file:
        while place < size:
            file.seek(place)
            head = file.read(16)
            length = int.from_bytes(head[:4], "big")
            if length == 1:  # a long box
                length = int.from_bytes(head[8:16], "big")
            if length < 8:
                return False
            kinds.add(head[4:8])
            place += length
    return place == size and b"moov" in kinds
