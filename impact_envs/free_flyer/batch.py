"""Many worlds of one scenario, stepped together: what a vector environment is made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from impact_envs.compiled import announce, bind
from impact_envs.domain import load_attribute
from impact_envs.errors import InputError
from impact_envs.flight import make_flight, make_no_flight
from impact_envs.free_flyer.contact.pair import EVENTS
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.secrets import list_secrets
from impact_envs.free_flyer.sensing import compute_memory_size, count_uniforms, make_sensing
from impact_envs.free_flyer.step import (
    LEAVE,
    START,
    STEP,
    Memory,
    Output,
    Rules,
    find_not_finite,
    run_tuples,
)
from impact_envs.free_flyer.task import SIGNALS, FreeFlyerTask
from impact_envs.free_flyer.truth import SENSOR_COLUMNS
from impact_envs.free_flyer.worlds import (
    HITS,
    LOST,
    OVERFLOW,
    ROW,
    STEPS,
    STRUCK,
    Worlds,
    make_arena,
    make_scratch,
    make_worlds,
    write_physics,
)
from impact_envs.interface.capacity import check_size
from impact_envs.interface.failure import NotFinite, TooManyEvents, check_finite
from impact_envs.interface.threads import APART, Threads
from impact_envs.reward import ROBUSTNESS, find_rates
from impact_envs.stl.compiler import compile_formula, read_parts
from impact_envs.stream import draw_doubles, seed_streams


class BatchViews:
    """What can be seen of N worlds, as arrays or, on a GPU, as tensors."""

    _worlds: Any
    _memory: Any
    _formula: Any
    task: FreeFlyerTask
    _last: int
    count: int
    scenario: FreeFlyerScenario

    @property
    def steps(self) -> Any:
        """Return the control periods since each world's reset, shape (N,)."""
        return self._worlds.counter[:, STEPS]

    @property
    def impacts(self) -> Any:
        """Return the number of impacts in each world's last control period, shape (N,)."""
        return self._worlds.counter[:, HITS]

    @property
    def overflow(self) -> Any:
        """Return 1 where the events of the last control period did not end, shape (N,)."""
        return self._worlds.counter[:, OVERFLOW]

    @property
    def bounds(self) -> Any:
        """Return the interval of robustness still possible, shape (N, 2) [m]."""
        return self._memory.bounds

    @property
    def outcome(self) -> Any:
        """Return the robustness if the episodes ended now, for ``judge``, shape (N,) [m]."""
        return self._memory.outcome

    @property
    def states(self) -> Any:
        """Return the true states, shape (N, bodies, 6); as ``DiscModel.state``."""
        return self._memory.states

    @property
    def parts(self) -> np.ndarray:
        """Return the intervals of the formula's temporal operators, as ``Monitor.parts``, shape (N, parts, 2) [m]."""
        return read_parts(self._formula, _hand_over(self._memory.monitor))

    @property
    def secrets(self) -> np.ndarray:
        """Return the drawn physics of every world, as the task lists them, shape (N, secrets)."""
        # What no world of the scenario needs is not kept: it is what it is where nothing is disturbed.
        usual = self.scenario.draw_many(np.zeros((1, self.scenario.draw_count)))
        kept = self._worlds.contact, self._worlds.body, self._worlds.thruster, self._memory.sensors
        parts = []
        defaults = usual.contact, usual.body, usual.thruster, usual.sensor
        for numbers, default in zip(kept, defaults, strict=True):
            part = np.repeat(default, self.count, axis=0)
            if numbers.shape[1] > 0:
                width = min(numbers.shape[-1], part.shape[-1])
                part[..., :width] = _hand_over(numbers)[..., :width]
            parts.append(part)
        return list_secrets(*parts)

    @property
    def failed(self) -> Any:
        """Return which worlds cannot be followed any further, shape (N,)."""
        return self._worlds.counter[:, OVERFLOW] + self._worlds.counter[:, LOST] > 0

    @property
    def over(self) -> Any:
        """Return which episodes are at their end, shape (N,)."""
        return (self.steps >= self._last) | self.failed

    @property
    def decided(self) -> Any:
        """Return where nothing follows: at the horizon, or failed, shape (N,)."""
        return (self.steps >= self.scenario.steps) | self.failed

    def describe_failures(self) -> np.ndarray:
        """Return why each world failed, "" where it did not, shape (N,) of texts."""
        texts = np.full(self.count, "", dtype=object)
        for k in np.flatnonzero(self.failed.tolist()).tolist():
            if self._worlds.counter[k, LOST] == 0:
                texts[k] = str(TooManyEvents(EVENTS, ("", *self.scenario.bodies)[int(self._worlds.counter[k, STRUCK])]))
                continue
            try:
                check_finite(np.array(self._worlds.state[k, :, :6].tolist()), self.scenario.bodies)
            except NotFinite as failure:
                texts[k] = str(failure)
        return texts


