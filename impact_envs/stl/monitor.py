"""Online monitor: the interval of robustness still possible after the samples so far.

Source: Deshmukh, Donze, Ghosh, Jin, Juniwal & Seshia, Robust online monitoring of signal temporal logic,
Formal Methods in System Design 51 (2017): robust satisfaction intervals (RoSI).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from impact_envs.errors import InputError, choices
from impact_envs.stl.formula import Formula
from impact_envs.stl.margin import AreaLike, Range, make_margins
from impact_envs.stl.rosi import make_node


class Monitor:
    """Follow a formula's robustness at time 0 sample by sample.

    The interval holds the final robustness as long as signals stay within the bounds; its lower end never
    decreases, its upper end never increases; after the last sample the formula looks at both ends equal
    ``robustness`` of the trace to the last bit. A step takes time independent of the horizon for Boolean
    combinations of temporal operators over predicates; temporal operators inside temporal operators are
    evaluated anew over their horizon at every step.

    Args:
        formula: specification.
        period: between samples [s].
        areas: regions and obstacles by name.
        bodies: what ``all`` stands for.
        bounds: signals to intervals known beforehand, for example the world box; samples to come count as
            anything within. A signal without bounds may become anything.

    Raises:
        FormulaError: an unknown area, or an interval without a sample.
        InputError: a period that is not positive, or bounds that are empty.
    """

    def __init__(
        self,
        formula: Formula,
        period: float,
        areas: Mapping[str, AreaLike],
        bodies: tuple[str, ...],
        bounds: Mapping[str, Range] | None = None,
    ) -> None:
        if not 0 < period < math.inf:
            raise InputError(f"monitor: period {period} s must be finite and positive")
        for name, (low, high) in (bounds or {}).items():
            if not low <= high:
                raise InputError(f"monitor: bounds [{low:g}, {high:g}] of signal '{name}' are empty")
        self.formula = formula.expand(bodies)
        self.period = period
        self.reach = self.formula.reach(period)
        self._bounds = dict(bounds or {})
        self._margins = make_margins(self.formula, areas)
        self._names = self.formula.signals()
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self.count = 0
        self._root = make_node(self.formula, self.period, self._margins, self._bounds)

    @property
    def interval(self) -> Range:
        """Return the interval of robustness still possible; at first what the bounds alone allow."""
        return self._root.interval

    @property
    def final(self) -> bool:
        """Return whether every sample the formula looks at has come; further samples change nothing."""
        return self.count > self.reach

    @property
    def verdict(self) -> bool | None:
        """Return the truth value as soon as it is decided.

        True when the lower end is above zero, False when the upper end is below. None before that, and for
        good if the final robustness is exactly zero, which says nothing about satisfaction (``satisfied``
        does).
        """
        low, high = self._root.interval
        return True if low > 0 else False if high < 0 else None

    def update(self, sample: Mapping[str, float]) -> Range:
        """Take the next sample; the first one is at time 0.

        Args:
            sample: signals to values; signals the formula does not name are ignored.

        Returns:
            Lower and upper end of the robustness still possible.

        Raises:
            InputError: a signal is missing or not finite.
        """
        if self.count > self.reach:
            return self._root.interval
        try:
            values = {name: float(sample[name]) for name in self._names}
        except KeyError as error:
            name = error.args[0]
            raise InputError(f"sample: signal '{name}' is missing; {choices(name, sample)}") from None
        if not math.isfinite(sum(values.values())):
            name = next((n for n, value in values.items() if not math.isfinite(value)), self._names[0])
            raise InputError(f"sample: signal '{name}' is {values[name]}; it must be finite")
        self._root.update(self.count, values)
        self.count += 1
        return self._root.interval
