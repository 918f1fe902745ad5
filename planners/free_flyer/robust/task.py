"""What the planner for the greatest deviation is asked for, and how far it goes."""

from __future__ import annotations

from dataclasses import dataclass, field

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.box_grid import BoxGrid, build_box_grid
from planners.free_flyer.robust.conditions import Conditions
from planners.free_flyer.robust.side_rows import add_side_rows
from planners.free_flyer.robust.zonotope_grid import build_zonotope_grid
from planners.free_flyer.specification.formula_rows import add_demands
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import Demands
from planners.free_flyer.specification.selection import Choices
from planners.spline_rows import SmoothingOptions


@dataclass(frozen=True)
class DeviationOptions:
    """Choose how closely the greatest deviation is found.

    Args:
        gap: to which it is proven, relative.
        rough_gap: the same while numbers of impacts are compared.
        worth: by how much more impacts have to raise it, relative.
        smallest: deviation below which a task counts as bearing none [m/s].
        families: pieces per leg, and whether areas may be reached between impacts; in the order in which they are
            tried.
    """

    gap: float = 1e-2
    rough_gap: float = 0.1
    worth: float = 0.2
    smallest: float = 1e-4
    families: tuple[tuple[int, bool], ...] = ((1, False), (2, True))


@dataclass(frozen=True)
class ResponseOptions:
    """Choose how impacts become smooth responses.

    Args:
        settle: longest time a robot takes to leave its responses before an impact, or to return after it [s].
        near: robots farther apart than this beyond their clearance get no rows [m].
        smoothing: weights and number of rounds; the first price of slacks alone is used.
    """

    settle: float = 10.0
    near: float = 1.0
    smoothing: SmoothingOptions = field(default_factory=lambda: SmoothingOptions(slack_weights=(1e3,), rounds=5))


@dataclass(frozen=True)
class RobustOptions:
    """Choose how far a plan that bears deviations is improved, and how it is checked.

    Args:
        share: of the greatest deviation that the plan is made for; the rest leaves room for smooth motions.
        smaller_shares: factors of this share, tried in turn when no motions bear the deviation.
        calmer: by what factor legs are slower to start and stop, and room beyond contact points to come to a halt
            [m]; tried in turn when motions prove too quick to be smoothed.
        more_words: number of other sequences of hitting robots that are tried then.
        halvings: how often the reserves are halved for a task that leaves no room for them.
        cost_gap: to which the least path cost is proven, relative.
        tangents: number of tangent planes of the path cost per piece, axis and sign.
        steps: control steps by which impacts may move so that they fall on one.
        runs: number of simulated runs of the closed loop.
        seed: of their randomness.
        deviation: of the search for the greatest deviation.
        response: of the motions.
    """

    share: float = 0.8
    smaller_shares: tuple[float, ...] = (1.0, 0.75, 0.5)
    calmer: tuple[tuple[float, float], ...] = ((1.0, 0.0), (1.25, 0.05), (1.5, 0.1))
    more_words: int = 2
    halvings: int = 2
    cost_gap: float = 0.05
    tangents: int = 12
    steps: int = 10
    runs: int = 200
    seed: int = 0
    deviation: DeviationOptions = field(default_factory=DeviationOptions)
    response: ResponseOptions = field(default_factory=ResponseOptions)


@dataclass(frozen=True)
class RobustTask:
    """Hold what is asked of a plan that bears deviations.

    Args:
        scenario: one object, any number of robots.
        demands: of the formula and of solid obstacles.
        conditions: what a deviation refers to.
        reserves: what the plan keeps in hand.
        segments: number of segments of the paper's constant grid; None: the times of impacts are free.
        solver: of mixed-integer models.
        options: how far the plan is improved.
    """

    scenario: FreeFlyerScenario
    demands: Demands
    conditions: Conditions
    reserves: Reserves
    segments: int | None = None
    solver: str = "highs"
    options: RobustOptions = field(default_factory=RobustOptions)

    def build(self, size: GridSize, delta: float | None) -> tuple[BoxGrid, Choices]:
        """Build the model of all plans of a size for a deviation, formula included.

        Args:
            size: of the grid.
            delta: deviation to bear [m/s]; None: as great as possible, on a constant grid only.

        Returns:
            The grid, and what reads from its solutions how the formula holds in them.

        Raises:
            Infeasible: the variable bounds alone exclude every plan.
        """
        scenario, conditions, reserves = self.scenario, self.conditions, self.reserves
        if self.segments is not None:
            grid = build_zonotope_grid(scenario, self.segments, delta, conditions, reserves)
        else:
            assert delta is not None
            grid = build_box_grid(scenario, size.impacts, delta, conditions, reserves, size.pieces)
        if not conditions.points:
            add_side_rows(grid, scenario, reserves)
        return grid, add_demands(grid, self.demands, scenario.control_period, size.passing)
