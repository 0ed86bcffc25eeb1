"""Arms with a joint to spare: paths, sets of solutions and derivatives, beside what users would
write themselves.
"""

from __future__ import annotations

import numpy as np

import kempe
from kempe_bench.bench import Bench
from kempe_bench.timing import Table, cases, measure

TARGETS = 200
"""Targets of the path, a circle."""
RADIUS = 0.1
VALUES = 64
BATCH = 10_000

PATH = "ik_path, a target of a circle"
LOOP = "ik(start=previous), a target of the circle"
HELD = "ik_all, a joint held, one call"
DERIVATIVE = "derivative of a batch, a target"


def _follow(robot: kempe.System, frame: str, targets: np.ndarray, q: np.ndarray) -> None:
    for target in targets:
        q = robot.ik(target, frame, start=q).q


def paths_and_sets(bench: Bench) -> Table:
    """A path, the set of solutions of a pose, and derivatives of answers."""
    robot = kempe.load("panda")
    frame = "panda_hand_tcp"
    joint = robot.joint_names[6]
    start = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.8])
    angle = np.linspace(0.0, 2.0 * np.pi, TARGETS)
    circle = np.tile(robot.fk(start, frame), (TARGETS, 1, 1))
    circle[:, 0, 3] += RADIUS * (np.cos(angle) - 1.0)
    circle[:, 1, 3] += RADIUS * np.sin(angle)
    q = robot.random(0, BATCH)
    answer = robot.ik(robot.fk(q, frame), frame, start=q)
    names = {
        "robot": robot,
        "frame": frame,
        "circle": circle,
        "start": start,
        "target": circle[0],
        "held": {joint: float(start[6])},
        "many": np.broadcast_to(circle[0], (VALUES, 4, 4)),
        "values": {joint: np.linspace(robot.lower[6], robot.upper[6], VALUES)},
        "sweep": robot.inverse.sweep(circle[0], frame),
        "answer": answer,
        "follow": _follow,
        "np": np,
        "derive": answer._row.derive,
    }
    calls = [
        (PATH, "robot.ik_path(circle, frame, start)", TARGETS),
        (LOOP, "follow(robot, frame, circle, start)", TARGETS),
        (HELD, "robot.ik_all(target, frame, fixed=held)"),
        (
            f"ik_all, {VALUES} values of a joint, a value",
            "robot.ik_all(many, frame, fixed=values)",
            VALUES,
        ),
        ("sweep, all intervals", "robot.inverse.sweep(target, frame)"),
        ("best of a sweep", "sweep.best()"),
        (DERIVATIVE, "derive(answer)", BATCH),
    ]
    own = (
        "jacobian and inverse of a batch, a target",
        "J = robot.jacobian(answer.q, frame); J.swapaxes(1, 2) @ np.linalg.inv(J @ J.swapaxes(1, 2))",
        BATCH,
    )
    rows = measure([*cases("Kempe", names, *calls), *cases("NumPy", names, own)], 1e6)
    table = Table(
        f"Redundant arm: {frame} of {robot.name}, paths and sets", "us", rows, ratios=False
    )
    table.at_most(f"{PATH}, at most 60 us", table.best("Kempe", PATH), 60.0)
    table.at_most(f"{HELD}, at most 5 us", table.best("Kempe", HELD), 5.0)
    table.at_most(f"{DERIVATIVE}, at most 1.5 us", table.best("Kempe", DERIVATIVE), 1.5)
    table.remarks.append(
        "a sweep finds where solutions merge and where joints meet limits to 1e-10; values of a "
        "joint in a grid do not"
    )
    return table
