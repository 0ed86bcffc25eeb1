"""Checks of the arguments of calls: names, numbers and switches. Errors name the argument."""

from __future__ import annotations

import functools
import itertools
import math
import re
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from types import FunctionType
from typing import Any, ParamSpec, TypeGuard, TypeVar

import numpy as np

from kempe.arrays import is_array, is_whole, read_reals
from kempe.errors import (
    CallError,
    InputError,
    Interrupted,
    KempeError,
    UnknownNameError,
    format_value,
)
from kempe.status import Status
from kempe.units import METRES, name_lengths
from kempe.words import format_count

Function = TypeVar("Function", bound=Callable[..., Any])
Class = TypeVar("Class", bound=type)
Options = ParamSpec("Options")
Kept = TypeVar("Kept")

FOREIGN = (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, NotImplementedError)
"""What Python and numpy raise for an argument of which nothing can be made."""

CONFIGURATIONS = {"q", "q0", "q1", "near", "start"}
"""Names of arguments that are configurations."""


# ---- errors that name the argument


def quiet(function: Function) -> Function:
    """Decorate a function so that NumPy raises no floating-point warnings.

    NaN and infinity show in the result of the function.

    It costs half a microsecond a call. Threads that it starts do not inherit it.
    """

    @functools.wraps(function)
    def call_quietly(*args: Any, **options: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*args, **options)

    return call_quietly  # type: ignore[return-value]


def explain_errors(function: Function, fast: bool = False) -> Function:
    """Decorate a function so that errors of Python and NumPy become errors that name the argument.

    Arguments are looked at only after something failed. What fails with arguments that are what the
    annotations say is raised as it is. The function is `quiet` unless it is `fast`: a call of a
    kernel, which never warns. Errors: `CallError` (a TypeError) for arguments that the function
    does not have, or lacks; `InputError` for those of a wrong kind.
    """
    run = function if fast else quiet(function)

    @functools.wraps(function)
    def call_function(*args: Any, **options: Any) -> Any:
        try:
            return run(*args, **options)
        except KempeError as error:
            _name_lengths_of_error(error, args)
            raise
        except FOREIGN as error:
            blame_argument(function, args, options, error)
            raise

    return call_function  # type: ignore[return-value]


def _name_lengths_of_error(error: KempeError, args: tuple[Any, ...]) -> None:
    """Name lengths in an error by the unit of the system or mechanism that was asked."""
    owner: Any = args[0] if args else None
    if not isinstance(getattr(owner, "unit", None), str):
        owner = getattr(owner, "system", None)  # of an answer, or of a part of a system
    unit = getattr(owner, "unit", None)
    if isinstance(unit, str) and unit in METRES and isinstance(error.args[0], str):
        error.args = (name_lengths(error.args[0], unit), *error.args[1:])


def raise_interrupted(verb: Callable[Options, Kept]) -> Callable[Options, Kept]:
    """Decorate a verb so that Ctrl-C raises `Interrupted` with the partial result as its `answer`.

    The interrupt goes on to the caller, so that it ends a loop over calls. The answer of another
    verb that this one called, and that was interrupted, is no answer to the question of this one:
    then `answer` is None.
    """

    @functools.wraps(verb)
    def call_verb(*args: Options.args, **options: Options.kwargs) -> Kept:
        try:
            answer = verb(*args, **options)
        except KeyboardInterrupt:
            raise Interrupted from None
        broken = getattr(answer, "broken", None)
        if getattr(answer, "interrupted", False) is True or broken is Status.INTERRUPTED:
            raise Interrupted(answer)
        return answer

    return call_verb


def call_until_interrupt(
    verb: Callable[Options, Kept], *args: Options.args, **options: Options.kwargs
) -> Kept:
    """Call a verb and return its answer, after Ctrl-C the partial one. Errors: `Interrupted` if
    there is none.
    """
    try:
        return verb(*args, **options)
    except Interrupted as stop:
        if stop.answer is None:
            raise
        answer: Any = stop.answer
        return answer


