"""The expert keeps the plan's promise, sees only what robots see, and obeys corrections of the impulse."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from impact_envs import InputError, parallel_env, rollout
from impact_envs.env import ImpactEnv
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import Impact
from impact_envs.rollout import Episode
from planners import list_variants, make_expert
from planners.bezier import Curve
from planners.free_flyer.belief.impact_parameters import compute_pair_gain
from planners.free_flyer.belief.options import EXPERT, VARIANTS, Options, make_record
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.tracking.box_qp import NEWTON_STEPS
from planners.free_flyer.tracking.mpc import STAGES
from planners.free_flyer.tracking.problem import PUBLISHED_WEIGHTS
from planners.plan import Plan, PlannedImpact
from tests.frozen.freeze import get_plan
from tests.planners.free_flyer import plans
from tests.planners.free_flyer.plans import load

OPTIONS = make_record(EXPERT)[0]

SEED = 1_000_000


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    return load("throw_and_catch")


@pytest.fixture(scope="module")
def plan(scenario: FreeFlyerScenario) -> Plan:
    return get_plan(scenario.name, "nominal")


@pytest.fixture(scope="module")
def nominal(scenario: FreeFlyerScenario, plan: Plan) -> Episode:
    return rollout(parallel_env(scenario), FreeFlyerExpert(scenario, plan), SEED)


class Corrected:
    """The expert with a fixed correction at every impact, or at chosen ones."""

    name = "corrected"

    def __init__(self, expert: FreeFlyerExpert, *corrections: tuple[float, float, float]) -> None:
        self.expert, self.corrections = expert, corrections

    def reset(self, seed: int) -> None:
        self.expert.reset(seed)
        self.features: list[np.ndarray] = []

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        self.expert.observe(observations)
        if self.expert.awaiting_correction:
            self.features.append(self.expert.features())
            self.expert.correct(np.array(self.corrections[min(len(self.features), len(self.corrections)) - 1]))
        return self.expert.control()

    def diagnostics(self) -> object:
        return self.expert.diagnostics()


def test_keeps_the_promise_of_the_plan(nominal: Episode, plan: Plan) -> None:
    assert nominal.success
    assert nominal.robustness >= plan.robustness - 0.01
    assert nominal.fallbacks == {}
    assert [(i.a, i.b) for i in nominal.impacts] == [(i.robot, i.object) for i in plan.impacts]
    for happened, planned in zip(nominal.impacts, plan.impacts, strict=True):
        assert happened.time == pytest.approx(planned.time, abs=0.01)
        assert happened.normal @ planned.normal == pytest.approx(1.0, abs=1e-4)


def test_keeps_the_promise_in_the_corridor() -> None:
    corridor = load("corridor")
    plan = get_plan("corridor", "nominal")
    episode = rollout(parallel_env(corridor), FreeFlyerExpert(corridor, plan), SEED)
    assert episode.success
    assert episode.robustness >= plan.robustness - 0.01


@pytest.mark.parametrize("suite", ["restitution", "mass", "sensing", "drift", "actuation", "all"])
def test_succeeds_where_the_world_is_not_as_believed(scenario: FreeFlyerScenario, plan: Plan, suite: str) -> None:
    world = scenario.suite(suite)
    for seed in (SEED, SEED + 1):
        assert rollout(parallel_env(world), FreeFlyerExpert(world, plan), seed).success


def test_same_seed_same_actions(scenario: FreeFlyerScenario, plan: Plan, nominal: Episode) -> None:
    again = rollout(parallel_env(scenario), FreeFlyerExpert(scenario, plan), SEED)
    for name, actions in nominal.actions.items():
        np.testing.assert_array_equal(again.actions[name], actions)


def test_zero_correction_is_the_expert_and_is_asked_for_once_per_impact(
    scenario: FreeFlyerScenario, plan: Plan, nominal: Episode
) -> None:
    policy = Corrected(FreeFlyerExpert(scenario, plan), (0.0, 0.0, 0.0))
    episode = rollout(parallel_env(scenario), policy, SEED)
    for name, actions in nominal.actions.items():
        np.testing.assert_array_equal(episode.actions[name], actions)
    assert len(policy.features) == len(plan.impacts)
    for features in policy.features:
        assert features.shape == (FreeFlyerExpert.feature_size,)
        assert np.isfinite(features).all()
        assert 0.0 < features[7] <= 8.0 + 1e-6  # time to the impact
    assert [int(np.argmax(features[:6])) for features in policy.features] == [0, 1]
    assert list(policy.features[0][37:42]) == [1.0, 0.0, 1.0, 0.0, 0.0]  # nothing observed yet
    # The throw did what was commanded; there is none before it.
    np.testing.assert_allclose(policy.features[1][37:42], [1.0, 0.0, 1.0, 0.0, 1.0], atol=0.01)


def test_observed_ratio_tells_the_true_restitution(scenario: FreeFlyerScenario, plan: Plan) -> None:
    policy = Corrected(FreeFlyerExpert(scenario, plan), (0.0, 0.0, 0.0))
    rollout(parallel_env(scenario.override({"true.restitution": 0.4})), policy, SEED)
    assert policy.features[1][37] == pytest.approx(1.4 / 1.8, abs=0.01)


def test_correction_scales_and_turns_the_impulse(scenario: FreeFlyerScenario, plan: Plan, nominal: Episode) -> None:
    whole = FreeFlyerExpert(scenario, plan, options=replace(EXPERT, filter=False))
    policy = Corrected(whole, (-0.6, 0.5, 0.0), (0.0, 0.0, 0.0))
    first, before = rollout(parallel_env(scenario), policy, SEED).impacts[0], nominal.impacts[0]
    assert first.speed == pytest.approx(before.speed * math.exp(-0.3), rel=0.01)
    turned = before.normal[0] * first.normal[1] - before.normal[1] * first.normal[0]
    assert math.asin(turned) == pytest.approx(0.15, abs=2e-3)


def test_never_sees_the_truth(scenario: FreeFlyerScenario, plan: Plan) -> None:
    worlds = scenario, scenario.suite("all")
    experts = [FreeFlyerExpert(world, plan) for world in worlds]
    assert worlds[0].true != worlds[1].true
    env = parallel_env(worlds[1])
    observations, _ = env.reset(seed=SEED)
    for expert in experts:
        expert.reset(SEED)
    for _ in range(150):
        first, second = (expert.act(observations) for expert in experts)
        for name in first:
            np.testing.assert_array_equal(first[name], second[name])
        observations, *_ = env.step(first)


def test_mirrored_scenario_is_played_mirrored(scenario: FreeFlyerScenario, plan: Plan, nominal: Episode) -> None:
    middle = scenario.world.lower[1] + scenario.world.upper[1]
    mirrored = mirror_scenario(scenario, middle)
    episode = rollout(parallel_env(mirrored), FreeFlyerExpert(mirrored, mirror_plan(plan, middle)), SEED)
    for name in scenario.bodies:
        np.testing.assert_allclose(episode.signals[f"{name}.x"], nominal.signals[f"{name}.x"], atol=1e-6)
        np.testing.assert_allclose(episode.signals[f"{name}.y"], middle - nominal.signals[f"{name}.y"], atol=1e-6)
    assert episode.robustness == pytest.approx(nominal.robustness, abs=1e-6)


def test_mirrored_corrections_have_the_mirrored_outcome(
    scenario: FreeFlyerScenario, plan: Plan, nominal: Episode
) -> None:
    middle = scenario.world.lower[1] + scenario.world.upper[1]
    mirrored, other = mirror_scenario(scenario, middle), mirror_plan(plan, middle)
    corrections = (0.4, -0.5, 0.6), (-0.3, 0.2, 0.0)
    one = Corrected(FreeFlyerExpert(scenario, plan), *corrections)
    two = Corrected(FreeFlyerExpert(mirrored, other), *((s, -turn, shift) for s, turn, shift in corrections))
    a, b = rollout(parallel_env(scenario), one, SEED), rollout(parallel_env(mirrored), two, SEED)
    for name in scenario.bodies:
        np.testing.assert_allclose(b.signals[f"{name}.x"], a.signals[f"{name}.x"], atol=1e-6)
        np.testing.assert_allclose(b.signals[f"{name}.y"], middle - a.signals[f"{name}.y"], atol=1e-6)
    assert b.robustness == pytest.approx(a.robustness, abs=1e-6)
    assert abs(a.impacts[0].time - nominal.impacts[0].time) > 1.0


def mirror_scenario(scenario: FreeFlyerScenario, middle: float) -> FreeFlyerScenario:
    """Return the scenario with y turned into middle - y."""

    def flip(point: tuple[float, float] | None) -> tuple[float, float] | None:
        return point and (point[0], middle - point[1])

    robots = {
        name: robot.model_copy(update={"start": flip(robot.start), "goal": flip(robot.goal)})
        for name, robot in scenario.robots.items()
    }
    objects = {name: item.model_copy(update={"start": flip(item.start)}) for name, item in scenario.objects.items()}
    regions = {
        name: region.model_copy(
            update={
                "lower": (region.lower[0], middle - region.upper[1]),
                "upper": (region.upper[0], middle - region.lower[1]),
            }
        )
        for name, region in scenario.regions.items()
    }
    return scenario.model_copy(update={"robots": robots, "objects": objects, "regions": regions})


def mirror_plan(plan: Plan, middle: float) -> Plan:
    flip, lift = np.array([1.0, -1.0]), np.array([0.0, middle])
    impacts = tuple(
        replace(
            impact,
            **{name: flip * getattr(impact, name) + lift for name in ("position", "contact")},
            **{name: flip * getattr(impact, name) for name in ("normal", "robot_minus", "robot_plus")},
            **{name: flip * getattr(impact, name) for name in ("object_minus", "object_plus")},
        )
        for impact in plan.impacts
    )
    curves = [
        {name: Curve(curve.times, flip * curve.points + lift) for name, curve in table.items()}
        for table in (plan.robots, plan.objects)
    ]
    return replace(plan, impacts=impacts, robots=curves[0], objects=curves[1])


def play(
    scenario: FreeFlyerScenario,
    expert: FreeFlyerExpert,
    actuate: Callable[[int, dict[str, np.ndarray]], None] = lambda k, actions: None,
    disturb: Callable[[int, ImpactEnv, dict[str, np.ndarray]], None] = lambda k, env, observations: None,
) -> tuple[bool, list[Impact], Mapping[str, int]]:
    """Play an episode whose actions and observations are tampered with; return success, impacts, fallbacks."""
    env, impacts = parallel_env(scenario), []
    observations, infos = env.reset(seed=SEED)
    expert.reset(SEED)
    for k in range(scenario.steps):
        disturb(k, env, observations)
        actions = expert.act(observations)
        for action in actions.values():
            assert np.all(np.abs(action) <= 1.0)  # finite, too
        actuate(k, actions)
        observations, _, _, _, infos = env.step(actions)
        impacts += env.impacts
    return bool(infos["snap"]["success"]), impacts, expert.diagnostics().fallbacks


def test_never_raises_on_rubbish(scenario: FreeFlyerScenario, plan: Plan) -> None:
    rng, expert = np.random.default_rng(0), FreeFlyerExpert(scenario, plan)

    def spoil(k: int, env: ImpactEnv, observations: dict[str, np.ndarray]) -> None:
        for vector in observations.values():
            if k % 7 == 0:
                vector[-4] = 1.0  # contact felt
            if k % 11 == 0:
                vector[:-4] = np.nan
            if 100 < k < 130:
                vector[:-4] += rng.normal(size=len(vector) - 4)

    _, _, fallbacks = play(scenario, expert, disturb=spoil)
    assert fallbacks["unplanned_contact"] > 0
    assert fallbacks["no_measurement"] > 0


@pytest.mark.parametrize("column", ["everything", "time", "contact", "heading", "object"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_passed_over(scenario: FreeFlyerScenario, plan: Plan, column: str, value: float) -> None:
    """Twice before the throw and once on the way to the catch."""
    where = {"everything": slice(None), "time": -3, "contact": -4, "heading": 4, "object": 14}[column]

    def spoil(k: int, env: ImpactEnv, observations: dict[str, np.ndarray]) -> None:
        if k in (50, 51, 140):
            for vector in observations.values():
                vector[where] = value if column != "contact" else np.nan

    success, _, fallbacks = play(scenario, FreeFlyerExpert(scenario, plan), disturb=spoil)
    assert success
    bodies = {"everything": 3, "heading": 2, "object": 1}
    assert fallbacks.get("no_measurement", 0) >= 3 * bodies.get(column, 0)


def test_missed_impact_is_tried_again(scenario: FreeFlyerScenario, plan: Plan) -> None:
    """A wrong position of the object makes the robot miss; seen aright again, it hits."""
    first = plan.impacts[0]
    beside = 0.45 * np.array([-first.normal[1], first.normal[0]])

    def spoil(k: int, env: ImpactEnv, observations: dict[str, np.ndarray]) -> None:
        for vector in observations.values():
            if k * 0.1 < first.time + 2.0:
                vector[14:16] += beside

    credulous = replace(EXPERT, estimation=replace(EXPERT.estimation, patience=0.05))
    _, impacts, fallbacks = play(scenario, FreeFlyerExpert(scenario, plan, options=credulous), disturb=spoil)
    assert fallbacks["retry"] == 1
    assert (impacts[0].a, impacts[0].b) == (first.robot, first.object)
    assert first.time + 5.0 < impacts[0].time < first.time + 8.0


@pytest.mark.parametrize("gone", [slice(0, 7), slice(14, 21)])
def test_missing_measurements_are_bridged(scenario: FreeFlyerScenario, plan: Plan, gone: slice) -> None:
    """For 2 s right before the first impact the throwing robot does not see itself, or nobody sees the object."""
    begin = round(plan.impacts[0].time / 0.1) - 20

    def spoil(k: int, env: ImpactEnv, observations: dict[str, np.ndarray]) -> None:
        if begin <= k < begin + 20:
            for name, vector in observations.items():
                if gone.start == 14 or name == plan.impacts[0].robot:
                    vector[gone] = np.nan

    success, impacts, fallbacks = play(scenario, FreeFlyerExpert(scenario, plan), disturb=spoil)
    assert success
    assert len(impacts) == 2
    assert fallbacks == {"no_measurement": 20}


def test_object_that_is_not_where_expected_is_found_and_caught(scenario: FreeFlyerScenario, plan: Plan) -> None:
    """On its way the object loses a third of its speed and is turned aside, as by a collision nobody felt."""
    catch = plan.impacts[1]

    def shove(k: int, env: ImpactEnv, observations: dict[str, np.ndarray]) -> None:
        if k == 130:
            states = env.model.state()
            states[2, 2:4] = 0.7 * states[2, 3] * np.array([0.15, 1.0])
            env.model.set_state(states)

    expert = FreeFlyerExpert(scenario, plan)
    success, impacts, fallbacks = play(scenario, expert, disturb=shove)
    assert success
    assert fallbacks == {}
    assert [(i.a, i.b) for i in impacts] == [(i.robot, i.object) for i in plan.impacts]
    assert impacts[1].time > catch.time + 1.0
    blind = FreeFlyerExpert(scenario, plan, options=replace(EXPERT, retime=False))
    assert play(scenario, blind, disturb=shove)[1][1].time < impacts[1].time


@pytest.mark.parametrize(("value", "lead"), [(0.0, 5.0), (0.5, 5.0), (1.0, 8.0)])
@pytest.mark.parametrize("number", [0, 1])
def test_actuator_stuck_for_two_seconds_is_made_up_for(
    scenario: FreeFlyerScenario, plan: Plan, number: int, value: float, lead: float
) -> None:
    """Dead, at half thrust, or at full thrust while there is still time."""
    hit = plan.impacts[number]
    expert, stick = FreeFlyerExpert(scenario, plan), stick_at([value, 0.0, 0.0], hit, lead)
    success, impacts, fallbacks = play(scenario, expert, actuate=stick)
    assert success
    assert [(i.a, i.b) for i in impacts] == [(i.robot, i.object) for i in plan.impacts]
    assert set(fallbacks) == ({"lost"} if value else set())


@pytest.mark.parametrize("push", [[1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
@pytest.mark.parametrize("number", [0, 1])
def test_whatever_is_stuck_the_episode_goes_on_and_it_is_counted(
    scenario: FreeFlyerScenario, plan: Plan, number: int, push: list[float]
) -> None:
    """Full thrust along both axes throws the robot half a metre off its course, full torque turns it round."""
    expert = FreeFlyerExpert(scenario, plan)
    _, impacts, fallbacks = play(scenario, expert, actuate=stick_at(push, plan.impacts[number], 5.0))
    assert any(i.a == plan.impacts[number].robot and i.b == "pop" for i in impacts)
    assert push[2] or fallbacks["lost"] > 0


def stick_at(push: list[float], hit: PlannedImpact, lead: float) -> Callable[[int, dict[str, np.ndarray]], None]:
    """Return what replaces the action of an impact's robot for 2 s, from so many seconds before the impact."""
    begin = round((hit.time - lead) / 0.1)

    def stick(k: int, actions: dict[str, np.ndarray]) -> None:
        if begin <= k < begin + 20:
            actions[hit.robot][:] = push

    return stick


