"""Calls as they are written: few arguments, one budget for all verbs."""

from __future__ import annotations

import collections
import contextlib
import ctypes
import functools
import importlib
import inspect
import math
import operator
import pickle
import pkgutil
import re
import signal
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rounded import exact, rounded

import kempe
from kempe import Budget, arguments
from kempe.budget import TimeUp, Usual, check_for_stop, list_checks
from kempe.errors import CallError, InputError, NoSolutionError
from kempe.inverse import multi_start, numeric
from kempe.inverse.closed_forms import problem as chain_problem
from kempe.inverse.tasks import search
from kempe.numerics import clock
from kempe.numerics.clock import TimeLimit

ROOT = Path(__file__).parent.parent

ARM, LINKAGE, SEVEN = (kempe.load(n) for n in ("puma560", "four_bar", "iiwa14"))
Q = ARM.mid + 0.1
X = ARM.fk(Q, "tool")
FREE = SEVEN.mid + 0.2
P = SEVEN.fk(FREE, "tool")
THIRD = SEVEN.coordinate_names[2]

METHODS = {
    n: f
    for n in dir(kempe.System)
    if n[0] != "_" and callable(f := inspect.getattr_static(kempe.System, n))
}
FREE_NAMES = {"with_parameters"}
"""Methods whose keywords are names that the system has."""
MORE = {"plot": 14, "workspace": 10, "ik_path": 11, "ik": 9, "ik_all": 9, "drive": 9, "trace": 9}
"""Methods with more arguments: what a picture shows (`PlotOptions`), what each kind needs, which
of several paths is the answer, the steps of a search, which solutions are kept, what ends a motion."""


@pytest.mark.parametrize("name", METHODS)
def test_verbs_have_at_most_eight_arguments_all_written_out(name):
    parameters = list(inspect.signature(METHODS[name]).parameters.values())[1:]
    assert len(parameters) <= MORE.get(name, 8)
    assert name in FREE_NAMES or not any(
        p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL) for p in parameters
    )


READ = {
    "ik": (
        lambda b: ARM.ik(X, "tool", budget=b),
        {"starts": 3, "iterations": 9, "rng": 1, "threads": 1},
    ),
    "ik of tasks": (
        lambda b: ARM.ik([kempe.tasks.Pose("tool", X)], budget=b),
        {"starts": 3, "time_limit": 9.0},
    ),
    "ik_all": (lambda b: ARM.ik_all(X, "tool", budget=b), {"threads": 2}),
    "ik_path": (
        lambda b: ARM.ik_path(X[None], "tool", budget=b),
        {"starts": 5, "progress": lambda n: None},
    ),
    "ik_sweep": (lambda b: SEVEN.inverse.sweep(P, "tool", budget=b), {"points": 64}),
    "assemble": (
        lambda b: LINKAGE.assemble({"A": 0.3}, budget=b),
        {"starts": 4, "rng": 2, "threads": 1},
    ),
    "assembler": (lambda b: LINKAGE.loops.assembler(["A"])([0.3], budget=b), {"starts": 4}),
    "assembly_modes": (
        lambda b: LINKAGE.assembly_modes({"A": 0.3}, budget=b),
        {"time_limit": math.inf, "starts": 9},
    ),
    "self_motion": (
        lambda b: SEVEN.inverse.self_motion(FREE, "tool", budget=b),
        {"points": 3, "step": 0.01},
    ),
    "trace": (
        lambda b: LINKAGE.trace("A", budget=b),
        {"points": 9, "step": 0.05, "time_limit": math.inf},
    ),
    "drive": (
        lambda b: LINKAGE.drive({"A": [0.3, 0.4]}, budget=b),
        {"step": 0.05, "time_limit": 9.0},
    ),
}


@pytest.mark.parametrize("verb", READ)
def test_a_budget_is_read(verb):
    call, fields = READ[verb]
    assert str(call(Budget(**fields)))
    assert str(call(Budget())) == str(call(None)), "an empty budget is the usual one"


