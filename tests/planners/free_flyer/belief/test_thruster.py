"""Gains of thrusters are found from commands and positions, through noise, delay and contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.thruster import learn_thrust, start_passes
from planners.free_flyer.belief.world_memory import FILTER, THRUST

PERIOD, STRONG = 0.1, 0.06  # [s], [m/s^2]
OPTIONS = make_record(EXPERT)[0]
PRIOR = EXPERT.thruster


class Robot:
    """A robot that starts at rest, and what is believed of its thrusters."""

    def __init__(self, gains: tuple[float, ...], sigma: float = 0.0, delay: int = 0, heading: float = 0.0) -> None:
        self.gains, self.sigma, self.heading = np.array(gains), sigma, heading
        self.rng = np.random.default_rng(3)
        self.places, self.velocity, self.now = [np.zeros(2)] * (delay + 1), np.zeros(2), 0.0
        self.thrust, self.z = np.zeros(1, THRUST)[0], np.zeros(1, FILTER)[0]
        self.thrust["gain"] = self.thrust["estimate"] = 1.0
        self.thrust["variance"] = PRIOR.spread**2
        start_passes(self.thrust, OPTIONS, self.z, 0.0)

    def fly(self, *commands: tuple[float, float]) -> Any:
        """Fly one period by each command, in the body's frame [m/s^2]; return what is believed."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        for command in commands:
            force = np.array(command) * np.where(np.array(command) >= 0.0, self.gains[::2], self.gains[1::2])
            push = np.array([[cos, -sin], [sin, cos]]) @ force
            self.places.append(self.places[-1] + PERIOD * self.velocity + PERIOD**2 / 2 * push)
            self.velocity, self.now = self.velocity + PERIOD * push, self.now + PERIOD
            self.places.pop(0)
            x, y = self.places[0] + self.sigma * self.rng.normal(size=2)
            self.thrust["command"] = command
            self.z["position"], self.z["velocity"] = (x, y), self.velocity
            learn_thrust(self.thrust, OPTIONS, self.z, self.heading, x, y, self.sigma, self.now, PERIOD)
        return self.thrust


def test_filtered_accelerations_are_exact_in_samples() -> None:
    robot, tau = Robot((0.5, 1.1, 0.8, 0.9)), PRIOR.low_pass
    commands = STRONG * np.random.default_rng(0).uniform(-1, 1, (100, 2))
    believed = robot.fly(*map(tuple, commands))
    seen = (robot.places[-1] - 2 * believed["once"] + believed["twice"]) / tau**2
    told = (robot.gains * believed["push_twice"]).reshape(2, 2).sum(axis=1)
    assert seen == pytest.approx(told, abs=1e-12)


@pytest.mark.parametrize("heading", [0.0, 2.5])
def test_weak_thruster_is_found(heading: float) -> None:
    believed = Robot((0.5, 1.0, 1.0, 1.0), heading=heading).fly(*[(STRONG, 0.0)] * 60)
    assert believed["estimate"][0] == pytest.approx(0.5, abs=0.06)
    assert believed["gain"][0] == pytest.approx(0.5, abs=0.1)
    assert believed["estimate"][1:] == pytest.approx(1.0)


def test_both_directions_of_an_axis_are_told_apart() -> None:
    pushes = [(STRONG, 0.0)] * 40 + [(-STRONG, 0.0)] * 40
    believed = Robot((1.0, 0.5, 1.0, 1.0)).fly(*pushes, *pushes)
    assert believed["estimate"][:2] == pytest.approx([1.0, 0.5], abs=0.08)


def test_delay_is_no_weakness() -> None:
    believed = Robot((1.0, 1.0, 1.0, 1.0), delay=3).fly(*[(STRONG, 0.0)] * 60)
    assert believed["estimate"][0] == pytest.approx(1.0, abs=0.1)


def test_noise_changes_no_command() -> None:
    robot = Robot((1.0, 1.0, 1.0, 1.0), sigma=5e-3)
    wave = STRONG * np.sin(0.5 * PERIOD * np.arange(400))
    assert robot.fly(*[(u, -u) for u in wave])["gain"].tolist() == [1.0] * 4


def test_small_pushes_tell_nothing() -> None:
    believed = Robot((0.5, 0.5, 0.5, 0.5)).fly(*[(PRIOR.least / 2, 0.0)] * 100)
    assert believed["estimate"].tolist() == [1.0] * 4


def test_contact_is_taken_for_no_thrust() -> None:
    robot = Robot((1.0, 1.0, 1.0, 1.0))
    robot.fly(*[(STRONG, 0.0)] * 40)
    robot.velocity = -robot.velocity
    robot.thrust["ready"] = robot.now + PRIOR.settle
    before = robot.thrust["estimate"].copy()
    assert robot.fly(*[(STRONG, 0.0)] * 19)["estimate"].tolist() == before.tolist()
    assert robot.fly(*[(STRONG, 0.0)] * 60)["estimate"] == pytest.approx(1.0, abs=0.05)


def test_belief_stays_within_bounds() -> None:
    dead = Robot((0.0, 1.0, 1.0, 1.0)).fly(*[(STRONG, 0.0)] * 200)
    assert dead["estimate"][0] == PRIOR.weakest
    mighty = Robot((3.0, 1.0, 1.0, 1.0)).fly(*[(STRONG, 0.0)] * 200)
    assert mighty["estimate"][0] == PRIOR.strongest
