"""What a learner sends as corrections is either taken or refused in one clear line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from impact_envs.errors import InputError
from planners.correction import spread_corrections

AWAITING = np.array([True, False, True])


@pytest.mark.parametrize("worlds", [[True, False, True], [0, 2], np.array([0, 2], np.uint8)])
def test_a_mask_and_numbers_say_the_same(worlds: Any) -> None:
    spread = spread_corrections(worlds, np.array([[2.0], [0.5]]), AWAITING, 1)
    np.testing.assert_array_equal(spread, [[1.0], [np.nan], [0.5]])


def test_numbers_keep_their_order_and_none_is_none() -> None:
    np.testing.assert_array_equal(
        spread_corrections(np.array([2, 0]), [[0.5], [-0.5]], AWAITING, 1), [[-0.5], [np.nan], [0.5]]
    )
    assert np.isnan(spread_corrections(np.array([]), np.zeros((0, 1)), AWAITING, 1)).all()


@pytest.mark.parametrize(
    ("worlds", "corrections", "message"),
    [
        ("all", [[0.0]], "a mask of shape"),
        (["0"], [[0.0]], "a mask of shape"),
        ([0.0], [[0.0]], "a mask of shape"),
        ([[0], [0, 2]], [[0.0]], "a mask of shape"),
        ([3], [[0.0]], "world 3 does not exist"),
        ([-1], [[0.0]], "world -1 does not exist"),
        ([0, 0], [[0.0], [0.0]], "each once"),
        ([True, False], [[0.0]], "a mask of shape"),
        ([1], [[0.0]], "world 1 awaits no correction"),
        ([0, 2], [[0.0], [0.0, 1.0]], "finite numbers of shape"),
        ([0], [["a"]], "finite numbers of shape"),
        ([0], [[np.nan]], "correction of world 0"),
    ],
)
def test_anything_else_is_refused_in_one_line(worlds: Any, corrections: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        spread_corrections(worlds, corrections, AWAITING, 1)
    assert "\n" not in str(refused.value)
