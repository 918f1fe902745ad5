"""Evaluations on a Ray cluster of two nodes on this machine: whatever is killed, the same rows."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from impact_envs import InputError
from tests.train.processes import ROOT, count_rows, find_children, is_alive, start, wait_until
from train.arguments import Args
from train.cli.sweep import Command
from train.errors import WorkerLost
from train.evaluation.case import TUNING_SEEDS, make_cases
from train.evaluation.evaluate import evaluate_cases
from train.launch.choice import Launch, use_launcher
from train.launch.local import LocalLauncher
from train.runs import TrainingRun, launch_runs, name_folder
from train.search.search import Sampling

pytestmark = [
    pytest.mark.skipif(find_spec("ray") is None, reason="the extra [ray] is not installed"),
    pytest.mark.skipif(sys.platform != "linux", reason="reads /proc and sends signals"),
]

EPISODES, SIZE = 150, 10  # of each policy; seeds of a shard
POLICIES = ("zero", "expert")
SETTINGS = {"expert.tracker": "lqr"}
MEMORY = 100 * 2**20  # of a node's object store [bytes]
CODE = f"""
import sys
from train.evaluation.case import make_cases
from train.evaluation.evaluate import evaluate_cases
from train.evaluation.shard import ShardSizes
from train.launch.choice import Launch, use_launcher

if __name__ == "__main__":
    cases = make_cases(["throw_and_catch"], ["hard"], {SETTINGS})
    with use_launcher(Launch("ray", sys.argv[1])) as launcher:
        evaluate_cases(
            cases, {POLICIES}, {EPISODES}, {TUNING_SEEDS}, out=sys.argv[2], progress=False, batched=True,
            launcher=launcher, sizes=ShardSizes(batched={SIZE}),
        )
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The table that this process alone comes to."""
    out = tmp_path_factory.mktemp("whole")
    cases = make_cases(["throw_and_catch"], ["hard"], SETTINGS)
    evaluate_cases(cases, POLICIES, EPISODES, TUNING_SEEDS, out=out, progress=False, batched=True)
    return (out / "rows.parquet").read_bytes()


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two nodes of a core each."""
    from ray.cluster_utils import Cluster

    os.environ["PYTHONPATH"] = str(ROOT)
    head = {"num_cpus": 1, "object_store_memory": MEMORY, "include_dashboard": False}
    made = Cluster(initialize_head=True, head_node_args=head)
    made.add_node(num_cpus=1, object_store_memory=MEMORY)
    made.wait_for_nodes()
    ours = find_children(os.getpid(), b"ray")
    assert len(ours) >= 3  # two raylets and what knows them both
    yield made
    made.shutdown()
    assert wait_until(lambda: not any(map(is_alive, ours)), 30)


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "script.py"
    path.write_text(CODE)
    return path


@pytest.mark.slow
def test_a_worker_a_node_and_the_driver_are_killed_and_the_table_has_the_same_bytes(
    cluster: Any, whole: bytes, script: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run = start(script, cluster.address, out)
    try:
        assert wait_until(lambda: count_rows(out) >= SIZE, 240), run.poll()
        workers = find_children(os.getpid(), b"ray::_do")
        os.kill(workers[0], signal.SIGKILL)
        assert wait_until(lambda: count_rows(out) >= 6 * SIZE, 240), run.poll()
        cluster.remove_node(cluster.list_all_nodes()[-1], allow_graceful=False)
        lost = count_rows(out)
        assert wait_until(lambda: count_rows(out) >= lost + 2 * SIZE, 240), run.poll()
    finally:
        run.kill()
        run.communicate()
    assert count_rows(out) < len(POLICIES) * EPISODES
    cluster.add_node(num_cpus=1, object_store_memory=MEMORY)
    again = start(script, cluster.address, out)
    try:
        _, said = again.communicate(timeout=300)
    finally:
        again.kill()
    assert again.returncode == 0, said
    rows = [json.loads(line) for line in (out / "rows.jsonl").read_text().splitlines()]
    keys = [(row["policy"], row["seed"]) for row in rows]
    assert len(keys) == len(set(keys)) == len(POLICIES) * EPISODES
    assert (out / "rows.parquet").read_bytes() == whole


@pytest.mark.slow
def test_rows_behind_a_uri_outlive_the_driver(cluster: Any, whole: bytes, script: Path, tmp_path: Path) -> None:
    out = tmp_path / "shared"
    run = start(script, cluster.address, out.as_uri())
    try:
        assert wait_until(lambda: len(list((out / "rows").glob("*.jsonl"))) >= 5, 240), run.poll()
    finally:
        run.kill()
        run.communicate()
    kept = {path.name: path.read_bytes() for path in (out / "rows").glob("[!.]*.jsonl")}
    assert not (out / "rows.parquet").exists()
    again = start(script, cluster.address, out.as_uri())
    try:
        _, said = again.communicate(timeout=300)
    finally:
        again.kill()
    assert again.returncode == 0, said
    assert (out / "rows.parquet").read_bytes() == whole
    assert all((out / "rows" / name).read_bytes() == content for name, content in kept.items())
    assert len(list((out / "rows").glob("*.jsonl"))) == len(POLICIES) * EPISODES // SIZE


@pytest.mark.parametrize("address", ["127.0.0.1:1", "127.0.0.1:99999", "nonsense"])
def test_where_no_cluster_is_one_line_says_so(address: str) -> None:
    said = f"the Ray cluster at '{address}' cannot be reached"
    with pytest.raises(InputError, match=said) as caught, use_launcher(Launch("ray", address)):
        pass
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_cluster_that_is_started_here_is_told_and_one_that_is_joined_is_not(cluster: Any) -> None:
    command = [sys.executable, "-m", "train.cli.main", "evaluate", "throw_and_catch", "--policies", "zero"]
    command += ["--episodes", "1", "--batched", "--launcher", "ray"]
    environment = {name: value for name, value in os.environ.items() if name != "RAY_ADDRESS"}
    for more, told in ((["--workers", "1"], 1), (["--address", cluster.address], 0)):
        with tempfile.TemporaryDirectory(dir="/tmp") as folder:  # no cluster is known there; names of sockets are short
            done = subprocess.run(
                [*command, *more],
                env=environment | {"RAY_TMPDIR": folder},
                cwd=ROOT,
                capture_output=True,
                text=True,
                timeout=300,
            )
        assert done.returncode == 0, done.stderr
        lines = [line for line in done.stderr.splitlines() if "no Ray cluster is named" in line]
        assert len(lines) == told, done.stderr
        assert all("--address" in line and "RAY_ADDRESS" in line for line in lines)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("optuna") is None, reason="the extra [sweep] is not installed")
