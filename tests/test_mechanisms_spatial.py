"""Closed mechanisms in space: published degrees of freedom and motions, other libraries' constraint
Jacobians.
"""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms_spatial import SPATIAL, Spatial, joint_constraints, singular_values
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import kempe
from kempe import System
from kempe.equations.closure_rows import compute_jacobian, compute_residual

every_mechanism = pytest.mark.parametrize("row", SPATIAL, ids=lambda row: row.name)
NOT_DRIVEN = "seven_bodies_loop"
PI = np.pi


def close(system: System, q: np.ndarray, hold: tuple[str, ...] = ()) -> np.ndarray:
    """A configuration near q that closes all loops, some coordinates held: scipy's solver, then
    Newton steps.
    """
    free = [i for i, name in enumerate(system.structure.velocity_names) if name not in hold]

    def moved(x: np.ndarray) -> np.ndarray:
        v = np.zeros((*x.shape[:-1], system.nv))
        v[..., free] = x
        return system.configuration_space.integrate(q, v)

    def slope(x: np.ndarray) -> np.ndarray:
        """By differences, since rotations are charted about q."""
        h = 1e-6 * np.eye(len(free))
        return (
            compute_residual(system, moved(x + h)) - compute_residual(system, moved(x - h))
        ).T / 2e-6

    found = least_squares(
        lambda x: compute_residual(system, moved(x)),
        np.zeros(len(free)),
        slope,
        xtol=1e-15,
        ftol=1e-15,
    )
    q = moved(found.x)
    for _ in range(4):
        v = np.zeros(system.nv)
        v[free] = np.linalg.lstsq(
            compute_jacobian(system, q)[:, free], -compute_residual(system, q), rcond=1e-7
        )[0]
        q = system.configuration_space.integrate(q, v)
    assert np.abs(system.loops.closure_error(q)).max() < 1e-12
    return q


def driven(name: str, driver: str, angles: np.ndarray) -> tuple[System, list[np.ndarray]]:
    """Configurations with the driver at each angle, each closed from the one before; the first from
    the posture.
    """
    system = kempe.load(name)
    q = system.q("closed")
    start = q[system.coordinate_names.index(driver)]
    out = []
    for angle in np.linspace(start, angles[0], 8).tolist()[:-1] + list(angles):
        q = close(system, system.q({driver: angle}, q), (driver,))
        out.append(q)
    return system, out[7:]


# ------------------------------------------------------------------ degrees of freedom


@every_mechanism
def test_the_posture_closes_all_loops(row: Spatial):
    system = kempe.load(row.name)
    assert np.abs(system.loops.closure_error(system.q("closed"))).max() < 1e-14


@every_mechanism
def test_counting(row: Spatial):
    """6 for each moving body, minus 6 less its freedoms for each joint."""
    system = kempe.load(row.name)
    freedoms = {"revolute": 1, "prismatic": 1, "universal": 2, "spherical": 3}
    taken = sum(6 - freedoms[j.type.type_name] for j in system.structure.joints.values())
    assert 6 * (len(system.body_names) - 1) - taken == row.count
    assert row.rank - row.count == row.redundant


@every_mechanism
def test_the_rank_of_the_equations(row: Spatial):
    system = kempe.load(row.name)
    J = compute_jacobian(system, system.q("closed"))
    assert J.shape == (6 * len(system.structure.closures), system.nv)
    rank = singular_values(J)[1]
    assert system.nv - rank == row.rank
    assert len(J) - rank == row.redundant


@every_mechanism
def test_the_rank_of_the_joints(row: Spatial):
    """Twists of bodies in place of coordinates, and no loops: the same freedoms and redundancies."""
    system = kempe.load(row.name)
    A = joint_constraints(system, system.q("closed"))
    rank = singular_values(A)[1]
    assert A.shape[1] - rank == row.rank
    assert len(A) - rank == row.redundant


def motors_of(name: str) -> tuple[str, ...]:
    """Joints of a shipped mechanism that are driven."""
    return tuple(j.name for j in kempe.load(name).structure.joints.values() if j.actuated)


