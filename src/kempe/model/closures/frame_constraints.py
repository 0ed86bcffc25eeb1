"""Ties: what holds one frame in another, or coordinates; `loop_plan` packs them for the kernels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from kempe.constraints.builder import substituted
from kempe.constraints.tape import POSE, Tape
from kempe.description.parts import Joint
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.forward.table_layout import NV
from kempe.model.tree.coordinates import Relation

TURN_NAMES = {
    L.NO_TURN: (),
    L.ANGLE: ("rz",),
    L.ALIGN: ("rx", "ry"),
    L.CROSS: ("x.y",),
    L.FULL: ("rx", "ry", "rz"),
    L.LOOK: ("rx", "ry"),
}
ONE_ROW = {L.DISTANCE: "distance", L.LINEAR: "relation"}


class CompiledFunction(Protocol):
    """A function of q in compiled form: `address` of void(double* q, double* value, double*
    columns, int64 flag).

    It writes its `rows` values at q, and with the flag the columns (n, rows) of its Jacobian in
    scaled velocities.
    """

    rows: int
    address: int
    scale: np.ndarray
    """Units (nv,) of the velocities: radians, or the length that equations are measured in."""
    support: tuple[int, ...]
    """The velocities that it depends on: its columns."""
    error: BaseException | None
    """What it raised."""


@dataclass(frozen=True, eq=False)
class Centre:
    """A centre of masses whose sum is 1: for each row of the table (n, 4) mass and first moment in
    its axes.

    `rest` (3,) is the first moment of what stands on the ground.
    """

    rows: np.ndarray
    rest: np.ndarray


@dataclass(frozen=True, eq=False)
class RecordedRows:
    """Rows that are outputs of a recorded expression: of the pose of B in A (where `posed`), else
    of coordinates.

    Inputs that start with no other meaning are coordinates by name.
    """

    tape: Tape
    names: tuple[str, ...]
    unit: str
    posed: bool
    given: tuple[str, ...] = ()
    """Inputs that are numbers of the call."""

    def input(self, name: str) -> int:
        """Number of the input `name`, as `loop_layout` encodes it."""
        if name in self.given:
            return L.GIVEN
        return L.PLACE + POSE.index(name) if self.posed and name in POSE else L.COORDINATE

    @property
    def moved(self) -> bool:
        """Whether the expression depends on the pose of B in A."""
        return any(self.input(n) < L.COORDINATE for n in self.tape.inputs)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates that the expression depends on."""
        return tuple(n for n in self.tape.inputs if self.input(n) == L.COORDINATE)

    def over(self, sources: Mapping[str, tuple[str | None, float, float]]) -> RecordedRows:
        """The expression with coupled coordinates replaced by their sources: (source, multiplier,
        offset) by name.
        """
        return replace(
            self,
            tape=substituted(self.tape, {n: sources[n] for n in self.coordinates if n in sources}),
        )


@dataclass(frozen=True, eq=False)
class Tie:
    """Equations that hold a frame B in a frame A: name, both ends (row, placement, particle), and
    what they hold.
    """

    name: str
    a: tuple[int, np.ndarray, bool]
    b: tuple[int, np.ndarray, bool]
    mask: int = 0
    turns: int = L.NO_TURN
    number: float = 0.0
    relation: Relation | None = None
    pin: bool = False
    joint: Joint | None = None
    """The joint whose coordinates are read off where B is in A."""
    given: bool = False
    """Whether its number, or its four of a quaternion, come with the call."""
    bounds: tuple[tuple[float, float], ...] = ()
    """For each row, in metres or radians, between what it is held; without them at zero."""
    centre: Centre | None = None
    """In place of frame B."""
    own: int = -1
    """The velocity coordinate that an OWN tie holds, the first of a `ball`."""
    ball: bool = False
    function: CompiledFunction | None = None
    tape: RecordedRows | None = None

    @property
    def written(self) -> bool:
        """Whether its equations are an expression or a function."""
        return self.tape is not None or self.function is not None

    @property
    def plain(self) -> bool:
        """Whether its equations are plain numbers, neither metres nor radians of a pose."""
        return (
            self.relation is not None
            or self.function is not None
            or (self.tape is not None and self.tape.unit not in ("m", "rad"))
        )

    @property
    def rows(self) -> list[str]:
        """Names of its equations."""
        if self.turns in ONE_ROW:
            return [ONE_ROW[self.turns]]
        if self.tape is not None:
            return list(self.tape.names)
        if self.function is not None:
            return [str(i) for i in range(self.function.rows)]
        if self.turns == L.OWN:
            return ["rx", "ry", "rz"] if self.ball else ["value"]
        return [x for i, x in enumerate("xyz") if self.mask >> i & 1] + list(TURN_NAMES[self.turns])


