"""Papers against here: the files of published numbers, verdicts, and what `impact reproduce` says."""

import json

import pytest

from impact_envs import load_scenario
from impact_envs.errors import InputError
from planners import list_variants
from train.cli.main import main
from train.cli.printing import show
from train.cli.reproduce import describe_play
from train.papers.comparison import compare_row, find_value, write_table
from train.papers.paper import Row, list_papers, load_paper

NAMES = ("verhagen", "nekoo", "van_steen")


def make_row(**values):
    return Row(**({"quantity": "q", "paper": 1.0, "place": "Sec. 1", "here": ("a:x",)} | values))


def run(capsys, *arguments):
    code = main(("reproduce", *arguments))
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("name", NAMES)
def test_a_paper_names_plays_that_exist(name):
    paper = load_paper(name)
    used = {place.partition(":")[0] for row in paper.rows for place in row.here}
    drawn = {figure.play for figure in paper.figures.values()}
    assert used | drawn == paper.plays.keys()
    for play in paper.plays.values():
        scenario = load_scenario(play.arguments["scenario"])
        assert play.command == "plan" or play.arguments["policy"] in ("expert", *list_variants(scenario))
        assert describe_play(play).startswith(f"impact {play.command} {scenario.name}")


def test_a_paper_is_found_by_its_domain_too():
    assert set(list_papers()) == {"free_flyer", "floating_manipulator", "dual_arm"}
    for domain, name in zip(("free_flyer", "floating_manipulator", "dual_arm"), NAMES, strict=True):
        assert load_paper(domain) == load_paper(name)


def test_a_number_agrees_within_its_tolerance():
    assert compare_row(make_row(tolerance=0.1), [1.05])["verdict"] == "agrees"
    assert compare_row(make_row(tolerance=0.1, fitted=True), [1.05])["verdict"] == "agrees by construction"
    assert compare_row(make_row(tolerance=0.1, fitted=True), [1.5])["verdict"] == "differs"
    assert compare_row(make_row(), [1.05])["verdict"] == "not comparable"
    assert compare_row(make_row(tolerance=0.1), [1.5])["difference"] == pytest.approx(0.5)
    assert compare_row(make_row(tolerance=0.1, scale=1000.0), [0.001])["here"] == pytest.approx(1.0)


def test_what_does_not_exist_is_not_judged():
    assert compare_row(make_row(tolerance=0.1), [None])["verdict"] == "not applicable"
    assert compare_row(make_row(here=("a:x", "b:x")), [1.0, None])["verdict"] == "not applicable"
    assert compare_row(make_row(paper="drawn"), [1.0])["verdict"] == "no published number"


def test_an_ordering_holds_or_fails():
    assert compare_row(make_row(here=("a:x", "b:x")), [1.0, 2.0])["verdict"] == "holds"
    assert compare_row(make_row(here=("a:x", "b:x")), [1.0, 1.0])["verdict"] == "fails"


def test_values_are_found_by_key_index_name_and_count():
    results = {"a": {"x": {"y": [3.0, 4.0]}, "rows": [{"name": "reach", "ok": True}], "none": None}}
    assert find_value("a:x.y.1", results) == 4.0
    assert find_value("a:rows.reach.ok", results) is True
    assert find_value("a:rows.count", results) == 1
    assert find_value("a:none.0", results) is None


def test_a_table_has_a_line_per_row():
    lines = write_table([compare_row(make_row(tolerance=0.1), [1.05])]).splitlines()
    assert len(lines) == 3 and len({line.count("|") for line in lines}) == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nekko",), ("nekko", "did you mean 'nekoo'?", "van_steen")),
        (("nekoo", "fig1"), ("fig1", "fig4", "fig19")),
        (("van_steen", "--time-limit", "0"), ("--time-limit 0",)),
        (("van_steen", "--time-limit", "nan"), ("--time-limit nan",)),
    ],
)
def test_bad_input_is_refused_in_one_line(capsys, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *arguments, "--out", "new")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert all(word in err for word in words)
    assert not (tmp_path / "new").exists()


def test_a_figure_of_the_second_paper(capsys, tmp_path):
    code, out, err = run(capsys, "nekoo", "fig11", "--out", str(tmp_path), "--json")
    said = json.loads(out)
    assert code == 0 and "about 2 s" in err
    found = {row["quantity"]: row for row in said["comparison"]}
    box, base = (found[f"no actuation: way of the {name} after the impact"] for name in ("box", "base"))
    # 22.26 s at 0.2439 m/s; the base's way is no 6 m, whatever the paper says.
    assert box["here"] == pytest.approx(0.243877 * (30.0 - 7.7429), abs=0.01)
    assert base["verdict"] == "differs"
    assert [entry["figure"] for entry in said["figures"]] == ["fig11"]
    assert {path.name for path in tmp_path.iterdir()} == {"nekoo_passive.png", "nekoo.md"}


def test_the_numbers_side_by_side_are_printed_for_people(capsys):
    show({"paper": "nekoo", "comparison": [compare_row(make_row(tolerance=0.1), [1.05])]})
    assert "Sec. 1" in (said := capsys.readouterr().out) and "agrees" in said


def test_unknown_papers_name_the_known_ones():
    with pytest.raises(InputError, match="choices: "):
        load_paper("x")


def test_two_meanings_of_the_least_error(capsys):
    found = {}
    for scenario in ("floating_manipulator", "floating_manipulator_passive"):
        assert main(("run", scenario, "--json")) == 0
        found[scenario] = json.loads(capsys.readouterr().out)
    whole, passive = found.values()
    assert whole["min_error"] == whole["min_error_after_pause"] < 0.13  # it goes on after the pause
    assert passive["min_error_after_pause"] is None  # the pause lasts to the end
    assert passive["start_error"] == pytest.approx((4.5**2 + 1.5**2) ** 0.5)


def test_run_prints_estimates_of_every_pair(capsys):
    assert main(("run", "throw_and_catch", "--set", "true.restitution=0.5", "--json")) == 0
    rows = json.loads(capsys.readouterr().out)["estimates"]
    assert [(row["robot"], row["object"]) for row in rows] == [("snap", "pop"), ("crackle", "pop")]
    assert abs(rows[0]["restitution"] - 0.5) < abs(0.8 - 0.5) / 2  # believed 0.8; snap has hit
    assert all(row["mass"] > 0.0 and len(row["drift"]) == 2 for row in rows)
    assert main(("run", "throw_and_catch", "--policy", "zero", "--json")) == 0
    assert "estimates" not in json.loads(capsys.readouterr().out)
