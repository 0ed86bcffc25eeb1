"""The commands for closed loops as their users see them: freedoms, assemblies, motions, pictures,
errors.
"""

from __future__ import annotations

import io
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import Result

import kempe
from kempe.cli import terminal

CRANK_SLIDER = """\
# A crank of 1 m and a rod of 2 m that push a slider along x; a wheel is geared to the crank.
format = 1
name = "engine"
dim = 2
body = [{name = "wheel"}, {name = "crank"}, {name = "rod"}, {name = "slider"}]
frame = [{name = "pin", body = "rod"}]
postures = {closed = {A = 0, B = 0, C = 0, S = 3}}
[[joint]]
name = "W"
type = "revolute"
parent = "ground"
child = "wheel"
at = [-1, 0]
[[joint]]
name = "A"
type = "revolute"
parent = "ground"
child = "crank"
[[joint]]
name = "B"
type = "revolute"
parent = "crank"
child = "rod"
at = [1, 0]
[[joint]]
name = "C"
type = "revolute"
parent = "rod"
child = "slider"
at = [2, 0]
[[joint]]
name = "S"
type = "prismatic"
parent = "ground"
child = "slider"
axis = [1, 0]
[[coupling]]
of = "W"
sources = {A = -2.0}
offset = 0.1
"""

RODDED = """\
# The same engine with a rod that has no body, and a slider that floats on a line.
format = 1
name = "rodded"
dim = 2
body = [{name = "crank"}, {name = "slider"}]
[[joint]]
name = "A"
type = "revolute"
parent = "ground"
child = "crank"
[[joint]]
name = "P"
type = "planar"
parent = "ground"
child = "slider"
[[constraint]]
name = "rod"
type = "distance"
parent = "crank"
child = "slider"
at = [1, 0]
length = 2.0
[[constraint]]
name = "guide"
type = "point_on_line"
parent = "ground"
child = "slider"
axis = [1, 0]
"""


@pytest.fixture
def engine(tmp_path: Path) -> Path:
    path = tmp_path / "engine.toml"
    path.write_text(CRANK_SLIDER)
    return path


@pytest.fixture
def rodded(tmp_path: Path) -> Path:
    path = tmp_path / "rodded.toml"
    path.write_text(RODDED)
    return path


def reach(angle: float) -> float:
    """Where the slider is at an angle of the crank."""
    return math.cos(angle) + math.sqrt(4.0 - math.sin(angle) ** 2)


def table(path: Path) -> np.ndarray:
    return np.genfromtxt(path, delimiter=",", names=True)


def gap(system: kempe.System, q: dict[str, float]) -> float:
    """By how much the loops are open at a configuration by name."""
    return float(np.abs(system.loops.closure_error(system.q(q))).max())


class Terminal(io.StringIO):
    """A terminal that remembers what it was sent."""

    def isatty(self) -> bool:
        return True


# ---- help, usage


