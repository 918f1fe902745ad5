"""Hits tell restitution and mass ratio of their pair, how sure that is, and what it says about other pairs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from impact_envs import parallel_env, vector_env
from planners import make_plan
from planners.free_flyer.belief.impact_parameters import (
    KNOWN,
    NOW,
    UNSEEN,
    compute_gain_spread,
    compute_pair_gain,
    find_row,
    get_pair,
    learn_velocity_error,
    relearn_pairs,
    settle_hit,
    start_pairs,
    watch_recoil,
)
from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.plan_table import PlanTable, make_plan_table
from planners.free_flyer.belief.world_memory import NOBODY, WorldMemory, make_world_memory
from planners.free_flyer.closed_loop.world_loop import adopt_world
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from planners.free_flyer.next_impact.replanner import solve_strike
from tests.planners.free_flyer import plans
from tests.planners.free_flyer.plans import K, load, set_fields

OPTIONS = make_record(EXPERT)[0]
PRIOR = EXPERT.impact_parameters

SNAP, CRACKLE = range(2)
POP, PIP = range(2)
EXACT = 1e-14  # variance of a velocity that is known [m^2/s^2]
HEAVY = 1.25  # crackle's mass over snap's


@pytest.fixture(scope="module")
def table() -> PlanTable:
    """Return what is believed of two robots, of which one is heavier, and two objects."""
    scenario = load("throw_and_catch")
    pop, crackle = scenario.objects["pop"].model_dump(), scenario.robots["crackle"]
    scenario = scenario.override(
        {
            "robots.crackle.mass": HEAVY * crackle.mass,
            "objects": {"pop": pop, "pip": pop | {"start": [1.5, 3.5]}},
            "formula": "F[0,30] pop.x >= -9",
        }
    )
    return make_plan_table(scenario.as_believed(), plans.make_plan(scenario))


@pytest.fixture
def memory(table: PlanTable) -> WorldMemory:
    made = make_world_memory(table, 3)
    start_pairs(table, made, OPTIONS, K)
    return made


def compute_changes(e: float, mu: float, s: float) -> tuple[float, float]:
    """Return the changes of velocity of object and robot."""
    change = (1 + e) / (1 + mu) * s
    return change, mu * change


def see(
    memory: WorldMemory,
    r: int,
    o: int,
    s: float,
    changes: tuple[float, float],
    after: tuple[float, float] = (EXACT, EXACT),
    before: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Let the last hit on object o be one by robot r, with variances of the velocities of object and robot."""
    hit = memory.hit[K, o]
    set_fields(hit, is_pending=True, robot=r)
    hit["gained"], hit["recoil"] = changes
    hit["gained_variance"], hit["recoil_variance"] = after
    set_fields(hit["contact"], approach=s, object_variance=before[0], robot_variance=before[1])
    relearn_pairs(memory, OPTIONS, K)


def covariance(memory: WorldMemory) -> np.ndarray:
    return memory.pair_covariance[K, NOW].copy()


def test_starts_with_what_is_believed(table: PlanTable, memory: WorldMemory) -> None:
    for r, ratio in ((SNAP, 1.0), (CRACKLE, 1 / HEAVY)):
        for o in (POP, PIP):
            assert get_pair(memory, K, r, o) == pytest.approx((0.8, ratio), abs=1e-15)
    assert compute_gain_spread(memory, OPTIONS, K, SNAP, POP) == pytest.approx(0.13, abs=0.005)
    assert np.linalg.eigvalsh(covariance(memory)).min() > -1e-15
    assert not memory.pair_mean[::2].any()  # other worlds are left alone


