"""Every task of the zoo: derivatives by finite differences, errors against the forward model,
masses by Pinocchio.
"""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import numpy as np
import pytest
from graphs import graphs
from hunts import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from robots import urdf_files

import kempe
from kempe import Mechanism, System, spatial, tasks
from kempe.equations.packed_tasks import Packed
from kempe.errors import InputError, UnknownNameError

STEP = 1e-6


def zoo(s: System, frame: str, other: str, rng: np.random.Generator) -> list[tasks.Task]:
    """All tasks that can be required of two bodies of a system."""
    dim = s.dim

    def p() -> np.ndarray:
        return rng.uniform(-1, 1, dim)

    X = (
        spatial.exp_se3(rng.normal(size=6))
        if dim == 3
        else spatial.pose(spatial.rot_z(rng.normal()), [*p(), 0.0])
    )
    particles = {n for n, (_, _, particle) in s.structure.table.at.items() if particle}
    out: list[tasks.Task] = [
        tasks.Position(frame, p()),
        tasks.OnLine(frame, p(), p()),
        tasks.OnPlane(frame, p(), p()),
        tasks.HalfSpace(frame, p(), p(), margin=0.3),
        tasks.OnSphere(frame, p() + 3.0, 0.7),
        tasks.InBox(frame, -abs(p()), abs(p()), X),
        tasks.Distance(frame, other, 0.4),
        tasks.CentreOfPoints([frame, other], p()),
        tasks.CentreOfPoints({frame: 1.0, other: 3.0, "ground": 2.0}, p()),
        tasks.Posture(s.random(rng)),
        tasks.Function(lambda q: np.array([np.sum(np.sin(q)), q[0] * q[-1]])),
    ]
    if frame not in particles:
        out += [
            tasks.Pose(frame, X),
            tasks.Orientation(frame, X[:3, :3]),
            tasks.Pointing(frame, p(), p()),
            tasks.LookAt(frame, p() + 3.0, p()),
            tasks.Position(frame, p(), point=p()),
            tasks.OnLine(frame, p(), p(), point=p()),
            tasks.OnSphere(frame, p() + 3.0, 0.7, point=p()),
        ]
    if not {frame, other} & particles:
        out += [
            tasks.RelativePose(frame, other, X),
            tasks.RelativePosition(frame, other, p(), point=p()),
            tasks.Distance(frame, other, 0.4, point=p(), other_point=p() + 2.0),
            tasks.Distance(frame, other, at_least=0.2, at_most=0.3, point=p() + 2.0),
        ]
    return out


def by_differences(task: tasks.Task, s: System, q: np.ndarray) -> np.ndarray:
    ends = [
        tasks.error(s, task, s.configuration_space.integrate(q, x * STEP * np.eye(s.nv)))
        for x in (1, -1)
    ]
    return (ends[0] - ends[1]).T / (2 * STEP)


def is_smooth(task: tasks.Task, s: System, q: np.ndarray) -> bool:
    """Whether the error has a derivative: near a half turn it grows without bounds, at no distance
    there is none.
    """
    if isinstance(task, tasks.Distance):
        return tasks.miss(s, task, s.neutral)[0] != pytest.approx(0.4)
    return isinstance(task, tasks.Posture) or tasks.miss(s, task, q)[1] <= 3.0


def check(task: tasks.Task, s: System, q: np.ndarray) -> None:
    """The battery for one task at one configuration."""
    meters, radians = (float(x) for x in tasks.miss(s, task, q))
    e = tasks.error(s, task, q)
    J = tasks.jacobian(s, task, q)
    assert J.shape == (*e.shape, s.nv), task.label
    np.testing.assert_allclose(
        J,
        by_differences(task, s, q),
        atol=3e-7 * (1 + np.abs(J).max(initial=0)),
        err_msg=task.label,
    )
    loops = Packed(s, [task], length=1.0).loops
    tie = next(t for t in loops.ties if t.name == task.label)
    if isinstance(task, (tasks.Pose, tasks.RelativePose)):
        assert math.hypot(meters, radians) == pytest.approx(np.linalg.norm(e), abs=1e-7)
    elif isinstance(task, (tasks.Pointing, tasks.LookAt)):
        assert 2.0 * math.sin(radians / 2) == pytest.approx(np.linalg.norm(e), abs=1e-9)
    elif isinstance(task, tasks.Orientation):
        assert radians == pytest.approx(np.linalg.norm(e), abs=1e-7)
    elif not isinstance(task, tasks.Posture):
        low, high = np.array(tie.bounds).reshape(-1, 2).T if tie.bounds else (0.0, 0.0)
        assert math.hypot(meters, radians) == pytest.approx(
            np.linalg.norm(e - np.clip(e, low, high)), abs=1e-9
        )


