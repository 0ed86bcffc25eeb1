"""The move to the layout of tools/layout.toml: `python tools/layout.py check [--all]`,
`python tools/layout.py apply`.

`check` applies the table to the imports of today, also those in functions and for type checking,
and to calls of methods of `System`, which are imports in disguise: it prints what would go against
the order, and the circles. `apply` moves the files, merges and splits modules, and rewrites imports
and names of modules in code and text.
"""

from __future__ import annotations

import ast
import builtins
import collections
import pathlib
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from typing import NamedTuple

ROOT = pathlib.Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src" / "kempe"
TABLE = tomllib.loads((ROOT / "tools" / "layout.toml").read_text(encoding="utf-8"))
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
FACADE = {"System", "Inverse", "Loops", "ReachStudies", "Symbolic", "Pictured"}
SYSTEM = ("model.system", "System")
MODEL = ("model.compiled_system", "Compiled")
RENAMES = {tuple(k.rsplit(":", 1)): v for k, v in TABLE.get("renames", {}).items()}
"""New names of what modules define, by module and name: where merged modules have the same name for
two things."""


def key_of(path: pathlib.Path) -> str:
    """The name of a module below the package, `a.__init__` of a package with contents."""
    name = ".".join(path.relative_to(SOURCE).with_suffix("").parts)
    return "__root__" if name == "__init__" else name


def dotted(key: str) -> str:
    """The name by which a module is imported."""
    return "kempe" if key == "__root__" else f"kempe.{key.removesuffix('.__init__')}"


def file_of(key: str) -> str:
    """The file of a module, from the package on."""
    return "__init__.py" if key == "__root__" else f"{key.replace('.', '/')}.py"


class Bound(NamedTuple):
    """What an import binds: a name, of a module (by key) and there a name, or the module itself
    (None).
    """

    name: str
    module: str
    of: str | None
    kind: str
    line: int
    unit: int


class Old:
    """A module as it is: its statements at the top, each with the comments before it and the text
    after it.
    """

    def __init__(self, key: str, path: pathlib.Path, package: bool = True):
        self.key = key
        self.path = path
        self.text = path.read_text(encoding="utf-8")
        self.tree = ast.parse(self.text)
        self.starts = [0, 0]
        for line in self.text.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.units: list[list[ast.stmt]] = []
        for node in self.tree.body:
            is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            if is_text and self.units and not _is_import(self.units[-1][0]):
                self.units[-1].append(node)
            else:
                self.units.append([node])
        self.defines: dict[str, int] = {}
        for i, unit in enumerate(self.units):
            if not _is_import(unit[0]):
                for name in bound_in(unit):
                    self.defines.setdefault(name, i)

    def at(self, line: int, column: int) -> int:
        """The place in the text of a line and a column, which Python counts in bytes."""
        start = self.starts[line]
        return start + len(self.text[start:].split("\n", 1)[0].encode()[:column].decode())

    def span(self, node: ast.AST) -> tuple[int, int]:
        """Where a node begins and ends in the text, with its decorators."""
        first = min(
            [node, *getattr(node, "decorator_list", [])], key=lambda n: (n.lineno, n.col_offset)
        )
        start = self.at(first.lineno, first.col_offset)
        if getattr(node, "decorator_list", []):
            start = self.text.rindex("@", 0, start)
        return start, self.at(node.end_lineno, node.end_col_offset)


def _is_import(node: ast.stmt) -> bool:
    """Whether a statement is an import, or imports for type checking."""
    checking = (
        isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING" and not node.orelse
    )
    return isinstance(node, (ast.Import, ast.ImportFrom)) or (
        checking and all(_is_import(n) for n in node.body)
    )


def bound_in(nodes: list[ast.stmt]) -> set[str]:
    """Names that statements bind in their own scope."""
    found: set[str] = set()

    def walk(node: ast.AST) -> None:
        if isinstance(node, (*FUNCTIONS[:2], ast.ClassDef)):
            found.add(node.name)
            return
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            found.update((a.asname or a.name).split(".")[0] for a in node.names)
        if isinstance(node, ast.Name) and isinstance(node.ctx, (ast.Store, ast.Del)):
            found.add(node.id)
        if isinstance(node, ast.ExceptHandler) and node.name:
            found.add(node.name)
        if isinstance(node, (ast.MatchAs, ast.MatchStar)) and node.name:
            found.add(node.name)
        if not isinstance(node, (ast.Lambda, *COMPREHENSIONS)):
            for child in ast.iter_child_nodes(node):
                walk(child)

    for node in nodes:
        walk(node)
    return found


def references(
    node: ast.AST, hidden: frozenset[str] = frozenset()
) -> Iterator[tuple[ast.Name, frozenset[str]]]:
    """Names that are read or written in a node, with the names that scopes around hide there from
    the module's.
    """
    if isinstance(node, ast.Name):
        yield node, hidden
    elif isinstance(node, FUNCTIONS):
        own = node.args
        every = [
            *own.posonlyargs,
            *own.args,
            *own.kwonlyargs,
            *filter(None, (own.vararg, own.kwarg)),
        ]
        for child in [
            *getattr(node, "decorator_list", []),
            *own.defaults,
            *filter(None, own.kw_defaults),
            *(a.annotation for a in every if a.annotation),
            getattr(node, "returns", None),
        ]:
            if child is not None:
                yield from references(child, hidden)
        body = node.body if isinstance(node.body, list) else [ast.Expr(node.body)]
        free = {
            n
            for s in body
            for g in ast.walk(s)
            if isinstance(g, (ast.Global, ast.Nonlocal))
            for n in g.names
        }
        inner = hidden | frozenset(({a.arg for a in every} | bound_in(body)) - free)
        for child in body:
            yield from references(child, inner)
    elif isinstance(node, COMPREHENSIONS):
        targets = frozenset(
            n.id for g in node.generators for n in ast.walk(g.target) if isinstance(n, ast.Name)
        )
        yield from references(node.generators[0].iter, hidden)
        for child in ast.iter_child_nodes(node):
            if child is not node.generators[0]:
                yield from references(child, hidden | targets)
        first = node.generators[0]
        for child in (first.target, *first.ifs):
            yield from references(child, hidden | targets)
    elif isinstance(node, ast.ClassDef):
        for child in [*node.decorator_list, *node.bases, *(k.value for k in node.keywords)]:
            yield from references(child, hidden)
        own_names = frozenset(bound_in(node.body))
        for child in node.body:  # functions of a class do not see its names
            yield from references(
                child, hidden if isinstance(child, FUNCTIONS) else hidden | own_names
            )
    else:
        for child in ast.iter_child_nodes(node):
            yield from references(child, hidden)


