"""Paths between configurations that are called clear: beside dense samples, and in closed form."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from command import Result

import kempe
from kempe import Budget, Status
from kempe.constraints import Clearance
from kempe.errors import InputError, UnknownNameError
from kempe.geometry import path_clearance
from kempe.numerics.clock import TimeLimit

pytest.importorskip("coal")

KEEP = Clearance("self", at_least=0.02)
SHAPES = (
    {"kind": "sphere", "radius": 0.15},
    {"kind": "box", "size": (0.2, 0.3, 0.1)},
    {"kind": "capsule", "radius": 0.05, "length": 0.4},
    {"kind": "cylinder", "radius": 0.1, "length": 0.3},
)


def two_free_bodies(rng: np.random.Generator) -> kempe.System:
    """Two bodies with quaternions."""
    m = kempe.Mechanism("two")
    for name in "ab":
        m.free(name.upper(), m.ground, m.body(name))
        m.shape(name, **SHAPES[rng.integers(4)], at=rng.uniform(-0.3, 0.3, 3))
    return m.build()


def tree(rng: np.random.Generator) -> kempe.System:
    """A slide with two arms: a ball with an elbow that a screw follows, and a turn; and a post."""
    m = kempe.Mechanism("tree")
    place = lambda: rng.uniform(-0.4, 0.4, 3)  # noqa: E731
    for name in ("slide", "upper", "lower", "screw", "side"):
        m.body(name)
        m.shape(name, **SHAPES[rng.integers(4)], at=place())
    m.prismatic("P", m.ground, "slide", axis=rng.normal(size=3))
    m.spherical("S", "slide", "upper", at=place())
    m.revolute("E", "upper", "lower", at=place(), axis=rng.normal(size=3))
    m.helical("H", "lower", "screw", 0.7, at=place(), axis="x")
    m.revolute("T", "slide", "side", at=place(), axis="y")
    m.couple("T", {"E": -1.5})
    m.obstacle("post", "box", size=(0.2, 0.2, 2.0), at=(1.0, 0, 0))
    return m.build()


@pytest.mark.parametrize("make", [two_free_bodies, tree])
def test_hunt_what_is_called_clear_is_clear_in_dense_samples(make, hunt):
    rng = hunt.rng()
    outcomes = []
    for _ in range(hunt.cases(40)):
        s = make(rng)
        layout = s.structure.layout
        q = s.random(rng, 2)
        q[0, layout.vector_q] = rng.uniform(-0.5, 0.5, len(layout.vector_q))
        q[1] = layout.integrate_velocity(q[0], rng.uniform(-0.5, 0.5, s.nv))
        answer = s.geometry.check_path(q, KEEP)
        v = layout.compute_difference(q[0], q[1])
        dense = layout.integrate_velocity(q[0], np.linspace(0, 1, 400)[:, None] * v)
        nearest = s.geometry.clearance(dense)
        outcomes.append(bool(answer))
        if answer:
            assert answer.proven and nearest.min() >= 0.02 - 2e-6
            continue
        met = answer.encounter
        assert met.decided and answer.code is Status.TOO_NEAR and answer.proven
        there = layout.integrate_velocity(q[0], met.part * v)
        assert math.isclose(s.geometry.clearance(there, [met.pair]), met.distance, abs_tol=2e-6)
        assert met.distance < 0.02
    assert 0.1 < np.mean(outcomes) < 0.95


def swing(**post: object) -> kempe.System:
    """A sphere on an arm of 1 m that turns about z past a post."""
    m = kempe.Mechanism("swing")
    m.revolute("A", m.ground, m.body("link"), axis="z")
    m.shape("link", "sphere", radius=0.1, at=(1, 0, 0))
    m.obstacle("post", **post)
    return m.build()


def test_a_thin_post_between_two_configurations_is_met():
    s = swing(kind="cylinder", radius=0.001, length=1.0, at=(0, 1, 0))
    q = np.linspace(0, math.pi, 4)[:, None]
    assert s.geometry.clearance(q).min() > 0.02
    answer = s.geometry.check_path(q, KEEP)
    assert not answer
    assert answer.encounter.piece == 1 and answer.encounter.pair == ("link", "post")
    assert "too near 0.5 of the way from configuration 1 to 2" in answer.status
    assert "'link' and 'post' overlap by" in str(answer)
    assert answer.data()["encounter"]["pair"] == ["link", "post"]
    assert pickle.loads(pickle.dumps(answer)).status == answer.status


@pytest.mark.parametrize("over", [-1e-3, 3e-4, 1e-3])
def test_a_passage_is_decided_to_a_third_of_a_millimetre(over):
    """The sphere passes a post outside of its circle; the gap is known in closed form."""
    s = swing(kind="sphere", radius=0.1, at=(0, 1.22 + over, 0))
    answer = s.geometry.check_path([[0.2], [1.5], [3.0]], KEEP)
    assert bool(answer) == (over > 0)


def test_a_way_along_the_distance_is_not_decided():
    m = kempe.Mechanism("slider")
    m.prismatic("x", m.ground, m.body("block"), axis="x")
    m.shape("block", "sphere", radius=0.1, at=(0, 0, 0.22))
    m.obstacle("floor", "box", size=(10, 10, 0.2))
    s = m.build()
    almost = Clearance(at_least=0.02 - 2e-7)
    answer = s.geometry.check_path([[0.0], [1.0]], almost)
    assert not answer and not answer.proven and answer.code is Status.NOT_FOUND
    assert "not decided" in answer.status and "is not excluded" in answer.status
    assert s.geometry.check_path([[0.0], [1.0]], Clearance(at_least=0.0195))


def test_configurations_that_are_missing_or_alone():
    s = swing(kind="sphere", radius=0.1, at=(0, 1, 0))
    assert s.geometry.check_path(np.zeros((0, 1)), KEEP)
    assert s.geometry.check_path([[0.0]], KEEP)
    alone = s.geometry.check_path([[math.pi / 2]], KEEP)
    assert not alone and "at configuration 0" in alone.status
    assert s.geometry.check_path([[0.0], [np.nan], [3.0]], KEEP)
    last = s.geometry.check_path([[0.0], [math.pi / 2 - 0.21]], KEEP)
    assert last.encounter.piece + last.encounter.part > 0.9
    long = s.geometry.check_path(np.linspace(0.0, 1.57, 300)[:, None], KEEP)
    angle = 2.0 * math.asin(0.22 / 2)  # at which the centres are 0.22 m apart
    at = (long.encounter.piece + long.encounter.part) * 1.57 / 299
    assert math.isclose(at, math.pi / 2 - angle, abs_tol=1.57 / 299)


def test_closed_loops_are_not_proven():
    m = kempe.load("four_bar").mechanism
    m.shape("coupler", "sphere", radius=0.01)
    m.obstacle("ball", "sphere", radius=0.01, at=(5, 0, 0))
    s = m.build()
    answer = s.geometry.check_path(s.trace("A"), KEEP)
    assert answer and not answer.proven and "loops were not closed" in answer.status


def end_time_after(monkeypatch, count: int) -> None:
    """Let the time be up at the look at the clock number `count`, in the place of a long path."""
    looks = iter(range(1, count))

    def check_time(self: TimeLimit) -> None:
        if next(looks, None) is None:
            self.end = self.soon = 0.0
            self._raise_time_up()

    monkeypatch.setattr(TimeLimit, "check_time", check_time)


def test_what_was_checked_before_the_time_was_up_is_clear(monkeypatch):
    s = swing(kind="sphere", radius=0.1, at=(0, 1, 0))
    q = np.linspace(0.0, 1.57, 300)[:, None]
    whole = s.geometry.check_path(q, KEEP)
    assert not whole.late and whole.encounter.piece > 128
    end_time_after(monkeypatch, 2)
    late = s.geometry.check_path(q, KEEP)
    assert late.late and not late and not late.proven and late.code is Status.OUT_OF_TIME
    assert late.count == 129 and late.encounter is None and "time limit" in late.status
    monkeypatch.undo()
    assert s.geometry.check_path(q[: late.count], KEEP).proven
    none = s.geometry.check_path(q, KEEP, budget=Budget(time_limit=1e-9))
    assert none.count == 0 and none.code is Status.OUT_OF_TIME


def test_bad_input():
    s = swing(kind="sphere", radius=0.1, at=(0, 1, 0))
    with pytest.raises(InputError, match="must be a kempe.constraints.Clearance"):
        s.geometry.check_path([[0.0], [1.0]], 0.02)
    with pytest.raises(InputError, match=r"must be \(n, 1\)"):
        s.geometry.check_path([0.0], KEEP)
    with pytest.raises(UnknownNameError, match="link"):
        s.geometry.check_path([[0.0]], Clearance("lnk"))


# ---- motions


def crank_and_peg(at: tuple[float, float]) -> kempe.System:
    """A four-bar with a ball on its crank's end, and a peg."""
    m = kempe.Mechanism("four-bar", dim=2)
    crank, coupler, rocker = (m.body(name) for name in ("crank", "coupler", "rocker"))
    m.revolute("A", m.ground, crank, at=(0, 0))
    m.revolute("B", crank, coupler, at=(0.3, 0))
    m.revolute("C", coupler, rocker, at=(0.6, 0))
    m.revolute("D", m.ground, rocker, at=(0.5, 0), child_at=(0.5, 0))
    m.shape("crank", "sphere", radius=0.02, at=(0.3, 0, 0))
    m.obstacle("peg", "sphere", radius=0.01, at=(*at, 0))
    return m.build()


