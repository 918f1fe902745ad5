"""Many worlds of two arms and a box, stepped together: what a vector environment is made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from gymnasium.utils import seeding

from impact_envs.compiled import announce
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.dual_arm.secrets import list_secrets
from impact_envs.dual_arm.step import (
    LEAVE,
    RULES,
    SIGNALS,
    START,
    STEP,
    TASK,
    Memory,
    Output,
    make_scratch,
    run_worlds,
)
from impact_envs.dual_arm.task import EFFORT_PERIOD, DualArmTask
from impact_envs.dual_arm.world import PLANT, WORLD, make_clock, start_world
from impact_envs.errors import InputError
from impact_envs.interface.capacity import check_size
from impact_envs.interface.failure import NotFinite, check_finite
from impact_envs.interface.threads import APART, Threads
from impact_envs.stl.compiler import compile_formula, read_parts
from impact_envs.stream import check_seed


class DualArmBatch:
    """N worlds of a scenario; world k is ImpactEnv with seed k's generator, bit for bit in float64.

    Args:
        scenario: who is where.
        count: N.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: of what is returned; all else is float64.
        threads: that share the worlds.

    Attributes:
        robots, bodies: numbers of arms, and of arms and boxes.
        action_shape: of one world's actions.
        joint_size, agent_size: lengths of the joint observation and of an arm's own.
        task: of every world.
        secrets: drawn physics of every world, as the task lists them, shape (N, secrets).
        last: control periods after which an episode is over.

    Raises:
        InputError: too many worlds for the memory, or a count below 1.
    """

    robots, bodies = 2, 3
    action_shape = (2, 3)

    def __init__(
        self,
        scenario: DualArmScenario,
        count: int,
        max_cycles: int | None = None,
        dtype: type = np.float64,
        threads: int = 1,
    ) -> None:
        self.scenario, self.count, self.dtype = scenario, count, dtype
        self.task = task = DualArmTask(scenario)
        self._formula = compile_formula(
            scenario.specification,
            scenario.control_period,
            scenario.areas,
            scenario.bodies,
            [f"{body}.{name}" for body in scenario.bodies for name in scenario.signals],
            task.signal_bounds(),
        )
        check_size(count, PLANT.itemsize + WORLD.itemsize + TASK.itemsize + 8 * (SIGNALS * 3 + self._formula.size + 3))
        announce(run_worlds)
        self.joint_size, self.agent_size = task.joint_layout.size, task.layouts[scenario.agents[0]].size
        self.last = scenario.steps if max_cycles is None else min(max_cycles, scenario.steps)
        self._rules = np.zeros(1, RULES)
        self._rules[0] = (
            scenario.control_period,
            scenario.horizon,
            self.last,
            scenario.world.diagonal,
            EFFORT_PERIOD,
        )
        self._clock = make_clock(scenario)
        self._plants, self._worlds, self._tasks = (np.zeros(count, kind) for kind in (PLANT, WORLD, TASK))
        self._memory = Memory(
            signals=np.zeros((count, SIGNALS * self.bodies)),
            monitor=np.zeros((count, self._formula.size)),
            bounds=np.zeros((count, 2)),
            outcome=np.zeros(count),
        )
        self.secrets = np.zeros((count, task.secrets_layout.size))
        self._threads = Threads(threads, count)
        self._scratch = make_scratch(self._threads.rows)
        self._generators: list[np.random.Generator] = [np.random.default_rng(0) for _ in range(count)]
        self._overflow = np.zeros(count, np.int64)
        self._todo = np.zeros(count, np.int64)

    @property
    def steps(self) -> np.ndarray:
        """Return the control periods since each world's reset, shape (N,)."""
        return self._tasks["steps"]

    @property
    def impacts(self) -> np.ndarray:
        """Return the number of pads that first touched the box in the last control period, shape (N,)."""
        return self._tasks["impacts"]

    @property
    def overflow(self) -> np.ndarray:
        """Return zeros: compliant contacts have no events that could fail to end, shape (N,)."""
        return self._overflow

    @property
    def bounds(self) -> np.ndarray:
        """Return the interval of robustness still possible, shape (N, 2) [m]."""
        return self._memory.bounds

    @property
    def outcome(self) -> np.ndarray:
        """Return the robustness if the episodes ended now, for ``judge``, shape (N,) [m]."""
        return self._memory.outcome

    @property
    def states(self) -> np.ndarray:
        """Return the true states, shape (N, 3, 22); as ``DualArmModel.state``."""
        return self._tasks["states"]

    @property
    def failed(self) -> np.ndarray:
        """Return which worlds cannot be followed any further, shape (N,)."""
        return self._tasks["lost"] > 0

    @property
    def over(self) -> np.ndarray:
        """Return which episodes are at their end, shape (N,)."""
        return (self.steps >= self.last) | self.failed

    @property
    def decided(self) -> np.ndarray:
        """Return where nothing follows: at the horizon, or failed, shape (N,)."""
        return (self.steps >= self.scenario.steps) | self.failed

    @property
    def parts(self) -> np.ndarray:
        """Return the intervals of the formula's temporal operators, as ``Monitor.parts``, shape (N, parts, 2) [m]."""
        return read_parts(self._formula, self._memory.monitor)

    def describe_failures(self) -> np.ndarray:
        """Return why each world failed, "" where it did not, shape (N,) of texts."""
        texts = np.full(self.count, "", dtype=object)
        for k in np.flatnonzero(self.failed).tolist():
            try:
                check_finite(self._worlds[k]["rows"], self.scenario.bodies)
            except NotFinite as failure:
                texts[k] = str(failure)
        return texts

    def seed(self, worlds: np.ndarray, seeds: Sequence[int] | np.ndarray) -> None:
        """Start the random generators of some worlds.

        Args:
            worlds: their numbers, shape (m,).
            seeds: shape (m,).

        Raises:
            InputError: a seed that is none.
        """
        for k, seed in zip(worlds.tolist(), seeds, strict=True):
            self._generators[k], _ = seeding.np_random(check_seed(seed, f"seed of world {k}"))

    def start(self, worlds: np.ndarray, output: Output) -> None:
        """Draw new physics and start an episode in some worlds; the others are left alone.

        Args:
            worlds: mask, shape (N,).
            output: takes their first observations.
        """
        self._draw(worlds)
        self._run(np.zeros((self.count, 2, 3)), np.where(worlds, START, LEAVE), output)

    def step(self, actions: np.ndarray, output: Output, restart: np.ndarray | None = None) -> None:
        """Advance the worlds by one control period.

        Args:
            actions: in [-1, 1], shape (N, 2, 3).
            output: takes observations and rewards.
            restart: worlds that start an episode instead; their actions are not looked at, shape (N,).

        Raises:
            InputError: actions of another shape, or one that is no finite number; nothing was stepped.
        """
        actions = np.ascontiguousarray(actions, dtype=np.float64)
        if actions.shape != (self.count, 2, 3):
            raise InputError(f"actions have shape {actions.shape}; ({self.count}, 2, 3) is needed")
        todo = self._todo
        todo[:] = STEP
        if restart is not None and restart.any():
            todo[restart] = START
            actions = np.where(restart[:, None, None], 0.0, actions)
        finite = np.isfinite(actions)
        if np.count_nonzero(finite) < finite.size:
            world, arm = np.argwhere(~finite)[0, :2].tolist()
            name = self.scenario.agents[arm]
            raise InputError(f"action of {name} in world {world} = {actions[world, arm].tolist()}: finite numbers only")
        if restart is not None:
            self._draw(restart)
        self._run(actions, todo, output)

    def make_output(self, agents: bool) -> Output:
        """Return fresh arrays for a step to fill.

        Args:
            agents: make room for each arm's own observation.
        """
        n = self.count
        return Output(
            joint=np.empty((n, self.joint_size), self.dtype),
            agents=np.empty((n, 2 if agents else 0, self.agent_size), self.dtype),
            rewards=np.empty((n, 2), self.dtype),
        )

    def close(self) -> None:
        """Let the threads go; the next step starts new ones."""
        self._threads.close()

    def _draw(self, worlds: np.ndarray) -> None:
        """Draw the physics of some worlds, a mask, and put them at their starts."""
        for k in np.flatnonzero(worlds).tolist():
            physics = self.scenario.draw(self._generators[k])
            start_world(self.scenario, physics, self._plants, self._worlds, k)
            self.secrets[k] = list_secrets(physics)

    def collect(self) -> tuple[Any, ...]:
        """Return what every call of `run_worlds` takes before the output."""
        records = self._plants, self._worlds, self._clock, self._rules, self._tasks
        return *records, *map(tuple, (self._scratch, self._formula, self._memory))

    def _run(self, actions: np.ndarray, todo: np.ndarray, output: Output) -> None:
        world, shown, call = self.collect(), tuple(output), cast(Any, run_worlds)

        def run(thread: int, first: int, end: int) -> None:
            call(*world, shown, actions, todo, APART * thread, first, end)

        self._threads.share(run)


def make_batch(
    scenario: DualArmScenario,
    count: int,
    max_cycles: int | None = None,
    dtype: type = np.float64,
    threads: int = 1,
    device: str = "cpu",
) -> DualArmBatch:
    """Make N worlds of a scenario.

    Args:
        scenario: who is where.
        count: N.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: of what is returned.
        threads: that share the worlds.
        device: ``cpu``.

    Raises:
        InputError: a GPU, or what the batch itself refuses.
    """
    if device != "cpu":
        raise InputError(f"device '{device}': the worlds of domain 'dual_arm' run on the cpu only")
    return DualArmBatch(scenario, count, max_cycles, dtype, threads)
