"""What the expert has learned of masses, impacts and drift by the end of an episode."""

from __future__ import annotations

from typing import Any

from impact_envs.rollout import Episode
from train.free_flyer.flight_record import FlightRecord


def compute_figures(record: FlightRecord, episode: Episode) -> dict[str, Any]:
    """Return the expert's estimates at the end, none of another policy.

    Args:
        record: what was watched.
        episode: the same one.

    Returns:
        ``estimates``: a row for each pair of robot and object, with ``restitution``, ``mass`` of the object [kg] by
        the believed mass of the robot, their standard deviations, and ``drift`` of the object, shape (2,) [m/s^2].
    """
    expert, scenario = record.expert, record.scenario
    if expert is None:
        return {}
    drifts = expert.memory.filter[0, len(scenario.robots) :]["drift"]
    drift_of = dict(zip(scenario.objects, drifts.tolist(), strict=True))
    rows = []
    for (robot, item), pair in expert.estimates().items():
        mass = scenario.robots[robot].mass
        rows.append(
            {
                "robot": robot,
                "object": item,
                "restitution": pair.restitution,
                "restitution_spread": pair.restitution_spread,
                "mass": mass * pair.mass_ratio,
                "mass_spread": mass * pair.mass_ratio_spread,
                "drift": drift_of[item],
            }
        )
    return {"estimates": rows}
