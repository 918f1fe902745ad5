"""What the checkpoints among policies say of themselves."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from train.evaluation.comparison import Origin
from train.evaluation.player import SHIPPED


def read_origins(policies: Iterable[str]) -> dict[str, Origin]:
    """Return what the checkpoints among some policies say of themselves; one that is not here any more says nothing."""
    folders = {name: [folder for folder in (Path(name), SHIPPED / name) if folder.is_dir()] for name in policies}
    if not any(folders.values()):
        return {}  # and no torch is needed
    from agents.actor import DESCRIPTION, PolicyRecord
    from agents.checkpoint import read_record
    from agents.shared_actor import is_shared, load_shared

    origins = {}
    for name, found in folders.items():
        for folder in found:
            if (folder / DESCRIPTION).is_file():
                record = read_record(folder / DESCRIPTION, PolicyRecord)
                origins[name] = Origin(record.algorithm, record.cpu_seconds)
                break
            if is_shared(folder):
                _, shared = load_shared(folder)
                origins[name] = Origin(shared.algorithm, shared.cpu_seconds)
                break
    return origins
