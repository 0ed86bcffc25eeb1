"""Batches of designs: one structure, many lengths."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe import Mechanism, System
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.status import Status


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


# ---- loops


def close_four_bar(a, b, c, d, A, sign):
    """Direction of the coupler of the four-bar of the library, by the law of cosines.

    Its pins are (0, 0), a (cos A, sin A), and (d, 0); the sign is that of the side of the pin of
    coupler and rocker on the way from the crank's end to the ground.
    """
    end = a * np.exp(1j * A)
    way = d - end
    cosine = (b**2 + np.abs(way) ** 2 - c**2) / (2 * b * np.abs(way))
    return np.angle(way) + sign * np.arccos(cosine)


@pytest.mark.parametrize("branch", ["+", "-"])
def test_four_bars_close_as_the_law_of_cosines_says(branch):
    bar = kempe.load("four_bar")
    rng = np.random.default_rng(1)
    numbers = {k: x * rng.uniform(0.8, 1.2, (50, 4)) for k, x in bar.structure.parameters.items()}
    designs = bar.with_parameters(**numbers)
    A = rng.uniform(-3.0, 3.0, (50, 4, 7))
    answer = designs.assemble({"A": A}, branch=branch)
    a, b, c, d = (numbers[k][..., None] for k in "abcd")
    with np.errstate(invalid="ignore"):
        coupler = close_four_bar(a, b, c, d, A, 1 if branch == "+" else -1)
    closes = np.isfinite(coupler)
    assert answer.q.shape == (50, 4, 7, 4) and 100 < closes.sum()
    np.testing.assert_array_equal(answer.success, closes)
    at = bar.coordinate_names.index
    turned = answer.q[..., at("A")] + answer.q[..., at("B")] - coupler
    assert np.abs(np.sin(0.5 * turned[closes])).max() < 1e-12
    X = designs.fk(answer.q, "coupler")
    pin = X[..., :2, 3] + b[..., None] * X[..., :2, 0]
    far = np.stack([a * np.cos(A) + b * np.cos(coupler), a * np.sin(A) + b * np.sin(coupler)], -1)
    np.testing.assert_allclose(pin[closes], far[closes], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("watt_six_bar", "A"),
        ("jansen", "crank"),
        ("klann", "crank"),
        ("slider_crank", "A"),
        ("peaucellier", "crank"),
    ],
)
def test_designs_close_as_each_of_them_alone(name, known):
    """On every branch, where the loops of some do not close; angles are near the start."""
    system = kempe.load(name)
    rng = np.random.default_rng(2)
    numbers = {
        k: x * rng.uniform(0.9, 1.1, 12) for k, x in system.structure.parameters.items() if x
    }
    known = known if known in system.coordinate_names else system.coordinate_names[0]
    designs = system.with_parameters(**numbers)
    values = rng.uniform(-1.0, 1.0, (12, 5))
    signs = system.loops.closed_form([known]).signs
    start = system.mid
    closed = 0
    for branch in rng.choice(["+", "-"], (3, signs)).tolist():
        answer = designs.assemble({known: values}, branch="".join(branch), start=start)
        for i in range(12):
            one = (
                designs[i]
                .loops.closed_form([known])
                .close(values[i, :, None], "".join(branch), start)
            )
            np.testing.assert_array_equal(answer.success[i], one.success)
            np.testing.assert_allclose(answer.gap[i], one.gap, atol=1e-12)
            np.testing.assert_allclose(
                answer.q[i][one.success], one.q[one.success], rtol=0, atol=1e-9
            )
            closed += int(np.count_nonzero(one.success))
    assert closed > 20


def make_rod() -> System:
    """Crank and rocker with a rod between them that is a distance."""
    m = Mechanism("rod", dim=2)
    for name, x in {"a": 0.1, "l": 0.5, "c": 0.4, "d": 0.4, "t": 0.3, "off": 0.05}.items():
        m.parameter(name, x)
    m.revolute("A", m.ground, m.body("crank"))
    m.revolute("D", m.ground, m.body("rocker"), at=("d", 0), angle="t")
    m.distance("rod", "crank", "rocker", "l", at=("a", 0), child_at=("c", "off"))
    return m.build()


def make_slot() -> System:
    """A pin of a crank in a slot of a lever, which a gear turns on."""
    m = Mechanism("slot", dim=2)
    for name, x in {"a": 0.1, "g": 0.3, "h": 0.02, "t": 0.3}.items():
        m.parameter(name, x)
    m.revolute("A", m.ground, m.body("crank"))
    m.revolute("W", m.ground, m.body("wheel"))
    m.couple("W", {"A": -2.0})
    m.revolute("D", m.ground, m.body("lever"), at=("g", 0), angle="t")
    m.point_on_line("slot", "lever", "wheel", at=(0, "h"), axis=(1, 0), child_at=("a", 0))
    return m.build()


@pytest.mark.parametrize("make", [make_rod, make_slot])
def test_rods_slots_and_gears(make):
    """As each design alone, on both branches."""
    system = make()
    rng = np.random.default_rng(3)
    numbers = {k: x * rng.uniform(0.9, 1.1, 30) for k, x in system.structure.parameters.items()}
    designs = system.with_parameters(**numbers)
    A = rng.uniform(-3.0, 3.0, (30, 6))
    for branch in "+-":
        answer = designs.assemble({"A": A}, branch=branch)
        for i in range(30):
            one = designs[i].loops.closed_form(["A"]).close(A[i, :, None], branch)
            np.testing.assert_array_equal(answer.success[i], one.success)
            np.testing.assert_allclose(answer.q[i], one.q, rtol=0, atol=1e-9)
        assert answer.success.sum() > 90


def test_values_are_for_all_designs_or_for_each():
    bar = kempe.load("four_bar")
    designs = bar.with_parameters(b=np.linspace(0.45, 0.55, 4))
    A = np.linspace(0.0, 1.0, 4)
    each = designs.assemble({"A": A})
    every = designs.assemble({"A": A[None]})
    assert each.q.shape == (4, 4) and every.q.shape == (4, 4, 4)
    np.testing.assert_array_equal(every.q[range(4), range(4)], each.q)
    np.testing.assert_array_equal(designs.assemble({"A": 0.0}).q, every.q[:, 0])
    assert every.success.all() and every.status == "16 of 16 configurations closed" and bool(every)
    closed = bar.q("closed")
    np.testing.assert_array_equal(  # the branch of the posture 'closed'
        designs.assemble({"A": closed[0]}).q,
        designs.assemble({"A": closed[0]}, start=closed).q,
    )
    with pytest.raises(InputError, match=r"'A' has shape \(3,\); known values must be one number"):
        designs.assemble({"A": A[:3]})
    with pytest.raises(UnknownNameError, match="'Aa'"):
        designs.assemble({"Aa": 0.0})
    with pytest.raises(InputError, match="one for each dyad"):
        designs.assemble({"A": 0.0}, branch="++")
    none = bar.with_parameters(b=np.zeros(0)).assemble({"A": np.zeros((1, 5))})
    assert none.q.shape == (0, 5, 4)


def test_what_does_not_close_is_said_and_leaves_the_others_alone():
    bar = kempe.load("four_bar")
    designs = bar.with_parameters(b=[0.5, 3.0, 0.5])
    answer = designs.assemble({"A": [0.1, 0.1, np.nan]})
    assert answer.success.tolist() == [True, False, False]
    assert [Status(c).name for c in answer.code] == ["SOLVED", "NOT_FOUND", "BAD_INPUT"]
    assert "1 of 3 configurations closed; the others are open by up to 2." in answer.status
    stewart = kempe.load("stewart")
    with pytest.raises(UnsupportedError, match="'stewart' is not planar"):
        stewart.with_parameters(
            **{k: [x, x] for k, x in list(stewart.structure.parameters.items())[:1]}
        ).assemble({})


def test_pins_that_part_in_some_designs_are_refused():
    """Three bars on one pin are two dyads, one after the other; on two pins they are none."""
    m = kempe.Mechanism("hinge", dim=2)
    m.parameter("apart", 0.0)
    crank, first, middle, last, block = (
        m.body(n) for n in ("crank", "first", "middle", "last", "block")
    )
    m.revolute("A", m.ground, crank)
    m.revolute("B", crank, first, at=(0.2, 0))
    m.revolute("H1", first, middle, at=(0.6, 0))
    m.revolute("H2", middle, last, at=("apart", 0))
    m.revolute("G", last, m.ground, at=(0.5, 0), child_at=(0.6, 0))
    m.revolute("S", middle, block, at=(0.9, 0))
    m.prismatic("T", m.ground, block, axis="x")
    system = m.build()
    assert system.with_parameters(apart=[0.0, 0.0]).assemble({"A": 0.5}).success.all()
    with pytest.raises(UnsupportedError, match="pins coincide, or rails are parallel, in some"):
        system.with_parameters(apart=[0.0, 0.1]).assemble({"A": 0.5})
