"""How much of a scenario's formula a plan gives up: by how much it misses each conjunct."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.specification.loosening import list_conjuncts
from planners.free_flyer.validation import compute_robustness
from planners.plan import Plan


@dataclass(frozen=True)
class GivenUp:
    """Say what a plan gives up of a formula.

    Args:
        conjunct: as the user wrote it.
        missed: by how much it is missed [m].
    """

    conjunct: str
    missed: float


def list_given_up(scenario: FreeFlyerScenario, plan: Plan) -> list[GivenUp]:
    """Return the conjuncts of a scenario's formula that a plan misses, with how much it misses them by.

    Args:
        scenario: as it was asked for.
        plan: of its robots and objects.
    """
    return [part for part in measure_missed(scenario, plan) if part.missed > 0.0]


def measure_missed(scenario: FreeFlyerScenario, plan: Plan) -> list[GivenUp]:
    """Return all conjuncts of a scenario's formula with how much a plan misses them by; negative: it keeps them."""
    fields = {field: getattr(scenario, field) for field in FreeFlyerScenario.model_fields}
    return [
        GivenUp(str(conjunct), -measure(FreeFlyerScenario(**fields | {"formula": str(conjunct)}), plan))
        for conjunct in list_conjuncts(scenario)
    ]


def measure(scenario: FreeFlyerScenario, plan: Plan) -> float:
    """Return the robustness of a scenario's formula over a plan's curves at the control steps [m]."""
    times = np.linspace(0.0, scenario.horizon, round(scenario.horizon / scenario.control_period) + 1)
    curves = plan.robots | plan.objects
    return compute_robustness(scenario, times, {name: curve.position(times) for name, curve in curves.items()})
