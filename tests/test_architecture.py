"""Dependencies point one way, importing is cheap, and nothing of the machine it was written on is
left behind.
"""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import sources

from kempe import late

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "kempe"
MODULES = sorted(SOURCE.rglob("*.py"))

LAYERS = [
    {
        "errors",
        "reals",
        "calls",
        "budget",
        "spatial",
        "rigid",
        "status",
        "words",
        "late",
        "version",
        "singular_values",
    },
    {"kernels"},
    {"joints"},
    {"values", "placement"},
    {"constraints"},
    {"description", "library"},
    {"model"},
    {"kinematics"},
    {"solvers"},
    {"analysis"},
    {"views", "cli", "tasks", "convert", "__main__"},
]
"""Each may import itself and what stands to the left."""

FOLDERS: dict[str, list[set[str]]] = {
    "kernels": [
        {"base"},
        {"forward", "dyads"},
        {"one_frame", "closed_form", "constraints"},
        {"elimination", "series", "tasks"},
        {"."},
    ],
    "description": [{"."}, {"dh"}, {"toml", "urdf"}, {"read", "write"}],
    "model": [{"kept"}, {"tree"}, {"closures"}, {"."}],
    "kinematics": [{"common"}, {"."}, {"velocity", "formulas"}, {"tasks"}],
    "solvers": [
        {"common"},
        {"one_frame", "dyads"},
        {"assembly"},
        {"modes"},
        {"tasks"},
        {"velocity"},
        {"paths"},
        {"analytic"},
        {"."},
    ],
    "solvers.analytic": [{"plans"}, {"answers"}, {"."}, {"describe", "redundant"}],
    "analysis": [
        {"first_order"},
        {"local"},
        {"mobility"},
        {"continuation"},
        {"motion"},
        {"manoeuvre"},
        {"simulation"},
        {"maps"},
        {"spaces"},
    ],
    "analysis.spaces": [
        {"curves", "kinds", "singular"},
        {"planar"},
        {"configuration", "workspace"},
        {"reach"},
    ],
    "views": [{"drawing"}, {"."}, {"input", "viewer"}],
}
"""In each package the order of its folders, and of single modules that stand apart; "." is what
lies in no folder.

Each may import itself and what stands to the left; folders in one set do not import one another."""

LATER = {
    "inverse.ik": {"tasks", "analytic"},
    "inverse.refine": {"analytic"},
    "inverse.limit_proof": {"analytic"},
    "inverse.explain": {"tasks"},
    "inverse.explain_tasks": {"velocity"},
    "mobility.mobility": {"motion"},
    "inverse.explain_all": {"."},
    "inverse.path": {"analytic"},
}
"""Modules that import to the right inside functions: another solver answers, or what is required of
an answer later."""

UPWARD = {"system.py", "namespaces.py", "system.py"}
"""The map of the library, which imports upwards inside functions. All else that points upwards are
rows of `late`."""

BELOW = {
    "mobility/idle_spins.py": "kempe.analysis.mobility",
    "mobility/independent.py": "kempe.analysis.mobility",
    "assemble/modes.py": "kempe.analysis.first_order",
}
"""Modules that import from a folder in which tools/layout.toml puts them, or which it puts below
them."""


