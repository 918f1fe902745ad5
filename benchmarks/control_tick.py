"""Time two arms' control: a tick beside the same programs by other solvers, and whole episodes; one run, one thread.

    OMP_NUM_THREADS=1 python benchmarks/control_tick.py --repeats 5 --out control_tick.json

OSQP's own rows need the package osqp, which cvxpy brings along; without it they are left out with a note.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
import tyro
from scipy import sparse

from impact_envs import parallel_env, rollout, vector_env
from impact_envs.dual_arm.model import DualArmModel
from impact_envs.dual_arm.plant import NORMAL
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.errors import InputError
from impact_envs.scenario import load_scenario
from planners import make_expert, make_expert_batch
from planners.dual_arm.dense_qp import COMPILED, get_solver
from planners.dual_arm.expert import DualArmExpert
from planners.dual_arm.reference_spreading import ReferenceSpreading
from planners.dual_arm.torque_qp import EQUALITIES, FREE, GRASP, QDD, TorqueQP, make_torque_qp
from train.watch import exit_codes

TOLERANCE, MOST_ITERATIONS = 1e-6, 20_000  # of OSQP, absolute and relative
OURS = "ours"
SEED = 1_000_000  # of the episodes, among those for tuning
SHORT = 5  # the interim phase is short, its programs are solved more often: a tick just after them finds cold caches
PHASES = ("ante", "interim", "post")
NOTES = """\
ours: the whole control tick, from measured joints and forces to torques: phases, dynamics, references, program, solver.
others: the program that this tick assembled, handed over and solved; its assembly, and for cvxpy the Cholesky factor of
  H, are not timed. cvxpy is parametrised (DPP) and compiled once; OSQP has tolerance 1e-6, Clarabel its own.
