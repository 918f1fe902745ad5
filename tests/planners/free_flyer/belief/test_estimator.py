"""Exact measurements are believed, noise is learned, drift is found, contacts follow the impact law."""

from __future__ import annotations

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.belief.estimator import (
    add_jump,
    compute_variance,
    correct_position,
    correct_velocity,
    extrapolate_flight,
    open_filters,
    predict_state,
    update_estimates,
)
from planners.free_flyer.belief.impact_parameters import NOW, find_row, start_pairs
from planners.free_flyer.belief.options import EXPERT, VARIANTS, Options, make_record
from planners.free_flyer.belief.plan_table import make_plan_table
from planners.free_flyer.belief.world_memory import BLANK_FILTER, FILTER, NOBODY, UNKNOWN, make_world_memory
from tests.planners.free_flyer.plans import load, make_plan, set_fields

OPTIONS = make_record(EXPERT)[0]

PERIOD = 0.1
STATES, COVARIANCES = ("position", "velocity", "drift"), ("P_pp", "P_pv", "P_pa", "P_vv", "P_va", "P_aa")
SNAP, CRACKLE, POP = range(3)


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    return load("throw_and_catch").as_believed()


class World:
    """Bodies in free flight; robots accelerate as told, the object drifts."""

    def __init__(self, scenario: FreeFlyerScenario, sigma: float = 0.0, drift: tuple[float, float] = (0, 0)) -> None:
        self.scenario, self.sigma, self.drift, self.rng = scenario, sigma, np.array(drift), np.random.default_rng(3)
        self.position = np.array([scenario.body(name).start for name in scenario.bodies], dtype=float)
        self.velocity = np.zeros((3, 2))
        self.time, self.push = 0.0, np.zeros((2, 2))

    def advance(self, h: float = PERIOD) -> None:
        self.time += h
        a = np.array([*self.push, self.drift])
        self.position += h * self.velocity + h * h / 2 * a
        self.velocity += h * a

    def aim(self, seconds: float) -> None:
        """Make snap reach pop after a time, both at rest now."""
        between = self.position[POP] - self.position[SNAP]
        distance = float(np.linalg.norm(between))
        self.push[SNAP] = between / distance * 2 * (distance - self.reach) / seconds**2

    @property
    def reach(self) -> float:
        return self.scenario.robots["snap"].radius + self.scenario.objects["pop"].radius

    def measure(self, contact: int = NOBODY, velocity_known: bool = True) -> np.ndarray:
        """Return the joint observation, shape (1, 7 * 3 + 2 + 3)."""
        bodies = np.zeros((3, 7))
        bodies[:, :2] = self.position + self.sigma * self.rng.normal(size=(3, 2))
        bodies[:, 2:4] = self.velocity if velocity_known else 0.0
        bodies[:, 4:6] = np.cos(0.3), np.sin(0.3)
        felt = [float(contact == robot) for robot in (SNAP, CRACKLE)]
        return np.array([[*bodies.ravel(), *felt, self.time / self.scenario.horizon, -1.0, 1.0]])

    def bounce(self, restitution: float) -> None:
        n = self.position[POP] - self.position[SNAP]
        n /= np.linalg.norm(n)
        a, b = self.scenario.robots["snap"].mass, self.scenario.objects["pop"].mass
        impulse = (1 + restitution) * a * b / (a + b) * (self.velocity[SNAP] - self.velocity[POP]) @ n
        self.velocity[SNAP] -= impulse / a * n
        self.velocity[POP] += impulse / b * n


class Estimator:
    """The compiled estimator of the middle one of three worlds."""

    def __init__(self, scenario: FreeFlyerScenario, options: Options = EXPERT) -> None:
        self.table = make_plan_table(scenario, make_plan(scenario))
        self.memory = make_world_memory(self.table, 3)
        open_filters(self.table, self.memory, make_record(options)[0], 1)
        start_pairs(self.table, self.memory, OPTIONS, 1)

    def update(self, measured: np.ndarray, world: World) -> int:
        """Take in a sample; return what snap touched."""
        self.memory.push[1] = world.push
        joint = np.full((3, measured.shape[1]), np.nan)
        joint[1] = measured
        update_estimates(self.table, self.memory, OPTIONS, 1, joint, world.time)
        assert (self.memory.filter[::2] == BLANK_FILTER).all()  # other worlds are left alone
        assert self.memory.touch[1, CRACKLE] == NOBODY
        return int(self.memory.touch[1, SNAP])

    def position(self, body: int) -> np.ndarray:
        return self.memory.filter[1, body]["position"].copy()

    def velocity(self, body: int) -> np.ndarray:
        return self.memory.filter[1, body]["velocity"].copy()

    def drift(self, body: int) -> np.ndarray:
        return self.memory.filter[1, body]["drift"].copy()

    def error(self, world: World, body: int) -> tuple[float, float]:
        p, v = self.position(body) - world.position[body], self.velocity(body) - world.velocity[body]
        return float(np.abs(p).max()), float(np.abs(v).max())


