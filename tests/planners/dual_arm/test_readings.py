"""The dual arm's expert acts on the motion that its torques should cause where readings cannot be; it counts that."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env
from impact_envs.dual_arm.observation import ARM
from planners import make_expert
from planners.dual_arm.expert import DualArmExpert

NAME, SEED = "dual_arm_grasp", 1_000_000
Spoil = Callable[[np.ndarray, int], None]


@pytest.fixture(scope="module")
def expert() -> DualArmExpert:
    return make_expert(NAME)


def play(expert: DualArmExpert, spoil: Spoil, suite: str = "nominal") -> tuple[bool, Counter[str]]:
    """Play an episode in which the first arm's readings are spoiled."""
    env = parallel_env(load_scenario(NAME).suite(suite))
    seen, _ = env.reset(seed=SEED)
    expert.reset(SEED)
    k, infos = 0, {}
    while env.agents:
        seen["arm_1"] = seen["arm_1"].copy()
        spoil(seen["arm_1"], k)
        actions = expert.act(seen)
        assert all(np.isfinite(action).all() for action in actions.values())
        seen, _, _, _, infos = env.step(actions)
        k += 1
    return bool(infos["arm_1"]["success"]), expert.diagnostics().fallbacks


def spoil_in_turn(row: np.ndarray, k: int) -> None:
    """Spoil twenty of every hundred readings, each time by another kind."""
    kind, since = divmod(k, 100)
    if not 50 <= since < 70:
        return
    if kind == 0:
        row[:] = 0.0
    elif kind == 1:
        row[:] = np.nan
    elif kind == 2:
        row[:] = -row
    elif kind == 3:
        row[:] = np.inf
    elif kind == 4:
        row[ARM["angles"].start] += 1.0
    elif kind == 5:
        row[ARM["rates"].start] += 5.0
    elif kind == 12:
        row[:] = 1e154
    elif kind == 13:
        row[ARM["angles"]], row[ARM["rates"]] = row[ARM["rates"]].copy(), row[ARM["angles"]].copy()
    elif kind in (14, 19):
        row[:] = 1e3 * np.random.default_rng(k).standard_normal(len(row))


def test_impossible_readings_of_every_kind_do_no_harm(expert: DualArmExpert) -> None:
    success, counts = play(expert, spoil_in_turn)
    assert success
    assert counts["rejected"] > 100
    assert counts["no_measurement"] >= 40
    assert counts["taken_up"] == 0
    assert counts["last_torque"] == 0  # it acts on what it predicts


@pytest.mark.parametrize("force", [1e154, -5.0, 30.0])
def test_a_force_far_from_the_box_is_no_contact(expert: DualArmExpert, force: float) -> None:
    def push(row: np.ndarray, k: int) -> None:
        if k in (100, 101):
            row[ARM["forces"]] = force

    success, counts = play(expert, push)
    assert success
    assert counts["rejected"] == 2
    assert expert.controller.switches["interim"] > 0.5


@pytest.mark.parametrize("suite", ["nominal", "all", "hard"])
def test_right_readings_are_never_rejected(expert: DualArmExpert, suite: str) -> None:
    _, counts = play(expert, lambda row, k: None, suite)
    assert not {"rejected", "taken_up", "no_measurement"} & set(counts)


def test_an_arm_that_is_elsewhere_is_believed_after_a_while(expert: DualArmExpert) -> None:
    def move(row: np.ndarray, k: int) -> None:
        row[ARM["angles"].start] += 0.5 if k > 20 else 0.0

    _, counts = play(expert, move)
    assert counts["taken_up"] >= 1
