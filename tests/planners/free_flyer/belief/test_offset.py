"""The offset of a centre of mass is seen in how the geometric centre swings; where nothing turns it is nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import planners
from impact_envs.free_flyer.model import FreeFlyerModel
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.truth import OFFSET_X, OFFSET_Y
from impact_envs.vector import vector_env
from planners.free_flyer.belief.estimator import (
    compute_variance,
    correct_position,
    correct_velocity,
    extrapolate_flight,
    open_filters,
    predict_state,
    update_estimates,
)
from planners.free_flyer.belief.impact_parameters import compute_pair_gain, start_pairs
from planners.free_flyer.belief.offset import (
    compute_lever,
    compute_spin,
    correct_centre_velocity,
    extrapolate_swing,
    open_offset,
    swing_centre,
)
from planners.free_flyer.belief.options import EXPERT, Options, make_record
from planners.free_flyer.belief.plan_table import make_plan_table
from planners.free_flyer.belief.world_memory import FILTER, make_world_memory
from planners.free_flyer.next_impact.two_body import compute_lever_gain
from planners.options import replace_options
from tests.planners.free_flyer.plans import load, make_plan

SNAP, POP = 0, 2
PAIRS = ("pp", "pv", "pa", "pd", "vv", "va", "vd", "aa", "ad", "dd")
STATES = {name: (0, index) for index, name in enumerate(("position", "velocity", "drift", "offset"))}
OFFSET = np.array([0.024, -0.018])  # of the geometric centre from the centre of mass [m]
OFF = replace_options(EXPERT, {"offset": False})


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    return load("throw_and_catch").as_believed()


class Flight:
    """The engine and the estimator of a world in which pop's centre of mass is beside its centre."""

    def __init__(
        self, scenario: FreeFlyerScenario, rate: float, options: Options = EXPERT, friction: float = 0.0
    ) -> None:
        self.scenario, self.options = scenario, make_record(options)[0]
        self.model = FreeFlyerModel(scenario)
        physics = self.model.physics
        physics.body[POP, [OFFSET_X, OFFSET_Y]] = -OFFSET
        self.model.reset(physics)
        self.table = make_plan_table(scenario, make_plan(scenario))
        self.memory = make_world_memory(self.table, 1)
        open_filters(self.table, self.memory, self.options, 0)
        start_pairs(self.table, self.memory, self.options, 0)
        states = self.model.state()
        states[POP, 2:] = 0.05, -0.02, 0.0, rate
        self.model.set_state(states)
        self.memory.filter["P_vv"][0, POP] = 1.0  # how fast it is, is not known

    @property
    def z(self) -> Any:
        return self.memory.filter[0, POP]

    def observe(self, noise: np.ndarray | float = 0.0) -> None:
        states = self.model.state()
        body = np.zeros((3, 7))
        body[:, :4], body[:, 6] = states[:, :4], states[:, 5]
        body[:, 4], body[:, 5] = np.cos(states[:, 4]), np.sin(states[:, 4])
        body[:, :2] += noise
        if np.any(noise):
            body[:, 2:4] = 0.0
        joint = np.array([[*body.ravel(), 0.0, 0.0, self.model.time / self.scenario.horizon, -1.0, 1.0]])
        update_estimates(self.table, self.memory, self.options, 0, joint, self.model.time)

    def fly(self, seconds: float, noise: Callable[[], Any] = lambda: 0.0) -> None:
        for _ in range(round(seconds / self.scenario.control_period)):
            self.observe(noise())
            self.model.step({name: np.zeros(3) for name in self.scenario.robots})
        self.observe(noise())


def as_matrix(z: Any) -> np.ndarray:
    """Return a filter's covariance over the real numbers, shape (8, 8): all x, then all y."""
    P = np.zeros((4, 4), complex)
    rows, columns = np.triu_indices(4)
    P[rows, columns] = [complex(z[f"P_{pair}"]) for pair in PAIRS]
    P = P + np.triu(P, 1).conj().T
    return np.block([[P.real, -P.imag], [P.imag, P.real]])


def as_vector(z: Any) -> np.ndarray:
    return np.array([z[name] for name in STATES]).T.ravel()


def over_reals(F: Any) -> np.ndarray:
    """Return a complex linear map as a real one."""
    F = np.array(F)
    return np.block([[F.real, -F.imag], [F.imag, F.real]])


