"""Velocities and forces through closed loops, against differences along the branch and textbook
formulas.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from motion_linkages import bennett, four_bar, jansen, linkage, row_of_four_bars, slider_crank

import kempe
from kempe import Mechanism, spatial
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.motion.drive import drive
from kempe.motion.trace import trace
from kempe.motion.transmission import (
    compute_loop_jacobian,
    compute_mechanical_advantage,
    compute_pressure_angle,
    compute_transmission_angle,
    find_dead_points,
)
from kempe.numerics.rank import Spectrum


def five_bar():
    points = {"A": (0.0, 0.0), "B": (-0.5, 1.0), "C": (0.9, 1.8), "D": (2.2, 1.1), "E": (2.0, 0.0)}
    return linkage(
        "five-bar",
        points,
        {
            "ground": ("A", "E"),
            "a": ("A", "B"),
            "b": ("B", "C"),
            "c": ("C", "D"),
            "d": ("D", "E"),
        },
    )


def four_bar_on_branch(n=25):
    path = trace(four_bar(1, 2.5, 2, 3, tracer=(1.0, 0.7)), "A", {"A": 0.5})
    return path.system, path.resample(n).q


def differences(system, q, inputs, frame, h=1e-4):
    """Twist of a frame by each input, by central differences of neighbours on the branch."""
    columns = []
    for name in inputs:
        values = system.q_dict(q)
        ends = []
        for sign in (1.0, -1.0):
            course = {n: np.array([values[n], values[n] + sign * h * (n == name)]) for n in inputs}
            motion = drive(system, course, start=q, limits=False)
            assert motion.success
            ends.append(system.fk(motion.q[-1], frame))
        v = (ends[0][:3, 3] - ends[1][:3, 3]) / (2 * h)
        w = spatial.log_so3(ends[0][:3, :3] @ ends[1][:3, :3].T) / (2 * h)
        columns.append(np.concatenate([v, w]))
    return np.stack(columns, axis=1)


def test_four_bar_rates_are_freudensteins():
    """Rocker rate = a sin(coupler - crank) / (c sin(coupler - rocker)) (Freudenstein, 1955)."""
    system, q = four_bar_on_branch()
    J = compute_loop_jacobian(system, q, ["A"], ["D", "B"])
    assert J.success.all() and J.matrix.shape == (25, 2, 1) and J.rows == ("D", "B")
    crank = q[:, 0]
    rocker = q[:, 2]
    coupler = q[:, 0] + q[:, 1]
    exact = 1.0 * np.sin(coupler - crank) / (2.0 * np.sin(coupler - rocker))
    np.testing.assert_allclose(J.matrix[:, 0, 0], exact, rtol=1e-12, atol=1e-13)
    # of B, which counts from the crank
    own = -1.0 * np.sin(crank - rocker) / (2.5 * np.sin(coupler - rocker)) - 1.0
    np.testing.assert_allclose(J.matrix[:, 1, 0], own, rtol=1e-12, atol=1e-13)


def test_frames_by_differences_along_the_branch():
    system, q = four_bar_on_branch(7)
    for x in q:
        J = compute_loop_jacobian(system, x, ["A"], ["P"])
        assert J.rows == ("P.vx", "P.vy", "P.vz", "P.wx", "P.wy", "P.wz")
        np.testing.assert_allclose(J.matrix, differences(system, x, ["A"], "P"), atol=2e-7)


def test_two_inputs_and_a_long_linkage_by_differences():
    system = five_bar()
    J = compute_loop_jacobian(system, np.zeros(5), ["A", "E"], ["C*", "C"])
    np.testing.assert_allclose(
        J.matrix[:6], differences(system, np.zeros(5), ["A", "E"], "C*"), atol=1e-7
    )
    assert J.matrix.shape == (7, 2)
    leg = jansen()
    x = trace(leg, "O", np.zeros(leg.nq)).at(2.0)
    J = compute_loop_jacobian(leg, x, ["O"], ["F*"])
    # lengths are about 50
    np.testing.assert_allclose(J.matrix, differences(leg, x, ["O"], "F*"), atol=1e-5)


@pytest.mark.slow
def test_space_and_quaternions_by_differences():
    m = Mechanism("RUSR")
    crank = m.body("crank")
    rod = m.body("rod")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank)
    m.revolute("D", m.ground, rocker, at=(2, 0, 0.5), rpy=(0.5, 1.2, 0))
    m.universal("B", crank, rod, at=(0.5, 0, 0))
    m.spherical("C", rod, rocker, at=(2, 0, 0), child_at=(1, 0, 0), cut=True)
    system = m.build()
    path = trace(system, "D", {"A": 0.3})
    # far from the dead points of D
    x = path.q[np.argmax(np.abs(np.gradient(path.values("D"), path.s)))]
    J = compute_loop_jacobian(system, x, ["D"], ["rod", "A"])
    np.testing.assert_allclose(J.matrix[:6], differences(system, x, ["D"], "rod"), atol=1e-6)
    # an idle spin of the rod does not matter to what does not spin
    m = Mechanism("RSSR")
    crank = m.body("crank")
    rod = m.body("rod")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank)
    m.revolute("D", m.ground, rocker, at=(2, 0, 0.5), rpy=(0.5, 1.2, 0))
    m.spherical("B", crank, rod, at=(0.5, 0, 0))
    m.spherical("C", rod, rocker, at=(2, 0, 0), child_at=(1, 0, 0), cut=True)
    idle = m.build()
    assembled = idle.q({"A": system.q_dict(x)["A"], "D": system.q_dict(x)["D"]})
    from kempe.equations.closure import Closure, close_loops

    y = close_loops(Closure(idle, [0, 1], assembled), assembled)
    spinning = compute_loop_jacobian(idle, y, ["D"], ["A", "rocker"])
    assert spinning.success and spinning.nullity == 2
    assert spinning.matrix[0, 0] == pytest.approx(J.matrix[6, 0], rel=1e-9)
    loose = compute_loop_jacobian(idle, y, ["D"], ["rod"])
    assert not loose and "not determined" in loose.status and np.isnan(loose.matrix).all()


@pytest.mark.parametrize("t", [0.3, 1.0, 2.5])
def test_bennett_rates(t):
    alpha = math.radians(40)
    beta = math.radians(70)
    system = bennett(1.0, math.sin(beta) / math.sin(alpha), alpha, beta)
    K = math.sin((beta + alpha) / 2) / math.sin((beta - alpha) / 2)
    second = 2 * math.atan(K / math.tan(t / 2))
    J = compute_loop_jacobian(system, [t, second, -t, -second], ["T1"], ["T2", "T3", "T4"])
    rate = -math.sin(second) / math.sin(t)  # derivative of tan(T1/2) tan(T2/2) = K
    np.testing.assert_allclose(J.matrix[:, 0], [rate, -1.0, -rate], rtol=1e-9)


def test_dead_points_and_change_points_are_refused_with_their_rank():
    a = 2.0
    b = 1.5
    c = 2.2
    d = 3.0
    system = four_bar(a, b, c, d)
    path = trace(system, "D", {"A": 0.8})
    found = find_dead_points(path, "A")
    assert len(found) == 2 and find_dead_points(path, "D") == path.turning_points
    for e in found:
        J = compute_loop_jacobian(system, e.q, ["A"], ["D"])
        assert (
            not J and "dead point" in J.status and (J.rank, J.nullity) == (0, 1) and J.margin < 1e-8
        )
        assert compute_loop_jacobian(system, e.q, ["D"], ["A"]).matrix == pytest.approx(
            0.0, abs=1e-8
        )
    flat = compute_loop_jacobian(four_bar(1, 2, 1, 2), np.zeros(4), ["A"], ["D"])
    assert not flat and "not determined" in flat.status and (flat.rank, flat.nullity) == (1, 2)
    both = compute_loop_jacobian(system, path.q[3], ["A", "D"], ["B"])
    assert (
        not both
        and (both.rank, both.nullity) == (1, 1)
        and "only 1 of the inputs ('A' and 'D')" in both.status
    )


def test_units_of_slides():
    r = 0.02
    rod = 0.05
    system = slider_crank(r, rod)
    path = trace(system, "A", [0.7, -1.0, 0.0, 0.06])
    q = path.resample(40).q
    A = q[:, 0]
    exact = -r * np.sin(A) - r * r * np.sin(A) * np.cos(A) / np.sqrt(rod**2 - (r * np.sin(A)) ** 2)
    np.testing.assert_allclose(
        compute_loop_jacobian(system, q, ["A"], ["S"]).matrix[:, 0, 0], exact, atol=1e-14
    )
    np.testing.assert_allclose(
        compute_loop_jacobian(system, q[:5], ["S"], ["A"]).matrix[:, 0, 0],
        1 / exact[:5],
        rtol=1e-10,
    )
    np.testing.assert_allclose(
        compute_mechanical_advantage(system, q, "A", "S"), 1.0 / exact, rtol=1e-9
    )
    pull = compute_mechanical_advantage(system, q, "A", "slider", direction=(1, 0, 0))
    np.testing.assert_allclose(pull, 1.0 / exact, rtol=1e-9)


def test_mechanical_advantage_at_a_toggle_is_infinite_and_at_a_dead_point_zero():
    system = slider_crank(1.0, 2.0)
    straight = system.q({"S": 3.0})
    assert compute_mechanical_advantage(system, straight, "A", "S") == math.inf
    assert compute_mechanical_advantage(system, straight, "S", "A") == pytest.approx(0.0, abs=1e-12)
    assert math.isnan(compute_mechanical_advantage(five_bar(), np.zeros(5), "A", "C"))
    held = compute_mechanical_advantage(five_bar(), np.zeros(5), "A", "C", still=["E"])
    J = compute_loop_jacobian(five_bar(), np.zeros(5), ["A", "E"], ["C"])
    assert held == pytest.approx(1.0 / J.matrix[0, 0], rel=1e-12)


def test_transmission_angle_of_a_four_bar_by_the_law_of_cosines():
    a = 1.0
    b = 2.5
    c = 2.0
    d = 3.0
    system, q = four_bar_on_branch()
    cosine = (b * b + c * c - a * a - d * d + 2 * a * d * np.cos(q[:, 0])) / (2 * b * c)
    exact = np.arccos(np.abs(cosine))
    np.testing.assert_allclose(compute_transmission_angle(system, q, "C"), exact, atol=1e-12)
    np.testing.assert_allclose(
        compute_pressure_angle(system, q, "C", coupler="B", output="D"),
        math.pi / 2 - exact,
        atol=1e-12,
    )
    # the crank as output
    B = a * np.stack([np.cos(q[:, 0]), np.sin(q[:, 0])], axis=-1)
    u = np.stack([np.cos(q[:, 0] + q[:, 1]), np.sin(q[:, 0] + q[:, 1])], axis=-1)
    other = np.arccos(np.abs(np.sum(u * B, axis=-1) / a))
    np.testing.assert_allclose(compute_transmission_angle(system, q, "B"), other, atol=1e-12)


def test_transmission_angle_of_a_slider():
    r = 1.0
    rod = 2.3
    offset = 0.4
    system = slider_crank(r, rod, offset)
    q = trace(system, "A", [0.6, -1.0, 0.0, 3.0]).resample(30).q
    tilt = np.abs(np.arcsin((r * np.sin(q[:, 0]) - offset) / rod))  # of the rod from the slide
    np.testing.assert_allclose(compute_pressure_angle(system, q, "C"), tilt, atol=1e-12)
    np.testing.assert_allclose(
        compute_transmission_angle(system, q, "C"), math.pi / 2 - tilt, atol=1e-12
    )


def test_names_and_open_loops():
    system, q = four_bar_on_branch(3)
    with pytest.raises(InputError, match="open by"):
        compute_loop_jacobian(system, q[0] + 0.01, ["A"], ["D"])
    for q_open in (q[0] + 0.01, np.stack([q[0], q[0] + 0.01])):
        with pytest.raises(InputError, match="open by"):
            compute_transmission_angle(system, q_open, "C")
    with pytest.raises(UnknownNameError, match="coordinate or frame 'Q'"):
        compute_loop_jacobian(system, q[0], ["A"], ["Q"])
    with pytest.raises(InputError, match="direction"):
        compute_mechanical_advantage(system, q[0], "A", "P")
    with pytest.raises(UnsupportedError, match="bodies with a joint to the ground"):
        compute_pressure_angle(five_bar(), np.zeros(5), "C")
    with pytest.raises(InputError, match="not a joint of the coupler"):
        compute_pressure_angle(system, q[0], "C", coupler="A")
    twin = Mechanism("twin", dim=2)
    twin.revolute("x", twin.ground, twin.body("x"))
    with pytest.raises(InputError, match="'joint:x' or 'frame:x'"):
        compute_loop_jacobian(twin.build(), [0.1], ["x"], ["x"])
    twin.revolute("y", twin.ground, twin.body("z"))
    twin.gear("y", "x", -2.0)
    with pytest.raises(InputError, match="'y' is not part of q: it follows 'x'"):
        compute_loop_jacobian(twin.build(), [0.1], ["x"], ["y"])
    J = compute_loop_jacobian(twin.build(), [0.1], ["x"], ["joint:x", "frame:x"])
    np.testing.assert_allclose(J.matrix[:, 0], [1, 0, 0, 0, 0, 0, 1], atol=1e-15)
    assert "determine" in str(J) and "<table>" in J._repr_html_()


def test_a_joint_on_the_ground_has_no_transmission_angle():
    s = kempe.load("four_bar")
    with pytest.raises(InputError, match="on the ground"):
        compute_transmission_angle(s, s.q("closed"), "A")


# ---- long chains


def test_velocities_of_a_long_chain_take_no_dense_decomposition(monkeypatch):
    """Where the inputs determine all else, sparse factors give the same matrix, rank and margin as
    dense ones.
    """
    system = row_of_four_bars(40, wider=0.01)
    q = system.assemble({"A0": 0.2}).q
    outputs = ["A40", "coupler20", "C3"]
    with monkeypatch.context() as patch:
        patch.setattr(Spectrum, "compute_sparse_null_space", lambda *args: None)
        dense = compute_loop_jacobian(system, q, ["A0"], outputs)
    dense_null = Spectrum.compute_null_space

    def null(spectrum, level):
        assert spectrum.A.shape[1] < system.nv, "a dense decomposition"
        return dense_null(spectrum, level)

    monkeypatch.setattr(Spectrum, "compute_null_space", null)
    sparse = compute_loop_jacobian(system, q, ["A0"], outputs)
    assert sparse.success and dense.success
    assert (sparse.rank, sparse.nullity) == (dense.rank, dense.nullity) == (1, 1)
    np.testing.assert_allclose(sparse.matrix, dense.matrix, rtol=1e-10, atol=1e-12)
    assert abs(sparse.margin - dense.margin) < 1e-12


def test_a_dead_point_of_a_long_chain_is_left_to_the_dense_decomposition():
    """With the second crank in line with its coupler, the first one cannot move; the rank says so."""
    m = row_of_four_bars(40, wider=0.01).mechanism
    m.body("slider")
    m.prismatic("S", m.ground, "slider", at=(-2, 0), axis=(1, 0))
    rod = m.body("rod")
    m.revolute("P", "crank0", rod, at=(0, 0.5))
    m.revolute("Q", rod, "slider", at=(1.0, 0.0))
    system = m.build()
    q = system.assemble({"A0": math.pi / 2}, start=system.q({"P": 0.0, "A0": math.pi / 2})).q
    J = compute_loop_jacobian(system, q, ["S"], ["A0"])
    assert J.code == kempe.Status.DEAD_POINT and J.nullity == 1
    assert compute_loop_jacobian(system, q, ["A0"], ["S"]).success


def test_a_null_space_from_inputs_is_the_null_space_or_nothing(hunt):
    """Random sparse matrices, some of them nearly singular: what is given is the null space, to
    rounding.
    """
    rng = hunt.rng()
    given = 0
    for _ in range(hunt.cases(200)):
        m = int(rng.integers(3, 40))
        k = int(rng.integers(1, 4))
        A = rng.normal(size=(m, m + k)) * (rng.random((m, m + k)) < 0.3)
        A[np.arange(m), rng.permutation(m + k)[:m]] += rng.normal(size=m)
        if rng.random() < 0.5:  # a row that nearly depends on the others
            A[0] = rng.normal(size=m - 1) @ A[1:] + 10.0 ** rng.uniform(-16, 0) * A[0]
        columns = rng.permutation(m + k)[:k].tolist()
        basis = Spectrum(A).compute_sparse_null_space(columns, 1e-8)
        exact = Spectrum(A).compute_null_space(1e-8)
        if basis is None:
            continue
        given += 1
        assert basis.shape == exact.shape
        assert np.abs(basis.T @ basis - np.eye(k)).max() < 1e-13
        assert np.linalg.norm(A @ basis) < 1e-8 * np.linalg.norm(A)
        assert np.abs(basis - exact @ (exact.T @ basis)).max() < 1e-8
    assert given
    assert Spectrum(np.ones((2, 3))).compute_sparse_null_space([0], 1e-8) is None
    assert Spectrum(np.zeros((2, 3))).compute_sparse_null_space([0], 1e-8) is None
    assert Spectrum(np.eye(3)).compute_sparse_null_space([0], 1e-8) is None