def test_solver_out_of_steps_falls_back_and_still_succeeds(scenario: FreeFlyerScenario, plan: Plan) -> None:
    expert = FreeFlyerExpert(scenario, plan)
    expert.workspace.steps[:] = 0
    success, impacts, fallbacks = play(scenario, expert)
    assert success
    assert len(impacts) == 2
    assert fallbacks["shifted_plan"] > 0
    assert set(fallbacks) <= {"shifted_plan", "lqr"}


def test_fallbacks_in_their_order(scenario: FreeFlyerScenario, plan: Plan) -> None:
    """After a solved step nine inputs are left of its plan; then it is LQR."""
    on_course = replace(EXPERT, replanning=replace(EXPERT.replanning, off_course=10.0))  # whatever is believed
    expert, env = FreeFlyerExpert(scenario, plan, options=on_course), parallel_env(scenario)
    observations, _ = env.reset(seed=SEED)
    expert.reset(SEED)
    expert.act(observations)
    robots = len(scenario.robots)
    solved = expert.workspace.solution[0].reshape(STAGES, 3).copy()  # of the last robot
    last, limits = scenario.agents[-1], np.array([1.5, 1.5, 0.5])
    believed = expert.memory.filter["position"][0, :robots] + 0.5  # so far off that the limits bind, only the QP does

    def act() -> np.ndarray:
        expert.observe(observations)
        expert.memory.filter["position"][0, :robots] = believed
        return expert.control()[last]

    def count() -> dict[str, int]:
        return {name: n for name, n in expert.diagnostics().fallbacks.items() if name in {"shifted_plan", "lqr"}}

    expert.workspace.steps[:] = 0
    for k in range(1, STAGES):
        np.testing.assert_allclose(act(), solved[k] / limits, atol=1e-15)
    assert count() == {"shifted_plan": robots * (STAGES - 1)}
    action = act()
    assert count() == {"shifted_plan": robots * (STAGES - 1), "lqr": robots}
    np.testing.assert_allclose(action[:2], [-1.0, -1.0])  # back to where it should be
    expert.workspace.steps[:] = NEWTON_STEPS
    act()
    assert count()["lqr"] == robots


