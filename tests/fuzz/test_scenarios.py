"""Any scenario file loads and can be stepped, or is refused in one line."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_envs import parallel_env
from impact_envs.domain import find_part, find_scenarios, list_domains
from impact_envs.scenario import build_scenario, load_scenario
from tests.fuzz.mutations import answered, check, check_finite, mistyped, mutated

TEXTS = {path.stem: path.read_text() for path in find_scenarios()}
TABLES = {name: tomllib.loads(text) for name, text in TEXTS.items()}
SUITES = {
    name: tomllib.loads(find_part("impact_envs", name, "SCHEMA").suite_file.read_text()) for name in list_domains()
}
POLYGON = {"vertices": [[-0.14, -0.14], [0.14, -0.14], [0.14, 0.14], [-0.14, 0.14]]}
TABLES["polygon"] = TABLES["throw_and_catch"] | {
    "objects": {"pop": TABLES["throw_and_catch"]["objects"]["pop"] | POLYGON}
}
SUITE = {"description": "harder", "horizon_scale": 0.6}
TRUTH = {
    "free_flyer": {
        "restitution": 0.7,
        "friction": 0.1,
        "object_mass_scale": {"uniform": [0.7, 1.3]},
        "robot_mass_scale": 1.1,
        "restitution_speed": 0.5,
        "center_of_mass_offset": 0.03,
        "drift": {"uniform": [0.0, 0.001]},
        "thruster_gain": {"uniform": [0.8, 1.1]},
        "weak_thruster": 0.5,
        "position_noise": 0.005,
        "delay_steps": 1,
    },
    "floating_manipulator": {
        "restitution": 0.7,
        "restitution_speed": 0.5,
        "box_mass_scale": {"uniform": [0.5, 2.0]},
        "box_turn": 0.1,
        "stall_torque_scale": 0.9,
        "thruster_gain": 0.9,
        "rate_noise": 0.005,
        "delay_steps": 1,
    },
    "dual_arm": {"mass_scale": {"uniform": [0.8, 1.2]}, "friction": 0.5, "stiffness_scale": 1.1, "start_x": 0.001},
}


def fill(table):
    """Return a scenario's tables with all that they may have, so that it can be changed."""
    return table | {"true": table.get("true", {}) | TRUTH[table["domain"]], "suites": {"mine": SUITE}}


def play(scenario):
    """Play some steps."""
    env = parallel_env(scenario)
    observations, _ = env.reset(seed=1)
    for agent in env.possible_agents:
        env.action_space(agent).seed(1)
    check_finite(*observations.values())
    for _ in range(3):
        if not env.agents:
            break
        observations, rewards, *_ = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        check_finite(*observations.values(), *rewards.values())


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile before time is taken; and what is to be changed is right at first."""
    for table in TABLES.values():
        play(build_scenario(fill(table), "mine.toml"))


def check_tables(data):
    table = data.draw(st.sampled_from(list(TABLES.values())).flatmap(lambda table: mutated(fill(table))))
    suite = data.draw(st.sampled_from((None, None, None, "mine", "hard", "all")))
    with answered():
        scenario = build_scenario(table, "mine.toml")
        play(scenario if suite is None else scenario.suite(suite))


def check_suites(data):
    """Play in a suite of the shipped files, changed."""
    table = data.draw(st.sampled_from(list(TABLES.values())))
    suites = data.draw(mutated(SUITES[table["domain"]]))
    with answered():
        scenario = build_scenario(table | {"suites": suites}, "mine.toml")
        play(scenario.suite(data.draw(st.sampled_from(list(suites)))) if suites else scenario)


def check_text(data, folder):
    path = folder / "mine.toml"
    text = data.draw(st.sampled_from(list(TEXTS.values())).flatmap(mistyped))
    path.write_text(text, encoding="utf-8", errors="replace")
    with answered():
        play(load_scenario(path))


@check(80)
@given(data=st.data())
def test_changed_tables(data):
    check_tables(data)


@check(30)
@given(data=st.data())
def test_changed_suites(data):
    check_suites(data)


@check(30)
@given(data=st.data())
def test_changed_text(data, tmp_path_factory):
    check_text(data, tmp_path_factory.getbasetemp())


@pytest.mark.slow
@check(3000)
@given(data=st.data())
def test_many_changed_tables(data):
    check_tables(data)


@pytest.mark.slow
@check(500)
@given(data=st.data())
def test_many_changed_suites(data):
    check_suites(data)


@pytest.mark.slow
@check(1000)
@given(data=st.data())
def test_many_changed_texts(data, tmp_path_factory):
    check_text(data, tmp_path_factory.getbasetemp())
