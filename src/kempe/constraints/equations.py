"""Kinds that the user writes: equations, inequalities and velocity equations of coordinates.

They are text, or Python functions, which are recorded once as text where that is possible.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np

from kempe.arguments import FOREIGN, read_distinct_names, read_flag
from kempe.arrays import is_array, is_sequence
from kempe.constraints.base import LARGEST, Bounded, Constraint, Names, Op, Row, kind
from kempe.constraints.builder import Builder, rename_inputs, scale_inputs
from kempe.constraints.tape import RATE, TIME, Tape, quote_name
from kempe.constraints.text import is_text_tuple, parse_expression, parse_tape
from kempe.errors import InputError, KempeError, UnknownNameError, format_value
from kempe.kernels.constraints import tape_layout as L
from kempe.values import Expression
from kempe.words import format_count

# ---- recording functions

# A function is run once on numbers that note what is done to them; the result is a tape.

POINTS = 12
"""Points at which a recorded function is compared with its tape."""


class NotRecorded(KempeError):
    """Error for a function that cannot be recorded.

    It branches on values, or hands them to a function that takes plain numbers only.
    """


class Branches(KempeError):
    """Error inside a function that asks a recording number for its value."""


class RecordedNumber:
    """A number without a value that records the operations on it.

    Comparisons and float() raise `Branches`.
    """

    __slots__ = ("_builder", "place")

    def __init__(self, builder: Builder, place: int):
        self._builder = builder
        self.place = place

    def _place_operand(self, x: Any) -> int | None:
        """Return the place of another operand, or None where it is no number."""
        if isinstance(x, RecordedNumber):
            if x._builder is not self._builder:
                raise Branches("it keeps numbers of an earlier call")
            return x.place
        if is_array(x) and x.ndim == 0:
            return self._place_operand(x.item())
        number: Any = x
        if isinstance(x, (bool, np.bool_)) or not isinstance(
            x, (int, float, np.integer, np.floating)
        ):
            return None
        return self._builder.add_number(float(number))

    def _record_binary(self, op: int, left: object, right: object) -> Any:
        """Record an operation with two operands, which may be arrays."""
        if isinstance(left, np.ndarray) or isinstance(right, np.ndarray):
            a, b = np.broadcast_arrays(
                np.asarray(left, dtype=object), np.asarray(right, dtype=object)
            )
            if a.ndim:
                out = np.empty(a.shape, dtype=object)
                for i in np.ndindex(*a.shape):
                    out[i] = self._record_binary(op, a[i], b[i])
                return out
            left = a.item()
            right = b.item()
        a = self._place_operand(left)
        b = self._place_operand(right)
        if a is None or b is None:
            return NotImplemented
        return RecordedNumber(self._builder, self._builder.add_binary(op, a, b))

    def _record_unary_operation(self, op: int) -> RecordedNumber:
        """Record an operation with this number as operand."""
        return RecordedNumber(self._builder, self._builder.add_unary(op, self.place))

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method == "__call__" and not options:
            if ufunc in _UFUNCS_2:
                return self._record_binary(_UFUNCS_2[ufunc], *inputs)
            if ufunc in _UFUNCS:
                return _UFUNCS[ufunc](inputs[0])
        raise Branches(f"numpy.{ufunc.__name__} cannot be recorded")

    def __add__(self, other: object) -> Any:
        return self._record_binary(L.ADD, self, other)

    def __radd__(self, other: object) -> Any:
        return self._record_binary(L.ADD, other, self)

    def __sub__(self, other: object) -> Any:
        return self._record_binary(L.SUB, self, other)

    def __rsub__(self, other: object) -> Any:
        return self._record_binary(L.SUB, other, self)

    def __mul__(self, other: object) -> Any:
        return self._record_binary(L.MUL, self, other)

    def __rmul__(self, other: object) -> Any:
        return self._record_binary(L.MUL, other, self)

    def __truediv__(self, other: object) -> Any:
        return self._record_binary(L.DIV, self, other)

    def __rtruediv__(self, other: object) -> Any:
        return self._record_binary(L.DIV, other, self)

    def __pow__(self, other: object) -> Any:
        return self._record_binary(L.POW, self, other)

    def __rpow__(self, other: object) -> Any:
        return self._record_binary(L.POW, other, self)

    def __neg__(self) -> RecordedNumber:
        return self._record_unary_operation(L.NEG)

    def __pos__(self) -> RecordedNumber:
        return self

    def conjugate(self) -> RecordedNumber:
        """Return the number itself, which is real."""
        return self

    def _refuse_use(self, what: str) -> Any:
        """Refuse a use that needs a value, by `Branches`."""
        raise Branches(f"it {what}")

    def __bool__(self) -> bool:
        return self._refuse_use("branches on a value (if, and, or, not, min, max, a comparison)")

    def __lt__(self, other: object) -> bool:
        return self._refuse_use("compares a value")

    __le__ = __gt__ = __ge__ = __eq__ = __ne__ = __lt__  # type: ignore[assignment]

    def __hash__(self) -> int:
        return self._refuse_use("uses a value as a key")

    def __float__(self) -> float:
        return self._refuse_use(
            "asks for a plain number (float(), or a function of math: use that of numpy)"
        )

    __int__ = __index__ = __complex__ = __float__  # type: ignore[assignment]

    def __abs__(self) -> RecordedNumber:
        return self._refuse_use("uses abs(), which has a corner")

    def __mod__(self, other: object) -> Any:
        return self._refuse_use("uses a remainder or rounds, which jumps")

    __rmod__ = __floordiv__ = __rfloordiv__ = __divmod__ = __rdivmod__ = __mod__

    def __round__(self, digits: int = 0) -> Any:
        return self.__mod__(1)

    __floor__ = __ceil__ = __trunc__ = __round__


def _make_method(op: int) -> Callable[[RecordedNumber, object], Any]:
    """Make a method that records an operation with two operands."""
    return lambda x, other: x._record_binary(op, x, other)


def _make_scaled_method(factor: float, op: int | None = None) -> Callable[[RecordedNumber], Any]:
    """Make a method that records a function of the number times a factor."""
    return lambda x: (x if op is None else x._record_unary_operation(op)) * factor


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
    f: (lambda x, op=op: x._record_unary_operation(op))
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
    np.deg2rad: _make_scaled_method(np.pi / 180.0),
    np.radians: _make_scaled_method(np.pi / 180.0),
    np.rad2deg: _make_scaled_method(180.0 / np.pi),
    np.degrees: _make_scaled_method(180.0 / np.pi),
    np.log10: _make_scaled_method(float(1.0 / np.log(10.0)), L.LOG),
    np.log2: _make_scaled_method(float(1.0 / np.log(2.0)), L.LOG),
    np.exp2: lambda x: (x * float(np.log(2.0)))._record_unary_operation(L.EXP),
    np.expm1: lambda x: x._record_unary_operation(L.EXP) - 1.0,
    np.log1p: lambda x: (1.0 + x)._record_unary_operation(L.LOG),
}

for (
    _ufunc,
    _make,
) in _UFUNCS.items():  # an array of objects calls the method of this name on each of them
    if not hasattr(RecordedNumber, _ufunc.__name__):
        setattr(RecordedNumber, _ufunc.__name__, _make)
for _ufunc, _op in _UFUNCS_2.items():
    setattr(RecordedNumber, _ufunc.__name__, _make_method(_op))


class _Named(dict[Any, Any]):
    """The inputs of a function by name.

    Errors: `UnknownNameError` for a name that was not declared.
    """

    def __missing__(self, name: object) -> Any:
        raise UnknownNameError("input", name, self, "the function asks for an undeclared name:")


def record_function(
    function: Callable[..., Any],
    inputs: Collection[str],
    *,
    time: bool = False,
    what: str = "the function",
) -> tuple[Tape, tuple[int, ...]]:
    """Record a Python function of named inputs as a tape.

    Returned are the tape, whose outputs are the values row by row, and their shape.

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
        tape, shape = _record_function_call(function, names, time)
        again = _record_function_call(function, names, time)
    except InputError as error:
        raise InputError(f"{what}: {error}") from None
    except Branches as error:
        find_shape(function, names, time, what)
        raise NotRecorded(f"{what} cannot be recorded: {error}") from None
    except FOREIGN as error:
        if isinstance(error, KempeError):
            raise
        find_shape(function, names, time, what)
        raise NotRecorded(f"{what} cannot be recorded: {type(error).__name__}: {error}") from None
    if again != (tape, shape):
        raise InputError(
            f"{what} is not the same function when it is called again: it depends on hidden state"
        )
    _compare_tape(function, tape, shape, names, time, what)
    return tape, shape


