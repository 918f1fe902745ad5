"""The units and the origin that a task is planned in, so that no absolute length, speed or mass decides what is found.

Reserves, tolerances and rounding are chosen for robots of 0.2 m and 16.8 kg. Any task is planned in units in which its
smallest robot has this radius and its heaviest robot this mass, and the plan is told in the user's units. Far from the
origin, where coordinates have fewer digits, the origin moves along.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario, Object, Robot
from impact_envs.stl import Distance, Formula, Linear, Speed, parse
from planners.bezier import Curve
from planners.plan import Plan, PlannedImpact, Tube

RADIUS = 0.2  # of the robots for which reserves and tolerances were chosen [m]
MASS = 16.8  # of these robots [kg]
FAR = 100.0  # origins are whole multiples of this, so that tasks near their own origin keep it [m, for such robots]
WIDEST = 1000.0  # greatest diagonal of the world, however small its robots: rows need digits [m, for such robots]
# Decimals kept of places, and digits of other numbers: what only differs by the round-off of units is the same task.
DECIMALS, DIGITS = 10, 12


@dataclass(frozen=True)
class Frame:
    """Hold the units and the origin of a frame.

    Args:
        length: unit of length, which also divides speeds and forces [m].
        mass: unit of mass, which also divides forces [kg].
        origin: in the user's coordinates [m].
    """

    length: float = 1.0
    mass: float = 1.0
    origin: tuple[float, float] = (0.0, 0.0)

    @property
    def is_users(self) -> bool:
        """Return whether these are the user's units and origin."""
        return self == Frame()

    def enter(self, scenario: FreeFlyerScenario) -> FreeFlyerScenario:
        """Return a scenario, as it is believed, in the frame's units."""
        if self.is_users:
            return scenario
        scenario = scenario.as_believed()
        values: dict[str, Any] = {"formula": str(self._enter_formula(scenario.specification))}
        for table, group in (("robots", scenario.robots), ("objects", scenario.objects)):
            for name, body in group.items():
                values |= {f"{table}.{name}.{key}": value for key, value in self._enter_body(body).items()}
        areas: list[tuple[str, Any]] = [("world", scenario.world)]
        areas += [(f"regions.{name}", area) for name, area in scenario.regions.items()]
        areas += [(f"obstacles.{name}", area) for name, area in scenario.obstacles.items()]
        for path, area in areas:
            if getattr(area, "vertices", None) is not None:
                values[f"{path}.vertices"] = [self._enter_point(vertex) for vertex in area.vertices]
            else:
                values |= {f"{path}.{end}": self._enter_point(getattr(area, end)) for end in ("lower", "upper")}
        if scenario.world.rest_speed is not None:
            values["world.rest_speed"] = scenario.world.rest_speed / self.length
        return scenario.override(values)

    def leave(self, plan: Plan) -> Plan:
        """Return a plan in the user's units."""
        if self.is_users:
            return plan
        length, area = self.length, self.length**2
        return replace(
            plan,
            robustness=plan.robustness * length,
            bound=plan.bound * length,
            effort=plan.effort * area,
            effort_bound=None if plan.effort_bound is None else plan.effort_bound * area,
            impacts=tuple(self._leave_impact(impact) for impact in plan.impacts),
            robots=self._leave_curves(plan.robots),
            objects=self._leave_curves(plan.objects),
            deviation=None if plan.deviation is None else plan.deviation * length,
            deviation_bound=None if plan.deviation_bound is None else plan.deviation_bound * length,
            tubes={name: self._leave_tube(tube) for name, tube in plan.tubes.items()},
            responses={name: tuple(map(self._leave_curve, curves)) for name, curves in plan.responses.items()},
            shape_error=plan.shape_error * length,
        )

    def leave_formula(self, text: str) -> str:
        """Return a formula in the user's units."""
        if self.is_users:
            return text
        x, y = self.origin
        return str(Frame(1.0 / self.length, 1.0, (-x / self.length, -y / self.length))._enter_formula(parse(text)))

    def _enter_point(self, point: Iterable[float]) -> list[float]:
        return [self._round((x - o) / self.length) for x, o in zip(point, self.origin, strict=True)]

    def _round(self, value: float) -> float:
        return round(float(value), DECIMALS)

    def _enter_body(self, body: Robot | Object) -> dict[str, Any]:
        length, mass = self.length, self.mass
        divisors = {"radius": length, "speed_limit": length, "mass": mass, "inertia": mass * length**2}
        divisors |= {"force_limit": mass * length, "torque_limit": mass * length**2, "keep_force": mass * length}
        divisors |= {"final_speed": length}
        found: dict[str, Any] = {"start": self._enter_point(body.start)}
        for key, divisor in divisors.items():
            if hasattr(body, key):
                found[key] = float(f"{getattr(body, key) / divisor:.{DIGITS}g}")
        if getattr(body, "goal", None) is not None:
            found["goal"] = self._enter_point(body.goal)  # type: ignore[union-attr, arg-type]
        for key in ("start_velocity", "start_uncertainty"):
            if hasattr(body, key):
                found[key] = [self._round(x / length) for x in getattr(body, key)]
        if getattr(body, "vertices", None) is not None:
            found["vertices"] = [[x / length for x in vertex] for vertex in body.vertices]  # type: ignore[union-attr]
        return found

    def _enter_formula(self, formula: Formula) -> Formula:
        match formula:
            case Distance() | Speed():
                return replace(formula, bound=self._round(formula.bound / self.length))
            case Linear():
                # Velocities and angles are refused anyway.
                offset = sum(c * self.origin[s.endswith("y")] for s, c in formula.terms if s.endswith((".x", ".y")))
                return replace(formula, bound=self._round((formula.bound - offset) / self.length))
        children = [self._enter_formula(child) for child in formula.children]
        return formula.rebuild(children) if children else formula

    def _leave_points(self, points: np.ndarray) -> np.ndarray:
        return points * self.length + np.array(self.origin)

    def _leave_curve(self, curve: Curve) -> Curve:
        return Curve(curve.times, self._leave_points(curve.points))

    def _leave_curves(self, curves: Mapping[str, Curve]) -> dict[str, Curve]:
        return {name: self._leave_curve(curve) for name, curve in curves.items()}

    def _leave_impact(self, impact: PlannedImpact) -> PlannedImpact:
        return replace(
            impact,
            position=self._leave_points(impact.position),
            contact=self._leave_points(impact.contact),
            robot_minus=impact.robot_minus * self.length,
            robot_plus=impact.robot_plus * self.length,
            object_minus=impact.object_minus * self.length,
            object_plus=impact.object_plus * self.length,
        )

    def _leave_tube(self, tube: Tube) -> Tube:
        shift = np.zeros((2, 4))
        shift[0, :2] = self.origin
        return Tube(tube.times, tube.start * self.length + shift, tube.end * self.length + shift)


def find_frame(scenario: FreeFlyerScenario) -> Frame:
    """Return the frame a task is planned in; one of robots of 0.2 m and 16.8 kg near its origin keeps its own.

    Args:
        scenario: robots and world.
    """
    robots = scenario.robots.values()
    world = scenario.world
    length = max(min(robot.radius for robot in robots) / RADIUS, world.diagonal / WIDEST)
    mass = max(robot.mass for robot in robots) / MASS
    length, mass = (float(f"{value:.{DIGITS}g}") for value in (length, mass))
    step = FAR * length
    center = 0.5 * (np.array(world.lower) + np.array(world.upper))
    x, y = np.round(center / step) * step + 0.0
    return Frame(length, mass, (float(x), float(y)))
