"""Chains from tables: products of the matrices as the books write them."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from kempe.description.dh import DHRow, ScrewRow, from_dh, from_screws
from kempe.errors import InputError

ANGLE = st.floats(-3.2, 3.2)
LENGTH = st.floats(-2.0, 2.0)
ROWS = st.lists(
    st.tuples(
        LENGTH, ANGLE, LENGTH, ANGLE, st.sampled_from(["revolute", "prismatic", "fixed"]), ANGLE
    ),
    min_size=1,
    max_size=5,
)


def product(rows, convention: str) -> list[np.ndarray]:
    """Poses of the bodies: A1, A1 A2, ... with the numbers of the joints put in."""
    out = []
    X = np.eye(4)
    for a, alpha, d, theta, kind, q in rows:
        theta = theta + q * (kind == "revolute")
        d = d + q * (kind == "prismatic")
        z = reference.turn("z", theta) @ reference.slide("z", d)
        x = reference.slide("x", a) @ reference.turn("x", alpha)
        X = X @ (z @ x if convention == "standard" else x @ z)
        out.append(X.astype(float))
    return out


@pytest.mark.parametrize("convention", ["standard", "modified"])
@given(rows=ROWS)
def test_dh_tables(convention: str, rows):
    table = [
        {"a": a, "alpha": alpha, "d": d, "theta": theta, "type": kind}
        for a, alpha, d, theta, kind, _ in rows
    ]
    s = from_dh(table, convention).build()
    q = {f"q{i}": row[5] for i, row in enumerate(rows, 1) if row[4] != "fixed"}
    for i, X in enumerate(product(rows, convention), 1):
        np.testing.assert_allclose(s.fk(q, f"link{i}"), X, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(s.fk(q, "tool"), s.fk(q, f"link{len(rows)}"))


def test_base_tool_names_and_parameters():
    m = from_dh(
        [
            DHRow(a="l1", name="A", body="upper", limits=(-1, 1)),
            DHRow(a="l2", alpha="pi/2", velocity=2.0),
        ],
        name="planar",
        base=reference.slide("z", 0.5).astype(float),
        tool={"at": (0, 0, "l1/2")},
        parameters={"l1": 0.3, "l2": 0.2},
    )
    assert (
        m.name == "planar"
        and list(m.bodies) == ["ground", "upper", "link2"]
        and list(m.joints) == ["A", "q2"]
    )
    assert m.joints["A"].limits == {"": (-1.0, 1.0)} and m.joints["q2"].velocity_limits == {"": 2.0}
    np.testing.assert_allclose(
        m.build().fk([0, 0], "tool")[:3, 3], [0.5, -0.15, 0.5], rtol=0, atol=1e-15
    )
    longer = m.build().with_parameters(l1=1.0)
    np.testing.assert_allclose(
        longer.fk([0, 0], "tool")[:3, 3], [1.2, -0.5, 0.5], rtol=0, atol=1e-15
    )


UNIT = (
    st.tuples(*[st.floats(-1, 1)] * 3)
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: np.array(v) / np.linalg.norm(v))
)
VECTOR = st.tuples(*[LENGTH] * 3).map(np.array)


@st.composite
def twists(draw):
    """Unit screws [v; w]: turns, slides and screws."""
    axis = draw(UNIT)
    point = draw(VECTOR)
    kind = draw(st.integers(0, 2))
    if kind == 0:
        return np.concatenate([axis, np.zeros(3)])
    return np.concatenate(
        [np.cross(point, axis) + (kind - 1) * draw(st.floats(0.1, 1.0)) * axis, axis]
    )


def exponential(twist: np.ndarray, q: float) -> np.ndarray:
    v = twist[:3]
    w = twist[3:]
    A = np.zeros((4, 4))
    A[:3, :3] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
    A[:3, 3] = v
    return expm(A * q)


@given(st.lists(st.tuples(twists(), ANGLE), min_size=1, max_size=5), VECTOR)
def test_products_of_exponentials(screws, at):
    home = reference.slide("x", at[0]).astype(float) @ reference.turn("y", at[1]).astype(float)
    m = from_screws([t for t, _ in screws], home)
    s = m.build()
    X = np.eye(4)
    q = {f"q{i}": angle for i, (_, angle) in enumerate(screws, 1)}
    for i, (twist, angle) in enumerate(screws, 1):
        X = X @ exponential(twist, angle)
        np.testing.assert_allclose(s.fk(q, f"link{i}"), X, rtol=0, atol=1e-12)
    np.testing.assert_allclose(s.fk(q, "tool"), X @ home, rtol=0, atol=1e-12)


def test_types_of_screws():
    m = from_screws(
        [
            [0, 0, 0, 0, 0, 1],
            [0, 1, 0, 0, 0, 0],
            [0, 0, 0.2, 0, 0, 1],
            ScrewRow(axis=(0, 0, 2), point=("l", 0, 0)),
            {"axis": (1, 0, 0), "pitch": 0.1, "name": "screw", "body": "nut"},
            {"axis": (1, 0, 0), "pitch": float("inf")},
        ],
        parameters={"l": 1.0},
    )
    kinds = [j.type.type_name for j in m.joints.values()]
    assert kinds == ["revolute", "prismatic", "helical", "revolute", "helical", "prismatic"]
    assert m.joints["screw"].child == "nut" and m.joints["q4"].X_PF.names == {"l"}


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: from_dh([]), "no rows"),
        (
            lambda: from_dh([{}], "paul"),
            "convention is 'paul'; it must be 'standard' or 'modified'",
        ),
        (lambda: from_dh([{"A": 1}]), "row 1 has an unknown entry 'A'; did you mean 'a'"),
        (
            lambda: from_dh([{"type": "ball"}]),
            "row 1: type is 'ball'; it must be revolute, prismatic, fixed",
        ),
        (lambda: from_dh([{"a": float("nan")}]), "row 1: a is nan; it must be finite"),
        (lambda: from_dh([3.0]), "it must be plain numbers or a dict"),
        (lambda: from_dh([{}], tool={"xyz": 1}), "tool has an unknown entry 'xyz'"),
        (lambda: from_dh([{}], tool="gripper"), "pose"),
        (lambda: from_screws([]), "empty"),
        (
            lambda: from_screws([[0, 0, 1, 0, 0, 0.5]]),
            "rotation part w has length 0.5; it must be 1",
        ),
        (lambda: from_screws([[0, 0, 0, 0, 0, 0]]), "linear part v has length 0; it must be 1"),
        (lambda: from_screws([[0, 0, 1]]), "screw 1: twist has 3 numbers; it must have 6"),
        (lambda: from_screws([{}]), "either twist or axis"),
        (lambda: from_screws([{"axis": (0, 0, 0)}]), "axis is 0.0 0.0 0.0"),
        (
            lambda: from_screws([{"twist": ["l", 0, 0, 0, 0, 1]}], parameters={"l": 1}),
            "with parameters use axis",
        ),
        (lambda: from_screws([{"axis": (0, 0, 1), "pitch": "x"}]), "pitch"),
    ],
)
def test_what_is_wrong(call, words: str):
    with pytest.raises(InputError, match=words):
        call()
