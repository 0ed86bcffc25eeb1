"""Writes docs/trust.md from docs/claims.toml: `python docs/trust_page.py`.

A test fails where the page is stale, where a claim does not stand on its page, and where it names
no hunt.
"""

from __future__ import annotations

import ast
import json
import re
import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
HEAD = """\
# What has been hunted

<!-- Written by docs/trust_page.py from docs/claims.toml; do not edit. -->

A sentence that says *every*, *never*, *all* or *none* is false if one counter-example exists. This page lists such
sentences of the documentation with the tests that look for a counter-example. A *hunt* draws its cases at random and
judges them by something else than the code that it tests: another library, a closed form, brute force. A *property* is
a test by Hypothesis, which shrinks the counter-example that it finds. A *battery* goes through a list of cases, such as
all joint types or all shipped models. None of them is a proof: they say where somebody has looked.

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


class Claim(NamedTuple):
    """A general sentence of a page, in one line, and the tests that hunt it
    (`tests/path/test_file.py::test_name`).
    """

    page: str
    sentence: str
    tests: tuple[str, ...]


def claims() -> list[Claim]:
    """The claims of docs/claims.toml."""
    found = tomllib.loads((DOCS / "claims.toml").read_text(encoding="utf-8"))["claim"]
    return [Claim(c["page"], c["sentence"], tuple(c["tests"])) for c in found]


@cache
def tests_of(path: Path) -> dict[str, ast.FunctionDef]:
    """The tests of a file by name."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {
        n.name: n
        for n in tree.body
        if isinstance(n, ast.FunctionDef) and n.name.startswith("test_")
    }


def kind(test: str) -> str:
    """What a test is: a hunt, a property, a battery; empty if it is none of these or does not
    exist.
    """
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
    for claim in claims():
        path = ROOT / claim.page
        name = (
            path.name
            if path.stem == "README"
            else f"[{path.stem}]({path.relative_to(DOCS).as_posix()})"
        )
        said = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", claim.sentence).replace("|", "\\|")
        tests = "<br>".join(f"`{t.removeprefix('tests/')}` ({kind(t)})" for t in claim.tests)
        lines.append(f"| {name} | {said} | {tests} |\n")
    return HEAD + "".join(lines) + mutants()


def mutants() -> str:
    """What `tests/mutants.py --write` found: how many were killed, and why the others were not."""
    path = ROOT / "docs" / "mutants.json"
    if not path.is_file():
        return ""
    found = json.loads(path.read_text(encoding="utf-8"))
    areas = {**found["areas"]}
    areas["all"] = {
        head: sum(row[head] for row in areas.values()) for head in next(iter(areas.values()))
    }
    lines = [
        "| area | " + " | ".join(areas["all"]) + " | share killed |\n",
        "|---" * (len(areas["all"]) + 2) + "|\n",
    ]
    for name, row in areas.items():
        share = f"{100 * row['killed'] / max(1, row['drawn']):.1f} %"
        lines.append(f"| {name} | " + " | ".join(map(str, row.values())) + f" | {share} |\n")
    lines += ["\n| survived | change | reason |\n", "|---|---|---|\n"]
    for s in found["survivors"]:
        cells = (
            f"`{s['module']}` {s['function']}",
            f"`` {s['before']} `` → `` {s['after']} ``",
            s["reason"],
        )
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n")
    return MUTANTS.format(seed=found["seed"], count=areas["all"]["drawn"]) + "".join(lines)


if __name__ == "__main__":
    Path(__file__).with_name("trust.md").write_text(page(), encoding="utf-8")