def _record_function_call(
    function: Callable[..., Any], names: list[str], time: bool
) -> tuple[Tape, tuple[int, ...]]:
    """Record one call of the function: the tape, and the shape of the values."""
    builder = Builder(names)
    recorded = _Named({name: RecordedNumber(builder, i) for i, name in enumerate(names)})
    found = function(recorded, recorded.pop(TIME)) if time else function(recorded)
    entries, shape = _flatten_entries(found)
    places: list[int] = []
    for entry in entries:
        if isinstance(entry, RecordedNumber):
            if entry._builder is not builder:
                raise Branches("it returns numbers of an earlier call")
            places.append(entry.place)
        else:
            places.append(builder.add_number(entry))
    return builder.finish_tape(places), shape


def _flatten_entries(found: Any) -> tuple[list[Any], tuple[int, ...]]:
    """Return the numbers that a function returned, row by row, and their shape.

    Errors: `InputError`.
    """
    if isinstance(found, np.ndarray):
        found = found.tolist()
    if is_sequence(found):
        parts = [_flatten_entries(part) for part in found]
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
        f"it returns {format_value(found)}; it must return a number, a list of numbers, or rows of "
        "numbers"
    )


def call_function(
    function: Callable[..., Any], values: Mapping[str, float], time: bool, what: str
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Call a function with plain numbers, and return its values row by row and their shape.

    Errors: `InputError` with the call.
    """
    given = _Named({name: np.float64(x) for name, x in values.items()})
    try:
        with np.errstate(all="ignore"):
            found = function(given, given.pop(TIME)) if time else function(given)
        entries, shape = _flatten_entries(found)
        numbers = np.array(entries, dtype=np.float64)
    except InputError as error:
        raise InputError(f"{what} at {format_inputs(values)}: {error}") from None
    except Branches:
        kept = "numbers of an earlier call: it depends on hidden state"
        raise InputError(f"{what} returns at {format_inputs(values)} {kept}") from None
    except KempeError:
        raise
    except FOREIGN as error:
        raise InputError(
            f"{what} raised {type(error).__name__} at {format_inputs(values)}: {error}"
        ) from error
    return numbers, shape


def format_inputs(values: Mapping[str, float]) -> str:
    """Return values of inputs as text: ``A = 0.1, B = 2.0``."""
    return ", ".join(f"{name} = {float(x)!r}" for name, x in values.items()) or "no inputs"


def sample_inputs(names: Collection[str]) -> list[dict[str, float]]:
    """Return values of the inputs to try, the same ones on every call."""
    rng = np.random.default_rng(len(names))
    spread = [0.5, 1.0, 0.1, 3.0]
    return [{name: float(rng.normal(0.0, spread[k % 4])) for name in names} for k in range(POINTS)]


def find_shape(
    function: Callable[..., Any], names: Collection[str], time: bool, what: str
) -> tuple[int, ...]:
    """Find the shape of the values of a function by calls with plain numbers.

    Errors: `InputError` with the call, where it fails or gives NaN wherever it is tried, and where
    it answers the same call in two ways.
    """
    failures: list[InputError] = []
    found: list[tuple[np.bool_, tuple[Any, ...], dict[str, float]]] = []
    for values in sample_inputs(names):
        try:
            entries, shape = call_function(function, values, time, what)
        except InputError as error:
            if not isinstance(error.__cause__, FOREIGN):
                raise
            failures.append(error)
            continue
        again, _ = call_function(function, values, time, what)
        if not np.array_equal(entries, again, equal_nan=True):
            raise InputError(
                f"{what} gives {entries.tolist()} at {format_inputs(values)}, and {again.tolist()} when it is "
                "called again: it depends on hidden state"
            )
        found.append((np.isfinite(entries).all(), shape, values))
    if not found:
        raise failures[0]
    shapes = {shape for _, shape, _ in found}
    if len(shapes) > 1:
        raise InputError(f"{what} returns arrays of different shapes: {sorted(shapes)}")
    if not any(finite for finite, _, _ in found):
        where = format_inputs(found[0][2])
        raise InputError(
            f"{what} gives numbers that are not finite wherever it was tried, such as at {where}"
        )
    return shapes.pop()


def _compare_tape(
    function: Callable[..., Any],
    tape: Tape,
    shape: tuple[int, ...],
    names: list[str],
    time: bool,
    what: str,
) -> None:
    """Compare the tape with the function itself.

    Errors: `InputError` with the call where they differ.
    """
    for values in sample_inputs(names):
        expected = tape.evaluate_outputs(values)
        try:
            found, size = call_function(function, values, time, what)
        except InputError as error:
            # not defined there: the tape says NaN or infinity
            if isinstance(error.__cause__, ArithmeticError):
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
                f"{what} gives {found.tolist()} at {format_inputs(values)}, and {expected.tolist()} when it "
                "was recorded: it depends on hidden state"
            )


# ---- the kinds

# A recorded function is kept as text, so that it can be written to files and compared. Where it
# branches on values it stays a function (`Call`): it can be called, but has no series.

Written: TypeAlias = (
    "float | str | Expression | Sequence[object] | Callable[..., object] | Tape | Call"
)
"""A field of an expression: text, several, or a function of named inputs."""
Parameters: TypeAlias = "Mapping[str, float] | None"
"""Parameters of the mechanism by name; None where they are not known yet."""


@dataclass(frozen=True)
class Call:
    """A Python function of named inputs that cannot be recorded, because of the `reason`.

    It gives `size` numbers.

    It reads `inputs`, which are the coordinates and parameters `of` here.
    """

    function: Callable[..., Any]
    inputs: tuple[str, ...]
    of: tuple[str, ...]
    time: bool
    size: int
    reason: str
    what: str

    def __call__(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the values (size,) of the function.

        `values` are those of the names in `of`, and of the time "t".

        Errors: `InputError` with the call.
        """

        given = {own: float(values[name]) for own, name in zip(self.inputs, self.of, strict=True)}
        if self.time:
            given[TIME] = float(values.get(TIME, 0.0))
        found, _ = call_function(self.function, given, self.time, self.what)
        if len(found) != self.size:
            raise InputError(
                f"{self.what} returned {format_count(self.size, 'number')} first and {len(found)} at "
                f"{format_inputs(given)}; the number of values must not change"
            )
        return found

    def __repr__(self) -> str:
        return getattr(self.function, "__qualname__", repr(self.function))

    def __reduce__(self) -> Any:
        try:
            pickle.dumps(self.function)
        except (pickle.PicklingError, AttributeError, TypeError):
            raise InputError(
                f"{self.what} is {self!r}, which cannot be pickled, and cannot be recorded: "
                f"{self.reason}"
            ) from None
        return Call, (
            self.function,
            self.inputs,
            self.of,
            self.time,
            self.size,
            self.reason,
            self.what,
        )


@lru_cache(maxsize=1024)
def list_words(texts: tuple[str, ...]) -> tuple[str, ...]:
    """List the names in expressions, in the order in which they occur. Errors: `InputError`."""
    found: dict[str, None] = {}
    for text in texts:
        expression, meant = parse_expression(text)
        found |= dict.fromkeys(meant.get(word, word) for word in expression.names)
    return tuple(found)


def format_expression(x: Any, what: str) -> str:
    """Return an expression, or a number, as text. Errors: `InputError`."""
    given: Any = x
    if isinstance(x, Expression):
        return x.text
    if isinstance(x, (int, float, np.integer, np.floating)) and not isinstance(x, bool):
        whole_and_huge = isinstance(x, int) and abs(x) > LARGEST  # perhaps no float at all
        if whole_and_huge or abs(number := float(given)) > LARGEST:
            raise InputError(
                f"{what} is {format_value(given)}; its size must be at most {LARGEST:g}"
            )
        return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)
    if not isinstance(x, str):
        raise InputError(
            f"{what} is {format_value(x)}; it must be text, a number, or a function of named "
            "coordinates"
        )
    return x


