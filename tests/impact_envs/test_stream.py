"""Streams are numpy's generator, bit for bit, for many worlds at once."""

import os
import subprocess
import sys

import numpy as np
import pytest
from gymnasium.utils import seeding

from impact_envs.errors import InputError
from impact_envs.stream import draw_doubles, next_double, normal_pair, seed_streams

EDGES = [0, 1, 2**31, 2**32 - 1, 2**32, 2**32 + 1, 2**63 - 1]
SEEDS = EDGES + np.random.default_rng(0).integers(0, 2**63 - 1, 1000).tolist()


def read_words(rng):
    """State and increment of a numpy generator as the four words of a stream."""
    state = rng.bit_generator.state["state"]
    return [word for name in ("state", "inc") for word in divmod(state[name], 2**64)]


def test_seeding_is_gymnasiums():
    streams = seed_streams(SEEDS)
    assert streams.shape == (len(SEEDS), 4)
    for stream, seed in zip(streams, SEEDS, strict=True):
        assert stream.tolist() == read_words(seeding.np_random(seed)[0]), seed


def test_doubles_are_the_generators():
    streams = seed_streams(SEEDS)
    doubles = draw_doubles(streams, np.arange(len(SEEDS)), 30)
    for k, seed in enumerate(SEEDS):
        rng = seeding.np_random(seed)[0]
        assert np.array_equal(doubles[k], rng.random(30)), seed
        assert streams[k].tolist() == read_words(rng), seed


def test_streams_go_on_one_by_one():
    streams = seed_streams([7, 8, 9])
    rngs = [np.random.default_rng(seed) for seed in (7, 8, 9)]
    for worlds in ([0, 2], [1], [2, 1], [0, 1, 2]):
        drawn = draw_doubles(streams, np.array(worlds), 3)
        assert np.array_equal(drawn, [rngs[k].random(3) for k in worlds])
    drawn = draw_doubles(streams, np.array([False, True, True]), 2)
    assert np.array_equal(drawn, [rngs[k].random(2) for k in (1, 2)])
    assert [next_double(streams, k) for k in (1, 1, 0)] == [rngs[k].random() for k in (1, 1, 0)]


def test_no_worlds_and_no_doubles():
    assert seed_streams([]).shape == (0, 4)
    streams = seed_streams([5])
    before = streams.copy()
    assert draw_doubles(streams, np.array([0]), 0).shape == (1, 0)
    assert np.array_equal(streams, before)


@pytest.mark.parametrize(
    ("seeds", "named"),
    [
        ([0, -1], "world 1 = -1"),
        ([0, 1, 2**63], "world 2 = 9223372036854775808"),
        ([2**70, 1], "world 0 = 1180591620717411303424"),
        ([1.5], "world 0 = 1.5"),
        ([1, "two"], "world 1 = two"),
        (np.array([[1, 2]]), r"shape \(1, 2\)"),
    ],
)
def test_bad_seeds_are_named(seeds, named):
    with pytest.raises(InputError, match=named):
        seed_streams(seeds)


def test_normal_pair_is_normal():
    u = draw_doubles(seed_streams(np.arange(50_000)), np.arange(50_000), 2)
    z = np.array([normal_pair(u1, u2) for u1, u2 in u])
    # Five standard errors of mean, variance, correlation, kurtosis and tail of 50,000 pairs.
    n = len(z)
    assert np.all(np.abs(z.mean(axis=0)) < 5 / np.sqrt(n))
    assert np.all(np.abs(z.var(axis=0) - 1) < 5 * np.sqrt(2 / n))
    assert abs(np.mean(z[:, 0] * z[:, 1])) < 5 / np.sqrt(n)
    assert np.all(np.abs(np.mean(z**4, axis=0) - 3) < 5 * np.sqrt(96 / n))
    assert np.all(np.abs(np.mean(np.abs(z) > 1.959964, axis=0) - 0.05) < 5 * np.sqrt(0.05 * 0.95 / n))


def test_normal_pair_is_finite_at_the_ends():
    assert normal_pair(0.0, 0.0) == (0.0, 0.0)
    assert all(np.isfinite(normal_pair(1 - 2**-53, u2)).all() for u2 in (0.0, 0.25, 1 - 2**-53))


def test_uncompiled_is_the_same_without_a_warning():
    code = (
        "import numpy as np; from impact_envs.stream import draw_doubles, seed_streams\n"
        f"seeds = {SEEDS[:20]}; streams = seed_streams(seeds)\n"
        "print(draw_doubles(streams, np.arange(20), 5).tobytes().hex(), streams.tobytes().hex())"
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-W", "error::RuntimeWarning", "-c", code]
    out = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    streams = seed_streams(SEEDS[:20])
    doubles = draw_doubles(streams, np.arange(20), 5)
    assert out.stdout.split() == [doubles.tobytes().hex(), streams.tobytes().hex()]
