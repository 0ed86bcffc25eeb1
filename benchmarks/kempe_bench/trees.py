"""Forward model of all bodies against the peers: a humanoid, and chains of growing length."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kempe.description.mechanism import Mechanism
from kempe.system import System
from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.timing import Case, Row, Table, cases, measure

BATCH = 10_000
LENGTHS = (10, 100, 300, 1000, 10_000)
PINOCCHIO_LONGEST = 300
"""Bodies of the longest chain given to Pinocchio, whose memory grows with the cube of the
length."""


def humanoid(bench: Bench) -> Table | None:
    """All bodies of a humanoid: one call, and a batch."""
    import kempe

    file = peers.robot_file("talos_full_v2.urdf")
    if file is None:
        bench.say("  skipped: the package example-robot-data is not installed")
        return None
    robot = kempe.load(file)
    k = len(robot.body_names)
    q = robot.random(1, BATCH)
    out = {"out": np.empty((k, 4, 4)), "outs": np.empty((BATCH, k, 4, 4))}
    batch = f"batch of {BATCH:,} into out=, one thread"
    timed = cases(
        "Kempe",
        out | {"robot": robot, "q": q[0], "many": q},
        ("one call, a new array", "robot.fk(q)"),
        ("one call into out=", "robot.fk(q, out=out)"),
        (batch, "robot.fk(many, out=outs, threads=1)", BATCH),
    )
    if "pin" in bench.versions:
        timed += _pinocchio(file)
    if "mujoco" in bench.versions:
        timed += _mujoco(file)
    title = f"Forward: all {k - 1} bodies of {robot.name} ({robot.nv} degrees of freedom)"
    table = Table(title, "us a configuration", measure(timed, 1e6))
    exported = table.ratio("Pinocchio", "joints and frames, as", "one call, a new")
    table.at_least("one call, at least twice as fast as Pinocchio with its export", exported, 2)
    table.at_most("batch, at most 0.6 us a configuration", table.best("Kempe", batch), 0.6)
    return table


def _pinocchio(file: Path) -> list[Case]:
    pin = peers.module("pinocchio")
    model = pin.buildModelFromUrdf(str(file))
    names = {
        "model": model,
        "data": model.createData(),
        "q": pin.neutral(model),
        "array": np.array,
        "fk": pin.forwardKinematics,
        "frames": pin.updateFramePlacements,
    }
    joints = "fk(model, data, q)"
    frames = "fk(model, data, q); frames(model, data)"
    return cases(
        "Pinocchio",
        names,
        ("joints only, in its data", joints),
        ("joints and frames, in its data", frames),
        ("joints only, as one array", f"{joints}; array([X.homogeneous for X in data.oMi])"),
        ("joints and frames, as one array", f"{frames}; array([X.homogeneous for X in data.oMf])"),
    )


def _mujoco(file: Path) -> list[Case]:
    model, data = peers.mujoco_model(file)
    names = {
        "fk": peers.module("mujoco").mj_kinematics,
        "model": model,
        "data": data,
        "q": data.qpos.copy(),
    }
    code = "data.qpos[:] = q; fk(model, data); data.xpos.copy(), data.xmat.copy()"
    return cases("MuJoCo", names, ("copies of positions and rotations", code))


def growth(bench: Bench) -> Table:
    """All bodies of chains of revolute joints, by their length."""
    rows: list[Row] = []
    for n in LENGTHS:
        robot = chain(n)
        names = {"robot": robot, "q": robot.random(1), "out": np.empty((n + 1, 4, 4))}
        timed = cases("Kempe", names, (f"{n:,} bodies", "robot.fk(q, out=out)", n))
        if "pin" in bench.versions and n <= PINOCCHIO_LONGEST:
            timed += _pinocchio_chain(n, robot)
        rows += measure(timed)
    rows.sort(key=lambda r: r.library != "Kempe")
    table = Table("Growth: all bodies of a chain, one call", "ns a body", rows, ratios=False)
    long, short = (table.best("Kempe", f"{n:,} bodies") for n in (LENGTHS[-1], LENGTHS[1]))
    assert long is not None and short is not None, "Kempe takes part in every run"
    table.at_most(
        f"a body of {LENGTHS[-1]:,} costs at most twice one of {LENGTHS[1]:,}", long / short, 2
    )
    return table


def chain(n: int) -> System:
    """A chain of n revolute joints with axes in turn."""
    out = Mechanism(f"chain of {n}")
    previous = out.ground
    for i in range(n):
        body = out.body(f"b{i}")
        out.revolute(
            f"j{i}", previous, body, at=(0.1, 0.0, 0.02), axis=((0, 0, 1), (0, 1, 0))[i % 2]
        )
        previous = body
    return out.build()


def _pinocchio_chain(n: int, robot: System) -> list[Case]:
    pin = peers.module("pinocchio")
    model = pin.Model()
    parent = 0
    for i in range(n):
        kind = (pin.JointModelRZ(), pin.JointModelRY())[i % 2]
        parent = model.addJoint(
            parent, kind, pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.02])), f"j{i}"
        )
    names = {
        "fk": pin.forwardKinematics,
        "model": model,
        "data": model.createData(),
        "q": robot.random(1),
    }
    return cases("Pinocchio", names, (f"{n:,} bodies, in its data", "fk(model, data, q)", n))
