"""Robustness and satisfaction of traces whose values are known by hand."""

from dataclasses import dataclass

import numpy as np
import pytest

from impact_envs.errors import FormulaError, InputError
from impact_envs.stl import Trace, parse, robustness, robustness_signal, satisfied


@dataclass(frozen=True)
class Box:
    lower: tuple[float, float]
    upper: tuple[float, float]

    def halfspaces(self):
        normals = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        (x0, y0), (x1, y1) = self.lower, self.upper
        return normals, np.array([x1, -x0, y1, -y0])


@dataclass(frozen=True)
class Triangle:
    """x >= 0, y >= 0, x + y <= 1."""

    def halfspaces(self):
        slope = 1 / np.sqrt(2)
        return np.array([[-1.0, 0.0], [0.0, -1.0], [slope, slope]]), np.array([0.0, 0.0, slope])


AREAS = {"goal": Box((0, 0), (2, 1)), "wedge": Triangle()}


def make_trace(period=1.0, bodies=("pop", "snap"), **signals):
    return Trace({name.replace("_", "."): v for name, v in signals.items()}, period, AREAS, bodies)


def rho(text, **signals):
    return float(robustness(parse(text), make_trace(**signals)))


def test_area_robustness_is_the_distance_to_the_nearest_face():
    assert rho("pop in goal", pop_x=[0.5], pop_y=[0.6]) == pytest.approx(0.4)
    assert rho("pop in goal", pop_x=[2.5], pop_y=[0.5]) == pytest.approx(-0.5)
    assert rho("pop not in goal", pop_x=[2.5], pop_y=[0.5]) == pytest.approx(0.5)
    assert rho("pop in wedge", pop_x=[0.2], pop_y=[0.2]) == pytest.approx(0.2)
    assert rho("pop in wedge", pop_x=[1.0], pop_y=[1.0]) == pytest.approx(-np.sqrt(0.5))


def test_distance_speed_and_linear_robustness():
    positions = {"pop_x": [0.0], "pop_y": [0.0], "snap_x": [3.0], "snap_y": [4.0]}
    assert rho("distance(pop, snap) >= 4", **positions) == 1.0
    assert rho("distance(pop, snap) < 4", **positions) == -1.0
    assert rho("speed(pop) <= 10", pop_vx=[3.0], pop_vy=[4.0]) == 5.0
    assert rho("pop.x + 2*pop.y <= 3", pop_x=[0.5], pop_y=[0.5]) == 1.5
    assert rho("pop.x >= snap.x + 1", pop_x=[0.5], snap_x=[2.0]) == -2.5


def test_all_takes_the_worst_body():
    signals = {"pop_x": [0.5], "pop_y": [0.5], "snap_x": [0.1], "snap_y": [0.5]}
    assert rho("all in goal", **signals) == pytest.approx(0.1)
    assert rho("all not in goal", **signals) == pytest.approx(-0.5)


def test_temporal_operators_on_a_ramp():
    ramp = np.arange(11.0)
    assert rho("F[2,7] pop.x >= 0", pop_x=ramp) == 7
    assert rho("G[2,7] pop.x >= 0", pop_x=ramp) == 2
    assert rho("F[1,3] G[2,4] pop.x >= 0", pop_x=ramp) == 5
    assert rho("G[1,3] F[2,4] pop.x >= 0", pop_x=ramp) == 5
    assert rho("pop.x <= 6 U[2,7] pop.x >= 0", pop_x=ramp) == 3  # at 3: min(6 - 3, 3)


def test_until_needs_the_left_side_at_the_sample_that_completes_it():
    left, right = [1.0, -1.0, -1.0], [-1.0, 1.0, 1.0]
    assert rho("pop.x >= 0 U[0,2] snap.x >= 0", pop_x=left, snap_x=right) == -1
    assert rho("pop.x >= 0 U[0,2] snap.x >= 0", pop_x=[1.0, 1.0, -1.0], snap_x=right) == 1


def test_until_demands_the_left_side_before_its_interval():
    right = [5.0] * 4
    assert rho("pop.x >= 0 U[2,3] snap.x >= 0", pop_x=[1.0, -2.0, 3.0, 4.0], snap_x=right) == -2
    assert rho("pop.x >= 0 U[2,3] snap.x >= 0", pop_x=[1.0, 2.0, 3.0, -4.0], snap_x=right) == 1


def test_interval_ends_beside_a_sample_by_rounding_count():
    values = np.zeros(11)
    values[3] = 1.0
    assert rho("F[0.3,0.3] pop.x >= 0", period=0.1, pop_x=values) == 1  # 0.3 / 0.1 < 3 in floating point
    assert rho("F[0,0.3] pop.x >= 0", period=0.1, pop_x=values) == 1
    assert rho("F[0,0.29] pop.x >= 0", period=0.1, pop_x=values) == 0
    assert rho("F[0.31,1] pop.x >= 0", period=0.1, pop_x=values) == 0


