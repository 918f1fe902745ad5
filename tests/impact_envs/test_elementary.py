"""Our elementary functions are right to one unit in the last place, and the same compiled and as plain Python."""

import math
import random

import numpy as np
import pytest
from mpmath import mp, mpf

from impact_envs import elementary
from impact_envs.compiled import compiled, interpret
from impact_envs.elementary import apply, atan, atan2, cos, cos_sin, exp, hypot, log, power, sin

ULP = 1.0
BITS = 400  # with which what is right is computed; angles up to 2^1023 need another 1000
INF, NAN = math.inf, math.nan


def draw(count, low, high, signs=(-1.0, 1.0)):
    """Return numbers whose logarithms to the base 2 are uniform."""
    rng = random.Random(1)
    return [rng.choice(signs) * 2.0 ** rng.uniform(low, high) for _ in range(count)]


def spread(count, low, high, seed=2):
    rng = random.Random(seed)
    return [rng.uniform(low, high) for _ in range(count)]


def surround(x, steps=2):
    """Return a number and its neighbours."""
    return [x + k * math.ulp(x) for k in range(-steps, steps + 1)]


def pair(first, second):
    return list(zip(first, second, strict=True))


QUARTERS = [y for k in range(1, 1030) for y in surround(float(mp.mpf(k) * mp.pi / 2))]
LARGE = [*draw(1000, 10.65, 1023.9), 6381956970095103.0 * 2.0**797, 5.319372648326541e255, 1e22, 1.7976931348623157e308]
ANGLES = [*spread(5000, -7.0, 7.0), *draw(3000, -40.0, 10.65), *QUARTERS, 1607.999, 1608.0, 5e-324, -5e-324, *LARGE]
EXPONENTS = [*spread(3000, -745.0, 709.7), *spread(3000, -2.0, 2.0), *draw(1000, -60.0, 0.0), 709.78, -708.5, -744.9]
NUMBERS = [*draw(3000, -1074.0, 1023.0, (1.0,)), *spread(3000, 0.4, 2.5), *(1.0 + d for d in draw(2000, -52.0, -1.0))]
BORDERS = [y for c in (0.25, 0.5, 0.72, 1.0, 1.4, 2.0, 4.0) for y in surround(c)]
RATIOS = [*draw(3000, -40.0, 40.0), *spread(3000, -5.0, 5.0), *BORDERS]
PLANE = pair(spread(4000, -1.0, 1.0), spread(4000, -1.0, 1.0, seed=3))
FAR = [
    *pair(draw(2000, -1074.0, 1023.0), spread(2000, 1e-300, 1e300)),
    *pair(draw(2000, -300.0, 300.0), reversed(draw(2000, -300.0, 300.0))),
    *[(1e308, 1e308), (5e-324, 5e-324)],
]
POWERS = [
    *pair(spread(3000, 1e-9, 0.1), 600 * [1.5, 2.5, 3.0, 1.1, 0.5]),
    *pair(draw(2000, -30.0, 30.0, (1.0,)), spread(2000, -16.0, 16.0)),
]
CASES = {
    "sin": (sin, mp.sin, ANGLES),
    "cos": (cos, mp.cos, ANGLES),
    "exp": (exp, mp.exp, EXPONENTS),
    "log": (log, mp.log, [*NUMBERS, 5e-324, 1.7976931348623157e308]),
    "atan": (atan, mp.atan, RATIOS),
    "atan2": (atan2, mp.atan2, [*PLANE, *FAR]),
    "hypot": (hypot, mp.hypot, [*PLANE, *FAR]),
    "power": (power, mp.power, POWERS),
}


@pytest.mark.parametrize("name", CASES)
def test_errors_stay_below_one_unit_in_the_last_place(name):
    function, right, arguments = CASES[name]
    plain, worst = interpret(function), 0.0
    for given in arguments:
        values = given if isinstance(given, tuple) else (given,)
        found = function(*values)
        with mp.workprec(BITS + (1000 if max(map(abs, values)) > 1e3 else 0)):
            exact = right(*map(mpf, values))
            nearest = float(exact)
            if math.isinf(nearest):
                assert found == nearest
            else:
                worst = max(worst, float(abs(mpf(found) - exact) / mpf(math.ulp(nearest))))
        assert plain(*values) == found
    assert worst < ULP


EXP = [(0.0, 1.0), (INF, INF), (-INF, 0.0), (NAN, NAN), (710.0, INF), (-746.0, 0.0)]
LOG = [(1.0, 0.0), (0.0, -INF), (-0.0, -INF), (-1.0, NAN), (INF, INF), (-INF, NAN), (NAN, NAN)]
HYPOT = [
    (3.0, -4.0, 5.0),
    (0.0, -0.0, 0.0),
    (-INF, NAN, INF),
    (NAN, INF, INF),
    (NAN, 1.0, NAN),
    (1.7e308, 1.7e308, INF),
]
POWER = [
    *[(0.0, 1.5, 0.0), (0.0, -1.5, INF), (2.0, 0.0, 1.0), (NAN, 0.0, 1.0), (1.0, NAN, 1.0), (-1.0, 1.5, NAN)],
    *[(INF, 2.0, INF), (INF, -2.0, 0.0), (2.0, NAN, NAN), (2.0, INF, INF), (0.5, INF, 0.0), (2.0, -INF, 0.0)],
    *[(3.7, 1.0, 3.7), (10.0, 400.0, INF), (10.0, -400.0, 0.0)],
]
PLACES = [0.0, -0.0, 2.0, -2.0, INF, -INF, NAN]
SPECIAL = [
    *((function, (x,), x) for function in (sin, atan) for x in (0.0, -0.0)),
    *((function, (x,), NAN) for function in (sin, cos) for x in (INF, -INF, NAN)),
    *((cos, (x,), 1.0) for x in (0.0, -0.0)),
    *((exp, (x,), right) for x, right in EXP),
    *((log, (x,), right) for x, right in LOG),
    *((hypot, (x, y), right) for x, y, right in HYPOT),
    *((power, (x, y), right) for x, y, right in POWER),
    *((atan2, (y, x), math.atan2(y, x)) for x in PLACES for y in PLACES),
]


