"""Files of pictures: what can be written, and writing it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from impact_envs.errors import InputError
from impact_envs.file import replace_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".pdf", ".svg")


def check_picture_path(path: str | Path) -> None:
    """Raise unless a picture can be written there.

    Args:
        path: of the picture.

    Raises:
        InputError: a suffix of no known format, or a folder that does not exist.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(f"picture {path}: choices: a file ending in {', '.join(SUFFIXES)}")
    if not Path(path).absolute().parent.is_dir():
        raise InputError(f"picture {path}: folder {Path(path).absolute().parent} does not exist")


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure; equal figures give equal files.

    Args:
        figure: to write.
        path: of a .png, .pdf or .svg file.

    Raises:
        InputError: another suffix, or a file that cannot be written.
    """
    from matplotlib import rc_context

    check_picture_path(path)
    undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    with replace_file(path) as partial, rc_context({"svg.hashsalt": "picture"}):
        figure.savefig(partial, metadata=undated.get(partial.suffix.lower()))
