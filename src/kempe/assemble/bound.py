"""Reusable assembly: names and loops are prepared once for many sets of known values.

Systems with one-sided constraints have a solver of their own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.known_values import convert_places, read_place
from kempe.answers.problem import Choice, Problem, record_choice
from kempe.arguments import (
    compute_deadline,
    draw_seed,
    explain_errors,
    quiet,
    read_flag,
    read_names,
    read_start_count,
)
from kempe.arrays import check_range, is_real, read_reals
from kempe.assemble.answer import Assembly
from kempe.budget import Budget, TimeUp, Usual, check_for_stop, list_checks
from kempe.equations.closure_rows import count_remaining_freedoms
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError, UnknownNameError
from kempe.kernels.base import search_layout as S
from kempe.kernels.base.search_layout import BAD_INPUT, LARGEST, LATE, NOT_FOUND, SOLVED, UNFINISHED
from kempe.kernels.compiled import closure_batch, loop_closing, task_search
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.loop_layout import view_velocity_lists
from kempe.model.configurations import (
    compute_source_values,
    find_free_angles,
    find_home,
    list_sources,
    read_start,
    refuse_large_numbers,
)
from kempe.model.model import keep_answers
from kempe.model.own_tree import remove_cut_marks
from kempe.model.packed_loops import PackedLoops, find_explicit_joints, get_packed_loops
from kempe.numerics.clock import SHORT, TimeLimit, get_clock
from kempe.numerics.pool import sum_over_chunks
from kempe.poses import check_poses
from kempe.spatial import Array
from kempe.status import MEMBERS, Status

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- systems with one-sided constraints

# The solver of tasks holds all equations and bounds. Its steps are small quadratic programmes with
# an active set (`kempe.kernels.tasks.task_search`). What it finds is then led back towards its
# start, so that a start that violates a bound is brought to the nearest place where all hold.

BOUNDED_CHUNK = 16
BOUNDED_SERIAL_BELOW = 32
BOUNDED_MANY = 60
"""Rows from which on the clock is looked at within a start."""


@dataclass(frozen=True, eq=False)
class OneSidedAssembly:
    """Assembly of a system with one-sided constraints, by an active set.

    `weights` are those of the packed `loops`, with or without limits; `steps` and `tolerance` are
    those of one start.
    """

    system: Model
    loops: PackedLoops
    weights: Array
    steps: int
    tolerance: float
    rng: int
    threads: int | None

    @property
    def held_mask(self) -> np.ndarray:
        """Mask (nv,) of the velocity coordinates whose values are given."""
        return np.isin(np.arange(self.system.nv), self.loops.unknown, invert=True)

    def assemble_batch(
        self, starts: Array, pins: Array, tries: int, q: Array, residual: Array, info: np.ndarray
    ) -> None:
        """Assemble from starts (N, nq) into `q` (N, nq), `residual` (N,) and `info` (N, 3).

        A row of `info` is (status, steps, starts), as kernels write it.

        Where `TimeUp` ends it, what was found by then is written.
        """
        try:
            self._search_batch(starts, pins, tries, 0, q, info)
        finally:
            residual[:] = self.compute_residuals(q, pins)

    def assemble_sequence(
        self, starts: Array, pins: Array, tries: int, q: Array, residual: Array, info: np.ndarray
    ) -> None:
        """Assemble rows in sequence, each from the extrapolation of the two rows before it.

        The known coordinates are those of each row.
        """
        try:
            self._search_sequence(starts, pins, tries, q, info)
        finally:
            residual[:] = self.compute_residuals(q, pins)

    def _search_sequence(
        self, starts: Array, pins: Array, tries: int, q: Array, info: np.ndarray
    ) -> None:
        """Search row after row, each from the extrapolation of the two rows before it."""
        for i in range(len(starts)):
            first = starts[i : i + 1]
            if i:
                ahead = self.system.structure.layout.compute_difference(q[max(i - 2, 0)], q[i - 1])
                first = self._copy_held_coordinates(
                    self.system.structure.layout.integrate_velocity(q[i - 1], ahead)[None], first
                )
            own = pins[i : i + 1] if len(pins) > 1 else pins
            self._search_batch(first, own, tries, i, q[i : i + 1], info[i : i + 1])

    def compute_residuals(self, q: Array, pins: Array) -> Array:
        """Return norms (N,) of violations, in radians and characteristic lengths."""
        loops = self.loops
        m = len(self.loops.names)
        g = np.empty((len(q), m))
        none = np.empty((0, m, 0))
        closure_batch.evaluate_equations(
            loops.ints,
            loops.floats,
            loops.plan,
            self.weights,
            pins,
            np.ascontiguousarray(q),
            False,
            g,
            none,
        )
        return np.linalg.norm(g - np.clip(g, *loops.bounds), axis=1)

    def _search_batch(
        self, starts: Array, pins: Array, tries: int, offset: int, q: Array, info: np.ndarray
    ) -> None:
        """Search from the starts, then from random ones around them in growing distance.

        Writes configurations `q` and rows (status, steps, starts) of `info`.
        """
        self._solve_starts(starts, starts, pins, q, info)
        left = np.flatnonzero(info[:, 0] == S.NOT_FOUND)
        nv = self.system.nv
        least = self.compute_residuals(q, pins)
        scale = self.loops.scale * ~self.held_mask
        count = 1
        while count < tries and len(left):
            each = [
                np.random.default_rng((self.rng, offset + int(i), count)).uniform(-1.0, 1.0, nv)
                for i in left
            ]
            spread = min(1.0, L.WIDER * count) * np.pi * scale
            some = pins[left] if len(pins) > 1 else pins
            begin = self.system.structure.layout.integrate_velocity(
                starts[left], np.stack(each) * spread
            )
            found = begin.copy()
            more = np.zeros((len(left), 3), dtype=np.int64)
            # until these starts are made
            before = info[left, 0]
            info[left, 0] = S.NOT_FOUND + S.LATE
            self._solve_starts(begin, starts[left], some, found, more)
            info[left, 0] = before
            size = self.compute_residuals(found, some)
            better = (more[:, 0] == S.SOLVED) | (size < least[left])
            q[left[better]] = found[better]
            least[left[better]] = size[better]
            info[left, 0] = more[:, 0]
            info[left, 1:] += more[:, 1:]
            left = left[more[:, 0] == S.NOT_FOUND]
            count = count + 1

    def _solve_starts(
        self, starts: Array, goals: Array, pins: Array, q: Array, info: np.ndarray
    ) -> None:
        """Solve from one start per row, with the solutions drawn towards `goals`.

        Raises `TimeUp` where the time ends it.
        """
        loops = self.loops
        ties = len(self.loops.ties)
        stages = np.ones(2 * ties, dtype=np.int64)
        strengths = np.ones((ties, 3))
        strengths[:, 1:] = self.tolerance

        # each start is short, else
        stop = get_clock().address if len(loops.names) >= BOUNDED_MANY or loops.functions else 0

        def solve_chunk(i: int, j: int) -> int:
            """Solve the rows i to j by the kernel."""
            left = task_search.solve_tasks(
                loops.ints,
                loops.floats,
                loops.plan,
                self.weights,
                stages,
                strengths,
                starts[i:j],
                goals[i:j],
                pins[i:j] if len(pins) > 1 else pins,
                1,
                self.steps,
                S.AHEAD,
                stop,
                False,
                self.rng,
                q[i:j],
                info[i:j],
            )
            if error := get_clock().take_error():
                raise error
            return left

        sum_over_chunks(solve_chunk, len(starts), BOUNDED_CHUNK, self.threads, BOUNDED_SERIAL_BELOW)

    def _copy_held_coordinates(self, q: Array, known: Array) -> Array:
        """Return configurations (N, nq) with the known coordinates of others."""
        layout = self.system.structure.layout
        held = self.held_mask
        out = q.copy()
        at = layout.vector_q[held[layout.vector_v]]
        out[:, at] = known[:, at]
        for iq, iv in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
            if held[iv]:
                out[:, iq : iq + 4] = known[:, iq : iq + 4]
        return out


# ---- the assembler

STARTS = 20
"""Starts before an assembly is given up; from a guess 1 rad off 95 to 100 % of the first ones
close."""
STEPS = 60
"""Steps of a start; 3 to 6 are usual, at singular positions up to 50."""
LARGE = 24
"""Equations between frames or coordinates from which on later starts change only a part of the
mechanism."""
WHOLE = 0.1
"""Part of the starts that are drawn anew as a whole, after those that change a part only."""
LOCAL_STEPS = 20
"""Steps of a start that changes a part; a third of those of another, so that three of them count as
one start."""
HOPS = 4
"""How far from an open place, counted in loops that share coordinates, a start is changed at
most."""
TOLERANCE = 1e-10
"""Largest norm of the closure equations of a success, in radians and characteristic lengths; 1e-15
is usual."""
NOT_FINITE = "known values and start lead to numbers that are not finite"
LOOSEST = 1e-3
"""The largest tolerance that can be requested: above it, an open loop would be called closed."""
NEAREST_STEPS = 50
"""Steps at most towards the closed configuration nearest to the start."""
PREFER = (None, "nearest", "continuous")
MANY = 60
"""Equations from which on one start may take long."""
USUAL = Usual("assemble", starts=STARTS, time_limit=SHORT, rng=0, threads=None)
"""Of a single set of known values that no other verb asks for."""
BATCH = Usual("assemble", starts=STARTS, time_limit=None, rng=0, threads=None)
CHUNK = 64
SERIAL_BELOW = 2048
ROUNDING = 1e-14
"""Residual, in radians and characteristic lengths, up to which a configuration of a closed form is
taken as it is."""
PIECE = 4096
CONFIRMED_BELOW = 20_000
"""Rows whose equations are evaluated at once, and rows from which on several threads do so."""
LONG = 512
"""Rows of a sequence from which on a closed form, where there is one, is tried before rows are
searched one by one."""
CONTINUED = Choice(
    "dyads", "closed form on the branch of the first row, which no row comes near to leaving", ()
)
"""Who answers for a sequence that `_continue_closed_form` follows."""
PLAIN_NUMBERS = {float, int, np.float64}
FLOAT = np.dtype(np.float64)
FEW = 300
"""Equations up to which the freedoms that are left are counted: it takes a dense decomposition."""


def _read_budget(budget: Budget | None) -> tuple[int, int, int | None, float | None]:
    """Return number of starts, seed, threads and time limit [s] of a budget, after checks."""
    spend = USUAL.complete_budget(budget)
    compute_deadline(spend.time_limit)
    return read_start_count(spend.starts), draw_seed(spend.rng), spend.threads, spend.time_limit


OUT_OF_TIME = int(Status.OUT_OF_TIME)
SPENT = _read_budget(None)
"""The same for calls without a budget, found once."""


class Assembler:
    """Assembly for fixed names of known coordinates and frames, reused for many values.

    Names are looked up and loops are packed once.

    Parameters
    ----------
    known
        Names of coordinates and frames, in the order of the values.
    one_sided
        Whether declared inequalities count.
    """

    def __init__(self, system: Model, known: Iterable[str] = (), one_sided: bool = True):
        self.system = system
        self.known = tuple(known)
        self.tree = remove_cut_marks(system)
        self.one_sided = (
            pack_one_sided_rows(system)
            if one_sided and pack_one_sided_rows(system).declared
            else None
        )
        self.names: AbstractSet[str] = set(self.known)
        coordinates = [
            k for k in self.known if k not in system.frame_names or k in system.coordinate_names
        ]
        self.frames = tuple(k for k in self.known if k not in coordinates)
        self._find_known_places(coordinates)
        self.explicit = find_explicit_joints(self.tree, self.sources)
        self.loops = self._pack_loops((False,) * len(self.frames))
        self.no_pins = np.zeros((1, 12 * len(self.frames)))
        self.quick = self.one_sided is None and self._is_quick(self.loops)

    def __repr__(self) -> str:
        return f"Assembler of {self.system.name!r} from {', '.join(self.known) or 'nothing known'}"

    def _find_known_places(self, names: list[str]) -> None:
        """Find the indices in q of the known coordinates; for a coupled one, those of its source.

        Sets `places`, `sources`, `held`, the `limits` (2, n), and these widened by rounding, `low`
        and `high`. Errors: `UnknownNameError`, `InputError`.
        """
        system = self.system
        couplings = system.structure.couplings
        index = {n: i for i, n in enumerate(system.coordinate_names)}
        for name in names:
            if name not in couplings and name not in index:
                allowed = (*system.coordinate_names, *couplings, *system.structure.frames)
                raise UnknownNameError("coordinate or frame", name, allowed, system.name)
        self.sources = list_sources(system, names)
        places = [index[name] for name in self.sources]
        self.coordinates = tuple(names)
        self.places = np.array(places, dtype=np.int64)
        self.shape = (system.nq,)
        self.named_places = tuple(zip(self.sources, places, strict=True))
        self.plain = couplings.keys().isdisjoint(names)
        layout = system.structure.layout
        velocity = dict(zip(layout.vector_q.tolist(), layout.vector_v.tolist(), strict=True))
        held = [velocity[i] for i in places if i in velocity]
        for iq, iv in zip(layout.quaternion_q.tolist(), layout.quaternion_v.tolist(), strict=True):
            given = set(range(iq, iq + 4)) & set(places)
            if given and len(given) < 4:
                missing = [system.coordinate_names[i] for i in range(iq, iq + 4) if i not in given]
                raise InputError(
                    f"a quaternion is given as a whole; missing are {', '.join(missing)}"
                )
            held += [iv, iv + 1, iv + 2] if given else []
        self.held = frozenset(system.structure.velocity_names[int(v)] for v in held)
        limits = np.full((2, len(places)), np.inf) * [[-1.0], [1.0]]
        for k, i in enumerate(places):
            if i in velocity:
                limits[:, k] = (
                    system.structure.coordinates.lower[velocity[i]],
                    system.structure.coordinates.upper[velocity[i]],
                )
        self.limits = limits
        slack = 1e-9 * (1.0 + np.abs(np.where(np.isfinite(limits), limits, 0.0)))
        self.low = limits[0] - slack[0]
        self.high = limits[1] + slack[1]
        self.bounds = list(zip(self.low.tolist(), self.high.tolist(), strict=True))
        self.limited = bool(np.isfinite(limits).any())

    def _pack_loops(self, turned: tuple[bool, ...], whole: bool = False) -> PackedLoops:
        """Return the packed loops with the known frames held at their positions.

        Frames with `turned` are held in orientation, too.

        `whole`: the coordinates of all joints are unknowns, also of those that the tree left out,
        so that what is nearest does not depend on where the loops are cut.
        """
        bounded = self.one_sided is not None
        explicit = frozenset(self.tree.structure.closures) if whole or bounded else self.explicit
        pins = tuple(zip(self.frames, turned, strict=True))
        return get_packed_loops(self.tree, explicit, self.held, pins, one_sided=bounded)

    @cached_property
    def freedoms(self) -> int:
        """Number of freedoms near home with the known coordinates held; -1 if not counted."""
        if self.frames or len(self.loops.names) > FEW:
            return -1
        home = find_home(self.system)[None]
        q, _, info = self.run(home, self.no_pins)
        if info[0, 0] != SOLVED:
            return -1
        return count_remaining_freedoms(self.system, q[0], self.held)

    def run(
        self,
        starts: Array,
        pins: Array,
        tries: int = STARTS,
        nearest: int = 0,
        rng: int = 0,
        threads: int | None = 1,
        limits: bool = True,
        tolerance: float = TOLERANCE,
        follow: bool = False,
        loops: PackedLoops | None = None,
        limit: float | None = None,
    ) -> tuple[Array, Array, np.ndarray]:
        """Close the loops from starts (N, nq).

        Returns configurations (N, nq), residuals (N,) and rows (status, steps, starts) (N, 3).

        Rows that the time `limit` [s] ended have the status `OUT_OF_TIME`, and what is nearest to
        closing by then. The clock is read after the first start of each row, of many equations
        before each step.
        """
        n = len(starts)
        few = False
        q = np.empty((n, self.system.nq))
        residual = np.empty(n)
        info = np.empty((n, 3), dtype=np.int64)
        if loops is None:
            loops = self.loops
            few = self.quick and n <= CHUNK and not (follow or nearest)
        weights = loops.weights if limits else remove_limits(self.system, loops)
        if few and not loop_closing.assemble_loops(
            loops.ints,
            loops.floats,
            loops.plan,
            weights,
            starts,
            pins,
            0,
            1,
            STEPS,
            tolerance,
            UNFINISHED if tries > 1 else 0,
            rng,
            0,
            False,
            0,
            q,
            residual,
            info,
        ):
            return q, residual, info
        by_parts = (
            tries > 1
            and len(loops.ties) >= LARGE
            and not (nearest or follow)
            and self.one_sided is None
        )

        def close_chunk(i: int, j: int, first: int, most: int, steps: int, stop: int) -> int:
            """Close the rows i to j by starts `first` to `most`."""
            before = info[i:j, 1].copy() if first else 0
            left = loop_closing.assemble_loops(
                loops.ints,
                loops.floats,
                loops.plan,
                weights,
                starts[i:j],
                pins[i:j] if len(pins) > 1 else pins,
                first,
                most,
                STEPS,
                tolerance,
                steps,
                rng,
                i,
                follow,
                stop,
                q[i:j],
                residual[i:j],
                info[i:j],
            )
            if first:
                info[i:j, 1] += before
            if stop and (error := get_clock().take_error()):
                raise error
            return left

        if follow:
            sound = np.isfinite(starts).all(axis=-1) & np.isfinite(pins).all(axis=-1)
            if not sound.all():  # the others follow as if these rows were not there
                q[:], residual[:], info[:] = np.nan, np.nan, (BAD_INPUT, 0, 0)
                inner = self.run(
                    starts[sound],
                    pins[sound] if len(pins) > 1 else pins,
                    tries,
                    nearest,
                    rng,
                    threads,
                    limits,
                    tolerance,
                    True,
                    loops,
                    limit,
                )
                q[sound], residual[sound], info[sound] = inner
                return q, residual, info
        if not few:
            q[:], residual[:], info[:] = starts, np.inf, 0
            info[:, 0] = OUT_OF_TIME
        time = TimeLimit(limit)
        stop = get_clock().address
        search: Any = None
        try:
            with time:
                if few:
                    for i in np.flatnonzero(info[:, 0] != SOLVED).tolist() if tries > 1 else ():
                        close_chunk(i, i + 1, 1, tries, 0, stop)
                elif self.one_sided is not None:
                    bounded = OneSidedAssembly(
                        self.system, loops, weights, STEPS, tolerance, rng, threads
                    )
                    (bounded.assemble_sequence if follow else bounded.assemble_batch)(
                        starts, pins, tries, q, residual, info
                    )
                elif n <= CHUNK or follow:
                    close_chunk(0, n, 0, 1 if by_parts else tries, nearest, stop)
                else:
                    sum_over_chunks(
                        lambda i, j: close_chunk(i, j, 0, 1 if by_parts else tries, nearest, stop),
                        n,
                        CHUNK,
                        threads,
                        SERIAL_BELOW,
                    )
                loops.raise_function_error()
                if by_parts:
                    search = LocalStarts(self.system, loops, weights, tolerance)
                    search.close_rows(starts, pins, tries, rng, q, residual, info)
        except TimeUp:
            if not time.spent:
                raise
            self._complete_late_rows(loops, weights, starts, pins, q, residual, info, by_parts)
        info[info[:, 0] == NOT_FOUND + LATE, 0] = OUT_OF_TIME
        return q, residual, info

    def _is_quick(self, loops: PackedLoops) -> bool:
        """Return whether one start takes less than about a millisecond.

        Then the clock is read after the first start only.
        """
        return len(loops.names) < MANY and len(loops.ties) < LARGE and not loops.functions

    def _complete_late_rows(
        self,
        loops: PackedLoops,
        weights: Array,
        starts: Array,
        pins: Array,
        q: Array,
        residual: Array,
        info: np.ndarray,
        by_parts: bool,
    ) -> None:
        """Complete status and residual of the rows that were not finished when the time ended."""
        for function in loops.functions:
            function.error = None  # it was the time that was up
        code = info[:, 0]
        cut = (code == BAD_INPUT) & np.isfinite(starts).all(axis=-1) & bool(loops.functions)
        q[cut] = starts[cut]
        residual[cut] = np.inf
        code[cut] = OUT_OF_TIME
        if by_parts:
            code[(code == NOT_FOUND) & (info[:, 2] <= 1)] = OUT_OF_TIME
        unknown = np.flatnonzero(~np.isfinite(residual) & np.isfinite(q).all(axis=-1))
        if self.one_sided is None and (len(unknown) <= 1 or not loops.functions):
            m = len(loops.names)
            packed = (loops.ints, loops.floats, loops.plan, weights)
            out = np.empty((len(unknown), m))
            none = np.empty((0, m, self.system.nv))
            own = pins[unknown] if len(pins) > 1 else pins
            closure_batch.evaluate_equations(*packed, own, q[unknown], False, out, none)
            residual[unknown] = np.linalg.norm(out, axis=-1)

    # ---- configurations of closed forms

    @cached_property
    def _limited_unknowns(self) -> tuple[np.ndarray, Array, Array]:
        """Indices in q of the unknown coordinates with limits, their lower and their upper limits."""
        layout = self.system.structure.layout
        low, high = view_velocity_lists(self.loops.weights, self.system.nv)[1:3, layout.vector_v]
        free = ~np.isin(layout.vector_q, self.places) & ((low > -LARGEST) | (high < LARGEST))
        return layout.vector_q[free], low[free], high[free]

    def _find_closed_rows(
        self, q: Array, residual: Array, limits: bool, threads: int | None
    ) -> np.ndarray:
        """Return a mask (N,) of the configurations (N, nq) that are closed and inside the limits.

        Writes their residuals (N,).
        """
        loops = self.loops
        none = np.empty((0, len(self.loops.names), self.system.nv))
        good = np.empty(len(q), dtype=bool)
        places, low, high = self._limited_unknowns

        def evaluate_chunk(first: int, last: int) -> int:
            """Evaluate residuals and limits of the rows from `first` to `last`."""
            for i in range(first, last, PIECE):
                x = q[i : min(i + PIECE, last)]
                rows = np.empty((len(x), len(loops.names)))
                there = slice(i, i + len(x))
                packed = loops.ints, loops.floats, loops.plan, loops.weights
                closure_batch.evaluate_equations(*packed, self.no_pins, x, False, rows, none)
                np.sqrt(np.einsum("ij,ij->i", rows, rows), out=residual[there])
                good[there] = residual[there] <= ROUNDING
                if not max(float(x.max()), -float(x.min())) < LARGEST:
                    good[there] = False
                if limits and len(places):
                    good[there] &= np.all((x[:, places] >= low) & (x[:, places] <= high), axis=1)
            return 0

        sum_over_chunks(evaluate_chunk, len(q), 2 * PIECE, threads, CONFIRMED_BELOW)
        loops.raise_function_error()
        return good

    def _confirm_closed_form(
        self, starts: Array, limits: bool, threads: int | None
    ) -> tuple[Assembly, np.ndarray, Array]:
        """Return the answer for configurations (..., nq) of a closed form.

        Also returns the rows that were searched, and their starts.

        Where a configuration fulfils the equations to `ROUNDING`, and the limits, it is the answer;
        from the others one search starts. The answer is written to `starts`, which must be
        contiguous.
        """
        lead = starts.shape[:-1]
        q = starts.reshape(-1, self.system.nq)
        residual = np.empty(len(q))
        info = np.empty((len(q), 3), dtype=np.int64)
        info[:] = SOLVED, 0, 1
        if self.one_sided is None and len(q):
            searched = np.flatnonzero(~self._find_closed_rows(q, residual, limits, threads))
        else:
            searched = np.arange(len(q))
        before = q[searched]
        if len(searched):
            q[searched], residual[searched], info[searched] = self.run(
                before, self.no_pins, 1, threads=threads, limits=limits
            )
        return self._make_answer(q, lead, q, residual, info, limits), searched, before

    @cached_property
    def _units(self) -> tuple[Array, np.ndarray]:
        """Units (nq,) of one radian or characteristic length, and indices of periodic angles."""
        layout = self.system.structure.layout
        unit = np.ones(self.system.nq)
        unit[layout.vector_q] = self.loops.scale[layout.vector_v]
        return unit, layout.vector_q[find_free_angles(self.system)[layout.vector_v]]

    def _continue_closed_form(
        self, starts: Array, tries: int, rng: int, limits: bool, tolerance: float
    ) -> tuple[Array, Array, np.ndarray] | None:
        """Continue a sequence of configurations by the closed form of dyads.

        Returns what `run` does with `follow`; None where the closed form does not decide how all
        rows continue.
        """
        from kempe.assemble.dyads import (  # only here: other calls do not need them
            Plan,
            find_closed_form,
        )

        if self.one_sided is not None or self.frames or not np.isfinite(starts).all():
            return None
        plan = find_closed_form(self.system, self.sources)
        if not isinstance(plan, Plan):
            return None
        first = self.run(
            starts[:1], self.no_pins, tries, rng=rng, limits=limits, tolerance=tolerance
        )
        if first[2][0, 0] != SOLVED:
            return None
        (unit, turns) = self._units
        n = len(starts)
        nq = self.system.nq
        q = np.empty((n, nq))
        residual = np.empty(n)
        info = np.empty((n, 3), dtype=np.int64)
        info[1:] = SOLVED, 0, 1
        q[:1], residual[:1], info[:1] = first
        for i in range(1, n, PIECE):
            j = min(i + PIECE, n)
            x = plan._continue_configuration(
                np.ascontiguousarray(starts[i:j, self.places]), q[i - 1], unit, turns
            )
            if x is None or not self._find_closed_rows(x, residual[i:j], limits, 1).all():
                return None
            q[i:j] = x
        return q, residual, info

    def _assemble_values(
        self,
        values: Any = (),
        start: Any = None,
        *,
        prefer: str | None = None,
        limits: bool = True,
        tolerance: float = TOLERANCE,
        budget: Budget | None = None,
    ) -> Assembly:
        """Assemble for `values` (..., k) of the known coordinates, in order or as a dict."""
        given: Any = values
        if prefer is None and limits is True and tolerance is TOLERANCE and budget is None:
            answer = self._answer_usual_call(values, start)
            if answer is not None:
                return answer
        named = values.__class__ is dict or isinstance(values, Mapping)
        given = given if named else self._name_values(values)
        return self._solve_problem(
            Problem(self.system, "one", given, start, prefer, limits, tolerance, budget)
        )

    __call__ = explain_errors(_assemble_values, fast=True)

    @quiet
    def _solve_problem(self, problem: Problem) -> Assembly:
        """Check the inputs of a problem with these known names, and solve it."""
        limits: Any
        given: Any
        _, _, given, start, prefer, limits, tolerance, budget, *_ = problem
        if self.frames:
            given = convert_places(given, self.frames)
        if given.keys() != self.names:
            said = ", ".join(map(repr, given)) or "nothing"
            raise InputError(f"values are given for {said}; needed are {self.known}")
        named = given
        if not self.plain:
            given = self._convert_to_sources(given)
        if not (isinstance(tolerance, (int, float)) and 0.0 < tolerance <= LOOSEST):
            raise InputError(
                f"tolerance is {tolerance!r}; it must be above 0 and at most {LOOSEST}"
            )
        if limits.__class__ is not bool:
            read_flag(limits, "limits")
        if prefer not in PREFER:
            raise InputError(
                f"prefer is {prefer!r}; it must be one of {', '.join(map(repr, PREFER))}"
            )
        tries, number, threads, limit = SPENT if budget is None else _read_budget(budget)
        base = self._read_single_start(given, start)
        lead = ()
        if base is None:
            base, lead = self._make_starts(given, start)
        if (lead or list_checks()) and (budget is None or budget.time_limit is None):
            limit = BATCH.complete_budget(budget).time_limit
        turned = self._find_oriented_frames(given) if self.frames else ()
        pins = self._read_pin_poses(given, turned, lead) if turned else self.no_pins
        steps = NEAREST_STEPS if prefer == "nearest" and self.freedoms != 0 else 0
        follow = prefer == "continuous" and len(base) > 1
        along = (
            self._continue_closed_form(base, tries, number, limits, tolerance)
            if follow and len(base) >= LONG
            else None
        )
        q, residual, info = along or self.run(
            base,
            pins,
            tries,
            steps,
            number,
            threads,
            limits,
            tolerance,
            follow,
            self._pack_loops(turned, steps > 0) if turned or steps else None,
            limit,
        )
        if not lead and int(info[0, 0]) == BAD_INPUT:
            self._refuse_values(named, start)
        answer = self._make_answer(base, lead, q, residual, info, limits)
        if lead or answer.code is Status.OUT_OF_TIME:
            answer.__dict__["limit"] = limit
        return record_choice(answer, CONTINUED) if along else answer

    def _convert_to_sources(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the known values with coupled coordinates replaced by their sources.

        Errors: `InputError` for values of coupled coordinates that contradict each other.
        """
        own = {name: given[name] for name in self.coordinates}
        return {**compute_source_values(self.system, own), **{f: given[f] for f in self.frames}}

    def _refuse_values(self, given: Mapping[str, Any], start: Any) -> None:
        """Raise an `InputError` that names the input with which nothing can be computed."""
        for name in self.coordinates:
            check_range(read_reals(given[name], ""), f"the known value of {name!r}")
        for frame, whole in zip(self.frames, self._find_oriented_frames(given), strict=True):
            place = read_place(self.system, frame, given[frame], whole)
            what = f"the place of frame {frame!r}"
            _ = check_poses(place, what) if whole else check_range(place, what)
        if start is not None:
            refuse_large_numbers(self.system, read_start(self.system, start), "start")
        raise InputError(NOT_FINITE)

    def _make_answer(
        self,
        base: Array,
        lead: tuple[int, ...],
        q: Array,
        residual: Array,
        info: np.ndarray,
        limits: bool,
    ) -> Assembly:
        """Make an `Assembly` from the results of the kernel, checking known values against limits."""
        if not lead:
            code, steps, starts = info.tolist()[0]
            if code == BAD_INPUT:
                refuse_large_numbers(self.system, base[0], "start")
                raise InputError(NOT_FINITE)
            # in Python: for a few numbers an array costs as much as the assembly
            if self.limited and limits:
                known = base[0, self.places].tolist()
                if any(
                    x < low or x > high for x, (low, high) in zip(known, self.bounds, strict=True)
                ):
                    code = Status.OUTSIDE_LIMITS
            return Assembly.from_fields(
                q=q[0],
                success=code == SOLVED,
                code=MEMBERS[code],
                residual=residual.item(),
                iterations=steps,
                starts=starts,
                assembler=self,
            )
        code = info[:, 0]
        if self.limited and limits:
            code = np.where(
                self._find_outside_limits(base) & (code != BAD_INPUT), Status.OUTSIDE_LIMITS, code
            )
        good, code, residual, steps, starts = (
            x.reshape(lead) for x in (code == SOLVED, code, residual, info[:, 1], info[:, 2])
        )
        return Assembly(q.reshape(*lead, self.system.nq), good, code, residual, steps, starts, self)

    @cached_property
    def _solvable_by_kernel(self) -> bool:
        """Whether one call of the kernel answers, for known coordinates as they are given."""
        loops = self.loops
        more = (
            self.frames or self.one_sided is not None or loops.functions or len(loops.ties) >= LARGE
        )
        return self.plain and not more

    def _answer_usual_call(self, given: Any, start: Any) -> Assembly | None:
        """Answer the usual call quickly: one start as an array and plain numbers by name.

        Returns None for other arguments.

        None leaves to `_solve_problem` what it is to be said of other arguments.
        """
        if (
            not self._solvable_by_kernel
            or given.__class__ is not dict
            or len(given) != len(self.known)
        ):
            return None
        base = self._read_single_start(given, start)
        if base is None:
            return None
        loops = self.loops
        number = SPENT[1]
        q = np.empty((1, self.shape[0]))
        residual = np.empty(1)
        info = np.empty((1, 3), np.int64)
        if loop_closing.assemble_loops(
            loops.ints,
            loops.floats,
            loops.plan,
            loops.weights,
            base,
            self.no_pins,
            0,
            1,
            STEPS,
            TOLERANCE,
            UNFINISHED,
            number,
            0,
            False,
            0,
            q,
            residual,
            info,
        ):
            q, residual, info = self.run(base, self.no_pins, limit=None if list_checks() else SHORT)
        if info[0, 0] == BAD_INPUT:
            return None
        answer = self._make_answer(base, (), q, residual, info, True)
        if answer.code is Status.OUT_OF_TIME:
            answer.__dict__["limit"] = SHORT
        return answer

    def _read_single_start(self, given: Mapping[str, Any], start: Any) -> Array | None:
        """Return the start (1, nq) of the usual call: an array and plain numbers by name.

        Returns None for other arguments.
        """
        if (
            start.__class__ is not np.ndarray
            or start.shape != self.shape
            or start.dtype is not FLOAT
        ):
            return None
        if self.frames or not self.plain:
            return None
        base = start[None].copy()
        row = base[0]
        for name, place in self.named_places:
            x = given.get(name)
            # a start is read whole
            if x.__class__ not in PLAIN_NUMBERS or not isfinite(row[place]):
                return None
            if x.__class__ is int and not is_real(x):
                return None
            row[place] = x
        return base

    def _name_values(self, values: Any) -> dict[str, Any]:
        """Return values (..., k) as a dict by the known names."""
        if self.frames:
            raise InputError("give the places of frames by name: a dict")
        array = read_reals(values, "values")
        if array.ndim == 1 and len(array) == len(self.known):
            return dict(zip(self.known, array.tolist(), strict=True))
        if array.ndim == 0 or array.shape[-1] != len(self.known):
            raise InputError(
                f"values have shape {array.shape}; needed are (..., {len(self.known)}): "
                f"{self.known}"
            )
        return {k: array[..., i] for i, k in enumerate(self.known)}

    def _make_starts(self, given: Mapping[str, Any], start: Any) -> tuple[Array, tuple[int, ...]]:
        """Return starts (N, nq) that contain the known values, and the leading shape of the answer."""
        system = self.system
        base = find_home(system) if start is None else read_start(system, start)
        columns = [
            read_reals(given[k], f"the known value of {k!r}", "a number, or an array")
            for k in self.sources
        ]
        shapes = [c.shape for c in columns] + [base.shape[:-1]]
        shapes += [
            np.shape(given[f])[: -2 if t else -1]
            for f, t in zip(self.frames, self._find_oriented_frames(given), strict=True)
        ]
        try:
            lead = np.broadcast_shapes(*shapes) if any(shapes) else ()
        except ValueError:
            raise InputError(
                f"known values and start have shapes that do not fit together: {shapes}"
            ) from None
        starts = np.empty((*lead, system.nq))
        starts[:] = base
        for k, column in enumerate(columns):
            at = starts[..., self.places[k]]
            # a start is read whole
            starts[..., self.places[k]] = np.where(np.isfinite(at), column, np.nan)
        return starts.reshape(math.prod(lead), system.nq), lead

    def _find_oriented_frames(self, given: Mapping[str, Any]) -> tuple[bool, ...]:
        """Return for each known frame whether its orientation is given beside its position."""
        size = self.system.dim
        out: list[bool] = []
        for frame in self.frames:
            shape = np.shape(given[frame])
            if len(shape) >= 2 and shape[-2:] == (4, 4):
                out.append(True)
            elif len(shape) >= 1 and shape[-1] in (size, 3):
                out.append(False)
            else:
                allowed = f"a position (..., {size}) or a pose (..., 4, 4)"
                raise InputError(
                    f"the place of frame {frame!r} has shape {shape}; it must be {allowed}"
                )
        return tuple(out)

    def _read_pin_poses(
        self, given: Mapping[str, Any], turned: tuple[bool, ...], lead: tuple[int, ...]
    ) -> Array:
        """Return the poses (N, 12 k) of the k known frames, three rows of each matrix."""
        n = math.prod(lead)
        pins = np.zeros((n, len(self.frames), 3, 4))
        pins[..., :3, :3] = np.eye(3)
        for k, (frame, whole) in enumerate(zip(self.frames, turned, strict=True)):
            place = read_place(self.system, frame, given[frame], whole)
            if whole:
                pins[:, k] = np.broadcast_to(place, (*lead, 4, 4)).reshape(n, 4, 4)[:, :3]
            else:
                size = place.shape[-1]
                pins[:, k, :size, 3] = np.broadcast_to(place, (*lead, size)).reshape(n, size)
        pins[..., 3] -= self.loops.origin
        return pins.reshape(n, 12 * len(self.frames))

    def _find_outside_limits(self, starts: Array) -> np.ndarray:
        """Return a mask (N,) of the starts whose known values are outside their limits."""
        x = starts[:, self.places]
        return np.any((x < self.low) | (x > self.high), axis=-1)


