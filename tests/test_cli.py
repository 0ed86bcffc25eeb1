"""The command line as its users see it: answers, JSON, exit codes, sentences for what goes wrong."""

from __future__ import annotations

import importlib.metadata
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import ARM, Result, write_models
from hunts import some
from typer.main import get_command

import kempe
from kempe.cli import app
from kempe.cli.terminal import expand_home, translate_keywords
from kempe.kernels.compiled import VARIANT
from kempe.library import list_models as library_models


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    """A folder with models: arm.urdf, broken.urdf, fourbar.toml."""
    monkeypatch.chdir(tmp_path)
    write_models(tmp_path)
    return tmp_path


def tip(q1: float, q2: float) -> tuple[float, float, float]:
    """x, y and angle of the arm's tip."""
    return math.cos(q1) + 0.5 * math.cos(q1 + q2), math.sin(q1) + 0.5 * math.sin(q1 + q2), q1 + q2


# ---- the command itself


def test_help_and_version():
    assert Result("--version").out == f"kempe {kempe.__version__}, kernels {VARIANT}\n"
    alone = Result()
    requested = Result("--help")
    assert alone.code == requested.code == 0
    for name in ("info", "check", "fk", "ik", "convert", "library"):
        assert name in alone.out and name in requested.out
        assert Result(name, "--help").code == 0


def test_no_traceback_and_no_heavy_imports():
    code = (
        "import sys, kempe.cli\nkempe.cli.app(sys.argv[1:], "
        "standalone_mode=False)\nprint(sorted({'numba', 'scipy', 'sympy', 'matplotlib', "
        "'pinocchio', 'mujoco'} & set(sys.modules)))"
    )
    for arguments in (["--help"], ["info", "arm.urdf"], ["check", "arm.urdf"], ["library"]):
        done = subprocess.run(
            [sys.executable, "-c", code, *arguments], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines()[-1] == "[]", arguments


def test_as_a_process():
    command = f"{sys.executable} -c 'import kempe.cli; kempe.cli.main()' info"

    def run(words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(f"{command} {words}", shell=True, capture_output=True, text=True)

    good = run("arm.urdf")
    assert good.returncode == 0 and good.stderr == "" and "\x1b" not in good.stdout
    assert not any(line != line.rstrip() for line in good.stdout.splitlines())
    bad = run("nothing.urdf")
    assert bad.returncode == 2 and bad.stdout == "" and "Traceback" not in bad.stderr
    half = run("arm.urdf | head -n 1")
    assert half.stdout.startswith("arm") and "Traceback" not in half.stderr


# ---- options in messages


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("hold 5 of them (hold={name: value}), or", "hold 5 of them (--hold NAME=VALUE), or"),
        ("the link, with root='an arm'", "the link, with --root an arm"),
        ("lenient_limits=True reads it so", "--lenient-limits reads it so"),
        ("load it with xacro=True (", "load it with --xacro ("),
        ("give it by xacro={name: value};", "give it by --xacro-arg NAME=VALUE;"),
        ("is 0.1 away: project=True takes it", "is 0.1 away: --project takes it"),
        ("where tolerance=1e-05 lets it go on", "where --tolerance 1e-05 lets it go on"),
        ("tolerance=(1e-05, 0.002) accepts it", "--tolerance 1e-05,0.002 accepts it"),
        ("by columns=(...)", "by --columns"),
        ("with this file as srdf=(...)", "with this file as --srdf"),
        ("allow more by kempe.Budget(time_limit=...)", "allow more by --time-limit"),
        ("'A' = 0.3 or A=0.3, angles=True", "'A' = 0.3 or A=0.3, angles=True"),
    ],
)
def test_messages_name_options_of_commands(said: str, words: str):
    assert translate_keywords(said) == words
    commands = get_command(app).commands.values()  # type: ignore[attr-defined]
    options = {option for command in commands for p in command.params for option in p.opts}
    assert set(re.findall(r"--[a-z-]+", words)) <= options


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("trace puma560", "--hold NAME=VALUE"),
        ("info SWAPPED", "--lenient-limits reads it so"),
        ("info XACRO", "--xacro"),
        ("info CIRCLE", "--root base"),
        ("ik STILL --frame hand --target 0,0.5,0", "--lenient-limits reads it as unlimited"),
    ],
)
def test_failures_name_the_option_that_helps(words: str, said: str, tmp_path):
    turns = '<parent link="base"/> <child link="hand"/>'
    back = '<joint name="k" type="fixed"> <parent link="hand"/> <child link="base"/> </joint>'
    still = '<limit effort="1" velocity="1"/>'
    files = {
        "STILL": f"{turns} {still} </joint>",
        "SWAPPED": f'{turns} <limit lower="2" upper="1" effort="1" velocity="1"/> </joint>',
        "XACRO": f'{turns} <limit effort="${{1}}" velocity="1"/> </joint>',
        "CIRCLE": f"{turns} {still} </joint> {back}",
    }
    links = '<link name="base"/> <link name="hand"/>'
    for name, text in files.items():
        robot = f'<robot name="r"> {links} <joint name="j" type="revolute"> {text} </robot>'
        (tmp_path / f"{name}.urdf").write_text(robot)
    result = Result(*(str(tmp_path / f"{w}.urdf") if w in files else w for w in words.split()))
    assert result.code and said in result.out + result.err


