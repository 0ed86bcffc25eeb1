"""Hypothesis strategies for mechanisms of any kind that the builder accepts."""

from __future__ import annotations

import math

from hypothesis import strategies as st

from kempe.description.mechanism import Mechanism, declare_placed_constraint
from kempe.poses import Placement, place, read_placement_steps

NAMES = st.text(
    st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=6
).filter(str.strip)
NUMBERS = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, math.pi / 2, 1e-300, -1e16, 0.1]),
    st.floats(-10.0, 10.0, allow_subnormal=True),
)
AXES = st.sampled_from(
    [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -2.0), (0.1, -0.2, 0.3)]
)
TURNS = {
    3: [
        "fixed",
        "revolute",
        "prismatic",
        "helical",
        "cylindrical",
        "universal",
        "planar",
        "spherical",
        "free",
    ],
    2: ["fixed", "revolute", "planar", "free"],
}
SLIDES = {3: ["translation", "free", "fixed"], 2: ["translation", "free", "planar", "fixed"]}


@st.composite
def values(draw, parameters):
    """A number, or an expression in the parameters."""
    number = draw(NUMBERS)
    if parameters and draw(st.booleans()):
        name = draw(st.sampled_from(parameters))
        return draw(st.sampled_from([name, f"{name}/2", f"1 - cos({name})", f"({name})"]))
    return number


