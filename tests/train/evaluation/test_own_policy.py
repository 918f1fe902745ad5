"""Policies of the user: which code is run, that no other is, and that it is judged as every policy is."""

import pickle
import re
import sys
import tempfile
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from impact_envs import InputError, JointPolicy, SharedPolicy, gym_id, load_scenario, parallel_env, rollout
from impact_envs.rollout import ZeroPolicy
from train.cli.main import main
from train.evaluation.evaluate import evaluate
from train.evaluation.own_policy import OwnCodeFailed, announce, find_code, is_own, read_policies

PAGE = Path(__file__).parents[3] / "docs" / "own_policy.md"
IDLE = """
import numpy as np
from pathlib import Path

Path("ran").touch()


class Idle:
    def __init__(self, scenario):
        self.actions = {name: np.zeros(3) for name in scenario.agents}

    def reset(self, seed):
        pass

    def act(self, observations):
        return self.actions


def nothing(scenario):
    return 7
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with a module of the user; what is imported from it is forgotten."""
    monkeypatch.chdir(tmp_path)
    before = set(sys.modules)
    (tmp_path / "package").mkdir()
    for place in ("idle_robot.py", "package/__init__.py", "package/deep.py"):
        (tmp_path / place).write_text(IDLE)
    yield tmp_path
    for name in set(sys.modules) - before:
        if name.startswith(("idle_robot", "package", "own_", "mine", "ppo")):
            del sys.modules[name]


def test_names_of_code_are_told_from_names_of_policies(folder):
    assert is_own("idle_robot:Idle")
    assert is_own("some/where/idle_robot.py:Idle")
    assert not is_own("expert")
    assert not is_own("runs/residual")
    (folder / "a:b").mkdir()
    assert not is_own("a:b")


def test_code_is_found_without_running_it(folder):
    for policy, file in (("idle_robot:Idle", "idle_robot.py"), ("package.deep:Idle", "package/deep.py")):
        assert find_code(policy) == folder / file
    assert find_code("package/deep.py:Idle") == folder / "package/deep.py"
    assert not (folder / "ran").exists()


def test_the_file_is_named_before_it_runs(folder, capsys):
    (folder / "idle_robot.py").write_text("import sys\nprint('I run', file=sys.stderr)\n" + IDLE)
    announce(["expert", "idle_robot:Idle"])
    said = capsys.readouterr().err.splitlines()
    assert said == [f"policy idle_robot:Idle: runs {folder / 'idle_robot.py'}", "I run"]


def test_only_what_is_named_runs(folder, capsys):
    assert main(("run", "throw_and_catch", "--policy", "zero", "--json")) == 0
    assert not (folder / "ran").exists()


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        ("idle_rbot:Idle", ("idle_rbot", "no module", "file.py")),
        ("package.dep:Idle", ("package.dep", "no module")),
        ("idle_robot:Idel", ("no function 'Idel'", "did you mean 'Idle'", "nothing")),
        ("no/such.py:Idle", ("no such file no/such.py",)),
        ("idle_robot:nothing", ("made 7", "no reset and no act")),
    ],
)
def test_code_that_is_not_there_is_one_line(folder, capsys, policy, words):
    assert main(("run", "throw_and_catch", "--policy", policy)) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert all(word in line for word in words), line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def make(:", ("SyntaxError in", "mine.py, line 1: invalid syntax")),
        ("\nimport no_such_thing", ("ModuleNotFoundError in", "mine.py, line 2: No module named 'no_such_thing'")),
        ("def make(scenario):\n    return 1 / 0", ("ZeroDivisionError in", "mine.py, line 2: division by zero")),
        ("def make():\n    pass", ("TypeError in", "takes 0 positional arguments but 1 was given")),
    ],
)
def test_code_that_fails_is_named_with_its_line(folder, capsys, text, words):
    (folder / "mine.py").write_text(text)
    assert main(("run", "throw_and_catch", "--policy", "mine.py:make", "--save", "a.csv")) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 2  # which file runs, and what came of it
    assert all(word in said[1] for word in words), said
    assert not (folder / "a.csv").exists()


