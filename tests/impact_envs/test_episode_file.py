"""What an episode's file holds is what happened, in every format, and adds up to what the episode says."""

import csv
import itertools
import json

import numpy as np
import pytest

from impact_envs import InputError, load_scenario, parallel_env, rollout
from impact_envs.rollout import RandomPolicy, ZeroPolicy
from train.cli.main import main


@pytest.fixture(scope="module")
def episode():
    env = parallel_env(load_scenario("crew").suite("all"), max_cycles=400)
    return rollout(env, RandomPolicy(env), seed=1_000_003)


def read_csv(path):
    with path.open() as file:
        header, *rows = csv.reader(file)
    return {name: [row[k] for row in rows] for k, name in enumerate(header)}


def test_archive_holds_the_episode_bit_for_bit(episode, tmp_path):
    (path,) = episode.save(tmp_path / "flight.npz")
    with np.load(path) as archive:  # without pickles
        content = dict(archive)
    assert np.array_equal(content["times"], episode.times)
    for name, values in episode.signals.items():
        assert np.array_equal(content[name], values)
    for agent, actions in episode.actions.items():
        assert np.array_equal(content[f"{agent}.actions"], actions)
        assert np.array_equal(content[f"{agent}.rewards"], episode.rewards[agent])
    assert episode.impacts
    assert [(float(t), str(a)) for t, a in zip(content["impacts.time"], content["impacts.a"], strict=True)] == [
        (hit.time, hit.a) for hit in episode.impacts
    ]
    facts = json.loads(str(content["facts"]))
    assert (facts["robustness"], facts["success"], facts["seed"]) == (episode.robustness, False, episode.seed)


def test_tables_keep_every_digit(episode, tmp_path):
    flight, impacts, facts = episode.save(tmp_path / "flight.csv")
    assert [path.name for path in (flight, impacts, facts)] == ["flight.csv", "flight.impacts.csv", "flight.facts.json"]
    table, hits = read_csv(flight), read_csv(impacts)
    assert [float(x) for x in table["pop.x"]] == episode.signals["pop.x"].tolist()
    agent = next(iter(episode.actions))
    *actions, last = table[f"{agent}.action_0"]
    assert [float(u) for u in actions] == episode.actions[agent][:, 0].tolist()
    assert last == ""
    assert [float(x) for x in hits["impulse_x"]] == [hit.impulse[0] for hit in episode.impacts]
    assert json.loads(facts.read_text())["effort"] == episode.effort


def test_parquet_is_the_same_table(episode, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    flight, impacts, _ = episode.save(tmp_path / "flight.parquet")
    table = parquet.read_table(flight)
    assert table["pop.x"].to_pylist() == episode.signals["pop.x"].tolist()
    assert parquet.read_table(impacts)["speed"].to_pylist() == [hit.speed for hit in episode.impacts]


def test_impacts_of_no_impact_are_an_empty_table(tmp_path):
    env = parallel_env("throw_and_catch", max_cycles=3)
    _, impacts, _ = rollout(env, ZeroPolicy(env), seed=0).save(tmp_path / "still.csv")
    assert read_csv(impacts).keys() >= {"time", "a", "b", "speed"}
    assert not any(read_csv(impacts).values())


def test_impulses_explain_the_jumps_of_momentum(episode):
    """Saved impulses are the change of the object's momentum over the episode, where nothing else pushes it."""
    env = parallel_env("pong")
    flown = rollout(env, RandomPolicy(env), seed=1_000_001)
    mass = load_scenario("pong").objects["pop"].mass
    told = sum(np.array(hit.impulse) * ((hit.b == "pop") - (hit.a == "pop")) for hit in flown.impacts)
    told = told + sum(np.array(c.impulse) * ((c.b == "pop") - (c.a == "pop")) for c in flown.lasting_contacts)
    change = [mass * (flown.signals[f"pop.{v}"][-1] - flown.signals[f"pop.{v}"][0]) for v in ("vx", "vy")]
    assert np.allclose(told, change, atol=1e-9)


@pytest.mark.parametrize("path", ["flight.mat", "no/such/flight.npz"])
def test_bad_paths_are_refused_before_anything_is_played(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(("run", "throw_and_catch", "--policy", "zero", "--save", path)) == 2
    assert path in capsys.readouterr().err
    env = parallel_env("throw_and_catch", max_cycles=3)
    with pytest.raises(InputError, match=path):
        rollout(env, ZeroPolicy(env), seed=0).save(path)


def test_run_saves(tmp_path, capsys):
    path = tmp_path / "flight.npz"
    assert main(("run", "dual_arm_grasp", "--policy", "zero", "--save", str(path), "--json")) == 0
    with np.load(path) as archive:
        assert archive["arm_1.actions"].shape[1] == 3


def test_plan_samples_obey_newton(tmp_path, capsys):
    folder = tmp_path / "plan"
    assert main(("plan", "throw_and_catch", "--csv", str(folder), "--json")) == 0
    robot, mass = read_csv(folder / "snap.csv"), load_scenario("throw_and_catch").robots["snap"].mass
    v, force, t = (np.array([float(x) for x in robot[name]]) for name in ("vx", "force_x", "t"))
    hits = [float(time) for time in read_csv(folder / "plan.impacts.csv")["time"]]
    free = np.array([not any(a <= hit <= b for hit in hits) for a, b in itertools.pairwise(t)])
    mean = (force[1:] + force[:-1]) / 2
    assert np.allclose((mass * np.diff(v))[free], (mean * np.diff(t))[free], atol=2e-3)
    assert set(robot["heading"]) == {"0.0"}
