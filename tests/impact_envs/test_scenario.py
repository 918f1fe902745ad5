"""A scenario file is read whole or refused in one line that says what to mend."""

import numpy as np
import pytest

from impact_envs import list_scenarios, load_scenario
from impact_envs.domain import find_scenarios
from impact_envs.errors import ScenarioError
from impact_envs.free_flyer.truth import DRIFT_X, DRIFT_Y, MASS, RESTITUTION
from impact_envs.scenario import Uniform

CORRIDOR = next(path for path in find_scenarios() if path.stem == "corridor").read_text()


def write(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", list_scenarios())
def test_shipped_scenarios_load_and_know_their_name(name):
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.specification.horizon <= scenario.horizon
    assert load_scenario(scenario) is scenario


def test_a_path_serves_as_a_name(tmp_path):
    copy = load_scenario(write(tmp_path, CORRIDOR))
    assert copy.name == "mine"
    assert copy.robots == load_scenario("corridor").robots


BAD = {
    "typo in a key": (CORRIDOR.replace("force_limit", "force_limt", 1), ["force_limt", "robots.snap", "force_limit"]),
    "unknown region": (CORRIDOR.replace("pop in goal", "pop in gaol"), ["gaol", "goal", "corridor"]),
    "unknown body": (CORRIDOR.replace("pop in goal", "pup in goal"), ["pup", "pop"]),
    "start outside": (CORRIDOR.replace("start = [1.0, 1.0]", "start = [1.0, -1.0]"), ["robots.snap.start", "-1.0"]),
    "negative mass": (
        CORRIDOR.replace("mass = 16.8", "mass = -1.0", 1),
        ["robots.snap.mass", "-1.0", "greater than 0"],
    ),
    "empty": ("", ["empty", "domain", "formula"]),
    "not TOML": ("domain = ", ["TOML"]),
    "unknown domain": (CORRIDOR.replace('"free_flyer"', '"free_flier"'), ["free_flier", "free_flyer"]),
    "missing key": (CORRIDOR.replace("horizon = 100.0", ""), ["horizon", "missing"]),
    "text for a number": (CORRIDOR.replace("horizon = 100.0", 'horizon = "long"'), ["horizon", "'long'"]),
    "infinite": (CORRIDOR.replace("horizon = 100.0", "horizon = inf"), ["horizon", "inf"]),
    "formula too long": (CORRIDOR.replace("horizon = 100.0", "horizon = 90.0"), ["formula", "100", "90"]),
    "formula syntax": (CORRIDOR.replace("G[100,100] pop", "G[100,100 pop"), ["formula"]),
    "no sample in the interval": (CORRIDOR.replace("G[100,100] pop", "F[1.01,1.02] pop"), ["formula", "1.01"]),
    "unspeakable name": (CORRIDOR.replace("regions.goal", "regions.until"), ["until", "formula"]),
    "overlap": (CORRIDOR.replace("start = [1.0, 2.0]", "start = [1.0, 1.1]"), ["snap", "pop", "overlap"]),
    "one name twice": (
        CORRIDOR.replace("objects.pop", "objects.snap").replace("pop in goal", "snap in goal"),
        ["'snap' names both robots.snap and objects.snap"],
    ),
    "enormous inertia": (CORRIDOR.replace("inertia = 0.1594", "inertia = 1e19", 1), ["robots.snap.inertia", "1e+19"]),
    "box upside down": (CORRIDOR.replace("upper = [3.0, 10.0]", "upper = [-3.0, 10.0]", 1), ["world", "lower"]),
    "restitution above 1": (
        CORRIDOR.replace("restitution = 0.8", "restitution = 1.8"),
        ["believed.restitution", "1.8"],
    ),
    "true typo": (CORRIDOR + "\n[true]\nrestitutoin = 0.5\n", ["restitutoin", "true", "restitution"]),
    "text for a quantity": (CORRIDOR + '\n[true]\nrestitution = "high"\n', ["true.restitution = 'high'"]),
    "upper-case table": (
        CORRIDOR.replace("regions.goal", "regions.B")
        .replace("upper = [1.75", "upper = [-1.75")
        .replace("in goal", "in B"),
        ["regions.B", "lower"],
    ),
    "true above 1": (CORRIDOR + "\n[true]\nrestitution = { uniform = [0.5, 1.5] }\n", ["true", "1.5"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_in_one_line(case, tmp_path):
    text, words = BAD[case]
    path = write(tmp_path, text)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    for word in words:
        assert word in message, message


def test_missing_file_and_unknown_name_say_the_choices():
    with pytest.raises(ScenarioError, match=r"no/such\.toml.*corridor"):
        load_scenario("no/such.toml")
    with pytest.raises(ScenarioError, match=r"'coridor' is unknown; did you mean 'corridor'"):
        load_scenario("coridor")


@pytest.mark.parametrize(("length", "mass"), [(1e3, 1e3), (1e-3, 1e-3), (1e3, 1e-3)])
def test_other_units_are_taken(length, mass):
    """A robot of 600 kg and 1 m: 300 kg m^2 are 3e11 g mm^2."""
    unit = mass * length**2
    values = {"inertia": 300.0 * unit, "torque_limit": 10.0 * unit, "mass": 600.0 * mass}
    changed = load_scenario("corridor").override({f"robots.snap.{key}": value for key, value in values.items()})
    assert changed.robots["snap"].inertia == pytest.approx(300.0 * unit)


def test_override_validates_and_leaves_the_original():
    scenario = load_scenario("corridor")
    changed = scenario.override({"true.restitution": 0.5})
    assert changed.true.restitution == 0.5
    assert scenario.true.restitution is None
    with pytest.raises(ScenarioError, match="restitutoin"):
        scenario.override({"true.restitutoin": 0.5})


def test_suites_change_only_the_true_world():
    scenario = load_scenario("throw_and_catch")
    for name in ("nominal", "restitution", "mass", "sensing", "drift", "actuation", "all"):
        changed = scenario.suite(name)
        assert changed.as_believed() == scenario.as_believed(), name
    assert scenario.suite("nominal") == scenario
    assert scenario.suite("all").true.delay_steps == 1
    with pytest.raises(ScenarioError, match="suite 'mas' is unknown; did you mean 'mass'"):
        scenario.suite("mas")


@pytest.mark.parametrize("suite", ["short", "hard_v0"])
def test_a_short_suite_tightens_every_deadline(suite):
    tight = load_scenario("corridor").suite(suite)
    assert tight.horizon == pytest.approx(60.0)
    assert tight.specification.horizon == pytest.approx(60.0)


def test_hard_keeps_the_deadlines_and_draws_what_it_has():
    scenario = load_scenario("corridor")
    hard = scenario.suite("hard")
    assert hard.specification == scenario.specification
    assert hard.draw_count > scenario.suite("all").draw_count
    constant = {"position_noise", "velocity_measured"}
    changed = {
        name for name in type(hard.true).model_fields if getattr(hard.true, name) != getattr(scenario.true, name)
    }
    assert {name for name in changed if not isinstance(getattr(hard.true, name), Uniform)} == constant


def test_draws_stay_in_their_range_and_repeat():
    scenario = load_scenario("throw_and_catch").suite("all")
    drawn = [scenario.draw(np.random.default_rng(seed)) for seed in range(200)]
    pop = scenario.bodies.index("pop")
    e = np.array([physics.contact[RESTITUTION] for physics in drawn])
    assert np.all((e >= 0.3) & (e <= 0.95))
    assert e.std() > 0.1
    mass = np.array([physics.body[pop, MASS] for physics in drawn]) / 16.8
    assert np.all((mass >= 0.7) & (mass <= 1.3))
    drift = np.array([np.linalg.norm(physics.body[pop, DRIFT_X : DRIFT_Y + 1]) for physics in drawn])
    assert np.all(drift <= 1e-3)
    assert drift.max() > 5e-4
    again = scenario.draw(np.random.default_rng(7))
    assert np.array_equal(again.contact, drawn[7].contact)
    assert np.array_equal(again.body, drawn[7].body)


def test_believed_world_is_undisturbed():
    scenario = load_scenario("corridor").suite("all").as_believed()
    physics, pop = scenario.draw(np.random.default_rng(0)), scenario.bodies.index("pop")
    assert physics.contact[RESTITUTION] == scenario.believed.restitution
    assert physics.body[pop, MASS] == scenario.objects["pop"].mass
    assert not np.any(physics.body[pop, DRIFT_X : DRIFT_Y + 1])
    assert physics.true.position_noise == 0.0
    assert physics.true.delay_steps == 0


def test_halfspaces_hold_the_corners():
    region = load_scenario("corridor").regions["goal"]
    H, b = region.halfspaces()
    corners = np.array(region.corners)
    assert np.allclose(np.linalg.norm(H, axis=1), 1.0)
    assert np.max(H @ corners.T - b[:, None]) == pytest.approx(0.0, abs=1e-12)
    center = corners.mean(axis=0)
    assert np.min(b - H @ center) == pytest.approx(0.75)


SMALL = load_scenario("throw_and_catch").override(
    {"control_period": 0.25, "horizon": 5.0, "formula": "F[0,5] pop in goal"}
)


@pytest.mark.parametrize("suite", ["short", "hard_v0"])
@pytest.mark.parametrize(
    ("formula", "tight"),
    [
        ("G[4,4] pop in goal", "G[2.25,2.25] pop in goal"),  # 2.4 s is no sample, the one before it is
        ("F[3,4] pop in goal", "F[1.7999999999999998,2.4] pop in goal"),  # contains samples 2.0 and 2.25
        ("F[1.5,1.5] F[1.5,1.5] F[2,2] pop in goal", "F[0.75,0.75] F[0.75,0.75] F[1,1] pop in goal"),
        ("pop in goal U[4,4] pop in goal", "pop in goal U[2.25,2.25] pop in goal"),
    ],
)
def test_shortened_formulas_keep_a_sample_in_every_interval(suite, formula, tight):
    changed = SMALL.override({"formula": formula}).suite(suite)
    assert changed.horizon == 3.0
    assert changed.formula == tight


@pytest.mark.parametrize("name", list_scenarios())
def test_shipped_scenarios_are_shortened_by_the_factor_alone(name):
    scenario = load_scenario(name)
    for suite in {"short", "hard", "hard_v0"} & scenario._suites().keys():
        tight = scenario.suite(suite)
        assert tight.specification == scenario.specification.scale_time(tight.horizon / scenario.horizon)


@pytest.mark.parametrize("scale", [np.nan, np.inf, -np.inf, 0, -1, 1.1, "x", True, [1], None])
def test_a_horizon_scale_is_a_share(scale):
    scenario = SMALL.override({"suites": {"mine": {"horizon_scale": scale}}})
    with pytest.raises(ScenarioError, match=r"suite 'mine': horizon_scale = .*above 0, at most 1"):
        scenario.suite("mine")


@pytest.mark.parametrize(
    "name", ["../up", "a/b", "a\0b", "a\nb", ".hidden", "..", "", " ", "a b", "x" * 65, "a\\b", "a:b"]
)
def test_names_that_cannot_name_a_file_are_refused(name):
    for values in (
        {"name": name},
        {"suites": {name: {}}},
        {f"regions.{name or ' '}": {"lower": [0, 0], "upper": [1, 1]}},
    ):
        if "." in next(iter(values)) and "." in name:
            continue  # a dotted key names another table
        with pytest.raises(ScenarioError) as caught:
            SMALL.override(values)
        assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", ["mine", "a-b", "v1.2", "_x", "x" * 64, "été", "-"])
def test_other_names_are_taken(name):
    assert SMALL.override({"name": name, "suites": {name: {}}}).suite(name).name == name


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("domain", {"a": 1}, ["domain", "{'a': 1}", "free_flyer"]),
        ("domain", [1], ["domain", "[1]", "free_flyer"]),
        ("horizon", 1e308, ["horizon", "1e+308", "1000000000"]),
        ("control_period", 5e-324, ["control_period", "1e-09"]),
        ("control_period", 1e-300, ["control_period", "1e-300"]),
        ("control_period", 1e-6, ["control_period", "1000000 control periods"]),
        ("control_period", 100.0, ["control_period", "60"]),
        ("true.weak_thruster", -1, ["true.weak_thruster", "negative"]),
        ("true.weak_thruster", {"uniform": [-1e308, 1e308]}, ["true.weak_thruster", "-1e+308"]),
        ("true.thruster_gain", 1e300, ["true.thruster_gain", "1e+300"]),
        ("true.drift", {"uniform": [2, 1]}, ["true.drift", "low 2 is above high 1"]),
        ("robots.snap.torque_limit", 1e308, ["robots.snap.torque_limit", "1e+308"]),
        ("robots.snap.mass", 1e-12, ["robots.snap.mass", "1e-12", "1e-09"]),
        ("regions.goal.upper", [0.25 + 1e-12, 3.0], ["regions.goal", "below"]),
        ("robots.a-b", 1, ["robots.a-b"]),
        ("name", "a\nb\nc", ["a\\nb"]),
        ("description", 10**30, ["description"]),
    ],
)
def test_values_out_of_bounds_are_refused_in_one_line(key, value, words):
    with pytest.raises(ScenarioError) as caught:
        SMALL.override({key: value})
    message = str(caught.value)
    assert message.isprintable()
    for word in words:
        assert word in message, message


def test_a_file_nested_too_deeply_is_refused(tmp_path):
    with pytest.raises(ScenarioError, match="nested too deeply"):
        load_scenario(write(tmp_path, "a = " + "[" * 5000 + "]" * 5000))


def test_what_is_no_scenario_is_refused():
    for source in (5, None, {"domain": "free_flyer"}):
        with pytest.raises(ScenarioError, match="a name, a path or a Scenario"):
            load_scenario(source)
    with pytest.raises(ScenarioError, match=r"is unknown"):
        load_scenario("x" * 5000)
