"""Rows of a mixed-integer model by what they ask: of binaries alone, or of all else once binaries are chosen."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from planners.mixed_integer import Affine, Model
from planners.row_bounds import RowBounds


@dataclass(frozen=True)
class Group:
    """Hold binaries of which at least one must be 1.

    Args:
        members: their columns.
        when: binary without which this is not asked; None: always.
        exact: exactly one must be 1.
    """

    members: tuple[int, ...]
    when: int | None = None
    exact: bool = False


class AlternativeRows:
    """Hold a model's rows: what they ask of binaries alone, and of all else, with binaries at what relaxes them most.

    Args:
        model: the model.
    """

    def __init__(self, model: Model) -> None:
        self.integer = np.array(model.integer, dtype=bool)
        self.lower, self.upper = np.array(model.lower), np.array(model.upper)
        ends = np.concatenate([self.lower[self.integer], self.upper[self.integer]])
        if not np.isin(ends, (0.0, 1.0)).all():
            raise ValueError(f"{model.name}: an integer is no binary")
        self.groups: list[Group] = []
        self.logic: list[Affine] = []  # <= 0, of binaries alone
        mixed: list[Affine] = []
        equal: list[Affine] = []
        for row in model.inequalities:
            if self._is_logic(row):
                self._add_logic(row)
            else:
                mixed.append(row)
        for row in model.equalities:
            if self._is_logic(row):
                if row.constant == -1.0 and set(row.coefficients.values()) == {1.0}:
                    self.groups.append(Group(tuple(row.coefficients), exact=True))
                else:
                    self.logic += [row, -row]
            elif self.integer[list(row.coefficients)].any():
                mixed += [row, -row]
            else:
                equal.append(row)
        self._collect(model.name, mixed, equal)

    def _is_logic(self, row: Affine) -> bool:
        return bool(self.integer[list(row.coefficients)].all())

    def _add_logic(self, row: Affine) -> None:
        below = tuple(i for i, c in row.coefficients.items() if c == -1.0)
        above = [i for i, c in row.coefficients.items() if c == 1.0]
        if len(below) + len(above) == len(row.coefficients) and len(above) + row.constant == 1.0 and len(above) < 2:
            self.groups.append(Group(below, above[0] if above else None))
        else:
            self.logic.append(row)

    def _collect(self, name: str, mixed: Sequence[Affine], equal: Sequence[Affine]) -> None:
        """Split the rows into columns of the linear problem and what binaries do to them."""
        columns = np.cumsum(~self.integer) - 1
        entries: list[tuple[int, int, float]] = []
        self.binaries: list[dict[int, float]] = []  # of each row, with their coefficients
        tighter: dict[tuple[int, int], dict[int, float]] = defaultdict(dict)
        self.relaxed = np.array([-row.constant for row in mixed])
        for k, row in enumerate((*mixed, *equal)):
            self.binaries.append({i: c for i, c in row.coefficients.items() if self.integer[i] and c != 0.0})
            entries += [(k, columns[i], c) for i, c in row.coefficients.items() if not self.integer[i]]
            for i, c in self.binaries[-1].items():
                self.relaxed[k] -= min(c, 0.0)
                tighter[i, int(c > 0.0)][k] = abs(c)
        matrix = sparse.csr_matrix(
            ([c for *_, c in entries], ([k for k, *_ in entries], [i for _, i, _ in entries])),
            shape=(len(mixed) + len(equal), int((~self.integer).sum())),
        )
        # Column and value of a binary, to the rows that it tightens, and by how much.
        self.tighter = {key: (np.array(list(rows)), np.array(list(rows.values()))) for key, rows in tighter.items()}
        self.norms = np.maximum(np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel())[: len(mixed)], 1e-9)
        fixed = np.array([-row.constant for row in equal])
        box = self.lower[~self.integer], self.upper[~self.integer]
        self.problem = RowBounds(name, matrix, self.relaxed, fixed, box)


@dataclass
class Candidates:
    """Hold what choosing each member of each group would tighten.

    Args:
        groups: of the candidates.
        members: their columns.
        rows: that they tighten, one after another.
        amounts: by how much, in the same order, over the rows' norms.
        starts: where the rows of each candidate begin.
    """

    groups: list[int] = field(default_factory=list)
    members: list[int] = field(default_factory=list)
    rows: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    amounts: np.ndarray = field(default_factory=lambda: np.zeros(0))
    starts: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))


def list_candidates(rows: AlternativeRows) -> Candidates:
    """Return what each choice of a group's member would tighten; in an exact one all others are then 0.

    Args:
        rows: the model's.
    """
    found, where, amounts = Candidates(), [np.zeros(0, dtype=int)], [np.zeros(0)]
    for g, group in enumerate(rows.groups):
        for member in group.members:
            changes: dict[int, float] = defaultdict(float)
            rest = [(other, 0) for other in group.members if other != member] if group.exact else []
            for key in ((member, 1), *rest):
                for row, amount in zip(*rows.tighter.get(key, ((), ())), strict=True):
                    changes[int(row)] += float(amount) / rows.norms[int(row)]
            found.groups.append(g)
            found.members.append(member)
            # The last row stands for "none", so that every candidate has one.
            where.append(np.array([*changes, len(rows.norms)], dtype=int))
            amounts.append(np.array([*changes.values(), 0.0]))
    found.rows, found.amounts = np.concatenate(where), np.concatenate(amounts)
    found.starts = np.cumsum([len(part) for part in where[:-1]], dtype=int)
    return found
