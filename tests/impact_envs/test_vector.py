"""Many worlds are JointEnv many times over, and behave as Gymnasium defines a vector environment."""

import itertools

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_reset_options, check_returned_data_not_reused, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from impact_envs import JointEnv, gym_id, list_scenarios, load_scenario, parallel_env, rollout, vector_env
from impact_envs.errors import InputError
from impact_envs.rollout import Diagnostics

DISCS = [name for name in list_scenarios() if load_scenario(name).domain == "free_flyer"]

SCENARIO = load_scenario("throw_and_catch").suite("all")
SUITES = ("nominal", "all", "hard")
WORLDS, CYCLES, SIZE = 3, 5, 6
ALWAYS = ("robustness_lower", "robustness_upper")
ONE, TWO = (np.arange(WORLDS) == k for k in (1, 2))
FLOAT32 = pytest.mark.slow  # compiled apart from float64: half a minute


def make_worlds(scenario=SCENARIO, worlds=WORLDS, threads=1, **options):
    return vector_env(scenario, worlds, threads=threads, **options)


def draw_actions(steps=20, size=SIZE, worlds=WORLDS, held=1, seed=0):
    """Beyond the limits now and then, so that clipping is compared too."""
    drawn = np.random.default_rng(seed).uniform(-1.2, 1.2, (-(-steps // held), worlds, size))
    return np.repeat(drawn, held, axis=0)[:steps]


def strengthen(scenario):
    """Make robots strong, so that much is hit in a short time."""
    return scenario.override({f"robots.{name}.force_limit": 40.0 for name in scenario.agents})


def check_infos(mine, theirs, over):
    """Compare infos with SyncVectorEnv's; what an end is told of twice, at the top too, where it resets at once."""
    for name in ALWAYS:
        assert mine[f"_{name}"].all()
        assert np.array_equal(mine[name][theirs[f"_{name}"]], theirs[name][theirs[f"_{name}"]])
    assert ("final_info" in mine) == ("final_info" in theirs)
    if not over.any():
        assert "robustness" not in mine
        assert "success" not in mine
        return
    last = theirs.get("final_info", theirs)
    for name in (*ALWAYS, "robustness", "success", "decided"):
        assert np.array_equal(mine.get("final_info", mine)[name][over], last[name][over])
    for name in ("robustness", "success", "decided"):
        assert np.array_equal(mine[f"_{name}"], over)
        assert np.array_equal(mine[name][over], last[name][over])


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_autoreset_modes_are_gymnasiums(mode):
    mine = make_worlds(autoreset_mode=mode, max_cycles=CYCLES)
    theirs = SyncVectorEnv([lambda: JointEnv(SCENARIO, max_cycles=CYCLES)] * WORLDS, autoreset_mode=mode)
    assert mine.metadata["autoreset_mode"] is mode
    assert mine.single_observation_space == theirs.single_observation_space
    assert mine.single_action_space == theirs.single_action_space
    assert mine.observation_space == theirs.observation_space
    assert mine.action_space == theirs.action_space
    assert np.array_equal(mine.reset(seed=4)[0], theirs.reset(seed=4)[0])
    ends, over = 0, np.zeros(WORLDS, bool)
    for step, actions in enumerate(draw_actions(24)):
        # World 1 is reset on the way, so that the worlds' episodes end at different times.
        mask = over if mode is AutoresetMode.DISABLED and over.any() else ONE if step == 2 else None
        if mask is not None:
            first, infos = mine.reset(options={"reset_mask": mask})
            assert np.array_equal(first, theirs.reset(options={"reset_mask": mask.copy()})[0])
            assert "robustness" not in infos
        one, two = mine.step(actions), theirs.step(actions)
        for ours, expected in zip(one[:4], two[:4], strict=True):
            assert ours.dtype == expected.dtype
            assert np.array_equal(ours, expected)
        over = one[3]
        ends += over.sum()
        check_infos(one[4], two[4], over)
        assert ("final_obs" in one[4]) == (mode is AutoresetMode.SAME_STEP and bool(over.any()))
        if "final_obs" in one[4]:
            assert np.array_equal(one[4]["_final_obs"], over)
            assert np.array_equal(one[4]["_final_info"], over)
            assert not one[4]["impacts"][over].any()
            for world in np.flatnonzero(over):
                assert np.array_equal(one[4]["final_obs"][world], two[4]["final_obs"][world])
                assert not np.array_equal(one[4]["final_obs"][world], one[0][world])
    assert ends >= 3 * WORLDS


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_gymnasiums_episode_statistics_are_those_of_single_environments(mode):
    mine = RecordEpisodeStatistics(make_worlds(autoreset_mode=mode, max_cycles=CYCLES))
    singles = [lambda: JointEnv(SCENARIO, max_cycles=CYCLES)] * WORLDS
    theirs = RecordEpisodeStatistics(SyncVectorEnv(singles, autoreset_mode=mode))
    mine.reset(seed=0)
    theirs.reset(seed=0)
    for actions in draw_actions(3 * CYCLES + 3):
        mine.step(actions)
        theirs.step(actions)
    assert len(mine.return_queue) == 3 * WORLDS
    assert list(mine.return_queue) == list(theirs.return_queue)
    assert list(mine.length_queue) == list(theirs.length_queue) == [CYCLES] * len(mine.length_queue)


def test_gymnasiums_checks_of_an_environment_hold():
    for mode in AutoresetMode:
        # Its checks are written for one environment; with the end at the second step a reset in the same step is seen.
        worlds = make_worlds(worlds=1, autoreset_mode=mode, max_cycles=2, per_robot=True)
        check_returned_data_not_reused(worlds)
        check_reset_options(worlds)


@pytest.mark.parametrize(
    ("name", "suite", "strong"),
    [*itertools.product(DISCS, SUITES, [True]), *itertools.product(["corridor", "crew"], SUITES, [False])],
)
def test_world_k_is_the_single_environment_with_seed_plus_k_bit_for_bit(name, suite, strong):
    scenario = load_scenario(name).suite(suite)
    scenario = strengthen(scenario) if strong else scenario
    worlds, single = make_worlds(scenario, per_robot=True), JointEnv(scenario)
    singles = [single, *(JointEnv(scenario) for _ in range(WORLDS - 1))]
    first, infos = worlds.reset(seed=11)
    assert np.array_equal(first, [env.reset(seed=11 + k)[0] for k, env in enumerate(singles)])
    assert np.array_equal(worlds.agent_observations[0], observe_apart(single))
    hits = 0
    for actions in draw_actions(60, single.action_space.shape[0], held=10):
        observations, rewards, _, _, infos = worlds.step(actions)
        for k, env in enumerate(singles):
            observation, reward, _, _, info = env.step(actions[k])
            assert np.array_equal(observations[k], observation)
            assert rewards[k] == reward
            assert infos["impacts"][k] == len(env.parallel.impacts)
            assert [infos[bound][k] for bound in ALWAYS] == [info[bound] for bound in ALWAYS]
        hits += infos["impacts"].sum()
        assert not infos["overflow"].any()
    assert np.array_equal(worlds.agent_observations[0], observe_apart(single))
    assert hits > 0 or not strong


def observe_apart(env):
    return list(env.parallel.task.observe(env.parallel.time, env.parallel.conjuncts).values())


def test_robustness_at_the_end_is_that_of_the_whole_recorded_episode():
    worlds, seed = make_worlds(strengthen(SCENARIO), autoreset_mode="Disabled"), 3
    actions = draw_actions(SCENARIO.steps, held=20)
    worlds.reset(seed=seed)
    for row in actions:
        _, _, _, over, infos = worlds.step(row)
    assert over.all()
    env = parallel_env(strengthen(SCENARIO))
    for k in range(WORLDS):
        episode = rollout(env, Replay(env, actions[:, k]), seed + k)
        assert infos["robustness"][k] == pytest.approx(episode.robustness, abs=1e-12)
        assert infos["success"][k] == episode.success
    assert len(set(infos["robustness"])) > 1


class Replay:
    """Recorded joint actions, as a policy."""

    name = "replay"

    def __init__(self, env, actions):
        self._agents, self._actions = env.possible_agents, actions

    def reset(self, seed):
        self._rows = iter(self._actions)

    def act(self, observations):
        return dict(zip(self._agents, np.split(next(self._rows), len(self._agents)), strict=True))

    def diagnostics(self):
        return Diagnostics()


def test_seeds_are_numbers_or_one_for_each_world_and_without_one_generators_go_on():
    worlds = make_worlds()
    first = worlds.reset(seed=7)[0]
    second = worlds.reset()[0]
    assert not np.array_equal(first, second)
    assert np.array_equal(worlds.reset(seed=[9, 8, 7])[0][::-1], first)
    assert np.array_equal(worlds.reset(seed=np.arange(7, 10))[0], first)
    assert np.array_equal(worlds.reset()[0], second)
    again = worlds.reset(seed=7, options={"reset_mask": TWO})[0]
    assert np.array_equal(again, np.where(TWO[:, None], first, second))
    assert not np.array_equal(make_worlds().reset()[0], make_worlds().reset()[0])


def test_a_masked_reset_leaves_the_other_worlds_alone():
    worlds, twin = make_worlds(per_robot=True), make_worlds(per_robot=True)
    worlds.reset(seed=1)
    twin.reset(seed=1)
    for step, actions in enumerate(draw_actions()):
        if step == 10:
            before, robots = twin.step(np.zeros((WORLDS, SIZE)))[0], twin.agent_observations
            worlds.step(np.zeros((WORLDS, SIZE)))
            after, _ = worlds.reset(options={"reset_mask": ONE})
            assert np.array_equal(after[~ONE], before[~ONE])
            assert np.array_equal(worlds.agent_observations[~ONE], robots[~ONE])
            assert not np.array_equal(after[ONE], before[ONE])
        mine, theirs = worlds.step(actions), twin.step(actions)
        assert np.array_equal(mine[0][~ONE], theirs[0][~ONE])
        assert np.array_equal(mine[1][~ONE], theirs[1][~ONE])


@FLOAT32
def test_float32_follows_float64():
    double, single = make_worlds(worlds=50), make_worlds(worlds=50, dtype="float32")
    assert single.observation_space.dtype == np.float32
    wide, narrow = double.reset(seed=0)[0], single.reset(seed=0)[0]
    for actions in draw_actions(60, worlds=50, held=10):
        assert narrow.dtype == np.float32
        assert narrow in single.observation_space
        assert np.allclose(wide, narrow, rtol=0, atol=1e-4)
        wide, narrow = double.step(actions)[0], single.step(actions)[0]
    assert np.allclose(wide, narrow, rtol=0, atol=1e-4)


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_threads_change_nothing(mode):
    options = {"worlds": 7, "autoreset_mode": mode, "max_cycles": CYCLES, "per_robot": True}
    one, two = make_worlds(**options), make_worlds(threads=2, **options)
    assert data_equivalence(one.reset(seed=2), two.reset(seed=2), exact=True)
    for actions in draw_actions(worlds=7):
        assert data_equivalence(one.step(actions), two.step(actions), exact=True)
        assert np.array_equal(one.agent_observations, two.agent_observations)
        assert np.array_equal(one.agent_rewards, two.agent_rewards)
    two.close()


def test_robots_rewards_add_up_and_their_observations_are_their_own():
    worlds = make_worlds(per_robot=True)
    worlds.reset(seed=0)
    for actions in draw_actions(10):
        rewards = worlds.step(actions)[1]
        assert worlds.agent_rewards.shape == (WORLDS, 2)
        assert np.allclose(worlds.agent_rewards.sum(axis=1), rewards, rtol=0, atol=1e-15)
    assert not np.array_equal(worlds.agent_observations[:, 0], worlds.agent_observations[:, 1])


def test_observations_are_in_their_space():
    worlds = make_worlds(autoreset_mode="SameStep", max_cycles=CYCLES)
    observations, _ = worlds.reset(seed=0)
    for actions in draw_actions(CYCLES):
        assert observations in worlds.observation_space
        observations, rewards, terminated, truncated, infos = worlds.step(actions)
        assert (rewards.dtype, terminated.dtype, truncated.dtype) == (np.float64, bool, bool)
        assert not terminated.any()
    assert observations in worlds.observation_space
    assert all(last in worlds.single_observation_space for last in infos["final_obs"])


@pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=FLOAT32)])
def test_tensors_share_memory_with_what_was_written_and_are_taken_in(dtype):
    torch = pytest.importorskip("torch")
    options = {"dtype": dtype, "per_robot": True, "autoreset_mode": "SameStep", "max_cycles": CYCLES}
    tensors, arrays = make_worlds(device="cpu", **options), make_worlds(**options)
    observations, _ = tensors.reset(seed=0)
    assert np.array_equal(observations.numpy(), arrays.reset(seed=0)[0])
    for actions in draw_actions(2 * CYCLES):
        mine = tensors.step(torch.from_numpy(actions))
        theirs = arrays.step(actions)
        for tensor, array in zip(mine[:4], theirs[:4], strict=True):
            assert isinstance(tensor, torch.Tensor)
            assert np.array_equal(tensor.numpy(), array)
        assert mine[0].dtype == getattr(torch, dtype)
        written = tensors._output
        assert mine[0].data_ptr() == written.joint.ctypes.data
        assert tensors.agent_observations.data_ptr() == written.agents.ctypes.data
        assert mine[4].keys() == theirs[4].keys()
        infos = mine[4] | mine[4].pop("final_info", {})
        assert all(isinstance(value, torch.Tensor) for value in infos.values())


