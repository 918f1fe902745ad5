"""Free-flyers and objects in a planar, weightless world: exact flight, exact impacts, lasting contact.

A control period is split where something happens. Between, bodies fly under constant force (``Body.fly``).
Impacts of discs are found as roots of polynomials, those of polygons and of discs with an offset centre of
mass by conservative steps, and obey ``physics.impact``. The forces of contacts that last are pymunk's.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import numpy as np

from impact_envs.elementary import cos_sin
from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.body import Body, make_obstacle, make_walls
from impact_envs.free_flyer.contact.deviation import compute_deviation, roll_dice
from impact_envs.free_flyer.contact.lasting_contact import ContactSolver
from impact_envs.free_flyer.contact.pair import (
    CONTACT_STEP,
    EVENTS,
    GRAZE,
    PART_SPEED,
    REST_GAP,
    REST_PRESS,
    REST_SHARE,
    SIMULTANEOUS,
    compute_approach,
    compute_force_press,
    compute_press,
    find_contact,
    find_time_of_impact,
    remove_overlap,
)
from impact_envs.free_flyer.engine import fade_thruster, turn_drift
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.truth import (
    CORNERS,
    DEVIATION,
    DICE,
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
    TURN,
    Physics,
)
from impact_envs.interface.failure import TooManyEvents
from impact_envs.physics.convex import Contact
from impact_envs.physics.impact import Impact, LastingContact, compute_restitution, is_rebound, solve_contacts

Pair = tuple[int, int]


class FreeFlyerModel:
    """Physics of the free-flyer domain.

    Robots take a force and a torque in their body frame. The force acts at the geometric centre, round which
    the thrusters are arranged, whatever the true centre of mass. Over a control period it is held in the
    world frame, turned by the heading that the middle of the period has in free flight. On/off thrusters make
    pulses of force whose sum follows the command; the torque stays continuous. Solid obstacles and the
    world's box stop bodies.

    Everything that outlives a control period is plain numbers: a pickled model goes on bit for bit.

    Args:
        scenario: who is where.
    """

    def __init__(self, scenario: FreeFlyerScenario) -> None:
        self.scenario = scenario
        solid = {name: area for name, area in scenario.obstacles.items() if area.solid}
        self._fixed = make_walls(scenario.world.lower, scenario.world.upper)
        self._fixed += [make_obstacle(name, area.corners) for name, area in solid.items()]
        movable = len(scenario.bodies)
        self._movable_pairs = list(itertools.combinations(range(movable), 2))
        self._rest_speed = scenario.rest_speed
        self._faces = [(movable + k, body.faces) for k, body in enumerate(self._fixed)]
        self.reset(scenario.as_believed().draw(np.random.default_rng(0)))

    def reset(self, physics: Physics) -> None:
        """Put all bodies at their start, in a world with these physics.

        Args:
            physics: the drawn numbers of one episode.
        """
        self.physics = physics
        self._steps = 0
        self._held: dict[Pair, np.ndarray] = {}
        self._dice = physics.body[:, DICE].tolist()
        self._owed = {name: [0.0, 0.0] for name in self.scenario.robots}
        self._gains = dict(zip(self.scenario.robots, physics.thruster.tolist(), strict=True))
        self._bodies = [self._make_body(name) for name in self.scenario.bodies] + self._fixed
        self._movable = self._bodies[: len(self.scenario.bodies)]
        self._robots = {name: self._bodies[i] for i, name in enumerate(self.scenario.robots)}
        self.set_state(self.scenario.place_bodies(physics))
        self._masses = np.array([m for body in self._movable for m in (body.mass, body.mass, body.inertia)])

    @property
    def time(self) -> float:
        """Return the time since reset [s]."""
        return self._steps * self.scenario.control_period

    def state(self) -> np.ndarray:
        """Return the state of all bodies.

        Returns:
            Rows x, y, vx, vy, heading, omega in the order of ``scenario.bodies``, of the geometric centres,
            shape (bodies, 6) [m], [m/s], [rad], [rad/s]. Headings are not wrapped.
        """
        rows = []
        for body in self._movable:
            x, y, heading = body.centre()
            rows.append((x, y, *body.velocity_at((x, y)), heading, body.omega))
        return np.array(rows)

    def set_state(self, states: np.ndarray) -> None:
        """Move all bodies to a state; time and what on/off thrusters owe go on.

        Args:
            states: as ``state`` returns them, shape (bodies, 6).
        """
        for body, row in zip(self._movable, states, strict=True):
            x, y, vx, vy, heading, omega = map(float, row)
            c, s = cos_sin(heading)
            rx, ry = c * body.offset[0] - s * body.offset[1], s * body.offset[0] + c * body.offset[1]
            body.x, body.y, body.heading = x + rx, y + ry, heading
            body.vx, body.vy, body.omega = vx - omega * ry, vy + omega * rx, omega

    def step(self, controls: Mapping[str, np.ndarray]) -> list[Impact]:
        """Advance one control period under held controls.

        Args:
            controls: robot to its commanded body-frame force and torque (Fx, Fy, tau), shape (3,) [N], [N m];
                clipped to the robot's limits. All robots need one.

        Returns:
            The impacts, in order of time; touches that start a lasting contact are none.

        Raises:
            InputError: a robot without control, an unknown robot, or a control that is not three finite
                numbers.
            TooManyEvents: impacts do not end.
        """
        if controls.keys() != self._robots.keys():
            wrong = ", ".join(sorted(controls.keys() ^ self._robots.keys()))
            raise InputError(f"controls must name every robot once, not so: {wrong}; {choices(wrong, self._robots)}")
        for name, control in controls.items():
            self._apply_command(name, control)
        for index in range(len(self._robots), len(self._movable)):
            self._apply_drift(index)
        self._held = {}
        impacts = self._advance_period(self.scenario.control_period)
        self._steps += 1
        return impacts

    @property
    def lasting_contacts(self) -> list[LastingContact]:
        """Return what lasting contacts exchanged in the last control period, one record for each pair."""
        found = []
        for pair, impulse in sorted(self._held.items()):
            a, b = self._get_bodies(pair)
            if b.fixed:  # the fixed one is named first
                a, b, impulse = b, a, -impulse
            if impulse.any():
                found.append(LastingContact(self.time, a.name, b.name, (float(impulse[0]), float(impulse[1]))))
        return found

    def _make_body(self, name: str) -> Body:
        table, row = self.scenario.body(name), self.physics.body[self.scenario.bodies.index(name)].tolist()
        return Body(
            name,
            table.radius,
            getattr(table, "vertices", None),
            (row[OFFSET_X], row[OFFSET_Y]),
            row[MASS],
            row[INERTIA],
        )

    def _apply_drift(self, index: int) -> None:
        """Set the acceleration that an object has by itself over the coming control period."""
        body, row = self._bodies[index], self.physics.body[index].tolist()
        period = self.scenario.control_period
        body.ax, body.ay = turn_drift(row[DRIFT_X], row[DRIFT_Y], row[TURN], self._steps, period)

    def _apply_command(self, name: str, control: np.ndarray) -> None:
        """Turn a command into the accelerations held over the coming control period."""
        body, table, gain = self._robots[name], self.scenario.robots[name], self._gains[name]
        command = [float(u) for u in control]
        if len(command) != 3 or not all(map(math.isfinite, command)):
            raise InputError(f"control of {name} = {command}: three finite numbers Fx, Fy, tau are needed")
        limits = (table.force_limit, table.force_limit, table.torque_limit)
        command = [min(max(u, -limit), limit) for u, limit in zip(command, limits, strict=True)]
        if self.physics.true.thruster_on_off:
            command[:2] = self._quantise_force(name, command, table.force_limit)
        used = [2 * k + (0 if u >= 0 else 1) for k, u in enumerate(command)]
        fx, fy, tau = (
            u * fade_thruster(gain[place], gain[FADE + place], self.time)
            for u, place in zip(command, used, strict=True)
        )
        # The lever of the force about the true centre of mass.
        tau -= body.offset[0] * fy - body.offset[1] * fx
        period = self.scenario.control_period
        body.alpha = tau / body.inertia
        middle = body.heading + (body.omega + body.alpha * period / 4) * period / 2
        c, s = cos_sin(middle)
        body.ax, body.ay = (c * fx - s * fy) / body.mass, (s * fx + c * fy) / body.mass

    def _quantise_force(self, name: str, command: list[float], limit: float) -> list[float]:
        """Return forces that are off or full, and whose sum follows the command's to half a pulse."""
        owed, pulses = self._owed[name], []
        for k in range(2):
            wanted = command[k] / limit + owed[k]
            pulse = min(max(round(wanted), -1), 1)
            owed[k] = wanted - pulse
            pulses.append(pulse * limit)
        return pulses

    def _advance_period(self, period: float) -> list[Impact]:
        """Move all bodies through one control period, event by event."""
        impacts: list[Impact] = []
        solver: ContactSolver | None = None
        held = [(body.ax, body.ay, body.alpha) for body in self._movable]
        t = held_for = 0.0
        for _ in range(EVENTS):
            left = period - t
            near = self._find_near_pairs(left)
            pressed, idle = self._find_resting(near)
            if pressed:
                # No last step of mere rounding: pymunk divides by it.
                left = CONTACT_STEP if left > CONTACT_STEP + SIMULTANEOUS else left
                # pymunk starts from the last step's impulses, and scales them wrongly when the steps differ.
                if solver is None or left != held_for:
                    solver, held_for = ContactSolver(self._bodies, float(self.physics.contact[FRICTION])), left
                solver.add_contact_forces(pressed, left)
                near = self._find_near_pairs(left)
            first, hits = self._find_first_impact(near, pressed | idle, left)
            h = min(first, left)
            if pressed:
                assert solver is not None
                for pair, impulse in solver.impulses.items():
                    self._add_held(pair, h / left * np.array(impulse))
            for body in self._movable:
                body.fly(h)
            t = period if h == period - t else t + h
            if hits:
                impacts += self._resolve_impacts(hits, near, self.time + t)
            for body, acceleration in zip(self._movable, held, strict=True):
                body.ax, body.ay, body.alpha = acceleration
            if t >= period:
                return impacts
        last = (impacts[-1].a, impacts[-1].b) if impacts else ("", "")
        raise TooManyEvents(EVENTS, last[0] if last[0] in self.scenario.bodies else last[1])

    def _find_near_pairs(self, h: float) -> list[Pair]:
        """Return the pairs that could touch within h (circles round the bodies, grown by their motion)."""
        bodies = self._bodies
        rooms = [
            body.reach + REST_GAP + (math.hypot(body.vx, body.vy) + math.hypot(body.ax, body.ay) * h / 2) * h
            for body in self._movable
        ]
        near = [
            (i, j)
            for i, j in self._movable_pairs
            if math.hypot(bodies[i].x - bodies[j].x, bodies[i].y - bodies[j].y) <= rooms[i] + rooms[j]
        ]
        for j, faces in self._faces:
            for i, room in enumerate(rooms):
                x, y = bodies[i].x, bodies[i].y
                for px, py, nx, ny, _ in faces:
                    if nx * (x - px) + ny * (y - py) > room:
                        break
                else:
                    near.append((i, j))
        return near

    def _find_first_impact(self, near: list[Pair], resting: set[Pair], end: float) -> tuple[float, list[Pair]]:
        """Return when the first impact happens, infinity if not within end, and which pairs take part."""
        first, times = math.inf, {}
        for pair in near:
            end = min(end, first + SIMULTANEOUS)
            times[pair] = find_time_of_impact(*self._get_bodies(pair), pair in resting, end)
            first = min(first, times[pair])
        end = min(end, first + SIMULTANEOUS)
        return first, [pair for pair, time in times.items() if time <= end]

    def _get_bodies(self, pair: Pair) -> tuple[Body, Body]:
        return self._bodies[pair[0]], self._bodies[pair[1]]

    def _find_resting(self, near: list[Pair]) -> tuple[set[Pair], set[Pair]]:
        """Return the pairs that rest on each other under pressure, and those that do so without.

        Where any is pressed, every pair that touches may become so, and counts as pressed.
        """
        touching, pressed = {}, False
        for pair in near:
            a, b = self._get_bodies(pair)
            contact = find_contact(a, b)
            if contact.gap <= REST_GAP:
                approach = compute_approach(a, b, contact)
                if -PART_SPEED <= approach <= REST_SHARE * self._rest_speed:
                    touching[pair] = press = compute_press(a, b, contact)
                    # Parting bodies are pressed if the pressure turns them round within a contact step.
                    pressed = pressed or press > max(REST_PRESS, -approach / CONTACT_STEP)
        if pressed:
            return set(touching), set()
        return set(), {pair for pair, press in touching.items() if press <= REST_PRESS}

    def _resolve_impacts(self, hits: list[Pair], near: list[Pair], time: float) -> list[Impact]:
        """Change velocities by the impacts of one instant and return them.

        If all of them are starts of lasting contacts, everything that touches comes to rest together instead.
        """
        contacts = {pair: find_contact(*self._get_bodies(pair)) for pair in hits}
        genuine = {pair: contact for pair, contact in contacts.items() if self._does_rebound(pair, contact, near)}
        if not genuine:
            self._start_lasting_contacts(
                contacts | {pair: find_contact(*self._get_bodies(pair)) for pair in near}, near
            )
            return []
        speeds = {pair: compute_approach(*self._get_bodies(pair), contact) for pair, contact in genuine.items()}
        law = self.physics.contact.tolist()
        e, e_speed = law[RESTITUTION], law[RESTITUTION_SPEED]
        restitution = {pair: compute_restitution(speeds[pair], e, e_speed) for pair in genuine}
        impulses = self._apply_impulses(genuine, restitution)
        for pair, impulse in impulses.items():
            impulse += self._deviate(pair)
        return [self._make_impact(pair, genuine[pair], impulses[pair], speeds[pair], time) for pair in genuine]

    def _does_rebound(self, pair: Pair, contact: Contact, near: list[Pair]) -> bool:
        """Return whether an impact, one of the near pairs, is more than the start of a lasting contact."""
        a, b = self._get_bodies(pair)
        measure = compute_force_press if a.lever > 0 or b.lever > 0 else compute_press
        speed, press = compute_approach(a, b, contact), measure(a, b, contact)
        low_speed = self._rest_speed
        if REST_SHARE * low_speed < speed <= low_speed and not self._is_any_pressed(near):
            low_speed *= REST_SHARE
        return is_rebound(speed, press, low_speed, CONTACT_STEP)

    def _is_any_pressed(self, near: list[Pair]) -> bool:
        """Return whether anything presses any of the pairs together that touch: if so it may press them all."""
        for pair in near:
            a, b = self._get_bodies(pair)
            contact = find_contact(a, b)
            touching = contact.gap <= REST_GAP and compute_approach(a, b, contact) >= -PART_SPEED
            if touching and compute_press(a, b, contact) > REST_PRESS:
                return True
        return False

    def _start_lasting_contacts(self, contacts: Mapping[Pair, Contact], near: list[Pair]) -> None:
        """Bring everything that touches to rest on each other, without restitution."""
        touching = {
            pair: contact
            for pair, contact in contacts.items()
            if contact.gap <= REST_GAP and not self._does_rebound(pair, contact, near)
        }
        for pair, impulse in self._apply_impulses(touching, dict.fromkeys(touching, 0.0)).items():
            self._add_held(pair, impulse)
        for pair, contact in touching.items():
            if contact.gap < -GRAZE:
                remove_overlap(*self._get_bodies(pair), contact)

    def _add_held(self, pair: Pair, impulse: np.ndarray) -> None:
        self._held[pair] = self._held.get(pair, np.zeros(2)) + impulse

    def _apply_impulses(
        self, contacts: Mapping[Pair, Contact], restitution: Mapping[Pair, float]
    ) -> dict[Pair, np.ndarray]:
        """Apply simultaneous impulses; return their sum on each pair's second body, shape (2,) [N s]."""
        entries = [(pair, contact.normal, point) for pair, contact in contacts.items() for point in contact.points]
        n = len(self._masses)
        normals, tangents = np.zeros((len(entries), n)), np.zeros((len(entries), n))
        for row, (pair, (nx, ny), (px, py)) in enumerate(entries):
            for k, sign in zip(pair, (-1.0, 1.0), strict=True):
                body = self._bodies[k]
                if not body.fixed:
                    rx, ry = px - body.x, py - body.y
                    normals[row, 3 * k : 3 * k + 3] = sign * nx, sign * ny, sign * (rx * ny - ry * nx)
                    tangents[row, 3 * k : 3 * k + 3] = -sign * ny, sign * nx, sign * (rx * nx + ry * ny)
        v = np.array([u for body in self._movable for u in (body.vx, body.vy, body.omega)])
        e = np.array([restitution[pair] for pair, _, _ in entries])
        p, q = solve_contacts(normals, np.diag(self._masses), v, e, tangents, float(self.physics.contact[FRICTION]))
        v += (p @ normals + q @ tangents) / self._masses
        for k, body in enumerate(self._movable):
            body.vx, body.vy, body.omega = (float(u) for u in v[3 * k : 3 * k + 3])
        sums = {pair: np.zeros(2) for pair in contacts}
        for (pair, (nx, ny), _), along, across in zip(entries, p, q, strict=True):
            sums[pair] += along * nx - across * ny, along * ny + across * nx
        return sums

    def _deviate(self, pair: Pair) -> np.ndarray:
        """Let a robot's impact on an object deviate from the law; return the impulse that this takes, shape (2,)."""
        (i, j), robots = pair, len(self._robots)
        if i >= robots or not robots <= j < len(self._movable):
            return np.zeros(2)
        size, at_corners = (float(self.physics.body[j, column]) for column in (DEVIATION, CORNERS))
        if size == 0.0:
            return np.zeros(2)
        first = roll_dice(self._dice[j])
        self._dice[j] = second = roll_dice(first)
        dx, dy = (float(compute_deviation(dice, size, at_corners > 0.0)) for dice in (first, second))
        robot, item = self._get_bodies(pair)
        item.vx, item.vy = item.vx + dx, item.vy + dy
        share = item.mass / robot.mass
        robot.vx, robot.vy = robot.vx - share * dx, robot.vy - share * dy
        return item.mass * np.array([dx, dy])

    def _make_impact(self, pair: Pair, contact: Contact, impulse: np.ndarray, speed: float, time: float) -> Impact:
        a, b = self._get_bodies(pair)
        nx, ny = contact.normal
        if b.fixed:  # the fixed one is named first
            a, b, nx, ny, impulse = b, a, -nx, -ny, -impulse
        x, y = (sum(c) / len(contact.points) for c in zip(*contact.points, strict=True))
        return Impact(time, a.name, b.name, (x, y), (nx, ny), (float(impulse[0]), float(impulse[1])), speed)
