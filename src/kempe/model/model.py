"""Compiled models: structure (tree, coordinates, primitive table, limits) and identity.

Results that follow from a model alone are kept with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from kempe.arguments import check_name
from kempe.budget import check_for_stop
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Body, Frame, Joint, ReadOnlyDict
from kempe.errors import DescriptionError, Fault, InputError, UnknownNameError, format_value
from kempe.model.coordinates import (
    Coordinates,
    Layout,
    Relation,
    list_coordinate_names,
    make_coordinates,
)
from kempe.model.primitive_table import Table, make_primitive_table
from kempe.model.topology import Topology, find_spanning_tree
from kempe.spatial import Array
from kempe.words import format_count

# ---- results kept with a system

# What follows from a system, and a few keys, alone is worked out once and kept with the system.

MOST = 256
"""Answers of one function that are kept with a system; the oldest go first."""

Keys = ParamSpec("Keys")
T = TypeVar("T")


def keep_answers(
    function: Callable[Concatenate[SystemType, Keys], T],
) -> Callable[Concatenate[SystemType, Keys], T]:
    """Decorate a function of a system and keys so that its answers are kept with the system.

    Before an answer is worked out, the clock is looked at: of large systems it may take long.
    """

    @wraps(function)
    def find_answer(system: SystemType, *keys: Any) -> T:
        """Return the kept answer for these keys, computed in the first call."""
        answers = system._kept.get(function)
        if answers is None:
            answers = system._kept[function] = {}
        found = answers.get(keys, answers)  # it never holds itself
        if found is not answers:
            return found
        check_for_stop()
        return store_answer(answers, keys, function(system, *keys))  # type: ignore[call-arg]

    return find_answer  # type: ignore[return-value]


def store_answer(answers: dict[Any, Any], key: Any, answer: T, most: int = MOST) -> T:
    """Keep an answer under `key` in a store of at most `most` answers, and return it.

    A full store loses its oldest answer.
    """
    while len(answers) >= most:
        answers.pop(next(iter(list(answers)), None), None)
    answers[key] = answer
    return answer


def bind_call(system: Model, verb: str, key: Any, make: Callable[[], Any]) -> Any:
    """Return the prepared call of a verb for `key`, made by the first request.

    A prepared call answers plain calls with all names looked up and all arrays packed, and returns
    None for what needs the general solver. `System` finds it in ``_kept[verb]`` itself: a call of
    this function, or the import of the verb, would take as long as `fk`.
    """
    calls = system._kept[verb]
    if key not in calls:
        calls[key] = make()
    return calls[key]


# ---- the compiled model

FrameLike = Body | Frame | str


@dataclass(frozen=True, eq=False, repr=False)
class Structure:
    """Structure of a system: its description, spanning tree, coordinates and primitive table.

    It is read-only. The names and sizes that every computation needs are attributes of the `System`
    itself.
    """

    _mechanism: Mechanism
    topology: Topology
    """The spanning tree."""
    coordinates: Coordinates
    """The coordinates with limits, followers and relations."""
    table: Table
    """The primitive table that the kernels walk."""
    layout: Layout
    """Where quaternions sit in `q`."""

    # ---- what the description says

    @property
    def joints(self) -> dict[str, Joint]:
        """All joints, including fixed joints and loop closures, in the order of the description."""
        return ReadOnlyDict(self._mechanism.joints)

    @property
    def frames(self) -> dict[str, Frame]:
        """The named frames of the description, by name."""
        return ReadOnlyDict(self._mechanism.frames)

    @property
    def parameters(self) -> dict[str, float]:
        """Named parameters and their values."""
        return ReadOnlyDict(self._mechanism.parameters)

    @property
    def posture_names(self) -> tuple[str, ...]:
        """Names of the postures, which `System.q` takes."""
        return tuple(self._mechanism.postures)

    @property
    def tolerance(self) -> float | str | None:
        """Tolerance of the dimensions in metres and radians; None where loops close up to rounding."""
        return self._mechanism.tolerance

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks of the reader of a file, such as on parts that were left out."""
        return tuple(self._mechanism.notes)

    # ---- the tree

    @property
    def parent_joints(self) -> tuple[str, ...]:
        """For each body from 1 on, the joint that connects it to its parent."""
        return self.topology.parent_joints

    @property
    def closures(self) -> tuple[str, ...]:
        """Joints that the spanning tree left out: each closes a loop."""
        return self.topology.closures

    # ---- coordinates

    @property
    def velocity_names(self) -> tuple[str, ...]:
        """Names of the nv velocity coordinates.

        They are as in `System.coordinate_names`, but 'joint.wx', ... for quaternions.
        """
        return self.coordinates.velocity_names

    @property
    def relations(self) -> tuple[Relation, ...]:
        """Linear relations between several coordinates, which are equations on `q`."""
        return self.coordinates.relations

    @property
    def couplings(self) -> dict[str, Any]:
        """Coupled coordinates by name, not in `q`: a multiple of a coordinate plus an offset."""
        return ReadOnlyDict(self.coordinates.followers)

    @property
    def limits(self) -> Array:
        """Lower and upper limits (nv, 2) of the velocity coordinates [rad, m].

        The array is read-only; see `System.with_limits`.
        """
        return self.coordinates.limits

    @property
    def velocity_limits(self) -> Array:
        """Largest speeds (nv,) of the velocity coordinates [rad/s, m/s], inf without a limit.

        The array is read-only, as `limits`.
        """
        return self.coordinates.velocity

    def coordinates_of_joint(self, name: str) -> list[str]:
        """Return the names of all coordinates of a joint, including coupled and locked ones.

        Parameters
        ----------
        name
            Name of the joint.

        Returns
        -------
        list of str
            The name of the joint if it has one coordinate, else 'joint.x', 'joint.y', ...

        Raises
        ------
        UnknownNameError
            For names of no joint, with the nearest names.

        Examples
        --------
        >>> import kempe
        >>> kempe.load("car").structure.coordinates_of_joint("drive")
        ['drive.x', 'drive.y', 'drive.rz']
        """
        m = self._mechanism
        return list_coordinate_names(m, m.joints[check_name("joint", name, m.joints, m.name)])

    def frame_name(self, frame: FrameLike) -> str:
        """Return the name of a frame or body, checked.

        Parameters
        ----------
        frame
            Name of a body or frame, or the object that describes it.

        Returns
        -------
        str
            The name.

        Raises
        ------
        UnknownNameError
            For names of no body and no frame, with the nearest names.
        """
        name = frame if isinstance(frame, str) else getattr(frame, "name", frame)
        if not isinstance(name, str) or name not in self.table.at:
            names = (*self.topology.bodies, *self._mechanism.frames)
            raise UnknownNameError("frame", name, names, self._mechanism.name)
        return name

    # ---- identity

    @cached_property
    def content_hash(self) -> str:
        """Digest of all content of the system, as text: equal systems have equal digests.

        It is the same in every process.
        """
        return _compute_digest(self._mechanism.content())

    @cached_property
    def hash(self) -> str:
        """Digest of bodies, joints and tree without numbers, as text.

        It is equal for all designs of one structure.
        """
        m = self._mechanism
        joints = [(j.name, j.type.type_name, j.parent, j.child) for j in m.joints.values()]
        constraints = [(c.name, c.kind, c.parent, c.child) for c in m.constraints.values()]
        return _compute_digest(
            (m.dim, self.topology, joints, constraints, self.coordinates.names, tuple(m.frames))
        )

    def __repr__(self) -> str:
        counts = (
            f"{format_count(len(self.topology.parent), 'body')}, "
            f"{format_count(len(self._mechanism.joints), 'joint')}"
        )
        cut = f", loops closed by {', '.join(map(repr, self.closures))}" if self.closures else ""
        tied = f", {format_count(len(self.relations), 'relation')}" if self.relations else ""
        return f"Structure of {self._mechanism.name!r}: {counts}{cut}{tied}"


