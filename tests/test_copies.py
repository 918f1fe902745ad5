"""A copy of anything that a user can hold goes on as the original does, bit for bit, and alone."""

import copy
import multiprocessing
import pickle
from functools import cache
from hashlib import sha256

import gymnasium
import numpy as np
import pytest

from agents.residual import ResidualPolicy
from agents.vec_env import ImpactVecEnv
from impact_envs import gym_id, load_scenario, parallel_env, rollout, vector_env
from impact_envs.rollout import RandomPolicy, ZeroPolicy
from impact_envs.stl import parse
from impact_envs.stl.monitor import Monitor
from planners import make_expert, make_expert_batch
from tests.frozen.freeze import get_plan
from train.evaluation.player import checkpoint_directory

FRESH, STARTED, UNDER_WAY = 0, 1, 2
STEPS = 8
SEED = 1_000_003
DISTURBED = {"throw_and_catch": "all", "floating_manipulator_thrusters": "all", "dual_arm_grasp": "all"}


@cache
def plan_of(name):
    return get_plan(name, "nominal")


def load(name):
    return load_scenario(name).suite(DISTURBED[name])


class Player:
    """What is copied: something that steps, with the steps already made; subclasses say how it starts and steps."""

    steps = 0
    count = STEPS  # made by each go_on

    def go_on(self):
        """Start if it has not, make some steps, and return a digest of all that was seen."""
        seen = [] if self.steps else [self.start()]
        for _ in range(self.count):
            self.steps += 1
            seen.append(self.step(np.random.default_rng(self.steps)))
        return sha256(repr(flatten(seen)).encode()).hexdigest()

    def bring(self, moment):
        """Bring a new one to a moment."""
        if moment == STARTED:
            self.start_only()
        elif moment == UNDER_WAY:
            self.go_on()
        return self

    def start_only(self):
        """Start; `go_on` will start it once more."""
        self.start()


def flatten(seen):
    """Return nested results as lists of text and bytes."""
    if isinstance(seen, dict):
        return [[str(key), flatten(value)] for key, value in seen.items()]
    if isinstance(seen, list | tuple):
        return [flatten(value) for value in seen]
    if isinstance(seen, np.ndarray):
        return flatten(seen.tolist()) if seen.dtype == object else [str(seen.dtype), seen.shape, seen.tobytes()]
    return repr(seen)


class Environment(Player):
    """Anything with reset(seed=...) and step(action)."""

    over = False

    def __init__(self, env, count=STEPS):
        self.env, self.count = env, count

    def start(self):
        return self.env.reset(seed=SEED)

    def is_over(self, seen):
        return isinstance(seen[3], bool) and seen[3]

    def draw(self, rng):
        return rng.uniform(-1, 1, self.env.action_space.shape).astype(np.float32)

    def step(self, rng):
        seen = None if self.over else self.env.step(self.draw(rng))
        self.over = self.over or self.is_over(seen)
        return seen


class Parallel(Environment):
    """A PettingZoo environment."""

    def is_over(self, seen):
        return not self.env.agents

    def draw(self, rng):
        return {name: rng.uniform(-1, 1, self.env.action_space(name).shape) for name in self.env.agents}


class Learners(Environment):
    """A VecEnv of stable-baselines3."""

    def start(self):
        self.env.seed(SEED)
        return self.env.reset()

    def draw(self, rng):
        return rng.uniform(-1, 1, (self.env.num_envs, *self.env.action_space.shape))


class Flown(Player):
    """A policy with the environment it acts in."""

    def __init__(self, name, policy):
        self.env, self.policy = parallel_env(load(name)), policy

    def start(self):
        self.policy.reset(SEED)
        self.observations = self.env.reset(seed=SEED)[0]
        return self.observations

    def step(self, rng):
        actions = self.policy.act(self.observations)
        self.observations, *results = self.env.step(actions)
        return actions, self.observations, results


class FlownBatch(Player):
    """An expert batch with the vector environment it acts in."""

    def __init__(self, name):
        scenario = load(name)
        self.env = vector_env(scenario, 3, threads=2)
        self.experts = make_expert_batch(scenario, 3, plan_of(name), threads=2)

    def start(self):
        self.observations = self.env.reset(seed=SEED)[0]
        return self.observations

    def step(self, rng):
        actions = self.experts.act(self.observations)
        self.observations, *results = self.env.step(actions)
        return actions, self.observations, results


class Watched(Player):
    """An online monitor."""

    def __init__(self, text):
        self.monitor = Monitor(parse(text), 0.1, {}, ("a",))

    def start(self):
        self.monitor.reset()
        return self.monitor.interval

    def step(self, rng):
        return self.monitor.update({"a.x": rng.normal(), "a.y": rng.normal()})


def residual(name, checkpoint):
    scenario = load_scenario(name)
    return ResidualPolicy.load(checkpoint_directory(checkpoint), scenario, plan_of(name))


