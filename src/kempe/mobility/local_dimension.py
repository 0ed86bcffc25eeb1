"""Exact local dimension of the set of closed configurations, branch by branch.

The rank of the Jacobian is an upper bound only. Taylor coefficients, and points on small spheres
around the configuration, tell the branches and their dimensions.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.errors import InputError
from kempe.mobility import lyapunov_schmidt
from kempe.mobility.dof_proofs import Proof, Prover
from kempe.mobility.local_equations import Equations
from kempe.mobility.lyapunov_schmidt import Split
from kempe.model.ball_angles import convert_from_chart, make_regular_chart
from kempe.model.configurations import read_q
from kempe.model.model import keep_answers
from kempe.model.own_tree import remove_cut_marks
from kempe.numerics.clock import TimeLimit
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.words import InWords

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- branches on small spheres

# Near a point an analytic set is a cone over its intersection with a small sphere (Milnor, 1968,
# section 2), so the points at distance h, for several h, show all branches: cusps, too, and those
# that tangent cones do not tell apart.

RADII = (0.06, 0.02, 0.006)
"""Radii of the spheres, in radians and characteristic lengths."""
FAR = 0.3
"""Radius at which branches that touch should have parted."""
CLOSED = 1e-11
"""Residual below which a point belongs to the solution set."""
SAME_POINT = 1e-3
"""Points nearer than this part of the radius are one."""
BLURRED = 0.05
"""The same where the equations touch the solution set: there points are known to few digits."""
ALONG = 0.5
TURNED = 0.15
"""Way along the sphere, as a part of its radius, and the turn of the tangent space over it that
shows a cone."""
FELL_BACK = 0.1
"""A start that ends nearer to the configuration than this part of the radius found no motion."""
BATCH = 32
MOST_STARTS = 480
MOST_KEPT = 20
ENOUGH = 4
"""Starts at a time and in all, points kept of a family, and hits of each beyond which the search
ends."""
SAME_PLANE = 0.2
"""Tangent spaces nearer to each other (root sum square of sines) belong to one branch."""
SPREAD = 0.7
"""Singular value of points around a point of a branch up to which a direction is none of the
branch, but its bend or its distance to the point. Points are sought both ways along the axes of a
frame: where both are found it is at least the root of 2 for directions of the branch, where one of
each is found at least 1."""
SAME_LIMIT = 0.1
"""The same on the smallest sphere, where they are nearly those at the configuration itself."""
STEP = 0.2
"""Steps from a point of a branch, to see which directions it has, as a part of the radius."""


@dataclass(frozen=True, eq=False)
class Branch:
    """One branch of the solution set through a configuration.

    `tangent` (nv, dim): velocities (rad/s, m/s) that span it, each of unit size with lengths over
    the characteristic length. For curves it is the limit at the configuration, else that at `q`
    (nq,), a point of the branch nearby. `ends` says for a curve how many half-branches make it up:
    2, with `cusp` where both leave to the same side.
    """

    dim: int
    tangent: Array
    q: Array
    ends: int = 0
    cusp: bool = False
    multiple: bool = False
    """Whether the equations touch it: their Jacobian has a larger null space than the branch has
    dimensions (shaky)."""
    cone: bool = False
    """Whether the tangent spaces around the configuration have no limit: it is the tip of a cone,
    or of several."""


@dataclass(eq=False)
class Spot:
    """A sampled point of the solution set near the configuration: offsets (3, nv) at three radii."""

    offsets: Array
    split: Split
    dim: int | None = None
    tangent: Array | None = None
    near: Array | None = None
    """Basis of the null space on the smallest sphere."""
    obstructed: int | None = None
    """The first order at which null vectors there cannot be continued."""


@dataclass(eq=False)
class ConeFamily:
    """Sampled points of one branch on the largest sphere, with nearly equal null spaces."""

    spots: list[Spot]
    cone: bool = False
    hits: int = 1
    opposite: ConeFamily | None = None
    """The family on the other side of the configuration: what a curve through it is there."""

    @property
    def total_hits(self) -> int:
        """Number of random starts that led to this family, on either side of the configuration."""
        return self.hits + (0 if self.opposite in (None, self) else self.opposite.hits)

    def has_spot(self, spot: Spot) -> bool:
        """Return whether a sampled point belongs to this family."""
        first = self.spots[0]
        if first.split.delta != spot.split.delta:
            return False
        if first.split.delta == 1:
            return _are_same_point(first.offsets[0], spot.offsets[0])
        return measure_subspace_angle(first.split.null_space, spot.split.null_space) < SAME_PLANE

    def add_spot(self, spot: Spot, hits: int) -> None:
        """Add `hits` to the starts that led here, and keep the point if it is new.

        At most MOST_KEPT points are kept.
        """
        self.hits += hits
        if len(self.spots) < MOST_KEPT and not any(
            _are_same_point(s.offsets[0], spot.offsets[0]) for s in self.spots
        ):
            self.spots.append(spot)


def _are_same_point(x: Array, y: Array) -> bool:
    """Return whether two offsets (nv,) are of the same point."""
    d = x - y
    return float(d @ d) < (SAME_POINT * RADII[0]) ** 2


class SpherePoints(NamedTuple):
    """Points (n, nq) sought on a sphere, with offsets (n, nv) and Jacobians; `good`: found."""

    q: Array
    offsets: Array
    jacobian: Array
    good: np.ndarray


def find_sphere_points(
    equations: Equations, q: Array, directions: Array, radius: float
) -> SpherePoints:
    """Find points of the solution set at a distance from q, in directions (n, nv).

    First they are sought anywhere near: the equation of the sphere would lead many into a local
    minimum.
    """
    near = equations.project_points(equations.move_configurations(q, radius * directions), q)
    back = near.distance < FELL_BACK * radius
    x = np.where(
        back[:, None],
        directions,
        equations.compute_offsets(q, near.q) / np.maximum(near.distance, 1e-300)[:, None],
    )
    at = equations.project_points(equations.move_configurations(q, radius * x), q, radius)
    good = ~back & (at.residual < CLOSED) & (np.abs(at.distance - radius) < 1e-4 * radius)
    return SpherePoints(at.q, equations.compute_offsets(q, at.q), at.jacobian, good)


def find_cone_families(
    equations: Equations, at: Split, rng: np.random.Generator
) -> tuple[list[ConeFamily], bool]:
    """Find families of points on the largest sphere that can be followed to the smallest.

    Also returns whether all were hit twice.

    The part of the branches, by how often random starts lead to them, that was never hit is about
    the number of families hit once over the number of starts (Good, 1953): so the search ends when
    there is none hit that rarely. A curve is hit on either side, for the other side is looked for
    at once.
    """
    families: list[ConeFamily] = []
    starts = 0
    while starts < MOST_STARTS:
        d = lyapunov_schmidt.sample_unit_vectors(rng, BATCH, at.delta) @ at.null_space.T
        starts = starts + len(d)
        known = len(families)
        _sort_spots(equations, at, families, _find_spots(equations, at, d))
        _add_opposite_points(equations, at, families, families[known:])
        if starts >= 2 * BATCH and all(f.total_hits > ENOUGH for f in families):
            break
    followed = {
        id(s)
        for s in _follow_to_small_spheres(equations, at, [s for f in families for s in f.spots])
    }
    for family in families:
        family.spots = [s for s in family.spots if id(s) in followed]
    families = _join_families([f for f in families if f.spots])
    return families, all(f.total_hits > 1 for f in families)


def _add_opposite_points(
    equations: Equations, at: Split, families: list[ConeFamily], new: list[ConeFamily]
) -> None:
    """Add the points opposite to the first points of new families."""
    if not new:
        return
    shell = find_sphere_points(
        equations, at.q, np.array([-f.spots[0].offsets[0] / RADII[0] for f in new]), RADII[0]
    )
    for i in np.flatnonzero(shell.good):
        spot = Spot(
            shell.offsets[None, i], lyapunov_schmidt.split_jacobian(shell.q[i], shell.jacobian[i])
        )
        _sort_spots(equations, at, families, [spot], False)
        other = next((f for f in families if any(s is spot for s in f.spots)), None)
        other = other or next((f for f in families if not f.cone and f.has_spot(spot)), None)
        if other is not None:
            new[i].opposite, other.opposite = (
                other,
                new[i] if other.opposite is None else other.opposite,
            )


def _join_families(families: list[ConeFamily]) -> list[ConeFamily]:
    """Join families whose tangent spaces meet at the configuration.

    A bent branch seems to be several families.
    """
    out: list[ConeFamily] = []
    for family in families:
        near = family.spots[0].near
        for other in out:
            like = other.spots[0].near
            if near is None or like is None or family.cone or other.cone or near.shape[1] < 2:
                continue
            if measure_subspace_angle(near, like) < SAME_LIMIT:
                other.spots = (other.spots + family.spots)[:MOST_KEPT]
                other.hits = other.hits + family.hits
                break
        else:
            out.append(family)
    return out


def _find_spots(equations: Equations, at: Split, directions: Array) -> list[Spot]:
    """Find points on the largest sphere in directions (n, nv)."""
    shell = find_sphere_points(equations, at.q, directions, RADII[0])
    found = np.flatnonzero(shell.good)
    splits = lyapunov_schmidt.split_jacobians(shell.q[found], shell.jacobian[found])
    return [Spot(shell.offsets[None, i], split) for i, split in zip(found, splits, strict=True)]


def _sort_spots(
    equations: Equations,
    at: Split,
    families: list[ConeFamily],
    spots: list[Spot],
    counted: bool = True,
) -> None:
    """Sort points into the families that contain them, or new ones.

    All points of cones of one dimension are a family.
    """
    hit = int(counted)
    for spot in spots:
        held = next((f for f in families if not f.cone and f.has_spot(spot)), None)
        if held is None and spot.split.delta > 1 and _has_turning_null_space(equations, at, spot):
            held = next(
                (f for f in families if f.cone and f.spots[0].split.delta == spot.split.delta), None
            )
            if held is None:
                families.append(ConeFamily([spot], cone=True, hits=hit))
                continue
        if held is None:
            families.append(ConeFamily([spot], hits=hit))
        else:
            held.add_spot(spot, hit)


def _has_turning_null_space(equations: Equations, at: Split, spot: Spot) -> bool:
    """Return whether the null space turns along the sphere.

    It does not turn on a branch that has a tangent space.
    """
    x = spot.offsets[0] / RADII[0]
    K = spot.split.null_space
    along = K @ lyapunov_schmidt.sample_axes(np.random.default_rng(0), K.shape[1]).T
    along -= x[:, None] * (x @ along)
    d = x + ALONG * along.T / np.maximum(np.linalg.norm(along, axis=0), 1e-3)[:, None]
    shell = find_sphere_points(
        equations, at.q, d / np.linalg.norm(d, axis=1, keepdims=True), RADII[0]
    )
    spaces = (
        x.null_space
        for x in lyapunov_schmidt.split_jacobians(shell.q[shell.good], shell.jacobian[shell.good])
    )
    return any(measure_subspace_angle(K, k) > TURNED for k in spaces if k.shape == K.shape)


def _follow_to_small_spheres(equations: Equations, at: Split, spots: list[Spot]) -> list[Spot]:
    """Follow points to the smaller spheres; return those that can be followed, with offsets."""
    for before, radius in zip(RADII, RADII[1:], strict=False):
        if not spots:
            break
        d = np.array([s.offsets[-1] for s in spots]) / before
        shell = find_sphere_points(equations, at.q, d, radius)
        good = shell.good & (np.linalg.norm(shell.offsets / radius - d, axis=1) < 0.5)
        splits = lyapunov_schmidt.split_jacobians(shell.q, shell.jacobian)
        for i, spot in enumerate(spots):
            spot.offsets = np.concatenate([spot.offsets, shell.offsets[None, i]])
            spot.near = splits[i].null_space if good[i] else None
        spots = [s for s, ok in zip(spots, good, strict=True) if ok]
    return spots


def measure_subspace_angle(a: Array, b: Array) -> float:
    """Measure the angle between subspaces with orthonormal bases (nv, k).

    It is the root sum square of the sines of the principal angles.
    """
    if a.shape != b.shape:
        return np.inf
    d = (a - b @ (b.T @ a)).ravel()
    return float(np.sqrt(d @ d))


def measure_spot(equations: Equations, spot: Spot, order: int, rng: np.random.Generator) -> bool:
    """Find dimension and tangent space of the solution set at a point of a branch.

    Returns whether two methods agree.
    """
    at = spot.split
    spot.dim = at.delta
    spot.tangent = at.null_space
    if at.corank == 0 or at.delta == 0:
        return True
    k = lyapunov_schmidt.measure_obstruction(equations, at, order, rng).order
    if k is None:
        return True
    spot.obstructed = k
    spot.dim, spot.tangent = measure_solution_span(
        equations, at.q, at.null_space, STEP * RADII[0], rng
    )
    return k > 1 and lyapunov_schmidt.find_lineality(equations, at, k, rng).shape[1] == spot.dim


def measure_solution_span(
    equations: Equations, q: Array, basis: Array, radius: float, rng: np.random.Generator
) -> tuple[int, Array]:
    """Find the dimension spanned by points of the solution set at a distance from q.

    They are sought along `basis` (nv, k).
    """
    shell = find_sphere_points(
        equations, q, lyapunov_schmidt.sample_axes(rng, basis.shape[1]) @ basis.T, radius
    )
    return compute_span(shell.offsets[shell.good] / radius)


def compute_span(x: Array) -> tuple[int, Array]:
    """Compute dimension and basis (nv, dim) of the span of vectors (n, nv) of about unit length."""
    if not len(x):
        return 0, np.zeros((x.shape[1], 0))
    basis = Spectrum(x, 1.0).compute_row_space(SPREAD)
    return basis.shape[1], basis


def measure_families(
    equations: Equations, families: list[ConeFamily], order: int, rng: np.random.Generator
) -> bool:
    """Find dimensions and tangent spaces of all points, and split families with several branches.

    Says whether the ways to find the dimension, and points where equations are smooth, agree.
    """
    sound = True
    out = list[ConeFamily]()
    for family in families:
        spots = family.spots
        for spot in spots:
            if spot.split.corank == 0:
                spot.dim = spot.split.delta
                spot.tangent = spot.split.null_space
        rest = [s for s in spots if s.dim is None]
        for spot in rest[:2]:
            sound &= measure_spot(equations, spot, order, rng)
        shaky = any(s.obstructed is not None for s in rest[:2])
        for i, spot in enumerate(rest[2:], 2):
            like = (
                next((s for s in rest[:i] if _is_in_tangent_space(spot, s)), None)
                if shaky and not family.cone
                else rest[0]
            )
            if like is None:
                sound &= measure_spot(equations, spot, order, rng)
            else:
                spot.dim = like.dim
                spot.tangent = like.tangent if shaky else spot.split.null_space
        parts = _split_family(family)
        sound &= shaky or len(parts) == 1
        out += parts if shaky else [family]
    families[:] = out
    return sound


def _is_in_tangent_space(spot: Spot, other: Spot) -> bool:
    """Return whether a point lies in the tangent space of another point's branch.

    The branch has two or more dimensions.
    """
    T = other.tangent
    x = spot.offsets[0] / RADII[0]
    return (
        T is not None and T.shape[1] > 1 and float(np.linalg.norm(x - T @ (T.T @ x))) < SAME_PLANE
    )


def _are_on_one_branch(a: Array | None, b: Array | None) -> bool:
    """Return whether tangent spaces may belong to one branch; those of curves always may."""
    return a is None or b is None or a.shape[1] < 2 or measure_subspace_angle(a, b) < SAME_PLANE


def _split_family(family: ConeFamily) -> list[ConeFamily]:
    """Split a family by dimension and tangent space.

    Where it is shaky, branches that meet can have the same null space.
    """
    parts: list[ConeFamily] = []
    for spot in family.spots:
        for part in parts:
            first = part.spots[0]
            if first.dim == spot.dim and (
                family.cone or _are_on_one_branch(first.tangent, spot.tangent)
            ):
                part.spots.append(spot)
                break
        else:
            parts.append(ConeFamily([spot], family.cone, family.hits))
    return parts


def are_branches_shaky(equations: Equations, at: Split, families: list[ConeFamily]) -> bool:
    """Return whether branches that are shaky near the configuration are so farther out.

    Two branches that touch closely look like one with multiplicity on small spheres; farther out
    they part.
    """
    shaky = [
        f.spots[0]
        for f in families
        if (f.spots[0].dim or 0) < f.spots[0].split.delta and f.spots[0].dim
    ]
    if not shaky:
        return True
    shell = find_sphere_points(
        equations, at.q, np.array([s.offsets[0] for s in shaky]) / RADII[0], FAR
    )
    deltas = [lyapunov_schmidt.split_jacobian(at.q, J).delta for J in shell.jacobian]
    return all(d >= s.split.delta for s, d, ok in zip(shaky, deltas, shell.good, strict=True) if ok)


def collect_branches(equations: Equations, families: list[ConeFamily]) -> tuple[list[Branch], bool]:
    """Collect the branches of the points; also whether curves come in pairs of half-branches."""
    out: list[Branch] = []
    for family in sorted(families, key=lambda f: -(f.spots[0].dim or 0)):
        spot = family.spots[0]
        T = spot.tangent
        if T is None or T.shape[1] < 2:
            continue
        if family.cone or not any(
            b.dim == spot.dim and measure_subspace_angle(b.tangent, T) < SAME_PLANE for b in out
        ):
            shaky = spot.split.delta > T.shape[1]
            out.append(Branch(T.shape[1], T, spot.split.q, multiple=shaky, cone=family.cone))
    curves, paired = _pair_half_branches([s for f in families for s in f.spots if s.dim == 1])
    return [replace(b, tangent=b.tangent * equations.scale[:, None]) for b in out + curves], paired


def _pair_half_branches(halves: list[Spot]) -> tuple[list[Branch], bool]:
    """Pair half-branches into curves through the configuration with continuous direction and bend."""
    h = np.array(RADII)
    rays: list[tuple[Array, Array, Spot]] = []
    for s in _drop_repeated_halves(halves):
        u = s.offsets / h[:, None]
        t = u[2] - (u[1] - u[2]) * h[2] / (h[1] - h[2])
        rays.append((t / np.linalg.norm(t), (u[1] - u[2]) / (h[1] - h[2]), s))
    left = list(range(len(rays)))
    out: list[Branch] = []

    def compute_cost(i: int, j: int, sign: float) -> float:
        """Compute the mismatch of direction and bend of two half-branches."""
        return float(
            np.linalg.norm(rays[i][0] + sign * rays[j][0])
            + h[1] * np.linalg.norm(rays[i][1] - rays[j][1])
        )

    for sign in (1.0, -1.0):  # first those that go through, then cusps
        pairs = sorted((compute_cost(i, j, sign), i, j) for i in left for j in left if i < j)
        for c, i, j in pairs:
            if c < 0.3 and i in left and j in left:
                left = [k for k in left if k not in (i, j)]
                out.append(_make_curve(rays[i], 2, sign < 0.0))
    out += [_make_curve(rays[i], 1, False) for i in left]
    return out, not left


def _drop_repeated_halves(halves: list[Spot]) -> list[Spot]:
    """Drop half-branches that repeat another one.

    Where they are shaky, points are known to few digits.
    """
    out: list[Spot] = []
    for s in halves:
        shaky = [o for o in out if min(s.split.delta, o.split.delta) > 1]
        if not any(np.linalg.norm(s.offsets[0] - o.offsets[0]) < BLURRED * RADII[0] for o in shaky):
            out.append(s)
    return out


def _make_curve(ray: tuple[Array, Array, Spot], ends: int, cusp: bool) -> Branch:
    """Make a branch of dimension one."""
    t, _, spot = ray
    return Branch(1, t[:, None], spot.split.q, ends, cusp, spot.split.delta > 1)


# ---- the local dimension

# The rank of the constraint Jacobian gives an upper bound only. Where equations are dependent, the
# reduction of Lyapunov and Schmidt tells by Taylor coefficients whether null vectors are velocities
# of motions; where not all are, the branches are found on small spheres, and what they are is
# measured at their own points.
#
# Kicking the mechanism and letting it snap back is a second method that shares nothing with the
# first but equations and projection. Neither proves a number; where a theorem does
# (`kempe.mobility.dof_proofs`), the answer is certain. Joint limits do not count.

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
    """The true number of degrees of freedom at a configuration, and the test that gave it.

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
                    [
                        "branches: " + ", ".join(_describe_branch(b) for b in self.branches),
                        *self.more,
                    ]
                )
            )
        return "; ".join([*text, *([f"proven: {self.proof}"] if self.proof else []), *self.doubts])


