"""The ``impact break`` command."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from tyro.conf import Positional, arg

from impact_envs.domain import find_part
from impact_envs.errors import InputError
from train.cli.progress import say_written
from train.evaluation.case import Case, make_case

if TYPE_CHECKING:
    from train.falsification.arena import Arena, Played
    from train.falsification.counterexample import Counterexample
    from train.falsification.search import SearchOptions


@dataclass
class Command:
    """Search the worlds that a suite may draw for failures of a policy, and write the mildest of each cause."""

    extras: ClassVar[tuple[str, ...]] = ("plan", "report")
    policy: Annotated[Positional[str], arg(metavar="POLICY")]
    """As impact evaluate --batched takes it; not the oracle."""
    scenario: Annotated[Positional[str], arg(metavar="SCENARIO")]
    """Shipped name or TOML file."""
    suite: str = "hard"
    """Suite whose ranges are searched."""
    vary: tuple[str, ...] = ()
    """Further ranges, or others than the suite's: start=0.05 for robots and objects that start up to 0.05 m from where
    the plan has them, along x and y; robot_start=, object_start=; NAME=LOW,HIGH for what the suite may draw."""
    stand_in: tuple[str, ...] = ()
    """Have the policy with these options of its expert search, where it takes much less time, for example
    expert.plan_anew=false. The policy itself plays the mildest of its failures again; counterexamples are those in
    which it fails too, made milder and measured with it. Where the stand-in succeeds nobody looks."""
    episodes: int = 3000
    """Of the search, rounded to whole rounds of 64 or more that are played together: 300 plays 320."""
    method: Literal["random", "cross_entropy", "cma"] = "cross_entropy"
    """How worlds are chosen, after 40 % at random; cma needs the package cma."""
    seed: int = 1_000_000
    """First seed: of the tuning range, so that evaluation seeds stay unseen."""
    most: int = 5
    """Counterexamples at most, one of a cause."""
    fresh: int = 64
    """Other seeds on which each counterexample's failure rate is measured."""
    workers: int = 1
    """Threads; experts plan anew in processes beside them."""
    out: Path | None = None
    """Write a copy of the scenario with a suite break_1, break_2, ... for each; every command takes it. A file that is
    there is kept: choose another."""
    map: Path | None = None
    """Draw robustness over the two disturbances that explain most of it: a .png, .pdf or .svg."""
    report: Path | None = None
    """Folder of an evaluation: put counterexamples, map and films there, where impact report shows them."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return counts of the search and the counterexamples."""
        from train.evaluation.evaluate import check_request, make_plans
        from train.evaluation.player import Job
        from train.falsification.arena import Arena
        from train.falsification.robustness_map import check_map
        from train.falsification.search import SearchOptions
        from train.falsification.stand_in import make_stand_in
        from train.falsification.suite_file import write_suites
        from train.settings import parse_settings

        self._check()
        case, options = self._make_case(), SearchOptions(self.method, self.episodes)
        changed = parse_settings(self.stand_in, "--stand-in")
        make_stand_in(case, self.policy, changed)  # says now what is wrong with it
        check_request([case], [self.policy], self.episodes, self.seed, self.workers)
        arena = Arena(case, self.policy, options.width)  # refuses what cannot be searched before anything is planned
        if self.map is not None:
            check_map(arena)
        (case,) = make_plans([case], [Job(0, self.policy, self.seed)])
        played, found, counts = self._search(case, options, changed)
        if self.out:
            write_suites(case, self.scenario, found, self.out)
            say_written(self.out)
        result = {
            "scenario": case.scenario.name,
            "suite": self.suite,
            **({"vary": list(self.vary)} if self.vary else {}),
            "policy": self.policy,
            **({"stand_in": changed} if changed else {}),
            "episodes": len(played.success),
            "failures": int(np.sum(~played.success)),
            "least_robustness": float(played.robustness.min()),
            **counts,
            **_describe(arena, played, found),
        }
        self._show(case, arena, played, found, result)
        return result

    def _search(
        self, case: Case, options: SearchOptions, changed: dict[str, Any]
    ) -> tuple[Played, list[Counterexample], dict[str, Any]]:
        """Return the episodes of the search, the counterexamples, and how many episodes that took."""
        from train.falsification.arena import Arena
        from train.falsification.counterexample import find_counterexamples
        from train.falsification.search import search_failures
        from train.falsification.stand_in import make_stand_in, replay_failures

        counts: dict[str, Any] = {}
        with ExitStack() as arenas:

            def open_arena(case: Case) -> Arena:
                return arenas.enter_context(closing(Arena(case, self.policy, options.width, self.workers)))

            arena = searcher = open_arena(case)
            if changed:
                searcher = open_arena(make_stand_in(case, self.policy, changed))
            start = time.perf_counter()
            played = own = search_failures(searcher, self.seed, options)
            counts["episodes_per_minute"] = 60.0 * searcher.episodes / max(time.perf_counter() - start, 1e-9)
            if changed:
                own = replay_failures(arena, searcher, played, self.most)
                counts |= {"replayed": len(own.success), "confirmed": int(np.sum(~own.success))}
            found = find_counterexamples(arena, own, self.most, self.seed + 100_000 + np.arange(self.fresh))
            counts["episodes_with_minimising"] = arena.episodes + (searcher.episodes if changed else 0)
        return played, found, counts

    def _show(self, case: Case, arena: Arena, played: Played, found: list[Counterexample], result: Any) -> None:
        """Draw the map, and put what was found beside the evaluation, where it is asked for."""
        from train.falsification.record import write_record
        from train.falsification.robustness_map import draw_map
        from train.pictures.file import save_figure

        if self.map is None and self.report is None:
            return
        figure = None
        if len(arena.names) > 1:
            who = f"{self.policy}{' with ' * bool(self.stand_in)}{', '.join(self.stand_in)}"
            title = f"{who} in {case.scenario.name}, {self.suite}: {result['episodes']} episodes"
            figure = draw_map(arena, played, found, title, case.scenario.specification)
        if self.map is not None and figure is not None:
            save_figure(figure, self.map)
            say_written(self.map)
        if self.report is not None:
            say_written(write_record(self.report, case, self.policy, result, found, figure))

    def _make_case(self) -> Case:
        """Return the case that is searched."""
        case = make_case(self.scenario, self.suite)
        if not self.vary:
            return case
        pinned = find_part("train", case.scenario.domain, "PINNED")
        if pinned is None:
            raise InputError(f"--vary: worlds of domain '{case.scenario.domain}' cannot be chosen")
        return make_case(self.scenario, self.suite, pinned.read_ranges(self.vary))

    def _check(self) -> None:
        from train.falsification.record import check_folder
        from train.pictures.file import check_picture_path

        for name in ("episodes", "most", "fresh"):
            if getattr(self, name) < 1:
                raise InputError(f"--{name} {getattr(self, name)}: at least 1 is needed")
        if self.out is not None and not self.out.absolute().parent.is_dir():
            raise InputError(f"cannot write {self.out}: folder {self.out.absolute().parent} does not exist")
        if self.out is not None and self.out.is_dir():
            raise InputError(f"--out {self.out}: is a folder; name a file, for example {self.out / 'broken.toml'}")
        if self.out is not None and self.out.is_file():  # a scenario that somebody wrote, or an earlier search's
            raise InputError(f"--out {self.out}: is there already; choose another file")
        if self.map is not None:
            check_picture_path(self.map)
        if self.report is not None:
            check_folder(self.report)


def _describe(arena: Arena, played: Played, found: Sequence[Counterexample]) -> dict[str, Any]:
    """Return what each number explains of the robustness, and the counterexamples, as JSON values."""
    from train.falsification.robustness_map import compute_importance
    from train.falsification.suite_file import name_suites

    importance = dict(zip(arena.names, compute_importance(played), strict=True))
    usual = arena.worlds.list_values(arena.worlds.nominal)
    rows = [
        {
            "suite": name,
            "cause": one.cause,
            "seed": one.seed,
            "robustness": one.robustness,
            "failure_rate": one.failure_rate,
            "found": one.found,
            "not_nominal": {key.removeprefix("true."): one.values[key] for key in one.moved},
            "nominal": {key.removeprefix("true."): usual[key] for key in one.moved},
        }
        for name, one in zip(name_suites(found), found, strict=True)
    ]
    explains = {name: round(importance[name], 3) for name in sorted(importance, key=lambda name: -importance[name])}
    return {"explains": explains, "counterexamples": rows}
