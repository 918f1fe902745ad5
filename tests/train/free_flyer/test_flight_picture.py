"""The picture of free-flyers' episode shows what happened in it and what its expert did."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from impact_envs.env import parallel_env
from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import Impact
from impact_envs.picture import drawing
from impact_envs.rollout import Episode, ZeroPolicy, rollout
from impact_envs.scenario import load_scenario
from planners import make_expert
from train.cli.main import main
from train.free_flyer.flight_picture import draw_flight, save_flight_picture
from train.free_flyer.flight_record import FlightRecord, convert_episode

ROBOTS = ("snap", "crackle")
COLORS = {"snap": drawing.ROBOT_COLORS[0], "crackle": drawing.ROBOT_COLORS[1], "pop": drawing.OBJECT_COLORS[0]}


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    return load_scenario("throw_and_catch").suite("all")  # type: ignore[return-value]


@pytest.fixture(scope="module")
def played(scenario: FreeFlyerScenario) -> tuple[FlightRecord, Episode]:
    policy = make_expert(scenario)
    record = FlightRecord(scenario, policy)
    return record, rollout(parallel_env(scenario), policy, 2_000_000, on_step=record.add)


@pytest.fixture(scope="module")
def figure(scenario: FreeFlyerScenario, played: tuple[FlightRecord, Episode]) -> Figure:
    return draw_flight(scenario, played[1], played[0])


def _solid(axes: Axes, color: drawing.Color) -> list[np.ndarray]:
    """Return the points of all solid lines of a colour, each shape (2, n)."""
    wanted = np.array(color) / 255
    found = [line for line in axes.lines if line.get_linestyle() == "-"]
    return [line.get_xydata().T for line in found if np.allclose(to_rgb(line.get_color()), wanted, atol=1e-3)]


def _stars(axes: Axes) -> tuple[list[Line2D], list[Line2D]]:
    """Return the marks of executed and of planned impacts."""
    stars = [line for line in axes.lines if line.get_marker() == "*"]
    red = [np.allclose(to_rgb(line.get_markerfacecolor()), np.array(drawing.IMPACT) / 255, atol=1e-3) for line in stars]
    return [line for line, is_red in zip(stars, red, strict=True) if is_red], [
        line for line, is_red in zip(stars, red, strict=True) if not is_red
    ]


def _verticals(axes: Axes, dashes: str) -> list[float]:
    found = [line.get_xdata() for line in axes.lines if line.get_linestyle() == dashes and len(line.get_xdata()) == 2]
    return sorted(float(x[0]) for x in found if x[0] == x[1])


def test_executed_motions_are_the_signals(figure: Figure, played: tuple[FlightRecord, Episode]) -> None:
    ground, *panels = figure.axes
    _, episode = played
    for name, color in COLORS.items():
        for panel, signal in zip(panels[:4], ("x", "y", "vx", "vy"), strict=True):
            (line,) = _solid(panel, color)
            np.testing.assert_array_equal(line[0], episode.times)
            np.testing.assert_array_equal(line[1], episode.signals[f"{name}.{signal}"])
            low, high = panel.get_ylim()
            assert low <= line[1].min() and line[1].max() <= high
        x, y = max(_solid(ground, color), key=lambda line: line.shape[1])
        np.testing.assert_allclose(x[::2], episode.signals[f"{name}.x"][:-1], atol=1e-12)
        np.testing.assert_allclose(y[1::2], episode.signals[f"{name}.y"][1:], atol=1e-12)


def test_every_impact_is_marked_planned_and_executed(figure: Figure, played: tuple[FlightRecord, Episode]) -> None:
    ground, *panels = figure.axes
    record, episode = played
    assert record.plan is not None
    times, planned = [hit.time for hit in episode.impacts], [impact.time for impact in record.plan.impacts]
    assert len(times) >= len(planned) >= 2
    for axes in (*panels[:4], panels[4], panels[5]):
        assert _verticals(axes, "-") == times
        assert _verticals(axes, "--") == planned
    for panel, axis in zip(panels[:2], (0, 1), strict=True):
        executed, meant = _stars(panel)
        assert [float(star.get_xdata()[0]) for star in executed] == times
        assert [float(star.get_ydata()[0]) for star in meant] == [hit.position[axis] for hit in record.plan.impacts]
    (executed,), (meant,) = _stars(ground)
    # The centre of a disc that is hit lies its radius behind the point of contact.
    behind = executed.get_xydata() - [hit.point for hit in episode.impacts]
    np.testing.assert_allclose(np.hypot(*behind.T), 0.2, atol=1e-4)
    np.testing.assert_array_equal(meant.get_xydata(), [hit.position for hit in record.plan.impacts])
    labels = [text.get_text() for text in ground.texts if ":" in text.get_text()]
    assert labels == [f"{k}: {hit.time:.1f} s {hit.a}" for k, hit in enumerate(episode.impacts, start=1)]
    assert [text.get_text() for text in panels[0].texts] == [str(k + 1) for k in range(len(times))]


def test_planned_motions_are_the_plans(figure: Figure, played: tuple[FlightRecord, Episode]) -> None:
    record, _ = played
    assert record.plan is not None
    pale = drawing.mix(COLORS["pop"], 0.6)
    for axis, panel in enumerate(figure.axes[1:3]):
        found = [line for line in panel.lines if np.allclose(to_rgb(line.get_color()), np.array(pale) / 255, atol=1e-3)]
        (line,) = [line.get_xydata().T for line in found]
        np.testing.assert_allclose(line[1], record.plan.objects["pop"].position(line[0])[:, axis], atol=1e-9)


def test_inputs_are_the_actions_within_their_limits(
    figure: Figure, played: tuple[FlightRecord, Episode], scenario: FreeFlyerScenario
) -> None:
    inputs = np.array(figure.axes[7:]).reshape(len(ROBOTS), 3)
    struck = {name: [hit.time for hit in played[1].impacts if hit.a == name] for name in ROBOTS}
    for name, own in zip(ROBOTS, inputs, strict=True):
        robot = scenario.robots[name]
        limits = (robot.force_limit, robot.force_limit, robot.torque_limit)
        for k, (axes, limit) in enumerate(zip(own, limits, strict=True)):
            (line,) = [line for line in _solid(axes, COLORS[name]) if line.shape[1] > 2]
            np.testing.assert_allclose(line[1][:-1], limit * played[1].actions[name][:, k], atol=1e-12)
            bounds = {float(line.get_ydata()[0]) for line in axes.lines if line.get_linestyle() == "--"}
            assert bounds == {-limit, limit}
            assert _verticals(axes, "-") == struck[name]


def test_robustness_is_the_interval(figure: Figure, played: tuple[FlightRecord, Episode]) -> None:
    panel, (_, episode) = figure.axes[5], played
    lower, upper, *_ = (line for line in _solid(panel, drawing.SATISFIED) if line.shape[1] > 2)
    np.testing.assert_array_equal(np.stack([lower[1], upper[1]], axis=1), episode.robustness_bounds)
    low, high = panel.get_ylim()
    assert low < episode.robustness < high
    assert f"ρ = {episode.robustness:.3f} m" in figure.texts[0].get_text()


def test_events_are_what_the_expert_counted(figure: Figure, played: tuple[FlightRecord, Episode]) -> None:
    panel, (record, episode) = figure.axes[6], played
    labels = [text.get_text() for text in panel.get_yticklabels()]
    assert episode.replans == len(record.replans) == len(_times(record, "replans"))
    assert len(record.expectations) == episode.replans - len(episode.impacts)  # after an impact back to the plan
    anew = {"reoptimised": episode.reoptimised["same_sequence"], "planned_anew": episode.reoptimised["free_sequence"]}
    # Which lack the other routine: retiming.
    counted = {"replans": episode.replans} | {name: n for name, n in anew.items() if n} | episode.fallbacks
    assert counted["reoptimised"] == 1  # after the throw
    assert dict(label.rsplit(" ", 1) for label in labels).keys() - {"retimed"} == {
        name.replace("_", " ") for name in counted
    }
    for label, ticks in zip(labels, panel.collections, strict=True):
        name, count = label.rsplit(" ", 1)
        times = _times(record, name.replace(" ", "_"))
        np.testing.assert_array_equal(ticks.get_offsets()[:, 0], times)
        assert counted.get(name.replace(" ", "_"), len(times)) == len(times) == int(count) > 0
    colors = {tuple(np.round(255 * np.array(color[:3])).astype(int)) for color in panel.collections[0].get_edgecolors()}
    assert colors == {COLORS["snap"], COLORS["crackle"]}


def _times(record: FlightRecord, name: str) -> list[float]:
    return [time for time, other in record.events if other == name]


def test_the_last_replan_before_an_impact_knows_where_it_will_be(played: tuple[FlightRecord, Episode]) -> None:
    record, episode = played
    for hit in episode.impacts:
        expected = [wish for wish in record.expectations if wish.way[0, 0] < hit.time][-1]
        assert {expected.robot, expected.object} == {hit.a, hit.b}
        assert expected.way[-1, 0] == pytest.approx(hit.time, abs=0.5)
        place = [np.interp(hit.time, episode.times, episode.signals[f"pop.{axis}"]) for axis in "xy"]
        assert np.hypot(*(expected.way[-1, 1:] - place)) < 0.05


def test_courses_are_what_robots_follow(played: tuple[FlightRecord, Episode]) -> None:
    record, episode = played
    for name, course in record.courses.items():
        np.testing.assert_allclose(course[:, 0], episode.times[:-1], atol=1e-9)
        executed = np.stack([episode.signals[f"{name}.{axis}"][:-1] for axis in "xy"], axis=1)
        assert np.hypot(*(course[:, 1:3] - executed).T).max() < 0.15


def test_without_an_expert_only_what_happened_is_drawn(scenario: FreeFlyerScenario) -> None:
    policy = ZeroPolicy(parallel_env(scenario))
    record = FlightRecord(scenario, policy)
    episode = rollout(parallel_env(scenario, max_cycles=20), policy, 0, on_step=record.add)
    assert record.plan is None and not record.events and not record.courses
    wall = Impact(1.0, "wall", "pop", (0.5, -0.75), (0.0, 1.0), (0.0, 0.1), 0.1)
    drawn = draw_flight(scenario, replace(episode, impacts=(wall,)), record)
    ground, *panels = drawn.axes
    (cross,) = [line for line in ground.lines if line.get_marker() == "x"]
    np.testing.assert_array_equal(cross.get_xydata(), [[0.5, -0.75]])
    assert [len(line.get_xdata()) for stars in _stars(ground) for line in stars] == [0]
    assert panels[0].get_xlim() == (0.0, pytest.approx(2.0))
    assert not convert_episode(scenario, episode).impacts
    entries = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert "other impact" in entries and "planned" not in entries


def test_file_is_written_and_bad_paths_are_refused(
    scenario: FreeFlyerScenario, played: tuple[FlightRecord, Episode], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    record, episode = played
    path = tmp_path / "flight.png"
    save_flight_picture(record, episode, path)
    assert path.read_bytes().startswith(b"\x89PNG")
    for bad, message in (("flight.jpg", "choices: a file ending in"), ("no/flight.png", "does not exist")):
        with pytest.raises(InputError, match=message):
            save_flight_picture(record, episode, tmp_path / bad)
        assert main(["run", "throw_and_catch", "--plot", str(tmp_path / bad), "--json"]) == 2
        assert message in capsys.readouterr().err
    (tmp_path / "folder.svg").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        save_flight_picture(record, episode, tmp_path / "folder.svg")
