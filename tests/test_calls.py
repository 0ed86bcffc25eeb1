"""Wrong calls are answered with an error of Kempe's own, which names what is wrong and what is
allowed.
"""

from __future__ import annotations

import copy
import importlib
import inspect
import pickle
import re
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
import pytest
import wrong_calls
from hunts import Hunt

import kempe
from kempe import arguments, namespaces, tasks
from kempe.errors import (
    CallError,
    DescriptionError,
    InputError,
    KempeError,
    RoundedWarning,
    UnknownNameError,
)

PUMA = kempe.load("puma560")
FOUR_BAR = kempe.load("four_bar")
X = PUMA.fk(PUMA.mid, "tool")


# ---- any wrong call


def kept(x: Any) -> Any:
    """A copy of an argument that a call could change; nothing for all else."""
    return copy.deepcopy(x) if isinstance(x, np.ndarray) or type(x) in (dict, list) else None


def same(a: Any, b: Any) -> bool:
    """Whether an argument is what it was."""
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and repr(a) == repr(b)
    return b is None or len(a) == len(b)


def is_pythons_own(error: TypeError) -> bool:
    """Whether it is Python that refused the call, before anything of Kempe ran."""
    files = [frame.filename for frame in traceback.extract_tb(error.__traceback__)]
    return not any("/kempe/" in file for file in files)


def written_to(function: Callable[..., Any]) -> int | None:
    """The place of the argument that an answer is written to, if there is one."""
    names = list(inspect.signature(function).parameters)
    return names.index("out") if "out" in names else None


def answered(call: wrong_calls.Call) -> None:
    """Make a wrong call: it may have an answer, or be refused with an error of Kempe's own."""
    given = [x for k, x in enumerate(call.args) if k != written_to(call.function)]
    given += [x for name, x in call.options.items() if name != "out"]
    before = [kept(x) for x in given]
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            str(call.function(*call.args, **call.options))
    except KempeError as error:
        assert str(error), call
    except TypeError as error:
        assert is_pythons_own(error), f"{call}: {error!r}"
    except Exception as error:
        raise AssertionError(f"{call}: {error!r}") from error
    assert all(same(a, b) for a, b in zip(given, before, strict=True)), (
        f"{call} has changed what it was given"
    )
    # of numpy, say
    wrong = [w for w in warned if w.category not in (RoundedWarning, DeprecationWarning)]
    assert not wrong, f"{call}: {wrong[0].category.__name__} {wrong[0].message}"


def hunted(hunt: Hunt, count: int) -> None:
    rng = hunt.rng()
    everything = wrong_calls.functions()
    for _ in range(hunt.cases(count)):
        answered(wrong_calls.call_of(*everything[rng.integers(len(everything))], rng))


def test_some_wrong_calls(hunt):
    hunted(hunt, 150)


@pytest.mark.slow
def test_wrong_calls(hunt):
    """Of everything that is public, with arguments of any kind but the right one."""
    hunted(hunt, 2000)


def extremes(hunt: Hunt, count: int) -> None:
    rng = hunt.rng()
    everything = list(
        {title: (title, f, system) for title, f, system in wrong_calls.functions()}.values()
    )
    for _ in range(hunt.cases(count)):
        call = wrong_calls.extreme_call_of(*everything[rng.integers(len(everything))], rng)
        if call is not None:
            answered(call)


def test_some_extreme_numbers(hunt):
    extremes(hunt, 400)


@pytest.mark.slow
def test_extreme_numbers(hunt):
    """Infinities, NaN, numbers near the ends of floats: refused in words, or answered, without a
    warning of numpy.
    """
    extremes(hunt, 5000)


