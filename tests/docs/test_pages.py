"""The generated pages say all that the code has: every key, element, action, option and suite, with its meaning."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from docs.pages.comments import split_comment
from docs.pages.docstrings import convert_docstring
from docs.pages.environment import TOPICS, list_suites, read_topics, write_environment
from docs.pages.formula import EXAMPLES, judge, read_spellings
from docs.pages.keys import list_sections
from docs.pages.options import write_options
from docs.pages.scenario_file import write_keys
from impact_envs import gym_id, list_scenarios, load_scenario, parallel_env
from impact_envs.domain import find_part, list_domains
from impact_envs.env import ImpactEnv
from impact_envs.stl import parse
from planners import list_options

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("domain", list_domains())
def test_every_key_of_a_scenario_file_says_what_it_means(domain: str) -> None:
    schema = find_part("impact_envs", domain, "SCHEMA")
    sections = list_sections(schema)  # refuses a key without a comment
    assert {key.name for key in sections[0].keys} == set(schema.model_fields)
    assert all(section.meaning for section in sections)


def test_units_and_limits_come_from_the_schema() -> None:
    text = write_keys()
    assert "| `mass` | number > 0 | kg | required |" in text
    assert "| `control_period` | number > 0, ≤ 60 | s | required |" in text
    assert "| `drift` | number, or `{ uniform = [low, high] }`" in text.replace(" at least zero", "")


@pytest.mark.parametrize("name", list_scenarios())
def test_a_page_lists_every_element_action_and_suite(name: str) -> None:
    text, env = write_environment(name, None), parallel_env(name)
    layout = env.task.layouts[env.possible_agents[0]]
    for index in range(layout.size):
        assert f"\n| {index} | " in text
    for agent in env.possible_agents:
        assert env.action_space(agent).shape == (len(env.task.action_elements[agent]),)
        assert all(re.search(r" \[[^\]]+\]$", element) for element in env.task.action_elements[agent])
    assert gym_id(name) in text
    assert all(f"\n| `{suite}` |" in text for suite in list_suites(load_scenario(name)))


def test_the_environment_describes_itself_in_gymnasiums_words() -> None:
    topics = read_topics(re.sub(r"\n {4}", "\n", ImpactEnv.__doc__ or ""))
    assert set(TOPICS) | {"Infos"} <= set(topics)


def test_every_option_of_an_expert_has_its_row() -> None:
    text = write_options()
    for name in ("corridor", "floating_manipulator", "dual_arm_grasp"):
        for option in list_options(load_scenario(name)):
            assert f"| `expert.{option}` |" in text


def test_spellings_of_operators_are_those_that_the_parser_takes() -> None:
    for name, spellings in read_spellings().items():
        for spelling in spellings:
            text = {
                "_IN": f"a {spelling} b",
                "_NOT": f"{spelling} a in b",
                "_EVENTUALLY": f"{spelling}[0,1] a in b",
                "_ALWAYS": f"{spelling}[0,1] a in b",
                "_UNTIL": f"a in b {spelling}[0,1] a in b",
            }.get(name, f"a in b {spelling} a in b")
            parse(text)


def test_examples_of_formulas_show_both_answers() -> None:
    verdicts = {text: judge(text) for text in EXAMPLES}
    assert {planner.partition(":")[0] for _, planner in verdicts.values()} == {"yes", "no"}
    assert verdicts["G[90,100] speed(pop) <= 0.1"][0] == "yes"
    assert verdicts["G[90,100] speed(pop) <= 0.1"][1].startswith("no: 'speed(pop) <= 0.1'")
    assert all(not text.endswith("'") or "in '" not in text for pair in verdicts.values() for text in pair)


def test_a_comment_is_split_into_meaning_and_unit() -> None:
    assert split_comment("of the disc [m]") == ("Of the disc", "m")
    assert split_comment("e(v) = e exp(-v / v_e) [m/s]; 0 = constant") == (
        "e(v) = e exp(-v / v_e); 0 = constant",
        "m/s",
    )
    assert split_comment("gains [1/s^2], [1/s]") == ("Gains [1/s^2], [1/s]", "")


def test_docstrings_keep_code_and_absolute_values() -> None:
    lines = ["gap over max(1, |bound|), see `plan` and ``|x|``"]
    convert_docstring(lines)
    assert lines == [r"gap over max(1, \|bound\|), see ``plan`` and ``|x|``"]


@pytest.mark.slow
@pytest.mark.skipif(find_spec("furo") is None, reason="the extra [docs] is not installed")
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    environment = {**os.environ, "DOCS_EXECUTE": "0", "DOCS_PICTURES": "0", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "docs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    assert (tmp_path / "generated" / "environments" / "corridor.html").is_file()