@pytest.mark.parametrize(("drift", "tolerance"), [(0.0, 5e-3), (1e-3, 5e-3)])
def test_learns_the_true_velocity_gain_of_one_impact(
    scenario: FreeFlyerScenario, plan: Plan, drift: float, tolerance: float
) -> None:
    """Restitution 0.4 instead of 0.8 is a factor of 1.4 / 1.8."""
    world = scenario.override({"true.restitution": 0.4, "true.drift": drift})
    true = 1.4 / 1.8
    for seed in range(3):
        assert learn(FreeFlyerExpert(world, plan), world, plan, seed) == pytest.approx(true, rel=tolerance)


def test_filter_without_drift_blames_it_on_the_impact(scenario: FreeFlyerScenario, plan: Plan) -> None:
    world = scenario.override({"true.restitution": 0.4, "true.drift": 1e-3})
    errors = {}
    for variant in (None, "with_learning"):
        found = [learn(FreeFlyerExpert(world, plan, variant), world, plan, seed) for seed in range(3)]
        errors[variant] = np.abs(np.array(found) - 1.4 / 1.8).max()
    assert errors["with_learning"] > 1.5 * errors[None]


@pytest.mark.parametrize("variant", ["one_replan", "paper_expert"])
def test_variants_without_learning_believe_on(scenario: FreeFlyerScenario, plan: Plan, variant: str) -> None:
    world = scenario.override({"true.restitution": 0.4})
    assert learn(FreeFlyerExpert(world, plan, variant), world, plan, 0) == 1.0


