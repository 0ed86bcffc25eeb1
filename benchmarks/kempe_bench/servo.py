"""Steps of a servo loop: one cycle towards a moving pose, within limits of position and speed."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from kempe import tasks
from kempe.description.urdf_writer import write_urdf
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.timing import Case, Grid, measure

CYCLE = 0.01
"""Seconds of one cycle."""
SPEED = 3.0
"""Largest speed of every joint, rad/s."""
RADIUS = 0.05
TARGETS = 200
"""A circle of so many poses, one a cycle, which returns to its start."""
FAR = 3.0
"""Metres by which the target is moved out of reach."""


class Stream:
    """A loop that asks for one pose after the other; `step` is one cycle."""

    q: Array

    def __init__(self, start: Array, targets: list[Any]):
        self.start = start
        self.targets = targets
        self.k = 0

    def next_target(self) -> Any:
        """The next pose of the circle."""
        self.k = (self.k + 1) % len(self.targets)
        return self.targets[self.k]


class KempeStream(Stream):
    """`ik_step` from configuration to configuration."""

    def __init__(self, arm: peers.Arm, start: Array, targets: Array):
        super().__init__(start, list(targets))
        self.system = arm.system
        self.frame = arm.frame
        self.q = start

    def step(self) -> None:
        """One cycle."""
        self.q = self.system.ik_step(
            self.q, self.next_target(), self.frame, CYCLE, velocity_limits=SPEED
        ).q


class KempeTaskStream(KempeStream):
    """`ik_step` of tasks: the hand's position, and the starting posture in what that leaves."""

    def step(self) -> None:
        """One cycle."""
        wanted = [
            tasks.Position(self.frame, self.next_target()[:3, 3]),
            tasks.Posture(q=self.start, weight=1.0, priority=1),
        ]
        self.q = self.system.ik_step(self.q, wanted, dt=CYCLE, velocity_limits=SPEED).q


class MinkStream(Stream):
    """mink: a quadratic program for each cycle by daqp, on MuJoCo."""

    turns = 1.0
    """Cost of the orientation."""

    def __init__(self, arm: peers.Arm, start: Array, targets: Array):
        mink = peers.module("mink")
        mujoco = peers.module("mujoco")
        super().__init__(start, [mink.SE3.from_matrix(X) for X in targets])
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "arm.urdf"  # without fingers
            file.write_text(write_urdf(arm.system.mechanism), encoding="utf-8")
            model, _ = peers.mujoco_model(file)
        self.configuration = mink.Configuration(model)
        self.configuration.update(start)
        self.solve = mink.solve_ik
        self.task = mink.FrameTask(
            arm.frame, "body", position_cost=1.0, orientation_cost=self.turns, lm_damping=1e-3
        )
        self.tasks = [self.task]
        joints = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, i) for i in range(model.njnt)]
        limits = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, dict.fromkeys(joints, SPEED)),
        ]
        self.options = {"solver": "daqp", "damping": 1e-6, "limits": limits}

    def step(self) -> None:
        """One cycle."""
        self.task.set_target(self.next_target())
        v = self.solve(self.configuration, self.tasks, CYCLE, **self.options)
        self.configuration.integrate_inplace(v, CYCLE)


class MinkTaskStream(MinkStream):
    """mink with a position and a posture of small cost: it has no strict priorities here."""

    turns = 0.0

    def __init__(self, arm: peers.Arm, start: Array, targets: Array):
        super().__init__(arm, start, targets)
        posture = peers.module("mink").PostureTask(self.configuration.model, cost=1e-2)
        posture.set_target(start)
        self.tasks.append(posture)


def stream(bench: Bench) -> Grid:
    """One cycle towards poses on a circle, poses out of reach, and positions beside a posture."""
    arm = bench.arm
    s = arm.system
    start = np.clip(s.mid + 0.3, s.lower, s.upper)
    near = np.tile(s.fk(start, arm.frame), (TARGETS, 1, 1))
    t = np.arange(1, TARGETS + 1) * 2.0 * math.pi / TARGETS
    near[:, 0, 3] += RADIUS * (np.cos(t) - 1.0)
    near[:, 1, 3] += RADIUS * np.sin(t)
    far = near.copy()
    far[:, 0, 3] += FAR
    table = Grid(f"Servo loop: one cycle of {s.name} towards a pose", "us")
    pose: dict[str, Any] = {"Kempe": KempeStream}
    both: dict[str, Any] = {"Kempe": KempeTaskStream}
    if "mink" in bench.versions:
        pose["mink"] = MinkStream
        both["mink"] = MinkTaskStream
    timed = [
        Case(name, call, "loop.step()", {"loop": make(arm, start, targets)})
        for call, targets, loops in (
            ("poses on a circle", near, pose),
            ("poses out of reach", far, pose),
            ("position and posture", near, both),
        )
        for name, make in loops.items()
    ]
    table.rows += measure(timed, 1e6)
    table.remarks.append(
        f"cycles of {CYCLE} s, joints up to {SPEED:g} rad/s and within their limits; mink: daqp, "
        "limits of position and speed, the posture with a cost of 0.01 in place of a lower priority"
    )
    return table
