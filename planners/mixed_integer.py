"""Mixed-integer linear models written row by row, with interval big-M; `planners.solvers` solves them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from planners.errors import Infeasible


class Affine:
    """Hold an affine expression sum_i c_i x_i + constant of model variables."""

    __slots__ = ("coefficients", "constant")

    def __init__(self, coefficients: dict[int, float], constant: float = 0.0) -> None:
        self.coefficients = coefficients
        self.constant = constant

    def __add__(self, other: Affine | float) -> Affine:
        if not isinstance(other, Affine):
            return Affine(self.coefficients, self.constant + float(other))
        total = dict(self.coefficients)
        for i, c in other.coefficients.items():
            total[i] = total.get(i, 0.0) + c
        return Affine(total, self.constant + other.constant)

    def __mul__(self, factor: float) -> Affine:
        factor = float(factor)
        if factor == 1.0:
            return self
        return Affine({i: c * factor for i, c in self.coefficients.items()}, self.constant * factor)

    def __neg__(self) -> Affine:
        return Affine({i: -c for i, c in self.coefficients.items()}, -self.constant)

    # Not a sum with -1 times the other: models have tens of thousands of differences, and this takes half as long.
    def __sub__(self, other: Affine | float) -> Affine:
        if not isinstance(other, Affine):
            return Affine(self.coefficients, self.constant - float(other))
        total = dict(self.coefficients)
        for i, c in other.coefficients.items():
            total[i] = total.get(i, 0.0) - c
        return Affine(total, self.constant - other.constant)

    def __rsub__(self, other: float) -> Affine:
        return Affine({i: -c for i, c in self.coefficients.items()}, float(other) - self.constant)

    __radd__, __rmul__ = __add__, __mul__

    def value(self, x: np.ndarray) -> float:
        """Return the expression's value at a point, shape (n,)."""
        return self.constant + sum(c * x[i] for i, c in self.coefficients.items())


def evaluate(expressions: object, x: np.ndarray) -> np.ndarray:
    """Return the values of nested expressions and numbers at a point.

    Args:
        expressions: Affine, number, or nested sequence of them.
        x: the point, shape (n,).

    Returns:
        Values, in the shape of the expressions.
    """
    array = np.array(expressions, dtype=object)
    flat = [entry.value(x) if isinstance(entry, Affine) else float(entry) for entry in array.flat]
    return np.array(flat).reshape(array.shape)


