"""The tables of the page on formulas: operators, predicates, and what the planner takes, found out by asking it."""

from __future__ import annotations

import inspect
import re
from importlib import resources

from docs.pages.table import make_table
from impact_envs import InputError, load_scenario
from impact_envs.stl import Distance, Formula, In, Linear, Speed
from impact_envs.stl.operator import Always, And, Eventually, Implies, Not, Or, Until
from planners.free_flyer.specification.requirement import read_demands

# From loosest to tightest, with the terminal of the grammar that writes each.
OPERATORS = (
    (Implies, "_IMPLIES"),
    (Or, "_OR"),
    (And, "_AND"),
    (Until, "_UNTIL"),
    (Not, "_NOT"),
    (Eventually, "_EVENTUALLY"),
    (Always, "_ALWAYS"),
)
PREDICATES = (In, Distance, Speed, Linear)
# Put to the parser and to the planner of `corridor`, so that the table says what they do and not what we remember.
EXAMPLES = (
    "F[0,80] pop in goal & G[0,100] all in corridor",
    "G[0,100] all not in wall_left",
    "F[0,80] pop in goal | F[0,80] pop.y >= 8",
    "G[0,50] (pop.y >= 5 -> F[0,40] pop in goal)",
    "(pop in corridor) U[10,80] (pop in goal)",
    "G[0,60] F[0,40] pop in corridor",
    "not F[0,100] pop in wall_left",
    "G[0,100] distance(snap, crackle) >= 0.5",
    "F[0,80] distance(snap, pop) <= 0.6",
    "G[0,100] snap.y - crackle.y <= 1",
    "G[90,100] speed(pop) <= 0.1",
    "F[0,80] pop.vy >= 0.1",
    "F[0,80] pop.heading <= 0.5",
    "F pop in goal",
    "F[0,80] pop.x == 1",
    "F[0,80] pop.x * pop.y <= 1",
    "F[80,10] pop in goal",
    "F[0,200] pop in goal",
    "F[0.02,0.06] pop in goal",
    "pop in not goal",
)


def write_operators() -> str:
    """Return the table of operators, from loosest to tightest."""
    spellings = read_spellings()
    rows = [[f"`{'` `'.join(spellings[name])}`", _read_docstring(kind)] for kind, name in OPERATORS]
    return make_table(("written", "meaning and robustness"), rows)


def write_predicates() -> str:
    """Return the table of predicates."""
    return make_table(("predicate", ""), [[kind.__name__, _read_docstring(kind)] for kind in PREDICATES])


def write_examples() -> str:
    """Return what the monitor and the planner say of the examples."""
    rows = []
    for text in EXAMPLES:
        monitor, planner = judge(text)
        rows.append([f"`{text}`", monitor, planner])
    return make_table(("formula", "environment and monitor", "planner"), rows)


def judge(text: str) -> tuple[str, str]:
    """Return what the environment and the planner of `corridor` say of a formula: ``yes``, or the reason for a no."""
    try:
        scenario = load_scenario("corridor").override({"formula": text})
    except InputError as error:
        return f"no: {_shorten(str(error))}", "no"
    try:
        read_demands(scenario, 0.0)
    except InputError as error:
        return "yes", f"no: {_shorten(str(error))}"
    return "yes", "yes"


def read_spellings() -> dict[str, list[str]]:
    """Return how each operator may be written, by the grammar's name of it."""
    grammar = resources.files("impact_envs.stl").joinpath("grammar.lark").read_text(encoding="utf-8")
    found = dict(re.findall(r"^(_[A-Z]+)\.2: /(.*)/$", grammar, re.MULTILINE))
    return {name: [_read_spelling(part) for part in _split(pattern)] for name, pattern in found.items()}


def _split(pattern: str) -> list[str]:
    r"""Return the alternatives of a pattern; ``\|`` is a sign and no border."""
    return [part.replace("\0", r"\|") for part in pattern.replace(r"\|", "\0").split("|")]


def _read_spelling(part: str) -> str:
    r"""Return one way to write an operator: ``&&?`` is ``&`` or ``&&``, of which the shorter one is shown."""
    part = part.replace(r"\b", "").replace(r"\|", "|")
    return part[:-2] if part.endswith("?") else part


def _read_docstring(kind: type[Formula]) -> str:
    return " ".join(inspect.cleandoc(kind.__doc__ or "").split())


def _shorten(message: str) -> str:
    """Return an error without the names and the excerpt around it."""
    return re.sub(r"; in '.*'$", "", message.removeprefix("corridor: ").removeprefix("formula: ")).partition("; it ")[0]
