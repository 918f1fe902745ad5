"""Facts of physics of the free-flyer models, the same for both engines; polygons are pymunk's alone."""

import math
import pickle

import numpy as np
import pymunk
import pytest

from impact_envs.errors import InputError
from impact_envs.free_flyer.disc_model import DiscModel
from impact_envs.free_flyer.model import FreeFlyerModel
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.truth import (
    DRIFT_X,
    DRIFT_Y,
    FADE,
    FRICTION,
    INERTIA,
    MASS,
    OFFSET_X,
    OFFSET_Y,
    RESTITUTION,
    RESTITUTION_SPEED,
)
from impact_envs.physics.convex import Disc, Polygon, compute_contact
from impact_envs.physics.impact import (
    Side,
    compute_impulse,
    compute_planar_jacobian,
    compute_restitution,
    compute_velocity_gain,
)
from impact_envs.scenario import load_scenario

FAR = ((-500.0, -500.0), (500.0, 500.0))
BODY = {"mass": 16.8, "inertia": 0.3, "radius": 0.2, "speed_limit": 10.0}


ENGINES = {"pymunk": FreeFlyerModel, "exact": DiscModel}
present = {"engine": "pymunk"}


@pytest.fixture(autouse=True, params=ENGINES)
def engine(request):
    """Run every test with both engines."""
    present["engine"] = request.param


def build(scenario):
    if present["engine"] == "exact" and scenario.has_polygons:
        pytest.skip("the exact engine takes discs only")
    return ENGINES[present["engine"]](scenario)


def box(a, b):
    return ((-a, -b), (a, -b), (a, b), (-a, b))


def make_scenario(robots, objects=(), world=FAR, obstacles=None, period=0.1):
    """Robots and objects by name; only what differs from BODY is given."""
    thrust = {"force_limit": 50.0, "torque_limit": 5.0}
    return FreeFlyerScenario.model_validate(
        {
            "name": "test",
            "domain": "free_flyer",
            "formula": f"G[0,1] {next(iter(robots))}.x <= 1000",
            "horizon": 100 * period + 1,
            "control_period": period,
            "world": {"lower": world[0], "upper": world[1]},
            "robots": {name: {**BODY, **thrust, **table} for name, table in robots.items()},
            "objects": {name: {**BODY, **table} for name, table in dict(objects).items()},
            "obstacles": obstacles or {},
            "believed": {"restitution": 0.8},
        }
    )


def change(scenario, physics, thruster_on_off=False, thruster_gain=None, **values):
    """Physics with other values: numbers of all contacts, or vectors by body name."""
    contact = {"restitution": RESTITUTION, "restitution_speed": RESTITUTION_SPEED, "friction": FRICTION}
    body = {"center_of_mass": slice(OFFSET_X, OFFSET_Y + 1), "drift": slice(DRIFT_X, DRIFT_Y + 1)}
    for key, value in values.items():
        if key in contact:
            physics.contact[contact[key]] = value
        else:
            for name, vector in value.items():
                physics.body[scenario.bodies.index(name), body[key]] = vector
    for name, gain in (thruster_gain or {}).items():
        physics.thruster[scenario.agents.index(name), :FADE] = gain.ravel()
    return physics._replace(true=physics.true.model_copy(update={"thruster_on_off": thruster_on_off}))


def make_model(scenario, velocities=None, **physics):
    """A model in a world with these physics, with given (vx, vy, omega) by body name."""
    model = build(scenario)
    model.reset(change(scenario, scenario.as_believed().draw(np.random.default_rng(0)), **physics))
    states = model.state()
    for name, (vx, vy, omega) in (velocities or {}).items():
        row = scenario.bodies.index(name)
        states[row, 2:4], states[row, 5] = (vx, vy), omega
    model.set_state(states)
    return model


def hit_at_rest(robot_mass, object_mass, v, normal, e):
    """Velocities of two discs after one hits the other, which rests, along a normal."""
    closing = v @ normal
    lost, gained = compute_velocity_gain(e, object_mass, robot_mass), compute_velocity_gain(e, robot_mass, object_mass)
    return v - lost * closing * normal, gained * closing * normal


def zero(model):
    return {name: np.zeros(3) for name in model.scenario.robots}


def run(model, seconds, controls=None):
    impacts = []
    for _ in range(round(seconds / model.scenario.control_period)):
        impacts += model.step(controls or zero(model))
    return impacts


def masses(model):
    return model.physics.body[:, MASS]


def momentum(model):
    return masses(model) @ model.state()[:, 2:4]


def energy(model):
    """Kinetic energy, of centred bodies."""
    states = model.state()
    inertias = model.physics.body[:, INERTIA]
    return (masses(model) @ np.sum(states[:, 2:4] ** 2, axis=1) + inertias @ states[:, 5] ** 2) / 2


