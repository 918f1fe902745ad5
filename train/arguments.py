"""Arguments of the training scripts, apart from them so that printing them imports no learner."""

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
    steps: int | None = None
    """Corrections to answer in the whole run; a free-flyer asks for one per impact, the others periodically. Without:
    120,000 of free-flyers, 60,000 of the others."""
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
    worlds: int | None = None
    """Episodes of an iteration, over all scenarios and suites; without: 512 of free-flyers, 128 of the others."""
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
    failure: float = 0.5
    """Least cost of a failure beside its robustness, times the expert's median robustness; it rises while success is
    lost on the tuning seeds."""
    highest_failure: float = 8.0
    """Greatest such cost: beyond, robustness counts for nothing."""
    failure_rise: float = 2.0
    """Times that the cost rises after an evaluation that lost success."""
    failure_fall: float = 0.8
    """Times that the cost falls after an evaluation that did not."""
    loss: float = 0.005
    """Success, of all tuning episodes, that a policy may lose and yet be kept."""
    shares: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)
    """Of its corrections with which a policy is tried, one after the other, until it loses no success."""
    eval_every: int | None = None
    """Iterations between two evaluations on tuning seeds; without: as many as play 2,560 episodes; 0: never, and the
    last policy is kept."""
    eval_episodes: int = 400
    """Tuning seeds per evaluation, of each scenario and suite."""
    report_episodes: int = 200
    """Seeds for the report on the kept policy, neither learned from nor chosen on; 0: none."""
    log: bool = True
    """Write TensorBoard logs."""
    progress: bool = True
    """Show a bar, and each evaluation, on standard error."""


@dataclass(frozen=True)
class TuneArgs:
    """Arguments of a search for the best constant."""

    scenarios: Positional[tuple[str, ...]] = ("pong",)
    """Shipped names or TOML files; several share one constant."""
    suite: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="SUITE")] = ()
    """Mismatch suite of the true world; given several times, one constant for all. Without: hard."""
    per_impact: bool = False
    """A constant for each number of the impact in the plan, instead of one for all."""
    out: Path = Path("runs/constant")
    """Folder of the checkpoint; must not hold one."""
    seed: int = 0
    """Of the candidates."""
    variant: str | None = None
    """Published form or baseline of the expert to correct; without: the expert."""
    set: tuple[str, ...] = ()
    """Values to change, for example true.restitution=0.5 expert.NAME=VALUE."""
    plan_anew: bool = False
    """Let free-flyers' experts plan anew in the background: slower, and hardly another constant."""
    population: int = 24
    """Candidates of a generation."""
    elites: int = 6
    """The best of them, to whose mean and spread the search moves."""
    episodes: int = 40
    """Tuning seeds of a generation, of each scenario and suite; every candidate plays them all."""
    generations: int = 10
    """Of the search; every one plays other seeds."""
    spread: float = 0.3
    """Standard deviation of the first candidates, of the range of a correction."""
    least_spread: float = 0.02
    """The standard deviation does not fall below this: a lucky generation must not end the search."""
    step: float = 0.7
    """Share of the way to the elites that mean and spread move: the score of so few episodes is noisy."""
    finalists: int = 4
    """Means of the last generations among which, and zero, the last choice is made."""
    final_episodes: int = 400
    """Seeds of that choice, of each scenario and suite; the search has not seen them."""
    report_episodes: int = 200
    """Seeds for the report on what was chosen; 0: none."""
    worst: float = 2.0
    """A failure counts no more than so many times the expert's median robustness."""
    failure: float = 0.5
    """Cost of a failure beside its robustness, times the expert's median robustness."""
    loss: float = 0.005
    """Success, of all seeds of the choice, that a constant may lose and yet be kept."""
    shares: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)
    """Of a finalist that are tried, one after the other, until it loses no success."""
    worlds: int = 512
    """Episodes that are played at a time, over all scenarios and suites."""
    threads: int | None = None
    """That share the worlds; all cores without."""
    progress: bool = True
    """Show a bar, and each generation, on standard error."""
