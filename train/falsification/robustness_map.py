"""A picture of a search: robustness over the two disturbances that explain most of it, and where failures are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from impact_envs.errors import InputError
from impact_envs.picture import drawing
from impact_envs.picture.unit import label_robustness
from impact_envs.stl import Formula
from train.falsification.arena import Arena, Played
from train.falsification.counterexample import Counterexample
from train.pictures.color import hex_color

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BINS = 8  # of a disturbance's range, whose mean robustness is compared
CELLS = 12  # hexagons along an axis


def compute_importance(played: Played) -> np.ndarray:
    """Return which share of the robustness' variance the mean over bins of each disturbance explains, shape (names,).

    The correlation ratio: a disturbance that hurts at both ends of its range counts, too.

    Args:
        played: episodes of the search.
    """
    spread, mean = float(np.var(played.robustness)), float(np.mean(played.robustness))
    if spread == 0.0:
        return np.zeros(played.places.shape[1])
    shares = []
    for column in np.clip(played.places, 0.0, 1.0).T:
        bins = np.minimum((BINS * column).astype(int), BINS - 1)
        counts = np.bincount(bins, minlength=BINS)
        means = np.bincount(bins, played.robustness, BINS) / np.maximum(counts, 1)
        shares.append(float(np.sum(counts * (means - mean) ** 2)) / (len(bins) * spread))
    return np.array(shares)


def draw_map(arena: Arena, played: Played, found: Sequence[Counterexample], title: str, formula: Formula) -> Figure:
    """Draw the mean robustness over the two most important disturbances, failures, and numbered counterexamples.

    Args:
        arena: in which was played.
        played: episodes of the search.
        found: counterexamples, in the order of their suites.
        title: of the picture.
        formula: whose robustness it is.

    Raises:
        InputError: the suite draws less than two numbers from ranges.
    """
    from matplotlib.colors import TwoSlopeNorm
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    check_map(arena)
    first, second = np.argsort(-compute_importance(played), kind="stable")[:2]
    keys = [f"true.{arena.names[number]}" for number in (first, second)]
    listed = [arena.worlds.list_values(places) for places in played.places]
    x, y = (np.array([values[key] for values in listed]) for key in keys)
    figure = Figure(figsize=(7.0, 5.2), layout="constrained")
    axes = figure.add_subplot()
    # Few episodes fail by far; their colour may be the same as that of others that fail clearly.
    most = max(float(np.quantile(np.abs(played.robustness), 0.9)), 1e-6)
    cells = axes.hexbin(
        x, y, played.robustness, gridsize=CELLS, reduce_C_function=np.mean, cmap="RdBu",
        norm=TwoSlopeNorm(0.0, -most, most), linewidths=0.2,
    )  # fmt: skip
    ink = hex_color(drawing.INK)
    failed = ~played.success
    axes.plot(x[failed], y[failed], ".", color=ink, ms=2, label=f"{int(failed.sum())} failures")
    numbers: dict[tuple[float, float], list[str]] = {}
    for number, one in enumerate(found, start=1):
        numbers.setdefault((one.values[keys[0]], one.values[keys[1]]), []).append(str(number))
    for count, (place, names) in enumerate(numbers.items()):
        axes.plot(
            *place, "*", color=ink, ms=13, mfc="white", label="counterexamples, as mild as they fail" * (count == 0)
        )
        axes.annotate(", ".join(names), place, (6, 4), textcoords="offset points", color=ink)
    for axis, values in ((axes.xaxis, x), (axes.yaxis, y)):
        if (values == np.round(values)).all():
            axis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel=keys[0].removeprefix("true."), ylabel=keys[1].removeprefix("true."))
    axes.set_title(title, wrap=True)  # names of scenarios and options may be long
    figure.legend(loc="outside lower center", ncols=2, fontsize="small")
    figure.colorbar(cells, label=f"mean {label_robustness(formula)}", extend="both")
    return figure


def check_map(arena: Arena) -> None:
    """Raise unless there are two disturbances to draw over.

    Raises:
        InputError: there are not.
    """
    if len(arena.names) < 2:
        raise InputError(f"--map: the suite draws {', '.join(arena.names)} alone from a range; two are needed")
