"""Conversion of configurations, velocities and Jacobians for Pinocchio, MuJoCo and ROS.

Joints are found by name in the model object of the other library, which is read by its attributes
and not imported.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.arguments import (
    broadcast_shapes,
    explain_errors,
    explain_init_errors,
    explain_method_errors,
    numbers,
)
from kempe.arrays import read_reals
from kempe.errors import InputError, UnknownNameError
from kempe.forward.fk import fk
from kempe.joints import Q, R
from kempe.model.configurations import (
    FIT,
    make_q,
    read_one_q,
    refuse_other_follower,
)
from kempe.model.coordinates import Follower, format_coordinate_name
from kempe.model.in_metres import InMetres
from kempe.spatial import Array
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.model import Model

# ---- the numbers of a joint

NUMBER = "n"
"""A length, or an angle."""
ALONG = "t"
"""A length whose velocity is along the axes that the joint's turn, which follows, has reached."""
CIRCLE = "a"
"""An angle; in other libraries its cosine and sine."""
BALL = "b"
"""A unit quaternion, with an angular velocity in the turned axes."""
WIDTH = {NUMBER: 1, ALONG: 1, CIRCLE: 2, BALL: 4}
"""How many numbers of a configuration each has in other libraries."""
RATES = {NUMBER: 1, ALONG: 1, CIRCLE: 1, BALL: 3}
"""How many velocities."""
ON_CIRCLE = 1e-3
"""How far the length of a cosine and sine may be from 1."""
SHOWN = 8
"""Problems that one message names."""


class LibraryModel(Protocol):
    """A model of Pinocchio or MuJoCo."""

    nq: int
    nv: int


class JointState(Protocol):
    """A message of ROS with names and values of coordinates."""

    name: Any
    position: Any
    velocity: Any


Message = TypeVar("Message", bound=JointState)


class Place(NamedTuple):
    """One part of a joint of another library: its kind, and its first indices in q and v."""

    kind: str
    q: int
    v: int


class Theirs(NamedTuple):
    """A joint of another library, and the name of the body that it moves, where known."""

    name: str
    body: str
    places: list[Place]

    @property
    def kinds(self) -> str:
        """Kinds of the joint's parts, as a text."""
        return "".join(p.kind for p in self.places)


class Library(NamedTuple):
    """Another library: its name, attributes of its models, and a reader of their joints.

    `order` is the order of w, x, y, z in its quaternions.
    """

    name: str
    model: str
    attributes: tuple[str, ...]
    joints: Callable[[Any], Iterable[Theirs]]
    order: tuple[int, int, int, int]
    free_on_ground: bool
    """Whether a free joint is measured from the ground, wherever the description puts it."""


def _build_places(kinds: str, q: int, v: int) -> list[Place]:
    """Build the parts of a joint from their kinds, with consecutive indices in q and v."""
    out: list[Place] = []
    for kind in kinds:
        out.append(Place(kind, q, v))
        q += WIDTH[kind]
        v += RATES[kind]
    return out


PINOCCHIO_KINDS = {(7, 6): 3 * ALONG + BALL, (4, 3): BALL, (2, 1): CIRCLE}
"""Of joints with so many numbers in q and v."""


def _read_pinocchio_joints(model: Any) -> Iterator[Theirs]:
    """Read the joints of a Pinocchio model."""
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
        yield Theirs(
            str(name),
            "",
            _build_places(_find_pinocchio_kinds(joint, str(name)), joint.idx_q, joint.idx_v),
        )


def _find_pinocchio_kinds(joint: Any, name: str) -> str:
    """Find the kinds of the parts of a Pinocchio joint.

    Errors: `InputError` for unknown joints.
    """
    kind: str = joint.shortname()
    if kind.endswith("Composite"):
        return "".join(_find_pinocchio_kinds(part, name) for part in joint.extract().joints)
    if kind.endswith("Planar"):
        return 2 * ALONG + CIRCLE
    size: tuple[int, int] = (joint.nq, joint.nv)
    if size in PINOCCHIO_KINDS:
        return PINOCCHIO_KINDS[size]
    if size[0] != size[1]:
        raise InputError(f"joint {name!r} of the Pinocchio model is a {kind}, which is not known")
    return size[0] * NUMBER


MUJOCO_KINDS = (3 * NUMBER + BALL, BALL, NUMBER, NUMBER)
"""Of the joints free, ball, slide and hinge, by their number in `jnt_type`."""


def _read_mujoco_joints(model: Any) -> Iterator[Theirs]:
    """Read the joints of a MuJoCo model.

    Bodies without a name are named by their number, as where Kempe reads MJCF.
    """
    for i in range(model.njnt):
        number = int(model.jnt_bodyid[i])
        body = str(model.body(number).name) or f"body{number}"
        kinds = MUJOCO_KINDS[int(model.jnt_type[i])]
        at = _build_places(kinds, int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i]))
        yield Theirs(str(model.joint(i).name), body, at)


