"""Any folder of an evaluation is gone on with and reported, or is refused in one line and left as it is."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fuzz.mutations import (
    Content,
    answer,
    check,
    check_finite,
    damaged,
    mistyped,
    mutated,
    read_folder,
    write_folder,
)
from train.evaluation.results import read_evaluation

SEEDS = (2_000_000, 2_000_001, 2_000_002)
COMMAND = ("evaluate", "throw_and_catch", "--policies", "random", "zero", "--episodes", str(len(SEEDS)))
SHORT = ("--set", "horizon=3.0", "formula=G[3,3] pop in goal", "--json")
KEYS = {(policy, seed) for policy in ("random", "zero") for seed in SEEDS}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The files of a finished evaluation."""
    folder = tmp_path_factory.mktemp("finished")
    assert answer(*COMMAND, *SHORT, "--out", str(folder)) == 0
    return {name: content for name, content in read_folder(folder).items() if name != ".lock"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("changed")


def change_rows(rows):
    """Change what a journal holds, or take rows away, as a kill does."""
    lines = rows.decode().splitlines(keepends=True)

    def change_row(place):
        changed = mutated(json.loads(lines[place])).map(lambda row: json.dumps(row) + "\n")
        return changed.map(lambda line: "".join((*lines[:place], line, *lines[place + 1 :])))

    one = st.integers(0, len(lines) - 1).flatmap(change_row)
    text = st.one_of(one, one, mistyped(rows.decode())).map(lambda text: text.encode(errors="replace"))
    cut = st.integers(0, len(rows)).map(lambda length: rows[:length])
    return st.one_of(text, text, damaged(rows), cut).map(Content)


def change_file(name, content):
    """Change a file of JSON, or of bytes."""
    if not name.endswith(".json"):
        return damaged(content).map(Content)
    text = st.one_of(mutated(json.loads(content)).map(json.dumps), mistyped(content.decode()))
    return st.one_of(text.map(lambda text: text.encode(errors="replace")), damaged(content)).map(Content)


def check_resuming(data, finished, folder):
    """Go on with a journal: every episode is there once, or nothing has changed."""
    files = dict(finished)
    for name in ("summary.json", "rows.parquet"):  # as a kill leaves it
        del files[name]
    if data.draw(st.booleans()):
        files["rows.jsonl"] = data.draw(change_rows(files["rows.jsonl"]))
    else:
        files["manifest.json"] = data.draw(change_file("manifest.json", files["manifest.json"]))
    write_folder(folder, files)
    if answer(*COMMAND, *SHORT, "--out", str(folder)):
        assert {name: content for name, content in read_folder(folder).items() if name != ".lock"} == files
        return
    left = read_folder(folder).keys() - {".lock"}
    assert left - finished.keys() <= {name for name in left if name.startswith("replays")}
    rows = [json.loads(line) for line in (folder / "rows.jsonl").read_text().splitlines()]
    assert {(row["policy"], row["seed"]) for row in rows} >= KEYS
    episodes = read_evaluation(folder).episodes
    assert set(zip(episodes["policy"], episodes["seed"], strict=True)) == KEYS
    assert len(episodes) == len(KEYS)
    check_finite(episodes["robustness"])


def check_report(data, finished, folder):
    """Report an evaluation of which one file is spoilt."""
    name = data.draw(st.sampled_from([name for name in sorted(finished) if name != "rows.jsonl"]))
    files = finished | {name: data.draw(change_file(name, finished[name]))}
    write_folder(folder, files)
    answered_with = answer("report", str(folder), "--json")
    left = read_folder(folder)
    assert left.keys() - files.keys() == ({"report.html"} if answered_with == 0 else set())
    assert all(left[name] == content for name, content in files.items())


@check(30)
@given(data=st.data())
def test_changed_journals(data, finished, folder):
    check_resuming(data, finished, folder)


@check(20)
@given(data=st.data())
def test_changed_files_of_a_report(data, finished, folder):
    check_report(data, finished, folder)


@pytest.mark.slow
@check(1500)
@given(data=st.data())
def test_many_changed_journals(data, finished, folder):
    check_resuming(data, finished, folder)


@pytest.mark.slow
@check(1000)
@given(data=st.data())
def test_many_changed_files_of_a_report(data, finished, folder):
    check_report(data, finished, folder)
