"""Closed form of planar mechanisms made of dyads: all configurations for known coordinates.

The signs of the dyads name the branch of a configuration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.answer import Answer
from kempe.answers.known_values import find_source_values, list_known_tasks
from kempe.arguments import explain_errors, explain_method_errors, read_distinct_names
from kempe.arrays import read_reals
from kempe.assemble.dyad_decomposition import Decomposition, Dyad, PartLine, build_parts
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.forward.fk import fk
from kempe.kernels import compiled
from kempe.model.configurations import read_q, read_start, refuse_large_numbers
from kempe.model.model import keep_answers, store_answer
from kempe.numerics.pool import sum_over_chunks
from kempe.report import Report
from kempe.spatial import Array
from kempe.status import Status, to_status
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.assemble.dyad_formulas import DyadFormulas
    from kempe.model.model import Model


CLOSED = 1e-12
"""Openings below this share of the mechanism's size are rounding."""
CHUNK = 8192
SERIAL_BELOW = 20_000
STEP = 0.1
"""Largest change of a coordinate between two rows, in radians and characteristic lengths, as a part
of the least margin of a dyad, for a sequence of rows to stay on its branch: the sine of the angle
between the links is that margin."""
MOST_SIGNS = 16
"""Branch signs up to which all combinations are tried: 65536 configurations."""


