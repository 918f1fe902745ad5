"""Films and single pictures: frames in, a file out."""

from __future__ import annotations

import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.file import replace_file

SUFFIXES = (".mp4", ".gif", ".png")


class Film:
    """Write frames to a file as they come; its suffix decides the format.

    Args:
        path: file to write: .mp4 (H.264), .gif (endless loop) or .png (the last frame).
        fps: frames per second.
        hold: for which the last frame stays [s]; a short film begins anew before anybody has read its end.

    The end of a ``with`` statement closes it; an exception leaves no file.

    Raises:
        InputError: unknown suffix, or missing directory.
    """

    def __init__(self, path: str | Path, fps: float, hold: float = 0.0) -> None:
        self.path, self._fps, self._hold = Path(path), fps, hold
        self._file = ExitStack()
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
            for _ in range(round(self._hold * self._fps)):
                self.add(self._last)
            with self._file:
                writer, self._writer = self._writer, None
                writer.close()
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
        if self.suffix == ".gif":
            from impact_envs.picture.gif import Gif

            self._partial = self._file.enter_context(replace_file(self.path))
            return Gif(self._file.enter_context(self._partial.open("wb")), self._fps)
        import imageio.v2 as imageio

        self._partial = self._file.enter_context(replace_file(self.path))
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