def test_gymnasium_makes_them():
    worlds = gymnasium.make_vec(
        gym_id("throw_and_catch"),
        num_envs=WORLDS,
        vectorization_mode="vector_entry_point",
        max_cycles=CYCLES,
        autoreset_mode="SameStep",
    )
    plain = make_worlds("throw_and_catch", max_cycles=CYCLES, autoreset_mode=AutoresetMode.SAME_STEP)
    assert worlds.spec.id == gym_id("throw_and_catch")
    assert np.array_equal(worlds.reset(seed=0)[0], plain.reset(seed=0)[0])
    for actions in draw_actions(2 * CYCLES):
        assert data_equivalence(worlds.step(actions), plain.step(actions), exact=True)


@pytest.mark.parametrize("name", ["corridor", "crew"])
def test_a_world_needs_at_most_a_kilobyte_beyond_its_observations(name):
    sizes = [count_bytes(make_worlds(name, worlds).batch) for worlds in (1000, 3000)]
    parts = len(make_worlds(name, 1).batch.parts[0])  # whose intervals are there for critics to read
    conjuncts = len(load_scenario(name).specification.conjuncts())  # whose intervals are observed
    assert 0 < (sizes[1] - sizes[0]) / 2000 <= 1024 + 8 + 16 * (parts + conjuncts)  # 8: who was hit last


