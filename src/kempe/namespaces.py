"""Groups of methods: `System.symbolic`, `System.inverse`, `System.loops` and `System.reach`."""

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
    """Kinematic models of a system as symbolic formulas."""

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
        """Derive the forward kinematics of a frame as a SymPy matrix 4 x 4.

        It is in the ground frame or in another frame.

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
        """Derive the matrices whose product is the forward kinematics.

        See `kempe.forward.symbolic_steps`.
        """
        from kempe.forward.symbolic_steps import derive_steps

        return derive_steps(self.system, frame, symbols=symbols, snap=snap)

    @explain_errors
    def jacobian(
        self, frame: FrameLike, *, symbols: Mapping[str, Any] | None = None, snap: float = 0.0
    ) -> Any:
        """Derive the Jacobian of a frame as a SymPy matrix 6 x nv.

        See `kempe.forward.symbolic_steps`.
        """
        from kempe.forward.symbolic_steps import derive_jacobian

        return derive_jacobian(self.system, frame, symbols=symbols, snap=snap)

    @explain_errors
    def closure(
        self, *, symbols: Mapping[str, Any] | None = None, snap: float = 0.0
    ) -> SymbolicClosure:
        """Derive the equations f(q) = 0 of all loops.

        See `kempe.forward.symbolic_closure.derive_closure`.
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
        """Derive the Denavit-Hartenberg table of a frame's chain.

        See `kempe.forward.symbolic_dh.to_dh`.
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
        """Derive formulas of the inverse kinematics of a planar arm, or a spatial arm with a wrist.

        See `kempe.inverse.formulas.derive_ik`.
        """
        from kempe.inverse.formulas import derive_ik

        return derive_ik(self.system, frame, task, symbols=symbols, snap=snap)

    @explain_errors
    def short(self, formula: Any) -> ShortForm:
        """Shorten a formula, with c12 for cos(q1 + q2), and return the short form and the legend.

        See `kempe.forward.symbolic_steps`.
        """
        from kempe.forward.symbolic_steps import shorten_formula

        return shorten_formula(self.system, formula)


@dataclass(frozen=True, repr=False)
class Inverse(Namespace):
    """Methods about inverse kinematics: closed forms, and self-motions of redundant chains."""

    @explain_errors
    def plan(
        self,
        frame: FrameLike,
        task: str | tuple[str, ArrayLike] | None = None,
        fixed: Iterable[str] = (),
    ) -> Recognised:
        """Return the structure of a frame's chain and the closed form by which `ik_all` solves it.

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
        """Solve the inverse kinematics of a redundant chain along one parameter.

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
        """Trace the motion from q that keeps a frame's pose or other tasks.

        See `kempe.inverse.self_motion`.
        """
        from kempe.inverse.self_motion import self_motion

        return self_motion(self.system, q, tasks, task=task, direction=direction, budget=budget)

    def arm_angle(self, q: Any, frame: FrameLike, reference: ArrayLike | None = None) -> Any:
        """Compute the arm angle (...) in radians at q (..., nq).

        The arm has seven joints with spherical shoulder and wrist.

        See `kempe.inverse.arm_angle`.
        """
        from kempe.inverse.arm_angle import compute_arm_angle

        return compute_arm_angle(self.system, q, frame, reference)


@dataclass(frozen=True, repr=False)
class Loops(Namespace):
    """Methods about closed loops: constraints that close them, velocities, forces and angles."""

    def constraints(self) -> list[SystemConstraint]:
        """Return the loop closures, declared constraints and relations of the system.

        See `kempe.equations.closure_rows`.
        """
        return list_constraints(self.system)

    def closure_error(self, q: Any) -> Array:
        """Compute the gaps (..., number of closures, 6) of all loops as twists [m; rad].

        Each twist is in the cut joint of the loop.
        """
        from kempe.equations.judge import closure_error

        return closure_error(self.system, q)

    def assembler(self, known: Iterable[str] = ()) -> Assembler:
        """Return a reusable assembler for known coordinates with fixed names.

        See `kempe.assemble.bound.Assembler`.
        """
        from kempe.assemble.assemble import bind_assembler

        return bind_assembler(self.system, known)

    def closed_form(self, known: Sequence[str]) -> Plan | Incomplete:
        """Return the closed form of a planar system of dyads.

        Its inputs are the `known` coordinates; see `kempe.assemble.dyads`.
        """
        from kempe.assemble.dyads import find_closed_form

        return find_closed_form(self.system, known)

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
        """Compute the matrix from input velocities to output velocities, with all loops closed.
        Outputs are joints or frames.

        See `kempe.motion.transmission`.
        """
        from kempe.motion.transmission import compute_loop_jacobian

        return compute_loop_jacobian(self.system, q, inputs, outputs, in_frame, tolerance=tolerance)

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
        """Compute the ratio of output force to input force at closed configurations q (..., nq).

        See `kempe.motion.transmission`.
        """
        from kempe.motion.transmission import compute_mechanical_advantage

        return compute_mechanical_advantage(
            self.system, q, input, output, direction, still, tolerance=tolerance
        )

    @explain_errors
    def relative_motion(
        self, q: ArrayLike, body: FrameLike, to: FrameLike, *, tolerance: float | str | None = None
    ) -> RelativeMotion:
        """Describe how a body can move relative to another at q: degrees of freedom and twists.

        See `kempe.mobility.relative_motion`.
        """
        from kempe.mobility.relative_motion import find_relative_motion

        return find_relative_motion(self.system, q, body, to, tolerance=tolerance)

    @explain_errors
    def transmission_angle(
        self, q: Any, joint: str, coupler: str | None = None, output: str | None = None
    ) -> Any:
        """Compute the angle (...) between coupler and output link at their joint.

        See `kempe.motion.transmission`.
        """
        from kempe.motion.transmission import compute_transmission_angle

        return compute_transmission_angle(self.system, q, joint, coupler, output)


@dataclass(frozen=True, repr=False)
class ReachStudies(Namespace):
    """Methods about the reach of a frame: poses, base placements, capability, planar workspaces."""

    @explain_errors
    def poses(
        self,
        targets: ArrayLike,
        frame: FrameLike,
        *,
        task: str | tuple[str, ArrayLike] | None = None,
        budget: Budget | None = None,
    ) -> ReachStudy:
        """Study which poses of a list a frame reaches.

        The study gives distances from singularities and limits, and what blocks the other poses.

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
        """Compute a map of base placements from which all poses of a list are reached.

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
        """Compute for each cell of a box in how many directions a frame reaches it, and how well.

        See `kempe.workspace.capability`.
        """
        from kempe.workspace.capability import capability_map

        return capability_map(self.system, frame, box, cells, directions, rolls, budget=budget)

    @explain_errors
    def planar(
        self, frame: FrameLike, kind: str | None = None, orientation: Any = None
    ) -> PlanarWorkspace:
        """Compute the exact workspace of a planar system.

        See `kempe.workspace.planar.planar_workspace`.
        """
        from kempe.workspace.planar.planar_workspace import planar_workspace

        return planar_workspace(self.system, frame, kind, orientation)
