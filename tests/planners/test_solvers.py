import itertools
import math

import numpy as np
import pytest

from impact_envs.errors import InputError
from planners import solvers
from planners.errors import Infeasible, SolverFailed
from planners.mixed_integer import Affine, Model
from planners.solvers import PACKAGES, SOLVERS, installed_solvers, solve

INSTALLED = installed_solvers()
EVERY = pytest.mark.parametrize(
    "solver",
    [pytest.param(s, marks=pytest.mark.skipif(s not in INSTALLED, reason=f"{PACKAGES[s]} missing")) for s in SOLVERS],
)
QUADRATIC = pytest.mark.parametrize(
    "solver",
    [
        pytest.param(s, marks=pytest.mark.skipif(s not in INSTALLED, reason=f"{PACKAGES[s]} missing"))
        for s in ("scip", "gurobi")
    ],
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


@EVERY
def test_an_infinite_gap_takes_the_first_point(solver: str) -> None:
    model = Model("first")
    chosen = [model.binary() for _ in range(6)]
    model.require(sum(chosen, Affine({})) - 3.0)
    model.objective = sum((-z for z in chosen), Affine({}))
    solution = solve(model, 10.0, relative_gap=math.inf, solver=solver)
    assert solution.bound <= -3.0 + 1e-6
    assert -3.0 - 1e-6 <= solution.objective <= 1e-6


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
    with pytest.raises(InputError, match=f"pip install {PACKAGES[solver]}; installed: highs"):
        solve(Model("any"), 10.0, solver=solver)


@pytest.mark.skipif("gurobi" not in INSTALLED, reason="gurobipy missing")
def test_a_missing_licence_is_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GRB_LICENSE_FILE", "/no/such/licence")
    model = Model("unlicensed")
    model.objective = model.binary()
    with pytest.raises(SolverFailed, match="Gurobi: ") as error:
        solve(model, 10.0, solver="gurobi")
    assert "another solver" in error.value.remedy
