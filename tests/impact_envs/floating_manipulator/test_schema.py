"""Scenario tables of the floating manipulator: what is computed from them, and what they refuse."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

import impact_envs
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario

FOLDER = Path(impact_envs.__file__).parent / "floating_manipulator"
NAMES = sorted(path.stem for path in FOLDER.rglob("floating_manipulator*.toml"))


def tables(name="floating_manipulator"):
    return {"name": name, **tomllib.loads(next(FOLDER.rglob(f"{name}.toml")).read_text())}


def validate(data):
    return FloatingManipulatorScenario.model_validate(data)


@pytest.mark.parametrize("name", NAMES)
def test_shipped_scenarios_start_where_the_paper_says(name):
    scenario = validate(tables(name))
    x, y, psi, *joints = scenario.start
    # Recovered joint angles of the paper's start.
    np.testing.assert_allclose(joints, [1.032470, 1.131766, -2.164236], atol=1e-6)
    assert (x, y, psi) == (5.0, -1.75, 0.1)
    assert psi + sum(joints) == pytest.approx(0.1)
    assert scenario.agents == (("arm", "base") if scenario.thrusters else ("arm",))


def test_elbow_has_the_sign_asked_for():
    data = tables()
    data["arm"]["elbow"] = "negative"
    up, down = validate(tables()).start, validate(data).start
    assert up[4] > 0 > down[4]
    assert sum(up[2:]) == pytest.approx(math.remainder(sum(down[2:]), math.tau))


def test_joints_may_be_given_for_any_number_of_links():
    data = tables() | {"requirements": {}}
    data["links"] = {f"part_{k}": data["links"]["link_1"] for k in range(5)}
    data["arm"] = {"goal": [3.0, 0.0], "joints": [0.1, 0.2, 0.3, 0.4, 0.5]}
    scenario = validate(data)
    assert scenario.start.shape == (8,)
    assert scenario.bodies == ("base", *(f"part_{k}" for k in range(5)), "tip", "box", "target")


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("box", "start", [7.5, 1.4], "tip starts inside the box"),
        ("arm", "tip", [12.0, 1.5], r"arm.tip = \[12.0, 1.5\].*out of reach"),
        ("base", "mass", 0.0, "greater than 0"),
        ("box", "mass", 0.0, "greater than 0"),
        ("arm", "joints", [0.1, 0.2, 0.3], "either joints or tip"),
        ("true", "box_offset_x", {"uniform": [-1.0, 5.0]}, "offsets of the box reach 5"),
        ("true", "box_mass_scale", 0.0, "box_mass_scale must be above 0"),
        ("true", "restitution", {"uniform": [0.5, 1.5]}, "restitution reaches 1.5"),
        ("links", "tip", {}, "links"),
        ("requirements", "mine", "G[0,30] box.torque <= 1", "requirements.mine: signal 'box.torque' is unknown"),
        ("requirements", "mine", "G[0,31] tip.x <= 1", "requirements.mine: looks 31 s ahead, the horizon is 30 s"),
        ("requirements", "mine", "G[0,30", "requirements: "),
    ],
)
def test_impossible_set_ups_are_refused(table, key, value, words):
    data = tables()
    data.setdefault(table, {})[key] = value
    if table == "links":
        data["links"]["tip"] = data["links"]["link_1"]
    with pytest.raises(ValidationError, match=words):
        validate(data)


def test_a_tighter_task_has_tighter_requirements():
    scenario = validate(tables())
    tight = scenario.shorten(0.5)
    assert tight.horizon == 15.0
    assert {name: f.horizon for name, f in tight.required.items()} == {
        name: f.horizon / 2 for name, f in scenario.required.items()
    }
    assert str(tight.required["hold"]) == "G[12.5,15] distance(tip, target) <= 0.05"


def test_true_worlds_follow_the_seed_and_leave_the_belief_alone():
    data = tables()
    suites = tomllib.loads((FOLDER / "suites.toml").read_text())
    for name, values in suites.items():
        data["true"] = {key.removeprefix("true."): value for key, value in values.items() if "true." in key}
        scenario = validate(data)
        one, two = (scenario.draw(np.random.default_rng(3)) for _ in range(2))
        other = scenario.draw(np.random.default_rng(4))
        assert one.box_mass == two.box_mass
        np.testing.assert_array_equal(one.box_start, two.box_start)
        differ = (one.restitution, one.box_mass, *one.box_start, one.chain.mass, *one.stall_torque) != (
            (other.restitution, other.box_mass, *other.box_start, other.chain.mass, *other.stall_torque)
        )
        assert differ == (name not in ("nominal", "sensing"))
        believed = scenario.as_believed().draw(np.random.default_rng(3))
        assert (believed.restitution, believed.box_mass, believed.chain.mass) == (1.0, 5.0, 12.0)
        np.testing.assert_array_equal(believed.box_start, [3.5, -0.5, 0.0])
