"""Two contracts, each tested over every verb: answers (configurations) and reports (findings)."""

from __future__ import annotations

import html
import inspect
import json
import pickle
import re
import sys
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from hunts import some

import kempe
from kempe import Budget, library
from kempe.answers.answer import Answer
from kempe.arguments import call_until_interrupt
from kempe.errors import InputError, KempeError
from kempe.namespaces import BodyGeometry, Inverse, Loops, ReachStudies
from kempe.report import Report, Result
from kempe.status import Status
from kempe.words import convert_sentence_angles


def marked(name: str, *joints: str) -> kempe.System:
    """A shipped model with names that HTML would take for tags."""
    text = re.sub(
        r"^\[postures.*?(?=^\[(?!postures)|\Z)",
        "",
        library.find_model_file(name).read_text(),
        flags=re.M | re.S,
    )
    text = text.replace(f'name = "{name}"', f'name = "<b>{name}</b>"', 1)
    for joint in joints:
        text = text.replace(f'name = "{joint}"', f'name = "<b>{joint}"')
    return kempe.load(text)


ARM = marked("puma560")
SEVEN = marked("iiwa14")
LINKAGE = marked("four_bar", *"ABCD")
TWO = marked("two_link_pose", "q1", "q2")
SPATIAL = marked("bennett")
CAR = marked("car")
BALL = marked("ball")
SHAPES = kempe.Mechanism("<b>shapes")
SHAPES.body("<b>ball")
SHAPES.prismatic("<b>slide", SHAPES.ground, "<b>ball", axis="x")
SHAPES.shape("<b>ball", "sphere", radius=0.1)
SHAPES.obstacle("<b>wall", "box", size=(0.1, 1.0, 1.0), at=(1.0, 0.0, 0.0))
SHAPES = SHAPES.build()
FIVE = marked("five_bar")
CRANK = "<b>A"
ROCKER = "<b>D"
TOOL = ARM.frame_names[-1]
TIP = SEVEN.frame_names[-1]
Q = ARM.mid + 0.1
SEVEN_Q = SEVEN.mid + 0.2
CLOSED = LINKAGE.assemble({CRANK: 0.3}).q
STRETCHED = LINKAGE.assemble({CRANK: np.arccos((0.6**2 + 0.4**2 - 0.4**2) / (2 * 0.6 * 0.4))}).q
"""Crank and coupler in one line, 0.6 m, by the law of cosines: a dead point of the rocker."""
X = ARM.fk(Q, TOOL)
FAR = X.copy()
WRONG = np.full((4, 4), np.nan)
FAR[:3, 3] += 9.0
BATCH = np.stack([X, FAR, WRONG])
EMPTY = np.zeros((0, 4, 4))
REACHED = ARM.fk(np.stack([Q, Q + 0.02, Q + 0.04]), TOOL)
POSITION = kempe.tasks.Position
THREE = Budget(starts=3)
FIVES = Budget(points=5)
MANY = Budget(starts=64)
NINE = Budget(points=9)
AT_ONCE = Budget(time_limit=1e-9)
NONE = np.zeros(0)
POINT = np.zeros((4, 4))
AHEAD = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e-3])


class Case(NamedTuple):
    """A call of a verb, and the outcomes that are expected of it: names of `Status`, of a batch in
    their order.
    """

    verb: str
    call: Callable[[], Any]
    expected: Any


def interrupt(*done: Any) -> None:
    """As Ctrl-C."""
    raise KeyboardInterrupt


BROKEN = Budget(progress=interrupt)


def held(n: int) -> dict[str, Any]:
    return {CRANK: np.linspace(0.3, 0.6, n)}


