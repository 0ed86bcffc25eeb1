"""The configuration space of a system: a subset of the product space of its joints.

Loops and relations leave this subset. `compare_parametrizations` compares ways to parametrize it: how many
numbers and constraints each takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explain_errors, explain_method_errors
from kempe.errors import InputError
from kempe.model.configurations import (
    compute_difference,
    compute_distance,
    compute_mid_configuration,
    find_winding_angles,
    has_loops,
    integrate_velocity,
    interpolate_configurations,
    name_values,
)
from kempe.report import Report, Table
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, format_count
from kempe.words import join_first_words as listed_words

if TYPE_CHECKING:
    from kempe.budget import Budget
    from kempe.mobility.answer import Mobility
    from kempe.model.model import Model
    from kempe.spaces.components import Components
    from kempe.spaces.connection import Connection
    from kempe.spaces.sampling import Sample


@dataclass(frozen=True)
class ProductSpace(InWords):
    """The space that the coordinates of all joints span: a circle T for each turn, a line R for
    each slide.
    """

    shape: str
    dimension: int

    def __str__(self) -> str:
        return f"{self.shape}, dimension {self.dimension}"


@dataclass(frozen=True, repr=False)
class ConfigurationSpace(Report):
    """Set of all configurations that a system can have.

    The sizes of arrays are `System.nq` and `System.nv`.

    Attributes
    ----------
    ambient
        Space of all coordinates: a circle T for each angle, a line R for each slide, SO(3) for each
        quaternion. An angle without limits is a line if a constraint distinguishes whole turns,
        such as 1 - q1 - q2 >= 0.
    dimension
        Dimension of the configuration space. For a tree the configuration space is `ambient`; loop
        closures and relations make it a subset of smaller dimension.
    constraints
        Number of equations of loop closures and relations.
    limited
        Coordinates that limits confine to an interval.
    """

    _entries = (
        "system",
        "shape",
        "dimension",
        "certain",
        "ambient_dimension",
        "limited",
        "constraints",
    )
    _has_angles = True
    system: Model
    ambient: ProductSpace
    limited: int
    constraints: int

    # ---- its geometry

    def integrate(self, q: Any, v: ArrayLike) -> Array:
        """Integrate a constant velocity for a unit of time.

        Parameters
        ----------
        q
            Configurations (..., nq), or values by name.
        v
            Tangent vectors (..., nv) in radians and metres.

        Returns
        -------
        Array
            Configurations (..., nq). Loops are not closed again.

        See Also
        --------
        difference : The tangent vector between two configurations.

        Notes
        -----
        Angles and slides are added; a quaternion is multiplied with the exponential of its angular
        velocity, in the axes of the body.

        Examples
        --------
        >>> import kempe
        >>> kempe.load("two_link").configuration_space.integrate([0.1, 0.2], [1.0, -1.0])
        array([ 1.1, -0.8])
        """
        return integrate_velocity(self.system, q, v)

    def difference(self, q0: Any, q1: Any) -> Array:
        """Compute the shortest tangent vector from `q0` to `q1`.

        Parameters
        ----------
        q0, q1
            Configurations (..., nq), or values by name.

        Returns
        -------
        Array
            Tangent vectors (..., nv) in radians and metres. Joints without limits turn the short
            way.

        See Also
        --------
        distance : Its length.
        integrate : ``integrate(q0, difference(q0, q1))`` is `q1`, up to whole turns.

        Examples
        --------
        >>> import kempe
        >>> kempe.load("two_link").configuration_space.difference([3.0, 0], [-3.0, 0]).round(6)
        array([0.283185, 0.      ])
        """
        return compute_difference(self.system, q0, q1)

    def interpolate(self, q0: Any, q1: Any, t: ArrayLike) -> Array:
        """Interpolate between two configurations, along the shortest tangent vector.

        Parameters
        ----------
        q0, q1
            Configurations (..., nq), or values by name.
        t
            Fractions (...): 0 for `q0`, 1 for `q1`.

        Returns
        -------
        Array
            Configurations (..., nq). Loops are not closed; see `path`.

        Examples
        --------
        >>> import kempe
        >>> kempe.load("two_link").configuration_space.interpolate([0, 0], [1, 2], [0, 0.5, 1])
        array([[0. , 0. ],
               [0.5, 1. ],
               [1. , 2. ]])
        """
        return interpolate_configurations(self.system, q0, q1, t)

    def distance(self, q0: Any, q1: Any) -> Array:
        """Compute the length of the straight way from `q0` to `q1`.

        Parameters
        ----------
        q0, q1
            Configurations (..., nq), or values by name.

        Returns
        -------
        Array
            Norms (...) of the `difference`, in which radians and metres count alike.

        Examples
        --------
        >>> import kempe
        >>> float(kempe.load("two_link").configuration_space.distance([0, 0], [0.3, 0.4]))
        0.5
        """
        return compute_distance(self.system, q0, q1)

    # ---- all of it

    def sample(
        self,
        n: float,
        rng: np.random.Generator | int | None = None,
        *,
        budget: Budget | None = None,
    ) -> Sample:
        """Draw random configurations within limits and constraints, uniform in a stated measure.

        Parameters
        ----------
        n
            Number of configurations.
        rng
            Random generator or seed. Default: a new one for each call.
        budget
            `time_limit` (120 s) and `progress(done, n)`.

        Returns
        -------
        Sample
            Configurations `q` (n, nq), their `measure` in words, and whether they are `exact`:
            independent draws from it.

        Raises
        ------
        InputError
            For `n`, and for slides without limits, by name.

        Notes
        -----
        Of a tree the measure is the product of the coordinates, for quaternions Haar's. With loops
        it is length, area or volume of the closed configurations: of one freedom the arc length of
        the traced curves, of several a random walk (Zappa, Holmes-Cerfon and Goodman, 2018), which
        is uniform in the limit of many steps.

        Examples
        --------
        >>> import kempe
        >>> len(kempe.load("two_link").configuration_space.sample(100, rng=0))
        100
        """
        from kempe.spaces.sampling import draw_sample

        return draw_sample(self.system, n, rng, budget=budget)

    def components(self, *, budget: Budget | None = None) -> Components:
        """Find the connected components, or a lower bound of their number.

        Parameters
        ----------
        budget
            `starts` (256), `rng` (0) and `time_limit` (120 s).

        Returns
        -------
        Components
            `count`, whether it is proven (`complete`) and why (`reason`), and, with one freedom,
            the `parts` as curves.

        See Also
        --------
        path : A motion between two configurations of one component.

        Notes
        -----
        Planar single loops of revolute joints: theorem on long bars (Kapovich and Millson, 1995).
        Loops of four joints: dead points and limits. Other systems with one freedom are traced from
        many starts, which gives a lower bound; so do systems with several freedoms.

        Examples
        --------
        >>> import kempe
        >>> components = kempe.load("four_bar").configuration_space.components()
        >>> components.count, components.complete
        (2, True)
        """
        from kempe.spaces.components import find_components

        return find_components(self.system, budget=budget)

    def path(self, q0: Any, q1: Any, *, budget: Budget | None = None) -> Connection:
        """Find a continuous motion between two configurations.

        It stays within limits and on all constraints.

        Parameters
        ----------
        q0, q1
            Configurations (nq,), or values by name. Loops must be closed.
        budget
            `step` (0.1, largest distance between two rows), `rng` (0), `iterations` (4000 branches
            of random trees) and `time_limit` (120 s).

        Returns
        -------
        Connection
            Configurations `q` (n, nq) and their `length`; empty without a motion. Its `status`
            says why there is none.

        Raises
        ------
        InputError
            For configurations that are not single, or not closed.

        See Also
        --------
        components : The parts that motions cannot leave.

        Notes
        -----
        A straight line for trees, the traced curve with one freedom, else two random trees on the
        closed configurations that grow until they meet (Berenson, Srinivasa, Ferguson and Kuffner,
        2009).

        Examples
        --------
        >>> import kempe
        >>> bar = kempe.load("four_bar")
        >>> ends = [bar.assemble({"A": a}, bar.neutral).q for a in (0.3, 1.0)]
        >>> bool(bar.configuration_space.path(*ends))
        True
        """
        from kempe.spaces.connection import find_connection

        return find_connection(self.system, q0, q1, budget=budget)

    def parametrizations(self, q: Any = None) -> Parametrizations:
        """Compare descriptions by pairs (r, R) with constraints and by generalized positions.

        Parameters
        ----------
        q
            Configuration (nq,) at which ranks are computed. Default: a closed one.

        Returns
        -------
        Parametrizations
            `rows`: for each choice of coordinates their number, the number of constraints and the
            rank of these; `n`, the degrees of freedom; `pairs(q)`, positions and orientations of
            all bodies.

        Examples
        --------
        >>> import kempe
        >>> kempe.load("two_link").configuration_space.parametrizations().n
        2
        """
        return compare_parametrizations(self.system, q)

    # ---- what it is

    @property
    def ambient_dimension(self) -> int:
        """Dimension nv of the space of all coordinates, which contains the configuration space."""
        return self.ambient.dimension

    @property
    def shape(self) -> str:
        """The product form of a tree, such as "T^2 x R".

        With constraints a text such as "a subset of T^4".
        """
        return f"a subset of {self.ambient.shape}" if has_loops(self.system) else self.ambient.shape

    @cached_property
    def _mobility(self) -> Mobility:
        """The mobility of the system at its home configuration."""
        from kempe.mobility.mobility import mobility

        return mobility(self.system)

    @property
    def dimension(self) -> int | None:
        """Exact degrees of freedom at the configuration `at`; None if unknown."""
        return self._mobility.dof if has_loops(self.system) else self.ambient.dimension

    @property
    def certain(self) -> bool:
        """Whether `dimension` is proven; see `Mobility.certain`."""
        return self._mobility.certain if has_loops(self.system) else True

    @property
    def at(self) -> Array:
        """The closed configuration (nq,) at which the dimension is computed.

        A tree has the same dimension everywhere.

        At a singular point the dimension may differ from that of configurations nearby.
        """
        return (
            self._mobility.q if has_loops(self.system) else compute_mid_configuration(self.system)
        )

    @property
    def within(self) -> str:  # type: ignore[override]
        """The product space that contains the configuration space, as text."""
        text = str(self.ambient) + (
            f", {self.limited} of them within limits" if self.limited else ""
        )
        if not self.constraints:
            return text
        return (
            f"the subset of {text}, that satisfies "
            f"{format_count(self.constraints, 'constraint equation')}"
        )

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `UNDETERMINED` if the dimension is unknown."""
        return Status.UNDETERMINED if self.dimension is None else Status.SOLVED

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {"at": name_values(self.system, self.at)}

    @property
    def status(self) -> str:
        """The dimension of the configuration space and the space that contains it."""
        if not has_loops(self.system):
            return self.within
        dimension = "not known here" if self.dimension is None else str(self.dimension)
        known = self.certain or self.dimension is None
        return f"dimension {'' if known else 'probably '}{dimension}: {self.within}"