def add_signature_options(cls: type) -> Callable[[Function], Function]:
    """Make a decorator that adds the fields of a dataclass to a signature with `**options`."""
    from inspect import Parameter, signature  # only here: few functions have it

    more = [
        Parameter(f.name, Parameter.KEYWORD_ONLY, default=f.default, annotation=f.type)
        for f in fields(cls)
    ]

    def write_signature(function: Function) -> Function:
        own = signature(function)
        kept = [p for p in own.parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
        function.__signature__ = own.replace(parameters=[*kept, *more])  # type: ignore[attr-defined]
        return function

    return write_signature


def find_parameter_text(doc: str | None, first: str = "") -> str:
    """Return the lines of a docstring's section Parameters, from the parameter `first` on."""
    from inspect import cleandoc  # only here, and below

    lines = cleandoc(doc or "").partition(PARAMETERS)[2].partition("\n\n")[0]
    return lines[lines.find(f"{first}\n") if first else 0 :]


def add_parameter_text(doc: str | None, text: str) -> str | None:
    """Add lines at the end of a docstring's section Parameters, if there is one."""
    from inspect import cleandoc

    before, heading, after = cleandoc(doc or "").partition(PARAMETERS)
    if not heading:
        return doc
    own, gap, rest = after.partition("\n\n")
    return f"{before}{heading}{own}\n{text}{gap}{rest}"


PARAMETERS = "\n\nParameters\n----------\n"
"""Heading of the section of a docstring that describes the parameters."""


def explain_method_errors(cls: Class) -> Class:
    """Decorate the public methods, `__call__` and `__str__` of a class with `explain_errors`."""
    for name, value in list(vars(cls).items()):
        if isinstance(value, FunctionType) and (name[0] != "_" or name in ("__call__", "__str__")):
            setattr(cls, name, explain_errors(value))
    return cls


def explain_init_errors(cls: Class) -> Class:
    """Decorate the `__init__` of a class with `explain_errors`."""
    cls.__init__ = explain_errors(cls.__init__)  # type: ignore[misc]
    return cls


def blame_argument(
    function: Callable[..., Any],
    args: tuple[Any, ...],
    options: Mapping[str, Any],
    error: Exception,
) -> None:
    """Raise an error that names the wrong argument of a failed call; return if all have the right
    kind.
    """
    from inspect import Parameter, signature  # only here: most calls succeed

    called = function.__qualname__.removesuffix(".__init__").rpartition(".")[2]
    parameters = signature(function).parameters
    if Parameter.VAR_KEYWORD not in {p.kind for p in parameters.values()}:
        allowed = [
            p.name for p in list(parameters.values())[1:] if p.kind is not Parameter.POSITIONAL_ONLY
        ]
        for name in options:
            if name not in parameters:
                raise CallError(called, name, allowed) from None
    try:
        bound = signature(function).bind(*args, **options)
    except TypeError as wrong:
        raise CallError(called, str(wrong)) from None
    for name, value in bound.arguments.items():
        p = parameters[name]
        if p.kind in (Parameter.VAR_KEYWORD, Parameter.VAR_POSITIONAL) or value is p.default:
            continue
        said = describe_expected_kind(name, p.annotation, value)
        if said:
            raise InputError(f"{name} is {format_value(value)}; it must be {said}") from error


def describe_expected_kind(name: str, annotation: object, value: object) -> str:
    """Describe what an argument must be, by its annotation or name; '' if its value is of that
    kind.
    """
    if name in CONFIGURATIONS:
        annotation = "Mapping[str, Any] | ArrayLike | None" + (" | str" if name == "start" else "")
    said: list[str] = []
    for part in re.split(r" \| (?![^\[]*\])", str(annotation)):  # not within brackets
        kind = KINDS.get(part) or KINDS.get(part.partition("[")[0])
        if kind is None or kind[0](value):
            return ""
        said.append(kind[1])
    return " or ".join(said)


def is_array_like(x: object) -> bool:
    """Whether `x` is an array of real numbers or can be converted to one."""
    try:
        return read_reals(x, "").dtype == np.float64
    except InputError:
        return False


def _is_bounded_integer(x: object) -> bool:
    """Whether `x` is an integer of absolute value below 2**62."""
    return is_whole(x) and abs(int(x)) < 2**62


def _is_number(x: object) -> bool:
    given: Any = x
    real = isinstance(x, (int, float, np.number)) and not isinstance(x, (bool, np.complexfloating))
    return real and is_array_like(given)


def is_list(x: object) -> TypeGuard[Iterable[Any]]:
    """Whether `x` is iterable and not text."""
    try:
        return iter(x) is not None and not isinstance(x, (str, bytes))  # type: ignore[call-overload]
    except TypeError:
        return False


def _is_list_of_text(x: Any) -> bool:
    return is_list(x) and (iter(x) is x or all(isinstance(name, str) for name in x))


def _has_class_name(name: str, x: object) -> bool:
    """Whether a class of `x` or one of its base classes has this name."""
    return name in [c.__name__ for c in type(x).__mro__]


def _is_frame_like(x: object) -> bool:
    """Whether `x` is a name, or has a name as a frame or body has."""
    return isinstance(x, str) or isinstance(getattr(x, "name", None), str)


KINDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "bool": (lambda x: isinstance(x, (bool, np.bool_)), "True or False"),
    "int": (_is_bounded_integer, "a whole number"),
    "float": (_is_number, "a number"),
    "str": (lambda x: isinstance(x, str), "text"),
    "None": (lambda x: x is None, "None"),
    "Path": (lambda x: isinstance(x, Path), "a path"),
    "bytes": (lambda x: isinstance(x, bytes), "bytes"),
    "tuple": (lambda x: isinstance(x, tuple), "a tuple"),
    "list": (lambda x: isinstance(x, list), "a list"),
    "Callable": (callable, "a function"),
    "Progress": (callable, "a function"),
    "Mapping": (lambda x: isinstance(x, Mapping), "a dict by name"),
    "ArrayLike": (is_array_like, "an array of real numbers"),
    "Array": (lambda x: is_array(x) and is_array_like(x), "an array of real numbers"),
    "FrameLike": (_is_frame_like, "the name of a body or frame"),
    "BodyLike": (_is_frame_like, "the name of a body"),
    "Frame": (_is_frame_like, "the name of a frame"),
    "Iterable[str]": (_is_list_of_text, "a list of names"),
    "Sequence[str]": (_is_list_of_text, "a list of names"),
    "Iterable": (is_list, "a list"),
    "Sequence": (is_list, "a list"),
    "System": (lambda x: _has_class_name("System", x), "a System"),
    "SystemType": (lambda x: _has_class_name("Model", x), "a System"),
    "Model": (lambda x: _has_class_name("Model", x), "a System"),
    "Mechanism": (lambda x: _has_class_name("Mechanism", x), "a Mechanism"),
    "Constraint": (
        lambda x: _has_class_name("Constraint", x),
        "a task or constraint of kempe.constraints",
    ),
    "np.random.Generator": (lambda x: isinstance(x, np.random.Generator), "a generator"),
}
"""What the parts of annotations stand for: whether a value is of the kind, and the words for it."""


