"""Any --set KEY=VALUE changes a world or an expert that can be played, or is refused in one line."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_envs import load_scenario, parallel_env
from planners import list_options, make_expert
from tests.frozen.freeze import get_plan
from tests.fuzz.mutations import LISTS, NUMBERS, WORDS, answered, check, check_finite, list_places, mistyped
from tests.fuzz.test_scenarios import TRUTH
from train.evaluation.case import check_settings, make_case
from train.settings import parse_settings

NAMES = ("throw_and_catch", "corridor", "floating_manipulator_thrusters", "dual_arm_grasp")
SCENARIOS = {name: load_scenario(name) for name in NAMES}
PLANS = {name: get_plan(name, "nominal") for name in NAMES[:2]}
VALUES = (
    *(text for value in (*NUMBERS, *LISTS) if (text := json.dumps(value)).isprintable()),
    *WORDS,
    *("inf", "-inf", "nan", "true", "1979-05-27", "07:32:00", "0x10", "1_000", "'a'", '"a', "{a = 1}", "1\n[a]"),
    *("{ uniform = [0.1, 0.2] }", "{ uniform = [0.2, 0.1] }", "[" * 5000, "1" * 5000, "1e400", "9" * 400),
)


def list_keys(name):
    """Return dotted names that a scenario or its expert has, or may have."""
    scenario = SCENARIOS[name]
    tables = scenario.model_dump(mode="json") | {"true": TRUTH[scenario.domain]}
    places = [".".join(map(str, place)) for place in list_places(tables)]
    return (*places, *(f"expert.{option}" for option in list_options(scenario)))


KEYS = {name: list_keys(name) for name in NAMES}


@st.composite
def settings_of(draw, name):
    """Return one or two texts, often of a name and a value that are nearly right."""
    texts = []
    for _ in range(draw(st.integers(1, 2))):
        # Half of them the expert's, of which there are fewer.
        own = draw(st.booleans())
        key = draw(st.sampled_from([key for key in KEYS[name] if key.startswith("expert.") == own]))
        text = f"{key}={draw(st.sampled_from(VALUES))}"
        texts.append(draw(st.one_of(st.just(text), st.just(text), mistyped(text, ("expert.", "true.", ".", "=")))))
    return texts


def check_set(data):
    name = data.draw(st.sampled_from(NAMES))
    texts = data.draw(settings_of(name))
    with answered():
        settings = parse_settings(texts)
        case = make_case(name, "nominal", settings)
        check_settings(case, ("expert",))
        json.dumps(settings, allow_nan=True)  # as the manifest of an evaluation keeps them
        env = parallel_env(case.scenario)
        observations, _ = env.reset(seed=0)
        expert = make_expert(SCENARIOS[name], PLANS.get(name), options=case.options)
        expert.reset(seed=0)
        for _ in range(2):
            actions = expert.act(observations) if case.scenario.agents == SCENARIOS[name].agents else {}
            check_finite(*actions.values())
            observations, *_ = env.step(actions or {agent: env.action_space(agent).sample() for agent in env.agents})
            check_finite(*observations.values())


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile before time is taken."""
    for name in NAMES:
        make_expert(SCENARIOS[name], PLANS.get(name)).act(parallel_env(SCENARIOS[name]).reset(seed=0)[0])


@check(60)
@given(data=st.data())
def test_settings(data):
    check_set(data)


@pytest.mark.slow
@check(1500)
@given(data=st.data())
def test_many_settings(data):
    check_set(data)
