"""The impact law, in generalised coordinates; discs and point masses are special cases.

The scalar functions are compiled, and all engines and planners call them; those of arrays serve the engines that are
not compiled.

Sign convention: the normal is a unit vector from body a to body b, and the impulse along it acts on b. The
speed of approach is positive when the bodies close in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import exp

Point = tuple[float, float]
# Gauss-Seidel on simultaneous contacts: last change, relative to the largest impulse, and the most sweeps.
SMALL_CHANGE, SWEEPS = 1e-14, 1000


@dataclass(frozen=True)
class Impact:
    """One impact of two bodies.

    Attributes:
        time: since reset [s].
        a: name of the first body; of the wall or obstacle if one is fixed.
        b: name of the second body.
        point: where they touch, shape (2,) [m].
        normal: unit vector from a to b, shape (2,).
        impulse: acting on b, shape (2,) [N s].
        speed: of approach along the normal [m/s].
    """

    time: float
    a: str
    b: str
    point: Point
    normal: Point
    impulse: Point
    speed: float


@dataclass(frozen=True)
class LastingContact:
    """What two bodies that rest on each other exchanged in one control period.

    With the impulses of the impacts it balances the momentum of every body.

    Attributes:
        time: since reset, at the end of the control period [s].
        a: name of the first body; of the wall or obstacle if one is fixed.
        b: name of the second body.
        impulse: acting on b, shape (2,) [N s].
    """

    time: float
    a: str
    b: str
    impulse: Point


class Side(NamedTuple):
    """One body at an impact.

    Attributes:
        jacobian: J of the contact point, whose velocity is J v, shape (d, n).
        mass_matrix: M, shape (n, n).
        velocity: generalised velocity v, shape (n,).
    """

    jacobian: np.ndarray
    mass_matrix: np.ndarray
    velocity: np.ndarray


@compiled
def compute_restitution(speed: float, restitution: float, restitution_speed: float = 0.0) -> float:
    """Return the coefficient of restitution at a speed of approach.

    e(v) = e_0 exp(-v / v_e), or e_0 if v_e = 0.

    Args:
        speed: of approach v [m/s].
        restitution: e_0, at zero speed.
        restitution_speed: v_e at which e has fallen to 1/2.72 of e_0 [m/s]; 0 = constant.

    Returns:
        e in [0, 1].

    Source: ours; restitution falls with impact speed, Stronge, *Impact Mechanics* (2000), ch. 6.
    """
    return restitution * exp(-speed / restitution_speed) if restitution_speed > 0 else restitution


@compiled
def is_rebound(speed: float, press: float, low_speed: float, contact_time: float) -> bool:
    """Return whether an impact is more than the start of a lasting contact.

    It is none when it is slow, or when the bodies are pressed together so hard that even the full rebound would end
    within a contact time: without such a rule, bounces crowd without end.

    Args:
        speed: of approach [m/s].
        press: acceleration at which the gap closes in free flight [m/s^2].
        low_speed: slower is never an impact [m/s].
        contact_time: shorter is no rebound [s].
    """
    return speed > max(low_speed, press * contact_time / 2)


@compiled
def compute_velocity_gain(restitution: float, mass: float, other_mass: float) -> float:
    """Return what an impact with a body of some mass changes the other one's speed by, per speed of approach.

    alpha = (1 + e) m / (m + m_other), which is (1 + e) m_eff / m_other.

    Args:
        restitution: e.
        mass: m, of the body that hits, for example the robot [kg].
        other_mass: m_other, of the body whose speed changes, for example the object [kg].

    Returns:
        alpha in v_other+ = v_other- + alpha ((v- - v_other-) . n) n.

    Source: Verhagen & Tumova, Eq. 6.
    """
    return (1.0 + restitution) * mass / (mass + other_mass)


def compute_mass_fractions(
    robot_mass: float, object_mass: float, restitution: float
) -> tuple[float, float, float, float]:
    """Return m1..m4 with v_R^+ = m1 v_R^- + m2 v_O^- and v_O^+ = m3 v_R^- + m4 v_O^-.

    Args:
        robot_mass: m_R [kg].
        object_mass: m_O [kg].
        restitution: e.

    Returns:
        The four mass fractions.

    Source: Verhagen & Tumova, Eq. 5.
    """
    total = robot_mass + object_mass
    return (
        (robot_mass - restitution * object_mass) / total,
        compute_velocity_gain(restitution, object_mass, robot_mass),
        compute_velocity_gain(restitution, robot_mass, object_mass),
        (object_mass - restitution * robot_mass) / total,
    )


@compiled
def project_impulse(old: float, excess: float, mobility: float, low: float, high: float) -> float:
    """Return a contact's impulse after one Gauss-Seidel step: p = old - excess / W, kept between low and high.

    Args:
        old: impulse so far [N s].
        excess: speed of the contact with it, minus its goal [m/s].
        mobility: W, inverse of the mass that the impulse feels [1/kg].
        low, high: 0 and infinity along a normal; minus and plus the bound of friction along a tangent [N s].
    """
    return min(max(old - excess / mobility, low), high)


def compute_effective_mass(normal: np.ndarray, sides: Sequence[Side]) -> float:
    """Return the mass that the normal impulse feels.

    1 / m_eff = sum over the bodies of n J M^-1 J' n'.

    Args:
        normal: n, shape (d,).
        sides: the movable bodies, one or two.

    Returns:
        m_eff [kg].

    Source: Nekoo, Sharf & Ollero, *Free-floating space manipulator impacting a floating object*.
    """
    rows = [normal @ side.jacobian for side in sides]
    return 1.0 / float(sum(row @ np.linalg.solve(s.mass_matrix, row) for row, s in zip(rows, sides, strict=True)))


def compute_impulse(normal: np.ndarray, a: Side, b: Side | None, restitution: float) -> float:
    """Return the frictionless impulse of one impact.

    p = (1 + e) m_eff v_rel with v_rel = n (J_a v_a - J_b v_b), and 0 if the bodies part.

    Args:
        normal: n from a to b, shape (d,).
        a: first body.
        b: second body, None if it cannot move.
        restitution: e.

    Returns:
        Impulse along n, acting on b [N s].

    Source: Newton's law of restitution in generalised coordinates.
    """
    sides = [a] if b is None else [a, b]
    approach = normal @ a.jacobian @ a.velocity
    if b is not None:
        approach -= normal @ b.jacobian @ b.velocity
    return (1 + restitution) * compute_effective_mass(normal, sides) * max(float(approach), 0.0)


def apply_impulse(side: Side, impulse: np.ndarray) -> np.ndarray:
    """Return the generalised velocity after an impulse at the contact point.

    v+ = v- + M^-1 J' p.

    Args:
        side: the body before the impact.
        impulse: p acting on this body, shape (d,) [N s].

    Returns:
        v+, shape (n,).
    """
    return side.velocity + np.linalg.solve(side.mass_matrix, side.jacobian.T @ impulse)


def solve_contacts(
    normals: np.ndarray,
    mass_matrix: np.ndarray,
    velocity: np.ndarray,
    restitution: np.ndarray,
    tangents: np.ndarray | None = None,
    friction: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Solve contacts that happen at the same instant.

    Per contact, with u = N v the speed of separation and W = N M^-1 N':
    0 <= p  is complementary to  u+ + e u- >= 0,  and  |q| <= mu p  with  q  stopping the slip left when
    compression ends, where it can. One contact without friction is ``compute_impulse``. Frictionless contacts
    add the energy sum p u- (1 - e) / 2, which is never positive if all close in, or if all have the same e.
    One contact with friction is the algebraic law of Chatterjee & Ruina with tangential restitution 0, which
    never gains energy either (stopping the slip left when restitution ends would, wherever normal and
    tangential motion are coupled).

    Args:
        normals: N, one row per contact, u = N v positive when parting, shape (k, n).
        mass_matrix: M, shape (n, n).
        velocity: v-, shape (n,).
        restitution: e of each contact, shape (k,).
        tangents: T, rows of the slip speed T v, shape (k, n); needed with friction.
        friction: mu.

    Returns:
        Normal impulses p and tangential impulses q, shape (k,) each [N s]; v+ = v- + M^-1 (N' p + T' q).

    Source: Newton's law as a linear complementarity problem, Moreau (1988); projected Gauss-Seidel.
        Chatterjee & Ruina, *A New Algebraic Rigid-Body Collision Law Based on Impulse Space Considerations*
        (1998).
    """
    k = len(normals)
    to_velocity = np.linalg.solve(mass_matrix, normals.T)
    separation = normals @ velocity
    goal = -restitution * separation
    W = normals @ to_velocity
    p = _gauss_seidel(W, separation, goal)
    if friction == 0 or tangents is None:
        return p, np.zeros(k)
    compression = _gauss_seidel(W, separation, np.zeros(k))
    rows = np.vstack([normals, tangents])
    slip_goal = tangents @ to_velocity @ (p - compression)
    W = rows @ np.linalg.solve(mass_matrix, rows.T)
    both = _gauss_seidel(W, rows @ velocity, np.concatenate([goal, slip_goal]), friction)
    return both[:k], both[k:]


