import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from impact_envs.errors import InputError
from planners.bezier import Curve
from planners.plan import Plan
from train.evaluation.journal import JudgedCase
from train.evaluation.metric import signed
from train.evaluation.metrics import summarize
from train.evaluation.replay import describe_plan
from train.evaluation.results import Difference, Replay
from train.evaluation.statistics import compare
from train.report import page as page_module
from train.report.learning import collect_learning, write_learning
from train.report.page import choose_looks, write_report
from train.report.suites import write_suites
from train.report.tables import write_differences

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no chromium, chromium-browser or google-chrome here")

HOSTILE = 'runs/</script><script>document.title="hacked"</script>&<b>'
POLICIES = ("expert", "zero", HOSTILE)
SEED, EPISODES, HORIZON, PERIOD = 2_000_000, 12, 30.0, 0.1
CATCH = 20.0  # [s], when the object stops


def _box(x0, y0, x1, y1):
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]


def _plan():
    """A throw from (0.5, 1.5) at 5 s, caught at (0.5, 2.25) at 20 s."""
    still = [[0.5, 1.5], [0.5, 1.5]], [[0.5, 1.5], [0.5, 2.25]], [[0.5, 2.25], [0.5, 2.25]]
    reach = [[0.0, 0.5], [0.5, 1.1]], [[0.5, 1.1], [0.3, 0.8]], [[0.3, 0.8], [0.0, 0.5]]
    times = [0.0, 5.0, CATCH, HORIZON]
    curves = {"pop": Curve(times, list(reach))}, {"puck": Curve(times, list(still))}
    numbers = {
        "horizon": HORIZON,
        "robustness": 0.25,
        "bound": 0.25,
        "gap": 0.0,
        "effort": 0.1,
        "effort_bound": None,
    }
    return Plan("throw", "robustness", **numbers, impacts=(), robots=curves[0], objects=curves[1],
                solve_seconds=0.1, stage_seconds={}, validated=True)  # fmt: skip


def _replay(suite, policy, thrown):
    times = np.round(PERIOD * np.arange(round(HORIZON / PERIOD) + 1), 10)
    plan = _plan()
    puck = plan.objects["puck"].position(times if thrown else 0 * times)
    pop = plan.robots["pop"].position(times if thrown else 0 * times)
    rho = 0.25 if thrown else -0.5
    signals = {"pop.heading": np.angle(np.exp(1j * times)), "puck.heading": 0 * times}
    for axis, k in (("x", 0), ("y", 1)):
        signals |= {f"pop.{axis}": pop[:, k], f"puck.{axis}": puck[:, k]}
    lower = np.where(times < CATCH, -1.0, rho)
    upper = np.where(times < CATCH, 0.25, rho)
    bounds = [[low, None if k == 0 else high] for k, (low, high) in enumerate(zip(lower, upper, strict=True))]
    disc = {"vertices": None}
    return {
        "format": 1, "scenario": "throw", "domain": "free_flyer", "suite": suite, "policy": policy, "seed": SEED,
        "formula": "F[0,30] puck in goal", "horizon": HORIZON, "period": PERIOD, "world": [[-1, 0], [2, 4]],
        "agents": ["pop"], "bodies": ["pop", "puck"], "times": times.tolist(),
        "shapes": [
            {"body": None, "role": "region", "radius": None, "vertices": _box(0.25, 2, 0.75, 2.5), "label": "goal"},
            {"body": None, "role": "obstacle", "radius": None, "vertices": _box(-1, 3, 0, 3.4), "label": "shelf"},
            {"body": "puck", "role": "object", "radius": 0.15, "label": "puck"} | disc,
            {"body": "pop", "role": "robot", "radius": 0.2, "label": "pop"} | disc,
        ],
        "signals": {name: values.tolist() for name, values in signals.items()},
        "actions": {}, "rewards": {}, "robustness_bounds": bounds, "robustness": rho, "success": thrown, "effort": 1.5,
        "impacts": [{"time": t, "a": "pop", "b": "puck", "point": [0.5, y], "normal": [0, 1], "impulse": [0, 1],
                     "speed": 0.1} for t, y in ((5.02, 1.35), (CATCH, 2.4)) if thrown],
        "fallbacks": {}, "solve_ms": {"p50": None, "p99": None, "max": None},
        "plan": describe_plan(plan) if thrown else None,
    }  # fmt: skip


