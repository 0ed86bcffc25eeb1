"""Poses as people have them: the same answers from every form, and what is off by rounding is
mended and said.
"""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import polar
from scipy.spatial.transform import RigidTransform, Rotation

import kempe
from kempe import poses, spatial, tasks
from kempe.errors import RoundedWarning

pin = pytest.importorskip("pinocchio")


class Listed:
    """As the classes of the Spatial Math Toolbox: `A` is a matrix, or a list of them where it holds
    several.
    """

    def __init__(self, X):
        self.A = X if X.ndim == 2 else list(X)


def _ros(X):
    x, y, z, w = Rotation.from_matrix(X[:3, :3]).as_quat()
    px, py, pz = X[:3, 3]
    return SimpleNamespace(
        position=SimpleNamespace(x=px, y=py, z=pz), orientation=SimpleNamespace(x=x, y=y, z=z, w=w)
    )


FORMS = {
    "list": lambda X: X.tolist(),
    "pinocchio": lambda X: pin.SE3(X),
    "scipy": RigidTransform.from_matrix,
    "toolbox": Listed,
    "drake": lambda X: SimpleNamespace(GetAsMatrix4=lambda: X),
    "sophus": lambda X: SimpleNamespace(matrix=lambda: X),
    "ros": _ros,
    "ros transform": lambda X: SimpleNamespace(
        translation=_ros(X).position, rotation=_ros(X).orientation
    ),
    "ros pose with a header": lambda X: SimpleNamespace(header=None, pose=_ros(X)),
    "ros transform with a header": lambda X: SimpleNamespace(
        header=None,
        transform=SimpleNamespace(translation=_ros(X).position, rotation=_ros(X).orientation),
    ),
    "ros odometry": lambda X: SimpleNamespace(
        header=None, pose=SimpleNamespace(pose=_ros(X), covariance=[0.0] * 36), twist=None
    ),
    "pair": lambda X: (X[:3, 3], X[:3, :3]),
    "reversed pair": lambda X: [X[:3, :3].tolist(), X[:3, 3].tolist()],
    "pair with scipy": lambda X: (X[:3, 3], Rotation.from_matrix(X[:3, :3])),
    "wxyz": lambda X: {"at": X[:3, 3], "quat_wxyz": spatial.matrix_to_quat_wxyz(X[:3, :3])},
    "xyzw": lambda X: {
        "at": X[:3, 3].tolist(),
        "quat_xyzw": Rotation.from_matrix(X[:3, :3]).as_quat(),
    },
    "rpy": lambda X: {"at": X[:3, 3], "rpy": Rotation.from_matrix(X[:3, :3]).as_euler("xyz")},
    "matrix": lambda X: {"at": X[:3, 3], "matrix": X[:3, :3]},
    "matrix of scipy": lambda X: {"at": X[:3, 3], "matrix": Rotation.from_matrix(X[:3, :3])},
}


def _poses(rng, n):
    return spatial.pose(Rotation.random(n, rng=rng).as_matrix(), rng.uniform(-1.0, 1.0, (n, 3)))


@pytest.mark.parametrize("form", FORMS)
def test_forms_are_the_same_pose(form, hunt):
    X = _poses(hunt.rng(), 3)
    for one in X:
        np.testing.assert_allclose(poses.read_pose_array(FORMS[form](one), "x"), one, atol=1e-14)
    np.testing.assert_allclose(
        poses.read_pose_array([FORMS[form](one) for one in X], "x"), X, atol=1e-14
    )


def test_forms_of_many_at_once(hunt):
    X = _poses(hunt.rng(), 4).reshape(2, 2, 4, 4)
    R = Rotation.from_matrix(X[..., :3, :3].reshape(-1, 3, 3))
    for given in (
        (X[..., :3, 3], X[..., :3, :3]),
        {"at": X[..., :3, 3], "quat_xyzw": R.as_quat().reshape(2, 2, 4)},
        [Listed(X[0]), Listed(X[1])],
        [[pin.SE3(x) for x in row] for row in X],
    ):
        np.testing.assert_allclose(poses.read_pose_array(given, "x"), X, atol=1e-14)


