"""Whole episodes with random corrections, by any expert."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Played = tuple[np.ndarray, list[np.ndarray], dict[str, int]]


def play(env: Any, experts: Sequence[Any], seed: int, steps: int) -> list[Played]:
    """Play an episode by the first expert, correcting at random whenever a correction is awaited; all see the same.

    Returns:
        Of every expert: actions, shape (T, size); features at every awaited correction; counted fallbacks.
    """
    rng = np.random.default_rng(seed)
    seen, _ = env.reset(seed=seed)
    actions: list[list[np.ndarray]] = [[] for _ in experts]
    features: list[list[np.ndarray]] = [[] for _ in experts]
    for expert in experts:
        expert.reset(seed)
    for _ in range(steps):
        chosen: list[dict[str, np.ndarray]] = []
        correction: np.ndarray | None = None
        for expert, acted, felt in zip(experts, actions, features, strict=True):
            expert.observe(seen)
            if expert.awaiting_correction:
                felt.append(expert.features())
                correction = rng.uniform(-1.0, 1.0, expert.correction_size) if correction is None else correction
                expert.correct(correction)
            chosen.append(expert.control())
            acted.append(np.concatenate(list(chosen[-1].values())))
        seen = env.step(chosen[0])[0]
        if not env.agents:
            break
    return [
        (np.array(acted), felt, dict(expert.diagnostics().fallbacks))
        for expert, acted, felt in zip(experts, actions, features, strict=True)
    ]
