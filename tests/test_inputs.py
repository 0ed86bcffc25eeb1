"""What public functions are given: one reading of configurations and of numbers, found by
introspection.
"""

from __future__ import annotations

import importlib
import inspect
import re
from array import array
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hunts import some

import kempe
from kempe import namespaces, spatial, tasks
from kempe.errors import InputError, KempeError
from kempe.model.model import Structure
from kempe.spaces.configuration_space import ConfigurationSpace

FAMILIES: dict[str, type] = {
    "structure": Structure,
    "configuration_space": ConfigurationSpace,
    "loops": namespaces.Loops,
    "inverse": namespaces.Inverse,
    "reach": namespaces.ReachStudies,
    "symbolic": namespaces.Symbolic,
}
REFERENCE = (Path(__file__).parent.parent / "docs" / "api").glob("*.md")
API = "".join(page.read_text(encoding="utf-8") for page in sorted(REFERENCE))


def listed() -> dict[str, Callable[..., Any]]:
    """Every function that the reference lists, and every method of a system, by name; each takes a
    system first.
    """
    out: dict[str, Callable[..., Any]] = {}
    for name in re.findall(r"autofunction:: (kempe\.[\w.]+)", API):
        module, _, function = name.rpartition(".")
        out[name] = getattr(importlib.import_module(module), function)
    for module in re.findall(r"automodule:: (kempe\.[\w.]+)", API):
        for name, function in vars(importlib.import_module(module)).items():
            if (
                inspect.isfunction(function)
                and function.__module__ == module
                and not name.startswith("_")
            ):
                out[f"{module}.{name}"] = function
    for name, function in vars(kempe.System).items():
        if inspect.isfunction(function) and not name.startswith("_"):
            out[f"System.{name}"] = function
    for family, kind in FAMILIES.items():
        for name, function in vars(kind).items():
            if inspect.isfunction(function) and not name.startswith("_"):
                out[f"System.{family}.{name}"] = through(family, function, f"{family}_{name}")
    return out


def through(family: str, function: Callable[..., Any], title: str) -> Callable[..., Any]:
    """A method of a namespace as a function of the system."""

    @wraps(function)
    def call(system: kempe.System, *args: Any, **options: Any) -> Any:
        return function(getattr(system, family), *args, **options)

    call.__name__ = title
    return call


LISTED = listed()
OF_SYSTEMS = {
    k: f
    for k, f in LISTED.items()
    if next(iter(inspect.signature(f).parameters), "") in ("self", "system")
}
OF_ARRAYS = {k: f for k, f in LISTED.items() if k.startswith("kempe.spatial.")}


class Series:
    """What numpy reads by position and a person by name, as a pandas Series is."""

    ndim = 1

    def __init__(self, values: Any, names: Any):
        self.values = np.asarray(values)
        self.names = list(names)

    def keys(self) -> list[Any]:
        return self.names

    def __getitem__(self, name: Any) -> Any:
        return self.values[..., self.names.index(name)]

    def __len__(self) -> int:
        return len(self.values)

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.array(self.values, dtype=dtype)


class Frame(Series):
    """As a pandas DataFrame is."""

    ndim = 2

    @property
    def columns(self) -> list[Any]:
        return self.names


