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
from kempe.views import overviews

SCREEN = 40
"""Lines of one screen."""
MANY = 300
ARM = kempe.load("puma560")
BAR = kempe.load("four_bar")
TWO = kempe.load("two_link")
SOURCE = Path(kempe.__file__).parent
FOUND = [
    (f"kempe.{path.relative_to(SOURCE).with_suffix('').as_posix().replace('/', '.')}", node.name)
    for folder in ("kinematics", "solvers", "analysis")
    for path in sorted((SOURCE / folder).rglob("*.py"))
    for node in sources.tree(path).body
    if isinstance(node, ast.ClassDef)
    and any(getattr(x, "name", "") == "__str__" for x in node.body)
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
    "ik of tasks": lambda n: ARM.ik(
        [kempe.tasks.Position(ARM.frame_names[-1], poses(n)[:, :3, 3])]
    ),
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
    assert (
        page.count("<tr>") + page.count("<p>") + page.count("<br>") <= SCREEN and str(MANY) in page
    )


def picture(page: str) -> np.ndarray:
    """The only picture of a page."""
    (data,) = re.findall(r'<img alt="[^"]+" src="data:image/png;base64,([^"]+)"/>', page)
    return imread(io.BytesIO(base64.b64decode(data)))[..., :3]


MAPS = {
    "workspace": lambda: TWO.workspace("e", n=5000, cells=16),
    "planar": lambda: TWO.reach.planar("e"),
    "capability": lambda: TWO.reach.capability("e", [[-2.0, -2.0], [2.0, 2.0]], 4, 4),
    "place": lambda: TWO.reach.place(
        TWO.fk(TWO.random(0, 3), "e"), "e", {"x": (-1, 1), "y": (-1, 1)}, 3
    ),
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
}


@pytest.mark.parametrize("name", WORDED)
def test_a_cell_shows_words_and_no_arrays(name):
    """On one screen, without places in memory, and with names that the system has."""
    found = WORDED[name]()
    text = str(found)
    assert (
        " at 0x" not in text
        and "array(" not in text
        and len(text.splitlines()) <= SCREEN
        and len(text) < 3000
    )
    assert any(word in text for word in ("C", "two_link", "four_bar", "c12", "start"))
    assert not hasattr(found, "_repr_html_") or found._repr_html_().count("<p>") <= SCREEN


def test_a_short_formula_is_printed_with_what_it_stands_for():
    """Read back with the legend put in it is the long one; a difference of angles does not look
    like a subtraction.
    """
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


def records() -> dict[str, object]:
    """What the builder returns, in the plane and in space."""
    m = kempe.Mechanism("arm", dim=2)
    s = kempe.Mechanism("joints")
    m.parameter("l1", 0.3)
    m.revolute(
        "q1", m.ground, m.body("a", mass=2, center=(0.1, 0, 0)), at=("l1", 0), limits=(-1, 1)
    )
    m.prismatic("q2", "a", m.body("b"), axis=(3, 4), actuated=True, limits=(None, 0.3))
    m.translation("q3", m.ground, m.particle("p"), limits={"x": (0, 1)})
    m.revolute("q4", "b", m.body("c"), actuated=False)
    m.constrain(kempe.constraints.Distance("p", "a", 0.3), name="rod")
    m.couple("q4", {"q1": -2, "q2": 1}, "l1")
    s.revolute("r", s.ground, s.body("r1"), axis="-z")
    s.cylindrical("c", s.ground, s.body("c1"), rpy=(s.parameter("l", 0.3), 0, 0))
    s.helical("h", s.ground, s.body("h1"), pitch=0.01)
    s.universal("u", s.ground, s.body("u1"))
    s.spherical("s", s.ground, s.body("s1"))
    found = {
        **m.bodies,
        **m.joints,
        "tip": m.frame("tip", "c", at=("l1", 0)),
        **m.constraints,
        **s.joints,
    }
    return {**found, **{f"of {name}": x for name, x in m.couplings.items()}}


RECORDS = {
    "a": "a: a rigid body, 2 kg, centre of mass at (0.1, 0, 0) m",
    "p": "p: a particle, a body without orientation",
    "tip": "tip: a frame on c, placed by x = l1",
    "rod": "rod: p and a are 0.3 m apart",
    "of q4": "q4 = -2 q1 + q2 + (l1)",
    "q1": "q1: a revolute joint between ground and a, turns about z of ground, from -1 to 1 rad; a cannot slide along "
    "x or y of ground: 2 of 3 freedoms are taken away",
    "q2": "q2: a prismatic joint between a and b, slides along (0.6, 0.8) of a, to 0.3 m, driven by a motor; b cannot "
    "slide along y, nor turn about z of the frame of q2: 2 of 3 freedoms are taken away",
    "q3": "q3: a translation joint between ground and p, which allows: slide along x and y of its frame on ground, "
    "x from 0 to 1 m; p can move freely: 0 of 2 freedoms are taken away",
    "q4": "q4: a revolute joint between b and c, turns about z of b, without limits, passive; c cannot slide along x "
    "or y of b: 2 of 3 freedoms are taken away",
    "r": "r: a revolute joint between ground and r1, turns about -z of ground, without limits; r1 cannot slide along "
    "x, y or z, nor turn about x or y of ground: 5 of 6 freedoms are taken away",
    "c": "c: a cylindrical joint between ground and c1, turns about and slides along z of its frame on ground, without "
    "limits; c1 cannot slide along x or y, nor turn about x or y of the frame of c: 4 of 6 freedoms are taken away",
    "h": "h: a helical joint between ground and h1, screws along z of ground by 0.01 m a rad, without limits; h1 "
    "cannot slide along x or y, nor turn about x or y of ground: 5 of 6 freedoms are taken away, 1 of them by a "
    "relation or about an axis that moves",
    "u": "u: a universal joint between ground and u1, which allows: turn about x of F, then about y of M (F is its "
    "frame on ground, M on u1), without limits; u1 cannot slide along x, y or z of ground: 4 of 6 freedoms are taken "
    "away, 1 of them by a relation or about an axis that moves",
    "s": "s: a spherical joint between ground and s1, which allows: any rotation, without limits; s1 cannot slide "
    "along x, y or z of ground: 3 of 6 freedoms are taken away",
}


@pytest.mark.parametrize("name", RECORDS)
def test_a_record_of_a_mechanism_is_a_sentence(name):
    """Those of a planar mechanism count in the plane."""
    record = records()[name]
    assert record.sentence == RECORDS[name]
    assert record._repr_html_() == f"<p>{RECORDS[name]}</p>"


def test_types_of_joints_and_tasks_are_sentences():
    """At the end of a cell as elsewhere; fields stay in the `repr`."""
    joint = kempe.joints.TYPES["cylindrical"]()
    task = kempe.tasks.Position("tip", (1, 2, 3))
    assert (
        joint._repr_html_()
        == "<p>cylindrical: turn about z, slide along z; 2 DoF, 4 constraints</p>"
    )
    assert task._repr_html_() == f"<p>{task.sentence}</p>" and "tip" in task.sentence
    named = kempe.tasks.Position("tip", (1, 2, 3), name="home")
    assert named._repr_html_() == f"<p>home: {named.sentence}</p>"


def test_a_screw_without_a_pitch_is_made_of_its_pitch():
    rows = {row["type"]: row["made_of"] for row in overviews.list_joint_types()}
    assert rows["helical"] == "R(z) P(z, pitch q)"
    assert kempe.joints.Helical(0.02).decomposition == "R(z) P(z, 0.02 q)"
