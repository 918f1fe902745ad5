"""Time-invariant reference spreading of two arms: ante-impact, interim and post-impact control, and its baselines."""

from __future__ import annotations

import math
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.errors import InputError, choices
from planners.dual_arm.dense_qp import get_solver, relax_contacts
from planners.dual_arm.grasp_program import assemble_post
from planners.dual_arm.programs import (
    FREE,
    GRASP,
    GRIP,
    INERTIA,
    MASS,
    QDD,
    WS,
    Program,
    assemble_ante,
    assemble_interim,
    make_program,
)
from planners.dual_arm.reference import (
    AnteField,
    ImpactMap,
    PostField,
    compute_post_reference,
    compute_smoothstep,
    predict_twist,
)
from planners.dual_arm.terms import compute_terms, estimate_box, make_terms
from planners.errors import PlanningError

METHODS = ("proposed", "no_impact_map", "no_interim_phase", "no_synchronisation")
FADED = 20.0  # time constants after which nothing is left of a step
Phase = Literal["ante", "interim", "post"]


@dataclass(frozen=True)
class Settings:
    """Parameters of the controller; the paper gives none, these are ours.

    The last six are no part of the paper's controller; `PAPER` turns them off. Without `press`, pads that bounce off a
    turned box are brought back by the weak position feedback alone, which can take hundreds of milliseconds. Without
    `grip` the forces are the least inside the believed cone, under which a held weight creeps.

    Args:
        impact_velocity: of the first pad in the box frame, mirrored for the second, shape (2,) [m/s].
        alpha, r_min, r_max, kappa_theta: of the ante-impact field [1/s], [m], [m], [1/s].
        k_p, k_theta: velocity gains before the impact [1/s].
        sync_p, sync_d: gains of the synchronisation [1/s^2], [1/s].
        w_p, w_theta, w_sync: weights before the impact.
        k_int, k_theta_int: position gains during the impact [1/s^2].
        w_p_int, w_theta_int: weights during the impact.
        kappa_post, kappa_theta_post, r_max_post: of the post-impact field [1/s], [1/s], [m].
        k_p_post, k_theta_post: velocity gains after the impact [1/s].
        w_p_post, w_theta_post, w_share, w_normal: weights after the impact; share = equal forces on a pad's corners.
        contact_force: that every corner must exceed for full contact [N].
        dwell: for how long [s].
        press, press_rise: acceleration of both pads towards the box during the impact [m/s^2] and the time over which
            it rises [s].
        soft_start: time over which the feedback gains rise from rest [s].
        fade: time constant with which the step of the torque at full contact fades [s].
        grip: normal force that every corner is drawn to after the impact [N].
        time_out: longest interim phase [s].
    """

    impact_velocity: tuple[float, float] = (0.5, 0.25)
    alpha: float = 20.0
    r_min: float = 0.19
    r_max: float = 0.30
    kappa_theta: float = 8.0
    k_p: float = 120.0
    k_theta: float = 60.0
    sync_p: float = 225.0
    sync_d: float = 30.0
    w_p: float = 1.0
    w_theta: float = 0.1
    w_sync: float = 10.0
    k_int: float = 200.0
    k_theta_int: float = 100.0
    w_p_int: float = 1.0
    w_theta_int: float = 0.1
    kappa_post: float = 4.0
    kappa_theta_post: float = 4.0
    r_max_post: float = 0.25
    k_p_post: float = 60.0
    k_theta_post: float = 60.0
    w_p_post: float = 1.0
    w_theta_post: float = 0.1
    w_share: float = 1e-4
    w_normal: float = 1e-4
    contact_force: float = 1.0
    dwell: float = 0.015
    press: float = 10.0
    press_rise: float = 0.02
    soft_start: float = 0.3
    fade: float = 0.005
    grip: float = 25.0
    time_out: float = math.inf

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "impact_velocity" and not value >= 0.0:
                raise InputError(f"setting {field.name} = {value:g} must not be negative")


SHIPPED = Settings()
# As published, with a reference that turns towards the impact more slowly and looser synchronisation: from far starts
# its pads meet the box beside the middle of its faces, and at different times.
PAPER = Settings(
    alpha=10.0,
    r_min=0.24,
    r_max=0.40,
    kappa_theta=4.0,
    sync_p=100.0,
    sync_d=20.0,
    press=0.0,
    soft_start=0.0,
    fade=0.0,
    grip=0.0,
)


def make_gains(scenario: DualArmScenario, settings: Settings) -> np.ndarray:
    """Collect gains, weights and the box's believed numbers in the order of `programs`, shape (23,)."""
    s, box = settings, scenario.box
    return np.array(
        [
            *(s.k_p, s.k_theta, s.sync_p, s.sync_d, s.w_p, s.w_theta, s.w_sync),
            *(s.k_int, s.k_theta_int, s.w_p_int, s.w_theta_int),
            *(s.k_p_post, s.k_theta_post, s.w_p_post, s.w_theta_post, s.w_share, s.w_normal),
            *(scenario.believed.friction, box.mass, box.inertia, scenario.gravity, scenario.links.pad_half_height),
            s.grip,
        ]
    )


