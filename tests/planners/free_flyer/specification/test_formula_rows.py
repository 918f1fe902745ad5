import itertools
from dataclasses import dataclass

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from impact_envs.stl import Formula, Trace, parse, robustness
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.event_grid import build_event_grid
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.formula_rows import add_demands
from planners.free_flyer.specification.requirement import Requirement, read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound
from planners.free_flyer.validation import compute_robustness
from planners.mixed_integer import Affine, evaluate
from planners.solvers import solve

PERIOD = 0.005  # of dense samples [s]
AREAS = {
    "regions.zone": {"lower": [-0.9, 1.5], "upper": [-0.1, 2.5]},  # between the robots
    "regions.middle": {"lower": [0.75, 1.0], "upper": [1.75, 2.0]},
    "regions.far": {"lower": [1.0, 3.0], "upper": [1.8, 4.0]},
    "regions.home": {"lower": [0.2, 1.3], "upper": [0.8, 1.9]},  # the object starts 0.2 m inside
    "regions.corner": {"vertices": [[0.0, 0.0], [1.5, 0.5], [0.2, 2.2]]},
    "regions.sealed": {"lower": [-0.95, 4.3], "upper": [-0.8, 4.45]},  # no body fits in
}


@dataclass(frozen=True)
class _Found:
    scenario: FreeFlyerScenario
    rho: float
    true: float
    bound: float
    times: np.ndarray
    positions: dict[str, np.ndarray]
    needs: tuple[Requirement, ...]

    def holds(self, formula: str, start: float, end: float) -> bool:
        """Return whether a formula about one instant holds at all samples from start to end."""
        inside = (self.times >= start - 1e-9) & (self.times <= end + 1e-9)
        positions = {name: points[inside] for name, points in self.positions.items()}
        whole = parse(f"G[0,{(inside.sum() - 1) * PERIOD}] ({formula})")
        return _robustness(self.scenario, whole, positions) > 0.0


def _scenario(formula: str, **values: object) -> FreeFlyerScenario:
    """Return throw-and-catch with 40 s and more areas."""
    scenario = load_scenario("throw_and_catch").override({"horizon": 40.0, "formula": formula, **AREAS, **values})
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario


def _robustness(scenario: FreeFlyerScenario, formula: Formula, positions: dict[str, np.ndarray]) -> float:
    signals = {f"{name}.{axis}": p[:, k] for name, p in positions.items() for k, axis in enumerate("xy")}
    return float(robustness(formula, Trace(signals, PERIOD, scenario.areas, scenario.bodies)))


def _solve(
    formula: str, impacts: int, pieces: int = 1, passing: bool = True, least: float = 0.0, seconds: float = 20.0
) -> _Found:
    """Return the most robust polylines, without any smoothing."""
    scenario = _scenario(formula)
    demands = read_demands(scenario, 0.05)
    bound = compute_geometric_bound(scenario, demands)
    grid = build_event_grid(scenario, impacts, (least, max(bound, least)), Reserves(), pieces)
    choices = add_demands(grid, demands, scenario.control_period, passing)
    grid.model.objective = -grid.rho
    x = solve_apart(grid, scenario, Reserves(), lambda: solve(grid.model, seconds, 1e-4).x)
    knot_times = evaluate(grid.times, x)
    times = np.arange(round(scenario.horizon / PERIOD) + 1) * PERIOD
    positions = {}
    for name, knots in grid.knots.items():
        points = evaluate(knots, x)
        positions[name] = np.stack([np.interp(times, knot_times, points[:, d]) for d in range(2)], axis=1)
    true = _robustness(scenario, scenario.specification, positions)
    needs = choices.read(x, knot_times)
    return _Found(scenario, float(grid.rho.value(x)), true, bound, times, positions, needs)


