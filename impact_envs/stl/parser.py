"""STL text to formulas, with errors that say where and what was expected."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from importlib import resources
from typing import Any

from lark import Lark, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedToken

from impact_envs.errors import FormulaError, choices
from impact_envs.stl.formula import LARGEST, Formula
from impact_envs.stl.operator import Always, And, Eventually, Implies, Not, Or, Until, check_interval
from impact_envs.stl.predicate import ALL, FUNCTIONS, In, Linear, make_comparison

_OPERATORS = ("and", "or", "not", "implies", "until", "U", "eventually", "F", "always", "G")
RESERVED = frozenset((*_OPERATORS, "in", ALL, *FUNCTIONS))
"""Words that cannot name a body or an area in a formula."""

DEEPEST = 64
"""Greatest number of operators within each other: what copies a formula takes up to seven Python calls for each"""
LONGEST = 100_000
"""Greatest number of letters of a formula: some thousand predicates"""

_EXCERPT = 60  # characters of the formula an error shows
_MIRRORED = {"<=": ">=", "<": ">", ">=": "<=", ">": "<"}


def parse(text: str) -> Formula:
    """Read a formula.

    Both spellings mean the same: ``F[0,80] pop in goal & G[0,80] all not in wall`` and ``eventually[0:80](pop
    in goal) and always[0:80](all not in wall)``. From loosest to tightest: ``implies``, ``or``, ``and``,
    ``until``, then ``not``, ``F`` and ``G``; so the first text is a conjunction of two temporal formulas.

    Args:
        text: formula, times in s.

    Returns:
        The formula's tree; names are not checked (see ``Formula.check_names``).

    Raises:
        FormulaError: text that is no formula; one line with column, offending text and what was expected.
    """
    if not isinstance(text, str):
        raise FormulaError(f"a formula is text such as 'F[0,80] pop in goal', got {type(text).__name__}")
    if len(text) > LONGEST:
        raise FormulaError(f"the formula has {len(text)} letters, at most {LONGEST} are read")
    try:
        return _build(_lark().parse(text), text)
    except UnexpectedToken as error:
        raise _explain(text, error) from None
    except UnexpectedCharacters as error:
        position = error.pos_in_stream or 0
        what = f"'{text[position]}' has no meaning in a formula"
        raise FormulaError(_locate(text, position, what)) from None


@cache
def _lark() -> Lark:
    grammar = resources.files(__package__).joinpath("grammar.lark").read_text(encoding="utf-8")
    grammar = grammar.replace("(FUNCTIONS)", f"({'|'.join(FUNCTIONS)})")
    # The basic lexer keeps keywords keywords everywhere, so that "pop in not wall" is an error at "not".
    return Lark(grammar, parser="lalr", lexer="basic", propagate_positions=True)


@dataclass(frozen=True)
class _Sum:
    """A linear combination of signals plus a constant."""

    terms: dict[str, float]
    constant: float = 0.0

    def scaled(self, factor: float) -> _Sum:
        return _Sum({name: factor * c for name, c in self.terms.items()}, factor * self.constant)

    def plus(self, other: _Sum) -> _Sum:
        merged = dict(self.terms)
        for name, coefficient in other.terms.items():
            merged[name] = merged.get(name, 0.0) + coefficient
        return _Sum(merged, self.constant + other.constant)


def _number(text: str) -> float:
    value = float(text)
    if value > LARGEST:
        raise FormulaError(f"the number {text:.40} is too large, at most {LARGEST:g} is read")
    return value


def _interval(lower: float, upper: float) -> tuple[float, float]:
    check_interval(lower, upper)
    return lower, upper


def _multiply(left: _Sum, right: _Sum) -> _Sum:
    if left.terms and right.terms:
        raise FormulaError("a product of two signals is not linear")
    return right.scaled(left.constant) if not left.terms else left.scaled(right.constant)


def _divide(left: _Sum, right: _Sum) -> _Sum:
    if right.terms or right.constant == 0:
        raise FormulaError("a signal is divided by a number other than zero")
    return _Sum({name: c / right.constant for name, c in left.terms.items()}, left.constant / right.constant)


def _compare(left: Any, relation: str, right: Any) -> Formula:
    if not isinstance(right, _Sum):
        left, relation, right = right, _MIRRORED[relation], left
    if isinstance(left, _Sum) and isinstance(right, _Sum):
        total = left.plus(right.scaled(-1.0))
        terms = tuple((name, c) for name, c in total.terms.items() if c != 0)
        return Linear(terms, relation, right.constant - left.constant)
    if not isinstance(right, _Sum) or right.terms:
        raise FormulaError(f"{' and '.join(FUNCTIONS)} are compared with a number")
    return left(relation, right.constant)


_RULES: dict[str, Callable[..., Any]] = {
    "implies": Implies,
    "disjunction": lambda *operands: Or(operands),
    "conjunction": lambda *operands: And(operands),
    "until": lambda left, interval, right: Until(interval, left, right),
    "negation": Not,
    "eventually": Eventually,
    "always": Always,
    "interval": _interval,
    "bound": _number,
    "negative": lambda text: -_number(text),
    "inside": In,
    "outside": partial(In, negated=True),
    "body": str,
    "comparison": _compare,
    "function": lambda name, *bodies: partial(make_comparison, name, bodies),
    "number": lambda text: _Sum({}, _number(text)),
    "signal": lambda name: _Sum({name: 1.0}),
    "minus": lambda value: value.scaled(-1.0),
    "add": _Sum.plus,
    "subtract": lambda left, right: left.plus(right.scaled(-1.0)),
    "multiply": _multiply,
    "divide": _divide,
}


def _build(tree: Tree, text: str) -> Any:
    """Return the formula of a syntax tree: children first, left to right, by a stack of our own instead of Python's."""
    todo: list[tuple[Any, bool]] = [(tree, False)]
    built: list[tuple[Any, int]] = []  # with its depth
    while todo:
        node, entered = todo.pop()
        if not isinstance(node, Tree):
            built.append((str(node), 0))
        elif not entered:
            todo.append((node, True))
            todo.extend((child, False) for child in reversed(node.children))
        else:
            first = len(built) - len(node.children)
            children = built[first:]
            del built[first:]
            try:
                value = _RULES[node.data](*(child for child, _ in children))
                depth = max((depth for _, depth in children), default=0) + isinstance(value, Formula)
                if depth > DEEPEST:
                    raise FormulaError(f"operators are nested more than {DEEPEST} deep")
            except FormulaError as error:
                raise FormulaError(_locate(text, node.meta.start_pos, str(error))) from None
            built.append((value, depth))
    return built[0][0]


