"""Libraries that solve the inverse model numerically, with the same chain, with restarts and a time
limit.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.numeric_robots import BASE, TIP

TOLERANCE = 1e-6
"""Largest position error [m] and rotation angle [rad] of a success."""
LIMIT = 0.05
"""Seconds that a library may spend on a target."""
ATTEMPT = 30
STEPS = 15
"""Iterations of a start, and steps of a start by libraries that give velocities."""
DAMPING = 1e-2
"""Levenberg and Marquardt's factor of libraries that give velocities: of 1e-6 to 1 the one with the
best times."""
REGULARISED = 1e-6
"""Weight of placo's regularisation."""
BASE_AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
"""Coordinates of placo's floating base."""
MANY = 1_000_000
"""As many starts as the time allows."""


class Solver:
    """The inverse model by one library; making it is the preparation of the robot.

    `ready` makes a library's own kind of targets, `solve` is what is timed: a configuration (n,)
    for a target and a start (n,), or None where the library says that it found none.
    """

    seedless = False
    """Whether the library needs no start, so that it gets one only where the start is near the
    answer."""
    slow = False
    """Whether the library solves one set of targets only."""

    def __init__(self, arm: peers.Arm):
        raise NotImplementedError

    def ready(self, targets: Array) -> Sequence[Any]:
        """The library's targets, one for each pose (n, 4, 4)."""
        return list(targets)

    def solve(self, target: Any, start: Array | None) -> Any:
        """What the library answers to one target."""
        raise NotImplementedError

    def read(self, answer: Any) -> Array:
        """The configuration (n,) in an answer."""
        return np.asarray(answer)


class Kempe(Solver):
    """Kempe, by its one public call."""

    seedless = True

    def __init__(self, arm: peers.Arm):
        self.system = arm.system

    def solve(self, target: Any, start: Array | None) -> Any:
        """One public call."""
        solution = self.system.ik(target, TIP, start=start)
        return solution.q if solution.success else None


class OptIK(Solver):
    """OptIK: sequential quadratic programming with restarts in Rust; its goal is the squared norm
    of the error.
    """

    def __init__(self, arm: peers.Arm):
        optik = peers.module("optik")
        self.robot = optik.Robot.from_urdf_file(str(arm.file), BASE, TIP)
        self.robot.set_parallelism(1)
        self.config = optik.SolverConfig(
            "speed", max_time=LIMIT, max_restarts=MANY, tol_f=TOLERANCE**2
        )

    def solve(self, target: Any, start: Array | None) -> Any:
        """One public call."""
        answer = self.robot.ik(self.config, target, start)
        return None if answer is None else answer[0]


class TracIK(Solver):
    """TRAC-IK (Beeson and Ames, 2015), two threads; its tolerance is one of each component, not of
    the norm.
    """

    def __init__(self, arm: peers.Arm):
        self.module = peers.module("pytracik")
        self.limits = arm.limits
        speed = self.module.SolveType.Speed
        text = arm.file.read_text(encoding="utf-8")
        self.robot = self.module.TRAC_IK(BASE, TIP, text, LIMIT, TOLERANCE / np.sqrt(3.0), speed)

    def ready(self, targets: Array) -> Sequence[Any]:
        """Positions and quaternions."""
        from scipy.spatial.transform import Rotation

        quat_xyzw = Rotation.from_matrix(targets[:, :3, :3]).as_quat()
        return np.concatenate([targets[:, :3, 3], quat_xyzw], axis=1).tolist()

    def solve(self, target: Any, start: Array | None) -> Any:
        """One public call, whose first number says how it went."""
        answer = self.module.ik(self.robot, start, *target)
        return answer[1:] if answer[0] >= 0 else None

    def read(self, answer: Any) -> Array:
        """It keeps the limits in single precision."""
        return np.clip(answer, *self.limits.T)


