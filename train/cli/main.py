"""The ``impact`` command: what users type.

Every command takes a scenario name or the path of a TOML file. With ``--json`` the last line of standard output is
one JSON object and nothing else goes there. Exit codes: 0 done, 1 the thing itself failed, 2 bad input.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import re
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import tyro

from impact_envs.errors import InputError, choices
from planners.errors import PlanningError
from train.evaluation.errors import Diverged, WorkerLost

COMMANDS = ("list", "plan", "run", "play", "train", "tune", "evaluate", "compare", "report", "reproduce", "demo")
# Faults of the disk; some libraries do not say of which file.
DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


class Command(Protocol):
    """The arguments of a subcommand, in the file of its name."""

    json: bool

    def run(self) -> dict[str, Any]:
        """Return the result, as it is printed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; those of the process if None.

    Returns:
        Exit code: 0 done, 1 the thing itself failed, 2 bad input.
    """
    try:
        command = _parse(sys.argv[1:] if arguments is None else list(arguments))
        start = time.perf_counter()
        # Solvers and libraries may print; standard output is the result's alone.
        with contextlib.redirect_stdout(sys.stderr):
            result = command.run()
        result.setdefault("wall_seconds", time.perf_counter() - start)
    except InputError as error:
        print(f"impact: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        if error.filename is None and error.errno not in DISK:  # not about a file
            raise
        print(f"impact: {error.filename or 'a file'}: {error.strerror}", file=sys.stderr)
        return 2
    except (PlanningError, WorkerLost, Diverged) as error:
        print(f"impact: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("impact: interrupted; what was finished is kept", file=sys.stderr)
        return 130
    if command.json:
        print(json.dumps(result, default=_plain))
    else:
        from train.cli.printing import show

        show(result)
    return 0


def _parse(arguments: list[str]) -> Command:
    """Parse arguments; tyro's boxed message becomes one line."""
    name = arguments[0] if arguments else "--help"
    if not name.startswith("-") and name not in COMMANDS:
        raise InputError(f"command '{name}' is unknown; {choices(name, COMMANDS)}")
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            if name in COMMANDS:  # nothing of the other commands is imported
                return tyro.cli(_load(name), prog=f"impact {name}", args=arguments[1:])
            commands = {command: _load(command) for command in COMMANDS}
            return tyro.extras.subcommand_cli_from_dict(commands, prog="impact", description=__doc__, args=[name])
    except SystemExit as error:
        if not error.code:
            raise
    raise InputError(_one_line(said.getvalue())) from None


def _load(name: str) -> Any:
    return import_module(f"train.cli.{name}").Command


def _one_line(box: str) -> str:
    """Return the text of tyro's message box as one line."""
    lines = [re.sub(r"\x1b\[[0-9;]*m|[^\x20-\x7e]", " ", line).strip(" -+|") for line in box.splitlines()]
    title, *rest = [re.sub(r"\s+", " ", line) for line in lines if line and "--help" not in line] or ["bad arguments"]
    text = " ".join(rest)
    return text if text.lower().startswith(title.lower()) or title == "Value error" else f"{title}: {text}"


def _plain(value: Any) -> Any:
    """Turn numpy values and paths into what JSON knows."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"cannot write {type(value).__name__} as JSON")


if __name__ == "__main__":
    sys.exit(main())
