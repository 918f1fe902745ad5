"""Rows of the smoothing program for what a formula demands of robots."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planners.free_flyer.specification.requirement import Requirement
from planners.quintic_spline import DEGREE, QuinticSpline
from planners.spline_rows import SplineRows

SAME_TIME = 1e-6  # differences of times that count as none [s]


def add_requirement_rows(
    rows: SplineRows,
    splines: Mapping[str, QuinticSpline],
    need: Requirement,
    rho: float,
    points: Mapping[str, np.ndarray],
) -> None:
    """Keep a requirement on control points, and thereby at all times of its window.

    What is not convex is taken from the previous points, segment by segment: the face beyond which an area is avoided,
    and the side on which bodies stay apart (that of the nearest control points).

    Args:
        rows: gets the rows, of kind "area".
        splines: robot name to its spline.
        need: with its window; one about objects alone adds nothing.
        rho: robustness to keep [m].
        points: previous control points of robots, and the control points of objects, each shape (S, 6, 2) [m].
    """
    movable = [name for name in need.bodies if name in splines]
    if not movable:
        return
    active = _find_active(need, splines[movable[0]].times)
    for normals, limit in _find_half_planes(need, rho, points, active):
        limits = np.where(active, limit, np.inf)
        for name in normals.keys() - splines.keys():
            limits = limits - np.sum(normals[name] * points[name], axis=2)
        parts = [(name, splines[name].position, normals[name].reshape(-1, 2)) for name in movable]
        rows.add(parts, limits.ravel(), "area")


def _find_active(need: Requirement, times: np.ndarray) -> np.ndarray:
    """Return which control points have to keep the requirement, shape (S, 6): at a breakpoint only those there."""
    active = np.zeros((len(times) - 1, DEGREE + 1), dtype=bool)
    if need.start == need.end:
        active[:, 0] = np.abs(times[:-1] - need.start) < SAME_TIME
        active[:, -1] = np.abs(times[1:] - need.start) < SAME_TIME
        if active.any():
            return active
    active[(times[1:] > need.start) & (times[:-1] < need.end)] = True
    return active


def _find_half_planes(
    need: Requirement, rho: float, points: Mapping[str, np.ndarray], active: np.ndarray
) -> list[tuple[dict[str, np.ndarray], np.ndarray | float]]:
    """Return pairs (body to normals of its control points, limits): the sum of normals . p is at most the limit."""
    shape = points[need.body].shape
    if need.kind == "stay":
        every = {need.body: need.faces, **need.others}
        return [
            ({name: np.broadcast_to(faces[f], shape) for name, faces in every.items()}, bound - rho)
            for f, bound in enumerate(need.bounds)
        ]
    if need.kind == "avoid":
        beyond = np.where(active[..., None], points[need.body] @ need.faces.T - need.bounds, np.inf)
        chosen = beyond.min(axis=1).argmax(axis=1)
        normals = np.broadcast_to(-need.faces[chosen][:, None, :], shape)
        limit = -need.bounds[chosen] - need.margin(rho)
        return [({need.body: normals}, np.broadcast_to(limit[:, None], active.shape))]
    (other,) = need.others
    apart = points[other] - points[need.body]
    lengths = np.linalg.norm(apart, axis=2)
    nearest = np.where(active, lengths, np.inf).argmin(axis=1)
    index = np.arange(len(nearest))
    side = apart[index, nearest] / np.maximum(lengths[index, nearest], 1e-9)[:, None]
    normals = np.broadcast_to(side[:, None, :], shape)
    return [({need.body: normals, other: -normals}, -need.distance - rho)]
