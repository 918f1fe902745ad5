"""The replay of an episode: all that is needed to draw it without the simulator."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from impact_envs.domain import find_part
from impact_envs.file import make_file_name
from impact_envs.interface.shape import Shape
from impact_envs.rollout import Episode
from planners.plan import Plan
from train.evaluation.statistics import compute_solve_times

DECIMALS = 5


def find_replay(directory: Path, scenario: str, suite: str, policy: str, seed: int) -> Path:
    """Return where the replay of an episode is, in the folder of an evaluation."""
    return directory / "replays" / make_file_name(scenario, suite, policy, seed, suffix=".json")


def episode_to_dict(
    episode: Episode, scenario: Any, suite: str, shapes: Iterable[Shape], plan: Plan | None = None
) -> dict[str, Any]:
    """Return an episode as a JSON object that can be replayed without the simulator.

    Args:
        episode: what happened.
        scenario: where, in its suite.
        suite: name of the suite.
        shapes: what is drawn, fixed in the world or carried by a body.
        plan: what the policy set out to do, if it had a plan.

    Returns:
        Numbers are rounded to 1e-5; a bound that is not finite is None.
    """
    links = find_part("train", scenario.domain, "LINKS")
    return {
        "format": 1,
        "scenario": episode.scenario,
        "domain": scenario.domain,
        "suite": suite,
        "policy": episode.policy,
        "seed": episode.seed,
        "formula": str(scenario.specification),
        "horizon": scenario.horizon,
        "period": episode.period,
        "world": [list(scenario.world.lower), list(scenario.world.upper)],
        "agents": list(scenario.agents),
        "bodies": list(scenario.bodies),
        "shapes": [asdict(shape) for shape in shapes],
        "links": links(scenario) if links else {},
        "times": _rounded(episode.times),
        "signals": {name: _rounded(values) for name, values in episode.signals.items()},
        "actions": {name: _rounded(values) for name, values in episode.actions.items()},
        "rewards": {name: _rounded(values) for name, values in episode.rewards.items()},
        "impacts": [
            {key: value if isinstance(value, str) else _rounded(value) for key, value in asdict(impact).items()}
            for impact in episode.impacts
        ],
        "robustness_bounds": [[_finite(x) for x in pair] for pair in _rounded(episode.robustness_bounds)],
        "robustness": float(episode.robustness),
        "success": bool(episode.success),
        "failure": episode.failure,
        "effort": float(episode.effort),
        "fallbacks": dict(episode.fallbacks),
        "solve_ms": compute_solve_times(1e3 * episode.solve_seconds),
        "plan": describe_plan(plan) if plan else None,
    }


def describe_plan(plan: Plan) -> dict[str, Any]:
    """Return a plan's fields; the version is that of a file of its own."""
    content: dict[str, Any] = json.loads(plan.to_json())
    del content["version"]
    return content


def _rounded(values: Any) -> Any:
    # Adding zero turns -0.0 into 0.0.
    return (np.round(np.asarray(values, dtype=float), DECIMALS) + 0.0).tolist()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
