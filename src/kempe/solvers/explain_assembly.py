"""Why loops could not be closed: which is open, by how much, and whether limits or the known values prevent it."""

from __future__ import annotations

import math

import numpy as np

from kempe.solvers.assembled import BAD_INPUT, CLOSED, OTHER_BRANCH, OUTSIDE, Assembly
from kempe.solvers.assembly import FEW, Assembler, freedoms_left
from kempe.solvers.home import home_of
from kempe.spatial import Array


def sentence(answer: Assembly, index: tuple[int, ...]) -> str:
    """The sentence for one configuration of an assembly."""
    bound = answer.assembler
    code, residual, steps, starts = (
        np.asarray(x)[index].item() for x in (answer.code, answer.residual, answer.iterations, answer.starts)
    )
    q = answer.q[index]
    if code == BAD_INPUT:
        return "known values, places or near are not finite"
    if code == CLOSED:
        left = freedoms_left(bound.system, q, bound.held) if 0 <= bound.freedoms else 0
        more = f"; {_count(left, 'freedom')} left open" if left else ""
        return f"closed: residual {residual:.1e} ({_count(steps, 'step')}, {_count(starts, 'start')}){more}"
    if code == OUTSIDE:
        return f"a known value is outside its limits: {_outside(bound, q)}"
    if code == OTHER_BRANCH:
        return "the branch asked for cannot be closed with these values; q is closed on another one"
    reason = _limits(bound, q) or _too_many(bound) or "with these values no closed configuration was found"
    return f"not closed after {_count(starts, 'start')}: {_open(bound, q)}; {reason}; q is the nearest to closing"


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def _outside(bound: Assembler, q: Array) -> str:
    texts = []
    for name, i, low, high in zip(bound.sources, bound.places, bound.low, bound.high, strict=True):
        if not low <= q[i] <= high:
            texts.append(f"{name} = {q[i]:.6g} is not in [{low:.6g}, {high:.6g}]")
    return ", ".join(texts)


def _open(bound: Assembler, q: Array) -> str:
    """The loop that is open most, in metres and radians."""
    system = bound.system
    worst, text = -1.0, "a place of a frame or a declared constraint is missed"
    error = system.closure_error(q)
    for name, e in zip(system.closures, error, strict=True):
        apart, turned = float(np.linalg.norm(e[:3])), float(np.linalg.norm(e[3:]))
        size = math.hypot(apart / bound.loops.length, turned)
        if size > worst and size > 1e-9:
            worst = size
            text = f"the loop of joint {name!r} stays open by {apart:.6g} m"
            text += f" and {turned:.3g} rad" if turned > 1e-9 else ""
    return text


def _limits(bound: Assembler, q: Array) -> str:
    """Whether it closes without the limits, and which coordinates are then outside."""
    system = bound.system
    if bound.frames or not np.isfinite(system.limits).any():
        return ""
    free, _, info = bound.run(q[None], bound.no_pins, limits=False)
    if info[0, 0] != CLOSED:
        return ""
    v = system.difference(system.neutral, free[0])
    slack = 1e-9
    names = [n for n, x, low, high in zip(system.velocity_names, v, system.lower, system.upper, strict=True)
             if not low - slack <= x <= high + slack]  # fmt: skip
    return f"the limits of {', '.join(map(repr, names))} prevent it" if names else ""


def _too_many(bound: Assembler) -> str:
    """Whether more is given than the system has freedoms where it is closed."""
    system = bound.system
    home = home_of(system)
    if not bound.held or len(bound.loops.names) > FEW or np.abs(system.closure_error(home)).max(initial=0.0) > 1e-9:
        return ""
    freedoms = freedoms_left(system, home)
    if len(bound.held) <= freedoms:
        return ""
    return f"{len(bound.held)} coordinates are given, but it has {_count(freedoms, 'freedom')}"
