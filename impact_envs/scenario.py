"""Scenario files: TOML read into frozen, validated tables; every error is one line.

What all domains share lives here (regions, quantities drawn from the seed, overrides, suites); the tables of one
domain live in ``impact_envs/<domain>/schema.py``.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from impact_envs.domain import find_part, find_scenarios, list_domains
from impact_envs.errors import InputError, ScenarioError, choices
from impact_envs.stl import LARGEST, RESERVED, SIGNALS, Formula, parse

SMALLEST = 1e-9  # of numbers that must be positive: quotients with LARGEST, and their products, stay finite
MOST_PERIODS = 1_000_000  # control periods in a horizon: hours of computing
LONGEST_PERIOD = 60.0  # of control [s]: within one, engines may take many short steps
LONGEST_NAME = 64  # letters, so that files can be called after it


def _check_size(number: float) -> float:
    if number < SMALLEST:
        raise ValueError(f"{number:g} is below {SMALLEST:g}, the smallest number above 0")
    return number


Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False), AfterValidator(_check_size)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Vector = tuple[Finite, Finite]


def _check_file_name(name: str) -> str:
    if not re.fullmatch(rf"[\w-][\w.-]{{0,{LONGEST_NAME - 1}}}", name):
        raise ValueError(
            f"{name!r} cannot name a file; use up to {LONGEST_NAME} letters, digits, '_', '-' and, not first, '.'"
        )
    return name


Name = Annotated[str, AfterValidator(_check_file_name)]  # files may be called after it


class Table(BaseModel):
    """A TOML table: frozen, and a key it does not know is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, ignored_types=(cached_property,))


class Uniform(Table):
    """A quantity drawn uniformly at reset: ``{ uniform = [low, high] }``."""

    uniform: Vector  # least and greatest value, in the unit of the quantity

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.uniform[0] > self.uniform[1]:
            raise ValueError(f"low {self.uniform[0]:g} is above high {self.uniform[1]:g}")
        return self


Quantity = Finite | Uniform


def draw(quantity: Quantity, rng: np.random.Generator) -> float:
    """Return the number, or draw it from its distribution.

    Args:
        quantity: a number, or a distribution.
        rng: the episode's generator; a plain number draws nothing from it.

    Returns:
        One number in the quantity's unit.
    """
    return float(rng.uniform(*quantity.uniform)) if isinstance(quantity, Uniform) else float(quantity)


class Box(Table):
    """An axis-aligned box ``lower <= p <= upper`` [m]."""

    lower: Vector  # corner of least x and y [m]
    upper: Vector  # corner of greatest x and y [m]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        check_box(self.lower, self.upper)
        return self

    @property
    def diagonal(self) -> float:
        """Return the length of the diagonal [m]."""
        return math.dist(self.lower, self.upper)


class Region(Table):
    """A convex area: a box (``lower``, ``upper``) or a polygon (``vertices``) [m]."""

    lower: Vector | None = None  # of a box: corner of least x and y [m]
    upper: Vector | None = None  # of a box: corner of greatest x and y [m]
    vertices: tuple[Vector, ...] | None = None  # of a polygon, counter-clockwise [m]

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.vertices is None:
            if self.lower is None or self.upper is None:
                raise ValueError("give lower and upper, or vertices")
            check_box(self.lower, self.upper)
        elif self.lower is not None or self.upper is not None:
            raise ValueError("give either lower and upper, or vertices, not both")
        else:
            check_convex(self.vertices)
        return self

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Return the corners, counter-clockwise [m]."""
        if self.vertices is not None:
            return self.vertices
        assert self.lower is not None and self.upper is not None
        (x0, y0), (x1, y1) = self.lower, self.upper
        return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))

    def halfspaces(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the area as ``H p <= b`` with unit rows.

        Returns:
            H: shape (faces, 2). b: shape (faces,) [m].

        Source: Verhagen & Tumova, Eq. 21.
        """
        corners = np.array(self.corners)
        edges = np.roll(corners, -1, axis=0) - corners
        H = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1, keepdims=True)
        return H, np.sum(H * corners, axis=1)


def check_box(lower: Vector, upper: Vector) -> None:
    """Raise unless one corner of a box is below the other in both axes.

    Args:
        lower, upper: corners [m].

    Raises:
        ValueError: it is not, or by less than what counts as a length.
    """
    if not all(low + SMALLEST <= high for low, high in zip(lower, upper, strict=True)):
        raise ValueError(f"lower {list(lower)} must be below upper {list(upper)} in both axes")


def check_convex(vertices: tuple[tuple[float, float], ...]) -> None:
    """Raise unless the vertices go counter-clockwise round a strictly convex polygon.

    Args:
        vertices: corners [m].

    Raises:
        ValueError: fewer than three corners, or a corner that does not turn left.
    """
    if len(vertices) < 3:
        raise ValueError(f"a polygon needs at least 3 vertices, got {len(vertices)}")
    points = np.array(vertices)
    edges = np.roll(points, -1, axis=0) - points
    if np.min(np.hypot(*edges.T)) < SMALLEST:
        raise ValueError(f"two vertices in a row are nearer than {SMALLEST:g} m")
    after = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    angle = np.sum(np.arctan2(turns, np.sum(edges * after, axis=1)))
    if np.any(turns <= 0) or not math.isclose(angle, 2 * math.pi, rel_tol=1e-6):
        raise ValueError("vertices must go counter-clockwise round a convex polygon")


