"""Plans of analytical inverse kinematics: which joints are unknown, and how they are solved.

Lines complete the unknown joints to six. Which joints a redundant chain holds is chosen here, too.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.answers.targets import TASKS
from kempe.budget import check_for_stop
from kempe.errors import UnsupportedError
from kempe.inverse.closed_forms.chain_lines import (
    Lines,
    compute_jacobians,
    compute_line_placements,
    compute_motion,
    find_chain_lines,
)
from kempe.inverse.closed_forms.structure import Axes, Strategy, find_strategies, join_axes
from kempe.kernels import compiled
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.closed_form.analytic_layout import X_FIRST, Z_FIRST
from kempe.kernels.compiled import candidates
from kempe.kernels.forward.table_layout import SLIDE, TURN
from kempe.model.model import keep_answers
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


TRIALS = 24
"""Random configurations that a plan must find again before it is used."""

ELIMINATIONS = 3
MOST_FORMS = 5
"""Completions to six lines that are tried by elimination, and formulations that are kept."""

EIGHT = 8
"""Rows of an answer where targets are solved side by side."""

AGAIN = 1e-6
"""How near is found again."""


# ---- how a plan can be carried out


def _load_closed_kernel() -> Callable[..., None]:
    """Load the kernel that solves closed forms one target after the other."""
    import kempe.kernels.compiled as kernels

    return kernels.every_solution.find_closed_form_solutions


def _load_block_kernel() -> Callable[..., int]:
    """Load the kernel that solves closed forms of several targets side by side."""
    import kempe.kernels.compiled as kernels

    return kernels.candidate_blocks.find_plain_solutions


def _load_elimination_kernel() -> Callable[..., None]:
    """Load the kernel that solves by elimination."""
    import kempe.kernels.compiled as kernels

    return kernels.elimination_ik.find_general_solutions


class Method(NamedTuple):
    """A method to solve the lines of a chain: a row in the table of solvers of `ik_all`.

    `name` and `how` are those of the row, `unfit` says why it is not for a chain, `word` is its
    short name. Its answers have `slots` rows; `piece` is how many targets it solves between two
    looks at the clock. `kernel` gives the function that solves one target after the other, None for
    a search, and `blocks` the one that solves several side by side, if there is one.
    """

    name: str
    how: str
    unfit: str
    word: str
    slots: int = A.SLOTS
    piece: int = 512
    kernel: Callable[[], Callable[..., None]] | None = None
    blocks: Callable[[], Callable[..., int]] | None = None


SIDE_BY_SIDE = Method(
    "closed form, side by side",
    "subproblems of six turns, many targets at once; what is close is done again",
    "it is for six joints that turn, of which one equation in one unknown is left",
    "closed form",
    slots=EIGHT,
    piece=2**62,
    kernel=_load_closed_kernel,
    blocks=_load_block_kernel,
)
CLOSED_FORM = Method(
    "closed form",
    "subproblems of the lines of the chain, and of lines that stand in for what the task leaves",
    "no three neighbouring axes of the chain meet or are parallel, or as it takes",
    "closed form",
    kernel=_load_closed_kernel,
)
ELIMINATION = Method(
    "elimination",
    "sixteen roots of six lines in general",
    "its lines are not general enough to find random configurations again",
    "elimination",
    piece=64,
    kernel=_load_elimination_kernel,
)
SEARCH = Method("search", "many starts: what is found, with no claim that it is all", "", "search")
METHODS = (SIDE_BY_SIDE, CLOSED_FORM, ELIMINATION, SEARCH)
"""The methods, the best first."""


@dataclass(frozen=True, eq=False)
class Extra(Axes):
    """Auxiliary lines that complete a chain to six joints; their roles say whether they move."""

    roles: np.ndarray


@dataclass(frozen=True, eq=False)
class ChainPlan:
    """The plan of a chain's inverse kinematics, packed for the kernels.

    `method` says how it is carried out; `locked` are the joints held at values: those
    `fixed` by whoever asks, and others where the chain has more than the task needs, which are at
    `first` (n,) where nobody says where. `extra` are the lines that complete the rest to six.
    `blurred`: lengths leave so few digits that roots may be lost.
    """

    lines: Lines
    task: str
    locked: tuple[int, ...]
    method: Method
    way: Strategy | None
    extra: Extra = field(repr=False)
    ints: np.ndarray = field(repr=False)
    floats: np.ndarray = field(repr=False)
    fixed: tuple[int, ...] = ()
    planar: bool = False
    first: tuple[float, ...] = ()
    blurred: bool = False

    @property
    def spare_joints(self) -> list[int]:
        """Joints that are locked only because the chain has more joints than the task needs."""
        return [i for i in self.locked if i not in self.fixed]

    @property
    def has_resting_lines(self) -> bool:
        """Whether auxiliary lines at rest stand for missing joints: fewer joints than equations."""
        return bool(np.any(self.extra.roles == A.REST)) and not self.planar

    @cached_property
    def alternative_plan(self) -> ChainPlan | None:
        """Another plan for the same task, with other auxiliary lines; None where there is none."""
        found = make_plan(self.lines, self.task, self.locked, self.planar, self.extra)
        return None if found.method == SEARCH else found

    def fill_solutions(self, *given: Any) -> None:
        """Write the solutions of targets into arrays, one target after the other.

        Given are targets (N, 4, 4), coordinates near which angles are given and those of locked
        joints (1 or N, n), tolerances of positions and angles, whether the target is a single one,
        the indices of the targets to solve, and the rows (N, K, n + 2) and counts (N, 2) to write.
        """
        assert self.method.kernel is not None
        self.method.kernel()(self.ints, self.floats, *given)

    @cached_property
    def has_system_coordinates(self) -> bool:
        """Whether the chain's coordinates are the system's, in the same order."""
        return bool(np.array_equal(self.lines.q_index, np.arange(len(self.lines))))


def compute_targets(lines: Lines, extra: Extra, q: Array) -> Array:
    """Compute targets (m, 4, 4) in the ground frame, in metres, reached at coordinates q (m, n).

    Motions that the task leaves free are random.
    """
    T = compute_line_placements(lines, lines.compute_theta(q))[0] @ sample_free_motions(
        lines, extra, len(q)
    )
    T[:, :3, 3] = T[:, :3, 3] * lines.length + lines.origin
    return T


def sample_free_motions(lines: Lines, extra: Extra, count: int) -> Array:
    """Sample random motions (count, 4, 4) of the tip that the task leaves free.

    A target says nothing of what its task does not ask: its rotation or position there is any, not
    that of the chain.
    """
    rng = np.random.default_rng(13)
    M = lines.tip
    out = np.tile(np.eye(4), (count, 1, 1))
    for kind, h, o, role in zip(extra.kinds, extra.h, extra.o, extra.roles, strict=True):
        if role == A.FREE:
            ways = rng.uniform(-1.0, 1.0, count) * (1.0 if kind == SLIDE else np.pi)
            out = out @ np.array([compute_motion(int(kind), h, o, float(way)) for way in ways])
    return spatial.inverse(M) @ out @ M


# ---- lines that complete a chain to six joints


def make_free_lines(lines: Lines, task: str, planar: bool) -> Extra:
    """Make auxiliary lines at the tip for the motions that the task leaves free."""
    R = lines.tip[:3, :3]
    p = lines.tip[:3, 3]
    turns = {"position": (0, 1, 2), "direction": (2,), "position_axis": (2,)}.get(task, ())
    slides = (0, 1, 2) if task in ("orientation", "direction") else ()
    if planar:
        R = np.eye(3)
        turns, slides = ((2,), ()) if task == "position" else ((), slides[:2])
    kinds = [TURN] * len(turns) + [SLIDE] * len(slides)
    h = [R[:, i] for i in (*turns, *slides)]
    k = len(kinds)
    return Extra(
        np.array(kinds, dtype=np.int64),
        np.array(h).reshape(k, 3),
        np.tile(p, (k, 1)),
        np.full(k, A.FREE),
    )


def compute_extra_screws(extra: Axes, tip: Array) -> Array:
    """Compute the constant screws (6, k) of auxiliary lines in the tip's frame."""
    R = tip[:3, :3].T
    p = tip[:3, 3]
    J = np.zeros((6, len(extra)))
    for i, kind in enumerate(extra.kinds):
        if kind == SLIDE:
            J[:3, i] = R @ extra.h[i]
        else:
            J[:3, i] = R @ np.cross(extra.h[i], p - extra.o[i])
            J[3:, i] = R @ extra.h[i]
    return J


