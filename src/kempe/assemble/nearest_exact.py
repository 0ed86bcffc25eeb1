"""The nearest mechanism that closes exactly and moves, for dimensions with small errors.

Redundant constraints agree only for special dimensions, which rounded and measured numbers miss.
Small changes of joint placements, up to a tolerance in metres and radians, give the *ideal*
mechanism. It has the same coordinates; answers about the given one are computed for it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from kempe.arguments import explain_errors, explain_method_errors
from kempe.arrays import is_real
from kempe.assemble.bound import get_assembler_as_given
from kempe.assemble.dimensions import Dimensions, Place, Relations, simplify_angles
from kempe.assemble.fit import (
    DAMPING,
    ENOUGH,
    Fit,
    Valley,
    fit_whole_motion,
    is_closed_along_valley,
)
from kempe.budget import Budget, TimeUp, Usual, list_checks
from kempe.description.mechanism import choose_unused_name, number_components
from kempe.description.parts import Declared, Joint
from kempe.equations.closure_rows import (
    compute_residual,
    count_remaining_freedoms,
    evaluate_constraints,
    list_row_names,
    pack_full_loops,
)
from kempe.equations.slip import has_velocity_constraints
from kempe.errors import InputError, TimeLimitError, format_value
from kempe.first_order.constraint_graph import build_constraint_graph
from kempe.joints import Revolute
from kempe.model.ball_angles import make_regular_chart
from kempe.model.characteristic_length import (
    adopt_characteristic_length,
    choose_origin,
    compute_characteristic_length,
)
from kempe.model.configurations import find_home, read_q
from kempe.model.model import keep_answers, store_answer
from kempe.model.own_tree import remove_cut_marks
from kempe.model.time_coordinate import list_timed_constraints
from kempe.numerics.clock import (
    ENDLESS,
    LONG,
    TIME_LIMIT,
    TimeLimit,
    limit_preparation_time,
    limit_time,
)
from kempe.report import Nearest, Report
from kempe.spatial import Array, log_so3, xyz_rpy_from_pose
from kempe.words import InWords, format_count

if TYPE_CHECKING:
    from kempe.model.model import Model

Function = TypeVar("Function", bound=Callable[..., Any])

USUAL_TOLERANCE = 1e-5
"""The tolerance that nobody has to ask for, in characteristic lengths and radians: what is off by
less is rounding."""
WIDEST = 1e-2
"""The largest tolerance, in characteristic lengths and radians: above it, it would be another
mechanism."""
FINEST = 1e-13
"""The smallest one, in characteristic lengths, also those to the joints from the origin: below it
is rounding."""
MEASURED = "measured"
"""The smallest tolerance with which the loops close, up to the largest one."""
MOST = 60
"""Velocity coordinates up to which a mechanism is compared with others: it takes dense
decompositions."""
EXACT = 1e-14
"""Residual up to which a mechanism is closed as it is, and singular values, as parts of the
largest, that are zero.

