"""Episodes do not depend on which instructions of the processor the compiler may use."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.frozen.test_frozen import SAME_MACHINE

# Processors without AVX, FMA and AVX-512: the least x86-64, and one of 2008 with SSE4.2.
TARGETS = ("generic", "nehalem")
# One scenario of each domain: compiling all of them anew takes minutes.
SCENARIOS = "throw_and_catch or floating_manipulator_thrusters or dual_arm_grasp"


@pytest.mark.slow
@pytest.mark.skipif(not SAME_MACHINE, reason="episodes were frozen on another machine: bits are not compared")
@pytest.mark.parametrize("target", TARGETS)
def test_episodes_have_the_same_bits_without_vector_extensions(target: str, tmp_path: Path) -> None:
    compiled_for = {"NUMBA_CPU_NAME": target, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    chosen = [str(Path(__file__).with_name("test_frozen.py")), "-k", f"episode_is and ({SCENARIOS})"]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *chosen]
    done = subprocess.run(command, env={**os.environ, **compiled_for}, capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stdout[-2000:]
    assert any(tmp_path.rglob("*.nbi"))  # it was compiled for the target, not read from the usual cache
