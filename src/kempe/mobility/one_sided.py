"""One-sided constraints at a configuration: active constraints, and velocities that they allow.

Limits of coordinates are among them, and clearances that are asked about.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import comb
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explain_errors, explain_method_errors
from kempe.equations.closure_rows import evaluate_constraints, pack_full_loops
from kempe.equations.one_sided import CLOSED, OneSided, pack_one_sided_rows
from kempe.equations.velocity import evaluate_velocity_rows, record_velocity_rows
from kempe.errors import InputError
from kempe.forward.fk import fk, jacobian
from kempe.geometry.clearance import compute_gap_gradients, watch_clearances
from kempe.geometry.path_clearance import ROUNDING, read_clearances
from kempe.model.configurations import read_q
from kempe.numerics.rank import Level, Spectrum
from kempe.report import Report
from kempe.spatial import Array
from kempe.words import InWords, Quantity, Unit, format_count

if TYPE_CHECKING:
    from kempe.constraints.clearances import Apart
    from kempe.geometry.solids import Gap
    from kempe.model.model import FrameLike, Model


# ---- the cone of allowed velocities

# The cone is {v : E v = 0, G v >= 0}, found by linear programming. Columns are scaled velocities
# (slides in lengths of a link), so that rows of turns and slides compare. Facts used: a one-sided
# row is zero on the whole cone where it takes part in a nonnegative combination of rows that
# vanishes (Stiemke, 1915); where no row is, and E has full rank, the cone is what curves of the set
# {e = 0, g >= 0} leave with (Mangasarian and Fromovitz, 1967); otherwise it says to first order
# what may move.

NOTHING = 1e-6
"""Rows, components and openings below this part of what they are measured against count as zero: at
a configuration that is 1e-14 from a singular one, where equations are quadratic, rows that vanish
there are 1e-7."""
MOST = 3000
"""Sets of rows that are tried for extreme rays; where there are more the rays are not listed."""
TOUCHING = 2e-5
"""Slack of a clearance, as a part of the characteristic length, up to which it counts as closed:
`ik` and `ik_step` leave half of it."""
PRECISE = 1e-10
"""Tolerances of the linear programs."""


class ConeDirections(NamedTuple):
    """Whether a quantity may fall and may rise, to first order."""

    down: bool
    up: bool

    def __str__(self) -> str:
        return _WORDS[self.up][self.down]


_WORDS = (
    ("can neither grow nor shrink", "can only shrink"),
    ("can only grow", "can grow and shrink"),
)


@dataclass(frozen=True, eq=False)
class Cone:
    """A cone of velocities: v (n,) with E v = 0 and G v >= 0.

    `dimension` is that of the cone, `lineality` that of the velocities whose opposite is allowed,
    too, with the basis `free` (lineality, n). `implicit` rows are zero at all allowed velocities
    though E v = 0 does not say so (opposite contacts, a wedge that has closed), `implied` ones
    because E v = 0 says so; `vanishing` rows are zero themselves: they say nothing to first order.
    `redundant` rows follow from the others. `rays` (k, n) are the extreme ones (unit vectors,
    across `free`), None where they are too many. `exact`: each of these velocities begins a motion.
    """

    size: int
    dimension: int
    lineality: int
    implicit: tuple[int, ...]
    implied: tuple[int, ...]
    vanishing: tuple[int, ...]
    redundant: tuple[int, ...]
    exact: bool
    rays: Array | None = field(repr=False)
    free: Array = field(repr=False)
    across: Array = field(repr=False)
    """Basis (dimension - lineality, n) of the cone's span across `free`."""
    rows: Array = field(repr=False)
    """The rows that are needed, in that basis: the cone across `free` is where they are not
    negative."""

    def find_directions(self, row: ArrayLike) -> ConeDirections:
        """Find whether a quantity with the gradient `row` (n,) may fall and may rise."""
        row = np.asarray(row, dtype=float)
        size = float(np.linalg.norm(row))
        if size == 0.0:
            return ConeDirections(False, False)
        if np.linalg.norm(self.free @ row) > NOTHING * size:
            return ConeDirections(True, True)
        if self.rays is not None:
            rates = self.rays @ row
            return ConeDirections(
                bool(np.any(rates < -NOTHING * size)), bool(np.any(rates > NOTHING * size))
            )
        own = self.across @ row / size
        return ConeDirections(
            _minimize_row(own, self.rows) < -NOTHING, _minimize_row(-own, self.rows) < -NOTHING
        )


