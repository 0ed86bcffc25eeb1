"""Random mechanisms whose number of degrees of freedom is known by other means than analysis: for
hunts.

Each function takes random numbers and gives a mechanism with the number at neutral coordinates, or
None where it is not known. Truths follow from proofs (dead centres, signatures of quadratic forms,
Dixon), or from the rank of the constraints on velocities of bodies where that is full.
"""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
from world_mechanisms import World, X, Y, Z, framework, loop, unit

from kempe.spatial import exp_se3, exp_so3

Truth = tuple[World, int]


def rotation(rng: np.random.Generator) -> np.ndarray:
    return exp_so3(rng.uniform(-2, 2, 3))


def dead_centres(rng: np.random.Generator, stages: int = 0, weak: float = 0.0) -> Truth:
    """Rigid: stretched bars shift a slider by about s^2, which at the dead centre of the next
    shifts that by s^4, ...

    With `weak` the shifts are this much smaller still, at each stage.
    """
    stages = stages or int(rng.integers(1, 8))
    w = World("dead centres", 2)
    p = np.zeros(2)
    along = np.array([1.0, 0.0])
    first, second = rng.uniform(0.7, 1.4, 2) if not weak else (weak, 1.0)
    w.turn("ground", "a", p)
    w.turn("a", "b", p + first * along)
    p = p + (first + second) * along
    w.turn("b", "k0" if stages > 1 else "ground", p)
    if stages > 1:
        w.slide("k0", "ground", along, p)
    for i in range(1, stages):
        along = np.array([-along[1], along[0]]) * (1 if rng.random() < 0.5 else -1)
        end = "ground" if i == stages - 1 else f"k{i}"
        w.turn(f"k{i - 1}", f"c{i}", p)
        p = p + along * (rng.uniform(0.7, 1.4) if not weak else 1.0 / weak)
        w.turn(f"c{i}", end, p)
        if end != "ground":
            w.slide(end, "ground", along, p)
    return w, 0


def weak_dead_centres(rng: np.random.Generator) -> Truth:
    """The same with shifts of 1e-2 s^2 and less: beyond rounding after a few stages, wherever it
    goes.
    """
    return dead_centres(rng, int(rng.integers(2, 6)), 10.0 ** rng.uniform(-3, -1))


def flat_loop(rng: np.random.Generator) -> Truth | None:
    """A flat loop of bars: the form sum s_i l_i t_i^2 on the plane sum s_i l_i t_i = 0 decides
    (Morse's lemma).
    """
    n = int(rng.integers(2, 6))
    lengths = rng.uniform(0.6, 1.4, size=n)
    signs = rng.choice([1, -1], size=n)
    v = lengths * signs
    if v.sum() < 0:
        v = -v
    plane = np.linalg.svd(v[None])[2][1:]
    eigen = np.linalg.eigvalsh(plane @ np.diag(v) @ plane.T)
    if v.sum() < 0.2 or np.abs(eigen).min() < 0.05:
        return None
    w = World("flat loop", 2)
    x = np.concatenate([[0.0], np.cumsum(v)])
    bodies = ["ground", *(f"b{i}" for i in range(n)), "ground"]
    for i in range(n + 1):
        w.turn(bodies[i], bodies[i + 1], (x[i], 0.0))
    return w, 0 if eigen[0] > 0 or eigen[-1] < 0 else n - 2


def row_of_parallelograms(rng: np.random.Generator) -> Truth:
    """Flat parallelograms, each of which turns the next: one freedom, in many branches."""
    n = int(rng.integers(1, 5))
    w = World("row", 2)
    x = 0.0
    crank = float(rng.uniform(0.5, 1.0))
    w.turn("ground", "c0", (0, 0))
    for i in range(n):
        span = float(rng.uniform(1.1, 2.0))
        w.turn(f"c{i}", f"k{i}", (x + crank, 0))
        w.turn(f"k{i}", f"c{i + 1}", (x + crank + span, 0))
        w.turn("ground", f"c{i + 1}", (x + span, 0))
        x += span
    return w, 1


def parallelograms_apart(rng: np.random.Generator) -> Truth:
    """Flat parallelograms one on the other's coupler: as many freedoms as there are."""
    n = int(rng.integers(1, 4))
    w = World("apart", 2)
    before = "ground"
    for i in range(n):
        a, b, p = *rng.uniform(0.6, 1.5, 2), rng.uniform(-1, 1, 2)
        e = np.array([cos(i), sin(i)])
        w.turn(before, f"l{i}", p)
        w.turn(before, f"r{i}", p + b * e)
        w.turn(f"l{i}", f"k{i}", p + a * e)
        w.turn(f"r{i}", f"k{i}", p + (a + b) * e)
        before = f"k{i}"
    return w, n