REFUSED = {
    "a class for a function": (lambda: PUMA.assemble(also=type(None)), "which it does not take"),
    "an array for a preference": (
        lambda: PUMA.ik(X, "tool", prefer=np.zeros((2, 3))),
        "prefer is array.*a function of q",
    ),
    "an infinite weight": (
        lambda: PUMA.ik_step(PUMA.mid, np.zeros(6), "tool", 0.01, weights=np.inf),
        "none negative or",
    ),
    "a number for rows": (lambda: kempe.from_dh(np.array(3.0)), "rows are array.*must be a list"),
    "an empty parameter": (
        lambda: PUMA.inverse.sweep(X, "tool", ()),
        "the parameter is .*a name, or a name and",
    ),
    "more samples than memory": (
        lambda: PUMA.inverse.sweep(X, "tool", n=2**31),
        "from 2 to 10000000",
    ),
    "an equation beyond floats": (
        lambda: tasks.Equation(10**400),
        "its size must be at most 1e\\+100",
    ),
    "folders that are numbers": (
        lambda: kempe.read("four_bar", package_dirs=[1]),
        "must be a list of folders",
    ),
    "no symbol": (
        lambda: FOUR_BAR.symbolic.fk("crank", symbols={"A": None}),
        "its values must be symbols",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_refused(what):
    call, said = REFUSED[what]
    with pytest.raises(InputError, match=said):
        call()


def test_a_mechanism_without_freedoms_has_one_mode_and_stays_where_it_is():
    assert len(kempe.Mechanism("nothing").build().assembly_modes({}).q) == 1
    ball = kempe.load("joint_spherical").simulate(2.0)
    assert np.isfinite(ball.q).all()


def test_one_folder_is_not_a_list_of_letters(tmp_path):
    assert kempe.read("four_bar", package_dirs=str(tmp_path)).roots == (str(tmp_path),)


# ---- options


VERBS = [
    ("ik", (X, "tool"), "method"),
    ("ik", ([tasks.Pose("tool", X)],), "prefer"),
    ("inverse.sweep", (X, "tool"), "fixed"),
    ("ik_path", (X[None], "tool"), "max_step"),
    ("assemble", ({},), "branch"),
    ("ik_step", (PUMA.mid, np.zeros(6), "tool", 0.01), "damping"),
    ("inverse.self_motion", (PUMA.mid, "tool"), "direction"),
    ("assembly_modes", ({},), "limits"),
    ("from_maximal", (PUMA.fk(PUMA.mid)[1:],), "tolerance"),
    ("mobility", (), "local"),
    ("trace", (), "toward"),
    ("drive", ({"q1": [0.0, 0.1]},), "times"),
    ("loops.jacobian", (PUMA.mid, ["q1"], ["tool"]), "in_frame"),
    ("plot", (), "labels"),
    ("loops.mechanical_advantage", (PUMA.mid, "q1", "q2"), "direction"),
    ("loops.transmission_angle", (PUMA.mid, "q2"), "joint"),
]


def verb_of(system: kempe.System, verb: str) -> Callable[..., Any]:
    """A method, of a namespace or of the system itself, or a function of `kempe.convert`."""
    return (
        partial(getattr(kempe.convert, verb), system)
        if "maximal" in verb
        else attrgetter(verb)(system)
    )


@pytest.mark.parametrize(("verb", "args", "option"), VERBS, ids=[f"{v}-{o}" for v, _, o in VERBS])
def test_an_unknown_option_names_the_nearest(verb, args, option):
    """As an error of Kempe's own that is a TypeError, too, as Python users expect."""
    with pytest.raises(
        CallError, match=f"has no option '{option}_'; did you mean .*'{option}'"
    ) as caught:
        verb_of(PUMA, verb)(*args, **{f"{option}_": 1})
    assert isinstance(caught.value, TypeError) and option in caught.value.allowed
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value) and again.allowed == caught.value.allowed


def test_an_unknown_option_of_a_task():
    with pytest.raises(CallError, match="Position has no option 'weigth'; did you mean 'weight'"):
        tasks.Position("tool", [0, 0, 0], weigth=1.0)


def test_what_the_map_of_the_library_calls_is_explained():
    source = inspect.getsource(kempe.System) + inspect.getsource(namespaces)
    found = re.findall(r"        from (kempe[\w.]+) import (\w+)$", source, re.MULTILINE)
    functions = [getattr(importlib.import_module(module), name) for module, name in found]
    assert len(functions) > 30
    takes = [f for f in functions if len(inspect.signature(f).parameters) > 1]
    assert [f.__name__ for f in takes if not hasattr(f, "__wrapped__")] == []


def test_what_is_missing_is_named():
    with pytest.raises(CallError, match="ik_all: missing a required argument: 'frame'|ik_all"):
        kempe.inverse.ik_all.ik_all(PUMA, X)
    with pytest.raises(CallError, match="revolute: too many positional arguments"):
        PUMA.mechanism.revolute("q7", "link6", "hand", (0, 0, 1))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: PUMA.random(n=100), "random has no option 'n'; there are: 'rng', 'shape'"),
        (lambda: PUMA.q(), "q: missing a required argument: 'coordinates'"),
        (lambda: PUMA.query(), "query: missing a required argument: 'frame'"),
        (lambda: PUMA.with_limits(limit={}), "with_limits has no option 'limit'; did you mean"),
        (lambda: FOUR_BAR.open_loops(joint="D"), "open_loops has no option 'joint'; did you mean"),
    ],
)
def test_arguments_of_short_methods_are_named(call, said):
    with pytest.raises(CallError, match=said):
        call()


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("q", "start=q"),
        ("prefer", "start=q"),
        ("hold", "fixed={'name': value}"),
        ("starts_", "'start'"),
    ],
)
def test_options_of_ik_that_ik_all_has_by_another_name(option, said):
    with pytest.raises(CallError) as caught:
        PUMA.ik_all(X, "tool", **{option: PUMA.mid})
    assert said in str(caught.value)
    with pytest.raises(CallError, match="no option 'toleranse'; did you mean 'tolerance'"):
        PUMA.ik_all(X, "tool", toleranse=0.1)
    with pytest.raises(UnknownNameError, match="no joint 'q9'"):
        PUMA.ik_all(X, "tool", fixed={"q9": 0.1})


