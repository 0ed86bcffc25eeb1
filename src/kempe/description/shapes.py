"""Kinds of shapes for the appearance of bodies and for collisions.

A kind is a frozen dataclass that declares its sizes and how each is checked. A shape lies about its
own origin: spheres, boxes, cylinders, capsules and ellipsoids are centred there, and cylinders and
capsules have z as their axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from typing import Any, ClassVar

from kempe.arrays import is_real, is_sequence
from kempe.errors import InputError, UnknownNameError, format_value
from kempe.values import Expression, Value, evaluate_value, read_value, read_values
from kempe.words import join_words

Triple = tuple[Value, Value, Value]
"""Three numbers, or expressions in parameters."""


def _check_length(given: Any, what: str) -> Value:
    """Return a length above zero [m].

    Errors: `InputError`.
    """
    found = read_value(given, what)
    if not isinstance(found, Expression) and not found > 0.0:
        raise InputError(f"{what} is {found:g}; it must be above zero")
    return found


def _check_lengths(given: Any, what: str) -> tuple[Value, ...]:
    """Return three lengths above zero [m].

    Errors: `InputError`.
    """
    found = read_values(given, 3, what)
    if any(not isinstance(x, Expression) and not x > 0.0 for x in found):
        raise InputError(f"{what} is {_format_sizes(found)}; its three lengths must be above zero")
    return found


def _check_scale(given: Any, what: str) -> tuple[Value, ...]:
    """Return three scale factors that are not zero; one number stands for three equal factors."""
    alike = is_real(given) or isinstance(given, (str, Expression))
    found = read_values((given, given, given) if alike else given, 3, what)
    if 0.0 in found:
        raise InputError(f"{what} is {_format_sizes(found)}; its three factors must not be zero")
    return found


def _check_path(given: Any, what: str) -> str:
    """Return the path of a file as text.

    Errors: `InputError`.
    """
    if not isinstance(given, str) or not given.strip():
        raise InputError(f"{what} is {format_value(given)}; it must be text, not empty")
    return given


def _format_sizes(xs: Any, unit: str = "") -> str:
    """Return numbers as text: '0.1 x 0.2 x 0.3 m', 'l/2'; expressions have no unit."""
    given = xs if is_sequence(xs) else (xs,)
    texts = [x.text if isinstance(x, Expression) else f"{x:.6g}" for x in given]
    return " x ".join(texts) + unit * all(isinstance(x, float) for x in given)


def _make_checked_field(check: Callable[[Any, str], Any], **usual: Any) -> Any:
    """Return a dataclass field with the function that checks its value."""
    return field(metadata={"check": check}, **usual)


@dataclass(frozen=True)
class Geometry:
    """Base of the kinds of shapes; sizes are in metres, or expressions in parameters."""

    kind: ClassVar[str] = ""
    """Its name in calls and files."""

    def __post_init__(self) -> None:
        for name, check, what in _list_checks(type(self)):
            object.__setattr__(self, name, check(getattr(self, name), what))

    @property
    def sizes(self) -> dict[str, Any]:
        """Sizes of the shape by name, and the path of a mesh."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def names(self) -> frozenset[str]:
        """Names of the parameters in the sizes of the shape."""
        return frozenset(n for x in self._list_expressions() for n in x.names)

    def evaluate_sizes(self, parameters: Mapping[str, Any]) -> Any:
        """Return the same shape with numbers in place of expressions.

        Errors: `InputError` for sizes that are not above zero.
        """
        if not self._list_expressions():
            return self
        numbers: dict[str, Any] = {}
        for name, x in self.sizes.items():
            if is_sequence(x):
                numbers[name] = tuple(float(evaluate_value(v, parameters)) for v in x)
            elif isinstance(x, Expression):
                numbers[name] = float(evaluate_value(x, parameters))
        return replace(self, **numbers)

    def _list_expressions(self) -> list[Expression]:
        """Return the expressions among the sizes."""
        given: list[Any] = []
        for x in self.sizes.values():
            given += x if is_sequence(x) else (x,)
        return [x for x in given if isinstance(x, Expression)]

    def __str__(self) -> str:
        """The kind with its sizes: 'capsule of radius 0.04 m and length 0.4 m'."""
        sizes = [f"{name} {_format_sizes(x, ' m')}" for name, x in self.sizes.items()]
        return f"{self.kind} of {' and '.join(sizes)}"


