"""Train a bounded correction to an expert, from first decision to resumable checkpoints.

``python -m train.residual --help`` lists every argument. What a run leaves in ``out``:

    policy.safetensors, policy.json   the policy that was best on the tuning seeds, so ``out`` is a checkpoint
    checkpoints/<steps>/              the last two policies, with all that is needed to resume
    args.json                         arguments, seed and versions
    tensorboard/                      learning curves
"""

from __future__ import annotations

import shutil
import signal
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, SupportsFloat, cast

import gymnasium
import numpy as np
import pandas as pd
import torch
import tyro
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import configure
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecNormalize

from agents import sb3
from agents.actor import PolicyRecord, save_policy
from agents.residual import TRAINING_SEEDS, ResidualEnv, ResidualPolicy
from agents.sb3 import export_actor
from agents.training_state import load_training, read_training, save_training
from impact_envs.env import parallel_env
from impact_envs.errors import InputError
from impact_envs.reward import compute_potential
from impact_envs.rollout import Policy, rollout
from impact_envs.scenario import Scenario, load_scenario
from planners import has_planner, make_expert, make_plan
from planners.plan import Plan
from train.arguments import Args
from train.evaluation.errors import WorkerLost
from train.evaluation.folder_lock import lock_folder
from train.evaluation.journal import read_versions, write_json
from train.evaluation.statistics import compare_pairs, compute_wilson_interval
from train.evaluation.workers import end_with_parent
from train.watch import EpisodeLog, learn, show_progress, stop_on_signals

# Tuning seeds start here; evaluation seeds start at 2,000,000.
TUNING_SEEDS = 1_000_000
# Arguments that decide what a checkpoint means; a resumed run must have the same.
FIXED = ("scenario", "suite", "algo", "seed", "n_envs", "hidden")


def main(args: Args) -> dict[str, Any]:
    """Train, or go on training, until ``steps`` corrections are answered or Ctrl-C asks to stop.

    Args:
        args: arguments of the run.

    Returns:
        ``steps`` answered, ``out``, ``wall_seconds``, ``eval`` (of the best policy on the tuning seeds,
        paired with the expert; empty if there was none) and ``interrupted``.

    Raises:
        InputError: bad arguments, or a run in ``out`` that cannot be gone on with.
        PlanningError: the expert found no plan.
        WorkerLost: the process of an environment ended.
        Diverged: the weights are no longer finite; the last checkpoint stays.
    """
    check_args(args)
    load_scenario(args.scenario).suite(args.suite)  # refused before anything is written
    with lock_folder(args.out):
        check_run(args)
        try:
            return _train(args)
        except (EOFError, ConnectionError) as error:
            raise WorkerLost(
                f"out {args.out}: the process of an environment ended ({type(error).__name__}): killed, or out of "
                "memory? resume from the last checkpoint"
            ) from None


def _train(args: Args) -> dict[str, Any]:
    start = time.perf_counter()
    torch.set_num_threads(1)
    scenario = load_scenario(args.scenario)
    plan = make_plan(scenario.suite(args.suite)) if has_planner(scenario) else None
    envs = make_envs(args, scenario, plan)
    try:
        model = make_model(args, envs)
        run = Run(args, scenario, plan, model, envs)
        with stop_on_signals() as stopping, show_progress(args.steps, args.progress) as advance:
            callback = EpisodeLog(stopping, advance)
            while model.num_timesteps < args.steps and not stopping.is_set():
                ahead = args.checkpoint_every - model.num_timesteps % args.checkpoint_every
                ahead = min(ahead, args.steps - model.num_timesteps)
                learn(model, ahead, callback)
                if not stopping.is_set():
                    run.evaluate_if_due()
                run.save()
    finally:
        _close(envs)
    return {
        "steps": model.num_timesteps,
        "out": str(args.out),
        "wall_seconds": time.perf_counter() - start,
        "eval": max(run.evaluations, key=_score, default={}),
        "interrupted": stopping.is_set(),
    }


def _close(envs: VecNormalize) -> None:
    """Close environments; where one process has died, the others end at once."""
    try:
        envs.close()
    except (EOFError, ConnectionError):
        for process in cast(SubprocVecEnv, envs.venv).processes:
            process.kill()


def check_args(args: Args) -> None:
    """Raise unless the arguments make sense.

    Args:
        args: arguments of a run.

    Raises:
        InputError: one line naming the argument, its value and the limit.
    """
    least = {"steps": 1, "seed": 0, "n_envs": 1, "rollout": 2, "batch": 2, "checkpoint_every": 1}
    for name, low in (least | {"eval_every": 0, "eval_episodes": 1}).items():
        if getattr(args, name) < low:
            raise InputError(f"{name} {getattr(args, name)} is too small; choices: {low}, {low + 1}, ...")
    sb3.check_algorithm(args.algo)
    # The limits of the deviation are SAC's own.
    for name, lowest, highest in (("learning_rate", 0.0, 1.0), ("log_std", -20.0, 2.0)):
        if not lowest <= (value := getattr(args, name)) <= highest:
            raise InputError(f"{name} {value:g}: choices: from {lowest:g} to {highest:g}")
    if args.rollout % args.n_envs:
        raise InputError(f"rollout {args.rollout} is not a multiple of n_envs {args.n_envs}")
    if not args.hidden or min(args.hidden) < 1:
        raise InputError(f"hidden {list(args.hidden)}: every layer needs a width of at least 1")
    check_run(args)


