"""An object that drifts stays where it has to for as long as it has to: it is thrown up against its drift."""

from __future__ import annotations

import numpy as np
import pytest

from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.plan_table import NO_IMPACT
from planners.free_flyer.belief.world_memory import NO_ROBOT
from planners.free_flyer.next_impact.desired_velocity import compute_margin
from planners.free_flyer.next_impact.stay import choose_stay, find_stay, is_leaving, watch_stays
from tests.planners.free_flyer.plans import K, World, load_open, make_straight_plan, set_estimate

OPTIONS = make_record(EXPERT)[0]
SNAP, POP = 0, 2
CATCH, END, STAY = 60.0, 200.0, 30.0
GOAL = "pop.x >= 2.5 & pop.x <= 3.5 & pop.y >= -0.5 & pop.y <= 0.5"
DRIFT = (4e-4, -8e-4)  # a flight of 140 s it bends by 2 m


def make_world(formula: str = f"F[0,150] G[0,{STAY:g}] ({GOAL})") -> World:
    """Return a world in which pop is thrown from the origin into the middle of its goal, and caught there."""
    scenario = load_open(formula, {"pop": (0.0, 0.0)}, END)
    hits = [(10.0, "snap", "pop", (0.0, 0.0)), (CATCH, "crackle", "pop", (3.0, 0.0))]
    return World(scenario, make_straight_plan(scenario, hits))


def fly(x: float, y: float, velocity: tuple[float, float], times: np.ndarray) -> np.ndarray:
    """Return where a drifting object is, shape (n, 2) [m]."""
    t = times[:, None]
    return np.array((x, y)) + t * (np.array(velocity) + t / 2 * np.array(DRIFT))


def put(world: World, now: float, velocity: tuple[float, float], place: tuple[float, float] = (3.0, 0.0)) -> None:
    """Let pop's flight and drift be known after its last impact, at which it was outside."""
    world.memory.time[K] = now
    set_estimate(world.memory.filter[K, POP, ...], place, velocity, DRIFT)
    world.strike["index"], world.hit["outside_at"] = NO_IMPACT, now


def test_only_a_place_where_it_has_to_stay_is_one() -> None:
    assert find_stay(make_world().table, 0) == 1
    assert find_stay(make_world(f"F[0,150] ({GOAL})").table, 0) == NO_IMPACT


def test_it_is_thrown_so_that_it_stays_long_enough_and_not_to_be_back_at_the_end() -> None:
    world = make_world()
    put(world, CATCH - 5.0, (0.06, 0.0), (2.7, 0.0))
    late = tuple(-np.array(DRIFT) * (END - CATCH) / 2)  # is back at the end, and far outside in between
    times = np.linspace(0.0, STAY, 50)
    x, y = 2.7 + 5.0 * 0.06 + 12.5 * DRIFT[0], 12.5 * DRIFT[1]

    def margin(velocity: tuple[float, float]) -> float:
        return min(compute_margin(world.table, 1, *place) for place in fly(x, y, velocity, times))

    assert margin(late) < 0.0
    chosen = choose_stay(world.table, world.memory, OPTIONS, K, 0, NO_ROBOT, CATCH, END - CATCH, late)
    assert margin(chosen) > 0.3 * 0.5
    assert choose_stay(world.table, world.memory, OPTIONS, K, 0, NO_ROBOT, CATCH, END - CATCH, chosen) == chosen


def test_one_that_will_leave_too_soon_is_told_from_one_that_stays() -> None:
    world = make_world()
    put(world, CATCH, (0.02, 0.0))  # out after 16 s
    assert is_leaving(world.table, world.memory, OPTIONS, K, 0, CATCH)
    put(world, CATCH, (-0.006, 0.016))
    assert not is_leaving(world.table, world.memory, OPTIONS, K, 0, CATCH)


@pytest.mark.parametrize(("outside", "enough"), [(1e9, True), (CATCH + 20.0, False)])
def test_nothing_is_asked_of_it_any_more_once_it_has_stayed(outside: float, enough: bool) -> None:
    world = make_world()
    for now in np.arange(CATCH, CATCH + STAY + 5.0, 0.5):
        away = abs(now - outside) < 1.0
        world.memory.time[K] = now
        set_estimate(world.memory.filter[K, POP, ...], (5.0, 0.0) if away or now == CATCH else (3.0, 0.0), drift=DRIFT)
        watch_stays(world.table, world.memory, OPTIONS, K, now)
    assert bool(world.hit[0]["has_stayed"]) is enough
    world.strike["index"] = NO_IMPACT
    set_estimate(world.memory.filter[K, POP, ...], (3.0, 0.0), (0.1, 0.0), DRIFT)  # out in 5 s
    assert is_leaving(world.table, world.memory, OPTIONS, K, 0, CATCH + STAY + 5.0) is not enough
