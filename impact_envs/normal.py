"""Standard normal numbers of many worlds' streams: those of numpy's ``rng.standard_normal()``.

Numbers of the tail, one in 4000, may differ in their last bits, which are the C library's in numpy. The tables are
numpy's, as numba keeps them to compile the same method.

Source: Marsaglia & Tsang, *The Ziggurat Method for Generating Random Variables*, J. Stat. Softw. 5 (2000), with 256
layers and 52 bits.
"""

from __future__ import annotations

import numpy as np
from numba.np.random import _constants as tables

from impact_envs.compiled import compiled
from impact_envs.elementary import exp, log
from impact_envs.stream import ROTATION, WIDTH, WRAP, Word, _advance, next_double

# Per layer: width per unit of a draw, greatest draw that is surely inside, density at the edge.
WIDTHS, INSIDE, DENSITIES = tables.wi_double, tables.ki_double, tables.fi_double
TAIL, TAIL_INVERSE = float(tables.ziggurat_nor_r), float(tables.ziggurat_nor_inv_r)  # where the tail begins
LAYER_MASK, LAYER_BITS, ONE, TAIL_BIT = np.uint64(0xFF), np.uint64(8), np.uint64(1), np.uint64(8)
DRAW_MASK = np.uint64(0x000FFFFFFFFFFFFF)
TWO_TO_64 = 2**64


def draw_normals(rng: np.random.Generator, count: int) -> np.ndarray:
    """Draw standard normal numbers from a generator, which moves on as the stream of a world does.

    Args:
        rng: numpy's PCG64, as gymnasium makes it.
        count: of numbers.

    Returns:
        Shape (count,).
    """
    state, numbers = rng.bit_generator.state, np.empty(count)
    words = state["state"]
    high, low = divmod(words["state"], TWO_TO_64)
    stream = np.array([[high, low, *divmod(words["inc"], TWO_TO_64)]], dtype=np.uint64)
    fill_normals(stream, numbers)
    high, low = stream[0, :2].tolist()
    words["state"] = high * TWO_TO_64 + low
    rng.bit_generator.state = state
    return numbers


@compiled
def fill_normals(streams: np.ndarray, numbers: np.ndarray) -> None:
    """Draw the next standard normal numbers of one stream, shape (1, 4) uint64."""
    for i in range(len(numbers)):
        numbers[i] = next_normal(streams, 0)


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
        if step * next_double(streams, k) + DENSITIES[layer] < exp(-0.5 * x * x):
            return x


@compiled
def draw_tail(streams: np.ndarray, k: int) -> float:
    """Draw a number of world k from beyond the last layer."""
    while True:
        # 1 minus a draw is exact.
        x = -TAIL_INVERSE * log(1.0 - next_double(streams, k))
        y = -log(1.0 - next_double(streams, k))
        if y + y > x * x:
            return TAIL + x
