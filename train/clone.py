"""Clone the expert into one network that all robots share: behaviour cloning, then DAgger.

    python -m train.clone throw_and_catch --out runs/clone

``--help`` lists every argument. What a run leaves in ``out``:

    shared.safetensors, shared.json   the policy that did best on the tuning seeds, so ``out`` is a checkpoint
    iterations/<iteration>/           that iteration's policy, examples and evaluation: all that is needed to resume
    curve.json                        every evaluation, with training CPU seconds
    args.json                         arguments, seed and versions

An iteration plays an episode in every world. The expert says at every control period what it would do; what is done
is the expert's answer with probability beta, else the network's. The first iteration is the expert's alone; in later
ones the expert is asked where the network leads. Then the network is fitted to all examples so far. All that an
iteration draws follows from the run's seed and its number: a killed and resumed run ends with the same weights.

Source: Ross, Gordon & Bagnell, "A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning" (2011).
"""

from __future__ import annotations

import math
import shutil
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from stable_baselines3.common.utils import set_random_seed
from torch.nn.functional import smooth_l1_loss
from tyro.conf import Positional

from agents.actor import Actor
from agents.checkpoint import WeightsRecord, read_record, read_tensors, write_checkpoint
from agents.residual import TRAINING_SEEDS
from agents.shared_actor import (
    Choose,
    SharedRecord,
    add_waves,
    find_layout,
    judge_shared,
    load_shared,
    make_worlds,
    save_shared,
)
from agents.source import Source, make_source
from impact_envs.errors import InputError
from planners import check_options, has_planner, list_options, make_expert_batch, make_plan
from train.errors import Diverged
from train.evaluation.case import REPORT_SEEDS, TUNING_SEEDS, make_case
from train.evaluation.folder_lock import lock_folder
from train.evaluation.journal import read_versions, write_json
from train.limits import check_hidden, check_least, check_ranges, check_same
from train.settings import parse_settings
from train.watch import Watch, run_script, show_progress

# Seeds of selection and of the report on what was selected; evaluation seeds start at 2,000,000.
EXAMPLES, DESCRIPTION = "examples.safetensors", "iteration.json"
# Arguments that decide what a checkpoint means; a resumed run must have the same.
FIXED = ("scenario", "suite", "seed", "variant", "set", "worlds", "beta", "hold", "noise", "hidden", "waves",
         "least_spread", "fit_steps", "batch", "learning_rate", "loss_width")  # fmt: skip


@dataclass(frozen=True)
class Args:
    """Arguments of a cloning run."""

    scenario: Positional[str] = "throw_and_catch"
    """Shipped name or TOML file."""
    suite: str = "nominal"
    """Mismatch suite of the true world."""
    iterations: int = 20
    """Times that examples are collected and the network is fitted, in the whole run."""
    out: Path = Path("runs/clone")
    """Folder for checkpoints and curve."""
    resume: bool = False
    """Go on from the last iteration in out."""
    seed: int = 0
    """Of network, mixture and episodes."""
    variant: str | None = None
    """Published form or baseline of the expert to clone; without: the expert."""
    set: tuple[str, ...] = ()
    """Values to change, for example true.restitution=0.5 expert.NAME=VALUE."""
    worlds: int = 32
    """Episodes of an iteration."""
    threads: int = 1
    """That share the worlds."""
    beta: float = 0.5
    """Iteration i lets the expert act with probability beta^i."""
    hold: float = 1.0
    """Time that the same one acts, and that noise stays the same [s]: a robot moves by centimetres in it."""
    noise: float = 0.05
    """Standard deviation of what is added to the actions done (not to the examples), share of the limits: without it
    every nominal episode of the expert is the same one."""
    hidden: tuple[int, ...] = (128, 128)
    """Width of each hidden layer."""
    waves: int = 16
    """Waves of the time that the network reads; the fastest turns about in horizon / 16."""
    least_spread: float = 0.05
    """Of a feature [m, m/s]: one that hardly varies in the expert's episodes is not blown up."""
    fit_steps: int = 1500
    """Gradient steps of an iteration."""
    batch: int = 512
    """Examples per gradient step."""
    learning_rate: float = 2e-3
    """Step size of Adam; falls to zero within an iteration along a cosine."""
    loss_width: float = 0.02
    """Error of an action from which on it counts linearly, not squared: answers jump where the expert replans."""
    eval_episodes: int = 20
    """Tuning seeds per evaluation."""
    report_episodes: int = 200
    """Seeds for the report on the kept policy, neither learned from nor chosen on; 0: none."""
    progress: bool = True
    """Show a bar, and each evaluation, on standard error."""


