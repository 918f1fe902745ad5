"""What is left of a plan is optimised anew: the nearest times and places at which formula, flights and robots agree."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import clarabel
import numpy as np
import pytest
from scipy import sparse

from planners.cones import solve_clarabel
from planners.errors import Infeasible
from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.plan_table import NO_IMPACT
from planners.free_flyer.closed_loop.world_loop import look_ahead
from planners.free_flyer.next_impact.reoptimisation import (
    reoptimise_rest,
)
from planners.free_flyer.next_impact.rest_qp import MOST_KNOTS
from tests.planners.free_flyer.plans import Hit, K, World, load_open, make_straight_plan

OPTIONS = make_record(EXPERT)[0]
SCALES = EXPERT.reoptimisation

HORIZON, HIT, NOW = 100.0, 10.0, 10.0 + EXPERT.timing.settle
SNAP, CRACKLE, POP = range(3)
C = 1  # the thread that plays, of three
THRUST = 0.75 * 1.5 / 16.8  # three quarters of the robots' force over their mass [m/s^2]
REACH = 0.4  # from a robot's centre to that of the object it hits [m]
FASTEST = SCALES.share * 0.5  # [m/s]
ONLY = replace(EXPERT, retime=False, insert=False)
BAND = "G[0,100] (pop.y <= 0.5 & pop.y >= -0.5)"
SLALOM = (
    "F[27,33] (pop.x >= 2 & pop.x <= 4 & pop.y >= 0.5 & pop.y <= 2) & F[52,62] (pop.x <= 2 & pop.y <= -0.5)"
    " & F[70,84] pop.y >= 1 & G[100,100] (pop.x >= 0.5 & pop.x <= 3 & pop.y <= 2)"
)
LINE: tuple[Hit, ...] = (
    (HIT, "snap", "pop", (1.0, 0.0)),
    (30.0, "crackle", "pop", (3.0, 0.0)),
    (60.0, "snap", "pop", (1.5, 0.0)),
)
ZIGZAG: tuple[Hit, ...] = (
    (HIT, "snap", "pop", (1.0, 0.0)),
    (30.0, "crackle", "pop", (3.0, 1.0)),
    (57.0, "snap", "pop", (1.5, -1.0)),
    (78.0, "crackle", "pop", (2.5, 1.5)),
)
SHARED: tuple[Hit, ...] = (*ZIGZAG, (44.0, "crackle", "fizz", (4.0, 0.0)), (68.0, "snap", "fizz", (4.0, -2.0)))
CASES = {"line": (BAND, LINE), "zigzag": (SLALOM, ZIGZAG), "shared": (SLALOM, SHARED)}


class Loop(World):
    """World 1 of three, after pop's first impact; robots stand at hand, pop flies as it is told to."""

    def __init__(self, formula: str, hits: tuple[Hit, ...], side: float = 1.0) -> None:
        starts = {name: next(place for _, _, hit, place in hits if hit == name) for name in {h[2] for h in hits}}
        objects = {name: (x, side * y) for name, (x, y) in sorted(starts.items())[::-1]}
        scenario, self.side = load_open(formula, objects, HORIZON), side
        super().__init__(scenario, make_straight_plan(scenario, hits, side), ONLY)
        self.clock = self.memory.clock[K]
        self.memory.time[K] = HIT
        self.contact(SNAP, POP, HIT)
        self.memory.time[K] = NOW
        self.see(SNAP, (2.0, -1.5))
        self.see(CRACKLE, (2.5, 1.8))

    def see(self, body: int, position: Sequence[float], velocity: Sequence[float] = (0.0, 0.0)) -> None:
        """Let a body's estimate be exact, mirrored as the world is."""
        flip = [1.0, self.side]
        super().see(body, np.multiply(position, flip), np.multiply(velocity, flip))

    def fly(self, vx: float, vy: float = 0.0) -> None:
        """Let pop fly with a velocity since its impact."""
        self.see(POP, (1.0 + vx * (NOW - HIT), vy * (NOW - HIT)), (vx, vy))

    def optimise(self) -> bool:
        return bool(reoptimise_rest(self.table, self.memory, OPTIONS, self.qp, C, K, 0, NOW))

    def chain(self) -> list[int]:
        """Return pop's knots that are left, the end included."""
        found, at = [], int(self.strike[0]["index"])
        while at != NO_IMPACT:
            found.append(at)
            at = int(self.table.impact[at]["next"])
        return [*found, len(self.table.impact)]


