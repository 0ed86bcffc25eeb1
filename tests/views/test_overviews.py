"""The tree as text and as a picture, the joint types, and what notebooks show, by the numbers of
the lecture.
"""

from __future__ import annotations

import base64
import html
import re

import numpy as np
import pytest
from drawn import artists
from hunts import some

import kempe
from kempe import library
from kempe.errors import InputError, UnsupportedError
from kempe.joints import TYPES, make_joint_type

pytest.importorskip("matplotlib")
from kempe.views import overviews

SEVEN = """0 B0
└─ J1 (revolute) ─ 1 B1
   ├─ J2 (revolute) ─ 2 B2
   │  ├─ J3 (prismatic) ─ 3 B3
   │  └─ J8 (revolute) ─ 7 B7
   └─ J4 (revolute) ─ 4 B4
      ├─ J5 (revolute) ─ 5 B5
      └─ J7 (prismatic) ─ 6 B6
╌╌ J6 (prismatic) closes a loop: B0 ╌ B5
C = {0, 1, 2, 1, 4, 4, 2}"""


# ---- the tree


def test_the_tree_of_the_seven_bodies_as_text():
    assert "\n".join(overviews.list_tree_lines(kempe.load("seven_bodies_loop"))) == SEVEN


def test_the_tree_of_the_seven_bodies_as_a_picture():
    """Each body stands one row below its parent, leaves beside one another, J6 is cut, C is
    written.
    """
    system = kempe.load("seven_bodies_loop")
    ax = system.plot_tree()
    found = artists(ax)
    at = {n: found[f"body:{n}"][0].get_xydata()[0] for n in system.body_names}
    for body, parent in enumerate(system.parent, 1):
        child = at[f"B{body}"]
        above = at[f"B{parent}"]
        assert above[1] - child[1] == pytest.approx(1.4)
        line = found[f"edge:{system.structure.parent_joints[body - 1]}"][0].get_xydata()
        assert np.allclose(line, [above, child])
    cut = found["cut:J6"][0]
    assert cut.get_linestyle() == "--" and np.allclose(
        cut.get_xydata()[[0, -1]], [at["B0"], at["B5"]]
    )
    assert found["connectivity"][0].get_text() == "C = {0, 1, 2, 1, 4, 4, 2}"
    assert (
        found["label:J3"][0].get_text() == "J3  P" and found["label:J6"][0].get_color() != "black"
    )


def humanoid() -> kempe.System:
    """A tree with long names, several of them beside one another."""
    m = kempe.Mechanism("humanoid")
    m.revolute("waist", m.ground, m.body("torso"))
    m.revolute("neck", "torso", m.body("head"), at=(0, 0, 0.5))
    for side, y in (("left", 0.2), ("right", -0.2)):
        m.spherical(f"{side}_shoulder", "torso", m.body(f"{side}_upper_arm"), at=(0, y, 0.4))
        m.revolute(f"{side}_elbow", f"{side}_upper_arm", m.body(f"{side}_forearm"), at=(0, 0, -0.3))
        m.spherical(f"{side}_hip_of_the_leg", m.ground, m.body(f"{side}_thigh"), at=(0, 0.5 * y, 0))
    return m.build()


def chain_of_long_names() -> kempe.System:
    m = kempe.Mechanism("chain")
    name = "part_of_the_second_station_at_the_left_of_the_long_assembly_line"
    m.revolute(f"{name}_joint_1", m.ground, m.body(f"{name}_body_1"))
    m.revolute(f"{name}_joint_2", f"{name}_body_1", m.body(f"{name}_body_2"), at=(0, 0, 1))
    return m.build()


@pytest.mark.parametrize("make", [humanoid, chain_of_long_names])
def test_names_in_a_tree_can_be_read(make):
    """They stay on the paper, do not touch one another, and every circle has a number; long ones
    keep both ends.
    """
    system = make()
    ax = system.plot_tree()
    draw = ax.figure.canvas.get_renderer()
    boxes = {t.get_text(): t.get_window_extent(draw) for t in ax.texts}
    assert {str(k) for k in range(len(system.body_names))} <= set(boxes)
    paper = ax.figure.bbox
    said = list(boxes.items())
    for k, (text, box) in enumerate(said):
        assert paper.x0 <= box.x0 and box.x1 <= paper.x1, text
        for other, more in said[:k]:
            assert not box.overlaps(more), (text, other)
    if make is chain_of_long_names:
        assert "part_of_the_sec…bly_line_joint_2  R" in boxes


@pytest.mark.parametrize("name", ["stewart", "andrews_squeezer", "panda"])
def test_circles_of_trees_lie_apart(name):
    at = overviews._place_bodies(kempe.load(name))
    gaps = np.linalg.norm(at[:, None] - at, axis=-1)[np.triu_indices(len(at), 1)]
    assert gaps.min() >= 0.99


@pytest.mark.slow
def test_a_long_chain_has_a_tree():
    m = kempe.Mechanism("chain", dim=2)
    body = m.ground
    for k in range(3000):
        m.revolute(f"j{k}", body, body := m.body(f"b{k}"), at=(1.0, 0.0))
    lines = overviews.list_tree_lines(system := m.build())
    assert len(lines) == 3002 and lines[2999].endswith("└─ j2998 (revolute) ─ 2999 b2998")
    assert (
        overviews._place_bodies(system)[-1, 1] == -3000
        and "... and 2962 more" in system._repr_html_()
    )


