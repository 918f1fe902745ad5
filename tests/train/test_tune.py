"""The best constant: found where it is known, kept only if it gains, stored as every policy is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from agents.actor import load_policy
from impact_envs import InputError, load_scenario
from train import tune
from train.arguments import TuneArgs
from train.evaluation.player import make_policy
from train.ground import Ground
from train.watch import Watch

ARGS = TuneArgs(progress=False)
SILENT = cast(Watch, SimpleNamespace(advance=lambda steps: None, say=lambda line: None))


def make_ground(name: str = "pong", met: int = 2) -> Ground:
    """Return a ground without worlds whose expert met the first impacts of its plan."""
    features = np.zeros((met, 45))
    features[np.arange(met), np.arange(met)] = 1.0
    worlds = SimpleNamespace(
        scenario=load_scenario(name), experts=SimpleNamespace(feature_size=45, correction_size=3), num_envs=8
    )
    reference = {tune.FINAL_SEEDS: SimpleNamespace(features=features)}
    return Ground(cast(Any, None), cast(Any, worlds), 1.0, cast(Any, reference))


@pytest.mark.parametrize("numbers", [0, 6])
def test_the_search_finds_a_known_optimum(numbers: int, monkeypatch: pytest.MonkeyPatch) -> None:
    best = np.array([0.4, -0.2, 0.1])

    def score(args: Any, grounds: Any, candidates: np.ndarray, *rest: Any) -> np.ndarray:
        return -((candidates - best) ** 2).sum(axis=(1, 2))

    monkeypatch.setattr(tune, "score", score)
    found = tune.search(replace(ARGS, generations=25), [make_ground()], numbers, SILENT)[-1]
    met = 2 if numbers else 1
    np.testing.assert_allclose(found[:met], np.tile(best, (met, 1)), atol=0.03)
    assert (found[met:] == 0.0).all()  # impacts that the plan does not have stay uncorrected


@pytest.mark.parametrize(
    ("gain", "loss", "kept"),
    [
        ((-0.1, -0.2), (0.0, 0.0), (0, 1.0)),
        ((0.3, 0.1), (0.0, 0.0), (1, 1.0)),
        ((0.3, 0.1), (1.0, 0.0), (2, 1.0)),  # who loses success is not kept, whatever it gains
        ((0.5, 0.1), (0.02, 0.0), (1, 0.25)),  # a share of it may be
    ],
)
def test_zero_is_kept_unless_a_finalist_surely_gains_without_losing_success(
    gain: tuple[float, ...], loss: tuple[float, ...], kept: tuple[int, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    means = [np.full((1, 3), 0.1), np.full((1, 3), 0.3)]

    def judge(grounds: Any, actor: Any, *_: Any) -> dict[str, float]:
        """Gain and lose in proportion to the share of a finalist."""
        (value,) = set(actor.correction(np.zeros((1, 45))).ravel().round(4))
        place, share = next(
            (place, share)
            for place in (0, 1)
            for share in (1.0, 0.5, 0.25, 0.0)
            if round(float(np.float32(share * means[place][0, 0])), 4) == value
        )
        found = {"gain": share * gain[place], "success_rate": 0.9 - share * loss[place], "expert_success_rate": 0.9}
        return {"low": found["gain"], "sources": [], **found}

    monkeypatch.setattr(tune, "judge", judge)
    args = replace(ARGS, shares=(1.0, 0.5, 0.25))
    constants, found = tune.choose_best(args, [make_ground()], means, 0, SILENT)
    finalist, share = kept
    expected = share * means[finalist - 1] if finalist else np.zeros((1, 3))
    np.testing.assert_array_equal(constants, expected)
    assert found["gain"] == (share * gain[finalist - 1] if finalist else 0.0)


def test_the_network_returns_the_constant_of_the_impact() -> None:
    constants = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 3)).astype(np.float32).astype(float)
    features = np.random.default_rng(1).normal(size=(7, 45))
    features[:, :6] = np.eye(7, 6)  # the last one is no impact
    each = tune.make_actor(make_ground(), constants, 6).correction(features)
    np.testing.assert_array_equal(each, [*constants, np.zeros(3)])
    alike = tune.make_actor(make_ground(), constants[:1], 0).correction(features)
    np.testing.assert_array_equal(alike, np.tile(constants[0], (7, 1)))


@pytest.mark.parametrize("name", ["dual_arm_grasp", "floating_manipulator_thrusters"])
def test_experts_that_number_no_impacts_have_no_constant_each(name: str) -> None:
    with pytest.raises(InputError, match=f"--per-impact: scenario '{name}' has domain .* numbers no impacts"):
        tune.count_numbers(replace(ARGS, scenarios=(name,), per_impact=True))
    assert tune.count_numbers(replace(ARGS, scenarios=(name,))) == 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"population": 1}, "population 1 is too small"),
        ({"elites": 30}, "elites 30: there are 24 candidates"),
        ({"step": 0.0}, "step 0: choices"),
        ({"generations": 10_000}, "generations x episodes = 400000"),
        ({"report_episodes": 1}, "report_episodes 1 is too small"),
    ],
)
def test_bad_arguments_are_one_line(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        tune.main(replace(ARGS, out=tmp_path, **changes))


@pytest.mark.slow
def test_a_tuned_constant_is_a_policy(tmp_path: Path) -> None:
    small = {"population": 4, "elites": 2, "episodes": 2, "generations": 2, "final_episodes": 4, "report_episodes": 2}
    args = replace(ARGS, scenarios=("throw_and_catch",), per_impact=True, out=tmp_path, worlds=8, **small)
    result = tune.main(args)
    actor, record = load_policy(tmp_path)
    assert record.algorithm == "constant_per_impact"
    assert np.allclose(actor.correction(np.eye(6, 45)), result["constants"], atol=1e-4)
    assert result["eval"]["gain"] >= 0.0
    make_policy(str(tmp_path), load_scenario("throw_and_catch").suite("hard"))
    with pytest.raises(InputError, match="holds a policy; choose another"):
        tune.main(args)
