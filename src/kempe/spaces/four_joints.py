"""Components of the configuration space of loops of four joints, by dead points and limits.

Two points, each guided by a crank or a slide, are the ends of a rod: |p(x) - r(y)| = L. For a crank
y that is A cos y + B sin y + C = 0, for a slide a quadratic equation, and y is real where the
discriminant D(x) >= 0 (Freudenstein, Kiss, "Type determination of skew four-bar mechanisms", J. Eng.
Ind. 91, 1969). Zeros of D are the dead points. Four turns about axes through one point are such a
loop, too: p and r are the directions of the coupler's axes, on the unit sphere; so are four turns
about parallel axes, seen along them. Between dead points, and places at which a joint reaches a
limit, each of the two branches y exists throughout or nowhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.assemble.assemble import assemble
from kempe.assemble.modes import assembly_modes
from kempe.equations.judge import multiply_primitives
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.forward.limits import with_limits
from kempe.joints import P, Q, R
from kempe.model.configurations import compute_mid_configuration, find_free_angles
from kempe.model.model import keep_answers
from kempe.numerics.roots import find_sign_change
from kempe.spaces.manifold import Manifold
from kempe.spaces.only_loop import find_only_loop, list_primitives, locate_joint
from kempe.spatial import Array, inverse
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.model import Model

SAME = 1e-12
"""Part of the size up to which points are one and directions parallel."""
TOUCHING = 4e-12
"""Part of the largest discriminant up to which a smallest or largest one counts as zero."""
NEAR = 1e-7
"""How near to a dead point or a limit, as a part of the range, no component is named."""
FIRST_CUT = 0.1 - math.pi
"""Angle at which a full turn is cut open: not round, so that no event is expected there."""
UNDECIDED = "its dead points and limits are too near to one another to be told apart"


class Rod(NamedTuple):
    """A rod of a `length` between the points p(x) and r(y). These are coefficients of 1, cos and
    sin of a crank's angle, (3, 3), or of 1 and a slide, (2, 3).
    """

    p: Array
    r: Array
    length: float

    def compute_discriminant(self, x: Array) -> Array:
        """Compute the discriminant D(x), which is positive where two solutions y exist."""
        return self._compute_coefficients(x)[-1]

    def exchange_ends(self) -> Rod:
        """Return the same rod with its ends exchanged."""
        return Rod(self.r, self.p, self.length)

    def solve_branch(self, x: Array, sign: Array | float) -> Array:
        """Solve for y on one branch, or with the sign 0 where both branches meet."""
        *parts, D = self._compute_coefficients(x)
        h = np.sqrt(np.maximum(D, 0.0)) * sign
        if len(self.r) == 2:
            along, square = parts
            return (along + h) / square
        A, B, C = parts
        return np.arctan2(A * h - C * B, -C * A - B * h)

    def compute_branch_sign(self, x: Array, y: Array) -> Array:
        """Compute the signed branch of y at x, from about -1 to 1. It is 0 where two branches meet."""
        *parts, _ = self._compute_coefficients(x)
        if len(self.r) == 2:
            along, square = parts
            return (y * square - along) / math.sqrt(square)
        A, B, _ = parts
        return (A * np.sin(y) - B * np.cos(y)) / np.maximum(np.hypot(A, B), 1e-300)

    def _compute_coefficients(self, x: Array) -> tuple[Array, ...]:
        """Compute the coefficients of the equation for y at x."""
        way = _evaluate_basis(x, len(self.p)) @ self.p - self.r[0]
        far = np.sum(way**2, axis=-1) - self.length**2
        if len(self.r) == 2:
            along = way @ self.r[1]
            square = float(self.r[1] @ self.r[1])
            return along, np.array(square), along**2 - far * square
        A = way @ self.r[1] * -2.0
        B = way @ self.r[2] * -2.0
        C = far + float(self.r[1] @ self.r[1])
        return A, B, C, A**2 + B**2 - C**2

    def find_turning_points(self) -> Array:
        """Find values of x between which D is monotone: all extrema, and perhaps further values."""
        if len(self.p) == 2:
            before, at, after = self.compute_discriminant(np.array([-1.0, 0.0, 1.0])).tolist()
            bend = 0.5 * (before + after) - at
            flat = abs(bend) <= SAME * max(abs(before), abs(at), abs(after))
            return np.array([] if flat else [0.25 * (before - after) / bend])
        # a trigonometric polynomial of degree 2 in x, whose derivative has four zeros exp(i x)
        wave = np.fft.fft(self.compute_discriminant(np.linspace(0.0, 2.0 * np.pi, 9)[:8]))
        slopes = np.array([2.0 * wave[2], wave[1], 0.0, -wave[-1], -2.0 * wave[-2]])
        large = np.abs(slopes) > 1e-15 * np.abs(wave).max(initial=1e-300)
        return np.asarray(np.angle(np.roots(np.where(large, slopes, 0.0))), dtype=float)


def _evaluate_basis(x: Array, n: int) -> Array:
    """Evaluate the basis functions 1 and x, or 1, cos(x) and sin(x), (..., n) at x (...)."""
    x = np.asarray(x, dtype=float)
    return np.stack([np.ones_like(x), *((x,) if n == 2 else (np.cos(x), np.sin(x)))], axis=-1)


@dataclass(frozen=True, eq=False)
class FourJoints:
    """A loop of four joints over the coordinate `first`, on two branches of the coordinate `last`.

    `cuts` (n + 1,) are the ends of its n pieces, `label` (n, 2) the component of each piece on the
    branches with the signs 1 and -1, or -1 where nothing closes within the limits; `touching` are
    places where both branches meet without an end.
    """

    system: Model
    rod: Rod
    first: str
    last: str
    closes: bool
    cuts: Array = field(repr=False)
    label: np.ndarray = field(repr=False)
    dead: Array
    touching: Array

    @property
    def count(self) -> int:
        """Number of components."""
        return int(self.label.max(initial=-1)) + 1

    @property
    def reason(self) -> str:
        """The reason for the number of components."""
        said = f"{format_count(len(self.dead), 'dead point')} over {self.first!r}"
        if len(self.touching):
            said += (
                f", and {format_count(len(self.touching), 'place')} where branches touch, to "
                "rounding"
            )
        cut = len(self.cuts) - 2 - len(self.dead) - len(self.touching)
        said += "; cut by limits" if cut > 0 else ""
        return f"{said} (two branches of {self.last!r}: Freudenstein and Kiss, 1969)"

    @property
    def starts(self) -> Array:
        """One configuration (count, nq) on each component, in the middle of its widest piece."""
        wide = np.where(self.label.T >= 0, np.diff(self.cuts), -1.0).T
        x = np.empty(self.count)
        sign = np.empty(self.count)
        for c in range(self.count):
            i, k = divmod(int(np.argmax(np.where(self.label == c, wide, -1.0))), 2)
            x[c] = 0.5 * (self.cuts[i] + self.cuts[i + 1])
            sign[c] = 1.0 - 2.0 * k
        q, ok = _solve_configurations(self.system, self.rod, self.first, self.last, x, sign)
        return Manifold(self.system, 1).metric.choose_representatives(q[ok], None)

    @property
    def singular_points(self) -> Array:
        """Configurations (k, nq) at which branches touch."""
        q, ok = _solve_configurations(
            self.system, self.rod, self.first, self.last, self.touching, np.zeros(1)
        )
        return q[ok]

    def label_components(self, q: Array) -> np.ndarray:
        """Label configurations (k, nq) with their components (k,), -1 where uncertain."""
        names = self.system.coordinate_names
        x = q[:, names.index(self.first)]
        size = self.rod.compute_branch_sign(x, q[:, names.index(self.last)])
        if self.closes:
            x = self.cuts[0] + np.mod(x - self.cuts[0], 2.0 * np.pi)
        room = NEAR * (self.cuts[-1] - self.cuts[0])
        out = np.full(len(q), -1)
        for i in range(len(q)):
            ends = np.searchsorted(self.cuts, [x[i] - room, x[i] + room]) - 1
            pieces = np.unique(np.clip(ends, 0, len(self.label) - 1))
            branches = [k for k in (0, 1) if size[i] * (1 - 2 * k) > -NEAR]
            near = self.label[pieces][:, branches]
            known = np.unique(near[near >= 0])
            out[i] = known[0] if len(known) == 1 else -1
        return out


@keep_answers
def find_four_joints(system: Model) -> FourJoints | str:
    """Find the loop of four joints in a system, or the reason why its components cannot be decided."""
    loop = find_only_loop(system)
    if isinstance(loop, str):
        return loop
    bodies, names = loop
    if pack_one_sided_rows(system).declared or len(bodies) != 4:
        return "it has one-sided constraints, or other than four joints in its loop"
    joints = [system.structure.joints[n] for n in names]
    turns = dict(zip(system.structure.velocity_names, find_free_angles(system), strict=True))
    ways: list[tuple[bool, Joint, Joint, Rod]] = []
    for k in range(4):
        for step in (1, -1):
            at = [(k + step * i) % 4 for i in range(4)]
            # joint k lies between bodies k and k + 1: going back, the bodies shift by one
            ring = [bodies[i if step > 0 else (i + 1) % 4] for i in at]
            order = [joints[i] for i in at]
            rod = _make_rod(system, ring, order)
            if rod is not None and _is_single_valued(system, order):
                ways.append((not turns[order[0].name], order[0], order[3], rod))
    if not ways:
        return (
            "it is no rod between two points that cranks or slides guide, nor four turns of a "
            "sphere"
        )
    ways.sort(key=lambda way: (len(way[3].p) == 2, way[0]))
    for _, first, last, rod in ways:
        found = _decide_components(system, rod, first.name, last.name, list(names))
        if not isinstance(found, str):
            return found
    return UNDECIDED


def _list_limits(system: Model, name: str) -> tuple[float, float]:
    """Return the lower and upper limit of a joint."""
    k = system.structure.velocity_names.index(name)
    return float(system.lower[k]), float(system.upper[k])


def _is_single_valued(system: Model, order: list[Joint]) -> bool:
    """Whether limits of all joints but the first can be checked without counting whole turns."""
    own = {*system.coordinate_names} & {*system.structure.velocity_names}
    rows = pack_one_sided_rows(system).names
    for k, joint in enumerate(order):
        limited = any(n == joint.name or n.startswith(f"{joint.name}.") for n in rows)
        if joint.name not in own:
            if limited or k in (0, 3):
                return False
            continue
        if limited and k in (1, 2) and system.dim == 3:
            return False
        low, high = _list_limits(system, joint.name)
        turns = list_primitives(system, joint)[0].kind == R
        if turns and k and limited and not high - low < 2.0 * math.pi * (1.0 - 1e-9):
            return False
    return True


# ---- pieces between events, and how they are joined


def _decide_components(
    system: Model, rod: Rod, first: str, last: str, names: list[str]
) -> FourJoints | str:
    """Decide the components of a loop over one coordinate, or return the reason why that is
    impossible.
    """
    low, high = _list_limits(system, first)
    closes = not (math.isfinite(low) or math.isfinite(high)) and len(rod.p) == 3
    marks = rod.find_turning_points()
    if closes:
        low = FIRST_CUT
        high = FIRST_CUT + 2.0 * math.pi
    elif len(rod.p) == 2:
        size = rod.length + float(np.abs(rod.p).max() + np.abs(rod.r).max())
        low, high = np.clip(
            [low, high], *(marks.min(initial=0.0) - size, marks.max(initial=0.0) + size)
        )
    elif not math.isfinite(high - low):
        return "a turn that is limited on one side only"
    marks = np.unique(np.concatenate([[low, high], _select_inside(rod, marks, low, high)]))
    D = rod.compute_discriminant(marks)
    scale = float(np.abs(rod.compute_discriminant(np.linspace(low, high, 17))).max())
    size = float(np.abs(rod.p).max() + np.abs(rod.r).max() + rod.length)
    if scale <= SAME * size ** (2 if len(rod.r) == 2 else 4):
        return "a whole circle of configurations over one value"
    flat = np.abs(D) <= TOUCHING * scale
    clear = np.where(flat, 0.0, D)
    changes = [
        find_sign_change(
            lambda x: float(rod.compute_discriminant(np.array(x))),
            float(marks[i]),
            float(marks[i + 1]),
        )
        for i in np.flatnonzero(clear[:-1] * clear[1:] < 0.0)
    ]
    dead = [x for x in changes if x is not None]
    touching = marks[1:-1][flat[1:-1]] if not flat[[0, -1]].any() else None
    events = _find_limit_events(system, rod, first, last, names, low, high)
    if touching is None or events is None:
        return UNDECIDED
    limited = len(events) > 0 or _has_limits(system, [n for n in names if n != first])
    if len(touching) and limited:
        return UNDECIDED
    cuts = np.sort(np.concatenate([[low, high], dead, touching, events]))
    if np.diff(cuts).min() <= NEAR**1.25 * (high - low):
        cuts = cuts[np.append(True, np.diff(cuts) > 0.0)]
        if limited:
            return UNDECIDED
    middle = 0.5 * (cuts[:-1] + cuts[1:])
    alive = np.repeat(rod.compute_discriminant(middle)[:, None] > 0.0, 2, axis=1)
    if limited:
        for k, sign in enumerate((1.0, -1.0)):
            at = np.flatnonzero(alive[:, k])
            q, ok = _solve_configurations(
                system, rod, first, last, middle[at], np.full(len(at), sign)
            )
            if not ok.all():
                return UNDECIDED
            manifold = Manifold(system, 1)
            alive[at, k] = manifold.are_allowed(manifold.metric.choose_representatives(q, None))
    n = len(middle)
    node = np.arange(2 * n).reshape(n, 2)
    pairs: list[tuple[int, int]] = []
    for i in range(0 if closes else 1, n):
        x = cuts[i]
        for k in (0, 1):
            if alive[i - 1, k] and alive[i, k]:
                pairs.append((node[i - 1, k], node[i, k]))
        if np.isin(x, dead) or np.isin(x, touching):
            sides = [j % n for j in (i - 1, i) if alive[j % n].all()]
            pairs += [(node[j, 0], node[j, 1]) for j in sides]
            if np.isin(x, touching) and not sides:
                return UNDECIDED  # a point by itself
    group = node.ravel().copy()
    for a, b in pairs:
        group[group == max(group[a], group[b])] = min(group[a], group[b])
    group = group.reshape(n, 2)
    label = np.full((n, 2), -1)
    label[alive] = np.unique(group[alive], return_inverse=True)[1]
    return FourJoints(
        system, rod, first, last, closes, cuts, label, np.array(dead), np.asarray(touching)
    )


def _has_limits(system: Model, names: list[str]) -> bool:
    """Whether one of these joints has a finite limit."""
    return any(
        n in system.structure.velocity_names and np.isfinite(_list_limits(system, n)).any()
        for n in names
    )


def _find_limit_events(
    system: Model, rod: Rod, first: str, last: str, names: list[str], low: float, high: float
) -> Array | None:
    """Find values of the first coordinate at which another joint reaches a limit. None if not all
    are known.
    """
    out: list[float] = []
    back = rod.exchange_ends()
    for name in names:
        if name == first or name not in system.structure.velocity_names:
            continue
        for limit in _list_limits(system, name):
            if not math.isfinite(limit):
                continue
            if name == last:
                D = float(back.compute_discriminant(np.array(limit)))
                scale = np.abs(back.compute_discriminant(np.linspace(-3.0, 3.0, 13))).max()
                if abs(D) <= TOUCHING * scale:
                    return None
                out += (
                    back.solve_branch(np.full(2, limit), np.array([1.0, -1.0])).tolist()
                    if D > 0.0
                    else []
                )
            else:
                modes = assembly_modes(
                    _remove_limits(system), {name: limit} | _choose_other_values(system, names)
                )
                if not modes.complete:
                    return None
                out += modes.q[:, system.coordinate_names.index(first)].tolist()
    return _select_inside(rod, np.array(out), low, high)


def _select_inside(rod: Rod, x: Array, low: float, high: float) -> Array:
    """Select values (k,) of the first coordinate between two bounds. Angles may differ by whole
    turns.
    """
    if len(rod.p) == 3:
        whole = np.arange(math.floor((low - math.pi) / 2.0 / math.pi), high / 2.0 / math.pi + 1.0)
        x = (x[:, None] + 2.0 * np.pi * whole).ravel()
    return x[(x > low) & (x < high)]


@keep_answers
def _remove_limits(system: Model) -> Model:
    """Return the system without limits."""
    own = {*system.coordinate_names}
    return with_limits(system, {n: None for n in system.structure.velocity_names if n in own})


def _choose_other_values(system: Model, names: list[str]) -> dict[str, float]:
    """Choose values of coordinates of joints outside the loop: the middle of their limits."""
    rest = compute_mid_configuration(system)
    return {
        n: float(rest[k])
        for k, n in enumerate(system.coordinate_names)
        if n.partition(".")[0] not in names and n in system.structure.velocity_names
    }


def _solve_configurations(
    system: Model, rod: Rod, first: str, last: str, x: Array, sign: Array
) -> tuple[Array, np.ndarray]:
    """Solve for configurations (k, nq) at values (k,) of the first coordinate on branches (k,). A
    mask tells which close.
    """
    if not len(x):
        return np.empty((0, system.nq)), np.zeros(0, dtype=bool)
    loop = find_only_loop(system)
    names = list(loop[1]) if not isinstance(loop, str) else []
    known = {first: x, last: rod.solve_branch(x, sign)} | {
        n: np.full(len(x), value) for n, value in _choose_other_values(system, names).items()
    }
    found = assemble(_remove_limits(system), known)
    return np.asarray(found.q), np.asarray(found.success, dtype=bool)


# ---- the rod of a loop


def _make_rod(system: Model, ring: list[str], joints: list[Joint]) -> Rod | None:
    """Make the rod of a loop: between points, between directions, or between parallel axes. Where
    both ends turn, lengths are fractions of the loop's size.
    """
    base, crank, rod, rocker = ring
    first, ball, other, last = joints
    kinds = [[p.kind for p in list_primitives(system, j)] for j in joints]
    if kinds[0] not in ([R], [P]) or kinds[3] not in ([R], [P]):
        return None
    ends = locate_joint(system, ball, crank)[0], locate_joint(system, other, rocker)[0]
    points = [[Q], [Q]] if system.dim == 3 else [[R], [R]]
    if kinds[1:3] == points:
        length = float(
            np.linalg.norm(locate_joint(system, ball, rod)[0] - locate_joint(system, other, rod)[0])
        )
        p = _compute_path_coefficients(system, first, base, ends[0], 1.0)
        r = _compute_path_coefficients(system, last, base, ends[1], 1.0)
        return Rod(p, r, length) if length > 0.0 else None
    if kinds != [[R], [R], [R], [R]]:
        return None
    axes = {
        (joints[k].name, b): _locate_axis(system, joints[k], b)
        for k in range(4)
        for b in (ring[k], ring[(k + 1) % 4])
    }
    pairs = [[axes[joints[k - 1].name, b], axes[joints[k].name, b]] for k, b in enumerate(ring)]
    _, u = axes[ball.name, crank]
    _, v = axes[other.name, rocker]
    if _are_concurrent(pairs):
        length = float(np.linalg.norm(axes[ball.name, rod][1] - axes[other.name, rod][1]))
        p = _compute_path_coefficients(system, first, base, u, 0.0)
        r = _compute_path_coefficients(system, last, base, v, 0.0)
        return Rod(p, r, length) if SAME < 0.25 * length**2 < 1.0 - SAME else None
    if not _are_parallel(pairs):
        return None
    n = axes[first.name, base][1]
    x, _ = axes[ball.name, rod]
    y, m = axes[other.name, rod]
    length = float(np.linalg.norm((y - x) - m * (m @ (y - x))))
    p = _compute_path_coefficients(system, first, base, ends[0], 1.0)
    r = _compute_path_coefficients(system, last, base, ends[1], 1.0)
    return Rod(p - (p @ n)[:, None] * n, r - (r @ n)[:, None] * n, length)


def _compute_path_coefficients(
    system: Model, joint: Joint, base: str, point: Array, weight: float
) -> Array:
    """Compute coefficients of 1, cos and sin, or of 1 and the slide, of a point on a crank or
    slider. They are seen from the base; weight 0 stands for a direction.
    """
    F = joint.X_PF.evaluate_pose(system._mechanism.parameters)
    M = joint.X_CM.evaluate_pose(system._mechanism.parameters)
    turns = list_primitives(system, joint)[0].kind == R
    at = 2.0 * np.pi / 3.0 * np.arange(3.0) if turns else np.array([0.0, 1.0])
    X = F @ multiply_primitives(list_primitives(system, joint), at[:, None]) @ inverse(M)
    X = X if joint.parent == base else inverse(X)
    wave = _evaluate_basis(at, 3 if turns else 2)
    return np.asarray(np.linalg.solve(wave, (X @ np.append(point, weight))[:, :3]), dtype=float)


def _locate_axis(system: Model, joint: Joint, body: str) -> tuple[Array, Array]:
    """Return a point and the direction of a revolute joint's axis, in the axes of one of its
    bodies.
    """
    X = locate_joint(system, joint, body)[1]
    return X[:3, 3], X[:3, "xyz".index(list_primitives(system, joint)[0].axis)]


Axis = tuple[Array, Array]


def _are_concurrent(pairs: list[list[Axis]]) -> bool:
    """Whether the axes of joints k - 1 and k meet on each body, at one place for both bodies."""
    places: list[tuple[float, float]] = []
    for (x, u), (y, v) in pairs:
        c = float(u @ v)
        w = y - x
        det = 1.0 - c * c
        if det < SAME:
            return False
        s = float(w @ (u - c * v)) / det
        t = float(w @ (c * u - v)) / det
        if np.linalg.norm(x + s * u - y - t * v) > SAME * (1.0 + np.linalg.norm(w)):
            return False
        places.append((s, t))
    size = 1.0 + max(abs(x) for two in places for x in two)
    return all(abs(places[k][1] - places[(k + 1) % 4][0]) < SAME * size for k in range(4))


def _are_parallel(pairs: list[list[Axis]]) -> bool:
    """Whether the axes on each body are parallel, and the offsets along them sum to zero."""
    step = 0.0
    sense = 1.0
    size = 1.0
    for (x, u), (y, v) in pairs:
        if np.linalg.norm(np.cross(u, v)) > SAME:
            return False
        step = step + sense * float(u @ (y - x))
        sense = sense * float(u @ v)
        size = size + float(np.linalg.norm(y - x))
    return abs(step) < SAME * size and sense > 0.0