def test_help_lists_the_commands_in_order():
    shown = Result("--help").out
    order = (
        "info",
        "check",
        "convert",
        "fk",
        "ik",
        "dof",
        "classify",
        "assemble",
        "trace",
        "plot",
        "library",
    )
    places = [
        next(i for i, x in enumerate(shown.splitlines()) if x.startswith(f"│ {name} "))
        for name in order
    ]
    assert places == sorted(places)
    for title in ("Describe and convert", "Positions", "Closed loops", "Models"):
        assert f" {title} " in shown
    for name in ("dof", "classify", "assemble", "trace", "plot"):
        requested = Result(name, "--help")
        assert requested.code == 0 and f"Example: kempe {name} " in requested.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["dof"], "FILE"),
        (["dof", "four_bra"], "did you mean 'four_bar'"),
        (["dof", "four_bar", "--actuated", "X"], "no joint or coordinate 'X'"),
        (["dof", "four_bar", "--actuated", " , "], "names no joint; there are: A, B, C, D"),
        (["dof", "four_bar", "--q", "A=nan"], "'A' is nan; it must be finite"),
        (["dof", "four_bar", "--q", "1,2"], "four_bar needs 4"),
        (["dof", "four_bar", "--q", "coupler_point=1"], "no coordinate 'coupler_point'"),
        (["dof", "four_bar", "--posture", "closd"], "did you mean 'closed'"),
        (["assemble", "four_bar", "A"], "'A' is no known value"),
        (["assemble", "four_bar", "=1"], "'=1' is no known value"),
        (["assemble", "four_bar", "A="], "'' is not a number"),
        (["assemble", "four_bar", "A=x"], "'x' is not a number"),
        (["assemble", "four_bar", "A=-inf"], "'A' is -inf; it must be finite"),
        (["assemble", "four_bar", "A=1", "A=1"], "'A' is given twice"),
        (["assemble", "four_bar", "A=1,2"], "'A' has 2 values"),
        (["assemble", "four_bar", "crnk=1"], "no coordinate or frame 'crnk'"),
        (["assemble", "four_bar", "coupler_point=1"], "its place is coupler_point=x,y"),
        (["assemble", "four_bar", "coupler_point=1,nan"], "is nan; it must be finite"),
        (["assemble", "four_bar", "nothing.csv"], "no such file"),
        (["assemble", "four_bar", "--near", "opne"], "no posture 'opne'"),
        (["assemble", "four_bar", "--near", "A=inf"], "is inf; it must be finite"),
        (["assemble", "four_bar", "--near", "1,2"], "four_bar needs 4"),
        (["assemble", "four_bar", "A=1", "--branch", "++"], "branch is '++'; it must be 1 sign"),
        (["assemble", "four_bar", "A=1", "--branch", "open"], "or the name of a posture"),
        (
            ["assemble", "four_bar", "coupler_point=0,1", "--branch", "+"],
            "'coupler_point' is a frame",
        ),
        (["assemble", "four_bar", "--modes", "--branch", "+"], "leave --branch"),
        (["trace", "four_bar", "--driver", "X"], "'X'"),
        (["trace", "four_bar", "--frame", "X"], "no frame 'X'"),
        (["trace", "four_bar", "--points", "1"], "--points is 1; it must be at least 2"),
        (["trace", "four_bar", "--hold", "A"], "'A' is no known value: write name=value"),
        (["trace", "four_bar", "--hold", "A=1", "--start", "A=1"], "leave one out"),
        (["trace", "four_bar", "--start", "opne"], "no posture 'opne'"),
        (["trace", "five_bar"], "2 freedoms"),
        (["trace", "two_link"], "2 freedoms"),
        (["plot", "four_bar"], "OUT"),
        (["plot", "four_bar", "x.png", "--frame", "X"], "no frame 'X'"),
    ],
)
def test_wrong_questions(arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plain = Result(*arguments)
    data = Result(*arguments, "--json")
    assert plain.code == data.code == 2 and plain.out == data.err == "", plain.out + data.err
    assert said in plain.err and plain.err.startswith("error: ") and plain.err.count("\n") == 1, (
        plain.err
    )
    assert said in data.json()["error"] and not list(tmp_path.iterdir())


def test_files_that_cannot_be_written_are_reported_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "kempe.System.trace", lambda *_, **__: pytest.fail("it worked before it looked at the file")
    )
    monkeypatch.setattr(
        "kempe.System.assemble",
        lambda *_, **__: pytest.fail("it worked before it looked at the file"),
    )
    Path("folder.csv").mkdir()
    Path("folder.png").mkdir()
    for option, name, said in (
        ("--out", "x.txt", ".csv or .npy"),
        ("--out", "x", ".csv or .npy"),
        ("--out", "no/x.csv", "no folder 'no'"),
        ("--out", "folder.csv", "this is a folder"),
        ("--plot", "x.bmp", ".png, .svg or .pdf"),
        ("--plot", "no/x.png", "no folder 'no'"),
        ("--plot", "folder.png", "this is a folder"),
    ):
        for command in ("assemble", "trace"):
            refused = Result(command, "four_bar", option, name)
            assert refused.code == 2 and said in refused.err and refused.out == "", refused.err
    for name, said in (("x.bmp", ".svg"), ("no/x.png", "no folder"), ("folder.png", "a folder")):
        refused = Result("plot", "four_bar", name)
        assert refused.code == 2 and said in refused.err


