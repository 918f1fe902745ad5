"""Proven bounds of a formula's robustness over continuous time, and its robustness at the samples.

Over continuous time always and eventually take infimum and supremum over all instants of their intervals. Where a
signal jumps, as velocities do at impacts, both sides count, the worse one where a single instant is asked about.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import (
    Always,
    And,
    Eventually,
    Formula,
    Implies,
    Not,
    Or,
    Trace,
    Until,
    robustness,
)
from planners.free_flyer.certificate.claim import Claim
from planners.free_flyer.certificate.polynomial import Range
from planners.free_flyer.certificate.search import Effort, find_minimum
from planners.free_flyer.certificate.state_formula import make_leaf, negate_bounds, pick_bounds
from planners.free_flyer.certificate.track import Cell, Track, find_value, list_cells, make_track

Interval = tuple[Fraction, Fraction]
# Of the least of a value between two times; a third number is an upper bound of it that is known from elsewhere.
Bound = Callable[[Fraction, Fraction, Fraction | None], Range]


def compute_sampled_robustness(signals: Mapping[str, Track], scenario: FreeFlyerScenario) -> float:
    """Return the robustness at the control periods, from exact samples rounded to float64.

    Args:
        signals: of all bodies, such as ``pop.x``.
        scenario: with the formula.
    """
    formula = scenario.specification.expand(scenario.bodies)
    step = Fraction(scenario.horizon) / scenario.steps
    instants = [step * k for k in range(scenario.steps + 1)]
    samples = {name: _sample(signals[name], instants) for name in formula.signals()}
    return float(robustness(formula, Trace(samples, float(step), scenario.areas, scenario.bodies)))


def bound_robustness(signals: Mapping[str, Track], scenario: FreeFlyerScenario, effort: Effort) -> Range:
    """Return proven bounds of the robustness over continuous time.

    Args:
        signals: of all bodies, such as ``pop.x``.
        scenario: with formula and areas.
        effort: how far the bounds are refined.
    """
    formula = scenario.specification.expand(scenario.bodies)
    horizon = Fraction(scenario.horizon)
    return _Bounding(signals, scenario, horizon, effort).bound(formula, (Fraction(0), Fraction(0)), 1)


def make_signals(claim: Claim, scenario: FreeFlyerScenario) -> dict[str, Track]:
    """Return the signals that a formula may speak of; headings of discs turn as at the start.

    Args:
        claim: of a plan for the scenario.
        scenario: with headings and rates.
    """
    signals: dict[str, Track] = {}
    ends = Fraction(0), claim.horizon
    for name, motion in claim.paths.items():
        body = scenario.body(name)
        heading, rate = Fraction(body.heading), Fraction(body.start_rate)
        turned = make_track(ends, [(heading, heading + rate * claim.horizon)])
        tracks = {"x": motion.x, "y": motion.y, "vx": motion.vx, "vy": motion.vy}
        tracks |= {"heading": turned, "omega": make_track(ends, [(rate,)])}
        signals |= {f"{name}.{signal}": track for signal, track in tracks.items()}
    return signals


def _sample(track: Track, instants: Sequence[Fraction]) -> np.ndarray:
    last = track[-1].end
    return np.array([float(find_value(track, time, after=time < last)) for time in instants])


@dataclass(frozen=True)
class _Bounding:
    """Bounds of the least of sign times robustness over an interval: of a formula (1) or its negation (-1)."""

    signals: Mapping[str, Track]
    scenario: FreeFlyerScenario
    horizon: Fraction
    effort: Effort

    def bound(self, formula: Formula, interval: Interval, sign: int) -> Range:
        """Return bounds of the least of sign * rho over an interval of time [s]."""
        all_hold = (And, Always) if sign > 0 else (Or, Eventually)
        match formula:
            case Not(child):
                return self.bound(child, interval, -sign)
            case Implies():
                return self.bound(formula.define(), interval, sign)
            case And(operands) | Or(operands) if isinstance(formula, all_hold):
                return pick_bounds(min, [self.bound(operand, interval, sign) for operand in operands])
            case _ if not formula.is_temporal:
                return self._bound_state(formula, interval, sign)
            case And(operands) | Or(operands):
                return self._halve(lambda *part: self._bound_best(operands, part[:2], sign, part[2]), interval)
            case Always(window, child) | Eventually(window, child) if isinstance(formula, all_hold) or _is_instant(
                window
            ):
                return self.bound(child, self._shift(interval, window), sign)
            case Always(window, child) | Eventually(window, child):
                return self._halve(lambda *part: self._bound_some(child, part[:2], window, sign), interval)
            case Until():
                if sign < 0:
                    return negate_bounds(self._bound_most_until(formula, interval))
                return self._halve(lambda *part: self._bound_until(formula, part[:2]), interval)
        return self.bound(formula.define(), interval, sign)

    def _bound_state(self, formula: Formula, interval: Interval, sign: int) -> Range:
        leaf = make_leaf(formula, self.scenario)
        names = leaf.signals
        cells = [
            Cell(cell.start, cell.end, tuple(leaf.parts(dict(zip(names, cell.parts, strict=True)))))
            for cell in list_cells([self.signals[name] for name in names], *interval)
        ]
        bounds = find_minimum(
            cells, leaf.measure if sign > 0 else lambda ranges: negate_bounds(leaf.measure(ranges)), self.effort
        )
        return bounds.low, bounds.high

    def _bound_best(self, operands: Sequence[Formula], part: Interval, sign: int, known: Fraction | None) -> Range:
        """Return a lower bound of the least of the best operand over a part, and an upper one: in its middle.

        Where one operand alone is above an upper bound that is known, the others change nothing: what looks ahead is
        asked last.
        """
        ordered = sorted(operands, key=lambda operand: operand.is_temporal)
        middle = (part[0] + part[1]) / 2
        low = self._bound_until_known(ordered, part, sign, 0, known)
        if known is not None and low >= known:
            return low, known
        high = self._bound_until_known(ordered, (middle, middle), sign, 1, known)
        return low, high if known is None else min(high, known)

    def _bound_until_known(
        self, operands: Sequence[Formula], part: Interval, sign: int, end: int, known: Fraction | None
    ) -> Fraction:
        """Return the greatest of bounds of operands, or one that is not below what is known."""
        best = self.bound(operands[0], part, sign)[end]
        for operand in operands[1:]:
            if known is not None and best >= known:
                break
            best = max(best, self.bound(operand, part, sign)[end])
        return best

    def _bound_some(self, child: Formula, part: Interval, window: tuple[float, float], sign: int) -> Range:
        """Return the same of the best instant within a window ahead."""
        middle = (part[0] + part[1]) / 2
        shared = self._shift((part[1], part[0]), window)
        if shared[0] < shared[1]:
            low = -self.bound(child, shared, -sign)[1]
        else:
            low = self.bound(child, self._shift(part, window), sign)[0]
        return low, -self.bound(child, self._shift((middle, middle), window), -sign)[0]

    def _bound_until(self, formula: Until, part: Interval) -> Range:
        """Return the same of an until: what comes is looked for where all times of the part may look."""
        middle = (part[0] + part[1]) / 2
        shared = self._shift((part[1], part[0]), formula.interval)
        if shared[0] <= shared[1]:
            low = self._find_best_until(formula, part[0], shared)[0]
        else:
            reached = self._shift(part, formula.interval)
            low = min(self.bound(formula.right, reached, 1)[0], self.bound(formula.left, (part[0], reached[1]), 1)[0])
        return low, self._find_best_until(formula, middle, self._shift((middle, middle), formula.interval))[1]

    def _find_best_until(self, formula: Until, start: Fraction, window: Interval) -> Range:
        """Return bounds of max over tau in a window of min(right(tau), min of left over [start, tau])."""

        def measure(first: Fraction, last: Fraction, _: Fraction | None) -> Range:
            middle = (first + last) / 2
            high = min(-self.bound(formula.right, (first, last), -1)[0], self.bound(formula.left, (start, first), 1)[1])
            low = min(
                self.bound(formula.right, (middle, middle), 1)[0], self.bound(formula.left, (start, middle), 1)[0]
            )
            return -high, -low

        return negate_bounds(self._halve(measure, window))

    def _bound_most_until(self, formula: Until, interval: Interval) -> Range:
        """Return bounds of the greatest of an until over an interval: whoever waits least needs the left side least."""
        near = Fraction(formula.interval[0])

        def measure(first: Fraction, last: Fraction, _: Fraction | None) -> Range:
            middle = (first + last) / 2
            right = -self.bound(formula.right, (first, last), -1)[0]
            begin = min(interval[1], last - near)
            left = self.bound(formula.left, (begin, first), 1) if begin <= first else None
            high = min(right, left[1]) if left else right
            begin = max(min(interval[1], middle - near), interval[0])
            low = min(
                self.bound(formula.right, (middle, middle), 1)[0], self.bound(formula.left, (begin, middle), 1)[0]
            )
            return -high, -low

        return negate_bounds(self._halve(measure, self._shift(interval, formula.interval)))

    def _halve(self, bound: Bound, interval: Interval) -> Range:
        """Return bounds of the least of a value over an interval, whose lowest part is halved first.

        Args:
            bound: a lower bound of the least over a part, and an upper one, where some upper one is known.
            interval: of time [s].
        """
        parts = [(*bound(*interval, None), interval)]
        high = parts[0][1]
        for _ in range(self.effort.nested_splits):
            parts.sort()
            low, _, (start, end) = parts[0]
            if high - low <= self.effort.nested_accuracy or start == end:
                break
            middle = (start + end) / 2
            halves = [(*bound(*half, high), half) for half in ((start, middle), (middle, end))]
            high = min(high, *(half[1] for half in halves))
            parts[:1] = halves
        return min(parts)[0], high

    def _shift(self, interval: Interval, window: tuple[float, float]) -> Interval:
        """Return the instants that a window ahead covers; rounded ends must not leave the horizon."""
        start, end = (edge + Fraction(ahead) for edge, ahead in zip(interval, window, strict=True))
        return min(start, self.horizon), min(end, self.horizon)


def _is_instant(window: tuple[float, float]) -> bool:
    return window[0] == window[1]
