"""What agents are rewarded for: change of a potential, robustness at the end, and effort.

The only place of these formulas: the single environment, the batched step and the learner's wrapper call the same
compiled functions. To change the reward, change this file.

Two rewards differ in the potential phi. Both sum up to phi(end) - phi(start) + robustness, and where the formula is
decided at the end both potentials are the robustness there: what is asked for is the same, up to a constant of the
start.

``robustness``: phi is the middle of the interval of robustness still possible. Where something must hold at the end,
that stays the same until then. gamma = 1: at .99 a reward 1000 steps away counts 4e-5 of itself.

``progress``: phi is the robustness that would be reached if every body flew on as it moves now (`flight.py`), so that
a throw is rewarded when it is thrown. gamma = .999: what an action does to the flight shows at the next impact or
within `flight.EVERY`, so that a horizon of 1000 steps is long, and values vary less than at 1. The difference has no
gamma in it, as that keeps the sum what it is; at .999 it differs from gamma phi' - phi, which Ng et al. ask for, by
.001 phi' each step.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.domain import find_part
from impact_envs.errors import InputError, choices

ROBUSTNESS, PROGRESS = REWARDS = ("robustness", "progress")

# A full-thrust step of every actuator costs this much robustness per control period.
EFFORT_WEIGHT = 1e-4  # [m]


@compiled
def compute_effort(action: np.ndarray) -> float:
    """Return the mean square of an action that is clipped to [-1, 1]: effort = sum(u^2) / n, in [0, 1].

    Args:
        action: u, shape (n,).
    """
    total = 0.0
    for i in range(len(action)):
        u = min(max(float(action[i]), -1.0), 1.0)
        total += u * u
    return total / len(action)


@compiled
def compute_potential(low: float, high: float) -> float:
    """Return the middle of the interval of robustness still possible, phi = (low + high) / 2 [m].

    Args:
        low, high: bounds of the interval [m].

    Source: potential-based shaping, Ng, Harada & Russell (1999).
    """
    return (low + high) / 2


@compiled
def compute_team_reward(before: tuple[float, float], after: tuple[float, float], over: bool) -> float:
    """Return the team's reward of one control period, phi' - phi, plus the robustness reached where it is the last.

    Args:
        before, after: intervals of robustness still possible, at the start and at the end of the period [m].
        over: the episode ends; the lower bound is then the robustness that is certain.

    Returns:
        Reward before effort, shared equally by the agents [m].
    """
    return (after[0] + after[1] - (before[0] + before[1])) / 2 + (after[0] if over else 0.0)


@compiled
def compute_progress_reward(before: float, after: float, robustness: float, over: bool) -> float:
    """Return the team's reward of one control period, phi' - phi, plus the robustness reached where it is the last.

    Args:
        before, after: robustness that would be reached if every body flew on, at the start and at the end of the
            period, clipped to the world's diagonal [m].
        robustness: that is certain, the lower bound [m].
        over: the episode ends.

    Returns:
        Reward before effort, shared equally by the agents [m].
    """
    return after - before + (robustness if over else 0.0)


@compiled
def compute_reward(team: float, agents: int, effort: float) -> float:
    """Return an agent's reward of one control period, r = team / agents - EFFORT_WEIGHT effort [m].

    Args:
        team: from `compute_team_reward` [m].
        agents: that share it.
        effort: of this agent, as its task counts it, in [0, 1].
    """
    return team / agents - EFFORT_WEIGHT * effort


def find_rates(reward: str, domain: str) -> dict[str, str] | None:
    """Return what `flight.py` needs for a reward: a body's signals to their rates of change; None if nothing.

    Args:
        reward: one of `REWARDS`.
        domain: of the scenario.

    Raises:
        InputError: the reward is unknown, or bodies of the domain do not fly freely.
    """
    if reward not in REWARDS:
        raise InputError(f"reward '{reward}' is unknown; {choices(reward, REWARDS)}")
    if reward == ROBUSTNESS:
        return None
    rates: dict[str, str] | None = find_part("impact_envs", domain, "RATES")
    if rates is None:
        raise InputError(f"reward '{reward}': bodies of domain '{domain}' do not fly freely; choose '{ROBUSTNESS}'")
    return rates
