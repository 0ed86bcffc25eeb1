"""The architecture of the package: imports lead downwards, `System` stands on top of the library,
and importing is cheap.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import sources

from kempe import late
from kempe.model.model import Model
from kempe.system import System

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "kempe"
FILES = {
    ".".join(p.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__"): p
    for p in sorted(SOURCE.rglob("*.py"))
}
"""Modules by their names below `kempe`; the package itself is `__init__`."""

LAYERS = """
late version status words errors arrays units arguments budget numerics.rank spatial poses values report
kernels: base | forward dyads | one_frame closed_form constraints | elimination series tasks | *
joints
constraints
library description
model argument_types
numerics
forward
equations
answers
first_order
assemble
designs
geometry
inverse: chain | closed_forms | answer all_answer | tasks | *
mobility
motion
spaces
workspace
views: plot_options | drawing | * | viewer
solvers tasks convert namespaces
system
__init__
cli __main__
"""
"""A line may import itself and lines above; behind a colon stands the order within a folder, where
* is all that is not named. A module of a folder may stand alone in a line further up."""

TYPED = {("late", "system")}
"""The type of what `Mechanism.build` returns, which a row of `late` makes."""


@cache
def place(module: str) -> tuple[int, int]:
    """The layer of a module, and its place within the layer."""
    first, _, rest = module.partition(".")
    lines = LAYERS.split("\n")
    alone = any(module in line.partition(":")[0].split() for line in lines)
    for k, line in enumerate(lines):
        names, _, inner = line.partition(":")
        if (module if alone else first) in names.split():
            groups = [group.split() for group in inner.split("|")]
            named = [i for i, g in enumerate(groups) if rest.partition(".")[0] in g]
            return k, (named or [i for i, g in enumerate(groups) if "*" in g] or [0])[0]
    raise AssertionError(f"{module} stands in no layer")


def imports(node: ast.AST, typing: bool = False) -> Iterator[tuple[str, int, bool]]:
    """Imported modules of the package, the line, and whether only types are taken from it."""
    if isinstance(node, ast.Import):
        found = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        assert node.level == 0, f"line {node.lineno}: a relative import"
        found = [f"{node.module}.{alias.name}" for alias in node.names]
    else:
        found = []
    for name in (x for x in found if x.split(".")[0] == "kempe"):
        parts = name.split(".")[1:]
        prefixes = (".".join(parts[:k]) for k in range(len(parts), 0, -1))
        yield next((m for m in prefixes if m in FILES), "__init__"), node.lineno, typing
    typing = typing or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test))
    for child in ast.iter_child_nodes(node):
        yield from imports(child, typing)


@cache
def imports_of(path: Path) -> list[tuple[str, int, bool]]:
    """What a source imports, found once for all tests."""
    return list(imports(sources.tree(path)))


@pytest.mark.parametrize("layer", [line.split(":")[0] for line in LAYERS.split("\n") if line])
def test_imports_lead_downwards(layer):
    """Those in functions, and those of types, included."""
    upwards = [
        f"{module}:{line} imports {to}"
        for module in (m for m in FILES if m.split(".")[0] in layer.split())
        for to, line, _ in imports_of(FILES[module])
        if place(to) > place(module) and (module, to) not in TYPED
    ]
    assert not upwards, "\n".join(upwards)


def test_no_modules_import_one_another():
    """Imports in functions are included, those of types are not."""
    left = {
        m: {to for to, _, typing in imports_of(p) if not typing} - {m} for m, p in FILES.items()
    }
    while free := {m for m, to in left.items() if not to & left.keys()}:
        left = {m: to for m, to in left.items() if m not in free}
    while above := left.keys() - set().union(*left.values()):
        left = {m: to for m, to in left.items() if m not in above}
    assert not left, "\n".join(f"{m} -> {sorted(to & left.keys())}" for m, to in left.items())


def test_rows_of_late_are_few_found_and_used():
    assert len(late.ROWS) <= 20
    code = "".join(path.read_text("utf-8") for m, path in FILES.items() if m != "late")
    for name, row in late.ROWS.items():
        assert late.import_late_member(name) is not None and f'"{name}"' in code, row
    with pytest.raises(KeyError):
        late.import_late_member("nothing")


def test_the_library_is_data_and_kernels_know_arrays():
    """No other module imports what needs a compiler: only `compiled` and modules of constants."""
    for module, path in FILES.items():
        found = {to for to, _, _ in imports_of(path)}
        layer = module.split(".")[0]
        outside = {to for to in found if to.split(".")[0] not in ("kernels", "errors")}
        assert not outside or layer != "kernels", f"{module}: {outside}"
        assert found <= {"errors"} or layer != "library", module
        of_kernels = {
            x for x in found if x.startswith("kernels.") and not x.endswith(("layout", "constants"))
        }
        assert layer == "kernels" or of_kernels <= {"kernels.compiled", "kernels.digest"}, module


DECOMPOSED = re.compile(r"linalg\.(svd|svdvals|matrix_rank|pinv|lstsq|cond)\b|\bsvd\(")


@sources.each([p for m, p in FILES.items() if m.split(".")[0] != "numerics"], SOURCE)
def test_ranks_are_decided_in_one_place(path):
    """Singular values, pseudo-inverses and least squares of low rank come from `numerics.rank`."""
    assert not DECOMPOSED.findall(path.read_text("utf-8"))


# ---- System

FACADE = {name for name in dir(System) if not name.startswith("_")} - set(dir(Model))
ON_TOP = ("system", "namespaces", "__init__", "cli", "library")
RECEIVER = re.compile(r"(^|[._])(system|robot|arm)\d?$|\.build\(\)$|^Model\(")
"""What a system is called; Pyright finds the others, since `Model` has no verbs."""


@sources.each([p for m, p in FILES.items() if m.split(".")[0] not in ON_TOP], SOURCE)
def test_functions_are_called_not_methods_of_system(path):
    """A method that is called is a dependency that no import shows."""
    nodes = (n for n in sources.nodes(path) if isinstance(n, ast.Attribute) and n.attr in FACADE)
    calls = [f"{n.lineno} {ast.unparse(n)}" for n in nodes if RECEIVER.search(ast.unparse(n.value))]
    assert not calls


@pytest.mark.parametrize("module", ["system", "namespaces"])
def test_methods_of_system_only_delegate(module):
    """A method ends with the call of the function that it imports, and does little before."""
    functions = [n for n in sources.nodes(FILES[module]) if isinstance(n, ast.FunctionDef)]
    importing = [f for f in functions if any(isinstance(n, ast.ImportFrom) for n in f.body)]
    assert len(importing) > 10
    for function in importing:
        kinds = [type(n) for n in function.body]
        assert kinds[0] is ast.Expr and kinds[-2:] == [ast.ImportFrom, ast.Return], function.name
        assert len(kinds) <= 5, function.name


def verbs() -> set[str]:
    """Modules of solvers, and of what methods of `System` call, from the layer of `assemble` on."""
    found = {to for to, _, _ in imports_of(FILES["solvers"])}
    for module in ("system", "namespaces"):
        found |= {to for to, _, typing in imports_of(FILES[module]) if not typing}
    return {m for m in found if place("assemble") <= place(m) < place("views")}


ON_REQUEST = {
    "mobility.answer": {"mobility.relative_motion"},
    "workspace.answer": {"spaces.task_space", "workspace.planar.planar_workspace"},
}
"""What an answer computes with its own methods."""


@pytest.mark.parametrize("module", [m for m in FILES if m.endswith(("answer", "all_answer"))])
def test_answers_import_no_solver(module):
    """What explains an answer is a row of `late`."""
    found = {to for to, _, typing in imports_of(FILES[module]) if not typing}
    assert found & verbs() == ON_REQUEST.get(module, set())


# ---- what importing loads


def modules_after(code: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after running `code`."""
    script = f"import sys, json\n{code}\nprint(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(json.loads(run.stdout.splitlines()[-1]))


