"""Classification of constraints: holonomic, integrable, nonholonomic or unilateral.

The verb `classify`, its answer, and the wording of the answer. It also tells how far motions reach.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kempe.arguments import explain_errors, explain_method_errors, make_generator
from kempe.arrays import is_real
from kempe.assemble.generic_configurations import (
    NEAR,
    close_configuration,
    find_closed_configuration,
)
from kempe.assemble.nearest_exact import answer_within_tolerance, describe_nearest
from kempe.budget import Budget, TimeUp, Usual
from kempe.description.parts import ReadOnlyDict
from kempe.equations.velocity import VelocityRows, record_tangent_rows
from kempe.errors import InputError, format_value
from kempe.mobility.growth_vectors import Distribution, Growth, compute_distribution, compute_growth
from kempe.mobility.one_sided import OneSidedReport, report_if_relevant
from kempe.model.configurations import compute_distance, name_values, read_finite_q
from kempe.numerics.clock import SHORT, TimeLimit, find_time_limit, limit_time
from kempe.numerics.rank import Level, Spectrum
from kempe.report import Nearest, Report
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, choose_verb, cut_lines, format_count

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- the answer in words

SHOWN = 24
"""Constraints that are listed one by one."""
LATE = "the time limit ended the work before each constraint was looked at alone"
"""What is said where that is all that is missing."""
SEEN = 1e-9
"""Distance above which it is reported that the configuration is not the one that was given."""


def format_growth(growth: tuple[int, ...], open_end: bool = False) -> str:
    """Format a growth vector: '(2, 3, 4)', with dots where it continues."""
    return f"({', '.join(map(str, growth))}{', ...' if open_end else ''})"


def describe_classification(c: Classification) -> str:
    """Describe a classification in one sentence, with the tolerance within which it holds."""
    doubt = (
        "; a rank is doubtful"
        if c.doubtful and "beyond the digits" not in _describe_outcome(c)
        else ""
    )
    ended = f"; {LATE}" if c.late and not c.why else ""
    return _describe_outcome(c) + doubt + ended + describe_nearest(c.within)


def _describe_outcome(c: Classification) -> str:
    """Describe freedoms of position and velocity, and what motions reach."""
    both = f"{format_count(c.position_dof, 'freedom')} of position, {c.velocity_dof} of velocity"
    if c.kind in ("", "unilateral") or (c.kind == "holonomic" and c.position_dof == c.velocity_dof):
        return both + (f"; {c.why}" if c.why else "")
    if c.doubtful and c.reachable_dimension is not None and c.reachable_dimension < c.position_dof:
        least = (
            f"motions reach at least {format_count(c.reachable_dimension, 'dimension')} of "
            f"{c.position_dof}"
        )
        return f"{both}: {least}; whether more cannot be decided in double precision"
    if c.kind == "integrable":
        lost = c.integrals or 0
        keep = "keeps its value" if lost == 1 else "keep their values"
        return f"{both}: integrable, {format_count(lost, 'function')} of position {keep}"
    if c.reachable_dimension is None:
        return f"{both}: nonholonomic; {c.why}"
    if c.reachable_dimension == c.position_dof:
        return f"{both}: nonholonomic, motions reach every configuration around"
    return (
        f"{both}: nonholonomic, motions reach {format_count(c.reachable_dimension, 'dimension')} "
        f"of {c.position_dof}"
    )


def describe_constraint(c: ConstraintKind) -> str:
    """Describe the kind of one constraint, with the reason."""
    return _describe_kind(c) + ("; all this while it touches" if c.touching else "")


def _describe_kind(c: ConstraintKind) -> str:
    """Describe the kind of one constraint, regardless of contact."""
    count = format_count(len(c.rows), "row")
    if c.kind == "unilateral":
        return f"unilateral: {count} held on one side, which takes no freedom while there is no contact"
    if c.kind == "holonomic":
        takes = (
            f"takes {format_count(c.independent, 'freedom')}"
            if c.independent
            else "redundant, takes no freedom"
        )
        return f"holonomic: {count} f(q) = 0, {takes}"
    if not c.independent:
        return "integrable: its velocities are zero by what holds positions, it takes no freedom"
    growth = format_growth(c.growth or ())
    if c.doubtful:
        least = (
            "alone, brackets of its velocities reach at least "
            f"{format_count(c.reaches or 0, 'dimension')}, {growth}"
        )
        return f"{least}; whether it is integrable cannot be decided in double precision"
    if c.kind == "integrable":
        held = format_count(c.independent, "function")
        stay = format_count(c.reaches or 0, "dimension")
        alone = f"integrable: alone, brackets of its velocities add nothing, {growth}"
        return f"{alone}: it holds {held} of position, so motions stay in {stay}"
    part = ""
    if c.integrable:
        part = (
            f"; {c.integrable} of its {format_count(c.independent, 'freedom')} "
            f"{choose_verb(c.integrable, 'is', 'are')} integrable"
        )
    return (
        "nonholonomic: alone, brackets of its velocities reach "
        f"{format_count(c.reaches or 0, 'dimension')}, {growth}{part}"
    )


def list_reasons(c: Classification) -> list[str]:
    """List growth vectors and their consequences, line by line."""
    if c.growth_around is None or c.growth_around == () or c.position_dof == c.velocity_dof:
        return [c.why] if c.why else []
    out: list[str] = []
    if c.growth is not None:
        out.append(
            f"{format_growth(c.growth, c.degree is None)} at q"
            + (f", degree {c.degree}" if c.degree else "")
        )
    if c.singular:
        out.append(f"{format_growth(c.growth_around)} at configurations around: q is singular")
    if c.why:
        out.append(c.why)
    return out


def list_proofs(c: Classification) -> list[str]:
    """List what is proven, with the theorems."""
    if c.growth_around is None or c.position_dof == c.velocity_dof:
        return []
    out: list[str] = []
    if c.kind == "integrable" and not c.doubtful:
        out.append(
            "brackets of two velocities add nothing at a configuration drawn at random, so nowhere "
            "around: motions stay on surfaces (Frobenius, 1877)"
        )
    elif c.reachable_dimension is not None:
        out.append(
            "what brackets span is tangent to what motions reach (Chow, 1939; Nagano, 1966; "
            "Sussmann, 1973)"
        )
        if c.reachable_dimension < c.position_dof and not c.doubtful:
            out.append(
                "longer brackets add nothing at a configuration drawn at random among those that "
                "motions reach"
            )
    out.append(
        "ranks are decided by singular values against an estimate of rounding"
        + ("; one of them is doubtful" if c.doubtful else "")
    )
    return out


def list_topics(c: Classification) -> list[tuple[str, list[str]]]:
    """List the topics of the report as (title, lines)."""
    out = [("growth", list_reasons(c)), ("known by", list_proofs(c))]
    if c.moved > SEEN:
        out.insert(
            0, ("start", [f"q is {c.moved:.3g} away from what was given, which was not closed"])
        )
    each = [str(x) for x in c.constraints.values()]
    out.append(("constraints", cut_lines(each, SHOWN)))
    if c.one_sided is not None:
        out.append(("one-sided", [c.one_sided.sentence, *c.one_sided.lines]))
    return [(title, own) for title, own in out if own]


def collect_data(c: Classification) -> dict[str, Any]:
    """Collect all numbers and texts as plain Python, ready for JSON."""
    return {
        "system": c.name,
        "q": name_values(c.system, c.q),
        "kind": c.kind,
        "position_dof": c.position_dof,
        "velocity_dof": c.velocity_dof,
        "growth": None if c.growth is None else list(c.growth),
        "growth_around": None if c.growth_around is None else list(c.growth_around),
        "degree": c.degree,
        "reachable_dimension": c.reachable_dimension,
        "reachable_around": c.reachable_around,
        "singular": c.singular,
        "doubtful": c.doubtful,
        "why": c.why,
        "moved": c.moved,
        "one_sided": None if c.one_sided is None else c.one_sided._collect_data(),
        "constraints": {
            k: {
                "kind": x.kind,
                "rows": list(x.rows),
                "independent": x.independent,
                "integrable": x.integrable,
                "doubtful": x.doubtful,
                "reaches": x.reaches,
                "growth": None if x.growth is None else list(x.growth),
                "sentence": x.sentence,
            }
            for k, x in c.constraints.items()
        },
    }


# ---- the answer

HOLONOMIC = "holonomic"
INTEGRABLE = "integrable"
NONHOLONOMIC = "nonholonomic"
UNILATERAL = "unilateral"


@dataclass(frozen=True)
class ConstraintKind(InWords):
    """The kind of one constraint, considered alone with the constraints of position.

    `rows` are the names of its equations, `independent` of them take a freedom of velocity each.
    With rows of velocity, `integrable` of the freedoms that these take are rates of functions of
    position; `reaches` is the dimension of what motions reach that obey this constraint, `growth`
    their growth vector, both at configurations around.
    """

    name: str
    kind: str
    rows: tuple[str, ...]
    independent: int
    integrable: int = 0
    reaches: int | None = None
    growth: tuple[int, ...] | None = None
    doubtful: bool = False
    """Whether rounding decides that brackets reach no more: then `reaches` is the least."""
    touching: bool = False
    """Whether its rows of velocity hold only while it touches something."""

    @property
    def sentence(self) -> str:
        """The kind of the constraint, with the reason, in one sentence."""

        return describe_constraint(self)

    def __str__(self) -> str:
        return f"{self.name}: {self.sentence}"


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Classification(Report):
    """Kinds of the constraints of a system, alone and together; printed, with the reasoning.

    Attributes
    ----------
    constraints
        ``constraints[name].kind`` is "holonomic", "integrable" (a velocity constraint that is a
        position constraint in disguise), "nonholonomic" or "unilateral".
    kind
        Kind of all velocity constraints together.
    position_dof
        Dimension of the set of closed configurations at `q`.
    velocity_dof
        Dimension of the velocities that all constraints allow at `q`.
    growth, growth_around
        Growth vectors at `q` and at random configurations: dimensions that brackets of length up to
        1, 2, ... span.
    degree
        Length of brackets after which the dimension stays the same; None if it exceeds the limit of
        work.
    reachable_dimension
        Dimension of the set that motions from `q` reach; a lower bound if `doubtful`.
    why
        Reason why growth and reachable dimension are None.
    """

    _has_angles = True
    system: Model
    q: Array
    kind: str
    position_dof: int
    velocity_dof: int
    growth: tuple[int, ...] | None
    growth_around: tuple[int, ...] | None
    reachable_dimension: int | None
    degree: int | None
    constraints: Mapping[str, ConstraintKind]
    doubtful: bool
    why: str = ""
    one_sided: OneSidedReport | None = None
    """Which one-sided constraints are closed at `q` and what they still allow; None where there are
    none."""
    moved: float = 0.0
    """How far `q` is from the configuration that was given, where that was not closed."""
    late: bool = False
    """Whether the time limit ended the search for growth vectors; `constraints` has those that were
    looked at."""
    reachable_around: int | None = None
    """The dimension that motions reach from configurations drawn at random."""
    within: Nearest | None = None
    """The nearest mechanism that closes exactly, which was solved in place of the given one; None:
    it was itself."""

    @property
    def name(self) -> str:
        """The name of the system."""
        return self.system.name

    @property
    def singular(self) -> bool:
        """Whether the growth vector at `q` surely differs from the one at random configurations."""
        return not self.doubtful and self.growth != self.growth_around

    @property
    def integrals(self) -> int | None:
        """Number of independent functions of position that every motion around `q` keeps constant."""
        return None if self.reachable_around is None else self.position_dof - self.reachable_around

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `UNDETERMINED` where growth vector and reachable dimension are not known."""
        if self.late:
            return Status.OUT_OF_TIME
        return Status.UNDETERMINED if self.why and self.growth is None else Status.SOLVED

    @property
    def status(self) -> str:
        """The result in one sentence."""
        return describe_classification(self)

    def topics(self) -> list[tuple[str, list[str]]]:
        """Return the reasons as pairs of a title and its lines."""
        return list_topics(self)

    def _make_headline(self) -> str:
        return f"{self.name}: {self.status}"

    def _collect_data(self) -> dict[str, Any]:
        return collect_data(self)


