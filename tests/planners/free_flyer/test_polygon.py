"""Objects that are no discs are hit through their centre, or the expert says that it cannot."""

from __future__ import annotations

import math

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, rollout
from planners import make_expert, make_plan
from planners.free_flyer.belief.plan_table import find_central_hits

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


@pytest.mark.parametrize(("heading", "central"), [(0.0, True), (math.pi / 4, True), (0.3, False)])
def test_throws_and_catches_a_square(heading: float, central: bool) -> None:
    change = {"objects.pop.vertices": SQUARE.tolist(), "objects.pop.heading": heading}
    scenario = load_scenario("throw_and_catch").override(change)
    expert = make_expert(scenario, make_plan(scenario))
    episode = rollout(parallel_env(scenario), expert, SEED)
    assert episode.success
    assert [(impact.a, impact.b) for impact in episode.impacts] == [("snap", "pop"), ("crackle", "pop")]
    assert ("off_centre" not in episode.fallbacks) == central
    # A hit through the centre does not turn the object.
    assert abs(episode.signals["pop.heading"][-1] - heading) < (2e-3 if central else 0.05)
    assert episode.robustness > (0.24 if central else 0.0)
