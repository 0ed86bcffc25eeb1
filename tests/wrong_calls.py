"""Wrong calls of everything that is public, drawn by the names and signatures of what is called."""

from __future__ import annotations

import functools
import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

import kempe
from kempe import Mechanism, System, poses, spatial, tasks
from kempe.description import dh
from kempe.equations import closure_rows

SYSTEMS = (
    "puma560",
    "panda",
    "two_link",
    "four_bar",
    "bennett",
    "joint_spherical",
    "slider_crank",
    "nothing",
)
FORWARDED = re.compile(r"from (kempe[\w.]+) import (\w+)(?: as \w+)?\n(?:.*\n)*? *return \2?")
LEFT_OUT = {
    "save",
    "plot",
    "plot_spaces",
    "plot_tree",
    "animate",
    "show",
    "save_html",
    "run",
    "workspace",
}
"""Methods that write files or draw, and one that solvers call with arrays of theirs."""


class Odd:
    """An object of the caller's own, of which nothing can be made."""


def wrong_values(rng: np.random.Generator) -> list[Any]:
    """Values that are wrong for nearly every argument, and fresh."""
    return [
        None,
        True,
        "",
        "abc",
        "x",
        "tool",
        "A",
        "1.0",
        b"abc",
        -1,
        0,
        3,
        2**31,
        2**63,
        10**400,
        -(2**70),
        1.5,
        float("nan"),
        float("inf"),
        -0.0,
        1e308,
        1e101,
        1j,
        [],
        (),
        {},
        set(),
        {"q9": 1.0},
        {1: 2},
        {"A": "x"},
        {"A": None},
        {None: 1.0},
        {"q1": [1, 2]},
        ["tool"],
        [["tool"]],
        [None] * 6,
        ["a", 1],
        [1, [2, 3]],
        [[]],
        ("tool", "A"),
        {"tool"},
        np.zeros(0),
        np.zeros((0, 6)),
        np.zeros(7),
        np.zeros((3, 3)),
        np.eye(3),
        np.eye(4),
        np.zeros((2, 3, 4)),
        np.full(6, np.nan),
        np.full((4, 4), np.nan),
        np.full(6, np.inf),
        np.full(6, 1e101),
        np.full(6, 1e308),
        np.array(["a", "b"]),
        np.array([None, 1.0]),
        np.array([[1, 2], [3]], dtype=object),
        np.array(3.0),
        np.array("x"),
        np.arange(6) * 1j,
        np.ma.array([1.0, 2.0], mask=[0, 1]),
        np.zeros((2, 4, 4)),
        np.array(["2020-01-01"], "M8[D]"),
        np.zeros(6, dtype=bool),
        np.zeros((1000, 1)),
        rng.normal(size=6),
        rng.normal(size=(2, 6)),
        rng.normal(size=(4, 4)),
        date(2020, 1, 1),
        Odd(),
        Odd,
        len,
        lambda *a: None,
        iter([1, 2]),
        (i for i in range(2)),
        range(3),
        slice(1),
        Path("nowhere"),
        Ellipsis,
        NotImplemented,
        type(None),
        Exception("x"),
        np.float32(2),
        np.int8(-3),
        np.bool_(True),
    ]


def nothing(*_: Any) -> None:
    """A function that answers nothing."""


def systems() -> dict[str, System]:
    """Robots, closed loops, planar and in space, one with a quaternion, one with nothing in it."""
    out = {name: kempe.load(name) for name in SYSTEMS if name != "nothing"}
    return out | {"nothing": Mechanism("nothing").build()}


@dataclass(frozen=True)
class Call:
    """One wrong call: of what, with what, and how it is written."""

    function: Callable[..., Any]
    args: tuple[Any, ...]
    options: dict[str, Any]
    title: str

    def __str__(self) -> str:
        given = [shown(a) for a in self.args] + [f"{k}={shown(v)}" for k, v in self.options.items()]
        return f"{self.title}({', '.join(given)})"


def shown(x: Any) -> str:
    """An argument as text of one line."""
    if isinstance(x, np.ndarray) and x.size > 16:
        return f"array{x.shape}"
    text = re.sub(r"\s+", " ", repr(x))
    return text if len(text) < 120 else f"{text[:117]}..."


def signature_of(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """The parameters of a function; where it hands options on to another, the options of that."""
    try:
        given = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):
        return []
    if not given or given[-1].kind is not inspect.Parameter.VAR_KEYWORD:
        return given
    known = {p.name for p in given}
    for module, name in re.findall(
        r"from (kempe[\w.]+) import (\w+)\n", inspect.getsource(function)
    ):
        handed = getattr(importlib.import_module(module), name)
        more = inspect.signature(handed).parameters.values()
        given += [
            p for p in more if p.kind is inspect.Parameter.KEYWORD_ONLY and p.name not in known
        ]
    if function.__qualname__.startswith("Mechanism."):
        given += [
            p
            for p in inspect.signature(Mechanism.joint).parameters.values()
            if p.name not in known | {"self", "kind"}
        ]
    return given


