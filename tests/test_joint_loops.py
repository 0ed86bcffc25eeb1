"""Each joint type as each possible cut of a loop, both ways round, in the plane and in space:
answers do not change.

Judged by poses that `reference` multiplies out, by the same mechanism cut elsewhere, and by the
same mechanism with each joint taken apart into elementary joints.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from closed_graphs import Closed, closed, random_closed, stays_in_plane
from hunts import some
from numpy.typing import ArrayLike
from oracles import closures
from own_joints import (
    OWN,
    PRODUCTS,
    BallInTube,
    Crooked,
    Geared,
    PinSlot,
    Rail,
    SlotFirst,
    declared,
    registered,
    variants,
)

from kempe import Mechanism, System, convert, tasks
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.equations import closure_rows
from kempe.errors import DescriptionError, InputError, UnknownNameError, UnsupportedError
from kempe.joints import (
    TYPES,
    Cylindrical,
    Free,
    JointType,
    P,
    Planar,
    Primitive,
    Q,
    R,
    Revolute,
    make_joint_type,
)
from kempe.model.implicit_form import find_implicit_form
from kempe.views.drawing import symbols
from kempe.views.drawing.scene import build_scene
from kempe.views.drawing.solids import Solids

pytestmark = pytest.mark.usefixtures("solved_as_marked")
NEAR = 0.1
"""How far starts are from a closed configuration, in radians and metres."""
KINDS = [kind(**options) for kind in (*TYPES.values(), *OWN) for options in variants(kind, 0.3)]
BALL = make_joint_type("spherical")
KINDS += map(make_joint_type, PRODUCTS)
CASES = [
    (kind, dim)
    for kind in KINDS
    for dim in (2, 3)
    if dim == 3 or kind.planar and stays_in_plane(kind)
]


def nullity(s: System, q: np.ndarray) -> int:
    """Freedoms to first order in full form, where no coordinate is left out."""
    J = closure_rows.evaluate_constraints(s, q, scaled=True)[1]
    return s.nv - np.linalg.matrix_rank(J, tol=1e-7)


def check(shape: Closed, cuts: list[frozenset[str]], rng: np.random.Generator) -> None:
    """All cuts of a mechanism, and the mechanism taken apart, agree; each closes from near."""
    apart = shape.system(apart=True)
    freedoms = {nullity(apart, shape.values(apart, apart=True))}
    for cut in cuts:
        s = shape.system(cut)
        q = shape.values(s)
        assert (
            shape.open_by(s, q) < 1e-11
            and np.abs(s.loops.closure_error(q)).max(initial=0.0) < 1e-11
        )
        freedoms.add(nullity(s, q))
        for constraint in s.loops.constraints():
            assert np.abs(constraint.residual(s, q)).max(initial=0.0) < 1e-10, constraint.name
        start = s.configuration_space.integrate(q, rng.uniform(-NEAR, NEAR, s.nv))
        for nearest in (False, True) if cut == cuts[0] else (False,):
            answer = s.assemble(start=start, prefer="nearest" if nearest else None)
            assert answer.success, s.structure.closures
            assert shape.open_by(s, answer.q) < 1e-9
        if cut != cuts[0]:
            continue  # poses know no cut
        read = convert.from_maximal(
            s,
            convert.to_maximal(s, q),
            start=s.configuration_space.integrate(q, rng.uniform(-0.02, 0.02, s.nv)),
        )
        assert shape.open_by(s, read) < 1e-7
        np.testing.assert_allclose(s.fk(read), s.fk(q), rtol=0, atol=1e-8)
    assert len(freedoms) == 1, freedoms


def cuts_of(shape: Closed) -> list[frozenset[str]]:
    return [frozenset({link.name}) for link in shape.links]


def partners(dim: int) -> list[JointType]:
    return [Revolute(), Planar()] if dim == 2 else [BALL, Cylindrical()]


@pytest.mark.parametrize("backwards", some([False, True], 3), ids=["forward", "backwards"])
@pytest.mark.parametrize(("kind", "dim"), some(CASES, 4), ids=str)
def test_each_type_as_each_cut(kind, dim, backwards):
    """Rings of three joints in which this type has each place, cut at each joint."""
    rng = np.random.default_rng(5)
    for place in range(3):
        kinds = partners(dim)
        kinds.insert(place, kind)
        shape = closed(rng, dim, 2, kinds, backwards, ring=True)
        cut = {s.structure.closures for s in map(shape.system, cuts_of(shape))}
        assert len(cut) == 3, "each joint was cut"
        check(shape, cuts_of(shape), rng)


@pytest.mark.parametrize(("kind", "dim"), some(CASES, 3), ids=str)
@pytest.mark.parametrize("own", [False, True])
def test_closures_in_numpy(own, kind, dim):
    """Rows of the loop, also where it is open, by differences; where it is closed they hold what
    the judge's do.
    """
    shape = closed(
        np.random.default_rng(6), dim, 2, [BALL if dim == 3 else Revolute(), Free(), kind]
    )
    s = shape.system(frozenset({"j2"}))
    steps = 1e-6 * np.eye(s.nv)
    judge = closures.closure_of(s, "j2", own or find_implicit_form(kind, dim) is None)
    for closure in [c for c in closure_rows.list_constraints(s, own) if c.name == "j2"]:
        q = s.random(3)
        ends = [
            [closure.residual(s, s.configuration_space.integrate(q, x * e)) for x in (1, -1)]
            for e in steps
        ]
        by_differences = np.stack([(a - b) / 2e-6 for a, b in ends], axis=-1)
        np.testing.assert_allclose(closure.jacobian(s, q), by_differences, rtol=0, atol=1e-6)
        q = shape.values(s)
        J = closure.jacobian(s, q)
        K = judge.jacobian(s, q)
        assert [np.linalg.matrix_rank(M, tol=1e-7) for M in (J, K, np.vstack([J, K]))] == 3 * [
            len(J)
        ]
        assert not own or closure.size == (6 if dim == 3 else 3) == len(
            closure_rows.list_row_names(s)
        )


@pytest.mark.parametrize(("kind", "dim"), some(CASES, 3), ids=str)
def test_coordinates_of_a_cut_joint_can_be_known_held_or_coupled(kind, dim):
    shape = closed(
        np.random.default_rng(8), dim, 2, [BALL if dim == 3 else Revolute(), Free(), kind]
    )
    s = shape.system(frozenset({"j2"}))
    q = shape.values(s)
    at = s.q_dict(shape.values(s))
    mine = [n for n in s.structure.coordinates_of_joint("j2") if n in s.structure.velocity_names]
    start = s.configuration_space.integrate(q, np.random.default_rng(1).uniform(-NEAR, NEAR, s.nv))
    for name in mine:
        answer = s.assemble({name: at[name]}, start=start)
        assert (
            answer.success
            and s.q_dict(answer.q)[name] == at[name]
            and shape.open_by(s, answer.q) < 1e-9
        )
        held = s.mechanism.lock({name: at[name]}).build()
        locked = held.assemble(
            start=held.q({n: x for n, x in s.q_dict(start).items() if n != name})
        )
        assert locked.success
        whole = s.q({**held.q_dict(locked.q), name: at[name]})
        assert shape.open_by(s, whole) < 1e-9
        back = convert.from_maximal(held, convert.to_maximal(held, locked.q), start=locked.q)
        np.testing.assert_allclose(held.fk(back), held.fk(locked.q), rtol=0, atol=1e-8)
    if mine:
        m = s.mechanism.copy()
        driver = "j1.x"
        m.gear(mine[0], driver, 0.7, at[mine[0]] - 0.7 * at[driver])
        geared = m.build()
        free = geared.q({n: x for n, x in s.q_dict(start).items() if n != mine[0]})
        answer = geared.assemble(start=free)
        assert answer.success
        value = 0.7 * geared.q_dict(answer.q)[driver] + at[mine[0]] - 0.7 * at[driver]
        assert shape.open_by(s, s.q({**geared.q_dict(answer.q), mine[0]: value})) < 1e-9


def test_random_mechanisms(hunt):
    """Mechanisms of one to three loops, of joints of the table and of random types, cut anywhere."""
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        hunted(random_closed(rng), rng)


@pytest.mark.slow
def test_random_mechanisms_at_length(hunt):
    """A thousand of them."""
    rng = hunt.rng()
    for _ in range(hunt.cases(1000)):
        hunted(random_closed(rng), rng)


def hunted(shape: Closed, rng: np.random.Generator) -> None:
    names = [link.name for link in shape.links]
    count = len(shape.links) - len(shape.bodies)
    check(
        shape, [frozenset(rng.choice(names, count, replace=False).tolist()) for _ in range(3)], rng
    )


# ------------------------------------------------------------------ all verbs, where a type of
# one's own is the cut


def slotted(cut: str = "", apart: bool = False) -> System:
    """A crank whose pin drives a slotted lever: the pin turns in the lever's slot, and slides along
    it.
    """
    m = Mechanism("slotted lever", dim=2)
    crank = m.body("crank")
    lever = m.body("lever")
    m.revolute("A", m.ground, crank, cut=cut == "A", actuated=True)
    m.revolute("B", m.ground, lever, at=(1.0, 0.0), cut=cut == "B")
    m.frame("tip", lever, at=(-1.5, 0.0))
    if apart:
        block = m.body("block")
        m.prismatic("S.x", lever, block, axis=(1, 0), cut=cut == "S")
        m.revolute("S.rz", block, crank, child_at=(0.4, 0.0))
    else:
        m.joint("S", PinSlot(), lever, crank, child_at=(0.4, 0.0), cut=cut == "S")
    m.posture("closed", {"A": 0.0, "B": 0.0, "S.x": -0.6})
    return m.build()


SLOTTED = {cut: slotted(cut) for cut in "ABS"} | {"apart": slotted("S", apart=True)}
each_cut = pytest.mark.parametrize("s", SLOTTED.values(), ids=SLOTTED)


def lever_angle(a: ArrayLike) -> np.ndarray:
    """Angle of the lever by trigonometry, for a crank of 0.4 m and centres 1 m apart."""
    return np.arctan2(-0.4 * np.sin(a), 1.0 - 0.4 * np.cos(a))


def test_cuts_are_what_they_say():
    assert [SLOTTED[cut].structure.closures for cut in "ABS"] == [("A",), ("B",), ("S",)]
    assert SLOTTED["apart"].structure.closures == ("S.x",)


@each_cut
def test_the_slotted_lever_assembles(s):
    angles = np.linspace(0.0, 6.0, 61)
    answer = s.assemble({"A": angles}, start=s.q("closed"), prefer="continuous")
    assert np.all(answer.success)
    at = {name: answer.q[:, i] for i, name in enumerate(s.coordinate_names)}
    np.testing.assert_allclose(at["B"], lever_angle(angles), rtol=0, atol=1e-9)
    np.testing.assert_allclose(at["S.x"], -np.sqrt(1.16 - 0.8 * np.cos(angles)), rtol=0, atol=1e-9)


@each_cut
def test_the_slotted_lever_moves(s):
    start = s.assemble({"A": 0.3}, start=s.q("closed")).q
    m = s.mobility(start)
    assert (
        m.dof == 1 and m.counting.gruebler == 1 and not m.idle_freedoms and m.redundancy.number == 0
    )
    path = s.trace("A", start)
    assert path.closed and np.abs(s.loops.closure_error(path.q)).max() < 1e-9
    turned = path.q[:, s.coordinate_names.index("A")]
    assert np.ptp(turned) == pytest.approx(2 * np.pi, abs=1e-6)
    np.testing.assert_allclose(
        path.q[:, s.coordinate_names.index("B")], lever_angle(turned), rtol=0, atol=1e-8
    )
    times = np.linspace(0.0, 1.0, 11)
    drive = s.drive({"A": lambda t: 0.3 + 2.0 * t}, times, start=start)
    np.testing.assert_allclose(
        drive.q[:, s.coordinate_names.index("B")], lever_angle(0.3 + 2.0 * times), rtol=0, atol=1e-9
    )
    rate = (lever_angle(0.3 + 1e-5) - lever_angle(0.3 - 1e-5)) / 2e-5
    assert s.loops.jacobian(start, ["A"], ["B"]).matrix[0, 0] == pytest.approx(rate, abs=1e-9)
    assert s.independent(start).dim == 1
    assert s.loops.mechanical_advantage(start, "A", "B") == pytest.approx(1.0 / rate, rel=1e-6)


@each_cut
def test_the_slotted_lever_is_placed(s):
    start = s.assemble({"A": 0.9}, start=s.q("closed")).q
    X = s.fk(start, "tip")
    found = s.ik(tasks.Pose("tip", X), start=s.assemble({"A": 0.7}, start=start).q)
    assert found.success
    assert np.abs(s.loops.closure_error(found.q)).max() < 1e-8
    np.testing.assert_allclose(s.fk(found.q, "tip"), X, rtol=0, atol=1e-7)
    modes = s.assembly_modes({"A": 0.9})
    assert len(modes.q) == 2 and np.abs(s.loops.closure_error(modes.q)).max() < 1e-9
    every = s.ik_all(X, "tip")
    assert any(np.abs(s.configuration_space.difference(q, start)).max() < 1e-6 for q in every.q)
    np.testing.assert_allclose(
        s.fk(every.q, "tip"), np.broadcast_to(X, (len(every), 4, 4)), atol=1e-9
    )
    with pytest.raises(UnsupportedError, match="loop that joint"):
        s.inverse.plan("tip")
    step = s.ik_step(
        start, tasks.Pose("tip", s.fk(s.assemble({"A": 0.91}, start=start).q, "tip")), dt=0.01
    )
    # it is damped
    assert step.velocity[s.structure.velocity_names.index("A")] == pytest.approx(1.0, abs=0.05)


@each_cut
def test_poses_of_the_slotted_lever(s):
    q = s.assemble({"A": np.linspace(-1, 1, 5)}, start=s.q("closed")).q
    poses = convert.to_maximal(s, q)
    np.testing.assert_allclose(convert.from_maximal(s, poses, start=q), q, rtol=0, atol=1e-10)
    off = np.array(poses)
    off[..., 0, 0, 3] += 1e-3
    with pytest.raises(InputError, match=r"violate joint"):
        convert.from_maximal(s, off)


@pytest.mark.parametrize("kind", [Revolute(), Geared()], ids=str)
@pytest.mark.parametrize("slide", [Rail(), TYPES["prismatic"]()], ids=str)
def test_a_slider_crank_of_own_hinges_and_rails(kind, slide):
    """In closed form by dyads where each joint is one motion in its unit, else by search: the same
    poses.
    """
    m = Mechanism("slider crank", dim=2)
    crank = m.body("crank")
    rod = m.body("rod")
    block = m.body("block")
    m.revolute("A", m.ground, crank)
    m.joint("B", kind, crank, rod, at=(0.3, 0.0))
    m.revolute("C", rod, block, at=(1.0, 0.0))
    m.joint("D", slide, m.ground, block, axis=(1, 0) if slide.type_name == "prismatic" else None)
    s = m.build()
    modes = s.assembly_modes({"A": 0.8})
    x = np.sort(s.fk(modes.q, "block")[:, 0, 3])
    expected = 0.3 * np.cos(0.8) + np.array([-1.0, 1.0]) * np.sqrt(1.0 - (0.3 * np.sin(0.8)) ** 2)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-9)


def test_a_geared_hinge_returns_after_its_own_period():
    """0.4 of a turn a turn: the motor's coordinate makes five turns until all is as before, and no
    fewer count.
    """
    m = Mechanism("four bar", dim=2)
    a, b, c = (m.body(n) for n in "abc")
    m.joint("A", Geared(), m.ground, a, actuated=True)
    m.revolute("B", a, b, at=(0.2, 0.0))
    m.revolute("C", b, c, at=(0.9, 0.0))
    m.revolute("D", m.ground, c, at=(1.0, 0.0), child_at=(0.6, 0.0))
    s = m.build()
    assert not s.structure.coordinates.turning[s.structure.velocity_names.index("A.motor")]
    q = s.assemble({"A.motor": 0.5}).q
    turns = s.assemble({"A.motor": 0.5 + 2 * np.pi * np.array([1, 5])}, start=q).q
    poses = s.fk(turns, "a")
    assert np.abs(poses[0] - s.fk(q, "a")).max() > 0.5
    np.testing.assert_allclose(poses[1], s.fk(q, "a"), rtol=0, atol=1e-9)
    assert len(s.assembly_modes({"A.motor": 0.5}).q) == 2


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        (Rail(), 5),
        (PinSlot(), 4),
        (SlotFirst(), 4),
        (Crooked(), None),
        (BallInTube(), None),
    ],
)
def test_redundant_constraints_of_own_types(kind, number):
    """Two rails in parallel, of which one is a pin in a slot: the slot's pin holds what the rail
    holds already.
    """
    m = Mechanism("parallel")
    body = m.body("b")
    m.joint("first", Rail(), m.ground, body)
    m.joint("second", kind, m.ground, body, at=(0, 1, 0), child_at=(0, 1, 0), cut=True)
    s = m.build()
    found = s.mobility(s.neutral).redundancy
    assert found is not None
    if number is not None:
        assert found.number == number, kind
    assert "redundant" in str(found)


# ------------------------------------------------------------------ files, drawings, declarations


def test_files_hold_registered_types():
    with registered():
        for kind in OWN:
            for options in variants(kind, 0.125):
                m = Mechanism("own", dim=3)
                m.joint(
                    "j",
                    kind.type_name,
                    m.ground,
                    m.body("b"),
                    at=(1, 2, 3),
                    rpy=(0.1, 0.2, 0.3),
                    **options,
                )
                text = write_toml(m)
                assert f'type = "{kind.type_name}"' in text and read_toml(text) == m
                assert read_toml(text).build() == m.build()
    assert not {kind.type_name for kind in OWN} & TYPES.keys()
    with pytest.raises(DescriptionError, match="not in the table of joints"):
        write_toml(m)
    with pytest.raises(UnknownNameError, match="pin_slot"):
        from kempe.joints import make_joint_type

        make_joint_type("pin_slot")


@pytest.mark.parametrize(
    ("kind", "dim"),
    some(
        [
            (PinSlot(), 2),
            (Geared(), 2),
            (Crooked(), 3),
            (BallInTube(), 3),
            (make_joint_type("P(x) R(z)"), 2),
            (make_joint_type("P(x) R(z) R(y)"), 3),
        ],
        3,
    ),
    ids=str,
)
def test_own_types_are_drawn(kind, dim):
    pytest.importorskip("matplotlib").use("Agg")
    from matplotlib import pyplot

    shape = closed(np.random.default_rng(3), dim, 2, [*partners(dim), kind])
    s = shape.system(frozenset({"j2"}))
    q = shape.values(s)

    def drawn(q: np.ndarray) -> set[str]:
        axes = s.plot(q)
        pyplot.close("all")
        if dim == 2:
            return {str(a.get_gid()) for a in axes.findobj()}
        solids = Solids()
        symbols.add_scene(solids, build_scene(s, q), 0.02, None)
        return set(solids.named)

    assert any(g.startswith("joint:j2") for g in drawn(q)), "a symbol"
    assert not any(g.startswith("open:j2") for g in drawn(q))
    assert any(
        g.startswith("open:j2")
        for g in drawn(s.configuration_space.integrate(q, np.full(s.nv, 0.4)))
    )


def faults() -> Iterator[tuple[str, tuple, tuple, str]]:
    one = Primitive(R, "z", 0)
    yield "same names", ("a", "a"), (one, Primitive(R, "x", 1)), "a name of its own"
    yield "no name", ("", "a"), (one, Primitive(R, "x", 1)), "a name of its own"
    yield "idle coordinate", ("a", "b"), (one,), "no primitive has its coordinate 'b'"
    yield (
        "multiplier 0",
        ("a",),
        (one._replace(multiplier=0.0),),
        "no primitive has its coordinate 'a'",
    )
    yield "unknown kind", ("a",), (Primitive(7, "z", 0),), "is not R, P or Q"
    yield "unknown axis", ("a",), (Primitive(R, "w", 0),), "is not R, P or Q"
    yield "no such coordinate", ("a",), (Primitive(R, "z", 1),), "there is 1 coordinate"
    yield "negative coordinate", ("a",), (Primitive(R, "z", -1),), "there is 1 coordinate"
    yield "short quaternion", ("w", "x", "y"), (Primitive(Q, "z", 0),), "there are 3 coordinates"
    yield "not finite", ("a",), (one._replace(multiplier=np.nan),), "multiplier nan"
    yield "stretched quaternion", tuple("wxyz"), (Primitive(Q, "z", 0, 2.0),), "multiplier 2"
    yield (
        "shared quaternion",
        tuple("wxyz"),
        (Primitive(Q, "z", 0), Primitive(R, "z", 2)),
        "shares no coordinate",
    )
    yield (
        "two quaternions",
        tuple("wxyzabcd"),
        (Primitive(Q, "z", 0), Primitive(Q, "z", 4)),
        "at most one",
    )
    yield (
        "name of a velocity",
        ("w", "x", "y", "z", "wx"),
        (Primitive(Q, "z", 0), Primitive(R, "z", 4)),
        "velocities",
    )


@pytest.mark.parametrize(
    ("names", "primitives", "said"), [f[1:] for f in faults()], ids=[f[0] for f in faults()]
)
def test_wrong_declarations_are_refused(names, primitives, said):
    kind = declared("odd", [])
    object.__setattr__(kind, "layout", lambda *_: (names, primitives))
    m = Mechanism()
    with pytest.raises(
        DescriptionError, match=rf"joint 'j': joint type 'odd' is not declared well.*{said}"
    ):
        m.joint("j", _Fixed(names, primitives)(), m.ground, m.body("b"))


def _Fixed(names: tuple, primitives: tuple) -> type[JointType]:
    return type(
        "Odd", (JointType,), {"type_name": "odd", "layout": lambda *_, **__: (names, primitives)}
    )


@pytest.mark.parametrize(
    "steps",
    [
        [Primitive(R, "x", 0)],
        [Primitive(Q, "z", 0)],
        [Primitive(P, "z", 0), Primitive(R, "z", 1)],
        [Primitive(P, "z", 0), Primitive(P, "x", 1)],
    ],
    ids=str,
)
def test_types_that_leave_the_plane_are_refused(steps):
    m = Mechanism(dim=2)
    with pytest.raises(
        DescriptionError, match="leaves the plane; in the plane a joint turns about z"
    ):
        m.joint("j", declared("odd", steps), m.ground, m.body("b"))


def test_the_table_is_as_before_after_a_registration():
    before = dict(TYPES)
    with pytest.raises(ZeroDivisionError), registered():
        assert len(TYPES) == len(before) + len(OWN)
        _ = 1 / 0
    assert before == TYPES and list(before) == list(TYPES)
    assert len(list(itertools.chain(OWN))) >= 5