def sample_variables(lines: Lines, rng: np.random.Generator, count: int) -> Array:
    """Sample random variables (count, n): any angle, slides of the size of the chain."""
    shape = (count, len(lines))
    return np.where(
        lines.kinds == SLIDE, rng.uniform(-1.0, 1.0, shape), rng.uniform(-np.pi, np.pi, shape)
    )


def iterate_resting_lines(
    lines: Lines, free: Extra, unknown: list[int], planar: bool
) -> Iterator[Extra]:
    """Iterate over sets of lines at rest that complete a chain to six, best conditioned first."""
    count = 6 - len(unknown) - len(free)
    if count == 0:
        yield Extra(
            np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int64)
        )
        return
    candidate_lines = _collect_candidate_lines(lines, unknown, planar)
    rng = np.random.default_rng(5)
    samples = compute_jacobians(lines, sample_variables(lines, rng, 5))[:, :, unknown]
    at_tip = compute_extra_screws(free, lines.tip)
    pool = compute_extra_screws(candidate_lines, lines.tip)
    choices = list(itertools.combinations(range(len(candidate_lines)), count))
    J = np.zeros((len(choices), len(samples), 6, 6))
    J[..., : len(unknown)] = samples
    J[..., len(unknown) : 6 - count] = at_tip
    J[..., 6 - count :] = np.moveaxis(pool[:, np.array(choices)], 0, 1)[:, None]
    least = np.median(Spectrum(J).smallest, axis=1)
    scored = list(zip(least.tolist(), choices, strict=True))
    best = max(s for s, _ in scored)
    good = [(s, c) for s, c in scored if s > 0.05 * best]
    for _, choice in sorted(good, key=lambda pair: (sum(pair[1]), -pair[0])):
        yield _give_roles(candidate_lines.select_lines(choice), np.full(count, A.REST))


