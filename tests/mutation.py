"""Mutations on the syntax tree of a module: small changes of its meaning that a test should notice.

A mutation is a node and what stands in its place. Texts are left out: docstrings, messages,
f-strings, what `__str__` gives, functions that make a sentence. So are annotations, decorators,
assertions, imports for type checking, and what changes nothing by construction: `strict` of `zip`,
whether an array without entries holds zeros or ones, defaults of arguments that a function does not
read.
"""

from __future__ import annotations

import ast
import copy
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

Function = ast.FunctionDef | ast.AsyncFunctionDef
COMPOUND = (ast.If, ast.For, ast.While, ast.Try, ast.With, ast.Match)
NEGATED: dict[type, type] = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
BOUNDARY: dict[type, type] = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
ARITHMETIC: dict[type, type] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
NAMES = {
    a: b
    for p in (
        "min max",
        "any all",
        "minimum maximum",
        "argmin argmax",
        "sin cos",
        "zeros ones",
        "floor ceil",
    )
    for a, b in (p.split(), p.split()[::-1])
}
SYMMETRIC = {
    "max",
    "min",
    "maximum",
    "minimum",
    "hypot",
    "allclose",
    "isclose",
    "gcd",
    "array_equal",
    "parallel",
}
SKIPPED = {"annotation", "returns", "decorator_list", "exc", "cause"}
SPOKEN = {"__repr__", "__str__", "_repr_html_", "__format__"}


class Site(NamedTuple):
    """One mutation of a module: its number there, where it is, what it does; `segment` is what a
    test has to reach.
    """

    number: int
    line: int
    function: str
    segment: str
    before: str
    after: str


class _Place(NamedTuple):
    """A node with its parent's field, and the function and the segment that it stands in."""

    parent: ast.AST
    field: str
    index: int | None
    node: ast.AST
    function: str
    segment: str


def is_text(node: ast.AST) -> bool:
    """Whether a node and what stands in it is a text, a type, or an assertion, such as `strict` of
    `zip`.
    """
    if isinstance(node, Function):
        spoken = node.returns is not None and ast.unparse(node.returns) in ("str", "str | None")
        return (
            node.name in SPOKEN
            or spoken
            and any(isinstance(n, ast.JoinedStr) for n in ast.walk(node))
        )
    if isinstance(node, ast.If):
        return "TYPE_CHECKING" in ast.unparse(node.test)
    if isinstance(node, ast.BinOp):
        return any(_says(n) for n in (node.left, node.right))
    if isinstance(node, ast.IfExp):
        return any(_says(n) for n in (node.body, node.orelse))
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Attribute) and (
            _says(node.func.value) or node.func.attr == "warn"
        )
    if isinstance(node, ast.keyword):
        return node.arg == "strict"
    return isinstance(node, (ast.JoinedStr, ast.Assert, ast.Import, ast.ImportFrom))


def _says(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.JoinedStr)
        or isinstance(node, ast.Constant)
        and isinstance(node.value, str)
    )


def _walk(tree: ast.Module, starts: list[tuple[list[Any], int, str]]) -> Iterator[_Place]:
    """All nodes that may be changed, in the order of the text; `starts` gets where each segment
    begins.

    A segment is a run of statements of a function of which all are reached, or none: it begins with
    a body, and after each statement that may end the function.
    """
    count: dict[str, int] = {}

    def visit(parent: ast.AST, scope: str, function: str, segment: str) -> Iterator[_Place]:
        enters = isinstance(parent, Function) and not function
        for field, value in ast.iter_fields(parent):
            if field in SKIPPED:
                continue
            inside = scope[:-1] if enters and field == "body" else function
            for i, node in enumerate(value if isinstance(value, list) else [value]):
                if (
                    inside
                    and isinstance(node, ast.stmt)
                    and (i == 0 or isinstance(value[i - 1], COMPOUND))
                ):
                    count[inside] = count.get(inside, -1) + 1
                    segment = f"{inside}:{count[inside]}"
                    starts.append((value, i, segment))
                if isinstance(node, ast.AST) and not is_text(node) and id(node) not in unread:
                    yield _Place(
                        parent, field, i if isinstance(value, list) else None, node, inside, segment
                    )
                    named = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))
                    yield from visit(
                        node, f"{scope}{node.name}." if named else scope, inside, segment
                    )

    unread = {id(x) for f in ast.walk(tree) if isinstance(f, Function) for x in _unread(f)}
    yield from visit(tree, "", "", "")


def _unread(function: Function) -> Iterator[ast.AST]:
    """Defaults of arguments that a function does not read, but takes as others of its kind do."""
    read = {n.id for s in function.body for n in ast.walk(s) if isinstance(n, ast.Name)}
    given = [*function.args.posonlyargs, *function.args.args]
    pairs = [*zip(given[::-1], function.args.defaults[::-1], strict=False)]
    pairs += zip(function.args.kwonlyargs, function.args.kw_defaults, strict=True)
    yield from (x for a, x in pairs if x is not None and a.arg not in read)


def _changed(node: Any, **fields: Any) -> Any:
    """A copy of a node with other fields."""
    out = copy.deepcopy(node)
    for name, value in fields.items():
        setattr(out, name, value)
    return out


