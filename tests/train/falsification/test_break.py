"""Failures are found, made as mild as they stay failures, and written so that every command meets the same world."""

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from impact_envs.errors import InputError
from impact_envs.free_flyer.truth import START_X, START_Y
from impact_envs.stl import parse
from planners.plan import Plan
from train.evaluation.batch_player import play_batched
from train.evaluation.case import make_case
from train.evaluation.player import Job
from train.falsification.arena import Arena, Played
from train.falsification.counterexample import Counterexample, find_counterexamples, minimise
from train.falsification.robustness_map import compute_importance, draw_map
from train.falsification.search import SearchOptions, search_failures
from train.falsification.suite_file import write_suites
from train.free_flyer.pinned_worlds import PinnedScenario
from train.pictures.file import save_figure

TUNING = 1_000_000  # first seed
PLAN = Plan.load(Path(__file__).parents[2] / "frozen" / "plans" / "throw_and_catch.json")


class Hill:
    """An arena in which an episode fails where x + y exceeds 1, nominal at (0, 0); z does not matter."""

    names, wide = ("x", "y", "z"), 32

    def __init__(self, least=1.0):
        self.worlds = SimpleNamespace(
            nominal=np.zeros(3), list_values=lambda places: dict(zip("xyz", map(float, places), strict=True))
        )
        self.least, self.episodes = least, 0

    def play(self, places, seeds):
        self.episodes += len(places)
        robustness = self.least - places[:, 0] - places[:, 1]
        causes = np.where(robustness < 0, "too high", "").astype(object)
        return Played(places, seeds, robustness, robustness >= 0, causes)


def test_minimising_leaves_what_matters_at_the_edge_of_failing():
    places = minimise(Hill(), np.array([[0.9, 0.8, 0.7], [0.6, 0.5, 0.0]]), np.zeros(2, int))
    assert (places[:, 2] == 0.0).all()
    assert (places[:, :2].sum(axis=1) > 1.0).all()
    assert (places[:, :2].sum(axis=1) < 1.05).all()


def test_disturbance_that_alone_fails_is_the_only_one_left():
    assert np.flatnonzero(minimise(Hill(least=0.5), np.array([[0.9, 0.8, 0.7]]), np.zeros(1, int))[0]).tolist() in (
        [0],
        [1],
    )


@pytest.mark.parametrize("method", ["cross_entropy", "cma"])
def test_search_finds_rare_failures_that_chance_does_not(method):
    if method == "cma" and importlib.util.find_spec("cma") is None:
        pytest.skip("the package cma is not installed")
    options = SearchOptions(method, episodes=1280)
    found = search_failures(Hill(least=1.9), 0, options)
    chance = search_failures(Hill(least=1.9), 0, replace(options, method="random"))
    assert len(found.success) == len(chance.success) == 1280
    assert np.sum(~found.success) > 10 * np.sum(~chance.success) + 10
    (one,) = find_counterexamples(Hill(least=1.9), found, 3, np.arange(4))
    assert (one.cause, one.failure_rate, one.moved) == ("too high", 1.0, ("x", "y"))