PINOCCHIO = Library(
    "Pinocchio",
    "Model",
    ("names", "joints", "nq", "nv"),
    _read_pinocchio_joints,
    (3, 0, 1, 2),
    False,
)
MUJOCO = Library(
    "MuJoCo",
    "MjModel",
    ("njnt", "jnt_type", "jnt_qposadr"),
    _read_mujoco_joints,
    (0, 1, 2, 3),
    True,
)
LIBRARIES = (PINOCCHIO, MUJOCO)


def _find_library(model: Any) -> Library:
    """Find the library that a model belongs to.

    Errors: `InputError`.
    """
    for library in LIBRARIES:
        if all(hasattr(model, name) for name in library.attributes):
            return library
    allowed = " or ".join(f"a {x.model} of {x.name}" for x in LIBRARIES)
    raise InputError(f"model is {type(model).__name__}; it must be {allowed}")


# ---- joints of one and the other


class Ours(NamedTuple):
    """A joint of a system, with the kind and the coordinate names of each of its parts."""

    joint: Joint
    parts: list[tuple[str, list[str]]]

    @property
    def kinds(self) -> str:
        """Kinds of the joint's parts, as a text."""
        return "".join(kind for kind, _ in self.parts)


def _split_joint(system: Model, joint: Joint) -> Ours:
    """Split a joint of a system into parts of one kind each."""
    names, primitives = joint.type.layout(system.dim, joint.of_particle)
    full = [format_coordinate_name(joint.name, n) for n in names]
    parts: list[tuple[str, list[str]]] = []
    i = 0
    while i < len(full):
        kinds = {p.kind for p in primitives if p.coordinate == i}
        kind = BALL if Q in kinds else CIRCLE if kinds == {R} else NUMBER
        size = 4 if kind == BALL else 1
        parts.append((kind, full[i : i + size]))
        i += size
    return Ours(joint, parts)


def _remove_locked_parts(system: Model, ours: Ours) -> Ours:
    """Return the joint without its locked parts, if any others are left."""
    laws = system.structure.couplings
    locked = [names[0] in laws and laws[names[0]].source is None for _, names in ours.parts]
    left = [part for part, held in zip(ours.parts, locked, strict=True) if not held]
    return Ours(ours.joint, left) if left else ours


SAME = {(NUMBER, NUMBER), (NUMBER, ALONG), (CIRCLE, NUMBER), (CIRCLE, CIRCLE), (BALL, BALL)}
"""Kinds, here and there, that can mean the same."""


def _can_correspond(ours: Ours, places: list[Place]) -> bool:
    """Return whether a joint's coordinates can correspond to the given parts.

    A fixed joint fits any.
    """
    kinds = [p.kind for p in places]
    pairs = zip(ours.kinds, kinds, strict=False)
    return not ours.parts or (len(kinds) == len(ours.parts) and SAME.issuperset(pairs))


def _pair_joints(
    system: Model, theirs: Iterable[Theirs], library: Library, partial: bool
) -> list[tuple[Ours, list[Place]]]:
    """Pair the joints of the system with the parts of their counterparts in the other model.

    A counterpart has the same name, or is all joints of the body that the joint moves, or the only
    one of its kind that is left on both sides.

    Errors: `InputError` that names those without a counterpart, unless `partial`.
    """
    ours = [_split_joint(system, j) for j in system.structure.joints.values()]
    left = [t for t in theirs if t.places]
    pairs: list[tuple[Ours, list[Place]]] = []

    def find_by_name(mine: Ours) -> list[Theirs]:
        return [t for t in left if t.name == mine.joint.name]

    def find_by_body(mine: Ours) -> list[Theirs]:
        found = [t for t in left if t.body and t.body == mine.joint.child]
        return found if len(mine.parts) > 1 or not any(t.name for t in found) else []

    def find_by_kind(mine: Ours) -> list[Theirs]:
        found = [
            t for t in left if len(t.places) > 1 and mine.parts and _can_correspond(mine, t.places)
        ]
        alone = sum(1 for m in ours if m.kinds == mine.kinds) == 1
        return found if len(found) == 1 and alone else []

    for way in (find_by_name, find_by_body, find_by_kind):
        for mine in tuple(ours):
            found = way(mine)
            places = [p for t in found for p in t.places]
            fits = [
                m for m in (mine, _remove_locked_parts(system, mine)) if _can_correspond(m, places)
            ]
            if found and fits:
                pairs.append((fits[0], places))
                ours.remove(mine)
                left = [t for t in left if t not in found]
    _refuse_unpaired_joints(system, ours, left, library, partial)
    return pairs


