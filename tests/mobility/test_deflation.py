"""Motions along which the Jacobian has a larger null space than freedoms: linkages that hang on
bars in line.
"""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hunts import some
from world_mechanisms import World, axes_with

import kempe
from kempe import Mechanism
from kempe.errors import UnsupportedError

STILL = {"SA": 0.0, "SB": 0.0, "SC": 0.0}


def bars_in_line(m: Mechanism, lengths=(0.2, 0.3)) -> str:
    """The first of two bars between fixed points: to first order they move, truly they do not."""
    one = m.body("s1")
    two = m.body("s2")
    m.revolute("SA", m.ground, one)
    m.revolute("SB", one, two, at=(lengths[0], 0))
    m.revolute("SC", m.ground, two, at=(sum(lengths), 0), child_at=(lengths[1], 0))
    return "s1"


def four_bar(on_bars: bool, lengths=(0.1, 0.4, 0.3), base: float = 0.4) -> kempe.System:
    """A four-bar linkage, on the ground or on bars in line."""
    m = Mechanism("four-bar", dim=2)
    ground = bars_in_line(m) if on_bars else m.ground
    for body in ("crank", "coupler", "rocker"):
        m.body(body)
    a, b, c = lengths
    m.revolute("A", ground, "crank")
    m.revolute("B", "crank", "coupler", at=(a, 0))
    m.revolute("C", "coupler", "rocker", at=(b, 0), child_at=(c, 0))
    m.revolute("D", ground, "rocker", at=(base, 0))
    return m.build()


