"""Reports and facts from Python: what they say, and that they print anywhere."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest

from kempe import Mechanism
from kempe.cli import terminal
from kempe.cli.terminal import list_error_data
from kempe.errors import DescriptionError, Fault, UnknownNameError, Where
from kempe.model.configurations import list_units, name_values
from kempe.views.facts import SystemFacts
from kempe.words import format_fixed, format_json, to_json_data


class Terminal(io.StringIO):
    """A terminal that remembers what it was sent."""

    def isatty(self) -> bool:
        return True


def text(answer, file=None) -> str:
    """What is printed of an answer, or of rich text."""
    file = file or io.StringIO()
    if isinstance(answer, SystemFacts):
        terminal.print_answer(answer, file=file)
    else:
        terminal.print_text(answer, file)
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
    unit = list_units(zoo().build())
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
    shown = name_values(system, np.ones(system.nq)).to_dict(degrees=True)
    assert shown["screw"] == pytest.approx(180.0 / np.pi)
    assert shown["sleeve.z"] == shown["ball.qx"] == 1.0


def test_info_says_everything():
    shown = text(SystemFacts(zoo().build()))
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
    data = SystemFacts(zoo().build()).data()
    assert json.loads(format_json(data)) == data
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
    shown = format_json(data)
    assert (
        json.loads(shown) == data and '"a": [1.0, -2.5e-300, null],' in shown and "[3, 4]" in shown
    )
    assert to_json_data(np.array([[np.nan, np.inf], [1.0, -0.0]])) == [[None, None], [1.0, 0.0]]


def test_empty_systems():
    shown = text(SystemFacts(Mechanism("nothing").build()))
    assert "C = {}" in shown and "0 bodies" in shown


def test_wide_tables_are_whole_outside_a_terminal():
    m = Mechanism("long names")
    name = "a" * 300
    m.revolute("j" * 300, m.ground, m.body(name), limits=(-1, 1))
    line = next(x for x in text(SystemFacts(m.build())).splitlines() if name in x)
    assert "j" * 300 in line and line.endswith("rad")


def test_colours_on_terminals_only(monkeypatch):
    for variable in ("NO_COLOR", "FORCE_COLOR", "COLUMNS"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    system = zoo().build()
    assert "\x1b[" in text(SystemFacts(system), Terminal()) and "\x1b[" not in text(
        SystemFacts(system)
    )


def test_markup_and_control_characters_are_plain_text():
    m = Mechanism("[red]zoo[/red] :smile: \x1b[31m")
    m.fixed("j\x07", m.ground, m.body("b\r"))
    shown = text(SystemFacts(m.build()), Terminal())
    assert "[red]zoo[/red] :smile: \\x1b[31m" in shown and "j\\x07" in shown and "b\\x0d" in shown


def test_problems_have_carets():
    where = Where("robot.urdf", 3, 8, '<axis xyz="0 0 0"/>')
    error = DescriptionError([Fault("axis is zero", "joint 'j'", where), Fault("no root")] * 12)
    lines = text(terminal.format_error(error)).splitlines()
    assert lines[0] == "error: robot.urdf:3: joint 'j': axis is zero"
    assert lines[1].strip() == where.text and lines[2].index("^") == lines[1].index("<") + 7
    assert lines[3] == "no root" and lines[-1] == "... and 4 more"
    found = text(
        terminal.format_findings("robot.urdf", error.problems, [f"n{i}" for i in range(12)])
    )
    assert found.startswith("robot.urdf: 24 problems, 12 notes") and "... and 2 more notes" in found


def test_errors_carry_their_data():
    data = list_error_data(UnknownNameError("frame", "x", ["a", "b"], "arm"))
    assert data == {
        "error": "arm has no frame 'x'; there are: 'a', 'b'",
        "type": "UnknownNameError",
        "allowed": ["a", "b"],
    }
    problem = list_error_data(DescriptionError(Fault("bad", "joint 'j'", Where("f", 3, 1, "x"))))[
        "problems"
    ][0]
    assert (problem["file"], problem["line"], problem["column"], problem["message"]) == (
        "f",
        3,
        1,
        "bad",
    )


def test_numbers_have_no_negative_zero():
    assert (format_fixed(-1e-9), format_fixed(-0.5, 1), format_fixed(np.nan)) == (
        "0.000000",
        "-0.5",
        "nan",
    )
