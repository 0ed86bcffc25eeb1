"""Inverse kinematics of arms with seven joints: all configurations over the arm angle.

Seven turns: three axes that meet in the shoulder point S, the elbow axis, three axes that meet in
the wrist point W. A pose fixes W, and |SW| the elbow's angle; the arm can still turn about the line
SW. The *arm angle* psi says how far:

    E    the elbow point: the point of the elbow axis that is nearest to S
    v    the direction from S to W
    psi  the angle about v that brings the half plane through SW and `reference`
         to the half plane through SW and E

`reference` is a direction in ground axes: that of the first joint's axis, where no other is named.
For arms whose first axis is vertical, psi = 0 has the elbow straight above the line SW, in the
vertical plane, where q3 = 0 in the usual designs (Kreutz-Delgado, Long and Seraji, IJRR 11(5),
1992). Singular cases: where v lies along `reference`, the x axis of the ground stands for it (the y
axis where that lies along v too), so that psi jumps there; where the arm is stretched, E lies on
SW, and psi is the limit that is reached from the elbow's branch "+".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.answers.targets import Z_AXIS
from kempe.arguments import explain_errors
from kempe.arrays import read_reals
from kempe.errors import InputError, UnsupportedError
from kempe.inverse.closed_forms.chain_lines import Lines, find_chain_lines
from kempe.inverse.closed_forms.structure import find_meeting_point, is_spherical_triple
from kempe.kernels.forward.table_layout import TURN
from kempe.model.configurations import read_q
from kempe.model.model import keep_answers
from kempe.numerics.intervals import join_arcs, split_circle
from kempe.spatial import Array
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model

SHOULDER = (0, 1, 2)
ELBOW = 3
WRIST = (4, 5, 6)
"""Places of the joints."""

BRANCHES = tuple((e, s, w) for e in (0, 1) for s in (0, 1) for w in (0, 1))
"""Branches of elbow, shoulder and wrist: 0 where the middle joint is turned in its positive sense,
counted from where its neighbours are closest to each other (for the elbow: the arm is longest), 1
where in its negative sense."""

ALONG = 1e-9
STRETCHED = 1e-9
"""Sine between v and the reference, distance of E from SW in lengths of the arm, below which these
are singular."""

MERGED = 1e-13
"""Discriminants down to minus this are taken as zero: the two branches have merged."""

FITS = 1e-10
"""How far beyond a limit a joint may be and count as inside, as in `ik_all`."""

ROUNDING = 1e-14
"""Sine below which a direction lies along an axis."""

AT_REACH = 4e-15
"""Fraction of its reach by which an arm that counts as stretched, or folded, may fall short of
it."""

TWO_PI = 2.0 * math.pi


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm of seven joints: its lines, points S, E and W at theta = 0, and its reference.

    The distance of shoulder and wrist is |SW|^2 = size + cosine c4 + sine s4.
    """

    lines: Lines
    shoulder: Array
    elbow: Array
    wrist: Array
    reference: Array
    size: float
    cosine: float
    sine: float

    def compute_upper_arm(self, theta: Array) -> tuple[Array, Array]:
        """Compute W - S and E - S, (..., 3), for the elbow at theta (...), the shoulder at rest."""
        o = self.elbow
        W = o + compute_rotations(self.lines.h[ELBOW], theta) @ (self.wrist - o)
        return W - self.shoulder, np.broadcast_to(o - self.shoulder, W.shape)

    @property
    def stretched_angle(self) -> float:
        """Angle of the elbow at which the arm is longest."""
        return math.atan2(self.sine, self.cosine)


def recognise_arm(lines: Lines, reference: ArrayLike | None = None) -> Arm | str:
    """Recognise the arm of a chain, or return the reason why it is none.

    Errors: `InputError` for the reference.
    """
    if len(lines) != 7:
        return f"it has {format_count(len(lines), 'joint')}, not seven"
    if np.any(lines.kinds != TURN):
        return "not all of its joints turn"
    if not is_spherical_triple(lines, 0):
        return "its first three axes do not meet in a point"
    if not is_spherical_triple(lines, 4):
        return "its last three axes do not meet in a point"
    S = find_meeting_point(lines, SHOULDER)
    W = find_meeting_point(lines, WRIST)
    assert S is not None and W is not None
    h = lines.h[ELBOW]
    o = lines.o[ELBOW]
    E = o + h * (h @ (S - o))
    foot = E + h * (h @ (W - E))
    out = W - foot
    up = foot - S
    cosine = 2.0 * up @ out
    sine = 2.0 * up @ np.cross(h, out)
    if math.hypot(cosine, sine) < 1e-6:
        return "its fourth joint does not change the distance between shoulder and wrist"
    return Arm(
        lines,
        S,
        E,
        W,
        _read_reference(lines, reference),
        float(up @ up + out @ out),
        float(cosine),
        float(sine),
    )


