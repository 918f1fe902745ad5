"""One confirmed or refused statement of a certificate, and by how much numbers may be off."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

from planners.free_flyer.certificate.polynomial import Range
from planners.free_flyer.certificate.search import Effort, Measure, find_minimum
from planners.free_flyer.certificate.track import Cell


@dataclass(frozen=True)
class Tolerances:
    """Say by how much a plan may be off.

    A file holds float64: coordinates up to 100 m are rounded to 1e-14 m, and quotients by durations make velocities
    from them. The tolerances are some 1e5 times that, and a thousandth of what the planner calls equal (1e-6).

    Attributes:
        length: of positions, contacts and gaps [m].
        velocity: of velocities and what impacts do to them [m/s].
        time: least between two impacts of a body, whose order must be known [s].
        share: of limits of speed and force.
        robustness: below the promised one; within a micrometre the planner calls a plan optimal [m].
        effort: how far bounds over continuous time are refined; these hold for any.
    """

    length: Fraction = Fraction(1, 10**9)
    velocity: Fraction = Fraction(1, 10**9)
    time: Fraction = Fraction(1, 10**9)
    share: Fraction = Fraction(1, 10**9)
    robustness: Fraction = Fraction(1, 10**6)
    effort: Effort = field(default_factory=Effort)


@dataclass(frozen=True)
class Found:
    """A number, and where it is the worst.

    Attributes:
        amount: proven not to be exceeded, or not to be fallen below.
        where: bodies and time.
    """

    amount: Fraction
    where: str


@dataclass(frozen=True)
class Check:
    """A statement about a plan.

    Attributes:
        name: what is looked at.
        found: the worst that was found, proven.
        allowed: the most, or the least, that it may be.
        unit: of both.
        is_least: whether `allowed` is the least.
        where: the worst is.
    """

    name: str
    found: Fraction
    allowed: Fraction
    unit: str
    is_least: bool
    where: str

    @property
    def margin(self) -> Fraction:
        """Return how much is left; below zero it is refused."""
        return self.found - self.allowed if self.is_least else self.allowed - self.found

    @property
    def confirmed(self) -> bool:
        """Return whether it holds, decided exactly."""
        return self.margin >= 0

    def to_dict(self) -> dict[str, object]:
        """Return the check as it is printed."""
        return {
            "check": self.name,
            "found": float(self.found),
            "relation": ">=" if self.is_least else "<=",
            "allowed": float(self.allowed),
            "margin": float(self.margin),
            "unit": self.unit,
            "where": self.where,
            "confirmed": self.confirmed,
        }


def check_most(name: str, unit: str, allowed: Fraction, found: Iterable[Found]) -> list[Check]:
    """Return a check that the greatest of some numbers is at most so much; none where there is no number."""
    worst = max(found, key=lambda one: one.amount, default=None)
    return [] if worst is None else [Check(name, worst.amount, allowed, unit, False, worst.where)]


def check_least(name: str, unit: str, allowed: Fraction, found: Iterable[Found]) -> list[Check]:
    """Return a check that the least of some numbers is at least so much; none where there is no number."""
    worst = min(found, key=lambda one: one.amount, default=None)
    return [] if worst is None else [Check(name, worst.amount, allowed, unit, True, worst.where)]


def find_least(who: str, cells: Iterable[Cell], measure: Measure, effort: Effort) -> Found:
    """Return what a function never falls below over some cells, and where it comes nearest to that."""
    bounds = find_minimum(cells, measure, effort)
    return Found(bounds.low, f"{who} at {float(bounds.time):.6g} s")


def find_most(who: str, cells: Iterable[Cell], measure: Measure, effort: Effort) -> Found:
    """Return what a function never exceeds over some cells, and where it comes nearest to that."""
    least = find_least(who, cells, _negate(measure), effort)
    return Found(-least.amount, least.where)


def _negate(measure: Measure) -> Callable[[Sequence[Range]], Range]:
    def measure_negative(ranges: Sequence[Range]) -> Range:
        low, high = measure(ranges)
        return -high, -low

    return measure_negative