# ---- further starts for mechanisms of many loops


class LocalStarts:
    """Further starts of an assembly of many loops, each changed near an open loop.

    The more loops are far from closed, the more often some of them end in a local minimum of the
    residual, also from starts that are drawn as a whole. A loop that stays open affects its
    neighbours most. So coordinates near it are drawn anew, the others begin where they are, and the
    start is kept if it leaves less open (iterated local search: Lourenco, Martin and Stuetzle,
    2003).
    """

    def __init__(self, system: Model, loops: PackedLoops, weights: Array, tolerance: float):
        self.system = system
        self.loops = loops
        self.weights = weights
        self.tolerance = tolerance
        self.moved_by = loops.tie_coordinates
        self.users: dict[int, list[int]] = {}
        for k, coordinates in enumerate(self.moved_by):
            for v in coordinates:
                self.users.setdefault(v, []).append(k)
        self.of_row = np.repeat(
            np.arange(len(loops.ties)), [len(tie.row_names) for tie in loops.ties]
        )
        low, high = view_velocity_lists(loops.weights, system.nv)[3:5]
        self.range = high - low
        self.reached: tuple[Array, float, np.ndarray]

    def close_rows(
        self,
        starts: Array,
        pins: Array,
        tries: int,
        rng: int,
        q: Array,
        residual: Array,
        info: np.ndarray,
    ) -> None:
        """Search on for the rows that a first start left open.

        Reads and writes `q`, `residual` and `info`.
        """
        for i in np.flatnonzero(info[:, 0] == NOT_FOUND).tolist():
            self.reached = q[i], float(residual[i]), info[i]
            try:
                self.reached = self.close_row(
                    starts[i], q[i], pins[i] if len(pins) > 1 else pins[0], tries, rng, i, info[i]
                )
            finally:
                q[i], residual[i], info[i] = self.reached

    def close_row(
        self, start: Array, q: Array, pin: Array, tries: int, rng: int, row: int, before: np.ndarray
    ) -> tuple[Array, float, np.ndarray]:
        """Search on from the result `q` of a first start for one row.

        Returns configuration, residual and (status, steps, starts); `before` is that row after the
        first start.

        `row` is the number of the start `start` in its batch, by which random numbers are drawn.
        `reached` is the same of what was done by now.
        """
        random = np.random.default_rng([rng, row])
        _, steps, first = before.tolist()
        least = np.inf
        parts = STEPS // LOCAL_STEPS * max(1, tries - first - int(WHOLE * tries))
        for k in range(parts):
            check_for_stop()
            square = np.zeros(len(self.moved_by))
            np.add.at(square, self.of_row, self._evaluate_equations(q, pin) ** 2)
            least = min(least, math.sqrt(square.sum()))
            self.reached = (
                q,
                least,
                np.array([NOT_FOUND + LATE, steps, first + k * LOCAL_STEPS // STEPS]),
            )
            there = self._randomize_near_tie(
                q, int(random.choice(len(square), p=square / square.sum())), random
            )
            found, residual, info = self._call_kernel(there, pin, 1, LOCAL_STEPS, rng, row)
            steps += int(info[1])
            if residual < least:
                q = found
                least = residual
            if info[0] == SOLVED:
                return q, residual, np.array([SOLVED, steps, first + 1 + k * LOCAL_STEPS // STEPS])
        count = first + parts * LOCAL_STEPS // STEPS
        self.reached = q, least, np.array([NOT_FOUND + LATE, steps, count])
        found, residual, info = self._call_kernel(
            start, pin, 1 + max(0, tries - count), STEPS, rng, row
        )
        code = int(info[0])
        if residual > least:
            found = q
            residual = least
        return found, residual, np.array([code, steps + int(info[1]), count + int(info[2]) - 1])

    def _randomize_near_tie(self, q: Array, tie: int, random: np.random.Generator) -> Array:
        """Return the configuration with random values of the coordinates near a loop closure."""
        near = {tie}
        for _ in range(int(random.integers(1, HOPS + 1))):
            near = {k for n in near for v in self.moved_by[n] for k in self.users[v]} | near
        changed = sorted({v for k in near for v in self.moved_by[k]})
        velocity = np.zeros(self.system.nv)
        spread = random.uniform(0.2, 1.0)
        velocity[changed] = spread * self.range[changed] * random.uniform(-0.5, 0.5, len(changed))
        return self.system.structure.layout.integrate_velocity(q, velocity)

    def _evaluate_equations(self, q: Array, pin: Array) -> Array:
        """Evaluate the equations (m,) at q (nq,)."""
        loops = self.loops
        out = np.empty((1, len(self.loops.names)))
        columns = np.empty((0, out.shape[1], self.system.nv))
        packed = loops.ints, loops.floats, loops.plan, self.weights
        closure_batch.evaluate_equations(*packed, pin[None], q[None], False, out, columns)
        return out[0]

    def _call_kernel(
        self, start: Array, pin: Array, tries: int, steps: int, rng: int, row: int
    ) -> tuple[Array, float, np.ndarray]:
        """Call the kernel; return configuration, residual and (status, steps, starts)."""
        loops = self.loops
        q = np.empty((1, self.system.nq))
        residual = np.empty(1)
        info = np.empty((1, 3), dtype=np.int64)
        loop_closing.assemble_loops(
            loops.ints,
            loops.floats,
            loops.plan,
            self.weights,
            start[None].copy(),
            pin[None],
            0,
            tries,
            steps,
            self.tolerance,
            0,
            rng,
            row,
            False,
            get_clock().address,
            q,
            residual,
            info,
        )
        if error := get_clock().take_error():
            raise error
        loops.raise_function_error()
        return q[0], float(residual[0]), info[0]


# ---- how assemblers are made


def remove_limits(system: Model, loops: PackedLoops) -> Array:
    """Return the weights of packed loops with all limits removed."""
    weights = loops.weights.copy()
    view_velocity_lists(weights, system.nv)[1:3] = [[-np.inf], [np.inf]]
    return weights


def get_assembler_as_given(system: Model, known: Iterable[str] = ()) -> Assembler:
    """Return the `Assembler` of the mechanism as given, without tolerance of its dimensions."""
    return _make_assembler(system, tuple(known), True)


@keep_answers
def _make_assembler(system: Model, known: tuple[str, ...], one_sided: bool) -> Assembler:
    """Return the `Assembler` for known names, with or without one-sided constraints."""
    return Assembler(system, read_names(known, "known"), one_sided=one_sided)


def get_equation_assembler(system: Model, known: Iterable[str] = ()) -> Assembler:
    """Return the `Assembler` for known names that ignores declared one-sided constraints.

    Callers judge these afterwards.
    """
    return _make_assembler(
        system, read_names(known, "known"), not pack_one_sided_rows(system).declared
    )
