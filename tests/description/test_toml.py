"""TOML: the lossless round trip, what the format says, and where it is wrong."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from random_mechanisms import mechanisms

from kempe.description.mechanism import Mechanism
from kempe.description.shapes import Sphere
from kempe.description.source import Source
from kempe.description.toml_document import KEYS, Places
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.errors import DescriptionError
from kempe.joints import Revolute
from kempe.poses import COUNTS
from kempe.values import Expression

FOUR_BAR = """\
format = 1
name = "four-bar"      # a comment
dim = 2

[parameters]
crank = 1.0

[[body]]
name = "crank"
[[body]]
name = "coupler"
[[body]]
name = "rocker"

[[joint]]
name = "A"
type = "revolute"
parent = "ground"
child = "crank"
limits = [-3.0, inf]
actuated = true

[[joint]]
name = "B"
type = "revolute"
parent = "crank"
child = "coupler"
at = ["crank", 0]

[[joint]]
name = "C"
type = "revolute"
parent = "coupler"
child = "rocker"
at = [4, 0]
child_at = [2.5, 0]

[[joint]]
name = "D"
type = "revolute"
parent = "ground"
child = "rocker"
at = [3, 0]
cut = true

[[frame]]
name = "pen"
body = "coupler"
at = [2, 1]
angle = "pi/2"

[postures]
start = {A = 0.5}
"""


@given(mechanisms())
def test_round_trip(mechanism: Mechanism):
    text = write_toml(mechanism)
    again = read_toml(text)
    assert again == mechanism
    assert again.notes == mechanism.notes
    assert write_toml(again) == text


@given(mechanisms())
def test_round_trip_through_bytes_and_other_line_ends(mechanism: Mechanism):
    text = write_toml(mechanism)
    assert read_toml(text.encode("utf-8-sig").replace(b"\n", b"\r\n")) == mechanism


def test_what_the_format_says():
    m = read_toml(FOUR_BAR)
    built = Mechanism("four-bar", dim=2)
    l1 = built.parameter("crank", 1.0)
    crank, coupler, rocker = (built.body(n) for n in ("crank", "coupler", "rocker"))
    built.revolute("A", built.ground, crank, limits=(-3.0, math.inf), actuated=True)
    built.revolute("B", crank, coupler, at=(l1, 0))
    built.revolute("C", coupler, rocker, at=(4, 0), child_at=(2.5, 0))
    built.revolute("D", built.ground, rocker, at=(3, 0), cut=True)
    built.frame("pen", coupler, at=(2, 1), angle="pi/2")
    built.posture("start", {"A": 0.5})
    assert m == built
    assert m.joints["B"].where is not None and m.joints["B"].where.line == 23


def test_written_text_is_plain():
    text = write_toml(read_toml(FOUR_BAR))
    assert (
        'at = ["crank", 0.0]' in text
        and 'angle = "pi/2"' in text
        and "limits = [-3.0, inf]" in text
    )
    assert "steps" not in text and "child_at = [2.5, 0.0]" in text


def test_the_axis_of_the_parent_holds_for_the_child():
    head = (
        'format = 1\n[[body]]\nname = "a"\n[[joint]]\nname = "j"\ntype = "revolute"\nparent = '
        '"ground"\nchild = "a"\n'
    )
    same = read_toml(head + "axis = [0, 1, 0]\n").joints["j"]
    assert same.X_PF == same.X_CM
    other = read_toml(head + "axis = [0, 1, 0]\nchild_axis = [0, 0, 1]\n").joints["j"]
    assert other.X_CM.steps == () and other.X_PF == same.X_PF
    steps = read_toml(head + 'axis = [0, 1, 0]\nchild_steps = [["x", 1]]\n').joints["j"]
    assert steps.X_CM.steps == (("x", (1.0,)),)


def test_frames_name_places():
    text = FOUR_BAR.replace("at = [3, 0]\ncut = true", 'at = [3, 0]\nchild_at = "end"') + (
        '[[frame]]\nname = "end"\nbody = "rocker"\nat = [0.25, 0]\n'
    )
    assert read_toml(text).joints["D"].X_CM.steps == (("x", (0.25,)),)
    with pytest.raises(DescriptionError, match="no frame 'pen'"):
        read_toml(text.replace('child_at = "end"', 'child_at = "pen"'))


def test_names_with_dots_need_no_quotes():
    text = (
        'format = 1\n[[body]]\nname = "a"\n[[joint]]\nname = "p"\ntype = "planar"\nparent = '
        '"ground"\nchild = "a"\n'
    )
    m = read_toml(text + '[postures]\nhome = {p.x = 1, "p.rz" = 2}\n[locks]\np.y = 3\n')
    assert m.postures == {"home": {"p.x": 1.0, "p.rz": 2.0}} and m.locks == {"p.y": 3.0}
    with pytest.raises(DescriptionError, match="names 'p.x' twice"):
        read_toml(text + '[postures]\nhome = {p.x = 1, "p.x" = 2}\n')


def test_ground_can_have_mass():
    m = read_toml(
        'format = 1\nground = "base"\n[[body]]\nname = "base"\nmass = 2\n[[shape]]\nbody = "base"\n'
        'type = "sphere"\nradius = 1\n'
    )
    assert m.ground.mass == 2.0 and m.ground.shapes[0].geometry == Sphere(1.0)
    assert read_toml(write_toml(m)) == m


def test_dh_table():
    text = """
