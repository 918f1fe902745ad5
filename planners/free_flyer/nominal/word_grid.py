"""The event grid of one sequence of impacts: its greatest robustness, then events of less path cost, without search."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planners.cones import solve_cones
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.event_grid import EventGrid
from planners.free_flyer.nominal.event_sequence import Word
from planners.free_flyer.nominal.least_cost import CostOptimum, read_events
from planners.free_flyer.nominal.task import NominalTask
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.selection import Choices
from planners.mixed_integer import Solution
from planners.path_cost import PieceCost, add_path_cost
from planners.solvers import solve

SLACK = 1e-6  # of robustness, so that the cone program has an inside [m]


@dataclass
class WordGrid:
    """Hold a grid and its point of greatest robustness.

    Args:
        task: what is asked.
        grid: the grid.
        choices: alternatives of the formula.
        x: the point, shape (n,).
        proven: whether no point is more robust.
    """

    task: NominalTask
    grid: EventGrid
    choices: Choices
    x: np.ndarray
    proven: bool = True

    @property
    def rho(self) -> float:
        """Return the greatest robustness [m]."""
        return float(self.grid.rho.value(self.x))

    def read(self) -> CostOptimum:
        """Return the events of the point, whatever their path cost; of one object."""
        return read_events(self.task, self.grid, self.choices, self.x)

    def reduce_cost(self, rho: float) -> CostOptimum:
        """Return the events of least path cost that keep a robustness and take the point's alternatives; one object.

        Args:
            rho: robustness to keep [m].

        Raises:
            SolverFailed: the cone program has no usable answer.
        """
        model, costs = self.grid.model, self._costs
        (index,) = self.grid.rho.coefficients
        model.lower[index] = rho - SLACK
        start = np.zeros(len(model.lower))
        start[: len(self.x)] = self.x
        return read_events(self.task, self.grid, self.choices, solve_cones(model, start, costs))

    @cached_property
    def _costs(self) -> list[PieceCost]:
        return add_path_cost(self.grid.model, self.grid.displacements(), 1)


def solve_word_grid(
    task: NominalTask,
    size: GridSize,
    rho: tuple[float, float],
    time_limit: float,
    gap: float,
    word: Word | None = None,
    pauses: int | None = None,
) -> WordGrid:
    """Return the grid of a size and its point of greatest robustness.

    Args:
        task: what is asked.
        size: of the grid.
        rho: least and greatest robustness [m].
        time_limit: wall time of each mixed-integer solution [s].
        gap: to which the greatest robustness is proven, relative.
        word: who hits what; None: anybody anything.
        pauses: of the solver in each solution, see `planners.solvers.Limits`; None: any number.

    Raises:
        Infeasible: no plan of this size.
        SolverFailed: out of time, or of pauses.
    """
    grid, choices = task.build(size, rho, word)
    grid.model.objective = -grid.rho
    found: list[Solution] = []

    def solve_point() -> np.ndarray:
        found.append(solve(grid.model, time_limit, gap, task.solver, work=task.work, pauses=pauses))
        return found[-1].x

    x = solve_apart(grid, task.scenario, task.reserves, solve_point)
    last = found[-1]
    return WordGrid(task, grid, choices, x, last.objective - last.bound <= gap * abs(last.objective) + SLACK)