@dataclass(frozen=True, repr=False)
class Incomplete(Report):
    """Report that there is no closed form.

    Attributes
    ----------
    reason
        Why there is none.
    bodies
        Bodies that no dyad places.
    """

    _entries = ("bodies",)

    reason: str
    bodies: tuple[str, ...] = ()

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome `NOT_FOUND`: it is not proven that no closed form exists."""
        return Status.NOT_FOUND

    @property
    def status(self) -> str:
        """Reason why there is no closed form, as a sentence."""
        return self.reason

    def describe(self) -> str:
        """Return the reason why there is no closed form; see `Plan.describe`."""
        return self.reason

    def formulas(self, *args: Any, **options: Any) -> NoReturn:
        """Raise an `UnsupportedError` with the reason why there is no closed form.

        Errors: `UnsupportedError`.
        """
        raise UnsupportedError(
            f"{self.reason}; `assemble` and `assembly_modes` find its configurations by numbers"
        )

    solve = close = all = heights = branch_of = formulas


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class DyadAnswer(Answer):
    """Configurations `q` (..., nq) on a branch, with a mask of the closed configurations.

    `success` or `ok` say so; `gap` are the openings in metres.

    `undetermined` (...) counts the parts of each that these inputs leave free: links without
    length, circles with one centre, parallel lines. They got one of their infinitely many
    positions.
    """

    what = "configurations closed"
    _entries = ("gap", "undetermined")

    q: Array
    success: Any
    gap: Any
    undetermined: Any
    closing: tuple[Plan, Array]
    """The plan, and the values (n, known) that it was to close."""

    @property
    def system(self) -> Model:
        """The system of the problem."""
        return self.closing[0].system

    @property
    def ok(self) -> Any:
        """Mask (...) of the closed configurations: another name of `success`."""
        return self.success

    @property
    def code(self) -> Any:
        """Outcome (...) for this branch; other branches may close where this branch does not."""
        sound = np.isfinite(self.closing[1]).all(axis=-1).reshape(np.shape(self.success))
        left = np.where(sound, Status.NOT_FOUND, Status.BAD_INPUT)
        return to_status(np.where(self.success, Status.SOLVED, left))

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:

        plan, values = self.closing
        columns = values.T.reshape(len(plan.known), *np.shape(self.success))
        return list_known_tasks(self.system, dict(zip(plan.known, columns, strict=True)))

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        code, gap, free = (
            np.asarray(x)[index].item() for x in (self.code, self.gap, self.undetermined)
        )
        if code == Status.BAD_INPUT:
            return "known values are not finite or too large"
        if code != Status.SOLVED:
            text = f"open by {gap:.6g} m on this branch; q is where it nearly touches"
            return text + (
                f"; {format_count(free, 'part')} left undetermined, which may close elsewhere"
                if free
                else ""
            )
        return f"closed: open by {gap:.1e} m" + (
            f"; {format_count(free, 'part')} left undetermined" if free else ""
        )


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Plan(Report):
    """Closed form of a mechanism for known coordinates: dyads that are solved one after the other.

    Attributes
    ----------
    known
        Names of the known coordinates.
    dyads
        The dyads in order.
    signs
        Number of dyads with two roots; a branch sign, +1 or -1, chooses the root of each.
    tolerance
        Openings up to this length in metres count as closed.

    Notes
    -----
    A sign stays along a motion until its `heights` is zero, where two branches meet. Most
    mechanisms turn back there. At a change point, such as a flat parallelogram, a smooth motion
    continues with the other sign. Method: intersections of circles and lines of the dyads (Assur,
    1914), for vectors of configurations.
    """

    _entries = ("system", "known", "signs")

    system: Model
    known: tuple[str, ...]
    dyads: tuple[Dyad, ...]
    tolerance: float
    program: tuple[np.ndarray, np.ndarray]

    @property
    def signs(self) -> int:
        """Number of branch signs."""
        return sum(d.sign is not None for d in self.dyads)

    @property
    def status(self) -> str:
        """Sentence that names the known coordinates and the number of dyads."""
        return (
            f"{self.system.name} from {', '.join(self.known) or 'nothing'}: "
            f"{format_count(len(self.dyads), 'dyad')}"
        )

    def describe(self) -> str:
        """Return a line of text for each dyad, with the meaning of its branch sign."""
        return str(self)

    def _list_notes(self, degrees: bool = False) -> list[str]:
        return [
            f"{'sign ' + str(d.sign + 1) if d.sign is not None else 'no sign'}: {d}"
            for d in self.dyads
        ]

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {"dyads": self._list_notes()}

    def formulas(self, *, symbols: Mapping[str, Any] | None = None) -> DyadFormulas:
        """Return the closed form as formulas, which can be called, printed, and written as code.

        `symbols` replaces coordinates and parameters as in `symbolic.fk`. Errors:
        `UnsupportedError` for rods and slots without bodies of their own, laws of several
        coordinates, and links that are several bodies; `MissingExtraError` without sympy.
        """

        from kempe.assemble.dyad_formulas import derive_formulas

        return derive_formulas(self, symbols)

    def solve(
        self, values: ArrayLike, branch: Any = None, start: Any = None, threads: int | None = None
    ) -> tuple[Array, Any, Any]:
        """Solve for configurations on one branch.

        Parameters
        ----------
        values
            Values (..., n_known) in the order of `known`. NaN gives NaN.
        branch
            Signs, (signs,) or (..., signs), or text such as '+-' (default: the branch of `start`,
            else + everywhere).
        start
            Configurations (nq,) or (..., nq): angles are the nearest to them (default: to zero),
            and inside the limits if a representative is.
        threads
            Number of threads for a large batch.

        Returns
        -------
        tuple
            Configurations (..., nq), a mask (...) of the closed ones, and openings (...) in metres.
            Dyads that cannot close are placed where they nearly touch.
        """
        closed = self.close(values, branch, start, threads)
        return closed.q, closed.ok, closed.gap

    def close(
        self, values: ArrayLike, branch: Any = None, start: Any = None, threads: int | None = None
    ) -> DyadAnswer:
        """Solve for configurations, and count the parts that the values leave undetermined."""
        q, status, given, lead = self._solve_rows(values, branch, start, threads)
        gap = status[:, 0]
        ok = (gap <= self.tolerance) & np.isfinite(given).all(axis=-1)
        if not lead:
            return DyadAnswer(q[0], bool(ok[0]), float(gap[0]), int(status[0, 1]), (self, given))
        ok, gap, free = (x.reshape(lead) for x in (ok, gap, status[:, 1].astype(int)))
        return DyadAnswer(q.reshape(*lead, q.shape[-1]), ok, gap, free, (self, given))

    def _solve_rows(
        self, values: ArrayLike, branch: Any, start: Any, threads: int | None
    ) -> tuple[Array, Array, Array, tuple[int, ...]]:
        """Solve as `solve` does, with rows instead of leading axes.

        Returned are what `_run_program` returns, the values (N, n_known), and their leading shape.
        """
        given, lead = self.values(values)
        if start is None:
            targets = np.zeros((1, self.system.nq))
        else:
            targets = _shape_rows(read_start(self.system, start), lead, "near")
            refuse_large_numbers(self.system, targets, "start")
        signs = self.sign_rows(
            branch, targets if branch is None and start is not None else None, lead
        )
        q, status = self._run_program(given, signs, targets, threads)
        return q, status, given, lead

    def all(self, values: ArrayLike, start: Any = None) -> tuple[Array, np.ndarray]:
        """Solve on all branches: q (..., 2**signs, nq), and a mask (..., 2**signs) of closed q.

        Branches are in the order of `branches()`. Angles are nearest to `start` (nq,), else to
        zero.
        """
        given, lead = self.values(values)
        signs = self.branches()
        k = len(signs)
        nq = self.system.nq
        targets = (
            np.zeros((1, nq))
            if start is None
            else _shape_rows(read_start(self.system, start), (), "near")
        )
        refuse_large_numbers(self.system, targets, "start")
        many = np.repeat(given, k, axis=0)
        q, status = self._run_program(many, np.tile(signs, (len(given), 1)), targets)
        mask = (status[:, 0] <= self.tolerance) & np.isfinite(many).all(axis=-1)
        return q.reshape(*lead, k, nq), mask.reshape(*lead, k)

    def branches(self) -> Array:
        """Return all combinations of signs (2**signs, signs), + before -.

        Errors: `InputError` where they are too many.
        """
        if self.signs > MOST_SIGNS:
            raise InputError(
                f"there are 2**{self.signs} branches; all of them are listed up to 2**{MOST_SIGNS}"
            )
        return np.array(list(product((1.0, -1.0), repeat=self.signs))).reshape(
            2**self.signs, self.signs
        )

    def heights(self, q: Any) -> Array:
        """Compute the signed lengths whose signs name the branch.

        Parameters
        ----------
        q
            Configurations (..., nq).

        Returns
        -------
        Array
            Lengths (..., signs) in metres; zero where two branches meet. For three revolute joints
            it is the distance of the middle joint from the line through the others; with a
            prismatic joint, its displacement from where its two roots meet.
        """
        q = read_q(self.system, q)
        X = fk(self.system, q)
        out = np.empty((*q.shape[:-1], self.signs))
        for d in self.dyads:
            if d.sign is None:
                continue
            first, line, last = (self._locate_line(X, e) for e in d.ends)
            to = last[0] - first[0]
            if d.along:
                out[..., d.sign] = np.sum(line[1] * to, axis=-1)
                continue
            way = line[0] - first[0]
            length = np.linalg.norm(way, axis=-1, keepdims=True)
            base = X[..., d.base, :2, 0]
            unit = np.where(length > 0.0, way / np.where(length > 0.0, length, 1.0), base)
            out[..., d.sign] = unit[..., 0] * to[..., 1] - unit[..., 1] * to[..., 0]
        return out

    def branch_of(self, q: Any) -> Array:
        """Return the branch signs (..., signs) of closed configurations q (..., nq).

        They are +1 or -1, and +1 where two branches meet.
        """
        return np.where(self.heights(q) < 0.0, -1.0, 1.0)

    def _locate_line(self, X: Array, end: PartLine) -> tuple[Array, Array]:
        """Return positions and directions (..., 2) of a line on a part with poses X."""
        pose = X[..., end.part, :, :]
        point = pose[..., :2, 3] + pose[..., :2, :2] @ np.array([end.x, end.y])
        return point, pose[..., :2, :2] @ np.array([end.dx, end.dy])

    def _continue_configuration(
        self, values: Array, before: Array, unit: Array, turns: np.ndarray
    ) -> Array | None:
        """Solve for configurations (N, nq) that continue the closed one `before` (nq,).

        `values` (N, n_known) are the known coordinates; None where a row comes near to another
        branch.

        They lie on its branch, and each follows the row before it without a jump. None where a row
        does not close, is undetermined, or differs from the row before it by more than `STEP` of
        the least margin of its dyads: the branch alone does not say there how the sequence goes on.
        `unit` (nq,) are the coordinates of one radian or one characteristic length; `turns` are
        indices of those that a full turn brings back.
        """
        q, status = self._run_program(values, self.branch_of(before)[None], before[None], 1)
        if not (np.all(status[:, 0] <= self.tolerance) and np.all(status[:, 1] == 0.0)):
            return None
        turning = set(turns.tolist())
        given = {self.system.coordinate_names.index(name) for name in self.known}
        most = np.zeros(len(q))
        for i in range(self.system.nq):
            if i in given:
                continue
            change = np.diff(q[:, i], prepend=before[i])
            if i in turning:
                back = np.rint(change / (2.0 * math.pi))
                if back.any():
                    q[:, i] -= 2.0 * math.pi * np.cumsum(back)
                    change -= 2.0 * math.pi * back
            np.maximum(most, np.abs(change) / unit[i], out=most)
        return q if np.all(most <= STEP * status[:, 2]) else None

    def _run_program(
        self, values: Array, signs: Array, targets: Array, threads: int | None = None
    ) -> tuple[Array, Array]:
        """Run the kernel for known values (N, n_known); of n designs, N / n rows belong to each.

        Returns configurations (N, nq) and, of each, the opening, the number of undetermined parts
        and the margin (N, 3).
        """
        ints = self.program[0]
        floats = np.atleast_2d(self.program[1])
        q = np.empty((len(values), self.system.nq))
        status = np.empty((len(values), 3))
        # what is cut into chunks: rows, or the designs with all their rows
        each = max(len(values) // len(floats), 1) if len(floats) > 1 else 1

        def solve_chunk(i: int, j: int) -> int:
            """Solve the rows, or the designs, i to j."""
            rows = slice(i * each, j * each)
            f, s, t = (
                a if len(a) == 1 else a[part]
                for a, part in ((floats, slice(i, j)), (signs, rows), (targets, rows))
            )
            return compiled.dyads_program.run_program(
                ints, f, values[rows], s, t, q[rows], status[rows]
            )

        chunk = max(CHUNK // each, 1)
        sum_over_chunks(solve_chunk, len(values) // each, chunk, threads, SERIAL_BELOW // each)
        return q, status

    def values(self, values: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """Return the known values as an array (N, n_known), and their leading shape.

        Errors: `InputError`.
        """
        array = read_reals(values, "values")
        if array.ndim == 0 or array.shape[-1] != len(self.known):
            got = "a single number" if array.ndim == 0 else f"shape {array.shape}"
            raise InputError(
                f"values have {got}; they must be (..., {len(self.known)}): {', '.join(self.known)}"
            )
        lead = array.shape[:-1]
        return np.ascontiguousarray(array.reshape(math.prod(lead), len(self.known))), lead

    def sign_rows(self, branch: Any, start: Array | None, lead: tuple[int, ...]) -> Array:
        """Return the branch signs (1 or N, signs): of `branch`, else of `start`, else all +.

        Errors: `InputError`.
        """
        if branch is None:
            return (
                np.ones((1, self.signs))
                if start is None
                else np.ascontiguousarray(self.branch_of(start))
            )
        if not isinstance(branch, str):
            return self._read_signs(branch, lead)
        signs = self._signs_by_text.get(branch)
        if signs is None:
            given = [{"+": 1.0, "-": -1.0}.get(c, math.nan) for c in branch]
            signs = store_answer(self._signs_by_text, branch, self._read_signs(given, lead, branch))
        return signs

    @cached_property
    def _signs_by_text(self) -> dict[str, Array]:
        """Branch signs (1, signs) by the text that names them."""
        return {}

    def _read_signs(self, given: Any, lead: tuple[int, ...], said: Any = None) -> Array:
        """Read branch signs, rows (1 or N, signs). Errors: `InputError`, with the text `said`."""
        signs = read_reals(given, "branch", "signs, +1 or -1")
        if signs.ndim == 0 or signs.shape[-1] != self.signs or not np.all(np.abs(signs) == 1.0):
            each = f"{format_count(self.signs, 'sign')}, + or - (1 or -1), one for each dyad"
            raise InputError(
                f"branch is {given if said is None else said!r}; it must be {each} (assembly_modes "
                "lists the branches), or the name of a posture"
            )
        return _shape_rows(signs, lead, "branch")


def _shape_rows(x: Array, lead: tuple[int, ...], what: str) -> Array:
    """Reshape `x` to (1 or N, k); its leading axes must be none, or those of the values."""
    if x.ndim > 1 and x.shape[:-1] != lead:
        raise InputError(
            f"{what} has shape {x.shape}; it must be ({x.shape[-1]},) or {(*lead, x.shape[-1])}"
        )
    return np.ascontiguousarray(x.reshape(math.prod(x.shape[:-1]), x.shape[-1]))


@explain_errors
def find_closed_form(system: Model, known: Sequence[str] | str) -> Plan | Incomplete:
    """Find the closed form of a planar system for given known coordinates.

    Returns `Incomplete` with the reason where there is none.

    It exists for bodies, joined by revolute, prismatic and fixed joints, that are placed by known
    coordinates, their followers, and dyads of three rigid clusters (Assur groups of the second
    class). Errors: `UnknownNameError` for the names, `InputError` for one that is not in q.
    """
    return _decompose_system(system, read_distinct_names(known, "known"))


def solve_branch(
    system: Model,
    known: Mapping[str, Any],
    branch: Any,
    near: Any = None,
    threads: int | None = None,
) -> Array:
    """Solve for configurations (..., nq) on a branch, for known values by coordinate name.

    What cannot close on this branch is put where it nearly touches. Errors: `InputError` where
    there is no closed form, and so no branch signs, and where the place of a frame is known.
    """
    own = (*system.coordinate_names, *system.structure.couplings)
    if places := [name for name in known if name in system.frame_names and name not in own]:
        raise InputError(
            f"signs name a branch where coordinates are known, and {places[0]!r} is a frame; give a "
            "start in place of the branch"
        )
    values = find_source_values(system, known)
    plan = _decompose_system(system, tuple(values))
    if isinstance(plan, Incomplete):
        raise InputError(f"branch {branch!r} cannot be looked up: {plan.reason}")
    shapes = [column.shape for column in values.values()]
    lead = np.broadcast_shapes(*shapes) if any(shapes) else ()
    stacked = np.empty((*lead, len(values)))
    for i, column in enumerate(values.values()):
        stacked[..., i] = column
    q = plan._solve_rows(stacked, branch, near, threads)[0]
    return q.reshape(*lead, system.nq)


@keep_answers
def _decompose_system(system: Model, names: tuple[str, ...]) -> Plan | Incomplete:
    """Decompose a planar system into dyads, for known coordinates."""
    return decompose_designs(system, names, system.structure.parameters)


def decompose_designs(
    system: Model, names: tuple[str, ...], parameters: Mapping[str, Any]
) -> Plan | Incomplete:
    """Decompose a planar system into dyads, for known coordinates and values of the parameters.

    Of designs, with arrays (n,) of values, the `program` has floats (n, k) and a `tolerance` (n,).
    """
    slots = {c: i for i, c in enumerate(system.coordinate_names)}
    for name in names:
        if name in slots:
            continue
        follower = system.structure.couplings.get(name)
        if follower is None:
            raise UnknownNameError("coordinate", name, system.coordinate_names, system.name)
        follows = (
            f"it follows {follower.source!r}"
            if follower.source
            else f"it is held at {follower.offset:g}"
        )
        raise InputError(f"coordinate {name!r} is not part of q: {follows}")
    parts = build_parts(system, parameters)
    if parts.trouble:
        return Incomplete(f"no closed form: {parts.trouble}")
    search = Decomposition(system, parts, [slots[n] for n in names])
    left = search.close_dyads()
    if left:
        return _explain_incomplete(search, left)
    dyads = tuple(_convert_to_bodies(d, parts.reps) for d in search.dyads)
    program = search.code.pack_arrays([slots[n] for n in names])
    return Plan(system, names, dyads, CLOSED * parts.size, program)


def _convert_to_bodies(dyad: Dyad, reps: tuple[int, ...]) -> Dyad:
    """Return a dyad whose points are numbered by bodies instead of parts."""
    ends = tuple(PartLine(reps[e.part], *e.rail) for e in dyad.ends)
    return Dyad(
        dyad.kind, dyad.base, dyad.bodies, dyad.joints, dyad.sign, dyad.meaning, ends, dyad.along
    )


def _explain_incomplete(search: Decomposition, left: list[int]) -> Incomplete:
    """Explain why dyads do not place all bodies: too little is known, or no dyad is left."""
    bodies = tuple(b for c in left for p in search.members[c] for b in search.parts.names[p])
    shown = ", ".join(bodies[:8]) + (f", ... ({len(bodies)} in all)" if len(bodies) > 8 else "")
    missing = search.count_freedoms()
    if missing > 0:
        them = "coordinate" if missing == 1 else "coordinates"
        why = f"by counting, {missing} more {them} must be known"
    else:
        why = "they form an Assur group of a higher class, which has no dyad"
    return Incomplete(
        f"no closed form: {shown} cannot be placed one dyad after another; {why}", bodies
    )
