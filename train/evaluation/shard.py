"""Episodes cut into shards, which are played anywhere with the same rows.

A shard is some seeds of one policy in one case. What plays it is made anew for it, so that its rows depend on nothing
else: not on who plays it, after what, or beside which other shards.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from impact_envs.file import make_file_name
from train.evaluation.batch_player import play_batched
from train.evaluation.case import Case, is_built_in
from train.evaluation.journal import ROWS, digest, read_versions
from train.evaluation.own_policy import digest_code, is_own
from train.evaluation.player import Job, Outcome, Player, checkpoint_directory, use_one_thread
from train.launch.folder import open_folder
from train.launch.origin import Origin, check_origin


@dataclass(frozen=True)
class ShardSizes:
    """Seeds of a shard: what is lost with a process or a node, and what is played again.

    Attributes:
        single: where one world is played at a time: an expert's ten episodes take seconds to a minute.
        batched: where many are: two times the worlds that are played together, so that making the experts anew is a
            twentieth of the work or less.
        least: where many are, and processes of this machine share few of them: with fewer in a shard, Python's part of
            a control step costs more than the worlds.
        pieces: shards of a process where they are few: the last ones are not waited for long.
    """

    single: int = 10
    batched: int = 100
    least: int = 10
    pieces: int = 4

    def share(self, episodes: int, workers: int) -> int | None:
        """Return how many seeds a shard has where processes of this machine share the episodes of many worlds.

        Args:
            episodes: of all policies and cases.
            workers: processes; one has nothing to share.
        """
        if workers == 1:
            return None
        return min(self.batched, max(self.least, math.ceil(episodes / (self.pieces * workers))))


@dataclass(frozen=True)
class Shard:
    """Episodes of one policy in one case.

    Attributes:
        case: place of its case in the list of cases.
        policy: name of the policy, as player.make_policy takes it.
        seeds: of the episodes, ascending.
        replay: of which of them a replay is wanted, if of any.
    """

    case: int
    policy: str
    seeds: tuple[int, ...]
    replay: int | None = None

    def __str__(self) -> str:
        """Name the shard in a message."""
        return f"policy '{self.policy}', case {self.case}, seeds {self.seeds[0]} to {self.seeds[-1]}"

    @property
    def jobs(self) -> list[Job]:
        """Return its episodes."""
        return [Job(self.case, self.policy, seed, seed == self.replay) for seed in self.seeds]


def cut_shards(jobs: Sequence[Job], size: int | None) -> list[Shard]:
    """Cut episodes into shards.

    Args:
        jobs: episodes; those of a policy in a case by ascending seeds.
        size: most seeds of a shard; None: all of a policy in a case.
    """
    together: dict[tuple[int, str], list[Job]] = {}
    for job in jobs:
        together.setdefault((job.case, job.policy), []).append(job)
    shards = []
    for (case, policy), some in together.items():
        step = size or len(some)
        for start in range(0, len(some), step):
            block = some[start : start + step]
            replay = next((job.seed for job in block if job.replay), None)
            shards.append(Shard(case, policy, tuple(job.seed for job in block), replay))
    return shards


@dataclass(frozen=True)
class Request:
    """What is needed to play shards, wherever that is.

    Attributes:
        cases: worlds to be judged in, with their plans.
        policies: that play.
        batched: whether many worlds are played at once.
        out: URI of the folder in which every shard's rows are kept by whoever played it; None: nowhere.
        origin: of the process that asks, see launch.origin; None: this machine, where nothing can differ.
    """

    cases: tuple[Case, ...]
    policies: tuple[str, ...]
    batched: bool
    out: str | None = None
    origin: Origin | None = None


def start_playing(request: Request) -> Callable[[Shard], Iterator[Outcome]]:
    """Return what plays a shard in this process.

    Args:
        request: what is played.

    Raises:
        InputError: this machine has other code, packages, checkpoints or folders than the one that asks.
    """
    use_one_thread(request.cases, request.policies)
    if request.origin is not None:
        check_origin(request.origin, lambda: describe_facts(request.cases, request.policies))
    last: tuple[tuple[int, str], Player] | None = None

    def play_one(shard: Shard) -> Generator[Outcome]:
        nonlocal last
        if request.batched:
            with closing(play_batched(request.cases, shard.jobs)) as outcomes:
                yield from outcomes
            return
        if last is None or last[0] != (shard.case, shard.policy):
            last = (shard.case, shard.policy), Player(request.cases)
        yield from map(last[1].play, shard.jobs)

    def play_and_keep(shard: Shard) -> Iterator[Outcome]:
        outcomes = list(play_one(shard))
        lines = "".join(json.dumps(row, allow_nan=False) + "\n" for row, _ in outcomes)
        assert request.out is not None
        open_folder(request.out).write(name_part(request.cases[shard.case], shard), lines.encode())
        return iter(outcomes)

    return play_one if request.out is None else play_and_keep


def name_part(case: Case, shard: Shard) -> str:
    """Return the name of the file of a shard's rows: the same for the same episodes."""
    seeds = digest(json.dumps(shard.seeds).encode())[:16]
    words = (case.scenario.name, case.suite, shard.policy, shard.seeds[0], shard.seeds[-1], seeds)
    return f"{ROWS}/{make_file_name(*words, suffix='.jsonl')}"


def describe_facts(cases: Sequence[Case], policies: Sequence[str]) -> dict[str, str]:
    """Return what rows that are played in this process depend on, besides what is sent."""
    digests = {f"policy {name}": value for name, value in digest_policies(cases, policies).items()}
    return {f"package {name}": value for name, value in read_versions().items()} | digests


def digest_policies(cases: Sequence[Case], policies: Sequence[str]) -> dict[str, str]:
    """Return what the content of each policy's files is told by: of checkpoints and of a user's code."""
    digests: dict[str, str] = {}
    for label in policies:
        if is_own(label):
            digests[label] = digest_code(label)
        elif not all(is_built_in(label, case.scenario) for case in cases):
            folder = checkpoint_directory(label)
            files: list[Any] = sorted((*folder.glob("policy.*"), *folder.glob("shared.*")))
            digests[label] = digest(*(file.read_bytes() for file in files))
    return digests