_EXPECTED = {
    "SIGNAL": "a signal such as pop.x",
    "NUMBER": "a number",
    "_IN": "'in' or 'not in' after a body's name",
    "RELATION": "'<=', '<', '>=', '>'",
    "LSQB": "a time interval such as [0,80]",
    "RSQB": "']'",
    "COMMA": "','",
    "COLON": "':'",
    "LPAR": "'('",
    "RPAR": "')'",
    "_AND": "'and', 'or', 'until', 'implies'",
    "$END": "the end of the formula",
}


def _explain(text: str, error: UnexpectedToken) -> FormulaError:
    """Return the error in words: found, expected, and the column."""
    ended = error.token.type == "$END"
    position = len(text) if ended else error.token.start_pos or 0
    found = "the formula ends" if ended else f"found '{error.token}'"
    before = re.search(r"([^\W\d]\w*)\s*$", text[:position])
    word = before.group(1) if before else ""
    if word and word not in RESERVED and error.token.type in ("LSQB", "LPAR"):
        operators = ("eventually", "always", "F", "G") if error.token.type == "LSQB" else tuple(FUNCTIONS)
        what = f"operator '{word}' is unknown; {choices(word, operators)}"
        return FormulaError(_locate(text, before.start(1) if before else position, what))
    if not text.strip():
        return FormulaError("the formula is empty; expected one such as 'F[0,80] pop in goal'")
    where = f" where {_expected(error, word)} is expected"
    return FormulaError(_locate(text, position, found + where))


def _expected(error: UnexpectedToken, word: str) -> str:
    accepted = error.accepts or error.expected
    if "_EVENTUALLY" in accepted:
        return "a formula such as 'pop in goal' or 'F[0,80] pop in goal'"
    if "NAME" in accepted:
        return "the name of an area" if word == "in" else "the name of a body"
    # Arithmetic signs could follow almost any number: naming them would hide what the user missed.
    return " or ".join(words for name, words in _EXPECTED.items() if name in accepted)


def _locate(text: str, position: int, what: str) -> str:
    """Return one line: the column (counted from 1), what is wrong, and the formula around it."""
    line, start = text.count("\n", 0, position) + 1, text.rfind("\n", 0, position) + 1
    where = f"line {line}, " if "\n" in text.strip() else ""
    first = max(0, min(position - _EXCERPT // 2, len(text) - _EXCERPT))
    excerpt = " ".join(text[first : first + _EXCERPT].split())
    left, right = "..." * (first > 0), "..." * (first + _EXCERPT < len(text))
    return f"{where}column {position - start + 1}: {what}; in '{left}{excerpt}{right}'"
