"""How far apart two readings of the floating manipulator and its box can be: the reach of their `reading_gate`.

The margins are shares of the arm's length; the actuators push the base by (F + sum tau / l) / m and
(tau_w + tau_1) / I, joint i by 2 tau_i / I_i; and an impact changes the speed of a point by at most 2 v, where
v = sum_i w_i L_i is the speed of the tip when every joint runs at its no-load speed w_i, L_i away from the tip.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from planners.floating_manipulator.options import ReadingOptions
from planners.reading_gate import make_gate, open_gate


def make_gates(scenario: FloatingManipulatorScenario, options: ReadingOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return the gate of base and joints, at rest at their start, and that of the box, which may be anywhere.

    Args:
        scenario: as believed.
        options: margins.

    Returns:
        Shapes (ROWS, n + 3) and (ROWS, 3).
    """
    links, base = list(scenario.links.values()), scenario.base
    lengths = np.array([link.length for link in links])
    to_tip = np.cumsum(lengths[::-1])[::-1]
    torques, size = np.array([link.stall_torque for link in links]), float(to_tip[0])
    jump = 2.0 * sum(link.no_load_speed * far for link, far in zip(links, to_tip.tolist(), strict=True))
    force = scenario.thrusters.force if scenario.thrusters else 0.0
    wheel = scenario.wheel.stall_torque if scenario.wheel else 0.0
    linear = (force * math.sqrt(2.0) + sum((torques / lengths).tolist())) / base.mass
    joints = 2.0 * torques / np.array([link.inertia for link in links])
    turning = (wheel + torques[0]) / base.inertia
    place, speed = options.place * size, options.speed * size
    spin, n = jump / float(min(lengths)), len(links)
    arm = make_gate(
        place=np.array([place, place, *[options.angle] * (n + 1)]),
        rate=np.array([speed, speed, *[options.rate] * (n + 1)]),
        push=np.array([linear, linear, turning, *joints]),
        jump=np.array([jump, jump, *[spin] * (n + 1)]),
        turns=np.arange(n + 3) == 2,
    )
    box = make_gate(
        place=np.array([place, place, options.angle]),
        rate=np.array([speed, speed, options.rate]),
        push=np.zeros(3),
        jump=np.array([jump, jump, 2.0 * jump / min(scenario.box.size)]),
        turns=np.arange(3) == 2,
    )
    open_gate(arm, scenario.start)
    open_gate(box, np.array([*scenario.box.start, scenario.box.heading]), known=False)
    return arm, box
