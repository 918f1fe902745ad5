import tomllib
from pathlib import Path

import numpy as np
import pytest

import impact_envs
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.errors import InputError
from planners.dual_arm.control_memory import make_ante_field
from planners.dual_arm.dense_qp import get_solver, solve_clarabel, solve_daqp, solve_goldfarb_idnani
from planners.dual_arm.grasp_qp import assemble_post, relax_contacts
from planners.dual_arm.options import EXPERT
from planners.dual_arm.reference import PostField, compute_ante_velocity
from planners.dual_arm.terms import compute_terms, estimate_box, make_terms
from planners.dual_arm.torque_qp import FREE, GRASP, TorqueQP, assemble_ante, assemble_interim, make_torque_qp
from planners.errors import Infeasible
from tests.planners.dual_arm.oracle import make_gains

PATH = Path(impact_envs.__file__).parent / "dual_arm" / "scenarios" / "dual_arm_grasp.toml"
SCENARIO = DualArmScenario.model_validate(tomllib.loads(PATH.read_text()))
ARMS = SCENARIO.arm_numbers()
ANTE_GAINS, INTERIM_GAINS, POST_GAINS = make_gains(SCENARIO, EXPERT.controller)
LIMITS = np.array([SCENARIO.links.torque_limits] * 2)
FIELD = make_ante_field(SCENARIO, EXPERT.controller)
POST = PostField(
    np.array([0.0, 0.3, 0.0]),
    np.array([0.0, 0.24, 0.0]),
    SCENARIO.target.array,
    kappa=4.0,
    kappa_theta=4.0,
    r_max=0.25,
    blend=True,
)


def near_impact(rng: np.random.Generator, spread: float) -> tuple[np.ndarray, np.ndarray]:
    poses = SCENARIO.contact_poses(SCENARIO.box.start.array) + spread * rng.normal(0.0, 1.0, (2, 3))
    return SCENARIO.joint_angles(poses), spread * rng.normal(0.0, 5.0, (2, 3))


def ante(q: np.ndarray, v: np.ndarray) -> TorqueQP:
    program = make_torque_qp(FREE, LIMITS)
    assemble_ante(program, make_terms(), FIELD, ANTE_GAINS, ARMS, q, v, 1.0)
    return program


def post(q: np.ndarray, v: np.ndarray) -> TorqueQP:
    program = make_torque_qp(GRASP, LIMITS)
    assemble_post(program, make_terms(), POST, POST_GAINS, ARMS, q, v, np.zeros(6))
    return program


def relaxed(program: TorqueQP) -> TorqueQP:
    """Return the slack form of a program."""
    slack = TorqueQP(*(part.copy() for part in program))
    relax_contacts(slack, EXPERT.controller.w_slack)
    return slack


def programs(seed: int) -> list[TorqueQP]:
    rng = np.random.default_rng(seed)
    states = [near_impact(rng, 0.02) for _ in range(10)]
    interim = make_torque_qp(FREE, LIMITS)
    q, v = states[0]
    integrated = SCENARIO.contact_poses(SCENARIO.box.start.array)
    assemble_interim(interim, make_terms(), FIELD, INTERIM_GAINS, ARMS, q, v, integrated, 10.0, 1e-3)
    return [ante(q, v) for q, v in states] + [interim] + [post(q, v) for q, v in states]


def solution_error(program: TorqueQP, x: np.ndarray) -> float:
    """Return how far a point is from the Karush-Kuhn-Tucker conditions, by its own active set."""
    rows = np.vstack([np.eye(6, len(x)), program.A])
    values = rows @ x
    scale = 1e-7
    upper, lower = values > program.upper - scale, values < program.lower + scale
    active = np.flatnonzero(upper | lower)
    gradient = program.H @ x + program.f
    multipliers, *_ = np.linalg.lstsq(rows[active].T, -gradient, rcond=None)
    wrong = [max(0.0, -y if upper[k] else y) for k, y in zip(active, multipliers, strict=True) if upper[k] != lower[k]]
    outside = np.maximum(values - program.upper, program.lower - values).max()
    return max(np.abs(rows[active].T @ multipliers + gradient).max(), max(wrong, default=0.0), outside)


def test_torques_equal_daqps():
    """Also where torques are at their limits, and in the slack form; the split of tangential forces has no cost."""
    at_limit = 0
    for program in programs(5):
        for limit in (70.0, 12.0):
            narrow = program._replace(lower=program.lower.copy(), upper=program.upper.copy())
            narrow.upper[:6], narrow.lower[:6] = limit, -limit
            forms = [narrow]
            if len(program.f) == GRASP[0]:
                forms = [relaxed(narrow)] + ([narrow] if limit == 70.0 else [])
            for form in forms:
                x, y = solve_goldfarb_idnani(form), solve_daqp(form)
                assert np.abs(x[:6] - y[:6]).max() < 1e-9
                at_limit += int((np.abs(x[:6]) > limit - 1e-9).sum())
    assert at_limit > 20


@pytest.mark.parametrize("name", ["goldfarb_idnani", "daqp"])
def test_solutions_agree_with_an_interior_point_method(name):
    solve = get_solver(name)
    for program in programs(0):
        x = solve(program)
        assert np.abs(x[:6] - solve_clarabel(program)[:6]).max() < 1e-5  # where Clarabel may stop: 3e-6 was seen
        assert solution_error(program, x) < 1e-5