def make_configuration_space(system: Model) -> ConfigurationSpace:
    """Make the configuration space of a system; its dimension is computed on demand."""
    turning = (system.structure.coordinates.turning & ~find_winding_angles(system))[
        system.structure.layout.vector_v
    ]
    turns = int(turning.sum())
    slides = int((~turning).sum())
    balls = len(system.structure.layout.quaternion_q)
    factors = [("SO(3)", balls), ("T", turns), ("R", slides)]
    if turns == 0 and slides and balls:
        factors = [("R", slides), ("SO(3)", balls)]
    parts = [name if n == 1 else f"{name}^{n}" for name, n in factors if n]
    limited = int((np.isfinite(system.lower) | np.isfinite(system.upper)).sum())
    rows = len(system.structure.relations)
    rows += sum(c.count_equations(system.dim) for c in system._mechanism.constraints.values())
    for name in system.structure.closures:
        joint = system.structure.joints[name]
        particle = system._mechanism.bodies[joint.child].particle
        # q holds the joint's own coordinates too: all freedoms of the child are tied to it
        rows += joint.type.constraints(system.dim, particle) + joint.type.dof(system.dim, particle)
    return ConfigurationSpace(
        system, ProductSpace(" x ".join(parts) or "a point", system.nv), limited, rows
    )


