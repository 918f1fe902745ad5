"""Facts of physics of the floating manipulator and its box."""

import math
import pickle
import tomllib
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

import impact_envs
from impact_envs.errors import InputError
from impact_envs.floating_manipulator.model import FloatingManipulatorModel
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario

FOLDER = Path(impact_envs.__file__).parent / "floating_manipulator"
TIP, BOX = -3, -2  # rows of the state
BASE = {"mass": 5.0, "inertia": 2.0833, "mount": [0.905, -0.391]}


def load(name="floating_manipulator", **tables):
    data = tomllib.loads(next(FOLDER.rglob(f"{name}.toml")).read_text())
    return FloatingManipulatorScenario.model_validate({"name": name, **data, "requirements": {}, **tables})


def make_model(scenario=None, **physics):
    scenario = scenario or load()
    model = FloatingManipulatorModel(scenario)
    model.reset(replace(scenario.draw(np.random.default_rng(0)), **physics))
    return model


def is_pushing(model):
    """Whether the tip stays at the box: where it only bounces, it is not that near at the end of a control period."""
    return abs(model.gap) < 1e-9


def put_box_before_tip(model, turn=0.0, gap=0.05, aside=0.0):
    """Put the box so that the tip looks at one of its faces, and return the outward normal of that face."""
    states = model.state()
    normal = np.array([math.cos(turn), math.sin(turn)])
    along = np.array([-normal[1], normal[0]])
    states[BOX, :2] = states[TIP, :2] - (0.5 + model.scenario.load.radius + gap) * normal + aside * along
    states[BOX, 4] = turn
    model.set_state(states)
    return normal


def throw(model, seed, normal):
    """Give everything random rates that bring the tip to the box."""
    rng = np.random.default_rng(seed)
    states = model.state()
    states[0, 2:4], states[:4, 5] = rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.2, 0.2, 4)
    states[BOX, 2:4], states[BOX, 5] = rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.2, 0.2)
    model.set_state(states)
    states = model.state()
    closing = normal @ (states[TIP, 2:4] - states[BOX, 2:4])
    states[BOX, 2:4] += (closing + 0.3) * normal
    model.set_state(states)


def idle(model):
    return {agent: np.zeros(len(model.scenario.links) if agent == "arm" else 3) for agent in model.scenario.agents}


def press_towards_box(model, force):
    """Joint torques J' F of a force at the tip towards the box."""
    q, _ = model.coordinates()
    headings, J = np.cumsum(q[2:])[1:], np.zeros((2, 3))
    for k in range(3):
        J[:, k] = sum(2.0 * np.array([-math.sin(a), math.cos(a)]) for a in headings[k:])
    states = model.state()
    way = states[BOX, :2] - states[TIP, :2]
    return {"arm": J.T @ (force * way / np.linalg.norm(way))}


# ---------------------------------------------------------------------------------------------------- flight


def test_coast_keeps_momenta_and_energy():
    model = make_model()
    states = model.state()
    states[0, 2:4], states[:4, 5] = (0.13, -0.06), (0.03, 0.04, -0.08, 0.05)
    states[BOX, 2:4], states[BOX, 5] = (-0.24, 0.0), 0.27
    model.set_state(states)
    momenta, energies = model.momenta(), model.energies()
    for _ in range(4460):  # 22.3 s
        assert model.step(idle(model)) == []
        assert not model.torques.any()
    np.testing.assert_allclose(model.momenta(), momenta, atol=1e-12)
    np.testing.assert_allclose(model.energies(), energies, atol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 6])
