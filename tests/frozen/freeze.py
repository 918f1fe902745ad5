"""Whole episodes of every shipped scenario, frozen: what must not change without a raised id.

`python -m tests.frozen.freeze [SCENARIO ...]` plays all of them, or those of some scenarios, and rewrites
`episodes.json`. It says which ids changed, and writes nothing if an id's episodes changed without its version: raise it
in `impact_envs/__init__.py` first. Plans are read from `plans/`; the command makes those that are missing.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from impact_envs import Episode, gym_id, list_scenarios, load_scenario, parallel_env, rollout
from impact_envs.errors import choices
from impact_envs.rollout import RandomPolicy
from planners import has_planner, list_variants, make_expert, make_plan
from planners.plan import Plan

FOLDER = Path(__file__).parent
FILE = FOLDER / "episodes.json"
PLANS = FOLDER / "plans"
SEEDS = (1, 2)  # of the training range
TOLERANCE = 1e-9  # of the sampled numbers, relative to 1 and to the number
SUITES = ("nominal", "all", "hard", "hard_v0")  # where a domain has them
UNPLANNED = {("crew", "hard_v0")}  # no plan is found within minutes: random actions only
PACKAGES = ("casadi", "clarabel", "daqp", "highspy", "llvmlite", "numba", "numpy", "pymunk", "scipy")

# Versions of the variants' episodes, which are no part of an id: raised when they change, and told in CHANGELOG.md.
VARIANTS = {"paper_expert": 4}

Case = tuple[str, str, str, int]  # scenario, suite, policy, seed


def list_cases(scenario: str) -> Iterator[Case]:
    """Yield what is played in a scenario."""
    variants = [name for name in list_variants(load_scenario(scenario)) if name in VARIANTS]
    known = load_scenario(scenario)._suites()
    for suite in (suite for suite in SUITES if suite in known):
        for policy in ("random", "expert", *variants):
            if policy == "random" or (scenario, suite) not in UNPLANNED:
                yield from ((scenario, suite, policy, seed) for seed in SEEDS)


def get_id(scenario: str, policy: str) -> str:
    """Return the id whose promise an episode is: the expert is inside the residual environment, variants are not."""
    if policy in VARIANTS:
        return f"{scenario} by {policy}-v{VARIANTS[policy]}"
    return gym_id(scenario, residual=policy != "random")


def read_fingerprint() -> dict[str, str]:
    """Return what the bits of an episode may depend on beside the code."""
    cpu = platform.processor()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), cpu)
    blas = {name: os.environ.get(name, "") for name in ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE")}
    system = {"python": platform.python_version(), "libc": "-".join(platform.libc_ver()), "cpu": cpu, **blas}
    return system | {name: version(name) for name in PACKAGES}


def get_plan(scenario: str, suite: str) -> Plan | None:
    """Return the frozen plan of a scenario in a suite; suites with the same task share it."""
    world = load_scenario(scenario).suite(suite)
    if not has_planner(world):
        return None
    shortened = world.horizon != load_scenario(scenario).horizon
    path = PLANS / f"{scenario}{'_hard' if shortened else ''}.json"
    if not path.exists():
        PLANS.mkdir(exist_ok=True)
        make_plan(world).save(path)
    return Plan.load(path)


class Recorded:
    """Keep every observation of an environment for `rollout`."""

    def __init__(self, env: Any) -> None:
        self._env, self.observations = env, list[dict[str, np.ndarray]]()
        self.unwrapped = self

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self, seed: int) -> Any:
        observations, infos = self._env.reset(seed=seed)
        self.observations = [observations]
        return observations, infos

    def step(self, actions: Any) -> Any:
        observations, *rest = self._env.step(actions)
        self.observations.append(observations)
        return observations, *rest


def play(case: Case) -> dict[str, Any]:
    """Play an episode and return its digest, its sampled numbers and how often the policy fell back."""
    scenario, suite, policy, seed = case
    world = load_scenario(scenario).suite(suite)
    env = Recorded(parallel_env(world))
    if policy == "random":
        actor: Any = RandomPolicy(env)
    else:
        actor = make_expert(world, get_plan(scenario, suite), None if policy == "expert" else policy)
    episode = rollout(env, actor, seed)
    return describe(episode, env.observations)


def describe(episode: Episode, observations: list[dict[str, np.ndarray]]) -> dict[str, Any]:
    """Return digest and sampled numbers of an episode.

    Args:
        episode: what happened.
        observations: agent to observation, after reset and after every step.

    Returns:
        ``digest`` of every float64 of the episode; ``numbers``: robustness, effort, number of impacts, sum of rewards,
        and values at evenly spaced places of signals (6), actions (5) and observations (5); ``fallbacks``.
    """
    signals = np.array([episode.signals[name] for name in sorted(episode.signals)]).T
    actions = np.concatenate([episode.actions[agent] for agent in episode.actions], axis=1)
    rewards = np.array(list(episode.rewards.values())).T
    seen = np.array([np.concatenate(list(sample.values())) for sample in observations])
    tables = [signals, actions, rewards, seen, episode.robustness_bounds, episode.robustness, episode.effort]
    digest = hashlib.sha256()
    for table in tables:
        digest.update(np.ascontiguousarray(table, dtype="<f8").tobytes())
    for hit in episode.impacts:
        values = (hit.time, *hit.point, *hit.normal, *hit.impulse, hit.speed)
        digest.update(f"{hit.a} {hit.b}".encode() + np.array(values, dtype="<f8").tobytes())
    sampled = [episode.robustness, episode.effort, len(episode.impacts), rewards.sum()]
    for table, count in ((signals, 6), (actions, 5), (seen, 5)):
        flat = table.ravel()
        places = [(index + 1) * (flat.size - 1) // count for index in range(count)]
        sampled += [flat[place] for place in places]
    numbers = [float(value) for value in sampled]
    return {
        "digest": digest.hexdigest(),
        "numbers": [value if math.isfinite(value) else str(value) for value in numbers],
        "fallbacks": dict(episode.fallbacks) | dict(episode.reoptimised),
    }


def find_difference(found: dict[str, Any], frozen: dict[str, Any], same_system: bool) -> str | None:
    """Return what is not as it was in an episode, or None."""
    for index, (new, old) in enumerate(zip(found["numbers"], frozen["numbers"], strict=True)):
        if new != old and not math.isclose(float(new), float(old), rel_tol=TOLERANCE, abs_tol=TOLERANCE):
            return f"number {index} is {new!r}, was {old!r}"
    if same_system and found["digest"] != frozen["digest"]:
        return "the sampled numbers agree, the digest does not"
    return None


def read() -> dict[str, Any]:
    """Return the frozen episodes: fingerprint, and id to case to episode."""
    if not FILE.exists():
        return {"fingerprint": {}, "episodes": {}}
    return json.loads(FILE.read_text(encoding="utf-8"))


def label(case: Case) -> str:
    """Return what a case is called within its id."""
    return " ".join(map(str, case[1:]))


def write(episodes: dict[str, dict[str, Any]], fingerprint: dict[str, str]) -> None:
    """Write the file, one line an episode."""
    blocks = []
    for name in sorted(episodes):
        lines = [f"   {json.dumps(key)}: {json.dumps(episodes[name][key])}" for key in sorted(episodes[name])]
        blocks.append(f"  {json.dumps(name)}: {{\n" + ",\n".join(lines) + "\n  }")
    head = f'{{"fingerprint": {json.dumps(fingerprint)},\n "episodes": {{\n'
    FILE.write_text(head + ",\n".join(blocks) + "\n}}\n", encoding="utf-8")


def keep(old: dict[str, dict[str, Any]], scenarios: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the frozen episodes of scenarios that are not played anew, of the present versions."""
    kept = {get_id(*case[::2]): {} for name in list_scenarios() if name not in scenarios for case in list_cases(name)}
    return {name: old[name] for name in kept if name in old}


