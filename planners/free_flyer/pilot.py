"""The compiled expert of one world of many: observe, replan the courses to the impacts, track them."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.free_flyer.sensing import BODY_SIZE
from planners.free_flyer.avoidance import keep_off
from planners.free_flyer.course import IMPACT, UNTIL, approach, evaluate_course
from planners.free_flyer.estimator import extrapolate, open_filters, update_estimates
from planners.free_flyer.options import Options
from planners.free_flyer.progress import (
    CHANGE,
    CONTACT_X,
    CONTACT_Y,
    DECIDED,
    FACTOR,
    IMPACT_INDEX,
    INSERTED,
    LAST,
    LOST,
    LQR,
    MINUS_X,
    MINUS_Y,
    N_X,
    N_Y,
    NOBODY,
    OBJECT_X,
    OBJECT_Y,
    OFF_CENTRE,
    OUTCOME,
    PLUS_X,
    PLUS_Y,
    REFERENCE_X,
    REFERENCE_Y,
    REPLANNED,
    REPLANS,
    SCALE,
    SHIFTED_PLAN,
    SOLVED,
    TIME,
    TURN,
    Progress,
    find_next_event,
    find_strike,
)
from planners.free_flyer.retiming import is_reachable, look_ahead
from planners.free_flyer.script import (
    AT,
    END,
    HOME,
    MASS,
    RADIUS,
    SPEED,
    Script,
)
from planners.free_flyer.strike import (
    REPLAN_LAST,
    REPLAN_PERIOD,
    ROUND_OFF,
    SETTLE,
    aim,
    find_due,
    hasten,
    learn_from_hits,
    remember_before,
    set_clocks,
    set_time,
    start_strikes,
    take_contact,
    take_misses,
)
from planners.free_flyer.tracking import FEEDBACK, GAIN, INPUT_LIMIT, NO_JUMP, STAGES, Workspace, solve_tracking
from planners.free_flyer.two_body import compute_velocity_gain, solve_two_body_impact

REPLAN_WINDOW = 20.0  # before an impact [s]
CENTRAL = 0.966  # cosine by which an impulse may turn to go through the centre of an object that is no disc
POSTPONEMENTS = 10  # of a second each
OFF_COURSE = 0.1  # tracking error above which a course starts from the estimated state [m]
SCALE_RANGE = 0.5  # of the logarithm of the impulse, at correction 1
ROTATION_RANGE = 0.3  # of the impulse, at correction 1 [rad]


@compiled
def start_world(script: Script, progress: Progress, options: Options, k: int) -> None:
    """Forget the last episode of world k."""
    progress.time[k] = 0.0
    open_filters(script, progress, options, k)
    start_strikes(script, progress, k)
    for i in range(progress.counts.shape[1]):
        progress.counts[k, i] = 0
    for r in range(script.robots):
        progress.push[k, r, 0] = progress.push[k, r, 1] = 0.0
        progress.shifted[k, r, 3 * STAGES] = 0.0
        for i in range(progress.course.shape[2]):
            progress.course[k, r, i] = 0.0
    set_clocks(script, progress, k, 0.0)


@compiled
def observe_world(script: Script, progress: Progress, options: Options, k: int, joint: np.ndarray) -> int:
    """Update the estimates, take note of contacts and missed impacts, look ahead.

    Args:
        script: what is followed.
        progress: of all worlds.
        options: which parts of the loop are on.
        k: world.
        joint: everything measured once, shape (N, 7 n + r + 3).

    Returns:
        The object whose coming impact's correction is due, or END.
    """
    now = joint[k, BODY_SIZE * len(script.body) + script.robots] * script.horizon
    if not math.isfinite(now):
        now = progress.time[k] + script.period
    remember_before(script, progress, k)
    update_estimates(script, progress, k, joint, now)
    for r in range(script.robots):
        if progress.touch[k, r] != NOBODY:
            take_contact(script, progress, k, r, now)
    take_misses(script, progress, options, k, now)
    learn_from_hits(script, progress, options, k, now)
    look_ahead(script, progress, options, k, now)
    return find_due(script, progress, k, now)


@compiled
def control_world(
    script: Script, progress: Progress, options: Options, workspace: Workspace, c: int, k: int, actions: np.ndarray
) -> None:
    """Replan where it is time to, and write each robot's action.

    Args:
        script: what is followed.
        progress: of all worlds.
        options: which parts of the loop are on.
        workspace: of all threads.
        c: thread.
        k: world.
        actions: body-frame forces and torque over their limits, written, shape (N, r, 3).
    """
    now = progress.time[k]
    due = find_due(script, progress, k, now)
    while due != END:
        progress.strike[k, due, DECIDED] = 1.0
        if not options.once:
            progress.strike[k, due, REPLANNED] = -math.inf
        due = find_due(script, progress, k, now)
    for r in range(script.robots):
        o = find_strike(progress, k, r)
        if o != END:
            strike = progress.strike[k, o]
            event, _, _ = find_next_event(script, progress, k, r)
            if strike[INSERTED] == 0.0 and strike[TIME] > event + ROUND_OFF:
                o = END
            elif should_replan(progress, options, k, r, o, now):
                replan(script, progress, options, k, r, o, now)
        track(script, progress, options, workspace, c, k, r, o, actions)


@compiled
def should_replan(progress: Progress, options: Options, k: int, r: int, o: int, now: float) -> bool:
    """Return whether the course of robot r to its impact on object o is to be planned anew."""
    strike = progress.strike[k, o]
    time = strike[TIME]
    settled = now >= strike[LAST] + SETTLE - ROUND_OFF
    near = time - REPLAN_WINDOW <= now + ROUND_OFF or progress.course[k, r, IMPACT] > 0.0
    due = strike[REPLANNED] == -math.inf if options.once else now >= strike[REPLANNED] + REPLAN_PERIOD - ROUND_OFF
    return settled and near and due and now <= time - REPLAN_LAST + ROUND_OFF


@compiled
def solve_strike(script: Script, progress: Progress, options: Options, k: int, r: int, o: int, now: float) -> None:
    """Solve the two-body problem of robot r's impact on object o, from the object as it is seen now."""
    strike, body = progress.strike[k, o], script.robots + o
    time = strike[TIME]
    x, y, vx, vy = extrapolate(progress, k, body, time)
    if options.drift:
        hasten(script, progress, k, o)
    wish = aim(script, progress, options, k, o)
    scale, angle = math.exp(SCALE_RANGE * strike[SCALE]), ROTATION_RANGE * strike[TURN]
    cos, sin, dx, dy = math.cos(angle), math.sin(angle), wish[0] - vx, wish[1] - vy
    dx, dy = scale * (cos * dx - sin * dy), scale * (sin * dx + cos * dy)
    dx, dy, distance = turn_to_centre(script, progress, k, o, time - now, dx, dy)
    desired = (vx + dx, vy + dy)
    normal = (strike[REFERENCE_X], strike[REFERENCE_Y])
    factor = progress.hit[k, o, FACTOR]
    solution = solve_two_body_impact(
        (x, y),
        (vx, vy),
        desired,
        (vx, vy),
        normal,
        script.body[r, MASS],
        script.body[body, MASS],
        factor * (1.0 + script.restitution) - 1.0,
        script.body[r, RADIUS] + distance,
        script.body[r, SPEED],
    )
    strike[OUTCOME], strike[SOLVED] = solution.outcome.value, 1.0
    strike[N_X], strike[N_Y] = solution.normal
    strike[CONTACT_X], strike[CONTACT_Y] = solution.contact
    strike[MINUS_X], strike[MINUS_Y] = solution.robot_minus
    strike[PLUS_X], strike[PLUS_Y] = solution.robot_plus
    strike[OBJECT_X], strike[OBJECT_Y] = solution.object_minus
    strike[CHANGE] = math.hypot(solution.object_plus[0] - vx, solution.object_plus[1] - vy)


