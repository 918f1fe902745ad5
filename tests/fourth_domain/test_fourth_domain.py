"""A new domain is a folder in each layer and nothing else: every door takes one that lies outside the packages."""

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import impact_envs
import planners
from agents.residual import ResidualEnv
from impact_envs import JointEnv, list_scenarios, load_scenario, parallel_env, rollout, vector_env
from impact_envs.domain import list_domains
from impact_envs.errors import InputError
from impact_envs.rollout import RandomPolicy, ZeroPolicy
from planners import has_planner, list_options, list_variants, make_expert, make_plan
from train.cli.main import main
from train.evaluation.evaluate import evaluate

HERE = Path(__file__).parent
FILE = HERE / "impact_envs" / "point_mass" / "scenarios" / "slide.toml"


@pytest.fixture(scope="module", autouse=True)
def point_mass() -> Iterator[None]:
    """Let both layers find the folders beside this file."""
    roots = {impact_envs: HERE / "impact_envs", planners: HERE / "planners"}
    for package, root in roots.items():
        package.__path__.append(str(root))
    importlib.invalidate_caches()
    yield
    for package, root in roots.items():
        package.__path__.remove(str(root))
        for name in [name for name in sys.modules if name.startswith(f"{package.__name__}.point_mass")]:
            del sys.modules[name]
        delattr(package, "point_mass")
    assert "point_mass" not in list_domains()


def test_it_is_found_by_its_folder():
    assert list_domains() == ("dual_arm", "floating_manipulator", "free_flyer", "point_mass")
    assert "slide" in list_scenarios()
    scenario = load_scenario("slide")
    assert scenario == load_scenario(FILE)
    assert scenario.domain == "point_mass"
    assert not has_planner(scenario)
    assert not list_variants(scenario)
    assert not list_options(scenario)


def test_only_the_expert_satisfies_the_formula():
    scenario = load_scenario("slide")
    env = parallel_env(scenario)
    policies = (make_expert(scenario), ZeroPolicy(env), RandomPolicy(env))
    episodes = {policy.name: rollout(env, policy, 3) for policy in policies}
    assert {name: episode.success for name, episode in episodes.items()} == {
        "expert": True,
        "zero": False,
        "random": False,
    }
    assert episodes["expert"].robustness == pytest.approx(0.1, abs=0.01)
    assert episodes["expert"].robustness_bounds[-1] == pytest.approx(2 * [episodes["expert"].robustness])
    assert episodes["zero"].effort == 0.0


def test_walls_take_away_what_the_restitution_says():
    scenario = load_scenario("slide").suite("dull")
    env = parallel_env(scenario)
    env.reset(seed=5)
    impacts = []
    while env.agents and not impacts:
        speed = -env.model.state()[0, 2]
        before = env.model.kinetic_energy()
        env.step({"puck": np.array([-1.0, 0.0])})
        impacts = env.impacts
    (hit,) = impacts
    e = env.model.physics.restitution
    assert 0.2 <= e <= 0.5
    assert (hit.a, hit.b, hit.normal) == ("left", "puck", (1.0, 0.0))
    assert hit.speed > speed
    assert hit.impulse[0] == pytest.approx(scenario.mass * (1 + e) * hit.speed)
    assert env.model.kinetic_energy() == pytest.approx(scenario.mass * (e * hit.speed) ** 2 / 2)
    assert env.model.kinetic_energy() < before


def test_it_is_evaluated_like_the_others(tmp_path):
    result = evaluate(
        ["slide"], ("expert", "zero"), episodes=2, suites=("nominal", "dull"), out=tmp_path, progress=False
    )
    assert {(row["suite"], row["policy"]): row["success_rate"] for row in result.rows} == {
        (suite, policy): float(policy == "expert") for suite in ("nominal", "dull") for policy in ("expert", "zero")
    }
    replays = [json.loads(path.read_text()) for path in (tmp_path / "replays").iterdir()]
    assert {replay["domain"] for replay in replays} == {"point_mass"}
    assert len(replays) == 4


@pytest.mark.parametrize("scenario", [str(FILE), "slide"])
def test_the_command_line_runs_it(capsys, tmp_path, scenario):
    picture = tmp_path / "last.png"
    arguments = ("run", scenario, "--set", "true.restitution=0.5", "--render", str(picture), "--json")
    assert main(arguments) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["success"]
    assert (shown["scenario"], shown["policy"]) == ("slide", "expert")
    assert picture.stat().st_size > 0


def test_gymnasium_sees_it_without_registration():
    env = JointEnv("slide")
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert env.step(np.zeros(2))[0] == pytest.approx([0.2, 0.2, 0.0, 0.0, 0.01])


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda: make_plan("slide"), "domain 'point_mass', whose expert follows no plan"),
        (lambda: make_expert("slide", variant="paper"), "domain 'point_mass' has no variant 'paper'"),
        (lambda: make_expert("slide", options={"damping": 1.0}), "the expert of domain 'point_mass' has no options"),
        (lambda: ResidualEnv("slide"), "the expert of domain 'point_mass' takes no corrections"),
        (lambda: vector_env("slide", num_envs=2), "scenario 'slide'.*SyncVectorEnv runs every scenario"),
        (lambda: load_scenario("slide").override({"masss": 1.0}), "unknown key 'masss'; did you mean 'mass'"),
    ],
)
def test_what_it_does_not_bring_is_said_in_one_line(use, message):
    with pytest.raises(InputError, match=message) as caught:
        use()
    assert "\n" not in str(caught.value)
