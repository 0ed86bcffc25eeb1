"""Assembly of closed loops, against closed forms, other libraries, and itself cut elsewhere."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace

import graphs
import numpy as np
import pytest
from dyad_chains import random_chain
from hunts import examples, some
from hypothesis import given, settings
from hypothesis import strategies as st
from linkages import four_bar
from scipy.optimize import nnls

import kempe
from kempe import Mechanism, constraints
from kempe.assemble import bound as assembler_module
from kempe.assemble.bound import LONG, Assembler, OneSidedAssembly
from kempe.assemble.dyads import Plan
from kempe.equations import closure_rows
from kempe.errors import InputError, NoSolutionError, UnknownNameError
from kempe.mobility.independent import compute_tangent_space
from kempe.status import Status

MECHANISMS = [
    "four_bar",
    "slider_crank",
    "double_parallelogram",
    "bennett",
    "sarrus",
    "stewart",
    "peaucellier",
    "jansen",
    "three_rrr",
    "delta_ss",
    "bricard_trihedral",
]


def rocker_angles(a, b, c, d, theta):
    """Both angles of the rocker of a four-bar, by intersecting two circles."""
    x = a * math.cos(theta) - d
    y = a * math.sin(theta)
    r = math.hypot(x, y)
    spread = math.acos((r * r + c * c - b * b) / (2 * r * c))
    return math.atan2(y, x) + spread, math.atan2(y, x) - spread


@given(st.floats(-math.pi, math.pi), st.sampled_from("ABCD"))
def test_four_bar_is_the_intersection_of_two_circles(theta, cut):
    s = four_bar(cut=cut)
    answer = s.assemble({"A": theta}, start=s.q({"B": -0.9, "C": 0.9, "D": 1.5}))
    assert answer.success and s.loops.closure_error(answer.q) == pytest.approx(0.0, abs=1e-14)
    expected = rocker_angles(0.1, 0.5, 0.4, 0.4, theta)
    d = s.q_dict(answer.q)["D"]
    assert min(abs(math.remainder(d - e, 2 * math.pi)) for e in expected) < 1e-12


@pytest.mark.parametrize("name", some(MECHANISMS, 3))
@pytest.mark.parametrize("sigma", [0.1, 0.3, 1.0])
def test_perturbed_mechanisms_close(name, sigma):
    """From Gaussian noise at least 95 % close at the first start, and all with the usual starts
    inside the limits.
    """
    s = kempe.load(name)
    home = s.q("closed")
    rng = np.random.default_rng(5)
    q = np.stack(
        [s.configuration_space.integrate(home, sigma * rng.normal(size=s.nv)) for _ in range(400)]
    )
    once = s.assemble(start=q, limits=False, budget=kempe.Budget(starts=1))
    assert once.success.mean() >= 0.95
    answer = s.assemble(start=q)
    assert answer.success.all()
    assert np.abs(s.loops.closure_error(answer.q)).max() < 1e-9
    assert np.abs(closure_rows.compute_residual(s, answer.q)).max() < 1e-9


@pytest.mark.parametrize("name", MECHANISMS)
def test_convergence_is_quadratic(name):
    """Near the closed set each step squares the residual, redundant equations or not."""
    from kempe.kernels.compiled import loop_closing as kernel

    s = kempe.load(name)
    b = Assembler(s, ())
    rng = np.random.default_rng(2)
    start = s.configuration_space.integrate(s.q("closed"), 0.02 * rng.normal(size=s.nv))[None]
    q = np.empty_like(start)
    r = np.empty(1)
    info = np.empty((1, 3), dtype=np.int64)
    sizes = []
    arrays = b.loops.ints, b.loops.floats, b.loops.plan, b.loops.weights
    for limit in range(4):
        kernel.assemble_loops(
            *arrays, start, b.no_pins, 0, 1, limit, 1e100, 0, 0, 0, False, 0, q, r, info
        )
        sizes.append(r[0])
    bound = 30.0
    for before, after in zip(sizes, sizes[1:], strict=False):
        assert after <= bound * before**2 + 1e-14, sizes


@pytest.mark.parametrize("name", ["four_bar", "three_rrr", "rssr", "sarrus", "peaucellier"])
def test_closed_in_pinocchio_too(name):
    """Poses of both ends of each cut joint, computed by Pinocchio from a tree written by hand,
    coincide.
    """
    pin = pytest.importorskip("pinocchio")
    s = kempe.load(name)
    answer = s.assemble(
        start=s.configuration_space.integrate(
            s.q("closed"), 0.2 * np.random.default_rng(0).normal(size=s.nv)
        )
    )
    assert answer
    model, place = pinocchio_tree(pin, s)
    data = model.createData()
    q = pin.neutral(model)
    for joint, (idx, size, first) in place.items():
        del joint
        q[idx : idx + size] = answer.q[first] if size == 1 else answer.q[first]
    pin.forwardKinematics(model, data, q)
    pin.updateFramePlacements(model, data)
    X = s.fk(answer.q)
    for i, body in enumerate(s.body_names):
        if i:
            np.testing.assert_allclose(
                data.oMf[model.getFrameId(body)].homogeneous, X[i], atol=1e-10
            )


def pinocchio_tree(pin, s):
    """The spanning tree as a Pinocchio model of revolute and prismatic joints, and where its
    coordinates are.
    """
    model = pin.Model()
    place = {}
    ids = {0: 0}
    at = {0: pin.SE3.Identity()}
    m = s.mechanism
    for i, (parent, name) in enumerate(
        zip(s.parent, s.structure.parent_joints, strict=True), start=1
    ):
        joint = m.joints[name]
        assert not s.structure.topology.reversed_[i - 1], (
            "joints from child to parent are not written by hand"
        )
        before = at[parent] * pin.SE3(joint.X_PF.evaluate_pose(m.parameters))
        here = ids[parent]
        primitives = joint.type.layout(s.dim)[1]
        names = s.structure.coordinates_of_joint(name)
        for k, p in enumerate(primitives):
            axis = "xyz".index(p.axis)
            if p.kind == 2:
                kind = pin.JointModelSpherical()
                size = 4
            elif p.kind == 0:
                kind = [pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ][axis]()
                size = 1
            else:
                kind = [pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ][axis]()
                size = 1
            here = model.addJoint(here, kind, before, f"{name}_{k}")
            before = pin.SE3.Identity()
            first = s.coordinate_names.index(names[p.coordinate])
            index = first if size == 1 else [first + 1, first + 2, first + 3, first]  # xyzw
            place[f"{name}_{k}"] = (model.joints[here].idx_q, size, index)
        ids[i] = here
        at[i] = before * pin.SE3(joint.X_CM.evaluate_pose(m.parameters)).inverse()
        model.addFrame(pin.Frame(s.body_names[i], here, 0, at[i], pin.FrameType.BODY))
    return model, place


# ---- equations


@settings(max_examples=examples(60))
@given(graphs.graphs(), st.integers(0, 10**6))
def test_equations_have_exact_derivatives(graph, seed):
    s = graph.mechanism().build()
    q = s.random(seed)
    J = closure_rows.compute_jacobian(s, q)
    h = 1e-6
    integrate = s.configuration_space.integrate
    numeric = (
        np.stack(
            [
                (
                    closure_rows.compute_residual(s, integrate(q, h * e))
                    - closure_rows.compute_residual(s, integrate(q, -h * e))
                )
                / (2 * h)
                for e in np.eye(s.nv)
            ],
            -1,
        )
        if s.nv
        else J
    )
    angles = np.array([k.startswith("r") for _, k in closure_rows.list_row_names(s)], dtype=bool)
    # where the rotation vector jumps
    near_pi = np.abs(closure_rows.compute_residual(s, q))[angles].max(initial=0.0) > 2.9
    if not near_pi:
        np.testing.assert_allclose(J, numeric, atol=2e-6 * (1 + np.abs(J).max(initial=0.0)))


@settings(max_examples=examples(60))
@given(graphs.graphs(), st.integers(0, 10**6))
def test_equations_vanish_where_the_closure_error_does(graph, seed):
    s = graph.mechanism().build()
    q = s.random(seed)
    error = s.loops.closure_error(q)
    rows = closure_rows.compute_residual(s, q)
    names = closure_rows.list_row_names(s)
    for k, name in enumerate(s.structure.closures):
        mine = np.array([r for r, (n, _) in zip(rows, names, strict=True) if n == name])
        assert (
            np.linalg.norm(mine) == pytest.approx(0.0, abs=1e-9) or np.linalg.norm(error[k]) > 1e-10
        )
        # the rotation vector is the same, the position is taken without the screw's pitch
        if len(mine) == 6:
            np.testing.assert_allclose(mine[3:], error[k][3:], atol=1e-9)


@settings(max_examples=examples(40), deadline=None)
@given(graphs.graphs(), st.integers(0, 10**6))
def test_what_is_assembled_is_closed(graph, seed):
    """Whatever the joints: an answer called a success closes every loop, by the independent closure
    error.
    """
    s = graph.mechanism().build()
    answer = s.assemble(start=s.random(seed), budget=kempe.Budget(starts=3))
    if answer:
        assert np.abs(s.loops.closure_error(answer.q)).max(initial=0.0) < 1e-7
        assert np.all(
            answer.q[s.structure.layout.vector_q] >= s.lower[s.structure.layout.vector_v] - 1e-12
        )


# ---- what is known


@pytest.mark.parametrize("name", "ABCD")
def test_any_coordinate_can_be_known_cut_or_not(name):
    s = four_bar(cut="C")
    home = s.assemble({"A": 1.2}).q
    value = s.q_dict(home)[name]
    answer = s.assemble({name: value}, start=home)
    np.testing.assert_allclose(answer.q, home, atol=1e-12)


def test_places_of_frames_can_be_known():
    s = kempe.load("four_bar")
    q = s.assemble({"A": 0.7}).q
    place = s.fk(q, "coupler_point")[:2, 3]
    answer = s.assemble({"coupler_point": place}, start=s.q("closed"))
    np.testing.assert_allclose(s.fk(answer.q, "coupler_point")[:2, 3], place, atol=1e-12)
    assert answer and np.abs(s.loops.closure_error(answer.q)).max() < 1e-12
    stewart = kempe.load("stewart")
    X = stewart.fk(stewart.q("closed"), "platform")
    X[:3, 3] += [0.02, -0.03, 0.05]
    pose = stewart.assemble({"platform": X})
    np.testing.assert_allclose(stewart.fk(pose.q, "platform"), X, atol=1e-12)


def test_followers_stand_for_their_source():
    m = four_bar().mechanism
    m.body("wheel")
    m.revolute("W", m.ground, "wheel", at=(-0.2, 0))
    m.gear("W", "A", -2.0, 0.1)
    s = m.build()
    answer = s.assemble({"W": 0.5})
    assert s.q_dict(answer.q)["A"] == pytest.approx(-0.2, abs=1e-15)


def geared_four_bar() -> kempe.System:
    """A wheel W follows the crank A, and a third joint V is locked."""
    m = four_bar().mechanism
    m.revolute("W", m.ground, m.body("wheel"), at=(-0.2, 0))
    m.gear("W", "A", -2.0, 0.1)
    m.revolute("V", m.ground, m.body("vane"), at=(-0.3, 0))
    m.lock({"V": 0.4})
    return m.build()


@pytest.mark.parametrize(
    "known",
    [{"A": -0.2, "W": 0.5}, {"W": 0.5, "A": -0.2, "V": 0.4}, {"A": -0.2, "W": 0.5 + 1e-9}],
)
def test_leaders_and_followers_whose_values_fit_may_both_be_given(known):
    s = geared_four_bar()
    alone = s.assemble({"A": -0.2})
    for answer in (
        s.assemble(known),
        s.loops.assembler(known)(known),
        s.loops.assembler(known)(list(known.values())),
    ):
        assert answer and np.array_equal(answer.q, alone.q)
    modes = s.assembly_modes(known)
    assert np.array_equal(modes.q, s.assembly_modes({"A": -0.2}).q)
    rows = {name: np.full(3, x) for name, x in known.items()}
    assert np.array_equal(s.assemble(rows).q, np.tile(alone.q, (3, 1)))
    assert s.assemble({**rows, "A": -0.2}).q.shape == (3, s.nq)


@pytest.mark.parametrize(
    ("known", "problem"),
    [
        ({"A": -0.2, "W": 0.6}, "coordinate 'W' is 0.6; it follows 'A' and must be 0.5"),
        ({"V": 0.3}, "coordinate 'V' is 0.3; it is held at 0.4"),
        (
            {"A": [-0.2, 0.3], "W": [0.5, 0.4]},
            r"'W' is 0.4 \(row 1\); it follows 'A' and must be -0.5",
        ),
        ({"W": math.nan}, "the known value of 'W' is nan"),
    ],
)
def test_followers_whose_values_do_not_fit_are_refused(known, problem):
    s = geared_four_bar()
    with pytest.raises(InputError, match=problem):
        s.assemble(known)


def test_limits_hold_and_are_named():
    s = four_bar(D={"limits": (0.0, 1.2)})
    answer = s.assemble({"A": math.pi / 2}, start=s.q({"B": -0.9, "C": 0.9, "D": 1.1}))
    assert not answer and "without the limit of 'D' it closes, so that may be" in answer.status
    assert s.q_dict(answer.q)["D"] <= 1.2
    assert s.assemble({"A": math.pi / 2}, start=s.q({"B": -0.9, "D": 1.1}), limits=False).success
    known = s.assemble({"D": 2.0})
    assert known.code == Status.OUTSIDE_LIMITS and not known and "D = 2 is not in" in known.status


def test_an_open_loop_says_which_and_by_how_much():
    """Crank and coupler stretched cannot reach: the gap is a difference of lengths."""
    s = four_bar(a=0.2, b=0.3, c=0.1, d=1.0)
    answer = s.assemble()
    assert not answer and answer.code == 1
    gap = 1.0 - 0.2 - 0.3 - 0.1
    assert f"open by {gap:.6g} m" in answer.status and "'C'" in answer.status
    assert np.linalg.norm(s.loops.closure_error(answer.q)[0, :3]) == pytest.approx(gap, rel=1e-6)
    with pytest.raises(NoSolutionError, match="open by"):
        s.assemble().expect()


def test_too_much_known_is_said():
    s = kempe.load("four_bar")
    answer = s.assemble({"A": 0.3, "D": 1.0})
    assert not answer and "2 coordinates are given, but it has 1 freedom" in answer.status
    fitting = s.assemble({"A": 0.3}).q
    both = {"A": 0.3, "D": s.q_dict(fitting)["D"]}
    assert s.assemble(both).success


def test_wrong_questions_are_refused():
    s = kempe.load("four_bar")
    with pytest.raises(UnknownNameError, match="'crank' ... no, 'X'|'X'"):
        s.assemble({"X": 1.0})
    with pytest.raises(InputError, match="the known value of 'A' is nan; it must be finite"):
        s.assemble({"A": math.nan})
    with pytest.raises(InputError, match="must be a dict"):
        s.assemble([0.3])
    with pytest.raises(InputError, match="shape"):
        s.assemble({"coupler_point": [1.0]})
    with pytest.raises(InputError, match="needs 4"):
        s.assemble(start=[0.0])
    with pytest.raises(InputError, match="must be a number"):
        s.assemble({"A": "x"})


def test_what_is_nearly_closed_says_at_which_tolerance_it_counts_as_closed():
    m = kempe.Mechanism("open", dim=2)
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", "a", m.body("b"), at=(1, 0))
    m.revolute("C", m.ground, "b", at=(2.0001, 0), child_at=(1, 0))
    s = m.build()
    open_ = s.assemble()
    said = re.search(r"with tolerance=(\S+) it counts as closed as it is", open_.status)
    assert not open_ and said and open_.residual == pytest.approx(1e-4, rel=1e-3)
    assert s.assemble(tolerance=float(said[1]))
    assert s.assemble(tolerance=kempe.Tolerance(1e-3, float(said[1])))
    assert not s.assemble(tolerance=kempe.Tolerance(1e-3, 0.5 * open_.residual))


def test_a_batch_is_its_rows():
    s = kempe.load("jansen")
    driver = s.coordinate_names[0]
    angles = np.linspace(0, 6, 40)
    batch = s.assemble({driver: angles})
    assert batch.q.shape == (40, s.nq) and batch.success.all()
    for k in (0, 7, 39):
        one = s.assemble({driver: float(angles[k])}, budget=kempe.Budget(rng=0))
        if one.starts == 1 == batch.starts[k]:
            np.testing.assert_array_equal(one.q, batch.q[k])
    assert s.assemble({driver: np.zeros((0,))}).q.shape == (0, s.nq)
    assert s.assemble({driver: np.zeros((2, 3))}).success.shape == (2, 3)
    bad = s.assemble({driver: [0.1, math.nan]})
    assert bad.success.tolist() == [True, False] and np.isnan(bad.q[1]).all()
    assert (
        list(bad.status)[1]
        == "known values, places or start have numbers that are not finite or too large"
    )


def test_threads_do_not_matter():
    s = kempe.load("four_bar")
    angles = np.linspace(0, 6, 5000)
    one, three = (s.assemble({"A": angles}, budget=kempe.Budget(threads=n)) for n in (1, 3))
    np.testing.assert_array_equal(one.q, three.q)


@pytest.mark.parametrize("n", [36, 101, 360])
def test_continuous_rows_follow_each_other(n):
    """A parallelogram led through its change points stays a parallelogram; row by row from one
    start it need not.
    """
    s = kempe.load("parallelogram")
    driver = s.coordinate_names[0]
    angles = np.linspace(0.4, 0.4 + 2 * np.pi, n)
    start = s.assemble({driver: 0.4}, start=s.q("closed"))
    q = s.assemble({driver: angles}, start=start.q, prefer="continuous").q
    X = s.fk(q, "coupler") if "coupler" in s.body_names else s.fk(q)[:, 2]
    assert np.abs(X[:, 1, 0] - X[0, 1, 0]).max() < 1e-9, n  # the coupler does not turn


# ---- additional considerations


@pytest.mark.parametrize("name", ["stewart", "four_bar", "jansen", "bennett", "scissor", "sarrus"])
def test_what_is_left_open_is_nearest(name, hunt):
    """The conditions of Karush, Kuhn and Tucker hold: what is left of the way to the start is normal
    to the closed set, or leads out of limits that the answer lies at. Starts may violate limits.
    """
    free = kempe.load(name)
    closed = free.assemble().q
    numbers = dict(zip(free.coordinate_names, closed, strict=True))
    unknowns = [c for c in numbers if not c.endswith(".qw")]
    rng = hunt.rng()
    at_limits = 0
    for _ in range(hunt.cases(80)):
        limits = {
            c: (numbers[c] - 0.1 * rng.random(), numbers[c] + 0.1 * rng.random())
            for c in unknowns
            if rng.random() < 0.3 and ".q" not in c
        }
        s = free.with_limits(limits)
        space = s.configuration_space
        start = space.integrate(closed, 0.25 * rng.normal(size=s.nv))
        answer = s.assemble(start=start, prefer="nearest")
        assert answer
        N, scale = compute_tangent_space(s, answer.q)
        away = space.difference(answer.q, start) / scale
        q = s.q_dict(answer.q)
        x = np.array([q[c] for c in unknowns])
        assert (x >= s.lower - 1e-12).all() and (x <= s.upper + 1e-12).all()
        out = (x >= s.upper - 1e-9) * 1.0 - (x <= s.lower + 1e-9)
        at_limits += bool(out.any())
        left = nnls(N.T @ np.diag(out)[:, out != 0], N.T @ away)[1] if out.any() else N.T @ away
        assert np.abs(left).max() < 2e-5 * max(1.0, np.linalg.norm(away))
    assert at_limits


def test_names_that_stand_twice_are_refused():
    s = kempe.load("four_bar")
    for call in (
        lambda: s.loops.assembler(["A", "A"]),
        lambda: s.loops.closed_form(["A", "A"]),
        lambda: s.loops.jacobian(s.assemble({"A": 0.3}).q, ["A", "A"], ["D"]),
    ):
        with pytest.raises(InputError, match="names 'A' twice"):
            call()


@pytest.mark.slow
def test_large_systems_are_sparse():
    """The envelope of J J^T of a row of 200 four-bars grows with their number, not with its square."""

    def row(n):
        m = Mechanism("row", dim=2)
        for i in range(n + 1):
            m.body(f"r{i}")
            m.revolute(f"A{i}", m.ground, f"r{i}", at=(i, 0))
        for i in range(n):
            m.body(f"c{i}")
            m.revolute(f"B{i}", f"r{i}", f"c{i}", at=(0, 0.5))
            m.revolute(f"C{i}", f"c{i}", f"r{i + 1}", at=(1, 0), child_at=(0, 0.5))
        return m.build()

    sizes = [int(Assembler(row(n), ()).loops.plan[5]) for n in (100, 200)]
    assert sizes[1] < 2.1 * sizes[0]
    s = row(200)
    near = s.configuration_space.integrate(
        s.neutral, 0.1 * np.random.default_rng(0).normal(size=s.nv)
    )
    answer = s.assemble({"A0": 0.2}, start=near)
    assert answer.code == Status.SOLVED and answer.starts == 1
    assert np.abs(closure_rows.compute_residual(s, answer.q)).max() < 1e-12


# ---- branches and further constraints


def truss(bays: int, brace: float = math.sqrt(2.0)) -> tuple[kempe.System, np.ndarray]:
    """Particles on rods in square bays that stand on the ground, each with a brace; and the
    configuration as drawn.

    `brace` is the length of the brace in the middle.
    """
    m = Mechanism("truss", dim=2)
    m.frame("n0", m.ground, at=(0.0, 0.0)), m.frame("m0", m.ground, at=(0.0, 1.0))
    for k in range(1, bays + 1):
        for name in "nm":
            m.joint(f"{name}{k}", "translation", m.ground, m.particle(f"{name}{k}"))
        rods = (
            (f"n{k - 1}", f"n{k}", 1.0),
            (f"m{k - 1}", f"m{k}", 1.0),
            (f"n{k}", f"m{k}", 1.0),
            (f"n{k - 1}", f"m{k}", brace if 2 * k == bays else math.sqrt(2.0)),
        )
        for a, b, length in rods:
            m.constrain(constraints.Distance(a, b, length))
    return m.build(), np.array(
        [(k, y) for k in range(1, bays + 1) for y in (0.0, 1.0)], dtype=float
    ).ravel()


def rods_open(q: np.ndarray) -> float:
    """By how much the rods of a truss are too long or too short, in numpy alone."""
    places = np.concatenate([[[[0.0, 0.0], [0.0, 1.0]]], q.reshape(-1, 2, 2)])
    n = places[:, 0]
    m = places[:, 1]
    pairs = [
        (n[1:], n[:-1], 1.0),
        (m[1:], m[:-1], 1.0),
        (n[1:], m[1:], 1.0),
        (m[1:], n[:-1], math.sqrt(2.0)),
    ]
    return max(
        float(np.abs(np.linalg.norm(a - b, axis=1) - length).max()) for a, b, length in pairs
    )


def from_within(bays: int, size: float, rng: np.random.Generator, count: int) -> None:
    system, drawn = truss(bays)
    answer = system.assemble(start=drawn + rng.uniform(-size, size, (count, system.nq)))
    assert answer.success.all() and max(map(rods_open, answer.q)) < 1e-9


@pytest.mark.slow
def test_many_loops_close_from_far_away(hunt):
    """Starts that are drawn as a whole closed none of four trusses of 300 bays from within 1 m."""
    from_within(150, 3.0, hunt.rng(), hunt.cases(4))


@pytest.mark.slow
@pytest.mark.parametrize(("bays", "size"), [(300, 1.0), (200, 10.0), (300, 3.0), (60, 1.0)])
def test_many_loops_close_from_far_away_at_length(bays, size, hunt):
    from_within(bays, size, hunt.rng(), hunt.cases(8))


def test_many_loops_of_which_one_cannot_close():
    """All starts are spent, what is left open is not less than the nearest, and the rows beside it
    are the same.
    """
    system, drawn = truss(12, brace=2.5)
    start = drawn + np.random.default_rng(3).uniform(-0.5, 0.5, (2, system.nq))
    answer = system.assemble(start=start)
    assert (
        not answer.success.any()
        and np.all(answer.starts == 20)
        and np.all(np.asarray(answer.residual) > 1e-3)
    )
    alone = system.assemble(start=start[0])
    assert not alone and np.array_equal(alone.q, answer.q[0]) and alone.starts == 20


def test_a_branch_by_its_signs():
    s = kempe.load("four_bar")
    d = [s.q_dict(s.assemble({"A": 0.9}, branch=b).q)["D"] for b in "+-"]
    expected = rocker_angles(0.1, 0.5, 0.4, 0.4, 0.9)
    np.testing.assert_allclose(
        np.exp(1j * np.array(d)), np.exp(1j * np.array(expected[::-1])), atol=1e-12
    )
    angles = np.linspace(0, 6, 50)
    assert s.assemble({"A": angles}, branch="-").success.all()
    posture = s.assemble({"A": 1.5}, branch="closed")
    assert posture and s.q_dict(posture.q)["D"] > 0
    open_ = four_bar(a=0.3, b=0.2, c=0.2, d=0.4).assemble({"A": 2.0}, branch="+")
    # the closed form is where it starts, once
    assert not open_ and open_.status and open_.starts == 1


def test_further_constraints():
    s = kempe.load("four_bar")
    answer = s.assemble(also=lambda q: q[0] + q[3] - 2.0)
    assert answer and answer.q[0] + answer.q[3] == pytest.approx(2.0, abs=1e-12)
    assert np.abs(s.loops.closure_error(answer.q)).max() < 1e-12
    rockers = rocker_angles(0.1, 0.5, 0.4, 0.4, answer.q[0])
    assert min(abs(math.remainder(answer.q[3] - r, 2 * math.pi)) for r in rockers) < 1e-12
    never = constraints.Function(lambda q: q[0] * 0.0 + 1.0, name="never")
    answer = s.assemble(also=[never], budget=kempe.Budget(starts=2))
    assert not answer and "'never' is off by 1" in answer.status
    held = s.assemble(
        {"A": 0.4}, also=constraints.Equation("C = 0.5*D"), budget=kempe.Budget(starts=2)
    )
    assert not held and held.q[0] == 0.4
    with pytest.raises(TypeError, match="no option 'constraints'; they are given as 'also'"):
        s.assemble(constraints=[never])


def test_constraints_of_one_call():
    """They hold in this call, by the formula for the rocker's pin, and the system stays as it is."""
    s = kempe.load("four_bar")
    answer = s.assemble(also=[constraints.Equation("A + D = 2")])
    assert answer and answer.q[0] + answer.q[3] == pytest.approx(2.0, abs=1e-12)
    assert np.abs(s.loops.closure_error(answer.q)).max() < 1e-12 and not s.mechanism.constraints
    rockers = rocker_angles(0.1, 0.5, 0.4, 0.4, answer.q[0])
    assert min(abs(math.remainder(answer.q[3] - r, 2 * math.pi)) for r in rockers) < 1e-12
    rope = constraints.Distance("coupler_point", "ground", at_most=0.01)
    far = s.assemble({"A": 0.4}, also=rope)
    assert not far and "is violated by" in far.status
    with pytest.raises(InputError, match="no constraint of kempe.constraints"):
        s.assemble(also=["rod"])


