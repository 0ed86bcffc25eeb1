"""Python functions that compiled kernels can call."""

from __future__ import annotations

import ctypes
import sys
import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.budget import check_for_stop
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.constraints.equations import Call
    from kempe.model.model import Model

STEP = 1e-3
"""Step of differences, in units of the velocities."""
WEIGHTS = ((1, 45.0 / 60.0), (2, -9.0 / 60.0), (3, 1.0 / 60.0))
"""Central differences of six points: their error is of the sixth order of the step (Fornberg,
1988)."""


_NUMBERS = ctypes.POINTER(ctypes.c_double)
_KIND = ctypes.CFUNCTYPE(None, _NUMBERS, _NUMBERS, _NUMBERS, ctypes.c_int64)


class KernelFunction:
    """A Python function of three arrays and a flag, at an `address` that kernels can call.

    No exception passes through a kernel: what the function raises is given to `keep`. So is Ctrl-C
    that comes while the kernel works: Python raises it before the first line of the function, and
    ctypes passes it on to `sys.unraisablehook`.
    """

    def __init__(
        self, work: Callable[[Any, Any, Any, int], None], keep: Callable[[BaseException], object]
    ):
        self.work = work
        self.keep = keep
        self._called = _KIND(self._call_work)
        self._address = int(ctypes.cast(self._called, ctypes.c_void_p).value or 0)
        _all.add(self)

    @property
    def address(self) -> int:
        """The memory address of the function, as kernels take it."""
        if sys.unraisablehook is not _keep_interrupt:
            _others[:] = [sys.unraisablehook]
            sys.unraisablehook = _keep_interrupt
        return self._address

    def _call_work(self, q: Any, out: Any, columns: Any, flag: int) -> None:
        """Call the Python function, and keep what it raises."""
        with self:
            self.work(q, out, columns, flag)

    def __enter__(self) -> None: ...

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> bool:
        if error is not None:
            self.keep(error)
        return True


_all = weakref.WeakSet[KernelFunction]()
_others: list[Callable[[sys.UnraisableHookArgs], object]] = []


def _keep_interrupt(lost: sys.UnraisableHookArgs) -> None:
    """Keep an interrupt of a `KernelFunction`: the hook for exceptions that Python cannot raise."""
    if isinstance(lost.exc_value, KeyboardInterrupt):
        for function in _all:
            is_it = getattr(lost.object, "__self__", None) is function
            # from Python 3.13 on it is in the text
            if is_it or repr(function._call_work) in (lost.err_msg or ""):
                function.keep(lost.exc_value)
                return
    # none where the other hook calls this one
    other = _others.pop() if _others else sys.__unraisablehook__
    try:
        other(lost)
    finally:
        _others[:] = [other]


class ConfigurationRows:
    """Base of constraints whose rows are one function of a whole configuration of one system."""

    def make_callback(self, rows: Sequence[int]) -> Callback:
        """Make a callback for kernels that gives some of the rows."""
        raise NotImplementedError

    def compute_row_values(self, q: Array) -> Array:
        """Compute the values (m,) of the rows at q (nq,)."""
        raise NotImplementedError


class Callback:
    """A function of q (nq,) that gives values (rows,) and derivatives (rows, n) to kernels.

    `alone` gives the values only. What it raises is kept in `error`, for no exception passes
    through a kernel. `scale` (nv,) are the units of the velocities, `support` the n of them that it
    depends on, by default all. See `kempe.constraints.Function`. `maker`, called with `of`, gives
    the same again: in another process,
    where it has another address.
    """

    maker: Callable[..., Callback] | None = None
    of: tuple[Any, ...] = ()

    def __init__(
        self,
        system: Model,
        rows: int,
        function: Callable[[Array], tuple[Any, Array]],
        support: Sequence[int] | None = None,
        alone: Callable[[Array], Any] | None = None,
    ):
        self.rows = rows
        self.error = None
        self.scale = np.ones(system.nv)
        self.support = tuple(range(system.nv)) if support is None else tuple(support)
        nq = system.nq
        own = list(self.support)
        shape = (len(self.support), rows)

        def write_values(q: Any, value: Any, columns: Any, flag: int) -> None:
            """Write the values at q into `value`, and with the flag the derivatives into `columns`."""
            out = np.ctypeslib.as_array(value, (rows,))
            out[:] = np.nan  # what stays where it raises
            if self.error is not None:  # the kernel goes on, and ends sooner
                return
            check_for_stop()
            x = np.ctypeslib.as_array(q, (nq,)).copy()
            if alone is not None and not flag:
                out[:] = alone(x)
                return
            found, J = function(x)
            if shape[0]:
                np.ctypeslib.as_array(columns, shape)[:] = (J * self.scale[own]).T
            out[:] = found

        self._called = KernelFunction(write_values, self._keep_error)
        self.address = self._called.address

    def _keep_error(self, error: BaseException) -> None:
        """Keep the first error, which is raised after the kernel."""
        self.error = self.error or error

    def remember_maker(self, maker: Callable[..., Callback], *of: Any) -> Callback:
        """Remember the function and arguments that make this callback again when it is unpickled."""
        self.maker = maker
        self.of = of
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return self.maker, self.of, {"scale": self.scale}

    @classmethod
    def from_call(
        cls, system: Model, call: Call, rows: Sequence[int], numbers: Mapping[str, float]
    ) -> Callback:
        """Make a callback of some numbers of a function of named coordinates.

        Derivatives are by differences.
        """
        first = system.structure.coordinates.first
        followers = system.structure.couplings
        read: dict[str, tuple[int, float, float]] = {}
        for name in (n for n in call.of if n not in numbers):
            f = followers.get(name)
            source, multiplier, offset = (
                (name, 1.0, 0.0) if f is None else (f.source, f.multiplier, f.offset)
            )
            read[name] = (-1 if source is None else first[source][0], multiplier, offset)
        places = {i: v for i, v in first.values()}
        used = list(dict.fromkeys(i for i, _, _ in read.values() if i >= 0))
        own = list(rows)

        def compute_values(q: Array) -> Array:
            """Compute the values at q."""
            given = {
                n: m * (q[i] if i >= 0 else 0.0) + offset for n, (i, m, offset) in read.items()
            }
            return call({**numbers, **given})[own]

        def compute_derivatives(q: Array) -> tuple[Array, Array]:
            """Compute the values at q, and their derivatives by differences."""
            found = compute_values(q)
            J = np.empty((len(own), len(used)))
            for k, i in enumerate(used):
                unit = STEP * made.scale[places[i]]
                x = q[i]
                total = np.zeros(len(own))
                for n, weight in WEIGHTS:
                    q[i] = x + n * unit
                    total += weight * compute_values(q)
                    q[i] = x - n * unit
                    total -= weight * compute_values(q)
                q[i] = x
                J[:, k] = total / unit
            return found, J

        made = cls(system, len(own), compute_derivatives, [places[i] for i in used], compute_values)
        return made.remember_maker(cls.from_call, system, call, rows, numbers)
