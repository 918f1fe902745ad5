"""Palette and the primitives that pygame lacks: round polylines, dashes, stars, arrows, text with a halo.

Each returns the rectangle that it drew in.
"""

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
FLASH: Color = (255, 150, 60)
SATISFIED, VIOLATED, UNDECIDED = (0, 128, 94), (190, 60, 0), (104, 114, 126)
PAPER, WORLD, GRID, EDGE = (255, 255, 255), (248, 250, 252), (232, 236, 241), (148, 158, 170)
INK, MUTED = (31, 41, 55), (107, 114, 128)
REGION, REGION_EDGE, REGION_INK = (
    (0, 158, 115, 34),
    (80, 160, 130),
    (20, 100, 75),
)  # nested regions stay apart
SOLID, SOLID_EDGE, SOLID_INK = (203, 209, 217), (120, 130, 142), (75, 85, 99)

_TURNS = math.pi * np.arange(10) / 5 - math.pi / 2
STAR = np.where(np.arange(10) % 2, 0.42, 1.0)[:, None] * np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=1)

PIECES = 4  # of a link, so that the rectangle around a slanted one is not mostly empty
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


def draw_line(canvas: pygame.Surface, color: Color, points: Points, width: float) -> pygame.Rect:
    """Draw a polyline with round joints and ends, which pygame's own wide lines do not have.

    Args:
        canvas: surface to draw on.
        color: of the line.
        points: shape (n, 2) [px].
        width: of the line [px].
    """
    import pygame

    corners = points.tolist()
    for (x, y), (u, v) in itertools.pairwise(corners):
        length = math.hypot(u - x, v - y)
        if length > 0:
            dx, dy = width / 2 * (v - y) / length, width / 2 * (u - x) / length
            pygame.draw.polygon(canvas, color, [(x + dx, y - dy), (x - dx, y + dy), (u - dx, v + dy), (u + dx, v - dy)])
    for point in corners:
        pygame.draw.circle(canvas, color, point, width / 2)
    return find_bounds(points, width / 2)


def draw_dashes(canvas: pygame.Surface, color: Color, points: Points, width: float) -> pygame.Rect:
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
    return find_bounds(points, width / 2)


def draw_chain(canvas: pygame.Surface, color: Color, points: Points, width: float) -> list[pygame.Rect]:
    """Draw links from joint to joint, the joints as rings; the rectangles are those of pieces of the links.

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
    shares = np.linspace(0.0, 1.0, PIECES + 1)[:, None]
    pieces = [start + shares * (end - start) for start, end in itertools.pairwise(points)]
    return [find_bounds(piece[k : k + 2], 0.8 * width) for piece in pieces for k in range(PIECES)]


def draw_star(canvas: pygame.Surface, color: Color, center: Points, radius: float) -> pygame.Rect:
    """Draw a five-pointed star with a light rim.

    Args:
        canvas: surface to draw on.
        color: of the star.
        center: shape (2,) [px].
        radius: from the centre to the outer points [px].
    """
    import pygame

    star = center + radius * STAR
    rim = pygame.draw.polygon(canvas, PAPER, (center + 1.35 * radius * STAR).tolist())
    pygame.draw.polygon(canvas, color, star.tolist())
    return rim


def draw_ring(canvas: pygame.Surface, color: Color, center: Points, radius: float, width: float) -> pygame.Rect:
    """Draw a circle, not filled.

    Args:
        canvas: surface to draw on.
        color: of the circle.
        center: shape (2,) [px].
        radius: outer one [px].
        width: of the line; none is drawn below half a pixel [px].
    """
    import pygame

    if width < 0.5:
        return pygame.Rect(0, 0, 0, 0)
    return pygame.draw.circle(canvas, color, center.tolist(), radius, max(1, round(width)))


def draw_arrow(canvas: pygame.Surface, color: Color, start: Points, end: Points, width: float) -> pygame.Rect:
    """Draw an arrow with a light rim.

    Args:
        canvas: surface to draw on.
        color: of the arrow.
        start: shape (2,) [px].
        end: where it points to; nothing is drawn where that is nearer than its head is long, shape (2,) [px].
        width: of the shaft; the head is 4.5 widths long and 4 widths wide [px].
    """
    import pygame

    way = end - start
    length = float(np.hypot(*way))
    if length < 4.5 * width:
        return pygame.Rect(0, 0, 0, 0)
    along = way / length
    across = np.array([-along[1], along[0]])
    neck = end - 4.5 * width * along
    head = [end, neck + 2 * width * across, neck - 2 * width * across]
    for tone, rim in ((PAPER, 0.8 * width), (color, 0.0)):
        draw_line(canvas, tone, np.stack([start, neck]), width + 2 * rim)
        pygame.draw.polygon(canvas, tone, [tuple(point) for point in head])
        if rim:
            draw_line(canvas, tone, np.array([*head, head[0]]), 2 * rim)
    return find_bounds(np.array([start, *head]), 2 * width)


def find_bounds(points: Points, reach: float) -> pygame.Rect:
    """Return the rectangle around points, shape (n, 2), and what is drawn around each within a reach [px]."""
    import pygame

    if not len(points):
        return pygame.Rect(0, 0, 0, 0)
    x, y = points.T.tolist()  # there are few: lists are faster
    left, top = math.floor(min(x) - reach) - 1, math.floor(min(y) - reach) - 1
    right, bottom = math.ceil(max(x) + reach) + 1, math.ceil(max(y) + reach) + 1
    return pygame.Rect(left, top, right - left, bottom - top)


def render_text(text: str, font: pygame.font.Font, color: Color, halo: Color | None = None) -> pygame.Surface:
    """Return a line of text as a picture of its own, one pixel larger on each side.

    Args:
        text: one line.
        font: from `load_font`.
        color: of the letters.
        halo: colour of a rim of one pixel around the letters; None for no rim.
    """
    import pygame

    ink = font.render(text, True, color)
    picture = pygame.Surface((ink.get_width() + 2, ink.get_height() + 2), pygame.SRCALPHA, 32)
    if halo is not None:
        rim = font.render(text, True, halo)
        picture.blits([(rim, place) for place in itertools.product((0, 1, 2), repeat=2)])
    picture.blit(ink, (1, 1))
    return picture
