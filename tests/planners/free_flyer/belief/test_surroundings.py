"""Distances to walls and solid obstacles are those of geometry, from outside and from inside."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.free_flyer.belief.plan_table import PlanTable, make_plan_table
from planners.free_flyer.belief.surroundings import WALLS, is_way_clear, measure_distance, measure_gap
from tests.planners.free_flyer.plans import load, make_plan

TRIANGLE = ((1.0, 7.0), (3.0, 7.0), (2.0, 9.0))
BOX, SHARP = WALLS, WALLS + 1
RADIUS = 0.2


@pytest.fixture(scope="module")
def table() -> PlanTable:
    """Return the crew's world of 10 m: a pillar from 4 to 6 m, a triangle, and an area that stops nobody."""
    scenario = load("crew")
    item = scenario.obstacles["pillar"]
    areas = {
        "pillar": item,
        "wedge": {"vertices": TRIANGLE, "solid": True},
        "shade": {"lower": [0.0, 0.0], "upper": [9.9, 9.9]},
    }
    scenario = scenario.override({"obstacles": areas})
    return make_plan_table(scenario, make_plan(scenario))


@pytest.mark.parametrize(
    ("body", "place", "distance", "direction"),
    [
        (0, (3.0, 2.0), 3.0, (-1.0, 0.0)),
        (1, (3.0, 2.0), 2.0, (0.0, -1.0)),
        (2, (3.0, 2.0), 7.0, (1.0, 0.0)),
        (3, (3.0, 11.0), -1.0, (0.0, 1.0)),
        (BOX, (3.0, 5.5), 1.0, (1.0, 0.0)),
        (BOX, (5.0, 8.0), 2.0, (0.0, -1.0)),
        (BOX, (7.0, 7.0), math.sqrt(2.0), (-math.sqrt(0.5), -math.sqrt(0.5))),
        (BOX, (4.3, 5.0), -0.3, (1.0, 0.0)),
        (SHARP, (2.0, 9.5), 0.5, (0.0, -1.0)),
        (SHARP, (2.0, 7.1), -0.1, (0.0, 1.0)),
    ],
)
def test_distance_and_direction(
    table: PlanTable, body: int, place: tuple[float, float], distance: float, direction: tuple[float, float]
) -> None:
    assert measure_distance(table, body, *place) == pytest.approx((distance, *direction), abs=1e-12)


def test_gap_is_that_to_the_nearest_point_of_all_solids(table: PlanTable) -> None:
    along, rng = np.linspace(0.0, 1.0, 2001)[:, None], np.random.default_rng(0)
    rings = [((4, 4), (6, 4), (6, 6), (4, 6)), TRIANGLE, ((0, 0), (0, 10), (10, 10), (10, 0))]
    edges = [(np.array(a), np.array(b)) for ring in rings for a, b in zip(ring, (*ring[1:], ring[0]), strict=True)]
    points = np.vstack([a + along * (b - a) for a, b in edges])
    for place in rng.uniform(0.0, 10.0, (200, 2)):
        inside = any(
            all((b[0] - a[0]) * (place[1] - a[1]) > (b[1] - a[1]) * (place[0] - a[0]) for a, b in edges[i:j])
            for i, j in ((0, 4), (4, 7))
        )
        nearest = np.hypot(*(points - place).T).min()
        assert measure_gap(table, 0, *place) + RADIUS == pytest.approx(-nearest if inside else nearest, abs=1e-3)


def test_a_way_past_a_corner_is_clear_if_the_disc_fits(table: PlanTable) -> None:
    assert not is_way_clear(table, 0, 3.0, 5.0, 7.0, 5.0)
    assert not is_way_clear(table, 0, 3.0, 6.15, 7.0, 6.15)
    assert is_way_clear(table, 0, 3.0, 6.25, 7.0, 6.25)
    assert is_way_clear(table, 0, 4.1, 6.1, 4.1, 7.0)  # it touches, and leaves


def test_an_area_that_the_formula_forbids_counts_for_those_it_names_and_from_their_centres() -> None:
    scenario = load("crew")
    areas = {
        "shade": {"lower": [4.0, 4.0], "upper": [6.0, 6.0]},
        "sometimes": {"lower": [0.0, 0.0], "upper": [9.0, 9.0]},
    }
    name = scenario.agents[0]
    formula = f"G[0,{scenario.horizon:g}] {name} not in shade & G[0,10] {name} not in sometimes"
    scenario = scenario.override({"obstacles": areas, "formula": formula})
    table = make_plan_table(scenario, make_plan(scenario))
    assert len(table.solid) == 1
    assert measure_gap(table, 0, 3.5, 5.0) == pytest.approx(0.5)
    assert measure_gap(table, 0, 4.5, 5.0) == pytest.approx(-0.5)
    assert measure_gap(table, 1, 4.5, 5.0) == pytest.approx(4.5 - RADIUS)  # to a wall of the world
    assert not is_way_clear(table, 0, 3.0, 5.0, 7.0, 5.0)
    assert is_way_clear(table, 1, 3.0, 5.0, 7.0, 5.0)
