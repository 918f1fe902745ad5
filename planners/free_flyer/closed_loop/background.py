"""Replan in background processes when the current plan can no longer succeed; the loop goes on meanwhile.

A plan is asked for from the state that is expected `delay` later, and taken over then, in simulated time. Planning ends
by its work, not by the clock, so an episode does not depend on the machine; where simulated time runs faster than the
processes plan, the loop waits.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.options import EXPERT, Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable, make_plan_table
from planners.free_flyer.belief.world_memory import PAST_PERIOD, WorldMemory
from planners.free_flyer.closed_loop.planning_process import PlanningProcesses
from planners.free_flyer.next_impact.desired_velocity import find_mass
from planners.free_flyer.nominal.remaining import make_remaining_scenario
from planners.free_flyer.tracking.course import evaluate_course
from planners.plan import Plan

EARLY = 1e-6  # of a plan's time, by round-off [s]


@dataclass(frozen=True)
class Request:
    """Hold what a world waits for.

    Attributes:
        number: of the request.
        begin: when the plan is taken over [s].
        scenario: what is left of the task then, in time that starts then.
    """

    number: int
    begin: float
    scenario: FreeFlyerScenario


class Background:
    """Ask for new plans and hand them over, world by world.

    Args:
        scenario: the whole task, as believed.
        options: of the closed loop.
    """

    def __init__(self, scenario: FreeFlyerScenario, options: Options = EXPERT) -> None:
        self._scenario, self._options = scenario, options
        self._pending: dict[int, Request] = {}
        self._asked: dict[int, int] = {}
        self._next: dict[int, float] = {}
        self._numbers = 0
        self._processes = PlanningProcesses(options.background.processes, options.background.patience)

    def forget_world(self, k: int) -> None:
        """Forget what world k has asked for."""
        request = self._pending.pop(k, None)
        if request is not None:
            self._processes.forget(request.number)
        self._asked.pop(k, None)
        self._next.pop(k, None)

    def poll_plan(self, table: PlanTable, memory: WorldMemory, k: int) -> PlanTable | None:
        """Return a new table for world k to follow from now on, if there is one; ask for one if it is wanted.

        Args:
            table: what world k follows.
            memory: of all worlds.
            k: world.
        """
        now, request = float(memory.time[k]), self._pending.get(k)
        if request is not None:
            if now < request.begin - EARLY:
                return None
            taken = self._take_plan(memory, k, request)
            del self._pending[k]  # only now: an interrupted wait leaves a question that can be forgotten
            self._allow_next(k, now)
            return taken
        if now >= self._next.get(k, math.inf):
            del self._next[k]
            memory.wanted[k] = math.inf
        elif 0.0 <= memory.wanted[k] <= now and _is_calm(memory, self._options, k, now):
            # No further plan is wanted before this one had time to act.
            memory.wanted[k] = -math.inf
            if table.horizon - now >= self._options.background.least_left:
                self._ask_plan(table, memory, k, now)
        return None

    def find_wake(self, k: int) -> float:
        """Return when `poll_plan` will do something for world k, inf if it asked for nothing [s]."""
        request = self._pending.get(k)
        return self._next.get(k, math.inf) if request is None else request.begin - EARLY

    def find_busy(self, memory: WorldMemory) -> np.ndarray:
        """Return the worlds that `poll_plan` may do something for."""
        busy = (memory.wanted >= 0.0) & (memory.wanted <= memory.time)
        busy[[*self._pending, *self._next]] = True
        return np.flatnonzero(busy)

    def close(self) -> None:
        """End the processes."""
        self._processes.close()

    def _allow_next(self, k: int, now: float) -> None:
        if self._asked[k] < self._options.background.most:
            self._next[k] = now + self._options.background.apart

    def _ask_plan(self, table: PlanTable, memory: WorldMemory, k: int, now: float) -> None:
        self._asked[k] = self._asked.get(k, 0) + 1
        begin = round(round((now + self._options.background.delay) / table.period) * table.period, 9)
        try:
            rest = self._make_rest(table, memory, k, now, begin)
        except InputError:
            memory.counts["no_plan"][k] += 1
            self._allow_next(k, now)
            return
        self._numbers += 1
        data = {
            "number": self._numbers,
            "scenario": rest.model_dump(mode="json"),
            "impacts": _count_impacts(table, memory, k),
            "work": self._options.background.work,
            "nodes": self._options.background.nodes,
        }
        self._pending[k] = Request(self._numbers, begin, rest)
        self._processes.ask(self._numbers, json.dumps(data) + "\n")

    def _make_rest(self, table: PlanTable, memory: WorldMemory, k: int, now: float, begin: float) -> FreeFlyerScenario:
        """Make the scenario that is left at `begin`: objects fly on, robots follow their courses."""
        positions, velocities = {}, {}
        curves = memory.flown[k] if len(table.response) else table.coefficients
        for i, name in enumerate(self._scenario.bodies):
            if i < table.robots:
                motion = evaluate_course(memory.course[k, i], table.breaks, curves, i, begin)[:4]
            else:
                motion = (*find_mass(memory, k, i, begin), *extrapolate_flight(memory, k, i, begin)[2:])
            positions[name], velocities[name] = np.array(motion[:2]), np.array(motion[2:])
        seen = int(now / PAST_PERIOD + EARLY) + 1
        times = np.append(PAST_PERIOD * np.arange(seen), begin)
        tracks = {
            name: np.vstack([memory.past[k, :seen, i], positions[name]]) for i, name in enumerate(self._scenario.bodies)
        }
        return make_remaining_scenario(self._scenario, begin, positions, velocities, (times, tracks))

    def _take_plan(self, memory: WorldMemory, k: int, request: Request) -> PlanTable | None:
        answer: dict[str, Any] = self._processes.wait_for(request.number)
        if answer["plan"] is None:
            memory.counts[answer["failure"]][k] += 1
            return None
        table = make_plan_table(request.scenario, Plan.from_json(answer["plan"]), request.begin, self._options.weights)
        if len(table.impact) > memory.clock.shape[1]:
            memory.counts["no_plan"][k] += 1
            return None
        memory.counts["planned_anew"][k] += 1
        return table


def _is_calm(memory: WorldMemory, options: Options, k: int, now: float) -> bool:
    """Return whether no impact is near now or when a new plan is taken over."""
    strike = memory.strike[k]
    coming = strike[(strike["index"] != NO_IMPACT) | strike["is_inserted"]]
    settled = (now >= strike["last_contact"] + options.timing.settle).all()
    return bool((coming["time"] > now + options.background.delay + options.background.calm).all() and settled)


def _count_impacts(table: PlanTable, memory: WorldMemory, k: int) -> int:
    left = 0
    for o in range(len(table.first)):
        at = memory.strike[k, o]["index"]
        while at != NO_IMPACT:
            at, left = table.impact[at]["next"], left + 1
    return left
