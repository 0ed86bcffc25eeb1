"""The implicit form of each joint is the explicit one: the same closed configurations, freedoms and
coordinates.
"""

from __future__ import annotations

import numpy as np
import pytest
from closed_graphs import closed
from own_joints import OWN, Coaxial, declared, random_type, variants

from kempe import System
from kempe.assemble.bound import Assembler
from kempe.equations import closure_rows as full
from kempe.joints import TYPES, Free, Helical, JointType, P, Primitive, Q, R, Revolute, Spherical
from kempe.kernels.compiled import closure_batch
from kempe.model.implicit_form import find_implicit_form, find_screw_pitch, has_slide_along_z
from kempe.model.packed_loops import PackedLoops, find_explicit_joints, get_packed_loops

TABLE = [kind(**options) for kind in TYPES.values() for options in variants(kind, 0.3)]
EVERY = [*TABLE, Helical(1.0), *(t() for t in OWN)]
CASES = [(kind, dim) for kind in EVERY for dim in (2, 3) if dim == 3 or kind.planar]
FORMS = {
    "fixed": ("xyz", "xyz"),
    "revolute": ("xyz", "xy"),
    "prismatic": ("xy", "xyz"),
    "helical": None,
    "cylindrical": ("xy", "xy"),
    "universal": ("xyz", "x.y"),
    "planar": ("z", "xy"),
    "translation": ("", "xyz"),
    "spherical": ("xyz", ""),
    "free": ("", ""),
    "pin_slot": ("yz", "xy"),
    "slot_pin": None,
    "crooked": None,
    "turned_table": None,
    "cross_slide": ("z", "xy"),
    "other_cardan": None,
    "drill": None,
    "coaxial": None,
    "ball_in_tube": ("xy", ""),
    "ball_on_stick": None,
    "geared": None,
    "rail": ("yz", "xyz"),
    "telescope": None,
    "diagonal": None,
}
"""What types hold in space: positions and rotations; None for those that are explicit."""


@pytest.mark.parametrize("kind", EVERY, ids=str)
def test_what_is_held(kind):
    form = find_implicit_form(kind)
    expected = FORMS.get(kind.type_name, "not in the list: add what it holds")
    assert expected == (None if form is None else (form.position, form.turns))
    if form is not None:
        held = len(form.position) + {"xyz": 3, "xy": 2, "x.y": 1, "": 0}[form.turns]
        assert held == kind.constraints()


def test_screws_are_recognised_by_their_primitives():
    turn = Primitive(R, "z", 0)
    slide = Primitive(P, "z", 0, 0.3)
    assert find_screw_pitch(Helical(0.3)) == find_screw_pitch(declared("s", [slide, turn])) == 0.3
    for steps in (
        [turn],
        [turn, slide._replace(coordinate=1)],
        [turn, slide._replace(axis="x")],
        [turn, turn],
        [turn._replace(multiplier=2.0), slide],
    ):
        assert find_screw_pitch(declared("s", steps)) is None


def loop(rng: np.random.Generator, kind: JointType, dim: int) -> tuple[System, np.ndarray]:
    """A body that moves freely, and a joint of this kind that closes a loop; closed at the
    configuration given back.
    """
    shape = closed(rng, dim, 2, [Spherical() if dim == 3 else Revolute(), Free(), kind])
    s = shape.system(frozenset({"j2"}))
    assert s.structure.closures == ("j2",)
    return s, shape.values(s)