def learn(expert: FreeFlyerExpert, world: FreeFlyerScenario, plan: Plan, seed: int) -> float:
    """Return true over believed velocity gain as it is known well after the first impact."""
    env = parallel_env(world)
    observations, _ = env.reset(seed=seed)
    expert.reset(seed)
    while env.time < plan.impacts[0].time + 5.0:
        observations, *_ = env.step(expert.act(observations))
    return float(compute_pair_gain(expert.memory, 0, 0, 0)) / 0.9


def test_variants_by_name(scenario: FreeFlyerScenario, plan: Plan) -> None:
    assert list_variants(scenario) == tuple(VARIANTS)
    for variant, options in VARIANTS.items():
        expert = make_expert(scenario, plan, variant)
        assert (expert.name, expert.options) == (variant, options)
    assert make_expert(scenario, plan).name == "expert"
    assert make_expert(scenario, plan).options == Options()


def test_each_variant_has_one_part_more_than_the_last() -> None:
    every = [*VARIANTS.values(), EXPERT]
    assert all(options.filter for options in every)  # of a learner, no part of an expert
    parts = [{name for name, on in vars(options).items() if on is True} - {"filter"} for options in every]
    once, paper, weights, *rest = parts
    assert once == {"once"}
    assert paper == weights == set()
    assert replace(VARIANTS["paper_expert"], weights=EXPERT.weights) == VARIANTS["with_weights"]
    assert VARIANTS["paper_expert"].weights == VARIANTS["one_replan"].weights == PUBLISHED_WEIGHTS
    order = ["exact", "avoid", "learn", "retime", "drift", "insert", "reoptimise"]
    order += ["offset", "walls", "respond", "thrusters", "plan_anew"]
    for part, fewer, more in zip(order, [weights, *rest], rest, strict=False):
        assert more - fewer == {part}
        assert fewer < more
    assert replace(VARIANTS["with_thrusters"], plan_anew=True) == EXPERT


