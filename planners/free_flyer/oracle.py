"""The expert that is told the truth of its episode, one world or many: what any learning can gain is bounded by it.

It sees what the expert sees, and is the expert: only its belief opens with the true restitution, mass, drift and centre
of mass of every object instead of the believed ones, certain, and it knows which of its controls a reading is behind.
Whoever judges it hands over the drawn numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin, log
from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.engine import turn_drift
from impact_envs.free_flyer.observation import join_observations
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.sensing import TIME, find_shared_place
from impact_envs.free_flyer.truth import (
    DELAY,
    DRIFT_X,
    DRIFT_Y,
    MASS,
    MOST_DELAY,
    OFFSET_X,
    OFFSET_Y,
    RESTITUTION,
    RESTITUTION_SPEED,
    TURN,
    Physics,
)
from impact_envs.physics.impact import compute_restitution
from planners.free_flyer.belief.impact_parameters import find_row
from planners.free_flyer.belief.offset import LEAST
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from planners.plan import Plan

# What can be told.
PARTS = ("restitution", "mass", "offset", "drift", "delay")
CERTAIN = 1e-3  # standard deviation of a restitution, or of the logarithm of a mass, that is told
# What one object's truth is, as compiled code takes it.
TOLD = np.dtype(
    [
        ("offset", float, 2),  # centre of mass in the body frame, from the geometric centre [m]
        ("drift", float, 2),  # acceleration at the start of the episode [m/s^2]
        ("turn", float),  # rate at which its direction turns [rad/s]
    ]
)


class Truth:
    """What N worlds' oracle is told.

    Args:
        scenario: as believed.
        plan: that is followed; restitution that falls with speed is told for its speeds of approach.
        count: N.
        parts: of PARTS; what is not told is believed and learned as the expert does.

    Raises:
        InputError: an unknown part.
    """

    def __init__(self, scenario: FreeFlyerScenario, plan: Plan, count: int, parts: Sequence[str] = PARTS) -> None:
        for part in parts:
            if part not in PARTS:
                raise InputError(f"part '{part}' of the truth is unknown; {choices(part, PARTS)}")
        self._parts, self._period, self._robots = parts, float(scenario.control_period), len(scenario.robots)
        speeds = [float((hit.robot_minus - hit.object_minus) @ hit.normal) for hit in plan.impacts]
        self._approach = float(np.mean(speeds)) if speeds else 0.0
        self.told = np.zeros((count, len(scenario.objects)), TOLD)
        self.delay = np.zeros(count, np.int64)  # [control periods]
        # What the robots did in the last control periods, newest first: accelerations [m/s^2] and turning [rad/s^2].
        self.pushes = np.zeros((count, self._robots, MOST_DELAY + 1, 3))
        self._masses = np.array([scenario.body(name).mass for name in scenario.bodies])
        self._restitution = np.full(count, float(scenario.believed.restitution))
        self._mass = np.tile(self._masses, (count, 1))
        self._waits = np.zeros(count, bool)

    def tell(self, worlds: np.ndarray, physics: Physics) -> None:
        """Take note of the truth of some worlds that start an episode.

        Args:
            worlds: their numbers, shape (m,).
            physics: of these worlds, as ``draw_many`` returns it.
        """
        objects, told = physics.body[:, self._robots :], np.zeros((len(worlds), self.told.shape[1]), TOLD)
        if "offset" in self._parts:
            told["offset"] = objects[:, :, OFFSET_X : OFFSET_Y + 1]
        if "drift" in self._parts:
            told["drift"], told["turn"] = objects[:, :, DRIFT_X : DRIFT_Y + 1], objects[:, :, TURN]
        self.told[worlds] = told
        self.delay[worlds] = physics.sensor[:, DELAY] if "delay" in self._parts else 0
        laws = physics.contact[:, [RESTITUTION, RESTITUTION_SPEED]].tolist()
        self._restitution[worlds] = [compute_restitution(self._approach, *law) for law in laws]
        self._mass[worlds] = physics.body[:, :, MASS]
        self.pushes[worlds] = 0.0
        self._waits[worlds] = True

    def read(self, joint: np.ndarray, horizon: float, memory: WorldMemory) -> None:
        """Turn the drifts that are told into those of now, and take the pushes that a reading is behind.

        Args:
            joint: everything measured once, shape (N, size).
            horizon: [s].
            memory: of the expert.
        """
        if "drift" in self._parts:
            turn_drifts(self.told, self._period, horizon, joint, memory.filter)
        late = self.pushes[np.arange(len(joint)), :, self.delay]
        memory.push[:], memory.spin[:] = late[:, :, :2], late[:, :, 2]

    def keep(self, plan: PlanTable, memory: WorldMemory, options: Options) -> None:
        """Open the belief of worlds whose first reading the expert took; remember what the robots do.

        Args:
            plan: of the expert.
            memory: of the expert, changed in place.
            options: of the expert, as a record.
        """
        self.pushes[:, :, 1:] = self.pushes[:, :, :-1]
        self.pushes[:, :, 0, :2], self.pushes[:, :, 0, 2] = memory.push, memory.spin
        for k in np.flatnonzero(self._waits).tolist():
            self._open_pairs(memory, k)
            self._open_filters(plan, memory, options, k)
        self._waits[:] = False

    def _open_pairs(self, memory: WorldMemory, k: int) -> None:
        """Open the Gaussian of restitutions and mass ratios of world k."""
        objects = self.told.shape[1]
        for r in range(self._robots):
            for o in range(objects):
                i = find_row(memory, r, o)
                values = self._restitution[k], log(self._mass[k, self._robots + o] / self._mass[k, r])
                for part, place, value in zip(("restitution", "mass"), (i, i + 1), values, strict=True):
                    if part in self._parts:
                        memory.pair_mean[k, :, place] = value
                        memory.pair_covariance[k, :, place, :] = memory.pair_covariance[k, :, :, place] = 0.0
                        memory.pair_covariance[k, :, place, place] = CERTAIN * CERTAIN

    def _open_filters(self, plan: PlanTable, memory: WorldMemory, options: Any, k: int) -> None:
        """Open the filters of world k's objects with their centres of mass and drifts."""
        sure, slow = options["estimation"]["start_position"], options["estimation"]["start_velocity"]
        for o in range(self.told.shape[1]):
            i = self._robots + o
            z, body, told = memory.filter[k, i], plan.body[i], self.told[k, o]
            if "offset" in self._parts:
                (cos, sin), rate = cos_sin(body["heading"]), body["start_rate"]
                dx, dy = told["offset"]
                x, y = cos * dx - sin * dy, sin * dx + cos * dy
                z["position"], z["velocity"] = body["start"], body["start_velocity"] + (-rate * y, rate * x)
                z["P_pp"], z["P_vv"], z["P_pv"] = sure * sure + body["spread"] ** 2 / 3.0, slow * slow, 0.0
                z["offset"], z["P_dd"] = -told["offset"], LEAST
                z["P_pd"] = z["P_vd"] = z["P_ad"] = 0.0
                memory.track[k, i]["doubted"] = -math.inf
            if "drift" in self._parts:
                z["drift"] = told["drift"]
                z["P_pa"] = z["P_va"] = z["P_aa"] = 0.0