def test_one_mechanism_is_not_driven():
    assert [row.name for row in SPATIAL if not motors_of(row.name)] == [NOT_DRIVEN]


@pytest.mark.parametrize(
    "row", [r for r in SPATIAL if r.name != NOT_DRIVEN], ids=lambda row: row.name
)
def test_what_is_idle_moves_when_the_motors_hold(row: Spatial):
    system = kempe.load(row.name)
    motors = motors_of(row.name)
    assert len(motors) == row.dof - row.idle
    A = joint_constraints(system, system.q("closed"), motors)
    left = A.shape[1] - singular_values(A)[1]
    # what is neither driven nor idle: of a singular posture only
    assert left - row.idle == row.rank - row.dof


@every_mechanism
def test_each_velocity_is_the_start_of_a_motion(row: Spatial):
    """True freedoms: a step in any direction of the kernel leads to a closed configuration within
    the step squared.
    """
    system = kempe.load(row.name)
    q0 = system.q("closed")
    step = 1e-3
    J = compute_jacobian(system, q0)
    kernel = np.linalg.svd(J)[2][-row.rank :]
    rng = np.random.default_rng(0)
    directions = [*kernel, *(rng.normal(size=(4, row.rank)) @ kernel)]
    ends = []
    for v in directions:
        v /= np.abs(v).max()
        q = system.configuration_space.integrate(q0, step * v)
        for _ in range(6):
            q = system.configuration_space.integrate(
                q,
                np.linalg.lstsq(
                    compute_jacobian(system, q), -compute_residual(system, q), rcond=1e-5
                )[0],
            )
        # rounding, whatever the order of sums on this processor
        assert np.abs(compute_residual(system, q)).max() < 5e-13
        ends.append(system.configuration_space.difference(q0, q) / step - v)
    if row.dof == row.rank:
        assert np.abs(ends).max() < 30 * step
    else:  # a velocity that mixes two motions starts neither of them
        assert np.abs(ends[-4:]).max(axis=1).min() > 0.05


# ------------------------------------------------------------------ single loops of revolute joints

_B = 0.3 * np.sin(1.1) / np.sin(0.6)
_K = 0.2 / np.sin(0.9)
LOOPS = {
    "bennett": [(0.3, 0.6, 0), (_B, 1.1, 0), (0.3, 0.6, 0), (_B, 1.1, 0)],
    "goldberg_5r": [
        (_K * (np.sin(0.5) + np.sin(0.7)), 1.2, 0), (0.2, 0.9, 0), (_K * np.sin(0.7), 0.7, 0),
        (_K * np.sin(0.5), 0.5, 0), (0.2, 0.9, 0),
    ],
    "bricard_trihedral": [
        (0.2, PI / 2, 0), (0.25, -PI / 2, 0), (0.3, PI / 2, 0), (0.35, -PI / 2, 0), (0.4, PI / 2, 0),
        (np.sqrt(0.105), -PI / 2, 0),
    ],
    "bricard_rectangular": [(1, PI / 2, 0), (1, -PI / 2, 0)] * 3,
    "bricard_line_symmetric": [(0.3, 1.0, 0.1), (0.4, 0.7, -0.05), (0.25, 1.3, 0.15)] * 2,
    "schatz": [
        (0, PI / 2, 0.1), (0.2, PI / 2, 0), (0.2, PI / 2, 0), (0.2, PI / 2, 0), (0, PI / 2, 0),
        (0.2 * np.sqrt(3), 0, -0.1),
    ],
}  # fmt: skip
"""Denavit-Hartenberg parameters (a, alpha, d) of all links, the ground last, as published."""

every_loop = pytest.mark.parametrize("name", LOOPS)