FRAGILE = """
import numpy as np
from impact_envs.rollout import Diagnostics

class Fragile:
    def __init__(self, scenario):
        self.agents = scenario.agents

    def reset(self, seed):
        {reset}

    def act(self, observations):
        return {{agent: self.push(observations[agent]) for agent in self.agents}}

    def push(self, seen):
        return {push}

    def diagnostics(self):
        {diagnostics}
"""
SOUND = {
    "reset": "pass",
    "push": "np.zeros(3)",
    "diagnostics": "return Diagnostics()",
}


@pytest.mark.parametrize(
    ("method", "broken", "line"),
    [
        ("reset", {"reset": "self.missing"}, 10),
        ("act", {"push": "seen[:3] @ np.ones(4)"}, 16),
        ("diagnostics", {"diagnostics": "raise RuntimeError('of mine')"}, 19),
    ],
)
def test_code_that_fails_while_it_plays_is_named_and_leaves_nothing(folder, capsys, method, broken, line):
    (folder / "fragile.py").write_text(FRAGILE.format(**SOUND | broken))
    words = ("--policies", "fragile.py:Fragile", "--episodes", "2", "--out", "o")
    assert main(("evaluate", "throw_and_catch", *words)) == 2
    said = capsys.readouterr().err
    last = said.strip().splitlines()[-1]
    assert last.startswith(f"impact: policy 'fragile.py:Fragile': {method} raised "), last
    assert f"fragile.py, line {line}: " in last
    trace = said.rpartition("Traceback (most recent call last):")[2]
    assert f'fragile.py", line {line}' in trace
    assert "own_policy.py" not in trace  # of the user's code alone
    assert not (folder / "o").exists()


def test_a_worker_sends_the_trace_too():
    failed = OwnCodeFailed("policy 'mine': act raised KeyError")
    failed.trace = "Traceback"
    sent = pickle.loads(pickle.dumps(failed))
    assert (str(sent), sent.trace) == (str(failed), failed.trace)


def test_what_are_no_diagnostics_is_named(folder, capsys):
    (folder / "fragile.py").write_text(FRAGILE.format(**SOUND | {"diagnostics": "return 7"}))
    assert main(("run", "throw_and_catch", "--policy", "fragile.py:Fragile")) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last == "impact: policy 'fragile.py:Fragile': diagnostics returned 7; Diagnostics are needed"


@pytest.mark.parametrize(
    ("push", "says"),
    [
        ("np.zeros(2)", "action of snap = [0.0, 0.0]: 3 finite numbers are needed"),
        ("np.full(3, np.nan)", "action of snap = [nan, nan, nan]: 3 finite numbers are needed"),
        ("'left'", "action of snap = 'left': 3 finite numbers are needed"),
    ],
)
def test_what_are_no_actions_is_blamed_on_the_policy(folder, capsys, push, says):
    (folder / "fragile.py").write_text(FRAGILE.format(**SOUND | {"push": push}))
    assert main(("run", "throw_and_catch", "--policy", "fragile.py:Fragile")) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last == f"impact: policy 'fragile.py:Fragile': {says}"


def test_agents_that_are_left_out_are_blamed_on_the_policy(folder):
    class Silent:
        def reset(self, seed):
            pass

        def act(self, observations):
            return {}

    with pytest.raises(InputError, match="policy 'mine': actions must name every robot once, not so: crackle, snap"):
        evaluate(["throw_and_catch"], {"mine": lambda scenario: Silent()}, episodes=1, progress=False)


def test_own_policy_is_judged_as_its_equal_is(folder):
    labels = {"zero": "zero", "mine": lambda scenario: ZeroPolicy(parallel_env(scenario))}
    result = evaluate(["throw_and_catch"], labels, episodes=2, progress=False)
    zero, mine = (result.episodes[result.episodes.policy == label] for label in labels)
    assert list(zero.robustness) == list(mine.robustness)
    assert [(pair["a"], pair["b"]) for pair in result.paired] in ([("zero", "mine")], [("mine", "zero")])


