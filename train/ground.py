"""Scenarios in suites to learn in: worlds with the expert, its episodes, and what a policy gains there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from agents.actor import Actor
from agents.play import Played, play_episodes
from agents.residual_vector import ResidualVectorEnv
from agents.source import Source, make_source
from impact_envs.domain import find_part
from impact_envs.errors import InputError
from planners import check_options, has_planner, list_options, make_plan
from train.arguments import Args
from train.evaluation.case import Case, check_names, make_case
from train.evaluation.paired import Gain, compute_gain, summarise_pairs
from train.settings import parse_settings

DEFAULT_SUITE = "hard"
EVALUATION_EPISODES = 2560  # between two evaluations


@dataclass
class Ground:
    """A scenario in a suite to train in.

    Attributes:
        source: its description.
        worlds: with the expert.
        scale: unit of the robustness in scores: the median of the expert's, or of its size [m].
        reference: the expert's episodes by their first seed, played once.
    """

    source: Source
    worlds: ResidualVectorEnv
    scale: float
    reference: dict[int, Played]


def read_cases(args: Args) -> list[Case]:
    """Read every scenario in every suite.

    Args:
        args: arguments of the run.

    Raises:
        InputError: an unknown scenario, suite, variant or value.
    """
    suites, settings = args.suite or (DEFAULT_SUITE,), parse_settings(args.set)
    check_names("suite", suites)
    check_names("scenario", args.scenarios)
    cases = [make_case(scenario, suite, settings) for scenario in args.scenarios for suite in suites]
    for case in cases:
        check_options(case.scenario, case.options, args.variant, many=True)
    return cases


def fill_args(args: Args, cases: Sequence[Case]) -> Args:
    """Return arguments with the numbers that suit the domain where none is given: steps, worlds, times of evaluations.

    The less often an episode asks for a correction, the more of them an update needs.

    Args:
        args: arguments of the run.
        cases: scenarios in their suites.
    """
    steps, worlds, every = args.steps, args.worlds, args.eval_every
    domain = cases[0].scenario.domain
    if steps is None:
        steps = find_part("agents", domain, "TRAINING_CORRECTIONS")
    if worlds is None:
        share, usual = len(cases) * args.group, find_part("agents", domain, "ITERATION_EPISODES")
        worlds = share * math.ceil(usual / share)
    if every is None:
        every = math.ceil(EVALUATION_EPISODES / max(worlds, 1))
    return replace(args, steps=steps, worlds=worlds, eval_every=every)


def make_grounds(args: Args, cases: Sequence[Case]) -> list[Ground]:
    """Make the worlds of every scenario and suite.

    Args:
        args: arguments of the run.
        cases: scenarios in their suites.

    Raises:
        InputError: scenarios of different experts.
        PlanningError: an expert found no plan.
    """
    assert args.worlds is not None
    count, grounds, plans = args.worlds // len(cases), list[Ground](), dict[str, Any]()
    for case in cases:
        scenario, options = case.scenario, dict(case.options)
        if not args.plan_anew and args.variant is None and "plan_anew" in list_options(scenario):
            options.setdefault("plan_anew", False)
        believed = scenario.as_believed().model_dump_json()  # a suite may shorten the horizon
        if has_planner(scenario) and believed not in plans:
            plans[believed] = make_plan(scenario)
        plan = plans.get(believed)
        worlds = ResidualVectorEnv(
            scenario, count, plan=plan, options=options or None, threads=args.threads, variant=args.variant
        )
        grounds.append(Ground(make_source(scenario, case.suite, plan), worlds, 1.0, {}))
    sizes = {(g.worlds.experts.feature_size, g.worlds.experts.correction_size): g.source.scenario for g in grounds}
    if len(sizes) > 1:
        names = " and ".join(sizes.values())
        raise InputError(f"scenarios {names} have experts of different features or corrections: train them apart")
    return grounds


def judge(grounds: list[Ground], actor: Actor, first: int, episodes: int, worst: float) -> dict[str, Any]:
    """Pair a policy with the expert on some seeds of every ground.

    Args:
        grounds: to play in; the expert's episodes are played once for all policies.
        actor: the policy.
        first: of the seeds.
        episodes: of each ground; without any, nothing is returned.
        worst: a failure counts no more than so many times the scale of its ground.
    """
    if episodes == 0:
        return {}
    gains, sources, seeds = list[Gain](), [], np.arange(first, first + episodes)
    for ground in grounds:
        if first not in ground.reference:
            ground.reference[first] = play_episodes(ground.worlds, seeds)
        expert, played = ground.reference[first], play_episodes(ground.worlds, seeds, actor.correction)
        gains.append(compute_gain(played, expert, worst * ground.scale, ground.scale))
        sources.append({"scenario": ground.source.scenario, "suite": ground.source.suite, **asdict(gains[-1])})
    return {**summarise_pairs(gains), "sources": sources}
