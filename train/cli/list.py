"""The ``impact list`` command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from impact_envs.scenario import list_scenarios, load_scenario


@dataclass
class Command:
    """List the shipped scenarios."""

    extras: ClassVar[tuple[str, ...]] = ()
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return one entry per scenario."""
        from impact_envs import gym_id

        scenarios = [load_scenario(name) for name in list_scenarios()]
        return {
            "scenarios": [
                {
                    "name": s.name,
                    "domain": s.domain,
                    "gym_id": gym_id(s.name),
                    "horizon": s.horizon,
                    "agents": list(s.agents),
                    "description": s.description,
                }
                for s in scenarios
            ]
        }
