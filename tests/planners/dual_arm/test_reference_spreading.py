import math
import pickle
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import impact_envs
from impact_envs import load_scenario, parallel_env, rollout
from impact_envs.dual_arm.model import DualArmModel
from impact_envs.dual_arm.plant import NORMAL
from impact_envs.dual_arm.schema import DualArmScenario, Pose
from impact_envs.errors import InputError
from planners import list_options, make_expert
from planners.dual_arm.expert import DualArmExpert
from planners.dual_arm.impact_prediction import simulate_impacts
from planners.dual_arm.options import EXPERT, PAPER, VARIANTS, ControllerOptions
from planners.dual_arm.reference import make_impact_map
from planners.dual_arm.reference_spreading import ReferenceSpreading
from planners.options import replace_options

PATH = Path(impact_envs.__file__).parent / "dual_arm" / "scenarios" / "dual_arm_grasp.toml"
SCENARIO = DualArmScenario.model_validate(tomllib.loads(PATH.read_text()))
LIMITS = np.array([SCENARIO.links.torque_limits] * 2)
AFTER = 400  # ticks after the first contact in which steps of the torque count


@dataclass(frozen=True)
class Run:
    torques: np.ndarray
    forces: np.ndarray
    hits: list[int]
    step: float
    peak: float
    at_limit: int
    interim: float
    slip: float
    box_error: float
    controller: ReferenceSpreading


@pytest.fixture(scope="module")
def impact_map():
    return make_impact_map(*simulate_impacts(SCENARIO.as_believed(), EXPERT), EXPERT.prediction.rho)


@pytest.fixture(scope="module")
def paper_map():
    return make_impact_map(*simulate_impacts(SCENARIO.as_believed(), PAPER), PAPER.prediction.rho)


def simulate(scenario: DualArmScenario, controller: ReferenceSpreading, seconds: float) -> Run:
    model = DualArmModel(scenario)
    model.reset(scenario.draw(np.random.default_rng(0)))
    ticks = round(seconds / scenario.tick)
    torques, forces, slips = np.zeros((ticks, 2, 3)), np.zeros((ticks, 4)), np.zeros((ticks, 4))
    for k in range(ticks):
        torques[k] = controller.control(*model.joints(), model.contacts()[:4, NORMAL])
        model.tick(torques[k])
        forces[k], slips[k] = model.contacts()[:4, NORMAL], model.slips()
    touched = forces.reshape(ticks, 2, 2).max(axis=2) > 0.0
    hits = [int(k) for k in touched.argmax(axis=0)]
    first, post = min(hits), round(controller.switches["post"] / scenario.tick)
    return Run(
        torques=torques,
        forces=forces,
        hits=hits,
        step=float(np.abs(np.diff(torques[first : first + AFTER], axis=0)).max()),
        peak=float(np.abs(torques[first:]).max()),
        at_limit=int((np.abs(torques[first:]) >= LIMITS - 1e-6).any(axis=(1, 2)).sum()),
        interim=(post - first) * scenario.tick,
        slip=float(np.abs(slips[-1] - slips[post]).max()),
        box_error=math.dist(controller.box[:2], scenario.target.position),
        controller=controller,
    )


@pytest.fixture(scope="module")
def runs(impact_map, paper_map):
    """The nominal set-up under the expert and its variants."""
    variants = {name: VARIANTS[name].controller for name in ("published", "no_impact_map", "no_interim_phase")}
    controllers = {name: ReferenceSpreading(SCENARIO, paper_map, options) for name, options in variants.items()}
    controllers["expert"] = ReferenceSpreading(SCENARIO, impact_map)
    return {name: simulate(SCENARIO, controller, 2.2) for name, controller in controllers.items()}


@pytest.mark.parametrize("name", ["published", "expert"])
def test_both_arms_hit_at_once_and_carry_the_box_to_the_target(runs, name):
    run = runs[name]
    assert abs(run.hits[0] - run.hits[1]) <= 15
    assert list(run.controller.switches) == ["ante", "interim", "post"]
    assert run.interim <= 0.04
    assert run.slip <= 4e-3
    assert run.box_error <= 10e-3
    assert not run.controller.fallbacks
    post = round(run.controller.switches["post"] / SCENARIO.tick)
    assert np.mean(run.forces[post:].min(axis=1) > 0.0) >= 0.99


@pytest.mark.parametrize("name", ["published", "expert"])
def test_the_proposed_controller_steps_least(runs, name):
    step = runs[name].step
    assert step <= 20.0
    assert step <= 0.25 * runs["no_impact_map"].step
    assert step <= 0.45 * runs["no_interim_phase"].step