def tables(q: np.ndarray, names: tuple[str, ...]) -> dict[str, Any]:
    """A configuration (nq,), or several, labelled by name in another order, in the ways in which
    people have it.
    """
    back = list(reversed(names))
    one = q[0]
    many = q
    record = np.dtype([(n, float) for n in back])
    out = {
        "dict": (one, {n: one[names.index(n)] for n in back}),
        "series": (one, Series(one[::-1], back)),
        "record": (one, np.array(tuple(one[::-1]), dtype=record)),
        "dict of arrays": (many, {n: many[:, names.index(n)] for n in back}),
        "frame": (many, Frame(many[:, ::-1], back)),
        "list of dicts": (many, [{n: row[names.index(n)] for n in back} for row in many]),
        "list of series": (many, [Series(row[::-1], back) for row in many]),
        "series and array": (many, [Series(many[0, ::-1], back), *many[1:]]),
        "records": (many, np.array([tuple(row[::-1]) for row in many], dtype=record)),
        "labels 0, 1, 2": (one, Series(one, range(len(names)))),
        "message": (one, SimpleNamespace(name=back, position=array("d", one[::-1]), effort=[])),
        "messages": (many, [SimpleNamespace(name=back, position=row[::-1]) for row in many]),
    }
    try:
        import pandas as pd
    except ImportError:
        return out
    frame = pd.DataFrame(many[:, ::-1], columns=back)
    return out | {
        "pandas series": (one, frame.iloc[0]),
        "pandas frame": (many, frame),
        "pandas default": (many, pd.DataFrame(many)),
        "pandas rows": (many, list(frame.itertuples(index=False))),
        "pandas nullable": (many, frame.astype("Float64")),
        "pandas records": (many, frame.to_records(index=False)),
        "list of pandas series": (many, [row for _, row in frame.iterrows()]),
    }


# ---- what a call needs, by the name of the parameter


def usual(system: kempe.System, verb: str = "") -> dict[str, Any]:
    """Values that a verb takes, by the name of its parameter, at a configuration that is closed."""
    q = np.array(
        system.assemble({system.structure.velocity_names[0]: 1.0}).q
        if system.structure.closures
        else system.random(3)
    )
    name = system.coordinate_names[0]
    tip = system.frame_names[-1]
    other = system.coordinate_names[-1]
    X = system.fk(q, tip)
    rates = 3 * (system.dim - 1) * len(system.parent) if verb == "maximal_integrate" else system.nv
    return {
        "q": q,
        "q0": q,
        "q1": q,
        "v": np.full(rates, 0.1),
        "t": np.array(0.5),
        "frame": tip,
        "target": X,
        "targets": np.stack([X, X]),
        "seed": q,
        "near": q,
        "start": q,
        "known": {name: q[0]},
        "u": q[:1],
        "wanted": [kempe.tasks.Pose(tip, X)]
        if verb in ("reach", "reach_tasks")
        else np.full(6, 0.01),
        "coordinates": {name: 0.5},
        "dt": 0.01,
        "tasks": tip,
        "inputs": [name] if verb == "loops_jacobian" else {name: [1.0, 1.1]},
        "poses": system.fk(q)[1:],
        "outputs": [other],
        "input": name,
        "output": other,
        "at": X[: system.dim, 3] if verb == "workspace" else q,
        "joint": system.coordinate_names[-2],
        "toward": {name: 1.0},
        "direction": np.ones(3),
        "fixed": {name: q[0]},
        "driver": name,
        "limits": {name: (-2.0, 2.0)},
        "times": np.array([0.0, 1.0]),
        "base": q,
        "body": tip,
        "to": system.body_names[0],
        "hold": {name: q[0]},
        "reference": np.array([0.0, 0.0, 1.0]),
        "axis": np.array([0.0, 0.0, 1.0]),
        "velocity": np.ones(system.nv),
        "box": {"x": (-0.1, 0.1)} if verb.startswith("place") else [(-1.0, 1.0)] * system.dim,
        "velocity_limits": np.ones(system.nv),
        "weights": np.ones(6),
    }


NO_ARRAYS = {
    "self",
    "system",
    "options",
    "numbers",
    "frame",
    "joint",
    "input",
    "output",
    "inputs",
    "outputs",
    "driver",
}
NOT_REQUIRED = {
    "kempe.views.space_pictures.plot_spaces",  # of two freedoms, see test_space_pictures.py
    "System.structure.frame_name",
    "System.structure.coordinates_of_joint",  # no numbers
    "kempe.views.viewer.live.show",
    "kempe.views.viewer.pages.save_html",  # serve, write: see test_viewer.py
    "kempe.motion.transmission.compute_pressure_angle",  # by bodies, see test_transmission.py
    "System.manoeuvre",
    "System.simulate",  # of what rolls and bounces, see test_manoeuvre.py and test_simulate.py
    "kempe.motion.manoeuvre.manoeuvre",
    "kempe.motion.simulate.simulate",
    # of thousands of poses, see test_reach.py
    "kempe.workspace.capability.capability_map",
    "kempe.forward.neighbours.to_pinocchio",
    "kempe.forward.neighbours.from_pinocchio",
    "kempe.forward.neighbours.to_mujoco",
    "kempe.forward.neighbours.from_mujoco",
    "kempe.forward.neighbours.to_joint_state",
    "kempe.forward.neighbours.from_joint_state",  # of models of others, see test_neighbours.py
    "kempe.tasks.error",
    "kempe.tasks.jacobian",
    "kempe.tasks.count",
    "kempe.tasks.miss",  # see test_task_zoo.py
}


