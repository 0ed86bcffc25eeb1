"""Docstrings, types and terms: what keeps the code readable."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

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


@every_module
def test_no_docstring_says_a_paragraph_twice(path):
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(sources.tree(path)):
        if isinstance(node, kinds):
            paragraphs = (ast.get_docstring(node) or "").split("\n\n")
            assert len(set(paragraphs)) == len(paragraphs), getattr(node, "name", "module")


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
    """In alphabetical order, each term once with one meaning."""
    assert sorted(set(TERMS), key=str.lower) == TERMS
    meanings = re.split(r"^\S.*\n", GLOSSARY, flags=re.MULTILINE)[1:]
    assert len(meanings) == len(TERMS) and all(
        re.fullmatch(r"  \S.+\.\s*", m, re.DOTALL) for m in meanings
    )
