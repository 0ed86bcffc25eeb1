"""What a notebook shows of everything that a cell can end with."""

from __future__ import annotations

import ast
import base64
import importlib
import io
import re
from pathlib import Path

import numpy as np
import pytest
import sources
from hunts import some
from matplotlib.image import imread

import kempe
from kempe.errors import MissingExtraError

SCREEN = 40
"""Lines of one screen."""
MANY = 300
ARM, BAR, TWO = kempe.load("puma560"), kempe.load("four_bar"), kempe.load("two_link")
SOURCE = Path(kempe.__file__).parent
FOUND = [
    (f"kempe.{path.relative_to(SOURCE).with_suffix('').as_posix().replace('/', '.')}", node.name)
    for folder in ("kinematics", "solvers", "analysis")
    for path in sorted((SOURCE / folder).rglob("*.py"))
    for node in sources.tree(path).body
    if isinstance(node, ast.ClassDef) and any(getattr(x, "name", "") == "__str__" for x in node.body)
]
"""Modules and names of classes with a text of their own."""


@pytest.mark.parametrize(("module", "name"), FOUND)
def test_what_has_a_text_is_shown_by_it(module, name):
    """Instead of the text with all fields that a dataclass has; tuples are shown as they are."""
    kind = getattr(importlib.import_module(module), name)
    assert issubclass(kind, tuple) or hasattr(kind, "_repr_html_") or hasattr(kind, "_repr_latex_")


def poses(n: int) -> np.ndarray:
    return ARM.fk(ARM.random(0, n), ARM.frame_names[-1])


BATCHES = {
    "ik": lambda n: ARM.ik(poses(n), ARM.frame_names[-1]),
    "ik of tasks": lambda n: ARM.ik([kempe.tasks.Position(ARM.frame_names[-1], poses(n)[:, :3, 3])]),
    "ik_all": lambda n: ARM.ik_all(poses(n), ARM.frame_names[-1]),
    "assemble": lambda n: BAR.assemble({"A": np.linspace(0.0, 6.0, n)}),
    "close": lambda n: BAR.loops.closed_form(["A"]).close(np.linspace(0.0, 6.0, n)[:, None]),
    "jacobian": lambda n: BAR.loops.jacobian(np.zeros((n, 1)) + BAR.assemble().q, ["A"], ["D"]),
    "sample": lambda n: ARM.configuration_space.sample(n, 0),
    "poses": lambda n: ARM.reach.poses(poses(n), ARM.frame_names[-1]),
    "drive": lambda n: BAR.drive({"A": np.linspace(0.3, 0.6, n)}, start=BAR.assemble({"A": 0.3}).q),
}


@pytest.mark.parametrize("name", BATCHES)
def test_a_batch_is_one_screen(name):
    """As text and in a notebook."""
    found = BATCHES[name](MANY)
    page = found._repr_html_()
    assert len(str(found).splitlines()) <= SCREEN and str(MANY) in str(found)
    assert page.count("<tr>") + page.count("<p>") + page.count("<br>") <= SCREEN and str(MANY) in page


def picture(page: str) -> np.ndarray:
    """The only picture of a page."""
    (data,) = re.findall(r'<img alt="[^"]+" src="data:image/png;base64,([^"]+)"/>', page)
    return imread(io.BytesIO(base64.b64decode(data)))[..., :3]


MAPS = {
    "workspace": lambda: TWO.workspace("e", n=5000, cells=16),
    "planar": lambda: TWO.reach.planar("e"),
    "capability": lambda: TWO.reach.capability("e", [[-2.0, -2.0], [2.0, 2.0]], 4, 4),
    "place": lambda: TWO.reach.place(TWO.fk(TWO.random(0, 3), "e"), "e", {"x": (-1, 1), "y": (-1, 1)}, 3),
}


@pytest.mark.parametrize("name", some(MAPS, 3))
def test_maps_show_their_picture(name, monkeypatch):
    """Below their words, in more than one colour; without matplotlib the words alone."""
    found = MAPS[name]()
    drawn = picture(found._repr_html_())
    assert min(drawn.shape[:2]) > 150 and len(np.unique(drawn.reshape(-1, 3), axis=0)) > 20

    def missing(self, *options):
        raise MissingExtraError("matplotlib", "view")

    monkeypatch.setattr(type(found), "plot", missing)
    assert "<img" not in found._repr_html_() and found.status in str(found)


def test_symbolic_results_are_formulas():
    """With a legend where names are short: c1 stands for cos(q1)."""
    short = TWO.symbolic.short(TWO.symbolic.fk("e")[0, 3])
    assert r"c_{1} &= \cos" in short._repr_latex_() and "l_{1}" in short._repr_latex_()
    for found in (
        short,
        TWO.symbolic.steps("e"),
        TWO.symbolic.ik("e"),
        TWO.symbolic.fk("e"),
        TWO.symbolic.jacobian("e"),
    ):
        assert found._repr_latex_().startswith("$") and found._repr_latex_().endswith("$")


WORDED = {
    "constraints": lambda: BAR.loops.constraints(),
    "assembler": lambda: BAR.loops.assembler(["A"]),
    "wrenches": lambda: BAR.mobility().wrenches,
    "short": lambda: TWO.symbolic.fk("e", short=True),
    "history": lambda: TWO.ik([2.0, 0.0], "e", history=True).history,
    "loops": lambda: BAR.loops,
    "structure": lambda: BAR.structure,
    "query": lambda: TWO.query("e"),
    "designs": lambda: TWO.with_parameters(l1=np.linspace(0.1, 0.5, 4)),
}  # fmt: skip


@pytest.mark.parametrize("name", WORDED)
def test_a_cell_shows_words_and_no_arrays(name):
    """On one screen, without places in memory, and with names that the system has."""
    found = WORDED[name]()
    text = str(found)
    assert " at 0x" not in text and "array(" not in text and len(text.splitlines()) <= SCREEN and len(text) < 3000
    assert any(word in text for word in ("C", "two_link", "four_bar", "c12", "start"))
    assert not hasattr(found, "_repr_html_") or found._repr_html_().count("<p>") <= SCREEN


def test_a_short_formula_is_printed_with_what_it_stands_for():
    """Read back with the legend put in it is the long one; a difference of angles does not look like a subtraction."""
    import sympy

    m = kempe.Mechanism("crossed")
    m.revolute("q1", m.ground, m.body("a"))
    m.revolute("q2", "a", m.body("b"), at=(0.5, 0, 0), axis="-z")
    m.frame("e", "b", at=(0.25, 0, 0))
    long = m.build().symbolic.fk("e")[0, 3]
    short = m.build().symbolic.short(long)
    first, *legend = str(short).splitlines()
    assert "c_{1-2}" in first and len(legend) == 2
    pairs = [line.split(" = ") for line in legend]
    names = {word: sympy.Symbol(f"x{k}") for k, (word, _) in enumerate(pairs)}
    for word, name in names.items():
        first = first.replace(word, str(name))
    back = sympy.sympify(first).subs({names[w]: sympy.sympify(meaning) for w, meaning in pairs})
    assert sympy.simplify(back - long) == 0
