"""The path cost of polylines in a mixed-integer model: the sum over pieces and axes of displacement^2 / duration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from planners.mixed_integer import Affine, Model


@dataclass(frozen=True)
class Displacement:
    """Hold a piece of a body's path.

    Args:
        body: its name.
        move: displacement, shape (2,), of numbers or expressions [m].
        duration: number or expression [s].
        fastest: greatest speed per axis; 0: the piece costs nothing [m/s].
    """

    body: str
    move: np.ndarray
    duration: Affine | float
    fastest: float


@dataclass(frozen=True)
class PieceCost:
    """Hold the cost of a piece along one axis: cost >= move^2 / duration.

    Args:
        body: its name.
        cost: variable [m^2/s].
        move: displacement [m].
        duration: of the piece [s].
    """

    body: str
    cost: Affine
    move: Affine
    duration: Affine

    def add_tangents(self, model: Model, speed: float) -> None:
        """Add the tangent planes cost >= 2 q move - q^2 duration for q = speed and q = -speed [m/s]."""
        for slope in (speed, -speed):
            model.require(self.move * (2 * slope) - self.duration * slope**2 - self.cost)


def add_path_cost(model: Model, pieces: Iterable[Displacement], tangents: int) -> list[PieceCost]:
    """Make the path cost the objective of a model, bounded from below by tangent planes.

    Args:
        model: gets variables, rows and objective.
        pieces: of all bodies.
        tangents: number of tangent planes per piece, axis and sign, at equally spaced speeds.

    Returns:
        The costs of all pieces that move; their sum is the objective.
    """
    costs, total = [], Affine({})
    for piece in pieces:
        duration = piece.duration + Affine({})
        for step in piece.move if piece.fastest > 0.0 else ():
            greatest = piece.fastest**2 * model.limits(duration)[1]
            found = PieceCost(piece.body, model.variable(0.0, greatest), step + Affine({}), duration)
            for speed in piece.fastest * np.arange(1, tangents + 1) / tangents:
                found.add_tangents(model, speed)
            costs.append(found)
            total = total + found.cost
    model.objective = total
    return costs


def compute_path_cost(costs: Sequence[PieceCost], x: np.ndarray) -> float:
    """Return the exact path cost at a point of the model, shape (n,) [m^2/s]."""
    return sum(part.move.value(x) ** 2 / part.duration.value(x) for part in costs)


def measure_path_cost(knots: np.ndarray, times: np.ndarray) -> float:
    """Return the path cost of one polyline.

    Args:
        knots: shape (n, 2) [m].
        times: of the knots, shape (n,) [s].

    Returns:
        Sum of displacement^2 / duration [m^2/s].
    """
    return np.sum(np.diff(knots, axis=0) ** 2 / np.diff(times)[:, None])
