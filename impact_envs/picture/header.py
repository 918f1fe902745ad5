"""Texts of a picture: what stands above and below the world, and fonts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from impact_envs.picture import drawing
from impact_envs.picture.canvas import Canvas
from impact_envs.picture.drawing import Color
from impact_envs.picture.frame import MARGIN, Frame
from impact_envs.picture.unit import write_robustness

if TYPE_CHECKING:
    import pygame

FONTS = {"title": (16, True), "verdict": (14, True), "text": (13, False), "label": (12, False)}  # [px], bold


class Writer:
    """Turn texts into pictures, and keep those that are written again and again."""

    def __init__(self) -> None:
        self._fonts: dict[str, pygame.font.Font] = {}
        self._texts: dict[tuple[Any, ...], pygame.Surface] = {}

    def font(self, name: str) -> pygame.font.Font:
        """Return one of ``FONTS``."""
        if not self._fonts:
            import pygame

            pygame.font.init()
            self._fonts = {key: drawing.load_font(*size) for key, size in FONTS.items()}
        return self._fonts[name]

    def render(
        self, text: str, font: str, color: Color, halo: Color | None = None, kept: bool = True
    ) -> pygame.Surface:
        """Return a text as a picture; one that is written again and again is kept."""
        key = (text, font, color, halo)
        if key not in self._texts:
            made = drawing.render_text(text, self.font(font), color, halo)
            if not kept:
                return made
            self._texts[key] = made
        return self._texts[key]

    def fit(self, text: str, font: str, color: Color, room: float, kept: bool = True) -> pygame.Surface:
        """Return a text as a picture, cut to fit into a width [px]."""
        picture = self.render(text, font, color, kept=kept)
        if picture.get_width() <= room:
            return picture
        while text and self.font(font).size(text)[0] > room:
            text = text[:-2] + "…" if len(text) > 2 else ""
        return self.render(text, font, color, kept=kept)


def write_header(canvas: Canvas, frame: Frame, writer: Writer, step: float) -> None:
    """Write caption, clock, robustness and verdict above, the grid's step and a note below.

    Args:
        canvas: with the picture to write on.
        frame: of which instant.
        writer: of texts.
        step: of the grid [m].
    """
    width, height = canvas.picture.get_size()
    canvas.write(writer.fit(frame.caption, "title", drawing.INK, width - 2 * MARGIN), (MARGIN, 10))
    words = [f"t = {frame.time:.{2 if (frame.speed or 1.0) < 1.0 else 1}f} s"]
    if frame.speed is not None:
        words.append("real time" if frame.speed == 1.0 else f"{frame.speed:.2g}\N{MULTIPLICATION SIGN} real time")
    room = width - 2 * MARGIN
    if frame.robustness is not None:
        words.append(write_robustness(*frame.robustness, frame.unit))
        verdict, color = _verdict(*frame.robustness)
        text = writer.render(verdict, "verdict", drawing.PAPER)
        place = text.get_rect(midright=(width - MARGIN - 8, 46))
        canvas.write(text, place, badge=color)
        room -= place.w + 28
    readout = writer.render("   ".join(words), "text", drawing.MUTED, kept=False)
    while len(words) > 1 and readout.get_width() > room:
        words.pop()  # half a number would say something else
        readout = writer.render("   ".join(words), "text", drawing.MUTED, kept=False)
    canvas.write(readout, readout.get_rect(midleft=(MARGIN, 46)))
    grid = writer.render(f"grid {step:g} m", "label", drawing.MUTED)
    canvas.write(grid, grid.get_rect(bottomright=(width - MARGIN, height - 5)))
    note = frame.note or ("arrows: change of velocity at an impact" if frame.impacts else "")
    room = width - 3 * MARGIN - grid.get_width()
    line = writer.fit(note, "label", drawing.MUTED, room, kept=False)  # it may count the time
    canvas.write(line, line.get_rect(bottomleft=(MARGIN, height - 5)))


def _verdict(lower: float, upper: float) -> tuple[str, Color]:
    if lower > 0:
        return "satisfied", drawing.SATISFIED
    return ("violated", drawing.VIOLATED) if upper < 0 else ("undecided", drawing.UNDECIDED)
