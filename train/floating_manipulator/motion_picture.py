"""A picture of a floating manipulator's episode: its motion, joints, tip, torques, momenta and energies.

Source: Nekoo, Sharf & Ollero, Figs. 4 to 19, draw the same quantities.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_envs.floating_manipulator.task import FloatingManipulatorTask
from impact_envs.interface.shape import Shape
from impact_envs.picture import drawing
from impact_envs.picture.unit import label_robustness
from impact_envs.rollout import Episode
from train.floating_manipulator.motion_record import ManipulatorRecord
from train.pictures.color import hex_color
from train.pictures.file import save_figure
from train.pictures.robustness import draw_robustness, write_verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

SIZE, DPI = (19.2, 15.0), 100  # [in], [1/in]
COLUMNS, SNAPSHOTS = 4, 6
MARGIN = 0.3  # around the motion [m]
THIN = 0.9  # [pt]
AXES = (("x", drawing.ROBOT_COLORS[0]), ("y", drawing.OBJECT_COLORS[0]), ("angular", drawing.ROBOT_COLORS[1]))


def save_manipulator_picture(record: ManipulatorRecord, episode: Episode, path: str | Path) -> None:
    """Draw an episode into a file.

    Args:
        record: what was watched.
        episode: the same one.
        path: of a .png, .pdf or .svg file.

    Raises:
        InputError: a file that cannot be written.
    """
    save_figure(draw_manipulator_episode(record, episode), path)


def draw_manipulator_episode(record: ManipulatorRecord, episode: Episode) -> Figure:
    """Draw an episode: snapshots of the motion above, histories below.

    Args:
        record: what was watched.
        episode: the same one.

    Returns:
        A figure of 1920 x 1500 pixels, in no global state.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(SIZE, DPI, facecolor=hex_color(drawing.PAPER), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.add_gridspec(2, 1, height_ratios=(2, 3))
    above, below = (figure.add_subfigure(rows[place]) for place in range(2))
    above.suptitle(write_verdict(record.scenario, episode), fontsize=12)
    _draw_motion(above, record, episode)
    histories = [*_list_histories(record, episode), *_list_torques(record, episode)]
    panels = len(histories) + 1
    grid = below.add_gridspec(math.ceil(panels / COLUMNS), COLUMNS)
    for place, (title, curves) in enumerate(histories):
        axes = below.add_subplot(grid[divmod(place, COLUMNS)])
        _draw_history(axes, title, curves, episode.times)
        _mark_phases(axes, record)
        if place >= panels - COLUMNS:
            axes.set_xlabel("time [s]", fontsize=8)
    row, column = divmod(panels - 1, COLUMNS)
    axes = below.add_subplot(grid[row, column:])  # as wide as there is room
    draw_robustness(axes, record.scenario, episode)
    title = label_robustness(record.scenario.specification)
    _draw_history(axes, title, [], episode.times)
    axes.set_ylabel("")
    axes.set_xlabel("time [s]", fontsize=8)
    _mark_phases(axes, record)
    return figure


def _draw_motion(figure: SubFigure, record: ManipulatorRecord, episode: Episode) -> None:
    """Draw snapshots of all bodies, with the paths of tip, base and box so far, all to the same scale."""
    shapes = FloatingManipulatorTask(record.scenario).shapes()
    instants = _choose_instants(record, float(episode.times[-1]))
    samples = [min(round(instant / episode.period), len(episode.times) - 1) for instant in instants]
    drawn = np.concatenate([_place(shape, episode.signals, k) for shape in shapes for k in samples if shape.vertices])
    low, high = drawn.min(0) - MARGIN, drawn.max(0) + MARGIN
    panels = figure.subplots(2, SNAPSHOTS // 2, sharex=True, sharey=True).ravel()
    for axes, instant, k in zip(panels, instants, samples, strict=True):
        _draw_snapshot(axes, record, episode, shapes, k)
        axes.set_title(f"{instant:.2f} s{_name_instant(record, instant)}", fontsize=9, loc="left")
        axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.tick_params(labelsize=7)
        axes.grid(color=hex_color(drawing.GRID), lw=0.6)
        axes.label_outer()
    for axes in panels[SNAPSHOTS // 2 :]:
        axes.set_xlabel("x [m]", fontsize=8)
    for axes in panels[:: SNAPSHOTS // 2]:
        axes.set_ylabel("y [m]", fontsize=8)
    panels[0].legend(loc="upper left", fontsize=7, framealpha=0.8)


def _choose_instants(record: ManipulatorRecord, end: float) -> list[float]:
    """Return the start, the first impact, the end of its pause, the end, and the middles of the longest gaps [s]."""
    instants = {0.0, end}
    for hit in record.collisions[:1]:
        instants |= {hit.impact.time, min(hit.impact.time + record.scenario.safety_pause, end)}
    while len(instants) < SNAPSHOTS:
        start, stop = max(itertools.pairwise(sorted(instants)), key=lambda pair: pair[1] - pair[0])
        instants.add((start + stop) / 2)
    return sorted(instants)


def _name_instant(record: ManipulatorRecord, instant: float) -> str:
    """Return what happens at an instant, as the end of a title."""
    for hit in record.collisions[:1]:
        if instant == hit.impact.time:
            return ", impact"
        if instant == hit.impact.time + record.scenario.safety_pause:
            return ", end of the safety pause"
    return ""


def _draw_snapshot(
    axes: Axes, record: ManipulatorRecord, episode: Episode, shapes: Sequence[Shape], sample: int
) -> None:
    """Draw all bodies at a sample, where they came from, and the impacts up to then."""
    signals, colors = episode.signals, _body_colors(record.scenario.links)
    for body in ("tip", "base", "box"):
        path = [signals[f"{body}.{axis}"][: sample + 1] for axis in "xy"]
        axes.plot(*path, color=colors[body], lw=THIN, label=body)
    for shape in shapes:
        if not shape.vertices:
            continue
        corners = _place(shape, signals, sample)
        if shape.body is None:
            axes.fill(*corners.T, facecolor="none", edgecolor=hex_color(drawing.REGION_EDGE), lw=THIN)
        else:
            axes.fill(*corners.T, facecolor=(colors[shape.body], 0.35), edgecolor=colors[shape.body], lw=THIN)
    for hit in record.collisions:
        if hit.impact.time <= (sample + 1) * episode.period:
            axes.plot(*hit.impact.point, "*", color=hex_color(drawing.IMPACT), ms=10, mec="white", mew=0.5, zorder=5)


History = tuple[str, list[tuple[str, np.ndarray, str]]]


def _list_histories(record: ManipulatorRecord, episode: Episode) -> Iterator[History]:
    """Yield title and curves (label, values, colour) of every panel that is not about torques."""
    signals, q, v, energies = episode.signals, record.coordinates, record.rates, record.energies
    colors = _body_colors(record.scenario.links)
    joints = [(f"joint {k}", colors[link]) for k, link in enumerate(record.scenario.links, start=1)]
    blue, orange, green = (hex_color(color) for _, color in AXES)
    base = [("x - x(0) [m]", q[:, 0] - q[0, 0], blue), ("y - y(0) [m]", q[:, 1] - q[0, 1], orange)]
    yield "base: displacement, heading", [*base, ("psi [rad]", q[:, 2], green)]
    yield "joint angles [rad]", [(name, q[:, 3 + k], color) for k, (name, color) in enumerate(joints)]
    yield "joint rates [rad/s]", [(name, v[:, 3 + k], color) for k, (name, color) in enumerate(joints)]
    dx, dy = (signals[f"tip.{axis}"] - signals[f"target.{axis}"] for axis in "xy")
    error = [("x", dx, blue), ("y", dy, orange), ("distance", np.hypot(dx, dy), green)]
    yield "tip: error [m]", error
    yield "tip: velocity [m/s]", [("x", signals["tip.vx"], blue), ("y", signals["tip.vy"], orange)]
    for body, title in (("base", "manipulator"), ("box", "box")):
        names = ("momentum_x", "momentum_y", "angular_momentum")
        curves = zip(AXES, names, strict=True)
        yield (
            f"{title}: momenta [N s], [N m s]",
            [(label, signals[f"{body}.{name}"], hex_color(color)) for (label, color), name in curves],
        )
    yield "kinetic energy [J]", [("manipulator", energies[:, 0], blue), ("box", energies[:, 1], orange)]


def _list_torques(record: ManipulatorRecord, episode: Episode) -> Iterator[History]:
    """Yield the panels of torques with their bounds, and of thrusters and wheel where there are any."""
    limits, forces = record.torque_limits, record.base_forces
    grey = hex_color(drawing.MUTED)
    shown = list(record.scenario.links)[: 3 if "base" in record.scenario.agents else 4]
    for k, link in enumerate(shown):
        torque = ("torque", episode.signals[f"{link}.torque"][1:], hex_color(drawing.ROBOT_COLORS[0]))
        bounds = [("bounds", limits[:, 0, k], grey), ("", limits[:, 1, k], grey)]
        yield f"joint {k + 1}: torque [N m]", [*bounds, torque]
    if "base" in record.scenario.agents:
        curves = zip(AXES, forces.T, strict=True)
        labels = ("thrusters x", "thrusters y", "wheel")
        yield (
            "base: thrusters [N], wheel [N m]",
            [(label, values, hex_color(color)) for label, ((_, color), values) in zip(labels, curves, strict=True)],
        )


def _draw_history(axes: Axes, title: str, curves: Sequence[tuple[str, np.ndarray, str]], times: np.ndarray) -> None:
    for label, values, color in curves:
        axes.plot(times[-len(values) :], values, color=color, lw=THIN, label=label or None)
    axes.set_title(title, fontsize=9, loc="left")
    axes.set_xlim(times[0], times[-1])
    axes.tick_params(labelsize=7)
    axes.grid(color=hex_color(drawing.GRID), lw=0.6)
    axes.legend(fontsize=7, framealpha=0.8, ncols=max(1, len(curves)), loc="best")


def _mark_phases(axes: Axes, record: ManipulatorRecord) -> None:
    """Mark every impact by a line, and the safety pause after it by a shade."""
    for hit in record.collisions:
        start = hit.impact.time
        axes.axvline(start, color=hex_color(drawing.IMPACT), lw=0.7)
        axes.axvspan(start, start + record.scenario.safety_pause, color=hex_color(drawing.MUTED), alpha=0.12, lw=0)


def _body_colors(links: Mapping[str, Any]) -> dict[str, str]:
    """Return colours as the renderer has them, but for the tip, whose path is to stand out."""
    palette = itertools.cycle(drawing.ROBOT_COLORS)
    colors = {body: hex_color(color) for body, color in zip(("base", *links), palette, strict=False)}
    return colors | {"box": hex_color(drawing.OBJECT_COLORS[0]), "tip": hex_color(drawing.INK)}


def _place(shape: Shape, signals: Mapping[str, np.ndarray], sample: int) -> np.ndarray:
    """Return a shape's corners in the world at a sample, shape (n, 2) [m]."""
    if shape.body is None:
        return np.asarray(shape.vertices)
    x, y, heading = (float(signals[f"{shape.body}.{name}"][sample]) for name in ("x", "y", "heading"))
    cos, sin = math.cos(heading), math.sin(heading)
    return np.asarray(shape.vertices) @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
