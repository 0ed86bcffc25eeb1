"""Bad files never pass, and always say why; `docs/bad_files.md` is written from these cases.

Run this file as a program to write the page anew.
"""

from __future__ import annotations

import importlib.util
import os
import random
import re
import tempfile
from pathlib import Path

import pytest
from bad_file_cases import MJCF_CASES, SDF_CASES, TOML_CASES, URDF_CASES, Case
from hunts import some
from robots import BROKEN, good_urdf_files, urdf_files

from kempe.description.read import check_description, read_mechanism
from kempe.description.sdf_reader import read_sdf
from kempe.description.toml_reader import read_toml
from kempe.description.urdf_reader import read_urdf
from kempe.errors import PROBLEM_LIMIT, DescriptionError, KempeError

PAGE = Path(__file__).parent.parent / "docs" / "bad_files.md"
READ = [] if importlib.util.find_spec("mujoco") is None else MJCF_CASES
CASES = [*URDF_CASES, *SDF_CASES, *TOML_CASES, *READ]

INTRODUCTION = """\
# What happens to bad files

A robot file often comes from somewhere else, and many are broken. Kempe repairs nothing silently: a file either means
one system, or it is refused with its line, the thing that is wrong, and what is allowed. All problems of a file are
collected before it gives up; 20 are shown. What is legal but strange loads, with a note (`kempe info` shows notes,
`kempe check` shows problems with the line of the file and a caret).

- No DTD and no entity is ever read. A file has at most 32 MiB, its elements are nested
  at most 100 deep.
- Numbers are finite, separated by blanks, and exactly as many as the format says.
- Names of links are unique, and so are those of joints; they are not empty.
- Exactly one link is the root, and joints lead from it to all others. A second way to a link is a *loop*, and legal.
- A slip such as `orgin` for `origin` is refused, and so is what would be part of the mechanism for another reader: an
  element that decides on the motion and stands where it is not read, or whose prefix hides it, and a constraint that
  ties links. Other unknown elements directly in the robot, a link or a joint are noted, and so are unknown attributes
  of joints and their parts, and joints inside `<gazebo>`. So nothing that decides on the motion vanishes without a
  note.
- An archive, a web page, a Git LFS pointer, an SRDF, a USD scene, a mesh or a picture that was saved in place of a
  robot file is named, with what to do.
- [Files of other people](collected.md): how 1400 real ones are read.
- A prefix that is bound to `http://www.ros.org`, or to the namespace of the outermost element, changes no name.
- The version of `<robot>` is 1.0, 1.1 or 1.2, and 1.0 where it is left out; ROS refuses others, too.
- Meshes are not opened on loading. When they are drawn, only files inside the folders of the model are.
- MJCF is compiled by MuJoCo in a process with limits, which can open no file: includes are read before, from the
  folders of the model only, and meshes, textures and height fields never.
- xacro is a program, not data. It is expanded only where you ask for it, in a process with limits.

The tables below are written by the tests: each line is a file that is fed to the reader, and its answer.
"""


def answer(case: Case, folder: Path, data: bytes) -> tuple[str, KempeError | None]:
    """What reading and compiling the file says."""
    (folder / f"file{case.suffix}").write_bytes(data)
    here = os.getcwd()
    os.chdir(folder)
    try:
        mechanism = read_mechanism(f"file{case.suffix}")
        mechanism.build()
        assert case.holds(mechanism)
        return "\n".join(mechanism.notes), None
    except KempeError as error:
        return str(error), error
    finally:
        os.chdir(here)


def variants(case: Case) -> list[bytes]:
    """The file's bytes in the encodings and with the line ends in which it must be understood
    alike.
    """
    if not case.any_encoding:
        return [case.text.encode(case.encoding)]
    texts = [case.text, case.text.replace("\n", "\r\n")]
    return [
        text.encode(encoding) for text in texts for encoding in ("utf-8", "utf-8-sig", "utf-16")
    ]


ROWS = [
    pytest.param(
        case,
        id=f"{case.suffix[1:]}: {case.title}",
        marks=[pytest.mark.rest] if len(case.text) > 100_000 else [],
    )
    for case in CASES
]
"""Each file; long ones are left to the long battery."""


@pytest.mark.parametrize("case", ROWS)
def test_what_is_said(case: Case, tmp_path: Path):
    for data in variants(case):
        said, error = answer(case, tmp_path, data)
        if case.says is None:
            assert error is None, said
            assert case.note in said
            assert said.startswith(f"file{case.suffix}:") or not case.note
        else:
            is_refused_as(case, said, error)


def is_refused_as(case: Case, said: str, error: KempeError | None) -> None:
    """The pieces that the case names are said, of its file and line, with what is allowed."""
    assert isinstance(error, DescriptionError), said
    assert case.says is not None and all(piece in said for piece in case.says), said
    where = error.problems[0].where
    assert where is not None and where.file == f"file{case.suffix}"
    if case.line is not None:
        assert where.line == case.line, said
        assert "^" in error.problems[0].caret()
    for problem in error.problems[:PROBLEM_LIMIT]:
        assert problem.allowed or re.search("did you mean|there are|allowed|must", problem.message)


def test_caret_stands_under_the_place(tmp_path: Path):
    case = next(c for c in URDF_CASES if c.title == "a comma for the decimal point")
    problem = check_description(case.text).problems[0]
    line, caret = problem.caret().splitlines()
    assert line[caret.index("^") :].startswith("0 0 1,5")


