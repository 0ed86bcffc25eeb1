"""Libraries that solve the inverse model of a whole body, each given the same robot, the same
start, the same goals.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import kempe
from kempe import tasks
from kempe.inverse.tasks.demands import STARTS
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.whole_robots import BASE, Body, mujoco_body, pinocchio_body

COARSE = (1e-4, 1e-3)
FINE = (1e-6, 1e-6)
"""Largest errors of a success in metres and radians: as in published comparisons, and as Kempe has
it."""
LIMIT = 0.1
"""Seconds after which a library that is started again gives up a target."""
STEPS = 20
STEPS_ONCE = 100
"""Steps of a start: of 20, 40 and 100 the number with the least time for a success, and that with
most successes."""
DAMPING = 1e-2
"""Levenberg and Marquardt's factor of libraries that give velocities: of 1e-6 to 1 the one with the
most successes."""
LEAST = 1e-9
"""Smallest damping."""


class WholeBody:
    """The inverse model of a body by one library, which is started again at random until it
    succeeds, or `once` only.

    Goals (n, frames or frames + 1, 4, 4) are poses of the frames, then a pose at the centre of
    mass, if it is held. `solve` is what is timed: a library's own configuration for a goal and a
    start (7 + joints,), or None.
    """

    seedless = False
    """Whether the library needs no start, so that it gets one only where all have one start."""
    coarse = False
    """Whether the library can only be requested the coarser errors."""
    place: np.ndarray
    """Where each of our coordinates is in the library's own."""

    def __init__(self, body: Body, mass: bool, tolerance: tuple[float, float], once: bool):
        self.body = body
        self.mass = mass
        self.tolerance = tolerance
        self.once = once
        self.limits = body.limits
        self.names = body.names
        self.steps = STEPS_ONCE if once else STEPS
        self.prepare()

    def prepare(self) -> None:
        """Tell the library the robot."""
        raise NotImplementedError

    def ready(self, goals: Array) -> Sequence[Any]:
        """The library's goals."""
        return list(goals)

    def attempt(self, goal: Any, start: Array) -> Any:
        """A configuration from one start (7 + joints,), or None."""
        raise NotImplementedError

    def solve(self, goal: Any, start: Array | None) -> Any:
        """The first attempt that succeeds; later ones start with joints anywhere inside the limits."""
        end = time.perf_counter() + LIMIT
        begin = np.asarray(start)
        q = self.attempt(goal, begin)
        random = np.random.default_rng(1)
        while q is None and not self.once and time.perf_counter() < end:
            q = self.attempt(goal, np.concatenate([begin[:BASE], random.uniform(*self.limits.T)]))
        return q

    def own(self, q: Array) -> Array:
        """Our coordinates q (7 + joints,) as the library's."""
        out = np.empty(len(q))
        out[self.place] = q
        return out

    def read(self, answer: Any) -> Array:
        """Our coordinates of an answer; steps end at a limit up to the rounding of a quadratic
        program.
        """
        q = np.asarray(answer)[self.place]
        return np.concatenate([q[:BASE], np.clip(q[BASE:], *self.limits.T)])


class Kempe(WholeBody):
    """Kempe, by its one public call."""

    seedless = True

    def prepare(self) -> None:
        """Nothing more than to load it."""
        self.system = self.body.system
        self.place = np.arange(BASE + len(self.names))
        self.starts = 1 if self.once else STARTS

    def solve(self, goal: Any, start: Array | None) -> Any:
        """One public call, tasks and all."""
        held: list[tasks.Task] = [
            tasks.Pose(name, X) for name, X in zip(self.body.frames, goal, strict=False)
        ]
        if self.mass:
            held.append(tasks.CentreOfMass(goal[-1, :3, 3]))
        answer = self.system.ik(
            held, start=start, tolerance=self.tolerance, budget=kempe.Budget(starts=self.starts)
        )
        return answer.q if answer.success else None


class Steps(WholeBody):
    """A library that gives the velocity to its tasks: steps until all errors are small, at most
    `steps` of them.
    """

    configuration: Any
    held: list[Any]
    """Its tasks: the frames', then that of the centre of mass."""
    options: dict[str, Any]
    """Arguments of its `solve_ik`."""
    solve_ik: Any
    failures: tuple[type[BaseException], ...]
    """What it raises when a step has no solution."""

    def attempt(self, goal: Any, start: Array) -> Any:
        """Steps from one start."""
        for task, target in zip(self.held, goal, strict=True):
            task.set_target(target)
        self.configuration.update(self.own(start))
        for _ in range(self.steps):
            try:
                v = self.solve_ik(self.configuration, self.held, 1.0, **self.options)
            except self.failures:
                return None
            self.configuration.integrate_inplace(v, 1.0)
            if self.near():
                return self.configuration.q.copy()
        return None

    def near(self) -> bool:
        """Whether all errors are small enough."""
        linear, angular = self.tolerance
        for task in self.held:
            e = task.compute_error(self.configuration)
            if e[:3] @ e[:3] > linear**2 or e[3:] @ e[3:] > angular**2:
                return False
        return True