def scissor(rng: np.random.Generator) -> Truth:
    """Pairs of crossed bars in a row: one freedom, however long."""
    n = int(rng.integers(2, 41))
    t = float(rng.uniform(0.3, 1.2))
    w = World("scissor", 2)
    up = np.array([cos(t), sin(t)])
    down = np.array([-cos(t), sin(t)])
    base = np.zeros(2)
    w.turn("ground", "a0", base)
    w.slide("ground", "k", (1, 0), 2 * cos(t) * X)
    w.turn("k", "b0", 2 * cos(t) * X)
    for i in range(n):
        left = base
        right = base + [2 * cos(t), 0]
        w.turn(f"a{i}", f"b{i}", left + up)
        if i + 1 < n:
            w.turn(f"b{i}", f"a{i + 1}", right + 2 * down)
            w.turn(f"a{i}", f"b{i + 1}", left + 2 * up)
        base = base + [0, 2 * sin(t)]
    return w, 1


def loop_in_a_group(rng: np.random.Generator) -> Truth:
    """A loop in space of joints that stay in a group of three dimensions; tilted by what is no
    rounding it is rigid.
    """
    kind = int(rng.integers(0, 4))
    n = int(rng.integers(4, 7))
    R = rotation(rng)
    points = rng.uniform(-1, 1, (n, 3)) @ np.diag([1.0, 1.0, float(rng.random() < 0.5)]) @ R.T
    if kind == 0:  # in parallel planes
        joints = [("revolute", p, R[:, 2]) for p in points]
    elif kind == 1:  # about one point
        joints = [("revolute", R[:, 0], unit(rng.normal(size=3))) for _ in points]
    elif kind == 2:  # slides in space
        joints = [("prismatic", p, unit(rng.normal(size=3))) for p in points]
    else:  # slides and turns in a plane
        angles = rng.uniform(0, pi, n)
        joints = [
            ("prismatic", p, R @ [cos(a), sin(a), 0]) if k % 2 else ("revolute", p, R[:, 2])
            for k, (p, a) in enumerate(zip(points, angles, strict=True))
        ]
    if rng.random() < 0.3 and kind in (0, 3):
        tilt = 10.0 ** rng.uniform(-9, -1)
        return loop(
            "tilted", [(k, p, unit(z + tilt * rng.normal(size=3))) for k, p, z in joints]
        ), 0
    return loop("in a group", joints), n - 3


def sarrus(rng: np.random.Generator) -> Truth:
    """Chains of three parallel hinges in two or more directions between ground and platform: one
    straight line.
    """
    R = rotation(rng)
    w = World("Sarrus")
    for c in range(2):
        z = R @ [cos(c * 1.3), sin(c * 1.3), 0]
        p = rng.uniform(-1, 1, (3, 3))
        w.turn("ground", f"a{c}", p[0], z)
        w.turn(f"a{c}", f"b{c}", p[1], z)
        w.turn(f"b{c}", "top", p[2], z)
    return w, 1


def frameworks(rng: np.random.Generator) -> Truth | None:
    """K(m, n) in the plane or space: what the rank says where bars are independent; on a conic,
    shaky, it is rigid.
    """
    dim = int(rng.integers(2, 4))
    if rng.random() < 0.4:
        t = rng.uniform(0, 2 * pi, 6)
        if np.abs(np.subtract.outer(t, t) % (2 * pi))[~np.eye(6, dtype=bool)].min() < 0.2:
            return None
        points = np.stack([1.7 * np.cos(t), np.sin(t)], axis=1) @ rotation(rng)[:2, :2]
        if np.linalg.cond(points.T @ points) > 50:
            return None
        return framework("K33 on a conic", points, bipartite(3, 3), (0, 3), 2), 0
    m = int(rng.integers(2, 5))
    n = int(rng.integers(2, 5))
    points = rng.uniform(-1, 1, (m + n, dim))
    edges = bipartite(m, n)
    rigidity = np.zeros((len(edges), dim * (m + n)))
    for row, (i, k) in enumerate(edges):
        rigidity[row, dim * i : dim * i + dim] = points[i] - points[k]
        rigidity[row, dim * k : dim * k + dim] = points[k] - points[i]
    pinned = (0, m) if dim == 2 else (0, 1, m)
    keep = [d for i in range(m + n) if i not in pinned for d in range(dim * i, dim * i + dim)]
    rows = [r for r, (i, k) in enumerate(edges) if not (i in pinned and k in pinned)]
    A = rigidity[np.ix_(rows, keep)]
    sigma = np.linalg.svd(A, compute_uv=False)
    if not len(rows) or not keep or sigma[-1] < 1e-3:
        return None
    return framework("K", points, edges, pinned, dim), max(A.shape[1] - A.shape[0], 0)


