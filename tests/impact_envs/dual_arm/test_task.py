"""What arms see, do and are judged by: observations without the box, torques, the record of the grasp."""

import numpy as np
import pytest

from impact_envs import JointEnv, load_scenario, parallel_env, vector_env
from impact_envs.dual_arm.grasp_record import FIRST, GRASP
from impact_envs.dual_arm.model import DualArmModel
from impact_envs.dual_arm.plant import NORMAL
from impact_envs.dual_arm.schema import GRASP_SIGNALS
from impact_envs.dual_arm.task import DualArmTask
from impact_envs.stl import parse

SCENARIO = load_scenario("dual_arm_grasp")
SLOW = SCENARIO.override({"control_period": 0.01})


def push_together(scenario):
    """A model whose pads stand on their faces of a box where it is believed to be, and torques that press."""
    model = DualArmModel(scenario.as_believed())
    poses = scenario.contact_poses(scenario.box.start.array)
    model.set_joints(scenario.joint_angles(poses), np.zeros((2, 3)))
    return model, np.array([[35.0, -2.0, 2.0], [-35.0, 2.0, -2.0]])


def column(name):
    return 14 + GRASP_SIGNALS.index(name)


def test_the_box_is_in_the_state_and_nowhere_in_the_observations():
    near, far = (parallel_env(SCENARIO.override({"true.box_y": y, "true.box_heading": 0.0})) for y in (-0.02, 0.03))
    for env in (near, far):
        env.reset(seed=0)
    for _ in range(60):
        actions = {name: np.full(3, 0.3) for name in SCENARIO.agents}
        (first, *_), (second, *_) = near.step(actions), far.step(actions)
        assert not near.impacts and not far.impacts
        for name in SCENARIO.agents:
            assert np.array_equal(first[name], second[name])
    assert np.array_equal(*(env.task.observe_jointly(env.time, env.conjuncts) for env in (near, far)))
    difference = np.flatnonzero(near.state() != far.state())
    assert difference.size
    assert set(difference) <= set(range(2 * 22, 3 * 22))  # the box's row


def test_an_observation_begins_with_joints_and_forces_and_has_the_other_arm_after_it():
    task, (model, torques) = DualArmTask(SCENARIO), push_together(SCENARIO)
    for _ in range(20):
        model.tick(torques)
    task.reset(model.physics, model.state(), np.random.default_rng(0))
    observations = task.observe(1.1, (0.0, 0.0))
    q, v = model.joints()
    forces = model.contacts()[:4, NORMAL].reshape(2, 2)
    assert forces.max() > 0.0
    for i, name in enumerate(SCENARIO.agents):
        vector = observations[name]
        assert np.array_equal(vector[:8], [*q[i], *v[i], *forces[i]])
        assert vector[8:10] == pytest.approx(model.state()[i, :2])
        assert np.hypot(*vector[10:12]) == pytest.approx(1.0)
        assert np.array_equal(vector[15:30], observations[SCENARIO.agents[1 - i]][:15])
        assert vector[-1] == 0.5
    assert np.array_equal(task.observe_jointly(1.1, (0.0, 0.0)), observations["arm_1"])


def test_actions_are_shares_of_the_torque_limits():
    task = DualArmTask(SCENARIO)
    controls = task.controls({"arm_1": np.array([1.0, -0.5, 2.0]), "arm_2": np.zeros(3)})
    assert controls["arm_1"] == pytest.approx([70.0, -35.0, 30.0])
    assert task.impulse(controls) == pytest.approx(135.0 * SCENARIO.control_period)


def test_a_second_of_effort_costs_the_same_however_long_a_step_is():
    action = np.array([1.0, 0.5, 0.0])
    fast, slow = (DualArmTask(scenario).effort(action) / scenario.control_period for scenario in (SCENARIO, SLOW))
    assert fast == pytest.approx(slow)
    assert 0.0 < DualArmTask(SLOW).effort(np.ones(3)) <= 1.0


