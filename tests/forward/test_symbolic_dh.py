"""Denavit-Hartenberg tables of chains: published ones, and back again through `from_dh`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import some
from shipped import shipped, with_loops

import kempe
from kempe.errors import UnknownNameError, UnsupportedError

sympy = pytest.importorskip("sympy")

TIPS = {"two_link": "e", "two_link_pose": "e", "unreachable": "e"}
NONE = {"ball", "joint_fixed", "joint_free", "joint_helical", "joint_spherical"}
CHAINS = [n for n in shipped() if n not in NONE and n not in with_loops()]


def back(system, frame, table, q):
    """How far the chain of a table is from the system."""
    columns = [
        [n.replace(".", "_") for n in system.coordinate_names].index(row.name) for row in table.rows
    ]
    return np.abs(table.mechanism().build().fk(q[:, columns], "tool") - system.fk(q, frame)).max()


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("name", some(CHAINS, 4))
def test_tables_of_shipped_chains_are_these_chains(name, convention):
    system = kempe.load(name)
    frame = TIPS.get(name, system.frame_names[-1])
    table = system.symbolic.to_dh(frame, convention)
    assert back(system, frame, table, system.random(0, 5)) < 1e-9


def test_the_lectures_arm():
    table = kempe.load("two_link").symbolic.to_dh("e")
    assert [(r.a, r.alpha, r.d, r.theta) for r in table.rows] == [
        ("l1", 0.0, 0.0, 0.0),
        ("l2", 0.0, 0.0, 0.0),
    ]
    np.testing.assert_array_equal(table.base, np.eye(4))
    np.testing.assert_array_equal(table.tool, np.eye(4))
    assert "joint = q2, a = l2, alpha = 0, d = 0, theta = q2" in str(table)
    assert table.data()["rows"][1]["a"] == "l2"


def test_the_published_table_of_the_panda():
    """Franka Emika's documentation, 2017: modified parameters, the flange 0.107 m beyond joint 7."""
    panda = kempe.load("panda")
    table = panda.symbolic.to_dh("panda_hand_tcp", "modified")
    published = [(0, 0, 0.333), (0, -90, 0), (0, 90, 0.316), (0.0825, 90, 0), (-0.0825, -90, 0.384), (0, 90, 0),
                 (0.088, 90, 0.107 + 0.1034)]  # fmt: skip
    values = panda.structure.parameters

    def number(x):
        return float(sympy.sympify(x).subs(values))

    for row, (a, alpha, d) in zip(table.rows, published, strict=True):
        assert (number(row.a), math.degrees(number(row.alpha)), number(row.d)) == pytest.approx(
            (a, alpha, d)
        )


@pytest.mark.slow
def test_random_chains(hunt):
    """Axes in space in any direction, some of them parallel or meeting, turns and slides, the base
    anywhere.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        m = kempe.Mechanism("chain")
        here = None
        for i in range(int(rng.integers(1, 5))):
            axis = [(0, 0, 1), (0, 1, 0), (1, 0, 0), tuple(rng.uniform(-1, 1, 3)), (0, 0, -1)][
                int(rng.integers(5))
            ]
            at = np.where(rng.random(3) < 0.4, 0.0, rng.uniform(-1, 1, 3))
            make = m.revolute if rng.random() < 0.7 else m.prismatic
            make(
                f"q{i}",
                here or m.ground,
                m.body(f"b{i}"),
                at=tuple(at),
                axis=axis,
                rpy=tuple(rng.choice([0, 0.3], 3)),
            )
            here = f"b{i}"
        m.frame("tip", here, at=tuple(rng.uniform(-1, 1, 3)), rpy=tuple(rng.choice([0, 0.5], 3)))
        system = m.build()
        for convention in ("standard", "modified"):
            table = system.symbolic.to_dh("tip", convention)
            assert back(system, "tip", table, rng.uniform(-1, 1, (3, system.nq))) < 1e-8


def test_zero_lengths_and_lengths_at_an_angle():
    zero = kempe.load("two_link").with_parameters(l2=0.0)
    assert back(zero, "e", zero.symbolic.to_dh("e"), zero.random(0, 3)) < 1e-12
    m = kempe.Mechanism("offset", dim=2)
    m.revolute("q1", m.ground, m.body("A"))
    m.revolute("q2", "A", m.body("B"), at=(m.parameter("a", 0.3), m.parameter("b", 0.4)))
    m.frame("tip", "B", at=("a", 0))
    table = m.build().symbolic.to_dh("tip")
    assert (
        float(table.rows[0].a) == pytest.approx(0.5)
        and back(m.build(), "tip", table, m.build().random(0, 3)) < 1e-12
    )


@pytest.mark.parametrize(
    ("name", "frame"), [("ball", "ball"), ("joint_helical", "body"), ("joint_fixed", "body")]
)
def test_what_has_no_table(name, frame):
    with pytest.raises(UnsupportedError):
        kempe.load(name).symbolic.to_dh(frame)


def test_refusals():
    arm = kempe.load("two_link")
    with pytest.raises(UnknownNameError, match="'standard', 'modified'"):
        arm.symbolic.to_dh("e", "craig")
    with pytest.raises(UnknownNameError):
        arm.symbolic.to_dh("hand")
    with pytest.raises(UnsupportedError, match="no numbers are known for k"):
        arm.symbolic.to_dh("e", symbols={"l1": sympy.Symbol("k")})


def test_the_text_says_where_the_first_and_the_last_frame_are():
    """Where they are not those of the ground and of the tip: rows alone would give another place."""
    m = kempe.Mechanism("tilted", dim=2)
    m.revolute("q1", m.ground, m.body("A"), at=(0.2, 0.1))
    m.frame("tip", "A", at=(0.5, 0), angle=0.25)
    table = m.build().symbolic.to_dh("tip")
    text = str(table)
    assert "frame 0 in the ground: at (0.2, 0.1, 0), rpy (0, 0, 0)" in text
    assert (
        "tip in the last frame: at (0, 0, 0), rpy (0, 0, 0.25)" in text
        and "0.25)" in table._repr_html_()
    )
    assert "frame" not in str(kempe.load("two_link").symbolic.to_dh("e"))


@pytest.mark.slow
def test_axes_that_are_nearly_parallel(hunt):
    """Angles down to a few 1e-8 are in the table: six decimals of pi / 2 are off by 3.3e-7, which a
    long arm shows.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        m = kempe.Mechanism("near")
        L = 10.0 ** rng.uniform(-1, 3)
        off = 10.0 ** rng.uniform(-7.0, -2.0)
        a = m.body("a")
        b = m.body("b")
        m.revolute("q1", m.ground, a)
        m.revolute("q2", a, b, at=(L, 0.1 * L, 0), rpy=(0, off, rng.uniform(-3, 3)))
        m.frame("tool", b, at=L * rng.normal(size=3))
        system = m.build()
        q = rng.uniform(-3, 3, 2)
        table = system.symbolic.to_dh("tool", rng.choice(["standard", "modified"]))
        X = system.fk(q, "tool")
        Y = table.mechanism().build().fk(q, "tool")
        assert np.abs(X - Y)[:3, 3].max() < 2e-8 * L and np.abs(X - Y)[:3, :3].max() < 1e-8, off
