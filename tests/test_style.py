"""Sizes, docstrings and types: what keeps the code readable, as numbers."""

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

MODULE_LINES, FUNCTION_LINES = 400, 60

LONG_MODULES: dict[str, str] = {}
LONG_FUNCTIONS: dict[tuple[str, str], str] = {}
"""Exceptions, each with its reason."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def file(path: Path) -> str:
    return path.relative_to(SOURCE).as_posix()


def functions(tree: ast.AST) -> Iterator[Function]:
    """All functions and methods, nested ones too."""
    return (n for n in ast.walk(tree) if isinstance(n, Function))


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
def test_modules_are_short(path):
    lines = len(path.read_text().splitlines())
    assert lines <= MODULE_LINES or file(path) in LONG_MODULES, f"{lines} lines"


@every_module
def test_functions_are_short(path):
    for function in functions(sources.tree(path)):
        lines = (function.end_lineno or 0) - function.lineno + 1
        assert lines <= FUNCTION_LINES or (file(path), function.name) in LONG_FUNCTIONS, (
            f"{function.name}: {lines} lines"
        )


def test_exceptions_are_needed():
    for name in LONG_MODULES:
        assert len((SOURCE / name).read_text().splitlines()) > MODULE_LINES, name
    long = {SOURCE / name for name, _ in LONG_FUNCTIONS}
    names = {(file(p), f.name) for p in long for f in functions(sources.tree(p))}
    assert set(LONG_FUNCTIONS) <= names


@every_module
def test_all_that_is_public_is_documented(path):
    tree = sources.tree(path)
    if path.read_text().strip():
        assert ast.get_docstring(tree), "the module says what it is for"
    for node in public(tree):
        text = ast.get_docstring(node)
        assert text, f"{node.name} has no docstring"
        first = text.splitlines()[0]
        assert first.strip() and first.rstrip()[-1] in ".:;,?)`…" or len(first) > 60, f"{node.name}: {first!r}"


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

DIALECT = re.compile(
    r"(?<![a-z])(?:asked|unasked|told|halls?|desks?|employ(?:s|ed)?|fetch(?:es|ed)?)(?![a-z])|(?-i:Nothing;)",
    re.IGNORECASE,
)
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").partition("{glossary}\n")[2].partition("```")[0]
TERMS = re.findall(r"^\S.*", GLOSSARY, re.MULTILINE)


def test_the_glossary_is_a_list_that_is_overlooked():
    """In alphabetical order, each term once with one meaning, about sixty."""
    assert sorted(set(TERMS), key=str.lower) == TERMS and 50 <= len(TERMS) <= 75
    meanings = re.split(r"^\S.*\n", GLOSSARY, flags=re.MULTILINE)[1:]
    assert len(meanings) == len(TERMS) and all(re.fullmatch(r"  \S.+\.\s*", m, re.DOTALL) for m in meanings)
    assert not DIALECT.search(GLOSSARY)


WRITTEN = [
    p for folder in ("src", "docs", "tests", "benchmarks", "native") for p in sorted((ROOT / folder).rglob("*"))
    if p.suffix in (".py", ".md", ".toml") and "_build" not in p.parts and p != Path(__file__)
]  # fmt: skip


@sources.each([*WRITTEN, *ROOT.glob("*.md")], ROOT)
def test_words_are_those_of_the_field(path):
    """Names, comments, messages and pages have none of the words that once meant something in this code only."""
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        assert not DIALECT.search(line), f"line {number}: {line.strip()}"


@cache
def prose() -> str:
    """All pages but the glossary, and all docstrings of modules, classes and functions."""
    pages = [p.read_text(encoding="utf-8") for p in (ROOT / "docs").glob("*.md") if p.name != "glossary.md"]
    nodes = (n for p in MODULES for n in sources.nodes(p))
    return "\n".join([*pages, *(ast.get_docstring(n) or "" for n in nodes
                                if isinstance(n, (ast.Module, ast.ClassDef, ast.FunctionDef)))])  # fmt: skip


@pytest.mark.parametrize("term", TERMS)
def test_terms_of_the_glossary_are_used(term):
    """In pages or docstrings."""
    pattern = re.compile(r"(?<![\w-])" + re.escape(term).replace(r"\ ", r"\s+") + r"s?(?![\w-])", re.IGNORECASE)
    assert pattern.search(prose())


# ---- first lines

VERBS = """
    add analyse answer append apply arrange ask begin call check close collect combine compare compute convert copy
    count declare divide do draw drop end exchange exit fill find follow give go hold join judge keep let list make mark
    measure move note open optimise overwrite pin place print put raise read record refuse replace restore run save say
    scale search set show solve sort start stop take tell turn walk warn write
""".split()
"""What a function does that returns nothing."""


def returns_nothing(function: Function, path: Path) -> bool:
    """Whether a function is annotated to return None; in kernels, which have no annotations, whether it does."""
    if function.returns is not None or not file(path).startswith("kernels/"):
        return function.returns is not None and ast.unparse(function.returns) == "None"
    kinds = (ast.Return, ast.Yield, ast.YieldFrom)
    return not any(isinstance(n, kinds) and n.value is not None for n in ast.walk(function))


def first_lines(path: Path) -> Iterator[tuple[Function | ast.ClassDef, str]]:
    for node in sources.nodes(path):
        if isinstance(node, (*Function.__args__, ast.ClassDef)) and (text := ast.get_docstring(node)):
            yield node, text.splitlines()[0]


@every_module
def test_functions_that_return_nothing_say_what_they_do(path):
    for node, line in first_lines(path):
        if isinstance(node, Function) and returns_nothing(node, path):
            assert re.match(r"\w*", line)[0].lower() in VERBS, f"{node.name}: {line!r} begins with no verb"


@every_module
def test_first_lines_are_sentences(path):
    """Of three words at least; what a line says is not left to the one before it."""
    for node, line in first_lines(path):
        assert len(re.findall(r"[\w'`]+", line)) > 2, f"{node.name}: {line!r}"
        assert line[0] not in "-,;.)" and not line.startswith(("And ", "But ")), f"{node.name}: {line!r}"
