"""On/off thrusters under noise and delay: one pulse, then a rest in which its effect is measured.

A force that is switched anew every period by what was measured a period ago overshoots, is reversed and overshoots
again, without end; so does one that is switched by noise.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

REST, MEASURED = 6, 4  # control periods without force after a pulse, and of these the last ones, that are averaged


class Thrusters:
    """Turn a wanted force into pulses.

    A pulse starts where the mean f of the last `MEASURED` wanted forces of an axis exceeds the dead zone. It lasts
    m |f| / (k F) and at least one period: it takes away the speed |f| / k from a base of mass m alone, and so at most
    that from a base with an arm. In the first periods of the rest the measurements may be older than the pulse.

    Args:
        force: F of a thruster that is on [N].
        dead_zone: smaller wanted forces leave it off [N].
        speed_gain: k, wanted force per speed [N s/m].
        mass: m of the base alone [kg].
        period: of control [s].
    """

    def __init__(self, force: float, dead_zone: float, speed_gain: float, mass: float, period: float) -> None:
        self._force, self._dead_zone = force, dead_zone
        self._periods = mass / (speed_gain * force * period)  # of a pulse, per wanted force [1/N]
        self.reset()

    def reset(self) -> None:
        """Forget pulses and wanted forces."""
        self._wanted: tuple[deque[float], ...] = (deque(maxlen=MEASURED), deque(maxlen=MEASURED))
        self._on, self._rest, self._sign = [0, 0], [0, 0], [1.0, 1.0]

    def fire(self, wanted: np.ndarray) -> np.ndarray:
        """Return the forces of this control period, each 0 or of a thruster that is on.

        Args:
            wanted: along the world's axes, shape (2,) [N].
        """
        return np.array([self._fire(axis, float(force)) for axis, force in enumerate(wanted)])

    def _fire(self, axis: int, wanted: float) -> float:
        memory = self._wanted[axis]
        memory.append(wanted)
        if self._on[axis] == 0 and self._rest[axis] == 0 and len(memory) == MEASURED:
            mean = sum(memory) / MEASURED
            if abs(mean) > self._dead_zone:
                self._on[axis], self._rest[axis] = max(1, math.floor(self._periods * abs(mean))), REST
                self._sign[axis] = math.copysign(1.0, mean)
        if self._on[axis] > 0:
            self._on[axis] -= 1
            return self._sign[axis] * self._force
        self._rest[axis] = max(self._rest[axis] - 1, 0)
        return 0.0
