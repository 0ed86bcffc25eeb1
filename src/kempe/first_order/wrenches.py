"""Wrenches of joints and constraints: multipliers of their equations in maximal coordinates.

There each body is on its own, so that a multiplier of an equation is a force and a moment on the
bodies that it ties (Lanczos, The Variational Principles of Mechanics, 1970, chapter 2). Where the
multipliers of several equations balance each other without any load, these constraints are
redundant and statics does not determine their reactions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.arguments import explain_method_errors, numbers
from kempe.equations import closure_rows
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.velocity import record_velocity_rows
from kempe.errors import InputError, UnknownNameError
from kempe.forward.fk import fk, jacobian
from kempe.forward.maximal import maximal, maximal_q
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.words import InWords, cut_lines, join_first_words

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism
    from kempe.model.model import Model

BALANCED = 1e-8
"""Part of a load that may be left where reactions balance it."""
SHOWN = 12
"""Joints that are listed one by one."""
MOST = 600
"""Equations up to which reports list self-stresses: they take a dense decomposition."""
SMALL = 1e-9
"""Part of the largest number below which a component of a wrench is rounding."""


class _WrenchRow(NamedTuple):
    """One equation in maximal coordinates: its joint or constraint, name, unit and rates.

    `lasting` says whether the equation always holds.
    """

    of: str
    name: str
    unit: str
    lasting: bool
    rates: Array


@dataclass(frozen=True, eq=False)
class SelfStress(InWords):
    """Reactions that balance each other without a load, which statics cannot determine.

    `wrenches` (6,) are [force; moment] on the child of each joint or constraint that takes part, in
    axes of the ground, at the origin of its frame M (B of a constraint); `multipliers` are those of
    couplings and laws of coordinates.
    """

    wrenches: dict[str, Array]
    multipliers: dict[str, float]

    def __str__(self) -> str:
        parts = [f"{name}: {_format_wrench(w)}" for name, w in self.wrenches.items()]
        return "; ".join(
            cut_lines(parts + [f"{name}: {x:.4g}" for name, x in self.multipliers.items()], SHOWN)
        )


@dataclass(frozen=True, eq=False)
class Reactions(InWords):
    """Reactions that balance given loads: wrenches by joint or constraint, efforts of held inputs.

    `undetermined` names those that statics alone does not determine: any self-stress may be added
    to them.
    """

    wrenches: dict[str, Array]
    efforts: dict[str, float]
    undetermined: tuple[str, ...]

    def __str__(self) -> str:
        lines = [
            f"{name}: {_format_wrench(w)}" + " (not determined)" * (name in self.undetermined)
            for name, w in self.wrenches.items()
        ]
        return "\n".join(lines + [f"effort of {name}: {x:.6g}" for name, x in self.efforts.items()])


@explain_method_errors
@dataclass(frozen=True, eq=False)
class Wrenches:
    """The wrenches that joints and constraints can transmit at a closed configuration `q` (nq,).

    ``wrenches[name]`` (k, 6) has a basis for a joint; for a constraint one wrench for a unit
    multiplier of each of its rows, one-sided rows and those of velocity included. Each is [force;
    moment] on the child (on what has frame B), in axes of the ground, at `locate_wrench(name)`.
    """

    system: Model
    q: Array

    def __repr__(self) -> str:
        return f"Wrenches of {self.system.name!r}: {join_first_words(self.names, SHOWN)}"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the joints, constraints, couplings with several sources, and coordinate laws."""
        return tuple(dict.fromkeys(row.of for row in self._rows))

    def __getitem__(self, name: str) -> Array:
        rows = self._select_rows(name)
        own = np.stack([self._compute_wrench(name, r.rates) for r in rows])
        if name not in self.system.structure.joints:
            return own
        moves = np.stack([r.rates for r in rows])[:, self._bodies[-1][1] :]
        spectrum = Spectrum(moves)
        held = spectrum.left
        return _reduce_rows(held[:, spectrum.find_clear_rank()[0] :].T @ own)

    def locate_wrench(self, name: str) -> Array:
        """Return the point (3,) of a wrench: the origin of frame M, or of a constraint's frame B."""
        self._select_rows(name)
        return self._ends.get(name, ("", 1.0, np.zeros(3)))[2]

    def compute_generalised_forces(self, name: str) -> Array:
        """Compute generalised forces (k, nv) for a unit multiplier of each row of a constraint.

        They do no work on any velocity that the constraints allow; those of joints in the tree are
        zero.
        """
        return np.stack([r.rates for r in self._select_rows(name)]) @ self._tree_rates

    @cached_property
    def stresses(self) -> tuple[SelfStress, ...]:
        """States of self-stress, one for each redundant constraint at `q`.

        In each, the largest force is 1, or where there is none the largest moment.
        """
        if not self._balance_matrix.size or self._rank == len(self._balance_matrix):
            return ()
        states = Spectrum(self._balance_matrix).left[:, self._rank :].T
        rows = [r for r in self._rows if r.lasting]
        names = tuple(dict.fromkeys(r.of for r in rows))
        parts = [self._compute_wrench(r.of, r.rates) for r in rows]
        plain = [i for i, p in enumerate(parts) if not p.any()]
        each = np.zeros((len(names), 6, len(rows)))
        for i, (row, part) in enumerate(zip(rows, parts, strict=True)):
            each[names.index(row.of), :, i] = part * self._force_factors[i]
        scale = np.repeat([1.0, 1.0 / self._length], 3)
        both = np.hstack(
            [
                (np.einsum("nci,ki->knc", each, states) * scale).reshape(len(states), -1),
                states[:, plain],
            ]
        )
        out: list[SelfStress] = []
        forces = np.append(np.tile(np.arange(6) < 3, len(names)), np.zeros(len(plain), dtype=bool))
        for state in _reduce_rows(both, forces):
            found = state[: 6 * len(names)].reshape(-1, 6) / scale
            largest = np.abs(found[:, :3]).max() or np.abs(found).max() or 1.0
            found = found / largest
            rest = state[6 * len(names) :] / largest
            rest = {
                f"{rows[i].of} {rows[i].name}".strip(): float(x)
                for i, x in zip(plain, rest, strict=True)
                if x
            }
            out.append(
                SelfStress({n: w for n, w in zip(names, found, strict=True) if w.any()}, rest)
            )
        return tuple(out)

    def balance_loads(self, loads: Mapping[str, Any], held: Iterable[str] = ()) -> Reactions:
        """Compute the reactions that balance `loads` in statics, with coordinates `held` by motors.

        A load is [force; moment] (6,), or a force (3,), on a frame at its origin, in axes of the
        ground; in the plane [fx, fy, moment] (3,) or a force (2,). Bodies have no weight but what
        is given. Where reactions are not determined, those of least norm are given. Errors:
        `UnknownNameError`, `InputError` where nothing balances the loads, because the mechanism
        would move.
        """
        held = (held,) if isinstance(held, str) else tuple(held)
        wanted = np.zeros(self._n_velocities)
        names = self.system.structure.velocity_names
        for frame, load in loads.items():
            wanted += self._compute_load(frame, load)
        for name in held:
            if name not in names:
                raise UnknownNameError("velocity coordinate", name, names, self.system.name)
        motors = np.zeros((self._n_velocities, len(held)))
        for k, name in enumerate(held):
            motors[self._bodies[-1][1] + names.index(name), k] = 1.0
        wanted = wanted * self._scale
        motors = motors * self._scale[:, None]
        A = np.hstack([self._balance_matrix.T, motors])
        found = Spectrum(A).solve_least_squares(-wanted, Level.CLOSED)
        left = np.linalg.norm(A @ found + wanted)
        if left > BALANCED * max(np.linalg.norm(wanted), 1e-300):
            raise InputError(
                f"nothing balances the loads on {', '.join(map(repr, loads))} with "
                f"{', '.join(map(repr, held)) or 'no coordinate'} held: {self.system.name} would "
                "move; hold more"
            )
        rows = [r for r in self._rows if r.lasting]
        wrenches = {n: np.zeros(6) for n in self.names}
        for row, factor, x in zip(rows, self._force_factors, found, strict=False):
            wrenches[row.of] += x * factor * self._compute_wrench(row.of, row.rates)
        loose = {n for s in self.stresses for n in s.wrenches}
        wrenches = {
            n: np.where(np.abs(w) < SMALL * max(np.abs(w).max(), 1e-300), 0.0, w)
            for n, w in wrenches.items()
        }
        efforts = dict(zip(held, found[len(rows) :].tolist(), strict=True))
        return Reactions(wrenches, efforts, tuple(n for n in self.names if n in loose))

    def describe_stresses(self) -> list[str]:
        """Describe the states of self-stress in lines; no lines for systems of many equations."""
        if len(self._balance_matrix) > MOST:
            return []
        head = (
            "reactions in balance without a load, on the child at the origin of its M, in axes of "
            "the ground:"
        )
        return [head, *cut_lines([str(s) for s in self.stresses], SHOWN)] if self.stresses else []

    def export_stresses(self) -> list[dict[str, Any]]:
        """Return the states of self-stress as plain data; no data for systems of many equations."""
        states = self.stresses if len(self._balance_matrix) <= MOST else ()
        return [
            {
                "wrenches": {n: w.tolist() for n, w in s.wrenches.items()},
                "multipliers": s.multipliers,
            }
            for s in states
        ]

    # ---- equations in maximal coordinates

    @cached_property
    def _mechanism(self) -> Mechanism:
        """Description of the system."""
        return self.system.mechanism  # a copy

    @cached_property
    def _maximal(self) -> tuple[Model, Array]:
        """The system in maximal coordinates, and its configuration."""
        return maximal(self.system), maximal_q(self.system, self.q)

    @cached_property
    def _poses(self) -> dict[str, Array]:
        """Poses (4, 4) of the bodies in the ground frame, by name."""
        return dict(zip(self.system.body_names, fk(self.system, self.q), strict=True))

    @cached_property
    def _bodies(self) -> list[tuple[str, int]]:
        """The bodies, each with the index of its first velocity; last, '' with that of the joints."""
        m = self._mechanism
        at = 0
        out: list[tuple[str, int]] = []
        for body in self.system.body_names[1:]:
            out.append((body, at))
            at += self.system.dim if m.bodies[body].particle else 6 if self.system.dim == 3 else 3
        return [*out, ("", at)]

    @cached_property
    def _first_velocities(self) -> dict[str, int]:
        """Index of the first velocity of each body, by name."""
        return dict(self._bodies[:-1])

    @property
    def _n_velocities(self) -> int:
        """Number of velocities in maximal coordinates."""
        return self._maximal[0].nv

    @cached_property
    def _rows(self) -> tuple[_WrenchRow, ...]:
        """Equations of joints, constraints and couplings, velocity constraints, and one-sided rows."""
        M, Q = self._maximal
        packed = closure_rows.pack_full_loops(M, False)
        out: list[_WrenchRow] = []
        J = closure_rows.evaluate_constraints(M, Q, True, loops=packed)[1]
        k = 0
        for tie in packed.ties:
            name = tie.name if tie.relation is None else f"coupling of {tie.relation.of}"
            out += [
                _WrenchRow(name, row, packed.units[k + i], True, J[k + i])
                for i, row in enumerate(tie.row_names)
            ]
            k += len(tie.row_names)
        order = {
            n: i
            for i, n in enumerate((*self.system.structure.joints, *self._mechanism.constraints))
        }
        out.sort(key=lambda r: order.get(r.of, len(order)))
        rates = record_velocity_rows(M)
        A = rates.evaluate_rows(Q, np.zeros(()))[0]
        out += [
            _WrenchRow(r.of, r.name, r.unit, True, a) for r, a in zip(rates.names, A, strict=True)
        ]
        sided = pack_one_sided_rows(M)
        if sided.declared:
            n = sided.declared
            J = sided.compute_rates(Q, declared=True)[1] / self._scale / sided.scale[:n, None]
            assert sided.loops is not None
            tied: list[tuple[str, str]] = [
                (t.name, row) for t in sided.loops.ties for row in t.row_names
            ]
            chosen: list[int] = sided.chosen[:n].tolist()
            for i, which in enumerate(chosen):
                of, name = tied[which]
                out.append(_WrenchRow(of, name, sided.units[i], False, J[i]))
        return tuple(out)

    def _select_rows(self, name: str) -> list[_WrenchRow]:
        """Select the equations of a joint or constraint.

        Errors: `UnknownNameError`.
        """
        rows = [r for r in self._rows if r.of == name]
        if not rows:
            raise UnknownNameError("joint or constraint", name, self.names, self.system.name)
        return rows

    @property
    def _length(self) -> float:
        """Characteristic length, which makes lengths comparable with angles."""
        return closure_rows.pack_full_loops(self._maximal[0], True).length

    @cached_property
    def _scale(self) -> Array:
        """Units of the velocities in maximal coordinates."""
        return closure_rows.compute_coordinate_units(self._maximal[0])

    @cached_property
    def _force_factors(self) -> Array:
        """Factors from multipliers of the scaled equations to multipliers of the equations."""
        length = self._length
        return np.array(
            [1.0 / length if r.unit.startswith("m") else 1.0 for r in self._rows if r.lasting]
        )

    @cached_property
    def _balance_matrix(self) -> Array:
        """Scaled equations (m, velocities) that always hold; its left null space is balanced."""
        J = np.array([r.rates for r in self._rows if r.lasting]).reshape(-1, self._n_velocities)
        return J * self._force_factors[:, None] * self._scale

    @cached_property
    def _rank(self) -> int:
        """Rank of the equations that always hold."""
        return Spectrum(self._balance_matrix).find_clear_rank()[0]

    @cached_property
    def _tree_rates(self) -> Array:
        """Velocities (of `maximal`, nv) of bodies and joints for those of the tree's coordinates."""
        system = self.system
        out = np.zeros((self._n_velocities, self.system.nv))
        for body, at in self._bodies[:-1]:
            R = self._poses[body][:3, :3]
            J = jacobian(system, self.q, body)
            motion = np.vstack([J[:3], R.T @ J[3:]]) if system.dim == 3 else J[[0, 1, 5]]
            n = system.dim if self._mechanism.bodies[body].particle else len(motion)
            out[at : at + n] = motion[:n]
        out[self._bodies[-1][1] :] = np.eye(system.nv)
        return out

    # ---- wrenches

    def _compute_body_wrench(self, body: str, rates: Array) -> Array:
        """Compute the wrench (6,) of an equation on a body, at its origin in axes of the ground."""
        system = self.system
        at = self._first_velocities[body]
        out = np.zeros(6)
        if self._mechanism.bodies[body].particle:
            out[: system.dim] = rates[at : at + system.dim]
        elif system.dim == 2:
            out[[0, 1, 5]] = rates[at : at + 3]
        else:
            out[:3] = rates[at : at + 3]
            out[3:] = fk(system, self.q, body)[:3, :3] @ rates[at + 3 : at + 6]
        return out

    @cached_property
    def _ends(self) -> dict[str, tuple[str, float, Array]]:
        """For each joint and constraint: a body that it acts on, the sign of the wrench, its point."""
        m = self._mechanism
        ground = self.system.body_names[0]
        out: dict[str, tuple[str, float, Array]] = {}
        for of in (*m.joints.values(), *m.constraints.values()):
            if of.parent:
                given: Any = of
                M = (
                    given.X_CM.evaluate_pose(m.parameters)
                    if of.name in m.joints
                    else given.frames(m.parameters, self.system.dim)[1]
                )
                end = (of.child, 1.0) if of.child != ground else (of.parent, -1.0)
                out[of.name] = *end, (self._poses[of.child] @ M)[:3, 3]
        return out

    def _compute_wrench(self, name: str, rates: Array) -> Array:
        """Compute the wrench (6,) of an equation on a joint's or constraint's child, at its point."""
        if name not in self._ends:
            return np.zeros(6)
        body, sign, point = self._ends[name]
        out = sign * self._compute_body_wrench(body, rates)
        out[3:] += np.cross(self._poses[body][:3, 3] - point, out[:3])
        return out

    def _compute_load(self, frame: str, load: Any) -> Array:
        """Convert a load on a frame to generalised forces in maximal coordinates."""
        system = self.system
        x = numbers(load, f"load on {frame!r}")
        name = system.structure.frame_name(frame)
        body = system.structure.frames[name].body if name in system.structure.frames else name
        wrench = np.zeros(6)
        allowed = (2, 3) if system.dim == 2 else (3, 6)
        if x.ndim != 1 or len(x) not in allowed:
            raise InputError(
                f"load on {frame!r} has shape {x.shape}; needed are {allowed[0]} or {allowed[1]} "
                "numbers"
            )
        wrench[[0, 1, 5][: len(x)] if system.dim == 2 else slice(0, len(x))] = x
        out = np.zeros(self._n_velocities)
        at = self._first_velocities.get(body)
        if at is None:  # the ground carries it
            return out
        X = self._poses[body]
        wrench[3:] += np.cross(fk(system, self.q, name)[:3, 3] - X[:3, 3], wrench[:3])
        if self._mechanism.bodies[body].particle:
            out[at : at + system.dim] = wrench[: system.dim]
        elif system.dim == 2:
            out[at : at + 3] = wrench[[0, 1, 5]]
        else:
            out[at : at + 6] = *wrench[:3], *(X[:3, :3].T @ wrench[3:])
        return out