def _describe_branch(branch: Branch) -> str:
    """Describe a branch in words."""
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


def find_local_dimension(
    system: Model,
    q: Any,
    *,
    order: int = 8,
    rng: np.random.Generator | int = 0,
    tolerance: float = Level.GENERIC,
    sampling: bool = True,
    time: TimeLimit | None = None,
) -> LocalDimension:
    """Find the true number of degrees of freedom at a closed configuration, and its branches.

    `q` (nq,) or a dict by coordinate name must be closed; `order` is that of the Taylor
    coefficients, `tolerance` the part of the largest singular value below which one counts as zero;
    `sampling=False` leaves out the second method, which is used wherever no theorem decides. After
    the `time` of the call `TimeUp` is raised.
    Where three angles of a ball joint are singular coordinates, tangents are in rates of angles
    measured from there. Errors: `InputError` for an open configuration.

    >>> import kempe
    >>> system = kempe.load("parallelogram")
    >>> flat = find_local_dimension(system, system.q("flat"))
    >>> flat.rank_dim, flat.dim, flat.branch_dims
    (2, 1, (1, 1))
    """
    q = read_q(system, q)
    if q.ndim != 1:
        raise InputError(
            f"q has shape {q.shape}; the local dimension is found at one configuration (nq,)"
        )
    if not isinstance(order, (int, np.integer)) or not 2 <= order <= 16:
        raise InputError(f"order is {order!r}; it must be a whole number from 2 to 16")
    if not 0.0 < tolerance < 1.0:
        raise InputError(
            f"tolerance is {tolerance!r}; it must be a part of one, such as {Level.GENERIC:g}"
        )
    other, there, turned = make_regular_chart(remove_cut_marks(system), q)
    rng = np.random.default_rng(rng)
    return convert_to_system(
        system, _analyze_configuration(other, there, order, rng, tolerance, sampling, time), turned
    )


