r"""Learn how strong the thrusters of a robot are, from what it was commanded and how it moved; compiled.

A thruster's gain g is its true over its commanded force; a robot has four: body axes x and y, positive and negative.
Their acceleration is slow beside noise, delays and the pulses of thrusters that are off or full, so both sides of
p'' = g+ u+ + g- u- go through the same low pass F = 1 / (tau s + 1)^2,

y = s^2 F p = g+ F u+ + g- F u-,

u+ and u- the acceleration that was commanded each way. A command of one period moves a body by h^2 / 2 in that and as
much again in the next, so that second differences of positions are means of two commands: the equation is exact in
samples too. Every sample corrects both gains as if they were independent, with the variance of y times the samples that
a low pass joins.

After a contact its states begin anew at the estimated motion, once that is known again. Torques are not looked at.

Source: Ljung, System Identification (1999), secs. 11.2 and 14: recursive least squares of filtered signals; for a gain
that is hardly known to differ from 1 the positive part of James and Stein's estimate.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import cos_sin
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.world_memory import WorldMemory


@inlined
def find_thruster(axis: int, force: float) -> int:
    """Return the number of the thruster that pushes along a body axis: +x, -x, +y, -y."""
    return 2 * axis + (1 if force < 0.0 else 0)


@compiled
def open_thrusters(memory: WorldMemory, options: Options, k: int) -> None:
    """Believe that all thrusters of world k do as they are told."""
    for r in range(memory.thrust.shape[1]):
        thrust = memory.thrust[k, r]
        thrust.command[0] = thrust.command[1] = 0.0
        for i in range(4):
            thrust.gain[i] = thrust.estimate[i] = 1.0
            thrust.variance[i] = options.thruster.spread * options.thruster.spread
        start_passes(thrust, options, memory.filter[k, r], 0.0)


@inlined
def start_passes(thrust: np.record, options: Options, z: np.record, ready: float) -> None:
    """Let the low passes of a robot begin as if it had always flown as its filter says, without a command.

    Args:
        thrust: a THRUST, changed in place.
        z: its FILTER.
        ready: when it begins; until then it begins anew with every sample [s].
    """
    tau = options.thruster.low_pass
    thrust.ready = ready
    for axis in range(2):
        thrust.once[axis] = z.position[axis] - tau * z.velocity[axis]
        thrust.twice[axis] = thrust.once[axis] - tau * z.velocity[axis]
        thrust.last[axis] = 0.0
    for i in range(4):
        thrust.push_once[i] = thrust.push_twice[i] = 0.0


@compiled
def learn_thrust(
    thrust: np.record,
    options: Options,
    z: np.record,
    heading: float,
    x: float,
    y: float,
    sigma: float,
    now: float,
    h: float,
) -> None:
    """Update the gains of a robot's thrusters, in place, by a sample.

    Args:
        thrust: its THRUST.
        z: its FILTER, corrected by the sample.
        heading: [rad].
        x, y: position, read or, where that is not believed, estimated [m].
        sigma: standard deviation of positions per axis [m].
        now: time of the sample [s].
        h: since the one before [s].
    """
    if now < thrust.ready:
        start_passes(thrust, options, z, thrust.ready)
        return
    tau = options.thruster.low_pass
    share = h / (tau + h)
    for axis, p in ((0, x), (1, y)):
        thrust.once[axis] += share * (p - thrust.once[axis])
        thrust.twice[axis] += share * (thrust.once[axis] - thrust.twice[axis])
        u = thrust.command[axis]
        for sign in range(2):
            i, before, after = 2 * axis + sign, thrust.last[axis], u
            mean = (max(before, 0.0) + max(after, 0.0)) / 2 if sign == 0 else (min(before, 0.0) + min(after, 0.0)) / 2
            thrust.push_once[i] += share * (mean - thrust.push_once[i])
            thrust.push_twice[i] += share * (thrust.push_once[i] - thrust.push_twice[i])
        thrust.last[axis] = u
    ax = (x - 2.0 * thrust.once[0] + thrust.twice[0]) / (tau * tau)
    ay = (y - 2.0 * thrust.once[1] + thrust.twice[1]) / (tau * tau)
    push = thrust.push_twice
    if max(max(push[0], -push[1]), max(push[2], -push[3])) < options.thruster.least:
        return
    cos, sin = cos_sin(heading)
    noise = options.thruster.position_floor + sigma
    noise = noise * noise / (tau * tau * tau * tau)
    for axis, seen in ((0, cos * ax + sin * ay), (1, cos * ay - sin * ax)):
        correct_gains(thrust, options, axis, seen, noise, h)


@inlined
def correct_gains(thrust: np.record, options: Options, axis: int, seen: float, noise: float, h: float) -> None:
    """Update the gains of both thrusters along a body axis, in place, by a filtered acceleration.

    Args:
        thrust: a THRUST.
        axis: of the body.
        seen: filtered acceleration along it [m/s^2].
        noise: variance of that [m^2/s^4].
        h: time step [s].
    """
    i, j = 2 * axis, 2 * axis + 1
    f, g = thrust.push_twice[i], thrust.push_twice[j]
    size = f - g
    if size < options.thruster.least:
        return
    unknown = options.thruster.unknown * size
    P, Q = thrust.variance[i], thrust.variance[j]
    total = f * f * P + g * g * Q + (noise + unknown * unknown) * 2.0 * options.thruster.low_pass / h
    miss = (seen - f * thrust.estimate[i] - g * thrust.estimate[j]) / total
    wander = options.thruster.wander * options.thruster.wander * h
    most = options.thruster.spread * options.thruster.spread
    for n, push, variance in ((i, f, P), (j, g, Q)):
        mean = thrust.estimate[n] + variance * push * miss
        thrust.estimate[n] = min(max(mean, options.thruster.weakest), options.thruster.strongest)
        thrust.variance[n] = min(variance - variance * push / total * push * variance + wander, most)
        away = thrust.estimate[n] - 1.0
        doubt = options.thruster.sure * options.thruster.sure * thrust.variance[n]
        thrust.gain[n] = 1.0 + away * (1.0 - doubt / (away * away)) if away * away > doubt else 1.0