@pytest.mark.parametrize("verb", READ)
def test_what_a_verb_does_not_read_is_refused(verb):
    call, fields = READ[verb]
    unread = "step" if "step" not in fields else "iterations"
    with pytest.raises(
        InputError, match=f"budget has {unread}, which {verb[:2]}.* does not read; it reads "
    ):
        call(Budget(**{unread: 0.1}))
    with pytest.raises(InputError, match="budget is 5; it must be a kempe.Budget, such as Budget"):
        call(5)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"starts": 0}, "starts is 0"),
        ({"starts": 2.5}, "starts is 2.5"),
        ({"iterations": True}, "iterations is True"),
        ({"time_limit": -1.0}, "time_limit is -1.0"),
        ({"rng": -1}, "rng is -1"),
        ({"starts": "many"}, "starts is 'many'"),
    ],
)
def test_wrong_budgets_are_named(fields, said):
    with pytest.raises(InputError, match=said):
        ARM.ik(X, "tool", budget=Budget(**fields))


def test_wrong_points_and_steps_are_named():
    with pytest.raises(InputError, match="points is 1; it must be a whole number, at least 2"):
        LINKAGE.trace("A", budget=Budget(points=1))
    with pytest.raises(CallError, match="Budget has no option 'seconds'"):
        Budget(seconds=3)  # type: ignore[call-arg]


def test_budgets_are_values():
    budget = Budget(starts=5, rng=3)
    assert pickle.loads(pickle.dumps(budget)) == budget != Budget(starts=6, rng=3)
    assert hash(budget) == hash(Budget(starts=5, rng=3))


def test_tolerances_are_pairs():
    loose = kempe.Tolerance(linear=1e-3, angular=0.01)
    near = ARM.ik(X[None], "tool", tolerance=loose)
    assert near and near.problem.tolerance == (1e-3, 0.01)


def test_what_raised_is_expected():
    far = X.copy()
    far[0, 3] = 9.0
    for found in (ARM.ik(far, "tool"), ARM.ik_all(far, "tool"), LINKAGE.assemble({"D": 3.0})):
        with pytest.raises(NoSolutionError) as error:
            found.expect()
        assert error.value.solution is found
    good = ARM.ik(X, "tool")
    assert good.expect() is good


@pytest.mark.parametrize("option", ["colour", "hold"])
def test_options_that_never_were_are_refused(option):
    with pytest.raises(CallError, match=f"ik_all has no option '{option}'"):
        ARM.ik_all(X, "tool", **{option: 1})


# ---- time limits

ENDLESS = {
    "ik": "a target takes milliseconds; the number of targets says how long it takes",
    "ik_all": "so do the targets of a batch",
    "assemble": "so do the sets of known values of a batch",
    "workspace": "`n` says how long it takes",
    "map_file": "the rows of the file say how long it takes",
}
"""Verbs that read a time limit and have none by default."""


def module_names() -> list[str]:
    """The names of all modules but kernels and programs."""
    names = [module.name for module in pkgutil.walk_packages(kempe.__path__, "kempe.")]
    return [n for n in names if ".kernels" not in n and not n.endswith(("__main__", "_native"))]


def usual() -> dict[str, list[Any]]:
    """What each verb spends by itself, by its name, gathered from all modules."""
    found: dict[str, list[Any]] = {}
    for name in module_names():
        for value in vars(importlib.import_module(name)).values():
            if isinstance(value, Usual):
                found.setdefault(value.verb, []).append(value)
    return found


def test_every_verb_with_a_budget_ends_by_itself():
    for extra in ("matplotlib", "viser", "zarr", "sympy"):
        pytest.importorskip(extra)
    verbs = usual()
    assert len(verbs) > 20 and set(ENDLESS) <= set(verbs)
    for verb, all_ in verbs.items():
        for own in all_:
            assert own.reads["time_limit"] is not None or verb in ENDLESS, verb


FLAT, FIVE, CAR = (kempe.load(n) for n in ("parallelogram", "five_bar", "car"))
FAR = np.eye(4)
FAR[:3, 3] = 0.0, 0.0, -0.6718  # inside the reach of the lengths, but not with this orientation


def open_loops(count: int = 1) -> kempe.System:
    """Loops of four bars, one of which is too long to close them; of many of them each start
    changes a part.
    """
    m = kempe.Mechanism("open", dim=2)
    for k in range(count):
        a, b, c = (m.body(f"{n}{k}") for n in "abc")
        m.revolute(f"A{k}", m.ground, a)
        m.revolute(f"B{k}", a, b, at=(0.3, 0.0))
        m.revolute(f"C{k}", b, c, at=(9.0, 0.0))
        m.revolute(f"D{k}", m.ground, c, at=(1.0, 0.0), child_at=(0.5, 0.0))
    return m.build()