def right_value(name: str, system: System | None, rng: np.random.Generator) -> Any:
    """A value that an argument of this name may well have, or `Ellipsis`."""
    if system is None or rng.random() < 0.3:
        return rightly(name, systems_cache["puma560"], rng)
    return rightly(name, system, rng)


systems_cache: dict[str, System] = {}


def rightly(name: str, system: System, rng: np.random.Generator) -> Any:
    """A value that an argument of this name may well have for a system, or `Ellipsis`."""
    frame = system.frame_names[-1]
    coordinates = system.coordinate_names
    first, last = (coordinates[0], coordinates[-1]) if coordinates else ("", "")
    ground = system.body_names[0]
    body = system.body_names[-1]
    q = system.mid
    draw: dict[str, Callable[[], Any]] = {
        "q": lambda: q,
        "q0": lambda: q,
        "q1": lambda: q,
        "near": lambda: q,
        "seed": lambda: q,
        "start": lambda: q,
        "v": lambda: np.zeros(system.nv),
        "t": lambda: 0.5,
        "frame": lambda: frame,
        "frames": lambda: [frame],
        "target": lambda: system.fk(q, frame),
        "targets": lambda: np.stack([system.fk(q, frame)] * 3),
        "wanted": lambda: np.zeros(6),
        "dt": lambda: 0.01,
        "other": lambda: system.frame_names[0],
        "tasks": lambda: [tasks.Position(frame, system.fk(q, frame)[:3, 3])],
        "task": lambda: "position",
        "known": lambda: dict.fromkeys(coordinates[:1], 0.5),
        "inputs": lambda: list(coordinates[:1]),
        "outputs": lambda: list(coordinates[-1:]),
        "input": lambda: first,
        "output": lambda: last,
        "driver": lambda: first,
        "joint": lambda: system.joint_names[-1] if system.joint_names else "",
        "coordinates": lambda: {"q1": 0.1},
        "actuated": lambda: list(coordinates[:1]),
        "prefer": lambda: list(coordinates[:1]),
        "rng": lambda: 1,
        "starts": lambda: 2,
        "iterations": lambda: 10,
        "time_limit": lambda: 0.2,
        "threads": lambda: 1,
        "times": lambda: [0.0, 1.0],
        "poses": lambda: system.fk(q)[1:],
        "base": lambda: ground,
        "tip": lambda: frame,
        "tolerance": lambda: 1e-6,
        "name": lambda: "name",
        "kind": lambda: "revolute",
        "parent": lambda: ground,
        "child": lambda: body,
        "a": lambda: ground,
        "b": lambda: body,
        "at": lambda: (0.1, 0.0, 0.0),
        "length": lambda: 0.3,
        "body": lambda: frame,
        "axis": lambda: (0.0, 0.0, 1.0),
        "parameter": lambda: first or None,
    }
    return draw[name]() if name in draw else ...


def call_of(
    title: str,
    function: Callable[..., Any],
    system: System | None,
    rng: np.random.Generator,
    short: bool = False,
) -> Call | None:
    """A wrong call of one function: some arguments as they should be, at least one drawn from the
    wrong ones.
    """
    parameters = [p for p in signature_of(function) if p.name not in ("self", "where", "out")]
    wrong = wrong_values(rng)

    def bad(p: inspect.Parameter) -> Any:
        value = wrong[rng.integers(len(wrong))]
        # whose errors are the caller's
        return (
            nothing
            if callable(value) and re.search("Callable|Progress", str(p.annotation))
            else value
        )

    args = []
    options = {}
    named = False
    must = rng.integers(len(parameters)) if parameters else -1
    for i, p in enumerate(parameters):
        if p.kind is inspect.Parameter.VAR_KEYWORD:
            if rng.random() < 0.12 or len(parameters) == 1:
                options[str(rng.choice(["bogus", "starst", "frame_", "q1", "l1", "seeds"]))] = bad(
                    p
                )
            continue
        if p.kind is inspect.Parameter.VAR_POSITIONAL:
            continue
        required = p.default is inspect.Parameter.empty
        if not required and i != must and rng.random() < 0.75:
            named = True
            continue
        value = bad(p) if i == must or rng.random() < 0.15 else right_value(p.name, system, rng)
        if value is ...:
            value = bad(p) if required or i == must else p.default
        if named or p.kind is inspect.Parameter.KEYWORD_ONLY:
            options[p.name] = value
        else:
            args.append(value)
    names = {p.name for p in parameters}
    if "time_limit" in names and "time_limit" not in options and len(args) < len(parameters):
        options["time_limit"] = 0.3
    return Call(function, tuple(args), options, title)