def call(function: Callable[..., Any], system: kempe.System, given: dict[str, Any]) -> Any:
    """The answer of a verb: what it needs from `usual`, and these besides."""
    parameters = list(inspect.signature(function).parameters.values())
    values = usual(system, function.__name__) | given
    more = ("dt",) if "tasks" not in given else ()
    if function.__name__ in ("ik_step", "ik", "ik_path"):
        more += ("frame",)
    needed = [
        p
        for p in parameters[1:]
        if (p.default is p.empty or p.name in more)
        and p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    ]
    own = {p.name: values[p.name] for p in needed} | given
    return function(system, **own)


def takes(function: Callable[..., Any], name: str) -> bool:
    return name in inspect.signature(function).parameters


def numbers(x: Any) -> list[np.ndarray]:
    """All arrays of numbers in an answer."""
    if isinstance(x, np.ndarray) and x.dtype.kind in "fib":
        return [x.astype(float)]
    if isinstance(x, (int, float, np.number)):
        return [np.array(float(x))]
    if isinstance(x, (list, tuple)):
        return [a for y in x for a in numbers(y)]
    if isinstance(x, dict):
        return [a for y in x.values() for a in numbers(y)]
    if is_dataclass(x) and not isinstance(x, type):
        return [
            a
            for f in fields(x)
            if f.name not in ("system", "task")
            for a in numbers(getattr(x, f.name))
        ]
    return []


def drawn(axes: Any) -> list[np.ndarray]:
    """What was drawn, as pixels."""
    axes.figure.set_dpi(40)
    axes.figure.canvas.draw()
    return [np.asarray(axes.figure.canvas.buffer_rgba(), dtype=float)]


def same(a: Any, b: Any) -> bool:
    x, y = (drawn(z) if hasattr(z, "get_xlim") else numbers(z) for z in (a, b))
    assert x, "the answer holds no numbers to compare"
    return len(x) == len(y) and all(
        p.shape == r.shape and np.allclose(p, r, rtol=0, atol=1e-9, equal_nan=True)
        for p, r in zip(x, y, strict=True)
    )


@pytest.fixture(scope="module")
def robots() -> dict[str, kempe.System]:
    return {
        name: kempe.load(name) for name in ("ur5", "four_bar", "iiwa14", "two_link", "slider_crank")
    }


QS = ("q", "q0", "q1")
PLACES = [
    (n, p) for n, f in OF_SYSTEMS.items() for p in QS if takes(f, p) and n not in NOT_REQUIRED
]
ARM_ONLY = {"self_motion", "arm_angle", "compute_arm_angle"}
LOOP_ONLY = {
    "mechanical_advantage",
    "compute_mechanical_advantage",
    "transmission_angle",
    "compute_transmission_angle",
    "find_dead_points",
    "independent",
}
ONE_Q = {
    "relative_motion",
    "find_relative_motion",
    "mobility",
    "self_motion",
    "ik_step",
    "q_dict",
    "find_local_dimension",
    "classify",
    "report_one_sided",
    "path",
    "find_connection",
    "task_space",
    "parametrizations",
}
"""Verbs that take one configuration."""


def places(without: set[str]) -> list:
    """Parameters of the tests below: verbs and their arguments that are configurations, but for
    some verbs.
    """
    return [
        pytest.param(n, p, id=f"{n}-{p}") for n, p in PLACES if n.rpartition(".")[2] not in without
    ]


