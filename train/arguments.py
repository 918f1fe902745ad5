"""Arguments of the training script, apart from it so that printing them imports no learner."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg


@dataclass(frozen=True)
class Args:
    """Arguments of a training run."""

    scenarios: Positional[tuple[str, ...]] = ("pong",)
    """Shipped names or TOML files; several train one policy for all."""
    suite: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="SUITE")] = ()
    """Mismatch suite of the true world; given several times, one policy for all. Without: hard."""
    steps: int = 80_000
    """Corrections to answer in the whole run; a free-flyer asks for one per impact, the others periodically."""
    out: Path = Path("runs/residual")
    """Folder for checkpoints and logs."""
    resume: bool = False
    """Go on from the last checkpoint in out."""
    seed: int = 0
    """Of network, exploration and episodes."""
    variant: str | None = None
    """Published form or baseline of the expert to correct; without: the expert."""
    set: tuple[str, ...] = ()
    """Values to change, for example true.restitution=0.5 expert.NAME=VALUE."""
    plan_anew: bool = False
    """Let free-flyers' experts plan anew in the background while they train: slower, and hardly another policy."""
    worlds: int = 512
    """Episodes of an iteration, over all scenarios and suites."""
    group: int = 8
    """Episodes of an iteration that share a seed, and are compared with each other."""
    threads: int | None = None
    """That share the worlds; all cores without."""
    hidden: tuple[int, ...] = (64, 64)
    """Width of each hidden layer."""
    learning_rate: float = 1e-3
    """Step size of Adam."""
    log_std: float = -2.3
    """Logarithm of the exploration's standard deviation at the start (-2.3: 0.1 of the range)."""
    batch: int = 256
    """Corrections per gradient step."""
    epochs: int = 10
    """Times that each iteration's corrections are learned from."""
    clip: float = 0.2
    """Greatest relative change of a correction's probability that is rewarded."""
    entropy: float = 0.0
    """Weight of the exploration's entropy."""
    target_kl: float | None = None
    """Change of the policy at which an update ends early; without: never."""
    worst: float = 2.0
    """A failure counts no more than so many times the expert's median robustness."""
    cut: float = 1.0
    """Two episodes of a seed differ by no more than so many times the expert's median robustness."""
    eval_every: int = 5
    """Iterations between two evaluations on tuning seeds; 0: never, and the last policy is kept."""
    eval_episodes: int = 200
    """Tuning seeds per evaluation, of each scenario and suite."""
    report_episodes: int = 200
    """Seeds for the report on the kept policy, neither learned from nor chosen on; 0: none."""
    log: bool = True
    """Write TensorBoard logs."""
    progress: bool = True
    """Show a bar, and each evaluation, on standard error."""
