import tomllib
from pathlib import Path

import numpy as np
import pytest

import impact_envs
from impact_envs.dual_arm.model import DualArmModel
from impact_envs.dual_arm.plant import NORMAL
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.errors import InputError
from impact_envs.scenario import build_scenario

PATH = Path(impact_envs.__file__).parent / "dual_arm" / "scenarios" / "dual_arm_grasp.toml"
DATA = tomllib.loads(PATH.read_text())
SCENARIO = DualArmScenario.model_validate(DATA)


def make(**values: object) -> DualArmScenario:
    """Return the scenario with some dotted keys replaced."""
    data = tomllib.loads(PATH.read_text())
    for key, value in values.items():
        table = data
        *path, last = key.split("__")
        for part in path:
            table = table[part]
        table[last] = value
    return DualArmScenario.model_validate(data)


# Ten ticks in a step.
LONG = make(control_period=0.01)


def hold(model: DualArmModel) -> np.ndarray:
    """Return the torques of the arms' weight at the start."""
    from impact_envs.dual_arm.arm import compute_dynamics

    q, _ = model.joints()
    M, load = np.zeros((3, 3)), np.zeros((2, 3))
    for i in range(2):
        compute_dynamics(model.plant.arms[i], q[i], np.zeros(3), M, load[i])
    return load


@pytest.mark.parametrize("flexible", [True, False])
def test_arms_held_against_their_weight_stay(flexible):
    model = DualArmModel(make(joints__flexible=flexible))
    before, torques = model.state(), hold(model)
    for _ in range(50):
        model.tick(torques)
    assert model.state()[:, :12] == pytest.approx(before[:, :12], abs=1e-6)
    assert model.time == pytest.approx(0.05)


def test_the_box_rests_on_its_turned_table():
    model = DualArmModel(SCENARIO)
    model.reset(SCENARIO.draw(np.random.default_rng(0)))
    before, torques = model.state(), hold(model)
    for _ in range(200):
        model.tick(torques)
    assert model.state()[2, :2] == pytest.approx(before[2, :2], abs=2e-4)
    assert model.contacts()[4:, NORMAL].sum() == pytest.approx(2.0 * 9.81 * np.cos(np.radians(2.5)), rel=0.01)


def test_a_period_is_its_ticks():
    one, other = DualArmModel(LONG), DualArmModel(LONG)
    torques = np.random.default_rng(0).normal(0.0, 20.0, (LONG.ticks, 2, 3))
    one.step({"arm_1": torques[:, 0], "arm_2": torques[:, 1]})
    for row in torques:
        other.tick(row)
    assert np.array_equal(one.state()[:, :14], other.state()[:, :14])
    one.step({"arm_1": torques[0, 0], "arm_2": torques[0, 1]})
    for _ in range(LONG.ticks):
        other.tick(torques[0])
    assert np.array_equal(one.state()[:, :14], other.state()[:, :14])


def test_torques_are_clipped_to_their_limits():
    one, other = DualArmModel(SCENARIO), DualArmModel(SCENARIO)
    one.tick(np.full((2, 3), 1e3))
    other.tick(one.plant.limits)
    assert np.array_equal(one.state(), other.state())


def test_each_pads_first_touch_is_an_impact_on_the_box():
    model = DualArmModel(make(control_period=0.01, joints__flexible=False))
    poses = SCENARIO.contact_poses(SCENARIO.box.start.array)
    model.set_joints(SCENARIO.joint_angles(poses), np.zeros((2, 3)))
    push = hold(model) + np.array([[5.0, -5.0, 0.0], [-5.0, 5.0, 0.0]])
    controls = {"arm_1": push[0], "arm_2": push[1]}
    impacts = [impact for _ in range(5) for impact in model.step(controls)]
    assert [impact.a for impact in impacts] == ["arm_1", "arm_2"]
    for impact, side in zip(impacts, (1.0, -1.0), strict=True):
        assert impact.b == "box"
        assert impact.normal == pytest.approx((side, 0.0), abs=1e-3)
        assert impact.impulse[0] * side > 0.0
        assert impact.point[0] == pytest.approx(-side * SCENARIO.box.half_width, abs=1e-3)


@pytest.mark.parametrize(
    ("controls", "message"),
    [
        ({"arm_1": np.zeros(3)}, "wrong or missing: arm_2"),
        ({"arm_1": np.zeros(3), "arm_2": np.zeros(2)}, r"control of arm_2 = \[0\. 0\.\]: 3 finite joint torques"),
        ({"arm_1": np.full(3, np.nan), "arm_2": np.zeros(3)}, "control of arm_1"),
    ],
)
def test_bad_controls_are_refused(controls, message):
    with pytest.raises(InputError, match=message):
        DualArmModel(SCENARIO).step(controls)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("box__start", {"position": [0.0, 1.2]}, "box.start: arms.arm_1: pose .* is out of reach"),
        ("target", {"position": [0.9, 0.6]}, "target: arms.arm_1: pose .* is out of reach"),
        ("believed__friction", 0.7, "believed.friction = 0.7 is above the pads' true friction 0.6"),
        ("pads__stiffness", -1e4, "greater than 0"),
        ("physics_step", 3e-4, "physics_step = 0.0003 does not divide 0.001"),
        ("arms__arm_1", {**DATA["arms"]["arm_1"], "start": {"position": [-0.1, 0.3]}}, "behind its face of the box"),
        ("true", {"mass_scale": 0.0}, "mass_scale must be above 0"),
        ("true", {"box_y": {"uniform": [0.0, 1.0]}}, "true box: arms.arm_1: pose .* is out of reach"),
        ("true", {"start_x": {"uniform": [-1.5, 0.0]}}, "true start: arms.arm_1: pose .* is out of reach"),
        ("true", {"box_x": 0.4}, "arms.arm_2: true start: the pad is .* behind its face of the box"),
    ],
)
def test_bad_set_ups_are_refused(key, value, message):
    with pytest.raises(ValueError, match=message):
        make(**{key: value})


def test_worlds_are_drawn_from_the_seed_and_the_expert_sees_none_of_it():
    spread = make(true={"box_y": {"uniform": [-0.02, 0.02]}, "start_x": {"uniform": [-0.05, 0.05]}})
    first, again = (spread.draw(np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(first.box, again.box) and np.array_equal(first.starts, again.starts)
    assert not np.array_equal(first.box, spread.draw(np.random.default_rng(4)).box)
    believed = spread.as_believed().draw(np.random.default_rng(3))
    assert np.array_equal(believed.box, spread.box.start.array)


def test_an_override_is_validated_anew():
    assert build_scenario(dict(DATA), "here").override({"box.mass": 1.0}).box.mass == 1.0


@pytest.mark.parametrize("name", tomllib.loads((PATH.parents[1] / "suites.toml").read_text()))
def test_suites_change_the_true_world_and_nothing_that_is_believed(name):
    data = tomllib.loads(PATH.read_text())
    suite = tomllib.loads((PATH.parents[1] / "suites.toml").read_text())[name]
    data["true"] |= {key.removeprefix("true."): value for key, value in suite.items()}
    assert all(key.startswith("true.") for key in suite)
    changed = DualArmScenario.model_validate(data)
    first, second = (changed.draw(np.random.default_rng(seed)) for seed in (0, 1))
    names = ("box", "mass", "friction", "stiffness", "joint_stiffness", "starts")
    same = all(np.array_equal(getattr(first, key), getattr(second, key)) for key in names)
    assert same == (name == "nominal")
    assert changed.as_believed() == SCENARIO.as_believed()
    DualArmModel(changed).reset(first)
