"""Text to formula and back, and what a user reads after a mistake."""

import math

import pytest

from impact_envs.errors import FormulaError, InputError
from impact_envs.stl import (
    RESERVED,
    Always,
    And,
    Distance,
    Eventually,
    Implies,
    In,
    Linear,
    Not,
    Or,
    Speed,
    Until,
    parse,
)

P, Q, R = In("pop", "goal"), In("snap", "wall", negated=True), In("pop", "wall")


@pytest.mark.parametrize(
    ("text", "formula"),
    [
        ("pop in goal", P),
        ("snap not in wall", Q),
        ("all in goal", In("all", "goal")),
        ("F[0,80] pop in goal", Eventually((0, 80), P)),
        ("eventually[0:80](pop in goal)", Eventually((0, 80), P)),
        ("G[0.5,1e2] snap not in wall", Always((0.5, 100), Q)),
        ("always [ 0 : 8 ] ((snap not in wall))", Always((0, 8), Q)),
        ("pop in goal U[1,2] snap not in wall", Until((1, 2), P, Q)),
        ("pop in goal until[1:2] snap not in wall", Until((1, 2), P, Q)),
        ("not pop in goal", Not(P)),
        ("!pop in goal", Not(P)),
        ("~ (pop in goal)", Not(P)),
        ("distance(pop, snap) >= 0.4", Distance("pop", "snap", ">=", 0.4)),
        ("0.4 < distance(pop, snap)", Distance("pop", "snap", ">", 0.4)),
        ("speed(pop) <= 0.1", Speed("pop", "<=", 0.1)),
        ("speed(all) < 2*0.5", Speed("all", "<", 1.0)),
        ("pop.x + 2*pop.y <= 3", Linear((("pop.x", 1), ("pop.y", 2)), "<=", 3)),
        ("pop.x >= snap.x", Linear((("pop.x", 1), ("snap.x", -1)), ">=", 0)),
        ("-(pop.x - 1)/2 < 3 - pop.y*2 - pop.x", Linear((("pop.x", 0.5), ("pop.y", 2)), "<", 2.5)),
    ],
)
def test_text_means_formula(text, formula):
    assert parse(text) == formula
    assert parse(str(formula)) == formula


@pytest.mark.parametrize("conjunction", ["and", "&", "&&"])
@pytest.mark.parametrize("disjunction", ["or", "|", "||"])
@pytest.mark.parametrize("implication", ["implies", "->"])
def test_precedence_from_implication_to_until(conjunction, disjunction, implication):
    p, q, r = "pop in goal", "snap not in wall", "pop in wall"
    text = f"{p} {implication} {q} {disjunction} {r} {conjunction} {p} U[0,1] {q}"
    assert parse(text) == Implies(P, Or((Q, And((R, Until((0, 1), P, Q))))))


def test_temporal_operators_take_only_what_follows():
    formula = parse("F[0,80] pop in goal & G[0,100] all not in wall_left")
    assert formula == And((Eventually((0, 80), P), Always((0, 100), In("all", "wall_left", negated=True))))


def test_implication_and_until_group_to_the_right():
    p, q, r = "pop in goal", "snap not in wall", "pop in wall"
    assert parse(f"{p} -> {q} -> {r}") == Implies(P, Implies(Q, R))
    assert parse(f"{p} U[0,1] {q} U[2,3] {r}") == Until((0, 1), P, Until((2, 3), Q, R))


def test_parentheses_are_kept_where_they_make_another_tree():
    for formula in (And((And((P, Q)), R)), Until((0, 1), Until((0, 1), P, Q), R), Not(And((P, Q)))):
        assert parse(str(formula)) == formula
    assert parse("pop in goal & snap not in wall & pop in wall") == And((P, Q, R))


def test_formula_tells_what_it_reads():
    formula = parse("F[0,8] (pop in goal & G[1,3] distance(pop, snap) > 1) & G[0,5] all not in wall")
    assert formula.horizon == 11
    assert formula.reach(0.5) == 22
    assert formula.bodies() == ("pop", "snap")
    assert formula.areas() == ("goal", "wall")
    assert formula.signals() == ("pop.x", "pop.y", "snap.x", "snap.y")
    assert [str(part) for part in formula.conjuncts()] == [str(part) for part in formula.operands]


def test_conjuncts_open_nested_conjunctions_only():
    formula = parse("pop in goal & (snap in goal & (pop in wall | snap in wall))")
    assert [str(part) for part in formula.conjuncts()] == [
        "pop in goal",
        "snap in goal",
        "pop in wall | snap in wall",
    ]
    assert P.conjuncts() == (P,)


def test_all_is_a_conjunction_over_bodies():
    formula = parse("G[0,1] all not in wall | speed(all) <= 1")
    written = "G[0,1] (a not in wall & b not in wall) | speed(a) <= 1 & speed(b) <= 1"
    assert formula.expand(("a", "b")) == parse(written)
    assert parse("all in goal").expand(("a",)) == In("a", "goal")
    with pytest.raises(FormulaError, match="there is none"):
        formula.expand(())


