"""Boolean satisfaction of sampled traces, by a recursion of its own beside the robustness."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import numpy as np

from impact_envs.errors import InputError
from impact_envs.stl.formula import Always, And, Formula, Implies, Not, Or, Temporal, Until
from impact_envs.stl.margin import make_margins
from impact_envs.stl.predicate import Predicate
from impact_envs.stl.trace import Trace, check_reach, is_tensor


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

    def holds(predicate: Predicate, count: int) -> np.ndarray:
        mu = margins[predicate].compute(trace.first(predicate.signals(), count), np)
        return np.asarray(mu > 0 if predicate.strict else mu >= 0)

    return _holds(formula, 1, trace.period, holds)[..., 0]


def _holds(formula: Formula, count: int, period: float, holds: Callable[[Predicate, int], np.ndarray]) -> np.ndarray:
    """Return the truth value at the first ``count`` samples, by counting true samples in windows."""
    match formula:
        case Predicate():
            return holds(formula, count)
        case Not(child):
            return ~_holds(child, count, period, holds)
        case And(operands):
            return reduce(np.logical_and, [_holds(part, count, period, holds) for part in operands])
        case Or(operands):
            return reduce(np.logical_or, [_holds(part, count, period, holds) for part in operands])
        case Implies(left, right):
            return ~_holds(left, count, period, holds) | _holds(right, count, period, holds)
        case Temporal():
            first, last = formula.window(period)
            children = [_holds(child, count + last, period, holds) for child in formula.children]
            start = np.arange(count) + first
            stop = np.broadcast_to(start + last - first + 1, (*children[-1].shape[:-1], count))
            if isinstance(formula, Until):
                stop = np.minimum(stop, _first_false(children[0])[..., :count])
            if isinstance(formula, Always):
                return ~_any(~children[0], start, stop)
            return _any(children[-1], start, stop)
    raise TypeError(f"{type(formula).__name__} is not a formula")


def _any(truth: np.ndarray, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """Return whether truth[start : stop] has a true sample."""
    shape = (*np.broadcast_shapes(truth.shape[:-1], stop.shape[:-1]), truth.shape[-1])
    counts = np.zeros((*shape[:-1], shape[-1] + 1), dtype=np.int64)
    np.cumsum(np.broadcast_to(truth, shape), axis=-1, out=counts[..., 1:])
    begin = np.broadcast_to(start, (*shape[:-1], start.shape[-1]))
    end = np.broadcast_to(stop, begin.shape)
    counted = np.take_along_axis(counts, end, -1) - np.take_along_axis(counts, begin, -1)
    return counted > 0


def _first_false(truth: np.ndarray) -> np.ndarray:
    """Return the index of the first false sample from each sample on, the length where there is none."""
    index = np.where(truth, truth.shape[-1], np.arange(truth.shape[-1]))
    return np.flip(np.minimum.accumulate(np.flip(index, -1), -1), -1)
