"""The pages tell the truth: their code runs, their outputs are what comes out, their links lead
somewhere.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import re
import shlex
import sys
from pathlib import Path
from types import ModuleType

import pytest
import sources
from command import Result
from hunts import some

import kempe
from kempe import library

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tools"))
import docs  # noqa: E402

DOCS = ROOT / "docs"
PAGES = sorted(
    [
        *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
        *(page for folder in ("", "add/", "api/") for page in DOCS.glob(f"{folder}*.md")),
    ]
)
FENCE = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
README_COMMAND = re.compile(r"\.venv/bin/kempe ([^\n]*)")

pages = pytest.mark.parametrize(
    "path", PAGES, ids=lambda p: p.relative_to(ROOT).with_suffix("").as_posix()
)
blocks = docs.read_blocks
same_output = docs.same_output


@pytest.mark.parametrize(
    ("got", "shown", "is_same"),
    [
        ("reached (7 steps)", "reached (... steps)", True),
        ("reached ( steps)", "reached (... steps)", False),
        ("q = 0.1234567", "q = 0.1234568", True),
        ("q = 0.12", "q = 0.13", False),
        ("q = -1", "q = 1", False),
        ("a b", "a", False),
        ("error 2e-16 m", "error ... m", True),
    ],
)
def test_outputs_are_compared(got, shown, is_same):
    assert same_output(got, shown) is is_same


def test_the_readme_shows_nothing_that_depends_on_the_processor():
    """Rounding errors, and how many steps or points it took."""
    shown = "".join(b.text for b in blocks(ROOT / "README.md") if b.kind == "text")
    assert not re.findall(r"\d[eE][-+]\d+|\d+ (?:steps?|points?)\b", shown)


SHORT = ("README.md", "docs/howto_inverse.md")
RUN = [
    name if name in SHORT else pytest.param(name, marks=pytest.mark.rest)
    for name in (p.relative_to(ROOT).as_posix() for p in docs.list_pages())
]
"""Pages whose code runs; the default suite runs what is read first, and a short one."""


@pytest.mark.parametrize("name", RUN)
def test_pages_show_what_comes_out(name):
    """Outputs and pictures below the code of a page are those of the code."""
    pytest.importorskip("matplotlib")
    pytest.importorskip("sympy")
    try:
        assert docs.find_differences(ROOT / name) == [], f"run  python tools/docs.py --write {name}"
    except docs.SkippedPageError as error:
        pytest.skip(f"{error} is not installed")


def test_pictures_of_pages_are_small_and_shown():
    found = sorted(docs.PICTURES.iterdir())
    assert {p.name for p in found} == docs.list_shown_pictures()
    assert all(p.stat().st_size <= docs.LARGEST for p in found)
    assert sum(p.stat().st_size for p in DOCS.glob("_static/**/*") if p.is_file()) < 8e6


def test_the_readme_is_short_and_its_pictures_are_small():
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(page.split()) <= 900
    pictures = re.findall(r'src="([^"]+)"', page)
    assert len(pictures) == 3
    assert all((ROOT / picture).stat().st_size < 1e6 for picture in pictures)


def test_first_command_of_the_readme(tmp_path, monkeypatch):
    """The command that does the main job prints what the README shows beneath it."""
    found = blocks(ROOT / "README.md")
    at = next(i for i, b in enumerate(found) if README_COMMAND.search(b.text))
    command = README_COMMAND.search(found[at].text)
    assert command is not None
    monkeypatch.chdir(tmp_path)
    result = Result(*shlex.split(command[1]))
    assert result.code == 0
    assert same_output(result.out, found[at + 1].text), result.out


def test_figures_of_the_readme_are_those_of_the_benchmark():
    """Each measured number of the README stands in benchmarks/results.md: copy them anew after a
    run.
    """
    results = (ROOT / "benchmarks" / "results.md").read_text(encoding="utf-8")
    measured = {cell.strip() for line in results.splitlines() for cell in line.split("|")}
    section = (
        (ROOT / "README.md")
        .read_text(encoding="utf-8")
        .partition("## How fast")[2]
        .partition("\n## ")[0]
    )
    rows = [line.split("|")[2:-1] for line in section.splitlines() if line.startswith("|")][2:]
    figures = [cell.split()[0] for row in rows for cell in row if cell.strip()]
    assert figures
    assert [x for x in figures if x not in measured] == []


@pages
def test_links_lead_somewhere(path):
    links = LINK.findall(FENCE.sub("", path.read_text(encoding="utf-8")))
    for target in (t for t in links if "://" not in t and not t.startswith("mailto:")):
        file, _, heading = target.partition("#")
        to = (path.parent / file).resolve() if file else path
        assert to.exists(), f"{path.name} links to {target}"
        if heading:
            assert heading in headings(to), f"{path.name} links to {target}"


def headings(path: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub and MyST make them."""
    lines = re.findall(r"^#+ (.*)$", FENCE.sub("", path.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", line.lower()).strip().replace(" ", "-") for line in lines}


def test_every_page_is_in_the_table_of_contents():
    index = DOCS / "index.md"
    listed = [
        line
        for page in (index, DOCS / "api.md")
        for b in blocks(page)
        if b.kind == "{toctree}"
        for line in b.text.splitlines()
        if line and not line.startswith(":")
    ]
    written = [
        p.relative_to(DOCS).with_suffix("").as_posix()
        for p in PAGES
        if DOCS in p.parents and p != index
    ]
    assert sorted(listed) == sorted(written)


def written_by(script: str) -> ModuleType:
    """A module of docs that writes a page."""
    spec = importlib.util.spec_from_file_location(script, ROOT / "docs" / f"{script}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[script] = module  # dataclasses and named tuples look themselves up
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", some(["formats", "joints", "trust"], 3))
def test_written_pages_are_up_to_date(name):
    shown = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    assert shown == written_by(f"{name}_page").page(), f"run  python docs/{name}_page.py"


def test_members_that_the_reference_lists_exist():
    text = "".join(page.read_text(encoding="utf-8") for page in DOCS.glob("api/*.md"))
    listed = re.findall(
        r"^\.\. autoclass:: ([\w.]+)\n   :members: (\w[\w, ]*)$", text, re.MULTILINE
    )
    assert len(listed) > 20
    for name, members in listed:
        module, _, of = name.rpartition(".")
        kind = getattr(importlib.import_module(module or "kempe"), of)
        known = {*dir(kind), *inspect.get_annotations(kind)}
        assert known.issuperset(members.split(", ")), name


def test_each_verb_is_on_one_page_of_the_reference():
    """The page of `System` leaves out what stands on the page of a verb."""
    left_out = re.search(r":exclude-members: (.*)", (DOCS / "api/system.md").read_text("utf-8"))
    assert left_out is not None
    elsewhere = [
        name
        for page in DOCS.glob("api/*.md")
        for name in re.findall(r"automethod:: kempe\.System\.(\w+)", page.read_text("utf-8"))
    ]
    assert sorted(left_out[1].split(", ")) == sorted(elsewhere)
    verbs = "fk jacobian ik ik_all assemble mobility trace workspace show".split()
    assert set(verbs) <= set(elsewhere) <= set(dir(kempe.System))


def test_the_list_of_public_names_is_up_to_date():
    """A change of a public name or signature shows in the list: rename with care."""
    shown = (DOCS / "public_api.txt").read_text(encoding="utf-8")
    assert written_by("public_api_page").page() == shown, "run  python docs/public_api_page.py"


def test_each_model_is_in_the_gallery():
    """By a thumbnail that leads to the page of the model, both with their pictures."""
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    cells = re.findall(
        r"\[!\[(\w+)\]\(_static/gallery/small/(\w+)\.png\)\]\(gallery/(\w+)\.md\)<br>`(\w+)`, \d+ DoF",
        page,
    )
    models = sorted(library.list_models())
    assert sorted(cell[0] for cell in cells) == models and len(models) >= 40
    assert all(len(set(cell)) == 1 for cell in cells)
    for folder, ending in (
        ("gallery", "md"),
        *(("_static/gallery" + s, "png") for s in ("", "/small")),
    ):
        assert sorted(p.stem for p in (DOCS / folder).glob(f"*.{ending}")) == models
    for name in models:
        page = (DOCS / "gallery" / f"{name}.md").read_text(encoding="utf-8")
        assert f"](../_static/gallery/{name}.png)" in page


@pytest.mark.slow
def test_pages_of_the_gallery_are_up_to_date():
    for path, text in written_by("gallery_page").pages().items():
        shown = (DOCS / path).read_text(encoding="utf-8")
        assert same_output(text, shown), f"{path}: run  python docs/gallery_page.py"


@pytest.mark.slow
def test_pictures_of_the_gallery(tmp_path):
    """Each has something drawn on it, and is the one that is shown."""
    pytest.importorskip("matplotlib")
    from matplotlib.image import imread

    drawn = written_by("gallery_page").draw(tmp_path)
    assert [p.stem for p in drawn] == sorted(library.list_models())
    assert all(0.002 < float((imread(p)[..., :3].min(axis=-1) < 0.9).mean()) < 0.6 for p in drawn)
    assert all(docs.same_picture(p, DOCS / "_static" / "gallery" / p.name) for p in drawn)


DESIGN = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
JOURNEYS = re.findall(r"^`[^`\n]*`, from [^\n]*:\n\n((?:\d+\. .*\n)+)", DESIGN, re.MULTILINE)
STATION = re.compile(r"\d+\. `(kempe(?:\.\w+)+)` [^.]*\.")


def test_there_are_three_journeys_of_at_most_ten_stations():
    assert [1 < journey.count("\n") <= 10 for journey in JOURNEYS] == [True] * 3


@pytest.mark.parametrize("station", [line for journey in JOURNEYS for line in journey.splitlines()])
def test_stations_of_journeys_exist(station):
    """Looked up in the sources, since kernels are imported only where Numba is."""
    match = STATION.match(station)
    assert match, f"{station!r} is no name with one sentence"
    parts = match[1].split(".")
    folder = next(i for i in range(len(parts), 0, -1) if (ROOT / "src" / Path(*parts[:i])).is_dir())
    inside = (ROOT / "src" / Path(*parts[:folder])) / "__init__.py"
    path = inside.with_name(f"{parts[folder]}.py")
    names = parts[folder + 1 :]
    path, names = (path, names) if path.exists() else (inside, parts[folder:])
    body: list[ast.stmt] = sources.tree(path).body
    for name in names:
        found = [
            n for n in body if isinstance(n, (ast.FunctionDef, ast.ClassDef)) and n.name == name
        ]
        assert found, f"{name} is not in {path.name}"
        body = found[-1].body


# ---- general sentences

trust = written_by("trust_page")


def test_claims_stand_on_their_pages():
    pages = {
        c.page: " ".join((ROOT / c.page).read_text(encoding="utf-8").split())
        for c in trust.claims()
    }
    assert not [c for c in trust.claims() if c.sentence not in pages[c.page]]
    assert len({c[:2] for c in trust.claims()}) == len(trust.claims()) > 100


def test_claims_name_hunts():
    """A hunt, a property by Hypothesis or a battery of cases, which exists; a plain example hunts
    nothing.
    """
    assert not [
        (c.sentence, test) for c in trust.claims() for test in c.tests if not trust.kind(test)
    ]
    assert all(c.tests for c in trust.claims())


@pytest.mark.parametrize(
    ("test", "kind"),
    [
        ("tests/test_claims.py::test_unknown_keys_of_files_are_errors", "hunt"),
        ("tests/forward/test_forward.py::test_poses_of_random_systems", "property"),
        ("tests/test_bad_files.py::test_what_is_said", "battery"),
        ("tests/test_docs.py::test_claims_name_hunts", ""),
        ("tests/test_docs.py::test_that_is_not_there", ""),
        ("tests/test_nowhere.py::test_x", ""),
        ("tests/test_docs.py", ""),
    ],
)
def test_kinds_of_tests(test, kind):
    assert trust.kind(test) == kind


def cheat_sheet(column: int) -> list[str]:
    """The code in one column of its tables."""
    lines = (DOCS / "cheat_sheet.md").read_text(encoding="utf-8").splitlines()
    rows = [line.split("|") for line in lines if line.startswith("| ")]
    return [
        code for row in rows if len(row) > column for code in re.findall(r"`([^`]+)`", row[column])
    ]


@pytest.mark.parametrize("code", cheat_sheet(2))
def test_what_the_cheat_sheet_calls_can_be_called(code):
    """Names exist, and calls have all arguments that are needed, and none that are not known."""
    owners = {
        "robot": kempe.load("puma560"),
        "system": kempe.load("four_bar"),
        "m": kempe.Mechanism("m"),
    }
    owners["kempe"] = kempe
    tree = ast.parse(code, mode="eval")
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    for node in calls or [tree.body]:
        function = eval(
            ast.unparse(node.func if isinstance(node, ast.Call) else node), dict(owners)
        )
        assert function is not None
        if isinstance(node, ast.Call) and "..." not in map(ast.unparse, node.args):
            inspect.signature(function).bind(*node.args, **{k.arg: k.value for k in node.keywords})


def test_names_of_pinocchio_in_the_cheat_sheet_exist():
    pin = pytest.importorskip("pinocchio")
    import pinocchio.visualize

    model = pin.buildSampleModelManipulator()
    owners = {"model": model, "data": model.createData()}
    codes = [code.split("(")[0].split("[")[0] for code in cheat_sheet(4)]
    assert len(codes) > 10
    for code in codes:
        owner, _, name = code.rpartition(".")
        assert hasattr(owners.get(owner, pin), name) or hasattr(pinocchio.visualize, name), code
