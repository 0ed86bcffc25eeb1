"""Tests that can fail: what holds for every test function, by the syntax tree."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import sources

HERE = Path(__file__).parent
FILES = [
    p
    for folder in (HERE, HERE.parent / "benchmarks" / "tests")
    for p in sorted(folder.rglob("*.py"))
]
every_file = sources.each([p for p in FILES if p.stem.startswith("test_")], HERE.parent)


def functions_of(path: Path) -> list[ast.FunctionDef]:
    return [
        n
        for n in sources.tree(path).body
        if isinstance(n, ast.FunctionDef) and n.name.startswith("test_")
    ]


def own(node: ast.AST) -> Iterator[ast.AST]:
    """What a node holds, but for functions and classes in it."""
    for child in ast.iter_child_nodes(node):
        yield child
        if not isinstance(child, (ast.FunctionDef, ast.Lambda, ast.ClassDef)):
            yield from own(child)


def name_of(call: ast.Call) -> str:
    """The function or method that is called."""
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def called(node: ast.AST) -> set[str]:
    """Names of functions and methods that are called anywhere in it."""
    return {name_of(n) for n in ast.walk(node) if isinstance(n, ast.Call)}


def is_assertion(node: ast.AST) -> bool:
    """An assert, an expected exception or warning, or a call of `numpy.testing` or of a mock."""
    if isinstance(node, ast.Raise):
        return "AssertionError" in ast.unparse(node)
    name = name_of(node) if isinstance(node, ast.Call) else ""
    return (
        isinstance(node, ast.Assert)
        or name in ("raises", "warns", "fail")
        or name.startswith("assert_")
    )


@cache
def helpers() -> set[str]:
    """Names of functions of the tests that assert something, by themselves or by what they call."""
    functions = [
        n for path in FILES for n in ast.walk(sources.tree(path)) if isinstance(n, ast.FunctionDef)
    ]
    found = {f.name for f in functions if asserts_itself(f)}
    calls = {f: called(f) for f in functions if f.name not in found}
    while more := {f.name for f, names in calls.items() if f.name not in found and names & found}:
        found |= more
    return found


@cache
def asserts_itself(node: ast.AST) -> bool:
    """Whether something is asserted in it, and not only in what it calls."""
    return any(map(is_assertion, ast.walk(node)))


def asserts(node: ast.AST) -> bool:
    """Whether something is asserted in it."""
    return asserts_itself(node) or bool(called(node) & helpers())


@every_file
def test_every_test_asserts(path):
    assert not [f.name for f in functions_of(path) if not asserts(f)]


@every_file
def test_no_test_returns(path):
    """A test that returns has passed without testing: its cases are to be filtered, or assumed."""
    assert not [f.name for f in functions_of(path) for n in own(f) if isinstance(n, ast.Return)]


@every_file
def test_no_exception_is_swallowed(path):
    """Where an exception is one of the outcomes, that it is the right one is asserted, or the case
    is not counted.
    """
    handlers = [
        (f.name, n) for f in functions_of(path) for n in own(f) if isinstance(n, ast.ExceptHandler)
    ]
    assert not [
        name
        for name, n in handlers
        if not asserts(n) and not uses_error(n) and not called(n) & {"reject"}
    ]
    assert not [f.name for f in functions_of(path) if "suppress" in called(f)]


def uses_error(handler: ast.ExceptHandler) -> bool:
    """Whether the exception is kept, to be compared later."""
    return handler.name is not None and any(
        isinstance(n, ast.Name) and n.id == handler.name for x in handler.body for n in ast.walk(x)
    )


@every_file
def test_only_what_is_not_installed_is_skipped(path):
    calls = (n for n in sources.nodes(path) if isinstance(n, ast.Call))
    skips = [n for n in calls if ast.unparse(n.func) == "pytest.skip"]
    assert not [
        ast.unparse(n)
        for n in skips
        if not ast.unparse(n.args[0]).rstrip("'\"").endswith("is not installed")
    ]


@every_file
def test_loops_that_leave_cases_out_count_the_others(path):
    """After a loop with `continue` something is asserted, so that it was not all cases that were
    left out.
    """
    for function in functions_of(path):
        for k, statement in enumerate(function.body):
            if any(isinstance(n, ast.Continue) for n in own(statement)):
                assert any(map(asserts, function.body[k + 1 :])), (
                    f"{function.name}, line {statement.lineno}"
                )
