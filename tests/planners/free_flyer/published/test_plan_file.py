import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_envs.env import parallel_env
from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from impact_envs.rollout import rollout
from impact_envs.scenario import load_scenario
from planners import make_expert
from planners.bezier import Curve
from planners.free_flyer.published.conversion import convert_published_plan, make_published_plan
from planners.free_flyer.published.curve import PublishedPlan
from planners.free_flyer.published.impact import read_deviation, read_impacts
from planners.free_flyer.published.plan_file import read_published_plan, write_published_plan
from planners.plan import Plan, PlannedImpact, Tube

SHARED = Path(__file__).resolve().parents[5] / "shared" / "data" / "impact_stl_plans"
NAMES = {"throw_and_catch_SR": "throw_catch", "throw_and_catch_IR": "throw_catch"}
NAMES |= {"obstacle_avoidance_SR": "obstacle_avoidance"}

# Time, robot, velocities before and after of robot and object, error of the impact law: as measured from the files.
TABLE = {
    "throw_and_catch_SR": (
        0.75,
        [
            (15.45, "snap", (0, 0.2264), (0, 0.0670), (0, 0), (0, 0.2159), 0.0178),
            (43.24, "crackle", (0, -0.0250), (0, 0.1798), (0, 0.2159), (0, 0), 0.0052),
        ],
    ),
    "obstacle_avoidance_SR": (
        0.75,
        [
            (34.59, "snap", (-0.2471, 0), (-0.0166, 0), (0, 0), (-0.1924, 0), 0.0238),
            (54.13, "crackle", (0.0067, -0.0825), (-0.1350, -0.0238), (-0.1924, 0), (-0.0029, -0.0785), 0.0166),
            (105.07, "crackle", (0.3594, 0.0525), (0.0079, -0.0746), (-0.0029, -0.0785), (0.2142, 0), 0.1062),
            (120.97, "snap", (-0.0157, 0), (0.1642, 0), (0.2142, 0), (0, 0), 0.0130),
        ],
    ),
    "throw_and_catch_IR": (
        1.0,
        [
            (11.43, "snap", (0, 0.2059), (0, 0), (0, 0), (0, 0.2059), 0.0),
            (45.71, "crackle", (0, -0.1635), (0, 0.1913), (0, 0.2059), (0, -0.1635), 0.0),
            (57.14, "snap", (0, 0.0354), (0, -0.1635), (0, -0.1635), (0, 0.0354), 0.0),
        ],
    ),
}
# The specification each plan was made for, and the robustness of every body's part of it.
WALLS = "G[0,{T}] all not in wall_left & G[0,{T}] all not in wall_right"
SPECIFICATIONS = {
    "throw_and_catch_SR": ("corridor", 60, f"F[0,60] pop in goal & {WALLS}", 0.75),
    "throw_and_catch_IR": ("corridor", 80, f"F[0,80] pop in goal & {WALLS}", 0.75),
    "obstacle_avoidance_SR": ("obstacle_avoidance", 150, "G[0,150] all not in block", 1.0),
}
OBSTACLE_MARGINS = {"pop": 1.0, "snap": 1.0, "crackle": 1.2597}


def _published(name: str) -> PublishedPlan:
    if not (SHARED / name).is_dir():
        pytest.skip(f"published plans are not beside the repository: no folder {SHARED / name}")
    return read_published_plan(SHARED / name)


def _scenario(name: str, horizon: float, formula: str) -> FreeFlyerScenario:
    return load_scenario(name).override({"horizon": float(horizon), "formula": formula})  # type: ignore[return-value]


@pytest.mark.parametrize("name", TABLE)
def test_published_impacts_and_their_errors_are_those_of_the_baseline(name: str) -> None:
    restitution, rows = TABLE[name]
    impacts = read_impacts(_published(name))
    assert [(round(hit.time, 2), hit.robot, hit.object) for hit in impacts] == [(row[0], row[1], "pop") for row in rows]
    for hit, (_, _, *velocities, published_error) in zip(impacts, rows, strict=True):
        found = [hit.robot_minus, hit.robot_plus, hit.object_minus, hit.object_plus]
        assert np.allclose(found, velocities, atol=5.1e-5)
        assert np.allclose(hit.position, hit.contact, atol=1e-12)
        # How far the planned velocity is from that of Eq. (5) for points of equal mass.
        _, _, m3, m4 = compute_mass_fractions(1.0, 1.0, restitution)
        error = np.linalg.norm(m3 * hit.robot_minus + m4 * hit.object_minus - hit.object_plus)
        assert error == pytest.approx(published_error, abs=5.1e-5)


