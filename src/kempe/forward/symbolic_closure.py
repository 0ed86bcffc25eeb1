"""Loop-closure equations f(q) = 0 in symbols, of cut joints and declared constraints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import explain_errors
from kempe.constraints.base import Op, evaluate_number_fields, find_value_field, list_position_rows
from kempe.description.parts import Declared, Joint
from kempe.errors import UnsupportedError
from kempe.forward.symbolic import (
    SymbolicStep,
    SymbolLeaves,
    align_formulas,
    format_latex,
    invert_steps,
    iterate_joint_motions,
    iterate_placement_steps,
    list_steps_by_body,
    multiply_steps,
    sympy,
)
from kempe.model.implicit_form import ImplicitForm, find_implicit_form, has_slide_along_z
from kempe.model.packed_loops import find_explicit_joints
from kempe.poses import make_placement_from_pose

if TYPE_CHECKING:
    from kempe.model.model import Model

Steps = list[SymbolicStep]


@dataclass(frozen=True, eq=False)
class SymbolicClosure:
    """The loop-closure equations f(q) = 0 of a system in symbols, by name.

    Names are those of cut joints, constraints and relations.

    Each is a sympy Matrix (m, 1) that is zero where it holds.
    """

    equations: dict[str, Any]

    @property
    def matrix(self) -> Any:
        """All equations, one below the other, as a sympy Matrix (m, 1)."""
        return sympy.Matrix([f for own in self.equations.values() for f in own])

    def __getitem__(self, name: str) -> Any:
        return self.equations[name]

    def latex(self) -> str:
        """Return the equations in LaTeX, one line each."""
        return align_formulas(f"{format_latex(f)} &= 0" for f in self.matrix)

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def __str__(self) -> str:
        return "\n".join(f"{name}: {f} = 0" for name, own in self.equations.items() for f in own)


@explain_errors
def derive_closure(
    system: Model, *, symbols: Mapping[str, Any] | None = None, snap: float = 0.0
) -> SymbolicClosure:
    """Derive the equations f(q) = 0 of closed configurations, in coordinates and parameters.

    A joint that the tree left out holds places and directions of its frame M in its frame F; where
    the coordinates of this joint are not needed for that they do not occur. Places are in metres,
    in axes of the ground where all of them are held, else in those of F; turns are sines of angles,
    so that they are zero half a turn off, too. A rod gives the difference of the squares of two
    lengths. `symbols` and `snap` are those of `kempe.forward.symbolic.derive_fk`;
    besides its errors, `UnsupportedError` for constraints of other kinds.

    >>> import kempe
    >>> derive_closure(kempe.load("four_bar"))["C"][0]
    a*cos(A) + b*cos(A + B) - c*cos(D) - d
    """
    leaves = SymbolLeaves(system, symbols or {}, snap)
    m = system.mechanism
    explicit = find_explicit_joints(system)
    out = dict[str, Any]()
    for name in system.structure.closures:
        out[name] = _derive_joint_equations(system, m.joints[name], name in explicit, leaves)
    for constraint in m.constraints.values():
        if list_position_rows(constraint.of, system.dim):
            out[constraint.name] = _derive_constraint_equations(system, constraint, leaves)
    for r in system.structure.relations:
        sources = sum(
            leaves.express_value(k) * leaves.express_coordinate(s) for s, k in r.sources.items()
        )
        out[r.of] = sympy.Matrix(
            [leaves.express_coordinate(r.of) - sources - leaves.express_value(r.offset)]
        )
    return SymbolicClosure(out)


def _list_body_steps(system: Model, body: str, leaves: SymbolLeaves) -> Steps:
    """List the motions from the ground to a body."""
    return [step for _, steps in list_steps_by_body(system, body, leaves) for step in steps]


def _derive_joint_equations(
    system: Model, joint: Joint, explicit: bool, leaves: SymbolLeaves
) -> Any:
    """Derive the equations of a cut joint."""
    m = system.mechanism
    dim = system.dim
    subject = f"joint {joint.name!r}"
    particle = m.bodies[joint.child].particle
    form = None if explicit else find_implicit_form(joint.type, dim, particle)
    F = [
        *_list_body_steps(system, joint.parent, leaves),
        *iterate_placement_steps(joint.X_PF, subject, leaves),
    ]
    M = [
        *_list_body_steps(system, joint.child, leaves),
        *iterate_placement_steps(joint.X_CM, subject, leaves),
    ]
    if form is None:  # F is led on by the joint's own motion, and all of M is held there
        F += iterate_joint_motions(system, joint, False, leaves)
        form = ImplicitForm("xyz"[:dim], "" if particle else "z" if dim == 2 else "xyz", ())
    X_F = multiply_steps(F, leaves)
    X_M = multiply_steps(M, leaves)
    gap = X_F[:3, 3] - X_M[:3, 3]
    R = X_F[:3, :3]
    if len(form.position) == dim:
        places = list(gap[:dim, :])
    elif has_slide_along_z(joint.type, dim, particle):
        places = [-R[1, 2] * gap[0] + R[0, 2] * gap[1]]
    else:
        places = [R[:, "xyz".index(axis)].dot(gap) for axis in form.position]
    return sympy.Matrix(
        [sympy.expand(f) for f in [*places, *_derive_turn_equations(form.turns, F, M, leaves)]]
    )


def _derive_turn_equations(held_turns: str, F: Steps, M: Steps, leaves: SymbolLeaves) -> list[Any]:
    """Derive the equations that keep M from turning against F except as the joint allows.

    Parallel turns on both ways are merged.
    """
    if held_turns == "z":
        return [multiply_steps([*M, *invert_steps(F)], leaves)[1, 0]]
    R = multiply_steps([*invert_steps(F), *M], leaves)[:3, :3] if held_turns else sympy.eye(3)
    if held_turns == "xyz":
        return [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    return {"": [], "xy": [R[0, 2], R[1, 2]], "x.y": [R[0, 1]]}[held_turns]


def _derive_constraint_equations(system: Model, constraint: Declared, leaves: SymbolLeaves) -> Any:
    """Derive the equations of a declared constraint."""
    dim = system.dim
    of = constraint.of
    subject = f"constraint {constraint.name!r}"
    rows = list_position_rows(of, dim)
    other = [r for r in rows if r.op not in (Op.POINT, Op.DISTANCE)]
    if other or not constraint.parent:
        raise UnsupportedError(
            f"constraint {constraint.name!r} is of kind {of.kind}; formulas are known of distances "
            "and of points on lines and planes; loops.constraints() has numbers"
        )
    made = evaluate_number_fields(of, system.structure.parameters)
    ends: list[Any] = []
    goal = made.make_goal_poses(dim)
    tool = np.reshape(made.make_tool_pose(dim), (4, 4))
    for body, X, more in (
        (constraint.parent, constraint.X_PF, goal),
        (constraint.child, constraint.X_CM, tool),
    ):
        steps = [
            *_list_body_steps(system, body, leaves),
            *iterate_placement_steps(X @ make_placement_from_pose(more), subject, leaves),
        ]
        ends.append(multiply_steps(steps, leaves))
    gap = ends[1][:3, 3] - ends[0][:3, 3]
    out: list[Any] = []
    for row in rows:
        name = find_value_field(of, row)
        value: Any = getattr(of, name) if name else 0.0
        value = leaves.express_value(value if row.part is None else value[row.part])
        out.append(
            gap.dot(gap) - value**2
            if row.op is Op.DISTANCE
            else ends[0][:3, int(row.args[0])].dot(gap) - value
        )
    return sympy.Matrix([sympy.expand(f) for f in out])