def test_arm_may_have_any_number_of_links(n):
    link = load().links["link_1"].model_dump()
    arm = {"goal": [3.0, 0.0], "joints": [0.3] * n}
    model = make_model(load(links={f"part_{k}": link for k in range(n)}, arm=arm, base={"start": [20.0, 5.0], **BASE}))
    states = model.state()
    states[: n + 1, 5] = np.linspace(0.05, 0.2, n + 1)
    model.set_state(states)
    momenta, energies = model.momenta(), model.energies()
    for _ in range(600):
        model.step({"arm": np.zeros(n)})
    np.testing.assert_allclose(model.momenta(), momenta, atol=1e-11)
    np.testing.assert_allclose(model.energies(), energies, atol=1e-11)
    np.testing.assert_array_equal(model.state().shape, (n + 4, 6))


def test_torques_of_joints_give_energy_but_no_momentum():
    model, rng = make_model(), np.random.default_rng(1)
    states = model.state()
    states[BOX, :2] = 50.0, 50.0
    model.set_state(states)
    for _ in range(400):
        before, q = model.energies().sum(), model.coordinates()[0]
        model.step({"arm": rng.uniform(-10, 10, 3)})
        work = model.torques @ (model.coordinates()[0] - q)[3:]
        assert model.energies().sum() - before == pytest.approx(work, abs=1e-9)
    np.testing.assert_allclose(model.momenta(), 0.0, atol=1e-9)
    assert model.energies()[0] > 0.01


def test_thrusters_and_wheel_change_momenta_by_their_impulse():
    model = make_model(load("floating_manipulator_thrusters"))
    rng, period = np.random.default_rng(2), 0.005
    for _ in range(100):
        before, q = model.momenta()[0], model.coordinates()[0]
        model.step({"arm": rng.uniform(-5, 5, 3), "base": rng.uniform(-30, 30, 3) * (0.05, 0.05, 1.0)})
        fx, fy, torque = model.base_forces
        assert set(np.abs([fx, fy])) <= {0.0, 50.0}
        change = model.momenta()[0] - before
        np.testing.assert_allclose(change[:2], [fx * period, fy * period], atol=1e-9)
        x, y = (q[:2] + model.coordinates()[0][:2]) / 2
        assert change[2] == pytest.approx((torque + x * fy - y * fx) * period, abs=1e-3)
    assert model.wheel_momentum != 0.0


def test_wheel_takes_up_what_it_gives():
    model = make_model(load("floating_manipulator_thrusters"))
    for _ in range(60):
        model.step({"arm": np.zeros(3), "base": np.array([0.9, -1.0, 7.0])})  # thrusters in their dead zone
    assert model.momenta()[0, 2] + model.wheel_momentum == pytest.approx(0.0, abs=1e-10)
    assert model.wheel_momentum < -0.5


def test_motors_obey_their_speed_torque_line():
    model = make_model()
    states = model.state()
    states[1:4, 5] = 0.27, 0.27, 0.0  # joint rates: 0.27, 0, -0.27 of at most 0.54
    model.set_state(states)
    model.step({"arm": np.array([100.0, 100.0, 100.0])})
    np.testing.assert_allclose(model.torques, [7.0, 14.0, 21.0], atol=1e-9)
    model.set_state(states)
    model.step({"arm": np.array([-100.0, -100.0, -100.0])})
    np.testing.assert_allclose(model.torques, [-21.0, -14.0, -7.0], atol=1e-9)


# --------------------------------------------------------------------------------------------------- impacts


def collide(e, seed):
    """One collision of a thrown manipulator with a turned, moving box."""
    model = make_model(restitution=e)
    normal = put_box_before_tip(model, turn=0.4, aside=0.2)
    throw(model, seed, normal)
    before = model.momenta().sum(axis=0), model.energies().sum()
    for _ in range(200):
        if model.step(idle(model)):
            return model, model.collisions[0], before
    raise AssertionError("no impact")