def _give_roles(axes: Axes, roles: np.ndarray) -> Extra:
    """Return lines as auxiliary lines with these roles."""
    return Extra(axes.kinds, axes.h, axes.o, roles)


def _collect_candidate_lines(lines: Lines, unknown: list[int], planar: bool) -> Axes:
    """Collect candidates for auxiliary lines: turns through two points, and slides."""
    if planar:
        R = np.eye(3)
        at = np.zeros((6, 3))
        at[3] = 0.4, 0.7, 0.0
        return Axes(np.array([SLIDE, TURN, TURN, TURN, SLIDE, SLIDE]), R[[2, 0, 1, 2, 0, 1]], at)
    turning = [i for i in unknown if lines.kinds[i] != SLIDE]
    last = turning[-1] if turning else unknown[-1]
    h = lines.h[last]
    u = np.cross(h, [0.36, 0.48, 0.8] if abs(h @ [0.36, 0.48, 0.8]) < 0.9 else [0.8, -0.6, 0.0])
    u /= np.linalg.norm(u)
    w = np.cross(h, u)
    on = lines.o[last] + 0.4 * h
    off = lines.o[last] + 0.3 * h + 0.5 * u + 0.35 * w
    kinds = np.array([TURN, TURN, SLIDE, SLIDE, SLIDE, TURN, TURN, TURN])
    return Axes(
        kinds, np.array([u, w, h, u, w, h, u, w]), np.array([on, on, on, on, on, off, off, off])
    )


