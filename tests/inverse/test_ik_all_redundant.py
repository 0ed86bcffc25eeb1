"""Chains with joints to spare: a pose that can be reached has a solution, whatever is held; said,
and as data.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import reference
from hunts import some
from robots import urdf_files

import kempe
from kempe.inverse.ik_all import ik_all
from kempe.inverse.sweep import ik_sweep

PI = math.pi
H = math.pi / 2

FILES = {
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "link7"),
    "baxter": ("baxter_description/urdf/baxter.urdf", "left_wrist"),
    "pr2": ("pr2_description/urdf/pr2.urdf", "r_gripper_palm_link"),
    "centauro": ("centauro_description/urdf/centauro.urdf", "arm1_8"),
    "tiago": ("tiago_description/robots/tiago.urdf", "arm_tool_link"),
    "tiago_pro": ("tiago_pro_description/robots/tiago_pro.urdf", "arm_left_7_link"),
}
"""Arms of the package example-robot-data, with the frame that reaches."""

LIBRARY = {"panda": "panda_hand_tcp", "iiwa14": "tool", "gen3": "tool"}


def rail() -> kempe.System:
    """A UR5 on a carriage that slides two metres."""
    m = kempe.Mechanism("rail")
    carriage = m.body("carriage")
    m.prismatic("rail", m.ground, carriage, axis=(1, 0, 0), limits=(-1, 1))
    m.attach(kempe.read("ur5"), to=carriage, prefix="u_")
    return m.build()


def robot(name: str) -> tuple[kempe.System, str]:
    """A system with joints to spare, and its frame; skips where its file is not installed."""
    if name == "rail":
        return rail(), "u_tool"
    if name in LIBRARY:
        return kempe.load(name), LIBRARY[name]
    path, frame = FILES[name]
    if path not in urdf_files():
        pytest.skip("example-robot-data is not installed")
    return kempe.load(urdf_files()[path]), frame


def pinocchio_poses(name: str, system: kempe.System, q: np.ndarray) -> np.ndarray:
    """Poses (N, 4, 4) of the frame of a file by Pinocchio, at configurations (N, nq)."""
    pin = pytest.importorskip("pinocchio")
    path, frame = FILES[name]
    model = pin.buildModelFromUrdf(str(urdf_files()[path]))
    data = model.createData()
    number = model.getFrameId(frame)
    own = {n: i for i, n in enumerate(system.coordinate_names)}
    out = np.empty((len(q), 4, 4))
    for k, x in enumerate(q):
        full = pin.neutral(model)
        for joint, joint_name in zip(model.joints[1:], model.names[1:], strict=True):
            if joint_name in own and joint.nq == 1:
                full[joint.idx_q] = x[own[joint_name]]
            elif joint_name in own:
                full[joint.idx_q : joint.idx_q + 2] = (
                    math.cos(x[own[joint_name]]),
                    math.sin(x[own[joint_name]]),
                )
        pin.framesForwardKinematics(model, data, full)
        out[k] = data.oMf[number].homogeneous
    return out


def configurations(system: kempe.System, rng: np.random.Generator, number: int) -> np.ndarray:
    """Configurations (number, nq) inside the limits: anywhere, half of the joints at a limit, all
    of them, and many at zero, where arms are stretched.
    """
    q = system.random(rng, number)
    low, high = system.structure.limits.T
    ends = np.where(rng.random(q.shape) < 0.5, low, high)
    ends = np.where(np.isfinite(ends), ends, q)
    kind = np.arange(number)[:, None] % 4
    q = np.where((kind == 1) & (rng.random(q.shape) < 0.5) | (kind == 2), ends, q)
    return np.where((kind == 3) & (rng.random(q.shape) < 0.6), np.clip(0.0, low, high), q)


def assert_reached(system, frame, answer, poses, targets, tolerance=1e-8):
    """Every target has a solution inside the limits, and every solution is on its target by `poses`
    (N, K, 4, 4).
    """
    assert answer.mask.any(axis=1).all() and answer.inside.any(axis=1).all()
    off = np.abs(poses - targets[:, None]).max(axis=(-1, -2))
    assert off[answer.mask].max() < tolerance
    chain = answer.plan.lines.v_index
    q = answer.q[answer.inside][:, answer.plan.lines.q_index]
    assert (q >= system.structure.limits[chain, 0]).all() and (
        q <= system.structure.limits[chain, 1]
    ).all()
    for name, value in answer.held.items():
        own = answer.q[..., system.coordinate_names.index(name)]
        turns = (own - value[:, None])[answer.mask] / (2 * PI)
        assert np.abs(turns - np.round(turns)).max() < 1e-9


@pytest.mark.parametrize("name", some([*FILES, *LIBRARY, "rail"], 3))
def test_what_can_be_reached_is_reached(name, hunt):
    """36 to 54 % of these poses have no solution with the last joint held at zero."""
    system, frame = robot(name)
    q = configurations(system, hunt.rng(), hunt.cases(40))
    if name in FILES:
        targets = pinocchio_poses(name, system, q)
        answer = system.ik_all(targets, frame)
        own = np.where(answer.mask[..., None], answer.q, 0.0).reshape(-1, system.nq)
        poses = pinocchio_poses(name, system, own).reshape(*answer.mask.shape, 4, 4)
    else:
        targets = system.fk(q, frame)
        answer = system.ik_all(targets, frame)
        poses = system.fk(np.where(answer.mask[..., None], answer.q, 0.0), frame)
    assert_reached(system, frame, answer, poses, targets)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FILES, *LIBRARY, "rail"])
def test_hunt_what_can_be_reached_is_reached(name, hunt):
    system, frame = robot(name)
    targets = system.fk(configurations(system, hunt.rng(), hunt.cases(1000)), frame)
    answer = system.ik_all(targets, frame)
    poses = system.fk(np.where(answer.mask[..., None], answer.q, 0.0), frame)
    assert_reached(system, frame, answer, poses, targets)


# ---------------------------------------------------------------- random chains

KINDS = (
    "7R",
    "8R",
    "structured 7R",
    "rail 6R",
    "mixed",
    "planar 3R",
    "planar 4R",
    "planar 5R",
    "SCARA and a turn",
)


def random_chain(rng: np.random.Generator, kind: str) -> tuple[kempe.System, list]:
    """A chain with joints to spare, limits about them, and its steps as plain products read them."""
    planar = kind.startswith("planar")
    letters = {"rail 6R": "PRRRRRR", "SCARA and a turn": "RRRPR"}.get(kind)
    if kind == "mixed":
        letters = "".join(rng.permutation(list("RRRRRP" + "RP"[rng.integers(2)])))
    letters = letters or "R" * int(kind[-2])
    m = kempe.Mechanism("chain", dim=2 if planar else 3)
    last = m.ground
    steps = []
    for i, letter in enumerate(letters):
        body = m.body(f"b{i}")
        middle = rng.uniform(-1, 1)
        half = rng.uniform(0.3, PI)
        limits = (middle - half, middle + half) if letter == "R" else (-0.4, 0.5)
        at = tuple(rng.uniform(-0.4, 0.4, 3))
        rpy = tuple(rng.uniform(-PI, PI, 3))
        if planar or kind.startswith("SCARA"):
            at = (rng.uniform(0.1, 0.5) * (i > 0), 0.0, 0.0)
            rpy = (0.0, 0.0, 0.0)
        elif kind.startswith("structured"):
            at = tuple(rng.choice([0.0, 0.0, 0.3, -0.2], 3))
            rpy = tuple(rng.choice([0.0, H, -H, PI / 4], 3))
        turned = {} if planar else {"rpy": rpy}
        m.joint(
            f"j{i}",
            "revolute" if letter == "R" else "prismatic",
            last,
            body,
            at=at[: m.dim],
            limits=None if letter == "R" and rng.random() < 0.15 else limits,
            **turned,
        )
        steps.append((reference.placement(at, rpy).astype(float), letter))
        last = body
    tip = (0.2, 0.1, 0.0) if planar else (0.1, 0.05, 0.2)
    m.frame("tool", last, at=tip[: m.dim])
    steps.append((reference.placement(tip, (0.0, 0.0, 0.0)).astype(float), ""))
    return m.build(), steps


def product(steps: list, q: np.ndarray) -> np.ndarray:
    """Poses (..., 4, 4) of the tip by products of matrices."""
    T = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
    for i, (X, letter) in enumerate(steps):
        T = T @ X
        if letter:
            E = np.broadcast_to(np.eye(4), T.shape).copy()
            c = np.cos(q[..., i])
            s = np.sin(q[..., i])
            if letter == "R":
                E[..., 0, 0], E[..., 0, 1], E[..., 1, 0], E[..., 1, 1] = c, -s, s, c
            else:
                E[..., 2, 3] = q[..., i]
            T = T @ E
    return T


def chains_are_reached(hunt, kind, chains, poses):
    rng = hunt.rng()
    for _ in range(chains):
        system, steps = random_chain(rng, kind)
        q = configurations(system, rng, poses)
        targets = product(steps, q)
        task = "position" if kind == "planar 3R" else "pose"
        answer = system.ik_all(targets, "tool", task=task)
        reached = product(steps, np.where(answer.mask[..., None], answer.q, 0.0))
        if task == "position":
            reached[..., :3, :3] = targets[:, None, :3, :3]
        assert_reached(system, "tool", answer, reached, targets)


@pytest.mark.parametrize("kind", KINDS)
def test_random_chains(kind, hunt):
    chains_are_reached(hunt, kind, hunt.cases(1), 16)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_hunt_random_chains(kind, hunt):
    """Every pose of a configuration inside the limits has a solution inside the limits."""
    chains_are_reached(hunt, kind, hunt.cases(12), 84)


# ---------------------------------------------------------------- what is held, and where


@pytest.mark.parametrize(
    ("name", "held"),
    [
        ("panda", {"panda_joint7"}),
        ("iiwa14", {"q3", "q5"}),
        ("rail", {"rail"}),
        ("pr2", {"torso_lift_joint"}),
        ("tiago", {"torso_lift_joint"}),
        ("centauro", {"torso_yaw"}),
    ],
)
def test_what_is_held(name, held):
    """What leaves a closed form; a rail or a torso that carries an arm; of these what serves most
    poses.
    """
    system, frame = robot(name)
    target = system.fk(system.mid, frame)
    answer = system.ik_all(target, frame)
    assert set(answer.spare) & held and set(answer.held) == set(answer.spare)


def test_values_are_said_and_are_data():
    system, frame = robot("panda")
    q = system.random(3, 40)
    targets = system.fk(q, frame)
    batch = system.ik_all(targets, frame)
    values = batch.held["panda_joint7"]
    assert values.shape == batch.tried.shape == (40,)
    assert (
        (values == 0.0).any()
        and (values != 0.0).any()
        and ((batch.tried > 1) == (values != 0.0)).all()
    )
    assert "one joint to spare" in str(batch) and "'panda_joint7' at 0 for" in str(batch)
    for i in (int(np.argmax(values == 0.0)), int(np.argmax(values != 0.0))):
        one = system.ik_all(targets[i], frame)
        assert one.held == {"panda_joint7": values[i]} and one.tried == batch.tried[i]
        assert f"'panda_joint7' at {values[i]:.6g}" in one.status == batch.status[i]
        assert ("(at 0 there is none inside the limits)" in one.status) == (values[i] != 0.0)
        rows = batch.q[i][batch.mask[i]]
        np.testing.assert_allclose(one.q[np.lexsort(one.q.T)], rows[np.lexsort(rows.T)], atol=1e-9)
    assert not batch.complete.any()


@pytest.mark.slow
def test_a_named_value_stays():
    system, frame = robot("panda")
    targets = system.fk(system.random(3, 40), frame)
    answer = system.ik_all(targets, frame, fixed={"panda_joint7": 0.0})
    assert (
        answer.spare == ()
        and (answer.held["panda_joint7"] == 0.0).all()
        and (answer.tried == 1).all()
    )
    assert 0 < answer.inside.any(axis=1).sum() < 40
    assert "to spare" not in str(answer)
    lost = int(np.argmin(answer.mask.any(axis=1)))
    assert "tried" not in answer.status[lost] and answer.status[lost].startswith("no solution")


def test_some_held_by_name_and_others_by_choice():
    """Values by target; the torso stays where it is said to be."""
    system, frame = robot("tiago")
    q = system.random(1, 30)
    height = q[:, system.coordinate_names.index("torso_lift_joint")]
    answer = system.ik_all(system.fk(q, frame), frame, fixed={"torso_lift_joint": height})
    np.testing.assert_array_equal(answer.held["torso_lift_joint"], height)
    assert len(answer.spare) == 1 and answer.inside.any(axis=1).all()


def test_no_is_evidence_or_a_proof(hunt):
    """Targets outwards, with the same orientation, until there is no solution."""
    system, frame = robot("panda")
    proven = 0
    for q in system.random(hunt.rng(), hunt.cases(6)):
        far = system.fk(q, frame)
        near = system.fk(q, frame)[:3, 3]
        for scale in np.linspace(1.0, 4.0, 101):
            far[:3, 3] = scale * near
            answer = system.ik_all(far, frame)
            if not len(answer):
                break
        assert not len(answer)
        proof = answer.status.startswith("no solution: outside the workspace by at least")
        evidence = (
            "no solution with 'panda_joint7' at any of 64 values tried, and none from 1000 starts "
            "of a search"
        )
        assert proof or answer.tried == 64 and answer.status.startswith(evidence)
        proven += proof
        far[2, 3] = 9.0
        assert system.ik_all(far, frame).status.startswith(
            "no solution: outside the workspace by at least"
        )
    assert proven < hunt.cases(6)


def test_a_thin_interval_of_values():
    """Stretched to the boundary a planar arm has solutions at one value of each joint only."""
    m = kempe.Mechanism("three", dim=2)
    last = m.ground
    for i in range(3):
        body = m.body(f"b{i}")
        m.revolute(f"q{i + 1}", last, body, at=(0.4 * (i > 0), 0), limits=(-3, 3))
        last = body
    m.frame("tip", last, at=(0.3, 0))
    arm = m.build()
    for k, reach in enumerate((1.1, 1.1 - 1e-9, 1.1 - 1e-6, 1.1 - 1e-3)):
        angle = 0.3 + 0.7 * k
        p = reach * np.array([math.cos(angle), math.sin(angle)])
        for turned in (p, (2.0 * p)[:2] / 2.0):
            a = arm.ik_all(turned, "tip", start=[0.0, 0.9, 0.4])
            assert a and np.abs(arm.fk(a.q, "tip")[:, :2, 3] - p).max() < 1e-8, (reach, a.status)


def test_a_length_of_zero_leaves_a_family():
    arm = kempe.load("two_link")
    tip_on_elbow = arm.with_parameters(l2=0.0).ik_all([0.3, 0.4], "e")
    assert tip_on_elbow.status == "no isolated solution, and a family with one freedom: q2 is free"
    elbow_at_base = arm.with_parameters(l1=0.0).ik_all([0.0, 0.4], "e")
    assert "a family with one freedom: q1 + q2 = 1.5708" in elbow_at_base.status


@pytest.mark.parametrize("task", ["position", "orientation", "direction", "position_axis"])
def test_other_tasks_of_redundant_chains(task):
    system, frame = robot("gen3")
    targets = system.fk(configurations(system, np.random.default_rng(8), 24), frame)
    answer = ik_all(system, targets, frame, task=task)
    assert answer.inside.any(axis=1).all(), task


def test_a_sweep_holds_the_others_where_there_is_a_solution():
    """Of two spare joints one is swept; with the other held at zero most targets had no interval."""
    system, frame = robot("pr2")
    targets = system.fk(system.random(5, 4), frame)
    assert all(ik_sweep(system, X, frame, budget=kempe.Budget(points=32)) for X in targets)


@pytest.mark.parametrize("name", ["panda", "iiwa14", "gen3", "ur5"])
def test_values_of_their_own_give_the_same_bits_in_batches(name, hunt):
    """Held by name at arrays, held near configurations, and held elsewhere by choice: as each
    target alone.
    """
    rng = hunt.rng()
    robot = kempe.load(name)
    frame = list(robot.structure.frames)[-1]
    joint = robot.coordinate_names[-1]
    q = robot.random(rng, hunt.cases(30))
    X = robot.fk(q, frame)
    ways = [lambda k: {}, lambda k: {"start": q[k]}, lambda k: {"fixed": {joint: q[k][..., -1]}}]
    for way in ways:
        together = ik_all(robot, X, frame, **way(slice(None)))
        few = ik_all(robot, X[:3], frame, **way(slice(3)))
        assert np.array_equal(few.q, together.q[:3, : few.q.shape[1]], equal_nan=True)
        for i in range(len(X)):
            alone = ik_all(robot, X[i], frame, **way(i))
            assert sorted(map(tuple, alone.q)) == sorted(
                map(tuple, together.q[i][together.mask[i]])
            )


@pytest.mark.parametrize("name", ["panda", "iiwa14", "gen3"])
def test_what_is_held_beyond_its_limits_is_outside(name, hunt):
    """Also where the value less a turn is inside; alone, in a batch, and with values of their own."""
    rng = hunt.rng()
    robot = kempe.load(name)
    frame = list(robot.structure.frames)[-1]
    at = max(i for i in range(robot.nq) if np.isfinite(robot.upper[i]))
    joint = robot.coordinate_names[at]
    X = robot.fk(robot.random(rng, hunt.cases(20)), frame)
    first = robot.lower[at] + 0.1

    def is_reported(answer):
        q = answer.q.reshape(-1, robot.nq)
        inside = answer.inside.reshape(-1)
        truth = ((q >= robot.lower - 1e-9) & (q <= robot.upper + 1e-9)).all(axis=1)
        return np.array_equal(inside, truth)

    for value in (first, first + 2 * math.pi, robot.upper[at] + 0.01):
        batch = ik_all(robot, X, frame, fixed={joint: value})
        assert batch.mask.any()
        assert is_reported(batch)
        assert is_reported(ik_all(robot, X, frame, fixed={joint: np.full(len(X), value)}))
        assert all(is_reported(ik_all(robot, x, frame, fixed={joint: value})) for x in X)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "joint"), [("panda", "panda_joint7"), ("iiwa14", "q3")])
def test_bound_calls_with_held_joints_answer_as_others(name, joint):
    """The second plain call goes by the bound form, one with a start or an unusual value does not."""
    system = kempe.load(name)
    frame = LIBRARY[name]
    at = system.coordinate_names.index(joint)
    for q in system.random(4, 25):
        X = system.fk(q, frame)
        X[:3, 3] *= 1.0 if q[0] > 0.0 else 1.3
        value = float(q[at])
        calls = [
            system.ik_all(X, frame, fixed={joint: value}),
            system.ik_all(X, frame, fixed={joint: value}),
            ik_all(system, X, frame, fixed={joint: np.array(value)}),
        ]
        first = calls[-1]
        for other in calls[:-1]:
            np.testing.assert_array_equal(other.q, first.q)
            np.testing.assert_array_equal(other.inside, first.inside)
            assert str(other) == str(first) and other.complete == first.complete
            assert other.held == first.held
    key = (frame, joint)
    assert key in system._kept["ik_all"]
    bound = system._kept["ik_all"][key]
    assert bound(X, {joint: value}) is not None
    assert bound(X, {joint: system.upper[at] + 0.1}) is None
    beyond = system.ik_all(X, frame, fixed={joint: system.upper[at] + 0.1})
    assert not beyond.inside.any()
    with pytest.raises(kempe.errors.InputError):
        system.ik_all(X, frame, fixed={joint: math.nan})
    with pytest.raises(kempe.errors.InputError):
        system.ik_all(X, frame, fixed=[joint])
