"""Strictly convex quadratic programs, small and dense: equalities eliminated, then a dual active-set method; compiled.

Minimise x' H x / 2 + f' x subject to lower <= (x_1 .. x_b, A x) <= upper, of which the first rows of A are equalities.

1. x = x_0 + Z z, where x_0 is the shortest solution of the equalities and the columns of Z are an orthonormal basis of
   what they leave free: A_e' = Q R by Householder reflections, Q = (Y, Z). So a variable that costs next to nothing, as
   a torque that the motion determines, does not spoil the condition of what is left.
2. From the minimum without inequalities, the most violated row is made active by steps that keep the multipliers of the
   active rows at zero or above; one that would pass below zero is dropped first. There are finitely many steps, no
   starting point and no memory of the last program, so equal programs have equal solutions, bit for bit.

Source: Goldfarb & Idnani, A numerically stable dual method for solving strictly convex quadratic programs (1983),
Sec. 3 and 4; null space: Golub & Van Loan, Matrix Computations, Sec. 5.2 and 6.2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import hypot

SOLVED, INFEASIBLE, STOPPED = range(3)
STEPS = 200  # more than ten times what any recorded program needed; a rounding error might let the method cycle
VIOLATED = 1e-11  # of a bound, relative to one and to the bound; rounding stays below a tenth of it
DEPENDENT = 1e-13  # what is left of a row outside the span of others, relative to its length
NONE = -1


class Workspace(NamedTuple):
    """Where programs of at most n unknowns and m rows are solved.

    Attributes:
        reflectors: of the equalities, below the diagonal, and R above it, shape (n, n).
        pivots, scale: of R, and 2 / |v|^2 of each reflector v, shape (1 + n,).
        basis: x_0 and Z, shape (n, 1 + n).
        image: H times the basis, shape (n, 1 + n).
        rows: of the inequalities in z: value at x_0, then coefficients, shape (m, 1 + n).
        factor: L of Z' H Z = L L', shape (n, n).
        J: columns of L^-T, turned with every change of the active rows, as rows, shape (n, n).
        R: triangle of the active rows, shape (n, n).
        z, direction, d, r: shape (1 + n,).
        active: rows that hold with equality, shape (1 + n,).
        sign: 1 for those at their lower bound, -1 at their upper, shape (1 + n,).
        u: their multipliers, shape (1 + n,).
    """

    reflectors: np.ndarray
    pivots: np.ndarray
    scale: np.ndarray
    basis: np.ndarray
    image: np.ndarray
    rows: np.ndarray
    factor: np.ndarray
    J: np.ndarray
    R: np.ndarray
    z: np.ndarray
    direction: np.ndarray
    d: np.ndarray
    r: np.ndarray
    active: np.ndarray
    sign: np.ndarray
    u: np.ndarray


def make_workspace_type(unknowns: int, rows: int) -> np.dtype:
    """Return a workspace as a record, for programs of at most so many unknowns and rows, bounds included."""
    n = unknowns
    shapes = {"basis": (n, 1 + n), "image": (n, 1 + n), "rows": (rows, 1 + n)}
    shapes |= dict.fromkeys(("reflectors", "factor", "J", "R"), (n, n))
    kinds = {"active": np.int64}
    return np.dtype([(name, kinds.get(name, float), shapes.get(name, (1 + n,))) for name in Workspace._fields])


def make_workspace(unknowns: int, rows: int) -> Workspace:
    """Make room for programs of at most so many unknowns and rows, bounds included."""
    record = np.zeros(1, make_workspace_type(unknowns, rows))[0]
    return Workspace(*(record[name] for name in Workspace._fields))


@compiled
def solve_qp(
    H: np.ndarray,
    f: np.ndarray,
    A: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    bounds: int,
    equal: int,
    work: Workspace,
    x: np.ndarray,
) -> int:
    """Solve a program.

    Args:
        H: symmetric, positive definite where the equalities leave x free, shape (n, n).
        f: shape (n,).
        A: shape (m, n).
        lower, upper: of the first unknowns, then of the rows of A, infinite where there is none, shape (bounds + m,).
        bounds: b, number of unknowns that have bounds.
        equal: number of equalities, the first rows of A; `upper` is what they equal.
        work: scratch.
        x: solution, shape (n,); of no use unless SOLVED.

    Returns:
        SOLVED; INFEASIBLE, no x satisfies all rows; or STOPPED: equalities that depend on each other, H not positive
        definite, a number that is not finite, or too many steps.
    """
    n = len(f)
    free = n - equal
    if not (eliminate(A, upper, bounds, equal, work) and condense(H, f, equal, work)):
        return STOPPED
    for c in range(bounds + len(A) - equal):
        write_row(A, c, bounds, equal, work)
    status = search(lower, upper, bounds, equal, free, bounds + len(A) - equal, work)
    total = 0.0
    for i in range(n):
        value = work.basis[i, 0]
        for j in range(free):
            value += work.basis[i, 1 + j] * work.z[j]
        x[i] = value
        total += 0.0 * value
    return status if total == 0.0 else STOPPED


@inlined
def eliminate(A: np.ndarray, right: np.ndarray, bounds: int, equal: int, work: Workspace) -> bool:
    """Write the basis x_0, Z of the solutions of the equalities; return False if they depend on each other.

    Args:
        A: the first rows are the equalities, shape (m, n).
        right: what they equal begins at `bounds`.
        bounds, equal, work: see `solve_qp`.
    """
    n = A.shape[1]
    T, pivots, scale, basis = work.reflectors, work.pivots, work.scale, work.basis
    for k in range(n):
        for i in range(equal):
            T[k, i] = A[i, k]
    for j in range(equal):
        size, length = 0.0, 0.0
        for k in range(n):
            square = T[k, j] * T[k, j]
            length += square
            if k >= j:
                size += square
        if not size > DEPENDENT * DEPENDENT * length:
            return False
        norm = math.sqrt(size)
        pivots[j] = -math.copysign(norm, T[j, j])
        T[j, j] -= pivots[j]
        scale[j] = 1.0 / (norm * abs(T[j, j]))
        reflect(T, j, n, scale[j], T, j + 1, equal, work.r)
    columns = 1 + n - equal
    for i in range(n):
        for j in range(columns):
            basis[i, j] = 0.0
        if i >= equal:
            basis[i, 1 + i - equal] = 1.0
    for j in range(equal):
        value = right[bounds + j]
        for i in range(j):
            value -= T[i, j] * basis[i, 0]
        basis[j, 0] = value / pivots[j]
    for back in range(equal):
        j = equal - 1 - back
        reflect(T, j, n, scale[j], basis, 0, columns, work.r)
    return True


@inlined
def reflect(
    T: np.ndarray, j: int, n: int, scale: float, target: np.ndarray, first: int, end: int, w: np.ndarray
) -> None:
    """Apply reflector j, X -= scale v (v' X), to some columns of a matrix.

    Args:
        T: holds v in column j, from row j on, shape (n, ...).
        j: number of the reflector.
        n: its end.
        scale: 2 / |v|^2.
        target: X, changed, shape (n, ...).
        first, end: its columns, from first to before end.
        w: scratch, shape (end,).
    """
    for i in range(first, end):
        w[i] = 0.0
    for k in range(j, n):
        v = T[k, j]
        if v != 0.0:
            for i in range(first, end):
                w[i] += v * target[k, i]
    for k in range(j, n):
        v = scale * T[k, j]
        if v != 0.0:
            for i in range(first, end):
                target[k, i] -= v * w[i]


@inlined
def condense(H: np.ndarray, f: np.ndarray, equal: int, work: Workspace) -> bool:
    """Write the cost's factor, J and its least z, all in z; return False if the cost is not definite there.

    Args:
        H, f, equal, work: see `solve_qp`.
    """
    n, free = len(f), len(f) - equal
    basis, image, L, J, z = work.basis, work.image, work.factor, work.J, work.z
    for i in range(n):
        for j in range(1 + free):
            image[i, j] = 0.0
        image[i, 0] = f[i]
        for k in range(n):
            if H[i, k] != 0.0:
                for j in range(1 + free):
                    image[i, j] += H[i, k] * basis[k, j]
    for i in range(free):
        for j in range(free):
            L[i, j] = 0.0
        z[i] = 0.0
    for k in range(n):
        for i in range(free):
            z[i] -= basis[k, 1 + i] * image[k, 0]
            for j in range(i + 1):
                L[i, j] += basis[k, 1 + i] * image[k, 1 + j]
    return factorise(L, J, z, free)


@inlined
def factorise(L: np.ndarray, J: np.ndarray, z: np.ndarray, free: int) -> bool:
    """Factorise M = L L' in place, write J = L^-T and solve M z = z; return False if M is not positive definite.

    Args:
        L: lower triangle of M, then of L, shape (free, free) of it.
        J: written by columns: row c is column c of L^-T.
        z: right side, then solution.
        free: size.
    """
    for i in range(free):
        for j in range(i + 1):
            total = L[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif not (total > 0.0 and math.isfinite(total)):
                return False
            else:
                L[i, i] = math.sqrt(total)
    for c in range(free):  # row c of L^-1
        for j in range(free):
            J[c, j] = 0.0
        J[c, c] = 1.0
        for k in range(c):
            for j in range(k + 1):
                J[c, j] -= L[c, k] * J[k, j]
        for j in range(c + 1):
            J[c, j] /= L[c, c]
    for i in range(free):
        total = z[i]
        for k in range(i):
            total -= L[i, k] * z[k]
        z[i] = total / L[i, i]
    for back in range(free):
        i = free - 1 - back
        z[i] /= L[i, i]
        for k in range(i):
            z[k] -= L[i, k] * z[i]
    return True


@inlined
def write_row(A: np.ndarray, c: int, bounds: int, equal: int, work: Workspace) -> None:
    """Write inequality c in z: its value at x_0, then its coefficients.

    Args:
        A: shape (m, n).
        c: inequality: bounds of unknowns, then the rows of A after the equalities.
        bounds, equal, work: see `solve_qp`.
    """
    n = A.shape[1]
    columns = 1 + n - equal
    row, basis = work.rows, work.basis
    if c < bounds:
        for j in range(columns):
            row[c, j] = basis[c, j]
        return
    for j in range(columns):
        row[c, j] = 0.0
    for k in range(n):
        value = A[c - bounds + equal, k]
        if value != 0.0:
            for j in range(columns):
                row[c, j] += value * basis[k, j]


@inlined
def search(
    lower: np.ndarray, upper: np.ndarray, bounds: int, equal: int, free: int, count: int, work: Workspace
) -> int:
    """Move z to the minimum over the inequalities; return SOLVED, INFEASIBLE or STOPPED.

    Args:
        lower, upper, bounds, equal, work: see `solve_qp`.
        free: size of z.
        count: number of inequalities.
    """
    J, R, z, direction, d, r = work.J, work.R, work.z, work.direction, work.d, work.r
    rows, active, sign, u = work.rows, work.active, work.sign, work.u
    held, added, side, entering = 0, NONE, 0.0, 0.0
    for _ in range(STEPS):
        if added == NONE:
            added, side = find_violated(lower, upper, bounds, equal, free, count, work)
            if added == NONE:
                return SOLVED
            entering = 0.0
        bound = added if added < bounds else added + equal
        violation = rows[added, 0] - (lower[bound] if side > 0.0 else upper[bound])
        for j in range(free):
            violation += rows[added, 1 + j] * z[j]
        violation *= side
        inside, outside = 0.0, 0.0
        for c in range(free):
            total = 0.0
            for j in range(free):
                total += J[c, j] * rows[added, 1 + j]
            d[c] = side * total
            if c < held:
                inside += d[c] * d[c]
            else:
                outside += d[c] * d[c]
        for back in range(held):
            i = held - 1 - back
            total = d[i]
            for j in range(i + 1, held):
                total -= R[i, j] * r[j]
            r[i] = total / R[i, i]
        step, dropped = math.inf, NONE
        for i in range(held):
            if r[i] > 0.0 and u[i] < step * r[i]:
                step, dropped = u[i] / r[i], i
        independent = held < free and outside > DEPENDENT * DEPENDENT * (inside + outside)
        if independent and -violation <= step * outside:
            step, dropped = -violation / outside, NONE
        elif dropped == NONE:
            return INFEASIBLE
        if independent:
            for j in range(free):
                direction[j] = 0.0
            for c in range(held, free):
                for j in range(free):
                    direction[j] += J[c, j] * d[c]
            for j in range(free):
                z[j] += step * direction[j]
        for i in range(held):
            u[i] -= step * r[i]
        entering += step
        if dropped == NONE:
            add_row(J, R, d, held, free)
            active[held], sign[held], u[held] = added, side, entering
            held, added = held + 1, NONE
        else:
            held -= 1
            for i in range(dropped, held):
                active[i], sign[i], u[i] = active[i + 1], sign[i + 1], u[i + 1]
            drop_row(J, R, dropped, held, free)
    return STOPPED


@inlined
def find_violated(
    lower: np.ndarray, upper: np.ndarray, bounds: int, equal: int, free: int, count: int, work: Workspace
) -> tuple[int, float]:
    """Return the inequality that z violates most, and 1 for its lower bound or -1 for its upper; NONE if none is."""
    found, side, worst = NONE, 0.0, 0.0
    for c in range(count):
        bound = c if c < bounds else c + equal
        value = work.rows[c, 0]
        for j in range(free):
            value += work.rows[c, 1 + j] * work.z[j]
        below, above = lower[bound] - value, value - upper[bound]
        if below > worst and below > VIOLATED * (1.0 + abs(lower[bound])):
            found, side, worst = c, 1.0, below
        if above > worst and above > VIOLATED * (1.0 + abs(upper[bound])):
            found, side, worst = c, -1.0, above
    return found, side


@inlined
def add_row(J: np.ndarray, R: np.ndarray, d: np.ndarray, held: int, free: int) -> None:
    """Make a row active: turn J so that the row has no part in the free columns but the first, its part joins R.

    Args:
        J, R: changed.
        d: J' times the row, changed, shape (free,).
        held: number of active rows before.
        free: size of z.
    """
    for back in range(free - 1 - held):
        c = free - 1 - back
        if d[c] != 0.0:
            size = hypot(d[c - 1], d[c])
            turn(J, c - 1, d[c - 1] / size, d[c] / size, free)
            d[c - 1], d[c] = size, 0.0
    for i in range(held + 1):
        R[i, held] = d[i]


@inlined
def drop_row(J: np.ndarray, R: np.ndarray, dropped: int, held: int, free: int) -> None:
    """Take an active row out of R, and turn R back into a triangle, J with it.

    Args:
        J, R: changed.
        dropped: its place.
        held: number of active rows after.
        free: size of z.
    """
    for j in range(dropped, held):
        for i in range(j + 2):
            R[i, j] = R[i, j + 1]
    for j in range(dropped, held):
        size = hypot(R[j, j], R[j + 1, j])
        c, s = R[j, j] / size, R[j + 1, j] / size
        turn(J, j, c, s, free)
        for k in range(j, held):
            R[j, k], R[j + 1, k] = c * R[j, k] + s * R[j + 1, k], c * R[j + 1, k] - s * R[j, k]


@inlined
def turn(J: np.ndarray, i: int, c: float, s: float, free: int) -> None:
    """Turn rows i and i + 1 of a matrix by a Givens rotation."""
    for k in range(free):
        J[i, k], J[i + 1, k] = c * J[i, k] + s * J[i + 1, k], c * J[i + 1, k] - s * J[i, k]
