"""Whether bodies keep their distance on the way from each configuration to the next.

Conservative advancement (Mirtich, 1996; Schwarzer, Saha and Latombe, 2005): the distance of two
bodies in the middle of a piece of the way, less a bound on how far their points move towards one
another within the piece, is a lower bound of their distance on all of the piece. A piece that is
too long for that is halved.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.answers import wording
from kempe.arguments import explain_errors, explain_method_errors
from kempe.arrays import is_sequence
from kempe.budget import Budget, TimeUp, Usual, check_for_stop
from kempe.constraints.clearances import Apart
from kempe.errors import InputError, format_value
from kempe.forward.fk import fk
from kempe.geometry.clearance import Watch, watch_clearances
from kempe.geometry.smallest_distance import SmallestDistance
from kempe.geometry.solids import Placed
from kempe.joints import P, Q, R
from kempe.kernels.compiled import table_sweep
from kempe.model.configurations import read_q
from kempe.numerics.clock import LONG, TimeLimit, describe_early_end, find_time_limit, limit_time
from kempe.report import Report
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import Model

USUAL = Usual("check_path", time_limit=LONG)
DEPTH = 12
"""How often the way between two configurations is halved before it counts as not decided."""
PIECES = 64
"""Ways between configurations that are looked at together."""
ROUNDING = 1e-6
"""By how much measured distances may be too large, in metres."""


class Encounter(NamedTuple):
    """Where two bodies come too near, or may: on the way from configuration `piece` to the next.

    `part` is the fraction of the way. `decided` says that the distance was measured there as too
    small; else the bodies keep their distance there, and no bound says so for what is near.
    """

    piece: int
    part: float
    pair: tuple[str, str]
    distance: float
    at_least: float
    decided: bool

    @property
    def clear(self) -> int:
        """Number of configurations before that are clear."""
        return self.piece + int(self.part > 0.0)

    @property
    def place(self) -> str:
        """The place on the path as text."""
        if self.part in (0.0, 1.0):
            return f"at configuration {self.piece + int(self.part)}"
        return f"{self.part:.3g} of the way from configuration {self.piece} to {self.piece + 1}"

    def describe_bodies(self) -> str:
        """Describe how near the bodies come."""
        if not self.decided:
            a, b = self.pair
            return (
                f"{a!r} and {b!r} are {self.distance:.7g} m apart, where less than "
                f"{self.at_least:.4g} m near it is not excluded"
            )
        return wording.describe_closest(self.pair, self.distance, self.at_least)


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class PathClearance(Report):
    """Whether clearances are kept along a path; true if they are.

    Attributes
    ----------
    system
        The system.
    count
        Number of configurations of the path; where it is `late`, of those that were checked.
    encounter
        The first place where they are not kept, or where this is not decided; None if they are
        kept. Its fields are `piece` (the number of the configuration before), `part` (the fraction
        of the way to the next), `pair`, `distance` and `at_least` in metres, and `decided`.
    late
        Whether the time limit ended the work before the end of the path.
    code
        `SOLVED`, `TOO_NEAR` where bodies come too near, `NOT_FOUND` where it is not decided, and
        `OUT_OF_TIME`.
    """

    _entries = ("system", "count", "proven", "late")

    system: Model
    count: int
    encounter: Encounter | None
    late: bool = False

    @property
    def code(self) -> Any:
        """Outcome as a `Status`."""
        if self.encounter is None:
            return Status.OUT_OF_TIME if self.late else Status.SOLVED
        return Status.TOO_NEAR if self.encounter.decided else Status.NOT_FOUND

    @property
    def proven(self) -> bool:
        """Whether the answer is proven, up to rounding of the distances.

        A distance that was measured as too small is. The straight way of coordinates opens closed
        loops between its ends: of these systems it proves nothing.
        """
        if self.encounter is not None:
            return self.encounter.decided
        return not self.late and not self.system.structure.closures

    @property
    def status(self) -> str:
        """Whether the bodies keep apart, or where which two do not."""
        if self.encounter is None:
            straight = "between them, too" if self.count > 1 else "there"
            loops = ", where loops were not closed" if self.system.structure.closures else ""
            many = format_count(self.count, "configuration")
            if self.late:
                return f"clear as far as it was checked: {many}{describe_early_end(False, True)}"
            return f"clear: {many}, and {straight}{loops}"
        if self.encounter.decided:
            return f"too near {self.encounter.place}: {self.encounter.describe_bodies()}"
        return f"not decided {self.encounter.place}: {self.encounter.describe_bodies()}"

    def _collect_data(self) -> dict[str, Any]:
        found = self.encounter
        met = None if found is None else found._asdict() | {"pair": list(found.pair)}
        return super()._collect_data() | {"encounter": met}


def read_clearances(clearance: Any) -> list[Apart]:
    """Read one clearance, or several. Errors: `InputError`."""
    given = list(clearance) if is_sequence(clearance) else [clearance]
    if not given or not all(isinstance(c, Apart) for c in given):
        raise InputError(
            f"clearance is {format_value(clearance)}; it must be a kempe.constraints.Clearance, or "
            "a list of them"
        )
    return given


@explain_errors
@limit_time(USUAL)
def check_path(
    system: Model, path: Any, clearance: Any, *, budget: Budget | None = None
) -> PathClearance:
    """Check whether bodies keep clearances along a path; see `BodyGeometry.check_path`."""
    q = read_q(system, path if isinstance(path, np.ndarray) else getattr(path, "q", path))
    if q.ndim != 2:
        raise InputError(f"path has shape {q.shape}; it must be (n, {system.nq})")
    guard = PathGuard(system, watch_clearances(system, read_clearances(clearance)))
    time = find_time_limit(USUAL, budget)
    time.release_reserved_time()  # there is nothing to do afterwards
    checked, met = guard.check_in_time(q, time)
    late = met is None and checked < len(q)
    return PathClearance(system, checked if late else len(q), met, late)


class PathGuard:
    """Search for places of paths at which solids come too near."""

    def __init__(self, system: Model, watch: Watch):
        self.system = system
        self.watch = watch
        self._motions = MotionBounds(system, watch)
        self._distance = SmallestDistance(system, watch.solids, watch.couples, watch.at_least)

    def find_encounter(self, q: Array) -> Encounter | None:
        """Find the first place on the way through configurations (n, nq) not proven to be clear.

        The way is straight in the coordinates. Rows that are not finite are left out, and the ways
        to them.
        """
        return next((met for _, met in self._check_pieces(q) if met is not None), None)

    def check_in_time(self, q: Array, time: TimeLimit) -> tuple[int, Encounter | None]:
        """Check configurations (n, nq) and the ways between them until the time is up.

        Returned are the number of configurations that were checked, and the encounter.
        """
        checked = 0
        met = None
        try:
            for checked, met in self._check_pieces(q):
                if met is not None or checked == len(q):
                    break
                time.check_time()
        except TimeUp:
            if not time.spent:
                raise  # that of a verb which called this one
        return checked, met

    def _check_pieces(self, q: Array) -> Iterator[tuple[int, Encounter | None]]:
        """Yield how many configurations were checked, piece by piece, with the encounter there."""
        layout = self.system.structure.layout
        good = np.asarray(np.isfinite(q).all(axis=1))
        for first in range(0, max(len(q) - 1, 1), PIECES):
            check_for_stop()
            last = min(first + PIECES, len(q) - 1)
            near = self.find_near_configuration(q[first : last + 1])
            # ways behind a configuration that is too near do not matter
            ways = np.arange(first, last if near is None else first + near.piece)
            ways = ways[good[ways] & good[ways + 1]]
            v = layout.compute_difference(q[ways], q[ways + 1])
            met = self._find_near_piece(q[ways], v) if len(ways) else None
            if met is not None:
                met = met._replace(piece=int(ways[met.piece]))
            elif near is not None:
                met = near._replace(piece=first + near.piece)
            yield last + 1, met

    def find_near_configuration(self, q: Array) -> Encounter | None:
        """Find the first of some configurations (n, nq) that is too near."""
        near = np.flatnonzero(self._distance.compute_distances(q, ROUNDING) < ROUNDING)
        X = fk(self.system, q[near], self.watch.solids.names)
        for k, poses in zip(near.tolist(), X, strict=True):
            worst = self.watch.find_worst(self.watch.list_gaps(poses, 0.0))
            if worst is not None:
                return Encounter(k, 0.0, worst[:2], *worst[2:], True)
        return None

    def _find_near_piece(self, q: Array, v: Array) -> Encounter | None:
        """Find the first place on ways from q (n, nq) by v (n, nv), between their ends."""
        watch = self.watch
        pairs = len(watch.couples)
        number = np.repeat(np.arange(len(q)), pairs)  # of a piece, each 1 / 2^level of a way
        couple = np.tile(np.arange(pairs), len(q))
        found: Encounter | None = None
        for level in range(DEPTH + 1):
            if not len(number):
                break
            check_for_stop()
            size = 0.5**level
            pieces, of = np.unique(number, return_inverse=True)
            way, begin = np.divmod(pieces, 2**level)
            middle = (begin + 0.5) * size
            moved = v[way]
            at = self.system.structure.layout.integrate_velocity(q[way], middle[:, None] * moved)
            motions = self._motions.compute_motions(at, 0.5 * size * moved)
            kept: list[int] = []
            for k in motions.find_doubtful(of, couple).tolist():
                piece = int(of[k])
                pair = int(couple[k])
                place = int(way[piece]), float(middle[piece])
                if found is not None and place >= (found.piece, found.part):
                    continue
                d = motions.measure_distance(piece, pair)
                least = float(watch.at_least[pair])
                if d >= least + motions.need[piece, pair]:
                    continue
                if d >= least and level < DEPTH:
                    kept.append(k)
                else:
                    found = Encounter(*place, watch.name_bodies(pair), d, least, d < least)
            number = (2 * number[kept][:, None] + np.arange(2)).ravel()
            couple = np.repeat(couple[kept], 2)
            if found is not None:
                before = number < (found.piece + found.part) * 2 ** (level + 1)
                number = number[before]
                couple = couple[before]
        return found


# ---- how far bodies move


class MotionBounds:
    """Bounds on how much nearer solids come while coordinates move by given amounts."""

    def __init__(self, system: Model, watch: Watch):
        solids = watch.solids
        table = system.structure.table
        self.watch = watch
        self.table = table
        self.chains: dict[int, list[int]] = {}
        """For each solid, the rows of the table from its body to the ground."""
        for solid in np.unique(watch.couples).tolist():
            self.chains[solid] = table.find_path(solids.names[solids.body_of[solid]])[::-1]
        self.tops = [
            tuple(
                next((row for row in self.chains[s][::-1] if row not in self.chains[other]), -1)
                for s, other in ((a, b), (b, a))
            )
            for a, b in watch.couples.tolist()
        ]
        """For each pair, the row nearest to the ground that moves the one, and not the other."""
        self.rows = sorted({row for chain in self.chains.values() for row in chain})
        at: dict[Any, Any] = {("row", row): (row, np.eye(4), False) for row in self.rows}
        outputs = (*solids.names, *at)
        self._packed = replace(table, at=at | dict(table.at)).pack_arrays(outputs)

    def compute_motions(self, q: Array, half: Array) -> Motions:
        """Bound the motions while q (n, nq) moves by `half` (n, nv), forwards and backwards."""
        solids = self.watch.solids
        n = len(q)
        names = len(solids.names)
        X = np.empty((n, names + len(self.rows), 4, 4))
        table_sweep.compute_poses(*self._packed, np.ascontiguousarray(q), X)
        at = X[:, solids.body_of]
        centers = (at[..., :3, :3] @ solids.centers[:, :, None])[..., 0] + at[..., :3, 3]
        rows = {row: X[:, names + k] for k, row in enumerate(self.rows)}
        moved: dict[tuple[int, int], Array] = {}
        for solid, chain in self.chains.items():
            total = np.zeros(n)
            radius = solids.radii[solid]
            for row in chain:
                reach = radius + total  # from where the centre is in the middle
                total = total + self._bound_row(row, half, rows[row], centers[:, solid], reach)
                moved[solid, row] = total
        need = np.full((n, len(self.watch.couples)), ROUNDING)
        for k, (pair, tops) in enumerate(zip(self.watch.couples.tolist(), self.tops, strict=True)):
            for solid, top in zip(pair, tops, strict=True):
                if top >= 0:
                    need[:, k] += moved[solid, top]
        return Motions(self.watch, X[:, :names], centers, need, {})

    def _bound_row(self, row: int, half: Array, X: Array, center: Array, reach: Array) -> Array:
        """Bound how far one row moves points (n,) that stay within `reach` (n,) of a centre (n, 3)."""
        kind = self.table.kind[row]
        v = int(self.table.iv[row])
        if kind == Q:
            angle = np.linalg.norm(half[:, v : v + 3], axis=1)
        else:
            angle = np.abs(self.table.multiplier[row] * half[:, v])
        if kind == P:
            return angle
        away = center - X[:, :3, 3]
        square = np.einsum("ni,ni->n", away, away)
        if kind == R:  # from the axis, not from a point of it
            square = square - np.einsum("ni,ni->n", away, X[:, :3, 2]) ** 2
        return angle * (np.sqrt(np.maximum(square, 0.0)) + reach)


class Motions(NamedTuple):
    """Poses X (n, m, 4, 4) of bodies and centres (n, s, 3) of solids in the middle of n pieces of a
    way, and how much nearer the solids of each pair come at most (n, k), with rounding.
    """

    watch: Watch
    X: Array
    centers: Array
    need: Array
    placed: dict[int, Placed]
    """Solids at those pieces that were measured."""

    def find_doubtful(self, piece: np.ndarray, couple: np.ndarray) -> np.ndarray:
        """Find which pairs, each in a piece, the spheres about them do not keep apart."""
        a, b = self.watch.couples[couple].T
        radii = self.watch.solids.radii
        apart = np.linalg.norm(self.centers[piece, a] - self.centers[piece, b], axis=1)
        least = self.watch.at_least[couple] + self.need[piece, couple]
        return np.flatnonzero(apart - radii[a] - radii[b] < least)

    def measure_distance(self, piece: int, couple: int) -> float:
        """Measure the distance of a pair in the middle of a piece."""
        if piece not in self.placed:
            self.placed[piece] = Placed(self.watch.solids, self.X[piece])
        a, b = self.watch.couples[couple].tolist()
        return self.placed[piece].measure_solids(a, b)
