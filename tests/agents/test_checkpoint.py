"""Checkpoints: what is read is what was written, broken ones are named in one line, and nothing in them is run."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file

from agents import ResidualPolicy
from agents.actor import Actor, PolicyRecord, load_policy, save_policy
from agents.source import Source, compute_digest, make_source
from agents.training_state import load_training, read_training, save_training
from impact_envs import InputError, load_scenario
from impact_envs.file import write_atomically
from planners.free_flyer.expert import FreeFlyerExpert
from planners.plan import Plan
from tests.agents.target import SIZES, STATISTICS, draw_features, export, make_small, practise
from tests.frozen.freeze import get_plan

SOURCE = Source(scenario="throw_and_catch", suite="hard", environment=None, plan=None)


def make_record(**changes: Any) -> PolicyRecord:
    fields = {
        "domain": "free_flyer",
        "sources": (SOURCE,),
        "algorithm": "ppo",
        "feature_size": SIZES[0],
        "correction_size": SIZES[1],
        "hidden": (8, 4),
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


@pytest.mark.parametrize("hidden", [(8, 4), (4,), ()])
def test_round_trip_gives_identical_corrections(tmp_path: Path, hidden: tuple[int, ...]) -> None:
    actor = make_actor(hidden=hidden)
    save_policy(tmp_path, actor, make_record(hidden=hidden))
    again, record = load_policy(tmp_path)
    assert record == make_record(hidden=hidden, weights_digest=record.weights_digest)
    features = np.random.default_rng(0).normal(scale=4.0, size=(200, SIZES[0]))
    corrections = actor.correction(features)
    np.testing.assert_array_equal(corrections, again.correction(features))
    assert np.all(np.abs(corrections) <= 1.0)
    assert len(np.unique(corrections)) > 100


def test_a_new_actor_corrects_nothing() -> None:
    features = np.random.default_rng(0).normal(scale=100.0, size=(50, SIZES[0]))
    for hidden in ((), (8, 4)):
        assert np.array_equal(Actor(*SIZES, hidden).correction(features), np.zeros((50, 2)))


def test_an_actor_without_hidden_layers_is_a_constant_or_one_per_impact() -> None:
    features = np.random.default_rng(0).normal(scale=100.0, size=(30, SIZES[0]))
    features[:, :3] = np.eye(3)[np.arange(30) % 3]  # the one-hot number of an impact
    actor = Actor(*SIZES, ())
    actor.layers[0].bias.data.copy_(torch.tensor([0.25, -0.5]))
    np.testing.assert_array_equal(actor.correction(features), np.tile([0.25, -0.5], (30, 1)))
    each = np.array([[0.5, 0.25, -0.25], [-1.0, 0.75, 2.0]], np.float32)
    actor.layers[0].bias.data.zero_()
    actor.layers[0].weight.data[:, :3] = torch.from_numpy(each)
    np.testing.assert_array_equal(actor.correction(features), np.clip(each, -1.0, 1.0).T[np.arange(30) % 3])


def flatten(value: Any, path: str = "") -> dict[str, Any]:
    """All leaves of nested dictionaries and lists."""
    if isinstance(value, dict | list | tuple):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return {k: leaf for key, item in items for k, leaf in flatten(item, f"{path}/{key}").items()}
    return {path: value.detach().numpy().tolist() if isinstance(value, torch.Tensor) else value}


def save_small(folder: Path, rounds: int = 0, **changes: Any) -> Path:
    """Write the state of a small run, and return the file of its tensors."""
    model = make_small(**changes)
    practise(model, rounds)
    save_training(folder, model, STATISTICS, rounds, [0.5], {"seed": 0}, [{"steps": 64}])
    return folder / "training.safetensors"


def drop_digest(path: Path) -> None:
    """Let the tensors' file be looked at although it was changed."""
    description = path.with_suffix(".json")
    description.write_text(json.dumps(json.loads(description.read_text()) | {"weights_digest": None}))