@pytest.mark.parametrize("name", SPECIFICATIONS)
def test_published_plans_have_the_robustness_of_the_baseline(name: str) -> None:
    scenario, horizon, formula, rho = SPECIFICATIONS[name]
    plan = convert_published_plan(_published(name), _scenario(scenario, horizon, formula.format(T=horizon)))
    assert plan.robustness == pytest.approx(rho, abs=1e-6)
    assert not plan.validated
    assert Plan.from_json(plan.to_json()) == plan


@pytest.mark.parametrize("body", OBSTACLE_MARGINS)
def test_margins_of_single_bodies_are_those_of_the_baseline(body: str) -> None:
    scenario = _scenario("obstacle_avoidance", 150, f"G[0,150] {body} not in block")
    plan = convert_published_plan(_published("obstacle_avoidance_SR"), scenario)
    assert plan.robustness == pytest.approx(OBSTACLE_MARGINS[body], abs=5e-5)


def test_permissible_deviation_is_that_of_the_baseline() -> None:
    published = _published("throw_and_catch_IR")
    plan = convert_published_plan(published, _scenario("corridor", 80, "F[0,80] pop in goal"))
    assert read_deviation(published) == plan.deviation == pytest.approx(0.0145833, abs=5e-8)
    assert plan.objective == "impact_uncertainty"
    assert plan.tubes["pop"].end[-1, 1, :2].tolist() == [0.5, 0.5]
    assert read_deviation(_published("throw_and_catch_SR")) is None


@pytest.mark.parametrize("name", NAMES)
def test_published_files_are_written_as_they_were_read(name: str, tmp_path: Path) -> None:
    published = _published(name)
    files = write_published_plan(published, tmp_path, NAMES[name])
    assert {file.name for file in files} == {file.name for file in (SHARED / name).iterdir()}
    for file in files:
        if file.name.startswith("plan_"):
            assert file.read_bytes() == (SHARED / name / file.name).read_bytes()
    again = read_published_plan(tmp_path)
    assert again.zonotopes == published.zonotopes


@pytest.mark.parametrize("name", NAMES)
def test_converted_curves_follow_the_published_ones(name: str) -> None:
    published = _published(name)
    scenario = "obstacle_avoidance" if "obstacle" in name else "corridor"
    plan = convert_published_plan(published, _scenario(scenario, published.horizon, "pop in goal"))
    times = np.linspace(0.0, published.horizon, 5001)
    for body, curve in (plan.robots | plan.objects).items():
        assert np.abs(curve.position(times) - published.bodies[body].position(times)).max() < 1e-6
        assert np.abs(curve.velocity(times) - published.bodies[body].velocity(times)).max() < 5e-5
    for hit in plan.impacts:
        assert hit.time in plan.robots[hit.robot].times
        assert hit.time in plan.objects[hit.object].times


def test_a_published_plan_is_executed() -> None:
    scenario = load_scenario("corridor")
    plan = convert_published_plan(_published("throw_and_catch_SR"), scenario)  # type: ignore[arg-type]
    episode = rollout(parallel_env(scenario), make_expert(scenario, plan), seed=0)
    assert episode.success
    assert len(episode.impacts) == 2