CASES = {
    "ik": Case("ik", lambda: ARM.ik(X, TOOL), "SOLVED"),
    "ik again": Case("ik", lambda: ARM.ik(X, TOOL, start=Q), "SOLVED"),
    "ik failing": Case("ik", lambda: ARM.ik(FAR, TOOL), "OUT_OF_REACH"),
    "ik of a batch": Case(
        "ik", lambda: ARM.ik(BATCH, TOOL), ["SOLVED", "OUT_OF_REACH", "BAD_INPUT"]
    ),
    "ik of none": Case("ik", lambda: ARM.ik(EMPTY, TOOL), []),
    "ik in time": Case(
        "ik", lambda: TWO.ik(TWO.fk(TWO.neutral, "p"), "e", budget=AT_ONCE), "OUT_OF_TIME"
    ),
    "tasks": Case("ik", lambda: ARM.ik([POSITION(TOOL, X[:3, 3])]), "SOLVED"),
    "tasks failing": Case(
        "ik", lambda: ARM.ik([POSITION(TOOL, FAR[:3, 3])], budget=THREE), "OUT_OF_REACH"
    ),
    "tasks that exclude each other": Case(
        "ik",
        lambda: ARM.ik([POSITION(TOOL, x[:3, 3]) for x in REACHED[1:]], budget=THREE),
        "CONTRADICTORY",
    ),
    "tasks of a batch": Case(
        "ik",
        lambda: ARM.ik([POSITION(TOOL, BATCH[:, :3, 3])], budget=THREE),
        ["SOLVED", "OUT_OF_REACH", "BAD_INPUT"],
    ),
    "tasks of none": Case("ik", lambda: ARM.ik([POSITION(TOOL, EMPTY[:, :3, 3])]), []),
    "ik_all": Case("ik_all", lambda: ARM.ik_all(X, TOOL), "SOLVED"),
    "ik_all failing": Case("ik_all", lambda: ARM.ik_all(FAR, TOOL), "NONE_EXISTS"),
    "ik_all of a batch": Case(
        "ik_all", lambda: ARM.ik_all(BATCH, TOOL), ["SOLVED", "NONE_EXISTS", "BAD_INPUT"]
    ),
    "ik_all of none": Case("ik_all", lambda: ARM.ik_all(EMPTY, TOOL), []),
    "ik_all inside": Case(
        "ik_all",
        lambda: ARM.with_limits({"q1": (2.0, 2.1)}).ik_all(X, TOOL, limits=True),
        "OUTSIDE_LIMITS",
    ),
    "ik_all of seven": Case("ik_all", lambda: SEVEN.ik_all(SEVEN.fk(SEVEN_Q, TIP), TIP), "SOLVED"),
    "ik_all through a loop": Case(
        "ik_all",
        lambda: LINKAGE.ik_all(LINKAGE.fk(CLOSED, "coupler_point")[:2, 3], "coupler_point"),
        "SOLVED",
    ),
    "ik_plan": Case("ik_plan", lambda: ARM.inverse.plan(TOOL), "SOLVED"),
    "ik_sweep": Case(
        "ik_sweep", lambda: SEVEN.inverse.sweep(SEVEN.fk(SEVEN_Q, TIP), TIP), "SOLVED"
    ),
    "ik_sweep sampled": Case(
        "ik_sweep", lambda: SEVEN.inverse.sweep(SEVEN.fk(SEVEN_Q, TIP), TIP, n=5), "SOLVED"
    ),
    "ik_sweep failing": Case("ik_sweep", lambda: SEVEN.inverse.sweep(FAR, TIP), "NONE_EXISTS"),
    "ik_sweep over a joint": Case(
        "ik_sweep",
        lambda: SEVEN.inverse.sweep(
            SEVEN.fk(SEVEN_Q, TIP), TIP, SEVEN.coordinate_names[2], budget=Budget(points=16)
        ),
        "SOLVED",
    ),
    "at": Case("at", lambda: SEVEN.inverse.sweep(SEVEN.fk(SEVEN_Q, TIP), TIP).at(0.2), "SOLVED"),
    "at of a batch": Case(
        "at",
        lambda: (
            SEVEN.with_limits({SEVEN.coordinate_names[0]: (-0.5, 0.5)})
            .inverse.sweep(SEVEN.fk(SEVEN_Q, TIP), TIP)
            .at([0.2, 3.0])
        ),
        ["OUTSIDE_LIMITS", "SOLVED"],
    ),
    "at failing": Case("at", lambda: SEVEN.inverse.sweep(FAR, TIP).at(0.2), "NONE_EXISTS"),
    "at of none": Case("at", lambda: SEVEN.inverse.sweep(SEVEN.fk(SEVEN_Q, TIP), TIP).at(NONE), []),
    "ik_path": Case("ik_path", lambda: ARM.ik_path(REACHED, TOOL, Q), "SOLVED"),
    "ik_path broken off": Case(
        "ik_path",
        lambda: call_until_interrupt(ARM.ik_path, REACHED, TOOL, Q, budget=BROKEN),
        "INTERRUPTED",
    ),
    "ik_path failing": Case("ik_path", lambda: ARM.ik_path(np.stack([X, FAR]), TOOL, Q), "PARTLY"),
    "ik_path without a beginning": Case(
        "ik_path", lambda: ARM.ik_path(FAR[None], TOOL, Q), "NOT_FOUND"
    ),
    "ik_step": Case("ik_step", lambda: ARM.ik_step(Q, AHEAD, TOOL, 0.01), "SOLVED"),
    "ik_step failing": Case("ik_step", lambda: ARM.ik_step(Q, 1e4 * AHEAD, TOOL, 0.01), "PARTLY"),
    "self_motion": Case(
        "self_motion", lambda: SEVEN.inverse.self_motion(SEVEN_Q, TIP, budget=FIVES), "SOLVED"
    ),
    "self_motion failing": Case(
        "self_motion",
        lambda: TWO.inverse.self_motion(np.array([0.4, 0.0]), "e", task="position"),
        "NOT_FOUND",
    ),
    "reach.poses": Case("reach.poses", lambda: ARM.reach.poses(REACHED, TOOL), "SOLVED"),
    "reach.poses failing": Case(
        "reach.poses", lambda: ARM.reach.poses(FAR[None], TOOL), "NOT_FOUND"
    ),
    "reach.poses in part": Case(
        "reach.poses", lambda: ARM.reach.poses(np.stack([X, FAR]), TOOL), "PARTLY"
    ),
    "reach.place": Case(
        "reach.place", lambda: ARM.reach.place(REACHED, TOOL, {"x": (-0.1, 0.1)}, 3), "SOLVED"
    ),
    "reach.place failing": Case(
        "reach.place", lambda: ARM.reach.place(FAR[None], TOOL, {"x": (0, 1)}, 2), "NOT_FOUND"
    ),
    "reach.capability": Case(
        "reach.capability",
        lambda: ARM.reach.capability(TOOL, [[-0.5] * 3, [0.5] * 3], 2, 4),
        "SOLVED",
    ),
    "reach.capability failing": Case(
        "reach.capability",
        lambda: ARM.reach.capability(TOOL, [[5.0] * 3, [6.0] * 3], 1, 2),
        "NOT_FOUND",
    ),
    "reach.planar": Case("reach.planar", lambda: TWO.reach.planar("e"), "SOLVED"),
    "singularities": Case(
        "singularities", lambda: TWO.singularities("e", "position", budget=THREE), "SOLVED"
    ),
    "singularities failing": Case(
        "singularities",
        lambda: LINKAGE.singularities("coupler", inputs=[CRANK], budget=THREE),
        "NOT_FOUND",
    ),
    "singularities of loops": Case(
        "singularities", lambda: FIVE.singularities("tip", budget=MANY), "SOLVED"
    ),
    "assemble": Case("assemble", lambda: LINKAGE.assemble({CRANK: 0.3}), "SOLVED"),
    "assemble failing": Case("assemble", lambda: LINKAGE.assemble({ROCKER: 0.0}), "NOT_FOUND"),
    "assemble beyond limits": Case(
        "assemble",
        lambda: LINKAGE.with_limits({CRANK: (0.0, 1.0)}).assemble({CRANK: 2.0}),
        "OUTSIDE_LIMITS",
    ),
    "assemble of a batch": Case(
        "assemble",
        lambda: LINKAGE.assemble({ROCKER: np.array([1.6, 0.0, np.nan])}),
        ["SOLVED", "NOT_FOUND", "BAD_INPUT"],
    ),
    "assemble of none": Case("assemble", lambda: LINKAGE.assemble({CRANK: NONE}), []),
    "assembly_modes": Case(
        "assembly_modes", lambda: LINKAGE.assembly_modes({CRANK: 0.3}), "SOLVED"
    ),
    "assembly_modes failing": Case(
        "assembly_modes", lambda: LINKAGE.assembly_modes({ROCKER: 0.0}), "NONE_EXISTS"
    ),
    "assembly_modes beyond limits": Case(
        "assembly_modes",
        lambda: LINKAGE.with_limits({ROCKER: (3.0, 3.1)}).assembly_modes({CRANK: 0.3}),
        "OUTSIDE_LIMITS",
    ),
    "assembly_modes in space": Case(
        "assembly_modes",
        lambda: SPATIAL.assembly_modes({SPATIAL.coordinate_names[0]: 0.5}, budget=MANY),
        "SOLVED",
    ),
    "closed_form": Case("closed_form", lambda: LINKAGE.loops.closed_form([CRANK]), "SOLVED"),
    "closed_form failing": Case(
        "closed_form", lambda: SPATIAL.loops.closed_form([SPATIAL.coordinate_names[0]]), "NOT_FOUND"
    ),
    "close": Case("close", lambda: LINKAGE.loops.closed_form([CRANK]).close([0.3]), "SOLVED"),
    "close failing": Case(
        "close", lambda: LINKAGE.loops.closed_form([ROCKER]).close([0.0]), "NOT_FOUND"
    ),
    "close of a batch": Case(
        "close",
        lambda: LINKAGE.loops.closed_form([ROCKER]).close([[1.6], [0.0], [np.nan]]),
        ["SOLVED", "NOT_FOUND", "BAD_INPUT"],
    ),
    "close of none": Case(
        "close", lambda: LINKAGE.loops.closed_form([CRANK]).close(np.zeros((0, 1))), []
    ),
    "configuration_space": Case(
        "configuration_space", lambda: LINKAGE.configuration_space, "SOLVED"
    ),
    "configuration_space of a tree": Case(
        "configuration_space", lambda: ARM.configuration_space, "SOLVED"
    ),
    "configuration_space failing": Case(
        "configuration_space", lambda: apart().configuration_space, "UNDETERMINED"
    ),
    "sample": Case("sample", lambda: ARM.configuration_space.sample(3, 0), "SOLVED"),
    "sample of a curve": Case("sample", lambda: LINKAGE.configuration_space.sample(3, 0), "SOLVED"),
    "sample in time": Case(
        "sample", lambda: FIVE.configuration_space.sample(3, 0, budget=AT_ONCE), "OUT_OF_TIME"
    ),
    "sample failing": Case("sample", lambda: apart().configuration_space.sample(3), "NOT_FOUND"),
    "components": Case("components", lambda: LINKAGE.configuration_space.components(), "SOLVED"),
    "components failing": Case(
        "components", lambda: apart().configuration_space.components(), "NONE_EXISTS"
    ),
    "components in space": Case(
        "components", lambda: SPATIAL.configuration_space.components(), "PARTLY"
    ),
    "path": Case("path", lambda: ARM.configuration_space.path(Q, Q + 0.1), "SOLVED"),
    "path along a curve": Case(
        "path",
        lambda: LINKAGE.configuration_space.path(CLOSED, LINKAGE.trace(start=CLOSED).q[5]),
        "SOLVED",
    ),
    "path failing": Case(
        "path",
        lambda: LINKAGE.configuration_space.path(*LINKAGE.assembly_modes({CRANK: 0.3}).q),
        "NONE_EXISTS",
    ),
    "task_space": Case("task_space", lambda: TWO.task_space("e"), "SOLVED"),
    "independent": Case("independent", lambda: LINKAGE.independent(CLOSED), "SOLVED"),
    "idealise": Case("idealise", lambda: rounded().idealise(), "SOLVED"),
    "nearest": Case("nearest", lambda: SHAPES.geometry.nearest([0.0]), "SOLVED"),
    "check_path": Case(
        "check_path",
        lambda: SHAPES.geometry.check_path([[0.0]], kempe.constraints.Clearance()),
        "SOLVED",
    ),
    "mobility": Case("mobility", lambda: LINKAGE.mobility(), "SOLVED"),
    "mobility failing": Case("mobility", lambda: apart().mobility(), "NOT_FOUND"),
    "mobility of a ball": Case("mobility", lambda: BALL.mobility(), "SOLVED"),
    "classify": Case("classify", lambda: CAR.classify(), "SOLVED"),
    "trace": Case("trace", lambda: LINKAGE.trace(start=CLOSED), "SOLVED"),
    "trace in time": Case(
        "trace", lambda: LINKAGE.trace(start=CLOSED, budget=AT_ONCE), "OUT_OF_TIME"
    ),
    "trace broken off": Case(
        "trace",
        lambda: call_until_interrupt(LINKAGE.trace, start=CLOSED, budget=BROKEN),
        "INTERRUPTED",
    ),
    "trace failing": Case("trace", lambda: apart().trace(), "NOT_FOUND"),
    "drive": Case("drive", lambda: LINKAGE.drive(held(4), start=CLOSED), "SOLVED"),
    "drive in time": Case(
        "drive", lambda: LINKAGE.drive(held(4), start=CLOSED, budget=AT_ONCE), "OUT_OF_TIME"
    ),
    "drive broken off": Case(
        "drive",
        lambda: call_until_interrupt(LINKAGE.drive, held(99), start=CLOSED, budget=BROKEN),
        "INTERRUPTED",
    ),
    "drive failing": Case(
        "drive", lambda: LINKAGE.drive({ROCKER: np.linspace(2.0, 0.0, 9)}), "PARTLY"
    ),
    "drive open": Case("drive", lambda: apart().drive({"A": np.zeros(2)}), "NOT_FOUND"),
    "manoeuvre": Case(
        "manoeuvre",
        lambda: CAR.manoeuvre(np.zeros(3), [0.0, 1.0, 0.0], radius=1.0, budget=NINE),
        "SOLVED",
    ),
    "simulate": Case(
        "simulate", lambda: BALL.simulate(0.5, {"flight.z": 1.0}, budget=NINE), "SOLVED"
    ),
    "workspace": Case(
        "workspace", lambda: kempe.load("two_link").workspace("e", n=5000, cells=16), "SOLVED"
    ),
    "loop_jacobian": Case(
        "loop_jacobian", lambda: LINKAGE.loops.jacobian(CLOSED, [CRANK], [ROCKER]), "SOLVED"
    ),
    "loop_jacobian at a dead point": Case(
        "loop_jacobian", lambda: LINKAGE.loops.jacobian(STRETCHED, [ROCKER], [CRANK]), "DEAD_POINT"
    ),
    "loop_jacobian of too few inputs": Case(
        "loop_jacobian",
        lambda: FIVE.loops.jacobian(FIVE.assemble().q, ["A"], ["D"]),
        "UNDETERMINED",
    ),
    "loop_jacobian of a batch": Case(
        "loop_jacobian",
        lambda: LINKAGE.loops.jacobian(CLOSED + np.zeros((2, 1)), [CRANK], [ROCKER]),
        ["SOLVED"] * 2,
    ),
    "relative_motion": Case(
        "relative_motion",
        lambda: LINKAGE.loops.relative_motion(CLOSED, *LINKAGE.body_names[:2]),
        "SOLVED",
    ),
    "loop_jacobian of none": Case(
        "loop_jacobian", lambda: LINKAGE.loops.jacobian(np.zeros((0, 4)), [CRANK], [ROCKER]), []
    ),
}