def _refuse_unpaired_joints(
    system: Model, ours: list[Ours], theirs: list[Theirs], library: Library, partial: bool
) -> None:
    """Refuse moving joints without a counterpart, with an `InputError`.

    If `partial`, refuse only joints of one name that do not correspond.
    """
    followers = system.structure.couplings
    moving = [m for m in ours if any(n not in followers for _, part in m.parts for n in part)]
    size = {t.name: sum(WIDTH[p.kind] for p in t.places) for t in theirs}
    here = {m.joint.name for m in moving}
    said: list[str] = []
    for mine in moving:
        name = mine.joint.name
        if name in size:
            n = sum(len(part) for _, part in mine.parts)
            said.append(
                f"joint {name!r} has {format_count(n, 'coordinate')}, and "
                f"{format_count(size[name], 'number')} in the {library.name} model: these do not "
                "correspond"
            )
        elif not partial:
            loop = name in system.structure.closures
            hint = (
                "it closes a loop: see open_loops()" if loop else "where it is fixed there, lock it"
            )
            said.append(f"joint {name!r} is not in the {library.name} model ({hint})")
    for t in theirs:
        if not partial and t.name not in here:
            name = f"{t.name!r}" if t.name else f"without a name, of body {t.body!r},"
            said.append(f"joint {name} of the {library.name} model is not in {system.name!r}")
    if said:
        more = f"; {len(said) - SHOWN} more" if len(said) > SHOWN else ""
        hint = "" if partial else ". With base=... only joints of both are converted"
        raise InputError("; ".join(said[:SHOWN]) + more + hint)


# ---- the correspondence


class Entry(NamedTuple):
    """One number of a model: its index, and the coordinate of the system that gives its value.

    `source` is the index in the system's array, one behind the end for held coordinates; `follower`
    is the rule by which the number follows.
    """

    kind: str
    at: int
    name: str
    source: int
    follower: Follower | None


class Turned(NamedTuple):
    """Velocities along rotated axes: first index, number, and the entry of the rotation."""

    first: int
    size: int
    turn: int


