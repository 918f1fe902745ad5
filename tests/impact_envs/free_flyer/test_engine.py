"""Accuracy of the exact engine: impact times, conserved quantities, agreement with pymunk's model, one source."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from impact_envs.compiled import compiled
from impact_envs.errors import ScenarioError
from impact_envs.free_flyer.disc_model import DiscModel, make_model
from impact_envs.free_flyer.model import FreeFlyerModel
from impact_envs.free_flyer.truth import MASS, RESTITUTION
from impact_envs.interface.failure import TooManyEvents
from impact_envs.physics.time_of_impact import find_disc_impact
from impact_envs.scenario import build_scenario, load_scenario

THRUST = {"force_limit": 1.5, "torque_limit": 0.5}
BODY = {"mass": 16.8, "inertia": 0.3, "radius": 0.2, "speed_limit": 10.0}


def make_scenario(robots, objects=(), size=6.0, restitution=0.8, obstacles=None):
    data = {
        "name": "test",
        "domain": "free_flyer",
        "formula": "G[0,1] a.x <= 1000",
        "horizon": 100.0,
        "control_period": 0.1,
        "world": {"lower": [0, 0], "upper": [size, size]},
        "robots": {name: {**BODY, **THRUST, **table} for name, table in robots.items()},
        "objects": {name: {**BODY, **table} for name, table in dict(objects).items()},
        "obstacles": obstacles or {},
        "believed": {"restitution": restitution},
    }
    return build_scenario(data, "test")


def launch(model, velocities, restitution=None):
    physics = model.scenario.as_believed().draw(np.random.default_rng(0))
    if restitution is not None:
        physics.contact[RESTITUTION] = restitution
    model.reset(physics)
    states = model.state()
    states[:, 2:4] = velocities
    model.set_state(states)


@compiled
def find_impacts(cases, radius, end, times):
    for k in range(cases.shape[0]):
        x, y, vx, vy, ax, ay = cases[k, 0], cases[k, 1], cases[k, 2], cases[k, 3], cases[k, 4], cases[k, 5]
        times[k] = find_disc_impact(x, y, vx, vy, ax, ay, radius, 0.0, end)


def test_impact_times_are_the_roots_of_the_quartic():
    """5,000 encounters under thrust: none missed, none invented, time within 1e-11 s of numpy's roots."""
    rng, radius, end, n = np.random.default_rng(0), 0.4, 3.0, 5_000
    angle, distance = rng.uniform(0, 2 * np.pi, n), rng.uniform(0.41, 1.2, n)
    speed, aim = rng.uniform(0, 0.6, n), angle + np.pi + rng.normal(0, 0.5, n)
    thrust = rng.uniform(-0.2, 0.2, (n, 2))
    cases = np.column_stack(
        [distance * np.cos(angle), distance * np.sin(angle), speed * np.cos(aim), speed * np.sin(aim), thrust]
    )
    times = np.empty(n)
    find_impacts(cases, radius, end, times)
    hits, worst = 0, 0.0
    for (x, y, vx, vy, ax, ay), time in zip(cases, times, strict=True):
        c = [x * x + y * y - radius**2, 2 * (x * vx + y * vy), vx * vx + vy * vy + x * ax + y * ay]
        c += [vx * ax + vy * ay, (ax * ax + ay * ay) / 4]
        roots = np.roots(c[::-1])
        real = np.sort(roots[np.abs(roots.imag) < 1e-7].real)
        slopes = c[1] + real * (2 * c[2] + real * (3 * c[3] + real * 4 * c[4]))
        falling = real[(real >= 0) & (real <= end) & (slopes < -1e-6)]
        if len(falling) == 0:
            # A graze within rounding of touching may go either way.
            assert time == math.inf or np.min(np.abs(roots - time)) < 1e-5
        else:
            hits += 1
            worst = max(worst, abs(time - falling[0]))
    assert hits > 1250
    assert worst < 1e-11


def crowd(restitution):
    robots = {name: {"start": start} for name, start in zip("abcd", ((1, 1), (3, 1), (1, 3), (3, 3)), strict=True)}
    objects = {
        name: {"start": start, "mass": 5.0} for name, start in zip("uvw", ((2, 2), (2, 3.2), (3.2, 2)), strict=True)
    }
    return make_scenario(robots, objects, size=4.0, restitution=restitution)