REPORTING = {
    "check_path",
    "nearest",
    "workspace",
    "mobility",
    "classify",
    "idealise",
    "independent",
    "closed_form",
    "ik_plan",
    "loop_jacobian",
    "relative_motion",
    "configuration_space",
    "components",
    "task_space",
    "singularities",
    "reach.poses",
    "reach.place",
    "reach.capability",
    "reach.planar",
}
REPORTS, ANSWERS = (
    [n for n, c in CASES.items() if (c.verb in REPORTING) == report] for report in (True, False)
)
"""Cases of the verbs that find something out about a system, and of those that give
configurations."""
NAMED = {
    "loop_jacobian": "jacobian",
    "ik_sweep": "sweep",
    "ik_plan": "plan",
    "reach.poses": "poses",
    "reach.place": "place",
    "reach.capability": "capability",
    "reach.planar": "planar",
}
"""Verbs of families, by the names that the families give them."""
OF_RESULTS = {"at", "close", "sample", "components", "path"}
"""Verbs of results."""
NO_RESULTS = {
    "geometry",
    "assembler",
    "constraints",
    "plot",
    "plot_spaces",
    "query",
    "structure",
    "loops",
    "inverse",
    "reach",
    "symbolic",
    "with_limits",
    "with_parameters",
    "open_loops",
}
"""Members of `System` that give a system, a set, poses, a bound form or a drawing."""