def test_only_without_the_impact_map_torques_reach_their_limits_after_contact(runs):
    assert {name for name, run in runs.items() if run.at_limit} == {"no_impact_map"}
    assert runs["no_impact_map"].at_limit >= 20


def test_the_soft_start_keeps_torques_from_their_limits_before_contact(runs):
    def saturated(run: Run) -> bool:
        return bool((np.abs(run.torques[: min(run.hits)]) >= LIMITS - 1e-6).any())

    assert saturated(runs["published"])
    assert not saturated(runs["expert"])


def test_the_prediction_meets_the_box_as_it_leaves(runs):
    """Without the map the reference at the grasp is an order of magnitude farther from the box's velocity."""
    controller = runs["published"].controller
    assert controller.predicted[:2] == pytest.approx((0.0, 0.24), abs=0.02)
    target, start = np.array(SCENARIO.target.position), np.array(SCENARIO.box.start.position)
    without = np.linalg.norm(4.0 * (target - start) - controller.predicted[:2])
    assert without > 1.0


def test_arms_that_are_not_synchronised_hit_far_apart(paper_map):
    run = simulate(SCENARIO, ReferenceSpreading(SCENARIO, paper_map, VARIANTS["no_synchronisation"].controller), 1.3)
    assert abs(run.hits[0] - run.hits[1]) > 50


def test_from_far_starts_both_pads_meet_the_box_in_time_and_at_its_middle(impact_map, paper_map):
    """Start poses at the corner of the suite, from which the published reference turns too late."""
    physics = SCENARIO.draw(np.random.default_rng(0))
    starts = physics.starts + np.array([[0.06, -0.08, 0.4], [-0.06, 0.08, 0.4]])
    heights, lags = {}, {}
    for name, (options, found) in {
        "expert": (EXPERT.controller, impact_map),
        "paper": (PAPER.controller, paper_map),
    }.items():
        model, controller = DualArmModel(SCENARIO), ReferenceSpreading(SCENARIO, found, options)
        model.reset(replace(physics, starts=starts))
        first = [math.inf, math.inf]
        for k in range(1000):
            model.tick(controller.control(*model.joints(), model.contacts()[:4, NORMAL]))
            touched = model.contacts()[:4, NORMAL].reshape(2, 2).max(axis=1) > 0.0
            first = [k if now and before == math.inf else before for now, before in zip(touched, first, strict=True)]
        heights[name], lags[name] = np.abs(controller.heights).max(), abs(first[0] - first[1])
    assert heights["expert"] <= 5e-3 < heights["paper"]
    assert lags["expert"] <= 6


def test_the_grip_presses_as_asked(impact_map):
    """A held weight creeps less the more it is pressed, down to what the joints' springs give."""
    forces, slips = {}, {}
    for grip in (0.0, 25.0):
        run = simulate(SCENARIO, ReferenceSpreading(SCENARIO, impact_map, ControllerOptions(grip=grip)), 2.2)
        forces[grip], slips[grip] = run.forces[-1].mean(), run.slip
    assert forces[25.0] == pytest.approx(25.0, abs=1.0) and forces[0.0] < 16.0
    assert slips[25.0] < 0.6 * slips[0.0]


def test_the_press_ends_a_long_interim_phase(paper_map):
    """A turned, raised box off which the published controller bounces for a quarter of a second."""
    true = {"box_y": 0.0182, "box_heading": -0.0255}
    starts = {"arm_1": [-0.381, 0.064, 0.447], "arm_2": [0.456, 0.38, 3.701]}
    arms = {
        name: arm.model_copy(update={"start": Pose(position=tuple(starts[name][:2]), heading=starts[name][2])})
        for name, arm in SCENARIO.arms.items()
    }
    scenario = SCENARIO.model_copy(update={"true": SCENARIO.true.model_copy(update=true), "arms": arms})
    paper = simulate(scenario, ReferenceSpreading(scenario, paper_map, PAPER.controller), 1.3)
    pressed = simulate(scenario, ReferenceSpreading(scenario, paper_map, replace(PAPER.controller, press=10.0)), 1.3)
    assert paper.interim > 0.1
    assert pressed.interim <= 0.05
    assert pressed.step < paper.step


def test_a_pickled_run_goes_on_bit_for_bit(impact_map):
    model, controller = DualArmModel(SCENARIO), ReferenceSpreading(SCENARIO, impact_map)
    while controller.phase == "ante":
        model.tick(controller.control(*model.joints(), model.contacts()[:4, NORMAL]))
    assert controller.phase == "interim"
    copies = pickle.loads(pickle.dumps((model, controller)))
    for world, brain in ((model, controller), copies):
        for _ in range(100):
            world.tick(brain.control(*world.joints(), world.contacts()[:4, NORMAL]))
    assert controller.phase == copies[1].phase == "post"
    assert np.array_equal(model.state(), copies[0].state())


