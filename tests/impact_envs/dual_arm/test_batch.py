"""Many worlds of two arms are the single environment many times over, bit for bit."""

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, vector_env
from impact_envs.errors import InputError

NAME, SEED = "dual_arm_grasp", 1_000_000
# The pads of this one start at the box, so that something is hit at once; it ends after 60 periods of two ticks.
START = {
    "arms.arm_1.start": {"position": [-0.16, 0.28], "heading": 0.05},
    "arms.arm_2.start": {"position": [0.16, 0.31], "heading": 3.1},
    "control_period": 0.002,
    "horizon": 0.12,
    "formula": "G[0,0.12] box.lag <= 0.015 & F[0,0.12] box.force_min >= 1 & G[0.1,0.12] 0.001*box.slip <= 0.005",
    "true.start_x": 0.0,
    "true.start_y": 0.0,
    "true.start_heading": 0.0,
}
CLOSE = load_scenario(NAME).override(START)


def draw_actions(steps: int, worlds: int) -> np.ndarray:
    """Push the pads together, unevenly and beyond the limits now and then."""
    press = np.array([0.5, -0.4, -0.1, -0.5, 0.4, 0.1])
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, worlds, 6))
    return press + 0.8 * noise


def split(action: np.ndarray) -> dict[str, np.ndarray]:
    return {"arm_1": action[:3], "arm_2": action[3:]}


@pytest.mark.parametrize("suite", ["nominal", "box_pose", "hard"])
def test_worlds_equal_single_environments(suite):
    if suite == "nominal":
        scenario = CLOSE
    else:
        true = load_scenario(NAME).suite(suite).true.model_dump(exclude={"start_x", "start_y", "start_heading"})
        scenario = CLOSE.override({f"true.{name}": value for name, value in true.items() if value is not None})
    count, impacts = 3, 0
    worlds = vector_env(scenario, count, threads=2, per_robot=True)
    singles = [parallel_env(scenario) for _ in range(count)]
    joint, infos = worlds.reset(seed=SEED)
    for k, single in enumerate(singles):
        first, _ = single.reset(seed=SEED + k)
        assert np.array_equal(worlds.agent_observations[k], list(first.values()))
    for actions in draw_actions(60, count):
        joint, rewards, terminated, truncated, infos = worlds.step(actions)
        for k, single in enumerate(singles):
            seen, earned, _, _, _ = single.step(split(actions[k]))
            assert np.array_equal(worlds.agent_observations[k], list(seen.values()))
            assert np.array_equal(joint[k], single.task.observe_jointly(single.time, single.bounds))
            assert worlds.agent_rewards[k].tolist() == list(earned.values())
            assert rewards[k] == sum(earned.values())
            assert np.array_equal(worlds.batch.states[k], single.model.state())
            assert infos["impacts"][k] == len(single.impacts)
            assert (infos["robustness_lower"][k], infos["robustness_upper"][k]) == single.bounds
            impacts += len(single.impacts)
    assert truncated.all() and not terminated.any()
    assert impacts >= 2 * count - 1
    for k in range(count):
        assert infos["robustness"][k] == singles[k].bounds[0]
    # The next step starts the next episode of every world, as a reset without a seed does.
    joint, *_ = worlds.step(np.zeros((count, 6)))
    for k, single in enumerate(singles):
        single.reset()
        assert np.array_equal(joint[k], single.task.observe_jointly(0.0, single.bounds))


def test_threads_and_masks_change_nothing_elsewhere():
    one, two = (vector_env(CLOSE, 4, threads=n, autoreset_mode="Disabled") for n in (1, 3))
    for worlds in (one, two):
        worlds.reset(seed=SEED)
    for k, actions in enumerate(draw_actions(30, 4)):
        a, b = one.step(actions), two.step(actions)
        assert np.array_equal(a[0], b[0]) and np.array_equal(a[1], b[1])
        if k == 10:
            before = one.batch.states.copy()
            mask = np.array([False, True, False, False])
            for worlds in (one, two):
                worlds.reset(seed=7, options={"reset_mask": mask})
            assert np.array_equal(one.batch.states[~mask], before[~mask])
            assert one.batch.steps.tolist() == [11, 0, 11, 11]


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_lost_world_ends_alone_and_starts_again(mode):
    worlds, single = vector_env(CLOSE, 2, threads=1, autoreset_mode=mode), parallel_env(CLOSE)
    worlds.reset(seed=SEED)
    single.reset(seed=SEED + 1)
    still = np.zeros((2, 6))
    worlds.step(still)
    single.step(split(still[0]))
    for state in (worlds.batch._worlds[1]["state"], single.model._worlds[0]["state"]):
        state[24 + 3] = np.nan
    joint, rewards, terminated, truncated, infos = worlds.step(still)
    _, earned, _, _, told = single.step(split(still[0]))
    assert terminated.tolist() == [False, True] and not truncated.any()
    assert infos["failure"].tolist() == ["", told["arm_1"]["failure"]]
    assert rewards[1] == sum(earned.values())
    assert infos["robustness"][1] == told["arm_1"]["robustness"]
    seen = infos["final_obs"] if mode == "SameStep" else joint
    assert np.array_equal(seen[1], single.task.observe_jointly(single.time, single.bounds))
    worlds.step(still)
    assert not worlds.batch.failed.any()


def test_shorter_episodes_and_bad_input():
    worlds = vector_env(CLOSE, 2, threads=1, max_cycles=2)
    worlds.reset(seed=SEED)
    worlds.step(np.zeros((2, 6)))
    with pytest.raises(InputError, match=r"action of arm_2 in world 1 = \[0.0, nan, 0.0\]"):
        worlds.step(np.array([np.zeros(6), [0, 0, 0, 0, np.nan, 0]]))
    assert worlds.step(np.zeros((2, 6)))[3].all()
    with pytest.raises(InputError, match="device 'cuda': the worlds of domain 'dual_arm' run on the cpu only"):
        vector_env(CLOSE, 2, device="cuda")
    with pytest.raises(InputError, match="bytes per world; half of this machine's memory holds"):
        vector_env(CLOSE, 10**9)


@pytest.mark.slow
def test_float32_is_what_is_returned_only():
    exact, short = vector_env(CLOSE, 2, threads=1), vector_env(CLOSE, 2, threads=1, dtype="float32")
    for worlds in (exact, short):
        worlds.reset(seed=SEED)
    for actions in draw_actions(20, 2):
        a, b = exact.step(actions), short.step(actions)
    assert b[0].dtype == np.float32 and np.array_equal(a[0].astype(np.float32), b[0])
    assert np.array_equal(exact.batch.states, short.batch.states)