@every_loop
def test_pinocchio_closes_the_loop_and_finds_its_freedom(name):
    """The open chain of the published parameters: its end meets its start, its Jacobian has one
    direction too many.
    """
    pin = pytest.importorskip("pinocchio")
    model = pin.Model()
    before = pin.SE3.Identity()
    number = 0
    for i, (a, alpha, d) in enumerate(LOOPS[name]):
        number = model.addJoint(number, pin.JointModelRZ(), before, f"q{i + 1}")
        before = pin.SE3(Rotation.from_euler("x", alpha).as_matrix(), np.array([a, 0, d]))
    end = model.addFrame(pin.Frame("end", number, before, pin.FrameType.OP_FRAME))
    data = model.createData()
    system = kempe.load(name)
    q = system.q("closed")
    assert system.coordinate_names == tuple(model.names[1:])
    J = pin.computeFrameJacobian(model, data, q, end, pin.WORLD)
    np.testing.assert_allclose(data.oMf[end].homogeneous, np.eye(4), rtol=0, atol=1e-14)
    rank = singular_values(J)[1]
    assert model.nv - rank == 1
    ours = np.linalg.svd(compute_jacobian(system, q))[2][-1]
    np.testing.assert_allclose(J @ ours, 0, rtol=0, atol=1e-13)


@every_loop
@pytest.mark.parametrize("side", [0.5, -0.5])
def test_each_loop_turns(side, name):
    """Not only to first order: half a radian to both sides in steps, one freedom everywhere."""
    system = kempe.load(name)
    start = system.q("closed")[0]
    _, found = driven(name, "q1", start + np.linspace(0.1, 1.0, 4) * side)
    for q in found:
        assert system.nv - singular_values(compute_jacobian(system, q))[1] == 1


PARAMETERS = [
    ("bennett", {"a": 0.2, "alpha": 0.9}),
    ("goldberg_5r", {"beta": 0.55, "gamma": 0.6, "alpha": 1.0}),
    ("bricard_trihedral", {"a1": 0.25, "a4": 0.3}),
    ("bricard_rectangular", {"a": 0.3}),
    ("bricard_line_symmetric", {"a": 0.35, "beta": 0.8, "t": 0.1}),
    ("schatz", {"a": 0.25, "offset": 0.15}),
]


@pytest.mark.parametrize("name, parameters", PARAMETERS, ids=[p[0] for p in PARAMETERS])
def test_the_paradox_does_not_depend_on_the_numbers(name, parameters):
    """The conditions stand in the files' expressions: other lengths and twists move as well."""
    before = kempe.load(name)
    system = before.with_parameters(**parameters)
    opened = np.abs(system.loops.closure_error(before.q("closed"))).max()
    # one length only: the angles are the same in every size
    if name in (
        "bricard_rectangular",
        "schatz",
    ):
        assert opened < 1e-14
    else:
        assert opened > 1e-3
    q = close(system, before.q("closed"))
    assert system.nv - singular_values(compute_jacobian(system, q))[1] == 1


def test_bennett_relation():
    """Bennett, 1903: tan(q1/2) tan(q2/2) is the same everywhere, opposite angles are opposite."""
    system, found = driven("bennett", "q1", np.linspace(0.4, 5.8, 12))
    constant = np.sin((1.1 + 0.6) / 2) / np.sin((1.1 - 0.6) / 2)
    for q in found:
        assert np.tan(q[0] / 2) * np.tan(q[1] / 2) == pytest.approx(constant, rel=1e-11)
        np.testing.assert_allclose(np.exp(1j * q[2:]), np.exp(-1j * q[:2]), rtol=0, atol=1e-12)


def test_goldberg_is_two_of_bennetts_linkages():
    """Either side keeps the relation of the linkage that it comes from; the long link's is their
    product.
    """
    _, found = driven("goldberg_5r", "q1", np.linspace(2.2, 3.0, 6))
    first, second = (np.sin((0.9 + twist) / 2) / np.sin((0.9 - twist) / 2) for twist in (0.5, 0.7))
    for q in found:
        t = np.tan(q / 2)
        np.testing.assert_allclose(
            [t[4] * t[0], t[1] * t[2], t[0] * t[1]], [-first, -second, first * second], rtol=1e-10
        )


@pytest.mark.parametrize("side", [0.8, -0.8])
def test_half_a_turn_takes_the_line_symmetric_loop_to_itself(side):
    start = kempe.load("bricard_line_symmetric").q("closed")[0]
    for q in driven("bricard_line_symmetric", "q1", start + np.linspace(0.2, 1, 4) * side)[1]:
        np.testing.assert_allclose(np.exp(1j * q[3:]), np.exp(1j * q[:3]), rtol=0, atol=1e-12)