format = 1
name = "scara"
[parameters]
l = 0.4
[dh]
convention = "modified"
base = {at = [0, 0, 0.1]}
tool = {at = [0, 0, -0.2], rpy = [0, 0, 0.5]}
rows = [
  {a = 0.3, name = "shoulder", limits = [-2, 2]},
  {a = "l", type = "prismatic", d = 0.05},
]
[[body]]
name = "gripper"
[[joint]]
name = "mount"
type = "fixed"
parent = "link2"
child = "gripper"
"""
    m = read_toml(text)
    assert list(m.joints) == ["shoulder", "q2", "mount"] and "tool" in m.frames
    assert m.joints["q2"].where is not None and m.joints["q2"].where.line == 12
    assert m.joints["q2"].X_PF.steps == (("x", (Expression("l"),)), ("z", (0.05,)))
    with pytest.raises(
        DescriptionError, match=r":12: dh: row 2 has an unknown entry 'tipe'; did you mean 'type'"
    ):
        read_toml(text.replace('type = "prismatic"', 'tipe = "prismatic"'))


def test_screws():
    text = """
format = 1
[screws]
home = {at = [1, 0, 0]}
[[screws.rows]]
axis = [0, 0, 1]
[[screws.rows]]
twist = [0, -0.5, 0, 0, 0, 2]
"""
    with pytest.raises(
        DescriptionError, match=r":7: screws: screw 2: its rotation part w has length 2"
    ):
        read_toml(text)
    m = read_toml(text.replace("0, 2]", "0, 1]"))
    assert m.joints["q2"].X_PF.steps == (("x", (0.5,)),)


def test_every_place_is_found():
    text = (
        "format = 1\nnotes = [\"a # b\", '''\n[[x]]\n''',\n  \"c\"]\n[a.b]\nx.y = {z = 1} # [q]\n"
        '[[c]]\n"d e" = [\n [1, 2],\n [3], # ]\n]\n[c.f]\ng = """\n] = \\"\n"""\n[[c]]\nh = 1979-05-27T07:32:00Z\n'
    )
    where = Places(Source("t", text)).locate_value
    expected = {
        ("format",): (1, 10),
        ("notes",): (2, 9),
        ("notes", 0): (2, 10),
        ("notes", 1): (2, 19),
        ("notes", 2): (5, 3),
        ("a",): (6, 1),
        ("a", "b"): (6, 1),
        ("a", "b", "x", "y"): (7, 7),
        ("c", 0): (8, 1),
        ("c", 0, "d e"): (9, 9),
        ("c", 0, "d e", 1): (11, 2),
        ("c", 0, "f", "g"): (14, 5),
        ("c", 1, "h"): (18, 5),
        ("c", 1, "nothing"): (17, 1),
    }
    assert {path: (where(*path).line, where(*path).column) for path in expected} == expected


