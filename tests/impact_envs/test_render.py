import sys
import threading
import time
from dataclasses import replace

import imageio.v3 as iio
import numpy as np
import pytest

import impact_envs
from impact_envs.errors import InputError
from impact_envs.interface.shape import Shape
from impact_envs.picture import drawing, labels
from impact_envs.picture.render import Film, Frame, Mark, Renderer
from impact_envs.picture.unit import find_unit
from impact_envs.picture.view import find_view
from impact_envs.picture.window import Window
from impact_envs.stl import parse
from planners import make_expert
from tests.frozen.freeze import get_plan

LOWER, UPPER = (-1.0, 0.0), (3.0, 10.0)  # the corridor's 4 x 10 m
ROBOT = Shape("snap", "robot", radius=0.3)
PUCK = Shape("pop", "object", radius=0.3)
BOX = Shape("pop", "object", vertices=((-0.6, -0.2), (0.6, -0.2), (0.6, 0.2), (-0.6, 0.2)))
SIZE = (500, 900)
ORANGE = drawing.mix(drawing.OBJECT_COLORS[0], 0.85)  # as bodies are filled


def _draw(shapes, size=SIZE, **frame):
    renderer = Renderer(LOWER, UPPER, shapes, size=size)
    frame.setdefault("poses", {"snap": (1.0, 2.0, 0.0), "pop": (1.0, 6.0, 0.0)})
    return renderer.draw(Frame(0.0, **frame))


def _find(image, color, tolerance=40.0):
    """Return rows and columns of the pixels of nearly this colour."""
    return np.nonzero(np.linalg.norm(image.astype(float) - color, axis=2) < tolerance)


def _center(image, color):
    rows, columns = _find(image, color)
    return np.array([columns.mean(), rows.mean()])


def _extent(image, color):
    rows, columns = _find(image, color)
    return np.ptp(columns) + 1, np.ptp(rows) + 1


def test_picture_is_a_fresh_array_of_the_asked_size():
    renderer = Renderer(LOWER, UPPER, [ROBOT], size=SIZE)
    frame = Frame(1.0, {"snap": (1.0, 2.0, 0.0)})
    first, second = renderer.draw(frame), renderer.draw(frame)
    assert first.shape == (SIZE[1], SIZE[0], 3) and first.dtype == np.uint8
    assert np.array_equal(first, second) and not np.shares_memory(first, second)
    first[:] = 0
    assert np.array_equal(renderer.draw(frame), second)


@pytest.mark.parametrize("size", [SIZE, None])
def test_both_axes_have_one_scale_and_y_points_up(size):
    color = ORANGE
    width, height = _extent(_draw([PUCK], size), color)
    assert abs(width - height) <= 1
    here = _center(_draw([PUCK], size), color)
    right = _center(_draw([PUCK], size, poses={"pop": (2.0, 6.0, 0.0)}), color) - here
    up = _center(_draw([PUCK], size, poses={"pop": (1.0, 7.0, 0.0)}), color) - here
    assert right[0] == pytest.approx(-up[1], abs=0.6) and right[0] > 20  # drawn to half a pixel
    assert (right[1], up[0]) == pytest.approx((0, 0), abs=0.3)
    assert width == pytest.approx(0.6 * right[0], abs=4)  # a disc of radius 0.3 m is 0.6 m wide


def test_polygon_turns_with_its_body():
    lying = _extent(_draw([BOX]), ORANGE)
    upright = _extent(_draw([BOX], poses={"pop": (1.0, 6.0, np.pi / 2)}), ORANGE)
    assert lying[0] > 2.5 * lying[1]
    assert upright == pytest.approx(lying[::-1], abs=1)
    # A quarter turn is counter-clockwise: a long arm to the right then points up.
    arm = Shape("pop", "object", vertices=((0.0, -0.1), (1.2, -0.1), (1.2, 0.1), (0.0, 0.1)))
    up = _center(_draw([arm], poses={"pop": (1.0, 6.0, np.pi / 2)}), ORANGE)
    assert up[1] < _center(_draw([arm]), ORANGE)[1] - 20


def test_heading_mark_points_along_the_heading():
    plain = _draw([Shape("snap", "object", radius=0.3)])
    middle = _center(plain, ORANGE)
    for heading in (0.0, 0.5 * np.pi, np.pi, 1.25 * np.pi):
        image = _draw([ROBOT], poses={"snap": (1.0, 2.0, heading)})
        rows, columns = _find(image, drawing.PAPER, 12.0)
        near = np.hypot(columns - middle[0], rows - middle[1]) < 18
        mark = np.array([columns[near].mean(), rows[near].mean()]) - middle
        assert mark / np.linalg.norm(mark) == pytest.approx((np.cos(heading), -np.sin(heading)), abs=0.12)


