"""Docstrings, types and terms: what keeps the code readable."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import sources

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "kempe"
MODULES = sorted(SOURCE.rglob("*.py"))
every_module = sources.each(MODULES, SOURCE)

Function = ast.FunctionDef | ast.AsyncFunctionDef


def file(path: Path) -> str:
    return path.relative_to(SOURCE).as_posix()


def public(node: ast.AST) -> Iterator[ast.ClassDef | Function]:
    """Classes, functions and methods that users can name."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            overload = any("overload" in ast.unparse(d) for d in child.decorator_list)
            if child.name.startswith("_") or overload:
                continue
            yield child
            if isinstance(child, ast.ClassDef):
                yield from public(child)


@every_module
def test_all_that_is_public_is_documented(path):
    tree = sources.tree(path)
    if path.read_text().strip():
        assert ast.get_docstring(tree), "the module says what it is for"
    for node in public(tree):
        text = ast.get_docstring(node)
        assert text, f"{node.name} has no docstring"
        first = " ".join(text.split("\n\n")[0].split())
        assert first.strip() and first.rstrip()[-1] in ".:;,?)`…" or len(first) > 60, (
            f"{node.name}: {first!r}"
        )


@sources.each([p for p in MODULES if not file(p).startswith("kernels/")], SOURCE)
def test_arguments_are_typed(path):
    """But those of kernels, which are compiled for explicit signatures."""
    for function in (n for n in public(sources.tree(path)) if isinstance(n, Function)):
        arguments = function.args
        for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
            if a.arg not in ("self", "cls"):
                assert a.annotation is not None, f"{function.name}({a.arg})"


@every_module
def test_no_leftovers(path):
    text = path.read_text()
    for word in ("TODO", "FIXME", "XXX", "breakpoint(", "import pdb"):
        assert word not in text, word


# ---- words

GLOSSARY = (
    (ROOT / "docs" / "glossary.md")
    .read_text(encoding="utf-8")
    .partition("{glossary}\n")[2]
    .partition("```")[0]
)
TERMS = re.findall(r"^\S.*", GLOSSARY, re.MULTILINE)


def test_the_glossary_is_a_list_that_is_overlooked():
    """In alphabetical order, each term once with one meaning, about sixty."""
    assert sorted(set(TERMS), key=str.lower) == TERMS and 50 <= len(TERMS) <= 75
    meanings = re.split(r"^\S.*\n", GLOSSARY, flags=re.MULTILINE)[1:]
    assert len(meanings) == len(TERMS) and all(
        re.fullmatch(r"  \S.+\.\s*", m, re.DOTALL) for m in meanings
    )


@cache
def prose() -> str:
    """All pages but the glossary, and all docstrings of modules, classes and functions."""
    pages = [
        p.read_text(encoding="utf-8")
        for p in (ROOT / "docs").glob("*.md")
        if p.name != "glossary.md"
    ]
    nodes = (n for p in MODULES for n in sources.nodes(p))
    return "\n".join(
        [
            *pages,
            *(
                ast.get_docstring(n) or ""
                for n in nodes
                if isinstance(n, (ast.Module, ast.ClassDef, ast.FunctionDef))
            ),
        ]
    )


@pytest.mark.parametrize("term", TERMS)
def test_terms_of_the_glossary_are_used(term):
    """In pages or docstrings."""
    pattern = re.compile(
        r"(?<![\w-])" + re.escape(term).replace(r"\ ", r"\s+") + r"s?(?![\w-])", re.IGNORECASE
    )
    assert pattern.search(prose())


# ---- first lines


def first_lines(path: Path) -> Iterator[tuple[Function | ast.ClassDef, str]]:
    for node in sources.nodes(path):
        if isinstance(node, (*Function.__args__, ast.ClassDef)) and (
            text := ast.get_docstring(node)
        ):
            yield node, text.splitlines()[0]


@every_module
def test_first_lines_are_sentences(path):
    """Of three words at least; what a line says is not left to the one before it."""
    for node, line in first_lines(path):
        assert len(re.findall(r"[\w'`]+", line)) > 2, f"{node.name}: {line!r}"
        assert line[0] not in "-,;.)" and not line.startswith(("And ", "But ")), (
            f"{node.name}: {line!r}"
        )
