"""Typed failures of planners: what was asked, what the solver said, what to try."""

from __future__ import annotations


class PlanningError(Exception):
    """No plan.

    Attributes:
        problem: name of the optimisation problem.
        status: what the solver or the check said.
        remedy: what the user can change.
    """

    def __init__(self, problem: str, status: str, remedy: str) -> None:
        super().__init__(f"{problem}: {status}; {remedy}")
        self.problem, self.status, self.remedy = problem, status, remedy

    def __reduce__(self) -> tuple[type[PlanningError], tuple[str, str, str]]:
        return type(self), (self.problem, self.status, self.remedy)


class Infeasible(PlanningError):
    """The problem is proven to have no solution within its limits."""


class SolverFailed(PlanningError):
    """The solver stopped without a usable answer, or its answer failed the independent check."""


class OutOfWork(Exception):
    """The work that planning may take is done; no PlanningError, for what tries something else after those must end."""
