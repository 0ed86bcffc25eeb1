"""Two ways to say where all bodies are: pairs (r, R) that constraints tie, and generalized
positions without any.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from kempe.analysis.first_order.counting import counting
from kempe.analysis.mobility.mobility import mobility
from kempe.calls import explained, explained_methods
from kempe.errors import InputError
from kempe.kinematics.common.result import Cells, Report
from kempe.kinematics.configuration import has_loops
from kempe.kinematics.maximal import to_maximal
from kempe.solvers.assembly.charts import independent
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import counted, listed

if TYPE_CHECKING:
    from kempe.model.system import System

SHOWN = 12
"""Names that the table shows of one row."""


class Parametrization(NamedTuple):
    """A way to say where all bodies are: how many numbers, how many constraints on them, of which
    `rank`.

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
        """Numbers less rank: freedoms to first order."""
        return None if self.rank is None else self.numbers - self.rank


@explained_methods
@dataclass(frozen=True, eq=False)
class Parametrizations(Report):
    """Ways to parametrize the configuration space of a system, as one table; ``print`` it.

    `rows` are the pairs (r, R) of all bodies; with loops the coordinates of all joints; the
    generalized positions, as many as freedoms. Constraints of velocity and one-sided ones take no
    dimension, and are not counted.
    """

    system: System = field(repr=False)
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
        """Positions r (..., n_b, 3) and orientations R (..., n_b, 3, 3) of all bodies at q (...,
        nq).
        """
        X = to_maximal(self.system, q)
        return X[..., :3, 3].copy(), X[..., :3, :3].copy()

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `UNDETERMINED` where the degrees of freedom are not known."""
        return Status.UNDETERMINED if self.n is None else Status.SOLVED

    @property
    def status(self) -> str:
        """The lecture's sentence: n_b pairs with m_c constraints, or n generalized positions."""
        known = self.why or f"n = {counted(self.n or 0, 'generalized position')}"
        pairs = (
            f"n_b = {counted(self.n_b, 'pair')} (r, R) with m_c = {counted(self.m_c, 'constraint')}"
        )
        return f"{self.system.name}: {pairs}, or {known}"

    def _cells(self) -> Cells:
        rows = [
            (
                r.what,
                *("?" if x is None else str(x) for x in (r.numbers, r.constraints, r.rank, r.dof)),
                listed(r.names, SHOWN),
            )
            for r in self.rows
        ]
        return ("parameters", "numbers", "constraints", "rank", "left", "names"), rows

    def _lines(self) -> list[str]:
        heads, rows = self._cells()
        widths = [max(len(row[k]) for row in (heads, *rows)) for k in range(len(heads) - 1)]
        padded = [
            [
                row[0].ljust(widths[0]),
                *(x.rjust(w) for x, w in zip(row[1:-1], widths[1:], strict=True)),
                row[-1],
            ]
            for row in (heads, *rows)
        ]
        return ["  ".join(row) for row in padded]

    def _data(self) -> dict[str, Any]:
        return {"n_b": self.n_b, "m_c": self.m_c, "n": self.n, "why": self.why} | {
            "rows": [row._asdict() | {"dof": row.dof} for row in self.rows]
        }


@explained
def parametrizations(system: System, q: Any = None) -> Parametrizations:
    """How many numbers say where all bodies are, in pairs with constraints and in generalized
    positions.

    `q` (nq,): where the rank is taken, default as in `mobility`. Errors: as `mobility`.
    """
    m = mobility(system, q)
    count = counting(system)
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
            names = independent(system, m.q).independent
            if m.dof in (None, len(names)):
                rows.append(Parametrization("generalized positions", len(names), 0, 0, names))
            else:
                why = f"no generalized positions at this singular q, where n = {m.dof}"
        except InputError as error:
            why = f"no generalized positions here: {error}"
    return Parametrizations(system, tuple(rows), len(bodies), m.dof, why)
