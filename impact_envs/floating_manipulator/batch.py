"""Many worlds of one floating manipulator, stepped together: what a vector environment is made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from impact_envs.compiled import announce, bind
from impact_envs.errors import InputError
from impact_envs.floating_manipulator.collision import EVENTS
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.floating_manipulator.secrets import list_secrets
from impact_envs.floating_manipulator.step import LEAVE, START, STEP, Output, run_range
from impact_envs.floating_manipulator.task import FloatingManipulatorTask
from impact_envs.floating_manipulator.worlds import (
    Drawn,
    Memory,
    Worlds,
    make_arena,
    make_memory,
    make_step_scratch,
    make_worlds,
    write_physics,
)
from impact_envs.interface.capacity import check_size
from impact_envs.interface.failure import NotFinite, TooManyEvents
from impact_envs.interface.threads import Threads
from impact_envs.stl.compiler import compile_formula, read_parts
from impact_envs.stream import draw_doubles, seed_streams


class ManipulatorBatch:
    """N worlds of a scenario; world k is ImpactEnv with seed k's stream, bit for bit in float64.

    Args:
        scenario: of the worlds.
        count: N.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: of what is returned; what is stored is float64.
        threads: that share the worlds.

    Attributes:
        robots: number of agents.
        action_shape: of one world's actions.
        joint_size: length of an observation.
        task: of every world.
        secrets: drawn physics of every world, as the task lists them, shape (N, secrets).

    Raises:
        InputError: too many worlds for the memory, or a count below 1.
    """

    def __init__(
        self,
        scenario: FloatingManipulatorScenario,
        count: int,
        max_cycles: int | None = None,
        dtype: type = np.float64,
        threads: int = 1,
    ) -> None:
        announce(run_range)
        self.scenario, self.count, self.dtype = scenario, count, dtype
        self.task = task = FloatingManipulatorTask(scenario)
        self.robots, self.joint_size = len(scenario.agents), task.joint_layout.size
        self.action_shape = (sum(space.shape[0] for space in task.action_spaces.values()),)
        self._last = scenario.steps if max_cycles is None else min(max_cycles, scenario.steps)
        self._arena = make_arena(scenario, self._last)
        self._formula = compile_formula(
            scenario.specification,
            scenario.control_period,
            scenario.areas,
            scenario.bodies,
            task.signal_names,
            task.signal_bounds(),
        )
        check_size(count, sum(array.nbytes for group in self._make_worlds(1) for array in group))
        self._worlds, self._memory = self._make_worlds(count)
        counted = Drawn()
        scenario.draw(cast(Any, counted))
        self._draw_count = counted.count
        self.secrets = np.zeros((count, task.secrets_layout.size))
        self._threads, self._todo = Threads(threads, count), np.zeros(count, np.int64)
        self._scratch = [make_step_scratch(self._arena) for _ in range(self._threads.number)]
        self._bind()

    @property
    def steps(self) -> np.ndarray:
        """Return the control periods since each world's reset, shape (N,)."""
        return self._worlds.progress["steps"]

    @property
    def impacts(self) -> np.ndarray:
        """Return the number of impacts in each world's last control period, shape (N,)."""
        return self._worlds.progress["hits"]

    @property
    def overflow(self) -> np.ndarray:
        """Return 1 where the events of the last control period did not end, shape (N,)."""
        return self._worlds.progress["overflow"]

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
        """Return the true states, shape (N, n + 4, 6); as ``FloatingManipulatorModel.state``."""
        return self._memory.states

    @property
    def failed(self) -> np.ndarray:
        """Return which worlds cannot be followed any further, shape (N,)."""
        return self._worlds.progress["overflow"] + self._worlds.progress["lost"] > 0

    @property
    def over(self) -> np.ndarray:
        """Return which episodes are at their end, shape (N,)."""
        return (self.steps >= self._last) | self.failed

    @property
    def decided(self) -> np.ndarray:
        """Return where nothing follows: at the horizon, or failed, shape (N,)."""
        return (self.steps >= self.scenario.steps) | self.failed

    @property
    def parts(self) -> np.ndarray:
        """Return the intervals of the formula's temporal operators, as ``Monitor.parts``, shape (N, parts, 2) [m]."""
        return read_parts(self._formula, self._memory.monitor)

    @property
    def agent_size(self) -> int:
        """Return the length of an agent's own observation, for learners that share one policy among all agents.

        Raises:
            InputError: the agents' actions are not of three numbers each, so that they cannot share one.
        """
        joints = len(self.scenario.links)
        if joints != 3:
            raise InputError(f"per_robot: scenario '{self.scenario.name}' has {joints} joints; a shared policy needs 3")
        return self.joint_size

    def describe_failures(self) -> np.ndarray:
        """Return why each world failed, "" where it did not, shape (N,) of texts."""
        texts = np.full(self.count, "", dtype=object)
        for k in np.flatnonzero(self.failed).tolist():
            lost = self._worlds.progress["lost"][k]
            texts[k] = str(NotFinite(self._find_lost(k)) if lost else TooManyEvents(EVENTS, "box"))
        return texts

    def seed(self, worlds: np.ndarray, seeds: Sequence[int] | np.ndarray) -> None:
        """Start the random streams of some worlds.

        Args:
            worlds: their numbers, shape (m,).
            seeds: shape (m,).

        Raises:
            InputError: a seed that is none.
        """
        self._worlds.streams[worlds] = seed_streams(seeds)

    def start(self, worlds: np.ndarray, output: Output) -> None:
        """Draw new physics and start an episode in some worlds; the others are left alone.

        Args:
            worlds: mask, shape (N,).
            output: takes their first observations.
        """
        self._draw(np.flatnonzero(worlds))
        self._run(np.zeros((self.count, *self.action_shape)), np.where(worlds, START, LEAVE), output)

    def step(self, actions: np.ndarray, output: Output, restart: np.ndarray | None = None) -> None:
        """Advance the worlds by one control period.

        Args:
            actions: in [-1, 1], of the arm, then of the base where it is actuated, shape (N, size).
            output: takes observations and rewards.
            restart: worlds that start an episode instead; their actions are not looked at, shape (N,).

        Raises:
            InputError: actions of another shape, or one that is no finite number; nothing was stepped.
        """
        actions = np.ascontiguousarray(actions, dtype=np.float64)
        if actions.shape != (self.count, *self.action_shape):
            raise InputError(f"actions have shape {actions.shape}; {(self.count, *self.action_shape)} is needed")
        todo = self._todo
        todo[:] = STEP
        if restart is not None and restart.any():
            todo[restart] = START
            actions = np.where(restart[:, None], 0.0, actions)
        else:
            restart = None
        finite = np.isfinite(actions)
        if np.count_nonzero(finite) < finite.size:
            self._refuse(actions, finite)
        if restart is not None:
            self._draw(np.flatnonzero(restart))
        self._run(actions, todo, output)

    def close(self) -> None:
        """Let the threads go; the next step starts new ones."""
        self._threads.close()

    def make_output(self, agents: bool) -> Output:
        """Return fresh arrays for a step to fill.

        Args:
            agents: make room for each agent's own observation, which is the joint one.
        """
        n, r, size = self.count, self.robots, self.joint_size
        return Output(
            joint=np.empty((n, size), self.dtype),
            agents=np.empty((n, r if agents else 0, size), self.dtype),
            rewards=np.empty((n, r), self.dtype),
        )

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_call"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def _bind(self) -> None:
        arrays, actions, todo = self.collect(0), np.zeros((0, *self.action_shape)), np.zeros(0, np.int64)
        self._call = bind(run_range, *arrays, self.make_output(False), actions, todo, 0, 0)  # of no world

    def collect(self, thread: int) -> tuple[Any, ...]:
        """Return what every call of `run_range` by a thread takes before the output."""
        return self._arena, self._worlds, self._memory, self._formula, self._scratch[thread]

    def _run(self, actions: np.ndarray, todo: np.ndarray, output: Output) -> None:
        def run(thread: int, first: int, end: int) -> None:
            self._call(*self.collect(thread), output, actions, todo, first, end)

        self._threads.share(run)

    def _draw(self, worlds: np.ndarray) -> None:
        """Draw the physics of some worlds, shape (m,), as `scenario.draw` does."""
        numbers = draw_doubles(self._worlds.streams, worlds, self._draw_count)
        for k, row in zip(worlds.tolist(), numbers.tolist(), strict=True):
            physics = self.scenario.draw(cast(Any, Drawn(row)))
            write_physics(self._worlds, k, physics)
            self.secrets[k] = list_secrets(physics)

    def _make_worlds(self, count: int) -> tuple[Worlds, Memory]:
        delay, conjuncts = self.scenario.true.delay_steps, len(self.scenario.specification.conjuncts())
        return make_worlds(self._arena, count), make_memory(self._arena, count, delay, self._formula.size, conjuncts)

    def _refuse(self, actions: np.ndarray, finite: np.ndarray) -> None:
        """Raise InputError: name the first world and agent with a number that is not finite."""
        world, place = np.argwhere(~finite)[0].tolist()
        joints = len(self.scenario.links)
        agent, part = ("arm", slice(joints)) if place < joints else ("base", slice(joints, None))
        raise InputError(f"action of {agent} in world {world} = {actions[world, part].tolist()}: finite numbers only")

    def _find_lost(self, k: int) -> str:
        """Return the first body of world k whose state is not finite."""
        motion = np.stack([self._worlds.q[k], self._worlds.v[k]])
        joints = len(self.scenario.links)
        finite = np.isfinite(motion).all(axis=0)
        if not finite[:3].all():
            return "base"
        lost = np.flatnonzero(~finite[3 : 3 + joints])
        return self.scenario.bodies[1 + lost[0]] if len(lost) else "box"


def make_batch(
    scenario: FloatingManipulatorScenario,
    count: int,
    max_cycles: int | None = None,
    dtype: type = np.float64,
    threads: int = 1,
    device: str = "cpu",
) -> ManipulatorBatch:
    """Make N worlds of a scenario.

    Args:
        scenario: of the worlds.
        count: N.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: of what is returned.
        threads: that share the worlds.
        device: ``cpu``.

    Raises:
        InputError: another device, or what the batch itself refuses.
    """
    if device != "cpu":
        raise InputError(
            f"scenario '{scenario.name}': floating manipulators run on the CPU only, got device '{device}'"
        )
    return ManipulatorBatch(scenario, count, max_cycles, dtype, threads)
