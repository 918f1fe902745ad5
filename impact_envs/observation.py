"""Where the parts of an observation stand: named fields in place of index arithmetic.

A domain says once what its observations hold, as a `Layout`. What writes, reads or describes them asks the layout.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import Box

from impact_envs.errors import InputError, choices
from impact_envs.stl import Formula

# Elements of a body's motion.
MOTION = ("x [m]", "y [m]", "vx [m/s]", "vy [m/s]", "heading [rad]", "omega [rad/s]")


class Layout:
    """The fields of an observation vector, in order: ``vector[layout["pop"]]`` is what is observed of ``pop``.

    Args:
        fields: names, each with what its elements are and their units: ``("tip", ("x [m]", "y [m]"))``.

    Attributes:
        fields: by name.
        size: length of the vector.

    Raises:
        InputError: two fields of one name.
    """

    def __init__(self, *fields: tuple[str, Sequence[str]]) -> None:
        self.fields, self.size, self._slices = dict(fields), 0, dict[str, slice]()
        for name, elements in fields:
            if name in self._slices:
                raise InputError(f"'{name}' names two fields of the observation: choose another name for the body")
            self._slices[name] = slice(self.size, self.size + len(elements))
            self.size += len(elements)

    def __getitem__(self, name: str) -> slice:
        if name not in self._slices:
            raise InputError(f"observation has no field '{name}'; {choices(name, self._slices)}")
        return self._slices[name]

    def describe(self) -> str:
        """Return one line for each element: its index, its field and what it is."""
        lines = [f"{name}: {element}" for name, elements in self.fields.items() for element in elements]
        return "\n".join(f"{index:3} {line}" for index, line in enumerate(lines))

    def make_space(self) -> Box:
        """Return the space of such vectors."""
        return make_unbounded_space(self.size)


def describe_robustness(formula: Formula) -> tuple[str, ...]:
    """Return what the robustness in an observation is, element by element: an interval per conjunct of the formula.

    The interval of the whole formula lies between the least of the lower ends and the least of the upper ones.

    Args:
        formula: without ``&`` outside all operators it is its only conjunct.
    """
    return tuple(f"robustness_{end} of {part} [m]" for part in formula.conjuncts() for end in ("lower", "upper"))


def make_unbounded_space(size: int) -> Box:
    """Return the space of all float64 vectors of a size."""
    return Box(-np.inf, np.inf, (size,), np.float64)
