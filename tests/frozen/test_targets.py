"""Episodes do not depend on which instructions of the processor the compiler may use."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.frozen.targets import EXPERT, FOLLOWED, play

# Processors without AVX, FMA and AVX-512: the least x86-64, and one of 2008 with SSE4.2. The C library is another
# matter: glibc rounds sin, cos, exp, ... otherwise where a processor has no FMA, whatever the compiler does. To compile
# for a target takes five to six minutes of one core.
TARGETS = ("generic", "nehalem")
ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="the targets are x86-64 processors")
@pytest.mark.parametrize("target", TARGETS)
def test_episodes_have_the_same_bits_without_vector_extensions(target: str, tmp_path: Path) -> None:
    own = {name: play(name) for name in (EXPERT, *FOLLOWED)}  # with all that this processor can do
    assert all(played.impacts > 0 for played in own.values())
    np.savez(tmp_path / "actions.npz", **{name: own[name].actions for name in FOLLOWED})
    compiled_for = {"NUMBA_CPU_NAME": target, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "tests.frozen.targets", str(tmp_path / "actions.npz")],
        env={**os.environ, **compiled_for},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=3600,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert json.loads(done.stdout) == {name: played.digest for name, played in own.items()}
    assert any(tmp_path.rglob("*.nbi"))  # it was compiled for the target, not read from the usual cache