def count_chain_freedoms(lines: Lines, free: Extra, unknown: list[int]) -> int:
    """Count the freedoms of the unknown joints and the free lines: the rank of their Jacobian.

    At random configurations.
    """
    if not unknown:
        return len(free)
    if lines.even is not None:
        lines, free = (
            lines.even,
            replace(free, o=np.tile(lines.even.tip[:3, 3], (len(free), 1))),
        )
    T, h, o = compute_line_placements(lines, sample_variables(lines, np.random.default_rng(7), 4))
    X = T @ spatial.inverse(lines.tip)
    turns = np.concatenate([lines.kinds[unknown], free.kinds]) != SLIDE
    h = np.concatenate([h[:, unknown], np.einsum("mij,kj->mki", X[:, :3, :3], free.h)], axis=1)
    moved = np.einsum("mij,kj->mki", X[:, :3, :3], free.o) + X[:, None, :3, 3]
    o = np.concatenate([o[:, unknown], moved], axis=1)
    J = np.concatenate(
        [np.where(turns[:, None], np.cross(o, h), h), np.where(turns[:, None], h, 0.0)], axis=2
    )
    J = J / np.linalg.norm(J, axis=2, keepdims=True)  # seen from the chain, whatever the tool
    return int(Spectrum(J).compute_ranks(Level.GENERIC).max())


def count_task_freedoms(plan: ChainPlan, held: Sequence[int]) -> tuple[int, int]:
    """Count the equations of the task, and its freedoms that joints give which are not `held`."""
    free = make_free_lines(plan.lines, plan.task, plan.planar)
    unknown = [i for i in range(len(plan.lines)) if i not in held]
    others = len(free)
    rank = count_chain_freedoms(plan.lines, free, unknown)
    return (3 if plan.planar else 6) - others, rank - others


# ---- how plans are made


def make_plan(
    lines: Lines, task: str, locked: tuple[int, ...], planar: bool, but: Extra | None = None
) -> ChainPlan:
    """Make the plan of a chain that is not redundant with the joints `locked`.

    but: lines that complete it in a plan that is known; then another one is made.
    """
    plan = find_closed_form_plan(lines, task, locked, planar, but)
    if plan is not None:
        return plan
    unknown = [i for i in range(len(lines)) if i not in locked]
    for extra in itertools.islice(
        _iterate_completions(lines, task, unknown, planar, but), ELIMINATIONS
    ):
        check_for_stop()
        plan = _make_elimination_plan(lines, task, unknown, locked, extra)
        if plan is not None:
            return plan
    return pack_plan(lines, task, locked, make_free_lines(lines, task, planar), None)


def find_closed_form_plan(
    lines: Lines, task: str, locked: tuple[int, ...], planar: bool, but: Extra | None = None
) -> ChainPlan | None:
    """Find the plan that solves the unlocked joints in closed form; None where there is none.

    See `make_plan`.
    """
    unknown = [i for i in range(len(lines)) if i not in locked]
    if not unknown:
        raise UnsupportedError(
            "no joint is left to move: all of the chain are held, or do nothing for this task"
        )
    for extra in _iterate_completions(lines, task, unknown, planar, but):
        check_for_stop()
        for way in _find_common_strategies(lines, unknown, locked, extra):
            plan = pack_plan(lines, task, locked, extra, way)
            if (off := _estimate_error(plan)) < max(AGAIN, lines.span.blur):
                return replace(plan, blurred=off >= AGAIN)
    return None


def _iterate_completions(
    lines: Lines, task: str, unknown: list[int], planar: bool, but: Extra | None
) -> Iterator[Extra]:
    """Iterate over auxiliary lines that complete the unknown joints to six."""
    free = make_free_lines(lines, task, planar)
    for rest in iterate_resting_lines(lines, free, unknown, planar):
        extra = _give_roles(join_axes(free, rest), np.concatenate([free.roles, rest.roles]))
        if but is None or not (np.array_equal(extra.h, but.h) and np.array_equal(extra.o, but.o)):
            yield extra


def _make_elimination_plan(
    lines: Lines, task: str, unknown: list[int], locked: tuple[int, ...], extra: Extra
) -> ChainPlan | None:
    """Make the plan that solves six general lines by elimination; None where that fails."""
    from kempe.kernels.closed_form.analytic_layout import FORMULATIONS

    theta = sample_variables(lines, np.random.default_rng(11), 1)[0]
    places = [*unknown, *range(len(lines), len(lines) + len(extra))]
    axes, _ = compute_carried_lines(lines, locked, extra, theta)
    scores = np.zeros(FORMULATIONS)
    compiled.elimination_score.score_formulations(
        axes.kinds[places].astype(np.int64), axes.pack_lines().reshape(-1, 8)[places], scores
    )
    best = [int(f) for f in np.argsort(-scores, kind="stable") if scores[f] > 0.0][:MOST_FORMS]
    if not best:
        return None
    plan = pack_plan(lines, task, locked, extra, None, (tuple(places), best))
    return plan if _estimate_error(plan) < AGAIN else None


