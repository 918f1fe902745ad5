"""Many episodes of a policy at once: rows as the player's of single worlds, at a hundredth of the time.

Success and robustness equal the single world's, an expert's bit for bit, a network's to rounding. What only a single
world tells is not there: effort, solve and wall times are None; a domain's own figures and replays are left out.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.stl.verdict import judge
from impact_envs.stream import draw_doubles, seed_streams
from planners import list_variants, make_expert_batch, make_oracle_batch
from train.evaluation.case import Case
from train.evaluation.metrics import METRICS
from train.evaluation.own_policy import is_own
from train.evaluation.player import Job, Outcome, checkpoint_directory

# Episodes that are played together, and lost together when a run is interrupted.
SHARD = 50


class BatchPolicy(Protocol):
    """Who acts in N worlds."""

    def begin(self, seeds: np.ndarray) -> None:
        """Be told the seeds of the episodes that start, shape (N,)."""

    def act(self, output: Any) -> np.ndarray:
        """Return the joint actions, shape (N, size), from what the worlds' last step returned."""

    def count_events(self) -> dict[str, np.ndarray]:
        """Return how often what happened since the episodes began, name to shape (N,)."""

    def close(self) -> None:
        """Let threads and processes go."""


def answer_each(network: Callable[[np.ndarray], np.ndarray], given: np.ndarray) -> np.ndarray:
    """Return what a network answers in every world, shape (m, ...), float64.

    World by world: libraries multiply matrices of other shapes in another order, and a world's answer would depend, in
    its last bits, on which others ask at the same moment; so on how episodes are cut into shards.

    Args:
        network: takes and returns a row for each world.
        given: shape (m, ...).
    """
    return np.stack([np.asarray(network(given[k : k + 1]), float)[0] for k in range(len(given))])


class _Zero:
    """No control at all."""

    def __init__(self, count: int, action_shape: tuple[int, ...]) -> None:
        self._actions = np.zeros((count, *action_shape))

    def begin(self, seeds: np.ndarray) -> None:
        """Do nothing."""

    def act(self, output: Any) -> np.ndarray:
        """Return zeros."""
        return self._actions

    def count_events(self) -> dict[str, np.ndarray]:
        """Return nothing."""
        return {}

    def close(self) -> None:
        """Do nothing."""


class _Expert:
    """Experts, and where a network corrects them, its corrections.

    Args:
        experts: of N worlds.
        correct: takes features, shape (m, F), and returns corrections, shape (m, C); None: nobody corrects.
    """

    def __init__(self, experts: Any, correct: Callable[[np.ndarray], np.ndarray] | None = None) -> None:
        self._experts, self._correct = experts, correct
        self._unanswered = np.zeros(experts.count, np.int64)

    def begin(self, seeds: np.ndarray) -> None:
        """Forget what was counted; experts start anew with the first observation."""
        self._unanswered[:] = 0

    def act(self, output: Any) -> np.ndarray:
        """Return the experts' actions, corrected where they ask."""
        if self._correct is None:
            return self._experts.act(output.joint)
        awaiting = self._experts.observe(output.joint)
        while awaiting.any():
            chosen = np.flatnonzero(awaiting)
            corrections = answer_each(self._correct, self._experts.features()[chosen])
            lost = ~np.isfinite(corrections).all(axis=1)  # no answer counts as zero
            corrections[lost] = 0.0
            self._unanswered[chosen] += lost
            awaiting = self._experts.correct(chosen, np.clip(corrections, -1.0, 1.0))
        return self._experts.control()

    def count_events(self) -> dict[str, np.ndarray]:
        """Return the experts' counts, and how many corrections were no finite numbers."""
        return {**self._experts.counts, "no_correction": self._unanswered}

    def close(self) -> None:
        """Let the experts' threads and processes go."""
        self._experts.close()