def count_bytes(batch):
    """Sum what a batch's arrays take, each piece of memory once."""
    pieces = {}
    for value in vars(batch).values():
        for array in value if isinstance(value, tuple) else (value,):
            if isinstance(array, np.ndarray):
                start = array.ctypes.data
                pieces[start] = max(array.nbytes, pieces.get(start, 0))
    return sum(pieces.values())


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_an_action_that_is_no_number_is_refused_and_nothing_is_stepped(mode, wrong):
    worlds, twin = (make_worlds(autoreset_mode=mode, max_cycles=CYCLES) for _ in range(2))
    worlds.reset(seed=0)
    twin.reset(seed=0)
    actions = draw_actions(4)
    worlds.step(actions[0])
    twin.step(actions[0])
    bad = actions[1].copy()
    bad[2, 4] = wrong
    with pytest.raises(InputError, match=f"{SCENARIO.agents[1]} in world 2"):
        worlds.step(bad)
    for row in actions[1:]:
        assert data_equivalence(worlds.step(row), twin.step(row), exact=True)


def test_actions_of_a_world_that_starts_anew_are_not_looked_at():
    worlds = make_worlds(autoreset_mode=AutoresetMode.NEXT_STEP, max_cycles=1)
    worlds.reset(seed=0)
    assert worlds.step(np.zeros((WORLDS, SIZE)))[3].all()
    observations, rewards, _, over, _ = worlds.step(np.full((WORLDS, SIZE), np.nan))
    assert np.isfinite(observations).all()
    assert not rewards.any()
    assert not over.any()