# ---- joint types


def test_letters_of_joint_types():
    assert {n: t().letter for n, t in TYPES.items()} == {
        "fixed": "",
        "revolute": "R",
        "prismatic": "P",
        "helical": "H",
        "cylindrical": "C",
        "universal": "U",
        "planar": "E",
        "translation": "T",
        "spherical": "S",
        "free": "F",
    }
    assert make_joint_type("P(x) R(z) R(y)").letter == "PRR"


@pytest.mark.slow
def test_all_joint_types_in_one_picture():
    axes = overviews.plot_joints()
    assert [ax.get_title() for ax in axes][:2] == ["revolute, 1 freedom", "prismatic, 1 freedom"]
    assert len(axes) == len(TYPES) - 1 and all(ax.collections for ax in axes)
    assert len(overviews.plot_joints(["revolute", "spherical"])) == 2
    with pytest.raises(InputError, match="names has 'hinge'; there are: fixed, revolute"):
        overviews.plot_joints(["hinge"])


def test_a_row_for_each_joint_type():
    """Six less the constraints are the freedoms, in the plane three less."""
    rows = overviews.list_joint_types()
    assert [row["type"] for row in rows] == list(TYPES)
    assert all(row["dof"] + row["constraints"] == 6 for row in rows)
    plane = [row for row in rows if row["dof_in_the_plane"] is not None]
    assert plane and all(
        row["dof_in_the_plane"] + row["constraints_in_the_plane"] == 3 for row in plane
    )


# ---- notebooks


@pytest.mark.parametrize(
    "name", some(["two_link", "four_bar", "bennett", "seven_bodies_loop", "ball", "panda"], 3)
)
def test_a_system_in_a_notebook(name):
    system = kempe.load(name)
    page = system._repr_html_()
    (data,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert base64.b64decode(data)[1:4] == b"PNG"
    said = html.unescape(page)
    assert overviews.format_connectivity(system) in said and all(
        joint in said for joint in system.joint_names
    )
    assert system.mechanism._repr_html_() == page


@pytest.mark.parametrize(
    ("name", "said"),
    [("car", "3 degrees of freedom.*; 2 of velocity"), ("two_link", "dimension 2<")],
)
def test_freedoms_of_velocity_are_said_in_notebooks(name, said):
    """A car has three freedoms of position, and at every moment two."""
    assert re.search(said, kempe.load(name)._repr_html_())


def test_names_are_escaped_in_notebooks():
    m = kempe.Mechanism("<b>", dim=2)
    m.revolute("<i>", m.ground, m.body("<u>"))
    page = m._repr_html_()
    assert not re.findall(r"<[biu]>", page) and "&lt;i&gt;" in page


def test_what_cannot_be_built_or_drawn_is_text():
    m = kempe.Mechanism("parts")
    m.body("loose")
    assert m._repr_html_() is None
    far = kempe.Mechanism("far", dim=2)
    far.revolute("A", far.ground, far.body("b"), at=(1e300, 0.0))
    assert "C = {0}" in far.build()._repr_html_() and "<img" not in far.build()._repr_html_()
    with pytest.raises(
        UnsupportedError, match="body 'b' is 1e[+]300 from the origin; up to 1e[+]100 can be drawn"
    ):
        far.build().plot()


@pytest.mark.slow
@pytest.mark.parametrize("name", library.list_models())
def test_every_model_in_a_notebook(name):
    page = kempe.load(name)._repr_html_()
    assert page.count("<img") == 1 and "freedom" in page or "DoF" in page or "Gruebler" in page


NOTEBOOK = {
    "import kempe": 0,
    "kempe.load('two_link')": 0,
    "kempe.load('four_bar').mechanism": 0,
    "kempe.load('four_bar').plot()": 1,
    "kempe.load('seven_bodies').plot_tree();": 1,
    "import matplotlib.pyplot as plt\nkempe.load('puma560').plot()\nplt.show()": 1,
    "arm = kempe.load('two_link')\narm.ik_all([0.6, 0.3], 'e').plot(workspace='e')": 1,
    "arm.ik_all(arm.fk(arm.random(0, 1000), 'e')[:, :2, 3], 'e')": 0,
    "arm.configuration_space": 0,
    "kempe.load('four_bar').trace('A')": 0,
}
"""Cells, and how many pictures each shows."""


@pytest.mark.slow
def test_cells_of_a_notebook_show_pictures():
    """Run by Jupyter's own client; texts are a screen at most."""
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    cells = [nbformat.v4.new_code_cell(source) for source in NOTEBOOK]
    book = nbformat.v4.new_notebook(cells=cells)
    nbclient.NotebookClient(book, timeout=300, kernel_name="python3").execute()
    for cell, pictures in zip(book.cells, NOTEBOOK.values(), strict=True):
        data = [o["data"] for o in cell.outputs if "data" in o]
        assert sum("image/png" in d for d in data) == pictures, cell.source
        assert all(len(d.get("text/plain", "")) < 2500 for d in data), cell.source
    assert "data:image/png" in book.cells[1].outputs[0]["data"]["text/html"]
