"""Systems with other parameter values: one system, or a batch of designs of one structure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.known_values import find_source_values
from kempe.arguments import explain_errors, explain_method_errors
from kempe.arrays import check_range, read_reals
from kempe.assemble.dyads import Incomplete, Plan, decompose_designs, find_closed_form
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.kernels.compiled import table_sweep
from kempe.model.configurations import read_q, read_start, refuse_large_numbers
from kempe.model.model import FrameLike, SystemType
from kempe.model.primitive_table import make_primitive_table
from kempe.report import Report
from kempe.spatial import Array
from kempe.status import Status, to_status
from kempe.values import Expression
from kempe.words import format_count


@explain_errors
def with_parameters(
    system: SystemType, numbers: Mapping[str, Any]
) -> SystemType | Designs[SystemType]:
    """Return the system with other parameter values, or `Designs`; see `System.with_parameters`."""
    arrays: dict[str, np.ndarray] = {}
    for name, x in numbers.items():
        if name not in system.structure.parameters:
            raise UnknownNameError("parameter", name, system.structure.parameters, system.name)
        arrays[name] = read_reals(x, f"parameter {name!r}", "a number or an array of numbers")
        check_range(arrays[name], f"parameter {name!r}")
    try:
        shape = np.broadcast_shapes(*(x.shape for x in arrays.values()))
    except ValueError:
        shapes = ", ".join(f"{k} {v.shape}" for k, v in arrays.items())
        raise InputError(f"shapes of the parameters do not fit together: {shapes}") from None
    if shape:
        return Designs(system, arrays)
    mechanism = system.mechanism
    mechanism.parameters |= {k: float(v) for k, v in arrays.items()}
    return type(system)(mechanism, system.structure.topology)


@dataclass(frozen=True, eq=False, repr=False)
class DesignAssembly(Report):
    """Configurations that close the loops of a batch of designs, on one branch.

    Attributes
    ----------
    q
        Configurations (*shape, ..., nq) in radians and metres. Where the loops of a design do not
        close, `q` is where they nearly touch; where a value is no number, it is NaN.
    gap
        Distances (*shape, ...) in metres by which joints stay open.
    undetermined
        How many parts (*shape, ...) have infinitely many positions, one of which was taken: links
        without length, circles with one centre, parallel lines.
    code
        Outcomes (*shape, ...); `success` is the mask of those that closed. Where a design does not
        close on this branch, it may on another one.
    """

    _entries = ("gap", "undetermined")

    q: Array
    gap: Array
    undetermined: np.ndarray
    code: Any

    @property
    def status(self) -> str:
        """Sentence that says how many configurations closed."""
        count = int(np.count_nonzero(self.success))
        said = f"{count} of {format_count(self.success.size, 'configuration')} closed"
        left = self.gap[~self.success & np.isfinite(self.gap)]
        return said + (f"; the others are open by up to {left.max():.6g} m" if left.size else "")


@explain_method_errors
class Designs(Generic[SystemType]):
    """Batch of designs: one system with arrays of parameter values.

    Attributes
    ----------
    system
        The system.
    parameters
        Values by parameter name; arrays have the shape `shape`.
    shape
        Shape of the batch.
    """

    def __init__(self, system: SystemType, numbers: Mapping[str, ArrayLike]):
        arrays = np.broadcast_arrays(*numbers.values())
        self.system = system
        self.shape = arrays[0].shape
        self.parameters = {**system.structure.parameters, **dict(zip(numbers, arrays, strict=True))}
        for coupling in system.mechanism.couplings.values():
            terms = (*coupling.sources.values(), coupling.offset)
            used = {n for v in terms if isinstance(v, Expression) for n in v.names if n in numbers}
            if used:
                raise UnsupportedError(
                    f"the coupling of {coupling.of!r} depends on {', '.join(sorted(used))}: "
                    "a batch of designs must share its couplings"
                )
        self._table = make_primitive_table(
            system.mechanism,
            system.structure.topology,
            system.structure.coordinates,
            self.parameters,
        )

    def fk(self, q: Any, frame: FrameLike) -> Array:
        """Compute the poses of a frame for every design and configuration.

        Parameters
        ----------
        q
            One configuration (nq,) for all designs, or configurations (*shape, ..., nq) of each
            design.
        frame
            Name of the body or frame.

        Returns
        -------
        Array
            Poses (*shape, ..., 4, 4).

        Raises
        ------
        InputError
            For wrong shapes.
        UnknownNameError
            If there is no such frame.
        """
        name = self.system.structure.frame_name(frame)
        ints, floats = self._table.pack_arrays([name])
        q = read_q(self.system, q)
        k = len(self.shape)
        if q.ndim == 1:
            q = np.broadcast_to(q, (*self.shape, self.system.nq))
        if q.shape[:k] != self.shape:
            raise InputError(
                f"q has shape {q.shape}; it must be ({self.system.nq},) or begin with {self.shape}"
            )
        inner = q.shape[k:-1]
        designs = math.prod(self.shape)
        each = math.prod(inner)
        flat_q = np.ascontiguousarray(q).reshape(designs, each, self.system.nq)
        floats = np.broadcast_to(floats, (*self.shape, floats.shape[-1])).reshape(
            designs, floats.shape[-1]
        )
        out = np.empty((designs, each, 1, 4, 4))
        for i in range(designs):
            table_sweep.compute_poses(ints, floats[i], flat_q[i], out[i])
        return out.reshape(*self.shape, *inner, 4, 4)

    def assemble(
        self,
        known: Mapping[str, Any],
        *,
        branch: str | None = None,
        start: Any = None,
        threads: int | None = None,
    ) -> DesignAssembly:
        """Close the loops of every design on one branch, for known coordinates.

        Parameters
        ----------
        known
            Values in radians and metres by coordinate name: one number for all designs, or arrays
            (*shape, ...) with values of each design. An axis of length 1 in `shape` stands for all
            designs: of n designs, (1, 100) is the same hundred values for each.
        branch
            Branch signs, such as '+-' (see `assembly_modes`). Default: the branch of `start`, else
            + everywhere.
        start
            Configuration (nq,) or values by name; angles are the nearest to it. Default: the
            posture 'closed', if the system has one, else zero.
        threads
            Number of threads (default: all processors).

        Returns
        -------
        DesignAssembly
            Configurations `q` (*shape, ..., nq), and which of them closed.

        Raises
        ------
        InputError
            For wrong shapes or values, and for a branch that the mechanism does not have.
        UnknownNameError
            If there is no such coordinate.
        UnsupportedError
            If the mechanism is not one of dyads: bodies in the plane on revolute and prismatic
            joints, each pair of which is placed by an intersection of circles and lines.

        Notes
        -----
        Limits do not count. Method: intersections of circles and lines (Assur, 1914), for all
        designs by one decomposition. Pins that coincide in some designs only are not merged there:
        such a design may have `undetermined` parts.

        Examples
        --------
        >>> import kempe
        >>> import numpy as np
        >>> designs = kempe.load("four_bar").with_parameters(b=np.linspace(0.3, 0.7, 5))
        >>> answer = designs.assemble({"A": np.linspace(0.0, 3.0, 4)[None]}, branch="+")
        >>> answer.q.shape, answer.status
        ((5, 4, 4), '20 of 20 configurations closed')
        """
        values = find_source_values(self.system, known)
        plan, ordinary = self._decompose(tuple(values))
        rows = self._read_rows(values)
        if start is None and "closed" in self.system.structure.posture_names:
            start = "closed"
        near = np.zeros(self.system.nq) if start is None else read_start(self.system, start)
        refuse_large_numbers(self.system, near, "start")
        of_start = near if start is not None and branch is None else None
        signs = ordinary.sign_rows(branch, of_start, ())
        flat = np.ascontiguousarray(rows.reshape(-1, rows.shape[-1]))
        q, status = plan._run_program(flat, np.atleast_2d(signs), np.atleast_2d(near), threads)
        lead = rows.shape[:-1]
        gap = status[:, 0].reshape(lead)
        within = np.broadcast_to(plan.tolerance, math.prod(self.shape)).reshape(self.shape)
        closed = gap <= within.reshape(*self.shape, *(1,) * (gap.ndim - within.ndim))
        closed &= np.isfinite(rows).all(axis=-1)
        code = np.where(np.isfinite(gap), Status.NOT_FOUND, Status.BAD_INPUT)
        return DesignAssembly(
            q.reshape(*lead, self.system.nq),
            gap,
            status[:, 1].astype(int).reshape(lead),
            to_status(np.where(closed, Status.SOLVED, code)),
        )

    def _decompose(self, known: tuple[str, ...]) -> tuple[Plan, Plan]:
        """Decompose all designs into dyads, and the system with its own parameters.

        Errors: `UnsupportedError`.
        """
        ordinary = find_closed_form(self.system, known)
        if isinstance(ordinary, Incomplete):
            raise UnsupportedError(f"{ordinary.reason}; designs are assembled in closed form only")
        numbers = {
            k: x.reshape(-1) if isinstance(x, np.ndarray) else x for k, x in self.parameters.items()
        }
        if not math.prod(self.shape):
            return ordinary, ordinary
        plan = decompose_designs(self.system, known, numbers)
        if isinstance(plan, Incomplete) or [d.joints for d in plan.dyads] != [
            d.joints for d in ordinary.dyads
        ]:
            raise UnsupportedError(
                "pins coincide, or rails are parallel, in some of the designs only; assemble those "
                "apart from the others"
            )
        return plan, ordinary

    def _read_rows(self, values: Mapping[str, Array]) -> Array:
        """Read known values as rows (*shape, ..., n_known). Errors: `InputError`."""
        k = len(self.shape)
        shapes = {name: np.shape(x) for name, x in values.items()}
        inner = max((len(s) - k for s in shapes.values() if s), default=0)
        try:
            full = [
                np.broadcast_to(
                    x.reshape(*s[:k], *(1,) * (k + inner - len(s)), *s[k:]) if s else x,
                    (*self.shape, *np.broadcast_shapes(*(s[k:] for s in shapes.values()))),
                )
                for x, s in zip(values.values(), shapes.values(), strict=True)
            ]
        except ValueError:
            said = ", ".join(f"{name!r} has shape {s}" for name, s in shapes.items())
            raise InputError(
                f"{said}; known values must be one number, or begin with {self.shape}, where 1 in "
                "place of a number is for all designs"
            ) from None
        return np.stack(full, axis=-1) if full else np.empty((*self.shape, 0))

    def __getitem__(self, index: Any) -> SystemType | Designs[SystemType]:
        """Return one design as a `System`, or a smaller batch."""
        varied = {k: v[index] for k, v in self.parameters.items() if isinstance(v, np.ndarray)}
        return with_parameters(self.system, varied)

    def __repr__(self) -> str:
        return f"Designs({self.system.name!r}, shape={self.shape})"
