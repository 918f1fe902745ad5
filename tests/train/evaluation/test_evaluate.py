"""Evaluation: paired seeds, the same rows from any number of workers, and going on after a kill."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import train.evaluation.player
from agents.actor import Actor, PolicyRecord, save_policy
from agents.source import Source
from impact_envs import InputError, Scenario, load_scenario, parallel_env, rollout
from planners import make_plan
from planners.free_flyer.expert import FreeFlyerExpert
from train.evaluation.case import has_expert, make_cases
from train.evaluation.evaluate import EvaluationResult, evaluate, evaluate_cases
from train.evaluation.player import make_policy
from train.evaluation.replay import episode_to_dict, find_replay
from train.evaluation.results import read_evaluation

TIMES = ["solve_ms", "solve_ms_p50", "solve_ms_p99", "solve_ms_max", "wall_seconds"]


@pytest.fixture(scope="module")
def short() -> Scenario:
    """Three seconds, too short to reach the goal."""
    return load_scenario("throw_and_catch").shorten(0.1)


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> EvaluationResult:
    """The real expert and no control at all, on three seeds."""
    out = tmp_path_factory.mktemp("evaluation")
    policies, suites = ("expert", "zero"), ("nominal", "restitution")
    return evaluate(["throw_and_catch"], policies, 3, suites=suites, out=out, progress=False)


def save_checkpoint(folder: Path, output: float = 0.0) -> None:
    """A policy whose correction is always the same; 0 is the expert."""
    sizes = FreeFlyerExpert.feature_size, FreeFlyerExpert.correction_size
    actor = Actor(*sizes, ())
    actor.layers[-1].bias.data.fill_(output)
    record = PolicyRecord(
        domain="free_flyer",
        sources=(Source(scenario="pong", suite="nominal", environment=None, horizon=100.0, plan=None),),
        algorithm="ppo",
        feature_size=sizes[0],
        correction_size=sizes[1],
        hidden=(),
        seed=0,
        steps=0,
    )
    save_policy(folder, actor, record)


def without_times(table: pd.DataFrame) -> pd.DataFrame:
    return table.drop(columns=TIMES)


def test_expert_succeeds_and_zero_does_not(judged: EvaluationResult) -> None:
    rates = {(row["suite"], row["policy"]): row["success_rate"] for row in judged.rows}
    assert rates["nominal", "expert"] == 1.0
    assert rates["nominal", "zero"] == rates["restitution", "zero"] == 0.0
    pair = next(pair for pair in judged.paired if pair["suite"] == "nominal")
    assert (pair["a"], pair["b"], pair["win_rate"]) == ("zero", "expert", 0.0)
    assert pair["difference_median"] < 0


def test_seeds_are_paired_and_start_where_evaluation_seeds_start(judged: EvaluationResult) -> None:
    seeds = judged.episodes.groupby(["suite", "policy"])["seed"].agg(list)
    assert all(numbers == [2_000_000, 2_000_001, 2_000_002] for numbers in seeds)


def test_nominal_worlds_do_not_depend_on_the_seed_and_mismatched_ones_do(judged: EvaluationResult) -> None:
    expert = judged.episodes[judged.episodes["policy"] == "expert"]
    distinct = expert.groupby("suite")["robustness"].nunique()
    assert (distinct["nominal"], distinct["restitution"]) == (1, 3)


def test_a_row_is_the_episode_of_its_seed(judged: EvaluationResult) -> None:
    row = judged.episodes[(judged.episodes["suite"] == "restitution") & (judged.episodes["policy"] == "expert")].iloc[1]
    scenario = load_scenario("throw_and_catch").suite("restitution")
    episode = rollout(parallel_env(scenario), make_policy("expert", scenario), int(row["seed"]))
    assert (row["robustness"], row["success"], row["effort"]) == (episode.robustness, episode.success, episode.effort)
    assert row["impacts"] == len(episode.impacts)


def test_files_hold_the_same_as_the_result(judged: EvaluationResult) -> None:
    assert judged.out is not None
    table = pd.read_parquet(judged.out / "rows.parquet")
    pd.testing.assert_frame_equal(without_times(table), without_times(judged.episodes), check_dtype=False)
    summary = json.loads((judged.out / "summary.json").read_text())
    assert summary["rows"] == judged.rows
    assert summary["paired"] == judged.paired
    assert summary == json.loads(json.dumps(judged.to_dict(), allow_nan=False))
    assert summary["rows"][0]["solve_ms"]["p99"] > 0
    assert summary["rows"][1]["solve_ms"] == {"p50": None, "p99": None, "max": None}


def test_a_replay_tells_the_whole_episode(judged: EvaluationResult) -> None:
    assert judged.out is not None
    replays = {path.name: json.loads(path.read_text()) for path in (judged.out / "replays").iterdir()}
    assert sorted(replays) == [
        f"throw_and_catch__{suite}__{policy}__2000000.json"
        for suite in ("nominal", "restitution")
        for policy in ("expert", "zero")
    ]
    replay = replays["throw_and_catch__restitution__expert__2000000.json"]
    scenario = load_scenario("throw_and_catch").suite("restitution")
    episode = rollout(parallel_env(scenario), make_policy("expert", scenario), 2_000_000)
    for name, values in episode.signals.items():
        np.testing.assert_allclose(replay["signals"][name], values, atol=5.1e-6)
    assert len(replay["times"]) == len(replay["robustness_bounds"]) == scenario.steps + 1
    assert len(replay["impacts"]) == len(episode.impacts) > 0
    assert replay["plan"]["impacts"]
    assert replays["throw_and_catch__nominal__zero__2000000.json"]["plan"] is None
    assert {shape["label"] for shape in replay["shapes"]} >= {"snap", "crackle", "pop", "goal"}
    assert replay["formula"] == str(scenario.specification)


def test_numbers_json_cannot_say_become_null(short: Scenario) -> None:
    env = parallel_env(short)
    episode = rollout(env, make_policy("zero", short), 1)
    episode.robustness_bounds[0] = (-math.inf, math.inf)
    replay = episode_to_dict(episode, short, "nominal", env.task.shapes())
    assert replay["robustness_bounds"][0] == [None, None]
    json.dumps(replay, allow_nan=False)


def test_rows_do_not_depend_on_the_number_of_workers() -> None:
    arguments: dict[str, Any] = {"policies": ("random", "expert"), "episodes": 2, "suites": ("all",), "progress": False}
    alone = evaluate(["throw_and_catch"], **arguments)
    together = evaluate(["throw_and_catch"], workers=2, **arguments)
    pd.testing.assert_frame_equal(without_times(alone.episodes), without_times(together.episodes))
    for a, b in zip(alone.rows, together.rows, strict=True):
        assert {**a, "solve_ms": 0, "wall_seconds_mean": 0} == {**b, "solve_ms": 0, "wall_seconds_mean": 0}
    assert alone.paired == together.paired


def test_a_zero_checkpoint_ties_with_the_expert_on_every_seed(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "still", 0.0)
    save_checkpoint(tmp_path / "loud", 0.9)
    policies = ("expert", str(tmp_path / "still"), f"{tmp_path / 'loud'}/")
    result = evaluate(["throw_and_catch"], policies, 2, suites=("restitution",), progress=False)
    still, loud, _ = result.paired
    assert (still["a"], still["b"], still["tie_rate"]) == (policies[1], "expert", 1.0)
    assert (loud["a"], loud["tie_rate"]) == (str(tmp_path / "loud"), 0.0)


def test_a_second_call_plays_only_what_is_missing(short: Scenario, tmp_path: Path) -> None:
    arguments: dict[str, Any] = {"out": tmp_path, "progress": False}
    whole = evaluate([short], ("random", "zero"), 4, **arguments)
    journal = tmp_path / "rows.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    # A kill leaves a part of the rows, the last of them cut.
    journal.write_text("".join(lines[:3]) + lines[3][:50])
    again = evaluate([short], ("random", "zero"), 4, **arguments)
    assert (whole.episodes_played, again.episodes_played) == (8, 5)
    pd.testing.assert_frame_equal(without_times(whole.episodes), without_times(again.episodes))
    assert again.rows[0]["robustness_ci"] == whole.rows[0]["robustness_ci"]
    more = evaluate([short], ("zero", "random"), 5, suites=("nominal", "mass"), **arguments)
    assert more.episodes_played == 12
    assert list(dict.fromkeys(more.episodes["policy"])) == ["zero", "random"]


def test_what_was_finished_before_an_interruption_is_kept(
    short: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    play, count = train.evaluation.player.rollout, 0

    def interrupted(*arguments: Any) -> Any:
        nonlocal count
        count += 1
        if count == 3:
            raise KeyboardInterrupt
        return play(*arguments)

    monkeypatch.setattr(train.evaluation.player, "rollout", interrupted)
    with pytest.raises(KeyboardInterrupt):
        evaluate([short], ("random",), 4, out=tmp_path, progress=False)
    monkeypatch.undo()
    assert evaluate([short], ("random",), 4, out=tmp_path, progress=False).episodes_played == 2


def test_rows_of_other_inputs_are_never_mixed_in(short: Scenario, tmp_path: Path) -> None:
    evaluate([short], ("zero",), 1, out=tmp_path / "a", progress=False)
    heavier = short.override({"objects.pop.mass": 20.0})
    with pytest.raises(InputError, match="holds episodes of another 'throw_and_catch/nominal'"):
        evaluate([heavier], ("zero",), 1, out=tmp_path / "a", progress=False)


def test_rows_of_other_settings_are_never_mixed_in(tmp_path: Path) -> None:
    def play(settings: dict[str, Any]) -> EvaluationResult:
        cases = make_cases(["throw_and_catch"], ["nominal"], settings)
        return evaluate_cases(cases, ("expert", "zero"), 1, out=tmp_path, progress=False)

    with pytest.raises(InputError, match=r"expert\.retmie is unknown; did you mean 'retime'"):
        play({"expert.retmie": False})
    assert not (tmp_path / "manifest.json").exists()
    play({"expert.retime": False})
    assert json.loads((tmp_path / "manifest.json").read_text())["set"] == {"expert.retime": False}
    for other in ({}, {"expert.retime": True}, {"expert.retime": False, "objects.pop.mass": 20.0}):
        with pytest.raises(InputError, match="holds episodes of another 'throw_and_catch/nominal'"):
            play(other)
    assert play({"expert.retime": False}).episodes_played == 0


def test_one_plan_serves_all_seeds_and_suites_of_one_belief(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def count_plans(scenario: Scenario, objective: str) -> Any:
        made.append(scenario.name)
        return make_plan(scenario, objective)

    monkeypatch.setattr("train.evaluation.evaluate.make_plan", count_plans)
    evaluate(["throw_and_catch"], ("zero", "expert"), 1, suites=("nominal", "mass"), progress=False)
    assert made == ["throw_and_catch"]
    evaluate(["throw_and_catch"], ("zero",), 1, progress=False)
    assert len(made) == 1
    assert not has_expert("random")


def test_a_clone_has_no_expert_and_needs_no_plan(tmp_path: Path) -> None:
    (tmp_path / "residual").mkdir()
    (tmp_path / "clone").mkdir()
    (tmp_path / "clone" / "shared.json").write_text("{}")
    assert has_expert(str(tmp_path / "residual"))
    assert not has_expert(str(tmp_path / "clone"))


def test_a_refused_journal_stays_as_it_is(short: Scenario, tmp_path: Path) -> None:
    """Its last line too, which a kill cut off and which would be dropped otherwise."""
    evaluate([short], ("zero",), 3, out=tmp_path, progress=False)
    journal = tmp_path / "rows.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text(lines[0] + "{}\n" + lines[2][:50])
    before = journal.read_bytes()
    with pytest.raises(InputError, match="line 2 is not an episode"):
        evaluate([short], ("zero",), 3, out=tmp_path, progress=False)
    assert journal.read_bytes() == before


def test_damaged_folders_are_named(short: Scenario, tmp_path: Path) -> None:
    evaluate([short], ("zero",), 2, out=tmp_path, progress=False)
    journal = tmp_path / "rows.jsonl"
    journal.write_text("nonsense\n" + journal.read_text())
    with pytest.raises(InputError, match=r"rows\.jsonl: line 1 is not an episode"):
        evaluate([short], ("zero",), 2, out=tmp_path, progress=False)
    (tmp_path / "manifest.json").write_text("[]")
    with pytest.raises(InputError, match=r"manifest\.json: content: Input should be an object"):
        evaluate([short], ("zero",), 2, out=tmp_path, progress=False)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        evaluate([short], ("zero",), 1, out=tmp_path / "file", progress=False)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenarios": ["throw_and_cathc"]}, "did you mean 'throw_and_catch'"),
        ({"scenarios": []}, "no scenario"),
        ({"scenarios": ["corridor", "corridor"]}, "scenario 'corridor' is given twice"),
        (
            {"policies": ["exprt"]},
            r"policy 'exprt' is unknown; did you mean 'expert'\? choices: expert, oracle, zero, random",
        ),
        ({"policies": ["zero", "zero"]}, "policy 'zero' is given twice"),
        ({"policies": []}, "no policy"),
        ({"suites": ["mas"]}, "did you mean 'mass'"),
        ({"episodes": 0}, "episodes 0 is too small"),
        ({"episodes": 10**12}, "episodes 1000000000000 is too large"),
        ({"seed": 2**63 - 1, "episodes": 2}, "seed of the last episode"),
        ({"seed": -1}, "seed -1 is too small"),
        ({"workers": 0}, "workers 0 is too small"),
        ({"policies": ["tests"]}, "checkpoint 'tests' has no policy.json"),
    ],
)
def test_bad_requests_are_one_line(changes: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parents[3])
    request: dict[str, Any] = {"scenarios": ["throw_and_catch"], "policies": ["zero"], "episodes": 1}
    with pytest.raises(InputError, match=message) as caught:
        evaluate(**(request | changes), progress=False)
    assert "\n" not in str(caught.value)


def test_every_mistyped_field_of_the_journal_is_named(short: Scenario, tmp_path: Path) -> None:
    evaluate([short], ("zero",), 1, out=tmp_path, progress=False)
    journal = tmp_path / "rows.jsonl"
    row = json.loads(journal.read_text())
    for name in row:
        for value in ([row[name]], {"x": 1}, "text" if not isinstance(row[name], str) else 7):
            journal.write_text(json.dumps(row | {name: value}) + "\n")
            with pytest.raises(InputError, match=rf"rows\.jsonl: line 1 is not an episode: {name}") as caught:
                evaluate([short], ("zero",), 1, out=tmp_path, progress=False)
            assert "\n" not in str(caught.value)
    for name in ("solve_ms", "success", "impacts", "fallback_kinds", "seed"):
        journal.write_text(json.dumps({key: value for key, value in row.items() if key != name}) + "\n")
        with pytest.raises(InputError, match=rf"line 1 is not an episode: {name}: Field required"):
            evaluate([short], ("zero",), 1, out=tmp_path, progress=False)


@pytest.mark.parametrize("name", ["../../escaped", "/escaped", "a/b", "n" * 300, "a\0b", "a\nb"])
def test_a_scenario_with_a_path_for_a_name_is_refused(short: Scenario, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="cannot name a file") as refusal:
        evaluate([short.model_copy(update={"name": name})], ("zero",), 1, out=tmp_path / "out", progress=False)
    assert "\n" not in str(refusal.value)
    assert not list(tmp_path.iterdir())


def test_replays_of_policies_with_a_path_for_a_name_stay_in_their_folder(tmp_path: Path) -> None:
    names = ("../../escaped", "/escaped", "a/b", "a_b", "n" * 300, "A/B")
    paths = [find_replay(tmp_path, "corridor", "nominal", name, 1).resolve() for name in names]
    assert len({str(path).lower() for path in paths}) == len(names)
    assert len({path.parent for path in paths}) == 1
    assert all(path.is_relative_to(tmp_path.resolve()) and len(path.name) < 255 for path in paths)


def test_a_manifest_without_a_policy_or_a_case_of_the_summary_is_named(short: Scenario, tmp_path: Path) -> None:
    evaluate([short], ("zero", "random"), 1, out=tmp_path, progress=False)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    for damage, words in (({"policies": ["zero"]}, "policies lack 'random'"), ({"cases": []}, "cases lack .* nominal")):
        (tmp_path / "manifest.json").write_text(json.dumps(manifest | damage))
        with pytest.raises(InputError, match=rf"manifest\.json: {words}"):
            read_evaluation(tmp_path)


@pytest.mark.slow
def test_ctrl_c_ends_the_workers_soon_and_keeps_what_was_played(tmp_path: Path) -> None:
    code = (
        "import sys; from train.evaluation.evaluate import evaluate\n"
        "if __name__ == '__main__':\n"
        "    evaluate(['throw_and_catch'], ['zero'], 5000, workers=2, out=sys.argv[1], progress=False)\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    run = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "out")],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])},
        # A test runner in the background may have been started with Ctrl-C ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    journal = tmp_path / "out" / "rows.jsonl"
    try:
        deadline = time.monotonic() + 120
        while not journal.exists() and time.monotonic() < deadline:
            time.sleep(0.2)
        os.killpg(run.pid, signal.SIGINT)
        # 5000 episodes would take many minutes.
        _, said = run.communicate(timeout=60)
    finally:
        run.kill()
    assert b"KeyboardInterrupt" in said
    rows = [json.loads(line) for line in journal.read_text().splitlines()]
    assert 0 < len(rows) < 5000


def test_the_oracle_has_an_expert_and_is_refused_where_there_is_none() -> None:
    assert not has_expert("zero")
    assert has_expert("oracle")
    with pytest.raises(InputError, match="the expert of domain 'floating_manipulator' cannot be told the truth"):
        evaluate(["floating_manipulator"], ("oracle",), 1, progress=False)
