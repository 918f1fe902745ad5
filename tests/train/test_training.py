"""Training: starts at the expert, keeps what surely gains most, keeps its seeds apart, and is one run however often
it is stopped.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tyro
from safetensors.numpy import load_file

import planners
from agents import ResidualPolicy, ResidualVectorEnv
from agents.actor import load_policy
from agents.play import Played, play_episodes
from agents.residual import TRAINING_SEEDS
from agents.training_state import read_training
from impact_envs import InputError, load_scenario, parallel_env, rollout
from impact_envs.scenario import Scenario
from planners.plan import Plan
from train import ground, residual
from train.cli.main import main as run_command
from train.errors import Diverged
from train.evaluation.case import EVALUATION_SEEDS, REPORT_SEEDS, TUNING_SEEDS
from train.evaluation.paired import QUANTILE, Gain, compute_gain, compute_interquartile_mean, summarise_pairs
from train.residual import Args, check_evaluations, main
from train.score import compare_episodes, compute_scores, find_failure_cost, rate_evaluation

SCORED: dict[str, Any] = {
    "iterations": 0, "share": 1.0, "low": 0.0, "success_rate": 1.0, "expert_success_rate": 1.0, "sources": []
}  # fmt: skip
STEPS = 96  # three iterations and a bit: an episode of throw_and_catch asks for two corrections


PLANS: dict[tuple[str, float], Plan] = {}


@pytest.fixture(autouse=True)
def _plan_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ground, "make_plan", plan_once)


def plan_once(scenario: Scenario) -> Plan:
    key = scenario.name, scenario.horizon
    if key not in PLANS:
        PLANS[key] = planners.make_plan(scenario)
    return PLANS[key]


def make_args(out: Path, **changes: Any) -> Args:
    small = Args(
        scenarios=("throw_and_catch",),
        suite=("all",),
        out=out,
        steps=STEPS,
        worlds=16,
        group=4,
        threads=1,
        batch=16,
        epochs=2,
        log_std=-1.0,
        eval_every=2,
        eval_episodes=6,
        report_episodes=0,
        hidden=(8,),
        log=False,
        progress=False,
    )
    return dataclasses.replace(small, **changes)


def read_bytes(out: Path) -> dict[str, bytes]:
    """Return all weights that a run left, by their place."""
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*.safetensors"))}


def read_run(out: Path) -> Any:
    return read_training(residual.last_checkpoint(out) or out)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A run that nobody interrupts."""
    out = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ground, "make_plan", plan_once)
        main(make_args(out))
        yield out


def test_a_run_saves_what_is_needed(tmp_path: Path) -> None:
    result = main(make_args(tmp_path, log=True, report_episodes=5))
    assert result["steps"] >= STEPS
    assert (result["out"], result["wall_seconds"] > 0) == (str(tmp_path), True)
    folders = sorted(path.name for path in (tmp_path / "checkpoints").iterdir())
    last = int(folders[-1])
    assert folders == [f"{last - 1:06d}", f"{last:06d}"]
    assert list((tmp_path / "tensorboard").glob("events.*"))
    settings = json.loads((tmp_path / "args.json").read_text())
    assert settings["args"]["scenarios"] == ["throw_and_catch"]
    assert settings["versions"]["torch"]
    record = read_run(tmp_path)
    assert (record.iterations, record.steps) == (last, result["steps"])
    assert [evaluation["iterations"] for evaluation in record.evaluations] == [*range(0, last, 2), last]
    assert result["eval"] in record.evaluations
    (source,) = result["report"]["sources"]
    assert (source["scenario"], source["suite"], source["episodes"]) == ("throw_and_catch", "all", 5)
    policy = load_policy(tmp_path)[1]
    assert policy.steps == result["eval"]["steps"]
    assert [source.suite for source in policy.sources] == ["all"]


def test_training_starts_exactly_at_the_expert(whole: Path) -> None:
    first = read_run(whole).evaluations[0]
    assert (first["iterations"], first["steps"]) == (0, 0)
    assert (first["gain"], first["low"], first["correction"], first["filtered"]) == (0.0, 0.0, 0.0, 0.0)
    assert first["success_rate"] == first["expert_success_rate"]


