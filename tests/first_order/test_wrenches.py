"""Wrenches of joints and constraints: reciprocal to what may move, in balance, and equal to statics
by hand.
"""

from __future__ import annotations

import closed_graphs
import numpy as np
import pytest
from hunts import some
from known_truths import bipartite
from shipped import with_loops

import kempe
from kempe import Mechanism, System
from kempe import constraints as c
from kempe.equations import closure_rows
from kempe.equations.judge import Poses
from kempe.equations.velocity import evaluate_velocity_rows
from kempe.errors import InputError, UnknownNameError
from kempe.first_order.wrenches import Wrenches

H = 1e-6


def allowed(system: System, q: np.ndarray) -> np.ndarray:
    """Velocities (nv, k) that all equations of position and velocity allow, by their own Jacobian."""
    J = np.vstack([closure_rows.compute_jacobian(system, q), evaluate_velocity_rows(system, q)[0]])
    U, s, Vt = np.linalg.svd(J)
    return Vt[int((s > 1e-8 * max(1.0, s.max(initial=0.0))).sum()) :].T


def twist(system: System, q: np.ndarray, v: np.ndarray, body: str, p: np.ndarray) -> np.ndarray:
    """[v; w] of a body at the point p along a velocity, in axes of the ground, by differences of
    poses.
    """
    a, b = (Poses(system, system.configuration_space.integrate(q, h * v))(body) for h in (H, -H))
    W = (a - b)[:3, :3] @ Poses(system, q)(body)[:3, :3].T / (2.0 * H)
    w = np.array([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]]) / 2.0
    return np.append((a - b)[:3, 3] / (2.0 * H) + np.cross(w, p - Poses(system, q)(body)[:3, 3]), w)


def work(system: System, w: Wrenches, v: np.ndarray) -> float:
    """The largest power of a wrench of any joint or constraint along an allowed velocity."""
    out = 0.0
    m = system.mechanism
    for name in w.names:
        of = m.joints.get(name) or m.constraints.get(name)
        if of is None or not of.parent:
            continue
        p = w.locate_wrench(name)
        moves = twist(system, w.q, v, of.child, p) - twist(system, w.q, v, of.parent, p)
        out = max(out, float(np.abs(w[name] @ moves).max(initial=0.0)))
    return out


# ---- no power


def test_random_loops_of_all_joints(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(25)):
        made = closed_graphs.random_closed(rng)
        system = made.system()
        w = Wrenches(system, made.values(system))
        V = allowed(system, w.q)
        for name in w.names:
            assert np.abs(w.compute_generalised_forces(name) @ V).max(initial=0.0) < 1e-8
        if V.shape[1]:
            assert work(system, w, V @ rng.normal(size=V.shape[1])) < 1e-6


@pytest.mark.slow
def test_many_random_loops_of_all_joints(hunt):
    for _ in range(8):
        test_random_loops_of_all_joints(hunt)


RODS = {
    "distance": lambda: c.Distance("tip", "eye", 0.9),
    "on_line": lambda: c.OnLine("tip", (0.1, 0.2, 0.0), (1.0, 1.0, 0.0), other="eye"),
    "on_plane": lambda: c.OnPlane("tip", (0.1, 0.2, 0.0), (1.0, 1.0, 0.0)),
    "on_surface": lambda: c.OnSurface("tip", "x^2/4 + y^2 = 1", other="eye"),
    "pointing": lambda: c.Pointing("tip", (0.6, 0.8, 0.0), other="eye"),
    "look_at": lambda: c.LookAt("tip", (2.0, 1.0, 3.0)),
    "relative_pose": lambda: c.RelativePose("tip", "eye", np.eye(4)),
    "orientation": lambda: c.Orientation("tip", np.eye(3), other="eye"),
    "rolls": lambda: c.Rolls("tip", radius=0.1),
    "disc": lambda: c.Rolls("tip", radius=0.1, shape="disc"),
    "no_sideslip": lambda: c.NoSideslip("tip"),
    "equation": lambda: c.Equation("`Ja.x` - 2*`Jb.x` = 0.1"),
}


def two_bodies() -> Mechanism:
    m = Mechanism("two")
    for name, frame in (("a", "tip"), ("b", "eye")):
        m.free(f"J{name}", m.ground, m.body(name))
        m.frame(frame, name, at=(0.2, 0.1), rpy=(0.1, 0.2, 0.3))
    return m


