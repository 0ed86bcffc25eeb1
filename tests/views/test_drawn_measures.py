"""What pictures write and draw of lengths, values and constraints, against what was built."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe import Mechanism

pytest.importorskip("matplotlib")
from kempe.views.drawing import page, symbols
from kempe.views.drawing.scene import build_scene
from kempe.views.drawing.solids import Solids


def texts(ax) -> dict[str, str]:
    return {str(t.get_gid()): t.get_text() for t in ax.texts}


@pytest.mark.parametrize(
    ("length", "said"),
    [(-0.4929, "-0.4929 m"), (-0.0456, "-45.6 mm"), (0.0, "0 m"), (-2e-5, "-20 µm"), (3.0, "3 m")],
)
def test_a_length_has_a_unit_by_its_size_whatever_its_sign(length, said):
    assert page.format_length(length) == said


def test_values_stand_beside_the_arcs_of_angles():
    """Of an arm in the plane and of one in space, and zero where a value is but rounding."""
    arm = kempe.load("two_link")
    said = texts(arm.plot([0.5, 1e-17], labels=("coordinates",), angles=True))
    assert said["label:angle:q1"] == "q1 = 0.5 rad" and said["label:angle:q2"] == "q2 = 0 rad"
    said = texts(arm.plot([0.5, 1e-17], labels=("joints",), angles=True))
    assert said["label:angle:q1"] == "q1"
    m = Mechanism("gantry")
    m.prismatic("lift", m.ground, m.body("trolley"), axis="z")
    m.revolute("turn", "trolley", m.body("arm"), at=(0.5, 0, 0))
    said = texts(m.build().plot([0.7, 0.25], labels="all", angles=True))
    assert (
        said["label:angle:lift"] == "lift = 0.7 m" and said["label:angle:turn"] == "turn = 0.25 rad"
    )


def test_only_lengths_that_a_body_has_are_dimensions():
    """A wheel, which has nothing but its joint, has none; a triangle in space has those of its
    three sides.
    """
    m = Mechanism("wheel and plate")
    m.revolute("axle", m.ground, m.body("wheel"), axis="y")
    plate = m.body("plate")
    m.free("J", m.ground, plate)
    for name, at in (("a", (0, 0, 0)), ("b", (0.3, 0, 0)), ("c", (0, 0.4, 0))):
        m.spherical(name, plate, m.body(f"arm {name}"), at=at)
        m.frame(f"end {name}", f"arm {name}", at=(0, 0, 0.25))
    said = texts(m.build().plot({"J.y": 1.0}, labels=False, dimensions=True))

    def of(body):
        return sorted(x for gid, x in said.items() if gid.startswith(f"label:dimension:{body}:"))

    assert (
        of("wheel") == []
        and of("plate") == ["0.3 m", "0.4 m", "0.5 m"]
        and of("arm a") == ["0.25 m"]
    )


def test_a_rod_to_the_ground_ends_at_a_ground_symbol():
    m = Mechanism("hook", dim=2)
    m.translation("J", m.ground, m.particle("p"))
    m.distance("hook", m.ground, "p", length=0.5, at=(0.2, 0.1))
    m.distance("other", m.ground, "p", length=0.5, at=(0.2, 0.1))
    patches = {str(p.get_gid()): p for p in m.build().plot({"J.x": 0.5, "J.y": 0.5}).patches}
    corners = patches["ground:hook"].get_path().vertices
    assert (
        np.linalg.norm(corners - [0.2, 0.1], axis=1).min() < 1e-9 and "ground:other" not in patches
    )
    m = Mechanism("in space")
    m.free("J", m.ground, m.particle("p"))
    m.distance("hook", m.ground, "p", length=1.0, at=(0, 0, 1))
    solids = Solids()
    system = m.build()
    symbols.add_scene(solids, build_scene(system, system.neutral), 0.02, None)
    assert [name for name in solids.named if name.startswith("ground:")] == ["ground:0"]


def test_a_point_on_a_plane_lies_on_a_plate_and_not_on_a_line():
    """The plate is flat along the plane, through the point; a point on a line keeps its line."""
    m = Mechanism("on both")
    m.free("J", m.ground, m.body("b"))
    m.frame("tip", "b", at=(0.3, 0, 0))
    m.constrain(kempe.constraints.OnPlane("tip", normal=(1, 2, 2)), "plane")
    m.constrain(kempe.constraints.OnLine("b", direction=(0, 0, 1)), "line")
    system = m.build()
    scene = build_scene(system, system.assemble().q)
    (mark,) = scene.marks
    assert [line[0] for line in scene.lines] == ["line"] and mark.name == "plane"
    assert np.allclose(mark.plane[1], np.array([1, 2, 2]) / 3) and np.allclose(
        mark.plane[0], mark.point, atol=1e-6
    )


def test_a_place_out_of_reach_is_shown_with_its_distance():
    """Of an arm of 0.9 m in the plane with a target at 1.25 m, and of one in space; where it is
    reached nothing.
    """
    arm = kempe.load("two_link")
    ax = arm.plot(arm.ik([1.0, 0.75], "e"))
    (line,) = (x for x in ax.get_lines() if x.get_gid() == "missed")
    assert np.allclose(line.get_xydata(), [[0.72, 0.54], [1.0, 0.75]], atol=1e-5)
    assert texts(ax)["label:missed"] == "0.35 m"
    assert "label:missed" not in texts(arm.plot(arm.ik([0.6, 0.3], "e")))
    puma = kempe.load("puma560")
    far = puma.ik([2.0, 0.0, 0.0], "tool")
    ax = puma.plot(far, labels=False)
    (line,) = (x for x in ax.get_lines() if x.get_gid() == "missed")
    assert np.allclose(np.array(line.get_data_3d())[:, 1], [2.0, 0.0, 0.0])
    assert texts(ax)["label:missed"] == page.format_length(float(f"{far.position_error:.3g}"))


def test_a_car_has_wheels_at_each_of_several_places():
    """Along its heading, half a turn to the left and on it."""
    car = kempe.load("car")
    patches = {
        str(p.get_gid()): p for p in car.plot([[0, 0, 0], [1, 2, np.pi / 2], [3, 0, 0]]).patches
    }
    for name, along in (("configuration1", 1), ("configuration2", 0)):
        corners = patches[f"{name}:rear axle:wheel0"].get_path().vertices
        wide = np.ptp(corners, axis=0)
        assert wide[along] > 2 * wide[1 - along]