def _rows():
    rng = np.random.default_rng(0)
    rows = []
    for suite in ("nominal", "restitution"):
        for policy in POLICIES:
            for seed in range(SEED, SEED + EPISODES):
                spread = 0.01 if suite == "nominal" else 0.2
                rho = -0.5 if policy == "zero" else 0.24 - abs(rng.normal(0, spread)) + 0.02 * (policy == HOSTILE)
                kinds = {} if policy == "zero" else {"hold <course>": int(rng.integers(3))}
                solve = [] if policy == "zero" else rng.uniform(1, 9, 5).round(3).tolist()
                rows.append({
                    "scenario": "throw", "suite": suite, "policy": policy, "seed": seed, "success": rho > 0,
                    "robustness": rho, "effort": 0.0 if policy == "zero" else 1.5, "impacts": 2 * (policy != "zero"),
                    "steps": 300, "replans": 1, "fallbacks": sum(kinds.values()), "fallback_kinds": json.dumps(kinds),
                    "solve_ms": solve, "wall_seconds": 0.5,
                })  # fmt: skip
    return pd.DataFrame(rows)


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory):
    """An evaluation directory as train.evaluation.evaluate writes it, with a hostile policy name."""
    directory = tmp_path_factory.mktemp("evaluation")
    rows = _rows()
    rows.to_parquet(directory / "rows.parquet", index=False)
    summary = {
        "rows": summarize(rows),
        "paired": compare(rows),
        "episodes_played": len(rows),
        "wall_seconds": 9.0,
    }
    (directory / "summary.json").write_text(json.dumps(summary))
    case = {"name": "throw", "domain": "free_flyer", "description": "Throw & catch <puck>.",
            "formula": "F[0,30] puck in goal & G[0,30] speed(puck) <= 0.5", "horizon": HORIZON}  # fmt: skip
    cases = [case | {"suite": suite} for suite in ("nominal", "restitution")]
    manifest = {"format": 1, "cases": cases, "policies": POLICIES, "episodes": EPISODES, "seed": SEED}
    manifest |= {"versions": {"numpy": "2.4"}, "digests": {}, "cores": 2}
    (directory / "manifest.json").write_text(json.dumps(manifest))
    (directory / "replays").mkdir()
    for suite in ("nominal", "restitution"):
        for k, policy in enumerate(POLICIES):
            path = directory / "replays" / f"throw__{suite}__{k}__{SEED}.json"
            path.write_text(json.dumps(_replay(suite, policy, policy != "zero")))
    return directory


@pytest.fixture(scope="module")
def page(evaluation):
    return write_report(evaluation)


