"""A picture of a dual-arm episode: both velocity fields, velocities and forces over the impact, torques compared.

Source: van Steen et al., Figs. 2 to 4, draw the same quantities.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.dual_arm.task import DualArmTask
from impact_envs.env import parallel_env
from impact_envs.errors import InputError
from impact_envs.picture import drawing
from impact_envs.rollout import Episode, Policy, rollout
from planners import make_expert
from planners.dual_arm.reference import PostField, compute_ante_velocity, compute_post_reference
from planners.dual_arm.reference_spreading import ReferenceSpreading
from train.dual_arm.arms_panel import draw_arms
from train.pictures.color import hex_color
from train.pictures.file import save_figure
from train.pictures.robustness import draw_robustness, write_verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE, DPI = (19.2, 10.8), 100  # [in], [1/in]
WIDTHS = (1.15, 1.3, 0.9, 1.0)  # of the panels above, relative
COMPARED = ("no_impact_map", "no_interim_phase", "published")  # two of them are drawn beside the policy
BEFORE, AFTER = 0.06, 0.2  # of the first contact, for velocities and forces [s]
TORQUES_AFTER = 0.4  # of it, for torques [s]
SPACING = 0.04  # of the arrows of a field [m]
MARGIN = 0.06  # around what is drawn of a field [m]
THIN = 1.0  # [pt]
DASHES = ("-", (0, (4, 1.5)), (0, (1, 1)))  # of the joints
ARMS = tuple(hex_color(color) for color in drawing.ROBOT_COLORS[:2])
BOX, GREY, INK = (hex_color(color) for color in (drawing.OBJECT_COLORS[0], drawing.MUTED, drawing.INK))


class GraspRecord:
    """Hold the controller of an episode, whose references are drawn; the episode itself says the rest.

    Args:
        scenario: where.
        policy: that plays.

    Attributes:
        scenario: where.
        controller: after the episode it still holds its references.

    Raises:
        InputError: a policy without references.
    """

    def __init__(self, scenario: DualArmScenario, policy: Policy) -> None:
        self.scenario, self.controller = scenario, find_controller(policy)

    def add(self, env: Any) -> None:
        """Take no sample."""


def save_grasp_picture(record: GraspRecord, episode: Episode, path: str | Path) -> None:
    """Draw an episode into a file; two other controllers play the same seed for it.

    Args:
        record: what was watched.
        episode: the same one.
        path: of a .png, .pdf or .svg file.

    Raises:
        InputError: an episode without contact, or a file that cannot be written.
    """
    scenario = record.scenario
    others = [name for name in COMPARED if name != episode.policy][:2]
    episodes = {episode.policy: episode} | {
        name: rollout(parallel_env(scenario), make_expert(scenario, variant=name), episode.seed) for name in others
    }
    save_figure(draw_grasp(scenario, record.controller, episodes), path)


def find_controller(policy: Policy) -> ReferenceSpreading:
    """Return the controller whose references a policy follows.

    Args:
        policy: an expert, or a residual on one.

    Raises:
        InputError: it follows none.
    """
    controller = getattr(getattr(policy, "expert", policy), "controller", None)
    if not isinstance(controller, ReferenceSpreading):
        raise InputError(f"policy '{policy.name}' follows no reference to draw; choices: the expert, its variants")
    return controller


def draw_grasp(scenario: DualArmScenario, controller: ReferenceSpreading, episodes: Mapping[str, Episode]) -> Figure:
    """Draw an episode: fields and histories above, the torques of all policies below.

    Args:
        scenario: where.
        controller: after the first episode.
        episodes: policy to what happened, the one in question first.

    Returns:
        A figure of 1920 x 1080 pixels, in no global state.

    Raises:
        InputError: an episode without contact.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    for name, played in episodes.items():
        if not played.impacts:
            raise InputError(f"policy '{name}' touched nothing with seed {played.seed}; there is no impact to draw")
    episode = next(iter(episodes.values()))
    figure = Figure(SIZE, DPI, facecolor=hex_color(drawing.PAPER), layout="constrained")
    FigureCanvasAgg(figure)
    halves = figure.add_gridspec(2, 1, height_ratios=(1.35, 1.0))
    above, below = halves[0].subgridspec(1, 4, width_ratios=WIDTHS), halves[1].subgridspec(1, len(episodes))
    left = above[0].subgridspec(2, 1, height_ratios=(2.4, 1.0))
    _draw_course([figure.add_subplot(left[row]) for row in range(2)], scenario, episode)
    _draw_ante(figure.add_subplot(above[1]), scenario, controller, episode)
    _draw_post(figure.add_subplot(above[2]), scenario, controller, episode)
    rows = above[3].subgridspec(3, 1)
    _draw_impact([figure.add_subplot(rows[row]) for row in range(3)], scenario, controller, episode)
    first: Axes | None = None
    for column, (name, played) in enumerate(episodes.items()):
        axes = figure.add_subplot(below[column], sharey=first)
        _draw_torques(axes, scenario, name, played, labelled=first is None)
        first = first or axes
    figure.suptitle(write_verdict(scenario, episode), fontsize=12)
    return figure