def bipartite(m: int, n: int) -> list[tuple[int, int]]:
    return [(i, m + k) for i in range(m) for k in range(n)]


def bars(rng: np.random.Generator) -> Truth | None:
    """Random bars with two or three loops: where their constraints are independent, what is left of
    3 a body.
    """
    n = int(rng.integers(3, 9))
    w = World("bars", 2)
    edges = [(int(rng.integers(0, i)), i) for i in range(1, n + 1)]
    while len(edges) < n + 2 + int(rng.integers(0, 2)):
        i, k = sorted(rng.choice(n + 1, size=2, replace=False).tolist())
        edges.append((i, k))
    G = np.zeros((2 * len(edges), 3 * n + 3))
    for r, (i, k) in enumerate(edges):
        x, y = rng.uniform(-1, 1, 2)
        w.turn("ground" if i == 0 else f"b{i}", f"b{k}", (x, y))
        for body, sign in ((i, -1.0), (k, 1.0)):
            G[2 * r : 2 * r + 2, 3 * body : 3 * body + 3] += sign * np.array(
                [[1, 0, -y], [0, 1, x]]
            )
    A = G[:, 3:]
    sigma = np.linalg.svd(A, compute_uv=False)
    return None if sigma[-1] < 1e-3 else (w, max(A.shape[1] - A.shape[0], 0))


def hinges(rng: np.random.Generator) -> Truth:
    """A loop of random hinges in space: n - 6, or rigid; with three of them about one point no
    less.
    """
    n = int(rng.integers(4, 9))
    joints = [("revolute", rng.uniform(-1, 1, 3), unit(rng.normal(size=3))) for _ in range(n)]
    if rng.random() < 0.3:
        joints[:3] = [("revolute", joints[0][1], z) for _, _, z in joints[:3]]
    return loop("hinges", joints), max(n - 6, 0)


def gimbal(rng: np.random.Generator) -> Truth:
    """Hinges about three axes through one point, the third in line with the first, and rods: the
    middle turns.
    """
    w = World("gimbal")
    rods = int(rng.integers(1, 4))
    w.turn("ground", "outer", (0, 0, 0), Z)
    w.turn("outer", "middle", (0, 0, 0), Y)
    w.turn("middle", "inner", (0, 0, 0), Z)
    for _ in range(rods):
        w.rod("ground", "inner", rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 3))
    return w, max(3 - rods, 1)


def stopped_row(rng: np.random.Generator) -> Truth:
    """A row of flat parallelograms whose first crank is stretched with a bar: rigid, one after the
    other.
    """
    w, _ = row_of_parallelograms(rng)
    end = w.joints[1][4]
    more = float(rng.uniform(0.5, 1.5))
    w.turn("c0", "stop", end)
    w.turn("stop", "ground", end + more * X)
    return w, 0


def nearly_flat(rng: np.random.Generator) -> Truth | None:
    """A flat loop that is bent by more than rounding: regular, a motion even where the flat one is
    rigid.
    """
    n = int(rng.integers(3, 6))
    w = World("nearly flat", 2)
    off = 10.0 ** rng.uniform(-10, -1)
    v = rng.uniform(0.6, 1.4, size=n) * rng.choice([1, -1], size=n)
    if abs(v.sum()) < 0.2:
        return None
    points = np.stack([np.concatenate([[0.0], np.cumsum(v)]), off * rng.normal(size=n + 1)], axis=1)
    bodies = ["ground", *(f"b{i}" for i in range(n)), "ground"]
    for i in range(n + 1):
        w.turn(bodies[i], bodies[i + 1], points[i])
    return w, n - 2


