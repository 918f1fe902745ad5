"""What a plan file claims: its curves and impacts with the exact values of their numbers."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal, NoReturn

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import LARGEST
from planners.free_flyer.certificate.track import Track, derive, make_track

VERSIONS = (1, 2)  # of plan files that this reader knows
MOST_DEGREE = 30  # of curves; planners write 1 and 5
VERTICES = 4  # of a box in the plane: a robot's responses
Number = Annotated[float, Field(strict=True, ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Amount = Annotated[Number, Field(ge=0)]
Pair = tuple[Number, Number]
Box = tuple[tuple[Number, Number, Number, Number], tuple[Amount, Amount, Amount, Amount]]  # centre, half widths
Point = tuple[Fraction, Fraction]


class _Curve(BaseModel):
    model_config = ConfigDict(extra="forbid")
    times: list[Number]
    points: list[list[Pair]]


class _Tube(BaseModel):
    model_config = ConfigDict(extra="forbid")
    times: list[Number]
    start: list[Box]
    end: list[Box]


class _Response(BaseModel):
    model_config = ConfigDict(extra="forbid")
    start: Number
    end: Number
    leave: Number
    join: Number
    gain: Pair


class _Impact(BaseModel):
    model_config = ConfigDict(extra="forbid")
    time: Number
    robot: str
    object: str
    position: Pair
    contact: Pair
    normal: Pair
    robot_minus: Pair
    robot_plus: Pair
    object_minus: Pair
    object_plus: Pair


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")
    version: Annotated[int, Field(strict=True)] = 1
    scenario: str
    objective: Literal["robustness", "impact_uncertainty"]
    horizon: Number
    robustness: Number
    impacts: list[_Impact]
    robots: dict[str, _Curve]
    objects: dict[str, _Curve]
    # What is read and not certified: how near to the best it is, how it was made, and what deviations it bears.
    bound: Number | None = None
    gap: Number | None = None
    effort: Amount | None = None
    effort_bound: Number | None = None
    solve_seconds: Amount | None = None
    stage_seconds: dict[str, Amount] | None = None
    validated: Annotated[bool, Field(strict=True)] | None = None
    deviation: Amount | None = None
    deviation_bound: Number | None = None
    tubes: dict[str, _Tube] = {}
    responses: dict[str, list[_Curve]] = {}
    shape_error: Amount = 0.0
    planned_responses: list[_Response] = []


@dataclass(frozen=True)
class Motion:
    """The motion of a body's centre.

    Attributes:
        x, y: position [m].
        vx, vy: velocity [m/s].
    """

    x: Track
    y: Track
    vx: Track
    vy: Track

    @property
    def position(self) -> tuple[Track, Track]:
        """Return x and y."""
        return self.x, self.y

    @property
    def velocity(self) -> tuple[Track, Track]:
        """Return vx and vy."""
        return self.vx, self.vy


@dataclass(frozen=True)
class ClaimedImpact:
    """An impact as the file tells it.

    Attributes:
        time: [s].
        robot, object: who hits and who is hit.
        vectors: the others of its fields by name [m, m/s].
    """

    time: Fraction
    robot: str
    object: str
    vectors: Mapping[str, Point]


@dataclass(frozen=True)
class Claim:
    """What a plan file claims.

    Attributes:
        scenario: name of the scenario that it is for.
        horizon: its duration [s].
        promised: robustness of the formula over the curves [m].
        impacts: in the order of time.
        paths: of all bodies, by their names.
        deviation: claimed for the object's velocity after impacts; None: the plan claims none [m/s].
    """

    scenario: str
    horizon: Fraction
    promised: Fraction
    impacts: tuple[ClaimedImpact, ...]
    paths: Mapping[str, Motion]
    deviation: float | None


def read_claim(path: str | Path) -> Claim:
    """Read a plan file.

    Args:
        path: a JSON file that `impact plan --out` wrote.

    Raises:
        InputError: it cannot be read, or is no plan.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        file = _File.model_validate(content)
        return _make_claim(file)
    except OSError as error:
        raise InputError(f"plan file {path}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        raise InputError(f"plan file {path}: {_describe_fault(error)}") from None
    except InputError as error:
        raise InputError(f"plan file {path}: {error}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"plan file {path}: not JSON of a plan: {error}") from None


def check_claim(claim: Claim, scenario: FreeFlyerScenario, unchanged: FreeFlyerScenario | None = None) -> None:
    """Raise unless a plan is for a scenario with discs of these names, and over its whole horizon.

    Args:
        claim: of the plan.
        scenario: in its suite.
        unchanged: the same in no suite, to say which of its suites has the plan's horizon.

    Raises:
        InputError: it is not.
    """
    if claim.scenario != scenario.name:
        raise InputError(f"the plan is for scenario '{claim.scenario}', not for '{scenario.name}'")
    if claim.paths.keys() != set(scenario.bodies):
        raise InputError(f"the plan moves {', '.join(claim.paths)}; the scenario has {', '.join(scenario.bodies)}")
    for name, body in scenario.objects.items():
        if body.vertices is not None:
            raise InputError(f"objects.{name} is a polygon; a certificate is for discs only")
    for impact in claim.impacts:
        if impact.robot not in scenario.robots or impact.object not in scenario.objects:
            name, known = impact.robot, list(scenario.robots)
            if name in known:
                name, known = impact.object, list(scenario.objects)
            pair = f"{impact.robot} on {impact.object}"
            raise InputError(
                f"the impact at {float(impact.time):g} s is of {pair}: '{name}' is unknown; {choices(name, known)}"
            )
    if claim.horizon != Fraction(scenario.horizon):
        spans = f"the plan spans {float(claim.horizon):g} s, the scenario {scenario.horizon:g} s"
        raise InputError(f"{spans}{_name_suite(claim.horizon, unchanged)}")


def _name_suite(horizon: Fraction, unchanged: FreeFlyerScenario | None) -> str:
    """Return the advice to name a suite, where one has this horizon."""
    if unchanged is None:
        return ""
    fitting = (name for name in unchanged.list_suites() if unchanged.suite(name).horizon == horizon)
    name = next(fitting, None)
    return "" if name is None else f"; name its suite with --suite, for example {name}"


def _make_claim(file: _File) -> Claim:
    if file.version not in VERSIONS:
        _refuse(f"version {file.version} is unknown; choices: {', '.join(map(str, VERSIONS))}")
    if file.robots.keys() & file.objects.keys():
        _refuse(f"'{min(file.robots.keys() & file.objects.keys())}' is both a robot and an object")
    _check_uncertified(file)
    curves = file.robots | file.objects
    impacts = tuple(
        ClaimedImpact(Fraction(one.time), one.robot, one.object, {name: _to_point(pair) for name, pair in pairs})
        for one in file.impacts
        for pairs in [[(name, value) for name, value in one if isinstance(value, tuple)]]
    )
    for before, after in itertools.pairwise(impacts):
        if after.time < before.time:
            _refuse(f"the impact at {float(after.time):g} s stands behind the one at {float(before.time):g} s")
    paths = {name: _make_path(name, curve, file.horizon) for name, curve in curves.items()}
    return Claim(file.scenario, Fraction(file.horizon), Fraction(file.robustness), impacts, paths, file.deviation)


def _check_uncertified(file: _File) -> None:
    """Raise unless tubes and responses are of the plan's bodies, and their numbers fit together."""
    for field, named, bodies in (("tubes", file.tubes, file.objects), ("responses", file.responses, file.robots)):
        for name in named:
            if name not in bodies:
                _refuse(f"{field}.{name}: '{name}' is unknown; {choices(name, bodies)}")
    for name, tube in file.tubes.items():
        if not len(tube.times) - 1 == len(tube.start) == len(tube.end) >= 1:
            counts = f"{len(tube.times)} times, {len(tube.start)} boxes start and {len(tube.end)} end"
            _refuse(f"tubes.{name}: {counts}, which do not fit")
        _check_times(f"tubes.{name}", tube.times)
    for name, curves in file.responses.items():
        if len(curves) != VERTICES:
            _refuse(f"responses.{name}: {len(curves)} curves, expected {VERTICES}")
        for number, curve in enumerate(curves):
            _check_curve(f"responses.{name}.{number}", curve)
    answered, hit = len(file.planned_responses), len(file.impacts)
    if answered not in (0, hit):
        _refuse(f"planned_responses: {answered}, expected one for each of {hit} impacts")
    for number, one in enumerate(file.planned_responses):
        if not (one.start < one.end and one.leave < one.join):
            times = f"start {one.start:g}, end {one.end:g}, leave {one.leave:g}, join {one.join:g}"
            _refuse(f"planned_responses.{number}: {times} s are out of order")


def _check_curve(where: str, curve: _Curve) -> None:
    times, points, sizes = curve.times, curve.points, {len(piece) for piece in curve.points}
    if len(times) < 2 or len(points) != len(times) - 1 or len(sizes) != 1 or not 1 <= min(sizes) <= MOST_DEGREE + 1:
        _refuse(f"{where}: {len(times)} times and {len(points)} pieces with {sorted(sizes)} points do not fit")
    _check_times(where, times)


def _check_times(where: str, times: Sequence[float]) -> None:
    for before, after in itertools.pairwise(times):
        if after <= before:
            _refuse(f"{where}: times do not increase: {before:g} s, then {after:g} s")


def _make_path(name: str, curve: _Curve, horizon: float) -> Motion:
    _check_curve(f"curve of {name}", curve)
    times, points = [Fraction(time) for time in curve.times], curve.points
    if times[0] != 0 or times[-1] != Fraction(horizon):
        _refuse(f"curve of {name}: spans [{curve.times[0]:g}, {curve.times[-1]:g}] s, expected [0, {horizon:g}] s")
    x, y = (make_track(times, [tuple(Fraction(point[axis]) for point in piece) for piece in points]) for axis in (0, 1))
    return Motion(x, y, derive(x), derive(y))


def _to_point(pair: Pair) -> Point:
    return Fraction(pair[0]), Fraction(pair[1])


def _describe_fault(error: ValidationError) -> str:
    """Return the first field that does not fit, its value, and why."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"]) or "content"
    value = "" if first["type"] == "missing" else f" = {first['input']!r:.60}"
    return f"{where}{value}: {first['msg']}"


def _refuse(reason: str) -> NoReturn:
    raise InputError(reason)