def name_of(path: Path) -> str:
    """The first part of a module's name below the package: its layer."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def level(layer: str) -> int:
    return next(i for i, names in enumerate(LAYERS) if layer in names)


@cache
def imports(path: Path) -> tuple[tuple[str, str, int], ...]:
    """Imported modules with the function that imports them ('' at the top) and the line; type
    checking left out.
    """

    def walk(node: ast.AST, function: str) -> Iterator[tuple[str, str, int]]:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        if isinstance(node, ast.Import):
            yield from ((alias.name, function, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: a relative import"
            yield from (
                (f"{node.module}.{alias.name}", function, node.lineno) for alias in node.names
            )
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            function = node.name
        for child in ast.iter_child_nodes(node):
            yield from walk(child, function)

    return tuple(walk(sources.tree(path), ""))


@sources.each(MODULES, SOURCE)
def test_imports_go_to_the_left(path):
    own = name_of(path)
    of_layers = tuple(f"kempe.{name}" for name in set().union(*LAYERS))
    for module, function, line in (row for row in imports(path) if row[0].startswith(of_layers)):
        parts = module.split(".")
        where = f"{path.relative_to(SOURCE)}:{line} imports {module}"
        if own == "__init__":
            assert function or level(parts[1]) <= level("model"), where
        elif own == "kernels":
            assert parts[1] in ("kernels", "errors"), f"{where}: kernels know arrays and each other"
        elif own == "library":
            assert parts[1] == "errors", f"{where}: the library is data"
        else:
            rel = path.relative_to(SOURCE).as_posix()
            free = (function and rel in UPWARD) or module.startswith(BELOW.get(rel, "-"))
            assert level(parts[1]) <= level(own) or free, where


def test_what_points_upwards_is_found_and_used():
    assert len(late.ROWS) <= 20
    text = "".join(path.read_text() for path in MODULES if path.name != "late.py")
    for name, row in late.ROWS.items():
        assert late.late(name) is not None and f'"{name}"' in text, row
    with pytest.raises(KeyError):
        late.late("nothing")


def place(package: str, module: str) -> tuple[int, str]:
    """Where a module of a package stands in the order of its folders, and the folder."""
    first = module.removeprefix(f"{package}.").partition(".")[0]
    for k, names in enumerate(FOLDERS[package]):
        if first in names:
            return k, first
    return next(k for k, names in enumerate(FOLDERS[package]) if "." in names), "."


def dotted(path: Path) -> str:
    return ".".join(path.relative_to(SOURCE).with_suffix("").parts)


@pytest.mark.parametrize("package", FOLDERS)
def test_folders_of_a_package_are_imported_in_their_order(package):
    known = {dotted(path) for path in MODULES}
    for path in (SOURCE / package.replace(".", "/")).rglob("*.py"):
        own = dotted(path)
        for full, function, line in imports(path):
            module = full.removeprefix("kempe.")
            module = module if module in known else module.rpartition(".")[0]
            if path.stem != "__init__" and module.startswith(f"{package}."):
                (to, folder) = place(package, module)
                (at, here) = place(package, own)
                later = function and folder in LATER.get(own, ())
                assert folder == here or to < at or later, f"{own}:{line} imports {module}"


@pytest.mark.parametrize("module", ["system.py", "namespaces.py", "pictured.py"])
def test_the_map_of_the_library_only_delegates(module):
    """A method of System that imports upwards ends by calling what it imported, and does little
    before.
    """
    tree = ast.parse((SOURCE / "model" / module).read_text())
    for function in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)):
        inner = [n for n in function.body if isinstance(n, ast.ImportFrom)]
        if inner:
            kinds = [type(n) for n in function.body]
            assert kinds[0] is ast.Expr and kinds[-2:] == [ast.ImportFrom, ast.Return], (
                function.name
            )
            assert len(kinds) <= 5, function.name


def modules_after(code: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after running `code`."""
    script = f"import sys, json\n{code}\nprint(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(json.loads(run.stdout.splitlines()[-1]))


def test_importing_is_cheap():
    """Counted in modules, since seconds depend on the machine."""
    loaded = modules_after("import kempe")
    heavy = {
        "numba",
        "llvmlite",
        "sympy",
        "matplotlib",
        "scipy",
        "typer",
        "rich",
        "pinocchio",
        "viser",
        "xml",
        "tomllib",
    }
    assert not heavy & loaded
    ours = {
        m
        for m in loaded
        if m.split(".")[0] == "kempe" and (SOURCE.parent / f"{m.replace('.', '/')}.py").exists()
    }
    assert len(ours) < 40, sorted(ours)
    others = {
        m
        for m in loaded - modules_after("import numpy, numpy.typing")
        if m.split(".")[0] != "kempe"
    }
    assert len(others) < 30, sorted(others)


