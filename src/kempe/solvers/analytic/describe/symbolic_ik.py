"""The inverse model as formulas, in the steps of its derivation on paper: planar arms, SCARAs, arms
in space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained, numbers
from kempe.errors import InputError, UnsupportedError, shown
from kempe.kinematics.closure_rows import of_system
from kempe.kinematics.formulas.derivation import Derivation, FormulaStep
from kempe.kinematics.formulas.plane_steps import Names, endings
from kempe.kinematics.formulas.symbolic import SymbolLeaves
from kempe.kinematics.formulas.symbolic_dh import JointLine, joint_lines, tidy
from kempe.kinematics.formulas.symbolic_turns import sympy
from kempe.reals import is_whole
from kempe.solvers.analytic.describe import arm_plane
from kempe.solvers.analytic.describe.arm_plane import PLACES, ArmPlane
from kempe.solvers.analytic.describe.parallel_arms import ParallelArm
from kempe.solvers.analytic.describe.plane_arms import PlaneJoint, in_plane
from kempe.solvers.analytic.describe.spatial_arms import SpatialArm
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

TASKS = {2: "position", 3: "pose"}
"""What a chain of so many joints that move in the plane can reach."""
SPATIAL = {3: "position", 6: "pose"}
"""What an arm in space of so many joints can reach."""
OWN = ("p_x", "p_y", "p_z", "phi", "w_x", "w_y", "w_z")
"""Names of the target, and of the place of the last joint, or of the wrist."""
TURNED = tuple(f"r_{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
"""Names of the entries of a target's rotation matrix."""


@dataclass(frozen=True, eq=False)
class InverseFormulas(Derivation):
    """Formulas of the solutions; the symbol `sign` is -1 for elbow up and +1 for elbow down, as
    `ik_all` names them.

    Of an arm with a slide it is +1 where that is farther than where both solutions meet; two slides
    have one solution. An arm in space has up to three: `shoulder`, `elbow` (or its slide) and
    `wrist`, +1 without a flip.
    """

    @property
    def target(self) -> tuple[Any, ...]:
        """Symbols of the wanted position, p_x and p_y, in space p_z, and of a pose phi, or r_11 to
        r_33.
        """
        return self.given

    def __call__(self, p: ArrayLike, sign: Any = 1) -> Array:
        """The coordinates (..., n), radians and metres, for positions (..., 2) or x, y and angle
        (..., 3).

        Where a joint slides along z the height comes after x and y: (..., 3) or x, y, z and angle
        (..., 4). The angle is that of the frame's x axis. Of an arm in space targets are positions
        (..., 3), and `sign` has one -1 or 1 for each of its signs, or is one for all. Poses (...,
        4, 4) say all of it. They are nan where the target is out of reach.
        """
        if len(self.given) > len(TURNED):
            X = numbers(p, "p", 4, 4)
            at = np.concatenate([X[..., :3, 3], X[..., :3, :3].reshape(*X.shape[:-2], 9)], axis=-1)
        else:
            at = numbers(self._of_poses(p), "p", len(self.given))
        several = isinstance(sign, (tuple, list, np.ndarray))
        most = max(len(self.signs), 1)
        signs: list[Any] = list(sign) if several else [sign] * most
        if not all(is_whole(s) and s in (-1, 1) for s in signs):
            elbows = (" (elbow up)", " (elbow down)") if len(self.signs) < 2 else ("", "")
            raise InputError(f"sign is {shown(sign)}; it must be -1{elbows[0]} or 1{elbows[1]}")
        if len(signs) != most:
            raise InputError(
                f"sign is {shown(sign)}; it must be one number, or {len(self.signs)}: "
                f"{', '.join(map(str, self.signs))}"
            )
        signs = signs[: len(self.signs)]
        return self.evaluate(
            at, np.broadcast_to(np.array(signs, dtype=float), at.shape[:-1] + (len(signs),))
        )

    def _of_poses(self, p: ArrayLike) -> ArrayLike:
        """The numbers that the formulas take of poses (..., 4, 4); what is none, as it is."""
        X = np.asarray(p)
        if (
            X.shape[-2:] != (4, 4)
            or X.dtype.kind not in "fi"
            or not np.all(X[..., 3, :] == (0.0, 0.0, 0.0, 1.0))
        ):
            return p
        angle = np.arctan2(X[..., 1, 0], X[..., 0, 0])
        place = X[..., : len(self.given) - ("phi" in str(self.given[-1])), 3]
        return np.concatenate([place, angle[..., None]], axis=-1)[..., : len(self.given)]


