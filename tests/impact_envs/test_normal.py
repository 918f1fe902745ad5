"""Normal numbers of compiled streams are numpy's, those of the tail up to what the C library rounds otherwise."""

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.normal import TAIL, draw_normals, next_normal
from impact_envs.stream import next_double, seed_streams


@compiled
def fill(streams, k, numbers):
    for i in range(len(numbers)):
        numbers[i] = next_normal(streams, k)


def test_normal_numbers_are_numpys_and_leave_the_stream_where_numpy_does():
    seeds, count = (0, 1, 2**63 - 1), 100_000
    streams, numbers = seed_streams(seeds), np.empty(count)
    for k, seed in enumerate(seeds):
        rng = np.random.default_rng(seed)
        fill(streams, k, numbers)
        right = rng.standard_normal(count)
        tail = np.abs(right) > TAIL
        assert tail.any()
        assert np.array_equal(numbers[~tail], right[~tail])
        assert np.abs(numbers[tail] - right[tail]).max() <= np.spacing(4.0)
        assert next_double(streams, k) == rng.random()


def test_a_generator_draws_what_its_stream_draws_and_moves_on():
    rng, other, streams = np.random.default_rng(5), np.random.default_rng(5), seed_streams([5])
    other.random(), next_double(streams, 0), rng.random()
    for count in (1, 36, 0, 7):
        expected = np.empty(count)
        fill(streams, 0, expected)
        assert np.array_equal(draw_normals(rng, count), expected)
        other.standard_normal(count)
    assert rng.random() == other.random() == next_double(streams, 0)
