import tomllib
from pathlib import Path

import numpy as np
import pytest

import impact_envs
from impact_envs.dual_arm.arm import compute_dynamics
from impact_envs.dual_arm.plant import (
    BOX,
    CONTACTS,
    GAP,
    GAP_RATE,
    NORMAL,
    SLIP_RATE,
    STATE,
    TANGENTIAL,
    Plant,
    advance_state,
    compute_derivative,
    make_plant,
)
from impact_envs.dual_arm.schema import DualArmScenario

PATH = Path(impact_envs.__file__).parent / "dual_arm" / "scenarios" / "dual_arm_grasp.toml"
SCENARIO = DualArmScenario.model_validate(tomllib.loads(PATH.read_text()))
PHYSICS = SCENARIO.as_believed().draw(np.random.default_rng(0))
FLEXIBLE = make_plant(SCENARIO, PHYSICS)
RIGID = FLEXIBLE._replace(flexible=False)
FREE = FLEXIBLE.table._replace(stiffness=1e-9 * FLEXIBLE.table.stiffness, damping=0.0, friction=0.0)  # no table
H = 2e-5


def derivative(plant: Plant, s: np.ndarray, tau: np.ndarray | None = None):
    ds, contacts = np.zeros(STATE), np.zeros((CONTACTS, 5))
    compute_derivative(plant, np.zeros((2, 3)) if tau is None else tau, s, ds, contacts, np.zeros(3))
    return ds, contacts


def squeezed(rng: np.random.Generator, depth: float) -> np.ndarray:
    """Return a state with both pads about on their faces of a turned, moving box."""
    box = np.array([0.02, 0.31, 0.1])
    poses = SCENARIO.contact_poses(box)
    poses[0, 0] += depth
    poses[1, 0] -= depth
    poses[:, 2] += rng.uniform(-0.03, 0.03, 2)
    q, s = SCENARIO.joint_angles(poses), np.zeros(STATE)
    s[:BOX] = np.stack([q, rng.normal(0.0, 0.5, (2, 3)), q, np.zeros((2, 3))], axis=1).ravel()
    s[BOX:] = [*box, *rng.normal(0.0, 0.3, 3)]
    return s


def run(plant: Plant, s: np.ndarray, tau: np.ndarray, steps: int, h: float = H):
    s, contacts, sums = s.copy(), np.zeros((CONTACTS, 5)), np.zeros((4, 2))
    advance_state(plant, tau, s, steps, h, np.zeros((6, STATE)), contacts, sums)
    return s, contacts, sums


def energy(plant: Plant, s: np.ndarray) -> float:
    """Return kinetic, gravitational, joint spring and pad spring energy."""
    m, inertia, g = plant.box_mass, plant.box_inertia, plant.gravity
    total = 0.5 * m * (s[BOX + 3] ** 2 + s[BOX + 4] ** 2) + 0.5 * inertia * s[BOX + 5] ** 2 + m * g * s[BOX + 1]
    for i in range(2):
        q, v, theta, rate = s[12 * i : 12 * i + 12].reshape(4, 3)
        M, h = np.zeros((3, 3)), np.zeros(3)
        compute_dynamics(plant.arms[i], q, v, M, h)
        heights = np.sin(np.cumsum(q))
        total += 0.5 * v @ M @ v + plant.arms[i, 11:14] @ heights
        if plant.flexible:
            total += 0.5 * plant.joint_stiffness @ (theta - q) ** 2 + 0.5 * plant.shaped_inertia @ rate**2
    _, contacts = derivative(plant, s)
    touching = contacts[:4, NORMAL] > 0.0
    return total + 0.5 * plant.pads.stiffness * np.sum(contacts[:4, GAP][touching] ** 2)


def test_gap_and_slip_rates_equal_finite_differences():
    rng, h = np.random.default_rng(2), 1e-7
    for depth in (0.003, -0.003):
        for _ in range(10):
            s = squeezed(rng, depth)
            ds, contacts = derivative(FLEXIBLE, s)
            ahead, behind = s.copy(), s.copy()
            places = [0, 1, 2, 12, 13, 14, 24, 25, 26]
            for sign, state in ((1.0, ahead), (-1.0, behind)):
                state[places] += sign * h * ds[places]
            gaps = (derivative(FLEXIBLE, ahead)[1] - derivative(FLEXIBLE, behind)[1])[:, GAP] / (2 * h)
            assert contacts[:, GAP_RATE] == pytest.approx(gaps, abs=1e-6)
            slips = [(along_face(ahead, k) - along_face(behind, k)) / (2 * h) for k in range(4)]
            assert contacts[:4, SLIP_RATE] == pytest.approx(np.array(slips), abs=1e-6)


def along_face(s: np.ndarray, k: int) -> float:
    """Return sigma of pad corner k: its y in the box frame."""
    i = k // 2
    a, arm = np.cumsum(s[12 * i : 12 * i + 3]), FLEXIBLE.arms[i]
    end = arm[:2] + np.array([arm[2:5] @ np.cos(a), arm[2:5] @ np.sin(a)])
    corner = end + SCENARIO.links.pad_half_height * (1 - 2 * (k % 2)) * np.array([-np.sin(a[2]), np.cos(a[2])])
    return (corner - s[BOX : BOX + 2]) @ np.array([-np.sin(s[BOX + 2]), np.cos(s[BOX + 2])])


