"""Formulas about one instant as polynomials, and bounds of their robustness from bounds of these."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import And, Distance, Formula, In, Linear, Not, Or, Predicate, Speed
from planners.free_flyer.certificate.area import make_faces
from planners.free_flyer.certificate.motion import ONE
from planners.free_flyer.certificate.polynomial import Polynomial, Range, combine, root_above, root_below, square
from planners.free_flyer.certificate.search import Measure


@dataclass(frozen=True)
class Leaf:
    """A formula without temporal operators over an interval.

    Attributes:
        signals: whose polynomials it needs.
        parts: from these to its own polynomials.
        measure: from bounds of its own polynomials to those of its robustness.
        count: of its own polynomials.
    """

    signals: tuple[str, ...]
    parts: Callable[[Mapping[str, Polynomial]], list[Polynomial]]
    measure: Measure
    count: int


def make_leaf(formula: Formula, scenario: FreeFlyerScenario) -> Leaf:
    """Return the polynomials and the measure of a formula without temporal operators.

    Raises:
        InputError: it has a predicate that is not known here.
    """
    match formula:
        case Not(child):
            leaf = make_leaf(child, scenario)
            return Leaf(leaf.signals, leaf.parts, lambda ranges: negate_bounds(leaf.measure(ranges)), leaf.count)
        case And(operands):
            return _join(min, [make_leaf(operand, scenario) for operand in operands])
        case Or(operands):
            return _join(max, [make_leaf(operand, scenario) for operand in operands])
        case In():
            return _make_area_leaf(formula, scenario)
        case Linear():
            return _make_linear_leaf(formula)
        case Distance() | Speed():
            return _make_norm_leaf(formula)
        case Predicate():
            raise InputError(f"predicate '{formula}' cannot be certified")
    return make_leaf(formula.define(), scenario)


def _make_area_leaf(formula: In, scenario: FreeFlyerScenario) -> Leaf:
    faces = make_faces(scenario.areas[formula.area].corners)
    x, y = formula.signals()

    def measure(ranges: Sequence[Range]) -> Range:
        inside = pick_bounds(min, [face.bound(part) for face, part in zip(faces, ranges, strict=True)])
        return negate_bounds(inside) if formula.negated else inside

    def parts(signals: Mapping[str, Polynomial]) -> list[Polynomial]:
        return [face.make_part(signals[x], signals[y]) for face in faces]

    return Leaf((x, y), parts, measure, len(faces))


def _make_linear_leaf(formula: Linear) -> Leaf:
    sign, names = Fraction(formula.sign), formula.signals()
    weights = [-sign * Fraction(coefficient) for _, coefficient in formula.terms]

    def parts(signals: Mapping[str, Polynomial]) -> list[Polynomial]:
        return [combine([signals[name] for name in names], weights, sign * Fraction(formula.bound))]

    return Leaf(names, parts, lambda ranges: ranges[0], 1)


def _make_norm_leaf(formula: Distance | Speed) -> Leaf:
    """Return the leaf of a bound on a norm; its polynomial is the square of the norm."""
    bound = Fraction(formula.bound)
    pairs: list[tuple[str, ...]]
    if isinstance(formula, Distance):
        pairs = [(f"{formula.a}.{axis}", f"{formula.b}.{axis}") for axis in "xy"]
    else:
        pairs = [(f"{formula.body}.{axis}",) for axis in ("vx", "vy")]

    def parts(signals: Mapping[str, Polynomial]) -> list[Polynomial]:
        rows = [combine([signals[name] for name in pair], [ONE, -ONE][: len(pair)], Fraction(0)) for pair in pairs]
        return [combine([square(row) for row in rows], [ONE, ONE], Fraction(0))]

    def measure(ranges: Sequence[Range]) -> Range:
        low, high = (max(end, Fraction(0)) for end in ranges[0])
        slack = bound - root_above(high), bound - root_below(low)
        return slack if formula.is_upper else negate_bounds(slack)

    return Leaf(formula.signals(), parts, measure, 1)


def _join(pick: Callable[..., Fraction], leaves: Sequence[Leaf]) -> Leaf:
    names = tuple(dict.fromkeys(name for leaf in leaves for name in leaf.signals))

    def parts(signals: Mapping[str, Polynomial]) -> list[Polynomial]:
        return [part for leaf in leaves for part in leaf.parts(signals)]

    def measure(ranges: Sequence[Range]) -> Range:
        return pick_bounds(pick, [leaf.measure(share) for leaf, share in _deal(leaves, ranges)])

    return Leaf(names, parts, measure, sum(leaf.count for leaf in leaves))


def _deal(leaves: Sequence[Leaf], ranges: Sequence[Range]) -> Iterator[tuple[Leaf, Sequence[Range]]]:
    start = 0
    for leaf in leaves:
        yield leaf, ranges[start : start + leaf.count]
        start += leaf.count


def pick_bounds(pick: Callable[..., Fraction], bounds: Sequence[Range]) -> Range:
    """Return bounds of the least (pick is min) or the greatest (max) of some values."""
    return pick(low for low, _ in bounds), pick(high for _, high in bounds)


def negate_bounds(bounds: Range) -> Range:
    """Return bounds of minus a value."""
    return -bounds[1], -bounds[0]