class Mink(Steps):
    """mink: a quadratic program for each step, on MuJoCo."""

    def prepare(self) -> None:
        """Tasks without a goal."""
        mink = peers.module("mink")
        model, self.place = mujoco_body(self.body)
        self.SE3 = mink.SE3
        self.solve_ik = mink.solve_ik
        self.configuration = mink.Configuration(model)
        self.held = [
            mink.FrameTask(name, "body", 1.0, 1.0, lm_damping=DAMPING) for name in self.body.frames
        ]
        if self.mass:
            self.held.append(mink.ComTask(1.0, lm_damping=DAMPING))
        self.options = {
            "solver": "daqp",
            "damping": LEAST,
            "limits": [mink.ConfigurationLimit(model, gain=1.0)],
        }
        self.failures = mink.NoSolutionFound, mink.NotWithinConfigurationLimits

    def ready(self, goals: Array) -> Sequence[Any]:
        """Poses, then the position of the centre."""
        n = len(self.body.frames)
        return [[*(self.SE3.from_matrix(X) for X in goal[:n]), *goal[n:, :3, 3]] for goal in goals]


class Pink(Steps):
    """pink: a quadratic program for each step, on Pinocchio."""

    def prepare(self) -> None:
        """Tasks without a goal."""
        pin = peers.module("pinocchio")
        pink = peers.module("pink")
        model, self.place = pinocchio_body(self.body)
        self.SE3 = pin.SE3
        self.solve_ik = pink.solve_ik
        self.configuration = pink.Configuration(model, model.createData(), pin.neutral(model))
        self.held = [
            pink.FrameTask(name, 1.0, 1.0, lm_damping=DAMPING) for name in self.body.frames
        ]
        if self.mass:
            self.held.append(pink.tasks.ComTask(1.0, lm_damping=DAMPING))
        bounds = [peers.module("pink.limits").ConfigurationLimit(model, config_limit_gain=1.0)]
        self.options = {"solver": "daqp", "damping": LEAST, "limits": bounds}
        failures = peers.module("pink.exceptions")
        self.failures = failures.NoSolutionFound, failures.NotWithinConfigurationLimits

    def ready(self, goals: Array) -> Sequence[Any]:
        """Poses, then the position of the centre."""
        n = len(self.body.frames)
        return [[*(self.SE3(X) for X in goal[:n]), *goal[n:, :3, 3]] for goal in goals]


class Newton(WholeBody):
    """Damped Newton steps written in numpy on Pinocchio's frames and Jacobians, cut at the limits.

    Joints at a limit that a step pushes further are left out of it, once (an active set of two
    passes).
    """

    def prepare(self) -> None:
        """The model, where its limits are, and the rows of the equations."""
        self.pin = peers.module("pinocchio")
        self.model, self.place = pinocchio_body(self.body)
        self.data = self.model.createData()
        self.axes = self.pin.ReferenceFrame.LOCAL
        self.frames = [self.model.getFrameId(name) for name in self.body.frames]
        self.at_q = np.array([j.idx_q for j in self.model.joints if j.nq == 1])
        self.at_v = np.array([j.idx_v for j in self.model.joints if j.nq == 1])
        self.bounds = (
            self.model.lowerPositionLimit[self.at_q],
            self.model.upperPositionLimit[self.at_q],
        )
        rows = 6 * len(self.frames) + 3 * self.mass
        self.e = np.empty(rows)
        self.J = np.empty((rows, self.model.nv))

    def ready(self, goals: Array) -> Sequence[Any]:
        """Poses, then the position of the centre."""
        n = len(self.frames)
        return [
            ([self.pin.SE3(X) for X in goal[:n]], goal[-1, :3, 3] if self.mass else None)
            for goal in goals
        ]

    def attempt(self, goal: Any, start: Array) -> Any:
        """Steps from one start."""
        q = self.own(start)
        linear = self.tolerance[0] ** 2
        angular = self.tolerance[1] ** 2
        for _ in range(self.steps + 1):
            e = self.equations(goal, q)
            if all(
                x[:3] @ x[:3] <= linear and x[3:] @ x[3:] <= angular
                for x in np.split(e, range(6, len(e), 6))
            ):
                return q
            q = self.pin.integrate(self.model, q, self.step(q, self.J, e))
            q[self.at_q] = np.clip(q[self.at_q], *self.bounds)
        return None

    def equations(self, goal: Any, q: Array) -> Array:
        """Errors (rows,); their Jacobian is `J` then."""
        pin = self.pin
        model = self.model
        data = self.data
        if self.mass:
            self.J[-3:] = pin.jacobianCenterOfMass(model, data, q)
            self.e[-3:] = data.com[0] - goal[1]
        pin.computeJointJacobians(model, data, q)
        for i, (frame, target) in enumerate(zip(self.frames, goal[0], strict=True)):
            miss = target.actInv(pin.updateFramePlacement(model, data, frame))
            self.e[6 * i : 6 * i + 6] = pin.log6(miss).vector
            self.J[6 * i : 6 * i + 6] = pin.Jlog6(miss) @ pin.getFrameJacobian(
                model, data, frame, self.axes
            )
        return self.e

    def step(self, q: Array, J: Array, e: Array) -> Array:
        """The damped step of least norm, taken again without the joints that it pushes out."""
        free = np.ones(self.model.nv)
        v = np.zeros(self.model.nv)
        for _ in range(2):
            A = (J * free) @ J.T
            A.flat[:: len(A) + 1] += DAMPING * (e @ e) + LEAST
            v = -free * (J.T @ np.linalg.solve(A, e))
            x = q[self.at_q] + v[self.at_v]
            free[self.at_v[(x < self.bounds[0]) | (x > self.bounds[1])]] = 0.0
            if free.all():
                break
        return v


