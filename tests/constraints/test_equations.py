"""Equations of the user: text and functions, what they are recorded to, files, copies, and what is
refused.
"""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from linkages import two_bars

import kempe
from kempe.constraints import Equation, Inequality, VelocityEquation
from kempe.constraints.text import parse_tape
from kempe.equations import closure_rows
from kempe.errors import DescriptionError, InputError, KempeError, UnknownNameError


def branching(x):
    return x["A"] - 2.0 * x["B"] if x["B"] < 10.0 else 0.0


FORMS = {
    "text": ("A - 2*sin(B)", ()),
    "sides": ("A = 2*sin(B)", ()),
    "power": ("A - 2*sin(B)^1", ("A", "B")),
    "function": (lambda x: x["A"] - 2 * np.sin(x["B"]), ("A", "B")),
}


@pytest.mark.parametrize("form", FORMS)
def test_forms_agree(form: str):
    m = two_bars()
    m.equation("law", *FORMS[form])
    s = m.build()
    q = np.array([0.7, 0.4])
    value, J = closure_rows.evaluate_constraints(s, q)
    np.testing.assert_allclose(value, [0.7 - 2 * np.sin(0.4)], atol=1e-15)
    np.testing.assert_allclose(J, [[1.0, -2 * np.cos(0.4)]], atol=1e-15)
    assert s.assemble({"B": 0.3}).q[0] == pytest.approx(2 * np.sin(0.3), abs=1e-9)


def test_several_equations_and_names_of_rows():
    m = two_bars()
    m.equation("laws", ["A - 0.3", "B = 0.1"])
    m.equation("more", lambda x: [x["A"] - 0.3, 2 * (x["B"] - 0.1)], of=("A", "B"))
    s = m.build()
    assert [name for name, _ in closure_rows.list_row_names(s)] == ["laws", "laws", "more", "more"]
    found = s.assemble()
    np.testing.assert_allclose(found.q, [0.3, 0.1], atol=1e-9)


def test_parameters_are_data():
    m = two_bars()
    m.parameter("k", 2.0)
    m.equation("law", "A = k*B")
    m.equation("same", lambda x: x["A"] - x["k"] * x["B"], of=("A", "B", "k"))
    assert m.constraints["law"].of.of == m.constraints["same"].of.of == ("A", "B")
    s = m.build()
    for k, system in ((2.0, s), (3.0, s.with_parameters(k=3.0))):
        np.testing.assert_allclose(
            closure_rows.compute_residual(system, [0.5, 0.1]), 0.5 - k * 0.1, atol=1e-15
        )


@pytest.mark.parametrize("law", ["A = B", lambda x: x["A"] - x["B"], branching])
def test_coordinates_that_follow_or_are_held(law):
    """J = 0.5 B + 0.1 follows B; what reads it reads B."""
    m = two_bars()
    more = m.body("more")
    m.revolute("J", "lower", more, at=(1.0, 0.0))
    m.couple("J", {"B": 0.5}, 0.1)
    m.equation("law", lambda x: x["A"] - 3 * x["J"] ** 2, of=("A", "J"))
    s = m.build()
    value, J = closure_rows.evaluate_constraints(s, np.array([0.2, 0.4]))
    np.testing.assert_allclose(value, [0.2 - 3 * 0.3**2], atol=1e-15)
    np.testing.assert_allclose(J, [[1.0, -6 * 0.3 * 0.5]], atol=1e-14)
    m.lock({"B": 0.4})
    held = m.build()
    assert held.coordinate_names == ("A",)
    np.testing.assert_allclose(closure_rows.evaluate_constraints(held, np.array([0.2]))[1], [[1.0]])
    assert held.assemble().q[0] == pytest.approx(0.27, abs=1e-9)


def test_functions_that_branch_are_called():
    m = two_bars()
    m.equation("law", branching, of=("A", "B"))
    s = m.build()
    value, J = closure_rows.evaluate_constraints(s, np.array([0.2, 0.4]))
    np.testing.assert_allclose(value, [-0.6], atol=1e-15)
    np.testing.assert_allclose(J, [[1.0, -2.0]], atol=1e-9)
    assert s.assemble({"B": 0.1}).q[0] == pytest.approx(0.2, abs=1e-9)
    assert pickle.loads(pickle.dumps(m)) == m
    with pytest.raises(DescriptionError, match="'law'.*branching"):
        m.save("never.toml")