def test_restored_training_has_every_weight_and_optimiser_state_and_goes_on_alike(tmp_path: Path) -> None:
    model, other = make_small(), make_small(seed=7)
    practise(model, 2)
    save_training(tmp_path, model, STATISTICS, 2, [0.5, 2.0], {"seed": 0}, [{"steps": 64}])
    record, statistics = load_training(tmp_path, other)
    assert record == read_training(tmp_path)
    assert (record.steps, record.iterations, record.scales) == (128, 2, [0.5, 2.0])
    assert (other.num_timesteps, other._n_updates) == (128, model._n_updates)
    assert (record.run, record.evaluations) == ({"seed": 0}, [{"steps": 64}])
    np.testing.assert_array_equal(statistics.mean, STATISTICS.mean)
    np.testing.assert_array_equal(statistics.std, STATISTICS.std)
    before, after = flatten(model.get_parameters()), flatten(other.get_parameters())
    assert before == after
    assert sum("exp_avg" in key for key in before) > 4
    for each in (model, other):
        practise(each, 2, seed=2)
    assert flatten(model.get_parameters()) == flatten(other.get_parameters()) != before
    features = draw_features(1, 20)
    np.testing.assert_array_equal(export(model).correction(features), export(other).correction(features))


def test_training_state_of_another_network_is_refused(tmp_path: Path) -> None:
    path = save_small(tmp_path)
    tensors = load_file(path)
    name = "policy/action_net.weight"
    save_file(tensors | {name: np.zeros((3, 8), np.float32)}, path)
    with pytest.raises(InputError, match=r"training.safetensors: is damaged"):
        load_training(tmp_path, make_small())
    drop_digest(path)
    with pytest.raises(InputError, match=rf"training.safetensors: tensor '{name}' is .* \[3, 8\], expected"):
        load_training(tmp_path, make_small())
    save_file(tensors, path)
    drop_digest(path)
    with pytest.raises(InputError, match=r"training.safetensors: tensor 'policy/.*' is float32 .*, expected float32"):
        load_training(tmp_path, make_small(hidden=(6, 4)))
    with pytest.raises(InputError, match=r"training.safetensors: tensor 'policy/.*' is missing"):
        load_training(tmp_path, make_small(hidden=(8, 4, 4)))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("features/std", np.zeros(5), "'features/std' holds a value that is not positive"),
        ("features/std", None, "'features/std' is missing"),
        ("features/mean", np.zeros(4), r"'features/mean' is float64 \[4\], expected float64 \[5\]"),
    ],
)
def test_statistics_that_features_cannot_have_are_refused(tmp_path: Path, name: str, value: Any, message: str) -> None:
    path = save_small(tmp_path)
    tensors = load_file(path) | {name: value}
    save_file({key: array for key, array in tensors.items() if array is not None}, path)
    drop_digest(path)
    with pytest.raises(InputError, match=message):
        load_training(tmp_path, make_small())


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
    path, key = save_small(tmp_path, rounds=1), f"policy.optimizer/3/{name}"
    tensors = load_file(path)
    old = tensors.pop(key, None)
    if value is not None:
        tensors[key] = value if old is None or isinstance(value, np.ndarray) else np.full_like(old, value)
    save_file(tensors, path)
    drop_digest(path)
    with pytest.raises(InputError, match=message):
        load_training(tmp_path, make_small())