def evaluated(system: System, loops: PackedLoops, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual and Jacobian of packed loops at configurations (n, nq)."""
    out = np.empty((len(q), len(loops.names)))
    columns = np.empty((len(q), len(loops.names), system.nv))
    closure_batch.evaluate_equations(
        loops.ints, loops.floats, loops.plan, loops.weights, np.zeros((1, 0)), q, True, out, columns
    )
    return out, columns


def nullity(J: np.ndarray) -> int:
    return J.shape[1] - np.linalg.matrix_rank(J, tol=1e-8)


def compare(system: System, q: np.ndarray, rng: np.random.Generator) -> None:
    """Both forms of the only loop: closed at q, as many freedoms, and each closes where the other
    does.
    """
    explicit = frozenset(system.structure.closures)
    small = get_packed_loops(system, frozenset())
    large = get_packed_loops(system, explicit)
    at = q[None]
    (r, J) = evaluated(system, small, at)
    (R_, K) = evaluated(system, large, at)
    assert np.abs(r).max(initial=0.0) < 1e-12 and np.abs(R_).max(initial=0.0) < 1e-12
    own = [
        system.structure.velocity_names.index(n)
        for n in system.structure.velocity_names
        if n.split(".")[0] == "j2"
    ]
    others = [v for v in range(system.nv) if v not in own]
    assert nullity(J[0][:, others]) == nullity(K[0])
    assert np.linalg.matrix_rank(J[0], tol=1e-8) == len(small.names), "no row too many"
    start = system.configuration_space.integrate(q, rng.uniform(-0.3, 0.3, system.nv))
    for form in (small, large):
        solver = Assembler(system)
        solver.loops = form
        answer = solver({}, start=start)
        assert answer.success
        # coordinates of the joint included
        assert np.abs(full.compute_residual(system, answer.q)).max(initial=0.0) < 1e-9
        assert np.abs(evaluated(system, small, answer.q[None])[0]).max(initial=0.0) < 1e-9


@pytest.mark.parametrize(
    ("kind", "dim"), [c for c in CASES if find_implicit_form(*c) is not None], ids=str
)
def test_the_implicit_form_is_the_explicit_one(kind, dim):
    rng = np.random.default_rng(11)
    for _ in range(4):
        system, q = loop(rng, kind, dim)
        assert find_explicit_joints(system) == frozenset()
        compare(system, q, rng)


@pytest.mark.parametrize(
    ("kind", "dim"), [c for c in CASES if find_implicit_form(*c) is None], ids=str
)
def test_what_has_no_implicit_form_is_explicit(kind, dim):
    system, _ = loop(np.random.default_rng(12), kind, dim)
    assert find_explicit_joints(system) == {"j2"}


def test_random_types(hunt):
    """Implicit forms of random types, most of which have none."""
    rng = hunt.rng()
    found = 0
    for k in range(hunt.cases(150)):
        dim = int(rng.choice([2, 3]))
        steps = list(reordered(rng, dim))
        kind = declared(f"t{k}", steps) if k % 2 else random_type(rng, f"t{k}", dim)
        if find_implicit_form(kind, dim) is not None:
            found += 1
            compare(*loop(rng, kind, dim), rng)
    assert found > 0.3 * hunt.cases(150)


def reordered(rng: np.random.Generator, dim: int) -> list[Primitive]:
    """Slides along some axes in any order, then turns that are likely to have a implicit form,
    coordinates shuffled.
    """
    axes = list(rng.permutation(list("xyz"[:dim]))[: int(rng.integers(0, dim + 1))])
    turns = ["z", ""] if dim == 2 else ["z", "xy", "zyx", "", "yx", "Q"]
    about = str(rng.choice(turns))
    if about == "Q":
        return [Primitive(Q, "z", 0), *(Primitive(P, str(a), 4 + i) for i, a in enumerate(axes))][
            :: -1 if axes else 1
        ]
    kinds = [(P, str(a)) for a in axes] + [(R, a) for a in about]
    order = rng.permutation(len(kinds))
    return [Primitive(kind, axis, int(k)) for (kind, axis), k in zip(kinds, order, strict=True)]


def test_planes_and_particles():
    rail = declared("rail", [Primitive(P, "z", 0)])
    assert has_slide_along_z(rail, 2, False) and not has_slide_along_z(rail, 3, False)
    form = find_implicit_form(rail, 2)
    assert form is not None and (form.position, form.turns, form.readings) == (
        "y",
        "z",
        ((0, "x"),),
    )
    free = find_implicit_form(Free(), 3, particle=True)
    assert free is not None and (free.position, free.turns) == ("", "")
    both = declared("both", [Primitive(P, "z", 0), Primitive(R, "z", 1)])
    assert find_implicit_form(Coaxial()) is None and find_implicit_form(both, 2) is None
