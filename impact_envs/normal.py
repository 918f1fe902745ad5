"""Standard normal numbers of many worlds' streams: those of numpy's ``rng.standard_normal()``, bit for bit.

The tables are numpy's, as numba keeps them to compile the same method.

Source: Marsaglia & Tsang, *The Ziggurat Method for Generating Random Variables*, J. Stat. Softw. 5 (2000), with 256
layers and 52 bits.
"""

from __future__ import annotations

import math

import numpy as np
from numba.np.random import _constants as tables

from impact_envs.compiled import compiled
from impact_envs.stream import ROTATION, WIDTH, WRAP, Word, _advance, next_double

# Per layer: width per unit of a draw, greatest draw that is surely inside, density at the edge.
WIDTHS, INSIDE, DENSITIES = tables.wi_double, tables.ki_double, tables.fi_double
TAIL, TAIL_INVERSE = float(tables.ziggurat_nor_r), float(tables.ziggurat_nor_inv_r)  # where the tail begins
LAYER_MASK, LAYER_BITS, ONE, TAIL_BIT = np.uint64(0xFF), np.uint64(8), np.uint64(1), np.uint64(8)
DRAW_MASK = np.uint64(0x000FFFFFFFFFFFFF)


@compiled
def next_word(streams: np.ndarray, k: int) -> Word:
    """Draw the next 64 bits of world k's stream, shape (worlds, 4) uint64; row k moves on."""
    _advance(streams, k)
    folded = streams[k, 0] ^ streams[k, 1]
    turn = streams[k, 0] >> ROTATION
    return (folded >> turn) | (folded << ((WIDTH - turn) & WRAP))


@compiled
def next_normal(streams: np.ndarray, k: int) -> float:
    """Draw the next standard normal number of world k.

    Args:
        streams: shape (worlds, 4) uint64; row k moves on.
        k: world.
    """
    while True:
        word = next_word(streams, k)
        layer = int(word & LAYER_MASK)
        negative = ((word >> LAYER_BITS) & ONE) != 0
        draw = (word >> (LAYER_BITS + ONE)) & DRAW_MASK
        x = float(draw) * WIDTHS[layer]
        if negative:
            x = -x
        if draw < INSIDE[layer]:
            return x
        if layer == 0:
            beyond = draw_tail(streams, k)
            return -beyond if ((draw >> TAIL_BIT) & ONE) != 0 else beyond
        step = DENSITIES[layer - 1] - DENSITIES[layer]
        if step * next_double(streams, k) + DENSITIES[layer] < math.exp(-0.5 * x * x):
            return x


@compiled
def draw_tail(streams: np.ndarray, k: int) -> float:
    """Draw a number of world k from beyond the last layer."""
    while True:
        x = -TAIL_INVERSE * math.log1p(-next_double(streams, k))
        y = -math.log1p(-next_double(streams, k))
        if y + y > x * x:
            return TAIL + x
