"""Bounds of robustness over continuous time hold what dense samples say, and come near to it."""

from fractions import Fraction

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.stl import Trace, robustness
from planners.free_flyer.certificate.certificate import certify_plan
from planners.free_flyer.certificate.claim import read_claim
from planners.free_flyer.certificate.polynomial import evaluate, restrict, root_above, root_below, square
from planners.free_flyer.certificate.robustness import bound_robustness, make_signals
from planners.free_flyer.certificate.search import Effort
from planners.plan import Plan
from tests.planners.free_flyer.certificate.mutants import FOLDER

PLAN = FOLDER / "throw_and_catch.json"
STEP = 0.005  # of the dense samples [s]
# Robots and the object move at up to 0.1 m/s, and speeds change by less than 0.1 m/s^2.
CLOSE = 0.1 * STEP
FORMULAS = {
    "always": "G[3.3,17.1] pop in goal",
    "eventually": "F[0,30] snap.x >= 0.2",
    "outside": "G[0,30] all not in goal",
    "distance": "G[0,9] distance(snap, pop) >= 0.4",
    "speed": "G[0,9] speed(snap) <= 0.1 & F[11,19] speed(pop) <= 0.09",
    "either": "G[0,30] (pop.y <= 2 | distance(pop, crackle) <= 1)",
    "nested": "G[0,20] F[0,8] pop.y >= 1.6",
    "in order": "F[0,12] (snap.y >= 0.2 & F[0,9] (pop.y >= 1.9 & F[0,9] pop in goal))",
    "until": "(pop.y <= 2.2) U[5,25] (crackle.y <= 3)",
    "no until": "not ((pop.y <= 2.2) U[5,25] (crackle.y <= 3))",
    "until within": "F[0,5] ((pop.y <= 2.2) U[2,20] (snap.y >= 0.6))",
    "implies": "G[0,25] (pop.y >= 1.7 -> F[0,5] pop.y >= 1.9)",
}


@pytest.mark.parametrize("name", FORMULAS)
def test_bounds_agree_with_dense_samples(name):
    scenario = load_scenario("throw_and_catch").override({"formula": FORMULAS[name]})
    claim, plan = read_claim(PLAN), Plan.load(PLAN)
    low, high = map(float, bound_robustness(make_signals(claim, scenario), scenario, Effort()))
    times = np.arange(round(30 / STEP) + 1) * STEP
    signals = {}
    for body, curve in (plan.robots | plan.objects).items():
        columns = np.hstack([curve.position(times), curve.velocity(times)]).T
        signals |= {f"{body}.{axis}": column for axis, column in zip(("x", "y", "vx", "vy"), columns, strict=True)}
    dense = robustness(scenario.specification, Trace(signals, STEP, scenario.areas, scenario.bodies))
    assert low <= high
    assert high - low < 1e-4
    assert dense - CLOSE <= high
    assert low <= dense + CLOSE


def test_formula_that_fails_between_samples_is_refused():
    """The throw passes y = 2 between two samples: it is never exactly there at one, so it may stay away from it."""
    scenario = load_scenario("throw_and_catch")
    strip = {"lower": [0.0, 1.7401], "upper": [1.0, 1.7402]}
    changed = scenario.override({"regions.strip": strip, "formula": "G[30,30] pop in goal & G[0,30] pop not in strip"})
    certificate = certify_plan(PLAN, changed)
    checks = {check.name: check for check in certificate.checks}
    assert certificate.sampled > 0
    assert not checks["robustness over continuous time"].confirmed


def test_polynomials_are_exact():
    p = tuple(Fraction(k) for k in (3, -1, 4, 1, -5, 9))
    part, squared = restrict(p, Fraction(1, 3), Fraction(3, 4)), square(p)
    for s in (Fraction(0), Fraction(2, 7), Fraction(1)):
        assert evaluate(part, s) == evaluate(p, Fraction(1, 3) + s * Fraction(5, 12))
        assert evaluate(squared, s) == evaluate(p, s) ** 2
    assert root_below(Fraction(9, 4)) == root_above(Fraction(9, 4)) == Fraction(3, 2)
    assert root_below(Fraction(2)) ** 2 < 2 < root_above(Fraction(2)) ** 2