@pytest.mark.parametrize("name", RODS)
def test_constraints_of_all_kinds(name, hunt):
    m = two_bodies()
    rng = hunt.rng()
    m.constrain(RODS[name](), "it")
    system = m.build()
    w = Wrenches(system, system.assemble(start=system.random(rng)).q)
    V = allowed(system, w.q)
    assert V.shape[1] == system.nv - len(w.compute_generalised_forces("it"))
    assert (
        np.abs(w.compute_generalised_forces("it") @ V).max() < 1e-8
        and np.abs(w.compute_generalised_forces("it")).max() > 0.1
    )
    if name != "equation":
        assert work(system, w, V @ rng.normal(size=V.shape[1])) < 1e-6
        assert np.linalg.matrix_rank(w["it"]) == len(w["it"])
    assert w["Ja"].shape == (0, 6)  # a free joint transmits nothing


# ---- known ones


def test_a_rod_pulls_along_itself():
    m = two_bodies()
    m.constrain(c.Distance("tip", "eye", 0.9), "rod")
    system = m.build()
    w = Wrenches(system, system.assemble(start=system.random(3)).q)
    a, b = (system.fk(w.q, f)[:3, 3] for f in ("tip", "eye"))
    force = w["rod"][0]
    np.testing.assert_allclose(np.abs(force[:3] @ (b - a)), 0.9, atol=1e-9)
    assert np.linalg.norm(force[:3]) == pytest.approx(1.0) and np.abs(force[3:]).max() < 1e-9


def test_a_pin_carries_all_but_a_moment_about_its_axis():
    m = Mechanism("pin")
    m.revolute("pin", m.ground, m.body("door"), at=(1, 2, 3), axis=(0.6, 0.0, 0.8))
    w = Wrenches(m.build(), np.array([0.4]))
    assert (
        np.linalg.matrix_rank(w["pin"]) == 5
        and np.abs(w["pin"][:, 3:] @ [0.6, 0.0, 0.8]).max() < 1e-12
    )
    np.testing.assert_allclose(w.locate_wrench("pin"), [1, 2, 3])


@pytest.mark.parametrize(
    ("kind", "count"), [("prismatic", 5), ("cylindrical", 4), ("spherical", 3), ("fixed", 6)]
)
def test_how_many_a_joint_carries(kind, count):
    m = Mechanism(kind)
    m.joint("J", kind, m.ground, m.body("b"))
    w = Wrenches(system := m.build(), system.random(1))
    assert np.linalg.matrix_rank(w["J"]) == len(w["J"]) == count


def test_a_locked_hinge_carries_everything():
    m = Mechanism("locked")
    m.revolute("J", m.ground, m.body("b"))
    m.lock({"J": 0.3})
    assert np.linalg.matrix_rank(Wrenches(m.build(), np.zeros(0))["J"]) == 6


def test_a_contact_pushes_along_the_normal_and_a_wheel_across():
    ball = kempe.load("ball")
    w = Wrenches(ball, ball.q({"flight.x": 0.3, "flight.z": 0.1}))
    np.testing.assert_allclose(w["ground plane"], [[0, 0, 1, 0, 0, 0]], atol=1e-12)
    car = kempe.load("car")
    w = Wrenches(car, np.array([1.0, 2.0, 0.3]))
    np.testing.assert_allclose(
        w["rear axle"], [[-np.sin(0.3), np.cos(0.3), 0, 0, 0, 0]], atol=1e-12
    )


# ---- self-stress


@pytest.mark.parametrize("name", some(with_loops(), 3))
def test_as_many_states_as_redundant_constraints(name):
    """The multipliers of maximal coordinates against the rank of screws; bodies and axes are in
    balance.
    """
    system = kempe.load(name)
    m = system.mobility(local=False)
    w = m.wrenches
    assert len(w.stresses) == m.redundant_here
    ground = system.body_names[0]
    joints = system.structure.joints
    for state in w.stresses:
        total = {body: np.zeros(6) for body in system.body_names}
        for n, wrench in state.wrenches.items():
            about = np.append(wrench[:3], wrench[3:] + np.cross(w.locate_wrench(n), wrench[:3]))
            total[joints[n].child] += about
            total[joints[n].parent] -= about
            left = wrench - w[n].T @ np.linalg.lstsq(w[n].T, wrench, rcond=None)[0]
            assert np.abs(left).max() < 1e-7 or system.structure.couplings
        assert max(np.abs(x).max() for body, x in total.items() if body != ground) < 1e-7


