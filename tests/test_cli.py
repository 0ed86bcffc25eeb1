"""The command line as its users see it: answers, JSON, exit codes, sentences for what goes wrong."""

from __future__ import annotations

import importlib.metadata
import json
import math
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import Result
from hunts import some
from typer.main import get_command

import kempe
from kempe.cli import app
from kempe.cli.terminal import expand_home, translate_keywords
from kempe.kernels.compiled import VARIANT
from kempe.library import list_models as library_models

ARM = """\
<robot name="arm">
  <link name="base"/> <link name="upper"/> <link name="lower"/> <link name="tip"/> <link name="finger"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/> <child link="upper"/> <axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/> <child link="lower"/> <origin xyz="1 0 0"/> <axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="end" type="fixed"> <parent link="lower"/> <child link="tip"/> <origin xyz="0.5 0 0"/> </joint>
  <joint name="slide" type="prismatic">
    <parent link="tip"/> <child link="finger"/> <axis xyz="1 0 0"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/> <mimic joint="elbow" multiplier="0.01"/>
  </joint>
</robot>
"""

BROKEN = """\
<robot name="broken">
  <link name="base"/>
  <link name="hand"/>
  <joint name="wrist" type="revolute">
    <parent link="base"/> <child link="hand"/> <axis xyz="0 0 0"/>
    <limit lower="2" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""

FOUR_BAR = """\
# A four-bar linkage.
format = 1
name = "four-bar"
dim = 2
body = [{name = "crank"}, {name = "coupler"}, {name = "rocker"}]
frame = [{name = "pen", body = "crank", at = [1.0, 0.0]}]
postures = {home = {A = 0.5}}
[[joint]]
name = "A"
type = "revolute"
parent = "ground"
child = "crank"
[[joint]]
name = "B"
type = "revolute"
parent = "crank"
child = "coupler"
at = [1.0, 0.0]
[[joint]]
name = "C"
type = "revolute"
parent = "coupler"
child = "rocker"
at = [2.0, 0.0]
child_at = [1.0, 0.0]
[[joint]]
name = "D"
type = "revolute"
parent = "ground"
child = "rocker"
at = [2.0, 0.0]
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    return path


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    path = tmp_path / "broken.urdf"
    path.write_text(BROKEN)
    return path


@pytest.fixture
def four_bar(tmp_path: Path) -> Path:
    path = tmp_path / "fourbar.toml"
    path.write_text(FOUR_BAR)
    return path


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


@pytest.mark.parametrize(
    "arguments",
    [["fly"], ["info"], ["fk", "x", "--fly"], ["ik", "two_link"], ["ik", "two_link", "--frame"]],
)
def test_wrong_usage(arguments):
    plain = Result(*arguments)
    assert plain.code == 2 and plain.out == ""
    assert plain.err.startswith("error: ") and plain.err.count("\n") == 1 and "--help" in plain.err
    data = Result(*arguments, "--json")
    assert data.code == 2 and (data.json()["error"] or "").strip() and data.err == ""


def test_wrong_options_name_the_help_of_their_command():
    assert "(see 'kempe joints --help')" in Result("joints", "--plot").err
    assert "(see 'kempe fk --help')" in Result("fk", "x", "--fly").err


