"""Assembly with other libraries: Gauss-Newton by hand on the equations that MuJoCo and Pinocchio
evaluate.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from kempe.kernels.forward.table_layout import BALL, SLIDE, TURN
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.loop_trees import Tree, mjcf

STEPS = 100
"""Steps after which a solver gives up."""
CLOSED = 1e-10
"""Norm of the closure equations at which it stops."""
LONGEST = 1.0
"""Largest component of a step, in radians or metres."""


class Assembler:
    """A library that assembles: `ready` for guesses, the call itself, and how far its answers are
    from closed.

    Only the call is timed; guesses and answers are in the library's own coordinates.
    """

    tolerance = 1e-8
    """Openings up to which an answer counts as closed."""
    slow = False
    """Whether it is given fewer guesses."""

    def ready(self, q: Array) -> Sequence[Any]:
        """What the calls take, for guesses q (n, nq)."""
        raise NotImplementedError

    def call(self, guess: Any, /) -> Any:
        """The answer to one guess."""
        raise NotImplementedError

    def opening(self, answers: Sequence[Any]) -> Array:
        """How far (n,) the answers are from closed, by plain products; infinite where the library
        itself gave up.
        """
        raise NotImplementedError


class GaussNewton(Assembler):
    """Steps of minimum norm v = -J^T (J J^T + m I)^-1 r, with a damping m in proportion to the
    residual r.

    A subclass evaluates r and J at the library's coordinates and adds steps to them. `place` says
    where in these the coordinates of the tree are, `first` where the velocities of its moves begin;
    `known` ones of the system stay.
    """

    damping = 1e-2
    """As a part of the residual: of 1e-4 to 1e-1 the one with which most guesses close."""

    def __init__(
        self, tree: Tree, nv: int, place: np.ndarray, first: Sequence[int], known: Iterable[str]
    ):
        self.tree = tree
        self.nv = nv
        self.place = place
        columns = {tree.columns[name] for name in known}
        held = [v for move, v in zip(tree.moves, first, strict=True) if move.column in columns]
        self.free = np.setdiff1d(np.arange(nv), held)

    def equations(self, x: Array) -> tuple[Array, Array]:
        """Closure equations (m,) and their Jacobian (m, nv)."""
        raise NotImplementedError

    def add(self, x: Array, v: Array) -> Array:
        """Coordinates after the step v (nv,)."""
        raise NotImplementedError

    def ready(self, q: Array) -> Sequence[Array]:
        """The library's coordinates."""
        x = self.tree.coordinates(q)
        out = np.empty_like(x)
        out[..., self.place] = x
        return list(out)

    def call(self, guess: Array, /) -> Array:
        """Coordinates found from the guess, or the last ones tried."""
        x = guess
        some = len(self.free) < self.nv
        for _ in range(STEPS):
            r, J = self.equations(x)
            size = float(np.sqrt(r @ r))
            if size < CLOSED:
                break
            if some:
                J = J[:, self.free]
            step = self.step(r, J, self.damping * min(size, 1.0))
            longest = np.abs(step).max()
            if longest > LONGEST:
                step *= LONGEST / longest
            if some:
                whole = np.zeros(self.nv)
                whole[self.free] = step
                step = whole
            x = self.add(x, step)
        return x

    def step(self, r: Array, J: Any, damping: float) -> Array:
        """The step of minimum norm."""
        A = J @ J.T
        A.flat[:: len(A) + 1] += damping
        return -J.T @ np.linalg.solve(A, r)

    def opening(self, answers: Sequence[Array]) -> Array:
        """Of the cut joints; the others cannot open."""
        return self.tree.opening(np.array(answers)[:, self.place])


class Mujoco(GaussNewton):
    """MuJoCo's equality constraints, of which it tells residual and Jacobian."""

    def __init__(self, tree: Tree, known: Iterable[str] = (), sparse: bool = False):
        mujoco = peers.module("mujoco")
        self.model = mujoco.MjModel.from_xml_string(mjcf(tree, sparse))
        self.data = mujoco.MjData(self.model)
        self.turn = mujoco.mj_kinematics
        self.shift = mujoco.mj_comPos
        self.tie = mujoco.mj_makeConstraint
        self.integrate = mujoco.mj_integratePos
        joints = [self.model.joint(m.name) for m in tree.moves]
        place = [j.qposadr[0] + np.arange(m.size) for j, m in zip(joints, tree.moves, strict=True)]
        first = [int(j.dofadr[0]) for j in joints]
        super().__init__(tree, self.model.nv, np.concatenate(place), first, known)

    def evaluate(self, x: Array) -> Any:
        """MuJoCo's data with the constraints evaluated."""
        model = self.model
        data = self.data
        data.qpos[:] = x
        self.turn(model, data)
        self.shift(model, data)
        self.tie(model, data)
        return data

    def equations(self, x: Array) -> tuple[Array, Array]:
        """Residual and Jacobian of all connects: MuJoCo's own arrays, which the next call
        overwrites.
        """
        data = self.evaluate(x)
        return data.efc_pos, data.efc_J.reshape(-1, self.nv)

    def add(self, x: Array, v: Array) -> Array:
        """Coordinates after the step, by MuJoCo."""
        x = x.copy()
        self.integrate(self.model, x, v, 1.0)
        return x


