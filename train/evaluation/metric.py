"""What a metric is: how it is computed from an episode, summed up over episodes, and shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, FiniteFloat

if TYPE_CHECKING:
    import pandas as pd

UNKNOWN = "–"
Pair = tuple[FiniteFloat, FiniteFloat]


class SolveTimes(BaseModel):
    """Percentiles of solve times [ms]; None where nothing was solved."""

    p50: FiniteFloat | None
    p99: FiniteFloat | None
    max: FiniteFloat | None


@dataclass(frozen=True)
class Aggregate:
    """A number that sums up a metric over the episodes of one scenario, suite and policy.

    Attributes:
        key: in the summary.
        compute: from the metric's column.
        kind: type as it is read back from a file.
        title: of its column in tables, without the unit; it is not shown without one.
        write: text of its cell, from the summary's row.
        cell: how the text is set.
        bar: share, low and high end of its interval, drawn before the text; from the summary's row.
        hint: text shown on hover, from the summary's row.
        detail: shown in reports only, not on terminals.
    """

    key: str
    compute: Callable[[pd.Series], Any]
    kind: Any = FiniteFloat
    title: str = ""
    write: Callable[[Mapping[str, Any]], str] = lambda row: ""
    cell: Literal["number", "interval", "text"] = "number"
    bar: Callable[[Mapping[str, Any]], tuple[float, float, float]] | None = None
    hint: Callable[[Mapping[str, Any]], str] | None = None
    detail: bool = False


@dataclass(frozen=True)
class Metric:
    """A number of an episode.

    Attributes:
        name: of its column in an episode's row.
        unit: of the number.
        compute: from an episode and its scenario, and where `of_plan` from the plan that was followed, None without
            one; a JSON value, None where it is not applicable.
        aggregates: what sums it up.
        compare: keys that sum up the paired difference of two policies, from its columns a and b by seed.
        required: whether every evaluation on disk has it; a metric added later is not required.
        of_plan: whether it also needs the plan.
        kind: type of the number as it is read back from a file.
    """

    name: str
    unit: str
    compute: Callable[..., Any]
    aggregates: tuple[Aggregate, ...] = ()
    compare: Callable[[pd.Series, pd.Series], dict[str, Any]] | None = None
    required: bool = False
    of_plan: bool = False
    kind: Any = FiniteFloat | None


def mean(key: str, title: str = "", decimals: int = 2) -> Aggregate:
    """Aggregate by the mean."""
    return _average(key, lambda values: values.mean(), title, decimals)


def median(key: str, title: str = "", decimals: int = 2) -> Aggregate:
    """Aggregate by the median."""
    return _average(key, lambda values: values.median(), title, decimals)


def _average(key: str, compute: Callable[[pd.Series], Any], title: str, decimals: int) -> Aggregate:
    def average(values: pd.Series) -> float | None:
        known = values.dropna()
        return float(compute(known)) if len(known) else None

    return Aggregate(key, average, FiniteFloat | None, title, lambda row: f"{row[key]:.{decimals}f}")


def signed(value: float) -> str:
    """Return text with three decimals, the sign and a true minus, such as "+0.250", "−1.300" or "0.000"."""
    text = f"{value:+.3f}".replace("-", "−")
    return "0.000" if text.strip("+−") == "0.000" else text


def write_interval(ends: Sequence[float]) -> str:
    """Return text such as "[−0.010, +0.200]"."""
    return f"[{signed(ends[0])}, {signed(ends[1])}]"
