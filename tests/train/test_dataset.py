"""Datasets of flights: what Minari reads back is what happens again when the actions are replayed."""

import json

import numpy as np
import pytest

from train.cli.main import main

minari = pytest.importorskip("minari", reason="minari is not installed")
pytest.importorskip("h5py", reason="h5py is not installed")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


def write(capsys, *arguments):
    code = main(("dataset", *arguments, "--json"))
    said = capsys.readouterr()
    return code, said.out and json.loads(said.out), said.err


def test_replayed_actions_are_the_same_episode_bit_for_bit(folder, capsys):
    code, told, err = write(capsys, "throw_and_catch", "--episodes", "2", "--suite", "all", "--seed", "7")
    assert code == 0, err
    assert told["success_rate"] == 1.0
    data = minari.load_dataset(told["dataset"])
    assert (data.total_episodes, data.total_steps) == (2, told["steps"])
    env = data.recover_environment()
    for number, episode in enumerate(data.iterate_episodes()):
        observation, _ = env.reset(seed=7 + number)
        assert np.array_equal(observation, episode.observations[0])
        for k, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, info = env.step(action)
            assert np.array_equal(observation, episode.observations[k + 1])
            assert reward == pytest.approx(episode.rewards[k], abs=1e-12)
            assert (terminated, truncated) == (episode.terminations[k], episode.truncations[k])
            assert info["is_success"] == episode.infos["is_success"][k + 1]
        assert truncated
    metadata = data.storage.metadata
    assert metadata["actions_of"] == {"snap": [0, 3], "crackle": [3, 6]}
    assert len(metadata["elements"]) == data.observation_space.shape[0]


def test_own_scenarios_and_other_domains_are_written(folder, capsys):
    own = folder / "mine.toml"
    from impact_envs.domain import find_scenarios

    text = next(path for path in find_scenarios() if path.stem == "pong").read_text()
    own.write_text(text)
    for scenario in (str(own), "dual_arm_grasp"):
        code, told, err = write(capsys, scenario, "--episodes", "1", "--policy", "zero")
        assert code == 0, err
        assert minari.load_dataset(told["dataset"]).total_episodes == 1


def test_a_dataset_is_not_overwritten_and_bad_names_are_refused(folder, capsys):
    arguments = ("throw_and_catch", "--episodes", "1", "--policy", "zero")
    assert write(capsys, *arguments)[0] == 0
    for more, word in (((), "is there already"), (("--name", "a b"), "a b"), (("--seed", "-1"), "-1")):
        code, _, err = write(capsys, *arguments, *more)
        assert code == 2
        assert len(err.strip().splitlines()) == 1
        assert word in err


def test_nothing_is_left_where_there_is_no_such_policy_or_name(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    (tmp_path / "file").touch()
    for arguments, word in (
        (("--policy", "nobody", "--out", str(tmp_path / "new")), "nobody"),
        (("--policy", "zero", "--name", "a/b/c", "--out", str(tmp_path / "new")), "a/b/c-v0"),
        (("--policy", "zero", "--out", str(tmp_path / "file")), "is a file"),
    ):
        code, _, err = write(capsys, "throw_and_catch", *arguments)
        assert code == 2
        assert len(err.strip().splitlines()) == 1
        assert word in err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
