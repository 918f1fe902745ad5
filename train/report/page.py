"""One self-contained HTML page from an evaluation: tables, replays, distributions, failures that were searched for."""

from __future__ import annotations

import json
from collections import Counter
from html import escape
from importlib.resources import files
from itertools import groupby
from pathlib import Path, PurePath
from string import Template
from typing import Any

import numpy as np

from impact_envs.file import write_atomically
from impact_envs.scenario import Region
from impact_envs.stl import Trace, parse, robustness
from planners.plan import Plan
from train.evaluation.journal import JudgedCase
from train.evaluation.results import Evaluation, Replay, read_evaluation
from train.report.comparison import write_comparison
from train.report.failures import write_failures
from train.report.learning import collect_learning, write_learning
from train.report.suites import write_suites
from train.report.tables import Look, write_differences, write_results

# Okabe & Ito, "Color Universal Design" (2008), in the order of the policies.
POLICY_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#7f7f7f")
# A page of all scenarios stays below 2 MB: a number takes about 7 bytes.
SAMPLES_PER_REPLAY, FEWEST_SAMPLES, NUMBERS_IN_ALL = 1500, 60, 140_000
PLAN_SAMPLES = 101
HELD_SAMPLES = 101


def write_report(directory: str | Path) -> Path:
    """Write report.html into an evaluation's directory.

    The page holds its style, scripts and data, so it opens from the file system and needs no network.

    Args:
        directory: what an evaluation wrote.

    Returns:
        Path of the page.

    Raises:
        InputError: the directory or one of its files is missing, or does not hold an evaluation.
    """
    evaluation = read_evaluation(directory)
    looks = choose_looks(evaluation.manifest.policies)
    data = collect_data(evaluation, looks)
    source = files("train.report")
    page = Template(source.joinpath("page.html").read_text(encoding="utf-8")).substitute(
        **_write_heading(evaluation, looks),
        results=write_results(evaluation.summary.rows, looks),
        paired=write_differences(evaluation.summary.paired, looks),
        comparison=write_comparison(evaluation.episodes, looks),
        without_replays="hidden" if evaluation.replays else "",
        with_replays="" if evaluation.replays else "hidden",
        distributions=_write_distributions(evaluation),
        labels=", ".join(f"<code>{escape(label)}</code>" for label in looks),
        versions=escape(", ".join(f"{name} {number}" for name, number in evaluation.manifest.versions.items())),
        style=source.joinpath("page.css").read_text(encoding="utf-8"),
        script=source.joinpath("page.js").read_text(encoding="utf-8"),
        plot=source.joinpath("plot.js").read_text(encoding="utf-8"),
        suites=write_suites(evaluation.manifest.cases),
        learning=write_learning(data["learning"]),
        failures=write_failures(Path(directory)),
        data=_inline(data),
    )
    path = Path(directory) / "report.html"
    write_atomically(path, page.encode())
    return path


def choose_looks(labels: list[str]) -> dict[str, Look]:
    """Give every policy a short name and a colour.

    Args:
        labels: policies as the user named them, in the order asked.

    Returns:
        Label to its look; the name is the last part of a path, unless two policies share it.
    """
    last = {label: PurePath(label).name or label for label in labels}
    shared = {name for name, count in Counter(last.values()).items() if count > 1}
    return {
        label: Look(label if last[label] in shared else last[label], POLICY_COLORS[k % len(POLICY_COLORS)])
        for k, label in enumerate(labels)
    }


def collect_data(evaluation: Evaluation, looks: dict[str, Look]) -> dict[str, Any]:
    """Collect what the page's script draws, as JSON values.

    Args:
        evaluation: what was read.
        looks: name and colour of every policy.

    Returns:
        ``policies``, ``distributions`` (one per scenario), ``replays``, ``plans`` that they point to, and ``learning``.
    """
    cells = [
        {
            "scenario": scenario,
            "suite": suite,
            "policy": policy,
            **group[["seed", "robustness"]].to_dict("list"),
        }
        for (scenario, suite, policy), group in evaluation.episodes.groupby(["scenario", "suite", "policy"], sort=False)
    ]
    each = NUMBERS_IN_ALL / max(1, len(evaluation.replays))
    plans: list[dict[str, Any]] = []
    replays = []
    for replay in evaluation.replays:
        limit = int(np.clip(each / (3 * len(replay.bodies) + 3), FEWEST_SAMPLES, SAMPLES_PER_REPLAY))
        thin = thin_replay(replay, looks[replay.policy], limit)
        if thin["plan"] not in (None, *plans):
            plans.append(thin["plan"])
        replays.append(thin | {"plan": None if thin["plan"] is None else plans.index(thin["plan"])})
    return {
        "policies": [{"label": label, "name": look.name, "color": look.color} for label, look in looks.items()],
        "distributions": [
            {"scenario": name, "cells": [cell for cell in cells if cell["scenario"] == name]}
            for name in dict.fromkeys(cell["scenario"] for cell in cells)
        ],
        "replays": replays,
        "plans": plans,
        "learning": collect_learning(looks),
    }


