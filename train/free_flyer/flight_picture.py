"""A picture of free-flyers' episode: executed against planned motion, replans, impacts, robustness and inputs.

Source: Verhagen & Tumova, Figs. 6 to 11, draw the same quantities.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.picture import drawing
from impact_envs.picture.drawing import mix
from impact_envs.rollout import Episode
from planners.free_flyer.belief.world_memory import COUNTERS
from planners.plan import Plan
from train.free_flyer.flight_record import SIGNALS, FlightRecord, Hit, convert_episode, list_hits, list_others, locate
from train.free_flyer.plan_map import Style, choose_styles, draw_map, list_curves, sample_curve, star
from train.free_flyer.plan_picture import PANELS
from train.pictures.color import hex_color
from train.pictures.file import check_picture_path, save_figure
from train.pictures.robustness import draw_robustness

WIDTH, DPI = 19.2, 100  # [in], [1/in]
# Of the blocks from top to bottom, and of what is around them [in].
TITLE, UPPER, GAP, ROW, INPUT, LEGEND, LEFT, RIGHT = 1.0, 9.0, 0.75, 0.12, 0.95, 1.05, 0.75, 0.25
SHARES = (1.0, 1.0, 1.0, 1.0, 0.85, 0.6)  # of heights: PANELS, robustness, events
INPUTS = ("Fx [N]", "Fy [N]", "torque [N m]")
COLUMNS = 4  # of robots' inputs
BETWEEN = 1.55  # map and panels, for the names of events [in]
DASHES = (0, (4, 2))
IMPACT, MUTED, INK = hex_color(drawing.IMPACT), hex_color(drawing.MUTED), hex_color(drawing.INK)


def save_flight_picture(record: FlightRecord, episode: Episode, path: str | Path) -> None:
    """Write a picture of an episode; the same episode gives the same file.

    Args:
        record: what was watched.
        episode: the same one.
        path: of a .png, .pdf or .svg file.

    Raises:
        InputError: another suffix, or a file that cannot be written.
    """
    check_picture_path(path)
    save_figure(draw_flight(record.scenario, episode, record), path)


def draw_flight(scenario: FreeFlyerScenario, episode: Episode, record: FlightRecord | None = None) -> Figure:
    """Draw an episode: a map, positions, velocities, robustness and events over time, every robot's inputs.

    Args:
        scenario: where.
        episode: what happened.
        record: what was watched of the policy.

    Returns:
        A figure 1920 pixels wide, in no global state; its axes are the map, x, y, vx, vy, robustness, events, then
        Fx, Fy and torque of every robot.
    """
    plan = record.plan if record else None
    styles, hits = choose_styles(scenario), list_hits(scenario, episode)
    with rc_context({"text.parse_math": False}):
        rows = math.ceil(len(scenario.robots) / COLUMNS)
        block = len(INPUTS) * (INPUT + ROW)
        height = TITLE + UPPER + rows * (GAP + block) + LEGEND
        figure = Figure((WIDTH, height), DPI, facecolor=hex_color(drawing.PAPER))
        FigureCanvasAgg(figure)
        ground, panels = _add_upper_axes(figure, scenario, float(episode.times[-1]))
        _draw_ground(ground, scenario, episode, plan, styles, hits)
        _draw_motions(panels[:4], episode, record, styles)
        _draw_robustness(panels[4], scenario, episode, plan)
        _draw_events(panels[5], record, styles)
        inputs = _add_input_axes(figure, scenario, panels[0])
        _draw_inputs(inputs, scenario, episode, styles)
        _mark_planned(panels, plan)
        _mark_executed(panels, dict(zip(scenario.robots, inputs, strict=True)), episode, hits)
        _add_legend(figure, scenario, record, styles, bool(list_others(episode, hits)))
        _write_title(figure, scenario, episode, plan)
    return figure


def _add_upper_axes(figure: Figure, scenario: FreeFlyerScenario, end: float) -> tuple[Axes, list[Axes]]:
    """Add the map, as wide as the world needs, and panels over time."""
    width, height = figure.get_size_inches()
    (x0, y0), (x1, y1) = scenario.world.lower, scenario.world.upper
    top, wide = height - TITLE, float(np.clip((x1 - x0) / (y1 - y0) * UPPER, 0.2 * width, 0.46 * width))
    ground = _add_axes(figure, LEFT, top - UPPER, wide, UPPER)
    ground.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    ground.set(facecolor=hex_color(drawing.WORLD), anchor="N")
    left, tall = LEFT + wide + BETWEEN, UPPER - (len(SHARES) - 1) * ROW
    panels: list[Axes] = []
    for share, label in zip(SHARES, (*PANELS, "", ""), strict=True):
        high = tall * share / sum(SHARES)
        top -= high
        panel = _add_axes(figure, left, top, width - RIGHT - left, high, panels[0] if panels else None)
        panel.set_ylabel(label)
        panel.yaxis.set_label_coords(-0.65 / (width - RIGHT - left), 0.5)
        panel.tick_params(labelbottom=share == SHARES[-1])
        panels.append(panel)
        top -= ROW
    panels[0].set_xlim(0.0, end)
    panels[-1].set_xlabel("time [s]")
    return ground, panels


def _add_input_axes(figure: Figure, scenario: FreeFlyerScenario, shared: Axes) -> list[list[Axes]]:
    """Add three panels over time for every robot, robots side by side."""
    width, height = figure.get_size_inches()
    columns = min(COLUMNS, len(scenario.robots))
    wide = (width - RIGHT - LEFT + 0.6) / columns
    inputs = []
    for place, _ in enumerate(scenario.robots):
        row, column = divmod(place, COLUMNS)
        top = height - TITLE - UPPER - GAP - row * (GAP + len(INPUTS) * (INPUT + ROW))
        bottoms = [top - (k + 1) * INPUT - k * ROW for k in range(len(INPUTS))]
        own = [_add_axes(figure, LEFT + column * wide, bottom, wide - 0.6, INPUT, shared) for bottom in bottoms]
        for k, (axes, label) in enumerate(zip(own, INPUTS, strict=True)):
            axes.tick_params(labelbottom=k == len(INPUTS) - 1)
            axes.set_ylabel(label if column == 0 else "")
            axes.yaxis.set_label_coords(-0.5 / (wide - 0.6), 0.5)
        own[-1].set_xlabel("time [s]")
        inputs.append(own)
    return inputs


def _add_axes(figure: Figure, left: float, bottom: float, wide: float, high: float, shared: Axes | None = None) -> Axes:
    """Add axes at a place given in inches."""
    width, height = figure.get_size_inches()
    axes = figure.add_axes((left / width, bottom / height, wide / width, high / height), sharex=shared)
    axes.grid(color=hex_color(drawing.GRID), lw=0.8)
    axes.set_axisbelow(True)
    axes.ticklabel_format(axis="y", useOffset=False)
    for spine in axes.spines.values():
        spine.set_color(hex_color(drawing.EDGE))
    return axes


def _draw_ground(
    ground: Axes,
    scenario: FreeFlyerScenario,
    episode: Episode,
    plan: Plan | None,
    styles: dict[str, Style],
    hits: Sequence[Hit],
) -> None:
    """Draw executed paths over planned ones, and all impacts."""
    if plan:
        for name, curve in list_curves(plan):
            _, points, _ = sample_curve(curve)
            ground.plot(*points.T, **_planned(styles[name]), zorder=3)
        places = np.array([impact.position for impact in plan.impacts]).reshape(-1, 2)
        ground.plot(*places.T, **_planned_star(13.0), zorder=6.5)
    draw_map(ground, scenario, convert_episode(scenario, episode), styles)
    points = np.array([hit.point for hit in list_others(episode, hits)]).reshape(-1, 2)
    ground.plot(*points.T, marker="x", ls="none", color=INK, ms=6, mew=1.5, zorder=7)


def _draw_motions(
    panels: Sequence[Axes], episode: Episode, record: FlightRecord | None, styles: dict[str, Style]
) -> None:
    """Draw positions and velocities of every body: planned, as replanned, executed."""
    if record and record.plan:
        for name, curve in list_curves(record.plan):
            times, points, velocities = sample_curve(curve)
            for panel, values in zip(panels, (*points.T, *velocities.T), strict=True):
                panel.plot(times, values, **_planned(styles[name]), zorder=3)
    for name, style in reversed(styles.items()):  # thinner lines of robots over those of objects
        for panel, signal in zip(panels, SIGNALS, strict=True):
            panel.plot(episode.times, episode.signals[f"{name}.{signal}"], **style.line(1.0, 0.8), zorder=4)
    # Settled before courses are drawn, as one that nobody could follow would flatten the rest. Siblings share a scale
    # down to a twentieth, so that what is no motion looks like none.
    for pair in (panels[:2], panels[2:]):
        limits = np.array([panel.get_ylim() for panel in pair])
        spans = np.maximum(np.ptp(limits, axis=1), 0.05 * np.ptp(limits, axis=1).max())
        for panel, middle, span in zip(pair, limits.mean(axis=1), spans, strict=True):
            panel.set_ylim(middle - span / 2, middle + span / 2)
    if not record:
        return
    for name, course in record.courses.items():
        for panel, values in zip(panels, course.T[1:], strict=True):
            panel.plot(course[:, 0], values, **_replanned(styles[name]), zorder=5)
    for axis, panel in enumerate(panels[:2]):
        for name, style in styles.items():
            ways = [wish.way[:, (0, 1 + axis)] for wish in record.expectations if wish.object == name]
            panel.add_collection(LineCollection(ways, color=_ink(style), lw=0.6, alpha=0.4, zorder=4.5), False)


def _draw_robustness(panel: Axes, scenario: FreeFlyerScenario, episode: Episode, plan: Plan | None) -> None:
    """Draw the interval of robustness still possible, what was planned and what was reached."""
    draw_robustness(panel, scenario, episode, plan.robustness if plan else 0.1)
    if plan:
        panel.axhline(plan.robustness, color=MUTED, lw=1.0, ls=DASHES, zorder=2)


def _draw_events(panel: Axes, record: FlightRecord | None, styles: dict[str, Style]) -> None:
    """Draw a tick whenever the expert counted something, in one row per counter; replans in their robots' colours."""
    events = record.events if record else []
    counts = Counter(name for _, name in events)
    rows = [name for name in COUNTERS if name in counts]
    for row, name in enumerate(rows):
        if name == "replans" and record:
            times = [time for time, _ in record.replans]
            colors = [hex_color(styles[robot].color) for _, robot in record.replans]
        else:
            times = [time for time, other in events if other == name]
            colors = [INK] * len(times)
        panel.scatter(times, [row] * len(times), c=colors, marker="|", s=55.0, lw=1.1, zorder=3)
    panel.set_yticks(range(len(rows)), [f"{name.replace('_', ' ')} {counts[name]}" for name in rows], size=8.5)
    panel.set_ylim(len(rows) - 0.4 if rows else 1.0, -0.6)
    panel.grid(visible=False, axis="y")


