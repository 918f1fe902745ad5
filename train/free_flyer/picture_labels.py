"""Labels of a picture, put where they cover least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

DIRECTIONS = np.stack([[np.cos(a), np.sin(a)] for a in np.linspace(0, 2 * np.pi, 17)[:-1]])
GAPS = (3.0, 12.0, 26.0, 44.0, 70.0)  # between a thing and its label [px at 100 dpi]
LEADER = 20.0  # gap from which on a line leads to the label
FAR, COVERED, OUTSIDE = 0.15, 0.1, 10.0  # cost of a pixel of gap, of a covered square pixel, of a pixel outside


@dataclass(frozen=True, eq=False)
class Label:
    """Hold what is to be written beside a thing.

    Args:
        text: one line.
        anchor: centre of the thing, shape (2,), in data coordinates.
        radius: of the thing, in data coordinates.
        color: of the letters.
        weight: of the letters.
    """

    text: str
    anchor: np.ndarray
    radius: float
    color: Any
    weight: str = "normal"


def place_labels(axes: Axes, labels: Sequence[Label], lines: np.ndarray, fixed: Sequence[Text], halo: Any) -> None:
    """Write labels one after the other, each where it covers fewest points of lines and other labels.

    Args:
        axes: whose limits and place in the figure are settled.
        labels: the most important one first.
        lines: points along everything that should stay in sight, shape (n, 2), in data coordinates.
        fixed: texts that stay where they are.
        halo: colour of a rim round the letters.
    """
    axes.apply_aspect()
    canvas = cast(FigureCanvasAgg, cast(Figure, axes.figure).canvas)
    busy = np.unique(np.round(axes.transData.transform(lines) / 3.0) * 3.0, axis=0)
    frame = np.array(axes.get_window_extent().extents)
    things = [_thing(axes, label) for label in labels]
    renderer = canvas.get_renderer()
    taken = [np.array(text.get_window_extent(renderer).extents) for text in fixed]
    taken += [np.concatenate([center - reach, center + reach]) for center, reach in things]
    for label, (center, reach) in zip(labels, things, strict=True):
        text = axes.text(0.0, 0.0, label.text, color=label.color, weight=label.weight, size=10, zorder=9)
        text.set(ha="center", va="center", path_effects=[withStroke(linewidth=3, foreground=halo)])
        half = np.array(text.get_window_extent(renderer).size) / 2 + 1.0
        best = min(_candidates(center, reach, half), key=lambda place: _cost(place, half, busy, taken, frame))
        middle = best[1]
        text.set_position(tuple(axes.transData.inverted().transform(middle)))
        taken.append(np.concatenate([middle - half, middle + half]))
        if best[0] >= LEADER:
            _lead(axes, center, middle, reach, half, label.color)


def _thing(axes: Axes, label: Label) -> tuple[np.ndarray, float]:
    """Return centre and radius in pixels."""
    center, edge = axes.transData.transform([label.anchor, np.add(label.anchor, (label.radius, 0.0))])
    return center, max(float(edge[0] - center[0]), 8.0)


def _candidates(center: np.ndarray, reach: float, half: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Return gaps and middles of labels round a thing; a label touches the ring of its gap."""
    return [
        (gap, center + way * (reach + gap) + np.sign(np.round(way, 3)) * half) for gap in GAPS for way in DIRECTIONS
    ]


def _cost(
    place: tuple[float, np.ndarray], half: np.ndarray, busy: np.ndarray, taken: Sequence[np.ndarray], frame: np.ndarray
) -> float:
    gap, middle = place
    lower, upper = middle - half, middle + half
    points = float(np.sum(np.all((busy > lower) & (busy < upper), axis=1)))
    boxes = np.array(taken)
    overlap = np.minimum(upper, boxes[:, 2:]) - np.maximum(lower, boxes[:, :2])
    covered = float(np.sum(np.prod(np.maximum(overlap, 0.0), axis=1)))
    outside = float(np.sum(np.maximum(frame[:2] - lower, 0.0) + np.maximum(upper - frame[2:], 0.0)))
    return FAR * gap + points + COVERED * covered + OUTSIDE * outside


def _lead(axes: Axes, center: np.ndarray, middle: np.ndarray, reach: float, half: np.ndarray, color: Any) -> None:
    """Draw a line from a thing to the nearest point of its label."""
    near = np.clip(center, middle - half, middle + half)
    way = (near - center) / np.linalg.norm(near - center)
    ends = axes.transData.inverted().transform([center + reach * way, near])
    axes.plot(*ends.T, color=color, lw=0.7, zorder=8, scalex=False, scaley=False)
