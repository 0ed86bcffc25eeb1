"""Description in words of a chain's structure and of the solution of its inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.targets import choose_axis, choose_task, split_task
from kempe.arguments import explain_errors, read_names
from kempe.errors import UnsupportedError
from kempe.inverse.closed_forms.chain_lines import Lines, compute_line_placements, find_chain_lines
from kempe.inverse.closed_forms.plan import (
    ChainPlan,
    compute_outer_terms,
    count_task_freedoms,
    find_plan,
    sample_variables,
)
from kempe.inverse.closed_forms.problem import read_held_joints
from kempe.inverse.closed_forms.structure import (
    EXACT,
    Strategy,
    are_parallel,
    compute_line_distance,
    find_meeting_point,
    is_spherical_triple,
)
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.closed_form.analytic_layout import AT_REST, COUPLED, PLANE, X_FIRST
from kempe.kernels.forward.table_layout import SLIDE
from kempe.report import Report
from kempe.spatial import Array
from kempe.units import name_lengths
from kempe.words import format_count, format_topics, join_words

if TYPE_CHECKING:
    from kempe.inverse.formulas import InverseFormulas
    from kempe.model.model import FrameLike, Model


# ---- facts about consecutive axes

# These facts decide how the inverse model is solved.

NEAR = 1e-2
"""Sine of an angle, or distance in lengths of the chain, below which a structure that is not there
counts as missed."""

AS_IT_IS = "solved as what they are"


def list_axis_relations(lines: Lines) -> tuple[str, ...]:
    """List facts about consecutive axes of a chain that hold in every configuration.

    Structures are those that `structure.EXACT` accepts; what misses one by less than `NEAR` is
    reported with its size.
    """
    n = len(lines)
    i = 0
    out: list[str] = []
    if n == 1:
        return (f"{lines.names[0]} is the only joint",)
    while i < n - 1:
        end = _find_last_parallel(lines, i)
        if end > i:
            out += _describe_parallel_joints(lines, i, end)
            i = end
            continue
        end = _find_last_meeting(lines, i)
        if end > i + 1:
            out.append(_describe_ball(lines, i, end))
            i = end
            continue
        out.append(_describe_pair(lines, i))
        missed = _describe_near_ball(lines, i)
        if missed:
            out.append(missed)
        i += 1
    return tuple(out)


def _find_last_parallel(lines: Lines, i: int) -> int:
    """Find the last of the consecutive axes from i that are parallel."""
    j = i
    while j + 1 < len(lines) and are_parallel(lines.h[j], lines.h[j + 1]):
        j += 1
    return j


def _find_last_meeting(lines: Lines, i: int) -> int:
    """Find the last of the consecutive turns from i that meet in one point.

    Neighbours are not parallel.
    """
    j = i + 1
    while j + 1 < len(lines) and is_spherical_triple(lines, j - 1):
        if find_meeting_point(lines, tuple(range(i, j + 2))) is None:
            break
        j += 1
    return j


def _describe_parallel_joints(lines: Lines, first: int, last: int) -> list[str]:
    """Describe consecutive joints of one direction."""
    turns = [i for i in range(first, last + 1) if lines.kinds[i] != SLIDE]
    slides = [i for i in range(first, last + 1) if lines.kinds[i] == SLIDE]
    sliding = join_words([lines.names[i] for i in slides]) if slides else ""
    verb = "slides" if len(slides) == 1 else "slide"
    if not turns:
        return [f"{sliding} slide in one direction"]
    names = join_words([lines.names[i] for i in turns])
    if len(turns) == 1:
        return [f"{sliding} {verb} along the axis of {names}"]
    gaps = [compute_line_distance(lines, i, j) for i, j in zip(turns, turns[1:], strict=False)]
    if max(gaps) <= EXACT:
        fact = f"the axes of {names} are one line"
        them = "it"
    else:
        size = f", {_format_metres(lines, gaps[0])} apart" if len(turns) == 2 else ""
        fact = f"the axes of {names} are parallel{size}"
        them = "them"
    out = [fact + (f", and {sliding} {verb} along {them}" if slides else "")]
    if max(gaps) > EXACT:
        for gap, i, j in zip(gaps, turns, turns[1:], strict=False):
            if gap <= EXACT:
                out.append(f"the axes of {lines.names[i]} and {lines.names[j]} are one line")
    return out


def _describe_ball(lines: Lines, first: int, last: int) -> str:
    """Describe consecutive turns that meet in one point."""
    names = join_words([lines.names[i] for i in range(first, last + 1)])
    right = all(abs(float(lines.h[i] @ lines.h[i + 1])) <= EXACT for i in range(first, last))
    return f"the axes of {names} meet in one point" + (
        ", neighbours at right angles" if right else ""
    )


def _describe_pair(lines: Lines, i: int) -> str:
    """Describe two neighbouring axes that are not parallel."""
    a = lines.names[i]
    b = lines.names[i + 1]
    angle, sine = _compute_angle(lines.h[i], lines.h[i + 1])
    at = (
        "right angles"
        if abs(float(lines.h[i] @ lines.h[i + 1])) <= EXACT
        else f"{math.degrees(angle):.4g} degrees"
    )
    sliding = lines.kinds[i] == SLIDE, lines.kinds[i + 1] == SLIDE
    if sine <= NEAR:
        what = "the directions" if any(sliding) else "the axes"
        return f"{what} of {a} and {b} are {sine:.2g} rad from parallel: {AS_IT_IS}"
    if all(sliding):
        return f"{a} and {b} slide at {at} to each other"
    if any(sliding):
        slide, turn = (a, b) if sliding[0] else (b, a)
        return f"{slide} slides at {at} to the axis of {turn}"
    gap = compute_line_distance(lines, i, i + 1)
    if gap <= EXACT:
        return f"the axes of {a} and {b} meet at {at}"
    if gap <= NEAR:
        return f"the axes of {a} and {b} miss each other by {_format_metres(lines, gap)}, at {at}: {AS_IT_IS}"
    return f"the axes of {a} and {b} pass each other at {at}, {_format_metres(lines, gap)} apart"


def _describe_near_ball(lines: Lines, i: int) -> str:
    """Describe three axes that nearly meet in one point; '' for others."""
    if i + 2 >= len(lines) or np.any(lines.kinds[i : i + 3] == SLIDE):
        return ""
    points: list[Array] = []
    for j in (i, i + 1):
        if (
            _compute_angle(lines.h[j], lines.h[j + 1])[1] <= NEAR
            or compute_line_distance(lines, j, j + 1) > NEAR
        ):
            return ""
        points.append(_find_foot(lines, j + 1 if j == i else j, j if j == i else j + 1))
    gap = max(
        float(np.linalg.norm(points[1] - points[0])),
        compute_line_distance(lines, i, i + 1),
        compute_line_distance(lines, i + 1, i + 2),
    )
    if not EXACT < gap <= NEAR:
        return ""
    names = join_words(lines.names[i : i + 3])
    return f"the axes of {names} miss a common point by {_format_metres(lines, gap)}: {AS_IT_IS}"


def _find_foot(lines: Lines, i: int, j: int) -> Array:
    """Find the point (3,) of axis i nearest to axis j."""
    n = np.cross(lines.h[i], lines.h[j])
    d = lines.o[j] - lines.o[i]
    return lines.o[i] + lines.h[i] * (np.cross(d, lines.h[j]) @ n) / (n @ n)


def _compute_angle(g: Array, h: Array) -> tuple[float, float]:
    """Compute the angle between two axes, at most a right angle, and its sine."""
    sine = float(np.linalg.norm(np.cross(g, h)))
    cosine = abs(float(g @ h))
    return math.atan2(sine, cosine), sine


def _format_metres(lines: Lines, distance: float) -> str:
    """Format a distance of the chain in metres."""
    return f"{distance * lines.length:.4g} m"


# ---- the steps from a target to all configurations, and how many there can be

BY_SLIDES = {0: 16, 1: 16, 2: 8, 3: 2}
"""Isolated configurations of six joints at most, by the number that slide (Raghavan and Roth,
1993)."""

FREE = {False: "free turn", True: "free slide"}
"""What the task leaves free at the tip, by whether it slides."""

SPARE = "to spare: held where `start` has them, and elsewhere for targets without a solution there"

ORDERS = {1: "linear equation", 2: "quadratic equation", 4: "quartic equation"}


class Step(NamedTuple):
    """A step of inverse kinematics: the joints it solves, the equation, and the number of values."""

    joints: tuple[str, ...]
    equation: str
    values: int

    def __str__(self) -> str:
        of = f"{join_words(list(self.joints))}: " if self.joints else ""
        return f"{of}{self.equation}" + (f", {self.values} values" if self.values > 1 else "")


def list_steps(plan: ChainPlan, fixed: frozenset[str]) -> tuple[Step, ...]:
    """List the steps from a target to all configurations; the caller holds the joints `fixed`."""
    names = plan.lines.names
    held = [names[i] for i in plan.locked]
    by_caller = tuple(name for name in held if name in fixed)
    spare = tuple(name for name in held if name not in fixed)
    out = [Step(by_caller, "held at given values", 1)] if by_caller else []
    out += [Step(spare, SPARE, 1)] if spare else []
    unknown = [i for i in range(len(names)) if i not in plan.locked]
    if plan.way is not None:
        out += _list_closed_form_steps(plan, plan.way)
    else:
        method = (
            "elimination, roots of one polynomial"
            if plan.method.word == "elimination"
            else "search"
        )
        out.append(Step(tuple(names[i] for i in unknown), method, _bound_by_slides(plan)))
    equations, freedoms = count_task_freedoms(plan, plan.locked)
    if (left := equations - freedoms) > 0:
        them = "it" if left == 1 else "them"
        rest = format_count(left, "equation")
        out.append(Step((), f"{rest} left over: targets that miss {them} are out of reach", 1))
    return tuple(out)


def bound_solutions(plan: ChainPlan) -> int:
    """Bound the number of isolated configurations, without turns by 2 pi, for fixed held joints."""
    unknown = len(plan.lines) - len(plan.locked)
    # else the joints would move as one
    if unknown == 1 or (unknown == 2 and plan.task == "pose"):
        return 1
    steps = [] if plan.way is None else _list_closed_form_steps(plan, plan.way)
    return min(_bound_by_slides(plan), math.prod(step.values for step in steps) if steps else 16)


def _bound_by_slides(plan: ChainPlan) -> int:
    """Bound the number of configurations of six general joints by their number of slides."""
    unknown = [i for i in range(len(plan.lines)) if i not in plan.locked]
    kinds = np.concatenate([plan.lines.kinds[unknown], plan.extra.kinds])
    return BY_SLIDES.get(int((kinds == SLIDE).sum()), 1) if len(kinds) <= 6 else BY_SLIDES[0]


def _list_closed_form_steps(plan: ChainPlan, way: Strategy) -> list[Step]:
    """List the steps of a closed form: equations of the outer joints x and z, then inner joints."""
    n = len(plan.lines)
    order = [way.order[(way.inner + k) % 6] for k in range(6)]
    roles = [A.JOINT if j < n else int(plan.extra.roles[j - n]) for j in order]
    slides = np.concatenate([plan.lines.kinds, plan.extra.kinds])[order] == SLIDE
    names = [
        (plan.lines.names[j],) if j < n else (FREE[bool(slide)],) * (role == A.FREE)
        for j, role, slide in zip(order, roles, slides, strict=True)
    ]
    inner = sum(
        (name for name, role in zip(names[:3], roles[:3], strict=True) if role == A.JOINT), ()
    )
    out: list[Step] = []
    x = 3
    y = 4
    z = 5
    if way.mode == COUPLED:
        values = 2 if A.REST in (roles[x], roles[z]) else 4
        out.append(Step((*names[x], *names[z]), ORDERS[4], values))
    elif way.mode != AT_REST:
        first, second = (0, 1) if way.mode == X_FIRST else (1, 0)
        size = _measure_factors(plan)
        room = 2 if roles[y] == A.REST else 4  # a point moved by x and z alone: two circles
        for k, measure in ((first, way.measure), (second, 1 - way.measure)):
            place = (x, z)[k]
            linear = slides[place] and size[k, measure, 1] <= EXACT
            values = 1 if linear or roles[place] == A.REST else min(2, room)
            room //= values
            if names[place]:
                out.append(Step(names[place], ORDERS[1 if linear else 2], values))
    if out:
        s = "s" * (len(inner) == 1)
        who = join_words(list(inner))
        still = f"plane that {who} move{s} in itself"
        if way.what != PLANE:
            still = f"point that {who} leave{s} in place"
        out[0] = out[0]._replace(equation=f"{out[0].equation} for the {still if inner else 'tip'}")
    if names[y] and out:
        out.append(Step(names[y], "follows", 1))
    if inner:
        in_plane = way.what == PLANE
        one = A.REST in roles[:3] or A.JOINT not in roles[:3] or (in_plane and sum(slides[:3]) > 1)
        out.append(
            Step(inner, "motion within the plane" if in_plane else "orientation", 1 if one else 2)
        )
    return out


def _measure_factors(plan: ChainPlan) -> Array:
    """Measure the largest size (2, 2, 2) of the factors of x and z (rows) over some targets."""
    rng = np.random.default_rng(13)
    lines = plan.lines
    theta = sample_variables(lines, rng, 4)
    theta[1:, list(plan.locked)] = theta[0, list(plan.locked)]
    terms = [
        compute_outer_terms(plan, theta[0], X) for X in compute_line_placements(lines, theta[1:])[0]
    ]
    return np.abs(terms)[..., 1:].max(axis=0)


# ---- the report

WIDTH = 110
"""Columns of the text."""


@dataclass(frozen=True, repr=False)
class Recognised(Report):
    """Structure of the chain of a frame, and the method that solves its inverse kinematics.

    Attributes
    ----------
    joints, kinds
        Names of the joints from the ground to the frame, and whether each "turns" or "slides".
    relations
        Facts about consecutive axes, also those that a structure misses by little.
    steps
        Rows of a table in the order of solving: joints, the equation for them, and the largest
        number of values.
    method
        "closed form", "elimination" or "search".
    most
        Largest number of isolated solutions of a target, whole turns not counted.
    held
        Joints that keep their values, because the chain has spare joints or by request.
    """

    system: str
    frame: str
    task: str
    joints: tuple[str, ...]
    kinds: tuple[str, ...]
    relations: tuple[str, ...]
    steps: tuple[Step, ...]
    most: int
    method: str
    held: tuple[str, ...]
    note: str = ""
    """Why the task is not a pose, where none was given."""
    of: Model | None = field(default=None, compare=False)

    @property
    def status(self) -> str:
        """Title of the report: frame, system and task."""
        return f"inverse model of {self.frame} of {self.system}, task {self.task}"

    def formulas(self, *, symbols: Mapping[str, Any] | None = None) -> InverseFormulas:
        """Derive the inverse kinematics as formulas; see `kempe.inverse.formulas.derive_ik`.

        Errors: `UnsupportedError` where there are no short ones, with the reason.
        """
        from kempe.inverse.formulas import derive_ik

        if self.of is None or self.held:
            why = (
                f"with {', '.join(self.held)} held; lock them in the mechanism"
                if self.held
                else "without the system"
            )
            raise UnsupportedError(f"there are no formulas {why}")
        return derive_ik(self.of, self.frame, self.task, symbols=symbols)

    def _collect_data(self) -> dict[str, Any]:
        own = {name: x for name, x in vars(self).items() if name != "of"}
        return {**own, "steps": [step._asdict() for step in self.steps]}

    def topics(self) -> list[tuple[str, tuple[str, ...]]]:
        """Return the report as pairs of a title and its lines."""
        joints = ", ".join(f"{n} {k}" for n, k in zip(self.joints, self.kinds, strict=True))
        if set(self.kinds) == {"turns"} and len(self.joints) > 1:
            joints = f"{', '.join(self.joints)}: all turn"
        count = "configuration" if self.most == 1 else "configurations"
        each = " for each value of what is held" if self.held else ""
        return [
            *([("task", (self.note,))] if self.note else []),
            ("joints", (joints,)),
            ("axes", self.relations),
            ("steps", tuple(map(str, self.steps))),
            ("method", (self.method,)),
            ("solutions", (f"{self.most} isolated {count} at most{each}",)),
        ]

    def __str__(self) -> str:
        return format_topics(self.status, self.topics(), 11, WIDTH)


@explain_errors
def describe_plan(
    system: Model,
    frame: FrameLike,
    task: str | tuple[str, ArrayLike] | None = None,
    fixed: Iterable[str] = (),
) -> Recognised:
    """Describe the structure of the chain that moves `frame`, and how `ik_all` solves it.

    Arguments as those of `kempe.inverse.ik_all.ik_all`; without a `task` that of a pose,
    or of a position where the chain has no more joints than that has equations. `fixed` are the
    names of joints that are held. Errors: `UnsupportedError` for chains with loops, quaternions or
    shared coordinates, `InputError`, `UnknownNameError`.

    >>> import kempe
    >>> from kempe.inverse.describe import describe_plan
    >>> print(describe_plan(kempe.load("puma560"), "tool").most)
    8
    """
    name = system.structure.frame_name(frame)
    said, axis = split_task(task)
    what = choose_task(said, False, bool(system.structure.table.at[name][2]))
    direction = choose_axis(axis, what)
    lines = find_chain_lines(system, name, direction)
    note = ""
    if task is None and what == "pose" and len(lines) <= system.dim:
        n = 3 * (system.dim - 1)
        count = format_count(len(lines), "joint")
        what = "position"
        note = (
            f"a pose has {n} equations, more than the chain has joints ({count}): the position is "
            "planned"
        )
    given = read_held_joints(name, lines.names, dict.fromkeys(read_names(fixed, "fixed"), 0.0))
    plan = find_plan(system, name, lines, what, direction, tuple(given))
    kinds = tuple("slides" if kind == SLIDE else "turns" for kind in lines.kinds)
    return Recognised(
        system.name,
        name,
        what,
        lines.names,
        kinds,
        tuple(name_lengths(list_axis_relations(lines), system.unit)),
        list_steps(plan, frozenset(given)),
        bound_solutions(plan),
        plan.method.word,
        tuple(lines.names[i] for i in plan.locked),
        note,
        system,
    )
