import json
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "monitor.py"


def test_every_formula_is_timed_and_ends_at_its_robustness(tmp_path, capsys):
    spec = spec_from_file_location("monitor_benchmark", SCRIPT)
    benchmark = module_from_spec(spec)
    sys.modules[spec.name] = benchmark  # dataclasses look their module up
    spec.loader.exec_module(benchmark)
    out = tmp_path / "monitor.json"
    rows = benchmark.main(benchmark.Args(worlds=3, repeats=1, out=out))
    assert json.loads(out.read_text()) == rows
    assert [row["formula"] for row in rows] == list(benchmark.FORMULAS.values())
    assert all(float(row["ratio"]) > 0 for row in rows)
    assert "nested three times" in capsys.readouterr().out
