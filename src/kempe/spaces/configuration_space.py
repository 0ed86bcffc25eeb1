"""The configuration space of a system: the product space of its joints, and its closed subset.

Loops and relations leave this subset.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.model.configurations import (
    difference,
    distance,
    has_loops,
    integrate,
    interpolate,
    mid,
    winding_angles,
)
from kempe.report import Report
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, counted

if TYPE_CHECKING:
    from kempe.budget import Budget
    from kempe.mobility.answer import Mobility
    from kempe.mobility.independent import Parametrizations
    from kempe.model.model import Model
    from kempe.spaces.components import Components
    from kempe.spaces.connection import Connection
    from kempe.spaces.sampling import Sample


@dataclass(frozen=True)
class ProductSpace(InWords):
    """The space that the coordinates of all joints span: a circle T for each turn, a line R for
    each slide, ...
    """

    shape: str
    dimension: int

    def __str__(self) -> str:
        return f"{self.shape}, dimension {self.dimension}"


@dataclass(frozen=True)
class ConfigurationSpace(Report):
    """The set of the configurations that a system can have.

    `ambient` is the space of all coordinates: a circle T for each turn, a line R for each slide,
    SO(3) for each quaternion. A turn without limits is a line, too, where a constraint tells whole
    turns apart: 1 - q1 - q2 >= 0. Of a tree it is the configuration space. With loop closures or
    relations (`constraints` rows of them) the configuration space is a subset, of a smaller
    `dimension`. `limited` coordinates are confined to an interval of their factor. Sizes of arrays
    are `System.nq` and `System.nv`.
    """

    system: Model
    ambient: ProductSpace
    limited: int
    constraints: int

    # ---- its geometry

    def integrate(self, q: Any, v: ArrayLike) -> Array:
        """Configuration (..., nq) reached from `q` by the tangent vector `v` (..., nv)."""
        return integrate(self.system, q, v)

    def difference(self, q0: Any, q1: Any) -> Array:
        """Shortest tangent vector (..., nv) from `q0` to `q1`, whose length is the `distance`.

        ``integrate(q0, difference(q0, q1))`` is `q1`, up to whole turns of unlimited joints.
        """
        return difference(self.system, q0, q1)

    def interpolate(self, q0: Any, q1: Any, t: ArrayLike) -> Array:
        """Configuration (..., nq) at the fraction `t` (...) of the straight way from `q0` to `q1`."""
        return interpolate(self.system, q0, q1, t)

    def distance(self, q0: Any, q1: Any) -> Array:
        """Length (...) of the straight way from `q0` to `q1`; unlimited joints turn the short way."""
        return distance(self.system, q0, q1)

    # ---- all of it

    def sample(
        self,
        n: float,
        rng: np.random.Generator | int | None = None,
        *,
        budget: Budget | None = None,
    ) -> Sample:
        """Random configurations (n, nq), uniform in a stated measure; see
        `spaces.sampling.sample`.
        """
        from kempe.spaces.sampling import sample

        return sample(self.system, n, rng, budget=budget)

    def components(self, *, budget: Budget | None = None) -> Components:
        """Its connected components, or a lower bound of their number; see
        `spaces.components`.
        """
        from kempe.spaces.components import components

        return components(self.system, budget=budget)

    def path(self, q0: Any, q1: Any, *, budget: Budget | None = None) -> Connection:
        """A continuous motion between two configurations; see
        `spaces.connection.path`.
        """
        from kempe.spaces.connection import path

        return path(self.system, q0, q1, budget=budget)

    def parametrizations(self, q: Any = None) -> Parametrizations:
        """Pairs (r, R) with constraints, and generalized positions; see
        `mobility.independent`.
        """
        from kempe.mobility.independent import parametrizations

        return parametrizations(self.system, q)

    # ---- what it is

    @property
    def ambient_dimension(self) -> int:
        """Dimension nv of the space of all coordinates, in which constraints cut out the
        configuration space.
        """
        return self.ambient.dimension

    @property
    def shape(self) -> str:
        """The product form, such as "T^2 x R", of a tree; "a subset of T^4" where constraints hold."""
        return f"a subset of {self.ambient.shape}" if has_loops(self.system) else self.ambient.shape

    @cached_property
    def _mobility(self) -> Mobility:
        from kempe.mobility.mobility import mobility

        return mobility(self.system)

    @property
    def dimension(self) -> int | None:
        """Its dimension at the configuration `at`: the true degrees of freedom; None where nothing
        is known of them.
        """
        return self._mobility.dof if has_loops(self.system) else self.ambient.dimension

    @property
    def certain(self) -> bool:
        """Whether `dimension` is proven; see `Mobility.certain`."""
        return self._mobility.certain if has_loops(self.system) else True

    @property
    def at(self) -> Array:
        """The closed configuration (nq,) of which the dimension is found; of a tree it is the same
        anywhere.

        At a singular point the dimension may differ from that of configurations nearby.
        """
        return self._mobility.q if has_loops(self.system) else mid(self.system)

    @property
    def within(self) -> str:  # type: ignore[override]
        """What it is a subset of, without its own dimension, which takes an analysis."""
        text = str(self.ambient) + (
            f", {self.limited} of them within limits" if self.limited else ""
        )
        if not self.constraints:
            return text
        return (
            f"the subset of {text}, that satisfies "
            f"{counted(self.constraints, 'constraint equation')}"
        )

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `UNDETERMINED` where nothing is known of the dimension."""
        return Status.UNDETERMINED if self.dimension is None else Status.SOLVED

    def _data(self) -> dict[str, Any]:
        names = ("shape", "dimension", "certain", "ambient_dimension", "limited", "constraints")
        at = dict(zip(self.system.coordinate_names, self.at.tolist(), strict=True))
        return (
            {"system": self.system.name}
            | {name: getattr(self, name) for name in names}
            | {"at": at}
        )

    @property
    def status(self) -> str:
        """Its dimension, and what it is a subset of."""
        if not has_loops(self.system):
            return self.within
        dimension = "not known here" if self.dimension is None else str(self.dimension)
        known = self.certain or self.dimension is None
        return f"dimension {'' if known else 'probably '}{dimension}: {self.within}"


def configuration_space(system: Model) -> ConfigurationSpace:
    """The configuration space of a system; its dimension is found on demand."""
    turning = (system.structure.coordinates.turning & ~winding_angles(system))[
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
    rows += sum(c.equations(system.dim) for c in system._mechanism.constraints.values())
    for name in system.structure.closures:
        joint = system.structure.joints[name]
        particle = system.mechanism.bodies[joint.child].particle
        # q holds the joint's own coordinates too: all freedoms of the child are tied to it
        rows += joint.type.constraints(system.dim, particle) + joint.type.dof(system.dim, particle)
    return ConfigurationSpace(
        system, ProductSpace(" x ".join(parts) or "a point", system.nv), limited, rows
    )
