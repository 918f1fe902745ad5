"""Bodies, areas, formulas and traces that several tests draw from."""

import numpy as np

from impact_envs.stl import Always, And, Distance, Eventually, Implies, In, Linear, Not, Or, Speed, Until

BODIES = ("pop", "snap")
NAMES = tuple(f"{body}.{name}" for body in BODIES for name in ("x", "y", "vx", "vy"))
LIMIT = 3.0  # of every signal
BOUNDS = dict.fromkeys(NAMES, (-LIMIT, LIMIT))
PERIOD = 0.1


class Area:
    def __init__(self, H, b):
        self.H, self.b = np.array(H), np.array(b)

    def halfspaces(self):
        return self.H, self.b


AREAS = {
    "goal": Area([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]], [1.0, 1.0, 1.0, 0.0]),
    "wall": Area([[0.6, 0.8], [-1.0, 0.0], [0.0, -1.0]], [1.5, 1.0, 1.0]),
}


def draw_predicate(rng):
    body, relation = rng.choice(["pop", "snap", "all"]), rng.choice(["<=", "<", ">=", ">"])
    bound = round(rng.uniform(-LIMIT, LIMIT), rng.integers(3))
    match rng.integers(4):
        case 0:
            return In(body, rng.choice(["goal", "wall"]), bool(rng.integers(2)))
        case 1:
            return Distance("pop", "snap", relation, bound)
        case 2:
            return Speed(body, relation, bound)
        case _:
            names = rng.choice(NAMES, rng.integers(1, 4), replace=False)
            return Linear(tuple((name, rng.choice([-1, 1]) * rng.uniform(0.1, 2)) for name in names), relation, bound)


def draw_interval(rng):
    first = rng.integers(6) * rng.integers(2)
    return (first * PERIOD, (first + rng.integers(9)) * PERIOD)


def draw_formula(rng, depth):
    """Return any formula of at most so many levels."""
    if depth == 0 or rng.random() < 0.15:
        return draw_predicate(rng)
    interval = draw_interval(rng)
    parts = [draw_formula(rng, depth - 1) for _ in range(3)]
    match rng.integers(7):
        case 0:
            return Not(parts[0])
        case 1:
            return And(tuple(parts[: rng.integers(2, 4)]))
        case 2:
            return Or(tuple(parts[: rng.integers(2, 4)]))
        case 3:
            return Implies(parts[0], parts[1])
        case 4:
            return Eventually(interval, parts[0])
        case 5:
            return Always(interval, parts[0])
        case _:
            return Until(interval, parts[0], parts[1])


def draw_alternation(rng, depth):
    """Return always eventually always ... of a formula about one instant, or its dual."""
    formula = draw_state(rng)
    kinds = [Always, Eventually] if rng.integers(2) else [Eventually, Always]
    for level in range(depth):
        formula = kinds[level % 2](draw_interval(rng), formula)
    return formula


def draw_join(rng):
    """Return an operator about an operator, or some, joined with formulas about one instant."""
    inner = draw_operator(rng)
    for _ in range(rng.integers(4)):
        kind, other = (And, Or, Implies)[rng.integers(3)], draw_operator(rng) if rng.random() < 0.2 else draw_state(rng)
        parts = [inner, other] if rng.integers(2) else [other, inner]
        inner = Implies(*parts) if kind is Implies else kind(tuple(parts))
    formula = (Always, Eventually)[rng.integers(2)](draw_interval(rng), inner)
    if rng.integers(2):
        formula = Until(draw_interval(rng), draw_state(rng), inner)
    return Not(formula) if rng.integers(2) else formula


def draw_operator(rng):
    """Return an operator about formulas about one instant."""
    match rng.integers(3):
        case 0:
            return Always(draw_interval(rng), draw_state(rng))
        case 1:
            return Eventually(draw_interval(rng), draw_state(rng))
        case _:
            return Until(draw_interval(rng), draw_state(rng), draw_state(rng))


def draw_state(rng):
    """Return a formula about one instant."""
    return draw_predicate(rng) if rng.integers(2) else And((draw_predicate(rng), Not(draw_predicate(rng))))


def draw_bounds(rng):
    """Nothing known, everything, or some signals with ends that may be infinite or false."""
    some = {"pop.x": (-LIMIT, LIMIT), "pop.y": (-1.0, 1.0), "snap.vx": (-np.inf, 2.0)}
    return (None, BOUNDS, some)[rng.integers(3)]


def draw_trace(rng, length):
    """Return samples, shape (length, signals): noise, whole numbers, which make ties and zeros, or smooth motion."""
    trace = rng.uniform(-LIMIT, LIMIT, (length, len(NAMES)))
    match rng.integers(3):
        case 0:
            return trace
        case 1:
            return np.round(trace)
        case _:
            return LIMIT * np.sin(np.cumsum(trace, axis=0) / 10)
