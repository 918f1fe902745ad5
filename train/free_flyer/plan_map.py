"""The map of a plan: areas, boxes, paths, bodies and impacts; and how bodies look."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon, Rectangle
from matplotlib.text import Text

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.picture import drawing
from impact_envs.picture.drawing import mix
from planners.bezier import Curve
from planners.plan import Plan
from train.free_flyer.picture_labels import Label, place_labels
from train.pictures.color import hex_color

SAMPLES = 24  # per segment of a curve


def draw_map(ground: Axes, scenario: FreeFlyerScenario, plan: Plan, styles: dict[str, Style]) -> None:
    """Draw the map of a plan.

    Args:
        ground: axes of equal scale, whose limits and place in the figure are settled.
        scenario: areas and bodies.
        plan: for these bodies.
        styles: from `choose_styles`.
    """
    areas = _draw_areas(ground, scenario)
    _draw_boxes(ground, plan, styles)
    _draw_paths(ground, plan, styles)
    for name, curve in list_curves(plan):
        _draw_arrows(ground, plan, name, curve, styles[name])
        _draw_body(ground, scenario, name, styles[name], curve.points[-1, -1])
    _write_labels(ground, scenario, plan, styles, areas)


@dataclass(frozen=True)
class Style:
    """How one body is drawn.

    Args:
        color: red, green, blue in 0..255.
        width: of its path [pt].
        dashes: of its path, as matplotlib's linestyle.
    """

    color: drawing.Color
    width: float
    dashes: Any

    def line(self, share: float = 1.0, width: float = 1.0) -> dict[str, Any]:
        """Return what a line of this body looks like."""
        return {"color": hex_color(mix(self.color, share)), "lw": width * self.width, "ls": self.dashes}


def choose_styles(scenario: FreeFlyerScenario) -> dict[str, Style]:
    """Return the renderer's colours, with other dashes where they begin anew.

    Args:
        scenario: whose bodies are drawn.

    Returns:
        Body to its style, robots first.
    """
    styles = {}
    kinds = ((scenario.robots, drawing.ROBOT_COLORS, 1.7), (scenario.objects, drawing.OBJECT_COLORS, 3.0))
    for names, colors, width in kinds:
        for k, name in enumerate(names):
            dashes = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)))[k // len(colors) % 3]
            styles[name] = Style(colors[k % len(colors)], width, dashes)
    return styles


def star(size: float) -> dict[str, Any]:
    """Return what the star of an impact looks like."""
    return {
        "marker": "*",
        "ms": size,
        "ls": "none",
        "mfc": hex_color(drawing.IMPACT),
        "mec": hex_color(drawing.PAPER),
        "mew": 0.8,
    }


def list_curves(plan: Plan) -> Iterator[tuple[str, Curve]]:
    """Return all curves, objects first, so that the thinner lines of robots lie on them."""
    return itertools.chain(plan.objects.items(), plan.robots.items())


def sample_curve(curve: Curve) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return samples of a curve; where segments meet, both limits.

    Args:
        curve: of degree 1 (then only ends are sampled) or higher.

    Returns:
        Times, shape (n,) [s]; positions, shape (n, 2) [m]; velocities, shape (n, 2) [m/s].
    """
    share = np.linspace(0.0, 1.0, SAMPLES if curve.degree > 1 else 2)
    times = curve.times[:-1, None] + share * np.diff(curve.times)[:, None]
    times[:, -1] = curve.times[1:]
    inner = curve.velocity(times.ravel(), "right").reshape(*times.shape, 2)
    inner[:, -1] = curve.velocity(curve.times[1:], "left")
    return times.ravel(), curve.position(times.ravel()), inner.reshape(-1, 2)


def _draw_areas(ground: Axes, scenario: FreeFlyerScenario) -> list[Text]:
    """Draw regions and obstacles; returns their names as written."""
    names: list[Text] = []
    for name, area in scenario.areas.items():
        region = name in scenario.regions
        fill = drawing.REGION if region else drawing.SOLID
        edge = drawing.REGION_EDGE if region else drawing.SOLID_EDGE
        ground.add_patch(Polygon(area.corners, fc=hex_color(fill), ec=hex_color(edge), lw=1.3, zorder=1))
        left, top = min(x for x, _ in area.corners), max(y for _, y in area.corners)
        ink = hex_color(drawing.REGION_INK if region else drawing.SOLID_INK)
        place = {"xytext": (4, -4), "textcoords": "offset points", "va": "top", "size": 8.5, "color": ink}
        names.append(ground.annotate(name, (left, top), **place, zorder=8))  # type: ignore[arg-type]
    return names