def test_the_reference_names_the_verbs():
    """The tests below run over what they find: there is enough of it."""
    assert len(PLACES) > 30 and len(OF_SYSTEMS) > 60 and len(OF_ARRAYS) > 20


# ---- configurations by name


@pytest.mark.parametrize(("name", "place"), places(ARM_ONLY))
def test_named_coordinates_of_a_loop_are_closed(name, place, robots):
    """Every verb reads them as the configuration that `assemble` finds from home."""
    if name.rpartition(".")[2].startswith("plot"):
        pytest.importorskip("matplotlib")
    function = OF_SYSTEMS[name]
    system = robots["four_bar"]
    closed = system.assemble({"A": 0.7}).q
    assert np.abs(system.loops.closure_error(closed)).max() < 1e-12
    assert same(
        call(function, system, {place: {"A": 0.7}}), call(function, system, {place: closed})
    )
    with pytest.raises(InputError, match="must close them|no configuration|cannot"):
        call(function, robots["slider_crank"], {place: {"S": 1e3}})


def test_a_dict_of_a_loop_is_closed(robots):
    system = robots["four_bar"]
    assert system.q_dict({"A": 0.7}) == system.q_dict(system.assemble({"A": 0.7}).q)


@pytest.mark.parametrize(("name", "place"), some(places(LOOP_ONLY), 4))
def test_tables_are_read_by_name(name, place, robots):
    function = OF_SYSTEMS[name]
    short = name.rpartition(".")[2]
    if short.startswith("plot"):
        pytest.importorskip("matplotlib")
    arms = {
        "arm_angle": "iiwa14",
        "compute_arm_angle": "iiwa14",
        "self_motion": "iiwa14",
        "plot": "two_link",
    }
    system = robots[arms.get(short, "ur5")]
    q = np.array(system.random(5, 2))
    for kind, (plain, table) in tables(q, system.coordinate_names).items():
        if plain.ndim == 2 and short in ONE_Q:
            with pytest.raises(InputError):
                call(function, system, {place: table})
        else:
            assert same(
                call(function, system, {place: table}), call(function, system, {place: plain})
            ), kind


def test_bound_forms_read_by_name_too(robots):
    system = robots["ur5"]
    q = np.array(system.random(5, 2))
    f = system.query("tool")
    for kind, (plain, table) in tables(q, system.coordinate_names).items():
        assert same(f(table), f(plain)) and same(f.jacobian(table), f.jacobian(plain)), kind
        assert same(f.pose_and_jacobian(table), f.pose_and_jacobian(plain)), kind


@pytest.mark.parametrize(
    "model", ["four_bar", "slider_crank", "five_bar", "stewart", "jansen", "three_rpr", "rssr"]
)
def test_named_values_hunt(model, hunt):
    """What is named is kept, what is not closes the loops, or the reason is reported; the same each
    time.
    """
    system = kempe.load(model)
    rng = hunt.rng()
    names = [system.structure.velocity_names[i] for i in system.structure.layout.vector_v]
    closed = 0
    for _ in range(hunt.cases(20)):
        some = [
            str(n)
            for n in rng.choice(names, size=min(len(names), int(rng.integers(1, 4))), replace=False)
        ]
        at = system.assemble(start=system.random(rng))
        values = {n: float(system.q_dict(at.q)[n]) if at else float(rng.normal()) for n in some}
        try:
            X = system.fk(values)
        except InputError as error:
            assert all(n in str(error) for n in some)
            continue
        closed += 1
        q = system.assemble(values).q
        assert (
            np.array_equal(X, system.fk(q)) and np.abs(system.loops.closure_error(q)).max() < 1e-8
        )
        assert all(abs(system.q_dict(values)[n] - x) == 0.0 for n, x in values.items())
    assert closed