times: CPU time of the thread, which says more on a busy machine; wall beside it.
off: greatest difference of a torque from ours.
episodes: physics, observations, robustness and expert from reset to the end; CPU time of one world's episode, the least
  of the repeats; realtime: the horizon over that."""

Tick = tuple[np.ndarray, np.ndarray, np.ndarray]  # joint angles and rates, forces
Shape = tuple[int, int]  # of a program
Pattern = tuple[np.ndarray, np.ndarray]  # where H and A are not zero
Peer = Callable[[TorqueQP], Callable[[], np.ndarray]]


@dataclass
class Args:
    """Time a control tick and its peers."""

    scenario: str = "dual_arm_grasp"
    """Shipped name or TOML file."""
    repeats: int = 5
    """Times that the episode is controlled again."""
    every: int = 20
    """The peers solve the program of every so many ticks; in the interim phase of every fifth."""
    worlds: int = 32
    """Worlds of the batch whose episodes are timed."""
    out: Path | None = None
    """Write every measurement here as JSON."""


@dataclass
class Times:
    """Hold what one method took in one phase.

    Attributes:
        cpu, wall: of every call [s].
        off: greatest difference of a torque from ours [N m].
        failures: calls without a solution.
    """

    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)
    off: float = 0.0
    failures: int = 0


def main(args: Args) -> list[dict[str, str]]:
    """Measure, print the table as Markdown, and return its rows."""
    for name, value in (("repeats", args.repeats), ("every", args.every), ("worlds", args.worlds)):
        if value < 1:
            raise InputError(f"{name} {value} is too small; choices: 1, 2, ...")
    scenario = load_scenario(args.scenario)
    if not isinstance(scenario, DualArmScenario):
        raise InputError(f"{args.scenario}: domain {scenario.domain} has no such tick; choices: dual_arm")
    machine, controller = describe_machine(), DualArmExpert(scenario).controller
    ticks, patterns = record_ticks(scenario, controller)
    peers = {shape: make_peers(shape, pattern, scenario) for shape, pattern in patterns.items()}
    found: dict[tuple[str, str], Times] = {}
    episodes: dict[str, list[float]] = {}
    try:
        measure(controller, ticks, peers, args.every, {})  # compiles everything
        for _ in range(args.repeats):
            measure(controller, ticks, peers, args.every, found)
            time_episodes(scenario, args.worlds, episodes)
    except KeyboardInterrupt:
        print("stopped early", file=sys.stderr)
    rows = make_rows(found)
    print(", ".join(f"{key} {value}" for key, value in machine.items()), end="\n\n")
    print(format_table(rows), format_table(make_episode_rows(episodes, scenario.horizon)), NOTES, sep="\n\n")
    if not find_spec("osqp"):
        print("left out: OSQP, not installed (pip install osqp)")
    if args.out:
        times = [{"phase": phase, "method": method, **asdict(t)} for (phase, method), t in found.items()]
        record = {"machine": machine, "args": asdict(args), "rows": rows, "times": times, "episodes": episodes}
        args.out.write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")
    return rows


def describe_machine() -> dict[str, str]:
    """Return what times depend on, the load average before the start among it."""
    packages = [name for name in ("numpy", "daqp", "cvxpy", "clarabel", "osqp") if find_spec(name)]
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": str(os.cpu_count()),
        "load": "/".join(f"{load:.1f}" for load in os.getloadavg()),
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "unset"),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def record_ticks(scenario: DualArmScenario, controller: ReferenceSpreading) -> tuple[list[Tick], dict[Shape, Pattern]]:
    """Play the scenario once.

    Returns:
        What the controller measured in every tick, and where H and A of any program were not zero, by shape.
    """
    model = DualArmModel(scenario)
    model.reset(scenario.draw(np.random.default_rng(0)))
    controller.reset()
    ticks: list[Tick] = []
    patterns: dict[Shape, Pattern] = {(n, m): (np.eye(n) > 0.0, np.zeros((m, n)) > 0.0) for n, m in (FREE, GRASP)}
    for _ in range(round(scenario.horizon / scenario.tick)):
        ticks.append((*model.joints(), model.contacts()[:4, NORMAL]))
        model.tick(controller.control(*ticks[-1]))
        program = controller.qp
        for mask, matrix in zip(patterns[program.A.shape[::-1]], (program.H, program.A), strict=True):
            mask |= matrix != 0.0
    return ticks, patterns


def measure(
    controller: ReferenceSpreading,
    ticks: list[Tick],
    peers: dict[Shape, dict[str, Peer]],
    every: int,
    found: dict[tuple[str, str], Times],
) -> None:
    """Control the recorded ticks again, and let the peers solve some programs as soon as they are there.

    Args:
        controller: is reset.
        ticks: what it measures.
        peers: shape of a program to method to who solves it.
        every: see Args.
        found: phase and method to times, added to.
    """
    solve = get_solver()
    controller.reset()
    for k, (q, v, forces) in enumerate(ticks):
        before = time.thread_time(), time.perf_counter()
        controller.control(q, v, forces)
        after = time.thread_time(), time.perf_counter()
        _add(found, controller.phase, OURS, before, after, 0.0)
        if k % (SHORT if controller.phase == "interim" else every):
            continue
        program = controller.qp
        torques = solve(program)[:QDD]
        for method, peer in peers[program.A.shape[::-1]].items():
            hand_over = peer(program)
            before = time.thread_time(), time.perf_counter()
            x = hand_over()
            after = time.thread_time(), time.perf_counter()
            _add(found, controller.phase, method, before, after, float(np.abs(x[:QDD] - torques).max()))


def _add(
    found: dict[tuple[str, str], Times],
    phase: str,
    method: str,
    before: tuple[float, float],
    after: tuple[float, float],
    off: float,
) -> None:
    times = found.setdefault((phase, method), Times())
    if not np.isfinite(off):
        times.failures += 1
        return
    times.cpu.append(after[0] - before[0])
    times.wall.append(after[1] - before[1])
    times.off = max(times.off, off)


def make_peers(shape: Shape, pattern: Pattern, scenario: DualArmScenario) -> dict[str, Peer]:
    """Return what solves programs of a shape, by method; each takes a program and returns what is to be timed."""
    limits = np.array([scenario.links.torque_limits] * 2, dtype=float)
    peers: dict[str, Peer] = {name: make_direct(name) for name in (COMPILED, "daqp")}
    peers["cvxpy, Clarabel"] = make_cvxpy(shape, limits, "CLARABEL", {})
    if find_spec("osqp"):
        options = {"eps_abs": TOLERANCE, "eps_rel": TOLERANCE, "max_iter": MOST_ITERATIONS}
        peers["cvxpy, OSQP"] = make_cvxpy(shape, limits, "OSQP", options)
        peers["OSQP"] = make_osqp(shape, pattern, limits)
    return peers


def make_direct(name: str) -> Peer:
    """Return one of our own solvers, called from Python as it is for inspection."""
    solve = get_solver(name)
    return lambda program: lambda: solve(program)


def make_cvxpy(shape: Shape, limits: np.ndarray, solver: str, options: dict[str, Any]) -> Peer:
    """Return who fills the parameters of one cvxpy problem and solves it.

    With H = F' F the cost is |F x - g|^2 / 2, F' g = -f, so that the problem is disciplined in its parameters.
    """
    (n, m), equal = shape, EQUALITIES[shape]
    x, F, g = cp.Variable(n), cp.Parameter((n, n)), cp.Parameter(n)
    A, b = cp.Parameter((equal, n)), cp.Parameter(equal)
    constraints = [A @ x == b, x[:QDD] <= limits.ravel(), x[:QDD] >= -limits.ravel()]
    C = cp.Parameter((max(m - equal, 1), n))
    if m > equal:
        constraints.append(C @ x >= 0.0)
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(F @ x - g)), constraints)

    def hand_over(program: TorqueQP) -> Callable[[], np.ndarray]:
        factor = np.linalg.cholesky(program.H).T
        center = np.linalg.solve(factor.T, -program.f)

        def solve() -> np.ndarray:
            F.value, g.value = factor, center
            A.value, b.value = program.A[:equal], program.upper[QDD : QDD + equal]
            if m > equal:
                C.value = program.A[equal:]
            problem.solve(solver=solver, **options)
            return np.full(n, np.nan) if x.value is None else np.array(x.value)

        return solve

    return hand_over


def make_osqp(shape: Shape, pattern: Pattern, limits: np.ndarray) -> Peer:
    """Return who updates the numbers of one OSQP problem, with the zeros that never change left out, and solves it."""
    osqp = import_module("osqp")  # has no types
    n, first = shape[0], make_torque_qp(shape, limits)
    above = sparse.csc_matrix(np.triu(pattern[0]).astype(float))
    rows = sparse.csc_matrix(np.vstack([np.eye(QDD, n), pattern[1].astype(float)]))
    (i, j), (row, column) = (_list_entries(matrix) for matrix in (above, rows))
    solver = osqp.OSQP()
    solver.setup(
        P=above,
        q=np.zeros(n),
        A=rows,
        l=first.lower,
        u=first.upper,
        eps_abs=TOLERANCE,
        eps_rel=TOLERANCE,
        max_iter=MOST_ITERATIONS,
        verbose=False,
    )

    def hand_over(program: TorqueQP) -> Callable[[], np.ndarray]:
        Px, Ax = program.H[i, j].copy(), np.vstack([np.eye(QDD, n), program.A])[row, column]

        def solve() -> np.ndarray:
            solver.update(Px=Px, Ax=Ax, q=program.f, l=program.lower, u=program.upper)
            result = solver.solve(raise_error=False)
            return np.array(result.x) if result.info.status_val == 1 else np.full(n, np.nan)

        return solve

    return hand_over


def _list_entries(matrix: sparse.csc_matrix) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the entries in the order in which they are stored."""
    return matrix.indices.copy(), np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))


