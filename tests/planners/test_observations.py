"""What every expert makes of observations that are none: one line where the shape is wrong, else a counted fallback."""

import numpy as np
import pytest

from impact_envs import parallel_env
from impact_envs.errors import InputError
from planners import make_expert, make_expert_batch

# One scenario of each domain.
DOMAINS = ("throw_and_catch", "floating_manipulator_thrusters", "dual_arm_grasp")


@pytest.fixture(scope="module", params=DOMAINS)
def acting(request):
    return parallel_env(request.param), make_expert(request.param)


def start(acting):
    env, expert = acting
    observations, _ = env.reset(seed=0)
    expert.reset(0)
    return env, expert, observations


@pytest.mark.parametrize(
    "kind", ["short", "long", "empty", "text", "none", "row", "complex", "missing", "no dict", "nothing"]
)
def test_observations_of_another_shape_are_refused_in_one_line(acting, kind):
    _, expert, observations = start(acting)
    last = list(observations)[-1]
    whole = observations[last]
    if kind == "missing":
        del observations[last]
    elif kind in ("no dict", "nothing"):
        observations = whole if kind == "no dict" else {}
    else:
        observations[last] = {
            "short": whole[:-1],
            "long": np.append(whole, 0.0),
            "empty": [],
            "text": "abc",
            "none": None,
            "row": whole[None],
            "complex": whole.astype(complex),
        }[kind]
    with pytest.raises(InputError, match="observation") as error:
        expert.act(observations)
    assert "\n" not in str(error.value)


def test_a_list_is_an_observation(acting):
    _, expert, observations = start(acting)
    actions = expert.act(observations)
    expert.reset(0)
    again = expert.act({name: vector.tolist() for name, vector in observations.items()})
    assert all(np.array_equal(actions[name], again[name]) for name in actions)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200, -1e300, 1e154, 1e20, 1e8])
def test_no_action_is_nan_whatever_is_observed(acting, value):
    env, expert, observations = start(acting)
    rng = np.random.default_rng(0)
    for step in range(30):
        if 3 <= step < 18:
            for vector in observations.values():
                vector[rng.integers(len(vector), size=1 + step % 4)] = value
        if step == 18:
            for vector in observations.values():
                vector[:] = value
        actions = expert.act(observations)
        assert all(np.isfinite(action).all() and (abs(action) <= 1).all() for action in actions.values())
        observations, *_ = env.step(actions)
    if abs(value) > 1e10 or np.isnan(value):
        assert sum(expert.diagnostics().fallbacks.values()) > 0


def test_worlds_of_experts_do_as_one():
    env = parallel_env(DOMAINS[0])
    env.reset(seed=0)
    scenario = env.scenario
    experts = make_expert_batch(scenario, 2, threads=1)
    size = env.task.joint_layout.size
    for wrong in (
        np.zeros((2, size - 1)),
        np.zeros(size),
        "abc",
        [[1.0], [1.0, 2.0]],
        np.zeros((2, size), complex),
        None,
    ):
        with pytest.raises(InputError, match="observations") as error:
            experts.act(wrong)
        assert "\n" not in str(error.value)
    observations = np.array([env.task.observe_jointly(0.0, (0.0, 0.0))] * 2)
    experts.act(observations)
    observations[:, 3] = 1e200
    for _ in range(20):
        assert np.isfinite(experts.act(observations + 0.0)).all()
    assert (experts.counts["no_measurement"] + experts.counts["rejected"] > 0).all()