def test_the_nearest_does_not_depend_on_the_cut():
    """The distance counts all coordinates, so that the answer by name is the same wherever the loop
    is cut.
    """
    near = {"A": 1.4, "B": -0.7, "C": 1.0, "D": 1.3}
    answers = []
    for cut in "ABCD":
        s = four_bar(cut=cut)
        answer = s.assemble(start=near, prefer="nearest")
        assert answer
        answers.append([s.q_dict(answer.q)[n] for n in "ABCD"])
    np.testing.assert_allclose(answers, np.broadcast_to(answers[0], (4, 4)), atol=1e-7)


def test_the_nearest_is_nearest():
    """No closed configuration of a fine sweep of the crank is nearer, measured in all joints."""
    s = kempe.load("four_bar")
    near = s.q({"A": 1.4, "B": -0.7, "C": 1.0, "D": 1.3})
    answer = s.assemble(start=near, prefer="nearest")
    crank = answer.q[0] + np.linspace(-0.2, 0.2, 2001)
    around = s.assemble({"A": crank}, start=answer.q)
    assert around
    assert (
        s.configuration_space.distance(near, answer.q)
        <= s.configuration_space.distance(near, around.q).min() + 1e-9
    )


@pytest.mark.slow
def test_a_mechanism_far_from_the_origin():
    """1000 m away loops close, and are traced, as at the origin: no digits and no tolerance are
    lost.
    """
    m = Mechanism("far", ground="world")
    m.attach(kempe.load("sarrus"), m.ground, at=(1000.0, 2000.0, 0.0), rpy=(0.3, 0.2, 1.0))
    far = m.build()
    home = kempe.load("sarrus")
    driver = home.structure.velocity_names[0]
    start = far.q({k: v for k, v in home.q_dict(home.q("closed")).items()})
    assert far.trace(driver, start).length == pytest.approx(
        home.trace(driver, "closed").length, rel=1e-6
    )
    s = four_bar(at=(1e6, 0.0))
    answer = s.assemble({"A": 1.0})
    assert answer and np.abs(s.loops.closure_error(answer.q)).max() < 1e-9
    tip = s.fk(answer.q, "rocker")[:3, 3] + s.fk(answer.q, "rocker")[:3, :3] @ [0.4, 0, 0]
    assert np.linalg.norm(tip[:2] - [1e6 + 0.1 * np.cos(1.0), 0.1 * np.sin(1.0)]) == pytest.approx(
        0.5, abs=1e-9
    )