# ---- kernels, and arrays packed for them


def _find_common_strategies(
    lines: Lines, unknown: list[int], locked: tuple[int, ...], extra: Extra
) -> list[Strategy]:
    """Find closed forms of six lines that are common to two positions of the locked joints."""
    rng = np.random.default_rng(11)
    variants = list[Axes]()
    goals = list[list[Array]]()
    places = [*unknown, *range(len(lines), len(lines) + len(extra))]
    for _ in range(2 if locked else 1):
        theta = sample_variables(lines, rng, 4)
        theta[1:, list(locked)] = theta[0, list(locked)]
        axes, shift = compute_carried_lines(lines, locked, extra, theta[0])
        variants.append(axes.select_lines(places))
        T = compute_line_placements(lines, theta[1:])[0] @ sample_free_motions(
            lines, extra, len(theta) - 1
        )
        G = T @ spatial.inverse(lines.tip) @ spatial.inverse(shift)
        goals.append([np.ascontiguousarray(g[:3]).ravel() for g in G])
    at_rest = {
        i for i, j in enumerate(places) if j >= len(lines) and extra.roles[j - len(lines)] == A.REST
    }
    found = find_strategies(variants, goals, at_rest)
    return [Strategy(tuple(places[i] for i in w.order), *_extract_settings(w)) for w in found]


def _extract_settings(w: Strategy) -> tuple[int, int, int, int, int]:
    """Extract the settings of a strategy for the kernels."""
    return w.inner, w.what, w.mode, w.measure, w.option


def compute_carried_lines(
    lines: Lines, locked: tuple[int, ...], extra: Extra, theta: Array
) -> tuple[Axes, Array]:
    """Compute all lines as locked joints carry them, and the motion (4, 4) of all of these."""
    X = np.eye(4)
    axes = join_axes(lines, extra)
    h = axes.h
    o = axes.o
    for i in range(len(axes)):
        if i in locked:
            X = X @ compute_motion(axes.kinds[i], h[i], o[i], theta[i])
        else:
            h[i], o[i] = X[:3, :3] @ h[i], X[:3, :3] @ o[i] + X[:3, 3]
    return axes, X


def compute_outer_terms(plan: ChainPlan, theta: Array, X: Array) -> Array:
    """Compute constants and factors (2, 2, 3) of the outer joints x and z of a closed form.

    In both measures.

    X (4, 4) is a pose of the tip, scaled as the lines; locked joints are as in theta (n,). See
    `kempe.kernels.closed_form.arm_part`.
    """
    way = plan.way
    assert way is not None
    axes, shift = compute_carried_lines(plan.lines, plan.locked, plan.extra, theta)
    six = axes.select_lines(way.order)
    goal = X @ spatial.inverse(plan.lines.tip) @ spatial.inverse(shift)
    out = np.empty(12)
    flat = np.ascontiguousarray(goal[:3]).ravel()
    candidates.write_outer_terms(
        six.kinds, six.pack_lines(), flat, way.inner, way.what, way.option, out
    )
    return out.reshape(2, 2, 3)


