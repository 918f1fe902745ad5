import json


def test_every_formula_is_timed_and_ends_at_its_robustness(load_benchmark, tmp_path, capsys):
    benchmark = load_benchmark("monitor")
    out = tmp_path / "monitor.json"
    rows = benchmark.main(benchmark.Args(worlds=3, repeats=1, out=out))
    assert json.loads(out.read_text()) == rows
    assert [row["formula"] for row in rows] == list(benchmark.FORMULAS.values())
    assert all(float(row["ratio"]) > 0 for row in rows)
    assert "nested three times" in capsys.readouterr().out
