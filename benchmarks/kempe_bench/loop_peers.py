"""Assembly with libraries that have a solver of their own: Drake's inverse kinematics, Exudyn's
static solver.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from kempe import spatial
from kempe.errors import UnsupportedError
from kempe.kernels.forward.table_layout import BALL, TURN
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.loop_solvers import Assembler
from kempe_bench.loop_trees import Link, Tree, worst


class Drake(Assembler):
    """Drake's inverse kinematics solved by SNOPT: a point of one side of each cut held at its place
    on the other.

    SNOPT scales its equations: where 1e-9 is requested, 1e-7 is usual, so that answers are judged
    less strictly.
    """

    tolerance = 1e-5
    slow = True

    def __init__(self, tree: Tree, known: Iterable[str] = ()):
        self.tree = tree
        plant, frames, self.first = drake_plant(tree)
        kinematics = peers.module("pydrake.multibody.inverse_kinematics").InverseKinematics
        self.plant = plant
        self.ik = kinematics(plant, with_joint_limits=False)
        for cut in tree.cuts:
            for point in tree.points(cut):
                a, b = ((X @ np.append(point, 1.0))[:3] for X in (cut.X_a, cut.X_b))
                slack = np.array([0.0, 0.0, np.inf if tree.system.dim == 2 else 0.0])
                self.ik.AddPositionConstraint(frames[cut.b], b, frames[cut.a], a - slack, a + slack)
        self.program = self.ik.prog()
        self.variables = self.ik.q()
        self._hold(known)
        solvers = peers.module("pydrake.solvers")
        self.solver = solvers.SnoptSolver()
        self.options = solvers.SolverOptions()
        self.options.SetOption(self.solver.solver_id(), "Major feasibility tolerance", 1e-9)

    def _hold(self, known: Iterable[str]) -> None:
        columns = {self.tree.columns[name] for name in known}
        home = self.ready(self.tree.system.q("closed")[None])[0]
        for move, i in zip(self.tree.moves, self.first, strict=True):
            if move.column in columns:
                self.program.AddBoundingBoxConstraint(home[i], home[i], self.variables[i])

    def ready(self, q: Array) -> Sequence[Array]:
        """Drake's coordinates, ball joints by roll, pitch and yaw."""
        x = self.tree.coordinates(q)
        out = np.empty((len(q), self.plant.num_positions()))
        for move, i, j in zip(self.tree.moves, self.first, self.tree.firsts, strict=False):
            if move.kind == BALL:
                out[:, i : i + 3] = spatial.matrix_to_rpy(
                    spatial.quat_wxyz_to_matrix(x[:, j : j + 4])
                )
            else:
                out[:, i] = x[:, j]
        return list(out)

    def call(self, guess: Array, /) -> Array:
        """Coordinates found from the guess."""
        return self.solver.Solve(self.program, guess, self.options).GetSolution(self.variables)

    def opening(self, answers: Sequence[Array]) -> Array:
        """Of the cut joints; the others cannot open."""
        y = np.array(answers)
        x = np.empty((len(y), self.tree.nx))
        for move, i, j in zip(self.tree.moves, self.first, self.tree.firsts, strict=False):
            if move.kind == BALL:
                x[:, j : j + 4] = spatial.matrix_to_quat_wxyz(
                    spatial.rpy_to_matrix(y[:, i : i + 3])
                )
            else:
                x[:, j] = y[:, i]
        return self.tree.opening(x)


def drake_plant(tree: Tree) -> tuple[Any, list[Any], list[int]]:
    """The tree as a Drake plant, the frames of its bodies, and where the coordinates of its moves
    begin.
    """
    tree_module = peers.module("pydrake.multibody.tree")
    plants = peers.module("pydrake.multibody.plant")
    place = peers.module("pydrake.math").RigidTransform
    plant = plants.MultibodyPlant(0.0)
    inertia = tree_module.SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    frames = [plant.world_frame()]
    joints = []
    for limb in tree.limbs:
        offset = tree_module.FixedOffsetFrame(
            f"{limb.name}_before", frames[limb.parent], place(limb.before)
        )
        here = plant.AddFrame(offset)
        for move in limb.moves:
            body = plant.AddRigidBody(move.name, inertia).body_frame()
            if move.kind == BALL:
                joint = tree_module.BallRpyJoint(move.name, here, body)
            else:
                kind = (
                    tree_module.RevoluteJoint if move.kind == TURN else tree_module.PrismaticJoint
                )
                joint = kind(move.name, here, body, np.eye(3)[move.axis])
            joints.append(plant.AddJoint(joint))
            here = body
        frames.append(
            plant.AddFrame(tree_module.FixedOffsetFrame(limb.name, here, place(limb.after)))
        )
    plant.Finalize()
    return plant, frames, [joint.position_start() for joint in joints]


