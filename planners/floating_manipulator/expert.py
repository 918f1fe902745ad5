"""The floating manipulator's expert: OSDRE, safety pause after every impact, recovery of the base by thrusters."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Literal

import numpy as np

from impact_envs.errors import InputError
from impact_envs.floating_manipulator.observation import Measurement, read_observations
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.physics.multibody import compute_directions, compute_momenta
from impact_envs.rollout import Diagnostics
from planners.floating_manipulator.correction import (
    PERIOD,
    UNDER_WAY,
    Correction,
    compute_features,
    compute_tip,
    correction_size,
    feature_size,
    read_correction,
)
from planners.floating_manipulator.osdre import Coefficients, OutputRegulator
from planners.floating_manipulator.pulses import Thrusters

Phase = Literal["before", "pause", "after"]
EFFORT_BEFORE, EFFORT_AFTER = 1.0, 0.1  # R = r 1 before the first impact and after its pause: Nekoo et al., Sec. 4.1
DAMPING = 0.75  # derivative over proportional gains: Nekoo et al., Sec. 4.4
JOINT_DAMPING = 0.5  # of joint motion that the tip does not feel; among 0.25 to 2 the best on tuning seeds [N m s/rad]
AVERAGED = 0.5  # at the end of a pause, from the last pulse on: time over which measured momenta are averaged [s]
THRUSTER_GAIN, WHEEL_GAIN, JOINT_GAIN = 50.0, 200.0, 150.0  # [N/m], [N m/rad], [N m/rad]: Nekoo et al., Sec. 4.4


def make_floating_manipulator_expert(
    scenario: FloatingManipulatorScenario, variant: str | None = None
) -> FloatingManipulatorExpert:
    """Make the expert, or a form of it to compare with.

    Args:
        scenario: its true physics are not looked at.
        variant: ``published``, the paper's OSDRE without compensation; the same as ``printed``, with the coefficients
            that the paper prints; as ``measured_base``, which takes the base's rates from measurements and not from
            the momentum; the expert without.

    Returns:
        A Policy named after the variant.
    """
    if variant is None:
        return FloatingManipulatorExpert(scenario)
    expert = FloatingManipulatorExpert(
        scenario,
        sdc="printed" if variant == "printed" else "absolute_output",
        base_rates="measured" if variant == "measured_base" else "momentum",
        compensated=False,
    )
    expert.name = variant
    return expert


class FloatingManipulatorExpert:
    """Drive the tip to its goal through impacts.

    Before an impact: OSDRE with the base's rates from the momentum, which is zero (Eq. 19). Then a safety pause: no
    torque, or, where the base can be driven, PD control of base and joints back to where they were at the impact. After
    it: OSDRE with a smaller R and the base's rates from the momentum measured at the end of the pause (Eq. 24). Every
    further impact starts a pause anew. Everything is computed from believed masses and measurements.

    Where the base can be driven, so that the goal can be held, the paper's law after the pause is compensated: the
    drift is cancelled, joint motion that the tip does not feel is damped, and the tip keeps off the box. Without it
    the joints keep moving while the tip rests and push it out of its goal, and a box that was only grazed is hit again.
    There, too, the thrusters fire in pulses (`pulses`) and the momentum is a mean over the end of the pause: with noise
    or delay the thrusters would otherwise not come to rest, and one noisy momentum would be believed to the end.

    While the tip is under way, a correction of the OSDRE is awaited every three seconds (`agents.residual`); zero
    changes nothing.

    Args:
        scenario: its true physics are not looked at.
        sdc: form of the OSDRE's state-dependent coefficients.
        base_rates: "momentum" as said, or "measured": taken from the measurement.
        compensated: False is the paper's law everywhere.

    Attributes:
        name: of the policy.
        phase: "before", "pause" or "after".
        correction_size, feature_size: of what `correct` takes and `features` returns.

    Source: Nekoo, Sharf & Ollero, Secs. 2.4, 3 and 4.4; the compensation is not theirs.
    """

    name = "expert"

    def __init__(
        self,
        scenario: FloatingManipulatorScenario,
        sdc: Coefficients = "absolute_output",
        base_rates: Literal["momentum", "measured"] = "momentum",
        compensated: bool = True,
    ) -> None:
        self._scenario = scenario.as_believed()
        self._chain = self._scenario.chain()
        self._regulator = OutputRegulator(self._chain, scenario.arm.goal, sdc)
        self._measured = base_rates == "measured"
        self._compensated = compensated and "base" in scenario.agents
        self._thrusters = self._make_thrusters() if self._compensated else None
        self._n, self._limits = len(scenario.links), scenario.largest_commands
        self.correction_size, self.feature_size = correction_size(scenario), feature_size(scenario)
        self.reset(0)
        self._warm_up()
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode.

        Args:
            seed: unused, the expert is deterministic.
        """
        self.phase: Phase = "before"
        self._diagnostics = Diagnostics()
        self._regulator.reset()
        self._momenta = np.zeros(3)
        self._resume = 0.0
        self._held = start = self._scenario.start
        self._measurement = Measurement(0.0, start, np.zeros(len(start)), False, self._rest())
        self._impacts = self._samples = 0
        self._correction: Correction | None = None
        self._awaiting, self._due, self._seconds = False, 0.0, 0.0

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each agent's action in [-1, 1].

        Args:
            observations: each agent's observation.
        """
        self.observe(observations)
        return self.control()

    def diagnostics(self) -> Diagnostics:
        """Return computing times and fallbacks since reset."""
        return self._diagnostics

    def observe(self, observations: Mapping[str, np.ndarray]) -> None:
        """Take this control step's measurements, and see which phase it is and whether a correction is due.

        Args:
            observations: each agent's observation.
        """
        self.take(read_observations(self._scenario, observations))

    def take(self, measurement: Measurement) -> None:
        """Take this control step's measurements, as `observe` does.

        Args:
            measurement: of this step.
        """
        begin = time.perf_counter()
        self._measurement = measurement
        self._update_phase(measurement)
        due = measurement.time >= self._due - 1e-9
        under_way = self.phase != "pause"
        if under_way and (due or self._correction is not None):
            tip = compute_tip(self._chain, measurement.q, measurement.v)
            under_way = math.dist(tip[:2], self._scenario.arm.goal) > UNDER_WAY
        if not under_way:
            self._due = measurement.time
        self._awaiting = under_way and due
        if self._awaiting or not under_way:
            self._correction = None
        self._seconds = time.perf_counter() - begin

    @property
    def awaiting_correction(self) -> bool:
        """Return whether the next `control` will use up a new correction."""
        return self._awaiting

    def correct(self, correction: np.ndarray) -> None:
        """Set the correction of the coming three seconds.

        A twentieth of the stall torques times c_1 ... c_n is added to the torques; R is multiplied by exp(2 c_n+1),
        the weights of the tip's velocity in Q by exp(2 c_n+2).

        Args:
            correction: c in [-1, 1], shape (n + 2,); zero changes nothing, bit for bit.

        Raises:
            InputError: wrong shape, or no correction is awaited.
        """
        read = read_correction(self._scenario, correction)
        if not self._awaiting:
            raise InputError("no correction is awaited now; see awaiting_correction")
        self._correction = read

    def features(self) -> np.ndarray:
        """Return what a learner may see, shape (2 n + 27,); see `compute_features`."""
        known = self._measurement, self.phase, self._momenta, self._impacts
        return compute_features(self._scenario, self._chain, *known)

    def control(self) -> dict[str, np.ndarray]:
        """Return each agent's action in [-1, 1]."""
        return {
            agent: np.minimum(np.maximum(control / self._limits[agent], -1.0), 1.0)
            for agent, control in self.compute_controls().items()
        }

    def compute_controls(self) -> dict[str, np.ndarray]:
        """Return the controls of one step.

        Returns:
            ``arm`` to joint torques, shape (n,) [N m]; where it can be driven, ``base`` to forces along the world's
            axes and torque, shape (3,) [N], [N m]. Limits and on/off switching are the actuators' own.
        """
        begin = time.perf_counter()
        if self._awaiting:
            self._awaiting, self._due = False, self._measurement.time + PERIOD
        controls = self._recover() if self.phase == "pause" else self._regulate()
        self._diagnostics.solve_seconds.append(self._seconds + time.perf_counter() - begin)
        return {agent: controls[agent] for agent in self._scenario.agents}

    def _warm_up(self) -> None:
        """Run every compiled function once, so that no control step has to wait for the compiler."""
        for self.phase in ("before", "after"):
            self.compute_controls()
        self._measure_momenta(self._measurement)
        self.features()

    def _make_thrusters(self) -> Thrusters | None:
        thrusters, scenario = self._scenario.thrusters, self._scenario
        if thrusters is None:
            return None
        gain = DAMPING * THRUSTER_GAIN
        return Thrusters(thrusters.force, thrusters.dead_zone, gain, scenario.base.mass, scenario.control_period)

    def _rest(self) -> np.ndarray:
        """Return the box at its believed start, at rest, shape (6,)."""
        box = self._scenario.box
        return np.array([*box.start, box.heading, 0.0, 0.0, 0.0])

    def _update_phase(self, measurement: Measurement) -> None:
        if measurement.contact:
            self.phase = "pause"
            self._impacts += 1
            self._resume = measurement.time + self._scenario.safety_pause
            self._held, self._samples = measurement.q.copy(), 0
            if self._thrusters is not None:
                self._thrusters.reset()
        elif self.phase == "pause":
            left = self._resume - 1e-9 - measurement.time
            if left <= (AVERAGED if self._compensated else 0.0):
                self._samples += 1
                self._momenta = self._momenta + (self._measure_momenta(measurement) - self._momenta) / self._samples
            if left <= 0.0:
                self.phase = "after"

    def _measure_momenta(self, measurement: Measurement) -> np.ndarray:
        """Return the manipulator's momenta from measured rates, shape (3,) [N s], [N m s]."""
        w, rates = np.zeros((self._n + 1, 2)), np.zeros(self._n + 1)
        compute_directions(self._chain, measurement.q, measurement.v, w, rates)
        return np.array(compute_momenta(self._chain, measurement.q, measurement.v, w, rates))

    def _regulate(self) -> dict[str, np.ndarray]:
        """Return the OSDRE's torques, corrected; the base is left alone."""
        effort, speed_weight = (EFFORT_BEFORE if self.phase == "before" else EFFORT_AFTER), 1.0
        correction = self._correction
        if correction is not None:
            effort, speed_weight = effort * correction.effort, correction.speed_weight
        momenta = None if self._measured else self._momenta
        q, v = self._measurement.q, self._measurement.v
        torques, source = self._regulator.control(q, v, effort, momenta, speed_weight)
        if source != "riccati":
            self._diagnostics.fallbacks[source] += 1
        compensated = self._compensated and self.phase == "after"
        if compensated:
            self._regulator.compensate(torques, JOINT_DAMPING)
        if correction is not None and correction.torques.any():
            torques += correction.torques
        if compensated:
            self._regulator.keep_off(
                torques, self._measurement.box, self._scenario.box.size, self._scenario.load.radius
            )
        return {"arm": torques, "base": np.zeros(3)}

    def _recover(self) -> dict[str, np.ndarray]:
        """Return the controls of the safety pause: none, or PD to the configuration at the impact."""
        if "base" not in self._scenario.agents:
            return {"arm": np.zeros(self._n)}
        gains = np.array([THRUSTER_GAIN, THRUSTER_GAIN, WHEEL_GAIN, *self._n * [JOINT_GAIN]])
        away = self._measurement.q - self._held
        away[2] = math.remainder(away[2], math.tau)  # psi may be measured up to whole turns
        command = -gains * (away + DAMPING * self._measurement.v)
        if self._thrusters is not None:
            command[:2] = self._thrusters.fire(command[:2])
            if command[:2].any():
                self._samples = 0
        return {"arm": command[3:], "base": command[:3]}