def pack_plan(
    lines: Lines,
    task: str,
    locked: tuple[int, ...],
    extra: Extra,
    way: Strategy | None,
    forms: tuple[tuple[int, ...], list[int]] | None = None,
) -> ChainPlan:
    """Pack a plan and its arrays for the kernels.

    Layout: `kempe.kernels.closed_form.analytic_layout`; `forms` are orders and ways to eliminate.
    """
    n = len(lines)
    k = len(extra)
    axes = join_axes(lines, extra)
    ints = np.zeros(A.PLAN_HEADER + n + k + n, dtype=np.int64)
    ints[[A.N_LINES, A.N_JOINTS, A.N_LOCKED]] = n + k, n, len(locked)
    order = () if forms is None else forms[0]
    if way is not None:
        ints[[A.INNER, A.WHAT, A.MODE, A.MEASURE, A.OPTION]] = _extract_settings(way)
        order = way.order
    if forms is not None:
        ints[A.N_FORMS] = len(forms[1])
        ints[A.FORMS : A.FORMS + len(forms[1])] = forms[1]
    if order:
        ints[A.ORDER : A.ORDER + 6] = order
        ints[A.ROLES : A.ROLES + 6] = [A.JOINT if j < n else extra.roles[j - n] for j in order]
    ints[A.PLAN_HEADER : A.PLAN_HEADER + n + k] = axes.kinds
    ints[A.PLAN_HEADER + n + k :] = [int(i not in locked) for i in range(n)]
    head = np.concatenate([lines.tip[:3].ravel(), TASKS[task], [lines.length], lines.origin])
    joints = np.column_stack([lines.offset, lines.multiplier, *lines.limits]).ravel()
    floats = np.concatenate([head, axes.pack_lines(), joints])
    method = SEARCH if forms is None else ELIMINATION
    if way is not None:
        method = SIDE_BY_SIDE if _can_solve_in_blocks(lines, task, way) else CLOSED_FORM
    return ChainPlan(lines, task, locked, method, way, extra, ints, floats)


def _can_solve_in_blocks(lines: Lines, task: str, way: Strategy) -> bool:
    """Return whether kernels can solve several targets side by side with a strategy.

    They need six turning joints and an equation in one unknown.
    """
    if task != "pose" or way.mode not in (X_FIRST, Z_FIRST) or np.any(lines.kinds == SLIDE):
        return False
    if tuple(sorted(way.order)) != way.order or way.order[-1] >= len(lines):
        return False
    return (way.inner, way.option) not in ((1, 0), (2, 1))


def _estimate_error(plan: ChainPlan) -> float:
    """Estimate the error with which the plan finds random configurations again.

    An angle or length that four of five of them stay below.
    """
    lines = plan.lines
    rng = np.random.default_rng(3)
    theta = sample_variables(lines, rng, TRIALS)
    q = (theta - lines.offset) / lines.multiplier
    n = len(lines)
    floats = plan.floats.copy()  # limits do not matter here
    floats[-A.JOINT_FLOATS * n :].reshape(n, -1)[:, A.LOW :] = -np.inf, np.inf
    out = np.empty((TRIALS, plan.method.slots, n + A.INFO))
    numbers = np.arange(TRIALS)
    if plan.method.blocks is not None:
        kernel = plan.method.blocks()
        q[:, list(plan.locked)] = q[0, list(plan.locked)]
        kernel(plan.ints, floats, compute_targets(lines, plan.extra, q), q, q[:1], 0, out, numbers)
    else:
        counts = np.empty((TRIALS, 2), dtype=np.int64)
        replace(plan, floats=floats).fill_solutions(
            compute_targets(lines, plan.extra, q),
            q,
            q,
            1e-9,
            1e-9,
            0,
            numbers,
            out,
            counts,
        )
    off = np.where(
        out[..., n + A.CODE] >= 0.0, np.abs(out[..., :n] - q[:, None]).max(axis=-1), np.inf
    )
    return float(np.sort(off.min(axis=1))[int(0.8 * TRIALS)])


# ---- choice of the joints that a redundant chain holds

# Held are those without which the rest is solved best, and most often.

MOST_CHOICES = 60
ELIMINATED = 12
"""Choices of joints that are looked at for a closed form, and for an elimination where none has a
closed form."""

SAMPLES = 32
STEP = 0.1
"""Random poses that measure how often a choice has a solution, and the difference in that which
counts."""

TOLERANCE = 1e-9

ASIDE = 0.4
"""Angle, or length of the chain, from zero at which joints are held first where at zero axes of the
rest line up."""

NEARLY = 1e-3
"""Sine of an angle, or distance in lengths of the chain, below which an elimination has trouble
with two axes."""