@pytest.mark.slow
@given(graphs(most=6, loops=2), st.integers(0, 2**32))
@settings(deadline=None, max_examples=examples(25))
def test_the_zoo_on_random_graphs(graph, seed):
    """Trees and loops, in the plane and in space, with balls, screws, particles, gears and locked
    joints.
    """
    s = graph.mechanism().build()
    assume(s.nv)
    rng = np.random.default_rng(seed)
    frame, other = rng.choice(s.body_names, 2)
    if frame == "ground":
        frame, other = other, frame
    with pytest.raises(InputError, match="particle") if "p" in frame else contextlib.nullcontext():
        tasks.error(s, tasks.Pose(str(frame), np.eye(4)), s.neutral)
    posed = [(task, s.random(rng)) for task in zoo(s, str(frame), str(other), rng)]
    smooth = [(task, q) for task, q in posed if is_smooth(task, s, q)]
    assert len(smooth) >= 10
    for task, q in smooth:
        check(task, s, q)


def test_one_axis_and_dict_of_coordinates():
    s = kempe.load("ball")
    q = s.random(3)
    check(tasks.Posture(s.q_dict(s.random(4))), s, q)
    with pytest.raises(InputError, match="as a whole"):
        tasks.error(s, tasks.Posture({s.coordinate_names[3]: 1.0}), q)
    with pytest.raises(UnknownNameError):
        tasks.error(s, tasks.Posture({"nothing": 1.0}), q)


def weighed() -> System:
    """A tree with a floating base, a ball, a coupling, a particle and masses off their frames, the
    ground's too.
    """
    m = Mechanism("weighed")
    m.bodies["ground"] = type(m.ground)("ground", False, 2.0, (0.1, 0.2, 0.3))
    rng = np.random.default_rng(1)
    for k, (kind, parent) in enumerate(
        [
            ("free", "ground"),
            ("revolute", "b0"),
            ("spherical", "b1"),
            ("revolute", "b0"),
            ("prismatic", "ground"),
        ]
    ):
        m.joint(
            f"j{k}",
            kind,
            parent,
            m.body(f"b{k}", 1.0 + k, rng.uniform(-1, 1, 3)),
            at=rng.uniform(-1, 1, 3),
            rpy=rng.uniform(-1, 1, 3),
        )
    m.translation("p", "b1", m.particle("p", 0.5), at=rng.uniform(-1, 1, 3))
    m.gear("j3", "j1", -2.0, 0.3)
    return m.build()


def test_centre_of_mass_against_its_definition():
    s = weighed()
    q = s.random(1)
    bodies = s.mechanism.bodies
    total = sum(b.mass for b in bodies.values())
    expected = (
        sum(b.mass * (s.fk(q, n) @ [*(b.center or (0, 0, 0)), 1.0])[:3] for n, b in bodies.items())
        / total
    )
    target = np.array([0.3, -0.2, 0.5])
    task = tasks.CentreOfMass(target)
    np.testing.assert_allclose(tasks.error(s, task, q), expected - target, atol=1e-14)
    for more in ({}, {"axes": "xz"}, {"axes": "z"}, {"within": 0.1}, {"within": [0.1, 0.2, 0.3]}):
        check(tasks.CentreOfMass(target, **more), s, q)
    with pytest.raises(InputError, match="no masses"):
        tasks.error(
            kempe.load("four_bar"), tasks.CentreOfMass(target[:2]), kempe.load("four_bar").neutral
        )
    with pytest.raises(InputError, match="axes"):
        tasks.error(s, tasks.CentreOfMass(target, "up"), q)