@explained
def symbolic_ik(
    system: System,
    frame: FrameLike,
    task: str | None = None,
    *,
    symbols: Mapping[str, Any] | None = None,
    snap: float = 0.0,
) -> InverseFormulas:
    """Formulas of the inverse model: of planar arms, SCARAs, and arms in space with a wrist or
    three parallel axes.

    In the plane two joints reach a "position", three a "pose" x, y, angle: they turn about z or -z
    of the ground, or slide across it. One more may slide along it, at any place, as of a SCARA,
    which then reaches a height, too. Of two turns, the position is squared and summed, which leaves
    the second angle; its sine has two signs, the two elbows; the first is the difference of two
    angles (Siciliano, Sciavicco, Villani, Oriolo 2009, section 2.12.1); slides make lines of
    circles. A pose fixes where the last joint is, from which on it is the same.

    In space three joints reach a "position": the first turns about z or -z, the others turn about
    or slide across one horizontal direction, as of the Puma, of a Stanford arm, or of a cylindrical
    one. Six reach a "pose" if the axes of the last three, turns about directions at right angles,
    meet in a point; or if three joints turn about or slide across that direction, and the axes of
    the last two, turns, meet at right angles, the first of them at right angles to that direction,
    as of the arms of Universal Robots.

    Limits are not regarded. `ik_all` gives the solutions of other chains in numbers. `symbols` and
    `snap` are those of `symbolic_fk`.

    Errors: those of `kempe.kinematics.formulas.symbolic.symbolic_fk`; `UnsupportedError` for other
    chains and for systems with constraints.

    >>> import kempe
    >>> print(symbolic_ik(kempe.load("two_link"), "e").steps[1].formula)
    (-l1**2 - l2**2 + r2)/(2*l1*l2)
    """
    name = system.structure.frame_name(frame)
    if of_system(system):
        raise UnsupportedError(f"formulas for {name!r} need an open chain; ik_all gives numbers")
    leaves = SymbolLeaves(system, symbols or {}, snap)
    joints, tip = joint_lines(
        system, name, leaves, f"formulas for {name!r} need two or three joints that move it"
    )
    taken: set[Any] = {sympy.Symbol(j.name) for j in joints} | set(tip.free_symbols)
    taken = taken.union(*(j.point.free_symbols for j in joints))
    words = (*Names._fields, *OWN, *TURNED, *arm_plane.OWN)
    free = {
        word: next(s for e in endings() if (s := sympy.Symbol(f"{word}{e}")) not in taken)
        for word in words
    }
    if _is_planar(joints, tip, task):
        return _of_plane(system, joints, tip, task, free)
    arm = SpatialArm.of(joints, tip) or ParallelArm.of(joints, tip)
    if arm is None or task not in (None, SPATIAL[len(joints)]):
        raise UnsupportedError(
            f"formulas for {name!r} need two joints to a position, or three to a pose, that turn "
            "about z of the ground or slide across it, and at most one that slides along it; or "
            "in space a first turn about z, and two joints that turn about or slide across one "
            "horizontal direction, to a position, or to a pose with a wrist of three axes at "
            "right angles that meet, or three such joints and two turns about axes at right "
            "angles that meet, the first at right angles to that direction; ik_all gives numbers"
        )
    return _of_space(system, arm, free)


