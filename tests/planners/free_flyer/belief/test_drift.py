"""A flight without drift is known from a filter with one, and weighed by how likely it is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from planners.free_flyer.belief.drift import find_drift, find_motion, mix_variance, weigh_drift
from planners.free_flyer.belief.estimator import correct_position, predict_state
from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.world_memory import FILTER
from planners.options import replace_options

PRIOR = EXPERT.estimation
SIGMA = 5e-3  # of positions [m]


def follow(drift: float, samples: int, rng: np.random.Generator) -> tuple[Any, Any]:
    """Return the filters with and without a drift of an object that starts at rest."""
    filters = np.zeros(2, FILTER)
    filters["P_pp"], filters["P_vv"] = PRIOR.start_position**2, PRIOR.start_velocity**2
    filters["P_aa"][0] = PRIOR.drift**2
    for k in range(samples):
        read = np.array([drift * (0.1 * k) ** 2 / 2, 0.0]) + SIGMA * rng.normal(size=2)
        for z in filters:
            correct_position(z, *read, SIGMA**2)
            predict_state(z, 0.0, 0.0, 0.1, 0.0)
    return filters[0], filters[1]


def test_what_it_would_be_without_a_drift_follows() -> None:
    z, without = follow(3e-4, 100, np.random.default_rng(0))
    z["still"] = 1.0
    p, v, a = find_motion(z)
    np.testing.assert_allclose([p.real, p.imag], without["position"], atol=1e-12)
    np.testing.assert_allclose([v.real, v.imag], without["velocity"], atol=1e-12)
    assert a == 0.0
    h = 7.0
    variance = z["P_vv"] + h * h * z["P_aa"] - 2 * h * z["P_va"].real
    assert mix_variance(z, variance, complex(z["P_va"] - h * z["P_aa"])) == pytest.approx(without["P_vv"], abs=1e-12)


def test_odds_are_those_of_the_two_filters_predictions() -> None:
    """The ratio of what both say of the readings, one after the other."""
    rng, filters, log_odds = np.random.default_rng(2), np.zeros(2, FILTER), 0.0
    filters["P_pp"], filters["P_vv"] = PRIOR.start_position**2, PRIOR.start_velocity**2
    filters["P_aa"][0] = PRIOR.drift**2
    for _ in range(80):
        read = SIGMA * rng.normal(size=2)
        for z, sign in zip(filters, (-1.0, 1.0), strict=True):
            total = z["P_pp"] + SIGMA**2
            miss = read - z["position"]
            log_odds += sign * (-math.log(total) - miss @ miss / (2 * total))
            correct_position(z, *read, SIGMA**2)
            predict_state(z, 0.0, 0.0, 0.1, 0.0)
    options = make_record(replace_options(EXPERT, {"estimation.still": 0.3}))[0]
    weigh_drift(filters[0], options)
    odds = 0.3 / 0.7 * math.exp(log_odds)
    assert filters[0]["still"] == pytest.approx(odds / (1 + odds), rel=1e-6)


def test_a_drift_is_believed_where_there_is_one() -> None:
    options, rng = make_record(EXPERT)[0], np.random.default_rng(1)
    z, _ = follow(1e-3, 150, rng)
    weigh_drift(z, options)
    assert z["still"] < 1e-3
    np.testing.assert_allclose(find_drift(z), z["drift"], rtol=1e-3)
    z, _ = follow(0.0, 150, rng)
    weigh_drift(z, options)
    assert z["still"] > 0.9


def test_a_filter_without_drift_state_has_none() -> None:
    z = np.zeros(1, FILTER)[0]
    weigh_drift(z, make_record(EXPERT)[0])
    assert z["still"] == 0.0
    z["P_aa"], z["drift"] = 1e-300, 1e-3  # exactly known
    weigh_drift(z, make_record(EXPERT)[0])
    assert z["still"] == 0.0
    z["drift"] = 0.0
    weigh_drift(z, make_record(EXPERT)[0])
    assert z["still"] == 1.0