def test_energy_is_kept_over_a_hundred_thousand_elastic_impacts():
    model = DiscModel(crowd(1.0))
    rng = np.random.default_rng(1)
    launch(model, rng.uniform(-12, 12, (7, 2)))
    masses = model.physics.body[:, MASS]
    energy = masses @ np.sum(model.state()[:, 2:4] ** 2, axis=1)
    still, impacts = {name: np.zeros(3) for name in "abcd"}, 0
    while impacts < 100_000:
        impacts += len(model.step(still))
    after = masses @ np.sum(model.state()[:, 2:4] ** 2, axis=1)
    assert abs(after - energy) < 1e-11 * energy


def test_momentum_is_kept_and_energy_lost_as_newton_says():
    model = DiscModel(make_scenario({"a": {"start": (300, 300)}}, {"u": {"start": (300.6, 300.1), "mass": 7.0}}, 600.0))
    rng = np.random.default_rng(2)
    for _ in range(300):
        e = rng.uniform(0, 1)
        launch(model, [(rng.uniform(0.2, 2), 0.0), rng.uniform(-0.1, 0.1, 2)], restitution=e)
        masses = np.array([16.8, 7.0])
        before = model.state()[:, 2:4]
        impacts = [impact for _ in range(40) for impact in model.step({"a": np.zeros(3)})]
        after = model.state()[:, 2:4]
        assert np.all(np.abs(masses @ after - masses @ before) < 1e-12)
        if impacts:
            normal = np.array(impacts[0].normal)
            assert normal @ (after[1] - after[0]) == pytest.approx(-e * (normal @ (before[1] - before[0])), abs=1e-13)


def test_pushing_head_on_neither_sinks_nor_floods():
    """30 s of full thrust against an object: bounces end, the pair goes on as one body."""
    model = DiscModel(make_scenario({"a": {"start": (300, 300)}}, {"u": {"start": (300.5, 300)}}, 600.0))
    push, gaps = {"a": np.array([1.5, 0.0, 0.0])}, []
    for _ in range(300):
        model.step(push)
        states = model.state()
        gaps.append(np.hypot(*(states[1, :2] - states[0, :2])) - 0.4)
    assert min(gaps) > -1e-9
    assert states[:, 2] == pytest.approx([states[0, 2]] * 2, abs=1e-9)
    assert 16.8 * states[:, 2].sum() == pytest.approx(1.5 * 30, abs=1e-9)


def random_episode(rng):
    """A crowded world: two robots and one or two objects of any size, mass and restitution, flying about."""
    names, places, tables = ["a", "b", "u", "v"][: rng.integers(3, 5)], [], {}
    while len(places) < len(names):
        radius, place = rng.uniform(0.1, 0.4), rng.uniform(0.5, 2.5, 2)
        if all(np.hypot(*(place - other)) > radius + r + 0.01 for other, r in places):
            places.append((place, radius))
            mass, inertia = rng.uniform(1, 30), rng.uniform(0.1, 1)
            tables[names[len(places) - 1]] = {
                "start": place.tolist(),
                "radius": radius,
                "mass": mass,
                "inertia": inertia,
            }
    robots = {name: tables[name] for name in "ab"}
    objects = {name: tables[name] for name in names[2:]}
    return make_scenario(robots, objects, size=3.0, restitution=rng.uniform(0, 1))


def test_agrees_with_pymunks_model_until_chaos_takes_over():
    """Where a twin that starts 1e-13 m beside stays within 1e-9 m, both engines agree to 1e-8 m."""
    rng = np.random.default_rng(3)
    compared = impacts = episodes = 0
    for _ in range(300):
        scenario = random_episode(rng)
        ours, twin, theirs = DiscModel(scenario), DiscModel(scenario), FreeFlyerModel(scenario)
        velocities = rng.uniform(-0.5, 0.5, (len(scenario.bodies), 2))
        for model in (ours, twin, theirs):
            launch(model, velocities)
        beside = twin.state()
        beside[:, :2] += rng.choice([-1e-13, 1e-13], (len(beside), 2))
        twin.set_state(beside)
        episodes += 1
        for _ in range(20):
            controls = {name: rng.uniform(-1, 1, 3) * (1.5, 1.5, 0.5) for name in "ab"}
            hits = ours.step(controls)
            twin.step(controls)
            theirs.step(controls)
            state = ours.state()
            if np.max(np.abs(twin.state() - state)) > 1e-9:
                break
            assert np.max(np.abs(theirs.state() - state)) < 1e-8
            compared += 1
            impacts += len(hits)
    assert episodes == 300
    assert compared > 4_500
    assert impacts > 300