class Scenario(Table):
    """What every domain's scenario has: a name, a formula, a horizon, areas and mismatch suites."""

    suite_file: ClassVar[Path | None] = None

    name: Name = ""  # unset: the file's name
    domain: str  # whose tables follow
    description: str = ""  # one sentence
    formula: str  # in Signal Temporal Logic, times in s
    horizon: Positive  # duration of an episode, a whole number of control periods [s]
    control_period: Annotated[Positive, Field(le=LONGEST_PERIOD)]  # of actions and samples [s]
    regions: dict[str, Region] = {}  # that the formula may name
    suites: dict[Name, dict[str, Any]] = {}  # by name: dotted keys and their values in that suite

    @property
    def agents(self) -> tuple[str, ...]:
        """Return the names of the controlled agents, in file order."""
        raise TypeError("a domain's schema says who its agents are")

    @property
    def bodies(self) -> tuple[str, ...]:
        """Return the names of all bodies a formula may speak of, in canonical order."""
        raise TypeError("a domain's schema says what its bodies are")

    @property
    def signals(self) -> tuple[str, ...]:
        """Return what a formula may say of a body, for example ``vx`` in ``pop.vx``."""
        return SIGNALS

    @property
    def areas(self) -> Mapping[str, Region]:
        """Return every area a formula may name."""
        return self.regions

    @property
    def steps(self) -> int:
        """Return the number of control periods in the horizon."""
        return round(self.horizon / self.control_period)

    @cached_property
    def specification(self) -> Formula:
        """Return the parsed formula."""
        return parse(self.formula)

    def as_believed(self) -> Self:
        """Return the scenario as the expert sees it: the true physics are the believed ones."""
        raise TypeError("a domain's schema says what is believed")

    def override(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with some values replaced, validated anew.

        Args:
            values: dotted keys to values, for example ``{"true.restitution": 0.5}``.

        Raises:
            ScenarioError: an unknown key or a value that does not fit.
        """
        if not isinstance(values, Mapping) or not all(isinstance(key, str) for key in values):
            raise ScenarioError(f"{self.name}: override {values!r:.60}: a dict from dotted key to value is needed")
        data = self.model_dump(exclude_unset=True)
        for key, value in values.items():
            table = data
            *path, last = key.split(".")
            for part in path:
                table = table.setdefault(part, {})
                if not isinstance(table, dict):
                    raise ScenarioError(f"{self.name}: {key}: '{part}' is a value, not a table")
            table[last] = value
        return build_scenario(data, source=self.name or "scenario")

    def suite(self, name: str) -> Self:
        """Return the scenario with a suite's true world; what the expert believes stays.

        Args:
            name: a suite, for example ``restitution``.

        Raises:
            ScenarioError: no such suite.
        """
        table = self._suites()
        if not isinstance(name, str) or name not in table:
            raise ScenarioError(f"{self.name}: suite '{name!s:.60}' is unknown; {choices(name, table)}")
        values = dict(table[name])
        scale = values.pop("horizon_scale", 1.0)
        if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 < scale <= 1:
            raise ScenarioError(
                f"{self.name}: suite '{name}': horizon_scale = {scale!r:.60}: must be above 0, at most 1"
            )
        changed = self.override(values)
        return changed if scale == 1.0 else changed.shorten(scale)

    def shorten(self, scale: float) -> Self:
        """Return the scenario with horizon and every time in the formula scaled.

        The horizon is kept a whole number of control periods, at least one. An interval of the formula that contains no
        sample any more moves to the sample before it.

        Args:
            scale: factor in (0, 1] for tighter tasks.
        """
        horizon = max(1, round(self.horizon * scale / self.control_period)) * self.control_period
        return self.override({"horizon": horizon, "formula": self._shorten_formula(self.specification, horizon)})

    def _shorten_formula(self, formula: Formula, horizon: float) -> str:
        return str(formula.scale_time(horizon / self.horizon).move_to_samples(self.control_period))

    def list_suites(self) -> list[str]:
        """Return the names of its suites: those of its domain, then its own."""
        return list(self._suites())

    def _suites(self) -> dict[str, dict[str, Any]]:
        shipped = tomllib.loads(self.suite_file.read_text()) if self.suite_file else {}
        return {**shipped, **self.suites}

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.horizon > self.control_period * MOST_PERIODS * (1 + 1e-9):
            raise ValueError(
                f"control_period = {self.control_period:g}: horizon {self.horizon:g} has more than "
                f"{MOST_PERIODS} control periods"
            )
        if not math.isclose(self.steps * self.control_period, self.horizon, rel_tol=1e-9):
            raise ValueError(
                f"horizon {self.horizon:g} is not a whole number of control periods {self.control_period:g}"
            )
        for name in (*self.bodies, *self.areas):
            if name in RESERVED or not re.fullmatch(rf"[^\W\d]\w{{0,{LONGEST_NAME - 1}}}", name):
                raise ValueError(
                    f"'{name}' cannot be named in a formula; use at most {LONGEST_NAME} letters, digits and underscores"
                )
        try:
            formula = self.specification
            formula.check_names(self.bodies, tuple(self.areas), self.signals)
            formula.reach(self.control_period)
        except InputError as error:
            raise ValueError(f"formula: {error}") from None
        if formula.horizon > self.horizon * (1 + 1e-9):
            raise ValueError(f"formula: looks {formula.horizon:g} s ahead, the horizon is {self.horizon:g} s")
        return self


def list_scenarios() -> tuple[str, ...]:
    """Return the names of the shipped scenarios, sorted."""
    return tuple(sorted(path.stem for path in find_scenarios()))


def load_scenario(source: str | Path | Scenario) -> Scenario:
    """Read a scenario.

    Args:
        source: the name of a shipped scenario, the path of a TOML file, or a Scenario (returned as it is).

    Returns:
        A frozen, validated scenario of its domain's type.

    Raises:
        ScenarioError: one line naming file, key, value and the choices.
    """
    if isinstance(source, Scenario):
        return source
    if not isinstance(source, str | Path):
        raise ScenarioError(f"a scenario is a name, a path or a Scenario, got {type(source).__name__}")
    shipped = {path.stem: path for path in find_scenarios()}
    path = shipped.get(str(source), Path(source))
    if not _is_file(path):
        if path.suffix == ".toml" or len(path.parts) > 1:
            raise ScenarioError(f"{path}: no such scenario file; {choices(path.stem, sorted(shipped))}")
        raise ScenarioError(f"scenario '{source!s:.60}' is unknown; {choices(str(source), sorted(shipped))}")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{path}: not readable as TOML: {error}") from None
    except RecursionError:
        raise ScenarioError(f"{path}: not readable as TOML: nested too deeply") from None
    if not data:
        raise ScenarioError(f"{path}: the file is empty; it needs at least domain, formula, horizon, control_period")
    data.setdefault("name", path.stem)
    return build_scenario(data, source=str(path))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # for example a name too long for the file system
        return False


def build_scenario(data: dict[str, Any], source: str) -> Any:
    """Validate tables read from a file or made by an override.

    Args:
        data: nested tables, as TOML gives them.
        source: what to call the file in an error.

    Raises:
        ScenarioError: one line naming source, key, value and the choices.
    """
    domain = data.get("domain")
    known = list_domains()
    if not isinstance(domain, str) or domain not in known:
        wrong = "is missing" if domain is None else f"{domain!r:.60} is unknown"
        raise ScenarioError(f"{source}: domain {wrong}; {choices(str(domain), known)}")
    schema = find_part("impact_envs", domain, "SCHEMA")
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(f"{source}: {_one_line(error, schema, data)}") from None
    except UnicodeEncodeError as error:
        raise ScenarioError(f"{source}: {error.object!r:.60} is no text: {error.reason}") from None


def _one_line(error: ValidationError, schema: type[Table], data: Any) -> str:
    """Say the first thing wrong in the file's own words: key, value, limit and choices."""
    # A misspelt key is also a missing one; the misspelling is what the user wants to hear of.
    # And a table for a quantity is a distribution with a fault rather than no number.
    first = min(
        error.errors(),
        key=lambda entry: (
            entry["type"] != "extra_forbidden",
            entry["type"] == "float_type" and isinstance(entry["input"], dict),
        ),
    )
    path = _find_path(first["loc"], data)
    if first["type"] == "missing":
        path.append(str(first["loc"][-1]))
    key = ".".join(path)
    if first["type"] == "extra_forbidden":
        known = _keys(schema, path[:-1])
        where = f" in [{'.'.join(path[:-1])}]" if path[:-1] else ""
        return f"unknown key '{path[-1]}'{where}; {choices(path[-1], known)}"
    if first["type"] == "missing":
        return f"{key} is missing"
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "value_error":
        return f"{key}: {message}" if key else message
    return f"{key} = {first['input']!r:.60}: {message[0].lower()}{message[1:]}"


def _find_path(location: tuple[int | str, ...], data: Any) -> list[str]:
    """Return the keys of the file among an error's: pydantic puts names of its own between, as of a union's branch."""
    path = []
    for part in location:
        known = range(len(data)) if isinstance(data, list | tuple) else data if isinstance(data, dict) else ()
        if part in known:
            path.append(str(part))
            data = data[part]
    return path


def _keys(schema: type[Table], path: list[str]) -> list[str]:
    """Return the keys known in the table at a path of the file."""
    table: Any = schema
    for part in path:
        if isinstance(table, type) and issubclass(table, BaseModel) and part in table.model_fields:
            table = table.model_fields[part].annotation
            continue
        table = getattr(table, "__args__", (None, table))[-1]
    if not (isinstance(table, type) and issubclass(table, BaseModel)):
        table = next(
            (arg for arg in getattr(table, "__args__", ()) if isinstance(arg, type) and issubclass(arg, BaseModel)),
            Table,
        )
    return [field.alias or name for name, field in table.model_fields.items()]
