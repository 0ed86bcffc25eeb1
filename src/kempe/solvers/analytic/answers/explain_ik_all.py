"""What there is to say about a target: how many solutions, why these are all, or why there are none."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from kempe import spatial, words
from kempe.kernels.base.search_layout import LARGEST
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.closed_form.analytic_layout import AT_REST, COUPLED, PLANE, POINT, X_FIRST
from kempe.kernels.forward.table_layout import SLIDE
from kempe.model.immovable import immovable
from kempe.solvers.analytic.answers.explain_held import (
    held_at,
    more_than_enough,
    moved_sentence,
    number,
    spare_joints,
    tried_sentence,
)
from kempe.solvers.analytic.answers.families import EXACT, Family
from kempe.solvers.analytic.answers.nearest import aim_of, fixed_joints, held_coordinates, nearest
from kempe.solvers.analytic.plans.plan import Plan, carried_lines, free_lines
from kempe.solvers.analytic.plans.plan import freedoms as rank_of
from kempe.solvers.analytic.plans.structure import Axes, Way
from kempe.solvers.common.proofs import Lengths, by_lengths
from kempe.solvers.common.serial_chain import chain_of
from kempe.solvers.common.targets import not_a_pose
from kempe.solvers.one_frame.explain_ik import rounded
from kempe.spatial import Array
from kempe.words import in_words, joined

if TYPE_CHECKING:
    from kempe.solvers.analytic.answers.solutions import Solutions

BEYOND = 1e-8
"""How far (lengths of the chain, cosines) an equation must be from having a root, to be named as the reason."""

CANNOT = "this target is not among those it can reach"
"""End of the sentence on targets with more equations than freedoms."""

REACHED = 2e-6
"""Error [m, rad] below which a search, which stops there, has found a solution."""

CONSTANT = 1e-9
"""Factor of an unknown below which an equation does not depend on it."""

CONDITION, PERTURBED = 1e-6, 0.1
"""A joint that rests is a condition of a family if moving it by PERTURBED makes this singular value of the joints that
move larger."""

AT_ZERO = 1e-7
"""Angle [rad] below which a joint that rests is at zero: merged roots are known to the root of rounding."""

NO_ROOT = {
    "closed": "the equations of the closed form have no real root", "elimination": "no real root among 16",
    "search": "not found; no closed form applies",
}  # fmt: skip
"""What is said of a method that found nothing."""


def status(solutions: Solutions, index: int) -> str:
    """The sentence for target number `index`: how many solutions and why these are all, or why there are none."""
    if solutions._counts[index, 0] < 0:
        return not_a_pose(solutions.question.targets[index])
    if solutions._used[index].any():
        return _reached(solutions, index)
    size = float(np.abs(solutions.question.targets[index]).max())
    if size >= LARGEST:
        return f"no solution: the target has an entry of {size:.3g}; allowed are numbers below {LARGEST:g}"
    _, position, angle = nearest(solutions, index)
    question, plan = solutions.question, solutions.plan
    spare, miss = spare_joints(plan), math.hypot(position, angle)
    why, proven = _why(solutions, index)
    text = f"no solution: {why}" if not spare or proven else f"no solution{tried_sentence(solutions, index, spare)}"
    if miss <= REACHED:
        near = f"a configuration within {miss:.1g} of the target: see nearest()"
        return f"{text.split(':')[0]} within {question.tolerance:.1g}, but {near}"
    missed = [] if question.task in ("orientation", "direction") else [f"{position:.6g} m"]
    missed += [] if question.task == "position" else [f"{angle:.2g} rad"]
    if why.endswith(CANNOT):
        text += rounded(position, angle, chain_of(solutions.system, question.frame).span.largest, one=True)
    limits = " inside the limits" if np.isfinite(plan.lines.limits).any() else ""
    return f"{text}; the closest configuration found{limits} misses it by {', '.join(missed)}"


# ---- reached


def _reached(solutions: Solutions, index: int) -> str:
    """What was found."""
    plan = solutions.plan
    spare = spare_joints(plan)
    deficient = bool(spare) and not more_than_enough(plan)
    unknown: tuple[list[Family], np.ndarray] = ([], np.full(solutions._used.shape[1], -1))
    families, member = unknown if spare and not deficient else solutions._families[index]
    alone = solutions._used[index] & (member < 0)
    code = solutions._code[index]
    inside, k = int((code[alone] % 2).sum()), int(alone.sum())
    text = f"{k} solution{'' if k == 1 else 's'}"
    if k == 0:
        text = "no isolated solution"
    elif plan.method == "elimination":
        text += " by elimination"
    text += _completeness(plan, k, bool(solutions._counts[index, 1]), bool(spare))
    text += _merged(code[alone])
    if inside < k:
        text += f", {inside or 'none'} inside the limits"
    if k and not inside and not families:
        text += _beyond(solutions, index, alone)
    if families:
        text += f", and {_families(families)}"
    elif plan.method == "closed":
        text += f": {_ground(plan)}"
    if spare and not (deficient and k == 0):
        text += f"; the chain has {in_words(len(spare), 'joint')} to spare: {held_at(solutions, index, spare)}"
        text += moved_sentence(solutions, index, inside)
    return text


def _completeness(plan: Plan, k: int, doubt: bool, spare: bool) -> str:
    if k == 0:
        return ""
    if doubt:
        return " found, there may be more"
    if spare:
        return " for what is held"
    if plan.method == "closed":
        return ", all of them" if k > 1 else ", the only one"
    return ", all there are" if plan.method == "elimination" else " found, there may be more"


def _merged(code: np.ndarray) -> str:
    """Which of the solutions are roots that have merged."""
    times = code // int(A.MULTIPLICITY_UNIT)
    merged = times[times > 1]
    if not len(merged):
        return ""
    words = {2: "double", 3: "triple"}
    kind = words.get(int(merged[0]), "multiple") if len(set(merged.tolist())) == 1 else "multiple"
    if len(code) == 1:
        return f" (a {kind} root)"
    return f", {len(merged)} of them {'a ' if len(merged) == 1 else ''}{kind} root{'' if len(merged) == 1 else 's'}"


def _families(families: list[Family]) -> str:
    """The families, those of one description together."""
    texts = [(in_words(f.dimension, "freedom"), family_motion(f)) for f in families]
    out = []
    for freedoms, moves in dict.fromkeys(texts):
        k = texts.count((freedoms, moves))
        out.append(f"{'a family' if k == 1 else f'{k} families'} with {freedoms}{'' if k == 1 else ' each'}: {moves}")
    return "; ".join(out)


def _ground(plan: Plan) -> str:
    """Why there is a closed form."""
    way, n = plan.way, len(plan.lines)
    if way is None:
        return "closed form"
    inner = sorted(way.order[way.inner : way.inner + 3])
    if inner[-1] >= n or np.any(plan.lines.kinds[inner] == SLIDE):
        return "closed form"
    axes = ", ".join(str(i + 1) for i in inner)
    return f"axes {axes} {'meet in a point' if way.what == POINT else 'are parallel'} (closed form)"


def _beyond(solutions: Solutions, index: int, alone: np.ndarray) -> str:
    """Which limit the solution violates that is the least beyond its limits."""
    lines = solutions.plan.lines
    q = solutions._rows[index, alone, : len(lines)]
    over = np.maximum(q - lines.limits[1], lines.limits[0] - q)
    row = over[int(np.argmin(over.max(axis=1)))]
    worst = int(np.argmax(row))
    unit = "m" if lines.kinds[worst] == SLIDE else "rad"
    names = solutions.system.structure.velocity_names
    still = immovable(solutions.system, [i for i, name in enumerate(names) if name in lines.names])
    far = f"the nearest to them has {lines.names[worst]!r} {row[worst]:.6g} {unit} beyond its limit"
    return f" ({far}{f'; {still}' if still else ''})"


# ---- not reached


def _why(solutions: Solutions, index: int) -> tuple[str, bool]:
    """What is to be said of a target without solutions, and whether it holds wherever spare joints are held."""
    question, plan, system = solutions.question, solutions.plan, solutions.system
    target, tolerance = question.targets[index : index + 1], question.tolerance
    reasons = []
    if question.task not in ("orientation", "direction"):
        if system.dim == 2 and abs(target[0, 2, 3]) > tolerance:
            return words.off_plane(abs(target[0, 2, 3])), True
        bounds = chain_of(system, question.frame).bounds
        far = Lengths(float(by_lengths(bounds, target, (tolerance, tolerance), False)[0, 0]))
        reasons += [far.text] if far else []
    proven = bool(reasons)
    wide = plan.lines.span.wide
    failed = "" if wide or spare_joints(plan) or plan.method != "closed" else _without_root(solutions, index)
    reasons += [failed] if failed else []
    if reasons:
        return "; ".join(reasons), proven
    over = _overdetermined(solutions)
    if wide and not over:
        return plan.lines.span.sentence(), True
    return over or NO_ROOT[plan.method], bool(over)


def _overdetermined(solutions: Solutions) -> str:
    """Whether the task asks for more than the chain can do anywhere."""
    plan, planar = solutions.plan, solutions.system.dim == 2
    unknown = [i for i in range(len(plan.lines)) if i not in fixed_joints(plan)]
    free = free_lines(plan.lines, plan.task, planar)
    full = 3 if planar else 6
    rank = rank_of(plan.lines, free, unknown)
    if rank >= full:
        return ""
    equations, held = full - len(free.kinds), " to move" if fixed_joints(plan) else ""
    able = rank - len(free.kinds)
    few = f", which give it {in_words(able, 'freedom')}" if able < len(unknown) else ""
    return (f"the chain has {len(unknown)} joint{'' if len(unknown) == 1 else 's'}{held}{few}, the task {equations} "
            f"equations: {CANNOT}")  # fmt: skip


def _without_root(solutions: Solutions, index: int) -> str:
    """The equation of a closed form that has no root, in words; '' where there is none of one unknown."""
    plan, way = solutions.plan, solutions.plan.way
    if way is None or way.mode in (AT_REST, COUPLED):
        return ""
    terms = _terms(solutions, index, way)
    slides = np.concatenate([plan.lines.kinds, plan.extra.kinds]) == SLIDE
    first, second = (0, 1) if way.mode == X_FIRST else (1, 0)
    joint = [way.order[(way.inner + 3) % 6], way.order[(way.inner + 5) % 6]]
    measures = way.measure, 1 - way.measure
    # the other joint does not appear in the first measure: its constant is what is wanted
    t, wanted = terms[first, measures[0]], terms[second, measures[0], 0]
    roots = _roots(t, wanted, bool(slides[joint[first]]))
    if not len(roots):
        return _named(solutions, way, joint[first], measures[0], t, wanted)
    texts = []
    for f, g in roots:
        if math.isnan(f):
            return ""
        known = terms[first, measures[1]] @ (1.0, f, g)
        t = terms[second, measures[1]]
        if len(_roots(t, known, bool(slides[joint[second]]))):
            return ""
        texts.append((_range(t, known)[0], _named(solutions, way, joint[second], measures[1], t, known)))
    return min(texts)[1]


def _terms(solutions: Solutions, index: int, way: Way) -> Array:
    """Constant and factors (2, 2, 3) of joints x and z in both measures, see `kernels.outer`."""
    from kempe.kernels.compiled import candidates

    plan, aim = solutions.plan, aim_of(solutions, index)
    theta = plan.lines.theta(held_coordinates(solutions, index))
    axes, shift = carried_lines(plan.lines, plan.locked, plan.extra, theta)
    order = list(way.order)
    six = Axes(axes.kinds[order], axes.h[order], axes.o[order])
    goal = np.ascontiguousarray((aim.target @ spatial.inverse(plan.lines.tip) @ spatial.inverse(shift))[:3]).ravel()
    out = np.empty(12)
    candidates.outer_terms(six.kinds, six.packed(), goal, way.inner, way.what, way.option, out)
    return out.reshape(2, 2, 3)


def _range(t: Array, wanted: float) -> tuple[float, float, float]:
    """How far a turn's t0 + t1 cos + t2 sin stays from a value, and the least and the largest that it reaches."""
    size = math.hypot(t[1], t[2])
    return max(t[0] - size - wanted, wanted - t[0] - size, 0.0), t[0] - size, t[0] + size