def rounded() -> kempe.System:
    """A planar four-bar linkage built in space, one pin of which is off by a hundredth of a
    millimetre.
    """
    m = kempe.Mechanism("<b>rounded")
    a, b, c = (m.body(n) for n in "abc")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(0.1, 0.0, 0.0))
    m.revolute("C", b, c, at=(0.5, 0.0, 1e-5), child_at=(0.4, 0.0, 0.0))
    m.revolute("D", m.ground, c, at=(0.4, 0.0, 0.0))
    return m.build()


def apart() -> kempe.System:
    """Two bars that are too short to meet."""
    m = kempe.Mechanism("<b>apart", dim=2)
    a = m.body("a")
    b = m.body("b")
    m.revolute("A", m.ground, a)
    m.revolute("B", m.ground, b, at=(9.0, 0.0))
    m.revolute("C", a, b, at=(1.0, 0.0), child_at=(1.0, 0.0))
    return m.build()


@cache
def answered(name: str) -> tuple[Any, Any]:
    """The result of a case, and the outcome that is expected."""
    return CASES[name].call(), CASES[name].expected


def test_every_verb_that_returns_a_result_is_in_the_table():
    plain = {
        "Array",
        "Any",
        "System",
        "str",
        "bool",
        "float",
        "int",
        "None",
        "dict",
        "tuple",
        "list",
        "Path",
        "Axes",
        "Callable",
        "Mapping",
        "Sequence",
    }
    verbs = set()
    for owner in (kempe.System, Loops, Inverse, ReachStudies, BodyGeometry):
        for name, member in vars(owner).items():
            function = (
                member.fget if isinstance(member, property) else getattr(member, "func", member)
            )
            if (
                name[0] != "_"
                and callable(function)
                and set(re.findall(r"\w+", str(returned(function)))) - plain
            ):
                verbs.add(name)
    assert {"ik", "mobility", "trace", "idealise"} <= verbs
    own = {NAMED.get(c.verb, c.verb) for c in CASES.values()}
    assert verbs - NO_RESULTS == own - OF_RESULTS, (
        "a verb of System is missing in the table, or is no verb"
    )