def test_joint_types_from_outside_are_refused():
    class Mine(Revolute):
        pass

    m = Mechanism()
    m.joint("j", Mine(), m.ground, m.body("a"))
    with pytest.raises(DescriptionError, match="not in the table of joints"):
        write_toml(m)


@pytest.mark.parametrize(
    "name", ["\n", "a\nb", "'''", '"', "\\", "a'\n'", "\r\n\r", "\x00\x7f", "#", "=", "é", " x "]
)
def test_any_text_survives(name: str):
    m = Mechanism("a" + name)
    m.posture("p" + name, {})
    m.body("b" + name)
    for text in (name, "x\n" + name, name + "\n"):
        m.shape("b" + name, "sphere", radius=1, name=text)
    assert read_toml(write_toml(m)) == m
    assert read_toml(write_toml(m).replace("\n", "\r\n").encode()) == m


def test_floats_survive_to_the_last_bit():
    m = Mechanism()
    numbers = [0.1 + 0.2, 5e-324, 1.7976931348623157e308, -0.0, 1 / 3, 1e22]
    for i, x in enumerate(numbers):
        m.posture(str(i), {"j": x})
    m.revolute("j", m.ground, m.body("a"))
    again = read_toml(write_toml(m))
    assert [np.float64(p["j"]).tobytes() for p in again.postures.values()] == [
        np.float64(x).tobytes() for x in numbers
    ]


PAGE = Path(__file__).parents[2] / "docs" / "toml.md"


@pytest.mark.parametrize(
    "text", re.findall(r"^```toml\n(.*?)^```$", PAGE.read_text(), re.DOTALL | re.MULTILINE)
)
def test_examples_of_the_page(text: str):
    m = read_toml(text)
    assert read_toml(write_toml(m)) == m and m.build().nq >= 3


def test_the_page_names_every_key():
    page = PAGE.read_text()
    keys = {key.removeprefix("child_") for known in KEYS.values() for key in known} | set(COUNTS)
    assert {
        key
        for key in keys
        if f"`{key}`" not in page and f"[[{key}]]" not in page and f"[{key}]" not in page
    } <= {
        "of",
        "sources",
        "offset",
        "rows",
        "convention",
    }
    assert all(f"{key} = " in page for key in ("of", "sources", "rows", "convention"))


@pytest.mark.parametrize(
    "text",
    [
        "[a{}]",
        "a{} = 1",
        "[[a{}]]",
        "'a'{} = 1",
        '[ "a" {} ]',
        "x = {{a{} = 1}}",
        "x = {{b = 2, a{} = 1}}",
        'x = [{{"a"{} = 1}}]',
        "x = {{y = 'z', 'a'{} = 1}}",
        "x = {{a{}",
    ],
)
def test_long_dotted_keys_are_refused_before_they_take_long(text, monkeypatch):
    """The time of `tomllib` grows as the square of their names: it does not get them."""
    from kempe.description import toml_document

    monkeypatch.setattr(
        toml_document.tomllib, "loads", lambda text: pytest.fail("given to tomllib")
    )
    for names in (65, 100_000):
        with pytest.raises(
            DescriptionError, match="<text>:2: .*a dotted key of more than 64 names"
        ):
            read_toml("# a comment\n" + text.format(". b" * names) + "\n")


@pytest.mark.parametrize(
    "text",
    [
        'name = "{{{}"',
        "name = '{{{}'",
        'name = """\n{{{}\n"""\nb = 1',
        "name = '''\n, {}\n'''",
        "b = 1 # {{{}",
        'a = ["\\", {}"]',
        "a = [1, # , {}\n 2]",
    ],
)
def test_strings_and_comments_may_look_like_long_keys(text):
    from kempe.description import toml_document

    whole = text.format(".".join("a" * 100)) + "\n"
    assert toml_document.parse_toml(whole)[0] == toml_document.tomllib.loads(whole)


def test_places_of_deep_keys_are_those_of_what_encloses_them():
    from kempe.description.toml_document import DEEPEST

    deep = tuple("abcdefghijklmnopqrstuvwxyz")
    places = Places(Source("x", f"x = 1\n[{'.'.join(deep)}]\ny = 2\n"))
    assert (
        places.locate_value(*deep[:3]).line == places.locate_value(*deep, "y").line == 2
        and len(deep) > DEEPEST
    )