@pytest.mark.parametrize("e", [0.0, 0.3, 0.5, 0.8, 1.0])
def test_impact_keeps_momentum_reverses_speed_and_loses_what_restitution_says(e):
    for seed in range(5):
        model, collision, (momentum, _) = collide(e, seed)
        np.testing.assert_allclose(model.momenta().sum(axis=0), momentum, atol=1e-9)
        chain, physics, impact = model.physics.chain, model.physics, collision.impact
        box, normal = collision.box, np.array(impact.normal)
        before = momenta_and_energy(chain, physics, collision.q, collision.v_minus, box, collision.box_minus)
        after = momenta_and_energy(chain, physics, collision.q, collision.v_plus, box, collision.box_plus)
        np.testing.assert_allclose(after[:3], before[:3], atol=1e-12)
        m_eff = np.array(impact.impulse) @ normal / ((1 + e) * impact.speed)
        assert before[3] - after[3] == pytest.approx((1 - e**2) * m_eff * impact.speed**2 / 2, abs=1e-12)
        arm = np.array(impact.point) - box[:2]
        for v, u, speed in (
            (collision.v_minus, collision.box_minus, impact.speed),
            (collision.v_plus, collision.box_plus, -e * impact.speed),
        ):
            closing = normal @ (tip_velocity(collision.q, v, chain.mount) - u[:2] - u[2] * np.array([-arm[1], arm[0]]))
            assert closing == pytest.approx(speed, abs=1e-12)


def tip_velocity(q, v, mount):
    """Velocity of the tip of three links of 2 m."""
    c, s = math.cos(q[2]), math.sin(q[2])
    d = np.array([[c, -s], [s, c]]) @ mount
    headings, rates = np.cumsum(q[2:])[1:], np.cumsum(v[2:])[1:]
    velocity = v[:2] + v[2] * np.array([-d[1], d[0]])
    for heading, rate in zip(headings, rates, strict=True):
        velocity = velocity + 2 * rate * np.array([-math.sin(heading), math.cos(heading)])
    return velocity


def momenta_and_energy(chain, physics, q, v, box, u):
    """The momentum and energy of manipulator and box, from the velocity of every body."""
    headings, rates = np.cumsum(q[2:]), np.cumsum(v[2:])
    masses, inertias = [5.0, 2.0, 2.0, 2.0, 1.0], [2.0833, 0.6667, 0.6667, 0.6667, 0.0]
    c, s = math.cos(q[2]), math.sin(q[2])
    d = np.array([[c, -s], [s, c]]) @ chain.mount
    joint, speed = q[:2] + d, v[:2] + v[2] * np.array([-d[1], d[0]])
    places, speeds, turns = [q[:2]], [v[:2]], [v[2]]
    for k in range(1, 4):
        along = np.array([math.cos(headings[k]), math.sin(headings[k])])
        across = rates[k] * np.array([-along[1], along[0]])
        places.append(joint + along)
        speeds.append(speed + across)
        turns.append(rates[k])
        joint, speed = joint + 2 * along, speed + 2 * across
    places += [joint, box[:2]]
    speeds += [speed, u[:2]]
    turns += [0.0, u[2]]
    masses, inertias = [*masses, physics.box_mass], [*inertias, physics.box_inertia]
    P, L, T = np.zeros(2), 0.0, 0.0
    for m, inertia, x, dx, turn in zip(masses, inertias, places, speeds, turns, strict=True):
        P += m * dx
        L += inertia * turn + m * (x[0] * dx[1] - x[1] * dx[0])
        T += (m * dx @ dx + inertia * turn**2) / 2
    return np.array([*P, L, T])