It is a tenth of what motions may stay open by, `kempe.numerics.curves.CLOSED`, so that what
counts as exact at some configurations is closed all along a motion.
"""
SHOWN = 1e-3
"""Part of the largest change below which others are not listed."""
OPEN = 10.0
"""What may stay open along the motion of the given mechanism, as a multiple of the tolerance."""
FEW = 3
"""Starts of the search for a configuration at which the given loops are least open."""
BESIDE = 2
ASIDE = 0.2
"""Configurations beside home where it is looked, too, as home may be singular, and how far away, in
radians and characteristic lengths."""
WAYS = 16
"""Directions in which it is looked beside a singular home."""
CLOSE = 0.02
"""Places where the same rank would lead to the same motion, in radians and characteristic
lengths."""
HELD = "held"
"""Name of the joint that holds a part of a mechanism in the ground."""
NEARLY = 4.0
"""Relations that hold within this multiple of the changes that make it close are meant to hold."""
NEARLY_CLOSED = 1e-3
"""What a fit may leave open for relations to be of help."""
GAP = 3.0
"""Ratio of singular values from which they may part what moves from what is held."""


@dataclass(frozen=True)
class Change(InWords):
    """Changed placement of a joint or constraint: `moved` [m] and `turned` [rad] at its `side`."""

    name: str
    side: str
    old: str
    new: str
    moved: float
    turned: float

    def __str__(self) -> str:
        where = "on its parent" if self.side == "X_PF" else "on its child"
        return f"{self.name!r} {where}: {self.old} -> {self.new}"


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Idealised(Report):
    """Nearest mechanism that closes exactly, with its differences from the `given` one.

    Attributes
    ----------
    system
        The exact mechanism, with the same coordinates.
    tolerance
        Largest change of a placement, in metres and radians.
    requested
        The tolerance of the call.
    residual
        Largest gap of the given loops along its motion, in metres and radians.
    absorbed
        The gaps by closing joint or constraint.
    """

    _entries = ("sentence", "requested", "tolerance", "residual", "freedoms", "absorbed")

    given: Model
    system: Model
    requested: float
    tolerance: float
    residual: float
    freedoms: int
    changes: tuple[Change, ...]
    absorbed: dict[str, float]

    @property
    def within(self) -> Idealised:  # type: ignore[override]
        """The ideal mechanism itself."""
        return self

    @property
    def status(self) -> str:
        """The result in one sentence."""
        return f"closed {self.least}, with {format_count(self.freedoms, 'freedom')}; {self.exactly}"

    @property
    def least(self) -> str:
        """Text that states the largest change of a joint's placement, in metres and radians."""
        return f"within {self.tolerance:.2g} m and rad"

    @property
    def exactly(self) -> str:
        """Sentence that states the loop gaps [m, rad] if the given numbers are taken exactly."""
        lock = " and would lock it" if self.freedoms else ""
        return f"taken exactly, its numbers leave loops open by {self.residual:.2g} (m, rad){lock}"

    @property
    def lines(self) -> list[str]:
        """Lines of text: loop gaps, joints that absorb the gaps, and changes, the largest first."""
        off = sorted(self.absorbed.items(), key=lambda x: -x[1])
        said = ", ".join(f"{name!r} by {x:.2g}" for name, x in off if x >= SHOWN * self.residual)
        return [
            self.exactly,
            f"absorbed is what misses in {said} (m, rad)",
            *map(str, self.changes),
        ]

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {"changes": [vars(c) for c in self.changes]}

    def close_configurations(self, q: Any) -> Array:
        """Return the configurations (..., nq) of the exact mechanism nearest to `q` (..., nq).

        A configuration that is farther from closed than the tolerance explains is returned
        unchanged.
        """
        q = read_q(self.system, q)
        off = np.linalg.norm(evaluate_constraints(self.system, q, False, True)[0], axis=-1)
        length = compute_characteristic_length(self.system)
        near = (off > EXACT) & (off <= OPEN * self.tolerance * (1.0 + 1.0 / length))
        if not np.any(near):
            return q
        flat = q.reshape(-1, self.system.nq)
        out = q.reshape(-1, self.system.nq).copy()
        for i in np.flatnonzero(near.ravel()):
            answer = get_assembler_as_given(self.system)(
                start=flat[i], limits=False, budget=Budget(starts=1)
            )
            out[i] = answer.q if answer.success else flat[i]
        return out.reshape(q.shape)

    def _make_headline(self) -> str:
        return f"{self.given.name}: {self.status}"

    def _list_notes(self, degrees: bool = False) -> list[str]:
        return self.lines[1:]


def choose_smaller_tolerance(tolerance: Any) -> Any:
    """Return the smaller tolerance of a pair of metres and radians; other input unchanged."""
    given: Any = tolerance
    pair = isinstance(tolerance, tuple) and len(given) == 2 and all(map(is_real, given))
    return min(given) if pair else given