# ---------------------------------------------------------------------------------------------- the
# table


OLD = {key_of(p): Old(key_of(p), p) for p in sorted(SOURCE.rglob("*.py"))}
REST: dict[str, str] = {}
SPLIT: dict[tuple[str, str], str] = {}
PARTS: dict[str, list[str]] = {}
for _new, _text in TABLE["modules"].items():
    for _part in _text.split():
        _old, _, _names = _part.partition(":")
        if _old not in OLD:  # deleted since
            continue
        PARTS.setdefault(_new, []).append(_old)
        if _names:
            SPLIT.update({(_old, name): _new for name in _names.split(",")})
        else:
            REST[_old] = _new
PLACELESS = [
    k
    for k, m in OLD.items()
    if k not in {*REST, *TABLE["deleted"]} and (len(m.tree.body) > 1 or not m.tree.body)
]  # the packages' own files have a docstring and nothing else
for _old in PLACELESS:  # what is new since stays where it is
    REST[_old] = _old
    PARTS[_old] = [_old]
SPLIT_MODULES = {old for old, _ in SPLIT}
for (_old, _name), _new in list(SPLIT.items()):  # what one statement defines goes together
    if _old in OLD and _name in OLD[_old].defines:
        _i = OLD[_old].defines[_name]
        SPLIT.update({(_old, n): _new for n, k in OLD[_old].defines.items() if k == _i})
DELETED = set(TABLE["deleted"])
LEVEL = {name: i for i, line in enumerate(TABLE["order"]) for name in line.split()}


def checked_table() -> list[str]:
    """What is wrong with the table: modules without a place, and names that are nowhere."""
    wrong = [f"no place: {k}" for k in PLACELESS]
    wrong += [
        f"a new name that means another module now: {n}"
        for n in PARTS
        if n in OLD and REST.get(n, n) != n
    ]
    wrong += [
        f"no such module: {p}"
        for text in TABLE["modules"].values()
        for p in text.split()
        if p.partition(":")[0] not in OLD
    ]
    return wrong + [
        f"no such name: {k}:{n}" for k, n in SPLIT if k in OLD and n not in OLD[k].defines
    ]


def module_at(name: str) -> str | None:
    """The key of the module of this full name; None where there is none."""
    key = name.removeprefix("kempe").removeprefix(".") if name.split(".")[0] == "kempe" else None
    if key is None:
        return None
    return (
        "__root__"
        if not key
        else key
        if key in OLD
        else f"{key}.__init__"
        if f"{key}.__init__" in OLD
        else None
    )


def imported(node: ast.stmt, kind: str, unit: int) -> Iterator[Bound]:
    """What an import statement binds of the package."""
    if isinstance(node, ast.Import):
        for a in node.names:
            if (module := module_at(a.name)) is not None:
                yield Bound(a.asname or a.name, module, None, kind, node.lineno, unit)
    elif isinstance(node, ast.ImportFrom) and (base := node.module or "").split(".")[0] == "kempe":
        for a in node.names:
            module = module_at(f"{base}.{a.name}")
            if (
                module is not None
                and a.name not in OLD.get(module_at(base) or "", OLD["__root__"]).defines
            ):
                yield Bound(a.asname or a.name, module, None, kind, node.lineno, unit)
            elif (module := module_at(base)) is not None:
                yield Bound(a.asname or a.name, module, a.name, kind, node.lineno, unit)


def imports_of(old: Old) -> list[tuple[ast.stmt, list[Bound]]]:
    """The import statements of a module, each with what it binds: at the top, `lazy` in functions,
    or `typing`.
    """
    found: list[tuple[ast.stmt, list[Bound]]] = []

    def walk(node: ast.AST, kind: str, unit: int) -> None:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            found.append((node, list(imported(node, kind, unit))))
        inner = "lazy" if isinstance(node, FUNCTIONS) and kind != "typing" else kind
        typing = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for child in ast.iter_child_nodes(node):
            below = typing and child in node.body and "not" not in ast.unparse(node.test)  # type: ignore[attr-defined]
            walk(child, "typing" if below else inner, unit)

    for i, unit in enumerate(old.units):
        for node in unit:
            walk(node, "top", i)
    return found


IMPORTS = {key: imports_of(old) for key, old in OLD.items()}
TOP_BINDINGS = {
    key: {b.name: b for _, bounds in rows for b in bounds if b.kind != "lazy"}
    for key, rows in IMPORTS.items()
}


def origin(module: str, name: str | None) -> tuple[str, str | None]:
    """Where a name comes from that a module may only hand on."""
    while (
        name is not None
        and not module.endswith(("__init__", "__root__"))
        and name not in OLD[module].defines
    ):
        bound = TOP_BINDINGS[module].get(name)
        if bound is None:
            break
        module = bound.module
        name = bound.of
    return module, name


def home(module: str, name: str | None) -> str | None:
    """The new module of a name of an old one, or of the module itself; None where it is deleted."""
    return SPLIT.get((module, name or "")) or REST.get(module)


def place(module: str, name: str | None, kind: str, of: str) -> tuple[str | None, str | None]:
    """New module and name of what a new module imports; below `System` types of systems are the
    model's.
    """
    module, name = origin(module, name)
    if (module, name) == SYSTEM and kind == "typing" and below_system(of):
        module, name = MODEL
    there = home(module, name) or (None if module in DELETED else module)
    return there, name and RENAMES.get((module, name), name)


