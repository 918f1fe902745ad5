"""What the sensors of world k make of its true states, and how measurements are laid out in observations.

Compiled scalar functions for one world of many; the single environment is a batch of one. Every array has the world as
its first axis. Nothing has to be cleared between episodes: sample 0 starts anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import cos_sin
from impact_envs.free_flyer.truth import DELAY, DROPOUT, Truth, largest
from impact_envs.stream import normal_pair

# What is observed of a body, in order; after all bodies come contacts, the time, and the robustness of each conjunct.
BODY = ("x [m]", "y [m]", "vx [m/s]", "vy [m/s]", "cos(heading)", "sin(heading)", "omega [rad/s]")
X, Y, VX, VY, COS, SIN, OMEGA, BODY_SIZE = range(8)
TIME_ELEMENTS = ("time / horizon",)
TIME, LOWER = range(2)  # of what all robots share, behind the contacts
# The published replanner averages the differences of its last 15 positions, which is this difference quotient.
VELOCITY_WINDOW = 15
# Slowest impact the inertial unit feels; below it lies resting contact.
FELT_SPEED = 1e-3  # [m/s]
STATE_SIZE = 6  # x, y, vx, vy, heading, omega


class Sensing(NamedTuple):
    """The sensors of a scenario's true world.

    Attributes:
        period: control period [s].
        noise: standard deviation of positions per axis [m].
        velocity_measured: False when velocity is a filtered difference of positions.
        delay_steps: control periods between event and observation, at most.
        lost_steps: control periods that a loss of readings lasts, 0 where none is ever lost.
    """

    period: float
    noise: float
    velocity_measured: bool
    delay_steps: int
    lost_steps: int = 0


def make_sensing(period: float, true: Truth) -> Sensing:
    """Return the sensors of a true world.

    Args:
        period: control period [s].
        true: its table.
    """
    lost = 0 if true.dropout_rate == 0.0 else max(round(true.dropout_seconds / period), 1)
    delay = int(largest(true.delay_steps))
    return Sensing(float(period), float(true.position_noise), true.velocity_measured, delay, lost)


def compute_memory_size(sensing: Sensing, bodies: int, robots: int) -> int:
    """Return how many numbers ``take_sample`` remembers per world: velocity window, delay line, what arrived last.

    Args:
        sensing: without velocity measurement the window is kept, with a delay the delay line, with losses what arrived.
        bodies, robots: how many.
    """
    window = 0 if sensing.velocity_measured else 2 * bodies * VELOCITY_WINDOW
    arrived = 1 + STATE_SIZE * bodies if sensing.lost_steps > 0 else 0
    return window + sensing.delay_steps * (STATE_SIZE * bodies + robots) + arrived


def count_uniforms(sensing: Sensing, bodies: int) -> int:
    """Return how many uniform numbers ``take_sample`` reads per world: two per body with noise, one with losses."""
    return (2 * bodies if sensing.noise > 0 else 0) + (1 if sensing.lost_steps > 0 else 0)


@inlined
def take_sample(
    sensing: Sensing,
    k: int,
    sample: int,
    states: np.ndarray,
    contacts: np.ndarray,
    sensors: np.ndarray,
    uniforms: np.ndarray,
    memory: np.ndarray,
    measured: np.ndarray,
    felt: np.ndarray,
) -> None:
    """Take one sample of world k; call once per control step.

    Args:
        sensing: noise, velocity, delay and losses.
        k: world.
        sample: number of the sample, 0 at the start of the episode.
        states: true [x, y, vx, vy, heading, omega] of all bodies, shape (worlds, bodies, 6).
        contacts: which robots felt an impact, shape (worlds, robots), 0 or 1.
        sensors: as ``Physics.sensor``, shape (worlds, 2).
        uniforms: in [0, 1), shape (worlds, ``count_uniforms``).
        memory: shape (worlds, ``compute_memory_size``), changed in place.
        measured: takes the measured states, as old as the delay (the first ones until then), shape (worlds, bodies, 6).
        felt: takes the contacts of the same age, shape (worlds, robots).
    """
    for i in range(states.shape[1]):
        for j in range(STATE_SIZE):
            measured[k, i, j] = states[k, i, j]
        if sensing.noise > 0.0:
            x, y = normal_pair(uniforms[k, 2 * i], uniforms[k, 2 * i + 1])
            measured[k, i, 0] += sensing.noise * x
            measured[k, i, 1] += sensing.noise * y
    for r in range(contacts.shape[1]):
        felt[k, r] = contacts[k, r]
    start = 0
    if not sensing.velocity_measured:
        _differentiate(sensing, k, sample, memory, measured)
        start = 2 * states.shape[1] * VELOCITY_WINDOW
    if sensing.delay_steps > 0:
        _delay(sensing, k, sample, int(sensors[k, DELAY]), memory, start, measured, felt)
        start += sensing.delay_steps * (STATE_SIZE * states.shape[1] + contacts.shape[1])
    if sensing.lost_steps > 0:
        is_loss = uniforms[k, uniforms.shape[1] - 1] < sensors[k, DROPOUT] * sensing.period
        _lose(sensing, k, sample, is_loss, memory, start, measured)


@compiled
def sample_alone(
    sensing: tuple,
    sample: int,
    states: np.ndarray,
    contacts: np.ndarray,
    sensors: np.ndarray,
    uniforms: np.ndarray,
    memory: np.ndarray,
    measured: np.ndarray,
    felt: np.ndarray,
) -> None:
    """``take_sample`` of world 0 for Python, which hands over a plain tuple faster than a NamedTuple."""
    take_sample(Sensing(*sensing), 0, sample, states, contacts, sensors, uniforms, memory, measured, felt)


@inlined
def _differentiate(sensing: Sensing, k: int, sample: int, memory: np.ndarray, measured: np.ndarray) -> None:
    """Replace velocities by the difference quotient to the oldest remembered position.

    v = (p - p_oldest) / (n period), n = min(sample, VELOCITY_WINDOW) periods ago; zero for the first sample.
    """
    bodies = measured.shape[1]
    periods = min(sample, VELOCITY_WINDOW)
    newest = 2 * bodies * (sample % VELOCITY_WINDOW)
    oldest = newest if sample >= VELOCITY_WINDOW else 0
    for i in range(bodies):
        for axis in range(2):
            position = measured[k, i, axis]
            velocity = 0.0
            if periods > 0:
                velocity = (position - memory[k, oldest + 2 * i + axis]) / (periods * sensing.period)
            measured[k, i, 2 + axis] = velocity
            memory[k, newest + 2 * i + axis] = position


@inlined
def _delay(
    sensing: Sensing,
    k: int,
    sample: int,
    delay: int,
    memory: np.ndarray,
    start: int,
    measured: np.ndarray,
    felt: np.ndarray,
) -> None:
    """Exchange a sample for the one of a delay ago, or for the first one; the line holds the longest delay."""
    bodies, robots = measured.shape[1], felt.shape[1]
    size = STATE_SIZE * bodies + robots
    newest = start + size * (sample % sensing.delay_steps)
    oldest = start + size * (max(sample - delay, 0) % sensing.delay_steps)
    first = sample == 0 or delay == 0
    for i in range(bodies):
        for j in range(STATE_SIZE):
            at = STATE_SIZE * i + j
            new = measured[k, i, j]
            measured[k, i, j] = new if first else memory[k, oldest + at]
            memory[k, newest + at] = new
    for r in range(robots):
        at = STATE_SIZE * bodies + r
        contact = felt[k, r]
        felt[k, r] = contact if first else memory[k, oldest + at]
        memory[k, newest + at] = contact


@inlined
def _lose(
    sensing: Sensing, k: int, sample: int, is_loss: bool, memory: np.ndarray, start: int, measured: np.ndarray
) -> None:
    """Repeat the last sample that arrived while readings are lost; the first one always arrives.

    Args:
        is_loss: whether a loss begins with this sample, if none goes on.
        start: where the memory holds how many samples are still lost, and behind it the last one that arrived.
    """
    left = int(memory[k, start]) if sample > 0 else 0
    if left == 0 and is_loss and sample > 0:
        left = sensing.lost_steps
    memory[k, start] = max(left - 1, 0)
    for i in range(measured.shape[1]):
        for j in range(STATE_SIZE):
            at = start + 1 + STATE_SIZE * i + j
            if left > 0:
                measured[k, i, j] = memory[k, at]
            else:
                memory[k, at] = measured[k, i, j]


@compiled
def find_contact_place(bodies: int, robot: int) -> int:
    """Return where a robot's contact stands in a joint observation."""
    return BODY_SIZE * bodies + robot


