"""The longest integration step with which the springs of joints and contacts stay stable under Runge-Kutta 4.

Friction is left out: its force is bounded, so that too long a step makes it inexact, not unstable.
"""

from __future__ import annotations

import numpy as np

from impact_envs.dual_arm.arm import C11, C12, C13, C22, C23, C33, L1, L2, L3

# Angles of a joint at which the arm's inertia is looked at.
ANGLES = np.linspace(-np.pi, np.pi, 13)
FARTHEST = 4.0  # no |step x eigenvalue| beyond this is stable under Runge-Kutta 4
BISECTIONS = 40


def find_longest_steps(eigenvalues: np.ndarray) -> np.ndarray:
    """Return the longest step with which Runge-Kutta 4 does not amplify x' = lambda x.

    |1 + z + z^2 / 2 + z^3 / 6 + z^4 / 24| <= 1 with z = step lambda.

    Args:
        eigenvalues: lambda with real parts not above 0, any shape [1/s].

    Returns:
        Of the same shape, infinity at 0 [s].
    """
    sizes = np.abs(eigenvalues)
    rays = eigenvalues / np.where(sizes > 0.0, sizes, 1.0)
    low, high = np.zeros(sizes.shape), np.full(sizes.shape, FARTHEST)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        z = middle * rays
        stable = np.abs(1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))) <= 1.0 + 1e-9
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    with np.errstate(divide="ignore"):
        return np.where(sizes > 0.0, low / sizes, np.inf)


def compute_inverse_masses(arm: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the inverse mass matrices of the joints, and the greatest inverse mass of the pad, over the arm's angles.

    Args:
        arm: a row of `arm.make_arm`, shape (14,).

    Returns:
        Shape (configurations, 3, 3) [1/(kg m^2)], and a number [1/kg].

    Raises:
        LinAlgError: the inertias are not invertible.
    """
    q2, q3 = (angles.ravel() for angles in np.meshgrid(ANGLES, ANGLES))
    a = np.stack([np.zeros_like(q2), q2, q2 + q3], axis=1)
    couplings = arm[[[C11, C12, C13], [C12, C22, C23], [C13, C23, C33]]]
    sums = np.tril(np.ones((3, 3)))  # absolute angles are sums of joint angles
    M = sums.T @ (couplings * np.cos(a[:, :, None] - a[:, None, :])) @ sums
    inverse = np.linalg.inv(M)
    J = (arm[[L1, L2, L3]] * np.stack([-np.sin(a), np.cos(a)], axis=1)) @ sums
    return inverse, float(np.linalg.eigvalsh(J @ inverse @ J.transpose(0, 2, 1)).max())


def find_stiffest_joint(
    inverse: np.ndarray, stiffness: np.ndarray, damping: np.ndarray, shaped_inertia: np.ndarray
) -> tuple[int, float]:
    """Find the joint spring that needs the shortest step.

    The deflection theta - q obeys d'' = -(M^-1 + Bt^-1) (K d + D d').

    Args:
        inverse: inverse mass matrices, shape (configurations, 3, 3) [1/(kg m^2)].
        stiffness, damping: K, D, shape (3,) [N m/rad], [N m s/rad].
        shaped_inertia: Bt, shape (3,) [kg m^2].

    Returns:
        The joint, counted from 0, and the longest stable step [s].
    """
    W = inverse + np.diag(1.0 / shaped_inertia)
    A = np.zeros((len(W), 6, 6))
    A[:, :3, 3:] = np.eye(3)
    A[:, 3:, :3], A[:, 3:, 3:] = -W * stiffness, -W * damping
    values, vectors = np.linalg.eig(A)
    steps = find_longest_steps(values)
    worst, mode = np.unravel_index(np.argmin(steps), steps.shape)
    return int(np.argmax(np.abs(vectors[worst, :3, mode]))), float(steps[worst, mode])


def find_contact_step(inverse_mass: float, stiffness: float, damping: float, exponent: float, depth: float) -> float:
    """Return the longest step with which a compliant contact is stable down to a depth [s].

    Args:
        inverse_mass: of all that moves the contact [1/kg].
        stiffness, damping, exponent: k, d, c of the normal force (see `physics.contact`).
        depth: greatest overlap [m].
    """
    K, D = exponent * stiffness * depth ** (exponent - 1.0), damping * depth**exponent
    return float(find_longest_steps(np.roots([1.0, D * inverse_mass, K * inverse_mass])).min())
