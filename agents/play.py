"""Whole episodes of many worlds, whose corrections one function chooses: for learning and for judging alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from agents.residual_vector import ResidualVectorEnv


@dataclass(frozen=True)
class Played:
    """Episodes, E of them, with n corrections in all.

    Attributes:
        robustness: of each episode, shape (E,) [m].
        success: of each, shape (E,) bool.
        features: at each correction, shape (n, F).
        corrections: as they were chosen, shape (n, C); beyond [-1, 1] they are clipped.
        episode: that each correction was given in, shape (n,).
        filtered: share of the corrections that the expert did not take whole.
    """

    robustness: np.ndarray
    success: np.ndarray
    features: np.ndarray
    corrections: np.ndarray
    episode: np.ndarray
    filtered: float


def play_episodes(
    worlds: ResidualVectorEnv,
    seeds: Sequence[int] | np.ndarray,
    choose: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Played:
    """Play an episode of each seed.

    Args:
        worlds: to play them in, so many at a time; their episodes are given up.
        seeds: of the episodes, shape (E,).
        choose: takes features, shape (m, F), and returns corrections, shape (m, C); None: zeros, the expert alone.

    Returns:
        The episodes in the order of the seeds, corrections in the order of time, chunk by chunk of worlds.
    """
    if choose is None:
        return play_each(worlds, seeds, lambda features, _: np.zeros((len(features), worlds.experts.correction_size)))
    return play_each(worlds, seeds, lambda features, _: choose(features))


def play_each(
    worlds: ResidualVectorEnv,
    seeds: Sequence[int] | np.ndarray,
    choose: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Played:
    """Play an episode of each seed, each with a policy of its own.

    Args:
        worlds, seeds: as `play_episodes` takes them.
        choose: takes features, shape (m, F), and the places of their episodes among the seeds, shape (m,); returns
            corrections, shape (m, C).

    Returns:
        As `play_episodes`.
    """
    seeds, size = np.asarray(seeds, np.int64), worlds.num_envs
    starts = range(0, len(seeds), size)
    chunks = [_play_chunk(worlds, seeds[start : start + size], start, choose) for start in starts]
    counts = [len(chunk.episode) for chunk in chunks]
    return Played(
        np.concatenate([chunk.robustness for chunk in chunks]),
        np.concatenate([chunk.success for chunk in chunks]),
        np.concatenate([chunk.features for chunk in chunks]),
        np.concatenate([chunk.corrections for chunk in chunks]),
        np.concatenate([chunk.episode + start for chunk, start in zip(chunks, starts, strict=True)]),
        float(np.dot([chunk.filtered for chunk in chunks], counts) / max(sum(counts), 1)),
    )


def _play_chunk(
    worlds: ResidualVectorEnv, seeds: np.ndarray, start: int, choose: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> Played:
    """Play one episode in each of the first worlds; start is the place of the first seed."""
    decisions, count = worlds.decisions, worlds.num_envs
    size, width = worlds.experts.correction_size, worlds.experts.feature_size
    used = np.arange(count) < len(seeds)
    features, corrections, episode = [np.zeros((0, width))], [np.zeros((0, size))], [np.zeros(0, np.int64)]
    decisions.start(used, seeds)
    while (awaiting := decisions.awaiting_correction & used).any():
        chosen = np.flatnonzero(awaiting)
        seen = worlds.experts.features()[chosen]
        answer = np.array(choose(seen, start + chosen), float)
        answer[~np.isfinite(answer).all(axis=1)] = 0.0  # no answer counts as zero, as in ResidualPolicy
        given = np.zeros((count, size))
        given[chosen] = np.clip(answer, -1.0, 1.0)
        decisions.answer(awaiting, given)
        features.append(seen)
        corrections.append(answer)
        episode.append(chosen)
    robustness, success = decisions.judge()
    filtered = getattr(worlds.experts, "counts", {}).get("filtered", np.zeros(count))[used].sum()
    total = sum(map(len, episode))
    return Played(
        robustness[used].copy(),
        success[used].copy(),
        np.concatenate(features),
        np.concatenate(corrections),
        np.concatenate(episode),
        float(filtered) / max(total, 1),
    )
