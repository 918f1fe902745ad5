"""Several runs of a training script, each in its own folder, done by whoever is chosen.

A run that is asked for again goes on from its last checkpoint; one that has ended is only read. So a command that was
killed is given again, and comes to the same policies. In the folder there are, beside what the script leaves there:

    result.json   the script's arguments, from the start, and what it returned, at the end
    state.tar     behind a URI: the script's folder at its last checkpoint, from which another machine goes on
"""

from __future__ import annotations

import io
import json
import tarfile
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from impact_envs.errors import InputError
from impact_envs.scenario import load_scenario
from planners.errors import PlanningError
from train.arguments import Args, TuneArgs
from train.errors import Diverged
from train.evaluation.journal import digest, read_versions
from train.launch.folder import Folder, LocalFolder, is_uri, open_folder, write_uri
from train.launch.launcher import Launcher
from train.launch.origin import Origin, check_origin, describe_origin
from train.settings import list_settings
from train.watch import show_progress

RESULT, STATE, DESCRIPTION = "result.json", "state.tar", "policy.json"
FREE = ("out", "resume", "threads", "progress", "log")  # arguments that change nothing of what is learned


@dataclass(frozen=True)
class TrainingRun:
    """One run of a training script.

    Attributes:
        script: which.
        args: its arguments; ``out`` is not looked at.
        out: its folder, an absolute path or a URI.
        values: what tells it from the others, name to value.
    """

    script: Literal["train", "tune"]
    args: Args | TuneArgs
    out: str
    values: tuple[tuple[str, Any], ...] = ()

    def __str__(self) -> str:
        """Name the run in a message."""
        return f"{self.script} in {self.out}"


def name_folder(out: str | Path, *words: str) -> str:
    """Return the folder of a run below a folder: an absolute path, since others may work elsewhere, or a URI."""
    whole = write_uri(out) if is_uri(out) else str(Path(out).absolute())
    return "/".join((whole.rstrip("/"), *words))


def launch_runs(
    launcher: Launcher, runs: Sequence[TrainingRun], progress: bool = True, keep_failures: bool = False
) -> list[dict[str, Any]]:
    """Do runs of training scripts.

    Args:
        launcher: who does them.
        runs: to be done.
        progress: show a bar of the runs on standard error.
        keep_failures: go on where a run diverges or its expert finds no plan.

    Returns:
        What each script returned, in the order of the runs; of one that failed, where that is kept, a line ``failure``.

    Raises:
        InputError: bad arguments, or a folder holds a run of others.
        PlanningError: an expert found no plan.
        Diverged: a run's weights are no longer finite.
        WorkerLost: a run lost its process too often.
    """
    _check_folders(runs)
    many = launcher.remote or getattr(launcher, "workers", 1) > 1
    asked = [replace(run, args=_quieten(run.args, many)) for run in runs]
    names = sorted({name for run in runs for name in run.args.scenarios})
    origin = describe_origin(_describe_facts(names), any(Path(name).is_file() for name in names))
    start = partial(_start, names, origin if launcher.remote else None, keep_failures)
    found: dict[str, dict[str, Any]] = {}
    with (
        show_progress(len(runs), progress and len(runs) > 1, "runs") as watch,
        closing(launcher.run(start, asked)) as ended,
    ):
        for out, result in ended:
            found[out] = result
            watch.advance(len(found))
    return [found[run.out] for run in runs]


def _quieten(args: Args | TuneArgs, many: bool) -> Any:
    """Return the arguments of one run among many: a core each, and no bar of its own."""
    return replace(args, progress=False, threads=args.threads or 1) if many else args


def _describe_facts(scenarios: Sequence[str]) -> dict[str, str]:
    digests = {f"scenario {name}": digest(load_scenario(name).model_dump_json().encode()) for name in scenarios}
    return {f"package {name}": value for name, value in read_versions().items()} | digests


def _start(
    scenarios: Sequence[str], origin: Origin | None, keep_failures: bool
) -> Callable[[TrainingRun], Iterator[tuple[str, dict[str, Any]]]]:
    if origin is not None:
        check_origin(origin, lambda: _describe_facts(scenarios))
    do = _do_or_say if keep_failures else do_run
    return lambda run: iter([(run.out, do(run))])


def _do_or_say(run: TrainingRun) -> dict[str, Any]:
    """Do a run; one that fails though its input is right has a line in place of a result."""
    try:
        return do_run(run)
    except (Diverged, PlanningError) as error:
        return {"failure": str(error), "out": run.out}