def _draw_course(rows: list[Axes], scenario: DualArmScenario, episode: Episode) -> None:
    """Draw the arms, and below them robustness over the whole episode."""
    draw_arms(rows[0], scenario, episode, _find_hit(episode))
    _finish(rows[0], "arms at start, first contact, end", legend="lower right")
    draw_robustness(rows[1], scenario, episode)
    rows[1].yaxis.label.set_fontsize(7)
    rows[1].set_xlim(episode.times[0], episode.times[-1])
    rows[1].set_xlabel("time [s]", fontsize=8)
    _finish(rows[1], "", legend="lower left")


def _draw_ante(axes: Axes, scenario: DualArmScenario, controller: ReferenceSpreading, episode: Episode) -> None:
    """Draw the velocity fields of the pads, each on its own side of the box, with their radii and the pads' paths."""
    field, signals = controller.field, episode.signals
    hit = _find_hit(episode)
    _draw_bodies(axes, scenario, episode, 0)
    paths = {arm: np.array([signals[f"{arm}.x"][: hit + 1], signals[f"{arm}.y"][: hit + 1]]) for arm in scenario.arms}
    points = np.hstack([*paths.values(), field.box[:2, None] + field.r_max, field.box[:2, None] - field.r_max])
    low, high = points.min(axis=1) - MARGIN, points.max(axis=1) + MARGIN
    size = _measure_box(scenario)
    for i, (arm, color) in enumerate(zip(scenario.arms, ARMS, strict=True)):
        side = (low[0], field.box[0] - size[0]) if i == 0 else (field.box[0] + size[0], high[0])
        grid = _make_grid((side[0], low[1]), (side[1], high[1]))
        velocity = np.array([compute_ante_velocity(field, i, x, y) for x, y in grid])
        axes.quiver(*grid.T, *velocity.T, color=color, alpha=0.55, width=0.0018, scale=16.0, label=None)
        axes.plot(*paths[arm], color=color, lw=2.0, label=f"{arm.replace('_', ' ')}: pad's path")
        axes.plot(*field.points[i], "x", color=INK, ms=6, mew=1.5, label="impact as meant" if i == 0 else None)
    for radius, dashes, label in (
        (field.r_min, "-", "impact velocity within"),
        (field.r_max, "--", "extension alone beyond"),
    ):
        _draw_circle(axes, field.box[:2], radius, dashes, label)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    _finish(axes, "ante-impact reference with its extension", legend="lower right")


