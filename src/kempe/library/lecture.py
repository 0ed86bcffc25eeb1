"""The lecture in the terminal: the sections of its page, and the output of their code."""

from __future__ import annotations

import ast
import contextlib
import io
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kempe.errors import InputError, format_value

HERE = Path(__file__).parent

CELL = re.compile(
    r"^```python\n(.*?)^```\n(?:\n^```text\n.*?^```\n)?((?:\n^!\[[^\n]*\n)*)",
    re.DOTALL | re.MULTILINE,
)
"""A block of code with what the page shows below it: its output and its pictures."""

SOLUTION = re.compile(r"<details><summary>Solution</summary>(.*?)</details>", re.DOTALL)
"""The solution of the exercise of a section, which the page folds away."""

WIDTH = 100
"""Columns of the text."""

MARKUP = (
    (r"<!--.*?-->", ""),
    (r"\[([^]]*)\]\((https?://[^)]*)\)", r"\1 (\2)"),
    (r"\[([^]]*)\]\(([^)]*)\)", r"\1 (docs/\2)"),
    (r"\*\*(.*?)\*\*|\*(\S.*?\S)\*", r"\1\2"),
    (r"`(.*?)`", r"\1"),
)
"""What marks up the text of the page, and what stands in the terminal."""

FORMULAS = (
    (r"\\(?:mathbb|mathcal|mathrm)\{(\w+)\}", r"\1"),
    (r"([_^])\{(\w+)_(\w+)\}", r"\1{\2\3}"),
    (r"\{\}\^(\w)|\{\}\^\{([^{}]*)\}", r"\1\2"),
    (r"\\begin\{bmatrix\} *(.*?) *\\end\{bmatrix\}", r"[\1]"),
    (r" *\\\\ *", "; "),
    (r" & ", ", "),
    (r"\\dot (\w)", r"d\1/dt"),
    (r"\\[,;]|\\quad", " "),
    (r"\\times", "x"),
    (r"\\geq", ">="),
    (r"\\leq", "<="),
    (r"\\neq", "!="),
    (r"\\notin", "not in"),
    (r"\\mapsto", "->"),
    (r"\\dots", "..."),
    (r"\\\|", "|"),
    (r"\\Sigma", "S"),
    (r"\\Delta *", "d"),
    (r"\\([a-z]+)", r"\1"),
    (r"([_^])\{([^{}]*)\}", r"\1\2"),
    (r" +", " "),
)
"""TeX of the page's formulas, and what stands for it, in this order."""


@dataclass(frozen=True)
class Cell:
    """A cell of code of the page; with `picture` its last line draws."""

    code: str
    picture: bool = False


@dataclass(frozen=True)
class Section:
    """A section of the lecture: number (from 1), title, texts and cells, and those of the solution."""

    number: int
    title: str
    parts: tuple[str | Cell, ...]
    solution: tuple[str | Cell, ...] = ()


def read_page() -> str:
    """Read the page of the lecture as Markdown; in an installed package it is beside the models."""
    packed = HERE / "lecture.md"
    source = packed if packed.is_file() else HERE.parents[2] / "docs" / "lecture.md"
    return source.read_text(encoding="utf-8")


def read_sections() -> tuple[Section, ...]:
    """Read the sections in the lecture's order. Each one runs without the others."""
    head, *rest = re.split(r"^## ", read_page(), flags=re.MULTILINE)
    first = [Cell(code, bool(pictures)) for code, pictures in CELL.findall(head)]
    out: list[Section] = []
    for number, text in enumerate(rest, 1):
        title, _, body = text.partition("\n")
        parts = _split_parts(SOLUTION.sub("", body))
        solution = [x for folded in SOLUTION.findall(body) for x in _split_parts(folded)]
        out.append(Section(number, title.strip(), (*first, *parts), tuple(solution)))
    return tuple(out)


