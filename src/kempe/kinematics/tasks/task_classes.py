"""Which class asks for which constraint."""

from __future__ import annotations

from functools import lru_cache

from kempe.constraints.base import Constraint, Op, Row
from kempe.errors import InputError
from kempe.kinematics.tasks.task import Centred, PlacedTask, Task
from kempe.kinematics.tasks.tasks_whole import CoordinateTask
from kempe.kinematics.tasks.written import Written

FAMILIES: dict[Op, type[Task]] = {Op.COORDINATE: CoordinateTask, Op.TAPE: Written, Op.CALL: Written}
"""Which class asks for rows of an operation; `PlacedTask` for all others."""


def task_of(constraint: Constraint, dim: int) -> Task:
    """The constraint as a task. Errors: `InputError` where it cannot be required of a
    configuration.
    """
    rows = constraint.rows(dim)
    constraint.check(dim)
    family = family_of(rows)
    if family is None:
        raise InputError(
            f"{constraint.label} is about velocities, which no configuration has: declare it by "
            "Mechanism.constrain"
        )
    if family is PlacedTask and constraint.ends[1] is None:  # a centre is no frame
        family = Centred
    return family(constraint, dim, rows)


@lru_cache(maxsize=512)
def family_of(rows: tuple[Row, ...]) -> type[Task] | None:
    """The class that asks for these rows; None where some are about velocities."""
    ops = [r.op for r in rows]
    if Op.VELOCITY in ops:
        return None
    families = {FAMILIES.get(op, PlacedTask) for op in ops}
    if families != {PlacedTask}:
        return families.pop() if len(families) == 1 else Written
    further = [r for r in rows if r.op is not Op.POINT]
    sided = {bool(r.low or r.high) for r in rows}
    valued = any(r.equal for r in rows if r.op is not Op.DISTANCE)
    alone = len(further) <= 1 and (len(rows) == 1 or Op.DISTANCE not in ops)
    return (
        PlacedTask
        if alone
        and len(sided) == 1
        and not valued
        and not (sided == {True} and further and further[0].op is not Op.DISTANCE)
        else Written
    )
