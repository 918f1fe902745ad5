"""Polynomials on [0, 1] with rational coefficients in the Bernstein basis, and rational bounds of square roots.

p(s) = sum_k binom(d, k) (1 - s)^(d-k) s^k p[k]. The least and the greatest coefficient bound the polynomial, the first
and the last are its values at the ends. Source: Farouki, "The Bernstein polynomial basis: a centennial retrospective"
(2012).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from fractions import Fraction

Polynomial = tuple[Fraction, ...]
Range = tuple[Fraction, Fraction]
HALF = Fraction(1, 2)
ROOT_BITS = 80  # roots are known to 2^-80 [unit of the root], far below every tolerance


def split(polynomial: Polynomial, place: Fraction = HALF) -> tuple[Polynomial, Polynomial]:
    """Return the polynomial before and after a place in [0, 1], each on [0, 1] again, by de Casteljau's rule."""
    row, left, right = list(polynomial), [polynomial[0]], [polynomial[-1]]
    while len(row) > 1:
        row = [low + place * (high - low) for low, high in itertools.pairwise(row)]
        left.append(row[0])
        right.append(row[-1])
    return tuple(left), tuple(reversed(right))


def restrict(polynomial: Polynomial, start: Fraction, end: Fraction) -> Polynomial:
    """Return the polynomial between two places, 0 <= start < end <= 1, on [0, 1] again."""
    if end < 1:
        polynomial = split(polynomial, end)[0]
    return split(polynomial, start / end)[1] if start > 0 else polynomial


def evaluate(polynomial: Polynomial, place: Fraction) -> Fraction:
    """Return the value at a place in [0, 1]."""
    return split(polynomial, place)[0][-1]


def differentiate(polynomial: Polynomial, duration: Fraction) -> Polynomial:
    """Return the derivative by time, of a polynomial that lasts so long [s]."""
    degree = len(polynomial) - 1
    if degree == 0:
        return (Fraction(0),)
    return tuple(degree * (high - low) / duration for low, high in itertools.pairwise(polynomial))


def elevate(polynomial: Polynomial, degree: int) -> Polynomial:
    """Return the same polynomial with the coefficients of a higher degree."""
    while len(polynomial) <= degree:
        n = len(polynomial)
        inner = (Fraction(k, n) * polynomial[k - 1] + Fraction(n - k, n) * polynomial[k] for k in range(1, n))
        polynomial = (polynomial[0], *inner, polynomial[-1])
    return polynomial


def combine(polynomials: Sequence[Polynomial], weights: Sequence[Fraction], constant: Fraction) -> Polynomial:
    """Return constant + sum_i weights[i] polynomials[i]."""
    degree = max(len(polynomial) for polynomial in polynomials) - 1
    rows = [elevate(polynomial, degree) for polynomial in polynomials]
    return tuple(
        constant + sum(weight * value for weight, value in zip(weights, column, strict=True))
        for column in zip(*rows, strict=True)
    )


def square(polynomial: Polynomial) -> Polynomial:
    """Return the square, of twice the degree."""
    n = len(polynomial) - 1
    scaled = [math.comb(n, k) * value for k, value in enumerate(polynomial)]
    product = [Fraction(0)] * (2 * n + 1)
    for i, left in enumerate(scaled):
        for j, right in enumerate(scaled):
            product[i + j] += left * right
    return tuple(value / math.comb(2 * n, k) for k, value in enumerate(product))


def find_range(polynomial: Polynomial) -> Range:
    """Return bounds of the polynomial on [0, 1]."""
    return min(polynomial), max(polynomial)


def root_below(number: Fraction) -> Fraction:
    """Return a number not above the square root of one that is not negative; the root itself if it is rational."""
    return _find_root(number)[0]


def root_above(number: Fraction) -> Fraction:
    """Return a number not below the square root of one that is not negative; the root itself if it is rational."""
    return _find_root(number)[1]


def _find_root(number: Fraction) -> Range:
    over, under = math.isqrt(number.numerator), math.isqrt(number.denominator)
    if over * over == number.numerator and under * under == number.denominator:
        return Fraction(over, under), Fraction(over, under)
    root = math.isqrt((number.numerator << 2 * ROOT_BITS) // number.denominator)
    return Fraction(root, 1 << ROOT_BITS), Fraction(root + 1, 1 << ROOT_BITS)
