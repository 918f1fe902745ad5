"""What changes from picture to picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from impact_envs.picture.drawing import Points

Pose = tuple[float, float, float]
HEADER, FOOTER, MARGIN = 66, 18, 14  # of a picture [px]


class Mark(NamedTuple):
    """An impact as it is drawn.

    Attributes:
        x, y: where [m].
        age: time since [s].
        changes: (x, y, vx, vy) of each body that it struck: where its centre was, change of its velocity [m, m/s].
    """

    x: float
    y: float
    age: float
    changes: Sequence[tuple[float, float, float, float]] = ()


@dataclass(frozen=True, eq=False)
class Frame:
    """Hold what changes from picture to picture.

    Args:
        time: since the start of the episode [s].
        poses: (x, y, heading) of each body [m, m, rad].
        chains: links from where a body is held to the body, by body, shape (n, 2) [m].
        trails: positions so far of each body, shape (n, 2) [m].
        plans: planned curves by body (any other name is drawn grey), shape (n, 2) [m].
        impacts: oldest first; the last dozen are drawn.
        robustness: interval of robustness still possible; None when there is no formula.
        unit: of the robustness; may be empty.
        caption: first header line, for example scenario and policy.
        speed: time shown in one second of the viewer's, 1 is real time; None where nobody knows.
        note: a line at the lower edge, for example which keys there are.
    """

    time: float
    poses: Mapping[str, Pose]
    chains: Mapping[str, Points] = field(default_factory=dict)
    trails: Mapping[str, Points] = field(default_factory=dict)
    plans: Mapping[str, Points] = field(default_factory=dict)
    impacts: Sequence[Mark] = ()
    robustness: tuple[float, float] | None = None
    unit: str = ""
    caption: str = ""
    speed: float | None = None
    note: str = ""