def _draw_post(axes: Axes, scenario: DualArmScenario, controller: ReferenceSpreading, episode: Episode) -> None:
    """Draw the velocity field of the box at its target's heading, and the box's way, true and as estimated."""
    signals, target = episode.signals, scenario.target.position
    x, y = signals["box.x"], signals["box.y"]
    middle = np.mean([[signals[f"{arm}.{axis}"] for axis in "xy"] for arm in scenario.arms], axis=0)
    start = controller.post_field.start[:2] if controller.post_field else np.array([x[0], y[0]])
    reach = max(abs(start[0] - target[0]), abs(start[1] - target[1])) / 2.0 + 3.0 * MARGIN
    center = (start + target) / 2.0
    low, high = center - reach, center + reach
    if controller.post_field:
        _draw_box_field(axes, controller.post_field, low, high)
        post = round(controller.switches["post"] / episode.period)
        axes.plot(*middle[:, post:], color=INK, lw=THIN, ls="--", label="middle of the pads")
    axes.plot(x, y, color=BOX, lw=2.0, label="box")
    axes.plot(*target, "x", color=INK, ms=7, mew=1.5, label="target")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    _finish(axes, "post-impact reference of the box", legend="lower right")


def _draw_box_field(axes: Axes, field: PostField, low: np.ndarray, high: np.ndarray) -> None:
    grid = _make_grid(low, high)
    velocity = np.array([compute_post_reference(field, x, y, field.target[2])[:2] for x, y in grid])
    axes.quiver(*grid.T, *velocity.T, color=BOX, alpha=0.6, width=0.003, scale=20.0)
    if field.blend:
        axes.quiver(
            *field.start[:2], *field.twist[:2], color=hex_color(drawing.IMPACT), width=0.006, scale=2.5, zorder=4,
            label="predicted velocity",
        )  # fmt: skip
        _draw_circle(axes, field.start[:2], field.r_max, "--", "blended within")


def _draw_impact(rows: list[Axes], scenario: DualArmScenario, controller: ReferenceSpreading, episode: Episode) -> None:
    """Draw velocities along both axes with their references, and contact forces, over the impact."""
    signals, times = episode.signals, episode.times
    hit = _find_hit(episode)
    shown = slice(max(0, hit - round(BEFORE / episode.period)), hit + round(AFTER / episode.period) + 1)
    ante = slice(shown.start, hit + 1)
    bodies = dict(zip((*scenario.arms, "box"), (*ARMS, BOX), strict=True))
    for axes, axis in zip(rows[:2], (0, 1), strict=True):
        for body, color in bodies.items():
            values = signals[f"{body}.v{'xy'[axis]}"]
            axes.plot(times[shown], values[shown], color=color, lw=THIN, label=body.replace("_", " "))
        for i, arm in enumerate(scenario.arms):
            way = zip(signals[f"{arm}.x"][ante], signals[f"{arm}.y"][ante], strict=True)
            reference = [compute_ante_velocity(controller.field, i, x, y)[axis] for x, y in way]
            label = "reference" if i == 0 else None
            axes.plot(times[ante], reference, color=GREY, lw=THIN, ls="--", label=label)
        if controller.post_field and controller.post_field.blend:
            red = hex_color(drawing.IMPACT)
            axes.plot(controller.switches["post"], controller.predicted[axis], "o", color=red, ms=4, label="predicted")
    for arm, color in zip(scenario.arms, ARMS, strict=True):
        name = arm.replace("_", " ")
        axes = rows[2]
        low, high = signals[f"{arm}.force_min"][shown], signals[f"{arm}.force_max"][shown]
        axes.fill_between(times[shown], low, high, color=color, alpha=0.3, lw=0, label=f"{name}: corners")
        axes.plot(times[shown], high, color=color, lw=THIN)
    titles = ("velocity along x [m/s]", "velocity along y [m/s]", "normal contact forces [N]")
    for axes, title in zip(rows, titles, strict=True):
        _mark_phases(axes, controller, episode)
        axes.set_xlim(times[shown][0], times[shown][-1])
        _finish(axes, title, legend=None)
        axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.03), frameon=False, handlelength=1.2)
    for axes in rows[:2]:
        axes.tick_params(labelbottom=False)
    rows[2].set_xlabel("time [s]", fontsize=8)


