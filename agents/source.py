"""Where a policy comes from: scenario, suite, expert and plan of its training, and whether they are still these."""

from __future__ import annotations

import hashlib
import json

from agents.checkpoint import JsonRecord
from impact_envs import gym_id
from impact_envs.scenario import Scenario, list_scenarios
from planners.plan import Plan

TIMES = ("solve_seconds", "stage_seconds")  # of a plan: how long it took, not what it is


class Source(JsonRecord):
    """What a policy was trained in.

    Attributes:
        scenario, suite: names.
        environment: Gymnasium id of the residual environment, whose version rises with every change of the expert's
            behaviour; None for a user's own scenario.
        horizon: of the scenario in that suite [s].
        plan: digest of the plan that the expert followed, None without one.
    """

    scenario: str
    suite: str
    environment: str | None
    horizon: float
    plan: str | None


def make_source(scenario: Scenario, suite: str, plan: Plan | None) -> Source:
    """Describe a scenario in a suite, with the expert's plan, as they are now."""
    shipped = scenario.name in list_scenarios()
    environment = gym_id(scenario.name, residual=True) if shipped else None
    digest = compute_digest(plan)
    return Source(scenario=scenario.name, suite=suite, environment=environment, horizon=scenario.horizon, plan=digest)


def compute_digest(plan: Plan | None) -> str | None:
    """Return a digest of what a plan has its expert fly, None without a plan."""
    if plan is None:
        return None
    content = json.loads(plan.to_json())
    kept = {key: value for key, value in content.items() if key not in TIMES}
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()[:16]


def find_difference(sources: tuple[Source, ...], scenario: Scenario, plan: Plan | None) -> str | None:
    """Return in one line how expert or plan differ from those of a policy's training, None if they are the same.

    Args:
        sources: of the training.
        scenario: that the policy is to play; one that it was not trained in is no difference of the expert.
        plan: that its expert follows there.
    """
    known = [source for source in sources if source.scenario == scenario.name]
    for source in known:
        now = make_source(scenario, source.suite, plan)
        if now.environment != source.environment:
            return f"trained on the expert of {source.environment}; this one is {now.environment}'s"
    digests = {source.plan for source in known if source.horizon == scenario.horizon}
    if digests and (digest := compute_digest(plan)) not in digests:
        trained = " or ".join(sorted(map(str, digests)))
        return f"trained on another plan of {scenario.name} (digest {trained}, now {digest})"
    return None
