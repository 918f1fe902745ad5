"""Formulas to flat arrays, from which compiled functions follow their robustness in many worlds (code.py)."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.stl import alternation, joined
from impact_envs.stl import compiled_formula as tables
from impact_envs.stl.compiled_formula import CompiledFormula
from impact_envs.stl.formula import Formula
from impact_envs.stl.margin import TIE, AreaLike, Margin, Range, combine_ranges, mark_tie
from impact_envs.stl.term import (
    Combination,
    Operator,
    Pick,
    Term,
    compute_range,
    find_join,
    is_state,
    join_states,
    list_operands,
    make_term,
    other,
    split_operators,
)

LONGEST = 2**31 - 1  # samples, the greatest int32


def compile_formula(
    formula: Formula,
    period: float,
    areas: Mapping[str, AreaLike],
    bodies: Sequence[str],
    signals: Sequence[str],
    bounds: Mapping[str, Range] | None = None,
) -> CompiledFormula:
    """Make the arrays that follow a formula.

    Args:
        formula: specification.
        period: between samples [s].
        areas: regions and obstacles by name.
        bodies: what ``all`` stands for.
        signals: names in the order of the sample.
        bounds: signals to intervals known beforehand, as for ``Monitor``.

    Raises:
        FormulaError: an unknown area, an interval without a sample, or an operator without an online form.
        InputError: a period that is not positive, bounds that are empty, a signal the formula needs and the
            sample has not, or a formula that looks too far ahead.
    """
    if not 0 < period < math.inf:
        raise InputError(f"monitor: period {period} s must be finite and positive")
    for name, (low, high) in (bounds or {}).items():
        if not low <= high:
            raise InputError(f"monitor: bounds [{low:g}, {high:g}] of signal '{name}' are empty")
    parts, formula = formula.conjuncts(), formula.expand(bodies)
    for name in formula.signals():
        if name not in signals:
            raise InputError(f"monitor: signal '{name}' is missing; {choices(name, signals)}")
    reach = formula.reach(period)
    if reach > LONGEST:
        raise InputError(f"monitor: the formula looks {reach} samples ahead; at most {LONGEST} are possible")
    builder = _Builder(bounds or {}, signals)
    terms = [split_operators(make_term(part.expand(bodies), period, areas)) for part in parts]
    builder.add_root(split_operators(make_term(formula, period, areas)), terms)
    return builder.finish()


def read_parts(compiled: CompiledFormula, memory: np.ndarray) -> np.ndarray:
    """Return the intervals of robustness still possible of the root's temporal operators.

    Args:
        compiled: formula.
        memory: of N worlds, shape (N, ``compiled.size``).

    Returns:
        Lower and upper ends, shape (N, operators, 2).
    """
    count = int(np.sum(~np.isin(compiled.root[:, tables.KIND], (tables.PUSH, tables.POP))))
    found = memory[:, : 2 * count].reshape(len(memory), count, 2)
    return np.where(np.abs(found) <= TIE, 0.0, found)


def describe_parts(
    formula: Formula, period: float, areas: Mapping[str, AreaLike], bodies: Sequence[str]
) -> tuple[str, ...]:
    """Return what each of the root's temporal operators is, in the order of `read_parts`.

    Args:
        formula, period, areas, bodies: see `compile_formula`.
    """
    term = split_operators(make_term(formula.expand(tuple(bodies)), period, areas))
    leaves = [part[-1] for part in _list_steps(term, len(formula.conjuncts()))]
    return tuple(_describe(leaf, period) for leaf in leaves if leaf is not None)


def _describe(term: Term, period: float) -> str:
    signals = ", ".join(dict.fromkeys(_list_signals(term)))
    if not isinstance(term, Operator):
        return f"at time 0, of {signals}"
    name = ("always", "eventually") if len(term.children) == 1 else ("not until", "until")
    return f"{name[_pick(term.pick)]}[{term.first * period:g},{term.last * period:g}] of {signals}"


def _list_signals(term: Term) -> Iterator[str]:
    if isinstance(term, Combination | Operator):
        for child in term.children:
            yield from _list_signals(child)
    else:
        yield from term.encode()[1]


@dataclass
class _Node:
    """A row of ``CompiledFormula.nodes`` in the making.

    Attributes:
        earliest, reach: first and last sample that a value at instant 0 depends on.
        start, end: instants at which the value is needed.
        oldest: how far behind the present sample the value is still read.
    """

    kind: int
    pick: Pick
    first: int
    last: int
    left: int
    right: int
    range: Range
    earliest: int = 0
    reach: int = 0
    start: int = LONGEST
    end: int = -1
    oldest: int = 0

    def need(self, start: int, end: int, oldest: int) -> None:
        self.start, self.end = min(self.start, start), max(self.end, end)
        self.oldest = max(self.oldest, oldest)


class _Builder:
    def __init__(self, bounds: Mapping[str, Range], signals: Sequence[str]) -> None:
        self.bounds = bounds
        self.column_of = {name: column for column, name in enumerate(signals)}
        self.root: list[list[int]] = []
        self.conjuncts: list[int] = []  # the number of each row's
        self.nodes: list[_Node] = []
        self.starts, self.columns = [0], list[int]()
        self.code: list[list[int]] = []
        self.numbers: list[float] = []
        self.size = 0
        self._known: dict[Hashable, int] = {}  # nodes, states and scratch memory, to have each once

    def add_root(self, term: Term, conjuncts: Sequence[Term]) -> None:
        """Append the rows of a whole formula.

        Args:
            term: of the formula.
            conjuncts: terms whose least it is, in order.
        """
        self.conjuncts = [number for number, rows in enumerate(_count_rows(term, conjuncts)) for _ in range(rows)]
        rows = _list_steps(term, len(conjuncts))
        self._allocate(2 * sum(leaf is not None for *_, leaf in rows))  # their intervals, see read_parts
        for kind, how, depth, leaf in rows:
            if leaf is None:
                self.root.append([kind, how, 0, 0, 0, 0, 0, self._scratch("root", depth, 2)])
            else:  # what is no operator is about the first sample
                self._add_operator(how, leaf if isinstance(leaf, Operator) else Operator(max, 0, 0, (leaf,)))

    def _add_operator(self, how: int, term: Operator) -> None:
        """Append an operator of the root: over states, an alternation, a join or nodes."""
        children, until = term.children, len(term.children) == 2
        inner, join = _find_alternation(term), find_join(term)
        more = [number for operator in inner for number in (operator.first, operator.last)]
        unseen = 0
        if all(map(is_state, children)):
            kind = tables.UNTIL if until else tables.EXTREME
            operands = [self._add_state(child) for child in children]
            unseen = self._add_numbers(compute_range(term, self.bounds))
            size = len(children)
        elif inner:
            kind = tables.TWOFOLD if len(inner) == 1 else tables.THREEFOLD
            operands = [self._add_state(inner[-1].children[0])]
            unseen = self._add_numbers(compute_range(term, self.bounds))
            size = alternation.compute_size([operator.last - operator.first + 1 for operator in inner])
        elif join:
            kind, operator, ends = tables.JOINED, join.operator, joined.find_ends(term.pick, join)
            states = [children[0] if until else None, operator.children[-1]]
            states += [operator.children[0] if len(operator.children) == 2 else None, join.lower, join.upper]
            left, right, *others = (self._add_state(state) if state else -1 for state in states)
            operands = [left, right]
            unseen = self._add_numbers([*compute_range(term, self.bounds), *compute_range(operator, self.bounds)])
            size = joined.compute_size(operator.first, operator.last, ends)
            more = [operator.first, operator.last, 0, 0, _pick(operator.pick), *others, ends]
        else:
            kind = tables.OPEN_UNTIL if until else tables.OPEN_EXTREME
            operands = [self._add_node(child) for child in children]
            reach = max(self.nodes[node].reach for node in operands)
            self.nodes[operands[0]].need(0 if until else term.first, term.last, reach)
            self.nodes[operands[-1]].need(term.first, term.last, reach)
            size = len(children)
        row = [term.first, term.last, operands[0], operands[-1], self._allocate(size), unseen]
        self.root.append([kind, how, _pick(term.pick), *row, *more])

    def _add_node(self, term: Term) -> int:
        """Return the node of a term."""
        if is_state(term):
            state = self._add_state(term)
            return self._make_node(_Node(tables.STATE_NODE, max, 0, 0, state, state, compute_range(term, self.bounds)))
        if isinstance(term, Operator):
            nodes = [self._add_node(child) for child in term.children]
            if len(nodes) == 2:
                return self._add_until(term.pick, term.first, term.last, *nodes)
            return self._join(tables.EXTREME_NODE, term.pick, term.first, term.last, nodes[0], nodes[0])
        assert isinstance(term, Combination)
        nodes = [self._add_node(part) for part in join_states(term)]
        return reduce(lambda a, b: self._join(tables.JOIN_NODE, term.pick, 0, 0, a, b), nodes)

    def _add_until(self, pick: Pick, first: int, last: int, left: int, right: int) -> int:
        """Return the node of p U[a,b] q = G[0,a] p and F[a,a] (p U[0,b-a] q); the second part is one node."""
        until = self._join(tables.UNTIL_NODE, pick, first, last, left, right)
        if first == 0:
            return until
        held = self._join(tables.EXTREME_NODE, other(pick), 0, first, left, left)
        return self._join(tables.JOIN_NODE, other(pick), 0, 0, held, until)

    def _join(self, kind: int, pick: Pick, first: int, last: int, left: int, right: int) -> int:
        children = [self.nodes[left], self.nodes[right]]
        gather = other(pick) if kind == tables.UNTIL_NODE else pick
        ends = combine_ranges(gather, [child.range for child in children])
        node = _Node(kind, pick, first, last, left, right, ends)
        node.earliest = first + min(child.earliest for child in children)
        node.reach = last + max(child.reach for child in children)
        return self._make_node(node)

    def _make_node(self, node: _Node) -> int:
        key = ("node", node.kind, node.pick, node.first, node.last, node.left, node.right)
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(node)
        return self._known[key]

    def _add_state(self, term: Term) -> int:
        """Return the place in ``starts`` of a term without temporal operators."""
        if ("state", term) not in self._known:
            self._known["state", term] = len(self.starts) - 1
            for kind, how, depth, leaf in _linearise(term, lambda part: not isinstance(part, Combination)):
                assert not isinstance(leaf, Combination | Operator)
                if leaf is None:
                    self.code.append([kind, how, 0, self._scratch("state", depth, 1), 0])
                else:
                    self._add_predicate(how, leaf)
            self.starts.append(len(self.code))
        return self._known["state", term]

    def _add_predicate(self, how: int, margin: Margin) -> None:
        kind, names, numbers, count = margin.encode()
        column = len(self.columns)
        self.columns += (self.column_of[name] for name in names)
        self.code.append([kind, how, column, self._add_numbers((mark_tie(0.0, margin.strict), *numbers)), count])

    def _add_numbers(self, numbers: Sequence[float]) -> int:
        self.numbers += numbers
        return len(self.numbers) - len(numbers)

    def _allocate(self, size: int) -> int:
        self.size += size
        return self.size - size

    def _scratch(self, user: str, depth: int, size: int) -> int:
        if (user, depth) not in self._known:
            self._known[user, depth] = self._allocate(size)
        return self._known[user, depth]

    def finish(self) -> CompiledFormula:
        """Return the arrays."""
        for node in reversed(self.nodes):
            if node.kind != tables.STATE_NODE:
                for child in (node.left, node.right):
                    window = node.start + node.first, node.end + node.last
                    self.nodes[child].need(*window, node.reach - node.first)
        rows = [self._finish_node(node) for node in self.nodes]
        root = _table(self.root, tables.CONJUNCT + 1)
        root[:, tables.CONJUNCT] = self.conjuncts
        return CompiledFormula(
            root,
            _table(rows, tables.STRIDE + 1),
            np.array(self.starts, np.int32),
            _table(self.code, tables.COUNT + 1),
            np.array(self.columns, np.int32),
            np.array(self.numbers, np.float64),
            self.size,
        )

    def _finish_node(self, node: _Node) -> list[int]:
        """Return a node's row; the length of its ring is a power of two, so that places are found by masking."""
        stride = 1 if node.kind == tables.STATE_NODE else 2
        length = min(node.oldest - node.earliest, node.end - node.start) + 1
        length = 1 << (length - 1).bit_length()
        slot, unseen = self._allocate(stride * length), self._add_numbers(node.range)
        head = [node.kind, 0, _pick(node.pick), node.first, node.last, node.left, node.right, slot, unseen]
        return [*head, node.earliest, node.reach, node.start, node.end, length - 1, stride]


