"""Predict the velocity of the box after an impact: simulate impacts at a grid of contact heights, keep them on disk."""

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
from impact_envs.elementary import cos_sin
from impact_envs.errors import InputError
from impact_envs.file import replace_file
from planners.dual_arm.control_memory import make_ante_field
from planners.dual_arm.options import ControllerOptions, Options, PredictionOptions
from planners.dual_arm.reference import ImpactMap, compute_ante_velocity, make_impact_map
from planners.dual_arm.reference_spreading import ReferenceSpreading
from planners.dual_arm.terms import find_rates

VERSION = 2  # raise when the simulation changes what it returns
DIRECTORY = "IMPACT_ENVS_CACHE"  # environment variable
# Tables of a scenario that simulated impacts do not depend on.
UNUSED = {"name", "description", "formula", "horizon", "control_period", "world", "regions", "suites", "target", "true"}
# Controller options that they depend on: all of the ante-impact phase except the soft start.
FIELD = ("impact_velocity", "alpha", "r_min", "r_max", "kappa_theta")
GAINS = ("k_p", "k_theta", "sync_p", "sync_d", "w_p", "w_theta", "w_sync")


def load_impact_map(scenario: DualArmScenario, options: Options) -> ImpactMap:
    """Return the prediction for a scenario as it is believed, read from disk or simulated now.

    Args:
        scenario: its true physics are not looked at.
        options: of controller and prediction.
    """
    believed, count = scenario.as_believed(), options.prediction.heights**2
    path = find_cache() / f"impact_map_{hash_inputs(believed, options)}.npz"
    try:
        with np.load(path, allow_pickle=False) as data:
            heights, twists = data["heights"], data["twists"]
        if heights.shape == (count, 2) and twists.shape == (count, 3):
            return make_impact_map(heights, twists, options.prediction.rho)
    except (OSError, ValueError, KeyError, EOFError):
        pass
    heights, twists = simulate_impacts(believed, options)
    _store_impacts(path, heights, twists)
    return make_impact_map(heights, twists, options.prediction.rho)


def find_cache() -> Path:
    """Return the directory of predictions: $IMPACT_ENVS_CACHE, or impact_envs in the user's cache directory."""
    if DIRECTORY in os.environ:
        return Path(os.environ[DIRECTORY])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "impact_envs"


def hash_inputs(scenario: DualArmScenario, options: Options) -> str:
    """Return a hexadecimal name for everything that the simulated impacts depend on.

    Args:
        scenario: as believed.
        options: of controller and prediction.
    """
    data = scenario.model_dump(mode="json", exclude=UNUSED)
    chosen = {name: getattr(options.controller, name) for name in (*FIELD, *GAINS)}
    inputs = [VERSION, _list_heights(options.prediction).tolist(), options.prediction.duration, data, chosen]
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()[:24]


def simulate_impacts(scenario: DualArmScenario, options: Options) -> tuple[np.ndarray, np.ndarray]:
    """Simulate simultaneous impacts of rigid arms at a grid of heights.

    Each begins with both pads on their faces at the reference velocity, and continues under ante-impact control.

    Args:
        scenario: as believed.
        options: of controller and prediction; its switches are ignored.

    Returns:
        Heights, shape (heights^2, 2) [m]; velocities of the box, shape (heights^2, 3) [m/s, rad/s].

    Source: van Steen et al., App. A.
    """
    rigid = scenario.model_copy(update={"joints": scenario.joints.model_copy(update={"flexible": False})})
    model = DualArmModel(rigid)
    physics = rigid.draw(np.random.default_rng(0))
    ante_only = replace(
        options.controller, soft_start=0.0, time_out=np.inf, impact_map=False, interim_phase=True, synchronisation=True
    )
    # With our own solver, whichever is chosen: friction that chatters amplifies the last bits of torques to 1e-6 m/s
    # beside the middle, and a library's next version may bring others.
    controller = ReferenceSpreading(rigid, None, ante_only)
    single = _list_heights(options.prediction)
    heights = np.array([(first, second) for first in single for second in single])
    twists = []
    for pair in heights:
        model.reset(physics)
        controller.reset()
        model.set_joints(*place_arms(rigid, options.controller, pair))
        for _ in range(round(options.prediction.duration / rigid.tick)):
            q, v = model.joints()
            model.tick(controller.control(q, v, np.zeros(4)))
        twists.append(model.state()[2, [2, 3, 5]])
    return heights, np.array(twists)


def place_arms(
    scenario: DualArmScenario, controller: ControllerOptions, heights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return joint angles and rates of arms whose pads touch the box at given heights, at the reference velocity.

    Args:
        scenario: as believed.
        controller: options of the reference.
        heights: of both pads in the box frame, shape (2,) [m].

    Returns:
        Angles and rates, shapes (2, 3) [rad], [rad/s].

    Raises:
        InputError: an arm is stretched there, so that no rates give the velocity.
    """
    box = scenario.box.start.array
    field = make_ante_field(scenario, controller)
    poses = scenario.contact_poses(box)
    c, s = cos_sin(float(box[2]))
    poses[:, :2] += heights[:, None] * np.array([-s, c])
    q, v = scenario.joint_angles(poses), np.zeros((2, 3))
    pose, J, drift = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    for i, arm in enumerate(scenario.arm_numbers()):
        compute_kinematics(arm, q[i], v[i], pose, J, drift)
        found, *v[i] = find_rates(J, *compute_ante_velocity(field, i, pose[0], pose[1]), 0.0)
        if not found:
            raise InputError(f"{scenario.name}: arm {i + 1} is stretched at the box: its pad cannot hit it as planned")
    return q, v


def _list_heights(prediction: PredictionOptions) -> np.ndarray:
    """Return the simulated heights of each pad's centre in the box frame, shape (heights,) [m]."""
    return np.linspace(-prediction.greatest_height, prediction.greatest_height, prediction.heights)


def _store_impacts(path: Path, heights: np.ndarray, twists: np.ndarray) -> None:
    """Write simulated impacts all or nothing; do nothing where the directory cannot be written."""
    with contextlib.suppress(InputError), replace_file(path) as partial:
        np.savez(partial, heights=heights, twists=twists)
