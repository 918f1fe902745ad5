"""Training a team: robots see their own features, the critic sees the state; it starts at a clone exactly."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

import numpy as np
import pytest
import torch

from agents.actor import Actor
from agents.shared_actor import SharedRecord, add_waves, find_layout, load_shared, save_shared
from impact_envs import InputError, load_scenario
from train import clone, team
from train.team import Args, copy_actor, main, make_model

SHORT = load_scenario("throw_and_catch").shorten(0.1)


@pytest.fixture
def args(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Args:
    """Put a world of three seconds in the place of the real one."""
    monkeypatch.setattr(team, "load_scenario", lambda _: SHORT)
    return Args(
        out=tmp_path / "run", minutes=0.01, worlds=2, hidden=(8,), epochs=1, parts=1, eval_episodes=2,
        report_episodes=2, progress=False,
    )  # fmt: skip


@pytest.fixture
def cloned(tmp_path: Path) -> Path:
    """Write a policy of random weights."""
    layout = find_layout(SHORT)
    place = layout["time"].start
    torch.manual_seed(0)
    actor = Actor(layout.size + 4, 3, (8,))
    torch.nn.init.normal_(actor.layers[-1].weight, std=0.1)
    record = SharedRecord(
        domain="free_flyer", sources=(team.make_source(SHORT, "nominal", None),), algorithm="dagger",
        observation=tuple(layout.describe().splitlines()), action_size=3, time_place=place, waves=2, hidden=(8,),
        seed=0, steps=0,
    )  # fmt: skip
    save_shared(tmp_path / "clone", actor, record)
    return tmp_path / "clone"


def test_robots_do_not_see_the_state_and_the_critic_does(args: Args) -> None:
    model, *_ = make_model(args, SHORT)
    observations = torch.as_tensor(model.env.reset())
    torch.nn.init.normal_(model.policy.action_net.weight)
    changed = observations.clone()
    changed[:, model.env.features :] += 1.0
    before, after = (model.policy.get_distribution(x).mode() for x in (observations, changed))
    values = [model.policy.predict_values(x) for x in (observations, changed)]
    assert torch.equal(before, after)
    assert not torch.allclose(*values)


def test_rewards_sum_up_to_the_bounded_return(args: Args) -> None:
    model, *_ = make_model(args, SHORT)
    model.env.reset()
    actions, total = np.full((4, 3), 0.3), np.zeros(4)
    for _ in range(SHORT.steps):
        _, rewards, ended, infos = model.env.step(actions)
        total += rewards
    returns = np.array([info["episode"]["r"] for info in infos])
    assert ended.all()
    assert np.allclose(total, 0.25 * np.tanh(returns / 0.25), atol=1e-5)  # half of `reach`, for each of two robots


def test_training_from_a_clone_starts_at_it_exactly(args: Args, cloned: Path) -> None:
    model, actor, record = make_model(dataclasses.replace(args, init=cloned), SHORT)
    copy_actor(model, actor)
    start, _ = load_shared(cloned)
    draw = np.random.default_rng(0)
    observations = draw.normal(size=(5, len(record.observation)))
    features = add_waves(observations, record.time_place, record.waves)
    joined = np.concatenate([(features - start.mean.numpy()) / start.std.numpy(), np.zeros((5, 99))], axis=1)
    size = model.observation_space.shape[0]
    chosen, _ = model.predict(np.clip(joined[:, :size], -10, 10).astype(np.float32), deterministic=True)
    assert np.allclose(actor.correction(features), start.correction(features))
    assert np.allclose(chosen, start.correction(features), atol=1e-5)


def test_the_critic_alone_learns_first(args: Args, cloned: Path) -> None:
    main(dataclasses.replace(args, init=cloned, critic_first=10**6))
    first, second = load_shared(cloned)[0].state_dict(), load_shared(args.out)[0].state_dict()
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_a_run_learns_keeps_its_best_policy_and_its_curve(
    args: Args, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(elsewhere))
    result = main(args)
    assert not list(elsewhere.iterdir())  # SB3's logger would make a folder there
    assert result["steps"] >= 2 * 2 * SHORT.steps
    assert {path.name for path in args.out.iterdir()} >= {
        "shared.safetensors",
        "shared.json",
        "curve.json",
        "args.json",
    }
    assert result["report"]["robustness"] <= 0.25
    with pytest.raises(InputError, match="holds a run"):
        main(args)


def test_bad_arguments_get_one_line(args: Args) -> None:
    with pytest.raises(InputError, match="reward 'progres' is unknown"):
        main(dataclasses.replace(args, reward="progres"))
    with pytest.raises(InputError, match="minutes 0"):
        main(dataclasses.replace(args, minutes=0.0))


@pytest.mark.slow
def test_a_team_that_starts_at_a_clone_keeps_solving_throw_and_catch(tmp_path: Path) -> None:
    cloned = clone.main(clone.Args(iterations=1, out=tmp_path / "clone", report_episodes=0, progress=False))
    result = main(Args(init=tmp_path / "clone", out=tmp_path / "run", minutes=0.5, report_episodes=20, progress=False))
    assert cloned["eval"]["success_rate"] >= 0.8
    assert result["report"]["success_rate"] >= 0.8
