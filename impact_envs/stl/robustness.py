"""Robustness and satisfaction of sampled traces, for numpy and torch with leading batch dimensions.

An interval [a, b] at sample k holds the samples k + ceil(a / period) to k + floor(b / period), both included.
Nothing is assumed after the trace's end: it must reach as far as the formula looks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from impact_envs.errors import InputError
from impact_envs.stl.formula import Formula
from impact_envs.stl.margin import Array
from impact_envs.stl.operator import Always, And, Eventually, Not, Or, Until
from impact_envs.stl.predicate import Predicate, make_margins
from impact_envs.stl.trace import Trace, check_reach, is_tensor


def robustness(formula: Formula, trace: Trace) -> Array:
    """Compute how far the formula is from changing its truth value at time 0.

    rho > 0: satisfied; rho < 0: violated; rho = 0 says nothing (see ``satisfied``). Differentiable for torch.
    NaN in a signal gives NaN.

    Args:
        formula: specification.
        trace: signals, shapes (..., T).

    Returns:
        rho, shape (...), in the unit of the predicates [m for areas and distances, m/s for speeds].

    Raises:
        FormulaError: unknown names, a trace shorter than the formula looks, or an interval without a sample.

    Source: Verhagen & Tumova, Eq. 2.
    """
    return _rho(formula, trace, 1)[..., 0]


def robustness_signal(formula: Formula, trace: Trace) -> Array:
    """Compute the robustness at every time at which the trace reaches as far as the formula looks.

    Args:
        formula: specification.
        trace: signals, shapes (..., T).

    Returns:
        rho, shape (..., T - R), R the formula's reach in samples.

    Raises:
        FormulaError: as for ``robustness``.
    """
    return _rho(formula, trace, trace.length - formula.reach(trace.period))


def satisfied(formula: Formula, trace: Trace) -> np.ndarray:
    """Decide whether the formula holds at time 0, by Boolean semantics from the predicates up.

    Predicates are closed as written: ``in``, ``<=`` and ``>=`` hold at a robustness of exactly zero, ``not
    in``, ``<`` and ``>`` do not.

    Args:
        formula: specification.
        trace: signals, shapes (..., T).

    Returns:
        Truth values, shape (...), numpy whatever the trace is.

    Raises:
        FormulaError: as for ``robustness``.
        InputError: a signal contains NaN.

    Source: Verhagen & Tumova, Definition 1.
    """
    if any(is_tensor(value) for value in trace.signals.values()):
        arrays = {name: value.detach().cpu().numpy() for name, value in trace.signals.items()}
        trace = Trace(arrays, trace.period, trace.areas, trace.bodies)
    formula = formula.expand(trace.bodies)
    check_reach(formula, trace)
    margins = make_margins(formula, trace.areas)
    for name in formula.signals():
        if np.isnan(trace.signals[name]).any():
            raise InputError(f"trace: signal '{name}' contains NaN")

    def truth(predicate: Predicate, count: int) -> np.ndarray:
        mu = margins[predicate].compute(trace.first(predicate.signals(), count), np)
        return np.where(mu > 0 if predicate.strict else mu >= 0, 1.0, -1.0)

    return np.asarray(Semantics(trace.period, np, truth).rho(formula, 1)[..., 0] > 0)


def _rho(formula: Formula, trace: Trace, count: int) -> Array:
    formula = formula.expand(trace.bodies)
    check_reach(formula, trace)
    margins = make_margins(formula, trace.areas)
    xp: Any = np
    if any(is_tensor(value) for value in trace.signals.values()):
        import torch

        xp = torch

    def mu(predicate: Predicate, count: int) -> Array:
        return margins[predicate].compute(trace.first(predicate.signals(), count), xp)

    return Semantics(trace.period, xp, mu).rho(formula, count)


@dataclass(frozen=True)
class Semantics:
    """Quantitative semantics over arrays (..., T).

    Args:
        period: between samples [s].
        xp: the module the arrays belong to, numpy or torch.
        mu: robustness of a predicate at its first so many samples.
    """

    period: float
    xp: Any
    mu: Callable[[Predicate, int], Array]

    def rho(self, formula: Formula, count: int) -> Array:
        """Compute robustness at the first ``count`` samples.

        Args:
            formula: specification without ``all``.
            count: number of samples.

        Returns:
            rho, shape (..., count).

        Raises:
            FormulaError: an operator that is not known here.
        """
        match formula:
            case Predicate():
                return self.mu(formula, count)
            case Not(child):
                return -self.rho(child, count)
            case And(operands):
                return reduce(self.xp.minimum, [self.rho(operand, count) for operand in operands])
            case Or(operands):
                return reduce(self.xp.maximum, [self.rho(operand, count) for operand in operands])
            case Eventually(_, child):
                first, last = formula.window(self.period)
                return _sliding_max(self.rho(child, count + last)[..., first:], last - first + 1, self.xp)
            case Always(_, child):
                first, last = formula.window(self.period)
                return -_sliding_max(-self.rho(child, count + last)[..., first:], last - first + 1, self.xp)
            case Until(_, left, right):
                first, last = formula.window(self.period)
                return _until(self.rho(left, count + last), self.rho(right, count + last), first, last, self.xp)
        return self.rho(formula.define(), count)


def _sliding_max(values: Array, width: int, xp: Any) -> Array:
    """Return out[k] = max values[k : k + width], linear in the trace's length whatever the width.

    A window covers the end of one block and the start of the next: it is the greater of a running maximum to
    the end of the former and one from the start of the latter. Source: van Herk 1992, Gil & Werman 1993.
    """
    count = values.shape[-1] - width + 1
    if width == 1:
        return values
    if count == 1:
        return xp.amax(values, -1, keepdims=True)
    blocks = -(-values.shape[-1] // width)
    # The last block is filled up with values that no window reads.
    filling = xp.broadcast_to(values[..., -1:], (*values.shape[:-1], blocks * width - values.shape[-1]))
    grid = xp.concatenate((values, filling), -1).reshape(*values.shape[:-1], blocks, width)
    starts = _running_max(grid, xp).reshape(*values.shape[:-1], blocks * width)
    ends = xp.flip(_running_max(xp.flip(grid, (-1,)), xp), (-1,)).reshape(starts.shape)
    return xp.maximum(ends[..., :count], starts[..., width - 1 : width - 1 + count])


def _running_max(values: Array, xp: Any) -> Array:
    return np.maximum.accumulate(values, -1) if xp is np else xp.cummax(values, -1).values


def _until(left: Array, right: Array, first: int, last: int, xp: Any) -> Array:
    """Return rho of left U[first,last] right, both given for ``last`` samples more than wanted.

    p U[a,b] q = G[0,a] p and F[a,b] q and F[a,a] (p U q) with an unbounded until: if q comes within b, and p
    holds until a later q, then p also holds until the earlier one. Source: Donze, Ferrere & Maler, CAV 2013.
    """
    held = -_sliding_max(-left[..., : left.shape[-1] - last + first], first + 1, xp)
    comes = _sliding_max(right[..., first:], last - first + 1, xp)
    unbounded = _unbounded_until(left[..., first:], right[..., first:], xp)[..., : comes.shape[-1]]
    return xp.minimum(xp.minimum(held, comes), unbounded)


def _unbounded_until(left: Array, right: Array, xp: Any) -> Array:
    """Return u[k] = min(left[k], max(right[k], u[k + 1])), u = -inf after the end, in log2(T) steps.

    Each step clamps u[k + 1] to [min(left, right), left]; clamps compose to clamps, so that composing
    neighbours, then neighbours of neighbours and so on (a parallel prefix scan) leaves the clamp from the end
    to every k. On -inf it gives its lower end.
    """
    low, stride = xp.minimum(left, right), 1
    high = xp.broadcast_to(left, low.shape)
    while stride < left.shape[-1]:
        near_low, near_high = low[..., :-stride], high[..., :-stride]
        low, high = (
            xp.concatenate((xp.minimum(near_high, xp.maximum(near_low, far[..., stride:])), far[..., -stride:]), -1)
            for far in (low, high)
        )
        stride *= 2
    return low