def _add_article(kind: type[Geometry]) -> str:
    """Return the kind of shape with its article: 'a box', 'an ellipsoid'."""
    return f"{'an' if kind.kind[:1] in 'aeio' else 'a'} {kind.kind}"


@cache
def _list_checks(kind: type[Geometry]) -> list[tuple[str, Callable[[Any, str], Any], str]]:
    """Return the name of each size of a kind, its check, and its name in messages."""
    return [
        (f.name, f.metadata["check"], f"the {f.name} of {_add_article(kind)}") for f in fields(kind)
    ]


@dataclass(frozen=True)
class Sphere(Geometry):
    """Sphere with `radius`."""

    kind: ClassVar[str] = "sphere"
    radius: Value = _make_checked_field(_check_length)


@dataclass(frozen=True)
class Box(Geometry):
    """Box with side lengths `size` along x, y and z."""

    kind: ClassVar[str] = "box"
    size: Triple = _make_checked_field(_check_lengths)


@dataclass(frozen=True)
class Cylinder(Geometry):
    """Cylinder along z with its whole height `length`."""

    kind: ClassVar[str] = "cylinder"
    radius: Value = _make_checked_field(_check_length)
    length: Value = _make_checked_field(_check_length)


@dataclass(frozen=True)
class Capsule(Geometry):
    """Cylinder along z of this `length` with a hemisphere on each end.

    The whole height is ``length + 2 * radius``.
    """

    kind: ClassVar[str] = "capsule"
    radius: Value = _make_checked_field(_check_length)
    length: Value = _make_checked_field(_check_length)


@dataclass(frozen=True)
class Ellipsoid(Geometry):
    """Ellipsoid with semi-axes `radii` along x, y and z."""

    kind: ClassVar[str] = "ellipsoid"
    radii: Triple = _make_checked_field(_check_lengths)


@dataclass(frozen=True)
class Mesh(Geometry):
    """Triangles of a file, multiplied by `scale` along x, y and z.

    The path is kept as text, and the file is read only where it is drawn.
    """

    kind: ClassVar[str] = "mesh"
    path: str = _make_checked_field(_check_path)
    scale: Triple = _make_checked_field(_check_scale, default=(1.0, 1.0, 1.0))

    def __str__(self) -> str:
        """The path, and the scale where it is not 1: 'mesh arm.stl scaled by 0.001 x 0.001 x
        0.001'.
        """
        scaled = "" if self.scale == (1.0, 1.0, 1.0) else f" scaled by {_format_sizes(self.scale)}"
        return f"mesh {self.path}{scaled}"


SHAPES: dict[str, type[Geometry]] = {
    cls.kind: cls for cls in (Sphere, Box, Cylinder, Capsule, Ellipsoid, Mesh)
}
"""The kinds of shapes by name."""


def list_size_names(kind: type[Geometry]) -> tuple[str, ...]:
    """Return the names of the sizes of a kind of shapes."""
    return tuple(f.name for f in fields(kind))


def make_geometry(kind: object, given: Mapping[str, Any]) -> Geometry:
    """Return the shape of a kind with these sizes; None stands for a size that is not given.

    Errors: `UnknownNameError` for the kind; `InputError` for sizes that are missing, wrong, or of
    another kind.
    """
    sizes = {k: x for k, x in given.items() if x is not None}
    if isinstance(kind, Geometry):
        if sizes:
            raise InputError(
                f"{next(iter(sizes))} is given beside a shape that has its sizes: {kind}"
            )
        return kind
    made = SHAPES.get(kind) if isinstance(kind, str) else None
    if made is None:
        raise UnknownNameError("kind of shape", kind, SHAPES)
    needed = [f.name for f in fields(made) if f.default is MISSING]
    optional = [name for name in list_size_names(made) if name not in needed]
    allowed = f"it must have {join_words(needed)}" + "".join(f" and may have {x}" for x in optional)
    for name in sizes:
        if name not in list_size_names(made):
            raise InputError(f"{_add_article(made)} has no {name}; {allowed}")
    for name in needed:
        if name not in sizes:
            raise InputError(f"the {name} of {_add_article(made)} is missing; {allowed}")
    return made(**sizes)