def _read_reference(lines: Lines, given: ArrayLike | None) -> Array:
    """Read the reference direction as a unit vector (3,)."""
    if given is None:
        return lines.h[0]
    z = read_reals(given, "reference")
    size = float(np.linalg.norm(z)) if z.shape == (3,) else math.nan
    if not (math.isfinite(size) and size > 0.0):
        raise InputError(
            f"reference is {given!r}; it must be a direction, three numbers that are not all zero"
        )
    return z / size


def find_arm(system: Model, frame: str, reference: ArrayLike | None = None) -> Arm | str:
    """Find the arm that moves a frame, or the reason why there is none.

    Errors: `InputError`.
    """
    if reference is not None:
        return recognise_arm(find_chain_lines(system, frame, Z_AXIS), reference)
    return _find_default_arm(system, frame)


@keep_answers
def _find_default_arm(system: Model, frame: str) -> Arm | str:
    """Find the arm of a frame with the default reference, once."""
    return recognise_arm(find_chain_lines(system, frame, Z_AXIS))


def require_arm(system: Model, frame: str, reference: ArrayLike | None = None) -> Arm:
    """Return the arm that moves a frame.

    Errors: `UnsupportedError` for other chains, with the reason.
    """
    arm = find_arm(system, frame, reference)
    if isinstance(arm, str):
        raise UnsupportedError(explain_missing_arm(system, frame, arm))
    return arm


def explain_missing_arm(system: Model, frame: str, why: str) -> str:
    """Write the sentence that a frame's chain has no arm angle."""
    names = ", ".join(find_chain_lines(system, frame, Z_AXIS).names)
    return f"the chain of {frame!r} has no arm angle: {why}; name one of its joints: {names}"


@explain_errors
def compute_arm_angle(
    system: Model, q: Any, frame: FrameLike, reference: ArrayLike | None = None
) -> Any:
    """Compute the arm angle (...) of configurations q (..., nq), in (-pi, pi]; a float for one.

    The module defines the angle.

    reference: a direction (3,) in ground axes, by default that of the first joint's axis. Errors:
    `UnsupportedError` for chains that are not shoulder, elbow and wrist of seven joints,
    `InputError`.
    """
    arm = require_arm(system, system.structure.frame_name(frame), reference)
    theta = arm.lines.compute_theta(read_q(system, q)[..., arm.lines.q_index])
    R = np.eye(3)
    for i in SHOULDER:
        R = R @ compute_rotations(arm.lines.h[i], theta[..., i])
    along, out = _compute_directions(arm, theta[..., ELBOW])
    v = _apply_rotations(R, along)
    e = _apply_rotations(R, out)
    r = compute_reference_direction(arm.reference, v)
    psi = np.arctan2(np.sum(e * np.cross(v, r), axis=-1), np.sum(e * r, axis=-1))
    return float(psi) if psi.ndim == 0 else psi


def _apply_rotations(R: Array, x: Array) -> Array:
    """Apply rotations (..., 3, 3) to vectors (..., 3)."""
    return np.einsum("...ij,...j->...i", R, x)


def _compute_directions(arm: Arm, theta: Array) -> tuple[Array, Array]:
    """Compute unit vectors (..., 3) from S to W, and across it to E.

    The elbow is at theta and the shoulder at rest.
    """
    u, e = arm.compute_upper_arm(theta)
    u = u / np.linalg.norm(u, axis=-1, keepdims=True)
    out = e - u * np.sum(u * e, axis=-1, keepdims=True)
    size = np.linalg.norm(out, axis=-1, keepdims=True)
    h = arm.lines.h[ELBOW]
    bent, over = arm.compute_upper_arm(np.array(arm.stretched_angle + 1e-3))
    across = np.cross(h, u)
    across = across * np.sign(np.cross(h, bent) @ over)
    out = np.where(size > STRETCHED, out / np.maximum(size, STRETCHED), across)
    out = out - u * np.sum(u * out, axis=-1, keepdims=True)
    return u, out / np.linalg.norm(out, axis=-1, keepdims=True)