def test_a_new_policy_flies_the_experts_episodes_bit_for_bit(tmp_path: Path) -> None:
    main(make_args(tmp_path, steps=1, eval_episodes=2))
    first = residual.last_checkpoint(tmp_path).with_name("000000")
    world = load_scenario("throw_and_catch").suite("all")
    plan = plan_once(world)
    env, policy = parallel_env(world), ResidualPolicy.load(first, world, plan)
    for seed in (3, 4):
        expert = rollout(env, planners.make_expert(world, plan), seed)
        assert rollout(env, policy, seed).robustness == expert.robustness


def test_the_policy_that_surely_gains_most_is_kept(whole: Path) -> None:
    record = read_run(whole)
    rates = [rate_evaluation(evaluation, Args.loss) for evaluation in record.evaluations]
    best = record.evaluations[rates.index(max(rates))]
    assert load_policy(whole)[1].steps == best["steps"]


def test_a_policy_that_loses_success_is_not_kept_however_much_it_gains() -> None:
    gains = {"low": 1.0, "success_rate": 0.9, "expert_success_rate": 0.92, "sources": []}
    assert rate_evaluation(gains, 0.01) < rate_evaluation(SCORED, 0.01)
    assert rate_evaluation(gains | {"success_rate": 0.91}, 0.01) == rate_evaluation(gains, 0.03) == 1.0


def test_success_won_in_one_suite_does_not_pay_for_what_is_lost_in_another() -> None:
    won, lost = {"success_rate": 0.9, "expert_success_rate": 0.8}, {"success_rate": 0.88, "expert_success_rate": 0.9}
    both = {**SCORED, "success_rate": 0.89, "expert_success_rate": 0.85, "low": 1.0}
    assert rate_evaluation({**both, "sources": [won, lost]}, 0.01) == -math.inf
    assert rate_evaluation({**both, "sources": [won, lost]}, 0.015) == 1.0  # sqrt(2) times as much of one of two
    assert find_failure_cost(Args(failure=0.5, failure_rise=2.0, loss=0.01), [{**both, "sources": [won, lost]}]) == 1.0


@pytest.mark.parametrize("worse", [True, False])
def test_a_worse_policy_does_not_replace_a_better_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worse: bool
) -> None:
    """Gains are made up: each evaluation is worse than the one before, or better."""
    lows = iter(range(0, -100, -1) if worse else range(100))
    monkeypatch.setattr(
        ground, "summarise_pairs", lambda gains: summarise_pairs(gains) | SCORED | {"low": float(next(lows))}
    )
    result = main(make_args(tmp_path))
    assert load_policy(tmp_path)[1].steps == result["eval"]["steps"] == (0 if worse else result["steps"])


def test_without_evaluations_the_last_policy_is_kept(tmp_path: Path) -> None:
    result = main(make_args(tmp_path, eval_every=0))
    assert result["eval"] == {}
    assert load_policy(tmp_path)[1].steps == result["steps"]
    last = residual.last_checkpoint(tmp_path)
    assert (tmp_path / "policy.safetensors").read_bytes() == (last / "policy.safetensors").read_bytes()