@compiled
def turn_drifts(told: np.ndarray, period: float, horizon: float, joint: np.ndarray, filters: np.ndarray) -> None:
    """Turn the told drifts of N worlds into those of now.

    Args:
        told: TOLD of every object, shape (N, m).
        period: control period [s].
        horizon: [s].
        joint: everything measured once, shape (N, 7 n + r + 3).
        filters: FILTER of every body, whose drifts are written, shape (N, n).
    """
    bodies = filters.shape[1]
    robots = bodies - told.shape[1]
    clock = find_shared_place(bodies, robots) + TIME
    for k in range(joint.shape[0]):
        for o in range(told.shape[1]):
            steps = int(joint[k, clock] * horizon / period + 0.5)
            if steps > 0:
                drift = told[k, o].drift
                x, y = turn_drift(drift[0], drift[1], told[k, o].turn, steps, period)
                filters[k, robots + o].drift[0], filters[k, robots + o].drift[1] = x, y


class FreeFlyerOracle(FreeFlyerExpert):
    """The expert of one world, told the truth of every episode by `tell` after `reset`.

    Args:
        scenario: its true physics are not looked at.
        plan: to execute.
        options: of the expert.
        parts: of the truth, see PARTS.

    Raises:
        InputError: as FreeFlyerExpert, or an unknown part.
    """

    def __init__(
        self, scenario: FreeFlyerScenario, plan: Plan, options: Options | None = None, parts: Sequence[str] = PARTS
    ) -> None:
        self._truth = Truth(scenario.as_believed(), plan, 1, parts)
        super().__init__(scenario, plan, options=options)
        self.name = "oracle"

    def tell(self, physics: Physics) -> None:
        """Hand over the truth of the coming episode, as ``draw`` returns it."""
        parts = {name: part[None] for name, part in physics._asdict().items() if name != "true"}
        batch = Physics(**parts, true=physics.true)
        self._truth.tell(np.zeros(1, int), batch)

    def _join(self, observations: Mapping[str, np.ndarray]) -> None:
        join_observations(self._scenario, observations, self._joint[0])
        self._truth.read(self._joint, self.table.horizon, self.memory)

    def control(self) -> dict[str, np.ndarray]:
        """Return each robot's action; see FreeFlyerExpert."""
        actions = super().control()
        self._truth.keep(self.table, self.memory, self._record[0])
        return actions


class FreeFlyerOracleBatch(FreeFlyerExpertBatch):
    """The oracle of N worlds; world k acts as FreeFlyerOracle does.

    Args:
        scenario, plan, count, options, threads: see FreeFlyerExpertBatch.
        parts: of the truth, see PARTS.

    Raises:
        InputError: as FreeFlyerExpertBatch, or an unknown part.
    """

    def __init__(
        self,
        scenario: FreeFlyerScenario,
        plan: Plan,
        count: int,
        options: Options | None = None,
        threads: int = 1,
        parts: Sequence[str] = PARTS,
    ) -> None:
        super().__init__(scenario, plan, count, options=options, threads=threads)
        self._truth = Truth(scenario.as_believed(), plan, count, parts)

    def tell(self, physics: Physics, worlds: np.ndarray | None = None) -> None:
        """Hand over the truth of worlds that start an episode.

        Args:
            physics: as ``draw_many`` returns it.
            worlds: their numbers; all worlds if not given.
        """
        self._truth.tell(np.arange(self.count) if worlds is None else worlds, physics)

    def _read(self, observations: np.ndarray) -> np.ndarray:
        joint = super()._read(observations).copy()
        self._truth.read(joint, self._table.horizon, self.memory)
        return joint

    def _finish(self) -> None:
        self._truth.keep(self._table, self.memory, self.tables[1][0])
