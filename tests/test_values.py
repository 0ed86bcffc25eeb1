"""Numbers and expressions of a description, and the placements made of them."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kempe.errors import InputError, UnknownNameError
from kempe.poses import Placement, check_step, make_placement_from_pose, place, read_placement_steps
from kempe.values import (
    FUNCTIONS,
    Expression,
    evaluate_value,
    negate_value,
    read_value,
    read_values,
)

PARAMETERS = {"a": 0.3, "b": -1.7, "l1": 2.5}

# ------------------------------------------------------------------ expressions

CASES = {
    "1.5": 1.5,
    "a": 0.3,
    "-a": -0.3,
    "+b": -1.7,
    "2*l1 + a": 5.3,
    "(a + b)*l1": (0.3 - 1.7) * 2.5,
    "l1/2": 1.25,
    "2**3**2": 512.0,
    "-a**2": -0.09,
    "a - b - l1": 0.3 + 1.7 - 2.5,
    "pi/2": math.pi / 2,
    "1e3*a": 300.0,
    "sin(a)": math.sin(0.3),
    "cos(a + pi)": math.cos(0.3 + math.pi),
    "tan(a)": math.tan(0.3),
    "asin(a)": math.asin(0.3),
    "acos(a)": math.acos(0.3),
    "atan(b)": math.atan(-1.7),
    "atan2(b, a)": math.atan2(-1.7, 0.3),
    "sqrt(l1)": math.sqrt(2.5),
    "radians(90)": math.pi / 2,
    "  a  ": 0.3,
}


@pytest.mark.parametrize("text", CASES)
def test_expressions_mean_what_they_say(text):
    assert Expression(text).evaluate(PARAMETERS) == pytest.approx(CASES[text], rel=1e-15)


@pytest.mark.parametrize("text", [t for t in CASES if t.strip()])
def test_expressions_broadcast(text):
    arrays = {k: v + np.array([0.0, 0.1, 0.2]) for k, v in PARAMETERS.items()}
    found = np.broadcast_to(Expression(text).evaluate(arrays), 3)
    for i in range(3):
        assert found[i] == pytest.approx(
            Expression(text).evaluate({k: v[i] for k, v in arrays.items()}), rel=1e-15
        )


def test_names_are_parameters_only():
    assert Expression("l1*cos(alpha) + pi").names == ("alpha", "l1")
    assert Expression("2*3").names == ()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1,5",
        "1 2",
        "a b",
        "a +",
        "(a",
        "f(a)",
        "a.b",
        "a[0]",
        "lambda: 1",
        "a if b else 1",
        "[a]",
        "'a'",
        "a == b",
        "a // b",
        "a % b",
        "~a",
        "not a",
        "a and b",
        "1j",
        "1e999",
        "True",
        "None",
        "sin(a, b)",
        "atan2(a)",
        "sin()",
        "sin(x=a)",
        "sin(*a)",
        "__import__('os')",
        "a := 1",
        "sin",
        "2*cos",
        "a; b",
        "9" * 400,
        "-" * 400 + "1",
        "(" * 300 + "1" + ")" * 300,
        "a" * 2000,
        "1" + "+1" * 450,
        "\x00",
        "x²",
        "∞",
    ],
)
def test_other_texts_are_refused(text):
    with pytest.raises(InputError) as error:
        Expression(text)
    assert len(str(error.value)) < 1200


@pytest.mark.parametrize(
    "text",
    ["1/0", "a/(a - a)", "0**-1", "sqrt(-1)", "(-8)**(1/3)", "asin(2)", "1e308*10", "9.0**9**9**9"],
)
def test_what_is_no_number_gives_nan_or_infinity(text):
    with np.errstate(all="ignore"):
        assert not np.isfinite(Expression(text).evaluate(PARAMETERS))


def test_unknown_parameter_is_named():
    with pytest.raises(UnknownNameError, match="no parameter 'length'; did you mean 'length_1'"):
        Expression("length/2").evaluate({"length_1": 1.0, "a": 2.0})


OPERATIONS = {
    "+": lambda x, y: x + y,
    "-": lambda x, y: x - y,
    "*": lambda x, y: x * y,
    "/": lambda x, y: x / y,
    "negative": lambda x, y: -x,
}


@given(data=st.data())
def test_python_arithmetic_writes_expressions(data):
    """Whatever order of operations Python reads, the text must read the same."""
    terms = [(Expression(n), x) for n, x in PARAMETERS.items()] + [
        (x, x) for x in (2.0, -0.5, 1e-3)
    ]
    for _ in range(8):
        (e1, n1) = data.draw(st.sampled_from(terms))
        (e2, n2) = data.draw(st.sampled_from(terms))
        name = data.draw(st.sampled_from(list(OPERATIONS)))
        if name == "/" and abs(n2) < 1e-9:
            continue
        expression = OPERATIONS[name](e1, e2)
        if len(str(expression)) < 300:
            terms.append((expression, OPERATIONS[name](n1, n2)))
    for expression, number in terms:
        assert evaluate_value(expression, PARAMETERS) == pytest.approx(number, rel=1e-14)


def test_powers_and_signs():
    a = Expression("a")
    assert ((-a) ** 2).evaluate({"a": 3.0}) == 9.0
    assert (2.0**a).evaluate({"a": 3.0}) == 8.0
    assert (-(a**2)).evaluate({"a": 3.0}) == -9.0
    assert negate_value(negate_value(a)).evaluate({"a": 3.0}) == 3.0 and negate_value(2.0) == -2.0
    assert (1 - (2 - a)).evaluate({"a": 3.0}) == 2.0


def test_expressions_are_values():
    a = Expression("a + 1")
    b = Expression(" a + 1")
    assert a == b and hash(a) == hash(b) and a != Expression("a+1") and a != "a + 1"
    assert (
        pickle.loads(pickle.dumps(a)) == a
        and str(a) == "a + 1"
        and repr(a) == "Expression('a + 1')"
    )


@pytest.mark.parametrize(
    "bad", [None, True, 1j, [1], math.nan, math.inf, -math.inf, np.nan, object()]
)
def test_values_must_be_numbers(bad):
    with pytest.raises(InputError, match="length is"):
        read_value(bad, "length")


def test_numbers_become_floats():
    for number in (2, 2.0, np.float32(2), np.int64(2)):
        assert type(read_value(number)) is float and read_value(number) == 2.0
    assert read_values(np.array([1.0, 2.0]), 2, "at") == (1.0, 2.0)
    for bad in (3.0, "ab", None, (1,), (1, 2, 3, 4)):
        with pytest.raises(InputError, match="at (is|has)"):
            read_values(bad, (2, 3), "at")


def test_functions_are_the_usual_ones():
    assert set(FUNCTIONS) == {
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "atan2",
        "sqrt",
        "hypot",
        "exp",
        "log",
        "sinh",
        "cosh",
        "tanh",
        "asinh",
        "acosh",
        "atanh",
        "radians",
        "degrees",
    }


# ------------------------------------------------------------------ placements


@given(xyz=st.tuples(*[st.floats(-5, 5)] * 3), rpy=st.tuples(*[st.floats(-4, 4)] * 3))
def test_place_is_position_then_fixed_axis_angles(xyz, rpy):
    np.testing.assert_allclose(
        place(xyz, rpy=rpy).evaluate_pose({}),
        reference.placement(xyz, rpy).astype(float),
        rtol=0,
        atol=1e-14,
    )


def test_all_ways_to_say_one_orientation():
    R = Rotation.from_euler("xyz", (0.3, -0.4, 1.2))
    x, y, z, w = R.as_quat()
    X = np.eye(4)
    X[:3, :3] = R.as_matrix()
    for placement in (
        place(rpy=(0.3, -0.4, 1.2)),
        place(quat_wxyz=(w, x, y, z)),
        place(quat_wxyz=(-2 * w, -2 * x, -2 * y, -2 * z)),
        place(matrix=R.as_matrix()),
        make_placement_from_pose(X),
    ):
        np.testing.assert_allclose(
            placement.evaluate_pose({})[:3, :3], R.as_matrix(), rtol=0, atol=1e-15
        )
    np.testing.assert_allclose(
        place(angle=0.7).evaluate_pose({}), place(rpy=(0, 0, 0.7)).evaluate_pose({}), atol=0
    )
    np.testing.assert_allclose(place((1, 2)).evaluate_pose({})[:3, 3], [1, 2, 0])


def test_axis_is_read_in_the_turned_frame():
    X = place((1, 2, 3), rpy=(0.3, -0.4, 1.2), axis=(0, 3, 4)).evaluate_pose({})
    R = Rotation.from_euler("xyz", (0.3, -0.4, 1.2)).as_matrix()
    np.testing.assert_allclose(X[:3, 2], R @ [0, 0.6, 0.8], rtol=0, atol=1e-15)
    assert place(axis=(0, 0, 5)).steps == () and place(axis=(1, 0)).evaluate_pose({})[0, 2] == 1.0


@given(seed=st.integers(0, 10**6))
def test_inverse_undoes_every_motion(seed):
    rng = np.random.default_rng(seed)
    X = Placement(
        (
            ("x", (rng.normal(),)),
            ("ry", (rng.normal(),)),
            ("align", tuple(rng.normal(size=3))),
            ("quat_wxyz", tuple(rng.normal(size=4))),
            ("matrix", tuple(Rotation.random(None, rng).as_matrix().ravel())),
            ("z", (Expression("2*d"),)),
            ("unalign", tuple(rng.normal(size=3))),
            ("rz", (Expression("-alpha"),)),
            ("y", (0.3,)),
            ("rx", (0.1,)),
        )
    )
    parameters = {"d": 0.4, "alpha": 1.1}
    np.testing.assert_allclose(
        (X @ X.invert_steps()).evaluate_pose(parameters), np.eye(4), rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        (X.invert_steps() @ X).evaluate_pose(parameters), np.eye(4), rtol=0, atol=1e-14
    )
    assert X.names == X.invert_steps().names == {"d", "alpha"}
    batch = X.evaluate_pose({"d": np.array([[0.4], [0.5]]), "alpha": np.array([1.1, 0.2, 0.3])})
    assert batch.shape == (2, 3, 4, 4)
    np.testing.assert_allclose(batch[0, 0], X.evaluate_pose(parameters), rtol=0, atol=1e-15)


def test_nearly_rotations_become_rotations():
    """A matrix written with ten digits is accepted, and must not leak its rounding into poses."""
    R = np.round(Rotation.from_euler("xyz", (0.3, -0.4, 1.2)).as_matrix(), 10)
    Q = place(matrix=R).evaluate_pose({})[:3, :3]
    assert np.abs(R @ R.T - np.eye(3)).max() > 1e-12
    assert np.abs(Q @ Q.T - np.eye(3)).max() < 1e-15
    np.testing.assert_allclose(Q, R, rtol=0, atol=1e-9)
    flip = [[0, 0, 1], [0, -1, 0], [1, 0, 0]]
    np.testing.assert_array_equal(place(matrix=flip).evaluate_pose({})[:3, :3], flip)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: place((1,)), "at has 1 number; it must have 2 or 3"),
        (lambda: place("origin"), "at is 'origin'; it must have 2 or 3 numbers"),
        (lambda: place((1, math.nan, 0)), "at is nan; it must be finite"),
        (lambda: place((1, "1,5", 0)), "'1,5' is not an expression"),
        (lambda: place(rpy=(1, 2)), "rpy has 2 numbers; it must have 3"),
        (
            lambda: place(rpy=(0, 0, 0), angle=1),
            "orientation given twice, by rpy and angle; give one",
        ),
        (lambda: place(axis=(0, 0, 0)), "axis is 0.0 0.0 0.0; it must be finite and not zero"),
        (lambda: place(axis=(math.inf, 0, 0)), "axis is inf; it must be finite"),
        (lambda: place(axis=("l1", 0, 0)), "it must be plain numbers"),
        (
            lambda: place(quat_wxyz=(0, 0, 0, 0)),
            "quaternion is 0.0 0.0 0.0 0.0; it must be finite and not zero",
        ),
        (lambda: place(quat_wxyz=(1, 0, 0)), "quat_wxyz has 3 numbers; it must have 4"),
        (lambda: place(matrix=np.eye(3) * 1.1), "matrix is not a rotation"),
        (lambda: place(matrix=np.diag([1, 1, -1])), "matrix is not a rotation"),
        (lambda: place(matrix=np.eye(4)), "matrix is a pose .4, 4.; it must be a rotation .3, 3."),
        (lambda: place(matrix="eye"), "matrix is 'eye'; it must be an array of real numbers"),
        (lambda: place(matrix=[[1, 0], [0]]), "it must be an array of real numbers"),
        (
            lambda: make_placement_from_pose(np.eye(3)),
            r"the matrix of a pose has shape \(3, 3\); it must be \(4, 4\)",
        ),
        (
            lambda: make_placement_from_pose(2 * np.eye(4)),
            r"last row is \[0.0, 0.0, 0.0, 2.0\]; it must be 0 0 0 1",
        ),
        (lambda: make_placement_from_pose("here"), "pose is 'here'"),
        (lambda: make_placement_from_pose(np.diag([1, 1, 2, 1])), "matrix is not a rotation"),
        (lambda: check_step("roll", (1.0,)), "unknown motion 'roll'; allowed are x, y, z, rx"),
        (lambda: check_step("rx", (1.0, 2.0)), "rx has 2 numbers; it must have 1"),
        (lambda: read_placement_steps(["rx"]), "must be a list of a motion and its numbers"),
        (lambda: read_placement_steps([["rx", None]]), "rx is None"),
        (lambda: read_placement_steps([["matrix", *["a"] * 9]]), "plain numbers only"),
    ],
)
def test_bad_placements_say_what_is_wrong(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_steps_from_data():
    X = read_placement_steps([["z", "d1"], ["rx", 0.5], ["align", 0, 1, 0], ["y", 1]])
    expected = (
        reference.slide("z", 0.2)
        @ reference.turn("x", 0.5)
        @ reference.turn("x", -np.pi / 2)
        @ reference.slide("y", 1)
    )
    np.testing.assert_allclose(
        X.evaluate_pose({"d1": 0.2}), expected.astype(float), rtol=0, atol=1e-15
    )
