"""Sentences of answers: what was found, or why nothing was, in the same words for all verbs.

Solvers and the modules `explain_...` find the facts; each kind of fact has one sentence here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.words import choose_verb, format_count, join_first_words, join_words, spell_count

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- numbers, errors and limits as text


def format_number(x: float) -> str:
    """Format a number with six digits; values below 1e-9 are zero."""
    return f"{0.0 if abs(x) < 1e-9 else x:.6g}"


def format_errors(
    place: float | None,
    turn: float | None,
    metres: str = ".6g",
    radians: str = ".2g",
    by: str = ", ",
) -> str:
    """Format errors in metres and radians; None leaves one out."""
    parts = [] if place is None else [f"{place:{metres}} m"]
    return by.join(parts if turn is None else [*parts, f"{turn:{radians}} rad"])


def describe_search(steps: int, starts: int) -> str:
    """Describe the effort of a search: '12 steps, 3 starts'."""
    return f"{format_count(steps, 'step')}, {format_count(starts, 'start')}"


def format_limits(names: Sequence[str], join: str = ", ") -> str:
    """Format the limits of coordinates: "the limits of 'a', 'b'"; '' for no coordinates."""
    one = len(names) == 1 or join.endswith(" of ")
    return f"the limit{'' if one else 's'} of {join.join(map(repr, names))}" if names else ""


MILLIMETRES = 30.0
"""Typical lengths of a link, beyond which a target is out of reach by its unit rather than by
mistake."""


# ---- configurations that were found


def describe_reached_frame(place: float | None, turn: float | None, steps: int, starts: int) -> str:
    """Describe that a frame reached its target; without starts the solution is analytic."""
    what = format_errors(place, turn, ".1e")
    how = describe_search(steps, starts) if starts else "analytically"
    return f"reached: {'' if place is None else 'position error '}{what} ({how})"


def describe_closest(pair: tuple[str, str], distance: float, at_least: float) -> str:
    """Describe how near two bodies come that must keep a distance, in metres."""
    a, b = pair
    where = f"are {distance:.4g} m apart" if distance >= 0.0 else f"overlap by {-distance:.4g} m"
    return f"{a!r} and {b!r} {where} (asked: at least {at_least:.4g} m apart)"


def describe_hard_tasks(place: float | None, turn: float | None, how: str, freedoms: str) -> str:
    """Describe that all hard tasks hold, with the largest errors and the remaining freedoms."""
    left = f"; {freedoms}" if freedoms else ""
    return f"all hard tasks hold: errors up to {format_errors(place, turn, '.1e', '.1e')} ({how}){left}"


def describe_unfinished_tasks(limit: float | None) -> str:
    """Describe that the time limit ended the search before soft tasks were finished."""
    return f"the time limit of {limit or 0.0:g} s ended the search before all errors were minimal"


def describe_closed_loops(residual: float, steps: int, starts: int, left: str) -> str:
    """Describe that all loops are closed, with the residual and the freedoms left open."""
    return f"closed: residual {residual:.1e} ({describe_search(steps, starts)}){left}"


def explain_open_freedoms(
    left: int, count: int, who: str, folded: Sequence[tuple[str, str]], sure: bool, home: int
) -> str:
    """Explain how many freedoms are left open, and why these are more than expected.

    Expected are the `count` of `who`, or `home` freedoms (-1: as many as are left).

    `folded` are pins that coincide, and `sure` whether these are the reason.
    """
    said = f"; {format_count(left, 'freedom')} left open"
    if folded:
        pins = join_first_words([f"{a} and {b}" for a, b in folded], 3)
        why = "the mechanism is folded or singular here, where" if sure else "it may be folded, for"
        return f"{said}, {count} {who}: {why} {pins} coincide"
    return f"{said}, {home} at home: singular here, or on another branch" if home >= 0 else said


def describe_fold(folded: Sequence[tuple[str, str]]) -> str:
    """Describe that pins coincide, so that a mechanism may have more freedoms here than elsewhere."""
    pins = join_first_words([f"{a} and {b}" for a, b in folded], 3)
    return f"; it is folded here, where {pins} coincide: ask at another position, too"


def suggest_near_mechanism(nearest: str, freedoms: int) -> str:
    """Suggest the mechanism nearest to one that cannot move."""
    moves = f"it would have {format_count(freedoms, 'freedom')}"
    return f"; with dimensions changed {nearest} {moves}: the argument tolerance= allows this"


def describe_remaining_freedoms(
    first: int, finite: int, equations: int = 0, freedoms: int = 0
) -> str:
    """Describe how many freedoms the tasks leave, to first order and for finite motions."""
    if first == 0:
        said = "no freedom is left"
    elif finite == first:
        said = f"{format_count(finite, 'freedom')} left"
    else:
        said = f"{format_count(first, 'freedom')} to first order only"
        said = f"{format_count(finite, 'freedom')} left, {first} to first order" if finite else said
        said = f"{said} (the Jacobian loses rank here)"
    more = equations > freedoms
    return (
        f"{said}, though {equations} equations meet {format_count(freedoms, 'freedom')}"
        if more
        else said
    )


# ---- failures: the first clause, and what follows it


def describe_failure(head: str, *parts: Any) -> str:
    """Compose the sentence of a failure: what was tried, then the evidence that is not empty."""
    return f"{head}{': ' if head else ''}{'; '.join(str(part) for part in parts if part)}"


def describe_vain_starts(done: str, starts: int) -> str:
    """Describe that a search ended without success after some number of starts."""
    return f"not {done} after {format_count(starts, 'start')}"


def describe_late_search(
    limit: float | None, starts: int, most: int | None = None, done: str = "reached"
) -> str:
    """Describe that the time limit ended a search, and after how many starts."""
    count = (
        format_count(starts, "start")
        if most is None
        else f"{starts} of {format_count(most, 'start')}"
    )
    return f"not {done} within the time limit of {limit or 0.0:g} s, after {count}"


def describe_vain_calls(count: int) -> str:
    """Describe that a search with Python functions gave up after some number of calls."""
    return (
        f"{count} calls of functions found nothing, nor did a search without limits, or for the "
        "functions alone: kempe.Budget(starts=..., time_limit=...) goes on"
    )


def describe_incomplete_search(limit: float) -> str:
    """Describe that the time limit ended the search for all solutions."""
    return f"; the time limit of {limit:g} s ended the work: there may be others"


def describe_empty_search(limit: float) -> str:
    """Describe that the time limit ended a search before any solution was found."""
    return f"no solution found within the time limit of {limit:g} s: there may be some"


def describe_late_nearest_mechanism(limit: float | None) -> str:
    """Describe that the time limit ended the search for the nearest exact mechanism."""
    return (
        f"the time limit of {limit or 0.0:g} s ended the search for the nearest mechanism that closes "
        "exactly: what closes is not known; allow more by kempe.Budget(time_limit=...)"
    )


def describe_nearest_error(place: float | None, turn: float | None) -> str:
    """Describe the error of the nearest configuration that was found."""
    return f"the nearest configuration found misses it by {format_errors(place, turn)}"


# ---- evidence, by its kind


def _explain_lengths(
    place: float = 0.0,
    turned: float = 0.0,
    plane: float = 0.0,
    task: str = "",
    times: float = 0.0,
    point: bool = False,
    slides: Sequence[str] = (),
) -> str:
    """Explain that a target is out of reach of the links by at least so many metres.

    With `slides`, by the limits of these coordinates, too, without which lengths say nothing.
    """
    who = f"{task!r} is " if task else ""
    units = "; lengths are metres, and these look like millimetres" if times > MILLIMETRES else ""
    if plane > 0.0:
        angle = (
            "; three numbers are x, y, z here, and x, y, angle with task='pose'" if point else ""
        )
        return f"{who}outside the plane of the system by {plane:.6g} m{units}{angle}"
    parts = [f" by at least {place:.6g} m"] if place > 0.0 else []
    parts += [f" with this orientation by at least {turned:.6g} m"] if turned > place else []
    ends = f" and {format_limits(slides)}" if slides else ""
    return f"{who}outside the workspace{','.join(parts)}, by the lengths of the links{ends}{units}"


def _explain_short_links(joint: str, longest: float, others: float, known: bool = False) -> str:
    """Explain that a loop stays open since one of its links is longer than all others together."""
    size = f"{longest:.6g} m"
    held, what = (
        (" with these values", f"two of its joints are {size} apart")
        if known
        else ("", f"one of its links is {size} long")
    )
    return (
        f"the loop of joint {joint!r} cannot be closed{held}: {what}, "
        f"{longest - others:.6g} m more than all its other links together"
    )


def _explain_outside_limits(count: int = 0, short: float = 0.0) -> str:
    """Explain that all `count` configurations that reach a target violate limits.

    With `short`, slides end that many metres before the target.
    """
    if short > 0.0:
        return f"slides end {short:.6g} m before it"
    one = "the only configuration that reaches it is outside"
    return one if count == 1 else f"all {count} configurations that reach it are outside"


CONTRADICTIONS: Mapping[str, str] = MappingProxyType(
    {
        "links": (
            "their places are {off:.6g} m apart, the links between them allow at most "
            "{longest:.6g} m"
        ),
        "turns": "they turn one body to orientations {off:.6g} rad apart",
        "axes": "they turn axes of one body to directions that are {off:.6g} rad off",
        "points": "they hold points of one body in places that do not fit together by {off:.6g} m",
        "point": "they hold one point in places {off:.6g} m apart",
        "region": "one puts a point of the body {off:.6g} m away from where the other lets it be",
    }
)
"""How two tasks exclude each other: by lengths of links, or by what they ask of one body."""


def _explain_contradiction(how: str, off: float, first: str, second: str, **figures: Any) -> str:
    """Explain that two tasks contradict each other by so many metres or radians."""
    return (
        f"contradictory: {first!r} and {second!r}: {CONTRADICTIONS[how].format(off=off, **figures)}"
    )


def _explain_missing_root(joint: str, axes: Sequence[int], what: str, off: float) -> str:
    """Explain that no angle of a joint brings some axes to where the target needs them."""
    lines = (
        f"{'axis' if len(axes) == 1 else 'axes'} {', '.join(str(i + 1) for i in axes)}"
        if axes
        else "the tip"
    )
    if what == "direction":
        return (
            f"no angle of {joint!r} gives {lines} the direction that is needed: {off:.2g} rad off"
        )
    if what == "plane":
        return f"no angle of {joint!r} brings {lines} to where the target needs it"
    point = ("the tip", f"a point of {lines}", f"the point where {lines} meet")[min(len(axes), 2)]
    how = {
        "far": "distance: {} m too far",
        "near": "distance: {} m too near",
        "height": "height: {} m off",
    }[what]
    return f"no angle of {joint!r} brings {point} to its {how.format(f'{off:.6g}')}"


def _explain_rank(
    equations: int,
    freedoms: int,
    frame: str = "",
    position: bool | None = None,
    held: bool = False,
) -> str:
    """Explain that there are more equations than freedoms.

    For one frame also whether its position alone can be reached, and whether joints are `held`.
    """
    if not frame:
        return f"{format_count(equations, 'equation')}, but {format_count(freedoms, 'freedom')}"
    rest = " with the joints that are held" if held else ""
    if freedoms == 0:
        return f"no joint moves frame {frame!r}{rest}"
    said = f"the task has {format_count(equations, 'equation')}, but the chain moves this frame in"
    said += f" {format_count(freedoms, 'freedom')} only{rest}"
    alone = (
        ""
        if position is None
        else f" (its position alone {'can' if position else 'cannot'} be reached)"
    )
    return f"{said}{alone}"


def _explain_excess_values(
    given: int, freedoms: int, frames: Sequence[str] = (), numbers: int = 0
) -> str:
    """Explain that more is given than the system has freedoms.

    Given are coordinates, and positions of `frames`, which have so many `numbers` each.
    """
    parts = [format_count(given, "coordinate")] if given else []
    parts += [f"the position of {name!r} ({numbers} numbers)" for name in frames]
    verb = choose_verb(given + len(frames) * (1 + bool(given)), "is", "are")
    said = f"{join_words(parts)} {verb} given, but"
    if not freedoms:
        return f"{said} the mechanism cannot move (0 freedoms)"
    return f"{said} it has {format_count(freedoms, 'freedom')}"


def _suggest_more_starts(singular: bool = False) -> str:
    """Suggest a search with more starts."""
    stuck = "the search is stuck at a singular configuration; " if singular else ""
    return f"{stuck}more starts find an answer"


def _explain_blocking_limits(
    names: Sequence[str],
    together: bool = False,
    each: bool = False,
    proof: object = None,
    task: str = "",
    done: str = "is reached",
) -> str:
    """Explain that limits of `names` block the target, by a proof or by a search without them."""
    which = format_limits(names, " or of " if each else " and " if together else ", ")
    if proof:
        return (
            f"blocked by {which}{' together' if together else ''} ({proof}); without limits it is "
            "reachable"
        )
    them = "that" if each or len(names) == 1 else "these"
    way = f"{task!r} alone {done} without {which}" if task else f"without {which} it {done}"
    return f"{way}, so {them} may be what blocks it"


def _explain_one_sided_constraints(
    violated: Sequence[str], done: str = "is reached", known: bool = False
) -> str:
    """Explain that one-sided constraints block an answer, or contradict the known values."""
    what = ", ".join(violated)
    return (
        f"what is known contradicts {what}"
        if known
        else f"without one-sided constraints it {done}, violating {what}"
    )


def _explain_failed_task(task: str = "", rank: Any = None) -> str:
    """Explain that a task was not reached even alone."""
    said = f"{task!r} is not found even alone" if task else "no configuration was found"
    return f"{said}{f' ({rank})' if rank else ''}"


def _explain_conflicting_tasks(
    pairs: Sequence[tuple[str, str]], starts: int, tasks: int, rank: Any, two: bool
) -> str:
    """Explain that each task was reached alone, but not all of them, or not these pairs, together."""
    said = "each hard task was reached alone, but not all together"
    if pairs:
        names = ", ".join(f"{a!r} and {b!r}" for a, b in pairs)
        said = (
            f"{names}: each was reached alone, but not both together in "
            f"{format_count(starts, 'start')}"
        )
    elif two:
        said = f"any two of the {tasks} hard tasks were reached, but not all together"
    return f"{said}{f' ({rank})' if rank else ''}"


def _explain_near_miss(place: float, turn: float | None, longest: float, small: bool) -> str:
    """Explain that a search came close, so that it may have ended early."""
    came = f"the search came within {format_errors(place, turn, '.1g')}"
    if small:
        return (
            f"{came} with links of at most {longest:.2g} m: it may have ended early at so small a "
            "scale"
        )
    return f"{came}, so it may have ended early, or the target is just outside the workspace"


def _explain_missing_configuration(limits: bool, place: bool, turn: bool) -> str:
    """Explain that no configuration was found, and what the reason may be."""
    may = (
        "the target may be outside the workspace"
        if place
        else "the orientation may be out of reach"
    )
    turned = ", or not reachable with this orientation" if place and turn else ""
    return (
        f"no configuration was found{' without limits either' if limits else ''}, so {may}{turned}"
    )


OPEN: Mapping[str, str] = MappingProxyType(
    {
        "nothing": "nothing is open",
        "place": "the place of {names} is missed by {place:.6g} m",
        "loop": "the loop of joint {names} stays open by {errors}",
        "constraint": "constraint {names} stays open by {errors}",
        "equation": "constraint {names} is off by {turn:.6g}",
        "relation": "the relation of {names} is off by {turn:.6g}",
        "one-sided": "the one-sided constraint {names} is violated by {amount}",
    }
)
"""What is violated most where loops do not close."""


def _explain_open_loop(
    what: str,
    names: Sequence[str] = (),
    place: float = 0.0,
    turn: float = 0.0,
    amount: str = "",
) -> str:
    """Explain what stays open where loops do not close, and by how much."""
    return OPEN[what].format(
        names=" or ".join(map(repr, names)),
        place=place,
        turn=turn,
        amount=amount,
        errors=format_errors(place, turn if turn > 1e-9 else None, radians=".3g", by=" and "),
    )


def _suggest_closing_tolerance(nearest: str = "", tolerance: float = 0.0) -> str:
    """Suggest a tolerance with which loops close, of the mechanism nearest to the given one."""
    if nearest:
        return f"it closes {nearest}: give a larger tolerance"
    return f"with tolerance={tolerance:.2g} it counts as closed as it is"


NO_ROOT: Mapping[str, str] = MappingProxyType(
    {
        "closed form": "the equations of the closed form have no real root",
        "elimination": "no real root among 16",
        "search": "not found; no closed form applies",
    }
)
"""What a method of `ik_all` found where it found no solution."""


def _explain_vain_method(method: str) -> str:
    """Explain that a method of `ik_all` found no solution."""
    return NO_ROOT[method]


def _suggest_tolerance(metres: float, radians: float, one: bool) -> str:
    """Suggest tolerances that accept a target with rounded numbers; one number if `one`."""
    enough = (
        f"tolerance={max(metres, radians):g}" if one else f"tolerance=({metres:g}, {radians:g})"
    )
    return f"a target that was rounded needs a larger tolerance: {enough} accepts it"


def _describe_tried_values(held: Sequence[tuple[str, float]], values: int, starts: int) -> str:
    """Describe at which values of the spare joints there is no solution."""
    joints = ", ".join(repr(name) for name, _ in held)
    where = (
        describe_held_joints(held) if values == 1 else f"{joints} at any of {values} values tried"
    )
    return f"no solution with {where}, and none from {format_count(starts, 'start')} of a search"


# ---- all solutions of a target


def describe_held_joints(values: Sequence[tuple[str, float]]) -> str:
    """Describe at which values joints are held."""
    return ", ".join(f"{name!r} at {format_number(x)}" for name, x in values)


def describe_held_values(
    name: str, usual: float, times: int, targets: int, low: float, high: float
) -> str:
    """Describe at which values a joint is held for a batch of targets."""
    if low == high:
        return f"{name!r} at {format_number(usual)}"
    most = (
        f"{name!r} at {format_number(usual)} for {times} of {targets} targets, else"
        if times > 1
        else f"{name!r}"
    )
    return f"{most} at values from {format_number(low)} to {format_number(high)}"


def describe_spare_joints(
    count: int, held: str = "", first: Sequence[float] = (), tried: int = 1, inside: bool = False
) -> str:
    """Describe how many joints a chain has to spare, and at which values they are held.

    `first` are the values before these, after so many were `tried`.
    """
    text = f"the chain has {spell_count(count, 'joint')} to spare{held}"
    if tried == 1:
        return text
    if not len(first):
        return f"{text} ({format_count(tried, 'value')} {choose_verb(tried, 'was', 'were')} tried)"
    there = ", ".join(map(format_number, first))
    return f"{text} (at {there} there is none{' inside the limits' if inside else ''})"


def describe_solutions(
    count: int,
    inside: int,
    method: str,
    sure: bool,
    spare: bool,
    roots: Sequence[int],
    beyond: str,
    families: Sequence[tuple[int, str]],
    ground: str,
    sampled: int = 0,
) -> str:
    """Describe how many isolated solutions and families there are, and by which method.

    `families` are freedoms and motions; `beyond` says which limit the least of them violates if
    none is `inside`; `sampled` are the solutions of families that are not known further.
    """
    text = f"{count} solution{'' if count == 1 else 's'}" if count else "no isolated solution"
    if count:
        text += " by elimination" if method == "elimination" else ""
        text += _describe_completeness(count, method, sure, spare) + _describe_merged_roots(
            count, roots
        )
    if inside < count:
        text += f", {inside or 'none'} inside the limits"
        text += f" ({beyond})" if beyond else ""
    if families:
        return f"{text}, and {_describe_families(families)}"
    if sampled:
        text += f", and {'one' if sampled == 1 else sampled} of a continuous family"
    return f"{text}: {ground}" if method == "closed form" else text


def describe_limit_excess(joint: str, off: float, unit: str, still: str) -> str:
    """Describe how far the solution nearest to the limits is outside of them."""
    return (
        f"the nearest to them has {joint!r} {off:.6g} {unit} beyond its "
        f"limit{f'; {still}' if still else ''}"
    )


def explain_closed_form(axes: Sequence[int], meet: bool) -> str:
    """Explain why there is a closed form: which axes meet in a point or are parallel."""
    common = (
        f"axes {', '.join(str(i + 1) for i in axes)} "
        f"{'meet in a point' if meet else 'are parallel'}"
    )
    return f"{common} (closed form)" if axes else "closed form"


def _describe_completeness(count: int, method: str, sure: bool, spare: bool) -> str:
    """Describe whether the solutions are complete, as the end of a clause."""
    if not sure:
        return " found, there may be more"
    if spare:
        return " for what is held"
    if method == "closed form":
        return ", all of them" if count > 1 else ", the only one"
    return ", all there are" if method == "elimination" else " found, there may be more"


def _describe_merged_roots(count: int, roots: Sequence[int]) -> str:
    """Describe which of the solutions are double, triple or multiple roots."""
    if not roots:
        return ""
    kind = (
        {2: "double", 3: "triple"}.get(roots[0], "multiple") if len(set(roots)) == 1 else "multiple"
    )
    if count == 1:
        return f" (a {kind} root)"
    one = len(roots) == 1
    return f", {len(roots)} of them {'a ' if one else ''}{kind} root{'' if one else 's'}"


def _describe_families(families: Sequence[tuple[int, str]]) -> str:
    """Describe the families of solutions, equal ones together."""
    out: list[str] = []
    for dimension, moves in dict.fromkeys(families):
        k = families.count((dimension, moves))
        freedoms = spell_count(dimension, "freedom")
        out.append(
            f"{'a family' if k == 1 else f'{k} families'} with "
            f"{freedoms}{'' if k == 1 else ' each'}: {moves}"
        )
    return "; ".join(out)


def describe_linear_motion(
    names: Sequence[str],
    equations: Sequence[Mapping[str, float]],
    rest: Sequence[tuple[str, float]],
) -> str:
    """Describe a family of solutions on a straight line.

    `equations` have coefficients by joint, and "" for the right side, while the joints of `rest`
    stay.
    """
    text = join_words([_format_equation(e) for e in equations] or [f"{names[0]} is free"])
    return (
        f"{text} while {join_words([f'{n} = {format_number(x)}' for n, x in rest])}"
        if rest
        else text
    )


def describe_curved_motion(
    names: Sequence[str], first: str, turns: bool, is_closed: bool, ends: tuple[float, float]
) -> str:
    """Describe a family of solutions on a curve, by the range of its `first` joint."""
    if turns:
        return (
            f"{first} turns all the way round and {join_words([n for n in names if n != first])} "
            "follow"
        )
    how = "on a closed curve" if is_closed else "on a curve that does not close"
    return (
        f"{join_words(names)} move together {how}, {first} from {format_number(ends[0])} to "
        f"{format_number(ends[1])}"
    )


def _format_equation(terms: Mapping[str, float]) -> str:
    """Format a linear equation: coefficients by joint, and "" for the right side."""
    text = ""
    for name, a in ((n, a) for n, a in terms.items() if n):
        sign = ("-" if a < 0 else "") if not text else (" - " if a < 0 else " + ")
        text += f"{sign}{'' if abs(abs(a) - 1.0) < 1e-9 else f'{abs(a):.6g} '}{name}"
    return f"{text} = {format_number(terms[''])}"


PROOFS: Mapping[str, Callable[..., str] | str] = MappingProxyType(
    {
        "lengths": _explain_lengths,
        "tilted": "tilted out of the plane of the system by {angle:.2g} rad",
        "outside": _explain_outside_limits,
        "contradiction": _explain_contradiction,
        "no root": _explain_missing_root,
        "short links": _explain_short_links,
    }
)
"""Kinds of evidence that prove that there is no answer, each with its sentence as a function of its
figures, or as a template."""
FOUND_OUT: Mapping[str, Callable[..., str] | str] = MappingProxyType(
    {
        "rank": _explain_rank,
        "too many given": _explain_excess_values,
        "more starts": _suggest_more_starts,
        "limits": _explain_blocking_limits,
        "one-sided": _explain_one_sided_constraints,
        "not alone": _explain_failed_task,
        "not together": _explain_conflicting_tasks,
        "near miss": _explain_near_miss,
        "not found": _explain_missing_configuration,
        "no root found": _explain_vain_method,
        "open": _explain_open_loop,
        "not closed": "with these values no closed configuration was found",
        "nearly closed": _suggest_closing_tolerance,
        "wide span": "{span}, and solutions may be missed",
        "rounded": _suggest_tolerance,
        "tried": _describe_tried_values,
    }
)
"""All other kinds, with their sentences: they say what was found out, and prove nothing."""


# ---- coordinates that limits hold still

# Many files mean no limits where they give none.

SHOWN = 6
"""Names that are listed."""


def describe_immovable_coordinates(
    system: Model, coordinates: Iterable[int] | None = None, unstated: bool = False
) -> str:
    """Describe which coordinates cannot move because their limits are equal; '' for none.

    `coordinates` are their indices, all where None; `unstated` leaves out limits that the
    description gives.
    """
    low, high = system.structure.limits.T
    still = np.flatnonzero(low == high).tolist()
    if not still:
        return ""
    requested = set(still) if coordinates is None else {int(i) for i in coordinates}
    names = [system.structure.velocity_names[i] for i in still if i in requested]
    ours = {name for name, joint in system.structure.joints.items() if joint.unstated}
    ours |= {
        f.source
        for of, f in system.structure.couplings.items()
        if of in ours and f.source is not None
    }
    reported = [n for n in names if n in ours]
    given = [n for n in names if n not in ours and not unstated]
    parts: list[str] = []
    for group, why in (
        (
            reported,
            f"0..0 because the file gives no bounds; lenient_limits=True reads {_choose_pronoun(reported)} "
            "as unlimited",
        ),
        (given, f"lower and upper limit of {_choose_pronoun(given)} are the same"),
    ):
        if group:
            shown = ", ".join(map(repr, group[:SHOWN])) + (
                f", ... ({len(group)} in all)" if group[SHOWN:] else ""
            )
            parts.append(f"{shown} cannot move ({why})")
    return "; ".join(parts)


def _choose_pronoun(names: list[str]) -> str:
    """Choose the pronoun for some names: 'it' or 'them'."""
    return "it" if len(names) == 1 else "them"