def below_system(key: str) -> bool:
    """Whether a new module stands below `System`."""
    return key in TABLE["typed"] or LEVEL.get(key.split(".")[0], 99) < LEVEL["system"]


def users(old: Old, bound: Bound) -> set[str]:
    """The new modules in which what a module imports is needed."""
    if old.key not in SPLIT_MODULES:
        return {REST[old.key]}
    if not _is_import(old.units[bound.unit][0]):
        return {unit_home(old, bound.unit)}
    return {
        unit_home(old, i)
        for i, unit in enumerate(old.units)
        if not _is_import(unit[0]) and bound.name.split(".")[0] in names_in(old, i)
    }


def unit_home(old: Old, i: int) -> str:
    """The new module of a statement at the top."""
    homes = {SPLIT[old.key, n] for n, k in old.defines.items() if k == i and (old.key, n) in SPLIT}
    assert len(homes) < 2, f"{old.key}: one statement, two homes: {homes}"
    return homes.pop() if homes else REST[old.key]


_names: dict[tuple[str, int], set[str]] = {}


def names_in(old: Old, i: int) -> set[str]:
    """Names of the module's scope that a statement at its top needs."""
    if (old.key, i) not in _names:
        found = {n.id for s in old.units[i] for n, hidden in references(s) if n.id not in hidden}
        _names[old.key, i] = found
    return _names[old.key, i]


class Arrow(NamedTuple):
    """A new module needs a name of another: how, and where that is now."""

    of: str
    to: str
    name: str
    kind: str
    where: str


def facade() -> dict[str, tuple[str, str | None]]:
    """For each method of `System` that calls another module: the old module and the name that it
    imports last.
    """
    found: dict[str, tuple[str, str | None]] = {}
    for _, old in sorted(OLD.items(), key=lambda x: x[0] not in ("model.system", "system")):
        for c in (c for c in old.tree.body if isinstance(c, ast.ClassDef) and c.name in FACADE):
            for f in (f for f in c.body if isinstance(f, ast.FunctionDef) and f.name[0] != "_"):
                inner = [
                    b
                    for n in ast.walk(f)
                    if isinstance(n, ast.ImportFrom)
                    for b in imported(n, "lazy", 0)
                ]
                if inner:
                    found.setdefault(f.name, (inner[-1].module, inner[-1].of))
    return found


METHODS = facade()
OTHERS = re.compile(r"(mechanism|loops)$")
"""What has attributes of the same names as methods of `System`: they are no calls."""


def calls(old: Old) -> Iterator[tuple[ast.Attribute, int]]:
    """Attributes of systems that are methods of `System`, with the number of the statement at the
    top.
    """
    for i, unit in enumerate(old.units):
        for node in (n for s in unit for n in ast.walk(s)):
            if isinstance(node, ast.Attribute) and node.attr in METHODS:
                of = ast.unparse(node.value)
                if re.search(
                    r"(^|[._])(system|robot|tree|design|job\.system)$", of
                ) and not OTHERS.search(of):
                    yield node, i


def arrows() -> list[Arrow]:
    """What new modules will need of one another."""
    found: list[Arrow] = []
    for key, old in OLD.items():
        if key not in REST:
            continue
        where = old.path.relative_to(ROOT)
        for _, bounds in IMPORTS[key]:
            for b in (b for b in bounds if b.module in REST or b.module in DELETED):
                for of in users(old, b):
                    to, name = place(b.module, b.of, b.kind, of)
                    found.append(
                        Arrow(
                            of,
                            to or f"(deleted) {b.module}",
                            name or "*",
                            b.kind,
                            f"{where}:{b.line}",
                        )
                    )
        if key in SPLIT_MODULES:  # what a module needs of its own other parts
            for i in range(len(old.units)):
                for name in names_in(old, i) & set(old.defines):
                    line = old.units[i][0].lineno
                    found.append(
                        Arrow(
                            unit_home(old, i),
                            home(key, name) or "",
                            name,
                            "split",
                            f"{where}:{line}",
                        )
                    )
        if below_system(REST[key]):
            for node, i in calls(old):
                module, name = origin(*METHODS[node.attr])
                to = home(module, name) or "(deleted)"
                found.append(
                    Arrow(unit_home(old, i), to, f".{node.attr}", "call", f"{where}:{node.lineno}")
                )
    late = set(TABLE.get("late", {}))
    return [a for a in found if a.of != a.to and f"{a.of} -> {a.to}:{a.name}" not in late]


def rank(key: str) -> tuple[int, int]:
    """Place of a new module in the order: its line, and that within its folder."""
    folder, _, rest = key.partition(".")
    first = rest.split(".")[0]
    lines = [line.split() for line in TABLE["within"].get(folder, [])]
    inner = first if any(first in line for line in lines) else "."
    return LEVEL.get(folder, -1), next((k for k, line in enumerate(lines) if inner in line), -1)


def circles(edges: set[tuple[str, str]]) -> list[list[str]]:
    """Sets of modules that reach one another."""
    out: dict[str, list[str]] = collections.defaultdict(list)
    for a, b in sorted(edges):
        out[a].append(b)
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []
    for root in list(out):
        if root in index:
            continue
        work = [(root, iter(out[root]))]
        index[root] = low[root] = len(index)
        stack.append(root)
        while work:
            v, rest = work[-1]
            w = next(rest, None)
            if w is None:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[v])
                if low[v] == index[v]:
                    part = []
                    while not part or part[-1] != v:
                        part.append(stack.pop())
                    if len(part) > 1:
                        found.append(sorted(part))
            elif w not in index:
                index[w] = low[w] = len(index)
                stack.append(w)
                work.append((w, iter(out[w])))
            elif w in stack:
                low[v] = min(low[v], index[w])
    return sorted(found, key=len, reverse=True)


