"""Learn from nothing: PPO of Stable-Baselines3, one policy that all robots share, without any expert.

    OMP_NUM_THREADS=1 python benchmarks/from_scratch.py --reward progress --minutes 15

A rollout is one whole episode of every world. After each one the policy is played without exploration in other worlds.
Printed: robot-steps, CPU time, success and robustness with exploration (training seeds) and without (other seeds).
Ctrl-C prints what is measured.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from expert_in_loop import describe_machine, print_table
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecNormalize

from agents.vec_env import ImpactVecEnv
from impact_envs.scenario import load_scenario
from train.watch import exit_codes

GAMMAS = {"robustness": 1.0, "progress": 0.999}  # see impact_envs/reward.py
TRAINING_SEED, OTHER_SEED = 0, 1_000_000  # of the first worlds, to train and to judge in; evaluation seeds are higher


@dataclass
class Args:
    """Learn a policy from scratch."""

    scenario: str = "throw_and_catch"
    """Shipped name or TOML file, of free-flyers."""
    suite: str = "nominal"
    """Mismatch suite of the true worlds."""
    reward: str = "progress"
    """Reward of the environment."""
    minutes: float = 15.0
    """CPU time of the training, without evaluation [min]."""
    worlds: int = 64
    """Worlds that are learned in."""
    others: int = 20
    """Worlds that the policy is played in after each rollout."""
    gamma: float | None = None
    """Discount; default: the one named for the reward."""
    gae_lambda: float = 0.98
    """Trace of the advantages: 50 steps, the time that a robot takes to reach an object."""
    batch: int = 8192
    """Robot-steps per gradient step."""
    epochs: int = 10
    """Times that a rollout is learned from."""
    learning_rate: float = 1e-3
    """Of Adam."""
    log_std: float = -0.5
    """Logarithm of the exploration's standard deviation at the start."""
    entropy: float = 0.0
    """Weight of the exploration's entropy."""
    held: int = 1
    """Steps that exploration's matrix is held (gSDE); 1: white noise."""
    seed: int = 0
    """Of network and exploration; worlds are seeded with it too."""
    out: Path | None = None
    """Write every measurement here as JSON."""


class Curve(BaseCallback):
    """Play the policy after each rollout, write down what became of it, and stop when the time is over."""

    def __init__(self, args: Args, worlds: ImpactVecEnv) -> None:
        super().__init__()
        self._args, self._worlds, self.rows = args, worlds, list[dict[str, float]]()
        self._ends: list[dict[str, Any]] = []
        self._since, self._spent = time.process_time(), 0.0

    def _on_step(self) -> bool:
        self._ends += [info for info in self.locals["infos"] if info]
        return self._spent < 60.0 * self._args.minutes

    def _on_rollout_end(self) -> None:
        self._spent += time.process_time() - self._since
        explored = self._ends or [{"success": 0.0, "robustness": np.nan}]
        success, robustness = play(self.model, self._worlds, self._args.seed)
        row = {
            "robot_steps": self.num_timesteps,
            "cpu_seconds": self._spent,
            "explored_success": float(np.mean([info["success"] for info in explored])),
            "explored_robustness": float(np.mean([info["robustness"] for info in explored])),
            "success": float(success.mean()),
            "robustness": float(robustness.mean()),
        }
        self.rows.append(row)
        print(" ".join(f"{name} {value:.3f}" for name, value in row.items()), flush=True)
        self._ends, self._since = [], time.process_time()


def play(model: Any, worlds: ImpactVecEnv, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return success and robustness of one episode of every world, without exploration, shape (worlds,) each."""
    worlds.seed(OTHER_SEED + seed)
    observations, found = worlds.reset(), dict[int, dict[str, Any]]()
    robots = worlds.num_envs // worlds.worlds.num_envs
    while len(found) < worlds.worlds.num_envs:
        actions, _ = model.predict(model.get_vec_normalize_env().normalize_obs(observations), deterministic=True)
        observations, _, _, infos = worlds.step(actions)
        found |= {place // robots: info for place, info in enumerate(infos) if info}
    ends = [found[world] for world in sorted(found)]
    return np.array([info["success"] for info in ends]), np.array([info["robustness"] for info in ends])


def learn(args: Args) -> list[dict[str, float]]:
    """Train, and return a row per rollout."""
    scenario = load_scenario(args.scenario).suite(args.suite)
    gamma = GAMMAS.get(args.reward, 1.0) if args.gamma is None else args.gamma  # an unknown reward is refused below
    made = [
        ImpactVecEnv(scenario, count, per_robot=True, reward=args.reward, threads=1, dtype="float64")
        for count in (args.worlds, args.others)
    ]
    made[0].seed(TRAINING_SEED + 10_000 * args.seed)
    worlds = VecNormalize(made[0], gamma=gamma)
    torch.set_num_threads(1)
    model = PPO(
        "MlpPolicy",
        worlds,
        n_steps=scenario.steps,
        batch_size=args.batch,
        n_epochs=args.epochs,
        learning_rate=args.learning_rate,
        gamma=gamma,
        gae_lambda=args.gae_lambda,
        ent_coef=args.entropy,
        use_sde=args.held > 1,
        sde_sample_freq=args.held if args.held > 1 else -1,
        policy_kwargs={"log_std_init": args.log_std},
        seed=args.seed,
        device="cpu",
    )
    model.set_logger(Logger(None, []))  # SB3's own makes a folder in the temporary directory
    curve = Curve(args, made[1])
    try:
        model.learn(10**9, callback=curve)
    except KeyboardInterrupt:
        print("interrupted")
    return curve.rows


def main(args: Args) -> int:
    """Learn, and print the curve."""
    print(describe_machine(), asdict(args), sep="\n", flush=True)
    rows = learn(args)
    if args.out is not None:
        args.out.write_text(
            json.dumps({"args": asdict(args) | {"out": None}, "rows": rows}, indent=1), encoding="utf-8"
        )
    step = max(len(rows) // 12, 1)
    print_table("Learning curve", [{name: f"{value:.4g}" for name, value in row.items()} for row in rows[::step]])
    return 0


if __name__ == "__main__":
    with exit_codes():
        sys.exit(main(tyro.cli(Args)))
