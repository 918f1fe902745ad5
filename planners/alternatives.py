"""Trees of rows of which all or at least one must hold, written into a mixed-integer model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, TypeAlias, TypeVar

import numpy as np

from planners.errors import Infeasible
from planners.mixed_integer import Affine, Model

NOISE = 1e-9  # of bounds and rows, in their unit
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class AllOf(Generic[T]):
    """Hold nodes of which all must hold; nothing holds always.

    Args:
        parts: rows (expressions that must not be positive) and further nodes.
        marks: what it means that they hold, for whoever reads a solution.
    """

    parts: tuple[Node[T], ...]
    marks: tuple[T, ...] = ()


@dataclass(frozen=True, eq=False)
class AnyOf(Generic[T]):
    """Hold nodes of which at least one must hold; nothing holds never.

    Args:
        choices: rows and further nodes, the preferred ones first.
    """

    choices: tuple[Node[T], ...]


Node: TypeAlias = Affine | float | AllOf[T] | AnyOf[T]


def require_tree(model: Model, node: Node[T], when: Affine | None = None) -> None:
    """Add a tree to a model: one binary per alternative, of which the rows are relaxed by interval big-M.

    Alternatives that the variable bounds exclude are left out; nothing is added where the bounds imply one.

    Args:
        model: gets rows and binaries.
        node: the tree.
        when: binary at 1 of which the tree must hold; None: it must hold in any case.

    Raises:
        Infeasible: the bounds exclude the tree.
    """
    if isinstance(node, AllOf):
        for part in node.parts:
            require_tree(model, part, when)
    elif isinstance(node, AnyOf):
        _require_any(model, [part for choice in node.choices for part in _open(choice)], when)
    elif when is not None:
        model.require(node, 1.0 - when)
    elif _limits(model, node)[0] > NOISE:
        raise _contradiction(model)
    else:
        model.require(node)


def _require_any(model: Model, choices: list[Node[T]], when: Affine | None) -> None:
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


def _open(node: Node[T]) -> Iterator[Node[T]]:
    """Return the alternatives of a node: a choice among choices needs no binaries of its own."""
    if isinstance(node, AnyOf):
        for choice in node.choices:
            yield from _open(choice)
        return
    inner = [part for part in node.parts if isinstance(part, AnyOf)] if isinstance(node, AllOf) else []
    if isinstance(node, AllOf) and len(inner) == 1:
        rest = tuple(part for part in node.parts if part is not inner[0])
        for choice in _open(inner[0]):
            yield AllOf((*rest, choice))
    else:
        yield node


def _limits(model: Model, node: Node[T]) -> tuple[float, float]:
    """Return bounds of how much the worst row of a node, at the best choices, exceeds zero."""
    if isinstance(node, AllOf):
        ends = [_limits(model, part) for part in node.parts]
        return max((low for low, _ in ends), default=-np.inf), max((high for _, high in ends), default=-np.inf)
    if isinstance(node, AnyOf):
        ends = [_limits(model, choice) for choice in node.choices]
        return min((low for low, _ in ends), default=np.inf), min((high for _, high in ends), default=np.inf)
    return model.limits(model.loosened(node))


def compute_violation(node: Node[T], x: np.ndarray) -> float:
    """Return by how much a point violates a tree: its worst row at the best choices; negative where it holds.

    Args:
        node: the tree.
        x: the point, shape (n,).
    """
    if isinstance(node, AllOf):
        return max((compute_violation(part, x) for part in node.parts), default=-np.inf)
    if isinstance(node, AnyOf):
        return min((compute_violation(choice, x) for choice in node.choices), default=np.inf)
    return node.value(x) if isinstance(node, Affine) else float(node)


def read_marks(node: Node[T], x: np.ndarray, tolerance: float) -> Iterator[T]:
    """Return the marks of nodes that hold at a point, of one alternative of each choice.

    Args:
        node: a tree that holds.
        x: the point, shape (n,).
        tolerance: an alternative violated by no more than this is as good as any.

    Returns:
        Marks, parents first, of the first alternative that holds, or of the one that is violated least.
    """
    if isinstance(node, AllOf):
        yield from node.marks
        for part in node.parts:
            yield from read_marks(part, x, tolerance)
    elif isinstance(node, AnyOf) and node.choices:
        violations = np.maximum([compute_violation(choice, x) for choice in node.choices], tolerance)
        yield from read_marks(node.choices[int(np.argmin(violations))], x, tolerance)
