"""A picture of a plan: where bodies go and meet, and their positions and velocities over time."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.picture import drawing
from planners.bezier import Curve
from planners.plan import Plan
from train.free_flyer.plan_map import Style, choose_styles, draw_map, list_curves, sample_curve, star
from train.pictures.color import hex_color
from train.pictures.file import check_picture_path, save_figure

SIZE, DPI = (16.0, 9.0), 100  # [in], [1/in]
BOTTOM, TOP, LEFT, RIGHT = 0.145, 0.88, 0.05, 0.982  # of the axes, in shares of the picture
GAP = 0.015  # between panels
PANELS = ("x [m]", "y [m]", "vx [m/s]", "vy [m/s]")


def draw_plan(scenario: FreeFlyerScenario, plan: Plan) -> Figure:
    """Draw a plan: a map on the left, x, y, vx and vy over time on the right.

    Args:
        scenario: world, areas and bodies.
        plan: for these bodies; its boxes and responses are drawn where it has any.

    Returns:
        A figure of 1600 x 900 pixels, in no global state.

    Raises:
        InputError: the plan is for other bodies.

    Source: Verhagen & Tumova, Figs. 4, 5, 7, 8.
    """
    for name in sorted({*plan.robots, *plan.objects} ^ {*scenario.bodies}):
        known = scenario.bodies if name not in scenario.bodies else (*plan.robots, *plan.objects)
        raise InputError(f"plan of {plan.scenario} in scenario {scenario.name}: '{name}'; {choices(name, known)}")
    with rc_context({"text.parse_math": False}):
        figure = Figure(SIZE, DPI, facecolor=hex_color(drawing.PAPER))
        FigureCanvasAgg(figure)
        styles = choose_styles(scenario)
        ground, panels = _add_axes(figure, scenario, plan.horizon)
        draw_map(ground, scenario, plan, styles)
        _draw_signals(panels, plan, styles)
        _mark_impacts(panels, plan)
        _add_legend(figure, scenario, plan, styles)
        _write_title(figure, scenario, plan)
    return figure


def save_plan_picture(scenario: FreeFlyerScenario, plan: Plan, path: str | Path) -> None:
    """Write a picture of a plan; the same plan gives the same file.

    Args:
        scenario: world, areas and bodies.
        plan: to draw.
        path: of a .png, .pdf or .svg file.

    Raises:
        InputError: another suffix, a file that cannot be written, or as `draw_plan`.
    """
    check_picture_path(path)
    save_figure(draw_plan(scenario, plan), path)


def _add_axes(figure: Figure, scenario: FreeFlyerScenario, horizon: float) -> tuple[Axes, list[Axes]]:
    """Add the map, as wide as the world needs, and four panels over time."""
    (x0, y0), (x1, y1) = scenario.world.lower, scenario.world.upper
    height = TOP - BOTTOM
    width = float(np.clip((x1 - x0) / (y1 - y0) * height * SIZE[1] / SIZE[0], 0.22, 0.5))
    ground = figure.add_axes((LEFT, BOTTOM, width, height))
    ground.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    ground.set_facecolor(hex_color(drawing.WORLD))
    left = LEFT + width + 0.06
    tall = (height - (len(PANELS) - 1) * GAP) / len(PANELS)
    panels: list[Axes] = []
    for k, label in enumerate(PANELS):
        bottom = BOTTOM + (len(PANELS) - 1 - k) * (tall + GAP)
        panel = figure.add_axes((left, bottom, RIGHT - left, tall), sharex=panels[0] if panels else None)
        panel.set_ylabel(label)
        panel.yaxis.set_label_coords(-0.04 / (RIGHT - left), 0.5)
        panel.ticklabel_format(axis="y", useOffset=False)
        panel.tick_params(labelbottom=k == len(PANELS) - 1)
        panels.append(panel)
    panels[0].set_xlim(0.0, horizon)
    panels[-1].set_xlabel("time [s]")
    for axes in (ground, *panels):
        axes.grid(color=hex_color(drawing.GRID), lw=0.8)
        axes.set_axisbelow(True)
        for spine in axes.spines.values():
            spine.set_color(hex_color(drawing.EDGE))
    return ground, panels


def _draw_signals(panels: Sequence[Axes], plan: Plan, styles: dict[str, Style]) -> None:
    """Draw position and velocity of every body, and the bands of boxes."""
    for name, tube in plan.tubes.items():
        moments = np.stack([tube.times[:-1], tube.times[1:]], axis=1).ravel()
        boxes = np.stack([tube.start, tube.end], axis=1).reshape(-1, 2, 4)
        lower, upper = boxes[:, 0] - boxes[:, 1], boxes[:, 0] + boxes[:, 1]
        for k, panel in enumerate(panels):
            panel.fill_between(
                moments, lower[:, k], upper[:, k], fc=hex_color((*styles[name].color, 64)), lw=0, zorder=1
            )
    for name, curves in plan.responses.items():
        for curve in curves:
            _draw_curve(panels, curve, styles[name].line(0.5, 0.4))
    for name, curve in list_curves(plan):
        _draw_curve(panels, curve, styles[name].line())
    # Siblings share a scale down to a quarter, so that a body that hardly moves is seen to.
    for pair in (panels[:2], panels[2:]):
        limits = np.array([panel.get_ylim() for panel in pair])
        spans = np.maximum(np.diff(limits), 0.25 * np.ptp(limits, axis=1).max())
        for panel, middle, span in zip(pair, limits.mean(axis=1), spans[:, 0], strict=True):
            panel.set_ylim(middle - span / 2, middle + span / 2)


def _mark_impacts(panels: Sequence[Axes], plan: Plan) -> None:
    """Draw a line through all panels at every impact, and its number above them."""
    last, level = -np.inf, 0
    for number, impact in enumerate(plan.impacts, start=1):
        for panel in panels:
            panel.axvline(impact.time, color=hex_color(drawing.IMPACT), lw=0.9, ls=(0, (4, 3)), zorder=2)
        for axis, panel in enumerate(panels[:2]):
            panel.plot(impact.time, impact.position[axis], **star(10.0), zorder=6)
        # Numbers that would touch stand one above the other.
        level = (level + 1) % 3 if impact.time - last < 0.018 * plan.horizon else 0
        last = impact.time
        place = {"xy": (impact.time, 1.0), "xycoords": ("data", "axes fraction")}
        panels[0].annotate(
            str(number),
            **place,  # type: ignore[arg-type]
            xytext=(0, 2 + 11 * level),
            textcoords="offset points",
            ha="center",
            color=hex_color(drawing.IMPACT),
            weight="bold",
        )


def _draw_curve(panels: Sequence[Axes], curve: Curve, line: dict[str, Any]) -> None:
    times, points, velocities = sample_curve(curve)
    for panel, values in zip(panels, (*points.T, *velocities.T), strict=True):
        panel.plot(times, values, **line, zorder=3)


def _add_legend(figure: Figure, scenario: FreeFlyerScenario, plan: Plan, styles: dict[str, Style]) -> None:
    """Explain lines and areas below all axes."""
    entries: list[Line2D | Patch] = []
    for name, style in styles.items():
        kind = "robot" if name in scenario.robots else "object"
        entries.append(Line2D([], [], label=f"{name} ({kind})", **style.line()))
    entries.append(Line2D([], [], label="impact", **star(13.0)))
    if plan.tubes:
        color = next(iter(styles[name].color for name in plan.tubes))
        entries.append(Patch(fc=hex_color((*color, 64)), ec=hex_color(color), label="box an object stays in"))
    if plan.responses:
        entries.append(Line2D([], [], color=hex_color(drawing.MUTED), lw=0.7, label="response to a vertex of the box"))
    if scenario.regions:
        entries.append(Patch(fc=hex_color(drawing.REGION), ec=hex_color(drawing.REGION_EDGE), label="region"))
    if scenario.obstacles:
        entries.append(Patch(fc=hex_color(drawing.SOLID), ec=hex_color(drawing.SOLID_EDGE), label="obstacle"))
    disc = {"marker": "o", "ms": 11, "ls": "none", "mec": hex_color(drawing.INK), "mfc": hex_color(drawing.SOLID)}
    entries.append(Line2D([], [], label="body at its start (dashed: end)", **disc))  # type: ignore[arg-type]
    columns = math.ceil(len(entries) / math.ceil(len(entries) / 8))
    figure.legend(handles=entries, loc="lower center", ncol=columns, frameon=False, handlelength=2.4)


def _write_title(figure: Figure, scenario: FreeFlyerScenario, plan: Plan) -> None:
    facts = [scenario.name, f"robustness ρ = {plan.robustness:.3f} m"]
    if plan.deviation is not None:
        facts.append(f"permissible deviation δ = {plan.deviation:.4f} m/s")
    facts.append(f"{len(plan.impacts)} impact{'' if len(plan.impacts) == 1 else 's'}")
    figure.text(LEFT, 0.955, "     ".join(facts), size=15, weight="bold", color=hex_color(drawing.INK), va="center")
    formula = textwrap.shorten(scenario.formula, 190, placeholder=" …")
    figure.text(LEFT, 0.92, formula, size=10, color=hex_color(drawing.MUTED), va="center", family="monospace")
