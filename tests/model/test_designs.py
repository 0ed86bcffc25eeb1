"""Batches of designs: one structure, many lengths."""

from __future__ import annotations

import numpy as np
import pytest

from kempe import Mechanism, System
from kempe.errors import InputError, UnknownNameError


def two_link() -> System:
    m = Mechanism("two-link", dim=2)
    m.parameter("l1", 1.0), m.parameter("l2", 0.7), m.parameter("alpha", 0.0)
    (
        m.revolute("q1", m.ground, m.body("a")),
        m.revolute("q2", "a", m.body("b"), at=("l1", 0), angle="alpha"),
    )
    m.frame("tip", "b", at=("l2", 0))
    return m.build()


def closed_form(l1, l2, alpha, q1, q2):
    return np.stack(
        [
            l1 * np.cos(q1) + l2 * np.cos(q1 + q2 + alpha),
            l1 * np.sin(q1) + l2 * np.sin(q1 + q2 + alpha),
        ],
        axis=-1,
    )


def test_the_lectures_formula_for_many_lengths():
    s = two_link()
    rng = np.random.default_rng(0)
    l1 = rng.uniform(0, 2, (3, 1))
    l2 = rng.uniform(0, 2, 4)
    alpha = rng.normal(size=(3, 4))
    q = s.random(rng, (3, 4, 5))
    designs = s.with_parameters(l1=l1, l2=l2, alpha=alpha)
    assert designs.shape == (3, 4) and repr(designs) == "Designs('two-link', shape=(3, 4))"
    expected = closed_form(l1[..., None], l2[:, None], alpha[..., None], q[..., 0], q[..., 1])
    np.testing.assert_allclose(designs.fk(q, "tip")[..., :2, 3], expected, rtol=0, atol=1e-14)


def test_one_configuration_for_all():
    s = two_link()
    designs = s.with_parameters(l1=np.linspace(1, 2, 5))
    T = designs.fk({"q1": 0.3, "q2": 0.4}, "tip")
    np.testing.assert_allclose(
        T[:, :2, 3], closed_form(np.linspace(1, 2, 5), 0.7, 0.0, 0.3, 0.4), rtol=0, atol=1e-15
    )
    np.testing.assert_array_equal(designs.fk([0.3, 0.4], s.structure.frames["tip"]), T)


def test_a_design_can_be_taken_out():
    s = two_link()
    designs = s.with_parameters(l1=np.linspace(1, 2, 6).reshape(2, 3), l2=0.5)
    one = designs[1, 2]
    assert isinstance(one, System) and one.structure.parameters == {
        "l1": 2.0,
        "l2": 0.5,
        "alpha": 0.0,
    }
    assert (
        designs[0].shape == (3,)
        and designs[:, 1:].shape == (2, 2)
        and designs[designs.parameters["l1"] > 1.5].shape == (3,)
    )
    q = s.random(0)
    np.testing.assert_array_equal(designs[0].fk(q, "tip"), designs.fk(q, "tip")[0])
    with pytest.raises(IndexError):
        designs[5]


def test_impossible_designs_are_nan_and_leave_the_others_alone():
    m = Mechanism()
    m.parameter("d", 1.0)
    m.revolute("j", m.ground, m.body("b"), at=("sqrt(d)", 0, 0))
    T = m.build().with_parameters(d=[1.0, -1.0, 4.0]).fk([0.0], "b")
    np.testing.assert_array_equal(T[[0, 2], 0, 3], [1.0, 2.0])
    assert np.isnan(T[1, :3]).any()


def test_bad_questions():
    s = two_link()
    designs = s.with_parameters(l1=[1.0, 2.0])
    with pytest.raises(UnknownNameError, match="two-link has no frame 'tipp'; did you mean 'tip'"):
        designs.fk([0, 0], "tipp")
    with pytest.raises(InputError, match="q has 3 coordinates; two-link needs 2"):
        designs.fk([0, 0, 0], "tip")
    with pytest.raises(
        InputError, match=r"q has shape \(3, 2\); it must be \(2,\) or begin with \(2,\)"
    ):
        designs.fk(np.zeros((3, 2)), "tip")


def test_systems_without_coordinates():
    m = Mechanism()
    m.parameter("d", 1.0)
    m.frame("f", m.ground, at=("d", 0, 0))
    designs = m.build().with_parameters(d=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(designs.fk([], "f")[:, 0, 3], [1, 2, 3])
    assert designs.fk(np.zeros((3, 4, 0)), "f").shape == (3, 4, 4, 4)