def test_all_named_is_an_array(robots):
    system = robots["four_bar"]
    q = np.array([0.1, 0.2, 0.3, 0.4])
    assert np.array_equal(system.fk(system.q_dict(q)), system.fk(q))
    assert np.array_equal(system.q({"A": 0.3}), [0.3, 0.0, 0.0, 0.0]), (
        "numbers are only written down"
    )


def test_rows_that_cannot_be_closed_are_named(robots):
    with pytest.raises(InputError, match="row 1 of q gives 'S' of a system with loops"):
        robots["slider_crank"].fk({"S": [0.3, 99.0, 0.3]})


@pytest.mark.parametrize(
    "table",
    [
        Series(np.zeros(6), "abcdef"),
        Series(np.zeros(6), [5, 4, 3, 2, 1, 0]),
        Series(np.zeros(6), ["elbow"] * 6),
        Frame(np.zeros((2, 6)), [1, 2, 3, 4, 5, 6]),
        Series(np.zeros(6), [0.0, 1.5, 2, 3, 4, 5]),
        SimpleNamespace(name=["elbow", "shoulder_pan"], position=[0.0]),
    ],
    ids=["other names", "other places", "twice", "from 1 on", "numbers", "names without numbers"],
)
def test_labels_that_say_something_else_are_refused(table, robots):
    for ask in (lambda: robots["ur5"].fk(table, "tool"), lambda: robots["ur5"].fk([table], "tool")):
        with pytest.raises(KempeError):
            ask()


# ---- numbers


def wrong(good: Any) -> dict[str, Any]:
    """The same shape filled with what is no real number, or would lose something."""
    x = np.array(good, dtype=float)
    some = x.astype(object)
    some.flat[0] = None
    dates = np.full(x.shape, np.datetime64("2026-01-01"))
    out = {
        "text": x.astype(str),
        "list of text": x.astype(str).tolist(),
        "bytes": x.astype("S"),
        "complex": x + 1j,
        "complex without imaginary part": x + 0j,
        "masked": np.ma.array(x, mask=np.ones(x.shape)),
        "masked nowhere": np.ma.array(x),
        "dates": dates,
        "durations": dates - dates,
        "None inside": some.tolist(),
        "objects": x.astype(object),
        "truth values": x.astype(bool),
        "list of truth values": x.astype(bool).tolist(),
    }
    if x.ndim:
        names = [f"n{i}" for i in range(x.shape[-1])]
        out |= {
            "names": (Series if x.ndim == 1 else Frame)(x, names),
            "ragged": [*x.tolist(), [[[1.0]]]],
            "list of masked": list(np.ma.array(x)) if x.ndim > 1 else ["a"],
        }
    return out


def wrong_ones(verb: str, place: str, good: Any) -> dict[str, Any]:
    """What an argument of a verb may not be, in place of an array or of the values of a dict."""
    if isinstance(good, np.ndarray):
        return wrong(good)
    cases = {
        kind: dict.fromkeys(good, bad)
        for kind, bad in wrong(np.array(next(iter(good.values())))).items()
    }
    if verb == "with_limits":
        del cases["None inside"]  # no limit
    # of what is held only the names count
    return {} if verb in ("plan", "describe_plan") and place == "fixed" else cases


def numeric(name: str, function: Callable[..., Any], system: kempe.System) -> list[str]:
    """Parameters of a verb that are arrays, or dicts of numbers."""
    values = usual(system, name.rpartition(".")[2])
    if name.rpartition(".")[2] != "with_limits":  # elsewhere it says whether they hold
        values["limits"] = None
    if name.rpartition(".")[2] in (
        "assembler",
        "closed_form",
        "bind_assembler",
        "find_closed_form",
    ):  # names
        values["known"] = None
    own = set() if name.rpartition(".")[2] != "drive" else {"inputs"}
    known = [
        p
        for p in inspect.signature(function).parameters
        if p in values and (p in own or p not in NO_ARRAYS)
    ]
    return [
        p
        for p in known
        if isinstance(values[p], np.ndarray) or (isinstance(values[p], dict) and values[p])
    ]


def answers(function: Callable[..., Any], system: kempe.System, given: dict[str, Any]) -> bool:
    """Whether a verb answers when it is given these."""
    try:
        call(function, system, given)
    except KempeError:
        return False
    return True


