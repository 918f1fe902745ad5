"""A search: better than chance, the same trials however often it is ended, failures told."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from impact_envs import InputError
from train.search.search import Sampling, Score, check_sampling, find_best, list_trials, run_search
from train.search.space import Point, parse_space

pytestmark = pytest.mark.skipif(find_spec("optuna") is None, reason="the extra [sweep] is not installed")

SAMPLING = Sampling(("rate=1e-5,1,log", "share=0.0,1.0", "kind=[[1],[2]]", "count=1,9"), trials=60)
SPACE = parse_space(SAMPLING.sample)
BEST = 0.0


def compute_value(point: Point) -> float:
    """Return a score whose maximum, BEST, is at rate 1e-3, share 0.3, kind [2], count 4."""
    at = dict(point)
    away = (math.log10(at["rate"]) + 3.0) ** 2 + (4.0 * (at["share"] - 0.3)) ** 2 + (0.25 * (at["count"] - 4)) ** 2
    return BEST - away - (at["kind"] == [1])


def score(points: Sequence[Point]) -> list[float | str]:
    return [compute_value(point) for point in points]


def search(out: Path, sampling: Sampling = SAMPLING, by: Score = score, **asked: Any) -> list[Any]:
    return run_search(str(out), SPACE, sampling, asked, by, progress=False)


def interrupt_after(count: int) -> Callable[[Sequence[Point]], list[float | str]]:
    """Return scores that come until so many points were asked for."""
    asked = list[Point]()

    def give(points: Sequence[Point]) -> list[float | str]:
        asked.extend(points)
        if len(asked) > count:
            raise KeyboardInterrupt
        return score(points)

    return give


def test_it_finds_a_known_optimum_better_than_chance(tmp_path: Path) -> None:
    found = {}
    for sampler in ("tpe", "random"):
        best = []
        for seed in range(6):
            trials = search(tmp_path / f"{sampler}{seed}", replace(SAMPLING, sampler=sampler, search_seed=seed))
            place = find_best(trials)
            assert place is not None
            best.append(trials[place].score)
        found[sampler] = sum(best) / len(best)
    assert found["tpe"] > 0.5 * found["random"]  # below zero: less than half as far from the optimum
    assert found["tpe"] > BEST - 0.5


def test_a_search_that_was_ended_twice_has_the_trials_of_one_that_was_not(tmp_path: Path) -> None:
    whole, ended = tmp_path / "whole", tmp_path / "ended"
    search(whole)
    for count in (5, 11):
        with pytest.raises(KeyboardInterrupt):
            search(ended, by=interrupt_after(count))
    search(ended)
    for name in ("search.json", "trials.csv"):
        assert (ended / name).read_bytes() == (whole / name).read_bytes()


def test_more_trials_go_on_as_if_they_had_been_asked_for_at_once(tmp_path: Path) -> None:
    before = search(tmp_path / "grown", replace(SAMPLING, trials=10))  # ends within a round of four
    grown = search(tmp_path / "grown")
    assert [trial.values for trial in grown] == [trial.values for trial in search(tmp_path / "whole")]
    assert grown[:10] == before
    assert search(tmp_path / "grown", replace(SAMPLING, trials=3), interrupt_after(0)) == grown


def test_values_are_in_their_ranges_and_short(tmp_path: Path) -> None:
    for trial in search(tmp_path):
        at = trial.values
        assert 1e-5 <= at["rate"] <= 1
        assert 0 <= at["share"] <= 1
        assert at["kind"] in ([1], [2])
        assert isinstance(at["count"], int)
        assert at["rate"] == float(f"{at['rate']:.4g}")


def test_a_point_that_was_there_before_is_not_scored_again(tmp_path: Path) -> None:
    asked = list[Point]()

    def count(points: Sequence[Point]) -> list[float | str]:
        asked.extend(points)
        return [float(dict(point)["kind"]) for point in points]

    sampling = Sampling(("kind=[1,2]",), trials=9)
    trials = run_search(str(tmp_path), parse_space(sampling.sample), sampling, {}, count, progress=False)
    assert len(trials) == 9
    assert len(asked) == 2
    assert all(trial.score == trial.values["kind"] for trial in trials)


def test_trials_that_fail_are_told_and_the_search_goes_on(tmp_path: Path) -> None:
    def fail_above(points: Sequence[Point]) -> list[float | str]:
        return ["no plan" if dict(point)["share"] > 0.5 else compute_value(point) for point in points]

    trials = search(tmp_path, by=fail_above)
    failed = [trial.failure == "no plan" for trial in trials]
    assert 0 < sum(failed) < 15  # it learns to keep away
    assert [row["failure"] for row in list_trials(trials)] == ["no plan" if bad else None for bad in failed]
    assert "no plan" in (tmp_path / "trials.csv").read_text()
    none = search(tmp_path / "none", by=lambda points: ["no plan"] * len(points))
    assert find_best(none) is None


def test_another_search_in_the_folder_is_refused(tmp_path: Path) -> None:
    sampling = replace(SAMPLING, trials=4)
    search(tmp_path, sampling, suite=["hard"])
    with pytest.raises(InputError, match=r"holds a search with suite \['hard'\], not \['all'\]"):
        search(tmp_path, sampling, suite=["all"])
    with pytest.raises(InputError, match="holds a search with together 4, not 5"):
        search(tmp_path, replace(sampling, together=5), suite=["hard"])
    for _ in range(2):  # of several differences the first one is told
        with pytest.raises(InputError, match="holds a search with suite"):
            search(tmp_path, replace(sampling, together=5, search_seed=1), suite=["all"])
    record = json.loads((tmp_path / "search.json").read_text())
    (tmp_path / "search.json").write_text(json.dumps(record | {"trials": [{}]}))
    with pytest.raises(InputError, match=r"search.json: trials.0.values: Field required"):
        search(tmp_path, sampling, suite=["hard"])


@pytest.mark.parametrize(
    ("sampling", "said"),
    [
        (Sampling(trials=5), "--trials 5: needs --sample"),
        (Sampling(search_seed=5), "--search-seed 5: needs --sample"),
        (Sampling(("a=1,2",), trials=0), "--trials 0 is too small; choices: 1, 2"),
        (Sampling(("a=1,2",), together=0), "--together 0 is too small"),
        (Sampling(("a=1,2",), search_seed=-1), "--search-seed -1 is too small; choices: 0, 1"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(sampling: Sampling, said: str) -> None:
    with pytest.raises(InputError, match=said):
        check_sampling(sampling)