def read_requested_tolerance(system: Model, tolerance: Any) -> float:
    """Return the requested tolerance, in metres and radians.

    Errors: `InputError` with both bounds.
    """
    size = compute_characteristic_length(system)
    widest = WIDEST * min(size, 1.0)
    if tolerance is None:
        return USUAL_TOLERANCE * min(size, 1.0)
    if isinstance(tolerance, str) and tolerance == MEASURED:
        return widest
    finest = FINEST * max(size, float(np.linalg.norm(choose_origin(system))))
    if not (is_real(tolerance) and finest <= float(tolerance) <= widest):
        raise InputError(
            f"tolerance is {format_value(tolerance)}; it must be from {finest:.2g} (rounding) to "
            f"{widest:.2g} (a hundredth of the size of {system.name}), in metres and radians, or "
            f"{MEASURED!r}"
        )
    return float(tolerance)


def find_nearest_exact(
    system: Model, tolerance: Any = None, time: TimeLimit = ENDLESS
) -> Idealised | None:
    """Find the nearest mechanism that closes exactly within a tolerance.

    None where the given one closes as it is, or where there is none.

    `tolerance` is a number in metres and radians, "measured", or None: that of the system, else
    what is rounding. Of a `kempe.Tolerance` the smaller number counts. Raises `TimeUp` where the
    `time` ends the search, of which nothing is kept then; without one, and where no verb with a
    time limit asks, `TimeLimitError` after 600 s.
    """
    answers, key, tolerance = _get_kept_answers(system, tolerance)
    found = answers.get(key, answers)  # it never holds itself
    if found is not answers:
        return found
    most = read_requested_tolerance(system, tolerance)
    if not _has_closures(system):
        return store_answer(answers, key, None)
    own = time is ENDLESS and not list_checks()
    time = TimeLimit(LONG) if own else time
    try:
        with time:
            nearest = _search_nearest(system, most, time=time)
            if nearest is None and tolerance not in (None, MEASURED):
                # a search has room only well within its tolerance
                wider = find_nearest_exact(system, MEASURED, time)
                if wider is not None and wider.tolerance <= most:
                    nearest = replace(wider, requested=most)
            return store_answer(answers, key, nearest)
    except TimeUp:
        if own:
            raise TimeLimitError(
                "the search for the nearest mechanism that closes exactly", time.limit
            ) from None
        raise


def find_nearest_exact_in_time(usual: Usual, time: TimeLimit, system: Model) -> None:
    """Find the nearest mechanism that closes exactly within the time of a verb.

    Errors: `TimeLimitError`.
    """
    if _has_closures(system) and not is_nearest_exact_known(system):
        with limit_preparation_time(usual, time):
            find_nearest_exact(system)


def _has_closures(system: Model) -> bool:
    """Return whether a system has loops or constraints to close."""
    return bool(system.structure.closures or system._mechanism.constraints)


def is_nearest_exact_known(system: Model, tolerance: Any = None) -> bool:
    """Return whether the nearest mechanism within a tolerance is known without a search."""
    answers, key, _ = _get_kept_answers(system, tolerance)
    return key in answers


def _get_kept_answers(system: Model, tolerance: Any) -> tuple[dict[Any, Any], Any, Any]:
    """Return the kept results of a system, the key of a tolerance in them, and the tolerance."""
    tolerance = (
        system.structure.tolerance if tolerance is None else choose_smaller_tolerance(tolerance)
    )
    key = tolerance if tolerance.__class__ in (float, int, str) else repr(tolerance)
    return system._kept.setdefault(find_nearest_exact, {}), key, tolerance


USUAL = Usual("idealise", time_limit=TIME_LIMIT)


@explain_errors
@limit_time(USUAL)
def idealise(
    system: Model, tolerance: float | str | None = MEASURED, *, budget: Budget | None = None
) -> Idealised | None:
    """Find the nearest system that closes exactly and moves; see `System.idealise`."""
    return find_nearest_exact(system, tolerance)


def find_nearest_quickly(system: Model) -> Idealised | None:
    """Find the nearest mechanism in a short time, or None: used for hints."""
    return system._kept.get(find_nearest_exact, {}).get(MEASURED) or _search_nearest_quickly(system)