@compiled
def find_shared_place(bodies: int, robots: int) -> int:
    """Return where the time stands in a joint observation; the robustness intervals follow."""
    return BODY_SIZE * bodies + robots


@inlined
def write_observations(
    k: int,
    measured: np.ndarray,
    felt: np.ndarray,
    fraction: float,
    robustness: np.ndarray,
    joint: np.ndarray,
    agents: np.ndarray,
) -> None:
    """Write the joint observation of world k, and those of its robots for which there is room (see below)."""
    write_joint_observation(k, measured, felt, fraction, robustness, joint)
    for agent in range(agents.shape[1]):
        write_agent_observation(k, agent, measured.shape[1], joint, agents)


@inlined
def write_joint_observation(
    k: int, measured: np.ndarray, felt: np.ndarray, fraction: float, robustness: np.ndarray, joint: np.ndarray
) -> None:
    """Write everything world k measured once: bodies in scenario order, contacts, time, robustness intervals.

    Args:
        k: world.
        measured: [x, y, vx, vy, heading, omega] of all bodies, shape (worlds, bodies, 6).
        felt: contacts, shape (worlds, robots).
        fraction: time / horizon.
        robustness: lower and upper end of each conjunct's interval still possible, shape (worlds, 2 conjuncts) [m].
        joint: takes the observation, shape (worlds, joint size).
    """
    bodies, robots = measured.shape[1], felt.shape[1]
    for i in range(bodies):
        at, heading = BODY_SIZE * i, measured[k, i, 4]
        joint[k, at + X] = measured[k, i, 0]
        joint[k, at + Y] = measured[k, i, 1]
        joint[k, at + VX] = measured[k, i, 2]
        joint[k, at + VY] = measured[k, i, 3]
        joint[k, at + COS], joint[k, at + SIN] = cos_sin(heading)
        joint[k, at + OMEGA] = measured[k, i, 5]
    for r in range(robots):
        joint[k, find_contact_place(bodies, r)] = felt[k, r]
    at = find_shared_place(bodies, robots)
    joint[k, at + TIME] = fraction
    for j in range(robustness.shape[1]):
        joint[k, at + LOWER + j] = robustness[k, j]


@inlined
def write_agent_observation(k: int, agent: int, bodies: int, joint: np.ndarray, out: np.ndarray) -> None:
    """Write a robot's observation of world k: itself, other robots, objects, its contact, time, robustness intervals.

    Args:
        k: world.
        agent: robot, its number.
        bodies: how many.
        joint: as ``write_joint_observation`` left it, shape (worlds, joint size).
        out: takes the observation, shape (worlds, robots, own size).
    """
    robots, tail = out.shape[1], BODY_SIZE * bodies
    for i in range(bodies):
        place = 0 if i == agent else i + 1 if i < agent else i
        for j in range(BODY_SIZE):
            out[k, agent, BODY_SIZE * place + j] = joint[k, BODY_SIZE * i + j]
    out[k, agent, tail] = joint[k, find_contact_place(bodies, agent)]
    for j in range(out.shape[2] - tail - 1):
        out[k, agent, tail + 1 + j] = joint[k, find_shared_place(bodies, robots) + j]
