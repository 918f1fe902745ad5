"""However episodes are cut into shards, and whoever plays them: the same rows."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from agents.actor import Actor
from impact_envs import InputError
from train.cli.main import main
from train.errors import WorkerLost
from train.evaluation.batch_player import answer_each
from train.evaluation.case import TUNING_SEEDS, make_case
from train.evaluation.evaluate import evaluate_cases
from train.evaluation.player import Job
from train.evaluation.shard import Request, Shard, ShardSizes, cut_shards, describe_facts, name_part, start_playing
from train.launch.choice import Launch, use_launcher
from train.launch.local import LocalLauncher
from train.launch.origin import check_origin, describe_origin

CASE = make_case("throw_and_catch", "hard")
JOBS = [Job(0, policy, seed, replay=seed == 3) for policy in ("zero", "random") for seed in range(3, 10)]


@pytest.mark.parametrize("size", [None, 1, 3, 7, 100])
def test_every_episode_is_in_one_shard_and_no_shard_mixes_policies(size: int | None) -> None:
    shards = cut_shards(JOBS, size)
    assert [job for shard in shards for job in shard.jobs] == JOBS
    assert all(len(shard.seeds) <= (size or 7) for shard in shards)
    assert len({name_part(CASE, shard) for shard in shards}) == len(shards)


def test_two_processes_and_small_shards_come_to_the_table_of_one(tmp_path: Path) -> None:
    tables = []
    for name, launcher, size in (("one", None, 100), ("two", LocalLauncher(2), 4)):
        evaluate_cases(
            [CASE], ["zero"], 13, TUNING_SEEDS, out=tmp_path / name, progress=False, batched=True,
            launcher=launcher, sizes=ShardSizes(batched=size),
        )  # fmt: skip
        tables.append((tmp_path / name / "rows.parquet").read_bytes())
    assert tables[0] == tables[1]


def test_an_evaluation_behind_a_uri_goes_on_from_its_shards(tmp_path: Path) -> None:
    here, there, out = tmp_path / "here", tmp_path / "there", (tmp_path / "there").as_uri()
    sizes, common = ShardSizes(batched=5), {"progress": False, "batched": True}
    evaluate_cases([CASE], ["zero"], 20, TUNING_SEEDS, out=here, **common)
    first = evaluate_cases([CASE], ["zero"], 8, TUNING_SEEDS, out=out, sizes=sizes, **common)
    assert (first.episodes_played, first.out) == (8, out)
    assert len(list((there / "rows").iterdir())) == 2
    second = evaluate_cases([CASE], ["zero"], 20, TUNING_SEEDS, out=out, sizes=ShardSizes(batched=7), **common)
    assert second.episodes_played == 12
    assert (there / "rows.parquet").read_bytes() == (here / "rows.parquet").read_bytes()
    other = replace(CASE, scenario=CASE.scenario.override({"true.restitution": 0.5}))
    with pytest.raises(InputError, match=r"file://.*holds episodes of another 'throw_and_catch/hard'"):
        evaluate_cases([other], ["zero"], 8, TUNING_SEEDS, out=out, **common)


def test_a_damaged_shard_is_named(tmp_path: Path) -> None:
    evaluate_cases([CASE], ["zero"], 2, TUNING_SEEDS, out=tmp_path.as_uri(), progress=False, batched=True)
    (part,) = (tmp_path / "rows").iterdir()
    part.write_text("{}\n")
    with pytest.raises(InputError, match=rf"rows/{part.name}: line 1 is not an episode"):
        evaluate_cases([CASE], ["zero"], 2, TUNING_SEEDS, out=tmp_path.as_uri(), progress=False, batched=True)


def test_a_networks_answer_in_a_world_does_not_depend_on_the_others() -> None:
    torch.manual_seed(0)
    actor = Actor(20, 3)
    torch.nn.init.normal_(actor.layers[-1].weight)  # type: ignore[arg-type]
    features = np.random.default_rng(0).normal(size=(37, 20))
    whole = answer_each(actor.correction, features)
    np.testing.assert_allclose(whole, actor.correction(features), atol=1e-5)
    for start, end in ((0, 1), (1, 4), (4, 37)):
        np.testing.assert_array_equal(answer_each(actor.correction, features[start:end]), whole[start:end])


def test_a_machine_with_another_package_plays_nothing() -> None:
    facts = describe_facts([CASE], ["zero"])
    assert facts["package numpy"] == np.__version__
    same = describe_origin(facts, False)
    request = Request((CASE,), ("zero",), batched=True, origin=same)
    (row, replay), *rest = start_playing(request)(Shard(0, "zero", (7,)))
    assert (row["seed"], replay, rest) == (7, None, [])
    other = describe_origin(facts | {"package numpy": "1.0"}, False)
    with pytest.raises(InputError, match=rf"package numpy is {np.__version__}, but 1.0 where the command was given"):
        start_playing(replace(request, origin=other))
    with pytest.raises(InputError, match="folder /no/such, where the user's files are: No such file or directory"):
        check_origin(replace(same, folder="/no/such"), dict)


def give_up(task: int) -> list[int]:
    raise WorkerLost("gone")


def start_giving_up() -> object:
    return give_up


def test_what_a_task_raises_ends_the_run() -> None:
    with pytest.raises(WorkerLost, match="gone"):
        list(LocalLauncher().run(start_giving_up, [1, 2, 3]))  # type: ignore[arg-type]


def start_counting(factor: int) -> object:
    return partial(count_up, factor)


def count_up(factor: int, task: int) -> list[int]:
    return [factor * task, factor * task + 1]


def test_a_task_may_have_several_results() -> None:
    assert list(LocalLauncher().run(partial(start_counting, 10), [1, 2])) == [10, 11, 20, 21]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("launch", "said"),
    [
        (Launch("local", "auto"), "--address auto: is for --launcher ray"),
        (Launch("local", workers=0), "workers 0 is too small; choices: 1, 2"),
    ],
)
def test_launchers_refuse_what_does_not_fit(launch: Launch, said: str) -> None:
    with pytest.raises(InputError, match=said), use_launcher(launch):
        pass


def test_without_ray_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "train.launch.ray", raising=False)
    assert main(["evaluate", "throw_and_catch", "--policies", "zero", "--launcher", "ray"]) == 2
    assert capsys.readouterr().err == "impact: ray is not installed: pip install 'impact-envs[plan,report,ray]'\n"
