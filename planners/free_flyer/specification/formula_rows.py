"""Rows of the event grid for what a formula demands.

All motions are polylines on one grid of knots. By recursion a formula becomes a tree of rows that say "it holds at all
instants of [s, e]", where s and e are numbers or expressions. A state formula holds at an instant if it holds at a knot
at that time, at a fixed fraction of a piece (where time and place are both linear), or on a whole piece that contains
the instant. It holds over a window if it holds on every piece that the window meets.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from impact_envs.stl import Always, And, Eventually, Formula, Or, Predicate, Until
from planners.alternatives import AllOf, AnyOf, require_tree
from planners.errors import SolverFailed
from planners.free_flyer.specification.grid import Grid, Place, Time, find_place, interpolate
from planners.free_flyer.specification.negation_normal_form import Release
from planners.free_flyer.specification.predicate_rows import (
    Mark,
    MarkedTree,
    TimeWindow,
    make_predicate_rows,
    make_state_rows,
)
from planners.free_flyer.specification.requirement import Demands, Requirement
from planners.free_flyer.specification.selection import Choices
from planners.mixed_integer import Affine

FRACTIONS = (0.25, 0.5, 0.75)  # of a piece, where an instant may lie between knots
BEFORE = 0.01  # time before a window at which no witness has come yet [control periods]
MOST_PARTS = 500  # of a formula unfolded over instants: each operator nested may multiply them
WITNESSES = 12  # greatest number for a temporal formula that has to hold again and again


def add_demands(grid: Grid, demands: Demands, period: float, passing: bool, reserve: float = 0.0) -> Choices:
    r"""Add what the formula and solid obstacles demand to an event grid.

    Exact for the grid's motions: ``in`` and linear predicates in windows that begin and end at knots or at the ends of
    the horizon; conjunctions; F, until and disjunctions at an instant, with witnesses at the places above. The rest is
    sound, but conservative:

    - "not in" holds beyond one face per piece, "distance >=" along one of 8 directions per piece;
    - what holds in a window holds on the whole of every piece that meets it, or comes within a control period of it;
    - F over a window of instants has its witnesses at knots, at fractions of pieces and during pieces. If its operand
      is a temporal formula, it has at most 12 instants as witnesses, or else one delay that serves all instants;
    - a disjunction over a window makes one choice per piece;
    - the right side of until comes at once, or at least a control period later; a release over a window has one
      instant for the whole window.

    Args:
        grid: gets the rows.
        demands: demands.
        period: control period; a piece is outside a window only if it misses it by this time [s].
        passing: whether instants may lie between events.
        reserve: distance to keep from areas to avoid, in addition to the robustness [m].

    Returns:
        The alternatives, to be read from a solution.

    Raises:
        Infeasible: the variable bounds alone exclude a demand.
        SolverFailed: the formula unfolds into too many parts.

    Source: Verhagen & Tumova, Eqs. (2), (21), (22).
    """
    encoder = _Encoder(grid, demands, period, passing, reserve)
    nodes = []
    for text, formula in demands.conjuncts.items():
        with grid.model.part(text, demands.largest):
            nodes.append(encoder.encode(formula, TimeWindow(0.0, 0.0, period, period)))
            require_tree(grid.model, nodes[-1])
    for need in demands.solids:
        nodes.append(encoder.encode_predicate(need, TimeWindow(need.start, need.end, period, period)))
        require_tree(grid.model, nodes[-1])
    return Choices(grid, tuple(nodes), tuple(encoder.instants), period)


@dataclass
class _Encoder:
    """Build the tree of a formula in normal form; arguments as for `add_demands`."""

    grid: Grid
    demands: Demands
    period: float
    passing: bool
    reserve: float
    instants: list[Affine] = field(default_factory=list)
    parts: int = 0  # encoded so far

    def encode(self, formula: Formula, window: TimeWindow) -> MarkedTree:
        """Return the rows of 'the formula holds at all instants of the window'."""
        self.parts += 1
        if self.parts > MOST_PARTS:
            raise SolverFailed(
                "rows of the formula",
                f"it unfolds into more than {MOST_PARTS} parts",
                "nest fewer temporal operators within each other",
            )
        if window.is_instant and not formula.is_temporal:
            return self._encode_once(formula, window.start, window.start)
        match formula:
            case Predicate():
                return self.encode_predicate(self.demands.predicates[formula], window)
            case And(operands):
                return AllOf(tuple(self.encode(part, window) for part in _group(operands, window)))
            case Or(operands):
                return self._encode_any(operands, window)
            case Always((lower, upper), child):
                return self.encode(child, window.shifted(lower, upper))
            case Eventually((lower, upper), child):
                return self._encode_eventually(child, window, lower, upper)[0]
            case Until((lower, upper), left, right):
                return self._encode_until(left, right, window, lower, upper)
            case Release((lower, upper), left, right):
                return self._encode_release(left, right, window, lower, upper)
        raise TypeError(f"{type(formula).__name__} is not in normal form")

    def encode_predicate(self, need: Requirement, window: TimeWindow) -> MarkedTree:
        """Return the rows of 'the predicate holds at all instants of the window'."""
        pieces = []
        for piece in range(self.grid.count):
            inside = make_predicate_rows(self.grid, need, ((piece, 0.0), (piece, 1.0)), self.reserve)
            outside = self._miss_window(window, piece)
            pieces.append(AnyOf((*outside, inside) if need.kind == "avoid" else (inside, *outside)))
        return AllOf(tuple(pieces), (Mark(need, ((window.start, window.end),), once=False),))

    def _miss_window(self, window: TimeWindow, piece: int) -> tuple[MarkedTree, ...]:
        """Return the alternatives 'piece ends before the window' and 'piece starts after it'."""
        times = self.grid.times
        return times[piece + 1] + window.lead - window.start, window.end + window.lag - times[piece]

    def _make_state(
        self, formula: Formula, places: tuple[Place, ...], windows: tuple[tuple[Time, Time], ...], once: bool = False
    ) -> MarkedTree:
        return make_state_rows(self.grid, self.demands.predicates, formula, places, windows, once, self.reserve)

    def _find_time(self, place: Place) -> Time:
        piece, fraction = place
        return interpolate(self.grid.times[piece], self.grid.times[piece + 1], fraction)

    # Instants

    def _encode_once(self, formula: Formula, first: Time, last: Time) -> MarkedTree:
        """Return the rows of 'the state formula holds at an instant between first and last'."""
        grid = self.grid
        ends = {0.0: (0, 0.0), grid.times[-1]: (grid.count - 1, 1.0)}
        if first is last and not isinstance(first, Affine) and first in ends:
            return self._make_state(formula, (ends[first],), ((first, first),), once=True)
        choices: list[MarkedTree] = []
        # In a window of the whole horizon a witness on a piece is no better than one at its ends.
        early, late = (grid.model.limits(end)[1] <= 0.0 for end in (first, grid.times[-1] - last))
        knots_do = early and late and (self.passing or grid.pieces == 1)
        for piece in range(0 if knots_do else grid.count):
            between = grid.times[piece], grid.times[piece + 1]
            state = self._make_state(formula, ((piece, 0.0), (piece, 1.0)), ((first, last), between), once=True)
            choices.append(AllOf((between[0] - last, first - between[1], state)))
        for place in (*self._list_knots(), *self._list_passages(formula)):
            time = self._find_time(place)
            state = self._make_state(formula, (place,), ((time, time), (first, last)), once=True)
            choices.append(AllOf((first - time, time - last, state)))
        return AnyOf(tuple(choices))

    def _list_knots(self) -> list[Place]:
        count, step = self.grid.count, 1 if self.passing else self.grid.pieces
        return [(k, 0.0) if k < count else (k - 1, 1.0) for k in range(0, count + 1, step)]

    def _list_passages(self, formula: Formula) -> list[Place]:
        """Return the fractions of those pieces on which one of the formula's bodies moves."""
        pieces = range(self.grid.count if self.passing else 0)
        moving = [piece for piece in pieces if any(self._moves(body, piece) for body in formula.bodies())]
        return [(piece, fraction) for piece in moving for fraction in FRACTIONS]

    def _moves(self, body: str, piece: int) -> bool:
        here, there = (find_place(self.grid, body, (piece, end)) for end in (0.0, 1.0))
        if hasattr(here, "lower"):
            return True
        return any(self.grid.model.limits(step) != (0.0, 0.0) for step in there - here)

    def _add_instant(self, first: Time, last: Time) -> tuple[Affine, MarkedTree]:
        """Return a new instant between two others, with its rows."""
        model = self.grid.model
        low, high = model.limits(0.0)[0], model.limits(self.grid.times[-1])[1]
        if not model.elastic:
            # In an elastic model the rows can be violated at a price, so bounds must not replace them.
            low, high = max(low, model.limits(first)[0]), min(high, model.limits(last)[1])
        # If no instant is left, neither of the rows can hold.
        instant = model.variable(min(low, high), high, rigid=True)
        self.instants.append(instant)
        return instant, AllOf((first - instant, instant - last))

    # Operators

    def _encode_any(self, operands: tuple[Formula, ...], window: TimeWindow) -> MarkedTree:
        """Return the rows of a disjunction: one choice at an instant; over a window one per piece, between switches."""
        if window.is_instant:
            return AnyOf(tuple(self.encode(part, window) for part in operands))
        pieces: list[MarkedTree] = []
        if not any(part.is_temporal for part in operands):
            for piece in range(self.grid.count):
                windows = (window.start, window.end), (self.grid.times[piece], self.grid.times[piece + 1])
                inside = self._make_state(Or(operands), ((piece, 0.0), (piece, 1.0)), windows)
                pieces.append(AnyOf((inside, *self._miss_window(window, piece))))
            return AllOf(tuple(pieces))
        switch: Time = window.start
        for piece in range(self.grid.count):
            last = piece == self.grid.count - 1
            part = TimeWindow(switch, window.end if last else self._add_instant(window.start, window.end)[0], 0.0, 0.0)
            choices = [self._encode_on_piece(operand, piece, part) for operand in operands]
            pieces.append(AnyOf((part.end - part.start, *choices)))
            switch = part.end
        return AllOf(tuple(pieces))

    def _encode_on_piece(self, formula: Formula, piece: int, part: TimeWindow) -> MarkedTree:
        """Return the rows of 'the formula holds between two switches'; a state formula holds there on one piece."""
        if formula.is_temporal:
            return self.encode(formula, part)
        times = self.grid.times
        state = self._make_state(formula, ((piece, 0.0), (piece, 1.0)), ((part.start, part.end),))
        return AllOf((times[piece] - part.start, part.end - times[piece + 1], state))

    def _encode_eventually(
        self, child: Formula, window: TimeWindow, lower: float, upper: float, timed: bool = False
    ) -> tuple[MarkedTree, Time]:
        """Return the rows of F[lower,upper] over a window, and, if `timed`, the last instant they rely on."""
        if lower == upper:
            later = window.shifted(lower, upper)
            return self.encode(child, later), later.end
        if not window.is_instant:
            return (self._encode_recurrence if not child.is_temporal else self._encode_repetition)(
                child, window, lower, upper
            )
        first, last = window.start + lower, window.start + upper
        if isinstance(child, Or) and child.is_temporal and not timed:
            each = (Eventually((lower, upper), part) for part in child.operands)
            return AnyOf(tuple(self.encode(part, window) for part in each)), last
        if not child.is_temporal and not timed:
            return self._encode_once(child, first, last), last
        instant, rows = self._add_instant(first, last)
        return AllOf((rows, self.encode(child, self._at(instant)))), instant

    def _at(self, instant: Affine) -> TimeWindow:
        return TimeWindow(instant, instant, self.period, self.period)

    def _encode_recurrence(
        self, child: Formula, window: TimeWindow, lower: float, upper: float
    ) -> tuple[MarkedTree, Time]:
        """Return the rows of 'from every instant of the window on, a state formula holds in time', place by place.

        Each place may be a witness; then it has to begin in time after the witness before it.
        """
        span = upper - lower
        # One witness is needed even if the window shrinks to an instant.
        short = self.grid.model.limits(window.end - window.start)[0] <= 0.0
        latest: Time = window.start + lower - (BEFORE * self.period if short else 0.0)
        earliest = self.grid.model.limits(latest)[0]
        nodes: list[MarkedTree] = []
        for places in self._list_witnesses(child):
            begin, end = self._find_time(places[0]), self._find_time(places[-1])
            now = self.grid.model.variable(earliest, self.grid.model.limits(self.grid.times[-1])[1], rigid=True)
            self.instants.append(now)
            state = self._make_state(child, places, ((begin, end),), once=len(places) == 1)
            nodes.append(AnyOf((now - latest, AllOf((begin - latest - span, begin - now, now - end, state)))))
            latest = now
        return AllOf((*nodes, window.end + lower - latest)), latest

    def _list_witnesses(self, formula: Formula) -> Iterator[tuple[Place, ...]]:
        """Return knots, places between them and pieces, in the order of their times."""
        knots, passages = self._list_knots(), self._list_passages(formula)
        for piece in range(self.grid.count):
            yield from ((place,) for place in (*knots, *passages) if place[0] == piece and place[1] < 1.0)
            yield (piece, 0.0), (piece, 1.0)
        yield ((self.grid.count - 1, 1.0),)

    def _encode_repetition(
        self, child: Formula, window: TimeWindow, lower: float, upper: float
    ) -> tuple[MarkedTree, Time]:
        """Return the rows of 'from every instant of the window on, a temporal formula holds in time', one by one."""
        span = upper - lower
        longest = self.grid.model.limits(window.end - window.start)[1]
        count = int(np.ceil(longest / span - 1e-9)) + 1
        if count > WITNESSES:
            delay = self.grid.model.variable(lower, upper, rigid=True)
            later = TimeWindow(window.start + delay, window.end + delay, self.period, self.period)
            return self.encode(child, later), later.end
        nodes: list[MarkedTree] = []
        first, last = window.start + lower, window.start + upper
        for _ in range(count):
            instant, rows = self._add_instant(first, last)
            nodes += [rows, self.encode(child, self._at(instant))]
            first, last = instant, instant + span
        return AllOf((*nodes, window.end + lower - instant)), instant

    def _encode_until(
        self, left: Formula, right: Formula, window: TimeWindow, lower: float, upper: float
    ) -> MarkedTree:
        """Return the rows of 'right holds at an instant, and left holds until then'."""
        comes, last = self._encode_eventually(right, window, lower, upper, timed=True)
        until = AllOf((comes, self._encode_up_to(left, window.start, last, window.lead)))
        if window.is_instant and lower == 0.0:
            return AnyOf((self.encode(And((left, right)), window), until))
        return until

    def _encode_up_to(self, formula: Formula, first: Time, last: Time, lead: float) -> MarkedTree:
        """Return the rows of 'the formula holds from first to last', where last is a control period later or more.

        A piece that starts at the last instant is free, for the piece before it holds; so there must be one.
        """
        return AllOf((first + self.period - last, self.encode(formula, TimeWindow(first, last, lead, 0.0))))

    def _encode_release(
        self, left: Formula, right: Formula, window: TimeWindow, lower: float, upper: float
    ) -> MarkedTree:
        """Return the choice: `right` holds in the whole interval, or until an instant at which `left` holds."""
        first, last = window.start + lower, window.start + upper
        choices = [self.encode(right, window.shifted(lower, upper))]
        for begin, end, held in ((window.end, first, False), (first, last, True)):
            instant, rows = self._add_instant(begin, end)
            parts = [rows, window.end - instant, self.encode(left, self._at(instant))]
            if held:
                parts.append(self._encode_up_to(right, first, instant, window.lead))
            choices.append(AllOf(tuple(parts)))
        return AnyOf(tuple(choices))


def _group(operands: tuple[Formula, ...], window: TimeWindow) -> Iterator[Formula]:
    """Return the operands of a conjunction; at an instant its state formulas become one, for they share its place."""
    state = tuple(part for part in operands if not part.is_temporal) if window.is_instant else ()
    if len(state) > 1:
        yield And(state)
    yield from (part for part in operands if len(state) < 2 or part not in state)
