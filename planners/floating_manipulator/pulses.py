"""On/off thrusters under noise and delay: one pulse, then a rest in which its effect is measured.

A force that is switched every period by an old or noisy measurement overshoots, reverses and overshoots again, forever.

A pulse starts where the mean f of the last `pulse_samples` desired forces of an axis exceeds the dead zone. It lasts
m |f| / (k F), and at least one period: it removes the speed |f| / k from a base of mass m without an arm, and so at
most that from a base with an arm. k is the desired force per speed, `damping` times `thruster_gain` [N s/m].
"""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.floating_manipulator.options import Options
from planners.floating_manipulator.world_memory import BLANK_PULSE, ExpertMemory, ExpertTable


@compiled
def forget_pulses(memory: ExpertMemory, k: int) -> None:
    """Forget world k's pulses and desired forces."""
    for axis in range(2):
        memory.pulse[k, axis] = BLANK_PULSE


@compiled
def fire_axis(table: ExpertTable, memory: ExpertMemory, options: Options, k: int, axis: int, desired: float) -> float:
    """Return the force of world k's thruster in this control period: 0, or that of a thruster that is on [N].

    Args:
        axis: of the world, 0 or 1.
        desired: force along it [N].
    """
    pulse, last = memory.pulse[k, axis], memory.desired[k, axis]
    samples = len(last)
    if pulse.count < samples:
        last[pulse.count] = desired
        pulse.count += 1
    else:
        for i in range(samples - 1):
            last[i] = last[i + 1]
        last[samples - 1] = desired
    if pulse.on == 0 and pulse.rest == 0 and pulse.count == samples:
        start_pulse(table, memory, options, k, axis)
    if pulse.on > 0:
        pulse.on -= 1
        return pulse.sign * table.actuators.thruster_force
    pulse.rest = max(pulse.rest - 1, 0)
    return 0.0


@compiled
def start_pulse(table: ExpertTable, memory: ExpertMemory, options: Options, k: int, axis: int) -> None:
    """Start a pulse of world k's thruster if the mean desired force exceeds the dead zone."""
    pulse, last, recovery = memory.pulse[k, axis], memory.desired[k, axis], options.recovery
    mean = 0.0
    for i in range(len(last)):
        mean += last[i]
    mean /= len(last)
    if abs(mean) > table.actuators.dead_zone:
        gain = recovery.damping * recovery.thruster_gain
        periods = table.base_mass / (gain * table.actuators.thruster_force * table.period)  # per desired force [1/N]
        pulse.on, pulse.rest = max(1, math.floor(periods * abs(mean))), recovery.pulse_rest
        pulse.sign = math.copysign(1.0, mean)
