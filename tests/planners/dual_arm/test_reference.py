import math
import os
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import impact_envs
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.errors import InputError
from planners.dual_arm import impact_prediction
from planners.dual_arm.impact_prediction import hash_inputs, load_impact_map, place_arms, simulate_impacts
from planners.dual_arm.options import EXPERT
from planners.dual_arm.reference import (
    PostField,
    compute_ante_acceleration,
    compute_ante_rate,
    compute_ante_velocity,
    compute_post_reference,
    compute_smoothstep,
    make_impact_map,
    predict_twist,
)
from planners.dual_arm.reference_spreading import make_ante_field
from planners.options import replace_options

PATH = Path(impact_envs.__file__).parent / "dual_arm" / "scenarios" / "dual_arm_grasp.toml"
SCENARIO = DualArmScenario.model_validate(tomllib.loads(PATH.read_text()))
CONTROLLER = EXPERT.controller
FIELD = make_ante_field(SCENARIO, CONTROLLER)
POST = PostField(
    np.array([0.0, 0.3, 0.0]),
    np.array([0.01, 0.24, 0.1]),
    SCENARIO.target.array,
    kappa=4.0,
    kappa_theta=3.0,
    r_max=0.25,
    blend=True,
)
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def simulated():
    return simulate_impacts(SCENARIO.as_believed(), EXPERT)


def test_the_smoothstep_is_once_differentiable():
    for r in (0.24, 0.3, 0.4):
        value, slope = compute_smoothstep(r, 0.24, 0.4)
        ahead, behind = compute_smoothstep(r + 1e-6, 0.24, 0.4)[0], compute_smoothstep(r - 1e-6, 0.24, 0.4)[0]
        assert slope == pytest.approx((ahead - behind) / 2e-6, abs=1e-3)
        assert behind <= value <= ahead


def test_the_ante_field_keeps_its_speed_outside_and_is_constant_inside():
    speed = math.hypot(*CONTROLLER.impact_velocity)
    for x, y in RNG.uniform(-1.0, 1.0, (200, 2)):
        for i in range(2):
            v = compute_ante_velocity(FIELD, i, x, y)
            r = math.hypot(x, y - 0.3)
            if r >= CONTROLLER.r_max:
                assert math.hypot(*v) == pytest.approx(speed)
            elif r <= CONTROLLER.r_min:
                assert v == tuple(FIELD.velocities[i])
            else:
                assert math.hypot(*v) <= speed + 1e-12


def test_accelerations_are_derivatives_along_the_fields():
    h = 1e-6
    for x, y in RNG.uniform(-0.6, 0.6, (200, 2)):
        v = np.array(compute_ante_velocity(FIELD, 0, x, y))
        ahead = np.array(compute_ante_velocity(FIELD, 0, x + h * v[0], y + h * v[1]))
        behind = np.array(compute_ante_velocity(FIELD, 0, x - h * v[0], y - h * v[1]))
        assert compute_ante_acceleration(FIELD, 0, x, y) == pytest.approx((ahead - behind) / (2 * h), abs=1e-3)
        heading = float(RNG.uniform(-1.0, 1.0))
        reference = np.array(compute_post_reference(POST, x, y, heading))
        ahead, behind = (
            np.array(compute_post_reference(POST, *(np.array([x, y, heading]) + sign * h * reference[:3])))
            for sign in (1.0, -1.0)
        )
        assert reference[3:] == pytest.approx((ahead - behind)[:3] / (2 * h), abs=1e-3)


def test_the_path_of_the_ante_field_ends_near_the_impact_point_with_the_impact_velocity():
    p = SCENARIO.arms["arm_1"].start.array[:2]
    for _ in range(5000):
        p = p + 1e-3 * np.array(compute_ante_velocity(FIELD, 0, *p))
        if p[0] >= -SCENARIO.box.half_width:
            break
    assert p == pytest.approx(FIELD.points[0], abs=5e-3)
    assert compute_ante_velocity(FIELD, 0, *p) == pytest.approx(CONTROLLER.impact_velocity)


def test_turns_take_the_short_way():
    for turn in (-3.0, -0.5, 0.5, 3.0):
        for whole in (-2, 0, 1):
            rate, acceleration = compute_ante_rate(FIELD, 1, math.pi - turn + math.tau * whole)
            assert rate == pytest.approx(FIELD.kappa_theta * turn)
            assert acceleration == pytest.approx(-FIELD.kappa_theta * rate)