@pytest.mark.parametrize("shape", [(WORLDS, 5), (2, SIZE), (SIZE, WORLDS), (WORLDS * SIZE,), (SIZE,), ()])
def test_actions_of_another_shape_are_refused(shape):
    worlds = make_worlds()
    worlds.reset(seed=0)
    with pytest.raises(InputError, match="shape"):
        worlds.step(np.zeros(shape))


def test_steps_out_of_turn_are_refused():
    worlds = make_worlds(autoreset_mode=AutoresetMode.DISABLED, max_cycles=1)
    zeros = np.zeros((WORLDS, SIZE))
    with pytest.raises(InputError, match="reset"):
        worlds.step(zeros)
    worlds.reset(seed=0)
    worlds.reset(options={"reset_mask": ONE})
    worlds.step(zeros)
    worlds.reset(options={"reset_mask": ~TWO})
    with pytest.raises(InputError, match=r"after the end of the episode of world 2.*reset_mask"):
        worlds.step(zeros)


@pytest.mark.parametrize("seed", [None, 0])
def test_a_world_that_was_never_reset_is_not_stepped(seed):
    worlds = make_worlds(autoreset_mode=AutoresetMode.DISABLED)

    def reset_one_and_step_all():
        worlds.reset(seed=seed, options={"reset_mask": ONE})
        worlds.step(np.zeros((WORLDS, SIZE)))

    with pytest.raises(InputError, match="world 0"):
        reset_one_and_step_all()