def check() -> None:
    """Print what the plan needs."""
    for line in checked_table():
        print(line)
    every = arrows()
    wrong: dict[tuple[str, str], list[Arrow]] = collections.defaultdict(list)
    for a in every:
        if a.to.startswith("(") or rank(a.to) > rank(a.of):
            wrong[a.of, a.to].append(a)
    print(
        f"---- against the order: {len(wrong)} pairs of modules, {sum(map(len, wrong.values()))} "
        "names"
    )
    for (of, to), rows in sorted(wrong.items()):
        print(f"{of} -> {to}")
        for a in sorted(set(rows), key=lambda a: a.where):
            print(f"    {a.name:28} {a.kind:7} {a.where}")
    edges = {(a.of, a.to) for a in every if (a.of, a.to) not in wrong}
    rings = circles(edges)
    print(f"---- circles besides: {sum(map(len, rings))} modules in {len(rings)}")
    for ring in rings:
        print("circle:", " ".join(ring))
        for a in sorted(
            {a for a in every if a.of in ring and a.to in ring and (a.of, a.to) in edges}
        ):
            print(f"    {a.of} -> {a.to}: {a.name} ({a.kind}) {a.where}")
    runs = collections.defaultdict(set)
    for a in every:
        if a.kind != "typing":
            runs[a.to].add(a.of.removesuffix(".__init__"))
    lonely = [
        m
        for m in PARTS
        if len(runs[m]) == 1 and next(iter(runs[m])).rpartition(".")[0] == m.rpartition(".")[0]
    ]
    calls_left = [a for a in every if a.kind == "call"]
    whole = circles({(a.of, a.to) for a in every})
    print(
        f"---- modules {len(PARTS)}; with one importer beside them {len(lonely)}: "
        f"{' '.join(lonely)}"
    )
    print(
        f"     calls of methods of System {len(calls_left)}; modules in circles now "
        f"{sum(map(len, whole))}"
    )
    for line in collisions():
        print(line)
    notes: list[str] = []
    for key in DELETED & set(OLD):
        REST[key] = key
        PARTS[key] = [key]
    for new in PARTS:
        try:
            merged(new, notes)
        except AssertionError as error:
            print(error)
    print("\n".join(note for note in notes if note.startswith("shadowed")))


# ----------------------------------------------------------------------------------------------
# names that collide


def collisions() -> list[str]:
    """Names that parts of one new module would bind to different things."""
    found: list[str] = []
    for new, parts in PARTS.items():
        bound: dict[str, set[str]] = collections.defaultdict(set)
        for key in dict.fromkeys(parts):
            old = OLD[key]
            for name, i in old.defines.items():
                if unit_home(old, i) == new:
                    bound[RENAMES.get((key, name), name)].add(f"{key}:{name}")
            for b in TOP_BINDINGS[key].values():
                if new in users(old, b):
                    to, name = place(b.module, b.of, b.kind, new)
                    if to != new:
                        bound[b.name].add(f"import {to}:{name}")
                    elif name is not None and b.name != name and b.of != name:
                        bound[b.name].add(f"import {to}:{name}")
        for key in dict.fromkeys(
            parts
        ):  # a part that uses a builtin which another one defines anew
            old = OLD[key]
            own = {*old.defines, *TOP_BINDINGS[key]}
            used = (
                set().union(
                    *(names_in(old, i) for i in range(len(old.units)) if unit_home(old, i) == new)
                )
                - own
            )
            found += [
                f"collision in {new}: {n}: builtin in {key}"
                for n in used & set(bound) & set(dir(builtins))
            ]
        for name, what in sorted(bound.items()):  # imports get other names by themselves
            own = sorted(w for w in what if not w.startswith("import "))
            if len({unit_text(k, OLD[k].defines[n]) for k, n in (w.split(":") for w in own)}) > 1:
                found.append(f"collision in {new}: {name}: {', '.join(own)}")
    return found


# ----------------------------------------------------------------------------------------------
# apply


class Edits:
    """Replacements in a text, by place."""

    def __init__(self, text: str):
        self.text = text
        self.made = dict[tuple[int, int], str]()

    def put(self, start: int, end: int, new: str) -> None:
        """Replace the text from `start` to `end`."""
        self.made[start, end] = new

    def within(self, start: int, end: int) -> str:
        """A part of the text, edited."""
        out = []
        at = start
        for (i, j), new in sorted(self.made.items()):
            if start <= i and j <= end and i >= at:
                out += [self.text[at:i], new]
                at = j
        return "".join(out) + self.text[at:end]


def stem(key: str) -> str:
    """The last part of the name of a module."""
    return key.removesuffix(".__init__").rpartition(".")[2]