class Toolbox(Solver):
    """roboticstoolbox, its C++ Levenberg-Marquardt with restarts, whose residual is half the
    squared norm.
    """

    seedless = True

    def __init__(self, arm: peers.Arm):
        self.chain = peers.toolbox_arm(arm)

    def solve(self, target: Any, start: Array | None) -> Any:
        """One public call."""
        answer = self.chain.ik_LM(
            target, q0=start, tol=0.5 * TOLERANCE**2, slimit=100, method="chan", k=0.1
        )
        return answer.q if answer.success else None


class RoboPlan(Solver):
    """RoboPlan's SimpleIk: damped pseudoinverse with restarts in C++, collision checks off."""

    def __init__(self, arm: peers.Arm):
        core = peers.module("roboplan.core")
        simple = peers.module("roboplan.simple_ik")
        text = arm.file.read_text(encoding="utf-8")
        scene = core.Scene("benchmark", core.loadUrdfSceneDescriptionFromXml(text))
        scene.addGroupFromChain("chain", BASE, TIP)
        options = simple.SimpleIkOptions(
            "chain",
            max_iters=ATTEMPT,
            max_time=LIMIT,
            max_restarts=MANY,
            step_size=1.0,
            damping=1e-6,
            max_linear_error_norm=TOLERANCE,
            max_angular_error_norm=TOLERANCE,
            check_collisions=False,
        )
        self.core = core
        self.scene = scene
        self.robot = simple.SimpleIk(scene, options)
        self.names = scene.getJointGroupInfo("chain").joint_names

    def ready(self, targets: Array) -> Sequence[Any]:
        """Goals."""
        return [self.core.CartesianConfiguration(BASE, TIP, np.asfortranarray(X)) for X in targets]

    def solve(self, target: Any, start: Array | None) -> Any:
        """One public call."""
        out = self.core.JointConfiguration(self.names, start)
        found = self.robot.solveIk(target, self.core.JointConfiguration(self.names, start), out)
        return out.positions if found else None


class Restarted(Solver):
    """A library without restarts of its own: it starts again at random until it succeeds or the
    time is over.
    """

    limits: Array
    """Bounds (n, 2)."""

    def attempt(self, target: Any, start: Array) -> Any:
        """A configuration from one start, or None."""
        raise NotImplementedError

    def solve(self, target: Any, start: Array | None) -> Any:
        """The first attempt that succeeds."""
        end = time.perf_counter() + LIMIT
        random = np.random.default_rng(1)
        q = self.attempt(target, np.asarray(start))
        while q is None and time.perf_counter() < end:
            q = self.attempt(target, random.uniform(*self.limits.T))
        return q


class Klampt(Restarted):
    """Klampt: Newton with step limits at the joint limits."""

    def __init__(self, arm: peers.Arm):
        klampt = peers.module("klampt")
        self.ik = peers.module("klampt.model.ik")
        self.world = klampt.WorldModel()
        self.robot = self.world.loadRobot(str(arm.file))
        self.link = self.robot.link(TIP)
        self.limits = arm.limits
        # the first links are those of a floating base, which is left alone
        self.columns = [self.robot.link(f"body{i + 1}").getIndex() for i in range(len(arm.links))]
        self.whole = np.zeros(self.robot.numLinks())
        self.solver = klampt.IKSolver(self.robot)
        self.solver.setActiveDofs(self.columns)
        self.solver.setMaxIters(ATTEMPT)
        self.solver.setTolerance(TOLERANCE / np.sqrt(3.0))

    def ready(self, targets: Array) -> Sequence[Any]:
        """Objectives."""
        return [
            self.ik.objective(self.link, R=X[:3, :3].T.ravel().tolist(), t=X[:3, 3].tolist())
            for X in targets
        ]

    def attempt(self, target: Any, start: Array) -> Any:
        """One solve."""
        self.whole[self.columns] = start
        self.robot.setConfig(self.whole.tolist())
        self.solver.clear()
        self.solver.add(target)
        return np.array(self.robot.getConfig())[self.columns] if self.solver.solve() else None


