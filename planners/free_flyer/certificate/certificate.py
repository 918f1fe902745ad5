"""A certificate of a plan file: every check, with what was found and how much is left."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.certificate.check import Check, Tolerances
from planners.free_flyer.certificate.claim import Claim, check_claim, read_claim
from planners.free_flyer.certificate.clearance import check_clearance
from planners.free_flyer.certificate.impact import check_impacts
from planners.free_flyer.certificate.motion import check_motion
from planners.free_flyer.certificate.robustness import bound_robustness, compute_sampled_robustness, make_signals


@dataclass(frozen=True)
class Certificate:
    """What a check of a plan found.

    Attributes:
        checks: all of them.
        promised: robustness that the file tells [m].
        sampled: robustness at the control periods [m].
        continuous: proven bounds of the robustness over continuous time [m].
        deviation: that the plan says to bear after impacts, which is not certified; None: it says nothing [m/s].
    """

    checks: tuple[Check, ...]
    promised: float
    sampled: float
    continuous: tuple[Fraction, Fraction]
    deviation: float | None

    @property
    def confirmed(self) -> bool:
        """Return whether every check is."""
        return all(check.confirmed for check in self.checks)

    def to_dict(self) -> dict[str, Any]:
        """Return the certificate as it is printed."""
        low, high = map(float, self.continuous)
        return {
            "confirmed": self.confirmed,
            "refused": [check.name for check in self.checks if not check.confirmed],
            "promised_robustness": self.promised,
            "sampled_robustness": self.sampled,
            "continuous_robustness": [low, high],
            "deviation": self.deviation,
            "checks": [check.to_dict() for check in self.checks],
        }


def certify_plan(
    path: str | Path,
    scenario: FreeFlyerScenario,
    unchanged: FreeFlyerScenario | None = None,
    tolerances: Tolerances = Tolerances(),  # noqa: B008 - frozen
) -> Certificate:
    """Check a plan file against a scenario, as it is believed to be.

    Args:
        path: a JSON file that `impact plan --out` wrote.
        scenario: of discs, in its suite.
        unchanged: the same in no suite, to say which of its suites has the plan's horizon where it is another.
        tolerances: by how much the plan may be off.

    Returns:
        The certificate; read `confirmed`.

    Raises:
        InputError: no plan file, or one for other bodies or another horizon.
    """
    claim = read_claim(path)
    try:
        check_claim(claim, scenario, unchanged)
    except InputError as error:
        raise InputError(f"plan file {path}: {error}") from None
    signals = make_signals(claim, scenario)
    sampled = compute_sampled_robustness(signals, scenario)
    continuous = bound_robustness(signals, scenario, tolerances.effort)
    checks = [
        *check_motion(claim, scenario, tolerances),
        *check_impacts(claim, scenario, tolerances),
        *check_clearance(claim, scenario, tolerances),
        *_check_robustness(claim, Fraction(sampled), continuous[0], tolerances),
    ]
    return Certificate(tuple(checks), float(claim.promised), sampled, continuous, claim.deviation)


def _check_robustness(claim: Claim, sampled: Fraction, continuous: Fraction, tolerances: Tolerances) -> list[Check]:
    """Return the checks that samples keep the promise, and that the formula holds between them too."""
    return [
        Check("robustness at the samples", sampled, claim.promised - tolerances.robustness, "m", True, ""),
        Check("robustness over continuous time", continuous, Fraction(0), "m", True, ""),
    ]
