"""What the dual arm's expert remembers beside its control, and the rules of readings and corrections."""

from __future__ import annotations

import numpy as np

from impact_envs.dual_arm.observation import ARM
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.elementary import exp, hypot
from planners.dual_arm.options import Options
from planners.dual_arm.readings import make_gates, make_surroundings
from planners.reading_gate import COUNTS, ROWS

CORRECTION_SIZE, FEATURE_SIZE = 2, 22

# What all worlds share.
RULES = np.dtype(
    [
        ("surroundings", float, 9),  # see `readings`
        ("first", np.int64),  # ticks from full contact to the first correction
        ("every", np.int64),  # ticks between corrections
        ("log_range", float),
        ("most_change", float),  # of a correction in a tick
        ("lag_share", float),  # of the newest lag in the smoothed one
    ]
)

# What is remembered of one world.
EXPERT = np.dtype(
    [
        ("gates", float, (2, ROWS, 3)),  # of both arms' readings
        ("rows", float, (2, ARM.size)),  # what is believed of the last reading
        ("forces", float, (2, 2)),  # normal forces at the pads' corners, believed last [N]
        ("doubted", float, 2),  # ticks for which they are not believed
        ("counts", np.int64, len(COUNTS)),  # of readings missing, rejected, taken up
        ("awaiting", np.int64),  # a correction is awaited
        ("answer", float, CORRECTION_SIZE),  # correction of grip and load
        ("applied", float, CORRECTION_SIZE),  # the part of it in effect
        ("lag", float, 3),  # of the box behind its reference, smoothed [m/s, rad/s]
    ]
)


def make_rules(scenario: DualArmScenario, options: Options) -> np.ndarray:
    """Collect the rules of readings and corrections.

    Args:
        scenario: as believed.
        options: of the expert.

    Returns:
        A RULES, shape (1,).
    """
    rules, period, correction = np.zeros(1, RULES), scenario.control_period, options.correction
    row = rules[0]
    row["surroundings"] = make_surroundings(scenario, options.readings)
    row["first"], row["every"] = (max(1, round(t / period)) for t in (correction.first, correction.period))
    row["log_range"], row["most_change"] = correction.log_range, correction.rate * period
    row["lag_share"] = 1.0 - exp(-period / correction.lag_time)
    return rules


def make_expert_memory(scenario: DualArmScenario, options: Options, count: int) -> np.ndarray:
    """Return the memory of worlds in which nothing has happened, of type EXPERT, shape (count,).

    Args:
        scenario: as believed.
        options: of the expert.
        count: of worlds.
    """
    memory = np.zeros(count, EXPERT)
    memory["gates"] = make_gates(scenario, hypot(*options.controller.impact_velocity), options.readings)
    return memory
