"""Laws of STL on random formulas and traces, and agreement with the definition and with rtamt."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from impact_envs.stl import (
    Always,
    And,
    Distance,
    Eventually,
    Implies,
    In,
    Linear,
    Monitor,
    Not,
    Or,
    Predicate,
    Speed,
    Temporal,
    Trace,
    Until,
    parse,
    robustness,
    satisfied,
)
from tests.impact_envs.stl.samples import AREAS, BODIES, BOUNDS, LIMIT, PERIOD

CHECKED = settings(max_examples=60, deadline=None, derandomize=True, database=None)


bodies, areas = st.sampled_from(BODIES), st.sampled_from(sorted(AREAS))
relations = st.sampled_from(["<=", "<", ">=", ">"])
numbers = st.one_of(st.integers(-3, 3).map(float), st.floats(-3, 3))
terms = st.dictionaries(
    st.sampled_from(sorted(BOUNDS)), numbers.filter(lambda c: abs(c) > 1e-3), min_size=1, max_size=3
).map(lambda d: tuple(d.items()))
predicates = st.one_of(
    st.builds(In, st.sampled_from([*BODIES, "all"]), areas, st.booleans()),
    st.builds(Distance, st.just("pop"), st.just("snap"), relations, numbers),
    st.builds(Speed, st.sampled_from([*BODIES, "all"]), relations, numbers),
    st.builds(Linear, terms, relations, numbers),
)
intervals = st.tuples(st.integers(0, 3), st.integers(0, 5)).map(
    lambda ends: (ends[0] * PERIOD, (ends[0] + ends[1]) * PERIOD)
)


def compose(inner):
    pair = st.lists(inner, min_size=2, max_size=3).map(tuple)
    return st.one_of(
        st.builds(Not, inner),
        st.builds(And, pair),
        st.builds(Or, pair),
        st.builds(Implies, inner, inner),
        st.builds(Eventually, intervals, inner),
        st.builds(Always, intervals, inner),
        st.builds(Until, intervals, inner, inner),
    )


formulas = st.recursive(predicates, compose, max_leaves=6)


@st.composite
def tasks(draw, batch=()):
    """Draw a formula and a trace it can be judged on; whole numbers make robustness zero now and then."""
    formula = draw(formulas)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = (*batch, formula.reach(PERIOD) + 1 + draw(st.integers(0, 3)))
    values = {name: rng.uniform(-LIMIT, LIMIT, shape) for name in BOUNDS}
    if draw(st.booleans()):
        values = {name: np.round(value) for name, value in values.items()}
    return formula, Trace(values, PERIOD, AREAS, BODIES)


def judge_by_definition(formula, trace, judge, k=0):
    """Eq. 2, sample by sample; of truth values least and greatest are and, or.

    Args:
        judge: predicate and sample to its robustness, or to 1 or -1.
    """
    if isinstance(formula, Predicate):
        return judge(formula, k)
    values = [judge_by_definition(child, trace, judge, k) for child in formula.children]
    match formula:
        case Not():
            return -values[0]
        case And():
            return min(values)
        case Or():
            return max(values)
        case Implies():
            return max(-values[0], values[1])
    first, last = (k + round(end / trace.period) for end in formula.interval)
    right = [judge_by_definition(formula.children[-1], trace, judge, tau) for tau in range(first, last + 1)]
    match formula:
        case Eventually():
            return max(right)
        case Always():
            return min(right)
        case Until():
            left = [judge_by_definition(formula.left, trace, judge, s) for s in range(k, last + 1)]
            return max(min(r, *left[: first - k + i + 1]) for i, r in enumerate(right))
    raise TypeError(formula)


def read_mu(trace):
    """Return the robustness of a predicate at a sample of a trace."""

    def mu(predicate, k):
        signals = {name: value[..., k : k + 1] for name, value in trace.signals.items()}
        return float(robustness(predicate, Trace(signals, trace.period, trace.areas, trace.bodies)))

    return mu


def read_truth(trace):
    """Return whether a predicate holds at a sample of a trace, 1 or -1: at zero only if it is closed."""
    mu = read_mu(trace)

    def truth(predicate, k):
        return 1 if mu(predicate, k) > 0 or (mu(predicate, k) == 0 and not predicate.strict) else -1

    return truth


@CHECKED
@given(formulas)
def test_printed_formula_parses_back(formula):
    assert parse(str(formula)) == formula


@CHECKED
@given(tasks())
def test_robustness_and_satisfaction_are_the_definition(task):
    formula, trace = task
    temporal = sum(isinstance(node, Temporal) for node in formula.walk())
    assume(temporal <= 4)  # the definition costs window ** depth
    assert float(robustness(formula, trace)) == judge_by_definition(formula, trace, read_mu(trace))
    # Strictness is that of each predicate about one body.
    truth = judge_by_definition(formula.expand(BODIES), trace, read_truth(trace))
    assert bool(satisfied(formula, trace)) == (truth > 0)


@CHECKED
@given(tasks())
def test_sign_of_robustness_decides_satisfaction(task):
    formula, trace = task
    rho, truth = float(robustness(formula, trace)), bool(satisfied(formula, trace))
    assert truth or rho <= 0
    assert not truth or rho >= 0


@CHECKED
@given(tasks())
def test_negation_flips_sign_and_truth(task):
    formula, trace = task
    assert robustness(Not(formula), trace) == -robustness(formula, trace)
    assert satisfied(Not(formula), trace) == (not satisfied(formula, trace))


@CHECKED
@given(tasks(), intervals)
def test_always_is_not_eventually_not(task, interval):
    formula, trace = task
    always, dual = Always(interval, formula), Not(Eventually(interval, Not(formula)))
    assume(always.reach(PERIOD) < trace.length)
    assert robustness(always, trace) == robustness(dual, trace)
    assert satisfied(always, trace) == satisfied(dual, trace)


@CHECKED
@given(tasks(batch=(2, 3)))
def test_batch_equals_loop(task):
    formula, trace = task
    rho, truth = robustness(formula, trace), satisfied(formula, trace)
    assert rho.shape == truth.shape == (2, 3)
    for index in np.ndindex(2, 3):
        one = Trace({n: v[index] for n, v in trace.signals.items()}, PERIOD, AREAS, BODIES)
        assert rho[index] == robustness(formula, one)
        assert truth[index] == satisfied(formula, one)


@CHECKED
@given(tasks(batch=(2,)))
def test_torch_equals_numpy(task):
    torch = pytest.importorskip("torch")
    formula, trace = task
    tensors = {name: torch.from_numpy(value) for name, value in trace.signals.items()}
    same = Trace(tensors, PERIOD, AREAS, BODIES)
    np.testing.assert_allclose(robustness(formula, same).numpy(), robustness(formula, trace), rtol=0, atol=1e-12)
    assert satisfied(formula, same).tolist() == satisfied(formula, trace).tolist()


@CHECKED
@given(tasks(), st.sampled_from([0.25, 0.6, 3.0]))
def test_scaling_time_and_period_changes_nothing(task, factor):
    formula, trace = task
    stretched = Trace(trace.signals, PERIOD * factor, AREAS, BODIES)
    assert robustness(formula.scale_time(factor), stretched) == robustness(formula, trace)


@CHECKED
@given(tasks(), st.booleans(), st.integers(0, 2**32 - 1))
def test_monitor_interval_is_nested_sound_and_ends_at_the_offline_value(task, bounded, seed):
    formula, trace = task
    monitor = Monitor(formula, PERIOD, AREAS, BODIES, BOUNDS if bounded else None)
    offline = float(robustness(formula, trace))
    change = np.random.default_rng(seed).integers(trace.length + 1)
    low, high = monitor.interval
    verdict = monitor.verdict
    for k in range(trace.length):
        if k == change:
            check_other_continuation(formula, trace, k, seed, (low, high))
        new = monitor.update({name: value[k] for name, value in trace.signals.items()})
        assert low <= new[0] <= offline <= new[1] <= high
        assert verdict in (None, monitor.verdict)
        (low, high), verdict = new, monitor.verdict
    assert low == high == offline
    assert monitor.final
    assert verdict == bool(satisfied(formula, trace))


def check_other_continuation(formula, trace, k, seed, interval):
    """Whatever comes after k samples ends inside the interval they left possible."""
    other = np.random.default_rng(seed).uniform(-LIMIT, LIMIT, (20, len(BOUNDS), trace.length - k))
    signals = {
        name: np.concatenate((np.broadcast_to(trace.signals[name][:k], (20, k)), other[:, i]), axis=-1)
        for i, name in enumerate(BOUNDS)
    }
    rho = robustness(formula, Trace(signals, PERIOD, AREAS, BODIES))
    assert (interval[0] <= rho).all()
    assert (rho <= interval[1]).all()


def rtamt_text(formula, names):
    """Write a formula for rtamt over precomputed predicates, in samples.

    rtamt's until asks the left side only before the sample that completes it, the paper's also at it: p U q here is
    p until (p and q) there.
    """
    if isinstance(formula, Predicate):
        return f"({names[formula]} >= 0)"
    parts = [rtamt_text(child, names) for child in formula.children]
    match formula:
        case Not():
            return f"(not {parts[0]})"
        case And():
            return f"({' and '.join(parts)})"
        case Or():
            return f"({' or '.join(parts)})"
        case Implies():
            return f"({parts[0]} implies {parts[1]})"
    interval = "[" + ":".join(str(round(end / PERIOD)) for end in formula.interval) + "]"
    if isinstance(formula, Until):
        return f"({parts[0]} until{interval} ({parts[0]} and {parts[1]}))"
    return f"({'eventually' if isinstance(formula, Eventually) else 'always'}{interval} {parts[0]})"


@CHECKED
@given(tasks())
def test_robustness_is_that_of_rtamt(task):
    rtamt = pytest.importorskip("rtamt")
    formula, trace = task
    formula = formula.expand(BODIES)
    predicates = dict.fromkeys(node for node in formula.walk() if isinstance(node, Predicate))
    names = {predicate: f"p{i}" for i, predicate in enumerate(predicates)}
    spec = rtamt.StlDiscreteTimeSpecification()
    for name in names.values():
        spec.declare_var(name, "float")
    spec.spec = rtamt_text(formula, names)
    spec.parse()
    data = {"time": list(range(trace.length + 1))}  # rtamt cannot take one sample only
    for predicate, name in names.items():
        mu = [read_mu(trace)(predicate, k) for k in range(trace.length)]
        data[name] = [*mu, mu[-1]]
    assert spec.evaluate(data)[0][1] == float(robustness(formula, trace))
