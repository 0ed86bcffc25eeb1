"""Proofs that branches of dyads close or do not, by disc arithmetic.

The program of a closed form is walked with discs of the complex plane in place of points and
directions (circular arithmetic: Gargantini and Henrici, Numer. Math. 18, 1972): each disc contains
what is true, rounding of the input included. A branch ends where its circles, or its line and
circle, cannot meet, or where a joint is open for all members of the discs. What remains is
determined to the radii of its coordinates. These are large behind a dyad whose centres coincide,
whose link has no length or whose slides are parallel, and grow to the square root of rounding where
two roots meet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.assemble.dyad_decomposition import unpack_program
from kempe.kernels.dyads import dyads_layout as K
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.assemble.dyads import Plan

UNIT = 4.0 * float(np.finfo(float).eps)
"""Bound of the relative error of a few operations, with a margin."""
INPUT = 1e-15
"""Uncertainty of the points of parts, as a share of the mechanism's size: rounding of what
describes them."""
HUGE = 1e60
"""The largest radius: what has it is not known at all."""
FARTHEST = 1e9
"""Slides on rails that are parallel up to rounding, in sizes of the mechanism, beyond which nothing
is looked for."""
TURN = 2.0 * math.pi
COINCIDING = 1
NO_LENGTH = 2
PARALLEL = 4
MERGED = 8
WINDING = 16
"""Why a branch may be undetermined; bits."""
REASONS = {
    COINCIDING: "centres coincide",
    NO_LENGTH: "a link has no length",
    PARALLEL: "slides are parallel",
    MERGED: "two roots merge",
    WINDING: "whole turns of a joint move others that are geared to it",
}
"""The words for the bits."""


class Disc:
    """Enclosures of points of the plane: discs with complex middles (n,) and radii (n,)."""

    __slots__ = ("mid", "rad")

    def __init__(self, mid: Any, rad: Any):
        """Make discs, with radii widened by the rounding of the operation that gave them."""
        self.mid = mid
        rad = rad * (1.0 + UNIT) + UNIT * np.abs(mid)
        self.rad = np.where(rad < HUGE, rad, HUGE)  # also where it is NaN

    def __add__(self, other: Disc) -> Disc:
        return Disc(self.mid + other.mid, self.rad + other.rad)

    def __sub__(self, other: Disc) -> Disc:
        return Disc(self.mid - other.mid, self.rad + other.rad)

    def __mul__(self, other: Disc) -> Disc:
        rad = np.abs(self.mid) * other.rad + np.abs(other.mid) * self.rad + self.rad * other.rad
        return Disc(self.mid * other.mid, rad)

    def conjugate_disc(self) -> Disc:
        """Return the conjugate discs; of a direction, that is its inverse."""
        return Disc(np.conj(self.mid), self.rad)

    @property
    def real(self) -> Disc:
        """The component along x, as discs."""
        return Disc(self.mid.real, self.rad)

    @property
    def imag(self) -> Disc:
        """The component along y, as discs."""
        return Disc(self.mid.imag, self.rad)

    @property
    def low(self) -> Array:
        """Lower bounds of the distance from zero."""
        return np.maximum(np.abs(self.mid) - self.rad, 0.0)

    @property
    def high(self) -> Array:
        """Upper bounds of the distance from zero."""
        return np.abs(self.mid) + self.rad

    def __getitem__(self, at: Any) -> Disc:
        return Disc(self.mid[at], self.rad[at])


def _select_discs(which: np.ndarray, a: Disc, b: Disc) -> Disc:
    """Return discs of `a` where `which` (n,), else those of `b`."""
    return Disc(np.where(which, a.mid, b.mid), np.where(which, a.rad, b.rad))


def _normalize_vectors(v: Disc) -> Disc:
    """Normalize vectors; the unit disc where a vector may be zero."""
    n = np.abs(v.mid)
    known = v.rad < 0.5 * n
    safe = np.where(known, n, 1.0)
    off = v.rad / safe
    return Disc(np.where(known, v.mid / safe, 0.0), np.where(known, off * (1.0 + off * off), 1.0))


def _limit_unit_vectors(v: Disc) -> Disc:
    """Return `v`, known to have length one, with radii limited to one."""
    return _select_discs(v.rad >= 1.0, Disc(np.zeros_like(v.mid), np.ones_like(v.rad)), v)


def _divide_reals(a: Disc, b: Disc) -> Disc:
    """Divide real numbers; the result is unbounded where the divisor may be zero."""
    low = b.low
    sound = low > 0.0
    safe = np.where(sound, b.mid, 1.0)
    mid = np.where(sound, a.mid / safe, 0.0)
    rad = (a.rad + np.abs(mid) * b.rad) / np.where(sound, low, 1.0)
    return Disc(mid, np.where(sound, rad, HUGE))


def _enclose_root(low: Array, high: Array) -> Disc:
    """Return discs that contain the square roots of numbers between two bounds."""
    low = np.sqrt(low)
    high = np.sqrt(high)
    return Disc(0.5 * (low + high), 0.5 * (high - low))


def _bound_pin_radius(v1: Array, off1: Array, v2: Array, off2: Array) -> Array:
    """Bound the error of the pin of two links.

    v1 and v2 are the vectors of the links to the pin, off1 and off2 the errors of their other ends
    and lengths.

    To first order the pin moves along each link by what that is off; the rest by the theorem of
    Kantorovich: on a disc of twice that radius the directions of the links change by less than half
    of what would make them parallel.
    """
    n1 = np.abs(v1)
    n2 = np.abs(v2)
    sine = np.abs((np.conj(v1) * v2).imag) / (n1 * n2)
    first = (off1 + off2 + UNIT * (n1 + n2)) / sine
    change = (2.0 * first + off1 + off2) * (1.0 / n1 + 1.0 / n2) * 2.0 / sine
    return np.where(change < 0.25, first / (1.0 - change), HUGE)


class Placed(NamedTuple):
    """Poses of a part: its own point `own` lies at `at`, its axes are turned by `turn`."""

    turn: Disc
    own: Disc
    at: Disc

    def transform_point(self, w: Disc) -> Disc:
        """Return the positions of a point of the part."""
        return self.at + self.turn * (w - self.own)

    def invert_poses(self) -> Placed:
        """Return the inverse poses."""
        return Placed(self.turn.conjugate_disc(), self.at, self.own)

    def multiply_poses(self, other: Placed) -> Placed:
        """Return the product of poses, written with the own point that gives smaller radii."""
        turn = self.turn * other.turn
        one = Placed(turn, other.own, self.transform_point(other.at))
        two = Placed(turn, other.own + other.turn.conjugate_disc() * (self.own - other.at), self.at)
        return one.choose_smaller_radii(two)

    def choose_smaller_radii(self, other: Placed) -> Placed:
        """Return these poses, or the same poses written with another point, by smaller radii."""
        less = other.own.rad + other.at.rad < self.own.rad + self.at.rad
        return Placed(
            self.turn,
            _select_discs(less, other.own, self.own),
            _select_discs(less, other.at, self.at),
        )

    def select_rows(self, at: np.ndarray) -> Placed:
        """Return the poses of some branches."""
        return Placed(self.turn[at], self.own[at], self.at[at])


class Coordinate(NamedTuple):
    """Enclosures of a coordinate, and the periods by which its value may differ."""

    value: Disc
    steps: tuple[float, ...] = ()


@dataclass(frozen=True)
class Enclosed:
    """Branches that may close; all others are proven not to close.

    `branch` (k,) are their numbers in the order of `Plan.branches`, `middle` and `radius` (k, nq)
    enclose their coordinates (angles modulo whole turns), `why` (k,) are bits that say what may
    make radii large, and `dyad` (k,) is the first dyad that does, -1 for none.
    """

    branch: np.ndarray
    middle: Array
    radius: Array
    why: np.ndarray
    dyad: np.ndarray
    plan: Plan

    def explain_undetermined(self, rows: list[int]) -> str:
        """Explain why the first of some branches is undetermined."""
        if not rows:
            return ""
        bits = int(self.why[rows[0]])
        k = int(self.dyad[rows[0]])
        words = [word for bit, word in REASONS.items() if bits & bit] or [
            "rounding has grown along the chain of dyads"
        ]
        joints = self.plan.dyads[k].joints if 0 <= k < len(self.plan.dyads) else ()
        named = (
            f", first in the dyad with joints {', '.join(joints)}"
            if joints and bits & ~WINDING
            else ""
        )
        return " and ".join(words) + named

    def has_free_part(self, rows: list[int]) -> bool:
        """Return whether a part may be free to move on some of these branches.

        Otherwise they are undetermined only because roots merge.
        """
        return bool(np.any(self.why[rows] & ~MERGED))

    def find_undetermined(self, within: Array, closed: np.ndarray) -> np.ndarray:
        """Return a mask (k,) of the branches that may close in several or in unknown places.

        `closed` (k,) are those on which a closed configuration is known.

        A branch without a reason to the contrary has one place at most: all its circles and lines
        cross for all that the discs contain. Others must be determined to so much (nq,).
        """
        loose = (self.radius > within).any(axis=1)
        return loose & ((self.why > 0) | ~closed) | (self.why & WINDING > 0)

    def find_contained(self, k: int, q: Array, turning: np.ndarray, within: Array) -> np.ndarray:
        """Return a mask (n,) of the configurations (n, nq) at most `within` (nq,) off enclosure k."""
        off: Array = np.abs(q - self.middle[k])
        off = np.where(turning, np.abs(off - TURN * np.round(off / TURN)), off)
        return np.all(off <= self.radius[k] + within, axis=1)


def enclose_branches(plan: Plan, values: Array, limits: bool, size: float) -> Enclosed:
    """Find the branches of a plan that may close for known values (n_known,).

    With `limits`, it suffices to find those inside the limits.
    """
    with np.errstate(all="ignore"):
        return _Walk(plan, values, limits, size).run_program()


class _Walk:
    """Evaluation of a dyad program on all branches at once; a dyad with two roots doubles them."""

    def __init__(self, plan: Plan, values: Array, limits: bool, size: float):
        ints: list[int] = plan.program[0].tolist()
        given, self.ops = unpack_program(plan.program)
        self.plan = plan
        self.size = size
        self.tolerance = plan.tolerance
        self.limits = limits
        self.nq = ints[K.NQ]
        self.first = ints[K.COORDINATES]
        self.n = 1
        self.dyads = 0
        self.branch = np.zeros(1, dtype=np.int64)
        self.why = np.zeros(1, dtype=np.int64)
        self.dyad = np.full(1, -1)
        one = self.make_constant(1.0)
        zero = self.make_constant(0.0)
        self.poses: dict[int, Placed] = {
            K.REGISTERS + 4 * k: Placed(one, zero, zero) for k in range(ints[K.N_REGISTERS])
        }
        self.known: dict[int, Coordinate] = {
            self.first + slot: Coordinate(self.make_constant(float(x)))
            for slot, x in zip(given, values, strict=True)
        }

    def run_program(self) -> Enclosed:
        """Run the program, and return the branches that may close."""
        for i, f in self.ops:
            if not self.n:
                break
            OPERATIONS[i[0]](self, i, f)
        middle = np.zeros((self.n, self.nq))
        radius = np.full((self.n, self.nq), HUGE)
        for place, x in self.known.items():
            if place >= self.first:
                middle[:, place - self.first] = x.value.mid.real
                radius[:, place - self.first] = x.value.rad
        return Enclosed(self.branch, middle, radius, self.why, self.dyad, self.plan)

    # ---- branches

    def keep_branches(self, which: np.ndarray) -> None:
        """Keep only these branches, given by mask or indices."""
        if which.dtype == bool and which.all():
            return
        self.branch = self.branch[which]
        self.why = self.why[which]
        self.dyad = self.dyad[which]
        self.n = len(self.branch)
        self.poses = {k: x.select_rows(which) for k, x in self.poses.items()}
        self.known = {k: Coordinate(x.value[which], x.steps) for k, x in self.known.items()}

    def double_branches(self) -> Disc:
        """Double the branches, and return the sign of the root on each: + before -."""
        self.keep_branches(np.repeat(np.arange(self.n), 2))
        minus = np.arange(self.n) % 2
        self.branch = 2 * self.branch + minus
        return Disc(1.0 - 2.0 * minus, np.zeros(self.n))

    def record_doubt(self, which: np.ndarray, reason: int) -> None:
        """Note a reason why branches may be undetermined from here on, and the current dyad."""
        self.why = np.where(which, self.why | reason, self.why)
        self.dyad = np.where(which & (self.dyad < 0), self.dyads, self.dyad)

    def keep_closed_branches(self, opening: Disc, factor: float = 1.0) -> None:
        """Keep the branches on which an opening may be zero."""
        self.keep_branches(~(factor * opening.low > self.tolerance))

    # ---- numbers

    def make_constant(self, x: complex) -> Disc:
        """Return the same number on all branches."""
        return Disc(np.full(self.n, x), np.zeros(self.n))

    def read_point(self, f: list[float]) -> Disc:
        """Return a point of a part in its own frame."""
        return Disc(np.full(self.n, complex(f[0], f[1])), np.full(self.n, INPUT * self.size))

    def locate_pin(self, place: int, f: list[float]) -> Disc:
        """Return the positions of a point of a part."""
        return self.poses[place].transform_point(self.read_point(f))

    def locate_rail(self, place: int, f: list[float]) -> tuple[Disc, Disc]:
        """Return position and direction of a rail on a part."""
        return self.locate_pin(place, f), self.poses[place].turn * self.make_constant(
            complex(f[2], f[3])
        )

    def make_pose(self, f: list[float]) -> Placed:
        """Return a constant planar pose (c, s, x, y)."""
        return Placed(
            self.make_constant(complex(f[0], f[1])), self.make_constant(0.0), self.read_point(f[2:])
        )

    def has_windings(self, x: Coordinate, factor: float, period: float) -> bool:
        """Return whether unknown full turns of a coordinate, times a factor, change a result.

        The result counts modulo a period.
        """
        return any(not period or abs(math.remainder(factor * s, period)) > 1e-9 for s in x.steps)

    # ---- operations

    def set_number(self, i: list[int], f: list[float]) -> None:
        """SET: set an address to a number."""
        self.known[i[1]] = Coordinate(self.make_constant(f[0]))

    def add_multiple(self, i: list[int], f: list[float]) -> None:
        """ADD: add a multiple of a coordinate to an address."""
        a = self.known[i[1]]
        b = self.known[i[2]]
        steps = (*a.steps, *(f[0] * s for s in b.steps))
        self.known[i[1]] = Coordinate(a.value + b.value * self.make_constant(f[0]), steps)

    def check_zero_sum(self, i: list[int], f: list[float]) -> None:
        """EXPECT_ZERO: keep the branches on which a sum of coordinates may be zero."""
        x = self.known[i[1]]
        if self.has_windings(x, 1.0, 0.0):
            self.record_doubt(np.ones(self.n, dtype=bool), WINDING)
        else:
            self.keep_closed_branches(x.value, f[0])

    def turn_part(self, i: list[int], f: list[float]) -> None:
        """TURN: place a part by the angle of its joint to another part."""
        x = self.known[i[3]]
        angle = x.value * self.make_constant(f[0])
        turned = Disc(np.exp(1j * angle.mid), angle.rad)
        if self.has_windings(x, f[0], TURN):
            self.record_doubt(np.ones(self.n, dtype=bool), WINDING)
            turned = Disc(np.zeros(self.n, dtype=complex), np.ones(self.n))
        self._move_part(
            i,
            f,
            Placed(_limit_unit_vectors(turned), self.make_constant(0.0), self.make_constant(0.0)),
        )

    def slide_part(self, i: list[int], f: list[float]) -> None:
        """SLIDE: place a part by the displacement of its joint to another part."""
        x = self.known[i[3]]
        way = x.value * self.make_constant(f[0])
        if self.has_windings(x, f[0], 0.0):
            self.record_doubt(np.ones(self.n, dtype=bool), WINDING)
            way = Disc(way.mid, np.full(self.n, HUGE))
        self._move_part(i, f, Placed(self.make_constant(1.0), self.make_constant(0.0), way))

    def _move_part(self, i: list[int], f: list[float], motion: Placed) -> None:
        """Place a part by the motion of its joint to another part."""
        before = self.poses[i[2]].multiply_poses(self.make_pose(f[1:5]))
        self.poses[i[1]] = before.multiply_poses(motion).multiply_poses(self.make_pose(f[5:9]))

    def divide_pose(self, i: list[int], f: list[float]) -> None:
        """DIVIDE: compute the pose of a cluster from that of one of its parts."""
        self.poses[i[1]] = self.poses[i[1]].multiply_poses(self.poses[i[2]].invert_poses())

    def carry_part(self, i: list[int], f: list[float]) -> None:
        """CARRY: compute the pose of a part from that of its cluster."""
        self.poses[i[1]] = self.poses[i[2]].multiply_poses(self.poses[i[1]])

    def rebase_poses(self, i: list[int], f: list[float]) -> None:
        """REBASE: express two poses in the frame of another cluster."""
        back = self.poses[i[1]].invert_poses()
        self.poses[i[3]], self.poses[i[4]] = back, back.multiply_poses(self.poses[i[2]])

    def intersect_circles(self, i: list[int], f: list[float]) -> None:
        """CIRCLES: intersect the circles of two links that a pin connects."""
        A, C, a1, b1, b2, c2 = (self.locate_pin(i[k + 1], f[2 * k :]) for k in range(6))
        way = C - A
        w1 = b1 - a1
        w2 = b2 - c2
        reach = w1.high + w2.high - way.low
        inside = np.minimum(way.high + w2.high - w1.low, way.high + w1.high - w2.low)
        self.keep_branches(~((reach < -self.tolerance) | (inside < -self.tolerance)))
        sign = self.double_branches()
        A, C, a1, b1, b2, c2 = (self.locate_pin(i[k + 1], f[2 * k :]) for k in range(6))
        way = C - A
        w1 = b1 - a1
        w2 = b2 - c2
        d, r1, r2 = (Disc(np.abs(x.mid), x.rad) for x in (way, w1, w2))
        total = r1 + r2
        less = r1 - r2
        together = d.low <= 0.0
        self.record_doubt(together, COINCIDING)
        self.record_doubt((r1.low <= 0.0) | (r2.low <= 0.0), NO_LENGTH)
        near = np.where(together, 1.0, d.low)
        squares = less * total
        ratios = [
            (squares.mid + k * squares.rad) / x**2 for k in (-1.0, 1.0) for x in (near, d.high)
        ]
        slope = np.max([np.abs(1.0 - x) for x in ratios], axis=0)
        x = Disc(
            0.5 * (d.mid + squares.mid / np.where(together, 1.0, d.mid)),
            0.5 * (slope * d.rad + squares.rad / near),
        )
        lows: list[Array] = []
        highs: list[Array] = []
        for part in (total + d, total - d, d - less, d + less):
            lows.append(np.maximum(part.mid - part.rad, 0.0))
            highs.append(np.maximum(part.mid + part.rad, 0.0))
        y = _enclose_root(
            lows[0] * lows[1] * lows[2] * lows[3], highs[0] * highs[1] * highs[2] * highs[3]
        )
        y = (
            Disc(
                0.5 * y.mid / np.where(together, 1.0, d.mid),
                0.5 * (y.rad + y.high * d.rad / near) / near,
            )
            * sign
        )
        self.record_doubt((lows[1] <= 0.0) | (lows[2] <= 0.0) | (lows[3] <= 0.0), MERGED)
        u = _normalize_vectors(way)
        e1 = Disc(x.mid + 1j * y.mid, np.hypot(x.rad, y.rad))
        e2 = Disc(x.mid - d.mid + 1j * y.mid, np.hypot(x.rad + d.rad, y.rad))
        all_ = Disc(np.zeros(self.n, dtype=complex), np.ones(self.n))
        middle = A.mid + u.mid * e1.mid
        v1 = middle - A.mid
        v2 = middle - C.mid
        off1 = A.rad + r1.rad + np.abs(np.abs(v1) - r1.mid)
        off2 = C.rad + r2.rad + np.abs(np.abs(v2) - r2.mid)
        B = Disc(middle, _bound_pin_radius(v1, off1, v2, off2))
        for out, e, w, own, at in ((i[8], e1, w1, a1, A), (i[9], e2, w2, c2, C)):
            g = _limit_unit_vectors(u * _normalize_vectors(e))
            direct = _normalize_vectors(B - at)
            g = _select_discs(direct.rad < g.rad, direct, g)
            turn = _limit_unit_vectors(
                _select_discs(together, all_, g) * _normalize_vectors(w).conjugate_disc()
            )
            self.poses[out] = Placed(turn, own, at)
        self.dyads += 1

    def intersect_line_circle(self, i: list[int], f: list[float]) -> None:
        """LINE_CIRCLE: intersect the line of a slider and the circle of a link."""
        self.keep_branches(~(self._measure_line_gap(i, f)[0] > self.tolerance))
        sign = self.double_branches()
        _, (P, D), (Q, E), b1, b2, a2, A = self._measure_line_gap(i, f)
        turn = D * E.conjugate_disc()
        seen = D.conjugate_disc() * (P + turn * (b1 - Q) - A)
        along = seen.real
        h = seen.imag
        w = b2 - a2
        r = Disc(np.abs(w.mid), w.rad)
        self.record_doubt(r.low <= 0.0, NO_LENGTH)
        parts = r - h, r + h
        lows, highs = ([np.maximum(x.mid + k * x.rad, 0.0) for x in parts] for k in (-1.0, 1.0))
        self.record_doubt((lows[0] <= 0.0) | (lows[1] <= 0.0), MERGED)
        t = _enclose_root(lows[0] * lows[1], np.minimum(highs[0] * highs[1], r.high**2)) * sign
        to = Disc(t.mid + 1j * h.mid, np.hypot(t.rad, h.rad))
        to = _select_discs(to.rad < r.high, to, Disc(np.zeros(self.n, dtype=complex), r.high))
        slid = t - along
        one = Placed(turn, Q, P + slid * D)
        two = Placed(turn, b1, A + D * to)
        self.poses[i[8]] = one.choose_smaller_radii(two)
        self.poses[i[9]] = Placed(
            _limit_unit_vectors(
                _limit_unit_vectors(D * _normalize_vectors(to))
                * _normalize_vectors(w).conjugate_disc()
            ),
            a2,
            A,
        )
        self.dyads += 1

    def _measure_line_gap(self, i: list[int], f: list[float]) -> tuple[Any, ...]:
        """Return a lower bound of the gap between line and circle; the rails and pins."""
        (P, D) = self.locate_rail(i[1], f)
        (Q, E) = self.locate_rail(i[2], f[4:])
        b1, b2, a2, A = (self.locate_pin(i[k + 3], f[8 + 2 * k :]) for k in range(4))
        h = (D.conjugate_disc() * (P + D * E.conjugate_disc() * (b1 - Q) - A)).imag
        return h.low - (b2 - a2).high, (P, D), (Q, E), b1, b2, a2, A

    def intersect_lines(self, i: list[int], f: list[float]) -> None:
        """LINES: intersect the lines of two sliders that a pin connects."""
        (P, D), (Q, E), (S, G), (V, H) = (self.locate_rail(i[k + 1], f[4 * k :]) for k in range(4))
        b1 = self.locate_pin(i[5], f[16:])
        b2 = self.locate_pin(i[6], f[18:])
        one = D * E.conjugate_disc()
        two = G * H.conjugate_disc()
        gap = S + two * (b2 - V) - P - one * (b1 - Q)
        det = (D.conjugate_disc() * G).imag
        t1 = _divide_reals((gap.conjugate_disc() * G).imag, det)
        t2 = _divide_reals((gap.conjugate_disc() * D).imag, det)
        self.poses[i[7]] = Placed(one, Q, P + t1 * D)
        self.poses[i[8]] = Placed(two, V, S + t2 * G)
        self._note_parallel_rails(det, (gap.conjugate_disc() * D).imag)
        self.dyads += 1

    def _note_parallel_rails(self, det: Disc, apart: Disc) -> None:
        """Note branches on which rails may be parallel; drop those on which they are surely apart."""
        parallel = det.low <= 0.0
        self.record_doubt(parallel, PARALLEL)
        self.keep_branches(
            ~(parallel & (apart.low > np.maximum(FARTHEST * self.size * det.high, self.tolerance)))
        )

    def place_on_pins(self, i: list[int], f: list[float]) -> None:
        """PIN_PIN: place a cluster on two pins."""
        A, B, a1, b1 = (self.locate_pin(i[k + 1], f[2 * k :]) for k in range(4))
        way = B - A
        w = b1 - a1
        turn = _limit_unit_vectors(_normalize_vectors(way) * _normalize_vectors(w).conjugate_disc())
        self.poses[i[5]] = Placed(turn, a1, A)
        self.record_doubt(way.low <= 0.0, COINCIDING)
        self.record_doubt(w.low <= 0.0, NO_LENGTH)
        self.keep_branches(~(np.maximum(way.low - w.high, w.low - way.high) > self.tolerance))

    def place_on_pin_rail(self, i: list[int], f: list[float]) -> None:
        """PIN_RAIL: place a cluster on a pin and along a rail."""
        (_, D) = self.locate_rail(i[1], f)
        (_, E) = self.locate_rail(i[2], f[4:])
        self.poses[i[5]] = Placed(
            D * E.conjugate_disc(), self.locate_pin(i[4], f[10:]), self.locate_pin(i[3], f[8:])
        )

    def place_on_rails(self, i: list[int], f: list[float]) -> None:
        """RAIL_RAIL: place a cluster on two rails."""
        (P, D), (Q, E), (S, G), (V, _) = (self.locate_rail(i[k + 1], f[4 * k :]) for k in range(4))
        turn = D * E.conjugate_disc()
        gap = P + turn * (V - Q) - S
        det = (D.conjugate_disc() * G).imag
        t = _divide_reals((gap.conjugate_disc() * G).imag, det)
        self.poses[i[5]] = Placed(turn, Q, P - t * D)
        self._note_parallel_rails(det, (gap.conjugate_disc() * D).imag)

    def read_turn(self, i: list[int], f: list[float]) -> None:
        """READ_TURN: read or check the angle of a joint between placed parts."""
        a = self.poses[i[1]]
        b = self.poses[i[2]]
        turned = _limit_unit_vectors(
            a.turn.conjugate_disc() * b.turn * self.make_constant(complex(f[0], f[1]))
        )
        n = np.abs(turned.mid)
        known = turned.rad < 0.5 * n
        rad = np.where(known, 1.2 * turned.rad / np.where(known, n, 1.0), math.pi)
        angle = Disc(np.angle(turned.mid), rad) * self.make_constant(f[2]) + self.make_constant(
            f[3]
        )
        period = f[4]
        narrow = self.limits and f[6] - f[5] < f[4] * (1.0 - 1e-9)
        if i[5]:
            x = self.known[i[3]]
            if self.has_windings(x, 1.0, period):
                self.record_doubt(np.ones(self.n, dtype=bool), WINDING)
            else:
                off = angle - x.value
                self.keep_closed_branches(
                    Disc(off.mid - period * np.round(off.mid.real / period), off.rad), f[11]
                )
        else:
            self.known[i[3]] = Coordinate(angle, () if narrow else (period,))
        self.keep_closed_branches(self.locate_pin(i[2], f[9:]) - self.locate_pin(i[1], f[7:]))

    def read_slide(self, i: list[int], f: list[float]) -> None:
        """READ_SLIDE: read or check the displacement of a joint between placed parts."""
        (P, D) = self.locate_rail(i[1], f)
        (Q, _) = self.locate_rail(i[2], f[4:])
        seen = D.conjugate_disc() * (Q - P)
        value = seen.real * self.make_constant(f[8]) + self.make_constant(f[9])
        if i[5]:
            x = self.known[i[3]]
            if self.has_windings(x, 1.0, 0.0):
                self.record_doubt(np.ones(self.n, dtype=bool), WINDING)
            else:
                opening = value - x.value
                self.keep_closed_branches(opening, f[10])
        else:
            self.known[i[3]] = Coordinate(value)
        (P, D) = self.locate_rail(i[1], f)
        (Q, _) = self.locate_rail(i[2], f[4:])
        self.keep_closed_branches((D.conjugate_disc() * (Q - P)).imag)
        self.keep_closed_branches(
            self.locate_rail(i[2], f[4:])[1] - self.locate_rail(i[1], f)[1], f[11]
        )


OPERATIONS = {
    K.SET: _Walk.set_number,
    K.ADD: _Walk.add_multiple,
    K.EXPECT_ZERO: _Walk.check_zero_sum,
    K.TURN: _Walk.turn_part,
    K.SLIDE: _Walk.slide_part,
    K.DIVIDE: _Walk.divide_pose,
    K.CARRY: _Walk.carry_part,
    K.REBASE: _Walk.rebase_poses,
    K.CIRCLES: _Walk.intersect_circles,
    K.LINE_CIRCLE: _Walk.intersect_line_circle,
    K.LINES: _Walk.intersect_lines,
    K.PIN_PIN: _Walk.place_on_pins,
    K.PIN_RAIL: _Walk.place_on_pin_rail,
    K.RAIL_RAIL: _Walk.place_on_rails,
    K.READ_TURN: _Walk.read_turn,
    K.READ_SLIDE: _Walk.read_slide,
}
"""What each operation of a program does to enclosures."""
