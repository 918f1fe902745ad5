"""Two-body impact problems by the row, solved in one compiled loop."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.errors import InputError
from planners.free_flyer.next_impact.two_body import solve_soft_two_body_impact, solve_two_body_impact

# Columns of a row of `solve_two_body_impacts`, each the argument of `solve_two_body_impact` of that name.
ARGUMENTS = (
    *(f"{name}_{axis}" for name in ("object_position", "object_minus", "object_desired") for axis in "xy"),
    *(f"{name}_{axis}" for name in ("robot_wish", "default_normal") for axis in "xy"),
    *("robot_mass", "object_mass", "restitution", "reach", "speed_limit"),
)
# Columns of a row that it returns, the fields of `TwoBodyImpact`.
ANSWERS = (
    "outcome",
    *(f"{name}_{axis}" for name in ("normal", "contact", "robot_minus", "robot_plus") for axis in "xy"),
    *(f"{name}_{axis}" for name in ("object_minus", "object_plus") for axis in "xy"),
)


@compiled
def fill_answers(rows: np.ndarray, object_weight: float, robot_weight: float, answers: np.ndarray) -> None:
    """Solve one problem per row.

    Args:
        rows: columns ARGUMENTS, shape (N, 15).
        object_weight, robot_weight: see `solve_soft_two_body_impact`; with robot_weight 0 the hard form.
        answers: columns ANSWERS, written, shape (N, 13).
    """
    for k in range(len(rows)):
        row = rows[k]
        place, minus, desired = (row[0], row[1]), (row[2], row[3]), (row[4], row[5])
        wish, default = (row[6], row[7]), (row[8], row[9])
        m_r, m_o, e, reach, limit = row[10], row[11], row[12], row[13], row[14]
        if robot_weight > 0.0:
            answer = solve_soft_two_body_impact(
                place, minus, desired, wish, default, m_r, m_o, e, reach, limit, object_weight, robot_weight
            )
        else:
            answer = solve_two_body_impact(place, minus, desired, wish, default, m_r, m_o, e, reach, limit)
        out = answers[k]
        out[0] = answer.outcome.value
        out[1], out[2] = answer.normal
        out[3], out[4] = answer.contact
        out[5], out[6] = answer.robot_minus
        out[7], out[8] = answer.robot_plus
        out[9], out[10] = answer.object_minus
        out[11], out[12] = answer.object_plus


def solve_two_body_impacts(rows: np.ndarray, object_weight: float = 1.0, robot_weight: float = 0.0) -> np.ndarray:
    """Solve many two-body impact problems in one compiled loop.

    Args:
        rows: one problem each, columns ARGUMENTS, shape (N, 15) [m, m/s, kg].
        object_weight, robot_weight: see `solve_soft_two_body_impact`; with robot_weight 0 the hard form.

    Returns:
        One answer each, columns ANSWERS, shape (N, 13).

    Raises:
        InputError: rows of another shape, or a bad weight.
    """
    problems = np.ascontiguousarray(rows, dtype=np.float64)
    if problems.ndim != 2 or problems.shape[1] != len(ARGUMENTS):
        raise InputError(f"rows have shape {problems.shape}; (N, {len(ARGUMENTS)}) is needed: {', '.join(ARGUMENTS)}")
    if not (0.0 < object_weight < math.inf and 0.0 <= robot_weight < math.inf):
        raise InputError(
            f"object_weight {object_weight:g} and robot_weight {robot_weight:g}: "
            "a positive finite number and a finite one from 0 are needed"
        )
    answers = np.empty((len(problems), len(ANSWERS)))
    fill_answers(problems, float(object_weight), float(robot_weight), answers)
    return answers