@keep_answers
def _search_nearest_quickly(system: Model) -> Idealised | None:
    """Search the nearest mechanism with one fit only."""
    return _search_nearest(system, read_requested_tolerance(system, MEASURED), False)


def find_ideal_system(system: Model) -> Model:
    """Return the nearest system that closes exactly within its tolerance, or the system itself."""
    found = find_nearest_exact(system)
    return system if found is None else found.system


def describe_nearest(found: Nearest | None) -> str:
    """Return the text about the nearest mechanism that an answer appends to its sentence."""
    return "" if found is None else f"; {found.sentence}"


def _search_nearest(
    system: Model, most: float, thorough: bool = True, time: TimeLimit = ENDLESS
) -> Idealised | None:
    """Search the nearest mechanism part by part; None where none is needed or found."""
    if system._ideal is not None or not _has_closures(system):
        return None
    if not system.nv:
        return None
    declared = system._mechanism.constraints
    if declared and (list_timed_constraints(system) or has_velocity_constraints(system)):
        return None
    tree = remove_cut_marks(system)
    parts = _split_parts(tree, most)
    if not parts:
        return None
    home = find_home(tree)
    scaled = most / compute_characteristic_length(tree) + most
    found = [
        _idealise_part(part, home[index], most, scaled, thorough, time) for part, index in parts
    ]
    return (
        _make_idealised(tree, [x for x in found if x is not None], home, most)
        if any(found)
        else None
    )


class _Found(NamedTuple):
    """A part of a mechanism with changed dimensions.

    `ideal` is the part that closes exactly; `q` (N, nq) are configurations of its motion.
    """

    ideal: Model
    places: tuple[Place, ...]
    q: Array
    freedoms: int


# ---- parts that move independently


def _split_parts(system: Model, most: float) -> list[tuple[Model, np.ndarray]]:
    """Split a system into clusters of loops that may need other dimensions.

    Each comes with the indices (nq,) of its coordinates in the whole q.

    Loops that share no velocity close by themselves: to change one does not change what another
    needs.
    """
    graph = build_constraint_graph(system)
    places = {name: i for i, name in enumerate(system.coordinate_names)}
    owner = {c.name: e.name for e in graph.edges for c in e.columns}
    out: list[tuple[Model, np.ndarray]] = []
    for cluster in graph.clusters:
        laws = [graph.laws[k] for k in cluster.laws]
        edges = {*cluster.edges, *(i for law in laws for i in law.edges)}
        parts = [graph.edges[i].of for i in sorted(edges)] + [law.of for law in laws]
        joints = {x.name for x in parts if isinstance(x, Joint)}
        constraints = {x.name for x in parts if isinstance(x, Declared)}
        if not joints:  # equations of coordinates have no dimensions
            continue
        alone = len(cluster.loops) == 1 and not constraints and not laws
        if alone and _needs_no_change(system, joints, most):
            continue
        joints |= {owner[system.structure.velocity_names[v]] for v in cluster.velocities.tolist()}
        part = _make_part(system, joints, constraints)
        index = [places[name] for name in part.coordinate_names]
        out.append((part, np.array(index, dtype=int)))
    return out


def _make_part(system: Model, joints: set[str], constraints: Collection[str]) -> Model:
    """Make the system of these joints and constraints alone, and of the joints that they follow.

    Bodies that no joint leads to from the ground are held there.
    """
    m = system.mechanism
    owner = {c: name for name in m.joints for c in system.structure.coordinates_of_joint(name)}
    sources = [(owner[c.of], {owner[x] for x in c.sources}) for c in m.couplings.values()]
    while more := {x for of, follows in sources if of in joints for x in follows} - joints:
        joints = joints | more
    if len(joints) == len(m.joints) and len(constraints) == len(m.constraints):
        return system
    m.joints = {name: j for name, j in m.joints.items() if name in joints}
    m.constraints = {name: c for name, c in m.constraints.items() if name in constraints}
    m.couplings = {name: c for name, c in m.couplings.items() if owner[c.of] in joints}
    m.locks = {c: x for c, x in m.locks.items() if owner[c] in joints}
    m.frames = {}
    m.postures = {}
    ends = [(j.parent, j.child) for j in m.joints.values()]
    bodies = {m.ground.name}.union(*ends)
    m.bodies = {name: b for name, b in m.bodies.items() if name in bodies}
    of_body = number_components(m.bodies, ends)
    held = {of_body[m.ground.name]}
    for body, number in of_body.items():
        if number not in held and not m.bodies[body].particle:
            held.add(number)
            m.fixed(choose_unused_name(m, HELD), m.ground, body)
    return type(system)(m)


