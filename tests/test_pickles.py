"""What the verbs return can be sent to another process, which says of it what this one says.

Only public names are imported: answers, whose explanations and derivatives are found by name, are
asked for all that is public of them, in a process that has imported no more than `kempe` before it
reads them.
"""

from __future__ import annotations

import importlib.util
import pickle
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kempe

AGAIN = ", asked before"
PACKED = "loops"
"""A member that is not asked: arrays for kernels, with addresses of functions in this process."""
METHODS = (
    "code",
    "content",
    "data",
    "describe",
    "latex",
    "proofs",
    "sentence",
    "table",
    "to_json",
    "topics",
)
"""Methods that are asked; so are fields, properties, `str` and `repr` of all."""
WITH_ARGUMENTS: dict[str, Callable[[Any], Any]] = {
    "assembler": lambda x: x([0.3]).q,
    "assembler with a function": lambda x: x([0.2]).q,
    "closed_form": lambda x: x.close([0.3]).q,
    "configuration_space": lambda x: x.sample(3, 0).q,
    "designs": lambda x: x.fk([0.1], "tip"),
    "equation as a function": lambda x: x.build().assemble({"B": 0.1}).q,
    "formulas of dyads": lambda x: x([0.3], "+"),
    "ik in symbols": lambda x: x([0.3, 0.4]),
    "independent": lambda x: x.q(0.3).q,
    "loops": lambda x: x.closure_error([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
    "manoeuvre": lambda x: x.at(0.2),
    "mechanism with all of it": lambda x: x.build().structure.hash,
    "planar": lambda x: x.contains([[0.1, 0.2], [9.0, 0.0]]),
    "query": lambda x: x([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
    "query with a Jacobian": lambda x: x.jacobian([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
    "simulate": lambda x: x.at(0.2),
    "steps": lambda x: x.numbers([0.1, 0.2]),
    "sweep": lambda x: x.at(0.2).q,
    "system": lambda x: x.ik(x.fk([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], "tool"), "tool").q,
    "trace": lambda x: x.at(0.1),
    "workspace": lambda x: x.contains([[0.1, 0.2], [9.0, 0.0]]),
}
"""What is asked with arguments of some of the results, by their names."""


def said(name: str, thing: Any) -> dict[str, Any]:
    """What the result `name` says, as plain data: texts, bytes and tuples."""
    out: dict[str, Any] = {"type": type(thing).__name__, "str()": text(str(thing))}
    out["repr()"] = text(repr(thing))
    if name in WITH_ARGUMENTS:
        out["asked with arguments"] = plain(WITH_ARGUMENTS[name](thing))
    if type(thing).__module__.startswith("sympy."):
        return out
    if isinstance(thing, (tuple, list)):
        out["members"] = plain(thing)
    for member in sorted({*dir(type(thing)), *getattr(thing, "__dict__", {})}):
        if member[0] == "_" or member == PACKED:
            continue
        value = asked(thing, member)
        if not callable(value):
            out[member] = plain(value)
        elif member in METHODS:
            out[member + "()"] = plain(asked(thing, member, True))
    return out


def asked(thing: Any, name: str, call: bool = False) -> Any:
    """A member of `thing`, or what it returns; of what is refused, the sentence."""
    try:
        value = getattr(thing, name)
        return value() if call else value
    except kempe.KempeError as error:
        return f"{type(error).__name__}: {error}"


def plain(value: Any, depth: int = 4) -> Any:
    """A value as bytes of arrays, text and tuples, which another process can compare."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        return str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, np.ndarray):
        return value.shape, plain(value.ravel().tolist(), depth)
    if isinstance(value, Mapping):
        return tuple((text(str(key)), plain(x, depth - 1)) for key, x in value.items())
    if isinstance(value, (tuple, list)) and depth:
        return tuple(plain(x, depth - 1) for x in value)
    if isinstance(value, (set, frozenset)):
        return tuple(sorted(text(repr(x)) for x in value))
    return type(value).__name__, text(str(value))


def text(said: str) -> str:
    """Without addresses of objects, which no two processes share."""
    return re.sub(r" at 0x[0-9a-f]+", "", said)


def other() -> None:
    """The other process: reads answers and tells what they say."""
    given = pickle.loads(Path(sys.argv[1]).read_bytes())
    out: dict[str, Any] = {}
    for name, sent in given.items():
        with named(name):
            out[name] = said(name.removesuffix(AGAIN), pickle.loads(sent))
    Path(sys.argv[2]).write_bytes(pickle.dumps(out))


@contextmanager
def named(name: str) -> Iterator[None]:
    """Errors within say of which result they are."""
    try:
        yield
    except Exception as error:
        error.add_note(f"of the result {name!r}")
        raise


def results() -> Iterable[tuple[str, Any]]:
    """One of each kind of what the public verbs return, and of batches where these are others."""
    yield from of_arms()
    yield from of_redundant_arms()
    yield from of_tasks()
    yield from of_functions()
    yield from of_loops()
    yield from of_motions()
    yield from of_spaces()
    yield from of_formulas()
    yield from of_descriptions()
    yield from of_errors()


def of_arms() -> Iterable[tuple[str, Any]]:
    arm = kempe.load("puma560")
    tool = arm.frame_names[-1]
    q = arm.mid + 0.1
    X = arm.fk(q, tool)
    far = X.copy()
    wrong = np.full((4, 4), np.nan)
    far[:3, 3] += 9.0
    batch = np.stack([X, far, wrong])
    yield "ik", arm.ik(X, tool)
    yield "ik from a start", arm.ik(X, tool, start=q)
    yield "ik, numeric", arm.ik(X, tool, start=q + 0.1, method="numeric")
    yield "ik out of reach", arm.ik(far, tool)
    yield "ik of a batch", arm.ik(batch, tool)
    yield "ik of a position", arm.ik(X, tool, task="position")
    yield "ik within limits", arm.with_limits({"q1": (2.0, 2.1)}).ik(X, tool)
    yield "ik_all", arm.ik_all(X, tool)
    yield "ik_all out of reach", arm.ik_all(far, tool)
    yield "ik_all of a batch", arm.ik_all(batch, tool)
    yield "ik_all within limits", arm.with_limits({"q1": (2.0, 2.1)}).ik_all(X, tool, limits=True)
    yield "ik_path", arm.ik_path(arm.fk(np.stack([q, q + 0.02, q + 0.04]), tool), tool, q)
    yield "ik_path in part", arm.ik_path(np.stack([X, far]), tool, q)
    yield "ik_step", arm.ik_step(q, [0.0, 0.0, 0.0, 0.0, 0.0, 1e-3], tool, 0.01)
    yield "ik_step in part", arm.ik_step(q, [0.0, 0.0, 0.0, 0.0, 0.0, 9.0], tool, 0.01)
    yield "plan", arm.inverse.plan(tool)
    yield "poses", arm.reach.poses(np.stack([X, far]), tool)
    yield "place", arm.reach.place(X[None], tool, {"x": (-0.1, 0.1)}, 3)
    yield "capability", arm.reach.capability(tool, [[-0.5] * 3, [0.5] * 3], 2, 4)
    yield "query", arm.query(tool)
    yield "query with a Jacobian", arm.query(tool)
    for name in ("inverse", "loops", "reach", "symbolic", "structure", "mechanism"):
        yield name, getattr(arm, name)
    yield "system", arm
    yield "judged", arm.ik_all(X, tool).judged
    yield "problem", arm.ik(X, tool).problem


def of_redundant_arms() -> Iterable[tuple[str, Any]]:
    arm = kempe.load("iiwa14")
    tip = arm.frame_names[-1]
    q = arm.mid + 0.2
    X = arm.fk(q, tip)
    yield "ik, redundant", arm.ik(X, tip)
    yield "ik_all, a joint to spare", bars("ABC").build().ik_all([0.5, 0.1], "tip", task="position")
    sweep = arm.inverse.sweep(X, tip)
    yield "sweep", sweep
    yield "at", sweep.at(0.2)
    yield "at of a batch", sweep.at([0.2, 3.0])
    yield "best", sweep.best()
    yield "self_motion", arm.inverse.self_motion(q, tip, budget=kempe.Budget(points=5))


def of_tasks() -> Iterable[tuple[str, Any]]:
    arm = kempe.load("puma560")
    few = kempe.Budget(starts=3)
    tool = arm.frame_names[-1]
    position = kempe.tasks.Position
    p = arm.fk(arm.mid + 0.1, tool)[:3, 3]
    aim = kempe.tasks.Pointing(tool, [0.0, 0.0, -1.0], priority=1)
    yield "ik of tasks", arm.ik([position(tool, p)])
    yield "ik of tasks by priority", arm.ik([position(tool, p), aim], budget=few)
    yield "ik of tasks out of reach", arm.ik([position(tool, p + 9.0)], budget=few)
    yield (
        "ik of tasks that exclude each other",
        arm.ik([position(tool, p), position(tool, p + 0.1)], budget=few),
    )
    yield "ik of tasks of a batch", arm.ik([position(tool, np.stack([p, p + 9.0]))], budget=few)
    yield "ik_path of tasks", arm.ik_path([position(tool, np.stack([p, p + 0.01]))])
    yield "task_space", arm.task_space(tool)
    yield "tasks", [position(tool, p), aim, kempe.tasks.CentreOfMass(p)]


def law(x: Mapping[str, float]) -> float:
    """An equation that cannot be recorded, for it branches."""
    return x["A"] - 2.0 * x["B"] if x["B"] < 10.0 else 0.0


def first(q: np.ndarray) -> float:
    """A function of configurations that cannot be recorded, for it branches."""
    return q[0] - 0.1 if q[1] < 10.0 else 0.0


def of_functions() -> Iterable[tuple[str, Any]]:
    """Kernels call functions of the user at addresses, which are others in another process."""
    arm = kempe.load("puma560")
    few = kempe.Budget(starts=3)
    p = arm.fk(arm.mid + 0.1, "tool")[:3, 3]
    task = kempe.tasks.Function(first)
    near = kempe.tasks.Position("tool", p)
    far = kempe.tasks.Position("tool", p + 9.0)
    yield "ik of a function", arm.ik([task])
    yield "ik of a function out of reach", arm.ik([task, far], prefer=first, budget=few)
    yield "ik that prefers by a function", arm.ik([near], prefer=first)
    yield "ik that prefers manipulability", arm.ik([near], prefer="manipulability")
    along = kempe.tasks.Position("tool", np.stack([p, p + 0.01]))
    yield "ik_path of a function", arm.ik_path([task, along])
    m = bars()
    m.equation("law", law, of=("A", "B"))
    system = m.build()
    yield "system with a function", system
    yield "assemble with a function", system.assemble({"B": 0.1})
    yield "assembler with a function", system.loops.assembler(["B"])
    yield "constraints with a function", system.loops.constraints()
    yield "ik with a function", system.ik([0.4, 0.1], "tip", task="position")
    yield "mobility with a function", system.mobility()


def of_loops() -> Iterable[tuple[str, Any]]:
    linkage = kempe.load("four_bar")
    closed = linkage.assemble({"A": 0.3}).q
    bodies = linkage.body_names
    yield "assemble", linkage.assemble({"A": 0.3})
    yield "assemble, impossible", linkage.assemble({"D": 0.0})
    yield "assemble of a batch", linkage.assemble({"D": np.array([1.6, 0.0, np.nan])})
    yield "assembly_modes", linkage.assembly_modes({"A": 0.3})
    yield "assembly_modes, impossible", linkage.assembly_modes({"D": 0.0})
    yield (
        "ik through a loop",
        linkage.ik(linkage.fk(closed, "coupler_point")[:2, 3], "coupler_point"),
    )
    yield "closed_form", linkage.loops.closed_form(["A"])
    yield "closed_form, incomplete", kempe.load("bennett").loops.closed_form([])
    yield "close", linkage.loops.closed_form(["A"]).close([0.3])
    yield "close of a batch", linkage.loops.closed_form(["D"]).close([[1.6], [0.0], [np.nan]])
    yield "assembler", linkage.loops.assembler(["A"])
    yield "constraints", linkage.loops.constraints()
    yield "jacobian of loops", linkage.loops.jacobian(closed, ["A"], ["D"])
    yield "relative_motion", linkage.loops.relative_motion(closed, *bodies[:2])
    yield "independent", linkage.independent(closed)
    near = rounded()
    yield "idealise", near.idealise()
    yield "assemble the nearest exact one", near.assemble({"A": 0.3})
    yield "mobility", linkage.mobility()
    yield "mobility in space", kempe.load("bennett").mobility()
    yield "mobility with inputs", linkage.mobility(actuated=["A"])
    yield "configuration_space", linkage.configuration_space
    yield "components", linkage.configuration_space.components()
    yield "parametrizations", linkage.configuration_space.parametrizations()


def of_motions() -> Iterable[tuple[str, Any]]:
    linkage = kempe.load("four_bar")
    few = kempe.Budget(points=9)
    start = linkage.assemble({"A": 0.3}).q
    car = kempe.load("car")
    ball = kempe.load("ball")
    trace = linkage.trace(start=start)
    yield "trace", trace
    yield "resample", trace.resample(5)
    yield "drive", linkage.drive({"A": np.linspace(0.3, 0.6, 4)}, start=start)
    yield "drive in part", linkage.drive({"D": np.linspace(2.0, 0.0, 9)})
    yield "path", linkage.configuration_space.path(start, trace.q[5])
    yield "classify", car.classify()
    yield "manoeuvre", car.manoeuvre(np.zeros(3), [0.0, 1.0, 0.0], radius=1.0, budget=few)
    yield "simulate", ball.simulate(0.5, {"flight.z": 1.0}, budget=few)


def of_spaces() -> Iterable[tuple[str, Any]]:
    two = kempe.load("two_link_pose")
    few = kempe.Budget(starts=3)
    yield "sample", two.configuration_space.sample(3, 0)
    yield "workspace", two.workspace("e", n=5000, cells=16)
    yield "planar", two.reach.planar("e")
    singular = two.singularities("e", "position", budget=few)
    yield "singularities", singular
    yield "nearest", singular.nearest(two.mid + 0.1)
    yield "curves", singular.curves()


def of_formulas() -> Iterable[tuple[str, Any]]:
    two = kempe.load("two_link")
    linkage = kempe.load("four_bar")
    yield "fk in symbols", two.symbolic.fk("e")
    yield "short", two.symbolic.fk("e", short=True)
    yield "steps", two.symbolic.steps("e")
    yield "jacobian in symbols", two.symbolic.jacobian("e")
    yield "closure", linkage.symbolic.closure()
    yield "to_dh", kempe.load("puma560").symbolic.to_dh("tool")
    yield "ik in symbols", two.symbolic.ik("e")
    yield "formulas of a plan", two.inverse.plan("e").formulas()
    yield "formulas of dyads", linkage.loops.closed_form(["A"]).formulas()


def of_descriptions() -> Iterable[tuple[str, Any]]:
    m = kempe.Mechanism("described")
    a = m.body("a", mass=1.0, center=[0.1, 0.0, 0.0])
    b = m.body("b")
    length = m.parameter("length", 0.5)
    joint = m.revolute("A", m.ground, a, limits=(-1.0, 1.0))
    m.revolute("B", a, b, at=(length, 0.0, 0.0))
    yield "body", a
    yield "joint", joint
    yield "frame", m.frame("tip", b, at=(0.3, 0.0, 0.0))
    yield "coupling", m.gear("B", "A", 2.0)
    yield "parameter", length
    yield "constraint", m.distance("rod", a, b, 0.5)
    yield "equation", m.equation("law", "A - 2*sin(B)")
    m.posture("bent", {"A": 0.5})
    yield "mechanism with all of it", m
    yield "system with all of it", m.build()
    yield "designs", m.build().with_parameters(length=np.array([0.5, 0.6]))
    yield "from_dh", kempe.from_dh([{"a": 0.3, "alpha": 1.5}, {"a": 0.2}])
    law = bars()
    law.equation("law", lambda x: x["A"] - 2.0 * np.sin(x["B"]), of=("A", "B"))
    yield "equation as a function", law
    yield "expand_joints", kempe.convert.expand_joints(kempe.load("two_link"))
    yield "maximal", kempe.convert.maximal(kempe.load("two_link"))
    yield "budget", kempe.Budget(points=3)
    yield "tolerance", kempe.Tolerance(1e-6, 1e-6)
    yield "statuses", list(kempe.Status)


def of_errors() -> Iterable[tuple[str, Any]]:
    arm = kempe.load("puma560")
    far = np.eye(4)
    far[:3, 3] = 9.0

    def broken(*done: Any) -> None:
        raise KeyboardInterrupt

    calls = {
        "no solution": lambda: arm.ik(far, "tool").expect(),
        "unknown name": lambda: arm.ik(far, "tol"),
        "bad input": lambda: arm.ik(np.full((4, 4), np.nan), "tool"),
        "bad file": lambda: kempe.load(b"<robot name='a'><joint/></robot>", format="urdf"),
        "interrupt": lambda: kempe.load("four_bar").trace(budget=kempe.Budget(progress=broken)),
    }
    for name, call in calls.items():
        try:
            call()
        except (kempe.KempeError, kempe.Interrupted) as error:
            yield name, error


def bars(joints: str = "AB") -> kempe.Mechanism:
    """Bars in a row in the plane."""
    m = kempe.Mechanism("bars", dim=2)
    last = m.ground
    for name in joints:
        body = m.body(name.lower())
        m.revolute(name, last, body, at=(0.0 if last is m.ground else 0.3, 0.0))
        last = body
    m.frame("tip", last, at=(0.2, 0.0))
    return m


def rounded() -> kempe.System:
    """A planar four-bar linkage built in space, one pin of which is off by a hundredth of a
    millimetre.
    """
    m = kempe.Mechanism("rounded")
    a, b, c = (m.body(n) for n in "abc")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(0.1, 0.0, 0.0))
    m.revolute("C", b, c, at=(0.5, 0.0, 1e-5), child_at=(0.4, 0.0, 0.0))
    m.revolute("D", m.ground, c, at=(0.4, 0.0, 0.0))
    return m.build()


@pytest.mark.slow
def test_another_process_says_the_same(tmp_path):
    sent = {}
    here = {}
    for name, thing in results():
        # as it was returned, and after it was asked, with all that it keeps of what it said
        with named(name):
            sent[name] = pickle.dumps(thing)
            here[name] = here[name + AGAIN] = said(name, thing)
            sent[name + AGAIN] = pickle.dumps(thing)
    file = tmp_path / "sent"
    answer = tmp_path / "said"
    file.write_bytes(pickle.dumps(sent))
    code = (
        "import sys; sys.path.insert(0, sys.argv.pop()); import test_pickles; test_pickles.other()"
    )
    command = [sys.executable, "-c", code, file, answer, Path(__file__).parent]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert not done.returncode, done.stderr
    there = pickle.loads(answer.read_bytes())
    assert list(there) == list(here)
    wrong = {
        f"{name}: {key}": (here[name].get(key), there[name].get(key))
        for name in sent
        for key in {*here[name], *there[name]}
        if here[name].get(key) != there[name].get(key)
    }
    assert not wrong


@pytest.mark.parametrize(
    "place", ["solvers.one_frame.solution", "kinematics.common.result", "model.compiled_system"]
)
def test_a_pickle_of_another_version_is_refused_in_a_sentence(place):
    """It names a module that is not there."""
    with pytest.raises(
        ModuleNotFoundError, match=f"no module 'kempe.{place.split('.')[0]}.*wrote them"
    ):
        pickle.loads(f"ckempe.{place}\nSolution\n.".encode())
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        from kempe import nothing  # noqa: F401
    assert importlib.util.find_spec("kempe.kernels._nothing") is None