# Without impacts the object rests at (0.5, 1.5), snap goes from (0, 0.5) and crackle from (0, 3.25) and back.
KNOWN = {
    "F[0,40] snap in zone": 0.4,  # the inradius
    "F[20,20] snap in zone": 0.4,
    "F[0,40] (snap in zone & snap.y <= 2)": 0.25,  # 0.5 m high then
    "F[0,40] distance(snap, crackle) <= 1": 0.4,  # the planner keeps them 0.2 m beyond touching
    "G[0,40] distance(snap, crackle) >= 1": 1.75,  # at start and end; one side, the line between them
    "G[0,40] distance(snap, pop) >= 0.5": np.hypot(0.5, 1.0) - 0.5,
    "G[0,40] crackle.y - snap.y >= 1": 1.75,
    "G[0,40] (pop.x + 0.5*snap.x <= 1 | pop in goal)": 0.5,
    "G[0,40] (pop in middle | pop in far | pop in home)": 0.2,  # the last alone holds
    "F[0,40] pop in home & G[0,40] pop not in middle": 0.2,
    "not F[0,40] not (pop in home -> pop.y >= 1)": 0.5,
    "F[0,20] G[0,20] pop in home": 0.2,
    "G[0,30] F[0,10] pop in home": 0.2,
    "G[0,20] F[0,10] G[0,10] pop in home": 0.2,
    "(snap not in zone) U[5,30] pop.y >= 1": 0.5,
    "(pop in home) U[0,40] snap in zone": 0.2,
    "not ((snap not in zone) U[0,30] pop in goal)": 0.5,  # the object never comes: 0.5 m below
    "G[0,10] ((pop in home) U[0,30] snap in zone)": 0.2,
    "G[0,15] (snap not in zone -> F[0,25] snap in zone)": 0.4,
}


@pytest.mark.parametrize("formula", KNOWN)
def test_optima_known_by_hand_are_found(formula: str) -> None:
    found = _solve(formula, impacts=0, pieces=2)
    assert found.rho == pytest.approx(KNOWN[formula], abs=1e-3)
    assert found.rho - 1e-3 <= found.true
    assert found.rho <= found.bound + 1e-9


ALWAYS, NEVER = "snap.x <= 100", "snap.x >= 100"
SAME = [
    ("F[5,25] snap in zone", f"({ALWAYS}) U[5,25] snap in zone"),
    ("G[3,20] crackle.y >= 2.9", f"not (({ALWAYS}) U[3,20] crackle.y < 2.9)"),
    ("G[0,10] F[0,30] crackle in zone", f"G[0,10] (({ALWAYS}) U[0,30] crackle in zone)"),
    ("G[0,15] F[0,25] snap in zone", f"G[0,15] ({NEVER} | F[0,25] snap in zone)"),
    ("G[0,15] F[0,25] snap in zone", f"G[0,15] F[0,25] (snap in zone & F[0,0] {ALWAYS})"),
    ("F[0,20] G[5,8] snap.y >= 0.3", f"F[0,20] (G[5,8] snap.y >= 0.3 | G[0,1] {NEVER})"),
]


@pytest.mark.parametrize(("plain", "involved"), SAME)
def test_equivalent_formulas_have_the_same_optimum(plain: str, involved: str) -> None:
    assert _solve(involved, 0, 2).rho == pytest.approx(_solve(plain, 0, 2).rho, abs=1e-3)


@pytest.mark.parametrize("pieces", [1, 2])
def test_infeasible_forms_are_proven_to_be(pieces: int) -> None:
    for formula in (
        "F[0,40] snap in sealed",
        "F[0,4] pop in far | G[0,40] snap in zone",
        "G[0,30] F[0,5] snap in zone",
        "(snap not in zone) U[0,40] (snap in zone & pop in goal)",
        "G[0,40] distance(snap, crackle) >= 2.8",
        "F[0,10] G[0,30] pop not in home",
    ):
        with pytest.raises(Infeasible):
            _solve(formula, 0, pieces)


def test_a_disjunction_takes_the_only_feasible_branch() -> None:
    found = _solve("G[40,40] pop in sealed | (G[40,40] pop in goal & F[0,20] pop in sealed) | F[5,40] pop in far", 2, 2)
    assert [need.text for need in found.needs] == ["pop in far"]
    assert found.true > 0.3
    assert found.holds("pop in far", found.needs[0].start, found.needs[0].end)


