"""Plans and scenarios with one thing wrong, by a thousandth or more: each breaks what a certificate confirms."""

import copy
import json
from pathlib import Path

import numpy as np

from impact_envs import load_scenario
from impact_envs.errors import InputError
from planners.plan import Plan

FOLDER = Path(__file__).parents[3] / "frozen" / "plans"
LITTLE = 1e-3
MOVING = 1e-2  # a piece with less speed may be stretched in time and stay right [m/s]
VECTORS = ("robot_minus", "robot_plus", "object_minus", "object_plus")


def list_plans():
    """Return the frozen plans' names."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def read(name):
    """Return a frozen plan as nested tables, and its scenario."""
    suite = "hard_v0" if name.endswith("_hard") else "nominal"
    scenario = load_scenario(name.removesuffix("_hard")).suite(suite)
    return json.loads((FOLDER / f"{name}.json").read_text()), scenario


def move(rng, value):
    """Return a number off by a thousandth of itself, or of 0.1 where it is small."""
    return value + rng.choice([-1, 1]) * LITTLE * max(abs(value), 0.1)


def pick(rng, items):
    return items[rng.integers(len(items))]


def pick_curve(rng, plan):
    return pick(rng, [*plan["robots"].values(), *plan["objects"].values()])


def change_table(rng, plan, scenario, names=VECTORS):
    vector = pick(rng, plan["impacts"])[pick(rng, names)]
    axis = rng.integers(2)
    vector[axis] = move(rng, vector[axis])
    return scenario


def change_place(rng, plan, scenario):
    return change_table(rng, plan, scenario, ("position", "contact", "normal"))


def change_impact_time(rng, plan, scenario):
    impact = pick(rng, plan["impacts"])
    impact["time"] = move(rng, impact["time"])
    return scenario


def change_mass(rng, plan, scenario):
    impact = pick(rng, plan["impacts"])
    table = pick(rng, ["robots", "objects"])
    name = impact[table[:-1]]
    mass = getattr(scenario, table)[name].mass
    return scenario.override({f"{table}.{name}.mass": move(rng, mass)})


def change_restitution(rng, plan, scenario):
    return scenario.override({"believed.restitution": move(rng, scenario.believed.restitution)})


def change_radius(rng, plan, scenario):
    name = pick(rng, plan["impacts"])["robot"]
    return scenario.override({f"robots.{name}.radius": scenario.robots[name].radius * (1 - LITTLE)})


def change_start(rng, plan, scenario):
    name = pick(rng, scenario.bodies)
    table = "robots" if name in scenario.robots else "objects"
    x, y = scenario.body(name).start
    return scenario.override({f"{table}.{name}.start": [move(rng, x), y]})


def change_goal(rng, plan, scenario):
    name = pick(rng, list(scenario.robots))
    x, y = scenario.robots[name].goal
    return scenario.override({f"robots.{name}.goal": [x, move(rng, y)]})


def drop_impact(rng, plan, scenario):
    del plan["impacts"][rng.integers(len(plan["impacts"]))]
    return scenario


def repeat_impact(rng, plan, scenario):
    place = rng.integers(len(plan["impacts"]))
    plan["impacts"].insert(place, copy.deepcopy(plan["impacts"][place]))
    return scenario


def swap_hitters(rng, plan, scenario):
    impact = pick(rng, plan["impacts"])
    impact["robot"] = pick(rng, sorted(set(plan["robots"]) - {impact["robot"]}))
    return scenario


def swap_curves(rng, plan, scenario):
    first, second = rng.choice(sorted(plan["robots"]), 2, replace=False)
    robots = plan["robots"]
    robots[first], robots[second] = robots[second], robots[first]
    return scenario


def shift_piece(rng, plan, scenario):
    piece, axis = pick(rng, pick_curve(rng, plan)["points"]), rng.integers(2)
    for point in piece:
        point[axis] += LITTLE
    return scenario


def bend_end(rng, plan, scenario):
    """Move a control point that decides the velocity at an end of a robot's piece."""
    piece = pick(rng, pick(rng, list(plan["robots"].values()))["points"])
    point, axis = piece[pick(rng, [1, -2])], rng.integers(2)
    point[axis] = move(rng, point[axis])
    return scenario


def change_breakpoint(rng, plan, scenario):
    """Stretch a piece that moves at the cost of the next one."""
    planned = Plan.from_json(json.dumps(plan))
    places = [
        (table, name, k)
        for table in ("robots", "objects")
        for name, curve in getattr(planned, table).items()
        for k, time in enumerate(curve.times[1:-1], start=1)
        if np.abs(curve.velocity(time, "left")).max() > MOVING
    ]
    table, name, k = pick(rng, places)
    times = plan[table][name]["times"]
    times[k] += LITTLE * (times[k + 1] - times[k])
    return scenario


def promise_more(rng, plan, scenario):
    plan["robustness"] += LITTLE
    return scenario


def lower_limit(rng, plan, scenario, key, measure):
    name = pick(rng, list(scenario.robots))
    curve = Plan.from_json(json.dumps(plan)).robots[name]
    most = measure(scenario.robots[name], curve, np.linspace(0.0, plan["horizon"], 20001))
    return scenario.override({f"robots.{name}.{key}": most * (1 - LITTLE)})


def lower_speed(rng, plan, scenario):
    return lower_limit(
        rng, plan, scenario, "speed_limit", lambda robot, curve, times: np.abs(curve.velocity(times)).max()
    )


def lower_force(rng, plan, scenario):
    return lower_limit(
        rng,
        plan,
        scenario,
        "force_limit",
        lambda robot, curve, times: robot.mass * np.linalg.norm(curve.acceleration(times), axis=1).max(),
    )


def place_obstacle(rng, plan, scenario):
    """Put a small solid box on a body's way."""
    planned = Plan.from_json(json.dumps(plan))
    curves = list((planned.robots | planned.objects).values())
    for _ in range(1000):
        x, y = pick(rng, curves).position(rng.uniform(0.0, plan["horizon"]))
        box = {"lower": [x, y], "upper": [x + 0.01, y + 0.01], "solid": True}
        try:
            return scenario.override({"obstacles.rock": box})
        except InputError:  # a body starts or ends there
            continue
    raise AssertionError("no place for an obstacle")


KINDS = (
    change_table, change_place, change_impact_time, change_mass, change_restitution, change_radius, change_start,
    change_goal, drop_impact, repeat_impact, swap_hitters, swap_curves, shift_piece, bend_end, change_breakpoint,
    promise_more, lower_speed, lower_force, place_obstacle,
)  # fmt: skip


def make_mutants(names, count, seed):
    """Yield so many mutants: what was done, the plan's text and the scenario; kinds and plans take turns."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        name, kind = names[number // len(KINDS) % len(names)], KINDS[number % len(KINDS)]
        plan, scenario = read(name)
        scenario = kind(rng, plan, scenario)
        yield f"{kind.__name__} of {name}", json.dumps(plan), scenario
