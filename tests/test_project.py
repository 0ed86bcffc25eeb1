"""What stands around the code agrees with it: versions, commands of workflows and hooks, forms."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = SETTINGS["project"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text()
COMMANDS = re.compile(r"^\s*(?:- )?run: (.+)$", re.M)


def test_one_version_everywhere():
    assert (
        re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.M)[1]
        == PROJECT["version"]
    )
    heading = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert heading[1] == PROJECT["version"]


def test_the_pythons_that_are_promised_are_tested():
    row = re.search(r"python: \[(.+)\]", (ROOT / ".github" / "workflows" / "tests.yml").read_text())
    tested = re.findall(r"[\d.]+", row[1])
    promised = [c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", c)]
    assert promised == tested[: len(promised)] and PROJECT["requires-python"] == f">={tested[0]}"


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda p: p.stem)
def test_workflows_run_what_the_guide_says(path):
    """Each command but an installation stands in CONTRIBUTING.md; so each can be run, and was,
    without a workflow.
    """
    commands = [
        c
        for c in COMMANDS.findall(path.read_text())
        if "pip install" not in c and "--check" not in c
    ]
    assert commands or path.stem == "wheels"
    for command in commands:
        assert command.removeprefix("python -m ") in CONTRIBUTING, command


@pytest.mark.parametrize(
    "path",
    [*WORKFLOWS, *FORMS, ROOT / ".pre-commit-config.yaml", ROOT / "CITATION.cff"],
    ids=lambda p: p.name,
)
def test_settings_can_be_read(path):
    yaml = pytest.importorskip("yaml")
    assert yaml.safe_load(path.read_text())


def test_hooks_are_the_checks_of_the_guide():
    entries = re.findall(r"entry: (.+)$", (ROOT / ".pre-commit-config.yaml").read_text(), re.M)
    assert entries == ["ruff check", "ruff format", "pyright"]
    assert all(entry in CONTRIBUTING for entry in entries)


NOT_STRICT = {
    "src/kempe/kernels": "Numba compiles it, and tells nothing of types",
    "src/kempe/views": "methods of Matplotlib and trimesh have keyword arguments without types",
    "src/kempe/tasks.py": "its names are those of a table",
    "benchmarks/kempe_bench": "it calls libraries without types",
}
"""Where pyright checks less than strictly, and why."""


def test_types_are_checked_strictly_everywhere_else():
    settings = SETTINGS["tool"]["pyright"]
    assert settings["typeCheckingMode"] == "strict" and settings["include"] == [
        "src",
        "benchmarks/kempe_bench",
    ]
    roots = {
        e["root"]
        for e in settings["executionEnvironments"]
        if any(key.startswith("report") for key in e)
    }
    modules = (p for folder in settings["include"] for p in (ROOT / folder).rglob("*.py"))
    own = {
        p.relative_to(ROOT).as_posix()
        for p in modules
        if re.search(r"^# pyright:", p.read_text(), re.M)
    }
    assert roots | own == NOT_STRICT.keys()


RUFF = Path(sys.executable).with_name("ruff")


@pytest.mark.skipif(not RUFF.exists(), reason="ruff is not installed (extra dev)")
@pytest.mark.parametrize("check", [("check",), ("format", "--check")], ids=" ".join)
def test_the_code_passes_its_hooks(check):
    done = subprocess.run([str(RUFF), *check, "-q", "."], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