def nearly_parallel(rng: np.random.Generator) -> Truth:
    """Two chains of three hinges whose directions differ by what is no rounding: one straight line,
    as Sarrus' has.
    """
    R = rotation(rng)
    w = World("nearly parallel")
    off = 10.0 ** rng.uniform(-10, -1)
    for c in range(2):
        z = R @ [cos(c * off), sin(c * off), 0]
        p = rng.uniform(-1, 1, (3, 3))
        w.turn("ground", f"a{c}", p[0], z)
        w.turn(f"a{c}", f"b{c}", p[1], z)
        w.turn(f"b{c}", "top", p[2], z)
    return w, 1


def nearly_coplanar(rng: np.random.Generator) -> Truth:
    """Three slides in a loop whose directions leave one plane by what is no rounding: rigid."""
    R = rotation(rng)
    off = 10.0 ** rng.uniform(-10, -1)
    along = [
        [cos(a), sin(a), off * (k == 2)] for k, a in enumerate(np.cumsum(rng.uniform(0.5, 0.9, 3)))
    ]
    return loop(
        "nearly coplanar", [("prismatic", rng.uniform(-1, 1, 3), R @ unit(a)) for a in along]
    ), 0


def nearly_overconstrained(rng: np.random.Generator) -> Truth:
    """Three cranks of one length and direction but for an error that is no rounding: rigid; in the
    plane or space.
    """
    off = 10.0 ** rng.uniform(-10, -1)
    v = rng.uniform(-1, 1, 2)
    w = World("nearly", int(rng.integers(2, 4)))
    for k, p in enumerate(rng.uniform(-2, 2, (3, 2))):
        w.turn("ground", f"c{k}", p)
        w.turn(f"c{k}", "top", p + v + off * (k == 2) * unit(rng.normal(size=2)))
    return w, 0


def three_cranks(rng: np.random.Generator) -> Truth:
    """Cranks of one length and direction: one of them is redundant, and the platform goes around."""
    v = rng.uniform(-1, 1, 2)
    w = World("cranks", int(rng.integers(2, 4)))
    for k, p in enumerate(rng.uniform(-2, 2, (int(rng.integers(2, 6)), 2))):
        w.turn("ground", f"c{k}", p)
        w.turn(f"c{k}", "top", p + v)
    return w, 1


def wunderlich(rng: np.random.Generator) -> Truth:
    """The edges of a box, flat: five motions of two freedoms, eight of one (Wunderlich, 1954); rods
    or bars.
    """
    length = np.cumsum(rng.uniform(0.2, 0.6, 3))
    rng.shuffle(length)
    corners = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    points = [(float(np.dot(c, length)), 0.0) for c in corners]
    edges = [
        (a, b)
        for a in range(8)
        for b in range(a)
        if np.abs(np.subtract(corners[a], corners[b])).sum() == 1
    ]
    if rng.random() < 0.5:
        return framework("Wunderlich of rods", points, edges, (0, 4), 2), 2
    w = World("Wunderlich of bars", 2)
    first = {}
    for a, b in edges:
        bar = "ground" if {a, b} == {0, 4} else f"bar{a}{b}"
        for c in (a, b):
            if c in first:
                w.turn(first[c], bar, points[c])
            else:
                first[c] = bar
    return w, 2


def side_by_side(rng: np.random.Generator) -> Truth:
    """Four mechanisms that share nothing but the ground, one of them singular: their numbers add
    up.
    """
    whole = World("side by side", 2)
    total = 0
    odd = int(rng.integers(4))
    for n in range(4):
        part, truth = dead_centres(rng, 1) if n == odd else three_cranks(rng)
        total += truth
        name = {"ground": "ground"}
        for kind, a, b, p in ((j[1], j[2], j[3], j[4]) for j in part.joints):
            a, b = (name.setdefault(body, f"{body}_{n}") for body in (a, b))
            whole.joint(kind, a, b, p + [0.0, 3.0 * n, 0.0])
    return whole, total


def moved(rng: np.random.Generator, world: World) -> dict:
    """Scale and motion with which to build it."""
    twist = rng.uniform(-1, 1, 6) * (1 if world.dim == 3 else np.array([1, 1, 0, 0, 0, 1]))
    return {"scale": 10.0 ** rng.uniform(-3, 3), "move": exp_se3(twist)}


KINDS = (
    dead_centres,
    weak_dead_centres,
    flat_loop,
    row_of_parallelograms,
    parallelograms_apart,
    scissor,
    loop_in_a_group,
    sarrus,
    frameworks,
    bars,
    hinges,
    gimbal,
    stopped_row,
    nearly_flat,
    nearly_parallel,
    nearly_coplanar,
    nearly_overconstrained,
    three_cranks,
    wunderlich,
    side_by_side,
)