def test_parallel_axes_in_space():
    """Axes along z: statics leaves two moments across z open, and a force along z, the same all
    around the loop.
    """
    found = [s.wrenches for s in kempe.load("four_bar_spatial").mobility().wrenches.stresses]
    assert len(found) == 3
    for state in found:
        assert list(state) == ["A", "B", "C", "D"] and all(
            w[5] == w[0] == w[1] == 0.0 for w in state.values()
        )
    np.testing.assert_allclose(
        sorted(tuple(s["A"][2:5]) for s in found), [(0, 0, 1), (0, 1, 0), (1, 0, 0)]
    )
    assert "B: force (0, 0, 1), moment (-0.1, 0, 0)" in str(
        kempe.load("four_bar_spatial").mobility()
    )


def test_a_truss_against_its_equilibrium_matrix(hunt):
    """K(3, 3) with its joints on a conic has one state of self-stress (Bolker and Roth, 1980):
    forces of its rods.
    """
    angles = hunt.rng().uniform(0.0, 6.0, 6)
    points = np.column_stack([2.0 * np.cos(angles), np.sin(angles)])
    m = Mechanism("K33", dim=2)
    for k, p in enumerate(points):
        m.translation(f"P{k}", m.ground, m.particle(f"p{k}"), at=tuple(p))
    edges = bipartite(3, 3)
    for i, j in edges:
        m.distance(f"{i}-{j}", f"p{i}", f"p{j}", float(np.linalg.norm(points[i] - points[j])))
    system = m.build()
    found = Wrenches(system, system.neutral).stresses
    E = np.zeros((12, 9))  # of unit tensions
    for k, (i, j) in enumerate(edges):
        u = (points[j] - points[i]) / np.linalg.norm(points[j] - points[i])
        E[2 * i : 2 * i + 2, k] = u
        E[2 * j : 2 * j + 2, k] = -u
    tensions = np.linalg.svd(E)[2][np.linalg.matrix_rank(E, 1e-9) :]
    assert len(tensions) == len(found) == 1
    own = [
        -found[0].wrenches[f"{i}-{j}"][:2]
        @ (points[j] - points[i])
        / np.linalg.norm(points[j] - points[i])
        for i, j in edges
    ]
    np.testing.assert_allclose(np.abs(np.dot(own, tensions[0])), np.linalg.norm(own), rtol=1e-8)


# ---- statics


def test_the_torque_of_a_crank_by_virtual_work(hunt):
    """A force on the coupler of a four-bar against differences of its path (Lanczos, 1970, chapter
    3).
    """
    system = kempe.load("four_bar")
    rng = hunt.rng()
    for _ in range(hunt.cases(20)):
        a = float(rng.uniform(0.2, 6.0))
        force = rng.normal(size=2)
        q = system.assemble({"A": a}).q
        at = [
            system.fk(system.assemble({"A": a + h}, start=q).q, "coupler_point")[:2, 3]
            for h in (H, -H)
        ]
        found = Wrenches(system, q).balance_loads({"coupler_point": force}, held="A")
        assert found.efforts["A"] == pytest.approx(-force @ (at[0] - at[1]) / (2.0 * H), abs=1e-7)
        pins = found.wrenches["A"][:2] + found.wrenches["D"][:2] * (
            1 if system.structure.joints["D"].parent == "ground" else -1
        )
        np.testing.assert_allclose(pins, -force, atol=1e-9)


def carrying(dim: int, particle: bool) -> System:
    """An arm of two hinges, at the end of which a body slides, or a particle."""
    m = Mechanism("arm", dim)
    turn = {"rpy": (0.4, -0.3, 0.2)} if dim == 3 else {"angle": 0.4}
    m.revolute("A", m.ground, m.body("a"), at=(0.1, 0.2, 0.3)[:dim], **turn)
    m.revolute("B", "a", m.body("b"), at=(0.5, 0.1, -0.2)[:dim], **turn)
    end = m.particle("end") if particle else m.body("end")
    m.prismatic("C", "b", end, at=(0.3, -0.2, 0.1)[:dim], axis=(0.6, 0.8, 0.0)[:dim])
    m.frame("here", m.ground, at=(1.0, 2.0, 3.0)[:dim])
    if not particle:
        m.frame("tip", "end", at=(0.2, 0.1, 0.4)[:dim], **turn)
    return m.build()


