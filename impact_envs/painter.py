"""One picture of a world: shapes where their bodies are, trails, plans, impacts, header."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_envs import drawing
from impact_envs.drawing import Color, Points, mix
from impact_envs.errors import InputError, choices
from impact_envs.shape import Shape

if TYPE_CHECKING:
    import pygame

Pose = tuple[float, float, float]

HEADER, MARGIN = 66, 14  # [px]
ZOOM = 2  # pygame draws wide lines without antialiasing: draw large, then shrink
FADE = 2.0  # [s] for which a fresh impact is drawn larger and brighter
KEPT_IMPACTS = 12
TRAIL_POINTS = 300


@dataclass(frozen=True, eq=False)
class Frame:
    """Hold what changes from picture to picture.

    Args:
        time: since the start of the episode [s].
        poses: (x, y, heading) of each body [m, m, rad].
        chains: links from where a body is held to the body, by body, shape (n, 2) [m].
        trails: positions so far of each body, shape (n, 2) [m].
        plans: planned curves by body (any other name is drawn grey), shape (n, 2) [m].
        impacts: (x, y, age) of each impact, oldest first; the last dozen are drawn [m, m, s].
        robustness: interval of robustness still possible; None when there is no formula.
        caption: first header line, for example scenario and policy.
    """

    time: float
    poses: Mapping[str, Pose]
    chains: Mapping[str, Points] = field(default_factory=dict)
    trails: Mapping[str, Points] = field(default_factory=dict)
    plans: Mapping[str, Points] = field(default_factory=dict)
    impacts: Sequence[tuple[float, float, float]] = ()
    robustness: tuple[float, float] | None = None
    caption: str = ""


class Painter:
    """Paint frames of one world, all with the same size and scale.

    Lengths keep their ratio: the world is centred under the header with one scale for both axes.

    Args:
        world_lower: lower corner of the world box (x, y) [m].
        world_upper: upper corner of the world box (x, y) [m].
        shapes: what the world and its bodies look like.
        size: width and height of the picture [px]; None chooses them from the shape of the world.

    Raises:
        InputError: empty world, or a size too small to draw in.
    """

    def __init__(
        self,
        world_lower: Sequence[float],
        world_upper: Sequence[float],
        shapes: Sequence[Shape],
        size: tuple[int, int] | None = None,
    ) -> None:
        self._lower, self._upper = np.asarray(world_lower, float), np.asarray(world_upper, float)
        extent = self._upper - self._lower
        if not (np.isfinite(extent).all() and (extent > 0).all()):
            raise InputError(f"world from {list(world_lower)} to {list(world_upper)} is empty")
        self.size = size or _default_size(extent)
        least = (32 + 2 * MARGIN, 32 + 2 * MARGIN + HEADER)
        if self.size[0] < least[0] or self.size[1] < least[1]:
            raise InputError(f"picture size {self.size} is too small: at least {least} pixels")
        room = np.array([self.size[0] - 2 * MARGIN, self.size[1] - 2 * MARGIN - HEADER])
        self._scale = float((room / extent).min())  # [px/m]
        corner = MARGIN + (room - self._scale * extent) / 2
        self._origin = corner + np.array([0.0, HEADER + self._scale * extent[1]])  # pixel of world_lower
        self._fixed = [shape for shape in shapes if shape.body is None]
        self._carried = [(shape.body, shape) for shape in shapes if shape.body is not None]
        self._colors = _body_colors(self._carried)
        self._fonts: dict[str, pygame.font.Font] = {}
        self._background: pygame.Surface | None = None

    def paint(self, frame: Frame) -> pygame.Surface:
        """Paint one frame.

        Args:
            frame: poses and overlays of this instant.

        Returns:
            A new surface of the painter's size.

        Raises:
            InputError: a body with a shape has no pose.
        """
        import pygame

        for body, _ in self._carried:
            if body not in frame.poses:
                raise InputError(f"no pose for body '{body}': {choices(body, frame.poses)}")
        canvas = self._draw_background().copy()
        self._draw_curves(canvas, frame)
        for body, points in frame.chains.items():
            drawing.draw_chain(canvas, self._colors.get(body, drawing.MUTED), self._pixels(points), 7.0 * ZOOM)
        for body, shape in self._carried:
            self._draw_body(canvas, shape, frame.poses[body], self._colors[body])
        for x, y, age in frame.impacts[-KEPT_IMPACTS:]:
            fresh = min(1.0, max(0.0, 1.0 - age / FADE))
            color = mix(drawing.IMPACT, 0.6 + 0.4 * fresh)
            drawing.draw_star(canvas, color, self._pixels((x, y))[0], ZOOM * (6.0 + 6.0 * fresh))
        self._draw_verdict(canvas, frame)
        picture = pygame.transform.smoothscale(canvas, self.size)
        self._write_labels(picture, frame)
        self._write_header(picture, frame)
        return picture

    def _pixels(self, points: Any, zoom: int = ZOOM) -> Points:
        """Map world points (n, 2) to pixels; the screen's y axis points down."""
        offset = np.asarray(points, float).reshape(-1, 2) - self._lower
        return zoom * (self._origin + self._scale * offset * (1, -1))

    def _font(self, name: str) -> pygame.font.Font:
        if not self._fonts:
            import pygame

            pygame.font.init()
            sizes = {"title": (16, True), "verdict": (12, True), "text": (13, False), "label": (12, False)}
            self._fonts = {key: drawing.load_font(*size) for key, size in sizes.items()}
        return self._fonts[name]

    def _draw_background(self) -> pygame.Surface:
        """Draw once what never changes: paper, grid, regions, obstacles."""
        import pygame

        if self._background is not None:
            return self._background
        canvas = pygame.Surface((ZOOM * self.size[0], ZOOM * self.size[1]))
        canvas.fill(drawing.PAPER)
        (left, bottom), (right, top) = np.rint(self._pixels([self._lower, self._upper])).astype(int).tolist()
        area = pygame.Rect(left, top, right - left, bottom - top)
        canvas.fill(drawing.WORLD, area)
        step = _grid_step(self._upper - self._lower)
        for axis, (lower, upper) in enumerate(zip(self._lower, self._upper, strict=True)):
            for value in step * np.arange(math.ceil(lower / step), math.floor(upper / step) + 1):
                ends = np.array([self._lower, self._upper])
                ends[:, axis] = value
                start, end = self._pixels(ends).tolist()
                pygame.draw.line(canvas, drawing.GRID, start, end, ZOOM)
        canvas.set_clip(area)
        for shape in sorted(self._fixed, key=lambda shape: shape.role != "region"):
            self._draw_fixed(canvas, shape)
        canvas.set_clip(None)
        pygame.draw.rect(canvas, drawing.EDGE, area.inflate(2, 2), ZOOM)
        pygame.draw.line(canvas, drawing.GRID, (0, ZOOM * HEADER), (ZOOM * self.size[0], ZOOM * HEADER), ZOOM)
        self._background = canvas
        return canvas

    def _draw_fixed(self, canvas: pygame.Surface, shape: Shape) -> None:
        from pygame import gfxdraw

        corners = self._pixels(_outline(shape))
        region = shape.role == "region"
        fill = drawing.REGION if region else (*drawing.SOLID, 255)
        gfxdraw.filled_polygon(canvas, np.rint(corners).astype(int).tolist(), fill)
        edge = drawing.REGION_EDGE if region else drawing.SOLID_EDGE
        drawing.draw_line(canvas, edge, np.vstack([corners, corners[:1]]), 1.5 * ZOOM)

    def _draw_curves(self, canvas: pygame.Surface, frame: Frame) -> None:
        for name, points in frame.plans.items():
            color = mix(self._colors.get(name, drawing.MUTED), 0.7)
            drawing.draw_dashes(canvas, color, self._pixels(points), 1.3 * ZOOM)
        for name, points in frame.trails.items():
            color = mix(self._colors.get(name, drawing.MUTED), 0.6)
            recent_first = points[:: -(1 + len(points) // TRAIL_POINTS)]  # thinned, but never at the body
            drawing.draw_line(canvas, color, self._pixels(recent_first), 2.5 * ZOOM)

    def _draw_body(self, canvas: pygame.Surface, shape: Shape, pose: Pose, color: Color) -> None:
        import pygame

        fill, edge = mix(color, 0.85), mix(color, 0.8, drawing.INK)
        center = self._pixels(pose[:2])[0]
        if shape.vertices is None:
            radius = ZOOM * self._scale * (shape.radius or 0.0)
            pygame.draw.circle(canvas, edge, center, radius)
            pygame.draw.circle(canvas, fill, center, radius - 1.2 * ZOOM)
        else:
            corners = self._pixels(_place(shape.vertices, pose))
            pygame.draw.polygon(canvas, fill, corners.tolist())
            drawing.draw_line(canvas, edge, np.vstack([corners, corners[:1]]), 1.2 * ZOOM)
        if shape.role == "robot" and shape.radius is not None:
            mark = _place([(0.25 * shape.radius, 0.0), (0.85 * shape.radius, 0.0)], pose)
            drawing.draw_line(canvas, drawing.PAPER, self._pixels(mark), 2.5 * ZOOM)

    def _write_labels(self, picture: pygame.Surface, frame: Frame) -> None:
        font = self._font("label")
        for shape in self._fixed:
            if shape.label:
                self._write_fixed_label(picture, shape)
        for body, shape in self._carried:
            if shape.label:
                x, y = self._pixels(frame.poses[body][:2], zoom=1)[0]
                reach = self._scale * np.hypot(*np.transpose(_outline(shape))).max()
                below = (x, y + reach + 2)
                drawing.write(picture, shape.label, font, drawing.INK, drawing.WORLD, midtop=below)
        x, y = self._pixels((self._upper[0], self._lower[1]), zoom=1)[0]
        note = f"grid {_grid_step(self._upper - self._lower):g} m"
        drawing.write(picture, note, font, drawing.MUTED, drawing.WORLD, topright=(x, y + 1))

    def _write_fixed_label(self, picture: pygame.Surface, shape: Shape) -> None:
        """Write a label inside the upper left corner of its shape, or above where it does not fit."""
        font, corners = self._font("label"), self._pixels(_outline(shape), zoom=1)
        (left, top), (right, _) = corners.min(axis=0), corners.max(axis=0)
        color = drawing.REGION_INK if shape.role == "region" else drawing.SOLID_INK
        if font.size(shape.label)[0] + 8 < right - left:
            drawing.write(picture, shape.label, font, color, topleft=(left + 5, max(top, HEADER) + 4))
        else:
            drawing.write(picture, shape.label, font, color, drawing.WORLD, bottomleft=(left, top - 1))

    def _draw_verdict(self, canvas: pygame.Surface, frame: Frame) -> None:
        if frame.robustness is not None:
            import pygame

            text, color = _verdict(*frame.robustness)
            x = self.size[0] - MARGIN - self._font("verdict").size(text)[0] - 10
            pygame.draw.circle(canvas, color, (ZOOM * x, ZOOM * 46), ZOOM * 4)

    def _write_header(self, picture: pygame.Surface, frame: Frame) -> None:
        title, caption = self._font("title"), frame.caption
        while caption and title.size(caption)[0] > self.size[0] - 2 * MARGIN:
            caption = caption[:-2] + "…" if len(caption) > 2 else ""
        drawing.write(picture, caption, title, drawing.INK, topleft=(MARGIN, 11))
        readout = f"t = {frame.time:.1f} s"
        if frame.robustness is not None:
            lower, upper = frame.robustness
            readout += f"     robustness in [{lower:+.3f}, {upper:+.3f}]"
            text, color = _verdict(lower, upper)
            edge = (self.size[0] - MARGIN, 46)
            drawing.write(picture, text, self._font("verdict"), color, midright=edge)
        drawing.write(picture, readout, self._font("text"), drawing.MUTED, midleft=(MARGIN, 46))


def _default_size(extent: Points) -> tuple[int, int]:
    """Fit the world into 900 x 720 px; wide enough for the header; even, as H.264 wants."""
    scale = min(900 / extent[0], 720 / extent[1])
    width = max(460, scale * extent[0] + 2 * MARGIN)
    height = scale * extent[1] + 2 * MARGIN + HEADER
    return 2 * math.ceil(width / 2), 2 * math.ceil(height / 2)


def _grid_step(extent: Points) -> float:
    """Return the smallest of 1, 2, 5 x 10^k m that gives at most 12 lines along the longer side."""
    need = float(extent.max()) / 12
    decade = 10.0 ** math.floor(math.log10(need))
    return next(decade * factor for factor in (1, 2, 5, 10) if decade * factor >= need)


def _body_colors(carried: Sequence[tuple[str, Shape]]) -> dict[str, Color]:
    palettes = {True: itertools.cycle(drawing.ROBOT_COLORS), False: itertools.cycle(drawing.OBJECT_COLORS)}
    roles = {body: shape.role == "robot" for body, shape in reversed(carried)}
    return {body: next(palettes[roles[body]]) for body in dict.fromkeys(body for body, _ in carried)}


def _outline(shape: Shape) -> Sequence[tuple[float, float]]:
    if shape.vertices is not None:
        return shape.vertices
    radius, angles = shape.radius or 0.0, np.linspace(0, 2 * math.pi, 65)[:-1]
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]


def _place(vertices: Sequence[tuple[float, float]], pose: Pose) -> Points:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray(vertices, float) @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]


def _verdict(lower: float, upper: float) -> tuple[str, Color]:
    if lower > 0:
        return "satisfied", drawing.SATISFIED
    return ("violated", drawing.VIOLATED) if upper < 0 else ("undecided", drawing.UNDECIDED)
