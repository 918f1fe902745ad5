"""What a replay of two arms needs besides the poses of their pads."""

from __future__ import annotations

from typing import Any

from impact_envs.dual_arm.schema import DualArmScenario


def describe_links(scenario: DualArmScenario) -> dict[str, Any]:
    """Return arm to ``base``, ``lengths`` and ``elbow``: they place its joints by the pose of its pad."""
    lengths = list(scenario.links.lengths)
    return {n: {"base": list(arm.base), "lengths": lengths, "elbow": arm.elbow} for n, arm in scenario.arms.items()}
