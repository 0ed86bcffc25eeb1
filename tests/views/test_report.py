"""Reports and facts from Python: what they say, and that they print anywhere."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest

from kempe import Mechanism
from kempe.cli import as_json, report
from kempe.errors import DescriptionError, Fault, UnknownNameError, Where
from kempe.words import json_text, jsonable


class Terminal(io.StringIO):
    """A terminal that remembers what it was sent."""

    def isatty(self) -> bool:
        return True


def text(renderable, file=None) -> str:
    file = file or io.StringIO()
    report.show(renderable, file)
    return file.getvalue()


def zoo() -> Mechanism:
    """One of each kind of coordinate, with a follower, a held coordinate and a relation of several."""
    m = Mechanism("zoo")
    a, b, c, d, e = (m.body(x) for x in "abcde")
    p = m.particle("p")
    m.cylindrical("sleeve", m.ground, a, limits={"z": (-0.1, 0.2)})
    m.spherical("ball", a, b)
    m.helical("screw", b, c, pitch=0.01, limits=(-3, 3))
    m.translation("flight", m.ground, p)
    m.revolute("gear", c, d)
    m.couple("gear", {"screw": -2.0}, 0.1)
    m.fixed("backwards", e, d)
    m.parameter("l", 0.5)
    m.frame("tool", e, at=("l", 0, 0))
    m.posture("home", {"screw": 0.5})
    m.lock({"sleeve.rz": 0.25})
    return m


def test_units_of_every_coordinate():
    unit = as_json.units(zoo().build())
    assert {n for n, u in unit.items() if u == "m"} == {
        "sleeve.z",
        "flight.x",
        "flight.y",
        "flight.z",
    }
    assert {n for n, u in unit.items() if u == ""} == {"ball.qw", "ball.qx", "ball.qy", "ball.qz"}
    assert unit["screw"] == unit["sleeve.rz"] == unit["gear"] == unit["ball.wx"] == "rad"


def test_degrees_touch_angles_only():
    system = zoo().build()
    shown = as_json.in_degrees(
        np.ones(system.nq), system.coordinate_names, as_json.units(system), True
    )
    by_name = dict(zip(system.coordinate_names, shown, strict=True))
    assert (
        by_name["screw"] == pytest.approx(180.0 / np.pi)
        and by_name["sleeve.z"] == by_name["ball.qx"] == 1.0
    )


def test_info_says_everything():
    shown = text(report.info(zoo().build()))
    parts = [
        "zoo: 6 bodies, 6 joints, in space",
        "C = {0, 1, 2, 3, 4, 0}",
        "p (particle)",
        "0.01 m/rad",
        "walked backwards",
        "z [-0.1, 0.2] m",
        "gear = -2 screw + 0.1",
        "sleeve.rz = 0.25 (held)",
        "tool on e",
        "l = 0.5",
        "home",
    ]
    for part in parts:
        assert part in shown, part


def test_facts_are_json():
    data = as_json.system_facts(zoo().build())
    assert json.loads(json_text(data)) == data
    assert data["dof_of_tree"] == data["nv"] == 8
    assert [c["index"] for c in data["coordinates"]] == list(range(data["nq"]))


def test_numbers_in_json_share_a_line():
    data = {
        "a": [1.0, -2.5e-300, None],
        "b": [[1, 2], [3, 4]],
        "c": "[\n 1,\n 2\n]",
        "d": [],
        "e": ["1"],
    }
    shown = json_text(data)
    assert (
        json.loads(shown) == data and '"a": [1.0, -2.5e-300, null],' in shown and "[3, 4]" in shown
    )
    assert jsonable(np.array([[np.nan, np.inf], [1.0, -0.0]])) == [[None, None], [1.0, 0.0]]


def test_empty_systems():
    shown = text(report.info(Mechanism("nothing").build()))
    assert "C = {}" in shown and "0 bodies" in shown


def test_wide_tables_are_whole_outside_a_terminal():
    m = Mechanism("long names")
    name = "a" * 300
    m.revolute("j" * 300, m.ground, m.body(name), limits=(-1, 1))
    line = next(x for x in text(report.info(m.build())).splitlines() if name in x)
    assert "j" * 300 in line and line.endswith("rad")


def test_colours_on_terminals_only(monkeypatch):
    for variable in ("NO_COLOR", "FORCE_COLOR", "COLUMNS"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    system = zoo().build()
    assert "\x1b[" in text(report.info(system), Terminal()) and "\x1b[" not in text(
        report.info(system)
    )


def test_markup_and_control_characters_are_plain_text():
    m = Mechanism("[red]zoo[/red] :smile: \x1b[31m")
    m.fixed("j\x07", m.ground, m.body("b\r"))
    shown = text(report.info(m.build()), Terminal())
    assert "[red]zoo[/red] :smile: \\x1b[31m" in shown and "j\\x07" in shown and "b\\x0d" in shown


def test_problems_have_carets():
    where = Where("robot.urdf", 3, 8, '<axis xyz="0 0 0"/>')
    error = DescriptionError([Fault("axis is zero", "joint 'j'", where), Fault("no root")] * 12)
    lines = text(report.error(error)).splitlines()
    assert lines[0] == "error: robot.urdf:3: joint 'j': axis is zero"
    assert lines[1].strip() == where.text and lines[2].index("^") == lines[1].index("<") + 7
    assert lines[3] == "no root" and lines[-1] == "... and 4 more"
    found = text(report.findings("robot.urdf", error.problems, [f"n{i}" for i in range(12)]))
    assert found.startswith("robot.urdf: 24 problems, 12 notes") and "... and 2 more notes" in found


def test_errors_carry_their_data():
    data = as_json.error_facts(UnknownNameError("frame", "x", ["a", "b"], "arm"))
    assert data == {
        "error": "arm has no frame 'x'; there are: 'a', 'b'",
        "type": "UnknownNameError",
        "allowed": ["a", "b"],
    }
    problem = as_json.error_facts(
        DescriptionError(Fault("bad", "joint 'j'", Where("f", 3, 1, "x")))
    )["problems"][0]
    assert (problem["file"], problem["line"], problem["column"], problem["message"]) == (
        "f",
        3,
        1,
        "bad",
    )


def test_number_has_no_negative_zero():
    assert (
        report.number(-1e-9) == "0.000000"
        and report.number(-0.5, 1) == "-0.5"
        and report.number(np.nan) == "nan"
    )


def test_a_long_table_looks_as_a_short_one(monkeypatch):
    """Text in place of a table of rich, which takes a millisecond a line."""
    heads = (">target", "reached", "=name", ">q [rad]")
    lines = [
        (i, "yes" if i % 3 else "no", "\u00e4\u4e2d" * (i % 4), f"{1.5 * i:.3f}") for i in range(30)
    ]
    short = text(report.table(heads, lines, title="a title"))
    monkeypatch.setattr(report, "LONG", 10)
    long = report.table(heads, lines, title="a title")
    assert text(long).rstrip() == short.rstrip() and not hasattr(long, "columns")