def test_drive_stops_before_a_peg_between_two_samples_and_names_it():
    s = crank_and_peg((0.3 * np.cos(0.75), 0.3 * np.sin(0.75)))
    A = np.arange(0.0, 2.0, 0.5)  # samples are 0.15 m apart, the peg is thinner
    keep = Clearance("self", at_least=0.005)
    free = s.drive({"A": A})
    assert free.success and (s.geometry.clearance(free.q) > 0.005).all()
    motion = s.drive({"A": A}, clearance=keep)
    assert len(motion) == len(motion.times) == len(motion.held) == 2 and not motion.success
    np.testing.assert_allclose(motion.q, free.q[:2], atol=1e-12)
    assert motion.inputs["A"].tolist() == [0.0, 0.5]
    assert motion.status.startswith("it stops after sample 1 (time 1), before 'crank' and 'peg'")
    back = s.drive({"A": -A}, clearance=keep)
    assert back.success and len(back) == 4


def test_drive_says_where_it_begins_too_near():
    s = crank_and_peg((0.3, 0.0))
    motion = s.drive({"A": [0.0, 0.5]}, clearance=Clearance("crank", "peg", at_least=0.005))
    assert len(motion) == 1 and not motion.success
    assert motion.status.startswith("it begins where 'crank' and 'peg' overlap by ")


