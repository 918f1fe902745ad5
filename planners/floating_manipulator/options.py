"""Options of the floating manipulator's expert: every number that somebody chose, and the variants to compare with."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from impact_envs.errors import InputError, choices
from planners.options import Count, CountOrNone, Positive, replace_options, select_options

# Forms of the state-dependent coefficients, in compiled code by their numbers.
COEFFICIENTS = ("absolute_output", "printed")
PRINTED = COEFFICIENTS.index("printed")


class RegulatorOptions(NamedTuple):
    """The OSDRE before the first impact and after the safety pause.

    Attributes:
        coefficients: form of the state-dependent coefficients. "absolute_output" reproduces the paper's numbers; its A
            depends on where the world's origin is. "printed" is the paper's formula.
        state_weights: diagonal of Q, for the tip's position (2) and velocity (2); Nekoo et al., Sec. 4.1.
        effort_before, effort_after: r in R = r 1, before the first impact and after the pause; Nekoo et al., Sec. 4.1.
        measured_base: use the measured rates of the base instead of those that follow from its momenta.
    """

    coefficients: str = "absolute_output"
    state_weights: tuple[float, float, float, float] = (1.0, 1.0, 0.5, 0.5)
    effort_before: Positive = 1.0
    effort_after: Positive = 0.1
    measured_base: bool = False


class CompensationOptions(NamedTuple):
    """What is added to the OSDRE after the pause, see `compensation`.

    Attributes:
        joint_damping: of joint motion that does not move the tip; the best of 0.25 to 2 on tuning seeds [N m s/rad].
        damped_authority: below this singular value of B its generalised inverse is damped, because torques would grow
            without bound [1/kg/m].
        clearance: distance to keep between tip and box [m].
        approach_rate: how fast the tip may approach that distance [1/s].
    """

    joint_damping: float = 0.5
    damped_authority: float = 1e-2
    clearance: float = 0.02
    approach_rate: float = 2.0


class RecoveryOptions(NamedTuple):
    """The safety pause: PD control of base and joints, and pulses of the thrusters.

    Attributes:
        thruster_gain, wheel_gain, joint_gain: proportional gains [N/m], [N m/rad], [N m/rad]; Nekoo et al., Sec. 4.4.
        damping: derivative over proportional gains [s]; Nekoo et al., Sec. 4.4.
        momentum_time: time at the end of the pause, after the last pulse, over which measured momenta are averaged, so
            that one noisy measurement is not used to the end of the episode [s].
        pulse_samples: desired forces that are averaged to start a pulse; one noisy force starts none [control periods].
        pulse_rest: pause after a pulse, so that its effect is measured before the next; above `pulse_samples` by the
            delay of the measurements [control periods].
    """

    thruster_gain: Positive = 50.0
    wheel_gain: float = 200.0
    joint_gain: float = 150.0
    damping: Positive = 0.75
    momentum_time: float = 0.5
    pulse_samples: Count = 4
    pulse_rest: CountOrNone = 6


class CorrectionOptions(NamedTuple):
    """When a learner may correct the OSDRE, and how much.

    Attributes:
        period: between corrections [s].
        goal_distance: no correction when the tip is nearer to its goal: there the task is to hold it [m].
        torque_share: torque at correction 1, relative to the stall torque.
        log_range: logarithm of the factor on the weights at correction 1.
    """

    period: Positive = 3.0
    goal_distance: float = 0.1
    torque_share: float = 0.05
    log_range: float = 2.0


class ReadingOptions(NamedTuple):
    """Which readings are believed, see `readings`; the margins are twenty times the noise of the suites.

    Attributes:
        place, speed: margins of places and their rates, per length of the arm [-], [1/s].
        angle, rate: margins of angles and their rates [rad], [rad/s].
        patience: after which readings that no motion explains, but that agree with each other, are taken up; longer
            than a sensor is usually wrong, and as long as the model predicts well [s].
        clock_steps: control periods by which the clock may go forward from one reading to the next, at most.
    """

    place: float = 0.02
    speed: float = 0.05
    angle: float = 0.1
    rate: float = 0.3
    patience: float = 0.5
    clock_steps: float = 10.5


class Options(NamedTuple):
    """All options of the expert.

    Attributes:
        compensated: add the compensation where the base is actuated; otherwise the paper's law everywhere.
        regulator, compensation, recovery, correction, readings: of its parts.
    """

    compensated: bool = True
    regulator: RegulatorOptions = RegulatorOptions()
    compensation: CompensationOptions = CompensationOptions()
    recovery: RecoveryOptions = RecoveryOptions()
    correction: CorrectionOptions = CorrectionOptions()
    readings: ReadingOptions = ReadingOptions()


EXPERT = Options()
PAPER = EXPERT._replace(compensated=False)
VARIANTS = {
    "published": PAPER,
    "printed": replace_options(PAPER, {"regulator.coefficients": "printed"}),
    "measured_base": replace_options(PAPER, {"regulator.measured_base": True}),
}


def get_options(variant: str | None) -> Options:
    """Return the options of a variant, by default those of the expert itself.

    Raises:
        InputError: unknown variant.
    """
    return select_options(variant, VARIANTS, EXPERT)


@cache
def make_record(options: Options) -> np.ndarray:
    """Return options as compiled code takes them: one record with fields of the same names.

    The form of the coefficients is its number in `COEFFICIENTS`.

    Returns:
        Shape (1,); options.recovery.damping is record[0]["recovery"]["damping"].

    Raises:
        InputError: unknown form of the coefficients.
    """
    form = options.regulator.coefficients
    if form not in COEFFICIENTS:
        raise InputError(f"expert.regulator.coefficients '{form}' is unknown; {choices(form, COEFFICIENTS)}")
    number: Any = COEFFICIENTS.index(form)
    encoded = options._replace(regulator=options.regulator._replace(coefficients=number))
    record = np.zeros(1, _make_dtype(encoded))
    record[0] = encoded
    return record


def _make_dtype(options: Any) -> np.dtype:
    columns: list[Any] = [(name, *_describe(value)) for name, value in zip(options._fields, options, strict=True)]
    return np.dtype(columns, align=True)


def _describe(value: Any) -> tuple[Any, ...]:
    if hasattr(value, "_fields"):
        return (_make_dtype(value),)
    return (float, len(value)) if isinstance(value, tuple) else (type(value),)
