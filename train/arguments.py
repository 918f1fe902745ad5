"""Arguments of the training script, apart from it so that printing them imports no learner."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class Args:
    """Arguments of a training run."""

    scenario: Positional[str] = "throw_and_catch"
    """Shipped name or path of a TOML file."""
    suite: str = "restitution"
    """Mismatch suite of the true world."""
    algo: str = "ppo"
    """Learning algorithm, see agents.sb3.ALGORITHMS."""
    steps: int = 8192
    """Corrections to answer in the whole run; a free-flyer asks for one per impact, the others periodically."""
    out: Path = Path("runs/residual")
    """Folder for checkpoints and logs."""
    resume: bool = False
    """Go on from the last checkpoint in out."""
    seed: int = 0
    """Of networks, exploration and episodes."""
    n_envs: int = 2
    """Environments that play at the same time."""
    subprocesses: bool = True
    """Give each environment a process of its own, if there are several."""
    learning_rate: float = 5e-4
    """Step size of Adam."""
    hidden: tuple[int, ...] = (64, 64)
    """Width of each hidden layer, for policy and value."""
    log_std: float = -1.2
    """Logarithm of the exploration's standard deviation at the start (-1.2: 0.3 of the range)."""
    rollout: int = 256
    """Corrections between two PPO updates, over all environments."""
    batch: int = 64
    """Corrections per gradient step."""
    checkpoint_every: int = 1024
    """Corrections between two checkpoints."""
    eval_every: int = 2048
    """Corrections between two evaluations on tuning seeds; 0: never."""
    eval_episodes: int = 40
    """Tuning seeds per evaluation."""
    log: bool = True
    """Write TensorBoard logs."""
    progress: bool = True
    """Show a bar on standard error."""
