"""World k is ResidualEnv with seed + k, bit for bit; one step is one decision of every world."""

from __future__ import annotations

import pickle
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from agents import ResidualEnv, ResidualVectorEnv
from impact_envs import InputError, ResetNeeded, gym_id, list_scenarios, load_scenario
from impact_envs.domain import find_part
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from tests.frozen.freeze import get_plan

WORLDS, SEED = 3, 100
SIZE, FEATURES = FreeFlyerExpertBatch.correction_size, FreeFlyerExpertBatch.feature_size
LOOPED = [name for name in list_scenarios() if find_part("agents", load_scenario(name).domain, "LOOP")]
MODES = [mode.value for mode in AutoresetMode]
EVERYWHERE = ("seed", "control_steps")
ENDS = ("robustness", "success", "decided")


# Short episodes in which every domain's expert awaits corrections.
SHORT = {
    "dual_arm_grasp": load_scenario("dual_arm_grasp").override(
        {"horizon": 1.3, "formula": "G[0,1.3] box.lag <= 0.015"}
    ),
    "floating_manipulator_thrusters": load_scenario("floating_manipulator_thrusters").shorten(0.1),
}


def make(name: str, suite: str = "all", worlds: int = WORLDS, **options: Any) -> ResidualVectorEnv:
    settings = {"plan": get_plan(name, suite), "threads": 1} | options
    return ResidualVectorEnv(name, worlds, suite, **settings)


def make_singles(name: str, suite: str = "all", mode: str = "NextStep", **options: Any) -> SyncVectorEnv:
    plan = get_plan(name, suite)
    return SyncVectorEnv([lambda: ResidualEnv(name, suite, plan, **options)] * WORLDS, autoreset_mode=mode)


def play_both(mine: VectorEnv[Any, Any, Any], theirs: SyncVectorEnv, steps: int) -> Iterator[tuple[Any, Any]]:
    """Step both with the same random corrections, now and then beyond the limits."""
    shape = (steps, WORLDS, *mine.single_action_space.shape)
    for corrections in np.random.default_rng(0).uniform(-1.2, 1.2, shape).astype(np.float32):
        yield mine.step(corrections), theirs.step(np.clip(corrections, -1.0, 1.0))


def check_equal(mine: VectorEnv[Any, Any, Any], theirs: SyncVectorEnv, steps: int) -> int:
    """Return how many episodes ended, all alike."""
    ends = 0
    first, second = mine.reset(seed=SEED), theirs.reset(seed=SEED)
    np.testing.assert_array_equal(first[0], second[0])
    for (*one, infos), (*two, expected) in play_both(mine, theirs, steps):
        for ours, single in zip(one, two, strict=True):
            assert ours.dtype == single.dtype
            np.testing.assert_array_equal(ours, single)
        for name in EVERYWHERE:
            here = expected[f"_{name}"]
            np.testing.assert_array_equal(infos[name][here], expected[name][here])
        over = one[2] | one[3]
        ends += int(over.sum())
        if over.any():
            last, single = infos.get("final_info", infos), expected.get("final_info", expected)
            for name in ENDS:
                np.testing.assert_array_equal(last[name][over], single[name][over])
                np.testing.assert_array_equal(last[f"_{name}"], over)
        if "final_obs" in expected:
            for k in np.flatnonzero(over):
                np.testing.assert_array_equal(infos["final_obs"][k], expected["final_obs"][k])
    return ends


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_worlds_are_residual_envs_bit_for_bit_across_episodes(mode: str) -> None:
    mine, theirs = make("throw_and_catch", autoreset_mode=mode), make_singles("throw_and_catch", mode=mode)
    assert mine.single_observation_space == theirs.single_observation_space
    assert mine.single_action_space == theirs.single_action_space
    assert check_equal(mine, theirs, 10) >= 2 * WORLDS


@pytest.mark.parametrize("name", SHORT)
def test_worlds_of_other_domains_are_residual_envs_bit_for_bit(name: str) -> None:
    mine = ResidualVectorEnv(SHORT[name], WORLDS, "all", threads=2)
    theirs = SyncVectorEnv([lambda: ResidualEnv(SHORT[name], "all")] * WORLDS)
    assert check_equal(mine, theirs, 12) >= WORLDS


def test_a_cut_is_no_decided_end_and_shows_the_features_there() -> None:
    mine, theirs = (build("throw_and_catch", max_cycles=120) for build in (make, make_singles))
    assert check_equal(mine, theirs, 8) >= WORLDS
    mine.reset(seed=SEED)
    over, infos = np.zeros(WORLDS, bool), dict[str, Any]()
    while not over.all():
        _, _, _, over, infos = mine.step(np.zeros((WORLDS, SIZE)))
    assert not infos["decided"].any()


@pytest.mark.slow  # with plans made anew in the background, and two objects due at once
@pytest.mark.parametrize("suite", ["nominal", "all", "hard", "short"])
@pytest.mark.parametrize("name", LOOPED)
def test_every_scenario_and_suite_is_residual_envs_bit_for_bit(name: str, suite: str) -> None:
    if suite not in load_scenario(name)._suites() or (name == "crew" and suite in ("short", "hard")):
        pytest.skip(f"{name} has no plan within minutes, or no suite {suite}")
    mine, theirs = make(name, suite, threads=2), make_singles(name, suite)
    assert check_equal(mine, theirs, 12) >= 1