def one_sided() -> kempe.System:
    """A pendulum whose end would have to be higher than it reaches."""
    m = kempe.Mechanism("low", dim=2)
    m.revolute("A", m.ground, m.body("a"))
    m.constrain(kempe.constraints.HalfSpace("a", (0.0, 5.0, 0.0), (0.0, 1.0, 0.0)), name="high")
    return m.build()


def chain(count: int) -> kempe.System:
    m = kempe.Mechanism("chain")
    before = "ground"
    for k in range(count):
        m.revolute(
            f"j{k}",
            m.ground if k == 0 else before,
            m.body(f"b{k}"),
            at=(0.0, 0.05, 0.1),
            rpy=(0.5 * math.pi * (-1) ** k, 0.0, 0.0),
            limits=(-0.05, 0.05),
        )
        before = f"b{k}"
    return m.build()


OPEN = open_loops()
MANY = open_loops(30)
LOW = one_sided()
LONG = chain(40)
TURNED = LONG.fk(LONG.mid, LONG.frame_names[-1]) @ np.diag([1.0, -1.0, -1.0, 1.0])
NEVER = kempe.tasks.Function(lambda q: q[0] ** 2 + 1.0)
TURN = LINKAGE.trace("A")
KEEP = kempe.constraints.Clearance("self", at_least=0.01)


def two_balls() -> kempe.System:
    """A ball on a link that turns, and one that stands."""
    m = kempe.Mechanism("balls")
    m.revolute("A", m.ground, m.body("link"), axis="z")
    m.shape("link", "sphere", radius=0.1, at=(1, 0, 0))
    m.obstacle("post", "sphere", radius=0.1, at=(-1, 0, 0))
    return m.build()


TIMED = {
    "mobility": lambda b: FLAT.mobility(FLAT.q("flat"), budget=b),
    "classify": lambda b: CAR.classify(budget=b),
    "idealise": lambda b: rounded(exact("bennett"), 6, np.random.default_rng(0)).idealise(budget=b),
    "manoeuvre": lambda b: CAR.manoeuvre([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], radius=1.0, budget=b),
    "drive of what rolls": lambda b: CAR.drive(
        {"drive.x": [0.0, 1e9], "drive.rz": [0.0, 1.0]}, start=[0.0, 0.0, 0.0], budget=b
    ),
    "check_path": lambda b: two_balls().geometry.check_path([[0.0], [1.0]], KEEP, budget=b),
    "drive with a clearance": lambda b: two_balls().drive(
        {"A": [0.0, 1.0]}, clearance=KEEP, budget=b
    ),
    "drive far": lambda b: LINKAGE.drive({"A": [0.3, 1e7]}, budget=b),
    "simulate": lambda b: CAR.simulate(1.0, inputs={"drive.x": 1.0, "drive.rz": 0.1}, budget=b),
    "singularities": lambda b: ARM.singularities("tool", budget=b),
    "curves": lambda b: (
        kempe.load("two_link")
        .singularities("e", budget=Budget(time_limit=math.inf))
        .curves(budget=b)
    ),
    "reach.poses": lambda b: ARM.reach.poses(np.repeat(X[None], 5000, axis=0), "tool", budget=b),
    "reach.place": lambda b: ARM.reach.place(X[None], "tool", {"x": (0.0, 0.1)}, 5000, budget=b),
    "reach.capability": lambda b: ARM.reach.capability(
        "tool", [[0.0] * 3, [0.5] * 3], 9, 9, budget=b
    ),
    "assemble open": lambda b: OPEN.assemble(budget=b),
    "assemble many": lambda b: MANY.assemble(budget=b),
    "assemble many rows": lambda b: MANY.assemble({"A0": np.linspace(0.0, 1.0, 3)}, budget=b),
    "assemble a batch": lambda b: OPEN.assemble({"A0": np.linspace(0.0, 6.0, 100)}, budget=b),
    "assemble row by row": lambda b: OPEN.assemble(
        {"A0": np.linspace(0.0, 6.0, 9)}, prefer="continuous", budget=b
    ),
    "assemble one-sided": lambda b: LOW.assemble(budget=b),
    "assemble one-sided rows": lambda b: LOW.assemble({"A": np.linspace(0.0, 1.0, 9)}, budget=b),
    "assemble a function": lambda b: ARM.assemble(also=[NEVER], budget=b),
    "assembly_modes": lambda b: rssr().assembly_modes({"A": 0.4}, budget=b),
    "ik": lambda b: LONG.ik(TURNED, LONG.frame_names[-1], budget=b),
    "ik of a batch": lambda b: ARM.ik(np.repeat(FAR[None], 9, axis=0), "tool", budget=b),
    "ik of a batch, analytic": lambda b: ARM.ik(
        np.repeat(FAR[None], 9, axis=0), "tool", method="auto", budget=b
    ),
    "ik of tasks": lambda b: ARM.ik([kempe.tasks.Pose("tool", X), NEVER], budget=b),
    "ik_all": lambda b: SEVEN.ik_all(P, "tool", budget=b),
    "ik_path": lambda b: ARM.ik_path(np.repeat(X[None], 9, axis=0), "tool", budget=b),
    "ik_sweep": lambda b: SEVEN.inverse.sweep(P, "tool", THIRD, budget=b),
    "ik_sweep of an arm angle": lambda b: SEVEN.inverse.sweep(P, "tool", n=5000, budget=b),
    "self_motion": lambda b: SEVEN.inverse.self_motion(FREE, "tool", budget=b),
    "trace": lambda b: LINKAGE.trace("A", budget=b),
    "resample": lambda b: TURN.resample(9, budget=b),
    "sample": lambda b: FIVE.configuration_space.sample(99, budget=b),
    "components": lambda b: rssr().configuration_space.components(budget=b),
    "path": lambda b: FIVE.configuration_space.path(FIVE_Q[0], FIVE_Q[1], budget=b),
    "task_space": lambda b: ARM.task_space("tool", budget=b),
    "workspace": lambda b: ARM.workspace("tool", n=5e6, cells=8, budget=b),
}
"""Each verb with a time limit: a problem that takes it long, or for ever."""
FIVE_Q = [FIVE.assemble().q, FIVE.assemble({"A": 1.0}).q]
ELSEWHERE = {
    "map_file": "tests/workspace/test_file_map.py",
    "plot_spaces": "tests/views/test_space_pictures.py",
}
"""Verbs whose answers at the end of their time are tested elsewhere, for they need files or
pictures."""


