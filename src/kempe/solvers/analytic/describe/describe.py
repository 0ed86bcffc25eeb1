"""What the analytical inverse model recognises in a chain, and the path on which it solves it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from kempe.calls import explained, listed
from kempe.errors import UnsupportedError
from kempe.kernels.forward.table_layout import SLIDE
from kempe.kinematics.common.result import Report
from kempe.solvers.analytic.describe.describe_axes import relations
from kempe.solvers.analytic.describe.describe_path import METHODS, most, path
from kempe.solvers.analytic.ik_all import chain_lines, plan_for
from kempe.solvers.analytic.plans.question import held
from kempe.solvers.common.targets import axis_for, task_and_axis, task_of
from kempe.words import by_topic, counted

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System
    from kempe.solvers.analytic.describe.symbolic_ik import InverseFormulas

WIDTH = 110
"""Columns of the text."""


@dataclass(frozen=True)
class Recognised(Report):
    """What is known about the inverse geometric model of a `frame` for a `task`.

    `joints` are those that move the frame, from the ground to it, `kinds` whether each "turns" or
    "slides". `relations` are facts about consecutive axes, those that a structure misses by little
    among them. `path` says step by step how all configurations are found, `method` is "closed
    form", "elimination" or "search". `most` is the largest number of isolated configurations that a
    target can have, turns by 2 pi not counted; `held` are the joints that stay at their values
    because the chain has more than the task needs, or because the caller said so.
    """

    system: str
    frame: str
    task: str
    joints: tuple[str, ...]
    kinds: tuple[str, ...]
    relations: tuple[str, ...]
    path: tuple[str, ...]
    most: int
    method: str
    held: tuple[str, ...]
    note: str = ""
    """Why the task is not a pose, where none was given."""
    of: System | None = field(default=None, repr=False, compare=False)

    @property
    def status(self) -> str:
        """What it is about."""
        return f"inverse model of {self.frame} of {self.system}, task {self.task}"

    def formulas(self, *, symbols: Mapping[str, Any] | None = None) -> InverseFormulas:
        """The inverse model as formulas; see
        `kempe.solvers.analytic.describe.symbolic_ik.symbolic_ik`.

        Errors: `UnsupportedError` where there are no short ones, with the reason.
        """
        from kempe.solvers.analytic.describe.symbolic_ik import symbolic_ik

        if self.of is None or self.held:
            why = (
                f"with {', '.join(self.held)} held; lock them in the mechanism"
                if self.held
                else "without the system"
            )
            raise UnsupportedError(f"there are no formulas {why}")
        return symbolic_ik(self.of, self.frame, self.task, symbols=symbols)

    def _data(self) -> dict[str, Any]:
        return {name: x for name, x in vars(self).items() if name != "of"}

    def topics(self) -> list[tuple[str, tuple[str, ...]]]:
        """The report as (title, lines)."""
        joints = ", ".join(f"{n} {k}" for n, k in zip(self.joints, self.kinds, strict=True))
        if set(self.kinds) == {"turns"} and len(self.joints) > 1:
            joints = f"{', '.join(self.joints)}: all turn"
        count = "configuration" if self.most == 1 else "configurations"
        each = " for each value of what is held" if self.held else ""
        return [
            *([("task", (self.note,))] if self.note else []),
            ("joints", (joints,)),
            ("axes", self.relations),
            ("path", self.path),
            ("method", (self.method,)),
            ("solutions", (f"{self.most} isolated {count} at most{each}",)),
        ]

    def __str__(self) -> str:
        return by_topic(self.status, self.topics(), 11, WIDTH)


@explained
def ik_plan(
    system: System,
    frame: FrameLike,
    task: str | tuple[str, ArrayLike] | None = None,
    fixed: Iterable[str] = (),
) -> Recognised:
    """What is recognised in the chain that moves `frame`, and how `ik_all` solves it.

    Arguments as those of `kempe.solvers.analytic.ik_all.ik_all`; without a `task` that of a pose,
    or of a position where the chain has no more joints than that has equations. `fixed` are the
    names of joints that are held. Errors: `UnsupportedError` for chains with loops, quaternions or
    shared coordinates, `InputError`, `UnknownNameError`.

    >>> import kempe
    >>> from kempe.solvers.analytic.describe.describe import ik_plan
    >>> print(ik_plan(kempe.load("puma560"), "tool").most)
    8
    """
    name = system.structure.frame_name(frame)
    said, axis = task_and_axis(task)
    what = task_of(said, False, bool(system.structure.table.at[name][2]))
    direction = axis_for(axis, what)
    lines = chain_lines(system, name, direction)
    note = ""
    if task is None and what == "pose" and len(lines) <= system.dim:
        n = 3 * (system.dim - 1)
        count = counted(len(lines), "joint")
        what = "position"
        note = (
            f"a pose has {n} equations, more than the chain has joints ({count}): the position is "
            "planned"
        )
    given = held(name, lines.names, dict.fromkeys(listed(fixed, "fixed"), 0.0))
    plan = plan_for(system, name, lines, what, direction, tuple(given))
    kinds = tuple("slides" if kind == SLIDE else "turns" for kind in lines.kinds)
    return Recognised(
        system.name,
        name,
        what,
        lines.names,
        kinds,
        relations(lines),
        path(plan, frozenset(given), system.dim == 2),
        most(plan),
        METHODS[plan.method],
        tuple(lines.names[i] for i in plan.locked),
        note,
        system,
    )
