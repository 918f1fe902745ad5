"""The paper's own encoding as a reference: Bezier curves r(s), h(s) with the impact law on r' and on h'."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from planners.bezier import Curve
from planners.free_flyer.published.encoding_rows import BezierModel, build_bezier_model, differentiate
from planners.mixed_integer import Affine, evaluate
from planners.solvers import Squares, check_solver, solve

EXACT_LAW = 1e-12  # differences of masses and restitution that count as none


@dataclass(frozen=True)
class EncodingOptions:
    """Choose the form of the encoding.

    Args:
        curves: number of curves of every body, or body to number; other bodies have what the scenario says in `curves`,
            or else one of the next two numbers.
        robot_curves: of a robot.
        object_curves: of an object, and of every object on a constant grid.
        constant_grid: all curves of an object last equally long, which makes any impact exact.
        separation: keep robots from robots and objects from objects, Eq. (26); the published code leaves it out.
        attenuate: add Eq. (28), which makes the model quadratic: not for HiGHS.
        robustness_weight: of -rho beside Eq. (28).
        curvature_weight: of the squares of r'' in Eq. (28).
        rate_weight: of the squares of h'' in Eq. (28).

    Source: weights as in the published code.
    """

    curves: int | Mapping[str, int] | None = None
    robot_curves: int = 4
    object_curves: int = 6
    constant_grid: bool = False
    separation: bool = True
    attenuate: bool = False
    robustness_weight: float = 1e4
    curvature_weight: float = 0.05
    rate_weight: float = 0.1


@dataclass(frozen=True, eq=False)
class PointImpact:
    """Hold an impact of two points, with their physical velocities r' / h'.

    Args:
        time: instant of the impact [s].
        robot: name of the robot.
        object: name of the object.
        position: of both, shape (2,) [m].
        robot_minus, robot_plus: velocity of the robot just before and after, shape (2,) [m/s].
        object_minus, object_plus: velocity of the object just before and after, shape (2,) [m/s].
        error: greatest difference per axis between the velocities after it and those that Eq. (5) gives [m/s].
    """

    time: float
    robot: str
    object: str
    position: np.ndarray
    robot_minus: np.ndarray
    robot_plus: np.ndarray
    object_minus: np.ndarray
    object_plus: np.ndarray
    error: float


@dataclass(frozen=True)
class ModelSize:
    """Hold the size of a mixed-integer model: numbers of binary and other variables, and of rows."""

    binaries: int
    continuous: int
    rows: int


@dataclass(frozen=True, eq=False)
class BezierPlan:
    """Hold a plan of points in the paper's encoding.

    Args:
        scenario: name of the scenario the plan was made for.
        horizon: duration T [s].
        r: body to control points of r(s), shape (N, d+1, 2) [m].
        h: body to control points of h(s), shape (N, d+1) [s].
        impacts: in the order of time.
        rho: robustness of the formula in this encoding, which is no more than that of the motions [m].
        bound: proven upper bound of rho with so many curves [m].
        attenuation: value of Eq. (28) with the published weights.
        objective: what was minimised: -rho, or Eq. (28) - 1e4 rho.
        objective_bound: its proven lower bound.
        impact_error: greatest error of the impacts [m/s].
        is_exact: Eq. (24) is Eq. (5) here: equal masses and e = 1, or a constant grid.
        build_seconds: wall time of writing the model down [s].
        solve_seconds: wall time of the solver [s].
        size: of the model.
    """

    scenario: str
    horizon: float
    r: dict[str, np.ndarray]
    h: dict[str, np.ndarray]
    impacts: tuple[PointImpact, ...]
    rho: float
    bound: float
    attenuation: float
    objective: float
    objective_bound: float
    impact_error: float
    is_exact: bool
    build_seconds: float
    solve_seconds: float
    size: ModelSize

    @property
    def warning(self) -> str | None:
        """Return what is wrong with the physics of the plan; None: nothing."""
        if self.is_exact:
            return None
        return (
            "this encoding imposes the impact law on r' and on h' separately; for velocities r' / h' that is exact "
            "only with equal masses and e = 1, or on a constant grid; here impacts are off by up to "
            f"{self.impact_error:.3g} m/s"
        )

    def positions(self, times: np.ndarray, steps: int = 1000) -> dict[str, np.ndarray]:
        """Return where bodies are, p(t) = r(s) with h(s) = t, by interpolation between points of their curves.

        Args:
            times: shape (n,) [s].
            steps: points per curve to interpolate between.

        Returns:
            Body to positions, shape (n, 2) [m].

        Source: Verhagen & Tumova, Eq. (11).
        """
        found = {}
        for name, points in self.r.items():
            parameter = np.arange(len(points) + 1.0)
            s = np.linspace(0.0, len(points), steps * len(points) + 1)
            both = np.repeat(self.h[name][..., None], 2, axis=2)
            place, instant = Curve(parameter, points).position(s), Curve(parameter, both).position(s)[:, 0]
            found[name] = np.stack([np.interp(times, instant, place[:, axis]) for axis in range(2)], axis=1)
        return found


def make_bezier_plan(
    scenario: FreeFlyerScenario,
    *,
    solver: str = "highs",
    max_impacts: int | None = None,
    time_limit: float = 60.0,
    relative_gap: float = 1e-6,
    options: EncodingOptions = EncodingOptions(),
) -> BezierPlan:
    r"""Plan points by the paper's encoding: max rho, or max rho - 1e-4 Eq. (28).

    Robots have curves of degree 5, objects of degree 1. The impact law is imposed as printed, on r' and on h',
    while the velocity is r' / h'. The quotient obeys Eq. (5) only if m4 = m1 = 0, or if h'_R = h'_O before impacts,
    which a constant grid demands.

    Args:
        scenario: any number of robots and objects, taken as points; only believed physics are read.
        solver: a key of `planners.solvers.SOLVERS`.
        max_impacts: greatest number of impacts; None: as many as the curves have ends.
        time_limit: of the solver [s].
        relative_gap: of the objective at which the solver stops; infinite: at the first plan.
        options: form of the encoding.

    Returns:
        The best plan found, with its bound and its error of Eq. (5).

    Raises:
        InputError: bad numbers or names, a formula of an unsupported form, or a solver that is not there.
        Infeasible: no plan with so many curves.
        SolverFailed: no plan within the time limit, or the solver cannot take the model.

    Source: Verhagen & Tumova, Sec. IV-B, V; degrees, bounds of h' and weights from their published code.
    """
    _check_arguments(scenario, options, max_impacts, time_limit, relative_gap)
    check_solver(solver)
    start = time.perf_counter()
    counts = _count_curves(scenario, options)
    bezier = build_bezier_model(scenario, counts, options.constant_grid, options.separation, max_impacts)
    squares = _write_attenuation(bezier, scenario, options)
    if options.attenuate:
        bezier.model.objective = bezier.rho * -options.robustness_weight
    built = time.perf_counter()
    solution = solve(bezier.model, time_limit, relative_gap, solver, squares if options.attenuate else ())
    solved = time.perf_counter()
    r, h = ({name: evaluate(points, solution.x) for name, points in part.items()} for part in (bezier.r, bezier.h))
    impacts = _read_impacts(scenario, bezier, r, h, solution.x)
    return BezierPlan(
        scenario=scenario.name,
        horizon=scenario.horizon,
        r=r,
        h=h,
        impacts=impacts,
        rho=bezier.rho.value(solution.x),
        bound=bezier.ceiling if options.attenuate else min(bezier.ceiling, -solution.bound),
        attenuation=sum(weight * expression.value(solution.x) ** 2 for weight, expression in squares),
        objective=solution.objective,
        objective_bound=solution.bound,
        impact_error=max((impact.error for impact in impacts), default=0.0),
        is_exact=options.constant_grid or _is_swap(scenario),
        build_seconds=built - start,
        solve_seconds=solved - built,
        size=_measure(bezier),
    )


def _check_arguments(
    scenario: FreeFlyerScenario,
    options: EncodingOptions,
    max_impacts: int | None,
    time_limit: float,
    relative_gap: float,
) -> None:
    for name, count in _list_asked(scenario, options).items():
        if name not in scenario.bodies:
            raise InputError(f"curves: body '{name}' is unknown; {choices(name, scenario.bodies)}")
        if count < 1:
            raise InputError(f"curves: {name} has {count}, it needs at least 1")
    if scenario.starts_moving:
        raise InputError(f"{scenario.name}: start_velocity: this planner takes bodies that start at rest")
    if max_impacts is not None and max_impacts < 0:
        raise InputError(f"max_impacts is {max_impacts}, it must not be negative")
    if not time_limit > 0:
        raise InputError(f"time_limit is {time_limit} s, it must be positive")
    if not relative_gap >= 0:
        raise InputError(f"relative_gap is {relative_gap}, it must not be negative")


def _count_curves(scenario: FreeFlyerScenario, options: EncodingOptions) -> dict[str, int]:
    counts = {}
    for name in scenario.bodies:
        is_robot = name in scenario.robots
        usual = options.robot_curves if is_robot else options.object_curves
        stated = None if options.constant_grid and not is_robot else scenario.body(name).curves
        counts[name] = stated or usual
    return counts | _list_asked(scenario, options)


def _list_asked(scenario: FreeFlyerScenario, options: EncodingOptions) -> dict[str, int]:
    curves = options.curves
    return dict.fromkeys(scenario.bodies, curves) if isinstance(curves, int) else dict(curves or {})


def _write_attenuation(bezier: BezierModel, scenario: FreeFlyerScenario, options: EncodingOptions) -> Squares:
    """Return Eq. (28): the squares of all control points of the robots' r'' and h''."""
    squares = []
    for name in scenario.robots:
        for weight, points in ((options.curvature_weight, bezier.r[name]), (options.rate_weight, bezier.h[name])):
            second = differentiate(differentiate(points))
            squares += [(weight, Affine({}) + entry) for entry in second.ravel()]
    return squares


