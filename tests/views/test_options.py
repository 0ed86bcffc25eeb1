"""The command line speaks of its options: no sentence of the library reaches it in words of Python."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest
import sources
from command import Result

import kempe
from kempe.views.options import WORDS, at_home, data_in_options, in_options

SOURCE = Path(kempe.__file__).parent
PYTHON = re.compile(
    r"\b[a-z_]+=(?:True|False|None|\{[a-z]|\(|q\b)"  # keyword arguments
    r"|`[a-z_]+`"  # names
    r"|\b(?:robot|system|kempe\.\w+|path)\.\w+"  # attributes
    r"|\b[a-z_]+\(\)"  # calls
    r"|\b(?:package_dirs|lenient_limits)\b"
)
"""What only Python's users can do."""

NOT_OF_COMMANDS = {
    "analysis/continuation/path.py": "trace(start=path.elsewhere[0])",  # the command names --start and its value
    "analysis/motion/transmission.py": "coupler=...",
    "analysis/continuation/other_branches.py": "",
    "analysis/manoeuvre/wheeled.py": "(system.configuration_space.interpolate)",
    "constraints/equations.py": "of=(...)",
    "kinematics/formulas/symbolic_closure.py": "loops.constraints() has numbers",
    "solvers/one_frame/solution.py": "history=True",
    "solvers/one_frame/iterates.py": "history=True",
    "model/tree/coordinates.py": "time=True",
    "constraints/recording.py": "(float(), or a function of math: use that of numpy)",
    "description/compose.py": "`at` cannot be given",
    "description/mechanism.py": "kempe.read first",
    "solvers/analytic/plans/branch_names.py": "`branch` has their numbers",
    "errors.py": "start=q sorts the solutions",
    "budget.py": "it must be a kempe.Budget",
    "solvers/analytic/ik_all.py": "limits='turns' is for chains",
    "solvers/analytic/redundant/redundancy.py": "`ik_all`",
    "solvers/assembly/charts.py": "no choice of coordinates",
    "solvers/paths/self_motion.py": "`direction`",
    "analysis/motion/drive.py": "give it by `times`",
    "solvers/velocity/servo_closed.py": "robot.assemble(start=q)",
    "solvers/tasks/ik_tasks.py": "a task of kempe.tasks or a list",
    "views/plots.py": "as `system`",
    "description/checks.py": "",
    "solvers/analytic/plans/chain_lines.py": "",
    "solvers/common/answer.py": "",
    "solvers/common/slip.py": "",
    "solvers/dyads/dyads.py": "",
}
"""Files whose sentences in Python are of calls that no command makes, and some words of these."""


@cache
def sentences() -> list[tuple[str, str]]:
    """Files and texts in them, docstrings left out."""
    out = []
    for path in sorted(SOURCE.rglob("*.py")):
        name = path.relative_to(SOURCE).as_posix()
        if name.split("/")[0] in ("kernels", "cli") or "benchmark" in name or name in ("views/options.py",):
            continue
        tree = sources.tree(path)
        plain = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.JoinedStr):
                parts = [v.value if isinstance(v, ast.Constant) else "1" for v in node.values]
                plain |= {id(v) for v in node.values}
                out.append((name, "".join(map(str, parts))))
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in plain:
                out.append((name, node.value))
    return [(n, t) for n, t in out if " " in t.strip() and not t.strip().startswith(("<", "import", "\nimport"))]


@pytest.mark.slow
def test_sentences_of_the_library_are_in_words_of_the_command_line():
    found = [(n, t) for n, t in sentences() if PYTHON.search(in_options(t)) and n not in NOT_OF_COMMANDS]
    assert not found, "add these to WORDS of views/options.py, or say that no command can meet them"
    assert sum(in_options(t) != t for _, t in sentences()) >= 5


@pytest.mark.parametrize(("name", "words"), NOT_OF_COMMANDS.items())
def test_what_is_left_out_is_still_there(name, words):
    texts = sentences()
    assert not words or any(n == name and words in t for n, t in texts), name


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("hold 5 of them (hold={name: value}), or lock them", "hold 5 of them (--hold NAME=VALUE), or lock them"),
        ("name it, with root='arm'", "name it, with --root arm"),
        ("(lenient_limits=True reads it so)", "(--lenient-limits reads it so)"),
        ("needs tolerance=(1e-05, 0.002)", "needs --tolerance 1e-05,0.002"),
        ("name by package_dirs a folder", "name by --package-dir a folder"),
        ("'A' = 0.3 is known", "'A' = 0.3 is known"),
    ],
)
def test_words(said: str, words: str):
    assert in_options(said) == words
    assert data_in_options({"status": [said], "q": [1.0, 2.0], "root='arm'": said}) == {
        "status": [words],
        "q": [1.0, 2.0],
        "root='arm'": words,
    }


def test_every_word_is_said_by_the_library():
    texts = [t for _, t in sentences()]
    for pattern, _ in WORDS:
        if "root=" in pattern:
            pattern = r"\broot=1"  # a name in quotes, which is put in
        assert any(re.search(pattern, t) for t in texts), pattern


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
    assert at_home(given) == wanted


FAILING = [
    ["trace", "puma560"],
    ["trace", "four_bar", "--hold", "A=1", "--hold", "B=0"],
    ["ik", "STILL", "--frame", "c", "--target", "0,0.5,0"],
    ["ik", "STILL", "--frame", "c", "--target", "0,0.5,0", "--all"],
    ["ik", "two_link", "--frame", "tip", "--target", "0.71234,0.31234,0.5"],
    ["info", "SWAPPED"],
    ["info", "XACRO"],
    ["info", "CIRCLE"],
    ["info", "four_bar", "--root", "x"],
    ["info", "four_bar", "--lenient-limits"],
    ["assemble", "four_bar", "A=0.3", "--branch", "+-+"],
    ["dof", "four_bar", "--q", "A=9,B=9,C=9,D=9"],
    ["plan", "four_bar", "--frame", "coupler"],
    ["ik", "stewart", "--frame", "platform", "--target", "0,0,9,0,0,0", "--task", "orientation", "--all"],
]
ROBOT = (
    '<robot name="r"><link name="a"/><link name="b"/><link name="c"/><joint name="j" type="revolute"><parent link="a"/>'
    '<child link="b"/><axis xyz="0 0 1"/>{}</joint><joint name="k" type="fixed"><parent link="b"/><child link="c"/>'
    '<origin xyz="0.5 0 0"/></joint></robot>'
)
FILES = {
    "STILL": ROBOT.format('<limit effort="1" velocity="1"/>'),
    "SWAPPED": ROBOT.format('<limit effort="1" velocity="1" lower="1" upper="-1"/>'),
    "XACRO": ROBOT.format('<limit effort="${1}" velocity="1"/>'),
    "CIRCLE": ROBOT.format("").replace(
        "</robot>", '<joint name="l" type="fixed"><parent link="c"/><child link="a"/></joint></robot>'
    ),
}


@pytest.mark.parametrize("json", [False, True], ids=["text", "json"])
@pytest.mark.parametrize("words", FAILING, ids=" ".join)
def test_failures_are_reported_in_options(words: list[str], json: bool, tmp_path):
    for name, text in FILES.items():
        (tmp_path / f"{name}.urdf").write_text(text)
    given = [str(tmp_path / f"{w}.urdf") if w in FILES else w for w in words]
    result = Result(*given, *["--json"] * json)
    said = (result.out + result.err).replace(str(tmp_path), "")
    assert result.code and not PYTHON.search(said), said