@compiled
def replan(script: Script, progress: Progress, options: Options, k: int, r: int, o: int, now: float) -> None:
    """Plan the course of robot r to its impact on object o; a robot that lost its course may put the impact off."""
    strike = progress.strike[k, o]
    solve_strike(script, progress, options, k, r, o, now)
    begin = evaluate_course(progress.course, script.breaks, script.coefficients, k, r, now)
    z = progress.filter[k, r]
    if math.hypot(begin[0] - z[0], begin[1] - z[1]) > OFF_COURSE:
        progress.counts[k, LOST] += 1
        begin = (z[0], z[1], z[2], z[3], begin[4], begin[5])
        if options.retime:
            postpone(script, progress, options, k, r, o, now)
    time, contact = strike[TIME], (strike[CONTACT_X], strike[CONTACT_Y])
    index = int(strike[IMPACT_INDEX])
    planned = -1.0 if strike[INSERTED] > 0.0 else script.impact[index, AT]
    approach(
        progress.course,
        script.breaks,
        script.coefficients,
        k,
        r,
        now,
        begin,
        contact,
        (strike[MINUS_X], strike[MINUS_Y]),
        time,
        planned,
    )
    strike[REPLANNED] = now
    progress.counts[k, REPLANS] += 1


@compiled
def postpone(script: Script, progress: Progress, options: Options, k: int, r: int, o: int, now: float) -> None:
    """Put the impact of robot r on object o off until the robot can be there, by at most 10 s."""
    strike = progress.strike[k, o]
    for _ in range(POSTPONEMENTS):
        x, y, vx, vy = strike[CONTACT_X], strike[CONTACT_Y], strike[MINUS_X], strike[MINUS_Y]
        later = strike[TIME] + 1.0
        if later >= script.horizon or is_reachable(script, progress, k, r, x, y, vx, vy, strike[TIME] - now):
            return
        if strike[INSERTED] > 0.0:
            strike[TIME] = later
        else:
            set_time(script, progress, k, o, int(strike[IMPACT_INDEX]), later)
        solve_strike(script, progress, options, k, r, o, now)


