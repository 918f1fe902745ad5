"""What a search for failures left beside an evaluation is a section of the page, with its pictures inside."""

import json

import pytest

from impact_envs.errors import InputError
from train.report.failures import write_failures

RECORD = {
    "format": 1,
    "scenario": "pong",
    "suite": "hard",
    "policy": "runs/<b>mine",
    "episodes": 640,
    "failures": 130,
    "least_robustness": -2.05,
    "explains": {"restitution": 0.095, "drift": 0.04},
    "map": "map.png",
    "counterexamples": [
        {
            "suite": f"break_{number}",
            "cause": "G[100,100] pop in D, 3 impacts",
            "seed": 1_000_011,
            "robustness": robustness,
            "failure_rate": 0.03125,
            "found": 10,
            "not_nominal": {"restitution": 0.32},
            "nominal": {"restitution": 0.8},
            "film": f"{number}.mp4",
        }
        for number, robustness in ((1, -0.3), (2, -0.8))
    ],
}


def put(folder, record):
    (folder / "failures").mkdir(exist_ok=True)
    (folder / "failures" / "pong.json").write_text(json.dumps(record))
    for name in ("map.png", "1.mp4", "2.mp4"):
        (folder / "failures" / name).write_bytes(b"picture")


def test_without_a_search_the_page_says_how_to_make_one(tmp_path):
    assert "impact break" in write_failures(tmp_path)


def test_every_cause_is_a_row_and_every_picture_is_inside(tmp_path):
    put(tmp_path, RECORD)
    text = write_failures(tmp_path)
    assert text.count('<th scope="row">') == 2
    assert "restitution 0.32 (nominal 0.8)" in text
    assert text.count("data:video/mp4;base64,") == 2
    assert text.count("data:image/png;base64,") == 1
    assert "Counterexample 2 (the worst)" in text
    assert "1 (the worst)" not in text
    assert "<b>mine" not in text


def test_page_tells_who_searched(tmp_path):
    put(tmp_path, RECORD)
    assert "stand-in" not in write_failures(tmp_path)
    put(tmp_path, RECORD | {"stand_in": {"expert.plan_anew": False}, "replayed": 18, "confirmed": 16})
    text = write_failures(tmp_path)
    assert "130 of 640 episodes of a stand-in with expert.plan_anew=False failed" in text
    assert "played 18 of them again, or milder ones, and failed in 16" in text


@pytest.mark.parametrize("name", ["../1.mp4", "page.html", "missing.png"])
def test_picture_that_is_none_of_the_folders_is_refused(name, tmp_path):
    put(tmp_path, RECORD | {"map": name})
    with pytest.raises(InputError, match="evaluation file"):
        write_failures(tmp_path)


def test_search_without_failures_says_so(tmp_path):
    put(tmp_path, RECORD | {"counterexamples": [], "failures": 0, "map": None})
    assert "Nothing failed" in write_failures(tmp_path)
