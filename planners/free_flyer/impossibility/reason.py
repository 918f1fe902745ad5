"""Why a task has no plan, where places, times and speeds alone tell: within milliseconds, and in the user's words.

Only consequences of the formula are read, and only bounds that every plan keeps; so what has a plan is never refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario, Object
from impact_envs.stl import In, Predicate
from planners.budget import count_things
from planners.free_flyer.impossibility.coexistence import check_together
from planners.free_flyer.impossibility.convex_polygon import (
    clip,
    find_nearest,
    list_faces,
    make_box,
)
from planners.free_flyer.impossibility.least_way import FreeSpace, grow
from planners.free_flyer.impossibility.necessary_visits import (
    Alternative,
    Moment,
    Recurrence,
    Stay,
    Visit,
    list_alternatives,
    move_to_samples,
)
from planners.free_flyer.impossibility.reach import Kept, Reach, find_inner_radius, list_held
from planners.free_flyer.impossibility.visiting_order import (
    Call,
    Impossibility,
    check_orders,
    check_recurrences,
    say_place,
)
from planners.free_flyer.specification.requirement import Demands

MOST_REASONS = 3  # that are told where each alternative of a formula has its own
MOVE = "move the place or the body, or relax the formula"


def find_impossibility(
    scenario: FreeFlyerScenario, demands: Demands, max_impacts: int, kept: Kept
) -> Impossibility | None:
    """Return why a task has no plan; None: nothing that is looked at tells.

    Args:
        scenario: as it is believed.
        demands: of its formula.
        max_impacts: greatest number of impacts.
        kept: what a plan keeps in hand.
    """
    found: dict[str, Impossibility] = {}
    spaces: dict[tuple[str, tuple[Predicate, ...]], FreeSpace] = {}
    sampled = [move_to_samples(formula, scenario.control_period) for formula in demands.conjuncts.values()]
    for alternative in list_alternatives(sampled):
        brief = len(found) >= MOST_REASONS
        why = _Examiner(scenario, demands, alternative, max_impacts, kept, spaces, brief).examine()
        if why is None:
            return None
        found[why.reason] = why
    if len(found) == 1:
        return next(iter(found.values()))
    return Impossibility(" or, otherwise, ".join(list(found)[:MOST_REASONS]), next(iter(found.values())).remedy)


class _Examiner:
    """Examine one alternative of a formula."""

    def __init__(
        self,
        scenario: FreeFlyerScenario,
        demands: Demands,
        alternative: Alternative,
        max_impacts: int,
        kept: Kept,
        spaces: dict[tuple[str, tuple[Predicate, ...]], FreeSpace],
        brief: bool,
    ) -> None:
        self.scenario, self.demands, self.max_impacts, self.brief = scenario, demands, max_impacts, brief
        self.stays = [one for one in alternative if isinstance(one, Stay)]
        self.visits = [one for one in alternative if isinstance(one, Visit)]
        self.recurrences = [one for one in alternative if isinstance(one, Recurrence)]
        whole = [stay.predicate for stay in self.stays if stay.start <= 0.0 and stay.end >= scenario.horizon]
        self.reach = Reach(scenario, demands, kept, max_impacts, list_held(whole), spaces)
        self.unasked = Reach(
            scenario, demands, kept, max_impacts, {}, spaces
        )  # where bodies may be, whatever is asked of them

    def examine(self) -> Impossibility | None:
        """Return why nothing keeps the alternative."""
        calls = list(self._list_calls())
        for call in calls:
            why = self._check_place(call)
            if why is not None:
                return why
        together = self._check_starts() or check_together(
            self.scenario, self.visits, self.stays, calls, self.reach.forgiven
        )
        if together is not None:
            return together
        timed: list[Call] = []
        for call in calls:
            found = self._check_arrival(call)
            if isinstance(found, Impossibility):
                return found
            timed.append(found)
            if call.start >= self.scenario.horizon and self.reach.arrive(call.body, call.place)[0] > 0.0:
                stopped = self._check_stop(call)
                if stopped is not None:
                    return stopped
        for name in self.scenario.bodies:
            own = [call for call in timed if call.body == name]
            stays = [stay for stay in self.stays if self._is_place(stay.predicate, name)]
            why = check_orders(own, stays, self._cut, self.reach.speed(name), self.reach.forgiven)
            why = why or self._check_recurrences(name)
            if why is not None:
                return why
        return self._check_impacts(timed)

    def _check_recurrences(self, name: str) -> Impossibility | None:
        box = self.unasked.space(name).box
        places = [
            (one, self._cut(box, [one.predicate])) for one in self.recurrences if self._is_place(one.predicate, name)
        ]
        period = self.scenario.control_period
        return check_recurrences(name, places, self.reach.speed(name), period, self.reach.forgiven)

    # Places

    def _list_calls(self) -> Iterator[Call]:
        """Yield which body has to be where, when; what holds at the same instant counts together."""
        at: dict[tuple[str, object], list[Visit]] = {}
        for visit in self.visits:
            need = self.demands.predicates[visit.predicate]
            if self._is_place(visit.predicate, need.body):
                key = visit.moment.start if visit.moment.is_fixed else visit.moment
                at.setdefault((need.body, key), []).append(visit)
        for (body, _), visits in at.items():
            moment, box = visits[0].moment, self.reach.space(body).box
            predicates = list(dict.fromkeys(visit.predicate for visit in visits))
            said = " and ".join(say_place(predicate) for predicate in predicates)
            place = self._cut(box, predicates)
            yield Call(body, said, place, moment.start, moment.end, moment)
        for name, robot in self.scenario.robots.items():
            if robot.goal is not None:
                end = self.scenario.horizon
                yield Call(name, "at its goal", np.array([robot.goal]), end, end, Moment(end, end))

    def _is_place(self, predicate: Predicate, name: str) -> bool:
        """Return whether a predicate says that one body is in a convex place."""
        need = self.demands.predicates[predicate]
        return need.kind == "stay" and need.bodies == (name,)

    def _cut(self, place: np.ndarray, predicates: Sequence[Predicate]) -> np.ndarray:
        """Return the part of a place in which predicates about one body hold with some robustness, as plans have."""
        for predicate in predicates:
            need = self.demands.predicates[predicate]
            place = clip(place, need.faces, need.bounds - self.reach.forgiven)
        return place

    def _list_holding(self, call: Call) -> Iterator[tuple[Predicate, str]]:
        """Yield the predicates about the body of a call that hold at its moment, with when they do."""
        for visit in self.visits:
            same = visit.moment is call.moment or (
                visit.moment.is_fixed and visit.moment.start == call.start == call.end
            )
            if same and visit.predicate.bodies() == (call.body,):
                yield visit.predicate, "at the same time"
        for stay in self.stays:
            if stay.predicate.bodies() == (call.body,) and stay.start <= call.start and call.end <= stay.end:
                yield stay.predicate, f"from {stay.start:.4g} to {stay.end:.4g} s"

    def _check_place(self, call: Call) -> Impossibility | None:
        """Return why a body cannot be in a place at all, or not at its moment."""
        body = self.scenario.body(call.body)
        own = [one for one, _ in self._list_holding(call) if self.demands.predicates[one].kind == "stay"]
        inset = find_inner_radius(body) + self.reach.kept.wall
        for predicate in own:
            if not len(self._cut(self.unasked.space(call.body).box, [predicate])):
                world = make_box(np.array(self.scenario.world.lower), np.array(self.scenario.world.upper))
                outside = "that place lies outside of the world"
                if len(self._cut(world, [predicate])):
                    outside = (
                        f"its centre stays {inset:.3g} m inside of the world's edge, and that place is nearer to it"
                    )
                return Impossibility(f"{call.body} has to be {say_place(predicate)} {call.when}, but {outside}", MOVE)
        place = call.place
        for predicate, when in self._list_holding(call):
            if self.demands.predicates[predicate].kind == "stay":
                place = self._cut(place, [predicate])
                if not len(place):
                    return self._tell_pair(call, own, predicate, when)
        for predicate, when in self._list_holding(call):
            if isinstance(predicate, In) and predicate.negated:
                faces, bounds = self.scenario.areas[predicate.area].halfspaces()
                if (place @ faces.T - bounds < -0.5 * self.reach.forgiven).all():
                    never = f"{call.body} has to be {call.said} {call.when}, but {say_place(predicate)} {when}"
                    return Impossibility(f"{never}: {predicate.area} covers that place", MOVE)
        for area, obstacle in self.scenario.obstacles.items():
            if obstacle.solid:
                faces, bounds = list_faces(grow(np.array(obstacle.corners), inset))
                if (place @ faces.T - bounds < -self.reach.forgiven).all() and call.end > 0.0:
                    centre = f"its centre stays {inset:.3g} m away"
                    blocked = f"that place lies in the solid obstacle {area}, or too near to it: {centre}"
                    return Impossibility(f"{call.body} has to be {call.said} {call.when}, but {blocked}", MOVE)
        return None

    def _tell_pair(self, call: Call, own: Sequence[Predicate], last: Predicate, when: str) -> Impossibility:
        """Return which two demands on one place exclude each other, or the last one of several."""
        box = self.unasked.space(call.body).box
        others = [one for one in dict.fromkeys(own) if one != last]
        pairs = [one for one in others if not len(self._cut(box, [one, last]))] or others
        first = " and ".join(say_place(one) for one in pairs[:2]) or call.said
        told = f"{call.body} has to be {first} {call.when} and {say_place(last)} {when}: no place is both"
        return Impossibility(told, "change one of the two")

    def _check_starts(self) -> Impossibility | None:
        """Return which area a body starts in that it has to avoid from the start on."""
        for visit in self.visits:
            predicate = visit.predicate
            if isinstance(predicate, In) and predicate.negated and visit.moment.end <= 0.0:
                faces, bounds = self.scenario.areas[predicate.area].halfspaces()
                deep = -float((faces @ np.array(self.scenario.body(predicate.body).start) - bounds).max())
                if deep > self.reach.forgiven:
                    told = (
                        f"{predicate.body} starts {deep:.3g} m inside of {predicate.area}, and has to be outside at 0 s"
                    )
                    return Impossibility(told, MOVE)
        return None

    # Times

    def _check_arrival(self, call: Call) -> Impossibility | Call:
        """Return the call with the time from which its body can be there, or why it cannot be there in time."""
        way, time = self.reach.arrive(call.body, call.place)
        if not math.isfinite(way):
            return self._tell_closed(call)
        if not math.isfinite(time):
            return self._tell_unmoved(call)
        if time > call.end * (1.0 + 1e-9) + 1e-9:
            return self._tell_late(call, way, time)
        return replace(call, start=max(call.start, time))

    def _tell_closed(self, call: Call) -> Impossibility:
        told = f"there is no way for {call.body} from its start to be {call.said}"
        return Impossibility(f"{told}: it is closed by {self._say_closed(call.body, call.place)}", "open a way")

    def _say_closed(self, name: str, place: np.ndarray) -> str:
        """Return what closes all ways of a body into a place, unless nobody reads it."""
        if self.brief:
            return ""
        names, gap = self.reach.find_closing(name, place)
        size = 2.0 * (find_inner_radius(self.scenario.body(name)) + self.reach.kept.wall)
        by = " and ".join(names) if names else "obstacles and areas that it avoids at all times"
        through = f"the widest gap is {gap:.3g} m, it needs {size:.3g} m" if gap else f"it needs {size:.3g} m"
        return f"{by}, {through}"

    def _tell_unmoved(self, call: Call) -> Impossibility:
        told = f"{call.body} has to be {call.said} {call.when}, but no robot can reach {call.body} to hit it"
        if len(self.scenario.objects) > 1:
            told += " (no other object is thrown at it by a plan)"
        touched = {name: self.reach.find_touch(name, call.body) for name in self.scenario.robots}
        ways = [
            f"the way of {name} is closed by {self._say_closed(name, place)}"
            if len(place)
            else f"{name} may not be near enough"
            for name, place in touched.items()
        ]
        return Impossibility(
            ": ".join((told, " and ".join(ways[:2]))), "open a way from a robot to it, or move a robot"
        )

    def _check_stop(self, call: Call) -> Impossibility | None:
        """Return why no robot can stop an object where it has to rest in the end."""
        body = self.scenario.body(call.body)
        if not isinstance(body, Object) or not body.rest or any(body.start_velocity):
            return None  # what moves slowly may rest unhit
        touched = {name: self.reach.find_touch(name, call.body, call.place) for name in self.scenario.robots}
        if any(math.isfinite(self.reach.space(name).measure(place)) for name, place in touched.items() if len(place)):
            return None
        told = f"{call.body} has to rest {call.said} {call.when}, but no robot can come up to it there to stop it"
        if len(self.scenario.objects) > 1:
            told += " (no other object is thrown at it by a plan)"
        return Impossibility(told, "open a way from a robot to that place, or move a robot")

    def _tell_late(self, call: Call, way: float, time: float) -> Impossibility:
        body, speed, wait = call.body, self.reach.speed(call.body), self.reach.wait(call.body)
        where = call.said.removeprefix("in ") if call.said.startswith("in ") and " and " not in call.said else call.said
        where = where if where != call.said or call.said.startswith("at ") else f"being {call.said}"
        if call.end <= 0.0:
            return Impossibility(f"{body} has to be {call.said} at 0 s, but starts {way:.3g} m from it", MOVE)
        straight = float(np.abs(self._find_offset(call)).max())
        along = f" along {'xy'[int(np.abs(self._find_offset(call)).argmax())]}"
        round_it = way > straight + 2.0 * self.reach.forgiven
        told = f"{body} is {way:.3g} m from {where}{' on the shortest way round obstacles' if round_it else along}"
        told += f" and has to be there {'at' if call.start == call.end else 'by'} {call.end:.4g} s"
        remedy = f"allow it until {time:.4g} s at least, move them nearer, or raise speed limits"
        if wait >= call.end:
            return Impossibility(f"{told}, but no robot can hit it before {wait:.3g} s", remedy)
        if wait > 0.0:
            told += f", and no robot can hit it before {wait:.3g} s"
        limit = ""
        if speed < self.scenario.body(body).speed_limit:
            remedy += ", or allow more impacts (--max-impacts)"
            limit = f", all that {count_things(self.max_impacts, 'impact')} of the robots can give it,"
        return Impossibility(f"{told}: at most {speed:.3g} m/s{limit} reach {speed * (call.end - wait):.3g} m", remedy)

    def _find_offset(self, call: Call) -> np.ndarray:
        start = np.array(self.scenario.body(call.body).start)
        return find_nearest(start, call.place) - start

    def _check_impacts(self, calls: Sequence[Call]) -> Impossibility | None:
        """Return which objects need more impacts than are allowed: one to leave the start, one to rest again."""
        needed: dict[str, int] = {}
        for name, body in self.scenario.objects.items():
            moved = any(call.body == name and self.reach.arrive(name, call.place)[0] > 0.0 for call in calls)
            if moved and not any(body.start_velocity):
                needed[name] = 2 if body.rest else 1
            elif body.must_stop:
                needed[name] = 1
        total = sum(needed.values())
        if total <= self.max_impacts:
            return None
        each = ", ".join(f"{name} needs {count}" for name, count in needed.items())
        impacts = "1 impact is" if self.max_impacts == 1 else f"{self.max_impacts or 'no'} impacts are"
        told = f"{each}, to leave its start and to rest again, but {impacts} allowed"
        return Impossibility(told, f"allow {total} impacts or more (--max-impacts {total})")
