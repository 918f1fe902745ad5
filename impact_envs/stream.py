"""Random streams of many worlds: numpy's generator as compiled scalar functions.

A stream is numpy's ``Generator(PCG64(SeedSequence(seed)))``, which gymnasium makes of a seed, as one row of four
64-bit words: state high, state low, increment high, increment low. World k draws the doubles that ``rng.random()``
draws, bit for bit.

Source: O'Neill, *PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for Random Number
Generation* (2014), XSL-RR 128/64; ``numpy.random.SeedSequence``, after O'Neill, *Developing a seed_seq Alternative*
(2015).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin, log
from impact_envs.errors import InputError

WORDS = 4  # of a stream, and of the pool that a seed is hashed into
LARGEST_SEED = 2**63 - 1
Word = np.uint64
# All sums and products below are of 32-bit halves, and so stay below 2**64: numpy would warn of an overflow.
HALF = np.uint64(32)
LOW = np.uint64(0xFFFFFFFF)
ZERO, ONE = np.uint64(0), np.uint64(1)
# Multiplier of the generator, lowest 32 bits first.
M0, M1, M2, M3 = np.uint64(0x9FCCF645), np.uint64(0x4385DF64), np.uint64(0x1FC65DA4), np.uint64(0x2360ED05)
ROTATION, WIDTH, WRAP = np.uint64(58), np.uint64(64), np.uint64(63)
UNUSED_BITS, DOUBLE_STEP = np.uint64(11), 2.0**-53
# Hashing of a seed.
INIT_A, MULT_A = np.uint64(0x43B0D7E5), np.uint64(0x931E8875)
INIT_B, MULT_B = np.uint64(0x8B51F9DD), np.uint64(0x58F38DED)
MIX_LEFT, MIX_RIGHT = np.uint64(0xCA01F9DD), np.uint64(0x4973F715)
SHIFT, TWO_TO_32 = np.uint64(16), np.uint64(0x100000000)


def seed_streams(seeds: Sequence[int] | np.ndarray) -> np.ndarray:
    """Start one stream per seed.

    Args:
        seeds: from 0 to 2**63 - 1, shape (worlds,).

    Returns:
        Streams, shape (worlds, 4) uint64.

    Raises:
        InputError: a seed that is not such a number.
    """
    rows = np.asarray(seeds)
    if rows.ndim != 1:
        raise InputError(f"seeds have shape {rows.shape}: one number per world is needed")
    if rows.dtype.kind in "iu":
        wrong = (rows < 0) | (rows > LARGEST_SEED)
    else:
        wrong = np.array([not (isinstance(seed, int) and 0 <= seed <= LARGEST_SEED) for seed in seeds], dtype=bool)
    if np.any(wrong):
        world = int(np.argmax(wrong))
        raise InputError(f"seed of world {world} = {seeds[world]}: a whole number from 0 to 2**63 - 1 is needed")
    streams = np.empty((len(rows), WORDS), dtype=np.uint64)
    _seed_all(streams, rows.astype(np.uint64))
    return streams


def check_seed(seed: Any, what: str = "seed") -> int:
    """Return a seed of an episode.

    Args:
        seed: a whole number from 0 to 2**63 - 1.
        what: what to call it in an error.

    Raises:
        InputError: anything else.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"{what} = {seed!r}: a whole number from 0 to 2**63 - 1 is needed")
    return int(seed)


def draw_doubles(streams: np.ndarray, worlds: np.ndarray, count: int) -> np.ndarray:
    """Draw the next doubles of some worlds; the other streams stay where they are.

    Args:
        streams: shape (worlds, 4) uint64, changed in place.
        worlds: whose, their numbers, shape (m,), or a mask, shape (worlds,).
        count: doubles per world.

    Returns:
        Uniform in [0, 1), shape (m, count).
    """
    chosen = streams[worlds]
    doubles = np.empty((len(chosen), count))
    _draw_all(chosen, doubles)
    streams[worlds] = chosen
    return doubles


@compiled
def next_double(streams: np.ndarray, k: int) -> float:
    """Draw the next double of world k, ``rng.random()``.

    Args:
        streams: shape (worlds, 4) uint64; row k moves on.
        k: world.

    Returns:
        Uniform in [0, 1).
    """
    _advance(streams, k)
    folded = streams[k, 0] ^ streams[k, 1]
    turn = streams[k, 0] >> ROTATION
    bits = (folded >> turn) | (folded << ((WIDTH - turn) & WRAP))
    return float(bits >> UNUSED_BITS) * DOUBLE_STEP


@compiled
def normal_pair(u1: float, u2: float) -> tuple[float, float]:
    """Turn two uniform numbers into two independent standard normal ones.

    r = sqrt(-2 log(1 - u1)), (r cos(2 pi u2), r sin(2 pi u2)).

    Args:
        u1, u2: uniform in [0, 1).

    Source: Box & Muller, *A Note on the Generation of Random Normal Deviates* (1958).
    """
    r = math.sqrt(-2.0 * log(1.0 - u1))
    cos, sin = cos_sin(2.0 * math.pi * u2)
    return r * cos, r * sin