def make_ante_field(scenario: DualArmScenario, settings: Settings) -> AnteField:
    """Make the ante-impact reference towards the middles of the believed box's faces.

    Args:
        scenario: believed physics.
        settings: of the field.

    Returns:
        The reference.

    Raises:
        InputError: the radii do not enclose the impact points.
    """
    box = scenario.box.start.array
    poses = scenario.contact_poses(box)
    if not scenario.box.half_width < settings.r_min < settings.r_max:
        raise InputError(
            f"r_min = {settings.r_min:g} and r_max = {settings.r_max:g} must rise from the box's half width "
            f"{scenario.box.half_width:g}"
        )
    c, d = math.cos(box[2]), math.sin(box[2])
    along, across = settings.impact_velocity
    velocities = [(c * sign * along - d * across, d * sign * along + c * across) for sign in (1.0, -1.0)]
    shape = (settings.alpha, settings.r_min, settings.r_max, settings.kappa_theta)
    return AnteField(poses[:, :2].copy(), np.array(velocities), poses[:, 2].copy(), box, np.array(shape))


class ReferenceSpreading:
    """Control two arms through a simultaneous impact and the grasp that follows; one call per control period.

    The box is never measured: its pose is the believed one until the impact, the mean of both pads after it.

    Args:
        scenario: its true physics are not looked at.
        impact_map: predicted velocity of the box after the impact; needed but for ``no_impact_map``.
        settings: gains and weights.
        method: the proposed controller, or one of its baselines.
        solver: of the programs, see `dense_qp.get_solver`.

    Attributes:
        phase: ante, interim or post.
        fallbacks: how often the slack form or the last torque was used.
        switches: phase to the time it began [s].
        program: the one solved last, for inspection.
        field, post_field: the references before and after the impact; the second is None until full contact.
        box: estimated state of the box after the impact, shape (6,) [m, rad, m/s, rad/s].
        predicted: twist of the box just after the impact, shape (3,) [m/s, rad/s].

    Raises:
        InputError: unknown method, or no impact map where one is needed.

    Source: van Steen et al., Sec. 4; baselines: Sec. 5.
    """

    def __init__(
        self,
        scenario: DualArmScenario,
        impact_map: ImpactMap | None,
        settings: Settings = SHIPPED,
        method: str = "proposed",
        solver: str | None = None,
    ) -> None:
        if method not in METHODS:
            raise InputError(f"method '{method}' is unknown; {choices(method, METHODS)}")
        if impact_map is None and method != "no_impact_map":
            raise InputError(f"method '{method}' needs an impact map")
        self.method, self.settings = method, settings
        self._map = impact_map
        self._tick = scenario.control_period
        self._limits = np.array([scenario.links.torque_limits] * 2, dtype=float)
        self._arms = scenario.arm_numbers()
        self._gains = make_gains(scenario, settings)
        if method == "no_synchronisation":
            self._gains[WS] = 0.0
        self._nominal = self._gains.copy()
        self.field = make_ante_field(scenario, settings)
        self._target = scenario.target.array
        self._free, self._grasp = make_program(FREE, self._limits), make_program(GRASP, self._limits)
        self._terms = make_terms()
        self._solve = get_solver(solver)
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.phase: Phase = "ante"
        self.fallbacks: Counter[str] = Counter()
        self.switches: dict[str, float] = {"ante": 0.0}
        self.program: Program = self._free
        self.box, self.predicted = np.zeros(6), np.zeros(3)
        self._count = self._held = self._switched = 0
        self._last = np.zeros((2, 3))
        self._offset = np.zeros((2, 3))
        self._heights: np.ndarray | None = None
        self._integrated = np.zeros((2, 3))
        self.post_field: PostField | None = None
        self._gains[:] = self._nominal

    @property
    def ticks_of_grasp(self) -> int:
        """Return the number of ticks controlled since full contact."""
        return self._count - self._switched if self.phase == "post" else 0

    @property
    def heights(self) -> np.ndarray:
        """Return y of both pads in the frame of the believed box at the first contact, 0 before, shape (2,) [m]."""
        return np.zeros(2) if self._heights is None else self._heights

    def scale_load(self, grip: float, weight: float) -> None:
        """Change, until reset, what is held on with and what is carried.

        Args:
            grip: factor on `Settings.grip`.
            weight: factor on the box's believed mass and inertia.
        """
        self._gains[GRIP] = grip * self._nominal[GRIP]
        self._gains[[MASS, INERTIA]] = weight * self._nominal[[MASS, INERTIA]]

    def reference_error(self) -> np.ndarray:
        """Return the post-impact reference minus the box's estimated velocity; 0 before, shape (3,) [m/s, rad/s]."""
        if self.post_field is None:
            return np.zeros(3)
        return np.array(compute_post_reference(self.post_field, *self.box[:3])[:3]) - self.box[3:]

    def control(self, q: np.ndarray, v: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the torques of this tick.

        Args:
            q, v: measured joint angles and rates, shape (2, 3) [rad], [rad/s].
            forces: normal forces the pads' corners feel, for the detection of contact only, shape (4,) [N].

        Returns:
            Shape (2, 3) [N m]; the last ones where a measurement is not finite.
        """
        if not math.isfinite(sum(q.ravel().tolist()) + sum(v.ravel().tolist())):
            return self._hold()
        self._switch(q, v, forces.tolist())
        if self.phase == "ante":
            ramp = self._ramp()
            assemble_ante(self._free, self._terms, self.field, self._gains, self._arms, q, v, ramp)
            torques = self._torques(self._free)
        elif self.phase == "interim":
            press = self.settings.press * self._since_impact(self.settings.press_rise)
            assemble_interim(
                *(self._free, self._terms, self.field, self._gains, self._arms, q, v),
                *(self._integrated, press, self._tick),
            )
            torques = self._torques(self._free)
        else:
            assert self.post_field is not None
            assemble_post(self._grasp, self._terms, self.post_field, self._gains, self._arms, q, v, self.box)
            torques = self._fade(self._torques(self._grasp))
        self._count += 1
        self._last = torques
        return torques

    def _switch(self, q: np.ndarray, v: np.ndarray, forces: list[float]) -> None:
        """Move on to the next phase where contact says so."""
        if self.phase == "post":
            return
        self._held = self._held + 1 if min(forces) > self.settings.contact_force else 0
        if self._heights is None and max(forces) > 0.0:
            compute_terms(self._arms, q, v, self._terms)
            self._heights = self._measure_heights()
            self._first = self._count
            if self.method != "no_interim_phase":
                self._enter("interim")
                self._integrated[:] = self._terms.pose
        late = self._heights is not None and (self._count - self._first) * self._tick >= self.settings.time_out
        if self._held >= round(self.settings.dwell / self._tick) or late:
            compute_terms(self._arms, q, v, self._terms)
            self._enter("post")
            self.post_field = self._make_post_field()
            self._switched = self._count

    def _since_impact(self, rise: float) -> float:
        """Return how far something that rises from 0 to 1 after the first contact has come."""
        return compute_smoothstep((self._count - self._first) * self._tick, 0.0, rise)[0] if rise else 1.0

    def _ramp(self) -> float:
        """Return the factor of the soft start."""
        rise = self.settings.soft_start
        return compute_smoothstep(self._count * self._tick, 0.0, rise)[0] if rise else 1.0

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self.switches[phase] = self._count * self._tick

    def _measure_heights(self) -> np.ndarray:
        """Return y of both pads in the frame of the believed box, shape (2,) [m]."""
        box = self.field.box
        away = self._terms.pose[:, :2] - box[:2]
        return away @ np.array([-math.sin(box[2]), math.cos(box[2])])

    def _make_post_field(self) -> PostField:
        """Make the reference that starts at the box's estimated pose and predicted velocity."""
        s = self.settings
        estimate_box(self._terms, self.box)
        blend = self.method != "no_impact_map"
        if blend:
            assert self._map is not None and self._heights is not None
            self.predicted = predict_twist(self._map, self._heights)
        shape = np.array([s.kappa_post, s.kappa_theta_post, s.r_max_post, float(blend)])
        return PostField(self.box[:3].copy(), self.predicted, self._target, shape)

    def _torques(self, program: Program) -> np.ndarray:
        """Solve a program; if that fails its slack form; if that fails too, hold the last torques."""
        self.program = program
        with suppress(PlanningError):
            return self._solve(program)[:QDD].reshape(2, 3)
        if program is self._grasp:
            with suppress(PlanningError):
                x = self._solve(relax_contacts(program))
                self.fallbacks["slack"] += 1
                return x[:QDD].reshape(2, 3)
        return self._hold()

    def _hold(self) -> np.ndarray:
        """Return the last torques, and count it."""
        self.fallbacks["last_torque"] += 1
        return self._last.copy()

    def _fade(self, torques: np.ndarray) -> np.ndarray:
        """Let the step of the torques at full contact fade away."""
        since = (self._count - self._switched) * self._tick
        if since >= FADED * self.settings.fade:
            return torques
        if since == 0.0:
            self._offset = self._last - torques
        return np.clip(torques + self._offset * math.exp(-since / self.settings.fade), -self._limits, self._limits)
