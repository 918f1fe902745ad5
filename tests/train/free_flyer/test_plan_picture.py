from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib._pylab_helpers import Gcf
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.picture import drawing
from impact_envs.scenario import load_scenario
from planners.bezier import Curve
from planners.plan import Plan, PlannedImpact, Tube
from train.free_flyer.plan_picture import draw_plan, save_plan_picture
from train.pictures.file import check_picture_path

HITS = (("snap", 10.0), ("snap", 30.0), ("crackle", 31.0), ("crackle", 60.0))
PATH = np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 4.0], [1.05, 4.1], [1.0, 8.0], [1.0, 8.0]])


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    return load_scenario("corridor")  # type: ignore[return-value]


@pytest.fixture(scope="module")
def plan(scenario: FreeFlyerScenario) -> Plan:
    """Four impacts, two of them next to each other; snap flies a quintic."""
    times = np.array([0.0, *(time for _, time in HITS), 100.0])
    pop = Curve(times, np.stack([PATH[:-1], PATH[1:]], axis=1))
    snap = Curve([0.0, 10.0, 100.0], np.random.default_rng(1).uniform(0.5, 1.5, (2, 6, 2)))
    impacts = tuple(
        PlannedImpact(
            time=time,
            robot=robot,
            object="pop",
            position=pop.position(time),
            contact=pop.position(time),
            normal=[0.0, 1.0],
            robot_minus=[0.0, 0.0],
            robot_plus=[0.0, 0.0],
            object_minus=pop.velocity(time, "left"),
            object_plus=pop.velocity(time),
        )
        for robot, time in HITS
    )
    crackle = Curve([0.0, 100.0], np.tile([1.0, 9.0], (1, 2, 1)))
    robots = {"snap": snap, "crackle": crackle}
    return Plan(
        "corridor", "robustness", 100.0, 0.75, 0.75, 0.0, 1.0, None, impacts, robots, {"pop": pop}, 0.1, {}, True
    )


@pytest.fixture(scope="module")
def uncertain(plan: Plan) -> Plan:
    start = np.zeros((2, 2, 4))
    start[:, 0] = [[1.0, 2.0, 0.0, 0.0], [1.0, 2.0, 0.0, 0.05]]
    start[1, 1] = [0.0, 0.0, 0.01, 0.02]
    end = start.copy()
    end[1, :, :2] += 20.0 * start[1, :, 2:]
    moved = tuple(
        Curve(plan.robots["snap"].times, plan.robots["snap"].points + shift) for shift in (-0.1, 0.1, 0.2, 0.3)
    )
    tubes = {"pop": Tube([0.0, 10.0, 30.0], start, end)}
    return replace(plan, deviation=0.0123, tubes=tubes, responses={"snap": moved})


@pytest.fixture(scope="module")
def figure(scenario: FreeFlyerScenario, plan: Plan) -> Figure:
    return draw_plan(scenario, plan)


@pytest.fixture(scope="module")
def uncertain_figure(scenario: FreeFlyerScenario, uncertain: Plan) -> Figure:
    return draw_plan(scenario, uncertain)


def _lines(axes: Axes, color: drawing.Color) -> list[np.ndarray]:
    """Return the points of all lines of a colour, each shape (n, 2)."""
    wanted = np.array(color) / 255
    found = [line for line in axes.lines if line.get_linestyle() != "None"]
    return [line.get_xydata() for line in found if np.allclose(to_rgb(line.get_color()), wanted, atol=1e-3)]