# ---- names


def check_name(kind: str, name: object, names: Iterable[str], owner: str = "") -> str:
    """Return the name if it is one of `names`. Errors: `UnknownNameError`, with the allowed names."""
    if isinstance(name, str) and name in names:
        return name
    raise UnknownNameError(kind, name, names, owner)


MOST_NAMES = 10**6
"""Names of a list at most: one that is made while it is read may have no end."""


def read_names(names: object, what: str) -> tuple[str, ...]:
    """Read a list of names, or a single name, as a tuple. Errors: `InputError`."""
    if isinstance(names, str):
        return (names,)
    try:
        out: tuple[Any, ...] = tuple(itertools.islice(names, MOST_NAMES + 1))  # type: ignore[arg-type]
    except TypeError:
        out = (None,)
    if len(out) > MOST_NAMES:
        raise InputError(f"{what} has more than {MOST_NAMES} names")
    if not all(isinstance(name, str) for name in out):
        raise InputError(f"{what} is {format_value(names)}; it must be a list of names")
    return out  # type: ignore[return-value]


def read_distinct_names(names: object, what: str) -> tuple[str, ...]:
    """Read a list of names, each of which may occur once. Errors: `InputError`."""
    out = read_names(names, what)
    if len(set(out)) < len(out):
        twice = next(name for name in out if out.count(name) > 1)
        raise InputError(f"{what} names {twice!r} twice")
    return out


# ---- numbers


def numbers(x: Any, what: str, *core: int) -> np.ndarray:
    """Convert real numbers to an array of shape (..., *core).

    Errors: `InputError` for other values and shapes.
    """
    array = np.array(x) if x.__class__ is float else read_reals(x, what)
    if core and array.shape[-len(core) :] != core:
        raise InputError(
            f"{what} has shape {array.shape}; it must be (..., {', '.join(map(str, core))})"
        )
    return array


