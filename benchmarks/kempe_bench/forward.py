"""Forward model of an arm against the peers: a batch, one call, threads."""

from __future__ import annotations

import numpy as np

from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.timing import Case, Table, cases, measure

BATCH = 1_000_000
TRAJECTORY = 100_000
LOOP = 2_000
"""Poses of one turn of a library that is called once a pose."""

_PINOCCHIO_LOOP = """
for i, row in enumerate(q):
    fk(model, data, row)
    out[i] = update(model, data, frame).homogeneous
"""

_MUJOCO_LOOP = """
xpos, xmat, qpos = data.xpos, data.xmat, data.qpos
for i, row in enumerate(q):
    qpos[:n] = row
    fk(model, data)
    out[i, :3, 3] = xpos[body]
    out[i, :3, :3] = xmat[body].reshape(3, 3)
"""


def batch(bench: Bench) -> Table:
    """Poses of the arm's hand over a large batch, one thread."""
    arm = bench.arm
    q = arm.random(BATCH)
    names = {"query": arm.system.query(arm.frame), "q": q, "out": np.empty((BATCH, 4, 4))}
    own = f"{BATCH:,} poses into out="
    new = f"{BATCH:,} poses, a new array"
    timed = cases(
        "Kempe",
        names,
        (own, "query(q, out=out, threads=1)", BATCH),
        (new, "query(q, threads=1)", BATCH),
    )
    loop = f"Python loop over {LOOP:,}, pose as array"
    rows = {"q": list(q[:LOOP]), "out": np.zeros((LOOP, 4, 4))}
    if "pin" in bench.versions:
        timed += cases("Pinocchio", _pinocchio(arm) | rows, (loop, _PINOCCHIO_LOOP, LOOP))
    if "roboticstoolbox-python" in bench.versions:
        names = {"ets": peers.toolbox_arm(arm), "q": q[:TRAJECTORY]}
        call = f"ETS.eval on a trajectory of {TRAJECTORY:,}"
        timed += cases("roboticstoolbox", names, (call, "ets.eval(q)", TRAJECTORY))
    if "mujoco" in bench.versions:
        timed += cases("MuJoCo", _mujoco(arm) | rows, (loop, _MUJOCO_LOOP, LOOP))
    if "pytorch-kinematics" in bench.versions:
        timed += _torch(arm, q[:10_000], "batch of 10,000, float32, eager")
    table = Table(
        f"Forward: {arm.frame} of {arm.system.name}, batch, one thread", "ns a pose", measure(timed)
    )
    table.at_most("into out=, at most 20 ns a pose", table.best("Kempe", own), 20)
    table.at_most("a new array, at most 26 ns a pose", table.best("Kempe", new), 26)
    table.at_least(
        "into out=, at least 45 times as fast as Pinocchio's loop",
        table.ratio("Pinocchio", loop, own),
        45,
    )
    table.at_least(
        "a new array, at least 35 times as fast as it", table.ratio("Pinocchio", loop, new), 35
    )
    table.at_least(
        "at least 25 times as fast as ETS.eval", table.ratio("roboticstoolbox", "ETS.eval", own), 25
    )
    return table


