"""Who plays: policies by name, and episodes played in one process or in several with the same outcome."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import agents
from impact_envs.env import ImpactEnv, parallel_env
from impact_envs.errors import InputError, choices
from impact_envs.rollout import Policy, RandomPolicy, ZeroPolicy, rollout
from impact_envs.scenario import Scenario, load_scenario
from planners import list_variants, make_expert
from planners.plan import Plan
from train.evaluation.case import BUILT_IN, Case, has_expert, is_built_in
from train.evaluation.metrics import make_row
from train.evaluation.oracle import OraclePolicy
from train.evaluation.own_policy import is_own, make_own
from train.evaluation.replay import episode_to_dict

SHIPPED = Path(agents.__file__).parent / "checkpoints"
# An episode's row, and its replay if one is wanted.
Outcome = tuple[dict[str, Any], dict[str, Any] | None]


@dataclass(frozen=True)
class Job:
    """One episode to be played.

    Attributes:
        case: place of its case in the list of cases.
        policy: name of the policy, as make_policy takes it.
        seed: of the episode.
        replay: whether a replay is wanted.
    """

    case: int
    policy: str
    seed: int
    replay: bool = False


def checkpoint_directory(name: str, variants: Sequence[str] = ()) -> Path:
    """Return the checkpoint directory a policy name stands for.

    Args:
        name: a directory, or the name of a shipped checkpoint.
        variants: of the scenario's expert, to be named among the choices.

    Raises:
        InputError: neither; the line lists what there is.
    """
    shipped = sorted(path.name for path in SHIPPED.iterdir() if path.is_dir()) if SHIPPED.is_dir() else []
    if Path(name).is_dir():
        return Path(name)
    if name in shipped:
        return SHIPPED / name
    known = choices(name, (*BUILT_IN, *variants, *shipped))
    raise InputError(f"policy '{name}' is unknown; {known}, a checkpoint directory, or MODULE:FACTORY of your own")


def make_policy(
    name: str,
    scenario: str | Path | Scenario,
    plan: Plan | None = None,
    options: Mapping[str, Any] | None = None,
) -> Policy:
    """Make a policy from its name.

    Args:
        name: ``expert``, ``oracle`` (told the truth), ``zero`` (no control), ``random`` (uniform actions), a variant of
            the expert (see planners.list_variants), a checkpoint directory (of a residual policy, or of one that all
            robots share), the name of a shipped checkpoint, or ``module:factory`` of the user, see own_policy.
        scenario: a shipped name, the path of a TOML file, or a Scenario; experts see only its believed part.
        plan: for the expert to follow; planned now if one is needed and none is given.
        options: of the expert, see planners.make_expert; unused without one.

    Raises:
        InputError: unknown name, or a broken or unfitting checkpoint.
        PlanningError: the expert found no plan.
    """
    loaded = load_scenario(scenario)
    if is_own(name):
        return make_own(name, loaded)
    if name == "zero":
        return ZeroPolicy(parallel_env(loaded))
    if name == "random":
        return RandomPolicy(parallel_env(loaded))
    if name == "oracle":
        return OraclePolicy(loaded, plan, options)
    variants = list_variants(loaded)
    if name == "expert" or name in variants:
        return make_expert(loaded, plan, name if name in variants else None, options)
    directory = checkpoint_directory(name, variants)
    from agents.shared_actor import is_shared, load_shared_policy

    if is_shared(directory):
        return load_shared_policy(directory, loaded)
    from agents.residual import ResidualPolicy

    return ResidualPolicy.load(directory, loaded, plan, options)


def play(cases: Sequence[Case], jobs: Sequence[Job]) -> Generator[Outcome]:
    """Play episodes one after the other in this process, and yield each outcome as it finishes.

    Args:
        cases: worlds to be judged in.
        jobs: episodes to be played.

    Yields:
        Row and replay of an episode, see metrics.make_row and replay.episode_to_dict.

    Raises:
        InputError: a checkpoint is broken or does not fit.
        PlanningError: an expert found no plan.
    """
    use_one_thread(cases, {job.policy for job in jobs})
    yield from map(Player(cases).play, jobs)


class Player:
    """Play episodes in one process; environments and policies are made once and reused."""

    def __init__(self, cases: Sequence[Case]) -> None:
        self._cases = cases
        self._envs: dict[int, ImpactEnv] = {}
        self._policies: dict[tuple[int, str], Policy] = {}

    def play(self, job: Job) -> Outcome:
        """Return an episode's row, and its replay if one is wanted."""
        case, key = self._cases[job.case], (job.case, job.policy)
        if job.case not in self._envs:
            self._envs[job.case] = parallel_env(case.scenario)
        if key not in self._policies:
            self._policies[key] = make_policy(job.policy, case.scenario, case.plan, case.options)
        env = self._envs[job.case]
        episode = rollout(env, self._policies[key], job.seed)
        plan = case.plan if has_expert(job.policy) else None
        row = make_row(episode, case.scenario, case.suite, job.policy, plan)
        if not job.replay:
            return row, None
        return row, episode_to_dict(episode, case.scenario, case.suite, env.task.shapes(), plan)


def use_one_thread(cases: Sequence[Case], policies: Iterable[str]) -> None:
    """Keep numerical libraries from using a thread per core in every process."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if not all(is_built_in(policy, case.scenario) for policy in policies for case in cases):
        # Imported here: playing without checkpoints needs no torch.
        import torch

        torch.set_num_threads(1)