def test_power_of_contact_is_what_its_laws_say():
    """dE/dt = sum_k F_N gap' - F_T slip' without torque: forces act on arms and box alike, friction takes."""
    rng = np.random.default_rng(3)
    plant = RIGID._replace(table=FREE)
    for _ in range(20):
        s = squeezed(rng, 0.003)
        ds, contacts = derivative(plant, s)
        h = 1e-7
        rate = (energy(plant, s + h * ds) - energy(plant, s - h * ds)) / (2 * h)
        pads = contacts[:4]
        spring = -plant.pads.stiffness * np.where(pads[:, NORMAL] > 0.0, pads[:, GAP], 0.0)
        taken = (pads[:, NORMAL] - spring) @ pads[:, GAP_RATE] - pads[:, TANGENTIAL] @ pads[:, SLIP_RATE]
        assert rate == pytest.approx(taken, abs=1e-4)
        assert (pads[:, NORMAL] > 0.0).any()
        assert taken <= 0.0
        assert np.all(pads[:, TANGENTIAL] * pads[:, SLIP_RATE] >= 0.0)


@pytest.mark.parametrize("plant", [RIGID, FLEXIBLE._replace(joint_damping=np.zeros(3))])
def test_energy_is_kept_without_contact_damping_and_torque(plant):
    plant = plant._replace(table=FREE)
    s = squeezed(np.random.default_rng(4), -0.1)
    after, contacts, _ = run(plant, s, np.zeros((2, 3)), 5000)
    assert not contacts[:4, NORMAL].any()
    assert energy(plant, after) == pytest.approx(energy(plant, s), abs=1e-6)


def test_an_impact_never_adds_energy():
    plant = RIGID._replace(table=FREE)
    s = squeezed(np.random.default_rng(5), 0.002)
    last = energy(plant, s)
    for _ in range(200):
        s, _, _ = run(plant, s, np.zeros((2, 3)), 5)
        now = energy(plant, s)
        assert now <= last + 1e-9
        last = now


def mirrored(s: np.ndarray) -> np.ndarray:
    """Return the state seen in a mirror at x = 0."""
    arms = s[:BOX].reshape(2, 4, 3)[::-1] * -1.0
    arms = arms.copy()
    arms[:, [0, 2], 0] += np.pi
    box = s[BOX:] * np.array([-1, 1, -1, -1, 1, -1])
    return np.concatenate([arms.ravel(), box])


@pytest.mark.parametrize("plant", [RIGID, FLEXIBLE])
def test_a_mirrored_scene_moves_as_the_mirror_image(plant):
    rng = np.random.default_rng(6)
    s, tau = squeezed(rng, 0.003), rng.normal(0.0, 10.0, (2, 3))
    one, contacts, _ = run(plant, s, tau, 500)
    other, seen, _ = run(plant, mirrored(s), -tau[::-1], 500)
    assert contacts[:4, NORMAL].any() or np.abs(one - s).max() > 1e-3
    assert other == pytest.approx(mirrored(one), abs=1e-9)
    assert seen[3::-1, NORMAL] == pytest.approx(contacts[:4, NORMAL], abs=1e-6)


def test_corners_above_the_box_touch_nothing():
    s = squeezed(np.random.default_rng(7), 0.003)
    s[BOX : BOX + 2] -= 0.4 * np.array([-np.sin(s[BOX + 2]), np.cos(s[BOX + 2])])
    _, contacts = derivative(FLEXIBLE, s)
    assert np.all(contacts[:4, GAP] < 0.0)
    assert not contacts[:4, NORMAL].any()


def test_the_learning_step_agrees_with_the_reference_step():
    s, tau = squeezed(np.random.default_rng(8), 0.001), np.zeros((2, 3))
    fine, _, _ = run(FLEXIBLE, s, tau, 2500, 2e-5)
    coarse, _, _ = run(FLEXIBLE, s, tau, 1000, 5e-5)
    assert coarse[BOX : BOX + 3] == pytest.approx(fine[BOX : BOX + 3], abs=2e-5)


def test_the_torque_loop_hides_the_motors_inertia():
    """Bt theta'' + tau_a = u whatever B: the loop replaces it."""
    s = squeezed(np.random.default_rng(9), -0.1)
    s[6:9] += 1e-3
    tau = np.full((2, 3), 3.0)
    heavy = FLEXIBLE._replace(motor_inertia=5.0 * FLEXIBLE.motor_inertia)
    one, other = derivative(FLEXIBLE, s, tau)[0], derivative(heavy, s, tau)[0]
    assert one == pytest.approx(other)
    K, D, shaped = FLEXIBLE.joint_stiffness, FLEXIBLE.joint_damping, FLEXIBLE.shaped_inertia
    spring = K * (s[6:9] - s[:3]) + D * (s[9:12] - s[3:6])
    assert one[9:12] == pytest.approx((tau[0] - spring) / shaped)
