"""Sequential tests: errors as stated however often one looks, and decisions where there is a difference."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_envs.errors import InputError
from planners.plan import Plan
from train.evaluation.case import make_case
from train.evaluation.duel import Duel, play_until_decided
from train.evaluation.sequential import RobustnessTest, SequentialOptions, SuccessTest, combine_verdicts

OPTIONS = SequentialOptions()
TUNING = 1_000_000  # first seed


def play_success(rng, options, share, most, discordant=0.5):
    """Feed pairs of which some are discordant, a share of these won by a."""
    test = SuccessTest(options)
    for _ in range(most):
        differ, won = rng.random(2) < (discordant, share)
        test.update(won if differ else True, not won if differ else True)
        if test.verdict is not None:
            break
    return test


def play_robustness(options, differences):
    test = RobustnessTest(options)
    for difference in differences:
        test.update(difference, 0.0)
        if test.verdict is not None:
            break
    return test


def draw_skewed(rng, count):
    """Draw differences of mean zero as crashes make them: mostly small gains, now and then a great loss [m]."""
    return np.where(rng.random(count) < 0.05, -0.38, 0.02)


def draw_even(rng, count):
    return rng.normal(0.0, 0.1, count)


def test_success_test_decides_for_the_better_policy_sooner_than_the_fixed_plan():
    rng = np.random.default_rng(0)
    tests = [play_success(rng, OPTIONS, 0.8, 2000) for _ in range(50)]
    assert [test.verdict for test in tests] == ["a"] * 50
    assert np.mean([test.pairs for test in tests]) < np.mean([test.count_fixed(OPTIONS.error) for test in tests])
    assert play_success(rng, OPTIONS, 0.2, 2000).verdict == "b"
    assert play_success(rng, OPTIONS, 0.5, 2000).verdict == "equal"


def test_success_test_knows_nothing_without_discordant_pairs():
    test = play_success(np.random.default_rng(0), OPTIONS, 0.5, 100, discordant=0.0)
    assert test.verdict is None
    assert test.count_fixed(OPTIONS.error) is None


def test_robustness_test_finds_a_difference_and_that_there_is_none():
    rng = np.random.default_rng(0)
    gains = [play_robustness(OPTIONS, 0.05 + draw_even(rng, 2000)) for _ in range(20)]
    assert [test.verdict for test in gains] == ["a"] * 20
    assert play_robustness(OPTIONS, -0.05 + draw_even(rng, 2000)).verdict == "b"
    none = play_robustness(OPTIONS, 0.02 * draw_even(rng, 3000))
    assert none.verdict == "equal"
    assert none.interval[0] < none.mean < none.interval[1]


def test_mean_and_deviation_are_those_of_the_cut_differences():
    differences = draw_even(np.random.default_rng(0), 300)
    test = RobustnessTest(replace(OPTIONS, least_difference=1e-9, error=1e-9))
    for difference in differences:
        test.update(difference, 0.0)
    assert test.mean == pytest.approx(np.mean(differences))
    assert test.deviation == pytest.approx(np.std(differences), rel=0.05)


def test_both_tests_must_say_equal_and_one_that_finds_a_difference_is_enough():
    assert combine_verdicts("equal", None) is None
    assert combine_verdicts("equal", "equal") == "equal"
    assert combine_verdicts(None, "b") == "b"
    assert combine_verdicts("a", "b") == "a"


@pytest.mark.slow
def test_wrong_verdicts_are_as_rare_as_stated():
    """Of 4000 series without a difference; each test may be wrong in half of the error, and the intervals too."""
    rng, runs, most = np.random.default_rng(1), 4000, 400
    options = replace(OPTIONS, error=0.1, points=1, least_difference=1e-9)
    allowed = options.error / 2.0 + 3.0 * np.sqrt(0.05 * 0.95 / runs)
    wrong = np.mean([play_success(rng, options, 0.5, most).verdict in ("a", "b") for _ in range(runs)])
    assert wrong <= allowed
    for draw in (draw_skewed, draw_even):
        wrong = np.mean([play_robustness(options, draw(rng, most)).verdict in ("a", "b") for _ in range(runs)])
        assert wrong <= allowed
    # With the least share of wins, "equal" is wrong, and so is "b".
    wrong = np.mean(
        [play_success(rng, options, options.least_share, most).verdict in ("b", "equal") for _ in range(runs)]
    )
    assert wrong <= allowed


@pytest.mark.slow
def test_intervals_hold_the_mean_at_all_times():
    rng, runs, most = np.random.default_rng(2), 300, 400
    options, missed = replace(OPTIONS, error=0.2, least_difference=1e-9), 0
    for _ in range(runs):
        test, mean = RobustnessTest(options), 0.06
        for difference in mean + draw_skewed(rng, most):
            test.verdict = None
            test.update(difference, 0.0)
            low, high = test.interval
            if not low <= mean <= high:
                missed += 1
                break
    assert missed / runs <= 0.1 + 3.0 * np.sqrt(0.09 / runs)


def test_duel_ends_as_soon_as_the_expert_is_better_than_nobody():
    plan = Plan.load(Path(__file__).parents[2] / "frozen" / "plans" / "throw_and_catch.json")
    case = replace(make_case("throw_and_catch", "hard"), plan=plan)
    duel = play_until_decided(case, ("expert", "zero"), 200, TUNING, OPTIONS)
    said = duel.to_dict()
    assert duel.verdict == "a"
    assert said["decision"] == "expert is better"
    assert said["pairs"] <= said["pairs_played"] == 50
    assert said["episodes_saved"] > 0


def test_no_more_is_saved_than_the_allowed_pairs_would_cost():
    success, robustness = SuccessTest(OPTIONS), RobustnessTest(OPTIONS)
    for _ in range(40):
        success.update(True, True)
        robustness.update(0.1, 0.0)
    success.wins, robustness.verdict = 1, "a"
    needed = robustness.count_fixed(OPTIONS.error)
    for allowed in (100, round(needed) + 1000):
        said = Duel(("x", "y"), "a", success, robustness, 50, allowed, OPTIONS).to_dict()
        assert said["fixed_plan_pairs"] == needed
        assert said["episodes_saved"] == 2 * round(min(allowed, needed) - 50)


def test_bad_requests_are_refused():
    case = make_case("throw_and_catch")
    with pytest.raises(InputError, match="--error 0"):
        play_until_decided(case, ("zero", "zero"), 50, TUNING, replace(OPTIONS, error=0.0))
    with pytest.raises(InputError, match="--least-difference"):
        play_until_decided(case, ("zero", "expert"), 50, TUNING, replace(OPTIONS, least_difference=0.6))
    with pytest.raises(InputError, match="random"):
        play_until_decided(case, ("zero", "random"), 50, TUNING, OPTIONS)
