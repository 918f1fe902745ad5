"""Piecewise Bezier curves over physical time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import PlainSerializer, PlainValidator

from impact_envs.errors import InputError

Side = Literal["left", "right"]


def read_array(value: object) -> np.ndarray:
    """Return a read-only float64 copy of nested numbers.

    Args:
        value: array or nested sequences of finite numbers.

    Returns:
        A new array that cannot be written to.

    Raises:
        InputError: not an array of finite numbers.
    """
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"expected an array of numbers, got {value!r:.60}") from None
    if not np.isfinite(array).all():
        raise InputError("expected finite numbers, got inf or nan")
    array.setflags(write=False)
    return array


Array = Annotated[np.ndarray, PlainValidator(read_array), PlainSerializer(lambda array: array.tolist())]


@dataclass(frozen=True, eq=False)
class Curve:
    r"""Hold a piecewise Bezier curve in the plane.

    On segment k, with s = (t - times[k]) / (times[k+1] - times[k]):
    p(t) = sum_b binom(d, b) (1 - s)^(d-b) s^b points[k, b].

    The duration of every segment is a known number, so position, velocity and acceleration are all
    linear in the control points. Outside its time span the curve holds its end position at rest.

    Args:
        times: breakpoints, shape (S+1,), increasing [s].
        points: control points, shape (S, d+1, 2) [m].

    Raises:
        InputError: shapes do not fit, times do not increase, or a number is not finite.

    Source: Verhagen & Tumova, Eq. (8), with h(s) affine in Eq. (11).
    """

    times: Array
    points: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", read_array(self.times))
        object.__setattr__(self, "points", read_array(self.points))
        segments = len(self.times) - 1 if self.times.ndim == 1 else 0
        if segments < 1 or self.points.ndim != 3 or self.points.shape[::2] != (segments, 2):
            shapes = f"times {self.times.shape}, points {self.points.shape}"
            raise InputError(f"curve: {shapes} do not fit, expected (S+1,) and (S, degree+1, 2)")
        if self.points.shape[1] < 1 or (np.diff(self.times) <= 0).any():
            raise InputError("curve: needs control points and strictly increasing times")

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Curve)
            and np.array_equal(self.times, other.times)
            and np.array_equal(self.points, other.points)
        )

    __hash__ = None  # type: ignore[assignment]

    @property
    def degree(self) -> int:
        """Return the polynomial degree d of every segment."""
        return self.points.shape[1] - 1

    @cached_property
    def derivative(self) -> Curve:
        r"""Return the curve of the time derivative, of degree max(d-1, 0).

        Control points d (points[b+1] - points[b]) / h on a segment of duration h.

        Source: Verhagen & Tumova, Sec. II-E, property 3.
        """
        if self.degree == 0:
            return Curve(self.times, np.zeros_like(self.points))
        durations = np.diff(self.times)[:, None, None]
        return Curve(self.times, self.degree * np.diff(self.points, axis=1) / durations)

    def position(self, t: float | np.ndarray, side: Side = "right") -> np.ndarray:
        """Return the position by de Casteljau's rule.

        Args:
            t: time, scalar or shape (n,) [s].
            side: which segment answers at a breakpoint.

        Returns:
            Position, shape (2,) or (n, 2) [m].
        """
        t = np.asarray(t, dtype=float)
        k = np.searchsorted(self.times, t, side=side) - 1
        k = np.clip(k, 0, len(self.times) - 2)
        s = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        s = np.clip(s, 0.0, 1.0)[..., None, None]
        points = self.points[k]
        while points.shape[-2] > 1:
            points = (1.0 - s) * points[..., :-1, :] + s * points[..., 1:, :]
        return points[..., 0, :].copy()

    def velocity(self, t: float | np.ndarray, side: Side = "right") -> np.ndarray:
        """Return the velocity just after (right) or just before (left) time t.

        Args:
            t: time, scalar or shape (n,) [s].
            side: limit taken where the velocity jumps, at impacts.

        Returns:
            Velocity, shape (2,) or (n, 2) [m/s]; zero outside the time span.
        """
        return self._inside(t) * self.derivative.position(t, side)

    def acceleration(self, t: float | np.ndarray, side: Side = "right") -> np.ndarray:
        """Return the acceleration just after (right) or just before (left) time t.

        Args:
            t: time, scalar or shape (n,) [s].
            side: limit taken where the acceleration jumps.

        Returns:
            Acceleration, shape (2,) or (n, 2) [m/s^2]; zero outside the time span.
        """
        return self._inside(t) * self.derivative.derivative.position(t, side)

    def _inside(self, t: float | np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)[..., None]
        return ((t >= self.times[0]) & (t <= self.times[-1])).astype(float)
