"""Options of the dual-arm expert: every number that somebody chose, and the variants that it is compared with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

from planners.options import Limits, Positive, replace_options, select_options

Heights = Annotated[int, Limits(2, 50)]
Height = Annotated[float, Limits(1e-3, 1.0)]
Width = Annotated[float, Limits(0.1, 1e3)]
Dwell = Annotated[float, Limits(1e-3)]  # a control period, at least


@dataclass(frozen=True)
class ControllerOptions:
    """Parameters of the controller; the paper publishes none, these are tuned on the nominal scenario.

    The three switches turn off one part each, for comparison. `soft_start`, `press`, `fade` and `grip` are no parts of
    the paper's controller, and `PAPER` turns them off.

    Attributes:
        impact_map: start the reference after the impact at the predicted velocity of the box.
        interim_phase: between first and full contact, control without velocity feedback.
        synchronisation: keep the pads mirror images of each other before the impact.
        impact_velocity: of the first pad in the box frame at the impact, mirrored for the second, shape (2,) [m/s].
        alpha: how fast a pad turns onto the line through its impact point [1/s].
        r_min, r_max: the pads' velocity is constant nearer to the box than r_min, and blends up to r_max [m].
        kappa_theta: how fast a pad turns to its heading at the impact [1/s].
        k_p, k_theta: velocity gains before the impact [1/s].
        sync_p, sync_d: gains of the synchronisation [1/s^2], [1/s].
        w_p, w_theta, w_sync: weights of position, angle and synchronisation before the impact, relative to each other.
        k_int, k_theta_int: position gains in the interim phase, weak: the box may be beside its believed place [1/s^2].
        w_p_int, w_theta_int: weights in the interim phase.
        kappa_post, kappa_theta_post: how fast the box moves and turns to its target [1/s].
        r_max_post: distance from the impact over which the reference leaves the predicted velocity [m].
        k_p_post, k_theta_post: velocity gains after the impact [1/s].
        w_p_post, w_theta_post: weights of the motion of the box after the impact.
        w_share, w_normal: weights on the difference of the forces at a pad's corners and on their distance from `grip`;
            small, to choose only among forces that move the box alike [1/N^2].
        w_slack: weight on the acceleration between pads and box, where no torques avoid it.
        contact_force: that every corner must exceed for full contact [N].
        dwell: how long it must do so, so that a bounce is not taken for a grasp [s].
        press, press_rise: acceleration of both pads towards the box in the interim phase, and the time over which it
            rises. Without it, pads that bounce off a turned box come back by the weak position feedback alone, which
            can take hundreds of milliseconds [m/s^2], [s].
        soft_start: time over which the feedback gains rise from rest; without it, torques begin at their limits [s].
        fade: time constant with which the step of the torques at full contact fades [s].
        grip: desired normal force at every corner after the impact. Without it the forces are the least ones in the
            believed friction cone, under which a held weight creeps [N].
        time_out: longest interim phase [s].
    """

    impact_map: bool = True
    interim_phase: bool = True
    synchronisation: bool = True
    impact_velocity: tuple[float, float] = (0.5, 0.25)
    alpha: float = 20.0
    r_min: float = 0.19
    r_max: float = 0.30
    kappa_theta: float = 8.0
    k_p: float = 120.0
    k_theta: float = 60.0
    sync_p: float = 225.0
    sync_d: float = 30.0
    w_p: float = 1.0
    w_theta: float = 0.1
    w_sync: float = 10.0
    k_int: float = 200.0
    k_theta_int: float = 100.0
    w_p_int: float = 1.0
    w_theta_int: float = 0.1
    kappa_post: float = 4.0
    kappa_theta_post: float = 4.0
    r_max_post: float = 0.25
    k_p_post: float = 60.0
    k_theta_post: float = 60.0
    w_p_post: float = 1.0
    w_theta_post: float = 0.1
    w_share: float = 1e-4
    w_normal: float = 1e-4
    w_slack: float = 1.0
    contact_force: float = 1.0
    dwell: Dwell = 0.015
    press: float = 10.0
    press_rise: float = 0.02
    soft_start: float = 0.3
    fade: float = 0.005
    grip: float = 25.0
    time_out: float = math.inf


class PredictionOptions(NamedTuple):
    """Simulated impacts that predict the velocity of the box.

    Attributes:
        greatest_height: of a pad's centre from the middle of its face; greater ones are clipped to it [m].
        heights: number for each pad, evenly spaced; every pair of them is simulated.
        rho: one over the width of a basis function, which spans several heights [1/m].
        duration: of a simulated impact; contact becomes full within it [s].
    """

    greatest_height: Height = 0.05
    heights: Heights = 5
    rho: Width = 15.0
    duration: Positive = 0.05


class CorrectionOptions(NamedTuple):
    """When a learner may correct the grasp, and how much.

    Attributes:
        first: time from full contact to the first correction; by then the motion shows how heavy the box is [s].
        period: between corrections [s].
        log_range: logarithm of the factor on grip and believed load at correction 1; 0.7 doubles.
        rate: greatest rate of a correction, so that torques make no step [1/s].
        lag_time: time constant of the smoothed lag of the box among the features [s].
    """

    first: float = 0.02
    period: Positive = 0.25
    log_range: float = 0.7
    rate: float = 50.0
    lag_time: Positive = 0.05


class ReadingOptions(NamedTuple):
    """Which readings are believed, see `readings`.

    Attributes:
        angle, rate: margins of a joint's angle and rate [rad], [rad/s].
        force: greatest normal force at a pad's corner; four times what the formula allows [N].
        near: from a pad to the believed box, within which they may touch; the box is not measured [m].
        patience: after which readings that no motion explains, but that agree with each other, are taken up; longer
            than a sensor is usually wrong, short beside the time to the impact [s].
    """

    angle: float = 0.05
    rate: float = 0.5
    force: float = 1e3
    near: float = 0.1
    patience: float = 0.05


class Options(NamedTuple):
    """All options of the expert.

    Attributes:
        solver: of the quadratic programs, see `dense_qp.SOLVERS`.
        controller, prediction, correction, readings: of its parts.
    """

    solver: str = "goldfarb_idnani"
    controller: ControllerOptions = ControllerOptions()
    prediction: PredictionOptions = PredictionOptions()
    correction: CorrectionOptions = CorrectionOptions()
    readings: ReadingOptions = ReadingOptions()


EXPERT = Options()
# The paper's controller, with a reference that turns to the impact later and with looser synchronisation: from far
# starts the pads meet the box beside the middle of its faces, and at different times.
PAPER = Options(
    controller=ControllerOptions(
        alpha=10.0,
        r_min=0.24,
        r_max=0.40,
        kappa_theta=4.0,
        sync_p=100.0,
        sync_d=20.0,
        press=0.0,
        soft_start=0.0,
        fade=0.0,
        grip=0.0,
    )
)
VARIANTS = {
    "published": PAPER,
    "no_impact_map": replace_options(PAPER, {"controller.impact_map": False}),
    "no_interim_phase": replace_options(PAPER, {"controller.interim_phase": False}),
    "no_synchronisation": replace_options(PAPER, {"controller.synchronisation": False}),
}


def get_options(variant: str | None) -> Options:
    """Return the options of a variant, by default those of the expert itself.

    Raises:
        InputError: unknown variant.
    """
    return select_options(variant, VARIANTS, EXPERT)
