"""What a plan file claims: its curves and impacts with the exact values of their numbers."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, NoReturn

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from impact_envs.errors import InputError, describe_fault
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import LARGEST
from planners.free_flyer.certificate.track import Track, derive, make_track

VERSIONS = (1, 2)  # of plan files that this reader knows
MOST_DEGREE = 30  # of curves; planners write 1 and 5
Number = Annotated[float, Field(strict=True, ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Pair = tuple[Number, Number]
Point = tuple[Fraction, Fraction]


class _Curve(BaseModel):
    model_config = ConfigDict(extra="forbid")
    times: list[Number]
    points: list[list[Pair]]


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
    version: int = 1
    scenario: str
    objective: str
    horizon: Number
    robustness: Number
    impacts: list[_Impact]
    robots: dict[str, _Curve]
    objects: dict[str, _Curve]
    # What is not certified: how near to the best it is, how it was made, and what deviations it bears.
    bound: Any = None
    gap: Any = None
    effort: Any = None
    effort_bound: Any = None
    solve_seconds: Any = None
    stage_seconds: Any = None
    validated: Any = None
    deviation: Any = None
    deviation_bound: Any = None
    tubes: dict[str, Any] = {}
    responses: dict[str, Any] = {}
    shape_error: Any = 0.0
    planned_responses: Any = ()


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
        raise InputError(f"plan file {path}: {describe_fault(error)}") from None
    except InputError as error:
        raise InputError(f"plan file {path}: {error}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"plan file {path}: not JSON of a plan: {error}") from None


def check_claim(claim: Claim, scenario: FreeFlyerScenario) -> None:
    """Raise unless a plan is for a scenario with discs of these names, and over its whole horizon.

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
            raise InputError(f"the impact at {float(impact.time):g} s is of {impact.robot} on {impact.object}")
    if claim.horizon != Fraction(scenario.horizon):
        raise InputError(f"the plan spans {float(claim.horizon):g} s, the scenario {scenario.horizon:g} s")


def _make_claim(file: _File) -> Claim:
    if file.version not in VERSIONS:
        _refuse(f"version {file.version} is unknown; choices: {', '.join(map(str, VERSIONS))}")
    if file.robots.keys() & file.objects.keys():
        _refuse(f"'{min(file.robots.keys() & file.objects.keys())}' is both a robot and an object")
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
    return Claim(
        file.scenario, Fraction(file.horizon), Fraction(file.robustness), impacts, paths, _read_deviation(file)
    )


def _read_deviation(file: _File) -> float | None:
    return float(file.deviation) if isinstance(file.deviation, int | float) else None


def _make_path(name: str, curve: _Curve, horizon: float) -> Motion:
    times, points = [Fraction(time) for time in curve.times], curve.points
    sizes = {len(piece) for piece in points}
    if len(times) < 2 or len(points) != len(times) - 1 or len(sizes) != 1 or not 1 <= min(sizes) <= MOST_DEGREE + 1:
        _refuse(f"curve of {name}: {len(times)} times and {len(points)} pieces with {sorted(sizes)} points do not fit")
    if any(after <= before for before, after in itertools.pairwise(times)):
        _refuse(f"curve of {name}: times do not increase")
    if times[0] != 0 or times[-1] != Fraction(horizon):
        _refuse(f"curve of {name}: spans [{curve.times[0]:g}, {curve.times[-1]:g}] s, expected [0, {horizon:g}] s")
    x, y = (make_track(times, [tuple(Fraction(point[axis]) for point in piece) for piece in points]) for axis in (0, 1))
    return Motion(x, y, derive(x), derive(y))


def _to_point(pair: Pair) -> Point:
    return Fraction(pair[0]), Fraction(pair[1])


def _refuse(reason: str) -> NoReturn:
    raise InputError(reason)