def disturb(loop: Loop, seed: int) -> None:
    """Let pop's first throw go wrong, and robots stand somewhere else."""
    rng = np.random.default_rng(seed)
    first = loop.table.knot[loop.chain()[0]]["position"]
    right = (first - [1.0, 0.0]) / (loop.table.impact[loop.chain()[0]]["time"] - HIT) * [1.0, loop.side]
    fx, fy = rng.uniform(0.75, 1.3) * right + rng.uniform(-0.02, 0.02, 2)
    loop.fly(fx, fy)
    for robot, x, y in ((SNAP, 2.0, -1.5), (CRACKLE, 2.5, 1.8)):
        dx, dy = rng.uniform(-0.7, 0.7, 2)
        loop.see(robot, (x + dx, y + dy))


class Problem(NamedTuple):
    """min |J y - r|^2 with A y <= b over y = (t_1..t_m, P_2..P_{m+1}, rho)."""

    J: np.ndarray
    r: np.ndarray
    A: np.ndarray
    b: np.ndarray


def make_problem(loop: Loop) -> Problem:
    """Build what `reoptimise` solves from its description: times in s, places in m, by plain linear maps."""
    table, chain = loop.table, loop.chain()
    m = len(chain) - 1
    size = 3 * m + 1
    unit = np.eye(size)
    x, v = read_flight(loop)
    # An expression is a pair (row over y, constant).
    times = [(unit[i], 0.0) for i in range(m)] + [(np.zeros(size), HORIZON)]
    places = [[(v[a] * unit[0], x[a] - v[a] * NOW) for a in range(2)]]
    places += [[(unit[m + 2 * i + a], 0.0) for a in range(2)] for i in range(m)]
    rho = unit[-1]
    rows: list[tuple[np.ndarray, float]] = []

    def at_most(row: np.ndarray, constant: float, bound: float) -> None:
        rows.append((row, bound - constant))

    residuals = [
        (
            rho / SCALES.scale_rho,
            min([*table.knot[chain]["depth"], np.inf]) / SCALES.scale_rho,
        )
    ]
    if not np.isfinite(residuals[0][1]):
        residuals = [(rho / SCALES.scale_rho, 0.0)]
    for i, knot in enumerate(chain):
        for a in range(2):
            row, constant = places[i][a]
            residuals.append(
                (
                    row / SCALES.scale_place,
                    (table.knot[knot]["position"][a] - constant) / SCALES.scale_place,
                )
            )
        for (hx, hy), bound in table.face[knot, : table.knot[knot]["faces"]]:
            row = hx * places[i][0][0] + hy * places[i][1][0] + rho
            at_most(row, hx * places[i][0][1] + hy * places[i][1][1], bound)
    for i, knot in enumerate(chain[:-1]):
        old, opens, closes = loop.clock[knot], table.knot[knot]["opens"], table.knot[knot]["closes"]
        residuals.append((unit[i] / SCALES.scale_time, old / SCALES.scale_time))
        inset = min(SCALES.inset, (closes - opens) / 4)
        latest = max(HORIZON - max(EXPERT.retiming.reserve, EXPERT.retiming.reserve_share * HORIZON), old)
        at_most(unit[i], 0.0, min(closes - inset, latest))
        soonest = max(opens + inset, min(NOW + SCALES.notice, old)) if i == 0 else opens + inset
        at_most(-unit[i], 0.0, -soonest)
        if i:
            planned = table.impact[knot]["time"] - table.impact[chain[i - 1]]["time"]
            at_most(unit[i - 1] - unit[i], 0.0, -min(SCALES.gap, planned))
    for i in range(m):
        leg = [(places[i + 1][a][0] - places[i][a][0], places[i + 1][a][1] - places[i][a][1]) for a in range(2)]
        span = (times[i + 1][0] - times[i][0], times[i + 1][1] - times[i][1])
        for (row, constant), sign in itertools.product(leg, (1.0, -1.0)):
            at_most(sign * row - FASTEST * span[0], sign * constant - FASTEST * span[1], 0.0)
        wish = table.knot[chain[i + 1]]["position"] - table.knot[chain[i]]["position"]
        if np.hypot(*wish) < SCALES.shortest_leg:
            continue
        for knot, way in ((chain[i], 1.0), (chain[i + 1], -1.0)):
            if knot == chain[-1]:
                continue
            n = table.impact[knot]["normal"]
            side = np.array([-n[1], n[0]])
            if abs(side @ wish) > SCALES.widest * way * (n @ wish):
                continue
            for turn in (1.0, -1.0):
                h = way * (turn * side - SCALES.widest * n)
                at_most(h[0] * leg[0][0] + h[1] * leg[1][0], h[0] * leg[0][1] + h[1] * leg[1][1], 0.0)
    for row, constant, bound in robot_rows(loop, chain, times, places):
        at_most(row, constant, bound)
    return Problem(*(np.array(part, float) for part in (*zip(*residuals, strict=True), *zip(*rows, strict=True))))


