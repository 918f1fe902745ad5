"""State estimation of robots and objects: Kalman filters over free flight, re-opened at contacts; compiled.

One filter serves every body: position, velocity and a constant unknown acceleration (drift) per axis, and the offset
of the centre of mass; see `world_memory.FILTER` and `offset`.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.free_flyer.sensing import BODY_SIZE, OMEGA, VX, VY, X, Y, find_contact_place
from impact_envs.physics.impact import compute_velocity_gain
from planners.free_flyer.belief.drift import find_motion, let_drift_change, mix_variance, weigh_drift
from planners.free_flyer.belief.impact_parameters import compute_pair_gain, get_pair, learn_velocity_error
from planners.free_flyer.belief.offset import (
    LEAST,
    compute_direction,
    compute_lever,
    correct_centre_velocity,
    extrapolate_swing,
    find_swing,
    get_offset,
    open_offset,
    swing_centre,
)
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.readings import (
    EXPECTED,
    MISSING,
    REJECTED,
    SURPRISING,
    is_speed_possible,
    judge_reading,
    open_tracks,
)
from planners.free_flyer.belief.thruster import learn_thrust
from planners.free_flyer.belief.world_memory import BLANK_FILTER, NOBODY, UNKNOWN, WorldMemory
from planners.measurement import LARGEST


@compiled
def predict_state(z: np.record, ux: float, uy: float, h: float, unmodelled: float) -> None:
    """Predict a filter in place: p += h v + h^2/2 (a + u), v += h (a + u).

    Args:
        z: a FILTER.
        ux, uy: known acceleration [m/s^2].
        h: time step [s].
        unmodelled: standard deviation of an acceleration held over the step [m/s^2].
    """
    for axis, u in ((0, ux), (1, uy)):
        a = z.drift[axis] + u
        z.position[axis] += h * (z.velocity[axis] + h / 2 * a)
        z.velocity[axis] += h * a
    pp, pv, pa, vv, va, aa = z.P_pp, z.P_pv, z.P_pa, z.P_vv, z.P_va, z.P_aa
    q = unmodelled * unmodelled * h * h
    z.P_pp = pp + 2 * h * pv.real + h * h * (pa.real + vv) + h**3 * va.real + h**4 / 4 * aa + q * h * h / 4
    across = pv.imag + h * pa.imag + h * h / 2 * va.imag
    z.P_pv = complex(pv.real + h * (pa.real + vv) + 1.5 * h * h * va.real + h**3 / 2 * aa + q * h / 2, across)
    z.P_pa = complex(pa.real + h * va.real + h * h / 2 * aa, pa.imag + h * va.imag)
    z.P_vv = vv + 2 * h * va.real + h * h * aa + q
    z.P_va = complex(va.real + h * aa, va.imag)
    if z.P_dd > 0.0:
        z.P_pd += h * (z.P_vd + h / 2 * z.P_ad)
        z.P_vd += h * z.P_ad


@compiled
def correct_position(z: np.record, x: float, y: float, variance: float) -> None:
    """Update a filter in place by a measured position of the geometric centre.

    Args:
        z: a FILTER.
        x, y: measured position [m].
        variance: of the measurement per axis, above zero [m^2].
    """
    if z.P_aa == 0.0 and z.P_dd == 0.0:
        # A robot: the same numbers without complex ones.
        p, c = z.P_pp, z.P_pv.real
        total, left = p + variance, variance / (p + variance)
        move_state(z, (x - z.position[0]) / total, (y - z.position[1]) / total, p, c)
        z.P_vv = max(z.P_vv - c * c / total, 0.0)
        z.P_pp, z.P_pv = p * left, complex(c * left, 0.0)
        return
    pp, pv, pa, pd = z.P_pp, z.P_pv, z.P_pa, z.P_pd
    vp, ap, total = pv.conjugate(), pa.conjugate(), pp + variance
    innovation = complex((x - z.position[0]) / total, (y - z.position[1]) / total)
    add_change(z.position, pp * innovation)
    add_change(z.velocity, vp * innovation)
    add_change(z.drift, ap * innovation)
    left = variance / total
    z.P_vv = max(z.P_vv - (vp * pv).real / total, 0.0)
    z.P_va -= divide(vp * pa, total)
    z.P_aa = max(z.P_aa - (ap * pa).real / total, 0.0)
    z.P_pp, z.P_pv, z.P_pa = pp * left, pv * left, pa * left
    if z.P_dd > 0.0:
        add_change(z.offset, pd.conjugate() * innovation)
        z.P_dd = max(z.P_dd - (pd.conjugate() * pd).real / total, LEAST)
        z.P_vd -= divide(vp * pd, total)
        z.P_ad -= divide(ap * pd, total)
        z.P_pd = pd * left


@inlined
def move_state(z: np.record, dx: float, dy: float, to_position: float, to_velocity: float) -> None:
    """Add multiples of a plane vector to position and velocity of a filter."""
    z.position[0] += to_position * dx
    z.position[1] += to_position * dy
    z.velocity[0] += to_velocity * dx
    z.velocity[1] += to_velocity * dy


@inlined
def add_change(state: np.ndarray, change: complex) -> None:
    """Add a plane vector to a state."""
    state[0] += change.real
    state[1] += change.imag


@inlined
def divide(value: complex, by: float) -> complex:
    """Return a complex number over a real one, without the detour over complex ones."""
    return complex(value.real / by, value.imag / by)


@compiled
def correct_velocity(z: np.record, vx: float, vy: float, variance: float) -> None:
    """Update a filter in place by a measured velocity of a body that does not turn.

    Args:
        z: a FILTER.
        vx, vy: measured velocity [m/s].
        variance: of the measurement per axis, above zero [m^2/s^2].
    """
    if z.P_aa == 0.0 and z.P_dd == 0.0:
        c, v = z.P_pv.real, z.P_vv
        total, left = v + variance, variance / (v + variance)
        move_state(z, (vx - z.velocity[0]) / total, (vy - z.velocity[1]) / total, c, v)
        z.P_pp = max(z.P_pp - c * c / total, 0.0)
        z.P_pv, z.P_vv = complex(c * left, 0.0), v * left
        return
    pv, vv, va, vd = z.P_pv, z.P_vv, z.P_va, z.P_vd
    av, total = va.conjugate(), vv + variance
    innovation = complex((vx - z.velocity[0]) / total, (vy - z.velocity[1]) / total)
    add_change(z.position, pv * innovation)
    add_change(z.velocity, vv * innovation)
    add_change(z.drift, av * innovation)
    left = variance / total
    z.P_pp = max(z.P_pp - (pv * pv.conjugate()).real / total, 0.0)
    z.P_pa -= divide(pv * va, total)
    z.P_aa = max(z.P_aa - (av * va).real / total, 0.0)
    z.P_pv, z.P_vv, z.P_va = pv * left, vv * left, va * left
    if z.P_dd > 0.0:
        add_change(z.offset, vd.conjugate() * innovation)
        z.P_dd = max(z.P_dd - (vd.conjugate() * vd).real / total, LEAST)
        z.P_pd -= divide(pv * vd, total)
        z.P_ad -= divide(av * vd, total)
        z.P_vd = vd * left


@compiled
def add_jump(z: np.record, px: float, py: float, vx: float, vy: float, sigma_p: float, sigma_v: float) -> None:
    """Add a jump to a filter in place and open its covariance.

    Args:
        z: a FILTER.
        px, py: jump of the position [m].
        vx, vy: jump of the velocity [m/s].
        sigma_p, sigma_v: standard deviation of the jump [m], [m/s].
    """
    z.position[0] += px
    z.position[1] += py
    z.velocity[0] += vx
    z.velocity[1] += vy
    z.P_pp += sigma_p * sigma_p
    z.P_vv += sigma_v * sigma_v


@compiled
def open_filters(plan: PlanTable, memory: WorldMemory, options: Options, k: int) -> None:
    """Start world k's estimates at the scenario's start states."""
    for i in range(len(plan.body)):
        z, body = memory.filter[k, i], plan.body[i]
        memory.filter[k, i] = BLANK_FILTER
        z.position, z.velocity = body.start, body.start_velocity
        z.P_pp, z.P_vv = (
            options.estimation.start_position * options.estimation.start_position + body.spread * body.spread / 3.0,
            options.estimation.start_velocity * options.estimation.start_velocity,
        )
        if options.drift and i >= plan.robots and body.keep_force == 0.0:
            z.P_aa = options.estimation.drift * options.estimation.drift
        if options.offset and i >= plan.robots:
            open_offset(z, options.estimation.offset, body.heading, body.start_rate)
        memory.heading[k, i].angle, memory.heading[k, i].rate = body.heading, body.start_rate
    open_tracks(plan, memory, k)
    sensor = memory.sensor[k]
    sensor.sigma, sensor.weight, sensor.square, sensor.samples = options.estimation.position_prior, 0.0, 0.0, 0


@inlined
def update_estimates(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, joint: np.ndarray, now: float
) -> None:
    """Update world k's estimates by one sample: predict, apply felt impacts, correct by what was measured.

    The noise of positions is learned from the objects: between contacts their acceleration is constant, so the third
    difference of their positions is pure noise of variance 20 sigma^2. What no motion explains is left out: `readings`.

    Args:
        memory: of all worlds; `touch` says afterwards who was hit.
        joint: everything measured once, shape (N, 7 n + r + 3).
        now: time of the sample [s].
    """
    h, n, r = now - memory.time[k], len(plan.body), plan.robots
    memory.time[k] = now
    for i in range(n):
        ux, uy = (memory.push[k, i, 0], memory.push[k, i, 1]) if i < r else (0.0, 0.0)
        keeps = plan.body[i].keep_force > 0.0
        unmodelled = (
            options.estimation.thrust + options.estimation.thrust_share * math.hypot(ux, uy)
            if i < r
            else options.estimation.kept
            if keeps
            else options.estimation.flight
        )
        predict_state(memory.filter[k, i], ux, uy, h, unmodelled)
        if abs(memory.heading[k, i].rate) > options.estimation.least_turn:
            let_drift_change(memory.filter[k, i], options, h)
        if now <= memory.track[k, i].doubted:
            predict_state(memory.track[k, i].old, ux, uy, h, unmodelled)
        heading, spin = memory.heading[k, i], memory.spin[k, i] if i < r else 0.0
        turn_body(memory, k, i, heading.angle + h * (heading.rate + h / 2 * spin))
        heading.rate += h * spin
    calm = True
    for i in range(r):
        memory.touch[k, i] = NOBODY
        if 0.5 < joint[k, find_contact_place(n, i)] < 1.5:
            calm = False
            other = find_nearest(plan, memory, options, k, i)
            memory.thrust[k, i].ready = now + options.thruster.settle
            memory.touch[k, i] = other
            memory.track[k, i].doubted = memory.track[k, i if other == UNKNOWN else other].doubted = -math.inf
            if other == UNKNOWN:
                add_jump(
                    memory.filter[k, i],
                    0.0,
                    0.0,
                    0.0,
                    0.0,
                    options.estimation.unseen_jump * h,
                    options.estimation.unseen_jump,
                )
            else:
                apply_impact(plan, memory, options, k, i, other, h)
    variance = memory.sensor[k].sigma * memory.sensor[k].sigma
    for i in range(n):
        z, at = memory.filter[k, i], BODY_SIZE * i
        miss = math.hypot(joint[k, at + X] - z.position[0], joint[k, at + Y] - z.position[1])
        use = judge_reading(plan, memory, options, k, i, joint, miss)
        memory.track[k, i].use = use
        if use == SURPRISING:
            add_jump(z, 0.0, 0.0, 0.0, 0.0, miss, miss / plan.period)
            if i < r:
                memory.thrust[k, i].ready = now + options.thruster.settle
        calm = calm and use != SURPRISING and use != REJECTED
    learn_noise(memory, options, k, joint, r, calm)
    variance = memory.sensor[k].sigma * memory.sensor[k].sigma
    slow = options.estimation.velocity_ratio / plan.period
    for i in range(n):
        z, at, use = memory.filter[k, i], BODY_SIZE * i, memory.track[k, i].use
        if use in (MISSING, REJECTED):
            continue
        heading, rate = memory.heading[k, i], joint[k, at + OMEGA]
        turn_body(memory, k, i, memory.track[k, i].angle)
        if abs(rate - heading.rate) <= plan.body[i].jump / plan.body[i].radius:
            heading.rate = rate
        else:
            memory.counts[k].rejected += 1
        dx, dy = joint[k, at + VX] - z.velocity[0], joint[k, at + VY] - z.velocity[1]
        turns = z.P_dd > 0.0 and heading.rate != 0.0
        if turns:
            _, _, sx, sy = find_swing(z, heading.angle, heading.rate)
            dx, dy = dx - sx, dy - sy
        square = dx * dx + dy * dy
        is_speed = is_speed_possible(plan, memory, options, k, i, square)
        if calm and is_speed:
            learn_velocity_error(memory, options, k, i, square, slow * slow * variance)
        correct_position(z, joint[k, at + X], joint[k, at + Y], variance)
        vx, vy = joint[k, at + VX], joint[k, at + VY]
        if is_speed and turns:
            correct_centre_velocity(z, vx, vy, slow * slow * variance, heading.angle, heading.rate)
        elif is_speed:
            correct_velocity(z, vx, vy, slow * slow * variance)
    for i in range(r if options.thrusters else 0):
        z, at = memory.filter[k, i], BODY_SIZE * i
        is_read = memory.track[k, i].use == EXPECTED
        x, y = (joint[k, at + X], joint[k, at + Y]) if is_read else (z.position[0], z.position[1])
        learn_thrust(memory.thrust[k, i], options, z, memory.heading[k, i].angle, x, y, memory.sensor[k].sigma, now, h)
    for i in range(r, n):
        weigh_drift(memory.filter[k, i], options)


@inlined
def turn_body(memory: WorldMemory, k: int, i: int, angle: float) -> None:
    """Turn body i to a heading; its geometric centre goes along."""
    heading = memory.heading[k, i]
    if memory.filter[k, i].P_dd > 0.0 and angle != heading.angle:
        swing_centre(memory.filter[k, i], heading.angle, angle)
        if memory.time[k] <= memory.track[k, i].doubted:
            swing_centre(memory.track[k, i].old, heading.angle, angle)
    heading.angle = angle


@compiled
def find_nearest(plan: PlanTable, memory: WorldMemory, options: Options, k: int, i: int) -> int:
    """Return the body nearest to robot i, or UNKNOWN if none is near."""
    best, found, z = options.estimation.near, UNKNOWN, memory.filter[k, i]
    for j in range(len(plan.body)):
        if j != i:
            y = memory.filter[k, j]
            gap = math.hypot(y.position[0] - z.position[0], y.position[1] - z.position[1])
            gap = gap - plan.body[i].radius - plan.body[j].radius
            if gap < best:
                best, found = gap, j
    return found


@compiled
def apply_impact(plan: PlanTable, memory: WorldMemory, options: Options, k: int, i: int, j: int, h: float) -> None:
    """Apply Eq. 6 to the estimates; the overlap after free flight tells how long ago the impact was."""
    a, b = memory.filter[k, i], memory.filter[k, j]
    x, y = b.position[0] - a.position[0], b.position[1] - a.position[1]
    distance = math.hypot(x, y)
    nx, ny = (x / distance, y / distance) if distance > 0 else (1.0, 0.0)
    vx, vy = b.velocity[0], b.velocity[1]
    if b.P_dd > 0.0:
        _, _, sx, sy = extrapolate_swing(memory, k, j, memory.time[k])
        vx, vy = vx + sx, vy + sy
    approach = max((a.velocity[0] - vx) * nx + (a.velocity[1] - vy) * ny, 0.0)
    reach = plan.body[i].radius + plan.body[j].radius
    ago = min(max(reach - distance, 0.0) / approach, h) if approach > 0.0 else 0.0
    m_a, m_b = plan.body[i].mass, plan.body[j].mass
    gain, ratio, lever = compute_velocity_gain(plan.restitution, m_a, m_b), m_b / m_a, 0.0
    angle = memory.heading[k, j].angle - ago * memory.heading[k, j].rate
    if j >= plan.robots:
        o = j - plan.robots
        lever = compute_lever(b, plan.body[j].gyration, angle, nx, ny)
        gain, ratio = compute_pair_gain(memory, k, i, o, lever), get_pair(memory, k, i, o)[1]
    # The velocities are those of the end of the step.
    approach = max(approach - ago * (memory.push[k, i, 0] * nx + memory.push[k, i, 1] * ny), 0.0)
    felt = memory.felt[k, i]
    felt.approach, felt.normal[0], felt.normal[1] = approach, nx, ny
    felt.angle, felt.lever = angle, lever
    felt.free_velocity, felt.object_variance = a.velocity, b.P_vv
    # Replace the filter's variance of the thrust by the learned one.
    felt.robot_variance = (
        max(a.P_vv - options.estimation.thrust * options.estimation.thrust * h * h, 0.0) + memory.velocity_error[k, i]
    )
    for body in (0, 1):
        change = gain * approach if body == 0 else -gain * approach * ratio
        sigma = options.estimation.untrusted_jump * abs(change) + options.estimation.unknown_jump
        dx, dy = change * nx, change * ny
        add_jump(b if body == 0 else a, ago * dx, ago * dy, dx, dy, sigma * h, sigma)


@inlined
def learn_noise(memory: WorldMemory, options: Options, k: int, joint: np.ndarray, robots: int, calm: bool) -> None:
    """Update the estimate of the noise by the third difference of the objects' positions, unless something happened."""
    sensor, objects = memory.sensor[k], memory.recent.shape[1]
    samples = sensor.samples if calm else 0
    for o in range(objects):
        recent, at = memory.recent[k, o], BODY_SIZE * (robots + o)
        x, y = joint[k, at + X], joint[k, at + Y]
        if samples >= 3:
            dx = x - 3.0 * recent[2, 0] + 3.0 * recent[1, 0] - recent[0, 0]
            dy = y - 3.0 * recent[2, 1] + 3.0 * recent[1, 1] - recent[0, 1]
            square = dx * dx + dy * dy
            if square < LARGEST * LARGEST:
                keep = 1.0 - 1.0 / options.estimation.noise_memory
                sensor.weight = keep * sensor.weight + 1.0
                sensor.square = keep * sensor.square + square / 40.0
        for i in range(2):
            recent[i, 0], recent[i, 1] = recent[i + 1, 0], recent[i + 1, 1]
        recent[2, 0], recent[2, 1] = x, y
    # The sample that came with the event is not kept.
    sensor.samples = min(samples + 1, 3) if calm else 0
    if sensor.weight > 5.0:
        sensor.sigma = max(math.sqrt(sensor.square / sensor.weight), options.estimation.position_floor)


