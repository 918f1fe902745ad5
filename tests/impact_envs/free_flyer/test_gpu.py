"""The GPU's worlds are the CPU's: bit for bit in numba's CUDA simulator, nearly so on a GPU where there is one."""

import copy
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
import torch

from impact_envs import load_scenario, vector_env
from impact_envs.errors import InputError
from impact_envs.free_flyer import gpu
from impact_envs.free_flyer.batch import Batch
from impact_envs.free_flyer.contact.pair import REST_GAP
from impact_envs.free_flyer.gpu import SIMULATED, GpuBatch, check_gpu, check_room

WORLDS, STEPS = 3, 40
ALL = np.ones(WORLDS, bool)
on_device = pytest.mark.skipif(
    not (SIMULATED or torch.cuda.is_available()), reason="neither a GPU nor numba's CUDA simulator"
)


def strengthen(scenario):
    """Make robots strong, so that much is hit in a short time."""
    return scenario.override({f"robots.{name}.force_limit": 40.0 for name in scenario.agents})


def make_pair(scenario, **options):
    """Start the same worlds on the CPU and on the GPU; return both batches, each with what it fills."""
    pair = []
    for kind in (Batch, GpuBatch):
        batch = kind(scenario, WORLDS, **options)
        output = batch.make_output(agents=True)
        batch.seed(np.arange(WORLDS), [3, 4, 2**60])
        batch.start(ALL, output)
        pair.append((batch, output))
    return pair


def check_same(pair):
    (mine, ours), (theirs, expected) = pair
    for name in ("steps", "impacts", "overflow"):
        assert np.array_equal(getattr(theirs, name).cpu(), getattr(mine, name)), name
    tolerance = 0.0 if SIMULATED else 1e-9
    for new, old in zip((*expected, theirs.states, theirs.bounds), (*ours, mine.states, mine.bounds), strict=True):
        assert np.isfinite(old).all()
        np.testing.assert_allclose(new.cpu().numpy(), old, rtol=0, atol=tolerance)


def run_both(pair, actions, restarts=()):
    """Step both; in the step numbered as a restart, world 1 starts anew."""
    hits = []
    for t, action in enumerate(actions):
        restart = np.arange(WORLDS) == 1 if t in restarts else None
        for batch, output in pair:
            batch.step(action, output, restart)
        check_same(pair)
        hits.append(pair[0][0].impacts.copy())
    return np.array(hits)


