"""The ``impact`` command: what users type.

Every command takes a scenario name or the path of a TOML file. With ``--json`` the last line of standard output is
one JSON object and nothing else goes there. Exit codes: 0 done, 1 the thing itself failed, 2 bad input.
"""

from __future__ import annotations

import contextlib
import io
import json as jsonlib
import os
import re
import sys
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from tyro.conf import Positional

from impact_envs.errors import InputError
from impact_envs.scenario import list_scenarios, load_scenario
from planners.errors import PlanningError
from train.planning import Plan, load_plan
from train.printing import show

EVALUATION_SEED = 2_000_000
LEAST_FRAMES = 200  # of a film, so that a short episode is seen slowly
DEMO_SCENARIOS = ("throw_and_catch", "corridor")
DEMO_POLICY = "corridor_hard"


@dataclass
class List:
    """List the shipped scenarios."""

    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return one entry per scenario."""
        from impact_envs import gym_id

        scenarios = [load_scenario(name) for name in list_scenarios()]
        return {
            "scenarios": [
                {
                    "name": s.name,
                    "domain": s.domain,
                    "gym_id": gym_id(s.name),
                    "horizon": s.horizon,
                    "agents": list(s.agents),
                }
                for s in scenarios
            ]
        }


@dataclass
class Run:
    """Run one episode."""

    scenario: Positional[str]
    """Shipped name or TOML file."""
    policy: str = "expert"
    """expert, zero, random, a variant of the expert, a shipped policy or a checkpoint folder."""
    seed: int = EVALUATION_SEED
    """Of the whole episode."""
    suite: str = "nominal"
    """Mismatch suite of the true world."""
    set: tuple[str, ...] = ()
    """Values to change, for example true.restitution=0.5."""
    plan: Path | None = None
    """Execute this plan instead of planning: a JSON file, or a folder of published CSV files."""
    render: str | None = None
    """human, or a file ending in .mp4, .gif or .png (the last frame)."""
    plot: Path | None = None
    """Draw the whole episode: a file ending in .png, .pdf or .svg."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return what the episode came to."""
        from impact_envs.env import parallel_env
        from impact_envs.rollout import rollout
        from train.evaluate import make_policy
        from train.grasp_metrics import compute_figures

        scenario = load_scenario(self.scenario).suite(self.suite)
        if self.set:
            scenario = scenario.override(dict(_assignment(text) for text in self.set))
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is negative; choices: 0, 1, 2, ...")
        film = _open_film(self.render)
        if self.plot:
            from train.plan_picture import check_picture_path

            check_picture_path(self.plot)
        policy = make_policy(self.policy, scenario, plan=load_plan(self.plan, scenario))
        watcher = _make_record(scenario, policy, self.plot)
        env = parallel_env(scenario, render_mode="rgb_array" if film else self.render)
        env.curves |= _plan_curves(policy)
        spacing = min(0.1, scenario.horizon / LEAST_FRAMES)
        every = scenario.steps if film and film.suffix == ".png" else max(1, round(spacing / scenario.control_period))

        def record(shown: Any) -> None:
            if watcher:
                watcher.add(shown)
            if film and (shown.steps % every == 0 or not shown.agents):
                film.add(shown.render())

        episode = rollout(env, policy, self.seed, on_step=record)
        env.close()
        if film:
            film.close()
        if self.plot:
            _save_picture(scenario, policy, watcher, episode, self.plot)
        manipulator = scenario.domain == "floating_manipulator"
        figures = watcher.figures(episode) if manipulator else compute_figures(episode, scenario)
        return _episode_summary(episode, self.suite) | figures


@dataclass
class Train:
    """Train a residual on top of the expert."""

    scenario: Positional[str]
    """Shipped name or TOML file."""
    suite: str = "restitution"
    """Mismatch suite to train under."""
    algo: str = "ppo"
    """Learning algorithm."""
    steps: int = 20_000
    """Decisions to train for."""
    out: Path = Path("runs/residual")
    """Folder of checkpoints and logs."""
    seed: int = 0
    """Of training; evaluation and tuning seeds are apart from it."""
    resume: bool = False
    """Go on from the last checkpoint in out."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return steps, folder, time and the tuning evaluation."""
        from train.residual import Args, main

        args = Args(
            scenario=self.scenario,
            suite=self.suite,
            algo=self.algo,
            steps=self.steps,
            out=self.out,
            seed=self.seed,
            resume=self.resume,
        )
        return main(args)


