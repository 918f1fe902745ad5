"""Knots carry what the formula demands of them; expectations are written by hand from the scenario files."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.bezier import Curve
from planners.free_flyer.belief.plan_table import make_plan_table
from planners.free_flyer.specification.impact_demand import Knot, find_knots, find_own_faces
from planners.plan import Plan, PlannedImpact

ANY_TIME = (0.0, math.inf)
CORRIDOR = {(-1, 0, 0), (1, 0, 2), (0, -1, 0), (0, 1, 10)}
GOAL = {(-1, 0, -0.25), (1, 0, 1.75), (0, -1, -7.25), (0, 1, 8.75)}
B = {(-1, 0, -2.25), (1, 0, 2.75), (0, -1, 1), (0, 1, -0.5)}
C = {(-1, 0, -1), (1, 0, 1.5), (0, -1, 0), (0, 1, 0.5)}
D = {(-1, 0, -2.25), (1, 0, 2.75), (0, -1, -0.5), (0, 1, 1)}
LEFT = {(-1, 0, -1), (1, 0, 1.5), (0, -1, 0.25), (0, 1, 0.25)}
RIGHT = {(-1, 0, -2.5), (1, 0, 3), (0, -1, 0.25), (0, 1, 0.25)}
CENTRE = {(-1, 0, -1.75), (1, 0, 2.25), (0, -1, 0.25), (0, 1, 0.25)}

# Object's places: (time, x, y) of its impacts, then of its end.
PONG = [(8, 1.25, -0.75), (30, 2.5, -0.75), (60, 1.25, 0.25), (85, 2.5, 0.75), (100, 2.5, 0.75)]
ROUND = [(24, 5.5, 5), (52, 2.35, 4.65), (97, 2.35, 1.35), (123, 5, 1), (150, 5, 1)]


def load(name: str, formula: str = "") -> FreeFlyerScenario:
    scenario = load_scenario(name)
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario.override({"formula": formula}) if formula else scenario


def lay_plan(scenario: FreeFlyerScenario, places: list[tuple[float, float, float]]) -> Plan:
    """Return a plan in which pop flies straight from place to place and nobody else moves."""
    times = [0.0, *(float(time) for time, _, _ in places)]
    points = np.array([places[0][1:], *(place[1:] for place in places)], dtype=float)
    velocity = np.diff(points, axis=0) / np.diff(times)[:, None]
    normal, zero = np.array([1.0, 0.0]), np.zeros(2)
    impacts = tuple(
        PlannedImpact(t, "snap", "pop", p, p - 0.4 * normal, normal, zero, zero, velocity[k], velocity[k + 1])
        for k, (t, p) in enumerate(zip(times[1:-1], points[1:-1], strict=True))
    )
    robots = {name: Curve([0.0, times[-1]], [[robot.start]]) for name, robot in scenario.robots.items()}
    path = Curve(times, list(itertools.pairwise(points)))
    numbers = dict.fromkeys(("robustness", "bound", "gap", "effort", "solve_seconds"), 0.0)
    return Plan(
        scenario=scenario.name,
        objective="robustness",
        horizon=scenario.horizon,
        effort_bound=None,
        impacts=impacts,
        robots=robots,
        objects={"pop": path},
        stage_seconds={},
        validated=False,
        **numbers,
    )


def knots_of(scenario: FreeFlyerScenario, places: list[tuple[float, float, float]]) -> list[Knot]:
    knots = find_knots(scenario, lay_plan(scenario, places), "pop")
    assert [(knot.time, *knot.position) for knot in knots] == places
    return knots


def faces(knot: Knot) -> set[tuple[float, ...]]:
    return {tuple(float(value) for value in np.round(face, 12) + 0.0) for face in knot.faces}


def test_corridor_binds_all_knots_and_the_goal_the_rest_at_the_end() -> None:
    first, catch, end = knots_of(load("corridor"), [(8, 1, 2), (85, 1, 8), (100, 1, 8)])
    assert faces(first) == CORRIDOR
    assert faces(catch) == faces(end) == CORRIDOR | GOAL  # between them the object is at rest
    assert {knot.window for knot in (first, catch, end)} == {ANY_TIME}


def test_moving_object_is_not_bound_by_its_next_knot() -> None:
    _, second, end = knots_of(load("corridor"), [(8, 1, 2), (85, 1, 7.9), (100, 1, 8)])
    assert faces(second) == CORRIDOR
    assert faces(end) == CORRIDOR | GOAL


def test_pong_binds_the_knot_that_is_in_each_region() -> None:
    throw, b, c, d, end = knots_of(load("pong"), PONG)
    assert [faces(knot) for knot in (throw, b, c, d, end)] == [set(), B, C, D, D]
    assert {knot.window for knot in (throw, b, c, d, end)} == {ANY_TIME}  # "at any time" narrows nothing


def test_of_equal_knots_eventually_binds_the_last() -> None:
    places = [(8, 1.25, -0.75), (20, 2.5, -0.75), (40, 1.5, -0.75), (60, 2.5, -0.75), (100, 2.5, 0.75)]
    assert [faces(knot) for knot in knots_of(load("pong"), places)] == [set(), set(), set(), B, D]


def test_region_that_is_crossed_between_knots_binds_none() -> None:
    places = [(8, 1.25, -0.75), (40, 3.5, -0.75), (60, 1.25, 0.25), (85, 2.5, 0.75), (100, 2.5, 0.75)]
    throw, past_b, c, *_ = knots_of(load("pong"), places)
    assert faces(throw) == faces(past_b) == set()
    assert faces(c) == C


def test_pingpong_binds_within_its_windows() -> None:
    places = [(8, 1.25, 0), (20, 2.6, 0), (38, 2.9, 0), (47, 2, 0), (60, 2.1, 0)]
    knots = knots_of(load("pingpong"), places)
    # F[28,30] has no knot in its window: it binds none.
    assert [faces(knot) for knot in knots] == [LEFT, RIGHT, RIGHT, set(), CENTRE]
    assert [knot.window for knot in knots] == [(8, 10), (18, 20), (38, 40), ANY_TIME, (59, 60)]
    assert len(knots[1].faces) == 4


def test_rest_between_two_knots_serves_the_windows_it_spans() -> None:
    """F[18,20], F[28,30] and F[38,40] are served by one rest, F[59,60] by another."""
    places = [(8, 1.25, 0), (20, 2.75, 0), (38, 2.75, 0), (47, 2, 0), (60, 2, 0)]
    knots = knots_of(load("pingpong"), places)
    assert [knot.rests for knot in knots] == [False, True, False, True, False]
    assert [faces(knot) for knot in knots] == [LEFT, RIGHT, RIGHT, CENTRE, CENTRE]
    assert [knot.window for knot in knots] == [(8, 10), (0, 20), (38, 40), ANY_TIME, (59, 60)]
    assert all(len(knot.faces) == 4 for knot in knots)  # nothing is demanded twice


def test_object_comes_to_rest_before_a_window_closes_and_leaves_after_it_opens() -> None:
    places = [(9, 1.25, 0), (15, 2.6, 0), (25, 2.6, 0), (39, 2.8, 0), (60, 2, 0)]
    _, arrival, leaving, *_ = knots_of(load("pingpong"), places)
    assert (arrival.window, leaving.window) == ((0, 20), (18, math.inf))
    assert faces(arrival) == faces(leaving) == RIGHT


@pytest.mark.parametrize(
    ("formula", "time", "bound", "window"),
    [
        ("F[0,5] pop in left", 8, LEFT, ANY_TIME),
        ("F[5,10] pop in left", 8, LEFT, (5, 10)),
        ("F[5,10] pop in left", 15, LEFT, (5, math.inf)),  # it may stay longer
        ("F[9,20] pop in left", 8, set(), ANY_TIME),  # it has left before
    ],
)
def test_object_rests_until_its_first_impact(
    formula: str, time: float, bound: set[tuple[float, ...]], window: tuple[float, float]
) -> None:
    first, *_ = knots_of(load("pingpong", formula), [(time, 1.25, 0), (20, 2.75, 0), (60, 2, 0)])
    assert (faces(first), first.window) == (bound, window)


def test_solid_obstacle_is_kept_off_by_the_radius_on_the_side_of_each_leg() -> None:
    inside = {(-1, 0, -4.5), (1, 0, 5.5), (0, -1, -0.5), (0, 1, 1.5)}
    above, left, below = (0, -1, -4.2), (1, 0, 2.8), (0, 1, 1.8)
    knots = knots_of(load("obstacle_avoidance"), ROUND)
    assert [faces(knot) for knot in knots] == [
        {above},
        {above, left},
        {left, below},
        {below} | inside,
        {below} | inside,
    ]


def test_area_that_is_not_solid_may_be_touched() -> None:
    passable = load("obstacle_avoidance").override({"obstacles.block.solid": False})
    first, second, *_ = knots_of(passable, ROUND)
    assert faces(first) == {(0, -1, -4)}
    assert faces(second) == {(0, -1, -4), (1, 0, 3)}


def test_solid_obstacle_binds_where_the_formula_does_not_name_it() -> None:
    silent = load("obstacle_avoidance", "G[150,150] pop in goal")
    assert faces(knots_of(silent, ROUND)[1]) == {(0, -1, -4.2), (1, 0, 2.8)}


def test_of_a_disjunction_the_better_served_part_binds() -> None:
    scenario = load("pong", "F[0,100] (pop in B or pop in C) & G[100,100] (pop in D or pop in B)")
    places = [(8, 1.25, -0.75), (30, 2.7, -0.75), (60, 1.25, 0.25), (100, 2.5, 0.75)]
    throw, b, c, end = knots_of(scenario, places)
    assert [faces(knot) for knot in (throw, b, c, end)] == [set(), set(), C, D]  # C by 0.25 m, B by 0.05 m


def test_always_binds_the_knots_in_its_window() -> None:
    scenario = load("pong", "G[50,90] pop.x <= 3")
    assert [len(knot.faces) for knot in knots_of(scenario, PONG)] == [0, 0, 1, 1, 0]


@pytest.mark.parametrize(
    "formula",
    [
        "G[0,100] distance(pop, snap) >= 0.1",  # about two bodies
        "G[0,100] pop.x - snap.x >= -9",
        "G[0,100] snap.x >= -9",  # about another body
        "G[0,100] speed(pop) <= 1",  # not planned for
    ],
)
def test_what_is_not_about_this_object_alone_binds_nothing(formula: str) -> None:
    assert all(not knot.faces and knot.window == ANY_TIME for knot in knots_of(load("pong", formula), PONG))


def test_robots_may_not_leave_what_always_holds_them() -> None:
    corridor = load("corridor")
    for name in corridor.robots:
        assert {tuple(float(value) for value in face) for face in find_own_faces(corridor, name)} == CORRIDOR
    assert find_own_faces(load("throw_and_catch"), "snap") == []
    only = load("corridor", "G[0,100] snap in corridor & G[10,100] crackle in corridor & F[0,100] pop in goal")
    assert len(find_own_faces(only, "snap")) == 4
    assert find_own_faces(only, "crackle") == []  # not at all times
    assert find_own_faces(load("corridor", "G[0,100] speed(pop) <= 1"), "snap") == []


@pytest.mark.parametrize(
    ("name", "places", "depths"),
    [
        ("corridor", [(8, 1, 2), (85, 1, 8), (100, 1, 8)], [1, 0.75, 0.75]),
        ("pong", PONG, [math.inf, 0.25, 0.25, 0.25, 0.25]),
        ("pingpong", [(8, 1.25, 0), (20, 2.75, 0), (38, 2.8, 0), (60, 2, 0)], [0.25, 0.25, 0.2, 0.25]),
        ("obstacle_avoidance", ROUND, [0.8, 0.45, 0.45, 0.5, 0.5]),
    ],
)
def test_script_knows_how_deep_the_plan_lies(
    name: str, places: list[tuple[float, float, float]], depths: list[float]
) -> None:
    scenario = load(name)
    table, knots = make_plan_table(scenario, lay_plan(scenario, places)), knots_of(scenario, places)
    np.testing.assert_allclose(table.knot["depth"], depths, atol=1e-12)
    assert list(zip(table.knot["opens"], table.knot["closes"], strict=True)) == [knot.window for knot in knots]
    for i, knot in enumerate(knots):
        assert table.knot[i]["faces"] == len(knot.faces)
        faces = [(*face["normal"], face["offset"]) for face in table.face[i, : len(knot.faces)]]
        np.testing.assert_array_equal(np.reshape(faces, (-1, 3)), np.reshape(knot.faces, (-1, 3)))


def test_script_measures_in_metres_whatever_the_formula_multiplies_by() -> None:
    scenario = load("pong", "G[0,100] 3 * pop.x + 4 * pop.y <= 30")
    table = make_plan_table(scenario, lay_plan(scenario, PONG))
    np.testing.assert_allclose(table.face[0, 0]["normal"], [0.6, 0.8])
    assert table.face[0, 0]["offset"] == pytest.approx(6)
    assert table.knot[0]["depth"] == pytest.approx(6 - 0.6 * 1.25 + 0.8 * 0.75)


def test_script_keeps_robots_off_the_walls_of_the_world() -> None:
    scenario = load("throw_and_catch")
    table = make_plan_table(scenario, lay_plan(scenario, [(9, 0.5, 1.5), (30, 0.5, 2.25)]))
    # The world is [-1, 2] x [-0.75, 4.5]; touching with a radius of 0.2 m counts as 0.1 m inside.
    walls = {(-1, 0, 0.9), (0, -1, 0.65), (1, 0, 1.9), (0, 1, 4.4)}
    for faces in table.own:
        rows = [(*face["normal"], face["offset"]) for face in faces]
        assert {tuple(float(value) for value in np.round(row, 12) + 0.0) for row in rows} == walls


def test_one_visit_serves_every_window_that_it_is_in() -> None:
    """G[0,40] F[0,60] wants a visit in each of [t, t + 60]: one between 40 and 60 s is in all of them."""
    scenario = load("pong", "G[0,40] F[0,60] pop in C")
    places = [(8, 1.25, -0.75), (55, 1.25, 0.25), (85, 2.5, 0.75), (100, 2.5, 0.75)]
    throw, visit, *rest = knots_of(scenario, places)
    assert faces(visit) == C
    assert visit.window == (40.0, 60.0)
    assert [faces(knot) for knot in (throw, *rest)] == [set(), set(), set()]
    # No visit is in all windows of G[0,80] F[0,60].
    assert not any(faces(knot) for knot in knots_of(load("pong", "G[0,40] F[0,20] pop in C"), places))


def test_a_disjunction_that_another_body_serves_binds_nothing() -> None:
    scenario = load("pong", "G[0,100] (pop in D -> snap not in B) & G[100,100] pop in D")
    throw, *_, end = knots_of(scenario, PONG)
    assert faces(throw) == set()
    assert faces(end) == D  # not to be outside of it


@pytest.mark.parametrize("area", ["B", "C"])
def test_of_two_visits_the_one_that_the_plan_makes_binds(area: str) -> None:
    places = {"B": (30, 2.5, -0.75), "C": (30, 1.25, 0.25)}
    scenario = load("pong", "F[0,100] pop in B or F[0,100] pop in C")
    _, visit, end = knots_of(scenario, [(8, 1.25, -0.75), places[area], (100, 2.5, 0.75)])
    assert faces(visit) == {"B": B, "C": C}[area]
    assert faces(end) == set()


def test_a_stay_binds_its_arrival_and_what_ends_it_alone() -> None:
    scenario = load("pong", "F[0,60] G[0,20] pop in B")
    places = [(8, 1.25, -0.75), (30, 2.5, -0.75), (55, 2.5, -0.75), (85, 2.5, 0.75), (100, 2.5, 0.75)]
    assert [faces(knot) for knot in knots_of(scenario, places)] == [set(), B, B, set(), set()]


def test_visits_in_order_bind_one_after_the_other() -> None:
    scenario = load("pong", "F[0,50] (pop in B & F[0,50] pop in C)")
    places = [(8, 1.25, -0.75), (30, 2.5, -0.75), (60, 1.25, 0.25), (85, 2.5, 0.75), (100, 2.5, 0.75)]
    assert [faces(knot) for knot in knots_of(scenario, places)] == [set(), B, C, set(), set()]


def test_a_flight_past_a_corner_binds_each_end_by_its_own_face() -> None:
    """No face of the block has both ends beyond it: no knot lies outside of what is demanded of it."""
    scenario = load("obstacle_avoidance", "G[150,150] pop in goal")
    first, second, *_ = knots_of(scenario, [(24, 3.6, 4.9), (52, 2.3, 3.6), (97, 2.3, 1.35), (123, 5, 1), (150, 5, 1)])
    assert faces(first) == {(0, -1, -4.2)}
    assert faces(second) == {(1, 0, 2.8)}


def test_a_stay_counts_from_the_arrival_and_only_there() -> None:
    places = [(8, 1.25, -0.75), (30, 2.5, -0.75), (100, 2.5, -0.75)]
    first, catch, end = knots_of(load("pong", "F[0,60] G[0,20] pop in B"), places)
    assert (first.stay, catch.stay, end.stay) == (0.0, 20.0, 0.0)
    assert catch.window == (0.0, 60.0)
    assert all(knot.stay == 0.0 for knot in knots_of(load("pong", "F[0,60] pop in B"), places))
    assert all(knot.stay == 0.0 for knot in knots_of(load("pong", "G[50,60] pop in B"), places))


def test_a_place_that_is_passed_between_knots_is_noted_where_it_is_passed_best() -> None:
    places = [(10, 0.0, 0.25), (50, 5.0, 0.25), (100, 5.0, 0.25)]  # through C, from 1 to 1.5 m
    first, second, end = knots_of(load("pong", "F[0,100] pop in C"), places)
    assert first.via is not None
    assert first.via.share == pytest.approx(0.25, abs=1 / 64)
    assert first.via.position == pytest.approx((1.25, 0.25), abs=5 / 64)
    assert first.via.depth == pytest.approx(0.25, abs=5 / 64)
    assert first.via.closes == 100.0
    assert second.via is None
    assert end.via is None
    # In time only.
    assert all(knot.via is None for knot in knots_of(load("pong", "F[60,100] pop in C"), places))
    # A knot that serves it is bound instead.
    assert all(knot.via is None for knot in knots_of(load("pong", "F[0,100] pop in C"), PONG))


def test_what_has_to_hold_after_a_place_that_is_passed_binds_the_knots_after_it() -> None:
    places = [(10, 0.0, 0.25), (50, 2.5, 0.25), (100, 2.5, 0.25)]  # through C, from 1 to 1.5 m, to 2.5 m
    order = load("pong", "F[0,40] (pop in C & F[0,50] pop.x >= 2)")
    first, second, _ = knots_of(order, places)
    assert first.via is not None
    assert first.via.closes == 40.0
    assert (-1, 0, -2) in faces(second)
    assert not faces(first)


def test_until_binds_the_knot_that_serves_it_and_what_has_to_hold_before() -> None:
    places = [(8, 1.25, -0.75), (30, 2.5, -0.75), (100, 2.5, -0.75)]
    first, catch, end = knots_of(load("pong", "(pop not in C) U[0,60] pop in B"), places)
    assert faces(catch) >= B
    assert catch.window == (0.0, 60.0)
    assert faces(first) == {(0, 1, 0)}  # below C, as the plan
    assert not faces(end) & {(0, 1, 0)}  # after it has been in B it may go anywhere
    passed = knots_of(load("pong", "(pop not in D) U[0,100] pop in C"), [(10, 0, 0.25), (50, 5, 0.25), (100, 5, 0.25)])
    assert passed[0].via is not None
