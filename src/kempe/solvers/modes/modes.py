"""All assembly modes: the configurations that close a mechanism for given inputs, and how surely
these are all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.budget import Budget, TimeUp, Usual
from kempe.calls import brief, explained, explained_methods, flag, generator, interruptible
from kempe.constraints.tape import TIME
from kempe.errors import InputError
from kempe.kinematics.common.result import Cells
from kempe.kinematics.configuration import as_start, home_of, refuse_far
from kempe.kinematics.one_sided import one_sided_rows
from kempe.model.clocked import known_time
from kempe.model.kept import kept
from kempe.model.tree.own_tree import own_tree
from kempe.reals import within_range
from kempe.solvers.assembly.assembler import of_equations
from kempe.solvers.assembly.assembly import assemble
from kempe.solvers.assembly.ideal import tolerant
from kempe.solvers.common.answer import Configurations
from kempe.solvers.common.arguments import start_count
from kempe.solvers.common.clock import (
    BROKEN_OFF,
    TIME_LIMIT,
    TimeLimit,
    partial,
    time_limited,
    time_of,
)
from kempe.solvers.common.problem import Choice, Problem, Solver, choose, chosen_by, takes_all
from kempe.solvers.dyads.branch_proofs import enclose
from kempe.solvers.dyads.dyads import (
    CLOSED,
    MOST_SIGNS,
    DyadAnswer,
    Incomplete,
    Plan,
    closed_form,
    source_values,
)
from kempe.solvers.dyads.held import held_at
from kempe.solvers.modes.same_configuration import INSIDE, SAME, Clusters, metric_of
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import counted, verb

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

STARTS = 4096
"""Starts of a search, at most."""
BESIDE = 128
"""Random starts beside a closed form that leaves branches undetermined, at most."""
USUAL = Usual("assembly_modes", starts=STARTS, rng=0, time_limit=TIME_LIMIT, progress=None)


@explained_methods
@dataclass(frozen=True, eq=False)
class Modes(Configurations):
    """Configurations `q` (k, nq) that close the mechanism for the `known` inputs, each once.

    `complete` says that there are no others, proven by structure: each branch of dyads either has a
    joint that stays open whatever rounding does, or closes in one place: its circles and lines
    cross, or meet within 1e-6 (radians, sizes of the mechanism). `branches` names them where the
    mechanism is made of dyads ('+-', see `Plan.describe`; 0 where two branches meet), else they are
    ''. `multiplicity` (k,) counts merged roots, or, in a search, how many starts found it: 0 where
    only a mirror image or a mixture of others led there, or least squares in a branch of dyads that
    the closed form leaves undetermined. `freedoms` (k,) says how many freedoms are left at each
    with the inputs held, idle spins left out: where it is not 0, the configuration is one example
    of infinitely many. `inside` (k,) says which respect the limits; `outside` counts what was
    dropped because it does not. Of a search, `coverage` is a lower bound, with 95 % confidence, of
    the share of random starts that lead to what was found (Good, Biometrika 40, 1953), which is
    never 1, and `expected` the estimated number of modes (Chao, Scand. J. Statist. 11, 1984); both
    are None where there is a proof. A search that was `interrupted` from the keyboard, or that the
    time limit ended (`late`), says so.
    """

    __repr__ = brief

    also = (
        "complete",
        "branches",
        "multiplicity",
        "freedoms",
        "inside",
        "outside",
        "coverage",
        "expected",
        "interrupted",
        "late",
    )

    q: Array
    complete: bool
    reason: str
    branches: tuple[str, ...]
    multiplicity: np.ndarray
    freedoms: np.ndarray
    inside: np.ndarray
    outside: int
    system: System = field(repr=False)
    known: dict[str, Any] = field(repr=False)
    coverage: float | None = None
    expected: float | None = None
    interrupted: bool = False
    late: bool = False
    left_out: int = 0
    """How many close the mechanism, but violate declared one-sided constraints."""

    @property
    def success(self) -> bool:
        """Whether there is any."""
        return len(self.q) > 0

    @property
    def code(self) -> Status:
        """The outcome: that there is none is proven where the search is `complete`."""
        if self.success:
            return Status.SOLVED
        if self.complete:
            return Status.OUTSIDE_LIMITS if self.outside else Status.NONE_EXISTS
        return self._broken_off() or Status.NOT_FOUND

    @property
    def titles(self) -> tuple[str, ...]:
        """Names of the configurations in pictures: of their branches, else numbers."""
        return tuple(name or str(k) for k, name in enumerate(self.branches, 1))

    def _goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return held_at(self.system, self.known)

    def _cells(self) -> Cells:
        """What is shown: the coordinates that are not known."""
        names = [n for n in self.system.coordinate_names if n not in self.known]
        at = [self.system.coordinate_names.index(n) for n in names]
        rows = [
            [self.branches[k] or str(k + 1), *(f"{x:.9g}" for x in q[at])]
            for k, q in enumerate(self.q)
        ]
        return ["", *names], rows

    def _lines(self) -> Sequence[str]:
        heads, rows = self._cells()
        names = heads[1:]
        return [
            f"{k:>3s}  " + ", ".join(f"{n} = {x}" for n, x in zip(names, row, strict=True))
            for k, *row in rows
        ]

    def _headline(self) -> str:
        return f"{counted(len(self), 'configuration')} of {self.system.name}; {self.status}"


def _not_begun(
    time: TimeLimit,
    system: System,
    known: Mapping[str, Any] | None = None,
    start: Any = None,
    *,
    limits: bool = True,
    **_: Any,
) -> Modes:
    """The answer where the time was up before any mode was looked for."""
    none = np.zeros(0, dtype=np.int64)
    said = f"none is known: {time.reason(TimeUp())} came first"
    problem = Problem(system, "all", dict(known or {}), None, limits=bool(limits))
    return replace(
        _answer(problem, np.empty((0, system.nq)), said, [], none, none, False), late=True
    )


@explained
@interruptible
@time_limited(USUAL, _not_begun)
@tolerant()
def assembly_modes(
    system: System,
    known: Mapping[str, Any] | None = None,
    start: Any = None,
    *,
    limits: bool = True,
    frame: FrameLike | None = None,
    tolerance: float | str | None = None,
    budget: Budget | None = None,
) -> Modes:
    """All configurations found that close the mechanism with the `known` coordinates (or frames)
    held.

    The time of equations in time is known as "t", one number (default 0).
    Planar mechanisms made of dyads are solved in closed form: then `complete` is True, but where a
    branch is left undetermined, by centres that coincide, links without length, parallel slides,
    roots that merge before others, or whole turns that move what is geared to them; the status
    names the dyad, and least squares look for what closes there. Others are assembled from random
    starts, and from mirror images and mixtures of what is found, with a bound of how much was
    missed; starts go on while the number found is odd where it must be even. `start` (nq,) sorts
    the answer, the nearest first, and chooses the representatives of angles (else they are near
    zero). With `limits` what is outside the joint limits is dropped, else it is flagged by
    `inside`, and random starts are drawn over whole turns. With `frame`, configurations that put
    this frame at one pose count as one: legs that can be turned over would multiply the modes of a
    platform. Without it, those that differ only by idle spins (see `mobility`) are one. Of the
    `budget` are read: starts (4096, at most), rng (0), time_limit (120 s), progress(starts, modes),
    called after each round of starts; the time limit leaves what was found by then, Ctrl-C as the
    `answer` of an `Interrupted`. Errors: `UnknownNameError`, `InputError` for values that are not
    single numbers.
    """
    given: Mapping[str, Any] = {} if known is None else known
    if not isinstance(given, Mapping):
        raise InputError(
            f"known is {type(given).__name__}; it must be a dict of values by coordinate or frame "
            "name"
        )
    if TIME in given:
        system, given = known_time(system, given)
    base = None if start is None else as_start(system, start)
    if base is not None and refuse_far(system, base, "start").ndim != 1:
        raise InputError(
            f"start has shape {base.shape}; it must be one configuration ({system.nq},)"
        )
    spend = USUAL.of(budget)
    generator(spend.rng)
    start_count(spend.starts)
    flag(limits, "limits")
    name = None if frame is None else system.structure.frame_name(frame)
    problem = Problem(
        system, "all", dict(given), base, limits=bool(limits), budget=budget, frame=name
    )
    solver, choice = chosen(system, tuple(given))
    return chosen_by(solver.run(problem), choice)


@kept
def chosen(system: System, known: tuple[str, ...]) -> tuple[Solver, Choice]:
    """Who answers with these names known."""
    return choose(SOLVERS, system, known)


# ---- by structure


def no_dyads(system: System, known: tuple[str, ...]) -> str | None:
    """Why there is no closed form with these names known; None where there is one."""
    if system.dim != 2:
        return "it is for planar mechanisms"
    frames = [k for k in known if k in system.frame_names and k not in system.coordinate_names]
    if frames:
        return f"the place of frame {frames[0]!r} is known, not only coordinates"
    plan = closed_form(system, tuple(source_values(system, dict.fromkeys(known, 0.0))))
    if isinstance(plan, Incomplete):
        return plan.reason
    return f"it has 2^{plan.signs} branches, too many to list" if plan.signs > MOST_SIGNS else None


def by_dyads(question: Problem) -> Modes:
    """The answer in closed form, of a mechanism that is made of dyads."""
    system = question.system
    values = source_values(system, question.known)
    for name, x in values.items():
        if x.ndim:
            raise InputError(
                f"the known value of {name!r} has shape {x.shape}; it must be one number"
            )
        within_range(x, f"the known value of {name!r}")
    plan: Any = closed_form(system, tuple(values))
    signs = plan.branches()
    numbers = np.array([[float(x) for x in values.values()]] * len(signs)).reshape(
        len(signs), len(values)
    )
    closed = plan.close(numbers, signs, question.start)
    names = ["".join("+" if s > 0 else "-" for s in row) for row in signs]
    ok = np.flatnonzero(closed.ok)
    clusters = Clusters(system, () if question.frame is None else (question.frame,))
    clusters.add(closed.q[ok], np.full(len(ok), SAME))
    groups = [ok[members] for members in clusters.members]
    q = closed.q[[g[0] for g in groups]]
    free = np.zeros(len(groups), dtype=np.int64)
    branches = [_merged([names[i] for i in g]) for g in groups]
    sizes = np.array([len(g) for g in groups], dtype=np.int64)
    doubt = _looked_into(question, plan, numbers[0], closed, clusters)
    if doubt.found:
        shown = [*range(len(groups)), *doubt.found]
        q = np.concatenate([q, clusters.q[list(doubt.found)]])
        free = doubt.free[shown]
        branches += [
            "".join("+" if s > 0 else "-" for s in row) for row in plan.branch_of(q[len(groups) :])
        ]
        sizes = np.concatenate([sizes, np.zeros(len(doubt.found), dtype=np.int64)])
    elif len(doubt.free):
        free = doubt.free[: len(groups)]
    all_ = counted(len(signs), "branch")
    do = verb(len(ok), "closes", "close")
    new = len(doubt.found)
    status = f"complete: every dyad in closed form, {len(ok)} of {all_} {do}"
    if not len(q):
        status = (
            f"complete: none of the {all_} closes; the best is open by {closed.gap.min():.3g} m"
        )
    if len(doubt.rows):
        them = (
            f"{counted(len(doubt.rows), 'branch')} {verb(len(doubt.rows), 'is', 'are')} "
            f"undetermined: {doubt.why}"
        )
        status = f"not proven complete: {len(ok)} of {all_} {do}, and {them}"
        if free.any():
            moving = f"{int((free > 0).sum())} of {counted(len(q), 'configuration')}"
            status = f"not finite: {moving} can move with these inputs held; {them}"
        elif not len(q):
            status = f"none found, which proves nothing: {them}"
    if new:
        status += f"; {counted(new, 'configuration')} found by least squares"
    if any(len(g) > 1 for g in groups):
        status += f", {counted(sum(len(g) > 1 for g in groups), 'multiple root')}"
    return _answer(question, q, status, branches, sizes, free, not len(doubt.rows))


class _Doubt(NamedTuple):
    """The branches `rows` that discs leave undetermined, and `why`; what least squares `found`
    there, and the freedoms `free` of all clusters (empty where nothing was looked for).
    """

    rows: np.ndarray
    why: str = ""
    found: tuple[int, ...] = ()
    free: np.ndarray = np.zeros(0, dtype=np.int64)


def _looked_into(
    question: Problem, plan: Plan, values: Array, closed: DyadAnswer, clusters: Clusters
) -> _Doubt:
    """Which branches are not proven to close nowhere, or in one place; further configurations go
    into the clusters.

    A branch that did not close as it was computed may do so elsewhere in its discs: least squares
    start where it nearly closed and, where a branch is undetermined, at random.
    """
    system = question.system
    size = plan.tolerance / CLOSED
    proof = enclose(plan, values, bool(question.limits), size)
    layout = system.structure.layout
    turning = np.zeros(system.nq, dtype=bool)
    turning[layout.vector_q] = system.structure.coordinates.turning[layout.vector_v]
    within = SAME * np.where(turning, 1.0, size)
    ok = np.asarray(closed.ok)[proof.branch]
    wide = proof.undetermined(within, ok)
    if not len(ok) or (ok & ~wide).all():
        return _Doubt(np.zeros(0, dtype=np.int64))
    from kempe.solvers.modes.modes_search import (
        ModesSearch,
        random_starts,
    )  # its kernels are not needed before

    tree = own_tree(system)
    before = len(clusters.members)
    spend = USUAL.of(question.budget)
    bound = of_equations(tree, question.known)
    s = ModesSearch(
        tree,
        dict(question.known),
        question.start,
        generator(spend.rng),
        bound,
        clusters,
        question.frame,
        limits=bool(question.limits),
    )
    s.take(closed.q[proof.branch[~ok]], False)
    left = [
        k
        for k in np.flatnonzero(wide | ~ok).tolist()
        if wide[k] or not proof.contain(k, clusters.q, turning, within).any()
    ]
    continuum = bool(left) and proof.may_move(left)
    if continuum:
        s.take(random_starts(s, min(BESIDE, start_count(spend.starts))), False)
    else:  # near roots that merge, least squares stop at what only seems to move
        s.free = np.zeros(len(clusters.q), dtype=np.int64)
    new = np.arange(before, len(s.free))
    found = new[s.free[new] == 0].tolist()
    moving = new[s.free[new] > 0]
    if len(moving) and not s.free[:before].any():
        found.append(int(moving[_example(question, clusters, moving)]))
    return _Doubt(proof.branch[left], proof.reason(left), tuple(found), s.free)


def _merged(names: list[str]) -> str:
    """The name of branches that meet: their common signs, 0 for the others."""
    return "".join(c[0] if len(set(c)) == 1 else "0" for c in zip(*names, strict=True))


# ---- by many starts


def by_starts(question: Problem) -> Modes:
    """The answer of many starts: never proven complete."""
    from kempe.solvers.modes.modes_search import (
        estimates,
        search,
    )  # its kernels are not needed before

    system = question.system
    spend = USUAL.of(question.budget)
    found = search(
        system,
        dict(question.known),
        question.start,
        question.frame,
        generator(spend.rng),
        start_count(spend.starts),
        time_of(USUAL, question.budget),
        spend.progress,
        bool(question.limits),
    )
    q = found.clusters.q
    hits = found.clusters.hits
    free = found.free
    isolated = np.flatnonzero(free == 0)
    families = np.flatnonzero(free > 0)
    coverage, expected = estimates(found.hits)
    expected *= len(isolated) / max(len(found.hits), 1)  # mirror images are counted together
    expected += found.odd
    closed = int(hits.sum())
    status = (
        f"not proven complete: {len(isolated)} found from {counted(found.tried, 'start')}, of "
        f"which {closed} closed; with 95 % confidence at most {_up(100.0 * (1.0 - coverage))} % of "
        "the starts that close lead to others"
    )
    if expected > len(isolated) + 0.5:
        status += f", about {expected:.3g} in all by estimate"
    if found.bounded:
        status += "; starts were drawn inside the limits only"
    if found.odd:
        status += "; one is missing at least, since their number is even"
    if not closed:
        why = assemble(system, question.known, start=question.start).status
        status = (
            f"none found, which proves nothing: of {counted(found.tried, 'start')} none closed; "
            f"{why}"
        )
    if len(families):
        besides = (
            f"besides {counted(len(isolated), 'isolated configuration')}, " if len(isolated) else ""
        )
        left = "1 freedom" if free.max() == 1 else f"up to {free.max()} freedoms"
        status = (
            f"not finite: {besides}there are some with {left} left, of which one is shown; give "
            "more inputs"
        )
        families = families[[_example(question, found.clusters, families)]]
    if found.spins:
        status += f"; {counted(len(found.spins), 'idle spin')} left out: " + ", ".join(
            map(str, found.spins[:3])
        )
        status += ", ..." if len(found.spins) > 3 else ""
    keep = np.concatenate([isolated, families])
    guess = (coverage, float(expected))
    interrupted, late = (isinstance(found.broken, kind) for kind in BROKEN_OFF)
    status += partial(interrupted, late)
    answer = _answer(
        question, q[keep], status, [""] * len(keep), hits[keep], free[keep], False, guess
    )
    return replace(answer, interrupted=interrupted, late=late)


def _example(question: Problem, clusters: Clusters, which: np.ndarray) -> int:
    """Of some clusters the place in the list of the one that is shown: inside the limits, if one
    is, and near home.
    """
    q = clusters.q[which]
    near = home_of(question.system) if question.start is None else question.start
    away = clusters.metric.distances(q, near)
    return int(np.argmin(np.where(_inside(question.system, q), away, away + 1e9)))


def _up(percent: float) -> str:
    """A percentage with two digits, rounded up."""
    if percent <= 0.0:
        return "0"
    unit = 10.0 ** (np.floor(np.log10(percent)) - 1)
    return f"{np.ceil(percent / unit - 1e-9) * unit:.3g}"


# ---- what both need


def _inside(system: System, q: Array) -> np.ndarray:
    """Which configurations (n, nq) are inside the limits (n,)."""
    v = q[:, system.structure.layout.vector_q]
    low, high = (x[system.structure.layout.vector_v] for x in (system.lower, system.upper))
    return np.all((v >= low - INSIDE) & (v <= high + INSIDE), axis=-1)


def _answer(
    question: Problem,
    q: Array,
    status: str,
    branches: list[str],
    multiplicity: np.ndarray,
    freedoms: np.ndarray,
    complete: bool,
    guess: tuple[float | None, float | None] = (None, None),
) -> Modes:
    """The modes, sorted, with what is outside the limits dropped or flagged."""
    system = question.system
    inside = _inside(system, q)
    bounds = one_sided_rows(system)
    left_out = 0
    keep = np.flatnonzero(inside) if question.limits else np.arange(len(q))
    if bounds.declared:
        beyond = bounds.beyond(q, declared=True) > 0.0
        holds = np.logical_not(beyond.any(axis=1))
        inside = inside & holds
        left_out = int(np.sum(~holds))
        keep = keep[holds[keep]]
        status += bounds.left_out(beyond)
    if question.start is not None:
        keep = keep[np.argsort(metric_of(system).distances(q[keep], question.start), kind="stable")]
    outside = len(q) - int(inside.sum()) - left_out
    if outside:
        status += f"; {outside} {'are' if outside > 1 else 'is'} outside the limits"
    return Modes(
        q[keep],
        complete,
        status,
        tuple(branches[i] for i in keep),
        multiplicity[keep],
        freedoms[keep],
        inside[keep],
        outside if question.limits else 0,
        system,
        dict(question.known),
        *guess,
        left_out=left_out,
    )


SOLVERS = (
    Solver("dyads", "closed form, one dyad after the other", no_dyads, by_dyads),
    Solver(
        "many starts",
        "assembly from random starts, from mirror images and mixtures of what is found",
        takes_all,
        by_starts,
    ),
)
"""Who answers for all assembly modes."""
