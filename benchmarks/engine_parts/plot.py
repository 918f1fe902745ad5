"""Draw env-steps/s over batch size, one panel per setting, readable without colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

STYLES = ("o-", "s--", "D-", "^:", "v-.", "P--", "X:", "*-")
COLORS = ("#0b3c8c", "#8a8a8a", "#1f77b4", "#d62728", "#56b4e9", "#0b3c8c", "#e69f00", "#7f5539")
ROOM = 0.042  # least distance of two labels, as a part of the axis


def draw_rates(rates: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw medians with bars from the least to the greatest repeat.

    Args:
        rates: as ``make_rates`` of benchmarks/engine.py returns them.
        path: of the PNG file.
    """
    from matplotlib.figure import Figure

    settings = list(dict.fromkeys(row["setting"] for row in rates))
    methods = list(dict.fromkeys(row["method"] for row in rates))
    figure = Figure(figsize=(6.4 * len(settings), 4.8), layout="constrained")
    panels = figure.subplots(1, len(settings), squeeze=False, sharey=True)[0]
    labels = []
    for panel, setting in zip(panels, settings, strict=True):
        panel.set(
            xscale="log", yscale="log", title=f"{setting} bodies (robots + objects)", xlabel="worlds in the batch"
        )
        panel.grid(True, which="major", color="0.9")
        ends = []
        for number, method in enumerate(methods):
            line = [row for row in rates if (row["setting"], row["method"]) == (setting, method)]
            if line:
                ends.append(_draw_line(panel, line, number))
        labels.append(ends)
        ticks = sorted({row["batch"] for row in rates})
        panel.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
        panel.minorticks_off()
        panel.spines[["top", "right"]].set_visible(False)
    for panel, ends in zip(panels, labels, strict=True):  # after all lines, which share their axis of y
        _write_labels(panel, ends)
    panels[0].set_ylabel("env-steps/s (CPU time; all cores: wall time)")
    figure.savefig(path, dpi=130, metadata={"Software": None})


def _draw_line(panel: Any, line: Sequence[dict[str, Any]], number: int) -> tuple[float, float, str, str]:
    x, y = [row["batch"] for row in line], [row["rate"] for row in line]
    below = [row["rate"] - row["least"] for row in line]
    above = [row["greatest"] - row["rate"] for row in line]
    color = COLORS[number % len(COLORS)]
    panel.errorbar(x, y, [below, above], fmt=STYLES[number % len(STYLES)], color=color, capsize=2, markersize=5)
    return x[-1], y[-1], line[0]["method"], color


def _write_labels(panel: Any, ends: Sequence[tuple[float, float, str, str]]) -> None:
    """Write every line's name behind its end, names at the same batch size one above the other."""
    panel.set_xlim(right=panel.get_xlim()[1] * 30)
    low, high = panel.get_ylim()
    heights: dict[float, float] = {}
    for x, y, name, color in sorted(ends, key=lambda end: end[:2]):
        height = heights[x] = max(math.log(y / low) / math.log(high / low), heights.get(x, -1.0) + ROOM)
        panel.annotate(
            name,
            (x, height),
            xycoords=("data", "axes fraction"),
            xytext=(7, 0),
            textcoords="offset points",
            color=color,
            fontsize=8,
            va="center",
            bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
