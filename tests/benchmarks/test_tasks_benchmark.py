"""Random tasks are planned, flown and confirmed, and a failure has a cause; bad arguments are one line."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from impact_envs.errors import InputError
from impact_envs.physics.impact import Impact
from impact_envs.scenario import build_scenario
from planners.budget import Work
from planners.errors import Infeasible
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.task import PlanOptions

QUICK = 1_000_002  # a seed whose task is planned in half a second
BLOCKED = 1_000_014  # an obstacle takes the zone that a robot is to visit


@pytest.fixture(scope="module")
def tasks(load_benchmark):
    return load_benchmark("tasks")


@pytest.fixture(scope="module")
def flights(load_benchmark):
    return load_benchmark("task_flights")


def hit(time, a, b):
    return Impact(time, a, b, (0.0, 0.0), (1.0, 0.0), (0.0, 0.0), 0.1)


def test_a_task_is_planned_flown_and_won(tasks, flights, tmp_path, capsys):
    plans = tmp_path / "plans"
    tasks.main(tasks.Args(count=1, seed=QUICK, plans=plans, fly=2, out=tmp_path / "rows.json"))
    row = json.loads((tmp_path / "rows.json").read_text())[0]
    flown = flights.main(flights.Args(plans, 2, suites=("nominal",)))
    assert [flight.success for flight in flown] == [True, True]
    # The believed world has no noise: the flight is as robust as its plan promises.
    assert [flight.robustness for flight in flown] == pytest.approx(2 * [row["robustness"]], abs=1e-3)
    assert "nominal  all          1       2   100.0%" in capsys.readouterr().out


def test_a_hurry_shortens_the_horizon_and_nothing_else(tasks):
    (_, task), (_, short) = tasks.draw_task(QUICK), tasks.draw_task(QUICK, 0.12)
    assert tasks.draw_task(QUICK, short["horizon"] / task["horizon"])[1] == short  # so its plan is flown in it
    assert short["horizon"] == round(0.12 * task["horizon"], 1)
    assert short["robots"] == task["robots"]
    with pytest.raises(InputError, match="hurry = 2"):
        tasks.main(tasks.Args(hurry=2.0))


def test_flying_needs_plans(tasks, flights, tmp_path):
    with pytest.raises(InputError, match="--fly 2 needs --plans"):
        tasks.main(tasks.Args(count=1, fly=2))
    with pytest.raises(InputError, match=r"no plans task_SEED\.json"):
        flights.main(flights.Args(tmp_path))


@pytest.mark.parametrize(
    ("impacts", "unplanned", "cause"),
    [
        ([hit(1.0, "r", "o"), hit(2.0, "world", "o")], float("inf"), "object meets wall"),
        ([hit(1.0, "r", "s"), hit(2.0, "world", "o")], 1.0, "a robot touches its object when it should not"),
        ([hit(1.0, "s", "o")], 1.1, "a robot touches another object when it should not"),
        ([hit(1.0, "r", "o"), hit(2.0, "r", "s")], float("inf"), "robots meet"),
        ([hit(1.0, "r", "o")], float("inf"), "fewer impacts than planned"),
    ],
)
def test_the_first_thing_amiss_is_the_cause(flights, impacts, unplanned, cause):
    world = SimpleNamespace(robots={"r": 0, "s": 0}, objects={"o": 0}, control_period=0.1)
    if impacts[0].b == "s":
        world = SimpleNamespace(robots={"r": 0}, objects={"s": 0, "o": 0}, control_period=0.1)
    planned = [SimpleNamespace(robot="r", object="o"), SimpleNamespace(robot="r", object=impacts[0].b)]
    episode = SimpleNamespace(failure="", impacts=tuple(impacts))
    found = flights.find_cause(world, SimpleNamespace(impacts=planned), episode, unplanned)
    assert found == cause


def test_a_goal_within_an_obstacle_is_proven_without_a_search(tasks):
    scenario, work = build_scenario(tasks.draw_task(BLOCKED)[1], source="test"), Work()
    with pytest.raises(Infeasible, match=r"proven infeasible: r3 has to be in zone by 150 s, .* solid obstacle wall2"):
        make_free_flyer_plan(scenario, options=PlanOptions(diagnosis=0.0), work=work)
    assert work.done == 0.0


@pytest.mark.slow
def test_a_finer_encoding_confirms_that_and_finds_plans_where_there_are_some(tasks):
    assert tasks.confirm_proof(tasks.draw_task(BLOCKED)[1], 20.0) == tasks.AGREES
    assert tasks.confirm_proof(tasks.draw_task(QUICK)[1], 60.0) == tasks.DISAGREES
