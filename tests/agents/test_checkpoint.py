"""Checkpoints: what is read is what was written, broken ones are named in one line, and nothing in them is run."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from agents import ResidualPolicy, sb3
from agents.actor import Actor, PolicyRecord, load_policy, save_policy
from agents.sb3 import ALGORITHMS, LearningOptions, export_actor, start_at_expert
from agents.training_state import load_training, save_training
from impact_envs import InputError
from impact_envs.file import write_atomically
from planners.free_flyer.expert import FreeFlyerExpert
from planners.plan import Plan
from tests.agents.target import SIZES, Target, make_model
from tests.frozen.freeze import get_plan


def make_record(**changes: Any) -> PolicyRecord:
    fields = {
        "scenario": "throw_and_catch",
        "domain": "free_flyer",
        "suite": "restitution",
        "algorithm": "ppo",
        "feature_size": SIZES[0],
        "correction_size": SIZES[1],
        "hidden": (8, 4),
        "squash": "clip",
        "seed": 0,
        "steps": 10,
    }
    return PolicyRecord(**(fields | changes))


def make_actor(seed: int = 0, **changes: Any) -> Actor:
    torch.manual_seed(seed)
    actor = Actor(**({"feature_size": SIZES[0], "correction_size": SIZES[1], "hidden": (8, 4)} | changes))
    for parameter in actor.parameters():
        torch.nn.init.normal_(parameter, std=0.5)
    actor.mean.copy_(torch.linspace(-1, 1, len(actor.mean)))
    actor.std.copy_(torch.linspace(0.5, 2, len(actor.std)))
    return actor


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    save_policy(tmp_path / "policy", make_actor(), make_record())
    return tmp_path / "policy"


@pytest.fixture(scope="module")
def plan() -> Plan:
    return get_plan("throw_and_catch", "nominal")


@pytest.mark.parametrize("squash", ["clip", "tanh"])
def test_round_trip_gives_identical_corrections(tmp_path: Path, squash: str) -> None:
    actor = make_actor(squash=squash)
    save_policy(tmp_path, actor, make_record(squash=squash))
    again, record = load_policy(tmp_path)
    assert record == make_record(squash=squash, weights_digest=record.weights_digest)
    features = np.random.default_rng(0).normal(scale=4.0, size=(200, SIZES[0]))
    corrections = np.array([actor.correction(row) for row in features])
    np.testing.assert_array_equal(corrections, [again.correction(row) for row in features])
    assert np.all(np.abs(corrections) <= 1.0)
    assert len(np.unique(corrections)) > 100


def test_a_new_actor_corrects_nothing() -> None:
    features = np.random.default_rng(0).normal(scale=100.0, size=(50, SIZES[0]))
    for squash in ("clip", "tanh"):
        actor = Actor(*SIZES, squash=squash)
        assert all(np.array_equal(actor.correction(row), np.zeros(2)) for row in features)


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_exported_actor_is_the_models_deterministic_policy(algorithm: str) -> None:
    model, envs = make_model(algorithm)
    start_at_expert(model, log_std=-1.2)
    assert np.array_equal(export_actor(model, envs).correction(np.full(5, 7.0)), np.zeros(2))
    model.learn(96)
    actor = export_actor(model, envs)
    features = np.random.default_rng(1).normal(3.0, 2.0, size=(50, SIZES[0]))
    predicted, _ = model.predict(envs.normalize_obs(features), deterministic=True)
    corrections = np.array([actor.correction(row) for row in features])
    np.testing.assert_allclose(corrections, predicted, atol=1e-6)
    assert np.ptp(corrections) > 1e-3


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_algorithm_starts_at_the_expert_and_continues_after_a_stop(tmp_path: Path, name: str) -> None:
    options = LearningOptions(hidden=(8, 4), learning_rate=1e-2, rollout=16, batch=8, log_std=-1.2, seed=0)
    models = []
    for _ in range(2):
        envs = VecNormalize(DummyVecEnv([Target, Target]), norm_reward=False)
        models.append((sb3.make_model(name, envs, options), envs))
        assert np.array_equal(export_actor(*models[-1]).correction(np.full(5, 7.0)), np.zeros(2))
    (model, envs), (other, other_envs) = models
    assert sb3.find_name(model) == name
    model.learn(64)
    save_training(tmp_path, model, envs, {}, [])
    assert load_training(tmp_path, other, other_envs).algorithm == name
    actor, again = export_actor(model, envs), export_actor(other, other_envs)
    assert actor.squash == ALGORITHMS[name].squash
    features = np.random.default_rng(0).normal(3.0, 2.0, size=(20, SIZES[0]))
    corrections = np.array([actor.correction(row) for row in features])
    np.testing.assert_array_equal(corrections, [again.correction(row) for row in features])
    assert np.ptp(corrections) > 1e-3


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_training_starts_with_the_asked_exploration(algorithm: str) -> None:
    model, _ = make_model(algorithm)
    start_at_expert(model, log_std=-1.2)
    features = torch.zeros((1, SIZES[0]))
    if isinstance(model, PPO):
        spread = model.policy.get_distribution(features).distribution.stddev
    else:
        spread = model.actor.get_action_dist_params(features)[1].exp()
    assert spread.detach().numpy() == pytest.approx(np.exp(-1.2))


def flatten(value: Any, path: str = "") -> dict[str, Any]:
    """All leaves of nested dictionaries and lists."""
    if isinstance(value, dict | list | tuple):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return {k: leaf for key, item in items for k, leaf in flatten(item, f"{path}/{key}").items()}
    return {path: value.detach().numpy().tolist() if isinstance(value, torch.Tensor) else value}


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_restored_training_has_every_weight_and_optimiser_state(tmp_path: Path, algorithm: str) -> None:
    model, envs = make_model(algorithm)
    model.learn(64)
    save_training(tmp_path, model, envs, {"seed": 0}, [{"steps": 64}])
    other, other_envs = make_model(algorithm)
    record = load_training(tmp_path, other, other_envs)
    assert (record.steps, other.num_timesteps, other._n_updates) == (64, 64, model._n_updates)
    assert record.evaluations == [{"steps": 64}]
    before, after = flatten(model.get_parameters()), flatten(other.get_parameters())
    assert before == after
    assert sum("exp_avg" in key for key in before) > 4
    np.testing.assert_array_equal(envs.obs_rms.var, other_envs.obs_rms.var)
    assert envs.obs_rms.count == other_envs.obs_rms.count
    if isinstance(model, SAC) and isinstance(other, SAC):
        assert torch.equal(model.log_ent_coef, other.log_ent_coef)
        assert other.replay_buffer.size() == model.replay_buffer.size()
        np.testing.assert_array_equal(other.replay_buffer.actions, model.replay_buffer.actions)
    other.learn(32, reset_num_timesteps=False)
    assert other.num_timesteps == 96


def test_training_state_of_another_network_is_refused(tmp_path: Path) -> None:
    model, envs = make_model("ppo")
    save_training(tmp_path, model, envs, {}, [])
    path = tmp_path / "training.safetensors"
    tensors = load_file(path)
    name = "policy/action_net.weight"
    save_file(tensors | {name: np.zeros((3, 8), np.float32)}, path)
    with pytest.raises(InputError, match=r"training.safetensors: is damaged"):
        load_training(tmp_path, *make_model("ppo"))
    description = path.with_suffix(".json")
    description.write_text(json.dumps(json.loads(description.read_text()) | {"weights_digest": None}))
    with pytest.raises(InputError, match=rf"training.safetensors: tensor '{name}' is .* \[3, 8\], expected"):
        load_training(tmp_path, *make_model("ppo"))
    with pytest.raises(InputError, match=r"training\.json: key 'algorithm': is 'ppo', expected 'sac'"):
        load_training(tmp_path, *make_model("sac"))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("step", np.zeros((), np.float32), "'policy.optimizer/3/step' holds a value below 1"),
        ("step", np.zeros((0,), np.float32), r"'policy.optimizer/3/step' is float32 \[0\], expected float32 \[\]"),
        ("exp_avg", None, "'policy.optimizer/3/exp_avg' is missing"),
        ("exp_avg_sq", -1.0, "'policy.optimizer/3/exp_avg_sq' holds a value below 0"),
        ("more", np.zeros(1), "'policy.optimizer/3/more' is unknown"),
    ],
)
def test_moments_that_adam_cannot_have_are_refused(tmp_path: Path, name: str, value: Any, message: str) -> None:
    model, envs = make_model("ppo")
    model.learn(32)
    save_training(tmp_path, model, envs, {}, [])
    path, key = tmp_path / "training.safetensors", f"policy.optimizer/3/{name}"
    tensors = load_file(path)
    old = tensors.pop(key, None)
    if value is not None:
        tensors[key] = value if old is None or isinstance(value, np.ndarray) else np.full_like(old, value)
    save_file(tensors, path)
    description = path.with_suffix(".json")
    description.write_text(json.dumps(json.loads(description.read_text()) | {"weights_digest": None}))
    with pytest.raises(InputError, match=message):
        load_training(tmp_path, *make_model("ppo"))


def test_groups_of_another_optimiser_are_refused_but_for_the_learning_rate(tmp_path: Path) -> None:
    model, envs = make_model("ppo")
    save_training(tmp_path, model, envs, {}, [])
    path = tmp_path / "training.json"
    right = json.loads(path.read_text())
    for changes, message in (
        ({"params": [0, 1]}, r"params is \[0, 1\], expected"),
        ({"params": [{}]}, "params is .*, expected"),
        ({"betas": [0.9]}, r"betas is \[0.9\], expected \[0.9, 0.999\]"),
        ({"eps": "a\nb"}, "eps is "),
    ):
        group = right["param_groups"]["policy.optimizer"][0] | changes
        path.write_text(json.dumps(right | {"param_groups": {"policy.optimizer": [group]}}))
        with pytest.raises(InputError, match=message) as caught:
            load_training(tmp_path, *make_model("ppo"))
        assert str(caught.value).isprintable()
    group = right["param_groups"]["policy.optimizer"][0] | {"lr": 1.0}
    path.write_text(json.dumps(right | {"param_groups": {"policy.optimizer": [group]}}))
    load_training(tmp_path, *make_model("ppo"))


def edit_json(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        data = json.loads((folder / "policy.json").read_text())
        change(data)
        (folder / "policy.json").write_text(json.dumps(data))

    return edit


def edit_tensors(change: Callable[[dict[str, np.ndarray]], object]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        data = {name: array.copy() for name, array in load_file(folder / "policy.safetensors").items()}
        change(data)
        save_file(data, folder / "policy.safetensors")
        edit_json(lambda d: d.pop("weights_digest"))(folder)  # as a checkpoint of an earlier version

    return edit


def flip_bit(folder: Path) -> None:
    data = bytearray((folder / "policy.safetensors").read_bytes())
    data[-9] ^= 1
    (folder / "policy.safetensors").write_bytes(data)


def cut(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:-40]) and None


BREAKS: dict[str, tuple[Callable[[Path], object], str]] = {
    "no json": (lambda folder: (folder / "policy.json").unlink(), "has no policy.json"),
    "no weights": (lambda folder: (folder / "policy.safetensors").unlink(), "has no policy.safetensors"),
    "cut json": (cut("policy.json"), r"policy\.json: .*JSON"),
    "cut weights": (cut("policy.safetensors"), r"policy\.safetensors: not a safetensors file"),
    "flipped bit": (flip_bit, r"policy\.safetensors: is damaged, or of another checkpoint"),
    "empty weights": (lambda f: (f / "policy.safetensors").write_bytes(b""), "not a safetensors file"),
    "typo": (edit_json(lambda d: d.update(hiden=[8])), r"unknown key 'hiden'; did you mean 'hidden'\?"),
    "missing key": (edit_json(lambda d: d.pop("suite")), r"key 'suite': Field required"),
    "wrong type": (edit_json(lambda d: d.update(steps="ten")), r"key 'steps': .*integer"),
    "negative": (edit_json(lambda d: d.update(feature_size=-1)), r"key 'feature_size': .*greater"),
    "huge": (edit_json(lambda d: d.update(hidden=[10**9])), r"key 'hidden\.0': .*less"),
    "future": (edit_json(lambda d: d.update(format_version=2)), r"key 'format_version': "),
    "other size": (
        edit_json(lambda d: d.update(feature_size=6)),
        r"tensor 'mean' is float64 \[5\], expected float64 \[6\]",
    ),
    "other depth": (edit_json(lambda d: d.update(hidden=[8])), r"tensor 'layers\.2\.bias' is unknown"),
    "missing tensor": (edit_tensors(lambda d: d.pop("mean")), "tensor 'mean' is missing"),
    "extra tensor": (edit_tensors(lambda d: d.update(x=np.zeros(1))), "tensor 'x' is unknown"),
    "nan": (edit_tensors(lambda d: d["layers.1.bias"].fill(np.nan)), r"'layers\.1\.bias' .*not finite"),
    "zero std": (edit_tensors(lambda d: d["std"].fill(0.0)), "tensor 'std' .*not positive"),
    "double": (
        edit_tensors(lambda d: d.update({"layers.0.bias": d["layers.0.bias"].astype(np.float64)})),
        r"tensor 'layers\.0\.bias' is float64",
    ),
}


@pytest.mark.parametrize("name", BREAKS)
def test_a_broken_checkpoint_is_named_in_one_line(checkpoint: Path, name: str) -> None:
    break_it, message = BREAKS[name]
    break_it(checkpoint)
    with pytest.raises(InputError, match=message) as caught:
        load_policy(checkpoint)
    assert str(checkpoint) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_directory_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere' is not a directory"):
        load_policy(tmp_path / "nowhere")


class Bomb:
    """Leaves a trace if it is ever unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return Path.touch, (self.trace,)


