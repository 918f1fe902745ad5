"""How much of a scenario's plane is shown."""

from __future__ import annotations

from typing import Any

import numpy as np

from impact_envs.domain import find_part

ARROW_SHARE = 0.1  # an arrow is as long as its change of velocity moves a body in this share of the horizon


def find_view(scenario: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the lower and the upper corner of what is shown [m].

    It is the world, and in domains whose bodies may leave it what they call ``SHOWN_AROUND`` [m] around it.
    """
    around = find_part("impact_envs", scenario.domain, "SHOWN_AROUND") or 0.0
    low, high = np.array(scenario.world.lower) - around, np.array(scenario.world.upper) + around
    return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))
