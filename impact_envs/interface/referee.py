"""What the formula says of one world while it runs: interval of robustness, team's reward, verdict at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from impact_envs.flight import Forecast
from impact_envs.interface.failure import SimulationFailed, TooManyEvents
from impact_envs.reward import compute_progress_reward, compute_reward, compute_team_reward, find_rates
from impact_envs.stl import Monitor
from impact_envs.stl.verdict import compute_outcome, judge


def _read_source(function: Any) -> Callable[..., float]:
    """Return a compiled function's plain Python; of a few floats it is faster than a call of machine code."""
    return getattr(function, "py_func", function)


_team_reward, _progress_reward = _read_source(compute_team_reward), _read_source(compute_progress_reward)
_reward, _outcome = _read_source(compute_reward), _read_source(compute_outcome)


class Referee:
    """Watch one world's signals. What it says is clipped to the world's diagonal.

    Args:
        scenario: with the formula.
        signal_bounds: of signals known beforehand.
        reward: ``robustness`` or ``progress``; see ImpactEnv.

    Attributes:
        monitor: of the formula, not clipped.
        limit: the world's diagonal [m].
        bounds: interval of robustness still possible [m].
        conjuncts: lower and upper end of every conjunct's interval, one after another [m].

    Raises:
        InputError: ``reward`` is unknown, or bodies do not fly freely in this domain.
    """

    def __init__(self, scenario: Any, signal_bounds: Mapping[str, tuple[float, float]], reward: str) -> None:
        known = scenario.areas, scenario.bodies, signal_bounds
        self.monitor = Monitor(scenario.specification, scenario.control_period, *known)
        self.limit: float = scenario.world.diagonal
        self.bounds, self.conjuncts = (-self.limit, self.limit), list[float]()
        rates, self._forecast = find_rates(reward, scenario.domain), None
        if rates is not None:
            areas, bodies, bounds = known
            self._forecast = Forecast(scenario.specification, self.monitor, areas, bodies, rates, bounds)
        self._potential = 0.0  # of reward "progress" [m]

    def reset(self, signals: Mapping[str, float]) -> None:
        """Start an episode with its first sample."""
        self.monitor.reset()
        self.watch(signals)
        self._potential = self.predict(signals, 0)

    def watch(self, signals: Mapping[str, float]) -> None:
        """Take the formula's next sample."""
        low, high = self.monitor.update(signals)
        ends, limit = (low, high, *self.monitor.conjuncts), self.limit
        low, high, *self.conjuncts = [x if -limit <= x <= limit else -limit if x < -limit else limit for x in ends]
        self.bounds = low, high

    def fail(self) -> None:
        """Count what cannot be followed any further as the lowest robustness."""
        self.bounds, self.conjuncts = (-self.limit, -self.limit), [-self.limit] * len(self.conjuncts)

    def predict(self, signals: Mapping[str, float], steps: int) -> float:
        """Return the potential of reward "progress" [m]; 0 for the other one."""
        if self._forecast is None:
            return 0.0
        found = self._forecast.predict(self.monitor, signals, steps)
        return max(-self.limit, min(self.limit, found))

    def compute_team_reward(
        self, before: tuple[float, float], signals: Mapping[str, float], steps: int, hit: bool, over: bool, failed: bool
    ) -> float:
        """Return the team's reward of one control period, before effort [m].

        Args:
            before: the bounds at its start [m].
            signals, steps: at its end; control periods since reset.
            hit: something was struck within it.
            over: the episode ends.
            failed: the simulation did.
        """
        if self._forecast is None:
            return _team_reward(before, self.bounds, over)
        potential = self._potential
        if over or hit or steps % self._forecast.every == 0:
            self._potential = -self.limit if failed else self.predict(signals, steps)
        return _progress_reward(potential, self._potential, self.bounds[0], over)

    def make_info(self, failure: SimulationFailed | None, over: bool, decided: bool) -> dict[str, Any]:
        """Return what every agent is told; see ImpactEnv.

        Args:
            failure: of the simulation, if it failed.
            over: the episode ends.
            decided: nothing follows.
        """
        low, high = self.bounds
        robustness, success = judge(_outcome(*self.monitor.ends, self.limit))
        info: dict[str, Any] = {
            "robustness_lower": low,
            "robustness_upper": high,
            "overflow": int(isinstance(failure, TooManyEvents)),
            "is_success": bool(success) and failure is None,
        }
        if over:
            info |= {"robustness": robustness, "success": success, "decided": decided}
        if failure is not None:
            info |= {"robustness": -self.limit, "success": False, "failure": str(failure)}
        return info


def share_reward(team: float, efforts: Mapping[str, float]) -> dict[str, float]:
    """Return every agent's reward [m].

    Args:
        team: from `Referee.compute_team_reward` [m].
        efforts: agent to its effort in the control period, in [0, 1].
    """
    count = len(efforts)
    return {agent: _reward(team, count, effort) for agent, effort in efforts.items()}