def test_describing_and_building_needs_no_compiler():
    loaded = modules_after(
        "import kempe\nm = kempe.Mechanism()\nm.revolute('j', m.ground, m.body('b'))\ns = "
        "m.build()\ns.q({'j': 1.0}), s.structure.limits, s.parent, s.random(0), "
        "s.configuration_space, hash(s), s.mid"
    )
    assert not {"kempe.kernels.compiled", "numba", "scipy"} & loaded


def test_forward_needs_numpy_only():
    loaded = modules_after(
        "import kempe\nm = kempe.Mechanism()\nm.revolute('j', m.ground, "
        "m.body('b'))\nm.build().fk([0.1], 'b')"
    )
    assert not {"numba", "llvmlite", "scipy", "sympy", "matplotlib", "typer", "rich"} & loaded


@sources.each(MODULES, SOURCE)
def test_errors_are_caught_by_name(path):
    for node in sources.nodes(path):
        if isinstance(node, ast.ExceptHandler):
            caught = ast.unparse(node.type) if node.type else ""
            names = set(re.findall(r"\w+", caught))
            assert names and not names & {"Exception", "BaseException"}, (
                f"{path.name}:{node.lineno}"
            )


@sources.each(MODULES, SOURCE)
def test_nothing_is_evaluated_or_unpickled(path):
    """Files are data. The one page whose code runs is the lecture's, which is shipped with the
    package.
    """
    allowed = {"exec", "eval", "compile"} if path == SOURCE / "library" / "lecture.py" else set()
    for node in sources.nodes(path):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            forbidden = {
                "eval",
                "exec",
                "compile",
                "pickle.load",
                "pickle.loads",
                "os.system",
                "__import__",
            }
            assert called not in forbidden - allowed, f"{path.name}:{node.lineno}: {called}"


TEXT = {
    ".py",
    ".md",
    ".toml",
    ".cfg",
    ".yml",
    ".yaml",
    ".txt",
    ".ipynb",
    ".urdf",
    ".xml",
    ".json",
    "",
}
SKIPPED = {
    ".git",
    ".venv",
    "__pycache__",
    "_build",
    "jupyter_execute",
    "dist",
    "build",
    ".hypothesis",
}


def test_no_paths_of_a_machine():
    found = re.compile(r"(?<![\w.])/(?:work|home|root|Users|opt|mnt)/\w|[A-Z]:\\\\Users")
    files: list[Path] = []
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [x for x in folders if x not in SKIPPED and not x.endswith("_cache")]
        files += [
            p
            for p in (Path(folder, x) for x in names if x not in SKIPPED)
            if p.suffix in TEXT and p != Path(__file__)
        ]
    assert len(files) > 500
    for path in files:
        text = path.read_text(encoding="utf-8", errors="replace")
        assert not (hit := found.search(text)), (
            f"{path.relative_to(ROOT)}: {hit.group() if hit else ''}"
        )


SOLVERS = {
    "lstsq",
    "pinv",
    "solve",
    "svd",
    "least_squares",
    "least_squares_of_many",
    "damped_least_squares",
}
"""Calls by which a step of Gauss, Newton or least squares is made in numpy."""

