"""Descriptions of many bodies: the work grows as their number, and TOML read line by line is what
`tomllib` reads.
"""

from __future__ import annotations

import datetime
import gc
import math
import sys
import tomllib
import weakref

import numpy as np
import pytest
from hunts import part, some

import kempe
from kempe import Mechanism
from kempe.description import toml_document
from kempe.description.read import read_mechanism
from kempe.description.source import Source, pause_garbage_collection
from kempe.description.toml_document import Places
from kempe.description.toml_writer import write_toml
from kempe.errors import DescriptionError
from kempe.library import find_model_file as model_path
from kempe.library import list_models as models

SHAPES = ("chain", "star", "tree", "fixed", "unlimited")


def urdf(n: int, shape: str) -> str:
    """A robot of n joints."""
    rng = np.random.default_rng(0)
    out = ['<robot name="large">', '<link name="l0"/>']
    for i in range(1, n + 1):
        parent = {"star": 0, "tree": int(rng.integers(0, i))}.get(shape, i - 1)
        kind = {"fixed": "fixed" if i % 2 else "revolute", "unlimited": "continuous"}.get(
            shape, "revolute"
        )
        limit = (
            '<limit lower="-1" upper="1" effort="1" velocity="2"/>' if kind == "revolute" else ""
        )
        axis = '<axis xyz="0 1 0"/>' if kind != "fixed" else ""
        x, y, z = rng.random(3)
        out.append(
            f'<link name="l{i}"><inertial><mass value="{x}"/></inertial></link><joint name="j{i}" type="{kind}">'
            f'<parent link="l{parent}"/><child link="l{i}"/><origin xyz="{x} {y} {z}" rpy="0.1 0 {y}"/>{axis}{limit}'
            "</joint>"
        )
    return "\n".join([*out, "</robot>"])


def built(n: int, shape: str) -> Mechanism:
    """The same by calls."""
    m = Mechanism("large")
    rng = np.random.default_rng(0)
    for i in range(1, n + 1):
        parent = {"star": 0, "tree": int(rng.integers(0, i))}.get(shape, i - 1)
        add = m.fixed if shape == "fixed" and i % 2 else m.revolute
        add(
            f"j{i}",
            f"l{parent}" if parent else m.ground,
            m.body(f"l{i}"),
            at=tuple(rng.random(3)),
            **({} if add == m.fixed else {"limits": (-1.0, 1.0)}),
        )
    return m


def calls(function, *given) -> int:
    """How many functions Kempe calls, those written in C among them; not what these call: some keep
    what they found.
    """
    count = 0

    def counted(frame, event, _argument):
        nonlocal count
        caller = frame.f_back if event == "call" else frame
        count += event in ("call", "c_call") and caller.f_globals.get("__name__", "").startswith(
            "kempe"
        )

    sys.setprofile(counted)
    try:
        function(*given)
    finally:
        sys.setprofile(None)
    return count


WAYS = {
    "URDF": lambda n, shape: (read_mechanism, urdf(n, shape)),
    "TOML": lambda n, shape: (read_mechanism, write_toml(read_mechanism(urdf(n, shape)))),
    "calls": lambda n, shape: (built, n, shape),
    "build": lambda n, shape: (built(n, shape).build,),
    "fk": lambda n, shape: (lambda s: s.fk(s.neutral), built(n, shape).build()),
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", some(SHAPES, 6))
@pytest.mark.parametrize("way", WAYS)
def test_work_grows_as_the_number_of_bodies(way, shape):
    """Twice the bodies, twice the calls: counted, not timed. Calls in C that take longer show as
    none, see below.
    """
    few, many = (calls(*WAYS[way](n, shape)) for n in (300, 600))
    assert many < 2.1 * few + 100, (few, many)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["URDF", "TOML"])
def test_a_body_takes_few_calls(way):
    """What a further body costs, far less than where each number goes the long way."""
    few, many = (calls(*WAYS[way](n, "chain")) for n in (300, 600))
    assert (many - few) / 300 < {"URDF": 500, "TOML": 650}[way]


@pytest.mark.slow
@pytest.mark.parametrize("shape", part(SHAPES))
def test_twenty_thousand_bodies(shape):
    is_where_its_joints_put_it(20_000, shape)


@pytest.mark.slow
@pytest.mark.parametrize("shape", some(SHAPES, 3))
def test_two_thousand_bodies(shape):
    is_where_its_joints_put_it(2000, shape)


def is_where_its_joints_put_it(n: int, shape: str) -> None:
    """Assert that the last body of a robot of n joints is where these put it."""
    system = kempe.load(urdf(n, shape))
    assert len(system.body_names) == n + 1 and gc.isenabled()
    at = system.fk(system.neutral, f"l{n}")
    expected = np.eye(4)
    mechanism = system.mechanism
    body = f"l{n}"
    joints = {j.child: j for j in mechanism.joints.values()}
    while body in joints:  # the other way round, by multiplication of what the description says
        joint = joints[body]
        expected = (
            joint.X_PF.evaluate_pose({}) @ np.linalg.inv(joint.X_CM.evaluate_pose({})) @ expected
        )
        body = joint.parent
    np.testing.assert_allclose(at, expected, atol=1e-9 * n)


def test_garbage_is_collected_again_after_errors():
    with pytest.raises(DescriptionError), pause_garbage_collection(10**6):
        assert not gc.isenabled()
        read_mechanism("<robot name='x'>")
    assert gc.isenabled()
    gc.disable()
    try:
        with pause_garbage_collection(10**6):
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


class Circle:
    """An object that holds itself, which only the garbage collector frees."""

    def __init__(self) -> None:
        self.own = self