def _draw_boxes(ground: Axes, plan: Plan, styles: dict[str, Style]) -> None:
    """Draw where the boxes of objects are at the ends of their segments."""
    for name, tube in plan.tubes.items():
        color = styles[name].color
        for center, half in (tube.start[0], *tube.end):
            corner, extent = center[:2] - half[:2], 2 * half[:2]
            box = Rectangle(
                corner, *extent, fc=hex_color((*color, 31)), ec=hex_color(mix(color, 0.8)), lw=0.9, zorder=2
            )
            ground.add_patch(box)


def _draw_paths(ground: Axes, plan: Plan, styles: dict[str, Style]) -> None:
    """Draw responses, paths and impacts."""
    for name, curves in plan.responses.items():
        for curve in curves:
            _, points, _ = sample_curve(curve)
            ground.plot(*points.T, **styles[name].line(0.5, 0.4), zorder=3)
    for name, curve in list_curves(plan):
        _, points, _ = sample_curve(curve)
        ground.plot(*points.T, **styles[name].line(), solid_capstyle="round", zorder=4)
    places = np.array([impact.position for impact in plan.impacts]).reshape(-1, 2)
    ground.plot(*places.T, **star(15.0), zorder=7)


def _draw_arrows(ground: Axes, plan: Plan, name: str, curve: Curve, style: Style) -> None:
    """Put an arrowhead where half of every leg between impacts is behind, where the leg is long enough."""
    times, points, _ = sample_curve(curve)
    own = [impact.time for impact in plan.impacts if name in (impact.robot, impact.object)]
    least = 0.08 * float(np.ptp(ground.get_ylim()))
    for start, end in itertools.pairwise([0.0, *own, plan.horizon]):
        leg = points[(times >= start) & (times <= end)]
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(leg, axis=0).T))])
        if arc[-1] < least:
            continue
        here, ahead = (np.array([np.interp(s, arc, axis) for axis in leg.T]) for s in (arc[-1] / 2, 0.51 * arc[-1]))
        ground.annotate(
            "",
            tuple(ahead),
            tuple(here),
            arrowprops={"arrowstyle": "-|>", "color": hex_color(style.color), "mutation_scale": 15, "shrinkA": 0},
            zorder=5,
        )


def _draw_body(ground: Axes, scenario: FreeFlyerScenario, name: str, style: Style, end: np.ndarray) -> None:
    """Draw a body at its start, and its outline at its end."""
    body, edge = scenario.body(name), hex_color(mix(style.color, 0.8, drawing.INK))
    vertices = getattr(body, "vertices", None)
    for place, fill in ((end, None), (body.start, hex_color(mix(style.color, 0.85)))):
        look: dict[str, Any] = {"fc": fill or "none", "ec": edge, "lw": 1.2, "ls": "-" if fill else (0, (3, 2))}
        outline = Circle(tuple(place), body.radius, **look)
        shape = outline if vertices is None else Polygon(np.add(vertices, place), **look)
        shape.set_zorder(6 if fill else 3)
        ground.add_patch(shape)


def _write_labels(
    ground: Axes, scenario: FreeFlyerScenario, plan: Plan, styles: dict[str, Style], areas: Sequence[Text]
) -> None:
    """Write number, time and robot of impacts, and names of bodies."""
    labels = []
    for number, impact in enumerate(plan.impacts, start=1):
        text = f"{number}: {impact.time:.1f} s {impact.robot}"
        labels.append(Label(text, impact.position, 0.0, hex_color(drawing.IMPACT), "bold"))
    for name in scenario.bodies:
        body, color = scenario.body(name), hex_color(mix(styles[name].color, 0.6, drawing.INK))
        labels.append(Label(name, np.array(body.start), body.radius, color, "bold"))
    lines = np.concatenate([curve.position(np.linspace(0.0, plan.horizon, 600)) for _, curve in list_curves(plan)])
    place_labels(ground, labels, lines, areas, hex_color(drawing.WORLD))
