"""Reasons why a target was not reached: proofs, or findings of further searches.

Proofs are lengths, and limits where all answers are known to be outside them. Else what is found by
asking again is true, and what is not found is evidence: it is said with the number of starts, and
as what may be the reason.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kempe.answers import wording
from kempe.answers.evidence import Evidence, make_evidence, make_reach_evidence
from kempe.answers.problem import Choice, Problem, select_solver
from kempe.answers.targets import Z_AXIS, explain_refused_target, make_rotations_along
from kempe.answers.wording import describe_immovable_coordinates
from kempe.arguments import quiet
from kempe.errors import UnsupportedError
from kempe.forward.fk import jacobian
from kempe.inverse.answer import Solution, SolutionRow
from kempe.inverse.chain.problem import (
    ITERATIONS,
    MOST,
    TOLERANCE,
    FrameProblem,
    measure_length_excess,
)
from kempe.inverse.chain.serial_chain import (
    Chain,
    find_chain,
    find_motion_masks,
    has_shared_coordinates,
    is_moved_by_loop,
)
from kempe.inverse.derivative import compute_derivative
from kempe.inverse.multi_start import solve_targets
from kempe.inverse.numeric import SOLVERS
from kempe.inverse.tasks import freedoms
from kempe.joints import P
from kempe.kernels.forward.table_layout import MULTIPLIER, get_row_numbers
from kempe.model.configurations import sample_configurations
from kempe.model.model import Model
from kempe.numerics.clock import TimeLimit
from kempe.numerics.length_bounds import (
    GROUND,
    compute_reach_bounds,
    list_sliding_coordinates,
)
from kempe.numerics.rank import Level, Spectrum
from kempe.poses import correct_rotations
from kempe.spatial import Array
from kempe.status import Status
from kempe.units import make_tolerance

AT_LIMIT = 1e-9
"""How near to a limit a coordinate is at it."""
NEAR_MISS = 1e-6
NEAR_TURN = 1e-2
SMALL = 1e-2
"""Errors [m, rad] of a near miss, of which it is not said that the target may be outside; length of
links [m] that are small for tolerances in metres."""
ROUNDED = 2e-3
"""Errors, in radians and parts of the chain's longest link, that rounding of published figures may
have made."""
FEW_LIMITS = 12
"""Limits up to which each is lifted in turn; of more, only those that a configuration touches."""
STARTS = 250
"""Starts of a search without some limits, which begins where the target is reached without any."""
TILTED = 1e-7
"""Angle between a pose and the plane that is not rounding [rad]."""
ROUNDING = 1e-14
"""What rounding makes of a configuration that reaches a target, in parts of its size."""


def explain_target(solution: Solution, index: tuple[int, ...]) -> str:
    """Write the sentence about one target of a solution."""
    task: FrameProblem = solution.problem
    figures = (
        solution.code,
        solution.position_error,
        solution.orientation_error,
        solution.starts,
        solution.iterations,
    )
    code, position, angle, starts, steps = (np.asarray(x)[index].item() for x in figures)
    missed = position if any(task.mask[:3]) else None, angle if any(task.mask[3:]) else None
    if code == Status.SOLVED:
        return wording.describe_reached_frame(*missed, steps, starts)
    at = solution._count_row(index)
    target = task.targets[at : at + 1]
    if code == Status.BAD_INPUT:
        return explain_refused_target(target[0], "start")
    near = wording.describe_nearest_error(*missed)
    tilt = (
        float(np.arccos(np.clip(target[0, 2, 2], -1.0, 1.0)))
        if task.system.dim == 2 and any(task.mask[3:])
        else 0.0
    )
    if code == Status.OUT_OF_REACH:
        return wording.describe_failure("", prove_beyond_lengths(task, target), near)
    if tilt > max(task.tolerance[1], TILTED):
        return wording.describe_failure("", make_evidence("tilted", angle=tilt), near)
    if code == Status.OUT_OF_TIME:
        return wording.describe_failure(
            "", wording.describe_late_search(task.time_limit, starts, task.starts), near
        )
    if position <= ROUNDING * (1.0 + float(np.linalg.norm(target[0, :3, 3]))) and angle <= ROUNDING:
        return wording.describe_failure("the tolerance is finer than rounding", near)
    why = _list_reasons(
        task, target, np.asarray(solution.q)[index][task.chain.q_index], position, angle
    )
    still = describe_immovable_coordinates(task.system, task.chain.v_index)
    return wording.describe_failure(
        wording.describe_vain_starts("reached", starts), *why, near, still
    )


def list_proofs(solution: Solution, index: tuple[int, ...]) -> tuple[Evidence, ...]:
    """List the proofs that one target of a solution has no answer."""
    task: FrameProblem = solution.problem
    at = solution._count_row(index)
    prove = {Status.OUT_OF_REACH: prove_beyond_lengths, Status.NOT_FOUND: prove_unreachable}.get(
        np.asarray(solution.code)[index]
    )
    proof = prove and prove(task, task.targets[at : at + 1])
    return (proof,) if proof else ()


def prove_beyond_lengths(task: FrameProblem, target: Array) -> Evidence | None:
    """Prove that a target (1, 4, 4) is out of reach, by the lengths of the links.

    None where they do not prove it.
    """
    if not task.mask[0]:
        return None
    off = abs(float(target[0, 2, 3])) if task.system.dim == 2 else 0.0
    place, turned = measure_length_excess(task, target)[0].tolist()
    return make_reach_evidence(
        task.system,
        place,
        turned,
        off if off > task.tolerance[0] else 0.0,
        point=task.name == "position",
        slides=list_sliding_coordinates(task.system, task.system.structure.table.at[task.frame]),
    )


def _list_reasons(
    task: FrameProblem, target: Array, q: Array, position: float, angle: float
) -> list[Evidence]:
    """List reasons why a target has no answer; q (n,) is the nearest found, with its errors."""
    span = task.chain.span
    found = (
        make_evidence("wide span", span=span.format_ratio())
        if span.wide
        else _retry_search(task, target, q)
    )
    found = found or _find_blocking_limits(task, target, q)
    if not found and (rank := _prove_overdetermined(task, target)):
        rounded = (
            suggest_tolerance(task.system, position, angle, span.largest) if rank.freedoms else None
        )
        return [rank, rounded] if rounded else [rank]
    return [found or _explain_near_miss(task, position, angle) or _explain_not_found(task)]


def _solve_target(
    task: FrameProblem, target: Array, limits: Array | None = None, near: Array | None = None
) -> Array | None:
    """Solve for a configuration (n,) that reaches a target (1, 4, 4); None where none is found.

    The first start is `near`, or else the default of the chain.
    """
    seeds = task.chain.no_seed if near is None else near.reshape(1, 1, -1)
    q, _, info = solve_targets(task, seeds, 1, limits, target)
    return q[0] if info[0, 0] == Status.SOLVED else None


def _compute_rank(task: FrameProblem, q: Array, level: float) -> int:
    """Compute the largest rank, over configurations (N, nq), of the task's rows of the Jacobian."""
    J = jacobian(task.system, q, task.frame, "body")
    J[:, 3:] = make_rotations_along(np.array(task.axis)).T @ J[:, 3:]
    J = J[:, [i for i, used in enumerate(task.mask) if used]]
    if J.shape[-1] == 0:
        return 0
    return int(Spectrum(J).compute_ranks(level).max())


