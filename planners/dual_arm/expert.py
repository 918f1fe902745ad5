"""The dual arm's expert: reference spreading as a Policy, from observations and believed physics."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

import numpy as np

from impact_envs.dual_arm.observation import ARM
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.errors import InputError
from impact_envs.rollout import Diagnostics
from planners.dual_arm.impact_prediction import load_impact_map
from planners.dual_arm.reference_spreading import PAPER, SHIPPED, ReferenceSpreading, Settings

FIRST_DECISION = 0.02  # after full contact, when it shows how heavy the box is [s]
DECISION_PERIOD = 0.25  # between corrections [s]
RANGE = 0.7  # of the logarithms of grip and load, at correction 1
SLEW = 50.0  # greatest rate of a correction [1/s]
SMOOTHING = 0.05  # time constant of the smoothed lag [s]


def make_dual_arm_expert(scenario: DualArmScenario, variant: str | None = None) -> DualArmExpert:
    """Make the expert, or what it is compared with.

    Args:
        scenario: its true physics are not looked at.
        variant: ``published``, the proposed controller without what it does not have in the paper, or a baseline of
            `reference_spreading.METHODS`; the expert without.

    Returns:
        A Policy named after the variant.

    Raises:
        InputError: unknown variant.
    """
    if variant is None:
        return DualArmExpert(scenario)
    expert = DualArmExpert(scenario, PAPER, "proposed" if variant == "published" else variant)
    expert.name = variant
    return expert


class DualArmExpert:
    """Grasp the box by a simultaneous impact and carry it to the target: a Policy that also takes corrections.

    Of an arm's observation it uses its joint angles and rates, and the normal forces at the two corners of its
    pad, which serve to detect contact and nothing else.

    Args:
        scenario: its true physics are not looked at.
        settings: of the controller; without them `SHIPPED` for the proposed one, `PAPER` for the baselines.
        method: the proposed controller, or one of its baselines.
        solver: of its programs, see `dense_qp.get_solver`.

    Attributes:
        name: of the policy: expert, or the baseline's.
        correction_size, feature_size: of what `correct` takes and `features` returns.
        controller: what computes the torques.

    Raises:
        InputError: unknown method or solver.
    """

    correction_size = 2
    feature_size = 22

    def __init__(
        self,
        scenario: DualArmScenario,
        settings: Settings | None = None,
        method: str = "proposed",
        solver: str | None = None,
    ) -> None:
        self.name = "expert" if method == "proposed" else method
        self._scenario = scenario.as_believed()
        settings = settings or (SHIPPED if method == "proposed" else PAPER)
        impact_map = None if method == "no_impact_map" else load_impact_map(self._scenario, settings)
        self.controller = ReferenceSpreading(self._scenario, impact_map, settings, method, solver)
        self._limits = np.array([scenario.links.torque_limits] * 2, dtype=float)
        self._target = self._scenario.target.array
        self._first, self._every = (
            max(1, round(seconds / self._scenario.control_period)) for seconds in (FIRST_DECISION, DECISION_PERIOD)
        )
        self._warm_up()
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode.

        Args:
            seed: unused, the expert is deterministic.
        """
        self.controller.reset()
        self._diagnostics = Diagnostics()
        self._rows = np.zeros((2, ARM.size))
        self._seconds = 0.0
        self._awaiting = False
        self._answer, self._applied = np.zeros(2), np.zeros(2)
        self._lag = np.zeros(3)

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each arm's action, joint torques over their limits in [-1, 1], shape (3,); one call per period."""
        self.observe(observations)
        return self.control()

    def diagnostics(self) -> Diagnostics:
        """Return computing times and fallbacks since reset."""
        self._diagnostics.fallbacks = self.controller.fallbacks.copy()
        return self._diagnostics

    def observe(self, observations: Mapping[str, np.ndarray]) -> None:
        """Take this period's measurements and see whether a correction is due.

        The first one is 20 ms after full contact, the others follow every 0.25 s.

        Args:
            observations: arm to its observation.
        """
        begin = time.perf_counter()
        self._rows = np.array([observations[name][: ARM.size] for name in self._scenario.arms])
        ticks = self.controller.ticks_of_grasp
        self._awaiting = ticks >= self._first and (ticks - self._first) % self._every == 0
        if self._awaiting:
            self._answer = np.zeros(2)
        if ticks > 0:
            share = 1.0 - math.exp(-self._scenario.control_period / SMOOTHING)
            self._lag += share * (self.controller.reference_error() - self._lag)
        self._seconds = time.perf_counter() - begin

    @property
    def awaiting_correction(self) -> bool:
        """Return whether the next `control` will use a new correction."""
        return self._awaiting

    def correct(self, correction: np.ndarray) -> None:
        """Set the correction of grip and load, towards which both move by at most 1 in 20 ms.

        The grip is multiplied by exp(0.7 c_0), the believed mass and inertia of the box by exp(0.7 c_1).

        Args:
            correction: c in [-1, 1], shape (2,); zero changes nothing, bit for bit.

        Raises:
            InputError: wrong shape, or no correction is awaited.
        """
        values = np.asarray(correction, dtype=float)
        if values.shape != (2,) or not np.isfinite(values).all():
            raise InputError(f"correction must be 2 finite numbers, got {np.array2string(values, threshold=8)}")
        if not self._awaiting:
            raise InputError("no correction is awaited now; see awaiting_correction")
        self._answer = np.clip(values, -1.0, 1.0)

    def features(self) -> np.ndarray:
        """Return what a learner may see of the grasp.

        Returns:
            Shape (22,): time since full contact [s]; duration of the interim phase [s]; height of both pads in the
            believed box at the first contact (2) [m]; normal forces at the pads' corners (4) [N]; target minus
            estimated pose of the box (3) [m, rad], its twist (3) and how much it lags behind the reference (3), and
            that smoothed over 50 ms (3) [m/s, rad/s]; the corrections in force (2). Zeros before full contact.
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
            most = SLEW * self._scenario.control_period
            self._applied = self._applied + np.clip(self._answer - self._applied, -most, most)
            grip, weight = np.exp(RANGE * self._applied)
            self.controller.scale_load(float(grip), float(weight))
        q, v, forces = (self._rows[:, ARM[field]].copy() for field in ("angles", "rates", "forces"))
        actions = self.controller.control(q, v, forces.ravel()) / self._limits
        self._diagnostics.solve_seconds.append(self._seconds + time.perf_counter() - begin)
        return dict(zip(self._scenario.arms, actions, strict=True))

    def _warm_up(self) -> None:
        """Go once through all phases, so that no step has to wait for the compiler."""
        q = self._scenario.joint_angles(self._scenario.contact_poses(self._scenario.box.start.array))
        v, force = np.zeros((2, 3)), self.controller.settings.contact_force + 1.0
        self.controller.control(q, v, np.zeros(4))
        for _ in range(round(self.controller.settings.dwell / self._scenario.control_period) + 1):
            self.controller.control(q, v, np.full(4, force))
        self.controller.reference_error()
