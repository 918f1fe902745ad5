"""The tracking MPC as a cvxpy problem, for constraints and costs of one's own: built once, solved with new parameters.

The model, the cost and the limits are those of `mpc`, one line each. A tracker with one constraint more:

    def build_with_thrust_cone(problem):
        mpc = build_cvxpy_mpc(problem)
        force = mpc.variables["inputs"][:, :2]
        return mpc.add([cp.norm(force, axis=1) <= 1.0])

    expert = make_expert(scenario, tracker=CvxpyTracker(build_with_thrust_cone))
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import numpy as np

from impact_envs.elementary import cos_sin
from impact_envs.errors import InputError
from planners.errors import SolverFailed
from planners.free_flyer.tracking.problem import STAGES, TrackingProblem, TrackingTask, make_matrices

# Takes cones, and finds first inputs to 1e-7 of the limits; OSQP is off by 0.03 or fails, DAQP is twelve times slower.
SOLVER = cp.CLARABEL
NAME, REMEDY = "tracking MPC by cvxpy", "relax the constraints, or check the state and the reference"


@dataclass(frozen=True, eq=False)
class CvxpyMpc:
    """Hold one robot's MPC in cvxpy.

    Args:
        problem: the optimisation problem, within cvxpy's rules for parameters (DPP).
        variables: ``states`` at the nodes 0..10, shape (11, 6), the first the measured one and at the node of an impact
            the state just before it; ``inputs`` of the stages in the body frame, shape (10, 3) [N, N, N m].
        parameters: ``state`` measured (6,), reference ``states`` (11, 6) and ``inputs`` (10, 3), and of each stage k
            ``A[k]`` (6, 6), ``B[k]`` (6, 3), ``c[k]`` (6,): x_{k+1} = A x_k + B u_k + c, the impact's jump included.
    """

    problem: cp.Problem
    variables: dict[str, cp.Variable]
    parameters: dict[str, cp.Parameter]

    def add(self, constraints: Iterable[Any]) -> CvxpyMpc:
        """Return the MPC with more constraints."""
        problem = cp.Problem(self.problem.objective, [*self.problem.constraints, *constraints])
        return replace(self, problem=problem)


def build_cvxpy_mpc(problem: TrackingProblem) -> CvxpyMpc:
    """Build the tracking MPC of one robot, with its heading held over the horizon.

    min sum_k |x_k - x_ref,k|_Q^2 + |u_k - u_ref,k|_R^2 + |x_N - x_ref,N|_P^2,  x_{k+1} = A_k x_k + B_k u_k + c_k,
    |u_k| <= limit

    Args:
        problem: the same that `mpc.solve_tracking` solves.

    Source: Verhagen & Tumova, Eqs. 31 and 33; with `problem.PUBLISHED_WEIGHTS` App. B.
    """
    x, u = cp.Variable((STAGES + 1, 6), name="states"), cp.Variable((STAGES, 3), name="inputs")
    state, states = cp.Parameter(6, name="state"), cp.Parameter((STAGES + 1, 6), name="reference_states")
    inputs = cp.Parameter((STAGES, 3), name="reference_inputs")
    Q, P = cp.Parameter((6, 6), name="Q"), cp.Parameter((6, 6), name="P")
    parameters = {"state": state, "states": states, "inputs": inputs, "Q": Q, "P": P}
    cost = cp.sum_squares((u - inputs) @ np.diag(np.sqrt(problem.effort)))
    # Parameters may not be multiplied with each other: errors are variables.
    off = cp.Variable((STAGES, 6), name="errors")
    cost += cp.sum_squares(off[: STAGES - 1] @ Q) + cp.sum_squares(off[STAGES - 1] @ P)
    rules = [off == x[1:] - states[1:], x[0] == state, u <= problem.limits[None, :], u >= -problem.limits[None, :]]
    for k in range(STAGES):
        A, B, c = (cp.Parameter(shape, name=f"{name}[{k}]") for name, shape in (("A", (6, 6)), ("B", (6, 3)), ("c", 6)))
        parameters |= {f"A[{k}]": A, f"B[{k}]": B, f"c[{k}]": c}
        rules.append(x[k + 1] == A @ x[k] + B @ u[k] + c)
    return CvxpyMpc(cp.Problem(cp.Minimize(cost), rules), {"states": x, "inputs": u}, parameters)


def compute_stage(problem: TrackingProblem, task: TrackingTask, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B, c of stage k: x_{k+1} = A x_k + B u_k + c, with the jump of an impact at its node.

    Args:
        problem: accelerations per input.
        task: measured heading, durations and the impact.
        k: stage.

    Source: Verhagen & Tumova, Eq. 6, solved for the robot.
    """
    h, (cos, sin) = task.durations[k], cos_sin(task.state[2])
    push = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) * problem.gains
    flow, c = np.eye(6), np.zeros(6)
    flow[:3, 3:] = h * np.eye(3)
    if task.has_impact_before(k):
        jump, n = np.eye(6), np.array([*task.normal, 0.0])
        jump[3:, 3:] -= task.gain * np.outer(n, n)
        c = task.gain * task.object_speed * flow[:, 3:] @ n
        flow = flow @ jump
    return flow, np.vstack([h * h / 2 * push, h * push]), c