def compute_tangent_cone(equal: Array, one_sided: Array) -> Cone:
    """Compute the cone of velocities v (n,) with equal @ v = 0 and one_sided @ v >= 0.

    `equal` is (m, n), `one_sided` (k, n).

    Rows below `NOTHING` count as zero, one-sided ones that are not finite, too; others are scaled to
    unit length.
    """
    E = np.asarray(equal, dtype=float)
    G = np.asarray(one_sided, dtype=float)
    G = np.where(np.isfinite(G).all(axis=1, keepdims=True), G, 0.0)
    n = E.shape[1]
    held = Spectrum(_normalize_rows(E, NOTHING)[0], 1.0)
    N = held.compute_null_space(Level.GENERIC).T
    full = held.compute_rank(Level.GENERIC) == len(E)
    G, sizes = _normalize_rows(G, NOTHING)
    vanishing = sizes <= NOTHING
    inner = G @ N.T
    inner, left = _normalize_rows(inner, NOTHING)
    implied = ~vanishing & (left <= NOTHING)
    used = np.flatnonzero(~vanishing & ~implied)
    cut = inner[used]
    spectrum = Spectrum(cut, 1.0)
    free = spectrum.compute_null_space(Level.GENERIC).T
    across = spectrum.compute_row_space(Level.GENERIC).T
    depth = len(across)
    B = _normalize_rows(cut @ across.T, 0.0)[0]
    closed = _find_zero_rows(B)
    redundant = []
    if depth < len(used):
        redundant = _find_redundant_rows(B)
    left = Spectrum(B[closed], 1.0).compute_null_space(Level.GENERIC).T
    wide = len(left)
    across = left @ across
    open_rows = [i for i in range(len(used)) if i not in closed and i not in redundant]
    C = _normalize_rows(cut[open_rows] @ across.T, 0.0)[0]
    rays = _find_edge_rays(C)
    names = used.tolist()
    return Cone(
        n,
        len(free) + wide,
        len(free),
        tuple(names[i] for i in closed),
        tuple(np.flatnonzero(implied).tolist()),
        tuple(np.flatnonzero(vanishing).tolist()),
        tuple(names[i] for i in redundant),
        bool(full and not closed and not vanishing.any() and not implied.any()),
        None if rays is None else rays @ across @ N,
        free @ N,
        across @ N,
        C,
    )


def _normalize_rows(rows: Array, ignore: float) -> tuple[Array, Array]:
    """Normalize rows to unit length, and return their former lengths.

    Rows up to the length `ignore` become zero.
    """
    sizes = np.linalg.norm(rows, axis=1)
    good = sizes > ignore
    return np.where(good[:, None], rows / np.where(good, sizes, 1.0)[:, None], 0.0), sizes


def _find_zero_rows(B: Array) -> list[int]:
    """Find the rows of a pointed cone {B w >= 0} that are zero on the whole cone.

    One program: raise as many rows to 1 as can be at once, with w as long as the narrowest opening
    that counts needs.
    """
    k, r = B.shape
    if k == r:  # independent: each can be raised alone
        return []
    from scipy import optimize

    answer = cast(Any, optimize).linprog(
        np.concatenate([np.zeros(r), -np.ones(k)]),
        np.hstack([-B, np.eye(k)]),
        np.zeros(k),
        bounds=[(-1.0 / NOTHING, 1.0 / NOTHING)] * r + [(0.0, 1.0)] * k,
        **_METHOD,
    )
    return np.flatnonzero(answer.x[r:] < 0.5).tolist()


def _find_redundant_rows(B: Array) -> list[int]:
    """Find rows that follow from the rows that are kept; of equals the last ones go."""
    kept = list(range(len(B)))
    for i in range(len(B) - 1, -1, -1):
        others = [j for j in kept if j != i]
        if _minimize_row(B[i], B[others]) >= -NOTHING:
            kept = others
    return [i for i in range(len(B)) if i not in kept]


def _minimize_row(row: Array, rows: Array) -> float:
    """Minimize row @ w where rows @ w >= 0, in a box of unit size."""
    from scipy import optimize

    answer = cast(Any, optimize).linprog(
        row, -rows, np.zeros(len(rows)), bounds=[(-1.0, 1.0)] * len(row), **_METHOD
    )
    return float(answer.fun)