@compiled
def turn_to_centre(
    script: Script, progress: Progress, k: int, o: int, ahead: float, dx: float, dy: float
) -> tuple[float, float, float]:
    """Return the part of a change of velocity that a hit through object o's centre can give, and how far that hit is.

    A disc takes any. Of an object that is none the nearest side or corner is hit that is there at the time; where it
    is turned away by more than 15 degrees it is counted.

    Args:
        script: what is believed.
        progress: of all worlds.
        k: world.
        o: object.
        ahead: time until the impact [s].
        dx, dy: wished change [m/s].

    Returns:
        Change [m/s], and the distance of the place of contact from the centre [m].
    """
    body = script.robots + o
    size, best, distance = math.hypot(dx, dy), -1.0, script.body[body, RADIUS]
    heading = progress.heading[k, body, 0] + ahead * progress.heading[k, body, 1]
    cos, sin, nx, ny = math.cos(heading), math.sin(heading), 0.0, 0.0
    for i in range(script.side.shape[1]):
        ux, uy, far = script.side[o, i, 0], script.side[o, i, 1], script.side[o, i, 2]
        px, py = -(cos * ux - sin * uy), -(sin * ux + cos * uy)
        cosine = (px * dx + py * dy) / max(size, 1e-12)
        if far > 0.0 and cosine > best:
            best, nx, ny, distance = cosine, px, py, far
    if best == -1.0:
        return dx, dy, distance
    if best < CENTRAL and size > 1e-9:
        progress.counts[k, OFF_CENTRE] += 1
    along = max(best, 0.0) * size
    return along * nx, along * ny, distance


@compiled
def track(
    script: Script,
    progress: Progress,
    options: Options,
    workspace: Workspace,
    c: int,
    k: int,
    r: int,
    o: int,
    actions: np.ndarray,
) -> None:
    """Write robot r's action, and remember the acceleration it should cause."""
    now, h, pilot, z = progress.time[k], script.period, script.pilot[r], progress.filter[k, r]
    heading, rate = progress.heading[k, r, 0], progress.heading[k, r, 1]
    solved = False
    if options.mpc:
        fill_reference(script, progress, workspace, c, k, r, o)
        state = workspace.state[c]
        state[0], state[1], state[2], state[3], state[4], state[5] = z[0], z[1], heading, z[2], z[3], rate
        solved = solve_tracking(workspace, c, pilot)
        shifted = progress.shifted[k, r]
        left = int(shifted[3 * STAGES])
        if solved:
            for i in range(3 * STAGES):
                shifted[i] = workspace.solution[c, i]
            left = STAGES
        elif left > 0:
            progress.counts[k, SHIFTED_PLAN] += 1
        if left > 0:
            for i in range(3):
                actions[k, r, i] = shifted[i]
            for i in range(3 * (left - 1)):
                shifted[i] = shifted[i + 3]
            shifted[3 * STAGES] = left - 1
        solved = left > 0
    if not solved:
        if options.mpc:
            progress.counts[k, LQR] += 1
        here = evaluate_course(progress.course, script.breaks, script.coefficients, k, r, now)
        ahead = evaluate_course(progress.course, script.breaks, script.coefficients, k, r, now + h)
        # World-frame acceleration: feed-forward and feedback of the axes.
        ax = (ahead[2] - here[2]) / h
        ay = (ahead[3] - here[3]) / h
        g = pilot[GAIN]
        ax -= g * (pilot[FEEDBACK] * (z[0] - here[0]) + pilot[FEEDBACK + 1] * (z[2] - here[2]))
        ay -= g * (pilot[FEEDBACK + 2] * (z[1] - here[1]) + pilot[FEEDBACK + 3] * (z[3] - here[3]))
        cos, sin = math.cos(heading), math.sin(heading)
        actions[k, r, 0] = (cos * ax + sin * ay) / g
        actions[k, r, 1] = (cos * ay - sin * ax) / g
        turn = heading - script.body[r, HOME]
        actions[k, r, 2] = -pilot[FEEDBACK + 4] * turn - pilot[FEEDBACK + 5] * rate
    if options.avoid:
        g, cos, sin = pilot[GAIN], math.cos(heading), math.sin(heading)
        ax = g * (cos * actions[k, r, 0] - sin * actions[k, r, 1])
        ay = g * (sin * actions[k, r, 0] + cos * actions[k, r, 1])
        striking = o != END and progress.course[k, r, IMPACT] > 0.0
        bx, by, _ = keep_off(script, progress, k, r, script.robots + o if striking else END, ax, ay)
        if bx != ax or by != ay:
            actions[k, r, 0], actions[k, r, 1] = (cos * bx + sin * by) / g, (cos * by - sin * bx) / g
    for i in range(3):
        limit = pilot[INPUT_LIMIT + i]
        actions[k, r, i] = min(max(actions[k, r, i] / limit, -1.0), 1.0)
    middle = heading + rate * h / 2
    cos, sin = math.cos(middle), math.sin(middle)
    fx, fy = actions[k, r, 0] * pilot[INPUT_LIMIT], actions[k, r, 1] * pilot[INPUT_LIMIT + 1]
    progress.push[k, r, 0] = (cos * fx - sin * fy) * pilot[GAIN]
    progress.push[k, r, 1] = (sin * fx + cos * fy) * pilot[GAIN]


