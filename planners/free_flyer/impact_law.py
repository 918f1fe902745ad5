"""The impact law of two discs as the planner uses it: velocities after from velocities before."""

from __future__ import annotations

from impact_envs.compiled import compiled


@compiled
def compute_velocity_gain(restitution: float, robot_mass: float, object_mass: float) -> float:
    """Return the object's change of speed per approach speed.

    alpha = (1 + e) m_R / (m_R + m_O)

    Args:
        restitution: coefficient of restitution e.
        robot_mass: m_R [kg].
        object_mass: m_O [kg].

    Returns:
        alpha in v_O+ = v_O- + alpha ((v_R- - v_O-) . n) n.

    Source: Verhagen & Tumova, Eq. 6.
    """
    return (1.0 + restitution) * robot_mass / (robot_mass + object_mass)


def compute_mass_fractions(
    robot_mass: float, object_mass: float, restitution: float
) -> tuple[float, float, float, float]:
    """Return m1..m4 with v_R^+ = m1 v_R^- + m2 v_O^- and v_O^+ = m3 v_R^- + m4 v_O^-.

    Args:
        robot_mass: m_R [kg].
        object_mass: m_O [kg].
        restitution: coefficient of restitution e.

    Returns:
        The four mass fractions.

    Source: Verhagen & Tumova, Eq. (5).
    """
    total = robot_mass + object_mass
    return (
        (robot_mass - restitution * object_mass) / total,
        (1 + restitution) * object_mass / total,
        (1 + restitution) * robot_mass / total,
        (object_mass - restitution * robot_mass) / total,
    )
