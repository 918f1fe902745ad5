"""Plans from elsewhere: their bodies get the scenario's names, and what they break is said."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_envs.errors import InputError
from impact_envs.scenario import load_scenario
from planners.bezier import Curve
from planners.free_flyer.published.conversion import convert_published_plan, make_published_plan
from planners.free_flyer.published.names import match_names, rename_bodies
from planners.free_flyer.published.plan_file import read_published_plan, write_published_plan
from planners.free_flyer.published.violation import list_violations
from tests.frozen.freeze import get_plan
from train.cli.main import main

SHARED = Path(__file__).resolve().parents[5] / "shared" / "data" / "impact_stl_plans"
FOLDERS = {"throw_and_catch_SR": "corridor", "throw_and_catch_IR": "corridor"}
FOLDERS |= {"obstacle_avoidance_SR": "obstacle_avoidance"}
BODIES = ("snap", "crackle", "pop")


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("throw_and_catch")


@pytest.fixture(scope="module")
def plan(scenario):
    return get_plan(scenario.name, "nominal")


def _write(plan, folder, names):
    published = rename_bodies(make_published_plan(plan), dict(zip(BODIES, names, strict=True)))
    write_published_plan(published, folder, "away")
    return folder


def _run(capsys, *arguments):
    code = main([str(one) for one in arguments])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("names", [*itertools.permutations(BODIES), ("a", "b", "c")])
def test_roles_and_starts_tell_the_names(names, plan, scenario, tmp_path):
    published = read_published_plan(_write(plan, tmp_path, names))
    kept = names in ((BODIES), ("crackle", "snap", "pop"))  # names that fit are kept, wherever their bodies start
    found = convert_published_plan(published, scenario)
    assert [hit.robot for hit in found.impacts] == (
        ["snap", "crackle"] if names[0] != "crackle" or not kept else ["crackle", "snap"]
    )
    assert [hit.object for hit in found.impacts] == ["pop", "pop"]
    assert bool(list_violations(scenario, found)) == (names == ("crackle", "snap", "pop"))


def test_given_names_win_and_the_rest_is_told(plan, scenario, tmp_path):
    published = read_published_plan(_write(plan, tmp_path, ("a", "b", "c")))
    assert match_names(published, scenario, {"a": "crackle"}) == {"a": "crackle", "b": "snap", "c": "pop"}
    for given, words in (
        ({"d": "pop"}, "no body 'd'; choices: a, b, c"),
        ({"a": "top"}, "no body 'top'; did you mean 'pop'"),
        ({"a": "snap", "b": "snap"}, "would both be 'snap'"),
        ({"c": "snap"}, "the plan has|is a"),
    ):
        with pytest.raises(InputError, match=words):
            convert_published_plan(published, scenario, given)


def test_equal_distances_do_not_tell_who_is_who(plan, scenario, tmp_path):
    published = read_published_plan(_write(plan, tmp_path, ("a", "b", "c")))
    # Both robots of the scenario are as far from one robot of the plan as from the other.
    mirrored = scenario.override({"robots.snap.start": [-0.7, 1.875], "robots.crackle.start": [1.5, 1.875]})
    with pytest.raises(InputError, match=r"starts do not tell how a, b of the plan are snap, crackle.*--rename"):
        match_names(published, mirrored)


def test_messages_do_not_change_from_run_to_run(plan, scenario):
    published = make_published_plan(plan)
    fewer = rename_bodies(published, {"snap": "zoe", "crackle": "amy", "pop": "pop"})
    more = scenario.override({"robots.third": {**scenario.robots["snap"].model_dump(), "start": (1.5, 0.0)}})
    with pytest.raises(InputError, match="'amy' is a robot of the plan only; choices: snap, crackle, third"):
        convert_published_plan(fewer, more)


def test_plans_of_this_project_break_nothing(plan, scenario):
    assert list_violations(scenario, plan) == ()


def _shift(curve, offset):
    return Curve(curve.times, curve.points + np.array(offset))


BROKEN = {
    "start": lambda plan: {"robots": {**plan.robots, "snap": _shift(plan.robots["snap"], (0.05, 0.0))}},
    "world": lambda plan: {"robots": {**plan.robots, "snap": _shift(plan.robots["snap"], (-5.0, 0.0))}},
    "overlap": lambda plan: {"robots": {**plan.robots, "snap": plan.robots["crackle"]}},
    "contact": lambda plan: {"objects": {"pop": _shift(plan.objects["pop"], (0.0, 0.5))}},
    "impact_law": lambda plan: {"objects": {"pop": Curve([0.0, plan.horizon], [[[0.5, 1.5], [0.5, 1.5]]])}},
}


@pytest.mark.parametrize("kind", BROKEN)
def test_what_is_broken_is_named(kind, plan, scenario):
    broken = replace(plan, **BROKEN[kind](plan))
    found = [one for one in list_violations(scenario, broken) if one.kind == kind]
    assert found
    if kind == "start":
        assert found[0].amount == pytest.approx(0.05)
        assert not found[0].refused
    if kind in ("world", "overlap"):
        assert found[0].refused
    if kind == "impact_law":
        # A resting object that is hit and goes on resting.
        speed = np.linalg.norm(plan.impacts[0].object_plus)
        assert found[0].amount == pytest.approx(speed, rel=1e-6)
        assert str(found[0]).startswith(f"impact_law: pop at {plan.impacts[0].time:.2f} s by ")


def test_limits_are_measured_against_the_scenarios(plan, scenario):
    slow = scenario.override({"robots.snap.speed_limit": 0.02, "robots.snap.force_limit": 0.01})
    found = {one.kind: one for one in list_violations(slow, plan) if one.body == "snap"}
    assert found["speed"].refused
    assert found["force"].refused
    assert {one.kind for one in list_violations(slow, plan)} == {"speed", "force"}


def test_an_object_is_moved_by_impacts_alone(plan, scenario):
    none = replace(plan, impacts=())
    found = [one for one in list_violations(scenario, none) if one.kind == "free_flight"]
    assert [one.body for one in found] == ["pop"]


def test_a_renamed_plan_is_checked_and_flown(capsys, plan, tmp_path):
    folder = _write(plan, tmp_path / "plan", ("crackle", "pop", "snap"))
    code, out, err = _run(capsys, "plan", "throw_and_catch", "--check", folder, "--json")
    assert code == 0, err
    said = json.loads(out)
    assert said["renamed"] == {"crackle": "snap", "pop": "crackle", "snap": "pop"}
    assert (said["accepted"], said["violations"]) == (True, [])
    code, out, err = _run(capsys, "run", "throw_and_catch", "--plan", folder, "--json")
    assert code == 0, err
    assert json.loads(out)["success"]
    assert err.splitlines().count(f"plan {folder}: its snap is pop") == 1
    rename = ("--rename", "snap=pop", "crackle=snap", "pop=crackle")
    code, out, err = _run(capsys, "run", "throw_and_catch", "--plan", folder, "--json", *rename)
    assert code == 0, err
    assert json.loads(out)["success"]


def test_an_unlawful_plan_is_refused_unless_forced(capsys, plan, tmp_path):
    # The object flies back and forth at more than a metre per second; no robot hits it so fast.
    turns = [0.0, plan.impacts[0].time, plan.impacts[1].time, plan.horizon]
    places = np.array([[0.5, 1.5], [0.5, 1.5], [0.5, 15.0], [0.5, 2.25]])
    wild = replace(plan, objects={"pop": Curve(turns, np.stack([places[:-1], places[1:]], axis=1))})
    wild.save(tmp_path / "wild.json")
    code, out, err = _run(capsys, "run", "throw_and_catch", "--plan", tmp_path / "wild.json", "--json")
    assert (code, out) == (2, "")
    assert "impact_law: pop at" in err
    assert "m/s" in err
    assert "--force" in err
    assert len(err.strip().splitlines()) == 1
    code, out, err = _run(capsys, "plan", "throw_and_catch", "--check", tmp_path / "wild.json", "--json")
    assert code == 1, err
    said = json.loads(out)
    assert not said["accepted"]
    assert max(one["amount"] for one in said["violations"] if one["kind"] == "impact_law") > 1.0
    code, out, err = _run(capsys, "run", "throw_and_catch", "--plan", tmp_path / "wild.json", "--force", "--json")
    assert code == 0, err
    assert not json.loads(out)["accepted"]
    assert "impact_law: pop at" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("plan", "throw_and_catch", "--rename", "a=b"), "--check"),
        (("run", "throw_and_catch", "--rename", "a=b"), "--plan"),
        (("run", "throw_and_catch", "--force"), "--plan"),
        (("run", "throw_and_catch", "--plan", "PLAN", "--rename", "a"), "expected PLAN=SCENARIO"),
        (("run", "throw_and_catch", "--plan", "PLAN", "--rename", "a=b", "a=c"), "renamed twice"),
        (("run", "throw_and_catch", "--plan", "PLAN", "--rename", "x=pop"), "no body 'x'"),
    ],
)
def test_bad_names_are_one_line_and_exit_code_2(arguments, words, capsys, plan, tmp_path):
    folder = _write(plan, tmp_path / "plan", BODIES)
    code, out, err = _run(capsys, *(folder if one == "PLAN" else one for one in arguments))
    assert (code, out) == (2, "")
    assert len(err.strip().splitlines()) == 1
    assert words in err


@pytest.mark.parametrize("name", FOLDERS)
@pytest.mark.parametrize("order", [("snap", "crackle", "pop"), ("crackle", "pop", "snap")])
def test_every_published_folder_loads_under_any_names(name, order, tmp_path):
    if not (SHARED / name).is_dir():
        pytest.skip(f"published plans are not beside the repository: no folder {SHARED / name}")
    scenario = load_scenario(FOLDERS[name])
    published = read_published_plan(SHARED / name)
    other = rename_bodies(published, dict(zip(BODIES, order, strict=True)))
    found = list_violations(scenario, convert_published_plan(other, scenario))
    assert found == list_violations(scenario, convert_published_plan(published, scenario))
    assert {"impact_law", "contact"} <= {one.kind for one in found}
    assert not any(one.refused for one in found)