@pytest.mark.slow
def test_a_pendulum_on_bars_in_line_turns_all_round():
    """Its closed form: the angle runs, the bars rest."""
    system = kempe.load("pendulum_dead_centre")
    for path in (system.trace("P"), system.trace()):
        assert (
            path.closed
            and path.success
            and not path.singular_points
            and "may be passed unseen" in path.status
        )
        np.testing.assert_allclose(path.q[:, :3], 0.0, atol=1e-12)
        np.testing.assert_allclose(path.q[:, 3] - path.q[0, 3], path.s, atol=1e-9)
        assert path.s[-1] == pytest.approx(2 * np.pi, abs=1e-9)
    start = system.q_dict(system.q("closed"))["P"]
    motion = system.drive({"P": start + np.linspace(0, 3, 9)})
    assert motion.success
    np.testing.assert_allclose(motion.q[:, :3], 0.0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("driver", some(["A", "D"], 3))
def test_a_four_bar_on_bars_in_line_moves_as_on_the_ground(driver):
    alone = four_bar(False)
    hanging = four_bar(True)
    a = alone.trace(driver, alone.assemble({"A": 0.3}).q)
    b = hanging.trace(driver, hanging.assemble({"A": 0.3, **STILL}).q)
    assert (
        a.closed
        and b.closed
        and b.s[-1] == pytest.approx(a.s[-1], abs=1e-9)
        and "unseen" not in a.status
    )
    np.testing.assert_allclose(b.q[:, :3], 0.0, atol=1e-9)
    np.testing.assert_allclose(
        [e.value for e in b.turning_points], [e.value for e in a.turning_points], atol=1e-9
    )
    here = np.linspace(0, a.s[-1], 20)
    np.testing.assert_allclose(b.at(here)[:, 3:], a.at(here), atol=1e-8)


def test_paths_are_pickled():
    path = kempe.load("pendulum_dead_centre").trace("P")
    again = pickle.loads(pickle.dumps(path))
    np.testing.assert_array_equal(again.at(1.0), path.at(1.0))


@pytest.mark.slow
def test_hunt_four_bars_on_bars_in_line(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(3)):
        lengths = rng.uniform(0.2, 1.0, 4)
        while 2 * lengths.max() > 0.98 * lengths.sum():  # it does not close, or hardly
            lengths = rng.uniform(0.2, 1.0, 4)
        alone, hanging = (four_bar(on, lengths[:3], float(lengths[3])) for on in (False, True))
        start = alone.assemble(start={"A": float(rng.uniform(-3, 3))})
        assert start
        A = alone.q_dict(start.q)
        a = alone.trace("A", start.q)
        b = hanging.trace("A", hanging.q({**A, **STILL}))
        assert a.closed == b.closed and b.s[-1] == pytest.approx(a.s[-1], abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("A", some([0.4, 0.7, 1.3, 2.2, 2.7], 4))
def test_a_parallelogram_on_bars_in_line_goes_straight_on(A):
    """It passes its change points, as on the ground; the other branch may be unseen there, which is
    said.
    """
    alone, hanging = (four_bar(on, (1.0, 3.0, 1.0), 3.0) for on in (False, True))
    a = alone.trace("A", alone.assemble({"A": A}).q)
    b = hanging.trace("A", hanging.assemble({"A": A, **STILL}).q)
    assert a.closed and b.closed and b.s[-1] == pytest.approx(a.s[-1], abs=1e-8)
    assert len(a.singular_points) == 2 and "may be passed unseen" in b.status


@pytest.mark.slow
def test_two_freedoms_on_bars_in_line_are_refused():
    m = Mechanism("two pendulums", dim=2)
    on = bars_in_line(m)
    m.revolute("P", on, m.body("one"), at=(0.1, 0))
    m.revolute("Q", on, m.body("two"), at=(0.05, 0))
    system = m.build()
    with pytest.raises(UnsupportedError, match="to first order here, and 1 driver"):
        system.trace("P")
    assert system.trace("P", hold={"Q": 0.0}).closed
    motion = system.drive({"P": [0.0, 1.0], "Q": [0.0, -1.0]})
    assert motion.success
    np.testing.assert_allclose(motion.q[-1], [0, 0, 0, 1.0, -1.0], atol=1e-12)


def rssr_on_bars(draw: np.random.Generator, on_bars: bool, form: str) -> kempe.System:
    """A rod between two arms, on the ground or on bars in line; `form` says whether the rod spins
    (SS) or not (SU).
    """
    w = World("rssr")
    ground = "ground"
    if on_bars:
        w.turn("ground", "s1", (0, 0, 0), name="SA")
        w.turn("s1", "s2", (0.3, 0, 0), name="SB")
        w.turn("ground", "s2", (0.8, 0, 0), name="SC")
        ground = "s1"
    b, c = draw.uniform(-1, 1, (2, 3))
    x, y, _ = axes_with(c - b).T
    w.turn(ground, "crank", draw.uniform(-1, 1, 3), draw.normal(size=3), name="A")
    w.ball("crank", "rod", b, name="B")
    if form == "SS":
        w.ball("rod", "rocker", c, name="C")
    else:
        w.cross("rod", "rocker", c, x, y, name="C")
    w.turn(ground, "rocker", draw.uniform(-1, 1, 3), draw.normal(size=3), name="D")
    return w.build()


def assert_moves_as_on_the_ground(seed: int, form: str) -> None:
    hanging = rssr_on_bars(np.random.default_rng(seed), True, form)
    alone = rssr_on_bars(np.random.default_rng(seed), False, "SU")
    path, other = (s.trace("A", s.neutral.copy()) for s in (hanging, alone))
    np.testing.assert_allclose(path.q[:, :3], 0.0, atol=1e-7)
    assert path.closed == other.closed and len(path) > 1
    ends = [
        np.sort([np.cos(e.value) for e in p.extremes if e.coordinate in "AD"])
        for p in (path, other)
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)
    assert hanging.independent().dim == (2 if form == "SS" else 1)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["SS", "SU"])
def test_a_rod_on_bars_in_line_moves_as_on_the_ground(form):
    """Both at once: the rod spins, and the rank is low along the motion."""
    assert_moves_as_on_the_ground(2, form)


@pytest.mark.slow
def test_hunt_rods_on_bars_in_line(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(10)):
        assert_moves_as_on_the_ground(int(rng.integers(2**32)), str(rng.choice(["SS", "SU"])))
