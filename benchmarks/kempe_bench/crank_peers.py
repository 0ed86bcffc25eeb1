"""Planar mechanisms made of dyads, for pylinkage: points placed one after another from the crank's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.spatial import Array
from kempe_bench import peers

if TYPE_CHECKING:
    from kempe.system import System

Spot = tuple[str, str]
"""A point of a mechanism: 'joint' and its name, or 'frame' and its name."""


@dataclass(frozen=True)
class Drive:
    """A mechanism and its crank: the joint that turns, and the angles between which it does."""

    crank: str
    start: float
    end: float


DRIVES = {
    "four_bar": Drive("A", 0.0, 2 * math.pi),
    "peaucellier": Drive("Q", -1.2, 1.2),
    "jansen": Drive("O", 0.0, 2 * math.pi),
}
"""The mechanisms: Peaucellier's crank does not turn fully."""


@dataclass(frozen=True)
class Linkage:
    """pylinkage's model: `reset` puts it where it started, and `spots` tells the points of its
    columns.
    """

    model: Any
    coords: list[tuple[float, float]]
    spots: tuple[Spot, ...]

    def reset(self) -> None:
        """Put all points where they started."""
        self.model.set_coords(self.coords)


class _Points:
    """Components of pylinkage in the making, each at the place where Kempe has it at first."""

    def __init__(self, system: System, q: Array, drive: Drive, step: float):
        dyads = peers.module("pylinkage.dyads")
        self.ground = peers.module("pylinkage.components").Ground
        self.crank = peers.module("pylinkage.actuators").Crank
        self.rrr = dyads.RRRDyad
        self.fixed = dyads.FixedDyad
        self.system = system
        self.q = q
        self.drive = drive
        self.step = step
        self.parts: list[Any] = []
        self.spots: list[Spot] = []

    def _add(self, part: Any, spot: Spot) -> Any:
        self.parts.append(part)
        self.spots.append(spot)
        return part

    def at(self, spot: Spot) -> Array:
        return place(self.system, self.q, spot)

    def fix(self, joint: str) -> Any:
        spot = ("joint", joint)
        return self._add(self.ground(*self.at(spot).tolist(), name=joint), spot)

    def turn(self, anchor: Any, joint: str, radius: float) -> Any:
        rate = {"angular_velocity": self.step, "initial_angle": self.drive.start}
        return self._add(
            self.crank(anchor=anchor, radius=radius, name=joint, **rate), ("joint", joint)
        )

    def meet(self, a: Any, b: Any, distances: tuple[float, float], joint: str) -> Any:
        spot = ("joint", joint)
        x, y = self.at(spot).tolist()
        return self._add(self.rrr(a, b, *distances, x=x, y=y, name=joint), spot)

    def stick(self, a: Any, b: Any, spot: Spot) -> Any:
        base = np.array([b.x - a.x, b.y - a.y])
        way = self.at(spot) - [a.x, a.y]
        angle = math.atan2(base[0] * way[1] - base[1] * way[0], float(base @ way))
        return self._add(self.fixed(a, b, float(np.linalg.norm(way)), angle, name=spot[1]), spot)


def _four_bar(p: _Points, v: dict[str, float]) -> None:
    A = p.fix("A")
    D = p.fix("D")
    p.meet(p.turn(A, "B", v["a"]), D, (v["b"], v["c"]), "C")


def _peaucellier(p: _Points, v: dict[str, float]) -> None:
    origin = p.fix("Oa")
    Q = p.fix("Q")
    C = p.turn(Q, "Ca", v["crank"])
    A, B = (p.meet(origin, C, (v["arm"], v["side"]), name) for name in ("Aa", "Bb"))
    p.meet(A, B, (v["side"], v["side"]), "D")


def _jansen(p: _Points, v: dict[str, float]) -> None:
    axle = p.fix("O")
    K = p.fix("Kb")
    M = p.turn(axle, "Mj", v["m"])
    U = p.meet(M, K, (v["j"], v["b"]), "U")
    V = p.stick(K, U, ("joint", "V"))
    G = p.meet(M, K, (v["k"], v["c"]), "Gk")
    W = p.meet(V, G, (v["f"], v["g"]), "W")
    p.stick(G, W, ("frame", "foot"))


BUILDERS: dict[str, Callable[[_Points, dict[str, float]], None]] = {
    "four_bar": _four_bar,
    "peaucellier": _peaucellier,
    "jansen": _jansen,
}
"""How each mechanism is given to pylinkage."""


def place(system: System, q: Array, spot: Spot) -> Array:
    """Position (..., 2) of a point at configurations q (..., nq): of a joint, on its parent; or of
    a frame.
    """
    kind, name = spot
    if kind == "frame":
        return system.fk(q, name)[..., :2, 3]
    joint = system.structure.joints[name]
    X = joint.X_PF.evaluate_pose(system.structure.parameters)
    parent = system.fk(q)[..., system.body_names.index(joint.parent), :, :]
    return (parent @ X)[..., :2, 3]


def angles(drive: Drive, n: int) -> Array:
    """The crank's angles (n,) after each of n steps."""
    return np.linspace(drive.start, drive.end, n + 1)[1:]


def linkage(system: System, n: int) -> Linkage:
    """The mechanism as a model of pylinkage whose crank takes n steps, compiled."""
    drive = DRIVES[system.name]
    q = system.assemble({drive.crank: drive.start}, start=system.q("closed")).q
    points = _Points(system, q, drive, (drive.end - drive.start) / n)
    BUILDERS[system.name](points, system.structure.parameters)
    model = peers.module("pylinkage.simulation").Linkage(tuple(points.parts))
    coords = [(float(x), float(y)) for x, y in model.get_coords()]
    out = Linkage(model, coords, tuple(points.spots))
    model.step_fast(iterations=2)
    out.reset()
    return out
