"""What the planner of most robustness is asked for, and how far it goes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Work
from planners.free_flyer.frame import Frame
from planners.free_flyer.nominal.event_grid import EventGrid, build_event_grid
from planners.free_flyer.nominal.event_sequence import Word
from planners.free_flyer.nominal.leg_times import Correction
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.direction import DIRECTIONS
from planners.free_flyer.specification.formula_rows import add_demands
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import Demands
from planners.free_flyer.specification.selection import Choices
from planners.spline_rows import SmoothingOptions


@dataclass(frozen=True)
class NominalTask:
    """Hold what is asked of a plan.

    Args:
        scenario: bodies, limits and world.
        demands: of its formula and of solid obstacles.
        reserves: what the plan keeps in hand.
        solver: of mixed-integer models.
        work: that is counted and limited, if any is.
        frame: whose units the scenario is in.
        corrections: least times between events, and room for impacts, beyond those of the reserves.
        sharp: whether speeds of several objects are capped by what a word says of their first and last impacts.
        slanted: whether bodies may pass each other at a slant, too, and pieces of a leg on which the only object rests
            differ in length; both let robots be quicker, and take more binaries.
        easy_nodes: of branch and bound, in proofs that leave out what is in the way.
        proof_nodes: of branch and bound, in proofs for the least of all reserves.
        alone_nodes: the same in proofs for one of several objects with nothing in the way of robots: they are small.
    """

    scenario: FreeFlyerScenario
    demands: Demands
    reserves: Reserves
    solver: str = "highs"
    work: Work | None = None
    frame: Frame = field(default_factory=Frame)
    corrections: tuple[Correction, ...] = ()
    sharp: bool = False
    slanted: bool = False
    easy_nodes: int = 200
    proof_nodes: int = 5000
    alone_nodes: int = 50_000

    def build(
        self,
        size: GridSize,
        rho: tuple[float, float],
        word: Word | None = None,
        avoid: float = 0.0,
        elastic: bool = False,
        loose_speeds: bool = True,
    ) -> tuple[EventGrid, Choices]:
        """Build the model of all plans of a size, formula included.

        Args:
            size: of the grid.
            rho: least and greatest robustness allowed [m].
            word: who hits what at each impact; None: anybody anything.
            avoid: distance to keep from areas to avoid, in addition to the robustness [m].
            elastic: whether speeds and conjuncts of the formula may be exceeded at a price.
            loose_speeds: whether that holds for speeds, too.

        Returns:
            The grid, and what reads from its solutions how the formula holds in them.

        Raises:
            Infeasible: the variable bounds alone exclude every plan.
        """
        shape = size.impacts, rho, self.reserves, size.pieces, word, elastic, self.sharp, loose_speeds, self.slanted
        grid = build_event_grid(self.scenario, *shape)
        if self.slanted:
            grid = replace(grid, axes=DIRECTIONS)
        for correction in self.corrections:
            correction.add_to(grid)
        return grid, add_demands(grid, self.demands, self.scenario.control_period, size.passing, avoid)


class Wish(NamedTuple):
    """Say what a plan should do for its execution, where the robustness leaves room for it.

    Attributes:
        at_events: reach areas at events, where the execution aims, not between them.
        far: keep `Reserves.avoid` from areas to avoid.
    """

    at_events: bool
    far: bool


@dataclass(frozen=True)
class CostOptions:
    """Choose how closely the least path cost is approached.

    Args:
        gap: to which the least cost is proven, relative.
        tangents: number of tangent planes per piece, axis and sign at first; solutions add more.
        rounds: greatest number of outer approximations.
        straightening_gap: relative gap of the solution that flights of several objects are straightened by.
        weights: of objects' costs while their flights are still bent; the first one that lets them straighten counts.
        wishes: in the order in which they are given up.
        together: whether one solution may take all of the time for it; otherwise it leaves half to the next wish.
    """

    gap: float = 0.01
    tangents: int = 12
    rounds: int = 4
    straightening_gap: float = 0.05
    weights: tuple[float, ...] = (1.0, 3.0, 10.0)
    wishes: tuple[Wish, ...] = (Wish(True, True), Wish(True, False), Wish(False, True), Wish(False, False))
    together: bool = False


@dataclass(frozen=True)
class WordSearchOptions:
    """Choose how long sequences of impacts are compared.

    Args:
        gap: relative difference of costs below which sequences count as equally good.
        tangents: number of tangent planes per piece, axis and sign while sequences are compared.
        weight: of objects' costs while their flights are still bent.
        nodes: of the search over all sequences that bounds the cost, where there are few binaries of hits.
        few: greatest number of such binaries; with more, the linear relaxation alone is the bound.
        rows: greatest number of rows of that model; with more, each node takes so long that the words go short of time.
        proof: time for that search, whatever it takes, once there are words with plans; 0: it is not made [s].
        evaluations: greatest number of sequences tried.
        lost: greatest number of sequences tried while none has a plan, before objects are moved one after another.
        word_nodes: of branch and bound in each solution for one sequence, where objects can be moved one after another
            instead.
        word_pauses: of the solver in each of them where objects are moved in a simple way alone, for heuristics take
            long and count no nodes; the shipped scenarios need 30 at most. Where they do not suffice, it ends.
        nearly: share of the robustness that an object attains alone from which on fewer impacts or pieces do, for the
            models of all objects grow with both.
        settled: number of orders of impacts of which any point is sought, whoever hits, where no cheap one was found.
        settled_nodes: of branch and bound in each solution for these; few prove that there is none, and hundreds find
            who hits and on which side bodies pass.
        settling_time: share of the time left that all of these take.
        work: that the search may take then; the shipped scenarios take a quarter to a half of it [units of `Work`].
        improve: whether to look on after the first sequence that has a plan, and to bound the cost.
        longest: time for one sequence of more impacts than the objects need one by one [s].
        most_longer: greatest number of impacts more than that.
        few_longer: number of such sequences with plans after which no other one is tried.
        shallow_shares: shares of the robustness that the objects attain one by one, tried in turn where they do not
            attain it together.
        longer_shares: shares of the robustness that the objects attain one by one, tried in turn for such sequences.
    """

    gap: float = 0.01
    tangents: int = 5
    weight: float = 3.0
    nodes: int = 300
    few: int = 24
    rows: int = 2000
    proof: float = 0.0
    evaluations: int = 60
    lost: int = 2
    word_nodes: int = 500
    word_pauses: int = 40
    nearly: float = 0.9
    settled: int = 10
    settled_nodes: int = 1000
    settling_time: float = 0.8
    work: float = 5e4
    improve: bool = True
    longest: float = 6.0
    most_longer: int = 2
    few_longer: int = 2
    shallow_shares: tuple[float, ...] = (0.6, 0.25)
    longer_shares: tuple[float, ...] = (1.0, 0.6)


@dataclass(frozen=True)
class CompositionOptions:
    """Choose how objects that are moved one after another are planned.

    Args:
        shares: of the least robustness that objects attain alone, tried in turn.
        more_impacts: than an object needs alone, at most.
        gap: to which an object is done as early as may be, relative; that it is done counts more than when.
        nodes: of branch and bound for the impacts of one object.
        brief_nodes: the same in brief attempts.
        longest: wall time for them, so that a busy machine leaves time for the next order [s].
        binaries: of the model of one sequence, above which this comes before the search over sequences; the shipped
            scenarios have fewer.
        time: share of the time left that all orders and shares take.
    """

    shares: tuple[float, ...] = (1.0, 0.3)
    more_impacts: int = 1
    gap: float = 0.1
    nodes: int = 500
    brief_nodes: int = 60
    longest: float = 20.0
    binaries: int = 250
    time: float = 0.5


@dataclass(frozen=True)
class PlanOptions:
    """Choose how far a plan is improved, and what of it is proven.

    Args:
        least: robustness below which a task counts as having no plan [m].
        enough: share of the bound of the robustness above which no other number of impacts is tried; half of it once
            a plan has failed, if not thorough.
        enough_alone: the same for every one of several objects alone; with less than all reserves `enough_less`, for
            sequences of all objects grow with each of their impacts.
        enough_less: see there.
        deep: share of the bound of the robustness below which half the margin of speed is tried, too: a plan that is
            hardly inside its areas fails by small errors of direction, one with fast legs can still wait a little. With
            several objects the searches that take longer are made then, too.
        deeper: factor by which the robustness has to grow for that.
        robustness_gap: to which the greatest robustness is proven, relative.
        pieces: numbers of pieces per leg in the order in which they are tried; two let robots turn corners.
        most_pieces: greatest number of pieces per leg, where there is no plan with those.
        attempt_share: share of the time left that one attempt to find impacts may take, with one object; or motions for
            objects that are moved one after another.
        joint_share: the same with several objects.
        simple_share: the same for attempts in which they are only moved as each would be alone, or one after another.
        kept: share of all time that these leave to those that take longer.
        patience: factors of the least times of hasty legs, tried in turn when motions prove too quick to be smoothed.
        less: shares of the robustness that are kept then, in turn.
        satisfying: share of the robustness of the impacts from which on a plan with less is good enough, and reserves
            are not halved.
        joint: share of their robustness that several objects keep when their flights are straightened.
        thrust: share of the thrust that smooth motions may use; None: that of the reserves.
        few: impacts of every one of several objects that are tried first, with each of the reserves; None: all are.
        simple: whether several objects are only moved as each would be alone, or one after another; None: that and
            all that takes longer; False: what takes longer alone.
        near_words: whether sequences near those of the objects alone are compared; where brief attempts have done so,
            they are not compared again.
        pauses: of the solver in each solution for one number of impacts and pieces, above which the number is passed
            over, or its best point is taken; None: any number. It is the limit of the attempt that is made.
        brief_pauses: this limit in brief attempts, which are made with all, half and a quarter of the reserves before
            longer ones; the shipped scenarios need fewer, and so many take some seconds.
        brief_patience: factors as `patience`, in brief attempts.
        brief_less: shares as `less`, in brief attempts.
        improve_share: share of all time for more robust impacts, once a brief attempt has a plan.
        slanted_pieces: numbers of pieces per leg of the last brief attempts, in which bodies may pass each other at a
            slant: a robot that overtakes what it has just hit then goes a third as far round it.
        guided_pieces: numbers of pieces per leg where an object is hit near the turns of its shortest way.
        most_merges: greatest number of choices of near turns that are one hit.
        many_turns: from so many turns on, that comes first.
        expected: number of impacts to try first, then one more, then fewer, and none with more; None: count up from the
            fewest.
        screen: whether it is told first, with each of the reserves, where there is no plan, see `screen_task`.
        many_impacts: from which on it is looked first whether there are as many without anything in the way, see
            `exclude_size`; the shipped scenarios have fewer.
        halvings: how often the reserves are halved for a task that leaves no room for them.
        proof_share: share of the time left that it may take to prove, with the least of all reserves at once, that a
            number of pieces per leg has no plan; where it has one, the first point found ends it.
        brisk: factor of the time in which robots reach the speed of a leg, where their thrust limits this speed and the
            event grid has no plan.
        turns: factors of the time for starting and stopping, tried when motions prove too quick to be smoothed.
        words: number of sequences of impacts tried at each of these.
        haste: time for a plan with the impacts found so far, once planning is interrupted [s].
        hasty: number of the last attempts whose impacts are tried then.
        diagnosis: greatest time for finding what to loosen where there is no plan; 0: it is not said [s].
        remedy_room: by which a conjunct that is to be loosened is loosened more when that is tried [m].
        thorough: whether what to loosen is said, and robustness is improved for longer than there is a plan.
        reasons: whether a task is refused where places, times and speeds alone tell that it has no plan.
        central: least robustness of a plan that hits polygons through their centres, else they are planned as discs;
            the expert hits once more where less is left. None: always as discs [m].
        cost: of the stage of least path cost.
        search: of the sequences of impacts of several objects.
        compose: of objects one after another, where that search finds nothing.
        smoothing: of the motions.
    """

    least: float = 1e-3
    enough: float = 1.0
    enough_alone: float = 1.0
    enough_less: float = 0.3
    deep: float = 0.6
    deeper: float = 1.5
    robustness_gap: float = 1e-6
    pieces: tuple[int, ...] = (1, 2)
    most_pieces: int = 6
    attempt_share: float = 0.35
    joint_share: float = 0.45
    simple_share: float = 0.5
    kept: float = 0.2
    patience: tuple[float, ...] = (1.05, 1.2, 1.5, 2.0)
    less: tuple[float, ...] = (1.0, 0.85, 0.7, 0.5, 0.3)
    satisfying: float = 0.9
    joint: float = 1.0
    thrust: float | None = None
    few: int | None = 3
    simple: bool | None = None
    near_words: bool = True
    pauses: int | None = None
    brief_pauses: int = 4000
    brief_patience: tuple[float, ...] = (1.05, 1.5)
    brief_less: tuple[float, ...] = (1.0, 0.92, 0.5)
    improve_share: float = 0.15
    slanted_pieces: tuple[int, ...] = (2, 3)
    guided_pieces: tuple[int, ...] = (1, 2, 3)
    most_merges: int = 24
    many_turns: int = 3
    expected: int | None = None
    screen: bool = False
    many_impacts: int = 3
    halvings: int = 2
    proof_share: float = 0.3
    brisk: float = 2.0
    turns: tuple[float, ...] = (1.0, 1.5)
    words: int = 3
    haste: float = 5.0
    hasty: int = 3
    diagnosis: float = 20.0
    remedy_room: float = 0.02
    thorough: bool = True
    reasons: bool = True
    central: float | None = 0.02
    cost: CostOptions = field(default_factory=CostOptions)
    search: WordSearchOptions = field(default_factory=WordSearchOptions)
    compose: CompositionOptions = field(default_factory=CompositionOptions)
    smoothing: SmoothingOptions = field(default_factory=lambda: SmoothingOptions(segments=(3.0, 1.5)))

    def order_numbers(self, fewest: int, most: int) -> list[int]:
        """Return the numbers of impacts in the order in which they are tried."""
        every = range(fewest, most + 1)
        if self.expected is None:
            return list(every)
        last = self.expected + 1
        return sorted((k for k in every if k <= last), key=lambda k: (k < last - 1, abs(k - last + 1)))