def ladder(count: int) -> kempe.System:
    """Cranks in a row, each of which drives the next by a bar."""
    m = kempe.Mechanism("ladder", dim=2)
    for k in range(count + 1):
        m.revolute(f"A{k}", m.ground, m.body(f"a{k}"), at=(4.0 * k, 0.0))
    for k in range(count):
        m.revolute(f"B{k}", f"a{k}", m.body(f"b{k}"), at=(0.0, 1.0))
        m.revolute(f"C{k}", f"b{k}", f"a{k + 1}", at=(4.0, 0.1), child_at=(0.0, 1.2))
    return m.build()


AROUND = np.diag([1.0, -1.0, -1.0, 1.0])
LARGE = {
    "mobility": lambda s, b: s.mobility(budget=b),
    "classify": lambda s, b: s.classify(budget=b),
    "singularities": lambda s, b: s.singularities(inputs=["A0"], budget=b),
    "singularities of a frame": lambda s, b: s.singularities("a9", budget=b),
    "assemble": lambda s, b: s.assemble({"A0": 0.3}, budget=b),
    "assembly_modes": lambda s, b: s.assembly_modes({"A0": 0.3}, budget=b),
    "ik": lambda s, b: s.ik(s.fk(s.mid, "a9") @ AROUND, "a9", budget=b),
    "ik_all": lambda s, b: s.ik_all(s.fk(s.mid, "a9"), "a9", budget=b),
    "ik_path": lambda s, b: s.ik_path(
        np.repeat(s.fk(s.mid, "a9")[None], 9, axis=0), "a9", budget=b
    ),
    "trace": lambda s, b: s.trace("A0", budget=b),
    "drive": lambda s, b: s.drive({"A0": [0.0, 1.0]}, budget=b),
    "sample": lambda s, b: s.configuration_space.sample(9, budget=b),
    "components": lambda s, b: s.configuration_space.components(budget=b),
    "task_space": lambda s, b: s.task_space("a9", budget=b),
    "workspace": lambda s, b: s.workspace("b9", n=1000, budget=b),
    "reach.poses": lambda s, b: s.reach.poses(s.fk(s.mid, "a9")[None], "a9", budget=b),
    "reach.place": lambda s, b: s.reach.place(
        s.fk(s.mid, "a9")[None], "a9", {"x": (0.0, 0.1)}, 50, budget=b
    ),
    "reach.capability": lambda s, b: s.reach.capability(
        "a9", [[0.0, 0.0], [1.0, 1.0]], 9, 9, budget=b
    ),
    "chain: ik_all": lambda s, b: s.ik_all(s.fk(s.mid, "b99"), "b99", budget=b),
    "chain: ik": lambda s, b: s.ik(s.fk(s.mid, "b99") @ AROUND, "b99", method="auto", budget=b),
    "chain: singularities": lambda s, b: s.singularities("b99", budget=b),
    "chain: self_motion": lambda s, b: s.inverse.self_motion(
        s.mid, "b99", direction="j0", budget=b
    ),
    "chain: ik_sweep": lambda s, b: s.inverse.sweep(s.fk(s.mid, "b99"), "b99", "j0", budget=b),
    "chain: task_space": lambda s, b: s.task_space("b99", budget=b),
    "chain: workspace": lambda s, b: s.workspace("b99", n=1e5, budget=b),
    "chain: reach.poses": lambda s, b: s.reach.poses(s.fk(s.mid, "b99")[None], "b99", budget=b),
}
"""Verbs of systems of 40 loops, and of chains of 100 joints, of which nothing is known
beforehand."""
ALLOWED = 3000.0
AFTERWARDS = 200_000
"""Calls of functions that a verb may make, by its time limit, and that may follow: about 0.1 s."""
INSIDE = "integrate interpolate linalg optimize sparse sparse.csgraph sparse.linalg"
"""Parts of SciPy that functions import where they need them."""


