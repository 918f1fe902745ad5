"""Tables of a point-mass scenario."""

from __future__ import annotations

from typing import Literal, NamedTuple, Self

import numpy as np

from impact_envs.scenario import Box, Positive, Quantity, Scenario, Table, Vector, draw


class Truth(Table):
    """Physics of the simulated world."""

    restitution: Quantity = 1.0  # of the walls


class Physics(NamedTuple):
    """One drawn world."""

    restitution: float


class PointMassScenario(Scenario):
    """A puck that is pushed by a force, and bounces off the walls of its world."""

    domain: Literal["point_mass"]
    world: Box
    start: Vector  # [m]
    goal: Vector  # that the expert steers to [m]
    mass: Positive  # [kg]
    force_limit: Positive  # per axis [N]
    true: Truth = Truth()

    @property
    def agents(self) -> tuple[str, ...]:
        return ("puck",)

    @property
    def bodies(self) -> tuple[str, ...]:
        return ("puck",)

    def as_believed(self) -> Self:
        return self.model_copy(update={"true": Truth()})

    def draw(self, rng: np.random.Generator) -> Physics:
        return Physics(draw(self.true.restitution, rng))
