"""Binaries with values, and what follows from them: in groups, in rows of binaries, and from learned conflicts."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planners.alternative_rows import AlternativeRows, Group
from planners.mixed_integer import Affine

EXCESS = 1e-7  # by less than this a row of binaries counts as kept [its unit]
NOTHING = np.zeros(0, dtype=int), np.zeros(0)  # rows and amounts


@dataclass
class Undo:
    """Hold a binary that was fixed, and what its rows allowed before."""

    column: int
    rows: np.ndarray
    before: np.ndarray


class Implications:
    """Hold values of binaries; sets of levels of choices and sets of columns are integers, one bit for each.

    Args:
        rows: of the model.
    """

    def __init__(self, rows: AlternativeRows) -> None:
        self.rows = rows
        self.upper = rows.relaxed.copy()  # of the rows that are not of binaries alone
        self.values: dict[int, tuple[int, int]] = {}  # and the levels of the choices that they follow from
        self.ones = 0  # columns
        self.conflicts: dict[int, list[int]] = defaultdict(list)  # of a column: sets that are never all 1
        self.parts: dict[int, list[Group | Affine]] = defaultdict(list)
        for group in rows.groups:
            for i in (*group.members, *(() if group.when is None else (group.when,))):
                self.parts[i].append(group)
        for row in rows.logic:
            for i in row.coefficients:
                self.parts[i].append(row)
        self.waiting: deque[Group | Affine] = deque([*rows.groups, *rows.logic])

    def exclude(self, columns: Sequence[int]) -> None:
        """Remember that binaries are never all 1."""
        together = sum(1 << i for i in columns)
        for i in columns:
            self.conflicts[i].append(together)

    def fix(self, i: int, value: int, blamed: int, trail: list[Undo]) -> int | None:
        """Fix a binary.

        Args:
            i: its column.
            value: 0 or 1.
            blamed: levels of the choices that it follows from.
            trail: gets what is to be undone.

        Returns:
            The levels to blame if the other value follows from them; None: nothing is known to contradict it.
        """
        if i in self.values:
            return None if self.values[i][0] == value else blamed | self.values[i][1]
        self.values[i] = value, blamed
        rows, amounts = self.rows.tighter.get((i, value), NOTHING)
        trail.append(Undo(i, rows, self.upper[rows]))
        self.upper[rows] -= amounts
        self.ones |= value << i
        self.waiting.extend(self.parts[i])
        if value:
            for together in self.conflicts[i]:
                rest = together & ~self.ones
                if rest & (rest - 1):
                    continue
                others = together & ~rest
                if not rest:
                    return self.join(_list_bits(others))
                contradiction = self.fix(rest.bit_length() - 1, 0, self.join(_list_bits(others)), trail)
                if contradiction is not None:
                    return contradiction
        return None

    def undo(self, trail: list[Undo]) -> None:
        """Take back all of a trail, and forget what was still to be looked at."""
        self.waiting.clear()
        for undo in reversed(trail):
            value, _ = self.values.pop(undo.column)
            self.upper[undo.rows] = undo.before
            self.ones &= ~(value << undo.column)
        trail.clear()

    def propagate(self, trail: list[Undo]) -> int | None:
        """Fix what follows; returns the levels to blame if something follows both ways."""
        while self.waiting:
            part = self.waiting.popleft()
            blamed = self._visit_group(part, trail) if isinstance(part, Group) else self._visit_row(part, trail)
            if blamed is not None:
                return blamed
        return None

    def _visit_group(self, group: Group, trail: list[Undo]) -> int | None:
        values = self.values
        asked, blamed = (1, 0) if group.when is None else values.get(group.when, (0, 0))
        free = [i for i in group.members if i not in values]
        ones = [i for i in group.members if i in values and values[i][0]]
        if ones:
            for i in (*ones[1:], *free) if group.exact else ():
                contradiction = self.fix(i, 0, values[ones[0]][1], trail)
                if contradiction is not None:
                    return contradiction
            return None
        if len(free) + asked > 1 or (not asked and group.when in values):
            return None
        blamed |= self.join(i for i in group.members if i in values)
        if not free:
            return blamed if asked else self.fix(group.when, 0, blamed, trail)  # type: ignore[arg-type]
        return self.fix(free[0], 1, blamed, trail) if asked else None

    def _visit_row(self, row: Affine, trail: list[Undo]) -> int | None:
        least, blamed, free = row.constant, 0, []
        for i, c in row.coefficients.items():
            if i not in self.values:
                least += min(c, 0.0)
                free.append((i, c))
            else:
                value, follows = self.values[i]
                least += c * value
                blamed |= follows if value == (c > 0.0) else 0
        if least > EXCESS:
            return blamed
        for i, c in free:
            if least + abs(c) > EXCESS:
                self.fix(i, int(c < 0.0), blamed, trail)
        return None

    def join(self, columns: Iterable[int]) -> int:
        """Return the levels of the choices from which the values of binaries follow."""
        levels = 0
        for i in columns:
            levels |= self.values[i][1]
        return levels


def _list_bits(bits: int) -> Iterator[int]:
    while bits:
        yield bits.bit_length() - 1
        bits &= ~(1 << (bits.bit_length() - 1))
