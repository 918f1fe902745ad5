"""A sampled trace: the signals a formula is judged on."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from impact_envs.errors import FormulaError, InputError, choices
from impact_envs.stl.formula import Formula
from impact_envs.stl.margin import AreaLike, Array


@dataclass(frozen=True)
class Trace:
    """Sampled signals and the areas they are judged against.

    Args:
        signals: ``pop.x`` and the like to arrays, shapes (..., T) that broadcast; all numpy or all torch.
        period: between samples [s].
        areas: regions and obstacles by name.
        bodies: what ``all`` stands for.

    Raises:
        InputError: signals of unequal length or kind, or a period that is not positive.
    """

    signals: Mapping[str, Array]
    period: float
    areas: Mapping[str, AreaLike] = field(default_factory=dict)
    bodies: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not 0 < self.period < math.inf:
            raise InputError(f"trace: period {self.period} s must be finite and positive")
        tensors = [is_tensor(value) for value in self.signals.values()]
        if len(set(tensors)) == 2:
            raise InputError("trace: some signals are torch tensors and some are not")
        if not any(tensors):
            object.__setattr__(self, "signals", {n: np.asarray(v) for n, v in self.signals.items()})
        lengths = {name: value.shape[-1] if value.ndim else 0 for name, value in self.signals.items()}
        if len(set(lengths.values())) != 1 or 0 in lengths.values():
            found = ", ".join(f"{name}: {length}" for name, length in lengths.items())
            raise InputError(f"trace: signals need one common number of samples, got {found or 'none'}")

    @property
    def length(self) -> int:
        """Return the number of samples."""
        return int(next(iter(self.signals.values())).shape[-1])

    def first(self, names: Iterable[str], count: int) -> dict[str, Array]:
        """Return views of the first ``count`` samples of some signals.

        Args:
            names: signals.
            count: number of samples.
        """
        return {name: self.signals[name][..., :count] for name in names}


def check_reach(formula: Formula, trace: Trace) -> None:
    """Check that a trace has every sample and every signal the formula looks at.

    Args:
        formula: specification without ``all``.
        trace: signals, shapes (..., T).

    Raises:
        FormulaError: too short a trace, an unknown signal, or an interval without a sample.
    """
    reach = formula.reach(trace.period)
    if trace.length <= reach:
        raise FormulaError(
            f"the formula looks {formula.horizon:g} s ahead ({reach + 1} samples at {trace.period:g} s), "
            f"the trace is {(trace.length - 1) * trace.period:g} s long ({trace.length} samples)"
        )
    for name in formula.signals():
        if name not in trace.signals:
            raise FormulaError(f"signal '{name}' is not in the trace; {choices(name, trace.signals)}")


def is_tensor(value: Any) -> bool:
    """Return whether a value is a torch tensor, without importing torch.

    Args:
        value: anything.
    """
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)