def convert_to_system(
    system: Model, found: LocalDimension, turned: dict[str, Array]
) -> LocalDimension:
    """Convert the configurations of an answer to the coordinates of the system itself."""
    if not turned:
        return found
    own = tuple(replace(b, q=convert_from_chart(system, b.q, turned)) for b in found.branches)
    return replace(found, branches=own, q=convert_from_chart(system, found.q, turned))


def _analyze_configuration(
    system: Model,
    q: Array,
    order: int,
    rng: np.random.Generator,
    tolerance: float,
    sampling: bool,
    time: TimeLimit | None,
) -> LocalDimension:
    """Find the local dimension at a configuration whose coordinates are regular."""
    equations = _get_equations(system)
    # the equations are kept with the system, and other calls have other limits
    if time is not None:
        equations = copy(equations)
        equations.time = time
    at = lyapunov_schmidt.split_equations(
        equations, _correct_configuration(equations, q), tolerance
    )
    prover = Prover(system, equations, at.q)
    proof = prover.prove_manifold()
    doubts = _list_rank_doubts(at)
    more: list[str] = []
    if at.corank == 0 or at.delta == 0 or (proof is not None and proof.dim == at.delta):
        why = "the equations are independent: a manifold by the implicit function theorem"
        if at.corank and at.delta:
            why = "a manifold, though some equations depend on others"
        if at.delta == 0:
            why = "the Jacobian has no null space: rigid, to first order"
        whole = [_make_manifold_branch(equations, at)]
        return _make_answer(
            at, order, tolerance, whole, True, None, why, (doubts, more), None, proof
        )
    found = lyapunov_schmidt.measure_obstruction(equations, at, order, rng)
    k = found.order
    if found.doubt:
        doubts.append(f"a Taylor coefficient {found.doubt:.1g} is neither zero nor clearly not")
    if k is None:
        found = [_make_manifold_branch(equations, at)]
        smooth = True
        why = (
            f"no velocity is obstructed to order {order} (coefficients below "
            f"{lyapunov_schmidt.ZERO:g})"
        )
        why += ": a manifold, to that order"
        reached, faded = _follow_motion(equations, at, rng) if sampling else (0.0, False)
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
        found = _find_branches(equations, at, order, rng, doubts, more)
        smooth = False
        why = (
            f"some velocities are obstructed at order {k}; branches followed on spheres of radius "
            f"{RADII[0]:g}"
        )
    if proof is None and k is not None:
        proof = prover.prove_dimension(order, [b.tangent / equations.scale[:, None] for b in found])
    sampled = None
    if sampling:
        sampled = sample_dimension(equations, at, rng)
        truth = max((b.dim for b in found), default=0)
        if sampled != truth:
            doubts.append(f"sampling finds dimension {sampled}, following branches {truth}")
    return _make_answer(at, order, tolerance, found, smooth, k, why, (doubts, more), sampled, proof)