@pytest.mark.parametrize("points", [np.zeros((0, 2)), np.ones((1, 2)), np.ones((5, 2))])
def test_curves_without_length_draw_nothing_far(points):
    image = _draw([PUCK], trails={"pop": points}, plans={"pop": points}, poses={"pop": (1.0, 1.0, 0.0)})
    assert np.array_equal(image[: SIZE[1] // 2], _draw([PUCK], poses={"pop": (1.0, 1.0, 0.0)})[: SIZE[1] // 2])


@pytest.mark.parametrize(
    ("bounds", "color"),
    [((0.1, 0.4), drawing.SATISFIED), ((-1.0, -0.2), drawing.VIOLATED), ((-1.0, 0.4), drawing.UNDECIDED)],
)
def test_header_shows_the_verdict(bounds, color):
    header = _draw([], robustness=bounds)[:66, SIZE[0] // 2 :]
    for other in (drawing.SATISFIED, drawing.VIOLATED, drawing.UNDECIDED):
        assert (len(_find(header, other, 12)[0]) > 40) == (other == color)


def test_regions_lie_under_obstacles_and_obstacles_under_bodies():
    square = ((0.0, 4.0), (2.0, 4.0), (2.0, 8.0), (0.0, 8.0))
    stone, area = Shape(None, "obstacle", vertices=square), Shape(None, "region", vertices=square)
    for shapes in ([stone, area, PUCK], [PUCK, area, stone]):
        image = _draw(shapes)
        rows, _ = _find(image, drawing.SOLID, 6)
        assert len(rows) > 1000
        body_rows, _ = _find(image, ORANGE)
        assert rows.min() < body_rows.min() < body_rows.max() < rows.max()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((LOWER, UPPER, [], "rgb"), "render mode 'rgb' is unknown: choices: human, rgb_array"),
        ((LOWER, LOWER, []), "is empty"),
        ((LOWER, UPPER, [], "rgb_array", (40, 40)), "too small"),
    ],
)
def test_bad_input_is_one_line(arguments, says):
    with pytest.raises(InputError, match=says) as caught:
        Renderer(*arguments)
    assert "\n" not in str(caught.value)


def test_body_without_pose_is_named():
    with pytest.raises(InputError, match="no pose for body 'pop'"):
        _draw([PUCK], poses={"snap": (0, 0, 0)})


def test_window_draws_and_closes(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    import pygame

    renderer = Renderer(LOWER, UPPER, [PUCK], "human", fps=1000)
    frame = Frame(0.0, {"pop": (1.0, 6.0, 0.0)})
    try:
        assert renderer.draw(frame) is None
        shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
        assert np.array_equal(shown, Renderer(LOWER, UPPER, [PUCK]).draw(replace(frame, speed=1.0)))
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        with pytest.raises(KeyboardInterrupt):
            renderer.draw(frame)
        assert not pygame.display.get_init()
        assert renderer.draw(frame) is None
    finally:
        renderer.close()
    assert not pygame.display.get_init()


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_window_without_display_is_one_line(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match="finds no display"):
        Renderer(LOWER, UPPER, [], "human").draw(Frame(0.0, {}))


def write_film(path, pictures):
    film = Film(path, fps=10)
    for picture in pictures:
        film.add(picture)
    return film.close()


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_film_has_the_frames_given(tmp_path, suffix):
    renderer = Renderer((0, 0), (2, 1), [PUCK], size=(200, 170))
    pictures = [renderer.draw(Frame(0.0, {"pop": (0.4 + 0.3 * k, 0.5, 0.0)})) for k in range(5)]
    film = iio.imread(write_film(tmp_path / f"film{suffix}", pictures))
    assert film.shape == (5, 170, 200, 3)
    for shown, drawn in zip(film, pictures, strict=True):
        assert _center(shown, ORANGE) == pytest.approx(_center(drawn, ORANGE), abs=1)


def test_a_gif_keeps_colours_and_time(tmp_path):
    """Of a frame that shows what the first one has not, too; equal frames are one that is shown for longer."""
    from PIL import Image

    plain = np.full((60, 80, 3), (240, 241, 242), np.uint8)
    flash = plain.copy()
    flash[10:30, 20:60] = (201, 20, 33)
    pictures = [plain, flash, flash, plain]
    path = tmp_path / "film.gif"
    film = Film(path, fps=30.0, hold=0.5)
    for picture in pictures:
        film.add(picture)
    film.close()
    shown = iio.imread(path)
    assert len(shown) == 3
    for seen, drawn in zip(shown, (plain, flash, plain), strict=True):
        assert np.array_equal(seen, drawn)
    with Image.open(path) as image:
        times = [image.seek(k) or image.info["duration"] for k in range(image.n_frames)]
    assert sum(times) == pytest.approx(1000.0 * (4 / 30.0 + 0.5), abs=5.0)  # hundredths of a second
    assert times[0] == 30 and times[1] == 70


def test_picture_is_the_last_frame(tmp_path):
    renderer = Renderer((0, 0), (2, 1), [PUCK], size=(200, 170))
    pictures = [renderer.draw(Frame(0.0, {"pop": (0.4 + 0.3 * k, 0.5, 0.0)})) for k in range(3)]
    assert np.array_equal(iio.imread(write_film(tmp_path / "last.png", pictures)), pictures[-1])


@pytest.mark.parametrize(
    ("name", "count", "says"),
    [
        ("film.avi", 1, "suffix '.avi'.*choices: .mp4, .gif, .png"),
        ("film.gif", 0, "no frames"),
        ("no/film.gif", 1, "not exist"),
    ],
)
def test_film_that_cannot_be_written_is_one_line(tmp_path, name, count, says):
    with pytest.raises(InputError, match=says):
        write_film(tmp_path / name, [np.zeros((8, 8, 3), np.uint8)] * count)


def test_environment_gathers_trails_and_impacts():
    env = impact_envs.parallel_env("throw_and_catch", render_mode="rgb_array")
    env.reset(seed=0)
    start = env.render()
    assert np.array_equal(env.render(), start)
    push = {agent: np.array([-1.0, 0.0, 0.0]) for agent in env.possible_agents}  # against the wall on the left
    hits = 0
    while env.agents and hits == 0:
        env.step(push)
        image = env.render()
        hits = len(env.impacts)
    assert hits > 0
    assert len(_find(image, drawing.IMPACT, 60)[0]) > 20 and len(_find(start, drawing.IMPACT, 60)[0]) == 0
    env.reset(seed=0)
    assert np.array_equal(env.render(), start)
    env.close()


def test_a_chain_is_drawn_from_joint_to_joint_in_its_bodys_color():
    def place(x, y):
        return np.rint(_center(_draw([PUCK], poses={"pop": (x, y, 0.0)}), ORANGE)).astype(int)

    chain = np.array([(2.0, 4.0), (2.0, 8.0), (1.0, 8.0)])
    linked = _draw([ROBOT], poses={"snap": (1.0, 8.0, 0.0)}, chains={"snap": chain})
    link = drawing.mix(drawing.ROBOT_COLORS[0], 0.55)
    for x, y, color in ((2.0, 4.0, drawing.PAPER), (2.0, 8.0, drawing.PAPER), (2.0, 6.0, link), (1.5, 8.0, link)):
        column, row = place(x, y)
        assert linked[row, column] == pytest.approx(color, abs=3)


def test_drawing_on_gives_what_drawing_anew_gives():
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0.0, 0.3, (60, 2)), axis=0) + np.array([1.0, 5.0])
    other = path[::-1] + 0.5
    painter = Renderer(LOWER, UPPER, [ROBOT, BOX], size=SIZE)
    for k in (1, 2, 17, 40, 59, 30, 60):  # forth, and back as after a reset
        frame = Frame(
            0.1 * k,
            {"snap": (*path[k - 1], 0.3 * k), "pop": (*other[k - 1], -0.1 * k)},
            trails={"snap": path[:k], "pop": other[:k]},
            plans={"pop": other[:: 1 + k % 2]},
            impacts=[Mark(*path[k - 1], 0.0, [(*path[k - 1], 0.1, 0.2)])] if k % 2 else [],
            chains={"snap": np.array([(2.0, 4.0), (2.0, 8.0), path[k - 1]])},
        )
        assert np.array_equal(painter.draw(frame), Renderer(LOWER, UPPER, [ROBOT, BOX], size=SIZE).draw(frame))