@pytest.mark.parametrize("e", [0.0, 0.3, 0.8, 1.0])
@pytest.mark.parametrize("mu", [0.5, 1.0, 1.8])
def test_one_exact_hit_tells_restitution_and_masses(memory: WorldMemory, e: float, mu: float) -> None:
    see(memory, SNAP, POP, 0.1, compute_changes(e, mu, 0.1))
    assert get_pair(memory, K, SNAP, POP) == pytest.approx((e, mu), abs=1e-6)
    # The object weighs the same for the other robot; that its restitution is alike is only believed.
    other_e, other_mu = get_pair(memory, K, CRACKLE, POP)
    assert other_mu == pytest.approx(mu / HEAVY, abs=1e-6)
    assert abs(other_e - e) <= 0.035 * abs(e - 0.8) + 1e-6
    assert abs(get_pair(memory, K, SNAP, PIP)[0] - e) <= 0.105 * abs(e - 0.8) + 1e-6
    assert get_pair(memory, K, SNAP, PIP)[1] == pytest.approx(1.0)  # another object's mass is its own


def test_hit_of_one_robot_makes_the_next_ones_surer(memory: WorldMemory) -> None:
    before = [compute_gain_spread(memory, OPTIONS, K, r, o) for r, o in ((SNAP, POP), (CRACKLE, POP), (SNAP, PIP))]
    see(memory, SNAP, POP, 0.1, compute_changes(0.4, 1.2, 0.1), (1e-6, 2e-5), (1e-7, 4e-6))
    after = [compute_gain_spread(memory, OPTIONS, K, r, o) for r, o in ((SNAP, POP), (CRACKLE, POP), (SNAP, PIP))]
    assert after[0] < after[1] < 0.5 * before[1]
    assert after[2] < 0.85 * before[2]


def test_what_is_known_never_gets_less_by_a_hit(memory: WorldMemory) -> None:
    rng = np.random.default_rng(0)
    variances, after, before = np.diag(covariance(memory)), (2e-6, 2e-5), (1e-6, 6e-6)
    for _ in range(30):
        r, o = rng.integers(2, size=2)
        e, mu = rng.uniform(0.2, 0.95), rng.uniform(0.6, 1.4)
        see(memory, int(r), int(o), rng.uniform(0.03, 0.2), compute_changes(e, mu, 0.1), after, before)
        found = covariance(memory)
        np.testing.assert_allclose(found, found.T, atol=1e-15)
        assert np.linalg.eigvalsh(found).min() > -1e-12
        for numbers in (memory.pair_mean, memory.pair_covariance):
            numbers[K, KNOWN] = numbers[K, NOW]
        memory.hit["is_pending"][K] = False
        assert np.all(np.diag(found) <= variances + 1e-15)
        variances = np.diag(found)
    assert np.sqrt(variances.max()) < 0.5 * PRIOR.mass_spread


def test_object_alone_tells_the_gain_only(memory: WorldMemory) -> None:
    """What it leaves open goes to restitution and mass as they were in doubt before."""
    change, _ = compute_changes(0.6, 1.1, 0.1)
    see(memory, SNAP, POP, 0.1, (change, 0.0), (EXACT, UNSEEN))
    e, mu = get_pair(memory, K, SNAP, POP)
    assert (1 + e) / (1 + mu) == pytest.approx(1.6 / 2.1, abs=1e-6)
    assert 0.6 < e < 0.8
    assert 1.0 < mu < 1.6 * 1.2
    i = find_row(memory, SNAP, POP)
    ee, bb = covariance(memory)[[i, i + 1], [i, i + 1]]
    assert 0.3 * PRIOR.restitution_spread < math.sqrt(ee) < PRIOR.restitution_spread
    assert 0.3 * PRIOR.mass_spread < math.sqrt(bb) < PRIOR.mass_spread
    assert compute_gain_spread(memory, OPTIONS, K, SNAP, POP) == pytest.approx(PRIOR.wander / (1 + e), rel=1e-3)


def test_restitution_stays_between_0_and_1_and_the_mass_explains_the_rest(memory: WorldMemory) -> None:
    """A gain of 1.15 needs a light object, one of 0.35 a heavy one, whatever the recoil seems to say."""
    for gain, e in ((1.15, 1.0), (0.35, 0.0)):
        memory.hit["is_pending"][K] = False
        see(memory, SNAP, POP, 0.1, (0.1 * gain, 0.1 * gain), (1e-12, 1e-3))
        restitution, mu = get_pair(memory, K, SNAP, POP)
        assert restitution == pytest.approx(e, abs=1e-12)
        assert (1 + e) / (1 + mu) == pytest.approx(gain, abs=0.02)


