"""Films and plots of the site, made by the expert when the site is built; kept until the code changes."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from agents import ResidualPolicy
from impact_envs import load_scenario, parallel_env, rollout
from impact_envs.picture.render import Film
from planners import make_expert
from train.cli.plan import Command as PlanCommand
from train.cli.run import Command as RunCommand
from train.evaluation.case import EVALUATION_SEEDS
from train.pictures.file import save_figure

ROOT = Path(__file__).parents[2]
FRAMES, FPS = 180, 20  # of a film, whatever the horizon; a film lasts nine seconds
# Plots of the explaining pages, by the name of the file.
PLOTS: dict[str, Callable[[Path], object]] = {
    "plan_obstacle_avoidance.png": lambda path: PlanCommand("obstacle_avoidance", plot=path).run(),
    "expert_throw_and_catch.png": lambda path: RunCommand("throw_and_catch", suite="all", plot=path).run(),
    "corrections.png": lambda path: draw_corrections("throw_and_catch", EVALUATION_SEEDS, path),
    "manipulator.png": lambda path: RunCommand("floating_manipulator_thrusters", plot=path).run(),
    "arms.png": lambda path: RunCommand("dual_arm_grasp", plot=path).run(),
}


def make_pictures(folder: Path, names: tuple[str, ...]) -> dict[str, str]:
    """Make the films of scenarios, and the plots, unless they are there already and of the present code.

    Args:
        folder: that takes them.
        names: of the scenarios.

    Returns:
        The name of each scenario's film.
    """
    stamp, digest = folder / "digest.txt", read_sources()
    if not stamp.is_file() or stamp.read_text() != digest:
        stamp.unlink(missing_ok=True)
        for name in names:
            print(f"film of {name}", flush=True)
            film_episode(name, folder / f"{name}.mp4")
        for file, draw in PLOTS.items():
            print(f"plot {file}", flush=True)
            draw(folder / file)
        stamp.write_text(digest)
    return {name: f"{name}.mp4" for name in names}


def film_episode(name: str, path: Path) -> None:
    """Film an episode of the expert in the nominal world; its last frame stands beside it as PNG.

    Args:
        name: of a scenario.
        path: of the film.
    """
    scenario = load_scenario(name)
    env, every = parallel_env(scenario, render_mode="rgb_array"), max(1, scenario.steps // FRAMES)
    env.speed = FPS * every * scenario.control_period
    with Film(path, FPS) as film, Film(path.with_suffix(".png"), FPS) as last:

        def watch(shown: object) -> None:
            if env.steps % every == 0 or not env.agents:
                picture = env.render()
                film.add(picture)
                last.add(picture)

        rollout(env, make_expert(scenario), EVALUATION_SEEDS, on_step=watch)
    env.close()


def draw_corrections(name: str, seed: int, path: Path) -> None:
    """Draw the way of the first object without corrections, and with each element of every correction held at 1.

    Args:
        name: of a scenario of free-flyers.
        seed: of all episodes.
        path: of the picture.
    """
    scenario, expert = load_scenario(name), make_expert(name)
    item, env = next(iter(scenario.objects)), parallel_env(scenario)
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    axes = figure.subplots(1, 2)
    for k in range(-1, expert.correction_size):
        correction = np.eye(expert.correction_size)[k] if k >= 0 else np.zeros(expert.correction_size)
        episode = rollout(env, ResidualPolicy(expert, lambda features, c=correction: c), seed)
        label = f"$c_{k} = 1$" if k >= 0 else "expert, $c = 0$"
        style = {"label": f"{label}: {episode.robustness:.2f} m", "color": "black" if k < 0 else f"C{k}"}
        axes[0].plot(episode.signals[f"{item}.x"], episode.signals[f"{item}.y"], **style)
        axes[1].plot(episode.times, np.hypot(episode.signals[f"{item}.vx"], episode.signals[f"{item}.vy"]), **style)
    axes[0].set(xlabel="x [m]", ylabel="y [m]", title=f"way of {item}", aspect="equal", adjustable="datalim")
    axes[1].set(xlabel="time [s]", ylabel="speed [m/s]", title=f"speed of {item}")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, title="robustness")
    save_figure(figure, path)


def read_sources() -> str:
    """Return the digest of all that films and plots depend on."""
    files = [file for layer in ("impact_envs", "planners", "agents", "train") for file in (ROOT / layer).rglob("*")]
    text = b"".join(file.read_bytes() for file in sorted(files) if file.suffix in (".py", ".toml", ".lark"))
    return sha256(text + Path(__file__).read_bytes()).hexdigest()