def page() -> str:
    """The text of `docs/bad_files.md`."""
    out = [INTRODUCTION]
    kinds = {"URDF": URDF_CASES, "SDF": SDF_CASES, "TOML": TOML_CASES, "MJCF": READ}
    for heading, cases in kinds.items():
        out.append(f"## {heading}\n\n| in the file | what Kempe says |\n|---|---|")
        for case in cases:
            with tempfile.TemporaryDirectory() as folder:
                said, error = answer(case, Path(folder), variants(case)[0])
            said = re.sub(r"than MuJoCo [\d.]+\w*,", "than MuJoCo X.Y.Z,", said)
            lines = said.splitlines()
            shown = "<br>".join(f"`` {line.replace('|', chr(92) + '|')} ``" for line in lines[:3])
            shown += f"<br>... ({len(lines)} lines)" if len(lines) > 3 else ""
            verdict = shown if error is not None else f"loads{', noting ' + shown if said else ''}"
            out.append(f"| {case.title} | {verdict} |")
        out.append("")
    return "\n".join(out)


@pytest.mark.slow
@pytest.mark.skipif(not READ, reason="needs mujoco")
def test_page_is_true():
    assert PAGE.read_text(encoding="utf-8") == page(), (
        "run  python tests/test_bad_files.py  and commit the page"
    )


# ---- fuzzing: whatever the bytes, only errors of Kempe come out

SMALL = next(c for c in URDF_CASES if c.title == "a mimic of a mimic").text.encode()


def robot_bytes() -> bytes:
    """A real robot where the package of robots is installed, else a small one."""
    found = [path for name, path in urdf_files().items() if name.endswith("panda.urdf")]
    return found[0].read_bytes() if found else SMALL


def survives(reader, data: bytes) -> bool:
    """Whether the bytes load; raises unless they do or are refused by an error of Kempe."""
    try:
        reader(data).build()
    except KempeError as error:
        assert str(error)
        return False
    return True


def test_truncated_robots_are_refused():
    data = robot_bytes()
    rng = random.Random(1)
    end = data.rstrip().rfind(b"</robot>") + len(b"</robot>")
    for cut in [rng.randrange(end) for _ in range(200)]:
        assert not survives(read_urdf, data[:cut]), f"cut at {cut}"


def test_damaged_robots_never_crash():
    data = robot_bytes()
    rng = random.Random(2)
    for _ in range(150):
        damaged = bytearray(data)
        for _ in range(rng.choice([1, 1, 2, 5])):
            damaged[rng.randrange(len(damaged))] = rng.choice(
                [rng.randrange(256), rng.randrange(32, 127)]
            )
        survives(read_urdf, bytes(damaged))


def test_shuffled_pieces_never_crash():
    rng = random.Random(3)
    pieces = [c.text for c in URDF_CASES if len(c.text) < 5000]
    for _ in range(300):
        a = rng.choice(pieces)
        b = rng.choice(pieces)
        survives(
            read_urdf, (a[: rng.randrange(len(a) + 1)] + b[rng.randrange(len(b) + 1) :]).encode()
        )


def test_damaged_models_never_crash():
    rng = random.Random(5)
    texts = [c.text for c in SDF_CASES if 0 < len(c.text) < 2000]
    marks = [*"<>/&\"'. 1-:", "nan", "world", "base", "::", "</joint>", "<pose>1 0 0 0 0 0</pose>"]
    for _ in range(600):
        text = rng.choice(texts)
        for _ in range(rng.choice([1, 1, 2, 3])):
            at = rng.randrange(len(text) + 1)
            text = text[:at] + rng.choice(marks) + text[at + rng.choice([0, 0, 1, 3]) :]
        survives(read_sdf, text.encode())
    for _ in range(300):
        a = rng.choice(texts)
        b = rng.choice(texts)
        mixed = a[: rng.randrange(len(a) + 1)] + b[rng.randrange(len(b) + 1) :]
        survives(read_sdf, mixed.encode())


def test_damaged_tables_never_crash():
    rng = random.Random(4)
    texts = [c.text for c in TOML_CASES if 0 < len(c.text) < 2000]
    marks = [
        "[",
        "]",
        "{",
        "}",
        "=",
        '"',
        "'",
        ",",
        "\n",
        "1e999",
        "nan",
        "-inf",
        "true",
        "[1]",
        "{}",
        '""',
        "-1",
        "0",
    ]
    for _ in range(600):
        text = rng.choice(texts)
        for _ in range(rng.choice([1, 2, 3])):
            at = rng.randrange(len(text) + 1)
            text = text[:at] + rng.choice(marks) + text[at + rng.choice([0, 0, 1, 3]) :]
        survives(read_toml, text.encode())


REFUSED = {
    "ur3.urdf": (
        ":6: there is no robot in this file",
        "xacro made it from 'ur3.urdf.xacro'",
        "ur3_robot.urdf",
    ),
    "alex_psyonic_hands.urdf": (
        ":1037: joint 'Left_index_q2': it mimics joint 'index_q1', which does not exist",
        "did you mean 'Left_index_q1'",
    ),
}
"""Files of real robots that are wrong, and what is said of them."""
WRONG = {n: p for n, p in urdf_files().items() if p.name in BROKEN}


@pytest.mark.parametrize("path", some(good_urdf_files().values(), 3), ids=list(good_urdf_files()))
def test_real_robots_are_read(path: Path):
    assert read_mechanism(path).build().body_names


@pytest.mark.parametrize("path", WRONG.values(), ids=list(WRONG))
def test_wrong_files_of_real_robots_are_refused(path: Path):
    with pytest.raises(DescriptionError) as caught:
        read_mechanism(path)
    where, *more = REFUSED[path.name]
    assert str(caught.value).startswith(f"{path}{where}")
    assert all(piece in str(caught.value) for piece in more)


if __name__ == "__main__":
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(page(), encoding="utf-8")