class Rewriter:
    """Rewrites the imports of one file and the names that they bind, for a place in the new module
    `new`, if any.
    """

    def __init__(self, old: Old, new: str | None, idents: dict[str, object]):
        self.old = old
        self.new = new
        self.idents = idents
        self.edits = Edits(old.text)
        self.header: set[tuple[str, str, str | None, str]] = set()  # kind, module, name, as
        self.notes: list[str] = []
        self.names: dict[
            str, str | tuple[str, str]
        ] = {}  # of the module's scope: new text, or module for attributes
        self.rows = imports_of(old)

    def kept(self, i: int) -> bool:
        """Whether a statement at the top goes to the new module."""
        return self.new is None or self.old.key not in REST or unit_home(self.old, i) == self.new

    def target(self, b: Bound) -> tuple[str | None, str | None]:
        """The new module of what an import binds, and its new name there."""
        return place(b.module, b.of, b.kind, self.new or "cli")

    def identifier(self, b: Bound, to: str | None, name: str | None) -> str:
        """What the import will bind: the name as it is, unless another part of the module has that
        for something.
        """
        plain = name if b.of == b.name and name and origin(b.module, b.of) in RENAMES else b.name
        if b.of is None and b.name == stem(b.module) and to is not None:
            plain = (
                stem(to)
                if stem(to) not in self.old.defines and stem(to) not in self.taken()
                else b.name
            )
        if b.name == dotted(b.module):
            return dotted(to or b.module)
        at = "top" if b.kind != "lazy" else f"{id(self)}{b.line}"
        if self.idents.setdefault((at, plain), (to, name))[:2] != (to, name):  # type: ignore[index]
            if b.of is None:
                plain = stem(to or b.module)
            else:
                other = stem(to or b.module)
                plain = f"{other.upper()}_{plain}" if plain.isupper() else f"{plain}_{other}"
            self.idents[at, plain] = (to, name)
        return plain

    def taken(self) -> set[str]:
        """All names of the file."""
        if not hasattr(self, "_taken"):
            self._taken = {n.id for n in ast.walk(self.old.tree) if isinstance(n, ast.Name)}
            self._taken |= {n.arg for n in ast.walk(self.old.tree) if isinstance(n, ast.arg)}
        return self._taken

    def run(self, in_place: bool) -> None:
        """Make all edits; imports at the top are collected in the `header`, or rewritten
        `in_place`.
        """
        old = self.old
        scoped: dict[int, list[tuple[Bound, str | None, str | None, str]]] = {}
        for node, bounds in self.rows:
            if not bounds:
                if not in_place and self.at_top(node):
                    self.foreign(node)
                continue
            done = [(b, *self.target(b)) for b in bounds]
            rows = [(b, to, name, self.identifier(b, to, name)) for b, to, name in done]
            for b, to, name, ident in rows:
                if b.kind != "lazy":
                    self.bind(b, to, name, ident)
            if self.at_top(node) and not in_place:
                used = self.used()
                for b, to, name, ident in rows:
                    if to != self.new and (
                        old.key not in SPLIT_MODULES or b.name.split(".")[0] in used
                    ):
                        self.header.add((b.kind, to or f"deleted.{b.module}", name, ident))
                self.foreign(node, ours=False)
            elif self.at_top(node) or self.kept(bounds[0].unit):
                self.rewrite(node, rows)
                if bounds[0].kind == "lazy":
                    scoped.setdefault(bounds[0].unit, []).extend(rows)
        for name in old.defines:
            new = RENAMES.get((old.key, name), name)
            there = home(old.key, name) if old.key in REST else self.new
            if there != self.new:  # another part of a module that is split
                if name in self.used():
                    self.header.add(("top", there or "", new, new))
            if new != name:
                self.names[name] = new
        for i, unit in enumerate(old.units):
            if self.kept(i) and (in_place or not _is_import(unit[0])):
                self.references(unit, scoped.get(i, []))

    def used(self) -> set[str]:
        """Names of the module's scope that the statements need that go to the new module."""
        if not hasattr(self, "_used"):
            keep = [
                i
                for i, unit in enumerate(self.old.units)
                if self.kept(i) and not _is_import(unit[0])
            ]
            self._used = set().union(*(names_in(self.old, i) for i in keep))
        return self._used

    def at_top(self, node: ast.stmt) -> bool:
        """Whether an import stands among the imports of the module."""
        return any(
            _is_import(u[0]) and any(n is node for n in ast.walk(u[0])) for u in self.old.units
        )

    def foreign(self, node: ast.stmt, ours: bool = True) -> None:
        """An import of another package, for the header."""
        module = getattr(node, "module", "") or ""
        if not ours or module.split(".")[0] == "kempe" or module == "__future__":
            return
        typing = any(
            isinstance(u[0], ast.If) and any(n is node for n in ast.walk(u[0]))
            for u in self.old.units
        )
        for a in node.names:  # type: ignore[attr-defined]
            name = (a.asname or a.name).split(".")[0]
            if self.old.key not in SPLIT_MODULES or name in self.used():
                text = (
                    f"import {a.name}"
                    if isinstance(node, ast.Import)
                    else f"from {module} import {a.name}"
                )
                self.header.add(
                    (
                        "typing" if typing else "top",
                        "",
                        text + (f" as {a.asname}" if a.asname else ""),
                        name,
                    )
                )

    def bind(self, b: Bound, to: str | None, name: str | None, ident: str) -> None:
        """Remember what a name of the module's scope becomes."""
        if b.of is None:
            self.names[b.name] = (b.module, ident if to != self.new or self.new is None else "")
        else:
            text = name if to == self.new and self.new is not None else ident
            if text != b.name:
                self.names[b.name] = text or b.name

    def rewrite(
        self, node: ast.stmt, rows: list[tuple[Bound, str | None, str | None, str]]
    ) -> None:
        """Replace an import statement."""
        lines: list[str] = []
        groups: dict[str, list[str]] = {}
        ours = {b.name for b, *_ in rows}
        rest = [a for a in node.names if (a.asname or a.name) not in ours]  # type: ignore[attr-defined]
        for a in rest:
            text = f"{a.name} as {a.asname}" if a.asname else a.name
            if isinstance(node, ast.Import):
                lines.append(f"import {text}")
            else:
                groups.setdefault(node.module or "", []).append(text)  # type: ignore[attr-defined]
        for b, to, name, ident in rows:
            if to == self.new and self.new is not None:
                if b.kind == "lazy" and self.assigned(node, b.name):
                    place_of = f"{self.old.path.relative_to(ROOT)}:{b.line}"
                    self.notes.append(f"shadowed: {place_of}: {b.name} is assigned, too")
                continue
            if to is None:
                to = f"deleted.{b.module}"
            if name is None and b.name == dotted(b.module):
                lines.append(f"import {dotted(to)}")
            elif name is None:
                package, _, last = dotted(to).rpartition(".")
                text = last if last == ident else f"{last} as {ident}"
                if package:
                    groups.setdefault(package, []).append(text)
                else:
                    lines.append(f"import {text}")
            else:
                groups.setdefault(dotted(to), []).append(
                    name if name == ident else f"{name} as {ident}"
                )
        lines += [
            f"from {module} import {', '.join(sorted(set(names)))}"
            for module, names in sorted(groups.items())
        ]
        start, end = self.old.span(node)
        before = self.old.text.rfind("\n", 0, start) + 1
        indent = self.old.text[before:start]
        if indent.strip():
            self.edits.put(start, end, "; ".join(lines) or "pass")
        elif not lines:
            more = self.old.text.find("\n", end) + 1
            self.edits.put(before, more, f"{indent}pass\n" if self.alone(node) else "")
        elif ast.unparse(node).replace("\n", "") != "\n".join(lines):
            self.edits.put(start, end, f"\n{indent}".join(lines))

    def assigned(self, node: ast.stmt, name: str) -> bool:
        """Whether the function that imports a name also assigns it."""
        functions = [f for f in ast.walk(self.old.tree) if isinstance(f, FUNCTIONS[:2])]
        around = [f for f in functions if any(n is node for n in ast.walk(f))]
        inner = around[-1] if around else None
        stores = ast.walk(inner) if inner is not None else ()
        return any(
            isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store) and n.id == name
            for n in stores
        )

    def alone(self, node: ast.stmt) -> bool:
        """Whether a statement is the only one of its block."""
        return any(
            b == [node]
            for n in ast.walk(self.old.tree)
            for b in (getattr(n, "body", 0), getattr(n, "orelse", 0))
        )

    def references(
        self, unit: list[ast.stmt], lazy: list[tuple[Bound, str | None, str | None, str]]
    ) -> None:
        """Rewrite names in a statement at the top."""
        attributes = {
            id(n.value): n
            for s in unit
            for n in ast.walk(s)
            if isinstance(n, ast.Attribute) and isinstance(n.value, ast.Name)
        }
        for s in unit:
            name = getattr(s, "name", None)
            if name in self.names and isinstance(self.names[name], str):
                at = self.old.text.index(name, self.old.at(s.lineno, s.col_offset))
                self.edits.put(at, at + len(name), self.names[name])  # type: ignore[arg-type]
            for node, hidden in references(s):
                self.hidden = hidden
                if node.id not in hidden:
                    self.name(node, self.names.get(node.id), attributes.get(id(node)))
                elif row := next((r for r in lazy if r[0].name == node.id), None):
                    b, to, new, ident = row  # an import in a function
                    inner = to == self.new and self.new is not None
                    if b.of is None:
                        self.name(
                            node, (b.module, "" if inner else ident), attributes.get(id(node))
                        )
                    else:
                        self.name(node, new if inner else ident, None)

    def shadow(self, node: ast.Name, new: str) -> None:
        """Note where a new name would be that of a local variable."""
        if new in self.hidden:
            self.notes.append(
                f"shadowed: {self.old.path.relative_to(ROOT)}:{node.lineno}: {node.id} would be "
                f"{new}"
            )

    def name(
        self, node: ast.Name, new: str | tuple[str, str] | None, attribute: ast.Attribute | None
    ) -> None:
        """Replace one name, and where it is a module the attribute that is taken of it."""
        start, end = self.old.span(node)
        if isinstance(new, str):
            if new != node.id:
                self.shadow(node, new)
                self.edits.put(start, end, new)
        elif new is not None:
            module, ident = new
            if attribute is None:
                moved = [n for (m, n) in SPLIT if m == module] or [
                    m for m in PARTS.get(REST.get(module, ""), [])
                ][1:]
                if moved or not ident:
                    self.notes.append(
                        f"{self.old.path}:{node.lineno}: the module {module} as a value: {node.id}"
                    )
                if ident and ident != node.id:
                    self.edits.put(start, end, ident)
                return
            m, n = origin(module, attribute.attr)
            if m == module:
                there = home(m, n)
                now = RENAMES.get((m, n or ""), n)
            else:  # handed on: it still is
                there = REST.get(module)
                now = attribute.attr
            first, last = self.old.span(attribute)
            if there == self.new and self.new is not None:
                self.shadow(node, now or "")
                self.edits.put(first, last, now or "")
            elif there == REST.get(module) and ident:
                self.edits.put(first, last, f"{ident}.{now}")
            elif there is not None:
                self.edits.put(first, last, f"{stem(there)}.{now}")
                self.header.add(("top", there, None, stem(there)))


