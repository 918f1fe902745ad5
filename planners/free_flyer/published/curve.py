r"""Plans as the published planner writes them: a pair of Bezier curves per piece, p(h(s)) = r(s) for s in [0, 1]."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from impact_envs.errors import InputError, choices
from planners.bezier import Array, Side, read_array
from planners.plan import Tube

LABELS = ("none", "pre", "post")
JUMP = 1e-6  # greatest gap between curves that join, and between bodies at their impact [m, s]
SOLVED = 1e-13  # residual of h(s) = t, relative to the horizon
ITERATIONS = 100  # greatest number, of Newton's method


@dataclass(frozen=True, eq=False)
class PublishedBody:
    """Hold the curves of one body.

    Args:
        r: control points of x, y, theta, shape (n, d+1, 3) [m, m, rad].
        h: control points of the time, shape (n, d+1), increasing [s].
        ids: of every curve: "pre" if it ends at an impact, else "post" if it starts at one, else "none".
        other_names: of every curve, the body of that impact, or "none".

    Raises:
        InputError: shapes do not fit, time does not increase, curves do not join, or a label is unknown.

    Source: Verhagen & Tumova, Eqs. (8), (11).
    """

    r: Array
    h: Array
    ids: tuple[str, ...]
    other_names: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "r", read_array(self.r))
        object.__setattr__(self, "h", read_array(self.h))
        if self.h.ndim != 2 or len(self.h) < 1 or self.degree < 1 or self.r.shape != (*self.h.shape, 3):
            shapes = f"rvars {self.r.shape}, hvars {self.h.shape}"
            raise InputError(f"{shapes} do not fit, expected (n, d+1, 3) and (n, d+1) with d > 0")
        if not len(self.ids) == len(self.other_names) == len(self.h):
            counts = f"{len(self.ids)} ids and {len(self.other_names)} other_names"
            raise InputError(f"{counts} for {len(self.h)} curves")
        for k, label in enumerate(self.ids, start=1):
            other = self.other_names[k - 1]
            if label not in LABELS:
                raise InputError(f"ids: curve {k} is '{label}'; {choices(label, LABELS)}")
            if (label == "none" and other != "none") or (label == "pre" and other == "none"):
                raise InputError(f"curve {k} has id '{label}' and other name '{other}', which contradict each other")
        _check_joints(self.r, self.h)

    @property
    def degree(self) -> int:
        """Return the degree d of all curves."""
        return self.h.shape[1] - 1

    @property
    def times(self) -> np.ndarray:
        """Return the ends of the curves, shape (n+1,) [s]."""
        return np.append(self.h[:, 0], self.h[-1, -1])

    def position(self, t: float | np.ndarray, side: Side = "right") -> np.ndarray:
        """Return the position p(t) = r(s) where h(s) = t.

        Args:
            t: time, scalar or shape (n,), held at the ends of the plan [s].
            side: which curve answers where two meet.

        Returns:
            Position, shape (2,) or (n, 2) [m].
        """
        k, s = self._locate(t, side)
        return evaluate_bezier(self.r[k, :, :2], s).reshape(*np.shape(t), 2)

    def velocity(self, t: float | np.ndarray, side: Side = "right") -> np.ndarray:
        """Return the velocity p'(t) = r'(s) / h'(s) where h(s) = t.

        Args:
            t: time, scalar or shape (n,), held at the ends of the plan [s].
            side: limit taken where the velocity jumps, at impacts.

        Returns:
            Velocity, shape (2,) or (n, 2) [m/s].
        """
        k, s = self._locate(t, side)
        steps = evaluate_bezier(np.diff(self.r[k, :, :2], axis=1), s)
        durations = evaluate_bezier(np.diff(self.h[k], axis=1)[..., None], s)
        return (steps / durations).reshape(*np.shape(t), 2)

    def impact_partner(self, joint: int) -> str | None:
        """Return the body hit where a curve ends and the next one starts.

        Args:
            joint: index of the earlier curve.

        Returns:
            Its name; None where nothing is hit.

        Raises:
            InputError: the labels state an impact, but not with which body.
        """
        if self.ids[joint] == "pre":
            return self.other_names[joint]
        if joint + 1 == len(self.ids) or self.ids[joint + 1] != "post":
            return None
        if self.other_names[joint + 1] == "none":
            raise InputError(f"curve {joint + 2} is 'post', but names no other body and follows no 'pre'")
        return self.other_names[joint + 1]

    def _locate(self, t: float | np.ndarray, side: Side) -> tuple[np.ndarray, np.ndarray]:
        """Return curve and parameter at every time, each shape (n,)."""
        moments = np.clip(np.atleast_1d(np.asarray(t, dtype=float)), self.times[0], self.times[-1])
        k = np.clip(np.searchsorted(self.times, moments, side=side) - 1, 0, len(self.h) - 1)
        return k, _solve_clock(self.h[k], moments, SOLVED * self.times[-1])


@dataclass(frozen=True, eq=False)
class PublishedPlan:
    """Hold the curves of all bodies, and the boxes of objects under impact uncertainty.

    Args:
        bodies: name to its curves; those of objects are straight (degree 1), those of robots are not.
        zonotopes: object to its boxes at the start and end of every curve.

    Raises:
        InputError: bodies do not span one time from 0 on, a name is unknown, or boxes do not fit the curves.

    Source: Verhagen & Tumova, Sec. IV-A and Eqs. (18), (19).
    """

    bodies: dict[str, PublishedBody]
    zonotopes: dict[str, Tube] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, body in self.bodies.items():
            start, end = body.times[[0, -1]].tolist()
            if abs(start) > JUMP or abs(end - self.horizon) > JUMP:
                raise InputError(f"{name} spans [{start}, {end}] s, expected [0, {self.horizon}] s")
            for k, other in enumerate(body.other_names, start=1):
                if other not in ("none", *self.bodies):
                    names = choices(other, ("none", *self.bodies))
                    raise InputError(f"{name}: other_names: curve {k} names '{other}'; {names}")
        for name, tube in self.zonotopes.items():
            if name not in self.objects:
                raise InputError(f"zonotopes of '{name}', which is no object; {choices(name, self.objects)}")
            if not np.array_equal(tube.times, self.bodies[name].times):
                raise InputError(f"zonotopes of {name} do not last as long as its curves")

    @property
    def objects(self) -> tuple[str, ...]:
        """Return the bodies with straight curves."""
        return tuple(name for name, body in self.bodies.items() if body.degree == 1)

    @property
    def robots(self) -> tuple[str, ...]:
        """Return all other bodies."""
        return tuple(name for name in self.bodies if name not in self.objects)

    @property
    def horizon(self) -> float:
        """Return the duration of the plan [s]."""
        return float(next(iter(self.bodies.values())).times[-1]) if self.bodies else 0.0


def evaluate_bezier(points: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return points on Bezier curves by de Casteljau's rule.

    Args:
        points: control points, shape (n, d+1, c).
        s: parameter of every curve, shape (n,).

    Returns:
        Points, shape (n, c).

    Source: Verhagen & Tumova, Eq. (8).
    """
    share = s[:, None, None]
    while points.shape[1] > 1:
        points = (1.0 - share) * points[:, :-1] + share * points[:, 1:]
    return points[:, 0]


