"""How compiled functions are cached, announced and compiled for other targets."""

import logging

from impact_envs import compiled as module
from impact_envs.compiled import announce, compiled, inlined, is_compiled, list_calls, retarget

OFFSET = 3.0


@inlined
def double(x: float) -> float:
    return 2 * x


@compiled
def shifted(x: float) -> float:
    return double(x) + OFFSET


def test_retarget_runs_the_same_source_and_all_it_calls():
    names = []

    def plain(function):
        names.append(function.__name__)
        return function

    uncompiled = retarget(shifted, plain)
    assert names == ["double", "shifted"]
    assert uncompiled(4.0) == shifted(4.0) == 11.0
    assert uncompiled.__globals__["double"] is not double


def test_a_change_in_an_imported_file_compiles_anew(tmp_path, monkeypatch):
    """numba alone looks at the function's own file and would go on with the old callee."""
    monkeypatch.setattr(module, "ROOT", tmp_path)
    package = tmp_path / "pack"
    package.mkdir()
    (package / "inner.py").write_text("FACTOR = 2\n")
    (package / "outer.py").write_text("from pack.inner import FACTOR\n")
    module._read_sources.cache_clear()
    before = module._read_sources(package / "outer.py")
    module._read_sources.cache_clear()
    assert module._read_sources(package / "outer.py") == before
    (package / "inner.py").write_text("FACTOR = 3\n")
    module._read_sources.cache_clear()
    assert module._read_sources(package / "outer.py") != before
    module._read_sources.cache_clear()


def test_the_stamp_reaches_numba():
    stamp = shifted._cache._cache_file._source_stamp
    assert isinstance(stamp, bytes)
    assert len(stamp) == 32


FRESH = """
from impact_envs.compiled import compiled


@compiled
def inner(x):
    return 2 * x


@compiled
def outer(x):
    return inner(x) + 1
"""


def test_compilation_is_announced_once_and_counted(tmp_path, monkeypatch, caplog):
    (tmp_path / "fresh.py").write_text(FRESH)
    monkeypatch.syspath_prepend(tmp_path)
    from fresh import outer

    assert not is_compiled(outer)
    assert {function.__name__ for function in list_calls(outer)} == {"inner", "outer"}
    with caplog.at_level(logging.WARNING):
        announce(outer)
        announce(outer)
        assert outer(1) == 3
        assert outer(1.0) == 3.0
    first, last = [record.message for record in caplog.records]
    assert first.startswith("compiling 2 functions for this machine")
    assert last.startswith("compiled 2 of 2 functions in ")
    assert is_compiled(outer)
