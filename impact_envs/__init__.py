"""Robots that move free-floating objects by hitting them: environments with exact impacts and STL tasks.

The public door. Importing it registers the ids with Gymnasium and PettingZoo, and loads no solver and no learner.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium
import pettingzoo

from impact_envs.errors import FormulaError, InputError, ResetNeeded, ScenarioError

# Bound here, not lazily: the function shares its name with its module.
from impact_envs.rollout import Diagnostics, Episode, Policy, rollout
from impact_envs.scenario import Scenario, list_scenarios, load_scenario

if TYPE_CHECKING:
    from impact_envs.env import ImpactEnv, parallel_env
    from impact_envs.function_policy import JointPolicy, SharedPolicy
    from impact_envs.joint import JointEnv
    from impact_envs.vector import ImpactVectorEnv, vector_env

__version__ = "0.1.0"

__all__ = [
    "Diagnostics",
    "Episode",
    "FormulaError",
    "ImpactEnv",
    "ImpactVectorEnv",
    "InputError",
    "JointEnv",
    "JointPolicy",
    "Policy",
    "ResetNeeded",
    "Scenario",
    "ScenarioError",
    "SharedPolicy",
    "gym_id",
    "list_scenarios",
    "load_scenario",
    "parallel_env",
    "rollout",
    "vector_env",
]

# Names loaded when first used, so that reading a scenario needs no simulator.
_LAZY = {
    "ImpactEnv": "env",
    "ImpactVectorEnv": "vector",
    "JointEnv": "joint",
    "JointPolicy": "function_policy",
    "SharedPolicy": "function_policy",
    "parallel_env": "env",
    "vector_env": "vector",
}
# Scenario names whose Gymnasium id is not their words capitalised.
_TITLES = {"pingpong": "PingPong"}
# Raised when episodes change, by the id without its version; 0 where not listed. Frozen in tests/frozen.
_VERSIONS = {
    "Corridor": 3,
    "CorridorResidual": 5,
    "Crew": 4,
    "CrewResidual": 5,
    "DualArmGrasp": 2,
    "DualArmGraspResidual": 2,
    "Exchange": 3,
    "ExchangeResidual": 5,
    "FloatingManipulator": 2,
    "FloatingManipulatorNearGoal": 2,
    "FloatingManipulatorNearGoalResidual": 3,
    "FloatingManipulatorPassive": 2,
    "FloatingManipulatorPassiveResidual": 3,
    "FloatingManipulatorResidual": 3,
    "FloatingManipulatorThrusters": 2,
    "FloatingManipulatorThrustersResidual": 3,
    "ObstacleAvoidance": 3,
    "ObstacleAvoidanceResidual": 5,
    "PingPong": 3,
    "PingPongResidual": 5,
    "Pong": 3,
    "PongResidual": 5,
    "Relay": 3,
    "RelayResidual": 5,
    "ThrowAndCatch": 2,
    "ThrowAndCatchResidual": 5,
}


def gym_id(scenario: str, residual: bool = False) -> str:
    """Return the Gymnasium id of a shipped scenario, for example ``impact_envs/ThrowAndCatch-v2``."""
    title = _TITLES.get(scenario) or "".join(word.capitalize() for word in scenario.split("_"))
    title += "Residual" if residual else ""
    return f"impact_envs/{title}-v{_VERSIONS.get(title, 0)}"


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"impact_envs.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'impact_envs' has no attribute '{name}'")


for _name in list_scenarios():
    for _kind in ("parallel", "aec"):
        pettingzoo.register(_kind, gym_id(_name), f"impact_envs.env:{_kind}_env", kwargs={"scenario": _name})
    gymnasium.register(
        gym_id(_name),
        "impact_envs.joint:JointEnv",
        vector_entry_point="impact_envs.vector:ImpactVectorEnv",
        kwargs={"scenario": _name},
    )
    gymnasium.register(
        gym_id(_name, residual=True),
        "agents.residual:ResidualEnv",
        vector_entry_point="agents.residual_vector:ResidualVectorEnv",
        kwargs={"scenario": _name},
    )