# ---- how far motions reach

# Growth vectors of rows A(q) v = b at a configuration, around it, and along motions that obey them.

STEP = 0.7
"""Mean length of the step of a velocity to a configuration drawn at random, in radians and
characteristic lengths."""
TRIES = 8
"""Draws of such a configuration."""
PIECES = 3
"""Random motions, one after the other, to a configuration that is reached from a given one."""
EXACT = 1e-12
"""Tolerance of the integration of such motions."""
DRIFT = 1e-9
"""How far it leads away from what such motions reach, at most."""


@dataclass(frozen=True, eq=False)
class EvaluationPoint:
    """A configuration and time at which constraint rows are evaluated.

    `holding` are the rows that hold positions.

    `closed` gives for a configuration one with all loops closed near it, or None.
    """

    rows: VelocityRows
    q: Array
    t: float
    holding: tuple[int, ...]
    closed: Callable[[Array], Array | None]
    error: float = 1e-15
    """How far the configuration is from where it should be, in units."""

    def replace_configuration(self, q: Array) -> EvaluationPoint:
        """Return the same point with another configuration."""
        return replace(self, q=q)

    @property
    def n_time_directions(self) -> int:
        """Number of time directions: 1 if rows depend on the time, else 0."""
        return 0 if self.rows.steady else 1

    def compute_null_space(self, which: Sequence[int] = ()) -> Distribution:
        """Compute the velocities that constraints of position, and further rows, leave free."""
        return compute_distribution(self.rows, self.q, (*self.holding, *which), self.t, self.error)


