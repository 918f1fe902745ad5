"""The ``impact tune`` command."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from tyro.conf import OmitArgPrefixes

from train.arguments import TuneArgs


@dataclass
class Command:
    """Find the best constant correction to the expert, which a learned policy must beat."""

    extras: ClassVar[tuple[str, ...]] = ("plan", "learn")
    args: OmitArgPrefixes[TuneArgs] = field(default_factory=TuneArgs)
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the constants, folder, time and gains."""
        from train.tune import main

        return main(self.args)