def _draw_torques(axes: Axes, scenario: DualArmScenario, name: str, episode: Episode, labelled: bool) -> None:
    """Draw all joint torques around the impact, with their limits."""
    limits = scenario.links.torque_limits
    hit = _find_hit(episode)
    last = min(hit + round(TORQUES_AFTER / episode.period), len(episode.times) - 1)
    shown = slice(max(0, hit - round(2.0 * BEFORE / episode.period)), last)
    for (arm, color), (joint, dashes) in itertools.product(zip(scenario.arms, ARMS, strict=True), enumerate(DASHES)):
        torque = limits[joint] * np.clip(episode.actions[arm][shown, joint], -1.0, 1.0)
        label = f"{arm.replace('_', ' ')}, joint {joint + 1}" if labelled else None
        axes.plot(episode.times[shown], torque, color=color, lw=THIN, ls=dashes, label=label)
    for limit in sorted({sign * limit for limit in limits for sign in (-1.0, 1.0)}):
        axes.axhline(limit, color=GREY, lw=0.6, ls=":")
    axes.axvline(episode.times[hit], color=hex_color(drawing.IMPACT), lw=0.8)
    step = episode.signals["box.torque_step"][hit + 1 : last + 1].max()
    axes.set_xlim(episode.times[shown][0], episode.times[shown][-1])
    axes.set_xlabel("time [s]", fontsize=8)
    _finish(axes, f"{name}: joint torques [N m], largest step {step:.1f}", legend="upper right", columns=2)


def _mark_phases(axes: Axes, controller: ReferenceSpreading, episode: Episode) -> None:
    """Mark every impact by a line and the interim phase by a shade."""
    for impact in episode.impacts:
        axes.axvline(impact.time, color=hex_color(drawing.IMPACT), lw=0.7)
    switches = controller.switches
    if "interim" in switches and "post" in switches:
        axes.axvspan(switches["interim"], switches["post"], color=GREY, alpha=0.12, lw=0, label="interim phase")


def _draw_bodies(axes: Axes, scenario: DualArmScenario, episode: Episode, k: int) -> None:
    """Draw box, pads and table as they are at a sample."""
    for shape in DualArmTask(scenario).shapes():
        if shape.role == "region":
            continue
        corners = np.array(shape.vertices)
        color = GREY
        if shape.body is not None:
            x, y, heading = (episode.signals[f"{shape.body}.{name}"][k] for name in ("x", "y", "heading"))
            c, s = np.cos(heading), np.sin(heading)
            corners = corners @ np.array([[c, s], [-s, c]]) + (x, y)
            color = dict(zip(scenario.arms, ARMS, strict=True)).get(shape.body, BOX)
        axes.fill(*corners.T, facecolor=(color, 0.3), edgecolor=color, lw=THIN)


def _draw_circle(axes: Axes, center: Any, radius: float, dashes: str, label: str) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 120)
    x, y = center[0] + radius * np.cos(angles), center[1] + radius * np.sin(angles)
    axes.plot(x, y, color=GREY, lw=THIN, ls=dashes, label=f"{label} {radius:g} m")


def _make_grid(low: Any, high: Any) -> np.ndarray:
    """Return points inside a rectangle, shape (n, 2) [m]."""
    x, y = (np.arange(a + SPACING / 2.0, b, SPACING) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _measure_box(scenario: DualArmScenario) -> tuple[float, float]:
    return scenario.box.half_width, scenario.box.half_height


def _find_hit(episode: Episode) -> int:
    """Return the sample at which the first pad has touched."""
    return round(episode.impacts[0].time / episode.period)


def _finish(axes: Axes, title: str, legend: Any, columns: int = 1) -> None:
    axes.set_title(title, fontsize=10, loc="left")
    axes.tick_params(labelsize=7)
    axes.grid(color=hex_color(drawing.GRID), lw=0.6)
    if legend and axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7, framealpha=0.85, ncols=columns, loc=legend)
