"""Which impact of each object comes next, when it is expected, and what happened to it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planners.free_flyer.two_body import Outcome, TwoBodyImpact
from planners.plan import Plan, PlannedImpact

REPLAN_WINDOW = 20.0  # before an impact [s]
REPLAN_PERIOD = 0.5  # [s]
REPLAN_LAST = 1.0  # before an impact; later changes only shake the robot [s]
SETTLE = 1.5  # after a contact, until the object's velocity is known well enough to plan with [s]
DECISION_LEAD = 8.0  # before an impact its correction is decided [s]
DECISION_SETTLE = 2.5  # after the previous contact, at least [s]
EARLIEST = 2.0  # before the expected impact a contact is taken for it [s]
PATIENCE = 1.5  # after the expected impact it counts as missed [s]
RETRY = 5.0  # a missed impact is tried again after [s]
RETRIES = 3
OBSERVABLE = 1.0  # after a contact the object's velocity change can be observed [s]
SHORTEST_NOTICE = DECISION_SETTLE + REPLAN_LAST + REPLAN_PERIOD  # of an impact after a contact that came late [s]
ROUND_OFF = 1e-6  # of times [s]


@dataclass(eq=False)
class Strike:
    """The coming impact of one object.

    Attributes:
        planned: what the plan says of it.
        index: number of the impact in the plan.
        time: when it is expected [s].
        misses: how often it did not happen.
        correction: of the impulse, in [-1, 1].
        decided: the correction is final.
        replanned: time of the last replanning [s].
        solution: of the two-body problem at the last replanning.
    """

    planned: PlannedImpact
    index: int
    time: float
    misses: int = 0
    correction: tuple[float, float] = (0.0, 0.0)
    decided: bool = False
    replanned: float = -math.inf
    solution: TwoBodyImpact | None = None


@dataclass(eq=False)
class Hit:
    """A planned impact that happened.

    Attributes:
        object: that was hit.
        time: when it was felt [s].
        before: velocity of the object before, shape (2,) [m/s].
        commanded: size of the commanded velocity change [m/s].
        ratio: observed over commanded change, 0 until it can be observed.
    """

    object: str
    time: float
    before: np.ndarray
    commanded: float
    ratio: float = 0.0


class Schedule:
    """Keep the coming impact of every object.

    Args:
        plan: the sequence of impacts of each object.

    Attributes:
        strikes: object to its coming impact; objects without one are left out.
        last_contact: object to the time of its last contact with a robot, -inf before any [s].
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.reset()

    def reset(self) -> None:
        """Start from the first impacts."""
        self.strikes: dict[str, Strike] = {}
        self._hits: list[Hit] = []
        self.last_contact = dict.fromkeys(self.plan.objects, -math.inf)
        for name in self.plan.objects:
            self._advance(name, -1, 0.0)

    def strike_of(self, robot: str) -> Strike | None:
        """Return the robot's coming impact, if it is the next one of its object."""
        mine = [strike for strike in self.strikes.values() if strike.planned.robot == robot]
        first = min(mine, key=lambda strike: strike.time, default=None)
        return first if first is None or first.time <= self.next_impact(robot)[0] else None

    def next_impact(self, robot: str) -> tuple[float, float]:
        """Return when the robot has to be somewhere next: expected and planned time of its next impact, or horizon."""
        ahead = [(self.plan.horizon, self.plan.horizon)]
        for name, strike in self.strikes.items():
            later = self.plan.impacts[strike.index + 1 :]
            ahead += [(strike.time, strike.planned.time)] if strike.planned.robot == robot else []
            ahead += [(i.time, i.time) for i in later if i.robot == robot and i.object == name]
        return min(ahead)

    def target(self, strike: Strike) -> tuple[np.ndarray, float]:
        """Return where the object should be next, and when: at its next impact, or at the horizon [m], [s]."""
        after = self._following(strike.planned.object, strike.index)
        if after is None:
            horizon = self.plan.horizon
            return self.plan.objects[strike.planned.object].position(horizon, "left"), horizon
        return self.plan.impacts[after].position, self.plan.impacts[after].time

    def is_last(self, strike: Strike) -> bool:
        """Return whether no further impact of the object is planned."""
        return self._following(strike.planned.object, strike.index) is None

    def should_replan(self, strike: Strike, now: float) -> bool:
        """Return whether the course to the impact is to be planned anew."""
        settled = now >= self.last_contact[strike.planned.object] + SETTLE - ROUND_OFF
        in_window = strike.time - REPLAN_WINDOW <= now + ROUND_OFF and now <= strike.time - REPLAN_LAST + ROUND_OFF
        return settled and in_window and now >= strike.replanned + REPLAN_PERIOD - ROUND_OFF

    def find_due(self, now: float) -> Strike | None:
        """Return the impact whose correction is to be decided now."""
        for name, strike in self.strikes.items():
            due = max(strike.time - DECISION_LEAD, self.last_contact[name] + DECISION_SETTLE)
            if not strike.decided and now >= due - ROUND_OFF:
                return strike
        return None

    def take_contact(self, robot: str, other: str, now: float, before: np.ndarray) -> Strike | None:
        """Take note of a contact; the coming impact is done if robot, object and time fit.

        Args:
            robot: that felt it.
            other: body it touched, "" for none.
            now: present time [s].
            before: velocity of that body before, shape (2,) [m/s].

        Returns:
            The impact that is done, None if the contact was none of the plan.
        """
        if other in self.last_contact:
            self.last_contact[other] = now
        strike = self.strikes.get(other)
        if strike is None or strike.planned.robot != robot or now < strike.time - EARLIEST:
            return None
        if strike.solution is not None:
            commanded = math.dist(strike.solution.object_plus, strike.solution.object_minus)
            self._hits.append(Hit(other, now, before, commanded))
        self._advance(other, strike.index, now)
        return strike

    def observe_hits(self, velocities: Mapping[str, np.ndarray], now: float) -> None:
        """Compare what the last impact of each object did with what it should have done.

        Args:
            velocities: object to its present velocity, shape (2,) [m/s].
            now: present time [s].
        """
        for hit in {hit.object: hit for hit in self._hits}.values():
            untouched = self.last_contact[hit.object] == hit.time
            if untouched and now >= hit.time + OBSERVABLE and hit.commanded > 0.0:
                hit.ratio = math.dist(velocities[hit.object], hit.before) / hit.commanded

    def ratios(self, name: str) -> list[float]:
        """Return observed over commanded velocity change at the impacts of an object, in order of time."""
        return [hit.ratio for hit in self._hits if hit.object == name and hit.ratio > 0.0]

    def take_misses(self, now: float) -> list[tuple[Strike, bool]]:
        """Put off the impacts that are overdue, or give them up.

        Args:
            now: present time [s].

        Returns:
            The overdue impacts, each with whether it will be tried again.
        """
        overdue = []
        for strike in [strike for strike in self.strikes.values() if now > strike.time + PATIENCE]:
            hopeless = strike.solution is not None and strike.solution.outcome in (
                Outcome.NOT_NEEDED,
                Outcome.OUT_OF_REACH,
            )
            again = not hopeless and strike.misses < RETRIES and now + RETRY < self.plan.horizon
            if again:
                strike.misses, strike.time, strike.replanned = strike.misses + 1, now + RETRY, -math.inf
            else:
                self._advance(strike.planned.object, strike.index, now)
            overdue.append((strike, again))
        return overdue

    def _following(self, name: str, index: int) -> int | None:
        later = range(index + 1, len(self.plan.impacts))
        return next((i for i in later if self.plan.impacts[i].object == name), None)

    def _advance(self, name: str, index: int, now: float) -> None:
        self.strikes.pop(name, None)
        following = self._following(name, index)
        if following is not None:
            planned = self.plan.impacts[following]
            self.strikes[name] = Strike(planned, following, max(planned.time, now + SHORTEST_NOTICE))
