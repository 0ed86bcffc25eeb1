"""One-sided constraints at a configuration: which are closed, and what they allow, against linear
programs.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

import kempe
from kempe.constraints import Clearance
from kempe.equations.closure_rows import evaluate_constraints
from kempe.mobility.one_sided import report_one_sided


def lowest(c, E, G):
    """Where in the cone E v = 0, G v >= 0, within a unit box, c @ v is least."""
    b = None if not len(G) else np.zeros(len(G))
    e = None if not len(E) else np.zeros(len(E))
    return linprog(
        c,
        -G if len(G) else None,
        b,
        E if len(E) else None,
        e,
        bounds=[(-1, 1)] * len(c),
        method="highs",
    ).x


def least(c, E, G):
    """The least of c @ v in the cone, within a unit box."""
    return c @ lowest(c, E, G)


def spanned(E, G, n):
    """Dimension of the cone: directions across those found so far are requested, until none leads
    on.
    """
    found = np.zeros((0, n))
    while len(found) < n:
        across = np.linalg.svd(found)[2][len(found) :] if len(found) else np.eye(n)
        each = (sign * row for row in across for sign in (-1.0, 1.0))
        new = next((v for c in each if abs(c @ (v := lowest(c, E, G))) > 1e-6), None)
        if new is None:
            break
        found = np.linalg.svd(np.vstack([found, new]), full_matrices=False)[2]
    return len(found)


SYSTEMS = (
    "four_bar",
    "puma560",
    "five_bar",
    "two_link",
    pytest.param("stewart", marks=pytest.mark.slow),
)


@pytest.mark.parametrize("name", SYSTEMS)
def test_limits_that_are_reached(name, hunt):
    """Limits are put where coordinates are, below, above, or both; oracle: linear programs over the
    whole cone.
    """
    system = kempe.load(name)
    rng = hunt.rng()
    q = system.mobility(local=False).q
    at = system.structure.layout.vector_q
    v = system.structure.layout.vector_v
    for _ in range(hunt.cases(5)):
        limits = np.column_stack([np.full(system.nv, -np.inf), np.full(system.nv, np.inf)])
        G = []
        for i, k in zip(at, v, strict=True):
            kind = rng.integers(0, 4)
            if kind % 2:
                limits[k, 0] = q[i]
                G.append(np.eye(system.nv)[k])
            if kind > 1:
                limits[k, 1] = q[i]
                G.append(-np.eye(system.nv)[k])
        E = evaluate_constraints(system, q, True, True)[1]
        G = np.array(G).reshape(-1, system.nv)
        found = report_one_sided(system.with_limits(limits), q)
        assert len(found.active) == len(G)
        assert not found.violated
        assert found.dimension == spanned(E, G, system.nv)
        for k in range(system.nv):
            row = np.eye(system.nv)[k]
            ways = found.coordinates[system.structure.velocity_names[k]]
            assert ways == (least(row, E, G) < -1e-6, least(-row, E, G) < -1e-6)


def test_states_and_slacks():
    system = kempe.load("puma560")
    low, high = system.structure.limits.T
    q = system.mid.copy()
    q[0], q[1], q[2] = high[0], low[1] - 0.25, low[2] + 0.5
    found = report_one_sided(system, q)
    assert found.active == ("upper limit of q1",)
    assert found.violated == ("lower limit of q2",)
    side = {s.name: s for s in found.sides}
    assert side["lower limit of q2"].slack == pytest.approx(-0.25)
    assert side["lower limit of q3"].slack == pytest.approx(0.5) and side[
        "lower limit of q3"
    ].ways == (True, True)
    assert "violated: lower limit of q2 by 0.25 rad" in str(found)
    assert "reached; q1 can only shrink" in str(side["upper limit of q1"])


def test_a_gradient_that_is_not_defined_says_nothing():
    """A coin that lies flat: its height above the plane has a corner there."""
    m = kempe.Mechanism("coin")
    m.free("F", m.ground, m.body("coin"))
    m.contact("table", "coin", radius=0.1, shape="disc")
    found = report_one_sided(m.build(), [0, 0, 0, 0.5, 0.5, 0.5, 0.5])
    assert (found.active, found.dimension, found.lineality, found.cone.exact) == (
        ("table",),
        6,
        6,
        False,
    )
    assert "nothing is known to first order" in str(found)


def test_a_contact_at_the_lowest_point_of_a_circle_says_nothing_to_first_order():
    m = kempe.Mechanism("pendulum", dim=2)
    m.revolute("A", m.ground, m.body("link"))
    m.frame("tip", "link", at=(1, 0))
    m.frame("low", m.ground, at=(0, -1))
    m.contact("floor", "tip", on="low")
    system = m.build()
    found = report_one_sided(system, [-np.pi / 2])
    assert (found.active, found.dimension, found.lineality, found.cone.exact) == (
        ("floor",),
        1,
        1,
        False,
    )
    assert system.trace("A", {"A": 0.0}).closed  # it touches, and goes on


def test_opposite_contacts_hold_each_other():
    m = kempe.Mechanism("plates")
    m.free("F", m.ground, m.body("ball"))
    m.frame("top", m.ground, at=(0, 0, 0.2), rpy=(np.pi, 0, 0))
    m.contact("floor", "ball", radius=0.1)
    m.contact("ceiling", "ball", on="top", radius=0.1)
    system = m.build()
    found = report_one_sided(system, [0, 0, 0.1, 1, 0, 0, 0])
    assert (found.dimension, found.lineality) == (5, 5)
    assert "floor: closed; its value can neither grow nor shrink (held by ceiling)" in str(found)
    assert found.find_frame_directions("ball")["z"] == (False, False)
    assert found.find_frame_directions("ball")["x"] == (True, True)
    assert system.mobility([0, 0, 0.1, 1, 0, 0, 0]).dof == 6


def test_a_contact_that_equations_keep_closed():
    """A slider at the height of its own rail: the contact stays closed, whatever moves."""
    m = kempe.Mechanism("rail")
    m.prismatic("S", m.ground, m.body("cart"), at=(0, 0, 0.1), axis=(1, 0, 0))
    m.contact("floor", "cart", radius=0.1)
    found = report_one_sided(m.build(), [0.3])
    assert (found.active, found.dimension, found.lineality) == (("floor",), 1, 1)
    m.joint("J", "planar", m.ground, m.body("tile"), at=(0, 0, 0.1))
    m.contact("under", "tile", radius=0.1)
    m.distance("rod", "cart", "tile", 0.5)
    system = m.build()
    found = report_one_sided(system, system.assemble({"S": 0.3}).q)
    assert set(found.active) == {"floor", "under"} and found.dimension == found.lineality == 3


def test_a_side_that_only_equations_keep_closed():
    """Turned by two crossed rods a slider cannot leave its stop; neither side of it is free, and
    none is vanishing.
    """
    m = kempe.Mechanism("stop", dim=2)
    m.translation("P", m.ground, m.particle("p"))
    m.equation("line", "`P.y` = `P.x`")
    m.equation("other", "`P.y` = -`P.x`")
    m.contact("floor", "p", on=None)
    found = report_one_sided(m.build(), [0.0, 0.0])
    (side,) = found.sides
    assert (
        side.ways == (False, False)
        and side.why == "the equations keep it closed"
        and found.dimension == 0
    )


def test_rolling_is_obeyed_in_the_corner():
    """A ball that rolls on the floor, held against a wall: it may roll along it, spin, go away from
    it, and lift.
    """
    m = kempe.Mechanism("corner")
    m.free("F", m.ground, m.body("ball"))
    m.rolls("roll", "ball", 0.1, one_sided=True)
    m.frame("face", m.ground, at=(1, 0, 0), rpy=(0, -np.pi / 2, 0))
    m.contact("wall", "ball", on="face", radius=0.1)
    found = report_one_sided(m.build(), [0.9, 0, 0.1, 1, 0, 0, 0])
    assert (set(found.active), found.dimension, found.lineality) == ({"roll", "wall"}, 4, 2)
    assert found.coordinates["F.x"] == (True, False)
    assert found.coordinates["F.wy"] == (True, False)
    assert found.coordinates["F.wx"] == (True, True)


def test_mobility_tells_which_limits_are_reached():
    system = kempe.load("two_link").with_limits({"q1": (0.5, 1.0)})
    assert system.mobility([0.7, 0.2]).one_sided is None
    m = system.mobility([0.5, 0.2])
    assert (m.dof, m.rank_dof) == (2, 2)
    assert m.one_sided is not None
    assert m.one_sided.active == ("lower limit of q1",)
    assert (m.one_sided.dimension, m.one_sided.lineality) == (2, 1)
    assert "lower limit of q1: reached; q1 can only grow" in str(m)
    assert m.data()["one_sided"]["active"] == ["lower limit of q1"]


# ---- declared constraints


def gaps(system, q):
    """Gaps of the constraints of `cage` from poses alone, and their inward gradients by central
    differences.
    """

    def values(x):
        hand, elbow, anchor, tray = (system.fk(x, n) for n in ("hand", "elbow", "anchor", "tray"))
        seen = np.linalg.inv(tray) @ hand
        far = np.linalg.norm(hand[:3, 3] - anchor[:3, 3])
        box = np.linalg.inv(anchor) @ elbow
        return np.array(
            [
                seen[2, 3] - 0.05,
                hand[2, 3],
                1.4 - far,
                far - 0.2,
                *(box[:3, 3] + 0.9),
                *(0.9 - box[:3, 3]),
            ]
        )

    steps = 1e-6 * np.eye(system.nv)
    J = [
        (
            values(system.configuration_space.integrate(q, h))
            - values(system.configuration_space.integrate(q, -h))
        )
        / 2e-6
        for h in steps
    ]
    return values(q), np.array(J).T


def cage():
    """An arm of six joints on a slide whose hand touches a tray that turns, a floor, a rope, a box."""
    m = kempe.Mechanism("cage")
    for i, axis in enumerate(((0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))):
        link = m.body(f"link{i}")
        before = m.ground if i == 0 else f"link{i - 1}"
        m.revolute(f"J{i}", before, link, at=(0.1, 0.05 * i, 0.3), axis=axis)
    m.prismatic("S", "link4", m.body("last"), axis=(1, 0, 0))
    m.revolute("T", m.ground, m.body("tray body"), at=(0.3, 0, 0.1), axis=(1, 0, 0))
    m.frame("hand", "last", at=(0.1, 0, 0.05))
    m.frame("elbow", "link2", at=(0, 0.1, 0))
    m.frame("anchor", m.ground, at=(0.2, 0.1, 0.4), rpy=(0.3, 0.2, 0.1))
    m.frame("tray", "tray body", at=(0, 0, 0.1), rpy=(0.1, 0, 0))
    return m


def constrained(q, chosen):
    """The cage with constraints moved so that the chosen gaps are zero at q, and the others are
    open by 0.3.
    """
    system = cage().build()
    values, _ = gaps(system, q)
    out = cage()
    shift = np.where(chosen, values, values - 0.3)
    out.frame(
        "lifted",
        "tray body",
        at=tuple(np.array([0, 0, 0.1]) + shift[0] * tilt()[:, 2]),
        rpy=(0.1, 0, 0),
    )
    out.frame("low", out.ground, at=(0, 0, float(shift[1])))
    out.contact("ball", "hand", on="lifted", radius=0.05)
    out.contact("floor", "hand", on="low")
    out.constrain(
        kempe.constraints.Distance(
            "hand", "anchor", at_least=0.2 + shift[3], at_most=1.4 - shift[2]
        ),
        "rope",
    )
    low = -0.9 + shift[4:7]
    high = 0.9 - shift[7:]
    out.constrain(kempe.constraints.InBox("elbow", low, high, other="anchor"), name="box")
    return out.build()


def tilt():
    c = np.cos(0.1)
    s = np.sin(0.1)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


@pytest.mark.parametrize("number", [12, pytest.param(150, marks=pytest.mark.slow)])
def test_what_declared_constraints_allow(number, hunt):
    """Oracle: gradients by differences of poses, and linear programs."""
    system = cage().build()
    rng = hunt.rng()
    closed = 0
    for _ in range(hunt.cases(number)):
        q = rng.uniform(-1.0, 1.0, system.nq)
        chosen = rng.random(10) < 0.5
        chosen[3] &= not chosen[2]  # two ends of one row are apart
        chosen[7:] &= ~chosen[4:7]
        J = gaps(system, q)[1]
        made = constrained(q, chosen)
        found = report_one_sided(made, q)
        assert not found.violated
        assert len(found.active) == chosen.sum()
        assert np.sort([s.slack for s in found.sides]) == pytest.approx(
            np.sort(np.where(chosen, 0.0, 0.3)), abs=1e-9
        )
        G = J[chosen]
        E = np.zeros((0, system.nv))
        closed += len(G)
        if not len(G):
            continue
        assert found.dimension == spanned(E, G, system.nv)
        for k, name in enumerate(made.structure.velocity_names):
            row = np.eye(system.nv)[k]
            assert found.coordinates[name] == (least(row, E, G) < -1e-6, least(-row, E, G) < -1e-6)
    assert closed > hunt.cases(number)


def test_what_is_open_may_fall_and_rise():
    system = kempe.load("puma560")
    found = report_one_sided(system, system.mid)
    assert len(found.sides) == 12 and all(
        s.state == "open" and s.ways == (True, True) for s in found.sides
    )


def ball_on_slides(*walls: tuple[float, float, float]) -> kempe.System:
    """A ball of radius 0.1 that slides along x, y and z, and cubes of edge 0.2 at some places."""
    m = kempe.Mechanism("ball")
    last = m.ground
    for axis in "xyz":
        m.prismatic(f"s{axis}", last, m.body(axis), axis=axis)
        last = axis
    m.shape("z", "sphere", radius=0.1)
    for k, at in enumerate(walls):
        m.obstacle(f"cube {k}", "box", size=(0.2, 0.2, 0.2), at=at)
    return m.build()


def test_contacts_of_clearances_are_active_at_the_distance_to_be_kept():
    pytest.importorskip("coal")
    keep = Clearance("self", at_least=0.02)
    s = ball_on_slides((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    one = s.mobility([0.78, 0.0, 0.0], clearance=keep)
    assert one.dof == 3 and one.one_sided.active == ("distance of 'z' and 'cube 0'",)
    assert one.one_sided.dimension == 3 and one.one_sided.lineality == 2
    assert [str(x) for x in one.one_sided.coordinates.values()] == [
        "can only shrink", "can grow and shrink", "can grow and shrink",
    ]  # fmt: skip
    assert "distance of 'z' and 'cube 0': closed; its value can only grow" in str(one)
    two = report_one_sided(s, [0.78, 0.78, 0.0], clearance=[keep])
    assert len(two.active) == 0 and "open by" in two.lines[0], "a corner is further away"
    assert "one-sided" in str(s.mobility([0.0, 0.0, 0.0], clearance=keep))
    far = report_one_sided(s, [0.0, 0.0, 0.5], clearance=keep)
    assert far.active == () and far.lines == ["distance of 'z' and 'cube 2': open by 0.28 m"]
    near = report_one_sided(s, [0.85, 0.0, 0.0], clearance=keep)
    assert near.violated == ("distance of 'z' and 'cube 0'",)
    assert near.status == "violated: distance of 'z' and 'cube 0' by 0.07 m"
    assert s.mobility([0.78, 0.0, 0.0]).one_sided is None


def test_bodies_that_are_clamped_between_contacts_move_along_them_only():
    pytest.importorskip("coal")
    s = ball_on_slides((0.22, 0.0, 0.0), (-0.22, 0.0, 0.0))
    found = report_one_sided(s, [0.0, 0.0, 0.0], clearance=Clearance(at_least=0.02))
    assert len(found.active) == 2 and found.dimension == found.lineality == 2
    assert str(found.coordinates["sx"]) == "can neither grow nor shrink"
    assert all("held by distance of 'z' and 'cube" in line for line in found.lines[:2])


def test_hunt_a_step_that_a_closed_contact_allows_keeps_the_distance(hunt):
    """Two arms of spheres that rest against one another: rays of the cone open the contact."""
    pytest.importorskip("coal")
    rng = hunt.rng()
    compared = 0
    for _ in range(hunt.cases(40)):
        m = kempe.Mechanism("arms")
        for side, x in (("a", -0.4), ("b", 0.4)):
            last = m.ground
            for k in range(3):
                at = (0, 0, 0.4) if k else (x, 0, 0)
                m.revolute(f"{side}{k}", last, m.body(f"{side}{k}"), at=at, axis="xyz"[k])
                last = f"{side}{k}"
            m.shape(last, "sphere", radius=0.1, at=(0.1, 0.05, 0.3))
        s = m.build()
        q = s.random(rng)
        d = s.geometry.clearance(q)
        found = report_one_sided(s, q, clearance=Clearance("a2", "b2", at_least=max(d, 0.0)))
        if d < 0.0:
            assert found.violated
            continue
        assert len(found.active) == 1 and found.dimension == 6 and found.lineality == 5
        compared += 1
        v = found.scale * found.cone.rays[0]
        ahead, behind = (s.geometry.clearance(q + h * v) for h in (1e-6, -1e-6))
        assert ahead > d > behind
        for w in found.scale * found.cone.free:
            assert abs(s.geometry.clearance(q + 1e-6 * w) - d) < 1e-10
    assert compared > 5