def make_locked_plan(lines: Lines, task: str, fixed: tuple[int, ...], planar: bool) -> ChainPlan:
    """Make the plan of a redundant chain, with as many more joints locked as are redundant.

    Best is to hold slides that carry an arm of turns: a rail, a torso. Then what counts is how the
    rest is solved (side by side, in closed form, by elimination), and how many random poses have a
    solution inside the limits with the joints held where they are held first.
    """
    free = make_free_lines(lines, task, planar)
    unknown = [i for i in range(len(lines)) if i not in fixed]
    rank = count_chain_freedoms(lines, free, unknown)
    extra = len(unknown) + len(free) - rank
    if extra <= 0:
        return make_plan(lines, task, fixed, planar)
    best: tuple[tuple[float, ...], ChainPlan] | None = None
    choices = list(_iterate_lock_choices(lines, task, free, unknown, extra, rank))
    for carried, some in itertools.groupby(
        choices, lambda choice: _are_all_slides_held(lines, unknown, choice)
    ):
        group = [tuple(sorted((*fixed, *choice))) for choice in some]
        plans = [
            p
            for p in (find_closed_form_plan(lines, task, locked, planar) for locked in group)
            if p is not None
        ]
        plans = plans or [
            p
            for p in (make_plan(lines, task, x, planar) for x in group[:ELIMINATED])
            if p.method != SEARCH
        ]
        for k, bare in enumerate(plans):
            check_for_stop()
            plan = replace(bare, first=_choose_held_values(bare, fixed))
            key = (METHODS.index(plan.method), -round(_estimate_solved_share(plan) / STEP), k)
            if best is None or key < best[0]:
                best = key, plan
        if carried and best is not None:
            break
    if best is not None:
        return best[1]
    return make_plan(
        lines, task, tuple(sorted((*fixed, *choices[0]))) if choices else fixed, planar
    )


def _iterate_lock_choices(
    lines: Lines, task: str, free: Extra, unknown: list[int], extra: int, rank: int
) -> Iterator[tuple[int, ...]]:
    """Iterate over choices of locked joints that leave the chain all of its freedoms.

    Those that leave an arm of turns come first, the last joints first.

    Where the task asks for an orientation alone the first joints come first, since the last are
    those that turn the tip. Of many spare joints, the choices come first that leave joints in a
    row.
    """
    order = unknown if task in ("orientation", "direction") else unknown[::-1]
    count = len(unknown) - extra
    slides = [i for i in order if lines.kinds[i] == SLIDE]
    turns = [i for i in order if lines.kinds[i] != SLIDE]
    rows = (tuple(i for i in order if i not in order[k : k + count]) for k in range(extra + 1))
    more = extra - len(slides)
    carrying = (
        ((*c, *slides) for c in itertools.combinations(turns, more)) if slides and more >= 0 else ()
    )
    seen: set[frozenset[int]] = set()
    every = itertools.chain(
        itertools.islice(carrying, MOST_CHOICES),
        rows if extra > 2 else (),
        itertools.islice(itertools.combinations(order, extra), MOST_CHOICES),
    )
    for choice in every:
        check_for_stop()
        key = frozenset(choice)
        if (
            key not in seen
            and count_chain_freedoms(lines, free, [i for i in unknown if i not in key]) == rank
        ):
            seen.add(key)
            yield choice
        if len(seen) >= MOST_CHOICES:
            return
    if not seen:  # each of the first choices took a freedom: hold joints one by one
        held: list[int] = []
        for i in order:
            rest = [k for k in unknown if k != i and k not in held]
            if len(held) < extra and count_chain_freedoms(lines, free, rest) == rank:
                held.append(i)
        if len(held) == extra:
            yield tuple(held)


def _are_all_slides_held(lines: Lines, unknown: list[int], choice: tuple[int, ...]) -> bool:
    """Return whether a choice of locked joints holds all slides and leaves an arm of turns."""
    slides = [i for i in unknown if lines.kinds[i] == SLIDE]
    return bool(slides) and set(slides) <= set(choice)


def _choose_held_values(plan: ChainPlan, fixed: tuple[int, ...]) -> tuple[float, ...]:
    """Choose coordinates (n,) at which joints are held by default: zero, inside the limits.

    An elimination takes long where axes line up that do not otherwise; there they are held aside of
    zero.
    """
    lines = plan.lines
    n = len(plan.lines)
    zero = np.clip(np.zeros(n), *lines.limits)
    if plan.method != ELIMINATION:
        return tuple(zero.tolist())
    rng = np.random.default_rng(23)
    theta = sample_variables(lines, rng, 2)
    theta[1, list(plan.locked)] = lines.compute_theta(zero)[list(plan.locked)]
    if _count_aligned_joints(plan, theta[1]) <= _count_aligned_joints(plan, theta[0]):
        return tuple(zero.tolist())
    aside = np.clip(ASIDE / np.abs(lines.multiplier), *lines.limits)
    there = np.where(aside > zero, aside, np.clip(-ASIDE / np.abs(lines.multiplier), *lines.limits))
    return tuple(there.tolist())


