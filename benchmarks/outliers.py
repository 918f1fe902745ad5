"""Play the experts with impossible readings: 20 kinds of wrong sensors, each on the same seeds as with right ones.

    OMP_NUM_THREADS=1 python benchmarks/outliers.py --seeds 20 --out outliers.json

Every kind spoils readings from a period that the seed chooses, in the middle half of the episode. A row says how many
episodes succeed, and how often the expert rejected a reading or took its estimate up again. Ctrl-C prints what is
played.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from impact_envs import load_scenario, parallel_env, vector_env
from impact_envs.dual_arm.observation import ARM
from impact_envs.env import ImpactEnv
from impact_envs.errors import InputError
from impact_envs.observation import Layout
from planners import has_planner, make_expert, make_expert_batch, make_plan
from train.watch import exit_codes

FIRST_SEED = 1_500_000
# Fields of observations: places and angles, their rates, directions (cos, sin), by the last word of an element.
RATES = ("vx", "vy", "omega", "dpsi/dt", "rate", "q1'", "q2'", "q3'")
DIRECTIONS = ("cos", "sin")
NO_NUMBERS = "acts by no numbers"
SHARED = ("contact", "time", "robustness", "forces")


@dataclass(frozen=True)
class Sensors:
    """What stands where in a reading.

    Attributes:
        places, rates, directions: indices of coordinates, of their rates, and of cos and sin of headings.
        parts: slices of the bodies, which have the same fields.
        clock: index of the time.
        target: index of x of the first object, of the base, or of the first joint.
    """

    places: np.ndarray
    rates: np.ndarray
    directions: np.ndarray
    parts: Sequence[slice]
    clock: int
    target: int


@dataclass(frozen=True)
class Kind:
    """A kind of wrong readings.

    Attributes:
        spoil: takes reading, sensors, the readings so far and a generator, and returns what is read instead.
        periods: how many in a row.
        begin: share of the episode at which it begins, None: the seed chooses.
        share: of these periods that are spoiled.
    """

    spoil: Callable[[np.ndarray, Sensors, list[np.ndarray], np.random.Generator], np.ndarray]
    periods: int
    begin: float | None = None
    share: float = 1.0


def _add(name: str, size: float, which: int = 0) -> Callable[..., np.ndarray]:
    def spoil(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
        reading[getattr(sensors, name)[which]] += size
        return reading

    return spoil


def _move(size: float) -> Callable[..., np.ndarray]:
    def spoil(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
        reading[sensors.target] += size
        return reading

    return spoil


def _fill(value: float) -> Callable[..., np.ndarray]:
    def spoil(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
        return np.full_like(reading, value)

    return spoil


def _set(name: str, value: float) -> Callable[..., np.ndarray]:
    def spoil(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
        reading[getattr(sensors, name)] = value
        return reading

    return spoil


def _freeze(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    return past[-1].copy()


def _negate(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    return -reading


def _turn_round(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    reading[sensors.directions] *= -1.0
    return reading


def _jump(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    reading[sensors.places] += 3.0 * rng.standard_normal(len(sensors.places))
    return reading


def _swap(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    first, last = sensors.parts[0], sensors.parts[-1]
    reading[first], reading[last] = reading[last].copy(), reading[first].copy()
    return reading


def _scramble(reading: np.ndarray, sensors: Sensors, past: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    return 1e3 * rng.standard_normal(len(reading))


KINDS = {
    "right": Kind(_add("places", 0.0), 0),
    "0.1 m off, 2 periods": Kind(_move(0.1), 2),
    "0.3 m off, 2 periods": Kind(_move(0.3), 2),
    "1 m off, once": Kind(_move(1.0), 1),
    "10 m off, 2 periods": Kind(_move(10.0), 2),
    "1,000 m off, 2 periods": Kind(_move(1e3), 2),
    "1e154, once": Kind(_move(1e154), 1),
    "1 m off, 20 periods": Kind(_move(1.0), 20),
    "first coordinate 2 m off, 10 periods": Kind(_add("places", 2.0), 10),
    "first rate 5 off, 10 periods": Kind(_add("rates", 5.0), 10),
    "zeros, 20 periods": Kind(_fill(0.0), 20),
    "NaN, 20 periods": Kind(_fill(np.nan), 20),
    "infinite, 20 periods": Kind(_fill(np.inf), 20),
    "frozen, 20 periods": Kind(_freeze, 20),
    "signs flipped, 10 periods": Kind(_negate, 10),
    "turned round, 10 periods": Kind(_turn_round, 10),
    "jumps of 3 m, 10 periods": Kind(_jump, 10),
    "jumps of 3 m, 3 % of all": Kind(_jump, 10**9, 0.0, 0.03),
    "bodies swapped, 10 periods": Kind(_swap, 10),
    "clock at 1e154, 10 periods": Kind(_set("clock", 1e154), 10),
    "all scrambled, 20 periods, late": Kind(_scramble, 20, 0.8),
}


def find_sensors(layout: Layout, parts: Sequence[slice], objects: Collection[str]) -> Sensors:
    """Return what stands where in readings of a layout."""
    found: dict[str, list[int]] = {"places": [], "rates": [], "directions": []}
    for name, elements in layout.fields.items():
        for j, element in enumerate(elements):
            if name.split()[-1] in SHARED:
                continue
            word = element.split("(")[0].split()[0]
            key = "directions" if word in DIRECTIONS else "rates" if word in RATES else "places"
            found[key].append(layout[name].start + j)
    places, rates, directions = (np.array(indices) for indices in found.values())
    target = layout[next(iter(objects))].start if objects else int(places[0])
    return Sensors(places, rates, directions, parts, layout["time"].start, target)


class Spoiler:
    """Spoil one world's readings by a kind."""

    def __init__(self, kind: Kind, sensors: Sensors, periods: int, seed: int) -> None:
        self._kind, self._sensors, self._rng = kind, sensors, np.random.default_rng([seed, 77])
        share = self._rng.uniform(0.1, 0.6) if kind.begin is None else kind.begin
        self._begin, self._k = max(1, int(share * periods)), 0
        self._past: list[np.ndarray] = []

    def spoil(self, reading: np.ndarray) -> np.ndarray:
        """Return what is read instead in this period."""
        now = self._begin <= self._k < self._begin + self._kind.periods and self._rng.random() < self._kind.share
        self._k += 1
        if not now:
            self._past = [reading]
            return reading
        return self._kind.spoil(reading.copy(), self._sensors, self._past, self._rng)