@dataclass
class Evaluate:
    """Judge policies on the same seeds."""

    scenarios: Positional[tuple[str, ...]]
    """Shipped names or TOML files."""
    policies: tuple[str, ...] = ("expert", "zero")
    """expert, zero, random, variants of the expert, shipped policies or checkpoint folders."""
    episodes: int = 20
    """Episodes per scenario, suite and policy."""
    seed: int = EVALUATION_SEED
    """First seed; the episodes take the following ones."""
    suite: tuple[str, ...] = ("nominal",)
    """Mismatch suites."""
    workers: int = 1
    """Processes."""
    out: Path | None = None
    """Folder of rows, summary and replays; a second call with it resumes."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the summary's rows and paired differences."""
        from train.evaluate import evaluate

        result = evaluate(
            scenarios=self.scenarios,
            policies=self.policies,
            episodes=self.episodes,
            seed=self.seed,
            suites=self.suite,
            workers=self.workers,
            out=self.out,
            progress=True,
        )
        return {"rows": result.rows, "paired": result.paired}


@dataclass
class Report:
    """Write one self-contained HTML page from an evaluation."""

    folder: Positional[Path]
    """Folder that impact evaluate --out wrote."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the page's path."""
        from train.report import write_report

        return {"report": str(write_report(self.folder))}


@dataclass
class Demo:
    """Do the main job in small: plan, evaluate expert and learned policy, write the report."""

    episodes: int = 20
    """Episodes per scenario, suite and policy."""
    out: Path = Path("report")
    """Folder of the report."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the summary, the plans and the report's path."""
        from train.evaluate import evaluate
        from train.report import write_report

        if self.episodes < 1:
            raise InputError(f"episodes {self.episodes} is too small; choices: 1, 2, ...")
        policies = ("expert", DEMO_POLICY, "zero")
        _clear_last_demo(self.out, policies)
        say = Console(stderr=True)
        plans = {}
        for name in DEMO_SCENARIOS:
            plans[name] = Plan(name).run()
            p = plans[name]
            say.print(
                f"plan of {name}: robustness {p['robustness']:.3f} m, gap {p['gap']:.3g}, "
                f"{len(p['impacts'])} impacts, {p['solve_seconds']:.2f} s"
            )
        say.print(f"{DEMO_POLICY} was trained on corridor under hard; elsewhere it shows how it carries over")
        result = evaluate(
            scenarios=DEMO_SCENARIOS,
            policies=policies,
            episodes=self.episodes,
            seed=EVALUATION_SEED,
            suites=("all", "hard"),
            workers=min(2, os.cpu_count() or 1),
            out=self.out,
            progress=True,
        )
        report = write_report(self.out)
        return {"plans": plans, "rows": result.rows, "paired": result.paired, "report": str(report)}


Command = List | Plan | Run | Train | Evaluate | Report | Demo


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; those of the process if None.

    Returns:
        Exit code: 0 done, 1 the thing itself failed, 2 bad input.
    """
    try:
        command = _parse(sys.argv[1:] if arguments is None else list(arguments))
        start = time.perf_counter()
        # Solvers and libraries may print; standard output is the result's alone.
        with contextlib.redirect_stdout(sys.stderr):
            result = command.run()
        result.setdefault("wall_seconds", time.perf_counter() - start)
    except InputError as error:
        print(f"impact: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        if error.filename is None:  # not about a file the user named
            raise
        print(f"impact: {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    except PlanningError as error:
        print(f"impact: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("impact: interrupted; what was finished is kept", file=sys.stderr)
        return 130
    if command.json:
        print(jsonlib.dumps(result, default=_plain))
    else:
        show(result)
    return 0


def _parse(arguments: list[str]) -> Command:
    """Parse arguments; tyro's boxed message becomes one line."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(Command, prog="impact", description=__doc__, args=arguments)
    except SystemExit as error:
        if not error.code:
            raise
    raise InputError(_one_line(said.getvalue())) from None


