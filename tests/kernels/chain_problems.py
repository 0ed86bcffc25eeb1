"""Chains for the inverse kinematics, and an independent judgement of its answers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from primitive_tables import Row, Table, pose
from scipy.spatial.transform import Rotation

from kempe.kernels import compiled
from kempe.kernels.base.search_layout import ANSWER, STATUS
from kempe.kernels.forward.table_layout import BALL, SLIDE, TURN

POSE = (1, 1, 1, 1, 1, 1)
POSITION = (1, 1, 1, 0, 0, 0)
PLANAR = (1, 1, 0, 0, 0, 1)
POINT = (1, 1, 0, 0, 0, 0)
ORIENTATION = (0, 0, 0, 1, 1, 1)
DIRECTION = (0, 0, 0, 1, 1, 1, 1)
POSITION_AXIS = (1, 1, 1, 1, 1, 1, 1)
"""Rows of a task that count; a seventh number 1 says that of the orientation only the tip's z axis
does."""

TOLERANCE = 1e-6


@dataclass
class Chain:
    """A table with limits per velocity coordinate."""

    table: Table
    lower: np.ndarray
    upper: np.ndarray
    circular: np.ndarray

    def forward(self, q):
        return self.table.poses(q)[0]

    def random_q(self, rng, n):
        """n configurations (n, nq) inside the limits; of slides within 1 of zero where there is no
        limit.
        """
        out = np.zeros((n, self.table.nq))
        for r in self.table.rows:
            if r.kind == BALL:
                out[:, r.iq : r.iq + 4] = Rotation.random(n, random_state=rng).as_quat()
            else:
                free = np.pi if r.kind == TURN else 1.0
                low, high = np.clip([self.lower[r.iv], self.upper[r.iv]], -free, free)
                out[:, r.iq] = rng.uniform(low, high, n)
        return out

    def reachable(self, rng, n):
        q = self.random_q(rng, n)
        return np.array([self.forward(x) for x in q]).reshape(-1, 4, 4), q

    def within_limits(self, q):
        return all(
            self.lower[r.iv] <= q[r.iq] <= self.upper[r.iv]
            for r in self.table.rows
            if r.kind != BALL
        )


@dataclass
class Answers:
    missed: int
    q: np.ndarray
    residual: np.ndarray
    status: np.ndarray
    steps: np.ndarray
    starts: np.ndarray


def solve(
    chain,
    targets,
    mask=POSE,
    seeds=None,
    seed=1,
    first=0,
    starts=100,
    steps=20,
    tol=TOLERANCE,
    length=0.0,
    slow=False,
):
    """What the kernels write for targets (N, 4, 4); seeds (1 or N, K, nq). slow: starts one at a
    time.
    """
    n = len(targets)
    nq = chain.table.nq
    seeds = np.empty((1, 0, nq)) if seeds is None else np.asarray(seeds, dtype=float)
    limits = np.array([chain.lower, chain.upper], dtype=float)
    out = np.full((n, nq + ANSWER), 7.0)
    task = np.r_[np.array((*mask, 0)[:7]), chain.circular]
    arguments = (
        *chain.table.pack(),
        limits,
        task,
        np.ascontiguousarray(targets),
        seeds,
        seed,
        first,
        starts,
        steps,
        tol,
        tol,
        length,
        out,
    )
    balls = any(r.kind == BALL for r in chain.table.rows)
    if (
        compiled.scalar_search.reach_goals_singly
        if balls or slow
        else compiled.schedule.reach_goals
    )(*arguments):
        compiled.fallback.approach_goals(*arguments)
    missed = int((out[:, nq + STATUS] != 0).sum())
    q = out[:, :nq].copy()
    residual = out[:, nq : nq + STATUS].copy()
    info = out[:, nq + STATUS :].astype(np.int64)
    return Answers(missed, q, residual, *info.T.copy())


def distance(chain, q, target, mask=POSE):
    """Linear and angular distance of the tip at q from the target, in the rows of the task."""
    tip = chain.forward(q)
    rows = np.array(mask, dtype=float)
    if len(mask) == 7:
        a = tip[:3, 2]
        b = target[:3, 2]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
        return np.linalg.norm((target - tip)[:3, 3] * rows[:3]), angle
    turn = Rotation.from_matrix(target[:3, :3] @ tip[:3, :3].T).as_rotvec()
    return np.linalg.norm((target - tip)[:3, 3] * rows[:3]), np.linalg.norm(turn * rows[3:6])


def judge(chain, answers, targets, mask=POSE, tol=TOLERANCE):
    """Which answers reach their targets inside the limits (N,); fails if the kernel's own word
    differs.
    """
    found = np.array(
        [distance(chain, q, t, mask) for q, t in zip(answers.q, targets, strict=True)]
    ).reshape(-1, 2)
    right = (found <= tol).all(axis=1) & np.array(
        [chain.within_limits(q) for q in answers.q], dtype=bool
    )
    assert np.array_equal(right, answers.status == 0) and answers.missed == (~right).sum()
    assert np.abs(found - answers.residual).max(initial=0.0) < 1e-7 * (
        1.0 + np.abs(found).max(initial=0.0)
    )
    return right


def limited(table, lower, upper, circular=0):
    full = [np.broadcast_to(np.asarray(x, dtype=float), table.nv).copy() for x in (lower, upper)]
    return Chain(table, *full, np.broadcast_to(np.int64(circular), table.nv).copy())


def free(chain):
    """The same chain without limits; circular where a coordinate has one turning row with
    multiplier +-1.
    """
    readers = {}
    for r in chain.table.rows:
        readers.setdefault(r.iv, []).append(r)
    circular = [
        int(len(rows) == 1 and rows[0].kind == TURN and abs(rows[0].multiplier) == 1.0)
        for rows in (readers.get(v, ()) for v in range(chain.table.nv))
    ]
    n = chain.table.nv
    return Chain(
        chain.table, np.full(n, -np.inf), np.full(n, np.inf), np.array(circular, dtype=np.int64)
    )


def planar_arm(*lengths, circular=1):
    """Turning joints about z, links along x, no limits."""
    starts = (0.0, *lengths[:-1])
    n = len(lengths)
    rows = [Row(TURN, i - 1, i, i, pose(p=(x, 0, 0))) for i, x in enumerate(starts)]
    table = Table(rows, [(n - 1, False, pose(p=(lengths[-1], 0, 0)))], n, n, True)
    return limited(table, -np.inf, np.inf, circular)


def points(xyz):
    return np.array([pose(p=p) for p in np.atleast_2d(np.asarray(xyz, dtype=float))])


def floating_arm():
    """Three slides along x, y, z and a ball, then three turns within +-2."""
    to_x = Rotation.from_rotvec([0, np.pi / 2, 0]).as_matrix()
    to_y = Rotation.from_rotvec([-np.pi / 2, 0, 0]).as_matrix()
    placements = [pose(to_x), pose(to_x.T @ to_y), pose(to_y.T), pose()]
    rows = [
        Row(k, i - 1, i, i, X)
        for i, (k, X) in enumerate(zip((SLIDE, SLIDE, SLIDE, BALL), placements, strict=True))
    ]
    rows += [Row(TURN, i + 3, i + 7, i + 6, pose(to_y, (0.3, 0.0, 0.1))) for i in range(3)]
    table = Table(rows, [(6, False, pose(p=(0.1, 0.05, 0.0)))], 10, 9, True, [(3, 3)])
    return Chain(
        table,
        np.r_[np.full(6, -np.inf), -2.0, -2.0, -2.0],
        np.r_[np.full(6, np.inf), 2.0, 2.0, 2.0],
        np.zeros(9, int),
    )
