import json
import sys
from collections.abc import Iterator
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from impact_envs.errors import InputError

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def benchmark() -> Iterator[ModuleType]:
    sys.path.insert(0, str(FOLDER))
    spec = spec_from_file_location("engine_benchmark", FOLDER / "engine.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    sys.path.remove(str(FOLDER))


@pytest.fixture(autouse=True)
def no_peers(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("vmas", "mpe2", "mpe2.simple_spread_v3"):
        monkeypatch.setitem(sys.modules, name, None)


@pytest.fixture
def methods(benchmark: ModuleType) -> Any:
    return sys.modules["engine_methods"]


@pytest.fixture
def ours(benchmark: ModuleType) -> Any:
    return sys.modules["engine_ours"]


def test_a_small_run_writes_everything(
    benchmark: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, plot = tmp_path / "rates.json", tmp_path / "rates.png"
    arguments = benchmark.Args(batches=(1, 2), looped=1, steps=3, repeats=2, growth=False, out=out, plot=plot)
    benchmark.main(arguments)
    record = json.loads(out.read_text())
    measured = {(run["setting"], run["method"], run["batch"]) for run in record["runs"]}
    for setting in ("2+1", "4+3"):
        assert {name for _, name, batch in measured if batch == 2} >= {"ours, compiled step", "ours, vector_env"}
        assert (setting, "ours, PettingZoo", 1) in measured
        assert (setting, "pymunk, bare", 1) in measured
        assert (setting, "pymunk, bare", 2) not in measured
    assert all(run["seconds"] > 0.0 for run in record["runs"])
    assert len(record["runs"]) == 2 * len(measured)
    assert [row["overflow"] for row in record["episodes"]] == [0, 0]
    assert plot.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "VMAS transport is left out" in printed
    assert "pip install vmas mpe2" in printed
    assert "load before" in printed
    assert "| 2+1     | VMAS transport            |" in printed
    (line,) = (line for line in printed.splitlines() if line.startswith("| 4+3     | pymunk, bare"))
    assert line.rstrip(" |").endswith("-")


def test_ratios_are_of_medians(benchmark: ModuleType, methods: Any) -> None:
    def run(method: str, cpu_seconds: float) -> Any:
        return benchmark.Run("2+1", method, 10, 100, seconds=9.0, cpu_seconds=cpu_seconds)

    ours = [run(methods.VECTOR, seconds) for seconds in (0.1, 0.2, 5.0)]
    peer = [run(methods.VMAS, seconds) for seconds in (1.0, 4.0, 40.0)]
    rates = benchmark.make_rates([*ours, *peer], methods.make_methods(1, 10))
    assert [row["rate"] for row in rates] == pytest.approx([5000.0, 250.0])
    assert (rates[0]["least"], rates[0]["greatest"]) == pytest.approx((200.0, 10_000.0))
    (ratio,) = benchmark.make_ratios(rates)
    assert (ratio["ours"], ratio["peer"], ratio["batch"]) == (methods.VECTOR, methods.VMAS, 10)
    assert ratio["ratio"] == pytest.approx(20.0)


def test_all_cores_are_rated_by_wall_time(benchmark: ModuleType, methods: Any) -> None:
    method = next(method for method in methods.make_methods(1, 1) if method.name.endswith("cores"))
    (row,) = benchmark.make_rates([benchmark.Run("2+1", method.name, 1, 100, 0.5, 1.0)], [method])
    assert (row["rate"], row["cpu_rate"], row["clock"]) == (200.0, 100.0, "wall")


def test_ctrl_c_keeps_what_is_measured(
    benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measure = benchmark.measure_round

    def interrupt(runs: Any, *rest: Any) -> None:
        if runs:
            raise KeyboardInterrupt
        measure(runs, *rest)

    monkeypatch.setattr(benchmark, "measure_round", interrupt)
    record = benchmark.main(benchmark.Args(settings=("2+1",), batches=(1,), steps=2, repeats=3))
    assert {row["repeats"] for row in record["rates"]} == {1}
    assert record["growth"] == []
    assert "| 2+1     | ours, vector_env" in capsys.readouterr().out


def test_a_spent_budget_ends_the_repeats(benchmark: ModuleType) -> None:
    episode = benchmark.Episode(lambda: None, lambda count: None)
    args, runs = benchmark.Args(budget=1e-12), []
    for turn in range(3):
        benchmark.measure_round(runs, {"ours": episode}, "2+1", 1, args, turn)
    assert len(runs) == 1


def test_actions_are_random_and_held(ours: Any) -> None:
    rows = ours.make_rows(4, 6, 7)
    actions = ours.cut(rows, 4, 7, 2)
    assert [action.shape for action in actions] == [(4, 6)] * 7
    np.testing.assert_array_equal(actions[0], actions[1])
    assert not (actions[1] == actions[2]).any()
    assert -1.0 <= rows.min() < -0.5 < 0.5 < rows.max() <= 1.0


def test_the_compiled_step_alone_moves_worlds_as_vector_env_does(methods: Any, ours: Any) -> None:
    setting = methods.SETTINGS[0]
    episodes = [make(setting, 4, 7) for make in (partial(ours.make_vector, threads=1), ours.make_compiled)]
    states = []
    for episode in episodes:
        envs = episode.reset.func.__self__
        episode.reset()
        episode.run(7)
        assert envs.batch.steps.tolist() == [7] * 4
        states.append(envs.batch.states)
    np.testing.assert_array_equal(*states)
    assert np.abs(states[0][:, :2, 2:4]).min() > 0.0


def test_bare_pymunk_flies_as_ours_does(methods: Any, ours: Any) -> None:
    """Nothing touches in the first second from rest, and ten substeps integrate held forces to 1 cm."""
    setting = methods.SETTINGS[0]
    bare, exact = sys.modules["engine_peers"].make_pymunk(setting, 1, 10), ours.make_vector(setting, 1, 10, threads=1)
    for episode in (bare, exact):
        episode.reset()
        episode.run(10)
    (worlds,) = (cell.cell_contents for cell in bare.reset.__closure__ if isinstance(cell.cell_contents, list))
    positions = np.array([tuple(body.position) for body in worlds[0][1]])
    start = np.array([body.start for body in ours.load_discs(setting.scenario).robots.values()])
    assert np.abs(positions[:2] - start).max() > 1e-3
    np.testing.assert_allclose(positions, exact.reset.func.__self__.batch.states[0, :, :2], atol=0.01)


def test_growth_counts_bytes_once(benchmark: ModuleType) -> None:
    growth = sys.modules["engine_growth"]
    array = np.zeros((4, 6))
    assert growth.count_bytes([array, array.reshape(-1), np.zeros(3)]) == 27 * 8
    yard = growth.make_yard(4, 3)
    assert (len(yard.robots), len(yard.objects)) == (4, 3)
    memory = growth.measure_memory(yard)
    assert memory["joint observation, float64"] == 8 * (7 * 7 + 4 + 3)
    assert memory["bytes per world, float32"] < memory["bytes per world, float64"]


def test_bad_arguments_are_refused(benchmark: ModuleType) -> None:
    with pytest.raises(InputError, match="must be positive"):
        benchmark.main(benchmark.Args(repeats=0))
    with pytest.raises(InputError, match=r"setting '3\+1' is unknown; choices: 2\+1, 4\+3"):
        benchmark.main(benchmark.Args(settings=("3+1",)))