def test_drive_stops_at_a_sample_that_is_too_near():
    s = crank_and_peg((0.3 * np.cos(1.0), 0.3 * np.sin(1.0)))
    t = [0.0, 0.4, 1.0, 1.4]
    motion = s.drive({"A": t}, t, clearance=Clearance("self", at_least=0.005))
    assert len(motion) == 2 and "'crank' and 'peg'" in motion.status


def test_drive_keeps_the_samples_that_were_checked_before_the_time_was_up(monkeypatch):
    s = crank_and_peg((0.3 * np.cos(2.0), 0.3 * np.sin(2.0)))
    A = np.linspace(0.0, 3.0, 301)
    keep = Clearance("self", at_least=0.005)
    whole = s.drive({"A": A}, clearance=keep)
    assert 129 < len(whole) < 300 and not whole.late
    looks = []

    def check(guard: path_clearance.PathGuard, q: np.ndarray, time: TimeLimit):
        looks.append(len(q))
        end_time_after(monkeypatch, 2)
        return check_in_time(guard, q, time)

    check_in_time = path_clearance.PathGuard.check_in_time
    monkeypatch.setattr(path_clearance.PathGuard, "check_in_time", check)
    late = s.drive({"A": A}, clearance=keep)
    assert looks == [301] and late.late and not late.success
    assert len(late) == len(late.times) == len(late.held) == 129
    assert "time limit" in late.status


