"""What a learner sees is what the documentation says, finite, and the same wherever it means the same."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.belief.world_memory import NO_OBJECT
from planners.free_flyer.closed_loop.features import FAR, FEATURES, ONE_HOT
from planners.free_flyer.expert import FreeFlyerExpert
from planners.plan import Plan
from tests.frozen.freeze import get_plan
from tests.planners.free_flyer.plans import load, load_open, make_straight_plan

SEED = 1_000_000
# Where things stand behind the one-hot number of the impact.
NAMES = (
    "time", "to_impact", "leg", "cos", "sin", "size", "vx", "vy", "wish_x", "wish_y", "x", "y", "robot_x", "robot_y",
    "robot_vx", "robot_vy", "heading_cos", "heading_sin", "spin", "centre_x", "centre_y", "drift_x", "drift_y", "still",
    "sd_place", "sd_velocity", "sd_drift", "sd_offset", "sd_sensor", "gain", "gain_sd", "last_along", "last_across",
    "earlier_along", "earlier_across", "hits", "margin_here", "margin_next", "margin",
)  # fmt: skip


def name_features(features: np.ndarray) -> dict[str, float]:
    return dict(zip(NAMES, features[ONE_HOT:].tolist(), strict=True))


@cache
def plan_of(name: str) -> Plan:
    plan = get_plan(name, "nominal")
    assert plan is not None
    return plan


def collect(name: str, suite: str = "nominal", **changes: object) -> list[np.ndarray]:
    """Play the expert of a shipped scenario, and return what a learner sees at every correction that is due."""
    return watch(load_scenario(name).suite(suite).override(changes), plan_of(name))


def watch(scenario: FreeFlyerScenario, plan: Plan) -> list[np.ndarray]:
    """Play the expert, and return what a learner sees at every correction that is due."""
    env, expert = parallel_env(scenario), FreeFlyerExpert(scenario, plan)
    observations, _ = env.reset(seed=SEED)
    expert.reset(SEED)
    found = []
    for _ in range(scenario.steps):
        expert.observe(observations)
        if expert.awaiting_correction:
            found.append(expert.features().copy())
        observations, *_ = env.step(expert.control())
    return found


def test_the_size_is_documented() -> None:
    assert FEATURES == ONE_HOT + len(NAMES) == FreeFlyerExpert.feature_size == 45


@pytest.mark.parametrize("name", ["throw_and_catch", "pong", "corridor", "exchange"])
@pytest.mark.parametrize("suite", ["nominal", "all"])
def test_all_is_finite_and_of_a_size_to_learn_from(name: str, suite: str) -> None:
    for features in collect(name, suite):
        assert features.shape == (FEATURES,)
        assert np.isfinite(features).all()
        assert np.abs(features).max() <= load(name).horizon
        assert sorted(features[:ONE_HOT]) == [0, 0, 0, 0, 0, 1]
        seen = name_features(features)
        assert 0.0 <= seen["time"] <= 1.0
        assert seen["to_impact"] > 0.0 < seen["leg"]
        for cos, sin in (("cos", "sin"), ("heading_cos", "heading_sin")):
            assert math.hypot(seen[cos], seen[sin]) == pytest.approx(1.0, abs=1e-12)
        # Along and across the wished change: what is wished for differs from what is along that alone, by its size.
        assert seen["wish_x"] - seen["vx"] == pytest.approx(seen["size"], abs=1e-12)
        assert seen["wish_y"] - seen["vy"] == pytest.approx(0.0, abs=1e-12)
        assert min(seen[key] for key in NAMES if key.startswith("sd_") or key == "gain_sd") >= 0.0
        assert 0.0 <= seen["still"] <= 1.0
        assert max(abs(seen[key]) for key in ("margin_here", "margin_next", "margin")) <= FAR


def test_nothing_is_seen_where_no_impact_is_to_come() -> None:
    scenario = load("throw_and_catch")
    env, expert = parallel_env(scenario), FreeFlyerExpert(scenario, plan_of(scenario.name))
    observations, _ = env.reset(seed=SEED)
    for _ in range(scenario.steps - 1):
        observations, *_ = env.step(expert.act(observations))
    expert.observe(observations)
    assert expert._due[0] == NO_OBJECT
    assert not expert.features().any()


def test_the_last_two_hits_are_seen_in_their_order() -> None:
    """A restitution below what is believed: less than what was commanded, until it is learned."""
    first, second, third, *_ = map(name_features, collect("pong", **{"true.restitution": 0.5}))
    for seen in (first, second, third):
        assert [seen["hits"]] == [[first, second, third].index(seen)]
    assert (first["last_along"], first["last_across"]) == (first["earlier_along"], first["earlier_across"]) == (1, 0)
    believed = load("pong").believed.restitution
    assert second["last_along"] == pytest.approx(1.5 / (1.0 + believed), abs=0.02)
    assert (second["earlier_along"], second["earlier_across"]) == (1.0, 0.0)
    assert third["earlier_along"] == pytest.approx(second["last_along"], abs=0.01)
    assert abs(third["last_along"] - 1.0) < abs(second["last_along"] - 1.0)
    assert second["gain"] == pytest.approx(1.5 / (1.0 + believed), abs=0.03)
    assert first["gain_sd"] > second["gain_sd"] > 0.0


def test_heading_and_spin_are_those_of_the_object() -> None:
    for features in collect("throw_and_catch"):
        seen = name_features(features)
        assert seen["spin"] == pytest.approx(0.0, abs=1e-6)
        # The object's heading is 0: the angle to the wished change, mirrored.
        found = math.atan2(seen["heading_sin"], seen["heading_cos"]) + math.atan2(seen["sin"], seen["cos"])
        assert math.remainder(found, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)


def test_what_a_learner_sees_depends_on_nothing_that_is_true_only() -> None:
    """Until the first contact the world is as the believed one."""
    one, *_ = collect("pong")
    two, *_ = collect("pong", **{"true.restitution": 0.5})
    np.testing.assert_array_equal(one, two)


def see_thrown_and_caught(turn: complex, away: complex) -> list[np.ndarray]:
    """Return what a learner sees in a world that is turned and moved."""

    def move(x: float, y: float) -> tuple[float, float]:
        point = turn * complex(x + 20.0, y + 20.0) + away  # far from where robots start otherwise
        return point.real, point.imag

    scenario = load_open("F[0,40] speed(pop) >= 0.5", {"pop": move(0.0, 0.3)}, horizon=40.0)
    starts = {"snap": move(-2.0, 0.2), "crackle": move(3.0, -0.4)}
    scenario = scenario.override(
        {f"robots.{name}.{key}": at for name, at in starts.items() for key in ("start", "goal")}
    )
    hits = [(15.0, "snap", "pop", move(0.0, 0.3)), (32.0, "crackle", "pop", move(1.2, 0.5))]
    return watch(scenario, make_straight_plan(scenario, hits))


@pytest.mark.parametrize(("turn", "away"), [(1.0, 5.0 - 7.0j), (1.0j, 0.0), (-1.0j, 3.0 + 2.0j)])
def test_a_world_that_is_moved_and_turned_looks_the_same(turn: complex, away: complex) -> None:
    """But for where the impulse is to go, and how the object that is not turned stands to that."""
    plain, moved = see_thrown_and_caught(1.0, 0.0), see_thrown_and_caught(turn, away)
    assert len(plain) == len(moved) == 2
    for one, two in zip(map(name_features, plain), map(name_features, moved), strict=True):
        for name in NAMES:
            if name not in ("cos", "sin", "heading_cos", "heading_sin"):
                assert two[name] == pytest.approx(one[name], abs=1e-6), name
        for cos, sin, by in (("cos", "sin", turn), ("heading_cos", "heading_sin", 1 / turn)):
            assert complex(two[cos], two[sin]) == pytest.approx(by * complex(one[cos], one[sin]), abs=1e-6)
