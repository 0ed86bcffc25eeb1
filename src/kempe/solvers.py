"""Table of the solvers of each verb, in the order in which they are asked whether they can answer."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from kempe.answers.problem import Solver
from kempe.assemble import assemble, modes
from kempe.inverse import numeric, path, self_motion, solve_all, sweep

__path__: list[str] = []
"""Modules that a pickle asks for below this one are said to be missing by `kempe.version`, too."""

TABLE: Mapping[str, tuple[Solver, ...]] = MappingProxyType(
    {
        "ik": numeric.SOLVERS,
        "ik_all": solve_all.SOLVERS,
        "ik_path": path.SOLVERS,
        "assemble": assemble.SOLVERS,
        "assembly_modes": modes.SOLVERS,
        "self_motion": self_motion.SOLVERS,
        "sweep": sweep.SOLVERS,
    }
)
"""The rows by verb: the first that does not refuse answers; `Answer.solver` names it, and why those
before it did not.

"self_motion" and "sweep" are requested a set that is continuous. "assembly modes", of `ik_all` for
a frame that moves with loops, are those of `assembly_modes`.
"""
