"""The page of one environment, in Gymnasium's schema."""

from __future__ import annotations

import inspect
import re
import tomllib
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from docs.pages.table import make_code, make_table, split_unit
from impact_envs import gym_id, load_scenario, parallel_env
from impact_envs.env import ImpactEnv
from impact_envs.joint import JointEnv
from impact_envs.observation import Layout
from impact_envs.scenario import Scenario

CHANGES = Path(__file__).parents[2] / "CHANGELOG.md"
# Paragraphs of the environment's docstring, in Gymnasium's words.
TOPICS = ("Action space", "Observation space", "Rewards", "Starting state", "Episode end")


def write_index(names: tuple[str, ...]) -> str:
    """Return the page that lists all environments."""
    rows = []
    for name in names:
        scenario = load_scenario(name)
        title = gym_id(name).partition("/")[2]
        rows.append([f"[{title}]({name}.md)", f"`{scenario.domain}`", ", ".join(scenario.agents), scenario.description])
    table = make_table(("environment", "domain", "agents", "task"), rows)
    return (
        "# Environments\n\nOne page for each shipped scenario, written from the code when the site is built. Every id "
        "has a second one, `...Residual`, whose actions [correct the expert](../../explained/residuals.md).\n\n"
        f"{table}\n```{{toctree}}\n:hidden:\n\n" + "\n".join(names) + "\n```\n"
    )


def write_environment(name: str, film: str | None) -> str:
    """Return the page of a shipped scenario.

    Args:
        name: of the scenario.
        film: of an episode, relative to the static files; None: none was made.
    """
    scenario, env = load_scenario(name), parallel_env(name)
    topics = read_topics(inspect.cleandoc(ImpactEnv.__doc__ or ""))
    task = inspect.cleandoc(type(env.task).__doc__ or "").split("\n\n", 1)[1].split("\n\nAttributes:")[0]
    parts = [
        f"# {gym_id(name).partition('/')[2]}\n\n{scenario.description}\n",
        _show_film(name, film),
        _write_overview(name, scenario),
        f"The task, as an STL formula (see [the formula language](../../reference/formula_language.md)):\n\n"
        f"{make_code(' '.join(scenario.formula.split()))}",
        f"## In words\n\n{task}\n",
        f"## Action space\n\n{topics['Action space']}\n\n{_write_actions(env)}",
        f"## Observation space\n\n{topics['Observation space']}\n\n{_write_observations(env)}",
        f"## Rewards\n\n{topics['Rewards']}\n",
        f"## Starting state\n\n{topics['Starting state']}\n\n{_write_start(env)}",
        f"## Episode end\n\n{topics['Episode end']} The horizon is {scenario.horizon:g} s, {scenario.steps} steps.\n",
        f"## Infos\n\n{topics['Infos']}\n",
        f"## Arguments\n\n{_write_arguments(name)}",
        f"## Suites\n\n{_write_suites(scenario)}",
        f"## Version history\n\n{_write_versions(name)}",
    ]
    return "\n".join(parts)


def read_topics(docstring: str) -> dict[str, str]:
    """Return the paragraphs of an environment's docstring by their topic; what follows on infos is ``Infos``."""
    topics: dict[str, str] = {}
    for paragraph in docstring.split("\n\n")[1:]:
        text = " ".join(paragraph.split())
        head, colon, rest = text.partition(": ")
        if colon and head in TOPICS:
            topics[head] = rest[0].upper() + rest[1:]
        elif text.startswith("``infos"):
            topics["Infos"] = text
    return topics


def _show_film(name: str, film: str | None) -> str:
    if film is None:
        return ""
    return (
        f'<video src="../../_static/{film}" poster="../../_static/{name}.png" controls loop autoplay muted playsinline '
        f'style="max-width:100%;max-height:560px" aria-label="An episode of {name} under its expert"></video>\n\n'
        "*The expert in the nominal world.*\n"
    )


def _write_overview(name: str, scenario: Scenario) -> str:
    rows = [
        ["Gymnasium", f'`gymnasium.make("{gym_id(name)}")`'],
        ["PettingZoo", f'`impact_envs.parallel_env("{name}")`'],
        ["many worlds", f'`impact_envs.vector_env("{name}", num_envs=1024)`'],
        ["corrections to the expert", f'`gymnasium.make("{gym_id(name, residual=True)}")`'],
        ["domain", f"`{scenario.domain}`"],
        ["agents", ", ".join(f"`{agent}`" for agent in scenario.agents)],
        ["bodies of the formula", ", ".join(f"`{body}`" for body in scenario.bodies)],
        ["horizon, control period", f"{scenario.horizon:g} s, {scenario.control_period:g} s"],
    ]
    return make_table(("", ""), rows)


def _write_actions(env: ImpactEnv) -> str:
    rows = []
    for agent in env.possible_agents:
        space, elements = env.action_space(agent), env.task.action_elements[agent]
        assert space.shape == (len(elements),)
        for k, element in enumerate(elements):
            what, size = split_unit(element)
            rows.append([f"`{agent}`" if k == 0 else "", str(k), what, f"{size}"])
    total = sum(len(env.task.action_elements[agent]) for agent in env.possible_agents)
    return (
        f"{make_table(('agent', 'element', 'meaning', 'an action of 1 is'), rows)}\n"
        f"`gymnasium.make` joins them to one vector of {total}, in this order.\n"
    )