def _solve_clock(clocks: np.ndarray, t: np.ndarray, tolerance: float) -> np.ndarray:
    """Return s with h(s) = t, shape (n,): Newton's step where it stays between the bounds found, else their middle."""
    slopes = (clocks.shape[1] - 1) * np.diff(clocks, axis=1)[..., None]
    lower, upper = np.zeros_like(t), np.ones_like(t)
    s = np.clip((t - clocks[:, 0]) / (clocks[:, -1] - clocks[:, 0]), 0.0, 1.0)
    for _ in range(ITERATIONS):
        error = evaluate_bezier(clocks[..., None], s)[:, 0] - t
        open_ = np.abs(error) > tolerance
        if not open_.any():
            break
        lower, upper = np.where(error < 0, s, lower), np.where(error > 0, s, upper)
        step = s - error / evaluate_bezier(slopes, s)[:, 0]
        step = np.where((lower < step) & (step < upper), step, (lower + upper) / 2)
        s = np.where(open_, step, s)
    return s


def _check_joints(r: np.ndarray, h: np.ndarray) -> None:
    """Raise unless time increases along every curve and each curve starts where the one before it ends."""
    for k, clock in enumerate(h, start=1):
        if (np.diff(clock) <= 0).any():
            raise InputError(f"hvars: curve {k} does not increase: {clock.tolist()} s")
    for k in range(1, len(h)):
        ends = {"hvars": (h[k - 1, -1:], h[k, :1]), "rvars": (r[k - 1, -1, :2], r[k, 0, :2])}
        for block, (end, start) in ends.items():
            if np.abs(start - end).max() > JUMP:
                jump = f"curve {k + 1} starts at {start.tolist()}, curve {k} ends at {end.tolist()}"
                raise InputError(f"{block}: {jump}")