@pytest.mark.parametrize(
    "mask", [np.zeros(WORLDS, bool), np.ones(WORLDS + 1, bool), np.ones((WORLDS, 1), bool), np.ones(WORLDS, int), "all"]
)
def test_a_mask_that_is_none_is_refused(mask):
    worlds = make_worlds()
    before = worlds.reset(seed=0)[0].copy()
    with pytest.raises(InputError, match="reset_mask"):
        worlds.reset(options={"reset_mask": mask})
    assert np.array_equal(worlds.reset(seed=0)[0], before)


@pytest.mark.parametrize(
    ("seed", "message"),
    [
        (-1, "seed = -1"),
        ([1, 2], "shape"),
        ([1, -2, 3], "world 1 = -2"),
        ([1, None, 3], "world 1 = None"),
        (1.5, "1.5|shape"),
        (2**64, "seed = 18446744073709551616"),
        (2**63, "seed = 9223372036854775808"),
        ([5, 2**63, 5], "world 1 = 9223372036854775808"),
    ],
)
def test_a_seed_that_is_none_is_refused(seed, message):
    with pytest.raises(InputError, match=message):
        make_worlds().reset(seed=seed)


def test_a_bad_seed_among_those_to_reset_is_named_by_its_world():
    worlds = make_worlds()
    worlds.reset(seed=0)
    with pytest.raises(InputError, match="world 2 = -3"):
        worlds.reset(seed=[1, 2, -3], options={"reset_mask": TWO})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"worlds": 0}, "num_envs = 0"),
        ({"worlds": -1}, "num_envs = -1"),
        ({"worlds": 2.5}, "num_envs = 2.5"),
        ({"dtype": "float16"}, "'float16' is unknown; did you mean 'float64'"),
        ({"threads": -1}, "threads = -1"),
        ({"autoreset_mode": "SAME"}, "'SAME'.*SameStep"),
    ],
)
def test_bad_arguments_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        make_worlds(**options)


def test_more_worlds_than_fit_are_refused_with_the_number_that_does():
    with pytest.raises(InputError, match=r"num_envs = 1000000000000: \d+ bytes per world; .* holds \d+ worlds"):
        make_worlds(worlds=10**12)


def test_what_the_exact_engine_does_not_take_is_refused():
    box = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]
    polygon = load_scenario("throw_and_catch").override({"objects.pop.vertices": box})
    for scenario in (polygon, load_scenario("throw_and_catch").override({"engine": "pymunk"})):
        with pytest.raises(InputError, match=r"throw_and_catch.*SyncVectorEnv"):
            make_worlds(scenario)
    with pytest.raises(InputError, match="did you mean 'corridor'"):
        make_worlds("coridor")