@compiled
def fill_reference(script: Script, progress: Progress, workspace: Workspace, c: int, k: int, r: int, o: int) -> None:
    """Sample robot r's course at the nodes of the horizon, with the feed-forward forces that reproduce its velocities.

    A border between stages is moved onto an impact within the horizon.

    Source: Verhagen & Tumova, Sec. VII: Eq. 7 in the prediction at t_m = t_impact.
    """
    now, h, mass = progress.time[k], script.period, script.body[r, MASS]
    states, inputs, durations = workspace.states[c], workspace.inputs[c], workspace.durations[c]
    jump, heading = workspace.jump[c], progress.heading[k, r, 0]
    for j in range(STAGES):
        durations[j] = h
    ahead, node = progress.course[k, r, UNTIL] - now, NO_JUMP
    striking = o != END and progress.course[k, r, IMPACT] > 0.0
    if striking and ahead >= 0.0 and ahead < (STAGES - 0.5) * h:
        strike, body = progress.strike[k, o], script.robots + o
        node = min(max(math.floor(ahead / h + 0.5), 1), STAGES - 1)
        durations[node - 1] = ahead - (node - 1) * h
        durations[node] = (node + 1) * h - ahead
        m_r, m_o = script.body[r, MASS], script.body[body, MASS]
        # The robot's own jump: v+ = v- - c (n . v- - n . v_O) n with c = alpha m_O / m_R.
        gain = progress.hit[k, o, FACTOR] * compute_velocity_gain(script.restitution, m_r, m_o) * m_o / m_r
        jump[0], jump[1], jump[2] = strike[N_X], strike[N_Y], gain
        jump[3] = strike[N_X] * strike[OBJECT_X] + strike[N_Y] * strike[OBJECT_Y]
    workspace.node[c] = node
    cos, sin, t = math.cos(heading), math.sin(heading), now
    for j in range(STAGES + 1):
        bounced = node != NO_JUMP and j > node
        if bounced:
            plus_x, plus_y = progress.strike[k, o, PLUS_X], progress.strike[k, o, PLUS_Y]
            states[j, 0] = states[j - 1, 0] + durations[j - 1] * plus_x
            states[j, 1] = states[j - 1, 1] + durations[j - 1] * plus_y
            states[j, 3], states[j, 4] = plus_x, plus_y
        else:
            motion = evaluate_course(progress.course, script.breaks, script.coefficients, k, r, t)
            states[j, 0], states[j, 1], states[j, 3], states[j, 4] = motion[0], motion[1], motion[2], motion[3]
        states[j, 2], states[j, 5] = script.body[r, HOME], 0.0
        if j > 0:
            scale = 0.0 if bounced else mass / max(durations[j - 1], 1e-9)
            fx, fy = scale * (states[j, 3] - states[j - 1, 3]), scale * (states[j, 4] - states[j - 1, 4])
            inputs[j - 1, 0], inputs[j - 1, 1] = cos * fx + sin * fy, cos * fy - sin * fx
            inputs[j - 1, 2] = 0.0
        if j < STAGES:
            t += durations[j]