DISTURBED |= {"corridor": "hard", "pong": "hard"}
MAKERS = {
    **{f"ParallelEnv {name}": lambda name=name: Parallel(parallel_env(load(name))) for name in DISTURBED},
    "JointEnv": lambda: Environment(gymnasium.make("impact_envs/ThrowAndCatch-v2")),
    "vector_env": lambda: Environment(vector_env(load("throw_and_catch"), 3, threads=2)),
    "vector_env nominal": lambda: Environment(vector_env("corridor", 2, autoreset_mode="SameStep", max_cycles=5)),
    "ImpactVecEnv": lambda: Learners(ImpactVecEnv(load("throw_and_catch"), 2)),
    **{
        # A step lasts until the next correction, seconds later.
        f"residual {name}": lambda name=name: Environment(gymnasium.make(gym_id(name, residual=True)), count=3)
        for name in ("throw_and_catch", "floating_manipulator_thrusters", "dual_arm_grasp")
    },
    **{
        f"expert {name}": lambda name=name: Flown(name, make_expert(load(name)))
        for name in ("floating_manipulator_thrusters", "dual_arm_grasp")
    },
    **{
        f"expert by {tracker}": lambda tracker=tracker: Flown(
            "throw_and_catch", make_expert(load("throw_and_catch"), plan_of("throw_and_catch"), tracker=tracker)
        )
        for tracker in ("mpc", "lqr", "casadi", "cvxpy")
    },
    "expert batch": lambda: FlownBatch("throw_and_catch"),
    "ZeroPolicy": lambda: Flown("throw_and_catch", ZeroPolicy(parallel_env("throw_and_catch"))),
    "RandomPolicy": lambda: Flown("throw_and_catch", RandomPolicy(parallel_env("throw_and_catch"))),
    **{
        f"checkpoint {checkpoint}": lambda name=name, checkpoint=checkpoint: Flown(name, residual(name, checkpoint))
        for name, checkpoint in (
            ("pong", "pong_hard"),
            ("floating_manipulator_thrusters", "floating_manipulator_thrusters_hard"),
            ("dual_arm_grasp", "dual_arm_grasp_hard"),
        )
    },
    "Monitor": lambda: Watched("G[0,2] F[0,1] a.x > 0 & (a.x > 0 until[0,1] a.y > 0)"),
}


def go_on(pickled):
    return [pickle.loads(each).go_on() for each in pickled]


@pytest.fixture(scope="module")
def spawned():
    """Start one process for all that is sent away."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        yield pool


@pytest.mark.parametrize("name", MAKERS)
def test_a_copy_goes_on_as_the_original(name, spawned):
    away, here, stayed = [], [], []
    for moment in (FRESH, STARTED, UNDER_WAY):
        original = MAKERS[name]().bring(moment)
        sent = pickle.dumps(original)
        away.append(sent)
        copies = copy.deepcopy(original), pickle.loads(sent)
        here.append([each.go_on() for each in copies])  # before the original: they must not move it
        stayed.append(original.go_on())
        assert len({*here[-1], stayed[-1]}) == 1, moment
    assert spawned.apply(go_on, (away,)) == stayed


def test_a_copy_of_many_worlds_is_judged_by_its_own_states():
    """Pushed right, past what the formula allows."""
    scenario = load_scenario("throw_and_catch")
    name = scenario.agents[0]
    scenario = scenario.override({"formula": f"G[0,5] {name}.x <= 0.02", "horizon": 5.0})
    env = vector_env(scenario, 2)
    before = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    env.reset(seed=SEED)
    after = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    found = []
    for each in (env, *before, *after):
        if any(each is early for early in before):
            each.reset(seed=SEED)
        for _ in range(scenario.steps):
            infos = each.step(np.ones(each.action_space.shape))[4]
        found.append(infos["robustness"].tolist())
    assert found == [found[0]] * 5
    assert max(found[0]) < 0


def test_no_two_arrays_of_many_worlds_that_share_memory_are_parted():
    batch = vector_env("throw_and_catch", 2).batch
    copied = pickle.loads(pickle.dumps(batch))

    def list_arrays(each):
        return [array for group in each.arrays for array in (group if isinstance(group, tuple) else (group,))]

    old, new = (
        [array for array in list_arrays(each) if isinstance(array, np.ndarray) and array.size]
        for each in (batch, copied)
    )
    shared = [[np.shares_memory(a, b) for a in arrays for b in arrays] for arrays in (old, new)]
    assert shared[0] == shared[1]
    assert sum(shared[0]) > len(old)
    assert not any(np.shares_memory(a, b) for a in old for b in new)


@pytest.mark.parametrize("make", [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))])
def test_values_are_equal_to_their_copies(make):
    scenario, plan = load("throw_and_catch"), plan_of("throw_and_catch")
    assert make(scenario) == scenario
    assert make(plan).to_json() == plan.to_json()
    assert make(scenario.specification) == scenario.specification
    env = parallel_env(scenario, max_cycles=20)
    episode = rollout(env, make_expert(scenario, plan), SEED)
    copied = make(episode)
    assert flatten([vars(copied)]) == flatten([vars(episode)])