HEAVY = {"numba", "llvmlite", "scipy", "sympy", "matplotlib", "viser", "typer", "rich"}
DESCRIBED = (
    "import kempe\nm = kempe.Mechanism()\nm.revolute('j', m.ground, m.body('b'))\ns = m.build()\n"
)


def test_importing_is_cheap():
    """Counted in modules, since seconds depend on the machine."""
    loaded = modules_after("import kempe")
    assert not (HEAVY | {"pinocchio", "xml", "tomllib"}) & loaded
    ours = {m for m in FILES if f"kempe.{m}" in loaded and FILES[m].stem != "__init__"}
    assert len(ours) < 40, sorted(ours)
    others = {m for m in loaded - modules_after("import numpy, numpy.typing") if m[:5] != "kempe"}
    assert len(others) < 30, sorted(others)


@pytest.mark.parametrize(
    ("code", "left"),
    [
        ("s.q({'j': 1.0}), s.structure.limits, s.random(0), hash(s)", {"kempe.kernels.compiled"}),
        ("s.parent, s.mid, s.configuration_space", {"kempe.kernels.compiled"}),
        ("s.fk([0.1], 'b')", set()),
    ],
)
def test_describing_needs_no_kernels_and_forward_needs_numpy_only(code, left):
    assert not (HEAVY | left) & modules_after(DESCRIBED + code)