def test_a_union_of_convex_areas_is_a_non_convex_one() -> None:
    # A robot goes round the corner of an L, in one of its parts or in both, but never outside.
    left, top = "snap.x <= 0.3 & snap.x >= -0.7", "snap.y >= 1.2 & snap.y <= 2.2"
    found = _solve(f"G[0,40] ({left} | {top}) & F[0,40] snap.x >= 1", 0, 4)
    assert found.true >= found.rho - 1e-3 > 0.05
    assert found.positions["snap"][:, 0].max() > 1.1
    windows = [(need.start, need.end) for need in found.needs if need.text == "snap.y <= 2.2"]
    assert sum(end - start for start, end in windows) < 40.0


def test_until_puts_two_visits_in_order() -> None:
    reach = "F[0,40] snap in zone & F[0,40] crackle in zone"
    first = {}
    for order in ("(snap not in zone) U[0,40] crackle in zone", "(crackle not in zone) U[0,40] snap in zone"):
        found = _solve(f"{order} & {reach}", 0, 4)
        assert found.true >= found.rho - 1e-3 > 0.0
        visits = {}
        for robot in ("snap", "crackle"):
            x, y = found.positions[robot].T
            visits[robot] = found.times[(x > -0.9) & (x < -0.1) & (y > 1.5) & (y < 2.5)][0]
        first[order] = min(visits, key=visits.__getitem__)
    assert list(first.values()) == ["crackle", "snap"]


def test_a_dwell_lasts() -> None:
    found = _solve("F[10,30] G[0,7] snap in zone & F[0,30] G[0,9] crackle.x >= 1", 0, 4)
    assert found.true >= found.rho - 1e-3 > 0.0
    dwells = {need.text: need for need in found.needs}
    for text, least in (("snap in zone", 7.0), ("crackle.x >= 1", 9.0)):
        assert dwells[text].end - dwells[text].start == pytest.approx(least)
        assert found.holds(text, dwells[text].start, dwells[text].end)
    assert 10.0 <= dwells["snap in zone"].start <= 30.0


def test_what_has_to_recur_recurs() -> None:
    found = _solve("G[5,30] F[0,6] (snap in zone | crackle in zone)", 0, 4)
    assert found.true >= found.rho - 1e-3 > 0.0


def test_single_instants_move_with_their_knots() -> None:
    scenario = _scenario("F[0,40] snap in zone & (pop not in far) U[0,40] pop in goal")
    grid = build_event_grid(scenario, 2, (0.1, 0.25), Reserves(), 2)
    choices = add_demands(grid, read_demands(scenario, 0.05), scenario.control_period, passing=False)
    grid.model.objective = grid.times[2] + Affine({})
    x = solve(grid.model, 20.0).x
    before = evaluate(grid.times, x)
    events = before[::2] + np.array([0.0, 0.3, 0.3, 0.0])
    after = np.interp(np.arange(7) / 2, np.arange(4), events)
    for need, later in zip(choices.read(x, before), choices.read(x, after), strict=True):
        for here, there in ((need.start, later.start), (need.end, later.end)):
            # Control steps are 0.1 s apart.
            assert there == pytest.approx(np.interp(here, before, after), abs=0.1)
            assert np.abs(after - there).min() < 1e-6 or there == pytest.approx(round(there, 1), abs=1e-9)


def test_rows_carry_the_name_of_their_conjunct() -> None:
    scenario = _scenario("F[0,40] snap in zone & F[0,40] crackle in sealed & G[0,40] all not in far")
    grid = build_event_grid(scenario, 0, (0.0, 1.0), Reserves(), 2)
    grid.model.elastic = True
    add_demands(grid, read_demands(scenario, 0.05), scenario.control_period, passing=True)
    assert list(grid.model.slacks) == ["F[0,40] snap in zone", "F[0,40] crackle in sealed", "G[0,40] all not in far"]
    grid.model.objective = sum(grid.model.slacks.values(), Affine({}))
    x = solve(grid.model, 20.0).x
    needed = {name: slack.value(x) for name, slack in grid.model.slacks.items()}
    # Centres stay 0.25 m off the world's edge, so right of -0.75 m.
    assert needed.pop("F[0,40] crackle in sealed") == pytest.approx(0.05)
    assert max(needed.values()) == pytest.approx(0.0, abs=1e-6)