def read_flight(loop: Loop) -> tuple[np.ndarray, np.ndarray]:
    """Return pop's position and velocity."""
    z = loop.memory.filter[K, POP]
    return z["position"], z["velocity"]


def compute_span(way: float) -> float:
    """Return how long a robot takes for a way from rest to rest by a quintic [s]."""
    return float(np.sqrt(10.0 / np.sqrt(3.0) * way / THRUST))


def robot_rows(loop: Loop, chain: list[int], times: list, places: list) -> list[tuple[np.ndarray, float, float]]:
    """Return what gives robots time: the tangent of the square root at the way that is expected now."""
    table, found = loop.table, []
    x, v = read_flight(loop)
    expected = {knot: loop.place[knot].copy() for knot in range(len(table.impact))}
    expected[chain[0]] = x + v * (loop.clock[chain[0]] - NOW)
    stand = {i: expected[i] - REACH * table.impact[i]["normal"] for i in expected}

    def give(i: int, since: np.ndarray, other: tuple[np.ndarray, float], sign: float, longest: float) -> None:
        knot = chain[i]
        way = stand[knot] - since
        d = max(np.hypot(*way), SCALES.shortest_way)
        tau = min(compute_span(d), longest)
        slope = tau / (2.0 * d) * way / d if tau < longest else np.zeros(2)
        row = sum(slope[a] * places[i][a][0] for a in range(2)) - sign * (times[i][0] - other[0])
        constant = sum(slope[a] * (places[i][a][1] - expected[knot][a]) for a in range(2)) + tau + sign * other[1]
        found.append((row, constant, 0.0))

    for i, knot in enumerate(chain[:-1]):
        r = int(table.impact[knot]["robot"])
        mine = [j for j in range(i) if table.impact[chain[j]]["robot"] == r]
        if mine:
            j = mine[-1]
            longest = table.impact[knot]["time"] - table.impact[chain[j]]["time"]
            give(i, stand[chain[j]], times[j], 1.0, longest)
        else:
            give(i, loop.memory.filter[K, r]["position"], (np.zeros(len(times[0][0])), NOW), 1.0, np.inf)
        for other in range(len(table.impact)):
            if other not in chain and table.impact[other]["time"] > HIT and table.impact[other]["robot"] == r:
                sign = 1.0 if loop.clock[knot] >= loop.clock[other] else -1.0
                longest = abs(table.impact[knot]["time"] - table.impact[other]["time"])
                give(i, stand[other], (np.zeros(len(times[0][0])), loop.clock[other]), sign, longest)
    return found


def read_point(loop: Loop) -> np.ndarray:
    """Return t_1..t_m and P_2..P_{m+1} as they are expected."""
    chain = loop.chain()
    return np.concatenate([loop.clock[chain[:-1]], loop.place[chain[1:]].ravel()])


def solve(problem: Problem) -> np.ndarray:
    Q = 2.0 * problem.J.T @ problem.J
    q = -2.0 * problem.J.T @ problem.r
    cones = [clarabel.NonnegativeConeT(len(problem.b))]
    upper = sparse.csc_matrix(np.triu(Q))
    return solve_clarabel("reoptimisation", upper, q, sparse.csc_matrix(problem.A), problem.b, cones)


def make_loop(case: str, seed: int | None = None) -> Loop:
    loop = Loop(*CASES[case])
    if seed is None:
        first = loop.chain()[0]
        vx, vy = (loop.table.knot[first]["position"] - [1.0, 0.0]) / (loop.table.impact[first]["time"] - HIT)
        loop.fly(vx, vy)
    else:
        disturb(loop, seed)
    return loop


