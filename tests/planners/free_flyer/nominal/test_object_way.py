"""Objects behind walls: where their ways turn, which turns are one hit, and plans that no free search finds in time."""

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.free_flyer.nominal.event_grid import build_event_grid
from planners.free_flyer.nominal.leg_times import HitPlace
from planners.free_flyer.nominal.object_way import ObjectWay, find_most_impacts, find_object_way, list_merges
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands

HALF = 0.5  # of the box around a turn [m]


def _body(start: tuple[float, float], **more: object) -> dict[str, object]:
    return {"start": start, "mass": 16.8, "inertia": 0.336, "radius": 0.2, "speed_limit": 0.3} | more


def _rooms(formula: str = "F[0,400] pop in goal", **objects: object) -> FreeFlyerScenario:
    """Return four rooms in a row, joined above, below and above three walls: the object turns six corners."""
    walls = {"one": (2.4, 0.0, 4.4), "two": (4.9, 1.6, 6.0), "three": (7.4, 0.0, 4.4)}
    return build_scenario(
        {
            "name": "rooms",
            "domain": "free_flyer",
            "formula": formula,
            "horizon": 400.0,
            "control_period": 0.1,
            "world": {"lower": (0.0, 0.0), "upper": (10.0, 6.0)},
            "robots": {"snap": _body((0.6, 1.0), force_limit=1.5, torque_limit=0.5)},
            "objects": {"pop": _body((1.2, 1.5))} | objects,
            "regions": {
                "goal": {"lower": (8.5, 4.0), "upper": (9.5, 5.0)},
                "underway": {"lower": (3.2, 2.5), "upper": (4.2, 3.5)},
                "aside": {"lower": (3.2, 4.5), "upper": (4.2, 5.5)},
            },
            "obstacles": {
                name: {"lower": (x, low), "upper": (x + 0.2, high), "solid": True}
                for name, (x, low, high) in walls.items()
            },
            "believed": {"restitution": 0.8},
        },
        source="rooms",
    )


def _find_way(scenario: FreeFlyerScenario) -> ObjectWay:
    way = find_object_way(scenario, read_demands(scenario, 0.05), 0.05)
    assert way is not None
    return way


def test_an_object_turns_at_the_corners_of_walls_and_two_at_one_wall_may_be_one() -> None:
    way = _find_way(_rooms())
    corners = [(2.15, 4.65), (2.85, 4.65), (4.65, 1.35), (5.35, 1.35), (7.15, 4.65), (7.85, 4.65), (9.0, 4.5)]
    np.testing.assert_allclose([stop.middle for stop in way.stops], corners, atol=1e-9)
    assert (way.turns, way.impacts, way.pairs) == (6, 8, [0, 2, 4])
    first, *_, last = way.place_hits(frozenset([0]))
    assert (first.number, first.count, last.number) == (1, 7, 5), "the first hit is at the start, the last one free"
    np.testing.assert_allclose([first.lower, first.upper], [(2.5 - HALF, 4.65 - HALF), (2.5 + HALF, 4.65 + HALF)])


def test_as_many_turns_as_may_be_are_one_first() -> None:
    chosen = [sorted(merged) for merged in list_merges([0, 1, 3])]
    assert chosen == [[0, 3], [1, 3], [0], [1], [3], []], "two pairs that share a turn are never both one"


@pytest.mark.parametrize(
    ("formula", "turns", "places"),
    [
        ("F[0,200] (pop in underway & F[0,200] pop in goal)", 6, 1),  # on the way: passed in flight
        ("F[0,200] (pop in aside & F[0,200] pop in goal)", 5, 2),  # aside of it: hit there, too
        ("F[0,200] (pop in goal & F[0,200] pop in aside)", 10, 2),  # and back again
        ("F[0,300] G[0,50] pop in goal", 6, 1),  # one place for a while
        ("F[0,400] pop in goal & F[0,400] pop in underway", 6, 1),  # in any order: the shortest one
    ],
)
def test_places_are_visited_in_the_order_of_their_windows(formula: str, turns: int, places: int) -> None:
    way = _find_way(_rooms(formula))
    assert (way.turns, len(way.stops) - way.turns) == (turns, places)


def test_no_place_no_way() -> None:
    scenario = _rooms("G[0,400] pop not in goal")
    assert find_object_way(scenario, read_demands(scenario, 0.05), 0.05) is None
    scenario = _rooms("F[0,400] pop in goal", pop=_body((1.2, 1.5), start_velocity=(0.1, 0.0)))
    assert find_object_way(scenario, read_demands(scenario, 0.05), 0.05) is None, "it is not where it starts"


def test_every_turn_may_be_an_impact() -> None:
    assert find_most_impacts(_rooms("F[0,400] pop.x >= 1.5")) == 6
    assert find_most_impacts(_rooms()) == 8
    assert find_most_impacts(_rooms(tin=_body((6.0, 2.0)))) == 3 + 8 + 3


def test_places_hold_only_in_sequences_of_so_many_hits() -> None:
    scenario = _rooms(tin=_body((6.0, 2.0)))
    place = HitPlace("pop", 1, 2, (2.0, 4.0), (3.0, 5.0))
    counts = []
    for word in (("pop", "tin", "pop"), ("pop", "tin", "pop", "pop"), None):
        hits = None if word is None else tuple(("snap", name) for name in word)
        grid = build_event_grid(scenario, 3 if hits is None else len(hits), (0.0, 1.0), Reserves(), 1, word=hits)
        before = len(grid.model.inequalities)
        place.add_to(grid)
        counts.append(len(grid.model.inequalities) - before)
    assert counts == [4, 0, 0]


def test_one_robot_brings_an_object_through_four_rooms() -> None:
    plan = make_free_flyer_plan(_rooms())
    assert len(plan.impacts) == 7
    assert plan.robustness == pytest.approx(0.5, abs=1e-5), "the bound: half a side of the goal"
    assert plan.validated
