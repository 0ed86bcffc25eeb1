"""The commands for closed loops as their users see them: freedoms, assemblies, motions, pictures."""

from __future__ import annotations

import io
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from command import Result, write_models

import kempe
from kempe.cli import terminal


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    """A folder with models: engine.toml, rodded.toml."""
    monkeypatch.chdir(tmp_path)
    write_models(tmp_path)
    return tmp_path


def reach(angle: float) -> float:
    """Where the slider is at an angle of the crank."""
    return math.cos(angle) + math.sqrt(4.0 - math.sin(angle) ** 2)


def table(path: str) -> np.ndarray:
    return np.genfromtxt(path, delimiter=",", names=True)


class Terminal(io.StringIO):
    """A terminal that remembers what it was sent."""

    def isatty(self) -> bool:
        return True


# ---- help, and files that cannot be written


def test_help_lists_the_commands_in_order():
    shown = Result("--help").out
    order = "info check convert view fk ik path dof classify assemble trace plot demo library"
    lines = shown.splitlines()
    places = [
        next(i for i, x in enumerate(lines) if x.startswith(f"│ {name} ")) for name in order.split()
    ]
    assert places == sorted(places)
    for title in ("Describe and convert", "Positions", "Closed loops", "Models"):
        assert f" {title} " in shown
    for name in ("dof", "classify", "assemble", "trace", "plot"):
        requested = Result(name, "--help")
        assert requested.code == 0 and f"Example: kempe {name} " in requested.out


def refuse_work(*_, **__):
    pytest.fail("it worked before it looked at the file")


def test_files_that_cannot_be_written_are_reported_first(monkeypatch):
    monkeypatch.setattr("kempe.System.trace", refuse_work)
    monkeypatch.setattr("kempe.System.assemble", refuse_work)
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
        commands = [["assemble", "four_bar", option, name], ["trace", "four_bar", option, name]]
        if option == "--plot":
            commands.append(["plot", "four_bar", name])
        for words in commands:
            refused = Result(*words)
            assert refused.code == 2 and said in refused.err and refused.out == "", refused.err


def test_missing_matplotlib_is_reported_first(monkeypatch):
    for name in [*sys.modules]:
        if name.split(".")[0] == "matplotlib" or name.startswith("kempe.views.drawing"):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr("kempe.System.trace", refuse_work)
    for words in (["plot", "four_bar", "x.png"], ["trace", "four_bar", "--plot", "x.png"]):
        plain = Result(*words)
        data = Result(*words, "--json")
        assert plain.code == data.code == 2 and not Path("x.png").exists()
        assert "kempe[view]" in plain.err and plain.err.count("\n") == 1
        assert data.json()["type"] == "MissingExtraError"


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


@pytest.mark.parametrize("words", ["dof", "assemble", "trace", "assemble A=0.3 --modes"])
def test_names_cannot_reach_the_terminal(words, folder):
    text = (folder / "engine.toml").read_text()
    evil = text.replace('"B"', '"B\\u001b[31m"').replace("B = 0", '"B\\u001b[31m" = 0')
    Path("evil.toml").write_text(evil)
    command, *more = words.split()
    result = Result(command, "evil.toml", *more)
    assert result.code == 0 and "\x1b" not in result.out, result.out + result.err
    assert "B\\x1b[31m" in result.out


# ---- info, fk and dof


def test_info_shows_declared_constraints():
    keys = ("name", "type", "parent", "child", "length", "equations", "one_sided", "says")
    rod = ("rod", "distance", "crank", "slider", 2.0, 1, 0, "slider and crank are 2 m apart")
    guide = ("guide", "on_line", "ground", "slider", None, 1, 0, "slider is on a line of ground")
    data = Result("info", "rodded.toml", "--json").json()
    assert data["constraints"] == [dict(zip(keys, x, strict=True)) for x in (rod, guide)]
    shown = Result("info", "rodded.toml").out
    assert "at least 2 (4 coordinates - 2 equations of 2 constraints); kempe dof finds" in shown
    assert [line.split() for line in shown.splitlines() if line.startswith(("rod ", "guide "))] == [
        "rod distance crank - slider slider and crank are 2 m apart".split(),
        "guide on_line ground - slider slider is on a line of ground".split(),
    ]
    assert "kempe dof" in Result("info", "bennett").out
    assert "kempe dof" not in Result("info", "puma560").out