def shapes(model):
    """Every solid thing but the world's box, as the state says."""
    scenario, shapes = model.scenario, []
    for name, (x, y, _, _, heading, _) in zip(scenario.bodies, model.state(), strict=True):
        vertices = getattr(scenario.body(name), "vertices", None)
        c, s = math.cos(heading), math.sin(heading)
        corners = tuple((x + c * p - s * q, y + s * p + c * q) for p, q in vertices or ())
        shapes.append(Polygon(corners) if vertices else Disc(x, y, scenario.body(name).radius))
    return shapes + [Polygon(area.corners) for area in scenario.obstacles.values() if area.solid]


def smallest_gap(model):
    """Smallest distance between a body and anything solid; negative means overlap."""
    solids, moving = shapes(model), len(model.scenario.bodies)
    (x0, y0), (x1, y1) = model.scenario.world.lower, model.scenario.world.upper
    gaps = [compute_contact(solids[i], other).gap for i in range(moving) for other in solids[i + 1 :]]
    for solid in solids[:moving]:
        points = [(solid.x, solid.y)] if isinstance(solid, Disc) else solid.vertices
        margin = solid.radius if isinstance(solid, Disc) else 0.0
        gaps += [min(x - x0, x1 - x, y - y0, y1 - y) - margin for x, y in points]
    return min(gaps)


def crowd(count, seed, area, polygons=False, period=0.1, world=None, **physics):
    """Bodies of random mass, size and velocity on a grid in an area; it is the world unless one is given."""
    rng = np.random.default_rng(seed)
    side = math.ceil(math.sqrt(count))
    step = (area[1][0] - area[0][0]) / side
    along = [area[0][0] + (k + 0.5) * step for k in range(side)]
    spots = [(x, y) for x in along for y in along]
    tables, velocities = {}, {}
    for k, spot in enumerate(spots[:count]):
        radius = float(rng.uniform(0.25, 0.45)) * step
        tables[f"b{k}"] = {"start": spot, "mass": float(rng.uniform(1, 20)), "radius": radius}
        if polygons and k % 2:
            tables[f"b{k}"]["vertices"] = box(0.8 * radius, 0.5 * radius)
        velocities[f"b{k}"] = (*rng.uniform(-1, 1, 2), rng.uniform(-1, 1))
    robot = {"b0": tables.pop("b0")}
    return make_model(make_scenario(robot, tables, world or area, period=period), velocities, **physics)


# ---------------------------------------------------------------------------------------------------- flight


def test_flight_under_constant_force_is_exact():
    model = make_model(make_scenario({"r": {"start": (0, 0)}}), {"r": (0.3, -0.2, 0.0)})
    force, mass = np.array([1.5, -0.7]), 16.8
    run(model, 60.0, {"r": np.array([*force, 0.0])})
    t = 60.0
    expected = np.array([0.3, -0.2]) * t + force / mass * t**2 / 2
    np.testing.assert_allclose(model.state()[0, :2], expected, rtol=1e-9)
    np.testing.assert_allclose(model.state()[0, 2:4], np.array([0.3, -0.2]) + force / mass * t, rtol=1e-9)


def test_heading_under_constant_torque_is_exact():
    model = make_model(make_scenario({"r": {"start": (0, 0), "heading": 0.4}}), {"r": (0, 0, -0.5)})
    run(model, 30.0, {"r": np.array([0.0, 0.0, 0.02])})
    alpha = 0.02 / 0.3
    assert model.state()[0, 4] == pytest.approx(0.4 - 0.5 * 30 + alpha * 30**2 / 2, rel=1e-9)
    assert model.state()[0, 5] == pytest.approx(-0.5 + alpha * 30, rel=1e-9)


def test_force_turns_with_the_body():
    # One turn under a constant body force is a circle in velocity: nothing is gained.
    omega, period = 2 * math.pi / 20, 0.1
    model = make_model(make_scenario({"r": {"start": (0, 0)}}, period=period), {"r": (0, 0, omega)})
    run(model, 5.0, {"r": np.array([1.0, 0.0, 0.0])})
    quarter = model.state()[0, 2:4]
    # A held force is the turning one up to sinc(omega period / 2).
    np.testing.assert_allclose(quarter, np.array([1.0, 1.0]) / 16.8 / omega, rtol=(omega * period) ** 2)
    run(model, 15.0, {"r": np.array([1.0, 0.0, 0.0])})
    np.testing.assert_allclose(model.state()[0, 2:4], 0, atol=1e-12)