def _draw_inputs(
    inputs: Sequence[Sequence[Axes]], scenario: FreeFlyerScenario, episode: Episode, styles: dict[str, Style]
) -> None:
    """Draw every robot's commanded forces and torque in its body frame, held over each step, within their limits."""
    for (name, robot), own in zip(scenario.robots.items(), inputs, strict=True):
        actions = np.clip(episode.actions[name], -1.0, 1.0)
        for axes, limit, values in zip(own, (robot.force_limit,) * 2 + (robot.torque_limit,), actions.T, strict=True):
            axes.step(
                episode.times, limit * np.append(values, values[-1]), where="post", color=styles[name].line()["color"],
                lw=0.9, zorder=3,
            )  # fmt: skip
            for bound in (-limit, limit):
                axes.axhline(bound, color=MUTED, lw=0.9, ls=DASHES, zorder=2)
            axes.set_ylim(-1.2 * limit, 1.2 * limit)
        own[0].set_title(name, loc="left", size=10, weight="bold", color=_ink(styles[name]), pad=3)


def _mark_planned(panels: Sequence[Axes], plan: Plan | None) -> None:
    """Draw a dashed line at every planned impact, and hollow stars in the panels of x and y."""
    for planned in plan.impacts if plan else ():
        for axes in panels:
            axes.axvline(planned.time, color=hex_color(mix(drawing.IMPACT, 0.45)), lw=0.9, ls=DASHES, zorder=2)
        for axis, panel in enumerate(panels[:2]):
            panel.plot(planned.time, planned.position[axis], **_planned_star(9.0), zorder=6)