class IterationRecord(WeightsRecord):
    """The content of iteration.json, beside the examples.

    Attributes:
        format_version: of the two files.
        run: every argument of the run.
        evaluation: on the tuning seeds.
    """

    format_version: Literal[1] = 1
    run: dict[str, Any]
    evaluation: dict[str, Any]


def main(args: Args) -> dict[str, Any]:
    """Clone, or go on cloning, until all iterations are done; Ctrl-C or a kill loses the present one alone.

    Args:
        args: arguments of the run.

    Returns:
        ``iterations``, ``steps`` (examples of one robot each), ``out``, ``wall_seconds``, ``eval``: of the kept policy
        on the tuning seeds, ``report``: on seeds that it was not chosen on.

    Raises:
        InputError: bad arguments, or a run in ``out`` that cannot be gone on with.
        PlanningError: the expert found no plan.
        Diverged: the weights are no longer finite; the last iteration stays.
    """
    start = time.perf_counter()
    check_args(args)
    make_case(args.scenario, args.suite, parse_settings(args.set))  # refused before anything is written
    torch.set_num_threads(1)
    with lock_folder(args.out):
        check_run(args)
        run = Run(args)
        write_json(args.out / "args.json", {"args": run.settings, "versions": read_versions()})
        with show_progress(args.iterations, args.progress) as watch:
            watch.advance(run.iterations)
            while run.iterations < args.iterations:
                run.iterate(watch)
        report = run.report()
    return {
        "iterations": run.iterations,
        "steps": run.steps,
        "out": str(args.out),
        "wall_seconds": time.perf_counter() - start,
        "eval": run.best,
        "report": report,
    }


def check_args(args: Args) -> None:
    """Raise unless the arguments make sense.

    Raises:
        InputError: one line naming the argument, its value and the limit.
    """
    least = {"iterations": 1, "worlds": 1, "threads": 1, "fit_steps": 1, "batch": 1, "eval_episodes": 1}
    check_least(args, least | {"seed": 0, "waves": 0, "report_episodes": 0})
    shares = {"beta": (0.0, 1.0), "noise": (0.0, 1.0), "learning_rate": (0.0, 1.0), "loss_width": (1e-6, 1.0)}
    check_ranges(args, shares | {"hold": (0.0, 1e6), "least_spread": (1e-6, 1e6)})
    check_hidden(args.hidden)


def check_run(args: Args) -> None:
    """Raise unless what is in ``out`` is gone on with if there is something, and can be.

    Raises:
        InputError: one line naming the folder, and the argument that differs.
    """
    held = list_iterations(args.out)
    if args.resume and not held:
        raise InputError(f"out {args.out}: holds no iteration to resume from")
    if held and not args.resume:
        raise InputError(f"out {args.out}: holds a run of {len(held)} iterations; resume it or choose another")
    if held:
        before = read_record(held[-1] / DESCRIPTION, IterationRecord).run
        check_same(held[-1], before, describe_args(args), FIXED)


def list_iterations(out: Path) -> list[Path]:
    """Return the folders of a run's finished iterations, in order."""
    return sorted(path for path in (out / "iterations").glob("[0-9]*") if path.name.isdecimal())