def check_rows(loop: Loop, problem: Problem) -> np.ndarray:
    """Return rho, after every promised row was seen to hold with it."""
    point = np.append(read_point(loop), 0.0)
    slack = problem.b - problem.A @ point
    demands = problem.A[:, -1] == 1.0
    rho = slack[demands].min(initial=np.inf)
    assert slack[~demands].min() >= -1e-5  # the quintic's 10 / sqrt(3) is rounded
    return rho


WIDE = "F[20,40] pop.x >= 2 & F[50,80] pop.x <= 2 & G[0,100] (pop.y <= 0.5 & pop.y >= -0.5)"


@pytest.mark.parametrize("formula", [BAND, WIDE, "F[0,100] pop.x >= 2"])
def test_plan_on_time_keeps_its_clocks_and_places(formula: str) -> None:
    loop = Loop(formula, LINE)
    loop.fly(0.1 * 20.0 / (loop.clock[1] - HIT))  # an impact before the end of a window may be expected early
    clocks, places = loop.clock.copy(), loop.place.copy()
    if formula == BAND:
        np.testing.assert_array_equal(clocks[:3], [10.0, 30.0, 60.0])
    loop.fly(2.0 / (clocks[1] - HIT))
    assert loop.optimise()
    np.testing.assert_allclose(loop.clock, clocks, atol=1e-6)
    np.testing.assert_allclose(loop.place, places, atol=1e-6)
    assert loop.strike[0]["time"] == loop.clock[1]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_every_promise_is_kept_after_a_wrong_throw(case: str, seed: int) -> None:
    loop = make_loop(case, seed)
    problem, chain, table = make_problem(loop), loop.chain(), loop.table
    before, clocks, places = read_point(loop), loop.clock.copy(), loop.place.copy()
    assert loop.optimise()
    check_rows(loop, problem)
    times = loop.clock[chain[:-1]]
    assert np.abs(read_point(loop) - before).max() > 1e-3
    assert loop.strike[0]["time"] == times[0]
    # The same without the tables of rows: windows, order, reserve, speed.
    assert (times >= table.knot[chain[:-1]]["opens"] - 1e-7).all()
    assert (times <= table.knot[chain[:-1]]["closes"] + 1e-7).all()
    assert (np.diff(times) >= SCALES.gap - 1e-7).all()
    assert times[-1] <= HORIZON - EXPERT.retiming.reserve_share * HORIZON + 1e-7
    x, v = read_flight(loop)
    points = np.vstack([x + v * (times[0] - NOW), loop.place[chain[1:]]])
    speeds = np.abs(np.diff(points, axis=0)) / np.diff([*times, HORIZON])[:, None]
    assert speeds.max() <= FASTEST + 1e-7
    # Neither the first place nor what belongs to other objects was touched.
    others = [i for i in range(len(clocks)) if i not in chain]
    np.testing.assert_array_equal(loop.clock[others], clocks[others])
    others = [i for i in range(len(places)) if i not in chain[1:]]
    np.testing.assert_array_equal(loop.place[others], places[others])


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_margin_is_the_plans_or_what_is_left_of_it(case: str, seed: int) -> None:
    loop = make_loop(case, seed)
    problem, planned = make_problem(loop), loop.table.knot[loop.chain()]["depth"].min()
    assert loop.optimise()
    rho = loop.qp.centre[C, len(problem.J[0]) - 1] + SCALES.scale_rho * loop.qp.point[C, len(problem.J[0]) - 1]
    assert rho <= planned + 1e-9
    assert check_rows(loop, problem) >= rho - 1e-7


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_point_is_an_interior_point_solvers(case: str, seed: int) -> None:
    loop = make_loop(case, seed)
    problem = make_problem(loop)
    expected = solve(problem)
    assert loop.optimise()
    np.testing.assert_allclose(read_point(loop), expected[:-1], atol=5e-4)
    found = np.append(read_point(loop), expected[-1])
    assert np.sum((problem.J @ found - problem.r) ** 2) == pytest.approx(
        np.sum((problem.J @ expected - problem.r) ** 2), abs=1e-4
    )


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_mirrored_world_is_optimised_mirrored(case: str, seed: int) -> None:
    formula, hits = CASES[case]
    loop = make_loop(case, seed)
    turned = formula.replace("pop.y >= 0.5 & pop.y <= 2", "pop.y <= -0.5 & pop.y >= -2")
    turned = turned.replace("pop.y <= -0.5)", "pop.y >= 0.5)").replace("84] pop.y >= 1", "84] pop.y <= -1")
    turned = turned.replace("pop.y <= 2)", "pop.y >= -2)") if formula == SLALOM else formula
    mirrored = Loop(turned, hits, -1.0)
    mirrored.memory.filter[K] = loop.memory.filter[K]
    for name in ("position", "velocity", "drift"):
        mirrored.memory.filter[name][K, :, 1] *= -1
    assert loop.optimise()
    assert mirrored.optimise()
    np.testing.assert_allclose(mirrored.clock, loop.clock, atol=1e-7)
    np.testing.assert_allclose(mirrored.place, loop.place * [1, -1], atol=1e-7)