def _needs_no_change(system: Model, names: Iterable[str], most: float) -> bool:
    """Return whether a planar loop of hinges keeps its freedoms for all dimensions nearby.

    Its equations depend on each other only where all hinges are on one line, which they are not all
    along a motion.
    """
    m = system._mechanism
    joints = [m.joints[name] for name in names]
    if system.dim != 2 or len(joints) < 4:
        return False
    if not all(
        isinstance(j.type, Revolute) and j.name in system.structure.coordinates.first
        for j in joints
    ):
        return False
    ends: dict[str, list[Array]] = {}
    for j in joints:
        for body, X in ((j.parent, j.X_PF), (j.child, j.X_CM)):
            ends.setdefault(body, []).append(X.evaluate_pose(m.parameters)[:2, 3])
    lengths = [float(np.linalg.norm(a - b)) for a, b in ends.values()]
    return min(lengths) > OPEN * most


# ---- the nearest mechanism of a part

# *Within a tolerance* a mechanism closes, and has so many freedoms, if changes of the placements of
# its joints by at most this tolerance, in metres and radians, make it close exactly with them.


def _idealise_part(
    system: Model, home: Array, most: float, scaled: float, thorough: bool, time: TimeLimit
) -> _Found | None:
    """Find the nearest exact mechanism of a part; None where it closes as it is, or none is near."""
    equations = pack_full_loops(system, True)
    if (
        not 0 < system.nv <= MOST
        or not len(equations.names)
        or any(t.function is not None for t in equations.ties)
    ):
        return None
    starts = _find_starts(system, home, scaled)
    moving = [(rank, q) for rank, q in starts if rank < system.nv]
    found = _try_starts(system, moving, most, scaled, thorough, time)
    if found is not None or len(moving) == len(starts):
        return found
    rigid = _try_starts(
        system, [(rank, q) for rank, q in starts if rank == system.nv], most, scaled, thorough, time
    )
    return None if rigid is None or _can_move_with_changes(system, home, most, time) else rigid


def _try_starts(
    system: Model,
    starts: Sequence[tuple[int, Array]],
    most: float,
    scaled: float,
    thorough: bool,
    time: TimeLimit,
) -> _Found | None:
    """Try ranks and start configurations in turn, and return the first exact mechanism of a part."""
    for rank, q in starts:
        time.check_time()
        found = _idealise_with_rank(system, rank, q, most, scaled, thorough, time)
        if found is not None:
            return found
    return None


def _can_move_with_changes(system: Model, home: Array, most: float, time: TimeLimit) -> bool:
    """Return whether larger changes, up to the largest tolerance, make a part close and move.

    Rounded loops of a mechanism nearly close at single places, where small changes close them. They
    make a structure of it, which says nothing of the mechanism that was meant.
    """
    size = compute_characteristic_length(system)
    widest = WIDEST * min(size, 1.0)
    if most >= widest:
        return False
    scaled = widest / size + widest
    moving = [(rank, q) for rank, q in _find_starts(system, home, scaled) if rank < system.nv]
    return _try_starts(system, moving, widest, scaled, False, time) is not None


