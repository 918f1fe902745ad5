"""The ``impact`` command: what users type.

Every command takes a scenario name or the path of a TOML file. With ``--json`` the last line of standard output is
one JSON object and nothing else goes there. Exit codes: 0 done, 1 the thing itself failed, 2 bad input, 130 ended by
Ctrl-C.
``impact --version`` says which version this is.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import re
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Protocol

import tyro

import impact_envs
from impact_envs.errors import InputError, choices
from impact_envs.interface.extras import describe_missing
from planners.errors import PlanningError
from train.cli.progress import show_planning
from train.errors import Diverged, NothingFound, WorkerLost
from train.launch.ending import keep_interrupts

COMMANDS = (
    "list", "plan", "certify", "run", "play", "train", "tune", "dataset", "evaluate", "sweep", "compare", "break",
    "report", "reproduce", "demo",
)  # fmt: skip
# Faults of the disk; some libraries do not say of which file.
DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
# What tyro says of an option that takes a number and was given something else.
NUMBER = re.compile(
    r".*?Error parsing (--[\w-]+): .*?(\[[^\]]*\]|'[^']*')(?: Got errors.*)? Argument helptext: [^ ]+ \S*?(INT|FLOAT)"
)


class Command(Protocol):
    """The arguments of a subcommand, in the file of its name.

    Attributes:
        extras: of the distribution that it needs.
    """

    extras: ClassVar[tuple[str, ...]]
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
    start, needed = time.perf_counter(), tuple[str, ...]()
    try:
        command = _parse(sys.argv[1:] if arguments is None else list(arguments))
        needed = command.extras
        # Solvers and libraries may print; standard output is the result's alone.
        with contextlib.redirect_stdout(sys.stderr), show_planning(), keep_interrupts():
            result = command.run()
        result.setdefault("wall_seconds", time.perf_counter() - start)
    except InputError as error:
        # Where in the user's own code a policy failed; the line comes last.
        print(f"{getattr(error, 'trace', '')}impact: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        if error.filename is None and error.errno not in DISK:  # not about a file
            raise
        print(f"impact: {error.filename or 'a file'}: {error.strerror}", file=sys.stderr)
        return 2
    except (PlanningError, WorkerLost, Diverged, NothingFound) as error:
        print(f"impact: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        missing = describe_missing(error, needed)
        if missing is None:
            raise
        print(f"impact: {missing}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("impact: interrupted; what was finished is kept", file=sys.stderr)
        return 130
    try:
        if command.json:
            print(json.dumps(result, default=_plain), flush=True)
        else:
            from train.cli.printing import show

            show(result)
    except BrokenPipeError:
        _stop_printing()
    if result.get("interrupted"):
        return 130
    # A plan that was checked and refused; one that was forced is flown.
    refused = getattr(command, "check", None) is not None and result["accepted"] is False
    return int(refused or result.get("confirmed") is False)


def _stop_printing() -> None:
    """Let what is still printed go nowhere: who reads standard output has read enough."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parse(arguments: list[str]) -> Command:
    """Parse arguments; tyro's boxed message becomes one line."""
    name = arguments[0] if arguments else "--help"
    if name == "--version":
        print(f"impact-envs {impact_envs.__version__}")
        raise SystemExit
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
    except BrokenPipeError:  # of help
        _stop_printing()
        raise SystemExit from None
    raise InputError(_one_line(said.getvalue())) from None


def _load(name: str) -> Any:
    return import_module(f"train.cli.{name}").Command


def _one_line(box: str) -> str:
    """Return the text of tyro's message box as one line."""
    lines = [re.sub(r"\x1b\[[0-9;]*m|[^\x20-\x7e]", " ", line).strip(" -+|") for line in box.splitlines()]
    # The hint at --help may take two lines.
    kept = [line for line in lines if line and "--help" not in line and not line.startswith("For full helptext")]
    title, *rest = [re.sub(r"\s+", " ", line) for line in kept] or ["bad arguments"]
    # tyro lists choices without an order, and among them None where an option may be left out.
    number = NUMBER.match(f"{title} {' '.join(rest)}")
    if number:
        option, given, kind = number.groups()
        needed = "a whole number is needed" if kind == "INT" else "a number is needed"
        values = " ".join(re.findall("'([^']*)'", given))
        return f"{option} {values}: {needed}"
    text = re.sub(r"(?<=Expected one of )\(([^()]*)\)", _list_choices, " ".join(rest))
    return text if text.lower().startswith(title.lower()) or title == "Value error" else f"{title}: {text}"


def _list_choices(listed: re.Match[str]) -> str:
    """Return the choices of a message as text, without None."""
    names = sorted(set(listed[1].split(", ")) - {"'None'"})
    return f"({', '.join(names)})"


def _plain(value: Any) -> Any:
    """Turn numpy values and paths into what JSON knows."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"cannot write {type(value).__name__} as JSON")


if __name__ == "__main__":
    sys.exit(main())