def test_arguments_of_xacro(tmp_path):
    pytest.importorskip("xacrodoc")
    path = tmp_path / "a.urdf.xacro"
    path.write_text(
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="$(arg name)">'
        '<xacro:arg name="end" default="a"/><link name="$(arg end)"/></robot>'
    )
    given = ("--xacro-arg", "name=left")
    assert "left: 0 bodies" in Result("info", path, *given).out
    assert "b" in Result("info", path, *given, "--xacro-arg", "end=b=c", "--json").out
    assert json.loads(Result("check", path, *given, "--json").out)[0]["ok"]
    for more, code, said in (
        (("--xacro",), 2, "needs the argument 'name'; give it by --xacro-arg NAME=VALUE"),
        ((*given, "--xacro-arg", "ent=b"), 2, "no xacro argument 'ent'; did you mean 'end'?"),
        ((*given, *given), 2, "--xacro-arg gives 'name' twice"),
        (("--xacro-arg", "left"), 2, "--xacro-arg left: it must be NAME=VALUE"),
    ):
        result = Result("info", path, *more)
        assert result.code == code and said in result.err


def test_an_srdf(tmp_path):
    links = "".join(f'<link name="{name}"/>' for name in "abc")
    turns = "".join(
        f'<joint name="j{p}" type="continuous"><parent link="{p}"/><child link="{c}"/></joint>'
        for p, c in ("ab", "bc")
    )
    (tmp_path / "r.urdf").write_text(f'<robot name="r">{links}{turns}</robot>')
    (tmp_path / "r.srdf").write_text(
        '<robot name="r"><group name="arm"><joint name="jb"/></group>'
        '<group_state name="up" group="arm"><joint name="jb" value="0.5"/></group_state></robot>'
    )
    given = (tmp_path / "r.urdf", "--srdf", tmp_path / "r.srdf")
    out = Result("info", *given).out
    assert re.search(r"groups of joints +arm\n", out) and "arm/up" in out
    assert json.loads(Result("info", *given, "--json").out)["groups"] == {"arm": ["jb"]}
    said = json.loads(Result("fk", *given, "--posture", "arm/up", "--json").out)
    assert any(np.isclose(X[1, 1], np.cos(0.5)) for X in matrices(said))
    result = Result("info", tmp_path / "r.srdf")
    assert result.code == 2 and "with this file as --srdf" in result.err


def matrices(x):
    """All matrices (4, 4) in nested data."""
    inner = x.values() if isinstance(x, dict) else x if isinstance(x, list) else ()
    if isinstance(x, list) and len(x) == 4 and all(isinstance(r, list) and len(r) == 4 for r in x):
        return [np.array(x)]
    return [X for part in inner for X in matrices(part)]


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("~/x.urdf", "HOME/x.urdf"),
        ("--out=~/x.csv", "--out=HOME/x.csv"),
        ("~", "HOME"),
        ("x~/y", "x~/y"),
        ("--q=a~1", "--q=a~1"),
        ("A=~1", "A=~1"),
        ("~nobody-of-this-name/x", "~nobody-of-this-name/x"),
    ],
)
def test_files_of_the_home_folder(given: str, wanted: str, monkeypatch):
    monkeypatch.setenv("HOME", "HOME")
    assert expand_home(given) == wanted