def returned(function: Any) -> Any:
    return getattr(inspect.unwrap(function), "__annotations__", {}).get("return", "None")


@pytest.mark.parametrize("name", CASES)
def test_a_result_is_an_answer_or_a_report_and_has_the_outcome_expected(name):
    result, expected = answered(name)
    assert isinstance(result, Result) and isinstance(result, Answer) != isinstance(result, Report)
    codes = (
        [Status(c).name for c in result.code] if isinstance(expected, list) else result.code.name
    )
    assert codes == expected, result.status
    assert isinstance(result.code, Status if isinstance(expected, str) else np.ndarray)


@pytest.mark.parametrize("name", CASES)
def test_truth_sentences_and_shapes_agree_with_the_outcome(name):
    result, expected = answered(name)
    good = np.asarray(result.code) == Status.SOLVED
    assert bool(result) is bool(np.all(good))
    if isinstance(expected, list):
        assert (
            result.status.shape == result.code.shape == np.shape(result.success) == (len(expected),)
        )
        assert np.array_equal(result.success, good) and all(
            isinstance(s, str) and s for s in result.status
        )
    else:
        assert isinstance(result.status, str) and result.status and not result.status.endswith(".")
        assert np.all(result.success) == bool(good) or "jump" in result.status


@pytest.mark.parametrize("name", CASES)
def test_text_says_the_sentence_and_html_is_escaped(name):
    result, expected = answered(name)
    if isinstance(expected, str):
        assert result.status in str(result)
    else:
        assert str(len(expected)) in str(result)
    page = result._repr_html_()
    assert "<b>" not in page and page.startswith("<p>") and page.count("<p>") == page.count("</p>")
    tags = set(re.findall(r"</?(\w+)", page))
    assert tags <= {"p", "table", "tr", "td", "th", "br", "img"}, tags
    assert words(str(result)) <= words(html.unescape(re.sub(r"<[^>]+>", " ", page)))