def test_masses_survive_files(tmp_path: Path):
    """Written to TOML and read again, a robot keeps its centre of mass; Pinocchio says the same of
    URDF below.
    """
    m = weighed().mechanism
    m.bodies["ground"] = type(m.ground)("ground")
    del m.couplings["j3"]
    del m.joints["p"], m.bodies["p"]
    s = m.build()
    q = s.random(2)
    expected = tasks.error(s, tasks.CentreOfMass([0, 0, 0]), q)
    again = kempe.load(s.mechanism.save(tmp_path / "robot.toml"))
    found = tasks.error(again, tasks.CentreOfMass([0, 0, 0]), again.q(s.q_dict(q)))
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.skipif(not urdf_files(), reason="the package example-robot-data is not installed")
@pytest.mark.parametrize("name", ["g1_29dof_rev_1_0.urdf", "talos_reduced.urdf"])
def test_centre_of_mass_and_its_jacobian_against_pinocchio(name):
    pinocchio = pytest.importorskip("pinocchio")
    path = next(p for n, p in urdf_files().items() if n.endswith(name))
    s = kempe.load(path)
    model = pinocchio.buildModelFromUrdf(str(path))
    data = model.createData()
    q = s.random(5)
    theirs = pinocchio.neutral(model)
    joints = [
        (model.joints[i], n) for i, n in enumerate(model.names) if i and n in s.coordinate_names
    ]
    order = [s.coordinate_names.index(n) for _, n in joints]
    for joint, n in joints:
        assert joint.nq == joint.nv == 1
        theirs[joint.idx_q] = q[s.coordinate_names.index(n)]
    assert len(order) == s.nq == model.nq > 20
    task = tasks.CentreOfMass([0.0, 0.0, 0.0])
    # Pinocchio leaves out what is fixed to the ground, so masses on the root link are compared with
    # it put back
    ground = s.mechanism.bodies[s.body_names[0]]
    fixed = [n for n in s.body_names if s.structure.table.at[n][0] < 0]
    rest = [
        (s.mechanism.bodies[n].mass or 0.0, s.fk(q, n), s.mechanism.bodies[n].center or (0, 0, 0))
        for n in fixed
    ]
    moving = sum(i.mass for i in model.inertias[1:])
    com = pinocchio.centerOfMass(model, data, theirs)
    total = moving + sum(m for m, _, _ in rest)
    expected = (moving * com + sum(m * (X @ [*c, 1.0])[:3] for m, X, c in rest)) / total
    assert ground.name == s.body_names[0]
    np.testing.assert_allclose(tasks.error(s, task, q), expected, atol=1e-12)
    J = pinocchio.jacobianCenterOfMass(model, data, theirs) * moving / total
    np.testing.assert_allclose(
        tasks.jacobian(s, task, q)[:, order], J[:, [j.idx_v for j, _ in joints]], atol=1e-12
    )


def test_what_is_refused():
    s = kempe.load("panda")
    q = s.neutral
    X = np.eye(4)
    frame = s.body_names[-1]
    for bad, match in (
        (tasks.Pose(frame, np.eye(3)), "shape"),
        (tasks.Pose(frame, X.T + np.eye(4, k=-3)), "last row"),
        (tasks.Position(frame, [1, 2]), "shape"),
        (tasks.Position(frame, "here"), "real numbers"),
        (tasks.Pointing(frame, [0, 0, 0]), "zero"),
        (tasks.OnSphere(frame, [0, 0, 0], -1.0), "negative"),
        (tasks.InBox(frame, [1, 1, 1], [0, 0, 0]), "low <= high"),
        (tasks.Distance(frame, "panda_link1"), "needs"),
        (tasks.Distance(frame, "panda_link1", at_least=2, at_most=1), "leave nothing"),
        (tasks.CentreOfPoints([], [0, 0, 0]), "needed"),
        (tasks.Function(lambda q: q, low=[1, 2]), "bound"),
    ):
        with pytest.raises(InputError, match=match):
            tasks.error(s, bad, q)
    with pytest.raises(UnknownNameError, match="panda_link7"):
        tasks.error(s, tasks.Pose("panda_link77", X), q)
    m = Mechanism("dust")
    m.translation("p", m.ground, m.particle("dust"))
    with pytest.raises(InputError, match="particle"):
        tasks.error(m.build(), tasks.Pose("dust", X), np.zeros(3))


def ends(rng: np.random.Generator, p: np.ndarray, q: np.ndarray) -> dict[str, tuple[type, dict]]:
    """Tasks between ends with their parameters, those that have an entry for each of the points (n,
    3) as arrays.
    """
    width = rng.uniform(0.02, 0.1, (len(p), 3))
    far = np.linalg.norm(p - q, axis=1)
    return {
        "box": (tasks.InBox, {"frame": "panda_link7", "low": p - width, "high": p + 0.5 * width}),
        "one corner": (
            tasks.InBox,
            {"frame": "panda_link7", "low": p - width, "high": np.full(3, np.inf)},
        ),
        "margin": (
            tasks.HalfSpace,
            {
                "frame": "panda_link7",
                "origin": np.zeros(3),
                "normal": [0, 0, 1.0],
                "margin": p[:, 2],
            },
        ),
        "at least": (
            tasks.Distance,
            {"frame": "panda_link7", "other": "panda_link4", "at_least": far},
        ),
        "at most": (
            tasks.Distance,
            {"frame": "panda_link7", "other": "panda_link4", "at_most": far},
        ),
        "both": (
            tasks.Distance,
            {
                "frame": "panda_link7",
                "other": "panda_link4",
                "at_least": 0.98 * far,
                "at_most": 1.02 * far,
            },
        ),
        "sphere": (
            tasks.OnSphere,
            {"frame": "panda_link7", "center": np.zeros(3), "radius": np.linalg.norm(p, axis=1)},
        ),
        "within": (
            tasks.CentreOfPoints,
            {"frames": ["panda_link7"], "target": p, "within": width[:, :2], "axes": "xy"},
        ),
        "within all": (
            tasks.CentreOfPoints,
            {"frames": ["panda_link7"], "target": p, "within": width[:, :1]},
        ),
    }


