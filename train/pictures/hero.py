"""The film at the top of the README: one episode of each domain, side by side.

``python -m train.pictures.hero docs/hero.gif`` makes it anew; the same code gives the same film.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from impact_envs.env import ImpactEnv, parallel_env
from impact_envs.picture.film import Film
from impact_envs.rollout import rollout
from impact_envs.scenario import load_scenario
from planners import make_expert

SEED = 2_000_000  # the first one that evaluations use
FPS, SECONDS, HOLD = 15.0, 9.0, 2.5  # of the film; all of it fits into two megabytes
GAP = 4  # between panels [px]


@dataclass(frozen=True)
class Panel:
    """One of the episodes.

    Attributes:
        scenario, suite: where.
        caption: over it.
        size: width and height [px].
    """

    scenario: str
    suite: str
    caption: str
    size: tuple[int, int]


LEFT = Panel("obstacle_avoidance", "all", "Round an obstacle, moved by hits alone", (556, 640))
RIGHT = (
    Panel("floating_manipulator_thrusters", "nominal", "A floating arm hits, and recovers", (400, 318)),
    Panel("dual_arm_grasp", "nominal", "Two arms grasp by hitting", (400, 318)),
)


def make_hero(path: str | Path) -> Path:
    """Write the film.

    Args:
        path: of a .gif or .mp4 file.

    Returns:
        The path written.
    """
    left, *right = (_play(panel) for panel in (LEFT, *RIGHT))
    with Film(path, FPS, HOLD) as film:
        for pictures in zip(left, *right, strict=True):
            film.add(_compose(pictures))
    return Path(path)


def _play(panel: Panel) -> Iterator[np.ndarray]:
    """Yield the pictures of an expert's episode, as many for a short one as for a long one."""
    scenario = load_scenario(panel.scenario).suite(panel.suite)
    env = parallel_env(scenario, render_mode="rgb_array")
    env.caption, env.speed = panel.caption, scenario.horizon / SECONDS
    wanted = np.rint(np.linspace(0, scenario.steps, round(FPS * SECONDS))).astype(int).tolist()
    frames = []

    def watch(shown: ImpactEnv) -> None:
        if shown.steps in wanted:
            frame = shown.make_frame()
            frames.append(replace(frame, trails={body: path.copy() for body, path in frame.trails.items()}))

    rollout(env, make_expert(scenario), SEED, on_step=watch)
    renderer = env.make_renderer("rgb_array", size=panel.size)
    for frame in frames:
        picture = renderer.draw(frame)
        assert picture is not None
        yield picture


def _compose(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Put the first picture on the left and the others below each other on its right."""
    left, *right = pictures
    width = left.shape[1] + GAP + right[0].shape[1]
    whole = np.full((left.shape[0], width, 3), 255, np.uint8)
    whole[:, : left.shape[1]] = left
    top = 0
    for picture in right:
        whole[top : top + picture.shape[0], -picture.shape[1] :] = picture
        top += picture.shape[0] + GAP
    return whole


if __name__ == "__main__":
    made = make_hero(sys.argv[1] if len(sys.argv) > 1 else "docs/hero.gif")
    print(f"wrote {made}, {made.stat().st_size / 1e6:.2f} MB")
