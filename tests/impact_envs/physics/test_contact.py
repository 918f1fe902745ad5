import math

import numpy as np
import pytest

from impact_envs.physics.contact import compute_friction, compute_normal_force

PAD = (1e4, 1.4e5, 1.0)
RNG = np.random.default_rng(0)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_the_normal_force_never_pulls(exponent):
    for gap, rate in zip(RNG.uniform(-0.02, 0.02, 2000), RNG.normal(0.0, 2.0, 2000), strict=True):
        force = compute_normal_force(gap, rate, 1e4, 1.4e5, exponent)
        assert force >= 0.0
        assert (force > 0.0) == (gap < 0.0)


def test_the_normal_force_is_a_spring_at_rest_and_smooth_where_motion_turns():
    assert compute_normal_force(-0.01, 0.0, *PAD) == pytest.approx(100.0)
    h = 1e-6
    slopes = [(compute_normal_force(-0.01, r + h, *PAD) - compute_normal_force(-0.01, r, *PAD)) / h for r in (-h, 0.0)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-4)
    assert slopes[0] == pytest.approx(-1.4e5 * 0.01, rel=1e-4)


def test_no_force_jumps_at_first_touch():
    assert compute_normal_force(-1e-12, -1.0, *PAD) < 1e-6


def test_a_pressed_contact_gives_back_less_than_it_took():
    """A mass that hits the pad at 0.5 m/s leaves slower, whatever the damping."""
    for damping in (0.0, 1e4, 1.4e5):
        gap, rate, h = 0.0, -0.5, 1e-6
        while gap <= 0.0:
            rate += h * compute_normal_force(gap, rate, 1e4, damping, 1.0) / 3.0
            gap += h * rate
        assert rate == pytest.approx(0.5, rel=1e-3) if damping == 0.0 else 0.0 < rate < 0.5


def test_friction_only_dissipates_and_stays_inside_the_cone():
    for normal, slip in zip(RNG.uniform(0.0, 200.0, 2000), RNG.normal(0.0, 0.5, 2000), strict=True):
        force = compute_friction(normal, slip, 0.6, 1e3)
        assert force * slip >= 0.0
        assert abs(force) <= 0.6 * normal
        assert compute_friction(normal, -slip, 0.6, 1e3) == -force


def test_a_held_load_creeps_as_documented():
    slip = math.tan(math.pi / 2 * 0.5) / 1e3
    assert compute_friction(100.0, slip, 0.6, 1e3) == pytest.approx(0.5 * 0.6 * 100.0)
