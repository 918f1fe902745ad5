"""On/off thrusters under noise and delay: one pulse, then a rest in which its effect is measured.

A force that is switched every period by an old or noisy measurement overshoots, reverses and overshoots again, forever.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from planners.floating_manipulator.options import EXPERT, RecoveryOptions


class Thrusters:
    """Turn a desired force into pulses.

    A pulse starts where the mean f of the last `pulse_samples` desired forces of an axis exceeds the dead zone. It
    lasts m |f| / (k F), and at least one period: it removes the speed |f| / k from a base of mass m without an arm, and
    so at most that from a base with an arm. k is the desired force per speed, `damping` times `thruster_gain` [N s/m].

    Args:
        force: F of a thruster that is on [N].
        dead_zone: smaller desired forces leave it off [N].
        mass: m of the base alone [kg].
        period: of control [s].
        options: gains, samples and rest.
    """

    def __init__(
        self, force: float, dead_zone: float, mass: float, period: float, options: RecoveryOptions = EXPERT.recovery
    ) -> None:
        self._force, self._dead_zone = force, dead_zone
        speed_gain = options.damping * options.thruster_gain
        self._periods = mass / (speed_gain * force * period)  # of a pulse, per desired force [1/N]
        self._samples, self._pause = options.pulse_samples, options.pulse_rest
        self.reset()

    def reset(self) -> None:
        """Forget pulses and desired forces."""
        self._desired: tuple[deque[float], ...] = (deque(maxlen=self._samples), deque(maxlen=self._samples))
        self._on, self._rest, self._sign = [0, 0], [0, 0], [1.0, 1.0]

    def fire(self, desired: np.ndarray) -> np.ndarray:
        """Return the forces of this control period: per axis 0, or the force of a thruster that is on.

        Args:
            desired: along the world's axes, shape (2,) [N].
        """
        return np.array([self._fire_axis(axis, float(force)) for axis, force in enumerate(desired)])

    def _fire_axis(self, axis: int, desired: float) -> float:
        memory = self._desired[axis]
        memory.append(desired)
        if self._on[axis] == 0 and self._rest[axis] == 0 and len(memory) == self._samples:
            mean = sum(memory) / self._samples
            if abs(mean) > self._dead_zone:
                self._on[axis], self._rest[axis] = max(1, math.floor(self._periods * abs(mean))), self._pause
                self._sign[axis] = math.copysign(1.0, mean)
        if self._on[axis] > 0:
            self._on[axis] -= 1
            return self._sign[axis] * self._force
        self._rest[axis] = max(self._rest[axis] - 1, 0)
        return 0.0