def test_plane():
    X = np.array([[0.0, -1.0, 2.0], [1.0, 0.0, 3.0], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(poses.read_pose_array((X[:2, 2], X[:2, :2]), "x"), X)
    X4 = poses.read_pose_array({"at": (2.0, 3.0), "angle": np.pi / 2}, "x")
    np.testing.assert_allclose(X4[:2, [0, 1, 3]], X[:2], atol=1e-15)
    arm = kempe.Mechanism("arm", dim=2)
    last = arm.ground
    for i in range(3):
        body = arm.body(f"b{i}")
        arm.revolute(f"j{i}", last, body, at=(0.7 if i else 0.0, 0.0))
        last = body
    arm.frame("tip", last, at=(0.3, 0.0))
    arm = arm.build()
    target = arm.fk([0.3, 0.4, 0.5], "tip")
    for given in ({"at": target[:2, 3], "angle": 1.2}, (target[:2, 3], target[:2, :2])):
        assert arm.ik(given, "tip").residual < 1e-9
        assert len(arm.ik_all(given, "tip").q) == 2


@pytest.mark.parametrize(
    "given",
    [
        [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]],
        [np.eye(4), np.eye(4)],
        [np.zeros(3), np.zeros(3), np.zeros(3)],
        "text",
        None,
        3,
        [tasks.Position("a", (0, 0, 0))],
        [[1, 2], [3]],
        ["l1", 0.0, 0.0],
        ("l1", 0.0),
        object(),
    ],
)
def test_all_else_is_left_as_it_is(given):
    assert poses.read_pose_array(given, "x") is given


@pytest.mark.parametrize(
    "given, said",
    [
        (
            {"at": (0, 0, 0), "quat": (1, 0, 0, 0)},
            "has 'quat'; a pose in words has 'at' and one of rpy",
        ),
        ({"at": (0, 0, 0), "rpy": (0, 0, 0), "angle": 1.0}, "rpy and angle"),
        ({}, "is empty"),
        ({"at": (0, 0, 0, 1)}, r"shape \(4,\)"),
        ({"quat_xyzw": (0, 0, 1)}, r"shape \(3,\)"),
        ({"quat_xyzw": (0, 0, 0, 0)}, "must not be zero"),
        ({"matrix": np.eye(4)}, "rotations"),
        ({"at": "x"}, "real numbers"),
        ((np.zeros(3), np.array([1.0, 0, 0, 0])), "order is not named"),
        ([pin.SE3.Identity(), Rotation.identity()], "different shapes"),
    ],
)
def test_what_is_no_pose_is_refused(given, said):
    with pytest.raises(kempe.errors.InputError, match=said):
        poses.read_pose_array(given, "target")


ARM = kempe.load("puma560")
TOOL = ARM.frame_names[-1]
Q = ARM.random(4)
GOAL = ARM.fk(Q, TOOL)
MANY = ARM.fk(np.array([ARM.random(i) for i in range(3)]), TOOL)
PLATFORM = kempe.load("stewart")
HELD = PLATFORM.fk(PLATFORM.assemble().q, "platform") @ spatial.pose(
    spatial.rpy_to_matrix([0.1, 0.05, -0.07])
)
FREE = kempe.Mechanism("free")
FREE.free("J", FREE.ground, FREE.body("B"))
FREE = FREE.build()


def _at(given):
    m = kempe.Mechanism("m")
    m.fixed("J", m.ground, m.body("B"), at=given)
    return m.build().fk([], "B")


TARGETS = {
    "ik": (GOAL, lambda x: ARM.ik(x, TOOL, Q).q),
    "ik, analytic": (GOAL, lambda x: ARM.ik(x, TOOL, Q, method="analytic").q),
    "ik of many": (MANY, lambda x: ARM.ik(x, TOOL, Q).q),
    "ik of a task": (GOAL, lambda x: ARM.ik([tasks.Pose(TOOL, x)], start=Q).q),
    "ik of an orientation": (GOAL, lambda x: ARM.ik([tasks.Orientation(TOOL, x)], start=Q).q),
    "ik through loops": (HELD, lambda x: PLATFORM.ik(x, "platform").q),
    "ik_all": (GOAL, lambda x: ARM.ik_all(x, TOOL).q),
    "ik_all of many": (MANY, lambda x: ARM.ik_all(x, TOOL).q),
    "ik_path": (MANY, lambda x: ARM.ik_path(x, TOOL, ARM.random(0)).q),
    "ik_step": (GOAL, lambda x: ARM.ik_step(Q + 0.01, x, TOOL, dt=0.1).velocity),
    "assemble": (HELD, lambda x: PLATFORM.assemble({"platform": x}).q),
    "from_maximal": (GOAL[None], lambda x: kempe.convert.from_maximal(FREE, x)),
    "placement": (GOAL, _at),
}
"""Verbs that take poses: what is given as an array, and what comes out."""


@pytest.mark.parametrize("form", ["pinocchio", "scipy", "pair", "xyzw"])
@pytest.mark.parametrize("verb", TARGETS)
def test_verbs_take_each_form(verb, form):
    given, ask = TARGETS[verb]
    make = FORMS[form]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = ask(make(given) if given.ndim == 2 else [make(x) for x in given])
    np.testing.assert_allclose(found, ask(given), atol=1e-7)


@pytest.mark.parametrize("verb", TARGETS)
def test_rounded_rotations_are_mended_and_said(verb):
    given, ask = TARGETS[verb]
    off = given.copy()
    off[..., :3, :3] = np.round(off[..., :3, :3], 4)
    mended = off.copy().reshape(-1, 4, 4)
    for X in mended:
        X[:3, :3] = polar(X[:3, :3])[0]
    before = off.copy()
    with pytest.warns(RoundedWarning, match="nearest rotation was taken") as caught:
        found = ask(off)
    assert {w.filename for w in caught} == {__file__}
    np.testing.assert_array_equal(off, before)
    np.testing.assert_allclose(found, ask(mended.reshape(off.shape)), atol=1e-7)


@pytest.mark.parametrize("verb", TARGETS)
def test_what_is_further_off_is_refused(verb):
    given, ask = TARGETS[verb]
    off = given.copy()
    off[..., 0, 0] += 3e-3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if verb.endswith("of many"):
            assert np.isnan(ask(off)).all() or ask(off).size == 0
        else:
            with pytest.raises(kempe.errors.KempeError, match="rotation|not a pose"):
                ask(off)


def test_only_those_that_are_off_are_changed(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(200)):
        X = _poses(rng, 5)
        X[1, :3, :3] += rng.uniform(-1e-4, 1e-4, (3, 3))
        X[2, :3, :3] += rng.uniform(-1e-8, 1e-8, (3, 3))
        X[3, 0, :3] *= -1.0
        X[4, 0, 0] = np.nan
        with pytest.warns(RoundedWarning, match="in 1 of 5 cases"):
            found = poses.correct_rotations(X, "x")
        np.testing.assert_array_equal(found[[0, 2, 3, 4]], X[[0, 2, 3, 4]])
        np.testing.assert_allclose(found[1, :3, :3], polar(X[1, :3, :3])[0], atol=1e-15)
        with pytest.warns(RoundedWarning):
            np.testing.assert_array_equal(poses.correct_rotations(X[1], "x"), found[1])
        assert poses.correct_rotations(X[2], "x").base is X[2].base