class Exudyn(Assembler):
    """Exudyn's static solver without loads: a body's pose each, and all joints as equations.

    Coordinates: in the plane x, y and angle of each body; in space position and quaternion less the
    identity.
    """

    slow = True
    HELD = {
        "revolute": (1, 1, 1, 1, 1, 0),
        "prismatic": (1, 1, 0, 1, 1, 1),
        "universal": (1, 1, 1, 0, 0, 1),
    }
    """What joints hold, in axes of F: slides, then turns."""

    def __init__(self, tree: Tree, q: Array | None = None):
        system = tree.system
        self.exudyn = peers.module("exudyn")
        self.exudyn.config.printToConsole = False
        self.system = system
        self.planar = system.dim == 2
        self.tree = tree
        self.container = self.exudyn.SystemContainer()
        self.bodies = self.container.AddSystem()
        self._describe(peers.module("exudyn.itemInterface"))
        self.bodies.Assemble()
        self.initial = self.exudyn.ConfigurationType.Initial
        self.current = self.exudyn.ConfigurationType.Current
        self.settings = self._settings()
        if q is not None:
            self.bodies.systemData.SetODE2Coordinates(
                self.ready(q[None])[0], configuration=self.initial
            )

    def _describe(self, items: Any) -> None:
        add = self.bodies.AddObject
        planar = self.planar
        numbers = [add(items.ObjectGround())]
        for _ in self.system.body_names[1:]:
            if planar:
                node = self.bodies.AddNode(items.NodeRigidBody2D())
                numbers.append(add(items.ObjectRigidBody2D(mass=1.0, inertia=1.0, nodeNumber=node)))
            else:
                node = self.bodies.AddNode(
                    items.NodeRigidBodyEP(referenceCoordinates=[0, 0, 0, 1, 0, 0, 0])
                )
                numbers.append(
                    add(
                        items.ObjectRigidBody(mass=1.0, inertia=[1, 1, 1, 0, 0, 0], nodeNumber=node)
                    )
                )
        for link in self.tree.links.values():
            sides = ((link.a, link.X_a), (link.b, link.X_b))
            self._join(
                items,
                link,
                {"markerNumbers": [self._marker(items, numbers[i], X) for i, X in sides]},
            )

    def _marker(self, items: Any, body: int, X: Array) -> int:
        """A place on a body; in the plane its axes are those of the joint, which does not read the
        place's.
        """
        at = (
            {"localPosition": list(X[:3, 3])}
            if self.planar
            else {"localHT": np.ascontiguousarray(X)}
        )
        return self.bodies.AddMarker(items.MarkerBodyRigid(bodyNumber=body, **at))

    def _join(self, items: Any, link: Link, ends: dict[str, Any]) -> None:
        add = self.bodies.AddObject
        kind = link.joint.type.type_name
        if kind == "spherical":
            add(items.ObjectJointSpherical(**ends))
        elif self.planar and kind == "revolute":
            add(items.ObjectJointRevolute2D(**ends))
        elif self.planar and kind == "prismatic":
            normal = np.cross([0.0, 0.0, 1.0], link.X_b[:3, 2])
            add(
                items.ObjectJointPrismatic2D(
                    axisMarker0=list(link.X_a[:3, 2]), normalMarker1=list(normal), **ends
                )
            )
        elif kind in self.HELD:
            add(items.ObjectJointGeneric(constrainedAxes=list(self.HELD[kind]), **ends))
        else:
            raise UnsupportedError(
                f"{self.system.name}: {kind} joint {link.joint.name!r} is not given to Exudyn"
            )

    def _settings(self) -> Any:
        """Full Newton, one load step, and a factorisation that bears redundant equations and free
        bodies.
        """
        out = self.exudyn.SimulationSettings()
        out.linearSolver.solverType = self.exudyn.LinearSolverType.EigenDense
        out.linearSolver.ignoreSingularJacobian = True
        static = out.staticSolver
        static.numberOfLoadSteps = 1
        static.adaptiveStep = False
        static.verboseMode = 0
        static.newton.absoluteTolerance = 1e-10
        static.newton.maxIterations = 50
        static.newton.useModifiedNewton = False
        out.solution.file.write = False
        return out

    def ready(self, q: Array) -> Sequence[Array]:
        """Exudyn's coordinates of all bodies, placed by the tree."""
        parts = []
        for X in self.tree.poses(self.tree.coordinates(q))[1:]:
            if self.planar:
                parts += [X[:, :2, 3], np.arctan2(X[:, 1, 0], X[:, 0, 0])[:, None]]
            else:
                parts += [X[:, :3, 3], spatial.matrix_to_quat_wxyz(X[:, :3, :3]) - [1, 0, 0, 0]]
        return list(np.concatenate(parts, axis=-1))

    def call(self, guess: Array, /) -> Array:
        """Coordinates found from the guess; infinite where the solver gives up."""
        self.bodies.systemData.SetODE2Coordinates(guess, configuration=self.initial)
        try:
            done = self.bodies.SolveStatic(self.settings, storeSolver=False, showCausingItems=False)
        except (RuntimeError, ValueError):
            done = False
        if not done:
            return np.full_like(guess, np.inf)
        return np.array(self.bodies.systemData.GetODE2Coordinates(configuration=self.current))

    def opening(self, answers: Sequence[Array]) -> Array:
        """Of all joints."""
        y = np.array(answers)
        given_up = np.isinf(y[:, 0])
        y = np.where(given_up[:, None], self.ready(self.system.q("closed")[None])[0], y)
        X: list[Array] = [np.broadcast_to(np.eye(4), (len(y), 4, 4))]
        size = 3 if self.planar else 7
        for part in np.moveaxis(y.reshape(len(y), -1, size), 1, 0):
            if self.planar:
                X.append(
                    spatial.pose(spatial.rot_z(part[:, 2]), np.insert(part[:, :2], 2, 0.0, axis=-1))
                )
            else:
                quat = spatial.unit(part[:, 3:] + [1, 0, 0, 0])
                X.append(spatial.pose(spatial.quat_wxyz_to_matrix(quat), part[:, :3]))
        return np.where(given_up, np.inf, worst(self.tree.links.values(), X))

    def freedoms(self) -> int:
        """Degrees of freedom at the initial coordinates, as Exudyn counts them."""
        answer = self.exudyn.ComputeSystemDegreeOfFreedom(self.bodies)
        return int(answer["degreeOfFreedom"])