def _find_starts(system: Model, home: Array, scaled: float) -> list[tuple[int, Array]]:
    """Find possible ranks of the equations, lowest first, with configurations to start from.

    Those about home come first.
    """
    valley = Valley(system, 0)
    equations = len(pack_full_loops(system, True).names)
    limit = OPEN * scaled
    exact = EXACT + 4.0 * np.finfo(float).eps * float(
        np.linalg.norm(choose_origin(system))
    ) / compute_characteristic_length(system)
    out: list[tuple[int, Array]] = []
    rng = np.random.default_rng(0)
    looked = 0
    regular = 0
    held = system.nv
    for k in range(BESIDE + 1):
        start = home
        if k:
            start = system.structure.layout.integrate_velocity(
                home, valley.scale * rng.normal(size=system.nv) * ASIDE
            )
        q = get_assembler_as_given(system)(start=start, budget=Budget(starts=FEW)).q
        left = float(valley.compute_residual(q))
        s = _scale_singular_values(valley.compute_spectrum(q).values, system.nv)
        if not left <= limit:
            if not k:
                return []
            continue
        if make_regular_chart(system, q)[2]:  # angles of a ball that move nothing are no motion
            continue
        looked += 1
        if left <= exact and equations <= system.nv and np.all(s[:equations] >= limit):
            regular += 1  # it closes for any dimensions near by
            if not k:
                return []
            continue
        if left > exact or np.any((s > exact) & (s < limit)):
            least = max(0.1 * min(left, scaled), EXACT)
            top = system.nv + (left > exact)
            for at in _choose_rank_configurations(valley, start, q, limit):
                here = _scale_singular_values(valley.compute_spectrum(at).values, system.nv)
                held = min(held, int(np.sum(here >= limit)))
                out += [(r, at) for r in _list_possible_ranks(here, top, limit, least)]
    # of this rank no equation is too many, or nothing moves
    top = min(system.nv, equations)
    if held < top - 1:
        out += _find_starts_beside(valley, home, held, top, limit, rng)
    return [] if regular == looked - 1 > 0 else _drop_close_starts(system, out, valley.scale)


def _find_starts_beside(
    valley: Valley, home: Array, held: int, top: int, limit: float, rng: np.random.Generator
) -> list[tuple[int, Array]]:
    """Find start configurations of ranks from `held` to below `top`, beside a singular home.

    Each motion leaves along some direction that nothing holds at home. Of those that are tried the
    ones come first on which least stays open.
    """
    system = valley.system
    null_space = valley.compute_spectrum(home).right[held:]
    ways = rng.normal(size=(WAYS, len(null_space))) @ null_space
    ways *= 2.0 * ASIDE / np.linalg.norm(ways, axis=1, keepdims=True)
    starts = system.structure.layout.integrate_velocity(
        np.tile(home, (WAYS, 1)), valley.scale * ways
    )
    out: list[tuple[int, Array]] = []
    for r in range(max(held, 1), top):
        along = Valley(system, r)
        found = along.converge_to_valley(starts)
        found = found[np.isfinite(found).all(axis=1)]
        left = valley.compute_residual(found)
        fit: list[tuple[int, Array]] = []
        for q in found[np.argsort(left)[: int(np.sum(left <= limit))]]:
            spectrum = along.compute_spectrum(q)
            ranks = _list_possible_ranks(
                _scale_singular_values(spectrum.values, system.nv), r + 1, limit, EXACT
            )
            if r in ranks and along.is_regular(spectrum):
                fit.append((r, q))
        out += fit[:FEW]
    return out


def _drop_close_starts(
    system: Model, starts: Sequence[tuple[int, Array]], scale: Array
) -> list[tuple[int, Array]]:
    """Drop the starts that are close to one before them with the same rank."""
    out: list[tuple[int, Array]] = []
    for r, q in starts:
        off = (
            system.structure.layout.compute_difference(x, q) / scale for same, x in out if same == r
        )
        if all(np.abs(x).max() > CLOSE for x in off):
            out.append((r, q))
    return out


def _scale_singular_values(s: Array, n: int) -> Array:
    """Return singular values (n,) relative to the largest; missing ones are zero."""
    return np.append(s, np.zeros(max(n - len(s), 0)))[:n] / max(float(s[0]), 1e-300)