_METHOD: dict[str, Any] = {
    "method": "highs",
    "options": {"primal_feasibility_tolerance": PRECISE, "dual_feasibility_tolerance": PRECISE},
}


def _find_edge_rays(C: Array) -> Array | None:
    """Find unit vectors (k, r) along the edges of a pointed cone {C w >= 0}; None: too many.

    Along an edge r - 1 independent rows are zero.
    """
    k, r = C.shape
    if r == 0:
        return np.zeros((0, 0))
    if k == r:
        edges = np.linalg.inv(C).T
        return edges / np.linalg.norm(edges, axis=1)[:, None]
    if comb(k, r - 1) > MOST:
        return None
    chosen = np.array([*combinations(range(k), r - 1)], dtype=np.int64)
    spectrum = Spectrum(C[chosen], 1.0)
    lines = spectrum.right[spectrum.compute_ranks(Level.GENERIC) == r - 1, -1]
    both = np.concatenate([lines, -lines])
    inside = both[np.all(both @ C.T >= -NOTHING, axis=1)]
    out: list[Array] = []
    for ray in inside:
        if all(np.linalg.norm(ray - other) > NOTHING for other in out):
            out.append(ray)
    return np.array(out).reshape(-1, r)


# ---- the report

BLIND = "its gradient vanishes or is not defined here: nothing is known to first order"
"""What is said of a row that does not tell what it allows."""