@st.composite
def placements(draw, dim, parameters):
    """A placement by the usual keywords, or by any steps, in space or in the plane."""
    one = values(parameters)
    if dim == 2:
        if draw(st.booleans()):
            return place(at=(draw(one), draw(one)), angle=draw(one))
        motions = draw(st.lists(st.sampled_from(["x", "y", "rz"]), max_size=4))
        return read_placement_steps([[m, draw(one)] for m in motions])
    kind = draw(st.integers(0, 4))
    at = (draw(one), draw(one), draw(one))
    if kind == 0:
        return place(at=at, rpy=(draw(one), draw(one), draw(one)), axis=draw(st.none() | AXES))
    if kind == 1:
        return place(at=at, quat_wxyz=(1.0, draw(one), draw(one), 0.5), axis=draw(st.none() | AXES))
    if kind == 2:
        return place(at=at, matrix=[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    scalars = st.tuples(st.sampled_from(["x", "y", "z", "rx", "ry", "rz"]), one).map(list)
    aligned = st.tuples(st.sampled_from(["align", "unalign"]), AXES).map(lambda t: [t[0], *t[1]])
    X = read_placement_steps(draw(st.lists(scalars | aligned, max_size=4)))
    return X.invert_steps() if kind == 4 else X


@st.composite
def limits(draw):
    """Lower and upper limit, either of which may be missing."""
    lower, upper = sorted((draw(NUMBERS), draw(NUMBERS)))
    return draw(
        st.sampled_from(
            [(lower, upper), (lower, math.inf), (-math.inf, upper), (-math.inf, math.inf)]
        )
    )


@st.composite
def mechanisms(draw):
    """A mechanism with a joint to each body and a few more, which close loops."""
    dim = draw(st.sampled_from([2, 3]))
    names = draw(st.lists(NAMES, min_size=2, max_size=6, unique=True))
    m = Mechanism(draw(NAMES), dim, ground=names[0])
    parameters = draw(st.lists(st.sampled_from(["l1", "l2", "α"]), max_size=2, unique=True))
    for name in parameters:
        m.parameter(name, draw(NUMBERS))
    for name in names[1:]:
        if draw(st.integers(0, 4)) == 0:
            m.particle(name, mass=draw(st.none() | st.floats(0.0, 9.0)))
        else:
            center = draw(st.none() | st.tuples(NUMBERS, NUMBERS, NUMBERS))
            m.body(
                name,
                draw(st.none() | st.floats(0.0, 9.0)),
                center,
                draw(st.lists(st.text(max_size=9), max_size=2)),
            )
    ends = [(draw(st.integers(0, i - 1)), i) for i in range(1, len(names))]
    ends += draw(
        st.lists(
            st.tuples(*[st.integers(0, len(names) - 1)] * 2).filter(lambda e: e[0] != e[1]),
            max_size=2,
        )
    )
    for number, (a, b) in enumerate(ends):
        _joint(
            draw,
            m,
            f"{draw(st.sampled_from(['J', 'é ', '日本.']))}{number}",
            names[a],
            names[b],
            parameters,
        )
    for name in draw(st.lists(NAMES, max_size=2, unique=True)):
        if name not in m.bodies:
            body = draw(st.sampled_from(names))
            X = Placement() if m.bodies[body].particle else draw(placements(dim, parameters))
            m.frame(name, body, at=X)
    _constraints(draw, m, parameters)
    _relations(draw, m, parameters)
    m.notes = draw(st.lists(st.text(max_size=9), max_size=2))
    return m


def _joint(draw, m: Mechanism, name: str, parent: str, child: str, parameters: list[str]) -> None:
    if m.bodies[parent].particle:
        parent, child = (child, parent) if not m.bodies[child].particle else (m.ground.name, child)
    if parent == child:
        return
    particle = m.bodies[child].particle
    kind = draw(st.sampled_from((SLIDES if particle else TURNS)[m.dim]))
    options = {"pitch": draw(NUMBERS)} if kind == "helical" else {}
    if kind in ("spherical", "free") and not particle and m.dim == 3:
        options["angles"] = draw(st.booleans())
    X_PF = draw(placements(m.dim, parameters))
    X_CM = Placement() if particle else draw(placements(m.dim, parameters))
    joint = m.joint(
        name, kind, parent, child, at=X_PF, child_at=X_CM, cut=draw(st.booleans()), **options
    )
    del m.joints[name]
    names = [
        c
        for c in joint.type.list_velocity_names(m.dim, particle)
        if c in joint.type.list_coordinate_names(m.dim, particle)
    ]
    chosen = draw(st.lists(st.sampled_from(names), max_size=2, unique=True)) if names else []
    bounds = {k: {c: draw(st.floats(0.0, 9.0)) for c in chosen} for k in ("velocity", "effort")}
    m.joint(
        name,
        kind,
        parent,
        child,
        at=X_PF,
        child_at=X_CM,
        cut=joint.cut,
        limits={c: draw(limits()) for c in chosen},
        actuated=draw(st.none() | st.booleans()),
        **bounds,
        **options,
    )


def _constraints(draw, m: Mechanism, parameters: list[str]) -> None:
    """Rods, points on lines and in planes, between bodies and particles."""
    for name in draw(st.lists(NAMES, max_size=2, unique=True)):
        a, b = draw(st.permutations(list(m.bodies)))[:2]
        kinds = (
            ["distance"]
            if m.bodies[a].particle
            else ["distance", "point_on_line", "point_on_plane"][: m.dim]
        )
        kind = draw(st.sampled_from(kinds))
        X_PF, X_CM = (
            Placement() if m.bodies[body].particle else draw(placements(m.dim, parameters))
            for body in (a, b)
        )
        axis = (
            draw(st.sampled_from([(1.0, 0.0), (0.6, -0.8)]))
            if (m.dim, kind) == (2, "point_on_line")
            else None
        )
        length = draw(st.sampled_from([1.0, 5e-324, 0.1, 1e300])) if kind == "distance" else None
        if length and parameters:
            length = draw(st.sampled_from([length, f"2 + sin({parameters[0]})"]))
        if name not in m.joints:
            declare_placed_constraint(
                m, name, kind, (a, X_PF, {"axis": axis}), (b, X_CM, {}), length, None
            )


def _relations(draw, m: Mechanism, parameters: list[str]) -> None:
    """Couplings, postures and locks between the coordinates that are no quaternions."""
    names = []
    for joint in m.joints.values():
        for c in joint.type.list_coordinate_names(m.dim, m.bodies[joint.child].particle):
            names += [f"{joint.name}.{c}" if c else joint.name] if c[:1] != "q" else []
    if not names:
        return
    order = draw(st.permutations(names))
    for i, of in enumerate(order[1:3], 1):
        sources = {s: draw(values(parameters)) for s in order[: draw(st.integers(1, i))]}
        m.couple(of, sources, draw(values(parameters)))
    for name in draw(st.lists(NAMES, max_size=2, unique=True)):
        m.posture(
            name,
            {
                c: draw(NUMBERS)
                for c in draw(st.lists(st.sampled_from(names), unique=True, max_size=3))
            },
        )
    if draw(st.booleans()):
        m.lock({names[-1]: draw(NUMBERS)})