def test_solutions_satisfy_the_equations_of_motion_and_the_cones():
    for program in programs(1):
        x = get_solver()(program)
        assert program.A[:6] @ x == pytest.approx(program.upper[6:12], abs=1e-6)
        assert np.all(np.abs(x[:6]) <= LIMITS.ravel() + 1e-6)
        if len(x) == GRASP[0]:
            normal, tangential = x[15:19], x[19:23]
            assert np.all(normal >= -1e-6)
            assert np.all(np.abs(tangential) <= SCENARIO.believed.friction * normal + 1e-6)
            weight = SCENARIO.box.mass * (x[13] + SCENARIO.gravity)
            # the four contact forces carry the box: their sum along the world's y axis is its weight and more
            rows = program.A[7, 15:23]
            assert -(rows @ x[15:23]) == pytest.approx(weight, abs=1e-5)


def test_the_interim_phase_begins_where_the_ante_phase_ended():
    """On the reference, with nothing integrated and no press, both programs ask for the same torques."""
    poses = SCENARIO.contact_poses(SCENARIO.box.start.array)
    q, terms = SCENARIO.joint_angles(poses), make_terms()
    compute_terms(ARMS, q, np.zeros((2, 3)), terms)
    v = np.array(
        [np.linalg.solve(terms.J[i], [*compute_ante_velocity(FIELD, i, *poses[i, :2]), 0.0]) for i in range(2)]
    )
    interim = make_torque_qp(FREE, LIMITS)
    assemble_interim(interim, make_terms(), FIELD, INTERIM_GAINS, ARMS, q, v, poses.copy(), 0.0, 1e-3)
    solve = get_solver()
    assert solve(interim)[:6] == pytest.approx(solve(ante(q, v))[:6], abs=1e-4)


def test_a_mirrored_state_gets_mirrored_torques():
    rng = np.random.default_rng(2)
    q, v = near_impact(rng, 0.02)
    v *= 0.0  # the slip of only one corner per pad is prescribed, and pads that turn on the box tell the two apart
    seen, seen_v = -q[::-1].copy(), -v[::-1].copy()
    seen[:, 0] += np.pi
    solve = get_solver()
    centred = POST._replace(target=np.array([0.0, 0.6, 0.0]))
    cases = ((FREE, assemble_ante, FIELD, ANTE_GAINS), (GRASP, assemble_post, centred, POST_GAINS))
    for size, build, field, gains in cases:
        one, other = make_torque_qp(size, LIMITS), make_torque_qp(size, LIMITS)
        extra = 1.0 if size is FREE else np.zeros(6)
        build(one, make_terms(), field, gains, ARMS, q, v, extra)
        build(other, make_terms(), field, gains, ARMS, seen, seen_v, extra)
        assert solve(other)[:6].reshape(2, 3) == pytest.approx(-solve(one)[:6].reshape(2, 3)[::-1], abs=1e-5)


def test_the_estimated_box_lies_between_the_pads():
    box = np.array([0.05, 0.4, 0.2])
    terms, estimate = make_terms(), np.zeros(6)
    for turns in (-1, 0, 1):
        q = SCENARIO.joint_angles(SCENARIO.contact_poses(box))
        q[1, 2] += turns * 2 * np.pi
        compute_terms(ARMS, q, np.zeros((2, 3)), terms)
        estimate_box(terms, estimate)
        assert estimate[:3] == pytest.approx(box)


def test_rigid_contacts_move_with_the_box():
    """The equalities' accelerations keep the pads on the box: gaps of a moved system stay as they are."""
    box = np.array([0.0, 0.3, 0.0])
    q = SCENARIO.joint_angles(SCENARIO.contact_poses(box))
    program = post(q, np.zeros((2, 3)))
    x = get_solver()(program)
    terms = make_terms()
    compute_terms(ARMS, q, np.zeros((2, 3)), terms)
    for i, side in enumerate((1.0, -1.0)):
        pad = terms.J[i] @ x[6 + 3 * i : 9 + 3 * i]
        lever = np.array([-side * SCENARIO.box.half_width, 0.0])
        spin = x[14]
        assert pad == pytest.approx([x[12] - spin * lever[1], x[13] + spin * lever[0], spin], abs=1e-5)


def test_the_slack_form_solves_what_has_no_solution():
    q, v = near_impact(np.random.default_rng(3), 0.02)
    program = post(q, 20.0 * v)
    for bound, sign in ((program.upper, 1.0), (program.lower, -1.0)):
        bound[:6] = sign * 5.0
    solve = get_solver()
    with pytest.raises(Infeasible):
        solve(program)
    x = solve(relaxed(program))
    assert np.all(np.abs(x[:6]) <= 5.0 + 1e-6)
    assert program.A[:9] @ x == pytest.approx(program.upper[6:15], abs=1e-5)


def test_every_slack_form_is_solved():
    """Also at rates that no torques can follow, and at no higher a cost than DAQP's."""
    rng = np.random.default_rng(5)
    for _ in range(200):
        q, v = near_impact(rng, 0.05)
        program = relaxed(post(q, 40.0 * v))
        x = solve_goldfarb_idnani(program)
        assert np.all(np.abs(x[:6]) <= LIMITS.ravel() + 1e-8)
        assert program.A[:9] @ x == pytest.approx(program.upper[6:15], abs=1e-6)
        assert (program.A[15:] @ x >= -1e-6).all()
        cost, other = (0.5 * z @ program.H @ z + program.f @ z for z in (x, solve_daqp(program)))
        assert cost <= other + 1e-9 * abs(other)


def test_the_slack_form_changes_nothing_where_contacts_can_hold():
    q, v = near_impact(np.random.default_rng(4), 0.002)
    program, solve = post(q, v), get_solver()
    heavy = relaxed(program)
    rows = program.A[9:15] @ solve(heavy) - program.upper[15:21]
    assert np.abs(rows).max() < 0.5


def test_unknown_solvers_are_refused():
    with pytest.raises(InputError, match="did you mean 'daqp'"):
        get_solver("daqq")