def test_unknown_variant_is_refused_with_the_choices(scenario: FreeFlyerScenario, plan: Plan) -> None:
    for make in (make_expert, FreeFlyerExpert):
        with pytest.raises(InputError, match=r"variant 'paper_expret'.*paper_expert") as refusal:
            make(scenario, plan, "paper_expret")
        assert "\n" not in str(refusal.value)


def test_published_code_replans_each_impact_once(scenario: FreeFlyerScenario, plan: Plan, nominal: Episode) -> None:
    episode = rollout(parallel_env(scenario), FreeFlyerExpert(scenario, plan, "one_replan"), SEED)
    # Per impact one course to it and one back to the plan.
    assert episode.replans == 2 * len(plan.impacts)
    assert episode.success
    assert nominal.replans > 10 * len(plan.impacts)


def test_lqr_tracks_without_counting_as_a_fallback(scenario: FreeFlyerScenario, plan: Plan) -> None:
    expert = FreeFlyerExpert(scenario, plan, options=replace(EXPERT, tracker="lqr"))
    success, _, fallbacks = play(scenario, expert)
    assert success
    assert fallbacks == {}


def test_corrections_out_of_turn_or_shape_are_refused(scenario: FreeFlyerScenario, plan: Plan) -> None:
    expert = FreeFlyerExpert(scenario, plan)
    with pytest.raises(InputError, match="no correction is awaited"):
        expert.correct(np.zeros(3))
    with pytest.raises(InputError, match="3 finite numbers"):
        expert.correct(np.zeros(2))


