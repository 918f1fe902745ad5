"""Animated GIFs, written frame by frame: a film of any length takes the memory of a few pictures."""

from __future__ import annotations

from typing import IO, Any

import numpy as np

COLORS = 255  # in a table; the format has one index more, which stands for what does not change
CLEAR = COLORS
FAR = 40  # by which a colour channel may miss the drawn one, of 255; blends at edges of bodies miss by less
MISSED = 30  # pixels that may be further off before a new table is made; an impact's flash has more
UNKNOWN, OFF = 0xFFFF, 0x100  # of a colour that was not looked up, and of one that the table misses
LOOP = b"!\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"  # for ever


class Gif:
    """Write an endless GIF; each frame holds the pixels that changed.

    Colours are those of the first frame as long as they serve; a frame that shows others brings its own table.

    Args:
        file: open for writing bytes.
        fps: frames per second. The format counts hundredths of a second; they add up to this rate.
    """

    def __init__(self, file: IO[bytes], fps: float) -> None:
        self._file, self._fps = file, fps
        self._count = 0  # frames that came
        self._shown: np.ndarray | None = None  # colours of the last one, shape (height, width)
        self._waiting: tuple[Any, tuple[int, int], int] | None = None  # image, its corner, and the frame it begins at
        self._first, self._table = b"", b""  # of the file and of the present frame: red, green, blue of each index
        self._index: np.ndarray = np.zeros(0, np.uint16)  # colour to its place in the table, or OFF

    def append_data(self, picture: np.ndarray) -> None:
        """Append a frame.

        Args:
            picture: shape (height, width, 3) uint8, of the same size every time.
        """
        colors = _pack(picture)
        if self._shown is None:
            self._choose_table(picture)
            self._first = self._table
            self._file.write(_write_head(colors.shape, self._table))
        changed = np.ones(colors.shape, bool) if self._shown is None else colors != self._shown
        rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
        if len(rows):  # otherwise the last frame is shown for longer
            self._flush()
            place = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            image = self._reduce(picture, colors[place], changed[place])
            self._waiting = image, (int(columns[0]), int(rows[0])), self._count
        self._shown = colors
        self._count += 1

    def close(self) -> None:
        """Write what is left, and the end; the file stays open."""
        self._flush()
        self._file.write(b";")

    def _reduce(self, picture: np.ndarray, colors: np.ndarray, changed: np.ndarray) -> Any:
        """Return the changed pixels as an image, in colours of the present table; a new one where that has them not."""
        from PIL import Image

        wanted = colors[changed]
        found = self._look_up(wanted)
        if np.count_nonzero(found & OFF) > MISSED:
            self._choose_table(picture)
            found = self._look_up(wanted)
        indices = np.full(colors.shape, CLEAR, np.uint8)
        indices[changed] = found & 0xFF
        image = Image.frombytes("P", (colors.shape[1], colors.shape[0]), indices.tobytes())
        image.putpalette(self._table)
        return image

    def _choose_table(self, picture: np.ndarray) -> None:
        from PIL import Image

        chosen = Image.fromarray(picture).quantize(COLORS).getpalette() or []
        self._table = bytes(chosen[: 3 * COLORS]).ljust(3 * (COLORS + 1), b"\x00")
        self._index = np.full(1 << 24, UNKNOWN, np.uint16)

    def _look_up(self, colors: np.ndarray) -> np.ndarray:
        """Return the places of colours in the table, shape as colors; OFF is added where the nearest one is far."""
        found = self._index[colors]
        if (new := np.unique(colors[found == UNKNOWN])).size:
            table = np.frombuffer(self._table, np.uint8).reshape(-1, 3)[:COLORS].astype(np.int16)
            drawn = np.stack([new & 0xFF, new >> 8 & 0xFF, new >> 16], axis=1).astype(np.int16)
            misses = np.abs(drawn[:, np.newaxis] - table).max(axis=2)
            nearest = misses.argmin(axis=1)
            self._index[new] = nearest + OFF * (misses[np.arange(len(new)), nearest] > FAR)
            found = self._index[colors]
        return found

    def _flush(self) -> None:
        """Write the frame whose duration is known now."""
        if self._waiting is None:
            return
        from PIL.GifImagePlugin import getdata

        image, corner, begin = self._waiting
        hundredths = round(100 * self._count / self._fps) - round(100 * begin / self._fps)
        own = bytes(image.getpalette()) != self._first
        how: dict[str, Any] = {"duration": 10 * max(1, hundredths), "include_color_table": own}
        if begin > 0:  # the first frame is whole
            how["transparency"] = CLEAR
        for data in getdata(image, corner, **how):
            self._file.write(data)
        self._waiting = None


def _pack(picture: np.ndarray) -> np.ndarray:
    """Return each pixel's colour as one number, red + 256 green + 65,536 blue, shape (height, width)."""
    padded = np.zeros((*picture.shape[:2], 4), np.uint8)
    padded[..., :3] = picture
    return padded.view("<u4")[..., 0]


def _write_head(shape: tuple[int, ...], table: bytes) -> bytes:
    height, width = shape
    return b"GIF89a" + width.to_bytes(2, "little") + height.to_bytes(2, "little") + b"\xf7\x00\x00" + table + LOOP