NUMERIC = [n for n in OF_SYSTEMS if n not in NOT_REQUIRED]


@pytest.mark.parametrize("name", some(NUMERIC, 4))
def test_what_is_no_number_is_refused(name, robots):
    """By every parameter that takes numbers, in all verbs: an `InputError`, never an answer."""
    function = OF_SYSTEMS[name]
    short = name.rpartition(".")[2]
    if short.startswith("plot"):
        pytest.importorskip("matplotlib")
    arm = robots[
        "iiwa14"
        if short in ("arm_angle", "compute_arm_angle", "sweep", "ik_sweep", "self_motion")
        else "ur5"
    ]
    requested = [
        (s, p, usual(s, short)[p])
        for s in (arm, robots["four_bar"])
        for p in numeric(name, function, s)
    ]
    answered = [(s, p, good) for s, p, good in requested if answers(function, s, {p: good})]
    assert answered or not requested
    for (
        system,
        place,
        good,
    ) in answered:  # elsewhere another answer is not to be expected of wrong numbers
        for kind, bad in wrong_ones(short, place, good).items():
            with pytest.raises(KempeError):
                call(function, system, {place: bad})
                pytest.fail(f"{name}({place}={kind}) gave an answer")


def test_wrong_numbers_are_tried_where_right_ones_answer(robots):
    """The test above looks at enough parameters to mean something."""
    tried = [
        (n, p)
        for n in NUMERIC
        if "plot" not in n
        for m in ("ur5", "four_bar")
        for p in numeric(n, OF_SYSTEMS[n], robots[m])
        if answers(OF_SYSTEMS[n], robots[m], {p: usual(robots[m], OF_SYSTEMS[n].__name__)[p]})
    ]
    assert len(tried) > 120 and len({p for _, p in tried}) > 20, (
        len(tried),
        sorted({p for _, p in tried}),
    )


@pytest.mark.parametrize("name", sorted(OF_ARRAYS))
def test_spatial_functions_refuse_what_is_no_number(name):
    function = OF_ARRAYS[name]
    parameters = list(inspect.signature(function).parameters)
    shapes = {"X": (4, 4), "R": (3, 3), "twist": (6,), "values": (6,), "angle": ()}
    shapes |= dict.fromkeys(("q", "quat_wxyz", "a", "b"), (4,))
    good = {p: np.full(shapes.get(p, (3,)), 0.5) for p in parameters}
    good |= {
        p: np.eye(n) for p, n in (("X", 4), ("R", 3), ("particles", 2), ("places", 2)) if p in good
    }
    wrongs = {p: wrong(x) for p, x in good.items()}
    if name.endswith(".make_rotation"):
        good["axis"] = "x"
        wrongs["axis"]["another"] = "w"
    function(**good)
    for place in parameters:
        for kind, bad in wrongs[place].items():
            with pytest.raises(InputError, match=r"must be"):
                function(**{**good, place: bad})
                pytest.fail(f"{name}({place}={kind}) gave an answer")


@pytest.mark.parametrize("kind", list(wrong(np.zeros(3))))
def test_goals_of_tasks_are_numbers(kind, robots):
    system = robots["ur5"]
    bad = wrong(np.array([0.1, 0.2, 0.3]))[kind]
    for task in (
        tasks.Position("tool", bad),
        tasks.Pointing("tool", bad),
        tasks.LookAt("tool", bad),
    ):
        with pytest.raises(KempeError):
            system.ik(task)
    with pytest.raises(KempeError):
        system.ik(tasks.Posture(wrong(np.zeros(6))[kind]))


class Angle(np.ndarray):
    """Numbers with a unit, as libraries of units have them."""

    unit = "deg"


def test_units_are_not_dropped(robots):
    with pytest.raises(InputError, match="has the unit 'deg'"):
        robots["ur5"].fk(np.zeros(6).view(Angle), "tool")


