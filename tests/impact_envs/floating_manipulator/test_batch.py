"""Many manipulators are JointEnv many times over, bit for bit: draws, impacts, pushes, sensors, robustness, rewards."""

import copy

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from impact_envs import JointEnv, list_scenarios, load_scenario, parallel_env, vector_env
from impact_envs.errors import InputError

NAMES = [name for name in list_scenarios() if load_scenario(name).domain == "floating_manipulator"]
WORLDS, SEED = 3, 1_000_000
# Two seconds, with the box so near that random torques bring the tip to it.
SOON = {
    "horizon": 2.0,
    "formula": "F[0,1] distance(tip, target) <= 5 & G[0,2] (tip.impulse <= 0.2 & tip.since_impact >= 0)",
    "requirements": {},
    "box.start": [6.97, 1.5],
}


def soon(name="floating_manipulator_thrusters", suite="nominal", **values):
    """A scenario in whose suite the box is moved less, because it is near."""
    scenario = load_scenario(name).suite(suite)
    moved = {f"true.{key}": 0.0 for key in ("box_offset_x", "box_offset_y", "box_turn")}
    return scenario.override({**SOON, **moved, **values})


def draw_actions(worlds, steps, held=20, seed=0):
    """Beyond the limits now and then, so that clipping is compared too; the tip is pushed to the box at first."""
    size = worlds.single_action_space.shape[0]
    drawn = np.random.default_rng(seed).uniform(-1.2, 1.2, (-(-steps // held), worlds.num_envs, size))
    drawn[:2, :, :3] = [0.3, 0.1, 0.0]
    return np.repeat(drawn, held, axis=0)[:steps]


def check_same(scenario, seed, steps, **options):
    """Step worlds and environments; return how many impacts there were."""
    worlds = vector_env(scenario, WORLDS, threads=1, autoreset_mode="Disabled", per_robot=True, **options)
    singles = [JointEnv(scenario) for _ in range(WORLDS)]
    seen, _ = worlds.reset(seed=seed)
    assert np.array_equal(seen, [env.reset(seed=seed + k)[0] for k, env in enumerate(singles)])
    hits = 0
    for actions in draw_actions(worlds, steps):
        seen, rewards, terminated, truncated, infos = worlds.step(actions)
        stepped = [env.step(action) for env, action in zip(singles, actions, strict=True)]
        for found, wanted in zip((seen, rewards, terminated, truncated), zip(*stepped, strict=False), strict=False):
            assert np.array_equal(found, wanted)
        for name in ("robustness_lower", "robustness_upper"):
            assert np.array_equal(infos[name], [step[4][name] for step in stepped])
        assert np.array_equal(infos["impacts"], [len(env.parallel.impacts) for env in singles])
        assert np.array_equal(worlds.batch.states, [env.parallel.model.state() for env in singles])
        assert (worlds.agent_observations == seen[:, None]).all()
        hits += infos["impacts"].sum()
        if truncated.any():
            for name in ("robustness", "success"):
                assert np.array_equal(infos[name], [step[4][name] for step in stepped])
            break
    return hits


@pytest.mark.parametrize("suite", ["nominal", "hard"])
@pytest.mark.parametrize("name", ["floating_manipulator", "floating_manipulator_thrusters"])
def test_worlds_are_environments(name, suite):
    scenario = soon(name, suite)
    assert check_same(scenario, SEED, scenario.steps) > 0


def test_a_box_that_is_pushed_and_a_motor_without_thrusters():
    scenario = soon(thrusters=None, **{"believed.restitution": 0.0, "true.delay_steps": 3})
    assert check_same(scenario, SEED, scenario.steps) > 0


@pytest.mark.slow
@pytest.mark.parametrize("suite", ["nominal", "all", "sensing", "hard"])
@pytest.mark.parametrize("name", NAMES)
def test_whole_episodes_are_those_of_environments(name, suite):
    scenario = load_scenario(name).suite(suite)
    for first in range(SEED, SEED + 6, WORLDS):
        check_same(scenario, first, scenario.steps)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_autoreset_modes_are_gymnasiums(mode):
    scenario = soon(suite="hard")
    mine = vector_env(scenario, WORLDS, autoreset_mode=mode, max_cycles=5, threads=2)
    theirs = SyncVectorEnv([lambda: JointEnv(scenario, max_cycles=5)] * WORLDS, autoreset_mode=mode)
    assert mine.single_observation_space == theirs.single_observation_space
    assert mine.single_action_space == theirs.single_action_space
    assert np.array_equal(mine.reset(seed=4)[0], theirs.reset(seed=4)[0])
    over = np.zeros(WORLDS, bool)
    for actions in draw_actions(mine, 17):
        if mode is AutoresetMode.DISABLED and over.any():
            options = {"reset_mask": over.copy()}
            assert np.array_equal(mine.reset(options=dict(options))[0], theirs.reset(options=options)[0])
        found, wanted = mine.step(actions), theirs.step(actions)
        for one, two in zip(found[:4], wanted[:4], strict=True):
            assert np.array_equal(one, two)
        over = found[2] | found[3]
        if mode is AutoresetMode.SAME_STEP and over.any():
            assert np.array_equal(found[4]["final_obs"], np.stack(wanted[4]["final_obs"]))


def test_a_lost_world_ends_as_a_lost_environment_and_starts_again():
    scenario = soon()
    worlds, env = vector_env(scenario, 2, threads=1), parallel_env(scenario)
    worlds.reset(seed=0)
    env.reset(seed=1)
    still = np.zeros(worlds.action_space.shape)
    single = {agent: np.zeros(3) for agent in env.agents}
    worlds.step(still)
    env.step(single)
    worlds.batch._worlds.v[1, -3] = np.nan
    env.model._v[-3] = np.nan
    observations, rewards, terminated, _, infos = worlds.step(still)
    _, expected, _, _, told = env.step(single)
    assert terminated.tolist() == [False, True]
    assert infos["failure"].tolist() == ["", told["arm"]["failure"]]
    assert rewards[1] == sum(expected.values())
    assert np.array_equal(observations[1], env.task.observe_jointly(env.time, env.conjuncts))
    observations, _, terminated, *_ = worlds.step(still)
    assert np.isfinite(observations).all()
    assert not terminated.any()


def test_a_copy_goes_on_bit_for_bit_and_float32_is_the_same_rounded():
    worlds = vector_env(soon(suite="hard"), 2, threads=2)
    worlds.reset(seed=SEED)
    actions = draw_actions(worlds, 40)
    for action in actions[:20]:
        worlds.step(action)
    twin = copy.deepcopy(worlds)
    for action in actions[20:]:
        assert np.array_equal(worlds.step(action)[0], twin.step(action)[0])


@pytest.mark.slow  # compiled apart
def test_float32_is_float64_rounded():
    single, double = (vector_env(soon(suite="hard"), 2, threads=1, dtype=dtype) for dtype in ("float32", "float64"))
    assert np.array_equal(single.reset(seed=SEED)[0], double.reset(seed=SEED)[0].astype(np.float32))
    for actions in draw_actions(single, 60):
        one, two = single.step(actions), double.step(actions)
        assert one[0].dtype == np.float32
        assert np.array_equal(one[0], two[0].astype(np.float32))


def test_what_cannot_be_done_is_refused_in_one_line():
    worlds = vector_env(soon(), 2, threads=1)
    worlds.reset(seed=0)
    actions = np.zeros(worlds.action_space.shape)
    actions[1, 4] = np.nan
    with pytest.raises(InputError, match=r"action of base in world 1 = \[0.0, nan, 0.0\]"):
        worlds.step(actions)
    assert worlds.batch.steps.tolist() == [0, 0]
    with pytest.raises(InputError, match="device 'cuda'"):
        vector_env(soon(), 2, device="cuda")
    with pytest.raises(InputError, match=r"num_envs = 1000000000000: \d+ bytes per world"):
        vector_env(soon(), 10**12)
