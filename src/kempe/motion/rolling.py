"""Motions under given input velocities, integrated in time: rolling, and closing loops.

The velocities are those of A(q) v = b(q, t), of the closed loops and of the inputs together; they
are integrated by Dormand and Prince's method of order 8 (Hairer, Norsett and Wanner, *Solving
Ordinary Differential Equations I*, 1993), and after each step the position constraints are met
again by the smallest correction. No mass is needed: inputs are velocities, not forces.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kempe.arrays import is_array, is_real
from kempe.constraints.tape import TIME, TWIST
from kempe.equations.closure import Closure
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.velocity import evaluate_velocity_rows
from kempe.errors import InputError, UnknownNameError, UnsupportedError, format_value
from kempe.forward.fk import jacobian
from kempe.model.time_coordinate import add_time_coordinate, list_timed_constraints
from kempe.numerics.clock import BROKEN_OFF, TimeLimit
from kempe.numerics.newton import run_gauss_newton
from kempe.numerics.rank import Level, Spectrum
from kempe.numerics.roots import find_sign_change
from kempe.spatial import Array, quat_wxyz_multiply, unit

if TYPE_CHECKING:
    from kempe.model.model import Model

MISS = 1e-9
"""By how much velocities may miss a row, of rows and speeds of size 1, for inputs and constraints
to agree."""
OPEN = 1e-8
"""Residual, in radians and characteristic lengths, above which a start is not closed."""
PARTS = 64
"""Steps at least."""
LOOKS = 8
"""Places within a step at which one-sided constraints are looked at."""
CORRECTIONS = 6

Input = float | Callable[[float], Any]


class RollingStop(Exception):
    """Error inside a motion that cannot go on; the text says why."""


class Rolled(NamedTuple):
    """Samples of a motion: times (n,), configurations (n, nq), velocities (n, nv).

    With the reason why it ends, if early.
    """

    t: Array
    q: Array
    v: Array
    reason: str
    broken: BaseException | None


class Velocities:
    """Velocities that constraints and inputs determine, at any configuration and time.

    Where position constraints depend on time, `system` is the clocked one: the time is a
    coordinate, whose velocity is 1 and which closing the loops does not change.
    """

    def __init__(self, system: Model, inputs: Mapping[str, Any]):
        self.inputs = {name: _check_input(name, u) for name, u in inputs.items()}
        self.rows = [_make_input_row(system, name) for name in inputs]
        self.times = bool(list_timed_constraints(system))
        self.system = add_time_coordinate(system) if self.times else system
        clock = [list(self.system.structure.velocity_names).index(TIME)] if self.times else []
        self.closure = Closure(self.system, clock, np.zeros(self.system.nq))
        self.loops = len(self.closure.weight)
        self.clock = np.eye(self.system.nv)[clock]

    def evaluate_input(self, name: str, t: float) -> float:
        """Evaluate an input at a time. Errors: `InputError`."""
        u = self.inputs[name]
        if not callable(u):
            return u
        x = u(t)
        if not is_real(x) and not (is_array(x) and x.ndim == 0):
            raise InputError(
                f"input {name!r} at time {t:g} is {format_value(x)}; it must be one number"
            )
        if not math.isfinite(float(x)):
            raise InputError(
                f"input {name!r} at time {t:g} is {format_value(x)}; it must be finite"
            )
        return float(x)

    def compute_velocities(self, q: Array, t: float) -> Array:
        """Compute the velocities (nv,).

        Errors: `RollingStop` where they are not determined, or do not exist.
        """
        scale = self.closure.unit
        A, b = evaluate_velocity_rows(self.system, q, t)
        J = (
            self.closure.compute_jacobian(q)[: self.loops]
            if self.loops
            else np.zeros((0, len(scale)))
        )
        own = q[: len(q) - len(self.clock)]
        S = np.zeros((len(self.rows), len(scale)))
        for k, row in enumerate(self.rows):
            S[k, : len(scale) - len(self.clock)] = row(own)
        u = np.array([self.evaluate_input(name, t) for name in self.inputs])
        M = np.concatenate([A * scale, J, self.clock * scale, S * scale])
        wanted = np.concatenate([b, np.zeros(len(J)), np.ones(len(self.clock)), u])
        size = np.linalg.norm(M, axis=1)
        size = np.where(size > 1e-12, size, 1.0)
        M = M / size[:, None]
        wanted = wanted / size
        spectrum = Spectrum(M, 1.0)
        loose = spectrum.compute_null_space(Level.CLOSED)
        if loose.size:
            raise RollingStop(self._describe_freedom(loose.T))
        z = spectrum.solve_least_squares(wanted, Level.CLOSED)
        off = np.abs(M @ z - wanted)
        worst = int(np.argmax(off)) if len(off) else 0
        if len(off) and off[worst] > MISS * max(1.0, float(np.abs(wanted).max())):
            raise RollingStop(self._describe_contradiction(M, wanted, size))
        return z * scale

    def _describe_freedom(self, null_space: Array) -> str:
        """Describe the coordinates that inputs do not determine."""
        names = self.system.structure.velocity_names
        moving = [n for n, x in zip(names, np.abs(null_space).max(axis=0), strict=True) if x > 1e-6]
        said = ", ".join(map(repr, moving[:6])) + ", ..." * (len(moving) > 6)
        many = len(null_space)
        given = ", ".join(map(repr, self.inputs)) or "none"
        return (
            f"the inputs ({given}) leave {many} freedom{'s' * (many != 1)} of motion, among "
            f"{said}; give {many} more (a coordinate, or a twist such as 'frame.vx' in the axes of "
            "a frame)"
        )

    def _describe_contradiction(self, M: Array, wanted: Array, size: Array) -> str:
        """Describe the input that constraints and other inputs do not allow, and by how much."""
        fixed = len(M) - len(self.inputs)
        z = Spectrum(M[:fixed]).solve_least_squares(wanted[:fixed], Level.CLOSED)
        off = np.abs(M[:fixed] @ z - wanted[:fixed])
        if fixed and off.max() > MISS * max(1.0, float(np.abs(wanted).max())):
            return (
                "the constraints contradict each other: no velocity satisfies them all (by "
                f"{off.max():.3g})"
            )
        for k, name in enumerate(self.inputs):
            some = M[: fixed + k + 1], wanted[: fixed + k + 1]
            z = Spectrum(some[0]).solve_least_squares(some[1], Level.CLOSED)
            gap = float(np.abs(some[0] @ z - some[1]).max())
            if gap > MISS * max(1.0, float(np.abs(wanted).max())):
                before = ", ".join(map(repr, list(self.inputs)[:k]))
                beside = f" beside {before}" if before else ""
                z = Spectrum(some[0][:-1]).solve_least_squares(some[1][:-1], Level.CLOSED)
                had = float(some[0][-1] @ z) * size[fixed + k]
                return (
                    f"the constraints do not allow the input {name!r} = "
                    f"{float(some[1][-1]) * size[fixed + k]:.6g}{beside}; they allow {had:.6g}"
                )
        return "constraints and inputs contradict each other"

    def compute_slope(self, t: float, q: Array) -> Array:
        """Compute the rates (nq,) of the coordinates, those of quaternions included."""
        return compute_coordinate_rates(self.system, q, self.compute_velocities(q, t))

    def close_configuration(self, q: Array, t: float) -> Array:
        """Return the configuration (nq,) nearest to q that obeys position constraints at time t."""
        layout = self.system.structure.layout
        q = q.copy()
        if self.times:
            q[-1] = t
            self.closure.targets = np.array([t])
        for i in layout.quaternion_q.tolist():
            q[i : i + 4] = unit(q[i : i + 4])
        if not self.loops:
            return q
        closure = self.closure
        return run_gauss_newton(
            closure.evaluate_equations,
            q,
            CORRECTIONS,
            level=Level.CLOSED,
            met=closure.compute_tolerance(q),
            move=closure.move_point,
        ).x


def compute_coordinate_rates(system: Model, q: Array, v: Array) -> Array:
    """Compute the rates (nq,) of coordinates, quaternions included, at velocities (nv,)."""
    layout = system.structure.layout
    out = np.zeros(len(q))
    out[layout.vector_q] = v[layout.vector_v]
    for i, k in zip(layout.quaternion_q.tolist(), layout.quaternion_v.tolist(), strict=True):
        turn = np.concatenate([[0.0], v[k : k + 3]])
        out[i : i + 4] = 0.5 * quat_wxyz_multiply(q[i : i + 4], turn)
    return out


def _check_input(name: str, u: Any) -> Input:
    """Refuse an input that is neither a finite number nor a function; return others."""
    if callable(u):
        return u
    if not is_real(u) or not math.isfinite(float(u)):
        raise InputError(
            f"input {name!r} is {format_value(u)}; it must be a finite number or a function of time"
        )
    return float(u)


def _make_input_row(system: Model, name: str) -> Callable[[Array], Array]:
    """Return the row (nv,) of an input as a function of q.

    The input is a velocity coordinate, or a twist in the axes of a frame.
    """
    names = list(system.structure.velocity_names)
    if name in names:
        row = np.eye(system.nv)[names.index(name)]
        return lambda q: row
    frame, dot, part = str(name).rpartition(".")
    if dot and part in TWIST and frame in system.frame_names:
        k = TWIST.index(part)
        return lambda q: np.asarray(jacobian(system, q, frame, "body"))[k]
    allowed = [*names, *(f"{f}.{part if part in TWIST else 'vx'}" for f in system.frame_names[1:])]
    raise UnknownNameError("velocity", name, allowed, system.name)


def integrate_rolling(
    system: Model,
    inputs: Mapping[str, Any],
    q: Array,
    times: Array,
    tolerance: float,
    budget: TimeLimit,
) -> Rolled:
    """Integrate the motion from q (nq,) at the first of the `times` (n,).

    Errors: `InputError`, `UnsupportedError`.
    """
    from scipy import integrate

    motion = Velocities(system, inputs)
    begin = float(times[0])
    system = motion.system
    if motion.times:
        q = np.append(q, begin)
    F = motion.closure.compute_residuals(q)
    gap = float(np.abs(F).max(initial=0.0))
    if not gap < OPEN:
        raise InputError(
            f"the position constraints are off by {gap:.3g} at the start (radians or "
            "characteristic lengths); assemble it first"
        )
    rows = pack_one_sided_rows(system)
    q = motion.close_configuration(q, begin)
    if (over := rows.compute_excess(q)).any():
        k = int(np.argmax(over))
        raise InputError(f"the start violates {rows.names[k]!r} by {over[k]:.6g}")
    try:
        first = motion.compute_velocities(q, begin)
    except RollingStop as stop:
        raise UnsupportedError(f"{system.name}: {stop}") from None
    out_q = [q]
    out_v = [first]
    reason = ""
    broken = None
    k = 1
    end = float(times[-1])
    most = max((end - begin) / PARTS, 1e-300)
    solver: Any = cast(Any, integrate).DOP853(
        motion.compute_slope,
        begin,
        q,
        end,
        rtol=max(tolerance, 3e-14),
        atol=tolerance,
        max_step=most,
    )
    try:
        while solver.status == "running":
            budget.check_time()
            said: Any = solver.step()
            if str(solver.status) == "failed":
                raise RollingStop(f"at time {solver.t:.6g} the velocities change too fast: {said}")
            dense = solver.dense_output()
            last = solver.t
            stop = _find_limit(system, dense, float(solver.t_old or 0.0), last)
            while k < len(times) and times[k] <= (last if stop is None else stop[0]):
                x = motion.close_configuration(dense(times[k]), float(times[k]))
                out_v.append(motion.compute_velocities(x, float(times[k])))
                out_q.append(x)
                k += 1
            if stop is not None:
                x = motion.close_configuration(dense(stop[0]), stop[0])
                out_v.append(motion.compute_velocities(x, stop[0]))
                out_q.append(x)
                times = np.append(times[:k], stop[0])
                raise RollingStop(stop[1])
            solver.y = motion.close_configuration(solver.y, float(last))
            solver.f = motion.compute_slope(last, solver.y)
    except RollingStop as stop:
        reason = str(stop)
    except BROKEN_OFF as error:
        broken = error
    # without the clock
    n = len(out_v)
    more = int(motion.times)
    q = np.array(out_q[:n])
    v = np.array(out_v)
    return Rolled(times[:n], q[:, : q.shape[1] - more], v[:, : v.shape[1] - more], reason, broken)


def _find_limit(
    system: Model, dense: Callable[[Any], Array], t0: float, t1: float
) -> tuple[float, str] | None:
    """Find the time between two times at which a limit or one-sided constraint is reached.

    Returned are the time, and words for the limit.
    """
    rows = pack_one_sided_rows(system)
    looks = np.linspace(t0, t1, LOOKS + 1)
    violated = rows.compute_excess(dense(looks[1:]).T).any(axis=1)
    if not violated.any():
        return None
    first = int(np.argmax(violated))
    a = float(looks[first])
    b = float(looks[first + 1])

    def compute_excess(t: float) -> Array:
        """Compute the excess of each row, relative to the allowed one: above 1 if violated."""
        x = rows.compute_values(dense(t))
        return np.maximum(rows.low - x, x - rows.high) / (1e-3 * rows.slack)

    stop = find_sign_change(lambda t: float(compute_excess(t).max()) - 1.0, a, b)
    stop = a if stop is None else stop
    k = int(np.argmax(compute_excess(b if stop == a else stop)))
    what = "its limit" if k >= rows.declared else "its bound"
    return stop, f"it stops at time {stop:.9g}, where {rows.names[k]!r} meets {what}"


def compute_slip(system: Model, t: Array, q: Array, v: Array) -> float:
    """Compute the largest slip of samples, by velocity rows and speeds scaled to size 1."""
    A, b = evaluate_velocity_rows(system, q, t)
    size = np.linalg.norm(A, axis=-1) * np.maximum(1.0, np.linalg.norm(v, axis=-1))[:, None]
    off = np.abs(np.einsum("nij,nj->ni", A, v) - b)
    return float((off / np.maximum(size, 1e-300)).max(initial=0.0))
