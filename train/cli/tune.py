"""The ``impact tune`` command."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from tyro.conf import OmitArgPrefixes

from train.arguments import TuneArgs
from train.cli.seeds import launch_seeds
from train.launch.choice import Launch


@dataclass
class Command:
    """Find the best constant correction to the expert, which a learned policy must beat."""

    extras: ClassVar[tuple[str, ...]] = ("plan", "learn")
    args: OmitArgPrefixes[TuneArgs] = field(default_factory=TuneArgs)
    seeds: tuple[int, ...] = ()
    """A search of each of these seeds in OUT/seedN, instead of one of --seed in OUT; a second call goes on with all."""
    launch: OmitArgPrefixes[Launch] = field(default_factory=Launch)
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the constants, folder, time and gains; a row of each run where there are several."""
        if self.seeds or self.launch != Launch():
            return launch_seeds("tune", self.args, self.seeds, self.launch)
        from train.tune import main

        return main(self.args)