def time_episodes(scenario: DualArmScenario, worlds: int, found: dict[str, list[float]]) -> None:
    """Play episodes in one environment, in a vector environment of one world, and in one of many.

    Args:
        scenario: to play.
        worlds: how many are many.
        found: method to CPU times of one episode, added to [s].
    """
    env, expert = parallel_env(scenario), make_expert(scenario)
    begin = time.process_time()
    rollout(env, expert, SEED)
    found.setdefault("one world", []).append(time.process_time() - begin)
    for count in {1: "vector_env, 1 world", worlds: f"vector_env, {worlds} worlds"}.items():
        batch, experts = vector_env(scenario, count[0], threads=1), make_expert_batch(scenario, count[0])
        observations, _ = batch.reset(seed=SEED)
        begin = time.process_time()
        for _ in range(scenario.steps):
            observations, *_ = batch.step(experts.act(observations))
        found.setdefault(count[1], []).append((time.process_time() - begin) / count[0])


def make_episode_rows(found: dict[str, list[float]], horizon: float) -> list[dict[str, str]]:
    """Return one row of text per method."""
    return [
        {"episode": method, "CPU [s]": f"{min(times):.3f}", "realtime": f"{horizon / min(times):.0f}"}
        for method, times in found.items()
    ]


def make_rows(found: dict[tuple[str, str], Times]) -> list[dict[str, str]]:
    """Return one row of text per phase and method."""
    rows = []
    for phase, method in sorted(found, key=lambda key: PHASES.index(key[0])):
        times, ours = found[phase, method], found[phase, OURS]
        if not times.cpu:
            rows.append({"phase": phase, "method": method, "p50 [us]": "failed"})
            continue
        p50, p99 = np.percentile(times.cpu, [50, 99]) * 1e6
        rows.append(
            {
                "phase": phase,
                "method": method,
                "p50 [us]": f"{p50:.0f}",
                "p99 [us]": f"{p99:.0f}",
                "wall p50 [us]": f"{np.median(times.wall) * 1e6:.0f}",
                "ratio": f"{p50 / (np.median(ours.cpu) * 1e6):.1f}",
                "off [N m]": f"{times.off:.1g}",
                "calls": f"{len(times.cpu)}" + (f" + {times.failures} failed" if times.failures else ""),
            }
        )
    return rows


def format_table(rows: list[dict[str, str]]) -> str:
    """Return rows as a Markdown table."""
    if not rows:
        return "nothing measured"
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))