def test_robustness_signal_is_the_robustness_of_every_later_start():
    values = np.random.default_rng(3).normal(size=40)
    formula = parse("F[1,4] (G[0,3] pop.x >= 0 | pop.x <= -1 U[2,5] pop.x >= 0.5)")
    later = robustness_signal(formula, make_trace(pop_x=values))
    assert later.shape == (40 - formula.reach(1.0),)
    assert later.tolist() == [float(robustness(formula, make_trace(pop_x=values[k:]))) for k in range(later.size)]


def test_boundaries_belong_to_closed_predicates_only():
    on_edge = {"pop_x": [2.0], "pop_y": [0.5]}
    assert satisfied(parse("pop in goal"), make_trace(**on_edge))
    assert not satisfied(parse("pop not in goal"), make_trace(**on_edge))
    assert not satisfied(parse("not pop in goal"), make_trace(**on_edge))
    assert satisfied(parse("pop.x <= 2 & pop.x >= 2"), make_trace(**on_edge))
    assert not satisfied(parse("pop.x < 2 | pop.x > 2"), make_trace(**on_edge))


def test_signals_with_different_batch_shapes_broadcast():
    left, right = np.array([1.0, 2.0, 3.0]), np.random.default_rng(0).normal(size=(4, 2, 3))
    for text in ("pop.x >= 0 U[1,2] snap.x >= 0", "snap.x >= 0 U[1,2] pop.x >= 0", "pop.x >= snap.x"):
        formula, trace = parse(text), make_trace(pop_x=left, snap_x=right)
        assert robustness(formula, trace).shape == satisfied(formula, trace).shape == (4, 2)


def test_not_a_number_is_not_judged():
    trace = make_trace(pop_x=[np.nan, 1.0, 2.0])
    assert np.isnan(robustness(parse("F[0,2] pop.x >= 0"), trace))
    with pytest.raises(InputError, match=r"'pop\.x' contains NaN"):
        satisfied(parse("F[0,2] pop.x >= 0"), trace)


@pytest.mark.parametrize("judge", [robustness, satisfied, robustness_signal])
def test_traces_that_do_not_fit(judge):
    trace = make_trace(period=0.1, pop_x=np.zeros(9), pop_y=np.zeros(9))
    with pytest.raises(FormulaError, match=r"looks 2 s ahead \(21 samples at 0\.1 s\).*is 0\.8 s long \(9 samp"):
        judge(parse("F[0,1] G[0,1] pop in goal"), trace)
    with pytest.raises(FormulaError, match=r"\[0\.11,0\.19\] s contains no sample at a period of 0\.1 s"):
        judge(parse("F[0.11,0.19] pop in goal"), trace)
    with pytest.raises(FormulaError, match="area 'gaol' is unknown; did you mean 'goal'"):
        judge(parse("pop in gaol"), trace)
    with pytest.raises(FormulaError, match=r"'pop\.vx' is not in the trace; .*choices: pop\.x, pop\.y"):
        judge(parse("pop.vx <= 1"), trace)


def test_traces_that_are_none():
    with pytest.raises(InputError, match=r"pop\.y: 2"):
        make_trace(pop_x=[0.0], pop_y=[0.0, 1.0])
    with pytest.raises(InputError, match="one common number of samples, got none"):
        make_trace()
    with pytest.raises(InputError, match=r"pop\.x: 0"):
        make_trace(pop_x=[])
    with pytest.raises(InputError, match="period 0"):
        make_trace(period=0, pop_x=[0.0])


def test_torch_gradient_is_that_of_the_sample_that_decides():
    torch = pytest.importorskip("torch")
    x = torch.tensor([0.0, 3.0, 1.0, 2.0], dtype=torch.float64, requires_grad=True)
    robustness(parse("F[0,3] pop.x >= 0"), make_trace(pop_x=x)).backward()
    assert x.grad.tolist() == [0, 1, 0, 0]


def test_torch_gradient_equals_finite_differences():
    torch = pytest.importorskip("torch")
    formula = parse(
        "G[0,2] F[1,3] pop in wedge & (distance(pop, snap) <= 3 U[1,4] speed(pop) >= 0.5) | G[0,5] pop.y >= 3"
    )
    names = ("pop_x", "pop_y", "pop_vx", "pop_vy", "snap_x", "snap_y")
    values = torch.tensor(np.random.default_rng(1).normal(size=(6, 2, 6)), requires_grad=True)

    def judge(flat):
        return robustness(formula, make_trace(**dict(zip(names, flat, strict=True))))

    assert torch.autograd.gradcheck(judge, (values,))


def test_torch_gradient_at_zero_distance_is_finite():
    torch = pytest.importorskip("torch")
    x = torch.zeros(3, requires_grad=True)
    trace = make_trace(pop_x=x, pop_y=x, snap_x=torch.zeros(3), snap_y=torch.zeros(3))
    robustness(parse("G[0,2] distance(pop, snap) <= 1"), trace).backward()
    assert torch.isfinite(x.grad).all()


def test_torch_and_numpy_signals_do_not_mix():
    torch = pytest.importorskip("torch")
    with pytest.raises(InputError, match="some are not"):
        make_trace(pop_x=torch.zeros(3), pop_y=np.zeros(3))