@pytest.mark.slow
@pytest.mark.parametrize("write", [lambda: urdf(3, "chain"), lambda: write_toml(built(3, "chain"))])
def test_loads_leave_the_garbage_collector_to_its_work(write):
    """Cycles that are dropped between loads are collected while the loads go on."""
    text = write()
    dropped = []
    own = gc.get_threshold()
    gc.set_threshold(700, 10, 10)  # as users have it, not as tests do
    try:
        for _ in range(300):
            system = kempe.load(text)
            system.fk(system.neutral, "l3")
            dropped += [weakref.ref(system), weakref.ref(Circle())]
    finally:
        gc.set_threshold(*own)
    assert sum(x() is not None for x in dropped) < len(dropped) / 4


@pytest.mark.slow
@pytest.mark.parametrize("write", [lambda: urdf(20, "tree"), lambda: write_toml(built(20, "tree"))])
def test_a_dropped_system_and_its_reading_need_no_garbage_collector(write):
    text = write()
    kempe.load(text)
    gc.collect()
    gc.disable()
    try:
        system = weakref.ref(kempe.load(text))
        assert system() is None and gc.collect() == 0
    finally:
        gc.enable()


# ---- TOML line by line

WORDS = ("a", "b", "joint", "body", "x-1", "2", "true")
VALUES = (
    '"text"',
    '"#, [x] = \\"no\\""',
    "'literal'",
    '"""\nmany\n[[joint]]\n"""',
    "1",
    "-7",
    "+0",
    "1_000",
    "0x1f",
    "1.5",
    "-0.0",
    "5e-3",
    "+1.25E+10",
    "1e5",
    "inf",
    "-nan",
    "true",
    "false",
    "1979-05-27",
    "[]",
    "[1, 2.5]",
    "[1,2,]",
    "[ -0.5 ,\t3e2 ]",
    '["a", "b"]',
    "[[1, 2], [3]]",
    "[\n1,\n2,\n]",
    "[\n[1],\n[2]\n]",
    "{x = 1, y = 'z'}",
    "[true]",
    "",
    "1 2",
    "[1 2]",
    "[,]",
    "01",
    "1.",
    ".5",
    "--1",
    '"\\u00e9"',
    '"é"',
    '"tab\\t"',
    "[1, # c\n 2]",
    "'[x]'",
)


def random_text(rng: np.random.Generator) -> str:
    """Tables and keys of all kinds, most of them plain, some of them wrong."""
    lines = []
    for _ in range(int(rng.integers(3, 40))):
        what = rng.random()
        word = rng.choice(WORDS)
        blank = rng.choice(["", "", "", " ", "\t"])
        comment = rng.choice(["", "", "", " # said", "#[[x]]"])
        if what < 0.35:
            head = rng.choice(
                ["[[{}]]", "[[{}]]", "[{}]", "[{}.c]", "[[{}.c]]", "[[ {} ]]", '["{}"]', "[[{}]"]
            )
            head = head.format(word)
            lines.append(f"{blank}{head}{comment}")
        elif what < 0.95:
            value = rng.choice(VALUES[:1] if rng.random() < 0.5 else VALUES)
            key = rng.choice(
                [f"k{rng.integers(20)}", f"k{rng.integers(20)}", f"k.{word}", f'"{word}"']
            )
            equals = rng.choice([" = ", "=", " =\t"])
            lines.append(f"{blank}{key}{equals}{value}{comment}")
        else:
            lines.append(rng.choice(["", "  ", "# only said", "nothing", "\x01"]))
    return rng.choice(["\n", "\n", "\n", "\r\n"]).join(lines)


def alike(a: object, b: object) -> bool:
    """Whether two values are the same, of the same types, NaN equal to itself."""
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return list(a) == list(b) and all(alike(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(alike, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return (math.isnan(a) and math.isnan(b)) or (
            a == b and math.copysign(1, a) == math.copysign(1, b)
        )
    return a == b


@pytest.mark.slow
def test_lines_are_read_as_tomllib_reads_them(hunt, monkeypatch):
    """Data, errors, and the places of tables."""
    monkeypatch.setattr(toml_document, "MANY", 0)
    rng = hunt.rng()
    fast = 0
    good = 0
    for _ in range(hunt.cases(600, least=400)):
        text = random_text(rng)
        try:
            expected: object = tomllib.loads(text)
        except ValueError as error:
            expected = str(error)
        try:
            found, places = toml_document.parse_toml(text)
        except ValueError as error:
            assert str(error) == expected, text
            continue
        assert alike(found, expected), text
        good += 1
        if places is not None:
            fast += 1
            scanned = Places(Source("text", text))
            for path, offset in places.items():
                assert scanned.locate_value(*path) == Source("text", text).locate_offset(offset), (
                    text,
                    path,
                )
    assert fast > 0.1 * good > 0


@pytest.mark.parametrize("name", sorted(models()))
def test_models_of_the_library_are_read_line_by_line(name, monkeypatch):
    text = model_path(name).read_text(encoding="utf-8")
    monkeypatch.setattr(toml_document, "MANY", 0)
    found, _ = toml_document.parse_toml(text)
    assert alike(found, tomllib.loads(text))


def test_dates_are_still_refused_with_their_line():
    text = (
        write_toml(read_mechanism(urdf(60, "chain")))
        + "\n[[frame]]\nname = 'f'\nbody = 'l1'\nat = 1979-05-27\n"
    )
    line = text.split("\n").index("at = 1979-05-27") + 1
    assert isinstance(tomllib.loads(text)["frame"][0]["at"], datetime.date)
    with pytest.raises(DescriptionError, match=rf"<text>:{line}: .*is a date"):
        read_mechanism(text)
