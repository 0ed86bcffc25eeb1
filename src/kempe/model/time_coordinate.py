"""Systems whose equations depend on time: the time as a fixed number, or as a coordinate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import explain_errors, numbers
from kempe.arrays import check_range
from kempe.constraints.base import Constraint
from kempe.constraints.tape import TIME
from kempe.description.mechanism import Mechanism, choose_unused_name
from kempe.errors import InputError
from kempe.model.model import keep_answers

if TYPE_CHECKING:
    from kempe.model.model import Model, SystemType


def list_timed_constraints(system: Model) -> tuple[str, ...]:
    """List the names of position constraints that depend on time."""
    held = system._mechanism.constraints.values()
    return tuple(
        c.name
        for c in held
        if getattr(c.of, "time", False) and not any(r.velocity for r in c.of.list_rows(system.dim))
    )


@explain_errors
def fix_time(system: SystemType, t: float) -> SystemType:
    """Return the system at the time t in seconds, with the same coordinates. Errors: `InputError`."""
    if np.ndim(t) or not np.isfinite(numbers(t, "t")):
        raise InputError(
            f"t is {t!r}; it must be one finite number; drive(times=...) takes several"
        )
    if not t or not list_timed_constraints(system):
        return system
    check_range(np.asarray(t), f"parameter {TIME!r}")
    zero = _add_time_parameter(system)
    mechanism = zero.mechanism
    mechanism.parameters[TIME] = float(t)
    return type(zero)(mechanism, zero.structure.topology)


def fix_known_time(
    system: SystemType, known: Mapping[str, Any]
) -> tuple[SystemType, Mapping[str, Any]]:
    """Return the system at the time that is `known` as "t", and the other known values.

    Errors: `InputError`.
    """
    if (
        TIME in system.coordinate_names
        or TIME in system.frame_names
        or not list_timed_constraints(system)
    ):
        return system, known
    return fix_time(system, known[TIME]), {name: x for name, x in known.items() if name != TIME}


@keep_answers
def _add_time_parameter(system: SystemType) -> SystemType:
    """Return the system with the time as a parameter, 0 at first."""
    m = _make_time_an_input(system, ())
    m.parameter(TIME, 0.0)
    return type(system)(m)


@keep_answers
def add_time_coordinate(system: SystemType) -> SystemType:
    """Return the system with the time as its last coordinate.

    It is a prismatic coordinate that appears in equations only, in no pose.
    """
    m = _make_time_an_input(system, (TIME,))
    m.prismatic(TIME, m.ground, m.body(choose_unused_name(m, "clock")), axis="x")
    return type(system)(m)


def _make_time_an_input(system: Model, more: tuple[str, ...]) -> Mechanism:
    """Return the mechanism with the time as an ordinary name in its equations.

    `more` are added to the coordinates of these equations.
    """
    m = system.mechanism
    names = list_timed_constraints(system)
    if TIME in m.parameters or TIME in m.joints or TIME in m.constraints:
        raise InputError(
            f"constraint {names[0]!r} depends on the time {TIME!r}, and something else is called "
            "so: rename that"
        )
    m.constraints = {
        n: replace(c, of=_add_time_to_constraint(c.of, more)) if n in names else c
        for n, c in m.constraints.items()
    }
    return m


def _add_time_to_constraint(of: Any, more: tuple[str, ...]) -> Constraint:
    """Return a constraint that reads the time as an ordinary name."""
    expression = of.expression
    from kempe.constraints.equations import Call

    if isinstance(expression, Call):
        names = (*expression.inputs, TIME)
        expression = replace(
            expression,
            function=_add_time_to_function(expression.function),
            inputs=names,
            of=(*expression.of, TIME),
            time=False,
        )
    return replace(of, expression=expression, of=(*of.of, *more), time=False)


def _add_time_to_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function with the time among its named inputs."""

    def call_with_time(x: Mapping[str, float]) -> Any:
        """Call the function with its inputs and the time."""
        return function({n: v for n, v in x.items() if n != TIME}, x[TIME])

    return call_with_time
