"""What is told to be impossible is; what a plan does is never told to be."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from benchmarks.tasks import draw_tasks
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from impact_envs.scenario import build_scenario, list_scenarios, load_scenario
from planners.free_flyer.frame import find_frame
from planners.free_flyer.impossibility.reach import Kept, Reach
from planners.free_flyer.impossibility.reason import find_impossibility
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.validation import compute_robustness
from planners.plan import Plan
from tests.frozen.freeze import get_plan
from tests.planners.free_flyer.plans import load

BODY = {"mass": 16.8, "inertia": 0.336, "radius": 0.2, "speed_limit": 0.3}
ROBOT = BODY | {"force_limit": 1.5, "torque_limit": 0.5}
LEAST = Reserves().halved().halved()


def make_task(formula: str, horizon: float = 100.0, **tables: Any) -> FreeFlyerScenario:
    """Return ann at (1, 2) and a ball at (2, 2) in a world of 6 m x 4 m, with places A and B and a dock."""
    data: dict[str, Any] = {
        "domain": "free_flyer",
        "name": "task",
        "formula": formula,
        "horizon": horizon,
        "control_period": 0.1,
        "world": {"lower": [0.0, 0.0], "upper": [6.0, 4.0]},
        "robots": {"ann": ROBOT | {"start": [1.0, 2.0]}},
        "objects": {"ball": BODY | {"start": [2.0, 2.0]}},
        "regions": {
            "dock": {"lower": [4.5, 1.5], "upper": [5.5, 2.5]},
            "A": {"lower": [0.5, 0.5], "upper": [1.5, 1.5]},
            "B": {"lower": [4.5, 2.5], "upper": [5.5, 3.5]},
            "hole": {"lower": [3.0, 1.0], "upper": [3.25, 1.25]},
            "far": {"lower": [7.0, 1.0], "upper": [8.0, 2.0]},
        },
        "believed": {"restitution": 0.8},
    }
    return FreeFlyerScenario(**data | tables)


def explain(scenario: FreeFlyerScenario, max_impacts: int = 6, kept: Kept = Kept()) -> str | None:  # noqa: B008 - frozen
    found = find_impossibility(scenario, read_demands(scenario, 0.05), max_impacts, kept)
    return None if found is None else found.reason


WALL = {"wall": {"lower": [3.0, 0.0], "upper": [3.4, 4.0], "solid": True}}
CAGE = {
    "left": {"lower": [1.4, 1.0], "upper": [1.5, 3.0], "solid": True},
    "right": {"lower": [2.5, 1.0], "upper": [2.6, 3.0], "solid": True},
    "low": {"lower": [1.4, 1.0], "upper": [2.6, 1.1], "solid": True},
    "high": {"lower": [1.4, 2.9], "upper": [2.6, 3.0], "solid": True},
}
GAP = {
    "low": {"lower": [3.0, 0.0], "upper": [3.4, 1.81], "solid": True},
    "high": {"lower": [3.0, 2.19], "upper": [3.4, 4.0], "solid": True},
}
LOW = {"ann": ROBOT | {"start": [1.0, 1.0]}}
SMALL = {"ball": BODY | {"start": [2.0, 2.0], "radius": 0.1}}
BOB = {"ann": ROBOT | {"start": [1.0, 2.0]}, "bob": ROBOT | {"start": [1.0, 3.0], "goal": [5.0, 3.0]}}


@pytest.mark.parametrize(
    ("formula", "tables", "told"),
    [
        ("F[0,10] ball in dock", {}, "ball is 2.5 m from dock along x and has to be there by 10 s, .* reach 2.04"),
        (
            "F[0,100] ball in dock",
            {"obstacles": WALL},
            "ball from its start to be in dock: it is closed by wall, it needs",
        ),
        ("F[0,100] ball in dock", {"obstacles": GAP}, "closed by low and high, the widest gap is 0.38 m, it needs 0.4"),
        ("F[0,100] ball in dock", {"obstacles": CAGE}, "no way for ball from its start"),
        (
            "G[100,100] ball in dock",
            {"obstacles": GAP, "objects": SMALL},
            "ball has to rest in dock at 100 s, but no robot can come up to it there to stop it",
        ),
        ("F[0,100] ball in far", {}, "in far by 100 s, but that place lies outside of the world"),
        ("F[0,100] ball in dock & G[0,100] ball not in dock", {}, "but not in dock from 0 to 100 s: dock covers"),
        (
            "G[50,60] ann in A & F[55,58] ann in B",
            {},
            "ann has to be in B between 55 and 58 s and in A from 50 to 60 s",
        ),
        (
            "F[0,50] (ball in A & ball in B)",
            {},
            "ball has to be in B by 50 s and in A at the same time: no place is both",
        ),
        ("G[50,50] ball in A & G[55,55] ball in B", {}, r"3 m apart, at most 0\.3 m/s need 10 s, and 5 s are left"),
        ("F[0,90] (ball in A & F[0,8] ball in B)", {}, "need 10 s, and 8 s are left"),
        ("G[40,80] (F[0,9] ball in A & F[0,9] ball in B)", {}, "need 10 s, and 9 s are left"),
        ("G[40,99] (F[0,1] ann in A & F[0,1] ann in dock)", {}, r"ann has to be|and 1 s are left"),
        (
            "G[30,80] F[0,15] ball in A & G[30,80] F[0,19] ball in B",
            {},
            "in A every 15 s .*to and fro takes 20 s at 0.3",
        ),
        ("F[0,100] ball in dock & G[0,100] ann in A", {"robots": LOW}, "no robot can reach ball to hit it"),
        ("G[0,0] ball in dock", {}, "ball has to be in dock at 0 s, but starts 2.5 m from it"),
        ("F[0,60] (ann in hole & ball in hole)", {}, r"0\.4 m apart at least, those places 0\.354 m at most"),
        ("F[0,60] distance(ann, ball) <= 0.3", {}, "asks for less than the 0.4 m between centres when they touch"),
        ("F[0,60] (ann in A & ball in dock & distance(ann, ball) <= 1)", {}, "those places are farther apart"),
        ("G[0,99] bob in A", {"robots": BOB}, "bob has to be in A at 0 s, but starts 1.5 m from it"),
        ("F[99,99] bob in A", {"robots": BOB}, "at its goal at 100 s.* 1 s are left|and 1 s are left"),
        ("(ball not in dock) U[0,20] ball in far", {}, "far by 20 s"),
        ("F[0,9] ball in dock | F[0,8] ball in B", {}, "by 9 s.* or, otherwise, .* by 8 s"),
    ],
)
def test_what_is_impossible_is_told_with_names_and_numbers(formula: str, tables: dict[str, Any], told: str) -> None:
    assert re.search(told, str(explain(make_task(formula, **tables))))


def test_a_ball_that_no_robot_can_touch_stays() -> None:
    """The ball may leave through the window of the cage, but ann does not come in."""
    fat = {"ann": ROBOT | {"start": [0.7, 2.0], "radius": 0.6}}
    window = CAGE | {"right": {"lower": [2.5, 1.0], "upper": [2.6, 1.7], "solid": True}}
    window["upper_right"] = {"lower": [2.5, 2.3], "upper": [2.6, 3.0], "solid": True}
    window["shield"] = {"lower": [2.9, 1.0], "upper": [3.0, 3.0], "solid": True}
    found = explain(make_task("F[0,100] ball in A", obstacles=window, robots=fat))
    assert found is not None
    assert "no way" in found or "no robot can reach ball" in found


def test_a_light_robot_gives_a_heavy_object_little_speed_in_so_many_impacts() -> None:
    """0.2 kg against 60 kg: 0.7 % of the robot's 0.3 m/s, hitting aside, each time."""
    light = {"ann": ROBOT | {"start": [1.0, 2.0], "mass": 0.2}}
    heavy = {"ball": BODY | {"start": [2.0, 2.0], "mass": 60.0}}
    found = explain(make_task("F[0,100] ball in dock", robots=light, objects=heavy))
    assert re.search(r"at most 0\.013 m/s, all that 6 impacts of the robots can give it, reach", str(found)), found
    assert explain(make_task("F[0,100] ball in dock", robots=light, objects=heavy), 60) is None


