"""Paths that grow: only what a frame adds to them is drawn."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from impact_envs.picture.drawing import Color, Points, draw_line, find_bounds

if TYPE_CHECKING:
    import pygame

SHORTEST = 1.5  # of a piece of a path, as drawn; shorter ones wait for the next sample [px of a layer]


class Trails:
    """Draw paths piece by piece in the order of time, so that drawing on gives what drawing anew would.

    Args:
        width: of the paths [px of a layer].
    """

    def __init__(self, width: float) -> None:
        self._width = width
        self._drawn: dict[str, Points] = {}  # samples of each path that are drawn, shape (n, 2) [m]
        self._pen: dict[str, list[float]] = {}  # where each path's line ends [px of a layer]

    def goes_on(self, paths: Mapping[str, Points]) -> bool:
        """Return whether paths begin with what is drawn of them."""
        return self._drawn.keys() <= paths.keys() and all(
            np.array_equal(paths[name][: len(points)], points) for name, points in self._drawn.items()
        )

    def clear(self) -> None:
        """Forget what is drawn."""
        self._drawn, self._pen = {}, {}

    def draw(
        self,
        layer: pygame.Surface,
        paths: Mapping[str, Points],
        to_pixels: Callable[[Points], Points],
        colors: Mapping[str, Color],
    ) -> list[pygame.Rect]:
        """Draw what paths have got since the last time.

        Args:
            layer: to draw on.
            paths: by body, shape (n, 2) [m].
            to_pixels: from places in the world to places in the layer.
            colors: by body.

        Returns:
            Where was drawn.
        """
        firsts = {name: len(self._drawn.get(name, ())) for name in paths}
        fresh = {name: to_pixels(points[firsts[name] :]) for name, points in paths.items()}
        starts = {name: [self._pen[name]] if name in self._pen else [] for name in paths}
        grown = [find_bounds(np.array([*starts[name], *points]), self._width) for name, points in fresh.items()]
        lists = {name: points.tolist() for name, points in fresh.items()}
        for k in range(min(firsts.values(), default=0), max(map(len, paths.values()), default=0)):
            for name, points in lists.items():
                if firsts[name] <= k < firsts[name] + len(points):
                    self._go_to(layer, name, points[k - firsts[name]], colors[name])
        self._drawn = {name: np.array(points) for name, points in paths.items()}
        return grown

    def _go_to(self, layer: pygame.Surface, name: str, point: list[float], color: Color) -> None:
        pen = self._pen.setdefault(name, point)
        if math.hypot(point[0] - pen[0], point[1] - pen[1]) >= SHORTEST:
            draw_line(layer, color, np.array([pen, point]), self._width)
            self._pen[name] = point