def compute_reference_direction(z: Array, v: Array) -> Array:
    """Compute the unit vector (..., 3) across v (..., 3) towards z (3,).

    Where v lies along z, towards the ground's x or y.
    """
    out = np.zeros_like(v)
    left = np.ones(v.shape[:-1], dtype=bool)
    for other in (z, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])):
        across = other - v * np.sum(v * other, axis=-1, keepdims=True)
        size = np.linalg.norm(across, axis=-1)
        good = left & (size > (ALONG if other is z else 0.5))
        out[good] = across[good] / size[good][..., None]
        left &= ~good
    return out


def compute_rotations(h: Array, theta: Any) -> Array:
    """Compute rotations (..., 3, 3) about the unit vector h (3,) by theta (...)."""
    theta = np.asarray(theta, dtype=float)[..., None, None]
    K = spatial.skew(h)
    return np.eye(3) + np.sin(theta) * K + 2.0 * np.sin(0.5 * theta) ** 2 * (K @ K)


# ---- angles of three axes that meet in a point


def solve_three_turns(h: Array, R: Array) -> tuple[Array, Array]:
    """Solve E_a E_b E_c = R for angles (..., 2, 3), with the discriminant (...).

    The discriminant is negative where there is no solution.

    h (3, 3): the axes; R (..., 3, 3). The first has the middle angle turned in its positive sense.
    Where the outer axes fall together the first angle is zero. Source: the problems 1 and 4 of
    Elias and Wen ("IK-Geo", 2022), with the discriminant as Heron's formula on the sphere, which
    keeps its digits where the outer axes nearly fall together.
    """
    a, b, c = h
    w = R @ c
    cos_ab = a @ b
    cos_bc = b @ c
    sin_ab = np.linalg.norm(np.cross(a, b))
    sin_bc = np.linalg.norm(np.cross(b, c))
    spread = (sin_ab - sin_bc) ** 2
    d2 = 0.25 * (np.sum((a - w) ** 2, axis=-1) - (cos_ab - cos_bc) ** 2 - spread)
    d2 = d2 * (np.sum((a + w) ** 2, axis=-1) - (cos_ab + cos_bc) ** 2 - spread)
    x = a @ c - cos_ab * cos_bc
    y = a @ np.cross(b, c)
    k = w @ a - cos_ab * cos_bc
    d = np.sqrt(np.maximum(d2, 0.0))
    out = np.empty((*R.shape[:-2], 2, 3))
    for i, sign in enumerate((1.0, -1.0)):
        middle = np.arctan2(y * k + sign * x * d, x * k - sign * y * d)
        first = _compute_turn_angle(
            a, _apply_rotations(compute_rotations(b, middle), np.broadcast_to(c, w.shape)), w
        )
        back = np.einsum("...ji,...j->...i", R, compute_rotations(a, first) @ b)
        out[..., i, 0], out[..., i, 1], out[..., i, 2] = (
            first,
            middle,
            _compute_turn_angle(c, back, b),
        )
    return out, d2


def _compute_turn_angle(h: Array, u: Array, v: Array) -> Array:
    """Compute the angle (...) about h (3,) that brings u into the half plane of v.

    It is 0 where one of them lies along h.
    """
    # now no digits are lost where they come close to h
    u = u - (u @ h)[..., None] * h
    v = v - (v @ h)[..., None] * h
    sine = np.sum((u @ spatial.skew(h).T) * v, axis=-1)
    cosine = np.sum(u * v, axis=-1)
    return np.where(np.hypot(sine, cosine) > ROUNDING**2, np.arctan2(sine, cosine), 0.0)


# ---- rotations over the arm angle, and limits of their joints