def test_the_record_of_a_period_is_the_worst_of_its_ticks():
    rng = np.random.default_rng(0)
    commands = rng.uniform(-80.0, 80.0, (3, SLOW.ticks, 2, 3))
    model, ticks = DualArmModel(SLOW), DualArmModel(SCENARIO)
    last = None
    for period in commands:
        model.step({name: period[:, i] for i, name in enumerate(SLOW.agents)})
        steps = []
        for row in np.clip(period, -model.plant.limits, model.plant.limits):
            ticks.step({name: row[i] for i, name in enumerate(SLOW.agents)})
            steps.append(np.zeros((2, 3)) if last is None else np.abs(row - last))
            last = row
        worst = np.array(steps).max(axis=(0, 2))
        peak = np.abs(np.clip(period, -model.plant.limits, model.plant.limits)).max(axis=(0, 2))
        state = model.state()
        assert state[:, column("torque_step")] == pytest.approx([*worst, worst.max()])
        assert state[:, column("torque")] == pytest.approx([*peak, peak.max()])
    assert np.array_equal(model.state()[:, :14], ticks.state()[:, :14])
    since_reset = slice(column("slip"), column("limit_time") + 1)
    assert np.array_equal(model.state()[:, since_reset], ticks.state()[:, since_reset])


def test_impacts_grasp_and_slip_are_kept_as_they_happen():
    model, torques = push_together(SCENARIO)
    forces, slips = [], []
    for _ in range(200):
        model.tick(torques)
        forces.append(model.contacts()[:4, NORMAL])
        slips.append(model.slips())
    full = np.array(forces).min(axis=1) > 1.0
    runs = np.convolve(full, np.ones(15, int))[: len(full)]
    grasp, marks = int(np.argmax(runs == 15)), model.record().marks
    assert marks[GRASP] == grasp > 0
    first = marks[FIRST : FIRST + 2]
    assert (first >= 0).all()
    state = model.state()
    assert state[2, column("lag")] == pytest.approx(abs(first[0] - first[1]) * 1e-3)
    assert state[2, column("interim")] == pytest.approx((grasp - first.min()) * 1e-3)
    slip = np.abs(slips[-1] - slips[grasp]).reshape(2, 2).max(axis=1)
    assert state[:, column("slip")] == pytest.approx([*slip, slip.max()])


def test_time_at_a_limit_counts_from_the_first_contact():
    apart = DualArmModel(SCENARIO)
    for _ in range(5):
        apart.tick(np.full((2, 3), 100.0))
    assert not apart.state()[:, column("limit_time")].any()
    model, torques = push_together(SCENARIO)
    for _ in range(10):
        model.tick(torques)
    assert model.state()[2, column("lag")] >= 0.0 and model.record().marks[FIRST] >= 0
    before = model.state()[2, column("limit_time")]
    torques[1, 2] = -30.0
    for _ in range(4):
        model.tick(torques)
    assert model.state()[:, column("limit_time")] - before == pytest.approx([0.0, 0.004, 0.004])


def test_signals_are_bounded_as_promised_and_speak_in_formulas():
    env = parallel_env(SLOW)
    env.reset(seed=0)
    rng = np.random.default_rng(1)
    names = {f"{body}.{signal}" for body in SCENARIO.bodies for signal in SCENARIO.signals}
    bounds = env.task.signal_bounds()
    for _ in range(60):
        env.step({name: rng.uniform(-1.0, 1.0, 3) for name in SLOW.agents})
        assert env.signals.keys() == names
        assert all(np.isfinite(value) for value in env.signals.values())
        assert all(low <= env.signals[name] <= high for name, (low, high) in bounds.items())
    assert SCENARIO.override({"formula": "G[0,2] arm_1.lag <= 1"}).specification == parse("G[0,2] arm_1.lag <= 1")


def test_chains_lead_from_the_bases_to_the_pads():
    task, model = DualArmTask(SCENARIO), DualArmModel(SCENARIO)
    chains = task.chains(model.state())
    for i, (name, arm) in enumerate(SCENARIO.arms.items()):
        assert chains[name][0] == pytest.approx(arm.base)
        assert chains[name][-1] == pytest.approx(model.state()[i, :2])
        assert np.hypot(*np.diff(chains[name], axis=0).T) == pytest.approx(SCENARIO.links.lengths)


def test_shapes_stand_where_the_scenario_says():
    shapes = {shape.label: shape for shape in DualArmTask(SCENARIO).shapes()}
    assert {"goal", "table", "box", "arm_1", "arm_2"} == set(shapes)
    assert max(y for _, y in shapes["table"].vertices) == pytest.approx(0.15)  # under the box
    assert {shape.body for shape in shapes.values()} == {None, "box", "arm_1", "arm_2"}


def test_many_worlds_are_drawn_with_their_arms():
    worlds, single = vector_env("dual_arm_grasp", 1, render_mode="rgb_array"), JointEnv("dual_arm_grasp", "rgb_array")
    worlds.reset(seed=3)
    single.reset(seed=3)
    assert np.array_equal(worlds.render()[0], single.render())
