"""Motions that have no end, those that only seem to have none, and what is done when the time is
up.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hunts import some

import kempe
from kempe import Mechanism
from kempe.arguments import call_until_interrupt
from kempe.errors import InputError
from kempe.numerics.newton import solve_least_squares


def two_slides(tilt: float) -> kempe.System:
    """A bar between two slides in the plane that are nearly parallel: its joints run far out, and
    come back.
    """
    m = Mechanism("two slides", dim=2)
    a = m.body("a")
    b = m.body("b")
    c = m.body("c")
    m.prismatic("S", m.ground, a, axis=(1, 0))
    m.revolute("A", a, b)
    m.revolute("B", b, c, at=(1, 0))
    m.prismatic("T", m.ground, c, axis=(math.cos(tilt), math.sin(tilt)))
    return m.build()


def rprp(offset: float) -> kempe.System:
    m = Mechanism("rprp", dim=2)
    a = m.body("a")
    b = m.body("b")
    c = m.body("c")
    m.revolute("A", m.ground, a)
    m.prismatic("S", a, b, axis=(1, 0))
    m.revolute("B", b, c)
    m.prismatic("T", m.ground, c, at=(0, offset), axis=(1, 0))
    return m.build()


def three_slides() -> kempe.System:
    m = Mechanism("wedge", dim=2)
    a = m.body("a")
    b = m.body("b")
    m.prismatic("A", m.ground, a, axis=(1, 0))
    m.prismatic("B", a, b, axis=(1, 1))
    m.prismatic("C", m.ground, b, axis=(1, 2))
    return m.build()


def screws() -> kempe.System:
    m = Mechanism("screws")
    a = m.body("a")
    b = m.body("b")
    m.helical("H", m.ground, a, pitch=0.01)
    m.helical("K", a, b, pitch=0.013)
    m.prismatic("P", m.ground, b)
    return m.build()


def slide() -> kempe.System:
    m = Mechanism("slide", dim=2)
    m.prismatic("S", m.ground, m.body("a"), axis=(1, 0))
    return m.build()


def gears(ratio: float, bars: bool = False) -> kempe.System:
    """Two wheels, the second `ratio` times as fast; with `bars` pins on both are joined by two
    bars.
    """
    m = Mechanism("gears", dim=2)
    a = m.body("a")
    b = m.body("b")
    m.revolute("A", m.ground, a)
    m.revolute("B", m.ground, b, at=(2, 0))
    m.couple("B", {"A": ratio})
    if bars:
        c = m.body("c")
        d = m.body("d")
        m.revolute("C", a, c, at=(0.3, 0))
        m.revolute("D", c, d, at=(2, 0))
        m.revolute("E", b, d, at=(0.4, 0), child_at=(1.5, 0))
    return m.build()


# ---- no end


ENDLESS = {
    "rprp": lambda: rprp(0.3),
    "three slides": three_slides,
    "screws": screws,
    "slide": slide,
    "library screw": lambda: kempe.load("joint_helical"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", some(ENDLESS, 3))
def test_what_runs_away_is_said_to(name):
    s = ENDLESS[name]()
    path = s.trace()
    assert path and not path.closed and len(path) < 3000
    assert all(end.startswith("infinity: no end was found up to '") for end in path.ends)
    if s.structure.closures:
        assert np.abs(s.loops.closure_error(path.q)).max() < 1e-9


@pytest.mark.slow
def test_a_limit_ends_what_would_run_away():
    m = Mechanism("slide", dim=2)
    m.prismatic("S", m.ground, m.body("a"), axis=(1, 0), limits=(-math.inf, 90.0))
    path = m.build().trace("S", {"S": 0.0})
    assert (
        "upper limit 90" in path.ends[1]
        and path.ends[0].startswith("infinity")
        and path.q[-1, 0] == 90.0
    )


@pytest.mark.slow
@pytest.mark.parametrize("bars", [False, True], ids=["wheels", "bars"])
@pytest.mark.parametrize("ratio", some([math.sqrt(2.0), -math.pi, 1.0 / 1009.0], 3))
def test_gears_without_a_ratio_of_whole_numbers_do_not_come_back(ratio, bars):
    path = gears(ratio, bars).trace()
    assert path and not path.closed and len(path) < 3000
    assert (
        "does not come back within 1000 turns of 'A': 'B'" in path.ends[1]
        and path.ends[0] == "the start"
    )


# ---- an end, though far away


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.3, 0.03])
def test_nearly_parallel_slides_come_back(tilt):
    """The ellipse of the slides' places has the half axis 1 / (2 sin(tilt/2)): far beyond where one
    looks ahead.
    """
    path = two_slides(tilt).trace()
    assert path.closed and path.turns == {"A": 1, "B": -1} or path.closed
    reach = max(
        np.abs(path.values("S")).max(),
        *(abs(e.value) for e in path.extremes if e.coordinate == "S"),
    )
    assert reach == pytest.approx(1.0 / math.sin(tilt), rel=1e-6)


def test_ratios_of_whole_numbers_close(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(6)):
        p = int(rng.integers(1, 30))
        q = int(rng.integers(1, 30))
        path = gears(p / q).trace(budget=kempe.Budget(step=1.0))
        assert path.closed and path.turns == {"A": q // math.gcd(p, q)}, (p, q)


def test_long_periods_are_reported_where_points_end():
    path = gears(1.0 / 997.0).trace(budget=kempe.Budget(points=1000))
    assert not path.closed and "by its gear ratios all is as before after 997" in path.ends[1]


def test_many_turns_close():
    path = gears(355.0 / 113.0).trace(budget=kempe.Budget(step=1.0))
    assert path.closed and path.turns == {"A": 113}


# ---- the time is up


@pytest.mark.parametrize("look", [0, 1, 10, 22, 37])
def test_a_path_keeps_what_was_done(looks, look):
    s = kempe.load("four_bar")
    whole = s.trace(ways="forward")
    looks(look)
    path = s.trace(ways="forward", budget=kempe.Budget(time_limit=5.0))
    assert path.late and not path and not path.interrupted and "the time limit" in path.status
    np.testing.assert_array_equal(path.q, whole.q[: len(path)])
    assert len(path) < len(whole) or path.remark


def test_a_limit_that_does_not_bite_changes_nothing(looks):
    s = kempe.load("jansen")
    whole = s.trace(budget=kempe.Budget(time_limit=math.inf))
    looks(10**9)
    path = s.trace(budget=kempe.Budget(time_limit=1.0))
    np.testing.assert_array_equal(path.q, whole.q)
    assert path and not path.late and path.status == whole.status


def test_a_path_can_be_read_when_its_time_is_over(looks):
    path = kempe.load("four_bar").trace(budget=kempe.Budget(time_limit=5.0))
    looks(0)
    assert np.isfinite(path.at([0.1, 0.2])).all()
    assert len(path.resample(50, budget=kempe.Budget(time_limit=math.inf))) == 50


def test_other_branches_that_were_not_followed_are_reported(looks):
    s = kempe.load("parallelogram")
    whole = s.trace(ways="branches")
    assert whole.others and whole
    looks(120)
    path = s.trace(ways="branches", budget=kempe.Budget(time_limit=5.0))
    assert path.late and not path and len(path.others) <= len(whole.others)


def test_samples_points_and_self_motions_keep_what_was_done(looks):
    s = kempe.load("four_bar")
    panda = kempe.load("panda")
    path = s.trace()
    looks(390)
    motion = s.drive({"A": np.linspace(0.0, 6.0, 300)}, budget=kempe.Budget(time_limit=5.0))
    assert (
        motion.late and not motion and 0 < len(motion) < 300 and len(motion.times) == len(motion.q)
    )
    looks(3)
    points = path.resample(100_000, budget=kempe.Budget(time_limit=5.0))
    assert points.late and not points and not points.closed and 0 < len(points) < 100_000
    assert (
        "of 100000 points" in points.status
        and np.abs(s.loops.closure_error(points.q)).max() < 1e-12
    )
    looks(20)
    family = panda.inverse.self_motion(
        panda.q("ready"), "panda_hand_tcp", budget=kempe.Budget(time_limit=5.0)
    )
    assert family.late and 1 < len(family) < 10 and "time limit of 5 s" in family.ends[1]


def test_modes_and_paths_of_targets_keep_what_was_done(looks):
    s = kempe.load("rssr")
    panda = kempe.load("panda")
    looks(40)
    modes = s.assembly_modes({"A": 0.4}, frame="rocker", budget=kempe.Budget(time_limit=5.0))
    assert (
        modes.late
        and modes
        and "found from 384 starts" in modes.status
        and "time limit" in modes.status
    )
    q = panda.q("ready") + 0.3 * np.linspace(0.0, 1.0, 50)[:, None]
    looks(3)
    path = panda.ik_path(
        panda.fk(q, "panda_hand_tcp"), "panda_hand_tcp", q[0], budget=kempe.Budget(time_limit=5.0)
    )
    assert path.late and not path and 0 < path.success.sum() < 50 and "time limit" in path.status


@pytest.mark.parametrize(
    "verb", ["trace", "resample", "drive", "self_motion", "assembly_modes", "ik_path"]
)
@pytest.mark.parametrize("limit", [0.0, -1.0, "5", True])
def test_wrong_limits_are_refused(verb, limit):
    s = kempe.load("four_bar")
    panda = kempe.load("panda")
    calls = {
        "trace": lambda: s.trace(budget=kempe.Budget(time_limit=limit)),
        "resample": lambda: s.trace().resample(5, budget=kempe.Budget(time_limit=limit)),
        "drive": lambda: s.drive({"A": [0.0, 0.1]}, budget=kempe.Budget(time_limit=limit)),
        "self_motion": lambda: panda.inverse.self_motion(
            panda.q("ready"), "panda_hand_tcp", budget=kempe.Budget(time_limit=limit)
        ),
        "assembly_modes": lambda: s.assembly_modes(
            {"A": 0.3}, budget=kempe.Budget(time_limit=limit)
        ),
        "ik_path": lambda: panda.ik_path(
            panda.fk(panda.mid, "panda_hand_tcp")[None],
            "panda_hand_tcp",
            budget=kempe.Budget(time_limit=limit),
        ),
    }
    with pytest.raises(InputError, match="time_limit"):
        calls[verb]()


@pytest.mark.parametrize("phase", ["walk", "order"])
def test_an_interrupt_keeps_the_path(monkeypatch, phase):
    """Also where it comes after the walk, when special points are looked for."""
    s = kempe.load("four_bar")
    name = "find_return" if phase == "walk" else "find_extreme"
    count = itertools.count()
    own = getattr(kempe.motion.trace, name)

    def broken(*given):
        if next(count) == (30 if phase == "walk" else 3):
            raise KeyboardInterrupt
        return own(*given)

    whole = s.trace()
    monkeypatch.setattr(f"kempe.motion.trace.{name}", broken)
    path = call_until_interrupt(s.trace)
    assert path.interrupted and not path and not path.late and "interrupted" in path.status
    assert len(path) == len(whole) if phase == "order" else 20 < len(path) < len(whole)
    assert ("where it turns back" in path.status) == (phase == "order")


# ---- many points at once


@pytest.mark.parametrize(
    "name",
    some(["four_bar", "jansen", "bennett", "double_parallelogram", "schatz", "peaucellier"], 4),
)
def test_points_at_equal_distances_are_those_of_newtons_method_point_by_point(name):
    path = kempe.load(name).trace()
    found = path.resample(137)
    e = path.track.equations
    T = path.track
    assert found.s.tolist() == np.linspace(0.0, path.length, 137).tolist()
    for s, q in zip(found.s, found.q, strict=True):
        k = int(np.clip(np.searchsorted(T.s, s, side="right") - 1, 0, len(T.s) - 2))
        size = T.s[k + 1] - T.s[k]
        u = (s - T.s[k]) / size
        y = e.compute_difference(T.q[k], T.q[k + 1])
        a = size * T.t[k]
        b = size * T.t[k + 1]
        x = e.move_point(
            T.q[k], u * (1 - u) ** 2 * a + u * u * (3 - 2 * u) * y - u * u * (1 - u) * b
        )
        for _ in range(3):
            F, J = e.evaluate_equations(x)
            across = (1 - u) * T.t[k] + u * T.t[k + 1]
            x = e.move_point(x, solve_least_squares(np.vstack([J, across]), np.append(-F, 0.0)))
        np.testing.assert_allclose(q, x if 0.0 < u < 1.0 else T.q[k + (u >= 1.0)], atol=1e-12)


def test_points_are_closed_many_at_once(monkeypatch):
    """The equations are requested slices of points, not for points."""
    path = kempe.load("four_bar").trace()
    calls = []
    equations = kempe.equations.closure_rows.evaluate_constraints
    monkeypatch.setattr(
        "kempe.equations.closure_rows.evaluate_constraints",
        lambda *g, **o: calls.append(1) or equations(*g, **o),
    )
    assert len(path.resample(20_000)) == 20_000 and len(calls) <= 3 * 20