@compiled
def write_directions(angles: np.ndarray, directions: np.ndarray) -> None:
    """Write unit vectors (cos, sin), the same bits for one angle as for many.

    Args:
        angles: shape (n,) [rad].
        directions: takes them, shape (n, 2).
    """
    for k in range(len(angles)):
        directions[k, 0], directions[k, 1] = cos_sin(angles[k])


@compiled
def seed_stream(streams: np.ndarray, k: int, seed: Word) -> None:
    """Start world k's stream.

    Args:
        streams: shape (worlds, 4) uint64; row k is written.
        k: world.
        seed: uint64.
    """
    word, constant = seed, INIT_A
    for i in range(WORDS):
        streams[k, i] = _hash(word & LOW, constant, MULT_A)
        constant = constant * MULT_A & LOW
        word = word >> HALF
    for source in range(WORDS):
        for target in range(WORDS):
            if source != target:
                streams[k, target] = _mix(streams[k, target], _hash(streams[k, source], constant, MULT_A))
                constant = constant * MULT_A & LOW
    a, constant = _generate(streams[k, 0], streams[k, 1], INIT_B)
    b, constant = _generate(streams[k, 2], streams[k, 3], constant)
    c, constant = _generate(streams[k, 0], streams[k, 1], constant)
    d, constant = _generate(streams[k, 2], streams[k, 3], constant)
    streams[k, 2] = (c << ONE) | (d >> WRAP)
    streams[k, 3] = (d << ONE) | ONE
    streams[k, 1], carry = _add(b, streams[k, 3], ZERO)
    streams[k, 0], carry = _add(a, streams[k, 2], carry)
    _advance(streams, k)


@compiled
def _advance(streams: np.ndarray, k: int) -> None:
    """Move world k's generator on: state = state * multiplier + increment modulo 2**128."""
    s0, s1 = streams[k, 1] & LOW, streams[k, 1] >> HALF
    s2, s3 = streams[k, 0] & LOW, streams[k, 0] >> HALF
    p00, p01, p10, p11, p02, p20 = s0 * M0, s0 * M1, s1 * M0, s1 * M1, s0 * M2, s2 * M0
    top = (s0 * M3 & LOW) + (s1 * M2 & LOW) + (s2 * M1 & LOW) + (s3 * M0 & LOW)
    r0 = (p00 & LOW) + (streams[k, 3] & LOW)
    r1 = (p00 >> HALF) + (p01 & LOW) + (p10 & LOW) + (streams[k, 3] >> HALF) + (r0 >> HALF)
    r2 = (p01 >> HALF) + (p10 >> HALF) + (p11 & LOW) + (p02 & LOW) + (p20 & LOW)
    r2 = r2 + (streams[k, 2] & LOW) + (r1 >> HALF)
    r3 = (p11 >> HALF) + (p02 >> HALF) + (p20 >> HALF) + top + (streams[k, 2] >> HALF) + (r2 >> HALF)
    streams[k, 0] = (r3 << HALF) | (r2 & LOW)
    streams[k, 1] = (r1 << HALF) | (r0 & LOW)


@compiled
def _add(a: Word, b: Word, carry: Word) -> tuple[Word, Word]:
    """Return the sum of two 64-bit words modulo 2**64 and what is carried."""
    low = (a & LOW) + (b & LOW) + carry
    high = (a >> HALF) + (b >> HALF) + (low >> HALF)
    return (high << HALF) | (low & LOW), high >> HALF


@compiled
def _hash(word: Word, constant: Word, multiplier: Word) -> Word:
    """Return a 32-bit word hashed with a constant that moves on from word to word."""
    hashed = (word ^ constant) * (constant * multiplier & LOW) & LOW
    return hashed ^ (hashed >> SHIFT)


@compiled
def _mix(x: Word, y: Word) -> Word:
    """Return two 32-bit words mixed into one."""
    mixed = ((x * MIX_LEFT & LOW) + (TWO_TO_32 - (y * MIX_RIGHT & LOW))) & LOW
    return mixed ^ (mixed >> SHIFT)


@compiled
def _generate(first: Word, second: Word, constant: Word) -> tuple[Word, Word]:
    """Return the 64-bit word of two words of the pool, and the constant of the next one."""
    after = constant * MULT_B & LOW
    word = _hash(first, constant, MULT_B) | (_hash(second, after, MULT_B) << HALF)
    return word, after * MULT_B & LOW


@compiled
def _seed_all(streams: np.ndarray, seeds: np.ndarray) -> None:
    for k in range(len(seeds)):
        seed_stream(streams, k, seeds[k])


@compiled
def _draw_all(streams: np.ndarray, doubles: np.ndarray) -> None:
    for k in range(doubles.shape[0]):
        for i in range(doubles.shape[1]):
            doubles[k, i] = next_double(streams, k)
