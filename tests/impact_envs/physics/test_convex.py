import math

import numpy as np
import pytest

from impact_envs.physics.convex import Disc, Polygon, compute_contact

BOX = ((-0.3, -0.1), (0.3, -0.1), (0.3, 0.1), (-0.3, 0.1))


def moved(vertices, x, y, heading=0.0):
    c, s = math.cos(heading), math.sin(heading)
    return Polygon(tuple((x + c * px - s * py, y + s * px + c * py) for px, py in vertices))


def outline(polygon, n=60):
    corners = np.array(polygon.vertices)
    shares = np.linspace(0, 1, n)[:, None]
    return np.vstack([p + shares * (q - p) for p, q in zip(corners, np.roll(corners, -1, 0), strict=True)])


def test_discs():
    contact = compute_contact(Disc(0, 0, 0.2), Disc(0.3, 0.4, 0.1))
    assert contact.gap == pytest.approx(0.2)
    assert contact.normal == pytest.approx((0.6, 0.8))
    assert contact.points[0] == pytest.approx((0.12, 0.16))


@pytest.mark.parametrize(
    ("x", "y", "gap", "normal"),
    [
        (0.0, 0.5, 0.3, (0.0, -1.0)),  # above a face
        (0.6, 0.5, 0.3, (-0.6, -0.8)),  # beyond a corner
        (0.0, 0.05, -0.15, (0.0, -1.0)),  # inside
    ],
)
def test_disc_and_box(x, y, gap, normal):
    contact = compute_contact(Disc(x, y, 0.1 if gap < 0 or x == 0 else 0.2), Polygon(BOX))
    assert contact.gap == pytest.approx(gap)
    assert contact.normal == pytest.approx(normal)


def test_faces_that_lie_on_each_other_touch_along_their_common_part():
    contact = compute_contact(moved(BOX, 0, 0), moved(BOX, 0.4, 0.2))
    assert contact.gap == pytest.approx(0, abs=1e-15)
    assert contact.normal == pytest.approx((0, 1))
    assert sorted(point[0] for point in contact.points) == pytest.approx([0.1, 0.3])


def test_a_corner_touches_in_one_point():
    diagonal = math.hypot(0.3, 0.1)
    corner = math.atan2(0.1, 0.3)
    contact = compute_contact(moved(BOX, 0, 0), moved(BOX, 0, 0.1 + diagonal, math.pi / 2 - corner))
    assert contact.gap == pytest.approx(0, abs=1e-12)
    assert contact.points == (pytest.approx((0, 0.1), abs=1e-12),)


def test_gap_is_a_lower_bound_of_the_distance_and_never_zero_before_it():
    rng = np.random.default_rng(1)
    for _ in range(100):
        a = moved(BOX, 0, 0, rng.uniform(-3, 3))
        b = moved(BOX, *rng.uniform(-1, 1, 2), rng.uniform(-3, 3))
        gap = compute_contact(a, b).gap
        sampled = np.min(np.linalg.norm(outline(a)[:, None] - outline(b)[None], axis=2))
        if gap > 0:
            assert gap <= sampled + 1e-12
            assert sampled <= 2 * gap + 0.02  # a face sees at least half of a corner-to-corner distance here


def test_order_of_the_shapes_only_turns_the_normal():
    rng = np.random.default_rng(2)
    for _ in range(50):
        a = moved(BOX, 0, 0, rng.uniform(-3, 3))
        x, y = rng.uniform(-1, 1, 2)
        for b in (Disc(x, y, 0.2), moved(BOX, x, y, 1.0)):
            forth, back = compute_contact(a, b), compute_contact(b, a)
            assert forth.gap == pytest.approx(back.gap, abs=1e-12)
            if forth.gap > 0:
                assert forth.normal == pytest.approx((-back.normal[0], -back.normal[1]))
