from dataclasses import replace

import numpy as np
import pytest

from planners.errors import Infeasible
from planners.mixed_integer import Affine, Model
from planners.refutation import FIRST, RefutationOptions, choose_alternatives
from planners.solvers import solve

OPTIONS = RefutationOptions()


def _make_model(seed: int) -> Model:
    """Return discs in a row of rooms: points that keep their distance along one of four sides, within half-planes."""
    rng = np.random.default_rng(seed)
    model = Model(f"rooms {seed}")
    points = [model.vector(np.zeros(2), np.full(2, 4.0)) for _ in range(4)]
    apart = rng.uniform(2.0, 4.0)
    for k, here in enumerate(points):
        for there in points[:k]:
            step = here - there
            model.require_any([[apart - step[0]], [apart + step[0]], [apart - step[1]], [apart + step[1]]])
        normal = rng.normal(size=2)
        model.require(normal @ (here - np.full(2, 2.0)) - rng.uniform(-1.2, 1.0))
    chosen = [model.binary() for _ in points]
    model.require_equal(sum(chosen, Affine({})) - 1.0)
    for choice, point in zip(chosen, points, strict=True):
        for coordinate in point:
            model.require(coordinate - 0.7, unless=1.0 - choice)
    return model


def _is_feasible(model: Model) -> bool:
    try:
        solve(model, 60.0)
    except Infeasible:
        return False
    return True


def test_it_refutes_what_branch_and_bound_refutes_and_finds_what_it_finds() -> None:
    verdicts = []
    for seed in range(30):
        model = _make_model(seed)
        try:
            x = choose_alternatives(model, {}, OPTIONS, 60.0)
        except Infeasible:
            verdicts.append(False)
        else:
            assert x is not None
            verdicts.append(True)
            for i in np.flatnonzero(model.integer):
                model.lower[i] = model.upper[i] = x[i]
        assert _is_feasible(model) == verdicts[-1]
    assert 5 < sum(verdicts) < 25


def test_ranks_and_what_is_learned_change_no_verdict() -> None:
    for seed in range(5):
        model, verdicts = _make_model(seed), set()
        ranks = dict.fromkeys(np.flatnonzero(model.integer)[-4:], FIRST)
        for chosen, options in (({}, OPTIONS), (ranks, OPTIONS), (ranks, replace(OPTIONS, longest=0, growth=1.0))):
            try:
                verdicts.add(choose_alternatives(model, chosen, options, 60.0) is not None)
            except Infeasible:
                verdicts.add(False)
        assert len(verdicts) == 1


def test_binaries_alone_can_contradict_each_other() -> None:
    model = Model("logic")
    first, second, third = (model.binary() for _ in range(3))
    model.require_equal(first + second - 1.0)
    model.require_equal(first + third - 1.0)
    model.require(first * 2.0 + second - 1.5)  # not the first
    assert choose_alternatives(model, {}, OPTIONS, 60.0) is not None
    model.require(second + third - 1.0)  # the second and the third follow
    with pytest.raises(Infeasible):
        choose_alternatives(model, {}, OPTIONS, 60.0)


def test_binaries_that_nothing_asks_for_are_zero_in_what_is_found() -> None:
    model = Model("free")
    x, free = model.variable(0.0, 1.0), model.binary()
    model.require(0.5 - x - free)
    found = choose_alternatives(model, {}, OPTIONS, 60.0)
    np.testing.assert_array_equal(found, [0.0, 0.0])
    model.require(x - free)  # now it must be 1, which is not looked for
    model.require(0.25 - x)
    assert choose_alternatives(model, {}, OPTIONS, 60.0) is None


def test_limits_end_it_without_a_verdict() -> None:
    model = next(model for model in map(_make_model, range(30)) if not _is_feasible(model))
    assert choose_alternatives(model, {}, replace(OPTIONS, problems=1), 60.0) is None
    assert choose_alternatives(model, {}, OPTIONS, -1.0) is None


def test_other_integers_are_refused() -> None:
    model = Model("steps")
    model.variable(0.0, 3.0, integer=True)
    with pytest.raises(ValueError, match="no binary"):
        choose_alternatives(model, {}, OPTIONS, 60.0)