@dataclass(frozen=True, eq=False)
class Reach:
    """Growth vectors and reachable dimensions, at a configuration and at random ones around it.

    `growth` and `dimension` are None where the rows lose rank here; the other numbers do not count
    the time.
    """

    free: int
    growth: tuple[int, ...] | None
    around: tuple[int, ...]
    dimension: int | None
    dimension_around: int
    degree: int | None
    doubtful: bool


def sample_nearby_point(place: EvaluationPoint, rng: np.random.Generator) -> EvaluationPoint | None:
    """Sample a closed configuration around a point; None if none is found."""
    basis = place.compute_null_space().basis[: place.rows.layout.nv]
    units = place.rows.units[:-1]
    step = STEP
    for _ in range(TRIES):
        z = basis @ rng.normal(size=len(basis.T))
        q = place.closed(place.rows.layout.integrate_velocity(place.q, step * units * z))
        if q is not None:
            return place.replace_configuration(q)
        step *= 0.6
    return None


def sample_reachable_point(
    place: EvaluationPoint, which: Sequence[int], rng: np.random.Generator
) -> EvaluationPoint:
    """Sample a configuration that random motions under the rows reach from a point."""
    from scipy import integrate

    rows = place.rows
    layout = rows.layout
    units = rows.units[: rows.layout.nv + place.n_time_directions]
    start = place.q
    state = np.append(np.zeros(layout.nv), place.t)
    for _ in range(PIECES):
        wish = rng.normal(size=len(units))
        chosen = place.replace_configuration(start).compute_null_space(which).chosen

        def compute_rate(
            _: float, x: Array, chosen: np.ndarray = chosen, wish: Array = wish
        ) -> Array:
            """Compute the rates of configuration and time along a random direction."""
            A, b = rows.evaluate_rows(x[: layout.nq], x[layout.nq])
            whole = (np.concatenate([A, -b[:, None]], axis=1) if place.n_time_directions else A)[
                chosen
            ] * units
            v = (wish - Spectrum(whole).solve_least_squares(whole @ wish, Level.ROUNDING)) * units
            out = np.zeros(layout.nq + 1)
            out[layout.vector_q] = v[layout.vector_v]
            for iq, iv in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
                (w, x_, y, z) = x[iq : iq + 4]
                (a, b_, c) = v[iv : iv + 3]
                out[iq : iq + 4] = (
                    -x_ * a - y * b_ - z * c,
                    w * a + y * c - z * b_,
                    w * b_ + z * a - x_ * c,
                    w * c + x_ * b_ - y * a,
                )
                out[iq : iq + 4] *= 0.5
            out[-1] = v[layout.nv] if place.n_time_directions else 0.0
            return out

        begin = np.append(start, state[-1])
        solved = cast(Any, integrate).solve_ivp(
            compute_rate, (0.0, STEP), begin, "DOP853", rtol=EXACT, atol=EXACT
        )
        end = solved.y[:, -1]
        start = layout.integrate_velocity(end[:-1], np.zeros(layout.nv))
        state[-1] = end[-1]
    return replace(place, q=start, t=float(state[-1]), error=DRIFT)


