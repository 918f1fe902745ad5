"""Scripts under benchmarks/ are no package: they are loaded by their path, and import their neighbours."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def load_benchmark() -> Iterator[Callable[[str], ModuleType]]:
    """Load benchmarks/NAME.py as a module called NAME_benchmark."""
    sys.path.insert(0, str(FOLDER))
    yield _load
    sys.path.remove(str(FOLDER))


def _load(name: str) -> ModuleType:
    spec = spec_from_file_location(f"{name}_benchmark", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
