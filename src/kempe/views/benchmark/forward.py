"""Forward model against the peers: batches, single calls, all bodies, threads, growth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kempe.description.mechanism import Mechanism
from kempe.model.system import System
from kempe.views.benchmark import peers
from kempe.views.benchmark.bench import Bench
from kempe.views.benchmark.timing import Case, Row, Table, measure

BATCH = 1_000_000
LOOP = 2_000
"""Poses of one turn of a library that is called once a pose."""
TREE_BATCH = 10_000
LENGTHS = (10, 100, 300, 1000, 10_000)
PINOCCHIO_LONGEST = 300
"""Bodies of the longest chain given to Pinocchio, whose memory grows with the cube of the length."""


def batch(bench: Bench) -> Table:
    """Poses of the arm's hand over a large batch, one thread."""
    arm = bench.arm
    q = arm.random(BATCH)
    some, out = q[:LOOP], np.empty((BATCH, 4, 4))
    query = arm.system.query(arm.frame)
    names = {"query": query, "q": q, "out": out}
    cases = [
        Case("Kempe", f"{BATCH:,} poses into out=", "query(q, out=out, threads=1)", names, BATCH),
        Case("Kempe", "the same, a new array", "query(q, threads=1)", names, BATCH),
    ]
    if "pin" in bench.versions:
        cases.append(_pinocchio_loop(arm, some))
    if "roboticstoolbox-python" in bench.versions:
        names = {"evaluate": peers.toolbox_arm(arm).eval, "q": q[:100_000]}
        cases.append(
            Case("roboticstoolbox", "ETS.eval on a trajectory of 100,000", "evaluate(q)", names, 100_000)
        )
    if "mujoco" in bench.versions:
        cases.append(_mujoco_loop(arm, some))
    if "pytorch-kinematics" in bench.versions:
        cases.append(_torch_batch(arm, q[:10_000]))
    table = Table(
        f"Forward: {arm.frame} of {arm.system.name}, batch, one thread", "ns a pose", measure(cases)
    )
    own, new = table.value("Kempe", f"{BATCH:,}"), table.value("Kempe", "the same")
    table.at_most("into out=, at most 20 ns a pose", own, 20.0)
    table.at_most("a new array, at most 26 ns a pose", new, 26.0)
    table.at_least(
        "into out=, at least 45 times as fast as Pinocchio's loop",
        table.ratio("Pinocchio", "", f"{BATCH:,}"),
        45,
    )
    table.at_least(
        "a new array, at least 35 times as fast as Pinocchio's loop",
        table.ratio("Pinocchio", "", "the same"),
        35,
    )
    table.at_least(
        "at least 25 times as fast as ETS.eval", table.ratio("roboticstoolbox", "", f"{BATCH:,}"), 25
    )
    return table


def _pinocchio_loop(arm: peers.Arm, q: np.ndarray) -> Case:
    import pinocchio as pin

    model, data, frame = peers.pinocchio_arm(arm)
    names = {"fk": pin.forwardKinematics, "update": pin.updateFramePlacement, "model": model, "data": data,
             "frame": frame, "q": list(q), "out": np.empty((len(q), 4, 4))}  # fmt: skip
    code = "for i, row in enumerate(q):\n    fk(model, data, row)\n    out[i] = update(model, data, frame).homogeneous"
    return Case("Pinocchio", f"Python loop over {len(q):,}, pose as array", code, names, len(q))


def _mujoco_loop(arm: peers.Arm, q: np.ndarray) -> Case:
    import mujoco

    model, data = peers.mujoco_model(arm.file)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, arm.frame)  # type: ignore[attr-defined]
    names = {"fk": mujoco.mj_kinematics, "model": model, "data": data, "n": len(arm.links),  # type: ignore[attr-defined]
             "body": body, "q": list(q), "out": np.zeros((len(q), 4, 4))}  # fmt: skip
    code = ("xpos, xmat, qpos = data.xpos, data.xmat, data.qpos\nfor i, row in enumerate(q):\n    qpos[:n] = row\n"
            "    fk(model, data)\n    out[i, :3, 3] = xpos[body]\n    out[i, :3, :3] = xmat[body].reshape(3, 3)")  # fmt: skip
    return Case("MuJoCo", f"Python loop over {len(q):,}, pose as array", code, names, len(q))