OWN_LOOPS = {
    "numerics/newton.py gauss_newton": "the one for one start",
    "numerics/newton.py gauss_newton_of_many": "the one for many starts",
    "mobility/dof_proofs.py _regular_zero": (
        "of quadratic forms, on a sphere, judged after each step"
    ),
    "first_order/idle_freedoms.py _spins": "a basis that grows",
    "mobility/reachable.py moved_place": "motions integrated one after the other",
    "first_order/redundant_constraints.py _choose": "a basis that grows",
    "numerics/rank.py null_space_from": ("inverse iteration: the matrix is factored once"),
    "motion/transmission.py mechanical_advantage": "one kernel after the other",
    "inverse/closed_forms/nearest.py descend": "bounded in each lane, with damping that grows",
    "inverse/tasks/search.py near_target": "one move for the first task that has one",
    "numerics/least_squares.py bounded": "an active set: the problem is linear",
    "inverse/servo.py closed": ("bounded by limits of velocity, which move with the point"),
    "numerics/least_squares.py least_in_box": "an active set: the problem is quadratic",
    "assemble/fit.py _fit": ("over dimensions, the configurations solved for in each step"),
}
"""Functions outside the kernels whose loops solve linear equations for what their next round begins
with, and why."""


def calls_in(node: ast.AST) -> set[str]:
    """The last names of all that is called in a piece of code."""
    return {
        ast.unparse(n.func).rpartition(".")[2] for n in ast.walk(node) if isinstance(n, ast.Call)
    }


def roots_of(target: ast.AST) -> set[str]:
    """The names that an assignment changes."""
    if isinstance(target, (ast.Tuple, ast.List)):
        return set().union(*map(roots_of, target.elts))
    while isinstance(target, (ast.Subscript, ast.Starred)):
        target = target.value
    return {ast.unparse(target)}


def reads(node: ast.AST) -> set[str]:
    return {ast.unparse(n) for n in ast.walk(node) if isinstance(n, (ast.Name, ast.Attribute))}


def iterates(loop: ast.AST) -> bool:
    """Whether what a loop solves changes that from which it is solved in the next round."""
    assigned: list[tuple[set[str], set[str], bool]] = []
    for n in ast.walk(loop):
        if isinstance(n, (ast.Assign, ast.AugAssign)):
            targets = n.targets if isinstance(n, ast.Assign) else [n.target]
            changed = set().union(*map(roots_of, targets))
            more = changed if isinstance(n, ast.AugAssign) else set()
            assigned.append((changed, reads(n.value) | more, bool(calls_in(n.value) & SOLVERS)))
    solved: set[str] = set()
    for _ in assigned:
        solved |= {name for to, of, direct in assigned if direct or of & solved for name in to}
    return any(direct or of & solved for to, of, direct in assigned if to & of)


def own_loops(tree: ast.Module) -> Iterator[str]:
    for f in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)):
        if any(iterates(n) for n in ast.walk(f) if isinstance(n, (ast.For, ast.While))):
            yield f.name


def test_there_is_one_gauss_newton_loop_in_numpy():
    """No loop beside `kinematics.gauss_newton` solves linear equations for its next point, but for
    those listed.
    """
    solving = (
        p for p in MODULES if name_of(p) != "kernels" and any(s in p.read_text() for s in SOLVERS)
    )
    found = {
        f"{p.relative_to(SOURCE).as_posix()} {name}"
        for p in solving
        for name in own_loops(sources.tree(p))
    }
    assert found == set(OWN_LOOPS)


@pytest.mark.parametrize(
    ("body", "own"),
    [
        ("for _ in y:\n  x = x + np.linalg.lstsq(A(x), b)[0]", True),
        ("while True:\n  s = solve(A(x), b)\n  x = move(x, s)", True),
        ("for _ in y:\n  s = pinv(A(x)) @ b\n  x[left] += s", True),
        (
            "for _ in y:\n  U, s, Vt = np.linalg.svd(J(x))\n  d = -Vt.T @ (U.T @ r / s)\n  x = x + "
            "d",
            True,
        ),
        ("for a in y:\n  out.append(np.linalg.solve(a, b))", False),
        ("for a in y:\n  x = np.linalg.solve(a, b)\n  k = k + 1", False),
        ("x = x + np.linalg.solve(A, b)", False),
    ],
)
def test_loops_that_solve_for_their_next_point_are_seen(body, own):
    tree = ast.parse("def f(x):\n" + "\n".join("  " + line for line in body.split("\n")))
    assert list(own_loops(tree)) == ["f"] * own


