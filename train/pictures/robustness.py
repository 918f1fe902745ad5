"""Robustness over time, the same in every picture of an episode."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from impact_envs.picture import drawing
from impact_envs.picture.unit import find_unit, label_robustness, write_robustness
from impact_envs.rollout import Episode
from train.pictures.color import hex_color

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ABOVE = 1.15  # of the panel's upper end over the largest value shown


def draw_robustness(axes: Axes, scenario: Any, episode: Episode, promised: float = 0.0) -> None:
    """Draw the interval of robustness still possible, and what was reached.

    Args:
        axes: to draw in; its label says the unit.
        scenario: where.
        episode: what happened.
        promised: by a plan, or 0; stays in sight.
    """
    lower, upper = episode.robustness_bounds.T
    color = hex_color(drawing.SATISFIED if episode.success else drawing.VIOLATED)
    axes.fill_between(episode.times, lower, upper, fc=color, alpha=0.15, lw=0, zorder=1, label="still possible")
    for values in (lower, upper):
        axes.plot(episode.times, values, color=color, lw=1.2, zorder=3)
    axes.axhline(0.0, color=hex_color(drawing.INK), lw=0.8, zorder=2)
    axes.plot(episode.times[-1], episode.robustness, "o", color=color, ms=6, clip_on=False, zorder=6, label="reached")
    # The lower bound is far below until late; a scale that shows it all shows nothing of the rest.
    least = 0.1 if promised else 1e-3
    top = max(float(upper.max()), promised, abs(episode.robustness) if episode.success else 0.0, least)
    axes.set_ylim(min(-top, 1.3 * episode.robustness), ABOVE * top)
    axes.set_ylabel(label_robustness(scenario.specification))


def write_verdict(scenario: Any, episode: Episode) -> str:
    """Return who did what, where, and how it ended, as the title of a picture."""
    rho = write_robustness(episode.robustness, episode.robustness, find_unit(scenario.specification))
    verdict = "satisfied" if episode.success else "violated"
    return f"{episode.scenario}, {episode.policy}, seed {episode.seed}: {rho}, {verdict}"