class _Reader(HTMLParser):
    """Collects table rows, the data script, and attributes that would load something."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.data, self.loads, self.tags = {}, "", [], []
        self._table = self._cell = None
        self._in_data = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append(tag)
        self.loads += [value for key, value in attrs if key in ("src", "href", "srcset", "data-src")]
        self._in_data = tag == "script" and attributes.get("id") == "data"
        if tag == "table":
            self._table = self.rows.setdefault(attributes["id"], [])
        elif tag == "tr" and self._table is not None:
            self._table.append([])
        elif tag in ("td", "th") and self._table is not None:
            self._table[-1].append("")
            self._cell = True

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self._cell = False
        elif tag == "table":
            self._table = None
        elif tag == "script":
            self._in_data = False

    def handle_data(self, text):
        if self._cell:
            self._table[-1][-1] += text
        elif self._in_data:
            self.data += text


@pytest.fixture(scope="module")
def read(page):
    return _Reader(page.read_text(encoding="utf-8"))


def test_page_loads_nothing(page, read):
    assert read.loads == []
    assert "link" not in read.tags and "img" not in read.tags and "iframe" not in read.tags
    assert page.stat().st_size < 2e6


def test_hostile_names_stay_text(read):
    assert read.tags.count("script") == 3  # data, plots, the page's own
    template = Path(page_module.__file__).with_suffix(".html").read_text(encoding="utf-8")
    assert read.tags.count("b") == template.count("<b>")  # none from a name
    data = json.loads(read.data)
    assert [policy["label"] for policy in data["policies"]] == list(POLICIES)


def test_table_says_what_the_summary_says(evaluation, read):
    summary = json.loads((evaluation / "summary.json").read_text())
    head, *cells = [row for row in read.rows["results-table"] if len(row) > 1]
    fallbacks = next(index for index, title in enumerate(head) if title.startswith("Fallbacks"))
    solved = next(index for index, title in enumerate(head) if title.startswith("Solve time"))
    assert len(cells) == len(summary["rows"]) == 6
    for cell, row in zip(cells, summary["rows"], strict=True):
        assert row["policy"].endswith(cell[0])
        assert cell[1] == f"{row['successes']}/{row['episodes']}"
        low, high = row["success_ci"]
        assert cell[2] == f"{100 * row['success_rate']:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
        numbers = [_number(cell[3]), *map(_number, cell[4].strip("[]").split(",")), _number(cell[5])]
        expected = [row["robustness_median"], *row["robustness_ci"], row["robustness_q05"]]
        assert numbers == pytest.approx(expected, abs=5.1e-4)
        assert (cell[solved] == "–") == (row["solve_ms"]["p50"] is None)
        number, kinds = re.match(r"([\d.]+)(.*)", cell[fallbacks]).groups()
        assert float(number) == pytest.approx(row["fallbacks_per_episode"], abs=0.051)
        assert kinds == (", ".join(f"{kind}: {count}" for kind, count in row["fallbacks"].items()) or "none")


def test_paired_table_says_what_the_summary_says(evaluation, read):
    everything = json.loads((evaluation / "summary.json").read_text())["paired"]
    paired = [pair for pair in everything if "zero" not in (pair["a"], pair["b"])]  # which nobody doubts
    cells = [row for row in read.rows["paired-table"][1:] if len(row) > 1]
    assert len(cells) == len(paired) == 2 and len(everything) == 6
    for cell, pair in zip(cells, paired, strict=True):
        assert _number(cell[1]) == pytest.approx(pair["difference_median"], abs=5.1e-4)
        assert sum(map(int, cell[4].split("/"))) == pair["episodes"]
        word = "better" if pair["ci"][0] > 0 else "worse" if pair["ci"][1] < 0 else "no difference"
        assert word in cell[6]


def _number(text):
    return float(text.replace("−", "-"))


@pytest.mark.parametrize(
    ("interval", "reading"),
    [((0.01, 0.2), "better"), ((-0.2, -0.01), "worse"), ((-0.1, 0.3), "no difference shown"), ((0.0, 0.3), "no diff")],
)
def test_only_an_interval_beside_zero_is_called_a_difference(interval, reading):
    numbers = {"difference_median": 0.1, "difference_mean": 0.1, "win_rate": 0.7, "tie_rate": 0.1}
    names = {"scenario": "throw", "suite": "nominal", "a": "b", "b": "a"}
    difference = Difference(**names, **numbers, episodes=10, ci=interval, success_difference=0.1)
    row = _Reader(write_differences([difference], choose_looks(["a", "b"]))).rows["paired-table"][-1]
    assert reading in row[6]
    assert row[4:6] == ["7 / 1 / 2", "+10 points"]


def test_signed_numbers_are_rounded_and_carry_their_sign():
    assert [signed(x) for x in (0.25, -1.2996, 0.0, -0.0001)] == ["+0.250", "−1.300", "0.000", "0.000"]


def test_policies_sharing_a_last_part_keep_their_full_names():
    looks = choose_looks(["expert", "runs/a/best", "runs/b/best", "runs/c"])
    assert [look.name for look in looks.values()] == ["expert", "runs/a/best", "runs/b/best", "c"]
    assert len({look.color for look in looks.values()}) == 4


def test_thinning_keeps_ends_and_impacts(evaluation, read, monkeypatch):
    full = json.loads(read.data)["replays"][0]
    assert full["times"] == pytest.approx(PERIOD * np.arange(301))
    monkeypatch.setattr("train.report.page.SAMPLES_PER_REPLAY", 7)
    thin = json.loads(_Reader(write_report(evaluation).read_text(encoding="utf-8")).data)["replays"][0]
    monkeypatch.undo()
    write_report(evaluation)
    assert len(thin["times"]) <= 7 + 4
    assert {0.0, 5.0, 5.1, CATCH, HORIZON} <= set(thin["times"])
    assert len(thin["tracks"]["puck"]["y"]) == len(thin["bounds"]) == len(thin["times"])
    # Linear between its kinks, so the thinned path is the whole path.
    y = np.interp(full["times"], thin["times"], thin["tracks"]["puck"]["y"])
    assert y == pytest.approx(full["tracks"]["puck"]["y"], abs=6e-3)
    plans = json.loads(read.data)["plans"]
    assert len(plans) == 1 and thin["plan"] == 0  # the same one for every policy and suite
    assert plans[0]["curves"]["puck"][-1] == pytest.approx([0.5, 2.25])


def test_held_robustness_ends_at_the_robustness_reached(read):
    for replay in json.loads(read.data)["replays"]:
        held = dict(zip(replay["held"]["times"], replay["held"]["robustness"], strict=True))
        assert held[HORIZON] == pytest.approx(replay["robustness"])
        assert held[0.0] == pytest.approx(-0.5)  # the puck's start is 0.5 m below the goal
        # F[0,30]: what was reached stays, so the line only rises, and it stays inside the monitor's interval.
        assert (np.diff(list(held.values())) >= 0).all()


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("summary.json", None, "summary.json: cannot be read"),
        ("manifest.json", "{", "manifest.json: content: Invalid JSON"),
        ("manifest.json", '{"format": 2}', "manifest.json: format:"),
        ("summary.json", '{"rows": [], "paired": []}', "summary.json: rows:"),
        ("rows.parquet", None, "rows.parquet: cannot be read"),
        ("rows.parquet", "not parquet", "rows.parquet:"),
        (f"replays/throw__nominal__0__{SEED}.json", "[]", "json: content:"),
    ],
)
def test_broken_evaluation_is_one_line(evaluation, tmp_path, name, content, says):
    copy = tmp_path / "copy"
    shutil.copytree(evaluation, copy)
    (copy / name).unlink()
    if content is not None:
        (copy / name).write_text(content)
    with pytest.raises(InputError, match=re.escape(says)) as caught:
        write_report(copy)
    assert "\n" not in str(caught.value)


@needs_browser
def test_evaluation_without_replays_still_makes_a_page(evaluation, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(evaluation, copy)
    shutil.rmtree(copy / "replays")
    document = _browse(write_report(copy), tmp_path)
    assert 'data-ready="true"' in document and "data-error" not in document
    assert '<p class="empty">This evaluation kept no replays.</p>' in re.sub(" +>", ">", document)


def test_missing_directory_is_one_line(tmp_path):
    with pytest.raises(InputError, match="'nowhere' is not a directory"):
        write_report("nowhere")


@pytest.mark.parametrize("signal", ["pop.x", "pop.vx"])
def test_replay_with_missing_samples_is_refused(evaluation, tmp_path, signal):
    copy = tmp_path / "copy"
    shutil.copytree(evaluation, copy)
    path = copy / "replays" / f"throw__nominal__0__{SEED}.json"
    replay = json.loads(path.read_text())
    replay["signals"][signal] = replay["signals"]["pop.x"][:-1]
    path.write_text(json.dumps(replay))
    with pytest.raises(InputError, match="301 samples each"):
        write_report(copy)


def _browse(page, tmp_path, fragment=""):
    """Return the page's document after its scripts ran in a headless browser."""
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
             "--disable-background-networking", "--disable-component-update", "--hide-scrollbars")  # fmt: skip
    profile = tmp_path / "profile"
    profile.mkdir()
    command = [BROWSER, *flags, f"--user-data-dir={profile}", "--virtual-time-budget=3000", "--dump-dom"]
    result = subprocess.run(
        [*command, page.as_uri() + fragment], capture_output=True, text=True, timeout=60, check=True
    )
    return result.stdout