class _WrittenKind(Constraint):
    """Base of constraints whose equations the user writes, over coordinates `of` and parameters."""

    needs: ClassVar[str] = "a number or a list of numbers"
    if TYPE_CHECKING:  # fields of the kinds, each with its default
        of: Names
        time: bool
        parameters: Parameters

    def __post_init__(self) -> None:
        object.__setattr__(self, "of", self._read_names(self.of))
        object.__setattr__(self, "time", read_flag(self.time, f"time of {self.message_name}"))

    @property
    def message_name(self) -> str:
        """Name of the constraint in messages."""
        return (
            f"{self.kind.replace('_', ' ')} {self.name!r}"
            if self.name
            else f"the {self.kind.replace('_', ' ')}"
        )

    @property
    def subject(self) -> str:
        """The coordinates that the equations read, as text."""
        return ", ".join(self.of or self.words)

    def _read_names(self, given: Any) -> tuple[str, ...]:
        """Read the names of coordinates, each of which may occur once. Errors: `InputError`."""
        return read_distinct_names(given, f"of of {self.message_name}")

    def _record_user_function(
        self, function: Callable[..., Any], shape_of: Callable[[tuple[int, ...]], None]
    ) -> tuple[Any, Any]:
        """Record a function that the user wrote, and return its texts and the shape of its values.

        In place of texts a tape is returned where these would be too long, or a `Call` of what
        cannot be recorded.
        """

        of: Any = self.of
        time = self.time
        if not of:
            raise InputError(
                f"{self.message_name} is given a function; name the coordinates that it reads: of=(...)"
            )
        try:
            tape, shape = record_function(function, of, time=time, what=self.message_name)
        except NotRecorded as error:
            inputs: Collection[str] = [*of, TIME] if time else of
            shape_of(shape := find_shape(function, inputs, time, self.message_name))
            reason = str(error).removeprefix(f"{self.message_name} cannot be recorded: ")
            return Call(
                function, of, of, time, int(np.prod(shape)), reason, self.message_name
            ), shape
        shape_of(shape)
        try:
            return tape.format_outputs(), shape
        except InputError:
            return tape, shape

    def _parse_written(self, written: Any) -> Tape:
        """Parse the texts to a tape over coordinates, the time and parameters.

        Errors: `InputError`, `UnknownNameError`.
        """
        of: Any = self.of
        time = self.time
        known = self.parameters
        if isinstance(written, Tape):
            return written
        clock = (TIME,) if time else ()
        if time and TIME in of:
            raise InputError(
                f"{self.message_name} has a coordinate named {TIME!r}, which is the name of the time"
            )
        words = [w for w in list_words(written) if w not in clock]
        parameters = tuple(words if known is None else known)
        names: tuple[str, ...] = of or tuple(w for w in words if known is None or w not in known)
        try:
            return parse_tape(
                written, (*names, *clock), tuple(p for p in parameters if p not in names)
            )
        except UnknownNameError as error:
            more = "; for the time say time=True" if error.name == TIME and not time else ""
            raise InputError(f"{self.message_name}: {error}{more}") from None

    def resolve_names(self, parameters: Collection[str]) -> Constraint:
        """Return the constraint with every name that is not a parameter as a coordinate in `of`."""
        names = self.of or tuple(w for w in self.words if w != TIME or not self.time)
        return replace(self, of=tuple(n for n in names if n not in parameters))  # type: ignore[attr-defined]

    @property
    def words(self) -> tuple[str, ...]:
        """Names in the expressions."""
        raise NotImplementedError


