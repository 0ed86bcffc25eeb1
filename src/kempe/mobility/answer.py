"""The answer of `mobility`: degrees of freedom, and their wording as sentence, report and data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import explain_method_errors
from kempe.errors import InputError
from kempe.first_order.constraint_graph import NO_SERIES
from kempe.first_order.control import Control
from kempe.first_order.counting import Counting, LoopCount
from kempe.first_order.idle_freedoms import IdleFreedom
from kempe.first_order.rank import Rank
from kempe.first_order.redundant_constraints import Redundancy
from kempe.first_order.wrenches import Wrenches
from kempe.mobility.one_sided import OneSidedReport
from kempe.model.configurations import compute_mid_configuration, name_values
from kempe.report import Nearest, Report
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import choose_verb, cut_lines, format_count, join_first_words

if TYPE_CHECKING:
    from kempe.mobility.local_dimension import LocalDimension
    from kempe.mobility.relative_motion import RelativeMotion
    from kempe.model.model import FrameLike, Model


# ---- the answer in words

FEW = 4
"""Branches whose dimensions are listed one by one."""
SHOWN = 12
"""Loops, clusters and idle freedoms that are listed one by one."""


def describe_mobility(m: Mobility) -> str:
    """Describe the mobility in one sentence: the count, the true number, and why they differ."""
    count = f"Grübler count: {m.gruebler}"
    if m.late and m.rank is None:
        return f"degrees of freedom unknown ({count}): {m.why_open}"
    if not m.closed:
        return (
            f"degrees of freedom unknown ({count}): the mechanism cannot be closed here (residual "
            f"{m.residual:.2g}){f'; {m.why_open}' if m.why_open else ''}"
        )
    if m.dof is None:
        why_not = "the time limit came" if m.late else "not tested further"
        most = format_count(m.rank_dof or 0, "degree")
        return f"at most {most} of freedom, by the rank ({count}; {why_not})"
    false = max((m.generic_rank_dof or 0) - m.dof, 0)
    why: list[str] = []
    if (m.redundant or 0) > false:
        some = f", {false} of them to first order only" if false else ""
        why.append(f"{format_count(m.redundant or 0, 'redundant constraint')}{some}")
    if m.local is not None and len({b.dim for b in m.local.branches}) > 1:
        meet = "that meet here" if m.local.counted else "found here"
        why.append(
            f"the largest of {len(m.local.branches)} branches {meet} has "
            f"{format_count(m.dof, 'dimension')}"
        )
    doubtful = (
        m.local is None
        or m.local.doubts
        or m.local.more
        or (m.rank is not None and m.rank.doubtful)
    )
    sure = "probably " if not m.certain and doubtful or m.within is not None else ""
    order = (
        "" if m.certain or m.local is None or m.within is not None else f" to order {m.local.order}"
    )
    rank = (
        _describe_false_freedoms(m.generic_rank_dof or 0, false, m.generic_rank_dof != m.rank_dof)
        if false
        else ""
    )
    least = "" if m.within is None else f" {m.within.least}"
    exactly = "" if m.within is None else f"; {m.within.exactly}"
    freedoms = f"{sure}{format_count(m.dof, 'degree')} of freedom{order}{least}"
    return f"{freedoms} ({'; '.join([count, *why])}){rank}{exactly}{m.hint}"


def _describe_false_freedoms(rank: int, false: int, nearby: bool) -> str:
    """Describe the freedoms of the rank that lead to no motion."""
    where = " at configurations nearby" if nearby else ""
    if rank == false == 1:
        return f"; the rank says 1{where}, a velocity that leads to no motion"
    verb = "is a velocity that leads" if false == 1 else "are velocities that lead"
    return (
        f"; the rank says {rank}{where}, but {'all' if false == rank else false} of these {verb} "
        "to no motion"
    )


def describe_evidence(m: Mobility) -> str:
    """Describe the test that gave the true number of freedoms, with its tolerance."""
    if m.rank is None or m.dof is None:
        return ""
    if m.local is not None:
        order = f"; known to order {m.local.order} of the Taylor series, not proven"
        sure = f"; proven: {m.local.proof}" if m.local.certain else order
        sure += "".join(f"; {doubt}" for doubt in m.local.doubts)
        sampled = "" if m.local.sampled is None else f"; sampling agrees: {m.local.sampled}"
        if m.local.sampled is not None and m.local.sampled != m.local.dim:
            sampled = ""
        return f"{m.local.method}{sampled}{sure}"
    if not m.loops and not m.rank.clusters:
        return _describe_tree_freedoms(m)
    unsure = "" if m.certain else f"; not proven: {m.unproven}"
    if not m.rank.n_dependent:
        why = (
            "all constraints are independent here, so the configurations are a manifold (implicit "
            "function theorem)"
        )
        return why + unsure
    return "no velocity keeps all loops closed: rigid" + unsure


def _describe_tree_freedoms(m: Mobility) -> str:
    """Describe why a tree without constraints of position has the freedoms of its coordinates."""
    followers = [
        f"{name!r} follows {coupling.source!r}"
        for name, coupling in m.system.structure.couplings.items()
        if coupling.source
    ]
    said = f"no loops; {join_first_words(followers, 3)}" if followers else "no loops"
    if m.velocity_dof is not None:
        return f"{said}; constraints of velocity leave all positions possible"
    return f"{said}{'; all other' if followers else ': all'} joints move independently"


def format_rank(m: Mobility) -> str:
    """Format the rank with its gap, and whether it is beyond doubt."""
    r = m.rank
    if r is None:
        return ""
    equations = sum(len(c.jacobian) for c in r.clusters)
    if not equations:
        return (
            f"{format_count(len(r.units), 'coordinate')}, no equations: "
            f"{format_count(r.nullity, 'freedom')}"
        )
    many = format_count(len(r.units), "coordinate")
    left = format_count(r.nullity, "freedom")
    text = f"{many} - rank {r.rank} of {format_count(equations, 'equation')} = {left}"
    text += " to first order"
    gap = (
        "" if r.gap == float("inf") else f" (singular values fall by a factor of {r.gap:.1g} there)"
    )
    if r.doubtful:
        gap += (
            f"; doubtful: the smallest that counts is {r.smallest_counted_value:.1g} of the largest, {r.gap:.1g} "
            "times the next"
        )
        gap += ", which is not clearly zero" if r.largest_neglected_value > 1e-8 else ""
    elif r.smallest_counted_value < 1e-4:
        gap += (
            f"; close to a singular configuration: the smallest that counts is {r.smallest_counted_value:.1g} of "
            "the largest"
        )
    if m.generic_rank_dof != m.rank_dof:
        gap += f"; {m.generic_rank_dof} at other configurations nearby"
    return text + gap


def _describe_velocity_freedoms(m: Mobility) -> list[str]:
    """Describe freedoms of position and of velocity, if there are constraints of velocity."""
    if m.velocity_dof is None or m.rank_dof is None:
        return []
    if m.velocity_dof < 0:
        return [
            "no velocity satisfies all constraints of velocity here: they contradict each other"
        ]
    taken = m.rank_dof - m.velocity_dof
    return [
        f"{format_count(m.rank_dof, 'freedom')} of position, {m.velocity_dof} of velocity: "
        f"constraints of velocity take {taken} of them at every moment; what motions reach all the "
        "same says `classify`"
    ]


def _describe_closing(m: Mobility) -> str:
    """Describe from which open configuration the closed one comes."""
    if not m.searched:
        return f"given with residual {m.given_residual:.2g}; this is the nearest closed one"
    if "closed" in m.system.structure.posture_names:
        first = "the posture 'closed'"
    else:
        middle = compute_mid_configuration(m.system)
        first = (
            "all zeros" if np.array_equal(middle, m.system.neutral) else "the middle of the limits"
        )
    return f"no q was given: this is the closed one found from {first}"


def list_topics(m: Mobility) -> list[tuple[str, list[str]]]:
    """List the topics of the report as (title, lines)."""
    out = [("count", list(m.counting.steps))]
    if m.dim == 2 and m.gruebler_spatial != m.gruebler:
        out[0][1].append(f"Built in space, the same count is {m.gruebler_spatial}.")
    if m.loops:
        out.append(("loops", cut_lines([str(x) for x in m.loops], SHOWN)))
    if len(m.clusters) > 1:
        out.append(
            ("groups of loops", cut_lines([_describe_cluster(c) for c in m.clusters], SHOWN))
        )
    if not m.closed:
        return out
    if m.given_residual > 1e-9:
        out.append(
            (
                "closed",
                [_describe_closing(m)],
            )
        )
    if m.within is not None:
        out.append(("within", cut_lines(m.within.lines, SHOWN)))
    out.append(("rank", [format_rank(m)]))
    if m.dof is not None:
        useful = f", {m.useful or 'none'} of them useful" if m.idle else ""
        useful = ", which is idle" if m.idle == m.dof == 1 else useful
        out.append(
            ("truth", [f"{format_count(m.dof, 'degree')} of freedom{useful}", describe_evidence(m)])
        )
    if m.velocity_dof is not None:
        out.append(("velocity", _describe_velocity_freedoms(m)))
    if m.called:
        who = f"constraint {m.called[0]!r} {NO_SERIES}: what is singular here may be redundant"
        out.append(("truth", ["not known", who]))
    if m.redundancy is not None and m.redundancy.number:
        out.append(("redundant", [*str(m.redundancy).split("\n")]))
        if m.dof is not None and (m.generic_rank_dof or 0) > m.dof:
            out[-1][1].append(
                "redundant to first order only: such a release would set something free"
            )
    if m.redundant_here and m.wrenches is not None:
        out.append(("self-stress", m.wrenches.describe_stresses()))
    if m.idle:
        out.append((f"idle: {m.idle}", cut_lines([str(f) for f in m.idle_freedoms], SHOWN)))
    if m.singular:
        out.append(("singular", [m.kind]))
    if m.one_sided is not None:
        out.append(("one-sided", cut_lines([m.one_sided.sentence, *m.one_sided.lines], SHOWN)))
    if m.control is not None:
        out.append(("control", str(m.control).split("\n")))
        if m.dof is not None and (m.rank_dof or 0) > m.dof:
            seen = format_count(m.rank_dof or 0, "freedom")
            out[-1][1].append(
                f"counted to first order, where the rank sees {seen}; truly {_format_there_are(m.dof)}"
            )
    return out


def collect_data(m: Mobility) -> dict[str, Any]:
    """Collect all numbers and texts as plain Python, ready for JSON."""
    r = m.rank
    local = m.local
    c = m.control
    return {
        "system": m.name,
        "dim": m.dim,
        "q": name_values(m.system, m.q),
        "closed": m.closed,
        "residual": m.residual,
        "given_residual": m.given_residual,
        "dof": m.dof,
        "useful": m.useful,
        "idle": m.idle,
        "gruebler": m.gruebler,
        "gruebler_spatial": m.gruebler_spatial,
        "rank_dof": m.rank_dof,
        "velocity_dof": m.velocity_dof,
        "within": None if m.within is None else m.within.data(),
        "generic_rank_dof": m.generic_rank_dof,
        "redundant": m.redundant,
        "redundant_here": m.redundant_here,
        "singular": m.singular,
        "kind": m.kind,
        "certain": m.certain,
        "how": describe_evidence(m),
        "gap": None if r is None or r.gap == float("inf") else r.gap,
        "counting": list(m.counting.steps),
        "loops": [
            {
                "name": x.name,
                "joints": list(x.joints),
                "freedoms": x.freedoms,
                "equations": x.equations,
                "count": x.count,
                "motion": x.motion,
            }
            for x in m.loops
        ],
        "clusters": [
            {
                "joints": list(x.joints),
                "loops": list(x.loops),
                "gruebler": x.gruebler,
                "rank_dof": x.rank_dof,
                "redundant": x.redundant,
            }
            for x in m.clusters
        ],
        "branches": None if local is None else [b.dim for b in local.branches],
        "releases": []
        if m.redundancy is None
        else [
            {"joint": x.joint, "reactions": list(x.reactions), "pair": x.pair}
            for x in m.redundancy.releases
        ],
        "stressed": {} if m.redundancy is None else {k: list(v) for k, v in m.redundancy.stressed},
        "self_stress": []
        if not m.redundant_here or m.wrenches is None
        else m.wrenches.export_stresses(),
        "idle_freedoms": [
            {
                "bodies": list(f.bodies),
                "joints": list(f.joints),
                "point": list(f.point),
                "direction": list(f.direction),
            }
            for f in m.idle_freedoms
        ],
        "one_sided": None if m.one_sided is None else m.one_sided._collect_data(),
        "control": None
        if c is None
        else {
            "actuated": list(c.actuated),
            "useful": c.useful,
            "controlled": c.controlled,
            "excess": c.excess,
            "singular": c.singular,
            "complete": c.complete,
            "free": [dict(f) for f in c.free],
        },
    }


def _describe_cluster(c: Any) -> str:
    """Describe a group of loops: its joints, count, rank and redundancy."""
    name = ", ".join(c.joints[:SHOWN]) + (", ..." if len(c.joints) > SHOWN else "")
    known = "" if c.rank_dof is None else f", by rank {c.rank_dof}"
    known += f", {c.redundant} redundant" if c.redundant else ""
    return f"{name}: count {c.gruebler}{known}"


def format_dimensions(dims: Sequence[int]) -> str:
    """Format dimensions of branches: '2, 1, 1', or '2 (5 times), 1 (8 times)' for many."""
    if len(dims) <= FEW:
        return ", ".join(str(d) for d in dims)
    return ", ".join(str(d) if n == 1 else f"{d} ({n} times)" for d, n in Counter(dims).items())


def _format_there_are(n: int) -> str:
    """Return "there is 1" or "there are n"."""
    return f"there is {n}" if n == 1 else f"there are {n}"


# ---- the answer


@dataclass(frozen=True)
class ClusterMobility:
    """A group of loops that share joints: its joints, loops, count, rank DoF and redundancy.

    `rank_dof` and `redundant` are None where the mechanism is open.
    """

    joints: tuple[str, ...]
    loops: tuple[str, ...]
    gruebler: int
    rank_dof: int | None
    redundant: int | None


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Mobility(Report):
    """Degrees of freedom of a mechanism at a configuration; printed, with the reasoning.

    Attributes
    ----------
    gruebler
        Grübler count.
    rank_dof, generic_rank_dof
        Nullity of the loop equations at `q`, and its minimum at other configurations nearby.
    dof
        Exact local number: dimension of the set of closed configurations at `q`. None if it was not
        requested, or if the mechanism cannot be closed.
    redundant, redundant_here
        Numbers of constraints that depend on others to first order, at generic configurations and
        at `q`.
    idle, useful
        Numbers of freedoms that transmit nothing, and of all others.
    singular, kind
        Whether `q` is a singular point of the configuration space, and of which kind.
    certain
        Whether `dof` is proven.
    late
        Whether the time limit ended the work.
    """

    _has_angles = True
    system: Model
    dim: int
    q: Array
    closed: bool
    residual: float
    given_residual: float
    why_open: str
    counting: Counting
    loops: tuple[LoopCount, ...]
    clusters: tuple[ClusterMobility, ...]
    outside: int
    rank: Rank | None
    generic_rank_dof: int | None
    local: LocalDimension | None
    dof: int | None
    redundancy: Redundancy | None
    idle_freedoms: tuple[IdleFreedom, ...]
    control: Control | None
    singular: bool | None
    kind: str
    velocity_dof: int | None = None
    """Freedoms of velocity at `q`: what constraints of velocity leave of `rank_dof`; None without
    such constraints."""
    regular: bool = False
    """Whether the rank is full beyond rounding, so that the implicit function theorem gives
    `dof`."""
    one_sided: OneSidedReport | None = None
    """What one-sided constraints are closed and still allow; None where there are none but limits
    that are not reached.

    The freedoms above do not count them: a side that is open takes nothing away, a closed one only
    a direction.
    """
    called: tuple[str, ...] = ()
    """Constraints that are functions without series, because of which `dof` is not known."""
    wrenches: Wrenches | None = None
    """What joints and constraints transmit at `q`, their self-stresses among it; None where it
    cannot be closed."""
    within: Nearest | None = None
    """The nearest mechanism that closes exactly, whose freedoms these are; None: those of the given
    one."""

    late: bool = False
    """Whether the time limit came before the true number was known."""
    searched: bool = False
    """Whether no configuration was given."""
    hint: str = ""
    """What may have been meant: joints that coincide at `q`, or a mechanism nearby that moves."""

    @property
    def name(self) -> str:
        """The name of the system."""
        return self.system.name

    @property
    def gruebler(self) -> int:
        """Grübler count: freedoms of all bodies minus those that joints and constraints remove."""
        return self.counting.gruebler

    @property
    def gruebler_spatial(self) -> int:
        """Grübler count of the mechanism built in space.

        For a planar one each loop has three more equations there.
        """
        return self.counting.gruebler_spatial

    @property
    def rank_dof(self) -> int | None:
        """Freedoms to first order at `q`: coordinates less the rank of the loop equations."""
        return None if self.rank is None else self.rank.nullity

    @property
    def redundant(self) -> int | None:
        """Number of redundant constraints at generic configurations of this branch."""
        return None if self.generic_rank_dof is None else self.generic_rank_dof - self.gruebler

    @property
    def redundant_here(self) -> int | None:
        """Number of constraints at `q` that depend on other constraints, to first order."""
        return None if self.rank is None else self.rank.n_dependent

    @property
    def idle(self) -> int:
        """Number of idle freedoms."""
        return len(self.idle_freedoms)

    @property
    def useful(self) -> int | None:
        """Number of freedoms that are not idle."""
        return None if self.dof is None else self.dof - self.idle

    @property
    def certain(self) -> bool:
        """Whether `dof` is proven, with values below rounding error taken as exactly zero.

        There are two kinds of proofs. The rank is full: the smallest singular value exceeds a bound
        of all rounding errors, and an exactly closed configuration is nearby (Newton and
        Kantorovich). Or a theorem about singular or overconstrained mechanisms holds whose
        hypotheses were checked; see `kempe.mobility.dof_proofs`. Without a proof, `dof` is known to
        a finite order. A result `within` a tolerance is not proven for the given mechanism.
        """
        return self.within is None and (self.regular if self.local is None else self.local.certain)

    @property
    def unproven(self) -> str:
        """The reason why `dof` is not proven although the rank is full."""
        bent = (
            [c for r in self.rank.clusters for c in r.cluster.bent] if self.rank is not None else []
        )
        if bent:
            return (
                f"no bound is known of how {', '.join(map(repr, bent))} "
                f"{choose_verb(len(bent), 'bends', 'bend')}"
            )
        return "a singular value is too near zero to be distinguished from it"

    @property
    def code(self) -> Status:  # type: ignore[override]
        """Outcome: `SOLVED` if the mechanism can be closed here."""
        if self.late:
            return Status.OUT_OF_TIME
        return Status.SOLVED if self.closed else Status.NOT_FOUND

    def relative(self, body: FrameLike, to: FrameLike) -> RelativeMotion:
        """Find the motions of one body relative to another at `q`, such as "a slide along x".

        See `kempe.mobility.relative_motion`.

        Raises
        ------
        InputError
            If the mechanism cannot be closed.
        UnknownNameError
            If there is no such body or frame.
        UnsupportedError
            For frames of particles.
        """
        from kempe.mobility.relative_motion import find_relative_motion

        if self.wrenches is None:
            raise InputError(
                f"the loops of {self.name} do not close here, so the motion of its bodies is not defined"
            )
        found = find_relative_motion(self.wrenches.system, self.wrenches.q, body, to)
        return replace(found, within=found.within or self.within)

    @property
    def status(self) -> str:
        """The result in one sentence."""
        return describe_mobility(self)

    def topics(self) -> list[tuple[str, list[str]]]:
        """Return the reasons as pairs of a title and its lines."""
        return list_topics(self)

    def _make_headline(self) -> str:
        return f"{self.name}: {self.status}"

    def _collect_data(self) -> dict[str, Any]:
        return collect_data(self)
