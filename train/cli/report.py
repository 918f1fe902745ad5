"""The ``impact report`` command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from train.cli.progress import say_written


@dataclass
class Command:
    """Write one self-contained HTML page from an evaluation."""

    extras: ClassVar[tuple[str, ...]] = ("report",)
    folder: Annotated[Positional[Path], arg(metavar="FOLDER")]
    """Folder that impact evaluate --out wrote."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the page's path."""
        from train.report.page import write_report

        report = write_report(self.folder)
        say_written(report)
        return {"report": str(report)}