def test_a_search_comes_to_the_same_trials_as_here(cluster: Any, tmp_path: Path) -> None:
    sampling = Sampling(("expert.tracker=['lqr','mpc']", "true.restitution=0.3,0.9"), trials=6)
    command = Command(("throw_and_catch",), ("hard",), policies=("expert",), episodes=20, sampling=sampling)
    here, there = tmp_path / "here", tmp_path / "there"
    alone = replace(command, out=str(here)).run()
    assert replace(command, out=str(there), launch=Launch("ray", cluster.address)).run() == alone
    for name in ("search.json", "trials.csv", "rows.parquet", "report/rows.parquet"):
        assert (there / name).read_bytes() == (here / name).read_bytes()


@pytest.mark.slow
def test_what_a_shard_raises_is_raised_here(cluster: Any) -> None:
    with use_launcher(Launch("ray", cluster.address)) as launcher:
        with pytest.raises(InputError, match="no such thing"):
            list(launcher.run(start_failing, [1]))
        with pytest.raises(WorkerLost, match="4 Ray processes or nodes were lost"):
            list(launcher.run(start_missing, [1]))
        assert sorted(launcher.run(start_squaring, range(5))) == [0, 1, 4, 9, 16]


@pytest.mark.slow
def test_a_training_whose_worker_is_killed_goes_on_elsewhere_to_the_same_weights(cluster: Any, tmp_path: Path) -> None:
    arguments = Args(
        scenarios=("throw_and_catch",), suite=("hard",), steps=200, set=("expert.tracker=lqr",), worlds=16, threads=1,
        eval_every=2, eval_episodes=4, report_episodes=4, log=False, progress=False, seed=3,
    )  # fmt: skip
    shared = tmp_path / "shared"
    with use_launcher(Launch("ray", cluster.address)) as launcher:
        run = TrainingRun("train", arguments, name_folder(shared.as_uri(), "seed3"))
        killed = list[int]()
        watch = threading.Thread(target=kill_when, args=(shared / "seed3" / "state.tar", killed))
        watch.start()
        (result,) = launch_runs(launcher, [run], progress=False)
        watch.join()
    assert killed
    assert result["steps"] >= 200
    alone = TrainingRun("train", arguments, name_folder(tmp_path / "alone"))
    launch_runs(LocalLauncher(), [alone], progress=False)
    there, here = (folder / "policy.safetensors" for folder in (shared / "seed3", tmp_path / "alone"))
    assert there.read_bytes() == here.read_bytes()


def kill_when(path: Path, killed: list[int]) -> None:
    """Kill a worker once a file is there."""
    if wait_until(path.exists, 240):
        killed += find_children(os.getpid(), b"ray::_do")[:1]
        for pid in killed:
            os.kill(pid, signal.SIGKILL)


def start_squaring() -> Any:
    return lambda task: [task * task]


def start_missing() -> Any:
    """What a task needs was lost with a node, as Ray tells it where the task would run."""
    from ray.exceptions import OwnerDiedError

    def miss(task: int) -> list[int]:
        raise OwnerDiedError("00", None, "")

    return miss


def start_failing() -> Any:
    def fail(task: int) -> list[int]:
        raise InputError("no such thing")

    return fail