def test_without_autoreset_a_mask_restarts_worlds() -> None:
    worlds = make("throw_and_catch", autoreset_mode="Disabled")
    first, _ = worlds.reset(seed=SEED)
    over = np.zeros(WORLDS, bool)
    while not over.any():
        features, _, _, over, _ = worlds.step(np.zeros((WORLDS, SIZE)))
    with pytest.raises(ResetNeeded, match="step after the end of the episode of world"):
        worlds.step(np.zeros((WORLDS, SIZE)))
    again, infos = worlds.reset(seed=SEED, options={"reset_mask": over})
    np.testing.assert_array_equal(again[over], first[over])
    np.testing.assert_array_equal(again[~over], features[~over])
    assert "robustness" not in infos


@pytest.mark.parametrize("threads", [1, 2])
def test_seed_decides_everything(threads: int) -> None:
    one, two = make("pong", threads=1), make("pong", threads=threads)
    found = []
    for worlds in (one, two, one):
        trace = [worlds.reset(seed=SEED)]
        trace += [worlds.step(np.full((WORLDS, SIZE), 0.3)) for _ in range(6)]
        found.append(trace)
    assert data_equivalence(found[0], found[1], exact=True)
    assert data_equivalence(found[0], found[2], exact=True)


def test_arrays_are_fresh_at_every_step() -> None:
    worlds = make("throw_and_catch")
    first, _ = worlds.reset(seed=SEED)
    kept = first.copy()
    second, *_ = worlds.step(np.zeros((WORLDS, SIZE)))
    assert not np.shares_memory(first, second)
    np.testing.assert_array_equal(first, kept)


def test_a_copy_goes_on_alike() -> None:
    worlds = make("throw_and_catch", options={"plan_anew": False})
    worlds.reset(seed=SEED)
    copied = pickle.loads(pickle.dumps(worlds))
    for _ in range(4):
        assert data_equivalence(worlds.step(np.ones((WORLDS, SIZE))), copied.step(np.ones((WORLDS, SIZE))), exact=True)


def test_make_vec_gives_it() -> None:
    plan = get_plan("corridor", "nominal")
    made = gymnasium.make_vec(gym_id("corridor", residual=True), num_envs=2, plan=plan)
    assert isinstance(made.unwrapped, ResidualVectorEnv)
    features, _ = made.reset(seed=0)
    assert features.shape == (2, FEATURES)
    cut = gymnasium.make_vec(gym_id("corridor", residual=True), num_envs=2, plan=plan, max_episode_steps=50)
    cut.reset(seed=0)
    assert cut.step(np.zeros((2, SIZE)))[3].all()


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        (np.zeros(SIZE), r"actions of shape \(3,\), float64: real numbers of shape \(3, 3\) are needed"),
        ([["a", "b"]] * WORLDS, "real numbers of shape"),
        (np.full((WORLDS, SIZE), np.nan), r"action of world 0 = \[nan, nan, nan\]: finite numbers only"),
    ],
)
def test_bad_actions_are_named(actions: Any, words: str) -> None:
    worlds = make("throw_and_catch")
    with pytest.raises(ResetNeeded, match="step before reset"):
        worlds.step(actions)
    worlds.reset(seed=SEED)
    with pytest.raises(InputError, match=words):
        worlds.step(actions)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"worlds": 0}, "num_envs = 0"),
        ({"autoreset_mode": "Never"}, "autoreset_mode 'Never' is unknown"),
        ({"max_cycles": 0}, "max_cycles = 0"),
        ({"options": {"plan_anewe": False}}, "plan_anew"),
        ({"plan": 3}, "plan = 3: a Plan is needed"),
        ({"render_mode": "rgb_array"}, "render_mode 'rgb_array': decisions of many worlds are not drawn"),
        ({"max_episode_steps": 0}, "max_episode_steps = 0"),
        ({"max_episode_steps": 5, "max_cycles": 5}, "give only one"),
    ],
)
def test_bad_arguments_are_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make("throw_and_catch", **options)


def step_for_ever(worlds: ResidualVectorEnv) -> None:
    while True:
        worlds.step(np.zeros((worlds.num_envs, SIZE)))


def test_ctrl_c_is_answered_while_worlds_run() -> None:
    """A whole episode of 512 worlds takes seconds; whoever interrupts has to reset."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    worlds = make("pong", worlds=512, threads=2, options={"plan_anew": False})
    worlds.reset(seed=SEED)
    timer = threading.Timer(0.3, signal.raise_signal, [signal.SIGINT])
    timer.start()
    asked = time.perf_counter() + 0.3
    with pytest.raises(KeyboardInterrupt):
        step_for_ever(worlds)
    assert time.perf_counter() - asked < 2.0
    with pytest.raises(ResetNeeded):
        worlds.step(np.zeros((512, SIZE)))
    # No thread goes on behind the reset.
    twin = make("pong", worlds=512, threads=1, options={"plan_anew": False})
    np.testing.assert_array_equal(worlds.reset(seed=SEED)[0], twin.reset(seed=SEED)[0])
    np.testing.assert_array_equal(worlds.step(np.zeros((512, SIZE)))[0], twin.step(np.zeros((512, SIZE)))[0])