def do_run(run: TrainingRun) -> dict[str, Any]:
    """Do a run, go on with it, or read what it came to.

    Args:
        run: to be done.

    Raises:
        InputError: bad arguments, or its folder holds another run.
        PlanningError: the expert found no plan.
        Diverged: the weights are no longer finite.
    """
    folder, args = open_folder(run.out), _list_fixed(run.args)
    begun = folder.read(RESULT)
    if begun is not None and (result := _read_result(begun, args, folder)) is not None:
        return result
    if begun is None:
        if folder.read(DESCRIPTION) is not None:
            raise InputError(f"{folder}: holds a policy of another command; choose another out")
        check_run(run)
        _write_result(folder, args, None)
    if isinstance(folder, LocalFolder) and run.script == "train":
        result = _call_script(run, folder.path, None)
    else:
        with tempfile.TemporaryDirectory() as here:
            result = _run_elsewhere(run, folder, Path(here))
    result |= {"out": run.out}
    _write_result(folder, args, result)
    return result


def check_runs(runs: Sequence[TrainingRun]) -> None:
    """Raise unless all runs make sense that have not begun, before the first of them is done.

    Raises:
        InputError: one line naming the argument, its value and the limit, or the folder of two runs.
    """
    _check_folders(runs)
    for run in runs:
        if open_folder(run.out).read(RESULT) is None:
            check_run(run)


def _check_folders(runs: Sequence[TrainingRun]) -> None:
    folders = [run.out for run in runs]
    if len(set(folders)) < len(folders):
        twice = next(folder for folder in folders if folders.count(folder) > 1)
        raise InputError(f"two runs of the same folder {twice}: a seed, scenario, suite or value is given twice")


def check_run(run: TrainingRun) -> None:
    """Raise unless a run's arguments make sense, before anything is written.

    Raises:
        InputError: one line naming the argument, its value and the limit.
    """
    # Imported here: that a run has ended is found out without a learner.
    from train.ground import fill_args, read_cases

    if isinstance(run.args, TuneArgs):
        from train.tune import check_args as check_tuning

        check_tuning(run.args)
        read_cases(Args(run.args.scenarios, suite=run.args.suite, set=run.args.set, variant=run.args.variant))
        return
    from train.residual import check_args

    # In its own folder, not in the script's usual one, where there may be another run.
    check_args(fill_args(replace(run.args, out=Path(run.out)), read_cases(run.args)))


def _run_elsewhere(run: TrainingRun, folder: Folder, here: Path) -> dict[str, Any]:
    """Do a run in a folder of this machine, from which checkpoints and the end are copied."""
    if (state := folder.read(STATE)) is not None:
        with tarfile.open(fileobj=io.BytesIO(state)) as archive:
            archive.extractall(here, filter="data")
    result = _call_script(run, here, lambda: folder.write(STATE, _pack(here)))
    for name in LocalFolder(here).list(""):
        folder.write(name, (here / name).read_bytes())
    return result


def _call_script(run: TrainingRun, out: Path, saved: Callable[[], None] | None) -> dict[str, Any]:
    if isinstance(run.args, TuneArgs):
        from train.tune import main as tune

        return tune(replace(run.args, out=out))
    from train.residual import last_checkpoint
    from train.residual import main as train

    return train(replace(run.args, out=out, resume=last_checkpoint(out) is not None), saved)


def _pack(folder: Path) -> bytes:
    """Return a folder as an archive, without what is made anew or only looked at."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for name in LocalFolder(folder).list(""):
            if not name.startswith("tensorboard/"):
                archive.add(folder / name, name)
    return packed.getvalue()


def _list_fixed(args: Args | TuneArgs) -> dict[str, Any]:
    """Return the arguments that decide what is learned, as JSON values."""
    return {key: value for key, value in list_settings(asdict(args)).items() if key not in FREE}


def _write_result(folder: Folder, args: dict[str, Any], result: dict[str, Any] | None) -> None:
    folder.write(RESULT, (json.dumps({"args": args, "result": result}, default=_plain) + "\n").encode())


def _read_result(data: bytes, args: dict[str, Any], folder: Folder) -> dict[str, Any] | None:
    """Return what a run came to; None if it has not ended.

    Raises:
        InputError: it is a run with other arguments.
    """
    try:
        held = json.loads(data)
        before, result = dict(held["args"]), held["result"]
    except (ValueError, TypeError, KeyError):
        raise InputError(f"{folder}/{RESULT}: is not the result of a run") from None
    for name, value in json.loads(json.dumps(args)).items():
        if before.get(name) != value:
            raise InputError(f"{folder}: holds a run with {name} {before.get(name)}, not {value}; choose another out")
    return dict(result) if result is not None else None


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return str(value)