def _random_formula(rng: np.random.Generator, depth: int, left: float) -> str:
    """Return a formula that looks at most `left` seconds ahead."""
    if depth == 0 or rng.random() < 0.1:
        return _random_predicate(rng)
    kind = rng.choice(["&", "|", "->", "not", "F", "G", "G", "U"])
    if kind == "not":
        return f"not ({_random_formula(rng, depth - 1, left)})"
    start, end = sorted(np.round(rng.uniform(0.0, left * (1.0 if depth == 1 else 0.6), 2)).tolist())
    start = float(rng.choice([0.0, start]))
    later = left - end if kind in "FGU" else left
    first, second = (_random_formula(rng, depth - 1, later) for _ in range(2))
    if kind in "FG":
        return f"{kind}[{start},{end}] ({first})"
    return f"({first}) {kind}{f'[{start},{end}]' if kind == 'U' else ''} ({second})"


def _random_predicate(rng: np.random.Generator) -> str:
    one, two = rng.permutation(["snap", "crackle", "pop"])[:2]
    relation, bound = rng.choice(["<=", ">="]), round(float(rng.uniform(0.0, 2.0)), 1)
    area = rng.choice(["goal", "zone", "middle", "far", "corner"])
    predicates = [f"{one} in {area}", f"{one} not in {area}", f"distance({one}, {two}) {relation} {bound}"]
    predicates += [f"{one}.{rng.choice(['x', 'y'])} {relation} {bound}", f"{one}.x - 0.5*{two}.y >= {bound - 1.5:.1f}"]
    return str(rng.choice(predicates))


def test_polylines_are_as_robust_as_promised_whatever_the_formula() -> None:
    found = 0
    for seed in itertools.count():
        rng = np.random.default_rng(seed)
        formula = _random_formula(rng, int(rng.integers(1, 4)), 39.0)
        impacts, pieces, passing = int(rng.choice([0, 0, 2])), int(rng.integers(1, 3)), bool(rng.random() < 0.7)
        try:
            # Negative values count as well: they are promises too.
            plan = _solve(formula, impacts, pieces, passing, least=-4.0, seconds=1.0)
        except (Infeasible, SolverFailed):
            continue
        assert plan.true >= plan.rho - 1e-3, formula
        for need in plan.needs:
            if need.scored and need.end > need.start + PERIOD:
                within = (plan.times >= need.start) & (plan.times <= need.end)
                places = {name: points[within] for name, points in plan.positions.items()}
                held = _robustness(plan.scenario, parse(f"G[0,{(within.sum() - 1) * PERIOD}] {need.text}"), places)
                assert held >= plan.rho - 1e-3, (formula, need.text)
        found += 1
        if found == 30:
            break
    assert seed < 60


FORMS = [
    "F[0,40] snap in zone & G[40,40] pop in goal",
    "F[0,20] G[0,5] crackle in zone & G[40,40] pop in goal",
    "G[40,40] (pop in goal | pop in sealed) & G[0,40] (snap in zone | snap.y <= 1.5 | snap.x >= 0)",
    "(snap not in zone) U[0,40] (pop in goal) & F[0,40] snap in zone",
    "G[40,40] pop in goal & G[0,40] distance(snap, crackle) >= 2 & G[0,40] crackle.y - snap.y >= 1",
    "F[0,30] (distance(snap, pop) <= 1 & crackle in zone)",
    "G[20,30] F[0,10] pop in goal",
]


@pytest.mark.parametrize("formula", FORMS)
def test_plans_of_every_form_keep_their_robustness(formula: str) -> None:
    scenario = _scenario(formula)
    plan = make_free_flyer_plan(scenario)
    times = np.arange(scenario.steps + 1) * scenario.control_period
    positions = {name: curve.position(times) for name, curve in (plan.robots | plan.objects).items()}
    assert plan.robustness > 0.1
    assert compute_robustness(scenario, times, positions) == pytest.approx(plan.robustness, abs=1e-3)
    assert plan.robustness <= plan.bound + 1e-9
