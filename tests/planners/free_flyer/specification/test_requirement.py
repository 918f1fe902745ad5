import numpy as np
import pytest

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from impact_envs.stl import Trace, parse, robustness
from planners.free_flyer.specification.negation_normal_form import Release, compute_normal_form
from planners.free_flyer.specification.requirement import Demands, Requirement, read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound


def _read(formula: str, name: str = "throw_and_catch") -> Demands:
    scenario = load_scenario(name).override({"formula": formula})
    assert isinstance(scenario, FreeFlyerScenario)
    return read_demands(scenario, 0.05)


def _only(formula: str) -> Requirement:
    (need,) = _read(formula).predicates.values()
    return need


def test_conjuncts_keep_their_text_and_lose_all() -> None:
    demands = _read("F[0,30] pop in goal & G[0,30] all not in goal")
    assert list(demands.conjuncts) == ["F[0,30] pop in goal", "G[0,30] all not in goal"]
    bodies = [need.body for need in demands.predicates.values()]
    assert bodies == ["pop", "snap", "crackle", "pop"]


def test_comparisons_of_a_position_are_half_planes() -> None:
    need = _only("G[0,30] pop.x - 2*pop.y >= -9")
    assert need.faces.tolist() == [[-1.0, 2.0]]
    assert need.bounds.tolist() == [9.0]
    assert need.bodies == ("pop",)


def test_comparisons_of_several_bodies_are_half_planes_of_all() -> None:
    need = _only("G[0,30] pop.x - 2*snap.y + crackle.x <= 3")
    assert need.bodies == ("pop", "snap", "crackle")
    assert need.faces.tolist() == [[1.0, 0.0]]
    assert {name: normal.tolist() for name, normal in need.others.items()} == {
        "snap": [[0.0, -2.0]],
        "crackle": [[1.0, 0.0]],
    }


def test_a_distance_below_is_a_polygon_inside_the_circle() -> None:
    need = _only("G[0,30] distance(snap, pop) <= 0.7")
    for angle in np.linspace(0.0, 2.0 * np.pi, 200):
        direction = np.array([np.cos(angle), np.sin(angle)])
        reach = np.min(need.bounds / np.maximum(need.others["pop"] @ direction, 1e-9))
        assert 0.98 * 0.7 <= reach <= 0.7 + 1e-12
    np.testing.assert_allclose(need.faces, -need.others["pop"])


def test_solid_obstacles_keep_every_body_off() -> None:
    scenario = load_scenario("obstacle_avoidance")
    assert isinstance(scenario, FreeFlyerScenario)
    demands = read_demands(scenario, 0.05)
    avoided = [need for need in demands.predicates.values() if need.kind == "avoid"]
    assert [need.body for need in avoided] == list(scenario.bodies)
    assert all(need.scored and need.clearance == 0.25 for need in avoided)
    assert demands.solids == ()
    for formula, free in (("F[0,150] pop in goal", 3), ("F[0,150] pop in goal & G[0,150] snap not in block", 2)):
        solids = _read(formula, "obstacle_avoidance").solids
        assert len(solids) == free
        assert all(not need.scored and need.clearance == 0.25 and need.end == 150.0 for need in solids)
    # What is said about a part of the time does not stand for all of it.
    assert len(_read("G[0,149] all not in block", "obstacle_avoidance").solids) == 3


@pytest.mark.parametrize(
    ("formula", "culprit"),
    [
        ("F[0,30] pop in goal & G[0,30] pop.vx <= 1", "pop.vx <= 1"),
        ("G[0,30] (pop in goal -> speed(snap) <= 0.1)", "speed(snap) <= 0.1"),
        ("pop.heading >= 0 U[0,30] pop in goal", "pop.heading >= 0"),
        ("F[0,30] not pop.x + 2*crackle.omega < 1", "pop.x + 2*crackle.omega >= 1"),
        ("G[0,30] distance(snap, snap) >= 1", "distance(snap, snap) >= 1"),
    ],
)
def test_unsupported_predicates_are_named(formula: str, culprit: str) -> None:
    with pytest.raises(InputError, match="not supported by this planner") as error:
        _read(formula)
    assert f"'{culprit}'" in str(error.value)
    assert "\n" not in str(error.value)


FORMULAS = [
    "not (a.x <= 1 & G[1,3] a.x >= 0.5)",
    "not ((a.x >= 0.2) U[1,4] (a.x <= -0.2 | a in box))",
    "a in box -> not F[0,2] (a.x <= 0 -> a not in box)",
    "not not F[0,2] F[1,2] a in box",
    "not (not ((a.x >= 0.2) U[1,4] (a.x <= -0.2)))",
    "F[0,2] (a.x >= 0 & (a in box & distance(a, b) >= 1))",
]


