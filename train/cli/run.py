"""The ``impact run`` command."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.interface.episode_file import check_episode_path
from impact_envs.scenario import Scenario
from train.cli.progress import say_written
from train.evaluation.case import EVALUATION_SEEDS, check_settings, has_expert, make_case
from train.given_plan import check_plan_options, load_plan
from train.pictures.file import check_picture_path
from train.pictures.film import find_followed, sample_curves
from train.settings import parse_settings


@dataclass
class Command:
    """Run one episode."""

    extras: ClassVar[tuple[str, ...]] = ("plan",)
    scenario: Annotated[Positional[str], arg(metavar="SCENARIO")]
    """Shipped name or TOML file."""
    policy: str = "expert"
    """expert, oracle (told the truth), zero, random, a variant of the expert, a shipped policy or checkpoint folder, or
    MODULE:FACTORY of your own (module in the working folder, or a file: mine.py:make)."""
    seed: int = EVALUATION_SEEDS
    """Of the whole episode."""
    suite: str = "nominal"
    """Mismatch suite of the true world."""
    set: tuple[str, ...] = ()
    """Values to change, for example true.restitution=0.5 expert.NAME=VALUE."""
    plan: Path | None = None
    """Execute this plan instead of planning: a JSON file, or a folder of published CSV files."""
    rename: tuple[str, ...] = ()
    """Names of bodies in a published plan, PLAN=SCENARIO, where roles and starts do not tell them."""
    force: bool = False
    """Fly a plan that breaks the impact law or a limit by too much."""
    render: str | None = None
    """human, or a file ending in .mp4, .gif or .png (the last frame)."""
    speed: float | None = None
    """Of a film or window, in times real time; default: 3, less for a short episode."""
    plot: Path | None = None
    """Draw the whole episode: a file ending in .png, .pdf or .svg."""
    save: Path | None = None
    """Write the trajectory, with actions, rewards and impacts: a file ending in .npz, .parquet or .csv."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return what the episode came to."""
        from impact_envs.env import parallel_env
        from impact_envs.rollout import rollout
        from train.evaluation.metrics import find_metrics, measure
        from train.evaluation.own_policy import announce
        from train.evaluation.player import make_policy

        settings = parse_settings(self.set)
        case = make_case(self.scenario, self.suite, settings)
        scenario = case.scenario
        check_settings(case, (self.policy,))
        film = self._check(scenario)
        given = load_plan(self.plan, scenario, self.rename) if self.plan else None
        plan = given.admit(self.force) if given else None
        announce((self.policy,))
        policy = make_policy(self.policy, scenario, plan, case.options)
        record = self._make_record(scenario, policy)
        env = parallel_env(scenario, render_mode="rgb_array" if film else None)
        env.curves |= sample_curves(policy)
        if film:
            env.caption, env.speed = film.caption, film.speed

        def watch(shown: Any) -> None:
            if record:
                record.add(shown)
            if film:
                film.add(shown)

        with film or nullcontext():
            episode = rollout(env, policy, self.seed, on_step=watch)
        env.close()
        if self.plot:
            find_part("train", scenario.domain, "PICTURE")(record, episode, self.plot)
        saved = episode.save(self.save) if self.save else ()
        say_written(film and film.path, self.plot, *saved)
        figures = find_part("train", scenario.domain, "FIGURES")
        return (
            _summarize(episode, scenario, self.suite)
            | {"set": settings}
            | measure(find_metrics(scenario.domain), episode, scenario, find_followed(policy))
            | (figures(record, episode) if figures else {})
            | (given.describe() if given else {})
            | _explain(episode, scenario, self.policy)
        )

    def _check(self, scenario: Scenario) -> Any:
        """Refuse what cannot be played or written before anything is played; returns the film, None without one."""
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is negative; choices: 0, 1, 2, ...")
        check_plan_options(self.plan, self.rename, self.force)
        if self.plan and not has_expert(self.policy):
            raise InputError(f"--plan {self.plan}: policy {self.policy} has no expert that follows a plan")
        if self.plot:
            check_picture_path(self.plot)
            if find_part("train", scenario.domain, "PICTURE") is None:
                raise InputError(f"--plot {self.plot}: domain '{scenario.domain}' draws no picture of an episode")
        if self.save:
            check_episode_path(self.save)
        return self._open_viewer(scenario)

    def _open_viewer(self, scenario: Scenario) -> Any:
        """Return what shows the episode, None where nobody asks for it."""
        from train.pictures.film import Viewer

        if self.render is None:
            if self.speed is not None:
                raise InputError(f"--speed {self.speed:g}: shows nothing without --render")
            return None
        caption = f"{scenario.name} · {Path(self.policy).name} · suite {self.suite} · seed {self.seed}"
        return Viewer(self.render, scenario, self.speed, caption)

    def _make_record(self, scenario: Scenario, policy: Any) -> Any:
        """Return what watches the episode, None where nobody asks it."""
        make = find_part("train", scenario.domain, "RECORD")
        asked = self.plot or find_part("train", scenario.domain, "FIGURES")
        return make(scenario, policy) if make and asked else None


def _explain(episode: Any, scenario: Scenario, policy: str) -> dict[str, str]:
    """Return why an episode of an expert ends without success where the published one does."""
    outcomes = find_part("train", scenario.domain, "OUTCOMES") or {}
    told = not episode.success and has_expert(policy) and episode.scenario in outcomes
    return {"note": outcomes[episode.scenario]} if told else {}


def _summarize(episode: Any, scenario: Scenario, suite: str) -> dict[str, Any]:
    import numpy as np

    from impact_envs.picture.unit import find_unit

    ms = episode.solve_seconds * 1e3
    names = {"p50": 0.5, "p99": 0.99, "max": 1.0}
    quantiles = {name: round(float(np.quantile(ms, q)), 4) for name, q in names.items()} if len(ms) else None
    return {
        "scenario": episode.scenario,
        "domain": scenario.domain,
        "suite": suite,
        "policy": episode.policy,
        "seed": episode.seed,
        "robustness": episode.robustness,
        "unit": find_unit(scenario.specification),
        "success": episode.success,
        "failure": episode.failure,
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
        "episode_seconds": episode.wall_seconds,
    }
