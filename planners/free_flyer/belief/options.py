"""Which parts of the closed loop are on: the expert, and what it is compared with."""

from __future__ import annotations

from typing import Any, NamedTuple

from impact_envs.errors import InputError, choices

# Options.tracker in compiled code: by the compiled MPC, by LQR, by an object that Python calls.
BY_MPC, BY_LQR, BY_OBJECT = range(3)


class Options(NamedTuple):
    """Parts of the closed loop.

    Attributes:
        once: plan each impact once, as the published code does; otherwise every 0.5 s, as the paper says.
        learn: estimate restitution and mass from what impacts did.
        retime: move an impact to when the object is where it should be hit, and try a missed one again.
        drift: a constant unknown acceleration of every object in its filter.
        insert: add an unplanned impact when the object would miss its next knot or leave its goal; slow it gently
            at the goal.
        reoptimise: choose times and places of the impacts that are left anew after each one.
        plan_anew: plan the rest in the background, with who hits what open, where that fails.
        avoid: keep off bodies that are not to be hit.
        tracker: what follows the courses, a name of `tracking.trackers.TRACKERS`.
    """

    once: bool = False
    learn: bool = True
    retime: bool = True
    drift: bool = True
    insert: bool = True
    reoptimise: bool = True
    plan_anew: bool = True
    avoid: bool = True
    tracker: str = "mpc"


EXPERT = Options()
# Each is the one before and more; the last part makes the expert.
_PAPER = Options(learn=False, retime=False, drift=False, insert=False, reoptimise=False, plan_anew=False, avoid=False)
VARIANTS = {
    "one_replan": _PAPER._replace(once=True),
    "paper_expert": _PAPER,
    "with_learning": _PAPER._replace(learn=True),
    "with_retiming": _PAPER._replace(learn=True, retime=True),
    "with_drift": _PAPER._replace(learn=True, retime=True, drift=True),
    "with_insertion": EXPERT._replace(reoptimise=False, plan_anew=False),
    "with_reoptimisation": EXPERT._replace(plan_anew=False),
}


def get_options(variant: str | None) -> Options:
    """Return the parts of the closed loop that a variant has; all of them without one.

    Raises:
        InputError: unknown variant.
    """
    if variant is None:
        return EXPERT
    if variant not in VARIANTS:
        raise InputError(f"variant '{variant}' is unknown; {choices(variant, VARIANTS)}")
    return VARIANTS[variant]


def encode_options(options: Options) -> tuple[Any, ...]:
    """Return the options as compiled code takes them: the tracker as its number."""
    return tuple(options._replace(tracker={"mpc": BY_MPC, "lqr": BY_LQR}.get(options.tracker, BY_OBJECT)))  # type: ignore[arg-type]