def test_missing_matplotlib_is_reported_first(tmp_path, monkeypatch):
    for name in [
        n
        for n in sys.modules
        if n.split(".")[0] == "matplotlib" or n.startswith("kempe.views.drawing")
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(
        "kempe.System.trace", lambda *_, **__: pytest.fail("it worked before it looked")
    )
    for command in (
        ["plot", "four_bar", tmp_path / "x.png"],
        ["trace", "four_bar", "--plot", tmp_path / "x.png"],
    ):
        plain = Result(*command)
        data = Result(*command, "--json")
        assert (
            plain.code == data.code == 2
            and "kempe[view]" in plain.err
            and plain.err.count("\n") == 1
        )
        assert data.json()["type"] == "MissingExtraError" and not (tmp_path / "x.png").exists()


def test_narrow_terminals_get_all_digits(monkeypatch):
    for variable in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("COLUMNS", "20")
    system = kempe.load("four_bar")
    answer = system.assemble({"A": 0.3})
    for made in (answer, system.trace()):
        wide = io.StringIO()
        narrow = Terminal()
        terminal.print_answer(made, file=wide)
        terminal.print_answer(made, file=narrow)
        numbers = [x for x in wide.getvalue().split() if re.fullmatch(r"-?\d+\.\d{6}", x)]
        assert len(numbers) >= 4 and all(x in narrow.getvalue().split() for x in numbers)
    copy = "--q " + ",".join(f"{x:.9f}".rstrip("0") for x in answer.q)
    out = Terminal()
    terminal.print_answer(answer, file=out)
    assert copy in out.getvalue(), "the line to copy has no breaks in it"


@pytest.mark.parametrize(
    "command", [["dof"], ["assemble"], ["trace"], ["assemble", "A=0.3", "--modes"]], ids=str
)
def test_names_cannot_reach_the_terminal(command, tmp_path):
    path = tmp_path / "evil.toml"
    path.write_text(
        CRANK_SLIDER.replace('"B"', '"B\\u001b[31m"').replace("B = 0", '"B\\u001b[31m" = 0')
    )
    result = Result(command[0], path, *command[1:])
    assert result.code == 0 and "\x1b" not in result.out and "B\\x1b[31m" in result.out, (
        result.out + result.err
    )


# ---- info and fk


def test_info_shows_declared_constraints(rodded):
    data = Result("info", rodded, "--json").json()
    assert data["constraints"] == [
        {
            "name": "rod",
            "type": "distance",
            "parent": "crank",
            "child": "slider",
            "length": 2.0,
            "equations": 1,
            "one_sided": 0,
            "says": "slider and crank are 2 m apart",
        },
        {
            "name": "guide",
            "type": "on_line",
            "parent": "ground",
            "child": "slider",
            "length": None,
            "equations": 1,
            "one_sided": 0,
            "says": "slider is on a line of ground",
        },
    ]
    shown = Result("info", rodded).out
    assert "4 of all joints less 2 equations of 2 constraints: at least 2; kempe dof" in shown
    assert [line.split() for line in shown.splitlines() if line.startswith(("rod ", "guide "))] == [
        "rod distance crank - slider slider and crank are 2 m apart".split(),
        "guide on_line ground - slider slider is on a line of ground".split(),
    ]
    assert (
        "kempe dof" in Result("info", "bennett").out
        and "kempe dof" not in Result("info", "puma560").out
    )


def test_fk_says_where_loops_are_open(engine, rodded):
    def note(*arguments):
        result = Result("fk", *arguments, "--json")
        assert result.code == 0 and "matrix" in result.json()
        return result.err

    assert "'C' is open by 3 m" in note(engine, "--frame", "slider")
    assert "'rod' is open by 1 m" in note(rodded, "--frame", "slider")
    q = ",".join(f"{x:.6f}" for x in kempe.load("four_bar").assemble({"A": 0.3}).q)
    assert note(engine, "--frame", "slider", "--posture", "closed") == ""
    assert (
        note("four_bar", "--frame", "rocker", "--q", q) == note("puma560", "--frame", "tool") == ""
    )


# ---- classify


def test_classify_where_loops_are_open():
    """Refused with the distance, or projected."""
    requested = ("classify", "four_bar", "--q", "0.5,0.1,0.2,0.3")
    done = Result(*requested)
    projected = Result(*requested, "--project")
    assert done.code == 2 and "project" in done.err
    assert projected.code == 0 and "away from what was given" in " ".join(projected.out.split())


# ---- dof


def test_dof_where_nothing_closes(engine):
    plain = Result("dof", engine, "--q", "S=3.5")
    data = Result("dof", engine, "--q", "S=3.5", "--json")
    assert (
        plain.code == data.code == 1 and plain.out.startswith("not closed") and "0.5 m" in plain.out
    )
    assert data.json()["success"] is False and data.json()["q"]["S"] == 3.5


# ---- assemble


def test_coordinates_that_follow_others(engine):
    """The wheel turns by 0.1 - 2 A."""
    crank = (math.radians(30.0) - 0.1) / -2.0
    for more in ([], ["--modes"], ["--branch", "+"]):
        q = Result("assemble", engine, "W=30", "--deg", "--json", *more).json()["q"]
        q = q[0] if more == ["--modes"] else q
        assert math.radians(q["A"]) == pytest.approx(crank, abs=1e-12)
        assert q["S"] == pytest.approx(reach(crank), abs=1e-12), more
    refused = Result("assemble", engine, "A=1", "W=1")
    assert refused.code == 2 and "'W' is 1; it follows 'A'" in refused.err
    held = Result("trace", engine, "--hold", "W=30", "--deg", "--json").json()
    (q,) = held["q"]
    assert q["A"] == pytest.approx(math.degrees(crank), abs=1e-9)
    assert q["S"] == pytest.approx(reach(crank), abs=1e-9)


def test_the_last_line_can_be_given_back():
    line = Result("assemble", "four_bar", "A=40", "--deg").out.splitlines()[-1].split()
    assert line[0] == "--q"
    pose = Result("fk", "four_bar", "--frame", "rocker", *line, "--deg", "--json")
    robot = kempe.load("four_bar")
    want = robot.fk(robot.assemble({"A": math.radians(40.0)}).q, "rocker")
    np.testing.assert_allclose(pose.json()["matrix"], want, atol=1e-9)
    assert pose.err == ""


def test_an_open_loop_is_reported_and_not_written(engine, tmp_path):
    out = tmp_path / "q.csv"
    picture = tmp_path / "q.png"
    pytest.importorskip("matplotlib")
    result = Result("assemble", engine, "S=3.5", "--out", out, "--plot", picture)
    assert (
        result.code == 1
        and result.out.startswith("not closed")
        and "stays open by 0.5 m" in result.out
    )
    assert not out.exists() and picture.exists() and f"{out} is not written" in result.err
    assert "nearest found" in result.out and "--q" not in result.out
    data = Result("assemble", engine, "S=3.5", "--out", out, "--json")
    assert data.code == 1 and data.json()["success"] is False and data.json()["written"] == []


def test_assemble_rows_of_a_file(engine, tmp_path):
    inputs = tmp_path / "in.csv"
    out = tmp_path / "out.csv"
    inputs.write_text("A\n0.1\n0.2\n0.3\n")
    result = Result("assemble", engine, inputs, "--continuous", "--out", out, "--json")
    want = [reach(a) for a in (0.1, 0.2, 0.3)]
    assert (
        result.code == 0
        and result.json()["success"] == [True] * 3
        and result.json()["written"] == [str(out)]
    )
    assert [q["S"] for q in result.json()["q"]] == pytest.approx(want, abs=1e-12)
    assert table(out)["S"].tolist() == pytest.approx(want, abs=1e-12)
    inputs.write_text("S\n2.5\n3.5\n")
    half = Result("assemble", engine, inputs, "--out", out)
    assert (
        half.code == 1
        and half.out.startswith("1 of 2 configurations closed\n")
        and "row 1: not closed" in half.out
    )
    assert np.isfinite(table(out)["A"]).tolist() == [True, False], (
        "what is not closed is NaN in the file"
    )
    for text, said in (
        ("1\n2\n", "must name"),
        ("X\n1\n", "no coordinate or frame 'X'"),
        ("A,A\n1,1\n", "twice"),
    ):
        inputs.write_text(text)
        refused = Result("assemble", engine, inputs)
        assert refused.code == 2 and said in refused.err, text
    inputs.write_text("A\n0.1\nnan\n")
    bad = Result("assemble", engine, inputs, "--json").json()
    assert bad["code"] == ["SOLVED", "BAD_INPUT"] and bad["q"][1] is None
    inputs.write_text("A\n1\n2\n")
    refused = Result("assemble", engine, inputs, "--plot", tmp_path / "x.png")
    assert refused.code == 2 and "one configuration is drawn" in refused.err


# ---- trace


def test_trace_in_words(engine, tmp_path):
    """The rod leans by 30 degrees at most, where the crank is at right angles."""
    out = tmp_path / "path.npy"
    result = Result("trace", engine, "--deg", "--out", out)
    assert (
        result.code == 0
        and result.out.startswith("engine: closed curve")
        and result.out.endswith(f"written to {out}\n")
    )
    lines = [line.split() for line in result.out.splitlines()]
    assert ["C", "-30.0000", "30.0000", "deg"] in lines
    assert ["S", "1.000000", "3.000000", "m"] in lines
    assert "extreme, 'C' = 30 deg" in result.out
    assert np.load(out).shape[1] == 5


@pytest.mark.slow
def test_trace_other_branches(tmp_path):
    """A kite has the branch on which two of its bodies turn as one: A stays at a multiple of pi."""
    pytest.importorskip("matplotlib")
    out = tmp_path / "kite.csv"
    picture = tmp_path / "kite.svg"
    result = Result("trace", "kite", "--branches", "--out", out, "--plot", picture, "--json")
    data = result.json()
    rows = table(out)
    (other,) = data["others"]
    assert [e["kind"] for e in data["singular_points"]] == ["bifurcation"] * 2 and other["closed"]
    assert sorted(set(rows["branch"].tolist())) == [0.0, 1.0] and sum(rows["branch"] == 1) == len(
        other["q"]
    )
    straight = rows[rows["branch"] == 1]["A"] / np.pi
    np.testing.assert_allclose(straight, np.round(straight), atol=1e-9)
    assert np.ptp(rows[rows["branch"] == 0]["A"]) > 6.0
    assert "another branch" in Result("trace", "kite", "--branches").out
    few = Result("trace", "kite", "--branches", "--points", "7", "--json").json()
    assert len(few["q"]) == len(few["others"][0]["q"]) == 7
    alone = tmp_path / "alone.svg"
    assert Result("trace", "kite", "--plot", alone).code == 0
    assert len(picture.read_text()) > len(alone.read_text()) + 1000, "the other curve is drawn, too"


@pytest.mark.skipif(os.name == "nt", reason="signals of processes")
def test_an_interrupt_keeps_what_was_done(tmp_path):
    out = tmp_path / "part.csv"
    code = (
        "import dataclasses, os, signal, kempe, kempe.cli\ntrace = kempe.System.trace\ndef "
        "interrupted(*args, budget=kempe.Budget(), **options):\n    budget = "
        "dataclasses.replace(budget, progress=lambda n, s: os.kill(os.getpid(), signal.SIGINT))\n "
        "   return trace(*args, budget=budget, **options)\nkempe.System.trace = "
        "interrupted\nimport sys; sys.argv[1:] = ['trace', 'four_bar', '--out', "
        f"{str(out)!r}]\nkempe.cli.main()\n"
    )
    code = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n" + code
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (
        done.returncode == 130 and "interrupted" in done.stdout and "Traceback" not in done.stderr
    ), done.stderr
    system = kempe.load("four_bar")
    rows = table(out)
    assert 10 < len(rows) < 60
    q = np.array(rows.tolist())[:, 1:]
    assert np.abs(system.loops.closure_error(q)).max() < 1e-9


# ---- plot


@pytest.mark.slow
def test_plot(engine, tmp_path):
    pytest.importorskip("matplotlib")
    for name, first in (("x.png", b"\x89PNG"), ("x.svg", b"<?xml"), ("x.pdf", b"%PDF")):
        path = tmp_path / name
        result = Result("plot", engine, path, "--q", "A=30", "--deg", "--frame", "pin")
        assert (
            result.code == 0
            and result.out == f"written to {path}\n"
            and path.read_bytes().startswith(first)
        )
    marked = (tmp_path / "x.svg").read_text(encoding="utf-8")
    assert 'id="mark:pin:x"' in marked and 'id="mark:crank:x"' not in marked
    space = tmp_path / "space.svg"
    assert Result("plot", "puma560", space, "--frame", "tool").code == 0
    assert 'id="mark:tool:z"' in space.read_text(encoding="utf-8")
    data = Result("plot", "puma560", tmp_path / "y.png", "--json")
    assert data.code == 0 and data.json() == {"written": [str(tmp_path / "y.png")]}
    wrong = Result("plot", engine, tmp_path / "z.png", "--q", "S=9")
    assert wrong.code == 1 and "not closed" in wrong.err and (tmp_path / "z.png").exists()
    refused = Result("plot", engine, tmp_path / "w.png", "--q", "A=nan")
    assert refused.code == 2 and not (tmp_path / "w.png").exists()


def test_named_values_are_closed_and_numbers_are_not(tmp_path):
    """`kempe fk` closes the loops around 'name=value', and around the named columns of a file; a
    row of q is taken.
    """
    system = kempe.load("four_bar")
    poses = [
        [tuple(np.round(x[:3, 3], 9)) for x in system.fk(system.assemble({"A": a}).q)]
        for a in (1.0, 1.2)
    ]
    one = Result("fk", "four_bar", "--q", "A=1.0", "--frame", "rocker", "--json")
    assert one.code == 0 and "open" not in one.err
    (tmp_path / "a.csv").write_text("A\n1.0\n1.2\n")
    out = tmp_path / "poses.csv"
    many = Result("fk", "four_bar", "--q", tmp_path / "a.csv", "--out", out)
    assert many.code == 0 and "open" not in many.err
    rows = np.loadtxt(out, delimiter=",", skiprows=1)
    assert np.allclose(rows[:, 2:5].reshape(2, -1, 3), poses, atol=1e-8)
    assert "loops are open" in Result("fk", "four_bar", "--q", "1,0,0,0").err
    wrong = Result("fk", "slider_crank", "--q", "S=99")
    assert wrong.code == 2 and "must close them" in re.sub(r"\s+", " ", wrong.err)