def test_map_is_drawn_over_what_explains_the_robustness(tmp_path):
    arena = Hill()
    arena.worlds.list_values = lambda places: {f"true.{n}": 2.0 * p for n, p in zip("xyz", places, strict=True)}
    played = search_failures(arena, 0, SearchOptions("random", episodes=2000))
    shares = compute_importance(played)
    assert shares[2] < 0.02
    assert shares[0] == pytest.approx(0.5, abs=0.1)
    assert shares[1] == pytest.approx(0.5, abs=0.1)
    found = find_counterexamples(arena, played, 3, np.arange(4))
    figure = draw_map(arena, played, found, "a hill", parse("G[0,1] pop in goal"))
    (axes, _) = figure.axes
    assert {axes.get_xlabel(), axes.get_ylabel()} == {"x", "y"}
    cells = axes.collections[0]
    centres, means = cells.get_offsets(), cells.get_array()
    np.testing.assert_allclose(means, 1.0 - centres.sum(axis=1) / 2.0, atol=0.15)
    save_figure(figure, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 10_000
    arena.names = ("x",)
    with pytest.raises(InputError, match="--map: the suite draws x alone"):
        draw_map(arena, played, found, "", parse("G[0,1] pop in goal"))


def test_pinned_worlds_have_the_values_that_are_told():
    scenario = make_case("throw_and_catch", "hard").scenario
    pinned = PinnedScenario(scenario)
    assert "restitution" in pinned.names
    assert "position_noise" not in pinned.names  # a number, not a range
    places = np.random.default_rng(0).random((5, len(pinned.names)))
    pinned.pin(places)
    uniforms = np.random.default_rng(1).random((5, scenario.draw_count))
    drawn = pinned.draw_many(uniforms)
    for k in range(5):
        values = pinned.list_values(places[k])
        assert drawn.contact[k, 0] == values["true.restitution"]
        assert drawn.sensor[k, 0] == values["true.delay_steps"]
        narrowed = scenario.override({key: {"uniform": [value, value]} for key, value in values.items()})
        same = narrowed.draw_many(uniforms[k : k + 1])
        for numbers, wanted in zip(drawn[:4], same[:4], strict=True):
            np.testing.assert_array_equal(numbers[k], wanted[0])
    usual = pinned.list_values(pinned.nominal)
    assert usual.pop("true.restitution") == scenario.believed.restitution
    assert usual.pop("true.object_mass_scale") == 1.0
    assert set(usual.values()) == {0.0}
    pinned.pin(pinned.nominal[None])
    assert pinned.draw_many(uniforms[:1]).contact[0, 0] == scenario.believed.restitution


@pytest.mark.parametrize("policy", ["expert", "zero"])
@pytest.mark.parametrize("vary", [(), ("start=0.04", "friction=0,0.1")])
def test_suite_that_is_written_has_the_very_episode_that_was_found(vary, policy, tmp_path):
    case = replace(make_case("throw_and_catch", "hard", PinnedScenario.read_ranges(vary)), plan=PLAN)
    arena = Arena(case, policy, 4, threads=2)
    places, seeds = np.random.default_rng(3).random((2, len(arena.names))), np.array([TUNING, TUNING + 1])
    played = arena.play(places, seeds)
    arena.close()
    found = [
        Counterexample("some", int(seed), float(rho), arena.worlds.list_values(place), (), 1, place)
        for place, seed, rho in zip(places, seeds, played.robustness, strict=True)
    ]
    path = tmp_path / "broken.toml"
    names = write_suites(case, "throw_and_catch", found, path)
    for name, one in zip(names, found, strict=True):
        again = replace(make_case(path, name), plan=PLAN)
        assert again.scenario.name == "throw_and_catch"  # so that plans fit
        ((row, _),) = play_batched([again], [Job(0, policy, one.seed)])
        assert row["robustness"] == one.robustness


def test_starts_are_varied_around_the_scenarios_and_the_plan_knows_nothing_of_it():
    case = make_case("throw_and_catch", "nominal", PinnedScenario.read_ranges(["start=0.05"]))
    pinned = PinnedScenario(case.scenario)
    assert pinned.names == ("robot_start_x", "robot_start_y", "object_start_x", "object_start_y")
    pinned.pin(np.array([[0.0, 1.0, 0.5, 0.75], pinned.nominal]))
    drawn = pinned.draw_many(np.random.default_rng(0).random((2, case.scenario.draw_count)))
    moved = drawn.body[:, :, START_X : START_Y + 1]
    robots = len(case.scenario.robots)
    np.testing.assert_allclose(moved[0, :robots], [[-0.05, 0.05]] * robots)
    np.testing.assert_allclose(moved[0, robots:], [[0.0, 0.025]], atol=1e-15)
    assert not moved[1].any()
    believed = make_case("throw_and_catch").scenario.as_believed()
    np.testing.assert_array_equal(case.scenario.as_believed().starts, believed.starts)


@pytest.mark.parametrize("text", ["star=0.1", "start", "start=a", "start=0", "restitution=0.5,0.4", "start=1,2,3"])
def test_range_that_is_none_is_refused(text):
    with pytest.raises(InputError, match=f"--vary {text}"):
        PinnedScenario.read_ranges([text])


def test_what_cannot_be_searched_is_refused():
    for case, policy, word in (
        (make_case("throw_and_catch"), "zero", "draws nothing"),
        (make_case("throw_and_catch", "hard"), "oracle", "oracle"),
        (make_case("throw_and_catch", "hard"), "random", "random"),
        (make_case("dual_arm_grasp", "hard"), "zero", "cannot be chosen"),
    ):
        with pytest.raises(InputError, match=word):
            Arena(case, policy, 2)
