import itertools
import math

import numpy as np
import pytest

from impact_envs.errors import InputError
from planners import solvers
from planners.errors import Infeasible, SolverFailed
from planners.mixed_integer import Affine, Model
from planners.solvers import SOLVERS, compute_lower_bound, installed_solvers, solve

INSTALLED = installed_solvers()
MISSING = {
    name: pytest.mark.skipif(name not in INSTALLED, reason=f"{solver.package} missing")
    for name, solver in SOLVERS.items()
}
EVERY = pytest.mark.parametrize("solver", [pytest.param(name, marks=MISSING[name]) for name in SOLVERS])
QUADRATIC = pytest.mark.parametrize(
    "solver", [pytest.param(name, marks=MISSING[name]) for name, one in SOLVERS.items() if one.quadratic]
)


@EVERY
def test_knapsack_equals_enumeration(solver: str) -> None:
    rng = np.random.default_rng(3)
    value, weight = rng.uniform(1, 2, 8), rng.uniform(1, 2, 8)
    model = Model("knapsack")
    chosen = [model.binary() for _ in value]
    model.require(sum((w * z for w, z in zip(weight, chosen, strict=True)), Affine({})) - 6.0)
    model.objective = sum((-v * z for v, z in zip(value, chosen, strict=True)), Affine({}, 5.0))
    solution = solve(model, 10.0, solver=solver)
    best = max(value @ z for z in itertools.product((0, 1), repeat=8) if weight @ z <= 6.0)
    assert solution.objective == pytest.approx(5.0 - best, abs=1e-6)
    assert solution.objective - 1e-5 <= solution.bound <= solution.objective + 1e-9
    assert solution.objective == pytest.approx(model.objective.value(solution.x))


@EVERY
def test_linear_rows_and_equalities_hold(solver: str) -> None:
    model = Model("mixed")
    x, y, n = model.variable(-4.0, 4.0), model.variable(-4.0, 4.0), model.variable(0.0, 5.0, integer=True)
    model.require_equal(x + 2.0 * y - n + 0.5)
    model.require(1.5 - n)
    model.objective = n + 0.1 * x
    solution = solve(model, 10.0, solver=solver)
    np.testing.assert_allclose(solution.x[2], 2.0, atol=1e-6)
    np.testing.assert_allclose(solution.x[0] + 2.0 * solution.x[1], 1.5, atol=1e-6)
    assert solution.objective == pytest.approx(2.0 - 0.1 * 4.0, abs=1e-6)


@EVERY
def test_infeasible_is_typed(solver: str) -> None:
    model = Model("empty")
    x = model.variable(0.0, 1.0, integer=True)
    model.require(0.4 - x)
    model.require(x - 0.6)
    with pytest.raises(Infeasible) as error:
        solve(model, 10.0, solver=solver)
    assert error.value.problem == "empty"
    assert error.value.remedy


@EVERY
def test_an_infinite_gap_takes_the_first_point(solver: str) -> None:
    model = Model("first")
    chosen = [model.binary() for _ in range(6)]
    model.require(sum(chosen, Affine({})) - 3.0)
    model.objective = sum((-z for z in chosen), Affine({}))
    solution = solve(model, 10.0, relative_gap=math.inf, solver=solver)
    assert solution.bound <= -3.0 + 1e-6
    assert -3.0 - 1e-6 <= solution.objective <= 1e-6


@EVERY
def test_bounds_of_a_limited_search_are_bounds(solver: str) -> None:
    """Of three items of weight 2 a knapsack of 5 takes two; its linear relaxation takes two and a half."""
    model = Model("bound")
    chosen = [model.binary() for _ in range(3)]
    model.require(sum((2.0 * z for z in chosen), Affine({})) - 5.0)
    model.objective = sum((-z for z in chosen), Affine({}))
    relaxed, fractional = compute_lower_bound(model, 10.0, 0, solver)
    assert relaxed == pytest.approx(-2.5, abs=1e-6)
    assert fractional is not None
    assert model.objective.value(fractional) == pytest.approx(-2.5, abs=1e-6)
    searched, point = compute_lower_bound(model, 10.0, 100, solver)
    assert -2.5 - 1e-6 <= searched <= -2.0 + 1e-6
    assert point is None or np.abs(point - point.round()).max() < 1e-6


@QUADRATIC
def test_squares_equal_enumeration(solver: str) -> None:
    """Minimise 3 (n - 1.4)^2 + (n + y - 2)^2 - 0.5 y for n in {0..3}; for fixed n, y = 2.25 - n."""
    model = Model("squares")
    n, y = model.variable(0.0, 3.0, integer=True), model.variable(-5.0, 5.0)
    model.objective = -0.5 * y
    solution = solve(model, 10.0, solver=solver, squares=[(3.0, n - 1.4), (1.0, n + y - 2.0)])
    best = min(3.0 * (k - 1.4) ** 2 + 0.25**2 - 0.5 * (2.25 - k) for k in range(4))
    assert solution.objective == pytest.approx(best, abs=1e-5)
    np.testing.assert_allclose(solution.x, [1.0, 1.25], atol=1e-3)
    assert solution.bound <= solution.objective


def test_highs_refuses_squares() -> None:
    model = Model("squares")
    x = model.binary()
    with pytest.raises(SolverFailed, match="no quadratic objective") as error:
        solve(model, 10.0, squares=[(1.0, x - 0.3)])
    assert "scip" in error.value.remedy


def test_unknown_solvers_name_the_choices() -> None:
    with pytest.raises(InputError, match=r"'cplex' is unknown.*highs, scip, gurobi"):
        solve(Model("any"), 10.0, solver="cplex")


@pytest.mark.parametrize("solver", ["scip", "gurobi"])
def test_missing_packages_say_how_to_install_them(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solvers, "find_spec", lambda package: package == "highspy" or None)
    assert installed_solvers() == ("highs",)
    with pytest.raises(InputError, match=f"pip install {SOLVERS[solver].package}; installed: highs"):
        solve(Model("any"), 10.0, solver=solver)


@pytest.mark.skipif("gurobi" not in INSTALLED, reason="gurobipy missing")
def test_a_missing_licence_is_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GRB_LICENSE_FILE", "/no/such/licence")
    model = Model("unlicensed")
    model.objective = model.binary()
    with pytest.raises(SolverFailed, match="Gurobi: ") as error:
        solve(model, 10.0, solver="gurobi")
    assert "another solver" in error.value.remedy