def _expressions(node: ast.AST, parent: ast.AST) -> Iterator[ast.AST]:
    """What may stand in place of an expression."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        kind = type(node.ops[0])
        yield _changed(node, ops=[NEGATED[kind]()])
        if kind in BOUNDARY and any(_counts(n) for n in (node.left, node.comparators[0])):
            yield _changed(node, ops=[BOUNDARY[kind]()])
    elif isinstance(node, ast.BinOp):
        if type(node.op) in ARITHMETIC:
            yield _changed(node, op=ARITHMETIC[type(node.op)]())
        elif isinstance(node.op, ast.MatMult):
            yield _changed(node, left=node.right, right=node.left)
    elif isinstance(node, ast.BoolOp):
        yield _changed(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub)):
        yield node.operand
    elif isinstance(node, ast.Constant) and not isinstance(parent, ast.UnaryOp):
        if isinstance(node.value, bool):
            yield _changed(node, value=not node.value)
        elif isinstance(node.value, (int, float)):
            yield _changed(node, value=node.value + 1)
    elif isinstance(node, ast.Call):
        yield from _calls(node)


def _counts(node: ast.AST) -> bool:
    """Whether it is a whole number that counts something, so that the bound itself occurs."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return node.func.id == "len"
    return isinstance(node, ast.Constant) and type(node.value) is int and node.value != 0


def _calls(node: ast.Call) -> Iterator[ast.AST]:
    """A call with another function, with its first two arguments swapped, without one of those that
    have a name.
    """
    name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
    empty = name in ("zeros", "ones") and re.search(r"\b0\b", ast.unparse(node.args[0]))
    if name in NAMES and not empty:
        field = "id" if isinstance(node.func, ast.Name) else "attr"
        yield _changed(node, func=_changed(node.func, **{field: NAMES[name]}))
    first = node.args[:2]
    if (
        len(first) == 2
        and name not in SYMMETRIC
        and not any(isinstance(a, ast.Starred) for a in first)
    ):
        if ast.dump(first[0]) != ast.dump(first[1]):
            yield _changed(node, args=[first[1], first[0], *node.args[2:]])
    for i, keyword in enumerate(node.keywords):
        if keyword.arg and not is_text(keyword):
            yield _changed(node, keywords=node.keywords[:i] + node.keywords[i + 1 :])


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in place of a statement."""
    if isinstance(node, ast.Return):
        if node.value and ast.unparse(node.value) not in ("None", "False", "0", "()"):
            yield _changed(node, value=ast.Constant(None))
    elif isinstance(node, (ast.Raise, ast.AugAssign)):
        yield ast.Pass()
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield ast.Pass()
    elif isinstance(node, ast.Assign) and not isinstance(node.targets[0], (ast.Name, ast.Tuple)):
        yield ast.Pass()
    elif isinstance(node, (ast.Break, ast.Continue)):
        yield ast.Continue() if isinstance(node, ast.Break) else ast.Pass()


def _negated(place: _Place) -> Iterator[ast.AST]:
    """The negation of a condition that is no comparison and no negation itself."""
    plain = isinstance(place.node, (ast.Compare, ast.UnaryOp))
    if place.field in ("test", "ifs") and not (plain and len(getattr(place.node, "ops", [0])) == 1):
        yield ast.UnaryOp(ast.Not(), place.node)


def mutations(tree: ast.Module) -> Iterator[tuple[_Place, ast.AST]]:
    """All places with what may stand there."""
    for place in list(_walk(tree, [])):
        for source in (
            _expressions(place.node, place.parent),
            _statements(place.node),
            _negated(place),
        ):
            yield from ((place, new) for new in source)


def sites(text: str) -> list[Site]:
    """The mutations of a module, by number."""
    out = []
    for number, (place, new) in enumerate(mutations(ast.parse(text))):
        before, after = (" ".join(ast.unparse(n).split()) for n in (place.node, new))
        line = getattr(place.node, "lineno", 0)
        out.append(Site(number, line, place.function, place.segment, before, after))
    return out


def mutated(text: str, number: int) -> ast.Module:
    """The tree of a module with one mutation; all else keeps its line."""
    tree = ast.parse(text)
    place, new = next(m for i, m in enumerate(mutations(tree)) if i == number)
    ast.copy_location(new, place.node)
    if place.index is None:
        setattr(place.parent, place.field, new)
    else:
        getattr(place.parent, place.field)[place.index] = new
    return ast.fix_missing_locations(tree)


def instrumented(text: str, module: str) -> str:
    """The module with a call `_hit("module:function:segment")` at the beginning of each segment."""
    tree = ast.parse(text)
    starts = []
    list(_walk(tree, starts))
    for body, i, segment in reversed(starts):
        said = i == 0 and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant)
        body.insert(i + said, ast.parse(f"_hit({f'{module}:{segment}'!r})").body[0])
    future = [
        i
        for i, n in enumerate(tree.body)
        if isinstance(n, ast.ImportFrom) and n.module == "__future__"
    ]
    tree.body.insert(
        max(future, default=0) + 1, ast.parse("from kempe._hits import hit as _hit").body[0]
    )
    return ast.unparse(ast.fix_missing_locations(tree))
