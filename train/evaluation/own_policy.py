"""Policies whose code the user names: ``module:factory``, ``path/to/file.py:factory``, or a function handed over.

A factory is called with the scenario as the experts see it (what is true is not told) and returns a Policy, see
impact_envs.rollout; ``diagnostics`` and ``name`` may be missing.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import re
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from impact_envs.env import parallel_env
from impact_envs.errors import InputError, choices
from impact_envs.interface.agent_vectors import read_vectors
from impact_envs.interface.extras import find_extras
from impact_envs.rollout import Diagnostics, Policy
from impact_envs.scenario import Scenario
from planners.errors import PlanningError

Factory = Callable[[Scenario], Policy]


class OwnPolicy(str):
    """The label of a policy that comes with what makes it."""

    factory: Factory


class OwnCodeFailed(InputError):
    """The user's policy failed while it played.

    Attributes:
        trace: where in the user's code, as Python prints it; empty if that was not told.
    """

    trace = ""


class _Judged:
    """A user's policy with what the evaluation asks for besides actions.

    Args:
        label: what to call it.
        policy: with ``reset`` and ``act``.
        sizes: agent to the length of its actions.
    """

    def __init__(self, label: str, policy: Any, sizes: Mapping[str, int]) -> None:
        self.name, self._policy, self._sizes = label, policy, sizes
        self._seconds: list[float] = []

    def reset(self, seed: int) -> None:
        """Forget the last episode."""
        self._seconds = []
        with _blame_play(self.name, "reset"):
            self._policy.reset(seed)

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each agent's action.

        Raises:
            InputError: the policy failed, or returned what are no actions; the line names it.
        """
        start = time.perf_counter()
        with _blame_play(self.name, "act"):
            actions: dict[str, np.ndarray] = self._policy.act(observations)
        self._seconds.append(time.perf_counter() - start)
        read_vectors(actions, self._sizes, f"policy '{self.name}': action")
        return actions

    def diagnostics(self) -> Diagnostics:
        """Return what the policy says of its work; without its word, how long each control step took."""
        say = getattr(self._policy, "diagnostics", None)
        if say is None:
            return Diagnostics(solve_seconds=list(self._seconds))
        with _blame_play(self.name, "diagnostics"):
            said = say()
        if not isinstance(said, Diagnostics):
            raise InputError(f"policy '{self.name}': diagnostics returned {said!r:.60}; Diagnostics are needed")
        return said


def is_own(policy: str) -> bool:
    """Return whether a policy's name stands for code of the user."""
    named = re.fullmatch(r".+:[^\W\d]\w*", policy) is not None and not Path(policy).is_dir()
    return isinstance(policy, OwnPolicy) or named


def read_policies(policies: Sequence[str] | Mapping[str, Factory | str]) -> list[str]:
    """Return the labels of policies; a label of a function handed over comes with it.

    Args:
        policies: names; or label to factory, where a policy with a name of its own stands under that name.

    Raises:
        InputError: neither, or a label that is another policy's name.
    """
    if not isinstance(policies, Mapping):
        return [str(policy).rstrip("/") or str(policy) for policy in policies]
    labels: list[str] = []
    for label, factory in policies.items():
        if callable(factory):
            own = OwnPolicy(label)
            own.factory = factory
            labels.append(own)
        elif factory == label:
            labels.append(label)
        else:
            raise InputError(f"policies['{label}'] = {factory!r:.60}: a function is needed, or '{label}' itself")
    return labels


def make_own(policy: str, scenario: Scenario) -> Policy:
    """Make a policy by the user's code.

    Args:
        policy: for which is_own is true.
        scenario: the factory is told only what it believes.

    Raises:
        InputError: there is no such code, it fails, or what it returns does not act.
    """
    factory = policy.factory if isinstance(policy, OwnPolicy) else load_factory(policy)
    with _blame(policy):
        made: Any = factory(scenario.as_believed())
    lacking = [name for name in ("reset", "act") if not callable(getattr(made, name, None))]
    if lacking:
        raise InputError(f"policy '{policy}' made {made!r:.60}, which has no {' and no '.join(lacking)}")
    env = parallel_env(scenario)
    sizes = {agent: env.action_space(agent).shape[0] for agent in env.possible_agents}
    return _Judged(str(policy), made, sizes)


def announce(policies: Iterable[str]) -> None:
    """Say on standard error which files are run for policies that are named, then run them.

    Raises:
        InputError: there is no such file, or no such factory in it.
    """
    for policy in policies:
        if is_own(policy) and not isinstance(policy, OwnPolicy):
            print(f"policy {policy}: runs {find_code(policy)}", file=sys.stderr, flush=True)
            load_factory(policy)