class Drake(WholeBody):
    """Drake: SNOPT on bounds of positions and angles; the square of an angle is bounded, which
    cannot be small.
    """

    coarse = True

    def prepare(self) -> None:
        """The plant and the solver."""
        self.plant = peers.module("pydrake.multibody.plant").MultibodyPlant(0.0)
        peers.module("pydrake.multibody.parsing").Parser(self.plant).AddModels(str(self.body.file))
        self.plant.Finalize()
        self.kinematics = peers.module("pydrake.multibody.inverse_kinematics")
        joints = [self.plant.get_joint(i) for i in self.plant.GetJointIndices()]
        at = next(j.position_start() for j in joints if j.num_positions() == BASE)
        first = {j.name(): j.position_start() for j in joints}
        self.place = np.array(
            [*(at + k for k in (4, 5, 6, 0, 1, 2, 3)), *(first[name] for name in self.names)]
        )
        self.context = self.plant.CreateDefaultContext()
        self.rotation = peers.module("pydrake.math").RotationMatrix
        solvers = peers.module("pydrake.solvers")
        self.snopt = solvers.SnoptSolver()
        self.options = solvers.SolverOptions()
        for key, value in (("Major feasibility tolerance", 1e-7), ("Major iterations limit", 100)):
            self.options.SetOption(self.snopt.solver_id(), key, value)

    def ready(self, goals: Array) -> Sequence[Any]:
        """Positions and rotations of the frames, and the centre."""
        n = len(self.body.frames)
        return [
            (
                [(X[:3, 3], self.rotation(X[:3, :3])) for X in goal[:n]],
                goal[-1, :3, 3] if self.mass else None,
            )
            for goal in goals
        ]

    def attempt(self, goal: Any, start: Array) -> Any:
        """One program."""
        program = self.kinematics.InverseKinematics(self.plant)
        world = self.plant.world_frame()
        slack = 0.5 * self.tolerance[0]
        angle = 0.9 * self.tolerance[1]
        origin = np.zeros(3)
        for name, (p, R) in zip(self.body.frames, goal[0], strict=True):
            frame = self.plant.GetFrameByName(name)
            program.AddPositionConstraint(frame, origin, world, p - slack, p + slack)
            program.AddOrientationConstraint(world, R, frame, self.rotation(), angle)
        if self.mass:
            low = goal[1] - slack
            high = goal[1] + slack
            held = self.kinematics.ComInPolyhedronConstraint(
                self.plant, None, world, np.eye(3), low, high, self.context
            )
            program.prog().AddConstraint(held, program.q())
        answer = self.snopt.Solve(program.prog(), self.own(start), self.options)
        return answer.GetSolution(program.q()) if answer.is_success() else None


KEMPE = "kempe"
BODIES: dict[str, tuple[str, type[WholeBody]]] = {
    KEMPE: ("Kempe", Kempe),
    "mink": ("mink", Mink),
    "pin-pink": ("pink", Pink),
    "pin": ("Pinocchio", Newton),
    "drake": ("Drake", Drake),
}
"""Title and class of each library, by package."""


def prepared(
    package: str,
    file: Path,
    frames: Sequence[str],
    mass: bool,
    tolerance: Sequence[float],
    once: bool,
) -> WholeBody:
    """A library given the robot of a file, and what is required of it."""
    linear, angular = tolerance
    return BODIES[package][1](Body(file, tuple(frames)), mass, (linear, angular), once)