def test_a_known_place_far_from_the_origin():
    """Places of frames are in the ground, however the loops are measured."""
    m = Mechanism("four-bar", dim=2)
    crank = m.body("crank")
    coupler = m.body("coupler")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank, at=(500, 0))
    m.revolute("B", crank, coupler, at=(0.1, 0))
    m.revolute("C", coupler, rocker, at=(0.5, 0), child_at=(0.4, 0))
    m.revolute("D", m.ground, rocker, at=(500.4, 0))
    m.frame("pin", "crank", at=(0.1, 0))
    s = m.build()
    place = [500 + 0.1 * np.cos(0.7), 0.1 * np.sin(0.7)]
    answer = s.assemble({"pin": place})
    assert answer and s.q_dict(answer.q)["A"] == pytest.approx(0.7, abs=1e-8)


@pytest.mark.parametrize("tolerance", [-1.0, 0.0, 1.0, float("nan"), float("inf"), "x"])
def test_a_tolerance_that_would_call_open_loops_closed_is_refused(tolerance):
    with pytest.raises(InputError, match="tolerance"):
        kempe.load("four_bar").assemble({"A": 1.0}, tolerance=tolerance)


@pytest.mark.parametrize("values", [{}, {"B": 1.0}, {"A": 1.0, "B": 1.0}])
def test_a_bound_assembler_says_which_values_it_needs(values):
    with pytest.raises(InputError, match=r"needed are \('A',\)"):
        kempe.load("four_bar").loops.assembler(["A"])(values)


