import pytest

from impact_envs.errors import InputError
from impact_envs.scenario import load_scenario
from planners.free_flyer.requirement import Requirement, compute_geometric_bound, read_requirements


def _read(formula: str, name: str = "throw_and_catch") -> list[tuple[str, str, float, float]]:
    needs = read_requirements(load_scenario(name).override({"formula": formula}), 0.05)
    return [(need.kind, need.body, need.start, need.end) for need in needs]


def test_windows_add_up_and_conjunctions_open() -> None:
    assert _read("G[2,4] (pop in goal & G[1,3] snap not in goal)") == [
        ("stay", "pop", 2.0, 4.0),
        ("avoid", "snap", 3.0, 7.0),
    ]
    assert _read("F[1,5] F[2,3] pop in goal") == [("reach", "pop", 3.0, 8.0)]
    assert _read("pop in goal") == [("stay", "pop", 0.0, 0.0)]


def test_all_means_every_body() -> None:
    assert [body for _, body, _, _ in _read("G[0,30] all not in goal")] == ["snap", "crackle", "pop"]


def test_eventually_at_the_end_is_always_at_the_end() -> None:
    assert _read("F[30,30] pop in goal") == [("stay", "pop", 30.0, 30.0)]


def test_comparisons_of_a_position_are_half_planes() -> None:
    scenario = load_scenario("throw_and_catch").override({"formula": "G[0,30] pop.x - 2*pop.y >= -9"})
    (need,) = read_requirements(scenario, 0.05)
    assert need.faces.tolist() == [[-1.0, 2.0]]
    assert need.bounds.tolist() == [9.0]


def test_solid_obstacles_keep_every_body_off() -> None:
    scenario = load_scenario("obstacle_avoidance")
    needs = [need for need in read_requirements(scenario, 0.05) if need.kind == "avoid"]
    assert [need.body for need in needs] == list(scenario.bodies)
    assert all(need.scored and need.clearance == 0.25 for need in needs)
    free = scenario.override({"formula": "F[0,150] pop in goal"})
    assert [need.scored for need in read_requirements(free, 0.05)] == [True, False, False, False]


@pytest.mark.parametrize(
    "formula",
    [
        "F[0,30] (pop in goal & snap in goal)",
        "pop in goal U[0,30] snap in goal",
        "F[0,30] pop in goal | F[0,30] snap in goal",
        "F[0,30] snap in goal",
        "F[0,30] pop not in goal",
        "G[0,30] distance(snap, crackle) >= 1",
        "G[0,30] pop.vx <= 1",
        "G[0,20] F[0,5] pop in goal",
    ],
)
def test_unsupported_forms_are_named(formula: str) -> None:
    with pytest.raises(InputError, match="not supported by this planner") as error:
        _read(formula)
    assert "\n" not in str(error.value)


def _bound(name: str, **values: object) -> float:
    scenario = load_scenario(name).override({key.replace("__", "."): value for key, value in values.items()})
    needs: tuple[Requirement, ...] = read_requirements(scenario, 0.05)
    return compute_geometric_bound(scenario, needs)


def test_no_plan_is_more_robust_than_the_inradius_of_its_goal() -> None:
    assert _bound("throw_and_catch") == 0.25
    assert _bound("corridor") == 0.75


def test_fixed_starts_and_goals_bound_the_robustness() -> None:
    assert _bound("corridor", robots__snap__start=[0.5, 1.0]) == 0.5
    assert _bound("corridor", robots__snap__goal=[1.9, 1.0]) == pytest.approx(0.1)
    assert _bound("corridor", robots__snap__goal=[2.5, 1.0]) == -0.5
