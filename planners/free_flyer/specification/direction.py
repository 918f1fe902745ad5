"""The four axes and the eight directions that impulses, sides and distances are rounded to."""

from __future__ import annotations

import numpy as np

AXES = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# Directions an impulse is rounded to; the robot stands on the opposite side of the object.
DIRECTIONS = np.concatenate([AXES, np.sqrt(0.5) * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])])