EXTREMES: tuple[Any, ...] = (
    np.inf, -np.inf, np.nan, 1e300, -1e300, 1e308, 1e200, 1e155, 1e101, 1e99, 1e50, 1e15, -1e15, 1e-300, 5e-324,
    10**15, 2**63, -(10**30), 10**400,
)  # fmt: skip
"""Numbers with which nothing overflows silently: each is refused, or has an answer."""
NUMBERS = re.compile(
    "Array|float|int|Number|Value|Point|Any|Direction|Matrix|Rotation|Mapping|object"
)
NO_NUMBERS = {
    "ax",
    "budget",
    "index",
    "frame",
    "other",
    "progress",
    "expression",
    "function",
    "derivative",
    "symbols",
    "client",
    "where",
}
USUAL: dict[str, Any] = {
    "R": np.eye(3),
    "X": np.eye(4),
    "p": np.zeros(3),
    "w": np.full(3, 0.3),
    "twist": np.full(6, 0.3),
    "angle": 0.3,
    "rpy": np.full(3, 0.3),
    "quat_wxyz": np.array([1.0, 0.0, 0.0, 0.0]),
    "values": np.full(6, 0.3),
    "particles": np.eye(3),
    "places": np.eye(3) + 0.1,
    "rows": [[0.3, 0.1, 0.2, 0.4]] * 2,
    "home": np.eye(4),
    "screws": [[0, 0, 1, 0, 0, 0], [0, 0, 1, 0, -1, 0]],
    "points": [[0.0, 0, 0], [0.1, 0, 0], [0.2, 0.1, 0]],
    "low": (-1.0, -1.0, -1.0),
    "high": (1.0, 1.0, 1.0),
    "target": (0.1, 0.2, 0.3),
    "direction": (0.0, 0.0, 1.0),
    "normal": (0.0, 0.0, 1.0),
    "reference": (0.0, 0.0, 1.0),
    "dt": 0.01,
    "radius": 0.1,
    "duration": 0.5,
    "u": [0.5],
    "matrix": [[1.0]],
    "of": ["A"],
    "sources": {"A": 2.0},
    "ratio": 2.0,
    "limits": {"A": (-1.0, 1.0)},
}
"""Numbers that arguments of these names may be, where no system gives better ones."""


def spoiled(right: Any, rng: np.random.Generator) -> Any:
    """Numbers of which some, or the shape, are extreme."""
    x = EXTREMES[rng.integers(len(EXTREMES))]
    if isinstance(right, dict):
        return dict.fromkeys(right or {"A": 0.0}, x)
    try:
        array = np.array(right, dtype=float)
    except (TypeError, ValueError):
        return x
    if not array.ndim or not array.size:
        return x
    number = float(max(min(x, 10**308), -(10**308))) if isinstance(x, int) else x
    with np.errstate(all="ignore"):
        one = np.where(
            np.arange(array.size).reshape(array.shape) == rng.integers(array.size), number, array
        )
        cases = [
            np.full(array.shape, number),
            one,
            array * number,
            np.full((*array.shape, 2), number),
            array[0],
        ]
    given = cases[rng.integers(len(cases))]
    return given if rng.random() < 0.7 else given.tolist()


