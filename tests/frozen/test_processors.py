"""Episodes do not depend on which instructions C library, numpy and OpenBLAS find in the processor."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from tests.frozen.processors import CASES, SINES, ignore_instructions, play_all

ROOT = Path(__file__).parents[2]

pytestmark = [
    pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="x86-64 processors of old"),
    pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can be told what it must do without"),
]


def play_on(core, cases, cache):
    """Return the digests of episodes in a process that takes the processor for an old one, with an empty cache."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.frozen.processors", json.dumps(cases)],
        env={**os.environ, **ignore_instructions(core), "IMPACT_ENVS_CACHE": str(cache)},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def test_episodes_have_the_same_bits_on_a_processor_of_2008(tmp_path, monkeypatch):
    monkeypatch.setenv("IMPACT_ENVS_CACHE", str(tmp_path / "own"))  # what is kept may have come from elsewhere
    own, old = play_all(CASES), play_on("Nehalem", CASES, tmp_path / "old")
    if own.pop(SINES) == old.pop(SINES):
        pytest.skip("this processor has no fused multiply-add, or glibc has no switch for it: nothing is taken from it")
    assert old == own
    assert len(list(tmp_path.glob("*/*.npz"))) == 2  # the arms' predictions