def words(text: str) -> set[str]:
    return set(re.findall(r"[\w.+-]*\w", text))


@pytest.mark.parametrize("name", CASES)
def test_json_holds_what_python_says(name):
    result, expected = answered(name)
    data = json.loads(result.to_json())
    assert data == json.loads(json.dumps(result.data(), allow_nan=False))
    assert data["code"] == expected and data["status"] == np.asarray(result.status).tolist()
    assert np.array_equal(data["success"], np.asarray(result.code) == Status.SOLVED)


@pytest.mark.parametrize("name", CASES)
def test_columns_and_frames_show_what_print_does(name):
    """The text in columns begins as `print` does, in either unit; a data frame can be made of it."""
    result, _ = answered(name)
    for degrees in (True, False):
        lines = result.text(degrees).splitlines()
        assert lines[0] == convert_sentence_angles(str(result).splitlines()[0], degrees)
        assert not any(line != line.rstrip() for line in lines)
    narrow = result.text(width=60).splitlines()
    assert narrow[0] in lines[0] and " ".join(narrow).split()[:5] == lines[0].split()[:5]
    pandas = pytest.importorskip("pandas")
    frame = result.to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    if isinstance(result, Answer):
        names, columns = result.table()
        assert list(frame.columns) == names
        np.testing.assert_array_equal(frame.to_numpy(dtype=float), columns)


