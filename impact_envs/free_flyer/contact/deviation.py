"""How far the velocity of an object after an impact is from the impact law: a disturbance drawn at every impact.

Compiled scalar functions, for both engines.
"""

from __future__ import annotations

from impact_envs.compiled import compiled
from impact_envs.free_flyer.truth import DICE_MODULUS

MULTIPLIER = 48271.0


@compiled
def roll_dice(dice: float) -> float:
    """Return the next state of a generator, s' = 48271 s mod (2^31 - 1); all products are below 2^53, so exact.

    Source: Park, Miller & Stockmeyer, Communications of the ACM 36(7), 1993, p. 108.
    """
    return MULTIPLIER * dice % DICE_MODULUS


@compiled
def compute_deviation(dice: float, size: float, at_corners: bool) -> float:
    """Return one axis of a deviation: anything from -size to size, or one of the two."""
    share = dice / DICE_MODULUS
    if at_corners:
        return size if share < 0.5 else -size
    return size * (2.0 * share - 1.0)
