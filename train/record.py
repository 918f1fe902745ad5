"""What an evaluation keeps of an episode: a tidy row, a replay, and the journal to go on from."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterable
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from agents.checkpoint import write_atomically
from impact_envs.errors import InputError
from impact_envs.rollout import Episode
from impact_envs.shape import Shape
from planners.plan import Plan
from train.metrics import compute_solve_times

DECIMALS = 5
PACKAGES = (
    "numpy",
    "scipy",
    "pymunk",
    "gymnasium",
    "pettingzoo",
    "casadi",
    "cvxpy",
    "daqp",
    "torch",
    "stable-baselines3",
)


def read_versions() -> dict[str, str]:
    """Return the versions of the packages that results depend on, as far as they are installed."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def make_row(episode: Episode, suite: str, policy: str) -> dict[str, Any]:
    """Return an episode's tidy row.

    Args:
        episode: what happened.
        suite: mismatch suite it was played in.
        policy: label of the policy.

    Returns:
        One JSON object; ``fallback_kinds`` is JSON text, ``solve_ms`` the list of all solve times [ms].
    """
    solve_ms = [round(1e3 * float(seconds), 3) for seconds in episode.solve_seconds]
    percentiles = compute_solve_times(solve_ms)
    return {
        "scenario": episode.scenario,
        "suite": suite,
        "policy": policy,
        "seed": episode.seed,
        "success": bool(episode.success),
        "robustness": float(episode.robustness),
        "effort": float(episode.effort),
        "impacts": len(episode.impacts),
        "steps": len(episode.times) - 1,
        "replans": int(episode.replans),
        "fallbacks": int(sum(episode.fallbacks.values())),
        "fallback_kinds": json.dumps(dict(sorted(episode.fallbacks.items()))),
        **{f"solve_ms_{name}": value for name, value in percentiles.items()},
        "solve_ms": solve_ms,
        "wall_seconds": episode.wall_seconds,
    }


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
        "links": _describe_links(scenario),
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
        "effort": float(episode.effort),
        "fallbacks": dict(episode.fallbacks),
        "solve_ms": compute_solve_times(1e3 * episode.solve_seconds),
        "plan": json.loads(plan.to_json()) if plan else None,
    }


class Journal:
    """Finished episodes, one JSON line each, so that an interrupted evaluation goes on where it stopped.

    Args:
        directory: folder of the evaluation, made if missing.
        digests: name of an input (scenario in a suite, checkpoint) to the digest of its content.

    Raises:
        InputError: the folder holds an evaluation of other inputs, or is damaged.
    """

    def __init__(self, directory: str | Path, digests: dict[str, str]) -> None:
        self.directory = Path(directory)
        self._path = self.directory / "rows.jsonl"
        self.manifest = self._read_manifest()
        known = self.manifest.get("digests", {})
        for name, digest in digests.items():
            if known.get(name, digest) != digest:
                raise InputError(
                    f"{self.directory}: holds episodes of another '{name}'; choose another output directory"
                )
        self.manifest["digests"] = known | digests
        self.rows = self._read_rows()

    def write_manifest(self, request: dict[str, Any]) -> None:
        """Write what was asked into manifest.json.

        Args:
            request: the evaluation's arguments.
        """
        self.manifest |= {"format": 1, **request, "versions": read_versions(), "cores": os.cpu_count() or 1}
        write_json(self.directory / "manifest.json", self.manifest)

    def append(self, row: dict[str, Any], replay: dict[str, Any] | None) -> None:
        """Write a finished episode to disk; its replay first, so that no row lacks the one it should have.

        Args:
            row: what make_row returned.
            replay: what episode_to_dict returned, if it is to be kept.
        """
        if replay:
            label = "".join(c if c.isalnum() or c in "-_" else "_" for c in row["policy"])
            name = f"{row['scenario']}__{row['suite']}__{label}__{row['seed']}.json"
            write_json(self.directory / "replays" / name, replay | {"policy": row["policy"]})
        self.rows[row_key(row)] = row
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, allow_nan=False) + "\n")

    def _read_manifest(self) -> dict[str, Any]:
        path = self.directory / "manifest.json"
        if not path.exists():
            if self._path.exists():
                raise InputError(f"{self.directory}: has rows.jsonl but no manifest.json")
            return {}
        try:
            manifest = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from None
        if not isinstance(manifest, dict) or manifest.get("format") != 1:
            raise InputError(f"{path}: not the manifest of an evaluation of format 1")
        return manifest

    def _read_rows(self) -> dict[tuple[str, str, str, int], dict[str, Any]]:
        """Read the journal; a last line cut by a kill is dropped, also from the file."""
        if not self._path.exists():
            return {}
        *lines, tail = self._path.read_bytes().split(b"\n")
        if tail:
            write_atomically(self._path, b"".join(line + b"\n" for line in lines))
        rows = {}
        for number, line in enumerate(lines, start=1):
            try:
                row = json.loads(line)
                rows[row_key(row)] = row
            except (ValueError, KeyError, TypeError):
                raise InputError(f"{self._path}: line {number} is not an episode") from None
        return rows


def row_key(row: dict[str, Any]) -> tuple[str, str, str, int]:
    """Return what an episode is told apart by: scenario, suite, policy, seed."""
    return row["scenario"], row["suite"], row["policy"], row["seed"]


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file, all or nothing; what JSON cannot say (NaN, infinity) is refused.

    Args:
        path: file to write.
        value: a JSON value.
    """
    write_atomically(path, (json.dumps(value, allow_nan=False) + "\n").encode())


def digest(*contents: bytes) -> str:
    """Return the SHA-256 of some contents, in hexadecimal."""
    return hashlib.sha256(b"".join(contents)).hexdigest()


def _describe_links(scenario: Any) -> dict[str, Any]:
    """Return what places the joints of an arm by the pose of its pad; empty where there are no arms."""
    if scenario.domain != "dual_arm":
        return {}
    lengths = list(scenario.links.lengths)
    return {n: {"base": list(arm.base), "lengths": lengths, "elbow": arm.elbow} for n, arm in scenario.arms.items()}


def _rounded(values: Any) -> Any:
    # Adding zero turns -0.0 into 0.0.
    return (np.round(np.asarray(values, dtype=float), DECIMALS) + 0.0).tolist()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