def test_a_bad_row_leaves_the_others_alone_where_rows_follow_each_other():
    s = kempe.load("four_bar")
    angles = np.linspace(1.5, 2.5, 11)
    bad = np.where(np.arange(11) == 4, np.nan, angles)
    answer = s.assemble({"A": bad}, prefer="continuous")
    np.testing.assert_array_equal(answer.success, np.arange(11) != 4)
    assert np.isnan(answer.q[4]).all()
    whole = s.assemble({"A": angles}, prefer="continuous")
    good = np.arange(11) != 4
    np.testing.assert_allclose(answer.q[good], whole.q[good], atol=1e-9)


def test_a_bad_place_of_a_frame_leaves_the_other_rows_alone():
    s = kempe.load("four_bar")
    places = s.fk(s.assemble({"A": np.array([1.0, 1.1, 1.2])}).q, "coupler")[:, :2, 3]
    places[1] = np.nan
    answer = s.assemble({"coupler": places})
    assert answer.success.tolist() == [True, False, True] and np.isnan(answer.q[1]).all()


@pytest.mark.parametrize("cut", "ABCD")
@pytest.mark.parametrize(("driven", "driver"), [("D", "A"), ("A", "D"), ("C", "A"), ("B", "C")])
def test_gears_close_wherever_the_loop_is_cut(cut, driven, driver):
    """A cut joint that others follow is no less bound than one that follows."""
    m = four_bar(cut=cut).mechanism
    m.gear(driven, driver, -0.5, 0.4)
    s = m.build()
    answer = s.assemble()
    assert np.abs(s.loops.closure_error(answer.q)).max() < 1e-9 or not answer
    assert answer


