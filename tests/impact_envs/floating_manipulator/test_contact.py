"""The tip's contact agrees with the general geometry of discs and polygons, and its rates with differences."""

import math

import numpy as np
import pytest

from impact_envs.floating_manipulator.contact import compute_contact
from impact_envs.physics.convex import Disc, Polygon
from impact_envs.physics.convex import compute_contact as compute_general_contact

HALF = (0.7, 0.4)
RADIUS = 0.05


def corners(x, y, heading):
    c, s = math.cos(heading), math.sin(heading)
    a, b = HALF
    return tuple((x + c * p - s * q, y + s * p + c * q) for p, q in ((-a, -b), (a, -b), (a, b), (-a, b)))


def test_gap_and_normal_are_those_of_disc_and_polygon():
    rng = np.random.default_rng(0)
    for _ in range(500):
        x, y, heading = rng.uniform(-2, 2, 3)
        px, py = rng.uniform(-2, 2, 2)
        contact = compute_contact((px, py, 0, 0, 0, 0), RADIUS, (x, y, heading, 0, 0, 0), *HALF)
        general = compute_general_contact(Polygon(corners(x, y, heading)), Disc(px, py, RADIUS))
        assert contact.gap == pytest.approx(general.gap, abs=1e-12)
        assert (contact.nx, contact.ny) == pytest.approx(general.normal, abs=1e-9)
        assert (x + contact.rx, y + contact.ry) == pytest.approx(general.points[0], abs=1e-12)


def test_rate_and_bias_are_derivatives_of_the_gap():
    rng = np.random.default_rng(1)
    h, corners_seen = 1e-4, 0
    for _ in range(300):
        tip, box = rng.uniform(-1, 1, 6), rng.uniform(-1, 1, 6)
        tip[:2] += 1.2 * np.sign(tip[:2])

        def look(t, tip=tip, box=box):
            here = (*(tip[:2] + t * tip[2:4] + t**2 / 2 * tip[4:]), *(tip[2:4] + t * tip[4:]), *tip[4:])
            return compute_contact(here, RADIUS, (*(box[:3] + t * box[3:]), *box[3:]), *HALF)

        now, before, after = look(0.0), look(-h), look(h)
        assert now.rate == pytest.approx((after.gap - before.gap) / (2 * h), abs=1e-6)
        assert now.bias == pytest.approx((after.rate - before.rate) / (2 * h), abs=1e-5)
        corners_seen += math.isclose(abs(now.rx * math.cos(box[2]) + now.ry * math.sin(box[2])), HALF[0]) and (
            math.isclose(abs(now.ry * math.cos(box[2]) - now.rx * math.sin(box[2])), HALF[1])
        )
    assert 30 < corners_seen < 270
