"""Runs of a training script by seeds, and how they are listed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

from impact_envs.errors import InputError
from train.arguments import Args, TuneArgs
from train.cli.progress import say_written
from train.launch.choice import Launch, use_launcher
from train.launch.launcher import Launcher
from train.runs import TrainingRun, launch_runs, name_folder


def launch_seeds(
    script: Literal["train", "tune"], args: Args | TuneArgs, seeds: Sequence[int], launch: Launch
) -> dict[str, Any]:
    """Do a run of each seed, or the one that ``args`` names.

    Args:
        script: to be run.
        args: of the runs.
        seeds: each has a folder ``seedN`` in ``args.out``; without any there is one run, in ``args.out``.
        launch: where they are run.

    Raises:
        InputError: bad arguments, or a folder holds another run.
    """
    if isinstance(args, Args) and args.resume:
        raise InputError("--resume: --seeds and --launcher go on without being asked")
    runs = [
        TrainingRun(script, replace(args, seed=seed), name_folder(args.out, f"seed{seed}"), (("seed", seed),))
        for seed in seeds
    ] or [TrainingRun(script, args, name_folder(args.out), (("seed", args.seed),))]
    with use_launcher(launch) as launcher:
        return list_runs(launcher, runs)


def list_runs(launcher: Launcher, runs: Sequence[TrainingRun]) -> dict[str, Any]:
    """Do runs and return a row of each: what tells it apart, and how its policy compares with the expert.

    Args:
        launcher: who does them.
        runs: to be done.
    """
    rows = []
    for run, result in zip(runs, launch_runs(launcher, runs), strict=True):
        say_written(run.out)
        # On seeds that nothing was chosen on, where there are such.
        judged: dict[str, Any] = result["report"] or result["eval"] or {}
        gains = {name: judged.get(name) for name in ("success_rate", "expert_success_rate", "gain", "low")}
        rows.append({**dict(run.values), **gains, "out": run.out})
    return {"runs": rows}
