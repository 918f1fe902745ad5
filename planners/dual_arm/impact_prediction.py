"""Predict the velocity of the box after an impact: simulate impacts on a grid of contact heights, keep them on disk."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from impact_envs.dual_arm.arm import compute_kinematics
from impact_envs.dual_arm.model import DualArmModel
from impact_envs.dual_arm.schema import DualArmScenario
from planners.dual_arm.reference import ImpactMap, compute_ante_velocity, make_impact_map
from planners.dual_arm.reference_spreading import ReferenceSpreading, Settings, make_ante_field

HEIGHTS = np.linspace(-0.05, 0.05, 5)  # of each pad's centre in the box frame [m]
RHO = 15.0  # [1/m]
DURATION = 0.05  # of a simulated impact, within which contact becomes full [s]
VERSION = 1  # raise when the simulation changes what it returns
DIRECTORY = "IMPACT_ENVS_CACHE"  # environment variable
# Tables of a scenario that they do not depend on.
UNUSED = {"name", "description", "formula", "horizon", "control_period", "world", "regions", "suites", "target", "true"}
# Settings that the simulated impacts depend on: all that the ante-impact phase uses, but the soft start.
FIELD = ("impact_velocity", "alpha", "r_min", "r_max", "kappa_theta")
GAINS = ("k_p", "k_theta", "sync_p", "sync_d", "w_p", "w_theta", "w_sync")


def load_impact_map(scenario: DualArmScenario, settings: Settings) -> ImpactMap:
    """Return the prediction for a scenario as it is believed, from disk or simulated now.

    Args:
        scenario: its true physics are not looked at.
        settings: of the controller.

    Returns:
        The prediction.
    """
    believed = scenario.as_believed()
    path = find_cache() / f"impact_map_{hash_inputs(believed, settings)}.npz"
    try:
        with np.load(path, allow_pickle=False) as data:
            heights, twists = data["heights"], data["twists"]
        if heights.shape == (len(HEIGHTS) ** 2, 2) and twists.shape == (len(HEIGHTS) ** 2, 3):
            return make_impact_map(heights, twists, RHO)
    except (OSError, ValueError, KeyError, EOFError):
        pass
    heights, twists = simulate_impacts(believed, settings)
    _store(path, heights, twists)
    return make_impact_map(heights, twists, RHO)


def find_cache() -> Path:
    """Return the directory of predictions: $IMPACT_ENVS_CACHE, or impact_envs in the user's cache directory."""
    if DIRECTORY in os.environ:
        return Path(os.environ[DIRECTORY])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "impact_envs"


def hash_inputs(scenario: DualArmScenario, settings: Settings) -> str:
    """Return a name for everything the simulated impacts depend on.

    Args:
        scenario: as believed.
        settings: of the controller.

    Returns:
        Hexadecimal digits.
    """
    data = scenario.model_dump(mode="json", exclude=UNUSED)
    chosen = {name: getattr(settings, name) for name in (*FIELD, *GAINS)}
    inputs = [VERSION, HEIGHTS.tolist(), DURATION, data, chosen]
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()[:24]


def simulate_impacts(scenario: DualArmScenario, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Simulate simultaneous impacts of rigid arms at a grid of heights.

    Each begins with both pads on their faces, moving at the reference velocity, and lasts 50 ms under ante-impact
    control.

    Args:
        scenario: as believed.
        settings: of the controller.

    Returns:
        Heights, shape (25, 2) [m]; velocities of the box, shape (25, 3) [m/s, rad/s].

    Source: van Steen et al., App. A.
    """
    rigid = scenario.model_copy(update={"joints": scenario.joints.model_copy(update={"flexible": False})})
    model = DualArmModel(rigid)
    physics = rigid.draw(np.random.default_rng(0))
    controller = ReferenceSpreading(
        rigid, None, replace(settings, soft_start=0.0, time_out=np.inf), method="no_impact_map"
    )
    heights = np.array([(first, second) for first in HEIGHTS for second in HEIGHTS])
    twists = []
    for pair in heights:
        model.reset(physics)
        controller.reset()
        model.set_joints(*place_arms(rigid, settings, pair))
        for _ in range(round(DURATION / rigid.tick)):
            q, v = model.joints()
            model.tick(controller.control(q, v, np.zeros(4)))
        twists.append(model.state()[2, [2, 3, 5]])
    return heights, np.array(twists)


def place_arms(scenario: DualArmScenario, settings: Settings, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return joint angles and rates of arms whose pads touch the box at heights, at the reference velocity.

    Args:
        scenario: as believed.
        settings: of the controller.
        heights: of both pads in the box frame, shape (2,) [m].

    Returns:
        Angles and rates, shapes (2, 3) [rad], [rad/s].
    """
    box = scenario.box.start.array
    field = make_ante_field(scenario, settings)
    poses = scenario.contact_poses(box)
    poses[:, :2] += heights[:, None] * np.array([-np.sin(box[2]), np.cos(box[2])])
    q, v = scenario.joint_angles(poses), np.zeros((2, 3))
    pose, J, drift = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    for i, arm in enumerate(scenario.arm_numbers()):
        compute_kinematics(arm, q[i], v[i], pose, J, drift)
        v[i] = np.linalg.solve(J, [*compute_ante_velocity(field, i, pose[0], pose[1]), 0.0])
    return q, v


def _store(path: Path, heights: np.ndarray, twists: np.ndarray) -> None:
    """Write a prediction at once or not at all; a directory that cannot be written is no reason to stop."""
    partial = path.with_name(f"{path.stem}.{os.getpid()}.npz")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(partial, heights=heights, twists=twists)
        os.replace(partial, path)
    except OSError:
        with contextlib.suppress(OSError):
            partial.unlink()