@pytest.mark.parametrize("seed", range(4))
def test_elastic_impact_solves_the_papers_momentum_and_energy_equations(seed):
    # Nekoo, Sharf & Ollero, Eqs. 16 to 18: unknown are the impulse along the normal and the box's velocities.
    model, collision, _ = collide(1.0, seed)
    chain, physics = model.physics.chain, model.physics
    q, impact = collision.q, collision.impact
    normal, box = np.array(impact.normal), collision.box
    arm = np.array(impact.point) - box[:2]
    before = momenta_and_energy(chain, physics, q, collision.v_minus, box, collision.box_minus)
    after = momenta_and_energy(chain, physics, q, collision.v_plus, box, collision.box_plus)
    np.testing.assert_allclose(after, before, atol=1e-12)

    response = (collision.v_plus - collision.v_minus) / (np.array(impact.impulse) @ normal)

    def residual(x):
        v = collision.v_minus + x[0] * response
        return momenta_and_energy(chain, physics, q, v, box, x[1:]) - before

    guess = np.array([1.7 * np.array(impact.impulse) @ normal, *(collision.box_plus + 0.1)])
    found = root(residual, guess, tol=1e-14)
    wanted = [np.array(impact.impulse) @ normal, *collision.box_plus]
    np.testing.assert_allclose(found.x, wanted, atol=1e-12)
    lever = arm[0] * normal[1] - arm[1] * normal[0]
    assert collision.box_plus[2] - collision.box_minus[2] == pytest.approx(wanted[0] * lever / physics.box_inertia)


# ------------------------------------------------------------------------------- independent integration


def lagrangian_dynamics():
    """Accelerations of the paper's manipulator by symbolic differentiation of its energy."""
    q, v, tau = ca.SX.sym("q", 6), ca.SX.sym("v", 6), ca.SX.sym("tau", 3)
    turn = ca.vertcat(ca.horzcat(ca.cos(q[2]), -ca.sin(q[2])), ca.horzcat(ca.sin(q[2]), ca.cos(q[2])))
    joint, heading = q[:2] + turn @ ca.DM([0.905, -0.391]), q[2]
    bodies = [(5.0, 2.0833, q[:2], heading)]
    for k in range(3):
        heading = heading + q[3 + k]
        along = ca.vertcat(ca.cos(heading), ca.sin(heading))
        bodies.append((2.0, 0.6667, joint + along, heading))
        joint = joint + 2 * along
    bodies.append((1.0, 0.0, joint, heading))
    energy = 0
    for mass, inertia, place, angle in bodies:
        speed = ca.jtimes(place, q, v)
        energy += (mass * ca.dot(speed, speed) + inertia * ca.jtimes(angle, q, v) ** 2) / 2
    M = ca.hessian(energy, v)[0]
    bias = ca.jtimes(ca.gradient(energy, v), q, v) - ca.gradient(energy, q)
    a = ca.solve(M, ca.vertcat(0, 0, 0, tau) - bias)
    return ca.Function("a", [q, v, tau], [a]), ca.Function("tip", [q, v], [joint, ca.jacobian(joint, q), M])


def reference_collisions(start, held, box, e, period, radius, count):
    """States just before the first impacts, by DOP853 and a saddle-point system; a face of the box is hit."""
    acceleration, tip = lagrangian_dynamics()
    y, u, box, found = np.concatenate([start, np.zeros(6)]), np.zeros(3), np.array(box, dtype=float), []

    def geometry(z, pose):
        place, J, M = (np.array(part) for part in tip(z[:6], z[6:]))
        c, s = math.cos(pose[2]), math.sin(pose[2])
        local = np.array([[c, s], [-s, c]]) @ (place[:, 0] - pose[:2])
        axis = int(np.argmax(np.abs(local)))
        n = np.sign(local[axis]) * np.array([[c, s], [-s, c]])[axis]
        return abs(local[axis]) - 0.5 - radius, n, place[:, 0], J, M

    for k, tau in enumerate(held):
        t, end = k * period, (k + 1) * period
        while t < end:

            def flow(_, z, tau=tau):
                return np.concatenate([z[6:], np.array(acceleration(z[:6], z[6:], tau))[:, 0]])

            def gap(now, z, t=t, box=box, u=u):
                return geometry(z, box + (now - t) * u)[0]

            gap.terminal, gap.direction = True, -1
            out = solve_ivp(flow, (t, end), y, "DOP853", events=gap, rtol=1e-12, atol=1e-13)
            box, t, y = box + (out.t[-1] - t) * u, out.t[-1], out.y[:, -1]
            if out.status == 1:
                found.append((t, y[:6].copy(), y[6:].copy()))
                if len(found) == count:
                    return found
                _, n, place, J, M = geometry(y, box)
                arm = place - box[:2]
                row = np.concatenate([n @ J, -n, [-(arm[0] * n[1] - arm[1] * n[0])]])
                masses = np.diag([0.0] * 6 + [5.0, 5.0, 0.8333])
                masses[:6, :6] = M
                saddle = np.block([[masses, -row[:, None]], [row[None], np.zeros((1, 1))]])
                rates = np.concatenate([y[6:], u])
                after = np.linalg.solve(saddle, np.append(masses @ rates, -e * row @ rates))
                y, u = np.concatenate([y[:6], after[:6]]), after[6:9]
    return found