def compute_reach(
    place: EvaluationPoint,
    around: EvaluationPoint | None,
    which: Sequence[int],
    rng: np.random.Generator,
) -> Reach:
    """Compute growth and reachable dimension from a point for motions that obey further rows.

    `around` is a point drawn at random.
    """
    extra = place.n_time_directions
    whole = place.compute_null_space().dimension
    here = place.compute_null_space(which)
    there = here if around is None else around.compute_null_space(which)
    far = compute_growth(there, rng, whole, False)
    if far.dimensions[-1] < whole and around is not None:  # the end is confirmed at another place
        other = sample_nearby_point(around, rng)
        more = (
            far
            if other is None
            else compute_growth(other.compute_null_space(which), rng, whole, False)
        )
        far = max(far, more, key=lambda g: g.dimensions[-1])
    most = far.dimensions[-1]
    if here.dimension > there.dimension:  # no field of velocities at q goes on smoothly around
        return Reach(
            here.dimension - extra,
            None,
            _subtract_time(far, extra),
            None,
            most - extra,
            None,
            far.doubtful,
        )
    near = compute_growth(here, rng, most, False)
    doubtful = far.doubtful or near.doubtful
    least = most
    if near.dimensions[-1] < most:
        along = compute_growth(
            sample_reachable_point(place, which, rng).compute_null_space(which), rng, most, False
        )
        least = along.dimensions[-1]
        doubtful = doubtful or along.doubtful
        near = compute_growth(here, rng, least, True) if near.dimensions[-1] < least else near
        doubtful |= near.doubtful
    found = near.dimensions
    degree = found.index(least) + 1 if least in found else None
    # what is decided is that so many are reached, not that no more are
    if doubtful and least < whole:
        degree = None
    found = found[:degree] + (least,) * (least < whole) if degree else found
    return Reach(
        here.dimension - extra,
        tuple(d - extra for d in found),
        _subtract_time(far, extra),
        least - extra,
        most - extra,
        degree,
        doubtful,
    )