@pytest.fixture
def seeds(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Seeds of all that is played."""
    found: list[np.ndarray] = []

    def play(worlds: ResidualVectorEnv, seeds: Any, choose: Any = None) -> Played:
        found.append(np.asarray(seeds))
        return play_episodes(worlds, seeds, choose)

    for module in (ground, residual):
        monkeypatch.setattr(module, "play_episodes", play)
    return found


def test_seeds_of_training_selection_report_and_evaluation_are_apart(tmp_path: Path, seeds: list[np.ndarray]) -> None:
    args = make_args(tmp_path, report_episodes=5)
    main(args)
    learned = [each for each in seeds if len(each) == args.worlds]
    judged = [each for each in seeds if len(each) < args.worlds]
    assert all((each < TRAINING_SEEDS).all() for each in learned)
    assert {tuple(each) for each in judged} == {
        tuple(range(TUNING_SEEDS, TUNING_SEEDS + 6)),
        tuple(range(REPORT_SEEDS, REPORT_SEEDS + 5)),
    }
    assert TRAINING_SEEDS <= TUNING_SEEDS < REPORT_SEEDS < EVALUATION_SEEDS
    # The report comes last: nothing is chosen on it.
    assert min(map(min, judged[-2:])) == REPORT_SEEDS
    assert max(map(max, judged[:-2])) < REPORT_SEEDS


def test_episodes_of_a_group_share_their_seed_and_iterations_do_not(tmp_path: Path, seeds: list[np.ndarray]) -> None:
    main(make_args(tmp_path, eval_every=0))
    _, *iterations = seeds  # the first look at the expert
    assert len(iterations) >= 2
    for each in iterations:
        groups = each.reshape(-1, 4)
        assert (groups == groups[:, :1]).all()
    assert len({int(seed) for each in iterations for seed in each}) == 4 * len(iterations)


def test_the_same_seed_trains_the_same_bytes_with_any_number_of_threads(whole: Path, tmp_path: Path) -> None:
    for name, changes in (("again", {}), ("threads", {"threads": 2}), ("other", {"seed": 1})):
        main(make_args(tmp_path / name, **changes))
    assert read_bytes(tmp_path / "again") == read_bytes(whole)
    assert read_bytes(tmp_path / "threads") == read_bytes(whole)
    other = read_bytes(tmp_path / "other")
    assert other.keys() == read_bytes(whole).keys()
    assert all(content != other[name] for name, content in read_bytes(whole).items() if "checkpoints" in name)


class Interruption:
    """Act as if Ctrl-C were pressed at the n-th call of a function of the training."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, target: Any, name: str, number: int) -> None:
        self._plain: Callable[..., Any] = getattr(target, name)
        self.left = number
        monkeypatch.setattr(target, name, lambda *arguments, **options: self.call(*arguments, **options))

    def call(self, *arguments: Any, **options: Any) -> Any:
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt
        return self._plain(*arguments, **options)


MOMENTS = [
    (residual, "play_episodes", 4),
    (ground, "play_episodes", 4),
    (residual, "update", 1),
    (residual, "update", 3),
    (residual, "export_actor", 3),
    (residual, "save_policy", 4),
    (residual, "save_training", 3),
]


@pytest.mark.parametrize(("target", "name", "number"), MOMENTS)
def test_a_run_that_is_interrupted_anywhere_and_resumed_is_the_whole_run(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: Any, name: str, number: int
) -> None:
    with monkeypatch.context() as patch:
        Interruption(patch, target, name, number)
        with pytest.raises(KeyboardInterrupt):
            main(make_args(tmp_path))
    assert not list((tmp_path / "checkpoints").glob(".*"))
    main(make_args(tmp_path, resume=True))
    assert read_bytes(tmp_path) == read_bytes(whole)
    assert read_run(tmp_path).evaluations == read_run(whole).evaluations


def test_a_run_resumed_in_many_pieces_is_the_whole_run(whole: Path, tmp_path: Path) -> None:
    """Without evaluations, which a longer run would have elsewhere."""
    for part, steps in (("one", (STEPS,)), ("many", (1, STEPS // 2, STEPS))):
        for place, number in enumerate(steps):
            main(make_args(tmp_path / part, eval_every=0, steps=number, resume=place > 0))
    one, many = read_bytes(tmp_path / "one"), read_bytes(tmp_path / "many")
    assert one == many
    # Evaluating draws nothing that learning would miss.
    last = residual.last_checkpoint(whole).relative_to(whole) / "training.safetensors"
    assert one[str(last)] == read_bytes(whole)[str(last)]


def test_a_finished_run_is_resumed_to_nothing_new(whole: Path, tmp_path: Path) -> None:
    first = main(make_args(tmp_path))
    again = main(make_args(tmp_path, resume=True))
    assert (again["steps"], again["eval"]) == (first["steps"], first["eval"])
    assert read_bytes(tmp_path) == read_bytes(whole)


def test_ctrl_c_exits_130_and_what_was_finished_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Interruption(monkeypatch, residual, "update", 2)
    options = "--worlds 16 --group 4 --threads 1 --eval-every 0 --report-episodes 0 --no-log --no-progress"
    arguments = ["train", "throw_and_catch", "--out", str(tmp_path), "--steps", "96", *options.split()]
    assert run_command(arguments) == 130
    assert "interrupted; what was finished is kept" in capsys.readouterr().err
    assert read_run(tmp_path).iterations == 1
    assert run_command([*arguments, "--resume", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["steps"] >= 96


def test_a_trained_policy_is_what_was_judged(tmp_path: Path) -> None:
    result = main(make_args(tmp_path, eval_every=0, report_episodes=3, learning_rate=0.01))
    (source,) = result["report"]["sources"]
    world = load_scenario("throw_and_catch").suite("all")
    policy = ResidualPolicy.load(tmp_path, world, plan_once(world), {"plan_anew": False})
    expert = planners.make_expert(world, plan_once(world), options={"plan_anew": False})
    env, seeds = parallel_env(world), range(REPORT_SEEDS, REPORT_SEEDS + 3)
    learned, alone = ([rollout(env, each, seed).robustness for seed in seeds] for each in (policy, expert))
    assert source["robustness"] == pytest.approx(compute_interquartile_mean(np.array(learned)), abs=1e-6)
    assert source["expert_robustness"] == compute_interquartile_mean(np.array(alone))
    assert source["gain"] != 0.0


def test_several_scenarios_and_suites_train_one_policy(tmp_path: Path, seeds: list[np.ndarray]) -> None:
    args = make_args(
        tmp_path, scenarios=("throw_and_catch", "pong"), suite=("mass", "all"), steps=8, eval_episodes=2, eval_every=1
    )
    result = main(args)
    pairs = [(s, suite) for s in ("throw_and_catch", "pong") for suite in ("mass", "all")]
    assert [(s.scenario, s.suite) for s in load_policy(tmp_path)[1].sources] == pairs
    assert [(s["scenario"], s["suite"]) for s in result["eval"]["sources"]] == pairs
    assert len(read_run(tmp_path).scales) == 4
    assert {len(each) for each in seeds} == {4, 2}


def test_values_of_the_expert_and_of_the_world_can_be_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[dict[str, Any]] = []

    class Worlds(ResidualVectorEnv):
        def __init__(self, scenario: Any, *arguments: Any, **options: Any) -> None:
            made.append({"scenario": scenario, **options})
            super().__init__(scenario, *arguments, **options)

    monkeypatch.setattr(ground, "ResidualVectorEnv", Worlds)
    settings = ("expert.filter=false", "true.restitution=0.5")
    result = main(make_args(tmp_path, steps=1, set=settings, eval_episodes=2, eval_every=1, log_std=1.0))
    assert made[0]["options"] == {"filter": False, "plan_anew": False}
    assert result["eval"]["filtered"] == 0.0
    assert read_run(tmp_path).run["set"] == list(settings)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "steps 0 is too small; choices: 1, 2, ..."),
        ({"seed": -1}, "seed -1 is too small"),
        ({"group": 1}, "group 1 is too small; choices: 2, 3, ..."),
        ({"batch": 1}, "batch 1 is too small"),
        ({"epochs": 0}, "epochs 0 is too small"),
        ({"eval_episodes": 1}, "eval_episodes 1 is too small"),
        ({"eval_episodes": 600_000}, "eval_episodes 600000: there are 500000 tuning seeds"),
        ({"report_episodes": -1}, "report_episodes -1 is too small"),
        ({"worlds": 18}, "worlds 18 is not a multiple of group 4 in each of 1 scenarios and suites"),
        ({"suite": ("all", "mass"), "worlds": 12}, "worlds 12 is not a multiple of group 4 in each of 2"),
        ({"scenarios": ()}, "worlds 16 is not a multiple|scenario"),
        ({"hidden": ()}, r"hidden \[\]: every layer needs a width of at least 1"),
        ({"shares": (0.5,)}, r"shares \[0.5\]: choices: 1 and then ever smaller shares above 0"),
        ({"shares": (1.0, 0.5, 0.5)}, r"shares \[1.0, 0.5, 0.5\]: choices: 1 and then"),
        ({"loss": -0.1}, r"loss -0.1: choices: from 0 to 1"),
        ({"failure_fall": 1.5}, r"failure_fall 1.5: choices: from 0 to 1"),
        ({"hidden": (8, 0)}, r"hidden \[8, 0\]"),
        ({"suite": ("restitutoin",)}, "did you mean 'restitution'"),
        ({"suite": ("all", "all")}, "suite 'all' .*twice"),
        ({"scenarios": ("throw_and_cathc",)}, "throw_and_cathc"),
        ({"variant": "paper_exprt"}, "has no variant 'paper_exprt'; did you mean 'paper_expert'"),
        ({"set": ("expert.filtr=false",)}, "filtr"),
        ({"set": ("expert.filter=3",)}, "filter"),
        ({"set": ("true.restitution",)}, "expected KEY=VALUE"),
        ({"resume": True}, "holds no checkpoint to resume from"),
        ({"learning_rate": float("nan")}, "learning_rate nan: choices: from 0 to 1"),
        ({"learning_rate": -1e-3}, "learning_rate -0.001: choices: from 0 to 1"),
        ({"log_std": float("inf")}, "log_std inf: choices: from -20 to 2"),
        ({"clip": 1.5}, "clip 1.5: choices: from 0 to 1"),
        ({"worst": -1.0}, "worst -1: choices: from 0"),
        ({"cut": 0.0}, "cut 0: choices: from 1e-06"),
        ({"threads": 0}, "threads 0 is too small; choices: 1, 2, ..."),
        ({"entropy": float("nan")}, "entropy nan: choices: from 0 to 1"),
        ({"target_kl": 0.0}, "target_kl 0: choices: from 1e-06"),
    ],
)
def test_bad_arguments_are_one_line_and_leave_nothing(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        main(make_args(tmp_path / "out", **changes))
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_bad_arguments_of_the_command_exit_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["--suite", "nowhere"], ["--steps", "0"], ["--algo", "sac"], ["--set", "expert.filter=3"]):
        assert run_command(["train", "throw_and_catch", "--out", str(tmp_path / "out"), *arguments]) == 2
        said = capsys.readouterr()
        assert (len(said.err.splitlines()), said.out) == (1, "")
    assert not list(tmp_path.iterdir())


def test_scenarios_of_different_experts_are_trained_apart(tmp_path: Path) -> None:
    changes = {"scenarios": ("throw_and_catch", "dual_arm_grasp"), "suite": ("nominal",)}
    with pytest.raises(InputError, match=r"throw_and_catch and dual_arm_grasp .*train them apart"):
        main(make_args(tmp_path, **changes))


def test_a_run_is_neither_overwritten_nor_resumed_as_another(tmp_path: Path) -> None:
    main(make_args(tmp_path, steps=1, eval_every=0))
    with pytest.raises(InputError, match="holds a run of 1 iterations; resume it or choose another"):
        main(make_args(tmp_path))
    for changes, message in (
        ({"hidden": (4,)}, r"was made with hidden \[8\]; cannot be resumed with \[4\]"),
        ({"suite": ("mass",)}, r"was made with suite \['all'\]; cannot be resumed with \['mass'\]"),
        ({"scenarios": ("pong",)}, r"was made with scenarios \['throw_and_catch'\]"),
        ({"seed": 1}, "was made with seed 0; cannot be resumed with 1"),
        ({"worlds": 8}, "was made with worlds 16; cannot be resumed with 8"),
        ({"group": 8}, "was made with group 4"),
        ({"cut": 2.0}, "was made with cut 1.0"),
        ({"set": ("expert.filter=false",)}, r"was made with set \[\]"),
        ({"variant": "paper_expert"}, "was made with variant None"),
    ):
        with pytest.raises(InputError, match=message):
            main(make_args(tmp_path, resume=True, **changes))
    weights = residual.last_checkpoint(tmp_path) / "training.safetensors"
    weights.write_bytes(weights.read_bytes()[:100])
    with pytest.raises(InputError, match=r"training\.safetensors: not a safetensors file"):
        main(make_args(tmp_path, resume=True))


def test_a_resumed_run_may_have_another_learning_rate(tmp_path: Path) -> None:
    main(make_args(tmp_path, steps=1, eval_every=0))
    main(make_args(tmp_path, steps=40, eval_every=0, learning_rate=0.0, resume=True))
    saved, still = (load_file(tmp_path / f"checkpoints/{n:06d}/policy.safetensors") for n in (1, 2))
    assert saved.keys() == still.keys()
    assert all(np.array_equal(saved[name], still[name]) for name in saved)


@pytest.mark.parametrize("part", ["explore", "update"])
def test_a_training_that_diverges_says_so_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    plain = getattr(residual, part)

    def spoil(model: Any, *arguments: Any) -> Any:
        for parameter in model.policy.parameters():
            parameter.data.fill_(1e38)
        return plain(model, *arguments)

    monkeypatch.setattr(residual, part, spoil)
    with pytest.raises(Diverged, match=r"training diverged after .*; try a smaller learning_rate than") as caught:
        main(make_args(tmp_path))
    assert str(caught.value).isprintable()
    monkeypatch.undo()
    monkeypatch.setattr(ground, "make_plan", plan_once)
    assert main(make_args(tmp_path, steps=1, resume=True))["steps"] >= 1


def test_an_expert_that_asks_for_nothing_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = Played(np.ones(4), np.ones(4, bool), np.zeros((0, 45)), np.zeros((0, 3)), np.zeros(0, int), 0.0)
    monkeypatch.setattr(residual, "play_episodes", lambda *arguments: empty)
    with pytest.raises(InputError, match="scenario 'throw_and_catch' in suite 'all': the expert awaits no correction"):
        main(make_args(tmp_path))


@pytest.mark.parametrize(
    "evaluation",
    [
        {},
        {"iterations": 8},
        SCORED | {"low": "8"},
        SCORED | {"iterations": None},
        SCORED | {"low": True},
        SCORED | {"sources": {}},
        SCORED | {"sources": [{"success_rate": 1.0}]},
    ],
)
def test_evaluations_that_cannot_be_compared_are_refused(evaluation: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"runs/00000008: key 'evaluations\.1(\.sources\.0)?': "):
        check_evaluations(Path("runs/00000008"), [SCORED, evaluation])


def test_every_argument_is_a_documented_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        tyro.cli(Args, args=["--help"])
    assert caught.value.code == 0
    shown = capsys.readouterr().out
    _, *options = dataclasses.fields(Args)  # the scenarios are positional
    for field in options:
        assert f"--{field.name.replace('_', '-')}" in shown
    given = tyro.cli(Args, args=["pong", "corridor", "--hidden", "4", "4", "--suite", "hard", "--suite", "short"])
    assert (given.scenarios, given.hidden, given.suite) == (("pong", "corridor"), (4, 4), ("hard", "short"))


def test_a_failure_counts_no_more_than_the_worst() -> None:
    np.testing.assert_array_equal(compute_scores(np.array([0.2, -0.1, -9.0]), 0.2, 2.0), [1.0, -0.5, -2.0])


def make_outcome(robustness: list[float]) -> Played:
    rho = np.array(robustness)
    return Played(rho, rho > 0, np.zeros((0, 45)), np.zeros((0, 3)), np.zeros(0, int), 0.25)


def test_a_gain_is_paired_and_a_constant_one_is_sure() -> None:
    expert = make_outcome(np.random.default_rng(0).normal(size=40).tolist())
    gain = compute_gain(make_outcome((expert.robustness + 0.125).tolist()), expert, 2.0, 0.5)
    assert gain.gain == pytest.approx(0.125, abs=1e-12)
    assert gain.error == pytest.approx(0.0, abs=1e-12)
    assert (gain.episodes, gain.filtered, gain.correction) == (40, 0.25, 0.0)
    still = compute_gain(expert, expert, 2.0, 0.5)
    assert (still.gain, still.error, still.mean) == (0.0, 0.0, 0.0)


def test_a_few_lost_worlds_do_not_hide_a_gain_nor_does_their_depth_count_in_the_mean() -> None:
    expert = make_outcome([0.5] * 40)
    gain = compute_gain(make_outcome([0.6] * 39 + [-1e6]), expert, 1.0, 0.5)
    assert gain.gain == pytest.approx(0.1)
    assert gain.mean == pytest.approx((39 * 0.1 - 1.5) / 40)


def test_the_sure_gain_is_below_the_true_one_in_nineteen_of_twenty_sets_of_seeds() -> None:
    rng, below = np.random.default_rng(0), 0
    expert = make_outcome([0.0] * 200)
    for _ in range(400):
        gain = compute_gain(make_outcome(rng.normal(0.1, 0.5, 200).tolist()), expert, 100.0, 0.5)
        below += summarise_pairs([gain])["low"] < 0.1
    assert below / 400 == pytest.approx(0.95, abs=0.025)


def test_sources_are_averaged_in_their_units() -> None:
    def make_gain(gain: float, error: float, scale: float) -> Gain:
        return Gain(100, 0.9, 0.8, 0.0, 0.0, gain, error, 0.0, scale, 0.5, 0.25)

    found = summarise_pairs([make_gain(0.1, 0.03, 1.0), make_gain(0.02, 0.01, 0.2)])
    assert found["gain"] == pytest.approx(0.6 * (0.1 + 0.1) / 2)
    error = 0.6 * np.hypot(0.03, 0.05) / 2
    assert found["low"] == pytest.approx(found["gain"] - QUANTILE * error)
    assert (found["success_rate"], found["filtered"]) == (0.9, 0.25)


def test_of_equal_robustness_the_failed_episode_is_worse_by_the_cost_of_a_failure() -> None:
    success = np.array([True, True, True, False, True, True, True, True])
    none = np.zeros((0, 1))
    played = Played(np.full(8, 0.2), success, none, none, np.zeros(0, int), 0.0)
    found = compare_episodes(Args(group=4), played, 0.2, 3.0)
    np.testing.assert_allclose(found, [1.0, 1.0, 1.0, -3.0, 0.0, 0.0, 0.0, 0.0])
    assert not compare_episodes(Args(group=4), played, 0.2, 0.0).any()


def test_a_failure_costs_more_while_success_is_lost_and_less_after_it() -> None:
    lost, kept = {**SCORED, "success_rate": 0.996}, SCORED
    args = Args(failure=0.5, failure_rise=4.0, failure_fall=0.5, highest_failure=6.0)
    assert find_failure_cost(args, []) == 0.5
    assert find_failure_cost(args, [kept, lost]) == 2.0
    assert find_failure_cost(args, [kept, lost, lost, lost, lost]) == 6.0
    assert find_failure_cost(args, [kept, lost, lost, kept]) == 3.0
    assert find_failure_cost(args, [kept, kept, kept]) == 0.5
    assert find_failure_cost(args, [lost, {**kept, "share": 0.5}]) == 2.0  # a share of a policy says nothing of it
    assert find_failure_cost(dataclasses.replace(args, failure=20.0), [kept, lost, kept]) == 20.0


@pytest.mark.parametrize(("scenario", "episodes"), [("pong", 512), ("dual_arm_grasp", 128)])
def test_an_iteration_has_the_episodes_of_its_domain_unless_told_otherwise(scenario: str, episodes: int) -> None:
    args = Args(scenarios=(scenario,), suite=("hard", "all", "nominal"), group=8)
    filled = ground.fill_args(args, ground.read_cases(args))
    assert filled.worlds == 24 * -(-episodes // 24)  # the next multiple of what three suites share
    assert filled.eval_every == -(-2560 // filled.worlds)
    assert filled.steps == (120_000 if scenario == "pong" else 60_000)
    told = dataclasses.replace(args, steps=7, worlds=48, eval_every=0)
    assert ground.fill_args(told, ground.read_cases(told)) == told
