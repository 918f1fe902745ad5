"""Episodes do not depend on which instructions of the processor the compiler may use."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from tests.frozen.targets import digest_all

# Processors without AVX, FMA and AVX-512: the least x86-64, and one of 2008 with SSE4.2. The C library is another
# matter: glibc takes other roundings of sin, cos, exp, ... where a processor has no FMA, whatever the compiler does.
TARGETS = ("generic", "nehalem")
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def own() -> dict:
    """Return the digests of code for the processor that there is."""
    found = digest_all()
    assert all(episodes["impacts"] > 0 for episodes in found.values())
    return found


@pytest.mark.slow
@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="the targets are x86-64 processors")
@pytest.mark.parametrize("target", TARGETS)
def test_episodes_have_the_same_bits_without_vector_extensions(target: str, own: dict, tmp_path: Path) -> None:
    compiled_for = {"NUMBA_CPU_NAME": target, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "tests.frozen.targets"]
    done = subprocess.run(
        command, env={**os.environ, **compiled_for}, cwd=ROOT, capture_output=True, text=True, timeout=3600
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert json.loads(done.stdout) == own
    assert any(tmp_path.rglob("*.nbi"))  # it was compiled for the target, not read from the usual cache