@pytest.mark.parametrize(
    "good",
    [
        [0, 1, 2, 3, 4, 5],
        (0.0,) * 6,
        np.arange(6),
        np.arange(6, dtype=np.float32),
        np.arange(6, dtype=np.uint8),
        np.arange(6, dtype=">f8"),
        np.arange(12.0)[::2],
        range(6),
        [np.float32(1.0)] * 6,
        [np.array(0.5)] * 6,
        [[0.1] * 6],
        [np.zeros(6), [0.0] * 6],
        np.arange(6, dtype=np.float16),
    ],
)
def test_other_numbers_are_taken(good, robots):
    system = robots["ur5"]
    assert np.array_equal(
        system.fk(good, "tool"), system.fk(np.array(good, dtype=np.float64), "tool")
    )


def test_files_in_memory_are_taken(robots, tmp_path):
    np.save(tmp_path / "q.npy", np.full((3, 6), 0.2))
    q = np.load(tmp_path / "q.npy", mmap_mode="r")
    system = robots["ur5"]
    for plain, mapped in ((np.array(q), q), (np.array(q[0]), q[0])):
        assert np.array_equal(system.fk(mapped, "tool"), system.fk(plain, "tool"))
        assert np.array_equal(system.query("tool")(mapped), system.fk(plain, "tool"))


# ---- rotations are no positions, times grow


def rotations(rng: np.random.Generator, n: int) -> np.ndarray:
    return spatial.exp_so3(rng.normal(size=(n, 3)) * rng.choice([0.1, 1.0, 3.0], (n, 1)))


@pytest.mark.parametrize(
    "ask",
    [
        lambda s, R: s.ik(R, "tool"),
        lambda s, R: s.ik(R.astype(np.float32), "tool"),
        lambda s, R: s.ik(R.tolist(), "tool"),
        lambda s, R: s.ik_all(R, "tool"),
        lambda s, R: s.ik_path(R, "tool"),
        lambda s, R: s.ik(np.stack([R, R]), "tool"),
        lambda s, R: s.ik_path(np.stack([R, R]), "tool"),
        lambda s, R: s.ik(tasks.Position("tool", R)),
        lambda s, R: s.ik_path(tasks.Position("tool", np.stack([R, R]))),
        lambda s, R: s.inverse.sweep(R, "tool"),
    ],
    ids=range(10),
)
def test_a_rotation_is_not_three_positions(ask, robots, hunt):
    for R in rotations(hunt.rng(), hunt.cases(10)):
        with pytest.raises(InputError):
            ask(robots["ur5"], R)


def test_the_way_to_an_orientation_is_named(robots):
    system = robots["ur5"]
    R = spatial.rot_x(0.3)
    with pytest.raises(
        InputError, match=r"not three positions: .*tasks.Orientation.*task='orientation'"
    ):
        system.ik(R, "tool")
    assert system.ik(R, "tool", task="orientation") and system.ik(tasks.Orientation("tool", R))
    flat = np.array([[0.8, -0.6, 0.3], [0.6, 0.8, 0.2], [0.0, 0.0, 1.0]])
    with pytest.raises(InputError, match="a pose of the plane"):
        system.ik(flat, "tool")
    with pytest.raises(InputError, match="is a rotation"):
        robots["four_bar"].assemble({"coupler_point": R})


def test_three_positions_are_three_positions(robots, hunt):
    system = robots["ur5"]
    rng = hunt.rng()
    for _ in range(hunt.cases(50)):
        p = rng.uniform(-0.6, 0.6, (3, 3))
        assert system.ik(p, "tool").q.shape == (3, 6)
    assert system.ik(np.eye(3) * 0.5, "tool").q.shape == (3, 6)
    assert system.ik(np.eye(3), "tool", task="position").q.shape == (3, 6)


@pytest.mark.parametrize(
    "times", [[0.0, 2.0, 1.0], [0.0, 0.0, 1.0], [2.0, 1.0, 0.0], [0.0, 1.0, 1.0]]
)
def test_times_grow(times, robots):
    for inputs in ({"A": [0.0, 0.1, 0.2]}, {"A": lambda t: 0.1 * t}):
        with pytest.raises(InputError, match="times must grow from sample to sample"):
            robots["four_bar"].drive(inputs, times)
    assert robots["four_bar"].drive({"A": [0.0, 0.1, 0.2]}, [-1.0, 0.0, 5.0])


