"""Former names of arguments: accepted with a warning that says the present one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from kempe.errors import InputError, warn

STARTS = ("seed", "near")
"""Former names of `start`, the configuration that a verb starts from."""

SPENT = {"max_points": "points", "steps": "points", "samples": "points"}
"""Fields of a `Budget` by their former names where these differ."""

Change = Callable[[dict[str, Any], Any], str]
"""Puts a value into the arguments as they are called at present, and says how."""


def _axis(arguments: dict[str, Any], value: Any) -> str:
    if arguments.get("task") is not None:
        arguments["task"] = (arguments["task"], value)
    return "task=(name, axis)"


def _position_only(arguments: dict[str, Any], value: Any) -> str:
    if value and arguments.get("task") not in (None, "position"):
        raise InputError(f"task is {arguments['task']!r}, but position_only asks for 'position'")
    if value:
        arguments["task"] = "position"
    return "task='position'"


def _preferred(name: str) -> Change:
    def change(arguments: dict[str, Any], value: Any) -> str:
        if value and arguments.get("prefer") is not None:
            raise InputError(f"prefer is {arguments['prefer']!r}, and {name} is requested, too; give one of them")
        if value:
            arguments["prefer"] = name
        return f"prefer={name!r}"

    return change


def _given(name: str, usual: Any, present: Any, said: str) -> Change:
    def change(arguments: dict[str, Any], value: Any) -> str:
        if bool(value) is not usual and arguments.get(name) != "turns":
            arguments[name] = present
        return said

    return change


def _time(arguments: dict[str, Any], value: Any) -> str:
    if value:
        arguments["known"] = {**(arguments.get("known") or {}), "t": value}
    return "known={'t': ...}"


def _reference(arguments: dict[str, Any], value: Any) -> str:
    if value is not None:
        arguments["parameter"] = ("arm_angle", value)
    return "parameter=('arm_angle', reference)"


CHANGES: dict[tuple[str, str], Change] = {
    ("axis", "task"): _axis,
    ("position_only", "task"): _position_only,
    ("nearest", "prefer"): _preferred("nearest"),
    ("continuous", "prefer"): _preferred("continuous"),
    ("inside_only", "limits"): _given("limits", False, True, "limits=True"),
    ("expand_turns", "limits"): _given("limits", False, "turns", "limits='turns'"),
    ("both", "ways"): _given("ways", True, "forward", "ways='forward'"),
    ("switch", "ways"): _given("ways", False, "branches", "ways='branches'"),
    ("reference", "parameter"): _reference,
    ("t", "known"): _time,
}
"""What is done with a former argument, by its name and that of the present one."""


def renamed(
    function: Callable[..., Any], args: tuple[Any, ...], options: Mapping[str, Any]
) -> tuple[dict[str, Any], Callable[[Any], Any]] | None:
    """The arguments of a call in which some have their former names, and what is then done with the answer.

    None for all other calls. Errors: `InputError` where both names are given.
    """
    from inspect import signature

    from kempe.budget import Budget

    parameters = signature(function).parameters
    former = {name: value for name, value in options.items() if name not in parameters}
    if not former:
        return None
    try:
        bound = signature(function).bind_partial(*args, **{n: x for n, x in options.items() if n not in former})
    except TypeError:
        return None
    arguments, expected = bound.arguments, False
    said: dict[str, str] = {}
    spent: dict[str, Any] = {}
    known = {f.name for f in fields(Budget)}
    for name, value in former.items():
        own = next((c for (old, new), c in CHANGES.items() if old == name and new in parameters), None)
        if name in STARTS and "start" in parameters:
            if arguments.get("start") is not None or sum(n in former for n in STARTS) > 1:
                raise InputError(f"{name!r} is the former name of 'start', which is given, too; give start only")
            arguments["start"], said[name] = value, "start"
        elif own is not None:
            said[name] = own(arguments, value)
        elif (field := SPENT.get(name, name)) in known and "budget" in parameters:
            spent[field] = math.inf if field == "time_limit" and value is None else value
            said[name] = f"budget=Budget({field}=...)"
        elif name == "throw" and "budget" in parameters:
            expected, said[name] = bool(value), ".expect() of the answer"
        elif "fixed" in parameters and args and name in getattr(args[0], "system", args[0]).coordinate_names:
            if name in (arguments.get("fixed") or {}):
                raise InputError(f"{name!r} is held twice, by fixed and by name")
            arguments["fixed"] = {**(arguments.get("fixed") or {}), name: value}
            said[name] = "fixed={'" + name + "': ...}"
        else:
            return None
    if spent:
        given = arguments.get("budget") or Budget()
        arguments["budget"] = Budget(**{**{f: getattr(given, f) for f in known}, **spent})
    for name, present in said.items():
        warn(
            f"{name!r} is the former name of {present!r}"
            if present == "start"
            else f"{name!r} is a former name; the present one is {present}",
            DeprecationWarning,
        )
    return arguments, (lambda answer: answer.expect()) if expected else (lambda answer: answer)