def test_a_time_out_ends_the_interim_phase(impact_map):
    controller = ReferenceSpreading(SCENARIO, impact_map, ControllerOptions(time_out=0.01))
    controller.control(*DualArmModel(SCENARIO).joints(), np.array([1.0, 0.0, 0.0, 0.0]))
    assert controller.phase == "interim"
    for _ in range(10):
        controller.control(*DualArmModel(SCENARIO).joints(), np.zeros(4))
    assert controller.phase == "post"


def test_the_fade_removes_the_step_at_the_grasp(paper_map):
    run = simulate(SCENARIO, ReferenceSpreading(SCENARIO, paper_map, replace(PAPER.controller, fade=0.01)), 1.2)
    post = round(run.controller.switches["post"] / SCENARIO.tick)
    assert np.abs(run.torques[post] - run.torques[post - 1]).max() < 1e-9
    assert run.step < 5.0


def test_rigid_joints_are_grasped_alike(paper_map):
    rigid = SCENARIO.model_copy(update={"joints": SCENARIO.joints.model_copy(update={"flexible": False})})
    run = simulate(rigid, ReferenceSpreading(rigid, paper_map, PAPER.controller), 1.6)
    assert abs(run.hits[0] - run.hits[1]) <= 15
    assert run.at_limit == 0
    assert run.step <= 22.0


def test_a_program_that_cannot_be_solved_is_counted_and_the_last_torques_held(impact_map):
    controller = ReferenceSpreading(SCENARIO, impact_map)
    q, v = DualArmModel(SCENARIO).joints()
    first = controller.control(q, v, np.zeros(4))
    held = controller.control(q, np.full((2, 3), np.nan), np.zeros(4))
    assert np.array_equal(held, first)
    assert controller.fallbacks == {"last_torque": 1}


def test_the_expert_knows_only_what_is_believed(tmp_path, monkeypatch):
    monkeypatch.setenv("IMPACT_ENVS_CACHE", str(tmp_path))
    model = DualArmModel(SCENARIO)
    q, v = model.joints()
    observations = {name: np.concatenate([q[i], v[i], np.zeros(25)]) for i, name in enumerate(SCENARIO.agents)}
    experts = [DualArmExpert(SCENARIO), DualArmExpert(SCENARIO.as_believed())]
    one, other = (expert.act(observations) for expert in experts)
    for name in SCENARIO.agents:
        assert np.array_equal(one[name], other[name])
        assert np.all(np.abs(one[name]) <= 1.0)
    experts[0].reset(0)
    assert np.array_equal(experts[0].act(observations)["arm_1"], one["arm_1"])
    assert len(experts[0].diagnostics().solve_seconds) == 1
    assert experts[0].controller.phase == "ante"
    assert not experts[0].diagnostics().fallbacks
    assert DualArmExpert(SCENARIO, "no_impact_map").name == "no_impact_map"


def test_bad_options_are_refused():
    with pytest.raises(InputError, match=r"controller\.k_int = -1; choices: from 0"):
        replace_options(EXPERT, {"controller.k_int": -1.0})
    with pytest.raises(InputError, match="did you mean 'no_interim_phase'"):
        DualArmExpert(SCENARIO, "no_interim")
    with pytest.raises(InputError, match="solver 'osqp' is unknown; choices: goldfarb_idnani, daqp, clarabel"):
        make_expert("dual_arm_grasp", options={"solver": "osqp"})
    with pytest.raises(InputError, match="needs an impact map"):
        ReferenceSpreading(SCENARIO, None)


def test_a_variant_is_a_set_of_options(impact_map):
    """What a variant does, an expert with the options of that variant does bit for bit."""
    scenario = load_scenario("dual_arm_grasp").override({"horizon": 1.0, "formula": "G[0,1] box.lag <= 0.015"})
    changes = {"controller.press": 0.0, "controller.grip": 40.0, "correction.period": 0.1}
    experts = (
        make_expert(scenario, variant="published", options={"controller.grip": 40.0, "correction.period": 0.1}),
        make_expert(scenario, options=list_options(scenario, "published") | changes),
    )
    first, second = (rollout(parallel_env(scenario), expert, 1) for expert in experts)
    for agent in scenario.agents:
        assert np.array_equal(first.actions[agent], second.actions[agent])
    assert {expert.controller.options.grip for expert in experts} == {40.0}