def test_wrong_velocity_before_the_hit_is_not_taken_for_certain(memory: WorldMemory) -> None:
    """The robot was a tenth faster than believed, so approach and recoil were measured too small."""
    change, recoil = compute_changes(0.8, 1.3, 0.11)
    seen, i = (change, recoil - 0.01), find_row(memory, SNAP, POP)
    see(memory, SNAP, POP, 0.1, seen, (1e-8, 1e-8), (0.0, 1e-4))
    error = memory.pair_mean[K, NOW, i : i + 2] - [0.8, math.log(1.3)]
    assert np.all(np.abs(error) < 2 * np.sqrt(np.diag(covariance(memory))[i : i + 2]))
    see(memory, SNAP, POP, 0.1, seen, (1e-8, 1e-8))
    error = memory.pair_mean[K, NOW, i : i + 2] - [0.8, math.log(1.3)]
    assert np.all(np.abs(error) > 20 * np.sqrt(np.diag(covariance(memory))[i : i + 2]))


@pytest.mark.parametrize(
    ("after", "before"), [((1e-6, 2e-5), (1e-7, 4e-6)), ((4e-6, 4e-6), (4e-6, 4e-6)), ((1e-6, UNSEEN), (0.0, 1e-6))]
)
def test_errors_are_as_large_as_they_say(
    table: PlanTable, memory: WorldMemory, after: tuple[float, float], before: tuple[float, float]
) -> None:
    """Velocities are measured before and after with errors; the approach speed shares those of before."""
    rng, found = np.random.default_rng(1), []
    sigma = np.sqrt([*before, after[0], min(after[1], 1.0)])
    for _ in range(400):
        start_pairs(table, memory, OPTIONS, K)
        e, b, s = 0.8 + 0.1 * rng.normal(), PRIOR.mass_spread * rng.normal(), rng.uniform(0.06, 0.14)
        i = find_row(memory, SNAP, POP)
        for version in (NOW, KNOWN):
            memory.pair_covariance[K, version] *= (0.1 / PRIOR.restitution_spread) ** 2
            memory.pair_covariance[K, version, 1::2] *= (PRIOR.restitution_spread / 0.1) ** 2
        change, recoil = compute_changes(e, math.exp(b), s)
        object_before, robot_before, object_after, robot_after = sigma * rng.normal(size=4)
        seen = change + object_after - object_before, recoil + robot_before - robot_after
        see(memory, SNAP, POP, s + robot_before - object_before, seen, after, before)
        P = covariance(memory)[i : i + 2, i : i + 2]
        error = memory.pair_mean[K, NOW, i : i + 2] - [e, b]
        if e < 0.97 and 0.0 < memory.pair_mean[K, NOW, i] < 0.97:
            found.append(error / np.sqrt(np.diag(P)))
    assert len(found) > 300
    np.testing.assert_allclose(np.std(found, axis=0), 1.0, atol=0.15)


def test_hits_that_are_observed_at_the_same_time_do_not_forget_each_other(memory: WorldMemory) -> None:
    see(memory, SNAP, POP, 0.1, compute_changes(0.5, 1.2, 0.1), (1e-8, 1e-8))
    see(memory, CRACKLE, PIP, 0.1, compute_changes(0.5, 0.9 / HEAVY, 0.1), (1e-8, 1e-8))
    settle_hit(memory, OPTIONS, K, POP)  # the next contact of pop
    relearn_pairs(memory, OPTIONS, K)
    for r, mass in ((SNAP, 1.0), (CRACKLE, HEAVY)):
        assert get_pair(memory, K, r, POP)[1] == pytest.approx(1.2 / mass, rel=1e-3)
        assert get_pair(memory, K, r, PIP)[1] == pytest.approx(0.9 / mass, rel=1e-3)
    assert get_pair(memory, K, CRACKLE, PIP)[0] == pytest.approx(0.5, abs=1e-3)
    i = find_row(memory, SNAP, POP)
    assert math.sqrt(covariance(memory)[i, i]) == pytest.approx(PRIOR.wander, rel=0.1)  # the next hit may differ
    settle_hit(memory, OPTIONS, K, POP)  # only once
    relearn_pairs(memory, OPTIONS, K)
    assert math.sqrt(covariance(memory)[i, i]) == pytest.approx(PRIOR.wander, rel=0.1)