def single(bench: Bench) -> Table:
    """One pose, and one Jacobian, a call."""
    arm = bench.arm
    q = arm.random(1)[0]
    given = {"q": q}
    query = arm.system.query(arm.frame)
    names = {
        "query": query,
        "robot": arm.system,
        "frame": arm.frame,
        "out": np.empty((4, 4)),
    } | given
    timed = cases(
        "Kempe",
        names,
        ("query(q, out=out)", "query(q, out=out)"),
        ("query(q), a new array", "query(q)"),
        ("robot.fk(q, frame), a new array", "robot.fk(q, frame)"),
        ("Jacobian: query.jacobian(q)", "query.jacobian(q)"),
    )
    if "pin" in bench.versions:
        place = "fk(model, data, q); update(model, data, frame)"
        read = "read(model, data, frame, axes)"
        timed += cases(
            "Pinocchio",
            _pinocchio(arm) | given,
            ("forward and frame update, in its data", place),
            ("forward and frame update, as array", f"{place}.homogeneous"),
            ("Jacobian: computeFrameJacobian", "one(model, data, q, frame, axes)"),
            (
                "Jacobian: all joints, frame update, read",
                f"all(model, data, q); update(model, data, frame); {read}",
            ),
        )
    if "mujoco" in bench.versions:
        place = "qpos[:n] = q; fk(model, data)"
        read = "com(model, data); jac(model, data, J[:3], J[3:], body)"
        timed += cases(
            "MuJoCo",
            _mujoco(arm) | given,
            ("mj_kinematics, read a body", f"{place}; data.xpos[body], data.xmat[body]"),
            ("Jacobian: mj_kinematics, mj_comPos, mj_jacBody", f"{place}; {read}"),
        )
    if "roboticstoolbox-python" in bench.versions:
        names = {"ets": peers.toolbox_arm(arm)} | given
        calls = (
            ("ETS.eval", "ets.eval(q)"),
            ("ETS.fkine", "ets.fkine(q)"),
            ("Jacobian: ETS.jacob0", "ets.jacob0(q)"),
        )
        timed += cases("roboticstoolbox", names, *calls)
    if "ikpy" in bench.versions:
        names = {"chain": peers.ikpy_arm(arm), "q": np.array([0.0, *q, 0.0])}
        timed += cases("ikpy", names, ("forward_kinematics", "chain.forward_kinematics(q)"))
    if "pytorch-kinematics" in bench.versions:
        timed += _torch(arm, q[None], "forward_kinematics, float32, eager")
    table = Table(
        f"Forward: {arm.frame} of {arm.system.name}, one call", "us a call", measure(timed, 1e6)
    )
    _single_goals(table)
    return table


def _single_goals(table: Table) -> None:
    update = "forward and frame update"
    bare = table.ratio("Pinocchio", f"{update}, in its data", "query(q, out=out)")
    array = table.ratio("Pinocchio", f"{update}, as array", "query(q), a new array")
    jacobian = table.ratio("Pinocchio", "Jacobian: all joints", "Jacobian: query")
    table.at_least(
        "query(q, out=out), at least as fast as Pinocchio's forward and frame update", bare, 1
    )
    table.at_least("query(q), at least 3/4 as fast as Pinocchio's pose as array", array, 0.75)
    table.at_least("with Jacobian, at least as fast as Pinocchio", jacobian, 1)
    table.at_most("robot.fk(q, frame), under 2 us", table.best("Kempe", "robot.fk"), 2)


def threads(bench: Bench) -> Table:
    """What a second thread brings."""
    arm = bench.arm
    names = {
        "query": arm.system.query(arm.frame),
        "q": arm.random(BATCH),
        "out": np.empty((BATCH, 4, 4)),
    }
    calls = [
        (f"{n} thread{'s' * (n > 1)}", f"query(q, out=out, threads={n})", BATCH) for n in (1, 2)
    ]
    title = f"Threads: {arm.frame} of {arm.system.name}, {BATCH:,} poses into out="
    table = Table(title, "ns a pose", measure(cases("Kempe", names, *calls)))
    one = table.best("Kempe", "1 thread")
    two = table.best("Kempe", "2 threads")
    assert one is not None and two is not None, "Kempe takes part in every run"
    table.at_least("two threads, at least 1.7 times as fast", one / two, 1.7)
    return table


def _pinocchio(arm: peers.Arm) -> dict:
    """Names for statements that call Pinocchio."""
    pin = peers.module("pinocchio")
    model, data, frame = peers.pinocchio_arm(arm)
    return {
        "model": model,
        "data": data,
        "frame": frame,
        "fk": pin.forwardKinematics,
        "update": pin.updateFramePlacement,
        "all": pin.computeJointJacobians,
        "read": pin.getFrameJacobian,
        "one": pin.computeFrameJacobian,
        "axes": pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
    }


def _mujoco(arm: peers.Arm) -> dict:
    """Names for statements that call MuJoCo."""
    mujoco = peers.module("mujoco")
    model, data = peers.mujoco_model(arm.file)
    return {
        "model": model,
        "data": data,
        "qpos": data.qpos,
        "n": len(arm.links),
        "J": np.zeros((6, model.nv)),
        "body": mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, arm.frame),
        "fk": mujoco.mj_kinematics,
        "com": mujoco.mj_comPos,
        "jac": mujoco.mj_jacBody,
    }


def _torch(arm: peers.Arm, q: np.ndarray, call: str) -> list[Case]:
    torch = peers.module("torch")
    torch.set_num_threads(1)
    names = {"chain": peers.torch_arm(arm), "q": torch.tensor(q, dtype=torch.float32)}
    return cases(
        "pytorch-kinematics", names, (call, "chain.forward_kinematics(q).get_matrix()", len(q))
    )