def _is_planar(joints: list[JointLine], tip: Any, task: str | None) -> bool:
    """Whether two or three joints move the frame in a plane across z, and at most one along z."""
    arm = [j for j in joints if not _lifts(j)]
    what = task or TASKS.get(len(arm), "position")
    planar = all(
        bool(j.along[0] == 0 == j.along[1]) if j.turns else bool(j.along[2] == 0) for j in arm
    )
    upright = what != "pose" or tip[2, 0] == 0 == tip[2, 1]
    return TASKS.get(len(arm)) == what and planar and len(joints) <= len(arm) + 1 and bool(upright)


def _of_plane(
    system: System, joints: list[JointLine], tip: Any, task: str | None, names: dict[str, Any]
) -> InverseFormulas:
    """Formulas of a planar arm with at most one slide along z; `names` are the symbols by their
    words.
    """
    arm = [j for j in joints if not _lifts(j)]
    lifts = [j for j in joints if _lifts(j)]
    what = task or TASKS[len(arm)]
    x, y, z, phi, *last = (names[word] for word in OWN[:-1])
    inputs: list[Any] = [x, y, *([z] if lifts else []), *([phi] if what == "pose" else [])]
    n = Names.among(names)
    angle = phi - sympy.atan2(tip[1, 0], tip[0, 0]) if what == "pose" else None
    flat = [PlaneJoint.of(j) for j in arm]
    steps, coordinates = in_plane(n, flat, (x, y), (tip[0, 3], tip[1, 3]), angle, last)
    found: dict[str, Any] = {j.name: x for j, x in zip(flat, coordinates, strict=True)}
    found |= {
        j.coordinate: j.along[2] * (z - tip[2, 3]) for j in lifts
    }  # no other joint changes the height
    for j, place in zip(joints, PLACES, strict=False):
        says = f"the {place} coordinate" + ", from the height" * _lifts(j)
        steps.append(FormulaStep(sympy.Symbol(j.coordinate), found[j.coordinate], says))
    return _formulas(system, steps, inputs, [n.sign], joints)


def _of_space(system: System, arm: ArmPlane, names: dict[str, Any]) -> InverseFormulas:
    """Formulas of an arm in space; `names` are the symbols by their words."""
    x, y, z, _, *place = (names[word] for word in OWN)
    inputs = [x, y, z]
    to = [x, y, z]
    steps = list[FormulaStep]()
    R = None
    if len(arm.joints) > 3:
        R = sympy.Matrix(3, 3, [names[word] for word in TURNED])
        inputs += list(R)
        hand = tidy(arm.tip[:3, :3].T * (arm.end - arm.tip[:3, 3]))
        if not hand.is_zero_matrix:
            steps = [
                FormulaStep(s, w, "the wrist: the target, less the hand")
                for s, w in zip(place, sympy.Matrix(to) + R * hand, strict=True)
            ]
            to = place
    steps += arm.steps(to, R, names, Names.among(names)._replace(sign=names["elbow"]))
    return _formulas(
        system,
        steps,
        inputs,
        [names[word] for word in ("shoulder", "elbow", "wrist")],
        list(arm.joints),
    )


def _formulas(
    system: System,
    steps: list[FormulaStep],
    inputs: list[Any],
    signs: list[Any],
    joints: list[JointLine],
) -> InverseFormulas:
    """The formulas, with those of the signs that they have."""
    signs = [sign for sign in signs if any(s.formula.has(sign) for s in steps)]
    return InverseFormulas(
        system, tuple(steps), tuple(inputs), tuple(signs), tuple(j.coordinate for j in joints)
    )


def _lifts(joint: JointLine) -> bool:
    """Whether a joint slides along z of the ground."""
    return not joint.turns and bool(joint.along[0] == 0 == joint.along[1])
