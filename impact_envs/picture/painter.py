"""One picture of a world: shapes where their bodies are, trails, plans, impacts, header."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.interface.shape import Shape
from impact_envs.picture import drawing, labels
from impact_envs.picture.canvas import ZOOM, Canvas
from impact_envs.picture.drawing import Color, Points, mix
from impact_envs.picture.frame import FOOTER, HEADER, MARGIN, Frame, Mark, Pose
from impact_envs.picture.header import Writer, write_header
from impact_envs.picture.trails import Trails

if TYPE_CHECKING:
    import pygame

FADE = 2.0  # [s] for which an impact is drawn larger and brighter, where nobody says how fast time is shown
SEEN = 1.0  # [s] of the viewer's time for the same
FLASH = 0.5  # share of it in which a ring spreads
ARROW = 3.0  # [s]: an arrow is as long as its change of velocity moves a body in this time
LEAST_ARROW, LARGEST_ARROW = 26.0, 150.0  # [px]
KEPT_IMPACTS = 12


class Painter:
    """Paint frames of one world, all with the same size and scale.

    Lengths keep their ratio: the world is centred under the header with one scale for both axes.

    Args:
        world_lower: lower corner of the world box (x, y) [m].
        world_upper: upper corner of the world box (x, y) [m].
        shapes: what the world and its bodies look like.
        size: width and height of the picture [px]; None chooses them from the shape of the world.
        arrow: an arrow is as long as its change of velocity moves a body in this time [s].

    Raises:
        InputError: empty world, or a size too small to draw in.
    """

    def __init__(
        self,
        world_lower: Sequence[float],
        world_upper: Sequence[float],
        shapes: Sequence[Shape],
        size: tuple[int, int] | None = None,
        arrow: float = ARROW,
    ) -> None:
        self._lower, self._upper = np.asarray(world_lower, float), np.asarray(world_upper, float)
        extent = self._upper - self._lower
        if not (np.isfinite(extent).all() and (extent > 0).all()):
            raise InputError(f"world from {list(world_lower)} to {list(world_upper)} is empty")
        self.size = size or _default_size(extent)
        least = (32 + 2 * MARGIN, 32 + 2 * MARGIN + HEADER + FOOTER)
        if self.size[0] < least[0] or self.size[1] < least[1]:
            raise InputError(f"picture size {self.size} is too small: at least {least} pixels")
        room = np.array([self.size[0] - 2 * MARGIN, self.size[1] - 2 * MARGIN - HEADER - FOOTER])
        self._scale = float((room / extent).min())  # [px/m]
        corner = MARGIN + (room - self._scale * extent) / 2
        self._origin = corner + np.array([0.0, HEADER + self._scale * extent[1]])  # pixel of world_lower
        self._arrow = arrow
        self._fixed = [shape for shape in shapes if shape.body is None]
        self._carried = [(shape.body, shape) for shape in shapes if shape.body is not None]
        # What labels should not cover of each body, in its frame [m].
        spacing = labels.SPACING / self._scale
        self._samples = [labels.sample_area(np.array(_outline(shape)), spacing) for _, shape in self._carried]
        outlines = [self._pixels(_outline(shape), zoom=1) for shape in self._fixed]
        corners = self._pixels([self._lower, self._upper], zoom=1)
        low, high = corners.min(axis=0), corners.max(axis=0)
        self._ends = [(np.maximum(o.min(axis=0), low), np.minimum(o.max(axis=0), high)) for o in outlines]
        closed = [labels.sample_line(np.vstack([o, o[:1]]), labels.SPACING) for o in outlines]
        self._edges = labels.box_points(np.vstack([np.zeros((0, 2)), *closed]), labels.EDGE)
        self._colors = _body_colors(self._carried)
        self._writer = Writer()
        self._canvas: Canvas | None = None
        self._trails = Trails(2.5 * ZOOM)
        self._plans: dict[str, Points] = {}  # as drawn

    def paint(self, frame: Frame) -> pygame.Surface:
        """Paint one frame; equal frames give equal pictures, whatever was painted before.

        Args:
            frame: poses and overlays of this instant.

        Returns:
            A surface of the painter's size, which the next call paints anew.

        Raises:
            InputError: a body with a shape has no pose.
        """
        for body, _ in self._carried:
            if body not in frame.poses:
                raise InputError(f"no pose for body '{body}': {choices(body, frame.poses)}")
        if self._canvas is None:
            self._canvas = Canvas(self.size)
            self._draw_ground(self._canvas.ground)
        canvas = self._canvas
        canvas.uncover(self._draw_curves(canvas, frame))
        sheet, moved = canvas.sheet, []
        for body, points in frame.chains.items():
            color = self._colors.get(body, drawing.MUTED)
            moved += drawing.draw_chain(sheet, color, self._pixels(points), 7.0 * ZOOM)
        for body, shape in self._carried:
            moved.append(self._draw_body(sheet, shape, frame.poses[body], self._colors[body]))
        for mark in frame.impacts[-KEPT_IMPACTS:]:
            moved += self._draw_mark(sheet, mark, frame.speed)
        canvas.shrink(moved)
        self._write_labels(canvas, frame)
        write_header(canvas, frame, self._writer, choose_grid(self._upper - self._lower))
        return canvas.picture

    def _pixels(self, points: Any, zoom: int = ZOOM) -> Points:
        """Map world points (n, 2) to pixels; the screen's y axis points down."""
        offset = np.asarray(points, float).reshape(-1, 2) - self._lower
        return zoom * (self._origin + self._scale * offset * (1, -1))

    def _draw_ground(self, canvas: pygame.Surface) -> None:
        """Draw what never changes: paper, grid, regions, obstacles."""
        import pygame

        canvas.fill(drawing.PAPER)
        (left, bottom), (right, top) = np.rint(self._pixels([self._lower, self._upper])).astype(int).tolist()
        area = pygame.Rect(left, top, right - left, bottom - top)
        canvas.fill(drawing.WORLD, area)
        step = choose_grid(self._upper - self._lower)
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

    def _draw_fixed(self, canvas: pygame.Surface, shape: Shape) -> None:
        from pygame import gfxdraw

        corners = self._pixels(_outline(shape))
        region = shape.role == "region"
        fill = drawing.REGION if region else (*drawing.SOLID, 255)
        gfxdraw.filled_polygon(canvas, np.rint(corners).astype(int).tolist(), fill)
        edge = drawing.REGION_EDGE if region else drawing.SOLID_EDGE
        drawing.draw_line(canvas, edge, np.vstack([corners, corners[:1]]), 1.5 * ZOOM)

    def _draw_curves(self, canvas: Canvas, frame: Frame) -> list[pygame.Rect]:
        """Draw plans and paths, or what paths have got since the last frame; returns where was drawn."""
        same = self._plans.keys() == frame.plans.keys()
        same = same and all(np.array_equal(points, frame.plans[name]) for name, points in self._plans.items())
        grown = []
        if not same or not self._trails.goes_on(frame.trails) or canvas.is_blank:
            grown = canvas.clear()
            self._trails.clear()
            self._plans = {name: np.array(points) for name, points in frame.plans.items()}
            for name, points in self._plans.items():
                color = mix(self._colors.get(name, drawing.MUTED), 0.7)
                drawing.draw_dashes(canvas.curves, color, self._pixels(points), 1.3 * ZOOM)
        colors = {name: mix(self._colors.get(name, drawing.MUTED), 0.6) for name in frame.trails}
        return grown + self._trails.draw(canvas.curves, frame.trails, self._pixels, colors)

    def _draw_body(self, canvas: pygame.Surface, shape: Shape, pose: Pose, color: Color) -> pygame.Rect:
        import pygame

        fill, edge = mix(color, 0.85), mix(color, 0.8, drawing.INK)
        center = self._pixels(pose[:2])[0]
        if shape.vertices is None:
            radius = ZOOM * self._scale * (shape.radius or 0.0)
            place = pygame.draw.circle(canvas, edge, center, radius)
            pygame.draw.circle(canvas, fill, center, radius - 1.2 * ZOOM)
        else:
            corners = self._pixels(_place(shape.vertices, pose))
            pygame.draw.polygon(canvas, fill, corners.tolist())
            place = drawing.draw_line(canvas, edge, np.vstack([corners, corners[:1]]), 1.2 * ZOOM)
        if shape.role == "robot" and shape.radius is not None:
            mark = _place([(0.25 * shape.radius, 0.0), (0.85 * shape.radius, 0.0)], pose)
            drawing.draw_line(canvas, drawing.PAPER, self._pixels(mark), 2.5 * ZOOM)
        return place

    def _draw_mark(self, canvas: pygame.Surface, mark: Mark, speed: float | None) -> list[pygame.Rect]:
        """Draw an impact: a star, and while it is fresh a ring that spreads and arrows of the changes of velocity."""
        fade = FADE if speed is None else SEEN * speed
        fresh = min(1.0, max(0.0, 1.0 - mark.age / fade))
        center = self._pixels((mark.x, mark.y))[0]
        drawn = []
        if fresh > 0.0:
            spread = min(1.0, (1.0 - fresh) / FLASH)
            width = ZOOM * 5.0 * (1.0 - spread)
            drawn.append(drawing.draw_ring(canvas, drawing.FLASH, center, ZOOM * (10.0 + 34.0 * spread), width))
            for x, y, vx, vy in mark.changes:
                drawn.append(self._draw_change(canvas, (x, y), (vx, vy)))
        color = mix(drawing.IMPACT, 0.6 + 0.4 * fresh)
        return [*drawn, drawing.draw_star(canvas, color, center, ZOOM * (6.0 + 6.0 * fresh))]

    def _draw_change(
        self, canvas: pygame.Surface, place: tuple[float, float], change: tuple[float, float]
    ) -> pygame.Rect:
        start = self._pixels(place)[0]
        way = ZOOM * self._scale * self._arrow * np.array([change[0], -change[1]])
        length = float(np.hypot(*way))
        if length < 1.0:  # a body that hardly notices has no direction to show
            return drawing.find_bounds(np.zeros((0, 2)), 0.0)
        shown = min(max(length, ZOOM * LEAST_ARROW), ZOOM * LARGEST_ARROW)
        return drawing.draw_arrow(canvas, drawing.IMPACT, start, start + shown / length * way, 2.5 * ZOOM)

    def _write_labels(self, canvas: Canvas, frame: Frame) -> None:
        """Write the names of areas and bodies where they cover no body, as long as there is room."""
        named: list[tuple[Shape, Points, Points]] = []
        boxes: list[Points] = []
        for (body, shape), samples in zip(self._carried, self._samples, strict=True):
            low, high, covered = self._cover(shape, samples, frame.poses[body])
            named.append((shape, low, high))
            boxes.append(covered)
        for points in frame.chains.values():
            boxes.append(labels.box_points(labels.sample_line(self._pixels(points, zoom=1), labels.SPACING)))
        taken = np.vstack([*boxes, self._edges])
        named += [(shape, *ends) for shape, ends in zip(self._fixed, self._ends, strict=True)]
        view = (1.0, HEADER + 2.0, self.size[0] - 1.0, self.size[1] - FOOTER)
        for shape, low, high in named:
            if not shape.label:
                continue
            text = self._writer.render(shape.label, "label", _label_color(shape), drawing.WORLD)
            find_places = labels.place_inside if shape.body is None else labels.place_beside
            place = labels.choose_place(find_places(low, high, text.get_size()), taken, view)
            left, top = np.rint(place[:2]).astype(int).tolist()
            canvas.write(text, (left, top))
            taken = np.vstack([taken, place])

    def _cover(self, shape: Shape, samples: Points, pose: Pose) -> tuple[Points, Points, Points]:
        """Return where a body begins and ends, and boxes that cover it [px]."""
        if shape.vertices is None:
            center, radius = self._pixels(pose[:2], zoom=1)[0], self._scale * (shape.radius or 0.0)
            low, high = center - radius, center + radius
            return low, high, np.concatenate([low, high])[None]
        points = self._pixels(_place(samples, pose), zoom=1)
        return points.min(axis=0), points.max(axis=0), labels.box_points(points)


