"""Tapes in kernels against numpy, complex steps, differences and sympy."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import sympy
from hunts import some

from kempe.constraints.text import parse_tape
from kempe.kernels.compiled import tape_evaluation

X, Y, T = sympy.symbols("x y t")
MEANT = {
    "x": X,
    "y": Y,
    "hypot": lambda a, b: sympy.sqrt(a**2 + b**2),
    "radians": lambda a: a * sympy.pi / 180,
}


def form_of(text: str) -> sympy.Expr:
    """The expression as sympy reads it."""
    return sympy.sympify(text, MEANT)  # pyright: ignore


def run(t, inputs):
    """Outputs (N, m) and gradients (N, m, n) of a tape by the kernel, at inputs (N, n)."""
    ints, floats = t.make_arrays()
    n = len(inputs)
    values = np.full((n, len(t.outputs)), 7e77)
    gradients = np.full((n, len(t.outputs), len(t.inputs)), 7e77)
    tape_evaluation.evaluate_tape_gradients(
        ints, floats, np.ascontiguousarray(inputs, dtype=float), values, gradients
    )
    return values, gradients


def series(t, inputs):
    """Series (N, m, K + 1) of the outputs along curves (N, n, K + 1)."""
    ints, floats = t.make_arrays()
    inputs = np.ascontiguousarray(inputs, dtype=float)
    out = np.full((len(inputs), len(t.outputs), inputs.shape[2]), 7e77)
    tape_evaluation.evaluate_tape_series(ints, floats, inputs.shape[2] - 1, inputs, out)
    return out


FORMS = [
    "x + y",
    "x - y",
    "x*y",
    "x/y",
    "-x",
    "x**2",
    "x**5",
    "x**-3",
    "x**1.5",
    "x**y",
    "2**x",
    "sqrt(x)",
    "exp(x)",
    "log(x)",
    "sin(x)",
    "cos(x)",
    "tan(x)",
    "asin(x)",
    "acos(x)",
    "atan(x)",
    "sinh(x)",
    "cosh(x)",
    "tanh(x)",
    "asinh(x)",
    "acosh(x + 1)",
    "atanh(x)",
    "atan2(x, y)",
    "hypot(x, y)",
    "sin(x)*cos(y)/(1 + x**2)",
    "radians(x)",
    "x**70",
    "sqrt(x**2 + sin(y)**2)",
    "exp(-x*y)*atan2(sin(x), cos(y))",
    "3",
    "hypot(x*y, tan(y)) - acos(x*y/2)",
]


@pytest.mark.parametrize("text", FORMS)
def test_values_and_gradients_are_those_of_sympy(text, hunt):
    t = parse_tape(text, ["x", "y"])
    form = form_of(text)
    f = sympy.lambdify((X, Y), [form, *(form.diff(v) for v in (X, Y))], "numpy")
    at = hunt.rng().uniform(0.1, 0.9, size=(hunt.cases(30), 2))
    values, gradients = run(t, at[:, [("x", "y").index(name) for name in t.inputs]])
    judged = t.evaluate_outputs({"x": at[:, 0], "y": at[:, 1]})[..., 0]
    assert values[:, 0] == pytest.approx(np.broadcast_to(judged, len(at)), rel=4e-15, abs=1e-300)
    for k, (x, y) in enumerate(at):
        value, *rates = f(x, y)
        assert values[k, 0] == pytest.approx(value, rel=1e-13, abs=1e-14)
        by = dict(zip(t.inputs, gradients[k, 0], strict=True))
        assert [by.get("x", 0.0), by.get("y", 0.0)] == pytest.approx(rates, rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("text", some(FORMS, 3))
def test_series_are_those_of_sympy(text):
    """Taylor coefficients along a curve through a generic point, with 60 digits."""
    order = 6
    curve = {
        X: sympy.Rational(2, 5) + T / 2 - T**2 / 3 + T**4,
        Y: sympy.Rational(3, 5) - T + T**3 / 4,
    }
    f = sympy.lambdify(T, form_of(text).subs(curve, simultaneous=True), "mpmath")
    with mpmath.workdps(60):
        expected = [float(c) for c in mpmath.taylor(f, 0, order)]
    t = parse_tape(text, ["x", "y"])
    given = {"x": [0.4, 0.5, -1 / 3, 0, 1, 0, 0], "y": [0.6, -1, 0, 0.25, 0, 0, 0]}
    found = series(
        t, [[given[name] for name in t.inputs]] if t.inputs else np.empty((1, 0, order + 1))
    )
    assert found[0, 0] == pytest.approx(expected, rel=1e-11, abs=1e-12)


def composed(rng, depth):
    """A random composition that is defined near where it is evaluated."""
    if depth == 0:
        return str(rng.choice(["x", "y", "0.7", "(x + 2*y)"]))
    a = composed(rng, depth - 1)
    b = composed(rng, depth - 1)
    forms = [
        f"({a} + {b})",
        f"({a} - {b})",
        f"{a}*{b}",
        f"{a}/(2 + sin({b}))",
        f"sin({a})",
        f"cos({a})",
        f"exp(-({a})**2)",
        f"sqrt(1 + ({a})**2)",
        f"log(2 + cos({a}))",
        f"atan({a})",
        f"tanh({a})",
        f"asinh({a})",
        f"(1.5 + cos({a}))**0.7",
        f"atan2({a}, 2 + sin({b}))",
        f"hypot({a}, 1 + ({b})**2)",
        f"({a})**3",
        f"asin(sin({a})/2)",
        f"acos(cos({a})/2)",
        f"atanh(tanh({a})/2)",
        f"acosh(2 + cos({a}))",
        f"(2 + sin({a}))**cos({b})",
        f"1/(2 + cos({a}))**2",
    ]
    return str(rng.choice(forms))


def test_random_compositions_against_the_function_itself(hunt):
    """Gradients against the series along each axis, series against a circle of complex numbers."""
    rng = hunt.rng()
    order = 4
    points = 32
    radius = 0.05
    circle = radius * np.exp(2j * np.pi * np.arange(points) / points)
    for _ in range(hunt.cases(300)):
        text = f"{composed(rng, int(rng.integers(1, 4)))} + x*y"
        t = parse_tape(text, ["x", "y"])
        at = rng.uniform(0.2, 0.8, 2)
        way = rng.normal(size=(2, order)) / [[1, 2, 4, 8]]
        values, gradients = run(t, [at])
        along = series(t, [np.column_stack([at, way])])[0, 0]
        assert along[0] == pytest.approx(values[0, 0], rel=1e-13), text
        assert along[1] == pytest.approx(gradients[0, 0] @ way[:, 0], rel=1e-10, abs=1e-10), text
        powers = circle[:, None] ** np.arange(1, order + 1)
        x, y = at[:, None] + way @ powers.T
        with np.errstate(all="ignore"):
            f = complex_value(t, {"x": x, "y": y})
        coefficients = np.fft.fft(f)[: order + 1] / points / radius ** np.arange(order + 1)
        assert along == pytest.approx(
            coefficients.real, rel=1e-6, abs=1e-6 * np.abs(coefficients).max()
        ), text


def complex_value(t, x):
    """The output of a tape in complex numbers, where atan2 and hypot are analytic functions."""
    from kempe.constraints.tape import BINARY, UNARY
    from kempe.kernels.constraints import tape_layout as L

    found = [x[name] for name in t.inputs] + [None] * len(t.nodes)
    n = len(t.inputs)
    for i in t._list_needed_places():
        op, left, right = t.nodes[i - n]
        if op == L.NUMBER:
            found[i] = np.full(len(x["x"]), t.numbers[left], dtype=complex)
        elif op == L.ATAN2:
            found[i] = np.arctan(found[left] / found[right])  # the right half plane
        elif op == L.HYPOT:
            found[i] = np.sqrt(found[left] ** 2 + found[right] ** 2)
        else:
            found[i] = (
                BINARY[op](found[left], found[right]) if op in BINARY else UNARY[op](found[left])
            )
    return found[t.outputs[0]]


def test_kernel_and_judge_agree_on_random_tapes(hunt):
    """Values of the kernel against numpy, gradients against central differences of numpy."""
    rng = hunt.rng()
    h = 1e-6
    for _ in range(hunt.cases(300)):
        texts = [composed(rng, int(rng.integers(0, 4))) for _ in range(3)]
        t = parse_tape([*texts, "x - y"], ["x", "y"])
        at = rng.uniform(-2, 2, size=(4, 2))
        values, gradients = run(t, at)
        assert values == pytest.approx(
            t.evaluate_outputs({"x": at[:, 0], "y": at[:, 1]}), rel=1e-12, abs=1e-14, nan_ok=True
        )
        for k, step in enumerate(np.eye(2) * h):
            up, down = ({"x": p[:, 0], "y": p[:, 1]} for p in (at + step, at - step))
            slope = (t.evaluate_outputs(up) - t.evaluate_outputs(down)) / (2 * h)
            assert gradients[:, :, k] == pytest.approx(
                slope, rel=1e-5, abs=1e-5 * (1 + np.abs(slope).max())
            ), texts


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_powers_at_zero_are_exact(n):
    """A whole power of a series that begins late, also where the exponent is a parameter."""
    given = np.array([0.0, 0.0, 3.0, -1.0, 0.5, 2.0, 0.0, 1.0, 0.0])
    expected = np.array([1.0])
    for _ in range(n):
        expected = np.convolve(expected, given)[:9]
    for t in (parse_tape(f"x**{n}", ["x"]), parse_tape("x**n", ["x"], ["n"]).fix_inputs({"n": n})):
        assert series(t, [[given]])[0, 0] == pytest.approx(expected, abs=1e-14)
        assert series(t, np.zeros((1, 1, 9)))[0, 0] == pytest.approx(np.zeros(9), abs=0)
        assert run(t, [[0.0]])[1][0, 0, 0] == (1.0 if n == 1 else 0.0)


@pytest.mark.parametrize(
    ("text", "at"),
    [
        ("sqrt(x)", -1.0),
        ("log(x)", -1.0),
        ("log(x)", 0.0),
        ("asin(x)", 1.5),
        ("acos(x)", -1.5),
        ("acosh(x)", 0.5),
        ("atanh(x)", 1.0),
        ("1/x", 0.0),
        ("x/x", 0.0),
        ("x**1.5", -1.0),
        ("x**y", -1.0),
        ("sin(x)", np.inf),
        ("0*x", np.nan),
        ("0*x", np.inf),
        ("x**0.5 - x", np.nan),
        ("hypot(x, 1)", np.nan),
        ("exp(x)", 1e4),
    ],
)
def test_what_is_not_defined_is_no_number(text, at):
    t = parse_tape(text, ["x", "y"])
    values, gradients = run(t, [[at, 2.0][: len(t.inputs)]])
    assert not np.isfinite(values[0, 0]) and (text == "0*x" or not np.isfinite(gradients[0, 0, 0]))
    along = series(t, [[[at, 1.0, 0.0], [2.0, 0.0, 0.0]][: len(t.inputs)]])[0, 0]
    assert not np.isfinite(along[:2]).any() or text == "0*x"
    assert not np.isfinite(along[0])


CORNERS = {
    "sqrt(x)": (np.inf,),
    "hypot(x, y)": (np.nan,) * 2,
    "atan2(x, y)": (np.nan,) * 2,
    "y*sqrt(x)": (np.nan, 0),
}


@pytest.mark.parametrize(("text", "rates"), CORNERS.items())
def test_corners_have_no_gradient(text, rates):
    t = parse_tape(text, ["x", "y"])
    values, gradients = run(t, [[0.0] * len(t.inputs)])
    assert values[0, 0] == 0.0 and gradients[0, 0] == pytest.approx(rates, nan_ok=True)


def test_an_output_is_free_of_what_it_does_not_read():
    """The derivative of a neighbour may be infinite."""
    t = parse_tape(["y", "sqrt(x)", "x + y"], ["x", "y"])
    values, gradients = run(t, [[0.0, 2.0], [-1.0, np.nan]])
    assert gradients[0, 0].tolist() == [0.0, 1.0] and gradients[0, 2].tolist() == [1.0, 1.0]
    assert np.isinf(gradients[0, 1, 0]) and gradients[0, 1, 1] == 0.0
    assert np.isnan(values[1]).all() and gradients[1, 2].tolist() == [1.0, 1.0]


def test_exponents_that_move_are_refused():
    """A power whose exponent is a parameter has no series where the parameter is given one."""
    t = parse_tape("x**n", ["x"], ["n"])
    assert np.isfinite(series(t, [[[0.5, 1.0, 0.0], [1.5, 0.0, 0.0]]])).all()
    assert np.isnan(series(t, [[[0.5, 1.0, 0.0], [1.5, 0.5, 0.0]]])[0, 0, 1])
    _, gradients = run(t, [[0.5, 1.5]])
    assert gradients[0, 0] == pytest.approx([1.5 * 0.5**0.5, 0.5**1.5 * np.log(0.5)])


def test_an_empty_batch_and_no_inputs():
    assert run(parse_tape("x", ["x"]), np.empty((0, 1)))[0].shape == (0, 1)
    values, gradients = run(parse_tape(["2", "pi"], ["x"]), np.empty((3, 0)))
    assert values == pytest.approx(np.tile([2.0, np.pi], (3, 1))) and gradients.shape == (3, 2, 0)
