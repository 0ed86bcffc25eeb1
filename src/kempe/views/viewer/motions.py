"""Motions that a page plays: one that is given, and those that can be found from where the system
is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.kinematics.configuration import has_loops
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.views.viewer.session import Session

SLOW = 4.0
"""Seconds in which a motion is played that has no times of its own."""
FALL = 3.0
"""Seconds of a fall, and part of its speed that a bounce leaves."""
LEFT = 0.8
PATIENCE = 5.0
"""Seconds that a search for a motion may take."""


class Played(NamedTuple):
    """Configurations `q` (n, nq), all of them finite, at times `t` (n,) [s] from 0 on; `timed`: its
    own times.
    """

    q: Array
    t: Array
    timed: bool

    @property
    def duration(self) -> float:
        """Seconds from the first to the last configuration."""
        return float(self.t[-1]) or SLOW

    def at(self, time: float) -> Array:
        """The configuration (nq,) at the time that is nearest."""
        k = int(np.searchsorted(self.t, time))
        before = k > 0 and (k == len(self.t) or time - self.t[k - 1] < self.t[k] - time)
        return np.array(self.q[k - 1 if before else k])


def motion_from(system: System, path: Any) -> Played | None:
    """The motion of an answer, or of configurations (n, nq); None of None. Errors: `InputError` for
    other shapes.
    """
    from kempe.views.plots import motion_of

    q, _ = motion_of(system, path)
    if q is None:
        return None
    own: Any = getattr(path, "t", None)
    timed = np.shape(own) == q.shape[:1]
    t = np.asarray(own, dtype=float) if timed else np.linspace(0.0, SLOW, len(q))
    finite = np.isfinite(q).all(axis=1) & np.isfinite(t)
    return Played(q[finite], t[finite] - t[finite][0], timed)


def _whole(session: Session) -> Any:
    from kempe.analysis.motion.motion import trace

    driver = session.sliders[0].name
    return trace(session.system, driver, session.q, budget=session.budget(PATIENCE))


def _self_motion(session: Session) -> Any:
    from kempe.solvers.paths.self_motion import self_motion

    system = session.system
    way = session.rng.normal(size=system.nv)  # of several freedoms: each search takes another one
    budget = session.budget(PATIENCE)
    task = session.task
    return self_motion(system, session.q, session.frame, task=task, direction=way, budget=budget)


def _manoeuvre(session: Session) -> Any:
    from kempe.analysis.manoeuvre.manoeuvre import manoeuvre

    return manoeuvre(session.system, session.home, session.q)


def _fall(session: Session) -> Any:
    from kempe.analysis.simulation.simulate import simulate

    return simulate(session.system, FALL, session.q, restitution=LEFT)


MOTIONS: dict[str, Callable[[Session], Any]] = {
    "whole motion": _whole,
    "frame at rest": _self_motion,
    "manoeuvre": _manoeuvre,
    "fall": _fall,
}
"""Motions that are found on request: with one freedom, with the frame where it is, of what rolls,
of what falls."""


def possible(session: Session) -> tuple[str, ...]:
    """Names of `MOTIONS` that a system of this kind can have."""
    system = session.system
    freedoms = len(session.sliders)
    rows = [r for c in system.mechanism.constraints.values() for r in c.of.rows(system.dim)]
    rolls = any(r.velocity for r in rows)
    falls = len(system.parent) == 1 and any(
        c.bounds(system.dim) for c in system.mechanism.constraints.values()
    )
    have = {
        "whole motion": freedoms == 1 and not rolls,
        "frame at rest": session.spare() and not rolls,
        "manoeuvre": rolls and not has_loops(system),
        "fall": falls and not rolls,
    }
    return tuple(name for name, has in have.items() if has)


def found(session: Session, name: str) -> tuple[Played | None, str]:
    """The motion of this name from where the session is, if there is one, and the sentence about
    it.

    Errors: those of the verb that looks for it.
    """
    answer = MOTIONS[name](session)
    return (motion_from(session.system, answer) if len(answer.q) > 1 else None), answer.status