ASKED = """
import kempe
arm, leg, bar, car = map(kempe.load, ("puma560", "jansen", "four_bar", "car"))
X = arm.fk(arm.mid, "tool")
arm.ik(X, "tool"), arm.ik_all(X, "tool"), arm.ik_path(X[None], "tool"), arm.singularities("tool")
arm.ik([kempe.tasks.Position("tool", X[:3, 3])]), arm.workspace("tool", n=1000)
leg.assemble({"O": 1.0}), leg.assembly_modes({"O": 1.0}), leg.mobility(), leg.loops.closed_form("O")
bar.trace("A"), bar.drive({"A": [0.0, 1.0]}), bar.configuration_space.components(), car.classify()
"""


def test_verbs_load_no_extra():
    """A user who installed none has the answers, and does not wait for modules that draw."""
    assert not (HEAVY - {"scipy"}) & modules_after(ASKED)


# ---- what stands in files


@sources.each(FILES.values(), SOURCE)
def test_errors_are_caught_by_name_and_nothing_is_evaluated(path):
    """Files are data, except the code of the lecture's pages, which is shipped with the package."""
    for node in (n for n in sources.nodes(path) if isinstance(n, ast.ExceptHandler)):
        names = set(re.findall(r"\w+", ast.unparse(node.type) if node.type else ""))
        assert names and not names & {"Exception", "BaseException"}, f"line {node.lineno}"
    forbidden = {"pickle.load", "pickle.loads", "os.system", "__import__"}
    if path != FILES["library.lecture"]:
        forbidden |= {"eval", "exec", "compile"}
    for node in (n for n in sources.nodes(path) if isinstance(n, ast.Call)):
        assert ast.unparse(node.func) not in forbidden, f"line {node.lineno}"


def test_no_paths_of_a_machine():
    pattern = re.compile(r"(?<![\w.])/(?:work|home|root|Users|opt|mnt)/\w|[A-Z]:\\\\Users")
    endings = set(".py .md .toml .cfg .yml .yaml .txt .ipynb .urdf .xml .json".split())
    folders = ("src", "tests", "docs", "benchmarks", "native", "tools", ".github")
    found = (p for folder in folders for p in (ROOT / folder).rglob("*"))
    files = [p for p in (*found, *ROOT.glob("*.*")) if p.suffix in endings and p.is_file()]
    assert len(files) > 500
    built = {"_build", "jupyter_execute", Path(__file__).name}
    for path in (p for p in files if not built & set(p.relative_to(ROOT).parts)):
        hit = pattern.search(path.read_text(encoding="utf-8", errors="replace"))
        assert hit is None, f"{path.relative_to(ROOT)}: {hit and hit[0]}"


# ---- names in backticks

DOTTED = re.compile(r"`~?([A-Za-z_]\w*(?:\.\w+)+)(?:\(\))?`")


@cache
def identifiers() -> set[str]:
    """All names in the code of the package, and parts of names of modules."""
    fields = ("id", "attr", "name", "arg")
    nodes = (n for p in FILES.values() for n in sources.nodes(p))
    found = {str(getattr(n, f)) for n in nodes for f in fields if hasattr(n, f)}
    return found.union(*(m.split(".") for m in FILES))


SPOKEN = FACADE | {"model", "tasks", "constraints"}
"""Modules whose names are attributes or variables, too."""


def exists(name: str) -> bool:
    """Whether the parts of a dotted name are known, and its module, if it names one, has the next."""
    parts = name.removeprefix("kempe.").split(".")
    for k in range(len(parts) - 1, 0 if parts[0] not in SPOKEN else 1, -1):
        tail = ".".join(parts[:k])
        homes = [m for m in FILES if m == tail or (k > 1 and m.endswith(f".{tail}"))]
        if homes:
            word = re.compile(rf"\b{parts[k]}\b")
            return any(
                f"{m}.{parts[k]}" in FILES or word.search(FILES[m].read_text("utf-8"))
                for m in homes
            )
    return set(parts) <= identifiers()


@sources.each([*FILES.values(), *ROOT.glob("docs/**/*.md"), ROOT / "README.md"], ROOT)
def test_dotted_names_exist(path):
    """In sources all, on pages those that begin with the package or with a module."""
    names = DOTTED.findall(path.read_text(encoding="utf-8"))
    if path.suffix == ".md":
        names = [x for x in names if x.split(".")[0] in {*FILES, "kempe"} - SPOKEN]
    files = (".py", ".md", ".toml", ".json", ".urdf", ".so")
    assert not [x for x in names if not exists(x) and not x.endswith(files)]