def _write_range(part: slice) -> str:
    """Return the first and the last element of a part, or the only one."""
    last = part.stop - 1
    return f"{part.start}–{last}" if last > part.start else f"{last}"


def _write_observations(env: ImpactEnv) -> str:
    layouts = env.task.layouts
    first, *others = env.possible_agents
    parts = [f"Observation of `{first}`, float64, shape ({layouts[first].size},):\n\n{_write_layout(layouts[first])}"]
    if others:
        same = [agent for agent in others if list(layouts[agent].fields) == list(layouts[first].fields)]
        if same:
            parts.append(f"The same for {', '.join(f'`{agent}`' for agent in same)}.\n")
        for agent in (agent for agent in others if agent not in same):
            order = ", ".join(f"`{field}`" for field in layouts[agent].fields)
            parts.append(f"`{agent}` has the same elements with its fields in the order {order}.\n")
    joint = env.task.joint_layout
    rows = [[_write_range(joint[field]), f"`{field}`"] for field in joint.fields]
    parts.append(
        f"`gymnasium.make` and `vector_env` give everything measured once, shape ({joint.size},):\n\n"
        f"{make_table(('elements', 'field'), rows)}"
    )
    state = env.state_layout()
    parts.append(
        f"The true state, `env.state()`, is for critics, shape ({state.size},): "
        f"{', '.join(f'`{field}`' for field in state.fields)}. With `secrets=True` the drawn physics follow; "
        "`print(env.state_layout(True).describe())` names every element.\n"
    )
    return "\n".join(parts)


def _write_layout(layout: Layout) -> str:
    rows, k = [], 0
    for field, elements in layout.fields.items():
        for element in elements:
            rows.append([str(k), f"`{field}`", *split_unit(element)])
            k += 1
    return make_table(("element", "field", "meaning", "unit"), rows)


def _write_start(env: ImpactEnv) -> str:
    """Return the true state at the start of an episode of the nominal world."""
    env.reset(seed=0)
    state, layout = env.state(), env.state_layout()
    shown = {field: np.round(state[layout[field]], 4) + 0.0 for field in layout.fields}
    width = min(6, *(len(values) for field, values in shown.items() if field in env.scenario.bodies))
    bodies = [field for field in layout.fields if field in env.scenario.bodies]
    head = ("body", *layout.fields[bodies[0]][:width])
    return make_table(head, [[f"`{body}`", *(f"{value:g}" for value in shown[body][:width])] for body in bodies])


def _write_arguments(name: str) -> str:
    spec = gymnasium.spec(gym_id(name))
    said = _read_arguments(parallel_env.__doc__) | _read_arguments(JointEnv.__doc__)
    rows = []
    for parameter in list(inspect.signature(JointEnv.__init__).parameters.values())[1:]:
        value: Any = spec.kwargs.get(parameter.name, parameter.default)
        rows.append([f"`{parameter.name}`", f"`{value!r}`", said[parameter.name]])
    code = f'import gymnasium\n\nimport impact_envs\n\nenv = gymnasium.make("{gym_id(name)}", suite="all")'
    return (
        f"{make_table(('argument', 'default', 'meaning'), rows)}\nIn another true world:\n\n{make_code(code, 'python')}"
    )


def _read_arguments(docstring: str | None) -> dict[str, str]:
    block = inspect.cleandoc(docstring or "").partition("Args:\n")[2].partition("\n\n")[0]
    found = re.findall(r"^    (\w+): (.+(?:\n {8}.+)*)", block, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in found}


def list_suites(scenario: Scenario) -> dict[str, tuple[dict[str, Any], str]]:
    """Return the suites that a scenario can be played under: the values changed, and the comment beside the name."""
    text = scenario.suite_file.read_text(encoding="utf-8") if scenario.suite_file else ""
    said = dict(re.findall(r"^\[(\w+)\][ \t]*(?:# (.*))?$", text, re.MULTILINE))
    tables = {**tomllib.loads(text), **scenario.suites}
    return {name: (table, said.get(name, "")) for name, table in tables.items()}


def _write_suites(scenario: Scenario) -> str:
    rows = []
    for name, (table, said) in list_suites(scenario).items():
        scenario.suite(name)  # as the environment does, so that no suite is listed that it refuses
        rows.append([f"`{name}`", said, ", ".join(f"`{key}` {_write_value(value)}" for key, value in table.items())])
    return (
        "Suites change the true world only; what the expert believes stays. Ranges are drawn from the reset seed. "
        "`horizon_scale` shortens the horizon and every time of the formula.\n\n"
        + make_table(("suite", "", "changes"), rows)
    )


def _write_value(value: Any) -> str:
    if isinstance(value, dict):
        low, high = value["uniform"]
        return f"{low:g} to {high:g}"
    return f"= {str(value).lower() if isinstance(value, bool) else value}"


def _write_versions(name: str) -> str:
    """Return the present versions, and what the list of changes says of raised ones."""
    ids = ", ".join(f"`{gym_id(name, residual)}`" for residual in (False, True))
    entries = re.split(r"\n- ", CHANGES.read_text(encoding="utf-8"))
    raised = [" ".join(entry.split("\n\n")[0].split()) for entry in entries if re.search(r"-v\d\b", entry)]
    listed = "\n".join(f"- {entry}" for entry in raised)
    return (
        f"Present ids: {ids}. With the same id, version, seed and actions an episode keeps its numbers; a change of "
        f"behaviour raises the version. The raises so far, of all environments:\n\n{listed}\n"
    )
