"""Whether a mixed-integer model has a solution: alternatives are chosen one by one, with linear problems in between.

A row that binds only where binaries say so has a big M, and a linear relaxation makes little of it. Here such a row is
left out until the binaries that relax it are chosen, and then holds in full. A choice is made of an alternative that
the present point violates. Where no point is left, the rows that contradict each other name the choices to blame: those
alone are learned as excluded together, and choices that are not to blame are not tried otherwise.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planners.alternative_rows import AlternativeRows, Group, list_candidates
from planners.budget import read_clock
from planners.errors import Infeasible, SolverFailed
from planners.implications import Implications, Undo
from planners.mixed_integer import Model

VIOLATED = 1e-7  # by more than this a point violates a row [its unit, over the row's norm]
EXCESS = 1e-7  # what a contradiction keeps when choices that it can do without are taken from it [unit of its rows]
RANK = 2  # of binaries for which none is given
FIRST = 10  # alternatives of this rank and above are chosen even if no point violates them


@dataclass(frozen=True)
class RefutationOptions:
    """Choose how far a solution is looked for, or refuted, by linear problems alone.

    Args:
        problems: greatest number of linear problems.
        growth: by which a later conflict counts more than the one before it when the next choice is made.
        longest: number of choices of a conflict that is remembered; longer ones hardly ever exclude anything.
    """

    problems: int = 4000
    growth: float = 1.2
    longest: int = 8


def choose_alternatives(
    model: Model, ranks: Mapping[int, int], options: RefutationOptions, time_limit: float
) -> np.ndarray | None:
    """Return the binaries of a solution of a model without objective, whose integers are binaries.

    Args:
        model: the model.
        ranks: column of a binary to its rank, 2 where none is given: of the alternatives that a point violates, one of
            the highest rank is chosen first.
        options: how far it goes.
        time_limit: by the clock of limits [s].

    Returns:
        A point with the binaries, zero in all else, shape (n,); None: neither found nor refuted within the limits.

    Raises:
        Infeasible: proven to have no solution.
    """
    search = _Search(model, ranks, options, read_clock() + time_limit)
    try:
        search.refute(0)
    except _SolutionFound as found:
        return found.point
    except SolverFailed:
        return None
    raise Infeasible(model.name, "proven infeasible", "relax the formula, the limits or the horizon")


class _SolutionFound(Exception):
    def __init__(self, point: np.ndarray) -> None:
        super().__init__()
        self.point = point


class _Search:
    """Choose depth first; sets of levels of choices and sets of columns are integers, one bit for each.

    Args:
        model: the model.
        ranks: as for `choose_alternatives`.
        options: how far it goes.
        end: when it gives up, by the clock of limits [s].
    """

    def __init__(self, model: Model, ranks: Mapping[int, int], options: RefutationOptions, end: float) -> None:
        self.name, self.options, self.end = model.name, options, end
        self.rows = rows = AlternativeRows(model)
        self.candidates = list_candidates(rows)
        self.known = Implications(rows)
        self.values = self.known.values
        self.chosen: list[int] = []  # by level
        self.blame = np.zeros(len(rows.groups))
        self.step = 1.0
        self.solved = 0
        self.ranks = [ranks.get(group.members[0], RANK) if group.members else RANK for group in rows.groups]
        self.members = [range(0)] * len(rows.groups)
        for c, g in enumerate(self.candidates.groups):
            self.members[g] = range(self.members[g].start if len(self.members[g]) else c, c + 1)
        self.group_of = {i: g for g, group in enumerate(rows.groups) for i in group.members}
        for i in np.flatnonzero(rows.integer & (rows.lower == rows.upper)):
            self.known.fix(int(i), int(rows.lower[i]), 0, [])

    def refute(self, level: int) -> int:
        """Return the levels of choices that contradict each other, among those made so far.

        Args:
            level: number of choices made.

        Raises:
            _SolutionFound: they do not, and neither do all further ones that it made.
            SolverFailed: a limit is reached.
        """
        trail: list[Undo] = []
        try:
            blamed = self.known.propagate(trail)
            if blamed is not None:
                return blamed
            point = self._find_point()
            if point is None:
                return self._learn(self._explain())
            missed = self._measure(point)
            g = self._pick_group(missed)
            if g is None:
                raise _SolutionFound(self._complete())
            group, mine = self.rows.groups[g], list(self.members[g])
            # What the point violates most is refuted soonest, and tells the others what to avoid.
            order = sorted(range(len(mine)), key=lambda k: -missed[mine[k]])
            return self._try_members(group, [group.members[k] for k in order], level, trail)
        finally:
            self.known.undo(trail)

    def _try_members(self, group: Group, members: Sequence[int], level: int, trail: list[Undo]) -> int:
        bit, total = 1 << level, 0
        if group.when is not None:
            total |= self.values[group.when][1]
        for i in members:
            if i in self.values:
                value, follows = self.values[i]
                if value:
                    return self.refute(level)
                total |= follows
                continue
            blamed = self._try(i, level)
            if not blamed & bit:
                return blamed
            total |= blamed & ~bit
            self.known.fix(i, 0, blamed & ~bit, trail)
            contradiction = self.known.propagate(trail)
            if contradiction is not None:
                return contradiction
        return self._learn(total)

    def _try(self, i: int, level: int) -> int:
        """Return the levels to blame where a binary is chosen to be 1."""
        tried: list[Undo] = []
        self.chosen.append(i)
        try:
            blamed = self.known.fix(i, 1, 1 << level, tried)
            return self.refute(level + 1) if blamed is None else blamed
        finally:
            self.chosen.pop()
            self.known.undo(tried)

    def _find_point(self) -> np.ndarray | None:
        self.solved += 1
        if self.solved > self.options.problems or read_clock() > self.end:
            raise SolverFailed(self.name, "neither a solution nor a proof that there is none", "raise the limits")
        return self.rows.problem.find_point(self.known.upper)

    def _complete(self) -> np.ndarray:
        """Return all binaries, of which those that nothing asks for are 0."""
        trail: list[Undo] = []
        try:
            for i in np.flatnonzero(self.rows.integer):
                if int(i) not in self.values and self.known.fix(int(i), 0, 0, trail) is not None:
                    raise SolverFailed(
                        self.name, "binaries that no group asks for contradict each other", "ask for them"
                    )
            if self.known.propagate(trail) is not None or self._find_point() is None:
                raise SolverFailed(self.name, "binaries that no group asks for are not all 0", "ask for them")
            x = np.zeros(len(self.rows.integer))
            for column, (value, _) in self.values.items():
                x[column] = value
            return x
        finally:
            self.known.undo(trail)

    # Choices

    def _measure(self, point: np.ndarray) -> np.ndarray:
        """Return how much a point violates the rows of each candidate, over their norms."""
        found, rows = self.candidates, self.rows
        beyond = (rows.problem.matrix @ point)[: len(rows.norms)] - self.known.upper
        return np.maximum.reduceat(np.append(beyond / rows.norms, 0.0)[found.rows] + found.amounts, found.starts)

    def _pick_group(self, missed: np.ndarray) -> int | None:
        """Return the group to choose from: violated, of high rank, and to blame for the last conflicts."""
        best: tuple[tuple[bool, bool, int, float, float], int] | None = None
        for g, group in enumerate(self.rows.groups):
            if group.when is not None and not self.values.get(group.when, (0,))[0]:
                continue
            values = [self.values.get(i, (None,))[0] for i in group.members]
            if 1 in values:
                continue
            least = min(missed[c] for c, value in zip(self.members[g], values, strict=True) if value is None)
            violated, blame = bool(least > VIOLATED), self.blame[g]
            key = (self.ranks[g] >= FIRST, violated, self.ranks[g], blame if violated else 0.0, float(least))
            if best is None or key > best[0]:
                best = key, g
        return None if best is None else best[1]

    def _explain(self) -> int:
        """Return the levels whose choices contradict each other, by the rows that do; spare the last ones first."""
        weights, excess = self.rows.problem.find_contradiction()
        if excess <= EXCESS:
            return self.known.join(self.values)
        needed: dict[int, float] = defaultdict(float)
        for k in np.flatnonzero(weights):
            for i, c in self.rows.binaries[k].items():
                if i in self.values and self.values[i][0] == (c > 0.0):
                    needed[i] += float(weights[k]) * abs(c)
        blamed = 0
        for i in sorted(needed, key=lambda i: -self.values[i][1].bit_length()):
            if excess - needed[i] > EXCESS:
                excess -= needed[i]
            else:
                blamed |= self.values[i][1]
        return blamed

    def _learn(self, blamed: int) -> int:
        """Remember which choices exclude each other, and whose groups they are."""
        columns = [i for level, i in enumerate(self.chosen) if blamed >> level & 1]
        for i in columns:
            self.blame[self.group_of[i]] += self.step
        self.step *= self.options.growth
        if self.step > 1e100:
            self.blame /= self.step
            self.step = 1.0
        if len(columns) <= self.options.longest:
            self.known.exclude(columns)
        return blamed
