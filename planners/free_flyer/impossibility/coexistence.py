"""Whether two bodies can be in their places at the same time, and at the distances that are asked of them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Distance
from planners.free_flyer.impossibility.convex_polygon import measure_distance, measure_span
from planners.free_flyer.impossibility.necessary_visits import Stay, Visit
from planners.free_flyer.impossibility.reach import find_inner_radius
from planners.free_flyer.impossibility.visiting_order import Call, Impossibility


def check_together(
    scenario: FreeFlyerScenario, visits: Sequence[Visit], stays: Sequence[Stay], calls: Sequence[Call], forgiven: float
) -> Impossibility | None:
    """Return which two bodies cannot be where, or as near to each other, as they have to; None: nothing tells.

    Args:
        scenario: bodies.
        visits: what holds at moments.
        stays: what holds for some time.
        calls: which body has to be where, when.
        forgiven: by which places may be missed [m].
    """
    for predicate in dict.fromkeys([visit.predicate for visit in visits] + [stay.predicate for stay in stays]):
        if isinstance(predicate, Distance) and predicate.is_upper and predicate.a != predicate.b:
            least = _find_least_distance(scenario, predicate.a, predicate.b)
            if predicate.bound < least - forgiven:
                told = f"'{predicate}' asks for less than the {least:.3g} m between centres when they touch"
                return Impossibility(told, "allow a greater distance")
    for one, other in itertools.combinations(calls, 2):
        same = one.moment is other.moment or one.start == one.end == other.start == other.end
        if one.body == other.body or not same:
            continue
        least, span = _find_least_distance(scenario, one.body, other.body), measure_span(one.place, other.place)
        if span < least - 2.0 * forgiven:
            both = f"{one.body} has to be {one.said} and {other.body} {other.said} at the same time, {one.when}"
            told = f"{both}: their centres are {least:.3g} m apart at least, those places {span:.3g} m at most"
            return Impossibility(told, "give one of them another place or time")
        for predicate in _list_distances(visits, one, other):
            if measure_distance(one.place, other.place) > predicate.bound + 2.0 * forgiven:
                told = f"{one.body} has to be {one.said}, {other.body} {other.said} and '{predicate}' {one.when}"
                return Impossibility(f"{told}: those places are farther apart", "change one of the three")
    return None


def _find_least_distance(scenario: FreeFlyerScenario, one: str, other: str) -> float:
    return find_inner_radius(scenario.body(one)) + find_inner_radius(scenario.body(other))


def _list_distances(visits: Sequence[Visit], one: Call, other: Call) -> Iterator[Distance]:
    """Yield the greatest distances of two bodies that hold at the moment of both calls."""
    for visit in visits:
        if isinstance(visit.predicate, Distance) and visit.predicate.is_upper:
            same = visit.moment is one.moment or visit.moment.start == visit.moment.end == one.start == one.end
            if same and {visit.predicate.a, visit.predicate.b} == {one.body, other.body}:
                yield visit.predicate
