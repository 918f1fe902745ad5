"""Trees of rows of which all or at least one must hold, written into a mixed-integer model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, TypeAlias, TypeVar

import numpy as np

from planners.errors import Infeasible
from planners.mixed_integer import Affine, Model

NOISE = 1e-9  # round-off of bounds and rows [their unit]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class AllOf(Generic[T]):
    """Hold trees of which all must hold; without any it always holds.

    Args:
        parts: rows (expressions that must not be positive) and further trees.
        marks: what their holding means, to be read from a solution.
    """

    parts: tuple[Tree[T], ...]
    marks: tuple[T, ...] = ()


@dataclass(frozen=True, eq=False)
class AnyOf(Generic[T]):
    """Hold trees of which at least one must hold; without any it never holds.

    Args:
        choices: rows and further trees, the preferred ones first.
    """

    choices: tuple[Tree[T], ...]


Tree: TypeAlias = Affine | float | AllOf[T] | AnyOf[T]


def require_tree(model: Model, tree: Tree[T], when: Affine | None = None) -> None:
    """Add a tree to a model: one binary per alternative, of which the rows are relaxed by interval big-M.

    Alternatives that the variable bounds exclude get no rows; if the bounds imply one, no row is added at all.

    Args:
        model: gets rows and binaries.
        tree: the tree.
        when: binary; the tree must hold where it is 1; None: it must hold in any case.

    Raises:
        Infeasible: the bounds exclude the tree.
    """
    if isinstance(tree, AllOf):
        for part in tree.parts:
            require_tree(model, part, when)
    elif isinstance(tree, AnyOf):
        _require_any(model, [part for choice in tree.choices for part in _open(choice)], when)
    elif when is not None:
        model.require(tree, 1.0 - when)
    elif _limits(model, tree)[0] > NOISE:
        raise _contradiction(model)
    else:
        model.require(tree)


def _require_any(model: Model, choices: list[Tree[T]], when: Affine | None) -> None:
    limits = [_limits(model, choice) for choice in choices]
    if any(high <= NOISE for _, high in limits):
        return
    possible = [choice for choice, (low, _) in zip(choices, limits, strict=True) if low <= NOISE]
    if not possible:
        if when is None:
            raise _contradiction(model)
        model.inequalities.append(when)
    elif len(possible) == 1:
        require_tree(model, possible[0], when)
    else:
        chosen = [model.binary() for _ in possible]
        model.inequalities.append((1.0 if when is None else when) - sum(chosen, Affine({})))
        for binary, choice in zip(chosen, possible, strict=True):
            require_tree(model, choice, binary)


def _contradiction(model: Model) -> Infeasible:
    return Infeasible(model.name, "a requirement contradicts the limits", "widen limits or areas")


def _open(tree: Tree[T]) -> Iterator[Tree[T]]:
    """Return the alternatives of a tree, flattened: a choice among choices needs no binaries of its own."""
    if isinstance(tree, AnyOf):
        for choice in tree.choices:
            yield from _open(choice)
        return
    inner = [part for part in tree.parts if isinstance(part, AnyOf)] if isinstance(tree, AllOf) else []
    if isinstance(tree, AllOf) and len(inner) == 1:
        rest = tuple(part for part in tree.parts if part is not inner[0])
        for choice in _open(inner[0]):
            yield AllOf((*rest, choice))
    else:
        yield tree


def _limits(model: Model, tree: Tree[T]) -> tuple[float, float]:
    """Return bounds of the violation of a tree: its worst row at the best choices."""
    if isinstance(tree, AllOf):
        ends = [_limits(model, part) for part in tree.parts]
        return max((low for low, _ in ends), default=-np.inf), max((high for _, high in ends), default=-np.inf)
    if isinstance(tree, AnyOf):
        ends = [_limits(model, choice) for choice in tree.choices]
        return min((low for low, _ in ends), default=np.inf), min((high for _, high in ends), default=np.inf)
    return model.limits(model.loosened(tree))


def compute_violation(tree: Tree[T], x: np.ndarray) -> float:
    """Return how much a point violates a tree: its worst row at the best choices; negative where it holds.

    Args:
        tree: the tree.
        x: the point, shape (n,).
    """
    if isinstance(tree, AllOf):
        return max((compute_violation(part, x) for part in tree.parts), default=-np.inf)
    if isinstance(tree, AnyOf):
        return min((compute_violation(choice, x) for choice in tree.choices), default=np.inf)
    return tree.value(x) if isinstance(tree, Affine) else float(tree)


def read_marks(tree: Tree[T], x: np.ndarray, tolerance: float) -> Iterator[T]:
    """Return the marks that hold at a point; of each choice, those of one alternative.

    Args:
        tree: a tree that holds.
        x: the point, shape (n,).
        tolerance: alternatives violated by less than this count as equally good [unit of the rows].

    Returns:
        Marks, parents first; of the first alternative that holds, or else of the least violated one.
    """
    if isinstance(tree, AllOf):
        yield from tree.marks
        for part in tree.parts:
            yield from read_marks(part, x, tolerance)
    elif isinstance(tree, AnyOf) and tree.choices:
        violations = np.maximum([compute_violation(choice, x) for choice in tree.choices], tolerance)
        yield from read_marks(tree.choices[int(np.argmin(violations))], x, tolerance)