def _count_rows(term: Term, conjuncts: Sequence[Term]) -> list[int]:
    """Return how many of the root's rows each conjunct has, see `_Builder.add_root`."""
    steps = [len(list(_linearise(part, _is_leaf))) for part in list_operands(term, min)]
    if len(conjuncts) == 1:
        return [len(_list_steps(term, 1))]
    # What is no leaf stands in brackets, except where it is the first.
    rows = [count + 2 * (count > 1 and place > 0) for place, count in enumerate(steps)]
    ends = np.cumsum([0, *(len(list_operands(part, min)) for part in conjuncts)]).tolist()
    return [sum(rows[start:end]) for start, end in pairwise(ends)]


def _list_steps(term: Term, conjuncts: int) -> list[tuple[int, int, int, Term | None]]:
    """Return the steps of the root; conjuncts without temporal operators are not joined to one."""
    return list(_linearise(term, lambda part: _is_leaf(part) and (part is not term or conjuncts == 1)))


def _is_leaf(term: Term) -> bool:
    """Return whether the root's rows have no part of a term: it is an operator, or has none inside."""
    return is_state(term) or isinstance(term, Operator)


def _find_alternation(term: Operator) -> tuple[Operator, ...]:
    """Return the one or two operators inside one that alternate with it over a state; none if it is no alternation."""
    found, innermost = list[Operator](), term
    while len(innermost.children) == 1 and isinstance(innermost.children[0], Operator):
        innermost = innermost.children[0]
        found.append(innermost)
    over_state = len(innermost.children) == 1 and is_state(innermost.children[0])
    return tuple(found) if over_state and len(found) <= 2 else ()


def _linearise(
    term: Term, is_leaf: Callable[[Term], bool], depth: int = 0
) -> Iterator[tuple[int, int, int, Term | None]]:
    """Yield the steps of a Boolean combination: kind, how it joins, depth of brackets, and the leaf if it is one."""
    if is_leaf(term):
        yield -1, tables.SET, depth, term
        return
    assert isinstance(term, Combination)
    yield from _linearise(term.children[0], is_leaf, depth)
    how = _pick(term.pick)
    for child in term.children[1:]:
        if is_leaf(child):
            yield -1, how, depth, child
        else:
            yield tables.PUSH, tables.SET, depth, None
            yield from _linearise(child, is_leaf, depth + 1)
            yield tables.POP, how, depth, None


def _pick(pick: Pick) -> int:
    return tables.MAX if pick is max else tables.MIN


def _table(rows: list[list[int]], width: int) -> np.ndarray:
    return np.array([row + [0] * (width - len(row)) for row in rows], np.int32).reshape(-1, width)