def test_impacts_that_are_needed_are_counted() -> None:
    task = make_task("F[0,100] ball in dock")
    assert explain(task, 2) is None
    assert explain(task, 1) == "ball needs 2, to leave its start and to rest again, but 1 impact is allowed"
    free = make_task("F[0,100] ball in dock", objects={"ball": BODY | {"start": [2.0, 2.0], "rest": False}})
    assert explain(free, 1) is None


def test_what_reserves_leave_no_room_for_is_possible_without_them() -> None:
    gap = {name: dict(table) for name, table in GAP.items()}
    gap["low"]["upper"], gap["high"]["lower"] = [3.4, 1.79], [3.0, 2.21]
    task = make_task("F[0,100] ball in dock", obstacles=gap)
    assert explain(task) is None
    assert "the widest gap is 0.42 m, it needs 0.5 m" in str(explain(task, kept=Kept(wall=0.05)))


def test_the_time_that_is_told_to_be_needed_is() -> None:
    """2.5 m at 0.3 m/s, once ann has come up 0.6 m from rest with both axes, at sqrt(2) 1.5 / 16.8 m/s^2."""
    late = 0.6 / 0.3 + 0.3 / (2.0 * np.sqrt(2.0) * 1.5 / 16.8) + 2.5 / 0.3
    sample = np.ceil(late / 0.1) * 0.1
    assert explain(make_task(f"F[0,{sample:.1f}] ball in dock")) is None
    assert explain(make_task(f"F[0,{sample - 0.1:.1f}] ball in dock")) is not None