def broadcast_shapes(shapes: Mapping[str, tuple[int, ...]]) -> tuple[int, ...]:
    """Broadcast the leading shapes of several arguments, given by their names.

    Errors: `InputError`.
    """
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        said = ", ".join(f"{shape} of {name}" for name, shape in shapes.items())
        raise InputError(f"leading shapes do not fit together: {said}") from None


def make_generator(rng: Any) -> np.random.Generator:
    """Make a random generator from a generator, a seed, or None for a random seed. Errors:
    `InputError`.
    """
    if (
        rng is None
        or isinstance(rng, np.random.Generator)
        or (_is_bounded_integer(rng) and rng >= 0)
    ):
        return np.random.default_rng(rng)
    raise InputError(
        f"rng is {format_value(rng)}; it must be a generator, a whole number, from 0 and below "
        "2**62, or None"
    )


# ---- switches and places


def read_flag(x: Any, what: str) -> bool:
    """Read a switch. Errors: `InputError` for values other than True and False."""
    truth: Any = x
    if isinstance(x, (bool, np.bool_)):
        return bool(truth)
    raise InputError(f"{what} is {format_value(x)}; it must be True or False")


def read_batch_index(index: Any, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Read the index of one answer in a batch of this shape, counted from 0. Errors: `InputError`."""
    places: Any = index
    at: tuple[Any, ...] = places if isinstance(index, tuple) else (index,)
    if len(at) == len(shape) and all(
        _is_bounded_integer(i) and 0 <= i < n for i, n in zip(at, shape, strict=True)
    ):
        return tuple(int(i) for i in at)
    needed = (
        f"{format_count(len(shape), 'whole number')}, from 0 and below {shape}"
        if shape
        else "(), for there is one answer"
    )
    raise InputError(f"index is {format_value(places)}; it must be {needed}")


# ---- starts, steps, time, seeds and tolerances

DRAWN = 10**6
"""Starts of a search that draws them all before it begins, at most."""


def read_start_count(starts: object, most: int = 2**62 - 1) -> int:
    """Read the number of starts of a search, from 1 to `most`. Errors: `InputError`."""
    if not is_whole(starts) or not 1 <= starts <= most:
        above = f" and at most {most}" if most == DRAWN else ""
        raise InputError(
            f"starts is {format_value(starts)}; it must be a whole number, at least 1{above}"
        )
    return int(starts)


def read_step_count(iterations: object) -> int:
    """Read the number of iterations of one start, at least 1. Errors: `InputError`."""
    if not is_whole(iterations) or not 1 <= iterations < 2**31:
        raise InputError(
            f"iterations is {format_value(iterations)}; it must be a whole number, at least 1"
        )
    return int(iterations)


LONGEST = 1e15
"""Seconds above which a time limit is none."""


def compute_deadline(time_limit: Any) -> float:
    """Compute when a search that starts now must end, in seconds of `time.monotonic`. Infinity
    without a limit.

    Errors: `InputError`.
    """
    if time_limit is None:
        return math.inf
    if (
        isinstance(time_limit, bool)
        or not isinstance(time_limit, (int, float))
        or not time_limit > 0.0
    ):
        raise InputError(
            f"time_limit is {format_value(time_limit)}; it must be a positive number of seconds, "
            "or None"
        )
    return time.monotonic() + (math.inf if time_limit > LONGEST else float(time_limit))


def draw_seed(rng: object) -> int:
    """Draw a seed from a generator, or return the given whole number. Errors: `InputError`."""
    if is_whole(rng) and 0 <= rng < 2**62:
        return int(rng)
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**62))
    raise InputError(
        f"rng is {format_value(rng)}; it must be a generator or a whole number, from 0 and below "
        "2**62"
    )


def read_tolerances(tolerance: Any) -> tuple[float, float]:
    """Read one or two tolerances as a pair (metres, radians). Errors: `InputError`."""
    try:
        linear, angular = (tolerance, tolerance) if np.ndim(tolerance) == 0 else tolerance
        if 0.0 < linear < math.inf and 0.0 < angular < math.inf:
            return float(linear), float(angular)
    except (TypeError, ValueError):
        pass
    raise InputError(
        f"tolerance is {format_value(tolerance)}; it must be one or two positive numbers, in "
        "metres and radians"
    )
