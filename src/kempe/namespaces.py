"""Groups of methods: `System.symbolic`, `System.inverse`, `System.loops`, `System.reach` and
`System.geometry`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from kempe.arguments import explain_errors
from kempe.equations.closure_rows import list_constraints
from kempe.model.model import FrameLike
from kempe.spatial import Array

if TYPE_CHECKING:
    from sympy import Expr, Matrix

    from kempe.argument_types import ConfigurationLike, MotionLike, StartLike, TaskLike
    from kempe.assemble.bound import Assembler
    from kempe.assemble.dyads import Incomplete, Plan
    from kempe.budget import Budget
    from kempe.constraints.base import Constraint
    from kempe.equations.closure_rows import SystemConstraint
    from kempe.forward.symbolic_closure import SymbolicClosure
    from kempe.forward.symbolic_dh import DHTable
    from kempe.forward.symbolic_steps import ShortForm, SymbolicSteps
    from kempe.geometry.clearance import NearestBodies
    from kempe.geometry.path_clearance import PathClearance
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
        symbols: Mapping[str, Expr | str | float] | None = None,
        snap: float = 0.0,
        short: bool = False,
    ) -> Matrix | ShortForm:
        """Derive the pose of a frame as a SymPy matrix 4 x 4, in coordinates and parameters.

        Angles of parallel joints are summed: cos(q1 + q2).

        Parameters
        ----------
        frame
            Name of the body or frame.
        relative_to
            Frame in which the pose is expressed. Default: the ground frame.
        symbols
            Replacements of coordinates and parameters, by name: other symbols, expressions,
            numbers, or text of an expression. Default: symbols with their own names.
        snap
            Angle in radians, from 0 to below pi/4: angles that differ by at most that from a
            multiple of pi/2 become this multiple, and axes that near to x, y or z become these.
            Robot files write 1.5708. Default: exact multiples of pi/12 only.
        short
            Whether to return short names of sines and cosines: l1 c1 + l2 c12.

        Returns
        -------
        Matrix or ShortForm
            Lengths in metres, angles in radians. With `short` a pair of `formula` and `legend`. The
            attribute `snapped` of the matrix lists in sentences what `snap` changed.

        Raises
        ------
        UnknownNameError
            For names that the system does not have.
        InputError
            For a `snap` outside its range, and where a coordinate and a parameter share a name.
        UnsupportedError
            For formulas that would be too long.
        MissingExtraError
            Without SymPy.

        See Also
        --------
        steps : The matrices whose product this is.
        System.fk : The pose in numbers.

        Notes
        -----
        Product of homogeneous matrices along the chain (Siciliano, Sciavicco, Villani, Oriolo 2009,
        section 2.7). Quaternions are taken to have norm one.

        Examples
        --------
        >>> import kempe
        >>> kempe.load("two_link").symbolic.fk("e")[0, 3]
        l1*cos(q1) + l2*cos(q1 + q2)
        """
        from kempe.forward.symbolic_steps import derive_short_fk

        return derive_short_fk(
            self.system, frame, short, relative_to=relative_to, symbols=symbols, snap=snap
        )

    @explain_errors
    def steps(
        self,
        frame: FrameLike,
        *,
        symbols: Mapping[str, Expr | str | float] | None = None,
        snap: float = 0.0,
    ) -> SymbolicSteps:
        """Derive the pose of each frame of the chain in the frame before it.

        Parameters
        ----------
        frame
            Name of the body or frame.
        symbols
            Replacements of coordinates and parameters, by name: other symbols, expressions,
            numbers, or text of an expression. Default: symbols with their own names.
        snap
            Angle in radians, from 0 to below pi/4: angles that differ by at most that from a
            multiple of pi/2 become this multiple, and axes that near to x, y or z become these.
            Robot files write 1.5708. Default: exact multiples of pi/12 only.

        Returns
        -------
        SymbolicSteps
            `names` of the frames from the ground to the tip; matrices `T`, `R` and `p` of each
            step; `products`, the poses in the ground frame; `merged`, the result as `fk` gives it;
            `latex()` and `numbers(q)`.

        Raises
        ------
        UnknownNameError
            For names that the system does not have.
        InputError
            For a `snap` outside its range, and where a coordinate and a parameter share a name.

        See Also
        --------
        fk : The product.

        Examples
        --------
        >>> import kempe
        >>> steps = kempe.load("two_link").symbolic.steps("e")
        >>> steps.names, steps.p[1].T
        (('ground', 'B1', 'B2', 'e'), Matrix([[l1, 0, 0]]))
        """
        from kempe.forward.symbolic_steps import derive_steps

        return derive_steps(self.system, frame, symbols=symbols, snap=snap)

    @explain_errors
    def jacobian(
        self,
        frame: FrameLike,
        *,
        symbols: Mapping[str, Expr | str | float] | None = None,
        snap: float = 0.0,
    ) -> Matrix | ShortForm:
        """Derive the Jacobian of a frame as a SymPy matrix 6 x nv, in axes of the ground.

        Parameters
        ----------
        frame
            Name of the body or frame.
        symbols
            Replacements of coordinates and parameters, by name: other symbols, expressions,
            numbers, or text of an expression. Default: symbols with their own names.
        snap
            Angle in radians, from 0 to below pi/4: angles that differ by at most that from a
            multiple of pi/2 become this multiple, and axes that near to x, y or z become these.
            Robot files write 1.5708. Default: exact multiples of pi/12 only.

        Returns
        -------
        Matrix
            Linear velocity of the frame's origin in rows 0 to 2, angular velocity in rows 3 to 5;
            one column for each velocity coordinate.

        Raises
        ------
        UnknownNameError
            For names that the system does not have.
        InputError
            For a `snap` outside its range, and where a coordinate and a parameter share a name.
        UnsupportedError
            Where a joint with a quaternion moves the frame.

        See Also
        --------
        System.jacobian : The same in numbers.

        Notes
        -----
        A joint that turns about the axis a through c has the column [a x (p - c); a], a joint that
        slides along a has [a; 0] (Siciliano, Sciavicco, Villani, Oriolo 2009, section 3.1).

        Examples
        --------
        >>> import kempe
        >>> J = kempe.load("two_link").symbolic.jacobian("e")
        >>> J.shape, J[1, 1]
        ((6, 2), l2*cos(q1 + q2))
        """
        from kempe.forward.symbolic_steps import derive_jacobian

        return derive_jacobian(self.system, frame, symbols=symbols, snap=snap)

    @explain_errors
    def closure(
        self, *, symbols: Mapping[str, Expr | str | float] | None = None, snap: float = 0.0
    ) -> SymbolicClosure:
        """Derive the equations f(q) = 0 of closed configurations.

        Parameters
        ----------
        symbols
            Replacements of coordinates and parameters, by name: other symbols, expressions,
            numbers, or text of an expression. Default: symbols with their own names.
        snap
            Angle in radians, from 0 to below pi/4: angles that differ by at most that from a
            multiple of pi/2 become this multiple, and axes that near to x, y or z become these.
            Robot files write 1.5708. Default: exact multiples of pi/12 only.

        Returns
        -------
        SymbolicClosure
            `equations`: a matrix (m, 1) for each cut joint, constraint and relation, by its name;
            `matrix`: all of them in one column; `latex()`. Lengths are in metres; turns are sines
            of angles, which are zero half a turn off, too; a rod gives the difference of the
            squares of two lengths.

        Raises
        ------
        UnsupportedError
            For constraints without such equations.
        InputError
            For a `snap` outside its range, and where a coordinate and a parameter share a name.

        See Also
        --------
        System.assemble : Configurations that satisfy the equations.

        Examples
        --------
        >>> import kempe
        >>> kempe.load("four_bar").symbolic.closure()["C"][0]
        a*cos(A) + b*cos(A + B) - c*cos(D) - d
        """
        from kempe.forward.symbolic_closure import derive_closure

        return derive_closure(self.system, symbols=symbols, snap=snap)

    @explain_errors
    def to_dh(
        self,
        frame: FrameLike,
        convention: str = "standard",
        *,
        symbols: Mapping[str, Expr | str | float] | None = None,
        snap: float = 0.0,
    ) -> DHTable:
        """Derive the Denavit-Hartenberg table of the chain that moves a frame.

        Parameters
        ----------
        frame
            Name of the body or frame.
        convention
            "standard" or "modified", as in `kempe.from_dh`.
        symbols
            Replacements of coordinates and parameters, by name: other symbols, expressions,
            numbers, or text of an expression. Default: symbols with their own names.
        snap
            Angle in radians, from 0 to below pi/4: angles that differ by at most that from a
            multiple of pi/2 become this multiple, and axes that near to x, y or z become these.
            Robot files write 1.5708. Default: exact multiples of pi/12 only.

        Returns
        -------
        DHTable
            `rows` with a, alpha, d and theta of each joint, the poses `base` and `tool` (4, 4)
            before and after them, and `mechanism()`, the chain that the table describes.

        Raises
        ------
        UnknownNameError
            For names that the system does not have.
        InputError
            For a `snap` outside its range, and where a coordinate and a parameter share a name.
        UnsupportedError
            For quaternions, helical joints and couplings, and for a frame that no joint moves.

        See Also
        --------
        kempe.from_dh : The mechanism of a table.

        Notes
        -----
        Frames stand on the common normals of successive axes (Denavit and Hartenberg, 1955). Where
        axes are parallel, d is zero.

        Examples
        --------
        >>> import kempe
        >>> print(kempe.load("two_link").symbolic.to_dh("e"))
        e of two_link, standard Denavit-Hartenberg
          joint = q1, a = l1, alpha = 0, d = 0, theta = q1
          joint = q2, a = l2, alpha = 0, d = 0, theta = q2
        """
        from kempe.forward.symbolic_dh import to_dh

        return to_dh(self.system, frame, convention, symbols=symbols, snap=snap)

    @explain_errors
    def ik(
        self,
        frame: FrameLike,
        task: str | None = None,
        *,
        symbols: Mapping[str, Expr | str | float] | None = None,
        snap: float = 0.0,
    ) -> InverseFormulas:
        """Derive formulas of the inverse kinematics, step by step as on paper.

        They exist for planar arms of two or three joints, SCARAs, and arms in space of three or six
        joints with a wrist or with three parallel axes. Limits are not regarded.

        Parameters
        ----------
        frame
            Name of the body or frame.
        task
            "position" or "pose". Default: the one that the number of joints allows.
        symbols
            Replacements of coordinates and parameters, by name: other symbols, expressions,
            numbers, or text of an expression. Default: symbols with their own names.
        snap
            Angle in radians, from 0 to below pi/4: angles that differ by at most that from a
            multiple of pi/2 become this multiple, and axes that near to x, y or z become these.
            Robot files write 1.5708. Default: exact multiples of pi/12 only.

        Returns
        -------
        InverseFormulas
            `steps` with symbol, formula, reason and condition of each; `target` and `signs`, the
            symbols that are given; `latex()`; `code()`, a Python function for NumPy. Called with
            targets and signs it returns coordinates (..., n) in radians and metres, NaN out of
            reach.

        Raises
        ------
        UnknownNameError
            For names that the system does not have.
        InputError
            For a `snap` outside its range, and where a coordinate and a parameter share a name.
        UnsupportedError
            For other chains, and for systems with constraints.

        See Also
        --------
        System.ik_all : All solutions in numbers, of more chains.

        Notes
        -----
        The position is squared and summed, which leaves the angle of the elbow; its sine has two
        signs (Siciliano, Sciavicco, Villani, Oriolo 2009, section 2.12.1).

        Examples
        --------
        >>> import kempe
        >>> formulas = kempe.load("two_link").symbolic.ik("e")
        >>> print(formulas.steps[1].formula)
        (-l1**2 - l2**2 + r2)/(2*l1*l2)
        >>> formulas([0.6, 0.3], sign=1).round(6)
        array([-0.171499,  1.470629])
        """
        from kempe.inverse.formulas import derive_ik

        return derive_ik(self.system, frame, task, symbols=symbols, snap=snap)

    @explain_errors
    def short(self, formula: Expr | Matrix) -> ShortForm:
        """Shorten a formula: c1 for cos(q1), s12 for sin(q1 + q2).

        Parameters
        ----------
        formula
            Expression or matrix of SymPy. A coordinate is named by the last digit of its name if
            that tells it from the others, else by its name after an underscore.

        Returns
        -------
        ShortForm
            A pair of `formula` and `legend`, a dict from each short name to what it stands for.
            Functions whose short name is taken stay as they are.

        Raises
        ------
        InputError
            For what is no formula of SymPy.

        Examples
        --------
        >>> import kempe
        >>> arm = kempe.load("two_link")
        >>> arm.symbolic.short(arm.symbolic.fk("e")[0, 3]).formula
        c1*l1 + c12*l2
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
        """Describe the structure of a frame's chain, and the method by which `ik_all` solves it.

        Parameters
        ----------
        frame
            Name of the body or frame.
        task
            Part of the target that counts, as in `System.ik_all`. Default: the pose, or the
            position if the chain has no more joints than a position has equations.
        fixed
            Names of joints that are held.

        Returns
        -------
        Recognised
            The structure, the method, and the largest number of solutions, for example ``.most``.

        Raises
        ------
        UnsupportedError
            For chains with loops, quaternions or shared coordinates.
        InputError
            For wrong values and other words for `task`.
        UnknownNameError
            If there is no such frame or joint.
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
        start: StartLike | None = None,
        fixed: Mapping[str, ArrayLike] | None = None,
        budget: Budget | None = None,
    ) -> Sweep:
        """Solve the inverse kinematics of a redundant chain for one target along one parameter.

        Parameters
        ----------
        target, frame, task
            Target, as in `System.ik_all`.
        parameter
            Name of a joint, or "arm_angle" for seven revolute joints whose first three axes and
            last three axes meet in points (see `arm_angle`); the pair ("arm_angle", reference) sets
            its reference direction. Default: the arm angle if it exists, else the joint that
            `ik_all` holds.
        n
            Number of samples of the parameter.
        start
            Configuration (nq,) with the values of further spare joints; it also chooses among
            turns. Default: where `ik_all` finds a solution inside the limits.
        fixed
            Values of further spare joints by name.
        budget
            Reads points (256, values of a joint at which curves are searched) and time_limit (30
            s).

        Returns
        -------
        Sweep
            Branches with the intervals of the parameter in which they are inside the limits. If the
            time limit ends the work, `late` is true and these are the branches found.

        Raises
        ------
        UnsupportedError
            For chains without a spare freedom, or without an arm angle if it is requested.
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such frame or joint.
        TimeLimitError
            If no branch could be examined within the time limit.
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
        q: ConfigurationLike,
        tasks: FrameLike | TaskLike,
        *,
        task: str | tuple[str, ArrayLike] | None = None,
        direction: str | ArrayLike | None = None,
        budget: Budget | None = None,
    ) -> SelfMotion:
        """Trace the motion from a configuration that keeps a frame's pose or other tasks.

        Parameters
        ----------
        q
            Configuration (nq,) that satisfies the tasks.
        tasks
            Name of a frame, or hard tasks of `kempe.tasks`.
        task
            Part of the frame's pose that is kept, as in `System.ik`.
        direction
            Name of a coordinate, or a velocity (nv,), that chooses a curve if the tasks leave more
            than one freedom. It is projected onto the velocities that keep the tasks.
        budget
            Reads points (200 in each direction), step (0.05, in radians and characteristic
            lengths), time_limit (120 s) and progress.

        Returns
        -------
        SelfMotion
            Configurations `q` (n, nq). They satisfy the tasks to 1e-9. The curve is traced in both
            directions until it closes or meets a limit. Where the Jacobian loses rank and no motion
            is found, it is `q` alone.

        Raises
        ------
        InputError
            If the tasks are not satisfied at `q`, leave no freedom to first order, or leave more
            than one without a direction.
        UnsupportedError
            If velocity constraints do not allow the motion.
        """
        from kempe.inverse.self_motion import self_motion

        return self_motion(self.system, q, tasks, task=task, direction=direction, budget=budget)

    def arm_angle(
        self, q: ConfigurationLike, frame: FrameLike, reference: ArrayLike | None = None
    ) -> float | Array:
        """Compute the arm angle of an arm with seven joints, a spherical shoulder and wrist.

        `kempe.inverse.arm_angle` defines the angle.

        Parameters
        ----------
        q
            Configurations (..., nq).
        frame
            Name of the body or frame at the end of the arm.
        reference
            Direction (3,) in ground axes (default: the axis of the first joint).

        Returns
        -------
        float or Array
            Angles (...) in radians, in (-pi, pi].

        Raises
        ------
        UnsupportedError
            For other chains.
        InputError
            For wrong shapes.
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

    def closure_error(self, q: ConfigurationLike) -> Array:
        """Compute the gaps of all loops that cut joints close.

        Parameters
        ----------
        q
            Configurations (..., nq).

        Returns
        -------
        Array
            Twists (..., number of closures, 6) [v; w] in metres and radians, in axes of the joint's
            frame M. They lead from the pose that the joint's own coordinates give to M, to its pose
            by the tree. Zero for closed loops; the angular part is zero for particles.
        """
        from kempe.equations.judge import closure_error

        return closure_error(self.system, q)

    def assembler(self, known: Iterable[str] = ()) -> Assembler:
        """Return a reusable assembler for known coordinates with fixed names.

        Parameters
        ----------
        known
            Names of coordinates and frames.

        Returns
        -------
        Assembler
            Function of values in this order; see `kempe.assemble.bound.Assembler`.

        Raises
        ------
        UnknownNameError
            If there is no such coordinate or frame.
        InputError
            For names that cannot be known together.
        """
        from kempe.assemble.assemble import bind_assembler

        return bind_assembler(self.system, known)

    def closed_form(self, known: Sequence[str]) -> Plan | Incomplete:
        """Find the closed form of a planar system of dyads for known coordinates.

        It exists for bodies with revolute, prismatic and fixed joints, which are placed by the
        known coordinates, their followers, and dyads of three rigid clusters (Assur groups of class
        two).

        Parameters
        ----------
        known
            Names of the known coordinates.

        Returns
        -------
        Plan or Incomplete
            The closed form, or the reason why there is none.

        Raises
        ------
        UnknownNameError
            If there is no such coordinate.
        InputError
            For a coordinate that is not part of `q`.
        """
        from kempe.assemble.dyads import find_closed_form

        return find_closed_form(self.system, known)

    @explain_errors
    def jacobian(
        self,
        q: ConfigurationLike,
        inputs: Sequence[str],
        outputs: Sequence[str],
        in_frame: str = "world_aligned",
        *,
        tolerance: float | str | None = None,
    ) -> LoopJacobian:
        """Compute the Jacobian of outputs with respect to inputs, with all loops closed.

        Parameters
        ----------
        q
            Closed configurations (..., nq).
        inputs
            Names of angles and slides, as many as the mechanism has freedoms (fewer if the other
            freedoms do not move the outputs).
        outputs
            Names of coordinates (one row each), or of bodies and frames (six rows each, linear
            first). "joint:name" and "frame:name" distinguish equal names.
        in_frame
            Frame in which twists are expressed, as in `System.jacobian`.
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `System.idealise`.

        Returns
        -------
        LoopJacobian
            `matrix` (..., rows, inputs) in SI units, NaN where it does not exist, with its rank.

        Raises
        ------
        InputError
            For configurations that are not closed, and ambiguous names.
        UnknownNameError
            If there is no such coordinate or frame.
        """
        from kempe.motion.transmission import compute_loop_jacobian

        return compute_loop_jacobian(self.system, q, inputs, outputs, in_frame, tolerance=tolerance)

    @explain_errors
    def mechanical_advantage(
        self,
        q: ConfigurationLike,
        input: str,
        output: str,
        direction: ArrayLike | None = None,
        still: Sequence[str] = (),
        *,
        tolerance: float | str | None = None,
    ) -> float | Array:
        """Compute the ratio of output force to input force, without losses.

        Parameters
        ----------
        q
            Closed configurations (..., nq).
        input
            Name of the input coordinate.
        output
            Name of a coordinate or a frame.
        direction
            Direction (3,) in the ground frame in which an output frame pushes.
        still
            Names of other inputs, which do not move.
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `System.idealise`.

        Returns
        -------
        float or Array
            Ratios (...) of forces or torques: infinite where the output rests (toggle), 0 where the
            input rests (dead point), NaN where the ratio is undetermined.

        Raises
        ------
        InputError
            For configurations that are not closed, and ambiguous names.
        UnknownNameError
            If there is no such coordinate or frame.

        Notes
        -----
        By the principle of virtual power, the ratio is the input velocity divided by the output
        velocity.
        """
        from kempe.motion.transmission import compute_mechanical_advantage

        return compute_mechanical_advantage(
            self.system, q, input, output, direction, still, tolerance=tolerance
        )

    @explain_errors
    def relative_motion(
        self, q: ArrayLike, body: FrameLike, to: FrameLike, *, tolerance: float | str | None = None
    ) -> RelativeMotion:
        """Find the motions of a body or frame relative to another at a closed configuration.

        Parameters
        ----------
        q
            Closed configuration (nq,).
        body, to
            Names of the moving body or frame, and of the one from which it is seen.
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `System.idealise`.

        Returns
        -------
        RelativeMotion
            Number of freedoms and twists, in the frame `to`.

        Raises
        ------
        InputError
            For wrong shapes, and a `q` that is not closed.
        UnknownNameError
            If there is no such body or frame.
        UnsupportedError
            For frames of particles.

        Notes
        -----
        The result is of first order: the image, under the difference of both Jacobians, of all
        velocities that the constraints allow. At a singular configuration some of these may not
        extend to a motion; `System.mobility` examines this.
        """
        from kempe.mobility.relative_motion import find_relative_motion

        return find_relative_motion(self.system, q, body, to, tolerance=tolerance)

    @explain_errors
    def transmission_angle(
        self,
        q: ConfigurationLike,
        joint: str,
        coupler: str | None = None,
        output: str | None = None,
    ) -> float | Array:
        """Compute the transmission angle at a joint between the coupler and the output link.

        Parameters
        ----------
        q
            Closed configurations (..., nq).
        joint
            Joint that connects the coupler, a two-force member, with the output link.
        coupler, output
            Other joints of the coupler and of the output link. They may be left out where there is
            only one. `output` also chooses the output link (default: the one nearer to the ground).

        Returns
        -------
        float or Array
            Angles (...) in [0, pi/2]. pi/2 is best; below about 40 degrees a linkage runs badly; at
            0 it is stuck.

        Raises
        ------
        UnsupportedError
            For joints of other kinds.
        InputError
            For wrong shapes or ambiguous joints.
        UnknownNameError
            If there is no such joint.

        Notes
        -----
        The angle is pi/2 less the pressure angle between the force of the coupler and the possible
        motion of the output link (Alt, *Werkstattstechnik*, 1932). For a sliding output link it is
        measured to the normal of the slide.
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
        clearance: Constraint | Sequence[Constraint] | None = None,
        budget: Budget | None = None,
    ) -> ReachStudy:
        """Study which poses of a list a frame reaches, how well, and what blocks the others.

        Parameters
        ----------
        targets
            Poses (n, 4, 4) or positions (n, 3) in the ground frame.
        frame
            Name of the body or frame.
        task
            Part of the targets that counts, as in `System.ik`.
        clearance
            `Clearance`, or a list of them, that solutions must keep.
        budget
            Reads starts (1000), rng (0), threads, time_limit (600 s) and progress(poses tried,
            all).

        Returns
        -------
        ReachStudy
            Reached poses, their distances from singularities and limits, and reasons for the
            others. A pose is reached if `ik`, or `ik_all` for chains with finitely many solutions,
            finds a solution inside the limits. After the time limit it has the finished poses.

        Raises
        ------
        InputError
            For wrong shapes.
        UnknownNameError
            If there is no such frame.
        Interrupted
            After Ctrl-C, with the finished poses as its `answer`.
        """
        from kempe.workspace.reach import reach_poses

        return reach_poses(
            self.system, targets, frame, task=task, clearance=clearance, budget=budget
        )

    @explain_errors
    def place(
        self,
        targets: ArrayLike,
        frame: FrameLike,
        box: Mapping[str, float | tuple[float, float]],
        cells: int | Mapping[str, int] = 11,
        *,
        task: str | tuple[str, ArrayLike] | None = None,
        budget: Budget | None = None,
    ) -> BasePlacement:
        """Compute a map of base placements from which a frame reaches fixed targets.

        Parameters
        ----------
        targets, frame, task
            Poses (n, 4, 4) in the ground frame, and what counts of them, as in `poses`.
        box
            Range (low, high) or one number for each of "x", "y", "z" in metres and "yaw" in
            radians; others are 0.
        cells
            Number of values for each range, as one number or by name.
        budget
            Reads starts (64), rng (0), threads, time_limit (600 s) and progress(poses tried, all).

        Returns
        -------
        BasePlacement
            The map. After the time limit it has the finished placements.

        Raises
        ------
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such frame or coordinate of the base.
        Interrupted
            After Ctrl-C, with the finished placements as its `answer`.
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
        clearance: Constraint | Sequence[Constraint] | None = None,
        budget: Budget | None = None,
    ) -> CapabilityMap:
        """Compute for each cell of a box in how many directions a frame reaches it, and how well.

        Parameters
        ----------
        frame
            Name of the body or frame.
        box
            Two corners (2, 3) in metres, in the plane (2, 2).
        cells
            Number of cells along each axis.
        directions
            Number of evenly spread directions, or vectors (d, 3), in the plane (d, 2).
        rolls
            Number of angles about each direction. Each is tried as a pose, and solutions are
            counted for chains with finitely many.
        clearance
            `Clearance`, or a list of them: directions count that are reached by solutions which
            keep it, so that the map has the free part of the workspace.
        budget
            Reads starts (32), rng (0), threads, time_limit (600 s) and progress.

        Returns
        -------
        CapabilityMap
            The map. After the time limit it has the finished cells.

        Raises
        ------
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such frame.
        Interrupted
            After Ctrl-C, with the finished cells as its `answer`.
        """
        from kempe.workspace.capability import capability_map

        return capability_map(
            self.system, frame, box, cells, directions, rolls, clearance=clearance, budget=budget
        )

    @explain_errors
    def planar(
        self, frame: FrameLike, kind: str | None = None, orientation: ArrayLike | None = None
    ) -> PlanarWorkspace:
        """Compute the exact workspace of a frame of a planar system.

        Parameters
        ----------
        frame
            Name of the body or frame.
        kind, orientation
            Kind of workspace, as in `System.workspace`. "dexterous" without orientations means all
            angles.

        Returns
        -------
        PlanarWorkspace
            Region with its boundary and area.

        Raises
        ------
        UnsupportedError
            For spatial systems, constraints, coupled joints, chains of more than 6 joints, and
            loops other than those of legs (`kempe.workspace.legs`).
        InputError
            For prismatic joints without limits, and a frame that does not move.

        Notes
        -----
        Candidates for the boundary are arcs and segments on which joints are at limits or singular.
        The number of solutions of the inverse kinematics on both sides selects the boundary
        (`kempe.workspace.planar.planar_chain`). The workspace of a mechanism with legs is the
        intersection of the workspaces of the legs. Where orientations count, the last joint of the
        chain must turn without limits; so must the last joint of each leg, except for one leg if
        all others end at the frame's origin. For legs that hold different points of a platform, the
        boundary has coupler curves and the area is sampled
        (`kempe.workspace.planar.planar_platform`).
        """
        from kempe.workspace.planar.planar_workspace import planar_workspace

        return planar_workspace(self.system, frame, kind, orientation)


@dataclass(frozen=True, repr=False)
class BodyGeometry(Namespace):
    """Distances between bodies by their collision shapes (extra `collision`: coal)."""

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of bodies that are looked at: all that have collision shapes and move against one
        another, but for neighbours (a joint connects them), pairs that the description ignores, and
        pairs that touch in all of 64 random configurations.
        """
        from kempe.geometry.solids import get_solids

        return get_solids(self.system).pairs

    @explain_errors
    def clearance(
        self, q: ConfigurationLike, pairs: Iterable[tuple[str, str]] | None = None
    ) -> Array | float:
        """Compute the smallest distance between bodies.

        Parameters
        ----------
        q
            Configurations (..., nq).
        pairs
            Pairs of names of bodies (default: `pairs`).

        Returns
        -------
        Array or float
            Distances (...) in metres; a negative one is the depth by which two bodies overlap. NaN
            where q is not finite, infinite without pairs.

        Raises
        ------
        InputError
            If no body has a collision shape, a mesh cannot be read, or something is no pair.
        UnknownNameError
            If there is no such body.
        MissingExtraError
            Without coal.

        See Also
        --------
        nearest : which bodies are nearest, where, and the derivatives of their distances.

        Notes
        -----
        Spheres, capsules, and these with boxes are measured in closed form, to the last digits. All
        others are measured by coal: distances of convex shapes by the method of Gilbert, Johnson and
        Keerthi (1988), depths by expanding polytopes. A mesh counts as its convex hull: where it is
        not convex, the distance is too small; it is too large by rounding at most (about 1e-6).

        Examples
        --------
        >>> import kempe
        >>> m = kempe.Mechanism("arm")
        >>> link = m.body("link")
        >>> m.revolute("A", m.ground, link, at=(0, 0, 1), axis="y")  # doctest: +ELLIPSIS
        Joint(...)
        >>> shape = m.shape(link, "sphere", radius=0.1, at=(1, 0, 0))
        >>> wall = m.obstacle("wall", "box", size=(0.2, 2, 2), at=(1.5, 0, 1))
        >>> round(m.build().geometry.clearance([0.0]), 6)
        0.3
        """
        from kempe.geometry.clearance import compute_clearance

        return compute_clearance(self.system, q, pairs)

    @explain_errors
    def nearest(
        self, q: ConfigurationLike, pairs: Iterable[tuple[str, str]] | None = None
    ) -> NearestBodies:
        """Find the distance of each pair of bodies, the smallest first.

        Parameters
        ----------
        q
            Configuration (nq,).
        pairs
            Pairs of names of bodies (default: `pairs`).

        Returns
        -------
        NearestBodies
            Pairs, distances, nearest points, and derivatives of the distances.

        Raises
        ------
        InputError, UnknownNameError, MissingExtraError
            As `clearance`; and for more than one configuration.

        See Also
        --------
        clearance : the smallest distance of many configurations.
        """
        from kempe.geometry.clearance import find_nearest_bodies

        return find_nearest_bodies(self.system, q, pairs)

    @explain_errors
    def check_path(
        self,
        path: MotionLike,
        clearance: Constraint | Sequence[Constraint],
        *,
        budget: Budget | None = None,
    ) -> PathClearance:
        """Check whether bodies keep a distance along a path, between its configurations, too.

        Parameters
        ----------
        path
            Configurations (n, nq), or an answer that has them. Between two of them the coordinates
            move straight. Rows that are not finite are left out, and the ways to them.
        clearance
            `Clearance`, or a list of them.
        budget
            Reads time_limit (600 s).

        Returns
        -------
        PathClearance
            True if the distances are kept; else the `encounter`, the first place where two bodies
            come too near. After the time limit it is false, and has the `count` of the first
            configurations, which are clear, and the ways between them.

        Raises
        ------
        InputError
            For wrong shapes, for what is no clearance, and as `clearance`.
        UnknownNameError, MissingExtraError
            As `clearance`.

        See Also
        --------
        System.ik_path : follows targets and keeps clearances.

        Notes
        -----
        Conservative advancement (Mirtich, 1996; Schwarzer, Saha and Latombe, 2005): the distance of
        two bodies in the middle of a piece of the way, less a bound on how much nearer their points
        come within the piece, is a lower bound on all of the piece. The bound adds, over the joints
        between the bodies, the motion of the joint times the largest distance of the shape from its
        axis. Pieces for which it is not enough are halved, down to 1 / 4096 of the way between two
        configurations; where a distance stays within the bound, the answer says "not decided". So a
        path that is called clear is clear, up to rounding (about 1e-6 m) and, for systems with
        closed loops, as far as the loops stay closed on straight ways.

        Examples
        --------
        >>> import kempe
        >>> from kempe.constraints import Clearance
        >>> m = kempe.Mechanism("arm")
        >>> link = m.body("link")
        >>> m.revolute("A", m.ground, link, at=(0, 0, 1), axis="z")  # doctest: +ELLIPSIS
        Joint(...)
        >>> shape = m.shape(link, "sphere", radius=0.1, at=(1, 0, 0))
        >>> post = m.obstacle("post", "sphere", radius=0.1, at=(0, 1, 1))
        >>> arm = m.build()
        >>> found = arm.geometry.check_path([[0.0], [1.0], [2.0]], Clearance(at_least=0.02))
        >>> print(found.encounter.piece, found.encounter.part, found.encounter.pair)
        1 0.5 ('link', 'post')
        """
        from kempe.geometry.path_clearance import check_path

        return check_path(self.system, path, clearance, budget=budget)
