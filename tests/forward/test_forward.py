"""Poses and Jacobians of whole systems: against the reference, against differences, in every way of
asking.
"""

from __future__ import annotations

import math
import threading
from functools import partial
from types import MappingProxyType

import numpy as np
import pytest
import reference
from graphs import Graph, graphs
from hunts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

import kempe
from kempe import Mechanism, System, spatial
from kempe.errors import InputError, UnknownNameError
from kempe.forward.fk import SERIAL_BELOW
from kempe.kernels.compiled import bound
from kempe.kernels.forward.table_layout import fuse_table
from kempe.model.primitive_table import extract_chain

FRAMES = ("world_aligned", "world", "body")


def arm(n: int = 7) -> System:
    """A chain of skew hinges with a tool frame; its last body hangs on a fixed joint."""
    m = Mechanism("arm")
    rng = np.random.default_rng(0)
    here = m.ground
    for i in range(n):
        link = m.body(f"link{i}")
        m.revolute(f"q{i}", here, link, at=rng.uniform(-0.3, 0.3, 3), rpy=rng.uniform(-2, 2, 3))
        here = link
    m.fixed("flange", here, m.body("hand"), at=(0, 0, 0.1), rpy=(0, 0, np.pi / 4))
    m.frame("tool", "hand", at=(0.05, 0, 0.1), rpy=(0.3, 0, 0))
    return m.build()


# ------------------------------------------------------------------ poses