def play_batch(scenario: Any, plan: Any, kind: Kind, seeds: int) -> tuple[int, Counter[str]]:
    """Play free-flyers, all seeds at once; return the successes and what was counted."""
    worlds, experts = vector_env(scenario, num_envs=seeds, threads=1), make_expert_batch(scenario, seeds, plan)
    layout = parallel_env(scenario).task.joint_layout
    sensors = find_sensors(layout, [layout[name] for name in scenario.bodies], scenario.objects)
    spoilers = [Spoiler(kind, sensors, scenario.steps, FIRST_SEED + k) for k in range(seeds)]
    joint, _ = worlds.reset(seed=FIRST_SEED)
    infos: Mapping[str, Any] = {}
    mad = 0
    for _ in range(scenario.steps):
        read = np.array([spoiler.spoil(row) for spoiler, row in zip(spoilers, joint, strict=True)])
        actions = experts.act(read)
        mad += int((~np.isfinite(actions)).any(axis=1).sum())
        joint, _, _, _, infos = worlds.step(np.nan_to_num(actions))
    counts = Counter({name: int(values.sum()) for name, values in experts.counts.items() if values.sum()})
    return int(infos["success"].sum()), counts + Counter({NO_NUMBERS: mad})


def play_single(env: ImpactEnv, expert: Any, kind: Kind, seed: int) -> tuple[bool, Counter[str]]:
    """Play one episode of one world; return whether it succeeded, and what was counted."""
    layout, scenario = env.task.joint_layout, env.scenario
    arms = getattr(scenario, "arms", None)
    fields = [f"{arm} {name}" for arm in arms for name in ARM.fields] if arms else []
    half = len(fields) // 2
    parts = [fields[:half], fields[half:]] if arms else [["joints"], ["joint_rates"]]
    spans = [slice(layout[part[0]].start, layout[part[-1]].stop) for part in parts]
    spoiler = Spoiler(kind, find_sensors(layout, spans, ()), scenario.steps, seed)
    env.reset(seed=seed)
    expert.reset(seed)
    infos: Mapping[str, Any] = {}
    mad = 0
    while env.agents:
        read = spoiler.spoil(env.task.observe_jointly(env.time, env.conjuncts))
        if arms:
            first, second, clock = read[spans[0]], read[spans[1]], read[layout["time"]]
            pairs = ((first, second), (second, first))
            seen = {arm: np.concatenate([*pair, clock]) for arm, pair in zip(arms, pairs, strict=True)}
        else:
            seen = {agent: read.copy() for agent in env.agents}
        actions = expert.act(seen)
        mad += not all(np.isfinite(action).all() for action in actions.values())
        _, _, _, _, infos = env.step({name: np.nan_to_num(action) for name, action in actions.items()})
    counts = Counter(expert.diagnostics().fallbacks) + Counter({NO_NUMBERS: mad})
    return bool(next(iter(infos.values()))["success"]), counts


