"""Libraries that give all solutions of the inverse model of six turns, each given an arm in its own
way.
"""

from __future__ import annotations

import importlib.util
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kempe.errors import UnsupportedError
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.analytic_arms import Arm, Chain
from kempe_bench.analytic_forms import chain_of, decomposed, dh_table, opw_parameters


class Solver:
    """All solutions by one library; making it is the preparation of the robot. Errors:
    `UnsupportedError`.

    `ready` makes a library's own kind of target, `call` is what is timed, `read` makes answers (k,
    6) of what it gave, in the coordinates of `chain`, which the library may describe itself.
    Answers that the library marks as least squares are no answers.
    """

    chain: Chain
    slow = False
    """Whether the library gets few poses."""
    batches = False
    """Whether the library takes many poses in one call."""

    def ready(self, targets: Array) -> Sequence[Any]:
        """The library's targets, one for each pose (n, 4, 4)."""
        return list(targets)

    def __init__(self, arm: Arm):
        raise NotImplementedError

    def call(self, target: Any, /) -> Any:
        """What the library answers to one target."""
        raise NotImplementedError

    def read(self, answer: Any) -> Array:
        """Configurations (k, 6) in an answer."""
        raise NotImplementedError

    def ready_batch(self, targets: Array) -> Any:
        """The library's form of many targets (n, 4, 4)."""
        return targets

    def call_batch(self, targets: Any, /) -> Any:
        """What the library answers to many targets, in one thread."""
        raise NotImplementedError

    def read_batch(self, answer: Any) -> Sequence[Array]:
        """Configurations (k, 6) for each target of a batch."""
        raise NotImplementedError


class Eaik(Solver):
    """EAIK, given the poses of the joints: it finds out the family by itself (Ostermeier and
    others, 2024).
    """

    batches = True

    def __init__(self, arm: Arm):
        self.chain = arm.chain
        robot = peers.module("eaik.IK_Homogeneous").HomogeneousRobot(self.chain.frames)
        if not robot.hasKnownDecomposition():
            raise UnsupportedError(f"EAIK: {robot.getKinematicFamily()}")
        self.robot = robot

    def call(self, target: Any, /) -> Any:
        """Configurations, and which of them are least squares."""
        answer = self.robot.IK(target)
        return answer.Q, answer.is_LS

    def read(self, answer: Any) -> Array:
        """Exact ones."""
        q, least = answer
        return np.reshape(q, (-1, 6))[~np.asarray(least, dtype=bool)]

    def call_batch(self, targets: Any, /) -> Any:
        """A list of the library's answers."""
        return self.robot.IK_batched(targets, 1)

    def read_batch(self, answer: Any) -> Sequence[Array]:
        """Exact ones."""
        return [self.read((a.Q, a.is_LS)) for a in answer]


class IkGeo(Solver):
    """ik-geo of its authors (Elias and Wen, 2022), whose user says which family the arm belongs to."""

    def __init__(self, arm: Arm):
        self.chain = arm.chain
        self.family, h, p = decomposed(self.chain)
        self.robot = getattr(peers.module("ik_geo").Robot, self.family)(h, p)
        self.home = self.chain.frames[-1, :3, :3]

    def ready(self, targets: Array) -> Sequence[Any]:
        """Rotations of the tool from its place at q = 0, by columns as this package reads them, and
        positions.
        """
        turns = np.swapaxes(targets[:, :3, :3] @ self.home.T, -1, -2)
        return list(
            zip(np.ascontiguousarray(turns), np.ascontiguousarray(targets[:, :3, 3]), strict=True)
        )

    def call(self, target: Any, /) -> Any:
        """Configurations, each with whether it is least squares."""
        return self.robot.get_ik(*target)

    def read(self, answer: Any) -> Array:
        """Exact ones."""
        return np.reshape([q for q, least in answer if not least], (-1, 6))


