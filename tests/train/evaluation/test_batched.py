"""Many worlds played at once come to what single worlds come to."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from agents.actor import Actor, PolicyRecord, save_policy
from agents.shared_actor import SharedRecord, find_layout, save_shared
from agents.source import make_source
from impact_envs import InputError, load_scenario
from impact_envs.scenario import Scenario
from planners import make_expert_batch
from tests.frozen.freeze import get_plan
from train.evaluation.batch_player import SHARD, play_batched
from train.evaluation.case import EVALUATION_SEEDS, Case
from train.evaluation.evaluate import evaluate_cases
from train.evaluation.metrics import make_row_type
from train.evaluation.player import Job, play
from train.report.page import write_report

EXACT = ("scenario", "suite", "policy", "seed", "success", "steps", "impacts", "replans", "failure")
SEEDS = range(EVALUATION_SEEDS, EVALUATION_SEEDS + 2)


def make_short_case(name: str) -> Case:
    """Return a world in which much is disturbed, of a few seconds."""
    if name == "dual_arm_grasp":
        short: Scenario = load_scenario(name).override({"horizon": 1.3, "formula": "G[0,1.3] box.lag <= 0.015"})
        return Case(short, "nominal")
    if name == "floating_manipulator_thrusters":
        return Case(load_scenario(name).suite("all").shorten(0.1), "all")
    return Case(load_scenario(name).suite("all"), "all", plan=get_plan(name, "all"))


def save_constant(folder: Path, case: Case) -> str:
    """Store a policy that always answers with the same correction."""
    experts: Any = make_expert_batch(case.scenario, 1, case.plan)
    actor = Actor(experts.feature_size, experts.correction_size, hidden=())
    torch.nn.init.constant_(actor.layers[0].bias, 0.3)  # type: ignore[arg-type]
    record = PolicyRecord(
        domain=case.scenario.domain, sources=(make_source(case.scenario, case.suite, case.plan),),
        algorithm="constant", feature_size=experts.feature_size, correction_size=experts.correction_size,
        hidden=(), seed=0, steps=0,
    )  # fmt: skip
    save_policy(folder, actor, record)
    return str(folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["throw_and_catch", "floating_manipulator_thrusters", "dual_arm_grasp"])
def test_rows_equal_those_of_single_worlds(name: str, tmp_path: Path) -> None:
    case = make_short_case(name)
    policies = ["zero", "expert", save_constant(tmp_path / "constant", case)]
    policies += ["oracle", "paper_expert"] if name == "throw_and_catch" else []
    jobs = [Job(0, policy, seed) for policy in policies for seed in SEEDS]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a shortened scenario is another than the trained one
        singles = [row for row, _ in play([case], jobs)]
        batched = [row for row, _ in play_batched([case], jobs)]
    assert len(batched) == len(jobs)
    for ours, single in zip(batched, singles, strict=True):
        assert {key: ours[key] for key in EXACT} == {key: single[key] for key in EXACT}
        assert ours["fallback_kinds"] == single["fallback_kinds"]
        tolerance = 1e-6 if ours["policy"] == policies[2] else 0.0
        assert abs(ours["robustness"] - single["robustness"]) <= tolerance
        assert ours["effort"] is None
        make_row_type().model_validate(ours)
    if name == "dual_arm_grasp":
        return  # so short that no correction tells
    corrected = [row["robustness"] for row in batched if row["policy"] == policies[2]]
    assert corrected != [row["robustness"] for row in batched if row["policy"] == "expert"]


def test_a_network_that_robots_share_plays_alike_in_one_world_and_in_many(tmp_path: Path) -> None:
    case = make_short_case("throw_and_catch")
    layout = find_layout(case.scenario)
    torch.manual_seed(0)
    actor = Actor(layout.size, 3, hidden=(8,))
    torch.nn.init.normal_(actor.layers[-1].weight, std=0.05)  # type: ignore[arg-type]
    record = SharedRecord(
        domain="free_flyer", sources=(make_source(case.scenario, case.suite, None),), algorithm="random",
        observation=tuple(layout.describe().splitlines()), action_size=3, time_place=layout["time"].start, waves=0,
        hidden=(8,), seed=0, steps=0,
    )  # fmt: skip
    save_shared(tmp_path, actor, record)
    jobs = [Job(0, str(tmp_path), seed) for seed in SEEDS]
    singles = [row for row, _ in play([case], jobs)]
    batched = [row for row, _ in play_batched([case], jobs)]
    assert len({row["robustness"] for row in singles}) > 1
    for ours, single in zip(batched, singles, strict=True):
        assert {key: ours[key] for key in EXACT} == {key: single[key] for key in EXACT}
        assert ours["robustness"] == pytest.approx(single["robustness"], abs=1e-4)  # rounding grows with time


def test_finished_shards_are_kept_and_gone_on_with(tmp_path: Path) -> None:
    case = replace(make_short_case("throw_and_catch"), plan=None)
    first = evaluate_cases([case], ["zero"], SHARD + 3, out=tmp_path, progress=False, batched=True)
    lines = (tmp_path / "rows.jsonl").read_text().splitlines(keepends=True)
    assert first.episodes_played == len(lines) == SHARD + 3
    (tmp_path / "rows.jsonl").write_text("".join(lines[:SHARD]))
    second = evaluate_cases([case], ["zero"], SHARD + 3, out=tmp_path, progress=False, batched=True)
    assert second.episodes_played == 3
    np.testing.assert_array_equal(second.episodes["robustness"], first.episodes["robustness"])
    assert second.rows[0]["effort_median"] is None
    write_report(tmp_path)  # which is made without what is not known
    assert second.rows[0]["solve_ms"] == {"p50": None, "p99": None, "max": None}


def test_a_policy_of_single_worlds_is_refused() -> None:
    with pytest.raises(InputError, match="policy 'random' plays one world at a time"):
        evaluate_cases(
            [replace(make_short_case("throw_and_catch"), plan=None)], ["random"], 2, progress=False, batched=True
        )