def test_places_that_no_frame_can_have_are_refused():
    s = kempe.load("three_rrr")
    body = s.body_names[-1]
    tilted = np.eye(4)
    tilted[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    for place in ([0.0, 0.0, 1.0], tilted):
        with pytest.raises(InputError, match="leaves the plane"):
            s.assemble({body: place})
    for place in (np.full((4, 4), 2.0), np.diag([1.0, 1.0, -1.0, 1.0])):
        with pytest.raises(InputError, match="is not a pose"):
            s.assemble({body: place})


def test_bad_further_constraints_are_refused_and_violated_ones_named():
    s = kempe.load("five_bar")
    for bad in (3, ["x"]):
        with pytest.raises(InputError, match="also holds"):
            s.assemble(also=bad)
    for wrong in (lambda q: "x", lambda q: np.nan):
        with pytest.raises(InputError, match="must give a number"):
            s.assemble(also=wrong)
    with pytest.raises(InputError, match=r"its Jacobian has shape \(1, 3\)"):
        s.assemble(also=constraints.Function(lambda q: q[0], lambda q: np.zeros(3)))
    a = s.body_names[1]
    b = s.body_names[-1]
    answer = s.assemble(also=constraints.Distance(a, b, 99.0, name="far rod"))
    assert not answer and "'far rod'" in answer.status


def test_values_of_a_bound_assembler_are_rows_of_its_coordinates():
    s = kempe.load("five_bar")
    assembler = s.loops.assembler(["A", "D"])
    rows = np.array([[1.9, 1.2], [2.1, 1.0]])
    found = assembler(rows)
    assert found.success.all()
    np.testing.assert_allclose(
        [[s.q_dict(q)[name] for name in "AD"] for q in found.q], rows, atol=1e-12
    )
    np.testing.assert_allclose(assembler(rows[1]).q, found.q[1], atol=1e-9)


def test_known_values_are_inside_the_limits_up_to_rounding():
    s = kempe.load("four_bar").with_limits({"A": (0.0, 1.0)})
    assert s.assemble({"A": -0.5e-9}) and s.assemble({"A": -1.5e-9}).code == Status.OUTSIDE_LIMITS


def test_held_balls_keep_their_known_quaternions():
    """A ball behind a hinge, and one behind both, whose places in q and among velocities are no
    longer the same.
    """
    m = Mechanism("arm")
    m.revolute("A", m.ground, m.body("a"))
    m.spherical("B", "a", m.body("b"))
    m.spherical("C", "b", m.body("c"))
    s = m.build()
    loops = SimpleNamespace(unknown=np.array([1, 2, 3]))
    none = np.zeros(0)
    q = np.arange(9.0)[None]
    known = -1.0 - np.arange(9.0)[None]
    found = OneSidedAssembly(s, loops, none, 0, 0.0, 0, None)._copy_held_coordinates(q, known)
    assert found.tolist() == [[-1.0, 1.0, 2.0, 3.0, 4.0, -6.0, -7.0, -8.0, -9.0]]


# ---- how much work a call is


@pytest.fixture
def searched(monkeypatch):
    """How many rows each call of the kernel that searches has, of all calls so far."""
    rows: list[int] = []
    kernel = assembler_module.loop_closing

    def assemble(*args):
        rows.append(len(args[4]))
        return kernel.assemble_loops(*args)

    monkeypatch.setattr(assembler_module, "loop_closing", SimpleNamespace(assemble_loops=assemble))
    return rows


def test_a_named_branch_is_evaluated_once_and_not_searched(searched, monkeypatch):
    """A closed form that fulfils the equations is the answer: one evaluation a row, no search, no
    sign found again.
    """
    s = kempe.load("four_bar")
    n = 10_000
    evaluated = []
    s.assemble({"A": 0.3})
    searched.clear()
    equations = assembler_module.closure_batch.evaluate_equations

    def counted(*args):
        evaluated.append((len(args[5]), args[6]))
        return equations(*args)

    monkeypatch.setattr(
        assembler_module, "closure_batch", SimpleNamespace(evaluate_equations=counted)
    )
    monkeypatch.setattr(Plan, "branch_of", lambda self, q: pytest.fail("no row was searched"))
    answer = s.assemble({"A": np.linspace(0.0, 20.0, n)}, branch="+")
    assert answer.success.all() and not searched
    assert sum(rows for rows, _ in evaluated) == n and not any(
        jacobian for _, jacobian in evaluated
    )
    assert np.abs(s.loops.closure_error(answer.q)).max() < 1e-14


def test_a_sequence_on_one_branch_searches_its_first_row_only(searched):
    s = kempe.load("four_bar")
    s.assemble({"A": 0.3})
    searched.clear()
    answer = s.assemble({"A": np.linspace(0.0, 20.0, 10_000)}, prefer="continuous")
    assert answer.success.all() and searched == [1]
    assert answer.solver.name == "dyads"
    assert np.abs(np.diff(answer.q, axis=0)).max() < 0.05  # angles wind up with the crank


def test_the_usual_call_of_a_bound_assembler_is_one_call_of_the_kernel(searched, monkeypatch):
    """One array and plain numbers by name go to the kernel; the same answer comes from the general
    way.
    """
    s = kempe.load("four_bar")
    q = s.assemble({"A": 0.3}).q
    bound = s.loops.assembler(["A"])
    bound({"A": 0.4}, q)
    general = bound([0.4], q)
    searched.clear()
    monkeypatch.setattr(
        Assembler, "_solve_problem", lambda *args: pytest.fail("this is for other calls")
    )
    usual = bound({"A": 0.4}, q)
    public = s.assemble({"A": 0.4}, q)
    np.testing.assert_array_equal(usual.q, general.q)
    np.testing.assert_array_equal(public.q, general.q)
    assert usual.iterations == general.iterations and usual.status == general.status
    assert (type(usual.residual), type(usual.success)) == (
        type(general.residual),
        type(general.success),
    )


def test_a_new_design_copies_its_description_few_times(monkeypatch):
    """To build and assemble a mechanism copies its description a few times, not once for each
    joint.
    """
    copies = []
    copy = Mechanism.copy
    monkeypatch.setattr(Mechanism, "copy", lambda self: copies.append(self) or copy(self))
    for links in (3, 9):
        m = Mechanism(f"ring of {links}", dim=2)
        for k in range(links):
            m.body(f"b{k}")
            m.revolute(f"J{k}", f"b{k - 1}" if k else m.ground, f"b{k}", at=(1.0, 0.0))
        m.revolute("last", m.ground, f"b{links - 1}", at=(1.5, 0.0), child_at=(1.0, 0.0))
        copies.clear()
        assert m.build().assemble({"J0": np.linspace(0.5, 0.6, 32)}).q.shape == (32, links + 1)
        assert len(copies) < 16


# ---- sequences by the closed form


def follow(system, known, start, monkeypatch, by_rows):
    """The answer for a sequence; `by_rows`: each row searched from where the last two lead."""
    monkeypatch.setattr(assembler_module, "LONG", 10**9 if by_rows else LONG)
    return system.assemble(known, start, prefer="continuous")


@pytest.mark.slow
def test_a_sequence_by_the_closed_form_is_as_row_by_row(hunt, monkeypatch):
    """Random chains of dyads whose known coordinates go along lines, in small and in large steps."""
    rng = hunt.rng()
    taken = 0
    for _ in range(hunt.cases(80)):
        chain = random_chain(int(rng.integers(2**32)), most=3)
        system = chain.system()
        start = chain.system().q(chain.values)
        way = (
            np.linspace(0.0, 1.0, LONG + 100)[:, None]
            * rng.normal(size=len(chain.known))
            * 10.0 ** rng.uniform(-2, 1)
        )
        known = {name: chain.values[name] + way[:, k] for k, name in enumerate(chain.known)}
        quick, rows = (
            follow(system, known, start, monkeypatch, by_rows) for by_rows in (False, True)
        )
        taken += quick.solver.name == "dyads"
        np.testing.assert_array_equal(quick.code, rows.code)
        np.testing.assert_allclose(quick.q, rows.q, rtol=1e-9, atol=1e-8)
    assert taken > 0


@pytest.mark.parametrize(
    "name, driver", [("parallelogram", 0), ("kite", 0), ("slider_crank_equal", 0)]
)
@pytest.mark.parametrize("n", [700, 5000])
def test_a_sequence_through_a_meeting_of_branches_is_as_row_by_row(name, driver, n, monkeypatch):
    """At a change point the sign of the branch changes along a smooth motion: no closed form is
    taken there.
    """
    system = kempe.load(name)
    start = system.assemble({system.coordinate_names[driver]: 0.4}, start=system.q("closed")).q
    known = {system.coordinate_names[driver]: 0.4 + np.linspace(0.0, 2.0 * np.pi, n)}
    quick, rows = (follow(system, known, start, monkeypatch, by_rows) for by_rows in (False, True))
    assert quick.solver.name != "dyads"
    np.testing.assert_array_equal(quick.q, rows.q)


def test_a_sequence_that_meets_a_limit_is_as_row_by_row(monkeypatch):
    system = four_bar(D={"limits": (-1.5, 1.9)})
    known = {"A": np.linspace(0.0, 7.0, 1000)}
    quick, rows = (follow(system, known, None, monkeypatch, by_rows) for by_rows in (False, True))
    np.testing.assert_array_equal(quick.code, rows.code)
    np.testing.assert_allclose(quick.q, rows.q, atol=1e-9)