@pytest.mark.parametrize("change", [(0.3, 0.0), (0.0, 0.3), (-0.2, -0.2)])
def test_arrow_of_an_impact_points_along_the_change_of_velocity(change):
    mark = Mark(1.0, 6.0, 0.0, [(1.0, 6.0, *change)])
    image = _draw([], impacts=[mark])
    rows, columns = _find(image, drawing.IMPACT, 30)
    center = _center(_draw([PUCK]), ORANGE)
    far = np.argmax(np.hypot(columns - center[0], rows - center[1]))
    way = np.array([columns[far] - center[0], center[1] - rows[far]])
    assert way / np.hypot(*way) == pytest.approx(np.array(change) / np.hypot(*change), abs=0.1)
    old = _draw([], impacts=[mark._replace(age=60.0)])
    assert len(_find(old, drawing.IMPACT, 30)[0]) < len(rows) / 4


def test_labels_go_beside_bodies_as_long_as_there_is_room():
    body = np.array([[100.0, 100.0, 140.0, 140.0]])
    places = labels.place_beside(body[0, :2], body[0, 2:], (30, 12))
    blocked = np.array([[60.0, 141.0, 180.0, 170.0], [60.0, 70.0, 180.0, 99.0], [141.0, 90.0, 200.0, 150.0]])
    frame = (0.0, 0.0, 300.0, 300.0)
    for k in range(4):
        place = labels.choose_place(places, np.vstack([body, blocked[:k]]), frame)
        for box in (body[0], *blocked[:k]):
            assert not (np.maximum(place[:2], box[:2]) < np.minimum(place[2:], box[2:])).all()
    # In a corner of the picture it still lies inside.
    corner = labels.choose_place(labels.place_beside(np.zeros(2), np.full(2, 20.0), (30, 12)), np.zeros((0, 4)), frame)
    assert (corner >= 0).all() and (corner <= 300).all()


