"""The true local dimension of a mechanism: of its solution set at a closed configuration, branch by
branch.

The rank of the constraint Jacobian gives an upper bound only. Where equations are dependent, the
reduction of Lyapunov and Schmidt tells by Taylor coefficients whether null vectors are velocities
of motions; where not all are, the branches are found on small spheres, and what they are is
measured at their own points. Kicking the mechanism and letting it snap back is a second method that
shares nothing with the first but equations and projection. Neither proves a number; where a theorem
does (`kempe.analysis.local.dof_proofs`), the answer is certain. Joint limits do not count.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.analysis.local import branches as follow
from kempe.analysis.local import reduction
from kempe.analysis.local.branches import Branch
from kempe.analysis.local.dof_proofs import Proof, Prover
from kempe.analysis.local.local_equations import Equations
from kempe.analysis.local.reduction import Split
from kempe.errors import InputError
from kempe.kinematics.ball_angles import back, regular_chart
from kempe.kinematics.configuration import as_q
from kempe.model.kept import kept
from kempe.model.tree.own_tree import own_tree
from kempe.singular_values import svd
from kempe.solvers.common.clock import TimeLimit
from kempe.spatial import Array
from kempe.words import InWords

if TYPE_CHECKING:
    from kempe.model.system import System

OPEN = 1e-6
"""Residual above which a configuration is not closed."""
KICK = 0.1
"""Size of the kicks away from the configuration, in radians and characteristic lengths."""
SMALL_KICKS = (0.008, 0.003)
"""Sizes of the kicks around a point that was reached."""
WALK = tuple(0.1 * k for k in range(1, 11))
FAINT = 1e-6
"""Distances to which a motion is followed, and residuals that show, where it ends, that it was
none: what is shaky of a high order has none to be seen before, while a motion that turns back
leaves a large one beyond."""
STAYS = 0.3
"""Part of the kick that remains, where it was along a motion; the rest has collapsed."""
CLEAR_GAP = 1e3
ROUNDING = 1e-14
"""Ratio of singular values, on both sides of the rank tolerance, from which the rank is beyond
doubt; and the part of the largest up to which those that count as zero are rounding, with
certainty."""


@dataclass(frozen=True, eq=False)
class LocalDimension(InWords):
    """How many degrees of freedom a mechanism truly has at a configuration, and by which test that
    was found.

    `dim` is the largest dimension of a branch of the solution set through the configuration,
    `rank_dim` the nullity of the Jacobian, an upper bound; `smooth` says that the set is a manifold
    of dimension `rank_dim` there. `obstruction_order` is the first order at which a null vector
    cannot be continued (None: all can, to `order`). `q` is the configuration with its last digits
    corrected. `sampled` is the dimension by the second method (None: not requested, or a theorem
    decides).

    `certain` says that `dim` is proven, for the mechanism in which what is zero to rounding is
    zero; `proof` names the theorem. Otherwise `dim` is what Taylor coefficients to `order` and the
    second method say. `counted` says that the number of branches is proven, too; otherwise these
    were found, and `more` says why there may be others. `doubts` names disagreements of the
    methods, and numbers too near their tolerance: none where `dim` is proven.
    """

    dim: int
    rank_dim: int
    corank: int
    branches: tuple[Branch, ...]
    smooth: bool
    obstruction_order: int | None
    method: str
    order: int
    tolerance: float
    gap: float
    sampled: int | None
    certain: bool
    doubts: tuple[str, ...] = ()
    more: tuple[str, ...] = ()
    proof: str = ""
    counted: bool = False
    q: Array = field(default_factory=lambda: np.zeros(0), repr=False)

    @property
    def isolated(self) -> bool:
        """Whether the configuration is rigid: no motion leads away from it."""
        return self.dim == 0

    @property
    def branch_dims(self) -> tuple[int, ...]:
        """Dimensions of the branches, the largest first."""
        return tuple(b.dim for b in self.branches)

    def __str__(self) -> str:
        head = f"true local DoF {self.dim}" + (
            "" if self.certain else f" (to order {self.order}, not proven)"
        )
        text = [f"{head}; rank DoF {self.rank_dim}", self.method]
        if len(self.branches) > 1 or any(
            b.dim != self.rank_dim or b.cusp or b.cone for b in self.branches
        ):
            text.append(
                "; ".join(
                    ["branches: " + ", ".join(_describe(b) for b in self.branches), *self.more]
                )
            )
        return "; ".join([*text, *([f"proven: {self.proof}"] if self.proof else []), *self.doubts])


def _describe(branch: Branch) -> str:
    """A branch in words."""
    kind = (
        "a cusp"
        if branch.cusp
        else "an end"
        if branch.ends == 1
        else "a cone"
        if branch.cone
        else ""
    )
    notes = [n for n in (kind, "shaky all along" if branch.multiple else "") if n]
    return f"dimension {branch.dim}" + (f" ({', '.join(notes)})" if notes else "")


def local_dimension(
    system: System,
    q: Any,
    *,
    order: int = 8,
    rng: np.random.Generator | int = 0,
    tolerance: float = reduction.RANK,
    sampling: bool = True,
    time: TimeLimit | None = None,
) -> LocalDimension:
    """The true number of degrees of freedom at a closed configuration, with the branches that meet
    there.

    `q` (nq,) or a dict by coordinate name must be closed; `order` is that of the Taylor
    coefficients, `tolerance` the part of the largest singular value below which one counts as zero;
    `sampling=False` leaves out the second method, which is used wherever no theorem decides. After
    the `time` of the call `TimeUp` is raised.
    Where three angles of a ball joint are singular coordinates, tangents are in rates of angles
    measured from there. Errors: `InputError` for an open configuration.

    >>> import kempe
    >>> system = kempe.load("parallelogram")
    >>> flat = local_dimension(system, system.q("flat"))
    >>> flat.rank_dim, flat.dim, flat.branch_dims
    (2, 1, (1, 1))
    """
    q = as_q(system, q)
    if q.ndim != 1:
        raise InputError(
            f"q has shape {q.shape}; the local dimension is found at one configuration (nq,)"
        )
    if not isinstance(order, (int, np.integer)) or not 2 <= order <= 16:
        raise InputError(f"order is {order!r}; it must be a whole number from 2 to 16")
    if not 0.0 < tolerance < 1.0:
        raise InputError(
            f"tolerance is {tolerance!r}; it must be a part of one, such as {reduction.RANK:g}"
        )
    other, there, turned = regular_chart(own_tree(system), q)
    rng = np.random.default_rng(rng)
    return in_chart(system, _found(other, there, order, rng, tolerance, sampling, time), turned)


def in_chart(system: System, found: LocalDimension, turned: dict[str, Array]) -> LocalDimension:
    """The answer with its configurations in the coordinates of the system itself."""
    if not turned:
        return found
    own = tuple(replace(b, q=back(system, b.q, turned)) for b in found.branches)
    return replace(found, branches=own, q=back(system, found.q, turned))


def _found(
    system: System,
    q: Array,
    order: int,
    rng: np.random.Generator,
    tolerance: float,
    sampling: bool,
    time: TimeLimit | None,
) -> LocalDimension:
    """The answer at a configuration whose coordinates are regular."""
    equations = _equations(system)
    if (
        time is not None
    ):  # the equations are kept with the system, and other calls have other limits
        equations = copy(equations)
        equations.time = time
    at = reduction.split(equations, _closed(equations, q), tolerance)
    prover = Prover(system, equations, at.q)
    proof = prover.manifold()
    doubts = _doubts(at)
    more: list[str] = []
    if at.corank == 0 or at.delta == 0 or (proof is not None and proof.dim == at.delta):
        why = "the equations are independent: a manifold by the implicit function theorem"
        if at.corank and at.delta:
            why = "a manifold, though some equations depend on others"
        if at.delta == 0:
            why = "the Jacobian has no null space: rigid, to first order"
        whole = [_whole(equations, at)]
        return _answer(
            equations, at, order, tolerance, whole, True, None, why, (doubts, more), None, proof
        )
    found = reduction.obstruction(equations, at, order, rng)
    k = found.order
    if found.doubt:
        doubts.append(f"a Taylor coefficient {found.doubt:.1g} is neither zero nor clearly not")
    if k is None:
        found = [_whole(equations, at)]
        smooth = True
        why = f"no velocity is obstructed to order {order} (coefficients below {reduction.ZERO:g})"
        why += ": a manifold, to that order"
        reached, faded = _walked(equations, at, rng) if sampling else (0.0, False)
        if faded:
            doubts.append(
                f"the motion fades at a distance of {reached:.1g}: it may be shaky of an order "
                f"above {order}"
            )
        elif reached:
            why += f"; followed to a distance of {reached:.1g}"
    elif at.delta == 1:
        found = []
        smooth = False
        why = f"isolated: the only velocity is obstructed at order {k} (shaky of order {k - 1})"
    else:
        found = _branches(equations, at, order, rng, doubts, more)
        smooth = False
        why = (
            f"some velocities are obstructed at order {k}; branches followed on spheres of radius "
            f"{follow.RADII[0]:g}"
        )
    if proof is None and k is not None:
        proof = prover.dimension(order, [b.tangent / equations.scale[:, None] for b in found])
    sampled = None
    if sampling:
        sampled = sampled_dimension(equations, at, rng)
        truth = max((b.dim for b in found), default=0)
        if sampled != truth:
            doubts.append(f"sampling finds dimension {sampled}, following branches {truth}")
    return _answer(
        equations, at, order, tolerance, found, smooth, k, why, (doubts, more), sampled, proof
    )


def _doubts(at: Split) -> list[str]:
    """What speaks against the rank."""
    if at.gap < CLEAR_GAP:
        return [f"singular values differ by a factor {at.gap:.1g} only across the rank"]
    rest = (
        float(at.sigma[at.rank]) / max(float(at.sigma[0]), reduction.LEAST)
        if at.rank < len(at.sigma)
        else 0.0
    )
    if rest > ROUNDING:
        return [
            f"a singular value of {rest:.1g} of the largest is taken as zero, but may be more than "
            "rounding"
        ]
    return []


@kept
def _equations(system: System) -> Equations:
    """The packed equations of a system."""
    return Equations(system)


def _closed(equations: Equations, q: Array) -> Array:
    """The configuration with its last digits corrected. Errors: `InputError` saying what is open by
    how much.
    """
    value = equations.linearise(q)[0][0]
    if value.size and not np.max(np.abs(value)) < OPEN:
        name, row = equations.names[int(np.nanargmax(np.abs(np.nan_to_num(value, nan=np.inf))))]
        raise InputError(
            f"the configuration is open: {name!r} ({row}) by {np.max(np.abs(value)):.2g} (radians, "
            "or typical lengths of a link); close it with assemble first"
        )
    if value.size and np.linalg.norm(value) > 1e-13:
        better = equations.project(q, q)
        q = better.q[0] if better.residual[0] < np.linalg.norm(value) else q
    return q


def _whole(equations: Equations, at: Split) -> Branch:
    """The only branch of a manifold."""
    return Branch(
        at.delta, at.null_space * equations.scale[:, None], at.q, 2 if at.delta == 1 else 0
    )


def _branches(
    equations: Equations,
    at: Split,
    order: int,
    rng: np.random.Generator,
    doubts: list[str],
    more: list[str],
) -> list[Branch]:
    families, complete = follow.find(equations, at, rng)
    if not complete:
        more.append(
            f"some were hit once only in {follow.MOST_STARTS} starts, so there may be more branches"
        )
    if not follow.dimensions(equations, families, order, rng):
        doubts.append("points of one branch differ in dimension")
    if not follow.stays_multiple(equations, at, families):
        more.append("a branch is shaky near the configuration only, so several may nearly coincide")
    worst = max((s.obstructed or 0 for f in families for s in f.spots), default=0)
    if worst > 2:
        doubts.append(
            f"a branch is shaky of order {worst - 1} all along: its points are found to a few "
            "digits only"
        )
    found, paired = follow.collect(equations, families)
    if not paired:
        more.append("a half-branch was found without its other half, so some branches were missed")
    return found


def _answer(
    equations: Equations,
    at: Split,
    order: int,
    tolerance: float,
    found: list[Branch],
    smooth: bool,
    k: int | None,
    why: str,
    doubts: tuple[list[str], list[str]],
    sampled: int | None,
    proof: Proof | None,
) -> LocalDimension:
    """The answer; `doubts` about its number, and about that of its branches."""
    found = [b for b in found if b.dim and (proof is None or b.dim <= proof.dim)]
    dim = max((b.dim for b in found), default=0) if proof is None else proof.dim
    counted = proof is not None and proof.branches == len(found)
    return LocalDimension(
        dim,
        at.delta,
        at.corank,
        tuple(found),
        smooth,
        k,
        why,
        order,
        tolerance,
        at.gap,
        sampled,
        proof is not None,
        () if proof else tuple(doubts[0]),
        () if counted else tuple(doubts[1]),
        proof.why if proof else "",
        counted,
        at.q,
    )


def _walked(equations: Equations, at: Split, rng: np.random.Generator) -> tuple[float, bool]:
    """How far a motion along the null space can be followed, and whether it is seen to end there:
    (distance, bool).

    The direction is random, the distance at most 1, in radians and characteristic lengths. True
    means that the residual there is small but not zero: there is no finite motion, the loops only
    seem to close near the configuration.
    """
    x = reduction.axes(rng, at.delta) @ at.null_space.T
    reached = 0.0
    for radius in WALK:
        found = equations.project(equations.move(at.q, radius * x), at.q, radius)
        left = np.hypot(found.residual, found.distance - radius)
        good = left < follow.CLOSED
        if not good.any():
            return (radius, True) if left.min() < FAINT else (reached, False)
        reached = radius
        x = equations.offset(at.q, found.q[good]) / radius
    return reached, False


def sampled_dimension(equations: Equations, at: Split, rng: np.random.Generator) -> int:
    """Largest dimension that random steps along the null space show: they are projected back, then
    repeated from there.

    Steps in directions without a motion shrink to about the root of the residual; those along
    motions keep their size.
    """
    count = 10 + 2 * min(at.delta, 10)
    kicks = KICK * reduction.unit_directions(rng, count, at.delta) @ at.null_space.T
    found = equations.project(equations.move(at.q, kicks), at.q)
    good = (
        (found.residual < follow.CLOSED)
        & (found.distance > STAYS * KICK)
        & (found.distance < 2.0 * KICK)
    )
    if not good.any():
        return 0
    places: list[Split] = []
    for here in reduction.split_all(found.q[good], found.jacobian[good]):
        if all(
            follow.apart(here.null_space, other.null_space) > follow.SAME_PLANE for other in places
        ):
            places.append(here)
    return max(_kicked(equations, p, rng) for p in places[:6])


def _kicked(equations: Equations, at: Split, rng: np.random.Generator) -> int:
    """Dimension of the solution set about a point of it: the smaller of what two sizes of kicks
    see.

    Both can see too much: large ones because the set is bent, small ones because what collapses
    leaves a rest.
    """
    d = reduction.axes(rng, at.delta)
    seen: list[int] = []
    for size in SMALL_KICKS:
        found = equations.project(equations.move(at.q, size * d @ at.null_space.T), at.q)
        x = equations.offset(at.q, found.q[found.residual < follow.CLOSED]) / size
        sigma = svd(x, compute_uv=False) / np.sqrt(max(len(x), 1))
        seen.append(int(np.sum(sigma > STAYS / np.sqrt(max(at.delta, 1)))))
    return min(seen)