def _choose_rank_configurations(
    valley: Valley, start: Array, q: Array, limit: float
) -> list[Array]:
    """Choose configurations at which a rank is read: the start and the best closed one, `q`.

    The loops of rounded numbers may close exactly far away only, where the mechanism is flat and
    other ranks are near.
    """
    layout = valley.system.structure.layout
    if valley.compute_residual(start) > limit:
        return [q]
    far = np.abs(layout.compute_difference(start, q) / valley.scale).max() > ASIDE
    return [start, q] if far else [start]


def _list_possible_ranks(s: Array, top: int, limit: float, least: float) -> list[int]:
    """List ranks below `top` at which relative singular values (n,) have a gap."""
    ratio = np.append(np.maximum(s, least), least)
    return [
        r for r in range(1, top) if ratio[r - 1] >= GAP * ratio[r] and (r == len(s) or s[r] < limit)
    ]


def _idealise_with_rank(
    system: Model, rank: int, q: Array, most: float, scaled: float, thorough: bool, time: TimeLimit
) -> _Found | None:
    """Find the nearest mechanism whose equations keep this rank along a motion near q.

    None if there is none.
    """
    shape = Dimensions(system)
    freedoms = system.nv - rank
    limit = OPEN * scaled
    valley = Valley(shape.system, rank)
    q = valley.converge_to_valley(q[None])[0]
    if not valley.compute_residual(q) <= limit:
        return None
    points = valley.walk_valley(q, limit, np.random.default_rng(0)) if freedoms else q[None]
    if freedoms and len(points) < ENOUGH:
        return None
    off = float(Valley(shape.system, rank).compute_residual(points).max())
    if off <= EXACT:
        return None
    nice = simplify_angles(system, min(most, NEARLY * off))
    if nice is not None and is_closed_along_valley(Valley(nice, rank), points):
        return _Found(nice, tuple(shape.places), points, freedoms)
    found = fit_whole_motion(shape, rank, points, most, time, tries=len(DAMPING) if thorough else 1)
    if thorough:
        found = _choose_best_fit(found, shape, rank, points, most, time)
    return (
        _Found(shape.change_dimensions(found.p, system), tuple(shape.places), found.q, freedoms)
        if found.closed
        else None
    )


def _choose_best_fit(
    found: Fit, shape: Dimensions, rank: int, q: Array, most: float, time: TimeLimit
) -> Fit:
    """Choose between a fit and one that also obeys relations that nearly hold.

    The latter is taken if it closes with small changes.
    """
    off = float(Valley(shape.system, rank).compute_residual(q).max())
    size = float(np.abs(found.p).max()) if found.closed else off
    if size <= EXACT or off <= EXACT or not found.closed and found.left > NEARLY_CLOSED:
        return found
    relations = Relations(shape, NEARLY * size)
    if not relations.rows:
        return found
    largest = min(most, NEARLY * size * shape.unit.max()) if found.closed else most
    nicer = fit_whole_motion(
        shape, rank, q, largest, time, relations, 1 if found.closed else len(DAMPING)
    )
    return nicer if nicer.closed else found


# ---- differences between two mechanisms, in words