def check_run(args: Args) -> None:
    """Raise unless what is in ``out`` is gone on with if there is something, and can be.

    Args:
        args: arguments of a run.

    Raises:
        InputError: one line naming the folder, and the argument that differs.
    """
    held = last_checkpoint(args.out)
    if args.resume and held is None:
        raise InputError(f"out {args.out}: holds no checkpoint to resume from")
    if held is not None and not args.resume:
        raise InputError(f"out {args.out}: holds a run of {int(held.name)} steps; resume it or choose another")
    if held is not None:
        before, now = read_training(held).run, _settings(args)
        for key in FIXED:
            if before.get(key) != now[key]:
                raise InputError(f"{held}: was made with {key} {before.get(key)}; cannot be resumed with {now[key]}")


def check_evaluations(checkpoint: Path, evaluations: list[dict[str, Any]]) -> None:
    """Raise unless evaluations of a resumed run can be compared with new ones.

    Args:
        checkpoint: where they were read.
        evaluations: as read.

    Raises:
        InputError: one lacks a number, or has none there.
    """
    for place, evaluation in enumerate(evaluations):
        for name in ("steps", "success_rate", "difference_median"):
            if type(evaluation.get(name)) not in (int, float):
                where = f"{checkpoint}: key 'evaluations.{place}'"
                raise InputError(f"{where}: {name} = {evaluation.get(name)!r:.60}: a number is needed")


def last_checkpoint(out: Path) -> Path | None:
    """Return the newest checkpoint of a run, None if there is none.

    Args:
        out: folder of the run.
    """
    folders = [path for path in (out / "checkpoints").glob("*") if path.name.isdecimal()]
    return max(folders, key=lambda path: int(path.name), default=None)


def make_envs(args: Args, scenario: Scenario, plan: Plan | None) -> VecNormalize:
    """Make the training environments, with running normalisation of the features.

    Args:
        args: arguments of the run.
        scenario: what to train on.
        plan: for the experts to follow.
    """
    apart = args.subprocesses and args.n_envs > 1
    makers = [partial(_make_env, scenario, args.suite, plan, apart)] * args.n_envs
    envs: VecEnv = SubprocVecEnv(makers, start_method="spawn") if apart else DummyVecEnv(makers)  # type: ignore[arg-type]
    # A feature that hardly varies keeps a spread of 1e-3, so that it is not blown up to noise.
    return VecNormalize(envs, norm_reward=False, gamma=1.0, epsilon=1e-6)


class DecidedEnds(gymnasium.Wrapper[np.ndarray, np.ndarray, np.ndarray, np.ndarray]):
    """Tell the learner that nothing follows a decided formula, and leave out what every episode's return has in it.

    SB3 adds the value of the last features to a truncated return. At the horizon the return is whole: with it,
    gamma = 1 and an estimate that feeds on itself, the value would grow without bound. A cut before it stays one.

    Rewards sum up to twice the robustness minus what was known of it at the start, which can be many times larger,
    minus the effort. The known part, added at the end, is nothing that the value's network would have to learn.
    """

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode."""
        features, info = self.env.reset(seed=seed, options=options)
        self._known = compute_potential(*cast(ResidualEnv, self.unwrapped).parallel.bounds)
        return features, info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step; an end at the horizon is reported as terminated."""
        features, reward, terminated, truncated, info = self.env.step(action)
        decided = bool(info.get("decided", False))
        reward = float(reward) + (self._known if decided else 0.0)
        return features, reward, terminated or decided, truncated and not decided, info


def _make_env(scenario: Scenario, suite: str, plan: Plan | None, apart: bool) -> DecidedEnds:
    if apart:
        # Stopping is the parent's to handle; without it, so does this process.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        end_with_parent()
    return DecidedEnds(ResidualEnv(scenario, suite, plan))


def make_model(args: Args, envs: VecNormalize) -> BaseAlgorithm:
    """Make a model that starts exactly at the expert.

    Args:
        args: arguments of the run.
        envs: training environments.
    """
    steps = min(args.rollout, args.steps)  # a run shorter than a rollout still learns once
    options = sb3.LearningOptions(args.hidden, args.learning_rate, steps, args.batch, args.log_std, args.seed)
    model = sb3.make_model(args.algo, envs, options)
    model.set_logger(
        configure(str(args.out / "tensorboard") if args.log else None, ["tensorboard"] if args.log else [])
    )
    return model


