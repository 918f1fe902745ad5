"""State estimation of robots and objects: Kalman filters over free flight, re-opened at contacts.

One filter serves every body: position, velocity and a constant unknown acceleration (drift) per axis. Both axes share
one covariance. A filter is a row [px, py, vx, vy, ax, ay, Ppp, Ppv, Ppa, Pvv, Pva, Paa] of numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from impact_envs.free_flyer.observation import Measurement
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.two_body import compute_velocity_gain

FILTER_SIZE = 12
NEAR = 0.1  # a felt impact is blamed on a body closer than this gap [m]
UNTRUSTED_JUMP = 0.5  # standard deviation of a modelled velocity jump, relative to its size
UNKNOWN_JUMP = 0.002  # the same, at least [m/s]
START_POSITION = 1e-3  # bodies start where the scenario says [m]
START_VELOCITY = 1e-4  # and at rest [m/s]; knowing this makes a small drift visible early
SURPRISE = 6.0  # standard deviations, and
SURPRISE_FLOOR = 2e-3  # [m] beyond which a position tells of an unseen event, such as a bounce off a wall


@dataclass(frozen=True)
class Noise:
    """What the filters believe of sensors and disturbances, as standard deviations.

    Args:
        position_prior: of measured positions until it is estimated [m].
        position_floor: of measured positions, at least [m].
        velocity_ratio: of measured velocities over that of positions per control period; a velocity that comes
            from differences of noisy positions then hardly counts, an exact one counts fully.
        memory: samples over which the position noise is estimated.
        thrust: unmodelled acceleration of robots [m/s^2].
        flight: unmodelled acceleration of objects [m/s^2].
        drift: constant acceleration of an object [m/s^2].
    """

    position_prior: float = 5e-3
    position_floor: float = 1e-7
    velocity_ratio: float = 100.0
    memory: float = 50.0
    thrust: float = 4e-3
    flight: float = 1e-5
    drift: float = 5e-4


@njit(cache=True)
def predict(z: np.ndarray, ux: float, uy: float, h: float, unmodelled: float) -> None:
    """Move a filter ahead in place: p += h v + h^2/2 (a + u), v += h (a + u).

    Args:
        z: filter, shape (12,).
        ux, uy: known acceleration [m/s^2].
        h: time step [s].
        unmodelled: standard deviation of an acceleration held over the step [m/s^2].
    """
    for axis, u in ((0, ux), (1, uy)):
        a = z[4 + axis] + u
        z[axis] += h * (z[2 + axis] + h / 2 * a)
        z[2 + axis] += h * a
    pp, pv, pa, vv, va, aa = z[6], z[7], z[8], z[9], z[10], z[11]
    q = unmodelled * unmodelled * h * h
    z[6] = pp + 2 * h * pv + h * h * (pa + vv) + h**3 * va + h**4 / 4 * aa + q * h * h / 4
    z[7] = pv + h * (pa + vv) + 1.5 * h * h * va + h**3 / 2 * aa + q * h / 2
    z[8] = pa + h * va + h * h / 2 * aa
    z[9] = vv + 2 * h * va + h * h * aa + q
    z[10] = va + h * aa


@njit(cache=True)
def correct_position(z: np.ndarray, x: float, y: float, variance: float) -> None:
    """Update a filter in place by a measured position.

    Args:
        z: filter, shape (12,).
        x, y: measured position [m].
        variance: of the measurement per axis, above zero [m^2].
    """
    pp, pv, pa = z[6], z[7], z[8]
    total = pp + variance
    for axis, value in ((0, x), (1, y)):
        innovation = (value - z[axis]) / total
        z[axis] += pp * innovation
        z[2 + axis] += pv * innovation
        z[4 + axis] += pa * innovation
    z[9] = max(z[9] - pv * pv / total, 0.0)
    z[10] -= pv * pa / total
    z[11] = max(z[11] - pa * pa / total, 0.0)
    z[6], z[7], z[8] = pp * (variance / total), pv * (variance / total), pa * (variance / total)


@njit(cache=True)
def correct_velocity(z: np.ndarray, vx: float, vy: float, variance: float) -> None:
    """Update a filter in place by a measured velocity.

    Args:
        z: filter, shape (12,).
        vx, vy: measured velocity [m/s].
        variance: of the measurement per axis, above zero [m^2/s^2].
    """
    pv, vv, va = z[7], z[9], z[10]
    total = vv + variance
    for axis, value in ((0, vx), (1, vy)):
        innovation = (value - z[2 + axis]) / total
        z[axis] += pv * innovation
        z[2 + axis] += vv * innovation
        z[4 + axis] += va * innovation
    z[6] = max(z[6] - pv * pv / total, 0.0)
    z[8] -= pv * va / total
    z[11] = max(z[11] - va * va / total, 0.0)
    z[7], z[9], z[10] = pv * (variance / total), vv * (variance / total), va * (variance / total)


@njit(cache=True)
def shift(z: np.ndarray, px: float, py: float, vx: float, vy: float, sigma_p: float, sigma_v: float) -> None:
    """Add a jump to a filter in place and open its covariance.

    Args:
        z: filter, shape (12,).
        px, py: jump of the position [m].
        vx, vy: jump of the velocity [m/s].
        sigma_p, sigma_v: standard deviation of the jump [m], [m/s].
    """
    z[0] += px
    z[1] += py
    z[2] += vx
    z[3] += vy
    z[6] += sigma_p * sigma_p
    z[9] += sigma_v * sigma_v


class Estimator:
    """Estimate positions and velocities of all bodies from their measurements.

    How noisy positions are is learned from the objects: between contacts their acceleration is constant, so the third
    difference of their positions is pure noise of variance 20 sigma^2.

    Args:
        scenario: as believed.
        noise: what the filters believe.
    """

    def __init__(self, scenario: FreeFlyerScenario, noise: Noise = Noise()) -> None:
        self.scenario = scenario
        self.noise = noise
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.time = 0.0
        self.sigma = self.noise.position_prior
        self._filters = {name: self._open(name) for name in self.scenario.bodies}
        self._heading = {name: (self.scenario.body(name).heading, 0.0) for name in self.scenario.bodies}
        self._recent: list[dict[str, np.ndarray]] = []
        self._weight = self._square = 0.0

    def update(self, measurement: Measurement, accelerations: Mapping[str, tuple[float, float]]) -> dict[str, str]:
        """Take in one measurement.

        Args:
            measurement: of all bodies; values that are not finite are passed over.
            accelerations: of the robots in the world frame since the last measurement [m/s^2].

        Returns:
            Who was hit: robot that felt an impact to the object or robot it touched, or to "" if it touched neither.
        """
        measured = measurement.robots | measurement.objects
        h = measurement.time - self.time
        self.time = measurement.time
        for name, z in self._filters.items():
            unmodelled = self.noise.thrust if name in self.scenario.robots else self.noise.flight
            predict(z, *accelerations.get(name, (0.0, 0.0)), h, unmodelled)
        touched = self._take_contacts(measurement, h)
        surprised = [self._open_if_surprised(name, state) for name, state in measured.items()]
        self._learn_noise(measurement, skip=bool(touched) or any(surprised))
        variance, variance_v = self._variances()
        for name, state in measured.items():
            if np.isfinite(state).all():
                correct_position(self._filters[name], state[0], state[1], variance)
                correct_velocity(self._filters[name], state[2], state[3], variance_v)
                self._heading[name] = float(state[4]), float(state[5])
        return touched

    def position(self, name: str) -> np.ndarray:
        """Return the estimated position of a body, shape (2,) [m]."""
        return self._filters[name][0:2].copy()

    def velocity(self, name: str) -> np.ndarray:
        """Return the estimated velocity of a body, shape (2,) [m/s]."""
        return self._filters[name][2:4].copy()

    def drift(self, name: str) -> np.ndarray:
        """Return the estimated constant acceleration of a body, shape (2,) [m/s^2]."""
        return self._filters[name][4:6].copy()

    def state(self, name: str) -> np.ndarray:
        """Return the estimated [x, y, heading, vx, vy, omega] of a body, shape (6,) [m, rad, m/s, rad/s]."""
        (x, y, vx, vy), (heading, omega) = self._filters[name][:4], self._heading[name]
        return np.array([x, y, heading, vx, vy, omega])

    def extrapolate(self, name: str, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Predict the free flight of a body.

        Args:
            name: of the body.
            time: of the prediction [s].

        Returns:
            Position and velocity at that time, shapes (2,) [m], [m/s].

        Source: Verhagen & Tumova, Sec. VI, with the estimated drift added.
        """
        z, h = self._filters[name], time - self.time
        return z[0:2] + h * (z[2:4] + h / 2 * z[4:6]), z[2:4] + h * z[4:6]

    def _open(self, name: str) -> np.ndarray:
        z = np.zeros(FILTER_SIZE)
        z[0:2] = self.scenario.body(name).start
        z[6], z[9] = START_POSITION**2, START_VELOCITY**2
        z[11] = self.noise.drift**2 if name in self.scenario.objects else 0.0
        return z

    def _take_contacts(self, measurement: Measurement, h: float) -> dict[str, str]:
        touched = {}
        for robot, felt in measurement.contact.items():
            if felt:
                other = self._nearest(robot)
                touched[robot] = other
                if other:
                    self._apply_impact(robot, other, h)
                else:
                    shift(self._filters[robot], 0.0, 0.0, 0.0, 0.0, 0.05 * h, 0.05)
        return touched

    def _nearest(self, robot: str) -> str:
        gaps = {
            name: math.dist(self._filters[name][:2], self._filters[robot][:2]) - self._reach(robot, name)
            for name in self._filters
            if name != robot
        }
        nearest = min(gaps, key=gaps.__getitem__, default="")
        return nearest if nearest and gaps[nearest] < NEAR else ""

    def _apply_impact(self, robot: str, other: str, h: float) -> None:
        """Apply Eq. 6 to the estimates; how deep free flight would have overlapped says how long ago it was."""
        a, b = self._filters[robot], self._filters[other]
        between = b[:2] - a[:2]
        distance = math.hypot(*between)
        n = between / distance if distance > 0 else np.array([1.0, 0.0])
        approach = max(float((a[2:4] - b[2:4]) @ n), 0.0)
        ago = min(max(self._reach(robot, other) - distance, 0.0) / approach, h) if approach > 0 else 0.0
        m_a, m_b = self.scenario.body(robot).mass, self.scenario.body(other).mass
        jump = compute_velocity_gain(self.scenario.believed.restitution, m_a, m_b) * approach
        for z, change in ((b, jump), (a, -jump * m_b / m_a)):
            sigma = UNTRUSTED_JUMP * abs(change) + UNKNOWN_JUMP
            dx, dy = change * n
            shift(z, ago * dx, ago * dy, dx, dy, sigma * h, sigma)

    def _reach(self, a: str, b: str) -> float:
        return self.scenario.body(a).radius + self.scenario.body(b).radius

    def _variances(self) -> tuple[float, float]:
        """Return the variances of measured positions [m^2] and velocities [m^2/s^2]."""
        sigma_v = self.noise.velocity_ratio * self.sigma / self.scenario.control_period
        return self.sigma**2, sigma_v**2

    def _open_if_surprised(self, name: str, state: np.ndarray) -> bool:
        """Open a filter that a measurement does not fit at all, and return whether it was so."""
        z, miss = self._filters[name], math.dist(state[:2], self._filters[name][:2])
        if not miss > SURPRISE * math.sqrt(z[6] + self._variances()[0]) + SURPRISE_FLOOR:
            return False
        shift(z, 0.0, 0.0, 0.0, 0.0, miss, miss / self.scenario.control_period)
        return True

    def _learn_noise(self, measurement: Measurement, skip: bool) -> None:
        self._recent = [] if skip else [*self._recent[-3:], measurement.objects]
        if len(self._recent) < 4:
            return
        keep = 1.0 - 1.0 / self.noise.memory
        for name in measurement.objects:
            a, b, c, d = (sample[name][:2] for sample in self._recent)
            squares = float(np.sum((d - 3 * c + 3 * b - a) ** 2))
            if math.isfinite(squares):
                self._weight = keep * self._weight + 1.0
                self._square = keep * self._square + squares / 40.0
        if self._weight > 5.0:
            self.sigma = max(math.sqrt(self._square / self._weight), self.noise.position_floor)