def solve_cvxpy_mpc(mpc: CvxpyMpc, problem: TrackingProblem, task: TrackingTask) -> np.ndarray:
    """Solve the MPC of `build_cvxpy_mpc` for one step.

    Args:
        mpc: the problem; its parameters are set.
        problem: that it was built from.
        task: of this step.

    Returns:
        Inputs of all stages in the body frame, shape (10, 3) [N, N, N m].

    Raises:
        SolverFailed: no solution, or a task that is not finite.
    """
    parameters = mpc.parameters
    if not all(np.isfinite(values).all() for values in task):
        raise SolverFailed(NAME, "the task is not finite", REMEDY)
    parameters["state"].value, parameters["states"].value, parameters["inputs"].value = task[:3]
    for name, matrix in zip("QP", make_matrices(problem.select_weights(task.node)), strict=True):
        parameters[name].value = np.linalg.cholesky(matrix)
    for k in range(STAGES):
        for name, value in zip("ABc", compute_stage(problem, task, k), strict=True):
            parameters[f"{name}[{k}]"].value = value
    try:
        mpc.problem.solve(solver=SOLVER, warm_start=False)  # the same whatever was solved before
    except cp.SolverError as error:
        raise SolverFailed(NAME, str(error).splitlines()[0], REMEDY) from error
    if mpc.problem.status != cp.OPTIMAL:
        raise SolverFailed(NAME, mpc.problem.status, REMEDY)
    return np.array(mpc.variables["inputs"].value)


class CvxpyTracker:
    """Track by an MPC in cvxpy.

    Args:
        build: makes the problem of one robot; one's own calls `build_cvxpy_mpc` and adds to it.
    """

    def __init__(self, build: Callable[[TrackingProblem], CvxpyMpc] = build_cvxpy_mpc) -> None:
        self._build = build
        self._problems: Mapping[str, TrackingProblem] = {}

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        """See `Tracker.reset`.

        Raises:
            InputError: the problem would be compiled anew in each step, because it is not within cvxpy's DPP rules.
        """
        if problems is not self._problems:
            self._problems = problems
            self._build_all()
        for robot, mpc in self._mpcs.items():
            if not mpc.problem.is_dpp():
                raise InputError(f"the cvxpy problem of robot '{robot}' breaks the rules for parameters (DPP)")

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        """See `Tracker.track`."""
        return solve_cvxpy_mpc(self._mpcs[robot], self._problems[robot], task)

    def _build_all(self) -> None:
        self._mpcs = {robot: self._build(problem) for robot, problem in self._problems.items()}

    def __getstate__(self) -> dict[str, Any]:
        return {"_build": self._build, "_problems": self._problems}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._build_all()