def _torch_batch(arm: peers.Arm, q: np.ndarray) -> Case:
    import torch  # type: ignore[import-not-found]

    torch.set_num_threads(1)
    names = {"chain": peers.torch_arm(arm), "q": torch.tensor(q, dtype=torch.float32)}
    call = f"batch of {len(q):,}, float32, eager"
    return Case("pytorch-kinematics", call, "chain.forward_kinematics(q).get_matrix()", names, len(q))


def single(bench: Bench) -> Table:
    """One pose, and one Jacobian, a call."""
    arm = bench.arm
    q = arm.random(1)[0]
    names = {
        "query": arm.system.query(arm.frame),
        "robot": arm.system,
        "frame": arm.frame,
        "q": q,
        "out": np.empty((4, 4)),
    }
    cases = [
        Case("Kempe", "query(q, out=out)", "query(q, out=out)", names),
        Case("Kempe", "query(q), a new array", "query(q)", names),
        Case("Kempe", "robot.fk(q, frame), a new array", "robot.fk(q, frame)", names),
        Case("Kempe", "Jacobian: query.jacobian(q)", "query.jacobian(q)", names),
    ]
    if "pin" in bench.versions:
        cases += _pinocchio_calls(arm, q)
    if "mujoco" in bench.versions:
        cases += _mujoco_calls(arm, q)
    if "roboticstoolbox-python" in bench.versions:
        names = {"ets": peers.toolbox_arm(arm), "q": q}
        cases += [Case("roboticstoolbox", "ETS.eval", "ets.eval(q)", names),
                  Case("roboticstoolbox", "ETS.fkine", "ets.fkine(q)", names),
                  Case("roboticstoolbox", "Jacobian: ETS.jacob0", "ets.jacob0(q)", names)]  # fmt: skip
    if "ikpy" in bench.versions:
        names = {"chain": peers.ikpy_arm(arm), "q": np.array([0.0, *q, 0.0])}
        cases.append(Case("ikpy", "forward_kinematics", "chain.forward_kinematics(q)", names))
    if "pytorch-kinematics" in bench.versions:
        import torch  # type: ignore[import-not-found]

        names = {"chain": peers.torch_arm(arm), "q": torch.tensor(q, dtype=torch.float32)}
        cases.append(
            Case(
                "pytorch-kinematics", "forward_kinematics", "chain.forward_kinematics(q).get_matrix()", names
            )
        )
    table = Table(
        f"Forward: {arm.frame} of {arm.system.name}, one call from Python", "us a call", measure(cases, 1e6)
    )
    _single_goals(table)
    return table


def _single_goals(table: Table) -> None:
    times = {call: table.ratio("Pinocchio", peer, own) for call, peer, own in (
        ("bare", "forward + updateFramePlacement (", "query(q, out"), ("array", "forward + updateFramePlacement, as", "query(q), a"),
        ("jacobian", "Jacobian: forward, frame", "Jacobian"))}  # fmt: skip
    table.at_least("query with out=, not slower than Pinocchio's forward + frame update", times["bare"], 1.0)
    table.at_least(
        "query with a new array, at most 4/3 of Pinocchio with .homogeneous (times its speed)",
        times["array"],
        0.75,
    )
    table.at_least("with Jacobian, faster than Pinocchio (times its speed)", times["jacobian"], 1.0)
    table.at_most("robot.fk(q, frame), under 2 us", table.value("Kempe", "robot.fk"), 2.0)