class _Shared(_Zero):
    """A network that all robots share, each of which gives it its own observation.

    Args:
        choose: takes observations, shape (N, robots, size), and returns actions, shape (N, robots, action size).
    """

    def __init__(self, choose: Callable[[np.ndarray], np.ndarray]) -> None:
        self._choose = choose

    def act(self, output: Any) -> np.ndarray:
        """Return what the network answers."""
        return np.clip(answer_each(self._choose, output.agents), -1.0, 1.0)


class _Oracle(_Expert):
    """Experts that are told the truth of every episode.

    Args:
        experts: see planners.make_oracle_batch.
        scenario: with its true physics.
    """

    def __init__(self, experts: Any, scenario: Any) -> None:
        super().__init__(experts)
        self._scenario = scenario

    def begin(self, seeds: np.ndarray) -> None:
        """Draw the truth as the worlds do, and hand it over."""
        uniforms = draw_doubles(seed_streams(seeds), np.arange(len(seeds)), self._scenario.draw_count)
        self._experts.tell(self._scenario.draw_many(uniforms))


def make_batch_policy(name: str, case: Case, count: int, threads: int, action_shape: tuple[int, ...]) -> BatchPolicy:
    """Make a policy of many worlds from its name.

    Args:
        name: as `player.make_policy` takes it, but neither ``random`` nor a user's own.
        case: where it is judged.
        count: of worlds.
        threads: that share the worlds.
        action_shape: of one world.

    Raises:
        InputError: an unknown name, a policy or an expert of single worlds, or a checkpoint that does not fit.
        PlanningError: the expert found no plan.
    """
    scenario, options = case.scenario, case.options or None
    check_batched(name)
    if name == "zero":
        return _Zero(count, action_shape)
    if name == "oracle":
        return _Oracle(make_oracle_batch(scenario, count, case.plan, options, threads), scenario)
    variants = list_variants(scenario)
    if name == "expert" or name in variants:
        variant = name if name in variants else None
        return _Expert(make_expert_batch(scenario, count, case.plan, variant, options, threads))
    # Imported here: playing without checkpoints needs no torch.
    from agents.actor import load_policy
    from agents.residual import check_domain, check_fit
    from agents.shared_actor import is_shared, load_choice

    directory = checkpoint_directory(name, variants)
    if is_shared(directory):
        return _Shared(load_choice(directory, scenario))
    actor, record = load_policy(directory)
    check_domain(directory, record, scenario)
    experts = make_expert_batch(scenario, count, case.plan, record.variant, options, threads)
    check_fit(directory, record, scenario, experts, case.plan)
    return _Expert(experts, actor.correction)


def check_batched(policy: str) -> None:
    """Raise if a policy plays in single worlds only.

    Raises:
        InputError: it does.
    """
    if policy == "random" or is_own(policy):
        raise InputError(
            f"policy '{policy}' plays one world at a time: leave it out, or leave out --batched (sweep: add --single)"
        )


def play_batched(cases: Sequence[Case], jobs: Sequence[Job], threads: int = 1) -> Generator[Outcome]:
    """Play episodes, those of one policy in one case together, and yield each outcome when its shard has finished.

    Args:
        cases: worlds to be judged in.
        jobs: episodes to be played.
        threads: that share the worlds.

    Yields:
        Row of an episode, see metrics.make_row, and None: there is no replay.

    Raises:
        InputError: a policy or a scenario that plays in single worlds only, or a checkpoint that does not fit.
        PlanningError: an expert found no plan.
    """
    together: dict[tuple[int, str], list[int]] = {}
    for job in jobs:
        together.setdefault((job.case, job.policy), []).append(job.seed)
    for (place, name), seeds in together.items():
        case, count = cases[place], min(SHARD, len(seeds))
        make_batch = find_part("impact_envs", case.scenario.domain, "BATCH")
        if make_batch is None:
            raise InputError(f"scenario '{case.scenario.name}' has no engine of many worlds: leave out --batched")
        batch = make_batch(case.scenario, count, None, threads=threads)
        policy = make_batch_policy(name, case, count, threads, batch.action_shape)
        try:
            for start in range(0, len(seeds), count):
                shard = seeds[start : start + count]
                filled = np.array(shard + shard[:1] * (count - len(shard)), np.int64)
                found = play_worlds(batch, policy, filled, len(shard))
                for k, seed in enumerate(shard):
                    key = {"scenario": case.scenario.name, "suite": case.suite, "policy": name, "seed": seed}
                    yield key | _make_row(found, k, case.scenario.domain), None
        finally:
            policy.close()
            batch.close()


