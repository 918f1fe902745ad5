"""Episodes by the single environment with the expert inside, as digests: what must not depend on the processor.

`python -m tests.frozen.processors CASES` prints them as JSON, and a digest of what the C library makes of sines. What
libraries look at a processor for can be taken from them by environment variables, see `ignore_instructions`.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys

import numpy as np

from tests.frozen.freeze import Case, label, play

# One scenario of each domain, in suites that draw everything.
CASES: list[Case] = [
    ("throw_and_catch", "hard", "expert", 1),
    ("throw_and_catch", "hard_v0", "random", 1),
    ("throw_and_catch", "all", "paper_expert", 2),
    ("dual_arm_grasp", "all", "expert", 1),
    ("dual_arm_grasp", "hard", "random", 1),
    ("floating_manipulator_thrusters", "hard", "expert", 1),
    ("floating_manipulator_thrusters", "all", "random", 2),
]
# Instructions that the C library's functions must do without; each version of glibc has names of its own.
NO_FMA = "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-FMA_Usable,-FMA4_Usable,-AVX2_Usable"
SINES = "sines of the C library"


def ignore_instructions(core: str) -> dict[str, str]:
    """Return the environment in which glibc, numpy and OpenBLAS take a processor for an old one.

    Args:
        core: OpenBLAS's name of it.
    """
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    return {"GLIBC_TUNABLES": NO_FMA, "NPY_DISABLE_CPU_FEATURES": " ".join(found), "OPENBLAS_CORETYPE": core}


def play_all(cases: list[Case]) -> dict[str, str]:
    """Return the digests of episodes, and of the C library's sines."""
    digests = {f"{case[0]} {label(case)}": play(case)["digest"] for case in cases}
    sines = repr([math.sin(0.001 * i) for i in range(20_000)])
    return digests | {SINES: hashlib.sha256(sines.encode()).hexdigest()}


if __name__ == "__main__":
    print(json.dumps(play_all([(*case,) for case in json.loads(sys.argv[1])])))
