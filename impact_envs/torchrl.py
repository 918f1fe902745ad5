"""Many worlds as a TorchRL ``EnvBase``, over the compiled engine; needs ``pip install 'impact-envs[torchrl]'``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_marl_grouping

from impact_envs.domain import find_part
from impact_envs.scenario import Scenario, load_scenario
from impact_envs.vector import vector_env

ALL = "agents"  # the group of agents that are alike


class ImpactTorchEnv(EnvBase):
    """ImpactVectorEnv for TorchRL: batch size (num_envs,), agents in groups, partial resets; no autoreset.

    Each group has ``observation``, shape (num_envs, agents, size); ``action`` in [-1, 1], shape (num_envs, agents, 3);
    ``reward``, shape (num_envs, agents, 1). ``done``, ``terminated``, ``truncated`` are of worlds, shape (num_envs, 1).
    ``info`` has ``is_success`` and ``robustness`` (the middle of the interval still possible) of worlds. After
    ``set_seed(s)`` and ``reset`` world k is ImpactEnv with seed s + k.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        num_envs: how many worlds.
        suite: mismatch suite of the true world.
        max_cycles: truncate earlier than the horizon [control periods].
        group_map: group to its agents; a policy is mostly shared within one. Default: as the domain says, else one.
        state: give the true state too, ``state``, shape (num_envs, size), for centralised critics.
        dtype: of observations and of what the worlds store.
        threads: that share the worlds; all cores if not given.
        device: of the tensors, and of the engine.

    Raises:
        ScenarioError: the scenario or the suite cannot be read.
        InputError: polygons, or more worlds than fit into memory.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int = 1,
        suite: str = "nominal",
        max_cycles: int | None = None,
        group_map: Mapping[str, Sequence[str]] | None = None,
        state: bool = False,
        dtype: Literal["float64", "float32"] = "float32",
        threads: int | None = None,
        device: Any = "cpu",
    ) -> None:
        loaded = load_scenario(scenario).suite(suite)
        device = torch.device(device)
        super().__init__(device=device, batch_size=torch.Size((num_envs,)))
        self.scenario, self.num_envs, self._with_state = loaded, num_envs, state
        self.worlds = vector_env(
            loaded,
            num_envs,
            autoreset_mode=AutoresetMode.DISABLED,
            max_cycles=max_cycles,
            dtype=dtype,
            threads=threads,
            per_robot=True,
            device=device.type,
        )
        self.max_steps = min(max_cycles or loaded.steps, loaded.steps)
        self.group_map = {name: list(members) for name, members in (group_map or _group(loaded)).items()}
        check_marl_grouping(self.group_map, list(loaded.agents))
        self._places = {
            group: [loaded.agents.index(name) for name in members] for group, members in self.group_map.items()
        }
        self._columns: dict[str, torch.Tensor] = {}  # of the joint action, shape (agents, width)
        self._next_seed: int | None = None
        self._make_specs(getattr(torch, dtype))

    def _make_specs(self, dtype: torch.dtype) -> None:
        n, batch, device = self.num_envs, self.worlds.batch, self.device
        agents, spaces = self.scenario.agents, batch.task.action_spaces
        *starts, self._width = accumulate((spaces[name].shape[0] for name in agents), initial=0)
        observations, actions, rewards = (Composite(shape=(n,), device=device) for _ in range(3))
        for group, places in self._places.items():
            shape, width = (n, len(places)), spaces[agents[places[0]]].shape[0]
            columns = [list(range(starts[place], starts[place] + width)) for place in places]
            self._columns[group] = torch.tensor(columns, device=device)
            seen = Unbounded((*shape, batch.agent_size), dtype=dtype, device=device)
            done = Bounded(-1.0, 1.0, (*shape, width), dtype=torch.float32, device=device)
            earned = Unbounded((*shape, 1), dtype=torch.float32, device=device)
            for spec, key, value in ((observations, "observation", seen), (actions, "action", done)):
                spec[group] = Composite({key: value}, shape=shape, device=device)
            rewards[group] = Composite({"reward": earned}, shape=shape, device=device)
        told = {
            "is_success": Binary(1, (n, 1), dtype=torch.bool, device=device),
            "robustness": Unbounded((n, 1), dtype=torch.float32, device=device),
        }
        observations["info"] = Composite(told, shape=(n,), device=device)
        if self._with_state:
            size = self.worlds.state_layout().size
            observations["state"] = Unbounded((n, size), dtype=torch.float32, device=device)
        self.observation_spec, self.action_spec, self.reward_spec = observations, actions, rewards
        ends = {
            name: Binary(1, (n, 1), dtype=torch.bool, device=device) for name in ("done", "terminated", "truncated")
        }
        self.done_spec = Composite(ends, shape=(n,), device=device)

    def _reset(self, tensordict: TensorDictBase | None = None, **options: Any) -> TensorDictBase:
        chosen = None if tensordict is None else tensordict.get("_reset", None)
        mask = None if chosen is None else chosen.reshape(self.num_envs).cpu().numpy()
        if mask is not None and not mask.any():
            mask = np.ones(self.num_envs, bool)
        seed, self._next_seed = self._next_seed, None
        _, infos = self.worlds.reset(seed=seed, options=None if mask is None else {"reset_mask": mask})
        alive = torch.zeros((self.num_envs, 1), dtype=torch.bool, device=self.device)
        ends = {name: alive.clone() for name in ("done", "terminated", "truncated")}
        return self._wrap({**self._look(infos), **ends})

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        actions = torch.empty((self.num_envs, self._width), dtype=torch.float32, device=self.device)
        for group, columns in self._columns.items():
            actions[:, columns] = tensordict.get((group, "action")).to(torch.float32)
        _, _, terminated, truncated, infos = self.worlds.step(actions)
        seen, rewards = self._look(infos), self.worlds.agent_rewards.to(torch.float32).unsqueeze(-1)
        for group, places in self._places.items():
            seen[group].set("reward", rewards if len(self._places) == 1 else rewards[:, places])
        over = terminated | truncated
        ends = {"done": over, "terminated": terminated, "truncated": truncated}
        return self._wrap({**seen, **{name: value.unsqueeze(-1) for name, value in ends.items()}})

    def _set_seed(self, seed: int | None) -> None:
        self._next_seed = seed

    def _look(self, infos: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is seen of all worlds, by TorchRL's keys."""
        everything, n = self.worlds.agent_observations, self.num_envs
        seen: dict[str, Any] = {
            group: TensorDict(
                {"observation": everything if len(self._places) == 1 else everything[:, places]},
                batch_size=(n, len(places)),
                device=self.device,
            )
            for group, places in self._places.items()
        }
        middle = (infos["robustness_lower"] + infos["robustness_upper"]).to(torch.float32) / 2
        told = {"is_success": infos["is_success"].unsqueeze(-1), "robustness": middle.unsqueeze(-1)}
        seen["info"] = TensorDict(told, batch_size=(n,), device=self.device)
        if self._with_state:
            seen["state"] = self.worlds.state().to(torch.float32)
        return seen

    def _wrap(self, content: dict[str, Any]) -> TensorDictBase:
        return TensorDict(content, batch_size=self.batch_size, device=self.device)

    def close(self, **options: Any) -> None:
        """Let the threads go."""
        self.worlds.close()
        super().close(**options)


def _group(scenario: Scenario) -> dict[str, Sequence[str]]:
    """Return which agents are alike: those of one group, unless the domain says that each plays another part."""
    groups = find_part("impact_envs", scenario.domain, "GROUPS") or {}
    known = {group: [name for name in members if name in scenario.agents] for group, members in groups.items()}
    return {group: members for group, members in known.items() if members} or {ALL: scenario.agents}
