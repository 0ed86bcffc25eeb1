"""Tapes against numpy, sympy and themselves: what is recorded or read is the function that was
meant.
"""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
import sympy
from hypothesis import given, reject
from hypothesis import strategies as st

from kempe.constraints.builder import Builder
from kempe.constraints.equations import _UFUNCS, _UFUNCS_2, NotRecorded, find_shape, record_function
from kempe.constraints.tape import NAMES, Tape, is_plain
from kempe.constraints.text import parse_tape
from kempe.errors import InputError, KempeError, UnknownNameError
from kempe.values import FUNCTIONS, OF_TWO

NAMES_OF_INPUTS = ["A", "rear axle", "joint.x", "λ", "lambda", "sin", "ϕ"]
WORDS = {
    "A": "A",
    "rear axle": "`rear axle`",
    "joint.x": "joint.x",
    "λ": "λ",
    "lambda": "`lambda`",
    "sin": "`sin`",
    "ϕ": "`ϕ`",
}
VALUES = {name: 0.21 + 0.13 * k for k, name in enumerate(NAMES_OF_INPUTS)}


def random_text(rng: np.random.Generator, depth: int) -> tuple[str, str]:
    """An expression as Kempe reads it, and as Python with numpy does."""
    if depth == 0 or rng.random() < 0.1:
        if rng.random() < 0.3:
            x = repr(round(float(rng.uniform(0.1, 3)), 2))
            return x, x
        name = NAMES_OF_INPUTS[rng.integers(len(NAMES_OF_INPUTS))]
        return WORDS[name], f"v[{name!r}]"
    a, p = random_text(rng, depth - 1)
    b, q = random_text(rng, depth - 1)
    kind = rng.integers(8)
    if kind < 4:
        sign = "+-*/"[kind]
        return f"({a}){sign}({b})", f"({p}){sign}({q})"
    if kind == 4:
        n = int(rng.integers(-3, 6))
        return f"({a})^{n}" if n >= 0 else f"({a})**({n})", f"np.power(np.float64({p}), {float(n)})"
    if kind == 5:
        return f"-({a})", f"-({p})"
    name = str(rng.choice(sorted(FUNCTIONS)))
    call, python = (f"{a}, {b}", f"{p}, {q}") if name in OF_TWO else (a, p)
    return f"{name}({call})", f"F[{name!r}]({python})"


def plain(python: str, values: dict) -> float:
    with np.errstate(all="ignore"):
        return float(eval(python, {"np": np, "F": FUNCTIONS, "v": values}))


def test_text_is_read_as_python_reads_it(hunt):
    """The text, its tape, and the text of the tape are one function."""
    rng = hunt.rng()
    finite = 0
    for _ in range(hunt.cases(1000)):
        text, python = random_text(rng, int(rng.integers(1, 5)))
        expected = plain(python, VALUES)
        try:
            tape = parse_tape(text, NAMES_OF_INPUTS)
        except InputError as error:
            assert "finite" in str(error), text
            continue
        found = float(tape.evaluate_outputs(VALUES)[0])
        if np.isfinite(expected) and abs(expected) < 1e6:
            finite += 1
            assert found == pytest.approx(expected, rel=1e-7, abs=1e-7), text
        (back,) = tape.format_outputs()
        assert parse_tape(back, NAMES_OF_INPUTS) == tape, (text, back)
    assert finite > 300 * min(1, hunt.cases(1000) / 1000)


def test_every_function_of_expressions_has_an_operation():
    assert set(NAMES.values()) == set(FUNCTIONS) - {"radians", "degrees"}
    for name in FUNCTIONS:
        call = "A, B" if name in OF_TWO else "A"
        x = {"A": 1.5 if name == "acosh" else 0.4, "B": 0.7}
        expected = FUNCTIONS[name](*(x[n] for n in call.split(", ")))
        assert parse_tape(f"{name}({call})", ["A", "B"]).evaluate_outputs(x)[0] == pytest.approx(
            expected, rel=1e-14
        )