def test_an_object_hit_aside_is_faster_along_an_axis_than_one_hit_along_it() -> None:
    """A robot at (w, w) that hits at 22.5 degrees gives w m3 (1 + sqrt(2)) / 2 along x, 21 % more than at 0."""
    light = {"ann": ROBOT | {"start": [1.0, 2.0], "mass": 2.0}}
    task = make_task("F[0,100] ball in dock", robots=light)
    _, _, m3, _ = compute_mass_fractions(2.0, 16.8, 0.8)
    normal = np.array([np.cos(np.pi / 8.0), np.sin(np.pi / 8.0)])
    given = m3 * (np.array([0.3, 0.3]) @ normal) * normal
    reach = Reach(task, read_demands(task, 0.05), Kept(), 1, {})
    assert reach.speed("ball") == pytest.approx(given[0])
    assert given[0] > 1.2 * m3 * 0.3


def test_a_long_object_passes_a_gap_of_more_than_its_width() -> None:
    """0.8 m x 0.2 m: the disc around it needs 0.82 m, it flies through 0.38 m along its long side."""
    long = {"vertices": [[0.4, 0.1], [-0.4, 0.1], [-0.4, -0.1], [0.4, -0.1]], "start": [2.0, 2.0]}
    ball = BODY | long | {"radius": 0.4125}
    assert explain(make_task("F[0,100] ball in dock", objects={"ball": ball}, obstacles=GAP)) is None
    near = make_task("F[0,100] distance(ann, ball) <= 0.35", objects={"ball": ball})
    assert explain(near) is None


def test_areas_are_avoided_at_samples_and_may_be_crossed_between_them() -> None:
    """At 0.3 m/s and ten samples a second a body comes 0.03 m from one to the next."""
    for thick, told in ((0.02, False), (0.1, True)):
        wall = {"wall": {"lower": [3.0, 0.0], "upper": [3.0 + thick, 4.0]}}
        task = make_task("F[0,100] ball in dock & G[0,100] ball not in wall", obstacles=wall)
        assert (explain(task) is not None) == told