PLACES = set(
    "HEADER ROW_INTS OUTPUT_INTS ROW_FLOATS OUTPUT_FLOATS N_ROWS N_OUT PARENT FORM HEAD SCALES INVERSE_LENGTH TIE_INTS "
    "ENTRY_INTS USE_INTS ENVELOPE_INTS READING_INTS PLACE_INTS AT_TIES AT_ENTRIES AT_LOCALS AT_VARS AT_USES AT_ROWS "
    "AT_READINGS AT_PLACES AT_NUMBERS AT_FACTORS AT_BOUNDS AT_CENTRES".split()
)
"""Where the numbers of the two packed arrays lie that all systems have: heads, and steps through
them."""

UNPACKED = {
    "mobility/local_equations.py": {"N_ROWS", "N_OUT"},
    "assemble/dyad_decomposition.py": {"HEADER"},
    "inverse/tasks/search.py": {"AT_PLACES", "AT_VARS", "PLACE_INTS"},
}
"""Modules outside of kernels and model that know such places: they pack arrays of their own, or
walk such programs."""


def test_packed_layouts_are_read_where_they_are_written():
    """Others read them by the functions of the layouts, and by what packed loops offer."""
    found: dict[str, set[str]] = {}
    for path in (p for p in MODULES if "layout" in p.read_text()):
        rel = path.relative_to(SOURCE).as_posix()
        tree = sources.tree(path)
        layouts = {
            alias.asname or alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
            if alias.name.endswith("layout")
        }
        names = {
            alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and (node.module or "").endswith("layout")
            for alias in node.names
        }
        names |= {
            node.attr
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in layouts
        }
        if names & PLACES and name_of(path) not in ("kernels", "model"):
            found[rel] = names & PLACES
    assert found == UNPACKED


def test_places_in_packed_integers_have_names():
    """In kernels; the operations of dyads list their operands, as functions do."""
    for path in sorted(
        set(SOURCE.glob("kernels/**/*.py")) - set(SOURCE.glob("kernels/dyads/*.py"))
    ):
        read = [n for n in sources.nodes(path) if isinstance(n, ast.Subscript)]
        for node in (n for n in read if ast.unparse(n.value).split(".")[-1] == "ints"):
            last = node.slice.right if isinstance(node.slice, ast.BinOp) else node.slice
            assert not isinstance(last, ast.Constant), (
                f"{path.name}:{node.lineno}: {ast.unparse(node)}"
            )


DOTTED = re.compile(r"`~?([A-Za-z_]\w*(?:\.\w+)+)(?:\(\))?`")
TOP = {p.stem for p in SOURCE.iterdir()} - {
    "tasks",
    "constraints",
    "model",
}  # which are names of variables, too


def exists(name: str) -> bool:
    """Whether a dotted name is a module of the package, or stands in one."""
    parts = name.removeprefix("kempe.").split(".")
    for k in range(len(parts), -1, -1):
        path = SOURCE.joinpath(*parts[:k])
        module = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if module.is_file() and (k or name.startswith("kempe.")):
            rest = parts[k:]
            return not rest or all(
                re.search(rf"\b{word}\b", module.read_text(encoding="utf-8")) for word in rest[:1]
            )
    return False


@sources.each(
    [
        *MODULES,
        *sorted((ROOT / "docs").glob("**/*.md")),
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
    ],
    ROOT,
)
def test_dotted_names_exist(path):
    """Names in backticks that begin with the package, or with one of its folders."""
    found = [
        name
        for name in DOTTED.findall(path.read_text(encoding="utf-8"))
        if name.split(".")[0] in TOP | {"kempe"}
    ]
    wrong = [
        name
        for name in found
        if not exists(name) and not name.endswith((".py", ".md", ".toml", ".json"))
    ]
    assert not wrong
