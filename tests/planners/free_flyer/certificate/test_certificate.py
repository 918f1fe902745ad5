"""Certificates: shipped plans are confirmed, wrong ones are refused."""

import json
from fractions import Fraction

import pytest

from impact_envs import load_scenario
from impact_envs.errors import InputError
from planners.free_flyer.certificate.certificate import certify_plan
from tests.planners.free_flyer.certificate.mutants import FOLDER, KINDS, list_plans, make_mutants, read

SLOW = [pytest.param(name, marks=[] if name.startswith("throw") else pytest.mark.slow) for name in list_plans()]


def find_accepted(path, mutants):
    """Return the mutants that are not refused."""
    accepted = []
    for what, text, scenario in mutants:
        path.write_text(text)
        try:
            if certify_plan(path, scenario).confirmed:
                accepted.append(what)
        except InputError:  # it is no plan for the scenario any more
            pass
    return accepted


@pytest.mark.parametrize("name", SLOW)
def test_shipped_plan_is_confirmed_and_keeps_its_robustness_at_all_instants(name):
    certificate = certify_plan(FOLDER / f"{name}.json", read(name)[1])
    assert certificate.confirmed, certificate.to_dict()["refused"]
    low, high = certificate.continuous
    assert certificate.promised - 1e-6 <= low <= high <= certificate.sampled + 1e-7


def test_one_mutant_of_every_kind_is_refused(tmp_path):
    assert find_accepted(tmp_path / "plan.json", make_mutants(["throw_and_catch"], len(KINDS), seed=0)) == []


@pytest.mark.slow
def test_200_mutants_of_the_shipped_plans_are_refused(tmp_path):
    assert find_accepted(tmp_path / "plan.json", make_mutants(list_plans(), 200, seed=1)) == []


def test_contact_between_two_samples_is_found():
    """Two discs on straight lines overlap by 1e-6 m for some milliseconds at 5.0123 s, between the samples."""
    from planners.free_flyer.certificate.claim import Motion
    from planners.free_flyer.certificate.clearance import list_distances
    from planners.free_flyer.certificate.motion import measure_root
    from planners.free_flyer.certificate.search import Effort, find_minimum
    from planners.free_flyer.certificate.track import derive, make_track

    def fly(x0, vx, y):
        ends = Fraction(0), Fraction(10)
        x, y = make_track(ends, [(x0, x0 + 10 * vx)]), make_track(ends, [(y, y)])
        return Motion(x, y, derive(x), derive(y))

    meeting, apart = Fraction("5.0123"), Fraction("0.399999")
    first, second = fly(-meeting, Fraction(1), Fraction(0)), fly(Fraction(0), Fraction(0), apart)
    found = find_minimum(list_distances(first, second, Fraction(0), Fraction(10)), measure_root, Effort())
    assert found.low <= apart <= found.high <= apart + Fraction(1, 10**8)
    assert abs(found.time - meeting) < Fraction(1, 100)
    sampled = [
        find_minimum(list_distances(first, second, t, t), measure_root, Effort()).low
        for t in (Fraction(k, 10) for k in range(101))
    ]
    assert min(sampled) > Fraction(4, 10)


def test_file_that_is_no_plan_and_plan_of_another_scenario_are_bad_input(tmp_path):
    path, corridor = tmp_path / "plan.json", load_scenario("corridor")
    for text, words in (
        ("{", "not JSON"),
        ("[]", "plan.json"),
        ('{"scenario": "corridor"}', "objective"),
        ((FOLDER / "pong.json").read_text(), "pong"),
        (json.dumps(read("corridor")[0] | {"version": 9}), "version 9"),
        (json.dumps(read("corridor")[0] | {"horizon": float("nan")}), "horizon"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=words):
            certify_plan(path, corridor)
