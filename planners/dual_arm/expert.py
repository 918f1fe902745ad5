"""The dual arm's expert: reference spreading as a Policy, from observations and believed physics."""

from __future__ import annotations

import time

import numpy as np

from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.rollout import Diagnostics
from planners.dual_arm.impact_prediction import load_impact_map
from planners.dual_arm.reference_spreading import PAPER, SHIPPED, ReferenceSpreading, Settings


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
    """Grasp the box by a simultaneous impact and carry it to the target.

    An arm's observation begins with its joint angles (3) [rad], its joint rates (3) [rad/s] and the normal forces at
    the two corners of its pad [N], which serve to detect contact and nothing else.

    Args:
        scenario: its true physics are not looked at.
        settings: of the controller; without them `SHIPPED` for the proposed one, `PAPER` for the baselines.
        method: the proposed controller, or one of its baselines.
        solver: of its programs, see `dense_qp.get_solver`.

    Attributes:
        name: of the policy: expert, or the baseline's.
        controller: what computes the torques.

    Raises:
        InputError: unknown method or solver.
    """

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
        self._warm_up()
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode.

        Args:
            seed: unused, the expert is deterministic.
        """
        self.controller.reset()
        self._seconds: list[float] = []

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each arm's action, joint torques over their limits in [-1, 1], shape (3,); one call per period."""
        rows = np.array([observations[name][:8] for name in self._scenario.arms])
        torques = self.control(rows[:, :3].copy(), rows[:, 3:6].copy(), rows[:, 6:].ravel())
        return dict(zip(self._scenario.arms, torques / self._limits, strict=True))

    def control(self, q: np.ndarray, v: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the torques of a control period.

        Args:
            q, v: measured joint angles and rates, shape (2, 3) [rad], [rad/s].
            forces: normal forces at the pads' corners, shape (4,) [N].

        Returns:
            Shape (2, 3) [N m].
        """
        begin = time.perf_counter()
        torques = self.controller.control(q, v, forces)
        self._seconds.append(time.perf_counter() - begin)
        return torques

    def _warm_up(self) -> None:
        """Go once through all phases, so that no step has to wait for the compiler."""
        q, v = (
            self._scenario.joint_angles(self._scenario.contact_poses(self._scenario.box.start.array)),
            np.zeros((2, 3)),
        )
        self.controller.control(q, v, np.zeros(4))
        settings = self.controller.settings
        for _ in range(round(settings.dwell / self._scenario.control_period) + 1):
            self.controller.control(q, v, np.full(4, settings.contact_force + 1.0))

    def diagnostics(self) -> Diagnostics:
        """Return computing times and fallbacks since reset."""
        return Diagnostics(list(self._seconds), self.controller.fallbacks.copy())