@pytest.mark.parametrize(("e", "turn", "count"), [(0.5, math.pi - 0.3, 2), (0.3, math.pi + 0.2, 3)])
def test_impacts_agree_with_an_independent_integration(e, turn, count):
    model = make_model(restitution=e)
    put_box_before_tip(model, turn=turn, gap=0.2, aside=0.1)
    start, box = model.coordinates()[0], model.state()[BOX, [0, 1, 4]]
    held, collisions = [], []
    for _ in range(600):
        model.step(press_towards_box(model, 3.0))
        held.append(model.torques)
        collisions += model.collisions
        if len(collisions) >= count:
            break
    wanted = reference_collisions(start, np.array(held), box, e, 0.005, 0.009, count)
    assert len(collisions) == count
    for collision, (t, q, v) in zip(collisions, wanted, strict=True):
        assert collision.impact.time == pytest.approx(t, abs=1e-8)
        np.testing.assert_allclose(collision.q, q, atol=1e-6)
        np.testing.assert_allclose(collision.v_minus, v, atol=1e-6)


# --------------------------------------------------------------------------------------------- repeated contact


@pytest.mark.parametrize(
    ("e", "turn", "impacts", "steps"),
    [
        (0.0, math.pi, 1, 100),
        (0.0, math.pi - 0.6, 1, 100),
        (0.3, math.pi, 4, 100),
        (0.3, math.pi - 0.6, 4, 60),
        (0.8, math.pi, 4, 0),
    ],
)
def test_pressing_on_a_moving_box_neither_penetrates_nor_invents_momentum(e, turn, impacts, steps):
    model = make_model(restitution=e)
    put_box_before_tip(model, turn=turn, gap=0.02, aside=0.1)
    pushed, count, smallest = 0, 0, math.inf
    for _ in range(500):
        before, q, touched = model.energies().sum(), model.coordinates()[0], is_pushing(model)
        count += len(model.step(press_towards_box(model, 3.0)))
        pushed += is_pushing(model)
        smallest = min(smallest, model.gap)
        work = model.torques @ (model.coordinates()[0] - q)[3:]
        gain = model.energies().sum() - before
        if touched and is_pushing(model):
            assert abs(model.gap) < 1e-12
            assert gain == pytest.approx(work, abs=1e-9)
        else:
            assert gain <= work + 1e-9
    assert count >= impacts
    assert pushed >= steps
    assert smallest > -1e-11
    np.testing.assert_allclose(model.momenta().sum(axis=0), 0.0, atol=1e-8)
    assert np.linalg.norm(model.momenta()[1, :2]) > 1.0


def test_box_hit_again_after_it_has_turned_is_met_at_its_present_face():
    model = make_model(restitution=0.3)
    put_box_before_tip(model, turn=math.pi - 0.3, gap=0.02, aside=0.3)
    impacts = []
    for _ in range(800):
        impacts += model.step(press_towards_box(model, 3.0))
    assert len(impacts) > 3
    assert math.dist(impacts[0].normal, impacts[-1].normal) > 0.5
    for impact in impacts:
        assert np.array(impact.impulse) @ np.array(impact.normal) > 0
        assert math.hypot(*impact.normal) == pytest.approx(1.0)