def _reduce_rows(rows: Array, first: np.ndarray | None = None) -> Array:
    """Return a basis (k, n) of the rows' space in which each row has a 1 where others have 0.

    Rounding errors are set to zero.

    The ones are in the columns `first` (n,) as far as they can be.
    """
    out = rows.copy()
    n: int = out.shape[1]
    wanted_at = np.ones(n, dtype=bool) if first is None else first
    for k in range(len(out)):
        left = np.abs(out[k:])
        wanted = np.where(wanted_at, left, 0.0)
        left = wanted if wanted.max() > BALANCED * np.abs(out).max() else left
        i, j = map(
            int, np.unravel_index(int(np.argmax(left > (1.0 - 1e-6) * left.max())), left.shape)
        )
        out[[k, k + i]] = out[[k + i, k]]
        out[k] /= out[k, j]
        others = np.arange(len(out)) != k
        out[others] -= np.outer(out[others, j], out[k])
    out[np.abs(out) < SMALL * np.abs(out).max(initial=0.0)] = 0.0
    return out


def _format_wrench(wrench: Array) -> str:
    """Format a wrench without zero parts, such as 'force (0, 0, 1), moment (0.2, 0, 0)'."""
    parts = [
        (what, part) for what, part in (("force", wrench[:3]), ("moment", wrench[3:])) if part.any()
    ]
    return (
        ", ".join(f"{what} ({', '.join(f'{x + 0.0:.4g}' for x in part)})" for what, part in parts)
        or "nothing"
    )
