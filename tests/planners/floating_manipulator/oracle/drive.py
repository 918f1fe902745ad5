"""Whole episodes with random corrections, by any expert."""

from __future__ import annotations

from typing import Any

import numpy as np


def play(env: Any, expert: Any, seed: int, steps: int) -> tuple[np.ndarray, list[np.ndarray], dict[str, int]]:
    """Play an episode, correcting at random whenever a correction is awaited.

    Returns:
        Actions, shape (T, size); features at every awaited correction; counted fallbacks.
    """
    rng = np.random.default_rng(seed)
    seen, _ = env.reset(seed=seed)
    expert.reset(seed)
    actions, features = [], []
    for _ in range(steps):
        expert.observe(seen)
        if expert.awaiting_correction:
            features.append(expert.features())
            expert.correct(rng.uniform(-1.0, 1.0, expert.correction_size))
        chosen = expert.control()
        actions.append(np.concatenate(list(chosen.values())))
        seen = env.step(chosen)[0]
        if not env.agents:
            break
    return np.array(actions), features, dict(expert.diagnostics().fallbacks)