# Shoulder and wrist are rotations that depend on psi as M0 + Mc cos(psi) + Ms sin(psi). So a joint
# is at a limit where a sum of constant, cosine and sine of psi vanishes: a quadratic equation in
# tan(psi/2), as Shimizu, Kakuya, Yoon, Kitagaki and Kosuge ("Analytical inverse kinematic
# computation for 7-DOF redundant manipulators with joint limits", IEEE T-RO 24(5), 2008) found for
# axes at right angles. Here they may meet at any angles, and the elbow may be offset.


@dataclass(frozen=True, eq=False)
class Turning:
    """A rotation as a function of the arm angle psi.

    constant + cosine cos(psi) + sine sin(psi), each (3, 3).
    """

    constant: Array
    cosine: Array
    sine: Array

    def evaluate_rotation(self, psi: Array) -> Array:
        """Evaluate the rotations (..., 3, 3) at arm angles psi (...)."""
        psi = psi[..., None, None]
        return self.constant + self.cosine * np.cos(psi) + self.sine * np.sin(psi)

    def find_angles(self, p: Array, x: Array, k: float) -> list[float]:
        """Find the arm angles at which p . R x = k: none, or two."""
        a = float(p @ self.cosine @ x)
        b = float(p @ self.sine @ x)
        m = float(p @ self.constant @ x)
        r = math.hypot(a, b)
        if r < 1e-14 or abs(k - m) > r:
            return []
        middle = math.atan2(b, a)
        half = math.acos((k - m) / r)
        return [middle - half, middle + half]


def find_events(h: Array, R: Turning, limits: list[tuple[int, float]]) -> list[float]:
    """Find arm angles at which three joints with E_a E_b E_c = R(psi) reach limits or merge.

    Merging means that two branches meet.

    h (3, 3): the axes; limits: (joint 0 to 2, angle).
    """
    a, b, c = h
    out: list[float] = []
    for j, angle in limits:
        if j == 0:
            out += R.find_angles(compute_rotations(a, angle) @ b, c, float(b @ c))
        elif j == 1:
            out += R.find_angles(a, c, float(a @ compute_rotations(b, angle) @ c))
        else:
            out += R.find_angles(a, compute_rotations(c, -angle) @ b, float(a @ b))
    r = float(np.linalg.norm(np.cross(a, b)) * np.linalg.norm(np.cross(b, c)))
    middle = float((a @ b) * (b @ c))
    return out + R.find_angles(a, c, middle + r) + R.find_angles(a, c, middle - r)


# ---- configurations of an arm at a pose


@dataclass(frozen=True, eq=False)
class Half:
    """One of the two ways to bend the elbow: its angle, and the rotations of shoulder and wrist."""

    theta: float
    shoulder: Turning
    wrist: Turning