def _count_aligned_joints(plan: ChainPlan, theta: Array) -> int:
    """Count moving joints whose axis is nearly parallel to the next, or nearly meets it."""
    axes, _ = compute_carried_lines(plan.lines, plan.locked, plan.extra, theta)
    moving = [i for i in range(len(plan.lines)) if i not in plan.locked]
    count = 0
    for i, j in itertools.pairwise(moving):
        across = np.cross(axes.h[i], axes.h[j])
        size = float(np.linalg.norm(across))
        count += size < NEARLY or abs(float(across @ (axes.o[j] - axes.o[i]))) < NEARLY * size
    return count


def _estimate_solved_share(plan: ChainPlan) -> float:
    """Estimate the share of random poses that have a solution inside the limits."""
    lines = plan.lines
    n = len(plan.lines)
    q = scale_to_domains(lines, np.random.default_rng(17).random((SAMPLES, n)))
    held = np.array([plan.first])
    out = np.empty((SAMPLES, A.SLOTS, n + A.INFO))
    counts = np.empty((SAMPLES, 2), dtype=np.int64)
    tolerance = 1e-9 * max(lines.length, 1.0)
    plan.fill_solutions(
        compute_targets(lines, plan.extra, q),
        held,
        held,
        tolerance,
        TOLERANCE,
        0,
        np.arange(SAMPLES),
        out,
        counts,
    )
    code = out[..., n + A.CODE]
    return float(((code >= 0.0) & (code.astype(np.int64) % 2 == 1)).any(axis=1).mean())


def compute_domains(lines: Lines) -> Array:
    """Compute ranges (2, n) of the joints: limits, else one turn, or two lengths each way."""
    half = np.where(lines.kinds == SLIDE, 2.0, np.pi) / np.abs(lines.multiplier)
    low, high = lines.limits
    with np.errstate(invalid="ignore"):
        first = np.where(
            np.isfinite(low), low, np.where(np.isfinite(high), high - 2.0 * half, -half)
        )
        last = np.where(np.isfinite(high), high, first + 2.0 * half)
    return np.stack([first, last])


def scale_to_domains(lines: Lines, shares: Array) -> Array:
    """Scale shares (m, n) from 0 to 1 to coordinates (m, n) in the ranges of `compute_domains`."""
    first, last = compute_domains(lines)
    return first + shares * (last - first)


# ---- the plan of a task


def find_plan(
    system: Model,
    frame: str,
    lines: Lines,
    task: str,
    axis: tuple[float, float, float],
    fixed: tuple[str, ...],
) -> ChainPlan:
    """Find the plan for a task with given joints held; redundant chains hold more by choice."""
    return _build_plan(
        system, frame, task, axis, tuple(sorted(lines.names.index(n) for n in fixed))
    )


@keep_answers
def _build_plan(
    system: Model, frame: str, task: str, axis: tuple[float, float, float], at: tuple[int, ...]
) -> ChainPlan:
    """Build the plan of a frame and task, once."""
    planar = system.dim == 2
    return replace(
        make_locked_plan(find_chain_lines(system, frame, axis), task, at, planar),
        fixed=at,
        planar=planar,
    )


def find_plan_or_reason(
    system: Model, frame: str, task: str, axis: tuple[float, float, float]
) -> ChainPlan | str:
    """Find the plan for a task of a frame, or the reason why there is none."""
    try:
        plan = find_plan(system, frame, find_chain_lines(system, frame, axis), task, axis, ())
    except UnsupportedError as error:
        return str(error)
    if plan.method != SEARCH and not plan.locked:
        return plan
    why = (
        "has more joints than the task needs"
        if plan.locked
        else "has neither a closed form nor an elimination"
    )
    return f"the chain of {frame!r} {why}: method 'analytic' has no single answer for it"