def test_filter_is_the_kalman_filter() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    P, mean = root @ root.T, rng.normal(size=(3, 2))
    z = np.zeros(1, FILTER)[0]
    set_fields(z, **dict(zip(STATES, mean, strict=True)), **dict(zip(COVARIANCES, P[np.triu_indices(3)], strict=True)))
    h, sigma, u = 0.3, 0.7, np.array([0.2, -0.4])
    F, G = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]]), np.array([h * h / 2, h, 0])
    mean, P = F @ mean + np.outer(G, u), F @ P @ F.T + sigma**2 * np.outer(G, G)
    predict_state(z, *u, h, sigma)
    for row, update, variance in ((0, correct_position, 0.04), (1, correct_velocity, 0.09)):
        value = rng.normal(size=2)
        update(z, *value, variance)
        K = P[:, row] / (P[row, row] + variance)
        mean, P = mean + np.outer(K, value - mean[row]), P - np.outer(K, P[row])
    np.testing.assert_allclose([z["position"], z["velocity"], z["drift"]], mean, atol=1e-13)
    np.testing.assert_allclose([z[name] for name in COVARIANCES], P[np.triu_indices(3)], atol=1e-13)


def test_jump_opens_what_it_moves() -> None:
    z = np.zeros((), FILTER)[()]
    add_jump(z, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    np.testing.assert_allclose([z["position"], z["velocity"], z["drift"]], [[0.1, 0.2], [0.3, 0.4], [0, 0]])
    np.testing.assert_allclose([z[name] for name in COVARIANCES], [0.25, 0, 0, 0.36, 0, 0])


def test_starts_at_rest_where_the_scenario_says(scenario: FreeFlyerScenario) -> None:
    estimator = Estimator(scenario)
    for body, name in enumerate(scenario.bodies):
        np.testing.assert_array_equal(estimator.position(body), scenario.body(name).start)
        assert not estimator.velocity(body).any()
        assert (estimator.memory.filter[1, body]["P_aa"] > 0) == (body == POP)  # only objects drift
    with_learning = Estimator(scenario, VARIANTS["with_learning"])
    assert with_learning.memory.filter[1, POP]["P_aa"] == 0.0


def test_exact_measurements_are_believed_through_a_contact(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario), Estimator(scenario)
    world.aim(5.04)
    for k in range(81):
        assert estimator.update(world.measure(SNAP if k == 51 else NOBODY), world) == (POP if k == 51 else NOBODY)
        tolerance = 1e-9 if k < 51 else 1e-7 if k > 53 else 1e-6
        assert max(max(estimator.error(world, body)) for body in range(3)) < tolerance, k
        if k == 50:  # inside the step, at a restitution the filter does not expect
            world.advance(0.04)
            world.bounce(0.5)
            world.advance(0.06)
        else:
            world.advance()


def test_noise_is_learned_and_filtered(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario, sigma=5e-3), Estimator(scenario)
    world.velocity[POP] = 0.08, -0.03
    errors = []
    for k in range(200):
        estimator.update(world.measure(velocity_known=False), world)
        if k >= 100:
            errors.append(estimator.error(world, POP))
        world.advance()
    assert 3.5e-3 < estimator.memory.sensor[1]["sigma"] < 6.5e-3
    position, velocity = np.median(errors, axis=0)
    assert position < 2.5e-3  # below the noise of one measurement
    assert velocity < 1.5e-3  # the difference of two measurements errs by 70 mm/s


def test_spread_of_the_prediction_is_honest(scenario: FreeFlyerScenario) -> None:
    """Errors of predictions 10 s ahead are of the size the filter says: neither half nor twice."""
    ratios = []
    for seed in range(30):
        world, estimator = World(scenario, sigma=5e-3, drift=(4e-4, -3e-4)), Estimator(scenario)
        world.rng = np.random.default_rng(seed)
        world.velocity[POP] = 0.05, 0.02
        estimator.memory.filter[1, POP]["P_vv"] = 1.0  # how fast it is, is not known
        for _ in range(100):
            estimator.update(world.measure(velocity_known=False), world)
            world.advance()
        later = world.time + 10.0
        spread = np.sqrt(compute_variance(estimator.memory, 1, POP, later))
        position = extrapolate_flight(estimator.memory, 1, POP, later)[:2]
        world.advance(10.0)
        ratios += list((position - world.position[POP]) / spread)
    assert 0.6 < np.std(ratios) < 1.5


def test_drift_is_found(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario, drift=(6e-4, -3e-4)), Estimator(scenario)
    for _ in range(50):
        estimator.update(world.measure(), world)
        world.advance()
    np.testing.assert_allclose(estimator.drift(POP), world.drift, rtol=0.02)
    assert np.all(estimator.drift(SNAP) == 0.0)
    later = world.time + 10.0
    x, y, vx, vy = extrapolate_flight(estimator.memory, 1, POP, later)
    world.advance(later - world.time)
    np.testing.assert_allclose([x, y], world.position[POP], atol=2e-3)
    np.testing.assert_allclose([vx, vy], world.velocity[POP], atol=2e-4)


def test_without_drift_in_the_filter_none_is_found(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario, drift=(6e-4, -3e-4)), Estimator(scenario, VARIANTS["paper_expert"])
    for _ in range(50):
        estimator.update(world.measure(), world)
        world.advance()
    assert np.all(estimator.drift(POP) == 0.0)


@pytest.mark.parametrize("restitution", [0.8, 0.35])
def test_contact_makes_the_modelled_jump_before_velocities_are_known(
    scenario: FreeFlyerScenario, restitution: float
) -> None:
    """A learned restitution is part of the model."""
    world, estimator = World(scenario, sigma=1e-3), Estimator(scenario)
    estimator.memory.pair_mean[1, NOW, find_row(estimator.memory, SNAP, 0)] = restitution
    world.aim(5.0)
    for _ in range(50):
        estimator.update(world.measure(velocity_known=False), world)
        world.advance()
    before, approach = estimator.velocity(POP), np.linalg.norm(world.velocity[SNAP])
    world.bounce(restitution)
    world.advance()
    assert estimator.update(world.measure(SNAP, velocity_known=False), world) == POP
    jump = np.linalg.norm(world.velocity[POP])
    assert np.linalg.norm(before) < 0.02 * jump
    for body in (SNAP, POP):
        assert np.linalg.norm(estimator.velocity(body) - world.velocity[body]) < 0.1 * jump
    assert estimator.memory.felt[1, SNAP]["approach"] == pytest.approx(approach, rel=0.03)


def test_missing_measurements_are_bridged_and_counted(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario, drift=(8e-4, 0.0)), Estimator(scenario)
    for k in range(60):
        measured = world.measure()
        if 30 <= k < 50:
            measured[0, 7 * POP + (k % 7)] = np.nan  # one number is enough to distrust them all
        estimator.update(measured, world)
        # ten samples tell how exact positions are; the object moves by 8 mm while it is not seen
        assert k < 12 or max(estimator.error(world, POP)) < 1e-6
        world.advance()
    assert estimator.memory.counts["no_measurement"][1] == 20


def test_infinite_measurement_is_no_measurement(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario), Estimator(scenario)
    for k in range(40):
        measured = world.measure()
        if k == 20:
            measured[0, 7 * POP] = np.inf
        estimator.update(measured, world)
        world.advance()
    assert all(np.isfinite(estimator.memory.filter[name][1]).all() for name in FILTER.names)
    assert max(estimator.error(world, POP)) < 1e-4


def test_unseen_bounce_is_noticed(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario), Estimator(scenario)
    for k in range(60):
        if k == 40:
            world.velocity[POP] = -0.08, 0.05
        estimator.update(world.measure(), world)
        world.advance()
    estimator.update(world.measure(), world)
    assert max(estimator.error(world, POP)) < 1e-4


def test_robot_that_feels_an_impact_with_nothing_near_forgets_its_velocity(scenario: FreeFlyerScenario) -> None:
    world, estimator = World(scenario, sigma=1e-3), Estimator(scenario)
    for k in range(60):
        contact = SNAP if k == 40 else NOBODY
        if k == 40:
            world.velocity[SNAP] = 0.04, -0.03  # off a wall that the expert does not know
        found = estimator.update(world.measure(contact, velocity_known=False), world)
        assert found == (UNKNOWN if k == 40 else NOBODY)
        world.advance()
    estimator.update(world.measure(velocity_known=False), world)
    assert estimator.error(world, SNAP)[1] < 5e-3
    assert estimator.error(world, POP)[1] < 5e-3


@pytest.mark.parametrize("turns", [-2, -1, 1])
def test_heading_is_known_up_to_whole_turns_only(scenario: FreeFlyerScenario, turns: int) -> None:
    estimator, world = Estimator(scenario), World(scenario)
    estimator.update(world.measure(), world)
    home = scenario.robots["snap"].heading
    assert estimator.memory.heading[1, SNAP]["angle"] == pytest.approx(home + 0.3)
    angle = home + 0.4 + 2 * np.pi * turns
    measured = world.measure()
    measured[0, 4:7] = np.cos(angle), np.sin(angle), 0.2
    world.time += PERIOD
    estimator.update(measured, world)
    assert estimator.memory.heading[1, SNAP].tolist() == pytest.approx((home + 0.4, 0.2))