def _make_idealised(
    system: Model, changed: Sequence[_Found], home: Array, most: float
) -> Idealised | None:
    """Make the answer from the changed parts, with their differences in words.

    None where the changes are so small that all placements stay what they are.
    """
    m = system.mechanism
    new = system.mechanism
    size = 0.0
    changes: list[tuple[str, str, Any, Any, float, float]] = []
    absorbed: dict[str, float] = {}
    index = {name: i for i, name in enumerate(system.coordinate_names)}
    for part in changed:
        for table, name, side in part.places:
            parts = getattr(new, table)
            parts[name] = replace(
                parts[name], **{side: getattr(getattr(part.ideal.mechanism, table)[name], side)}
            )
            old, becomes = (
                getattr(getattr(x, table)[name], side).evaluate_pose(m.parameters) for x in (m, new)
            )
            before: Array = old
            between = np.linalg.inv(before) @ becomes
            twist = log_so3(between[:3, :3])
            slide = becomes[:3, 3] - old[:3, 3]
            by = float(np.linalg.norm(slide)), float(np.linalg.norm(twist))
            size = max(size, float(np.abs(slide).max()), float(np.abs(twist).max()))
            changes.append((name, side, old, becomes, *by))
        q = np.tile(home, (len(part.q), 1))
        q[:, [index[name] for name in part.ideal.coordinate_names]] = part.q
        own = {name for _, name, _ in part.places}
        off = np.abs(compute_residual(system, q)).max(axis=0)
        for (name, _), x in zip(list_row_names(system), off.tolist(), strict=True):
            if name in own:
                absorbed[name] = max(x, absorbed.get(name, 0.0))
    if size == 0.0:
        return None
    reported = [
        Change(name, side, *_format_pose_change(old, becomes, m.dim, SHOWN * size), *by)
        for name, side, old, becomes, *by in changes
        if max(by) >= SHOWN * size
    ]
    reported.sort(key=lambda c: -max(c.moved, c.turned))
    ideal = adopt_characteristic_length(type(system)(new, system.structure.topology), system)
    at = home.copy()
    for part in changed:  # what does not change counts as it is at home
        at[[index[name] for name in part.ideal.coordinate_names]] = part.q[-1]
    freedoms = count_remaining_freedoms(
        ideal, at, frozenset(n for x in changed for n in x.ideal.structure.velocity_names)
    )
    freedoms += sum(x.freedoms for x in changed)
    left = max(absorbed.values(), default=0.0)
    answer = Idealised(system, ideal, most, size, left, freedoms, tuple(reported), absorbed)
    vars(ideal)["_ideal"] = answer  # it is frozen, and known only now
    return answer


def _format_pose_change(old: Array, new: Array, dim: int, least: float) -> tuple[str, str]:
    """Format the entries of two poses that differ by `least`: x, y, z and fixed-axis angles."""
    names = ("x", "y", "z", "roll", "pitch", "yaw") if dim == 3 else ("x", "y", "", "", "", "angle")
    a = xyz_rpy_from_pose(old)
    b = xyz_rpy_from_pose(new)
    digits = max(3, 2 - math.floor(math.log10(least)))
    differ = [i for i in range(6) if abs(a[i] - b[i]) >= least] or [int(np.argmax(np.abs(a - b)))]
    said = [
        ", ".join(f"{names[i]} {_format_number(x[i], i > 2, digits)}" for i in differ if names[i])
        for x in (a, b)
    ]
    return said[0], said[1]


def _format_number(x: float, is_angle: bool, digits: int) -> str:
    """Format a number; angles that are simple fractions of pi by name."""
    from fractions import Fraction

    part = Fraction(round(12.0 * x / math.pi), 12)
    if is_angle and part and abs(x - math.pi * part) < 1e-14:
        return f"{'-' * (part < 0)}{abs(part.numerator) if abs(part.numerator) > 1 else ''}pi" + (
            f"/{part.denominator}" if part.denominator > 1 else ""
        )
    return f"{x:.{digits}f}"


# ---- verbs that answer within a tolerance


def answer_within_tolerance(*closed: str) -> Callable[[Function], Function]:
    """Decorate a verb so that the nearest mechanism within its `tolerance` answers.

    `closed` are its arguments that are configurations and must close the loops: they are led to
    where that one does.
    """

    def wrap_function(function: Function) -> Function:
        """Wrap a verb."""

        @functools.wraps(function)
        def call_on_nearest_mechanism(system: Model, *args: Any, **options: Any) -> Any:
            """Call the verb on the nearest mechanism, and store that in its answer."""
            found = find_nearest_exact(system, options.pop("tolerance", None))
            if found is None:
                return function(system, *args, **options)
            for name in closed:
                if args and args[0] is not None:
                    args = (found.close_configurations(args[0]), *args[1:])
                elif options.get(name) is not None:
                    options[name] = found.close_configurations(options[name])
            answer = function(found.system, *args, **options)
            named = {f.name for f in fields(answer)} if is_dataclass(answer) else ()
            return replace(answer, within=found) if "within" in named else answer  # type: ignore[type-var]

        return call_on_nearest_mechanism  # type: ignore[return-value]

    return wrap_function