def _subtract_time(found: Growth, extra: int) -> tuple[int, ...]:
    """Return the dimensions of a growth vector without the time direction."""
    return tuple(d - extra for d in found.dimensions)


# ---- the verb

# Velocities that rows A(q) v = 0 leave free span a distribution on the set of closed
# configurations. What brackets of its fields span at q is tangent to the set that motions from q
# reach (Chow, 1939; Nagano, 1966; Sussmann, 1973). Where it is no more than the distribution, at a
# configuration drawn at random and so everywhere, since all is analytic, the rows are the rates of
# functions of q (Frobenius, 1877): positions in disguise.

USUAL = Usual("classify", time_limit=SHORT)


@explain_errors
@limit_time(USUAL)
@answer_within_tolerance("q")
def classify(
    system: Model,
    q: Any = None,
    *,
    t: float = 0.0,
    project: bool = False,
    rng: np.random.Generator | int = 0,
    tolerance: float | str | None = None,
    budget: Budget | None = None,
) -> Classification:
    """Classify the constraints of a system; see `System.classify`."""
    find_time_limit(USUAL).release_reserved_time()  # there is nothing to do afterwards
    if not is_real(t):
        raise InputError(f"t is {format_value(t)}; it must be one number")
    given = None if q is None else read_finite_q(system, q)
    at = find_closed_configuration(system) if given is None else close_configuration(system, given)
    if not at.closed:
        raise InputError(
            f"the mechanism cannot be closed here (residual {at.residual:.2g}): {at.why}"
        )
    moved = 0.0 if given is None else float(compute_distance(system, given, at.q))
    if at.given > NEAR and given is not None and not project:
        raise InputError(
            f"q misses what holds positions by {at.given:.3g} (radians and characteristic "
            f"lengths); the nearest closed configuration found is {moved:.3g} away: project=True "
            "takes it"
        )
    found = _Classifier(
        system, at.q, float(t), make_generator(rng), find_time_limit(USUAL)
    ).classify_system()
    return replace(found, one_sided=report_if_relevant(system, at.q), moved=moved)