def _canvases(document):
    return [dict(re.findall(r'data-([a-z]+)="([^"]*)"', tag)) for tag in re.findall(r"<canvas[^>]*>", document)]


def _pose(canvas):
    return {name: tuple(map(float, xy.split(","))) for name, xy in re.findall(r"(\w+):(\S+)", canvas["pose"])}


@needs_browser
def test_browser_shows_the_asked_instant(page, tmp_path):
    document = _browse(page, tmp_path, "#scenario=throw&suite=restitution&t=12.57")
    assert 'data-ready="true"' in document and "data-error" not in document
    canvases = [canvas for canvas in _canvases(document) if "policy" in canvas]
    assert len(canvases) == 3
    thrown, still = canvases[0], canvases[1]
    assert float(thrown["time"]) == 12.57  # between two samples
    assert _pose(thrown)["puck"] == pytest.approx((0.5, 1.5 + 0.75 * 7.57 / 15), abs=1e-3)
    assert _pose(still)["puck"] == (0.5, 1.5)
    assert (thrown["impacts"], still["impacts"]) == ("1", "0")
    assert thrown["bounds"] == "-1,0.25"
    # A box per policy and suite, and a band and a line over time per replay, are really drawn.
    assert document.count('class="boxes"') == 6
    assert document.count('class="band"') == document.count('class="held"') == 3
    assert document.count("<circle cx") >= 6 * EPISODES
    assert "<title>hacked" not in document


