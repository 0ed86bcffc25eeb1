"""`ik_plan`: what is recognised in a chain, and how its inverse model is solved, in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.answers.targets import axis_for, task_and_axis, task_of
from kempe.arguments import explained, listed
from kempe.errors import UnsupportedError
from kempe.inverse.closed_forms.chain_lines import Lines, chain_lines, motion, sweep
from kempe.inverse.closed_forms.plan import (
    ChainPlan,
    carried_lines,
    free_lines,
    freedoms,
    plan_for,
    spread,
)
from kempe.inverse.closed_forms.question import held
from kempe.inverse.closed_forms.structure import (
    EXACT,
    Axes,
    Strategy,
    apart,
    keeps_point,
    meeting,
    parallel,
)
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.closed_form.analytic_layout import AT_REST, COUPLED, PLANE, POINT, X_FIRST
from kempe.kernels.compiled import candidates
from kempe.kernels.forward.table_layout import SLIDE
from kempe.report import Report
from kempe.singular_values import svd
from kempe.spatial import Array
from kempe.words import by_topic, counted, in_words, joined

if TYPE_CHECKING:
    from kempe.inverse.formulas import InverseFormulas
    from kempe.model.model import FrameLike, Model


# ---- facts about consecutive axes

# These facts decide how the inverse model is solved.

NEAR = 1e-2
"""Sine of an angle, or distance in lengths of the chain, below which a structure that is not there
counts as missed."""

AS_IT_IS = "solved as what they are"


def relations(lines: Lines) -> tuple[str, ...]:
    """Facts about consecutive axes of a chain, in its order; they hold in every configuration.

    Structures are those that `structure.EXACT` accepts; what misses one by less than `NEAR` is
    reported with its size.
    """
    axes = Axes(lines.kinds, lines.h, lines.o)
    n = len(lines)
    i = 0
    out: list[str] = []
    if n == 1:
        return (f"{lines.names[0]} is the only joint",)
    while i < n - 1:
        end = _last_parallel(axes, i)
        if end > i:
            out += _run(lines, axes, i, end)
            i = end
            continue
        end = _last_meeting(axes, i)
        if end > i + 1:
            out.append(_ball(lines, axes, i, end))
            i = end
            continue
        out.append(_pair(lines, axes, i))
        missed = _missed_ball(lines, axes, i)
        if missed:
            out.append(missed)
        i += 1
    return tuple(out)


def _last_parallel(axes: Axes, i: int) -> int:
    j = i
    while j + 1 < len(axes.kinds) and parallel(axes.h[j], axes.h[j + 1]):
        j += 1
    return j


def _last_meeting(axes: Axes, i: int) -> int:
    """The last of the consecutive turns from i that meet in one point, neighbours not parallel."""
    j = i + 1
    while j + 1 < len(axes.kinds) and keeps_point(axes, j - 1):
        if meeting(axes, tuple(range(i, j + 2))) is None:
            break
        j += 1
    return j


def _run(lines: Lines, axes: Axes, first: int, last: int) -> list[str]:
    """Facts about joints of one direction."""
    turns = [i for i in range(first, last + 1) if axes.kinds[i] != SLIDE]
    slides = [i for i in range(first, last + 1) if axes.kinds[i] == SLIDE]
    sliding = joined([lines.names[i] for i in slides]) if slides else ""
    verb = "slides" if len(slides) == 1 else "slide"
    if not turns:
        return [f"{sliding} slide in one direction"]
    names = joined([lines.names[i] for i in turns])
    if len(turns) == 1:
        return [f"{sliding} {verb} along the axis of {names}"]
    gaps = [apart(axes, i, j) for i, j in zip(turns, turns[1:], strict=False)]
    if max(gaps) <= EXACT:
        fact = f"the axes of {names} are one line"
        them = "it"
    else:
        size = f", {_metres(lines, gaps[0])} apart" if len(turns) == 2 else ""
        fact = f"the axes of {names} are parallel{size}"
        them = "them"
    out = [fact + (f", and {sliding} {verb} along {them}" if slides else "")]
    if max(gaps) > EXACT:
        for gap, i, j in zip(gaps, turns, turns[1:], strict=False):
            if gap <= EXACT:
                out.append(f"the axes of {lines.names[i]} and {lines.names[j]} are one line")
    return out


def _ball(lines: Lines, axes: Axes, first: int, last: int) -> str:
    names = joined([lines.names[i] for i in range(first, last + 1)])
    right = all(abs(float(axes.h[i] @ axes.h[i + 1])) <= EXACT for i in range(first, last))
    return f"the axes of {names} meet in one point" + (
        ", neighbours at right angles" if right else ""
    )


def _pair(lines: Lines, axes: Axes, i: int) -> str:
    """The fact about two neighbours that are not parallel."""
    a = lines.names[i]
    b = lines.names[i + 1]
    angle, sine = _angle(axes.h[i], axes.h[i + 1])
    at = (
        "right angles"
        if abs(float(axes.h[i] @ axes.h[i + 1])) <= EXACT
        else f"{math.degrees(angle):.4g} degrees"
    )
    sliding = axes.kinds[i] == SLIDE, axes.kinds[i + 1] == SLIDE
    if sine <= NEAR:
        what = "the directions" if any(sliding) else "the axes"
        return f"{what} of {a} and {b} are {sine:.2g} rad from parallel: {AS_IT_IS}"
    if all(sliding):
        return f"{a} and {b} slide at {at} to each other"
    if any(sliding):
        slide, turn = (a, b) if sliding[0] else (b, a)
        return f"{slide} slides at {at} to the axis of {turn}"
    gap = apart(axes, i, i + 1)
    if gap <= EXACT:
        return f"the axes of {a} and {b} meet at {at}"
    if gap <= NEAR:
        return (
            f"the axes of {a} and {b} miss each other by {_metres(lines, gap)}, at {at}: {AS_IT_IS}"
        )
    return f"the axes of {a} and {b} pass each other at {at}, {_metres(lines, gap)} apart"


def _missed_ball(lines: Lines, axes: Axes, i: int) -> str:
    """The fact that three axes nearly meet in one point; '' where they do not."""
    if i + 2 >= len(axes.kinds) or np.any(axes.kinds[i : i + 3] == SLIDE):
        return ""
    points: list[Array] = []
    for j in (i, i + 1):
        if _angle(axes.h[j], axes.h[j + 1])[1] <= NEAR or apart(axes, j, j + 1) > NEAR:
            return ""
        points.append(_foot(axes, j + 1 if j == i else j, j if j == i else j + 1))
    gap = max(
        float(np.linalg.norm(points[1] - points[0])),
        apart(axes, i, i + 1),
        apart(axes, i + 1, i + 2),
    )
    if not EXACT < gap <= NEAR:
        return ""
    names = joined(lines.names[i : i + 3])
    return f"the axes of {names} miss a common point by {_metres(lines, gap)}: {AS_IT_IS}"


def _foot(axes: Axes, i: int, j: int) -> Array:
    """The point (3,) of axis i nearest to axis j."""
    n = np.cross(axes.h[i], axes.h[j])
    d = axes.o[j] - axes.o[i]
    return axes.o[i] + axes.h[i] * (np.cross(d, axes.h[j]) @ n) / (n @ n)


def _angle(g: Array, h: Array) -> tuple[float, float]:
    """The angle between two axes, at most a right angle, and its sine."""
    sine = float(np.linalg.norm(np.cross(g, h)))
    cosine = abs(float(g @ h))
    return math.atan2(sine, cosine), sine


def _metres(lines: Lines, distance: float) -> str:
    return f"{distance * lines.length:.4g} m"


# ---- the way from a target to all configurations, and how many there can be

BY_SLIDES = {0: 16, 1: 16, 2: 8, 3: 2}
"""Isolated configurations of six joints at most, by the number that slide (Raghavan and Roth,
1993)."""


LEAVES_FREE = {
    "position": "the orientation",
    "orientation": "the position",
    "position_axis": "the turn about the tool's axis",
    "direction": "the position and the turn about the tool's axis",
}

ELIMINATED = (
    "no closed form is known for these axes: all unknowns but one are eliminated from the "
    "equations of the loop, which leaves an eigenvalue problem (Raghavan and Roth, 1990)"
)

METHODS = {"closed": "closed form", "elimination": "elimination", "search": "search"}


def path(plan: ChainPlan, given: frozenset[str], planar: bool) -> tuple[str, ...]:
    """Sentences: what is held, what is missing or free, which joints do what; `given` are joints
    held by the user.
    """
    out = [*_held(plan, given), *_balance(plan, planar)]
    if plan.method == "closed":
        return (*out, *_closed(plan))
    if plan.method == "elimination":
        out.append(ELIMINATED)
    else:
        out.append(
            "no closed form is known for these axes: the equations are solved from many starts"
        )
    return tuple(out)


def most(plan: ChainPlan) -> int:
    """The largest number of isolated configurations, turns by 2 pi not counted; held joints stay at
    their values.
    """
    places = [i for i in range(len(plan.lines)) if i not in plan.locked]
    kinds = np.concatenate([plan.lines.kinds[places], plan.extra.kinds])
    # else the joints would move as one
    if len(places) == 1 or (len(places) == 2 and plan.task == "pose"):
        return 1
    bound = BY_SLIDES.get(int((kinds == SLIDE).sum()), 1) if len(kinds) <= 6 else BY_SLIDES[0]
    return bound if plan.way is None else min(bound, _Steps(plan, plan.way).most)


# ---- what is held, missing or free


def _held(plan: ChainPlan, given: frozenset[str]) -> list[str]:
    names = [plan.lines.names[i] for i in plan.locked]
    by_user = [n for n in names if n in given]
    chosen = [n for n in names if n not in given]
    out: list[str] = []
    if by_user:
        out.append(
            f"{joined(by_user)} {_is(by_user)} held at the given value{'s' * (len(by_user) > 1)}"
        )
    if chosen:
        them = "it" if len(chosen) == 1 else "them"
        out.append(
            f"the chain has {in_words(len(chosen), 'joint')} more than the task needs: "
            f"{joined(chosen)} {_is(chosen)} held where `start` has {them}, and elsewhere for "
            "targets without a solution there; name=value holds joints at values of yours"
        )
    return out


def _balance(plan: ChainPlan, planar: bool) -> list[str]:
    """Sentences about what the task leaves free and about equations that the chain cannot meet at
    will.
    """
    out: list[str] = []
    unknown = [i for i in range(len(plan.lines)) if i not in plan.locked]
    free = free_lines(plan.lines, plan.task, planar)
    if len(free.kinds):
        in_plane = "the angle" if plan.task == "position" else "the position"
        out.append(f"the task leaves {in_plane if planar else LEAVES_FREE[plan.task]} free")
    missing = (3 if planar else 6) - freedoms(plan.lines, free, unknown)
    if missing > 0:
        equations = in_words(missing, "equation")
        moving = in_words(len(unknown), "joint")
        why = _why(plan, planar)
        out.append(
            f"{equations} of the task cannot be met at will, with {moving} to move: most targets "
            f"are out of reach{why}"
        )
    return out


def _why(plan: ChainPlan, planar: bool) -> str:
    """What the frame can never do, as part of a sentence."""
    if planar:
        return ""
    lines = plan.lines
    rng = np.random.default_rng(2)
    columns: list[Array] = []
    start: Array = spread(lines, rng, 1)[0]
    for _ in range(4):
        other: Array = spread(lines, rng, 1)[0]
        theta = np.where(np.isin(np.arange(len(lines)), plan.locked), start, other)
        columns.append(_twists(lines, theta, plan.locked))
    twists = np.hstack(columns)
    turning = _rank(twists[3:])
    if turning == 0:
        return "; the frame never turns"
    if turning > 1:
        return ""
    n = svd(twists[3:])[0][:, 0]
    level = float(np.abs(n @ twists[:3]).max()) <= EXACT
    return "; the frame never tilts" + (" and stays in one plane" if level else "")


def _twists(lines: Lines, theta: Array, locked: tuple[int, ...]) -> Array:
    """Twists (6, k) [linear; angular] of the joints that move, at the origin, at theta."""
    X = np.eye(4)
    out: list[Array] = []
    for i in range(len(lines)):
        w = X[:3, :3] @ lines.h[i]
        p = X[:3, :3] @ lines.o[i] + X[:3, 3]
        if i not in locked:
            out.append(
                np.concatenate([w, np.zeros(3)] if lines.kinds[i] == SLIDE else [np.cross(p, w), w])
            )
        X = X @ motion(lines.kinds[i], lines.h[i], lines.o[i], theta[i])
    return np.array(out).reshape(-1, 6).T


def _rank(M: Array) -> int:
    values = svd(M, compute_uv=False)
    return int((values > 1e-7 * max(values[0], 1e-300)).sum()) if values[0] > EXACT else 0


def _is(names: list[str]) -> str:
    return "is" if len(names) == 1 else "are"


# ---- steps of a closed form


def _closed(plan: ChainPlan) -> list[str]:
    assert plan.way is not None
    steps = _Steps(plan, plan.way)
    out: list[str] = []
    if steps.swapped:
        out.append(f"{steps.swapped}: a slide and a turn about its direction can change places")
    return out + steps.sentences()


class _Steps:
    """The three outer and the three inner joints of a way, and what each contributes."""

    def __init__(self, plan: ChainPlan, way: Strategy):
        self.plan = plan
        self.way = way
        n = len(plan.lines)
        places = [(way.inner + k) % 6 for k in range(6)]
        self.places = [way.order[k] for k in places]
        self.roles = [
            A.JOINT if way.order[k] < n else int(plan.extra.roles[way.order[k] - n]) for k in places
        ]
        self.names = [plan.lines.names[way.order[k]] if way.order[k] < n else "" for k in places]
        kinds = [*plan.lines.kinds, *plan.extra.kinds]
        self.slides = [kinds[way.order[k]] == SLIDE for k in places]
        self.degrees = self._degrees()

    @property
    def swapped(self) -> str:
        """Neighbours that the way has in another order, in words."""
        joints = [j for j in self.way.order if j < len(self.plan.lines)]
        moved = [
            self.plan.lines.names[j] for j, k in zip(joints, sorted(joints), strict=True) if j != k
        ]
        return f"{joined(moved)} are taken in another order" if moved else ""

    def _degrees(self) -> tuple[int, int]:
        """Largest numbers of values of x and z: two of a turn, one of a slide with a linear
        equation or at rest.
        """
        x = 3
        z = 5
        if self.way.mode == AT_REST:
            return 1, 1
        if self.way.mode == COUPLED:  # of which one alone has two values
            return (2, 1) if A.REST in (self.roles[x], self.roles[z]) else (4, 1)
        amplitude = _amplitudes(self.plan, self.way)
        first, j = (0, self.way.measure) if self.way.mode == X_FIRST else (1, self.way.measure)
        out = [2, 2]
        for k, measure in ((first, j), (1 - first, 1 - j)):
            place = (x, z)[k]
            if self.slides[place] and amplitude[k, measure, 1] <= EXACT:
                out[k] = 1
            if self.roles[place] == A.REST:
                out[k] = 1
        return out[0], out[1]

    @property
    def inner_ways(self) -> int:
        """Largest number of solutions of the inner joints."""
        inner = self.roles[:3]
        if (
            A.REST in inner
            or A.JOINT not in inner
            or (self.way.what == PLANE and sum(self.slides[:3]) > 1)
        ):
            return 1
        return 2

    @property
    def most(self) -> int:
        """Largest number of configurations that reach a target."""
        outer = self.degrees[0] * self.degrees[1]
        # x and z alone move a point, or a direction: two circles meet in two points
        if self.roles[4] == A.REST:
            outer = min(outer, 2)
        return outer * self.inner_ways

    def sentences(self) -> list[str]:
        """What the joints do, one step a sentence."""
        inner = [
            name
            for name, role in zip(self.names[:3], self.roles[:3], strict=True)
            if role == A.JOINT
        ]
        outer = sorted(
            (self.places[k], self.names[k]) for k in (3, 4, 5) if self.roles[k] == A.JOINT
        )
        out: list[str] = []
        if outer:
            out.append(self._outer(inner, [name for _, name in outer]))
        if inner:
            out.append(self._inner(inner, bool(outer)))
        if A.REST in self.roles and self.way.mode != AT_REST:
            out.append("what is left of the equations tells whether the target can be reached")
        return out

    def _outer(self, inner: list[str], outer: list[str]) -> str:
        """What the inner joints leave in place, and how the outer ones bring it there."""
        bring = "bring" if len(outer) > 1 else "brings"
        if self.way.what == PLANE:
            still = (
                f"{joined(inner)} move{'s' * (len(inner) == 1)} a plane in itself" if inner else ""
            )
            it = "that plane" if inner else "the plane of the tip"
        else:
            where = "where their axes meet" if len(inner) > 1 else "of its axis at the tip"
            still = (
                f"{joined(inner)} {'do' if len(inner) > 1 else 'does'} not move the point {where}"
                if inner
                else ""
            )
            it = "that point" if inner else "the tip"
        return (
            f"{still}{'; ' * bool(still)}{joined(outer)} {bring} {it} to its place: {self._how()}"
        )

    def _how(self) -> str:
        x, y, z = (self._called(k) for k in (3, 4, 5))
        if self.way.mode == COUPLED:
            pair = joined([w for w in (x, z) if w])
            return f"{pair} from one quartic" + (f", {y} follows" if y else "")
        words = {0: (x, self.degrees[0]), 1: (z, self.degrees[1])}
        order = (0, 1) if self.way.mode == X_FIRST else (1, 0)
        said = [
            f"{words[k][0]} from a {'quadratic' if words[k][1] == 2 else 'linear'} equation"
            for k in order
            if words[k][0]
        ]
        if y:
            said.append(f"{y} follows")
        return ", ".join(said)

    def _called(self, k: int) -> str:
        """Name of joint k of the six, inner ones first, or what a free one is; '' for an added one
        that must rest.
        """
        if self.roles[k] == A.FREE:
            return "the free slide" if self.slides[k] else "the free turn"
        return self.names[k]

    def _inner(self, inner: list[str], after: bool) -> str:
        ways = in_words(self.inner_ways, "way")
        then = "then " if after else ""
        if self.way.what == POINT:
            give = "give" if len(inner) > 1 else "gives"
            return f"{then}{joined(inner)} {give} the orientation, {ways}"
        kind = (
            "as a two-link arm does, " if not any(self.slides[:3]) and self.inner_ways == 2 else ""
        )
        give = "give" if len(inner) > 1 else "gives"
        return f"{then}{joined(inner)} {give} the motion within the plane, {kind}{ways}"


def _amplitudes(plan: ChainPlan, way: Strategy) -> Array:
    """Largest size (2, 2, 2) of the factors of x and z (rows) in both measures, over some goals."""
    rng = np.random.default_rng(13)
    lines = plan.lines
    theta: Array = spread(lines, rng, 1)[0]
    axes, shift = carried_lines(lines, plan.locked, plan.extra, theta)
    six = Axes(axes.kinds[list(way.order)], axes.h[list(way.order)], axes.o[list(way.order)])
    out = np.zeros((2, 2, 2))
    for _ in range(3):
        some: Array = spread(lines, rng, 1)[0]
        other = np.where(np.isin(np.arange(len(lines)), plan.locked), theta, some)
        G = sweep(lines, other[None])[0][0] @ spatial.inverse(lines.tip) @ spatial.inverse(shift)
        terms = np.empty(12)
        goal = np.ascontiguousarray(G[:3]).ravel()
        candidates.outer_terms(
            six.kinds, six.packed(), goal, way.inner, way.what, way.option, terms
        )
        out = np.maximum(out, np.abs(terms.reshape(2, 2, 3)[..., 1:]))
    return out


# ---- the report

WIDTH = 110
"""Columns of the text."""


@dataclass(frozen=True)
class Recognised(Report):
    """What is known about the inverse geometric model of a `frame` for a `task`.

    `joints` are those that move the frame, from the ground to it, `kinds` whether each "turns" or
    "slides". `relations` are facts about consecutive axes, those that a structure misses by little
    among them. `path` says step by step how all configurations are found, `method` is "closed
    form", "elimination" or "search". `most` is the largest number of isolated configurations that a
    target can have, turns by 2 pi not counted; `held` are the joints that stay at their values
    because the chain has more than the task needs, or because the caller said so.
    """

    system: str
    frame: str
    task: str
    joints: tuple[str, ...]
    kinds: tuple[str, ...]
    relations: tuple[str, ...]
    path: tuple[str, ...]
    most: int
    method: str
    held: tuple[str, ...]
    note: str = ""
    """Why the task is not a pose, where none was given."""
    of: Model | None = field(default=None, repr=False, compare=False)

    @property
    def status(self) -> str:
        """What it is about."""
        return f"inverse model of {self.frame} of {self.system}, task {self.task}"

    def formulas(self, *, symbols: Mapping[str, Any] | None = None) -> InverseFormulas:
        """The inverse model as formulas; see
        `kempe.inverse.formulas.symbolic_ik`.

        Errors: `UnsupportedError` where there are no short ones, with the reason.
        """
        from kempe.inverse.formulas import symbolic_ik

        if self.of is None or self.held:
            why = (
                f"with {', '.join(self.held)} held; lock them in the mechanism"
                if self.held
                else "without the system"
            )
            raise UnsupportedError(f"there are no formulas {why}")
        return symbolic_ik(self.of, self.frame, self.task, symbols=symbols)

    def _data(self) -> dict[str, Any]:
        return {name: x for name, x in vars(self).items() if name != "of"}

    def topics(self) -> list[tuple[str, tuple[str, ...]]]:
        """The report as (title, lines)."""
        joints = ", ".join(f"{n} {k}" for n, k in zip(self.joints, self.kinds, strict=True))
        if set(self.kinds) == {"turns"} and len(self.joints) > 1:
            joints = f"{', '.join(self.joints)}: all turn"
        count = "configuration" if self.most == 1 else "configurations"
        each = " for each value of what is held" if self.held else ""
        return [
            *([("task", (self.note,))] if self.note else []),
            ("joints", (joints,)),
            ("axes", self.relations),
            ("path", self.path),
            ("method", (self.method,)),
            ("solutions", (f"{self.most} isolated {count} at most{each}",)),
        ]

    def __str__(self) -> str:
        return by_topic(self.status, self.topics(), 11, WIDTH)


@explained
def ik_plan(
    system: Model,
    frame: FrameLike,
    task: str | tuple[str, ArrayLike] | None = None,
    fixed: Iterable[str] = (),
) -> Recognised:
    """What is recognised in the chain that moves `frame`, and how `ik_all` solves it.

    Arguments as those of `kempe.inverse.ik_all.ik_all`; without a `task` that of a pose,
    or of a position where the chain has no more joints than that has equations. `fixed` are the
    names of joints that are held. Errors: `UnsupportedError` for chains with loops, quaternions or
    shared coordinates, `InputError`, `UnknownNameError`.

    >>> import kempe
    >>> from kempe.inverse.describe import ik_plan
    >>> print(ik_plan(kempe.load("puma560"), "tool").most)
    8
    """
    name = system.structure.frame_name(frame)
    said, axis = task_and_axis(task)
    what = task_of(said, False, bool(system.structure.table.at[name][2]))
    direction = axis_for(axis, what)
    lines = chain_lines(system, name, direction)
    note = ""
    if task is None and what == "pose" and len(lines) <= system.dim:
        n = 3 * (system.dim - 1)
        count = counted(len(lines), "joint")
        what = "position"
        note = (
            f"a pose has {n} equations, more than the chain has joints ({count}): the position is "
            "planned"
        )
    given = held(name, lines.names, dict.fromkeys(listed(fixed, "fixed"), 0.0))
    plan = plan_for(system, name, lines, what, direction, tuple(given))
    kinds = tuple("slides" if kind == SLIDE else "turns" for kind in lines.kinds)
    return Recognised(
        system.name,
        name,
        what,
        lines.names,
        kinds,
        relations(lines),
        path(plan, frozenset(given), system.dim == 2),
        most(plan),
        METHODS[plan.method],
        tuple(lines.names[i] for i in plan.locked),
        note,
        system,
    )
