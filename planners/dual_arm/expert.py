"""The expert of the dual arm: reference spreading as a Policy, from observations and believed physics."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

import numpy as np

from impact_envs.agent_vectors import read_vectors
from impact_envs.dual_arm.observation import ARM, make_layout
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.rollout import Diagnostics
from planners.correction import check_correction
from planners.dual_arm.impact_prediction import load_impact_map
from planners.dual_arm.options import Options, get_options
from planners.dual_arm.readings import Readings
from planners.dual_arm.reference_spreading import ReferenceSpreading


class DualArmExpert:
    """Grasp the box by a simultaneous impact and carry it to the target: a Policy that also takes corrections.

    Of an arm's observation it uses its joint angles and rates, and the normal forces at the two corners of its
    pad, which serve to detect contact and nothing else.

    Args:
        scenario: its true physics are not looked at.
        variant: of `options.VARIANTS`, to compare the expert with; default: the expert itself.
        options: instead of the variant's.

    Attributes:
        name: of the policy.
        correction_size, feature_size: of what `correct` takes and `features` returns.
        controller: what computes the torques.

    Raises:
        InputError: unknown variant or solver, or options that do not fit the scenario.
    """

    correction_size = 2
    feature_size = 22

    def __init__(self, scenario: DualArmScenario, variant: str | None = None, options: Options | None = None) -> None:
        self.name = variant or "expert"
        self.options = options = get_options(variant) if options is None else options
        self._scenario = scenario.as_believed()
        impact_map = load_impact_map(self._scenario, options) if options.controller.impact_map else None
        self.controller = ReferenceSpreading(self._scenario, impact_map, options.controller, options.solver)
        speed = math.hypot(*options.controller.impact_velocity)
        self._readings = Readings(self._scenario, speed, options.readings)
        self._sizes = dict.fromkeys(scenario.arms, make_layout().size)
        self._limits = np.array([scenario.links.torque_limits] * 2, dtype=float)
        self._target = self._scenario.target.array
        self._first, self._every = (
            max(1, round(seconds / self._scenario.control_period))
            for seconds in (options.correction.first, options.correction.period)
        )
        self._warm_up()
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode.

        Args:
            seed: unused, the expert is deterministic.
        """
        self.controller.reset()
        self._readings.reset()
        self._diagnostics = Diagnostics()
        self._rows = np.zeros((2, ARM.size))
        self._seconds = 0.0
        self._awaiting = False
        self._answer, self._applied = np.zeros(2), np.zeros(2)
        self._lag = np.zeros(3)

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each arm's action, joint torques over their limits in [-1, 1], shape (3,); call once per period."""
        self.observe(observations)
        return self.control()

    def diagnostics(self) -> Diagnostics:
        """Return computing times and fallbacks since reset."""
        self._diagnostics.fallbacks = self.controller.fallbacks + self._readings.counts
        return self._diagnostics

    def observe(self, observations: Mapping[str, np.ndarray]) -> None:
        """Read this period's measurements, and decide whether a correction is awaited.

        The first one is awaited shortly after full contact, the next ones periodically, see `CorrectionOptions`.

        Args:
            observations: arm to its observation.

        Raises:
            InputError: an arm is missing or unknown, or an observation has another shape.
        """
        begin = time.perf_counter()
        observed = read_vectors(observations, self._sizes, "observation", finite=False)
        self._rows = np.array([observed[name][: ARM.size] for name in self._scenario.arms])
        self._readings.check(self._rows, self.controller.solution)
        ticks = self.controller.ticks_of_grasp
        self._awaiting = ticks >= self._first and (ticks - self._first) % self._every == 0
        if self._awaiting:
            self._answer = np.zeros(2)
        if ticks > 0:
            share = 1.0 - math.exp(-self._scenario.control_period / self.options.correction.lag_time)
            self._lag += share * (self.controller.reference_error() - self._lag)
        self._seconds = time.perf_counter() - begin

    @property
    def awaiting_correction(self) -> bool:
        """Return whether a correction is due in this control step, and not given yet."""
        return self._awaiting

    def correct(self, correction: np.ndarray) -> None:
        """Set the correction of grip and load, which both approach at a limited rate.

        The grip is multiplied by exp(r c_0), the believed mass and inertia of the box by exp(r c_1), r = `log_range`.

        Args:
            correction: c in [-1, 1], shape (2,); zero changes nothing, bit for bit.

        Raises:
            InputError: wrong shape, or no correction is awaited.
        """
        self._answer = check_correction(correction, self.correction_size, self._awaiting)
        self._awaiting = False

    def features(self) -> np.ndarray:
        """Return what a learner may see of the grasp.

        Returns:
            Shape (22,): time since full contact [s]; duration of the interim phase [s]; height of both pads in the
            believed box's frame at the first contact (2) [m]; normal forces at the pads' corners (4) [N]; target minus
            estimated pose of the box (3) [m, rad], its twist (3), its lag behind the reference (3) and the smoothed lag
            (3) [m/s, rad/s]; the corrections in effect (2). Zeros before full contact.
        """
        controller = self.controller
        if controller.phase != "post":
            return np.zeros(self.feature_size)
        switches = controller.switches
        return np.concatenate(
            [
                [controller.ticks_of_grasp * self._scenario.control_period],
                [switches["post"] - switches.get("interim", switches["post"])],
                controller.heights,
                self._rows[:, ARM["forces"]].ravel(),
                self._target - controller.box[:3],
                controller.box[3:],
                controller.reference_error(),
                self._lag,
                self._applied,
            ]
        )

    def control(self) -> dict[str, np.ndarray]:
        """Return each arm's action in [-1, 1], shape (3,): joint torques over their limits."""
        begin = time.perf_counter()
        self._awaiting = False
        if (self._applied != self._answer).any():
            most = self.options.correction.rate * self._scenario.control_period
            self._applied = self._applied + np.clip(self._answer - self._applied, -most, most)
            grip, weight = np.exp(self.options.correction.log_range * self._applied)
            self.controller.scale_load(float(grip), float(weight))
        q, v, forces = (self._rows[:, ARM[field]].copy() for field in ("angles", "rates", "forces"))
        actions = self.controller.control(q, v, forces.ravel()) / self._limits
        self._diagnostics.solve_seconds.append(self._seconds + time.perf_counter() - begin)
        return dict(zip(self._scenario.arms, actions, strict=True))

    def _warm_up(self) -> None:
        """Pass through all phases once, so that no control step waits for the compiler."""
        q = self._scenario.joint_angles(self._scenario.contact_poses(self._scenario.box.start.array))
        v, force = np.zeros((2, 3)), self.controller.options.contact_force + 1.0
        self.controller.control(q, v, np.zeros(4))
        for _ in range(round(self.controller.options.dwell / self._scenario.control_period) + 1):
            self.controller.control(q, v, np.full(4, force))
        self.controller.reference_error()