def test_recoil_is_seen_through_the_thrust_until_the_next_contact(memory: WorldMemory) -> None:
    hit, z = memory.hit[K, POP], memory.filter[K, SNAP]
    memory.touch[K] = NOBODY
    set_fields(hit, is_pending=True, robot=SNAP, time=10.0, recoil_variance=UNSEEN)
    set_fields(hit["contact"], normal=(1.0, 0.0), free_velocity=(0.1, 0.0))
    memory.push[K, SNAP] = -0.02, 0.05
    for step, variance in ((0, 1e-3), (1, 1e-4), (2, 2e-5), (3, 1e-3)):
        now = 10.0 + 0.1 * step
        # The hit took 0.07 m/s; what is seen with the large variance is wrong.
        z["velocity"][0] = 0.03 - 0.002 * step + (0.01 if variance == 1e-3 else 0.0)
        z["P_vv"] = variance
        watch_recoil(memory, OPTIONS, K, POP, now)
    assert hit["recoil"] == pytest.approx(0.07)
    assert 2e-5 < hit["recoil_variance"] < 2e-5 + 5 * PRIOR.thrust_error**2
    best = hit["recoil_variance"]
    z["P_vv"] = 0.0
    memory.touch[K, SNAP] = CRACKLE
    watch_recoil(memory, OPTIONS, K, POP, 10.4)
    memory.touch[K, SNAP] = NOBODY
    watch_recoil(memory, OPTIONS, K, POP, 10.5)
    assert hit["recoil_variance"] == best
    set_fields(hit, time=10.6, recoil_variance=UNSEEN)
    watch_recoil(memory, OPTIONS, K, POP, 10.6 + 2 * PRIOR.recoil_seconds)
    assert hit["recoil_variance"] == UNSEEN  # too late


def test_how_exact_the_thrust_is_shows_where_velocities_are_measured(memory: WorldMemory) -> None:
    for _ in range(200):
        learn_velocity_error(memory, OPTIONS, K, SNAP, 2 * 5e-3**2, 1e-8)
        learn_velocity_error(memory, OPTIONS, K, CRACKLE, 2 * 5.0**2, 5.0**2)  # noise only
    assert math.sqrt(memory.velocity_error[K, SNAP]) == pytest.approx(5e-3, rel=0.01)
    assert math.sqrt(memory.velocity_error[K, CRACKLE]) == pytest.approx(PRIOR.thrust_error, rel=1e-3)
    for _ in range(200):
        learn_velocity_error(memory, OPTIONS, K, SNAP, 0.0, 1e-8)
    assert math.sqrt(memory.velocity_error[K, SNAP]) < 1e-4


@pytest.fixture(scope="module")
def thrown() -> FreeFlyerExpert:
    """Return the expert 4 s after the first hit in a world of other restitution and mass."""
    scenario = load("throw_and_catch")
    world = scenario.override({"true.restitution": 0.45, "true.object_mass_scale": 1.25})
    plan = make_plan(scenario)
    env, expert = parallel_env(world), FreeFlyerExpert(scenario, plan)
    observations, _ = env.reset(seed=0)
    while env.time < plan.impacts[0].time + 4.0:
        observations, *_ = env.step(expert.act(observations))
    return expert