# ---- parametrizations

# Two ways to say where all bodies are: pairs (r, R) that constraints tie, and generalized positions
# without any.

SHOWN = 12
"""Names that the table shows of one row."""


class Parametrization(NamedTuple):
    """A choice of coordinates for the poses of all bodies: numbers, constraints and their `rank`.

    `rank` is None where the loops cannot be closed. `dof` is what is left of the numbers, to first
    order.
    """

    what: str
    numbers: int
    constraints: int
    rank: int | None
    names: tuple[str, ...]

    @property
    def dof(self) -> int | None:
        """Degrees of freedom to first order: numbers minus rank."""
        return None if self.rank is None else self.numbers - self.rank


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Parametrizations(Report):
    """Choices of coordinates for the configuration space of a system, as a table to ``print``.

    `rows` are the pairs (r, R) of all bodies; with loops the coordinates of all joints; the
    generalized positions, as many as freedoms. Constraints of velocity and one-sided ones take no
    dimension, and are not counted.
    """

    _entries = ("n_b", "m_c", "n", "why")

    system: Model
    rows: tuple[Parametrization, ...]
    n_b: int
    """Number of bodies, the ground left out."""
    n: int | None
    """Degrees of freedom; None where they are not known."""
    why: str = ""
    """Why there are no generalized positions."""

    @property
    def m_c(self) -> int:
        """Number of constraints on the pairs."""
        return self.rows[0].constraints

    def pairs(self, q: Any) -> tuple[Array, Array]:
        """Compute the pairs of all bodies at q (..., nq).

        They are positions r (..., n_b, 3) and orientations R (..., n_b, 3, 3).
        """
        from kempe.forward.maximal import to_maximal

        X = to_maximal(self.system, q)
        return X[..., :3, 3].copy(), X[..., :3, :3].copy()

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `UNDETERMINED` if the degrees of freedom are unknown."""
        return Status.UNDETERMINED if self.n is None else Status.SOLVED

    @property
    def status(self) -> str:
        """The lecture's sentence: n_b pairs with m_c constraints, or n generalized positions."""
        known = self.why or f"n = {format_count(self.n or 0, 'generalized position')}"
        pairs = (
            f"n_b = {format_count(self.n_b, 'pair')} (r, R) with m_c = "
            f"{format_count(self.m_c, 'constraint')}"
        )
        return f"{self.system.name}: {pairs}, or {known}"

    def _make_tables(self) -> Sequence[Table]:
        rows = [
            (
                r.what,
                *("?" if x is None else str(x) for x in (r.numbers, r.constraints, r.rank, r.dof)),
                listed_words(r.names, SHOWN),
            )
            for r in self.rows
        ]
        heads = ("parameters", "numbers", "constraints", "rank", "left", "names")
        return [Table(heads, rows, grid=True)]

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {
            "rows": [row._asdict() | {"dof": row.dof} for row in self.rows]
        }


