"""Rows of a quadratic program over several quintic splines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import sparse

from planners.quintic_spline import DEGREE, LinearMap, QuinticSpline


class SplineRows:
    """Collect rows a . x <= b as triplets, soft ones with a slack variable per segment."""

    def __init__(self, splines: Mapping[str, QuinticSpline]) -> None:
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
            soft: kind of rows of which a segment's six may be violated together, at a price; empty: hard rows.
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

    def stack(self) -> tuple[sparse.csc_matrix, np.ndarray]:
        """Return all rows A, b, and that no slack is negative."""
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

    def violation(self, x: np.ndarray, kind: str) -> float:
        """Return by how much rows of a kind are violated at most.

        Args:
            x: solution, slacks last.
            kind: as given to `add`.
        """
        return max((float(x[start:end].max()) for name, start, end in self._kinds if name == kind), default=0.0)