def stack(expressions: Sequence[Affine], size: int) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Return A, shape (m, size), and c, shape (m,), with expressions = A x + c."""
    indptr = np.cumsum([0, *(len(e.coefficients) for e in expressions)])
    columns = [i for e in expressions for i in e.coefficients]
    data = [c for e in expressions for c in e.coefficients.values()]
    constants = np.array([e.constant for e in expressions])
    return sparse.csr_matrix((data, columns, indptr), shape=(len(expressions), size)), constants


@dataclass(frozen=True)
class Solution:
    """Hold what a solver returned.

    Args:
        x: the point, shape (n,).
        objective: its objective, to be minimised.
        bound: proven lower bound of the objective.
    """

    x: np.ndarray
    objective: float
    bound: float


@dataclass
class Model:
    """Collect variables, rows and a linear objective to be minimised.

    Args:
        name: what failures call the problem.
        elastic: rows of a named part may be violated by the slack variable of the part.
    """

    name: str
    elastic: bool = False
    lower: list[float] = field(default_factory=list)
    upper: list[float] = field(default_factory=list)
    integer: list[bool] = field(default_factory=list)
    inequalities: list[Affine] = field(default_factory=list)
    equalities: list[Affine] = field(default_factory=list)
    objective: Affine = field(default_factory=lambda: Affine({}))
    slacks: dict[str, Affine] = field(default_factory=dict)
    rigid: set[int] = field(default_factory=set)
    _slack: Affine | None = None

    @contextmanager
    def part(self, name: str, largest: float) -> Iterator[None]:
        """Name the rows added inside; in an elastic model they share one slack variable that loosens them all.

        Args:
            name: of the part, as the user knows it; a name that is used again continues its part.
            largest: greatest slack [unit of the rows].
        """
        outer = self._slack
        if self.elastic:
            if name not in self.slacks:
                self.slacks[name] = self.variable(0.0, largest)
            self._slack = self.slacks[name]
        try:
            yield
        finally:
            self._slack = outer

    def variable(self, lower: float, upper: float, integer: bool = False, rigid: bool = False) -> Affine:
        """Add a variable between finite bounds and return it as an expression; rows of rigid ones get no slack."""
        if rigid:
            self.rigid.add(len(self.lower))
        self.lower.append(float(lower))
        self.upper.append(float(upper))
        self.integer.append(integer)
        return Affine({len(self.lower) - 1: 1.0})

    def binary(self) -> Affine:
        """Add a variable that is 0 or 1."""
        return self.variable(0.0, 1.0, integer=True)

    def vector(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Add one variable per entry of the bounds; returns an object array of their shape."""
        return np.array([self.variable(a, b) for a, b in zip(lower, upper, strict=True)], dtype=object)

    def limits(self, expression: Affine | float) -> tuple[float, float]:
        """Return the interval of an expression over the bounds of its variables."""
        if not isinstance(expression, Affine):
            return float(expression), float(expression)
        low = high = expression.constant
        lower, upper = self.lower, self.upper
        for i, c in expression.coefficients.items():
            if c > 0:
                low += c * lower[i]
                high += c * upper[i]
            else:
                low += c * upper[i]
                high += c * lower[i]
        return low, high

    def require(self, expression: Affine | float, unless: Affine | float = 0.0) -> None:
        """Add the row expression <= M * unless, where M is the largest value the expression can take.

        The row binds where `unless` is 0; it is left out if the variable bounds imply it.

        Args:
            expression: what must not be positive.
            unless: 0 where the row must hold, at least 1 where it must not bind.

        Raises:
            Infeasible: the row cannot hold and nothing relaxes it.
        """
        self._require(self.loosened(expression), unless)

    def loosened(self, expression: Affine | float) -> Affine | float:
        """Return the expression that `require` bounds: in an elastic model, less the slack of the current part."""
        if self._slack is None or (isinstance(expression, Affine) and self.rigid.issuperset(expression.coefficients)):
            return expression
        return expression - self._slack

    def _require(self, expression: Affine | float, unless: Affine | float) -> None:
        low, high = self.limits(expression)
        if high <= 1e-12 or self.limits(unless)[0] >= 1.0:
            return
        row = expression - unless * high
        if isinstance(row, Affine) and row.coefficients:
            self.inequalities.append(row)
        elif low > 1e-9:
            raise Infeasible(self.name, "a requirement contradicts the limits", "widen limits or areas")

    def require_any(self, alternatives: Sequence[Sequence[Affine | float]]) -> None:
        """Add the rows of at least one of several alternatives, each a list of expressions <= 0.

        Alternatives that the variable bounds exclude are dropped; nothing is added if the bounds imply one.

        Args:
            alternatives: lists of expressions that must not be positive.

        Raises:
            Infeasible: the bounds exclude every alternative.
        """
        possible = []
        for rows in [[self.loosened(row) for row in rows] for rows in alternatives]:
            limits = [self.limits(row) for row in rows]
            if all(high <= 1e-9 for _, high in limits):
                return
            if all(low <= 1e-9 for low, _ in limits):
                possible.append(rows)
        if not possible:
            raise Infeasible(self.name, "a requirement contradicts the limits", "widen limits or areas")
        if len(possible) == 1:
            for row in possible[0]:
                self._require(row, 0.0)
            return
        chosen = [self.binary() for _ in possible]
        self.inequalities.append(1.0 - sum(chosen, Affine({})))
        for choice, rows in zip(chosen, possible, strict=True):
            for row in rows:
                self._require(row, 1.0 - choice)

    def require_equal(self, expression: Affine) -> None:
        """Add the row expression = 0."""
        self.equalities.append(expression)

    def rows(self) -> tuple[sparse.csr_matrix, np.ndarray, np.ndarray]:
        """Return all rows as low <= A x <= high; the equalities come last."""
        matrix, constants = stack([*self.inequalities, *self.equalities], len(self.lower))
        high = -constants
        low = np.concatenate([np.full(len(self.inequalities), -np.inf), high[len(self.inequalities) :]])
        return matrix, low, high