leaves = st.sampled_from(["A", "B", "t", "2", "0.5", "pi"])
expressions = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*/"), inner).map(lambda x: f"({x[0]}){x[1]}({x[2]})"),
        inner.map(lambda x: f"-({x})"),
        st.tuples(inner, st.integers(2, 7)).map(lambda x: f"({x[0]})**{x[1]}"),
        st.tuples(st.sampled_from(["sin", "cos", "exp", "atan", "sqrt"]), inner).map(
            lambda x: f"{x[0]}({x[1]})"
        ),
    ),
    max_leaves=12,
)


@given(text=expressions)
def test_tapes_are_values(text):
    try:
        tape = parse_tape(text, ["A", "B", "t"])
    except InputError:
        reject()
    again = pickle.loads(pickle.dumps(tape))
    assert again == tape and hash(again) == hash(tape)
    assert parse_tape(tape.format_outputs(), tape.inputs) == tape
    ints, floats = tape.make_arrays()
    assert ints.dtype == np.int64 and floats.dtype == np.float64 and ints[1] == tape.size


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("A = 2*B", "A - 2*B"),
        ("A^2^3", "A**8"),
        ("-A^2", "-(A**2)"),
        ("A - (B - 1)", "A - B + 1"),
        ("2^-1*A", "A/2"),
        ("A = 0", "A"),
        ("A + B*A**3 = B", "A + B*(A*A*A) - B"),
        ("1_0*A", "10*A"),
        ("\tA +\n B", "B + A"),
        ("radians(180)*A", "pi*A"),
        ("A**0.5", "sqrt(A)"),
        ("A*A*A*A", "(A**2)**2"),
        ("+A", "A"),
    ],
)
def test_the_language(text, meaning, hunt):
    rng = hunt.rng()
    x = {"A": rng.uniform(0.1, 2, 20), "B": rng.uniform(0.1, 2, 20)}
    one = parse_tape(text, ["A", "B"])
    other = parse_tape(meaning, ["A", "B"])
    assert one.evaluate_outputs(x) == pytest.approx(other.evaluate_outputs(x), rel=1e-14, abs=1e-14)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("__import__('os')", 'has "\'" at place 12'),
        ("__import__(A)", "calls '__import__'"),
        ("A.__class__", "no name 'A.__class__'"),
        ("A if B else 1", "is not an expression"),
        ("A = B = 1", "2 signs of equality"),
        ("1/0*A", "must be finite"),
        ("abs(A)", "calls 'abs'"),
        ("A**", "is not an expression"),
        ("(A", "is not an expression"),
        ("(" * 10**6 + ")" * 10**6, "at most"),
        ("(" * 9000 + "A" + ")" * 9000, "is not an expression"),
        ("A" + "+A" * 9000, "is not an expression|inside"),
        ("A" + "+A" * 500, "operations inside each other"),
        ("sin", "without its brackets"),
        ("`sin`", "no name 'sin'"),
        ("A//2", "is not an expression"),
        ("A < 2", "'<' at place 3"),
        ("`A", "'`' at place 1"),
        ("``", "empty name"),
        ("", "is not an expression"),
        ("9**9**9", "must be finite"),
        ("1e999*A", "is not an expression"),
        ("0x10*A", "at place 1"),
        ("A[0]", r"'\[' at place 2"),
        ("lambda: A", "':' at place 7"),
        ("A := 1", "':' at place 3"),
        ("hypot(A)", "it takes 2"),
        ("sin(*A)", "is not an expression"),
        ("2 A", "is not an expression"),
        ("1.A", "is not an expression|at place"),
        ("A\x00", "at place 2"),
        ("\\", "at place 1"),
        (3, "must be text"),
        ("`rear wheel`/0", "no name 'rear wheel'; did you mean 'rear axle'"),
        ("`rear axle`//2", "`rear axle`//2"),
    ],
)
def test_other_texts_are_refused(text, error):
    with pytest.raises(KempeError, match=error) as raised:
        parse_tape(text, ["A", "B", "rear axle"])
    assert len(str(raised.value)) < 1500


def test_near_names_are_those_of_coordinates_and_parameters():
    with pytest.raises(UnknownNameError, match="did you mean 'length_1'"):
        parse_tape("A - lenght_1", ["A"], ["length_1"])
    with pytest.raises(InputError, match="'A' is the name of a coordinate and of a parameter"):
        parse_tape("A", ["A"], ["A"])