@pytest.mark.skipif(SIMULATED, reason="runs the others in the simulator")
def test_in_the_simulator():
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", "-rs", __file__]
    run = subprocess.run(
        command, env=os.environ | {"NUMBA_ENABLE_CUDASIM": "1"}, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stdout
    assert "2 skipped" in run.stdout, run.stdout  # this one, and the one about having no GPU


@on_device
@pytest.mark.parametrize(("name", "suite"), [("corridor", "nominal"), ("corridor", "all"), ("crew", "hard")])
def test_worlds_are_the_cpus(name, suite):
    pair = make_pair(strengthen(load_scenario(name).suite(suite)))
    check_same(pair)
    robots = pair[0][0].robots
    drawn = np.random.default_rng(1).uniform(-1.2, 1.2, (STEPS // 10, WORLDS, robots, 3))
    hits = run_both(pair, np.repeat(drawn, 10, axis=0), restarts=(30,))
    assert hits.sum() > 0
    assert pair[1][0].steps.tolist() == [STEPS, STEPS - 31, STEPS]


@on_device
def test_progress_is_the_cpus():
    pair = make_pair(strengthen(load_scenario("corridor").suite("all")), reward="progress")
    drawn = np.random.default_rng(1).uniform(-1.0, 1.0, (STEPS // 10, WORLDS, 2, 3))
    assert run_both(pair, np.repeat(drawn, 10, axis=0), restarts=(30,)).sum() > 0
    potentials = [np.ravel(batch._memory.potential.tolist()) for batch, _ in pair]
    assert len(set(potentials[0])) == WORLDS
    np.testing.assert_allclose(*potentials, rtol=0, atol=0.0 if SIMULATED else 1e-9)


@on_device
def test_operators_inside_operators_are_the_cpus():
    alternations = "G[0,2] F[0,1] all in corridor & F[0,1] G[0,1] F[0.2,1] pop.y <= 2"
    joins = "G[0,2] (pop in goal -> F[0,1] snap in goal) & F[0,2] (pop in goal U[0.4,1] snap in goal)"
    formula = f"{alternations} & {joins} & F[0,2] (G[0,1] pop in goal & F[0,1] (pop in goal U[0,1] snap in goal))"
    pair = make_pair(load_scenario("corridor").override({"formula": formula}))
    check_same(pair)
    run_both(pair, np.random.default_rng(2).uniform(-1.0, 1.0, (STEPS, WORLDS, 2, 3)), restarts=(10,))
    low, high = pair[1][0].bounds[0]
    assert low == high


@on_device
def test_impacts_and_lasting_contact_are_the_cpus():
    scenario = strengthen(load_scenario("corridor")).override({"true.restitution": 0.3, "objects.pop.start": [1, 1.45]})
    pair = make_pair(scenario)
    actions = np.zeros((STEPS, WORLDS, 2, 3))
    actions[:, :, 0, 1] = 1.0  # one robot pushes the object forward,
    actions[:, 1, 0, 0] = 0.02  # in world 1 not quite along the line of centres,
    actions[:, 2, 1, 1] = -1.0  # in world 2 the other one comes to meet them
    early, late = run_both(pair, actions[:10]), run_both(pair, actions[10:30])
    assert early.any(axis=0).all()
    assert early[:, 0].sum() > 3
    assert late[:, 0].sum() == 0
    snap, pop = pair[0][0].states[0, [0, 2], :2]
    assert abs(np.linalg.norm(snap - pop) - 0.4) < REST_GAP
    assert run_both(pair, actions[30:])[:, 0].any()  # both against the wall
    assert not pair[0][0].overflow.any()


@on_device
def test_contact_with_friction_and_an_offset_centre_of_mass_is_the_cpus():
    extra = {"true.friction": 0.3, "true.center_of_mass_offset": 0.03, "objects.pop.start": [1, 1.45]}
    pair = make_pair(strengthen(load_scenario("corridor")).override({"true.restitution": 0.3, **extra}))
    actions = np.zeros((STEPS // 2, WORLDS, 2, 3))
    actions[:, :, 0] = [0.02, 1.0, 0.3]
    assert run_both(pair, actions).sum() > 3


@on_device
@pytest.mark.parametrize("make", [copy.deepcopy, lambda batch: pickle.loads(pickle.dumps(batch))])
def test_a_copy_goes_on_as_the_original(make):
    (_, (batch, output)) = make_pair(load_scenario("corridor"))
    actions = np.random.default_rng(1).uniform(-1, 1, (6, WORLDS, 2, 3))
    for action in actions[:3]:
        batch.step(action, output)
    copied = make(batch)
    theirs = copied.make_output(agents=True)
    for action in actions[3:]:
        batch.step(action, output)
        copied.step(action, theirs)
        for new, old in zip((*theirs, copied.bounds, copied.steps), (*output, batch.bounds, batch.steps), strict=True):
            assert torch.equal(new, old)
    assert copied._memory.signals.data_ptr() == copied._memory.states.data_ptr()


@on_device
def test_float32_is_stored_and_returned():
    (mine, ours), _ = make_pair(load_scenario("corridor"))
    batch = GpuBatch(load_scenario("corridor"), WORLDS, dtype=np.float32)
    output = batch.make_output(agents=True)
    batch.start(ALL, output)
    for action in np.random.default_rng(1).uniform(-1, 1, (5, WORLDS, 2, 3)):
        mine.step(action, ours)
        batch.step(action, output)
    for new, old in zip((*output, batch.states), (*ours, mine.states), strict=True):
        assert new.dtype is torch.float32
        np.testing.assert_allclose(new.cpu().numpy(), old, rtol=0, atol=1e-4)


@on_device
def test_tensors_stay_where_they_are():
    (_, (batch, output)) = make_pair(load_scenario("corridor"))
    for tensor in (*output, batch.states, batch.bounds, batch.steps, batch.over):
        assert tensor.device.type == batch.device.type
    assert batch.states.stride() == (1, 6 * WORLDS, WORLDS)
    states, rewards = batch.states, output.rewards
    before = states.clone()
    actions = torch.full((WORLDS, 2, 3), 1.0, dtype=torch.float32, device=batch.device, requires_grad=True)
    batch.step(actions, output)
    assert not torch.equal(states, before)
    assert (rewards != 0).all()
    assert batch.make_output(agents=False).agents.shape == (WORLDS, 0, batch.agent_size)


@on_device
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_the_vector_environment_is_the_cpus(mode):
    options = {"autoreset_mode": mode, "max_cycles": 3, "per_robot": True}
    mine, theirs = (vector_env("corridor", WORLDS, device=device, threads=1, **options) for device in ("cpu", "cuda"))
    results = [env.reset(seed=5) for env in (mine, theirs)]
    for action in torch.rand((7, WORLDS, 6), generator=torch.Generator().manual_seed(0)):
        check_same_tensors(*results)
        results = [mine.step(action), theirs.step(action.to(theirs.batch.device))]
    check_same_tensors(results[0] + (mine.agent_observations,), results[1] + (theirs.agent_observations,))


def check_same_tensors(mine, theirs):
    if isinstance(mine, dict):
        assert mine.keys() == theirs.keys()
        mine, theirs = tuple(mine.values()), tuple(theirs.values())
    if isinstance(mine, tuple):
        for old, new in zip(mine, theirs, strict=True):
            check_same_tensors(old, new)
    else:
        assert mine.dtype == theirs.dtype
        torch.testing.assert_close(theirs.cpu(), mine, rtol=0, atol=0.0 if SIMULATED else 1e-9)


@on_device
def test_the_end_of_an_episode_is_seen():
    (_, (batch, output)) = make_pair(load_scenario("corridor"), max_cycles=2)
    for over in (False, True):
        batch.step(np.zeros((WORLDS, 2, 3)), output)
        assert batch.over.tolist() == [over] * WORLDS


@on_device
def test_bad_actions_are_named_and_nothing_is_stepped():
    (_, (batch, output)) = make_pair(load_scenario("corridor"))
    actions = torch.zeros((WORLDS, 2, 3), device=batch.device)
    with pytest.raises(InputError, match=r"shape \(3, 6\); \(3, 2, 3\) is needed"):
        batch.step(actions.reshape(WORLDS, 6), output)
    actions[2, 1, 0] = torch.nan
    with pytest.raises(InputError, match=r"action of crackle in world 2 = \[nan, 0.0, 0.0\]: finite numbers only"):
        batch.step(actions, output)
    assert batch.steps.tolist() == [0, 0, 0]
    batch.step(actions, output, restart=np.arange(WORLDS) == 2)
    assert batch.steps.tolist() == [1, 1, 0]


@on_device
@pytest.mark.parametrize("count", [0, 10**15])
def test_batches_that_do_not_fit_are_refused(count):
    with pytest.raises(InputError, match=f"num_envs = {count}: "):
        GpuBatch(load_scenario("corridor"), count)


@on_device
def test_more_bodies_than_there_is_room_for_are_refused(monkeypatch):
    monkeypatch.setattr(gpu, "MOST_BODIES", 2)
    with pytest.raises(InputError, match="'corridor' has 3 bodies; on a GPU 2 are possible"):
        GpuBatch(load_scenario("corridor"), 1)


def test_room_is_limited():
    check_room("x", gpu.MOST_BODIES, gpu.MOST_PAIRS)
    with pytest.raises(InputError, match="'x' has 13 bodies; on a GPU 12 are possible"):
        check_room("x", 13, 0)
    with pytest.raises(InputError, match=r"'x' has 257 pairs .* on a GPU 256 are possible"):
        check_room("x", 1, 257)


@pytest.mark.skipif(SIMULATED or torch.cuda.is_available(), reason="there is a GPU, or one is simulated")
def test_without_a_gpu_it_says_so():
    with pytest.raises(InputError, match=r"device 'cuda': torch .* finds no GPU"):
        check_gpu()
    with pytest.raises(InputError, match=r"device 'cuda': torch .* finds no GPU"):
        GpuBatch(load_scenario("corridor"), 1)