def test_the_post_field_starts_with_the_prediction_and_ends_at_the_target():
    assert compute_post_reference(POST, 0.0, 0.3, 0.0)[:3] == pytest.approx((0.01, 0.24, 0.1))
    assert compute_post_reference(POST, *POST.target)[:3] == pytest.approx((0.0, 0.0, 0.0))
    plain = POST._replace(blend=False)
    assert compute_post_reference(plain, 0.0, 0.3, 0.0)[:2] == pytest.approx((1.0, 1.2))


def test_the_interpolation_is_exact_at_its_nodes_and_clipped_outside():
    heights = np.array([(a, b) for a in (-0.05, 0.0, 0.05) for b in (-0.05, 0.0, 0.05)])
    twists, predicted = RNG.normal(0.0, 1.0, (9, 3)), np.zeros(3)
    impact_map = make_impact_map(heights, twists, 15.0)
    for pair, twist in zip(heights, twists, strict=True):
        predict_twist(impact_map, pair, predicted)
        assert predicted == pytest.approx(twist)
    predict_twist(impact_map, np.array([1.0, -1.0]), predicted)
    assert predicted == pytest.approx(twists[6])


def test_simulated_impacts_start_on_the_faces_at_the_reference_velocity():
    from impact_envs.dual_arm.arm import compute_kinematics

    q, v = place_arms(SCENARIO, CONTROLLER, np.array([0.03, -0.02]))
    for i, (height, arm) in enumerate(zip((0.03, -0.02), SCENARIO.arm_numbers(), strict=True)):
        pose, J, drift = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
        compute_kinematics(arm, q[i], v[i], pose, J, drift)
        assert pose[:2] == pytest.approx((-0.15 + 0.3 * i, 0.3 + height))
        assert J @ v[i] == pytest.approx((*compute_ante_velocity(FIELD, i, *pose[:2]), 0.0))


def test_predicted_velocities_mirror_as_the_impacts_do(simulated):
    heights, twists = simulated
    assert heights.shape == (25, 2)
    grid = twists.reshape(5, 5, 3)
    assert grid.transpose(1, 0, 2) == pytest.approx(grid * np.array([-1.0, 1.0, -1.0]), abs=1e-3)
    # the box leaves with about the vertical velocity of the pads that hit it
    assert np.all((grid[..., 1] > 0.2) & (grid[..., 1] < 0.28))


def test_predictions_are_kept_on_disk(simulated, tmp_path, monkeypatch):
    monkeypatch.setenv("IMPACT_ENVS_CACHE", str(tmp_path))
    calls = []
    monkeypatch.setattr(impact_prediction, "simulate_impacts", lambda *_: calls.append(1) or simulated)
    first = load_impact_map(SCENARIO, EXPERT)
    again = load_impact_map(SCENARIO, EXPERT)
    assert len(calls) == 1
    assert np.array_equal(first.weights, again.weights)
    (file,) = tmp_path.iterdir()
    file.write_bytes(b"broken")
    assert np.array_equal(load_impact_map(SCENARIO, EXPERT).weights, first.weights)
    assert len(calls) == 2
    assert [path.suffix for path in tmp_path.iterdir()] == [".npz"]


def test_predictions_are_named_by_what_is_believed():
    def name_with(**values):
        return hash_inputs(SCENARIO.as_believed(), replace_options(EXPERT, values))

    name = name_with()
    blind = SCENARIO.model_copy(update={"true": SCENARIO.true.model_copy(update={"box_y": 0.01})})
    assert hash_inputs(blind.as_believed(), EXPERT) == name
    heavier = SCENARIO.model_copy(update={"box": SCENARIO.box.model_copy(update={"mass": 3.0})})
    assert hash_inputs(heavier.as_believed(), EXPERT) != name
    assert name_with(**{"controller.k_p": 60.0}) != name
    assert name_with(**{"prediction.greatest_height": 0.04}) != name
    assert name_with(**{"controller.k_int": 60.0}) == name


def test_a_directory_that_cannot_be_written_stops_nothing(simulated, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("IMPACT_ENVS_CACHE", os.fspath(tmp_path / "file" / "below"))
    monkeypatch.setattr(impact_prediction, "simulate_impacts", lambda *_: simulated)
    assert load_impact_map(SCENARIO, EXPERT).weights.shape == (3, 25)


def test_radii_inside_the_box_are_refused():
    with pytest.raises(InputError, match=r"r_min = 0.1 and r_max = 0.3"):
        make_ante_field(SCENARIO, replace(CONTROLLER, r_min=0.1))
