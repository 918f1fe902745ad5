"""The OSDRE as an object: scratch arrays, weights and the last gain around the compiled functions."""

from __future__ import annotations

from typing import Literal

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.floating_manipulator.contact import compute_contact
from impact_envs.physics.multibody import Chain
from planners.floating_manipulator.compensation import avoid_box, compensate_drift
from planners.floating_manipulator.options import COEFFICIENTS, EXPERT, CompensationOptions, RegulatorOptions
from planners.floating_manipulator.osdre import compute_torques, make_output_scratch

Source = Literal["riccati", "last_gain", "none"]


class OutputRegulator:
    """Drive the tip to a goal by OSDRE, with the last gain where the equation has no solution.

    Args:
        chain: base, links and load, as believed.
        goal: of the tip, shape (2,) [m].
        options: weights, and form of the state-dependent coefficients.

    Raises:
        InputError: unknown form of the state-dependent coefficients.
    """

    def __init__(
        self,
        chain: Chain,
        goal: tuple[float, float],
        options: RegulatorOptions = EXPERT.regulator,
    ) -> None:
        form = options.coefficients
        if form not in COEFFICIENTS:
            raise InputError(f"expert.regulator.coefficients '{form}' is unknown; {choices(form, COEFFICIENTS)}")
        self._scratch = make_output_scratch(len(chain.inertia) - 1)
        self._weights = np.array(options.state_weights, dtype=float)
        self._chain, self._goal = chain, np.array(goal, dtype=float)
        self._printed = form == "printed"
        self.reset()

    def reset(self) -> None:
        """Forget the last gain."""
        self._scratch.K[:] = 0.0
        self._known = False
        self._rates = np.zeros(len(self._chain.inertia) - 1)

    def control(
        self,
        q: np.ndarray,
        v: np.ndarray,
        effort: float,
        momenta: np.ndarray | None = None,
        speed_weight: float = 1.0,
    ) -> tuple[np.ndarray, Source]:
        """Return the joint torques, and how they were found.

        Args:
            q, v: coordinates (base x, y, psi, joints) and rates, shape (n + 3,) [m], [rad], [m/s], [rad/s].
            effort: r in R = r 1.
            momenta: P_x, P_y and L about the world's origin, from which the base's rates follow; None: v has them,
                shape (3,) [N s], [N m s].
            speed_weight: factor on the weights of the tip's velocity in Q.

        Returns:
            Torques before the motors' limits, shape (n,) [N m]; "riccati", "last_gain", or "none" (zero torque).
        """
        u, v = np.zeros(len(v) - 3), np.array(v, dtype=float)
        measured = momenta is None
        known = v[:3] if momenta is None else momenta
        case = self._goal, effort, self._printed
        for i in range(4):
            self._scratch.Q[i, i] = self._weights[i] if i < 2 else speed_weight * self._weights[i]
        solved = compute_torques(self._chain, q, v, known, measured, *case, self._scratch, u)
        self._rates = v[3:]
        self._known = self._known or solved
        return u, "riccati" if solved else "last_gain" if self._known else "none"

    def compensate_drift(self, options: CompensationOptions, u: np.ndarray) -> None:
        """Update the torques of this step, shape (n,) [N m], by `compensation.compensate_drift`."""
        compensate_drift(options, self._scratch.drift, self._scratch.B, self._rates, u)

    def avoid_box(
        self,
        options: CompensationOptions,
        box: np.ndarray,
        size: tuple[float, float],
        radius: float,
        u: np.ndarray,
    ) -> None:
        """Update the torques of this step by `compensation.avoid_box`.

        Args:
            options: of the compensation.
            box: x, y, heading, vx, vy, omega, shape (6,) [m], [rad], [m/s], [rad/s].
            size: its length and width [m].
            radius: of the tip [m].
            u: torques, updated, shape (n,) [N m].
        """
        tip = (*self._scratch.z.tolist(), *self._scratch.drift.tolist())
        contact = compute_contact(tip, radius, tuple(box.tolist()), size[0] / 2, size[1] / 2)
        avoid_box(options, contact, self._scratch.B, u)