def header_text(rows: set[tuple[str, str, str | None, str]]) -> str:
    """Import statements; ruff sorts them."""
    top = {r[1:] for r in rows if r[0] == "top"}
    typing = {r[1:] for r in rows if r[0] == "typing"} - top
    out: list[str] = []
    if typing and not any(name == "from typing import TYPE_CHECKING" for _, name, _ in top):
        top.add(("", "from typing import TYPE_CHECKING", "TYPE_CHECKING"))

    def lines(rows: set[tuple[str, str | None, str]]) -> list[str]:
        found: set[str] = set()
        for module, name, ident in rows:
            if not module:
                found.add(name or "")
            elif name is None:
                package, _, last = dotted(module).rpartition(".")
                named = last if last == ident else f"{last} as {ident}"
                found.add(f"from {package} import {named}" if package else f"import {named}")
            else:
                found.add(
                    f"from {dotted(module)} import "
                    f"{name if name == ident else f'{name} as {ident}'}"
                )
        return sorted(found)

    out += lines(top)
    if typing:
        out += ["", "if TYPE_CHECKING:", *(f"    {line}" for line in lines(typing))]
    return "\n".join(out)


def ordered(new: str) -> list[str]:
    """The parts of a new module, those first that others need when they are imported."""
    parts = list(dict.fromkeys(PARTS[new]))
    needs: dict[str, set[str]] = {p: set() for p in parts}
    for p in parts:
        for _, bounds in IMPORTS[p]:
            for b in bounds:
                module = origin(b.module, b.of)[0]
                if (
                    b.kind == "top"
                    and module in parts
                    and module != p
                    and home(*origin(b.module, b.of)) == new
                ):
                    needs[p].add(module)
    out: list[str] = []
    while len(out) < len(parts):
        free = [p for p in parts if p not in out and needs[p] <= set(out)]
        assert free, f"{new}: parts need one another at the top: {needs}"
        out.append(free[0])
    return out


def docstring(old: Old) -> str:
    """The docstring of a module, as it stands."""
    first = old.tree.body[0] if old.tree.body else None
    if (
        isinstance(first, ast.Expr)
        and isinstance(first.value, ast.Constant)
        and isinstance(first.value.value, str)
    ):
        return old.text[slice(*old.span(first))]
    return ""


