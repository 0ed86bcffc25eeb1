"""Sine with cosine, and the angle of a point, for floats and vectors alike, without branches.

The functions of the C library do not vectorise. These do: some 40 operations for both sine and
cosine.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device
from kempe.kernels.base.vectors import copy_sign, is_negative, select_where

REACH = 1e8
"""Largest |x| for which `sincos` is right; there the quarter turns are counted exactly (fewer than
2**26)."""

ROUND = 1.5 * 2.0**52
"""x + ROUND - ROUND is x rounded to the nearest integer, for |x| < 2**51."""

# pi/2 in three parts (Cody and Waite 1980): the first two have at most 27 bits, so that their
# products with a count below 2**26 are exact with or without fused multiply-add.
QUARTER_1 = 1.570796325802803
QUARTER_2 = 9.920935184482005e-10
QUARTER_3 = 6.123233995736766e-17

# Minimax polynomials (Remez exchange, 60 digits) of (sin r / r - 1) / z and (cos r - 1 + z/2) /
# z**2,
# z = r**2, |r| <= pi/4; relative errors 3.4e-18 of sin r and 5.6e-20 of cos r.
S0 = -0.16666666666666632
S1 = 0.008333333333322425
S2 = -0.00019841269829817126
S3 = 2.7557313695247415e-06
S4 = -2.5050758653554223e-08
S5 = 1.589682786438747e-10
C0 = 0.041666666666666595
C1 = -0.0013888888888873058
C2 = 2.480158728885244e-05
C3 = -2.7557314179475125e-07
C4 = 2.0875700862508087e-09
C5 = -1.1358537420591712e-11


@device
def sincos(x):
    """Return sin x and cos x of a float or vector, |x| <= REACH, with an error below 1.8e-16; NaN
    and infinity give NaN.

    Beyond REACH the result is meaningless: there use `sincos_far`. The sign of sin(-0.0) is lost.
    """
    count = (x * 0.6366197723675814 + ROUND) - ROUND
    r = ((x - count * QUARTER_1) - count * QUARTER_2) - count * QUARTER_3
    z = r * r
    sine = r + r * z * (S0 + z * (S1 + z * (S2 + z * (S3 + z * (S4 + z * S5)))))
    cosine = (1.0 - 0.5 * z) + z * z * (C0 + z * (C1 + z * (C2 + z * (C3 + z * (C4 + z * C5)))))
    # quarter is -2 .. 2, the count modulo 4; its sine and cosine (in quarter turns) are polynomials
    # in it
    quarter = count - 4.0 * ((count * 0.25 + ROUND) - ROUND)
    size = abs(quarter)
    quarter_cosine = 1.0 - size
    quarter_sine = quarter * (2.0 - size)
    return (
        sine * quarter_cosine + cosine * quarter_sine,
        cosine * quarter_cosine - sine * quarter_sine,
    )


@device
def compute_sincos(x):
    """Return sin x and cos x of any float: by the polynomial up to REACH, by the C library beyond
    it.
    """
    if abs(x) <= REACH:
        return sincos(x)
    return math.sin(x), math.cos(x)


EIGHTH_1 = 0.7853981633974483
EIGHTH_2 = 3.061616997868383e-17
"""pi/4 = EIGHTH_1 + EIGHTH_2; the first has 50 bits, so that up to four of it are exact."""

BEND = 0.66
"""Ratio of the sides above which the angle is measured from the diagonal."""

# (atan t / t - 1) / z with z = t**2, |t| <= BEND (Remez exchange, 60 digits): relative error
# 1.3e-18
A0 = -0.33333333333333237
A1 = 0.19999999999976537
A2 = -0.1428571428372518
A3 = 0.11111111025430108
A4 = -0.09090906886465358
A5 = 0.0769227061437254
A6 = -0.06666235499087018
A7 = 0.058787582187222485
A8 = -0.05241156967974641
A9 = 0.04661588593725259
A10 = -0.040042511515128366
A11 = 0.031127040035073477
A12 = -0.01970784155820654
A13 = 0.008645775485216497
A14 = -0.0019014914592634848


@device
def atan2(y, x):
    """Return the angle of the point (x, y) in [-pi, pi], for floats or vectors; error below 2 ulp,
    signed zeros as in C.

    NaN gives NaN, and so do arguments that are infinite or have an infinite sum (where C gives an
    angle).
    """
    ax = abs(x)
    ay = abs(y)
    steep = ay > ax
    small = select_where(steep, ax, ay)
    large = select_where(steep, ay, ax)
    bent = small * (1.0 / BEND) > large  # rounds to the safe side at the smallest numbers
    top = select_where(bent, small - large, small)
    bottom = select_where(bent, small + large, large)
    t = top / select_where(bottom == 0.0, 1.0, bottom)
    z = t * t
    p = A8 + z * (A9 + z * (A10 + z * (A11 + z * (A12 + z * (A13 + z * A14)))))
    p = A0 + z * (A1 + z * (A2 + z * (A3 + z * (A4 + z * (A5 + z * (A6 + z * (A7 + z * p)))))))
    # 0 * bottom is NaN where an argument is not finite
    angle = t + (t * z * p + 0.0 * bottom)
    # the angle is eighths * pi/4 +- that, with the signs of the reflections at the diagonal and at
    # the y axis
    left = is_negative(x)
    eighths = select_where(bent, 1.0, 0.0)
    eighths = select_where(steep, 2.0 - eighths, eighths)
    angle = select_where(steep, -angle, angle)
    eighths = select_where(left, 4.0 - eighths, eighths)
    angle = select_where(left, -angle, angle)
    return copy_sign(eighths * EIGHTH_1 + (eighths * EIGHTH_2 + angle), y)
