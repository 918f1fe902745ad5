"""Which parts of the closed loop are on: the expert, and what it is compared with."""

from __future__ import annotations

from typing import NamedTuple


class Options(NamedTuple):
    """Parts of the closed loop.

    Attributes:
        once: plan each impact once, as the published code does; otherwise every 0.5 s, as the paper says.
        learn: estimate restitution and mass from what impacts did.
        retime: move an impact to when the object is where it should be hit, and try a missed one again.
        drift: a constant unknown acceleration of every object in its filter.
        insert: hit once more where the object would miss its next knot or leave its goal, and catch gently.
        reoptimise: choose times and places of the impacts that are left anew after each one.
        avoid: keep off bodies that are not to be hit.
        mpc: track by MPC; otherwise by LQR.
    """

    once: bool = False
    learn: bool = True
    retime: bool = True
    drift: bool = True
    insert: bool = True
    reoptimise: bool = True
    avoid: bool = True
    mpc: bool = True


EXPERT = Options()
VARIANTS = {
    "one_replan": Options(
        once=True, learn=False, retime=False, drift=False, insert=False, reoptimise=False, avoid=False
    ),
    "paper_expert": Options(learn=False, retime=False, drift=False, insert=False, reoptimise=False, avoid=False),
    "with_learning": Options(retime=False, drift=False, insert=False, reoptimise=False, avoid=False),
    "with_retiming": Options(drift=False, insert=False, reoptimise=False, avoid=False),
    "with_drift": Options(insert=False, reoptimise=False, avoid=False),
}
