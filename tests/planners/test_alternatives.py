import numpy as np
import pytest

from planners.alternatives import AllOf, AnyOf, compute_violation, read_marks, require_tree
from planners.errors import Infeasible
from planners.mixed_integer import Affine, Model
from planners.solvers import solve

Node = AllOf[str] | AnyOf[str] | Affine | float


def _between(x: Affine, low: float, high: float, name: str = "") -> AllOf[str]:
    return AllOf((low - x, x - high), (name,) if name else ())


def _range(tree: Node, x: Affine, model: Model) -> tuple[float, float]:
    """Return the least and the greatest value of a variable under a tree."""
    require_tree(model, tree)
    ends = []
    for sign in (1.0, -1.0):
        model.objective = x * sign
        ends.append(sign * solve(model, 10.0).objective)
    return ends[0], ends[1]


def _model() -> tuple[Model, Affine, Affine]:
    model = Model("tree")
    return model, model.variable(0.0, 10.0), model.variable(0.0, 10.0)


def test_a_choice_of_choices_is_the_union_of_their_ranges() -> None:
    model, x, y = _model()
    inner = AnyOf((_between(x, 3.0, 4.0), AllOf((_between(x, 5.0, 6.0), y - 1.0))))
    assert _range(AnyOf((inner, _between(x, 4.5, 4.6))), x, model) == pytest.approx((3.0, 6.0))
    # A choice among choices needs no binaries of its own.
    assert sum(model.integer) == 3


def test_choices_inside_an_alternative_hold_only_with_it() -> None:
    model, x, y = _model()
    twice = AllOf((_between(x, 7.0, 9.0), AnyOf((y - 1.0, 9.0 - y)), AnyOf((2.0 - y, x - 8.0))))
    require_tree(model, AnyOf((twice, AllOf((x - 2.0, _between(y, 4.0, 5.0))))))
    model.objective = -x
    assert solve(model, 10.0).objective == pytest.approx(-9.0)
    # x above 8 takes y from 9 on, x from 7 on takes y up to 1 or from 9 on.
    model.require(y - 8.0)
    assert solve(model, 10.0).objective == pytest.approx(-8.0)
    model.require(2.0 - y)
    assert solve(model, 10.0).objective == pytest.approx(-2.0)


def test_what_bounds_decide_takes_no_binaries() -> None:
    model, x, _ = _model()
    require_tree(model, AnyOf((x - 20.0, 5.0 - x)))
    assert model.integer == [False, False]
    assert model.inequalities == []
    require_tree(model, AnyOf((_between(x, 11.0, 12.0), AllOf((5.0 - x, AnyOf((x - 6.0, 12.0 - x)))))))
    assert not any(model.integer)
    assert _range(AllOf(()), x, model) == pytest.approx((5.0, 6.0))


def test_excluded_trees_are_infeasible_at_once() -> None:
    model, x, _ = _model()
    for tree in (AnyOf(()), AnyOf((11.0 - x, AllOf((x - 2.0, 12.0 - x)))), AllOf((11.0 - x,)), 1.0):
        with pytest.raises(Infeasible, match="contradicts"):
            require_tree(model, tree)


def test_an_elastic_part_gives_way_without_giving_up_its_choices() -> None:
    model, x, _ = _model()
    model.elastic = True
    with model.part("high", 5.0):
        require_tree(model, AnyOf((_between(x, 12.0, 13.0), _between(x, 14.0, 15.0))))
    model.objective = model.slacks["high"]
    assert solve(model, 10.0).objective == pytest.approx(2.0)


def test_marks_are_of_the_first_alternative_that_holds() -> None:
    _, x, y = _model()
    tree = AllOf(
        (AnyOf((_between(x, 0.0, 2.0, "low"), _between(x, 1.0, 5.0, "middle"))), _between(y, 0.0, 1.0, "y")), ("all",)
    )
    assert list(read_marks(tree, np.array([1.5, 1.0]), 1e-6)) == ["all", "low", "y"]
    assert list(read_marks(tree, np.array([2.5, 1.0]), 1e-6)) == ["all", "middle", "y"]
    # Where none holds, the one that is violated least.
    assert list(read_marks(tree, np.array([5.5, 1.0]), 1e-6)) == ["all", "middle", "y"]
    assert compute_violation(tree, np.array([5.5, 1.0])) == pytest.approx(0.5)
    assert compute_violation(tree, np.array([1.5, 0.25])) == pytest.approx(-0.25)
