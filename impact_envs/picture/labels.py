"""Where labels go: beside what they name, and on no body as long as there is room."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_envs.picture.drawing import Points

Size = tuple[int, int]
GAPS = (2.0, 14.0, 30.0, 60.0)  # between a body and its label [px]
INSET = 4.0  # of an area's label from its edges [px]
EDGE = 2.0  # half of the width that an area's edge takes [px]
SPACING = 10.0  # of the boxes that stand for an outline [px]
FAR = 4.0  # a place less dear is as good as one covered square pixel less, times this
OUTSIDE = 20.0  # a square pixel outside the picture costs as much as so many covered ones
# Directions from a body in the order of preference, in halves of its size and its label's: below, above, beside, ...
WAYS = np.array([(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)], float)
NEARBY = len(WAYS)  # places that are looked at before those farther away


def choose_place(places: Points, boxes: Points, frame: Sequence[float]) -> Points:
    """Choose where a label goes.

    Args:
        places: left, top, right, bottom of each, the best one first, shape (n, 4) [px].
        boxes: what should not be covered, shape (m, 4) [px].
        frame: what should not be left: left, top, right, bottom [px].

    Returns:
        The first place that covers and leaves least, moved inside the frame, shape (4,).
    """
    edge = np.asarray(frame, float)
    first = places[0]
    if (first[:2] >= edge[:2]).all() and (first[2:] <= edge[2:]).all() and not _covers(first, boxes).any():
        return first
    costs = np.zeros(0)
    # Places of one distance after the other: a place costs at least ``FAR`` times its number, whatever it covers.
    while len(costs) < len(places) and costs.min(initial=np.inf) >= FAR * len(costs):
        costs = np.append(costs, _judge(places[len(costs) : len(costs) + NEARBY], boxes, edge, len(costs)))
    best = places[int(np.argmin(costs))]
    shift = np.maximum(edge[:2] - best[:2], 0.0) - np.maximum(best[2:] - edge[2:], 0.0)
    return best + np.tile(shift, 2)


def _judge(places: Points, boxes: Points, edge: Points, first: int) -> Points:
    """Return what each place costs: what it covers, what of it leaves the frame, and its number in the list."""
    near = boxes[_covers(np.concatenate([places[:, :2].min(axis=0), places[:, 2:].max(axis=0)]), boxes)]
    # One axis after the other: NumPy is slow along an axis of two numbers.
    wide, tall = (
        np.minimum(places[:, k + 2, None], near[:, k + 2]) - np.maximum(places[:, k, None], near[:, k]) for k in (0, 1)
    )
    covered = (np.maximum(wide, 0.0) * np.maximum(tall, 0.0)).sum(axis=1)
    inside = np.maximum(np.minimum(places[:, 2:], edge[2:]) - np.maximum(places[:, :2], edge[:2]), 0.0).prod(axis=1)
    outside = (places[:, 2:] - places[:, :2]).prod(axis=1) - inside
    return covered + OUTSIDE * outside + FAR * (first + np.arange(len(places)))


def _covers(place: Points, boxes: Points) -> np.ndarray:
    """Return which boxes a place overlaps, shape (m,)."""
    return (boxes[:, 0] < place[2]) & (boxes[:, 2] > place[0]) & (boxes[:, 1] < place[3]) & (boxes[:, 3] > place[1])


def place_beside(low: Points, high: Points, size: Size) -> Points:
    """Return places of a label around a body from ``low`` to ``high`` [px], nearest and lowest first."""
    middle, half = (low + high) / 2, np.array(size) / 2
    reach = (high - low) / 2 + half + np.array(GAPS)[:, None, None]
    centers = (middle + WAYS * reach).reshape(-1, 2)
    return np.hstack([centers - half, centers + half])


def place_inside(low: Points, high: Points, size: Size) -> Points:
    """Return places of an area's label: in its corners where it fits, then above and below it, then anywhere around."""
    (left, top), (right, bottom), (width, height) = low, high, size
    columns, rows = (left + INSET, right - INSET - width), (top + INSET, bottom - INSET - height)
    corners = [(x, y) for y in rows for x in columns] if width + 2 * INSET < right - left else []
    beyond = [(x, y) for y in (top - height - 1, bottom + 1) for x in (left, right - width)]
    origins = np.array([*corners, *beyond], float)
    return np.vstack([np.hstack([origins, origins + size]), place_beside(low, high, size)])


def sample_line(points: Points, spacing: float) -> Points:
    """Return points along a polyline, its own among them, shape (m, 2)."""
    steps = np.diff(points, axis=0)
    counts = np.maximum(1, np.ceil(np.hypot(*steps.T) / spacing)).astype(int)
    shares = np.concatenate([np.arange(count) / count for count in counts.tolist()])
    inner = np.repeat(points[:-1], counts, axis=0) + shares[:, None] * np.repeat(steps, counts, axis=0)
    return np.vstack([inner, points[-1:]])


def sample_area(corners: Points, spacing: float) -> Points:
    """Return points in a convex polygon: along its outline, halfway to its middle, and that one, shape (m, 2)."""
    outline, middle = sample_line(np.vstack([corners, corners[:1]]), spacing), corners.mean(axis=0)
    return np.vstack([outline, (outline + middle) / 2, middle])


def box_points(points: Points, reach: float = SPACING / 2) -> Points:
    """Return boxes around points, shape (m, 4) [px]."""
    return np.hstack([points - reach, points + reach])
