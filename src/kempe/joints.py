"""The joint zoo: each joint type is one small class that *declares* its primitives; kernels do the arithmetic.

A joint connects frame F on its parent body to frame M on its child body. Its pose X_FM(q) is a product of primitives:
turns and slides about and along the axes x, y, z of the frame reached so far, and unit quaternions. Most complex
joints are combinations of revolute and prismatic ones; the classes say which.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.errors import InputError, UnknownNameError
from kempe.kernels.layout import BALL, SLIDE, TURN
from kempe.reals import is_real, reals

R, P, Q = TURN, SLIDE, BALL
"""Kinds of primitives in the table of the kernels: turn, slide, unit quaternion."""


class Primitive(NamedTuple):
    """One elementary motion: kind, axis of the frame reached so far, coordinate within the joint, multiplier."""

    kind: int
    axis: str
    coordinate: int
    multiplier: float = 1.0


@dataclass(frozen=True)
class JointType:
    """Base of the zoo. A subclass names its type, coordinates and primitives; the rest follows."""

    type_name: ClassVar[str] = ""
    summary: ClassVar[str] = ""
    planar: ClassVar[bool] = False
    """Whether the joint can be used in planar systems (dim = 2)."""

    def layout(self, dim: int = 3, particle: bool = False) -> tuple[tuple[str, ...], tuple[Primitive, ...]]:
        """Coordinate names within the joint and its primitives, in space or in the plane, for a body or a particle."""
        raise NotImplementedError

    def dof(self, dim: int = 3, particle: bool = False) -> int:
        """Degrees of freedom that the joint leaves, which is also its number of velocity coordinates."""
        return sum(3 if p.kind == Q else 1 for p in _unique(self.layout(dim, particle)[1]))

    def constraints(self, dim: int = 3, particle: bool = False) -> int:
        """How many freedoms the joint takes away: of 6 (in the plane 3) for a body, of 3 (2) for a particle."""
        free = dim if particle else (6 if dim == 3 else 3)
        return free - self.dof(dim, particle)

    def coordinates(self, dim: int = 3, particle: bool = False) -> tuple[str, ...]:
        """Names of the coordinates within the joint; a joint with one coordinate has the name ''."""
        return self.layout(dim, particle)[0]

    def velocities(self, dim: int = 3, particle: bool = False) -> tuple[str, ...]:
        """Names of the velocity coordinates: as the coordinates, with wx, wy, wz (axes of M) for a quaternion."""
        names, primitives = self.layout(dim, particle)
        quaternions = {p.coordinate for p in primitives if p.kind == Q}
        if not quaternions:
            return tuple(names)
        out: list[str] = []
        for i, name in enumerate(names):
            if i in quaternions:
                out += ["wx", "wy", "wz"]
            elif not any(first < i < first + 4 for first in quaternions):
                out.append(name)
        return tuple(out)

    @property
    def decomposition(self) -> str:
        """The joint as a combination of revolute (R) and prismatic (P) joints, as text."""
        parts = []
        for kind, axis, _, multiplier in self.layout()[1]:
            if kind == Q:
                parts.append("R R R (as one unit quaternion)")
            else:
                coupled = f", {multiplier:g} q" if multiplier != 1.0 else ""
                parts.append(f"{'RP'[kind]}({axis}{coupled})")
        return " ".join(parts) or "rigid"

    @property
    def options(self) -> dict[str, object]:
        """Settings that differ from their defaults, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}


@dataclass(frozen=True)
class Fixed(JointType):
    """No motion: the two bodies are one."""

    type_name = "fixed"
    summary = "no motion"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """No coordinates."""
        return (), ()


@dataclass(frozen=True)
class Revolute(JointType):
    """A hinge: turn about z of F."""

    type_name = "revolute"
    summary = "turn about z"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """One turn."""
        return ("",), (Primitive(R, "z", 0),)


@dataclass(frozen=True)
class Prismatic(JointType):
    """A slider: slide along z of F."""

    type_name = "prismatic"
    summary = "slide along z"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """One slide."""
        return ("",), (Primitive(P, "z", 0),)


@dataclass(frozen=True)
class Helical(JointType):
    """A screw: turn about z and slide along it together, `pitch` metres a radian (Lynch, Park, 2017, section 2.2)."""

    type_name = "helical"
    summary = "turn about z and slide along it by pitch times the angle"
    pitch: float = 0.0

    def layout(self, dim: int = 3, particle: bool = False):
        """A turn and a slide that share one coordinate, the angle."""
        return ("",), (Primitive(R, "z", 0), Primitive(P, "z", 0, self.pitch))