def test_code_in_a_checkpoint_is_not_run(checkpoint: Path, tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    bomb = pickle.dumps(Bomb(trace))
    for name in ("policy.safetensors", "policy.json"):
        good = (checkpoint / name).read_bytes()
        (checkpoint / name).write_bytes(bomb)
        with pytest.raises(InputError, match=name):
            load_policy(checkpoint)
        (checkpoint / name).write_bytes(good)
    assert not trace.exists()


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    write_atomically(path, b"old")
    write_bytes = Path.write_bytes

    def write_half(self: Path, data: bytes) -> int:
        write_bytes(self, data[: len(data) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", write_half)
    with pytest.raises(InputError, match="file: cannot be written: No space left on device"):
        write_atomically(path, b"new content")
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_a_policy_must_fit_the_expert(checkpoint: Path, tmp_path: Path, plan: Plan) -> None:
    with pytest.raises(InputError, match=r"trained on 'throw_and_catch' with feature_size 5; the expert of"):
        ResidualPolicy.load(checkpoint, "throw_and_catch", plan)
    edit_json(lambda d: d.update(domain="dual_arm"))(checkpoint)
    with pytest.raises(InputError, match="is for domain 'dual_arm'"):
        ResidualPolicy.load(checkpoint, "throw_and_catch", plan)
    feature_size = FreeFlyerExpert.feature_size
    good = Actor(feature_size, 2, (8, 4))
    save_policy(tmp_path / "good", good, make_record(feature_size=feature_size))
    policy = ResidualPolicy.load(tmp_path / "good", "throw_and_catch", plan)
    assert policy.name == str(tmp_path / "good")
