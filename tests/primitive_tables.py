"""Random primitive tables, and what they mean in 4x4 matrices: the independent version of the
kernels.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from kempe.kernels.forward.table_layout import BALL, GENERAL, RX, RX_FLAT, SLIDE, TURN


def pose(rotation=None, p=(0.0, 0.0, 0.0)):
    """4x4 matrix of a 3x3 rotation and a position."""
    X = np.eye(4)
    X[:3, :3] = np.eye(3) if rotation is None else rotation
    X[:3, 3] = p
    return X


def turn_z(angle):
    c = np.cos(angle)
    s = np.sin(angle)
    return pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))


def turn_x(angle):
    c = np.cos(angle)
    s = np.sin(angle)
    return pose(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]))


def random_pose(rng):
    return pose(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))


@dataclass
class Row:
    kind: int
    parent: int
    iq: int
    iv: int
    X: np.ndarray
    offset: float = 0.0
    multiplier: float = 1.0
    form: int = GENERAL


@dataclass
class Table:
    """A table as objects; `pack` gives what kernels read."""

    rows: list[Row]
    outputs: list[tuple[int, bool, np.ndarray]]
    nq: int
    nv: int
    is_chain: bool = False
    # (iq, iv) of each ball coordinate
    quaternions: list[tuple[int, int]] = field(default_factory=list)

    def pack(self):
        ints = [len(self.rows), len(self.outputs), self.nq, self.nv, int(self.is_chain)]
        ints += [int(bool(self.quaternions)), 0, 0]
        floats = []
        for r in self.rows:
            ints += [r.kind, r.parent, r.iq, r.iv, r.form, 0]
            floats += [*r.X[:3].ravel(), np.cos(r.offset), np.sin(r.offset), r.multiplier, 0.0]
        for row, particle, X in self.outputs:
            ints += [row, int(particle)]
            floats += [*X[:3].ravel()]
        return np.array(ints, dtype=np.int64), np.array(floats, dtype=np.float64)

    def random_q(self, rng, n, scale=2.0):
        """n configurations (n, nq); quaternions with norms other than one."""
        return rng.normal(size=(n, self.nq)) * scale

    def moved(self, q, v):
        """The configuration reached from q (nq,) with the velocity v (nv,) in unit time, on the
        manifold.
        """
        new = q.copy()
        balls = dict(self.quaternions)
        for iq, iv in balls.items():
            w, *xyz = q[iq : iq + 4]
            turned = Rotation.from_quat([*xyz, w]) * Rotation.from_rotvec(v[iv : iv + 3])
            x, y, z, w = turned.as_quat()
            new[iq : iq + 4] = w, x, y, z
        for r in {(r.iq, r.iv) for r in self.rows if r.kind != BALL}:
            new[r[0]] = q[r[0]] + v[r[1]]
        return new

    def motion(self, r, q):
        if r.kind == TURN:
            return turn_z(r.offset) @ turn_z(r.multiplier * q[r.iq])
        if r.kind == SLIDE:
            return pose(p=(0, 0, r.multiplier * q[r.iq]))
        w, x, y, z = q[r.iq : r.iq + 4]
        R = Rotation.from_quat([x, y, z, w]).as_matrix()
        return pose(R if r.multiplier > 0 else R.T)

    def row_poses(self, q):
        """For each row its pose before and after the motion."""
        before = []
        after = []
        for r in self.rows:
            base = (np.eye(4) if r.parent < 0 else after[r.parent]) @ r.X
            before.append(base)
            after.append(base @ self.motion(r, q))
        return before, after

    def poses(self, q):
        """(n_out, 4, 4) of one configuration."""
        after = self.row_poses(q)[1]
        out = [(np.eye(4) if row < 0 else after[row]) @ X for row, _, X in self.outputs]
        return np.array(
            [pose(p=T[:3, 3]) if o[1] else T for o, T in zip(self.outputs, out, strict=True)]
        )

    def jacobian(self, q, frame):
        """(6, nv) of output 0: the geometric Jacobian, cross products in ground axes."""
        before, after = self.row_poses(q)
        row, particle, X = self.outputs[0]
        T = (np.eye(4) if row < 0 else after[row]) @ X
        J = np.zeros((6, self.nv))
        while row >= 0:
            r = self.rows[row]
            if r.kind == SLIDE:
                J[:3, r.iv] += r.multiplier * after[row][:3, 2]
            elif r.kind == TURN:
                axis = r.multiplier * after[row][:3, 2]
                J[:, r.iv] += np.r_[np.cross(axis, T[:3, 3] - after[row][:3, 3]), axis]
            else:
                for i in range(3):
                    axis = after[row][:3, i] if r.multiplier > 0 else -before[row][:3, i]
                    J[:, r.iv + i] += np.r_[np.cross(axis, T[:3, 3] - after[row][:3, 3]), axis]
            row = r.parent
        if particle:
            J[3:] = 0.0
        elif frame == 1:
            J[:3] += np.cross(T[:3, 3], J[3:].T).T
        elif frame == 2:
            J = np.r_[T[:3, :3].T @ J[:3], T[:3, :3].T @ J[3:]]
        return J


def random_placement(rng, form):
    if form == GENERAL:
        return random_pose(rng)
    X = turn_x(rng.uniform(-3, 3))
    X[:3, 3] = rng.normal(size=3)
    if form == RX_FLAT:
        X[1, 3] = 0.0
    return X


def random_table(
    rng,
    n_rows,
    n_out=1,
    chain=False,
    kinds=(TURN, SLIDE, BALL),
    forms=(GENERAL,),
    plain=False,
    particles=False,
):
    """A table; not `plain`: with shared coordinates, negative multipliers, gauges, reversed balls."""
    rows = []
    quaternions = []
    single = []
    nq = nv = 0
    for i in range(n_rows):
        kind = int(rng.choice(kinds))
        parent = i - 1 if chain else int(rng.integers(-1, i)) if i else -1
        multiplier = 1.0
        if kind == BALL:
            if not plain and rng.random() < 0.4:
                multiplier = -1.0
            iq = nq
            iv = nv
            quaternions.append((iq, iv))
            nq = nq + 4
            nv = nv + 3
        elif not plain and single and rng.random() < 0.3:
            iq, iv = single[rng.integers(len(single))]
        else:
            iq = nq
            iv = nv
            single.append((iq, iv))
            nq = nq + 1
            nv = nv + 1
        if kind != BALL and not plain:
            multiplier = float(rng.choice([1.0, -1.0, rng.normal()]))
        offset = rng.uniform(-3, 3) if kind == TURN and not plain else 0.0
        form = int(rng.choice(forms))
        rows.append(
            Row(kind, parent, iq, iv, random_placement(rng, form), offset, multiplier, form)
        )
    outputs = [
        (
            n_rows - 1 if chain else int(rng.integers(-1, n_rows)),
            bool(particles and rng.random() < 0.5),
            random_pose(rng),
        )
        for _ in range(n_out)
    ]
    # coordinates that nothing reads
    return Table(rows, outputs, nq + 2, nv + 1, chain, quaternions)


def all_forms():
    return GENERAL, RX, RX_FLAT