@dataclass
class Args:
    """Play the experts with impossible readings."""

    scenarios: tuple[str, ...] = ("corridor:all", "floating_manipulator_thrusters:nominal", "dual_arm_grasp:nominal")
    """Scenario and suite."""
    seeds: int = 20
    """Of free-flyers."""
    few: int = 3
    """Seeds of the other domains, whose worlds are played one by one."""
    kinds: tuple[str, ...] = tuple(KINDS)
    """What is played."""
    out: Path | None = None
    """Write the rows here as JSON."""


def main(args: Args) -> list[dict[str, Any]]:
    """Play, print the table and return its rows."""
    rows: list[dict[str, Any]] = []
    try:
        for text in args.scenarios:
            name, _, suite = text.partition(":")
            play_scenario(args, name, suite or "nominal", rows)
    except KeyboardInterrupt:
        print(f"stopped after {len(rows)} rows", file=sys.stderr)
    table = Table(box=box.MARKDOWN)
    for column in ("scenario", "readings", "success", "counted"):
        table.add_column(column, no_wrap=True)
    for row in rows:
        counted = ", ".join(f"{key} {value}" for key, value in row["counted"].items())
        table.add_row(row["scenario"], row["kind"], f"{row['success']} of {row['episodes']}", counted)
    Console(width=180).print(table)
    if args.out:
        args.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return rows


def play_scenario(args: Args, name: str, suite: str, rows: list[dict[str, Any]]) -> None:
    """Play all kinds in a scenario, and append a row for each."""
    scenario = load_scenario(name).suite(suite)
    plan = make_plan(scenario) if has_planner(scenario) else None
    env, expert = (None, None) if plan else (parallel_env(scenario), make_expert(scenario))
    for kind in args.kinds:
        if kind not in KINDS:
            raise InputError(f"kind '{kind}' is unknown; choices: {', '.join(KINDS)}")
        if plan:
            success, counts = play_batch(scenario, plan, KINDS[kind], args.seeds)
        else:
            episodes = [play_single(env, expert, KINDS[kind], FIRST_SEED + k) for k in range(args.few)]
            success, counts = sum(won for won, _ in episodes), sum((c for _, c in episodes), Counter())
        episodes_played = args.seeds if plan else args.few
        row = {"scenario": f"{name}:{suite}", "kind": kind, "success": success, "episodes": episodes_played}
        rows.append(row | {"counted": dict(counts)})


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))