def test_scaled_time_scales_every_interval():
    formula = parse("F[2,8] G[1,3] pop in goal & (pop in wall U[0,4] pop in goal)")
    scaled = parse("F[1,4] G[0.5,1.5] pop in goal & (pop in wall U[0,2] pop in goal)")
    assert formula.scale_time(0.5) == scaled
    for factor in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(FormulaError, match="time factor"):
            formula.scale_time(factor)


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("F[0,80 pop in goal", 8, ["'pop'", "']'"]),
        ("F[0,] pop in goal", 5, ["']'", "a number"]),
        ("F[5,3] pop in goal", 2, ["[5,3]", "ends before it starts"]),
        ("F[-1,3] pop in goal", 2, ["[-1,3]", "starts before time 0"]),
        ("F[0,1e999] pop in goal", 5, ["1e999", "too large"]),
        ("F[0,inf] pop in goal", 5, ["'inf'", "a number"]),
        ("F(0,80) pop in goal", 2, ["'('", "a time interval such as [0,80]"]),
        ("F pop in goal", 3, ["'pop'", "a time interval"]),
        ("evntually[0,8] pop in goal", 1, ["'evntually'", "did you mean 'eventually'?"]),
        ("distnce(a, b) <= 1", 1, ["'distnce'", "did you mean 'distance'?"]),
        ("pop goal", 5, ["'goal'", "'in' or 'not in'"]),
        ("pop in", 7, ["ends", "the name of an area"]),
        ("pop in not goal", 8, ["'not'", "the name of an area"]),
        ("pop in goal adn pop in wall", 13, ["'adn'", "'and', 'or'"]),
        ("pop in goal &", 14, ["ends", "a formula such as"]),
        ("F[0,80] (pop in goal", 21, ["ends", "')'"]),
        ("pop in goal)", 12, ["')'", "the end of the formula"]),
        ("pop.x", 6, ["ends", "'<='"]),
        ("pop.x = 3", 7, ["'='", "no meaning"]),
        ("pop.x * pop.y <= 3", 1, ["product of two signals"]),
        ("pop.x / 0 <= 3", 1, ["divided by a number other than zero"]),
        ("pop.x <= pop.x + 1", 1, ["at least one signal"]),
        ("3 <= 4", 1, ["at least one signal"]),
        ("distance(a, b) <= pop.x", 1, ["compared with a number"]),
        ("speed(a) <= speed(b)", 1, ["compared with a number"]),
        ("distance(a) <= 1", 1, ["distance takes 2 bodies, got 1"]),
        ("speed(a, b) <= 1", 1, ["speed takes 1 body, got 2"]),
        ("distance(a, all) <= 1", 1, ["distance takes the names of 2 bodies, not 'all'"]),
        ("distance(a b) <= 1", 12, ["'b'", "','", "')'"]),
    ],
)
def test_mistakes_are_located_and_explained(text, column, words):
    with pytest.raises(FormulaError) as error:
        parse(text)
    message = str(error.value)
    assert f"column {column}:" in message
    assert "\n" not in message
    for word in words:
        assert word in message


def test_error_of_a_long_text_stays_one_short_line():
    with pytest.raises(FormulaError) as error:
        parse("G[0,9] (pop in goal\n & pop i goal) & " + " & ".join(["pop in goal"] * 50))
    assert str(error.value).startswith("line 2, column 8: found 'i'")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 200


@pytest.mark.parametrize("text", ["", " \n "])
def test_empty_text(text):
    with pytest.raises(FormulaError, match="the formula is empty"):
        parse(text)


def test_no_text():
    with pytest.raises(FormulaError, match="got int"):
        parse(5)


def test_reserved_words_name_no_area():
    for word in RESERVED:
        with pytest.raises(FormulaError):
            parse(f"pop in {word}")
        assert parse(f"pop in {word}_1") == In("pop", f"{word}_1")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pup in goal", "body 'pup' is unknown; did you mean 'pop'? choices: pop, snap"),
        ("pop in gaol", "area 'gaol' is unknown; did you mean 'goal'? choices: goal, wall"),
        ("pop.z <= 1", "signal 'z' is unknown; choices: x, y, vx, vy, heading, omega"),
        ("F[0,1] distance(pop, crackle) <= 1", "body 'crackle' is unknown; choices: pop, snap"),
    ],
)
def test_unknown_names_are_told_with_the_choices(text, message):
    with pytest.raises(FormulaError) as error:
        parse(text).check_names(("pop", "snap"), ("goal", "wall"))
    assert str(error.value) == message


def test_known_names_pass():
    parse("F[0,9] all in goal & speed(pop) < 1 & snap.omega > 0").check_names(("pop", "snap"), ("goal",))


def test_trees_that_mean_nothing_are_refused():
    for make in (
        lambda: And((P,)),
        lambda: Eventually((2, 1), P),
        lambda: Distance("a", "b", "==", 1.0),
        lambda: Speed("a", "<=", math.nan),
        lambda: Linear((("pop.x", 0.0),), "<=", 1.0),
        lambda: Linear((("pop.x", 1.0), ("pop.x", 2.0)), "<=", 1.0),
    ):
        with pytest.raises(InputError):
            make()
