"""Readings that motion explains are believed; others are not, until they agree for long enough."""

from __future__ import annotations

import numpy as np
import pytest

from planners.reading_gate import (
    BELIEVED,
    MISSING,
    REJECTED,
    TAKEN_UP,
    Q,
    judge_reading,
    make_gate,
    open_gate,
    predict_reading,
)

PERIOD, PATIENCE = 0.01, 0.2
REACH = (*(np.full(3, value) for value in (0.1, 0.3, 2.0, 5.0)), np.array([False, True, False]))


class Mechanism:
    """Three coordinates, of which the second turns, swing, and the gate reads them."""

    def __init__(self) -> None:
        self.gate, self.time = make_gate(*REACH), 0.0
        open_gate(self.gate, self.q)

    @property
    def q(self) -> np.ndarray:
        return 0.2 * (np.cos([self.time, 2.0 * self.time, self.time]) - 1.0)

    @property
    def v(self) -> np.ndarray:
        return -0.2 * np.array([1.0, 2.0, 1.0]) * np.sin([self.time, 2.0 * self.time, self.time])

    def read(self, q: object = None, v: object = None, touched: bool = False) -> int:
        """Read what is, or something else, and go on by a period."""
        read = [np.array(own if other is None else other, float) for own, other in ((self.q, q), (self.v, v))]
        use = judge_reading(self.gate, *read, PERIOD, touched, PATIENCE)
        if use <= REJECTED:
            predict_reading(self.gate, np.zeros(3), PERIOD)
        self.time += PERIOD
        return use


@pytest.fixture
def mechanism() -> Mechanism:
    moving = Mechanism()
    for _ in range(50):
        assert moving.read() == BELIEVED
    return moving


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_no_number_is_missing_and_opens_the_gate(mechanism: Mechanism, value: float) -> None:
    for _ in range(5):
        assert mechanism.read(q=[0.0, value, 0.0]) == MISSING
    assert mechanism.read(q=np.add(mechanism.q, (0.2, 0.0, 0.0))) == BELIEVED  # an impact may have happened meanwhile


@pytest.mark.parametrize("value", [0.3, 1.0, -10.0, 1e154, 1e300])
@pytest.mark.parametrize("periods", [1, 2, 15])
def test_what_no_motion_explains_is_rejected_and_the_truth_believed_again(
    mechanism: Mechanism, value: float, periods: int
) -> None:
    for _ in range(periods):
        assert mechanism.read(q=np.add(mechanism.q, (value, 0.0, 0.0))) == REJECTED
        assert np.abs(mechanism.gate[Q] - mechanism.q).max() < 0.02
    assert mechanism.read() == BELIEVED


def test_one_wrong_rate_rejects_the_reading(mechanism: Mechanism) -> None:
    assert mechanism.read(v=np.add(mechanism.v, (0.0, 0.5, 0.0))) == REJECTED
    assert mechanism.read(v=np.add(mechanism.v, (0.0, 0.5, 0.0)), touched=True) == BELIEVED  # an impact explains it


def test_whole_turns_do_not_matter_where_a_coordinate_turns(mechanism: Mechanism) -> None:
    assert mechanism.read(q=np.add(mechanism.q, (0.0, -4.0 * np.pi, 0.0))) == BELIEVED
    assert mechanism.read(q=np.add(mechanism.q, (2.0 * np.pi, 0.0, 0.0))) == REJECTED


def test_a_frozen_reading_of_what_moves_is_rejected(mechanism: Mechanism) -> None:
    q, v = mechanism.q, mechanism.v
    assert mechanism.read(q, v) == BELIEVED
    for _ in range(5):
        assert mechanism.read(q, v) == REJECTED
    assert mechanism.read() == BELIEVED


def test_a_delay_repeats_the_first_reading_and_rest_repeats_all() -> None:
    still = Mechanism()
    for _ in range(5):
        assert still.read(q=[0.0, 0.0, 0.0], v=[0.01, 0.0, 0.0]) == BELIEVED
    for _ in range(5):
        assert still.read(q=[0.01, 0.0, 0.0], v=[0.0, 0.0, 0.0]) == BELIEVED


def test_readings_that_agree_are_taken_up(mechanism: Mechanism) -> None:
    uses = [mechanism.read(q=np.add(mechanism.q, (1.0, 0.0, 0.0))) for _ in range(25)]
    patience = round(PATIENCE / PERIOD)
    assert uses == [REJECTED] * patience + [TAKEN_UP] + [BELIEVED] * (24 - patience)


def test_readings_that_jump_are_never_taken_up(mechanism: Mechanism) -> None:
    rng = np.random.default_rng(0)
    assert {mechanism.read(q=rng.uniform(5.0, 50.0, 3)) for _ in range(200)} == {REJECTED}


def test_the_first_reading_may_be_anywhere_if_the_start_is_unknown() -> None:
    known, unknown = Mechanism(), Mechanism()
    open_gate(unknown.gate, unknown.q, known=False)
    assert known.read(q=[1.0, 1.0, 0.0]) == REJECTED
    assert unknown.read(q=[1.0, 1.0, 0.0]) == BELIEVED
    assert unknown.read(q=[1.5, 1.0, 0.0]) == REJECTED
