"""The table of residuals is made in small, and gone on with where it stopped."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from impact_envs.errors import InputError


@pytest.fixture(scope="module")
def benchmark(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("residuals")


@pytest.mark.parametrize(
    ("rows", "line"),
    [
        (("pong",), "row 'pong': expected SCENARIO:SUITE, for example pong:hard"),
        (("pong:harder",), "suite 'harder'"),
        (("pongo:hard",), "pongo"),
        (("pong:hard", "pong:hard"), "given twice"),
    ],
)
def test_a_bad_row_is_one_line_before_anything_is_written(
    benchmark: ModuleType, rows: tuple[str, ...], line: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=line):
        benchmark.main(benchmark.Args(rows=rows, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("wrong", [{"runs": 0}, {"steps": 0}, {"generalists": -1}, {"episodes": 0}, {"threads": 0}])
def test_a_bad_count_is_one_line(benchmark: ModuleType, wrong: dict[str, int], tmp_path: Path) -> None:
    ((name, value),) = wrong.items()
    with pytest.raises(InputError, match=f"{name} = {value}"):
        benchmark.main(benchmark.Args(rows=("pong:hard",), out=tmp_path / "out", **wrong))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_small_table_and_what_is_there_is_not_made_again(
    benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tune = benchmark.tune.main
    small = {"population": 4, "elites": 2, "episodes": 4, "generations": 2, "final_episodes": 8, "worlds": 16}
    monkeypatch.setattr(benchmark.tune, "main", lambda args: tune(benchmark.replace(args, **small)))
    args = benchmark.Args(rows=("throw_and_catch:hard",), runs=2, steps=1000, episodes=10, out=tmp_path)
    benchmark.main(args)
    first = capsys.readouterr().out
    for policy in ("paper_expert", "expert", "oracle", "constant", "constant_per_impact", "residual"):
        assert policy in first

    def refuse(args: Any) -> None:
        raise AssertionError(f"made again: {args}")

    monkeypatch.setattr(benchmark.tune, "main", refuse)
    monkeypatch.setattr(benchmark.residual, "main", refuse)
    benchmark.main(args)
    again = capsys.readouterr().out
    assert again[again.index("| suite") :] == first[first.index("| suite") :]
