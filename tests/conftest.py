"""How a parallel run of all tests begins."""

import os

import pytest

# Before NumPy and torch are imported: each worker of a parallel run has one core, and a library that starts a thread
# for every core spends most of its time on waiting for the others. What tests start inherits it.
os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_configure(config: pytest.Config) -> None:
    """Compile before the workers start; a run of some tests compiles what they call."""
    workers = config.getoption("numprocesses", None)
    if workers and config.args_source is pytest.Config.ArgsSource.TESTPATHS and not config.option.collectonly:
        from tests.compilation import compile_what_is_missing

        compile_what_is_missing(workers)
