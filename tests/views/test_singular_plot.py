"""Pictures of singular configurations: arrows, centres and curves are those of closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from drawn import artists

import kempe
from kempe import Budget
from kempe.errors import InputError

pytest.importorskip("matplotlib")
from matplotlib.figure import Figure

FEW = Budget(starts=12)
ARM = kempe.load("two_link")


def test_an_arm_has_lost_the_direction_of_its_links():
    found = ARM.singularities("e", budget=FEW)
    axes = found.plot()
    assert [ax.get_title().splitlines() for ax in axes[:2]] == [
        ["serial, q2 = 0", "1 direction lost"],
        ["serial, q2 = 3.14", "1 direction lost"],
    ]
    for ax, x in zip(axes, (0.0, np.pi), strict=False):
        (arrow,) = artists(ax)["lost:0"]
        q = min(found.sets[0].q, key=lambda q: abs(q[1] - x))
        way = np.subtract(arrow.xy, arrow.xyann)
        link = ARM.fk(q, "e")[:2, 3]
        assert abs(way[0] * link[1] - way[1] * link[0]) < 1e-9 and np.linalg.norm(way) > 0.1
    radii = {
        round(float(np.hypot(*v[0].get_data())[0]), 9)
        for k, v in artists(axes[2]).items()
        if "singular" in k
    }
    assert len(axes) == 3 and radii == {0.9, 0.1}


@pytest.mark.slow
def test_a_platform_gains_a_turn_about_where_the_legs_meet():
    robot = kempe.load("three_rrr")
    found = robot.singularities("tool", budget=Budget(starts=24))
    axes = found.plot()
    assert len(axes) == len(found.sets) == 2  # the sets are surfaces: there are no curves
    (two,) = (k for k, s in enumerate(found.sets) if s.kinds == ("type 2",))
    q = found.sets[two].q[0]
    (twist,) = found.sets[two].gained[0]
    assert set(artists(axes[two])) >= {"gained:0"} and "lost:0" not in artists(axes[two])
    centre = robot.fk(q, "tool")[:2, 3] + np.array([-twist[1], twist[0]]) / twist[5]
    drawn = artists(axes[two]).get("gained:0:centre")
    assert drawn is None or np.ravel(drawn[0].get_data()) == pytest.approx(centre)
    for k in (1, 2, 3) if drawn else ():  # the lines of the distal links go through it
        link = robot.fk(q, f"link{k}")
        to = centre - link[:2, 3]
        assert abs(to[0] * link[1, 0] - to[1] * link[0, 0]) < 1e-6


def test_in_space_arrows_are_those_of_the_twists():
    puma = kempe.load("puma560")
    found = puma.singularities("tool", budget=Budget(starts=24))
    axes = found.plot()
    assert [ax.get_title().splitlines()[0].split(",")[0] for ax in axes] == [
        s.name for s in found.sets
    ]
    assert all("lost:0" in artists(ax) for ax in axes)


def test_curves_draw_themselves_on_axes_that_are_given():
    curves = ARM.singularities("e", budget=FEW).curves()
    ax = Figure().subplots()
    assert curves.plot(ax) is ax and ax.get_legend().get_texts()[0].get_text() == "serial"
    held = (
        kempe.load("puma560")
        .singularities("tool", budget=FEW)
        .curves(hold={"q2": 0.3, "q4": 0.2, "q5": 0.7, "q6": 0.1})
    )
    assert hasattr(held.plot(), "get_zlim")


def test_what_is_not_drawn_says_so():
    m = kempe.Mechanism("gantry", dim=2)
    m.prismatic("x", m.ground, m.body("a"), axis=(1, 0), limits=(0, 1))
    m.prismatic("y", "a", m.body("b"), axis=(0, 1), limits=(0, 1))
    none = m.build().singularities("b")
    with pytest.raises(InputError, match="no singular configuration found.*nothing to draw"):
        none.plot()
    with pytest.raises(InputError, match="no curve.*nothing to draw"):
        none.curves().plot()
    with pytest.raises(InputError, match="3 matplotlib axes"):
        ARM.singularities("e", budget=FEW).plot(ax=Figure().subplots())
    dead = kempe.load("four_bar").singularities(inputs=["A"], budget=FEW)
    assert not dead.sets or len(dead.plot())  # without a frame there are no arrows


def offset_arm():
    """Six turns with offsets, whose elbow is singular at two angles."""
    m = kempe.Mechanism("offset arm")
    before = "ground"
    places = [(0, 0, 0.3), (0.1, 0, 0.1), (0.05, 0, 0.4), (0.1, 0, 0.05), (0.3, 0, 0), (0, 0, 0)]
    for k, (axis, at) in enumerate(zip("zyyxyx", places, strict=True)):
        m.revolute(f"j{k}", before, m.body(f"b{k}"), at=at, axis=axis, limits=(-2.8, 2.8))
        before = f"b{k}"
    m.fixed("flange", before, m.body("tcp"), at=(0.5, 0, 0))
    return m.build()


@pytest.mark.slow
def test_each_set_is_drawn_before_a_second_of_one():
    found = offset_arm().singularities("tcp", budget=Budget(starts=64))
    assert len(found.sets) == 4 and len(found.sets[2].values) == 2
    heads = [ax.get_title().split("\n")[0].split(",")[0] for ax in found.plot()]
    assert heads == [s.name for s in found.sets]


def test_the_frame_is_in_view_where_it_is_a_body_beyond_the_last_joint():
    system = offset_arm()
    found = system.singularities("tcp", budget=FEW)
    for ax, s in zip(found.plot(), found.sets, strict=False):
        for x, name in zip(system.fk(s.q[0], "tcp")[:3, 3], "xyz", strict=True):
            low, high = getattr(ax, f"get_{name}lim")()
            assert low < x < high