def _default_size(extent: Points) -> tuple[int, int]:
    """Fit the world into 900 x 720 px; wide enough for the header; even, as H.264 wants."""
    scale = min(900 / extent[0], 720 / extent[1])
    width = max(540, scale * extent[0] + 2 * MARGIN)
    height = scale * extent[1] + 2 * MARGIN + HEADER + FOOTER
    return 2 * math.ceil(width / 2), 2 * math.ceil(height / 2)


def _body_colors(carried: Sequence[tuple[str, Shape]]) -> dict[str, Color]:
    palettes = {True: itertools.cycle(drawing.ROBOT_COLORS), False: itertools.cycle(drawing.OBJECT_COLORS)}
    roles = {body: shape.role == "robot" for body, shape in reversed(carried)}
    return {body: next(palettes[roles[body]]) for body in dict.fromkeys(body for body, _ in carried)}


def _outline(shape: Shape) -> Sequence[tuple[float, float]]:
    if shape.vertices is not None:
        return shape.vertices
    radius, angles = shape.radius or 0.0, np.linspace(0, 2 * math.pi, 65)[:-1]
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]


def _place(vertices: Sequence[tuple[float, float]] | Points, pose: Pose) -> Points:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray(vertices, float) @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]


def _label_color(shape: Shape) -> Color:
    if shape.body is not None:
        return drawing.INK
    return drawing.REGION_INK if shape.role == "region" else drawing.SOLID_INK


def choose_grid(extent: Points) -> float:
    """Return the smallest of 1, 2, 5 x 10^k m that gives at most 12 lines along the longer side."""
    need = float(extent.max()) / 12
    decade = 10.0 ** math.floor(math.log10(need))
    return next(decade * factor for factor in (1, 2, 5, 10) if decade * factor >= need)