def _list_rank_doubts(at: Split) -> list[str]:
    """List the doubts about the rank."""
    if at.gap < CLEAR_GAP:
        return [f"singular values differ by a factor {at.gap:.1g} only across the rank"]
    rest = (
        float(at.sigma[at.rank]) / max(float(at.sigma[0]), lyapunov_schmidt.LEAST)
        if at.rank < len(at.sigma)
        else 0.0
    )
    if rest > ROUNDING:
        return [
            f"a singular value of {rest:.1g} of the largest is taken as zero, but may be more than "
            "rounding"
        ]
    return []


@keep_answers
def _get_equations(system: Model) -> Equations:
    """Return the packed equations of a system."""
    return Equations(system)


def _correct_configuration(equations: Equations, q: Array) -> Array:
    """Correct the last digits of a closed configuration.

    Errors: `InputError` where it is open.
    """
    value = equations.linearise_equations(q)[0][0]
    if value.size and not np.max(np.abs(value)) < OPEN:
        name, row = equations.names[int(np.nanargmax(np.abs(np.nan_to_num(value, nan=np.inf))))]
        raise InputError(
            f"the configuration is open: {name!r} ({row}) by {np.max(np.abs(value)):.2g} (radians, "
            "or typical lengths of a link); close it with assemble first"
        )
    if value.size and np.linalg.norm(value) > 1e-13:
        better = equations.project_points(q, q)
        q = better.q[0] if better.residual[0] < np.linalg.norm(value) else q
    return q


