"""The longest control period over which motors that hold their torque brake the joints without driving them back.

A motor at its limit takes off stall_torque / no_load_speed * speed, with the speed at the start of the period: an
explicit Euler step of a damper.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import interpret
from impact_envs.physics.multibody import Chain, compute_directions, compute_mass_matrix

CONFIGURATIONS = 64  # of the joints at which the inertia is looked at; all joints straight is the first


def find_longest_period(chain: Chain, damping: np.ndarray) -> tuple[int, float]:
    """Find the motor that needs the shortest control period.

    v+ = (1 - T M^-1 D) v is stable while T times the greatest eigenvalue of M^-1 D is at most 2.

    Args:
        chain: base, links and load.
        damping: D, of the wheel and the joints' motors, shape (n + 1,) [N m s/rad].

    Returns:
        The motor, 0 for the wheel, and the period, infinity without motors [s].
    """
    n = len(damping) - 1
    joints = np.random.default_rng(0).uniform(-np.pi, np.pi, (CONFIGURATIONS, n))
    joints[0] = 0.0
    roots, greatest, motor = np.sqrt(damping), 0.0, 0
    w, rates, rest, M = np.zeros((n + 1, 2)), np.zeros(n + 1), np.zeros(n + 3), np.zeros((n + 3, n + 3))
    find_directions, fill_masses = interpret(compute_directions), interpret(compute_mass_matrix)
    for q in joints:
        find_directions(chain, np.concatenate([np.zeros(3), q]), rest, w, rates)
        fill_masses(chain, w, M)
        values, vectors = np.linalg.eigh(roots[:, None] * np.linalg.inv(M)[2:, 2:] * roots)
        if values[-1] > greatest:
            greatest, motor = values[-1], int(np.argmax(np.abs(vectors[:, -1])))
    return motor, 2.0 / greatest if greatest > 0.0 else np.inf
