"""The ``impact`` command as it is installed; it works whatever modules lie in the user's folder.

The distribution's packages beside this one have names that others use as well: a user's own ``train.py`` or ``agents/``
may come before them on the path (``PYTHONPATH=.``).
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import PathFinder
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("agents", "planners", "train")


def prefer_own_packages() -> None:
    """Put this distribution first on the path, here and for the processes started from here, if its names are taken."""
    for name in PACKAGES:
        spec = PathFinder.find_spec(name)
        if spec is not None and (spec.origin is None or Path(spec.origin).resolve().parent != ROOT / name):
            sys.path.insert(0, str(ROOT))
            return


def main() -> int:
    """Run the command line of this process."""
    prefer_own_packages()
    return int(import_module("train.cli.main").main())
