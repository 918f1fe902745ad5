"""Elementary functions of our own: the same bits on every processor, compiled or not, whatever the C library.

C libraries round such functions as they like: glibc has one version of each for processors with fused multiply-add and
one for those without. Here are only sums, products, quotients, square roots and exact operations, in which IEEE 754
leaves no choice; the compiler fuses none (see `compiled`). Errors stay below one unit in the last place.

Arguments are reduced with constants of two or three parts, the first of so few bits that their products are exact.
Polynomials interpolate what a function's first terms leave, in the Chebyshev nodes of the reduced range, computed with
400 bits: `tests/impact_envs/test_elementary.py` computes constants and coefficients anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from impact_envs.compiled import compiled, inlined

# x + ROUND - ROUND is the whole number nearest to x, for |x| < 2**51.
ROUND = 1.5 * 2.0**52
SPLIT = 2.0**27 + 1.0  # cuts a double in two halves, whose products are exact

# pi / 2 in 43 + 43 + 53 bits, for angles up to LARGEST, 1024 quarter turns; below LEAST, sin(x) is x.
QUARTER, QUARTER_2, QUARTER_3 = 1.5707963267948344, 6.223372171896261e-14, 3.5215598651832e-27
PER_QUARTER, LARGEST, LEAST = 0.6366197723675814, 1608.0, 2.0**-27
HALF_PI, HALF_PI_LOW, PI, PI_LOW = 1.5707963267948966, 6.123233995736766e-17, 3.141592653589793, 1.2246467991473532e-16
# 2 / pi after the point in digits of 24 bits, for greater angles; zeros before them stand for the digits in front.
DIGIT, MASK = 24, 2**24 - 1
_DIGITS = (
    *(0, 0, 0, 10680707, 7228996, 1387004, 2578385, 16069853, 12639074, 9804092, 4427841, 16666979, 11263675, 12935607),
    *(2387514, 4345298, 14681673, 3074569, 13734428, 16653803, 1880361, 10960616, 8533493, 3062596, 8710556, 7349940),
    *(6258241, 3772886, 3769171, 3798172, 8675211, 12450088, 3874808, 9961438, 366607, 15675153, 9132554, 7151469),
    *(3571407, 2607881, 12013382, 4155038, 6285869, 7677882, 13102053, 15825725, 473591, 9065106, 15363067, 6271263),
    *(9264392, 5636912, 4652155, 7056368, 13614112),
)
DIGITS = np.array(_DIGITS)  # of a tuple each place would be a branch of the code, wherever an angle is looked at
# (sin(x) / x - 1) / x^2 and (cos(x) - 1 + x^2 / 2) / x^4, in x^2 up to (pi / 4)^2.
SIN = (
    *(-0.16666666666666666, 0.008333333333333331, -0.00019841269841265065, 2.7557319219339167e-06),
    *(-2.5052106232447578e-08, 1.6058531618986147e-10, -7.586697117706918e-13),
)
COS = (
    *(0.041666666666666664, -0.0013888888888888887, 2.4801587301584645e-05, -2.7557319221402824e-07),
    *(2.087675579108042e-09, -1.1470460887609959e-11, 4.7458719020432915e-14),
)

# log(2) in 42 + 53 bits, the inverse, and where exp(x) overflows and vanishes.
LOG_2, LOG_2_LOW, PER_LOG_2 = 0.6931471805598903, 5.497923018708371e-14, 1.4426950408889634
OVERFLOW, UNDERFLOW = 709.79, -745.2
# (exp(x) - 1 - x - x^2 / 2) / x^3 up to log(2) / 2.
EXP = (
    *(0.16666666666666669, 0.041666666666666664, 0.008333333333330065, 0.0013888888888886554, 0.00019841269863040545),
    *(2.4801587317135164e-05, 2.7557268480310024e-06, 2.755728298405588e-07, 2.5100375832561234e-08),
    2.091122972975856e-09,
)
# (log((1 + s) / (1 - s)) / s - 2) / s^2, in s^2, where (1 + s) / (1 - s) is between sqrt(1/2) and sqrt(2).
LOG = (
    *(0.6666666666666666, 0.4000000000000088, 0.28571428570803614, 0.22222222391713917, 0.18181795640132906),
    *(0.15386239702814658, 0.13268773138656886, 0.13086626147840102),
)
ROOT_HALF = 0.7071067811865476
# (1 - atan(x) / x) / x^2, in x^2 up to 1 / 16; then the angles whose tangents are 1/2, 1 and 2, in two parts each.
ATAN = (
    *(0.3333333333333333, -0.19999999999998933, 0.1428571428525851, -0.11111111035986847, 0.09090902874969416),
    *(-0.07692017877237385, 0.06658687414697743, -0.057529943904780285, 0.041034266985419496),
)
ANGLE_HALF, ANGLE_HALF_LOW = 0.4636476090008061, 2.2698777452961687e-17
ANGLE_1, ANGLE_1_LOW = 0.7853981633974483, 3.061616997868383e-17
ANGLE_2, ANGLE_2_LOW = 1.1071487177940904, 9.40447137356638e-17
# Between these, squares of lengths neither overflow nor lose bits; lengths beyond are scaled.
SHORT, LONG, LONGEST, SCALE = 2.0**-450, 2.0**500, 2.0**900, 2.0**600


@inlined
def two_sum(a: float, b: float) -> tuple[float, float]:
    """Return a + b and its rounding error (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@inlined
def two_product(a: float, b: float) -> tuple[float, float]:
    """Return a b and its rounding error, for numbers whose product neither overflows nor loses bits (Dekker)."""
    p = a * b
    t = SPLIT * a
    a_high = t - (t - a)
    t = SPLIT * b
    b_high = t - (t - b)
    a_low, b_low = a - a_high, b - b_high
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low


@inlined
def cos_sin(x: float) -> tuple[float, float]:
    """Return cosine and sine of an angle, the direction that it points in.

    Args:
        x: any angle; NaN if it is infinite [rad].
    """
    if abs(x) < LEAST:
        return 1.0, x
    if abs(x) < LARGEST:
        n = (x * PER_QUARTER + ROUND) - ROUND
        quarter = int(n)
        r, low = two_sum(x - n * QUARTER, -(n * QUARTER_2))
        low -= n * QUARTER_3
    else:
        quarter, r, low = reduce_large(x)
    z = r * r
    w = z * z
    s0, s1, s2, s3, s4, s5, s6 = SIN
    c0, c1, c2, c3, c4, c5, c6 = COS
    sine_rest = (s0 + z * s1) + w * ((s2 + z * s3) + w * ((s4 + z * s5) + w * s6))
    cosine_rest = (c0 + z * c1) + w * ((c2 + z * c3) + w * ((c4 + z * c5) + w * c6))
    half = 0.5 * z
    sine = r + (r * z * sine_rest + low * (1.0 - half))
    near = 1.0 - half
    cosine = near + (((1.0 - near) - half) + (w * cosine_rest - r * low))
    c, s = (-sine, cosine) if quarter & 1 else (cosine, sine)
    sign = 1.0 - float(quarter & 2)
    return sign * c, sign * s


@compiled
def cos(x: float) -> float:
    """Return the cosine of an angle [rad]; of `cos_sin`."""
    return cos_sin(x)[0]


@compiled
def sin(x: float) -> float:
    """Return the sine of an angle [rad]; of `cos_sin`."""
    return cos_sin(x)[1]


@compiled
def reduce_large(x: float) -> tuple[int, float, float]:
    """Return quarter turns modulo 4, and what is left of an angle as a sum of two numbers; NaN if it is infinite.

    With x = m 2^(24 k), the digits of m meet those of 2 / pi. Products that are multiples of 4 are left out, and those
    that come 168 bits after the point: no double is nearer than 2^-62 to a quarter turn.

    Args:
        x: angle, at least `LARGEST` [rad].

    Source: Payne & Hanek, *Radian Reduction for Trigonometric Functions*, SIGNUM Newsletter 18 (1983).
    """
    if not abs(x) < math.inf:
        return 0, math.nan, math.nan
    fraction, exponent = math.frexp(abs(x))
    k = (exponent - 53) // DIGIT
    m, shift = int(fraction * 2.0**53), exponent - 53 - DIGIT * k
    total = (m & MASK) << shift
    m0 = total & MASK
    total = (((m >> DIGIT) & MASK) << shift) + (total >> DIGIT)
    m1 = total & MASK
    total = ((m >> 2 * DIGIT) << shift) + (total >> DIGIT)
    m2, m3 = total & MASK, total >> DIGIT
    turn, low, weight, carry = 0.0, 0.0, 2.0**-168, 0
    for place in range(7, 0, -1):
        at = k + place + 2
        total = m0 * DIGITS[at] + m1 * DIGITS[at + 1] + m2 * DIGITS[at + 2] + m3 * DIGITS[at + 3] + carry
        digit, carry = total & MASK, total >> DIGIT
        if place == 1 and digit > MASK // 2:
            digit, carry = digit - MASK - 1, carry + 1
        turn, error = two_sum(float(digit) * weight, turn)
        low += error
        weight *= 2.0**DIGIT
    at = k + 2
    total = m0 * DIGITS[at] + m1 * DIGITS[at + 1] + m2 * DIGITS[at + 2] + m3 * DIGITS[at + 3] + carry
    quarter = total & 3
    angle, error = two_product(turn, HALF_PI)
    error += turn * HALF_PI_LOW + low * HALF_PI
    return (quarter, angle, error) if x > 0.0 else (-quarter, -angle, -error)


@compiled
def exp(x: float) -> float:
    """Return e^x; infinity where that is too large for a double, 0 where it is too small."""
    return exp_sum(x, 0.0)


@compiled
def exp_sum(x: float, low: float) -> float:
    """Return e^(x + low), for |low| far below 1."""
    if x != x:
        return x
    if x > OVERFLOW:
        return math.inf
    if x < UNDERFLOW:
        return 0.0
    n = (x * PER_LOG_2 + ROUND) - ROUND
    a, b = x - n * LOG_2, n * LOG_2_LOW
    r = a - b
    low += (a - r) - b
    square = r * r
    w = square * square
    e0, e1, e2, e3, e4, e5, e6, e7, e8, e9 = EXP
    rest = (e0 + r * e1) + square * (e2 + r * e3)
    rest += w * (((e4 + r * e5) + square * (e6 + r * e7)) + w * (e8 + r * e9))
    near, curve = 1.0 + r, 0.5 * square + r * square * rest
    small = ((1.0 - near) + r) + (curve + low * (near + curve))
    return math.ldexp(near + small, int(n))


@compiled
def split_log(x: float) -> tuple[float, float]:
    """Return n and f with x = 2^n (1 + f) and 1 + f from sqrt(1/2) to sqrt(2), for a positive number."""
    fraction, exponent = math.frexp(x)
    if fraction < ROOT_HALF:
        return float(exponent - 1), 2.0 * fraction - 1.0
    return float(exponent), fraction - 1.0


@compiled
def log(x: float) -> float:
    """Return the natural logarithm; minus infinity of 0, NaN of negative numbers."""
    if not 0.0 < x < math.inf:
        return x if x > 0.0 else -math.inf if x == 0.0 else math.nan
    n, f = split_log(x)
    s = f / (2.0 + f)
    half = 0.5 * f * f
    return n * LOG_2 - ((half - (s * (half + sum_log(s * s)) + n * LOG_2_LOW)) - f)


@inlined
def sum_log(z: float) -> float:
    """Return log((1 + s) / (1 - s)) / s - 2 for z = s^2."""
    w = z * z
    l0, l1, l2, l3, l4, l5, l6, l7 = LOG
    return z * (((l0 + z * l1) + w * (l2 + z * l3)) + w * w * ((l4 + z * l5) + w * (l6 + z * l7)))


@compiled
def power(x: float, y: float) -> float:
    """Return x^y of x >= 0, NaN of negative numbers; to one unit in the last place for |y| up to 16.

    The logarithm is a sum of two numbers, of 61 bits: beyond, the relative error is y 2^-61.
    """
    if y == 0.0 or x == 1.0:
        return 1.0
    if y == 1.0 or x != x:
        return x
    if not 0.0 < x < math.inf or y != y:
        return math.nan if x < 0.0 or y != y else 0.0 if (x == 0.0) == (y > 0.0) else math.inf
    n, f = split_log(x)
    d, d_low = two_sum(2.0, f)
    s = f / d
    p, error = two_product(s, d)
    rest = 2.0 * (((f - p) - error - s * d_low) / d) + s * sum_log(s * s) + n * LOG_2_LOW
    high, low = two_sum(n * LOG_2, 2.0 * s)
    high, low = two_sum(high, low + rest)
    if not abs(y * high) < 1000.0:
        return exp(y * high)
    p, error = two_product(y, high)
    return exp_sum(p, error + y * low)


@compiled
def atan2(y: float, x: float) -> float:
    """Return the angle of the direction (x, y), from -pi to pi; signs of zero and infinities as in IEEE 754 [rad]."""
    a, b = abs(x), abs(y)
    longest = max(a, b)
    if x != x or y != y:
        return math.nan
    if longest == math.inf:
        a, b = (1.0 if a == math.inf else 0.0), (1.0 if b == math.inf else 0.0)
    elif not SHORT < longest < LONGEST:
        scale = SCALE if longest < 1.0 else 1.0 / SCALE
        a, b = scale * a, scale * b
    high, low = find_angle(a, b)
    if math.copysign(1.0, x) < 0.0:
        high, error = two_sum(PI, -high)
        high += error + (PI_LOW - low)
    return math.copysign(high, y)


@compiled
def atan(x: float) -> float:
    """Return the angle whose tangent is x, from -pi / 2 to pi / 2 [rad]."""
    return atan2(x, 1.0)


@inlined
def find_angle(a: float, b: float) -> tuple[float, float]:
    """Return the angle of the direction (a, b) in the first quadrant, as a sum of two numbers: 0 at the origin.

    From the nearest of the angles with the tangents 0, 1/2, 1, 2 and infinity, whose tangent c is exact:
    atan(b / a) = atan(c) + atan((b - c a) / (a + c b)).
    """
    if b <= 0.25 * a:
        base, base_low, c, numerator, d, d_low = 0.0, 0.0, 0.0, b, a, 0.0
    elif b >= 4.0 * a:
        base, base_low, c, numerator, d, d_low = HALF_PI, HALF_PI_LOW, 0.0, -a, b, 0.0
    else:
        if b <= 0.72 * a:
            base, base_low, c = ANGLE_HALF, ANGLE_HALF_LOW, 0.5
        elif b <= 1.4 * a:
            base, base_low, c = ANGLE_1, ANGLE_1_LOW, 1.0
        else:
            base, base_low, c = ANGLE_2, ANGLE_2_LOW, 2.0
        numerator = b - c * a
        d, d_low = two_sum(a, c * b)
    if d == 0.0:
        return 0.0, 0.0
    t = numerator / d
    t_low = 0.0
    if abs(numerator) > SHORT * SHORT and abs(t) > SHORT * SHORT:
        p, error = two_product(t, d)
        t_low = (((numerator - p) - error) - t * d_low) / d
    z = t * t
    w = z * z
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = ATAN
    rest = ((a0 + z * a1) + w * (a2 + z * a3)) + w * w * ((a4 + z * a5) + w * (a6 + z * a7 + w * a8))
    high, error = two_sum(base, t)
    low = error + ((base_low + t_low) - t * z * rest)
    s = high + low
    return s, (high - s) + low


@compiled
def hypot(x: float, y: float) -> float:
    """Return the length of a vector, sqrt(x^2 + y^2), wherever that is a double."""
    a, b = max(abs(x), abs(y)), min(abs(x), abs(y))
    if SHORT < a < LONG:
        return refine_length(a, b)
    if a == 0.0 or abs(x) == math.inf or abs(y) == math.inf:
        return math.inf if a != 0.0 else 0.0
    scale = SCALE if a < 1.0 else 1.0 / SCALE
    return refine_length(scale * a, scale * b) / scale


@inlined
def refine_length(a: float, b: float) -> float:
    """Return the length of a vector with parts a >= b >= 0: a square root, and one step of Newton's method from it."""
    aa, a_error = two_product(a, a)
    bb, b_error = two_product(b, b)
    h = math.sqrt(aa + bb)
    hh, h_error = two_product(h, h)
    return h + (((aa - hh) + bb) + (a_error + b_error - h_error)) / (2.0 * h)


def apply(function: Callable[[float], float], values: np.ndarray) -> np.ndarray:
    """Return an array of a function's values, the same bits as one by one."""
    return np.array([function(value) for value in values.ravel().tolist()]).reshape(values.shape)