def test_plan_of_something_else_is_refused(scenario: FreeFlyerScenario, plan: Plan) -> None:
    with pytest.raises(InputError, match="lasts 30 s, scenario throw_and_catch lasts 18 s"):
        FreeFlyerExpert(scenario.suite("short"), plan)
    pair, _ = make_pair()
    with pytest.raises(InputError, match="has a, b, idle, one, two"):
        FreeFlyerExpert(pair, plan)


def test_make_expert_passes_on_the_plan(scenario: FreeFlyerScenario, plan: Plan) -> None:
    assert make_expert(scenario, plan).plan == plan


def test_several_objects_and_a_robot_without_impacts() -> None:
    scenario, plan = make_pair()
    episode = rollout(parallel_env(scenario), FreeFlyerExpert(scenario, plan), SEED)
    assert sorted((i.a, i.b) for i in episode.impacts) == [("a", "one"), ("b", "two")]
    ends = {name: [episode.signals[f"{name}.{axis}"][-1] for axis in "xy"] for name in scenario.objects}
    # Where the formula says nothing the object ends as planned; where it does, deep enough: 0.1 m are planned.
    np.testing.assert_allclose(ends["two"], plan.objects["two"].position(plan.horizon, "left"), atol=0.01)
    assert 1.6 + EXPERT.aim.deep_enough * 0.1 <= ends["one"][0] + 1e-3 < 1.71
    still = [np.ptp(episode.signals[f"idle.{axis}"]) for axis in "xy"]
    assert max(still) < 1e-9


