"""What formulas speak of and sensors see, written by compiled functions for one world and for many."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.physics.multibody import Chain, compute_directions, compute_momenta


@compiled
def read_coordinates(states: np.ndarray, q: np.ndarray, v: np.ndarray) -> None:
    """Write the manipulator's coordinates and rates that the states of its bodies say.

    Args:
        states: rows x, y, vx, vy, heading, omega of base and links, then others, shape (bodies, 6).
        q, v: results: base x, y, psi, joints, and their rates, shape (n + 3,) [m], [rad], [m/s], [rad/s].
    """
    q[0], q[1], q[2] = states[0, 0], states[0, 1], states[0, 4]
    v[0], v[1], v[2] = states[0, 2], states[0, 3], states[0, 5]
    for j in range(3, len(q)):
        q[j], v[j] = states[j - 2, 4] - states[j - 3, 4], states[j - 2, 5] - states[j - 3, 5]


@compiled
def write_signals(
    chain: Chain,
    box: tuple[float, float],
    states: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    torques: np.ndarray,
    felt: tuple[float, float],
    work: tuple[np.ndarray, np.ndarray],
    values: np.ndarray,
) -> None:
    """Write the signals of the formula in the order of the task's names.

    Args:
        chain: true masses of base, links and load.
        box: true mass and inertia of the box [kg], [kg m^2].
        states: true states, shape (n + 4, 6).
        q, v: coordinates and rates of the manipulator, shape (n + 3,).
        torques: of the joints in the last control period, shape (n,) [N m].
        felt: impulses on the box in the last control period [N s], and time since the last impact felt [s].
        work: directions and absolute rates, shapes (n + 1, 2) and (n + 1,).
        values: result: states, rate and torque of every joint, momenta, felt; shape (6 (n + 4) + 2 n + 8,).
    """
    bodies, n, at = len(states), len(torques), 0
    for i in range(bodies):
        for column in range(6):
            values[at] = states[i, column]
            at += 1
    for j in range(n):
        values[at], values[at + 1] = v[3 + j], torques[j]
        at += 2
    w, rates = work
    compute_directions(chain, q, v, w, rates)
    px, py, spin = compute_momenta(chain, q, v, w, rates)
    place = states[n + 2]
    qx, qy = box[0] * place[2], box[0] * place[3]
    values[at], values[at + 1], values[at + 2], values[at + 3] = px, py, qx, qy
    values[at + 4], values[at + 5] = spin, box[1] * place[5] + place[0] * qy - place[1] * qx
    values[at + 6], values[at + 7] = felt[0], felt[1]


@compiled
def find_length(x: float, y: float) -> float:
    """Return the length of a vector; Python's hypotenuse rounds otherwise than the compiled one."""
    return math.sqrt(x * x + y * y)
