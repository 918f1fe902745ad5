"""Inputs that are nearly right: nested tables and text with some parts changed."""

import contextlib
import copy
import io
import math
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

from impact_envs.errors import InputError
from planners.errors import PlanningError
from train.cli.main import main

PATIENCE = 10.0  # longest time of one input, of this process alone [s]: machines are shared

NUMBERS = (
    0,
    1,
    -1,
    2,
    0.5,
    -0.0,
    1e-300,
    5e-324,
    1e-12,
    1e-9,
    1e-3,
    1e3,
    1e6,
    1e9,
    -1e9,
    1.1e9,
    1e200,
    1e308,
    -1.8e308,
)
NOT_NUMBERS = (math.nan, math.inf, -math.inf, 10**30, 10**400, True, False)
WORDS = (
    "",
    "x",
    "a\nb",
    "a\0b",
    "../up",
    "é",
    "all",
    "until",
    "F",
    "box",
    "nan",
    "-1",
    "x" * 5000,
    "\ud800",
    "a b",
    ".a",
)
LISTS = ([], [1], [[1]], [1, 2], [1, 2, 3], [0.0, math.nan], ["a"], [-1e308, 1e308], [[0, 0], [1, 0], [0, 1]], [None])
TABLES = (
    {},
    {"a": 1},
    {"uniform": [0, 1]},
    {"uniform": [-1e308, 1e308]},
    {"uniform": [2, 1]},
    {"uniform": 1},
    {"": {}},
)

strange = st.one_of(*(st.sampled_from(kind) for kind in (NUMBERS, NOT_NUMBERS, WORDS, LISTS, TABLES))).map(
    copy.deepcopy
)


def check(count):
    """Return the settings of a test of so many inputs, the same at every run."""
    unhealthy = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example]
    return settings(
        max_examples=count,
        derandomize=True,
        deadline=None,
        database=None,
        phases=(Phase.generate,),  # what fails is small already
        suppress_health_check=unhealthy,
    )


def list_places(table, place=()):
    """Return the places of all values in nested tables and lists."""
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    return [found for key, value in items for found in ((*place, key), *list_places(value, (*place, key)))]


@st.composite
def mutated(draw, table, values=strange, most=3):
    """Return a copy of nested tables with up to so many places changed, taken away, renamed or doubled."""
    table = copy.deepcopy(table)
    for _ in range(draw(st.integers(1, most))):
        places = list_places(table)
        if not places:
            return table
        *path, key = draw(st.sampled_from(places))
        parent = table
        for part in path:
            parent = parent[part]
        value = parent[key]
        change = draw(
            st.sampled_from(("scale", "scale", "scale", "scale", "replace", "replace", "remove", "rename", "double"))
        )
        if change == "scale" and isinstance(value, float):
            parent[key] = value * draw(st.sampled_from((-1, 0.5, 0.9, 1.1, 2, 10, 0.1, 1e-3, 1e3, 1e-6, 1e6)))
        elif change == "remove":
            del parent[key]
        elif change in ("rename", "double") and isinstance(parent, dict):
            parent[draw(st.sampled_from((*map(str, list(parent)), *WORDS)))] = copy.deepcopy(value)
            if change == "rename":
                parent.pop(key, None)
        elif change == "double" and isinstance(parent, list):
            parent.insert(key, copy.deepcopy(value))
        else:
            parent[key] = draw(values)
    return table


@st.composite
def mistyped(draw, text, pieces=()):
    """Return text with some letters or pieces put in, taken out or exchanged."""
    extra = st.one_of(
        st.sampled_from((*pieces, "\n", "\0", "nan", "1e400", "-", "[", "]", "(", ",", "=", '"')), st.characters()
    )
    for _ in range(draw(st.integers(1, 3))):
        first = draw(st.integers(0, len(text)))
        last = min(len(text), first + draw(st.sampled_from((0, 1, 1, 2, 5, 30))))
        text = text[:first] + draw(st.one_of(extra, st.just(""), st.just(text[first:last] * 2))) + text[last:]
    return text


@st.composite
def damaged(draw, data):
    """Return bytes with some of them changed, taken out, doubled or cut off."""
    for _ in range(draw(st.integers(1, 3))):
        # Faults near the ends matter as much as those in between: formats keep their tables there.
        reach = draw(st.sampled_from((8, 64, max(len(data), 1))))
        first = draw(st.integers(0, min(reach, len(data))))
        first = len(data) - first if draw(st.booleans()) else first
        length = draw(st.sampled_from((0, 1, 1, 8, 100)))
        piece = data[first : first + length]
        change = draw(st.sampled_from(("flip", "flip", "remove", "double", "insert", "cut")))
        if change == "flip":
            piece = bytes(byte ^ draw(st.sampled_from((1, 0x80, 0xFF))) for byte in piece)
        elif change == "insert":
            piece = draw(st.binary(max_size=8)) + piece
        else:
            piece = {"remove": b"", "double": piece * 2, "cut": b""}[change]
        data = data[:first] + piece + (b"" if change == "cut" else data[first + length :])
    return data


class Content(bytes):
    """The content of a file; a failing test shows the beginning only."""

    def __repr__(self):
        return f"{self[:300]!s} ({len(self)} bytes)"


def read_folder(folder):
    """Return the content of every file below a folder, by its path there."""
    files = sorted(path for path in Path(folder).rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): Content(path.read_bytes()) for path in files}


def write_folder(folder, contents):
    """Write files, and take away all others below a folder; a file that is right already is not written again."""
    held = read_folder(folder)
    for name in held.keys() - contents.keys():
        (folder / name).unlink()
    for name, content in contents.items():
        if held.get(name) != content:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)


def answer(*arguments):
    """Return the exit code of a command; fail unless it ends in time, with a result or a refusal in one line."""
    start, shown, said = time.process_time(), io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(said):
        code = main(arguments)
    lines = [line for line in said.getvalue().splitlines() if line.startswith("impact: ")]
    assert (code, len(lines)) in {(0, 0), (1, 1), (2, 1)}, (code, said.getvalue())
    assert bool(shown.getvalue()) == (code == 0)
    assert time.process_time() - start < PATIENCE
    return code


@contextmanager
def answered():
    """Fail unless the block ends in time, with a result or a refusal in one line."""
    start = time.process_time()
    try:
        yield
    except (InputError, PlanningError) as error:
        line = str(error)
    else:
        line = "a result"
    assert line and line.isprintable(), line  # so it is one line
    assert time.process_time() - start < PATIENCE


def check_finite(*values):
    """Fail unless all numbers are finite."""
    for value in values:
        assert np.all(np.isfinite(np.asarray(value, dtype=float))), value