class _Valued(_WrittenKind, Bounded):
    """Base of constraints on values of an expression.

    Bounds are for all n values alike, or (..., n).
    """

    sense: ClassVar[dict[str, Any]] = {}
    if TYPE_CHECKING:
        expression: Written

    def __post_init__(self) -> None:
        super().__post_init__()
        written: Any = self.expression
        if callable(written) and not isinstance(written, (Call, Tape)):
            written, _ = self._record_user_function(written, self._check_shape)
        elif is_sequence(written):
            written = tuple(format_expression(x, self.message_name) for x in written)
            self._check_shape((len(written),))
        elif not isinstance(written, (Call, Tape)):
            written = (format_expression(written, self.message_name),)
        texts: tuple[str, ...] = written if is_text_tuple(written) else ()
        object.__setattr__(self, "expression", texts[0] if len(texts) == 1 else written)
        for text in texts if self.sense or self.bounded else ():
            if "=" in text:
                what = "is within bounds" if self.bounded else "is not negative"
                raise InputError(
                    f"{self.message_name} is {text!r}: give what {what}, such as '1.2 - A'"
                )

    def check_fields(self, dim: int) -> None:
        """Refuse bounds that leave no value, or do not fit the values."""
        super().check_fields(dim)
        n = len(self.list_rows(dim))
        for name in ("at_least", "at_most"):
            if n > 1 and np.shape(x := getattr(self, name))[-1:] not in ((), (n,)):
                raise InputError(
                    f"{name} of {self.label} has shape {np.shape(x)}; it must be a number, or "
                    f"(..., {n})"
                )

    def _check_shape(self, shape: tuple[int, ...]) -> None:
        """Refuse values that are no list of numbers. Errors: `InputError`."""
        if len(shape) > 1 or 0 in shape:
            raise InputError(
                f"{self.message_name} returns numbers of the shape {shape}; it must return {self.needs}"
            )

    @property
    def _texts(self) -> Any:
        """The expressions as a tuple of texts, a tape or a `Call`."""
        written: Any = self.expression
        return (written,) if isinstance(written, str) else written

    @property
    def words(self) -> tuple[str, ...]:
        """Names in the expressions."""
        written = self._texts
        if isinstance(written, (Tape, Call)):
            return written.inputs if isinstance(written, Tape) else written.of
        return list_words(written)

    def describe_field(self, name: str) -> str:
        """Return the value of a field in words; expressions are compared with zero."""
        if name != "expression":
            return super().describe_field(name)
        written = self._texts
        tail = " >= 0" if self.sense else " = 0"
        texts: tuple[str, ...] = (
            written if is_text_tuple(written) else (f"f({', '.join(self.of)})",)
        )
        if self.bounded:
            return f"{', '.join(texts)} {'is' if len(texts) == 1 else 'are'} {self.bounds_text}"
        return ", ".join(t if "=" in t else t + tail for t in texts)

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row for each value of the expressions."""
        written = self._texts
        if isinstance(written, Call):
            op = Op.CALL
            of = written
            n = written.size
        else:
            op = Op.TAPE
            of = self._parse_written(written)
            n = len(of.outputs)
        sense = {"low": "at_least", "high": "at_most"} if self.bounded else self.sense
        part = n > 1 and self.bounded
        return tuple(
            Row(
                op,
                (of, k),
                "value" if n == 1 else f"value {k + 1}",
                "1",
                part=k if part else None,
                **sense,
            )
            for k in range(n)
        )

    def scale_lengths(self, factor: Fraction, slides: Collection[str]) -> Constraint:
        """Return the constraint as a function of slides in another unit; its values stay."""
        written = self.expression
        own = [n for n in self.of if n in slides]
        if not own:
            return self
        if isinstance(written, Call):
            raise InputError(
                f"{self.message_name} is a Python function of {', '.join(own)}, which is in another "
                "unit here: write it as an expression"
            )
        tape = scale_inputs(self._parse_written(self._texts), own, factor)
        new = tape if isinstance(written, Tape) else tape.format_outputs()
        return replace(self, expression=new)  # type: ignore[call-arg]

    def add_prefix(self, prefix: str) -> Constraint:
        """Return the constraint with a prefix before the names of its coordinates."""
        written = self.expression
        new = {n: prefix + n for n in self.of}
        if isinstance(written, Call):
            written = replace(written, of=tuple(new.get(n, n) for n in written.of))
        elif isinstance(written, Tape):
            written = rename_inputs(written, new)
        else:
            written = rename_inputs(self._parse_written(self._texts), new).format_outputs()
        return replace(self, expression=written, of=tuple(new.values()))  # type: ignore[call-arg]


@kind("equation", says="{expression}")
class Equation(_Valued):
    """Demand that an expression of coordinates is zero, or several.

    Parameters
    ----------
    expression
        Text such as ``"A = 2*B"``, several texts, or a function, called with a mapping from the names in
        `of` to numbers, that returns one number or several. Text finds its coordinates itself;
        other names are parameters of the mechanism.
    of
        Names of the coordinates of a function.
    time
        Whether the time t in seconds is an input: a second argument of a function, or ``t`` in
        a text (default: False).
    at_least, at_most
        Bounds of the values, in place of 0 (default: none).

    See Also
    --------
    Mechanism.equation : hold it always.

    Notes
    -----
    `drive` and `assemble` pass the time on; for other verbs it is 0.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import Equation
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(Equation("q1 = 2*q2"))
    >>> bool(abs(answer.q[0] - 2 * answer.q[1]) < 1e-6)
    True
    """

    expression: Written
    of: Names = ()
    time: bool = False
    parameters: Parameters = field(default=None, repr=False, kw_only=True)


@kind("inequality", says="{expression}")
class Inequality(_Valued):
    """Demand that an expression of coordinates is not negative, or several.

    Parameters
    ----------
    expression
        Text such as ``"1.2 - A"``, without a sign of equality, several texts, or a function, called
        with a mapping from the names in `of` to numbers, that returns one number or several. Text
        finds its coordinates itself; other names are parameters of the mechanism.
    of
        Names of the coordinates of a function.
    time
        Whether the time t in seconds is an input: a second argument of a function, or ``t`` in
        a text (default: False).
    at_least, at_most
        Bounds of the values, in place of 0 and above (default: none).

    See Also
    --------
    Mechanism.inequality : hold it always.

    Notes
    -----
    `drive` and `assemble` pass the time on; for other verbs it is 0.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import Inequality
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(Inequality("q1 - 0.1"))
    >>> bool(answer.q[0] >= 0.1 - 1e-6)
    True
    """

    expression: Written
    of: Names = ()
    time: bool = False
    parameters: Parameters = field(default=None, repr=False, kw_only=True)

    sense: ClassVar[dict[str, Any]] = {"low": "zero"}


@kind("velocity_equation", says="the velocities v of {of} obey {matrix} v = {b}")
class VelocityEquation(_WrittenKind):
    """Demand equations A(q) v = b(q, t) of the velocities of coordinates.

    Parameters
    ----------
    matrix
        Rows of A, one for each equation, with a number or text for each coordinate of `of`, or
        a function that returns them.
    of
        Names of the coordinates whose velocities are v.
    b
        Right side: a number or text, or one for each row, or a function (default: 0).
    time
        Whether the time t in seconds is an input (default: False).

    See Also
    --------
    Mechanism.velocity_equation : hold it always.

    Notes
    -----
    A mechanism can have the constraint, `ik` cannot.
    """

    matrix: Written
    of: Names = ()
    b: Written = 0
    time: bool = False
    parameters: Parameters = field(default=None, repr=False, kw_only=True)

    scaled: ClassVar[bool] = False
    needs: ClassVar[str] = "rows of numbers, one for each coordinate"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.of:
            raise InputError(
                f"{self.message_name} needs the coordinates whose velocities it is about: of=(...)"
            )
        A = self._read_entries(self.matrix, self._check_shape)
        A = (A,) if A and not isinstance(A[0], tuple) else A
        self._check_shape((len(A), len(A[0])) if A else (0, 0))
        b = self._read_entries(self.b, lambda shape: self._check_b_shape(shape, len(A)))
        b = b if len(b) == len(A) else b * len(A)
        self._check_b_shape((len(b),), len(A))
        object.__setattr__(self, "matrix", A)
        object.__setattr__(self, "b", b[0] if len(set(b)) == 1 else b)

    def _read_entries(self, written: Any, fits: Callable[[tuple[int, ...]], None]) -> Any:
        """Read entries as texts, or rows of texts."""
        if callable(written) and not isinstance(written, Expression):
            found, shape = self._record_user_function(written, fits)
            if not is_text_tuple(found):
                why = found.reason if isinstance(found, Call) else "as text it is too long"
                raise InputError(
                    f"{self.message_name} cannot be recorded: {why}; rows of velocities need derivatives "
                    "of their entries: write them as expressions"
                )
            n = shape[-1] if len(shape) == 2 else 0
            return tuple(found[i : i + n] for i in range(0, len(found), n)) if n else found
        rows: Any = written.tolist() if isinstance(written, np.ndarray) else written
        if not is_sequence(rows):
            return (format_expression(rows, self.message_name),)
        if any(is_sequence(x) for x in rows):
            if len({len(x) if is_sequence(x) else -1 for x in rows}) > 1:
                raise InputError(f"{self.message_name} has rows of different lengths")
            return tuple(
                tuple(format_expression(x, self.message_name) for x in row) for row in rows
            )
        return tuple(format_expression(x, self.message_name) for x in rows)

    def _check_shape(self, shape: tuple[int, ...]) -> None:
        """Refuse a shape other than that of a matrix with a column for each coordinate."""
        if len(shape) not in (1, 2) or shape[-1] != len(self.of) or 0 in shape:
            raise InputError(
                f"{self.message_name} has a matrix of the shape {shape}; each of its rows must have "
                f"{format_count(len(self.of), 'entry')}, for {', '.join(self.of)}"
            )

    def _check_b_shape(self, shape: tuple[int, ...], rows: int) -> None:
        """Refuse a `b` that is neither one number nor one for each row."""
        if shape not in ((), (1,), (rows,)):
            raise InputError(
                f"b of {self.message_name} has the shape {shape}; it must be one number, or {rows}"
            )

    def _format_rows(self) -> tuple[str, ...]:
        """Return each row A v - b as an expression in velocities."""
        matrix: Any = self.matrix
        b = self.b if is_text_tuple(self.b) else (self.b,) * len(matrix)
        rates = [quote_name(n + RATE) for n in self.of]
        rows = [" + ".join(f"({a})*{v}" for a, v in zip(row, rates, strict=True)) for row in matrix]
        return tuple(row if y == "0" else f"{row} - ({y})" for row, y in zip(rows, b, strict=True))

    @property
    def words(self) -> tuple[str, ...]:
        """Names in the expressions, coordinates first."""
        matrix: Any = self.matrix
        b = self.b if is_text_tuple(self.b) else (self.b,)
        return tuple(dict.fromkeys([*self.of, *list_words((*(x for r in matrix for x in r), *b))]))

    def resolve_names(self, parameters: Collection[str]) -> Constraint:
        """Return the constraint unchanged, since `of` already names the coordinates."""
        return self

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row for each row of the matrix."""
        rates = tuple(n + RATE for n in self.of)
        tape = self.make_velocity_tape(rates)
        n = len(tape.outputs)
        return tuple(
            Row(Op.VELOCITY, (tape, k), "velocity" if n == 1 else f"velocity {k + 1}", "1/s")
            for k in range(n)
        )

    def make_velocity_tape(self, rates: tuple[str, ...]) -> Tape:
        """Make the tape of the rows A v - b over coordinates and the velocities `rates`."""
        texts = self._format_rows()
        clock = (TIME,) if self.time else ()
        inputs = (*self.of, *rates, *clock)
        words = [w for w in list_words(texts) if w not in inputs]
        known = tuple(words if self.parameters is None else self.parameters)
        try:
            return parse_tape(texts, inputs, tuple(p for p in known if p not in inputs))
        except UnknownNameError as error:
            more = "; for the time say time=True" if error.name == TIME and not self.time else ""
            raise InputError(f"{self.message_name}: {error}{more}") from None

    def scale_lengths(self, factor: Fraction, slides: Collection[str]) -> Constraint:
        """Return the constraint on slides in another unit; the values of its rows stay."""
        own = [n for n in self.of if n in slides]
        scaled = self._convert_entries(lambda tape: scale_inputs(tape, own, factor))
        rows: Any = scaled.matrix
        columns = [float(1 / factor) if n in own else 1.0 for n in self.of]
        matrix = tuple(
            tuple(a if x == 1.0 else f"({a})*{x!r}" for a, x in zip(row, columns, strict=True))
            for row in rows
        )
        return replace(scaled, matrix=matrix)

    def add_prefix(self, prefix: str) -> Constraint:
        """Return the constraint with a prefix before the names of its coordinates."""
        new = {n: prefix + n for n in self.of}
        renamed = self._convert_entries(lambda tape: rename_inputs(tape, new))
        return replace(renamed, of=tuple(new.values()))

    def _convert_entries(self, convert: Callable[[Tape], Tape]) -> VelocityEquation:
        """Return the constraint with each entry of `matrix` and `b` converted as a tape."""
        clock = (TIME,) if self.time else ()

        def convert_text(text: str) -> str:
            """Return an entry, converted."""
            words = [w for w in list_words((text,)) if w not in self.of and w not in clock]
            tape = parse_tape((text,), (*self.of, *clock), tuple(words))
            return convert(tape).format_outputs()[0]

        b: Any = self.b
        b = tuple(map(convert_text, b)) if is_text_tuple(b) else convert_text(b)
        rows: Any = self.matrix
        return replace(self, matrix=tuple(tuple(map(convert_text, row)) for row in rows), b=b)
