import math

import numpy as np
import pytest

from impact_envs.physics.convex import Disc, Polygon, compute_contact, compute_faces
from impact_envs.physics.time_of_impact import (
    find_crossing,
    find_disc_impact,
    find_face_impact,
    find_fall,
)


def first_fall(coefficients, end):
    """First downward crossing by companion matrix; coefficients from the highest power down."""
    roots = np.roots(coefficients)
    real = np.sort(roots.real[(abs(roots.imag) < 1e-9) & (roots.real >= 0) & (roots.real <= end)])
    falling = [t for t in real if np.polyval(np.polyder(coefficients), t) < 0]
    return falling[0] if falling else math.inf


def test_disc_impact_equals_the_companion_matrix():
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(1500):
        p, v, a = rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2)
        r, end = rng.uniform(0.1, 0.5), 2.0
        if np.linalg.norm(p) <= r:
            continue
        quartic = [a @ a / 4, v @ a, v @ v + p @ a, 2 * p @ v, p @ p - r * r]
        expected = first_fall(quartic, end)
        found = find_disc_impact(*p, *v, *a, r, 0.0, end)
        assert (found == math.inf) == (expected == math.inf)
        if found < math.inf:
            hits += 1
            depth = abs(np.polyval(np.polyder(quartic), found))
            assert found == pytest.approx(expected, abs=1e-9 / max(depth, 1e-3))
    assert hits > 200


def test_bodies_that_part_after_touching_do_not_touch_again():
    assert find_disc_impact(0.4, 0.0, 0.1, 0.2, 0.0, 0.0, 0.4, 0.0, 10.0) == math.inf
    overlap = 0.4 - 1e-9
    assert find_disc_impact(overlap, 0.0, 0.1, 0.2, 0.0, 0.0, 0.4, 0.0, 10.0) == math.inf


def test_pressed_bodies_touch_again_when_the_parabola_says():
    # Parting at 0.1 m/s under an approach acceleration of 0.2 m/s^2: back after 1 s.
    assert find_disc_impact(0.4, 0.0, 0.1, 0.0, -0.2, 0.0, 0.4, 0.0, 10.0) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("height", "speed", "acceleration", "expected"),
    [
        (1.0, -2.0, 0.0, 0.5),
        (1.0, 0.0, -2.0, 1.0),
        (1.0, -1.0, 1.0, math.inf),
        (-1.0, 3.0, -4.0, 1.0),
        (-1.0, -1.0, -1.0, math.inf),
        (0.0, 0.5, -1.0, 1.0),
        (1.0, 1.0, 0.0, math.inf),
        # Behind a face and on the way out, hardly accelerated: rounding takes speed and root for equal.
        (-1.7534, -1.4946e-3, -9.3e-24, math.inf),
    ],
)
def test_fall(height, speed, acceleration, expected):
    assert find_fall(height, speed, acceleration) == pytest.approx(expected)


def test_box_impact_equals_fine_sampling():
    rng = np.random.default_rng(2)
    box = ((-0.3, -0.1), (0.3, -0.1), (0.3, 0.1), (-0.3, 0.1))
    faces, radius, end, hits = compute_faces(box), 0.15, 2.0, 0
    times = np.linspace(0, end, 4001)
    for _ in range(200):
        p, v, a = rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2)
        path = p[:, None] + v[:, None] * times + a[:, None] * times**2 / 2
        away = np.hypot(np.maximum(abs(path[0]) - 0.3, 0), np.maximum(abs(path[1]) - 0.1, 0)) - radius
        if away[0] <= 0:
            continue
        found = min(find_face_impact(*p, *v, *a, face, radius, 0.0, end) for face in faces)
        inside = np.flatnonzero(away < 0)
        if len(inside):
            hits += 1
            assert times[inside[0] - 1] - 1e-9 <= found <= times[inside[0]] + 1e-9
        elif found < math.inf:
            x, y = p + v * found + a * found**2 / 2
            assert compute_contact(Disc(x, y, radius), Polygon(box)).gap == pytest.approx(0, abs=1e-9)
    assert hits > 30


def test_disc_behind_a_face_does_not_hit_it():
    faces = compute_faces(((-0.001, -0.3), (0.001, -0.3), (0.001, 0.3), (-0.001, 0.3)))
    # Left of a thin wall and flying off to the left: the right face is behind.
    assert min(find_face_impact(-0.3, 0.0, -9.0, 1.0, -1.0, 0.0, f, 0.2, 0.0, 0.1) for f in faces) == math.inf


def test_crossing_equals_the_exact_time():
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(100):
        p, v, a = rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2)
        if np.linalg.norm(p) <= 0.3:
            continue

        def gap(t, p=p, v=v, a=a):
            return float(np.linalg.norm(p + v * t + a * t * t / 2) - 0.3)

        rate = float(np.linalg.norm(v) + np.linalg.norm(a) * 2.0)
        exact = find_disc_impact(*p, *v, *a, 0.3, 0.0, 2.0)
        found = find_crossing(gap, rate, 1e-3, 1e-10, 2.0)
        if exact < math.inf:
            hits += 1
            assert gap(found) == pytest.approx(0, abs=1e-9)
            assert found == pytest.approx(exact, abs=1e-4)
        else:
            assert found == math.inf
    assert hits > 20