@pytest.mark.parametrize(("vx", "sign"), [(0.085, 1.0), (0.115, -1.0)])
def test_slower_object_is_hit_later_and_faster_one_earlier(vx: float, sign: float) -> None:
    """Of the 0.3 m that the object is off after 20 s hardly a part is left where it is hit."""
    loop = Loop(BAND, LINE)
    loop.fly(vx)
    assert loop.optimise()
    assert sign * (loop.clock[1] - 30.0) > 1.0
    assert abs(1.0 + vx * (loop.clock[1] - HIT) - 3.0) < 0.06
    assert loop.clock[2] == pytest.approx(60.0, abs=1.0)


def test_impact_comes_no_sooner_than_there_is_notice() -> None:
    """The object comes by its place after 3.5 s, or was to be hit sooner anyway."""
    hits = (LINE[0], (18.0, "crackle", "pop", (3.0, 0.0)), LINE[2])
    loop = Loop(BAND, hits)
    loop.fly(0.4)
    loop.see(CRACKLE, (4.6, 0.1))
    assert loop.optimise()
    assert loop.clock[1] == pytest.approx(NOW + SCALES.notice)
    near = Loop(BAND, hits)
    near.clock[1] = near.strike[0]["time"] = NOW + 2.5
    near.fly(0.4)
    near.see(CRACKLE, (3.0, 0.1))
    assert near.optimise()
    assert NOW + 2.5 - 1e-7 <= near.clock[1] < NOW + SCALES.notice


def far_robot(formula: str = WIDE) -> Loop:
    """Return a world whose next robot cannot be there before the window closes."""
    loop = Loop(formula, LINE)
    loop.fly(0.1)
    loop.see(CRACKLE, (2.0, 48.0))
    return loop


def test_robot_that_comes_late_is_waited_for() -> None:
    loop = far_robot(BAND)
    assert loop.optimise()
    assert loop.clock[1] > 40.0
    place = np.array([1.0 + 0.1 * (loop.clock[1] - HIT), 0.0])
    way = place - REACH * loop.table.impact[1]["normal"] - [2.0, 48.0]
    # A tangent takes the way's length and its change along the way expected before: 0.15 s too little here.
    assert loop.clock[1] - NOW >= compute_span(float(np.hypot(*way))) - 0.3


def test_no_feasible_point_is_said_and_changes_nothing() -> None:
    loop = far_robot()
    with pytest.raises(Infeasible):
        solve(make_problem(loop))
    before = [table.copy() for table in loop.memory]
    assert not loop.optimise()
    for table, old in zip(loop.memory, before, strict=True):
        np.testing.assert_array_equal(table, old)


def test_no_optimum_is_counted_once_per_impact_and_a_flight_astray_asks_sooner_for_a_new_plan() -> None:
    loop = far_robot()
    clocks = loop.clock.copy()
    for step in range(20):
        loop.look(NOW + 0.1 * step)
    assert (loop.count("no_optimum"), loop.count("reoptimised")) == (1, 0)
    assert (loop.memory.wanted == np.inf).all()
    assert loop.strike[0]["astray_since"] == pytest.approx(NOW - EXPERT.insertion.long_astray + EXPERT.insertion.soon)
    np.testing.assert_array_equal(loop.clock, clocks)


