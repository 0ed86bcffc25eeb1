"""Systems with other parameter values: one system, or a batch of designs of one structure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Generic

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explain_errors, explain_method_errors
from kempe.arrays import check_range, read_reals
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.kernels.compiled import table_sweep
from kempe.model.configurations import read_q
from kempe.model.model import FrameLike, SystemType
from kempe.model.primitive_table import make_primitive_table
from kempe.spatial import Array
from kempe.values import Expression


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

    def __getitem__(self, index: Any) -> SystemType | Designs[SystemType]:
        """Return one design as a `System`, or a smaller batch."""
        varied = {k: v[index] for k, v in self.parameters.items() if isinstance(v, np.ndarray)}
        return with_parameters(self.system, varied)

    def __repr__(self) -> str:
        return f"Designs({self.system.name!r}, shape={self.shape})"