def test_parameters_are_fixed_without_a_change_of_structure(hunt):
    rng = hunt.rng()
    tape = parse_tape("(x/a)**n + (y/b)**n - 1", ["x", "y"], ["a", "b", "n"])
    assert tape.inputs == ("x", "y", "a", "b", "n")
    one, other = (
        tape.fix_inputs({"a": a, "b": 0.5, "n": n, "unused": 1.0})
        for a, n in ((2.0, 4.0), (3.0, 2.0))
    )
    assert one.nodes == other.nodes and one.inputs == ("x", "y") and one.outputs == other.outputs
    x, y = rng.normal(size=(2, 50))
    assert one.evaluate_outputs({"x": x, "y": y})[:, 0] == pytest.approx(
        (x / 2) ** 4 + (y / 0.5) ** 4 - 1, rel=1e-13
    )


@pytest.mark.parametrize(
    ("text", "degree"),
    [
        ("A*v + B*w", 1),
        ("A**2*sin(B)*v - 3", 1),
        ("v*w", 2),
        ("v**2", 2),
        ("A/v", 2),
        ("v/A", 1),
        ("sin(v)", 2),
        ("-v/2 + A**v", 2),
        ("A*B", 0),
        ("-(v - w)*A", 1),
        ("hypot(v, A)", 2),
    ],
)
def test_degrees_are_read_off_the_program(text, degree):
    tape = parse_tape(text, ["A", "B", "v", "w"])
    assert tape.compute_degrees(["v", "w"]) == (degree,) and tape.is_linear_in(["v", "w"]) == (
        degree < 2
    )


def test_outputs_are_evaluated_side_by_side_and_one_by_one():
    tape = parse_tape(["A*B", "3", "C - sqrt(A)"], ["A", "B", "C"])
    values = {"A": 4.0, "B": 2.0, "C": 5.0}
    assert tape.evaluate_outputs(values).tolist() == [8.0, 3.0, 3.0]
    assert tape.select_outputs([2, 0]).evaluate_outputs(values).tolist() == [3.0, 8.0]
    assert tape.evaluate_outputs({"A": np.ones((4, 1)), "B": 2.0, "C": np.zeros(3)}).shape == (
        4,
        3,
        3,
    )
    with pytest.raises(UnknownNameError, match="no input 'C'"):
        tape.evaluate_outputs({"A": 1.0, "B": 2.0})


# ---------------------------------------------------------------- functions


def of_numpy(x):
    a = x["A"]
    b = x["B"]
    point = np.array([a, b, 1.0])
    turned = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) @ np.array([b, 2.0])
    return [
        np.linalg.norm(point),
        np.dot(point, [1, 2, 3]),
        np.cross(point, [0, 1, b])[1],
        turned[0],
        turned.sum(),
        np.float64(2) * a,
        np.arctan2(a, b),
        np.hypot(3, b),
        np.deg2rad(a) + np.log1p(b * b),
        b**a,
        2**a,
        a**-2,
        np.square(a) / np.float32(2),
        np.exp2(b) - np.log10(a * a),
        sum([a, b]),
        np.array(3) * a,
        1 - a,
        1 / b,
        -a,
        np.sin(point[:2])[1],
        np.mean([a, b]),
        (point**2)[1],
        a * np.array([1.0, 2.0])[1],
        np.trace(np.diag(point)),
    ]


def test_numpy_is_recorded(hunt):
    rng = hunt.rng()
    tape, shape = record_function(of_numpy, ["A", "B"])
    assert shape == (len(of_numpy({"A": 1.0, "B": 1.0})),)
    for _ in range(hunt.cases(50)):
        x = {"A": rng.uniform(0.1, 2), "B": rng.uniform(0.1, 2)}
        assert tape.evaluate_outputs(x) == pytest.approx(of_numpy(x), rel=1e-12)
    assert parse_tape(tape.format_outputs(), tape.inputs) == tape


