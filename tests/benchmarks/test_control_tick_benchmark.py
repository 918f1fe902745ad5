import json
import sys
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from impact_envs.errors import InputError
from planners.dual_arm.dense_qp import solve_daqp
from planners.dual_arm.torque_qp import FREE, GRASP

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "control_tick.py"


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    spec = spec_from_file_location("control_tick_benchmark", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_one_round_times_all_methods_in_all_phases(
    benchmark: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "times.json"
    rows = benchmark.main(benchmark.Args(repeats=1, every=400, out=out))
    methods = ["ours", "cvxpy, Clarabel", *(["cvxpy, OSQP", "OSQP"] if find_spec("osqp") else [])]
    assert [(row["phase"], row["method"]) for row in rows] == [
        (phase, method) for phase in ("ante", "interim", "post") for method in methods
    ]
    for row in rows:
        assert 0.0 < float(row["p50 [us]"]) <= float(row["p99 [us]"])
        assert float(row["off [N m]"]) < 0.05
    assert all(row["ratio"] == "1.0" for row in rows if row["method"] == "ours")
    printed = capsys.readouterr().out
    assert "load" in printed and f"| {' | '.join(rows[0].values())} |" in printed
    record = json.loads(out.read_text())
    assert sum(len(times["cpu"]) for times in record["times"] if times["method"] == "ours") == 2200


def test_peers_agree_on_a_program_of_each_shape(benchmark: ModuleType) -> None:
    scenario = benchmark.load_scenario("dual_arm_grasp")
    controller = benchmark.DualArmExpert(scenario).controller
    short = scenario.model_copy(update={"horizon": 1.0})
    ticks, patterns = benchmark.record_ticks(short, controller)
    seen = set()
    controller.reset()
    for k, tick in enumerate(ticks):
        controller.control(*tick)
        program = controller.qp
        shape = program.A.shape[::-1]
        if shape not in seen and k > 200:
            seen.add(shape)
            for peer in benchmark.make_peers(shape, patterns[shape], scenario).values():
                np.testing.assert_allclose(peer(program)()[:6], solve_daqp(program)[:6], atol=0.05)
    assert seen == {FREE, GRASP}


def test_bad_arguments_are_refused(benchmark: ModuleType) -> None:
    with pytest.raises(InputError, match="repeats 0"):
        benchmark.main(benchmark.Args(repeats=0))
    with pytest.raises(InputError, match="corridor: domain free_flyer has no such tick"):
        benchmark.main(benchmark.Args(scenario="corridor"))
