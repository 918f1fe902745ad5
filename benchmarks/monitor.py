"""Time the online monitor: formulas with operators inside operators beside a flat one, in one run, taking turns.

    python benchmarks/monitor.py --worlds 1024 --out monitor.json

One world is a ``Monitor`` called from Python, many are the compiled function called in a loop over worlds, as the
environments' batched step does. The sample is the position of one body, the formulas look equally far ahead. Times are
CPU time of the thread, which says more on a busy machine.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from impact_envs.errors import InputError
from impact_envs.stl import Monitor, Trace, parse, robustness
from impact_envs.stl.compiler import compile_formula
from impact_envs.stl.stepper import start_monitor, update_monitor
from train.watch import exit_codes

PERIOD, LIMIT = 0.1, 3.0  # between samples [s]; of both coordinates [m]
FORMULAS = {
    "flat": "G[0,35] pop in goal",
    "flat until": "pop in wide U[0,35] pop in goal",
    "nested twice": "G[0,25] F[0,10] pop in goal",
    "nested three times": "G[0,20] F[0,10] G[0,5] pop in goal",
    "reach and stay": "F[0,25] (pop in wide & G[0,10] pop in goal)",
    "response": "G[0,25] (pop in wide -> F[0,10] pop in goal)",
    "until inside": "G[0,25] (pop in wide U[0,10] pop in goal)",
    "late until inside": "G[0,25] (pop in wide U[3,10] pop in goal)",
    "until reach and stay": "pop in wide U[0,25] G[0,10] pop in goal",
    "two responses": "G[0,25] (pop in wide -> F[0,10] pop in goal & G[0,5] pop in wide)",
    "two inside": "F[0,25] (G[0,5] pop in wide & F[0,10] pop in goal)",
    "sequence": "F[0,20] (pop in wide & F[0,10] (pop in goal & F[0,5] pop in wide))",
    "nested four times": "F[0,15] G[0,5] F[0,10] G[0,5] pop in goal",
}
SIGNALS = ("pop.x", "pop.y")
BOUNDS = dict.fromkeys(SIGNALS, (-LIMIT, LIMIT))


@dataclass
class Args:
    """Time the online monitor."""

    worlds: int = 1024
    """Worlds of the batch."""
    repeats: int = 20
    """Rounds over all formulas; the fastest counts."""
    out: Path | None = None
    """JSON file for the rows."""


@dataclass(frozen=True)
class Square:
    """The square |x| <= half, |y| <= half."""

    half: float

    def halfspaces(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]), np.full(4, self.half)


AREAS = {"goal": Square(1.0), "wide": Square(2.0)}


@numba.njit
def follow(formula: Any, memory: Any, samples: Any, ends: Any) -> None:
    """Follow the formula in all worlds, samples of shape (T, worlds, signals)."""
    for k in range(memory.shape[0]):
        start_monitor(formula, memory, k)
    for count in range(samples.shape[0]):
        for k in range(memory.shape[0]):
            ends[k, 0], ends[k, 1] = update_monitor(formula, memory, k, count, samples[count])


class Case:
    """A formula and samples it can be followed on."""

    def __init__(self, text: str, worlds: int) -> None:
        self.formula = parse(text)
        self.count = self.formula.reach(PERIOD) + 1
        rng, times = np.random.default_rng(0), PERIOD * np.arange(self.count)
        phases = rng.uniform(0.3, 1.5, (worlds, 2)) * times[:, None, None] + rng.uniform(0.0, 6.3, (worlds, 2))
        self.samples = 0.7 * LIMIT * np.sin(phases)
        self.monitor = Monitor(self.formula, PERIOD, AREAS, ("pop",), BOUNDS)
        self.dictionaries = [dict(zip(SIGNALS, sample, strict=True)) for sample in self.samples[:, 0].tolist()]
        self.compiled = compile_formula(self.formula, PERIOD, AREAS, ("pop",), SIGNALS, BOUNDS)
        self.memory, self.ends = np.zeros((worlds, self.compiled.size)), np.zeros((worlds, 2))

    def follow_one(self) -> None:
        self.monitor.reset()
        for sample in self.dictionaries:
            self.monitor.update(sample)

    def follow_all(self) -> None:
        follow(self.compiled, self.memory, self.samples, self.ends)

    def check(self) -> None:
        """Raise unless both doors ended at the robustness of the whole trace."""
        trace = Trace(dict(zip(SIGNALS, np.moveaxis(self.samples, 0, -1).swapaxes(0, 1), strict=True)), PERIOD, AREAS)
        rho = robustness(self.formula, trace)
        if self.monitor.interval != (rho[0], rho[0]) or not (self.ends == rho[:, None]).all():
            raise InputError(f"'{self.formula}' does not end at its robustness")


def measure(run: Callable[[], None]) -> float:
    start = time.thread_time()
    run()
    return time.thread_time() - start


def main(args: Args) -> list[dict[str, Any]]:
    """Print and return a row per formula."""
    cases = {name: Case(text, args.worlds) for name, text in FORMULAS.items()}
    one, many = (dict.fromkeys(cases, np.inf) for _ in range(2))
    for _ in range(args.repeats + 1):  # the first round compiles
        for name, case in cases.items():
            one[name] = min(one[name], measure(case.follow_one) / case.count)
            many[name] = min(many[name], measure(case.follow_all) / case.count / args.worlds)
            case.check()
    rows = [
        {
            "": name,
            "formula": FORMULAS[name],
            "one world [us]": f"{1e6 * one[name]:.2f}",
            "ratio": f"{one[name] / one['flat']:.2f}",
            f"{args.worlds} worlds [ns each]": f"{1e9 * many[name]:.1f}",
            "ratio of many": f"{many[name] / many['flat']:.2f}",
            "numbers per world": case.compiled.size,
        }
        for name, case in cases.items()
    ]
    table = Table(*rows[0], title="online monitor: time per sample")
    for row in rows:
        table.add_row(*map(str, row.values()))
    Console(width=160).print(table)
    if args.out:
        args.out.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    return rows


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))
