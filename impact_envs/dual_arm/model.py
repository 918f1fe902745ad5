"""Two planar arms and a box on a table with compliant contact, stepped one tick of held torques at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from impact_envs.compiled import announce, bind
from impact_envs.dual_arm.grasp_record import COUNT, GraspRecord
from impact_envs.dual_arm.plant import BOX, STATE
from impact_envs.dual_arm.schema import DualArmScenario, Physics
from impact_envs.dual_arm.world import (
    ALONG,
    IMPULSE,
    PERIOD,
    PLANT,
    POINT,
    ROWS,
    SPEED,
    TICK,
    TIME,
    WORLD,
    make_clock,
    run_model,
    set_joints,
    start_world,
)
from impact_envs.errors import InputError, choices
from impact_envs.interface.failure import are_finite
from impact_envs.physics.impact import Impact


class DualArmModel:
    """Physics of the dual-arm domain.

    Joint torques are held over a tick and clipped to their limits. With flexible joints they are the commands of the
    low-level torque loop. The corners of the pads touch the box's two side faces; its other faces and the arms' links
    touch nothing. The table supports the box's lower corners.

    Args:
        scenario: who is where.

    Attributes:
        physics, plant: the drawn numbers of the episode, and the plant made of them.
    """

    def __init__(self, scenario: DualArmScenario) -> None:
        self.scenario = scenario
        self._plants, self._worlds = np.zeros(1, PLANT), np.zeros(1, WORLD)
        self._clock, self._work = make_clock(scenario), np.zeros((6, STATE))
        self._torques = np.zeros((scenario.ticks, 2, 3))
        announce(run_model)
        self.reset(scenario.as_believed().draw(np.random.default_rng(0)))
        self._bind()

    def reset(self, physics: Physics) -> None:
        """Put pads and box at their starts, at rest, with the joint springs bent by the arms' weight.

        Args:
            physics: the drawn numbers of one episode.
        """
        self.physics = physics
        self.plant = start_world(self.scenario, physics, self._plants, self._worlds)

    @property
    def time(self) -> float:
        """Return the time since reset [s]."""
        return int(self._worlds[0]["marks"][COUNT]) * self.scenario.tick

    def set_joints(self, q: np.ndarray, v: np.ndarray) -> None:
        """Set the joints, with their springs bent by the arms' weight.

        Args:
            q: joint angles, shape (2, 3) [rad].
            v: joint rates, shape (2, 3) [rad/s].
        """
        set_joints(self.plant, self._worlds[0], q, v)

    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Return joint angles and rates on the link side, shapes (2, 3) [rad], [rad/s]."""
        arms = self._worlds[0]["state"][:BOX].reshape(2, 4, 3)
        return arms[:, 0].copy(), arms[:, 1].copy()

    def state(self) -> np.ndarray:
        """Return the state of all bodies.

        Returns:
            Rows of both pads and the box, shape (3, 22): x, y, vx, vy, heading, omega; then (zeros for the box) three
            joint angles, three joint rates, the normal forces at the pad's corners; then the grasp's record in the
            order of `schema.GRASP_SIGNALS` [m, m/s, rad, rad/s, N, N m, s].
        """
        self._call(*self._arrays, ROWS)
        return self._rows.copy()

    def contacts(self) -> np.ndarray:
        """Return the contacts at the current state.

        Returns:
            Rows gap [m], gap rate, slip rate [m/s], normal and tangential force on the box [N] of the corners of pad
            1 (2), of pad 2 (2) and of the box on the table (2), shape (6, 5); zeros before the first tick.
        """
        return self._worlds[0]["contacts"].copy()

    def slips(self) -> np.ndarray:
        """Return the net slip of each pad corner while it touched, since reset, shape (4,) [m]."""
        return self._worlds[0]["sums"][:, 0].copy()

    def record(self) -> GraspRecord:
        """Return the record of the grasp, as views."""
        return GraspRecord(*(self._worlds[0][name] for name in GraspRecord._fields))

    def tick(self, torques: np.ndarray) -> None:
        """Advance one tick under held torques.

        Args:
            torques: of each arm's joints, clipped to their limits, shape (2, 3) [N m].
        """
        self._torques[0] = torques
        self._call(*self._arrays, TICK)

    def step(self, controls: Mapping[str, np.ndarray]) -> list[Impact]:
        """Advance one control period.

        Args:
            controls: arm to its joint torques, held, shape (3,), or one row per tick, shape (ticks, 3) [N m].

        Returns:
            The first touch of each pad, with the impulse up to the end of its tick, in order of time.

        Raises:
            InputError: an arm without control, an unknown arm, or a control that is not finite torques.
        """
        arms = self.scenario.arms
        if controls.keys() != arms.keys():
            wrong = ", ".join(sorted(controls.keys() ^ arms.keys()))
            raise InputError(f"controls must name every arm once; wrong or missing: {wrong}; {choices(wrong, arms)}")
        ticks = len(self._torques)
        for i, name in enumerate(arms):
            values = np.asarray(controls[name], dtype=float)
            if values.shape not in ((3,), (ticks, 3)) or not are_finite(values):
                text = np.array2string(values, threshold=8).replace("\n", "")
                raise InputError(
                    f"control of {name} = {text}: 3 finite joint torques are needed, or {ticks} rows of them"
                )
            self._torques[:, i] = values
        self._call(*self._arrays, PERIOD)
        return self._list_touches() if any(self._hits.tolist()) else []

    def _list_touches(self) -> list[Impact]:
        """Return the pads' first touches in the last control period, as impacts on the box, in order of time."""
        world, found = self._worlds[0], list[Impact]()
        for i, name in enumerate(self.scenario.arms):
            if world["hits"][i]:
                touch = world["touches"][i].tolist()
                point, normal, impulse = ((touch[k], touch[k + 1]) for k in (POINT, ALONG, IMPULSE))
                found.append(Impact(touch[TIME], name, "box", point, normal, impulse, touch[SPEED]))
        return sorted(found, key=lambda impact: impact.time)

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: value for name, value in self.__dict__.items() if name not in ("_call", "_arrays", "_rows", "_hits")
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def _bind(self) -> None:
        """Look the compiled function up once; its arguments stay the same."""
        self._arrays = self._plants, self._worlds, self._clock, self._work, self._torques
        self._rows, self._hits = self._worlds["rows"][0], self._worlds["hits"][0]
        self._call: Callable[..., Any] = bind(run_model, *self._arrays, ROWS)
