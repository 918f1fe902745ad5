"""What a planner promises: curves, impacts, robustness with its proven bound."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pydantic import ConfigDict, FiniteFloat, TypeAdapter, ValidationError

from impact_envs.errors import InputError, choices
from impact_envs.file import write_atomically
from planners.bezier import Array, Curve, read_array

_STRICT = ConfigDict(extra="forbid")
# Of the JSON: 2 has `planned_responses`; texts without a version are of version 1.
VERSION = 2
VERTICES = 4  # of a box in the plane
Objective = Literal["robustness", "impact_uncertainty"]


@dataclass(frozen=True, eq=False)
class PlannedImpact:
    """Hold one planned impact of a robot on an object.

    Args:
        time: instant of the impact [s].
        robot: name of the robot that hits.
        object: name of the object that is hit.
        position: centre of the object, shape (2,) [m].
        contact: centre of the robot = position - (r_R + r_O) normal, shape (2,) [m].
        normal: unit vector from robot to object, the direction of the impulse, shape (2,).
        robot_minus: velocity of the robot just before, shape (2,) [m/s].
        robot_plus: velocity of the robot just after, shape (2,) [m/s].
        object_minus: velocity of the object just before, shape (2,) [m/s].
        object_plus: velocity of the object just after, shape (2,) [m/s].

    Raises:
        InputError: a vector is not two finite numbers.
    """

    time: FiniteFloat
    robot: str
    object: str
    position: Array
    contact: Array
    normal: Array
    robot_minus: Array
    robot_plus: Array
    object_minus: Array
    object_plus: Array

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        for name in _vectors():
            vector = read_array(getattr(self, name))
            if vector.shape != (2,):
                raise InputError(f"impact at {self.time} s: {name} has shape {vector.shape}, expected (2,)")
            object.__setattr__(self, name, vector)

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, PlannedImpact) and all(
            np.array_equal(getattr(self, field.name), getattr(other, field.name)) for field in fields(self)
        )

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class Tube:
    """Hold boxes in state space that an object cannot leave, whatever the disturbance at its impacts.

    Segment k lasts from times[k] to times[k+1]; the box moves linearly from its start to its end.

    Args:
        times: breakpoints, shape (S+1,), increasing [s].
        start: of every segment: centre (x, y, vx, vy) and half widths, shape (S, 2, 4) [m, m/s].
        end: the same at the end of every segment, shape (S, 2, 4) [m, m/s].

    Raises:
        InputError: shapes do not fit, or a half width is negative.

    Source: Verhagen & Tumova, Eqs. (3), (18), (19).
    """

    times: Array
    start: Array
    end: Array

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        for name in ("times", "start", "end"):
            object.__setattr__(self, name, read_array(getattr(self, name)))
        expected = (max(len(self.times) - 1, 1) if self.times.ndim == 1 else 1, 2, 4)
        if self.start.shape != expected or self.end.shape != expected:
            shapes = f"times {self.times.shape}, start {self.start.shape}, end {self.end.shape}"
            raise InputError(f"tube: {shapes} do not fit, expected (S+1,), (S, 2, 4) and (S, 2, 4)")
        if min(self.start[:, 1].min(), self.end[:, 1].min()) < 0 or (np.diff(self.times) <= 0).any():
            raise InputError("tube: half widths must not be negative and times must increase")

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Tube) and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in ("times", "start", "end")
        )

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class PlannedResponse:
    r"""Hold what the place of the object at one impact decides, in a plan that bears deviations.

    With d the place over the half widths of the tube's box from its centre, in [-1, 1] per axis, the robot follows
    sum_v prod_i (1 + v_i d_i) / 2 curve_v over its curves for the vertices v = (-, -), (-, +), (+, -), (+, +), which is
    affine in either axis, and gives the object the velocity object_plus + gain (place - centre).

    Args:
        start: from then on the robot responds to this impact [s].
        end: until then [s].
        leave: when the robot leaves its responses to meet the object exactly [s].
        join: when it is back on them after the impact [s].
        gain: change of the wanted velocity after the impact over the place's, per axis, shape (2,) [1/s].

    Raises:
        InputError: times out of order, or a gain that is not two finite numbers.

    Source: Verhagen & Tumova, Lemma 1 and Eq. (16).
    """

    start: FiniteFloat
    end: FiniteFloat
    leave: FiniteFloat
    join: FiniteFloat
    gain: Array

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        object.__setattr__(self, "gain", read_array(self.gain))
        if self.gain.shape != (2,):
            raise InputError(f"planned response: gain has shape {self.gain.shape}, expected (2,)")
        if not (self.start < self.end and self.leave < self.join):
            times = f"start {self.start}, end {self.end}, leave {self.leave}, join {self.join}"
            raise InputError(f"planned response: {times} s are out of order")

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, PlannedResponse) and all(
            np.array_equal(getattr(self, field.name), getattr(other, field.name)) for field in fields(self)
        )

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True)
class Plan:
    """Hold a motion plan for all robots and objects of a scenario.

    Args:
        scenario: name of the scenario the plan was made for.
        objective: what was maximised, "robustness" or "impact_uncertainty".
        horizon: duration T of the plan [s].
        robustness: STL robustness of the whole formula over the centres of all bodies [m].
        bound: proven upper bound of the robustness of any plan, with any number of impacts [m].
        gap: (bound - robustness) / max(1, |bound|); 0 once below the planner's tolerance of a micrometre.
        effort: path cost: sum over all bodies and legs between events of |displacement|^2 / duration [m^2/s].
        effort_bound: proven lower bound of the path cost at this robustness, number of impacts and these reserves;
            None: none was proven.
        impacts: planned impacts in the order of time.
        robots: curve of every robot's centre, over [0, T].
        objects: curve of every object's centre, over [0, T].
        solve_seconds: wall time of the whole planning [s].
        stage_seconds: wall time of each stage [s].
        validated: True if the independent simulation agreed with every promise.
        deviation: permissible deviation delta of an object's velocity after an impact, per axis; None: the plan was not
            made for any [m/s].
        deviation_bound: proven upper bound of the deviation of any such plan [m/s].
        tubes: object to the boxes it stays in under such deviations.
        responses: robot to its curves for the vertices of the boxes: (x-, y-), (x-, y+), (x+, y-), (x+, y+).
        shape_error: by how much the flown robustness may be lower, because objects are no discs; 0: all are discs [m].
        planned_responses: to each impact, in their order, when these curves hold; empty: nothing says so, as in
            plans of version 1, and nobody follows them.

    Raises:
        InputError: the curves do not span [0, T], or an impact names an unknown body or time.
    """

    scenario: str
    objective: Objective
    horizon: FiniteFloat
    robustness: FiniteFloat
    bound: FiniteFloat
    gap: FiniteFloat
    effort: FiniteFloat
    effort_bound: FiniteFloat | None
    impacts: tuple[PlannedImpact, ...]
    robots: dict[str, Curve]
    objects: dict[str, Curve]
    solve_seconds: FiniteFloat
    stage_seconds: dict[str, FiniteFloat]
    validated: bool
    deviation: FiniteFloat | None = None
    deviation_bound: FiniteFloat | None = None
    tubes: dict[str, Tube] = field(default_factory=dict)
    responses: dict[str, tuple[Curve, ...]] = field(default_factory=dict)
    shape_error: FiniteFloat = 0.0
    planned_responses: tuple[PlannedResponse, ...] = ()

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        if self.objective not in get_args(Objective):
            raise InputError(
                f"plan: objective '{self.objective}' is unknown; {choices(self.objective, get_args(Objective))}"
            )
        for name, curve in (self.robots | self.objects).items():
            if curve.times[0] != 0.0 or curve.times[-1] != self.horizon:
                span = f"[{curve.times[0]}, {curve.times[-1]}]"
                raise InputError(f"plan: curve of {name} spans {span} s, expected [0, {self.horizon}] s")
        previous = 0.0
        for impact in self.impacts:
            _check_name(impact.robot, self.robots)
            _check_name(impact.object, self.objects)
            if not previous <= impact.time <= self.horizon:
                raise InputError(f"plan: impact time {impact.time} s is not in [{previous}, {self.horizon}] s")
            previous = impact.time
        self._check_responses()

    def _check_responses(self) -> None:
        """Raise unless what is planned to respond can be followed."""
        if not self.planned_responses:
            return
        if len(self.planned_responses) != len(self.impacts):
            counts = f"{len(self.planned_responses)} planned responses, {len(self.impacts)} impacts"
            raise InputError(f"plan: {counts}, expected one for each")
        for impact in self.impacts:
            if impact.object not in self.tubes:
                raise InputError(f"plan: responses to {impact.object}, which has no tube")
            curves = self.responses.get(impact.robot, ())
            if len(curves) != VERTICES:
                raise InputError(f"plan: {len(curves)} responses of {impact.robot}, expected {VERTICES}")
            times = self.robots[impact.robot].times
            if any(not np.array_equal(curve.times, times) for curve in curves):
                raise InputError(f"plan: breakpoints of the responses of {impact.robot} are not those of its curve")

    def to_json(self) -> str:
        """Return the plan as JSON text; reading it back gives an equal plan, bit for bit."""
        return json.dumps({"version": VERSION, **_adapter().dump_python(self, mode="json")}, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Plan:
        """Return the plan written in JSON text.

        Args:
            text: what `to_json` returned.

        Returns:
            The plan.

        Raises:
            InputError: not JSON, a key is unknown or missing, a value does not fit, or the version is a later one.
        """
        try:
            content = json.loads(text)
            version = content.pop("version", 1) if isinstance(content, dict) else 1
            if version not in range(1, VERSION + 1):
                raise InputError(f"plan: version {version!r:.60} is unknown; choices: 1 to {VERSION}")
            return _adapter().validate_python(content)
        except ValidationError as error:
            raise InputError(f"plan: {_first_line(error)}") from None
        except ValueError as error:
            raise InputError(f"plan: not JSON: {error}") from None
        except RecursionError:
            raise InputError("plan: not JSON of a plan: nested too deep") from None

    def save(self, path: str | Path) -> None:
        """Write the plan to a JSON file.

        Args:
            path: file to write.

        Raises:
            InputError: the file cannot be written.
        """
        write_atomically(path, (self.to_json() + "\n").encode())

    @classmethod
    def load(cls, path: str | Path) -> Plan:
        """Read a plan from a JSON file.

        Args:
            path: file to read.

        Returns:
            The plan.

        Raises:
            InputError: the file cannot be read, or does not hold a plan.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "not text"
            raise InputError(f"plan file {path}: cannot be read: {reason}") from None
        try:
            return cls.from_json(text)
        except InputError as error:
            raise InputError(f"plan file {path}: {error}") from None


@cache
def _vectors() -> tuple[str, ...]:
    return tuple(field.name for field in fields(PlannedImpact) if field.name not in ("time", "robot", "object"))


@cache
def _adapter() -> TypeAdapter[Plan]:
    return TypeAdapter(Plan)


def _check_name(name: str, curves: dict[str, Curve]) -> None:
    if name not in curves:
        raise InputError(f"plan: impact names {name!r}, which has no curve; choices: {', '.join(curves)}")


def _first_line(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    message = first["msg"].removeprefix("Value error, ").removeprefix("plan: ")
    return f"{where}: {message}" if where else message
