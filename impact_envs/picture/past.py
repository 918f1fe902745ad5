"""What pictures of one world show: its bodies now, their paths, and past impacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from impact_envs.interface.shape import Shape
from impact_envs.physics.impact import Impact
from impact_envs.picture.frame import Frame, Mark, Pose
from impact_envs.picture.unit import find_unit


class Past:
    """Paths and impacts of one episode.

    Args:
        bodies: of the world, in order.
        shapes: as drawn; those with a label leave a trail.
        steps: control periods of an episode, at most.
        signals: at the start.

    Attributes:
        marks: every impact, and of each body that it struck where its centre was and the change of its velocity.
    """

    def __init__(
        self, bodies: Sequence[str], shapes: Sequence[Shape], steps: int, signals: Mapping[str, float]
    ) -> None:
        self._bodies = tuple(bodies)
        self._trailed = [shape.body for shape in shapes if shape.body is not None and shape.label]
        self._track = np.empty((steps + 1, len(bodies), 3))  # poses of every step
        self.marks: list[tuple[Impact, list[tuple[float, float, float, float]]]] = []
        self.add(0, signals, signals, [])

    def add(self, step: int, before: Mapping[str, float], signals: Mapping[str, float], impacts: list[Impact]) -> None:
        """Keep what is drawn of a control period.

        Args:
            step: its number, 0 at the start.
            before: signals at its start; a body's change of velocity in an impact is that of the whole period.
            signals: at its end.
            impacts: within it.
        """
        self._track[step] = list_poses(self._bodies, signals)
        for impact in impacts:
            changes = []
            for body in (impact.a, impact.b):
                if body in self._bodies:
                    x, y, vx, vy = (f"{body}.{name}" for name in ("x", "y", "vx", "vy"))
                    changes.append((before[x], before[y], signals[vx] - before[vx], signals[vy] - before[vy]))
            self.marks.append((impact, changes))

    def find_trails(self, step: int) -> dict[str, np.ndarray]:
        """Return the positions up to a step of the bodies that leave a trail, shape (step + 1, 2) each [m]."""
        return {body: self._track[: step + 1, self._bodies.index(body), :2] for body in self._trailed}

    def list_marks(self, time: float) -> list[Mark]:
        """Return the impacts as they are drawn at a time [s]."""
        return [Mark(*mark.point, time - mark.time, changes) for mark, changes in self.marks]


def list_poses(bodies: Sequence[str], signals: Mapping[str, float]) -> list[Pose]:
    """Return x, y, heading of bodies [m], [rad]."""
    return [(signals[f"{body}.x"], signals[f"{body}.y"], signals[f"{body}.heading"]) for body in bodies]


def draw_world(env: Any) -> Frame:
    """Return what is to be drawn of the present step of an ImpactEnv."""
    scenario, past, signals = env.scenario, env.past, env.signals
    bodies = scenario.bodies
    return Frame(
        time=env.time,
        poses=dict(zip(bodies, list_poses(bodies, signals), strict=True)),
        chains=env.task.chains(env.last_states),
        trails={} if past is None else past.find_trails(env.steps),
        plans=env.curves,
        impacts=[] if past is None else past.list_marks(env.time),
        robustness=env.bounds,
        unit=find_unit(scenario.specification),
        caption=env.caption or scenario.name,
        speed=env.speed,
    )
