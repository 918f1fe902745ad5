"""Find the best constant correction to an expert: what a learned policy must beat to have learned anything.

``python -m train.tune --help`` lists every argument. The cross-entropy method draws constants, or one constant for each
number of the impact in the plan, and moves to the best of them; all candidates of a generation play the same tuning
seeds, in one batch of worlds. The last generations' means and zero then play tuning seeds that the search has not seen,
and whoever surely gains most there, without losing success, is kept: the rule of trained policies. ``out`` is then a
checkpoint as a trained one is: a network of one layer that reads the number of the impact, or nothing.

Nothing is written before the end, and a run cannot be resumed: it takes a minute or two.

Source: Rubinstein, "The cross-entropy method for combinatorial and continuous optimization" (1999).
"""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from agents.actor import DESCRIPTION, Actor, PolicyRecord, save_policy
from agents.play import Played, play_each, play_episodes
from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.scenario import load_scenario
from train.arguments import Args, TuneArgs
from train.evaluation.case import REPORT_SEEDS, TUNING_SEEDS
from train.evaluation.folder_lock import lock_folder
from train.evaluation.journal import read_versions
from train.ground import DEFAULT_SUITE, Ground, judge, make_grounds, read_cases
from train.limits import check_choice, check_least, check_ranges
from train.score import compute_scores, loses_success, rate_evaluation
from train.settings import list_settings
from train.watch import Watch, run_script, show_progress

# Seeds on which the last choice is made; the search itself plays those from TUNING_SEEDS on.
FINAL_SEEDS = TUNING_SEEDS + 250_000


