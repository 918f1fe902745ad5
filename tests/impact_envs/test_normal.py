"""Normal numbers of compiled streams are numpy's."""

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.normal import TAIL, next_normal
from impact_envs.stream import next_double, seed_streams


@compiled
def fill(streams, k, numbers):
    for i in range(len(numbers)):
        numbers[i] = next_normal(streams, k)


def test_normal_numbers_are_numpys_bit_for_bit_and_leave_the_stream_where_numpy_does():
    seeds, count = (0, 1, 2**63 - 1), 100_000
    streams, numbers = seed_streams(seeds), np.empty(count)
    for k, seed in enumerate(seeds):
        rng = np.random.default_rng(seed)
        fill(streams, k, numbers)
        assert np.array_equal(numbers, rng.standard_normal(count))
        assert np.abs(numbers).max() > TAIL  # the tail was drawn from
        assert next_double(streams, k) == rng.random()
