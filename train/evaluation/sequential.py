"""Tests that may be looked at after every pair of episodes, and end as soon as they can decide.

Two policies play the same seeds. Success is tested on the discordant pairs, in which one succeeds and the other does
not; the mean difference of robustness by a confidence sequence, which holds at all times at once. Each says "a" or
"b" where that policy is better, "equal" where neither is by more than the least difference asked about, and None until
it knows. The probability of a wrong word is at most the error, whenever one looks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

import numpy as np

Verdict = Literal["a", "b", "equal"]


@dataclass(frozen=True)
class SequentialOptions:
    """Say what counts as a difference, and how sure the answer must be.

    Attributes:
        error: probability of any wrong verdict; half of it goes to either test.
        least_share: of the discordant pairs that the better policy wins at least, where success differs enough to
            matter: 0.7 is 7 of 10.
        least_difference: mean difference of robustness that matters [m, or the unit of the scenario's robustness].
        limit: differences are cut here, so that their mean is bounded: a lost object is no worse than this [m].
        points: of the grid of mean differences from -limit to limit, odd, so that zero is one of them.
    """

    error: float = 0.05
    least_share: float = 0.7
    least_difference: float = 0.02
    limit: float = 0.5
    points: int = 401


class SuccessTest:
    """Wald's sequential probability ratio tests of the share p of discordant pairs that ``a`` wins.

    p = 1/2 is tested against p = least_share and against p = 1 - least_share. The likelihood ratio of either exceeds
    1 / level with at most the probability level where p = 1/2 (Ville), and falls below level with at most that
    probability where its hypothesis is true.

    Args:
        options: see SequentialOptions.

    Source: Wald, "Sequential tests of statistical hypotheses" (1945); Sobel & Wald (1949) for three decisions.
    """

    def __init__(self, options: SequentialOptions) -> None:
        # Half of the error is this test's, and half of that is each side's.
        self._boundary = math.log(4.0 / options.error)
        self._win, self._loss = math.log(2.0 * options.least_share), math.log(2.0 * (1.0 - options.least_share))
        self._share = options.least_share
        self._rejected = [False, False]
        self.pairs = self.wins = self.losses = 0
        self.verdict: Verdict | None = None

    def update(self, success_a: bool, success_b: bool) -> None:
        """Take a pair of episodes of the same seed; a verdict stays."""
        if self.verdict is not None:
            return
        self.pairs += 1
        self.wins += success_a and not success_b
        self.losses += success_b and not success_a
        for side, (won, lost) in enumerate(((self.wins, self.losses), (self.losses, self.wins))):
            ratio = won * self._win + lost * self._loss
            if ratio >= self._boundary and not self._rejected[side]:
                self.verdict = ("a", "b")[side]
                return
            self._rejected[side] |= ratio <= -self._boundary
        if all(self._rejected):
            self.verdict = "equal"

    def count_fixed(self, error: float) -> float | None:
        """Return how many pairs a test of fixed size takes for the same least share and errors; None: not known.

        McNemar's test with as many discordant pairs among all as there were so far.

        Source: Connor, "Sample size for testing differences in proportions for the paired-sample design" (1987).
        """
        discordant, p = self.wins + self.losses, self._share
        if discordant == 0:
            return None
        z = NormalDist().inv_cdf(1.0 - error / 4.0)
        needed = (z * 0.5 + z * math.sqrt(p * (1.0 - p))) ** 2 / (p - 0.5) ** 2
        return float(needed * self.pairs / discordant)


class RobustnessTest:
    """A confidence sequence of the mean cut difference of robustness, by betting against every mean.

    For each mean m of a grid one gambler bets that the next difference is above m, another that it is below:
    prod(1 +- lambda_t (x_t - m)). If m is the mean both capitals are martingales, and each reaches 2 / level with at
    most the probability level / 2 (Ville). The means against which neither ever did form intervals that hold at all
    times at once.

    Args:
        options: see SequentialOptions.

    Source: Waudby-Smith & Ramdas, "Estimating means of bounded random variables by betting" (2023), Eqs. 24-26.
    """

    def __init__(self, options: SequentialOptions) -> None:
        self._limit, self._least, self._level = options.limit, options.least_difference, options.error / 2.0
        self._means = np.linspace(0.0, 1.0, options.points) if options.points > 1 else np.array([0.5])
        self._above, self._below = np.zeros(options.points), np.zeros(options.points)  # logarithms of the capitals
        self._lower, self._higher = np.zeros(options.points, bool), np.zeros(options.points, bool)  # than the mean
        self._sum, self._squares = 0.5, 0.25  # one imagined difference, so that the first bets are defined
        self.pairs = 0
        self.verdict: Verdict | None = None

    @property
    def mean(self) -> float:
        """Return the mean cut difference [m]."""
        return 2.0 * self._limit * ((self._sum - 0.5) / max(self.pairs, 1) - 0.5) if self.pairs else 0.0

    @property
    def deviation(self) -> float:
        """Return the standard deviation of the cut differences, a little above it after few pairs [m]."""
        return 2.0 * self._limit * math.sqrt(self._squares / (self.pairs + 1))

    @property
    def interval(self) -> tuple[float, float]:
        """Return the interval of the mean difference [m]; means at its ends are excluded."""
        count = len(self._means)
        low = int(np.argmin(np.append(self._lower, False))) - 1
        high = count - int(np.argmin(np.append(self._higher[::-1], False)))
        ends = self._means[max(low, 0)], self._means[min(high, count - 1)]
        return tuple(float(2.0 * self._limit * (end - 0.5)) for end in ends)  # type: ignore[return-value]

    def update(self, robustness_a: float, robustness_b: float) -> None:
        """Take a pair of episodes of the same seed; a verdict stays."""
        if self.verdict is not None:
            return
        difference = float(np.clip(robustness_a - robustness_b, -self._limit, self._limit))
        x = 0.5 + difference / (2.0 * self._limit)
        self.pairs += 1
        t, variance = self.pairs, self._squares / self.pairs
        bet = math.sqrt(2.0 * math.log(2.0 / self._level) / (variance * t * math.log(t + 1.0)))
        gap = x - self._means
        with np.errstate(divide="ignore"):  # no bound at the ends of the grid
            self._above += np.log1p(np.minimum(bet, 0.5 / self._means) * gap)
            self._below += np.log1p(-np.minimum(bet, 0.5 / (1.0 - self._means)) * gap)
        enough = math.log(2.0 / self._level)
        self._lower |= self._above >= enough
        self._higher |= self._below >= enough
        self._sum += x
        self._squares += (x - self._sum / (t + 1)) ** 2
        self._decide()

    def _decide(self) -> None:
        middle = len(self._means) // 2
        low, high = self.interval
        if self._lower[middle] or self._higher[middle]:
            self.verdict = "a" if self._lower[middle] else "b"
        elif -self._least < low and high < self._least:
            self.verdict = "equal"

    def count_fixed(self, error: float) -> float:
        """Return how many pairs a test of fixed size takes for the same least difference and errors.

        ((z + z) s / difference)^2 of the paired z test, s the deviation so far.
        """
        return float((2.0 * NormalDist().inv_cdf(1.0 - error / 4.0) * self.deviation / self._least) ** 2)


def combine_verdicts(success: Verdict | None, robustness: Verdict | None) -> Verdict | None:
    """Return what two tests of the same pairs say together.

    A policy that is better in one of them is better; they are equal if both say so; if the tests disagree about who
    is better, success decides.
    """
    for verdict in (success, robustness):
        if verdict in ("a", "b"):
            return verdict
    return "equal" if success == robustness == "equal" else None
