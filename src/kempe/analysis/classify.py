"""Which kind each constraint is: holonomic, integrable, nonholonomic, unilateral; how far velocities that are free reach.

Velocities that rows A(q) v = 0 leave free span a distribution on the set of closed configurations. What brackets of its
fields span at q is tangent to the set that motions from q reach (Chow, 1939; Nagano, 1966; Sussmann, 1973). Where it is
no more than the distribution, at a configuration drawn at random and so everywhere, since all is analytic, the rows are
the rates of functions of q (Frobenius, 1877): positions in disguise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.analysis.brackets import Distribution, Growth, distribution, growth
from kempe.analysis.generic import Closed, close, find_closed
from kempe.calls import explained, explained_methods, generator
from kempe.errors import InputError
from kempe.kinematics.configuration import as_q
from kempe.kinematics.recorded import Rows
from kempe.kinematics.velocity import tangent_rows
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

HOLONOMIC, INTEGRABLE, NONHOLONOMIC, UNILATERAL = "holonomic", "integrable", "nonholonomic", "unilateral"
STEP = 0.5
"""Length of the step to a configuration drawn at random, in radians and characteristic lengths."""
PIECES = 3
"""Random motions, one after the other, to a configuration that is reached from a given one."""


@dataclass(frozen=True)
class ConstraintKind:
    """What one constraint is, alone beside what holds positions.

    `rows` counts its equations, `independent` the freedoms of velocity that they take. `integrable` of the velocity
    rows, or of sums of them with factors, are rates of functions of position; `reaches` is the dimension of what
    motions reach that obey this constraint, `growth` their growth vector at configurations around.
    """

    name: str
    kind: str
    rows: int
    independent: int
    integrable: int
    reaches: int | None
    growth: tuple[int, ...] | None
    sentence: str

    def __str__(self) -> str:
        return f"{self.name}: {self.sentence}"


@explained_methods
@dataclass(frozen=True, eq=False)
class Classification:
    """What the constraints of a system are, each alone and all together, with the reasoning; ``print`` it.

    `position_dof` is the dimension of the set of closed configurations at `q`, `velocity_dof` that of the velocities
    that all constraints leave free there. `growth` is their growth vector at `q`: dimensions of what brackets of up to
    1, 2, ... of them span; `growth_around` that at configurations drawn at random. `degree` is the length of brackets
    after which nothing is added (None where it is beyond the limit of work), and `reachable_dimension` the dimension of
    the set that motions from `q` reach. `kind` says what the constraints of velocity are together.
    `constraints[name].kind` is "holonomic", "integrable" (of velocity, but positions in disguise), "nonholonomic" or
    "unilateral". Where `why` says why not, growth and what is reached are None.
    """

    name: str
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
    reachable_around: int | None = None
    """The dimension that motions reach from configurations drawn at random."""

    @property
    def singular(self) -> bool:
        """Whether the growth vector at `q` differs from that at configurations drawn at random."""
        return self.growth != self.growth_around

    @property
    def integrals(self) -> int | None:
        """How many independent functions of position keep their value along every motion, around `q`."""
        return None if self.reachable_around is None else self.position_dof - self.reachable_around

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        from kempe.analysis.classify_text import sentence

        return sentence(self)

    def data(self) -> dict[str, Any]:
        """All numbers and texts as plain Python, ready for JSON."""
        from kempe.analysis.classify_text import data

        return data(self)

    def __str__(self) -> str:
        from kempe.analysis.classify_text import text

        return text(self)

    def _repr_html_(self) -> str:
        from kempe.analysis.classify_text import html

        return html(self)


@explained
def classify(
    system: System, q: Any = None, *, t: float = 0.0, rng: np.random.Generator | int = 0
) -> Classification:  # fmt: skip
    """Which kind each constraint of a system is, and how far velocities that are free reach, with the reasoning.

    `q` (nq,) or a dict by coordinate name (default: as for `mobility`), `t` the time where constraints depend on it.
    `rng` draws letters of brackets and configurations around. Ranks are decided by the size of singular values against
    an estimate of rounding; `doubtful` says that one is not clearly on either side. Errors: `InputError`;
    `UnsupportedError` for constraints that are no recorded expressions, by name.
    """
    given = None if q is None else as_q(system, q)
    if given is not None and given.ndim != 1:
        raise InputError(f"q has shape {given.shape}; constraints are classified at one configuration ({system.nq},)")
    at = find_closed(system) if given is None else close(system, given)
    if not at.closed:
        raise InputError(f"the mechanism cannot be closed here (residual {at.residual:.2g}): {at.why}")
    return _Classifier(system, tangent_rows(system), at.q, float(t), generator(rng)).found()