def test_filter_is_the_kalman_filter_of_both_axes() -> None:
    """Over the real numbers it has eight states, and axes that turning couples."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(4, 4)) + 1j * rng.normal(size=(4, 4))
    P = root @ root.conj().T
    z = np.zeros(1, FILTER)[0]
    for pair, value in zip(PAIRS, P[np.triu_indices(4)], strict=True):
        z[f"P_{pair}"] = value.real if pair[0] == pair[1] else value
    for name in STATES:
        z[name] = rng.normal(size=2)
    mean, P = as_vector(z), as_matrix(z)
    h, sigma, angle, after, rate = 0.3, 0.7, 0.4, 1.3, 0.9
    F = np.eye(4, dtype=complex)
    F[0, 1:3], F[1, 2] = (h, h * h / 2), h
    swing = np.eye(4, dtype=complex)
    swing[0, 3] = np.exp(1j * after) - np.exp(1j * angle)
    G = np.array([h * h / 2, h, 0, 0])
    predict_state(z, 0.2, -0.4, h, sigma)
    real = over_reals(F)
    mean = real @ mean + np.concatenate([0.2 * G, -0.4 * G])
    P = real @ P @ real.T + sigma**2 * np.kron(np.eye(2), np.outer(G, G))
    np.testing.assert_allclose(as_vector(z), mean, atol=1e-12)
    np.testing.assert_allclose(as_matrix(z), P, atol=1e-12)
    swing_centre(z, angle, after)
    real = over_reals(swing)
    mean, P = real @ mean, real @ P @ real.T
    np.testing.assert_allclose(as_matrix(z), P, atol=1e-12)
    g = 1j * rate * np.exp(1j * after)
    for row, variance in (([1, 0, 0, 0], 0.04), ([0, 1, 0, 0], 0.09), ([0, 1, 0, g], 0.05)):
        H = over_reals([row])
        value = rng.normal(size=2)
        if row[0]:
            correct_position(z, *value, variance)
        elif row[3]:
            correct_centre_velocity(z, *value, variance, after, rate)
        else:
            correct_velocity(z, *value, variance)
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + variance * np.eye(2))
        mean, P = mean + gain @ (value - H @ mean), P - gain @ H @ P
        np.testing.assert_allclose(as_vector(z), mean, atol=1e-11)
        np.testing.assert_allclose(as_matrix(z), P, atol=1e-11)


def test_start_velocity_is_the_geometric_centres() -> None:
    z = np.zeros(1, FILTER)[0]
    z["P_vv"] = 1e-8
    open_offset(z, 0.02, 0.7, 0.5)
    g = 1j * 0.5 * np.exp(0.7j)
    assert z["P_vv"] + 2 * (g * z["P_vd"].conjugate()).real + abs(g) ** 2 * z["P_dd"] == pytest.approx(1e-8, rel=1e-6)


def test_offset_is_seen_in_a_turning_flight(scenario: FreeFlyerScenario) -> None:
    flight = Flight(scenario, rate=0.45)
    flight.fly(3.0)
    np.testing.assert_allclose(flight.z["offset"], OFFSET, atol=1e-4)
    np.testing.assert_allclose(flight.z["velocity"], flight.model._movable[POP].velocity_at(_mass(flight)), atol=1e-4)


def _mass(flight: Flight) -> tuple[float, float]:
    body = flight.model._movable[POP]
    return body.x, body.y


def test_error_of_the_offset_is_as_the_filter_says(scenario: FreeFlyerScenario) -> None:
    """With noisy positions; errors over their standard deviations have a mean square of about 1."""
    ratios = []
    for seed in range(20):
        flight, rng = Flight(scenario, rate=0.45), np.random.default_rng(seed)
        flight.fly(12.0, lambda rng=rng: 5e-3 * rng.normal(size=(3, 2)))  # type: ignore[misc]
        ratios += list((flight.z["offset"] - OFFSET) / math.sqrt(flight.z["P_dd"]))
        assert math.sqrt(flight.z["P_dd"]) < 3e-3
    assert 0.5 < np.mean(np.square(ratios)) < 1.7


def test_where_nothing_turns_the_offset_counts_for_nothing(scenario: FreeFlyerScenario) -> None:
    flight, without = Flight(scenario, rate=0.0), Flight(scenario, rate=0.0, options=OFF)
    for each in (flight, without):
        rng = np.random.default_rng(1)
        each.fly(5.0, lambda rng=rng: 5e-3 * rng.normal(size=(3, 2)))  # type: ignore[misc]
    z, other = flight.z, without.z
    assert not z["offset"].any()
    assert z["P_dd"] == EXPERT.estimation.offset**2
    assert other["P_dd"] == 0.0
    for name in FILTER.names or ():
        if name != "P_dd":
            np.testing.assert_array_equal(z[name], other[name], err_msg=name)
    assert extrapolate_flight(flight.memory, 0, POP, 30.0) == extrapolate_flight(without.memory, 0, POP, 30.0)
    assert compute_variance(flight.memory, 0, POP, 30.0) == compute_variance(without.memory, 0, POP, 30.0)


def test_flight_is_predicted_as_the_engine_has_it(scenario: FreeFlyerScenario) -> None:
    flight = Flight(scenario, rate=-0.6)
    flight.fly(2.0)
    heading = flight.memory.heading[0, POP]
    z, at = flight.z, np.exp(1j * heading["angle"]) * complex(*OFFSET)
    z["offset"], z["drift"], z["still"] = OFFSET, 0.0, 0.0
    z["velocity"] = flight.model.state()[POP, 2:4] - heading["rate"] * np.array([-at.imag, at.real])
    z["position"] = flight.model.state()[POP, :2]
    time = flight.model.time + 7.0
    x, y, vx, vy = extrapolate_flight(flight.memory, 0, POP, time)
    _, _, ux, uy = extrapolate_swing(flight.memory, 0, POP, time)
    for _ in range(70):
        flight.model.step({name: np.zeros(3) for name in scenario.robots})
    np.testing.assert_allclose(flight.model.state()[POP, :4], [x, y, vx + ux, vy + uy], atol=1e-9)


def test_hit_beside_the_centre_of_mass_acts_as_in_the_engine(scenario: FreeFlyerScenario) -> None:
    """The change of velocity and of the rate, of objects that turn already, and the robot's recoil."""
    flight = Flight(scenario, rate=0.3)
    states = flight.model.state()
    n = np.array([math.cos(0.5), math.sin(0.5)])
    reach = scenario.robots["snap"].radius + scenario.objects["pop"].radius
    states[POP, 2:4] = 0.0
    states[SNAP, :2], states[SNAP, 2:4] = states[POP, :2] - (reach + 1e-3) * n, 0.2 * n
    flight.model.set_state(states)
    body, robot = flight.model._movable[POP], flight.model._movable[SNAP]
    before = np.array([body.vx, body.vy, body.omega, robot.vx, robot.vy])
    (hit,) = flight.model.step({name: np.zeros(3) for name in scenario.robots})
    n, angle = np.array(hit.normal), body.heading - body.omega * (flight.model.time - hit.time)
    if hit.a == "pop":
        n = -n
    z = np.zeros(1, FILTER)[0]
    z["offset"], z["P_dd"] = OFFSET, 1e-4
    gyration = scenario.objects["pop"].inertia / scenario.objects["pop"].mass
    at = np.exp(1j * angle) * complex(*OFFSET)
    minus = before[:2] + before[2] * np.array([-at.imag, at.real])
    approach = (before[3:] - minus) @ n
    lever = compute_lever(z, gyration, angle, *n)
    assert 0.005 < lever < 0.1
    change = np.array([body.vx, body.vy]) - before[:2]
    gain = compute_pair_gain(flight.memory, 0, SNAP, 0, lever)
    masses = scenario.robots["snap"].mass, scenario.objects["pop"].mass
    assert gain == pytest.approx(compute_lever_gain(scenario.believed.restitution, *masses, lever), rel=1e-12)
    np.testing.assert_allclose(change, gain * approach * n, atol=1e-6)
    assert body.omega - before[2] == pytest.approx(compute_spin(z, gyration, angle, *change), abs=1e-6)
    np.testing.assert_allclose([robot.vx, robot.vy] - before[3:], -masses[1] / masses[0] * change, atol=1e-6)


@pytest.mark.slow
def test_off_and_on_are_one_where_nothing_turns() -> None:
    """All of `all`: noise, drift, restitution, mass; rounding in the engine's hits turns the object by 1e-16 rad/s."""
    world = load("throw_and_catch").suite("all")
    plan, acted = planners.make_plan(world), []
    for on in (True, False):
        env, experts = (
            vector_env(world, 3, threads=1),
            planners.make_expert_batch(world, 3, plan, options={"offset": on}),
        )
        observations, _ = env.reset(seed=1_000_000)
        actions = []
        for _ in range(250):
            actions.append(experts.act(observations))
            observations = env.step(actions[-1])[0]
        acted.append(np.array(actions))
        experts.close()
    assert np.abs(acted[0]).max() > 0.1
    first = next((k for k in range(250) if acted[0][k].tobytes() != acted[1][k].tobytes()), 250)
    assert first > 80  # not a bit differs before the first hit
    np.testing.assert_allclose(*acted, atol=1e-11)
