"""Plan files in the published format: one CSV file per body, and one per object with boxes.

``plan_<name>_<body>.csv`` holds the blocks rvars (rows x, y, theta of every curve), hvars (one row), ids and
other_names; ``zonotopes_<name>_<body>.csv`` holds X0s and Xfs (rows centre and half widths of x, y, vx, vy at the
start and end of every curve), and labels again. Those are not read: published ones have lost a "pre" that stands in
the plan file. An empty line follows every curve.

Source: plan files of the repository joris997/impact_stl.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from impact_envs.errors import InputError
from impact_envs.file import write_atomically
from planners.free_flyer.published.conversion import make_published_plan
from planners.free_flyer.published.curve import PublishedBody, PublishedPlan
from planners.plan import Plan, Tube

PLAN_BLOCKS = ("rvars", "hvars", "ids", "other_names")
BOX_BLOCKS = ("X0s", "Xfs")
BLOCKS = (*PLAN_BLOCKS, *BOX_BLOCKS)

Lines = list[tuple[int, str]]  # number and text


def read_published_plan(folder: str | Path, name: str | None = None) -> PublishedPlan:
    """Read a plan from a folder of published files.

    Args:
        folder: that holds the files.
        name: of the plan, as the files call it; None: worked out from the files, which are then of one plan.

    Returns:
        The plan, its bodies in the order of their names.

    Raises:
        InputError: no such files, or one does not hold what it should.
    """
    start = "plan_" if name is None else f"plan_{name}_"
    paths = sorted(path for path in Path(folder).glob("plan_*.csv") if path.name.startswith(start))
    if not paths:
        raise InputError(f"{folder}: no file {start}<body>.csv; give a folder of published plan files")
    found = {path.stem: _read_body(path) for path in paths}
    prefix = start if name is not None else _find_prefix(folder, found)
    bodies = {stem.removeprefix(prefix): body for stem, body in found.items()}
    boxes = {body: Path(folder) / f"zonotopes_{prefix.removeprefix('plan_')}{body}.csv" for body in bodies}
    zonotopes = {body: _read_boxes(path, bodies[body]) for body, path in boxes.items() if path.exists()}
    try:
        return PublishedPlan(bodies, zonotopes)
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None


def write_published_plan(plan: Plan | PublishedPlan, folder: str | Path, name: str) -> list[Path]:
    """Write a plan as published files; every number keeps all its digits.

    Args:
        plan: to write; see `make_published_plan` for what the format cannot hold.
        folder: to write into, made where it does not exist.
        name: of the plan, for the names of the files.

    Returns:
        The files written.

    Raises:
        InputError: a name does not fit into a file name, or a file cannot be written.
    """
    published = plan if isinstance(plan, PublishedPlan) else make_published_plan(plan)
    for part in (name, *published.bodies):
        if not re.fullmatch(r"[\w-]+", part):
            raise InputError(f"plan '{name}': '{part}' is no part of a file name; use letters, digits, _ and -")
    files = {}
    for body, curves in published.bodies.items():
        labels = _format("ids", curves.ids) + _format("other_names", curves.other_names)
        rows = [_format_rows(points.T) for points in curves.r]
        clocks = [_format_rows([clock]) for clock in curves.h]
        files[f"plan_{name}_{body}.csv"] = _format("rvars", rows) + _format("hvars", clocks) + labels
        if body in published.zonotopes:
            tube = published.zonotopes[body]
            starts, ends = ([_format_rows(box) for box in side] for side in (tube.start, tube.end))
            files[f"zonotopes_{name}_{body}.csv"] = _format("X0s", starts) + _format("Xfs", ends) + labels
    for file, text in files.items():
        write_atomically(Path(folder) / file, text.encode())
    return [Path(folder) / file for file in files]


def _format(block: str, entries: Iterable[str]) -> str:
    return f"{block}\r\n" + "".join(f"{entry}\r\n\r\n" for entry in entries)


def _format_rows(rows: Iterable[Iterable[float]]) -> str:
    return "\r\n".join(",".join(repr(float(value)) for value in row) for row in rows)


def _find_prefix(folder: str | Path, found: dict[str, PublishedBody]) -> str:
    """Return the start that all file names share and behind which the names of the bodies stand.

    Names of bodies may hold underscores; those the files name as hit bodies decide where they begin.
    """
    mentioned = {other for body in found.values() for other in body.other_names} - {"none"}
    first = next(iter(found))
    prefixes = [first[: at + 1] for at in range(len(first) - 1, 3, -1) if first[at] == "_"]
    for prefix in prefixes:
        if all(stem.startswith(prefix) for stem in found) and mentioned <= {stem[len(prefix) :] for stem in found}:
            return prefix
    files = ", ".join(f"{stem}.csv" for stem in found)
    missing = sorted(other for other in mentioned if not any(stem.endswith(f"_{other}") for stem in found))
    if missing:
        raise InputError(f"{folder}: no file of '{missing[0]}', which other_names mention; files: {files}")
    raise InputError(f"{folder}: files of several plans; say which plan by its name; files: {files}")


def _read_body(path: Path) -> PublishedBody:
    blocks = _read_blocks(path, PLAN_BLOCKS)
    h = _read_rows(path, blocks["hvars"])
    r = _read_rows(path, blocks["rvars"])
    if len(r) != 3 * len(h):
        raise InputError(f"{path}: rvars has {len(r)} rows for {len(h)} curves in hvars, expected {3 * len(h)}")
    ids, others = (tuple(text for _, text in blocks[name]) for name in ("ids", "other_names"))
    try:
        return PublishedBody(r.reshape(len(h), 3, -1).swapaxes(1, 2), h, ids, others)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read_boxes(path: Path, body: PublishedBody) -> Tube:
    blocks = _read_blocks(path, BOX_BLOCKS)
    sides = [_read_rows(path, blocks[name]) for name in BOX_BLOCKS]
    for name, rows in zip(BOX_BLOCKS, sides, strict=True):
        if rows.shape != (2 * len(body.h), 4):
            raise InputError(f"{path}: {name} has shape {rows.shape}, expected ({2 * len(body.h)}, 4)")
    try:
        return Tube(body.times, *(rows.reshape(-1, 2, 4) for rows in sides))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read_blocks(path: Path, required: Sequence[str]) -> dict[str, Lines]:
    """Return the lines of every block, without the empty ones."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise InputError(f"{path}: cannot be read: {reason}") from None
    blocks: dict[str, Lines] = {}
    lines: Lines | None = None
    for number, line in enumerate((line.strip() for line in text.splitlines()), start=1):
        if line in BLOCKS:
            if line in blocks:
                raise InputError(f"{path}: line {number}: block {line} comes a second time")
            lines = blocks[line] = []
        elif line and lines is None:
            raise InputError(f"{path}: line {number}: {line!r:.40} is in no block; choices: {', '.join(required)}")
        elif line and lines is not None:
            lines.append((number, line))
    for name in required:
        if not blocks.get(name):
            raise InputError(f"{path}: block {name} is missing or empty; a file holds {', '.join(required)}")
    return blocks


def _read_rows(path: Path, lines: Lines) -> np.ndarray:
    """Return rows of equally many finite numbers, shape (rows, columns)."""
    rows: list[list[float]] = []
    for number, line in lines:
        rows.append([_read_number(path, number, token.strip()) for token in line.split(",")])
        if len(rows[-1]) != len(rows[0]):
            raise InputError(f"{path}: line {number}: {len(rows[-1])} numbers, expected {len(rows[0])} as before")
    return np.array(rows)


def _read_number(path: Path, number: int, token: str) -> float:
    try:
        value = float(token) if "_" not in token else math.nan  # float() takes 1_000 for a number
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{path}: line {number}: {token!r:.40} is not a finite number")
    return value
