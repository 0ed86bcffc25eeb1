"""The table of solvers: who answers which question, in the order in which they are checked whether
they can.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from kempe.solvers.analytic import ik_all
from kempe.solvers.analytic.redundant import redundancy
from kempe.solvers.assembly import assembly
from kempe.solvers.common.problem import Solver
from kempe.solvers.modes import modes
from kempe.solvers.one_frame import inverse
from kempe.solvers.paths import following, self_motion

TABLE: Mapping[str, tuple[Solver, ...]] = MappingProxyType(
    {
        "ik": inverse.SOLVERS,
        "ik_all": ik_all.SOLVERS,
        "ik_path": following.SOLVERS,
        "assemble": assembly.SOLVERS,
        "assembly_modes": modes.SOLVERS,
        "self_motion": self_motion.SOLVERS,
        "sweep": redundancy.SOLVERS,
    }
)
"""The rows by verb: the first that does not refuse answers; `Answer.solver` names it, and why those
before it did not.

"self_motion" and "sweep" are requested a set that is continuous. "assembly modes", of `ik_all` for
a frame that moves with loops, are those of `assembly_modes`.
"""
