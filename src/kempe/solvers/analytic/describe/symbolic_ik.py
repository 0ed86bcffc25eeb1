"""The inverse model of a planar arm or a SCARA as formulas, in the steps in which it is derived on paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained, numbers
from kempe.errors import InputError, UnsupportedError, shown
from kempe.kinematics.formulas.derivation import Derivation, FormulaStep
from kempe.kinematics.formulas.plane_steps import (
    Names,
    Vector,
    endings,
    line_and_circle,
    minus,
    plus,
    polar,
    turned,
    turning_slide,
    two_circles,
    two_lines,
)
from kempe.kinematics.formulas.symbolic import SymbolLeaves
from kempe.kinematics.formulas.symbolic_dh import JointLine, joint_lines
from kempe.kinematics.formulas.symbolic_turns import sympy
from kempe.reals import is_whole
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

TASKS = {2: "position", 3: "pose"}
"""What a chain of so many joints that move in the plane can reach."""
OWN = ("p_x", "p_y", "p_z", "phi", "w_x", "w_y")
"""Names of the target, and of the place of the last joint."""
PLACES = ("first", "second", "third", "fourth")
ELBOW = "-1 is elbow up, +1 elbow down"


@dataclass(frozen=True, eq=False)
class InverseFormulas(Derivation):
    """Formulas of the solutions; the symbol `sign` is -1 for elbow up and +1 for elbow down, as `ik_all` names them.

    Of an arm with a slide it is +1 where that is farther than where both solutions meet; two slides have one solution.
    """

    @property
    def target(self) -> tuple[Any, ...]:
        """Symbols of the wanted position, p_x and p_y, with a slide along z p_z, and of a pose the angle phi."""
        return self.given

    def __call__(self, p: ArrayLike, sign: int = 1) -> Array:
        """The coordinates (..., n), radians and metres, for positions (..., 2) or x, y and angle (..., 3).

        Where a joint slides along z the height comes after x and y: (..., 3) or x, y, z and angle (..., 4). The angle
        is that of the frame's x axis. Poses (..., 4, 4) say all of it. They are nan where the target is out of reach.
        """
        at = numbers(self._of_poses(p), "p", len(self.given))
        if not is_whole(sign) or sign not in (-1, 1):
            raise InputError(f"sign is {shown(sign)}; it must be -1 (elbow up) or 1 (elbow down)")
        return self.evaluate(at, np.full(at.shape[:-1] + (len(self.signs),), float(sign)))

    def _of_poses(self, p: ArrayLike) -> ArrayLike:
        """The numbers that the formulas take of poses (..., 4, 4); what is none, as it is."""
        X = np.asarray(p)
        if X.shape[-2:] != (4, 4) or X.dtype.kind not in "fi" or not np.all(X[..., 3, :] == (0.0, 0.0, 0.0, 1.0)):
            return p
        angle = np.arctan2(X[..., 1, 0], X[..., 0, 0])
        place = X[..., : len(self.given) - ("phi" in str(self.given[-1])), 3]
        return np.concatenate([place, angle[..., None]], axis=-1)[..., : len(self.given)]


@explained
def symbolic_ik(
    system: System, frame: FrameLike, task: str | None = None, *, symbols: Mapping[str, Any] | None = None,
    snap: float = 0.0,
) -> InverseFormulas:  # fmt: skip
    """Formulas of the inverse model of a planar arm: two joints to a "position", three to a "pose" x, y, angle.

    Joints turn about z or -z of the ground, or slide across it. One more may slide along it, at any place, as of a
    SCARA, which then reaches a height, too. Of two turns, the position is squared and summed, which
    leaves the second angle; its sine has two signs, the two elbows; the first is the difference of two angles
    (Siciliano, Sciavicco, Villani, Oriolo 2009, section 2.12.1); slides make lines of circles. A pose fixes where the
    last joint is, from which on it is the same. Limits are not regarded. `ik_all` gives the solutions of other
    chains in numbers. `symbols` and `snap` are those of `symbolic_fk`.

    Errors: those of `kempe.kinematics.formulas.symbolic.symbolic_fk`; `UnsupportedError` for other chains and for
    systems with constraints.

    >>> import kempe
    >>> print(symbolic_ik(kempe.load("two_link"), "e").steps[1].formula)
    (-l1**2 - l2**2 + r2)/(2*l1*l2)
    """
    name = system.structure.frame_name(frame)
    if system.loops.constraints():
        raise UnsupportedError(f"formulas for {name!r} need an open chain; ik_all gives numbers")
    leaves = SymbolLeaves(system, symbols or {}, snap)
    joints, tip = joint_lines(system, name, leaves, f"formulas for {name!r} need two or three joints that move it")
    arm, lifts = [j for j in joints if not _lifts(j)], [j for j in joints if _lifts(j)]
    what = task or TASKS.get(len(arm), "position")
    planar = all(bool(j.along[0] == 0 == j.along[1]) if j.turns else bool(j.along[2] == 0) for j in arm)
    upright = tip[2, 0] == 0 == tip[2, 1]
    if TASKS.get(len(arm)) != what or not planar or len(lifts) > 1 or (what == "pose" and not upright):
        raise UnsupportedError(
            f"formulas for {name!r} need two joints to a position, or three to a pose, that turn about z of the ground "
            "or slide across it, and at most one that slides along it; ik_all gives numbers"
        )
    taken: set[Any] = {sympy.Symbol(j.name) for j in joints} | set(tip.free_symbols)
    taken = taken.union(*(j.point.free_symbols for j in joints))
    words = (*Names._fields, *OWN)
    end = next(e for e in endings() if not any(sympy.Symbol(f"{word}{e}") in taken for word in words))
    x, y, z, phi, *last = (sympy.Symbol(f"{word}{end}") for word in OWN)
    inputs: list[Any] = [x, y, *([z] if lifts else []), *([phi] if what == "pose" else [])]
    n, angle = Names.ending(end), phi - sympy.atan2(tip[1, 0], tip[0, 0]) if what == "pose" else None
    flat = [_PlaneJoint.of(j) for j in arm]
    steps, coordinates = _in_plane(n, flat, (x, y), (tip[0, 3], tip[1, 3]), angle, last)
    found: dict[str, Any] = {j.name: x for j, x in zip(flat, coordinates, strict=True)}
    found |= {j.coordinate: j.along[2] * (z - tip[2, 3]) for j in lifts}  # no other joint changes the height
    for j, place in zip(joints, PLACES, strict=False):
        says = f"the {place} coordinate" + ", from the height" * _lifts(j)
        steps.append(FormulaStep(sympy.Symbol(j.coordinate), found[j.coordinate], says))
    signs = (n.sign,) if any(s.formula.has(n.sign) for s in steps) else ()
    return InverseFormulas(system, tuple(steps), tuple(inputs), signs, tuple(j.coordinate for j in joints))


def _lifts(joint: JointLine) -> bool:
    """Whether a joint slides along z of the ground."""
    return not joint.turns and bool(joint.along[0] == 0 == joint.along[1])


class _PlaneJoint(NamedTuple):
    """A joint at q = 0: a point of its axis, whether it turns, its sense about z or its direction."""

    name: str
    at: Vector
    turns: bool
    sense: int
    along: Vector

    @classmethod
    def of(cls, joint: Any) -> _PlaneJoint:
        """The joint as it lies in the plane."""
        sense = int(joint.along[2]) if joint.turns else 1
        return cls(joint.coordinate, (joint.point[0], joint.point[1]), joint.turns, sense,
                   (joint.along[0], joint.along[1]))  # fmt: skip


def _in_plane(
    n: Names, arm: list[_PlaneJoint], to: Vector, end: Vector, angle: Any, names: list[Any]
) -> tuple[list[FormulaStep], list[Any]]:
    """Steps and coordinates as `_solved`; of a pose from the place of a last joint that turns, called `names`."""
    steps = list[FormulaStep]()
    if angle is not None and arm[-1].turns:
        place = minus(to, turned(minus(end, arm[-1].at), angle))
        if place != to:
            steps = [FormulaStep(s, x, "the target, less the last link") for s, x in zip(names, place, strict=True)]
            to = (steps[0].symbol, steps[1].symbol)
        end = arm[-1].at
    more, found = _solved(n, arm, to, end, angle)
    return steps + more, found


def _solved(
    n: Names, arm: list[_PlaneJoint], to: Vector, end: Vector, angle: Any
) -> tuple[list[FormulaStep], list[Any]]:
    """Steps and coordinates: of joints that bring the point `end` to `to`, the last body turned by `angle`."""
    kinds = "".join("RP"[not j.turns] for j in arm)
    one, two = arm[0], arm[1]
    if any(one.turns and two.turns and set(minus(two.at, one.at)) == {0} for one, two in pairwise(arm)):
        raise UnsupportedError("two turns are about one axis, which leaves a joint to spare; ik_all gives families")
    if kinds in ("RR", "RRR"):
        (l1, at1), (l2, at2) = polar(minus(two.at, one.at)), polar(minus(end, two.at))
        steps, first, bend = two_circles(n, minus(to, one.at), l1, l2, ELBOW, one.sense)
        turns = [first - at1, bend - (at2 - at1)]
        return steps, _turns(arm, turns, angle)
    if kinds in ("RP", "RPR"):
        gap, (_, at) = minus(end, one.at), polar(two.along)
        ahead, aside = _parts(gap, two.along)
        steps, u, rail = turning_slide(n, minus(to, one.at), aside)
        turn = rail - at
        return steps, [one.sense * turn, u - ahead, *([arm[2].sense * (angle - turn)] if kinds == "RPR" else [])]
    if kinds in ("PR", "PRR"):
        length, at = polar(minus(end, two.at))
        steps, u, bar = line_and_circle(n, minus(to, two.at), one.along, length)
        turn = bar - at
        return steps, [u, two.sense * turn, *([arm[2].sense * (angle - turn)] if kinds == "PRR" else [])]
    if kinds == "RRP":  # the orientation is that of the second body
        length, at = polar(minus(two.at, one.at))
        rest = minus(minus(to, one.at), turned(minus(end, two.at), angle))
        steps, u, bar = line_and_circle(n, rest, turned(arm[2].along, angle), length)
        turn = bar - at
        return steps, [one.sense * turn, two.sense * (angle - turn), u]
    if kinds in ("PP", "PPR"):
        steps, u1, u2 = two_lines(n, minus(to, end), one.along, two.along)
        return steps, [u1, u2, *([arm[2].sense * angle] if kinds == "PPR" else [])]
    if kinds == "RPP":
        rest = minus(turned(minus(to, one.at), -angle), minus(end, one.at))
        steps, u2, u3 = two_lines(n, rest, two.along, arm[2].along)
        return steps, [one.sense * angle, u2, u3]
    if kinds == "PRP":
        rest = minus(to, plus(two.at, turned(minus(end, two.at), angle)))
        steps, u1, u3 = two_lines(n, rest, one.along, turned(arm[2].along, angle))
        return steps, [u1, two.sense * angle, u3]
    raise UnsupportedError("formulas need a joint that turns where an angle is wanted; ik_all gives numbers")


def _turns(arm: list[_PlaneJoint], turns: list[Any], angle: Any) -> list[Any]:
    """Coordinates of joints that turn: by these, the last one by what is left of the angle."""
    last = [] if angle is None else [angle - sum(turns)]
    return [j.sense * x for j, x in zip(arm, [*turns, *last], strict=True)]


def _parts(v: Vector, along: Vector) -> tuple[Any, Any]:
    """Parts of a vector along a direction and to the left of it."""
    return v[0] * along[0] + v[1] * along[1], along[0] * v[1] - along[1] * v[0]