class Model:
    """A compiled mechanism: spanning tree, loop closures, coordinates, primitive table.

    It is frozen, and the base of `System`.
    """

    _mechanism: Mechanism
    _topology: Topology
    _coordinates: Coordinates
    _table: Table
    _ideal: Any = None
    """What this system is the nearest one of, an `Idealised`; None where it is the given one."""
    _kept: dict[Any, dict[Any, Any]]
    """Answers of functions with `kempe.model.model.keep_answers`, by function, and prepared calls
    of `kempe.model.model.bind_call`, by verb."""

    def __init__(
        self, mechanism: Mechanism, topology: Topology | None = None, table: Table | None = None
    ):
        if not hasattr(mechanism, "parameters"):
            raise InputError(
                f"mechanism is {format_value(mechanism)}; it must be a Mechanism; kempe.load reads "
                "a file or a shipped model"
            )
        own = vars(self)  # attributes cannot be set: the system is frozen
        own["_mechanism"] = mechanism = mechanism.copy()
        own["_topology"] = find_spanning_tree(mechanism) if topology is None else topology
        own["_coordinates"] = make_coordinates(mechanism)
        own["_table"] = (
            make_primitive_table(mechanism, self._topology, self._coordinates, mechanism.parameters)
            if table is None
            else table
        )
        own["_kept"] = {verb: {} for verb in ("fk", "ik", "ik_all", "ik_step")}
        self._check_placements()

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{self!r} is frozen: change its mechanism and build another")

    def _check_placements(self) -> None:
        """Refuse placements of bodies and frames that are not finite numbers."""
        problem = "placement is not a number with these parameters"
        for name, (_, X, _p) in self._table.at.items():
            if not np.isfinite(X).all():
                raise DescriptionError(Fault(f"its {problem}", f"frame {name!r}"))
        if not np.isfinite(self._table.placement).all():
            raise DescriptionError(Fault(f"a {problem}", f"system {self.name!r}"))
        known = {*self.coordinate_names, *self._coordinates.followers}
        for name, posture in self._mechanism.postures.items():
            for key in posture:
                if key not in known:
                    unknown = UnknownNameError("coordinate", key, self.coordinate_names, self.name)
                    raise DescriptionError(Fault(str(unknown), f"posture {name!r}"))

    # ---- what it is

    @property
    def name(self) -> str:
        """Name of the system."""
        return self._mechanism.name

    @property
    def dim(self) -> int:
        """2 for a planar system, 3 for one in space."""
        return self._mechanism.dim

    @property
    def unit(self) -> str:
        """Unit of lengths: "m", or what the mechanism declares, such as "mm"."""
        return self._mechanism.unit

    @property
    def mechanism(self) -> Mechanism:
        """A copy of the description, which can be changed and built again."""
        return self._mechanism.copy()

    @cached_property
    def structure(self) -> Structure:
        """Parts of the system: joints, frames, closures, couplings, limits, parameters, tree."""
        m = self._mechanism
        coordinates = self._coordinates
        return Structure(m, self._topology, coordinates, self._table, coordinates.layout)

    @property
    def kind(self) -> str:
        """Kind of the system: 'serial chain', 'tree', '1 loop', '2 loops', ...

        A constraint that ties two bodies closes a loop, too.
        """
        ties = sum(c.links for c in self._mechanism.constraints.values())
        loops = len(self._topology.closures) + ties
        parent = self._topology.parent
        if loops:
            return f"{loops} loop{'s' * (loops > 1)}"
        return "serial chain" if len(set(parent)) == len(parent) else "tree"

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies in the order of their numbers; the ground is number 0."""
        return self._topology.bodies

    @cached_property
    def frame_names(self) -> tuple[str, ...]:
        """Names that `fk` takes: all bodies, then the named frames."""
        return (*self._topology.bodies, *self._mechanism.frames)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints, including fixed joints and loop closures.

        The order is the order of the description.
        """
        return tuple(self._mechanism.joints)

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of the entries of `q`: the joint's name if it has one coordinate, else 'joint.x'."""
        return self._coordinates.names

    @property
    def parent(self) -> tuple[int, ...]:
        """The connectivity vector C: `parent[i - 1]` is the number of the parent of body i."""
        return self._topology.parent

    @property
    def nq(self) -> int:
        """Number of entries of a configuration `q`."""
        return self._coordinates.layout.nq

    @property
    def nv(self) -> int:
        """Number of velocity coordinates: the freedoms of all joints in the tree.

        A quaternion has 3 of them, and 4 in `nq`.
        """
        return self._coordinates.layout.nv

    # ---- limits

    @property
    def lower(self) -> Array:
        """Lower limits (nv,) of the velocity coordinates [rad, m], -inf without a limit.

        The array is read-only: see `with_limits`.
        """
        return self._coordinates.lower

    @property
    def upper(self) -> Array:
        """Upper limits (nv,) of the velocity coordinates [rad, m], inf without a limit.

        The array is read-only: see `with_limits`.
        """
        return self._coordinates.upper

    @property
    def neutral(self) -> Array:
        """Neutral configuration (nq,): zero angles and lengths, identity quaternions.

        It may be outside the limits, and is read-only.
        """
        return self._coordinates.layout.neutral

    # ---- identity

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and (
            self is other or self.structure.content_hash == other.structure.content_hash
        )

    def __hash__(self) -> int:
        return hash(self.structure.content_hash)

    def __reduce__(self):
        return (
            type(self),
            (self._mechanism,),
            None if self._ideal is None else {"_ideal": self._ideal},
        )

    def __repr__(self) -> str:
        loops = f", loops={len(self._topology.closures)}" if self._topology.closures else ""
        more = loops + (", planar" if self.dim == 2 else "")
        counts = f"bodies={len(self.parent)}, joints={len(self.joint_names)}, nq={self.nq}"
        return f"System({self.name!r}, {counts}{more})"


SystemType = TypeVar("SystemType", bound=Model)
"""The class of a system, for functions that make another one of the same class."""


def _compute_digest(content: object) -> str:
    """Compute the digest of the text that a tuple prints as."""
    from hashlib import sha256

    return sha256(repr(content).encode()).hexdigest()
