"""Energy and momentum of both engines: spinning polygons, slow impacts, bodies that touch, contacts that last."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

from impact_envs.errors import ScenarioError
from impact_envs.free_flyer.disc_model import DiscModel
from impact_envs.free_flyer.model import FreeFlyerModel
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.truth import INERTIA, MASS
from impact_envs.rollout import ZeroPolicy, rollout
from impact_envs.scenario import build_scenario

ENGINES = (DiscModel, FreeFlyerModel)
Model = DiscModel | FreeFlyerModel
SQUARE = [(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)]


def make_scenario(objects: dict[str, dict[str, Any]], e: float, size: float = 4.0, **changes: Any) -> FreeFlyerScenario:
    body = {"mass": 1.0, "inertia": 0.02, "radius": 0.2, "speed_limit": 1.0}
    robot = {**body, "start": (size - 0.2, size - 0.2), "force_limit": 2.0, "torque_limit": 1.0}
    data = {
        "domain": "free_flyer",
        "formula": "G[0,1] r.x >= -1000",
        "horizon": 100.0,
        "control_period": 0.1,
        "world": {"lower": (0.0, 0.0), "upper": (size, size)},
        "robots": {"r": {**robot, **changes.pop("robot", {})}},
        "objects": {name: {**body, **table} for name, table in objects.items()},
        "believed": {"restitution": e, "friction": changes.pop("friction", 0.0)},
        **changes,
    }
    built = build_scenario(data, "test")
    assert isinstance(built, FreeFlyerScenario)
    return built


def run(model: Model, steps: int, control: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[Any]:
    impacts = []
    for _ in range(steps):
        impacts += model.step({"r": np.array(control)})
    return impacts


def find_energy(model: Model) -> float:
    body, states = model.physics.body, model.state()
    return float(np.sum(body[:, MASS] * np.sum(states[:, 2:4] ** 2, axis=1) + body[:, INERTIA] * states[:, 5] ** 2) / 2)


def find_momenta(model: Model) -> np.ndarray:
    return np.asarray(model.physics.body[:, MASS, None] * model.state()[:, 2:4])


@pytest.mark.parametrize("rate", [20.0, 50.0, 100.0])
@pytest.mark.parametrize("partner", ["wall", "square", "disc"])
def test_a_fast_spinning_polygon_keeps_its_energy(rate: float, partner: str) -> None:
    others = {"wall": {}, "square": {"b": {"start": (1.2, 0.7), "vertices": SQUARE, "radius": 0.3}}}
    others["disc"] = {"b": {"start": (1.2, 0.7)}}
    objects = {"a": {"start": (0.5, 0.7), "vertices": SQUARE, "radius": 0.3, "start_rate": rate}, **others[partner]}
    model = FreeFlyerModel(make_scenario(objects, 1.0, 2.0))
    rng, count = np.random.default_rng(3), 0
    for _ in range(8):
        model.reset(model.physics)
        states = model.state()
        states[1:, 2:4] = rng.uniform(-0.3, 0.3, (len(states) - 1, 2))
        states[1, 4] = rng.uniform(0.0, 1.6)
        model.set_state(states)
        before = find_energy(model)
        count += len(run(model, 20))
        assert find_energy(model) == pytest.approx(before, rel=1e-9)
    assert count > 4


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("speed", [9e-5, 1e-5, 1e-6])
def test_a_slow_impact_of_free_bodies_is_an_impact(engine: type[Model], speed: float) -> None:
    objects = {"a": {"start": (1.0, 2.0), "start_velocity": (speed, 0.0)}, "b": {"start": (1.4 + speed, 2.0)}}
    model = engine(make_scenario(objects, 1.0))
    impacts = run(model, 20)
    assert [(hit.a, hit.b) for hit in impacts] == [("a", "b")]
    assert impacts[0].speed == pytest.approx(speed, rel=1e-9)
    np.testing.assert_allclose(model.state()[1:, 2], [0.0, speed], atol=1e-9 * speed)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_rest_speed_of_a_scenario_is_its_own(engine: type[Model]) -> None:
    world = {"lower": (0.0, 0.0), "upper": (4.0, 4.0)}
    robot = {"start": (3.8, 2.0), "start_velocity": (0.05, 0.0), "mass": 1.0}
    kinds = []
    for rest_speed in (0.1, 1e-6):
        scenario = make_scenario({}, 0.8, world={**world, "rest_speed": rest_speed}, robot=robot)
        model = engine(scenario)
        impacts = run(model, 1, (0.01, 0.0, 0.0))
        kinds.append((len(impacts), len(model.lasting_contacts), float(model.state()[0, 2])))
    assert kinds[0] == (0, 1, pytest.approx(0.0, abs=1e-9))
    assert kinds[1][0] == 1 and kinds[1][2] == pytest.approx(-0.04 + 0.001)


def test_the_rest_speed_follows_the_speeds_of_the_task() -> None:
    assert make_scenario({}, 1.0).rest_speed == 1e-4
    assert make_scenario({"a": {"start": (1.0, 1.0), "speed_limit": 2e-3}}, 1.0).rest_speed == pytest.approx(1e-6)


@pytest.mark.parametrize("left", [1.0, 1.1, 1.4, 1.6, 2.0, 2.2, 2.4, 2.9])
def test_bodies_may_touch_at_the_start(left: float) -> None:
    make_scenario({"a": {"start": (left, 2.0)}, "b": {"start": (round(left + 0.4, 10), 2.0)}}, 1.0)
    with pytest.raises(ScenarioError, match="overlap"):
        make_scenario({"a": {"start": (left, 2.0)}, "b": {"start": (left + 0.4 - 1e-6, 2.0)}}, 1.0)


@pytest.mark.parametrize("side", [(0.1, 2.0), (3.9, 2.0), (2.0, 3.9), (0.1 + 0.2, 2.0), (1.7, 0.1)])
def test_bodies_may_touch_walls_and_obstacles_at_the_start(side: tuple[float, float]) -> None:
    obstacles = {"block": {"lower": (0.4, 1.0), "upper": (1.6, 3.0), "solid": True}}
    make_scenario({"a": {"start": side, "radius": 0.1}}, 1.0, obstacles=obstacles)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("moving", [1, 2, 3])
def test_a_cradle_in_contact_passes_on_as_many_as_come(engine: type[Model], moving: int) -> None:
    objects = {}
    for ball in range(5):
        apart = 0.0 if ball < moving else 0.5
        speed = 0.2 if ball < moving else 0.0
        start = (round(0.5 + apart + 0.2 * ball, 10), 2.0)
        objects[f"b{ball}"] = {"start": start, "start_velocity": (speed, 0.0), "radius": 0.1, "inertia": 0.005}
    model = engine(make_scenario(objects, 1.0))
    before = find_energy(model)
    impacts = run(model, 30)
    assert len(impacts) == moving * (5 - moving)
    np.testing.assert_allclose(model.state()[1:, 2], [0.0] * (5 - moving) + [0.2] * moving, atol=1e-12)
    assert find_energy(model) == pytest.approx(before, rel=1e-12)


SHAPES = {
    "disc": (ENGINES, {"start": (2.0, 2.0)}),
    "square": ((FreeFlyerModel,), {"start": (2.0, 2.0), "vertices": SQUARE, "radius": 0.3}),
}


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize(("shape", "engine"), [(name, engine) for name, (some, _) in SHAPES.items() for engine in some])
def test_impacts_and_lasting_contacts_balance_the_momentum_of_every_body(
    shape: str, engine: type[Model], e: float, friction: float
) -> None:
    # A robot pushes an object askew across the room and against the wall, and goes on pushing.
    robot = {"start": (1.4, 2.03), "mass": 5.0}
    scenario = make_scenario({"a": SHAPES[shape][1]}, e, friction=friction, robot=robot)
    model, force = engine(scenario), np.array([1.5, 0.0, 0.0])
    names, lasting = list(scenario.bodies), 0
    for _ in range(100):
        before, heading = find_momenta(model), model.state()[0, 4:6]
        impacts = model.step({"r": force})
        expected = before.copy()
        middle = heading[0] + 0.05 * heading[1]
        expected[0] += 0.1 * force[0] * np.array([np.cos(middle), np.sin(middle)])
        for record in (*impacts, *model.lasting_contacts):
            for name, sign in ((record.a, -1.0), (record.b, 1.0)):
                if name in names:
                    expected[names.index(name)] += sign * np.array(record.impulse)
        np.testing.assert_allclose(find_momenta(model), expected, atol=1e-9)
        kinds = Counter((contact.a, contact.b) for contact in model.lasting_contacts)
        assert not kinds or max(kinds.values()) == 1  # one record for each pair of bodies and wall
        lasting += len(kinds)
    assert lasting > 3


def test_an_episode_keeps_what_lasting_contacts_exchanged() -> None:
    from impact_envs import parallel_env

    robot = {"start": (0.2, 2.0), "start_velocity": (-0.3, 0.0)}
    env = parallel_env(make_scenario({}, 0.0, robot=robot), max_cycles=5)
    episode = rollout(env, ZeroPolicy(env), 0)
    total = np.sum([record.impulse for record in (*episode.impacts, *episode.lasting_contacts)], axis=0)
    np.testing.assert_allclose(total, (0.3, 0.0), atol=1e-12)