@pytest.mark.parametrize("moment", [False, True])
@pytest.mark.parametrize("particle", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_what_an_arm_carries(dim, particle, moment):
    """Motors hold -J^T W, the first hinge with its motor the load; the ground carries what lies on
    it.
    """
    s = carrying(dim, particle)
    rng = np.random.default_rng(2)
    q = s.random(rng)
    frame = "end" if particle else "tip"
    load = np.zeros(6)
    load[[0, 1, 5] if dim == 2 else range(6)] = rng.normal(size=3 if dim == 2 else 6)
    load[3:] *= moment and not particle
    given = load[[0, 1, 5]] if dim == 2 else load
    given = given if moment else given[:dim]
    found = Wrenches(s, q).balance_loads({frame: given, "here": given}, held=s.coordinate_names)
    efforts = np.array([found.efforts[n] for n in s.coordinate_names])
    np.testing.assert_allclose(efforts, -s.jacobian(q, frame).T @ load, atol=1e-9)
    arm = s.fk(q, frame)[:3, 3] - s.fk(q, "a")[:3, 3]
    carried = -np.append(load[:3], load[3:] + np.cross(arm, load[:3]))
    np.testing.assert_allclose(found.wrenches["A"], carried, atol=1e-9)


@pytest.mark.parametrize("load", [(1.0,), (1.0, 2.0, 3.0, 4.0), ((1.0, 2.0),), 3.0])
def test_loads_of_a_wrong_shape(load):
    s = carrying(2, False)
    with pytest.raises(InputError, match="load on 'tip' has shape .*; needed are 2 or 3 numbers"):
        Wrenches(s, s.neutral).balance_loads({"tip": load}, held=s.coordinate_names)


def test_a_beam_on_two_supports():
    """A pin at 0 and a roller at 3 share a weight at 1 by 2 : 1 (the law of the lever)."""
    m = Mechanism("beam", dim=2)
    m.revolute("pin", m.ground, m.body("beam"))
    m.frame("end", "beam", at=(3, 0))
    m.frame("load", "beam", at=(1, 0))
    m.constrain(c.OnLine("end", (0, 0), (1, 0)), "roller")
    found = Wrenches(m.build(), np.zeros(1)).balance_loads({"load": (0, -9.0)})
    np.testing.assert_allclose(found.wrenches["pin"], [0, 6, 0, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(found.wrenches["roller"], [0, 3, 0, 0, 0, 0], atol=1e-9)
    assert found.undetermined == () and not found.efforts


def test_what_statics_does_not_determine_is_said():
    m = Mechanism("beam", dim=2)
    m.revolute("pin", m.ground, m.body("beam"))
    m.revolute("other", m.ground, "beam", at=(3, 0), child_at=(3, 0))
    found = Wrenches(m.build(), np.zeros(2)).balance_loads({"beam": (0, -9.0, 0.0)})
    assert found.undetermined == ("pin", "other") and "(not determined)" in str(found)
    np.testing.assert_allclose(
        found.wrenches["pin"] + found.wrenches["other"], [0, 9, 0, 0, 0, 0], atol=1e-9
    )


def test_bad_input():
    system = kempe.load("four_bar")
    w = Wrenches(system, system.assemble({"A": 1.0}).q)
    with pytest.raises(
        InputError, match="nothing balances the loads on 'coupler_point' with no coordinate held"
    ):
        w.balance_loads({"coupler_point": (1.0, 2.0)})
    with pytest.raises(UnknownNameError, match="joint or constraint 'X'"):
        w["X"]
    with pytest.raises(UnknownNameError, match="frame"):
        w.balance_loads({"nowhere": (1.0, 2.0)})
    with pytest.raises(UnknownNameError, match="'Z'"):
        w.balance_loads({"coupler_point": (1.0, 2.0)}, held="Z")
    with pytest.raises(InputError, match="needed are 2 or 3 numbers"):
        w.balance_loads({"coupler_point": (1.0, 2.0, 3.0, 4.0)}, held="A")