class Steps(Restarted):
    """A library that gives the velocity to a target: steps until the errors are small, at most
    `STEPS` of them.
    """

    configuration: Any
    task: Any
    options: dict[str, Any]
    """Arguments of its `solve_ik`."""
    solve_ik: Any
    failures: tuple[type[BaseException], ...]
    """What it raises when a step has no solution."""

    def read(self, answer: Any) -> Array:
        """Steps end at a limit up to the rounding of the quadratic program."""
        return np.clip(answer, *self.limits.T)

    def attempt(self, target: Any, start: Array) -> Any:
        """Steps from one start."""
        self.task.set_target(target)
        self.configuration.update(start)
        for _ in range(STEPS):
            try:
                v = self.solve_ik(self.configuration, [self.task], 1.0, **self.options)
            except self.failures:
                return None
            self.configuration.integrate_inplace(v, 1.0)
            e = self.task.compute_error(self.configuration)
            if e[:3] @ e[:3] <= TOLERANCE**2 and e[3:] @ e[3:] <= TOLERANCE**2:
                return self.configuration.q
        return None


class Mink(Steps):
    """mink: a quadratic program for each step, on MuJoCo."""

    def __init__(self, arm: peers.Arm):
        mink = peers.module("mink")
        model, _ = peers.mujoco_model(arm.file)
        self.SE3 = mink.SE3
        self.solve_ik = mink.solve_ik
        self.configuration = mink.Configuration(model)
        self.task = mink.FrameTask(
            TIP, "body", position_cost=1.0, orientation_cost=1.0, lm_damping=DAMPING
        )
        bounds = [mink.ConfigurationLimit(model, gain=1.0)]
        self.options = {"solver": "daqp", "damping": 1e-9, "limits": bounds}
        self.limits = arm.limits
        self.failures = mink.NoSolutionFound, mink.NotWithinConfigurationLimits

    def ready(self, targets: Array) -> Sequence[Any]:
        """Poses."""
        return [self.SE3.from_matrix(X) for X in targets]


class Pink(Steps):
    """pink: a quadratic program for each step, on Pinocchio."""

    def __init__(self, arm: peers.Arm):
        pin = peers.module("pinocchio")
        pink = peers.module("pink")
        model = pin.buildModelFromUrdf(str(arm.file))
        self.SE3 = pin.SE3
        self.solve_ik = pink.solve_ik
        self.configuration = pink.Configuration(model, model.createData(), pin.neutral(model))
        self.task = pink.FrameTask(TIP, position_cost=1.0, orientation_cost=1.0, lm_damping=DAMPING)
        bounds = [peers.module("pink.limits").ConfigurationLimit(model, config_limit_gain=1.0)]
        self.options = {"solver": "daqp", "damping": 1e-9, "limits": bounds}
        self.limits = arm.limits
        failures = peers.module("pink.exceptions")
        self.failures = failures.NoSolutionFound, failures.NotWithinConfigurationLimits

    def ready(self, targets: Array) -> Sequence[Any]:
        """Poses."""
        return [self.SE3(X) for X in targets]


class Placo(Restarted):
    """placo: a quadratic program for each step, on Pinocchio 3, with a floating base that is held."""

    def __init__(self, arm: peers.Arm):
        placo = peers.module("placo")
        self.robot = placo.RobotWrapper(str(arm.file), placo.Flags.ignore_collisions)
        self.solver = placo.KinematicsSolver(self.robot)
        self.solver.mask_fbase(True)
        self.solver.enable_joint_limits(True)
        self.solver.add_regularization_task(REGULARISED)
        self.task = self.solver.add_frame_task(TIP, np.eye(4))
        self.task.configure(TIP, "soft", 1.0, 1.0)
        self.limits = arm.limits

    def read(self, answer: Any) -> Array:
        """Steps end at a limit up to the rounding of the quadratic program."""
        return np.clip(answer, *self.limits.T)

    def attempt(self, target: Any, start: Array) -> Any:
        """Steps from one start."""
        self.task.T_world_frame = target
        self.robot.state.q = np.concatenate([BASE_AT_REST, start])
        self.robot.update_kinematics()
        for _ in range(STEPS):
            try:
                self.solver.solve(True)
            except RuntimeError:
                return None
            self.robot.update_kinematics()
            if _near(self.robot.get_T_world_frame(TIP), target):
                return np.array(self.robot.state.q[len(BASE_AT_REST) :])
        return None