def _make_manifold_branch(equations: Equations, at: Split) -> Branch:
    """Make the only branch of a manifold."""
    return Branch(
        at.delta, at.null_space * equations.scale[:, None], at.q, 2 if at.delta == 1 else 0
    )


def _find_branches(
    equations: Equations,
    at: Split,
    order: int,
    rng: np.random.Generator,
    doubts: list[str],
    more: list[str],
) -> list[Branch]:
    """Find the branches by points on spheres; adds `doubts` and reasons for `more` branches."""
    families, complete = find_cone_families(equations, at, rng)
    if not complete:
        more.append(
            f"some were hit once only in {MOST_STARTS} starts, so there may be more branches"
        )
    if not measure_families(equations, families, order, rng):
        doubts.append("points of one branch differ in dimension")
    if not are_branches_shaky(equations, at, families):
        more.append("a branch is shaky near the configuration only, so several may nearly coincide")
    worst = max((s.obstructed or 0 for f in families for s in f.spots), default=0)
    if worst > 2:
        doubts.append(
            f"a branch is shaky of order {worst - 1} all along: its points are found to a few "
            "digits only"
        )
    found, paired = collect_branches(equations, families)
    if not paired:
        more.append("a half-branch was found without its other half, so some branches were missed")
    return found


def _make_answer(
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
    """Make the answer, with doubts about its number and about that of its branches."""
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


def _follow_motion(equations: Equations, at: Split, rng: np.random.Generator) -> tuple[float, bool]:
    """Follow a motion along the null space on growing spheres.

    Returns the distance reached, and whether the motion is seen to end there.

    Points are sought on spheres about the configuration, which may be singular: there a curve has no
    tangent, and the tracer of `kempe.numerics.curves` no first step.
    The direction is random, the distance at most 1, in radians and characteristic lengths. True
    means that the residual there is small but not zero: there is no finite motion, the loops only
    seem to close near the configuration.
    """
    x = lyapunov_schmidt.sample_axes(rng, at.delta) @ at.null_space.T
    reached = 0.0
    for radius in WALK:
        found = equations.project_points(
            equations.move_configurations(at.q, radius * x), at.q, radius
        )
        left = np.hypot(found.residual, found.distance - radius)
        good = left < CLOSED
        if not good.any():
            return (radius, True) if left.min() < FAINT else (reached, False)
        reached = radius
        x = equations.compute_offsets(at.q, found.q[good]) / radius
    return reached, False


def sample_dimension(equations: Equations, at: Split, rng: np.random.Generator) -> int:
    """Sample the dimension by random steps along the null space that are projected back.

    Steps in directions without a motion shrink to about the root of the residual; those along
    motions keep their size.
    """
    count = 10 + 2 * min(at.delta, 10)
    kicks = KICK * lyapunov_schmidt.sample_unit_vectors(rng, count, at.delta) @ at.null_space.T
    found = equations.project_points(equations.move_configurations(at.q, kicks), at.q)
    good = (
        (found.residual < CLOSED) & (found.distance > STAYS * KICK) & (found.distance < 2.0 * KICK)
    )
    if not good.any():
        return 0
    places: list[Split] = []
    for here in lyapunov_schmidt.split_jacobians(found.q[good], found.jacobian[good]):
        if all(
            measure_subspace_angle(here.null_space, other.null_space) > SAME_PLANE
            for other in places
        ):
            places.append(here)
    return max(_sample_dimension_around(equations, p, rng) for p in places[:6])


def _sample_dimension_around(equations: Equations, at: Split, rng: np.random.Generator) -> int:
    """Sample the dimension around a point of the solution set with two sizes of steps.

    The smaller result is returned.

    Both can see too much: large ones because the set is bent, small ones because what collapses
    leaves a rest.
    """
    d = lyapunov_schmidt.sample_axes(rng, at.delta)
    seen: list[int] = []
    for size in SMALL_KICKS:
        found = equations.project_points(
            equations.move_configurations(at.q, size * d @ at.null_space.T), at.q
        )
        x = equations.compute_offsets(at.q, found.q[found.residual < CLOSED]) / size
        sigma = Spectrum(x).values / np.sqrt(max(len(x), 1))
        seen.append(int(np.sum(sigma > STAYS / np.sqrt(max(at.delta, 1)))))
    return min(seen)
