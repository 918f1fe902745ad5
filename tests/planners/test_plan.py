import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_envs.errors import InputError
from planners.bezier import Curve
from planners.plan import Plan, PlannedImpact


@pytest.fixture
def plan() -> Plan:
    rng = np.random.default_rng(2)
    impact = PlannedImpact(1 / 3, "snap", "pop", *(rng.normal(size=2) for _ in range(7)))
    return Plan(
        scenario="test",
        objective="robustness",
        horizon=2.0,
        robustness=0.1 + 0.2,
        bound=0.75,
        gap=0.45,
        effort=1e-17,
        effort_bound=None,
        impacts=(impact,),
        robots={"snap": Curve([0.0, 1 / 3, 2.0], rng.normal(size=(2, 6, 2)))},
        objects={"pop": Curve([0.0, 2.0], rng.normal(size=(1, 2, 2)))},
        solve_seconds=0.3,
        stage_seconds={"robustness": 0.1},
        validated=False,
    )


def test_json_round_trip_is_exact(plan: Plan) -> None:
    assert Plan.from_json(plan.to_json()) == plan
    assert Plan.from_json(plan.to_json()).to_json() == plan.to_json()


def test_equality_sees_the_last_bit(plan: Plan) -> None:
    assert replace(plan, robustness=0.3) != plan
    moved = replace(plan.impacts[0], contact=np.nextafter(plan.impacts[0].contact, 9.0))
    assert replace(plan, impacts=(moved,)) != plan


def test_files_keep_plans(plan: Plan, tmp_path: Path) -> None:
    plan.save(tmp_path / "plan.json")
    assert Plan.load(tmp_path / "plan.json") == plan


SPOILERS: dict[str, Callable[[dict], object]] = {
    "gap": lambda data: data.pop("gap"),
    "rho": lambda data: data.update(rho=1.0),
    "robots.snap": lambda data: data["robots"]["snap"].update(times=[0, 1, 1]),
    "points": lambda data: data["robots"]["snap"].update(points="x"),
    "spans": lambda data: data["objects"]["pop"].update(times=[0, 1]),
    "crackle": lambda data: data["impacts"][0].update(robot="crackle"),
    "normal": lambda data: data["impacts"][0].update(normal=[1, 2, 3]),
    "horizon": lambda data: data.update(horizon="long"),
    "impact time": lambda data: data["impacts"][0].update(time=7.0),
    "bound": lambda data: data.update(bound=float("inf")),
}


@pytest.mark.parametrize("name", SPOILERS)
def test_bad_json_is_one_line_that_names_the_place(plan: Plan, name: str) -> None:
    data = json.loads(plan.to_json())
    SPOILERS[name](data)
    with pytest.raises(InputError) as error:
        Plan.from_json(json.dumps(data))
    assert name in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "null", "[]", '"plan"'])
def test_what_is_no_plan_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="plan"):
        Plan.from_json(text)


def test_unreadable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.json"):
        Plan.load(tmp_path / "missing.json")
    (tmp_path / "bad.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"bad\.json"):
        Plan.load(tmp_path / "bad.json")


def test_damaged_plans_are_one_line(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "deep.json"
    path.write_text("[" * 100_000 + "]" * 100_000)
    with pytest.raises(InputError, match="nested too deep"):
        Plan.load(path)
    content = json.loads(plan.to_json())
    path.write_text(json.dumps(content | {"objective": "speed"}))
    with pytest.raises(InputError, match="objective: Input should be 'robustness' or 'impact_uncertainty'"):
        Plan.load(path)