def main(args: TuneArgs) -> dict[str, Any]:
    """Search, choose, report and store.

    Args:
        args: arguments of the search.

    Returns:
        ``constants``, shape (impact numbers or 1, correction size); ``out``, ``wall_seconds``, ``cpu_seconds`` of the
        search and the choice; ``eval``: of what was kept on the choice's seeds, paired with the expert; ``report``: on
        other seeds.

    Raises:
        InputError: bad arguments, or ``out`` holds a checkpoint.
        PlanningError: the expert found no plan.
    """
    start = time.perf_counter(), time.process_time()
    check_args(args)
    numbers = count_numbers(args)
    suites = args.suite or (DEFAULT_SUITE,)
    share = len(args.scenarios) * len(suites)
    ground = Args(
        scenarios=args.scenarios, suite=suites, set=args.set, plan_anew=args.plan_anew, variant=args.variant,
        worlds=share * max(1, args.worlds // share), threads=args.threads,
    )  # fmt: skip
    cases = read_cases(ground)
    torch.set_num_threads(1)
    with lock_folder(args.out):
        _check_free(args.out)
        grounds = make_grounds(ground, cases)
        try:
            with show_progress(args.generations + args.finalists, args.progress, "tuning") as watch:
                meet_expert(args, grounds)
                means = search(args, grounds, numbers, watch)
                constants, chosen = choose_best(args, grounds, means, numbers, watch)
            spent = time.process_time() - start[1]
            actor = make_actor(grounds[0], constants, numbers)
            save_policy(args.out, actor, describe(args, grounds, actor, numbers, spent))
            report = judge(grounds, actor, REPORT_SEEDS, args.report_episodes, args.worst)
        finally:
            for made in grounds:
                made.worlds.close()
    return {
        "constants": np.round(constants, 4).tolist(),
        "out": str(args.out),
        "wall_seconds": time.perf_counter() - start[0],
        "cpu_seconds": spent,
        "eval": chosen,
        "report": report,
    }


def check_args(args: TuneArgs) -> None:
    """Raise unless the arguments make sense.

    Raises:
        InputError: one line naming the argument, its value and the limit.
    """
    least = {"population": 2, "elites": 1, "episodes": 1, "generations": 1, "finalists": 1, "final_episodes": 2}
    check_least(args, least | {"seed": 0, "report_episodes": 0, "worlds": 1})
    shares = {"spread": (1e-6, 1.0), "least_spread": (0.0, 1.0), "step": (1e-3, 1.0)}
    check_ranges(args, shares | {"worst": (0.0, 1e6), "failure": (0.0, 1e6)})
    check_choice(args)
    if args.elites > args.population:
        raise InputError(f"elites {args.elites}: there are {args.population} candidates in a generation")
    if (wanted := args.generations * args.episodes) > FINAL_SEEDS - TUNING_SEEDS:
        raise InputError(f"generations x episodes = {wanted}: at most {FINAL_SEEDS - TUNING_SEEDS}")
    if args.final_episodes > REPORT_SEEDS - FINAL_SEEDS:
        raise InputError(f"final_episodes {args.final_episodes}: at most {REPORT_SEEDS - FINAL_SEEDS}")
    if args.report_episodes == 1:
        raise InputError("report_episodes 1 is too small; choices: 0, 2, 3, ...")


def _check_free(out: Path) -> None:
    if (out / DESCRIPTION).exists():
        raise InputError(f"out {out}: holds a policy; choose another")


def count_numbers(args: TuneArgs) -> int:
    """Return how many leading features number the impact; 0 where one constant is for all.

    Raises:
        InputError: an unknown scenario, or one whose expert does not number what it asks corrections for.
    """
    if not args.per_impact:
        return 0
    found = 0
    for name in args.scenarios:
        scenario = load_scenario(name)
        found = find_part("planners", scenario.domain, "IMPACT_NUMBERS")
        if found is None:
            raise InputError(
                f"--per-impact: scenario '{scenario.name}' has domain '{scenario.domain}', "
                "whose expert numbers no impacts"
            )
    return int(found)


def meet_expert(args: TuneArgs, grounds: list[Ground]) -> None:
    """Play the expert alone on the last choice's seeds; its median robustness there is the unit of the scores."""
    seeds = np.arange(FINAL_SEEDS, FINAL_SEEDS + args.final_episodes)
    for ground in grounds:
        expert = ground.reference[FINAL_SEEDS] = play_episodes(ground.worlds, seeds)
        ground.scale = max(abs(float(np.median(expert.robustness))), 1e-3)


def search(args: TuneArgs, grounds: list[Ground], numbers: int, watch: Watch) -> list[np.ndarray]:
    """Search by the cross-entropy method, from zero.

    Args:
        args: of the run.
        grounds: to play in.
        numbers: of impacts, see `count_numbers`.
        watch: told of every generation.

    Returns:
        The mean of every generation, shape (max(numbers, 1), C) each.
    """
    rng = np.random.default_rng(args.seed)
    met = find_met(grounds, numbers)
    mean = np.zeros((max(numbers, 1), grounds[0].worlds.experts.correction_size))
    spread, means = np.full(mean.shape, args.spread), list[np.ndarray]()
    for generation in range(args.generations):
        draws = rng.normal(size=(args.population, *mean.shape))
        draws[0] = 0.0  # the mean itself is a candidate
        candidates = np.clip(mean + spread * draws, -1.0, 1.0) * met[:, None]
        scores = score(args, grounds, candidates, numbers, generation)
        best = candidates[np.argsort(-scores, kind="stable")[: args.elites]]
        mean = mean + args.step * (best.mean(axis=0) - mean)
        spread = np.maximum(spread + args.step * (best.std(axis=0) - spread), args.least_spread)
        means.append(mean)
        watch.advance(generation + 1)
        watch.say(f"generation {generation + 1}: best score {scores.max():.3f}, of the mean before {scores[0]:.3f}")
    return means


def find_met(grounds: list[Ground], numbers: int) -> np.ndarray:
    """Return which numbers the expert's impacts have, shape (max(numbers, 1),) bool: others stay zero."""
    if numbers == 0:
        return np.ones(1, bool)
    features = np.concatenate([ground.reference[FINAL_SEEDS].features for ground in grounds])
    return (features[:, :numbers] != 0.0).any(axis=0)


def score(args: TuneArgs, grounds: list[Ground], candidates: np.ndarray, numbers: int, generation: int) -> np.ndarray:
    """Return the mean score of every candidate, shape (population,).

    Args:
        args: of the run.
        grounds: to play in.
        candidates: shape (population, max(numbers, 1), C).
        numbers: of impacts.
        generation: whose seeds are played.
    """
    first = TUNING_SEEDS + generation * args.episodes
    seeds = np.tile(np.arange(first, first + args.episodes), len(candidates))
    owner = np.repeat(np.arange(len(candidates)), args.episodes)

    def choose(features: np.ndarray, episode: np.ndarray) -> np.ndarray:
        return np.einsum("mn,mnc->mc", read_numbers(features, numbers), candidates[owner[episode]])

    total = np.zeros(len(candidates))
    for ground in grounds:
        played: Played = play_each(ground.worlds, seeds, choose)
        scores = compute_scores(played.robustness, ground.scale, args.worst) + args.failure * played.success
        total += scores.reshape(len(candidates), -1).mean(axis=1)
    return total / len(grounds)


def read_numbers(features: np.ndarray, numbers: int) -> np.ndarray:
    """Return what the constants are multiplied by: the one-hot number of the impact, or 1, shape (m, n).

    Args:
        features: shape (m, F).
        numbers: of impacts, 0 where one constant is for all.
    """
    return features[:, :numbers] if numbers else np.ones((len(features), 1))


def choose_best(
    args: TuneArgs, grounds: list[Ground], means: list[np.ndarray], numbers: int, watch: Watch
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return whichever of zero and the last means surely gains most on seeds that the search has not seen; see judge.

    The rule is that of trained policies: whoever loses success is not kept, but a share of it may be.

    Args:
        args: of the run.
        grounds: to play in.
        means: of every generation.
        numbers: of impacts.
        watch: told of every finalist.
    """
    tried, found = list[np.ndarray](), list[dict[str, Any]]()
    for place, mean in enumerate([np.zeros_like(means[0]), *means[-args.finalists :]]):
        for share in args.shares:
            tried.append(share * mean)
            actor = make_actor(grounds[0], tried[-1], numbers)
            found.append(judge(grounds, actor, FINAL_SEEDS, args.final_episodes, args.worst))
            part = "" if share == 1.0 else f", {share:g} of it"
            watch.say(
                f"{'zero' if place == 0 else f'finalist {place}{part}'}: "
                f"success {100 * found[-1]['success_rate']:.1f} % "
                f"(expert {100 * found[-1]['expert_success_rate']:.1f} %), gain {found[-1]['gain']:+.4f} m"
            )
            if not loses_success(found[-1], args.loss):
                break
        watch.advance(args.generations + place)
    best = max(range(len(tried)), key=lambda place: rate_evaluation(found[place], args.loss))
    return tried[best], found[best]


def make_actor(ground: Ground, constants: np.ndarray, numbers: int) -> Actor:
    """Make a network of one layer that returns the constants.

    Args:
        ground: whose expert it corrects.
        constants: shape (max(numbers, 1), C).
        numbers: of impacts: the weights of so many first features are the constants; with 0 the bias is.
    """
    experts = ground.worlds.experts
    actor = Actor(experts.feature_size, experts.correction_size, hidden=())
    values = torch.from_numpy(constants.astype(np.float32))
    layer = cast(torch.nn.Linear, actor.layers[0])
    with torch.no_grad():
        if numbers:
            layer.weight[:, :numbers] = values.T
        else:
            layer.bias.copy_(values[0])
    return actor


def describe(args: TuneArgs, grounds: list[Ground], actor: Actor, numbers: int, spent: float) -> PolicyRecord:
    """Return the record of the policy; spent is the processor time of the search and the choice [s]."""
    experts = grounds[0].worlds.experts
    searched = args.population * args.generations * args.episodes * len(grounds)
    return PolicyRecord(
        domain=grounds[0].worlds.scenario.domain,
        sources=tuple(ground.source for ground in grounds),
        variant=args.variant,
        algorithm="constant_per_impact" if numbers else "constant",
        feature_size=experts.feature_size,
        correction_size=experts.correction_size,
        hidden=(),
        feature_clip=actor.feature_clip,
        seed=args.seed,
        steps=searched,
        training=list_settings(asdict(args)),
        versions=read_versions(),
        cpu_seconds=round(spent, 3),
    )


if __name__ == "__main__":
    run_script(main, TuneArgs)
