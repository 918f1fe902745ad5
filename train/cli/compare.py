"""The ``impact compare`` command."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from tyro.conf import Positional

from impact_envs.errors import InputError, choices

if TYPE_CHECKING:
    import pandas as pd

    from train.evaluation.comparison import Origin

COLUMNS = ["scenario", "suite", "policy", "seed", "robustness", "success"]


@dataclass
class Command:
    """Compare learned policies of several training seeds with the expert and the best constant."""

    extras: ClassVar[tuple[str, ...]] = ("plan", "learn", "report")
    folders: Positional[tuple[Path, ...]]
    """Folders that impact evaluate --out wrote; policies named .../seed0, .../seed1, ... are runs of one."""
    constant: str | None = None
    """The best constant among the policies; without, found by what the checkpoints say of themselves."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return a row for each scenario, suite and group of policies."""
        from train.evaluation.comparison import compare_groups

        rows = read_rows(self.folders)
        policies = sorted(rows["policy"].unique())
        if self.constant is not None and self.constant not in policies:
            known = choices(self.constant, policies)
            raise InputError(f"--constant {self.constant}: policy '{self.constant}' was not evaluated; {known}")
        return {"groups": compare_groups(rows, read_origins(policies), self.constant)}


def read_rows(folders: Iterable[Path]) -> pd.DataFrame:
    """Read the episodes of some evaluations.

    Args:
        folders: of them.

    Returns:
        One row per episode, columns COLUMNS.

    Raises:
        InputError: a folder is none of an evaluation, two hold the same episode, or there is none.
    """
    import pandas as pd

    from train.evaluation.results import read_evaluation

    tables = []
    for folder in folders:
        read_evaluation(folder)  # says what is wrong with it
        tables.append(pd.read_parquet(folder / "rows.parquet", columns=COLUMNS))
    if not tables:
        raise InputError("no folder to compare; name at least one that `impact evaluate ... --out DIR` wrote")
    rows = pd.concat(tables, ignore_index=True)
    twice = rows[rows.duplicated(COLUMNS[:4])]
    if len(twice):
        scenario, suite, policy, seed = twice.iloc[0][COLUMNS[:4]]
        raise InputError(f"{policy} in {scenario} under {suite} with seed {seed} is in two of the folders")
    return rows


def read_origins(policies: Iterable[str]) -> dict[str, Origin]:
    """Return what the checkpoints among some policies say of themselves; one that is not here any more says nothing."""
    from agents.actor import DESCRIPTION, PolicyRecord
    from agents.checkpoint import read_record
    from train.evaluation.comparison import Origin
    from train.evaluation.player import SHIPPED

    origins = {}
    for name in policies:
        for folder in (Path(name), SHIPPED / name):
            if (folder / DESCRIPTION).is_file():
                record = read_record(folder / DESCRIPTION, PolicyRecord)
                origins[name] = Origin(record.algorithm, record.cpu_seconds)
                break
    return origins
