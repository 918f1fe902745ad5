"""A linear problem without objective that is solved again and again while the bounds of its rows change."""

from __future__ import annotations

from typing import Any

import highspy
import numpy as np
from scipy import sparse

from planners.errors import SolverFailed

TOLERANCE = 1e-8  # of rows [their unit]


class RowBounds:
    """Hold rows A x <= u and B x = b over a box of x, and find points for changing u; each search starts at the last.

    Args:
        name: what failures call the problem.
        matrix: A above B, shape (m + e, n).
        upper: u, shape (m,).
        equal: b, shape (e,).
        box: lower and upper end of x, each shape (n,).
    """

    def __init__(
        self, name: str, matrix: sparse.csr_matrix, upper: np.ndarray, equal: np.ndarray, box: tuple[np.ndarray, ...]
    ) -> None:
        self.name, self.matrix, self.box, self.count = name, matrix, box, len(upper)
        self._equal, self._sent = equal, upper.copy()
        problem = highspy.HighsLp()
        problem.num_row_, problem.num_col_ = matrix.shape
        problem.col_cost_ = np.zeros(matrix.shape[1])
        problem.col_lower_, problem.col_upper_ = box
        problem.row_lower_ = np.concatenate([np.full(self.count, -highspy.kHighsInf), equal])
        problem.row_upper_ = np.concatenate([upper, equal])
        problem.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
        problem.a_matrix_.start_, problem.a_matrix_.index_ = matrix.indptr, matrix.indices
        problem.a_matrix_.value_ = matrix.data
        self._solver: Any = highspy.Highs()
        options: dict[str, Any] = {"output_flag": False, "threads": 1, "presolve": "off", "solver": "simplex"}
        for option, value in (options | {"primal_feasibility_tolerance": TOLERANCE}).items():
            self._solver.setOptionValue(option, value)
        self._solver.passModel(problem)

    def find_point(self, upper: np.ndarray) -> np.ndarray | None:
        """Return a point for these bounds of the inequalities, shape (n,), or None where there is none.

        Args:
            upper: u, shape (m,).

        Raises:
            SolverFailed: neither is found.
        """
        changed = np.flatnonzero(upper != self._sent)
        if len(changed):
            low = np.full(len(changed), -highspy.kHighsInf)
            self._solver.changeRowsBounds(len(changed), changed.astype(np.int32), low, upper[changed])
            self._sent[changed] = upper[changed]
        self._solver.run()
        status = self._solver.getModelStatus()
        if status in (highspy.HighsModelStatus.kOptimal, highspy.HighsModelStatus.kModelEmpty):
            return np.array(self._solver.getSolution().col_value)
        if status != highspy.HighsModelStatus.kInfeasible:
            raise SolverFailed(
                self.name, f"HiGHS: {self._solver.modelStatusToString(status).lower()}", "scale the rows"
            )
        return None

    def find_contradiction(self) -> tuple[np.ndarray, float]:
        """Return weights y >= 0 of the inequalities whose sum no point satisfies, and by how much it fails.

        With weights of any sign for the equalities, min over the box of y A x + z B x exceeds y u + z b. Call it where
        the last search found no point.

        Returns:
            Weights, shape (m,), of which the greatest is at most 1, and the excess; it is not positive where rounding
            leaves nothing that can be checked.
        """
        _, exists, ray = self._solver.getDualRay()
        if not exists:
            return np.zeros(self.count), 0.0
        weights = np.array(ray)
        mine = weights[: self.count]
        if -mine.min(initial=0.0) > mine.max(initial=0.0):
            weights = -weights
        weights[: self.count] = np.maximum(weights[: self.count], 0.0)
        weights /= max(float(np.abs(weights).max(initial=0.0)), 1e-12)
        row = weights @ self.matrix
        least = np.minimum(row * self.box[0], row * self.box[1]).sum()
        return weights[: self.count], float(least - weights @ np.concatenate([self._sent, self._equal]))