def _roots(t: Array, wanted: float, slides: bool) -> list[tuple[float, float]]:
    """Solutions (f, g) of t0 + t1 f + t2 g = wanted: f, g are cosine and sine of a turn, d and d^2 of a slide.

    NaN where any value solves it.
    """
    k = wanted - t[0]
    if slides:
        if abs(t[2]) <= CONSTANT:
            return [(k / t[1], (k / t[1]) ** 2)] if abs(t[1]) > CONSTANT else [(math.nan, math.nan)]
        d = np.roots([t[2], t[1], -k])
        return [(float(x.real), float(x.real) ** 2) for x in d if abs(x.imag) < 1e-6]
    size = math.hypot(t[1], t[2])
    if abs(k) > size + BEYOND:
        return []
    if size <= CONSTANT:
        return [(math.nan, math.nan)]
    middle, half = math.atan2(t[2], t[1]), math.acos(min(1.0, max(-1.0, k / size)))
    return [(math.cos(middle + s * half), math.sin(middle + s * half)) for s in (1.0, -1.0)]


def _named(solutions: Solutions, way: Way, joint: int, measure: int, t: Array, wanted: float) -> str:
    """That a joint cannot bring what the inner joints keep to where the target wants it; '' for joints of nobody."""
    plan = solutions.plan
    n, length = len(plan.lines), plan.lines.length
    if joint >= n or plan.lines.kinds[joint] == SLIDE:
        return ""
    _, low, high = _range(t, wanted)
    inner = sorted(i for i in way.order[way.inner : way.inner + 3] if i < n)
    axes = f"{'axis' if len(inner) == 1 else 'axes'} {', '.join(str(i + 1) for i in inner)}" if inner else "the tip"
    middle = way.order[(way.inner + 4) % 6]
    turning = middle >= n and plan.extra.kinds[middle - n] != SLIDE or middle < n and plan.lines.kinds[middle] != SLIDE
    name = plan.lines.names[joint]
    if way.what == PLANE:
        if measure == 0 and turning:
            edge = low if wanted < low else high
            off = abs(math.acos(min(1.0, max(-1.0, wanted))) - math.acos(min(1.0, max(-1.0, edge))))
            return f"no angle of {name!r} gives {axes} the direction that is needed: {off:.2g} rad off"
        return f"no angle of {name!r} brings {axes} to where the target needs it"
    what = ("the tip", f"a point of {axes}", f"the point where {axes} meet")[min(len(inner), 2)]
    if measure == 1 and turning:
        far = wanted > high
        off = abs(math.sqrt(max(wanted, 0.0)) - math.sqrt(max(high if far else low, 0.0))) * length
        return f"no angle of {name!r} brings {what} to its distance: {off:.6g} m too {'far' if far else 'near'}"
    off = max(low - wanted, wanted - high) * length
    return f"no angle of {name!r} brings {what} to its height: {off:.6g} m off"