def _read_impacts(
    scenario: FreeFlyerScenario,
    bezier: BezierModel,
    r: dict[str, np.ndarray],
    h: dict[str, np.ndarray],
    x: np.ndarray,
) -> tuple[PointImpact, ...]:
    velocity = {name: differentiate(r[name]) / differentiate(h[name])[..., None] for name in scenario.bodies}
    impacts = []
    for (robot, i, name, j), hit in bezier.hits.items():
        if hit.value(x) < 0.5:
            continue
        masses = scenario.robots[robot].mass, scenario.objects[name].mass
        m1, m2, m3, m4 = compute_mass_fractions(*masses, scenario.believed.restitution)
        robot_minus, robot_plus = velocity[robot][i, -1], velocity[robot][i + 1, 0]
        object_minus, object_plus = velocity[name][j, -1], velocity[name][j + 1, 0]
        off_robot = robot_plus - m1 * robot_minus - m2 * object_minus
        off_object = object_plus - m3 * robot_minus - m4 * object_minus
        impacts.append(
            PointImpact(
                time=float(h[name][j, -1]),
                robot=robot,
                object=name,
                position=r[name][j, -1],
                robot_minus=robot_minus,
                robot_plus=robot_plus,
                object_minus=object_minus,
                object_plus=object_plus,
                error=float(np.abs([off_robot, off_object]).max()),
            )
        )
    return tuple(sorted(impacts, key=lambda impact: impact.time))


def _is_swap(scenario: FreeFlyerScenario) -> bool:
    """Return whether every impact swaps the velocities, which r' and h' can do separately."""
    e = scenario.believed.restitution
    pairs = [(robot.mass, body.mass) for robot in scenario.robots.values() for body in scenario.objects.values()]
    fractions = [compute_mass_fractions(*pair, e) for pair in pairs]
    return all(abs(m1) < EXACT_LAW and abs(m4) < EXACT_LAW for m1, _, _, m4 in fractions)


def _measure(bezier: BezierModel) -> ModelSize:
    model = bezier.model
    binaries = sum(model.integer)
    return ModelSize(binaries, len(model.integer) - binaries, len(model.inequalities) + len(model.equalities))