# ---- info and check


def test_info():
    out = Result("info", "arm.urdf").out
    for part in ("C = {0, 1, 2, 3}", "T^2, dimension 2", "[-2, 2] rad", "slide = 0.01 elbow"):
        assert part in out
    assert "[-114.59, 114.59] deg" in Result("info", "arm.urdf", "--deg").out
    data = Result("info", "arm.urdf", "--json").json()
    assert data["parent"] == [0, 1, 2, 3] and data["nq"] == data["nv"] == data["dof_of_tree"] == 2
    assert [b["name"] for b in data["bodies"]] == ["base", "upper", "lower", "tip", "finger"]
    assert [j["type"] for j in data["joints"]] == ["revolute", "revolute", "fixed", "prismatic"]
    shoulder, elbow = data["coordinates"]
    assert shoulder == {"index": 0, "name": "shoulder", "unit": "rad", "lower": -2.0, "upper": 2.0}
    reached = (elbow["lower"], elbow["upper"])
    assert reached == (0.0, 2.0), "the finger's limits reach back to the elbow"
    (follows,) = data["couplings"]
    assert follows == {"of": "slide", "source": "elbow", "multiplier": 0.01, "offset": 0.0}
    degrees = Result("info", "arm.urdf", "--json", "--deg").json()["coordinates"][0]
    assert degrees["unit"] == "deg" and degrees["upper"] == pytest.approx(math.degrees(2.0))
    free = Result("info", "arm.urdf", "--json", "--base", "free").json()
    assert free["nv"] == 8 and free["nq"] == 9


def test_info_of_loops():
    data = Result("info", "fourbar.toml", "--json").json()
    assert len(data["closures"]) == 1 and data["dof_of_tree"] == 3 and data["nv"] == 4
    assert data["coordinates"][0]["lower"] is None
    text = Result("info", "fourbar.toml").out
    assert "at least 1" in text and "Loops" in text and "pen on crank" in text and "home" in text


def test_names_cannot_reach_the_terminal():
    Path("evil.toml").write_text('format = 1\nname = "a\\u001b[31mb [bold]c"\n')
    assert "a\\x1b[31mb [bold]c" in Result("info", "evil.toml").out


def test_check():
    good = Result("check", "arm.urdf")
    assert good.code == 0 and good.out == "arm.urdf: no problems\n"
    bad = Result("check", "broken.urdf")
    lines = bad.out.splitlines()
    assert bad.code == 1 and "2 problems" in bad.out
    for line in (5, 6):
        assert f"broken.urdf:{line}: joint 'wrist': " in bad.out
    shown = next(i for i, line in enumerate(lines) if line.strip().startswith("<parent link="))
    mark = lines[shown + 1]
    assert mark.strip() == "^" and lines[shown].index("0 0 0") == mark.index("^")
    both = Result("check", "arm.urdf", "broken.urdf", "nothing.urdf")
    assert both.code == 1 and both.out.rstrip().endswith("3 files: 1 good, 2 with problems")
    data = json.loads(Result("check", "arm.urdf", "broken.urdf", "--json").out)
    assert [d["ok"] for d in data] == [True, False]
    problems = [(p["line"], p["subject"]) for p in data[1]["problems"]]
    assert problems == [(5, "joint 'wrist'"), (6, "joint 'wrist'")]


@pytest.mark.parametrize(
    "words", ["info broken.urdf", "fk broken.urdf", "convert broken.urdf b.toml"]
)
def test_broken_files_are_refused(words):
    plain = Result(*words.split())
    assert plain.code == 2 and plain.out == "" and "^" in plain.err
    assert "broken.urdf:5: joint 'wrist'" in plain.err
    data = Result(*words.split(), "--json")
    assert data.code == 2 and data.err == "" and len(data.json()["problems"]) == 2


# ---- fk and ik


def test_lengths_stay_metres():
    Path("s.urdf").write_text(ARM.replace('<mimic joint="elbow" multiplier="0.01"/>', ""))
    data = Result("fk", "s.urdf", "--frame", "finger", "--q", "0,0,0.1", "--deg", "--json").json()
    np.testing.assert_allclose(data["xyz"], [1.6, 0.0, 0.0], atol=1e-15)


