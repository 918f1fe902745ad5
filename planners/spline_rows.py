"""Quadratic programs over several quintic splines: rows, cost, and what their solutions say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from planners.quintic_spline import DEGREE, LinearMap, QuinticSpline


@dataclass(frozen=True)
class SmoothingOptions:
    """Choose how knots become smooth motions.

    Args:
        jerk_weight: w of the cost int |a|^2 + w |j|^2 dt; accelerations that change within less than sqrt(w) cost more
            by their change than by their size [s^2].
        parting_speed: rate at which the least distance of two bodies may grow after, and shrink before, an instant at
            which it is small, such as their own impact [m/s].
        slack_weights: prices of violated rows; each is for what the one before it leaves violated.
        rounds: greatest number of programs at each price; each one takes the sides of bodies from the one before.
        segments: mean lengths of a curve's segments, tried in turn where motions fail [s].
    """

    jerk_weight: float = 1.0
    parting_speed: float = 0.03
    slack_weights: tuple[float, ...] = (1e3, 1e5)
    rounds: int = 8
    segments: tuple[float, ...] = (3.0,)


class SplineRows:
    """Collect rows a . x <= b as triplets; soft rows have one slack variable per segment."""

    def __init__(self, splines: Mapping[str, QuinticSpline]) -> None:
        self.splines = splines
        sizes = [2 * spline.size for spline in splines.values()]
        self.starts = dict(zip(splines, np.cumsum([0, *sizes[:-1]]), strict=True))
        self.size = sum(sizes)
        self.slacks = 0
        self._kinds: list[tuple[str, int, int]] = []
        self._height = 0
        self._triplets: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self._bounds: list[np.ndarray] = []

    def add(self, parts: Sequence[tuple[str, LinearMap, np.ndarray]], limits: np.ndarray, soft: str = "") -> None:
        """Add sum over parts of normals . (control points) <= limits; infinite limits make no rows.

        Args:
            parts: robot, its map, and one normal per control point, shape (m, 2).
            limits: shape (m,).
            soft: kind of the rows; the six rows of a segment may be violated together, at a price; empty: hard rows.
        """
        bounds = limits.copy()
        for name, part, normals in parts:
            bounds -= np.sum(normals * part.constant, axis=1)
            row, column, value = part.triplets
            for axis in range(2):
                columns = self.starts[name] + axis * part.matrix.shape[1] + column
                self._triplets.append((self._height + row, columns, value * normals[row, axis]))
        if soft:
            row = np.arange(len(bounds))
            columns = self.size + self.slacks + row // (DEGREE + 1)
            self._triplets.append((self._height + row, columns, np.full(len(row), -1.0)))
            count = len(bounds) // (DEGREE + 1)
            self._kinds.append((soft, self.size + self.slacks, self.size + self.slacks + count))
            self.slacks += count
        self._bounds.append(bounds)
        self._height += len(bounds)

    def add_halfspaces(self, name: str, normals: np.ndarray, limits: np.ndarray, soft: str) -> None:
        """Add normals . p <= limits on the control points p of one spline.

        Args:
            name: of the spline.
            normals: shape (S, 6, 2).
            limits: shape (S, 6) [m].
            soft: as for `add`.
        """
        self.add([(name, self.splines[name].position, normals.reshape(-1, 2))], limits.ravel(), soft)

    def make_cost(self, jerk_weight: float, scale: float, price: float) -> tuple[sparse.csc_matrix, np.ndarray]:
        """Return P, q of the cost x'Px/2 + q'x: scale int |a|^2 + w |j|^2 dt of all splines, and the slacks' prices.

        Args:
            jerk_weight: w [s^2].
            scale: brings the cost near 1, where the solver's tolerances fit.
            price: of every slack.
        """
        blocks, linear = [], []
        for spline in self.splines.values():
            quadratic, slope = spline.cost(jerk_weight)
            blocks += [scale * quadratic, scale * quadratic]
            linear += [scale * slope[:, 0], scale * slope[:, 1]]
        blocks.append(sparse.csc_matrix((self.slacks, self.slacks)))
        return sparse.block_diag(blocks, format="csc"), np.concatenate([*linear, np.full(self.slacks, price)])

    def read_points(self, x: np.ndarray, name: str) -> np.ndarray:
        """Return the control points of a spline in a solution, shape (S, 6, 2) [m]."""
        spline = self.splines[name]
        states = x[self.starts[name] :][: 2 * spline.size].reshape(2, -1).T
        return spline.position.apply(states).reshape(-1, DEGREE + 1, 2)

    def stack(self) -> tuple[sparse.csc_matrix, np.ndarray]:
        """Return all rows A x <= b, with rows that keep every slack from being negative."""
        row, column, value = (np.concatenate(arrays) for arrays in zip(*self._triplets, strict=True))
        below = np.arange(self.slacks)
        row = np.concatenate([row, self._height + below])
        column = np.concatenate([column, self.size + below])
        value = np.concatenate([value, np.full(self.slacks, -1.0)])
        bounds = np.concatenate([*self._bounds, np.zeros(self.slacks)])
        index = np.cumsum(np.isfinite(bounds)) - 1
        keep = np.isfinite(bounds)[row] & (value != 0.0)
        shape = (int(index[-1]) + 1, self.size + self.slacks)
        matrix = sparse.csc_matrix((value[keep], (index[row[keep]], column[keep])), shape=shape)
        return matrix, bounds[np.isfinite(bounds)]

    def measure_violation(self, x: np.ndarray, kind: str) -> float:
        """Return the greatest violation of soft rows.

        Args:
            x: solution, slacks last.
            kind: of the rows, as given to `add`.
        """
        return max((float(x[start:end].max()) for name, start, end in self._kinds if name == kind), default=0.0)


def find_sides(relative: np.ndarray) -> np.ndarray:
    """Return on which side another body is: one unit direction per segment, repeated for its control points.

    Args:
        relative: control points of the other body minus those of this one, shape (S, 6, 2) [m].

    Returns:
        Directions, shape (S, 6, 2).
    """
    middle = relative.mean(axis=1)
    length = np.linalg.norm(middle, axis=1, keepdims=True)
    unit = np.where(length > 1e-9, middle / np.maximum(length, 1e-9), [1.0, 0.0])
    return np.repeat(unit[:, None, :], DEGREE + 1, axis=1)