def test_expert_knows_the_pair_after_its_first_hit(thrown: FreeFlyerExpert) -> None:
    found = thrown.estimates()
    assert list(found) == [("snap", "pop"), ("crackle", "pop")]
    snap, crackle = found.values()
    assert snap.restitution == pytest.approx(0.45, abs=5e-3)
    assert snap.mass_ratio == pytest.approx(1.25, abs=5e-3)
    assert snap.restitution_spread < 0.02
    assert snap.mass_ratio_spread < 0.03
    # Crackle has not hit anything yet.
    assert crackle.restitution == pytest.approx(0.45, abs=0.03)
    assert crackle.mass_ratio == pytest.approx(snap.mass_ratio)
    assert snap.restitution_spread < crackle.restitution_spread < 0.06


def test_learner_sees_the_gain_of_the_coming_pair(thrown: FreeFlyerExpert) -> None:
    expert = thrown
    factor, spread = expert.features()[35:37]
    assert factor == pytest.approx(compute_pair_gain(expert.memory, 0, CRACKLE, POP) / 0.9)
    assert factor == pytest.approx(1.45 / 2.25 / 0.9, rel=0.03)
    assert spread == pytest.approx(compute_gain_spread(expert.memory, OPTIONS, 0, CRACKLE, POP))
    assert 0.0 < spread < 0.06


def test_robot_is_expected_to_recoil_by_the_estimated_masses(thrown: FreeFlyerExpert) -> None:
    expert = thrown
    now = expert.memory.time[0]
    solve_strike(expert.table, expert.memory, OPTIONS, 0, CRACKLE, POP, now)
    strike = expert.memory.strike[0, POP]
    recoil = strike["robot_minus"] - strike["robot_plus"]
    ratio = expert.estimates()["crackle", "pop"].mass_ratio
    assert np.linalg.norm(recoil) == pytest.approx(ratio * strike["change"])


def test_new_plan_keeps_what_was_learned(thrown: FreeFlyerExpert) -> None:
    known = thrown.estimates()["snap", "pop"]
    assert known.restitution_spread < PRIOR.restitution_spread
    adopt_world(thrown.table, thrown.memory, OPTIONS, 0)
    assert thrown.estimates()["snap", "pop"] == known


def test_new_episode_forgets(thrown: FreeFlyerExpert) -> None:
    thrown.reset(0)
    assert thrown.estimates()["snap", "pop"] == pytest.approx((0.8, 1.0, PRIOR.restitution_spread, PRIOR.mass_spread))


def test_estimates_under_noise_are_as_good_as_they_say() -> None:
    """Positions with 5 mm noise, no velocities, pulsed thrusters of another gain; 4 s after the first hit."""
    scenario = load("throw_and_catch")
    fixed = {"true.restitution": 0.6, "true.object_mass_scale": 1.2, "true.thruster_gain": 0.95}
    world, plan, count = scenario.suite("all").override(fixed), make_plan(scenario), 40
    vector, batch = vector_env(world, num_envs=count, threads=1), FreeFlyerExpertBatch(world, plan, count)
    joint, _ = vector.reset(seed=1_000_000)
    for _ in range(round((plan.impacts[0].time + 4.0) / scenario.control_period)):
        joint = vector.step(batch.act(joint))[0]
    i = find_row(batch.memory, SNAP, POP)
    found = batch.memory.pair_mean[:, NOW, i : i + 2] - [0.6, math.log(1.2)]
    spread = np.sqrt(batch.memory.pair_covariance[:, NOW, [i, i + 1], [i, i + 1]])
    assert np.all(np.abs(found.mean(axis=0)) < [0.6 * 0.2, 0.6 * math.log(1.2)])  # of what was believed wrongly
    assert np.all(np.median(spread, axis=0) < [0.6 * PRIOR.restitution_spread, 0.75 * PRIOR.mass_spread])
    ratios = np.sqrt(np.mean((found / spread) ** 2, axis=0))
    assert np.all(ratios > 0.3)
    assert np.all(ratios < 1.3)
