"""Palette and the primitives that pygame lacks: round polylines, dashes, stars, text with a halo."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pygame

Color = tuple[int, int, int]
Points = NDArray[np.floating[Any]]

# Okabe & Ito, "Color Universal Design" (2008): told apart with any colour vision.
ROBOT_COLORS: tuple[Color, ...] = ((0, 114, 178), (0, 158, 115), (148, 86, 160), (86, 180, 233))
OBJECT_COLORS: tuple[Color, ...] = ((230, 159, 0), (166, 118, 29), (240, 200, 60))
IMPACT: Color = (204, 33, 41)
SATISFIED, VIOLATED, UNDECIDED = (0, 128, 94), (190, 60, 0), (104, 114, 126)
PAPER, WORLD, GRID, EDGE = (255, 255, 255), (248, 250, 252), (232, 236, 241), (148, 158, 170)
INK, MUTED = (31, 41, 55), (107, 114, 128)
REGION, REGION_EDGE, REGION_INK = (
    (0, 158, 115, 34),
    (80, 160, 130),
    (20, 100, 75),
)  # nested regions stay apart
SOLID, SOLID_EDGE, SOLID_INK = (203, 209, 217), (120, 130, 142), (75, 85, 99)

FONTS = "liberationsans,arial,helvetica,notosans,dejavusans"


def mix(color: Color, share: float, other: Color = PAPER) -> Color:
    """Return ``share * color + (1 - share) * other``.

    Args:
        color: red, green, blue in 0..255.
        share: weight of the colour, in [0, 1].
        other: the colour to mix with.

    Returns:
        Red, green, blue in 0..255.
    """
    red, green, blue = (round(share * a + (1 - share) * b) for a, b in zip(color, other, strict=True))
    return red, green, blue


def load_font(size: int, bold: bool = False) -> pygame.font.Font:
    """Load a common sans-serif font, or the one inside pygame where the system has none.

    Args:
        size: height [px].
        bold: heavier strokes.

    Returns:
        The font; `pygame.font.init` must have been called.
    """
    import pygame

    found = pygame.font.match_font(FONTS, bold=bold)
    return pygame.font.Font(found, size if found else round(1.2 * size))


def draw_line(canvas: pygame.Surface, color: Color, points: Points, width: float) -> None:
    """Draw a polyline with round joints and ends, which pygame's own wide lines do not have.

    Args:
        canvas: surface to draw on.
        color: of the line.
        points: shape (n, 2) [px].
        width: of the line [px].
    """
    import pygame

    for (x, y), (u, v) in itertools.pairwise(points.tolist()):
        length = math.hypot(u - x, v - y)
        if length > 0:
            dx, dy = width / 2 * (v - y) / length, width / 2 * (u - x) / length
            corners = [(x + dx, y - dy), (x - dx, y + dy), (u - dx, v + dy), (u + dx, v - dy)]
            pygame.draw.polygon(canvas, color, corners)
    for point in points.tolist():
        pygame.draw.circle(canvas, color, point, width / 2)


def draw_dashes(canvas: pygame.Surface, color: Color, points: Points, width: float) -> None:
    """Draw a dashed polyline; dashes are equally long along the curve, whatever its sampling.

    Args:
        canvas: surface to draw on.
        color: of the dashes.
        points: shape (n, 2), n >= 1 [px].
        width: of the dashes; they are 6 widths long and 4 widths apart [px].
    """
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    for start in np.arange(0.0, arc[-1], 10 * width):
        ends = np.minimum([start, start + 6 * width], arc[-1])
        draw_line(canvas, color, np.stack([np.interp(ends, arc, axis) for axis in points.T], axis=1), width)


def draw_chain(canvas: pygame.Surface, color: Color, points: Points, width: float) -> None:
    """Draw links from joint to joint, the joints as rings.

    Args:
        canvas: surface to draw on.
        color: of the links, which are lightened.
        points: the first joint, further joints and the end, shape (n, 2) [px].
        width: of the links [px].
    """
    import pygame

    draw_line(canvas, mix(color, 0.8, INK), points, width)
    draw_line(canvas, mix(color, 0.55), points, 0.7 * width)
    for point in points[:-1].tolist():
        pygame.draw.circle(canvas, mix(color, 0.8, INK), point, 0.8 * width)
        pygame.draw.circle(canvas, PAPER, point, 0.45 * width)


def draw_star(canvas: pygame.Surface, color: Color, center: Points, radius: float) -> None:
    """Draw a five-pointed star with a light rim.

    Args:
        canvas: surface to draw on.
        color: of the star.
        center: shape (2,) [px].
        radius: from the centre to the outer points [px].
    """
    import pygame

    angles = math.pi * np.arange(10) / 5 - math.pi / 2
    reach = radius * np.where(np.arange(10) % 2, 0.42, 1.0)
    star = reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    pygame.draw.polygon(canvas, PAPER, (center + 1.35 * star).tolist())
    pygame.draw.polygon(canvas, color, (center + star).tolist())


def write(
    canvas: pygame.Surface,
    text: str,
    font: pygame.font.Font,
    color: Color,
    halo: Color | None = None,
    **anchor: tuple[float, float],
) -> None:
    """Write text, moved back inside the canvas where it would leave it.

    Args:
        canvas: surface to write on.
        text: one line.
        font: from `load_font`.
        color: of the letters.
        halo: colour of a rim of one pixel around the letters; None for no rim.
        anchor: one attribute of pygame.Rect and its place, for example ``midtop=(x, y)`` [px].
    """
    ink = font.render(text, True, color)
    place = ink.get_rect(**{key: (round(x), round(y)) for key, (x, y) in anchor.items()}).clamp(canvas.get_rect())
    if halo is not None:
        rim = font.render(text, True, halo)
        canvas.blits([(rim, place.move(offset)) for offset in itertools.product((-1, 0, 1), repeat=2)])
    canvas.blit(ink, place)