def count_equations_and_freedoms(task: FrameProblem) -> tuple[int, int]:
    """Count the equations of a task, and the freedoms of the chain at random configurations."""
    system = task.system
    rows = sum(map(bool, task.mask))
    wanted = 2 * bool(any(task.mask[:3])) + bool(any(task.mask[3:])) if system.dim == 2 else rows
    return wanted, _compute_rank(task, sample_configurations(system, 0, 16), Level.GENERIC)


def _prove_overdetermined(task: FrameProblem, target: Array) -> Evidence | None:
    """Prove that a task has more equations than the chain has freedoms, from the rank."""
    equations, freedoms = count_equations_and_freedoms(task)
    if freedoms >= max(equations, 1):
        return None
    alone = None
    if freedoms and task.name in ("pose", "position_axis"):
        place = replace(
            task, name="position", axis=Z_AXIS, chain=find_chain(task.system, task.frame)
        )
        alone = _solve_target(place, target) is not None
    return make_evidence(
        "rank", equations=equations, freedoms=freedoms, frame=task.frame, position=alone
    )


def suggest_tolerance(
    system: Model, position: float, angle: float, length: float, one: bool = False
) -> Evidence | None:
    """Suggest the tolerance that accepts a target which may have been rounded.

    For tasks with more equations than freedoms; None for others.

    `position` and `angle` are the errors of the nearest found; None where these are more than
    rounding of figures, seen from a robot with links of this `length`. With `one` the tolerance is
    one number for both.
    """
    if position > ROUNDED * length or angle > ROUNDED:
        return None
    linear, angular = make_tolerance(TOLERANCE, system.unit)
    return make_evidence(
        "rounded",
        metres=_round_up_error(position, linear),
        radians=_round_up_error(angle, angular),
        one=one,
    )


def _round_up_error(error: float, usual: float) -> float:
    """Round an error up to one digit, at least the usual tolerance."""
    if error <= usual:
        return usual
    unit = 10.0 ** math.floor(math.log10(error))
    return float(f"{math.ceil(error / unit * 1.001) * unit:.0e}")


