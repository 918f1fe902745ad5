"""The compiled control of two arms computes what its readable form computes with DAQP, tick by tick."""

from dataclasses import replace

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.dual_arm.model import DualArmModel
from impact_envs.dual_arm.plant import NORMAL
from planners.dual_arm.impact_prediction import load_impact_map
from planners.dual_arm.options import EXPERT, PAPER, VARIANTS, Options
from planners.dual_arm.reference_spreading import ReferenceSpreading
from tests.planners.dual_arm.oracle import ReadableSpreading

SCENARIO = load_scenario("dual_arm_grasp")
# Late enough that the box is carried, in most draws.
TICKS = 1500


def make_pair(options: Options, solver: str = "goldfarb_idnani") -> tuple[ReferenceSpreading, ReadableSpreading]:
    believed = SCENARIO.as_believed()
    found = load_impact_map(believed, options) if options.controller.impact_map else None
    return (
        ReferenceSpreading(believed, found, options.controller, solver),
        ReadableSpreading(believed, found, options.controller, "daqp"),
    )


def compare(pair, suite: str, seed: int, ticks: int = TICKS, disturb=None) -> float:
    """Return the greatest difference of a torque when both measure what the readable one's torques cause."""
    scenario = SCENARIO.suite(suite)
    model, worst = DualArmModel(scenario), 0.0
    model.reset(scenario.draw(np.random.default_rng(seed)))
    compiled, readable = pair
    compiled.reset()
    readable.reset()
    for k in range(ticks):
        q, v = model.joints()
        forces = model.contacts()[:4, NORMAL]
        if disturb is not None:
            disturb(k, q, v, pair)
        one, other = compiled.control(q, v, forces), readable.control(q, v, forces)
        worst = max(worst, float(np.abs(one - other).max()))
        assert compiled.phase == readable.phase
        if disturb is None and readable.fallbacks["last_torque"]:
            return worst  # DAQP calls some slack forms infeasible, which always have a solution
        model.tick(other)
    assert compiled.switches == readable.switches
    assert compiled.fallbacks == readable.fallbacks
    assert compiled.ticks_of_grasp == readable.ticks_of_grasp
    for name in ("box", "predicted", "heights"):
        assert getattr(compiled, name) == pytest.approx(getattr(readable, name), abs=1e-12)
    assert compiled.reference_error() == pytest.approx(readable.reference_error(), abs=1e-12)
    assert compiled.solution[6:] == pytest.approx(readable.solution[6:12], abs=1e-6)
    return worst


@pytest.mark.parametrize("suite", ["nominal", "all", "hard"])
def test_torques_equal_those_of_the_readable_form(suite):
    assert compare(make_pair(EXPERT), suite, 1_000_000) < 1e-9


@pytest.mark.parametrize("variant", VARIANTS)
def test_variants_equal_those_of_the_readable_form(variant):
    assert compare(make_pair(VARIANTS[variant]), "all", 1_000_001) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("suite", ["nominal", "box_pose", "mass", "friction", "start_pose", "all", "hard"])
def test_many_worlds_equal_those_of_the_readable_form(suite):
    pair = make_pair(EXPERT)
    for seed in range(1_000_000, 1_000_010):
        worst = compare(pair, suite, seed, 2200)
        # where pads slide off the box, accelerations and their rounding errors are hundreds of times as great
        assert worst < (1e-7 if pair[1].fallbacks else 1e-9)


def test_with_daqp_both_compute_the_same_bits_before_the_impact():
    """The same programs, built by the same functions; the prediction after it is summed in another order."""
    assert compare(make_pair(EXPERT, "daqp"), "all", 1_000_002, 700) == 0.0
    assert compare(make_pair(EXPERT, "daqp"), "all", 1_000_002) < 1e-9


def test_missing_measurements_corrected_loads_and_impossible_programs_are_treated_alike():
    """Slack forms and held torques too: pads that fly apart faster than the torque limits allow for."""

    def disturb(k, q, v, pair):
        if k in (5, 6, 900):
            q[0, 0] = np.nan
        if 1000 <= k < 1020:
            v += 40.0 * np.random.default_rng(k).standard_normal((2, 3))
        if k == 950:
            for controller in pair:
                controller.scale_load(1.3, 0.8)

    pair = make_pair(EXPERT)
    # at the wild rates accelerations are hundreds of times those of an episode, and so are rounding errors
    assert compare(pair, "nominal", 1_000_003, 1100, disturb) < 1e-8
    assert pair[0].fallbacks["last_torque"] >= 3
    assert pair[0].fallbacks["slack"] > 0


def test_a_time_out_and_no_soft_start_are_treated_alike():
    quick = replace(PAPER.controller, time_out=0.02, fade=0.01, press=5.0, press_rise=0.0)
    assert compare(make_pair(PAPER._replace(controller=quick)), "all", 1_000_004, 1100) < 1e-9