@dataclass
class Ends:
    """What the episodes of N worlds came to, shape (N,) each; ``joint``: what was measured last, shape (N, size)."""

    robustness: np.ndarray
    success: np.ndarray
    steps: np.ndarray
    impacts: np.ndarray
    failure: np.ndarray
    joint: np.ndarray
    counts: dict[str, np.ndarray]


def play_worlds(
    batch: Any,
    policy: BatchPolicy,
    seeds: np.ndarray,
    played: int | None = None,
    is_stopped: Callable[[], bool] = lambda: False,
) -> Ends:
    """Play an episode in every world.

    Args:
        batch: of N worlds.
        policy: who acts in them.
        seeds: of the episodes, shape (N,).
        played: number of worlds, the first ones, whose episodes matter; the others wait at their start.
        is_stopped: asked at every control step; once it is true, episodes are left as they are.
    """
    count = len(seeds)
    output, everywhere = batch.make_output(agents=isinstance(policy, _Shared)), np.ones(count, bool)
    batch.seed(np.arange(count), seeds)
    policy.begin(seeds)
    batch.start(everywhere, output)
    ends = Ends(
        np.zeros(count), np.zeros(count, bool), np.zeros(count, np.int64), np.zeros(count, np.int64),
        np.full(count, "", object), np.zeros_like(output.joint), {},
    )  # fmt: skip
    running, ended = everywhere.copy(), ~everywhere
    played = count if played is None else played
    running[played:] = False
    # An expert that is shown its first observation again and again asks nobody for a new plan, which is dear.
    first = output.joint[~running]
    while running.any() and not is_stopped():
        if len(first):
            output.joint[played:] = first
        actions = policy.act(output).reshape(count, *batch.action_shape)
        # A world that failed is not stepped further: it starts anew, and what becomes of it is nobody's matter.
        batch.step(actions, output, ended if ended.any() else None)
        ends.impacts[running] += batch.impacts[running]
        over = batch.over & running
        ended = ended | batch.over
        if over.any():
            ends.joint[over] = output.joint[over]
            _keep_ends(ends, over, batch, policy)
            running &= ~over
    return ends


def _keep_ends(ends: Ends, over: np.ndarray, batch: Any, policy: BatchPolicy) -> None:
    """Keep what the episodes that are over, a mask of shape (N,), came to."""
    robustness, success = judge(batch.outcome)
    ends.robustness[over], ends.success[over] = robustness[over], success[over]
    ends.steps[over] = batch.steps[over]
    if (batch.failed & over).any():
        ends.failure[over] = batch.describe_failures()[over]
    for name, values in policy.count_events().items():
        kept = ends.counts.setdefault(name, np.zeros(len(over), np.int64))
        kept[over] = values[over]


def _make_row(ends: Ends, k: int, domain: str) -> dict[str, Any]:
    """Return world k's numbers by the metrics' names; None is what a batch does not know."""
    routine = find_part("planners", domain, "ROUTINE") or ()
    counts = {name: int(values[k]) for name, values in ends.counts.items()}
    fallbacks = Counter({name: count for name, count in counts.items() if count and name not in routine})
    return dict.fromkeys(metric.name for metric in METRICS) | {
        "success": bool(ends.success[k]),
        "robustness": float(ends.robustness[k]),
        "impacts": int(ends.impacts[k]),
        "steps": int(ends.steps[k]),
        "replans": counts.get("replans", 0),
        "fallbacks": fallbacks.total(),
        "fallback_kinds": json.dumps(dict(sorted(fallbacks.items()))),
        "failure": str(ends.failure[k]),
        "solve_ms": [],
    }
