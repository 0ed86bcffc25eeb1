"""Inverse solutions without Kempe: exponentials in numpy, Newton's method from thousands of starts,
closed forms.

`Model` is a chain as lines; `isolated` finds its isolated solutions for a target. Nothing here
calls the package.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any

import numpy as np
import reference
from scipy.spatial.transform import Rotation

TURN = 0
SLIDE = 1
TASKS = ("pose", "position", "orientation", "direction", "position_axis")
PER_JOINT = ("kinds", "axes", "points", "index", "multiplier", "offset")
Step = tuple  # ("X", pose) or ("R" or "P", axis, coordinate, multiplier, offset)


@dataclass(frozen=True, eq=False)
class Model:
    """A chain as lines in ground axes where all of its angles and lengths are zero (Brockett,
    1984).

    `index`, `multiplier` and `offset` (n,) say how coordinates drive it: theta = multiplier *
    q[index] + offset.
    """

    kinds: np.ndarray
    axes: np.ndarray
    points: np.ndarray
    home: np.ndarray
    index: np.ndarray
    multiplier: np.ndarray
    offset: np.ndarray
    names: tuple[str, ...]

    @property
    def n(self) -> int:
        return len(self.kinds)

    @property
    def size(self) -> float:
        """A length of the chain, by which errors of position are divided."""
        ends = np.vstack([self.points, self.home[None, :3, 3]])
        return max(float(np.linalg.norm(ends - ends.mean(axis=0), axis=1).max()), 1e-3)

    def theta(self, q) -> np.ndarray:
        """Angles and lengths (..., n) of configurations (..., nq)."""
        return self.multiplier * np.asarray(q, dtype=float)[..., self.index] + self.offset

    def fk(self, q) -> np.ndarray:
        """Poses (..., 4, 4) of configurations (..., nq)."""
        return self.pose(self.theta(q))

    def pose(self, theta) -> np.ndarray:
        theta = np.asarray(theta, dtype=float)
        R, p, _, _ = self._sweep(theta.reshape(-1, self.n))
        X = np.zeros((len(R), 4, 4))
        X[:, :3, :3] = R
        X[:, :3, 3] = p
        X[:, 3, 3] = 1.0
        return X.reshape(*theta.shape[:-1], 4, 4)

    def jacobian(self, theta) -> np.ndarray:
        """Jacobians (..., 6, n), linear part first, in axes of the ground at the tip, by the
        joints' own motions.
        """
        theta = np.asarray(theta, dtype=float)
        _, p, h, o = self._sweep(theta.reshape(-1, self.n))
        return self._columns(p, h, o).reshape(*theta.shape[:-1], 6, self.n)

    def _columns(self, p, h, o) -> np.ndarray:
        turns = (self.kinds == TURN)[:, None]
        v = np.where(turns, np.cross(h, p[:, None] - o), h)
        w = np.where(turns, h, 0.0)
        return np.swapaxes(np.concatenate([v, w], axis=-1), 1, 2)

    def _sweep(self, theta):
        """Rotation and position of the tip, and where the lines have moved to, for (N, n)."""
        N = len(theta)
        R = np.broadcast_to(np.eye(3), (N, 3, 3))
        p = np.zeros((N, 3))
        h = np.empty((N, self.n, 3))
        o = np.empty((N, self.n, 3))
        s = np.sin(theta)
        c = np.cos(theta)
        for i in range(self.n):
            h[:, i], o[:, i] = R @ self.axes[i], R @ self.points[i] + p
            if self.kinds[i] == SLIDE:
                p = p + h[:, i] * theta[:, i, None]
                continue
            K = skew(self.axes[i])
            E = np.eye(3) + s[:, i, None, None] * K + (1.0 - c[:, i])[:, None, None] * (K @ K)
            p = p + (R @ (self.points[i] - E @ self.points[i])[..., None])[..., 0]
            R = R @ E
        return R @ self.home[:3, :3], p + R @ self.home[:3, 3], h, o

    def wrapped(self, theta) -> np.ndarray:
        """Angles brought to (-pi, pi], lengths as they are."""
        theta = np.array(theta, dtype=float)
        turns = self.kinds == TURN
        theta[..., turns] = -np.remainder(np.pi - theta[..., turns], 2 * np.pi) + np.pi
        return theta

    def apart(self, a, b) -> np.ndarray:
        """Largest difference (...) of angles modulo a turn, and of lengths, of (..., n) and (...,
        n).
        """
        return np.abs(self.wrapped(np.asarray(a) - np.asarray(b))).max(axis=-1, initial=0.0)

    def held(self, values: dict[str, float]) -> Model:
        """The chain that remains when coordinates are held: later lines move with the joint, which
        then is none.
        """
        if not values:
            return self
        theta = self.theta([values.get(n, 0.0) for n in self.names])
        keep = np.array([self.names[i] not in values for i in self.index])
        X = np.eye(4)
        axes = []
        points = []
        for i in range(self.n):
            if keep[i]:
                axes.append(X[:3, :3] @ self.axes[i])
                points.append(X[:3, :3] @ self.points[i] + X[:3, 3])
                continue
            one = replace(self, home=np.eye(4), **{k: getattr(self, k)[[i]] for k in PER_JOINT})
            X = X @ one.pose(theta[[i]])
        return replace(
            self,
            axes=np.array(axes),
            points=np.array(points),
            home=X @ self.home,
            **{k: getattr(self, k)[keep] for k in PER_JOINT if k not in ("axes", "points")},
        )

    def condition(self, theta, task: str = "pose", axis=(0, 0, 1)) -> np.ndarray:
        """Smallest singular value (...) of the Jacobian of the task, lengths in units of `size`."""
        theta = np.asarray(theta, dtype=float)
        J = self.jacobian(theta)
        J[..., :3, :] /= self.size
        J = J * np.where(self.kinds == SLIDE, self.size, 1.0)
        rows = _rows(
            J.reshape(-1, 6, self.n), self.pose(theta).reshape(-1, 4, 4)[:, :3, :3], task, axis
        )
        return np.linalg.svd(rows, compute_uv=False)[:, -1].reshape(theta.shape[:-1])

    def curvature(
        self, theta, task: str = "pose", axis=(0, 0, 1), step: float = 1e-4
    ) -> np.ndarray:
        """How fast the smallest singular value (...) grows along its own motion, by central
        differences.

        Along that motion, near a fold, the error is half of it times the square of the distance to
        the fold.
        """
        theta = np.asarray(theta, dtype=float)
        scale = np.where(self.kinds == SLIDE, self.size, 1.0)

        def rows(points):
            J = self.jacobian(points)
            J[..., :3, :] /= self.size
            R = self.pose(points).reshape(-1, 4, 4)[:, :3, :3]
            return _rows((J * scale).reshape(-1, 6, self.n), R, task, axis).reshape(
                *theta.shape[:-1], -1, self.n
            )

        u, _, vt = np.linalg.svd(rows(theta))
        left = u[..., :, vt.shape[-1] - 1]
        right = vt[..., -1, :]
        change = (rows(theta + step * scale * right) - rows(theta - step * scale * right)) / (
            2.0 * step
        )
        return np.abs(np.einsum("...i,...ij,...j->...", left, change, right))


def skew(v) -> np.ndarray:
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])


def from_steps(steps: Iterable[Step], names: Sequence[str]) -> Model:
    """Model of a product of constant poses and motions; `names` are the coordinates in the order of
    q.
    """
    X = np.eye(4)
    rows = []
    for step in steps:
        if step[0] == "X":
            X = X @ np.asarray(step[1], dtype=float)
            continue
        letter, axis, name, multiplier, offset = step
        u = np.asarray(
            {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}.get(axis, axis), dtype=float
        )
        h = X[:3, :3] @ (u / np.linalg.norm(u))
        rows.append((letter == "P", h, X[:3, 3], names.index(name), multiplier, offset))
    kinds, axes, points, index, multiplier, offset = (np.array(c) for c in zip(*rows, strict=True))
    return Model(
        kinds.astype(int),
        axes,
        points,
        X,
        index.astype(int),
        multiplier.astype(float),
        offset.astype(float),
        tuple(names),
    )


def dh_steps(
    rows: Iterable[dict[str, Any]], convention: str = "standard", base=None, tool=None
) -> list[Step]:
    """Steps of a Denavit-Hartenberg table, as the books write its matrices; joints are q1, q2, ...
    unless named.
    """
    out: list[Step] = [("X", np.eye(4) if base is None else base)]
    for i, row in enumerate(rows, 1):
        kind = row.get("type", "revolute")
        name = row.get("name", f"q{i}")
        z = reference.turn("z", row.get("theta", 0.0)) @ reference.slide("z", row.get("d", 0.0))
        x = reference.slide("x", row.get("a", 0.0)) @ reference.turn("x", row.get("alpha", 0.0))
        move = ("R" if kind == "revolute" else "P", "z", name, 1.0, 0.0)
        out += (
            [move, ("X", z), ("X", x)] if convention == "standard" else [("X", x), move, ("X", z)]
        )
    return [*out, ("X", np.eye(4) if tool is None else tool)]


PRIMITIVES = {
    "revolute": [("R", None, "")],
    "prismatic": [("P", None, "")],
    "cylindrical": [("R", "z", ".rz"), ("P", "z", ".z")],
    "universal": [("R", "x", ".rx"), ("R", "y", ".ry")],
    "spherical": [("R", "z", ".rz"), ("R", "y", ".ry"), ("R", "x", ".rx")],
    "translation": [("P", "x", ".x"), ("P", "y", ".y"), ("P", "z", ".z")],
    "planar": [("P", "x", ".x"), ("P", "y", ".y"), ("R", "z", ".rz")],
}
"""Joints as products of turns and slides, as DESIGN.md states them; the first two about their own
axis."""


def joint_steps(
    kind: str, name: str, at, rpy, axis, multiplier: float = 1.0, offset: float = 0.0
) -> list[Step]:
    """Steps of a joint placed as in URDF; coordinates 'name' or 'name.rx', ..."""
    out: list[Step] = [("X", reference.placement(at, rpy))]
    for letter, own, suffix in PRIMITIVES[kind]:
        out.append((letter, own or axis, name + suffix, multiplier, offset))
    return out


def library_steps(name: str, frame: str) -> list[Step]:
    """Steps of a shipped chain, from its TOML text by a reader of our own."""
    data = tomllib.loads(
        (resources.files("kempe.library") / f"{name}.toml").read_text(encoding="utf-8")
    )
    space = {"pi": math.pi, "sqrt": math.sqrt, "__builtins__": {}} | data.get("parameters", {})

    def number(x) -> float:
        return float(eval(x, space)) if isinstance(x, str) else float(x)

    def pose(table) -> np.ndarray:
        return reference.placement(
            [number(x) for x in table.get("at", (0, 0, 0))],
            [number(x) for x in table.get("rpy", (0, 0, 0))],
        )

    if "dh" in data:
        table = data["dh"]
        rows = [
            {k: number(v) if k in ("a", "alpha", "d", "theta") else v for k, v in r.items()}
            for r in table["rows"]
        ]
        for row in rows:
            row.pop("limits", None)
        steps = dh_steps(
            rows, table["convention"], pose(table.get("base", {})), pose(table.get("tool", {}))
        )
        for extra in data.get("frame", []) if frame != "tool" else []:
            if extra["name"] == frame:
                steps[-1] = ("X", pose(extra))
        return steps
    tip = next(f for f in data["frame"] if f["name"] == frame)
    steps = [("X", pose(tip))]
    body = tip["body"]
    parent = {j["child"]: j for j in data["joint"]}
    while body in parent:
        j = parent[body]
        move = (
            "R" if j["type"] == "revolute" else "P",
            tuple(j.get("axis", (0, 0, 1))),
            j["name"],
            1.0,
            0.0,
        )
        steps = [("X", pose(j)), move, *steps]
        body = j["parent"]
    return steps


# ---------------------------------------------------------------- errors of a pose


def rotation_log(R) -> np.ndarray:
    """Rotation vectors (N, 3) of matrices (N, 3, 3)."""
    return Rotation.from_matrix(R).as_rotvec()


def error(X, target, task: str = "pose", axis=(0, 0, 1)) -> tuple[np.ndarray, np.ndarray]:
    """Errors of position [m] and of angle [rad], each (...), of poses; zero where the task does not
    ask for them.
    """
    X, target = np.broadcast_arrays(X, target)
    position = np.linalg.norm(X[..., :3, 3] - target[..., :3, 3], axis=-1)
    A = X[..., :3, :3]
    B = target[..., :3, :3]
    if task in ("direction", "position_axis"):
        u = A @ np.asarray(axis, dtype=float)
        v = B @ np.asarray(axis, dtype=float)
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=-1), (u * v).sum(-1))
    else:
        D = np.swapaxes(A, -1, -2) @ B
        w = np.stack(
            [D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]],
            -1,
        )
        angle = np.arctan2(np.linalg.norm(w, axis=-1), np.trace(D, axis1=-2, axis2=-1) - 1.0)
    zero = np.zeros_like(position)
    return (zero if task in ("orientation", "direction") else position), (
        zero if task == "position" else angle
    )


def _rows(J, R, task, axis):
    """Rows of Jacobians (N, 6, n) that the task asks for."""
    if task == "pose":
        return J
    if task == "position":
        return J[:, :3]
    if task == "orientation":
        return J[:, 3:]
    u = R @ np.asarray(axis, dtype=float)
    turned = np.cross(np.swapaxes(J[:, 3:], 1, 2), u[:, None])  # how the axis of the tool moves
    across = np.swapaxes(turned, 1, 2)
    return across if task == "direction" else np.concatenate([J[:, :3], across], axis=1)


def _residual(model: Model, R, p, target, task, axis):
    """What is missing (N, m) of targets (N, 4, 4), in the order of `_rows`."""
    dp = (target[:, :3, 3] - p) / model.size
    if task == "position":
        return dp
    if task in ("direction", "position_axis"):
        du = target[:, :3, :3] @ np.asarray(axis, dtype=float) - R @ np.asarray(axis, dtype=float)
        return du if task == "direction" else np.concatenate([dp, du], axis=1)
    w = rotation_log(target[:, :3, :3] @ np.swapaxes(R, 1, 2))
    return w if task == "orientation" else np.concatenate([dp, w], axis=1)


# ---------------------------------------------------------------- Newton from many starts


def newton(
    model: Model,
    target,
    theta,
    task: str = "pose",
    axis=(0, 0, 1),
    steps: int = 40,
    tol: float = 1e-12,
):
    """Where damped Gauss-Newton (Levenberg, 1944) leads from `theta` (N, n), and whether it solves
    the task (N,).

    `target` is one pose (4, 4), or one for each start (N, 4, 4).
    """
    theta = np.array(theta, dtype=float)
    target = np.broadcast_to(np.asarray(target, dtype=float), (len(theta), 4, 4))
    scale = np.where(model.kinds == SLIDE, model.size, 1.0)
    damping = np.full(len(theta), 1e-2)
    R, p, h, o = model._sweep(theta)
    r = _residual(model, R, p, target, task, axis)
    live = np.arange(len(theta))
    done = np.zeros(len(theta), dtype=bool)
    for _ in range(steps):
        cost = (r * r).sum(1)
        J = model._columns(p, h, o)
        J[:, :3] /= model.size
        J = _rows(J * scale, R, task, axis)
        A = np.swapaxes(J, 1, 2) @ J
        A[:, range(model.n), range(model.n)] += (
            damping[live, None] * np.minimum(1.0, cost)[:, None] + 1e-15
        )
        step = np.linalg.solve(A, np.swapaxes(J, 1, 2) @ r[..., None])[..., 0]
        # a slide may go far at once
        turn = np.abs(step[:, model.kinds == TURN]).max(1, initial=1e-300)
        step *= np.minimum(1.0, 1.0 / turn)[:, None]
        trial = theta[live] + step * scale
        R2, p2, h2, o2 = model._sweep(trial)
        r2 = _residual(model, R2, p2, target[live], task, axis)
        better = (r2 * r2).sum(1) <= cost
        theta[live[better]] = trial[better]
        damping[live] = np.where(better, damping[live] * 0.2, damping[live] * 8.0).clip(1e-12, 1e6)
        pick = better[:, None]
        r = np.where(pick, r2, r)
        R = np.where(pick[..., None], R2, R)
        p = np.where(pick, p2, p)
        h = np.where(pick[..., None], h2, h)
        o = np.where(pick[..., None], o2, o)
        size = np.abs(r).max(1)
        done[live] = size < tol
        go = (size >= tol) & (damping[live] < 1e5)
        live = live[go]
        r = r[go]
        R = R[go]
        p = p[go]
        h = h[go]
        o = o[go]
        if not len(live):
            break
    return theta, done


def clusters(model: Model, theta, near: float = 1e-5) -> tuple[np.ndarray, np.ndarray]:
    """Distinct solutions (k, n) among `theta` (N, n), angles in (-pi, pi], and how often each
    occurs (k,).
    """
    found: list[np.ndarray] = []
    hits: list[int] = []
    rest = model.wrapped(theta)
    while len(rest):
        same = model.apart(rest, rest[0]) < near
        found.append(rest[0])
        hits.append(int(same.sum()))
        rest = rest[~same]
    order = sorted(range(len(found)), key=lambda i: tuple(found[i]))
    return np.array([found[i] for i in order]).reshape(-1, model.n), np.array(
        [hits[i] for i in order], dtype=int
    )


def starts(model: Model, number: int, rng: np.random.Generator) -> np.ndarray:
    """Random angles in a turn, and lengths of all magnitudes from a tenth to a hundred sizes of the
    chain.
    """
    u = rng.uniform(-np.pi, np.pi, (number, model.n))
    far = np.sign(u) * 10.0 ** rng.uniform(-1.0, 2.0, u.shape)
    return np.where(model.kinds == SLIDE, far * model.size, u)


def isolated(
    model: Model,
    target,
    task: str = "pose",
    axis=(0, 0, 1),
    seed: int = 0,
    batch: int = 800,
    rounds: int = 10,
    known=None,
    singular: float = 1e-7,
) -> np.ndarray:
    """The isolated solutions (k, n) found, as theta, angles in (-pi, pi].

    Batches of random starts go on until each solution has been hit at least five times, so that one
    of the usual size of basin is missed with a probability below 1 % (Good, 1953). Points on curves
    of solutions are left out.
    """
    rng = np.random.default_rng(seed)
    pool = np.empty((0, model.n))
    for k in range(rounds):
        first = starts(model, batch, rng)
        if k == 0 and known is not None:
            first = np.vstack([first, np.atleast_2d(known)])
        theta, done = newton(model, target, first, task, axis)
        pool = np.vstack([pool, theta[done]])
        if not len(pool) and k:
            break
        if len(pool):
            pool = pool[model.condition(pool, task, axis) > singular]
            _, hits = clusters(model, pool)
            if k and len(hits) and hits.min() >= 5:
                break
    return clusters(model, pool)[0]


def singular_configuration(
    model: Model, rng: np.random.Generator, task: str = "pose"
) -> tuple[np.ndarray, np.ndarray]:
    """A random theta (n,) where a square Jacobian is singular, to rounding, and a direction (n,)
    that leaves it.

    The determinant changes its sign along a random line; bisection finds where.
    """
    scale = np.where(model.kinds == SLIDE, model.size, 1.0)

    def det(t):
        points = start + np.multiply.outer(np.atleast_1d(t), direction)
        J = model.jacobian(points)
        J[..., :3, :] /= model.size
        J = _rows(J * scale, model.pose(points)[:, :3, :3], task, (0, 0, 1))
        return np.linalg.det(J)

    for _ in range(100):
        start = starts(model, 1, rng)[0]
        direction = rng.normal(size=model.n) * scale
        direction /= np.linalg.norm(direction / scale)
        grid = np.linspace(0.0, 3.0, 60)
        values = det(grid)
        change = np.flatnonzero(values[:-1] * values[1:] < 0.0)
        if not len(change):
            continue
        low = grid[change[0]]
        high = grid[change[0] + 1]
        sign = math.copysign(1.0, values[change[0]])
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if det(middle)[0] * sign > 0.0 else (low, middle)
        return start + 0.5 * (low + high) * direction, direction
    raise AssertionError("no singular configuration found")


# ---------------------------------------------------------------- closed forms


def two_link(x: float, y: float, l1: float, l2: float) -> list[tuple[float, float]]:
    """The solutions of the lecture's two-link arm: none, one (stretched or folded) or two."""
    c = (x * x + y * y - l1 * l1 - l2 * l2) / (2 * l1 * l2)
    if abs(c) > 1.0:
        return []
    out = []
    for q2 in {math.acos(c), -math.acos(c)}:
        out.append((math.atan2(y, x) - math.atan2(l2 * math.sin(q2), l1 + l2 * math.cos(q2)), q2))
    return sorted(out)


def three_link(
    x: float, y: float, phi: float, l1: float, l2: float, l3: float
) -> list[tuple[float, float, float]]:
    """The solutions of a planar arm with three turns for a pose of its tip: those of two links to
    its last joint.
    """
    wrist = two_link(x - l3 * math.cos(phi), y - l3 * math.sin(phi), l1, l2)
    return [(a, b, phi - a - b) for a, b in wrist]