class Opw(Solver):
    """py-opw-kinematics: arms with ortho-parallel basis and spherical wrist (Brandstoetter and
    others, 2014).
    """

    batches = True

    def __init__(self, arm: Arm):
        self.chain = arm.chain
        opw = peers.module("py_opw_kinematics")
        numbers, self.ways, self.zeros, self.base, self.tool = opw_parameters(self.chain)
        self.robot = opw.Robot(opw.KinematicModel(**numbers), degrees=False)

    def _targets(self, targets: Array) -> Any:
        place = peers.module("scipy.spatial.transform").RigidTransform
        return place.from_matrix(self.base @ targets @ self.tool)

    def ready(self, targets: Array) -> Sequence[Any]:
        """Poses in scipy's class, of the tool on the base that the library assumes."""
        return [X for X in self._targets(targets)]

    def call(self, target: Any, /) -> Any:
        """A list of configurations."""
        return self.robot.inverse(target)

    def read(self, answer: Any) -> Array:
        """In the arm's own directions and zeros."""
        return self.zeros + self.ways * np.reshape(answer, (-1, 6))

    def ready_batch(self, targets: Array) -> Any:
        """All poses in one object."""
        return self._targets(targets)

    def call_batch(self, targets: Any, /) -> Any:
        """Eight slots for each pose, with margins that the library computes beside them."""
        return self.robot.reach(targets)

    def read_batch(self, answer: Any) -> Sequence[Array]:
        """The slots that hold numbers."""
        return [self.read(q[~np.isnan(q[:, 0])]) for q in answer.joints]


class Ssik(Solver):
    """ssik: a module written for the arm, as by its command `build`, or the one that comes with it.

    The latter describes the arm by itself, so that it is requested, and judged by, poses of its
    own.
    """

    slow = True

    def __init__(self, arm: Arm):
        self.chain = arm.chain
        if arm.prebuilt:
            robot = peers.module("ssik").Manipulator.from_prebuilt(arm.prebuilt)
            self.chain = chain_of(robot.kinbody)
            self.solve = robot.solve
        else:
            robot = peers.module("ssik").Manipulator.from_transforms(
                np.array([*self.chain.X, self.chain.tool])
            )
            if robot.solver_name == "ikgeo.general_6r":
                raise UnsupportedError("ssik would prepare this arm for a minute or more")
            self.solve = self._written(robot, arm).solve

    def _written(self, robot: Any, arm: Arm) -> Any:
        name = "ssik_" + "".join(c if c.isalnum() else "_" for c in arm.title.lower())
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{name}.py"
            peers.module("ssik.core.codegen").emit_artifact(
                kb=robot.kinbody, plan=robot.dispatch_plan, module_name=name, output_path=str(file)
            )
            spec = importlib.util.spec_from_file_location(name, file)
            assert spec is not None and spec.loader is not None
            out = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(out)
        return out

    def call(self, target: Any, /) -> Any:
        """A list of solutions."""
        return self.solve(target, respect_limits=False)

    def read(self, answer: Any) -> Array:
        """All of them."""
        return np.reshape([s.q for s in answer], (-1, 6))


class Toolbox(Solver):
    """roboticstoolbox's analytic inverse model, derived with sympy; arms are tables in the standard
    convention.
    """

    slow = True

    def __init__(self, arm: Arm):
        self.chain = arm.chain
        toolbox = peers.module("roboticstoolbox")
        rows, self.zeros, self.base, self.tool = dh_table(self.chain)
        links = [toolbox.RevoluteDH(a=a, alpha=alpha, d=d) for a, alpha, d in rows]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                self.solver = toolbox.DHRobot(links).analytic_ik()
            except (ValueError, NotImplementedError) as error:
                raise UnsupportedError(f"roboticstoolbox: {error}") from None

    def ready(self, targets: Array) -> Sequence[Any]:
        """Poses of the last frame of the table in its first."""
        return list(self.base @ targets @ self.tool)

    def call(self, target: Any, /) -> Any:
        """The library's answer."""
        return self.solver.solve(target, joint_limits=False)

    def read(self, answer: Any) -> Array:
        """In the arm's own zeros."""
        return np.reshape(answer.q, (-1, 6)) - self.zeros


SOLVERS: dict[str, tuple[str, type[Solver]]] = {
    "EAIK": ("EAIK", Eaik),
    "ik-geo": ("ik-geo", IkGeo),
    "ssik": ("ssik", Ssik),
    "py-opw-kinematics": ("OPW", Opw),
    "roboticstoolbox-python": ("roboticstoolbox", Toolbox),
}
"""Name in the tables and class by package."""