def test_the_rectangular_loop_lies_on_the_edges_of_a_cube():
    system = kempe.load("bricard_rectangular")
    corners = system.fk(system.q("closed"), ["ground", *(f"link{i}" for i in range(1, 6))])[
        :, :3, 3
    ]
    steps = np.diff([*corners, corners[0]], axis=0)
    np.testing.assert_allclose(np.sort(np.abs(steps), axis=1), [[0, 0, 1]] * 6, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.ptp(corners, axis=0), 1, rtol=0, atol=1e-14)


# ------------------------------------------------------------------ linkages with a known motion


def test_sarrus_moves_on_an_exact_line():
    """Sarrus, 1853: straight up, without turning, twice the plate's rise."""
    system, found = driven("sarrus", "A1", np.linspace(0.2, 1.3, 10))
    for angle, q in zip(np.linspace(0.2, 1.3, 10), found, strict=True):
        expected = np.eye(4)
        expected[2, 3] = 2 * 0.2 * np.sin(angle)
        np.testing.assert_allclose(system.fk(q, "platform"), expected, rtol=0, atol=1e-14)


def test_the_four_bar_in_space_moves_as_in_the_plane():
    plane = kempe.load("four_bar")
    system, found = driven("four_bar_spatial", "A", np.linspace(0, 6, 7))
    assert system.coordinate_names == plane.coordinate_names
    for q in found:
        assert np.abs(plane.loops.closure_error(q)).max() < 1e-13
        np.testing.assert_allclose(system.fk(q), plane.fk(q), rtol=0, atol=1e-14)


@pytest.mark.slow
def test_the_rssr_crank_turns_fully_and_the_rocker_follows_its_equation():
    """The ends of the coupler keep their distance: u cos(D) + v sin(D) = w, with two roots for each
    crank angle.
    """
    system, found = driven("rssr", "A", np.linspace(PI / 2, PI / 2 + 2 * PI, 25))
    for q in found:
        values = system.q_dict(q)
        # C = pivot + r (cos, 0, -sin)(D) in the basis of the rocker's frame
        X = system.structure.joints["D"].X_PF.evaluate_pose(system.structure.parameters)
        e1 = X[:3, 0]
        e2 = X[:3, 1]
        offset = X[:3, 3] - 0.1 * np.array([np.cos(values["A"]), np.sin(values["A"]), 0])
        u = 2 * 0.25 * e1 @ offset
        v = 2 * 0.25 * e2 @ offset
        w = 0.4**2 - 0.25**2 - offset @ offset
        roots = np.arctan2(v, u) + np.array([1, -1]) * np.arccos(w / np.hypot(u, v))
        assert np.abs(np.sin((roots - values["D"]) / 2)).min() < 1e-12
    D = system.coordinate_names.index("D")
    assert np.sin((found[-1][D] - found[0][D]) / 2) == pytest.approx(0, abs=1e-12)


# ------------------------------------------------------------------ platforms


def moved(name: str, seed: int, size: float = 0.1) -> tuple[System, np.ndarray]:
    """A configuration a random way from the posture `closed`, in six small steps."""
    system = kempe.load(name)
    q = system.q("closed")
    rng = np.random.default_rng(seed)
    v = rng.normal(size=system.nv)
    for _ in range(6):
        kernel = np.linalg.svd(compute_jacobian(system, q))[2][
            np.linalg.matrix_rank(compute_jacobian(system, q), tol=1e-7) :
        ]
        step = kernel.T @ (kernel @ v)
        q = close(
            system, system.configuration_space.integrate(q, size / 6 * step / np.abs(step).max())
        )
    return system, q