def _one_line(box: str) -> str:
    """Return the text of tyro's message box as one line."""
    lines = [re.sub(r"\x1b\[[0-9;]*m|[^\x20-\x7e]", " ", line).strip(" -+|") for line in box.splitlines()]
    title, *rest = [re.sub(r"\s+", " ", line) for line in lines if line and "--help" not in line] or ["bad arguments"]
    text = " ".join(rest)
    return text if text.lower().startswith(title.lower()) or title == "Value error" else f"{title}: {text}"


def _clear_last_demo(folder: Path, policies: Sequence[str]) -> None:
    """Forget the last demo's episodes: a demo shows the code as it is, so nothing is resumed."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out {folder}: is a file; it takes a folder")
    manifest = folder / "manifest.json"
    if manifest.exists():
        try:
            held = jsonlib.loads(manifest.read_text(encoding="utf-8")).get("policies")
        except (ValueError, AttributeError):
            held = None
        if held != list(policies):
            raise InputError(f"--out {folder}: holds another evaluation; choose another folder")
    for name in ("rows.jsonl", "manifest.json"):
        (folder / name).unlink(missing_ok=True)


def _assignment(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set {text}: expected KEY=VALUE, for example true.restitution=0.5")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


def _open_film(render: str | None) -> Any:
    """Return the film that --render asks for, None for a window or nothing."""
    from impact_envs.render import SUFFIXES, Film

    if render is None or render == "human":
        return None
    if Path(render).suffix.lower() not in SUFFIXES:
        raise InputError(f"--render {render}: choices: human, a file ending in {', '.join(SUFFIXES)}")
    return Film(render, fps=30)


def _make_record(scenario: Any, policy: Any, plot: Path | None) -> Any:
    """Return what watches an episode, None where the episode itself says enough."""
    if scenario.domain == "floating_manipulator":
        from train.manipulator_record import ManipulatorRecord

        return ManipulatorRecord(scenario)
    if scenario.domain == "free_flyer" and plot:
        from train.flight_record import FlightRecord

        return FlightRecord(policy)
    return None


def _save_picture(scenario: Any, policy: Any, watcher: Any, episode: Any, path: Path) -> None:
    """Draw a whole episode, in the way of its domain."""
    if scenario.domain == "floating_manipulator":
        from train.manipulator_picture import save_manipulator_picture

        save_manipulator_picture(watcher, episode, path)
    elif scenario.domain == "dual_arm":
        from train.grasp_picture import save_grasp_picture

        save_grasp_picture(scenario, policy, episode, path)
    else:
        from train.flight_picture import save_flight_picture

        save_flight_picture(scenario, episode, path, watcher)


def _plan_curves(policy: Any) -> dict[str, Any]:
    """Return the curves of the plan a policy follows, as polylines."""
    import numpy as np

    plan = getattr(getattr(policy, "expert", policy), "plan", None)
    if plan is None:
        return {}
    times = np.linspace(0.0, plan.horizon, 400)
    curves = plan.robots | plan.objects
    return {name: np.array([curve.position(t) for t in times]) for name, curve in curves.items()}


def _episode_summary(episode: Any, suite: str) -> dict[str, Any]:
    import numpy as np

    ms = episode.solve_seconds * 1e3
    names = {"p50": 0.5, "p99": 0.99, "max": 1.0}
    quantiles = {name: round(float(np.quantile(ms, q)), 4) for name, q in names.items()} if len(ms) else None
    return {
        "scenario": episode.scenario,
        "suite": suite,
        "policy": episode.policy,
        "seed": episode.seed,
        "robustness": episode.robustness,
        "success": episode.success,
        "impacts": [
            {
                "time": hit.time,
                "a": hit.a,
                "b": hit.b,
                "point": [float(x) for x in hit.point],
                "impulse": float(np.linalg.norm(hit.impulse)),
                "speed": hit.speed,
            }
            for hit in episode.impacts
        ],
        "effort": episode.effort,
        "solve_ms": quantiles,
        "fallbacks": dict(episode.fallbacks),
        "replans": episode.replans,
        "reoptimised": dict(episode.reoptimised),
        "wall_seconds": episode.wall_seconds,
    }


def _plain(value: Any) -> Any:
    """Turn numpy values and paths into what JSON knows."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"cannot write {type(value).__name__} as JSON")


if __name__ == "__main__":
    sys.exit(main())