def is_same_system(recorded: dict[str, str]) -> bool:
    """Return whether bits must agree with recorded ones: with the same libraries, on whatever processor of a kind."""
    return all(recorded.get(name) == value for name, value in read_fingerprint().items() if name != "cpu")


def main(chosen: Sequence[str]) -> int:
    """Play all or chosen scenarios, say what changed, and write the file unless an id changed without its version."""
    scenarios = [name for name in list_scenarios() if not chosen or name in chosen]
    old, changed = read(), dict[str, str]()
    same_system = is_same_system(old["fingerprint"])
    if unknown := sorted({*chosen} - {*scenarios}):
        print(f"no scenario: {', '.join(unknown)}; {choices(unknown[0], list_scenarios())}", file=sys.stderr)
        return 2
    if chosen and not same_system:
        print("the other episodes were frozen with other libraries: play all", file=sys.stderr)
        return 2
    episodes = keep(old["episodes"], scenarios)
    for scenario in scenarios:
        for case in list_cases(scenario):
            name, key = get_id(scenario, case[2]), label(case)
            found = episodes.setdefault(name, {})[key] = play(case)
            frozen = old["episodes"].get(name, {}).get(key)
            difference = find_difference(found, frozen, same_system) if frozen else None
            print(f"{name} {key}: {difference or ('as it was' if frozen else 'new')}", flush=True)
            if difference:
                changed.setdefault(name, f"{key}: {difference}")
    for name in sorted({*old["episodes"]} - {*episodes}):
        print(f"{name}: gone")
    for name, difference in changed.items():
        print(f"{name} changed ({difference}): raise its version in impact_envs/__init__.py", file=sys.stderr)
    if not changed:
        write(episodes, old["fingerprint"] if chosen else read_fingerprint())
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