@dataclass(frozen=True)
class Cylindrical(JointType):
    """A sleeve on a shaft: turn about z and slide along it, independently."""

    type_name = "cylindrical"
    summary = "turn about z, slide along z"

    def layout(self, dim: int = 3, particle: bool = False):
        """A turn and a slide."""
        return ("rz", "z"), (Primitive(R, "z", 0), Primitive(P, "z", 1))


@dataclass(frozen=True)
class Universal(JointType):
    """A Cardan joint: turn about x of F, then about y of the cross."""

    type_name = "universal"
    summary = "turn about x of F, then about y of M"

    def layout(self, dim: int = 3, particle: bool = False):
        """Two turns."""
        return ("rx", "ry"), (Primitive(R, "x", 0), Primitive(R, "y", 1))


@dataclass(frozen=True)
class Planar(JointType):
    """A block on a table: slide along x and y of F, then turn about z."""

    type_name = "planar"
    summary = "slide along x and y, turn about z"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Two slides and a turn; a particle only slides."""
        if particle:
            return ("x", "y"), (Primitive(P, "x", 0), Primitive(P, "y", 1))
        return ("x", "y", "rz"), (Primitive(P, "x", 0), Primitive(P, "y", 1), Primitive(R, "z", 2))


@dataclass(frozen=True)
class Translation(JointType):
    """Three sliders (two in the plane): the orientation stays, the position is free."""

    type_name = "translation"
    summary = "slide along x, y and z (in the plane x and y)"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """A slide along each axis."""
        return tuple("xyz"[:dim]), tuple(Primitive(P, a, i) for i, a in enumerate("xyz"[:dim]))


@dataclass(frozen=True)
class Spherical(JointType):
    """A ball joint: any rotation, as a unit quaternion; with `angles`, three turns about z, y', x''.

    With angles there are as many coordinates as degrees of freedom, at the price of a singularity at ry = +-90 degrees.
    """

    type_name = "spherical"
    summary = "any rotation"
    angles: bool = False

    def layout(self, dim: int = 3, particle: bool = False):
        """A quaternion, or three turns."""
        if self.angles:
            return ("rz", "ry", "rx"), tuple(Primitive(R, a, i) for i, a in enumerate("zyx"))
        return ("qw", "qx", "qy", "qz"), (Primitive(Q, "z", 0),)


@dataclass(frozen=True)
class Free(JointType):
    """No constraint at all: 6 degrees of freedom in space, 3 in the plane, as many as a particle has for one."""

    type_name = "free"
    summary = "any motion"
    planar = True
    angles: bool = False

    def layout(self, dim: int = 3, particle: bool = False):
        """Slides, then a rotation as in `Spherical`; in the plane as in `Planar`."""
        if particle:
            return Translation().layout(dim)
        if dim == 2:
            return Planar().layout(dim)
        names, slides = Translation().layout()
        ball_names, turns = Spherical(self.angles).layout()
        return names + ball_names, slides + tuple(t._replace(coordinate=t.coordinate + 3) for t in turns)


TYPES: dict[str, type[JointType]] = {
    t.type_name: t
    for t in (Fixed, Revolute, Prismatic, Helical, Cylindrical, Universal, Planar, Translation, Spherical, Free)
}
"""The table of the zoo: one row a joint type."""


def joint_type(name: str | JointType, **options: object) -> JointType:
    """A joint type by its name (or another joint type) and options.

    Errors: `UnknownNameError` for the name, `InputError` for options that the type does not take.
    """
    if isinstance(name, JointType):
        kind, options = type(name), {**name.options, **options}
    elif isinstance(name, str) and name in TYPES:
        kind = TYPES[name]
    else:
        raise UnknownNameError("joint type", name, TYPES)
    known = {f.name: f.default for f in fields(kind)}
    for key, given in options.items():
        if key not in known:
            allowed = f"it takes {', '.join(known)}" if known else "it takes no options"
            raise InputError(f"joint type {kind.type_name!r} has no option {key!r}; {allowed}")
        if isinstance(known[key], bool):
            if not isinstance(given, (bool, np.bool_)):
                raise InputError(f"option {key!r} is {given!r}; it must be true or false")
        elif not is_real(given) or not np.isfinite(float(given)):
            raise InputError(f"option {key!r} is {given!r}; it must be a finite number")
    return kind(**{k: type(known[k])(v) for k, v in options.items()})  # type: ignore[arg-type, call-arg]


AXIS_ROTATIONS = {"x": spatial.align_z([1.0, 0, 0]), "y": spatial.align_z([0.0, 1, 0]), "z": np.eye(3)}
"""The rotation that takes z to each axis: primitives of the table always turn about z or slide along it."""


def _unique(primitives: tuple[Primitive, ...]) -> list[Primitive]:
    return list({p.coordinate: p for p in primitives}.values())


@dataclass(frozen=True)
class Layout:
    """How an array `q` is made up: plain coordinates, and unit quaternions (w, x, y, z) whose velocities are angular.

    `vector_q[i]` is the coordinate whose velocity is `vector_v[i]`; a quaternion starts at `quaternion_q[k]`, its
    three angular velocities, in the axes of the turned frame, at `quaternion_v[k]`.
    """

    nq: int
    nv: int
    vector_q: np.ndarray
    vector_v: np.ndarray
    quaternion_q: np.ndarray
    quaternion_v: np.ndarray

    @cached_property
    def neutral(self) -> spatial.Array:
        """Zero coordinates and identity quaternions (nq,); read-only."""
        q = np.zeros(self.nq)
        q[self.quaternion_q] = 1.0
        q.setflags(write=False)
        return q

    def _quaternions(self, q: spatial.Array) -> spatial.Array:
        return q[..., self.quaternion_q[:, None] + np.arange(4)]

    def integrate(self, q: ArrayLike, v: ArrayLike) -> spatial.Array:
        """Configuration (..., nq) reached from `q` by the tangent vector `v` (..., nv) in one unit of time."""
        q, v = reals(q, "q"), reals(v, "v")
        out = np.array(np.broadcast_to(q, (*np.broadcast_shapes(q.shape[:-1], v.shape[:-1]), self.nq)))
        out[..., self.vector_q] += v[..., self.vector_v]
        if self.quaternion_q.size:
            w = v[..., self.quaternion_v[:, None] + np.arange(3)]
            turned = spatial.quat_wxyz_multiply(spatial.unit(self._quaternions(q)), spatial.quat_wxyz_exp(w))
            out[..., self.quaternion_q[:, None] + np.arange(4)] = spatial.unit(turned)
        return out

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> spatial.Array:
        """Tangent vector (..., nv) that `integrate` needs to go from `q0` to `q1`; rotations go the short way."""
        q0, q1 = reals(q0, "q0"), reals(q1, "q1")
        out = np.zeros((*np.broadcast_shapes(q0.shape[:-1], q1.shape[:-1]), self.nv))
        out[..., self.vector_v] = q1[..., self.vector_q] - q0[..., self.vector_q]
        if self.quaternion_q.size:
            a, b = spatial.unit(self._quaternions(q0)), spatial.unit(self._quaternions(q1))
            w = spatial.quat_wxyz_log(spatial.quat_wxyz_multiply(spatial.quat_wxyz_conjugate(a), b))
            out[..., self.quaternion_v[:, None] + np.arange(3)] = w
        return out

    def random_quaternions(self, q: spatial.Array, rng: np.random.Generator, order: np.ndarray | None = None) -> None:
        """Fill the quaternions of `q` (..., nq), in place, with uniformly distributed rotations."""
        for k in range(self.quaternion_q.size) if order is None else order:
            i = self.quaternion_q[k]
            q[..., i : i + 4] = spatial.unit(rng.normal(size=(*q.shape[:-1], 4)))


def layout_of(primitives: list[tuple[int, int, int]], nq: int, nv: int) -> Layout:
    """`Layout` of (kind, first coordinate, first velocity) triples, one for each independent primitive."""
    vectors = [(iq, iv) for kind, iq, iv in primitives if kind != Q]
    balls = [(iq, iv) for kind, iq, iv in primitives if kind == Q]
    vector = np.array(vectors, dtype=np.int64).reshape(-1, 2)
    ball = np.array(balls, dtype=np.int64).reshape(-1, 2)
    for array in (vector, ball):
        array.setflags(write=False)
    return Layout(nq, nv, vector[:, 0], vector[:, 1], ball[:, 0], ball[:, 1])
