"""Which numbers no expert takes for a measurement: NaN, infinity, and what is so great that its square overflows."""

from __future__ import annotations

from collections.abc import Iterable

LARGEST = 1e9  # of any measured quantity in SI units; its eighth power is still far from the greatest float


def is_measurement(values: Iterable[float]) -> bool:
    """Return whether numbers can be measured ones.

    Args:
        values: any units of SI.
    """
    return sum(map(abs, values)) < LARGEST