def test_no_traceback_and_no_heavy_imports(arm):
    code = (
        "import sys, kempe.cli\nkempe.cli.app(sys.argv[1:], "
        "standalone_mode=False)\nprint(sorted({'numba', 'scipy', 'sympy', 'matplotlib', "
        "'pinocchio', 'mujoco'} & set(sys.modules)))"
    )
    for arguments in (["--help"], ["info", str(arm)], ["check", str(arm)], ["library"]):
        done = subprocess.run(
            [sys.executable, "-c", code, *arguments], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines()[-1] == "[]", arguments


def test_as_a_process(arm, tmp_path):
    command = [sys.executable, "-c", "import kempe.cli; kempe.cli.main()"]
    good = subprocess.run([*command, "info", str(arm)], capture_output=True, text=True)
    assert good.returncode == 0 and good.stderr == "" and "\x1b" not in good.stdout
    assert not any(line != line.rstrip() for line in good.stdout.splitlines())
    bad = subprocess.run(
        [*command, "info", str(tmp_path / "nothing.urdf")], capture_output=True, text=True
    )
    assert bad.returncode == 2 and bad.stdout == "" and "Traceback" not in bad.stderr
    half = subprocess.run(
        f"{sys.executable} -c 'import kempe.cli; kempe.cli.main()' info {arm} | head -n 1",
        shell=True,
        capture_output=True,
        text=True,
    )
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


# ---- info


def test_info(arm):
    out = Result("info", arm).out
    assert "C = {0, 1, 2, 3}" in out
    assert "T^2, dimension 2" in out
    assert "[-2, 2] rad" in out and "slide = 0.01 elbow" in out
    assert "[-114.59, 114.59] deg" in Result("info", arm, "--deg").out


def test_info_as_json(arm):
    data = Result("info", arm, "--json").json()
    assert data["parent"] == [0, 1, 2, 3] and data["nq"] == data["nv"] == data["dof_of_tree"] == 2
    assert [b["name"] for b in data["bodies"]] == ["base", "upper", "lower", "tip", "finger"]
    assert [j["type"] for j in data["joints"]] == ["revolute", "revolute", "fixed", "prismatic"]
    shoulder, elbow = data["coordinates"]
    assert shoulder == {"index": 0, "name": "shoulder", "unit": "rad", "lower": -2.0, "upper": 2.0}
    assert (elbow["lower"], elbow["upper"]) == (0.0, 2.0), (
        "the finger's limits reach back to the elbow"
    )
    assert data["couplings"] == [
        {"of": "slide", "source": "elbow", "multiplier": 0.01, "offset": 0.0}
    ]
    degrees = Result("info", arm, "--json", "--deg").json()["coordinates"][0]
    assert degrees["unit"] == "deg" and degrees["upper"] == pytest.approx(math.degrees(2.0))


def test_info_of_loops(four_bar):
    data = Result("info", four_bar, "--json").json()
    assert len(data["closures"]) == 1 and data["dof_of_tree"] == 3 and data["nv"] == 4
    assert data["coordinates"][0]["lower"] is None
    text = Result("info", four_bar).out
    assert "at least 1" in text and "Loops" in text and "pen on crank" in text and "home" in text


def test_free_base(arm):
    data = Result("info", arm, "--json", "--base", "free").json()
    assert data["nv"] == 8 and data["nq"] == 9
    refused = Result("info", arm, "--base", "fixed")
    assert refused.code == 2 and "'free'" in refused.err


def test_names_cannot_reach_the_terminal(tmp_path):
    path = tmp_path / "evil.toml"
    path.write_text('format = 1\nname = "a\\u001b[31mb [bold]c"\n')
    assert "a\\x1b[31mb [bold]c" in Result("info", path).out


# ---- check


def test_check(arm, broken):
    good = Result("check", arm)
    assert good.code == 0 and good.out == f"{arm}: no problems\n"
    bad = Result("check", broken)
    assert bad.code == 1 and "2 problems" in bad.out
    assert f"{broken}:5: joint 'wrist': " in bad.out and f"{broken}:6: joint 'wrist': " in bad.out
    lines = bad.out.splitlines()
    shown = next(i for i, line in enumerate(lines) if line.strip().startswith("<parent link="))
    assert lines[shown + 1].strip() == "^" and lines[shown].index("0 0 0") == lines[
        shown + 1
    ].index("^")


def test_check_several(arm, broken, tmp_path):
    both = Result("check", arm, broken, tmp_path / "nothing.urdf")
    assert both.code == 1 and both.out.rstrip().endswith("3 files: 1 good, 2 with problems")
    data = json.loads(Result("check", arm, broken, "--json").out)
    assert [d["ok"] for d in data] == [True, False]
    assert [(p["line"], p["subject"]) for p in data[1]["problems"]] == [
        (5, "joint 'wrist'"),
        (6, "joint 'wrist'"),
    ]


def test_broken_file_is_refused_by_all(broken):
    for arguments in (
        ["info", broken],
        ["fk", broken],
        ["convert", broken, broken.with_suffix(".toml")],
    ):
        plain = Result(*arguments)
        assert (
            plain.code == 2
            and plain.out == ""
            and f"{broken}:5: joint 'wrist'" in plain.err
            and "^" in plain.err
        )
        data = Result(*arguments, "--json")
        assert data.code == 2 and data.err == "" and len(data.json()["problems"]) == 2


# ---- fk


def test_lengths_stay_metres(tmp_path, arm):
    path = tmp_path / "slider.urdf"
    path.write_text(ARM.replace('<mimic joint="elbow" multiplier="0.01"/>', ""))
    data = Result("fk", path, "--frame", "finger", "--q", "0,0,0.1", "--deg", "--json").json()
    np.testing.assert_allclose(data["xyz"], [1.6, 0.0, 0.0], atol=1e-15)


def test_fk_of_all_bodies(arm):
    data = Result("fk", arm, "--json").json()["bodies"]
    assert [b["frame"] for b in data] == ["base", "upper", "lower", "tip", "finger"]
    np.testing.assert_allclose(data[3]["xyz"], [1.5, 0.0, 0.0], atol=1e-15)
    assert (
        "1.500000" in Result("fk", arm).out
        and "-0.000000" not in Result("fk", arm, "--q", "-0.0,0").out
    )


def test_fk_of_postures(four_bar):
    for arguments, angle in (
        (["home"], 0.5),
        (["home", "--q", "A=0.2"], 0.2),
        (["neutral"], 0.0),
        (["mid"], 0.0),
    ):
        data = Result("fk", four_bar, "--frame", "pen", "--json", "--posture", *arguments).json()
        np.testing.assert_allclose(data["xyz"], [math.cos(angle), math.sin(angle), 0.0], atol=1e-15)
    refused = Result("fk", four_bar, "--posture", "hom")
    assert refused.code == 2 and "did you mean 'home'" in refused.err


def test_fk_of_a_file(arm, tmp_path):
    q = np.array([[0.1, 0.2], [-0.3, 0.7], [1.0, 1.5]])
    want = np.array([tip(*row) for row in q])
    np.save(tmp_path / "q.npy", q)
    np.savetxt(tmp_path / "q.csv", q, delimiter=",", fmt="%.17g")
    np.savetxt(
        tmp_path / "named.csv",
        q[:, ::-1],
        delimiter=",",
        fmt="%.17g",
        header="elbow,shoulder",
        comments="",
    )
    for name in ("q.npy", "q.csv", "named.csv"):
        data = Result("fk", arm, "--frame", "tip", "--q", tmp_path / name, "--json").json()[
            "configurations"
        ]
        np.testing.assert_allclose([d["xyz"][:2] for d in data], want[:, :2], atol=1e-15)
        assert (
            Result(
                "fk", arm, "--frame", "tip", "--q", tmp_path / name, "--out", tmp_path / "X.npy"
            ).code
            == 0
        )
        np.testing.assert_allclose(np.load(tmp_path / "X.npy")[:, :2, 3], want[:, :2], atol=1e-15)
    Result(
        "fk", arm, "--frame", "tip", "--q", tmp_path / "q.npy", "--out", tmp_path / "X.csv", "--deg"
    )
    table = np.genfromtxt(tmp_path / "X.csv", delimiter=",", names=True)
    want = np.array([tip(*np.radians(row)) for row in q])
    np.testing.assert_allclose(
        [table["x"], table["y"], np.radians(table["yaw"])], want.T, atol=1e-15
    )
    Result("fk", arm, "--q", tmp_path / "q.npy", "--out", tmp_path / "all.csv")
    table = np.genfromtxt(tmp_path / "all.csv", delimiter=",", names=True)
    assert (
        table.size == 15
        and list(table["body"][:5]) == [0, 1, 2, 3, 4]
        and table["configuration"][-1] == 2
    )


def test_fk_of_bad_rows(arm, tmp_path):
    path = tmp_path / "q.csv"
    path.write_text("0,0\nnan,0\n0,0\n")
    result = Result("fk", arm, "--frame", "tip", "--q", path, "--json")
    assert result.code == 1 and "row 1" in result.err
    xyz = [d["xyz"] for d in result.json()["configurations"]]
    assert xyz[1] == [None, None, None] and xyz[0] == xyz[2] == [1.5, 0.0, 0.0]


@pytest.mark.parametrize(
    ("q", "said"),
    [
        ("1", "arm needs 2: shoulder, elbow"),
        ("1,2,3", "arm needs 2"),
        ("1,a", "'a' is not a number"),
        ("1,inf", "'elbow'"),
        ("elbw=1", "did you mean 'elbow'"),
        ("elbow=1,slide=1", "'slide'"),
        ("elbow=1,2", "name=value"),
        ("elbow=1,elbow=2", "twice"),
        ("elbow=", "not a number"),
        ("nothing.csv", "no such file"),
        ("nothing.npy", "no such file"),
        ("", "not a number"),
    ],
)
def test_wrong_configurations(arm, q, said):
    plain = Result("fk", arm, "--q", q)
    data = Result("fk", arm, "--q", q, "--json")
    assert plain.code == data.code == 2 and plain.out == data.err == ""
    assert said in plain.err and plain.err.count("\n") == 1 and said in data.json()["error"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "no rows"),
        (b"shoulder\n", "no rows"),
        (b"1,2\n3\n", ":2: 1 value;"),
        (b"1,2\n3,x\n", ":2: 'x'"),
        (b"1,x\n", ":1: 'x'"),
        (b"shoulder,arm\n1,2\n", "'arm'"),
        (b"elbow,elbow\n1,2\n", "twice"),
        (b"1,2,3\n", "arm needs 2"),
        (b"\xff\xfe,1\n", "cannot be read as .csv: 'utf-8'"),
    ],
)
def test_wrong_files(arm, tmp_path, content, said):
    (tmp_path / "q.csv").write_bytes(content)
    result = Result("fk", arm, "--q", tmp_path / "q.csv")
    assert result.code == 2 and said in result.err and result.err.count("\n") == 1


