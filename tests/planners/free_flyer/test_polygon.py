"""Objects that are no discs are hit through their centre, or the expert says that it cannot."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, rollout
from planners import make_expert, make_plan
from planners.free_flyer.specification.central_hit import find_central_hits
from planners.plan import Plan

SQUARE = np.array([[0.14, -0.14], [0.14, 0.14], [-0.14, 0.14], [-0.14, -0.14]])
SEED = 1_000_001


def test_a_square_is_pushed_through_its_centre_at_its_sides_and_corners() -> None:
    hits = find_central_hits(SQUARE)
    angles = np.sort(np.degrees(np.arctan2(hits[:, 1], hits[:, 0])) % 360)
    np.testing.assert_allclose(angles, np.arange(0, 360, 45), atol=1e-9)
    along = np.abs(hits[:, :2]).max(axis=1) > 0.99
    np.testing.assert_allclose(hits[along, 2], 0.14)
    np.testing.assert_allclose(hits[~along, 2], 0.14 * math.sqrt(2))


def test_a_side_whose_foot_lies_beside_it_and_an_obtuse_corner_are_no_places_to_push() -> None:
    sheared = np.array([[0.2, -0.05], [0.3, 0.05], [-0.2, 0.05], [-0.3, -0.05]])
    hits = find_central_hits(sheared)
    # The long sides; the corners that stick out. The slanted sides' feet lie beyond their ends.
    np.testing.assert_allclose(sorted(hits[:, 2]), [0.05, 0.05, math.hypot(0.3, 0.05), math.hypot(0.3, 0.05)])
    assert find_central_hits(np.zeros((0, 2))).shape == (0, 3)


RECTANGLE = np.array([[0.18, -0.08], [0.18, 0.08], [-0.18, 0.08], [-0.18, -0.08]])
SLOW = {("rectangle", 30.0), ("rectangle", 150.0)}  # four impacts are needed
CASES = [
    pytest.param(vertices, math.radians(h), id=f"{name} {h}", marks=[pytest.mark.slow] if (name, h) in SLOW else [])
    for name, vertices, step in (("square", SQUARE, 7.5), ("rectangle", RECTANGLE, 15.0))
    for h in np.arange(12) * step
]


@pytest.mark.parametrize(("vertices", "heading"), CASES)
def test_a_flight_keeps_what_the_plan_for_a_polygon_promises(vertices: np.ndarray, heading: float) -> None:
    change = {"objects.pop.vertices": vertices.tolist(), "objects.pop.heading": heading}
    scenario = load_scenario("throw_and_catch").override(change)
    plan = make_plan(scenario)
    assert plan.shape_error > 0.0
    episode = rollout(parallel_env(scenario), make_expert(scenario, plan), SEED)
    assert episode.robustness >= plan.robustness - plan.shape_error - 1e-3
    if plan.shape_error < 0.05:
        # Hit through its centre: what the plan says is nearly exact, and the object does not turn.
        assert episode.success
        assert episode.robustness > plan.robustness - 0.02
        assert "off_centre" not in episode.fallbacks
        assert abs(episode.signals["pop.heading"][-1] - heading) < 0.05


def test_impulses_on_polygons_are_planned_through_their_centres() -> None:
    change = {"objects.pop.vertices": SQUARE.tolist(), "objects.pop.heading": 0.3}
    plan = make_plan(load_scenario("throw_and_catch").override(change))
    # From (0.5, 1.5) along a side's normal into the goal's corner: 0.25 - x = y, x = (0.5 + y) tan 0.3.
    slope = math.tan(0.3)
    assert plan.robustness == pytest.approx((0.25 - 0.5 * slope) / (1.0 + slope), abs=1e-3)
    for impact in plan.impacts:
        angle = (math.atan2(impact.normal[1], impact.normal[0]) - 0.3) % (math.pi / 4)
        assert min(angle, math.pi / 4 - angle) < 1e-4
    assert Plan.from_json(plan.to_json()) == plan


def test_plans_of_discs_have_no_shape_error_and_read_without_it() -> None:
    plan = make_plan("throw_and_catch")
    assert plan.shape_error == 0.0
    stored = json.loads(plan.to_json())
    del stored["shape_error"]
    assert Plan.from_json(json.dumps(stored)) == plan


def test_what_cannot_be_hit_through_its_centre_is_planned_as_a_disc_and_says_so() -> None:
    change = {"objects.pop.vertices": RECTANGLE.tolist(), "objects.pop.heading": 0.45}
    plan = make_plan(load_scenario("throw_and_catch").override(change))
    assert plan.robustness == pytest.approx(0.25, abs=1e-3)
    assert plan.shape_error > 0.2
