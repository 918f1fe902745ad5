"""What is added to the OSDRE does what it says: the drift is cancelled, the arm calmed, the box kept off."""

import math
from dataclasses import replace

import numpy as np
import pytest

import impact_envs
from impact_envs.floating_manipulator.contact import compute_contact
from impact_envs.floating_manipulator.model import FloatingManipulatorModel
from impact_envs.floating_manipulator.observation import Measurement
from planners.floating_manipulator.compensation import avoid_box, compensate_drift
from planners.floating_manipulator.expert import FloatingManipulatorExpert
from planners.floating_manipulator.options import EXPERT

GOAL = np.array([3.0, 0.0])
OPTIONS = EXPERT.compensation


def draw_case(seed, n=3):
    """Drift, B of a well-posed arm, joint rates and torques."""
    rng = np.random.default_rng(seed)
    return (
        0.1 * rng.normal(size=2),
        rng.uniform(0.2, 1.0, (2, n)) * [[1.0], [-1.0]] + np.eye(2, n),
        rng.normal(size=n),
        rng.normal(size=n),
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("n", [2, 3, 5])
def test_drift_is_cancelled_and_damping_does_not_move_the_tip(seed, n):
    drift, B, rates, before = draw_case(seed, n)
    after = before.copy()
    compensate_drift(OPTIONS, drift, B, rates, after)
    # to (s / sigma)^2 of what is to be cancelled, s = 0.01 and sigma the least singular value
    least = np.linalg.svd(B)[1][1]
    wanted = np.abs(drift).max() + 0.5 * np.abs(B @ rates).max()
    np.testing.assert_allclose(drift + B @ after, B @ before, atol=2 * wanted * (0.01 / least) ** 2)


@pytest.mark.parametrize("seed", range(5))
def test_damping_takes_energy_from_internal_motion_only(seed):
    _, B, rates, _ = draw_case(seed)
    torques = np.zeros(3)
    compensate_drift(OPTIONS, np.zeros(2), B, rates, torques)
    internal = np.linalg.svd(B)[2][2]
    assert rates @ torques <= 0.0
    np.testing.assert_allclose(internal @ torques, -0.5 * internal @ rates, atol=1e-12)
    rates = B.T @ [0.3, -0.2]  # nothing internal
    torques = np.zeros(3)
    compensate_drift(OPTIONS, np.zeros(2), B, rates, torques)
    np.testing.assert_allclose(torques, 0.0, atol=1e-3)


@pytest.mark.parametrize("speed", [-0.3, 0.0, 0.3])
@pytest.mark.parametrize("distance", [0.01, 0.1, 1.0])
def test_tip_comes_near_no_faster_than_allowed_by_the_smallest_change(speed, distance):
    drift, B, _, before = draw_case(1)
    contact = compute_contact(
        (1.0 + distance, 0.2, speed, 0.1, *drift), 0.001, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 1.0
    )
    after = before.copy()
    avoid_box(OPTIONS, contact, B, after)

    def margin(u):
        acceleration = contact.bias + contact.nx * B[0] @ u + contact.ny * B[1] @ u
        rate = OPTIONS.approach_rate
        return acceleration + 2 * rate * contact.rate + rate**2 * (contact.gap - OPTIONS.clearance)

    if margin(before) >= 0.0:
        np.testing.assert_array_equal(after, before)
    else:
        assert margin(after) == pytest.approx(0.0, abs=1e-3 * abs(margin(before)))
        row = contact.nx * B[0] + contact.ny * B[1]
        np.testing.assert_allclose(np.cross(after - before, row), 0.0, atol=1e-12)


def play(expert, physics, scenario, until):
    """Impacts and distances of the tip from its goal."""
    model, touched, errors, times = FloatingManipulatorModel(scenario), False, [], []
    model.reset(physics)
    expert.reset(0)
    while model.time < until - 1e-9:
        box = model.state()[-2, [0, 1, 4, 2, 3, 5]]
        expert.take_measurement(Measurement(model.time, *model.coordinates(), touched, box))
        impacts = model.step(expert.compute_controls())
        touched, times = bool(impacts), times + [impact.time for impact in impacts]
        errors.append(math.dist(model.state()[-3, :2], GOAL))
    return times, np.array(errors)


def test_a_light_load_is_held_only_with_compensation():
    scenario = impact_envs.load_scenario("floating_manipulator_thrusters").override({"true.load_mass_scale": 0.6})
    physics = scenario.draw(np.random.default_rng(0))
    held, drifting = (
        play(FloatingManipulatorExpert(scenario, variant), physics, scenario, 30.0)[1][5000:].max()
        for variant in (None, "published")
    )
    assert held < 0.02
    assert drifting > 0.05


def test_a_grazed_box_is_hit_again_only_without_compensation():
    scenario = impact_envs.load_scenario("floating_manipulator_thrusters").suite("all")
    physics = scenario.draw(np.random.default_rng(7))
    grazed = replace(
        physics,
        restitution=0.81,
        restitution_speed=0.0,
        chain=scenario.chain(1.0, 0.55),
        box_mass=9.78,
        box_inertia=9.78 / 6,
        box_start=np.array([3.48, -0.57, -0.27]),
        stall_torque=np.full(3, 13.0),
        no_load_speed=np.full(3, 0.43),
    )
    once, _ = play(FloatingManipulatorExpert(scenario), grazed, scenario, 16.0)
    twice, _ = play(FloatingManipulatorExpert(scenario, "published"), grazed, scenario, 16.0)
    assert len(once) == 1
    assert len(twice) == 2


# The box so near that the tip hits it in the first second, and hits it again after the pause.
SOON = {"box.start": [6.98, 1.5], "safety_pause": 0.5}


@pytest.mark.parametrize(
    ("name", "until", "same"),
    [
        ("floating_manipulator_thrusters", 0.19, True),  # before the impact
        ("floating_manipulator_thrusters", 2.0, False),
        ("floating_manipulator", 2.0, True),  # nothing drives the base
    ],
)
def test_compensation_comes_after_the_impact_and_only_where_the_base_is_driven(name, until, same):
    scenario = impact_envs.load_scenario(name).override(SOON)
    physics = scenario.draw(np.random.default_rng(0))
    (times, plain), (_, compensated) = (
        play(FloatingManipulatorExpert(scenario, variant), physics, scenario, until) for variant in ("published", None)
    )
    assert bool(times) == (until > 1.0)
    assert np.array_equal(plain, compensated) == same
