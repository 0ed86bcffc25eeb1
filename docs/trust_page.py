"""Writes docs/trust.md from the marks in README.md and docs/*.md: `python docs/trust_page.py`.

A mark is a comment after a sentence, ``<!-- hunted: tests/path/test_file.py::test_name -->``, with several tests
separated by blanks. A test fails where the page is stale and where a mark names no hunt.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FENCE = re.compile(r"^(`{3,}|:{3,})[^\n]*\n.*?^\1\s*$", re.DOTALL | re.MULTILINE)
FRONT = re.compile(r"\A---\n.*?^---\n", re.DOTALL | re.MULTILINE)
MARK = re.compile(r"<!--\s*hunted:\s*(.*?)\s*-->", re.DOTALL)
COMMENT = re.compile(r"<!--(?!\s*hunted:).*?-->", re.DOTALL)
BLOCK = re.compile(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.)\s|\||#)")
STOP = re.compile(r"(?<=[.!?])(?<!e\.g\.)(?<!\bp\.)\s+(?!<!--)(?=[^a-z])|(?<=-->)\s*(?=\S)")
HEAD = """\
# What has been hunted

<!-- Written by docs/trust_page.py from the marks in README.md and docs/*.md; do not edit. -->

A sentence that says *every*, *never*, *all* or *none* is false if one counter-example exists. So each such sentence of
these pages names the tests that look for one, in a comment of its source that readers do not see. A *hunt* draws its
cases at random and judges them by something else than the code that it tests: another library, a closed form, brute
force. A *property* is a test by Hypothesis, which shrinks the counter-example that it finds, and a *battery* goes
through a list of cases, such as all joint types or all shipped models. None of them is a proof: they say where
somebody has looked.

The tests that everybody runs take a quarter of the cases; `--hunt-times 1` takes all of them. For each change
half of them are taken. The same hunts on other cases, and on ten times as many:

```console
$ pytest --hunt-seed 7 --hunt-times 10
$ pytest --hunt-seed 7 --hunt-times 10 -m "slow or rest or hunt"
```

"""
MUTANTS = """
## Whether the tests notice

Small changes of the source (a comparison turned round, a sign, a number, an argument or a statement left out), drawn by
a seed, as many from each area, each run against the tests that reach it until one fails. Left out are texts, types,
assertions (`strict` of `zip` among them), the values of arrays without entries, defaults of arguments that are not
read, and the compiled kernels.
`python tests/mutants.py --seed {seed} -n {count}` does it again.
What was found killed is not run again where only tests were added (`--resume --again`), nor is a survivor of which the
reason is that it changes nothing: so most kills are of the tests as they were before the last ones were added.

"""


class Sentence(NamedTuple):
    """A sentence of a page: its text in one line without marks, the tests that hunt it, whether it is in a table."""

    page: str
    text: str
    tests: tuple[str, ...]
    cell: bool


def pages() -> list[Path]:
    """README.md and the pages of docs and docs/add but this one."""
    found = [*sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("add/*.md"))]
    return [ROOT / "README.md", *(p for p in found if p.name != "trust.md")]


def sentences(path: Path) -> Iterator[Sentence]:
    """The sentences of a page outside code and headings; items of lists and cells of tables are sentences, too."""
    text = FRONT.sub("", path.read_text(encoding="utf-8"))
    yield from sentences_of(COMMENT.sub("", FENCE.sub("\n\n", text)), path.relative_to(ROOT).as_posix())


def sentences_of(text: str, page: str) -> Iterator[Sentence]:
    """The sentences of Markdown without code."""
    for block in map(str.strip, BLOCK.split(text)):
        row = block.startswith("|")
        parts = re.split(r"(?<!\\)\|", block.strip("|")) if row else [] if block.startswith("#") else [block]
        for part in parts:
            for piece in STOP.split(" ".join(part.split())):
                tests = tuple(test for found in MARK.findall(piece) for test in found.split())
                if said := MARK.sub("", piece).strip():
                    yield Sentence(page, said, tests, row)


@cache
def tests_of(path: Path) -> dict[str, ast.FunctionDef]:
    """The tests of a file by name."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {n.name: n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name.startswith("test_")}


def kind(test: str) -> str:
    """What a test is: a hunt, a property, a battery; empty if it is none of these or does not exist."""
    file, _, name = test.partition("::")
    path = ROOT / file
    found = tests_of(path).get(name) if path.is_file() else None
    if found is None:
        return ""
    if "hunt" in {a.arg for a in found.args.args}:
        return "hunt"
    marks = [ast.unparse(d) for d in found.decorator_list]
    if any(m.startswith("given(") for m in marks):
        return "property"
    return "battery" if any("parametrize" in m for m in marks) else ""


def page() -> str:
    """The page as Markdown."""
    lines = ["| page | sentence | tested by |\n", "|---|---|---|\n"]
    for path in pages():
        name = path.name if path.stem == "README" else f"[{path.stem}]({path.relative_to(DOCS).as_posix()})"
        for s in sentences(path):
            if s.tests:
                said = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", s.text.removeprefix("- ")).replace("|", "\\|")
                tests = "<br>".join(f"`{t.removeprefix('tests/')}` ({kind(t)})" for t in s.tests)
                lines.append(f"| {name} | {said} | {tests} |\n")
    return HEAD + "".join(lines) + mutants()


def mutants() -> str:
    """What `tests/mutants.py --write` found: how many were killed, and why the others were not."""
    path = ROOT / "docs" / "mutants.json"
    if not path.is_file():
        return ""
    found = json.loads(path.read_text(encoding="utf-8"))
    areas = {**found["areas"]}
    areas["all"] = {head: sum(row[head] for row in areas.values()) for head in next(iter(areas.values()))}
    lines = ["| area | " + " | ".join(areas["all"]) + " | share killed |\n", "|---" * (len(areas["all"]) + 2) + "|\n"]
    for name, row in areas.items():
        share = f"{100 * row['killed'] / max(1, row['drawn']):.1f} %"
        lines.append(f"| {name} | " + " | ".join(map(str, row.values())) + f" | {share} |\n")
    lines += ["\n| survived | change | reason |\n", "|---|---|---|\n"]
    for s in found["survivors"]:
        cells = (f"`{s['module']}` {s['function']}", f"`` {s['before']} `` → `` {s['after']} ``", s["reason"])
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n")
    return MUTANTS.format(seed=found["seed"], count=areas["all"]["drawn"]) + "".join(lines)


if __name__ == "__main__":
    Path(__file__).with_name("trust.md").write_text(page(), encoding="utf-8")
