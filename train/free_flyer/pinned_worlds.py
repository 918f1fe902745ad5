"""Worlds whose drawn numbers are chosen: what a search for failures varies, from the schema's disturbances."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.truth import Drawn, Physics, Truth
from impact_envs.scenario import Uniform

# Names of several fields of `Truth` that a user varies as one.
GROUPS = {
    name: tuple(f"{kind}_start_{axis}" for kind in kinds for axis in "xy")
    for name, kinds in (
        ("start", ("robot", "object")), ("robot_start", ("robot",)), ("object_start", ("object",)),
    )
}  # fmt: skip
DRAWN = tuple(
    name for name, field in Truth.model_fields.items() if any(isinstance(how, Drawn) for how in field.metadata)
)


class PinnedScenario:
    """A scenario that draws what it is told to; all else is the scenario's.

    A place of 0 is the least value of a range, 1 the greatest; all robots or objects share it. What is drawn beside a
    value, such as a direction, and values without a range stay the seed's, so that a suite with the ranges
    ``[value, value]`` has the same world on the same seed, bit for bit.

    Args:
        scenario: in a suite that draws something.

    Attributes:
        names: of the disturbances with a range, fields of `Truth`.
    """

    def __init__(self, scenario: FreeFlyerScenario) -> None:
        self._scenario = scenario
        self._columns: dict[str, list[int]] = {}
        self._ranges: dict[str, tuple[float, float]] = {}
        self._whole: dict[str, bool] = {}
        self._read_ranges()
        self.names = tuple(self._columns)
        self._places: np.ndarray | None = None

    @staticmethod
    def read_ranges(texts: Iterable[str]) -> dict[str, Any]:
        """Return the changes of a scenario, dotted key to range, that some texts ask for.

        Args:
            texts: NAME=LOW,HIGH, a field of `Truth`; NAME=HALF means from -HALF to HALF. ``start`` is how far robots
                and objects start from where they are believed, along x and y [m]; ``robot_start``, ``object_start``.

        Raises:
            InputError: a name that is none, or no range.
        """
        changes: dict[str, Any] = {}
        for text in texts:
            name, _, ends = text.partition("=")
            if name not in (*GROUPS, *DRAWN):
                raise InputError(f"--vary {text}: '{name}' is unknown; {choices(name, (*GROUPS, *DRAWN))}")
            uniform = _read_ends(text, ends)
            changes |= {f"true.{field}": {"uniform": uniform} for field in GROUPS.get(name, (name,))}
        return changes

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scenario, name)

    def _read_ranges(self) -> None:
        """Find the columns of the uniform numbers that a disturbance is drawn from, one for each body."""
        counts = {"world": 1, "robot": len(self._scenario.robots), "object": len(self._scenario.objects)}
        place = 0
        for name, row in self._scenario.list_drawn().items():
            how = next(how for how in Truth.model_fields[name].metadata if isinstance(how, Drawn))
            length, given = len(row) // counts[how.per], getattr(self._scenario.true, name)
            varied = isinstance(given, Uniform) and given.uniform[0] < given.uniform[1]
            for number, quantity in enumerate(row):
                if isinstance(quantity, Uniform):
                    if varied and number % length == 0:
                        self._columns.setdefault(name, []).append(place)
                        self._ranges[name], self._whole[name] = quantity.uniform, how.whole
                    place += 1

    @property
    def nominal(self) -> np.ndarray:
        """Return the places of what is believed, undisturbed; they may lie outside of [0, 1]; shape (names,)."""
        places = []
        for name in self.names:
            low, high = self._ranges[name]
            usual = Truth.model_fields[name].default
            value = getattr(self._scenario.believed, name) if usual is None else usual
            places.append(_find_place(value + 0.5 * self._whole[name], low, high))
        return np.array(places)

    def pin(self, places: np.ndarray) -> None:
        """Choose the numbers of the worlds that are drawn next.

        Args:
            places: shape (worlds, names).
        """
        self._places = np.array(places)

    def draw_many(self, uniforms: np.ndarray) -> Physics:
        """Turn uniform numbers into worlds, with the chosen ones where all pinned worlds are drawn; see the schema."""
        if self._places is not None and len(uniforms) == len(self._places):
            uniforms = np.array(uniforms)
            for name, column in zip(self.names, self._places.T, strict=True):
                uniforms[:, self._columns[name]] = column[:, None]
        return self._scenario.draw_many(uniforms)

    def list_values(self, places: np.ndarray) -> Mapping[str, float]:
        """Return the values at some places, shape (names,), by the scenario's dotted keys."""
        values = {}
        for name, place in zip(self.names, places, strict=True):
            low, high = self._ranges[name]
            value = float(low + (high - low) * place)
            values[f"true.{name}"] = min(float(np.floor(value)), high - 1.0) if self._whole[name] else value
        return values


def _read_ends(text: str, ends: str) -> list[float]:
    """Return the least and the greatest value of a range."""
    try:
        values = [float(end) for end in ends.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(map(math.isfinite, values)):
        raise InputError(f"--vary {text}: NAME=HALF or NAME=LOW,HIGH is needed, for example start=0.05")
    if len(values) == 1 and values[0] <= 0.0:
        raise InputError(f"--vary {text}: HALF of NAME=HALF must be above 0: the range is from -HALF to HALF")
    if len(values) == 2 and values[0] >= values[1]:
        raise InputError(f"--vary {text}: LOW of NAME=LOW,HIGH must be less than HIGH")
    return values if len(values) == 2 else [-values[0], values[0]]


def _find_place(value: float, low: float, high: float) -> float:
    """Return the place at which low + (high - low) place is a value to the last bit, where one nearby is.

    Rounding must not make a disturbance that is zero a little negative, which no scenario may have.
    """
    place = (value - low) / (high - low)
    near = [place + ulps * float(np.spacing(place)) for ulps in sorted(range(-8, 9), key=abs)]
    return next((one for one in near if low + (high - low) * one == value), place)