def test_own_policy_is_told_beliefs_only(folder):
    seen = []

    def make(scenario):
        seen.append(scenario)
        return ZeroPolicy(parallel_env(scenario))

    scenario = load_scenario("throw_and_catch").suite("all")
    evaluate([scenario], {"mine": make}, episodes=1, progress=False)
    assert seen == [scenario.as_believed()]
    assert seen[0].true != scenario.true


def test_a_function_without_a_file_cannot_be_resumed(folder):
    namespace = {}
    exec("def make(scenario): ...", namespace)
    with pytest.raises(InputError, match="leave out `out`"):
        evaluate(["throw_and_catch"], {"mine": namespace["make"]}, episodes=1, out="o", progress=False)


def test_a_changed_file_is_another_policy(folder):
    def judge():
        return evaluate(["throw_and_catch"], ["idle_robot.py:Idle"], episodes=1, out="o", progress=False)

    assert judge().episodes_played == 1
    assert judge().episodes_played == 0
    (folder / "idle_robot.py").write_text(IDLE + "\n# changed\n")
    with pytest.raises(InputError, match="holds episodes of another"):
        judge()


def test_what_cannot_be_sent_to_workers_is_refused():
    with pytest.raises(InputError, match="cannot be sent to other processes"):
        evaluate(["throw_and_catch"], {"mine": lambda scenario: None}, workers=2, progress=False)
    with pytest.raises(InputError, match=r"policies\['mine'\]"):
        read_policies({"mine": "expert"})


def test_workers_find_the_same_code(folder):
    names = ["idle_robot:Idle", "package/deep.py:Idle"]
    alone, shared = (
        evaluate(["throw_and_catch"], names, episodes=2, workers=workers, progress=False) for workers in (1, 2)
    )
    assert list(alone.episodes.robustness) == list(shared.episodes.robustness)


@pytest.mark.parametrize("name", ["crew", "floating_manipulator_thrusters", "dual_arm_grasp"])
def test_joint_policy_sees_and_does_what_gymnasiums_door_does(name):
    rng, seen = np.random.default_rng(0), []
    env = gymnasium.make(gym_id(name), max_cycles=20)
    actions = rng.uniform(-1, 1, (20, *env.action_space.shape))

    def act(observation):
        seen.append(observation)
        return actions[len(seen) - 1]

    first, _ = env.reset(seed=5)
    expected = [first, *(env.step(action)[0] for action in actions)]
    rollout(parallel_env(name, max_cycles=20), JointPolicy(act, name), 5)
    assert np.array_equal(seen, expected[:-1])


def test_shared_policy_gives_every_agent_its_own():
    policy = SharedPolicy(lambda observation: observation[:3] / 10)
    policy.reset(0)
    observations = {"a": np.arange(5.0), "b": np.ones(5)}
    actions = policy.act(observations)
    assert {name: action.tolist() for name, action in actions.items()} == {"a": [0, 0.1, 0.2], "b": [0.1] * 3}
    assert len(policy.diagnostics().solve_seconds) == 1


def test_the_page_does_what_it_says(folder, capsys, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(folder))  # where SB3's logger makes a folder
    blocks = re.findall(r"```(\w*)(?: title=(\S+))?\n(.*?)```", PAGE.read_text(), re.S)
    commands = []
    sys.path.insert(0, str(folder))
    try:
        for _, title, text in (block for block in blocks if block[1]):
            (folder / title).write_text(text)
        for language, title, text in blocks:
            if language == "python" and not title:
                exec(compile(text, str(PAGE), "exec"), {})
            elif not language:
                commands += text.strip().splitlines()
                for line in text.strip().splitlines():
                    assert main(line.split()[1:]) == 0, line
    finally:
        sys.path.remove(str(folder))
    assert len(commands) == 3
    assert "ppo:make" in capsys.readouterr().out


def test_a_torch_network_acts(folder):
    import torch

    text = re.search(r"```python title=network.py\n(.*?)```", PAGE.read_text(), re.S)[1]
    (folder / "network.py").write_text(text)
    size = parallel_env("throw_and_catch").observation_space("snap").shape[0]
    torch.jit.script(torch.nn.Linear(size, 3)).save("network.pt")
    assert main(("run", "throw_and_catch", "--policy", "network.py:make", "--json")) == 0