def _pinocchio_calls(arm: peers.Arm, q: np.ndarray) -> list[Case]:
    import pinocchio as pin

    model, data, frame = peers.pinocchio_arm(arm)
    names = {"fk": pin.forwardKinematics, "update": pin.updateFramePlacement, "model": model, "data": data, "frame": frame,
             "q": q, "jacobians": pin.computeJointJacobians, "read": pin.getFrameJacobian, "one": pin.computeFrameJacobian,
             "axes": pin.ReferenceFrame.LOCAL_WORLD_ALIGNED}  # fmt: skip
    place = "fk(model, data, q); update(model, data, frame)"
    return [
        Case("Pinocchio", "forward + updateFramePlacement (in its data)", place, names),
        Case("Pinocchio", "forward + updateFramePlacement, as array", f"{place}.homogeneous", names),
        Case("Pinocchio", "Jacobian: computeFrameJacobian", "one(model, data, q, frame, axes)", names),
        Case("Pinocchio", "Jacobian: forward, frame and getFrameJacobian",
             "jacobians(model, data, q); update(model, data, frame); read(model, data, frame, axes)", names),
    ]  # fmt: skip


def _mujoco_calls(arm: peers.Arm, q: np.ndarray) -> list[Case]:
    import mujoco

    model, data = peers.mujoco_model(arm.file)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, arm.frame)  # type: ignore[attr-defined]
    names = {"fk": mujoco.mj_kinematics, "model": model, "data": data, "n": len(arm.links), "body": body, "q": q,  # type: ignore[attr-defined]
             "com": mujoco.mj_comPos, "jac": mujoco.mj_jacBody, "J": np.zeros((6, model.nv)), "qpos": data.qpos}  # type: ignore[attr-defined]  # fmt: skip
    return [
        Case("MuJoCo", "mj_kinematics, read one body",
             "qpos[:n] = q; fk(model, data); data.xpos[body], data.xmat[body]", names),
        Case("MuJoCo", "Jacobian: mj_kinematics, mj_comPos, mj_jacBody",
             "qpos[:n] = q; fk(model, data); com(model, data); jac(model, data, J[:3], J[3:], body)", names),
    ]  # fmt: skip


def tree(bench: Bench) -> Table | None:
    """All bodies of a humanoid: one call, and a batch."""
    file = peers.robot_file("talos_full_v2.urdf")
    if file is None:
        bench.say("all bodies of Talos: skipped, the package example-robot-data is not installed")
        return None
    import kempe

    robot = kempe.load(file)
    q = robot.random(1, TREE_BATCH)
    names: dict[str, Any] = {"robot": robot, "q": q[0], "many": q, "out": np.empty((len(robot.body_names), 4, 4)),
                             "outs": np.empty((TREE_BATCH, len(robot.body_names), 4, 4))}  # fmt: skip
    cases = [
        Case("Kempe", "one call into out=", "robot.fk(q, out=out)", names),
        Case("Kempe", "one call, a new array", "robot.fk(q)", names),
        Case(
            "Kempe",
            f"batch of {TREE_BATCH:,} into out=, one thread",
            "robot.fk(many, out=outs, threads=1)",
            names,
            TREE_BATCH,
        ),
    ]
    if "pin" in bench.versions:
        cases += _pinocchio_tree(file)
    if "mujoco" in bench.versions:
        cases.append(_mujoco_tree(file))
    title = f"Forward: all {len(robot.body_names) - 1} bodies of {robot.name} ({robot.nv} degrees of freedom)"
    table = Table(title, "us a configuration", measure(cases, 1e6))
    table.at_least(
        "one call, at least twice as fast as Pinocchio with its export",
        table.ratio("Pinocchio", "one call, joints and", "one call, a"),
        2,
    )
    batched = table.value("Kempe", "batch")
    table.at_most("batch, at most 600 ns a configuration", None if batched is None else batched * 1e3, 600.0)
    return table


