"""The ``impact compare`` command."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from tyro.conf import Positional

from impact_envs.errors import InputError, choices
from train.evaluation.case import EVALUATION_SEEDS, make_case
from train.evaluation.sequential import SequentialOptions
from train.settings import parse_settings

if TYPE_CHECKING:
    import pandas as pd


KEY = ["scenario", "suite", "policy", "seed"]  # of an episode


@dataclass
class Command:
    """Compare learned policies of several training seeds with the expert and the best constant.

    With --until decided, two policies play the same seeds until one is surely better, or no difference matters.
    """

    extras: ClassVar[tuple[str, ...]] = ("plan", "learn", "report")
    folders: Positional[tuple[Path, ...]]
    """Folders that impact evaluate --out wrote; policies named .../seed0, .../seed1, ... are runs of one. With --until
    two policies, as impact evaluate --batched takes them."""
    constant: str | None = None
    """The best constant among the policies; without, found by what the checkpoints say of themselves."""
    until: Literal["decided"] | None = None
    """Play the two policies until tests decide; the options that follow are for that."""
    scenario: str | None = None
    """Shipped name or TOML file."""
    suite: str = "nominal"
    """Mismatch suite."""
    set: tuple[str, ...] = ()
    """Values to change, as impact evaluate takes them."""
    episodes: int = 5000
    """Pairs of episodes at most."""
    seed: int = EVALUATION_SEEDS
    """First seed; the episodes take the following ones."""
    error: float = SequentialOptions.error
    """Probability of a wrong decision, whichever it is."""
    least_share: float = SequentialOptions.least_share
    """Share of the pairs with one success that the better policy wins, where success differs enough to matter."""
    least_difference: float = SequentialOptions.least_difference
    """Mean difference of robustness that matters [m, or the scenario's unit]."""
    limit: float = SequentialOptions.limit
    """Differences of robustness are cut here [m, or the scenario's unit]."""
    workers: int = 1
    """Threads."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return a row for each scenario, suite and group of policies, or what two policies' tests found."""
        if self.until is not None:
            return self._play_until_decided()
        self._refuse_options_of_until()
        from train.evaluation.comparison import compare_groups
        from train.evaluation.origins import read_origins

        rows = read_rows(self.folders)
        policies = sorted(rows["policy"].unique())
        if self.constant is not None and self.constant not in policies:
            known = choices(self.constant, policies)
            raise InputError(f"--constant {self.constant}: policy '{self.constant}' was not evaluated; {known}")
        return {"groups": compare_groups(rows, read_origins(policies), self.constant)}

    def _refuse_options_of_until(self) -> None:
        """Raise if something is asked of episodes, where none is played.

        Raises:
            InputError: naming the option.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name not in ("folders", "constant", "until", "json") and value != field.default:
                text = " ".join(value) if isinstance(value, tuple) else value
                raise InputError(
                    f"--{field.name.replace('_', '-')} {text} needs --until decided, which plays episodes; "
                    "folders hold theirs"
                )

    def _play_until_decided(self) -> dict[str, Any]:
        from train.evaluation.duel import play_until_decided

        if self.scenario is None:
            raise InputError("--until decided needs --scenario NAME, where the policies play")
        if self.constant is not None:
            raise InputError(f"--constant {self.constant}: is for folders; --until decided takes two policies")
        if len(self.folders) != 2:
            named = ", ".join(map(str, self.folders)) or "none"
            raise InputError(f"--until decided takes two policies, got {named}")
        first, second = map(str, self.folders)
        case = make_case(self.scenario, self.suite, parse_settings(self.set))
        options = SequentialOptions(self.error, self.least_share, self.least_difference, self.limit)
        duel = play_until_decided(case, (first, second), self.episodes, self.seed, options, self.workers)
        return {"scenario": case.scenario.name, "suite": self.suite, **duel.to_dict()}


def read_rows(folders: Iterable[Path]) -> pd.DataFrame:
    """Read the episodes of some evaluations.

    Args:
        folders: of them.

    Returns:
        One row per episode, see `compare_groups`.

    Raises:
        InputError: a folder is none of an evaluation, two hold the same episode, or there is none.
    """
    import pandas as pd

    from train.evaluation.results import read_evaluation

    tables = [read_evaluation(folder).episodes for folder in folders]
    if not tables:
        raise InputError("no folder to compare; name at least one that `impact evaluate ... --out DIR` wrote")
    rows = pd.concat(tables, ignore_index=True)
    twice = rows[rows.duplicated(KEY)]
    if len(twice):
        scenario, suite, policy, seed = twice.iloc[0][KEY]
        raise InputError(f"{policy} in {scenario} under {suite} with seed {seed} is in two of the folders")
    return rows
