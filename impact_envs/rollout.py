"""One rollout for tests, training callbacks and evaluation: a policy acts, an Episode says what happened."""

from __future__ import annotations

import time
from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:  # reading a scenario does not wait for the compiler
    from impact_envs.physics.impact import Impact, LastingContact


@dataclass
class Diagnostics:
    """What a policy says of its own work in one episode.

    Attributes:
        solve_seconds: computing time of each control step [s].
        fallbacks: name of a fallback to how often it was used.
        replans: how often a plan was changed on the way.
        reoptimised: how often what is left of the task was optimised anew, name of the method to count.
    """

    solve_seconds: list[float] = field(default_factory=list)
    fallbacks: Counter[str] = field(default_factory=Counter)
    replans: int = 0
    reoptimised: Counter[str] = field(default_factory=Counter)


class Policy(Protocol):
    """Anything that acts: expert, learner, residual sum, zero, random."""

    name: str

    def reset(self, seed: int) -> None:
        """Forget the last episode; all randomness of the next one comes from the seed."""

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each agent's action in [-1, 1]."""

    def diagnostics(self) -> Diagnostics:
        """Return what happened inside since reset."""


class ZeroPolicy:
    """No control at all."""

    name = "zero"

    def __init__(self, env: Any) -> None:
        self._actions = {agent: np.zeros(env.action_space(agent).shape) for agent in env.possible_agents}

    def reset(self, seed: int) -> None:
        """Do nothing: there is nothing to forget."""

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return zeros."""
        return {agent: self._actions[agent].copy() for agent in observations}

    def diagnostics(self) -> Diagnostics:
        """Return empty diagnostics."""
        return Diagnostics()


class RandomPolicy:
    """Uniform actions drawn from the episode's seed."""

    name = "random"

    def __init__(self, env: Any) -> None:
        self._sizes = {agent: env.action_space(agent).shape for agent in env.possible_agents}
        self._rng = np.random.default_rng(0)

    def reset(self, seed: int) -> None:
        """Seed the generator (apart from the world's, which has the same seed)."""
        self._rng = np.random.default_rng([seed, 1])

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return uniform actions."""
        return {agent: self._rng.uniform(-1.0, 1.0, self._sizes[agent]) for agent in observations}

    def diagnostics(self) -> Diagnostics:
        """Return empty diagnostics."""
        return Diagnostics()


@dataclass(frozen=True)
class Episode:
    """What happened in one episode; signals are true values, not measurements.

    Attributes:
        scenario, policy, seed: who did what, where.
        period: control period [s].
        times: shape (T+1,) [s].
        signals: name (``pop.x``) to values, shape (T+1,).
        actions: agent to actions in [-1, 1], shape (T, size).
        rewards: agent to rewards, shape (T,).
        impacts: in order of time.
        robustness_bounds: interval of robustness still possible, shape (T+1, 2) [m].
        robustness, success: of the whole formula on the true signals, as the environment's last infos say [m].
        effort: propulsion spent, sum of |F| dt over robots [N s].
        solve_seconds: the policy's computing time per control step, shape (n,) [s].
        fallbacks: the policy's fallbacks, name to count.
        replans: how often the policy changed its plan.
        wall_seconds: duration of the rollout [s].
        reoptimised: how often the policy optimised what is left of the task anew, method to count.
        failure: why the simulation failed; "" where it did not. Robustness is then the lowest, minus the world's
            diagonal.
        lasting_contacts: what bodies that rest on each other exchanged, one record for each pair and control period;
            with the impacts it balances momentum.
    """

    scenario: str
    policy: str
    seed: int
    period: float
    times: np.ndarray
    signals: Mapping[str, np.ndarray]
    actions: Mapping[str, np.ndarray]
    rewards: Mapping[str, np.ndarray]
    impacts: tuple[Impact, ...]
    robustness_bounds: np.ndarray
    robustness: float
    success: bool
    effort: float
    solve_seconds: np.ndarray
    fallbacks: Mapping[str, int]
    replans: int
    wall_seconds: float
    reoptimised: Mapping[str, int] = field(default_factory=dict)
    failure: str = ""
    lasting_contacts: tuple[LastingContact, ...] = ()

    def save(self, path: str | Path) -> tuple[Path, ...]:
        """Write the episode for other programs, in SI units.

        ``.npz``: one archive: times, signals by name, ``AGENT.actions``, ``AGENT.rewards``, ``robustness_bounds``,
        ``impacts.time`` and so on, and ``facts``, JSON text of all that is one number or word. ``.csv``, ``.parquet``:
        a table with a row for each time (actions and rewards stand in the row where their step begins; the last row has
        none), beside it a table ``FILE.impacts`` and ``FILE.facts.json``.

        Args:
            path: of the file; its suffix says which.

        Returns:
            The files written, that of the trajectory first.

        Raises:
            InputError: unknown suffix, or a file that cannot be written.
        """
        from impact_envs.interface.episode_file import save_episode

        return save_episode(self, path)


def rollout(env: Any, policy: Policy, seed: int, on_step: Any = None) -> Episode:
    """Run one episode.

    Args:
        env: an ImpactEnv, or a Gymnasium environment made from one.
        policy: who acts.
        seed: of world and policy.
        on_step: called with the environment after reset and every step, for example to record frames.

    Returns:
        The episode. If ``max_cycles`` cut the horizon, robustness is the lower bound of what was still possible.
        The verdict is the environment's own, see ImpactEnv.
    """
    env = getattr(env.unwrapped, "parallel", env)
    start = time.perf_counter()
    observations, infos = env.reset(seed=seed)
    policy.reset(seed)
    names, bounds, actions, rewards = list(env.signals), [env.bounds], [], []
    values = array("d", env.signals.values())  # of all samples: a dict for each would fill the memory
    impacts: list[Impact] = []
    contacts: list[LastingContact] = []
    if on_step:
        on_step(env)
    while env.agents:
        chosen = policy.act(observations)
        observations, reward, _, _, infos = env.step(chosen)
        values.extend(env.signals.values())
        bounds.append(env.bounds)
        actions.append(chosen)
        rewards.append(reward)
        impacts += env.impacts
        contacts += env.lasting_contacts
        if on_step:
            on_step(env)
    scenario, diagnostics = env.scenario, policy.diagnostics()
    traces = dict(zip(names, np.array(values).reshape(len(bounds), -1).T.copy(), strict=True))
    failed = env.failure is not None
    verdict = next(iter(infos.values()))
    return Episode(
        scenario=scenario.name,
        policy=policy.name,
        seed=seed,
        period=scenario.control_period,
        times=np.arange(len(bounds)) * scenario.control_period,
        signals=traces,
        actions={name: np.array([action[name] for action in actions]) for name in scenario.agents},
        rewards={name: np.array([reward[name] for reward in rewards]) for name in scenario.agents},
        impacts=tuple(impacts),
        robustness_bounds=np.array(bounds),
        robustness=verdict["robustness"],
        success=verdict["success"],
        effort=env.impulse,
        solve_seconds=np.array(diagnostics.solve_seconds),
        fallbacks=dict(diagnostics.fallbacks),
        replans=diagnostics.replans,
        wall_seconds=time.perf_counter() - start,
        reoptimised=dict(diagnostics.reoptimised),
        failure=str(env.failure) if failed else "",
        lasting_contacts=tuple(contacts),
    )
