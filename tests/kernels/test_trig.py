import math

import mpmath
import numba
import numpy as np
import pytest
from hunts import some
from hypothesis import given
from hypothesis import strategies as st

from kempe.kernels.base._jit import FLAGS
from kempe.kernels.base.trig import REACH, atan2, compute_sincos, sincos
from kempe.kernels.base.vectors import LANES, get_pointer, load_lanes, store_value

compiled = numba.njit(fastmath=FLAGS, error_model="numpy")


@compiled
def sincos_vectors(x, s, c):
    for i in range(0, x.size, LANES):
        a, b = sincos(load_lanes(get_pointer(x), i))
        store_value(get_pointer(s), i, a)
        store_value(get_pointer(c), i, b)


@compiled
def sincos_floats(x, s, c):
    for i in range(x.size):
        s[i], c[i] = compute_sincos(x[i])


@compiled
def atan2_vectors(y, x, out):
    for i in range(0, x.size, LANES):
        store_value(
            get_pointer(out), i, atan2(load_lanes(get_pointer(y), i), load_lanes(get_pointer(x), i))
        )


@compiled
def atan2_floats(y, x, out):
    for i in range(x.size):
        out[i] = atan2(y[i], x[i])


def both(function, *arguments, n_results):
    """The results of `function` for the arguments, padded to full vectors."""
    arguments = [np.asarray(a, dtype=float) for a in arguments]
    pad = -len(arguments[0]) % 8
    padded = [np.r_[a, np.ones(pad)] for a in arguments]
    out = [np.empty(len(padded[0])) for _ in range(n_results)]
    function(*padded, *out)
    return [o[: len(arguments[0])] for o in out]


def exact(function, *columns):
    """(value, value - double(value)) of a function of mpmath, as doubles."""
    with mpmath.workdps(60):
        values = [
            function(*map(mpmath.mpf, row))
            for row in zip(*(c.tolist() for c in columns), strict=True)
        ]
        heads = np.array([float(v) for v in values])
        return heads, np.array([float(v - h) for v, h in zip(values, heads.tolist(), strict=True)])


def nasty_angles():
    rng = np.random.default_rng(1)
    counts = np.r_[np.arange(-40, 41), rng.integers(-63_661_977, 63_661_977, 400)]
    near = counts * (math.pi / 2)
    eighths = (counts[counts % 2 == 0] + 0.5) * (math.pi / 2)
    x = np.r_[
        near,
        np.nextafter(near, np.inf),
        np.nextafter(near, -np.inf),
        eighths,
        np.nextafter(eighths, np.inf),
        0.0,
        -0.0,
        5e-324,
        -1e-310,
        1e-300,
        1e-20,
        1e-9,
        1e-8,
        0.5,
        1.0,
        REACH,
        -REACH,
    ]
    return x[np.abs(x) <= REACH]


@pytest.mark.parametrize("function", [sincos_vectors, sincos_floats])
@pytest.mark.parametrize("scale", some(["nasty", 1.0, 10.0, 1e3, 1e8], 3))
def test_sincos_is_right_to_one_ulp(function, scale):
    x = (
        nasty_angles()
        if scale == "nasty"
        else np.random.default_rng(0).uniform(-scale, scale, 3000)
    )
    s, c = both(function, x, n_results=2)
    for value, f in ((s, mpmath.sin), (c, mpmath.cos)):
        head, tail = exact(f, x)
        assert np.abs((value - head) - tail).max() < 2.3e-16


def test_sincos_of_small_angles_is_right_relatively():
    x = np.geomspace(1e-300, 1.5, 2000)
    s, _ = both(sincos_vectors, x, n_results=2)
    head, tail = exact(mpmath.sin, x)
    assert (np.abs((s - head) - tail) / head).max() < 3e-16


def test_sincos_of_floats_and_vectors_is_the_same():
    x = np.random.default_rng(3).uniform(-100, 100, 800)
    assert np.array_equal(both(sincos_vectors, x, n_results=2), both(sincos_floats, x, n_results=2))


def test_sincos_of_bad_numbers_is_nan():
    x = np.array([np.nan, np.inf, -np.inf])
    assert np.isnan(both(sincos_vectors, x, n_results=2)).all()
    assert np.isnan(both(sincos_floats, x, n_results=2)).all()


def test_far_angles_go_to_the_library():
    x = np.array([np.nextafter(REACH, np.inf), 3e9, -1e15, 1e22, -1e300, 1.7e308])
    s, c = both(sincos_floats, x, n_results=2)
    assert np.abs(s - exact(mpmath.sin, x)[0]).max() < 2.3e-16
    assert np.abs(c - exact(mpmath.cos, x)[0]).max() < 2.3e-16


def atan2_ulps(function, y, x):
    (value,) = both(function, y, x, n_results=1)
    head, tail = exact(mpmath.atan2, y, x)
    return np.abs((value - head) - tail) / np.spacing(np.abs(head))


@pytest.mark.parametrize("function", [atan2_vectors, atan2_floats])
def test_atan2_is_right_to_two_ulps(function):
    rng = np.random.default_rng(5)
    n = 4000
    x, y = rng.normal(size=(2, n))
    y *= 10.0 ** rng.uniform(-4, 4, n)
    assert atan2_ulps(function, y, x).max() < 2.0
    angle = rng.uniform(-np.pi, np.pi, n)
    assert atan2_ulps(function, np.sin(angle), np.cos(angle)).max() < 2.0


@pytest.mark.parametrize(("sx", "sy"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_atan2_where_its_branches_meet(sx, sy):
    ratio = np.array([0.66, 1.0, 1 / 0.66, 1e-300, 1e300, 3e-8])
    ratio = np.r_[ratio, np.nextafter(ratio, 0), np.nextafter(ratio, np.inf)]
    assert atan2_ulps(atan2_floats, sy * ratio, np.full(len(ratio), float(sx))).max() < 2.0


@given(*[st.floats(-1e300, 1e300, allow_subnormal=True)] * 2)
def test_atan2_agrees_with_the_library(y, x):
    (value,) = both(atan2_floats, [y], [x], n_results=1)
    expected = math.atan2(y, x)
    assert abs(value[0] - expected) <= 2.5 * np.spacing(abs(expected))
    assert math.copysign(1.0, value[0]) == math.copysign(1.0, expected)


@pytest.mark.parametrize("function", [atan2_vectors, atan2_floats])
def test_atan2_of_zeros_and_bad_numbers(function):
    zeros = [
        (0.0, 0.0),
        (-0.0, 0.0),
        (0.0, -0.0),
        (-0.0, -0.0),
        (1.0, 0.0),
        (-1.0, -0.0),
        (0.0, -3.0),
        (-0.0, -3.0),
    ]
    y, x = map(list, zip(*zeros, strict=True))
    (value,) = both(function, y, x, n_results=1)
    expected = np.array([math.atan2(b, a) for b, a in zeros])
    assert np.array_equal(value, expected) and np.array_equal(
        np.signbit(value), np.signbit(expected)
    )
    y = [np.nan, 1.0, np.inf, 1.0, -np.inf, np.nan, 1.7e308]
    x = [1.0, np.nan, 1.0, np.inf, np.inf, np.inf, 1.7e308]
    assert np.isnan(both(function, y, x, n_results=1)).all()
