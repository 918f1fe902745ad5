"""Two policies on the same seeds, until tests decide which one is better."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from impact_envs.errors import InputError
from train.evaluation.batch_player import SHARD, check_batched, play_batched
from train.evaluation.case import Case
from train.evaluation.evaluate import check_request, make_plans
from train.evaluation.player import Job
from train.evaluation.sequential import (
    RobustnessTest,
    SequentialOptions,
    SuccessTest,
    Verdict,
    combine_verdicts,
)


@dataclass(frozen=True)
class Duel:
    """What came of it.

    Attributes:
        policies: a and b.
        verdict: who is better, "equal", or None: the seeds were used up before.
        success, robustness: the tests.
        played: pairs of episodes, those of the last shard behind the decision among them.
        allowed: pairs of episodes at most.
        options: of the tests.
    """

    policies: tuple[str, str]
    verdict: Verdict | None
    success: SuccessTest
    robustness: RobustnessTest
    played: int
    allowed: int
    options: SequentialOptions

    def to_dict(self) -> dict[str, Any]:
        """Return the result as it is printed."""
        pairs = max(self.success.pairs, self.robustness.pairs)
        fixed = [test.count_fixed(self.options.error) for test in (self.success, self.robustness)]
        needed = self._find_needed(fixed)
        return {
            "a": self.policies[0],
            "b": self.policies[1],
            "decision": _say(self.verdict, self.policies),
            "pairs": pairs,
            "pairs_played": self.played,
            "fixed_plan_pairs": needed,
            # No plan plays more than is allowed, so that no more than the rest of it can be saved.
            "episodes_saved": None if needed is None else 2 * round(min(needed, self.allowed) - self.played),
            "tests": [
                {
                    "test": "success of discordant pairs",
                    "decision": _say(self.success.verdict, self.policies),
                    "pairs": self.success.pairs,
                    "found": f"a alone {self.success.wins}, b alone {self.success.losses}",
                    "fixed_plan_pairs": fixed[0],
                },
                {
                    "test": "mean difference of robustness",
                    "decision": _say(self.robustness.verdict, self.policies),
                    "pairs": self.robustness.pairs,
                    "found": "{:.4f} in [{:.4f}, {:.4f}]".format(self.robustness.mean, *self.robustness.interval),
                    "fixed_plan_pairs": fixed[1],
                },
            ],
        }

    def _find_needed(self, fixed: list[float | None]) -> float | None:
        """Return the pairs of the fixed plan of the test that decided; of both if they are equal."""
        verdicts = (self.success.verdict, self.robustness.verdict)
        if self.verdict == "equal":
            known = [count for count in fixed if count is not None]
            return max(known) if len(known) == len(fixed) else None
        for verdict, count in zip(verdicts, fixed, strict=True):
            if verdict is not None and verdict == self.verdict:
                return count
        return None


def play_until_decided(
    case: Case,
    policies: tuple[str, str],
    most: int,
    seed: int,
    options: SequentialOptions,
    threads: int = 1,
) -> Duel:
    """Play pairs of episodes until one policy is better, or both tests say that none is.

    Args:
        case: world to be judged in.
        policies: a and b, as player.make_policy takes them; those that play many worlds at once.
        most: pairs at most.
        seed: first seed; the others follow.
        options: what counts as a difference, and how sure the answer must be.
        threads: that share the worlds.

    Raises:
        InputError: one line naming what is unknown or does not fit.
        PlanningError: the expert found no plan.
    """
    _check_options(options)
    check_request([case], policies, most, seed, threads)
    for policy in policies:
        check_batched(policy)
    jobs = [[Job(0, policy, number) for number in range(seed, seed + most)] for policy in policies]
    cases = make_plans([case], [row[0] for row in jobs])
    success, robustness = SuccessTest(options), RobustnessTest(options)
    verdict, played = None, 0
    with (
        closing(play_batched(cases, jobs[0], threads)) as first,
        closing(play_batched(cases, jobs[1], threads)) as last,
    ):
        for a, b in _pair_rows(first, last):
            played += 1
            success.update(a["success"], b["success"])
            robustness.update(a["robustness"], b["robustness"])
            verdict = combine_verdicts(success.verdict, robustness.verdict)
            if verdict is not None:
                break
    whole = min(most, -(-played // SHARD) * SHARD)
    return Duel(policies, verdict, success, robustness, whole, most, options)


def _pair_rows(first: Any, last: Any) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    for (a, _), (b, _) in zip(first, last, strict=True):
        assert a["seed"] == b["seed"]
        yield a, b


def _check_options(options: SequentialOptions) -> None:
    if not 0.0 < options.limit < math.inf:
        raise InputError(f"--limit {options.limit:g}: must be above 0 and finite")
    for name, value, low, high, end in (
        ("--error", options.error, 0.0, 1.0, "1"),
        ("--least-share", options.least_share, 0.5, 1.0, "1"),
        ("--least-difference", options.least_difference, 0.0, options.limit, f"--limit {options.limit:g}"),
    ):
        if not low < value < high:
            raise InputError(f"{name} {value:g}: must be above {low:g} and below {end}")


def _say(verdict: Verdict | None, policies: tuple[str, str]) -> str:
    if verdict is None:
        return "not decided"
    return "no difference that matters" if verdict == "equal" else f"{policies['ab'.index(verdict)]} is better"