@dataclass(frozen=True, eq=False)
class PackedLoops:
    """The loop closures and constraints ("ties") of a system as arrays for the kernels.

    A tie is a set of equations that hold a frame B in a frame A. `ints` and `floats` are the table
    of primitives; the other arrays are as in `loop_layout`.
    """

    ties: tuple[Tie, ...]
    names: tuple[tuple[str, str], ...]
    """For each equation the name of its tie and what it is of it."""
    ints: np.ndarray
    floats: np.ndarray
    plan: np.ndarray
    weights: np.ndarray
    unknown: np.ndarray
    """Velocity coordinates (k,) that are solved for."""
    length: float
    origin: np.ndarray
    """Where (3,) the origin of the table is in the ground: pins are placed from there."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        """What was pickled: functions have other addresses in this process."""
        vars(self).update(state)
        for k, tie in enumerate(self.ties):
            if tie.function is not None:
                place = int(self.plan[L.AT_TIES]) + L.TIE_INTS * k + L.DATA
                self.plan[place] = tie.function.address

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each equation: "m", "rad", or that of an expression."""
        return tuple(
            "m" if i < n else "rad" if t.tape is None else t.tape.unit
            for t, n in zip(self.ties, self.lengths, strict=True)
            for i in range(len(t.rows))
        )

    @property
    def bounds(self) -> np.ndarray:
        """Low and high ends (2, m) of the equations, as scaled there; zero where they hold exactly."""
        ends = np.zeros((len(self.names), 2))
        first = int(self.plan[L.AT_BOUNDS])
        at = 0
        for k, tie in enumerate(self.ties):
            n = len(tie.rows)
            if tie.bounds:
                place = first + int(self.plan[self.plan[L.AT_TIES] + L.TIE_INTS * k + L.BOUND])
                ends[at : at + n] = self.weights[place : place + 2 * n].reshape(n, 2)
            at += n
        return ends.T

    @property
    def read_coordinates(self) -> list[list[int]]:
        """For each tie the unknown velocity coordinates that its equations depend on."""
        unknown = set(self.unknown.tolist())
        out = list[list[int]]()
        for tie in self.plan[self.plan[L.AT_TIES] :][: L.TIE_INTS * len(self.ties)].reshape(
            -1, L.TIE_INTS
        ):
            at = int(self.plan[L.AT_LOCALS] + tie[L.LOCAL])
            out.append([v for v in self.plan[at : at + tie[L.LOCALS]].tolist() if v in unknown])
        return out

    @property
    def lengths(self) -> list[int]:
        """How many of the first equations of each tie are lengths."""
        at = int(self.plan[L.AT_TIES]) + L.LENGTHS
        return self.plan[at : at + L.TIE_INTS * len(self.ties) : L.TIE_INTS].tolist()

    @property
    def scale(self) -> np.ndarray:
        """Unit (nv,) of each velocity coordinate in the kernels, in radians or metres; a view."""
        return L.velocity_lists(self.weights, int(self.ints[NV]))[0]

    @cached_property
    def functions(self) -> tuple[CompiledFunction, ...]:
        """The user's functions among the constraints, compiled."""
        return tuple(t.function for t in self.ties if t.function is not None)

    def check(self) -> None:
        """Raise the error that a user's function raised while a kernel called it, if any."""
        for f in self.functions:
            if f.error is not None:
                error = f.error
                f.error = None
                raise error

    def columns(self, k: int) -> list[int]:
        """Indices of the velocity coordinates that the equations of tie k (a loop closure or
        constraint) depend on.
        """
        tie = self.plan[self.plan[L.AT_TIES] + L.TIE_INTS * k :]
        at = int(self.plan[L.AT_LOCALS] + tie[L.LOCAL])
        return self.plan[at : at + int(tie[L.LOCALS])].tolist()
