"""One attempt at a plan: how much it keeps in hand, and how many pieces and impacts it may have."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planners.free_flyer.nominal.task import NominalTask, PlanOptions


@dataclass(frozen=True)
class Attempt:
    """Describe an attempt.

    Args:
        pieces: numbers of pieces per leg.
        halvings: how often the reserves are halved.
        few: whether only few impacts of each object are tried.
        simple: whether several objects are only moved as each would be alone, or one after another; None: that and
            all that takes longer; False: what takes longer alone.
        slanted: whether bodies may pass each other at a slant, too, see `NominalTask`.
        brief: whether every solution for one object, or for the next one of several, is limited, and few remedies are
            tried for hasty motions.
        guided: whether the only object is hit near the turns of its shortest way.
        brisk: whether robots may take longer to reach the speed of a leg, so that legs are faster.
    """

    pieces: tuple[int, ...]
    halvings: int = 0
    few: bool = False
    brisk: bool = False
    simple: bool | None = None
    slanted: bool = False
    brief: bool = False
    guided: bool = False

    def choose_options(self, options: PlanOptions) -> PlanOptions:
        """Return the options of this attempt.

        Args:
            options: of the whole task.
        """
        enough = options.enough * (1.0 if options.thorough else 0.5**self.halvings)
        few = options.few if self.few else None
        own = replace(options, pieces=self.pieces, enough=enough, few=few, simple=self.simple)
        if options.thorough and (self.brisk or self.halvings):
            own = replace(own, enough_alone=options.enough_less)
        if self.brief:
            limits = options.brief_patience, options.brief_less
            own = replace(own, pauses=options.brief_pauses, patience=limits[0], less=limits[1])
        if self.brief and self.simple:
            compose = replace(options.compose, nodes=options.compose.brief_nodes, shares=options.compose.shares[:1])
            own = replace(own, pauses=options.pauses, compose=compose, search=replace(options.search, settled=0))
        elif self.few and self.simple and not self.brisk:
            own = replace(own, near_words=False)
        return own

    def cut_reserves(self, task: NominalTask, options: PlanOptions) -> NominalTask:
        """Return the task with the reserves of this attempt.

        Args:
            task: with all reserves.
            options: how much longer brisk robots take.
        """
        task = replace(task, slanted=self.slanted)
        for _ in range(self.halvings):
            task = replace(task, reserves=replace(task.reserves.halved(), underway=1.0))
        if self.brisk:
            task = replace(task, reserves=replace(task.reserves, turn=options.brisk * task.reserves.turn))
        return task

    def rank(self) -> tuple[int, bool, bool]:
        """Return how little of the reserves is left, and then whether robots are slow and bodies pass along axes."""
        return self.halvings, self.brisk, not self.slanted

    def cut_to_least(self, task: NominalTask, options: PlanOptions) -> NominalTask:
        """Return the task with reserves of which those of every attempt with so many pieces ask at least as much.

        Robots are as fast as brisk ones, and lose no more time by starting and stopping than others.

        Args:
            task: with all reserves; its bodies start at rest.
            options: how far reserves are cut.
        """
        least = replace(self, halvings=options.halvings, brisk=True).cut_reserves(task, options)
        return replace(least, reserves=replace(least.reserves, slack=least.reserves.slack / options.brisk))

    def is_slow(self, task: NominalTask) -> bool:
        """Return whether thrust limits the legs of some robot, rather than its speed limit."""
        reserves = task.reserves
        for _ in range(self.halvings):
            reserves = reserves.halved()
        robots = task.scenario.robots.values()
        return any(reserves.cruise(robot) < reserves.speed * robot.speed_limit for robot in robots)

    def may_improve(self, several: bool, shallow: bool) -> bool:
        """Return whether it is worth the time where there is a plan of less robustness than impacts have.

        Args:
            several: whether there are several objects.
            shallow: whether the plan has so little of the bound that what takes longer may well find more.
        """
        worthy = self.simple is not False or shallow
        return not self.brisk and len(self.pieces) > 1 and self.few == several and worthy
