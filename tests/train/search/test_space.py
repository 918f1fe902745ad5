"""What a search may choose is read from texts, and what is no range or list is one line."""

from __future__ import annotations

import pytest

from impact_envs import InputError
from train.search.space import Choice, Range, list_shown, parse_space


def test_ranges_and_lists_are_read() -> None:
    space = parse_space(["a=0.1,2", "b=1,8", "c=1e-4,1e-2,log", "d=[[8],[8,8]]", "e=['x', 'y', 'z']"])
    assert space == (
        Range("a", 0.1, 2),
        Range("b", 1, 8),
        Range("c", 1e-4, 1e-2, log=True),
        Choice("d", ([8], [8, 8])),
        Choice("e", ("x", "y", "z")),
    )
    assert [isinstance(one, Range) and one.whole for one in space] == [False, True, False, False, False]
    assert list_shown(space) == [
        (("a", 0.1), ("b", 1), ("c", 1e-4), ("d", [8]), ("e", "x")),
        (("a", 2), ("b", 8), ("c", 1e-2), ("d", [8, 8]), ("e", "y")),
        (("a", 2), ("b", 8), ("c", 1e-2), ("d", [8, 8]), ("e", "z")),
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a", "expected KEY=LOW,HIGH"),
        ("a=1", "expected KEY=LOW,HIGH"),
        ("=1,2", "expected KEY=LOW,HIGH"),
        ("a=[]", "expected KEY=LOW,HIGH"),
        ("a=1,2,lin", "expected KEY=LOW,HIGH"),
        ("a=1,2,log,3", "expected KEY=LOW,HIGH"),
        ("a=2,1", "LOW must be less than HIGH"),
        ("a=1,1", "LOW must be less than HIGH"),
        ("a=0,1,log", "a range with log begins above 0"),
        ("a=x,1", "'x' is no number"),
        ("a=0,inf", "'inf' is no number"),
        ("a=true,2", "'true' is no number"),
    ],
)
def test_what_is_none_is_one_line(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        parse_space([text])
    assert text in str(caught.value)


def test_a_key_is_given_once() -> None:
    with pytest.raises(InputError, match="--sample a: is given twice"):
        parse_space(["a=1,2", "a=[3]"])


@pytest.mark.parametrize("values", ["[1,2,1]", "[1,1.0]", "['1',1]", "[[8],[8]]"])
def test_a_choice_is_given_once(values: str) -> None:
    with pytest.raises(InputError, match=r"--sample a=\[...\]: .* is given twice"):
        parse_space([f"a={values}"])
    assert parse_space(["a=[true,1]"]) == (Choice("a", (True, 1)),)