def test_errors_within_functions_of_the_caller_are_left_alone():
    def wrong(x: np.ndarray) -> float:
        return x + "text"  # type: ignore[operator]

    with pytest.raises(TypeError) as caught:
        PUMA.ik([tasks.Function(wrong)])
    assert not isinstance(caught.value, KempeError)


def test_what_fails_with_right_arguments_is_raised_as_it_is():
    @arguments.explain_errors
    def broken(system: str, starts: int = 3) -> int:
        return [][starts]

    with pytest.raises(IndexError):
        broken("a")
    with pytest.raises(InputError, match="starts is 'x'; it must be a whole number") as caught:
        broken("a", "x")
    assert isinstance(caught.value.__cause__, TypeError)


# ---- single cases


CASES = {
    "posture of numbers": (
        lambda: PUMA.q([0] * 6),
        InputError,
        "by coordinate name, or the name of a posture",
    ),
    "unknown posture": (lambda: PUMA.q("q"), UnknownNameError, "no posture .*; .* 'qz'"),
    "list of one frame": (lambda: PUMA.ik_all(X, ["tool"]), UnknownNameError, "no frame"),
    "list of one driver": (
        lambda: FOUR_BAR.trace(["A"]),
        InputError,
        "driver is .'A'.; it must be text or None",
    ),
    "text as q": (lambda: PUMA.q_dict("abc"), InputError, "q is"),
    "nearest to q": (
        lambda: PUMA.ik_all(X, "tool").nearest(PUMA.mid),
        InputError,
        "index .* must be a whole number",
    ),
    "no tasks": (lambda: PUMA.ik([]), InputError, "it is an empty list"),
    "letter for a branch": (
        lambda: FOUR_BAR.assemble({"A": 1.0}, branch="x"),
        InputError,
        "branch is 'x'",
    ),
    "start too large": (
        lambda: PUMA.ik(X, "tool", np.full(6, 1e101)),
        InputError,
        r"start\['q1'\] is 1e\+101; its size must be below",
    ),
    "rng too large": (
        lambda: FOUR_BAR.assemble(budget=kempe.Budget(rng=2**63)),
        InputError,
        r"rng is .* below 2\*\*62",
    ),
    "names of numbers": (
        lambda: PUMA.loops.assembler([1]),
        InputError,
        "known is .1.; it must be a list of names",
    ),
    "rows of other lengths": (
        lambda: PUMA.ik([[1, 2, 3], [1, 0]], "tool"),
        InputError,
        "target is ragged: row 1 has 2 numbers, row 0 has 3 numbers; it must be an array",
    ),
    "position beside a quaternion": (
        lambda: PUMA.ik(([1, 2, 3], [1, 0, 0, 0]), "tool"),
        InputError,
        "row 1 has 4 numbers.*write {'at': .*'quat_wxyz'",
    ),
    "place that is infinite": (
        lambda: PUMA.ik([np.inf, 0, 0], "tool"),
        InputError,
        "target is not a pose: its x is inf; it must be finite",
    ),
    "tasks with a frame": (
        lambda: PUMA.ik([tasks.Position("tool", [1, 0, 0])], "tool"),
        InputError,
        "target holds tasks, which name their own frames: leave out the frame",
    ),
    "posture as q": (
        lambda: PUMA.fk("qz", "tool"),
        InputError,
        r"q is 'qz'; .* a posture is system.q\('qz'\)",
    ),
    "more than memory": (lambda: PUMA.random(0, 2**60), InputError, "this memory does not hold"),
    "row of a batch": (
        lambda: PUMA.ik(np.stack([X, X]), "tool").sentence((2,)),
        InputError,
        "index is .2,.",
    ),
    "text as a vector": (lambda: kempe.spatial.exp_so3("x"), InputError, "w is 'x'"),
    "vector of two": (lambda: kempe.spatial.exp_so3([1.0, 2.0]), InputError, r"w has shape \(2,\)"),
    "endless points": (lambda: FOUR_BAR.trace("A").resample(2**40), InputError, "at most 10000000"),
    "a switch that is none": (
        lambda: PUMA.mechanism.joint("j", "fixed", "link6", "link1", cut="no"),
        InputError,
        "cut of joint 'j'",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_wrong_arguments_are_named(case):
    call, kind, said = CASES[case]
    with pytest.raises(kind, match=said):
        call()


def test_a_bad_last_row_in_a_batch_is_named():
    bad = np.stack([X, X])
    bad[1, 3] = [0.0, 0.0, 1.0, 1.0]
    for answer in (PUMA.ik(bad, "tool"), PUMA.ik_all(bad, "tool")):
        assert "its last row is [0.0, 0.0, 1.0, 1.0]" in answer.status[1]
    bad[1] = np.nan
    assert (
        "target is not a pose: its entry [0, 0] is nan; it must be finite"
        in PUMA.ik(bad, "tool").status[1]
    )
    seeds = np.stack([PUMA.mid, np.full(6, 1e101)])
    assert "start has entries" in PUMA.ik(np.stack([X, X]), "tool", seeds).status[1]


def test_attaching_names_the_prefix():
    rail = kempe.Mechanism("rail")
    rail.prismatic("x", rail.ground, rail.body("carriage"), axis=(1, 0, 0))
    before = rail.content()
    with pytest.raises(
        DescriptionError,
        match=r"both have bodies and frames 'ground'; .*attach\(..., prefix='ur5_'\)",
    ):
        rail.attach(kempe.load("ur5"), to="carriage")
    assert rail.content() == before
    assert rail.attach(kempe.load("ur5"), to="carriage", prefix="ur5_").build().nq == 7
    with pytest.raises(
        DescriptionError, match="joints and constraints .*7 in all.*prefix='ur5_2_'"
    ):
        rail.attach(kempe.load("ur5"), to="carriage", prefix="ur5_")


def test_the_centre_of_mass_needs_no_number_that_does_not_count():
    arm = kempe.Mechanism("arm")
    arm.revolute("a", arm.ground, arm.body("u", mass=1.0, center=(0.2, 0, 0)))
    arm.revolute(
        "b", "u", arm.body("v", mass=1.0, center=(0.2, 0, 0)), at=(0.5, 0, 0), axis=(0, 1, 0)
    )
    arm = arm.build()
    goal = tasks.error(arm, tasks.CentreOfMass([0.0, 0.0, 0.0]), arm.q({"a": 0.3, "b": 0.4}))
    short, whole = (
        arm.ik([tasks.CentreOfMass(p, axes="xy")]) for p in (goal[:2], [*goal[:2], 7.0])
    )
    assert short and np.array_equal(short.q, whole.q)
    with pytest.raises(
        InputError, match=r"\(2,\); it must be \(..., 3\), or \(..., 1\) for axes='z'"
    ):
        arm.ik([tasks.CentreOfMass(goal[:2], axes="z")])


def test_a_query_is_pickled():
    for frame in ("tool", "link3"):
        again = pickle.loads(pickle.dumps(PUMA.query(frame)))
        assert (again.system, again.frame) == (PUMA, frame)
        assert np.array_equal(again(PUMA.mid), PUMA.fk(PUMA.mid, frame))
        assert np.array_equal(again.jacobian(PUMA.mid), PUMA.jacobian(PUMA.mid, frame))
    again = copy.deepcopy(PUMA.query("tool"))
    assert np.array_equal(again(PUMA.mid), X)


def test_drawings_of_all_frames():
    pytest.importorskip("matplotlib")
    assert FOUR_BAR.plot(frames=None).figure is not None


@pytest.mark.parametrize("name", ["puma560", "panda", "four_bar", "joint_spherical"])
def test_answers_print_little(name):
    """Whatever the size of a batch: of large arrays their shape."""
    system = kempe.load(name)
    q = system.random(0, 1000)
    frame = system.frame_names[-1]
    large = (
        []
        if system.structure.closures
        else [
            system.ik(system.fk(q, frame), frame),
            system.ik([tasks.Pose(frame, system.fk(q, frame))]),
        ]
    )
    if name == "four_bar":
        large = [
            system.assemble({"A": q[:, 0]}),
            system.loops.jacobian(system.assemble({"A": np.linspace(0, 1, 1000)}).q, ["A"], ["D"]),
        ]
    for answer in (*large, *(a for _, a in wrong_calls.answers(system))):
        assert len(repr(answer)) <= 2500 and len(str(answer)) < 5000


# ---- arguments of a wrong kind, where errors of numpy and Python came out

FOUR = kempe.load("four_bar")
WRONG_KINDS = {
    "tasks.error": (
        lambda: kempe.tasks.error(PUMA, "nan", PUMA.mid),
        "constraint is 'nan'; it must be a task",
    ),
    "tasks.count": (lambda: kempe.tasks.count(PUMA, [{}]), "constraint is"),
    "tasks.jacobian": (lambda: kempe.tasks.jacobian(PUMA, {"q1": 1}, PUMA.mid), "constraint is"),
    "tasks.miss": (lambda: kempe.tasks.miss(PUMA, np.eye(4), PUMA.mid), "constraint is"),
    "convert.expand_joints": (
        lambda: kempe.convert.expand_joints([1]),
        "system is .*; it must be a System",
    ),
    "convert.maximal": (lambda: kempe.convert.maximal((1,)), "system is .*; it must be a System"),
    "convert.maximal_q": (
        lambda: kempe.convert.maximal_q([{}]),
        "system is .*; it must be a System",
    ),
    "path.save of None": (
        lambda: FOUR.trace("A").save(None),
        "path is None; it must be the path of a file",
    ),
    "path.save of bytes": (lambda: FOUR.trace("A").save(b"x.csv"), "path is b'x.csv'"),
    "mechanism.save": (lambda: FOUR.mechanism.save(None), "path is None"),
    "plot far away": (lambda: kempe.load("slider_crank").plot(np.full(4, 1e200)), "beyond 1e"),
    "plot of axes": (lambda: PUMA.plot(axes=np.zeros(6)), "no frame"),
    "plot of labels": (lambda: PUMA.plot(labels=np.zeros((2, 2))), "labels is"),
    "fk of a module": (lambda: PUMA.fk(np, "tool"), "q is"),
    "a place in a path": (lambda: FOUR.trace("A")["a"], "index is 'a'; it must be a whole number"),
}


@pytest.mark.parametrize("name", WRONG_KINDS)
def test_wrong_kinds_are_refused_in_words(name):
    if name.startswith("plot"):
        pytest.importorskip("matplotlib")
    call, said = WRONG_KINDS[name]
    with pytest.raises(KempeError, match=said) as error:
        call()
    assert len(str(error.value)) < 500


def test_unusual_kinds_that_say_what_is_meant_are_taken():
    way = kempe.load("car").manoeuvre([0.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    assert way.at(np.zeros((3, 0, 6))).shape == (3, 0, 6, 3)
    assert kempe.from_dh(memoryview(np.zeros((3, 4)))).build().nq == 3
    with pytest.raises(IndexError):
        way[10**9]


ENDLESS = {
    "fk": lambda x: PUMA.fk(x, "tool"),
    "ik": lambda x: PUMA.ik(x, "tool"),
    "tasks": lambda x: PUMA.ik(x),
    "start": lambda x: PUMA.ik(np.eye(4), "tool", x),
    "spatial": kempe.spatial.inverse,
    "known": lambda x: FOUR.assemble({"A": x}),
    "limits": lambda x: PUMA.with_limits(x),
    "frames": lambda x: PUMA.fk(PUMA.mid, x),
    "dh": kempe.from_dh,
    "poses": lambda x: PUMA.reach.poses(x, "tool"),
    "actuated": lambda x: PUMA.mobility(actuated=x),
}


@pytest.mark.parametrize("name", ENDLESS)
@pytest.mark.parametrize("kind", ["once", "twice", "with numbers"])
def test_a_list_that_holds_itself_is_refused(name, kind):
    """Twice: its entries would double with each level that is looked at."""
    own: list = [1.0] if kind == "with numbers" else []
    own += [own] if kind != "twice" else [own, own]
    with pytest.raises(KempeError) as error:
        ENDLESS[name](own)
    assert len(str(error.value)) < 500


LONG = "x" * 200_000
ECHOES = {
    "frame": lambda: PUMA.fk(PUMA.mid, LONG),
    "coordinate": lambda: PUMA.q({LONG: 1.0}),
    "task": lambda: PUMA.ik(np.eye(4), "tool", task=LONG),
    "form": lambda: PUMA.fk(PUMA.mid, "tool", form=[0.5] * 10**5),
    "posture": lambda: PUMA.ik(np.eye(4), "tool", LONG),
    "driver": lambda: FOUR.trace(LONG),
    "ways": lambda: FOUR.trace("A", ways=LONG),
    "verb": lambda: kempe.map_file(PUMA, LONG, "a.npy", "b.zarr"),
    "format": lambda: kempe.read("<robot/>", format=LONG),
    "parameter": lambda: PUMA.with_parameters(**{LONG: 1.0}),
    "file": lambda: kempe.load(
        f"<robot name='a'><link name='{LONG}'/><link name='{LONG}'/></robot>"
    ),
}


@pytest.mark.parametrize("what", ECHOES)
def test_messages_echo_little_of_what_was_given(what):
    with pytest.raises(KempeError) as error:
        ECHOES[what]()
    assert 20 < len(str(error.value)) < 3000 and max(map(len, str(error.value).split("\n"))) <= 1100


def test_a_long_message_keeps_its_beginning_and_its_end():
    said = str(InputError(f"task is {LONG}; it must be 'pose'\nsecond line"))
    assert said.startswith("task is xxx") and re.search(r"\(2000\d\d characters in all\)", said)
    assert said.endswith("xxx; it must be 'pose'\nsecond line")
    assert str(InputError("a short one")) == "a short one" and str(
        pickle.loads(pickle.dumps(InputError(LONG)))
    ) == str(InputError(LONG))


LARGE = {
    "assemble": (
        lambda: FOUR.assemble({"A": 1e300}),
        r"known value of 'A' is 1e\+300; its size must be below 1e\+100",
    ),
    "start": (lambda: FOUR.assemble(start=[0, 1e300, 0, 0]), r"start\['B'\] is 1e\+300; its size"),
    "modes": (
        lambda: FOUR.assembly_modes({"A": np.inf}),
        "known value of 'A' is inf; it must be finite",
    ),
    "trace": (
        lambda: FOUR.trace("A", start=[1e15, 0, 0, 0]),
        r"start\['A'\] is 1e\+15 rad; angles of a motion must",
    ),
    "hold": (
        lambda: kempe.load("five_bar").trace("A", hold={"B": 1e12}),
        r"hold\['B'\] is 1e\+12 rad",
    ),
    "drive": (
        lambda: FOUR.drive({"A": [0, 1e308]}),
        r"input 'A'\[1\] is 1e\+308; its size must be below",
    ),
    "drive by a function": (
        lambda: FOUR.drive({"A": lambda t: 1e9 * t}, [0, 1]),
        r"input 'A' at time 1 is 1e\+09 rad",
    ),
    "manoeuvre": (
        lambda: kempe.load("car").manoeuvre([0, 0, 1e120], [1, 0, 0]),
        r"start\['.*'\] is 1e\+120; its size",
    ),
    "ik": (
        lambda: PUMA.ik(X, "tool", [0, 1e101, 0, 0, 0, 0]),
        r"start\['q2'\] is 1e\+101; its size must be below",
    ),
    "whole": (
        lambda: FOUR.assemble({"A": 10**400}),
        "the known value of 'A' has a number that no float holds",
    ),
    "length": (
        lambda: kempe.load("two_link").with_parameters(l1=1e300),
        r"parameter 'l1' is 1e\+300; its size",
    ),
    "place": (
        lambda: FOUR.mechanism.frame("f", "crank", at=(1e300, 0)),
        r"1e\+300; its size must be below 1e\+100",
    ),
}


@pytest.mark.parametrize("name", LARGE)
def test_numbers_that_are_too_large_are_named(name):
    """They are finite, and said to be so; no statement about the mechanism is made of them."""
    call, said = LARGE[name]
    with pytest.raises((InputError, DescriptionError), match=said):
        call()


def test_whole_numbers_of_any_size_are_numbers():
    assert np.array_equal(FOUR.fk([10**30, 0, 0, 0]), FOUR.fk([1e30, 0, 0, 0]))
    assert FOUR.assemble({"A": 10**20}).q[0] == 1e20


@pytest.mark.parametrize("turns", [0, 10**3, 10**7])
def test_angles_of_many_turns_move_as_the_same_angles_do(turns):
    q = FOUR.assemble({"A": 0.7}).q + [2.0 * np.pi * turns, 0.0, 0.0, 0.0]
    path = FOUR.trace("A", start=q)
    assert path.closed and len(path.q) == len(FOUR.trace("A", start=FOUR.assemble({"A": 0.7}).q).q)


POSES = {
    "ik": lambda Y: PUMA.ik(Y, "tool"),
    "ik_all": lambda Y: PUMA.ik_all(Y, "tool"),
    "tasks": lambda Y: PUMA.ik([tasks.Pose("tool", Y)]),
    "path": lambda Y: PUMA.ik_path(np.stack([X, Y]), "tool"),
    "reach": lambda Y: PUMA.reach.poses(np.stack([X, Y]), "tool"),
    "sweep": lambda Y: kempe.load("panda").inverse.sweep(Y, "tool"),
    "place": lambda Y: kempe.load("stewart").assemble({"platform": Y}),
    "maximal": lambda Y: kempe.convert.from_maximal(
        PUMA, np.concatenate([PUMA.fk(PUMA.mid)[1:-1], Y[None]])
    ),
}
NO_POSES = {
    "last row": (
        np.diag([1.0, 1.0, 1.0, 2.0]),
        r"its last row is \[0.0, 0.0, 0.0, 2.0\]; it must be 0 0 0 1",
    ),
    "mirror": (np.diag([1.0, 1.0, -1.0, 1.0]), "det R is not positive, where R is its rotation"),
    "stretched": (
        np.diag([2.0, 1.0, 1.0, 1.0]),
        "R'R - 1 has an entry of 3, where R is its rotation",
    ),
    "nan": (
        np.where(np.arange(16).reshape(4, 4) == 3, np.nan, np.eye(4)),
        "its x is nan; it must be",
    ),
    "large": (
        np.where(np.arange(16).reshape(4, 4) == 3, 1e120, np.eye(4)),
        r"its x is 1e\+120; its size",
    ),
}


@pytest.mark.parametrize("wrong", NO_POSES)
@pytest.mark.parametrize("verb", POSES)
def test_all_verbs_say_the_same_about_a_matrix_that_is_no_pose(verb, wrong):
    Y, said = NO_POSES[wrong]
    with pytest.raises(InputError, match=said):
        POSES[verb](Y)
