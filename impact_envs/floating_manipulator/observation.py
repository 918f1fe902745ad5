"""What a floating manipulator measures. Experts import this module and never the task."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Measurement:
    """One control step's measurements.

    Attributes:
        time: since the start of the episode [s].
        q: base x, y, psi and joint angles, shape (n + 3,) [m], [rad].
        v: their rates, shape (n + 3,) [m/s], [rad/s].
        contact: the arm felt an impact in the last control period.
    """

    time: float
    q: np.ndarray
    v: np.ndarray
    contact: bool