class Posed:
    """An arm with its tip at a pose (4, 4): configurations as functions of the arm angle.

    `halves` has the ways to bend the elbow, with their place 0 or 1: two, one where the arm is
    stretched or folded, or none where the pose is out of reach.
    """

    def __init__(self, arm: Arm, target: Array):
        self.arm = arm
        lines = arm.lines
        X = np.array(target, dtype=float)
        X[:3, 3] = (X[:3, 3] - lines.origin) / lines.length
        goal = X @ spatial.inverse(lines.tip)
        to = goal[:3, :3] @ arm.wrist + goal[:3, 3] - arm.shoulder
        self.distance = float(np.linalg.norm(to))
        r = math.hypot(arm.cosine, arm.sine)
        k = self.distance**2 - arm.size
        self.halves: list[tuple[int, Half]] = []
        if abs(k) <= r * (1.0 + 1e-12) and self.distance > STRETCHED:
            merged = 1.0 - abs(k) / r < AT_REACH  # less than rounding can tell
            half = math.acos(math.copysign(1.0, k) if merged else k / r)
            signs = (1.0,) if merged else (1.0, -1.0)
            v = to / self.distance
            across = compute_reference_direction(arm.reference, v)
            frame = np.stack([v, across, np.cross(v, across)], axis=1)
            self.halves = [
                (i, _make_half(arm, goal, frame, arm.stretched_angle + s * half))
                for i, s in enumerate(signs)
            ]

    def solve_branches(self, psi: Array) -> tuple[Array, np.ndarray]:
        """Solve for the variables (m, 8, 7) of the branches at arm angles psi (m,).

        Also return the mask (m, 8) of the branches that exist.
        """
        psi = np.asarray(psi, dtype=float)
        out = np.full((len(psi), 8, 7), np.nan)
        found = np.zeros((len(psi), 8), dtype=bool)
        h = self.arm.lines.h
        for i, half in self.halves:
            shoulder, d2 = solve_three_turns(h[:3], half.shoulder.evaluate_rotation(psi))
            wrist, e2 = solve_three_turns(h[4:], half.wrist.evaluate_rotation(psi))
            rows = out[:, 4 * i : 4 * i + 4].reshape(len(psi), 2, 2, 7)
            rows[..., :3] = shoulder[:, :, None]
            rows[..., 3] = half.theta
            rows[..., 4:] = wrist[:, None]
            out[:, 4 * i : 4 * i + 4] = rows.reshape(len(psi), 4, 7)
            found[:, 4 * i : 4 * i + 4] = ((d2 >= -MERGED) & (e2 >= -MERGED))[:, None]
        return out, found

    def find_intervals(self, limited: bool = True) -> list[list[tuple[float, float]]]:
        """Find, for each branch, the intervals of the arm angle in which it exists.

        If `limited`, those inside the limits.

        low is in [-pi, pi), high may be beyond pi; (-pi, pi) is the whole circle.
        """
        out: list[list[tuple[float, float]]] = [[] for _ in BRANCHES]
        for i, half in self.halves:
            marks = self._find_arcs(half, limited)
            middles = np.array([0.5 * (a + b) for a, b in marks])
            theta, good = self.solve_branches(middles)
            if limited:
                good &= is_inside_limits(self.arm.lines, theta)
            for k in range(4 * i, 4 * i + 4):
                out[k] = join_arcs(marks, good[:, k].tolist())
        return out

    def _find_arcs(self, half: Half, limited: bool) -> list[tuple[float, float]]:
        """Find the arcs of the circle between the events of one way to bend the elbow."""
        lines = self.arm.lines
        found: list[float] = []
        for places, R in ((SHOULDER, half.shoulder), (WRIST, half.wrist)):
            limits: list[tuple[int, float]] = []
            for j, i in enumerate(places):
                ends = (
                    lines.compute_theta(np.broadcast_to(lines.limits[:, i, None], (2, 7)))[:, i]
                    if limited
                    else ()
                )
                limits += [(j, float(x)) for x in ends if math.isfinite(x)]
            found += find_events(lines.h[list(places)], R, limits)
        return split_circle(found)


def _make_half(arm: Arm, goal: Array, frame: Array, theta: float) -> Half:
    """Compute the rotations of shoulder and wrist for an elbow at theta.

    Columns of `frame`: v, the reference, the third.
    """
    u, e = _compute_directions(arm, np.array(theta))
    back = np.stack([u, e, np.cross(u, e)])  # rows: the transposed frame of the upper arm
    v, x, y = frame.T
    cosine = np.outer(x, back[1]) + np.outer(y, back[2])
    parts = (np.outer(v, back[0]), cosine, np.outer(y, back[1]) - np.outer(x, back[2]))
    E4 = compute_rotations(arm.lines.h[ELBOW], theta)
    return Half(theta, Turning(*parts), Turning(*((M @ E4).T @ goal[:3, :3] for M in parts)))


def is_inside_limits(lines: Lines, theta: Array) -> np.ndarray:
    """Return whether all joints (..., n) are inside their limits (...), by any turn."""
    q = (theta - lines.offset) / lines.multiplier
    low, high = lines.limits
    period = TWO_PI / np.abs(lines.multiplier)
    turned = (
        low + np.mod(q - low, period)
        if np.isfinite(low).all()
        else _add_turns(q, low, high, period)
    )
    return np.all((turned <= high + FITS) | (turned - period >= low - FITS), axis=-1)


def _add_turns(q: Array, low: Array, high: Array, period: Array) -> Array:
    """Add whole turns to q, so that it is just above the lower limit, or below the upper one."""
    with np.errstate(invalid="ignore"):
        above = low + np.mod(q - low, period)
        below = high - np.mod(high - q, period)
    return np.where(np.isfinite(low), above, np.where(np.isfinite(high), below, q))