@pytest.mark.parametrize("radius", [0.009, 0.001])
def test_any_contact_keeps_tip_and_box_apart_and_gains_nothing(radius):
    # Boxes that come from anywhere, spin, and are met at faces and corners, pressed on and let go.
    rng, scenario = np.random.default_rng(7), load(load={"mass": 1.0, "radius": radius})
    impacts = pushed = 0
    for _ in range(25):
        model = make_model(scenario, restitution=float(rng.choice([0.0, 0.2, 0.6, 1.0])))
        put_box_before_tip(model, turn=rng.uniform(0, 6), gap=rng.uniform(0.001, 0.2), aside=rng.uniform(-0.45, 0.45))
        states = model.state()
        states[BOX, 2:4], states[BOX, 5] = 0.5 * rng.normal(size=2), rng.normal()
        states[:4, 5] = 0.2 * rng.normal(size=4)
        model.set_state(states)
        momenta = model.momenta().sum(axis=0)
        for _ in range(200):
            before, q = model.energies().sum(), model.coordinates()[0]
            impacts += len(model.step(press_towards_box(model, rng.uniform(-5, 15))))
            pushed += is_pushing(model)
            work = model.torques @ (model.coordinates()[0] - q)[3:]
            assert model.gap > -1e-11
            assert model.energies().sum() - before <= work + 1e-9
        np.testing.assert_allclose(model.momenta().sum(axis=0), momenta, atol=1e-8)
    assert impacts > 20
    assert pushed > 50


# -------------------------------------------------------------------------------------------- state and errors


def busy_model():
    model = make_model(load("floating_manipulator_thrusters"), restitution=0.0)
    put_box_before_tip(model, turn=math.pi, gap=0.01, aside=0.1)
    return model


def drive(model, seed, steps):
    rng, impacts = np.random.default_rng(seed), []
    for _ in range(steps):
        impacts += model.step({**press_towards_box(model, 4.0), "base": rng.uniform(-0.9, 0.9, 3)})
    return impacts, model.state().tobytes()


def test_reset_and_pickle_go_on_bit_for_bit():
    model = busy_model()
    first = drive(model, 1, 100)
    assert first[0]
    assert is_pushing(model)
    twin = pickle.loads(pickle.dumps(model))
    assert drive(model, 2, 50) == drive(twin, 2, 50)
    assert drive(busy_model(), 1, 100) == first
    model.reset(model.physics)
    assert model.time == 0.0
    assert not is_pushing(model)


def test_state_can_be_put_back():
    model = busy_model()
    drive(model, 3, 50)
    states = model.state()
    assert states.shape == (len(model.scenario.bodies), 6)
    drive(model, 4, 20)
    model.set_state(states)
    np.testing.assert_allclose(model.state(), states, atol=1e-12)


def test_rows_of_the_state_follow_from_each_other():
    model = make_model()
    row, end = model.state(), model.state()[TIP]
    np.testing.assert_allclose(end[:2], [7.5, 1.5], atol=1e-12)
    assert row[3, 4] == pytest.approx(0.1)
    np.testing.assert_allclose(end[:2], row[3, :2] + np.array([math.cos(0.1), math.sin(0.1)]), atol=1e-12)


@pytest.mark.parametrize(
    ("controls", "word"),
    [
        ({}, "arm"),
        ({"arm": np.zeros(3), "base": np.zeros(3)}, "base"),
        ({"arm": np.zeros(2)}, "3 finite numbers"),
        ({"arm": np.array([0.0, np.nan, 0.0])}, "3 finite numbers"),
    ],
)
def test_bad_controls_are_said_in_one_line(controls, word):
    with pytest.raises(InputError, match=word) as error:
        make_model().step(controls)
    assert "\n" not in str(error.value)