def thin_replay(replay: Replay, look: Look, limit: int) -> dict[str, Any]:
    """Keep of a replay what is drawn, with few samples but every kink at an impact.

    Args:
        replay: a recorded episode.
        look: name and colour of its policy.
        limit: samples kept, apart from the two around each impact.

    Returns:
        One JSON object for the page's script.
    """
    last = len(replay.times) - 1
    kinks = np.searchsorted(replay.times, [impact.time for impact in replay.impacts])
    even = np.linspace(0, last, min(limit, last + 1)).astype(int)
    keep = np.unique(np.clip(np.concatenate([even, kinks, kinks - 1]), 0, last))

    def pick(name: str) -> list[float]:
        return np.round(np.asarray(replay.signals[name])[keep], 4).tolist()

    return {
        "scenario": replay.scenario,
        "suite": replay.suite,
        "label": replay.policy,
        "name": look.name,
        "color": look.color,
        "seed": replay.seed,
        "links": replay.links,
        "world": replay.world,
        "bodies": replay.bodies,
        "shapes": [shape.model_dump() for shape in replay.shapes],
        "times": np.round(np.asarray(replay.times)[keep], 5).tolist(),
        "tracks": {body: {key: pick(f"{body}.{key}") for key in ("x", "y", "heading")} for body in replay.bodies},
        "impacts": [impact.model_dump() for impact in replay.impacts],
        "bounds": [replay.robustness_bounds[k] for k in keep],
        "robustness": replay.robustness,
        "held": compute_held_robustness(replay),
        "plan": _sample_plan(replay.plan),
    }


def compute_held_robustness(replay: Replay) -> dict[str, list[float]]:
    """Compute at some times the robustness of the episode so far, continued with the state of that time held.

    Unlike the monitor's interval it also moves while a formula such as ``G[30,30] pop in goal`` waits for its time.

    Args:
        replay: a recorded episode.

    Returns:
        ``times`` [s] and ``robustness`` [m]; the last one is that of the whole episode.

    Raises:
        InputError: the formula does not fit the signals and areas of the replay.
    """
    formula = parse(replay.formula)
    samples = np.arange(len(replay.times))
    at = np.unique(np.linspace(0, samples[-1], HELD_SAMPLES).astype(int))
    held = np.minimum(samples, at[:, None])
    areas = {
        shape.label: Region(vertices=tuple(shape.vertices))
        for shape in replay.shapes
        if shape.body is None and shape.vertices is not None
    }
    signals = {name: np.asarray(values)[held] for name, values in replay.signals.items()}
    rho = robustness(formula, Trace(signals, replay.period, areas, tuple(replay.bodies)))
    return {"times": np.asarray(replay.times)[at].tolist(), "robustness": np.round(rho, 5).tolist()}


def _sample_plan(plan: Plan | None) -> dict[str, Any] | None:
    """Return a plan's curves, shape (n, 2) each, and where its impacts are."""
    if plan is None:
        return None
    curves = {
        body: np.round(
            curve.position(np.union1d(np.linspace(0.0, plan.horizon, PLAN_SAMPLES), curve.times)), 3
        ).tolist()
        for body, curve in (plan.robots | plan.objects).items()
    }
    places = [np.round(impact.position, 3).tolist() for impact in plan.impacts]
    return {"curves": curves, "impacts": [{"x": x, "y": y} for x, y in places]}


def _inline(value: Any) -> str:
    """Write JSON that can stand inside a script element: no '<' can end it."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _join(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _write_heading(evaluation: Evaluation, looks: dict[str, Look]) -> dict[str, str]:
    manifest, rows = evaluation.manifest, evaluation.summary.rows
    scenarios = list(dict.fromkeys(case.name for case in manifest.cases))
    suites = list(dict.fromkeys(case.suite for case in manifest.cases))
    where = _join(scenarios) if len(scenarios) <= 3 else f"{len(scenarios)} scenarios"
    last = manifest.seed + manifest.episodes - 1
    facts = {
        "Episodes": f"{sum(row.episodes for row in rows)}",
        "Seeds, the same for every policy": f"{manifest.seed} – {last}" if manifest.episodes > 1 else str(last),
        "Suites": ", ".join(suites),
        "Policies": ", ".join(look.name for look in looks.values()),
        **({"Changed": ", ".join(f"{key} = {value}" for key, value in manifest.set.items())} if manifest.set else {}),
        "Written": f"{evaluation.written:%Y-%m-%d %H:%M}, {evaluation.manifest.cores} cores",
    }
    return {
        "title": escape(f"{_join([look.name for look in looks.values()])} on {where}"),
        "facts": "".join(f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in facts.items()),
        "tasks": "".join(_write_task(list(group)) for _, group in groupby(manifest.cases, key=_task)),
    }


def _task(case: JudgedCase) -> tuple[str, str, float]:
    return case.name, case.formula, case.horizon  # a suite may shorten the horizon


def _write_task(cases: list[JudgedCase]) -> str:
    case, suites = cases[0], ", ".join(case.suite for case in cases)
    return (
        f'<div class="task"><h3>{escape(case.name)}</h3><p>{escape(case.description)}</p>'
        f"<code>{escape(case.formula)}</code>"
        f'<p class="note">Horizon {case.horizon:g} s · suites: {escape(suites)}</p>'
        f'<canvas class="plan" data-scenario="{escape(case.name)}" role="img" '
        f'aria-label="Plan of {escape(case.name)}"></canvas>'
        f'<p class="note">The plan: where bodies go, and its impacts (stars) in their order.</p></div>'
    )


def _write_distributions(evaluation: Evaluation) -> str:
    names = dict.fromkeys(evaluation.episodes["scenario"])
    plots = [f'<h3>{escape(name)}</h3><div class="plot" id="distribution-{k}"></div>' for k, name in enumerate(names)]
    return "".join(plots)
