"""The floating manipulator's expert: OSDRE, safety pause after every impact, recovery of the base by thrusters."""

from __future__ import annotations

import math
import time
from typing import Literal

import numpy as np

from impact_envs.floating_manipulator.observation import Measurement, read_observations
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.physics.multibody import compute_directions, compute_momenta
from impact_envs.rollout import Diagnostics
from planners.floating_manipulator.osdre import Coefficients, OutputRegulator

Phase = Literal["before", "pause", "after"]
EFFORT_BEFORE, EFFORT_AFTER = 1.0, 0.1  # R = r 1 before the first impact and after its pause: Nekoo et al., Sec. 4.1
DAMPING = 0.75  # derivative over proportional gains: Nekoo et al., Sec. 4.4
THRUSTER_GAIN, WHEEL_GAIN, JOINT_GAIN = 50.0, 200.0, 150.0  # [N/m], [N m/rad], [N m/rad]: Nekoo et al., Sec. 4.4


def make_floating_manipulator_expert(
    scenario: FloatingManipulatorScenario, variant: str | None = None
) -> FloatingManipulatorExpert:
    """Make the expert, or a form of it to compare with.

    Args:
        scenario: its true physics are not looked at.
        variant: ``printed``, with the coefficients that the paper prints; ``measured_base``, which takes the base's
            rates from measurements and not from the momentum; the expert without.

    Returns:
        A Policy named after the variant.
    """
    if variant is None:
        return FloatingManipulatorExpert(scenario)
    expert = (
        FloatingManipulatorExpert(scenario, sdc="printed")
        if variant == "printed"
        else FloatingManipulatorExpert(scenario, base_rates="measured")
    )
    expert.name = variant
    return expert


class FloatingManipulatorExpert:
    """Drive the tip to its goal through impacts.

    Before an impact: OSDRE with the base's rates from the momentum, which is zero (Eq. 19). Then a safety pause: no
    torque, or, where the base can be driven, PD control of base and joints back to where they were at the impact. After
    it: OSDRE with a smaller R and the base's rates from the momentum measured at the end of the pause (Eq. 24). Every
    further impact starts a pause anew. Everything is computed from believed masses and measurements.

    Args:
        scenario: its true physics are not looked at.
        sdc: form of the OSDRE's state-dependent coefficients.
        base_rates: "momentum" as said, or "measured": taken from the measurement.

    Attributes:
        name: of the policy.
        phase: "before", "pause" or "after".

    Source: Nekoo, Sharf & Ollero, Secs. 2.4, 3 and 4.4.
    """

    name = "expert"

    def __init__(
        self,
        scenario: FloatingManipulatorScenario,
        sdc: Coefficients = "absolute_output",
        base_rates: Literal["momentum", "measured"] = "momentum",
    ) -> None:
        self._scenario = scenario.as_believed()
        self._chain = self._scenario.chain()
        self._regulator = OutputRegulator(self._chain, scenario.arm.goal, sdc)
        self._measured = base_rates == "measured"
        self._n, self._limits = len(scenario.links), scenario.largest_commands
        self.reset(0)
        start = self._scenario.start
        self.control(Measurement(0.0, start, np.zeros(len(start)), False))  # compiles
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
        self._held = self._scenario.start

    def diagnostics(self) -> Diagnostics:
        """Return computing times and fallbacks since reset."""
        return self._diagnostics

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each agent's action in [-1, 1].

        Args:
            observations: each agent's observation.
        """
        controls = self.control(read_observations(self._scenario, observations))
        return {agent: np.clip(control / self._limits[agent], -1.0, 1.0) for agent, control in controls.items()}

    def control(self, measurement: Measurement) -> dict[str, np.ndarray]:
        """Return the controls of one step.

        Args:
            measurement: of this step.

        Returns:
            ``arm`` to joint torques, shape (n,) [N m]; where it can be driven, ``base`` to forces along the world's
            axes and torque, shape (3,) [N], [N m]. Limits and on/off switching are the actuators' own.
        """
        begin = time.perf_counter()
        self._update_phase(measurement)
        controls = self._recover(measurement) if self.phase == "pause" else self._regulate(measurement)
        self._diagnostics.solve_seconds.append(time.perf_counter() - begin)
        return {agent: controls[agent] for agent in self._scenario.agents}

    def _update_phase(self, measurement: Measurement) -> None:
        if measurement.contact:
            self.phase = "pause"
            self._resume = measurement.time + self._scenario.safety_pause
            self._held = measurement.q.copy()
        elif self.phase == "pause" and measurement.time >= self._resume - 1e-9:
            self.phase = "after"
            self._momenta = self._measure_momenta(measurement)

    def _measure_momenta(self, measurement: Measurement) -> np.ndarray:
        """Return the manipulator's momenta from measured rates, shape (3,) [N s], [N m s]."""
        w, rates = np.zeros((self._n + 1, 2)), np.zeros(self._n + 1)
        compute_directions(self._chain, measurement.q, measurement.v, w, rates)
        return np.array(compute_momenta(self._chain, measurement.q, measurement.v, w, rates))

    def _regulate(self, measurement: Measurement) -> dict[str, np.ndarray]:
        """Return the OSDRE's torques; the base is left alone."""
        effort = EFFORT_BEFORE if self.phase == "before" else EFFORT_AFTER
        momenta = None if self._measured else self._momenta
        torques, source = self._regulator.control(measurement.q, measurement.v, effort, momenta)
        if source != "riccati":
            self._diagnostics.fallbacks[source] += 1
        return {"arm": torques, "base": np.zeros(3)}

    def _recover(self, measurement: Measurement) -> dict[str, np.ndarray]:
        """Return the controls of the safety pause: none, or PD to the configuration at the impact."""
        if "base" not in self._scenario.agents:
            return {"arm": np.zeros(self._n)}
        gains = np.array([THRUSTER_GAIN, THRUSTER_GAIN, WHEEL_GAIN, *self._n * [JOINT_GAIN]])
        away = measurement.q - self._held
        away[2] = math.remainder(away[2], math.tau)  # psi may be measured up to whole turns
        command = -gains * (away + DAMPING * measurement.v)
        return {"arm": command[3:], "base": command[:3]}