def test_fk_of_all_bodies():
    data = Result("fk", "arm.urdf", "--json").json()["bodies"]
    assert [b["frame"] for b in data] == ["base", "upper", "lower", "tip", "finger"]
    np.testing.assert_allclose(data[3]["xyz"], [1.5, 0.0, 0.0], atol=1e-15)
    assert "1.500000" in Result("fk", "arm.urdf").out
    assert "-0.000000" not in Result("fk", "arm.urdf", "--q", "-0.0,0").out


@pytest.mark.parametrize(
    ("words", "angle"), [("home", 0.5), ("home --q A=0.2", 0.2), ("neutral", 0.0), ("mid", 0.0)]
)
def test_fk_of_postures(words, angle):
    pen = ("fk", "fourbar.toml", "--frame", "pen", "--json")
    data = Result(*pen, "--posture", *words.split()).json()
    np.testing.assert_allclose(data["xyz"], [math.cos(angle), math.sin(angle), 0.0], atol=1e-15)


def test_fk_of_a_file():
    q = np.array([[0.1, 0.2], [-0.3, 0.7], [1.0, 1.5]])
    want = np.array([tip(*row) for row in q])
    np.save("q.npy", q)
    np.savetxt("q.csv", q, delimiter=",", fmt="%.17g")
    head = {"header": "elbow,shoulder", "comments": ""}
    np.savetxt("named.csv", q[:, ::-1], delimiter=",", fmt="%.17g", **head)
    for name in ("q.npy", "q.csv", "named.csv"):
        words = ("fk", "arm.urdf", "--frame", "tip", "--q", name)
        data = Result(*words, "--json").json()["configurations"]
        np.testing.assert_allclose([d["xyz"][:2] for d in data], want[:, :2], atol=1e-15)
        assert Result(*words, "--out", "X.npy").code == 0
        np.testing.assert_allclose(np.load("X.npy")[:, :2, 3], want[:, :2], atol=1e-15)
    Result("fk", "arm.urdf", "--frame", "tip", "--q", "q.npy", "--out", "X.csv", "--deg")
    table = np.genfromtxt("X.csv", delimiter=",", names=True)
    want = np.array([tip(*np.radians(row)) for row in q])
    found = [table["x"], table["y"], np.radians(table["yaw_deg"])]
    np.testing.assert_allclose(found, want.T, atol=1e-15)
    Result("fk", "arm.urdf", "--q", "q.npy", "--out", "all.csv")
    table = np.genfromtxt("all.csv", delimiter=",", names=True)
    assert table.size == 15 and table["configuration"][-1] == 2
    assert list(table["body"][:5]) == [0, 1, 2, 3, 4]


def test_fk_of_bad_rows():
    Path("q.csv").write_text("0,0\nnan,0\n0,0\n")
    result = Result("fk", "arm.urdf", "--frame", "tip", "--q", "q.csv", "--json")
    assert result.code == 1 and "row 1" in result.err
    xyz = [d["xyz"] for d in result.json()["configurations"]]
    assert xyz[1] == [None, None, None] and xyz[0] == xyz[2] == [1.5, 0.0, 0.0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "no rows"),
        (b"shoulder\n", "no rows"),
        (b"1,2\n3\n", ":2: 1 value;"),
        (b"1,2\n3,x\n", ":2: 'x'"),
        (b"1,x\n", ":1: 'x'"),
        (b"shoulder;elbow\n0,1;0,2\n", "commas separate columns, and a point is the decimal mark"),
        (b"shoulder,arm\n1,2\n", "'arm'"),
        (b"elbow,elbow\n1,2\n", "twice"),
        (b"1,2,3\n", "arm needs 2"),
        (b"\xff\xfe,1\n", "cannot be read as .csv: 'utf-8'"),
    ],
)
def test_wrong_files(content, said):
    Path("q.csv").write_bytes(content)
    result = Result("fk", "arm.urdf", "--q", "q.csv")
    assert result.code == 2 and said in result.err and result.err.count("\n") == 1