def test_callbacks_have_declared_support():
    m = two_bars()
    third = m.body("third")
    m.revolute("C", "lower", third, at=(1.0, 0.0))
    m.equation("law", branching, of=("A", "B"))
    m.equation("other", lambda x: abs(x["C"]) - 0.5, of=("C",))
    J = closure_rows.evaluate_constraints(m.build(), np.array([0.2, 0.4, 0.3]))[1]
    by_name = dict(zip([n for n, _ in closure_rows.list_row_names(m.build())], J, strict=True))
    np.testing.assert_allclose(by_name["law"], [1.0, -2.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(by_name["other"], [0.0, 0.0, 1.0], atol=1e-9)


def test_lambdas_that_branch_cannot_be_pickled():
    m = two_bars()
    m.equation("law", lambda x: abs(x["A"]) - 1, of=("A",))
    with pytest.raises(InputError, match="equation 'law'.*cannot be pickled"):
        pickle.dumps(m)


def everything() -> kempe.Mechanism:
    m = two_bars()
    m.parameter("k", 2.0)
    m.equation("law", lambda x: x["A"] - np.hypot(x["B"], 0.5) * x["k"], of=("A", "B", "k"))
    m.equation("two", ["A = B^2", "exp(A) - 1"])
    m.inequality("stop", lambda x: [1.2 - x["A"], x["B"] + 2], of=("A", "B"))
    m.velocity_equation("rows", lambda x: [[-(x["B"] ** 2), 1], [0, x["A"]]], of=("A", "B"))
    m.velocity_equation("driven", [["k", "cos(B)"]], of=("A", "B"), b="A")
    return m


def test_files_copies_and_pickles(tmp_path):
    m = everything()
    path = m.save(tmp_path / "arm.toml")
    assert kempe.read(path) == m == m.copy() == pickle.loads(pickle.dumps(m))
    assert "format = 2" in path.read_text()
    other = everything()
    other.constraints.pop("two")
    assert other != m
    q = np.array([0.3, 0.6])
    np.testing.assert_array_equal(
        closure_rows.compute_residual(kempe.read(path).build(), q),
        closure_rows.compute_residual(m.build(), q),
    )


def test_attached_with_a_prefix():
    host = kempe.Mechanism("host", dim=2)
    host.attach(everything(), prefix="left_")
    s = host.build()
    alone = everything().build()
    q = np.array([0.3, 0.6])
    np.testing.assert_allclose(
        closure_rows.compute_residual(s, q), closure_rows.compute_residual(alone, q), atol=1e-15
    )
    from kempe.equations.velocity import evaluate_velocity_rows

    for found, expected in zip(
        evaluate_velocity_rows(s, q), evaluate_velocity_rows(alone, q), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-15)


def test_velocity_rows():
    from kempe.equations.velocity import evaluate_velocity_rows, list_velocity_row_names

    m = two_bars()
    m.couple("B", {"A": 2.0}, 0.1)
    m.velocity_equation("w", [["sin(B)", "t"]], of=("A", "B"), b=lambda x, t: x["A"] * t, time=True)
    s = m.build()
    A, b = evaluate_velocity_rows(s, [0.3], 0.5)
    np.testing.assert_allclose(A, [[math.sin(0.7) + 2 * 0.5]], atol=1e-15)
    np.testing.assert_allclose(b, [0.15], atol=1e-15)
    assert list_velocity_row_names(s) == (("w", "velocity"),)


# ---- given to ik


def test_as_a_task_of_ik():
    s = two_bars().build()
    answer = s.ik([Equation("A = 3*B"), kempe.constraints.OnLine("tip", (0.0, 0.5), (1.0, 0.0))])
    assert answer.success
    assert answer.q[0] == pytest.approx(3 * answer.q[1], abs=1e-7)
    assert s.fk(answer.q, "tip")[1, 3] == pytest.approx(0.5, abs=1e-7)
    bounded = s.ik([Inequality("A - 1"), kempe.constraints.Position("tip", (1.2, 0.3))])
    assert bounded.success and bounded.q[0] >= 1.0 - 1e-7
    called = s.ik(
        [
            Equation(branching, of=("A", "B")),
            kempe.constraints.OnLine("tip", (0.0, 0.5), (1.0, 0.0)),
        ]
    )
    assert called.success and called.q[0] == pytest.approx(2 * called.q[1], abs=1e-7)


def test_velocities_are_no_tasks_of_ik():
    with pytest.raises(InputError, match="about velocities"):
        two_bars().build().ik([VelocityEquation([[1, 0]], of=("A", "B"))])


# ---- refusals

WRONG = {
    "near name": (
        lambda m: m.equation("e", "A - 2*Bb"),
        DescriptionError,
        "'e'.*no coordinate 'Bb'; did you mean 'B'",
    ),
    "time unsaid": (lambda m: m.equation("e", "A - t"), DescriptionError, "'e'.*'t'.*time=True"),
    "raises": (
        lambda m: m.equation("e", lambda x: x["A"] - 1 / 0, of=("A",)),
        InputError,
        "'e' raised Zero.*at A = ",
    ),
    "wrong size": (
        lambda m: m.equation("e", lambda x: [[1, x["A"]]], of=("A",)),
        InputError,
        r"'e'.*shape \(1, 2\)",
    ),
    "NaN": (
        lambda m: m.equation("e", lambda x: math.nan * x["A"], of=("A",)),
        InputError,
        "'e'.*nan",
    ),
    "nothing": (
        lambda m: m.equation("e", lambda x: None, of=("A",)),
        InputError,
        "'e': it returns None",
    ),
    "undeclared": (
        lambda m: m.equation("e", lambda x: x["B"], of=("A",)),
        UnknownNameError,
        "undeclared.*'B'",
    ),
    "no names": (lambda m: m.equation("e", lambda x: x["A"]), InputError, r"'e'.*of=\(\.\.\.\)"),
    "code": (
        lambda m: m.equation("e", "__import__('os').getcwd()"),
        KempeError,
        "no expression holds",
    ),
    "attribute": (
        lambda m: m.equation("e", "A.__class__"),
        DescriptionError,
        "no coordinate 'A.__class__'",
    ),
    "call": (lambda m: m.equation("e", "open(A)"), KempeError, "open"),
    "twice": (lambda m: m.equation("e", "A", of=("A", "A")), InputError, "'A' twice"),
    "inequality": (lambda m: m.inequality("e", "A = 1"), InputError, "not negative"),
    "matrix": (
        lambda m: m.velocity_equation("e", [[1]], of=("A", "B")),
        InputError,
        "2 entries, for A, B",
    ),
    "ragged": (
        lambda m: m.velocity_equation("e", [[1, 2], [3]], of=("A", "B")),
        InputError,
        "different lengths",
    ),
    "b": (
        lambda m: m.velocity_equation("e", [[1, 2]], of=("A", "B"), b=[1, 2]),
        InputError,
        "b of .*'e'",
    ),
    "branching rows": (
        lambda m: m.velocity_equation("e", lambda x: [[abs(x["A"]), 1]], of=("A", "B")),
        InputError,
        "'e' cannot be",
    ),
    "a whole posture": (
        lambda m: m.constrain(kempe.constraints.Posture({"A": 0.1}, weight=None)),
        DescriptionError,
        "one call of ik",
    ),
    "bounds of several": (
        lambda m: m.constrain(kempe.constraints.Equation(["A", "B"], at_least=[0.0, 1.0, 2.0])),
        DescriptionError,
        r"at_least .* has shape \(3,\)",
    ),
    "of a file": (lambda m: m.equation("e", 3 + 4j), KempeError, "text"),
}


@pytest.mark.parametrize("case", WRONG)
def test_refused(case: str):
    make, kind, said = WRONG[case]
    m = two_bars()
    with pytest.raises(kind, match=said):
        make(m)
        m.build()


def test_hidden_state_is_named():
    calls = []

    def counting(x):
        calls.append(0)
        return x["A"] * len(calls)

    with pytest.raises(InputError, match="equation 'e'.*hidden state"):
        two_bars().equation("e", counting, of=("A",))


def test_a_name_that_is_a_coordinate_and_a_parameter():
    m = two_bars()
    m.parameter("B", 2.0)
    m.equation("e", "A - B")
    with pytest.raises(DescriptionError, match="'B' is a coordinate and a parameter"):
        m.build()


def test_parts_of_quaternions_are_refused_by_name():
    m = kempe.Mechanism("ball")
    m.spherical("J", m.ground, m.body("b"))
    m.equation("e", "`J.qx`")
    with pytest.raises(DescriptionError, match="quaternion.*angles=True"):
        m.build()


def test_a_function_that_changes_its_size_is_named_with_the_call():
    def growing(x):
        return [x["A"], 1.0] if x["A"] > 50.0 else [x["A"]]

    m = two_bars()
    m.equation("e", growing, of=("A",))
    with pytest.raises(InputError, match="'e' returned 1 number first and 2 at A = 60.0"):
        closure_rows.compute_residual(m.build(), [60.0, 0.0])


def test_the_words_of_a_tape_are_its_inputs():
    tape = parse_tape("A - 2*sin(B)", ("A", "B"))
    assert Equation(tape, of=("A", "B")).words == ("A", "B")
    assert Equation(branching, of=("B", "A")).words == ("B", "A")


@pytest.mark.parametrize(
    ("entry", "said"), [("C", "no .*'C'"), ("t", "no .*'t'.*; for the time say time=True")]
)
def test_names_in_rows_of_velocities_that_are_neither_coordinates_nor_parameters(entry, said):
    made = VelocityEquation([[entry, "p"]], of=("A", "B"), parameters=("p",))
    with pytest.raises(InputError, match=said):
        made.list_rows(2)


def test_a_function_reads_coordinates_where_they_are_in_q():
    """A ball before them has four numbers in q and three velocities."""
    m = kempe.Mechanism("ball and arm")
    m.spherical("J", m.ground, m.body("ball"))
    for name in "AB":
        m.revolute(name, m.ground, m.body(f"body {name}"))
    m.equation("e", branching, of=("A", "B"))
    q = np.array([1.0, 0.0, 0.0, 0.0, 0.7, 0.2])
    assert closure_rows.compute_residual(m.build(), q) == pytest.approx(
        [0.7 - 2.0 * 0.2], abs=1e-14
    )