@pytest.mark.parametrize("text", FORMULAS)
def test_the_normal_form_has_the_same_robustness(text: str) -> None:
    rng = np.random.default_rng(0)
    scenario = load_scenario("throw_and_catch")
    areas = {"box": scenario.areas["goal"]}
    formula = parse(text)
    normal = compute_normal_form(formula)
    kinds = {type(node).__name__ for node in normal.walk()}
    assert kinds <= {"And", "Or", "Always", "Eventually", "Until", "Release", "In", "Linear", "Distance"}
    if not any(isinstance(node, Release) for node in normal.walk()):
        for _ in range(20):
            signals = {f"{body}.{axis}": np.cumsum(rng.normal(size=21)) for body in "ab" for axis in "xy"}
            trace = Trace(signals, 0.5, areas, ("a", "b"))
            assert robustness(normal, trace) == robustness(formula, trace)
    assert compute_normal_form(parse(str(normal))) == normal


def test_a_negated_until_prints_as_such() -> None:
    text = "not (pop in goal U[0,30] snap in goal)"
    normal = compute_normal_form(parse(text))
    assert isinstance(normal, Release)
    assert str(normal) == text


def _bound(name: str, **values: object) -> float:
    scenario = load_scenario(name).override({key.replace("__", "."): value for key, value in values.items()})
    assert isinstance(scenario, FreeFlyerScenario)
    return compute_geometric_bound(scenario, read_demands(scenario, 0.05))


def test_no_plan_is_more_robust_than_the_inradius_of_its_goal() -> None:
    assert _bound("throw_and_catch") == 0.25
    assert _bound("corridor") == 0.75


def test_fixed_starts_and_goals_bound_the_robustness() -> None:
    assert _bound("corridor", robots__snap__start=[0.5, 1.0]) == 0.5
    assert _bound("corridor", robots__snap__goal=[1.9, 1.0]) == pytest.approx(0.1)
    assert _bound("corridor", robots__snap__goal=[2.5, 1.0]) == -0.5


@pytest.mark.parametrize(
    ("formula", "bound"),
    [
        ("F[0,100] pop in B | G[100,100] snap in D", 0.25),  # snap ends 1.75 m away from D
        ("F[0,100] (pop in B & snap.x <= 0.1)", 0.1),
        ("G[0,100] (snap in B -> pop in C)", 1.75),  # snap starts 1.75 m away from B
        ("(snap.x <= 0.6) U[0,100] pop in B", 0.1),
        ("not ((pop not in B) U[0,100] (snap in C))", 0.5),  # snap ends 0.5 m away from C
        ("G[0,100] F[0,0] pop in B", -1.0),
        ("F[0,100] G[0,0] distance(snap, crackle) <= 1", 0.6),  # discs touch at 0.4 m
        ("G[0,100] distance(snap, crackle) >= 1", 2.0),
        ("F[10,20] pop.x >= 100", -96.0),
    ],
)
def test_operators_pass_the_bound_on(formula: str, bound: float) -> None:
    assert _bound("pong", formula=formula) == pytest.approx(bound)


@pytest.mark.parametrize(
    ("lower", "upper", "solid", "formula", "bound"),
    [
        ([0.5, 1.9], [0.9, 3.0], True, "G[30,30] pop in goal", 0.05),  # pop, of 0.2 m, touches it at x = 0.3
        ([0.5, 1.9], [0.9, 3.0], False, "G[30,30] pop in goal", 0.25),  # nobody has to avoid it
        ([0.5, 1.9], [0.9, 3.0], False, "G[30,30] pop in goal & G[0,30] pop not in block", 0.125),
        ([0.2, 1.95], [0.8, 2.55], True, "G[30,30] pop in goal", -0.25),  # it takes all of the goal
        ([0.2, 1.95], [0.8, 2.55], True, "F[0,30] pop in goal | F[0,30] snap in goal", -0.25),
        ([0.2, 1.95], [0.8, 2.55], True, "F[0,30] snap.y <= 1 | F[0,30] pop in goal", 1.75),  # to the world's edge
        ([1.2, 1.95], [1.8, 2.55], True, "G[30,30] pop in goal", 0.25),  # it is out of the way
    ],
)
def test_obstacles_that_reach_into_a_goal_bound_the_robustness(
    lower: list[float], upper: list[float], solid: bool, formula: str, bound: float
) -> None:
    scenario = load_scenario("throw_and_catch")
    assert isinstance(scenario, FreeFlyerScenario)
    fields = {field: getattr(scenario, field) for field in FreeFlyerScenario.model_fields}
    block = {"block": {"lower": lower, "upper": upper, "solid": solid}}
    blocked = FreeFlyerScenario(**fields | {"obstacles": block, "formula": formula})
    assert compute_geometric_bound(blocked, read_demands(blocked, 0.05)) == pytest.approx(bound, abs=1e-6)