@pytest.mark.parametrize(("function", "arguments", "right"), SPECIAL)
def test_zeros_keep_their_sign_and_infinities_have_limits(function, arguments, right):
    for found in (function(*arguments), interpret(function)(*arguments)):
        assert math.isnan(found) if math.isnan(right) else found == pytest.approx(right, rel=1e-15)
        assert math.isnan(right) or math.copysign(1.0, found) == math.copysign(1.0, right)


def test_a_direction_is_cosine_and_sine_and_of_opposite_angles_the_mirror_image():
    for angle in ANGLES[::10]:
        assert cos_sin(angle) == (cos(angle), sin(angle))
        assert cos_sin(-angle) == (cos(angle), -sin(angle))


@compiled
def fill(angles, directions):
    for k in range(len(angles)):
        directions[k, 0], directions[k, 1] = cos_sin(angles[k])


def test_loops_and_arrays_have_the_bits_of_single_calls():
    """A compiler may take several turns of a loop at once."""
    angles = np.array(ANGLES[:14000])
    directions = np.empty((len(angles), 2))
    fill(angles, directions)
    assert np.array_equal(directions[:, 0], apply(cos, angles))
    assert np.array_equal(directions[:, 1].reshape(2, -1), apply(sin, angles.reshape(2, -1)))


def test_known_values():
    assert cos_sin(math.pi / 2)[1] == exp(0.0) == power(2.0, 0.0) == 1.0
    assert atan2(-1.0, -1.0) == -3.0 * math.pi / 4.0
    assert (power(4.0, 1.5), power(0.25, 0.5), hypot(5.0, 12.0)) == (8.0, 0.5, 13.0)


def interpolate(function, low, high, count):
    """Return the coefficients of the polynomial through a function's values in Chebyshev's nodes, as doubles."""
    nodes = [(low + high) / 2 + (high - low) / 2 * mp.cos(mp.pi * (2 * k + 1) / (2 * count)) for k in range(count)]
    powers = mp.matrix([[node**j for j in range(count)] for node in nodes])
    return tuple(map(float, mp.lu_solve(powers, mp.matrix([function(node) for node in nodes]))))


def cut(number, *bits):
    """Return a number's parts, each the nearest one with so many bits to what the parts before leave."""
    parts = []
    for size in bits:
        scale = mpf(2) ** (size - 1 - mp.floor(mp.log(number, 2)))
        parts.append(mp.nint(number * scale) / scale)
        number -= parts[-1]
    assert all(float(part) == part for part in parts[:-1])
    return tuple(map(float, parts))


def test_coefficients_are_those_of_the_functions():
    with mp.workprec(BITS):
        turn, ratio = (mp.pi / 4) ** 2, (mp.sqrt(2) - 1) ** 4
        assert interpolate(lambda z: (mp.sin(mp.sqrt(z)) / mp.sqrt(z) - 1) / z, 0, turn, 7) == elementary.SIN
        assert interpolate(lambda z: (mp.cos(mp.sqrt(z)) - 1 + z / 2) / z**2, 0, turn, 7) == elementary.COS
        half = mp.log(2) / 2
        assert interpolate(lambda r: (mp.exp(r) - 1 - r - r * r / 2) / r**3, -half, half, 10) == elementary.EXP
        assert interpolate(lambda z: (2 * mp.atanh(mp.sqrt(z)) / mp.sqrt(z) - 2) / z, 0, ratio, 8) == elementary.LOG
        assert interpolate(lambda z: (1 - mp.atan(mp.sqrt(z)) / mp.sqrt(z)) / z, 0, mpf(1) / 16, 9) == elementary.ATAN


def test_constants_are_those_of_the_reductions():
    e = elementary
    with mp.workprec(2000):
        assert cut(mp.pi / 2, 43, 43, 53) == (e.QUARTER, e.QUARTER_2, e.QUARTER_3)
        assert (*cut(mp.pi / 2, 53, 53), *cut(mp.pi, 53, 53)) == (e.HALF_PI, e.HALF_PI_LOW, e.PI, e.PI_LOW)
        assert cut(mp.log(2), 42, 53) == (e.LOG_2, e.LOG_2_LOW)
        assert (float(2 / mp.pi), float(1 / mp.log(2))) == (e.PER_QUARTER, e.PER_LOG_2)
        assert cut(mp.atan(mpf(1) / 2), 53, 53) == (e.ANGLE_HALF, e.ANGLE_HALF_LOW)
        assert (
            *cut(mp.pi / 4, 53, 53),
            *cut(mp.atan(2), 53, 53),
        ) == (e.ANGLE_1, e.ANGLE_1_LOW, e.ANGLE_2, e.ANGLE_2_LOW)
        digits, rest = [0, 0, 0], 2 / mp.pi
        while len(digits) < len(e.DIGITS):
            rest *= 2**e.DIGIT
            digits.append(int(mp.floor(rest)))
            rest -= digits[-1]
        assert digits == e.DIGITS.tolist()