def test_film_holds_its_end(tmp_path):
    renderer = Renderer((0, 0), (2, 1), [PUCK], size=(200, 170))
    film = Film(tmp_path / "film.mp4", fps=10, hold=0.5)
    for k in range(3):
        film.add(renderer.draw(Frame(0.0, {"pop": (0.4 + 0.3 * k, 0.5, 0.0)})))
    shown = iio.imread(film.close())
    assert len(shown) == 3 + 5
    for picture in shown[2:]:
        assert _center(picture, ORANGE) == pytest.approx(_center(shown[2], ORANGE), abs=0.5)


def _press(*names, kind="KEYDOWN"):
    import pygame

    for name in names:
        pygame.event.post(pygame.event.Event(getattr(pygame, kind), key=pygame.key.key_code(name)))


def test_window_pauses_steps_and_changes_its_speed(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    import pygame

    heard = []
    window = Window((80, 60), fps=50.0, speed=2.0, on_key=lambda name, pressed: heard.append((name, pressed)))
    picture = pygame.Surface((80, 60))
    try:
        window.show(picture, 0.0)
        assert not window.is_due(0.03)  # seen for 15 ms at twice real time, less than a picture's 20 ms
        assert window.is_due(0.05)
        start = time.perf_counter()
        window.show(picture, 0.2)
        assert time.perf_counter() - start > 0.08  # 0.2 s at twice real time
        _press("+", "+")
        window.show(picture, 0.2)
        assert window.speed == pytest.approx(4.0)
        _press("-", "-", "-", "-", "left")
        _press("left", kind="KEYUP")
        window.show(picture, 0.2)
        assert window.speed == pytest.approx(1.0)
        assert heard == [("left", True), ("left", False)]
        _press("space", ".")
        start = time.perf_counter()
        window.show(picture, 5.0)  # in a pause a step is shown when it is asked for, not 4.8 s later
        assert window.paused and time.perf_counter() - start < 1.0
        threading.Timer(0.15, lambda: _press("space")).start()
        start = time.perf_counter()
        window.show(picture, 5.1)  # and without being asked, none until time goes on
        assert not window.paused and time.perf_counter() - start > 0.1
        _press("escape")
        with pytest.raises(KeyboardInterrupt):
            window.show(picture, 5.1)
    finally:
        window.close()


def test_nothing_of_the_arms_leaves_the_picture():
    env = impact_envs.parallel_env("dual_arm_grasp", render_mode="rgb_array")
    env.reset(seed=0)
    lower, upper = find_view(env.scenario)
    joints = np.vstack(list(env.make_frame().chains.values()))
    assert (joints > lower).all() and (joints < upper).all()
    assert (joints.min(axis=0) < env.scenario.world.lower).any()  # which the world alone would not do


@pytest.mark.parametrize(
    ("formula", "unit"),
    [
        ("F[0,3] pop in goal & G[0,3] distance(pop, snap) >= 1", "m"),
        ("G[0,3] speed(pop) <= 1", "m/s"),
        ("G[0,3] pop.x - 2*snap.y <= 1", "m"),
        ("F[0,3] pop in goal & G[0,3] speed(pop) <= 1", ""),
        ("G[0,3] pop.x + pop.vx <= 1", ""),
    ],
)
def test_unit_of_robustness_is_that_of_the_predicates(formula, unit):
    assert find_unit(parse(formula)) == unit


def test_a_change_of_velocity_is_that_of_the_impulse():
    env = impact_envs.parallel_env("throw_and_catch", render_mode="rgb_array")
    policy = make_expert(env.scenario, get_plan("throw_and_catch", "nominal"))
    impact_envs.rollout(env, policy, seed=1_000_000)
    (mark, *_) = env.make_frame().impacts
    (impact, _), *_ = env.past.marks
    masses = {name: env.scenario.body(name).mass for name in (impact.a, impact.b)}
    for body, sign, (_, _, *change) in zip((impact.a, impact.b), (-1.0, 1.0), mark.changes, strict=True):
        # Thrusters add a little within the control period.
        assert change == pytest.approx(sign * np.array(impact.impulse) / masses[body], abs=0.02)