TWO_FREE: dict[str, Callable[[kempe.Mechanism, int], Any]] = {
    "radius of a ball": lambda m, x: m.rolls("floor", "a", x),
    "radius of a contact": lambda m, x: m.contact("c", "a", radius=x),
    "length": lambda m, x: m.distance("d", "a", "b", x),
    "target": lambda m, x: m.constrain(tasks.Position("a", [x, 0, 0])),
    "bound": lambda m, x: m.constrain(tasks.Position("a", [0, 0, 0], at_most=x)),
    "place": lambda m, x: m.frame("F", "a", at=(x, 0, 0)),
    "limits": lambda m, x: m.revolute("L", "a", m.body("c"), limits=(-x, x)),
    "parameter": lambda m, x: m.parameter("p", x),
    "coordinate": lambda m, x: m.build().q({"J.x": x}),
    "coordinates": lambda m, x: m.build().fk([x] * 14, "a"),
    "goal": lambda m, x: m.build().ik([x, 0, 0], "a"),
    "known": lambda m, x: m.build().assemble({"J.x": x}),
    "tolerance": lambda m, x: m.build().assemble(tolerance=x),
    "random numbers": lambda m, x: m.build().ik([0.1, 0, 0], "a", budget=kempe.Budget(rng=x)),
}


@pytest.mark.parametrize(
    "number", [10**400, -(10**400), 10**5000], ids=["large", "negative", "not to be printed"]
)
@pytest.mark.parametrize("what", TWO_FREE)
def test_a_whole_number_that_no_float_holds_is_refused(what, number):
    """The last one has more digits than Python prints."""
    m = kempe.Mechanism("two free bodies")
    m.free("J", m.ground, m.body("a"))
    m.free("K", m.ground, m.body("b"))
    with pytest.raises(KempeError) as error:
        TWO_FREE[what](m, number)
    assert len(str(error.value)) < 400


# ---- one rule for what is not finite


TIP = "tool"
OF_POSES = {
    "ik": lambda s, X: s.ik(X, TIP),
    "ik_all": lambda s, X: s.ik_all(X, TIP),
    "task": lambda s, X: s.ik([tasks.Pose(TIP, X)]),
    "tasks": lambda s, X: s.ik([tasks.Pose(TIP, X), tasks.Position(TIP, X[:3, 3])]),
    "ik_path": lambda s, X: s.ik_path(X[None], TIP),
    "reach": lambda s, X: s.reach.poses(X[None], TIP),
    "sweep": lambda s, X: s.inverse.sweep(X, TIP),
}


@pytest.mark.parametrize("entry", [(3, 3), (3, 0), (0, 3), (1, 1)])
@pytest.mark.parametrize("verb", OF_POSES)
def test_a_pose_with_a_nan_anywhere_is_refused(verb, entry):
    arm = kempe.load("panda" if verb == "sweep" else "puma560")
    X = arm.fk(arm.mid, TIP)
    X[entry] = np.nan
    with pytest.raises(InputError, match="finite|not a pose"):
        OF_POSES[verb](arm, X)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["four_bar", "slider_crank", "bennett", "jansen"])
def test_a_start_is_read_whole(name, value):
    """Also where a known value takes the place of the entry."""
    system = kempe.load(name)
    q = system.assemble().q
    for k, coordinate in enumerate(system.coordinate_names):
        start = q.copy()
        known = {coordinate: q[k]}
        start[k] = value
        for given in (start, start.tolist()):
            with pytest.raises(
                InputError, match=f"start.*{coordinate}.* is {value}; it must be finite"
            ):
                system.assemble(known, given)
        two = system.assemble(known, np.stack([q, start]))
        assert two.code[1] == kempe.Status.BAD_INPUT != two.code[0] and not two.success[1]
