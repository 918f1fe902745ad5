"""A scenario file is read whole or refused in one line that says what to mend."""

import numpy as np
import pytest

from impact_envs import list_scenarios, load_scenario
from impact_envs.domain import find_scenarios
from impact_envs.errors import ScenarioError
from impact_envs.free_flyer.schema import DRIFT_X, DRIFT_Y, MASS, RESTITUTION

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


def test_hard_suite_tightens_every_deadline():
    hard = load_scenario("corridor").suite("hard")
    assert hard.horizon == pytest.approx(60.0)
    assert hard.specification.horizon == pytest.approx(60.0)


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