def test_fk_says_where_loops_are_open():
    q = ",".join(f"{x:.6f}" for x in kempe.load("four_bar").assemble({"A": 0.3}).q)
    for words, said in (
        ("engine.toml --frame slider", "'C' is open by 3 m"),
        ("rodded.toml --frame slider", "'rod' is open by 1 m"),
        ("four_bar --frame rocker --q 1,0,0,0", "loops are open"),
        ("engine.toml --frame slider --posture closed", ""),
        (f"four_bar --frame rocker --q {q}", ""),
        ("puma560 --frame tool", ""),
    ):
        result = Result("fk", *words.split(), "--json")
        assert result.code == 0 and "matrix" in result.json()
        assert said in result.err and bool(said) == bool(result.err)


def test_named_values_are_closed():
    """`kempe fk` closes the loops around 'name=value', and around the named columns of a file."""
    system = kempe.load("four_bar")
    poses = [system.fk(system.assemble({"A": a}).q)[:, :3, 3] for a in (1.0, 1.2)]
    one = Result("fk", "four_bar", "--q", "A=1.0", "--frame", "rocker", "--json")
    assert one.code == 0 and "open" not in one.err
    Path("a.csv").write_text("A\n1.0\n1.2\n")
    many = Result("fk", "four_bar", "--q", "a.csv", "--out", "poses.csv")
    assert many.code == 0 and "open" not in many.err
    rows = np.loadtxt("poses.csv", delimiter=",", skiprows=1)
    assert np.allclose(rows[:, 2:5].reshape(2, -1, 3), poses, atol=1e-8)


def test_dof_where_nothing_closes():
    plain = Result("dof", "engine.toml", "--q", "S=3.5")
    data = Result("dof", "engine.toml", "--q", "S=3.5", "--json")
    assert plain.code == data.code == 1
    assert plain.out.startswith("not closed") and "0.5 m" in plain.out
    assert data.json()["success"] is False and data.json()["q"]["S"] == 3.5


# ---- assemble


def test_coordinates_that_follow_others():
    """The wheel turns by 0.1 - 2 A."""
    crank = (math.radians(30.0) - 0.1) / -2.0
    for more in ([], ["--modes"], ["--branch", "+"]):
        q = Result("assemble", "engine.toml", "W=30", "--deg", "--json", *more).json()["q"]
        q = q[0] if more == ["--modes"] else q
        assert math.radians(q["A"]) == pytest.approx(crank, abs=1e-12)
        assert q["S"] == pytest.approx(reach(crank), abs=1e-12), more
    held = Result("trace", "engine.toml", "--hold", "W=30", "--deg", "--json").json()
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


def test_an_open_loop_is_reported_and_not_written():
    pytest.importorskip("matplotlib")
    words = ("assemble", "engine.toml", "S=3.5", "--out", "q.csv")
    result = Result(*words, "--plot", "q.png")
    assert result.code == 1 and result.out.startswith("not closed")
    assert "stays open by 0.5 m" in result.out and "q.csv is not written" in result.err
    assert not Path("q.csv").exists() and Path("q.png").exists()
    assert "nearest found" in result.out and "--q" not in result.out
    data = Result(*words, "--json")
    assert data.code == 1 and data.json()["success"] is False and data.json()["written"] == []


