"""Training: starts at the expert, saves, goes on after a stop or a kill, and keeps its seeds apart."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import tyro
from safetensors.numpy import load_file

from agents import ResidualPolicy
from agents.actor import load_policy
from impact_envs import InputError, load_scenario, parallel_env, rollout
from impact_envs.rollout import Diagnostics
from planners import make_expert
from tests.agents.target import make_model
from train import residual
from train.evaluation.errors import Diverged
from train.residual import Args, check_evaluations, last_checkpoint, main
from train.watch import learn

ROOT = Path(__file__).parents[2]
SCORED = {"steps": 0, "success_rate": 1.0, "difference_median": 0.0}


class Pusher:
    """A tiny expert: both robots push along x, and ask for a correction of the push every second."""

    name = "pusher"
    correction_size = 2
    feature_size = 3
    seeds: list[int]
    at_reset: Callable[[], None]

    def __init__(self, scenario: Any, plan: Any = None, options: Any = None) -> None:
        self._agents = scenario.agents

    def reset(self, seed: int) -> None:
        self.seeds.append(seed)
        self.at_reset()
        self._count, self._push, self._position = -1, np.zeros(2), np.zeros(2)

    def observe(self, observations: dict[str, np.ndarray]) -> None:
        self._count += 1
        self._position = next(iter(observations.values()))[:2]
        self.awaiting_correction = self._count % 10 == 0

    def features(self) -> np.ndarray:
        return np.array([self._count / 10, *self._position])

    def correct(self, correction: np.ndarray) -> None:
        self._push, self.awaiting_correction = correction, False

    def control(self) -> dict[str, np.ndarray]:
        return {agent: np.array([0.1, 0.0, 0.0]) + 0.5 * np.append(self._push, 0.0) for agent in self._agents}

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        self.observe(observations)
        return self.control()

    def diagnostics(self) -> Diagnostics:
        return Diagnostics()


@pytest.fixture
def pusher(monkeypatch: pytest.MonkeyPatch) -> type[Pusher]:
    """Put the tiny expert and a world of three seconds in the place of the real ones."""
    short = load_scenario("throw_and_catch").shorten(0.1)
    monkeypatch.setattr(Pusher, "seeds", [], raising=False)
    monkeypatch.setattr(Pusher, "at_reset", lambda self: None, raising=False)
    monkeypatch.setattr("agents.residual.make_expert", Pusher)
    monkeypatch.setattr(residual, "make_expert", Pusher)
    monkeypatch.setattr(residual, "make_plan", lambda scenario: None)
    monkeypatch.setattr(residual, "load_scenario", lambda name: short)
    return Pusher


def make_args(out: Path, **changes: Any) -> Args:
    small = Args(
        out=out,
        steps=96,
        rollout=32,
        batch=16,
        checkpoint_every=32,
        eval_every=64,
        eval_episodes=2,
        hidden=(8,),
        subprocesses=False,
        progress=False,
    )
    return dataclasses.replace(small, **changes)


def read_steps(out: Path) -> list[int]:
    return sorted(int(path.name) for path in (out / "checkpoints").iterdir())


def test_a_run_saves_what_is_needed_and_goes_on_where_it_stopped(pusher: type[Pusher], tmp_path: Path) -> None:
    result = main(make_args(tmp_path))
    assert (result["steps"], result["out"], result["interrupted"]) == (96, str(tmp_path), False)
    assert result["wall_seconds"] > 0
    assert read_steps(tmp_path) == [64, 96]
    assert list((tmp_path / "tensorboard").glob("events.*"))
    settings = json.loads((tmp_path / "args.json").read_text())
    assert settings["args"]["seed"] == 0
    assert settings["versions"]["torch"]
    kept = load_file(tmp_path / "checkpoints/00000096/policy.safetensors")

    result = main(make_args(tmp_path, steps=160, resume=True))
    assert result["steps"] == 160
    assert read_steps(tmp_path) == [128, 160]
    training = json.loads((tmp_path / "checkpoints/00000160/training.json").read_text())
    assert training["steps"] == 160
    assert [evaluation["steps"] for evaluation in training["evaluations"]] == [0, 64, 96, 128, 160]
    moved = load_file(tmp_path / "checkpoints/00000160/policy.safetensors")
    assert kept.keys() == moved.keys()
    assert any(not np.array_equal(kept[name], moved[name]) for name in kept)
    # The optimiser went on counting: 10 epochs of 2 minibatches per rollout of 32.
    state = load_file(tmp_path / "checkpoints/00000160/training.safetensors")
    assert state["policy.optimizer/0/step"] == 160 / 32 * 10 * 2


def test_a_resumed_run_starts_from_the_saved_policy(pusher: type[Pusher], tmp_path: Path) -> None:
    main(make_args(tmp_path, eval_every=0))
    main(make_args(tmp_path, eval_every=0, steps=128, learning_rate=0.0, resume=True))
    saved, still = (load_file(tmp_path / f"checkpoints/{n:08d}/policy.safetensors") for n in (96, 128))
    for name in saved:
        assert np.array_equal(saved[name], still[name]) == name.startswith("layers")
    counts = [
        json.loads((tmp_path / f"checkpoints/{n:08d}/training.json").read_text())["feature_count"] for n in (96, 128)
    ]
    assert counts[1] - counts[0] >= 32


def test_training_starts_exactly_at_the_expert(pusher: type[Pusher], tmp_path: Path) -> None:
    main(make_args(tmp_path, steps=32))
    record = json.loads((tmp_path / "checkpoints/00000032/training.json").read_text())
    first = record["evaluations"][0]
    assert (first["steps"], first["tie_rate"], first["difference_median"]) == (0, 1.0, 0.0)


def test_the_best_policy_on_tuning_seeds_is_kept(pusher: type[Pusher], tmp_path: Path) -> None:
    result = main(make_args(tmp_path))
    record = json.loads((tmp_path / "checkpoints/00000096/training.json").read_text())
    best = max(record["evaluations"], key=lambda e: (e["success_rate"], e["difference_median"]))
    assert result["eval"] == best
    assert load_policy(tmp_path)[1].steps == best["steps"]


def test_training_and_tuning_seeds_are_apart(pusher: type[Pusher], tmp_path: Path) -> None:
    main(make_args(tmp_path, eval_every=0))
    assert pusher.seeds
    assert max(pusher.seeds) < 1_000_000
    assert len(set(pusher.seeds)) > 20
    pusher.seeds.clear()
    main(make_args(tmp_path / "b", steps=32, eval_every=32))
    assert {seed for seed in pusher.seeds if seed >= 1_000_000} == {1_000_000, 1_000_001}


def test_the_same_seed_trains_the_same_policy(pusher: type[Pusher], tmp_path: Path) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        main(make_args(tmp_path / name, steps=64, eval_every=0, seed=seed))
    a, b, c = (load_file(tmp_path / name / "policy.safetensors") for name in "abc")
    assert all(np.array_equal(a[key], b[key]) for key in a)
    assert any(not np.array_equal(a[key], c[key]) for key in a)


def test_ctrl_c_saves_and_ends_cleanly(pusher: type[Pusher], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(self: Pusher) -> None:
        if len(self.seeds) == 20:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(Pusher, "at_reset", interrupt)
    result = main(make_args(tmp_path, steps=10_000, eval_every=0))
    assert result["interrupted"]
    assert 0 < result["steps"] < 200
    assert read_steps(tmp_path)[-1] == result["steps"]
    assert signal.getsignal(signal.SIGINT) is before
    monkeypatch.setattr(Pusher, "at_reset", lambda self: None)
    resumed = main(make_args(tmp_path, steps=result["steps"] + 32, eval_every=0, resume=True))
    assert resumed["steps"] == result["steps"] + 32


def test_sac_trains_and_resumes(pusher: type[Pusher], tmp_path: Path) -> None:
    arguments = {"algo": "sac", "eval_every": 0, "checkpoint_every": 40, "batch": 16}
    assert main(make_args(tmp_path, steps=40, **arguments))["steps"] == 40
    assert main(make_args(tmp_path, steps=60, resume=True, **arguments))["steps"] == 60
    state = load_file(tmp_path / "checkpoints/00000060/training.safetensors")
    assert len(state["replay/actions"]) == 60 / 2
    assert load_policy(tmp_path)[1].squash == "tanh"


def test_the_real_expert_is_trained(tmp_path: Path) -> None:
    arguments = {"steps": 8, "rollout": 8, "batch": 4, "eval_every": 0}
    result = main(make_args(tmp_path, **arguments))
    assert result["steps"] == 8
    scenario = load_scenario("throw_and_catch").suite("restitution")
    policy = ResidualPolicy.load(tmp_path, scenario)
    env = parallel_env(scenario)
    learned, expert = rollout(env, policy, 7), rollout(env, make_expert(scenario), 7)
    assert learned.robustness != expert.robustness
    assert abs(learned.robustness - expert.robustness) < 0.2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algo": "dqn"}, "algo 'dqn' is unknown; choices: ppo, sac"),
        ({"steps": 0}, "steps 0 is too small"),
        ({"rollout": 33}, "rollout 33 is not a multiple of n_envs 2"),
        ({"hidden": ()}, r"hidden \[\]"),
        ({"suite": "restitutoin"}, "did you mean 'restitution'"),
        ({"resume": True}, "holds no checkpoint to resume from"),
        ({"learning_rate": float("nan")}, "learning_rate nan: choices: from 0 to 1"),
        ({"learning_rate": -1e-3}, "learning_rate -0.001: choices: from 0 to 1"),
        ({"log_std": float("inf")}, "log_std inf: choices: from -20 to 2"),
    ],
)
def test_bad_arguments_are_one_line(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        main(make_args(tmp_path, **changes))
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_run_is_neither_overwritten_nor_resumed_as_another(pusher: type[Pusher], tmp_path: Path) -> None:
    main(make_args(tmp_path, steps=32, eval_every=0))
    with pytest.raises(InputError, match="holds a run of 32 steps; resume it or choose another"):
        main(make_args(tmp_path))
    with pytest.raises(InputError, match=r"was made with hidden \[8\]; cannot be resumed with \[4\]"):
        main(make_args(tmp_path, hidden=(4,), resume=True))
    with pytest.raises(InputError, match="was made with suite restitution; cannot be resumed with mass"):
        main(make_args(tmp_path, suite="mass", resume=True))
    weights = tmp_path / "checkpoints/00000032/training.safetensors"
    weights.write_bytes(weights.read_bytes()[:100])
    with pytest.raises(InputError, match=r"training\.safetensors: not a safetensors file"):
        main(make_args(tmp_path, resume=True))


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_a_training_that_diverges_says_so(algorithm: str) -> None:
    model, _ = make_model(algorithm)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.fill_(1e38)
    with pytest.raises(Diverged, match=r"training diverged after .*; try a smaller learning_rate than") as caught:
        learn(model, 64)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "evaluation", [{}, {"steps": 8}, {"steps": "8", "success_rate": 0.5, "difference_median": 0.0}]
)
def test_evaluations_that_cannot_be_compared_are_refused(evaluation: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"runs/00000008: key 'evaluations\.1': "):
        check_evaluations(Path("runs/00000008"), [SCORED, evaluation])


def test_every_argument_is_a_documented_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        tyro.cli(Args, args=["--help"])
    assert caught.value.code == 0
    shown = capsys.readouterr().out
    _, *options = dataclasses.fields(Args)  # the scenario is positional
    for field in options:
        assert f"--{field.name.replace('_', '-')}" in shown
    assert tyro.cli(Args, args=["--hidden", "4", "4", "--algo", "sac"]).hidden == (4, 4)


@pytest.mark.slow
def test_a_killed_run_resumes(tmp_path: Path) -> None:
    options = "--steps 100000 --rollout 8 --batch 4 --checkpoint-every 8 --eval-every 0 --hidden 8 --no-progress"
    command = [sys.executable, "-m", "train.residual", *options.split(), "--out", str(tmp_path)]
    run = subprocess.Popen(command, cwd=ROOT, env=os.environ | {"OMP_NUM_THREADS": "1"}, start_new_session=True)
    try:
        deadline = time.monotonic() + 240
        while last_checkpoint(tmp_path) is None and time.monotonic() < deadline:
            time.sleep(0.2)
    finally:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
    checkpoint = last_checkpoint(tmp_path)
    assert checkpoint is not None
    steps = int(checkpoint.name)
    arguments = {"rollout": 8, "batch": 4, "checkpoint_every": 8, "eval_every": 0, "subprocesses": True}
    assert main(make_args(tmp_path, steps=steps + 8, resume=True, **arguments))["steps"] == steps + 8
