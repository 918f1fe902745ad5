"""The floating manipulator's expert in its readable form: the oracle of the compiled one."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from impact_envs.floating_manipulator.observation import Measurement
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.physics.multibody import compute_directions, compute_momenta
from impact_envs.rollout import Diagnostics
from planners.correction import check_correction
from planners.floating_manipulator.options import Options, get_options
from tests.impact_envs.floating_manipulator.reading import read_observations
from tests.planners.floating_manipulator.oracle.correction import (
    Correction,
    compute_features,
    compute_tip,
    get_correction_size,
    get_feature_size,
    scale_correction,
)
from tests.planners.floating_manipulator.oracle.output_regulator import OutputRegulator
from tests.planners.floating_manipulator.oracle.pulses import Thrusters
from tests.planners.floating_manipulator.oracle.readings import Readings

Phase = Literal["before", "pause", "after"]


class ReadableExpert:
    """What `FloatingManipulatorExpert` does, in plain Python around the functions of its parts."""

    def __init__(
        self, scenario: FloatingManipulatorScenario, variant: str | None = None, options: Options | None = None
    ) -> None:
        self.name = variant or "expert"
        self.options = options = get_options(variant) if options is None else options
        self._scenario = scenario.as_believed()
        self._chain = self._scenario.chain()
        self._regulator = OutputRegulator(self._chain, scenario.arm.goal, options.regulator)
        self._compensated = options.compensated and "base" in scenario.agents
        self._thrusters = self._make_thrusters() if self._compensated else None
        self._readings = Readings(self._scenario, options.readings)
        self._n, self._limits = len(scenario.links), scenario.largest_commands
        self.correction_size, self.feature_size = get_correction_size(scenario), get_feature_size(scenario)
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
        self._readings.reset()
        self._commanded: dict[str, np.ndarray] | None = None
        self._regulator.reset()
        self._momenta = np.zeros(3)
        self._resume = 0.0
        self._held = start = self._scenario.start
        self._measurement = Measurement(0.0, start, np.zeros(len(start)), False, self._rest())
        self._impacts = self._samples = 0
        self._correction: Correction | None = None
        self._awaiting, self._due, self._seconds = False, 0.0, 0.0

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each agent's action in [-1, 1] for its observation."""
        self.observe(observations)
        return self.control()

    def diagnostics(self) -> Diagnostics:
        """Return computing times and fallbacks since reset."""
        counts = self._diagnostics.fallbacks + self._readings.counts
        return replace(self._diagnostics, fallbacks=counts)

    def observe(self, observations: Mapping[str, np.ndarray]) -> None:
        """Read this control step's measurements, and decide on the phase and whether a correction is awaited.

        What no motion explains is left out, and counted: `readings`.

        Args:
            observations: each agent's observation.

        Raises:
            InputError: an agent is missing or unknown, or an observation has another shape.
        """
        measurement = read_observations(self._scenario, observations)
        self.take_measurement(self._readings.check(measurement, self._commanded))

    def take_measurement(self, measurement: Measurement) -> None:
        """Update the phase and whether a correction is awaited, as `observe` does, from a measurement."""
        begin = time.perf_counter()
        self._measurement = measurement
        self._update_phase(measurement)
        due = measurement.time >= self._due - 1e-9
        under_way = self.phase != "pause"
        if under_way and (due or self._correction is not None):
            tip = compute_tip(self._chain, measurement.q, measurement.v)
            under_way = math.dist(tip[:2], self._scenario.arm.goal) > self.options.correction.goal_distance
        if not under_way:
            self._due = measurement.time
        self._awaiting = under_way and due
        if self._awaiting or not under_way:
            self._correction = None
        self._seconds = time.perf_counter() - begin

    @property
    def awaiting_correction(self) -> bool:
        """Return whether a correction is due in this control step, and not given yet."""
        return self._awaiting

    def correct(self, correction: np.ndarray) -> None:
        """Set the correction until the next one is awaited.

        Add s c_1 ... c_n times the stall torques, s = `torque_share`; multiply R by exp(r c_n+1) and the weights of the
        tip's velocity in Q by exp(r c_n+2), r = `log_range`.

        Args:
            correction: c in [-1, 1], shape (n + 2,); zero changes nothing, bit for bit.

        Raises:
            InputError: wrong shape, or no correction is awaited.
        """
        c = check_correction(correction, self.correction_size, self._awaiting)
        self._correction = scale_correction(self._scenario, c, self.options.correction)
        self._wait_for_next()

    def features(self) -> np.ndarray:
        """Return what a learner may observe, shape (2 n + 27,); see `compute_features`."""
        known = self._measurement, self.phase, self._momenta, self._impacts
        return compute_features(self._scenario, self._chain, *known)

    def control(self) -> dict[str, np.ndarray]:
        """Return each agent's action in [-1, 1]; none, which is counted, where a control is no number."""
        actions = {}
        for agent, control in self.compute_controls().items():
            if np.isnan(control).any():
                control = np.zeros_like(control)
                self._diagnostics.fallbacks["no_action"] += 1
            actions[agent] = np.minimum(np.maximum(control / self._limits[agent], -1.0), 1.0)
        return actions

    def compute_controls(self) -> dict[str, np.ndarray]:
        """Compute the controls of one step.

        Returns:
            ``arm``: joint torques, shape (n,) [N m]; where the base is actuated, ``base``: forces along the world's
            axes and torque, shape (3,) [N], [N m]. The actuators apply their limits and on/off switching.
        """
        begin = time.perf_counter()
        if self._awaiting:
            self._wait_for_next()
        controls = self._recover() if self.phase == "pause" else self._regulate()
        self._diagnostics.solve_seconds.append(self._seconds + time.perf_counter() - begin)
        self._commanded = {agent: controls[agent] for agent in self._scenario.agents}
        return self._commanded

    def _wait_for_next(self) -> None:
        self._awaiting, self._due = False, self._measurement.time + self.options.correction.period

    def _warm_up(self) -> None:
        """Run every compiled function once, so that no control step waits for the compiler."""
        for self.phase in ("before", "after"):
            self.compute_controls()
        self._measure_momenta(self._measurement)
        self.features()

    def _make_thrusters(self) -> Thrusters | None:
        thrusters, scenario = self._scenario.thrusters, self._scenario
        if thrusters is None:
            return None
        force, dead_zone, mass = thrusters.force, thrusters.dead_zone, scenario.base.mass
        return Thrusters(force, dead_zone, mass, scenario.control_period, self.options.recovery)

    def _rest(self) -> np.ndarray:
        """Return the state of the box at its believed start, at rest, shape (6,)."""
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
            if left <= (self.options.recovery.momentum_time if self._compensated else 0.0):
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
        """Return the corrected torques of the OSDRE, and no control of the base."""
        options = self.options.regulator
        effort, speed_weight = (options.effort_before if self.phase == "before" else options.effort_after), 1.0
        correction = self._correction
        if correction is not None:
            effort, speed_weight = effort * correction.effort, correction.speed_weight
        momenta = None if options.measured_base else self._momenta
        q, v = self._measurement.q, self._measurement.v
        torques, source = self._regulator.control(q, v, effort, momenta, speed_weight)
        if source != "riccati":
            self._diagnostics.fallbacks[source] += 1
        compensated = self._compensated and self.phase == "after"
        if compensated:
            self._regulator.compensate_drift(self.options.compensation, torques)
        if correction is not None and correction.torques.any():
            torques += correction.torques
        if compensated:
            box, size = self._measurement.box, self._scenario.box.size
            self._regulator.avoid_box(self.options.compensation, box, size, self._scenario.load.radius, torques)
        return {"arm": torques, "base": np.zeros(3)}

    def _recover(self) -> dict[str, np.ndarray]:
        """Return the controls of the safety pause: none, or PD to the configuration at the impact."""
        if "base" not in self._scenario.agents:
            return {"arm": np.zeros(self._n)}
        options = self.options.recovery
        gains = np.array(
            [options.thruster_gain, options.thruster_gain, options.wheel_gain, *self._n * [options.joint_gain]]
        )
        away = self._measurement.q - self._held
        away[2] = math.remainder(away[2], math.tau)  # psi is measured modulo whole turns
        command = -gains * (away + options.damping * self._measurement.v)
        if self._thrusters is not None:
            command[:2] = self._thrusters.fire(command[:2])
            if command[:2].any():
                self._samples = 0
        return {"arm": command[3:], "base": command[:3]}