@pytest.mark.parametrize(
    ("function", "inputs", "shape", "texts"),
    [
        (lambda x: x["A"] - 2 * x["B"], ("A", "B"), (), ("A - 2*B",)),
        (lambda x: [[-(x["y"] ** 2), 0, 1]], ("y",), (1, 3), ("-y**2", "0", "1")),
        (lambda x: [3], (), (1,), ("3",)),
        (lambda x: np.array([x["B"]]), ("B",), (1,), ("B",)),
        (lambda x: (x["A"], x["A"]), ("A",), (2,), ("A", "A")),
    ],
)
def test_the_shape_and_the_inputs_are_those_of_the_result(function, inputs, shape, texts):
    tape, found = record_function(function, ["A", "B", "y"])
    assert (tape.inputs, found, tape.format_outputs()) == (inputs, shape, texts)


def test_the_time_is_an_input():
    tape, _ = record_function(lambda x, t: x["A"] - np.sin(t), ["A"], time=True)
    assert tape.inputs == ("A", "t") and tape == parse_tape("A - sin(t)", ["A", "t"])
    with pytest.raises(InputError, match="has an input 't' besides the time"):
        record_function(lambda x, t: t, ["t"], time=True)


def test_equal_functions_give_equal_tapes():
    def late(x):
        second = np.cos(x["B"])
        unused = x["A"] ** 9
        return np.sin(x["A"]) + second + 0 * unused * 0 if False else np.sin(x["A"]) + second

    assert record_function(late, ["A", "B"])[0] == parse_tape("sin(A) + cos(B)", ["A", "B"])
    one = parse_tape("sin(A) + sin(A)*cos(A)", ["A"])
    other = parse_tape("sin(A)", ["A"])
    assert one.size - other.size == 2  # sine, cosine and its derivative stand there already


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        (lambda x: math.sin(x["A"]), "plain number"),
        (lambda x: x["A"] if x["A"] > 0 else 1.0, "compares"),
        (lambda x: abs(x["A"]), "abs"),
        (lambda x: max(x["A"], x["B"]), "compares"),
        (lambda x: np.maximum(x["A"], 1), "numpy.maximum"),
        (lambda x: x["A"] % 2, "remainder"),
        (lambda x: float(x["A"]), "plain number"),
        (lambda x: x["A"] and x["B"], "branches"),
        (lambda x: {1.0: 2.0}.get(x["A"], 3.0), "as a key"),
        (lambda x: np.where(x["A"] > 0, 1.0, 2.0), "compares"),
        (lambda x: [1.0, 2.0][int(x["A"] > 9)], "compares"),
        (lambda x: x["A"].item(), "AttributeError"),
        (lambda x: np.add(x["A"], 1, dtype=float), "numpy.add"),
        (lambda x: round(x["A"]), "remainder"),
    ],
)
def test_what_cannot_be_recorded_says_why(function, reason):
    with pytest.raises(NotRecorded, match=f"the function cannot be recorded: .*{reason}"):
        record_function(function, ["A", "B"])
    assert find_shape(function, ["A", "B"], False, "the function") == ()


class Changing:
    """A function that answers otherwise from a call on."""

    def __init__(self, call: int):
        self.calls = 0
        self.at = call

    def __call__(self, x):
        self.calls += 1
        return x["A"] * (1 if self.calls < self.at else 2)


KEPT: list = []


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: 1 / 0, "raised ZeroDivisionError at A = 0.0945.*, B = .*: division by zero"),
        (lambda x: [1, 2][3] * x["A"], "raised IndexError at A ="),
        (lambda x: "text", "returns 'text'"),
        (lambda x: None, "returns None"),
        (lambda x: [[1], [2, 3]], "lists of different lengths"),
        (lambda x: [[[x["A"]]]], "deeper than rows"),
        (lambda x: [], "an empty list"),
        (lambda x: True, "returns True"),
        (lambda x: {"A": x["A"]}, "returns {"),
        (lambda x: math.nan * x["A"], "nan; it must be finite"),
        (lambda x: [x["A"], math.inf], "inf; it must be finite"),
        (lambda x: 1j * x["A"], "returns .*j"),
        (lambda x: math.sqrt(-1 - x["A"] ** 2), "raised ValueError at A ="),
        (lambda x: x["A"] + "a", "raised"),
        (lambda: 1, "raised TypeError"),
        (lambda x: x["A"] > 0, "returns .*True|returns .*False"),
        (lambda x: abs(x["A"]) * math.nan, "not finite wherever it was tried, such as at A ="),
        (Changing(2), "hidden state"),
        (Changing(3), r"gives \[.*\] at A = .*, B = .* when it was recorded: .*hidden"),
        (Changing(9), "at A = .*hidden state"),
        (lambda x: x["A"] * np.random.random(), "hidden state"),
        (
            lambda x: abs(x["A"]) * np.random.random(),
            "gives .* when it is called again: it depends on hidden state",
        ),
        (lambda x: (KEPT.append(x["A"]), KEPT[0])[1], "hidden state|cannot be recorded"),
    ],
)
def test_bad_functions_are_named_with_the_call(function, message):
    with pytest.raises(KempeError, match=message):
        record_function(function, ["A", "B"])


