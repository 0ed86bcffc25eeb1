"""`System`: what is computed with, and the map of the library: its methods call the functions of later layers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained, known
from kempe.description.mechanism import BodyLike
from kempe.model.compiled import Compiled, FrameLike
from kempe.spatial import Array

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from kempe.analysis.classify import Classification
    from kempe.analysis.drive import Drive
    from kempe.analysis.manoeuvre_path import Manoeuvre
    from kempe.analysis.mobility import Mobility
    from kempe.analysis.path import Path as Motion
    from kempe.analysis.simulate import Simulation
    from kempe.analysis.transmission import LoopJacobian
    from kempe.budget import Budget
    from kempe.kinematics.designs import Designs
    from kempe.kinematics.forward import Query
    from kempe.kinematics.loops import SystemConstraint
    from kempe.kinematics.space import ConfigurationSpace
    from kempe.solvers.analytic.describe import Recognised
    from kempe.solvers.analytic.solutions import Solutions
    from kempe.solvers.analytic.sweep import Sweep
    from kempe.solvers.assembly import Assembler, Assembly
    from kempe.solvers.charts import Chart
    from kempe.solvers.dyads import Incomplete, Plan
    from kempe.solvers.following import IkPath
    from kempe.solvers.ideal import Idealised
    from kempe.solvers.modes import Modes
    from kempe.solvers.self_motion import SelfMotion
    from kempe.solvers.servo import IkStep
    from kempe.solvers.solution import Solution

__all__ = ["FrameLike", "System"]


class System(Compiled):
    """A multibody system, compiled from a `Mechanism`: spanning tree, loop closures, coordinates, primitive table.

    Frozen, hashable by content, picklable, safe to share between threads. A configuration `q` is an array (..., nq) in
    the order of `coordinate_names`, in radians and metres; a dict by coordinate name is accepted in its place, of a
    system with loops as what `assemble` closes. Poses are relative to body 0, the ground. What the methods take is
    explained at the functions that they name.
    """

    # ---- configurations

    @property
    def mid(self) -> Array:
        """A configuration (nq,) inside the limits: mid-range, or as near to neutral as a one-sided limit allows.

        It is read-only: `mid.copy()` is one to change.
        """
        from kempe.kinematics.configuration import mid

        return mid(self)

    def posture(self, name: str) -> Array:
        """Configuration (nq,) of a named posture; coordinates that it does not name are neutral."""
        posture = self._mechanism.postures[known("posture", name, self._mechanism.postures, self.name)]
        names = set(self.coordinate_names)
        return self.q({k: v for k, v in posture.items() if k in names})

    def random(self, rng: np.random.Generator | int | None = None, shape: int | tuple[int, ...] = ()) -> Array:
        """Configurations (*shape, nq), uniform inside the limits; free angles in (-pi, pi], free lengths in (-1, 1)."""
        from kempe.kinematics.configuration import random

        return random(self, rng, shape)

    def q(self, coordinates: Mapping[str, float], base: ArrayLike | None = None) -> Array:
        """Configuration (..., nq) from values by coordinate name; the others are neutral, or as in `base` (..., nq).

        Numbers are only written down: no loop is closed (`assemble` closes them).
        """
        from kempe.kinematics.configuration import q_from_dict

        return q_from_dict(self, coordinates, base)

    def q_dict(self, q: ArrayLike) -> dict[str, float]:
        """Values by coordinate name of one configuration (nq,)."""
        from kempe.kinematics.configuration import q_dict

        return q_dict(self, q)

    # ---- the space of configurations

    @property
    def configuration_space(self) -> ConfigurationSpace:
        """The set that `q` ranges over: its true dimension and its shape, such as T^2 x R, and the space around it."""
        from kempe.kinematics.space import configuration_space

        return configuration_space(self)

    def integrate(self, q: Any, v: ArrayLike) -> Array:
        """Configuration (..., nq) reached from `q` by the tangent vector `v` (..., nv)."""
        from kempe.kinematics.configuration import integrate

        return integrate(self, q, v)

    def difference(self, q0: Any, q1: Any) -> Array:
        """Tangent vector (..., nv) from `q0` to `q1`: ``integrate(q0, difference(q0, q1)) == q1``."""
        from kempe.kinematics.configuration import difference

        return difference(self, q0, q1)

    def interpolate(self, q0: Any, q1: Any, t: ArrayLike) -> Array:
        """Configuration (..., nq) at the fraction `t` (...) of the straight way from `q0` to `q1`."""
        from kempe.kinematics.configuration import interpolate

        return interpolate(self, q0, q1, t)

    def distance(self, q0: Any, q1: Any) -> Array:
        """Length (...) of the shortest way from `q0` to `q1`; unlimited joints turn the short way."""
        from kempe.kinematics.configuration import distance

        return distance(self, q0, q1)

    # ---- where everything is

    def fk(
        self, q: Any, frame: FrameLike | list | tuple | None = None, out: Array | None = None,
        threads: int | None = None,
    ) -> Array:  # fmt: skip
        """Poses in the ground frame: (..., 4, 4) of one frame, (..., k, 4, 4) of several or of all bodies (None)."""
        query = self._queries.get(frame) if frame.__class__ is str else None
        if query is not None and q.__class__ is np.ndarray:  # the import below alone would double the time
            return query(None, q, out, threads)
        from kempe.kinematics.forward import fk

        return fk(self, q, frame, out, threads)

    def jacobian(self, q: Any, frame: FrameLike, in_frame: str = "world_aligned", threads: int | None = None) -> Array:
        """Jacobian (..., 6, nv), rows [linear; angular], of a frame; see `kempe.kinematics.forward.jacobian`."""
        query = self._queries.get(frame) if frame.__class__ is str else None
        if query is not None and q.__class__ is np.ndarray:
            return query.jacobian(q, in_frame, None, threads)
        from kempe.kinematics.forward import jacobian

        return jacobian(self, q, frame, in_frame, threads)

    def query(self, frame: FrameLike) -> Query:
        """The forward model of one frame with everything looked up: ``f(q, out=None)`` and ``f.jacobian(q)``."""
        from kempe.kinematics.forward import query

        return query(self, frame)

    def symbolic_fk(self, frame: FrameLike, *, symbols: Mapping[str, Any] | None = None, snap: float = 0.0) -> Any:
        """The forward model in symbols (sympy Matrix 4x4); see `kempe.kinematics.symbolic.symbolic_fk`."""
        from kempe.kinematics.symbolic import symbolic_fk

        return symbolic_fk(self, frame, symbols=symbols, snap=snap)

    def closure_error(self, q: Any) -> Array:
        """How far each loop is open (..., len(closures), 6): the twist [m; rad] missing in each left-out joint."""
        from kempe.kinematics.constraints import closure_error

        return closure_error(self, q)

    @explained
    def ik(
        self, target: Any, frame: FrameLike | None = None, start: Any = None, *,
        task: str | tuple[str, ArrayLike] | None = None, prefer: Any = None, method: str | None = None,
        tolerance: float | tuple[float, float] | None = None, budget: Budget | None = None,
    ) -> Solution:  # fmt: skip
        """A configuration that reaches a target or holds tasks; see `solvers.inverse.ik` and `solvers.tasks.reach`."""
        if frame.__class__ is str and prefer is method is tolerance is budget and target.__class__ is np.ndarray:
            bound = self._queries.get((frame, task if task is None else str(task), target.ndim))
            if bound is not None and budget is None and (answer := bound(target, start)) is not None:
                return answer
        from kempe.solvers.inverse import ik

        return ik(self, target, frame, start, task=task, prefer=prefer, method=method, tolerance=tolerance,
                  budget=budget)  # fmt: skip

    @explained
    def ik_all(
        self, target: Any, frame: FrameLike, start: Any = None, *, task: str | tuple[str, ArrayLike] | None = None,
        fixed: Mapping[str, Any] | None = None, limits: bool | str = False, tolerance: float | None = None,
        budget: Budget | None = None,
    ) -> Solutions | Modes:  # fmt: skip
        """Every configuration in which the frame reaches the target; see `kempe.solvers.analytic.ik_all.ik_all`."""
        plain = frame.__class__ is str and start is task is fixed is tolerance is budget is None and not limits
        if plain and target.__class__ is np.ndarray and target.shape == (4, 4):
            bound = self._queries.get((frame,))
            if bound is not None and (answer := bound(target)) is not None:
                return answer
        from kempe.solvers.analytic.ik_all import ik_all

        return ik_all(self, target, frame, start, task=task, fixed=fixed, limits=limits, tolerance=tolerance,
                      budget=budget)  # fmt: skip

    @explained
    def ik_plan(
        self, frame: FrameLike, task: str | tuple[str, ArrayLike] | None = None, fixed: Iterable[str] = ()
    ) -> Recognised:
        """What is recognised of a frame's chain, and how `ik_all` solves it; see `kempe.solvers.analytic.describe`."""
        from kempe.solvers.analytic.describe import ik_plan

        return ik_plan(self, frame, task, fixed)

    @explained
    def ik_sweep(
        self, target: ArrayLike, frame: FrameLike, parameter: str | tuple[str, ArrayLike] | None = None, *,
        n: int | None = None, task: str | tuple[str, ArrayLike] | None = None, start: Any = None,
        fixed: Mapping[str, Any] | None = None, budget: Budget | None = None,
    ) -> Sweep:  # fmt: skip
        """The solutions of a redundant chain along one parameter; see `kempe.solvers.analytic.redundancy.ik_sweep`."""
        from kempe.solvers.analytic.redundancy import ik_sweep

        return ik_sweep(self, target, frame, parameter, n=n, task=task, start=start, fixed=fixed, budget=budget)

    @explained
    def ik_path(
        self, targets: Any, frame: FrameLike | None = None, start: Any = None, *, max_step: float = 0.5,
        restart: bool = False, branches: bool = False, tolerance: float | tuple[float, float] | None = None,
        budget: Budget | None = None,
    ) -> IkPath:  # fmt: skip
        """Configurations that follow a sequence of targets without a jump; see `kempe.solvers.following.ik_path`."""
        from kempe.solvers.following import ik_path

        return ik_path(self, targets, frame, start, max_step=max_step, restart=restart, branches=branches,
                       tolerance=tolerance, budget=budget)  # fmt: skip

    @explained
    def ik_step(
        self, q: Any, wanted: Any, frame: FrameLike | None = None, dt: float = 0.0, *, velocity_limits: Any = None,
        damping: float = 0.05, keep_direction: bool = False, weights: Any = None,
    ) -> IkStep:  # fmt: skip
        """Velocities for a frame's twist or for tasks, within all limits; see `kempe.solvers.servo.ik_step`."""
        from kempe.solvers.servo import ik_step

        return ik_step(self, q, wanted, frame, dt, velocity_limits=velocity_limits, damping=damping,
                       keep_direction=keep_direction, weights=weights)  # fmt: skip

    @explained
    def self_motion(
        self, q: Any, tasks: Any, *, task: str | tuple[str, ArrayLike] | None = None, direction: Any = None,
        budget: Budget | None = None,
    ) -> SelfMotion:  # fmt: skip
        """The configurations reached from q while a frame or tasks stay; see `kempe.solvers.self_motion`."""
        from kempe.solvers.self_motion import self_motion

        return self_motion(self, q, tasks, task=task, direction=direction, budget=budget)

    def arm_angle(self, q: Any, frame: FrameLike, reference: ArrayLike | None = None) -> Any:
        """Arm angle (...) of seven joints with spherical shoulder and wrist; see `kempe.solvers.analytic.arm_angle`."""
        from kempe.solvers.analytic.arm_angle import arm_angle

        return arm_angle(self, q, frame, reference)

    # ---- closed loops

    @explained
    def assemble(
        self, known: Mapping[str, Any] | None = None, start: Any = None, *, branch: str | None = None,
        prefer: str | None = None, limits: bool = True, also: Any = (), tolerance: float | str | None = None,
        budget: Budget | None = None,
    ) -> Assembly:  # fmt: skip
        """A configuration that closes all loops, with the `known` given; see `kempe.solvers.assembly.assemble`."""
        from kempe.solvers.assembly import assemble

        return assemble(self, known, start, branch=branch, prefer=prefer, limits=limits, also=also, tolerance=tolerance,
                        budget=budget)  # fmt: skip

    @property
    def tolerance(self) -> float | str | None:
        """What its dimensions may be off by, in metres and radians; None: nothing but rounding."""
        return self._mechanism.tolerance

    def idealised(self, tolerance: float | str | None = "measured") -> Idealised | None:
        """The nearest system that closes exactly and moves, with what differs; see `kempe.solvers.ideal`."""
        from kempe.solvers.ideal import idealised

        return idealised(self, tolerance)

    def assembler(self, known: Iterable[str] = ()) -> Assembler:
        """The bound form of `assemble`: names looked up once; see `kempe.solvers.assembly.Assembler`."""
        from kempe.solvers.assembly import assembler

        return assembler(self, known)

    @explained
    def assembly_modes(
        self, known: Mapping[str, Any] | None = None, start: Any = None, *, limits: bool = True,
        frame: FrameLike | None = None, tolerance: float | str | None = None, budget: Budget | None = None,
    ) -> Modes:  # fmt: skip
        """All configurations found that close the loops with the `known` given; see `kempe.solvers.modes`."""
        from kempe.solvers.modes import assembly_modes

        return assembly_modes(self, known, start, limits=limits, frame=frame, tolerance=tolerance, budget=budget)

    def closed_form(self, known: Sequence[str]) -> Plan | Incomplete:
        """The closed form of a planar system of dyads for these known coordinates; see `kempe.solvers.dyads`."""
        from kempe.solvers.dyads import closed_form

        return closed_form(self, known)

    @explained
    def independent(
        self, q: Any = None, prefer: Iterable[str] = (), *, tolerance: float | str | None = None
    ) -> Chart:  # fmt: skip
        """Which coordinates can be set at a closed q, so that the others follow; see `kempe.solvers.charts`."""
        from kempe.solvers.charts import independent

        return independent(self, q, prefer, tolerance=tolerance)

    def constraints(self) -> list[SystemConstraint]:
        """The constraints of the system: closures, declared ones, relations; see `kempe.kinematics.loops`."""
        from kempe.kinematics.loops import of_system

        return of_system(self)

    @property
    def maximal(self) -> System:
        """The system with each body on a free joint and all its joints cut; see `kempe.kinematics.maximal.maximal`."""
        from kempe.kinematics.maximal import maximal

        return maximal(self)

    def to_maximal(self, q: Any) -> Array:
        """Poses (..., n_b, 4, 4) of all bodies but the ground, the maximal coordinates."""
        from kempe.kinematics.maximal import to_maximal

        return to_maximal(self, q)

    @explained
    def from_maximal(self, poses: ArrayLike, start: Any = None, tolerance: float | None = None) -> Array:
        """Configuration (..., nq) from the poses (..., n_b, 4, 4) of all bodies; see `kempe.solvers.poses`."""
        from kempe.solvers.poses import from_maximal

        return from_maximal(self, poses, start, tolerance)

    # ---- degrees of freedom and motion

    @explained
    def mobility(
        self, q: Any = None, actuated: Iterable[str] | None = None, *, local: bool = True,
        rng: np.random.Generator | int = 0, tolerance: float | str | None = None,
    ) -> Mobility:  # fmt: skip
        """Degrees of freedom by counting, by rank and truly, with the reasoning; see `kempe.analysis.mobility`."""
        from kempe.analysis.mobility import mobility

        return mobility(self, q, actuated, local=local, rng=rng, tolerance=tolerance)

    def classify(
        self, q: Any = None, *, t: float = 0.0, project: bool = False, rng: np.random.Generator | int = 0,
        tolerance: float | str | None = None,
    ) -> Classification:  # fmt: skip
        """Which kind each constraint is, and how far free velocities reach; see `kempe.analysis.classify`."""
        from kempe.analysis.classify import classify

        return classify(self, q, t=t, project=project, rng=rng, tolerance=tolerance)

    @explained
    def trace(
        self, driver: str | None = None, start: Any = None, *, hold: Mapping[str, float] | None = None,
        toward: Mapping[str, float] | None = None, ways: str = "both", limits: bool = True,
        tolerance: float | str | None = None, budget: Budget | None = None,
    ) -> Motion:  # fmt: skip
        """The whole branch of a mechanism with one freedom, as a `Path`; see `kempe.analysis.motion.trace`."""
        from kempe.analysis.motion import trace

        return trace(self, driver, start, hold=hold, toward=toward, ways=ways, limits=limits, tolerance=tolerance,
                     budget=budget)  # fmt: skip

    @explained
    def drive(
        self, inputs: Mapping[str, Any], times: Any = None, start: Any = None, *,
        hold: Mapping[str, float] | None = None, toward: Mapping[str, float] | None = None, limits: bool = True,
        tolerance: float | str | None = None, budget: Budget | None = None,
    ) -> Drive:  # fmt: skip
        """The continuous motion that follows prescribed inputs; see `kempe.analysis.drive.drive`."""
        from kempe.analysis.drive import drive

        return drive(self, inputs, times, start, hold=hold, toward=toward, limits=limits, tolerance=tolerance,
                     budget=budget)  # fmt: skip

    @explained
    def manoeuvre(
        self, start: Any, goal: Any, *, radius: float | None = None, free: Iterable[str] = (),
        budget: Budget | None = None,
    ) -> Manoeuvre:  # fmt: skip
        """A way between configurations of what rolls, without slipping; see `kempe.analysis.manoeuvre`."""
        from kempe.analysis.manoeuvre import manoeuvre

        return manoeuvre(self, start, goal, radius=radius, free=free, budget=budget)

    @explained
    def simulate(
        self, duration: float, start: Any = None, *, inputs: Mapping[str, Any] | None = None, velocity: Any = None,
        acceleration: Any = None, restitution: float = 1.0, tolerance: float | None = None,
        budget: Budget | None = None,
    ) -> Simulation:  # fmt: skip
        """The motion under input velocities, or of a ball that falls and bounces; see `kempe.analysis.simulate`."""
        from kempe.analysis.simulate import simulate

        return simulate(self, duration, start, inputs=inputs, velocity=velocity, acceleration=acceleration,
                        restitution=restitution, tolerance=tolerance, budget=budget)  # fmt: skip

    @explained
    def loop_jacobian(
        self, q: Any, inputs: Sequence[str], outputs: Sequence[str], in_frame: str = "world_aligned", *,
        tolerance: float | str | None = None,
    ) -> LoopJacobian:  # fmt: skip
        """Velocities of joints or frames by those of inputs, through the loops; see `kempe.analysis.transmission`."""
        from kempe.analysis.transmission import loop_jacobian

        return loop_jacobian(self, q, inputs, outputs, in_frame, tolerance=tolerance)

    @explained
    def mechanical_advantage(
        self, q: Any, input: str, output: str, direction: ArrayLike | None = None, still: Sequence[str] = ()
    ) -> Any:
        """Force at the output per force at the input, at closed q (..., nq); see `kempe.analysis.transmission`."""
        from kempe.analysis.transmission import mechanical_advantage

        return mechanical_advantage(self, q, input, output, direction, still)

    @explained
    def transmission_angle(self, q: Any, joint: str, coupler: str | None = None, output: str | None = None) -> Any:
        """Angle (...) between coupler and output link at their joint; see `kempe.analysis.transmission`."""
        from kempe.analysis.transmission import transmission_angle

        return transmission_angle(self, q, joint, coupler, output)

    @explained
    def plot(
        self, q: Any = None, *, path: Any = None, frames: Iterable[Any] | None = (), labels: bool = True,
        ax: Axes | None = None, ghosts: int = 0,
    ) -> Axes:  # fmt: skip
        """Matplotlib axes with a drawing of the system; see `kempe.views.plots.plot`."""
        from kempe.views.plots import plot

        return plot(self, q, path=path, frames=frames, labels=labels, ax=ax, ghosts=ghosts)

    # ---- other systems from this one

    def with_parameters(self, **numbers: Any) -> System | Designs:
        """The same system with other parameter values; arrays of values give a batch of designs."""
        from kempe.kinematics.designs import with_parameters

        return with_parameters(self, numbers)

    def with_limits(self, limits: Any = None, velocity: Any = None) -> System:
        """The same system with other limits, by coordinate name; see `kempe.kinematics.limits.with_limits`."""
        from kempe.kinematics.limits import with_limits

        return with_limits(self, limits, velocity)

    def lock(self, coordinates: Mapping[str, float]) -> System:
        """The same system with some coordinates held at values: they leave `q`."""
        return System(self.mechanism.lock(coordinates))

    def subchain(self, base: BodyLike, tip: FrameLike) -> System:
        """The bodies and joints between `base`, the new ground, and `tip`."""
        return System(self._mechanism.subchain(base, str(tip)))

    def save(self, path: str | Path) -> Path:
        """Write the description to a file: .toml holds everything, .urdf what URDF can express; returns the path."""
        return self._mechanism.save(path)