def test_windows_are_what_their_samples_are() -> None:
    """[9.55, 10.45] with a sample a second is 10 s, [10.55, 11.45] is 11 s: that is time enough."""
    formula = "G[9.55,10.45] ball in A & G[10.55,11.45] ball in B"
    near = {"A": {"lower": [1.5, 1.5], "upper": [2.2, 2.5]}, "B": {"lower": [2.3, 1.5], "upper": [3.0, 2.5]}}
    slow = make_task(formula, regions=near, control_period=1.0)
    assert explain(slow) is None
    assert explain(make_task(formula, regions=near)) is not None


# What plans do is possible


def _draw_box(rng: np.random.Generator, place: np.ndarray) -> dict[str, list[float]]:
    near = rng.uniform(1e-3, 0.6, 4)
    return {"lower": (place - near[:2]).tolist(), "upper": (place + near[2:]).tolist()}


def _hold(track: np.ndarray) -> dict[str, list[float]]:
    return {"lower": (track.min(axis=0) - 1e-3).tolist(), "upper": (track.max(axis=0) + 1e-3).tolist()}


class _Writer:
    """Write formulas that a plan keeps."""

    def __init__(self, scenario: FreeFlyerScenario, plan: Plan, seed: int) -> None:
        self.scenario, self.rng = scenario, np.random.default_rng(seed)
        count = round(scenario.horizon / scenario.control_period)
        self.times = scenario.control_period * np.arange(count + 1)
        curves = plan.robots | plan.objects
        self.tracks = {name: curve.position(np.minimum(self.times, plan.horizon)) for name, curve in curves.items()}
        self.regions: dict[str, Any] = {}

    def add(self, box: dict[str, list[float]]) -> str:
        self.regions[f"p{len(self.regions)}"] = box
        return f"p{len(self.regions) - 1}"

    def draw_step(self, first: int = 0) -> int:
        return int(self.rng.integers(first, len(self.times)))

    def avoid(self, track: np.ndarray, gap: float) -> dict[str, list[float]] | None:
        """Return a box that a track keeps a distance from."""
        lower, upper = np.array(self.scenario.world.lower), np.array(self.scenario.world.upper)
        for _ in range(50):
            middle, half = self.rng.uniform(lower, upper), self.rng.uniform(0.05, 1.5, 2)
            if (np.abs(track - middle) - half).max(axis=1).min() > gap:
                return {"lower": (middle - half).tolist(), "upper": (middle + half).tolist()}
        return None

    def write(self) -> str:
        rng, body = self.rng, str(self.rng.choice(list(self.tracks)))
        track, k = self.tracks[body], self.draw_step()
        time, slack = self.times[k], round(float(rng.uniform(0.0, 1.0)), 1)
        end = min(time + slack, self.scenario.horizon)
        here = f"{body} in {self.add(_draw_box(rng, track[k]))}"
        late = self.draw_step(k)
        kind = rng.integers(8)
        if kind == 0:
            return f"F[{max(0.0, time - slack):.1f},{end:.1f}] {here}"
        if kind == 1:
            return f"G[{time:.1f},{self.times[late]:.1f}] {body} in {self.add(_hold(track[k : late + 1]))}"
        if kind == 2:
            then = f"{body} in {self.add(_draw_box(rng, track[late]))}"
            return f"F[0,{time:.1f}] ({here} & F[0,{self.times[late] - time:.1f}] {then})"
        if kind == 3:
            other = str(rng.choice(list(self.tracks)))
            distance = float(np.linalg.norm(track[k] - self.tracks[other][k])) + 1e-3
            there = f"{other} in {self.add(_draw_box(rng, self.tracks[other][k]))}"
            near = "" if other == body else f" & distance({body}, {other}) <= {distance:.4f}"
            return f"F[0,{end:.1f}] ({here} & {there}{near})"
        if kind == 4 and (box := self.avoid(track[: k + 1], 1e-3)) is not None:
            return f"({body} not in {self.add(box)}) U[0,{time:.1f}] {here}"
        if kind == 5 and (box := self.avoid(track, 1e-3)) is not None:
            return f"G[0,{self.times[-1]:.1f}] {body} not in {self.add(box)}"
        if kind == 6:
            junk = f"{body} in {self.add(_draw_box(rng, rng.uniform(-9.0, 9.0, 2)))}"
            return f"(G[{time:.1f},{time:.1f}] {here} | F[0,1] {junk})"
        return f"G[{time:.1f},{time:.1f}] ({here} & F[0,{self.times[late] - time:.1f}] {body}.x <= 99)"