@explain_init_errors
@explain_method_errors
class Correspondence:
    """Conversion between a system and a model of Pinocchio or MuJoCo, in both directions.

    It converts configurations, velocities and Jacobians, and is made once for many conversions;
    `kempe.convert.to_pinocchio` and its like make one in each call.

    Parameters
    ----------
    system
        The system.
    model
        Model of Pinocchio or MuJoCo, of the same description: placements are not compared.
    tolerance
        Largest misfit of followers, in radians or metres, and relative to the number.
    partial
        Whether only joints on both sides are converted, such as those of a robot among other
        bodies. The others are as in a configuration `base` of the side that is asked for, and at
        rest.

    Raises
    ------
    InputError
        Joints without a counterpart, by name, unless `partial`; followers that do not fit.

    See Also
    --------
    kempe.convert.to_pinocchio, kempe.convert.from_mujoco : Single conversions.

    Notes
    -----
    Joints are paired by name; a free base also with one of another name; and several joints of a
    body in MuJoCo with the one joint here that moves the body of that name. Followers are computed
    here and may be joints of their own there; so may joints that are locked or fixed here. Lengths
    of the model are metres; those of the system are in its unit. All arrays may have leading axes.
    """

    def __init__(
        self, system: Model, model: LibraryModel, tolerance: float = FIT, partial: bool = False
    ):
        library = _find_library(model)
        self._in_unit = InMetres(system)
        """Conversion of the system's slides, of which all else here is in metres."""
        self.system = system = self._in_unit.system
        self.library = library.name
        self.tolerance = float(numbers(tolerance, "tolerance"))
        self.nq = int(model.nq)
        self.nv = int(model.nv)
        self._order = np.array(library.order)
        self._entries: list[Entry] = []
        self._rates: list[Entry] = []
        self._turned: list[Turned] = []
        self._begins: list[tuple[Place, Place, Array]] = []
        for ours, places in _pair_joints(system, library.joints(model), library, partial):
            self._add_joint_pair(ours, places)
            if library.free_on_ground and ours.kinds == 3 * NUMBER + BALL:
                self._add_free_joint_origin(ours.joint, places)
        self._pack_entries()

    def __repr__(self) -> str:
        return f"Correspondence of {self.system.name!r} and a model of {self.library}, nq={self.nq}"

    # ---- how it is made

    def _add_joint_pair(self, ours: Ours, places: list[Place]) -> None:
        """Add the numbers of a pair of joints."""
        along: list[Place] = []
        names = [part for _, part in ours.parts] or [[ours.joint.name]] * len(places)
        for (name, *_), place in zip(names, places, strict=True):
            if place.kind == ALONG:
                along.append(place)
            elif along:
                self._turned.append(Turned(along[0].v, len(along), len(self._entries)))
                along = []
            if place.kind == BALL:
                self._add_ball(ours.joint.name, name, place)
                continue
            (i, k), follower = self._find_source(name)
            self._entries.append(Entry(place.kind, place.q, name, i, follower))
            self._rates.append(Entry(NUMBER, place.v, name, k, follower))

    def _add_ball(self, joint: str, first: str, place: Place) -> None:
        """Add the numbers of a quaternion, whose first coordinate is `first`."""
        (i, k), held = self._find_source(first)
        for n, axis in enumerate("wxyz"):
            name = format_coordinate_name(joint, f"q{axis}")
            follower = held and self._find_source(name, float(n == 0))[1]
            at = place.q + int(self._order[n])
            self._entries.append(Entry(BALL, at, name, i + n * (held is None), follower))
        for n, axis in enumerate("xyz"):
            name = format_coordinate_name(joint, f"w{axis}")
            self._rates.append(Entry(NUMBER, place.v + n, name, k + n * (held is None), held))

    def _find_source(
        self, name: str, fixed: float = 0.0
    ) -> tuple[tuple[int, int], Follower | None]:
        """Find the indices of a coordinate's source in q and v, and the rule by which it follows.

        `fixed` is the value of a joint that has no coordinate here.
        """
        first = self.system.structure.coordinates.first
        if name in first:
            return first[name], None
        follower = self.system.structure.couplings.get(name, Follower(None, 0.0, fixed))
        if follower.source is None:
            return (self.system.nq, self.system.nv), follower
        return first[follower.source], follower

    def _add_free_joint_origin(self, joint: Joint, places: list[Place]) -> None:
        """Add the origin of a free joint, if that is not the frame of the ground."""
        system = self.system
        parameters = system.structure.parameters
        if system.structure.table.find_path(joint.parent):
            raise InputError(
                f"joint {joint.name!r} is free and begins on {joint.parent!r}, which moves; in "
                f"{self.library} it begins on the ground"
            )
        if not np.array_equal(joint.X_CM.evaluate_pose(parameters), np.eye(4)):
            raise InputError(
                f"joint {joint.name!r} is free and does not end in the frame of {joint.child!r}, "
                f"where it ends in {self.library}"
            )
        X = fk(system, system.neutral, joint.parent) @ joint.X_PF.evaluate_pose(parameters)
        if not np.array_equal(X, np.eye(4)):
            self._begins.append((places[0], places[3], X))

    def _pack_entries(self) -> None:
        """Pack the entries into arrays."""

        def make_index_array(x: Iterable[int]) -> np.ndarray:
            return np.array(list(x), dtype=np.int64)

        entries = self._entries
        rates = self._rates
        laws = [e.follower or Follower(None, 1.0, 0.0) for e in entries]
        self._factor = np.array([law.multiplier for law in laws])
        self._offset = np.array([law.offset for law in laws])
        self._at = make_index_array(e.at for e in entries)
        self._source_of = make_index_array(e.source for e in entries)
        self._own = make_index_array(k for k, e in enumerate(entries) if e.follower is None)
        self._angles = make_index_array(k for k, e in enumerate(entries) if e.kind == CIRCLE)
        self._balls = make_index_array(
            k for k, e in enumerate(entries) if e.kind == BALL and e.name.endswith("qw")
        )
        self._whole = len(entries) + len(self._angles)
        self._rate_at = make_index_array(e.at for e in rates)
        self._rate_source = make_index_array(e.source for e in rates)
        self._rate_own = make_index_array(k for k, e in enumerate(rates) if e.follower is None)
        self._spread = np.zeros((len(rates), self.system.nv + 1))
        for k, e in enumerate(rates):
            self._spread[k, e.source] = e.follower.multiplier if e.follower else 1.0
        self._spread = self._spread[:, :-1]

    # ---- configurations

    def to_q(self, q: Any, base: ArrayLike | None = None) -> Array:
        """Convert configurations of the system to those of the model.

        Parameters
        ----------
        q
            Configurations (..., nq) of the system, or values by name.
        base
            Configurations of the model with all numbers that the system does not have, if
            `partial`.

        Returns
        -------
        Array
            Configurations of the model, in its order and with its order of quaternions.

        Raises
        ------
        InputError
            For wrong shapes, and without the `base` that is needed.
        """
        values = self._compute_entries(self._in_unit.read_q(q))
        if base is None and self._whole < self.nq:
            raise InputError(
                f"base is None; it must be a configuration of the {self.library} model, for "
                f"{self.system.name!r} has {self._whole} of its {self.nq} numbers"
            )
        start = np.zeros(self.nq) if base is None else numbers(base, "base", self.nq)
        lead = broadcast_shapes({"q": values.shape[:-1], "base": start.shape[:-1]})
        out = np.broadcast_to(start, (*lead, self.nq)).copy()
        out[..., self._at] = values
        if self._angles.size:
            at = self._at[self._angles]
            angles = values[..., self._angles]
            out[..., at] = np.cos(angles)
            out[..., at + 1] = np.sin(angles)
        for slides, ball, X in self._begins:
            self._move_pose(out, slides, ball, X)
        return out

    def from_q(self, q: ArrayLike, base: Any = None) -> Array:
        """Convert configurations of the model to those of the system.

        Parameters
        ----------
        q
            Configurations of the model, with leading axes.
        base
            Configurations of the system with all coordinates that the model does not have. Default:
            neutral.

        Returns
        -------
        Array
            Configurations (..., nq) of the system.

        Raises
        ------
        InputError
            For wrong shapes, followers that do not fit, and numbers that are no cosine and sine.
        """
        values = self._read_entries(q)
        start = self.system.neutral if base is None else self._in_unit.read_q(base)
        lead = broadcast_shapes({"q": values.shape[:-1], "base": start.shape[:-1]})
        out = np.broadcast_to(start, (*lead, self.system.nq)).copy()
        out[..., self._source_of[self._own]] = values[..., self._own]
        self._add_whole_turns(out, values)
        wanted = self._compute_entries(out)
        for k, e in enumerate(self._entries):
            if e.follower is not None:
                turn = 2.0 * math.pi if e.kind == CIRCLE else 0.0
                self._refuse_misfit(f"coordinate {e.name!r}", e.follower, values, wanted, k, turn)
        return self._in_unit.write_q(out)

    def _add_whole_turns(self, q: Array, values: Array) -> None:
        """Add whole turns, in place, to angles known by cosine and sine, as a follower tells."""
        angles = {e.source for e in self._entries if e.kind == CIRCLE and e.follower is None}
        for k, e in enumerate(self._entries):
            if e.follower is not None and e.kind != CIRCLE and e.source in angles:
                angle = (values[..., k] - e.follower.offset) / e.follower.multiplier
                turns = np.round((angle - q[..., e.source]) / (2.0 * math.pi))
                q[..., e.source] += 2.0 * math.pi * turns
                angles.remove(e.source)

    def _refuse_misfit(
        self, what: str, law: Follower, given: Array, wanted: Array, k: int, turn: float = 0.0
    ) -> None:
        """Refuse a follower whose value does not fit within the tolerance."""
        refuse_other_follower(what, law, given[..., k], wanted[..., k], self.tolerance, turn)

    def _compute_entries(self, q: Array) -> Array:
        """Compute the entries (..., n) at q (..., nq); angles stand for cosines and sines."""
        ended = np.concatenate([q, np.zeros((*q.shape[:-1], 1))], axis=-1)
        values = ended[..., self._source_of] * self._factor + self._offset
        if self._balls.size:
            at = self._balls[:, None] + np.arange(4)
            values[..., at] = spatial.unit(values[..., at])
        return values

    def _read_entries(self, q: ArrayLike) -> Array:
        """Read the entries from a configuration of the model.

        Errors: `InputError` for other lengths, and for numbers that are no cosine and sine.
        """
        q = numbers(q, f"q of the {self.library} model", self.nq)
        if self._begins:
            q = q.copy()
        for slides, ball, X in self._begins:
            self._move_pose(q, slides, ball, spatial.inverse(X))
        values = q[..., self._at]
        if not self._angles.size:
            return values
        at = self._at[self._angles]
        c = q[..., at]
        s = q[..., at + 1]
        off = ~(np.abs(np.hypot(c, s) - 1.0) <= ON_CIRCLE)
        if off.any():
            where = tuple(np.argwhere(off)[0])
            name = self._entries[self._angles[where[-1]]].name
            raise InputError(
                f"coordinate {name!r} has the cosine {c[where]:.9g} and the sine {s[where]:.9g}; "
                "the sum of their squares must be 1"
            )
        values[..., self._angles] = np.arctan2(s, c)
        return values

    def _move_pose(self, q: Array, slides: Place, ball: Place, X: Array) -> None:
        """Move the pose of a free joint in a configuration of the model, in place, by X (4, 4)."""
        at = slice(slides.q, slides.q + 3)
        order = ball.q + self._order
        q[..., at] = q[..., at] @ X[:3, :3].T + X[:3, 3]
        turn = spatial.matrix_to_quat_wxyz(X[:3, :3])
        q[..., order] = spatial.quat_wxyz_multiply(turn, q[..., order])

    # ---- velocities and Jacobians

    def to_v(self, q: Any, v: ArrayLike) -> Array:
        """Convert velocities of the system to those of the model.

        Parameters
        ----------
        q
            Configurations (..., nq) of the system, or values by name.
        v
            Velocities (..., nv) at `q`.

        Returns
        -------
        Array
            Velocities of the model, in its order and axes; 0 for joints that the system does not
            have.
        """
        v = self._in_unit.convert_v(numbers(v, "v", self.system.nv))
        values = self._compute_entries(self._in_unit.read_q(q))
        out = np.zeros((*_merge_leading_shapes(v.shape[:-1], values), self.nv))
        out[..., self._rate_at] = v @ self._spread.T
        for at, turn in self._list_axis_turns(values):
            out[..., at] = (out[..., None, at] @ turn)[..., 0, :]
        return out

    def from_v(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Convert velocities of the model to those of the system.

        Parameters
        ----------
        q
            Configurations of the model, with leading axes.
        v
            Velocities of the model at `q`.

        Returns
        -------
        Array
            Velocities (..., nv) of the system.

        Raises
        ------
        InputError
            For velocities of followers that do not fit.
        """
        v = numbers(v, f"v of the {self.library} model", self.nv)
        values = self._read_entries(q)
        straight = np.broadcast_to(
            v, (*_merge_leading_shapes(v.shape[:-1], values), self.nv)
        ).copy()
        for at, turn in self._list_axis_turns(values):
            straight[..., at] = (turn @ straight[..., at, None])[..., 0]
        rates = straight[..., self._rate_at]
        out = np.zeros((*rates.shape[:-1], self.system.nv))
        out[..., self._rate_source[self._rate_own]] = rates[..., self._rate_own]
        wanted = out @ self._spread.T
        for k, e in enumerate(self._rates):
            if e.follower is not None:
                self._refuse_misfit(f"the velocity of {e.name!r}", e.follower, rates, wanted, k)
        return self._in_unit.write_v(out)

    def to_jacobian(self, q: Any, jacobian: ArrayLike) -> Array:
        """Convert Jacobians of the system to those of the model.

        Parameters
        ----------
        q
            Configurations (..., nq) of the system, or values by name.
        jacobian
            Jacobians (..., m, nv) at `q`, with any number m of rows.

        Returns
        -------
        Array
            Jacobians (..., m, nv of the model). Columns of followers are zero: the columns of their
            leaders contain their motion. Rows stay in the unit of what they are derivatives of.
        """
        J = numbers(jacobian, "jacobian")
        _check_columns(J, self.system.nv)
        J = self._in_unit.write_v(J)  # by a metre of a slide instead of its unit
        values = self._compute_entries(self._in_unit.read_q(q))
        out = np.zeros((*_merge_leading_shapes(J.shape[:-2], values), J.shape[-2], self.nv))
        out[..., self._rate_at[self._rate_own]] = J[..., self._rate_source[self._rate_own]]
        for at, turn in self._list_axis_turns(values):
            out[..., at] = out[..., at] @ turn
        return out

    def from_jacobian(self, q: ArrayLike, jacobian: ArrayLike) -> Array:
        """Convert Jacobians of the model to those of the system.

        Parameters
        ----------
        q
            Configurations of the model, with leading axes.
        jacobian
            Jacobians (..., m, nv of the model) at `q`; also (m,) for a model with one velocity, as
            Pinocchio returns it.

        Returns
        -------
        Array
            Jacobians (..., m, nv) of the system.
        """
        J = numbers(jacobian, "jacobian")
        if J.ndim == self.nv == 1:
            J = J[:, None]
        _check_columns(J, self.nv)
        values = self._read_entries(q)
        straight = np.broadcast_to(
            J, (*_merge_leading_shapes(J.shape[:-2], values), *J.shape[-2:])
        ).copy()
        for at, turn in self._list_axis_turns(values):
            straight[..., at] = straight[..., at] @ np.swapaxes(turn, -1, -2)
        return self._in_unit.convert_v(straight[..., self._rate_at] @ self._spread)

    def _list_axis_turns(self, values: Array) -> list[tuple[slice, Array]]:
        """List velocities with other axes in the model, with rotations (..., n, n) to ours."""
        out = [(slice(slides.v, slides.v + 3), X[:3, :3].T) for slides, _, X in self._begins]
        for first, size, k in self._turned:
            turn = (
                spatial.quat_wxyz_to_matrix(values[..., k : k + 4])
                if self._entries[k].kind == BALL
                else spatial.make_rotation(values[..., k], "z")
            )
            out.append((slice(first, first + size), turn[..., :size, :size]))
        return out


def _merge_leading_shapes(lead: tuple[int, ...], values: Array) -> tuple[int, ...]:
    """Merge the leading shape of velocities or Jacobians with that of q."""
    return broadcast_shapes({"v": lead, "q": values.shape[:-1]})


def _check_columns(J: Array, nv: int) -> None:
    """Refuse an array that is no Jacobian with `nv` columns, with an `InputError`."""
    if J.ndim < 2 or J.shape[-1] != nv:
        raise InputError(f"jacobian has shape {J.shape}; it must be (..., m, {nv})")


# ---- one call each


def _convert_to_library(
    library: Library, system: Model, q: Any, model: Any, v: Any, base: Any
) -> Any:
    """Convert a configuration, and a velocity if given, to the numbers of a model."""
    _check_library(library, model)
    both = Correspondence(system, model, partial=base is not None)
    at = both.to_q(q, base)
    return at if v is None else (at, both.to_v(q, v))


def _convert_from_library(
    library: Library, system: Model, q: Any, model: Any, v: Any, base: Any, tolerance: float
) -> Any:
    """Convert a configuration of a model, and a velocity if given, to those of the system."""
    _check_library(library, model)
    both = Correspondence(system, model, tolerance, partial=base is not None)
    at = both.from_q(q, base)
    return at if v is None else (at, both.from_v(q, v))


def _check_library(library: Library, model: Any) -> None:
    """Refuse a model of another library."""
    if _find_library(model) is not library:
        raise InputError(
            f"model is {type(model).__name__}; it must be a {library.model} of {library.name}"
        )


@explain_errors
def to_pinocchio(
    system: Model,
    q: ArrayLike | Mapping[str, ArrayLike],
    model: LibraryModel,
    v: ArrayLike | None = None,
    base: ArrayLike | None = None,
) -> Array | tuple[Array, Array]:
    """Convert configurations of a system to those of a Pinocchio model.

    Parameters
    ----------
    system
        System whose configurations are converted.
    q
        Configurations (..., nq) in radians and metres, or values by coordinate name.
    model
        Model of Pinocchio (pinocchio.Model). Joints are paired by name.
    v
        Velocities (..., nv), which are converted, too (default: none).
    base
        Configuration of the model: joints that only one side has are as there, and at rest
        (default: joints without a counterpart are an error).

    Returns
    -------
    Array or tuple
        Configurations of the model, with `v` a pair of configurations and velocities.

    Raises
    ------
    InputError
        If joints have no counterpart; the message names them.

    See Also
    --------
    Correspondence : many conversions, and Jacobians.

    Notes
    -----
    Quaternions become x, y, z, w, and angles of continuous joints cosine and sine. The linear
    velocity of a free base is along its own axes. Followers have their values where they are joints
    of the model.

    Examples
    --------
    >>> import kempe
    >>> from types import SimpleNamespace
    >>> hinge = {"idx_q": 0, "idx_v": 0, "nq": 2, "nv": 1, "shortname": lambda: "JointModelRUBZ"}
    >>> model = SimpleNamespace(
    ...     nq=2, nv=1, names=["universe", "q1"], joints=[None, SimpleNamespace(**hinge)]
    ... )
    >>> wheel = kempe.Mechanism("wheel")
    >>> joint = wheel.revolute("q1", wheel.ground, wheel.body("disc"))
    >>> kempe.convert.to_pinocchio(wheel.build(), [0.0], model)
    array([1., 0.])
    """
    return _convert_to_library(PINOCCHIO, system, q, model, v, base)


@explain_errors
def from_pinocchio(
    system: Model,
    q: ArrayLike,
    model: LibraryModel,
    v: ArrayLike | None = None,
    base: ArrayLike | Mapping[str, ArrayLike] | None = None,
    tolerance: float = FIT,
) -> Array | tuple[Array, Array]:
    """Convert configurations of a Pinocchio model to those of a system.

    Parameters
    ----------
    system
        System for which they are converted.
    q
        Configurations of the model.
    model
        Model of Pinocchio (pinocchio.Model). Joints are paired by name.
    v
        Velocities of the model, which are converted, too (default: none).
    base
        Configuration of the system: joints that only one side has are as there, and at rest
        (default: joints without a counterpart are an error).
    tolerance
        Largest misfit of followers, locked and fixed joints in radians or metres, relative to 1 and
        the number.

    Returns
    -------
    Array or tuple
        Configurations (..., nq), with `v` a pair of configurations and velocities (..., nv).

    Raises
    ------
    InputError
        If joints have no counterpart, or followers, locked or fixed joints do not fit.

    See Also
    --------
    Correspondence : many conversions, and Jacobians.
    """
    return _convert_from_library(PINOCCHIO, system, q, model, v, base, tolerance)


@explain_errors
def to_mujoco(
    system: Model,
    q: ArrayLike | Mapping[str, ArrayLike],
    model: LibraryModel,
    v: ArrayLike | None = None,
    base: ArrayLike | None = None,
) -> Array | tuple[Array, Array]:
    """Convert configurations of a system to those of a MuJoCo model.

    Parameters
    ----------
    system
        System whose configurations are converted.
    q
        Configurations (..., nq) in radians and metres, or values by coordinate name.
    model
        Model of MuJoCo (mujoco.MjModel). Joints are paired by name.
    v
        Velocities (..., nv), which are converted, too (default: none).
    base
        Configuration of the model: joints that only one side has are as there, and at rest
        (default: joints without a counterpart are an error).

    Returns
    -------
    Array or tuple
        `qpos` of the model, with `v` a pair of `qpos` and `qvel`.

    Raises
    ------
    InputError
        If joints have no counterpart; the message names them.

    See Also
    --------
    Correspondence : many conversions, and Jacobians.

    Notes
    -----
    Several joints of one body in the model are paired with the one joint that moves the body of this
    name in the system.
    """
    return _convert_to_library(MUJOCO, system, q, model, v, base)


@explain_errors
def from_mujoco(
    system: Model,
    q: ArrayLike,
    model: LibraryModel,
    v: ArrayLike | None = None,
    base: ArrayLike | Mapping[str, ArrayLike] | None = None,
    tolerance: float = FIT,
) -> Array | tuple[Array, Array]:
    """Convert configurations of a MuJoCo model to those of a system.

    Parameters
    ----------
    system
        System for which they are converted.
    q
        `qpos` of the model.
    model
        Model of MuJoCo (mujoco.MjModel). Joints are paired by name.
    v
        `qvel` of the model, which are converted, too (default: none).
    base
        Configuration of the system: joints that only one side has are as there, and at rest
        (default: joints without a counterpart are an error).
    tolerance
        Largest misfit of followers, locked and fixed joints in radians or metres, relative to 1 and
        the number. MuJoCo holds followers by springs, which may need a larger tolerance.

    Returns
    -------
    Array or tuple
        Configurations (..., nq), with `v` a pair of configurations and velocities (..., nv).

    Raises
    ------
    InputError
        If joints have no counterpart, or followers, locked or fixed joints do not fit.

    See Also
    --------
    Correspondence : many conversions, and Jacobians.
    """
    return _convert_from_library(MUJOCO, system, q, model, v, base, tolerance)


# ---- messages


@explain_errors
def to_joint_state(
    system: Model,
    q: ArrayLike | Mapping[str, ArrayLike],
    message: Message,
    v: ArrayLike | None = None,
) -> Message:
    """Fill a ROS message JointState with one configuration, and return the message.

    Parameters
    ----------
    system
        System of the configuration.
    q
        Configuration (nq,) in radians and metres, or values by coordinate name.
    message
        Message with the fields `name`, `position` and `velocity`. Names that it has are kept in
        their order; without names it gets all coordinates, followers included.
    v
        Velocity (nv,), which fills `velocity` (default: left as it is).

    Returns
    -------
    JointState
        The message itself.

    Raises
    ------
    UnknownNameError
        If a name of the message is no coordinate.

    Notes
    -----
    Joints with a quaternion have no place in the message; a free base is sent as the pose of its
    body.

    Examples
    --------
    >>> import kempe
    >>> from types import SimpleNamespace
    >>> message = SimpleNamespace(name=["q2", "q1"], position=[], velocity=[])
    >>> arm = kempe.load("two_link")
    >>> kempe.convert.to_joint_state(arm, [0.1, 0.2], message).position
    [0.2, 0.1]
    """
    metres = InMetres(system)
    system = metres.system
    q = metres.read_q(q, read_one_q)
    laws = {name: Follower(name, 1.0, 0.0) for name in system.coordinate_names}
    laws |= system.structure.couplings
    known = [
        n
        for joint in system.structure.joints.values()
        for n in _list_scalar_coordinates(system, joint)
    ]
    names = [str(n) for n in message.name] or known
    for name in names:
        if name not in known:
            raise UnknownNameError("coordinate", name, known, system.name)
    message.name = names
    message.position = _evaluate_followers(system.coordinate_names, q, [laws[n] for n in names])
    if v is not None:
        rates = metres.convert_v(numbers(v, "v", system.nv))
        still = [replace(laws[n], offset=0.0) for n in names]
        message.velocity = _evaluate_followers(system.structure.velocity_names, rates, still)
    return message


def _list_scalar_coordinates(system: Model, joint: Joint) -> list[str]:
    """List the coordinates of a joint; none for joints with a quaternion.

    Their velocities have the same names.
    """
    ours = _split_joint(system, joint)
    return [] if BALL in ours.kinds else [name for _, (name,) in ours.parts]


def _evaluate_followers(names: Sequence[str], x: Array, laws: list[Follower]) -> list[float]:
    """Evaluate linear rules for given values of coordinates by name."""
    value: dict[str | None, float] = dict(zip(names, x.tolist(), strict=True))
    return [law.multiplier * value.get(law.source, 0.0) + law.offset for law in laws]


@explain_errors
def from_joint_state(
    system: Model, message: JointState, base: ArrayLike | None = None, velocity: bool = False
) -> Array | tuple[Array, Array]:
    """Convert a ROS message JointState to a configuration.

    Parameters
    ----------
    system
        System for which it is converted.
    message
        Message with the fields `name`, `position` and, with `velocity`, `velocity`.
    base
        Configuration (nq,) for coordinates that the message does not name (default: neutral).
    velocity
        Whether to convert velocities, too (default: False).

    Returns
    -------
    Array or tuple
        Configuration (nq,), with `velocity` a pair of configuration and velocity (nv,), which is 0
        where the message names nothing.

    Raises
    ------
    UnknownNameError
        If a name of the message is no coordinate.
    InputError
        If followers do not fit; the message has the numbers.

    See Also
    --------
    System.q : takes messages, too.

    Examples
    --------
    >>> import kempe
    >>> from types import SimpleNamespace
    >>> message = SimpleNamespace(name=["q2"], position=[0.2], velocity=[])
    >>> kempe.convert.from_joint_state(kempe.load("two_link"), message)
    array([0. , 0.2])
    """
    given: Any = message
    metres = InMetres(system)
    system = metres.system
    q = metres.write_q(make_q(system, given, None if base is None else metres.read_q(base)))
    if not velocity:
        return q
    names = [str(n) for n in message.name]
    rates = read_reals(list(message.velocity), "velocity of the message")
    if rates.shape != (len(names),):
        raise InputError(
            f"the message has {format_count(len(names), 'name')} and "
            f"{format_count(rates.size, 'velocity')}"
        )
    index = {name: k for k, name in enumerate(system.structure.velocity_names)}
    v = np.zeros(system.nv)
    for name, rate in zip(names, rates, strict=True):
        if name in index:
            v[index[name]] = rate
    for name, rate in zip(names, rates, strict=True):
        law = system.structure.couplings.get(name)
        if law is not None:
            wanted = law.multiplier * v[index[law.source]] if law.source else 0.0
            refuse_other_follower(f"the velocity of {name!r}", law, rate, wanted)
    return q, metres.write_v(v)