def unit_text(key: str, i: int) -> str:
    """The text of a statement at the top."""
    old = OLD[key]
    return old.text[old.span(old.units[i][0])[0] : old.span(old.units[i][-1])[1]]


def main_part(new: str) -> str:
    """The part whose history a new module continues, and whose docstring it has: that of its name,
    or the largest.
    """
    whole = [p for p in PARTS[new] if REST[p] == new] or PARTS[new]
    same = [p for p in whole if stem(p) == stem(new)]
    return (same or sorted(whole, key=lambda p: -len(OLD[p].text)))[0]


def merged(new: str, notes: list[str]) -> str:
    """The text of a new module."""
    parts = ordered(new)
    idents: dict[str, object] = {}
    for p in parts:
        for name, i in OLD[p].defines.items():
            if unit_home(OLD[p], i) == new:
                now = RENAMES.get((p, name), name)
                other = idents.setdefault(("top", now), (new, now, p, i))
                same = other == (new, now, p, i) or unit_text(p, i) == unit_text(*other[2:])  # type: ignore[index]
                assert same, f"{new}: {now} of {p} and of {other}: see [renames]"
    if len(parts) == 1 and parts[0] not in SPLIT_MODULES:
        one = Rewriter(OLD[parts[0]], new, idents)
        one.run(in_place=True)
        notes += one.notes
        text = one.edits.within(0, len(one.old.text))
        if one.header:
            at = text.index(
                "\n\n", text.index("\nimport ") if "\nimport " in text else text.index("\nfrom ")
            )
            text = text[:at] + "\n" + header_text(one.header) + text[at:]
        return text
    header: set[tuple[str, str, str | None, str]] = set()
    bodies: list[str] = []
    main = main_part(new)
    seen = set[str]()
    exported = list[str]()
    for p in parts:
        r = Rewriter(OLD[p], new, idents)
        r.run(in_place=False)
        header |= r.header
        notes += r.notes
        pieces: list[str] = []
        before = 0
        for i, unit in enumerate(r.old.units):
            start = r.old.span(unit[0])[0]
            end = r.old.span(unit[-1])[1]
            rest = r.old.text[
                end : r.old.text.find("\n", end) if "\n" in r.old.text[end:] else len(r.old.text)
            ]
            if rest.lstrip().startswith("#"):
                end += len(rest)
            comments = r.old.text[before:start]
            before = end
            first = unit[0]
            text = r.edits.within(start, end)
            if (
                _is_import(first)
                or (i == 0 and docstring(r.old) and isinstance(first, ast.Expr))
                or not r.kept(i)
            ):
                continue
            if isinstance(first, ast.Assign) and ast.unparse(first.targets[0]) == "__all__":
                exported += ast.literal_eval(first.value)
                continue
            if isinstance(first, (ast.Assign, ast.AnnAssign)) and text in seen:
                continue
            seen.add(text)
            blank = "\n" * max(min(comments.split("#")[0].count("\n") - 1, 2), 0)
            note = comments[comments.index("#") :] if "#" in comments else ""
            pieces.append(f"{blank}{note}{text}\n" if note or blank else f"{text}\n")
        text = "".join(pieces).strip("\n")
        if p != main and text:
            words = re.sub(r'^[rR]?"""|"""$', "", docstring(OLD[p])).strip()
            said = "\n".join(f"# {line}".rstrip() for line in words.splitlines())
            text = (
                f"# ---- {stem(p).replace('_', ' ')}\n\n"
                + (f"{said}\n\n\n" if said else "\n")
                + text
            )
        if text:
            bodies.append(text)
    if exported:
        bodies.insert(0, f"__all__ = {sorted(set(exported))!r}")
    top = docstring(OLD[main])
    return (
        f"{top}\n\nfrom __future__ import annotations\n\n{header_text(header)}\n\n"
        + "\n\n\n".join(bodies)
        + "\n"
    )


# ---- names of modules in text


NAMES = sorted(
    (k for k in REST if k != "__root__" and not k.endswith("__init__")), key=len, reverse=True
)
FULL = re.compile(r"(?<![\w.])kempe\.((?:\w+\.)*\w+)(?::([A-Za-z_]\w*))?")
SHORT = re.compile(
    r"(?<![\w./])(" + "|".join(re.escape(n) for n in NAMES if "." in n) + r")(?:\.(\w+))?(?![\w/])"
)
TICKED = re.compile(r"`(~?)([A-Za-z_]\w*(?:\.\w+)+)(\(\))?`")
FILES = re.compile(r"(?<![\w/])((?:src/)?(?:kempe/)?)((?:\w+/)*\w+)\.py\b")
STATEMENT = re.compile(r"from (kempe[\w.]*) import (\([^)]*\)|[^\n(;\"'`]+)")


def new_name(key: str, name: str | None) -> str:
    """The new full name of a module, or of a name in it."""
    if name is not None and name in OLD[key].defines:
        return f"{dotted(home(key, name) or '')}.{RENAMES.get((key, name), name)}".removeprefix(
            "kempe."
        )
    return dotted(REST[key]).removeprefix("kempe.") + (f".{name}" if name else "")


def full_name(m: re.Match[str]) -> str:
    """A name that begins with the package, also as `module:name`."""
    if m[2] and m[1] in REST and m[2] in OLD[m[1]].defines:
        module, _, name = new_name(m[1], m[2]).rpartition(".")
        return f"kempe.{module}:{name}"
    if m[2]:
        return FULL.sub(full_name, f"kempe.{m[1]}") + f":{m[2]}"
    parts = m[1].split(".")
    for k in range(len(parts), 0, -1):
        key = ".".join(parts[:k])
        if key in REST:
            rest = parts[k + 1 :]
            return ".".join(["kempe", new_name(key, parts[k] if k < len(parts) else None), *rest])
    return m[0]


