"""An option takes the values that mean something, and one line says which."""

import math

import pytest

from impact_envs import InputError, load_scenario
from planners import list_options
from planners.options import Limits, _find_limits, replace_options

SCENARIOS = ("throw_and_catch", "floating_manipulator", "dual_arm_grasp")


def get_defaults(name):
    from impact_envs.domain import find_part

    return find_part("planners", load_scenario(name).domain, "OPTIONS")(None)


@pytest.mark.parametrize("name", SCENARIOS)
def test_no_number_is_below_its_least_or_above_its_greatest(name):
    defaults = get_defaults(name)
    for option, value in list_options(load_scenario(name)).items():
        numbers = value if isinstance(value, tuple) else (value,)
        if isinstance(numbers[0], bool | str):
            continue
        limits = _find_limits(defaults, option.split("."))
        assert all(limits.least <= number <= limits.greatest or number == math.inf for number in numbers), option
        kind = type(numbers[0])
        for wrong in (kind(limits.least - 1), kind(limits.greatest * 2 + 1)):
            wanted = tuple(wrong for _ in numbers) if isinstance(value, tuple) else wrong
            with pytest.raises(InputError, match=f"expert.{option} = .*; choices: from ") as error:
                replace_options(defaults, {option: wanted})
            assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "option", "value"),
    [
        ("throw_and_catch", "timing.replan_period", 0.0),
        ("throw_and_catch", "retiming.candidates", 2_000_000_000),
        ("throw_and_catch", "insertion.leads", [5.0] * 7 + [-1.0]),
        ("throw_and_catch", "insertion.wall", -1.0),
        ("throw_and_catch", "insertion.side", -1.5),
        ("floating_manipulator", "regulator.effort_before", 0.0),
        ("dual_arm_grasp", "controller.dwell", 0.0),
        ("dual_arm_grasp", "prediction.heights", 1),
        ("throw_and_catch", "aim.shares", math.nan),
        ("throw_and_catch", "timing.replan_period", 10**400),
        ("throw_and_catch", "retiming.candidates", 10**4000),
        ("throw_and_catch", "insertion.leads", [5.0] * 7 + [10**400]),
    ],
)
def test_what_would_break_the_expert_is_refused(name, option, value):
    with pytest.raises(InputError, match=option.replace(".", r"\.")):
        replace_options(get_defaults(name), {option: value})


def test_a_default_may_be_given_again():
    options = get_defaults("dual_arm_grasp")
    assert replace_options(options, {"controller.time_out": math.inf}) == options
    assert Limits().least == 0.0
