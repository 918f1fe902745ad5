"""Robustness mu(x) of a predicate: on arrays, on one sample, and the range it can take within bounds.

The three forms, and the compiled one (state.py), perform the same floating-point operations in the same order. Hence
the online monitor ends at exactly the offline value, and (rounding being monotone) a range holds every value to the
last bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Protocol, TypeAlias

import numpy as np

Array: TypeAlias = Any  # a numpy array or a torch tensor
Range: TypeAlias = tuple[float, float]
EVERYTHING: Range = (-math.inf, math.inf)
Code: TypeAlias = tuple[int, tuple[str, ...], tuple[float, ...], int]

# Stands for a margin of exactly zero where truth counts: TIE where the predicate holds, -TIE where it does not. The
# least normal number of float32, which no margin of a moving body comes close to.
TIE = 2.0**-126

# Kinds of a margin for the compiled evaluator (state.py).
AREA, LINEAR, NORM = 1, 2, 3


class AreaLike(Protocol):
    """A closed convex area of the plane."""

    def halfspaces(self) -> tuple[Any, Any]:
        """Return (H, b), shapes (f, 2) and (f,): the area is H p <= b, rows of H have unit length [m]."""


class Margin(Protocol):
    """A predicate made numeric; ``strict`` says that it is false at a robustness of exactly zero."""

    @property
    def strict(self) -> bool:
        """Return whether the predicate is false at zero."""

    def compute(self, signals: Mapping[str, Array], xp: Any) -> Array:
        """Return mu of every sample.

        Args:
            signals: arrays that broadcast, shape (..., T).
            xp: the module the arrays belong to, numpy or torch.
        """

    def at(self, sample: Mapping[str, float]) -> float:
        """Return mu of one sample.

        Args:
            sample: signals to values.
        """

    def range(self, bounds: Mapping[str, Range]) -> Range:
        """Return an interval that holds mu for all signals within bounds.

        Args:
            bounds: signals to intervals; one that is missing may be anything.
        """

    def encode(self) -> Code:
        """Return what the compiled evaluator needs: kind, signals, numbers beginning with the sign, and a count."""

    def negate(self) -> Margin:
        """Return the margin of the opposite predicate: exactly minus this one."""


@dataclass(frozen=True, slots=True)
class AreaMargin:
    """mu = sign * min_f (b_f - H_f p) of a position p; ``faces`` holds b_f, H_f1, H_f2."""

    x: str
    y: str
    faces: tuple[tuple[float, float, float], ...]
    sign: float
    strict: bool = False

    def compute(self, signals: Mapping[str, Array], xp: Any) -> Array:
        """Return mu of every sample (see Margin)."""
        x, y = signals[self.x], signals[self.y]
        return self.sign * reduce(xp.minimum, [b - hx * x - hy * y for b, hx, hy in self.faces])

    def at(self, sample: Mapping[str, float]) -> float:
        """Return mu of one sample (see Margin)."""
        x, y = sample[self.x], sample[self.y]
        least = math.inf
        for b, hx, hy in self.faces:  # half the time of min over a list, and this is the monitor's inner loop
            slack = b - hx * x - hy * y
            if slack < least:
                least = slack
        return self.sign * least

    def range(self, bounds: Mapping[str, Range]) -> Range:
        """Return the interval of mu (see Margin); its far end is loose: each face takes its own best point."""
        faces = [_slack(b, ((self.x, hx), (self.y, hy)), bounds) for b, hx, hy in self.faces]
        return _signed(self.sign, combine_ranges(min, faces))

    def encode(self) -> Code:
        """Return the compiled form (see Margin); the count is that of the faces."""
        numbers = tuple(number for face in self.faces for number in face)
        return AREA, (self.x, self.y), (self.sign, *numbers), len(self.faces)

    def negate(self) -> AreaMargin:
        """Return the opposite margin (see Margin)."""
        return replace(self, sign=-self.sign, strict=not self.strict)


@dataclass(frozen=True, slots=True)
class LinearMargin:
    """mu = sign * (bound - sum_i c_i x_i); ``terms`` pairs signals with coefficients."""

    terms: tuple[tuple[str, float], ...]
    bound: float
    sign: float
    strict: bool = False

    def compute(self, signals: Mapping[str, Array], xp: Any) -> Array:
        """Return mu of every sample (see Margin)."""
        slack: Array = self.bound
        for name, coefficient in self.terms:
            slack = slack - coefficient * signals[name]
        return self.sign * slack

    def at(self, sample: Mapping[str, float]) -> float:
        """Return mu of one sample (see Margin)."""
        return self.compute(sample, None)

    def range(self, bounds: Mapping[str, Range]) -> Range:
        """Return the interval of mu (see Margin), exact."""
        return _signed(self.sign, _slack(self.bound, self.terms, bounds))

    def encode(self) -> Code:
        """Return the compiled form (see Margin); the count is that of the terms."""
        names, coefficients = zip(*self.terms, strict=True)
        return LINEAR, names, (self.sign, self.bound, *coefficients), len(names)

    def negate(self) -> LinearMargin:
        """Return the opposite margin (see Margin)."""
        return replace(self, sign=-self.sign, strict=not self.strict)


@dataclass(frozen=True, slots=True)
class NormMargin:
    """mu = sign * (bound - |head - tail|) with the Euclidean norm, for distances and speeds.

    ``head`` and ``tail`` name two signals each; no ``tail`` means the origin.
    """

    head: tuple[str, str]
    tail: tuple[str, str] | None
    bound: float
    sign: float
    strict: bool = False

    def compute(self, signals: Mapping[str, Array], xp: Any) -> Array:
        """Return mu of every sample (see Margin); the gradient at norm zero is zero."""
        x, y = (signals[name] for name in self.head)
        if self.tail is not None:
            x, y = x - signals[self.tail[0]], y - signals[self.tail[1]]
        # sqrt has no gradient at zero, torch's norm takes zero there.
        norm = np.sqrt(x * x + y * y) if xp is np else xp.linalg.vector_norm(xp.stack((x, y)), dim=0)
        return self.sign * (self.bound - norm)

    def at(self, sample: Mapping[str, float]) -> float:
        """Return mu of one sample (see Margin)."""
        x, y = sample[self.head[0]], sample[self.head[1]]
        if self.tail is not None:
            x, y = x - sample[self.tail[0]], y - sample[self.tail[1]]
        return self.sign * (self.bound - math.sqrt(x * x + y * y))

    def range(self, bounds: Mapping[str, Range]) -> Range:
        """Return the interval of mu (see Margin); a norm is never negative, with or without bounds."""
        near = far = 0.0
        for head, tail in zip(self.head, self.tail or (None, None), strict=True):
            low, high = bounds.get(head, EVERYTHING)
            if tail is not None:
                tail_low, tail_high = bounds.get(tail, EVERYTHING)
                low, high = low - tail_high, high - tail_low
            least, most = max(0.0, low, -high), max(-low, high)
            near, far = near + least * least, far + most * most
        return _signed(self.sign, (self.bound - math.sqrt(far), self.bound - math.sqrt(near)))

    def encode(self) -> Code:
        """Return the compiled form (see Margin); the count is that of the signals."""
        names = (*self.head, *(self.tail or ()))
        return NORM, names, (self.sign, self.bound), len(names)

    def negate(self) -> NormMargin:
        """Return the opposite margin (see Margin)."""
        return replace(self, sign=-self.sign, strict=not self.strict)


def combine_ranges(pick: Any, ranges: Iterable[Range]) -> Range:
    """Return the range of the least or the greatest of several values.

    Args:
        pick: ``min`` or ``max``.
        ranges: of the values, at least one.
    """
    lows, highs = zip(*ranges, strict=True)
    return pick(lows), pick(highs)


def mark_tie(value: float, strict: bool) -> float:
    """Return a margin, or an end of its range; instead of zero TIE or -TIE.

    Args:
        value: of the margin.
        strict: whether the predicate is false at zero.
    """
    return value if value else -TIE if strict else TIE


def _slack(bound: float, terms: Iterable[tuple[str, float]], bounds: Mapping[str, Range]) -> Range:
    """Return the range of bound - sum_i c_i x_i; a zero coefficient silences even an unbounded signal."""
    low = high = bound
    for name, coefficient in terms:
        if coefficient != 0:
            ends = sorted(coefficient * end for end in bounds.get(name, EVERYTHING))
            low, high = low - ends[1], high - ends[0]
    return low, high


def _signed(sign: float, ends: Range) -> Range:
    return ends if sign > 0 else (-ends[1], -ends[0])
