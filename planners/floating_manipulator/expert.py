"""The expert of the floating manipulator: OSDRE, a safety pause after every impact, recovery by thrusters."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from impact_envs.compiled import announce, bind
from impact_envs.floating_manipulator.observation import Measurement, make_layout
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.interface.agent_vectors import read_vectors
from impact_envs.rollout import Diagnostics
from planners.correction import check_correction
from planners.floating_manipulator.correction import get_correction_size, get_feature_size
from planners.floating_manipulator.options import Options, get_options, make_record
from planners.floating_manipulator.world_loop import CONTROL, CORRECT, FEATURES, OBSERVE, START, UPDATE, run_experts
from planners.floating_manipulator.world_memory import (
    COUNTERS,
    PHASES,
    make_expert_memory,
    make_expert_scratch,
    make_expert_table,
)


class FloatingManipulatorExpert:
    """Drive the tip to its goal through impacts.

    Before the first impact: OSDRE with the base's rates from the momentum, which is zero (Eq. 19). Then a safety pause:
    no torque, or, where the base is actuated, PD control of base and joints back to their configuration at the impact.
    After it: OSDRE with a smaller R and the base's rates from the momentum measured at the end of the pause (Eq. 24).
    Every further impact starts another pause. Everything is computed from believed masses and measurements.

    Where the base is actuated, so that the goal can be held, the OSDRE after the pause is compensated (`compensation`):
    without it the joints continue to move while the tip rests and push it off its goal, and a box that was only grazed
    is hit again. There, the thrusters fire in pulses (`pulses`) and the momentum is averaged at the end of the pause:
    otherwise, under noise or delay, the thrusters would never rest, and one noisy momentum would be used to the end.

    While the tip is on its way, a correction of the OSDRE is awaited periodically; zero changes nothing. One world of
    `world_loop.run_experts`.

    Args:
        scenario: its true physics are not looked at.
        variant: of `options.VARIANTS`, to compare the expert with; default: the expert itself.
        options: instead of the variant's.

    Attributes:
        name: of the policy.
        correction_size, feature_size: of what `correct` takes and `features` returns.
        memory: of its one world.

    Raises:
        InputError: unknown variant or form of the coefficients.

    Source: Nekoo, Sharf & Ollero, Secs. 2.4, 3 and 4.4; the compensation is not theirs.
    """

    def __init__(
        self, scenario: FloatingManipulatorScenario, variant: str | None = None, options: Options | None = None
    ) -> None:
        announce(run_experts)
        self.name = variant or "expert"
        self.options = options = get_options(variant) if options is None else options
        self._agents, n = scenario.agents, len(scenario.links)
        self.correction_size, self.feature_size = get_correction_size(scenario), get_feature_size(scenario)
        record, believed = make_record(options), scenario.as_believed()
        table = make_expert_table(believed, options)
        self.memory = make_expert_memory(table, options, 1)
        size = make_layout(scenario).size
        self._sizes = dict.fromkeys(self._agents, size)
        self._joint, self._values = np.zeros((1, size)), np.zeros((1, self.feature_size))
        self._actions = np.zeros((1, n + 3 if len(self._agents) > 1 else n))
        self._arrays = table, self.memory, record, make_expert_scratch(table), self._joint, self._values, self._actions
        parts = {"arm": slice(0, n), "base": slice(n, n + 3)}
        self._parts = {agent: parts[agent] for agent in self._agents}
        self._bind()
        self.reset(0)

    @property
    def phase(self) -> str:
        """Return "before", "pause" or "after"."""
        return PHASES[self.memory.state["phase"][0]]

    def reset(self, seed: int) -> None:
        """Forget the last episode.

        Args:
            seed: unused, the expert is deterministic.
        """
        self._run(START)
        self._solve_seconds: list[float] = []
        self._seconds = 0.0

    def act(self, observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each agent's action in [-1, 1] for its observation."""
        self._read(observations)
        return self._act(OBSERVE | CONTROL)

    def diagnostics(self) -> Diagnostics:
        """Return computing times and fallbacks since reset."""
        counts = {name: int(self.memory.counts[name][0]) for name in COUNTERS}
        return Diagnostics(list(self._solve_seconds), +Counter(counts))

    def observe(self, observations: Mapping[str, np.ndarray]) -> None:
        """Read this control step's measurements, and decide on the phase and whether a correction is awaited.

        What no motion explains is left out, and counted: `readings`.

        Args:
            observations: each agent's observation; they share all sensors.

        Raises:
            InputError: an agent is missing or unknown, or an observation has another shape.
        """
        self._read(observations)
        begin = time.perf_counter()
        self._run(OBSERVE)
        self._seconds = time.perf_counter() - begin

    def take_measurement(self, measurement: Measurement) -> None:
        """Update the phase and whether a correction is awaited, as `observe` does, from a measurement."""
        memory, begin = self.memory, time.perf_counter()
        memory.state["time"], memory.state["contact"] = measurement.time, measurement.contact
        memory.q[0], memory.v[0], memory.box[0] = measurement.q, measurement.v, measurement.box
        self._run(UPDATE)
        self._seconds = time.perf_counter() - begin

    @property
    def awaiting_correction(self) -> bool:
        """Return whether a correction is due in this control step, and not given yet."""
        return bool(self.memory.state["is_awaited"][0])

    def correct(self, correction: np.ndarray) -> None:
        """Set the correction until the next one is awaited.

        Add s c_1 ... c_n times the stall torques, s = `torque_share`; multiply R by exp(r c_n+1) and the weights of the
        tip's velocity in Q by exp(r c_n+2), r = `log_range`.

        Args:
            correction: c in [-1, 1], shape (n + 2,); zero changes nothing, bit for bit.

        Raises:
            InputError: wrong shape, or no correction is awaited.
        """
        c = check_correction(correction, self.correction_size, self.awaiting_correction)
        self._values[0, : self.correction_size] = c
        self._run(CORRECT)

    def features(self) -> np.ndarray:
        """Return what a learner may observe, shape (2 n + 27,); see `correction.write_features`."""
        self._run(FEATURES)
        return self._values[0].copy()

    def control(self) -> dict[str, np.ndarray]:
        """Return each agent's action in [-1, 1]; none, which is counted, where a control is no number."""
        return self._act(CONTROL)

    def compute_controls(self) -> dict[str, np.ndarray]:
        """Compute the controls of one step.

        Returns:
            ``arm``: joint torques, shape (n,) [N m]; where the base is actuated, ``base``: forces along the world's
            axes and torque, shape (3,) [N], [N m]. The actuators apply their limits and on/off switching.
        """
        self._act(CONTROL)
        command = self.memory.command[0]
        controls = {"arm": command[3:].copy(), "base": command[:3].copy()}
        return {agent: controls[agent] for agent in self._agents}

    def _read(self, observations: Mapping[str, np.ndarray]) -> None:
        seen = read_vectors(observations, self._sizes, "observation", finite=False)
        self._joint[0] = seen[self._agents[0]]
        self._seconds = 0.0

    def _act(self, parts: int) -> dict[str, np.ndarray]:
        """Do the last parts of a control period; return each agent's action."""
        begin = time.perf_counter()
        self._run(parts)
        self._solve_seconds.append(self._seconds + time.perf_counter() - begin)
        return {agent: self._actions[0, part].copy() for agent, part in self._parts.items()}

    def _bind(self) -> None:
        self._call = bind(run_experts, *self._arrays, START, 0, 0)  # of no world

    def _run(self, parts: int) -> None:
        self._call(*self._arrays, parts, 0, 1)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_call"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()
