"""The pages tell the truth: their code runs, their outputs are what comes out, their links lead somewhere."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import itertools
import re
import shlex
from pathlib import Path
from typing import NamedTuple

import pytest

from kempe.errors import KempeError, MissingExtraError

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])
FENCE = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
COUNTS = re.compile(r"\(\d+ steps?, \d+ starts?\)")
NUMBER = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?|-?\d+")
README_COMMAND = re.compile(r"\.venv/bin/kempe ([^\n]*)")

pages = pytest.mark.parametrize("path", PAGES, ids=lambda p: p.stem)


class Block(NamedTuple):
    """A fenced block: what its first line says after the backticks, its text, the line where that starts."""

    kind: str
    text: str
    line: int


def blocks(path: Path) -> list[Block]:
    page = path.read_text(encoding="utf-8")
    return [Block(m[1].strip(), m[2], page.count("\n", 0, m.start(2)) + 1) for m in FENCE.finditer(page)]


def is_code(block: Block) -> bool:
    return block.kind in ("python", "{code-cell} python", "{code-cell} ipython3", "{code-cell}")


def run(path: Path, block: Block, names: dict[str, object]) -> str:
    """What a block prints. A cell tagged `raises-exception` must raise; one that needs an absent extra skips."""
    source = "\n" * (block.line - 1) + re.sub(r"^:\w+:.*$", "", block.text, flags=re.MULTILINE)
    must_raise = re.search(r"^:tags:.*raises-exception", block.text, re.MULTILINE)
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), pytest.raises(KempeError) if must_raise else contextlib.nullcontext():
            exec(compile(source, str(path), "exec"), names)
    except MissingExtraError as error:
        pytest.skip(str(error))
    return printed.getvalue()


def same_output(got: str, shown: str) -> bool:
    """Whether two outputs have the same words, and numbers that agree; counts of steps may depend on the processor."""
    got, shown = COUNTS.sub("", got), COUNTS.sub("", shown)

    def words(text: str) -> list[str]:
        return NUMBER.sub("#", text).split()

    numbers = ([float(x) for x in NUMBER.findall(text)] for text in (got, shown))
    return words(got) == words(shown) and all(abs(a - b) <= 1e-5 for a, b in zip(*numbers, strict=True))


@pages
def test_code_runs(path, tmp_path, monkeypatch):
    code = [b for b in blocks(path) if is_code(b)]
    if not code:
        pytest.skip("no code")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    for block in code:
        run(path, block, names)


def test_output_in_the_readme(tmp_path, monkeypatch):
    """Each Python block of the README that is followed by a text block prints that text."""
    monkeypatch.chdir(tmp_path)
    found, names = blocks(ROOT / "README.md"), {"__name__": "__main__"}
    compared = 0
    for block, after in itertools.pairwise([*found, Block("", "", 0)]):
        if is_code(block):
            printed = run(ROOT / "README.md", block, names)
            if after.kind == "text":
                compared += 1
                assert same_output(printed, after.text), f"line {after.line}: it prints\n{printed}"
    assert compared


def test_first_command_of_the_readme(tmp_path, monkeypatch):
    """The command that does the main job prints what the README shows beneath it."""
    from typer.testing import CliRunner

    from kempe.cli import app

    found = blocks(ROOT / "README.md")
    at = next(i for i, b in enumerate(found) if README_COMMAND.search(b.text))
    command = README_COMMAND.search(found[at].text)
    assert command is not None
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, shlex.split(command[1]), catch_exceptions=False)
    assert result.exit_code == 0
    assert same_output(result.stdout, found[at + 1].text), result.stdout


def test_figures_of_the_readme_are_those_of_the_benchmark():
    """Each measured number of the README stands in benchmarks/results.md: copy them anew after a run."""
    results = (ROOT / "benchmarks" / "results.md").read_text(encoding="utf-8")
    measured = {cell.strip() for line in results.splitlines() for cell in line.split("|")}
    section = (ROOT / "README.md").read_text(encoding="utf-8").partition("## How fast")[2].partition("\n## ")[0]
    rows = [line.split("|")[2:-1] for line in section.splitlines() if line.startswith("|")][2:]
    figures = [cell.split()[0] for row in rows for cell in row if cell.strip()]
    assert figures
    assert [x for x in figures if x not in measured] == []


@pages
def test_links_lead_somewhere(path):
    for target in LINK.findall(FENCE.sub("", path.read_text(encoding="utf-8"))):
        if "://" in target or target.startswith("mailto:"):
            continue
        file, _, heading = target.partition("#")
        to = (path.parent / file).resolve() if file else path
        assert to.exists(), f"{path.name} links to {target}"
        if heading:
            assert heading in headings(to), f"{path.name} links to {target}"


def headings(path: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub and MyST make them."""
    lines = re.findall(r"^#+ (.*)$", FENCE.sub("", path.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", line.lower()).strip().replace(" ", "-") for line in lines}


def test_every_page_is_in_the_table_of_contents():
    index = ROOT / "docs" / "index.md"
    listed = [
        line for b in blocks(index) if b.kind == "{toctree}" for line in b.text.splitlines()
        if line and not line.startswith(":")
    ]  # fmt: skip
    assert sorted(listed) == sorted(p.stem for p in PAGES if p.parent == index.parent and p != index)


def test_joints_page_is_up_to_date():
    spec = importlib.util.spec_from_file_location("joints_page", ROOT / "docs" / "joints_page.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    shown = (ROOT / "docs" / "joints.md").read_text(encoding="utf-8")
    assert shown == module.page(), "run  python docs/joints_page.py"
