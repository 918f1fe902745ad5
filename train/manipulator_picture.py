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

from impact_envs import drawing
from impact_envs.errors import InputError
from impact_envs.floating_manipulator.task import FloatingManipulatorTask
from impact_envs.rollout import Episode
from train.manipulator_record import ManipulatorRecord
from train.plan_map import hex_color

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE, DPI = (19.2, 10.8), 100  # [in], [1/in]
SNAPSHOTS = 6  # of the motion, the impact's apart
LABEL_ROOM = 0.6  # between the times written beside them [m]
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
    figure = draw_manipulator_episode(record, episode)
    try:
        figure.savefig(path, dpi=DPI)
    except OSError as error:
        raise InputError(f"picture {path}: cannot be written: {error.strerror}") from None


def draw_manipulator_episode(record: ManipulatorRecord, episode: Episode) -> Figure:
    """Draw an episode: the motion on the left, histories right and below.

    Args:
        record: what was watched.
        episode: the same one.

    Returns:
        A figure of 1920 x 1080 pixels, in no global state.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(SIZE, DPI, facecolor=hex_color(drawing.PAPER), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(4, 4)
    _draw_motion(figure.add_subplot(grid[:2, :2]), record, episode)
    cells = itertools.chain(itertools.product((0, 1), (2, 3)), itertools.product((2, 3), range(4)))
    histories = [*_list_histories(record, episode), *_list_torques(record, episode)]
    for (row, column), (title, curves) in zip(cells, histories, strict=False):
        axes = figure.add_subplot(grid[row, column])
        _draw_history(axes, title, curves, episode.times)
        _mark_phases(axes, record)
        if row == 3:
            axes.set_xlabel("time [s]", fontsize=8)
    verdict = "satisfied" if episode.success else "violated"
    figure.suptitle(
        f"{episode.scenario}, {episode.policy}: robustness {episode.robustness:.3f}, {verdict}", fontsize=12
    )
    return figure


def _draw_motion(axes: Axes, record: ManipulatorRecord, episode: Episode) -> None:
    """Draw the paths of tip, base and box, and snapshots of all bodies, the later the stronger."""
    scenario, signals = record.scenario, episode.signals
    instants = [float(t) for t in np.linspace(0.0, episode.times[-1], SNAPSHOTS)]
    instants += [hit.impact.time for hit in record.collisions[:1]]
    shapes = FloatingManipulatorTask(scenario).shapes()
    colors, labelled = _body_colors(scenario.links), list[tuple[float, float]]()
    for shape in shapes:
        if shape.body is None and shape.vertices:
            edge = hex_color(drawing.REGION_EDGE)
            axes.fill(*np.transpose(shape.vertices), facecolor="none", edgecolor=edge, lw=THIN)
    for body in ("tip", "base", "box"):
        axes.plot(signals[f"{body}.x"], signals[f"{body}.y"], color=colors[body], lw=THIN, label=body)
    for instant in sorted(instants):
        k = min(round(instant / episode.period), len(episode.times) - 1)
        strength = 0.2 + 0.8 * instant / max(episode.times[-1], episode.period)
        for shape in shapes:
            if shape.body is not None and shape.vertices:
                pose = tuple(float(signals[f"{shape.body}.{name}"][k]) for name in ("x", "y", "heading"))
                corners = _place(shape.vertices, *pose)
                color = colors[shape.body]
                axes.fill(*corners.T, facecolor=(color, 0.35 * strength), edgecolor=(color, strength), lw=THIN)
        here = float(signals["base.x"][k]), float(signals["base.y"][k])
        if all(math.dist(here, other) > LABEL_ROOM for other in labelled):
            axes.text(*here, f"{instant:.1f} s", fontsize=7, ha="center", va="center")
            labelled.append(here)
    for hit in record.collisions:
        axes.plot(*hit.impact.point, "*", color=hex_color(drawing.IMPACT), ms=10, mec="white", mew=0.5, zorder=5)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.legend(loc="upper left", fontsize=8, framealpha=0.8)
    axes.grid(color=hex_color(drawing.GRID), lw=0.6)


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
    axes.legend(fontsize=7, framealpha=0.8, ncols=len(curves), loc="best")


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


def _place(vertices: Sequence[tuple[float, float]], x: float, y: float, heading: float) -> np.ndarray:
    """Return a body's corners in the world, shape (n, 2) [m]."""
    cos, sin = np.cos(heading), np.sin(heading)
    return np.asarray(vertices) @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
