"""What agents are rewarded for: change of robustness, robustness at the end, and effort.

The only place of these formulas: the single environment, the batched step and the learner's wrapper call the same
compiled functions. To change the reward, change this file.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled

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
def compute_reward(team: float, agents: int, effort: float) -> float:
    """Return an agent's reward of one control period, r = team / agents - EFFORT_WEIGHT effort [m].

    Args:
        team: from `compute_team_reward` [m].
        agents: that share it.
        effort: of this agent, as its task counts it, in [0, 1].
    """
    return team / agents - EFFORT_WEIGHT * effort