@pytest.fixture(scope="module")
def imported():
    """All that a first call imports is there: whichever test comes first, none of its calls is an
    import.
    """
    for name in [*module_names(), *(f"scipy.{part}" for part in INSIDE.split())]:
        with contextlib.suppress(ImportError, kempe.errors.MissingExtraError):
            importlib.import_module(name)


@pytest.mark.parametrize("verb", LARGE)
@pytest.mark.usefixtures("imported")
def test_time_limits_hold_while_the_work_is_prepared(verb, monkeypatch):
    """The clock counts calls of Python functions: the answer comes soon after its time, whatever
    was going on.
    """
    system = chain(100) if verb.startswith("chain") else ladder(40)
    calls = collections.Counter[str]()
    counted = types.SimpleNamespace(monotonic=lambda: float(calls["call"]))
    for module in (arguments, clock, multi_start, chain_problem, search):
        monkeypatch.setattr(module, "time", counted)
    for module in (clock, numeric):
        monkeypatch.setattr(module, "compute_deadline", arguments.compute_deadline)
    sys.setprofile(lambda frame, event, argument: calls.update((event,)))
    try:
        LARGE[verb](system, Budget(time_limit=ALLOWED))
    except kempe.errors.TimeLimitError as error:
        assert "over before anything was known" in str(error)
    finally:
        sys.setprofile(None)
    assert calls["call"] < ALLOWED + AFTERWARDS


def test_every_verb_with_a_time_limit_is_in_the_battery():
    verbs = {name.split()[0].rstrip(",") for name in TIMED} | set(ELSEWHERE)
    assert verbs == set(usual())


def says(answer: Any) -> bool:
    """Whether an answer says, for one of its problems, that its time was up."""
    late = (
        np.any(getattr(answer, "late", False))
        or getattr(answer, "broken", None) is kempe.Status.OUT_OF_TIME
    )
    if not late and not np.any(np.asarray(getattr(answer, "code", 0)) == kempe.Status.OUT_OF_TIME):
        return False
    text = f"{answer} {np.asarray(answer.status).ravel()[-1]}"
    # of samples
    assert "time limit" in text or "stopped early" in text or "were requested" in text, text
    return True


def asked(verb: str) -> Any:
    """The answer of a verb to its problem, or the error that its time was over before anything was
    known.
    """
    try:
        return TIMED[verb](Budget(time_limit=5.0))
    except kempe.errors.TimeLimitError as error:
        return error


ASK_MORE = {
    "check_path",
    "idealise",
    "classify",
    "task_space",
    "ik_sweep",
    "ik_all",
    "manoeuvre",
    "simulate",
    "singularities",
    "self_motion",
    "workspace",
}
"""Verbs that know nothing before they are prepared."""


