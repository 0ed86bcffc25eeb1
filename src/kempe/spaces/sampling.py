"""Random configurations, uniform in a stated measure of coordinates, arc length or volume."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.answer import Configurations
from kempe.arguments import explain_errors, explain_method_errors, make_generator, raise_interrupted
from kempe.arrays import is_real
from kempe.assemble.assemble import assemble
from kempe.assemble.modes import assembly_modes
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError, UnsupportedError, format_value
from kempe.mobility.mobility import mobility
from kempe.model.configurations import find_free_angles, has_loops, sample_configurations
from kempe.numerics.clock import BROKEN_OFF, TIME_LIMIT, TimeLimit, find_time_limit, limit_time
from kempe.spaces.components import find_components
from kempe.spaces.manifold import Frames, Manifold
from kempe.spatial import Array
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- a random walk on a manifold

# Metropolis's algorithm on the closed configurations, with a uniform limit. Source: Zappa,
# Holmes-Cerfon, Goodman, "Monte Carlo on manifolds: sampling densities and integrating functions",
# Comm. Pure Appl. Math. 71 (2018): a step along the tangent space, led back along the normals of
# where it began, is taken only if the step back would be found, too. In rotations steps are
# exponentials; the determinants that compare the volumes of the two steps are transposes of one
# another, as in flat space, because the measure is invariant on both sides.

FIRST_STEP = 0.5
"""Standard deviation of the first steps in each tangent direction, in radians and characteristic
lengths."""
WANTED = 0.45
"""Share of steps that shall be taken: the length of steps is fitted to it before anything is
kept."""
BACK = 1e-6
"""How far the step back may miss where it came from."""
LEAST = 1e-3
LARGEST = 2.0


class Walkers:
    """Random walkers on a manifold at q (k, nq), with steps of standard deviation `sigma`."""

    def __init__(self, manifold: Manifold, q: Array, rng: np.random.Generator):
        self.manifold = manifold
        self.rng = rng
        self.sigma = FIRST_STEP
        frames = manifold.compute_frames(q)
        self.q = q[frames.regular]
        self.frames = Frames(*(x[frames.regular] for x in frames))
        self.steps = self.moves = 0

    @property
    def acceptance_rate(self) -> float:
        """Fraction of the counted steps that were accepted."""
        return self.moves / max(1, self.steps)

    def fit_step_length(self, steps: int, check: Callable[[], None]) -> None:
        """Take this number of steps and fit their length `sigma`."""
        for _ in range(steps):
            check()
            share = self._take_step()
            self.sigma = float(np.clip(self.sigma * np.exp(0.5 * (share - WANTED)), LEAST, LARGEST))

    def take_steps(self, steps: int, check: Callable[[], None]) -> None:
        """Take this number of steps with constant `sigma`."""
        for _ in range(steps):
            check()
            self._take_step()

    def _take_step(self) -> float:
        """Propose a step for each walker, and accept those that the measure allows."""
        m = self.manifold
        q = self.q
        f = self.frames
        k = len(self.q)
        v = self.sigma * self.rng.normal(size=(k, m.dim))
        chance = np.log(np.maximum(self.rng.random(k), 1e-300))
        step, ok = m.lift_steps(q, _combine_directions(f.tangent, v), f.normal)
        who = np.flatnonzero(ok)
        y = m.move_configurations(q[who], step[who])
        who, y = _select_rows(m.are_allowed(y), who, y)
        there = m.compute_frames(y)
        back = -np.einsum("kij,ki->kj", there.tangent, step[who])
        likely = np.sum(v[who] ** 2, axis=1) - np.sum(back**2, axis=1)
        taken = there.regular & (chance[who] < likely / (2.0 * self.sigma**2))
        who, y, back, tangent, normal = _select_rows(
            taken, who, y, back, there.tangent, there.normal
        )
        returned, found = m.lift_steps(y, _combine_directions(tangent, back), normal)
        found &= np.linalg.norm(returned + step[who], axis=1) < BACK
        who = who[found]
        self.q[who], f.tangent[who], f.normal[who] = _select_rows(found, y, tangent, normal)
        self.steps = self.steps + k
        self.moves = self.moves + len(who)
        return len(who) / max(1, k)


def _select_rows(which: np.ndarray, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """Select the same rows of several arrays."""
    return tuple(x[which] for x in arrays)


def _combine_directions(basis: Array, v: Array) -> Array:
    """Combine the columns of bases (k, i, j) with coefficients (k, j)."""
    return np.einsum("kij,kj->ki", basis, v)


# ---- samples

MOST = 10**7
"""Configurations at most."""
CHUNK = 1 << 16
"""Configurations that are drawn, and judged by one-sided constraints, at once."""
WALKERS = 1000
FEW = 100
STARTS = 4
"""Walkers at most, those that the length of steps is fitted with, and starts that are assembled for
each."""
FITTED = 60
FIRST = 140
EACH = 40
"""Steps whose length is fitted, steps before the first configuration is kept, and between two of
one walker."""
FAR = 1e3
"""Characteristic lengths at which a slide that can be there counts as one that runs away."""
USUAL = Usual("sample", time_limit=TIME_LIMIT, progress=None)


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Sample(Configurations):
    """Random configurations within limits and constraints.

    Attributes
    ----------
    q
        Configurations (n, nq).
    measure
        The measure in which they are uniform, in words.
    exact
        Whether they are independent draws from the measure (on curves, of the components found). A
        random walk only approaches it.
    taken
        Share of accepted proposals, or of accepted steps of the walk.
    """

    _entries = ("measure", "exact", "taken", "interrupted", "late")

    q: Array
    measure: str
    exact: bool
    reason: str
    taken: float
    wanted: int
    system: Model
    interrupted: bool = False
    late: bool = False

    @property
    def success(self) -> bool:
        """Whether the sample has the requested size."""
        return len(self.q) == self.wanted


def _make_sample(
    system: Model, n: int, q: Array, measure: str, exact: bool, how: str, taken: float = 1.0
) -> Sample:
    """Make the answer with its sentence."""
    said = (
        f"{format_count(len(q), 'configuration')}{'' if len(q) == n else f' of {n}'}, uniform in "
        f"{measure}: {how}"
    )
    return Sample(q, measure, exact, said, taken, n, system)


def _answer_no_time(time: TimeLimit, system: Model, n: float, *_: Any, **__: Any) -> Sample:
    """Make the answer for a time limit that passed before a configuration was drawn."""
    none = f"none is known: {time.describe_end_reason(TimeUp())} came first"
    return _mark_interrupted_answer(
        _make_sample(system, int(n), np.empty((0, system.nq)), "no measure", False, none, 0.0),
        TimeUp(),
    )


@explain_errors
@raise_interrupted
@limit_time(USUAL, _answer_no_time)
def draw_sample(
    system: Model,
    n: float,
    rng: np.random.Generator | int | None = None,
    *,
    budget: Budget | None = None,
) -> Sample:
    """Draw random configurations (n, nq) within limits and constraints.

    They are uniform in a stated measure.

    Of a tree: the product of the coordinates, rotations of balls by Haar's measure; independent
    draws, rejected where a one-sided constraint does not hold. With loops or relations the measure
    is the length, area or volume that closed configurations have in the space of all coordinates
    (radians and characteristic lengths): with one freedom along the traced curves by arc length,
    else by a random walk (Zappa, Holmes-Cerfon and Goodman, 2018) from random assemblies, which is
    uniform in the limit of many steps on each component; the shares of components that it does not
    join are those of the random assemblies. Of the `budget` are read: time_limit (120 s),
    progress(done, n). Errors: `InputError` for n, and for slides that nothing bounds, by name:
    nothing is uniform there.
    """
    if not (is_real(n) and 1 <= n <= MOST and n == int(n)):
        raise InputError(
            f"n is {format_value(n)}; it must be a whole number of configurations, from 1 to {MOST}"
        )
    rng = make_generator(rng)
    spend = USUAL.complete_budget(budget)
    n = int(n)
    time = find_time_limit(USUAL, budget)

    def check_progress(done: int) -> None:
        """Check the clock and report the number of configurations that are done."""
        time.check_time()
        if spend.progress is not None:
            spend.progress(done, n)

    if not has_loops(system):
        return _sample_tree(system, n, rng, check_progress)
    freedoms = mobility(system)
    if not freedoms.closed or freedoms.dof is None:
        return _make_sample(
            system,
            n,
            np.empty((0, system.nq)),
            "no measure",
            False,
            f"none is known: {freedoms.sentence}",
            0.0,
        )
    if freedoms.dof == 0:
        return _sample_points(system, n, rng)
    if freedoms.dof == 1:
        return _sample_curves(system, n, rng, spend)
    return _sample_by_walk(system, n, rng, freedoms.dof, freedoms.q, check_progress)


def _sample_tree(
    system: Model, n: int, rng: np.random.Generator, check: Callable[[int], None]
) -> Sample:
    """Sample a tree: coordinates uniform within their limits."""
    v = system.structure.layout.vector_v
    bounded = (np.isfinite(system.lower) & np.isfinite(system.upper)) | find_free_angles(system)
    _refuse_unbounded([system.structure.velocity_names[int(i)] for i in v if not bounded[i]])
    rows = pack_one_sided_rows(system)
    drawn = 0
    why = None
    found: list[Array] = []
    try:
        while sum(map(len, found)) < n:
            check(sum(map(len, found)))
            q = sample_configurations(system, rng, min(n, CHUNK))
            drawn += len(q)
            found.append(
                q[(rows.compute_excess(q, declared=True) <= 0.0).all(axis=1)]
                if rows.declared
                else q
            )
    except BROKEN_OFF as error:
        why = error
    q = np.concatenate([np.empty((0, system.nq)), *found])
    taken = len(q) / max(1, drawn)
    how = "drawn independently" + (
        f", {taken:.2g} of them within one-sided constraints" if rows.declared else ""
    )
    return _mark_interrupted_answer(
        _make_sample(system, n, q[:n], "the product of the coordinates", True, how, taken), why
    )


def _sample_points(system: Model, n: int, rng: np.random.Generator) -> Sample:
    """Sample a configuration space of isolated points, the assembly modes."""
    modes = assembly_modes(system)
    q = modes.q[rng.integers(len(modes.q), size=n)] if len(modes.q) else modes.q
    how = (
        f"{format_count(len(modes.q), 'assembly mode')} of a structure that does not move; "
        f"{modes.status}"
    )
    return _make_sample(system, n, q, "the count of assembly modes", modes.complete, how)


def _sample_curves(system: Model, n: int, rng: np.random.Generator, spend: Budget) -> Sample:
    """Sample a configuration space of curves, uniform in arc length."""
    found = find_components(system, budget=Budget(time_limit=spend.time_limit))
    paths = [p for c in found.parts for p in c.paths if len(p) > 1]
    for path in paths:
        if not path.closed and any("no end" in end or "runs away" in end for end in path.ends):
            raise InputError(
                f"{system.name} moves along a curve without end ({path.ends[1]}): nothing is "
                "uniform there; limits bound it (with_limits)"
            )
    if not paths:
        return _make_sample(
            system, n, np.empty((0, system.nq)), "arc length", False, found.status, 0.0
        )
    length = np.array([p.length for p in paths])
    which = rng.choice(len(paths), size=n, p=length / length.sum())
    at = rng.random(n) * length[which]
    q = np.empty((n, system.nq))
    for k, path in enumerate(paths):
        q[which == k] = path.at(at[which == k])
    q = Manifold(system, 1).metric.choose_representatives(q, None)
    how = (
        f"drawn independently along {format_count(len(paths), 'traced curve')} of total length "
        f"{length.sum():.6g}"
    )
    how += "" if found.complete else "; curves may have been missed"
    return _mark_interrupted_answer(
        _make_sample(system, n, q, "arc length", bool(found.complete), how), None, found.late
    )


def _sample_by_walk(
    system: Model,
    n: int,
    rng: np.random.Generator,
    dim: int,
    home: Array,
    check: Callable[[int], None],
) -> Sample:
    """Sample a configuration space of higher dimension by random walks on the manifold."""
    manifold = Manifold(system, dim)
    _refuse_unbounded(_find_unbounded_slides(system))
    why = None
    kept: list[Array] = []
    starts = _find_starts(manifold, min(n, WALKERS), home, rng)
    few = Walkers(manifold, starts[:FEW].copy(), rng)
    walkers = Walkers(manifold, starts, rng)
    if not len(walkers.q):
        raise UnsupportedError(
            f"{system.name}: no regular configuration was found from which to walk"
        )
    try:
        few.fit_step_length(FITTED, lambda: check(0))
        walkers.sigma = few.sigma
        walkers.take_steps(FIRST, lambda: check(0))
        while sum(map(len, kept)) < n:
            if kept:
                walkers.take_steps(EACH, lambda: check(sum(map(len, kept))))
            kept.append(manifold.metric.choose_representatives(walkers.q, None))
    except BROKEN_OFF as error:
        why = error
    q = np.concatenate([np.empty((0, system.nq)), *kept])[:n]
    measure = "area" if dim == 2 else f"volume of dimension {dim}"
    each = walkers.steps // len(walkers.q)
    starts = f"{'each of ' * (len(walkers.q) > 1)}{format_count(len(walkers.q), 'assembly')}"
    how = f"a random walk of {format_count(each, 'step')} from {starts}"
    how += f", {walkers.acceptance_rate:.2g} of them taken"
    return _mark_interrupted_answer(
        _make_sample(system, n, q, measure, False, how, walkers.acceptance_rate), why
    )


def _find_starts(manifold: Manifold, count: int, home: Array, rng: np.random.Generator) -> Array:
    """Find closed configurations (k, nq) inside the limits, from random ones."""
    q = manifold.metric.choose_representatives(
        manifold.draw_configurations(rng, STARTS * count), None
    )
    q = q[manifold.are_allowed(q)] if len(q) else q
    if not len(q):
        q = home[None] if manifold.are_allowed(home[None])[0] else q
    return np.resize(q, (count, q.shape[1])) if len(q) else q


def _find_unbounded_slides(system: Model) -> list[str]:
    """Find the names of slides that close the loops at a thousand characteristic lengths."""
    names = system.structure.velocity_names
    turning = system.structure.coordinates.turning
    manifold = Manifold(system, 1)
    out: list[str] = []
    layout = system.structure.layout
    for iq, iv in zip(layout.vector_q.tolist(), layout.vector_v.tolist(), strict=True):
        if turning[iv] or (np.isfinite(system.lower[iv]) and np.isfinite(system.upper[iv])):
            continue
        far = [
            s * FAR * manifold.metric.length
            for s in (-1.0, 1.0)
            if system.lower[iv] <= s * FAR <= system.upper[iv]
        ]
        if any(
            assemble(
                system, {system.coordinate_names[iq]: x}, limits=False, budget=Budget(starts=4)
            )
            for x in far
        ):
            out.append(names[int(iv)])
    return out


def _refuse_unbounded(names: list[str]) -> None:
    """Refuse coordinates without bounds. Errors: `InputError`."""
    if names:
        said = (
            f"{', '.join(map(repr, names))} {'is' if len(names) == 1 else 'are'} not bounded on "
            "both sides"
        )
        cure = f"with_limits({{{names[0]!r}: (low, high)}}) bounds it"
        raise InputError(f"{said}, and nothing is uniform there: {cure}")


def _mark_interrupted_answer(
    answer: Sample, why: BaseException | None, late: bool = False
) -> Sample:
    """Mark an answer whose work was ended by the time limit or by Ctrl-C."""
    if why is None and not late:
        return answer
    return replace(
        answer,
        late=late or isinstance(why, TimeUp),
        interrupted=isinstance(why, KeyboardInterrupt),
        reason=f"{answer.reason} (stopped early)",
    )