def _texts(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_picture_leaves_no_global_state(figure: Figure) -> None:
    assert isinstance(figure, Figure)
    assert not Gcf.get_all_fig_managers()


def test_panels_show_positions_and_both_limits_of_velocities(figure: Figure, plan: Plan) -> None:
    panels = figure.axes[1:]
    assert [panel.get_ylabel() for panel in panels] == ["x [m]", "y [m]", "vx [m/s]", "vy [m/s]"]
    for name, color in (("snap", drawing.ROBOT_COLORS[0]), ("pop", drawing.OBJECT_COLORS[0])):
        curve = (plan.robots | plan.objects)[name]
        for axis, panel in enumerate(panels[:2]):
            (points,) = _lines(panel, color)
            assert np.allclose(points[:, 1], curve.position(points[:, 0])[:, axis])
        for axis, panel in enumerate(panels[2:]):
            (points,) = _lines(panel, color)
            shown = points[points[:, 0] == 10.0, 1]
            assert shown == pytest.approx([curve.velocity(10.0, side)[axis] for side in ("left", "right")])


def test_what_hardly_moves_is_not_magnified(scenario: FreeFlyerScenario, plan: Plan) -> None:
    flat = {name: Curve(curve.times, curve.points * [1e-6, 1]) for name, curve in plan.robots.items()}
    objects = {name: Curve(curve.times, curve.points * [0, 1]) for name, curve in plan.objects.items()}
    panels = draw_plan(scenario, replace(plan, robots=flat, objects=objects, impacts=())).axes[1:]
    x, y, vx, vy = (float(np.ptp(panel.get_ylim())) for panel in panels)
    assert x == pytest.approx(0.25 * y)
    assert vx == pytest.approx(0.25 * vy)


def test_map_shows_the_world_to_scale_and_every_path(figure: Figure) -> None:
    ground = figure.axes[0]
    assert (*ground.get_xlim(), *ground.get_ylim()) == (-1.0, 3.0, 0.0, 10.0)
    box = ground.get_window_extent()
    assert box.width / box.height == pytest.approx(0.4)
    (path,) = _lines(ground, drawing.OBJECT_COLORS[0])
    assert {tuple(point) for point in path} == {tuple(point) for point in PATH}
    assert {"goal", "corridor", "wall_left", "wall_right"} <= set(_texts(ground))


def test_impacts_are_stars_with_number_time_and_robot(figure: Figure) -> None:
    ground, *panels = figure.axes
    (stars,) = [line.get_xydata() for line in ground.lines if line.get_marker() == "*"]
    assert np.allclose(stars, PATH[1:5])
    wanted = ["1: 10.0 s snap", "2: 30.0 s snap", "3: 31.0 s crackle", "4: 60.0 s crackle"]
    assert [text for text in _texts(ground) if ":" in text] == wanted
    assert _texts(panels[0]) == ["1", "2", "3", "4"]
    for panel in panels:
        marked = {float(np.unique(line)[0]) for line in (line.get_xdata() for line in panel.lines) if len(line) == 2}
        assert {10.0, 30.0, 31.0, 60.0} <= marked


def test_legend_and_title_say_what_is_drawn(uncertain_figure: Figure, scenario: FreeFlyerScenario) -> None:
    (legend,) = uncertain_figure.legends
    entries = [text.get_text() for text in legend.get_texts()]
    assert entries[:3] == ["snap (robot)", "crackle (robot)", "pop (object)"]
    assert {"impact", "box an object stays in", "response to a vertex of the box", "region", "obstacle"} <= set(entries)
    title, formula = (text.get_text() for text in uncertain_figure.texts)
    assert "ρ = 0.750 m" in title and "δ = 0.0123 m/s" in title and "4 impacts" in title
    assert formula == scenario.formula


def test_boxes_and_responses_are_drawn(uncertain_figure: Figure) -> None:
    ground, *panels = uncertain_figure.axes
    boxes = [patch.get_bbox().extents for patch in ground.patches if isinstance(patch, Rectangle)]
    assert boxes[-1] == pytest.approx([0.8, 2.6, 1.2, 3.4])  # after 20 s at (0, 0.05) +- (0.01, 0.02) m/s
    for panel, lower, upper in zip(panels, (0.8, 2.6, -0.01, 0.03), (1.2, 3.4, 0.01, 0.07), strict=True):
        (band,) = panel.collections
        points = band.get_paths()[0].vertices
        at_the_end = points[np.isclose(points[:, 0], 30.0), 1]
        assert (at_the_end.min(), at_the_end.max()) == pytest.approx((lower, upper))
    pale = drawing.mix(drawing.ROBOT_COLORS[0], 0.5)
    assert len(_lines(ground, pale)) == 4
    assert all(len(_lines(panel, pale)) == 4 for panel in panels)


def test_colours_begin_anew_with_other_dashes(scenario: FreeFlyerScenario, plan: Plan) -> None:
    names = [f"robot_{k}" for k in range(6)]
    data = scenario.model_dump(exclude_unset=True)
    robot = data["robots"]["snap"]
    data["robots"] = {name: robot | {"start": [1.0, 3.0 + k], "goal": None} for k, name in enumerate(names)}
    still = {name: Curve([0.0, 100.0], np.tile([1.0, 3.0], (1, 2, 1))) for name in names}
    crowd = draw_plan(FreeFlyerScenario.model_validate(data), replace(plan, robots=still, impacts=()))
    looks = [(line.get_color(), line.get_linestyle()) for line in crowd.legends[0].get_lines()[:6]]
    assert len(set(looks)) == 6
    assert looks[0][0] == looks[4][0]
    assert "0 impacts" in crowd.texts[0].get_text()


@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".pdf", b"%PDF"), (".SVG", b"<?xml")])
def test_the_same_plan_gives_the_same_file(
    scenario: FreeFlyerScenario, uncertain: Plan, tmp_path: Path, suffix: str, start: bytes
) -> None:
    first, second = tmp_path / f"1{suffix}", tmp_path / f"2{suffix}"
    save_plan_picture(scenario, uncertain, first)
    save_plan_picture(scenario, uncertain, second)
    assert first.read_bytes() == second.read_bytes()
    assert first.read_bytes().startswith(start)


def test_bad_paths_and_other_bodies_are_refused(scenario: FreeFlyerScenario, plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"plan\.jpg: choices: a file ending in \.png, \.pdf, \.svg"):
        save_plan_picture(scenario, plan, tmp_path / "plan.jpg")
    with pytest.raises(InputError, match="does not exist"):
        check_picture_path(tmp_path / "nowhere" / "plan.png")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        save_plan_picture(scenario, plan, tmp_path / "folder.png")
    renamed = replace(plan, robots={"snap": plan.robots["snap"], "crackl": plan.robots["crackle"]}, impacts=())
    with pytest.raises(InputError, match="'crackl'; did you mean 'crackle'"):
        draw_plan(scenario, renamed)