class _Classifier:
    """Classification in progress: the constraint rows of a system at a closed configuration."""

    def __init__(
        self, system: Model, q: Array, t: float, rng: np.random.Generator, time: TimeLimit
    ):
        self.system = system
        self.rows = record_tangent_rows(system)
        self.rng = rng
        self.time = time
        self.of: dict[str, list[int]] = {}
        for i, row in enumerate(self.rows.names):
            self.of.setdefault(row.of, []).append(i)
        names = self.rows.names
        self.moving = {c for c, rows in self.of.items() if any(names[i].velocity for i in rows)}
        # what rolls touches: its one-sided rows hold while it does
        held = (
            i
            for i, r in enumerate(names)
            if not r.velocity and (not r.sided or r.of in self.moving)
        )
        self.place = EvaluationPoint(self.rows, q, t, tuple(held), self._close_configuration)

    def _close_configuration(self, q: Array) -> Array | None:
        """Return the closed configuration nearest to q (nq,); None if there is none."""
        if not self.place.holding:
            return q
        at = close_configuration(self.system, q)
        return at.q if at.closed else None

    def list_velocity_rows(self, names: Iterable[str]) -> list[int]:
        """List the indices of the velocity rows of some constraints."""
        return [i for c in names for i in self.of[c] if self.rows.names[i].velocity]

    def classify_system(self) -> Classification:
        """Classify all constraints, alone and together."""
        place = self.place
        system = self.system
        whole = place.compute_null_space()
        around = sample_nearby_point(place, self.rng)
        positions = whole.dimension - place.n_time_directions
        away = whole.dimension if around is None else around.compute_null_space().dimension
        which = self.list_velocity_rows(self.moving)
        free = place.compute_null_space(which).dimension - place.n_time_directions
        made: dict[str, Any] = {
            "system": system,
            "q": place.q,
            "position_dof": positions,
            "velocity_dof": free,
        }
        if away < whole.dimension:
            count = f"{format_count(positions, 'freedom')}, around {away - place.n_time_directions}"
            why = f"q is a singular point of what holds positions, which leaves {count}"
            return self._classify_without_growth(why, made, around)
        if place.n_time_directions and not np.any(
            np.abs(place.compute_null_space(which).basis[-1]) > 1e-9
        ):
            return self._classify_without_growth(
                "the velocities that are requested contradict each other at q", made, around
            )
        try:
            total = compute_reach(place, around, which, self.rng)
        except TimeUp:
            if not self.time.spent:
                raise
            said = (
                f"the time limit of {self.time.limit:g} s ended the search for what brackets of "
                "velocities span"
            )
            return replace(self._classify_without_growth(said, made, around), late=True)
        kind = self._choose_common_kind(total)
        lost = (
            "constraints of velocity lose rank at q, where velocities do not go on smoothly around"
        )
        why = "" if total.growth is not None else lost
        each = self._classify_constraints(around or place)
        return Classification(
            **made,
            kind=kind,
            growth=total.growth,
            growth_around=total.around,
            reachable_dimension=total.dimension,
            degree=total.degree,
            constraints=each,
            late=self.time.spent,
            doubtful=total.doubtful,
            why=why,
            reachable_around=total.dimension_around,
        )

    def _classify_without_growth(
        self, why: str, made: dict[str, Any], around: EvaluationPoint | None
    ) -> Classification:
        """Classify the constraints without a growth vector, which is not defined or not known here."""
        return Classification(
            **made,
            kind="",
            growth=None,
            growth_around=None,
            reachable_dimension=None,
            degree=None,
            constraints=self._classify_constraints(around or self.place),
            doubtful=False,
            why=why,
        )

    def _choose_common_kind(self, total: Reach) -> str:
        """Choose the kind of all constraints together."""
        if self.moving:
            return INTEGRABLE if total.around[0] == total.dimension_around else NONHOLONOMIC
        sided = bool(self.rows.names) and all(r.sided for r in self.rows.names)
        return UNILATERAL if sided else HOLONOMIC

    def _classify_constraints(self, place: EvaluationPoint) -> Mapping[str, ConstraintKind]:
        """Classify each constraint alone, until the time is spent."""
        each: dict[str, ConstraintKind] = {}
        whole = -1
        for name, rows in self.of.items():
            if self.time.spent:
                continue
            try:
                whole = place.compute_null_space().dimension if whole < 0 else whole
                each[name] = self._classify_constraint(place, whole, name, rows)
            except TimeUp:
                if not self.time.spent:
                    raise
        return ReadOnlyDict(each)

    def _classify_constraint(
        self, place: EvaluationPoint, whole: int, name: str, own: list[int]
    ) -> ConstraintKind:
        """Classify one constraint alone with the constraints of position, which together leave
        `whole` freedoms.
        """
        rows = self.rows.names
        names = tuple(rows[i].name for i in own)
        which = self.list_velocity_rows([name]) if name in self.moving else []
        if not which:
            held = [i for i in own if not rows[i].sided]
            others = replace(place, holding=tuple(i for i in place.holding if i not in own))
            return ConstraintKind(
                name,
                HOLONOMIC if held else UNILATERAL,
                names,
                others.compute_null_space().dimension - whole if held else 0,
            )
        alone = place.compute_null_space(which)
        grown = compute_growth(alone, self.rng, whole, False)
        found = grown.dimensions
        kind = INTEGRABLE if found[-1] == alone.dimension else NONHOLONOMIC
        extra = place.n_time_directions
        return ConstraintKind(
            name,
            kind,
            names,
            whole - alone.dimension,
            whole - found[-1],
            found[-1] - extra,
            tuple(d - extra for d in found),
            grown.doubtful and found[-1] < whole,
            any(rows[i].sided for i in own),
        )