def test_undeclared_names_are_refused():
    with pytest.raises(
        UnknownNameError, match="asks for an undeclared name.*'elbw'; did you mean 'elbow'"
    ):
        record_function(lambda x: x["elbw"], ["elbow"])


def test_functions_that_are_not_defined_everywhere_are_recorded():
    tape, _ = record_function(lambda x: np.sqrt(1 - x["A"] ** 2) / x["A"], ["A"])
    assert np.isnan(tape.evaluate_outputs({"A": 2.0})[0]) and tape.evaluate_outputs({"A": 0.6})[
        0
    ] == pytest.approx(0.8 / 0.6)


def test_text_agrees_with_sympy(hunt):
    """The same text, read by another program."""
    text = "sin(A)**2*exp(-B) + atan2(A, B)/hypot(A, B) - log(1 + A^2) + asinh(A*B)"
    A, B = sympy.symbols("A B", positive=True)
    python = text.replace("^", "**").replace("hypot(A, B)", "sqrt(A**2 + B**2)")
    other = sympy.sympify(python, {"A": A, "B": B})  # pyright: ignore
    rng = hunt.rng()
    tape = parse_tape(text, ["A", "B"])
    for a, b in rng.uniform(0.1, 2, size=(hunt.cases(30), 2)):
        assert tape.evaluate_outputs({"A": a, "B": b})[0] == pytest.approx(
            float(other.subs({A: a, B: b})), rel=1e-12
        )


def test_long_texts_are_refused_where_shared_parts_multiply():
    def folded(x):
        y = x["A"]
        for _ in range(30):
            y = np.sin(y) + np.cos(y)
        return y

    tape, _ = record_function(folded, ["A"])
    assert isinstance(tape, Tape) and tape.size < 200
    with pytest.raises(InputError, match="more than 20000 characters"):
        tape.format_outputs()


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("q1", True),
        ("arm.q1", True),
        ("arm.if", False),
        ("if", False),
        ("if.q1", False),
        ("1q", False),
        ("sin", False),
        ("a b", False),
        ("", False),
    ],
)
def test_names_that_stand_in_text_as_they_are(name, plain):
    assert is_plain(name) is plain


def test_an_entry_of_a_list_is_the_number_at_its_place():
    lists = ([2.0, 2.0, 2.0], [3.0, 5.0, 3.0], [3.0, 5.0, 7.0])
    build = Builder(("s",))
    tape = build.finish_tape([build.add_entry(0, numbers) for numbers in lists])
    for k in range(3):
        assert tape.evaluate_outputs({"s": k + 0.4}).tolist() == [numbers[k] for numbers in lists]


@pytest.mark.filterwarnings("ignore:invalid value")
def test_every_function_of_numpy_is_recorded_as_itself():
    one, two = (sorted(table, key=lambda f: f.__name__) for table in (_UFUNCS, _UFUNCS_2))
    tape, _ = record_function(
        lambda x: [f(x["A"]) for f in one] + [f(x["A"], x["B"]) for f in two], ["A", "B"]
    )
    for a, b in ((0.3, 0.7), (1.4, 0.2), (0.9, 1.6)):
        expected = [f(a) for f in one] + [f(a, b) for f in two]
        np.testing.assert_allclose(tape.evaluate_outputs({"A": a, "B": b}), expected, rtol=1e-14)
