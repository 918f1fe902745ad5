"""Boolean satisfaction of sampled traces: the robustness of truth, 1 where a predicate holds and -1 where not."""

from __future__ import annotations

import numpy as np

from impact_envs.errors import InputError
from impact_envs.stl.formula import Formula
from impact_envs.stl.predicate import Predicate, make_margins
from impact_envs.stl.robustness import Semantics
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

    def truth(predicate: Predicate, count: int) -> np.ndarray:
        mu = margins[predicate].compute(trace.first(predicate.signals(), count), np)
        return np.where(mu > 0 if predicate.strict else mu >= 0, 1.0, -1.0)

    return np.asarray(Semantics(trace.period, np, truth).rho(formula, 1)[..., 0] > 0)