@pytest.mark.parametrize("verb", TIMED)
def test_an_answer_says_that_its_time_was_up(looks, verb):
    """At the first look at the clock; a few know nothing then, and raise."""
    looks(0)
    answer = asked(verb)
    if isinstance(answer, kempe.errors.TimeLimitError):
        assert verb.split()[0] in ASK_MORE
        assert "the time limit of 5 s was over before anything was known" in str(answer)
    else:
        assert says(answer)


@pytest.mark.parametrize("look", [1, 7, 60])
@pytest.mark.parametrize("verb", TIMED)
def test_a_verb_ends_at_whichever_look_its_time_is_up(looks, verb, look):
    """Few looks follow: the work is over, and what was done by then is put in order; each is
    answered, or raises.
    """
    count = looks(look)
    answer = asked(verb)
    done = next(count)
    assert done <= look + 3000
    if isinstance(answer, kempe.errors.TimeLimitError):
        assert done > look
    else:
        assert says(answer) is (done > look) or verb in FAST, (done, str(answer))


FAST = {"assemble open", "ik_sweep of an arm angle", "workspace"}
"""Verbs that may end by themselves at the look at which the time is up."""


@pytest.mark.parametrize(
    "ask", [lambda: FLAT.mobility(FLAT.q("flat")), lambda: MANY.assemble(), lambda: CAR.classify()]
)
def test_a_verb_that_another_one_asks_has_the_time_of_that_one(ask):
    """It has no answer of its own where that time is up: nobody takes a part for the whole."""
    with TimeLimit(1e-9), pytest.raises(TimeUp):
        ask()


def test_a_block_of_time_is_over_where_it_ends():
    """Also where the same one stands in itself, and in a thread of its own."""
    time = TimeLimit(1e-9)
    with time, pytest.raises(TimeUp):
        check_for_stop()
    check_for_stop()
    again = TimeLimit(1e9)
    with again, again:
        assert len(list_checks()) == 2
    assert not list_checks()


def test_time_limits_stand_in_the_documentation():
    """The table of docs/conventions.md is what the verbs do."""
    text = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `([a-z_.]+)` \| (\d+ s|none)", text, re.MULTILINE))
    for verb, all_ in usual().items():
        limits = [own.reads["time_limit"] for own in all_]
        single = min((x for x in limits if x is not None), default=None)
        assert rows.pop(verb) == ("none" if single is None else f"{single:g} s"), verb
    assert not rows


# ---- Ctrl-C


class Ends:
    """Progress that interrupts, as Ctrl-C, at its call number `at`; `came` says that it did."""

    def __init__(self, at: int = 0):
        self.at = at
        self.came = False

    def __call__(self, *done: object) -> None:
        assert not self.came, "the work goes on after an interrupt"
        self.at -= 1
        if self.at < 0:
            self.came = True
            raise KeyboardInterrupt


def rssr() -> kempe.System:
    return kempe.load("rssr")


INTERRUPTED = {
    "ik_path": lambda b: ARM.ik_path(
        ARM.fk(Q + np.linspace(0.0, 0.1, 9)[:, None], "tool"), "tool", Q, budget=b
    ),
    "assembly_modes": lambda b: rssr().assembly_modes({"A": 0.4}, budget=b),
    "self_motion": lambda b: SEVEN.inverse.self_motion(FREE, "tool", budget=b),
    "trace": lambda b: LINKAGE.trace("A", budget=b),
    "trace of branches": lambda b: kempe.load("parallelogram").trace(
        "A", ways="branches", budget=b
    ),
    "resample": lambda b: LINKAGE.trace("A").resample(9, budget=b),
    "drive": lambda b: LINKAGE.drive({"A": np.linspace(0.3, 1.0, 99)}, budget=b),
    "workspace": lambda b: ARM.workspace("tool", n=1e6, cells=8, budget=b),
    "sample": lambda b: kempe.load("five_bar").configuration_space.sample(99, budget=b),
    "singularities": lambda b: ARM.singularities("tool", budget=b),
    "curves": lambda b: (
        kempe.load("two_link").singularities("e", budget=Budget(starts=8)).curves(budget=b)
    ),
    "plot of singularities": lambda b: (
        kempe.load("two_link").singularities("e", budget=Budget(starts=8)).plot(budget=b)
    ),
    "reach.poses": lambda b: ARM.reach.poses(X[None], "tool", budget=b),
    "reach.place": lambda b: ARM.reach.place(X[None], "tool", {"x": (0.0, 0.1)}, 3, budget=b),
    "reach.capability": lambda b: ARM.reach.capability(
        "tool", [[0.0] * 3, [0.5] * 3], 2, 4, budget=b
    ),
}