def test_ik_of_a_pose_with_a_negative_number_first():
    x, y, angle = tip(1.9, 1.6)
    assert x < 0
    target = f"{x},{y},0,0,0,{math.degrees(angle)}"
    result = Result("ik", "arm.urdf", "--frame", "tip", "--target", target, "--deg")
    assert result.code == 0 and "reached" in result.out
    last = result.out.splitlines()[-1]
    q = [float(v) for v in last.removeprefix("--q ").split(",")]
    np.testing.assert_allclose(q, np.degrees([1.9, 1.6]), atol=1e-4)
    again = Result("fk", "arm.urdf", "--frame", "tip", "--deg", "--json", *last.split()).json()
    np.testing.assert_allclose(again["xyz"], [x, y, 0.0], atol=1e-6)


# ---- the rest


def test_convert():
    assert Result("convert", "arm.urdf", "arm.toml").code == 0
    again = Result("convert", "arm.toml", "-o", "again.urdf", "--json").json()
    assert again["written"] == ["again.urdf"]
    assert Result("convert", "fourbar.toml", "loop.urdf").code == 0
    assert len(kempe.load("loop.urdf").structure.closures) == 1
    refused = Result("convert", "car", "x.urdf")
    assert refused.code == 2 and "does not exist in URDF" in refused.err
    assert not Path("x.urdf").exists()
    q = np.array([0.3, 0.9])
    for path in ("arm.urdf", "arm.toml", "again.urdf"):
        np.testing.assert_allclose(kempe.load(path).fk(q, "tip")[:2, 3], tip(*q)[:2], atol=1e-15)


@pytest.mark.slow
def test_library():
    data = json.loads(Result("library", "--json").out)
    listed = Result("library").out
    assert [d["name"] for d in data] == list(library_models())
    for model in data:
        assert model["description"], model["name"]
        shown = Result("library", model["name"])
        assert shown.code == 0 and model["description"] in listed
        assert kempe.read(shown.out) == kempe.read(model["name"])
        assert Result("library", model["name"], "--json").json()["toml"] == shown.out


@pytest.mark.parametrize("name", some(library_models(), 5))
def test_commands_take_shipped_models(name):
    data = Result("info", name, "--json").json()
    assert data["nq"] == kempe.load(name).nq
    assert Result("check", name).code == 0
    assert len(Result("fk", name, "--json").json()["bodies"]) == len(data["bodies"])


# ---- the page of the documentation


# ---- the main job, on a real robot


def _panda() -> str:
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    return str(next(f.locate() for f in files if Path(str(f)).name == "panda.urdf"))


@pytest.mark.parametrize(
    "target", ["0.4,0.1,0.5,180,0,0", "-0.4,0.1,0.5,180,0,0", "0.3,-0.3,0.6,170,10,-20"]
)
def test_main_job(target):
    pin = pytest.importorskip("pinocchio")
    panda = _panda()
    result = Result("ik", panda, "--frame", "panda_hand_tcp", "--target", target, "--deg", "--json")
    assert result.code == 0
    model = pin.buildModelFromUrdf(panda)
    data = model.createData()
    q = pin.neutral(model)
    for name, value in result.json()["q"].items():
        finger = "finger" in name
        q[model.joints[model.getJointId(name)].idx_q] = value if finger else math.radians(value)
    assert (q >= model.lowerPositionLimit).all() and (q <= model.upperPositionLimit).all()
    pin.forwardKinematics(model, data, q)
    X = pin.updateFramePlacement(model, data, model.getFrameId("panda_hand_tcp"))
    numbers = [float(v) for v in target.split(",")]
    want = pin.SE3(pin.rpy.rpyToMatrix(*np.radians(numbers[3:])), np.array(numbers[:3]))
    error = pin.log6(X.actInv(want))
    assert np.linalg.norm(error.linear) <= 1e-6 and np.linalg.norm(error.angular) <= 1e-6


def test_main_job_on_the_shipped_arm():
    frame = ("panda", "--frame", "panda_hand_tcp", "--deg")
    result = Result("ik", *frame, "--target", "0.4,0.1,0.5,180,0,0")
    assert result.code == 0 and result.out.startswith("reached: ") and "panda_joint7" in result.out
    pose = Result("fk", *frame, *result.out.splitlines()[-1].split(), "--json").json()
    want = [[1, 0, 0, 0.4], [0, -1, 0, 0.1], [0, 0, -1, 0.5], [0, 0, 0, 1]]
    np.testing.assert_allclose(pose["matrix"], want, atol=1e-6)