class Teacher:
    """Worlds of a scenario, the expert who is asked in them, and what is done there.

    Args:
        args: arguments of the run.

    Attributes:
        scenario: in its suite.
        source: its description.
        size, action_size: of a robot's observation and action.
        time_place: of time / horizon in an observation.

    Raises:
        InputError: an unknown scenario, suite or value, or one whose robots cannot share a policy.
        PlanningError: the expert found no plan.
    """

    def __init__(self, args: Args) -> None:
        case = make_case(args.scenario, args.suite, parse_settings(args.set))
        self.scenario, self._args, self._options = case.scenario, args, dict(case.options)
        check_options(self.scenario, self._options, args.variant)
        if args.variant is None and "plan_anew" in list_options(self.scenario):
            self._options.setdefault("plan_anew", False)  # answers must come at once
        self.layout = find_layout(self.scenario)
        self.time_place = self.layout["time"].start
        self._plan = make_plan(self.scenario) if has_planner(self.scenario) else None
        self.source: Source = make_source(self.scenario, args.suite, self._plan)
        self._worlds = make_worlds(self.scenario, args.worlds, args.threads)
        self._experts = make_expert_batch(
            self.scenario, args.worlds, self._plan, args.variant, self._options or None, args.threads
        )
        self.robots = self._worlds.batch.robots
        self.action_size = int(np.prod(self._worlds.batch.action_shape)) // self.robots

    def collect(self, choose: Choose | None, beta: float, draw: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Play an episode in every world, asking the expert all along.

        Args:
            choose: the network: robots' observations, shape (worlds, robots, size), to actions; None: the expert alone.
            beta: probability that the expert acts.
            draw: of seeds, mixture and noise.

        Returns:
            Robots' observations, shape (n, size), and the expert's answers, shape (n, action_size), float32.
        """
        args, worlds = self._args, self._worlds
        shape = (args.worlds, self.robots, self.action_size)
        every = max(round(args.hold / self.scenario.control_period), 1)
        joint, _ = worlds.reset(seed=draw.integers(TRAINING_SEEDS, size=args.worlds).tolist())
        observations, answers = [], []
        for step in range(self.scenario.steps):
            if step % every == 0:
                expert_acts = draw.random((args.worlds, 1, 1)) < beta
                noise = args.noise * draw.standard_normal(shape)
            seen, answer = worlds.agent_observations.copy(), self._experts.act(joint).reshape(shape)
            done = answer if choose is None else np.where(expert_acts, answer, choose(seen))
            observations.append(seen.astype(np.float32))
            answers.append(np.clip(answer, -1.0, 1.0).astype(np.float32))
            joint = worlds.step(np.clip(done + noise, -1.0, 1.0).reshape(args.worlds, -1))[0]
        flat = (np.stack(part).reshape(-1, part[0].shape[-1]) for part in (observations, answers))
        return next(flat), next(flat)

    def judge(self, choose: Choose, first: int, episodes: int) -> dict[str, float]:
        """Play the network alone in worlds of successive seeds; see `shared_actor.judge_shared`."""
        return judge_shared(self.scenario, choose, first, episodes, self._args.threads)

    def close(self) -> None:
        """Let worlds and experts go."""
        self._worlds.close()
        self._experts.close()


class Run:
    """What a run has learned so far, on tuning seeds and on disk.

    Args:
        args: arguments of the run; with ``args.resume`` the iterations in ``out`` are loaded.

    Raises:
        InputError, PlanningError: as Teacher; InputError also where an iteration's files are damaged.
    """

    def __init__(self, args: Args) -> None:
        self._args, self.settings, self._teacher = args, describe_args(args), Teacher(args)
        self._examples: list[tuple[np.ndarray, np.ndarray]] = []
        self.evaluations: list[dict[str, Any]] = []
        self._spent = 0.0  # CPU time of training so far, without evaluation [s]
        self._actor: Actor | None = None
        for folder in list_iterations(args.out):
            record = read_record(folder / DESCRIPTION, IterationRecord)
            tensors = read_tensors(folder / EXAMPLES, record)
            self._examples.append((tensors["observations"], tensors["answers"]))
            self.evaluations.append(record.evaluation)
        if self.evaluations:
            self._actor, _ = load_shared(list_iterations(args.out)[-1])
            self._spent = self.evaluations[-1]["cpu_seconds"]
            self._keep_best()  # a kill may have come in between

    @property
    def iterations(self) -> int:
        """Return how many iterations are done."""
        return len(self.evaluations)

    @property
    def steps(self) -> int:
        """Return how many examples there are."""
        return sum(len(answers) for _, answers in self._examples)

    @property
    def best(self) -> dict[str, Any]:
        """Return the evaluation of the kept policy."""
        return max(self.evaluations, key=lambda found: (found["success_rate"], found["robustness"]))

    def iterate(self, watch: Watch) -> None:
        """Collect, fit, evaluate and save."""
        start, args = time.process_time(), self._args
        sequence = np.random.SeedSequence([args.seed, self.iterations])
        draw = np.random.default_rng(sequence)
        set_random_seed(int(sequence.generate_state(1)[0]))
        choose = None if self._actor is None else self._choose
        self._examples.append(self._teacher.collect(choose, args.beta**self.iterations, draw))
        if self._actor is None:
            self._actor = self._make_actor()
        error = self._fit(draw)
        self._spent += time.process_time() - start
        found = self._teacher.judge(self._choose, TUNING_SEEDS, args.eval_episodes)
        self.evaluations.append(
            {"iteration": self.iterations + 1, "steps": self.steps, "cpu_seconds": self._spent, "error": error, **found}
        )
        self._save()
        watch.advance(self.iterations)
        watch.say(describe_evaluation(self.evaluations[-1]))

    def report(self) -> dict[str, Any]:
        """Judge the kept policy on seeds that it was not chosen on; empty without such seeds."""
        if self._args.report_episodes:
            self._actor, _ = load_shared(self._args.out)
            found = self._teacher.judge(self._choose, REPORT_SEEDS, self._args.report_episodes)
        self._teacher.close()
        return found if self._args.report_episodes else {}

    def _make_actor(self) -> Actor:
        """Make a network that is normalised by the expert's own episodes, and returns zeros."""
        features = self._add_waves(self._examples[0][0].astype(float))
        actor = Actor(features.shape[1], self._teacher.action_size, self._args.hidden)
        actor.mean.copy_(torch.from_numpy(features.mean(axis=0)))
        actor.std.copy_(torch.from_numpy(np.maximum(features.std(axis=0), self._args.least_spread)))
        return actor

    def _fit(self, draw: np.random.Generator) -> float:
        """Fit the network to all examples so far; return the mean error of the last tenth of the steps."""
        assert self._actor is not None
        args, actor = self._args, self._actor
        observations, answers = (np.concatenate(part) for part in zip(*self._examples, strict=True))
        features, targets = torch.from_numpy(self._add_waves(observations)), torch.from_numpy(answers)
        optimizer = torch.optim.Adam(actor.parameters(), args.learning_rate)
        errors = np.empty(args.fit_steps)
        for step in range(args.fit_steps):
            for group in optimizer.param_groups:
                group["lr"] = args.learning_rate * (1.0 + math.cos(math.pi * step / args.fit_steps)) / 2
            chosen = torch.from_numpy(draw.integers(len(targets), size=args.batch))
            predicted = actor(features[chosen])
            loss = smooth_l1_loss(predicted, targets[chosen], beta=args.loss_width)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            errors[step] = loss.item()
        if not all(torch.isfinite(parameter).all() for parameter in actor.parameters()):
            raise Diverged(f"fitting diverged: try a smaller learning_rate than {args.learning_rate}")
        return float(errors[-max(args.fit_steps // 10, 1) :].mean())

    def _choose(self, observations: np.ndarray) -> np.ndarray:
        assert self._actor is not None
        return self._actor.correction(self._add_waves(observations))

    def _add_waves(self, observations: np.ndarray) -> np.ndarray:
        return add_waves(observations, self._teacher.time_place, self._args.waves).astype(observations.dtype)

    def _save(self) -> None:
        """Write the iteration's folder, all or nothing, and the policy if it is the best so far."""
        folder = self._args.out / "iterations" / f"{self.iterations - 1:06d}"
        partial = folder.with_name(f".{folder.name}")
        assert self._actor is not None
        shutil.rmtree(partial, ignore_errors=True)
        try:
            save_shared(partial, self._actor, self._describe())
            observations, answers = self._examples[-1]
            record = IterationRecord(run=self.settings, evaluation=self.evaluations[-1])
            write_checkpoint(
                (partial / EXAMPLES, {"observations": observations, "answers": answers}),
                (partial / DESCRIPTION, record),
            )
            partial.rename(folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        self._keep_best()

    def _keep_best(self) -> None:
        """Put the best iteration's policy, and the curve, into ``out``."""
        best = self._args.out / "iterations" / f"{self.best['iteration'] - 1:06d}"
        save_shared(self._args.out, *load_shared(best))
        write_json(self._args.out / "curve.json", {"evaluations": self.evaluations})

    def _describe(self) -> SharedRecord:
        assert self._actor is not None
        teacher = self._teacher
        return SharedRecord(
            domain=teacher.scenario.domain,
            sources=(teacher.source,),
            algorithm="dagger",
            observation=tuple(teacher.layout.describe().splitlines()),
            action_size=teacher.action_size,
            time_place=teacher.time_place,
            waves=self._args.waves,
            hidden=self._args.hidden,
            feature_clip=self._actor.feature_clip,
            seed=self._args.seed,
            steps=self.steps,
            training=self.settings,
            versions=read_versions(),
            cpu_seconds=round(self._spent, 3),
        )


def describe_evaluation(found: dict[str, Any]) -> str:
    """Return an evaluation as a line for people."""
    return (
        f"iteration {found['iteration']:>3}: {found['steps']:>9,} examples, {found['cpu_seconds']:6.0f} s CPU, error "
        f"{found['error']:.5f}: success {100 * found['success_rate']:.1f} %, robustness {found['robustness']:+.4f} m"
    )


def describe_args(args: Args) -> dict[str, Any]:
    """Return the arguments as JSON values."""
    values = asdict(args) | {"out": str(args.out)}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}


if __name__ == "__main__":
    run_script(main, Args)