def _mark_executed(
    panels: Sequence[Axes], inputs: Mapping[str, Sequence[Axes]], episode: Episode, hits: Sequence[Hit]
) -> None:
    """Draw a line at every impact, stars in the panels of x and y, and numbers above; with inputs only the robot's."""
    last, level = -np.inf, 0
    for number, (hit, robot, target) in enumerate(hits, start=1):
        for axes in (*panels, *inputs[robot]):
            axes.axvline(hit.time, color=IMPACT, lw=0.9, zorder=2)
        for panel, place in zip(panels[:2], locate(episode, target, hit.time), strict=True):
            panel.plot(hit.time, place, **star(10.0), zorder=7)
        # Numbers that would touch stand one above the other.
        level = (level + 1) % 3 if hit.time - last < 0.02 * episode.times[-1] else 0
        last = hit.time
        above = {"xy": (hit.time, 1.0), "xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        look = {"ha": "center", "color": IMPACT, "weight": "bold"}
        panels[0].annotate(str(number), **above, xytext=(0, 2 + 11 * level), **look)  # type: ignore[arg-type]
    for hit in list_others(episode, hits):
        for axes in (*panels, *inputs.get(hit.a, ()), *inputs.get(hit.b, ())):
            axes.axvline(hit.time, color=MUTED, lw=0.8, ls=(0, (1, 1.5)), zorder=2)


def _add_legend(
    figure: Figure, scenario: FreeFlyerScenario, record: FlightRecord | None, styles: dict[str, Style], others: bool
) -> None:
    """Explain lines and areas below all axes."""
    entries: list[Line2D | Patch] = []
    for name, style in styles.items():
        kind = "robot" if name in scenario.robots else "object"
        entries.append(Line2D([], [], label=f"{name} ({kind})", **style.line()))
    entries.append(Line2D([], [], label="impact of a robot on an object", **star(13.0)))
    first = next(iter(styles.values()))
    if record and record.plan:
        entries.append(Line2D([], [], label="planned", **_planned(first)))
        entries.append(Line2D([], [], label="planned impact", **_planned_star(12.0)))
        entries.append(Line2D([], [], label="course of a robot as replanned", **_replanned(first)))
        style = styles[next(iter(scenario.objects))]
        entries.append(Line2D([], [], color=_ink(style), lw=0.8, label="way of an object that a replan counts on"))
    entries.append(Line2D([], [], color=MUTED, lw=0.9, ls=DASHES, label="limit of an input, planned robustness"))
    if others:
        entries.append(Line2D([], [], marker="x", ls="none", color=INK, ms=7, mew=1.5, label="other impact"))
    if scenario.regions:
        entries.append(Patch(fc=hex_color(drawing.REGION), ec=hex_color(drawing.REGION_EDGE), label="region"))
    if scenario.obstacles:
        entries.append(Patch(fc=hex_color(drawing.SOLID), ec=hex_color(drawing.SOLID_EDGE), label="obstacle"))
    disc = {"marker": "o", "ms": 11, "ls": "none", "mec": INK, "mfc": hex_color(drawing.SOLID)}
    entries.append(Line2D([], [], label="body at its start (dashed: end)", **disc))  # type: ignore[arg-type]
    columns = math.ceil(len(entries) / math.ceil(len(entries) / 8))
    figure.legend(handles=entries, loc="lower center", ncol=columns, frameon=False, handlelength=2.4)


def _write_title(figure: Figure, scenario: FreeFlyerScenario, episode: Episode, plan: Plan | None) -> None:
    width, height = figure.get_size_inches()
    verdict = "satisfied" if episode.success else "violated"
    promised = f", planned {plan.robustness:.3f} m" if plan else ""
    facts = [
        f"{episode.scenario}, {episode.policy}, seed {episode.seed}: {verdict}",
        f"robustness ρ = {episode.robustness:.3f} m{promised}",
        f"propulsion {episode.effort:.1f} N s",
    ]
    left, ink = LEFT / width, hex_color(drawing.INK)
    figure.text(left, 1.0 - 0.32 / height, "     ".join(facts), size=15, weight="bold", color=ink, va="center")
    formula = scenario.formula if len(scenario.formula) <= 190 else scenario.formula[:189] + "…"
    figure.text(left, 1.0 - 0.6 / height, formula, size=10, color=MUTED, va="center", family="monospace")


def _planned(style: Style) -> dict[str, Any]:
    return {"color": hex_color(mix(style.color, 0.6)), "lw": 0.6 * style.width, "ls": DASHES}


def _replanned(style: Style) -> dict[str, Any]:
    return {"color": _ink(style), "lw": 0.9, "ls": (0, (1, 1.5))}


def _planned_star(size: float) -> dict[str, Any]:
    return star(size) | {"mfc": hex_color(drawing.PAPER), "mec": IMPACT, "mew": 1.0}


def _ink(style: Style) -> str:
    """Return the dark tone of a body, for letters and thin lines over its own."""
    return hex_color(mix(style.color, 0.6, drawing.INK))