class Batch(BatchViews):
    """N worlds of a scenario of discs; world k is ImpactEnv with seed k's stream, bit for bit in float64.

    Args:
        scenario: whose engine is the exact one.
        count: N.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: of what is stored and returned; arithmetic is float64.
        threads: that share the worlds.
        reward: see ImpactEnv.

    Raises:
        InputError: polygons, too many worlds for the memory, or a count below 1.
    """

    def __init__(
        self,
        scenario: FreeFlyerScenario,
        count: int,
        max_cycles: int | None = None,
        dtype: type = np.float64,
        threads: int = 1,
        reward: str = ROBUSTNESS,
    ) -> None:
        announce(run_tuples)
        self.scenario, self.count, self.dtype = scenario, count, dtype
        self.task = task = FreeFlyerTask(scenario)
        arena, _ = make_arena(scenario)
        signals = [f"{body}.{name}" for body in scenario.bodies for name in SIGNALS]
        bounds, period, specification = task.signal_bounds(), scenario.control_period, scenario.specification
        self._formula = compile_formula(specification, period, scenario.areas, scenario.bodies, signals, bounds)
        rates, self._flight = find_rates(reward, scenario.domain), make_no_flight()
        if rates is not None:
            reach = specification.expand(scenario.bodies).reach(period)
            self._flight = make_flight(self._formula, reach, period, signals, rates, bounds)
        self._sensing = make_sensing(scenario.control_period, scenario.true)
        self._last = scenario.steps if max_cycles is None else min(max_cycles, scenario.steps)
        starts, flight = scenario.starts[None], self._flight
        self._rules = Rules(float(scenario.horizon), self._last, scenario.world.diagonal, starts, flight)
        self.robots, self.bodies = len(scenario.robots), len(scenario.bodies)
        self.action_shape = self.robots, 3
        self.joint_size, self.agent_size = task.joint_layout.size, task.layouts[scenario.agents[0]].size
        self._threads = Threads(threads, count)
        self._arena, self._scratch = arena, make_scratch(arena, self._threads.rows)
        arrays = [array for group in self._make_worlds(1) for array in group]
        check_size(count, sum({array.ctypes.data: array.nbytes for array in arrays}.values()))
        self._worlds, self._memory = self._make_worlds(count)
        self._log = np.zeros((count, 0, ROW))
        self._collect()
        self._todo = np.zeros(count, np.int64)

    def seed(self, worlds: np.ndarray, seeds: Sequence[int] | np.ndarray) -> None:
        """Start the random streams of some worlds.

        Args:
            worlds: their numbers, shape (m,).
            seeds: shape (m,).

        Raises:
            InputError: a seed that is none.
        """
        self._memory.streams[worlds] = seed_streams(seeds)

    def start(self, worlds: np.ndarray, output: Output) -> None:
        """Draw new physics and start an episode in some worlds; the others are left alone.

        Args:
            worlds: mask, shape (N,).
            output: takes their first observations.
        """
        self._draw(np.flatnonzero(worlds))
        self._run(np.zeros((self.count, self.robots, 3)), np.where(worlds, START, LEAVE), output)

    def step(self, actions: np.ndarray, output: Output, restart: np.ndarray | None = None) -> None:
        """Advance the worlds by one control period.

        Args:
            actions: in [-1, 1], shape (N, robots, 3).
            output: takes observations and rewards.
            restart: worlds that start an episode instead; their actions are not looked at, shape (N,).

        Raises:
            InputError: actions of another shape, or one that is no finite number; nothing was stepped.
        """
        actions = np.ascontiguousarray(actions, dtype=np.float64)
        if actions.shape != (self.count, self.robots, 3):
            raise InputError(f"actions have shape {actions.shape}; ({self.count}, {self.robots}, 3) is needed")
        todo = self._todo
        todo[:] = STEP
        if restart is not None and not restart.any():
            restart = None
        if restart is not None:
            todo[restart] = START
            actions = np.where(restart[:, None, None], 0, actions)
        wrong = find_not_finite(actions.reshape(-1))
        if wrong >= 0:
            world, robot = divmod(wrong // 3, self.robots)
            name = self.scenario.agents[robot]
            raise InputError(
                f"action of {name} in world {world} = {actions[world, robot].tolist()}: finite numbers only"
            )
        if restart is not None:
            self._draw(np.flatnonzero(restart))
        self._run(actions, todo, output)

    def close(self) -> None:
        """Let the threads go; the next step starts new ones."""
        self._threads.close()

    def __getstate__(self) -> dict[str, Any]:
        state = {name: value for name, value in self.__dict__.items() if name != "_call"}
        return {**state, "arrays": ()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._memory = view_signals(self._memory)  # copying makes arrays of views
        self._collect()

    def _collect(self) -> None:
        """Collect the arrays that every step takes."""
        owned, shared = (self._arena, self._worlds, self._scratch), (self._formula, self._sensing, self._rules)
        self.arrays = (*map(tuple, owned), self._log, *map(tuple, (*shared, self._memory)))
        nothing = tuple(self.make_output(False)), np.zeros((0, self.robots, 3)), np.zeros(0, np.int64)
        self._call = bind(run_tuples, *self.arrays, *nothing, 0, 0, 0)  # of no world

    def make_output(self, agents: bool) -> Output:
        """Return fresh arrays for a step to fill.

        Args:
            agents: make room for each robot's own observation.
        """
        n, r = self.count, self.robots
        return Output(
            joint=np.empty((n, self.joint_size), self.dtype),
            agents=np.empty((n, r if agents else 0, self.agent_size), self.dtype),
            rewards=np.empty((n, r), self.dtype),
        )

    def _run(self, actions: np.ndarray, todo: np.ndarray, output: Output) -> None:
        filled, call = tuple(output), self._call

        def run(thread: int, first: int, end: int) -> None:
            call(*self.arrays, filled, actions, todo, APART * thread, first, end)

        self._threads.share(run)

    def _draw(self, worlds: np.ndarray) -> None:
        if len(worlds) == 0:
            return
        uniforms = draw_doubles(self._memory.streams, worlds, self.scenario.draw_count)
        write_physics(self._worlds, worlds, self.scenario.draw_many(uniforms), self._memory.sensors)

    def _make_worlds(self, count: int) -> tuple[Worlds, Memory]:
        n, r, sensing, dtype, true = self.bodies, self.robots, self._sensing, self.dtype, self.scenario.true
        states: np.ndarray = np.zeros((count, n, 6), dtype)
        contacts: np.ndarray = np.zeros((count, r), dtype)
        kept, drawn = compute_memory_size(sensing, n, r), count_uniforms(sensing, n)
        ideal = kept + drawn == 0
        columns = SENSOR_COLUMNS if sensing.delay_steps + sensing.lost_steps > 0 else 0
        predicts = self._flight.every > 0
        memory = Memory(
            states=states,
            signals=states,
            contacts=contacts,
            streams=np.zeros((count, 4), np.uint64),
            sensors=np.zeros((count, columns), dtype),
            uniforms=np.zeros((count, drawn)),
            samples=np.zeros((count, kept), dtype),
            measured=states if ideal else np.zeros_like(states),
            felt=contacts if ideal else np.zeros_like(contacts),
            monitor=np.zeros((count, self._formula.size), dtype),
            bounds=np.zeros((count, 2), dtype),
            conjuncts=np.zeros((count, 2 * len(self.scenario.specification.conjuncts())), dtype),
            outcome=np.zeros(count, dtype),
            potential=np.zeros((count, 1 if predicts else 0), dtype),
            spare=np.zeros((count, self._formula.size if predicts else 0), dtype),
            flown=np.zeros((count, 6 * n if predicts else 0), dtype),
        )
        return make_worlds(self._arena, count, true.moves_bodies, true.changes_thrusters, dtype), view_signals(memory)


def _hand_over(numbers: Any) -> np.ndarray:
    """Return an array, or a tensor's numbers as one."""
    return numbers if isinstance(numbers, np.ndarray) else numbers.cpu().numpy()


def view_signals(memory: Memory) -> Memory:
    """Return the memory with the monitor's signals as a view of the states."""
    return memory._replace(signals=memory.states.reshape(len(memory.states), -1))


def make_batch(
    scenario: FreeFlyerScenario,
    count: int,
    max_cycles: int | None = None,
    dtype: type = np.float64,
    threads: int = 1,
    device: str = "cpu",
    reward: str = ROBUSTNESS,
) -> Any:
    """Make N worlds of a scenario: a `Batch`, or on a GPU a `GpuBatch`.

    Args:
        scenario: of discs, for the exact engine.
        count: N.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: of what is stored and returned.
        threads: that share the worlds on the CPU.
        device: ``cpu`` or ``cuda``.
        reward: ``robustness`` or ``progress``.

    Raises:
        InputError: polygons, the other engine, or what the batch itself refuses.
    """
    if scenario.engine == "pymunk" or scenario.has_polygons:
        raise InputError(
            f"scenario '{scenario.name}' is not for the exact engine, which takes free-flyers and objects that are "
            "discs; gymnasium.vector.SyncVectorEnv runs every scenario"
        )
    if device == "cpu":
        return Batch(scenario, count, max_cycles, dtype, threads, reward)
    make_gpu_batch = load_attribute("impact_envs.free_flyer.gpu:GpuBatch")  # by name, because it is made of a Batch
    return make_gpu_batch(scenario, count, max_cycles, dtype, reward)