class Run:
    """What a run has learned so far, on tuning seeds and on disk.

    Args:
        args: arguments of the run.
        scenario: what is trained on.
        plan: for the expert to follow, if it follows one.
        model: to train; with ``args.resume`` the last checkpoint is put into it.
        envs: training environments; they are seeded anew, from seed and steps.

    Raises:
        InputError: the checkpoint does not fit the arguments.
    """

    def __init__(
        self, args: Args, scenario: Scenario, plan: Plan | None, model: BaseAlgorithm, envs: VecNormalize
    ) -> None:
        self._args, self._scenario, self._model, self._envs = args, scenario, model, envs
        self._settings = _settings(args)
        self._expert = make_expert(scenario.suite(args.suite), plan)
        self._reference: pd.DataFrame | None = None
        self.evaluations: list[dict[str, Any]] = []
        if args.resume:
            checkpoint = last_checkpoint(args.out)
            assert checkpoint is not None
            self.evaluations = load_training(checkpoint, model, envs).evaluations
            check_evaluations(checkpoint, self.evaluations)
        state = np.random.SeedSequence([args.seed, model.num_timesteps]).generate_state(2)
        set_random_seed(int(state[0]))
        envs.seed(int(state[1]) % (TRAINING_SEEDS - args.n_envs))
        write_json(args.out / "args.json", {"args": self._settings, "versions": read_versions()})
        self.evaluate_if_due()

    def evaluate_if_due(self) -> None:
        """Play the tuning seeds and keep the policy if it is the best so far."""
        steps, every = self._model.num_timesteps, self._args.eval_every
        done = self.evaluations[-1]["steps"] if self.evaluations else -1
        if every == 0 or done == steps:
            return
        if done < 0 or steps >= self._args.steps or steps // every > done // every:
            policy = ResidualPolicy(self._expert, export_actor(self._model, self._envs).correction)
            self.evaluations.append({"steps": steps, **self._compare(policy)})
            if max(self.evaluations, key=_score) is self.evaluations[-1]:
                self._save_policy(self._args.out)

    def save(self) -> None:
        """Write a checkpoint, all or nothing, and drop all but the last two."""
        folder = self._args.out / "checkpoints" / f"{self._model.num_timesteps:08d}"
        if not folder.exists():
            partial = folder.with_name(f".{folder.name}")
            shutil.rmtree(partial, ignore_errors=True)
            try:
                self._save_policy(partial)
                save_training(partial, self._model, self._envs, self._settings, self.evaluations)
                partial.rename(folder)
            finally:
                shutil.rmtree(partial, ignore_errors=True)
        if self._args.eval_every == 0:
            self._save_policy(self._args.out)
        for old in sorted(folder.parent.glob("[0-9]*"))[:-2]:
            shutil.rmtree(old)

    def _save_policy(self, folder: Path) -> None:
        actor, args = export_actor(self._model, self._envs), self._args
        record = PolicyRecord(
            scenario=self._scenario.name,
            domain=self._scenario.domain,
            suite=args.suite,
            algorithm=args.algo,
            feature_size=self._expert.feature_size,
            correction_size=self._expert.correction_size,
            hidden=args.hidden,
            squash=actor.squash,
            feature_clip=actor.feature_clip,
            seed=args.seed,
            steps=self._model.num_timesteps,
            training=self._settings,
            versions=read_versions(),
        )
        save_policy(folder, actor, record)

    def _compare(self, policy: ResidualPolicy) -> dict[str, Any]:
        """Play the tuning seeds and pair them with the expert's, which are played once."""
        if self._reference is None:
            self._reference = self._play(self._expert)
        played = self._play(policy)
        paired = played.merge(self._reference, on="seed", suffixes=("_a", "_b"))
        successes = int(played["success"].sum())
        return {
            "success_rate": successes / len(played),
            "success_ci": list(compute_wilson_interval(successes, len(played))),
            "robustness_median": float(played["robustness"].median()),
            "expert_success_rate": float(self._reference["success"].mean()),
            "expert_robustness_median": float(self._reference["robustness"].median()),
            **compare_pairs(paired),
        }

    def _play(self, policy: Policy) -> pd.DataFrame:
        env = parallel_env(self._scenario.suite(self._args.suite))
        seeds = range(TUNING_SEEDS, TUNING_SEEDS + self._args.eval_episodes)
        episodes = [rollout(env, policy, seed) for seed in seeds]
        return pd.DataFrame({"seed": e.seed, "success": e.success, "robustness": e.robustness} for e in episodes)


def _score(evaluation: dict[str, Any]) -> tuple[float, float]:
    """Order evaluations: success first, then the paired gain over the expert."""
    return evaluation["success_rate"], evaluation["difference_median"]


def _settings(args: Args) -> dict[str, Any]:
    """Return the arguments as JSON values."""
    return {key: _plain(value) for key, value in asdict(args).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    return list(value) if isinstance(value, tuple) else value


if __name__ == "__main__":
    main(tyro.cli(Args))
