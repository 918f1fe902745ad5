"""Solve the continuous algebraic Riccati equation of a small system by the matrix sign function."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import exp, log

ITERATIONS = 60  # at most, of Newton's method for the sign
# Relative change of the sign at which one last step follows: the method converges quadratically.
CONVERGED = 1e-7
RESIDUAL = 1e-8  # greatest residual of an accepted solution, relative to the largest term of the equation


class RiccatiScratch(NamedTuple):
    """Working arrays of `solve_riccati`, for m states.

    Attributes:
        Z, inverse, work: sign iterate, its inverse, a copy, shape (2 m, 2 m).
        AK, SK: products, shape (m, m).
    """

    Z: np.ndarray
    inverse: np.ndarray
    work: np.ndarray
    AK: np.ndarray
    SK: np.ndarray


def make_riccati_scratch(m: int) -> RiccatiScratch:
    """Allocate the working arrays for m states."""
    return RiccatiScratch(*(np.zeros((size, size)) for size in (2 * m, 2 * m, 2 * m, m, m)))


@compiled
def invert_matrix(Z: np.ndarray, inverse: np.ndarray) -> float:
    """Compute the inverse by Gauss-Jordan elimination with row pivoting; Z is destroyed.

    Args:
        Z: matrix, shape (m, m).
        inverse: result, shape (m, m).

    Returns:
        Logarithm of |det Z|; infinity if Z is singular.
    """
    m = len(Z)
    for i in range(m):
        for j in range(m):
            inverse[i, j] = 1.0 if i == j else 0.0
    log_det = 0.0
    for k in range(m):
        best = k
        for i in range(k + 1, m):
            if abs(Z[i, k]) > abs(Z[best, k]):
                best = i
        pivot = Z[best, k]
        if pivot == 0.0 or not math.isfinite(pivot):
            return math.inf
        log_det += log(abs(pivot))
        for j in range(m):
            held = Z[best, j]
            Z[best, j] = Z[k, j]
            Z[k, j] = held / pivot
            held = inverse[best, j]
            inverse[best, j] = inverse[k, j]
            inverse[k, j] = held / pivot
        for i in range(m):
            factor = Z[i, k]
            if i != k and factor != 0.0:
                for j in range(m):
                    Z[i, j] -= factor * Z[k, j]
                    inverse[i, j] -= factor * inverse[k, j]
    return log_det


@compiled
def solve_least_squares(C: np.ndarray, columns: int) -> bool:
    """Minimise |C_1 X + C_2| by Householder reflections; X replaces the upper part of C_2.

    Args:
        C: (C_1, C_2) side by side; C_1 has ``columns`` columns, C_2 the rest.
        columns: number of unknowns.

    Returns:
        Whether C_1 has full rank.
    """
    rows, width = C.shape
    for k in range(columns):
        square = 0.0
        for i in range(k, rows):
            square += C[i, k] * C[i, k]
        if square == 0.0 or not math.isfinite(square):
            return False
        alpha = -math.copysign(math.sqrt(square), C[k, k])
        scale = square - alpha * C[k, k]
        C[k, k] -= alpha
        for j in range(k + 1, width):
            dot = 0.0
            for i in range(k, rows):
                dot += C[i, k] * C[i, j]
            for i in range(k, rows):
                C[i, j] -= C[i, k] * dot / scale
        C[k, k] = alpha
    for j in range(columns, width):
        for i in range(columns - 1, -1, -1):
            total = -C[i, j]
            for k in range(i + 1, columns):
                total -= C[i, k] * C[k, j]
            C[i, j] = total / C[i, i]
    return True


@compiled
def solve_riccati(A: np.ndarray, S: np.ndarray, Q: np.ndarray, K: np.ndarray, scratch: RiccatiScratch) -> bool:
    """Solve A' K + K A + Q - K S K = 0 for the K that makes A - S K stable.

    K spans, as (1; K), the kernel of W + 1 with W the sign of the Hamiltonian (A, -S; -Q, -A'), which Newton's method
    Z <- (c Z + (c Z)^-1) / 2, c = |det Z|^(-1 / 2m), finds.

    Args:
        A: shape (m, m).
        S: B R^-1 B', shape (m, m).
        Q: symmetric, shape (m, m).
        K: result, shape (m, m).
        scratch: working arrays.

    Returns:
        Whether K solves the equation; K is untouched otherwise.

    Source: Roberts, Linear model reduction and solution of the algebraic Riccati equation by use of the sign function,
        Int. J. Control 32 (1980); scaling: Byers, Linear Algebra Appl. 85 (1987).
    """
    m = len(A)
    Z = scratch.Z
    for i in range(m):
        for j in range(m):
            Z[i, j], Z[i, m + j] = A[i, j], -S[i, j]
            Z[m + i, j], Z[m + i, m + j] = -Q[i, j], -A[j, i]
    if not compute_sign(Z, scratch.inverse, scratch.work):
        return False
    C = scratch.work
    for i in range(2 * m):
        for j in range(m):
            C[i, j], C[i, m + j] = Z[i, m + j], Z[i, j]
    for i in range(m):
        C[m + i, i] += 1.0
        C[i, m + i] += 1.0
    if not solve_least_squares(C, m):
        return False
    return accept_solution(A, S, Q, C[:m, m:], K, scratch.AK, scratch.SK)


@compiled
def compute_sign(Z: np.ndarray, inverse: np.ndarray, work: np.ndarray) -> bool:
    """Replace a matrix by its matrix sign.

    Args:
        Z: matrix without eigenvalues on the imaginary axis, replaced by its sign, shape (m, m).
        inverse, work: scratch, shape (m, m).

    Returns:
        Whether Newton's method converged.
    """
    m = len(Z)
    last = False
    for _ in range(ITERATIONS):
        for i in range(m):
            for j in range(m):
                work[i, j] = Z[i, j]
        log_det = invert_matrix(work, inverse)
        if not math.isfinite(log_det):
            return False
        c = 1.0 if last else exp(-log_det / m)
        change = size = 0.0
        for i in range(m):
            for j in range(m):
                new = (c * Z[i, j] + inverse[i, j] / c) / 2.0
                change = max(change, abs(new - Z[i, j]))
                size = max(size, abs(new))
                Z[i, j] = new
        if last:
            return True
        last = change <= CONVERGED * size
    return False


@compiled
def accept_solution(
    A: np.ndarray, S: np.ndarray, Q: np.ndarray, X: np.ndarray, K: np.ndarray, AK: np.ndarray, SK: np.ndarray
) -> bool:
    """Write the symmetric part of X to K if it solves the Riccati equation to `RESIDUAL`.

    Args:
        A, S, Q: of the equation, shape (m, m).
        X: candidate, shape (m, m).
        K: result, shape (m, m).
        AK, SK: scratch, shape (m, m).
    """
    m = len(A)
    for i in range(m):
        for j in range(m):
            AK[i, j] = SK[i, j] = 0.0
            for k in range(m):
                AK[i, j] += A[k, i] * (X[k, j] + X[j, k]) / 2.0
                SK[i, j] += S[i, k] * (X[k, j] + X[j, k]) / 2.0
    worst = largest = 0.0
    for i in range(m):
        for j in range(m):
            quadratic = 0.0
            for k in range(m):
                quadratic += (X[i, k] + X[k, i]) / 2.0 * SK[k, j]
            worst = max(worst, abs(AK[i, j] + AK[j, i] + Q[i, j] - quadratic))
            largest = max(largest, abs(AK[i, j]), abs(Q[i, j]), abs(quadratic))
    if not worst <= RESIDUAL * largest:
        return False
    for i in range(m):
        for j in range(m):
            K[i, j] = (X[i, j] + X[j, i]) / 2.0
    return True