@inlined
def extrapolate_flight(memory: WorldMemory, k: int, i: int, time: float) -> tuple[float, float, float, float]:
    """Return the position of the geometric centre and the velocity of the centre of mass of body i in flight at a time.

    Source: Verhagen & Tumova, Sec. VI, with the estimated drift and offset added.
    """
    return extrapolate_estimate(memory.filter[k, i], memory.heading[k, i], time - memory.time[k])


@compiled
def extrapolate_estimate(z: np.record, heading: np.record, h: float) -> tuple[float, float, float, float]:
    """Return what `extrapolate_flight` does a duration after a filter's and a heading's estimates.

    It is called for every point of a course that is looked at, and the arrays of all worlds take long to pass.
    """
    p, v, a = find_motion(z)
    p, v = p + h * (v + h / 2 * a), v + h * a
    if z.P_dd > 0.0:
        p += compute_turn_ahead(heading, h) * get_offset(z)
    return p.real, p.imag, v.real, v.imag


@compiled
def compute_variance(memory: WorldMemory, k: int, i: int, time: float) -> float:
    """Return the variance per axis of where body i is in free flight at a time [m^2]."""
    z, h = memory.filter[k, i], time - memory.time[k]
    pp, pv, pa, vv, va, aa = z.P_pp, z.P_pv.real, z.P_pa.real, z.P_vv, z.P_va.real, z.P_aa
    variance = pp + 2 * h * pv + h * h * (pa + vv) + h**3 * va + h**4 / 4 * aa
    drifting = z.P_pa + h * (z.P_va + h / 2 * aa)
    if z.P_dd > 0.0:
        s, pd = compute_turn_ahead(memory.heading[k, i], h), z.P_pd + h * (z.P_vd + h / 2 * z.P_ad)
        variance += 2.0 * (s * pd.conjugate()).real + (s * s.conjugate()).real * z.P_dd
        drifting += s * z.P_ad.conjugate()
    return mix_variance(z, variance, drifting)


@inlined
def compute_turn_ahead(heading: np.record, h: float) -> complex:
    """Return R(theta') - R(theta) of a body, theta' its heading after a time, as a complex number."""
    if heading.rate == 0.0:
        return complex(0.0, 0.0)
    return compute_direction(heading.angle + h * heading.rate) - compute_direction(heading.angle)
