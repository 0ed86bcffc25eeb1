"""Assembly modes that a traced path does not pass: a four-bar has two branches where Grashof's sum
says so.
"""

from __future__ import annotations

import numpy as np
import pytest

import kempe


def four_bar(ground: float, crank: float, coupler: float, rocker: float) -> kempe.System:
    """A four-bar by its lengths."""
    m = kempe.Mechanism("four-bar", dim=2)
    a = m.body("crank")
    b = m.body("coupler")
    c = m.body("rocker")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(crank, 0))
    m.revolute("C", b, c, at=(coupler, 0), child_at=(rocker, 0))
    m.revolute("D", m.ground, c, at=(ground, 0))
    return m.build()


def hunted(rng: np.random.Generator, count: int) -> tuple[int, int]:
    """Four-bars with two branches, and with one; what is said of each agrees with Grashof (1883)."""
    tally = [0, 0]
    for _ in range(count):
        lengths = rng.uniform(0.2, 1.0, 4)
        least = lengths.min()
        most = lengths.max()
        if most > 0.98 * (lengths.sum() - most) or abs(2 * (least + most) - lengths.sum()) < 0.1:
            continue  # it does not close, or it is near the border
        path = four_bar(*lengths).trace("A")
        two = bool(2 * (least + most) < lengths.sum())
        # the other branch is the mirror image, which may have none of these angles
        A = path.values("A")
        two &= any(A.min() <= 2 * np.pi * k - A[0] <= A.max() for k in (-1, 0, 1))
        assert len(path.elsewhere) == two, (lengths.tolist(), str(path))
        assert bool(path.hint) == two == ("not on this curve" in str(path))
        if two:
            other = path.system.trace("A", start=path.elsewhere[0])
            crossed = np.linalg.norm(
                np.angle(np.exp(1j * (other.q[:, None] - path.q[None]))), axis=-1
            )
            assert other.success and crossed.min() > 1e-3 and len(other.elsewhere) == 1
        tally[two] += 1
    return tally[1], tally[0]


def test_four_bars_say_whether_they_have_another_branch(hunt):
    assert min(hunted(hunt.rng(), cases := hunt.cases(20))) >= cases // 10


@pytest.mark.slow
def test_many_four_bars_say_whether_they_have_another_branch(hunt):
    assert min(hunted(hunt.rng(), cases := hunt.cases(250, least=75))) > cases // 8


def test_the_sentence_names_the_input_and_its_value():
    path = four_bar(0.3, 0.1, 0.3, 0.25).trace("A", start={"A": 0.3})
    said = "1 other assembly mode with 'A' = 0.3 rad is not on this curve"
    assert path.hint == said
    start = str(path).partition(f"  {said}; trace it with start=(")[2].partition(")")[0]
    np.testing.assert_allclose([float(x) for x in start.split(",")], path.elsewhere[0], atol=1e-8)


def test_the_sentence_speaks_of_the_driver_only():
    """The rocker of a crank-rocker has other angles on the other branch: there is none with the
    driver's value.
    """
    path = four_bar(0.3, 0.1, 0.3, 0.25).trace("D", start={"A": 0.3})
    assert path.success and path.hint == "" and not len(path.elsewhere)


def test_without_a_driver_the_first_coordinate_with_a_closed_form_is_taken():
    assert kempe.load("slider_crank").trace().hint.startswith("1 other assembly mode with 'A'")


@pytest.mark.parametrize("name", ["bennett", "two_link"])
def test_where_nothing_is_known_nothing_is_said(name: str):
    s = kempe.load(name)
    path = s.trace(hold={"q2": 0.3}) if name == "two_link" else s.trace()
    assert path.hint == "" and path.elsewhere.shape == (0, s.nq)


def test_mechanisms_of_many_dyads_are_left_alone():
    m = kempe.Mechanism("row", dim=2)
    left = m.body("a0")
    m.revolute("A0", m.ground, left)
    for i in range(7):
        bar = m.body(f"b{i}")
        right = m.body(f"a{i + 1}")
        m.revolute(f"B{i}", left, bar, at=(0.4, 0))
        m.revolute(f"C{i}", bar, right, at=(1, 0), child_at=(0.45, 0))
        m.revolute(f"A{i + 1}", m.ground, right, at=(i + 1, 0))
        left = right
    assert m.build().trace("A0", start={"A0": 1.2}, budget=kempe.Budget(points=20)).hint == ""
