"""What a floating manipulator's episode came to: its impact, its errors, its requirements, and histories to draw."""

from __future__ import annotations

from typing import Any

import numpy as np

from impact_envs.floating_manipulator.model import Collision
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.rollout import Episode, Policy
from impact_envs.stl import Trace, robustness, satisfied

DECIMALS = 9  # of the figures
OF_IMPACT = (
    "impact_time",
    "impact_point",
    "impulse",
    "angular_impulse",
    "object_velocity",
    "base_velocity_after",
    "joint_velocity_after",
)


class ManipulatorRecord:
    """Watch an episode of a floating manipulator.

    Args:
        scenario: where.
        policy: that plays; nothing in it is watched.

    Attributes:
        scenario: where.
        collisions: in order of time.
    """

    def __init__(self, scenario: FloatingManipulatorScenario, policy: Policy) -> None:
        self.scenario = scenario
        self.collisions: list[Collision] = []
        self._samples: list[tuple[np.ndarray, ...]] = []

    def add(self, env: Any) -> None:
        """Take a sample.

        Args:
            env: an ImpactEnv after reset or a step.
        """
        model = env.model
        if env.steps == 0:
            self.collisions, self._samples = [], []
        else:
            self.collisions += model.collisions
        drop = np.zeros(len(model.torques))
        if self._samples:
            drop = model.physics.stall_torque / model.physics.no_load_speed * self._samples[-1][1][3:]
        limits = np.array([-model.physics.stall_torque - drop, model.physics.stall_torque - drop])
        self._samples.append((*model.coordinates(), model.energies(), model.base_forces, limits))

    @property
    def coordinates(self) -> np.ndarray:
        """Return base x, y, psi and joint angles, shape (T + 1, n + 3) [m], [rad]."""
        return self._column(0)

    @property
    def rates(self) -> np.ndarray:
        """Return the rates of the coordinates, shape (T + 1, n + 3) [m/s], [rad/s]."""
        return self._column(1)

    @property
    def energies(self) -> np.ndarray:
        """Return the kinetic energies of manipulator and box, shape (T + 1, 2) [J]."""
        return self._column(2)

    @property
    def base_forces(self) -> np.ndarray:
        """Return force and torque on the base, held over each step, shape (T, 3) [N], [N m]."""
        return self._column(3)[1:]

    @property
    def torque_limits(self) -> np.ndarray:
        """Return the joint motors' least and greatest torques, shape (T, 2, n) [N m]."""
        return self._column(4)[1:]

    def _column(self, place: int) -> np.ndarray:
        return np.array([sample[place] for sample in self._samples])


def compute_figures(record: ManipulatorRecord, episode: Episode) -> dict[str, Any]:
    """Return the figures that the paper prints.

    Args:
        record: what was watched.
        episode: the same one.

    Returns:
        Of the first impact, None without one: ``impact_time`` [s], ``impact_point``, where the tip's centre is [m],
        ``impulse`` on the box [N s], ``angular_impulse`` on it about its centre [N m s], and just after it
        ``object_velocity`` (vx, vy, omega), ``base_velocity_after`` (vx, vy, omega) and ``joint_velocity_after`` [m/s],
        [rad/s]. From it to the end ``base_travel`` and ``box_travel``, the distances between first and last place [m].
        Distances of the tip from its goal [m]: ``start_error``; ``min_error``, the least of the whole episode;
        ``min_error_after_pause``, the least after the safety pause of the first impact, None where the episode ends
        before; ``final_error``. ``requirements``: robustness and truth of each of the scenario's.

    Source: Nekoo, Sharf & Ollero, Sec. 4 and App. A.
    """
    signals = episode.signals
    errors = np.hypot(signals["tip.x"] - signals["target.x"], signals["tip.y"] - signals["target.y"])
    return {
        **_measure_impact(record),
        **_measure_travel(record, episode),
        "start_error": float(errors[0]),
        "min_error": float(errors.min()),
        "min_error_after_pause": _find_least_after_pause(record, episode.times, errors),
        "final_error": float(errors[-1]),
        "requirements": _judge(record.scenario, episode),
    }


def _measure_impact(record: ManipulatorRecord) -> dict[str, Any]:
    """Return the figures of the first impact."""
    if not record.collisions:
        return dict.fromkeys(OF_IMPACT)
    hit = record.collisions[0]
    impact, radius = hit.impact, record.scenario.load.radius
    tip = np.array(impact.point) - radius * np.array(impact.normal)
    arm = np.array(impact.point) - hit.box[:2]
    spin = arm[0] * impact.impulse[1] - arm[1] * impact.impulse[0]
    vectors = (tip, impact.impulse, [spin], hit.box_plus, hit.v_plus[:3], hit.v_plus[3:])
    point, impulse, (angular,), *velocities = [_rounded(vector) for vector in vectors]
    return dict(zip(OF_IMPACT, (impact.time, point, impulse, angular, *velocities), strict=True))


def _measure_travel(record: ManipulatorRecord, episode: Episode) -> dict[str, float | None]:
    """Return how far base and box are from where they were at the first impact."""
    if not record.collisions:
        return {"base_travel": None, "box_travel": None}
    first = int(np.searchsorted(episode.times, record.collisions[0].impact.time))
    places = {name: [episode.signals[f"{name}.{axis}"] for axis in "xy"] for name in ("base", "box")}
    return {f"{name}_travel": float(np.hypot(x[-1] - x[first], y[-1] - y[first])) for name, (x, y) in places.items()}


def _find_least_after_pause(record: ManipulatorRecord, times: np.ndarray, errors: np.ndarray) -> float | None:
    """Return the least distance after the safety pause of the first impact; None if nothing comes after it."""
    if not record.collisions:
        return None
    after = times >= record.collisions[0].impact.time + record.scenario.safety_pause - 1e-9
    return float(errors[after].min()) if after.any() else None


def _judge(scenario: FloatingManipulatorScenario, episode: Episode) -> list[dict[str, Any]]:
    """Return name, truth and robustness of each requirement; nothing of an episode that was cut."""
    if len(episode.times) <= scenario.steps:
        return []
    trace = Trace(episode.signals, scenario.control_period, scenario.areas, scenario.bodies)
    return [
        {
            "name": name,
            "satisfied": bool(satisfied(formula, trace)),
            "robustness": float(robustness(formula, trace)),
        }
        for name, formula in scenario.required.items()
    ]


def _rounded(vector: Any) -> tuple[float, ...]:
    return tuple(round(float(value), DECIMALS) + 0.0 for value in vector)