@pytest.mark.slow
@given(graph=graphs(most=12), seed=st.integers(0, 10**6), large=st.sampled_from([1.0, 100.0]))
@settings(max_examples=examples(150))
def test_poses_of_random_systems(graph: Graph, seed, large):
    s = graph.mechanism().build()
    rng = np.random.default_rng(seed)
    q = s.random(rng, 3) * large
    expected = [graph.poses(s, x) for x in q]
    everything = s.fk(q)
    assert everything.shape == (3, len(s.body_names), 4, 4)
    for k, name in enumerate(s.body_names):
        wanted = np.array([e[name] for e in expected])
        tolerance = 1e-13 * (10 + large * len(s.body_names))
        np.testing.assert_allclose(everything[:, k], wanted, rtol=0, atol=tolerance)
        np.testing.assert_allclose(s.fk(q, name), wanted, rtol=0, atol=tolerance)
        for x, w in zip(q, wanted, strict=True):
            np.testing.assert_allclose(s.fk(x, name), w, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(everything[:, 0], np.tile(np.eye(4), (3, 1, 1)))
    some = [s.body_names[i] for i in rng.integers(0, len(s.body_names), 4)]
    indices = [s.body_names.index(n) for n in some]
    np.testing.assert_allclose(s.fk(q, some), everything[:, indices], rtol=0, atol=1e-13 * large)
    np.testing.assert_array_equal(s.fk(q[0], tuple(some)), s.fk(q, some)[0])


@given(graph=graphs(most=8), seed=st.integers(0, 10**6))
def test_frames_sit_on_their_bodies(graph: Graph, seed):
    rng = np.random.default_rng(seed)
    m = graph.mechanism()
    placements = {}
    for i, body in enumerate(("ground", *graph.bodies)):
        at = rng.uniform(-1, 1, 3)
        rpy = rng.uniform(-3, 3, 3)
        if graph.dim == 2:
            at[2] = 0.0
            rpy[:2] = 0.0
            m.frame(f"f{i}", body, at=at[:2], angle=rpy[2])
        else:
            m.frame(f"f{i}", body, at=at, rpy=rpy)
        placements[f"f{i}"] = body, reference.placement(at, rpy).astype(float)
    s = m.build()
    q = s.random(rng, 2)
    for name, (body, X) in placements.items():
        np.testing.assert_allclose(s.fk(q, name), s.fk(q, body) @ X, rtol=0, atol=1e-12)


@given(graph=graphs(), seed=st.integers(0, 10**6))
def test_a_chain_alone_is_the_chain_in_its_system(graph: Graph, seed):
    """Tables of single chains, with coordinates renumbered, say the same as the whole."""
    s = graph.mechanism().build()
    q = s.random(seed)
    for name in s.body_names:
        table, to_q, to_v = extract_chain(s.structure.table, name)
        pose = np.empty((4, 4))
        columns = np.zeros((6, table.nv))
        assert bound.compute_pose(fuse_table(*table.pack_arrays([name])), q[to_q], pose) == 0
        np.testing.assert_allclose(pose, s.fk(q, name), rtol=0, atol=1e-14)
        whole = s.jacobian(q, name)
        others = np.setdiff1d(np.arange(s.nv), to_v)
        assert columns.shape[1] == len(to_v) and not whole[:, others].any()


# ------------------------------------------------------------------ Jacobians


@given(graph=graphs(most=8), seed=st.integers(0, 10**6))
@settings(max_examples=examples(60))
def test_jacobians_are_derivatives_of_poses_on_the_manifold(graph: Graph, seed):
    s = graph.mechanism().build()
    rng = np.random.default_rng(seed)
    h = 1e-5
    q = s.random(rng)
    name = s.body_names[int(rng.integers(len(s.body_names)))]
    X = s.fk(q, name)
    steps = h * np.eye(s.nv)
    ahead = s.fk(s.configuration_space.integrate(q, steps), name)
    back = s.fk(s.configuration_space.integrate(q, -steps), name)
    aligned, world, body = (s.jacobian(q, name, frame) for frame in FRAMES)
    for i in range(s.nv):
        w = X[:3, :3] @ reference.twist_between(back[i], ahead[i], 2 * h)[3:]
        v = (ahead[i] - back[i])[:3, 3] / (2 * h)
        scale = 1e-8 * (1 + np.abs(aligned).max())
        np.testing.assert_allclose(aligned[:, i], [*v, *w], rtol=0, atol=scale)
        np.testing.assert_allclose(
            world[:, i], [*(v + np.cross(X[:3, 3], w)), *w], rtol=0, atol=scale
        )
        np.testing.assert_allclose(
            body[:, i], [*(X[:3, :3].T @ v), *(X[:3, :3].T @ w)], rtol=0, atol=scale
        )


@given(graph=graphs(most=8), seed=st.integers(0, 10**6))
@settings(max_examples=examples(30))
def test_batches_of_jacobians(graph: Graph, seed):
    s = graph.mechanism().build()
    q = s.random(seed, (2, 3))
    name = s.body_names[-1]
    for frame in FRAMES:
        J = s.jacobian(q, name, frame)
        pose, columns = s.query(name).pose_and_jacobian(q, frame)
        np.testing.assert_array_equal(J, columns)
        np.testing.assert_allclose(pose, s.fk(q, name), rtol=0, atol=1e-13)
        for i in np.ndindex(2, 3):
            np.testing.assert_allclose(J[i], s.jacobian(q[i], name, frame), rtol=0, atol=1e-13)
            single = s.query(name).pose_and_jacobian(q[i], frame)
            np.testing.assert_allclose(single[0], pose[i], rtol=0, atol=1e-13)
            np.testing.assert_allclose(single[1], J[i], rtol=0, atol=1e-13)


@given(graph=graphs(most=8), seed=st.integers(0, 10**6))
@settings(max_examples=examples(20))
def test_jacobians_of_several_frames(graph: Graph, seed):
    """They are those of each frame, in the order of the list, which may be empty."""
    s = graph.mechanism().build()
    q = s.random(seed, (2, 3))
    names = list(s.frame_names[::-1])
    for frame in FRAMES:
        J = s.jacobian(q, names, frame)
        assert J.shape == (2, 3, len(names), 6, s.nv)
        for k, name in enumerate(names):
            np.testing.assert_array_equal(J[:, :, k], s.jacobian(q, name, frame))
        np.testing.assert_array_equal(s.jacobian(q, tuple(names), frame, threads=2), J)
        np.testing.assert_allclose(s.jacobian(q[1, 2], names, frame), J[1, 2], rtol=0, atol=1e-13)
    assert s.jacobian(q, []).shape == (2, 3, 0, 6, s.nv)
    by_name = s.jacobian(s.q_dict(q[0, 0]), names)
    np.testing.assert_array_equal(by_name, s.jacobian(q[0, 0], names))


def test_the_lectures_jacobian():
    """Planar arm of two links: the derivative of l1 cos q1 + l2 cos(q1 + q2), written out."""
    m = Mechanism("two-link", dim=2)
    m.revolute("q1", m.ground, m.body("a")), m.revolute("q2", "a", m.body("b"), at=(1.0, 0))
    m.frame("tip", "b", at=(0.7, 0))
    s = m.build()
    s1 = np.sin(0.3)
    c1 = np.cos(0.3)
    s12 = np.sin(0.7)
    c12 = np.cos(0.7)
    expected = np.zeros((6, 2))
    expected[0], expected[1], expected[5] = (
        [-s1 - 0.7 * s12, -0.7 * s12],
        [c1 + 0.7 * c12, 0.7 * c12],
        [1, 1],
    )
    np.testing.assert_allclose(s.jacobian([0.3, 0.4], "tip"), expected, rtol=0, atol=1e-15)


# ------------------------------------------------------------------ ways of asking


def test_q_may_be_anything_that_is_an_array():
    s = arm()
    q = np.linspace(-1, 1, 7)
    expected = s.fk(q, "tool")
    strided = np.zeros((7, 5))
    strided[:, 2] = q
    readonly = q.copy()
    readonly.setflags(write=False)
    batch = np.asfortranarray(np.array([q, q + 0.1, q - 0.1]))
    for same in (
        q.tolist(),
        tuple(q),
        strided[:, 2],
        readonly,
        dict(zip(s.coordinate_names, q, strict=True)),
        MappingProxyType(dict(zip(s.coordinate_names, q, strict=True))),
    ):
        np.testing.assert_array_equal(s.fk(same, "tool"), expected)
        np.testing.assert_array_equal(s.jacobian(same, "tool"), s.jacobian(q, "tool"))
        np.testing.assert_array_equal(s.fk(same), s.fk(q))
    np.testing.assert_array_equal(s.fk(batch, "tool"), s.fk(np.ascontiguousarray(batch), "tool"))
    np.testing.assert_array_equal(s.fk(np.zeros(7, dtype=int), "tool"), s.fk(np.zeros(7), "tool"))
    np.testing.assert_allclose(s.fk(q.astype(np.float32), "tool"), expected, atol=1e-6)
    np.testing.assert_array_equal(s.query("tool")(q), expected)


def test_out_is_filled_and_returned():
    s = arm()
    q = s.random(0)
    batch = s.random(0, (4, 3))
    f = s.query("tool")
    for x, frame, shape in (
        (q, "tool", (4, 4)),
        (batch, "tool", (4, 3, 4, 4)),
        (q, None, (9, 4, 4)),
        (batch, ["hand", "tool"], (4, 3, 2, 4, 4)),
    ):
        out = np.full(shape, 7.0)
        assert s.fk(x, frame, out=out) is out
        np.testing.assert_array_equal(out, s.fk(x, frame))
    out = np.full((4, 4), 7.0)
    assert f(q, out=out) is out and f(q, out) is out
    np.testing.assert_array_equal(out, f(q))
    columns = np.full((6, 7), 7.0)
    assert f.jacobian(q, out=columns) is columns
    np.testing.assert_array_equal(columns, f.jacobian(q))


@pytest.mark.parametrize(
    "make",
    [
        lambda: np.empty((3, 4)),
        lambda: np.empty((4, 4), dtype=np.float32),
        lambda: np.empty((4, 4), order="F"),
        lambda: np.empty((8, 8))[::2, ::2],
        lambda: [[0.0] * 4] * 4,
        lambda: np.empty(16),
        lambda: "out",
        lambda: np.broadcast_to(np.empty(4), (4, 4)),
        lambda: np.empty((1, 4, 4)),
    ],
)
def test_other_outs_are_refused(make):
    s = arm()
    for call in (
        lambda out: s.fk(s.neutral, "tool", out=out),
        lambda out: s.query("tool")(s.neutral, out),
    ):
        with pytest.raises(
            InputError,
            match=r"out is .*must be a writable, C-contiguous float64 array of shape \(4, 4\)",
        ):
            call(make())
    with pytest.raises(InputError, match=r"out is .*shape \(5, 4, 4\)"):
        s.fk(s.random(0, 5), "tool", out=make())
    with pytest.raises(InputError, match=r"out is .*shape \(9, 4, 4\)"):
        s.fk(s.neutral, out=make())
    with pytest.raises(InputError, match=r"out is .*shape \(6, 7\)"):
        s.query("tool").jacobian(s.neutral, out=make())


def test_no_frames_and_frames_twice():
    s = arm()
    assert s.fk(s.neutral, []).shape == (0, 4, 4) and s.fk(s.random(0, 3), []).shape == (3, 0, 4, 4)
    twice = s.fk(s.random(1), ["hand", "hand"])
    np.testing.assert_array_equal(twice[0], twice[1])


def test_the_ground_does_not_move():
    s = arm()
    np.testing.assert_array_equal(s.fk(s.random(0), "ground"), np.eye(4))
    np.testing.assert_array_equal(s.jacobian(s.random(0), "ground"), np.zeros((6, 7)))
    np.testing.assert_array_equal(s.fk(s.random(0, 3), "ground"), np.tile(np.eye(4), (3, 1, 1)))


# ------------------------------------------------------------------ wrong questions


@pytest.mark.parametrize(
    ("q", "words"),
    [
        ([0.0] * 6, "q has 6 coordinates; arm needs 7: q0, q1, q2, q3, q4, q5, q6"),
        (np.zeros((3, 8)), "q has 8 coordinates; arm needs 7"),
        (0.0, "q has a single number; arm needs 7"),
        ([], "q has 0 coordinates"),
        ("zero", "q is 'zero'; it must be an array of real numbers or a dict"),
        (None, "q is None; it must be an array"),
        ([0, 0, 0, 0, 0, 0, "a"], "q holds text; it must be an array of real numbers"),
        (
            [[0], [0, 1]],
            "q is ragged: row 1 has 2 numbers, row 0 has 1 number; it must be an array of real",
        ),
        (["1"] * 7, "q holds text; it must be an array of real numbers"),
        ([1j] * 7, "q holds complex numbers; it must be an array of real numbers"),
        (np.full(7, 1j), "q holds complex numbers; it must be an array of real numbers"),
        ([0, 0, np.nan, 0, 0, 0, 0], r"q\['q2'\] is nan; it must be a finite number"),
        ([0, 0, 0, np.inf, 0, 0, 0], r"q\['q3'\] is inf; it must be a finite number"),
        ({"q1": "a"}, "coordinate 'q1' is 'a'; it must be a number"),
        ({"q1": np.nan}, r"q\['q1'\] is nan"),
    ],
)
def test_bad_configurations(q, words):
    s = arm()
    for ask in (
        lambda: s.fk(q, "tool"),
        lambda: s.fk(q),
        lambda: s.jacobian(q, "tool"),
        lambda: s.query("tool")(q),
    ):
        with pytest.raises(InputError, match=words):
            ask()


def test_unknown_names():
    s = arm()
    with pytest.raises(UnknownNameError, match="arm has no coordinate 'q9'; there are: 'q0', 'q1'"):
        s.fk({"q9": 0.0}, "tool")
    for wrong in ("tol", "Tool"):
        for ask in (s.fk, s.jacobian):
            with pytest.raises(
                UnknownNameError, match=f"arm has no frame '{wrong}'; did you mean 'tool'"
            ):
                ask(s.neutral, wrong)
    with pytest.raises(UnknownNameError, match="arm has no frame 'tol'"):
        s.fk(s.neutral, ["tool", "tol"])
    with pytest.raises(UnknownNameError, match="arm has no frame 'tol'"):
        s.jacobian(s.neutral, ["tool", "tol"])
    for wrong in (3, {"tool"}, np.zeros(3)):
        for ask in (
            partial(s.query, wrong),
            partial(s.fk, s.neutral, wrong),
            partial(s.jacobian, s.neutral, wrong),
        ):
            with pytest.raises(UnknownNameError, match="arm has no frame"):
                ask()
    for ask in (s.jacobian, lambda q, n, f: s.query(n).pose_and_jacobian(q, f)):
        with pytest.raises(
            UnknownNameError, match="no frame of expression 'wrld'; did you mean 'world'"
        ):
            ask(s.neutral, "tool", "wrld")


def test_bad_rows_of_a_batch_leave_the_others_alone():
    s = arm()
    q = s.random(0, (5, 4))
    good = s.fk(q, "tool"), s.fk(q), s.jacobian(q, "tool")
    q[1, 2, 3] = np.nan
    q[3, 0, 0] = np.inf
    q[4, 3, 6] = -np.inf
    bad = np.zeros((5, 4), dtype=bool)
    bad[1, 2] = bad[3, 0] = bad[4, 3] = True
    for now, before in zip((s.fk(q, "tool"), s.fk(q), s.jacobian(q, "tool")), good, strict=True):
        np.testing.assert_array_equal(now[~bad], before[~bad])
        assert np.isnan(now[bad].reshape(3, -1)).any(axis=1).all()
    assert (
        np.isnan(s.fk(q, "tool")[bad][:, :3]).all() and np.isnan(s.jacobian(q, "tool")[bad]).all()
    )
    # bodies before the bad joint do not depend on it
    assert np.isfinite(s.fk(q)[1, 2, :4]).all() and np.isnan(s.fk(q)[1, 2, 4:, :3]).all()
    np.testing.assert_allclose(s.fk(q, "link2")[1, 2], good[1][1, 2, 3], rtol=0, atol=1e-15)


# ------------------------------------------------------------------ threads


def test_answers_do_not_depend_on_the_number_of_threads():
    s = arm()
    q = s.random(0, SERIAL_BELOW + 12_345)
    for ask in (lambda n: s.fk(q, "tool", threads=n), lambda n: s.jacobian(q, "tool", threads=n)):
        one = ask(1)
        for n in (2, 3):
            np.testing.assert_array_equal(ask(n), one)
    few = q[:: len(q) // 4000]
    np.testing.assert_array_equal(s.fk(few, threads=1), s.fk(few, threads=3))


def test_threads_of_python_may_ask_anything_at_once():
    s = arm()
    q = s.random(0, SERIAL_BELOW + 1)
    expected = s.fk(q, "tool"), s.jacobian(q[:100], "hand"), s.fk(q[:200])
    found = []
    errors = []

    def work():
        try:
            mine = arm() if len(found) % 2 else s
            found.append(
                (mine.fk(q, "tool", threads=2), mine.jacobian(q[:100], "hand"), mine.fk(q[:200]))
            )
        except BaseException as error:  # noqa: BLE001
            errors.append(error)

    workers = [threading.Thread(target=work) for _ in range(4)]
    [w.start() for w in workers]
    [w.join() for w in workers]
    assert not errors and len(found) == 4
    for answers in found:
        for a, b in zip(answers, expected, strict=True):
            np.testing.assert_array_equal(a, b)


# ------------------------------------------------------------------ the open loops


def four_bar() -> System:
    """Parallelogram: with crank angle a the coupler keeps its orientation."""
    m = Mechanism("parallelogram", dim=2)
    for name in ("crank", "coupler", "rocker"):
        m.body(name)
    m.revolute("A", m.ground, "crank"), m.revolute("B", "crank", "coupler", at=(1, 0))
    (
        m.revolute("C", "coupler", "rocker", at=(2, 0), child_at=(1, 0)),
        m.revolute("D", m.ground, "rocker", at=(2, 0)),
    )
    return m.build()


def test_closure_error_is_zero_where_the_loop_is_closed():
    s = four_bar()
    a = np.linspace(-3, 3, 20)
    q = np.stack([s.q({"A": x, "B": -x, "C": x, "D": x}) for x in a])
    np.testing.assert_allclose(
        s.loops.closure_error(q), np.zeros((20, 1, 6)), rtol=0, atol=1e-15 * 10
    )
    assert s.loops.closure_error(q[0]).shape == (1, 6)


def test_closure_error_is_the_missing_twist():
    s = four_bar()
    (name,) = s.structure.closures
    q = s.q({"A": 0.3, "B": -0.3, "C": 0.3, "D": 0.3})
    off = s.q({name: 0.3 + 0.01}, base=q)
    np.testing.assert_allclose(
        np.abs(s.loops.closure_error(off)[0]), [0, 0, 0, 0, 0, 0.01], rtol=0, atol=1e-15
    )


@given(graph=graphs(loops=5), seed=st.integers(0, 10**6))
def test_closure_errors_of_random_systems(graph: Graph, seed):
    """exp(error) leads from the joint's own M to the tree's."""
    s = graph.mechanism().build()
    q = s.random(seed, 2)
    error = s.loops.closure_error(q)
    assert error.shape == (2, len(s.structure.closures), 6) and np.isfinite(error).all()
    edges = {e.name: e for e in graph.edges}
    for row in range(2):
        poses = graph.poses(s, q[row])
        values = graph.values(s, q[row])
        for k, name in enumerate(s.structure.closures):
            e = edges[name]
            X_PF, X_CM = graph.ends(e)
            X_WM = poses[e.parent] @ np.asarray(X_PF @ graph.joint_pose(e, values), dtype=float)
            turn = np.eye(4)
            # there M is turned so that its z is the axis of the slider
            if e.kind == "prismatic" and graph.dim == 2:
                turn[:3, :3] = spatial.align_z([0.6, -0.8, 0.0])
            X_WM = X_WM @ turn
            there = poses[e.child] @ X_CM.astype(float) @ turn
            if e.child in graph.particles:
                offset = X_WM[:3, :3].T @ (there[:3, 3] - X_WM[:3, 3])
                np.testing.assert_allclose(error[row, k], [*offset, 0, 0, 0], rtol=0, atol=1e-12)
            else:
                np.testing.assert_allclose(
                    X_WM @ spatial.exp_se3(error[row, k]), there, rtol=0, atol=1e-11
                )


def test_arrays_that_are_not_aligned_are_copied():
    """As in packed records: each verb gives what it gives for a copy, before and after a plain
    call.
    """
    s = kempe.load("puma560")
    q = s.random(5, 4)
    X = s.fk(q, "tool")

    def unaligned(a):
        raw = np.empty(a.nbytes + 1, dtype=np.uint8)[1:]
        out = raw.view(np.float64).reshape(a.shape)
        out[...] = a
        assert not out.flags.aligned
        return out

    for _ in range(2):
        for some in (q, q[0]):
            np.testing.assert_array_equal(s.fk(unaligned(some), "tool"), s.fk(some, "tool"))
            np.testing.assert_array_equal(s.fk(unaligned(some)), s.fk(some))
            np.testing.assert_array_equal(
                s.jacobian(unaligned(some), "tool"), s.jacobian(some, "tool")
            )
        for target in (X, X[0], X[:, :3, 3], X[0, :3, 3]):
            np.testing.assert_array_equal(s.ik(unaligned(target), "tool").q, s.ik(target, "tool").q)
        for target in (X, X[0]):
            np.testing.assert_array_equal(
                s.ik_all(unaligned(target), "tool").q, s.ik_all(target, "tool").q
            )
    np.testing.assert_array_equal(s.ik_path(unaligned(X), "tool").q, s.ik_path(X, "tool").q)
    bar = kempe.load("four_bar")
    closed = bar.assemble({"A": 1.0}).q
    assert bar.mobility(unaligned(closed)).dof == 1
    np.testing.assert_array_equal(
        bar.loops.closure_error(unaligned(closed)), bar.loops.closure_error(closed)
    )
    np.testing.assert_array_equal(
        bar.assemble({"A": 0.9}, unaligned(closed)).q, bar.assemble({"A": 0.9}, closed).q
    )
    with pytest.raises(InputError, match="aligned"):
        s.fk(q, "tool", out=unaligned(X))


@pytest.mark.parametrize(("frame", "tail"), [("tool", (4, 4)), (None, (7, 4, 4))])
def test_out_that_overlaps_q_gives_the_same_poses(frame, tail):
    robot = kempe.load("puma560")
    q = robot.random(0, 100)
    memory = np.zeros(100 * math.prod(tail))
    memory[: q.size] = q.ravel()
    out = robot.fk(memory[: q.size].reshape(q.shape), frame, out=memory.reshape(100, *tail))
    assert np.array_equal(out, robot.fk(q, frame))


def test_a_jacobian_written_over_its_own_configuration():
    robot = kempe.load("puma560")
    query = robot.query("tool")
    q = robot.random(0)
    J = query.jacobian(q)
    X = query(q)
    memory = np.zeros(40)
    for start in (0, 3, 30, 34):
        memory[start : start + 6] = q
        out = query.jacobian(memory[start : start + 6], "world_aligned", memory[:36].reshape(6, 6))
        assert np.array_equal(out, J)
    memory[5:11] = q
    assert np.array_equal(query(memory[5:11], memory[:16].reshape(4, 4)), X)