def make_pair() -> tuple[FreeFlyerScenario, Plan]:
    """Return two robots that each throw their own object along x at nearly the same time, and an idle third."""
    base = load("throw_and_catch")
    robot, item = next(iter(base.robots.values())), next(iter(base.objects.values()))
    places = {"a": (0.5, 0.5), "b": (0.5, 2.0), "idle": (0.5, 3.3)}
    scenario = base.override(
        {
            "robots": {name: robot.model_dump() | {"start": at, "goal": None} for name, at in places.items()},
            "objects": {
                name: item.model_dump() | {"start": at, "rest": False}
                for name, at in {"one": (1.5, 0.5), "two": (1.5, 2.0)}.items()
            },
            "regions": {},
            "horizon": 20.0,
            "formula": "F[0,20] one.x >= 1.6",
        }
    )
    impacts, curves, paths = [], {}, {}
    alpha = 1.8 * robot.mass / (robot.mass + item.mass)
    for name, target, time in (("a", "one", 10.0), ("b", "two", 10.3)):
        start, place = np.array(places[name]), np.array(scenario.objects[target].start)
        n, speed, reach = np.array([1.0, 0.0]), 0.02, robot.radius + item.radius
        minus, plus = speed / alpha * n, (speed / alpha - speed) * n
        contact = place - reach * n
        ahead = [start, start, start, contact - 2 * time / 5 * minus, contact - time / 5 * minus, contact]
        h = 20.0 - time
        end = contact + 0.3 * h * plus
        behind = [contact, contact + h / 5 * plus, contact + 2 * h / 5 * plus, end, end, end]
        curves[name] = Curve([0.0, time, 20.0], [ahead, behind])
        path = [[place] * 2, [place, place + h * speed * n]]
        paths[target] = Curve([0.0, time, 20.0], path)
        impacts.append(PlannedImpact(time, name, target, place, contact, n, minus, plus, 0 * n, speed * n))
    curves["idle"] = Curve([0.0, 20.0], [[places["idle"]]])
    return scenario, plans.make_plan(scenario, impacts, curves, paths)
