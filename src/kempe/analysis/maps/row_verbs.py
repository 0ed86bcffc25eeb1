"""Verbs over rows of numbers: what a row is to each of them, and what they answer, as arrays with
named axes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.analysis.maps.cluster import refuse_kernels
from kempe.budget import Budget
from kempe.calls import known
from kempe.errors import InputError
from kempe.kernels.compiled import VARIANT
from kempe.kinematics.configuration import as_q, as_start, has_loops, q_from_dict
from kempe.kinematics.forward import fk
from kempe.model.tree.coordinates import units
from kempe.solvers.analytic.ik_all import ik_all
from kempe.solvers.assembly.assembly import assemble
from kempe.solvers.common.target_columns import PLACE, QUATERNION, poses_of_columns, said_columns
from kempe.solvers.common.targets import task_of
from kempe.solvers.one_frame.inverse import ik
from kempe.spatial import Array
from kempe.status import Status
from kempe.version import __version__
from kempe.words import jsonable

if TYPE_CHECKING:
    from kempe.model.system import System

Arrays = dict[str, Any]


@dataclass(frozen=True)
class RowJob:
    """A verb of a system with its options, and what the rows are that it is for: all that an answer
    depends on.

    `tail` is the shape of a row and `columns` their names, None where they have none.
    """

    system: System
    verb: str
    frame: str | None
    options: dict[str, Any]
    tail: tuple[int, ...]
    columns: tuple[str, ...] | None
    degrees: bool = False
    rng: int = 0
    variant: str = VARIANT
    version: str = field(default=__version__)

    def said(self) -> dict[str, Any]:
        """What is written beside a map, and must be the same for it to be gone on with. Errors:
        `InputError`.
        """
        try:
            options = json.loads(json.dumps(jsonable(self.options)))
        except (TypeError, ValueError):
            raise InputError(
                "options hold more than numbers and names, which cannot be written beside a map"
            ) from None
        return {
            "system": self.system.structure.content_hash,
            "verb": self.verb,
            "frame": self.frame,
            "options": options,
            "columns": None if self.columns is None else list(self.columns),
            "row": list(self.tail),
            "degrees": self.degrees,
            "rng": self.rng,
            "variant": self.variant,
            "version": self.version,
        }

    def answers(self, rows: Array) -> Arrays:
        """What the verb answers to rows (n, *tail), each array with n rows, in one thread. Errors:
        `KernelsError`.
        """
        refuse_kernels(self.variant, self.version)
        return VERBS[self.verb].answers(self, rows)

    @cached_property
    def layout(self) -> dict[str, np.ndarray]:
        """The arrays of no rows: their shapes and types. Errors: those of the verb for its options."""
        found = self.answers(np.zeros((0, *self.tail)))
        return {name: np.asarray(array) for name, array in found.items()}

    @property
    def row_bytes(self) -> list[int]:
        """Bytes of the answer to a row, of each array."""
        return [a.itemsize * int(np.prod(a.shape[1:])) for a in self.layout.values()]

    # ---- what a row is

    def configurations(self, rows: Array) -> Array:
        """Configurations (n, nq) of rows: all coordinates in order, or some by name. Errors:
        `InputError`.
        """
        if self.columns is None:
            return as_q(self.system, rows)
        missing = [name for name in self.system.coordinate_names if name not in self.columns]
        if missing and has_loops(self.system):
            every = ", ".join(self.system.coordinate_names)
            raise InputError(
                f"column {missing[0]!r} is missing, which the loops of {self.system.name!r} "
                f"decide: give all of {every}, or map assemble first"
            )
        return q_from_dict(self.system, self.by_name(rows))

    def by_name(self, rows: Array) -> dict[str, Array]:
        """The columns (n,) by their names, angles in radians. Errors: `InputError`."""
        if self.columns is None:
            raise InputError(
                "the columns have no names: name the known coordinates by columns=(...)"
            )
        unit = units(self.system)
        turns = [name for name in self.columns if self.degrees and unit.get(name) == "rad"]
        return {
            name: np.radians(x) if name in turns else x
            for name, x in zip(self.columns, rows.T, strict=True)
        }

    def targets(self, rows: Array) -> Array:
        """Targets of rows: poses (n, 4, 4), or positions (n, 3), where only these count. Errors:
        `InputError`.
        """
        if len(self.tail) == 2:
            if self.tail not in ((4, 4), (3, 4)):
                raise InputError(
                    f"a row is of shape {self.tail}; a target is (4, 4), (3, 4), or the columns "
                    f"{said_columns(self.system.dim)}"
                )
            X = np.broadcast_to(np.eye(4), (len(rows), 4, 4)).copy()
            X[:, : self.tail[0]] = rows
            return X
        X, position = poses_of_columns(self.system.dim, rows, self.columns, self.degrees)
        task = self.options.get("task")
        if isinstance(task, str):
            task_of(task, position, False)
        if position and task not in (None, "position"):
            raise InputError(
                f"task {task!r} needs targets with an orientation; they have x, y, z only"
            )
        return np.ascontiguousarray(X[:, : self.system.dim, 3]) if position else X

    def axes(self) -> dict[str, list[str]]:
        """What stands along the axes that have names."""
        q = list(self.system.coordinate_names)
        unit = units(self.system)
        return {
            "coordinate": q,
            "unit": [unit[name] or "1" for name in q],
            "body": list(self.system.body_names),
            "axis": list(PLACE),
            "component": [*PLACE, *QUATERNION],
        }


class Verb(NamedTuple):
    """A verb: what it answers to rows, its options, and how many rows it is given at once, at most."""

    answers: Callable[[RowJob, Array], Arrays]
    options: tuple[str, ...]
    rows: int
    needs_frame: bool = True


def _fk(job: RowJob, rows: Array) -> Arrays:
    X = fk(job.system, job.configurations(rows), job.frame, threads=1, **job.options)
    form = job.options.get("form") or "matrix"
    code = np.where(
        np.isfinite(X).all(axis=tuple(range(1, X.ndim))), Status.SOLVED, Status.BAD_INPUT
    )
    return {"pose" if form in ("matrix", "3x4") else form: X, "code": code.astype(np.uint8)}


def _ik(job: RowJob, rows: Array) -> Arrays:
    answer = ik(
        job.system,
        job.targets(rows),
        job.frame,
        budget=Budget(rng=job.rng, threads=1),
        **job.options,
    )
    return {
        "q": answer.q,
        "code": np.asarray(answer.code, dtype=np.uint8),
        "position_error": answer.position_error,
        "orientation_error": answer.orientation_error,
    }


def _ik_all(job: RowJob, rows: Array) -> Arrays:
    if job.options.get("limits") == "turns":
        raise InputError(
            "limits='turns' gives as many solutions as there are turns; a map has room for one of "
            "each"
        )
    answer: Any = ik_all(
        job.system, job.targets(rows), str(job.frame), budget=Budget(threads=1), **job.options
    )
    return {
        "q": answer.q,
        "code": np.asarray(answer.code, dtype=np.uint8),
        "residual": answer.residual,
        "inside": answer.inside,
        "count": answer.mask.sum(axis=-1).astype(np.uint8),
        "complete": np.asarray(answer.complete, dtype=bool),
    }


def _assemble(job: RowJob, rows: Array) -> Arrays:
    if job.options.get("prefer") == "continuous":
        raise InputError(
            "prefer='continuous' goes row by row; a map has its rows answered side by side"
        )
    budget = Budget(rng=job.rng, threads=1)
    answer = assemble(job.system, job.by_name(rows), budget=budget, **job.options)
    return {
        "q": answer.q,
        "code": np.asarray(answer.code, dtype=np.uint8),
        "residual": answer.residual,
    }


VERBS = {
    "fk": Verb(_fk, ("form", "dtype"), 2**16, needs_frame=False),
    "ik": Verb(_ik, ("task", "start", "method", "tolerance"), 2**12),
    "ik_all": Verb(_ik_all, ("task", "start", "fixed", "limits", "tolerance"), 2**12),
    "assemble": Verb(
        _assemble, ("start", "branch", "prefer", "limits", "tolerance"), 2**12, needs_frame=False
    ),
}
"""The verbs that files can be mapped by."""

AXES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "q": (("coordinate",), "configuration", "rad or m, see unit"),
    "pose": (("matrix_row", "matrix_column"), "pose in the ground frame", "1, the last column m"),
    "position": (("axis",), "position in the ground frame", "m"),
    "position_quat_wxyz": (
        ("component",),
        "position and unit quaternion in the ground frame",
        "m and 1",
    ),
    "code": ((), "outcome", "1"),
    "position_error": ((), "position error of the answer", "m"),
    "orientation_error": ((), "angle of the rotation between target and answer", "rad"),
    "residual": ((), "norm of what is missed", "rad and m"),
    "inside": ((), "whether the solution is inside the limits", "1"),
    "count": ((), "number of solutions", "1"),
    "complete": ((), "whether there are no other isolated solutions", "1"),
}
"""Of each array the names of its last axes, what it is, and its unit."""


def axes_of(name: str, array: np.ndarray) -> tuple[str, ...]:
    """The names of the axes of an array: rows, then what there is several of, then those of its
    own.
    """
    own = AXES[name][0]
    several = "body" if name in ("pose", "position", "position_quat_wxyz") else "solution"
    return ("row", *([several] if array.ndim > len(own) + 1 else []), *own)


def job_of(
    system: System,
    verb: str,
    frame: Any,
    options: Mapping[str, Any] | None,
    source: Any,
    degrees: bool,
    rng: int,
) -> RowJob:
    """A verb with what it needs, checked on no rows. Errors: `InputError`, `UnknownNameError`,
    those of the verb.
    """
    chosen = VERBS[known("verb", verb, VERBS)]
    given = dict(options or {})
    for name in given:
        known(f"option of map {verb}", name, chosen.options)
    if verb == "assemble" and frame is not None:
        raise InputError("assemble needs no frame: known are coordinates")
    if chosen.needs_frame and frame is None:
        raise InputError(f"{verb} needs a frame")
    if given.get("start") is not None:
        start = as_start(system, given["start"])
        if np.ndim(start) != 1:
            raise InputError(f"start must be one configuration ({system.nq},)")
        if not np.isfinite(start).all():
            raise InputError(f"start is {start.tolist()}; its numbers must be finite")
    name = None if frame is None else system.structure.frame_name(frame)
    job = RowJob(system, verb, name, given, source.tail, source.names, degrees, rng)
    job.said()
    assert set(job.layout) <= set(AXES)
    return job
