"""The readable form of `planners.dual_arm.phase_machine`: reference spreading as a class, one solver call a tick."""

from __future__ import annotations

import math
from collections import Counter
from contextlib import suppress
from dataclasses import fields
from typing import Literal

import numpy as np

from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.errors import InputError
from planners.dual_arm.control_memory import make_ante_field
from planners.dual_arm.dense_qp import get_solver
from planners.dual_arm.grasp_qp import PostGains, assemble_post, relax_contacts
from planners.dual_arm.options import EXPERT, ControllerOptions
from planners.dual_arm.reference import (
    ImpactMap,
    PostField,
    compute_post_reference,
    compute_smoothstep,
)
from planners.dual_arm.terms import compute_terms, estimate_box, make_terms
from planners.dual_arm.torque_qp import (
    FREE,
    GRASP,
    QDD,
    AnteGains,
    InterimGains,
    TorqueQP,
    assemble_ante,
    assemble_interim,
    make_torque_qp,
)
from planners.errors import PlanningError
from planners.measurement import is_measurement

FADED = 20.0  # time constants after which e^-20 = 2e-9 is left of a step
Phase = Literal["ante", "interim", "post"]


def make_gains(scenario: DualArmScenario, options: ControllerOptions) -> tuple[AnteGains, InterimGains, PostGains]:
    """Return gains and weights of the three programs, and what they need of the believed box and pads."""
    chosen = {field.name: getattr(options, field.name) for field in fields(options)}
    ante = AnteGains(*(chosen[name] for name in AnteGains._fields))
    interim = InterimGains(*(chosen[name] for name in InterimGains._fields))
    post = PostGains(
        **{name: chosen[name] for name in PostGains._fields if name in chosen},
        friction=scenario.believed.friction,
        mass=scenario.box.mass,
        inertia=scenario.box.inertia,
        gravity=scenario.gravity,
        half_height=scenario.links.pad_half_height,
    )
    return ante if options.synchronisation else ante._replace(w_sync=0.0), interim, post