def test_wrong_arrays(arm, tmp_path):
    (tmp_path / "text.npy").write_text("no array")
    np.save(tmp_path / "flat.npy", np.zeros(2))
    np.save(tmp_path / "object.npy", np.array([{}], dtype=object), allow_pickle=True)
    for name in ("text.npy", "flat.npy", "object.npy"):
        assert Result("fk", arm, "--q", tmp_path / name).code == 2
    refused = Result("fk", arm, "--out", tmp_path / "X.txt")
    assert refused.code == 2 and ".csv or .npy" in refused.err and refused.out == ""


def test_wrong_frame(arm):
    for arguments in (
        ["fk", arm, "--frame", "tipp"],
        ["ik", arm, "--frame", "tipp", "--target", "1,0,0"],
    ):
        plain = Result(*arguments)
        data = Result(*arguments, "--json")
        assert plain.code == data.code == 2
        assert plain.err == "error: arm has no frame 'tipp'; did you mean 'tip'?\n"
        assert data.json()["error"] in plain.err and "tip" in data.json()["allowed"]


# ---- ik


def test_ik_of_a_pose_with_a_negative_number_first(arm):
    x, y, angle = tip(1.9, 1.6)
    assert x < 0
    target = f"{x},{y},0,0,0,{math.degrees(angle)}"
    result = Result("ik", arm, "--frame", "tip", "--target", target, "--deg")
    assert result.code == 0 and "reached" in result.out
    q = [float(v) for v in result.out.splitlines()[-1].removeprefix("--q ").split(",")]
    np.testing.assert_allclose(q, np.degrees([1.9, 1.6]), atol=1e-4)
    again = Result(
        "fk", arm, "--frame", "tip", "--deg", "--json", *result.out.splitlines()[-1].split()
    ).json()
    np.testing.assert_allclose(again["xyz"], [x, y, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (["--target", "1,2"], "2 numbers"),
        (["--target", "1,2,3,4"], "4 numbers"),
        (["--target", "1,2,x"], "'x'"),
        (["--target", "1,2,nan"], "finite"),
        (["--target", "1,0,0", "--tolerance", "0"], "positive"),
        (["--target", "1,0,0", "--tolerance", "1,2,3"], "one or two"),
        (["--target", "1,0,0", "--seed", "1"], "needs 2"),
        (["--target", "1,0,0", "--rng", "x"], "--rng"),
        (["--target", "1,0,0", "--out", "q.txt"], ".csv"),
    ],
)
def test_wrong_targets(arm, option, said):
    result = Result("ik", arm, "--frame", "tip", *option)
    assert result.code == 2 and said in result.err and result.err.count("\n") == 1