@pytest.mark.parametrize("name", [name for name in list_scenarios() if load_scenario(name).domain == "free_flyer"])
def test_no_shipped_task_is_refused(name: str) -> None:
    for suite in ("nominal", "short", "hard"):
        task = load_scenario(name).suite(suite)
        assert isinstance(task, FreeFlyerScenario)
        for kept in (Kept(), Kept(LEAST.wall, LEAST.times(task.horizon)[0])):
            assert explain(task, 3 + 3 * len(task.objects), kept) is None


@pytest.mark.parametrize("name", ["throw_and_catch", "pong", "pingpong", "relay", "exchange", "obstacle_avoidance"])
def test_what_a_plan_does_is_never_refused(name: str) -> None:
    plan, asked = get_plan(name, "nominal"), load(name)
    assert plan is not None
    for seed in range(12):
        writer = _Writer(asked, plan, seed)
        formula = " & ".join(writer.write() for _ in range(1 + seed % 4))
        obstacles = {key: table.model_dump() for key, table in asked.obstacles.items()}
        every = np.concatenate(list(writer.tracks.values()))
        box = writer.avoid(every, max(asked.body(one).radius for one in asked.bodies) + LEAST.wall)
        if box is not None:
            obstacles["added"] = box | {"solid": True}
        fields = {field: getattr(asked, field) for field in FreeFlyerScenario.model_fields}
        task = FreeFlyerScenario(**fields | {"formula": formula, "regions": writer.regions, "obstacles": obstacles})
        assert compute_robustness(task, writer.times, writer.tracks) >= 0.0, (seed, formula)
        for kept in (Kept(), Kept(LEAST.wall, LEAST.times(task.horizon)[0])):
            assert explain(task, len(plan.impacts), kept) is None, (seed, formula)


def test_of_random_tasks_only_the_one_whose_goal_lies_in_an_obstacle_is_refused() -> None:
    """Of the first 60 tuning tasks, 59 are planned or undecided in minutes; this one is proven by the models, too."""
    refused = {}
    for seed, _, data in draw_tasks(60, 1_000_000):
        task = build_scenario(data, source=data["name"])
        assert isinstance(task, FreeFlyerScenario)
        kept = Kept(LEAST.wall * find_frame(task).length, LEAST.times(task.horizon)[0])
        found = explain(task, 3 + 3 * len(task.objects), kept)
        if found is not None:
            refused[seed] = found
    assert list(refused) == [1_000_014]
    assert "r3 has to be in zone by 150 s, but that place lies in the solid obstacle wall2" in refused[1_000_014]


def test_what_need_not_rest_where_no_robot_comes_is_not_told_to_be_impossible() -> None:
    tables = {"obstacles": GAP, "objects": SMALL}
    assert explain(make_task("F[0,100] ball in dock", **tables)) is None
    roll = {"ball": SMALL["ball"] | {"rest": False}}
    assert explain(make_task("G[100,100] ball in dock", obstacles=GAP, objects=roll)) is None
    near = {"dock": {"lower": [3.0, 1.5], "upper": [4.0, 2.5]}}  # ann reaches 0.3 m beyond her last place
    assert explain(make_task("G[100,100] ball in dock", regions=near, **tables)) is None
