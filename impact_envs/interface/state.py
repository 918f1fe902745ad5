"""The whole truth of a world as one vector, for centralised critics and oracles; its second form has the secrets."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from impact_envs.observation import Layout
from impact_envs.stl.compiler import describe_parts


class Truthful(Protocol):
    """What a task says of the truth: of states, and of the physics that are drawn and that no expert sees."""

    scenario: Any
    state_layout: Layout
    secrets_layout: Layout


def make_state_layout(task: Truthful, secrets: bool) -> Layout:
    """Return what stands where in a state.

    Args:
        task: of the scenario.
        secrets: of the second form: behind the first one the drawn physics, and of every temporal operator that the
            formula is joined of the interval of robustness still possible, which is what it remembers.
    """
    fields = [*task.state_layout.fields.items(), ("time so far", ("time / horizon",))]
    if secrets:
        scenario = task.scenario
        parts = describe_parts(scenario.specification, scenario.control_period, scenario.areas, scenario.bodies)
        ends = [f"{part}: {end} end [m]" for part in parts for end in ("lower", "upper")]
        fields += [*task.secrets_layout.fields.items(), ("formula so far", ends)]
    return Layout(*fields)


def join_states(states: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Return the first form.

    Args:
        states: true states, shape (N, bodies, columns).
        fraction: time / horizon, shape (N,).

    Returns:
        Shape (N, size), float64.
    """
    return np.column_stack([states.reshape(len(states), -1), fraction]).astype(float)


def read_state(batch: Any, secrets: bool) -> np.ndarray:
    """Return the states of a batch's worlds, shape (N, size).

    Args:
        batch: of a domain.
        secrets: of the second form.
    """
    scenario = batch.scenario
    times = np.array(batch.steps.tolist()) * scenario.control_period
    state = join_states(np.array(batch.states.tolist()), times / scenario.horizon)
    if not secrets:
        return state
    return add_secrets(state, batch.secrets, batch.parts, scenario.world.diagonal)


def add_secrets(state: np.ndarray, secrets: np.ndarray, parts: np.ndarray, limit: float) -> np.ndarray:
    """Return the second form.

    Args:
        state: the first form, shape (N, size).
        secrets: drawn physics, shape (N, secrets).
        parts: intervals of the formula's operators, shape (N, operators, 2) [m].
        limit: intervals are clipped to it [m].
    """
    return np.column_stack([state, secrets, np.clip(parts, -limit, limit).reshape(len(state), -1)]).astype(float)