# ---- the rest


def test_convert(arm, tmp_path):
    toml = tmp_path / "arm.toml"
    urdf = tmp_path / "again.urdf"
    assert Result("convert", arm, toml).code == 0
    assert Result("convert", toml, urdf, "--json").json()["written"] == [str(urdf)]
    q = np.array([0.3, 0.9])
    for path in (arm, toml, urdf):
        np.testing.assert_allclose(kempe.load(path).fk(q, "tip")[:2, 3], tip(*q)[:2], atol=1e-15)


def test_convert_refuses(arm, four_bar, tmp_path):
    ending = Result("convert", arm, tmp_path / "arm.txt")
    loop = Result("convert", four_bar, tmp_path / "x.urdf")
    assert ending.code == loop.code == 2 and ".urdf, .toml" in ending.err and "loop" in loop.err
    assert not (tmp_path / "x.urdf").exists()
    folder = Result("convert", arm, tmp_path / "no" / "arm.toml")
    assert folder.code == 2 and "No such file" in folder.err and folder.err.count("\n") == 1


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
    assert Result("library", "no such model").code == 2


@pytest.mark.parametrize("name", some(library_models(), 5))
def test_commands_take_shipped_models(name):
    data = Result("info", name, "--json").json()
    assert data["nq"] == kempe.load(name).nq
    assert Result("check", name).code == 0
    assert len(Result("fk", name, "--json").json()["bodies"]) == len(data["bodies"])


