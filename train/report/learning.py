"""Learning curves of the policies that an evaluation judged, where their training left them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from train.report.tables import Look

RECORDS = "checkpoints/*/training.json"  # of a training run, in its folder


def collect_learning(looks: Mapping[str, Look]) -> list[dict[str, Any]]:
    """Return the curve of each policy whose name is the folder of its training.

    Args:
        looks: policy label to its look.

    Returns:
        ``name``, ``color``, and per evaluation ``steps`` and mean and sure ``gain`` and ``low`` [m].
    """
    curves = []
    for label, look in looks.items():
        points = _read_evaluations(Path(label))
        if points:
            values = {key: [point[key] for point in points] for key in ("steps", "gain", "low")}
            curves.append({"name": look.name, "color": look.color} | values)
    return curves


def write_learning(curves: list[dict[str, Any]]) -> str:
    """Write the places where the curves are drawn, or why there are none."""
    if not curves:
        return (
            '<p class="empty">No policy here was named by the folder of its training run, which keeps its curve; '
            "experts do not learn, and shipped policies come without.</p>"
        )
    return "".join(
        f'<h3>{escape(curve["name"])}</h3><div class="plot" id="learning-{k}"></div>' for k, curve in enumerate(curves)
    )


def _read_evaluations(folder: Path) -> list[dict[str, Any]]:
    """Return the evaluations of the longest record of a run; none where it has none that can be drawn."""
    found: list[dict[str, Any]] = []
    for path in sorted(folder.glob(RECORDS)):
        try:
            points = json.loads(path.read_text(encoding="utf-8")).get("evaluations", [])
            whole = [point for point in points if point.get("share", 1.0) == 1.0]
            kept = [{key: float(point[key]) for key in ("steps", "gain", "low")} for point in whole]
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            continue  # a run's own files are its own business; the page says where there is no curve
        found = kept if len(kept) > len(found) else found
    return found