def test_assemble_rows_of_a_file():
    inputs = Path("in.csv")
    inputs.write_text("A\n0.1\n0.2\n0.3\n")
    result = Result("assemble", "engine.toml", inputs, "--continuous", "--out", "q.csv", "--json")
    want = [reach(a) for a in (0.1, 0.2, 0.3)]
    data = result.json()
    assert result.code == 0 and data["success"] == [True] * 3 and data["written"] == ["q.csv"]
    assert [q["S"] for q in data["q"]] == pytest.approx(want, abs=1e-12)
    assert table("q.csv")["S"].tolist() == pytest.approx(want, abs=1e-12)
    inputs.write_text("S\n2.5\n3.5\n")
    half = Result("assemble", "engine.toml", inputs, "--out", "q.csv")
    assert half.code == 1 and half.out.startswith("1 of 2 configurations closed\n")
    assert "row 1: not closed" in half.out
    closed = np.isfinite(table("q.csv")["A"]).tolist()
    assert closed == [True, False], "what is not closed is NaN in the file"
    inputs.write_text("A\n0.1\nnan\n")
    bad = Result("assemble", "engine.toml", inputs, "--json")
    assert bad.code == 1 and bad.json()["code"] == ["SOLVED", "BAD_INPUT"]
    assert bad.json()["q"][0] and bad.json()["q"][1] is None


def test_an_equation_that_is_a_coordinate_alone_is_zero():
    alone = Result("assemble", "four_bar", "--where", "A", "--where", "A", "--json")
    assert alone.code == 0 and abs(alone.json()["q"]["A"]) < 1e-12


# ---- trace and plot


def test_trace_in_words():
    """The rod leans by 30 degrees at most, where the crank is at right angles."""
    result = Result("trace", "engine.toml", "--deg", "--out", "path.npy")
    assert result.code == 0 and result.out.startswith("engine: closed curve")
    assert result.out.endswith("written to path.npy\n")
    lines = [line.split() for line in result.out.splitlines()]
    assert ["C", "-30.0000", "30.0000", "deg"] in lines
    assert ["S", "1.000000", "3.000000", "m"] in lines
    assert "extreme, 'C' = 30 deg" in result.out
    assert np.load("path.npy").shape[1] == 5


@pytest.mark.slow
def test_trace_other_branches():
    """A kite has the branch on which two of its bodies turn as one: A stays at a multiple of pi."""
    pytest.importorskip("matplotlib")
    words = ("trace", "kite", "--branches")
    data = Result(*words, "--out", "kite.csv", "--plot", "kite.svg", "--json").json()
    rows = table("kite.csv")
    (other,) = data["others"]
    assert [e["kind"] for e in data["singular_points"]] == ["bifurcation"] * 2 and other["closed"]
    assert {*rows["branch"].tolist()} == {0.0, 1.0}
    assert sum(rows["branch"] == 1) == len(other["q"])
    straight = rows[rows["branch"] == 1]["A"] / np.pi
    np.testing.assert_allclose(straight, np.round(straight), atol=1e-9)
    assert np.ptp(rows[rows["branch"] == 0]["A"]) > 6.0
    assert "another branch" in Result(*words).out
    few = Result(*words, "--points", "7", "--json").json()
    assert len(few["q"]) == len(few["others"][0]["q"]) == 7
    assert Result("trace", "kite", "--plot", "alone.svg").code == 0
    both = len(Path("kite.svg").read_text())
    assert both > len(Path("alone.svg").read_text()) + 1000, "the other curve is drawn, too"


@pytest.mark.slow
def test_plot():
    pytest.importorskip("matplotlib")
    for name, first in (("x.png", b"\x89PNG"), ("x.svg", b"<?xml"), ("x.pdf", b"%PDF")):
        result = Result("plot", "engine.toml", name, "--q", "A=30", "--deg", "--frame", "pin")
        assert result.code == 0 and result.out == f"written to {name}\n"
        assert Path(name).read_bytes().startswith(first)
    marked = Path("x.svg").read_text(encoding="utf-8")
    assert 'id="mark:pin:x"' in marked and 'id="mark:crank:x"' not in marked
    data = Result("plot", "puma560", "space.svg", "--frame", "tool", "--json")
    assert data.code == 0 and data.json() == {"written": ["space.svg"]}
    assert 'id="mark:tool:z"' in Path("space.svg").read_text(encoding="utf-8")
    wrong = Result("plot", "engine.toml", "z.png", "--q", "S=9")
    assert wrong.code == 1 and "not closed" in wrong.err and Path("z.png").exists()
