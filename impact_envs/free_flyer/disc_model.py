"""The exact engine as a model: one world of discs, and the choice between it and pymunk."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from impact_envs.compiled import announce
from impact_envs.free_flyer.command import read_commands
from impact_envs.free_flyer.contact.pair import EVENTS
from impact_envs.free_flyer.engine import step_alone
from impact_envs.free_flyer.model import FreeFlyerModel
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.truth import Physics
from impact_envs.free_flyer.worlds import (
    HITS,
    LIMIT,
    OVERFLOW,
    ROW,
    STEPS,
    STRUCK,
    make_arena,
    make_scratch,
    make_worlds,
    read_states,
    write_physics,
    write_states,
)
from impact_envs.interface.failure import TooManyEvents
from impact_envs.physics.impact import Impact, LastingContact


def make_model(scenario: FreeFlyerScenario) -> FreeFlyerModel | DiscModel:
    """Make the model of a scenario: the engine it names, or the exact one wherever it can serve."""
    exact = scenario.engine == "exact" or (scenario.engine is None and not scenario.has_polygons)
    return DiscModel(scenario) if exact else FreeFlyerModel(scenario)


class DiscModel:
    """Physics of free-flyers and objects that are discs, as ``FreeFlyerModel`` describes them, compiled.

    Args:
        scenario: who is where.

    Raises:
        InputError: an object is no disc.
    """

    def __init__(self, scenario: FreeFlyerScenario) -> None:
        announce(step_alone)
        self.scenario = scenario
        self._arena, self._names = make_arena(scenario)
        self._scratch = make_scratch(self._arena, 1)
        self._log = np.zeros((1, EVENTS, ROW))
        self._robots = scenario.robots
        self._limits = self._arena.discs[: len(scenario.robots), LIMIT:].copy()
        self.reset(scenario.as_believed().draw(np.random.default_rng(0)))

    def reset(self, physics: Physics) -> None:
        """Put all bodies at their start, in a world with these physics.

        Args:
            physics: the drawn numbers of one episode.
        """
        self.physics = physics
        self._arena = self._arena._replace(on_off=physics.true.thruster_on_off)
        worlds = self._worlds = make_worlds(self._arena, 1, shifts=True, gains=True, held=True)
        write_physics(worlds, 0, physics)
        self._states = np.empty((1, len(self.scenario.bodies), 6))
        self._arrays = (*self._arena, *worlds, *self._scratch, self._log)
        self.set_state(self.scenario.place_bodies(physics))

    @property
    def time(self) -> float:
        """Return the time since reset [s]."""
        return int(self._worlds.counter[0, STEPS]) * self.scenario.control_period

    def state(self) -> np.ndarray:
        """Return the state of all bodies (see ``FreeFlyerModel.state``), shape (bodies, 6)."""
        return self._states[0].copy()

    def set_state(self, states: np.ndarray) -> None:
        """Move all bodies to a state; time and what on/off thrusters owe go on.

        Args:
            states: as ``state`` returns them, shape (bodies, 6).
        """
        write_states(self._worlds, 0, np.array(states, dtype=float)[None], 0)
        read_states(self._worlds, 0, self._states)

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
        held = read_commands(controls, self._robots, self._limits, "control")
        step_alone(*self._arrays, held, self._states)
        if self._worlds.counter[0, OVERFLOW]:
            raise TooManyEvents(EVENTS, ("", *self.scenario.bodies)[self._worlds.counter[0, STRUCK]])
        hits = int(self._worlds.counter[0, HITS])
        return [self._impact(row) for row in self._log[0, :hits].tolist()] if hits else []

    @property
    def lasting_contacts(self) -> list[LastingContact]:
        """Return what lasting contacts exchanged in the last control period, one record for each pair."""
        held = self._worlds.held[0]
        if not any(held.ravel().tolist()):
            return []
        found, n = [], len(self.scenario.bodies)
        for (i, j), impulse in zip(self._arena.pairs.tolist(), held, strict=True):
            if impulse.any():
                a, b, sign = (i, j, 1.0) if j < n else (j, i, -1.0)  # the fixed one is named first
                x, y = (sign * impulse).tolist()
                found.append(LastingContact(self.time, self._names[a], self._names[b], (x, y)))
        return found

    def _impact(self, row: list[float]) -> Impact:
        time, i, j, px, py, nx, ny, along, across, speed = row
        a, b = self._names[int(i)], self._names[int(j)]
        if j >= len(self.scenario.bodies):  # the fixed one is named first
            a, b, nx, ny, along, across = b, a, -nx, -ny, -along, -across
        return Impact(time, a, b, (px, py), (nx, ny), (along, across), speed)