# ---- families


def family_sentence(family: Family) -> str:
    """What moves in a family, how, and with how many freedoms."""
    return f"{family_motion(family)}: {in_words(family.dimension, 'freedom')}"


def family_motion(family: Family) -> str:
    """What moves in a family, and how."""
    text = _moving(family)
    return text if family.residual <= EXACT else f"{text} (on target within {family.residual:.1g})"


def _moving(family: Family) -> str:
    names = list(family.joints)
    if family.dimension > 1:
        return f"{joined(names)} can move"
    equations = family.equations
    if equations is not None:
        parts = [_equation(e) for e in equations] or [f"{names[0]} is free"]
        rest = [f"{n} = {number(x)}" for n, x in _conditions(family)]
        return joined(parts) + (f" while {joined(rest)}" if rest else "")
    if family.parameter is not None and family.closed:
        others = [n for n in names if n != family.parameter]
        return f"{family.parameter} turns all the way round and {joined(others)} follow"
    lines = family._motion.aim.lines
    first = family.parameter or names[0]
    x = family.q[:, lines.q_index[lines.names.index(first)]]
    how = "on a closed curve" if family.closed else "on a curve that does not close"
    return f"{joined(names)} move together {how}, {first} from {number(x.min())} to {number(x.max())}"


def _equation(terms: dict[str, float]) -> str:
    text = ""
    for name, a in terms.items():
        if name == "":
            continue
        sign = ("-" if a < 0 else "") if not text else (" - " if a < 0 else " + ")
        text += f"{sign}{'' if abs(abs(a) - 1.0) < 1e-9 else f'{abs(a):.6g} '}{name}"
    return f"{text} = {number(terms[''])}"


def _conditions(family: Family) -> list[tuple[str, float]]:
    """Joints at rest that must be where they are, with their values."""
    motion, lines = family._motion, family._motion.aim.lines
    theta, names = family._theta[0], lines.names
    at = [names.index(n) for n in family.joints]
    out = []
    for i in motion.aim.moves.tolist():
        if i in at:
            continue
        other = theta.copy()
        other[i] += PERTURBED
        J = motion.linear(other)[1][:, at]
        if J.shape[0] >= len(at) and np.linalg.svd(J, compute_uv=False)[-1] > CONDITION:
            x = float(family.q[0, lines.q_index[i]])
            out.append((names[i], 0.0 if abs(x) < AT_ZERO and not motion.aim.slides[i] else x))
    return out
