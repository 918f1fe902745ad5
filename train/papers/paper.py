"""What a paper publishes, and what computes it here: the file ``paper.toml`` of a domain's folder in ``train``."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, FiniteFloat, NonNegativeFloat, ValidationError

from impact_envs.domain import list_domains
from impact_envs.errors import InputError, choices, describe_fault


class Play(BaseModel):
    """A command that computes published numbers.

    Attributes:
        command: its name.
        arguments: as the command's fields, without --json.
        seconds: that it took on two cores, without compiling [s].
        says: what of the paper it plays.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    command: Literal["run", "plan"]
    arguments: Mapping[str, Any]
    seconds: NonNegativeFloat
    says: str


class Row(BaseModel):
    """A published number or ordering.

    Attributes:
        quantity: in words.
        unit: of the numbers, empty for none.
        paper: the number, or a text where the paper prints none.
        place: in the paper.
        here: values of plays, each ``PLAY:key.index``; several are in the order that the paper claims, from the least.
        scale: from what the command returns to the unit.
        tolerance: greatest difference that counts as agreement; None: nothing to agree with.
        fitted: the scenario was made from this number, so that agreement proves nothing.
        why: of a difference.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    quantity: str
    unit: str = ""
    paper: int | FiniteFloat | str
    place: str
    here: tuple[str, ...]
    scale: FiniteFloat = 1.0
    tolerance: NonNegativeFloat | None = None
    fitted: bool = False
    why: str = ""


class Figure(BaseModel):
    """A figure of the paper, and the play whose picture shows the same."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    play: str
    says: str


class Paper(BaseModel):
    """A paper.

    Attributes:
        name: that users type.
        title: with its authors.
        plays, rows, figures: of it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    title: str
    plays: dict[str, Play]
    rows: tuple[Row, ...]
    figures: dict[str, Figure]

    def select(self, figure: str | None) -> dict[str, Play]:
        """Return the plays of a figure, of the whole paper if None.

        Raises:
            InputError: the paper has no such figure here.
        """
        if figure is None:
            return self.plays
        if figure not in self.figures:
            raise InputError(f"figure '{figure}' of {self.name} is unknown; {choices(figure, self.figures)}")
        play = self.figures[figure].play
        return {play: self.plays[play]}


def list_papers() -> dict[str, Path]:
    """Return the files of all papers, by the name of the domain."""
    found = {}
    for domain in list_domains():
        package = find_spec(f"train.{domain}")
        if package is not None and package.origin is not None:
            path = Path(package.origin).parent / "paper.toml"
            if path.is_file():
                found[domain] = path
    return found


def load_paper(name: str) -> Paper:
    """Read a paper's file.

    Args:
        name: of the paper or of its domain.

    Raises:
        InputError: no such paper, or its file does not make sense.
    """
    known: list[str] = []
    for domain, path in list_papers().items():
        try:
            paper = Paper.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"paper file {path}: {error}") from None
        except ValidationError as error:
            raise InputError(f"paper file {path}: {describe_fault(error)}") from None
        if name in (paper.name, domain):
            return paper
        known += [paper.name]
    raise InputError(f"paper '{name}' is unknown; {choices(name, known)}")