@needs_browser
def test_slider_and_choices_move_the_picture(page, tmp_path):
    steps = """
    <script>
    const seen = [], canvases = () => [...document.querySelectorAll("canvas[data-policy]")];
    const say = () => seen.push(canvases().map((canvas) => canvas.dataset.pose));
    const slider = document.getElementById("time"), suite = document.getElementById("suite");
    const play = document.getElementById("play");
    say();
    slider.value = "8"; slider.dispatchEvent(new Event("input")); say();
    document.querySelector("#policies button").click(); say();
    suite.value = "restitution"; suite.dispatchEvent(new Event("change")); say();
    document.body.dataset.hash = location.hash;
    play.click();
    setTimeout(() => {
      seen.push(Number(slider.value));
      const text = JSON.stringify(seen);
      document.body.append(Object.assign(document.createElement("pre"), { id: "seen", textContent: text }));
    }, 1000);
    </script></body>"""
    copy = tmp_path / "driven.html"
    copy.write_text(steps.join(page.read_text(encoding="utf-8").rsplit("</body>", 1)), encoding="utf-8")
    document = _browse(copy, tmp_path)
    at_start, at_8, fewer, other, played = json.loads(re.search(r'<pre id="seen">(.*?)</pre>', document)[1])
    assert (len(at_start), len(at_8), len(fewer), len(other)) == (3, 3, 2, 2)
    assert "puck:0.500,1.500" in at_start[0]
    assert f"puck:0.500,{1.5 + 0.75 * 3 / 15:.3f}" in at_8[0]
    assert at_8[1] == at_start[1]  # the zero policy stays where it was
    assert fewer == at_8[1:]
    assert re.search(r'data-hash="#scenario=throw&amp;suite=restitution&amp;t=8.00"', document)
    assert 8 < played <= HORIZON  # the browser's clock is virtual here, so how far is left open


MEASURE = """
<iframe id="page" style="width:WIDTHpx;height:800px;border:0"></iframe>
<script>
const frame = document.getElementById("page"), text = atob("PAGE");
frame.srcdoc = new TextDecoder().decode(Uint8Array.from(text, (letter) => letter.charCodeAt(0)));
frame.onload = () => {
  const page = frame.contentDocument, view = frame.contentWindow, seen = {};
  const box = (node) => node.getBoundingClientRect();
  page.getElementById("panels").scrollIntoView({ block: "start" });
  const play = box(page.getElementById("play")), canvas = box(page.querySelector("canvas[data-policy]"));
  seen.play = [play.left, play.top, play.right, play.bottom];
  seen.canvas = [canvas.left, canvas.top, canvas.right, canvas.bottom];
  seen.clock = page.getElementById("clock").textContent;
  seen.ticks = [...page.querySelectorAll("#ticks button")].map((tick) => box(tick).left + box(tick).width / 2);
  const track = box(page.getElementById("time"));
  seen.track = [track.left, track.right];
  page.querySelector("#ticks button").click();
  seen.sought = Number(page.getElementById("time").value);
  seen.width = page.documentElement.scrollWidth;
  const heads = [...page.querySelectorAll("#results-table thead th")];
  seen.robustness = box(heads.find((head) => head.textContent.startsWith("Robustness"))).right;
  seen.heads = [...page.querySelectorAll("th")].every((th) => th.scope);
  seen.plan = page.querySelector("canvas.plan").dataset.impacts;
  const dot = page.querySelector("circle[data-tip]"), at = box(dot);
  const touch = { bubbles: true, pointerType: "touch", clientX: at.left, clientY: at.top };
  dot.dispatchEvent(new view.PointerEvent("pointerdown", touch));
  seen.tip = page.querySelector(".tip").textContent;
  const kinds = page.querySelector("#results-table summary");
  kinds.click();
  seen.opened = kinds.parentElement.open;
  seen.ready = page.body.dataset.ready;
  document.body.append(Object.assign(document.createElement("pre"), { id: "seen", textContent: JSON.stringify(seen) }));
};
</script>"""