@pytest.mark.parametrize("name", ["delta_ss", "delta_uu", "three_upu"])
def test_translational_platforms_do_not_turn(name):
    for seed in range(3):
        system, q = moved(name, seed)
        X, X0 = (system.fk(each, "platform") for each in (q, system.q("closed")))
        assert np.linalg.norm(X[:3, 3] - X0[:3, 3]) > 0.003
        np.testing.assert_allclose(X[:3, :3], np.eye(3), rtol=0, atol=1e-12)


def test_delta_arms_are_those_of_the_textbook():
    """The middles of elbow and platform edge are a rod apart: (r + arm cos - x)^2 + y^2 + (z + arm
    sin)^2 = rod^2.
    """
    system, q = moved("delta_uu", 1)
    p = system.fk(q, "platform")[:3, 3]
    for i, phi in enumerate((0.0, 2 * PI / 3, 4 * PI / 3), 1):
        x = np.cos(phi) * p[0] + np.sin(phi) * p[1]
        y = np.cos(phi) * p[1] - np.sin(phi) * p[0]
        angle = system.q_dict(q)[f"A{i}"]
        reach = 0.2 - 0.05 + 0.25 * np.cos(angle) - x
        assert reach**2 + y**2 + (p[2] + 0.25 * np.sin(angle)) ** 2 == pytest.approx(
            0.5**2, abs=1e-13
        )


@pytest.mark.parametrize(
    "name", ["stewart", "stewart_sps", "stewart_dietmaier", "three_upu", "three_rps"]
)
def test_a_leg_is_as_long_as_its_coordinate(name):
    system, q = moved(name, 2)
    joints = system.structure.joints
    values = system.q_dict(q)
    below = {j.child: j for j in joints.values() if j.parent == "ground"}
    for i in range(1, 1 + sum(n.startswith("leg") for n in joints)):
        foot = below[f"lower{i}"].X_PF.evaluate_pose(system.structure.parameters)[:3, 3]
        hand = next(j for j in joints.values() if j.parent == "platform" and j.child == f"upper{i}")
        head = (system.fk(q, "platform") @ hand.X_PF.evaluate_pose(system.structure.parameters))[
            :3, 3
        ]
        assert np.linalg.norm(head - foot) == pytest.approx(values[f"leg{i}"], abs=1e-13)


def test_hunts_platform_has_no_torsion():
    """Legs in three planes through the vertical axis: the platform's rotation matrix has R12 = R21."""
    for seed in range(3):
        system, q = moved("three_rps", seed, 0.4)
        R = system.fk(q, "platform")[:3, :3]
        assert abs(R[2, 2]) < 0.99 and R[0, 1] == pytest.approx(R[1, 0], abs=1e-12)


def test_two_motions_meet_in_the_singular_3_upu():
    """Away from the posture either of them has three freedoms: one without turning, one in which
    the platform tilts.
    """
    system = kempe.load("three_upu_snu")
    q0 = system.q("closed")
    kernel = np.linalg.svd(compute_jacobian(system, q0))[2][-5:].T
    twist = system.jacobian(q0, "platform") @ kernel
    assert np.linalg.matrix_rank(twist, tol=1e-9) == 5 and np.abs(twist[5]).max() < 1e-12

    def nearby(*velocity: float) -> tuple[np.ndarray, np.ndarray]:
        """Closed configuration and pose of the platform, from a velocity (x, y, z, tilts)."""
        v = kernel @ np.linalg.lstsq(twist[:5], np.array(velocity), rcond=None)[0]
        q = close(system, system.configuration_space.integrate(q0, v))
        assert system.nv - singular_values(compute_jacobian(system, q))[1] == 3
        return q, system.fk(q, "platform")

    _, X = nearby(0.1, 0.05, 0.02, 0, 0)
    np.testing.assert_allclose(X[:3, :3], np.eye(3), rtol=0, atol=1e-12)
    half = 0.35 / 2
    for a, b in ((0.2, 0.1), (-0.3, 0.2)):
        _, X = nearby(half * b, -half * a, 0.02, a, b)
        np.testing.assert_allclose(
            Rotation.from_matrix(X[:3, :3]).as_rotvec(), [a, b, 0], rtol=0, atol=0.02
        )
        bisector = X[:3, 2] + [0, 0, 1]  # the platform is the base seen in a mirror (Hunt, 1973)
        np.testing.assert_allclose(np.cross(bisector, X[:3, 3]), 0, rtol=0, atol=1e-12)