def digest_code(policy: str) -> str:
    """Return the SHA-256 of the file that a policy's factory stands in.

    Raises:
        InputError: a function without a file, of which nobody can say later whether it was the same.
    """
    try:
        code = Path(inspect.getfile(policy.factory)) if isinstance(policy, OwnPolicy) else find_code(policy)
        return hashlib.sha256(code.read_bytes()).hexdigest()
    except (TypeError, OSError):
        raise InputError(f"policy '{policy}': its code is in no file; leave out `out`, which resumes by it") from None


def find_code(policy: str) -> Path:
    """Return the file that a named factory stands in; nothing is run.

    Raises:
        InputError: there is none.
    """
    origin = _find_spec(policy).origin
    if origin is None or not Path(origin).is_file():
        raise InputError(f"policy '{policy}': its module is no file")
    return Path(origin)


def load_factory(policy: str) -> Factory:
    """Run the file of a named factory, once in a process, and return the factory.

    Raises:
        InputError: there is no such file or factory, or the file fails.
    """
    spec, (place, _, name) = _find_spec(policy), policy.rpartition(":")
    with _working_folder(), _blame(policy):
        module = _run(spec) if place.endswith(".py") else importlib.import_module(spec.name)
    factory = getattr(module, name, None)
    if not callable(factory):
        known = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        raise InputError(f"policy '{policy}': {spec.origin} has no function '{name}'; {choices(name, known)}")
    return factory


def _run(spec: ModuleSpec) -> ModuleType:
    if spec.name in sys.modules:
        return sys.modules[spec.name]
    module = importlib.util.module_from_spec(spec)
    assert spec.loader is not None
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[spec.name]
        raise
    return module


def _find_spec(policy: str) -> ModuleSpec:
    """Return where a module is; its packages are looked up one by one, because importing one would run it."""
    place = policy.rpartition(":")[0]
    if place.endswith(".py"):
        path = Path(place).resolve()
        digest = hashlib.sha256(str(path).encode()).hexdigest()[:16]
        spec = importlib.util.spec_from_file_location(f"own_{path.stem}_{digest}", path)
        if spec is None or not path.is_file():
            raise InputError(f"policy '{policy}': no such file {place}")
        return spec
    name, folders = "", None
    with _working_folder():
        for word in place.split("."):
            name = f"{name}.{word}" if name else word
            spec = importlib.util.find_spec(name) if folders is None else PathFinder.find_spec(name, folders)
            if spec is None:
                raise InputError(
                    f"policy '{policy}': no module '{name}' in the working folder or among the installed packages; "
                    "path/to/file.py:NAME names a file"
                )
            folders = spec.submodule_search_locations
    assert spec is not None
    return spec


@contextmanager
def _blame(policy: str) -> Iterator[None]:
    """Turn what the user's code raises into one line with the place; the exception itself is its cause."""
    try:
        yield
    except (InputError, PlanningError):
        raise
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and find_extras(error.name or ""):
            raise  # the command says what to install
        if isinstance(error, SyntaxError):
            place, says = f"{error.filename}, line {error.lineno}", error.msg
        else:
            last = traceback.extract_tb(error.__traceback__)[-1]
            place, says = f"{last.filename}, line {last.lineno}", " ".join(str(error).split())
        raise InputError(f"policy '{policy}': {type(error).__name__} in {place}: {says}") from error


@contextmanager
def _blame_play(policy: str, method: str) -> Iterator[None]:
    """Name the policy and its method in what the user's code raises while it plays; the trace comes with it."""
    try:
        yield
    except (InputError, PlanningError):
        raise
    except Exception as error:
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename != __file__]
        place = f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else "no file"
        says = " ".join(str(error).split())
        failed = OwnCodeFailed(f"policy '{policy}': {method} raised {type(error).__name__} in {place}: {says}")
        text = [*traceback.format_list(frames), *traceback.format_exception_only(error)]
        failed.trace = "".join(["Traceback (most recent call last):\n", *text])
        raise failed from error


@contextmanager
def _working_folder() -> Iterator[None]:
    """Look for modules in the working folder too, after all other places: no name of a package changes its meaning."""
    folder = str(Path.cwd())
    known = folder in sys.path or "" in sys.path
    if not known:
        sys.path.append(folder)
    try:
        yield
    finally:
        if not known:
            sys.path.remove(folder)