def _split_parts(body: str) -> list[str | Cell]:
    """Split Markdown into plain texts and cells of code."""
    pieces = CELL.split(body)
    parts: list[str | Cell] = [format_plain_text(pieces[0])]
    for code, pictures, after in zip(pieces[1::3], pieces[2::3], pieces[3::3], strict=True):
        parts += [Cell(code, bool(pictures)), format_plain_text(after)]
    return [x for x in parts if x]


def choose_sections(number: int | None) -> tuple[Section, ...]:
    """Return all sections, or the one of this number. Errors: `InputError` with the titles."""
    every = read_sections()
    if number is None:
        return every
    if number not in range(1, len(every) + 1):
        titles = "; ".join(f"{x.number} {x.title}" for x in every)
        raise InputError(f"section is {format_value(number)}; there are: {titles}")
    return (every[number - 1],)


def format_plain_text(text: str) -> str:
    """Format text of the page without its markup, wrapped, and formulas with plain letters."""

    def format_formula(match: re.Match[str]) -> str:
        """Format a formula with plain letters."""
        out = match[1]
        for pattern, letters in FORMULAS:
            out = re.sub(pattern, letters, out)
        return out.strip()

    for pattern, letters in MARKUP:
        text = re.sub(pattern, letters, text, flags=re.DOTALL)
    text = re.sub(r"\$(.+?)\$", format_formula, text, flags=re.DOTALL)
    paragraphs = [" ".join(x.split()) for x in re.split(r"\n\s*\n", text)]
    return "\n\n".join(textwrap.fill(x, WIDTH) for x in paragraphs if x)


def iterate_parts(section: Section, pictures: Path | None = None) -> Iterator[tuple[str, str]]:
    """Yield the parts of a section as pairs: "text", "code", its "output", or a "picture".

    The pair "solution" comes before the parts of the solution.

    Pictures are drawn where there is a folder for them, which is made. Code that needs a package
    that is not installed says so, and is left out with what depends on it.
    """
    names: dict[str, Any] = {}
    drawn = 0
    for k, part in enumerate((*section.parts, *section.solution)):
        if k == len(section.parts):
            yield "solution", "Solution"
        if isinstance(part, str):
            yield "text", part
            continue
        yield "code", part.code.rstrip()
        drawn += part.picture
        to = pictures / f"{section.number:02d}_{drawn}.png" if pictures and part.picture else None
        if out := run_cell(part, names, to):
            yield "output", out
        if part.picture:
            yield "picture", str(to) if to else "--pictures FOLDER draws it"


def run_cell(cell: Cell, names: dict[str, Any], picture: Path | None = None) -> str:
    """Run a cell and return its printed output with the value of its last line. Its picture is
    written to the file `picture`.
    """
    tree = ast.parse(cell.code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        try:
            exec(compile(tree, "lecture", "exec"), names)
            if isinstance(last, ast.Expr) and (picture or not cell.picture):
                value = eval(compile(ast.Expression(last.value), "lecture", "eval"), names)
                if picture:
                    _save_figure(value, picture)
                elif value is not None:
                    print(value)
        except ImportError as error:  # an extra that is not installed
            names["left out"] = True
            print(f"left out: {error}")
        except NameError as error:
            if "left out" not in names:
                raise
            print(f"left out: {error}")
    return printed.getvalue().rstrip("\n")


def add_prompts(code: str) -> str:
    """Format code as typed: `>>>` before each statement, `...` before its further lines."""
    begins = {node.lineno for node in ast.parse(code).body}
    return "\n".join(
        f"{'>>>' if i in begins else '...'} {line}".rstrip()
        for i, line in enumerate(code.split("\n"), 1)
    )


def _save_figure(axes: Any, path: Path) -> None:
    """Write the figure of axes, or of the first of several, to a file."""
    while not hasattr(axes, "figure"):
        axes = axes[0]
    path.parent.mkdir(parents=True, exist_ok=True)
    axes.figure.savefig(path, dpi=150, bbox_inches="tight")