def _raise_starts(task: FrameProblem) -> FrameProblem:
    """Return the task with at least the default number of starts, and no time limit."""
    return replace(
        task,
        starts=max(MOST, task.starts),
        iterations=max(ITERATIONS, task.iterations),
        end=math.inf,
    )


def _retry_search(task: FrameProblem, target: Array, nearest: Array) -> Evidence | None:
    """Search again with other starts, and report where the first search was stuck.

    `nearest` (n,) is the configuration that it found.
    """
    if _solve_target(replace(_raise_starts(task), rng=task.rng + 1), target) is None:
        return None
    return make_evidence("more starts", singular=_is_singular(task, nearest))


def _is_singular(task: FrameProblem, q: Array) -> bool:
    """Return whether the chain has fewer freedoms at q (n,) than elsewhere."""
    full = task.chain.base[0].copy()
    full[task.chain.q_index] = q
    generic = _compute_rank(task, sample_configurations(task.system, 0, 16), Level.ROUGH)
    return _compute_rank(task, full[None], Level.ROUGH) < generic


def _find_blocking_limits(task: FrameProblem, target: Array, nearest: Array) -> Evidence | None:
    """Find the limits that block the target, or may do so, by solving without limits.

    Or that they do not, for all starts may fail where there is an answer.
    """
    chain = task.chain
    bounded = np.flatnonzero(np.isfinite(chain.limits).any(axis=0) & (chain.circular == 0))
    open_ = np.stack([np.full(len(chain.v_index), -np.inf), np.full(len(chain.v_index), np.inf)])
    many = _raise_starts(task)
    free = _solve_target(many, target, open_) if bounded.size else None
    if free is None:
        return None
    if _solve_target(replace(many, rng=task.rng + 1), target, None, free) is not None:
        return make_evidence("more starts")
    suspects = list(
        bounded
        if len(bounded) <= FEW_LIMITS
        else _find_suspect_limits(chain, bounded, nearest, free)
    )
    few = replace(
        many, starts=min(many.starts, STARTS * FEW_LIMITS // max(FEW_LIMITS, len(suspects)))
    )

    def can_solve_without(lifted: Sequence[Any]) -> bool:
        limits = chain.limits.copy()
        limits[:, lifted] = open_[:, lifted]
        return _solve_target(few, target, limits, free) is not None

    alone = [i for i in suspects if can_solve_without([i])]
    lifted = (
        suspects
        if len(suspects) < len(bounded) and not alone and can_solve_without(suspects)
        else list(bounded)
    )
    for i in [] if alone else list(lifted):  # what is left cannot be done without
        rest = [k for k in lifted if k != i]
        lifted = rest if can_solve_without(rest) else lifted
    names = [task.system.structure.velocity_names[int(chain.v_index[i])] for i in alone or lifted]
    return make_evidence(
        "limits",
        names=names,
        together=not alone,
        each=bool(alone),
        proof=prove_unreachable(task, target),
    )


def _find_suspect_limits(
    chain: Chain, bounded: np.ndarray, nearest: Array, free: Array
) -> np.ndarray:
    """Find bounded coordinates that are at a limit in `nearest`, or beyond one in `free`."""
    if len(chain.q_index) != len(chain.v_index):
        return bounded
    low, high = chain.limits
    at = (nearest <= low + AT_LIMIT) | (nearest >= high - AT_LIMIT) | (free < low) | (free > high)
    return bounded[at[bounded]]


def _explain_near_miss(task: FrameProblem, position: float, angle: float) -> Evidence | None:
    """Explain a near miss; None for larger errors."""
    if not any(task.mask[:3]) or position > NEAR_MISS or angle > NEAR_TURN:
        return None
    longest = task.chain.span.largest
    turn = angle if any(task.mask[3:]) else None
    return make_evidence(
        "near miss", place=position, turn=turn, longest=longest, small=longest <= SMALL
    )


def _explain_not_found(task: FrameProblem) -> Evidence:
    """Explain a failure without a known reason."""
    limits = bool(np.isfinite(task.chain.limits).any())
    return make_evidence(
        "not found", limits=limits, place=any(task.mask[:3]), turn=any(task.mask[3:])
    )


# ---- proof that limits keep the answers away

# All of them are known, or slides end. Both hold for chains without loops and relations. That a
# search finds nothing inside the limits proves nothing.

CLEAR = 1e-3
"""How far beyond a limit, in radians or parts of the target's distance, each answer must be: what
is nearer may be reached within the tolerance, or be rounding where two answers are near each
other."""


@quiet
def prove_unreachable(task: FrameProblem, target: Array) -> Evidence | None:
    """Prove that a target (1, 4, 4) has no answer inside the limits; None without a proof."""
    return _prove_slides_too_short(task, target) or _prove_outside_limits(task, target)


def _prove_outside_limits(task: FrameProblem, target: Array) -> Evidence | None:
    """Prove that all answers that exist without limits are outside the limits."""
    system = task.system
    chain = task.chain
    plain = np.all(
        np.abs(get_row_numbers(task.chain.ints, task.chain.floats)[:, MULTIPLIER]) == 1.0
    )
    if max(task.tolerance) > CLEAR * CLEAR or len(chain.q_index) != len(chain.v_index) or not plain:
        return None
    if is_moved_by_loop(system, task.frame) or has_shared_coordinates(system, task.frame):
        return None
    from kempe.inverse.solve_all import SINGLE, solve_by_chain

    if task.name == "position":
        goal = np.eye(4)
        goal[: system.dim, 3] = target[0, : system.dim, 3]
    else:
        goal = correct_rotations(target[0], "target")
    problem = Problem(
        system,
        "all",
        limits=False,
        options={"time": TimeLimit(SINGLE)},
        frame=task.frame,
        task=(task.name, task.axis),
        targets=goal[None],
    )
    try:
        found = solve_by_chain(problem)
    except UnsupportedError:
        return None
    if not found.complete or not len(found.q) or found.families:
        return None
    size = 1.0 + float(np.linalg.norm(target[0, :3, 3]))
    beyond = min(_measure_limit_excess(chain, q[chain.q_index]) for q in found.q)
    if not beyond > CLEAR * size:
        return None
    return make_evidence("outside", count=len(found.q))


def _measure_limit_excess(chain: Chain, q: Array) -> float:
    """Measure how far the worst coordinate is outside its limits, by any whole turns."""
    turning, sliding = find_motion_masks(chain)
    (low, high) = chain.limits
    turns = 2.0 * np.pi * (turning & ~sliding)
    above = np.maximum(q - high, 0.0)
    below = np.maximum(low - q, 0.0)
    off = above + below
    # the nearest turns on both sides of the range
    for v in np.flatnonzero((turns > 0.0) & (off > 0.0)):
        x = off[v] % turns[v]
        room = high[v] - low[v]
        off[v] = max(min(x, turns[v] - x - room), 0.0)
    return float(off.max(initial=0.0))


def _prove_slides_too_short(task: FrameProblem, target: Array) -> Evidence | None:
    """Prove that slides which nothing turns end too far from the target along a direction."""
    table = task.system.structure.table
    X = np.eye(4)
    base = GROUND
    axes: list[Array] = []
    ends: list[Array] = []
    for row in table.find_path(task.frame):
        if table.kind[row] != P:
            break
        base = (row, np.eye(4), False)
        X = X @ table.placement[row]
        axes.append(X[:3, 2])
        ends.append(table.multiplier[row] * task.system.structure.limits[table.iv[row]])
    if not axes or not task.mask[0]:
        return None
    A = np.array(axes).T
    p = target[0, :3, 3]
    rest = compute_reach_bounds(task.system, table.at[task.frame], base)[0]
    for d in np.concatenate([A.T, Spectrum(A).compute_pseudo_inverse(Level.CLOSED)]):
        d = d / max(float(np.linalg.norm(d)), 1e-300)
        part = d @ A
        used = np.abs(part) > 1e-12
        moved = part[used, None] * np.array(ends)[used]
        for bound in rest:
            if bound.point.any():
                continue
            off = float(d @ (p - X[:3, 3] - X[:3, :3] @ bound.centre))
            least = float(moved.min(axis=1).sum()) - bound.largest
            most = float(moved.max(axis=1).sum()) + bound.largest
            short = max(off - most, least - off)
            if short > task.tolerance[0] + 1e-9 * (1.0 + abs(off) + bound.largest):
                return make_evidence("outside", short=short)
    return None


# ---- the row of the answer


def describe_solver(solution: Solution) -> Choice:
    """Describe the solver that searches for answers of targets of a frame."""
    task: FrameProblem = solution.problem
    problem = Problem(task.system, "one", frame=task.frame, task=(task.name, task.axis))
    return select_solver(SOLVERS, problem)[1]


def analyse_answer(solution: Solution) -> tuple[int, int, int, Array]:
    """Compute equations m, freedoms n, rank, and a basis (nv, k) of self-motions of one answer."""
    from kempe.answers.targets import make_target_constraints
    from kempe.inverse.tasks.search import make_demands

    task: FrameProblem = solution.problem
    goals = make_target_constraints(task.frame, task.name, task.axis, task.targets[0])
    return freedoms.analyse_freedoms(make_demands(task.system, goals, solution.q)[0], solution.q)


ROW = SolutionRow(explain_target, describe_solver, list_proofs, compute_derivative, analyse_answer)
"""What `ik` says of its answers."""
