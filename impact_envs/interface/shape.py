"""What a model looks like: shapes fixed in the world or carried by a body, for renderer and report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Role = Literal["robot", "object", "region", "obstacle", "wall"]


@dataclass(frozen=True)
class Shape:
    """One disc or polygon.

    Attributes:
        body: name of the body that carries it, None when fixed in the world.
        role: what it stands for; decides the colour.
        radius: of a disc [m], None for a polygon.
        vertices: of a polygon, in the body's frame (or the world's) [m], None for a disc.
        label: text drawn beside it; may be empty, and then the body's path is not drawn.
    """

    body: str | None
    role: Role
    radius: float | None = None
    vertices: tuple[tuple[float, float], ...] | None = None
    label: str = ""
