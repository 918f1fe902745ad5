"""Rows of the event grid for what a formula demands.

All motions are polylines on one grid of knots. A formula becomes a tree of rows by recursion: "it holds at all
instants of [s, e]", with s and e numbers or expressions. A state formula holds at an instant at a knot, at fixed
fractions of a piece (time and place are both linear there), or on a piece that contains the instant; and it holds
over a window if it does on every piece that the window meets.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from impact_envs.stl import Always, And, Eventually, Formula, Or, Predicate, Until
from planners.alternatives import AllOf, AnyOf, require_tree
from planners.free_flyer.specification.negation_normal_form import Release
from planners.free_flyer.specification.predicate_rows import (
    Grid,
    Mark,
    Node,
    Place,
    Time,
    Window,
    find_place,
    interpolate,
    make_predicate_rows,
    make_state_rows,
)
from planners.free_flyer.specification.requirement import Demands, Requirement
from planners.free_flyer.specification.selection import Choices
from planners.mixed_integer import Affine

FRACTIONS = (0.25, 0.5, 0.75)  # where on a piece an instant may lie, between events
BEFORE = 0.01  # [control periods]
WITNESSES = 12  # at most, of a temporal formula that has to come again and again


def add_demands(grid: Grid, demands: Demands, period: float, passing: bool, reserve: float = 0.0) -> Choices:
    r"""Add what the formula and solid obstacles demand to an event grid.

    Exact for the grid's motions: ``in`` and linear predicates in windows that begin and end at knots or with the
    horizon; conjunctions; F, until and disjunctions at an instant, with witnesses at the places above. Sound, and
    conservative as follows:

    - "not in" holds beyond one face per piece, "distance >=" along one of 8 directions per piece;
    - what holds in a window holds on all of every piece that meets it, or comes nearer than a control period;
    - F over a window of instants has witnesses at knots, fractions and during pieces; of a temporal formula, at
      12 instants at most, or else the formula holds all the time at one delay;
    - a disjunction over a window makes one choice per piece;
    - until comes to pass at once, or not within a control period; a release over a window has one instant of it.

    Args:
        grid: gets the rows.
        demands: demands.
        period: control period, by which a piece has to miss a window [s].
        passing: whether instants may lie between events.
        reserve: distance to keep from areas to avoid beyond the robustness [m].

    Returns:
        What reads the solution.

    Raises:
        Infeasible: the variable bounds alone exclude a demand.

    Source: Verhagen & Tumova, Eqs. (2), (21), (22).
    """
    encoder = _Encoder(grid, demands, period, passing, reserve)
    nodes = []
    for text, formula in demands.conjuncts.items():
        with grid.model.part(text, demands.largest):
            nodes.append(encoder.hold(formula, Window(0.0, 0.0, period, period)))
            require_tree(grid.model, nodes[-1])
    for need in demands.solids:
        nodes.append(encoder.hold_throughout(need, Window(need.start, need.end, period, period)))
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

    def hold(self, formula: Formula, window: Window) -> Node:
        """Return the rows of 'the formula holds at all instants of the window'."""
        if window.is_instant and not formula.is_temporal:
            return self._come(formula, window.start, window.start)
        match formula:
            case Predicate():
                return self.hold_throughout(self.demands.predicates[formula], window)
            case And(operands):
                return AllOf(tuple(self.hold(part, window) for part in _group(operands, window)))
            case Or(operands):
                return self._hold_any(operands, window)
            case Always((lower, upper), child):
                return self.hold(child, window.shifted(lower, upper))
            case Eventually((lower, upper), child):
                return self._eventually(child, window, lower, upper)[0]
            case Until((lower, upper), left, right):
                return self._until(left, right, window, lower, upper)
            case Release((lower, upper), left, right):
                return self._release(left, right, window, lower, upper)
        raise TypeError(f"{type(formula).__name__} is not in normal form")

    def hold_throughout(self, need: Requirement, window: Window) -> Node:
        """Return the rows of 'the predicate holds at all instants of the window'."""
        pieces = []
        for piece in range(self.grid.count):
            inside = make_predicate_rows(self.grid, need, ((piece, 0.0), (piece, 1.0)), self.reserve)
            outside = self._outside(window, piece)
            pieces.append(AnyOf((*outside, inside) if need.kind == "avoid" else (inside, *outside)))
        return AllOf(tuple(pieces), (Mark(need, ((window.start, window.end),), once=False),))

    def _outside(self, window: Window, piece: int) -> tuple[Node, ...]:
        """Return the alternatives 'piece ends before the window' and 'piece starts after it'."""
        times = self.grid.times
        return times[piece + 1] + window.lead - window.start, window.end + window.lag - times[piece]

    def _state(
        self, formula: Formula, places: tuple[Place, ...], windows: tuple[tuple[Time, Time], ...], once: bool = False
    ) -> Node:
        return make_state_rows(self.grid, self.demands.predicates, formula, places, windows, once, self.reserve)

    def _time(self, place: Place) -> Time:
        piece, fraction = place
        return interpolate(self.grid.times[piece], self.grid.times[piece + 1], fraction)

    # Instants

    def _come(self, formula: Formula, first: Time, last: Time) -> Node:
        """Return the rows of 'the state formula holds at some instant between first and last'."""
        grid = self.grid
        ends = {0.0: (0, 0.0), grid.times[-1]: (grid.count - 1, 1.0)}
        if first is last and not isinstance(first, Affine) and first in ends:
            return self._state(formula, (ends[first],), ((first, first),), once=True)
        choices: list[Node] = []
        # In a window of the whole horizon a piece comes down to its ends.
        early, late = (grid.model.limits(end)[1] <= 0.0 for end in (first, grid.times[-1] - last))
        knots_do = early and late and (self.passing or grid.pieces == 1)
        for piece in range(0 if knots_do else grid.count):
            between = grid.times[piece], grid.times[piece + 1]
            state = self._state(formula, ((piece, 0.0), (piece, 1.0)), ((first, last), between), once=True)
            choices.append(AllOf((between[0] - last, first - between[1], state)))
        for place in (*self._knots(), *self._passages(formula)):
            time = self._time(place)
            state = self._state(formula, (place,), ((time, time), (first, last)), once=True)
            choices.append(AllOf((first - time, time - last, state)))
        return AnyOf(tuple(choices))

    def _knots(self) -> list[Place]:
        count, step = self.grid.count, 1 if self.passing else self.grid.pieces
        return [(k, 0.0) if k < count else (k - 1, 1.0) for k in range(0, count + 1, step)]

    def _passages(self, formula: Formula) -> list[Place]:
        """Return fractions of pieces on which one of the formula's bodies moves."""
        pieces = range(self.grid.count if self.passing else 0)
        moving = [piece for piece in pieces if any(self._moves(body, piece) for body in formula.bodies())]
        return [(piece, fraction) for piece in moving for fraction in FRACTIONS]

    def _moves(self, body: str, piece: int) -> bool:
        here, there = (find_place(self.grid, body, (piece, end)) for end in (0.0, 1.0))
        if hasattr(here, "lower"):
            return True
        return any(self.grid.model.limits(step) != (0.0, 0.0) for step in there - here)

    def _instant(self, first: Time, last: Time) -> tuple[Affine, Node]:
        """Return a new instant between two others, with its rows."""
        model = self.grid.model
        low, high = model.limits(0.0)[0], model.limits(self.grid.times[-1])[1]
        if not model.elastic:
            # In an elastic model the rows may give way, so the bounds must not be in their stead.
            low, high = max(low, model.limits(first)[0]), min(high, model.limits(last)[1])
        # Where no instant is left, neither of the rows can hold.
        instant = model.variable(min(low, high), high, rigid=True)
        self.instants.append(instant)
        return instant, AllOf((first - instant, instant - last))

    # Operators

    def _hold_any(self, operands: tuple[Formula, ...], window: Window) -> Node:
        """Return one choice at an instant; over a window one per piece, between switches at knots."""
        if window.is_instant:
            return AnyOf(tuple(self.hold(part, window) for part in operands))
        pieces: list[Node] = []
        if not any(part.is_temporal for part in operands):
            for piece in range(self.grid.count):
                windows = (window.start, window.end), (self.grid.times[piece], self.grid.times[piece + 1])
                inside = self._state(Or(operands), ((piece, 0.0), (piece, 1.0)), windows)
                pieces.append(AnyOf((inside, *self._outside(window, piece))))
            return AllOf(tuple(pieces))
        switch: Time = window.start
        for piece in range(self.grid.count):
            last = piece == self.grid.count - 1
            part = Window(switch, window.end if last else self._instant(window.start, window.end)[0], 0.0, 0.0)
            choices = [self._on_piece(operand, piece, part) for operand in operands]
            pieces.append(AnyOf((part.end - part.start, *choices)))
            switch = part.end
        return AllOf(tuple(pieces))

    def _on_piece(self, formula: Formula, piece: int, part: Window) -> Node:
        """Return the rows of 'the formula holds between two switches'; a state formula's are on one piece."""
        if formula.is_temporal:
            return self.hold(formula, part)
        times = self.grid.times
        state = self._state(formula, ((piece, 0.0), (piece, 1.0)), ((part.start, part.end),))
        return AllOf((times[piece] - part.start, part.end - times[piece + 1], state))

    def _eventually(
        self, child: Formula, window: Window, lower: float, upper: float, timed: bool = False
    ) -> tuple[Node, Time]:
        """Return the rows of F[lower,upper] over a window, and if it is `timed` the last instant they rely on."""
        if lower == upper:
            later = window.shifted(lower, upper)
            return self.hold(child, later), later.end
        if not window.is_instant:
            return (self._repeat if child.is_temporal else self._recur)(child, window, lower, upper)
        first, last = window.start + lower, window.start + upper
        if isinstance(child, Or) and child.is_temporal and not timed:
            each = (Eventually((lower, upper), part) for part in child.operands)
            return AnyOf(tuple(self.hold(part, window) for part in each)), last
        if not child.is_temporal and not timed:
            return self._come(child, first, last), last
        instant, rows = self._instant(first, last)
        return AllOf((rows, self.hold(child, self._at(instant)))), instant

    def _at(self, instant: Affine) -> Window:
        return Window(instant, instant, self.period, self.period)

    def _recur(self, child: Formula, window: Window, lower: float, upper: float) -> tuple[Node, Time]:
        """Return the rows of 'from every instant of the window on, a state formula comes', place by place.

        Each place may be a witness: it then has to begin in time, counted from the latest witness before it.
        """
        span = upper - lower
        # At least one witness is needed, even if the window shrinks to an instant.
        short = self.grid.model.limits(window.end - window.start)[0] <= 0.0
        latest: Time = window.start + lower - (BEFORE * self.period if short else 0.0)
        earliest = self.grid.model.limits(latest)[0]
        nodes: list[Node] = []
        for places in self._witnesses(child):
            begin, end = self._time(places[0]), self._time(places[-1])
            now = self.grid.model.variable(earliest, self.grid.model.limits(self.grid.times[-1])[1], rigid=True)
            self.instants.append(now)
            state = self._state(child, places, ((begin, end),), once=len(places) == 1)
            nodes.append(AnyOf((now - latest, AllOf((begin - latest - span, begin - now, now - end, state)))))
            latest = now
        return AllOf((*nodes, window.end + lower - latest)), latest

    def _witnesses(self, formula: Formula) -> Iterator[tuple[Place, ...]]:
        """Return knots, places between them and pieces, in the order of their times."""
        knots, passages = self._knots(), self._passages(formula)
        for piece in range(self.grid.count):
            yield from ((place,) for place in (*knots, *passages) if place[0] == piece and place[1] < 1.0)
            yield (piece, 0.0), (piece, 1.0)
        yield ((self.grid.count - 1, 1.0),)

    def _repeat(self, child: Formula, window: Window, lower: float, upper: float) -> tuple[Node, Time]:
        """Return the rows of 'from every instant of the window on, a temporal formula comes', one by one."""
        span = upper - lower
        longest = self.grid.model.limits(window.end - window.start)[1]
        count = int(np.ceil(longest / span - 1e-9)) + 1
        if count > WITNESSES:
            delay = self.grid.model.variable(lower, upper, rigid=True)
            later = Window(window.start + delay, window.end + delay, self.period, self.period)
            return self.hold(child, later), later.end
        nodes: list[Node] = []
        first, last = window.start + lower, window.start + upper
        for _ in range(count):
            instant, rows = self._instant(first, last)
            nodes += [rows, self.hold(child, self._at(instant))]
            first, last = instant, instant + span
        return AllOf((*nodes, window.end + lower - instant)), instant

    def _until(self, left: Formula, right: Formula, window: Window, lower: float, upper: float) -> Node:
        """Return the rows of 'right comes, and left holds up to then'."""
        comes, last = self._eventually(right, window, lower, upper, timed=True)
        until = AllOf((comes, self._hold_up_to(left, window.start, last, window.lead)))
        if window.is_instant and lower == 0.0:
            return AnyOf((self.hold(And((left, right)), window), until))
        return until

    def _hold_up_to(self, formula: Formula, first: Time, last: Time, lead: float) -> Node:
        """Return the rows of 'the formula holds from first to last', at least a control period later.

        A piece that starts at the last instant need not hold, for the one before does; so there must be one.
        """
        return AllOf((first + self.period - last, self.hold(formula, Window(first, last, lead, 0.0))))

    def _release(self, left: Formula, right: Formula, window: Window, lower: float, upper: float) -> Node:
        """Return the choice: `right` in all the interval, or until an instant at which `left` holds."""
        first, last = window.start + lower, window.start + upper
        choices = [self.hold(right, window.shifted(lower, upper))]
        for begin, end, held in ((window.end, first, False), (first, last, True)):
            instant, rows = self._instant(begin, end)
            parts = [rows, window.end - instant, self.hold(left, self._at(instant))]
            if held:
                parts.append(self._hold_up_to(right, first, instant, window.lead))
            choices.append(AllOf(tuple(parts)))
        return AnyOf(tuple(choices))


def _group(operands: tuple[Formula, ...], window: Window) -> Iterator[Formula]:
    """Return operands of a conjunction; state formulas at an instant go together, for they share its place."""
    state = tuple(part for part in operands if not part.is_temporal) if window.is_instant else ()
    if len(state) > 1:
        yield And(state)
    yield from (part for part in operands if len(state) < 2 or part not in state)
