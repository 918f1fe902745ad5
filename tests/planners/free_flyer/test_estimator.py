"""Exact measurements are believed, noise is learned, drift is found, contacts follow the impact law."""

from __future__ import annotations

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.free_flyer.observation import Measurement
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.estimator import Estimator, correct_position, correct_velocity, predict, shift

PERIOD = 0.1


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    loaded = load_scenario("throw_and_catch")
    assert isinstance(loaded, FreeFlyerScenario)
    return loaded.as_believed()


class World:
    """Bodies in free flight; robots accelerate as told, the object drifts."""

    def __init__(self, scenario: FreeFlyerScenario, sigma: float = 0.0, drift: tuple[float, float] = (0, 0)) -> None:
        self.scenario, self.sigma, self.drift, self.rng = scenario, sigma, np.array(drift), np.random.default_rng(3)
        self.position = {name: np.array(scenario.body(name).start, dtype=float) for name in scenario.bodies}
        self.velocity = {name: np.zeros(2) for name in scenario.bodies}
        self.time, self.push = 0.0, dict.fromkeys(scenario.robots, (0.0, 0.0))

    def advance(self, h: float = PERIOD) -> None:
        self.time += h
        for name in self.position:
            a = np.array(self.push.get(name, self.drift))
            self.position[name] += h * self.velocity[name] + h * h / 2 * a
            self.velocity[name] += h * a

    def aim(self, robot: str, item: str, seconds: float) -> None:
        """Make a robot at rest reach an object at rest after a time."""
        between = self.position[item] - self.position[robot]
        distance = float(np.linalg.norm(between))
        reach = self.scenario.body(robot).radius + self.scenario.body(item).radius
        self.push[robot] = tuple(between / distance * 2 * (distance - reach) / seconds**2)

    def measure(self, contact: str = "", velocity_known: bool = True) -> Measurement:
        states = {
            name: np.array(
                [
                    *(self.position[name] + self.sigma * self.rng.normal(size=2)),
                    *(self.velocity[name] if velocity_known else np.zeros(2)),
                    0.3,
                    0.0,
                ]
            )
            for name in self.position
        }
        robots = {name: states[name] for name in self.scenario.robots}
        objects = {name: states[name] for name in self.scenario.objects}
        return Measurement(self.time, robots, objects, {name: name == contact for name in robots})

    def bounce(self, robot: str, item: str, restitution: float) -> None:
        n = self.position[item] - self.position[robot]
        n /= np.linalg.norm(n)
        a, b = self.scenario.body(robot).mass, self.scenario.body(item).mass
        impulse = (1 + restitution) * a * b / (a + b) * (self.velocity[robot] - self.velocity[item]) @ n
        self.velocity[robot] -= impulse / a * n
        self.velocity[item] += impulse / b * n


def error(estimator: Estimator, world: World, name: str) -> tuple[float, float]:
    p = np.abs(estimator.position(name) - world.position[name]).max()
    return float(p), float(np.abs(estimator.velocity(name) - world.velocity[name]).max())


def test_filter_is_the_kalman_filter() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    P, mean = root @ root.T, rng.normal(size=(3, 2))
    z = np.array([*mean.ravel(), P[0, 0], P[0, 1], P[0, 2], P[1, 1], P[1, 2], P[2, 2]])
    h, sigma, u = 0.3, 0.7, np.array([0.2, -0.4])
    F, G = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]]), np.array([h * h / 2, h, 0])
    mean, P = F @ mean + np.outer(G, u), F @ P @ F.T + sigma**2 * np.outer(G, G)
    predict(z, *u, h, sigma)
    for row, update, variance in ((0, correct_position, 0.04), (1, correct_velocity, 0.09)):
        value = rng.normal(size=2)
        update(z, *value, variance)
        K = P[:, row] / (P[row, row] + variance)
        mean, P = mean + np.outer(K, value - mean[row]), P - np.outer(K, P[row])
    np.testing.assert_allclose(z[:6], mean.ravel(), atol=1e-13)
    np.testing.assert_allclose(z[6:], P[np.triu_indices(3)], atol=1e-13)