def test_a_turning_drift_keeps_its_size_and_comes_back():
    """v over a whole turn is zero, and at half a turn twice the radius a / w of its circle."""
    size, turn, period = 1e-3, 0.2 * math.pi, 0.1
    scenario = load_scenario("throw_and_catch").override({"true.drift": size, "true.drift_turn": turn})
    model, pop = build(scenario), scenario.bodies.index("pop")
    model.reset(scenario.draw(np.random.default_rng(3)))
    speeds = [np.zeros(2)]
    for _ in range(round(2 * math.pi / turn / period)):
        model.step(zero(model))
        speeds.append(model.state()[pop, 2:4])
    pushes = np.diff(speeds, axis=0) / period
    assert np.hypot(*pushes.T) == pytest.approx(np.full(len(pushes), size), rel=1e-9)
    angles = np.unwrap(np.arctan2(pushes[:, 1], pushes[:, 0]))
    assert np.diff(angles) == pytest.approx(np.full(len(angles) - 1, turn * period), rel=1e-6)
    assert np.linalg.norm(speeds[-1]) < 1e-12
    half = np.linalg.norm(speeds[len(speeds) // 2])
    assert half == pytest.approx(2 * size / turn, rel=1e-3)


def test_a_thruster_fades_evenly():
    """The loss of speed against a sound thruster is a t^2 / 2T times its share, and others are as they were."""
    scenario = load_scenario("throw_and_catch")
    model, robot = build(scenario), scenario.robots["snap"]
    drawn = scenario.draw(np.random.default_rng(0))
    drawn.thruster[0, FADE] = 0.6 / scenario.horizon  # of snap, along +x
    model.reset(drawn)
    force = 0.05 * robot.force_limit
    pushes = []
    for _ in range(100):
        before = model.state()[0, 2:4]
        model.step({name: np.array([force, -force, 0.0]) for name in scenario.robots})
        pushes.append((model.state()[0, 2:4] - before) / scenario.control_period)
    time = np.arange(100) * scenario.control_period
    assert np.array(pushes)[:, 0] == pytest.approx(force / robot.mass * (1 - 0.6 * time / scenario.horizon), rel=1e-9)
    assert np.array(pushes)[:, 1] == pytest.approx(np.full(100, -force / robot.mass), rel=1e-9)


def test_drift_accelerates_objects_only():
    scenario = make_scenario({"r": {"start": (0, 0)}}, {"o": {"start": (5, 0)}})
    model = make_model(scenario, drift={"o": np.array([1e-3, -5e-4])})
    run(model, 10.0)
    np.testing.assert_allclose(model.state()[1, :4], [5.05, -0.025, 0.01, -0.005], atol=1e-12)
    np.testing.assert_array_equal(model.state()[0, :4], 0)


def test_offset_mass_turns_about_its_centre_of_mass():
    offset = np.array([0.03, -0.01])
    scenario = make_scenario({"r": {"start": (0, 0)}}, {"o": {"start": (3, 0)}})
    model = make_model(scenario, {"o": (0.0, 0.0, 0.8)}, center_of_mass={"o": offset})
    start = model.state()[1]
    fixed_point = start[:2] + offset
    velocity = start[2:4] + 0.8 * np.array([-offset[1], offset[0]])
    run(model, 2.0)
    x, y, vx, vy, heading, omega = model.state()[1]
    assert heading == pytest.approx(1.6)
    turn = np.array([[math.cos(1.6), -math.sin(1.6)], [math.sin(1.6), math.cos(1.6)]])
    np.testing.assert_allclose([x, y], fixed_point + 2.0 * velocity - turn @ offset, atol=1e-12)
    lever = turn @ offset
    np.testing.assert_allclose(np.array([vx, vy]) + omega * np.array([-lever[1], lever[0]]), velocity, atol=1e-12)


def test_thrust_through_the_geometric_centre_turns_an_offset_mass():
    model = make_model(make_scenario({"r": {"start": (0, 0)}}), center_of_mass={"r": np.array([0.0, 0.05])})
    model.step({"r": np.array([1.0, 0.0, 0.0])})
    assert model.state()[0, 5] == pytest.approx(0.05 * 1.0 / 0.3 * 0.1)


# ------------------------------------------------------------------------------------------------ thrusters


def test_thruster_gain_is_per_channel_and_sign():
    gain = {"r": np.array([[0.9, 1.1], [0.5, 1.0], [1.0, 0.25]])}
    model = make_model(make_scenario({"r": {"start": (0, 0)}}), thruster_gain=gain)
    model.step({"r": np.array([1.0, -1.0, -1e-3])})
    np.testing.assert_allclose(model.state()[0, [2, 3]] * 16.8 / 0.1, [0.9, -1.0], rtol=1e-5)
    assert model.state()[0, 5] == pytest.approx(-0.25e-3 / 0.3 * 0.1)


def test_commands_are_clipped_to_the_limits():
    model = make_model(make_scenario({"r": {"start": (0, 0)}}))
    model.step({"r": np.array([1e3, -1e3, 0.0])})
    np.testing.assert_allclose(model.state()[0, 2:4], np.array([5.0, -5.0]) / 16.8)


def test_on_off_thrusters_follow_the_command_to_half_a_pulse():
    model = make_model(make_scenario({"r": {"start": (0, 0)}}), thruster_on_off=True)
    rng, pulse = np.random.default_rng(3), 50.0 * 0.1
    wanted, levels = np.zeros(2), set()
    before = np.zeros(2)
    for _ in range(200):
        command = rng.uniform(-50, 50, 2)
        wanted += command * 0.1
        model.step({"r": np.array([*command, 0.0])})
        given = model.state()[0, 2:4] * 16.8
        levels |= set(np.round((given - before) / pulse, 9))
        before = given
        assert np.all(abs(wanted - given) <= pulse / 2 + 1e-9)
    assert levels == {-1.0, 0.0, 1.0}


def test_reset_forgets_what_on_off_thrusters_owe():
    model = make_model(make_scenario({"r": {"start": (0, 0)}}), thruster_on_off=True)
    histories = []
    for _ in range(2):
        model.reset(model.physics)
        history = []
        for _ in range(7):
            model.step({"r": np.array([20.0, 0.0, 0.0])})
            history.append(model.state()[0, 2])
        histories.append(history)
    assert histories[0] == histories[1]


# -------------------------------------------------------------------------------------------------- impacts


@pytest.mark.parametrize(
    ("period", "offset", "e"), [(0.1, 0.0, 1.0), (0.5, 0.5, 0.8), (0.1, 0.9, 0.5), (0.01, 0.99, 0.8)]
)
def test_oblique_disc_impact_is_the_closed_form_at_any_period(period, offset, e):
    radii, v = 0.2 + 0.15, np.array([1.0, 0.0])
    along = radii * math.sqrt(1 - offset**2)
    scenario = make_scenario(
        {"r": {"start": (-1.0, 0.0)}},
        {"o": {"start": (0.3, offset * radii), "radius": 0.15, "mass": 4.0}},
        period=period,
    )
    model = make_model(scenario, {"r": (*v, 0.0)}, restitution=e)
    impacts = run(model, 2.0)
    normal = np.array([along, offset * radii]) / radii
    plus = hit_at_rest(16.8, 4.0, v, normal, e)
    np.testing.assert_allclose(model.state()[:, 2:4], plus, atol=1e-10)
    (impact,) = impacts
    time = 1.3 - along
    assert impact.time == pytest.approx(time, abs=1e-10)
    assert (impact.a, impact.b) == ("r", "o")
    assert impact.normal == pytest.approx(tuple(normal), abs=1e-10)
    assert impact.speed == pytest.approx(normal[0], abs=1e-10)
    assert impact.impulse == pytest.approx(tuple(4.0 * plus[1]), abs=1e-10)
    expected = np.array([[-1.0 + time, 0.0], [0.3, offset * radii]]) + (2.0 - time) * np.stack(plus)
    np.testing.assert_allclose(model.state()[:, :2], expected, atol=1e-9)


@pytest.mark.parametrize("period", [0.02, 0.1, 0.5])
def test_impact_under_thrust_happens_when_and_as_computed(period):
    mass, force = 16.8, np.array([1.5, 0.4])
    scenario = make_scenario({"r": {"start": (0, 0)}}, {"o": {"start": (1.0, 0.1)}}, period=period)
    model = make_model(scenario, {"r": (0.2, 0.0, 0.0)}, restitution=0.7)
    a, v = force / mass, np.array([0.2, 0.0])
    p = np.array([-1.0, -0.1])
    roots = np.roots([a @ a / 4, v @ a, v @ v + p @ a, 2 * p @ v, p @ p - 0.16])
    time = min(roots.real[(abs(roots.imag) < 1e-12) & (roots.real > 0)])
    impacts = []
    while not impacts:
        impacts = model.step({"r": np.array([*force, 0.0])})
    assert impacts[0].time == pytest.approx(time, abs=1e-9)
    contact = p + v * time + a * time**2 / 2
    plus = hit_at_rest(mass, mass, v + a * time, -contact / 0.4, 0.7)
    np.testing.assert_allclose(model.state()[1, 2:4], plus[1], atol=1e-8)
    np.testing.assert_allclose(model.state()[0, 2:4], plus[0] + a * (model.time - time), atol=1e-8)


def test_momentum_is_kept_to_1e_12():
    model = crowd(12, 1, ((-2, -2), (2, 2)), restitution=0.9, friction=0.2, world=FAR)
    # Velocities towards the middle make them meet, far from the walls.
    states = model.state()
    states[:, 2:4] -= 0.8 * states[:, :2]
    model.set_state(states)
    before, hits = momentum(model), 0
    for _ in range(30):
        hits += len(model.step(zero(model)))
        assert np.max(abs(momentum(model) - before)) < 1e-12
    assert hits >= 20


def test_energy_is_kept_over_a_thousand_elastic_impacts():
    model = crowd(9, 2, ((-1, -1), (1, 1)), period=0.5, restitution=1.0)
    before, hits = energy(model), 0
    for _ in range(400):
        hits += len(model.step(zero(model)))
        if hits >= 1000:
            break
    assert hits >= 1000
    assert energy(model) == pytest.approx(before, rel=1e-9)
    assert smallest_gap(model) > -1e-9


@pytest.mark.parametrize("polygons", [False, True])
@pytest.mark.parametrize(("e", "friction"), [(1.0, 0.3), (0.7, 0.0), (0.7, 0.3)])
def test_energy_is_never_gained(polygons, e, friction):
    model = crowd(6, 3, ((-1, -1), (1, 1)), polygons, restitution=e, friction=friction)
    before = first = energy(model)
    for _ in range(60):
        model.step(zero(model))
        assert energy(model) <= before + 1e-9
        before = energy(model)
    assert before < 0.9 * first


def test_polygons_keep_energy_and_angular_momentum_at_full_restitution():
    start = {"o": {"start": (0.1, 0.7), "vertices": box(0.3, 0.1), "radius": 0.32, "mass": 5.0}}
    velocities = {"r": (0.02, 0.3, 0.0), "o": (0.0, -0.1, 1.3)}
    model = make_model(make_scenario({"r": {"start": (0, 0)}}, start), velocities, restitution=1.0)

    def angular(model):
        s = model.state()
        inertias = model.physics.body[:, INERTIA]
        return masses(model) @ (s[:, 0] * s[:, 3] - s[:, 1] * s[:, 2]) + inertias @ s[:, 5]

    before, spin = energy(model), angular(model)
    impacts = run(model, 4.0)
    assert impacts
    assert energy(model) == pytest.approx(before, rel=1e-9)
    assert angular(model) == pytest.approx(spin, rel=1e-9)
    assert smallest_gap(model) > -1e-9


def test_polygon_impact_is_what_pymunk_finds_with_tiny_steps():
    # An independent solver: plain pymunk at 10 us, whose error is of first order in the step.
    velocities = {"r": (0.0, 0.5, 0.0), "o": (0.05, -0.1, 0.7)}
    thing = {"start": (0.12, 0.6), "vertices": box(0.3, 0.1), "radius": 0.32, "mass": 5.0}
    model = make_model(make_scenario({"r": {"start": (0, 0)}}, {"o": thing}), velocities, restitution=0.8)
    space, twins = pymunk.Space(), []
    for name, mass, place in (("r", 16.8, (0, 0)), ("o", 5.0, (0.12, 0.6))):
        twin = pymunk.Body(mass, 0.3)
        shape = pymunk.Poly(twin, box(0.3, 0.1)) if name == "o" else pymunk.Circle(twin, 0.2)
        shape.elasticity = math.sqrt(0.8)
        twin.position, twin.velocity, twin.angular_velocity = place, velocities[name][:2], velocities[name][2]
        space.add(twin, shape)
        twins.append(twin)
    for _ in range(100_000):
        space.step(1e-5)
    assert len(run(model, 1.0)) == 1
    theirs = [(*twin.position, *twin.velocity, twin.angle, twin.angular_velocity) for twin in twins]
    np.testing.assert_allclose(model.state(), theirs, atol=2e-4)


def test_flat_boxes_bounce_straight():
    # Face on face: two points of contact, one impact, no spin.
    objects = {
        "o": {"start": (1.0, 0.0), "vertices": box(0.15, 0.1)},
        "p": {"start": (2.0, 0.0), "vertices": box(0.15, 0.1)},
    }
    model = make_model(make_scenario({"r": {"start": (-9, 0)}}, objects), {"o": (0.4, 0, 0)}, restitution=1.0)
    (impact,) = run(model, 3.0)
    np.testing.assert_allclose(model.state()[1:, 2:], [[0, 0, 0, 0], [0.4, 0, 0, 0]], atol=1e-12)
    assert impact.point == pytest.approx((1.85, 0.0), abs=1e-9)


def test_impulses_are_those_of_the_reference_law():
    model = crowd(6, 4, ((-1, -1), (1, 1)), polygons=True, restitution=0.9, restitution_speed=2.0)
    scenario, checked = model.scenario, 0
    for _ in range(60):
        before = dict(zip(scenario.bodies, model.state(), strict=True))
        impacts = model.step(zero(model))
        named = [name for impact in impacts for name in (impact.a, impact.b)]
        for impact in impacts:
            if (named.count(impact.a) > 1 and impact.a != "world") or named.count(impact.b) > 1:
                continue  # the velocity at the start of the step is not the one before this impact
            sides = []
            for name in (impact.a, impact.b):
                if name == "world":
                    continue
                x, y, vx, vy, _, omega = before[name]
                flight = impact.time - (model.time - 0.1)
                arm = np.array(impact.point) - (x + vx * flight, y + vy * flight)
                m, inertia = model.physics.body[model.scenario.bodies.index(name), [MASS, INERTIA]]
                sides.append(Side(compute_planar_jacobian(arm), np.diag([m, m, inertia]), np.array([vx, vy, omega])))
            normal = np.array(impact.normal)
            e = compute_restitution(impact.speed, 0.9, 2.0)
            if impact.a == "world":
                impulse = -compute_impulse(-normal, sides[0], None, e) * -normal
            else:
                impulse = compute_impulse(normal, sides[0], sides[1], e) * normal
            np.testing.assert_allclose(impact.impulse, impulse, atol=1e-6 * np.linalg.norm(impulse))
            checked += 1
    assert checked > 20


def test_restitution_belongs_to_the_world_and_not_to_materials():
    # The law has one e per pair; a product of two materials' would give 0.64 here.
    for objects in ({"o": {"start": (1, 0)}}, {"o": {"start": (1, 0), "vertices": box(0.1, 0.1)}}):
        model = make_model(make_scenario({"r": {"start": (0, 0)}}, objects), {"r": (0.5, 0, 0)}, restitution=0.8)
        run(model, 2.0)
        states = model.state()
        assert states[1, 2] - states[0, 2] == pytest.approx(0.8 * 0.5, abs=1e-10)


def test_restitution_may_fall_with_speed():
    for speed in (0.1, 0.5):
        model = make_model(
            make_scenario({"r": {"start": (0, 0)}}, {"o": {"start": (1, 0)}}),
            {"r": (speed, 0, 0)},
            restitution=0.9,
            restitution_speed=0.5,
        )
        run(model, 10.0)
        states = model.state()
        assert states[1, 2] - states[0, 2] == pytest.approx(0.9 * math.exp(-speed / 0.5) * speed, abs=1e-10)


def test_friction_spins_a_disc_off_a_wall_as_computed():
    world = ((-5.0, 0.0), (5.0, 5.0))
    m, inertia, r, e = 16.8, 0.3, 0.2, 0.6
    slip, down = 0.3, 0.5
    for mu in (10.0, 0.05):
        scenario = make_scenario({"r": {"start": (0, 1)}}, world=world)
        model = make_model(scenario, {"r": (slip, -down, 0.0)}, restitution=e, friction=mu)
        run(model, 2.0)
        along = -min(slip / (1 / m + r**2 / inertia), mu * (1 + e) * m * down)
        expected = [slip + along / m, e * down, r * along / inertia]
        np.testing.assert_allclose(model.state()[0, [2, 3, 5]], expected, atol=1e-10)


@pytest.mark.parametrize("gap", [0.0, 1e-3])
def test_cradle_hands_the_velocity_through(gap):
    objects = {"o": {"start": (1.0, 0)}, "p": {"start": (2.0, 0)}}
    model = make_model(make_scenario({"r": {"start": (0, 0)}}, objects), {"r": (0.5, 0, 0)}, restitution=1.0)
    states = model.state()
    states[2, 0] = 1.4 + gap
    model.set_state(states)
    impacts = run(model, 3.0)
    assert [(impact.a, impact.b) for impact in impacts] == [("r", "o"), ("o", "p")]
    np.testing.assert_allclose(model.state()[:, 2], [0, 0, 0.5], atol=1e-12)


def test_symmetric_squeeze_leaves_the_object_where_it_is():
    robots = {"r": {"start": (-1, 0), "mass": 7.0}, "s": {"start": (1, 0), "mass": 7.0, "heading": math.pi}}
    model = make_model(make_scenario(robots, {"o": {"start": (0, 0)}}), restitution=0.6)
    push = {"r": np.array([2.0, 0, 0]), "s": np.array([2.0, 0, 0])}
    impacts = run(model, 12.0, push)
    assert impacts
    states = model.state()
    np.testing.assert_allclose(states[2, :4], 0, atol=1e-9)
    np.testing.assert_allclose(states[:2, 0], [-0.4, 0.4], atol=2e-5)


def test_events_come_in_order_of_time():
    model = crowd(9, 5, ((-1, -1), (1, 1)), period=0.5, restitution=1.0)
    for step in range(20):
        times = [impact.time for impact in model.step(zero(model))]
        assert times == sorted(times)
        assert all(0.5 * step <= time <= 0.5 * (step + 1) for time in times)


# ------------------------------------------------------------------------------------ walls and tunnelling


@pytest.mark.parametrize("period", [0.1, 0.5])
def test_nothing_tunnels_at_ten_metres_per_second(period):
    rng = np.random.default_rng(6)
    thin = {"wall": {"lower": (-0.001, -0.5), "upper": (0.001, 0.5), "solid": True}}
    world = ((-2, -1), (2, 1))
    impacts = 0
    for trial in range(12):
        scenario = make_scenario({"r": {"start": (-1, 0)}}, {"o": {"start": (1, 0)}}, world, thin, period)
        angle = rng.uniform(0, 2 * math.pi, 2)
        velocities = {
            "r": (10 * math.cos(angle[0]), 10 * math.sin(angle[0]), 1.0),
            "o": (10 * math.cos(angle[1]), 10 * math.sin(angle[1]), 0.0),
        }
        model = make_model(scenario, velocities, restitution=1.0)
        for _ in range(round(1.0 / period)):
            impacts += len(model.step({"r": rng.uniform(-50, 50, 3) * (trial % 2)}))
            assert smallest_gap(model) > -1e-9
    assert impacts > 100


def test_fast_polygon_does_not_tunnel():
    thin = {"wall": {"lower": (0.999, -5), "upper": (1.001, 5), "solid": True}}
    objects = {"o": {"start": (0, 0), "vertices": box(0.15, 0.1)}}
    scenario = make_scenario({"r": {"start": (-3, 0)}}, objects, ((-5, -5), (5, 5)), thin)
    model = make_model(scenario, {"o": (10, 0.3, 3.0)}, restitution=1.0)
    before = energy(model)
    impacts = run(model, 0.3)
    assert any("wall" in (impact.a, impact.b) for impact in impacts)
    assert model.state()[1, 0] < 1.0
    assert energy(model) == pytest.approx(before, rel=1e-9)


def test_only_solid_obstacles_stop_bodies():
    for solid in (False, True):
        area = {"block": {"lower": (0.5, -0.5), "upper": (1.0, 0.5), "solid": solid}}
        scenario = make_scenario({"r": {"start": (0, 0)}}, obstacles=area)
        model = make_model(scenario, {"r": (0.5, 0, 0)}, restitution=0.8)
        impacts = run(model, 4.0)
        if solid:
            (impact,) = impacts
            assert (impact.a, impact.b, impact.normal) == ("block", "r", (-1.0, 0.0))
            assert impact.time == pytest.approx(0.6, abs=1e-10)
            assert impact.impulse == pytest.approx((-16.8 * 1.8 * 0.5, 0.0))
            assert model.state()[0, 2] == pytest.approx(-0.4)
        else:
            assert not impacts
            assert model.state()[0, 0] == pytest.approx(2.0)


def test_walls_of_the_world_stop_surfaces():
    scenario = make_scenario({"r": {"start": (0, 0)}}, world=((-1, -1), (1, 1)))
    model = make_model(scenario, {"r": (0.5, 0.25, 0)}, restitution=1.0)
    impacts = run(model, 4.0)
    assert {impact.a for impact in impacts} == {"world"}
    assert impacts[0].time == pytest.approx(0.8 / 0.5)
    assert impacts[0].point == pytest.approx((1.0, 0.4))


# ------------------------------------------------------------------------------------------ lasting contact


@pytest.mark.parametrize("e", [0.0, 0.5, 0.8])
def test_pushing_contact_settles(e):
    force, mass = 1.5, 16.8
    model = make_model(make_scenario({"r": {"start": (0, 0)}}, {"o": {"start": (0.5, 0)}}), restitution=e)
    push = {"r": np.array([force, 0, 0])}
    # Exact: first touch at t0, then bounces of geometric length, together at t0 (1 + e) / (1 - e).
    first = math.sqrt(2 * 0.1 * mass / force)
    settled = first * (1 + e) / (1 - e)
    impacts = run(model, math.ceil(settled) + 1.0, push)
    assert impacts[0].time == pytest.approx(first, abs=1e-9)
    assert impacts[-1].time <= settled
    gaps = []
    for _ in range(100):
        assert model.step(push) == []
        states = model.state()
        gaps.append(states[1, 0] - states[0, 0] - 0.4)
        assert states[1, 2] == pytest.approx(states[0, 2], abs=1e-9)
    assert min(gaps) > -1e-9
    assert max(gaps) - min(gaps) < 1e-9
    assert max(gaps) < 2e-5
    np.testing.assert_allclose(momentum(model), [force * model.time, 0], atol=1e-10)


def test_sliding_push_neither_sinks_nor_floods_events():
    # The object leaves round the robot's side; touches on the way are no impacts.
    start = (0.4 * math.cos(0.05), 0.4 * math.sin(0.05))
    model = make_model(make_scenario({"r": {"start": (0, 0)}}, {"o": {"start": start}}), restitution=0.8)
    impacts = []
    for _ in range(80):
        impacts += model.step({"r": np.array([1.5, 0, 0])})
        assert smallest_gap(model) > -1e-5
    assert impacts == []
    assert abs(model.state()[1, 3]) > 1e-3


def test_chain_pressed_against_a_wall_comes_to_rest():
    objects = {"o": {"start": (0.6, 0.0), "vertices": box(0.14, 0.14)}, "p": {"start": (1.2, 0.0)}}
    scenario = make_scenario({"r": {"start": (0, 0)}}, objects, ((-1, -1), (2, 1)))
    model = make_model(scenario, restitution=0.5, friction=0.3)
    push = {"r": np.array([5.0, 0, 0])}
    run(model, 15.0, push)
    assert [model.step(push) for _ in range(10)] == [[]] * 10
    assert smallest_gap(model) > -1e-5
    np.testing.assert_allclose(model.state()[:, 2:4], 0, atol=1e-6)


def test_friction_brakes_a_disc_pressed_along_a_wall():
    # Coulomb: m dv/dt = -mu N, I domega/dt = r mu N until it rolls.
    mu, press, m, inertia, r = 0.2, 4.0, 16.8, 0.3, 0.2
    scenario = make_scenario({"r": {"start": (0, 0.2)}}, world=((-5, 0), (5, 5)))
    model = make_model(scenario, {"r": (0.3, 0, 0)}, restitution=0.0, friction=mu)
    t = 0.5
    for _ in range(5):
        heading = model.state()[0, 4] + model.state()[0, 5] * 0.05
        model.step({"r": press * np.array([-math.sin(heading), -math.cos(heading), 0.0])})
    vx, omega = model.state()[0, [2, 5]]
    assert vx == pytest.approx(0.3 - mu * press / m * t, rel=1e-3)
    assert omega == pytest.approx(-r * mu * press / inertia * t, rel=2e-3)


# -------------------------------------------------------------------------------------- symmetry, sameness


def test_mirror_image_start_gives_mirror_image_motion():
    flip = np.array([1, -1, 1, -1, -1, -1])
    runs = []
    for sign in (1, -1):
        robots = {"r": {"start": (0, sign * 0.1), "heading": sign * 0.3}, "s": {"start": (2, sign * 0.4)}}
        objects = {"o": {"start": (1.0, 0.0)}, "p": {"start": (1.2, sign * 0.8), "vertices": box(0.14, 0.1)}}
        world = ((-1, -1.5), (3, 1.5))
        model = make_model(make_scenario(robots, objects, world), restitution=0.8, friction=0.1)
        rng, path = np.random.default_rng(7), []
        for _ in range(60):
            push = {name: rng.uniform(-20, 20, 3) * (1, 1, 0.01) for name in ("r", "s")}
            model.step({name: u * (1, sign, sign) for name, u in push.items()})
            path.append(model.state())
        runs.append(np.array(path))
    np.testing.assert_allclose(runs[0], runs[1] * flip, atol=1e-7)


def random_run(model, steps, seed):
    rng, impacts = np.random.default_rng(seed), []
    for _ in range(steps):
        impacts += model.step({name: rng.uniform(-20, 20, 3) * (1, 1, 0.1) for name in model.scenario.robots})
    return impacts


def busy_scenario():
    robots = {"r": {"start": (-0.6, 0)}, "s": {"start": (0.6, 0)}}
    objects = {"o": {"start": (0, 0)}, "p": {"start": (0, 0.6), "vertices": box(0.14, 0.1)}}
    return make_scenario(robots, objects, ((-1, -1), (1, 1)))


def test_same_inputs_give_the_same_result_bit_for_bit():
    results = []
    for _ in range(2):
        model = make_model(busy_scenario(), restitution=0.6, friction=0.2, center_of_mass={"o": np.array([0.02, 0.01])})
        results.append((random_run(model, 60, seed=8), model.state().tobytes()))
    assert results[0] == results[1]
    assert len(results[0][0]) > 5


def test_reset_starts_the_same_world_again():
    model = make_model(busy_scenario(), restitution=0.6)
    model.reset(model.physics)
    first = (random_run(model, 30, seed=9), model.state().tobytes())
    model.reset(model.physics)
    assert model.time == 0.0
    assert (random_run(model, 30, seed=9), model.state().tobytes()) == first


def test_pickled_model_goes_on_bit_for_bit_even_in_lasting_contact():
    scenario = make_scenario({"r": {"start": (0, 0)}}, {"o": {"start": (0.41, 0.03)}})
    model = make_model(scenario, restitution=0.3, friction=0.2, thruster_on_off=True)
    push = {"r": np.array([30.0, 0, 0])}
    run(model, 1.0, push)
    twin = pickle.loads(pickle.dumps(model))
    assert run(model, 1.0, push) == run(twin, 1.0, push)
    assert twin.time == model.time
    assert twin.state().tobytes() == model.state().tobytes()


def test_state_is_a_fresh_array_and_can_be_put_back():
    model = make_model(busy_scenario(), center_of_mass={"o": np.array([0.02, 0.01])})
    random_run(model, 5, seed=10)
    states = model.state()
    model.state()[:] = 0
    np.testing.assert_array_equal(model.state(), states)
    random_run(model, 5, seed=11)
    model.set_state(states)
    np.testing.assert_allclose(model.state(), states, atol=1e-15)


@pytest.mark.parametrize(
    ("controls", "word"),
    [
        ({}, "r"),
        ({"r": np.zeros(3), "x": np.zeros(3)}, "x"),
        ({"r": np.zeros(2)}, "three finite numbers"),
        ({"r": np.array([0, np.nan, 0])}, "three finite numbers"),
    ],
)
def test_bad_controls_are_said_in_one_line(controls, word):
    model = make_model(make_scenario({"r": {"start": (0, 0)}}))
    with pytest.raises(InputError, match=word) as error:
        model.step(controls)
    assert "\n" not in str(error.value)
