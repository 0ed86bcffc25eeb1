"""The way from a target to all configurations, in words, and how many there can be."""

from __future__ import annotations

import numpy as np

from kempe import spatial
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.closed_form.analytic_layout import AT_REST, COUPLED, PLANE, POINT, X_FIRST
from kempe.kernels.compiled import candidates
from kempe.kernels.forward.table_layout import SLIDE
from kempe.singular_values import svd
from kempe.solvers.analytic.plans.chain_lines import Lines
from kempe.solvers.analytic.plans.plan import (
    ChainPlan,
    carried_lines,
    free_lines,
    freedoms,
    motion,
    spread,
    sweep,
)
from kempe.solvers.analytic.plans.structure import EXACT, Axes, Strategy
from kempe.spatial import Array
from kempe.words import in_words, joined

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
    if len(places) == 1 or (
        len(places) == 2 and plan.task == "pose"
    ):  # else the joints would move as one
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


# ---- closed forms


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
        if (
            self.roles[4] == A.REST
        ):  # x and z alone move a point, or a direction: two circles meet in two points
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
