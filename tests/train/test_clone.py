"""Cloning: learns what the expert does, is judged by evaluation, and goes on after a stop with the same weights."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from agents.shared_actor import add_waves, load_shared, load_shared_policy
from impact_envs import InputError, load_scenario
from train import clone
from train.clone import EXAMPLES, Args, main
from train.evaluation.case import make_case
from train.evaluation.evaluate import evaluate_cases
from train.evaluation.player import make_policy


class Experts:
    """A tiny teacher of throw_and_catch: robots push against their own velocity."""

    def __init__(self, scenario: Any, count: int) -> None:
        self._robots = len(scenario.robots)

    def act(self, joint: np.ndarray) -> np.ndarray:
        bodies = joint[:, : 7 * self._robots].reshape(len(joint), self._robots, 7)
        answers = np.zeros((len(joint), self._robots, 3))
        answers[..., :2] = 0.1 - bodies[..., 2:4]
        return answers.reshape(len(joint), -1)

    def close(self) -> None:
        pass


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Args:
    """Put a tiny teacher and a world of three seconds in the place of the real ones."""
    scenario = load_scenario("throw_and_catch").shorten(0.1)
    case = dataclasses.replace(make_case("throw_and_catch"), scenario=scenario)
    monkeypatch.setattr(clone, "make_case", lambda *_: case)
    monkeypatch.setattr(clone, "make_plan", lambda _: None)
    monkeypatch.setattr(clone, "make_expert_batch", lambda scenario, count, *_: Experts(scenario, count))
    return Args(
        iterations=2, out=tmp_path / "run", worlds=3, hidden=(16,), waves=2, fit_steps=300, batch=64,
        eval_episodes=2, report_episodes=2, progress=False,
    )  # fmt: skip


def read_weights(out: Path) -> dict[str, torch.Tensor]:
    return load_shared(out)[0].state_dict()


def test_the_network_answers_as_the_teacher_does_where_it_was_asked(short: Args) -> None:
    result = main(short)
    actor, record = load_shared(short.out)
    examples = load_file(short.out / "iterations" / "000001" / EXAMPLES)
    answers = actor.correction(add_waves(examples["observations"], record.time_place, record.waves))
    assert result["steps"] == 2 * 3 * 30 * 2
    assert np.abs(answers - examples["answers"]).mean() < 0.2 * np.abs(examples["answers"] - 0.1).mean()


def test_waves_repeat_after_two_horizons() -> None:
    observations = np.array([[0.25, 7.0], [2.25, 7.0]])
    first, second = add_waves(observations, 0, 3)
    assert np.allclose(first[:2], [0.25, 7.0])
    assert np.allclose(first[2:], second[2:])
    assert np.allclose(first[2:5], np.sin(np.pi * 0.25 * np.arange(1, 4)))


def test_a_run_that_stopped_ends_with_the_same_weights(short: Args, tmp_path: Path) -> None:
    whole, parts = dataclasses.replace(short, iterations=3), dataclasses.replace(short, out=tmp_path / "parts")
    main(whole)
    main(parts)
    main(dataclasses.replace(parts, iterations=3, resume=True))
    folders = [args.out / "iterations" / "000002" for args in (whole, parts)]
    first, second = map(read_weights, folders)
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_an_interrupted_iteration_leaves_the_ones_before(short: Args, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    main(dataclasses.replace(short, iterations=1))
    with monkeypatch.context() as patched:
        patched.setattr(clone.Run, "_fit", interrupt)
        with pytest.raises(KeyboardInterrupt):
            main(dataclasses.replace(short, resume=True))
    assert [path.name for path in clone.list_iterations(short.out)] == ["000000"]
    assert main(dataclasses.replace(short, resume=True))["iterations"] == 2


def test_a_resumed_run_refuses_other_arguments_and_a_new_one_an_old_folder(short: Args) -> None:
    main(dataclasses.replace(short, iterations=1))
    with pytest.raises(InputError, match="holds a run of 1 iterations"):
        main(short)
    with pytest.raises(InputError, match=r"was made with beta 0\.5"):
        main(dataclasses.replace(short, resume=True, beta=0.2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"iterations": 0}, "iterations 0 is too small"),
        ({"beta": 1.5}, "beta 1.5: choices: from 0 to 1"),
        ({"hidden": ()}, "every layer needs a width"),
    ],
)
def test_bad_arguments_get_one_line(short: Args, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        main(dataclasses.replace(short, **changes))


def test_a_clone_is_a_policy_of_the_evaluation_and_refuses_other_observations(short: Args) -> None:
    main(dataclasses.replace(short, iterations=1))
    policy = make_policy(str(short.out), "throw_and_catch")
    scenario = load_scenario("throw_and_catch")
    assert policy.name == str(short.out)
    result = evaluate_cases([make_case(scenario)], [str(short.out)], 1)
    assert result.rows
    with pytest.raises(InputError, match="numbers in a robot's observation"):
        load_shared_policy(short.out, load_scenario("exchange"))


def test_a_damaged_clone_gets_one_line(short: Args) -> None:
    main(dataclasses.replace(short, iterations=1))
    file = short.out / "shared.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"time_place": 99}))
    with pytest.raises(InputError, match="time_place"):
        load_shared(short.out)


@pytest.mark.slow
@pytest.mark.parametrize(("scenario", "least"), [("throw_and_catch", 0.9), ("corridor", 0.7)])
def test_a_clone_of_the_expert_solves_what_the_expert_does(scenario: str, least: float, tmp_path: Path) -> None:
    result = main(Args(scenario, iterations=3, out=tmp_path / "run", report_episodes=20, progress=False))
    assert result["report"]["success_rate"] >= least
