"""The way of one object through rooms: hits near the turns of its shortest way, so that little is left to search.

A model that may send the object anywhere branches on every side of every obstacle on every leg; behind a few walls
it takes minutes. Where the object is hit is known up to a box here, and most sides follow.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.frame import find_frame
from planners.free_flyer.impossibility.convex_polygon import clip, make_box
from planners.free_flyer.impossibility.necessary_visits import Moment, Visit, list_alternatives
from planners.free_flyer.nominal.leg_times import HitPlace
from planners.free_flyer.nominal.several_objects.sequence_search import restrict_to_object
from planners.free_flyer.nominal.ways import find_way, list_avoided
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import Demands, read_demands

NEAR = 2.5  # half a side of the box around a turn [radii of the object]
MERGED = 8.0  # two turns that are nearer may be one, in the middle [radii of the object]
STRAIGHT = 0.9  # cosine of the angle of a turn that is none
MOST_ORDERS = 6  # of places that may be visited in any order
MOST_OBSTACLES = 20  # that the object keeps away from; among more a way takes seconds to find, and none is


@dataclass(frozen=True)
class _Stop:
    """Hold a box in which the object is hit: at a turn, or where it has to be."""

    lower: np.ndarray
    upper: np.ndarray
    is_turn: bool

    @property
    def middle(self) -> np.ndarray:
        """Return the middle of the box, shape (2,) [m]."""
        return 0.5 * (self.lower + self.upper)

    def mix(self, other: _Stop) -> _Stop:
        """Return the stop in the middle of this one and another one."""
        return _Stop(0.5 * (self.lower + other.lower), 0.5 * (self.upper + other.upper), self.is_turn)


@dataclass(frozen=True)
class ObjectWay:
    """Hold the turns of an object's shortest way through all places that it has to visit, and these places.

    Args:
        name: of the object.
        stops: turns and places in their order.
        near: distance of two turns that one hit in the middle may replace [m].
        rest: whether the object is stopped at the end.
    """

    name: str
    stops: tuple[_Stop, ...]
    near: float
    rest: bool

    @property
    def impacts(self) -> int:
        """Return the number of impacts with one at the start, at every stop, and one to rest."""
        return len(self.stops) + self.rest

    @property
    def turns(self) -> int:
        """Return how often the way turns between places."""
        return sum(stop.is_turn for stop in self.stops)

    @property
    def pairs(self) -> list[int]:
        """Return the numbers of those stops that, with the next one, are turns near each other."""
        return [
            k
            for k, (one, other) in enumerate(itertools.pairwise(self.stops))
            if one.is_turn and other.is_turn and float(np.linalg.norm(one.middle - other.middle)) <= self.near
        ]

    def place_hits(self, merged: frozenset[int]) -> tuple[HitPlace, ...]:
        """Return where the object is hit the second, third, ... time; the last hit, which stops it, is free.

        Args:
            merged: numbers of the turns that are one with the next one.
        """
        kept = [
            stop.mix(self.stops[k + 1]) if k in merged else stop
            for k, stop in enumerate(self.stops)
            if k - 1 not in merged
        ]
        count = len(kept) + self.rest
        boxes = enumerate(kept[:-1], start=1)
        return tuple(HitPlace(self.name, k, count, tuple(stop.lower), tuple(stop.upper)) for k, stop in boxes)


def find_object_way(scenario: FreeFlyerScenario, demands: Demands, wall: float) -> ObjectWay | None:
    """Return the way of the only object; None: the formula names no place for it, or none can be reached.

    Args:
        scenario: with one object, at rest at the start.
        demands: of its formula.
        wall: distance kept from the world's edge and solid obstacles beyond touching [m].
    """
    ((name, body),) = scenario.objects.items()
    avoided = sum(need.body == name for need in list_avoided(demands))
    if any(body.start_velocity) or avoided > MOST_OBSTACLES:
        return None
    orders = sorted(_list_orders(scenario, demands, name), key=partial(_measure_straight, np.array(body.start)))
    found = (_find_stops(scenario, demands, name, wall, places) for places in orders)
    stops = next((one for one in found if one is not None), None)
    return None if stops is None else ObjectWay(name, tuple(stops), MERGED * body.radius, body.rest)


def list_merges(pairs: Sequence[int]) -> Iterator[frozenset[int]]:
    """Yield which pairs of near turns may be one, as many as may be first, and none last.

    Args:
        pairs: numbers of the first turns.
    """
    for count in range(len(pairs), -1, -1):
        for chosen in itertools.combinations(pairs, count):
            if all(second > first + 1 for first, second in itertools.pairwise(chosen)):
                yield frozenset(chosen)


def find_most_impacts(scenario: FreeFlyerScenario) -> int:
    """Return the greatest number of impacts that is tried where nobody says another one: enough for every turn."""
    wall = Reserves().wall * find_frame(scenario).length
    ways = []
    for name in scenario.objects:
        own = scenario if len(scenario.objects) == 1 else restrict_to_object(scenario, name)
        ways.append(None if own is None else find_object_way(own, read_demands(own, wall), wall))
    few = 3 if len(ways) > 1 else 6
    return 3 * (len(ways) > 1) + sum(few if way is None else max(few, way.impacts) for way in ways)


def count_turns(scenario: FreeFlyerScenario, demands: Demands, wall: float) -> int:
    """Return how often the way of an only object turns; 0 for several objects."""
    way = find_object_way(scenario, demands, wall) if len(scenario.objects) == 1 else None
    return 0 if way is None else way.turns


def _list_orders(scenario: FreeFlyerScenario, demands: Demands, name: str) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield the places of an object in orders that their windows suggest, each a convex polygon, shape (n, 2) [m]."""
    world = make_box(np.array(scenario.world.lower), np.array(scenario.world.upper))
    for alternative in list_alternatives(demands.conjuncts.values())[:MOST_ORDERS]:
        at: dict[tuple[float, float, object], np.ndarray] = {}
        for visit in alternative:
            if not isinstance(visit, Visit):
                continue
            need = demands.predicates[visit.predicate]
            if need.kind == "stay" and need.bodies == (name,):
                key = _find_window(visit.moment)
                at[key] = clip(at.get(key, world), need.faces, need.bounds)
        groups = [
            [at[key] for key in keys]
            for _, keys in itertools.groupby(sorted(at, key=lambda key: key[:2]), key=lambda key: key[:2])
        ]
        orders = itertools.product(*(itertools.permutations(group) for group in groups))
        for order in itertools.islice(orders, MOST_ORDERS):
            places = [place for group in order for place in group if len(place) > 2]
            if places:
                yield tuple(_drop_repeated(places))


