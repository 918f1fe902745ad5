"""Any plan file is read and can be flown, or is refused in one line."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_envs import load_scenario, parallel_env
from planners import make_expert
from planners.free_flyer.published.plan_file import read_published_plan, write_published_plan
from planners.plan import Plan
from tests.fuzz.mutations import answered, check, check_finite, mistyped, mutated

SCENARIO = load_scenario("throw_and_catch")
FOLDER = Path(__file__).parents[1] / "frozen" / "plans"
TEXT = (FOLDER / "throw_and_catch.json").read_text()
TIMES = np.linspace(-1.0, 31.0, 20)


def fly(plan):
    """Evaluate all curves of a plan."""
    for curve in (*plan.robots.values(), *plan.objects.values()):
        check_finite(curve.position(TIMES), curve.velocity(TIMES), curve.acceleration(TIMES))
    assert Plan.from_json(plan.to_json()) == plan


def check_plan(data, folder, execute=False):
    path = folder / "plan.json"
    changed = st.one_of(mutated(json.loads(TEXT)).map(json.dumps), mistyped(TEXT))
    path.write_text(data.draw(changed), encoding="utf-8", errors="replace")
    with answered():
        plan = Plan.load(path)
        fly(plan)
        if execute:
            expert, env = make_expert(SCENARIO, plan), parallel_env(SCENARIO)
            observations, _ = env.reset(seed=0)
            expert.reset(seed=0)
            actions = expert.act(observations)
            check_finite(*actions.values(), *env.step(actions)[0].values())


def check_published(data, files, folder):
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    wrong = data.draw(st.sampled_from(sorted(files)))
    for name, text in files.items():
        changed = (
            data.draw(mistyped(text, ("rvars", "hvars", "pre", "post", "none", "1_0", "1e308")))
            if name == wrong
            else text
        )
        (folder / name).write_text(changed, encoding="utf-8", errors="replace", newline="")
    with answered():
        plan = read_published_plan(folder)
        for body in plan.bodies.values():
            check_finite(body.position(TIMES), body.velocity(TIMES), body.times)


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile before time is taken."""
    make_expert(SCENARIO, Plan.from_json(TEXT)).act(parallel_env(SCENARIO).reset(seed=0)[0])


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    folder = tmp_path_factory.mktemp("published")
    write_published_plan(Plan.from_json(TEXT), folder, "x")
    return {path.name: path.read_text(encoding="utf-8") for path in folder.iterdir()}


@check(60)
@given(data=st.data())
def test_changed_plans(data, tmp_path_factory):
    check_plan(data, tmp_path_factory.getbasetemp())


@check(20)
@given(data=st.data())
def test_changed_plans_are_executed(data, tmp_path_factory):
    check_plan(data, tmp_path_factory.getbasetemp(), execute=True)


@check(60)
@given(data=st.data())
def test_changed_published_plans(data, published, tmp_path_factory):
    check_published(data, published, tmp_path_factory.getbasetemp() / "changed")


@pytest.mark.slow
@check(1500)
@given(data=st.data())
def test_many_changed_plans(data, tmp_path_factory):
    check_plan(data, tmp_path_factory.getbasetemp(), execute=True)


@pytest.mark.slow
@check(1500)
@given(data=st.data())
def test_many_changed_published_plans(data, published, tmp_path_factory):
    check_published(data, published, tmp_path_factory.getbasetemp() / "changed")