@explain_errors
def compare_parametrizations(system: Model, q: Any = None) -> Parametrizations:
    """Count the coordinates of all bodies: in pairs (r, R) with constraints, and generalized
    positions.

    `q` (nq,): where the rank is taken, default as in `mobility`. Errors: as `mobility`.
    """
    from kempe.first_order.counting import count_freedoms
    from kempe.mobility.independent import independent
    from kempe.mobility.mobility import mobility

    m = mobility(system, q)
    count = count_freedoms(system)
    bodies = system.body_names[1:]
    rank = None if m.rank_dof is None else count.free - m.rank_dof
    rows = [Parametrization("pairs (r, R)", count.free, count.taken, rank, bodies)]
    if has_loops(system) and m.rank is not None:
        names = system.structure.velocity_names
        rows.append(
            Parametrization(
                "all joints", system.nv, count.taken - count.free + system.nv, m.rank.rank, names
            )
        )
    why = "" if m.closed else "no generalized positions: the loops cannot be closed here"
    if m.closed and m.dof is None:
        why = "generalized positions, whose true number is not known"
    if m.closed:
        try:
            chart = independent(system, m.q)
            names = chart.independent
            if m.dof in (None, len(names)):
                rows.append(Parametrization("generalized positions", len(names), 0, 0, names))
            else:
                why = f"no generalized positions at this singular q, where n = {m.dof}"
        except InputError as error:
            why = f"no generalized positions here: {error}"
    return Parametrizations(system, tuple(rows), len(bodies), m.dof, why)
