"""Python functions recorded as tapes: run once on numbers that note what is done to them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from kempe.calls import FOREIGN
from kempe.constraints.builder import Builder
from kempe.constraints.tape import TIME, Tape
from kempe.errors import InputError, KempeError, UnknownNameError, shown
from kempe.kernels.constraints import tape_layout as L
from kempe.reals import is_array, is_sequence

POINTS = 12
"""Points at which a recorded function is compared with its tape."""


class NotRecorded(KempeError):
    """A function that cannot be recorded: it branches on values, or hands them to what takes plain
    numbers only.
    """


class Branches(KempeError):
    """Raised inside a function that asks a recording number for its value."""


class RecordedNumber:
    """A number that notes what is done to it. It has no value: comparisons and float() raise
    `Branches`.
    """

    __slots__ = ("_builder", "place")

    def __init__(self, builder: Builder, place: int):
        self._builder = builder
        self.place = place

    def _of(self, x: Any) -> int | None:
        """The place of another operand."""
        if isinstance(x, RecordedNumber):
            if x._builder is not self._builder:
                raise Branches("it keeps numbers of an earlier call")
            return x.place
        if is_array(x) and x.ndim == 0:
            return self._of(x.item())
        number: Any = x
        if isinstance(x, (bool, np.bool_)) or not isinstance(
            x, (int, float, np.integer, np.floating)
        ):
            return None
        return self._builder.number(float(number))

    def _binary(self, op: int, left: object, right: object) -> Any:
        if isinstance(left, np.ndarray) or isinstance(right, np.ndarray):
            a, b = np.broadcast_arrays(
                np.asarray(left, dtype=object), np.asarray(right, dtype=object)
            )
            if a.ndim:
                out = np.empty(a.shape, dtype=object)
                for i in np.ndindex(*a.shape):
                    out[i] = self._binary(op, a[i], b[i])
                return out
            left = a.item()
            right = b.item()
        a = self._of(left)
        b = self._of(right)
        if a is None or b is None:
            return NotImplemented
        return RecordedNumber(self._builder, self._builder.binary(op, a, b))

    def _unary(self, op: int) -> RecordedNumber:
        return RecordedNumber(self._builder, self._builder.unary(op, self.place))

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method == "__call__" and not options:
            if ufunc in _UFUNCS_2:
                return self._binary(_UFUNCS_2[ufunc], *inputs)
            if ufunc in _UFUNCS:
                return _UFUNCS[ufunc](inputs[0])
        raise Branches(f"numpy.{ufunc.__name__} cannot be recorded")

    def __add__(self, other: object) -> Any:
        return self._binary(L.ADD, self, other)

    def __radd__(self, other: object) -> Any:
        return self._binary(L.ADD, other, self)

    def __sub__(self, other: object) -> Any:
        return self._binary(L.SUB, self, other)

    def __rsub__(self, other: object) -> Any:
        return self._binary(L.SUB, other, self)

    def __mul__(self, other: object) -> Any:
        return self._binary(L.MUL, self, other)

    def __rmul__(self, other: object) -> Any:
        return self._binary(L.MUL, other, self)

    def __truediv__(self, other: object) -> Any:
        return self._binary(L.DIV, self, other)

    def __rtruediv__(self, other: object) -> Any:
        return self._binary(L.DIV, other, self)

    def __pow__(self, other: object) -> Any:
        return self._binary(L.POW, self, other)

    def __rpow__(self, other: object) -> Any:
        return self._binary(L.POW, other, self)

    def __neg__(self) -> RecordedNumber:
        return self._unary(L.NEG)

    def __pos__(self) -> RecordedNumber:
        return self

    def conjugate(self) -> RecordedNumber:
        """Itself: it is real."""
        return self

    def _raise(self, what: str) -> Any:
        raise Branches(f"it {what}")

    def __bool__(self) -> bool:
        return self._raise("branches on a value (if, and, or, not, min, max, a comparison)")

    def __lt__(self, other: object) -> bool:
        return self._raise("compares a value")

    __le__ = __gt__ = __ge__ = __eq__ = __ne__ = __lt__  # type: ignore[assignment]

    def __hash__(self) -> int:
        return self._raise("uses a value as a key")

    def __float__(self) -> float:
        return self._raise(
            "asks for a plain number (float(), or a function of math: use that of numpy)"
        )

    __int__ = __index__ = __complex__ = __float__  # type: ignore[assignment]

    def __abs__(self) -> RecordedNumber:
        return self._raise("uses abs(), which has a corner")

    def __mod__(self, other: object) -> Any:
        return self._raise("uses a remainder or rounds, which jumps")

    __rmod__ = __floordiv__ = __rfloordiv__ = __divmod__ = __rdivmod__ = __mod__

    def __round__(self, digits: int = 0) -> Any:
        return self.__mod__(1)

    __floor__ = __ceil__ = __trunc__ = __round__


def _method(op: int) -> Callable[[RecordedNumber, object], Any]:
    return lambda x, other: x._binary(op, x, other)


def _scaled(factor: float, op: int | None = None) -> Callable[[RecordedNumber], Any]:
    return lambda x: (x if op is None else x._unary(op)) * factor


_UFUNCS_2: dict[np.ufunc, int] = {
    np.add: L.ADD,
    np.subtract: L.SUB,
    np.multiply: L.MUL,
    np.divide: L.DIV,
    np.power: L.POW,
    np.float_power: L.POW,
    np.arctan2: L.ATAN2,
    np.hypot: L.HYPOT,
}
_UFUNCS: dict[np.ufunc, Callable[[RecordedNumber], Any]] = {
    f: (lambda x, op=op: x._unary(op))
    for f, op in {
        np.negative: L.NEG,
        np.exp: L.EXP,
        np.log: L.LOG,
        np.sqrt: L.SQRT,
        np.sin: L.SIN,
        np.cos: L.COS,
        np.tan: L.TAN,
        np.arcsin: L.ASIN,
        np.arccos: L.ACOS,
        np.arctan: L.ATAN,
        np.sinh: L.SINH,
        np.cosh: L.COSH,
        np.tanh: L.TANH,
        np.arcsinh: L.ASINH,
        np.arccosh: L.ACOSH,
        np.arctanh: L.ATANH,
    }.items()
}
_UFUNCS |= {
    np.positive: lambda x: x,
    np.conjugate: lambda x: x,
    np.square: lambda x: x * x,
    np.reciprocal: lambda x: 1.0 / x,
    np.deg2rad: _scaled(np.pi / 180.0),
    np.radians: _scaled(np.pi / 180.0),
    np.rad2deg: _scaled(180.0 / np.pi),
    np.degrees: _scaled(180.0 / np.pi),
    np.log10: _scaled(float(1.0 / np.log(10.0)), L.LOG),
    np.log2: _scaled(float(1.0 / np.log(2.0)), L.LOG),
    np.exp2: lambda x: (x * float(np.log(2.0)))._unary(L.EXP),
    np.expm1: lambda x: x._unary(L.EXP) - 1.0,
    np.log1p: lambda x: (1.0 + x)._unary(L.LOG),
}

for (
    _ufunc,
    _make,
) in _UFUNCS.items():  # an array of objects calls the method of this name on each of them
    if not hasattr(RecordedNumber, _ufunc.__name__):
        setattr(RecordedNumber, _ufunc.__name__, _make)
for _ufunc, _op in _UFUNCS_2.items():
    setattr(RecordedNumber, _ufunc.__name__, _method(_op))


class _Named(dict[Any, Any]):
    """The inputs of a function by name. Errors: `UnknownNameError` for a name that was not
    declared.
    """

    def __missing__(self, name: object) -> Any:
        raise UnknownNameError("input", name, self, "the function asks for an undeclared name:")


def record(
    function: Callable[..., Any],
    inputs: Collection[str],
    *,
    time: bool = False,
    what: str = "the function",
) -> tuple[Tape, tuple[int, ...]]:
    """The tape of a Python function of named inputs, and the shape of what it returns; the tape has
    it row by row.

    function: called with a mapping from names to numbers, with `time` also with the time t, which
    is then the tape's input "t"; it returns a number, a list or array of numbers, or rows of equal
    length. numpy's functions are recorded. The tape's inputs are those that the result depends on,
    in the order of `inputs`.

    Errors: `NotRecorded` with the reason, where a callback is what remains; `InputError` for
    functions that raise, return anything else, or give different answers for the same numbers, with
    the call that showed it; `UnknownNameError` for a name that is not among the inputs.
    """
    names = list(inputs)
    if time and TIME in names:
        raise InputError(
            f"{what} has an input {TIME!r} besides the time, which is called so; rename the input"
        )
    names += [TIME] * time
    try:
        tape, shape = _once(function, names, time)
        again = _once(function, names, time)
    except InputError as error:
        raise InputError(f"{what}: {error}") from None
    except Branches as error:
        probe(function, names, time, what)
        raise NotRecorded(f"{what} cannot be recorded: {error}") from None
    except FOREIGN as error:
        if isinstance(error, KempeError):
            raise
        probe(function, names, time, what)
        raise NotRecorded(f"{what} cannot be recorded: {type(error).__name__}: {error}") from None
    if again != (tape, shape):
        raise InputError(
            f"{what} is not the same function when it is called again: it depends on hidden state"
        )
    _compared(function, tape, shape, names, time, what)
    return tape, shape


def _once(
    function: Callable[..., Any], names: list[str], time: bool
) -> tuple[Tape, tuple[int, ...]]:
    builder = Builder(names)
    recorded = _Named({name: RecordedNumber(builder, i) for i, name in enumerate(names)})
    found = function(recorded, recorded.pop(TIME)) if time else function(recorded)
    entries, shape = _entries(found)
    places: list[int] = []
    for entry in entries:
        if isinstance(entry, RecordedNumber):
            if entry._builder is not builder:
                raise Branches("it returns numbers of an earlier call")
            places.append(entry.place)
        else:
            places.append(builder.number(entry))
    return builder.finish(places), shape


def _entries(found: Any) -> tuple[list[Any], tuple[int, ...]]:
    """The numbers of what a function returned, row by row, and its shape. Errors: `InputError`."""
    if isinstance(found, np.ndarray):
        found = found.tolist()
    if is_sequence(found):
        parts = [_entries(part) for part in found]
        if not parts:
            raise InputError("it returns an empty list")
        shapes = {shape for _, shape in parts}
        if len(shapes) > 1 or any(len(shape) > 1 for shape in shapes):
            raise InputError(
                "it returns lists of different lengths, or deeper than rows of numbers"
            )
        return [x for entries, _ in parts for x in entries], (len(parts), *next(iter(shapes), ()))
    if isinstance(found, RecordedNumber):
        return [found], ()
    number: Any = found
    if isinstance(found, (int, float, np.integer, np.floating)) and not isinstance(found, bool):
        return [float(number)], ()
    raise InputError(
        f"it returns {shown(found)}; it must return a number, a list of numbers, or rows of numbers"
    )


def called(
    function: Callable[..., Any], values: Mapping[str, float], time: bool, what: str
) -> tuple[np.ndarray, tuple[int, ...]]:
    """What a function returns for plain numbers, row by row, and its shape. Errors: `InputError`
    with the call.
    """
    given = _Named({name: np.float64(x) for name, x in values.items()})
    try:
        with np.errstate(all="ignore"):
            found = function(given, given.pop(TIME)) if time else function(given)
        entries, shape = _entries(found)
        numbers = np.array(entries, dtype=np.float64)
    except InputError as error:
        raise InputError(f"{what} at {at(values)}: {error}") from None
    except Branches:
        kept = "numbers of an earlier call: it depends on hidden state"
        raise InputError(f"{what} returns at {at(values)} {kept}") from None
    except KempeError:
        raise
    except FOREIGN as error:
        raise InputError(
            f"{what} raised {type(error).__name__} at {at(values)}: {error}"
        ) from error
    return numbers, shape


def at(values: Mapping[str, float]) -> str:
    """The call as a reader repeats it: ``A = 0.1, B = 2.0``."""
    return ", ".join(f"{name} = {float(x)!r}" for name, x in values.items()) or "no inputs"


def points(names: Collection[str]) -> list[dict[str, float]]:
    """Values of the inputs to try: the same ones on every call."""
    rng = np.random.default_rng(len(names))
    spread = [0.5, 1.0, 0.1, 3.0]
    return [{name: float(rng.normal(0.0, spread[k % 4])) for name in names} for k in range(POINTS)]


def probe(
    function: Callable[..., Any], names: Collection[str], time: bool, what: str
) -> tuple[int, ...]:
    """The shape of what a function returns for plain numbers.

    Errors: `InputError` with the call, where it fails or gives NaN wherever it is tried, and where
    it answers the same call in two ways.
    """
    failures: list[InputError] = []
    found: list[tuple[np.bool_, tuple[Any, ...], dict[str, float]]] = []
    for values in points(names):
        try:
            entries, shape = called(function, values, time, what)
        except InputError as error:
            if not isinstance(error.__cause__, FOREIGN):
                raise
            failures.append(error)
            continue
        again, _ = called(function, values, time, what)
        if not np.array_equal(entries, again, equal_nan=True):
            raise InputError(
                f"{what} gives {entries.tolist()} at {at(values)}, and {again.tolist()} when it is "
                "called again: it depends on hidden state"
            )
        found.append((np.isfinite(entries).all(), shape, values))
    if not found:
        raise failures[0]
    shapes = {shape for _, shape, _ in found}
    if len(shapes) > 1:
        raise InputError(f"{what} returns arrays of different shapes: {sorted(shapes)}")
    if not any(finite for finite, _, _ in found):
        where = at(found[0][2])
        raise InputError(
            f"{what} gives numbers that are not finite wherever it was tried, such as at {where}"
        )
    return shapes.pop()


def _compared(
    function: Callable[..., Any],
    tape: Tape,
    shape: tuple[int, ...],
    names: list[str],
    time: bool,
    what: str,
) -> None:
    """Compare the tape with the function itself. Errors: `InputError` with the call where they
    differ.
    """
    for values in points(names):
        expected = tape.evaluate(values)
        try:
            found, size = called(function, values, time, what)
        except InputError as error:
            if isinstance(
                error.__cause__, ArithmeticError
            ):  # not defined there: the tape says NaN or infinity
                continue
            raise
        known = (
            np.isfinite(found) & np.isfinite(expected) if size == shape else np.zeros(1, dtype=bool)
        )
        scale = 1e-6 * (1.0 + np.abs(found)) if size == shape else 1.0
        if size != shape or np.any(
            np.abs(found - expected)[known] > np.broadcast_to(scale, known.shape)[known]
        ):
            raise InputError(
                f"{what} gives {found.tolist()} at {at(values)}, and {expected.tolist()} when it "
                "was recorded: it depends on hidden state"
            )