def test_exact_measurements_are_believed_through_a_contact(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario), Estimator(scenario)
    world.aim("snap", "pop", 5.04)
    estimator.update(world.measure(), {})
    for k in range(80):
        if k == 50:  # inside the step, at a restitution the filter does not expect
            world.advance(0.04)
            world.bounce("snap", "pop", 0.5)
            world.advance(0.06)
        else:
            world.advance()
        touched = estimator.update(world.measure("snap" if k == 50 else ""), world.push)
        assert touched == ({"snap": "pop"} if k == 50 else {})
        tolerance = 1e-9 if k < 50 else 1e-8 if k > 52 else 1e-6
        assert max(max(error(estimator, world, name)) for name in scenario.bodies) < tolerance, k


def test_noise_is_learned_and_filtered(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario, sigma=5e-3), Estimator(scenario)
    world.velocity["pop"] = np.array([0.08, -0.03])
    errors = []
    for k in range(200):
        estimator.update(world.measure(velocity_known=False), world.push)
        if k >= 100:
            errors.append(error(estimator, world, "pop"))
        world.advance()
    assert 3.5e-3 < estimator.sigma < 6.5e-3
    position, velocity = np.median(errors, axis=0)
    assert position < 2.5e-3  # below the noise of one measurement
    assert velocity < 1.5e-3  # the difference of two measurements errs by 70 mm/s


def test_drift_is_found(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario, drift=(6e-4, -3e-4)), Estimator(scenario)
    for _ in range(50):
        estimator.update(world.measure(), world.push)
        world.advance()
    np.testing.assert_allclose(estimator.drift("pop"), world.drift, rtol=0.02)
    assert np.all(estimator.drift("snap") == 0.0)
    later = world.time + 10.0
    position, velocity = estimator.extrapolate("pop", later)
    world.advance(later - world.time)
    np.testing.assert_allclose(position, world.position["pop"], atol=2e-3)
    np.testing.assert_allclose(velocity, world.velocity["pop"], atol=2e-4)


def test_contact_makes_the_modelled_jump_before_velocities_are_known(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario, sigma=1e-3), Estimator(scenario)
    world.aim("snap", "pop", 5.0)
    for _ in range(50):
        estimator.update(world.measure(velocity_known=False), world.push)
        world.advance()
    before = estimator.velocity("pop")
    world.bounce("snap", "pop", scenario.believed.restitution)
    world.advance()
    assert estimator.update(world.measure("snap", velocity_known=False), world.push) == {"snap": "pop"}
    jump = np.linalg.norm(world.velocity["pop"])
    assert np.linalg.norm(before) < 0.02 * jump
    for name in ("pop", "snap"):
        assert np.linalg.norm(estimator.velocity(name) - world.velocity[name]) < 0.1 * jump


def test_missing_measurements_are_bridged(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario, drift=(8e-4, 0.0)), Estimator(scenario)
    for k in range(60):
        measurement = world.measure()
        if 30 <= k < 50:
            measurement.objects["pop"][:] = np.nan
        estimator.update(measurement, world.push)
        # ten samples tell how exact positions are; the object moves by 8 mm while it is not seen
        assert k < 12 or max(error(estimator, world, "pop")) < 1e-6
        world.advance()


def test_unseen_bounce_is_noticed(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario), Estimator(scenario)
    for k in range(60):
        if k == 40:
            world.velocity["pop"] = np.array([-0.08, 0.05])
        estimator.update(world.measure(), world.push)
        world.advance()
    estimator.update(world.measure(), world.push)
    assert max(error(estimator, world, "pop")) < 1e-4


def test_shift_opens_what_it_moves() -> None:
    z = np.zeros(12)
    shift(z, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    np.testing.assert_allclose(z, [0.1, 0.2, 0.3, 0.4, 0, 0, 0.25, 0, 0, 0.36, 0, 0])
