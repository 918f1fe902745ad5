"""The ``impact train`` command."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from tyro.conf import OmitArgPrefixes

from train.arguments import Args
from train.cli.progress import say_written


@dataclass
class Command:
    """Train a residual on top of the expert."""

    extras: ClassVar[tuple[str, ...]] = ("plan", "learn")
    args: OmitArgPrefixes[Args] = field(default_factory=Args)
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return steps, folder, time and the tuning evaluation."""
        from train.residual import main

        result = main(self.args)
        say_written(result["out"])
        return result
