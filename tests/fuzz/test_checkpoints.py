"""Any checkpoint is loaded and can be used, or is refused in one line; nothing in it is run."""

import contextlib
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load, save

from agents.actor import load_policy
from agents.checkpoint import compute_digest
from agents.training_state import load_training, save_training
from tests.agents.target import SIZES, STATISTICS, export, make_small, practise
from tests.fuzz.mutations import (
    Content,
    answered,
    check,
    check_finite,
    damaged,
    mistyped,
    mutated,
    read_folder,
    strange,
    write_folder,
)
from train.evaluation.player import SHIPPED
from train.residual import check_evaluations

POLICIES = {path.name: read_folder(path) for path in sorted(SHIPPED.iterdir())}
NUMBERS = (0.0, -1.0, 1e-40, 1e30, np.nan, np.inf, -np.inf)
TYPES = ("float16", "float32", "float64", "int8", "int64", "uint64", "bool")


class Bomb:
    """Leaves a trace if it is ever unpickled."""

    def __init__(self, trace):
        self.trace = trace

    def __reduce__(self):
        return Path.touch, (self.trace,)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("changed")


@pytest.fixture(scope="module")
def training(tmp_path_factory):
    """The files of a run's state."""
    folder = tmp_path_factory.mktemp("training")
    model = make_small()
    practise(model)
    scored = {"iterations": 1, "low": 0.0, "success_rate": 1.0, "expert_success_rate": 1.0, "sources": []}
    save_training(folder, model, STATISTICS, 1, [0.5], {"seed": 0}, [scored])
    return read_folder(folder)


@st.composite
def changed_tensors(draw, data):
    """Return tensors of which one is of another shape or type, has other values or another name, or is not there."""
    tensors = dict(load(data))
    name = draw(st.sampled_from(sorted(tensors)))
    array = tensors.pop(name)
    change = draw(st.sampled_from(("value", "value", "all", "type", "shape", "cut", "rename", "remove", "add")))
    if change == "value" and array.size:
        array = array.copy()
        array.flat[draw(st.integers(0, array.size - 1))] = draw(st.sampled_from(NUMBERS))
    elif change == "all":
        array = np.full_like(array, draw(st.sampled_from(NUMBERS)))
    elif change == "type":
        array = array.astype(draw(st.sampled_from(TYPES)))
    elif change == "shape":
        array = array.reshape(draw(st.sampled_from(((-1,), (1, *array.shape), array.shape[::-1]))))
    elif change == "cut":
        array = array[..., 1:] if array.ndim else np.zeros((0, 3), array.dtype)
    if change == "rename":
        tensors[draw(st.sampled_from((*sorted(tensors), "", "x", "../x", "policy.optimizer/99/step")))] = array
    elif change != "remove":
        tensors[name] = array
    if change == "add":
        tensors["policy.optimizer/0/more"] = array
    return save({key: np.ascontiguousarray(value) for key, value in tensors.items()})


@st.composite
def changed_header(draw, data):
    """Return a safetensors file with a changed table of its tensors."""
    length = int.from_bytes(data[:8], "little")
    table = draw(mutated(json.loads(data[8 : 8 + length]), st.one_of(strange, st.sampled_from(("BF16", "F8_E4M3")))))
    header = json.dumps(table).encode(errors="replace")
    return len(header).to_bytes(8, "little") + header + data[8 + length :]


@st.composite
def changed_checkpoint(draw, files, trace):
    """Return the files of a checkpoint with one of them changed; its digest may be made right again."""
    files = dict(files)
    weights, description = sorted(files, key=lambda name: name.endswith(".json"))
    name = draw(st.sampled_from((weights, description)))
    if draw(st.integers(0, 19)) == 0:
        files[name] = pickle.dumps(Bomb(trace))
    elif name == description:
        text = files[name].decode()
        changed = st.one_of(mutated(json.loads(text)).map(json.dumps), mistyped(text))
        files[name] = draw(st.one_of(changed.map(lambda text: text.encode(errors="replace")), damaged(files[name])))
    else:
        data = files[name]
        files[name] = draw(st.one_of(changed_tensors(data), changed_tensors(data), changed_header(data), damaged(data)))
        record = json.loads(files[description])
        # Without the digest, or with the right one, the file itself must be looked at.
        record["weights_digest"] = draw(st.sampled_from((record["weights_digest"], None, compute_digest(files[name]))))
        files[description] = json.dumps(record).encode()
    return {name: Content(content) for name, content in files.items()}


def check_policy(data, folder):
    trace = folder.with_name("trace")
    files = data.draw(st.sampled_from(sorted(POLICIES)).flatmap(lambda name: changed_checkpoint(POLICIES[name], trace)))
    write_folder(folder, files)
    with answered():
        actor, record = load_policy(folder)
        for features in np.random.default_rng(0).normal(scale=4.0, size=(3, record.feature_size)):
            correction = actor.correction(features)
            check_finite(correction)
            assert np.all(np.abs(correction) <= 1.0)
    assert read_folder(folder) == files
    assert not trace.exists()


def check_training(data, training, folder):
    """A state that is taken can be learned from."""
    trace = folder.with_name("trace")
    files = data.draw(changed_checkpoint(training, trace))
    write_folder(folder, files)
    model = make_small()
    with answered():
        record, statistics = load_training(folder, model)
        check_evaluations(folder, record.evaluations)
        check_finite(statistics.normalize(np.zeros((1, SIZES[0]))))
        check_finite(export(model).correction(np.zeros(SIZES[0])))
        with contextlib.suppress(
            FloatingPointError
        ):  # weights of a run that was about to diverge: no error of the files
            practise(model)
    assert read_folder(folder) == files
    assert not trace.exists()


@check(40)
@given(data=st.data())
def test_changed_policies(data, folder):
    check_policy(data, folder)


@check(10)
@given(data=st.data())
def test_changed_training(data, training, folder):
    check_training(data, training, folder)


@pytest.mark.slow
@check(1500)
@given(data=st.data())
def test_many_changed_policies(data, folder):
    check_policy(data, folder)


@pytest.mark.slow
@check(500)
@given(data=st.data())
def test_many_changed_training(data, training, folder):
    check_training(data, training, folder)