class ReadableSpreading:
    """Control two arms through a simultaneous impact and the grasp that follows; one call per control period.

    The box is never measured: its pose is the believed one until full contact, then the mean of both pads' poses.

    Args:
        scenario: its true physics are not looked at.
        impact_map: predicted velocity of the box after the impact; None only if the options do without.
        options: gains, weights and switches.
        solver: of the quadratic programs, see `dense_qp.get_solver`.

    Attributes:
        phase: "ante", "interim" or "post".
        solution: of the program that gave the last torques; zeros where they are held.
        fallbacks: how often the slack form or the last torques were used.
        switches: phase to the time it began [s].
        qp: the quadratic program solved last, for inspection.
        field, post_field: references before and after the impact; the second is None until full contact.
        box: estimated state of the box after the impact, shape (6,) [m, rad, m/s, rad/s].
        predicted: twist of the box just after the impact, shape (3,) [m/s, rad/s].

    Raises:
        InputError: unknown solver, or no impact map where one is needed.

    Source: van Steen et al., Sec. 4; baselines: Sec. 5.
    """

    def __init__(
        self,
        scenario: DualArmScenario,
        impact_map: ImpactMap | None,
        options: ControllerOptions = EXPERT.controller,
        solver: str = "daqp",
    ) -> None:
        if impact_map is None and options.impact_map:
            raise InputError("expert.controller.impact_map = True needs an impact map, none is given")
        self.options, self._impact_map = options, impact_map
        self._tick = scenario.control_period
        self._limits = np.array([scenario.links.torque_limits] * 2, dtype=float)
        self._arms = scenario.arm_numbers()
        self._ante_gains, self._interim_gains, self._nominal = make_gains(scenario, options)
        self.field = make_ante_field(scenario, options)
        self._target = scenario.target.array
        self._free, self._grasp = make_torque_qp(FREE, self._limits), make_torque_qp(GRASP, self._limits)
        self._terms = make_terms()
        self._solve = get_solver(solver)
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.phase: Phase = "ante"
        self.fallbacks: Counter[str] = Counter()
        self.switches: dict[str, float] = {"ante": 0.0}
        self.qp: TorqueQP = self._free
        self.box, self.predicted = np.zeros(6), np.zeros(3)
        self._count = self._held = self._switched = 0
        self._last, self.solution = np.zeros((2, 3)), np.zeros(FREE[0])
        self._offset = np.zeros((2, 3))
        self._heights: np.ndarray | None = None
        self._integrated = np.zeros((2, 3))
        self.post_field: PostField | None = None
        self._post_gains = self._nominal

    @property
    def ticks_of_grasp(self) -> int:
        """Return the number of ticks controlled since full contact."""
        return self._count - self._switched if self.phase == "post" else 0

    @property
    def heights(self) -> np.ndarray:
        """Return y of both pads in the believed box's frame at the first contact, 0 before, shape (2,) [m]."""
        return np.zeros(2) if self._heights is None else self._heights

    def scale_load(self, grip: float, weight: float) -> None:
        """Scale, until reset, the grip and the believed load.

        Args:
            grip: factor on `ControllerOptions.grip`.
            weight: factor on the box's believed mass and inertia.
        """
        nominal = self._nominal
        self._post_gains = nominal._replace(
            grip=grip * nominal.grip, mass=weight * nominal.mass, inertia=weight * nominal.inertia
        )

    def reference_error(self) -> np.ndarray:
        """Return the post-impact reference minus the box's estimated velocity; 0 before, shape (3,) [m/s, rad/s]."""
        if self.post_field is None:
            return np.zeros(3)
        return np.array(compute_post_reference(self.post_field, *self.box[:3])[:3]) - self.box[3:]

    def control(self, q: np.ndarray, v: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Compute the torques of one tick.

        Args:
            q, v: measured joint angles and rates, shape (2, 3) [rad], [rad/s].
            forces: measured normal forces at the pads' corners, used only to detect contact, shape (4,) [N].

        Returns:
            Shape (2, 3) [N m]; the last torques if a measurement is none (`measurement.py`).
        """
        if not is_measurement((*q.ravel().tolist(), *v.ravel().tolist())):
            return self._hold_torques()
        self._update_phase(q, v, forces.tolist())
        if self.phase == "ante":
            ramp = self._compute_ramp()
            assemble_ante(self._free, self._terms, self.field, self._ante_gains, self._arms, q, v, ramp)
            torques = self._solve_torques(self._free)
        elif self.phase == "interim":
            press = self.options.press * self._compute_rise(self.options.press_rise)
            assemble_interim(
                *(self._free, self._terms, self.field, self._interim_gains, self._arms, q, v),
                *(self._integrated, press, self._tick),
            )
            torques = self._solve_torques(self._free)
        else:
            assert self.post_field is not None
            gains = self._post_gains
            assemble_post(self._grasp, self._terms, self.post_field, gains, self._arms, q, v, self.box)
            torques = self._fade_step(self._solve_torques(self._grasp))
        self._count += 1
        self._last = torques
        return torques

    def _update_phase(self, q: np.ndarray, v: np.ndarray, forces: list[float]) -> None:
        """Enter the next phase when contact begins or is full."""
        if self.phase == "post":
            return
        self._held = self._held + 1 if min(forces) > self.options.contact_force else 0
        if self._heights is None and max(forces) > 0.0:
            compute_terms(self._arms, q, v, self._terms)
            self._heights = self._measure_heights()
            self._first = self._count
            if self.options.interim_phase:
                self._enter_phase("interim")
                self._integrated[:] = self._terms.pose
        late = self._heights is not None and (self._count - self._first) * self._tick >= self.options.time_out
        if self._held >= round(self.options.dwell / self._tick) or late:
            compute_terms(self._arms, q, v, self._terms)
            self._enter_phase("post")
            self.post_field = self._make_post_field()
            self._switched = self._count

    def _compute_rise(self, rise: float) -> float:
        """Return a factor that rises from 0 to 1 over a time after the first contact."""
        return compute_smoothstep((self._count - self._first) * self._tick, 0.0, rise)[0] if rise else 1.0

    def _compute_ramp(self) -> float:
        """Return the factor of the soft start, from 0 to 1."""
        rise = self.options.soft_start
        return compute_smoothstep(self._count * self._tick, 0.0, rise)[0] if rise else 1.0

    def _enter_phase(self, phase: Phase) -> None:
        self.phase = phase
        self.switches[phase] = self._count * self._tick

    def _measure_heights(self) -> np.ndarray:
        """Return y of both pads in the believed box's frame, shape (2,) [m]."""
        box = self.field.box
        away = self._terms.pose[:, :2] - box[:2]
        return away @ np.array([-math.sin(box[2]), math.cos(box[2])])

    def _make_post_field(self) -> PostField:
        """Make the reference that starts at the box's estimated pose and predicted velocity."""
        options = self.options
        estimate_box(self._terms, self.box)
        if options.impact_map:
            assert self._impact_map is not None and self._heights is not None
            map_ = self._impact_map
            inside = np.clip(self._heights, map_.heights.min(axis=0), map_.heights.max(axis=0))
            distances = np.linalg.norm(map_.heights - inside, axis=1)
            self.predicted = map_.weights @ np.exp(-((map_.rho * distances) ** 2))
        return PostField(
            start=self.box[:3].copy(),
            twist=self.predicted,
            target=self._target,
            kappa=options.kappa_post,
            kappa_theta=options.kappa_theta_post,
            r_max=options.r_max_post,
            blend=options.impact_map,
        )

    def _solve_torques(self, qp: TorqueQP) -> np.ndarray:
        """Solve a program; if that fails, solve its slack form; if that fails too, hold the last torques."""
        self.qp = qp
        with suppress(PlanningError):
            return self._take_torques(self._solve(qp))
        if qp is self._grasp:
            with suppress(PlanningError):
                relax_contacts(qp, self.options.w_slack)
                x = self._solve(qp)
                self.fallbacks["slack"] += 1
                return self._take_torques(x)
        self.solution = np.zeros(FREE[0])
        return self._hold_torques()

    def _take_torques(self, x: np.ndarray) -> np.ndarray:
        """Return the torques of a program's solution, and remember it."""
        self.solution = x
        return x[:QDD].reshape(2, 3)

    def _hold_torques(self) -> np.ndarray:
        """Return the last torques, and count the fallback."""
        self.fallbacks["last_torque"] += 1
        return self._last.copy()

    def _fade_step(self, torques: np.ndarray) -> np.ndarray:
        """Add the step of the torques at full contact, fading exponentially."""
        since = (self._count - self._switched) * self._tick
        if since >= FADED * self.options.fade:
            return torques
        if since == 0.0:
            self._offset = self._last - torques
        return np.clip(torques + self._offset * math.exp(-since / self.options.fade), -self._limits, self._limits)