@dataclass(frozen=True)
class Side(InWords):
    """One bound of a one-sided constraint: `value` stays above or, if `upper`, below `bound`.

    `slack` is how far it is inside, negative where it is violated. `state` is "open", "closed" or
    "violated", `ways` what a closed one still lets its value do, to first order.
    """

    name: str
    value: float
    bound: float
    unit: str
    upper: bool
    limit: bool
    """Whether it is a limit of a coordinate."""
    slack: float
    state: str
    ways: ConeDirections
    why: str = ""
    """Why it can do neither though it is one-sided, or why nothing is known."""

    def __str__(self) -> str:
        amount = f"{abs(self.slack):.6g} {self.unit}".removesuffix(" 1")
        if self.state == "open":
            return f"{self.name}: open by {amount}"
        if self.state == "violated":
            return f"{self.name}: violated by {amount}"
        what = self.name.partition(" limit of ")[2] if self.limit else "its value"
        state = "reached" if self.limit else "closed"
        return f"{self.name}: {state}; {what} {self.ways}" + (f" ({self.why})" if self.why else "")


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class OneSidedReport(Report):
    """The state of one-sided constraints and limits of a system at `q` (nq,); ``print`` it.

    `sides` are all of them, `cone` the velocities that equations, those of rolling among them, and
    closed sides leave, to first order. Sides that are open take nothing away.
    """

    _entries = ("sentence", "active", "violated", "dimension", "lineality")

    system: Model
    q: Array
    sides: tuple[Side, ...]
    cone: Cone
    scale: Array
    """Radians or metres (nv,) in one unit of each velocity of the cone."""

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the sides that are closed: their bounds are reached."""
        return tuple(s.name for s in self.sides if s.state == "closed")

    @property
    def violated(self) -> tuple[str, ...]:
        """Names of the sides that are violated."""
        return tuple(s.name for s in self.sides if s.state == "violated")

    @property
    def dimension(self) -> int:
        """Dimension of the cone of allowed velocities."""
        return self.cone.dimension

    @property
    def lineality(self) -> int:
        """Dimension of the allowed velocities whose opposite is allowed, too."""
        return self.cone.lineality

    @property
    def coordinates(self) -> dict[str, ConeDirections]:
        """Whether each coordinate may fall and may rise, to first order."""
        each = np.eye(self.system.nv)
        return {
            n: self.cone.find_directions(row)
            for n, row in zip(self.system.structure.velocity_names, each, strict=True)
        }

    def find_frame_directions(self, frame: FrameLike) -> dict[str, ConeDirections]:
        """Find whether coordinates of a frame may fall and may rise, to first order.

        They are those of its origin, and turns about the axes of the ground.
        """
        J = jacobian(self.system, self.q, frame) * self.scale
        large = np.abs(J).max(axis=1, initial=0.0)
        J = np.where((large > 1e-9 * large.max(initial=1e-300))[:, None], J, 0.0)
        names = ("x", "y", "z", "rx", "ry", "rz")
        return {n: self.cone.find_directions(row) for n, row in zip(names, J, strict=True)}

    @property
    def status(self) -> str:
        """The result in one sentence."""
        bad = (s for s in self.sides if s.state == "violated")
        if which := ", ".join(
            f"{s.name} by {abs(s.slack):.6g} {s.unit}".removesuffix(" 1") for s in bad
        ):
            return f"violated: {which}"
        declared = [s for s in self.sides if not s.limit]
        touching = sum(s.state == "closed" for s in declared)
        reached = len(self.active) - touching
        parts: list[str] = []
        if declared:
            verb = "are" if touching > 1 else "is"
            parts.append(
                f"{touching or 'none'} of {format_count(len(declared), 'one-sided constraint')} "
                f"{verb} closed"
            )
        if reached:
            parts.append(
                f"{format_count(reached, 'limit')} {'is' if reached == 1 else 'are'} reached"
            )
        text = " and ".join(parts) or "no limit is reached"
        return text + (f": {self._describe_freedoms()}" if self.active else "")

    def _describe_freedoms(self) -> str:
        """Describe the velocities that closed sides leave."""
        if self.dimension == 0:
            return "nothing can move"
        one_way = self.dimension - self.lineality
        how = (
            f"{self.lineality} both ways and {one_way} one way only" if one_way else "all both ways"
        )
        return f"what may move has {format_count(self.dimension, 'dimension')}, {how}"

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {
            "exact": self.cone.exact,
            "sides": [
                {
                    "name": s.name,
                    "state": s.state,
                    "value": Quantity(s.value, s.unit),
                    "bound": Quantity(s.bound, s.unit),
                    "unit": Unit(s.unit),
                    "slack": Quantity(s.slack, s.unit),
                    "allowed": str(s.ways),
                    "why": s.why,
                }
                for s in self.sides
            ],
        }

    @property
    def lines(self) -> list[str]:
        """Lines about all sides but open limits; violated and closed sides come first."""
        order = {"violated": 0, "closed": 1, "open": 2}
        shown = [s for s in self.sides if s.state != "open" or not s.limit]
        out = [str(s) for s in sorted(shown, key=lambda s: order[s.state])]
        if self.active and not self.cone.exact:
            out.append("to first order: closed sides that depend on each other may allow less")
        return out

    def _make_headline(self) -> str:
        return f"{self.system.name}: {self.status}"

    def _list_notes(self, degrees: bool = False) -> list[str]:
        return self.lines


@explain_errors
def report_one_sided(system: Model, q: Any = None, *, clearance: Any = None) -> OneSidedReport:
    """Find the state of one-sided constraints at a configuration, and the velocities they allow.

    `q` (nq,) or a dict by coordinate name (default: as for `mobility`) should close all loops.
    Sides within 1e-6 of their bound, in radians and characteristic lengths, count as closed.
    Limits of coordinates are among them, and a `clearance`, or a list of them: the pairs of shapes
    that touch at the distance to be kept, or are nearer, else the nearest one. Errors: `InputError`.
    """
    from kempe.assemble.generic_configurations import find_closed_configuration

    at = read_q(system, q) if q is not None else find_closed_configuration(system).q
    if at.ndim != 1:
        raise InputError(
            f"q has shape {at.shape}; one-sided constraints are looked at in one configuration"
        )
    rows = pack_one_sided_rows(system)
    values, J = rows.compute_rates(at)
    found, G = _list_sides(rows, values, J)
    if clearance is not None:
        more, H = _list_clearance_sides(system, at, read_clearances(clearance))
        found = [*more, *found]
        G = np.concatenate([H, G])
    E, still = _compute_equality_rows(system, at)
    cone = compute_tangent_cone(E, G)
    cone = cone if still else replace(cone, exact=False)
    states = [s.state for s in found]
    closed = [k for k, state in enumerate(states) if state == "closed"]
    sides = list(found)
    for place, k in enumerate(closed):
        sides[k] = _add_directions(found[k], place, cone, G[place], [found[j].name for j in closed])
    return OneSidedReport(system, at, tuple(sides), cone, pack_full_loops(system, True).scale)


def report_if_relevant(system: Model, q: Array) -> OneSidedReport | None:
    """Return the report at q (nq,); None where nothing is declared and no limit is reached."""
    rows = pack_one_sided_rows(system)
    if not rows.declared:
        if not len(rows):
            return None
        x = q[rows.at]
        (low, high) = rows.inner_bounds
        if ((x > low) & (x < high)).all():
            return None
    return report_one_sided(system, q)


def _list_sides(rows: OneSided, values: Array, J: Array) -> tuple[list[Side], Array]:
    """List all sides, and the inward gradients (k, nv) of those that are closed."""
    out: list[Side] = []
    G: list[Any] = []
    for k in range(len(rows)):
        scale = rows.scale[k]
        unit = rows.units[k]
        for upper, bound in ((False, rows.low[k]), (True, rows.high[k])):
            if not np.isfinite(bound):
                continue
            slack = float(bound - values[k] if upper else values[k] - bound)
            state = (
                "open"
                if slack * scale > CLOSED
                else "closed"
                if slack * scale >= -CLOSED
                else "violated"
            )
            both = ConeDirections(True, True)
            out.append(
                Side(
                    rows.format_bound_name(k, upper),
                    float(values[k]),
                    float(bound),
                    unit,
                    upper,
                    k >= rows.declared,
                    slack,
                    state,
                    both,
                )
            )
            if state == "closed":
                G.append(-J[k] if upper else J[k])
    return out, np.array(G).reshape(len(G), rows.system.nv)


def _list_clearance_sides(
    system: Model, q: Array, clearances: Sequence[Apart]
) -> tuple[list[Side], Array]:
    """List the sides of clearances: of each one, the pairs of shapes that are closed or violated,
    or the nearest pair. Also return the inward gradients (k, nv) of those that are closed.
    """
    watch = watch_clearances(system, clearances)
    loops = pack_full_loops(system, True)
    gaps = watch.list_gaps(fk(system, q, watch.solids.names), np.inf)
    gaps.sort(key=lambda gap: gap.distance - watch.at_least[gap.couple])
    touching = TOUCHING * loops.length + ROUNDING
    seen = set[int]()
    out: list[Side] = []
    closed: list[Gap] = []
    for gap in gaps:
        least = float(watch.at_least[gap.couple])
        slack = gap.distance - least
        deep = -CLOSED * loops.length - ROUNDING
        state = "open" if slack > touching else "closed" if slack >= deep else "violated"
        of = int(watch.of[gap.couple])
        if state == "open" and of in seen:
            continue
        seen.add(of)
        a, b = watch.name_bodies(gap.couple)
        both = ConeDirections(True, True)
        name = f"distance of {a!r} and {b!r}"
        out.append(Side(name, gap.distance, least, "m", False, False, slack, state, both))
        if state == "closed":
            closed.append(gap)
    if not closed:
        return out, np.zeros((0, system.nv))
    return out, compute_gap_gradients(system, watch, q, closed) * loops.scale / loops.length


def _add_directions(side: Side, place: int, cone: Cone, inward: Array, names: list[str]) -> Side:
    """Return a closed side with the directions that it still allows."""
    if place in cone.vanishing:
        return replace(side, ways=ConeDirections(True, True), why=BLIND)
    if place in cone.implied:
        return replace(side, ways=ConeDirections(False, False), why="the equations keep it closed")
    ways = cone.find_directions(-inward if side.upper else inward)
    if place in cone.implicit:
        others = ", ".join(names[i] for i in cone.implicit if i != place)
        return replace(side, ways=ConeDirections(False, False), why=f"held by {others}")
    if place in cone.redundant:
        return replace(side, ways=ways, why="it follows from the others that are closed")
    return replace(side, ways=ways)


def _compute_equality_rows(system: Model, q: Array) -> tuple[Array, bool]:
    """Compute the rows (m, nv) of loops and equations on scaled velocities.

    Also returns whether rest is allowed.

    Where it is not, what they allow are differences of velocities.
    """
    J = evaluate_constraints(system, q, True, True)[1]
    (A, b) = evaluate_velocity_rows(system, q)
    loops = pack_full_loops(system, True)
    names = record_velocity_rows(system).names
    lengths = np.where([name.unit.startswith("m") for name in names], 1.0 / loops.length, 1.0)
    return np.concatenate([J, lengths[:, None] * A * loops.scale]), not b.any()