# ---- the page of the documentation

PAGE = Path(__file__).parent.parent / "docs" / "cli.md"
NUMBER = r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?"
VARIES = re.compile(r"\(\d+ steps?, \d+ starts?\)|\d+ starts?|\"(iterations|starts)\": \d+")
"""What depends on the processor's last digit."""


def _same(shown: str, documented: str) -> bool:
    words, wanted = (VARIES.sub("~", text).split() for text in (shown, documented))
    return len(words) == len(wanted) and all(map(_alike, words, wanted))


def _alike(word: str, wanted: str) -> bool:
    numbers = [[float(x) for x in re.findall(NUMBER, w)] for w in (word, wanted)]
    text = [re.sub(NUMBER, "~", w) for w in (word, wanted)]
    return text[0] == text[1] and numbers[0] == pytest.approx(numbers[1], abs=2e-4)


@pytest.mark.skipif(
    not PAGE.exists(), reason="the documentation is not part of an installed package"
)
def test_examples_of_the_documentation(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    arm = re.search(r"```toml\n(.*?)```", page, re.DOTALL)
    assert arm is not None
    Path("arm.toml").write_text(arm[1])
    Path("broken.toml").write_text(arm[1].replace('"upper"\nlimits', '"uper"\nlimits'))
    Path("many.csv").write_text("0,0\n1,1\n")
    Path("way.csv").write_text("1.2,0.5,0\n1.1,0.6,0\n1.0,0.7,0\n")
    tasks = re.search(r"```text\n(# tasks.toml\n.*?)```", page, re.DOTALL)
    assert tasks is not None
    Path("tasks.toml").write_text(tasks[1])
    blocks = re.findall(r"```console\n(.*?)```", page, re.DOTALL)
    examples = [
        e
        for block in blocks
        for e in re.findall(r"^\$ kempe (.*?)\n(.*?)(?=^\$|\Z)", block, re.DOTALL | re.MULTILINE)
    ]
    assert len(examples) >= 9
    for command, documented in examples:
        result = Result(*shlex.split(command))
        assert _same(result.out + result.err, documented), (
            f"kempe {command}\n{result.out}{result.err}"
        )


# ---- the main job, on a real robot


def _panda() -> Path:
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    return Path(str(next(f.locate() for f in files if Path(str(f)).name == "panda.urdf")))


@pytest.mark.parametrize(
    "target", ["0.4,0.1,0.5,180,0,0", "-0.4,0.1,0.5,180,0,0", "0.3,-0.3,0.6,170,10,-20"]
)
def test_main_job(target):
    pin = pytest.importorskip("pinocchio")
    panda = _panda()
    result = Result("ik", panda, "--frame", "panda_hand_tcp", "--target", target, "--deg", "--json")
    assert result.code == 0
    model = pin.buildModelFromUrdf(str(panda))
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
    result = Result(
        "ik", "panda", "--frame", "panda_hand_tcp", "--target", "0.4,0.1,0.5,180,0,0", "--deg"
    )
    assert result.code == 0 and result.out.startswith("reached: ") and "panda_joint7" in result.out
    q = result.out.splitlines()[-1].split()
    pose = Result("fk", "panda", "--frame", "panda_hand_tcp", *q, "--deg", "--json").json()
    np.testing.assert_allclose(
        pose["matrix"], [[1, 0, 0, 0.4], [0, -1, 0, 0.1], [0, 0, -1, 0.5], [0, 0, 0, 1]], atol=1e-6
    )