# ------------------------------------------------------------------ Dietmaier's forty poses


def forty(
    base: np.ndarray, platform: np.ndarray, legs: np.ndarray, starts: int = 4000
) -> np.ndarray:
    """Poses (n, 7), position and quaternion wxyz, w > 0, in which the legs have their lengths;
    Newton's method.
    """
    rng = np.random.default_rng(0)
    p = rng.normal(size=(starts, 3))
    p *= legs[0] / np.linalg.norm(p, axis=1, keepdims=True)
    R = Rotation.random(starts, rng=rng)
    for _ in range(60):
        r = np.einsum("nij,kj->nki", R.as_matrix(), platform)
        d = p[:, None] + r - base
        f = (np.einsum("nki,nki->nk", d, d) - legs**2) / 2
        J = np.concatenate([d, np.cross(r, d)], axis=-1)
        JT = J.swapaxes(1, 2)
        damping = 1e-3 * np.linalg.norm(f, axis=1)[:, None, None] ** 2 * np.eye(6) + 1e-18 * np.eye(
            6
        )
        step = -np.linalg.solve(JT @ J + damping, JT @ f[..., None])[..., 0]
        step *= np.minimum(1, 0.7 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-30))
        p = p + step[:, :3]
        R = Rotation.from_rotvec(step[:, 3:]) * R
    d = p[:, None] + np.einsum("nij,kj->nki", R.as_matrix(), platform) - base
    good = np.abs(np.linalg.norm(d, axis=-1) - legs).max(axis=1) < 1e-12
    found: list[np.ndarray] = []
    for pose in np.concatenate([p, np.roll(R.as_quat(canonical=True), 1, axis=1)], axis=1)[good]:
        if all(np.abs(pose - other).max() > 1e-3 for other in found):
            found.append(pose)
    return np.array(found)


@pytest.mark.slow
def test_dietmaiers_platform_has_forty_poses():
    """Dietmaier, 1998. From the lengths of the posture and the file's geometry, by Newton from 4000
    random poses.
    """
    system = kempe.load("stewart_dietmaier")
    q = system.q("closed")
    joints = system.structure.joints
    base, platform = (
        np.array(
            [
                joints[f"{kind}{i}"].X_PF.evaluate_pose(system.structure.parameters)[:3, 3]
                for i in range(1, 7)
            ]
        )
        for kind in "US"
    )
    legs = np.array([system.q_dict(q)[f"leg{i}"] for i in range(1, 7)])
    np.testing.assert_array_equal(legs, [1, 0.645275, 1.086284, 1.503439, 1.281933, 0.771071])
    poses = forty(base, platform, legs)
    assert len(poses) == 40
    X = system.fk(q, "platform")
    ours = np.r_[X[:3, 3], np.roll(Rotation.from_matrix(X[:3, :3]).as_quat(canonical=True), 1)]
    assert np.abs(poses - ours).max(axis=1).min() < 1e-9


# ------------------------------------------------------------------ MuJoCo

BALL = '<geom size="0.01" mass="1"/>'


def numbers(values: object) -> str:
    return " ".join(repr(float(v)) for v in np.asarray(values))


def mujoco_freedoms(bodies: str, pairs: list[tuple[str, str]], q: dict[str, list[float]]) -> int:
    """Velocities that connections between pairs of sites allow, at joint values by name; they must
    be closed.
    """
    mujoco = pytest.importorskip("mujoco")
    connections = "".join(f'<connect site1="{a}" site2="{b}"/>' for a, b in pairs)
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><option jacobian="dense"/>'
        f"<worldbody>{bodies}</worldbody><equality>{connections}</equality></mujoco>"
    )
    data = mujoco.MjData(model)
    for name, values in q.items():
        start = model.joint(name).qposadr[0]
        data.qpos[start : start + len(values)] = values
    mujoco.mj_forward(model, data)
    assert data.nefc == 3 * len(pairs) and np.abs(data.efc_pos).max() < 1e-12
    return model.nv - singular_values(np.asarray(data.efc_J).reshape(data.nefc, model.nv))[1]


