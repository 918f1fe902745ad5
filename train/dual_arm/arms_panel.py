"""Both arms as they stand at the start, at the first contact and at the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from impact_envs.dual_arm.arm import solve_inverse_kinematics
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.dual_arm.task import DualArmTask
from impact_envs.picture import drawing
from impact_envs.rollout import Episode
from train.pictures.color import hex_color

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ARMS = tuple(hex_color(color) for color in drawing.ROBOT_COLORS[:2])
BOX, GREY, EDGE = (hex_color(color) for color in (drawing.OBJECT_COLORS[0], drawing.MUTED, drawing.REGION_EDGE))
OPACITY = (0.3, 0.6, 1.0)  # start, first contact, end
AROUND = 0.05  # what is drawn [m]


def place_joints(scenario: DualArmScenario, episode: Episode, sample: int) -> dict[str, np.ndarray]:
    """Return base, elbow, wrist and pad of each arm, from the pose of its pad.

    Args:
        scenario: where.
        episode: what happened.
        sample: of it.

    Returns:
        Arm to shape (4, 2) [m].
    """
    joints = {}
    for (name, arm), row in zip(scenario.arms.items(), scenario.arm_numbers(), strict=True):
        pose = np.array([episode.signals[f"{name}.{key}"][sample] for key in ("x", "y", "heading")])
        angles = np.cumsum(solve_inverse_kinematics(row, pose, arm.elbow))
        ways = np.array(scenario.links.lengths)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        joints[name] = np.vstack([arm.base, arm.base + np.cumsum(ways, axis=0)])
    return joints


def draw_arms(axes: Axes, scenario: DualArmScenario, episode: Episode, contact: int) -> None:
    """Draw arms, pads and box at three instants, the later the darker, and the box's path.

    Args:
        axes: to draw in.
        scenario: where.
        episode: what happened.
        contact: sample of the first contact.
    """
    last = len(episode.times) - 1
    for shape in DualArmTask(scenario).shapes():
        if shape.body is None and shape.vertices is not None:
            color = EDGE if shape.role == "region" else GREY
            axes.fill(*np.transpose(shape.vertices), facecolor="none", edgecolor=color, lw=1.0)
    for sample, opacity in zip((0, contact, last), OPACITY, strict=True):
        _draw_bodies(axes, scenario, episode, sample, opacity)
        for color, (name, joints) in zip(ARMS, place_joints(scenario, episode, sample).items(), strict=True):
            label = name.replace("_", " ") if sample == last else None
            axes.plot(*joints.T, color=color, alpha=opacity, lw=2.2, solid_capstyle="round", label=label)
            axes.plot(*joints[:3].T, "o", color=color, mfc="white", alpha=opacity, ms=4)
    axes.plot(episode.signals["box.x"], episode.signals["box.y"], color=BOX, lw=1.0, ls="--", label="box's path")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.margins(AROUND)


def _draw_bodies(axes: Axes, scenario: DualArmScenario, episode: Episode, sample: int, opacity: float) -> None:
    for shape in DualArmTask(scenario).shapes():
        if shape.body is None:
            continue
        x, y, heading = (episode.signals[f"{shape.body}.{name}"][sample] for name in ("x", "y", "heading"))
        c, s = np.cos(heading), np.sin(heading)
        corners = np.array(shape.vertices) @ np.array([[c, s], [-s, c]]) + (x, y)
        color = dict(zip(scenario.arms, ARMS, strict=True)).get(shape.body, BOX)
        axes.fill(*corners.T, facecolor=(color, 0.25 * opacity), edgecolor=(color, opacity), lw=1.0)
