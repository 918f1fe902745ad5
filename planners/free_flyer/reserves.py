"""Margins of a plan: what it keeps in hand for its execution."""

from __future__ import annotations

from dataclasses import dataclass, replace

from impact_envs.free_flyer.schema import Robot


@dataclass(frozen=True)
class Reserves:
    """Hold what a plan keeps in hand for its execution.

    Lengths and speeds are for robots of 0.2 m; for others they are scaled, see `planners.free_flyer.frame`. Times count
    in full from about 30 s of horizon on; below, they are shares of the horizon.

    Args:
        speed: share of the speed limits that legs between impacts may use.
        thrust: share of force_limit / mass that motions may use.
        turn: time to reach the speed of a leg from rest, or to stop from it, at this thrust [s].
        slack: factor of the time that a leg loses by starting and stopping.
        underway: share of this time that counts on the first leg, where bodies move at the start.
        first: least time before the first impact [s].
        gap: least time between impacts [s].
        last: least time after the last impact [s].
        clearance: distance kept between bodies beyond touching [m].
        wall: distance kept from walls and solid obstacles beyond touching [m].
        avoid: distance kept from areas to avoid in addition to the robustness, where the optimum allows it [m].
        interior: robustness given up for a smaller path cost [m].
        run_up: room behind a robot that hits, between its disc and the world's edge [m].
        braking: share of the planned acceleration at which robots that move at the start are assumed to brake.
        push: least change of an object's displacement per leg by an impact, along its direction; an impulse
            near zero has no direction [m].
        push_speed: the same for plans that bear deviations: least speed of the object along the direction of an
            impact, before and after it [m/s].
        tracking: robustness that the boxes of such plans keep, because no flight is exact [m]; in the believed world,
            but for the deviations, objects leave their boxes by less than a tenth of it.

    Source: speed, first, gap, last and avoid are near the best of closed-loop trials of a prototype with restitution,
    mass, sensing, drift and actuation perturbed; the others are choices.
    """

    speed: float = 0.7
    thrust: float = 0.6
    turn: float = 4.0
    slack: float = 1.0
    underway: float = 0.5
    first: float = 8.0
    gap: float = 5.0
    last: float = 15.0
    clearance: float = 0.2
    wall: float = 0.05
    avoid: float = 0.15
    interior: float = 0.0
    run_up: float = 0.15
    braking: float = 0.75
    push: float = 0.1
    push_speed: float = 0.02
    tracking: float = 1e-3

    def quickened(self) -> Reserves:
        """Return a copy with half the margin of speed, for tasks whose deadline is tight."""
        return replace(self, speed=0.5 * (1.0 + self.speed))

    def halved(self) -> Reserves:
        """Return a copy with half the margins, for tight tasks."""
        return replace(
            self,
            speed=0.5 * (1.0 + self.speed),
            thrust=0.5 * (1.0 + self.thrust),
            first=0.5 * self.first,
            gap=0.5 * self.gap,
            last=0.5 * self.last,
            clearance=0.5 * self.clearance,
            push=0.5 * self.push,
            avoid=0.5 * self.avoid,
        )

    def times(self, horizon: float) -> tuple[float, float, float]:
        """Return the times (first, gap, last) for a horizon [s]."""
        last = min(self.last, max(0.4 * self.last, 0.15 * horizon), 0.2 * horizon)
        return min(self.first, 0.27 * horizon), min(self.gap, 0.17 * horizon), last

    def acceleration(self, robot: Robot) -> float:
        """Return the greatest planned acceleration of a robot per axis [m/s^2]."""
        return self.thrust * robot.force_limit / robot.mass

    def cruise(self, robot: Robot) -> float:
        """Return the greatest planned speed of a robot between impacts per axis [m/s]."""
        return min(self.speed * robot.speed_limit, self.turn * self.acceleration(robot))

    def turning(self, robot: Robot) -> float:
        """Return the time a robot loses on a leg by starting and stopping [s]."""
        return self.slack * self.cruise(robot) / self.acceleration(robot)
