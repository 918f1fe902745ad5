"""The compiled solver finds what DAQP finds, says where there is no solution, and keeps nothing of the last program."""

import daqp
import numpy as np
import pytest

from planners.goldfarb_idnani import INFEASIBLE, SOLVED, STOPPED, make_workspace, solve_qp

BOUNDS = 4


def make_program(rng: np.random.Generator, n: int, equal: int, rows: int) -> tuple[np.ndarray, ...]:
    """Return H, f, A, lower, upper of a program with a solution, at which many rows are active."""
    root = rng.normal(size=(n, n))
    A = rng.normal(size=(equal + rows, n))
    inside = rng.normal(size=n)
    values = np.concatenate([inside[:BOUNDS], A @ inside])
    slack = rng.uniform(0.0, 0.3, (2, len(values)))
    slack[:, BOUNDS : BOUNDS + equal] = 0.0
    lower, upper = values - slack[0], values + slack[1]
    upper[BOUNDS:][rng.random(equal + rows) < 0.2 * (np.arange(equal + rows) >= equal)] = np.inf
    return root @ root.T + 1e-3 * np.eye(n), 3.0 * rng.normal(size=n), A, lower, upper


def solve(program: tuple[np.ndarray, ...], equal: int, work=None) -> tuple[int, np.ndarray]:
    x = np.zeros(len(program[1]))
    work = work or make_workspace(len(x), len(program[3]))
    return solve_qp(*program, BOUNDS, equal, work, x), x


def solve_daqp(program: tuple[np.ndarray, ...], equal: int) -> tuple[int, np.ndarray]:
    H, f, A, lower, upper = program
    sense = np.zeros(len(lower), np.int32)
    sense[BOUNDS : BOUNDS + equal] = 5
    x, _, flag, _ = daqp.solve(H, f, A, upper, lower, sense, primal_tol=1e-12)
    return flag, x


@pytest.mark.parametrize(("n", "equal", "rows"), [(4, 0, 0), (6, 0, 8), (12, 6, 3), (20, 13, 12), (5, 5, 2)])
def test_solutions_equal_daqps(n, equal, rows):
    rng, work = np.random.default_rng(n), make_workspace(25, 40)
    active = 0
    for _ in range(200):
        program = make_program(rng, n, equal, rows)
        status, x = solve(program, equal, work)
        flag, y = solve_daqp(program, equal)
        assert (status, flag) == (SOLVED, 1)
        assert np.abs(x - y).max() < 1e-9
        values = np.concatenate([x[:BOUNDS], program[2] @ x])
        assert (values >= program[3] - 1e-9).all() and (values <= program[4] + 1e-9).all()
        active += int((np.minimum(values - program[3], program[4] - values) < 1e-9).sum()) - equal
    assert active > 200 or n == equal  # many inequalities hold with equality


def test_programs_without_solution_are_told_apart():
    """Both solvers agree on which of random programs with narrow bounds beside their equalities have none."""
    rng, found = np.random.default_rng(0), set()
    for _ in range(300):
        H, f, A, lower, upper = make_program(rng, 8, 3, 4)
        shift = rng.normal(size=BOUNDS)
        lower[:BOUNDS] += shift
        upper[:BOUNDS] += shift
        status, x = solve((H, f, A, lower, upper), 3)
        flag, y = solve_daqp((H, f, A, lower, upper), 3)
        assert status == (SOLVED if flag == 1 else INFEASIBLE)
        assert flag in (1, -1)
        assert status == INFEASIBLE or np.abs(x - y).max() < 1e-9
        found.add(status)
    assert found == {SOLVED, INFEASIBLE}


def test_a_program_is_solved_alike_after_any_other():
    rng, work = np.random.default_rng(1), make_workspace(30, 50)
    program = make_program(rng, 9, 4, 5)
    _, alone = solve(program, 4)
    for size in ((30, 10, 20), (6, 1, 0)):
        solve(make_program(rng, *size), size[1], work)
        _, after = solve(program, 4, work)
        assert np.array_equal(after, alone)


def test_an_active_bound_and_its_multiplier_by_hand():
    """min (x - 3)^2 / 2 + (y - 1)^2 / 2 with x + y = 1 and x <= 1: (1, 0)."""
    program = (np.eye(4), np.array([-3.0, -1.0, 0.0, 0.0]), np.array([[1.0, 1.0, 0.0, 0.0]]))
    upper = np.array([1.0, np.inf, np.inf, np.inf, 1.0])
    lower = np.array([-np.inf, -np.inf, -np.inf, -np.inf, 1.0])
    status, x = solve((*program, lower, upper), 1)
    assert status == SOLVED
    assert x == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-14)


def test_equalities_that_depend_on_each_other_and_bad_costs_stop():
    rng = np.random.default_rng(2)
    H, f, A, lower, upper = make_program(rng, 6, 3, 2)
    twice = A.copy()
    twice[2] = 2.0 * twice[0] - twice[1]
    assert solve((H, f, twice, lower, upper), 3)[0] == STOPPED
    assert solve((-H, f, A, lower, upper), 3)[0] == STOPPED
    assert solve((H, np.full(6, np.nan), A, lower, upper), 3)[0] == STOPPED
    assert solve((H, f, np.full(A.shape, np.inf), lower, upper), 3)[0] == STOPPED


def test_a_direction_without_cost_that_equalities_determine_does_no_harm():
    """Torques tau = M a + h cost 1e-8 of what accelerations cost, and come out exactly."""
    rng = np.random.default_rng(3)
    M, h, wanted = rng.normal(size=(4, 4)), rng.normal(size=4), rng.normal(size=4)
    H = np.diag([1e-8] * 4 + [1.0] * 4)
    A = np.hstack([np.eye(4), -M])
    free = np.full(BOUNDS, np.inf)
    status, x = solve((H, np.concatenate([np.zeros(4), -wanted]), A, np.r_[-free, h], np.r_[free, h]), 4)
    assert status == SOLVED
    # least of 1e-8 |M a + h|^2 + |a - wanted|^2
    exact = np.linalg.solve(np.eye(4) + 1e-8 * M.T @ M, wanted - 1e-8 * M.T @ h)
    assert x[4:] == pytest.approx(exact, abs=1e-13)
    assert x[:4] == pytest.approx(M @ exact + h, abs=1e-13)