def _gauss_seidel(W: np.ndarray, speed: np.ndarray, goal: np.ndarray, friction: float | None = None) -> np.ndarray:
    """Solve for impulses p with speed + W p = goal, or as near as their bounds let it be.

    Normal impulses come first and are >= 0; with friction, as many tangential ones follow, bounded by
    friction times theirs.
    """
    n = len(W)
    k = n if friction is None else n // 2
    p, u, rows = [0.0] * n, (speed - goal).tolist(), W.tolist()
    # Plain numbers: contacts are one to four, where array overhead costs more than the sums.
    for _ in range(SWEEPS):
        change = 0.0
        for i, row in enumerate(rows):
            limit = math.inf if friction is None or i < k else friction * p[i - k]
            new = project_impulse(p[i], u[i], row[i], 0.0 if i < k else -limit, limit)
            step = new - p[i]
            if step != 0.0:
                p[i] = new
                u = [speed + w * step for speed, w in zip(u, row, strict=True)]
                change = max(change, abs(step))
        if n == 1 or change <= SMALL_CHANGE * max(map(abs, p)):
            break
    return np.array(p)


def compute_planar_jacobian(arm: np.ndarray) -> np.ndarray:
    """Return J of a point of a planar rigid body with v = (vx, vy, omega).

    Args:
        arm: from the centre of mass to the point, shape (2,) [m].

    Returns:
        J, shape (2, 3).
    """
    return np.array([[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]]])