def test_offset_centres_of_mass_agree_with_pymunks_model():
    scenario = load_scenario("throw_and_catch").suite("hard_v0")
    ours, theirs, rng, impacts = DiscModel(scenario), FreeFlyerModel(scenario), np.random.default_rng(4), 0
    for _ in range(6):
        physics = scenario.draw(rng)
        for model in (ours, theirs):
            model.reset(physics)
        bias = rng.uniform(-1, 1, (2, 3))
        for _ in range(150):
            thrust = np.clip(bias + rng.uniform(-1, 1, (2, 3)), -1, 1) * (1.5, 1.5, 0.1)
            controls = dict(zip(scenario.robots, thrust, strict=True))
            impacts += len(ours.step(controls))
            theirs.step(controls)
        # The other engine lets offset discs overlap by 1e-10 m before it sees them touch.
        assert np.max(np.abs(ours.state() - theirs.state())) < 1e-6
    assert impacts >= 3


@pytest.mark.parametrize("model_type", [DiscModel, FreeFlyerModel])
def test_both_engines_refuse_impacts_that_do_not_end(model_type):
    """Walls a hair's breadth from a fast elastic disc make more events than are followed."""
    model = model_type(
        make_scenario(
            {"a": {"start": (0.21, 3.0)}},
            restitution=1.0,
            size=6.0,
            obstacles={"slab": {"lower": [0.4200001, 1.0], "upper": [3.0, 5.0], "solid": True}},
        )
    )
    launch(model, [(1e5, 0.0)])
    with pytest.raises(TooManyEvents, match="more than 20000 events in a control period, the last of them of a"):
        model.step({"a": np.zeros(3)})


SCRIPT = """
import numpy as np
from impact_envs.free_flyer.disc_model import DiscModel
from impact_envs.scenario import load_scenario
for suite in ("nominal", "hard"):
    scenario = load_scenario("throw_and_catch").suite(suite)
    model, rng = DiscModel(scenario), np.random.default_rng(5)
    model.reset(scenario.draw(rng))
    states = model.state()
    states[:, 2:4] = (2 * states[-1, :2] - states[:, :2] - states[0, :2]) / 2
    model.set_state(states)
    for _ in range(60):
        model.step({name: rng.uniform(-1, 1, 3) for name in scenario.robots})
    print(model.state().tobytes().hex())
"""


def test_the_source_runs_uncompiled_with_the_same_bits():
    outputs = [
        subprocess.run(
            [sys.executable, "-W", "error::RuntimeWarning", "-c", SCRIPT],
            env={**os.environ, "NUMBA_DISABLE_JIT": disabled},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for disabled in ("0", "1")
    ]
    assert len(outputs[0].split()) == 2
    assert outputs[0] == outputs[1]


def test_engine_is_chosen_by_scenario():
    scenario = load_scenario("corridor")
    assert isinstance(make_model(scenario), DiscModel)
    assert isinstance(make_model(scenario.override({"engine": "exact"})), DiscModel)
    assert isinstance(make_model(scenario.override({"engine": "pymunk"})), FreeFlyerModel)
    square = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)]
    polygon = scenario.override({"objects.pop.vertices": square})
    assert isinstance(make_model(polygon), FreeFlyerModel)
    with pytest.raises(ScenarioError, match=r'engine = "exact" takes discs, and objects\.pop is a polygon'):
        polygon.override({"engine": "exact"})
    with pytest.raises(ScenarioError, match="engine"):
        scenario.override({"engine": "mujoco"})


def test_a_mass_of_a_million_pinches_one_kilogram_as_often_as_pi_says():
    """The impacts count the digits of pi (Galperin, 2003), and none of the time that they take is lost."""
    bodies = {"a": {"start": (1.0, 3.0), "mass": 1.0}, "b": {"start": (2.0, 3.0), "mass": 1e6}}
    scenario = make_scenario(bodies, restitution=1.0)
    ends = []
    for model in (DiscModel(scenario), FreeFlyerModel(scenario)):
        launch(model, [(0.0, 0.0), (-0.2, 0.0)], restitution=1.0)
        impacts = sum(len(model.step({name: np.zeros(3) for name in scenario.robots})) for _ in range(200))
        assert impacts == 3141
        ends.append(model.state())
    assert ends[0][:, :4] == pytest.approx(ends[1][:, :4], abs=1e-6)
    # The heavy one turns where the light one is pinched, at three radii from the wall, and goes back as it came.
    assert ends[0][1, 2] == pytest.approx(0.2, abs=1e-6)
    assert ends[0][1, 0] == pytest.approx(0.6 + 0.2 * (20.0 - 7.0), abs=1e-3)
