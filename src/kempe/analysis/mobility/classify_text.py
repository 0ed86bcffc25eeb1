"""A `Classification` in words: the sentence, the reasoning by topic, and plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kempe.solvers.assembly.ideal import said
from kempe.words import counted, cut, verb

if TYPE_CHECKING:
    from kempe.analysis.mobility.classify import Classification, ConstraintKind

SHOWN = 24
"""Constraints that are listed one by one."""
LATE = "the time limit ended the work before each constraint was looked at alone"
"""What is said where that is all that is missing."""
SEEN = 1e-9
"""Distance above which it is reported that the configuration is not the one that was given."""


def vector(growth: tuple[int, ...], open_end: bool = False) -> str:
    """'(2, 3, 4)', with dots where it goes on."""
    return f"({', '.join(map(str, growth))}{', ...' if open_end else ''})"


def sentence(c: Classification) -> str:
    """The result in one sentence, and within which tolerance it holds."""
    doubt = "; a rank is doubtful" if c.doubtful and "beyond the digits" not in _sentence(c) else ""
    ended = f"; {LATE}" if c.late and not c.why else ""
    return _sentence(c) + doubt + ended + said(c.within)


def _sentence(c: Classification) -> str:
    both = f"{counted(c.position_dof, 'freedom')} of position, {c.velocity_dof} of velocity"
    if c.kind in ("", "unilateral") or (c.kind == "holonomic" and c.position_dof == c.velocity_dof):
        return both + (f"; {c.why}" if c.why else "")
    if c.doubtful and c.reachable_dimension is not None and c.reachable_dimension < c.position_dof:
        least = (
            f"motions reach at least {counted(c.reachable_dimension, 'dimension')} of "
            f"{c.position_dof}"
        )
        return f"{both}: {least}, whether more is beyond the digits of numbers"
    if c.kind == "integrable":
        lost = c.integrals or 0
        keep = "keeps its value" if lost == 1 else "keep their values"
        return f"{both}: integrable, {counted(lost, 'function')} of position {keep}"
    if c.reachable_dimension is None:
        return f"{both}: nonholonomic; {c.why}"
    if c.reachable_dimension == c.position_dof:
        return f"{both}: nonholonomic, motions reach every configuration around"
    return (
        f"{both}: nonholonomic, motions reach {counted(c.reachable_dimension, 'dimension')} of "
        f"{c.position_dof}"
    )


def of_one(c: ConstraintKind) -> str:
    """What one constraint is, and why."""
    return _of_one(c) + ("; all this while it touches" if c.touching else "")


def _of_one(c: ConstraintKind) -> str:
    count = counted(len(c.rows), "row")
    if c.kind == "unilateral":
        return (
            f"unilateral: {count} held on one side, which takes no freedom while it does not touch"
        )
    if c.kind == "holonomic":
        takes = (
            f"takes {counted(c.independent, 'freedom')}"
            if c.independent
            else "redundant, takes no freedom"
        )
        return f"holonomic: {count} f(q) = 0, {takes}"
    if not c.independent:
        return "integrable: its velocities are zero by what holds positions, it takes no freedom"
    growth = vector(c.growth or ())
    if c.doubtful:
        least = (
            "alone, brackets of its velocities reach at least "
            f"{counted(c.reaches or 0, 'dimension')}, {growth}"
        )
        return f"{least}; whether it is integrable is beyond the digits of numbers"
    if c.kind == "integrable":
        held = counted(c.independent, "function")
        stay = counted(c.reaches or 0, "dimension")
        alone = f"integrable: alone, brackets of its velocities add nothing, {growth}"
        return f"{alone}: it holds {held} of position, so motions stay in {stay}"
    part = ""
    if c.integrable:
        part = (
            f"; {c.integrable} of its {counted(c.independent, 'freedom')} "
            f"{verb(c.integrable, 'is', 'are')} integrable"
        )
    return (
        "nonholonomic: alone, brackets of its velocities reach "
        f"{counted(c.reaches or 0, 'dimension')}, {growth}{part}"
    )


def reasons(c: Classification) -> list[str]:
    """Growth and what follows from it, line by line."""
    if c.growth_around is None or c.growth_around == () or c.position_dof == c.velocity_dof:
        return [c.why] if c.why else []
    out: list[str] = []
    if c.growth is not None:
        out.append(
            f"{vector(c.growth, c.degree is None)} at q"
            + (f", degree {c.degree}" if c.degree else "")
        )
    if c.singular:
        out.append(f"{vector(c.growth_around)} at configurations around: q is singular")
    if c.why:
        out.append(c.why)
    return out


def proof(c: Classification) -> list[str]:
    """What is proven, and how."""
    if c.growth_around is None or c.position_dof == c.velocity_dof:
        return []
    out: list[str] = []
    if c.kind == "integrable" and not c.doubtful:
        out.append(
            "brackets of two velocities add nothing at a configuration drawn at random, so nowhere "
            "around: motions stay on surfaces (Frobenius, 1877)"
        )
    elif c.reachable_dimension is not None:
        out.append(
            "what brackets span is tangent to what motions reach (Chow, 1939; Nagano, 1966; "
            "Sussmann, 1973)"
        )
        if c.reachable_dimension < c.position_dof and not c.doubtful:
            out.append(
                "longer brackets add nothing at a configuration drawn at random among those that "
                "motions reach"
            )
    out.append(
        "ranks are decided by singular values against an estimate of rounding"
        + ("; one of them is doubtful" if c.doubtful else "")
    )
    return out


def lines(c: Classification) -> list[tuple[str, list[str]]]:
    """The report as (title, lines)."""
    out = [("growth", reasons(c)), ("known by", proof(c))]
    if c.moved > SEEN:
        out.insert(
            0, ("start", [f"q is {c.moved:.3g} away from what was given, which was not closed"])
        )
    each = [str(x) for x in c.constraints.values()]
    out.append(("constraints", cut(each, SHOWN)))
    if c.one_sided is not None:
        out.append(("one-sided", [c.one_sided.sentence, *c.one_sided.lines]))
    return [(title, own) for title, own in out if own]


def data(c: Classification) -> dict[str, Any]:
    """All numbers and texts as plain Python, ready for JSON."""
    return {
        "name": c.name,
        "sentence": sentence(c),
        "q": c.q.tolist(),
        "kind": c.kind,
        "position_dof": c.position_dof,
        "velocity_dof": c.velocity_dof,
        "growth": None if c.growth is None else list(c.growth),
        "growth_around": None if c.growth_around is None else list(c.growth_around),
        "degree": c.degree,
        "reachable_dimension": c.reachable_dimension,
        "reachable_around": c.reachable_around,
        "singular": c.singular,
        "doubtful": c.doubtful,
        "why": c.why,
        "moved": c.moved,
        "one_sided": None if c.one_sided is None else c.one_sided.data(),
        "constraints": {
            k: {
                "kind": x.kind,
                "rows": list(x.rows),
                "independent": x.independent,
                "integrable": x.integrable,
                "doubtful": x.doubtful,
                "reaches": x.reaches,
                "growth": None if x.growth is None else list(x.growth),
                "sentence": x.sentence,
            }
            for k, x in c.constraints.items()
        },
    }
