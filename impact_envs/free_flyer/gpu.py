"""Many worlds of one scenario on a GPU: the functions of ``step.py`` compiled for CUDA, one thread per world.

Arithmetic is float64 without fused multiply-add and elementary functions are our own, as on the CPU; what differs is
CUDA's hypot, in the last bit. Compiling takes about a minute, once per process, number of bodies and dtype.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch
from numba import config, cuda, float64, int64, typeof, types

from impact_envs.compiled import retarget
from impact_envs.errors import InputError
from impact_envs.free_flyer.batch import Batch, BatchViews
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.step import LEAVE, START, STEP, Memory, Output, run_range
from impact_envs.free_flyer.worlds import REST, Scratch, Worlds, write_physics
from impact_envs.interface.capacity import check_size
from impact_envs.reward import ROBUSTNESS
from impact_envs.stream import draw_doubles, seed_streams

# numba's simulator runs the kernels as plain Python on arrays in main memory (NUMBA_ENABLE_CUDASIM=1).
SIMULATED = bool(config.ENABLE_CUDASIM)  # type: ignore[attr-defined]
# Each thread keeps what a step computes with in its own local memory, 136 bytes per pair and 104 per body, and the
# driver sets it aside for all threads that a GPU can hold.
MOST_BODIES, MOST_PAIRS = 12, 256
THREADS = 64  # per block


class GpuBatch(BatchViews):
    """N worlds of a scenario of discs on the GPU that CUDA counts as 0, with what ``Batch`` offers on the CPU.

    What it takes and returns are torch tensors there; nothing is copied but the physics drawn for worlds that start.
    The world is the last axis in memory of all that is kept, so that neighbouring threads read neighbouring numbers.

    Args:
        scenario: whose engine is the exact one.
        count: N.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: of what is stored and returned, float64 or float32; arithmetic is float64.
        reward: see ImpactEnv.

    Raises:
        InputError: no GPU, polygons, more bodies than the kernel has room for, too many worlds for the memory, or a
            count below 1.
    """

    def __init__(
        self,
        scenario: FreeFlyerScenario,
        count: int,
        max_cycles: int | None = None,
        dtype: type = np.float64,
        reward: str = ROBUSTNESS,
    ) -> None:
        check_gpu()
        self.scenario, self.count, self.reward = scenario, count, reward
        self.device = torch.device("cpu" if SIMULATED else "cuda:0")
        self._host = host = Batch(scenario, 1, max_cycles, dtype, reward=reward)
        self._last, self._formula, self.task = host._last, host._formula, host.task
        self.robots, self.bodies = host.robots, host.bodies
        self.action_shape = host.action_shape
        self.joint_size, self.agent_size = host.joint_size, host.agent_size
        pairs, columns = len(host._arena.pairs), (host._scratch.motion.shape[2], host._scratch.contacts.shape[2])
        check_room(scenario.name, self.bodies, pairs)
        output = host.make_output(agents=True)
        _check_memory(count, sum(array.nbytes for array in (*host._worlds, *host._memory, *output)))
        self._worlds: Any = _replace_arrays(host._worlds, self._make_tensor)
        self._memory: Any = self._make_memory()
        shared = (host._log, host._formula, host._sensing, host._rules)
        kinds = (
            typeof(host._arena),
            _type_strided(host._worlds),
            *map(typeof, shared),
            _type_strided(host._memory),
            *map(typeof, (output, np.zeros((1, self.robots, 3)), np.zeros(1, np.int64))),
        )
        self._kernel = make_kernel(kinds, self.bodies, pairs, *columns)
        self._arena, *self._shared = (self._upload(arrays) for arrays in (host._arena, *shared))
        self._kept = _replace_arrays(self._worlds, _hand_over), _replace_arrays(self._memory, _hand_over)

    def seed(self, worlds: Any, seeds: Sequence[int] | np.ndarray) -> None:
        """Start the random streams of some worlds.

        Args:
            worlds: their numbers, shape (m,).
            seeds: shape (m,).

        Raises:
            InputError: a seed that is none.
        """
        self._write_streams(torch.as_tensor(worlds, device=self.device), seed_streams(seeds))

    def start(self, worlds: Any, output: Output) -> None:
        """Draw new physics and start an episode in some worlds; the others are left alone.

        Args:
            worlds: mask, shape (N,).
            output: takes their first observations.
        """
        mask = torch.as_tensor(worlds, device=self.device)
        self._draw(mask.nonzero()[:, 0])
        actions = torch.zeros((self.count, self.robots, 3), dtype=torch.float64, device=self.device)
        self._run(actions, torch.where(mask, START, LEAVE), output)

    def step(self, actions: Any, output: Output, restart: Any | None = None) -> None:
        """Advance the worlds by one control period.

        Args:
            actions: in [-1, 1], shape (N, robots, 3).
            output: takes observations and rewards.
            restart: worlds that start an episode instead; their actions are not looked at, shape (N,).

        Raises:
            InputError: actions of another shape, or one that is no finite number; nothing was stepped.
        """
        actions = torch.as_tensor(actions, device=self.device).detach().to(torch.float64).contiguous()
        if actions.shape != (self.count, self.robots, 3):
            raise InputError(f"actions have shape {tuple(actions.shape)}; ({self.count}, {self.robots}, 3) is needed")
        wrong = ~actions.isfinite().all(dim=2)
        starting = torch.zeros(self.count, dtype=torch.bool, device=self.device)
        if restart is not None:
            starting = torch.as_tensor(restart, device=self.device)
            wrong &= ~starting[:, None]
        any_wrong, any_starting = torch.stack((wrong.any(), starting.any())).tolist()  # waits for the device once
        if any_wrong:
            world, robot = wrong.nonzero()[0].tolist()
            name = self.scenario.agents[robot]
            raise InputError(
                f"action of {name} in world {world} = {actions[world, robot].tolist()}: finite numbers only"
            )
        if any_starting:
            self._draw(starting.nonzero()[:, 0])
        self._run(actions, torch.where(starting, START, STEP), output)

    def close(self) -> None:
        """Do nothing: memory goes back to the device with the tensors."""

    def make_output(self, agents: bool) -> Output:
        """Return fresh tensors for a step to fill.

        Args:
            agents: make room for each robot's own observation.
        """
        n, r = self.count, self.robots
        shapes = (n, self.joint_size), (n, r if agents else 0, self.agent_size), (n, r)
        dtype = self._memory.bounds.dtype
        return Output(*(torch.empty(shape, dtype=dtype, device=self.device) for shape in shapes))  # type: ignore[arg-type]

    def __getstate__(self) -> dict[str, Any]:
        arguments = self.scenario, self.count, self._last, self._host.dtype, self.reward
        groups = [_replace_arrays(group, lambda tensor: tensor.cpu().numpy()) for group in (self._worlds, self._memory)]
        return {"arguments": arguments, "groups": groups}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(*state["arguments"])  # type: ignore[misc]
        for tensors, arrays in zip((self._worlds, self._memory), state["groups"], strict=True):
            for tensor, array in zip(tensors, arrays, strict=True):
                if hasattr(tensor, "copy_"):
                    tensor.copy_(torch.from_numpy(array))

    def _run(self, actions: torch.Tensor, todo: torch.Tensor, output: Output) -> None:
        worlds, memory = self._kept
        threads = min(THREADS, self.count)
        stream = 0 if SIMULATED else torch.cuda.current_stream(self.device).cuda_stream
        run = self._kernel[-(-self.count // threads), threads, cuda.external_stream(stream) if stream else 0]
        given = _replace_arrays(output, _hand_over), _hand_over(actions), _hand_over(todo)
        run(self._arena, worlds, *self._shared, memory, *given)

    def _draw(self, worlds: torch.Tensor) -> None:
        """Draw physics on the host for worlds with these numbers, and bring them to the device."""
        count = len(worlds)
        if count == 0:
            return
        streams = self._memory.streams.view(torch.int64)[worlds].cpu().numpy().view(np.uint64)
        doubles = draw_doubles(streams, np.arange(count), self.scenario.draw_count)
        self._write_streams(worlds, streams)
        drawn = self.scenario.draw_many(doubles)
        write_physics(
            self._worlds,
            worlds,
            drawn,
            self._memory.sensors,
            lambda array, tensor: torch.from_numpy(array).to(tensor),
        )

    def _write_streams(self, worlds: torch.Tensor, streams: np.ndarray) -> None:
        # torch indexes few unsigned types
        self._memory.streams.view(torch.int64)[worlds] = torch.from_numpy(streams.view(np.int64)).to(self.device)

    def _make_memory(self) -> Any:
        """Return the task's memory of all worlds, aliased as the host's."""
        host = self._host._memory
        memory = _replace_arrays(host, self._make_tensor)
        return memory._replace(
            signals=memory.states.view(self.count, -1),
            measured=memory.states if host.measured is host.states else memory.measured,
            felt=memory.contacts if host.felt is host.contacts else memory.felt,
        )

    def _make_tensor(self, array: np.ndarray) -> torch.Tensor:
        """Return for all worlds what an array is for one; the world is the first axis, and the last one in memory."""
        dtype = torch.from_numpy(array).dtype
        return torch.zeros((*array.shape[1:], self.count), dtype=dtype, device=self.device).movedim(-1, 0)

    def _upload(self, arrays: Any) -> Any:
        """Return what all worlds share as the kernel takes it."""

        def upload(array: np.ndarray) -> Any:
            return _hand_over(torch.from_numpy(array).to(self.device))

        return upload(arrays) if isinstance(arrays, np.ndarray) else _replace_arrays(arrays, upload)


@cache
def make_kernel(kinds: tuple[Any, ...], bodies: int, pairs: int, motion_size: int, contact_size: int) -> Any:
    """Compile ``run_range`` for CUDA, with a thread's scratch arrays in its local memory.

    Args:
        kinds: numba types of the kernel's arguments.
        bodies, pairs: movable bodies, and pairs that can touch.
        motion_size, contact_size: columns of ``Scratch.motion`` and ``Scratch.contacts``.
    """
    # Linking intermediate code instead would compile twice, and fuse.
    options = {"lto": False} if "lto" in inspect.signature(cuda.jit).parameters else {}
    run = retarget(run_range, lambda function: cuda.jit(function, device=True, **options))

    def run_world(
        arena: Any,
        worlds: Worlds,
        log: Any,
        formula: Any,
        sensing: Any,
        rules: Any,
        memory: Memory,
        output: Output,
        actions: Any,
        todo: Any,
    ) -> None:
        k: Any = cuda.grid(1)  # type: ignore[call-arg]
        if k < todo.shape[0]:
            motion = cuda.local.array((1, bodies, motion_size), float64)
            marks = cuda.local.array((1, pairs, 2), int64)
            contacts = cuda.local.array((1, pairs, contact_size), float64)
            for pair in range(pairs):
                marks[0, pair, REST] = 0
            scratch = Scratch(motion, marks, contacts)
            run(arena, worlds, scratch, log, formula, sensing, rules, memory, output, actions, todo, 0, k, k + 1)

    with _unfused():
        return cuda.jit(kinds, **options)(run_world)


def check_gpu() -> None:
    """Raise unless torch and numba both have a GPU, or numba simulates one.

    Raises:
        InputError: saying which of them lacks what.
    """
    if SIMULATED:
        return
    if not torch.cuda.is_available():
        raise InputError(f"device 'cuda': torch {torch.__version__} finds no GPU; choices: cpu")
    # The target that numba itself still carries does not compile the kernel.
    if find_spec("numba_cuda") is None or not cuda.is_available():
        wheel = f"numba-cuda[cu{str(torch.version.cuda).split('.')[0]}]"
        raise InputError(f"device 'cuda': numba-cuda is missing or finds no CUDA; pip install '{wheel}', or choose cpu")


def check_room(name: str, bodies: int, pairs: int) -> None:
    """Raise unless a thread has room for a scenario's bodies.

    Raises:
        InputError: naming how many there are and how many there may be.
    """
    if bodies > MOST_BODIES:
        raise InputError(f"scenario '{name}' has {bodies} bodies; on a GPU {MOST_BODIES} are possible")
    if pairs > MOST_PAIRS:
        raise InputError(
            f"scenario '{name}' has {pairs} pairs of bodies, walls and obstacles that can touch; on a GPU {MOST_PAIRS} "
            "are possible"
        )


def _check_memory(count: int, size: int) -> None:
    """Raise unless so many worlds of a size in bytes exist and fit into half of the free memory."""
    check_size(count, size)
    if SIMULATED:
        return
    fits = torch.cuda.mem_get_info(0)[0] // (2 * size)
    if count > fits:
        raise InputError(
            f"num_envs = {count}: {size} bytes per world; half of the GPU's free memory holds {fits} worlds"
        )


@contextmanager
def _unfused() -> Iterator[None]:
    """Compile without fused multiply-add, which NVVM has an option for, but ``cuda.jit`` has not."""
    if SIMULATED:
        yield
        return
    from numba.cuda.cudadrv import nvvm

    compile_ir = nvvm.compile_ir
    nvvm.compile_ir = lambda *code, **options: compile_ir(*code, **options, fma=0)
    try:
        yield
    finally:
        nvvm.compile_ir = compile_ir


def _hand_over(tensor: torch.Tensor) -> Any:
    """Return a tensor as the kernel takes it, over the same memory."""
    return cuda.as_cuda_array(tensor) if tensor.is_cuda else tensor.numpy()


def _replace_arrays(arrays: Any, replace: Callable[[Any], Any]) -> Any:
    """Return a NamedTuple with its arrays or tensors replaced, those of NamedTuples in it too, and its numbers kept."""

    def renew(each: Any) -> Any:
        if isinstance(each, tuple):
            return _replace_arrays(each, replace)
        return replace(each) if hasattr(each, "shape") else each

    return type(arrays)(*map(renew, arrays))


def _type_strided(arrays: Any) -> types.BaseTuple:
    """Return the numba type of a NamedTuple of arrays whose axes lie in any order in memory."""
    kinds = [typeof(array).copy(layout="A") for array in arrays]
    return types.BaseTuple.from_types(kinds, type(arrays))
