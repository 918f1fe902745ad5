"""Quintic splines as linear maps from states at breakpoints to Bezier control points of the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from scipy import sparse

DEGREE = 5


@dataclass(frozen=True)
class Breakpoint:
    """Hold what is known of a spline at one of its breakpoints; None is free.

    Args:
        position: shape (2,) [m].
        velocities: just before and just after it, each shape (2,) [m/s]; where they are known the
            acceleration may jump.
    """

    position: np.ndarray | None = None
    velocities: tuple[np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True)
class LinearMap:
    """Hold control points as matrix @ x + constant, the same matrix for both axes.

    Args:
        matrix: shape (m, n).
        constant: shape (m, 2).
    """

    matrix: sparse.csr_matrix
    constant: np.ndarray

    @cached_property
    def triplets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the matrix as rows, columns and values, each shape (entries,)."""
        entries = self.matrix.tocoo()
        return entries.row, entries.col, entries.data

    def apply(self, x: np.ndarray) -> np.ndarray:
        """Return the control points, shape (m, 2), for free states of both axes, shape (n, 2)."""
        return self.matrix @ x + self.constant


@dataclass(frozen=True)
class QuinticSpline:
    """Hold a twice continuously differentiable spline; the states at its breakpoints are the variables.

    Args:
        times: breakpoints, shape (S+1,) [s].
        size: number n of free states per axis.
        position: map to the control points, 6 per segment [m].
        velocity: 5 per segment [m/s].
        acceleration: 4 per segment [m/s^2].
        jerk: 3 per segment [m/s^3].
    """

    times: np.ndarray
    size: int
    position: LinearMap
    velocity: LinearMap
    acceleration: LinearMap
    jerk: LinearMap

    def cost(self, jerk_weight: float) -> tuple[sparse.csc_matrix, np.ndarray]:
        r"""Return Q, q with int |a|^2 + w |j|^2 dt = x'Qx/2 + q'x + constant per axis.

        Args:
            jerk_weight: w [s^2].

        Returns:
            Q: shape (n, n). q: shape (n, 2).
        """
        steps = np.diff(self.times)
        quadratic, linear = sparse.csc_matrix((self.size, self.size)), np.zeros((self.size, 2))
        for weight, part, degree in ((1.0, self.acceleration, 3), (jerk_weight, self.jerk, 2)):
            gram = sparse.kron(sparse.diags(2.0 * weight * steps), _gram(degree), format="csr")
            quadratic = quadratic + part.matrix.T @ gram @ part.matrix
            linear = linear + part.matrix.T @ (gram @ part.constant)
        return sparse.csc_matrix(quadratic), linear

    def greville(self) -> np.ndarray:
        """Return the times that belong to the position control points, shape (6 S,) [s]."""
        share = np.arange(DEGREE + 1) / DEGREE
        return (self.times[:-1, None] + share * np.diff(self.times)[:, None]).ravel()


def build_quintic_spline(times: np.ndarray, known: Mapping[int, Breakpoint]) -> QuinticSpline:
    """Build the maps of a spline that is partly known at its breakpoints.

    Neighbouring segments share the variables of position, velocity and acceleration, so continuity needs no rows, and
    known states are met exactly.

    Args:
        times: breakpoints, shape (S+1,) [s].
        known: index of a breakpoint to what is known there.

    Returns:
        The spline.
    """
    slots, constants, size = _number_states(len(times), known)
    segments = len(times) - 1
    rows = np.flatnonzero(slots.ravel() >= 0)
    data = np.ones(len(rows))
    pick = sparse.csr_matrix((data, (rows, slots.ravel()[rows])), shape=(6 * segments, size))
    steps = np.diff(times)
    hermite = sparse.block_diag([_hermite(step) for step in steps], format="csr")
    maps = [LinearMap((hermite @ pick).tocsr(), hermite @ constants.reshape(6 * segments, 2))]
    for order in range(3):
        count = DEGREE - order
        difference = np.diff(np.eye(count + 1), axis=0)
        matrix = sparse.kron(sparse.diags(count / steps), difference, format="csr")
        maps.append(LinearMap((matrix @ maps[-1].matrix).tocsr(), matrix @ maps[-1].constant))
    return QuinticSpline(times, size, *maps)


def _number_states(count: int, known: Mapping[int, Breakpoint]) -> tuple[np.ndarray, np.ndarray, int]:
    """Return, per segment and (p, v, a) at its two ends, the variable's index or -1, and the known value."""
    slots = np.full((count - 1, 6), -1)
    constants = np.zeros((count - 1, 6, 2))
    size = 0
    for j in range(count):
        point = known.get(j, Breakpoint())
        before, after = point.velocities or (None, None)
        sides = [(j - 1, 3, before)] * (j > 0) + [(j, 0, after)] * (j < count - 1)
        for kind in range(3):
            index = -1
            for segment, offset, velocity in sides:
                value = (point.position, velocity, None)[kind]
                if value is not None:
                    constants[segment, offset + kind] = value
                    continue
                if index < 0 or (kind == 2 and point.velocities is not None):
                    index, size = size, size + 1
                slots[segment, offset + kind] = index
    return slots, constants, size


def _hermite(h: float) -> np.ndarray:
    """Return the map from (p0, v0, a0, p1, v1, a1) to the six control points of a segment of duration h."""
    v, a = h / 5.0, h * h / 20.0
    return np.array(
        [
            [1, 0, 0, 0, 0, 0],
            [1, v, 0, 0, 0, 0],
            [1, 2 * v, a, 0, 0, 0],
            [0, 0, 0, 1, -2 * v, a],
            [0, 0, 0, 1, -v, 0],
            [0, 0, 0, 1, 0, 0],
        ]
    )


def _gram(degree: int) -> np.ndarray:
    """Return the integrals of products of Bernstein polynomials over [0, 1]."""
    n = degree
    entries = [[comb(n, i) * comb(n, j) / comb(2 * n, i + j) for j in range(n + 1)] for i in range(n + 1)]
    return np.array(entries) / (2 * n + 1)