class SparseMujoco(Mujoco):
    """The same with SciPy's sparse factorisation."""

    damping = 1e-4
    """With more of it long rows of loops do not close."""

    def __init__(self, tree: Tree, known: Iterable[str] = ()):
        super().__init__(tree, known, sparse=True)
        self.csr = peers.module("scipy.sparse").csr_matrix
        self.eye = peers.module("scipy.sparse").identity
        self.solve = peers.module("scipy.sparse.linalg").spsolve

    def equations(self, x: Array) -> tuple[Array, Any]:
        """Residual and Jacobian, this as a sparse matrix."""
        data = self.evaluate(x)
        starts = np.append(data.efc_J_rowadr, data.efc_J_rowadr[-1] + data.efc_J_rownnz[-1])
        filled = int(starts[-1])
        J = self.csr(
            (data.efc_J[:filled], data.efc_J_colind[:filled], starts), shape=(data.nefc, self.nv)
        )
        return data.efc_pos, J

    def step(self, r: Array, J: Any, damping: float) -> Array:
        """The step of minimum norm."""
        A = (J @ J.T + damping * self.eye(len(r))).tocsc()
        return -(J.T @ self.solve(A, r))


class Pinocchio(GaussNewton):
    """Pinocchio's frames at both ends of each cut joint, and their Jacobians."""

    def __init__(self, tree: Tree, known: Iterable[str] = ()):
        pin = peers.module("pinocchio")
        self.model, joints = pinocchio_tree(tree)
        self.data = self.model.createData()
        self.axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        self.jacobians = pin.computeJointJacobians
        self.integrate = pin.integrate
        self.update = pin.updateFramePlacement
        self.read = pin.getFrameJacobian
        names = [f"{cut.joint.name}_{k}" for cut in tree.cuts for k in range(len(tree.points(cut)))]
        self.pairs = [
            tuple(self.model.getFrameId(f"{name}_{side}") for side in "ab") for name in names
        ]
        self.size = tree.system.dim
        n = self.size * len(self.pairs)
        self.r = np.empty(n)
        self.J = np.empty((n, self.model.nv))
        parts = zip((self.model.joints[j] for j in joints), tree.moves, strict=True)
        place = [
            j.idx_q + (np.array([3, 0, 1, 2]) if m.kind == BALL else np.arange(1)) for j, m in parts
        ]
        first = [self.model.joints[j].idx_v for j in joints]
        super().__init__(tree, self.model.nv, np.concatenate(place), first, known)

    def equations(self, x: Array) -> tuple[Array, Array]:
        """Differences of the ends' positions and of their Jacobians, in the plane two rows a point."""
        model = self.model
        data = self.data
        axes = self.axes
        update = self.update
        read = self.read
        n = self.size
        self.jacobians(model, data, x)
        for k, (a, b) in enumerate(self.pairs):
            rows = slice(n * k, n * k + n)
            self.r[rows] = (
                update(model, data, a).translation - update(model, data, b).translation
            )[:n]
            self.J[rows] = read(model, data, a, axes)[:n] - read(model, data, b, axes)[:n]
        return self.r, self.J

    def add(self, x: Array, v: Array) -> Array:
        """Coordinates after the step, by Pinocchio."""
        return self.integrate(self.model, x, v)


def pinocchio_tree(tree: Tree) -> tuple[Any, list[int]]:
    """The tree as a Pinocchio model with frames at both ends of each cut, and the number of each
    move's joint.
    """
    pin = peers.module("pinocchio")
    model = pin.Model()
    ids = [0]
    at = [pin.SE3.Identity()]
    joints = []
    kinds = {
        TURN: (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
        SLIDE: (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
        BALL: (pin.JointModelSpherical,) * 3,
    }
    for limb in tree.limbs:
        here = ids[limb.parent]
        before = at[limb.parent] * pin.SE3(limb.before)
        for move in limb.moves:
            here = model.addJoint(here, kinds[move.kind][move.axis](), before, move.name)
            joints.append(here)
            before = pin.SE3.Identity()
        ids.append(here)
        at.append(before * pin.SE3(limb.after))
        model.addFrame(pin.Frame(limb.name, here, 0, at[-1], pin.FrameType.BODY))
    for cut in tree.cuts:
        for side, number, X in (("a", cut.a, cut.X_a), ("b", cut.b, cut.X_b)):
            for k, point in enumerate(tree.points(cut)):
                place = at[number] * pin.SE3(X) * pin.SE3(np.eye(3), point)
                name = f"{cut.joint.name}_{k}_{side}"
                model.addFrame(pin.Frame(name, ids[number], 0, place, pin.FrameType.OP_FRAME))
    return model, joints