@pytest.mark.parametrize("name", CASES)
def test_an_interactive_session_shows_one_screen_of_what_print_does(name):
    result, _ = answered(name)
    assert type(result).__repr__ is Result.__repr__
    shown, printed = repr(result).splitlines(), str(result).splitlines()
    assert sum(max(1, -(-len(line) // 100)) for line in shown) <= 25
    assert shown == printed or shown[:-1] == printed[: len(shown) - 1]


def test_a_long_answer_says_that_there_is_more():
    chain = kempe.Mechanism("chain")
    for k in range(40):
        chain.revolute(f"j{k}", chain.ground if k == 0 else f"b{k - 1}", chain.body(f"b{k}"))
    chain.frame("tip", "b39")
    answer = chain.build().ik([0, 0, 0], "tip")
    *shown, last = repr(answer).splitlines()
    assert len(shown) == 24 and "print(answer) shows all of it" in last
    assert str(answer).startswith("\n".join(shown)) and "j39" in str(answer)


def test_a_data_frame_without_pandas_names_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        LINKAGE.mobility().to_dataframe()


@pytest.mark.parametrize("name", CASES)
def test_pickles_say_the_same(name):
    result, _ = answered(name)
    again = pickle.loads(pickle.dumps(result))
    assert (
        type(again) is type(result) and str(again) == str(result) and again.data() == result.data()
    )
    assert again._repr_html_() == result._repr_html_() and bool(again) is bool(result)


@pytest.mark.parametrize("name", REPORTS)
def test_the_sentence_of_a_report_is_its_status(name):
    report, _ = answered(name)
    assert isinstance(report, Report) and np.array_equal(report.sentence, report.status)


@pytest.mark.parametrize("name", ANSWERS)
def test_configurations_of_answers(name):
    answer, expected = answered(name)
    system = answer.system
    lead = answer.q.shape[:-1]
    assert answer.q.shape[-1] == system.nq and np.shape(answer.residual) == lead == np.shape(
        answer.judged.holds
    )
    assert "contradicted" not in answer.verdict
    claimed = np.broadcast_to(answer._select_claimed_rows(), lead)
    assert (
        np.all(np.asarray(answer.residual)[claimed] < 1e-5) and np.isfinite(answer.q[claimed]).all()
    )
    names, columns = answer.table()
    assert (
        columns.ndim == 2
        and columns.shape[1] == len(names)
        and set(system.coordinate_names) <= set(names)
    )
    places = np.ndindex(len(expected)) if isinstance(expected, list) else [()]
    said = [answer.sentence(place) for place in places]
    assert said == (list(answer.status) if isinstance(expected, list) else [answer.status])
    with pytest.raises(InputError, match="index"):
        answer.sentence((9, 9, 9))


@pytest.mark.parametrize("name", ANSWERS)
def test_data_of_an_answer_hold_its_configurations(name):
    answer, _ = answered(name)
    system = answer.system
    data = json.loads(answer.to_json())
    assert data["system"] == system.name

    def rows(x: Any) -> list[Any]:
        return [r for y in x for r in rows(y)] if isinstance(x, list) else [x]

    for row, q in zip(rows(data["q"]), answer.q.reshape(-1, system.nq), strict=True):
        if row is None:
            assert np.isnan(q).all()
        else:
            assert list(row.values()) == q.tolist() and list(row) == list(system.coordinate_names)


@pytest.mark.parametrize("name", [n for n, c in CASES.items() if "BAD_INPUT" in c.expected])
def test_rows_that_are_no_numbers_are_nan_and_leave_the_others_alone(name):
    answer = CASES[name].call()
    bad = np.asarray(answer.code) == Status.BAD_INPUT
    assert np.isnan(answer.q[bad]).all() and np.isfinite(answer.q[0][..., :]).all(axis=-1).any()
    assert all(re.search("not finite|no pose|not a pose|NaN", s) for s in answer.status[bad])
    single = CASES[name.replace(" of a batch", "")].call()
    assert single.code == answer.code[0]


@pytest.mark.parametrize(
    "call",
    [
        lambda: ARM.ik(WRONG, TOOL),
        lambda: ARM.ik([POSITION(TOOL, WRONG[:3, 3])]),
        lambda: ARM.ik_path(WRONG[None], TOOL),
        lambda: LINKAGE.assemble({CRANK: np.nan}),
        lambda: LINKAGE.assembly_modes({CRANK: np.nan}),
        lambda: LINKAGE.drive({CRANK: [0.3, np.nan]}),
        lambda: ARM.ik_step(np.full(6, np.nan), AHEAD, TOOL, 0.01),
        lambda: SEVEN.inverse.sweep(WRONG, TIP),
        lambda: ARM.inverse.self_motion(np.full(6, np.nan), TOOL, task="position"),
        lambda: LINKAGE.loops.jacobian(np.full(4, np.nan), [CRANK], [ROCKER]),
    ],
)
def test_a_single_question_that_is_no_number_is_refused(call):
    with pytest.raises(KempeError):
        call()


def test_degrees_change_the_angles_of_data_only():
    answer = LINKAGE.assemble({CRANK: 0.3})
    rad = answer.data()
    deg = answer.data(degrees=True)
    assert (rad["angle_unit"], deg["angle_unit"]) == ("rad", "deg")
    assert deg["q"] == pytest.approx({n: np.degrees(x) for n, x in rad["q"].items()})
    assert {k: v for k, v in deg.items() if k not in ("q", "angle_unit")} == {
        k: v for k, v in rad.items() if k not in ("q", "angle_unit")
    }


def test_the_judge_finds_answers_that_are_altered():
    """Of each sort of answer one is moved away from its target: the judge, and with it the verdict,
    says so.
    """
    modes = LINKAGE.assembly_modes({CRANK: 0.3})
    path = ARM.ik_path(REACHED, TOOL, Q)
    drive = LINKAGE.drive(held(4), start=CLOSED)
    every = ARM.ik_all(X, TOOL)
    for answer in (modes, path, drive, every):
        assert answer.judged and answer.judged.names
        answer = pickle.loads(pickle.dumps(answer))
        answer.q[-1, 0] += 1e-3
        answer.__dict__.pop("judged", None)
        assert not answer.judged and "contradicted" in answer.verdict
    other = LINKAGE.assembly_modes({CRANK: 0.4})
    object.__setattr__(other, "known", {CRANK: 0.3})  # closed, but not where it was requested
    assert "contradicted" in other.verdict and repr(CRANK) in other.verdict


def test_proofs_are_data_and_their_words_are_in_the_sentence():
    """What is proven of a failure can be had as numbers; where nothing is proven there are none."""
    far = ARM.ik(BATCH, TOOL)
    (lengths,) = far.proofs(1)
    assert (
        lengths.proof
        and lengths.kind == "lengths"
        and lengths.place > 5.0
        and lengths.text in far.status[1]
    )
    assert far.proofs(0) == far.proofs(2) == () and far.proven.tolist() == [False, True, False]
    elbow = TWO.with_limits({"<b>q2": (-0.1, 0.1)}).ik(
        TWO.fk([0.3, 1.2], "e"), "e", task="position"
    )
    (limits,) = elbow.proofs()
    assert (
        limits.proof
        and limits.kind == "outside"
        and limits.count == 2
        and limits.text in elbow.status
        and elbow.proven
    )
    two = CASES["tasks that exclude each other"].call()
    (apart,) = two.proofs()
    assert (apart.first, apart.second) == tuple(two.errors) and apart.text in two.status
    assert apart.off == pytest.approx(
        np.linalg.norm(REACHED[1, :3, 3] - REACHED[2, :3, 3]), abs=1e-5
    )
    assert all(not p.place for p in TWO.ik([POSITION("e", (0.3, 0.3))]).proofs())


def test_lengths_are_the_distance_beyond_the_longest_reach(hunt):
    """For an arm of two links: the distance of the target less the sum of the lengths, and no proof
    within.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(200)):
        p = rng.uniform(-2.0, 2.0, 2)
        answer = TWO.ik(p, "e", task="position", budget=kempe.Budget(starts=4))
        past = max(float(np.linalg.norm(p)) - 0.9, 0.1 - float(np.linalg.norm(p)), 0.0)
        found = answer.proofs()
        assert bool(found) == (past > 1e-6) == (answer.code == Status.OUT_OF_REACH)
        assert not found or found[0].place == pytest.approx(past, abs=1e-12)


@pytest.mark.parametrize("name", some(ANSWERS, 3))
def test_an_answer_draws_itself(name):
    """Its configurations, or its motion; where there is none to draw, the error says so."""
    pytest.importorskip("matplotlib")
    answer, _ = answered(name)
    finite = np.isfinite(answer.q).all(axis=-1)
    if finite.any() and (answer.is_motion or finite.sum() <= 32):
        assert answer.plot(labels=False).get_children()
    else:
        with pytest.raises(InputError, match="nothing to draw|not all of it NaN|at most 32"):
            answer.plot()
