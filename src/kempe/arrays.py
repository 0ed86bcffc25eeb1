"""Conversion of arguments to arrays of real numbers. Errors give the reason where that is
impossible.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from numbers import Rational, Real
from typing import Any, TypeGuard, cast

import numpy as np
from numpy.typing import NDArray

from kempe.errors import DegreesWarning, InputError, format_value, warn
from kempe.words import format_count

PLAIN = frozenset({float, int, np.float64})
"""Numbers of which a sequence needs no closer look."""
FARTHEST = 1e100
"""Numbers of this size and larger are refused where searches begin: products of three of them must
be floats."""
LISTS = frozenset({list, tuple})
DEEPEST = 64
"""Lists within lists that are read: as many as numpy has axes."""
MOST_TURNED = 4.0 * math.pi
LARGEST_DEGREES = 720.0
"""Two turns, in radians and in degrees: angles below and above do not look like degrees, larger
numbers, such as 1000, stand for no limit."""
LARGEST = int(np.finfo(np.float64).max)
"""The largest float: whole numbers and fractions can be larger."""
KINDS = {
    "U": "text",
    "S": "bytes",
    "O": "objects that are no numbers",
    "c": "complex numbers",
    "b": "truth values",
    "M": "dates",
    "m": "durations",
    "V": "records",
    "T": "text",
}
"""What arrays of these kinds hold that are no real numbers."""


def read_reals(
    given: Any, what: str, wanted: str = "an array of real numbers"
) -> NDArray[np.float64]:
    """Convert `given` to an array of float64; such an array is returned itself.

    Errors: `InputError` for anything but real numbers: text, truth values, dates, complex numbers,
    None, ragged lists, masked arrays, numbers with units, and tables whose columns have names.
    """
    kind = given.__class__
    if kind is np.ndarray and given.dtype == np.float64:
        return given
    if kind is float or kind is np.float64:
        return np.asarray(given, dtype=np.float64)
    if not is_number_list(given):
        try:
            held = next(
                (said for part in _iterate_parts(given) if (said := _explain_refusal(part))), ""
            )
        except RecursionError:  # a list that holds itself has no end
            held = f"has lists nested more than {DEEPEST} deep"
        if held:
            raise InputError(f"{what} {held}; it must be {wanted}")
    return convert_array(given, what, wanted)


def convert_array(given: Any, what: str, wanted: str) -> NDArray[np.float64]:
    """Convert `given`, without names, masks or units, to an array of float64. Errors: `InputError`."""
    try:
        array = np.asarray(given)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        held = explain_ragged_list(given) if is_sequence(given) else format_value(given)
        raise InputError(f"{what} is {held}; it must be {wanted}") from None
    if array.dtype == object and not is_array(given) and PLAIN.issuperset(map(type, array.flat)):
        try:
            array = array.astype(np.float64)  # whole numbers beyond those of numpy
        except OverflowError:
            raise InputError(
                f"{what} has a number that no float holds; it must be {wanted}"
            ) from None
    if array.dtype.kind not in "fiu":
        held = KINDS.get(array.dtype.kind, str(array.dtype))
        if given is None or not array.ndim:
            raise InputError(f"{what} is {format_value(given)}; it must be {wanted}")
        raise InputError(f"{what} holds {held}; it must be {wanted}")
    with np.errstate(over="ignore"):
        return array.astype(np.float64, copy=False)


def explain_ragged_list(given: Sequence[Any]) -> str:
    """Explain why a nested list is no array: the first row that has another size than row 0."""
    rows = [
        row if is_sequence(row) else list(row) if is_array(row) and row.ndim else None
        for row in given
    ]
    sizes = [None if row is None else len(row) for row in rows]
    odd = next((i for i, size in enumerate(sizes) if size != sizes[0]), None)
    if odd is None:
        return "ragged"
    numbers = all(is_real(x) for row in (rows[odd], rows[0]) for x in row or ())
    noun = "number" if numbers else "row"
    has, first = (
        "is a number" if size is None else f"has {format_count(size, noun)}"
        for size in (sizes[odd], sizes[0])
    )
    return f"ragged: row {odd} {has}, row 0 {first}"


def check_range(
    x: NDArray[np.float64], what: str, names: Sequence[str] = (), below: float = FARTHEST
) -> NDArray[np.float64]:
    """Return the numbers `x` if all are finite and of absolute value less than `below`. `names`
    label the last axis.

    Errors: `InputError`, with the first number that is not, and its place.
    """
    good = np.abs(x) < below
    if good.all():
        return x
    place = [int(i) for i in np.argwhere(~good)[0]]
    value = float(x[tuple(place)])
    place = [i for k, i in enumerate(place) if x.shape[k] > 1 or k + 1 == x.ndim]
    if names:
        place[-1:] = [repr(names[place[-1]])]  # type: ignore[list-item]
    at = f"[{', '.join(map(str, place))}]" if place else ""
    allowed = f"its size must be below {below:g}" if np.isfinite(value) else "it must be finite"
    raise InputError(f"{what}{at} is {value:g}; {allowed}")


def warn_of_degrees(angles: Any, what: str, in_file: bool = False) -> bool:
    """Warn if an angle, in radians, looks like one in degrees: a multiple of 5 beyond two turns, up
    to 720. Return whether it did. Of a number `in_file` the warning gives the radians to write there.

    `angles` is an array, or a sequence whose entries that are no numbers are not looked at.
    """
    if is_array(angles):
        if not np.any(np.abs(angles) > MOST_TURNED):
            return False
        angles = angles.ravel().tolist()
    for x in angles:
        if is_real(x) and MOST_TURNED < abs(x) <= LARGEST_DEGREES and x % 5.0 == 0.0:
            turns = x / (2.0 * math.pi)
            written = (
                f"angles in files are radians: for {x:g} degrees write {math.radians(x):.9g}"
                if in_file
                else f"for degrees write {x:g} * kempe.deg"
            )
            warn(f"{what} is {x:g} rad, {turns:.1f} turns; {written}", DegreesWarning)
            return True
    return False


def compute_median(values: Iterable[float]) -> float:
    """Compute the median of one or more numbers; of an even count the mean of the middle two."""
    # numpy's own imports masked arrays, a sixth of the time to a first answer
    x = sorted(map(float, values))
    return 0.5 * (x[(len(x) - 1) // 2] + x[len(x) // 2])


def is_whole(x: object) -> TypeGuard[int]:
    """Whether `x` is a single integer; True and False are not."""
    return isinstance(x, (int, np.integer)) and not isinstance(x, bool)


def unwrap_scalar(x: Any) -> Any:
    """Convert an array without axes to a Python number; other arrays are returned themselves."""
    return x if np.ndim(x) else np.asarray(x).item()


def is_real(x: object) -> TypeGuard[float]:
    """Whether `x` is a single real number within the range of a float; booleans and durations are
    not.
    """
    kind = x.__class__
    if kind is float or kind is np.float64:
        return True
    if kind is int:  # the usual ones first: what is abstract takes ten times as long
        return -LARGEST <= x <= LARGEST  # type: ignore[operator]
    real = isinstance(x, Real) and not isinstance(x, (bool, np.timedelta64))
    return real and not (isinstance(x, Rational) and abs(x) > LARGEST)  # type: ignore[operator]


def is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def is_number_list(given: Any) -> bool:
    """Whether `given` is a list of numbers, or of lists of numbers; only the first numbers are
    checked.
    """
    if given.__class__ not in LISTS or not len(given):
        return False
    first = given[0]
    if first.__class__ in PLAIN:
        return True
    return (
        first.__class__ in LISTS
        and len(first) > 0
        and first[0].__class__ in PLAIN
        and LISTS.issuperset(map(type, given))
    )


def is_mapping(x: object) -> TypeGuard[Mapping[Any, Any]]:
    """Whether `x` is a mapping."""
    return isinstance(x, Mapping)


def is_sequence(x: object) -> TypeGuard[list[Any] | tuple[Any, ...]]:
    """Whether `x` is a list or a tuple."""
    return isinstance(x, (list, tuple))


def is_array(x: object) -> TypeGuard[NDArray[Any]]:
    """Whether `x` is a NumPy array."""
    return isinstance(x, np.ndarray)


def read_mapping(given: Any) -> Mapping[str, Any] | None:
    """Convert values with names to a mapping by name; return None for values without names.

    A mapping, a record or an array of them, a series with an index, a table with columns, a message
    JointState. Labels 0, 1, 2, ... are the places that the values have anyway. Errors: `InputError`
    for labels that are neither, or appear twice.
    """
    kind = given.__class__
    if kind is dict:
        return given
    if kind in PLAIN or kind is list or kind is str:
        return None
    if kind is np.ndarray and given.dtype.names is None:
        return None
    if is_mapping(given):
        return given
    whole: Any = given
    if isinstance(given, tuple):
        names: Any = getattr(whole, "_fields", None)
        return None if names is None else dict(zip(names, whole, strict=True))
    kind = type(given).__name__
    message = read_joint_state(given)
    names = _find_labels(given) if message is None else message[0]
    if names is None or names == list(range(len(names))):
        return None
    if not all(isinstance(name, str) for name in names):
        raise InputError(
            f"the labels of the {kind} are {format_value(names)}; they must be names, or 0, 1, 2, "
            "..."
        )
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"the {kind} has {twice!r} twice")
    if message is not None:
        return dict(zip(*message, strict=True))
    table = (
        getattr(given, "ndim", 1) != 1 or isinstance(given, np.ndarray) or hasattr(given, "columns")
    )
    return {name: np.asarray(whole[name]) if table else whole[name] for name in names}


def read_joint_state(given: Any) -> tuple[list[Any], list[float]] | None:
    """Read the names and positions of a message JointState; return None for other objects."""
    names: Any = getattr(given, "name", None)
    positions: Any = getattr(given, "position", None)
    if not is_sequence(names) or positions is None:
        return None
    if len(names) != len(positions):
        raise InputError(
            f"the {type(given).__name__} has {format_count(len(names), 'name')} and "
            f"{format_count(len(positions), 'position')}"
        )
    return list(names), list(positions)


def list_named_rows(given: Any) -> list[Any] | None:
    """Return the entries of a list or tuple if some of them have names, else None."""
    if given.__class__ not in LISTS:
        return None
    return (
        list(given)
        if any(read_mapping(x) is not None for x in given if x.__class__ not in PLAIN)
        else None
    )


def _find_labels(given: Any) -> list[Any] | None:
    """Return the labels along the last axis of an array-like, or None without labels."""
    fields: Any = getattr(getattr(given, "dtype", None), "names", None)
    if isinstance(fields, tuple) and fields:
        return list(cast("tuple[Any, ...]", fields))
    for name in ("column_names", "columns"):
        found: Any = getattr(given, name, None)
        if found is not None and not callable(found):
            return list(found)
    keys = getattr(given, "keys", None)
    if not callable(keys) or not hasattr(given, "__getitem__"):
        return None
    found: Any = keys()
    return list(found)


def _iterate_parts(given: Any) -> Iterator[Any]:
    """Yield the entries of nested lists that are neither lists nor plain numbers."""
    level = [given]
    for _ in range(DEEPEST):
        if not level:
            return
        inner: list[Any] = []
        seen = set[int]()  # a list that holds itself twice would double at each level
        for x in level:
            if x.__class__ in PLAIN or x.__class__ is np.ndarray and x.dtype.kind != "V":
                continue
            if x.__class__ in LISTS:
                if len(x) and x[0].__class__ not in PLAIN and id(x) not in seen:
                    seen.add(id(x))
                    inner += x
            else:
                yield x
        level = inner
    raise RecursionError


def _explain_refusal(x: Any) -> str:
    """Explain why a value that NumPy could convert is refused as numbers; '' if it is accepted."""
    # asking numpy for it would import it
    if "numpy.ma" in sys.modules and isinstance(x, np.ma.MaskedArray):
        return "is a masked array, whose mask would be lost"
    kind: str = type(x).__name__
    if isinstance(x, Mapping):
        return f"is {kind}"
    whole: Any = x
    labels = list(getattr(whole, "_fields", ())) if isinstance(x, tuple) else _find_labels(whole)
    if labels and any(isinstance(label, str) for label in labels):
        plain = " (to_numpy() gives the numbers, in its order)" * hasattr(whole, "to_numpy")
        return f"is a {kind} with names, which have no meaning here{plain}"
    if labels and hasattr(whole, "columns") and labels != list(range(len(labels))):
        return f"is a {kind} whose columns are {format_value(labels)}, which have no meaning here"
    if not isinstance(whole, (np.generic, str, bytes)):
        unit = next(
            (
                u
                for u in (getattr(whole, name, None) for name in ("unit", "units"))
                if u is not None
            ),
            None,
        )
        if unit is not None and not callable(unit):
            return f"has the unit {str(unit)!r}, which would be lost"
        coords: Any = getattr(whole, "coords", None)
        if getattr(whole, "dims", None) and coords is not None and len(coords):
            return f"is a {kind} with labels, which have no meaning here"
    return ""