def test_optimised_once_after_every_contact_when_the_flight_is_known() -> None:
    loop = Loop(BAND, LINE)
    loop.fly(0.09)
    times = []
    for step in range(40):
        now, before = HIT + 0.1 * step, loop.count("reoptimised")
        loop.look(now)
        times += [now] * (loop.count("reoptimised") - before)
    assert times == pytest.approx([NOW])
    assert loop.strike[0]["optimised_at"] == pytest.approx(NOW)
    assert loop.memory.wanted[K] == np.inf
    loop.strike[0]["last_contact"] = 40.0
    for step in range(30):
        loop.look(40.0 + 0.1 * step)
    assert loop.count("reoptimised") == 2
    assert loop.strike[0]["optimised_at"] == pytest.approx(40.0 + EXPERT.timing.settle)


@pytest.mark.parametrize("change", ["option", "inserted", "over", "unsettled"])
def test_not_optimised_where_there_is_nothing_to_be_done(change: str) -> None:
    loop = Loop(BAND, LINE)
    loop.fly(0.08)
    options, now = replace(ONLY, reoptimise=change != "option"), NOW if change != "unsettled" else NOW - 0.2
    if change == "inserted":
        loop.strike[0]["is_inserted"] = True
    if change == "over":
        loop.strike[0]["index"] = NO_IMPACT
    clocks = loop.clock.copy()
    loop.strike[0]["looked_at"] = -np.inf
    look_ahead(loop.table, loop.memory, make_record(options)[0], loop.qp, C, K, now)
    assert (loop.count("no_optimum"), loop.count("reoptimised")) == (0, 0)
    np.testing.assert_array_equal(loop.clock, clocks)


def test_threads_optimise_in_places_of_their_own() -> None:
    loop, other = make_loop("zigzag", 0), make_loop("zigzag", 0)
    for part in loop.qp:
        part[[0, 2]] = 7
    others = [part[[0, 2]] for part in loop.qp]
    assert loop.optimise()
    for part, before in zip(loop.qp, others, strict=True):
        np.testing.assert_array_equal(part[[0, 2]], before)
    assert reoptimise_rest(other.table, other.memory, OPTIONS, other.qp, 2, K, 0, NOW)
    np.testing.assert_array_equal(other.clock, loop.clock)
    np.testing.assert_array_equal(other.place, loop.place)


def make_many() -> Loop:
    """Return a world with two impacts more left than are optimised at once."""
    hits = [
        (HIT + 8.0 * i, ("snap", "crackle")[i % 2], "pop", (1.0 + 0.8 * (i % 2), 0.0)) for i in range(MOST_KNOTS + 3)
    ]
    loop = Loop(BAND, tuple(hits))
    loop.fly(0.09, 0.01)
    assert len(loop.chain()) == MOST_KNOTS + 3
    return loop


def test_impacts_beyond_the_most_stay_where_they_are() -> None:
    loop = make_many()
    clocks, places = loop.clock.copy(), loop.place.copy()
    assert loop.optimise()
    assert abs(loop.clock[1] - clocks[1]) > 0.1
    np.testing.assert_array_equal(loop.clock[MOST_KNOTS + 1 :], clocks[MOST_KNOTS + 1 :])
    np.testing.assert_array_equal(loop.place[MOST_KNOTS + 1 :], places[MOST_KNOTS + 1 :])


def test_impacts_do_not_come_after_those_beyond_the_most() -> None:
    """Its robot comes to the first one at 55 s only, so that the eighth were at 83 s; the ninth stays at 82 s."""
    loop = make_many()
    loop.see(CRACKLE, (2.0, 22.0))
    loop.optimise()
    assert (np.diff(loop.clock[1 : MOST_KNOTS + 3]) >= SCALES.gap - 1e-7).all()


def test_legs_of_a_hasty_plan_stay_fast() -> None:
    """The second leg is planned with 0.4 m/s; were it slower, the impact before would come before its region."""
    hasty: tuple[Hit, ...] = (
        (HIT, "snap", "pop", (1.0, 0.0)),
        (30.0, "crackle", "pop", (5.0, 0.0)),
        (90.0, "snap", "pop", (-19.0, 0.0)),
    )
    loop = Loop("F[0,100] (pop.x >= 4.5 & pop.x <= 5.5) & G[100,100] pop.x <= -18.5", hasty)
    loop.fly(0.18)  # instead of 0.2 m/s
    assert loop.optimise()
    assert 1.0 + 0.18 * (loop.clock[1] - HIT) >= 4.5
    needed = (loop.place[1, 0] - loop.place[2, 0]) / (loop.clock[2] - loop.clock[1])
    assert FASTEST < needed <= EXPERT.aim.hurry * 0.4
