"""What the README says works as it is written there, and with the lowest versions that
pyproject.toml allows.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from copies import of_all_processes, once
from test_docs import README_COMMAND, blocks, same_output

from kempe.cli import app

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = ("view", "symbolic", "xacro")
TESTERS = ("pytest", "pytest-xdist", "hypothesis")
"""What the tests of `QUICK` need."""
QUICK = (
    "test_spatial.py",
    "test_calls.py",
    "test_cli.py",
    "views/test_plots.py",
    "description/test_urdf.py",
)
"""A part of these tests that runs in seconds and sees every package."""
FOUND = blocks(ROOT / "README.md")
RUN = """
import contextlib, io, json, sys
names, out = {"__name__": "__main__"}, []
for code in json.loads(sys.stdin.read()):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, names)
    out.append(printed.getvalue())
print(json.dumps(out))
"""
"""Runs pieces of code one after the other, and prints what each printed."""
MISSING = """
import kempe
try:
    kempe.load("two_link").symbolic.fk("e")
except kempe.KempeError as error:
    print(error)
"""
THERE = (
    "import importlib.metadata as m, json, sys; print(json.dumps({n: m.version(n) for n in "
    "sys.argv[1:]}))"
)
MAIN = "from kempe.cli import main; main()"

slow = pytest.mark.slow
needs_linux = pytest.mark.skipif(sys.platform != "linux", reason="other systems are untested")


def lowest() -> dict[str, str]:
    """The lowest versions that are allowed, by package: of what Kempe needs, of its extras and of
    the tests.
    """
    extras = PROJECT["optional-dependencies"]
    texts = [*PROJECT["dependencies"], *itertools.chain(*(extras[e] for e in EXTRAS))]
    texts += [t for t in extras["test"] if re.match(r"[\w-]+", t)[0] in TESTERS]  # type: ignore[index]
    pairs = (re.fullmatch(r"([\w-]+)>=([\d.]+)", text) for text in texts)
    return {m[1]: m[2] for m in pairs if m is not None}


def environment() -> dict[str, str]:
    """The environment, without what would lead to this Kempe."""
    keep = {
        k: v for k, v in os.environ.items() if not k.startswith(("KEMPE_", "PYTHON", "PYTEST_"))
    }
    keep["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{keep['PATH']}"
    return keep | {"PIP_DISABLE_PIP_VERSION_CHECK": "1"}


def done(command: object, cwd: Path, text: str = "") -> str:
    """What a command prints; it must succeed."""
    shell = isinstance(command, str)
    arguments = command if shell else list(map(str, command))  # type: ignore[call-overload]
    run = subprocess.run(
        arguments,
        shell=shell,
        cwd=cwd,
        env=environment(),
        input=text,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, f"{command}\n{run.stdout[-3000:]}\n{run.stderr[-3000:]}"
    return run.stdout


def copied(to: Path) -> None:
    """A clone of the sources with their kernels, in which the first command of the README has been
    run.

    That kernels are compiled where there are none, test_wheel.py shows.
    """
    leave = shutil.ignore_patterns("__pycache__", ".*", "dist", "build", "_build")
    shutil.copytree(ROOT, to / "clone", ignore=leave)
    first = next(b for b in FOUND if README_COMMAND.search(b.text))
    (to / "printed").write_text(done(first.text, to / "clone"))


def floored(to: Path, clone: Path) -> None:
    """An environment with the lowest versions, and the Kempe that was built in the clone."""
    done([sys.executable, "-m", "venv", to / "env"], to)
    python = to / "env" / "bin" / "python"
    done(
        [
            python,
            "-m",
            "pip",
            "install",
            "--no-compile",
            *(f"{name}=={version}" for name, version in lowest().items()),
        ],
        to,
    )
    (site,) = (to / "env").glob("lib/python*/site-packages")
    (built,) = clone.glob(".venv/lib/python*/site-packages")
    for part in built.glob("kempe*"):
        shutil.copytree(part, site / part.name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return of_all_processes(tmp_path_factory)


@pytest.fixture(scope="module")
def clone(folder) -> Path:
    return once(folder / "readme", copied) / "clone"


@pytest.fixture(scope="module")
def floors(folder, clone) -> Path:
    """The interpreter of the environment with the lowest versions."""
    return once(folder / "floors", lambda to: floored(to, clone)) / "env" / "bin" / "python"


def readme_prints(python: Path, cwd: Path) -> None:
    """Each piece of Python in the README runs, after those before it, and prints what is shown."""
    code = [b for b in FOUND if b.kind == "python"]
    printed = json.loads(done([python, "-c", RUN], cwd, json.dumps([b.text for b in code])))
    for block, text in zip(code, printed, strict=True):
        assert same_output(text, block.shown), f"line {block.line}: it prints\n{text}"


@slow
@needs_linux
def test_the_first_command_of_the_readme(clone):
    """As written, in a fresh clone: it makes an environment, installs Kempe, and prints what is
    shown.
    """
    at = next(i for i, b in enumerate(FOUND) if README_COMMAND.search(b.text))
    printed = (clone.parent / "printed").read_text()
    assert same_output(printed[printed.index("reached:") :], FOUND[at + 1].text), printed


@slow
@needs_linux
def test_the_python_of_the_readme(clone):
    readme_prints(clone / ".venv" / "bin" / "python", clone)
    assert (clone / "four_bar.gif").stat().st_size > 1000


@slow
@needs_linux
def test_what_is_missing_is_installed_by_its_hint(clone):
    """sympy is no part of what the README installs: the hint names what pip finds, from a clone as
    from a wheel.
    """
    python = clone / ".venv" / "bin" / "python"
    said = done([python, "-c", MISSING], clone)
    command = shlex.split(re.search(r"pip (install '[^']+')", said)[1])  # type: ignore[index]
    assert command[1] == f"sympy>={lowest()['sympy']}"
    assert "Would install" in done([python, "-m", "pip", *command, "--dry-run"], clone)


@slow
@needs_linux
def test_the_lowest_versions_are_those_that_are_there(floors):
    there = json.loads(done([floors, "-c", THERE, *lowest()], floors.parent))
    for name, version in lowest().items():
        assert (there[name] + ".0.0").startswith(version + "."), f"{name} {there[name]}"
    assert len(there) >= 10


@slow
@needs_linux
@pytest.mark.parametrize(
    "name", ["", *(c.name or c.callback.__name__ for c in app.registered_commands if c.callback)]
)
def test_help_with_the_lowest_versions(floors, name):
    printed = done([floors, "-c", MAIN, *([name] if name else []), "--help"], floors.parent)
    assert "Usage:" in printed and "--help" in printed and len(printed) > 300


@slow
@needs_linux
def test_the_readme_with_the_lowest_versions(floors, tmp_path):
    readme_prints(floors, tmp_path)
    at = next(i for i, b in enumerate(FOUND) if README_COMMAND.search(b.text))
    command = README_COMMAND.search(FOUND[at].text)
    assert command is not None
    assert same_output(
        done([floors, "-c", MAIN, *shlex.split(command[1])], tmp_path), FOUND[at + 1].text
    )


@slow
@needs_linux
def test_a_part_of_the_tests_with_the_lowest_versions(floors, tmp_path):
    files = [ROOT / "tests" / name for name in QUICK]
    command = [
        floors,
        "-m",
        "pytest",
        "-n",
        "0",
        "-x",
        "-p",
        "no:cacheprovider",
        "--rootdir",
        ROOT,
        *files,
    ]
    assert re.search(r"\d+ passed", done(command, tmp_path))


def test_the_lowest_versions_are_read():
    """Each requirement has one; scipy's and matplotlib's can be installed with numpy's."""
    found = lowest()
    extras = {"matplotlib", "sympy", "xacrodoc", "viser", "trimesh", "pycollada"}
    assert {"numpy", "scipy", "typer", "rich", *extras, *TESTERS} == set(found)
