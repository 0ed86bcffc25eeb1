"""Families of functions of a system, each under one name: `System.loops`, `System.inverse`,
`System.reach`, ...
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from kempe.arguments import explain_errors
from kempe.equations.closure_rows import list_constraints
from kempe.model.model import FrameLike
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.assemble.bound import Assembler
    from kempe.assemble.dyads import Incomplete, Plan
    from kempe.budget import Budget
    from kempe.equations.closure_rows import SystemConstraint
    from kempe.forward.symbolic_closure import SymbolicClosure
    from kempe.forward.symbolic_dh import DHTable
    from kempe.forward.symbolic_steps import ShortForm, SymbolicSteps
    from kempe.inverse.describe import Recognised
    from kempe.inverse.formulas import InverseFormulas
    from kempe.inverse.self_motion import SelfMotion
    from kempe.inverse.sweep import Sweep
    from kempe.mobility.relative_motion import RelativeMotion
    from kempe.model.model import Model
    from kempe.motion.transmission import LoopJacobian
    from kempe.workspace.base_placement import BasePlacement
    from kempe.workspace.capability import CapabilityMap
    from kempe.workspace.planar.planar_workspace import PlanarWorkspace
    from kempe.workspace.reach import ReachStudy


@dataclass(frozen=True, repr=False)
class Namespace:
    """Base of groups of methods of one `system`."""

    system: Model

    def __repr__(self) -> str:
        names = ", ".join(name for name in dir(self) if name[0] != "_" and name != "system")
        return f"{type(self).__name__} of {self.system.name!r}: {names}"


@dataclass(frozen=True, repr=False)
class Symbolic(Namespace):
    """Models of a system as formulas."""

    @explain_errors
    def fk(
        self,
        frame: FrameLike,
        *,
        relative_to: FrameLike | None = None,
        symbols: Mapping[str, Any] | None = None,
        snap: float = 0.0,
        short: bool = False,
    ) -> Any:
        """The forward model in symbols (sympy Matrix 4x4), in the ground frame or in another one.

        With `short` a `ShortForm`: l1 c1 + l2 c12, and the legend; see
        `kempe.forward.symbolic`.
        """
        from kempe.forward.symbolic_steps import derive_short_fk

        return derive_short_fk(
            self.system, frame, short, relative_to=relative_to, symbols=symbols, snap=snap
        )

    @explain_errors
    def steps(
        self, frame: FrameLike, *, symbols: Mapping[str, Any] | None = None, snap: float = 0.0
    ) -> SymbolicSteps:
        """The matrices whose product is the forward model; see
        `kempe.forward.symbolic_steps`.
        """
        from kempe.forward.symbolic_steps import derive_steps

        return derive_steps(self.system, frame, symbols=symbols, snap=snap)

    @explain_errors
    def jacobian(
        self, frame: FrameLike, *, symbols: Mapping[str, Any] | None = None, snap: float = 0.0
    ) -> Any:
        """The Jacobian in symbols (sympy Matrix 6 x nv); see
        `kempe.forward.symbolic_steps`.
        """
        from kempe.forward.symbolic_steps import derive_jacobian

        return derive_jacobian(self.system, frame, symbols=symbols, snap=snap)

    @explain_errors
    def closure(
        self, *, symbols: Mapping[str, Any] | None = None, snap: float = 0.0
    ) -> SymbolicClosure:
        """The equations f(q) = 0 of all loops; see
        `kempe.forward.symbolic_closure.derive_closure`.
        """
        from kempe.forward.symbolic_closure import derive_closure

        return derive_closure(self.system, symbols=symbols, snap=snap)

    @explain_errors
    def to_dh(
        self,
        frame: FrameLike,
        convention: str = "standard",
        *,
        symbols: Mapping[str, Any] | None = None,
        snap: float = 0.0,
    ) -> DHTable:
        """The Denavit-Hartenberg table of a frame's chain; see
        `kempe.forward.symbolic_dh.to_dh`.
        """
        from kempe.forward.symbolic_dh import to_dh

        return to_dh(self.system, frame, convention, symbols=symbols, snap=snap)

    @explain_errors
    def ik(
        self,
        frame: FrameLike,
        task: str | None = None,
        *,
        symbols: Mapping[str, Any] | None = None,
        snap: float = 0.0,
    ) -> InverseFormulas:
        """The inverse model of a planar arm, or of one in space that ends in a wrist, as formulas.

        See `kempe.inverse.formulas.derive_ik`.
        """
        from kempe.inverse.formulas import derive_ik

        return derive_ik(self.system, frame, task, symbols=symbols, snap=snap)

    @explain_errors
    def short(self, formula: Any) -> ShortForm:
        """A formula with c12 for cos(q1 + q2), and the legend; see
        `kempe.forward.symbolic_steps`.
        """
        from kempe.forward.symbolic_steps import shorten_formula

        return shorten_formula(self.system, formula)


@dataclass(frozen=True, repr=False)
class Inverse(Namespace):
    """Methods about the inverse kinematics of a frame: how it is solved, and self-motions of
    redundant chains.
    """

    @explain_errors
    def plan(
        self,
        frame: FrameLike,
        task: str | tuple[str, ArrayLike] | None = None,
        fixed: Iterable[str] = (),
    ) -> Recognised:
        """The structure recognised in a frame's chain, and the closed form by which `ik_all` solves
        it.

        See `kempe.inverse.describe`.
        """
        from kempe.inverse.describe import describe_plan

        return describe_plan(self.system, frame, task, fixed)

    @explain_errors
    def sweep(
        self,
        target: ArrayLike,
        frame: FrameLike,
        parameter: str | tuple[str, ArrayLike] | None = None,
        *,
        n: int | None = None,
        task: str | tuple[str, ArrayLike] | None = None,
        start: Any = None,
        fixed: Mapping[str, Any] | None = None,
        budget: Budget | None = None,
    ) -> Sweep:
        """The solutions of a redundant chain along one parameter.

        See `kempe.inverse.sweep.ik_sweep`.
        """
        from kempe.inverse.sweep import ik_sweep

        return ik_sweep(
            self.system,
            target,
            frame,
            parameter,
            n=n,
            task=task,
            start=start,
            fixed=fixed,
            budget=budget,
        )

    @explain_errors
    def self_motion(
        self,
        q: Any,
        tasks: Any,
        *,
        task: str | tuple[str, ArrayLike] | None = None,
        direction: Any = None,
        budget: Budget | None = None,
    ) -> SelfMotion:
        """The motion from q that keeps a frame's pose or other tasks; see
        `kempe.inverse.self_motion`.
        """
        from kempe.inverse.self_motion import self_motion

        return self_motion(self.system, q, tasks, task=task, direction=direction, budget=budget)

    def arm_angle(self, q: Any, frame: FrameLike, reference: ArrayLike | None = None) -> Any:
        """Arm angle (...) in radians of a seven-joint arm with spherical shoulder and wrist at q
        (..., nq).

        See `kempe.inverse.arm_angle`.
        """
        from kempe.inverse.arm_angle import compute_arm_angle

        return compute_arm_angle(self.system, q, frame, reference)


@dataclass(frozen=True, repr=False)
class Loops(Namespace):
    """Methods about closed loops: the constraints that close them, and velocities and forces
    through them.
    """

    def constraints(self) -> list[SystemConstraint]:
        """The constraints of the system: closures, declared ones, relations; see
        `kempe.equations.closure_rows`.
        """
        return list_constraints(self.system)

    def closure_error(self, q: Any) -> Array:
        """Gap of each loop (..., number of closures, 6): the twist [m; rad] that is missing in its
        cut joint.
        """
        from kempe.equations.judge import closure_error

        return closure_error(self.system, q)

    def assembler(self, known: Iterable[str] = ()) -> Assembler:
        """A reusable `assemble` for these known names; see
        `kempe.assemble.bound.Assembler`.
        """
        from kempe.assemble.assemble import assembler

        return assembler(self.system, known)

    def closed_form(self, known: Sequence[str]) -> Plan | Incomplete:
        """The closed form of a planar system of dyads for these known coordinates; see
        `kempe.assemble.dyads`.
        """
        from kempe.assemble.dyads import closed_form

        return closed_form(self.system, known)

    @explain_errors
    def jacobian(
        self,
        q: Any,
        inputs: Sequence[str],
        outputs: Sequence[str],
        in_frame: str = "world_aligned",
        *,
        tolerance: float | str | None = None,
    ) -> LoopJacobian:
        """Matrix from velocities of inputs to those of joints or frames, with all loops closed.

        See `kempe.motion.transmission`.
        """
        from kempe.motion.transmission import loop_jacobian

        return loop_jacobian(self.system, q, inputs, outputs, in_frame, tolerance=tolerance)

    @explain_errors
    def mechanical_advantage(
        self,
        q: Any,
        input: str,
        output: str,
        direction: ArrayLike | None = None,
        still: Sequence[str] = (),
        *,
        tolerance: float | str | None = None,
    ) -> Any:
        """Force at the output per force at the input, at closed q (..., nq).

        See `kempe.motion.transmission`.
        """
        from kempe.motion.transmission import mechanical_advantage

        return mechanical_advantage(
            self.system, q, input, output, direction, still, tolerance=tolerance
        )

    @explain_errors
    def relative_motion(
        self, q: ArrayLike, body: FrameLike, to: FrameLike, *, tolerance: float | str | None = None
    ) -> RelativeMotion:
        """How a body can move relative to another one here: its DoF, twists and their words.

        See `kempe.mobility.relative_motion`.
        """
        from kempe.mobility.relative_motion import relative_motion

        return relative_motion(self.system, q, body, to, tolerance=tolerance)

    @explain_errors
    def transmission_angle(
        self, q: Any, joint: str, coupler: str | None = None, output: str | None = None
    ) -> Any:
        """Angle (...) between coupler and output link at their joint; see
        `kempe.motion.transmission`.
        """
        from kempe.motion.transmission import transmission_angle

        return transmission_angle(self.system, q, joint, coupler, output)


@dataclass(frozen=True, repr=False)
class ReachStudies(Namespace):
    """Methods about the reach of a frame: listed poses, places of the base, cells of a box, planar
    workspaces.
    """

    @explain_errors
    def poses(
        self,
        targets: ArrayLike,
        frame: FrameLike,
        *,
        task: str | tuple[str, ArrayLike] | None = None,
        budget: Budget | None = None,
    ) -> ReachStudy:
        """For a list of poses: which are reached, how far from singularities and limits, and what
        blocks the others.

        See `kempe.workspace.reach`.
        """
        from kempe.workspace.reach import reach_poses

        return reach_poses(self.system, targets, frame, task=task, budget=budget)

    @explain_errors
    def place(
        self,
        targets: ArrayLike,
        frame: FrameLike,
        box: Mapping[str, Any],
        cells: int | Mapping[str, int] = 11,
        *,
        task: str | tuple[str, ArrayLike] | None = None,
        budget: Budget | None = None,
    ) -> BasePlacement:
        """A map of places for the base from which all of a list of poses are reached.

        See `kempe.workspace.base_placement`.
        """
        from kempe.workspace.base_placement import place_base

        return place_base(self.system, targets, frame, box, cells, task=task, budget=budget)

    @explain_errors
    def capability(
        self,
        frame: FrameLike,
        box: ArrayLike,
        cells: int | tuple[int, ...] = 10,
        directions: int | ArrayLike = 32,
        rolls: int | None = None,
        *,
        budget: Budget | None = None,
    ) -> CapabilityMap:
        """A map of a box: in how many directions each cell is reached, and how far from
        singularities.

        See `kempe.workspace.capability`.
        """
        from kempe.workspace.capability import capability_map

        return capability_map(self.system, frame, box, cells, directions, rolls, budget=budget)

    @explain_errors
    def planar(
        self, frame: FrameLike, kind: str | None = None, orientation: Any = None
    ) -> PlanarWorkspace:
        """The exact workspace of a planar system; see
        `kempe.workspace.planar.planar_workspace`.
        """
        from kempe.workspace.planar.planar_workspace import planar_workspace

        return planar_workspace(self.system, frame, kind, orientation)
