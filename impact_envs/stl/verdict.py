"""The verdict on an episode: robustness and success, decided here for one world and for many.

A robustness above zero is success, below zero failure. At exactly zero the predicates decide: ``in``, ``<=`` and ``>=``
hold there, ``not in``, ``<`` and ``>`` do not (``satisfied``). The online monitor remembers which by marking ties: a
margin of zero counts as TIE where its predicate holds and as -TIE where it does not, so that the order of all values,
and with it every least and greatest, stays what it was.
"""

from __future__ import annotations

from typing import Any

from impact_envs.compiled import inlined
from impact_envs.stl.margin import TIE


@inlined
def settle_tie(value: float) -> float:
    """Return a robustness, a marked tie as the zero that it is."""
    return 0.0 if -TIE <= value <= TIE else value


@inlined
def compute_outcome(low: float, high: float, limit: float) -> float:
    """Return the robustness that an episode would have if it ended now, ties marked.

    Args:
        low, high: ends of the interval still possible, ties marked.
        limit: of what is undecided; its lower end may be -inf.
    """
    return low if low == high or low > -limit else -limit


def judge(outcome: Any) -> tuple[Any, Any]:
    """Return robustness and success of an episode that is over.

    Args:
        outcome: from ``compute_outcome``: a number, an array or a tensor.
    """
    return outcome * (abs(outcome) > TIE) + 0.0, outcome > 0
