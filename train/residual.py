"""Train a bounded correction to an expert, from first decision to resumable checkpoints.

``python -m train.residual --help`` lists every argument. What a run leaves in ``out``:

    policy.safetensors, policy.json   the policy that surely gains most on the tuning seeds, so ``out`` is a checkpoint
    checkpoints/<iteration>/          the last two policies, with all that is needed to resume
    args.json                         arguments, seed and versions
    tensorboard/                      learning curves

An iteration plays whole episodes, several of each seed that differ in exploration alone, and improves the policy by
PPO; what an episode is compared with is the others of its seed. Its seeds and all that it draws follow from the run's
seed and its number: a run that was killed and resumed ends with the weights of one that was not.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure
from stable_baselines3.common.utils import set_random_seed

from agents.actor import Actor, PolicyRecord, save_policy
from agents.play import play_episodes
from agents.residual import TRAINING_SEEDS
from agents.sb3 import (
    LearningOptions,
    Statistics,
    compute_statistics,
    explore,
    export_actor,
    make_model,
    update,
)
from agents.training_state import load_training, read_training, save_training
from impact_envs.errors import InputError
from train.arguments import Args
from train.errors import Diverged
from train.evaluation.case import REPORT_SEEDS, TUNING_SEEDS
from train.evaluation.folder_lock import lock_folder
from train.evaluation.journal import read_versions, write_json
from train.ground import DEFAULT_SUITE, Ground, fill_args, judge, make_grounds, read_cases
from train.limits import check_choice, check_hidden, check_least, check_ranges, check_same
from train.score import compare_episodes, find_failure_cost, loses_success, rate_evaluation
from train.settings import list_settings
from train.watch import Watch, run_script, show_progress

# Arguments that decide what a checkpoint means; a resumed run must have the same.
FIXED = (
    "scenarios", "suite", "seed", "variant", "set", "worlds", "group", "hidden", "worst", "cut", "failure",
    "highest_failure", "failure_rise", "failure_fall", "loss", "shares",
)  # fmt: skip


def main(args: Args, saved: Callable[[], None] | None = None) -> dict[str, Any]:
    """Train, or go on training, until ``steps`` corrections are answered.

    Ctrl-C or a kill loses the present iteration and nothing else.

    Args:
        args: arguments of the run.
        saved: called after every checkpoint, such as to copy it elsewhere.

    Returns:
        ``steps`` answered, ``out``, ``wall_seconds``, ``eval``: of the kept policy on the tuning seeds, paired with the
        expert, empty without evaluations, and ``report``: on seeds that it was not chosen on.

    Raises:
        InputError: bad arguments, or a run in ``out`` that cannot be gone on with.
        PlanningError: the expert found no plan.
        Diverged: the weights are no longer finite; the last checkpoint stays.
    """
    start = time.perf_counter()
    cases = read_cases(args)
    args = fill_args(args, cases)
    check_args(args)
    assert args.steps is not None
    torch.set_num_threads(1)
    with lock_folder(args.out):
        check_run(args)
        grounds = make_grounds(args, cases)
        try:
            run = Run(args, grounds, saved)
            with show_progress(args.steps, args.progress) as watch:
                run.begin(watch)
                while not run.is_over:
                    run.iterate(watch)
            report = run.report()
        finally:
            for ground in grounds:
                ground.worlds.close()
    return {
        "steps": run.model.num_timesteps,
        "out": str(args.out),
        "wall_seconds": time.perf_counter() - start,
        "eval": run.best,
        "report": report,
    }


def check_args(args: Args) -> None:
    """Raise unless the arguments make sense.

    Args:
        args: arguments of a run.

    Raises:
        InputError: one line naming the argument, its value and the limit.
    """
    least = {"steps": 1, "seed": 0, "group": 2, "worlds": 2, "batch": 2, "epochs": 1, "threads": 1}
    check_least(args, least | {"eval_every": 0, "eval_episodes": 2, "report_episodes": 0})
    shares = dict.fromkeys(("learning_rate", "clip", "entropy"), (0.0, 1.0))
    sizes = {"worst": (0.0, 1e6), "failure": (0.0, 1e6), "cut": (1e-6, 1e6), "target_kl": (1e-6, 1e6)}
    check_ranges(args, shares | sizes | {"log_std": (-20.0, 2.0)})
    check_ranges(args, {"highest_failure": (0.0, 1e6), "failure_rise": (1.0, 1e3), "failure_fall": (0.0, 1.0)})
    check_choice(args)
    if args.eval_episodes > REPORT_SEEDS - TUNING_SEEDS:
        raise InputError(f"eval_episodes {args.eval_episodes}: there are {REPORT_SEEDS - TUNING_SEEDS} tuning seeds")
    check_hidden(args.hidden)
    share = len(args.scenarios) * len(args.suite or (DEFAULT_SUITE,)) * args.group
    if args.worlds is None or args.worlds % share:
        raise InputError(
            f"worlds {args.worlds} is not a multiple of group {args.group} in each of {share // args.group} "
            "scenarios and suites"
        )
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
        raise InputError(f"out {args.out}: holds a run of {int(held.name)} iterations; resume it or choose another")
    if held is not None:
        check_same(held, read_training(held).run, list_settings(asdict(args)), FIXED)


def check_evaluations(checkpoint: Path, evaluations: list[dict[str, Any]]) -> None:
    """Raise unless evaluations of a resumed run can be compared with new ones.

    Args:
        checkpoint: where they were read.
        evaluations: as read.

    Raises:
        InputError: one lacks a number, or has none there.
    """
    for place, evaluation in enumerate(evaluations):
        for name in ("iterations", "share", "low", "success_rate", "expert_success_rate"):
            _check_number(checkpoint, f"evaluations.{place}", evaluation, name)
        sources = evaluation.get("sources")
        if not isinstance(sources, list) or not all(isinstance(source, dict) for source in sources):
            raise InputError(f"{checkpoint}: key 'evaluations.{place}': sources = {sources!r:.60}: a list is needed")
        for number, source in enumerate(sources):
            for name in ("success_rate", "expert_success_rate"):
                _check_number(checkpoint, f"evaluations.{place}.sources.{number}", source, name)


def _check_number(checkpoint: Path, key: str, held: dict[str, Any], name: str) -> None:
    if type(held.get(name)) not in (int, float):
        raise InputError(f"{checkpoint}: key '{key}': {name} = {held.get(name)!r:.60}: a number is needed")


def last_checkpoint(out: Path) -> Path | None:
    """Return the newest checkpoint of a run, None if there is none.

    Args:
        out: folder of the run.
    """
    folders = [path for path in (out / "checkpoints").glob("*") if path.name.isdecimal()]
    return max(folders, key=lambda path: int(path.name), default=None)


class Run:
    """What a run has learned so far, on tuning seeds and on disk.

    Args:
        args: arguments of the run; with ``args.resume`` the last checkpoint is loaded.
        grounds: to train in.
        saved: called after every checkpoint.

    Attributes:
        model: that is trained.
        statistics: of the expert's features.
        iterations: so far.
        evaluations: on tuning seeds, so far.

    Raises:
        InputError: the checkpoint does not fit the arguments.
    """

    def __init__(self, args: Args, grounds: list[Ground], saved: Callable[[], None] | None = None) -> None:
        self._args, self._grounds, self._settings = args, grounds, list_settings(asdict(args))
        self._saved = saved
        experts = grounds[0].worlds.experts
        options = LearningOptions(
            args.hidden, args.learning_rate, args.batch, args.epochs, args.clip, args.entropy, args.target_kl,
            args.log_std, args.seed,
        )  # fmt: skip
        self.model: PPO = make_model(experts.feature_size, experts.correction_size, options)
        if args.log:
            self.model.set_logger(configure(str(args.out / "tensorboard"), ["tensorboard"]))
        self.iterations, self.evaluations = 0, list[dict[str, Any]]()
        self._cpu_start = time.process_time()
        self.statistics: Statistics
        if args.resume:
            checkpoint = last_checkpoint(args.out)
            assert checkpoint is not None
            record, self.statistics = load_training(checkpoint, self.model)
            check_evaluations(checkpoint, record.evaluations)
            self.iterations, self.evaluations = record.iterations, record.evaluations
            self._cpu_start -= record.cpu_seconds
            if len(record.scales) != len(grounds):
                raise InputError(f"{checkpoint}: key 'scales': {len(record.scales)} of {len(grounds)} sources")
            for ground, scale in zip(grounds, record.scales, strict=True):
                ground.scale = scale
        else:
            self._meet_experts()

    @property
    def best(self) -> dict[str, Any]:
        """Return the evaluation of the kept policy; empty without any."""
        return max(self.evaluations, key=lambda found: rate_evaluation(found, self._args.loss), default={})

    @property
    def is_over(self) -> bool:
        """Return whether all corrections are answered."""
        return self.model.num_timesteps >= (self._args.steps or 0)

    @property
    def cpu_seconds(self) -> float:
        """Return the processor time of the run so far, all threads together, without what a kill lost [s]."""
        return round(time.process_time() - self._cpu_start, 3)

    def begin(self, watch: Watch) -> None:
        """Evaluate and save the start, the expert, if the run is new."""
        write_json(self._args.out / "args.json", {"args": self._settings, "versions": read_versions()})
        watch.advance(self.model.num_timesteps)
        if not self._args.resume:
            if self._args.eval_every:
                self._evaluate(watch)
            self._save()

    def iterate(self, watch: Watch) -> None:
        """Play, learn, evaluate if it is time to, and save."""
        try:
            self._learn()
        except FloatingPointError as error:
            raise Diverged(
                f"training diverged after {self.model.num_timesteps} corrections: {error}; "
                f"try a smaller learning_rate than {self._args.learning_rate}"
            ) from error
        self.iterations += 1
        watch.advance(self.model.num_timesteps)
        last, every = self.is_over, self._args.eval_every
        if every and (last or self.iterations % every == 0):
            self._evaluate(watch)
        self.model.logger.dump(self.model.num_timesteps)
        self._save()

    def _learn(self) -> None:
        """Play an iteration's episodes and learn from them."""
        start, args = time.perf_counter(), self._args
        draw, failure = self._seed(), find_failure_cost(args, self.evaluations)
        scores, rows = [], []
        for ground in self._grounds:
            count = ground.worlds.num_envs
            seeds = np.repeat(draw.integers(TRAINING_SEEDS, size=count // args.group), args.group)
            played = play_episodes(ground.worlds, seeds, self._explore)
            advantages = compare_episodes(args, played, ground.scale, failure)
            scores.append(played)
            rows.append((self.statistics.normalize(played.features), played.corrections, advantages[played.episode]))
        features, corrections, advantages = (np.concatenate(part) for part in zip(*rows, strict=True))
        seconds = time.perf_counter() - start
        if len(corrections):
            update(self.model, features, corrections, advantages)
        record = self.model.logger.record
        record("episode/success", float(np.mean(np.concatenate([played.success for played in scores]))))
        record("episode/robustness", float(np.median(np.concatenate([played.robustness for played in scores]))))
        record("episode/failure_cost", failure)
        record("correction/filtered", float(np.mean([played.filtered for played in scores])))
        record("time/corrections_per_second", len(corrections) / seconds)

    def report(self) -> dict[str, Any]:
        """Judge the kept policy on seeds that it was not chosen on; empty without such seeds."""
        from agents.actor import load_policy

        actor, _ = load_policy(self._args.out)
        return self._judge(actor, REPORT_SEEDS, self._args.report_episodes)

    def _meet_experts(self) -> None:
        """Play the experts alone: for the statistics of their features, and the unit of each score."""
        draw, features = self._seed(), []
        for ground in self._grounds:
            played = play_episodes(ground.worlds, draw.integers(TRAINING_SEEDS, size=ground.worlds.num_envs))
            if len(played.features) == 0:
                raise InputError(
                    f"scenario '{ground.source.scenario}' in suite '{ground.source.suite}': "
                    "the expert awaits no correction, there is nothing to learn"
                )
            features.append(played.features)
            ground.scale = max(abs(float(np.median(played.robustness))), 1e-3)
        self.statistics = compute_statistics(np.concatenate(features))

    def _seed(self) -> np.random.Generator:
        """Seed all that the next iteration draws from; return the generator of its episodes' seeds."""
        sequence = np.random.SeedSequence([self._args.seed, self.iterations])
        set_random_seed(int(sequence.generate_state(1)[0]))
        return np.random.default_rng(sequence)

    def _explore(self, features: np.ndarray) -> np.ndarray:
        return explore(self.model, self.statistics.normalize(features))

    def _evaluate(self, watch: Watch) -> None:
        """Play the tuning seeds, and keep the policy, or a share of it, if it surely gains most so far."""
        for share in self._args.shares:
            actor = export_actor(self.model, self.statistics, share)
            found = self._judge(actor, TUNING_SEEDS, self._args.eval_episodes)
            evaluation = {"iterations": self.iterations, "steps": self.model.num_timesteps, "share": share, **found}
            self.evaluations.append(evaluation)
            if self.best is evaluation:
                self._save_policy(self._args.out, actor)
            if share == 1.0:
                for name in ("success_rate", "expert_success_rate", "gain", "low", "correction"):
                    self.model.logger.record(f"tuning/{name}", evaluation[name])
            watch.say(describe_evaluation(evaluation))
            if not loses_success(evaluation, self._args.loss):
                return

    def _judge(self, actor: Actor, first: int, episodes: int) -> dict[str, Any]:
        return judge(self._grounds, actor, first, episodes, self._args.worst)

    def _save(self) -> None:
        """Write a checkpoint, all or nothing, and drop all but the last two."""
        folder = self._args.out / "checkpoints" / f"{self.iterations:06d}"
        partial, actor = folder.with_name(f".{folder.name}"), export_actor(self.model, self.statistics)
        for rest in (partial, folder):
            shutil.rmtree(rest, ignore_errors=True)
        if self._args.eval_every == 0:  # before the checkpoint: whoever resumes a finished run finds the last policy
            self._save_policy(self._args.out, actor)
        try:
            self._save_policy(partial, actor)
            scales = [ground.scale for ground in self._grounds]
            save_training(
                partial, self.model, self.statistics, self.iterations, scales, self._settings, self.evaluations,
                self.cpu_seconds,
            )  # fmt: skip
            partial.rename(folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        for old in sorted(folder.parent.glob("[0-9]*"))[:-2]:
            shutil.rmtree(old)
        if self._saved is not None:
            self._saved()

    def _save_policy(self, folder: Path, actor: Actor) -> None:
        experts = self._grounds[0].worlds.experts
        record = PolicyRecord(
            domain=self._grounds[0].worlds.scenario.domain,
            sources=tuple(ground.source for ground in self._grounds),
            variant=self._args.variant,
            algorithm="ppo",
            feature_size=experts.feature_size,
            correction_size=experts.correction_size,
            hidden=self._args.hidden,
            feature_clip=actor.feature_clip,
            seed=self._args.seed,
            steps=self.model.num_timesteps,
            training=self._settings,
            versions=read_versions(),
            cpu_seconds=self.cpu_seconds,
        )
        save_policy(folder, actor, record)


def describe_evaluation(evaluation: dict[str, Any]) -> str:
    """Return an evaluation as a line for people."""
    share = "" if evaluation["share"] == 1.0 else f", {evaluation['share']:g} of each"
    return (
        f"{evaluation['steps']:>7,} corrections{share}: success {100 * evaluation['success_rate']:.1f} % "
        f"(expert {100 * evaluation['expert_success_rate']:.1f} %), gain {evaluation['gain']:+.4f} m "
        f"(surely {evaluation['low']:+.4f})"
    )


if __name__ == "__main__":
    run_script(main, Args)