def platform(system: System, sites: dict[str, np.ndarray]) -> tuple[str, list[float]]:
    """A free body with sites, and its coordinates as in the posture."""
    X = system.fk(system.q("closed"), "platform")
    text = "".join(f'<site name="{name}" pos="{numbers(p)}"/>' for name, p in sites.items())
    turn = np.roll(Rotation.from_matrix(X[:3, :3]).as_quat(), 1)
    return f'<body><freejoint name="platform"/>{BALL}{text}</body>', [*X[:3, 3], *turn]


@pytest.mark.parametrize("name, freedoms", [("stewart", 6), ("stewart_sps", 12)])
def test_mujoco_agrees_on_the_hexapod(name, freedoms):
    """Legs on the ground, a free platform, six connections: written from the dimensions, not from
    the file.
    """
    system = kempe.load(name)
    values = system.q_dict(system.q("closed"))
    bodies = ""
    heads = {}
    q = {}
    for i in range(6):
        side = (-1, 1)[i % 2]
        third = i // 2 * 2 * PI / 3
        foot = third + side * 0.2
        head = third + side * (PI / 3 - 0.2)
        heads[f"head{i}"] = 0.15 * np.array([np.cos(head), np.sin(head), 0])
        if name == "stewart":
            low = f'<joint name="x{i}" axis="1 0 0"/><joint name="y{i}" axis="0 1 0"/>'
            q |= {f"x{i}": [values[f"U{i + 1}.rx"]], f"y{i}": [values[f"U{i + 1}.ry"]]}
        else:
            low = f'<joint name="ball{i}" type="ball"/>'
            q[f"ball{i}"] = [values[f"B{i + 1}.q{c}"] for c in "wxyz"]
        bodies += (
            f'<body pos="{numbers([0.3 * np.cos(foot), 0.3 * np.sin(foot), 0])}" euler="0 0 '
            f'{foot!r}">{low}{BALL}<body><joint name="leg{i}" type="slide" axis="0 0 '
            f'1"/>{BALL}<site name="top{i}"/></body></body>'
        )
        q[f"leg{i}"] = [values[f"leg{i + 1}"]]
    body, q["platform"] = platform(system, heads)
    assert (
        mujoco_freedoms(bodies + body, [(f"top{i}", f"head{i}") for i in range(6)], q) == freedoms
    )


def test_mujoco_agrees_on_the_delta():
    """Arms on the ground, rods in ball joints, a free platform: 27 coordinates, 18 equations, 9
    freedoms.
    """
    system = kempe.load("delta_ss")
    values = system.q_dict(system.q("closed"))
    bodies = ""
    edges = {}
    q = {}
    for i in range(3):
        phi = i * 2 * PI / 3
        rods = ""
        for k, w in (("a", -0.05), ("b", 0.05)):
            radial = np.array([np.cos(phi), np.sin(phi), 0])
            tangent = np.array([-np.sin(phi), np.cos(phi), 0])
            edges[f"edge{i}{k}"] = 0.05 * radial + w * tangent
            rods += (
                f'<body pos="0.25 {w} 0" quat="{numbers([0.5, -0.5, 0.5, -0.5])}"><joint '
                f'name="rod{i}{k}" type="ball"/>{BALL}<site name="end{i}{k}" pos="0 0 0.5"/></body>'
            )
            q[f"rod{i}{k}"] = [values[f"B{i + 1}{k}.q{c}"] for c in "wxyz"]
        arm = f'<joint name="arm{i}" axis="0 1 0"/>{BALL}{rods}'
        bodies += f'<body euler="0 0 {phi!r}"><body pos="0.2 0 0">{arm}</body></body>'
        q[f"arm{i}"] = [values[f"A{i + 1}"]]
    body, q["platform"] = platform(system, edges)
    pairs = [(f"end{i}{k}", f"edge{i}{k}") for i in range(3) for k in "ab"]
    assert mujoco_freedoms(bodies + body, pairs, q) == 9