def test_groups_of_another_optimiser_are_refused_but_for_the_learning_rate(tmp_path: Path) -> None:
    path = save_small(tmp_path).with_suffix(".json")
    right = json.loads(path.read_text())
    for changes, message in (
        ({"params": [0, 1]}, r"params is \[0, 1\], expected"),
        ({"params": [{}]}, "params is .*, expected"),
        ({"betas": [0.9]}, r"betas is \[0.9\], expected \[0.9, 0.999\]"),
        ({"eps": "a\nb"}, "eps is "),
    ):
        path.write_text(json.dumps(right | {"param_groups": [right["param_groups"][0] | changes]}))
        with pytest.raises(InputError, match=message) as caught:
            load_training(tmp_path, make_small())
        assert str(caught.value).isprintable()
    path.write_text(json.dumps(right | {"param_groups": []}))
    with pytest.raises(InputError, match="key 'param_groups': params is None, expected"):
        load_training(tmp_path, make_small())
    path.write_text(json.dumps(right | {"param_groups": [right["param_groups"][0] | {"lr": 1.0}]}))
    load_training(tmp_path, make_small())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": -1}, "key 'steps': "),
        ({"iterations": 1.5}, "key 'iterations': .*integer"),
        ({"scales": [0.0]}, r"key 'scales\.0': .*greater than 0"),
        ({"scales": [float("inf")]}, r"key 'scales\.0': .*finite"),
        ({"format_version": 1}, "key 'format_version': "),
        ({"iteration": 3}, "unknown key 'iteration'; did you mean 'iterations'"),
    ],
)
def test_a_broken_description_of_a_training_is_named_in_one_line(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    path = save_small(tmp_path).with_suffix(".json")
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.raises(InputError, match=rf"training\.json: {message}") as caught:
        read_training(tmp_path)
    assert str(caught.value).isprintable()


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
    "missing key": (edit_json(lambda d: d.pop("sources")), r"key 'sources': Field required"),
    "no source": (edit_json(lambda d: d.update(sources=[])), r"key 'sources': .*at least 1"),
    "half a source": (edit_json(lambda d: d["sources"][0].pop("suite")), r"key 'sources\.0\.suite': Field required"),
    "wrong type": (edit_json(lambda d: d.update(steps="ten")), r"key 'steps': .*integer"),
    "negative": (edit_json(lambda d: d.update(feature_size=-1)), r"key 'feature_size': .*greater"),
    "huge": (edit_json(lambda d: d.update(hidden=[10**9])), r"key 'hidden\.0': .*less"),
    "past": (edit_json(lambda d: d.update(format_version=1)), r"key 'format_version': "),
    "future": (edit_json(lambda d: d.update(format_version=3)), r"key 'format_version': "),
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


def save_fitting(folder: Path, followed: Plan, **changes: Any) -> Path:
    """Write a policy that fits the expert, of whose source something may be changed."""
    source = make_source(load_scenario("throw_and_catch"), "hard", followed).model_copy(update=changes)
    sizes = FreeFlyerExpert.feature_size, FreeFlyerExpert.correction_size
    record = make_record(sources=(source,), feature_size=sizes[0], correction_size=sizes[1])
    save_policy(folder, make_actor(feature_size=sizes[0], correction_size=sizes[1]), record)
    return folder


def test_a_policy_must_fit_the_expert(checkpoint: Path, plan: Plan) -> None:
    with pytest.raises(InputError, match=r"trained on throw_and_catch with feature_size 5; the expert of"):
        ResidualPolicy.load(checkpoint, "throw_and_catch", plan)
    edit_json(lambda d: d.update(domain="dual_arm"))(checkpoint)
    with pytest.raises(InputError, match="is for domain 'dual_arm'"):
        ResidualPolicy.load(checkpoint, "throw_and_catch", plan)


def test_a_policy_of_this_expert_and_plan_is_loaded_without_a_word(
    tmp_path: Path, plan: Plan, recwarn: pytest.WarningsRecorder
) -> None:
    policy = ResidualPolicy.load(save_fitting(tmp_path, plan), "throw_and_catch", plan)
    assert policy.name == str(tmp_path)
    ResidualPolicy.load(save_fitting(tmp_path, plan), load_scenario("throw_and_catch").suite("mass"), plan)
    assert not recwarn.list


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"environment": "impact_envs/ThrowAndCatchResidual-v0"}, r"trained on the expert of .*Residual-v0; this one"),
        ({"environment": None}, "trained on the expert of None"),
        ({"plan": "0" * 16}, r"trained on another plan of throw_and_catch \(digest 0{16}, now [0-9a-f]{16}\)"),
    ],
)
def test_a_policy_of_another_expert_or_plan_is_loaded_with_one_line(
    tmp_path: Path, plan: Plan, changes: dict[str, Any], message: str
) -> None:
    with pytest.warns(UserWarning, match=message) as told:
        ResidualPolicy.load(save_fitting(tmp_path, plan, **changes), "throw_and_catch", plan)
    assert len(told) == 1
    assert str(told[0].message).startswith(f"checkpoint '{tmp_path}': ")
    assert "\n" not in str(told[0].message)


def test_a_scenario_that_a_policy_never_saw_is_no_difference(
    tmp_path: Path, plan: Plan, recwarn: pytest.WarningsRecorder
) -> None:
    folder = save_fitting(tmp_path, plan, scenario="pong", environment="impact_envs/PongResidual-v0")
    ResidualPolicy.load(folder, "throw_and_catch", plan)
    assert not recwarn.list


def test_a_digest_is_of_what_is_flown_not_of_how_long_planning_took(plan: Plan) -> None:
    assert compute_digest(replace(plan, solve_seconds=plan.solve_seconds + 1.0)) == compute_digest(plan)
    assert compute_digest(replace(plan, robustness=plan.robustness + 1.0)) != compute_digest(plan)
    assert compute_digest(None) is None