@pytest.mark.parametrize(
    "name", list(ends(np.random.default_rng(0), np.ones((2, 3)), np.zeros((2, 3))))
)
def test_ends_that_differ_from_target_to_target(name):
    """Each target of a batch is measured and solved as alone, and as the ends are written down
    here.
    """
    panda = kempe.load("panda")
    rng = np.random.default_rng(3)
    n = 6
    q = panda.random(rng, n)
    p, other = (panda.fk(q, f)[:, :3, 3] for f in ("panda_link7", "panda_link4"))
    kind, requested = ends(rng, p, other)[name]
    many = kind(**requested)
    at = panda.random(rng, n)
    got = tasks.miss(panda, many, at)[0] + tasks.miss(panda, many, at)[1]
    answer = panda.ik(many, start=at)
    assert answer.success.all()
    for i in range(n):
        one = kind(
            **{
                k: v[i] if isinstance(v, np.ndarray) and len(v) == n else v
                for k, v in requested.items()
            }
        )
        assert sum(tasks.miss(panda, one, at[i])) == pytest.approx(got[i], abs=1e-12)
        assert max(tasks.miss(panda, one, answer.q[i])) <= 1.001e-6
    x = panda.fk(at, "panda_link7")[:, :3, 3]
    if name == "box":
        np.testing.assert_allclose(
            got, np.linalg.norm(x - np.clip(x, requested["low"], requested["high"]), axis=1)
        )
    if name == "margin":
        np.testing.assert_allclose(got, np.maximum(requested["margin"] - x[:, 2], 0.0), atol=1e-12)
    if name == "both":
        d = np.linalg.norm(x - panda.fk(at, "panda_link4")[:, :3, 3], axis=1)
        np.testing.assert_allclose(
            got, np.abs(d - np.clip(d, requested["at_least"], requested["at_most"])), atol=1e-12
        )
    if name == "within":
        off = np.maximum(np.abs(x - p)[:, :2] - requested["within"], 0.0)
        np.testing.assert_allclose(got, np.linalg.norm(off, axis=1), atol=1e-12)


def test_derivatives_of_ends_that_differ():
    panda = kempe.load("panda")
    rng = np.random.default_rng(4)
    q = panda.random(rng)
    p, other = (panda.fk(q, f)[None, :3, 3] for f in ("panda_link7", "panda_link4"))
    for kind, parameters in ends(rng, p, other).values():
        task = kind(**parameters)
        J = tasks.jacobian(panda, task, q[None])[0]
        np.testing.assert_allclose(J, by_differences_of_rows(task, panda, q), atol=1e-6)


def by_differences_of_rows(task: tasks.Task, s: System, q: np.ndarray) -> np.ndarray:
    out = [
        [
            tasks.error(s, task, s.configuration_space.integrate(q, x * STEP * e)[None])[0]
            for x in (1, -1)
        ]
        for e in np.eye(s.nv)
    ]
    return np.array([(a - b) / (2 * STEP) for a, b in out]).T


def test_why_a_row_with_its_own_ends_fails():
    panda = kempe.load("panda")
    low = np.array([[0.3, 0.0, 0.4], [2.0, 0.0, 0.4]])
    answer = panda.ik(tasks.InBox("panda_link7", low, low + 0.1), budget=kempe.Budget(starts=5))
    assert list(answer.success) == [True, False] and "missed by" in answer.status[1]
    many = tasks.OnSphere("panda_link7", [0, 0, 0.3], [0.5, 9.0])
    assert "missed by" in panda.ik(many, budget=kempe.Budget(starts=5)).status[1]
    posture = tasks.Posture(np.array([panda.mid, panda.mid + 9.0]), weight=None)
    assert "missed by" in panda.ik(posture, budget=kempe.Budget(starts=5)).status[1]
    with pytest.raises(InputError, match="low <= high"):
        panda.ik(tasks.InBox("panda_link7", low, low - 0.1))