class Drake(Restarted):
    """Drake: SNOPT on three points of the frame, as bounds on an angle are squared there and cannot
    be that small.
    """

    slow = True
    POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).T

    def __init__(self, arm: peers.Arm):
        self.plant = peers.module("pydrake.multibody.plant").MultibodyPlant(0.0)
        peers.module("pydrake.multibody.parsing").Parser(self.plant).AddModels(str(arm.file))
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName(BASE))
        self.plant.Finalize()
        self.ik = peers.module("pydrake.multibody.inverse_kinematics").InverseKinematics
        solvers = peers.module("pydrake.solvers")
        self.snopt = solvers.SnoptSolver()
        self.options = solvers.SolverOptions()
        for key, value in (("Major feasibility tolerance", 1e-8), ("Major iterations limit", 100)):
            self.options.SetOption(self.snopt.solver_id(), key, value)
        self.limits = arm.limits

    def ready(self, targets: Array) -> Sequence[Any]:
        """Places of the points."""
        return [X[:3, :3] @ self.POINTS + X[:3, 3:] for X in targets]

    def attempt(self, target: Any, start: Array) -> Any:
        """One program."""
        program = self.ik(self.plant)
        frame = self.plant.GetFrameByName(TIP)
        world = self.plant.world_frame()
        for point, place in zip(self.POINTS.T, target.T, strict=True):
            program.AddPositionConstraint(frame, point, world, place - 1e-7, place + 1e-7)
        answer = self.snopt.Solve(program.prog(), start, self.options)
        return answer.GetSolution(program.q()) if answer.is_success() else None


class Ikpy(Restarted):
    """ikpy: least squares of SciPy, judged by a forward pass of its own; it is interrupted, as it
    can last.
    """

    slow = True

    def __init__(self, arm: peers.Arm):
        self.chain = peers.ikpy_arm(arm)
        self.limits = arm.limits
        signal.signal(signal.SIGALRM, self._stop)

    def _stop(self, *_: Any) -> None:
        raise TimeoutError

    def solve(self, target: Any, start: Array | None) -> Any:
        """The first attempt that succeeds before the time is over."""
        signal.setitimer(signal.ITIMER_REAL, LIMIT)
        try:
            return super().solve(target, start)
        except TimeoutError:
            return None
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def attempt(self, target: Any, start: Array) -> Any:
        """One fit."""
        first = np.concatenate([[0.0], start, [0.0]])
        q = self.chain.inverse_kinematics_frame(
            target, initial_position=first, orientation_mode="all"
        )
        return q[1:-1] if _near(self.chain.forward_kinematics(q), target) else None


def _near(X: Array, target: Array) -> bool:
    """Whether a library may stop at a pose; ||A - B|| is sqrt(2) times a small angle between
    rotations.
    """
    miss = X - target
    p = miss[:3, 3]
    R = miss[:3, :3].ravel()
    return bool(p @ p <= TOLERANCE**2 and R @ R <= 2.0 * TOLERANCE**2)


KEMPE = "kempe"
SOLVERS: dict[str, tuple[str, type[Solver]]] = {
    KEMPE: ("Kempe", Kempe),
    "optik-py": ("OptIK", OptIK),
    "pytracik": ("TRAC-IK", TracIK),
    "roboticstoolbox-python": ("roboticstoolbox", Toolbox),
    "roboplan": ("RoboPlan", RoboPlan),
    "klampt": ("Klampt", Klampt),
    "mink": ("mink", Mink),
    "pin-pink": ("pink", Pink),
    "placo": ("placo", Placo),
    "drake": ("Drake", Drake),
    "ikpy": ("ikpy", Ikpy),
}
"""Title and class of each library, by package."""