def _pinocchio_tree(file: Path) -> list[Case]:
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(file))
    names = {"fk": pin.forwardKinematics, "frames": pin.updateFramePlacements, "model": model, "data": model.createData(),
             "q": pin.neutral(model), "array": np.array}  # fmt: skip
    return [
        Case("Pinocchio", "one call, joints only, in its data", "fk(model, data, q)", names),
        Case("Pinocchio", "one call, joints, as one array",
             "fk(model, data, q); array([X.homogeneous for X in data.oMi])", names),
        Case("Pinocchio", "one call, joints and frames, in its data", "fk(model, data, q); frames(model, data)", names),
        Case("Pinocchio", "one call, joints and frames, as one array",
             "fk(model, data, q); frames(model, data); array([X.homogeneous for X in data.oMf])", names),
    ]  # fmt: skip


def _mujoco_tree(file: Path) -> Case:
    import mujoco

    model, data = peers.mujoco_model(file)
    names = {
        "fk": mujoco.mj_kinematics,
        "model": model,
        "data": data,
        "q": data.qpos.copy(),
        "qpos": data.qpos,
    }  # type: ignore[attr-defined]
    return Case("MuJoCo", "one call, copies of positions and rotations",
                "qpos[:] = q; fk(model, data); data.xpos.copy(), data.xmat.copy()", names)  # fmt: skip


def threads(bench: Bench) -> Table:
    """What a second thread brings."""
    arm = bench.arm
    names = {"query": arm.system.query(arm.frame), "q": arm.random(BATCH), "out": np.empty((BATCH, 4, 4))}
    cases = [
        Case("Kempe", f"{n} thread{'s' * (n > 1)}", f"query(q, out=out, threads={n})", names, BATCH)
        for n in (1, 2)
    ]
    table = Table(
        f"Threads: {arm.frame} of {arm.system.name}, {BATCH:,} poses into out=", "ns a pose", measure(cases)
    )
    table.at_least("two threads, at least 1.7 times one", table.rows[0].value / table.rows[1].value, 1.7)
    return table


def growth(bench: Bench) -> Table:
    """All bodies of chains of revolute joints, by their length."""
    rows: list[Row] = []
    own: list[float] = []
    for n in LENGTHS:
        robot = chain(n)
        names: dict[str, Any] = {"robot": robot, "q": robot.random(1), "out": np.empty((n + 1, 4, 4))}
        cases = [Case("Kempe", f"{n:,} bodies", "robot.fk(q, out=out)", names, n)]
        if "pin" in bench.versions and n <= PINOCCHIO_LONGEST:
            cases.append(_pinocchio_chain(n, robot))
        rows += (measured := measure(cases))
        own.append(measured[0].value)
    rows.sort(key=lambda r: r.library != "Kempe")
    table = Table("Growth: all bodies of a chain, one call", "ns a body", rows, ratios=False)
    table.at_most(
        f"{LENGTHS[-1]:,} bodies, at most twice the time a body of {LENGTHS[1]:,}", own[-1] / own[1], 2.0
    )
    return table


def chain(n: int) -> System:
    """A chain of n revolute joints with axes in turn."""
    out = Mechanism(f"chain of {n}")
    previous = out.ground
    for i in range(n):
        body = out.body(f"b{i}")
        out.revolute(f"j{i}", previous, body, at=(0.1, 0.0, 0.02), axis=((0, 0, 1), (0, 1, 0))[i % 2])
        previous = body
    return out.build()


def _pinocchio_chain(n: int, robot: System) -> Case:
    import pinocchio as pin

    model = pin.Model()
    parent = 0
    for i in range(n):
        kind = (pin.JointModelRZ(), pin.JointModelRY())[i % 2]
        parent = model.addJoint(parent, kind, pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.02])), f"j{i}")
    names = {"fk": pin.forwardKinematics, "model": model, "data": model.createData(), "q": robot.random(1)}
    return Case("Pinocchio", f"{n:,} bodies, in its data", "fk(model, data, q)", names, n)