def ticked_name(m: re.Match[str]) -> str:
    """A name in backticks that begins with the last parts of a module's name."""
    parts = m[2].split(".")
    for k in range(len(parts), max(0, len(parts) - 3), -1):
        tail = ".".join(parts[:k])
        keys = [n for n in NAMES if n == tail or n.endswith(f".{tail}")]
        name = parts[k] if k < len(parts) else None
        if (
            len(keys) == 1
            and (k > 1 or name in OLD[keys[0]].defines)
            and (k == len(parts) or name in OLD[keys[0]].defines)
        ):
            full = new_name(keys[0], name)
            if full == ".".join([keys[0], *parts[k : k + 1]]):
                return m[0]
            if k == 1:
                full = ".".join(full.split(".")[-2:])
            return f"`{m[1]}{'.'.join([full, *parts[k + 1 :]])}{m[3] or ''}`"
    return m[0]


def statement(m: re.Match[str]) -> str:
    """An import in a text, such as an example."""
    module = module_at(m[1])
    groups: dict[str, list[str]] = {}
    for item in re.split(r",\s*", m[2].strip("() \n").rstrip(",")):
        name, _, alias = item.strip().partition(" as ")
        inner = module_at(f"{m[1]}.{name}")
        if inner in REST and not (module in OLD and name in OLD[module].defines):
            package, _, last = dotted(REST[inner]).rpartition(".")
            text = last if last == (alias or name) else f"{last} as {alias or name}"
            groups.setdefault(package, []).append(text)
        elif module in REST and re.fullmatch(r"\w+", name):
            to, now = place(module, name, "top", "cli")
            text = (now or name) + (f" as {alias or name}" if alias or now != name else "")
            groups.setdefault(dotted(to or f"deleted.{module}"), []).append(text)
        else:
            return m[0]
    end = re.search(r"\s*$", m[2])
    return "; ".join(f"from {k} import {', '.join(v)}" for k, v in groups.items()) + (
        end[0] if end else ""
    )


def file_name(m: re.Match[str]) -> str:
    """The path of a file of the package."""
    key = m[2].replace("/", ".")
    if key in REST and ("." in key or m[1]):
        return m[1] + file_of(REST[key])
    return m[0]


def in_text(text: str) -> str:
    """A text with the new names."""
    text = STATEMENT.sub(statement, text)
    text = FULL.sub(full_name, text)
    text = TICKED.sub(ticked_name, text)
    text = SHORT.sub(lambda m: new_name(m[1], m[2]), text)
    return FILES.sub(file_name, text)


def in_code(text: str) -> str:
    """Code with the new names in its strings and comments."""
    import io
    import tokenize

    lines = [0]
    for line in text.splitlines(keepends=True):
        lines.append(lines[-1] + len(line))
    edits = Edits(text)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in (tokenize.STRING, tokenize.COMMENT):
            new = in_text(token.string)
            if new != token.string:
                (a, b) = token.start
                (c, d) = token.end
                edits.put(lines[a - 1] + b, lines[c - 1] + d, new)
    return FULL.sub(full_name, edits.within(0, len(text)))


def apply() -> None:
    """Move everything; modules that are to be deleted, and are not yet, stay where they are."""
    notes: list[str] = []
    for key in DELETED & set(OLD):
        REST[key] = key
        PARTS[key] = [key]
    texts = {new: merged(new, notes) for new in PARTS}
    others: dict[pathlib.Path, str] = {}
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split("\n")
    for name in filter(None, listed):
        path = ROOT / name
        if (
            name.startswith(("src/kempe/", "tools/layout"))
            and path.suffix in (".py", ".toml")
            or not path.is_file()
        ):
            if not (name.startswith("src/kempe/library") and path.suffix != ".py"):
                continue
        if path.suffix == ".py":
            r = Rewriter(Old(f"/{name}", path), None, {})
            r.run(in_place=True)
            text = r.edits.within(0, len(r.old.text))
            if r.header:
                at = r.old.span(
                    next(
                        u[0]
                        for u in r.old.units
                        if _is_import(u[0]) and "__future__" not in ast.unparse(u[0])
                    )
                )[0]
                text = (
                    r.edits.within(0, at)
                    + header_text(r.header)
                    + "\n"
                    + r.edits.within(at, len(r.old.text))
                )
            notes += r.notes
            others[path] = in_code(text)
        elif path.suffix in (".md", ".toml", ".txt", ".yml", ".yaml", ".json", ".cfg", ".svg"):
            others[path] = in_text(path.read_text(encoding="utf-8"))
    for old in OLD.values():  # git finds by itself what was moved
        old.path.unlink()
    for new, text in texts.items():
        target = SOURCE / file_of(new)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(in_code(text), encoding="utf-8")
    for folder in sorted({p.parent for p in SOURCE.rglob("*.py")}):
        name = ".".join(folder.relative_to(SOURCE).parts)
        if name and not (folder / "__init__.py").exists():
            old = OLD.get(f"{name}.__init__")
            said = TABLE["packages"].get(name) or (ast.get_docstring(old.tree) if old else "") or ""
            (folder / "__init__.py").write_text(f'"""{said}"""\n', encoding="utf-8")
    for path, text in others.items():
        path.write_text(text, encoding="utf-8")
    for folder in sorted(SOURCE.rglob("*"), reverse=True):
        if folder.is_dir() and not any(
            p.is_file() and p.suffix != ".pyc" for p in folder.rglob("*")
        ):
            for p in sorted(folder.rglob("*"), reverse=True):
                p.rmdir() if p.is_dir() else p.unlink()
            folder.rmdir()
    subprocess.run(
        ["ruff", "check", "-q", "--select", "I,F401", "--fix", "src", "tests", "benchmarks"],
        cwd=ROOT,
    )
    subprocess.run(["ruff", "format", "-q", "src"], cwd=ROOT)
    subprocess.run(
        ["git", "add", "-A", "src", "tests", "benchmarks", "docs", "native"], cwd=ROOT, check=True
    )
    print("\n".join(notes))


if __name__ == "__main__":
    {"check": check, "apply": apply}[sys.argv[1]]()