# snap flies with r = s, h = s + s^2 to x = 1 and back with r = 1 - s, h = 2 + 3 s - s^2; crackle stays.
HEAD = "{rvars}\n\nhvars\n{hvars}\n\nids\n{ids}\n\nother_names\n{others}\n"
ZERO = "0,0,0\n"
FILES = {
    "plan_two_words_snap.csv": HEAD.format(
        rvars=f"rvars\n0,0.5,1\n{ZERO}{ZERO}\n1,0.5,0\n{ZERO}{ZERO}",
        hvars="0,0.5,2\n\n2,3.5,4",
        ids="pre\n\npost",
        others="pop\n\npop",
    ),
    "plan_two_words_crackle.csv": HEAD.format(
        rvars=f"rvars\n5,5,5\n{ZERO}{ZERO}", hvars="0,2,4", ids="none", others="none"
    ),
    "plan_two_words_pop.csv": HEAD.format(
        rvars="rvars\n1,1\n0,0\n0,0\n\n1,2\n0,0\n0,0", hvars="0,2\n\n2,4", ids="pre\n\npost", others="snap\n\nnone"
    ),
    "zonotopes_two_words_pop.csv": "X0s\n1,0,0,0\n0,0,0,0\n\n1,0,0.5,0\n0,0,0.1,0.2\n"
    "Xfs\n1,0,0,0\n0,0,0,0\n\n2,0,0.5,0\n0.2,0.4,0.1,0.2\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def test_position_and_velocity_are_those_of_the_coupled_curves(folder: Path) -> None:
    body = read_published_plan(folder).bodies["snap"]
    t = np.linspace(0.0, 2.0, 101)
    s = (np.sqrt(1 + 4 * t) - 1) / 2
    assert np.allclose(body.position(t, "left")[:, 0], s, atol=1e-12)
    assert np.allclose(body.velocity(t, "left")[:, 0], 1 / (1 + 2 * s), atol=1e-12)
    assert body.velocity(2.0, "left") == pytest.approx([1 / 3, 0.0])
    assert body.velocity(2.0) == pytest.approx([-1 / 3, 0.0])
    assert body.position(9.0).tolist() == [0.0, 0.0]


def test_labels_become_impacts(folder: Path) -> None:
    published = read_published_plan(folder)
    assert (published.robots, published.objects, published.horizon) == (("crackle", "snap"), ("pop",), 4.0)
    (hit,) = read_impacts(published)
    assert (hit.time, hit.robot, hit.object) == (2.0, "snap", "pop")
    assert hit.position.tolist() == hit.contact.tolist() == [1.0, 0.0]
    assert hit.normal.tolist() == [1.0, 0.0]
    assert hit.object_plus.tolist() == [0.5, 0.0]
    assert hit.robot_minus.tolist() == pytest.approx([1 / 3, 0.0])


def test_labels_in_which_post_hides_pre_are_read_too(folder: Path) -> None:
    path = folder / "plan_two_words_pop.csv"
    path.write_text(FILES[path.name].replace("pre\n\npost", "none\n\npost").replace("snap\n\nnone", "none\n\nsnap"))
    assert [hit.robot for hit in read_impacts(read_published_plan(folder))] == ["snap"]


def test_files_of_one_plan_are_told_by_its_name(folder: Path) -> None:
    (folder / "plan_other_snap.csv").write_text(FILES["plan_two_words_snap.csv"])
    with pytest.raises(InputError, match="files of several plans; say which plan"):
        read_published_plan(folder)
    assert set(read_published_plan(folder, "two_words").bodies) == {"snap", "crackle", "pop"}
    with pytest.raises(InputError, match="plan_three_<body>"):
        read_published_plan(folder, "three")
    with pytest.raises(InputError, match="curve 1 names 'snap'; choices: none, words_crackle"):
        read_published_plan(folder, "two")


def test_names_of_bodies_may_hold_underscores(tmp_path: Path) -> None:
    for name, text in FILES.items():
        file = name.replace("two_words_snap", "x_robot_1").replace("two_words", "x")
        (tmp_path / file).write_text(text.replace("snap", "robot_1"))
    assert set(read_published_plan(tmp_path).bodies) == {"robot_1", "crackle", "pop"}


SNAP, POP, BOXES = "plan_two_words_snap.csv", "plan_two_words_pop.csv", "zonotopes_two_words_pop.csv"
SPOILED = {
    "line 2: '0.5e' is not a finite number": (SNAP, "0,0.5,1\n", "0,0.5e,1\n"),
    "line 2: 'nan'": (SNAP, "0,0.5,1\n", "0,nan,1\n"),
    "line 2: \"__import__('os')\" is not a finite number": (SNAP, "0,0.5,1\n", "0,__import__('os'),1\n"),
    "line 2: '1_0'": (SNAP, "0,0.5,1\n", "0,1_0,1\n"),
    "line 3: 2 numbers, expected 3": (SNAP, "0,0.5,1\n0,0,0\n", "0,0.5,1\n0,0\n"),
    "line 1: 'rvar' is in no block; choices: rvars, hvars, ids, other_names": (SNAP, "rvars", "rvar"),
    "block ids comes a second time": (SNAP, "ids\n", "ids\npre\nids\n"),
    "block hvars is missing or empty": (SNAP, "hvars\n0,0.5,2\n\n2,3.5,4", ""),
    "rvars has 6 rows for 1 curves": (SNAP, "0,0.5,2\n\n2,3.5,4", "0,0.5,2"),
    "rvars (2, 2, 3), hvars (2, 3) do not fit": (POP, "0,2\n\n2,4", "0,1,2\n\n2,3,4"),
    "1 ids and 2 other_names for 2 curves": (SNAP, "pre\n\npost", "pre"),
    "ids: curve 1 is 'pr'; did you mean 'pre'?": (SNAP, "pre\n", "pr\n"),
    "id 'pre' and other name 'none'": (SNAP, "pop\n\npop", "none\n\npop"),
    "hvars: curve 1 does not increase": (SNAP, "0,0.5,2", "0,3,2"),
    "hvars: curve 2 starts at [2.5]": (SNAP, "2,3.5,4", "2.5,3.5,4"),
    "rvars: curve 2 starts at [1.1, 0.0]": (SNAP, "1,0.5,0", "1.1,0.5,0"),
    "no file of 'snip', which other_names mention": (POP, "snap\n", "snip\n"),
    "spans [0.0, 4.5] s, expected": (SNAP, "2,3.5,4", "2,3.5,4.5"),
    "X0s has shape (2, 4), expected (4, 4)": (BOXES, "\n1,0,0.5,0\n0,0,0.1,0.2\n", ""),
    "half widths must not be negative": (BOXES, "0,0,0.1,0.2", "0,0,-0.1,0.2"),
}


@pytest.mark.parametrize("message", SPOILED)
def test_what_is_malformed_is_one_line_that_names_it(folder: Path, message: str) -> None:
    name, old, new = SPOILED[message]
    assert old in FILES[name]
    (folder / name).write_text(FILES[name].replace(old, new, 1))
    with pytest.raises(InputError) as error:
        read_published_plan(folder)
    assert message in str(error.value)
    assert str(folder) in str(error.value)
    assert "\n" not in str(error.value)


MISMATCHED = {
    "snap has no impact with pop then": (
        SNAP,
        "pre\n\npost\n\nother_names\npop\n\npop",
        "none\n\nnone\n\nother_names\nnone\n\nnone",
    ),
    "robots are labelled with 1 impacts, objects with 0": (POP, "pre\n\npost", "none\n\nnone"),
    "choices: crackle, snap": (POP, "snap\n", "pop\n"),
}


@pytest.mark.parametrize("message", MISMATCHED)
def test_labels_of_both_bodies_must_agree(folder: Path, message: str) -> None:
    name, old, new = MISMATCHED[message]
    text = FILES[name].replace(old, new, 1)
    if "none\n\nnone" in new and name == POP:
        text = text.replace("snap\n\nnone", "none\n\nnone")
    (folder / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_impacts(read_published_plan(folder))


def test_unreadable_files_are_named(folder: Path) -> None:
    with pytest.raises(InputError, match="no file plan_<body>"):
        read_published_plan(folder / "nowhere")
    (folder / SNAP).write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match=f"{SNAP}: cannot be read"):
        read_published_plan(folder)


def test_bodies_go_on_where_the_scenario_lasts_longer(folder: Path) -> None:
    plan = convert_published_plan(read_published_plan(folder), _scenario("throw_and_catch", 6, "pop in goal"))
    assert plan.horizon == 6.0
    assert plan.objects["pop"].position(6.0) == pytest.approx([3.0, 0.0])
    assert np.allclose(plan.tubes["pop"].end[-1], [[3, 0, 0.5, 0], [0.4, 0.8, 0.1, 0.2]])


def test_plans_of_other_bodies_or_longer_ones_are_refused(folder: Path) -> None:
    published = read_published_plan(folder)
    with pytest.raises(InputError, match="the plan lasts 4 s, scenario throw_and_catch only 3 s"):
        convert_published_plan(published, _scenario("throw_and_catch", 3, "pop in goal"))
    fewer = PublishedPlan({name: published.bodies[name] for name in ("snap", "pop")})
    with pytest.raises(InputError, match="'crackle' is a robot of scenario throw_and_catch only"):
        convert_published_plan(fewer, _scenario("throw_and_catch", 4, "pop in goal"))


@pytest.fixture
def plan() -> Plan:
    """Two robots play an object: both hit it, snap twice running."""
    rng = np.random.default_rng(5)
    path = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 1.0], [2.0, 0.5], [2.0, 3.0]])
    times, hitters = np.array([0.0, 1.0, 2.5, 3.0, 5.0]), ("snap", "snap", "crackle")
    pop = Curve(times, np.stack([path[:-1], path[1:]], axis=1))
    robots = {}
    for name in ("snap", "crackle"):
        own = [0.0, *(t for t, who in zip(times[1:-1], hitters, strict=True) if who == name), 5.0]
        knots = np.array([pop.position(t) - [0.4, 0.0] if 0 < t < 5 else rng.normal(size=2) for t in own])
        share = np.linspace(0.0, 1.0, 6)[:, None]
        points = np.array(
            [a + share * (b - a) + share * (1 - share) * rng.normal(size=2) for a, b in itertools.pairwise(knots)]
        )
        robots[name] = Curve(own, points)
    impacts = tuple(
        PlannedImpact(
            time=t,
            robot=name,
            object="pop",
            position=pop.position(t),
            contact=pop.position(t) - [0.4, 0.0],
            normal=[1.0, 0.0],
            robot_minus=robots[name].velocity(t, "left"),
            robot_plus=robots[name].velocity(t),
            object_minus=pop.velocity(t, "left"),
            object_plus=pop.velocity(t),
        )
        for t, name in zip(times[1:-1], hitters, strict=True)
    )
    # The tube has a breakpoint where the object has none, and none where the object flies on at 2.5 s.
    start = np.array([[[0, 0, 0, 0], [0, 0, 0, 0]], [[0, 0, 1, 1], [0, 0, 0.1, 0.2]]], dtype=float)
    end = start.copy()
    end[1, :, :2] += 4.0 * start[1, :, 2:]
    return Plan(
        "test", "impact_uncertainty", 5.0, 0.5, 1.0, 0.5, 1.0, None, impacts, robots, {"pop": pop}, 0.1, {}, False,
        deviation=0.1, tubes={"pop": Tube([0.0, 1.0, 5.0], start, end)},
    )  # fmt: skip


