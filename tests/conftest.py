"""How a parallel run of all tests begins."""

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Compile before the workers start; a run of some tests compiles what they call."""
    workers = config.getoption("numprocesses", None)
    if workers and config.args_source is pytest.Config.ArgsSource.TESTPATHS and not config.option.collectonly:
        from tests.compilation import compile_what_is_missing

        compile_what_is_missing(workers)