def test_hunt_trace_ends_before_a_peg_both_ways(hunt):
    """The crank turns around; it may turn on both sides up to where its ball is 5 mm from the peg."""
    rng = hunt.rng()
    keep = Clearance("self", at_least=0.005)
    count, inside = hunt.cases(40), 0
    for _ in range(count):
        peg, start = rng.uniform(-np.pi, np.pi, 2)
        near = 2 * np.arcsin(0.5 * 0.035 / 0.3)
        s = crank_and_peg((0.3 * np.cos(peg), 0.3 * np.sin(peg)))
        free = s.trace("A", {"A": start})
        assert free.closed
        path = s.trace("A", {"A": start}, clearance=keep)
        ahead = (peg - start) % (2 * np.pi)
        if min(ahead, 2 * np.pi - ahead) < near:
            assert len(path) == 1 and not path.success
            assert path.status.startswith("'crank' and 'peg' overlap by ") or "apart" in path.status
            assert "at the start" in path.status
            inside += 1
            continue
        assert path.success and not path.closed
        assert (s.geometry.clearance(path.q) >= 0.005).all()
        A = path.q[:, 0]
        assert (np.diff(A) > 0.0).all() and A[0] <= start <= A[-1]
        low, high = start + ahead - 2 * np.pi + near, start + ahead - near
        assert low <= A[0] < low + 0.1 and high - 0.1 < A[-1] <= high
        assert all("before 'crank' and 'peg' " in end for end in path.ends)
        forward = s.trace("A", {"A": start}, ways="forward", clearance=keep)
        assert forward.ends[0] == "the start" and "'peg'" in forward.ends[1]
        assert np.isclose(forward.q[0, 0], start) and high - 0.1 < forward.q[-1, 0] <= high
    assert inside < 0.2 * count + 2


def test_a_trace_that_stays_clear_is_the_one_without_a_clearance():
    s = crank_and_peg((0.0, 2.0))
    free = s.trace("A", {"A": 0.3})
    path = s.trace("A", {"A": 0.3}, clearance=[Clearance("crank", "peg", at_least=0.1)])
    assert path.closed and path.status == free.status
    np.testing.assert_array_equal(path.q, free.q)


def test_a_trace_between_two_obstacles_names_each_at_its_end():
    s = crank_and_peg((0.3 * np.cos(1.0), 0.3 * np.sin(1.0)))
    m = s.mechanism
    m.obstacle("wall", "box", size=(0.02, 0.2, 1.0), at=(-0.32, 0, 0))
    path = m.build().trace("A", {"A": 0.0}, clearance=Clearance())
    assert "'crank' and 'wall'" in path.ends[0] and "'crank' and 'peg'" in path.ends[1]
    assert "'wall'" in path.status and "'peg'" in path.status
    other = m.build().trace("A", {"A": 0.0}, ways="branches", clearance=Clearance("crank", "wall"))
    assert all("'wall'" in end for end in other.ends)


def test_a_trace_out_of_time_is_as_far_as_it_was_checked():
    s = crank_and_peg((0.3 * np.cos(1.0), 0.3 * np.sin(1.0)))
    keep = Clearance("self", at_least=0.005)
    path = s.trace("A", {"A": 0.0}, clearance=keep, budget=kempe.Budget(time_limit=1e-9))
    assert path.late and not path.success
    with pytest.raises(InputError, match="Clearance"):
        s.trace("A", {"A": 0.0}, clearance=0.01)


def test_the_command_traces_what_the_library_traces(tmp_path):
    s = crank_and_peg((0.3 * np.cos(1.0), 0.3 * np.sin(1.0)))
    file = s.mechanism.save(tmp_path / "four_bar.toml")
    call = ("trace", file, "--driver", "A", "--start", "A=0")
    kept = Result(*call, "--clearance", "0.005")
    path = s.trace("A", {"A": 0.0}, clearance=Clearance(at_least=0.005))
    assert kept.code == 0 and f"through {len(path)} points" in " ".join(kept.out.split())
    assert kept.out.count("'peg'") == 2 and "'peg'" not in Result(*call).out