def test_plans_of_ours_survive_the_published_format(plan: Plan, tmp_path: Path) -> None:
    write_published_plan(plan, tmp_path / "new", "ours")
    published = read_published_plan(tmp_path / "new")
    assert published.bodies["pop"].ids == ("pre", "pre", "pre", "post")
    assert published.bodies["pop"].other_names == ("snap", "snap", "crackle", "crackle")
    assert published.bodies["snap"].ids == ("pre", "pre", "post")
    back = convert_published_plan(published, _scenario("throw_and_catch", 5, "pop in goal"))
    for name, curve in (plan.robots | plan.objects).items():
        found = (back.robots | back.objects)[name]
        assert found.times.tolist() == curve.times.tolist()
        assert np.allclose(found.points, curve.points, atol=1e-12)
    for hit, planned in zip(back.impacts, plan.impacts, strict=True):
        assert (hit.time, hit.robot, hit.object) == (planned.time, planned.robot, planned.object)
        for name in ("position", "contact", "normal", "robot_minus", "robot_plus", "object_minus", "object_plus"):
            assert np.allclose(getattr(hit, name), getattr(planned, name), atol=1e-12), name
    assert back.deviation == plan.deviation


def test_boxes_are_cut_where_curves_are(plan: Plan) -> None:
    tube = make_published_plan(plan).zonotopes["pop"]
    assert tube.times.tolist() == [0.0, 1.0, 2.5, 3.0, 5.0]
    assert tube.start[2, 0].tolist() == pytest.approx([1.5, 1.5, 1, 1])  # 1.5 s after (0, 0) at 1 m/s
    assert tube.start[2, 1].tolist() == pytest.approx([0.15, 0.3, 0.1, 0.2])
    assert np.allclose(tube.start[2:], tube.end[1:-1])
    finer = replace(plan, tubes={"pop": Tube([0.0, 2.0, 5.0], np.zeros((2, 2, 4)), np.zeros((2, 2, 4)))})
    published = make_published_plan(finer)
    assert published.bodies["pop"].times.tolist() == [0.0, 1.0, 2.0, 2.5, 3.0, 5.0]
    assert published.bodies["pop"].ids == ("pre", "post", "pre", "pre", "post")


def test_what_the_format_cannot_hold_is_refused(plan: Plan, tmp_path: Path) -> None:
    late = replace(plan.impacts[0], time=1.1)
    with pytest.raises(InputError, match=r"impact at 1\.1 s: no two curves of snap meet"):
        make_published_plan(replace(plan, impacts=(late, *plan.impacts[1:])))
    bent = {"pop": Curve([0.0, 5.0], np.zeros((1, 3, 2)))}
    with pytest.raises(InputError, match="curve of pop has degree 2"):
        make_published_plan(replace(plan, objects=bent, impacts=()))
    short = {"pop": Tube([0.0, 4.0], np.zeros((1, 2, 4)), np.zeros((1, 2, 4)))}
    with pytest.raises(InputError, match=r"tube of pop spans \[0\.0, 4\.0\] s"):
        make_published_plan(replace(plan, tubes=short))
    with pytest.raises(InputError, match=r"'\.\./x' is no part of a file name"):
        write_published_plan(plan, tmp_path, "../x")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_published_plan(plan, tmp_path / "file", "x")
