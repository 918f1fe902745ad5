"""Readings that no motion explains are rejected and counted; the estimate goes on as if they had not been made."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from impact_envs import parallel_env, rollout, vector_env
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.belief.estimator import open_filters, update_estimates
from planners.free_flyer.belief.impact_parameters import start_pairs
from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.plan_table import make_plan_table
from planners.free_flyer.belief.world_memory import make_world_memory
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from tests.frozen.freeze import get_plan
from tests.planners.free_flyer.plans import load, make_plan

PERIOD, SEED = 0.1, 1_000_000
POP, SIZE = 2, 7
PATIENCE = round(EXPERT.estimation.patience / PERIOD)
OPTIONS = make_record(EXPERT)[0]
Spoil = Callable[[np.ndarray], None]


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    return load("throw_and_catch").as_believed()


class Flight:
    """The object flies at constant velocity, the robots rest, and an estimator reads them."""

    def __init__(self, scenario: FreeFlyerScenario, sigma: float = 0.0) -> None:
        self.table = make_plan_table(scenario, make_plan(scenario))
        self.memory = make_world_memory(self.table, 1)
        open_filters(self.table, self.memory, OPTIONS, 0)
        start_pairs(self.table, self.memory, OPTIONS, 0)
        self.sigma, self.rng, self.steps = sigma, np.random.default_rng(5), 0
        self.position = np.array([scenario.body(name).start for name in scenario.bodies], dtype=float)
        self.velocity, self.horizon = np.zeros((3, 2)), scenario.horizon
        self.memory.filter["P_vv"][0, POP] = 1.0  # how fast it is, is not known
        self.velocity[POP] = 0.06, -0.02
        self.held: np.ndarray | None = None

    def read(self, spoil: Spoil | None = None) -> None:
        bodies = np.zeros((3, SIZE))
        bodies[:, :2] = self.position + self.sigma * self.rng.normal(size=(3, 2))
        bodies[:, 2:4], bodies[:, 4] = self.velocity, 1.0
        if spoil:
            spoil(bodies)
        joint = np.array([[*bodies.ravel(), 0.0, 0.0, self.steps * PERIOD / self.horizon, -1.0, 1.0]])
        update_estimates(self.table, self.memory, OPTIONS, 0, joint, self.steps * PERIOD)
        assert all(np.isfinite(self.memory.filter[name]).all() for name in self.memory.filter.dtype.names)
        self.steps += 1
        self.error = float(np.abs(self.memory.filter["position"][0] - self.position).max())
        self.position += PERIOD * self.velocity

    def count(self, name: str) -> int:
        return int(self.memory.counts[name][0])


def add(size: float) -> Spoil:
    def spoil(bodies: np.ndarray) -> None:
        bodies[POP, 0] += size

    return spoil


def negate(bodies: np.ndarray) -> None:
    bodies *= -1.0


def swap(bodies: np.ndarray) -> None:
    bodies[[1, POP]] = bodies[[POP, 1]]


def clear(bodies: np.ndarray) -> None:
    bodies[:] = 0.0


def spin(bodies: np.ndarray) -> None:
    bodies[POP, 6] = 1e3


def rush(bodies: np.ndarray) -> None:
    bodies[POP, 2] = 7.0


def turn(bodies: np.ndarray) -> None:
    bodies[:, 4:6] *= -1.0


SPOILED = [add(0.3), add(-1.0), add(10.0), add(1e3), add(1e154), add(1e300), negate, swap, clear, spin, rush, turn]


@pytest.mark.parametrize("sigma", [0.0, 5e-3])
@pytest.mark.parametrize("periods", [1, 2, 20])
@pytest.mark.parametrize("spoil", SPOILED)
def test_impossible_readings_leave_no_trace(
    scenario: FreeFlyerScenario, spoil: Spoil, periods: int, sigma: float
) -> None:
    flight = Flight(scenario, sigma)
    for k in range(80):
        flight.read(spoil if 40 <= k < 40 + periods else None)
        assert k < 30 or flight.error < (1e-6 if sigma == 0.0 else 0.02), k
    assert flight.count("rejected") >= periods
    assert flight.count("rejected") % periods == 0
    assert flight.count("taken_up") == 0


@pytest.mark.parametrize("sigma", [0.0, 5e-3])
def test_a_frozen_reading_is_stale(scenario: FreeFlyerScenario, sigma: float) -> None:
    flight, last = Flight(scenario, sigma), np.zeros((3, SIZE))

    def freeze(bodies: np.ndarray) -> None:
        bodies[:] = last

    def keep(bodies: np.ndarray) -> None:
        last[:] = bodies

    for k in range(80):
        flight.read(freeze if 40 <= k < 60 else keep)
        assert k < 30 or flight.error < (1e-6 if sigma == 0.0 else 0.02), k
    # Of exact readings at rest it cannot be known.
    assert flight.count("rejected") == (20 if sigma == 0.0 else 60)


def test_an_estimate_that_is_wrong_is_given_up_for_readings_that_agree(scenario: FreeFlyerScenario) -> None:
    flight = Flight(scenario)
    for _ in range(40):
        flight.read()
    flight.position[POP] += 1.0  # nothing does that
    for _ in range(PATIENCE + 2):
        flight.read()
        assert flight.count("rejected") <= PATIENCE
    assert (flight.count("rejected"), flight.count("taken_up")) == (PATIENCE, 1)
    for _ in range(5):
        flight.read()
    assert flight.error < 1e-5


def test_readings_that_do_not_agree_are_never_taken_up(scenario: FreeFlyerScenario) -> None:
    flight, rng = Flight(scenario), np.random.default_rng(1)
    for k in range(3 * PATIENCE + 40):
        flight.read(add(float(rng.normal() * 3.0)) if k >= 40 and k % 10 else None)
    assert flight.count("taken_up") == 0
    assert flight.error < 1e-3


def test_nothing_is_ever_read_outside_the_walls(scenario: FreeFlyerScenario) -> None:
    flight = Flight(scenario)
    for k in range(3 * PATIENCE):
        flight.read(add(1e4) if k >= 40 else None)
    assert flight.count("taken_up") == 0


def test_a_surprise_that_was_wrong_is_taken_back(scenario: FreeFlyerScenario) -> None:
    """0.05 m in a period is what an impact could do: it is believed until later readings say otherwise."""
    flight = Flight(scenario)
    for k in range(45):
        flight.read(add(0.05) if k in (40, 41) else None)
        assert (flight.error > 0.03) == (k in (40, 41)) or k < 40
    assert flight.error < 1e-6
    assert np.abs(flight.memory.filter["velocity"][0] - flight.velocity).max() < 1e-5
    assert flight.count("rejected") == 1


def spoil_joint(joint: np.ndarray, k: int, rng: np.random.Generator) -> np.ndarray:
    """Return readings of two robots and an object of which most kinds of wrong ones come in turn."""
    bodies, read = joint[:, :21].reshape(-1, 3, SIZE), joint.copy()
    view = read[:, :21].reshape(-1, 3, SIZE)
    kind = {40: "far", 41: "far", 55: "huge", 90: "clock", 91: "clock"}.get(k)
    if 60 <= k < 80:
        read[:] = 0.0
    elif 100 <= k < 110:
        view[:] = bodies[:, [1, 2, 0]]
    elif 125 <= k < 135:
        read *= -1.0
    elif 150 <= k < 160:
        read[:] = np.inf if k % 2 else np.nan
    elif k >= 170 and k % 20 == 0:
        view[:, :, :2] += 3.0 * rng.normal(size=(len(read), 3, 2))
    elif kind == "far":
        view[:, 2, 0] += 10.0
    elif kind == "huge":
        view[:, 0, 1] = 1e154
    elif kind == "clock":
        read[:, 23] = 1e154
    return read


def test_single_and_batch_agree_and_succeed_with_impossible_readings() -> None:
    world, plan, count = load("throw_and_catch").suite("all"), get_plan("throw_and_catch", "all"), 3
    assert plan is not None
    vector, batch = vector_env(world, num_envs=count, threads=1), FreeFlyerExpertBatch(world, plan, count)
    singles, rng = [FreeFlyerExpert(world, plan) for _ in range(count)], np.random.default_rng(0)
    joint, _ = vector.reset(seed=SEED)
    for k in range(world.steps):
        read = spoil_joint(joint, k, rng)
        actions = batch.act(read)
        for row, expert in zip(range(count), singles, strict=True):
            alone = expert.act(split(read[row]))
            np.testing.assert_array_equal(actions[row], np.concatenate([alone[name] for name in world.agents]))
        assert np.isfinite(actions).all()
        joint, _, _, _, infos = vector.step(actions)
    assert infos["success"].all()
    for row, expert in enumerate(singles):
        assert expert.diagnostics().fallbacks["rejected"] == batch.counts["rejected"][row] > 100


def split(joint: np.ndarray) -> dict[str, np.ndarray]:
    """Return the observations of both robots."""
    snap, crackle, pop, tail = joint[:7], joint[7:14], joint[14:21], joint[23:]
    return {
        "snap": np.concatenate([snap, crackle, pop, joint[21:22], tail]),
        "crackle": np.concatenate([crackle, snap, pop, joint[22:23], tail]),
    }


@pytest.mark.parametrize("suite", ["nominal", "all", "hard_v0"])
def test_right_readings_are_never_rejected(suite: str) -> None:
    world, plan = load("throw_and_catch").suite(suite), get_plan("throw_and_catch", suite)
    assert plan is not None
    vector, batch = vector_env(world, num_envs=10, threads=1), FreeFlyerExpertBatch(world, plan, 10)
    joint, _ = vector.reset(seed=SEED)
    for _ in range(world.steps):
        joint = vector.step(batch.act(joint))[0]
    assert not batch.counts["rejected"].any()
    assert not batch.counts["taken_up"].any()


def test_lost_readings_are_rejected_and_the_expert_goes_on() -> None:
    """Readings that are repeated for a second are stale; the belief is that of flight until new ones arrive."""
    lost = {"true.dropout_rate": 0.05, "true.position_noise": 0.005, "true.velocity_measured": False}
    world, plan = load("throw_and_catch").override(lost), get_plan("throw_and_catch", "nominal")
    assert plan is not None
    vector, batch = vector_env(world, num_envs=10, threads=1), FreeFlyerExpertBatch(world, plan, 10)
    joint, infos = vector.reset(seed=SEED)
    for _ in range(world.steps):
        joint, _, _, _, infos = vector.step(batch.act(joint))
    assert infos["success"].all()
    assert batch.counts["rejected"].min() >= 0
    assert batch.counts["rejected"].max() >= 30  # three bodies for ten periods
    assert not batch.counts["taken_up"].any()


def test_the_case_that_was_found_succeeds() -> None:
    """Off by metres for two periods: corridor with everything disturbed."""
    world, plan = load("corridor").suite("all"), get_plan("corridor", "all")
    assert plan is not None
    expert = FreeFlyerExpert(world, plan)
    for jump in (0.3, 10.0, 1e3):
        wrong = Wrong(expert, jump)
        episode = rollout(parallel_env(world), wrong, seed=0)
        assert episode.success
        assert episode.fallbacks["rejected"] == 2


class Wrong:
    """An expert that reads the object in another place in two periods."""

    name = "wrong"

    def __init__(self, expert: FreeFlyerExpert, jump: float) -> None:
        self.expert, self.jump = expert, jump
        self.diagnostics = expert.diagnostics

    def reset(self, seed: int) -> None:
        self.expert.reset(seed)
        self.step = 0

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        wrong = self.step in (40, 41)
        self.step += 1
        place = np.arange(observations["snap"].size) == 2 * SIZE
        return self.expert.act({name: seen + self.jump * (place & wrong) for name, seen in observations.items()})