def _measure_straight(start: np.ndarray, places: Sequence[np.ndarray]) -> float:
    """Return the length of the lines from a start through the middles of places [m]."""
    middles = np.array([start, *(0.5 * (place.min(axis=0) + place.max(axis=0)) for place in places)])
    return float(np.linalg.norm(np.diff(middles, axis=0), axis=1).sum())


def _find_window(moment: Moment) -> tuple[float, float, object]:
    """Return a window by its end, and what else tells moments apart."""
    return moment.end, moment.start, None if moment.is_fixed else id(moment)


def _drop_repeated(places: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
    before = None
    for place in places:
        if before is None or place.shape != before.shape or not np.allclose(place, before):
            yield place
        before = place


def _find_stops(
    scenario: FreeFlyerScenario, demands: Demands, name: str, wall: float, places: Sequence[np.ndarray]
) -> list[_Stop] | None:
    """Return the turns of the shortest way through the middles of places, and these; None: there is no way."""
    body = scenario.objects[name]
    inset, near = body.radius + wall, NEAR * body.radius
    lower, upper = np.array(scenario.world.lower) + inset, np.array(scenario.world.upper) - inset
    needs = [need for need in list_avoided(demands) if need.body == name]
    stops: list[_Stop] = []
    here = np.array(body.start)
    for place in places:
        box = _Stop(place.min(axis=0), place.max(axis=0), False)
        way = find_way(here, box.middle, needs, lower, upper)
        if way is None:
            return None
        stops += [_Stop(np.maximum(turn - near, lower), np.minimum(turn + near, upper), True) for turn in way[1:-1]]
        stops.append(box)
        here = box.middle
    middles = [np.array(body.start), *(stop.middle for stop in stops)]
    # A place on a way that hardly turns there is passed in flight.
    return [
        stop
        for stop, before, here, after in zip(stops, middles, middles[1:], [*middles[2:], None], strict=False)
        if stop.is_turn or after is None or not _is_straight(before, here, after)
    ]


def _is_straight(before: np.ndarray, here: np.ndarray, after: np.ndarray) -> bool:
    step, next_step = here - before, after - here
    return bool(step @ next_step > STRAIGHT * np.linalg.norm(step) * np.linalg.norm(next_step))