def extreme_call_of(
    title: str, function: Callable[..., Any], system: System | None, rng: np.random.Generator
) -> Call | None:
    """A call with right arguments, of which one that takes numbers is spoiled; None where none
    takes any.
    """
    parameters = [
        p for p in signature_of(function) if p.name not in ("self", "where", "out", "time_limit")
    ]
    parameters = [p for p in parameters if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    able = [
        p.name for p in parameters if p.name not in NO_NUMBERS and NUMBERS.search(str(p.annotation))
    ]
    if not able:
        return None
    bad = str(rng.choice(able))
    options = {}
    for p in parameters:
        right = USUAL.get(p.name, ...) if system is None else rightly(p.name, system, rng)
        if p.name == "inputs" and system is not None and title.endswith("drive"):
            right = {name: [0.5, 0.6] for name in system.coordinate_names[:1]}
        right = USUAL.get(p.name, 0.3) if right is ... else right
        if p.name == bad:
            options[p.name] = spoiled(right, rng)
        elif p.default is p.empty:
            options[p.name] = right
        elif p.name == "budget":
            options[p.name] = kempe.Budget(time_limit=0.5)
    args = [
        options.pop(p.name) for p in parameters if p.kind is p.POSITIONAL_ONLY and p.name in options
    ]
    return Call(function, tuple(args), options, title)


def answers(system: System) -> Iterator[tuple[str, Any]]:
    """Answers of a system, of each kind that it has."""
    frame = system.frame_names[-1]
    q = system.mid
    yield "query", system.query(frame)
    if system.nq == 0:
        return
    X = system.fk(q, frame)
    first = system.coordinate_names[0]
    made: list[tuple[str, Callable[[], Any]]] = [
        ("ik", lambda: system.ik(X, frame)),
        ("iks", lambda: system.ik(np.stack([X, X]), frame)),
        ("reach", lambda: system.ik([tasks.Position(frame, X[:3, 3])])),
        ("ik_all", lambda: system.ik_all(X, frame)),
        ("ik_alls", lambda: system.ik_all(np.stack([X, X]), frame)),
        ("ik_plan", lambda: system.inverse.plan(frame)),
        ("path", lambda: system.ik_path(np.stack([X, X]), frame, q)),
        ("step", lambda: system.ik_step(q, X, frame, 0.01)),
        ("self_motion", lambda: system.inverse.self_motion(q, frame)),
        ("sweep", lambda: system.inverse.sweep(X, frame)),
        ("assemble", lambda: system.assemble({first: 0.5})),
        ("assembler", lambda: system.loops.assembler([first])),
        ("modes", lambda: system.assembly_modes({first: 0.5})),
        ("closed_form", lambda: system.loops.closed_form([first])),
        ("trace", lambda: system.trace(first)),
        ("drive", lambda: system.drive({first: [0.5, 0.6]}, [0.0, 1.0])),
        ("mobility", lambda: system.mobility()),
        ("independent", lambda: system.independent()),
        (
            "loop_jacobian",
            lambda: system.loops.jacobian(system.assemble({first: 0.5}).q, [first], [frame]),
        ),
        ("space", lambda: system.configuration_space),
    ]
    for title, make in made:
        try:
            yield title, make()
        except (kempe.KempeError, ValueError):
            continue


def public(thing: Any) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Public methods of an object, with its calls, indices and attributes."""
    for name in dir(thing):
        if name.startswith("_") and name != "__call__" or name in LEFT_OUT:
            continue
        if inspect.isfunction(inspect.getattr_static(type(thing), name, None)):
            yield name, getattr(thing, name)


def fresh(system: System, name: str) -> Callable[..., Any]:
    """A method of the description of a system, of a new copy at each call."""

    @functools.wraps(getattr(Mechanism, name))
    def call(*args: Any, **options: Any) -> Any:
        return changed_only_if_done(system.mechanism, name, args, options)

    return call


def changed_only_if_done(
    mechanism: Mechanism, name: str, args: tuple[Any, ...], options: dict[str, Any]
) -> Any:
    """What a method answers. A call that is refused changes nothing; after one that is not, the
    system can be built.
    """
    before = mechanism.content()
    try:
        answer = getattr(mechanism, name)(*args, **options)
    except kempe.KempeError:
        assert mechanism.content() == before, "a refused call has changed the mechanism"
        raise
    mechanism.build()
    return answer


@functools.cache
def functions() -> list[tuple[str, Callable[..., Any], System | None]]:
    """All that is called: methods of systems, mechanisms and answers, tasks, functions of modules."""
    systems_cache.update(systems())
    out: list[tuple[str, Callable[..., Any], System | None]] = []
    for name, system in systems_cache.items():
        out += [(f"{name}.{n}", f, system) for n, f in public(system)] * 3
        for family in ("structure", "configuration_space", "loops", "inverse", "symbolic"):
            out += [
                (f"{name}.{family}.{n}", f, system) for n, f in public(getattr(system, family))
            ] * 3
        out += [
            (f"{name}.mechanism.{n}", fresh(system, n), system) for n, _ in public(system.mechanism)
        ]
        for title, answer in answers(system):
            out += [(f"{name}.{title}.{n}", f, system) for n, f in public(answer)]
    for title, module in (("tasks", tasks), ("spatial", spatial)):
        names = getattr(module, "__all__", dir(module))
        found = [(n, getattr(module, n)) for n in names if not n.startswith("_")]
        out += [
            (f"{title}.{n}", f, None)
            for n, f in found
            if callable(f)
            and f.__module__.startswith(
                module.__name__.rpartition(".")[0] if module is tasks else module.__name__
            )
            and f is not tasks.Task
        ] * 3
    out += [
        (f"kempe.{f.__name__}", f, None)
        for f in (
            kempe.load,
            kempe.read,
            dh.from_dh,
            dh.from_screws,
            poses.place,
            Mechanism,
            closure_rows.list_constraints,
        )
    ] * 5
    return out