@pytest.mark.parametrize("verb", INTERRUPTED)
def test_an_interrupt_goes_on_to_the_caller_with_what_was_done(verb):
    """One Ctrl-C ends a loop over calls: no verb takes it for an answer."""
    pytest.importorskip("matplotlib")
    ends = Ends()
    calls = 0
    with pytest.raises(kempe.Interrupted) as stop:
        for _ in range(2):
            INTERRUPTED[verb](Budget(progress=ends))
            calls += 1
    answer = stop.value.answer
    assert ends.came and not calls and answer is not None
    if not verb.startswith("plot"):
        assert "interrupted" in str(answer) or answer.code is kempe.Status.INTERRUPTED
        assert "answer" in str(stop.value) and issubclass(stop.type, KeyboardInterrupt)


@pytest.mark.parametrize(
    "ask",
    [
        lambda: open_loops(30).assemble(),
        lambda: ARM.assemble(also=[NEVER]),
        lambda: ARM.ik([kempe.tasks.Pose("tool", X), NEVER]),
        lambda: ARM.ik(kempe.tasks.Pose("tool", FAR)),
        lambda: OPEN.assemble(),
    ],
)
@pytest.mark.parametrize("at", [0, 3])
def test_an_interrupt_while_a_kernel_looks_at_the_clock_is_not_lost(ask, at, monkeypatch):
    """Python hears Ctrl-C in the function that kernels call, from which no exception passes through
    a kernel.
    """
    ends = Ends(at)
    monkeypatch.setattr(clock, "check_for_stop", ends)
    with pytest.raises(KeyboardInterrupt):
        ask()
    assert ends.came


def test_what_a_verb_inside_another_did_is_no_answer(monkeypatch):
    """The samples of a linkage are taken along traced curves: an interrupted curve is no sample."""
    monkeypatch.setattr("kempe.motion.trace.find_return", lambda *_: Ends()())
    with pytest.raises(kempe.Interrupted) as stop:
        LINKAGE.configuration_space.sample(9)
    assert stop.value.answer is None
    with pytest.raises(kempe.Interrupted) as stop:
        LINKAGE.configuration_space.components()
    assert stop.value.answer.interrupted and stop.value.answer.count == 2
    with pytest.raises(kempe.Interrupted) as stop:
        LINKAGE.configuration_space.path(
            LINKAGE.assemble({"A": 0.3}).q, LINKAGE.assemble({"A": 0.9}).q
        )
    assert stop.value.answer.interrupted


def test_interrupts_are_pickled_with_their_answer():
    with pytest.raises(kempe.Interrupted) as stop:
        LINKAGE.trace("A", budget=Budget(progress=Ends()))
    again = pickle.loads(pickle.dumps(stop.value))
    assert np.array_equal(again.answer.q, stop.value.answer.q)


@pytest.mark.parametrize("times", [1, 2])
def test_an_interrupt_before_the_first_line_of_a_function_of_a_kernel_is_kept(times, monkeypatch):
    """While a kernel works Ctrl-C waits; Python raises it where the kernel calls back, outside the
    function's lines.

    `map` and `operator.call` call C functions one after the other, with no line of Python between
    them.
    """
    lost: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        out = (ctypes.c_double * 1)()
        number = ctypes.POINTER(ctypes.c_double)
        kernel = ctypes.CFUNCTYPE(None, number, number, number, ctypes.c_int64)(
            clock.get_clock().address
        )
        called = functools.partial(kernel, out, out, out, 0)
        list(map(operator.call, [ctypes.pythonapi.PyErr_SetInterrupt, called] * times))
        with pytest.raises(KeyboardInterrupt):
            clock.get_clock().take_error()
        assert clock.get_clock().take_error() is None and not lost
        called()
        assert out[0] == 0.0
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_exceptions_that_python_cannot_raise_go_where_they_went(monkeypatch):
    lost: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    assert clock.get_clock().address

    class Ends:
        def __del__(self):
            raise KeyboardInterrupt

    Ends()
    assert [x.exc_type for x in lost] == [KeyboardInterrupt]
