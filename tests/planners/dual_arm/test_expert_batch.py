"""Experts of many worlds of two arms act as the single expert does, corrections and all."""

import pickle

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, vector_env
from impact_envs.dual_arm.observation import ARM
from impact_envs.errors import InputError
from planners import make_expert, make_expert_batch

NAME, SEED = "dual_arm_grasp", 1_000_000
SUITES = (
    "nominal",
    "box_pose",
    "mass",
    "friction",
    "contact_stiffness",
    "joint_stiffness",
    "start_pose",
    "all",
    "hard",
)
# Ends a third of a second after the grasp.
SHORT = load_scenario(NAME).override({"horizon": 1.2, "formula": "G[0,1.2] box.lag <= 0.015"})


def play_single(scenario, seed, variant=None, spoil=None):
    """Return actions, features at every request, corrections given, fallbacks and robustness of an episode."""
    env, expert = parallel_env(scenario), make_expert(scenario, variant=variant)
    observations, infos = env.reset(seed=seed)
    expert.reset(seed)
    rng, actions, features = np.random.default_rng(seed), [], []
    while env.agents:
        if spoil is not None:
            spoil(env.steps, observations["arm_1"])
        expert.observe(observations)
        if expert.awaiting_correction:
            features.append(expert.features())
            correction = rng.uniform(-1.2, 1.2, 2)
            if len(features) != 2:  # the second request is left unanswered
                expert.correct(np.clip(correction, -1.0, 1.0))
        chosen = expert.control()
        actions.append(np.concatenate(list(chosen.values())))
        observations, _, _, _, infos = env.step(chosen)
    told = infos["arm_1"]
    return np.array(actions), np.array(features), expert.diagnostics().fallbacks, told["robustness"]


def play_batch(scenario, count, variant=None, spoil=None, threads=1):
    """Return the same of worlds with seeds from SEED on; the features are a list per world."""
    worlds, experts = vector_env(scenario, count, threads=threads), make_expert_batch(scenario, count, variant=variant)
    joint, infos = worlds.reset(seed=SEED)
    rngs = [np.random.default_rng(SEED + k) for k in range(count)]
    actions, features = [], [[] for _ in range(count)]
    for step in range(scenario.steps):
        if spoil is not None:
            for row in joint:
                spoil(step, row)
        due, seen = experts.observe(joint), None
        mask, corrections = np.zeros(count, bool), []
        for k in np.flatnonzero(due):
            seen = experts.features() if seen is None else seen
            features[k].append(seen[k])
            correction = rngs[k].uniform(-1.2, 1.2, 2)
            if len(features[k]) != 2:
                mask[k] = True
                corrections.append(correction)
        if mask.any():
            experts.correct(mask, np.array(corrections))
        actions.append(experts.control())
        joint, _, _, _, infos = worlds.step(actions[-1])
    return np.array(actions), features, experts.counts, infos["robustness"]


def check_equal(scenario, count, variant=None, spoil=None, threads=1):
    actions, features, counts, robustness = play_batch(scenario, count, variant, spoil, threads)
    for k in range(count):
        single = play_single(scenario, SEED + k, variant, spoil)
        assert np.array_equal(actions[:, k], single[0])
        assert np.array_equal(features[k], single[1])
        assert {name: int(values[k]) for name, values in counts.items() if values[k]} == single[2]
        assert robustness[k] == single[3]
    return features, counts


@pytest.mark.parametrize("suite", ["nominal", "all", "hard"])
def test_worlds_act_as_the_single_expert_with_random_corrections(suite):
    features, _ = check_equal(SHORT.suite(suite), 3, threads=2)
    assert sum(map(len, features)) >= 4


@pytest.mark.slow
@pytest.mark.parametrize("suite", SUITES)
def test_whole_episodes_of_many_worlds_equal_the_single_expert(suite):
    check_equal(load_scenario(NAME).suite(suite), 10, threads=2)


@pytest.mark.parametrize("variant", ["published", "no_impact_map", "no_interim_phase"])
def test_variants_act_alike(variant):
    check_equal(SHORT.suite("all"), 2, variant)


def test_wrong_and_missing_readings_are_judged_alike():
    def spoil(step, row):
        if 50 <= step < 60:
            row[: ARM.size] = np.nan
        elif 200 <= step < 210:
            row[ARM["angles"].start] += 1.0
        elif step == 300:
            row[: ARM.size] = 0.0

    _, counts = check_equal(SHORT.suite("all"), 2, spoil=spoil)
    assert counts["no_measurement"].min() >= 10 and counts["rejected"].min() >= 10


def test_a_world_that_starts_again_forgets_and_the_others_do_not():
    worlds, experts = vector_env(SHORT, 2, threads=1, max_cycles=5), make_expert_batch(SHORT, 2)
    joint, _ = worlds.reset(seed=SEED)
    first = [experts.act(joint)]
    for _ in range(3):
        joint, *_ = worlds.step(first[-1])
        first.append(experts.act(joint))
    again = joint.copy()
    joint, _ = worlds.reset(seed=SEED)
    mixed = np.array([joint[0], again[1]])
    before = experts._control["ticks"].copy()
    actions = experts.act(mixed)
    assert np.array_equal(actions[0], first[0][0])
    assert experts._control["ticks"].tolist() == [1, before[1] + 1]


def test_a_pickled_batch_goes_on_alike():
    worlds, experts = vector_env(SHORT, 2, threads=1), make_expert_batch(SHORT, 2, threads=2)
    joint, _ = worlds.reset(seed=SEED)
    for _ in range(30):
        joint, *_ = worlds.step(experts.act(joint))
    copy = pickle.loads(pickle.dumps(experts))
    assert np.array_equal(copy.act(joint), experts.act(joint))
    joint, *_ = worlds.step(np.zeros((2, 6)))
    assert np.array_equal(copy.act(joint), experts.act(joint))
    experts.close()
    copy.close()


def test_bad_input_is_refused():
    experts = make_expert_batch(SHORT, 2)
    with pytest.raises(InputError, match=r"real numbers of shape \(2, 31\) are needed"):
        experts.act(np.zeros((2, 30)))
    with pytest.raises(InputError, match="world 1 awaits no correction now"):
        experts.correct(np.array([False, True]), np.zeros((1, 2)))
    with pytest.raises(InputError, match=r"corrections of shape \(2,\): finite numbers of shape \(1, 2\)"):
        experts.correct(np.array([False, True]), np.zeros(2))
    with pytest.raises(InputError, match=r"expert\.solver = daqp: many worlds at once take goldfarb_idnani only"):
        make_expert_batch(SHORT, 2, options={"solver": "daqp"})
    with pytest.raises(InputError, match="count = 0: a whole number from 1"):
        make_expert_batch(SHORT, 0)
    with pytest.raises(InputError, match="whose expert follows no plan"):
        make_expert_batch(SHORT, 2, plan=object())