@needs_browser
@pytest.mark.parametrize("width", [1400, 400])
def test_page_works_at_a_desk_and_on_a_telephone(page, tmp_path, width):
    outer = tmp_path / "outer.html"
    content = base64.b64encode(page.read_bytes()).decode()
    outer.write_text(f"<!doctype html><body>{MEASURE.replace('WIDTH', str(width)).replace('PAGE', content)}</body>")
    seen = json.loads(re.search(r'<pre id="seen">(.*?)</pre>', _browse(outer, tmp_path))[1])
    assert seen["ready"] == "true" and seen["heads"]
    assert seen["width"] <= width  # the page itself never scrolls sideways
    assert seen["clock"].startswith("0.0 /")  # it opens at the start
    # Play and the whole picture are in sight together.
    for left, top, right, bottom in (seen["play"], seen["canvas"]):
        assert 0 <= left < right <= width and 0 <= top < bottom <= 800
    assert seen["robustness"] <= width  # the main number needs no scrolling
    # Each impact has a tick under the slider's knob at its time, and leads there.
    low, high = seen["track"][0] + 8, seen["track"][1] - 8
    shares = [(place - low) / (high - low) for place in seen["ticks"]]
    assert shares == pytest.approx(2 * [5.02 / HORIZON, CATCH / HORIZON], abs=0.01)
    assert seen["sought"] == pytest.approx(5.02, abs=0.01)
    assert seen["plan"] == "0"  # this plan has curves and no impacts
    # By touch: a dot says its seed, fallbacks their kinds.
    assert "seed 20000" in seen["tip"] and seen["opened"]


def test_suites_are_defined_on_the_page():
    base = {"description": "", "formula": "", "horizon": 1.0}
    changes = {"true.friction": {"uniform": [0.0, 0.5]}, "horizon_scale": 0.6}
    cases = [
        JudgedCase(name="a", suite="nominal", changes={}, **base),
        JudgedCase(name="a", suite="hard", changes=changes, **base),
        JudgedCase(name="b", suite="hard", changes=changes, **base),
        JudgedCase(name="b", suite="old", **base),
    ]
    head, nominal, hard, old = _Reader(write_suites(cases)).rows["suites-table"]
    assert head == ["Suite", "Scenarios", "The true world has"]
    assert nominal == ["nominal", "a", "what is believed, and no disturbance"]
    assert hard == ["hard", "a, b", "friction 0 to 0.5; horizon_scale 0.6"]
    assert "not kept" in old[2]


def test_learning_curve_is_read_from_the_training_run(tmp_path):
    looks = choose_looks([str(tmp_path / "run"), "expert"])
    assert collect_learning(looks) == [] and "no policy here" in write_learning([]).lower()
    folder = tmp_path / "run" / "checkpoints" / "7"
    folder.mkdir(parents=True)
    points = [{"steps": 100 * k, "gain": 0.01 * k, "low": -0.01, "success_rate": 1.0} for k in range(3)]
    (folder / "training.json").write_text(json.dumps({"evaluations": points}))
    (folder.parent / "8").mkdir()
    (folder.parent / "8" / "training.json").write_text("{")  # damaged: no curve is better than none of the page
    (curve,) = collect_learning(looks)
    assert curve["steps"] == [0, 100, 200] and curve["gain"] == [0.0, 0.01, 0.02]
    assert 'id="learning-0"' in write_learning([curve])


def test_a_page_of_many_replays_stays_small(evaluation, monkeypatch, tmp_path):
    """84 replays, as of 14 scenarios, 2 suites and 3 policies, each of 6,000 samples."""
    one = _replay("nominal", "expert", True)
    copies = []
    for k in range(84):
        copies.append(one | {"scenario": f"throw{k // 6}", "suite": ("nominal", "restitution")[k % 2]})
    read = page_module.read_evaluation(evaluation)
    many = tuple(Replay.model_validate(copy) for copy in copies)
    monkeypatch.setattr(page_module, "read_evaluation", lambda directory: replace(read, replays=many))
    assert write_report(tmp_path).stat().st_size < 2e6
