"""Other names and another order of declaration: the same tree, counts, ranks, sets of solutions and
single answers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from closed_graphs import closed
from hunts import some
from shipped import shipped, with_loops

import kempe
from kempe import Mechanism, System
from kempe.joints import make_joint_type

NEAR = 0.1
"""How far starts are from a closed configuration, in radians and metres."""


def renamed(system: System, rng: np.random.Generator) -> tuple[System, dict[str, str]]:
    """The same mechanism with other names of bodies and joints, declared in another order; and the
    new names.
    """
    m = system.mechanism
    bodies = list(m.bodies)
    joints = list(m.joints)
    texts = [
        f"{'xyzabc'[int(rng.integers(6))]}{n}"
        for n in rng.permutation(2 * (len(bodies) + len(joints)))
    ]
    new = {m.ground.name: m.ground.name}
    for name in (*bodies, *joints):
        new.setdefault(name, texts.pop())
    coordinates = {
        c: new[j] + c[len(j) :] for j in joints for c in system.structure.coordinates_of_joint(j)
    }
    coordinates |= {v: new[j] + v[len(j) :] for j in joints for v in velocity_names(system, j)}
    mixed = lambda names: [names[int(k)] for k in rng.permutation(len(names))]  # noqa: E731
    order = [m.ground.name, *mixed([b for b in bodies if b != m.ground.name])]
    m.bodies = {new[b]: replace(m.bodies[b], name=new[b]) for b in order}
    m.joints = {
        new[j]: replace(o, name=new[j], parent=new[o.parent], child=new[o.child])
        for j in mixed(joints)
        if (o := m.joints[j])
    }
    m.couplings = {
        coordinates[k]: replace(
            c, of=coordinates[c.of], sources={coordinates[s]: x for s, x in c.sources.items()}
        )
        for k, c in m.couplings.items()
    }
    m.locks = {coordinates[k]: x for k, x in m.locks.items()}
    m.frames = {n: replace(f, body=new[f.body]) for n, f in m.frames.items()}
    m.postures = {n: {coordinates[k]: x for k, x in p.items()} for n, p in m.postures.items()}
    m.constraints = {
        n: replace(c, parent=new.get(c.parent, ""), child=new.get(c.child, ""))
        for n, c in m.constraints.items()
    }
    return m.build(), coordinates


def velocity_names(system: System, joint: str) -> list[str]:
    dots = tuple(f"{joint}.{w}" for w in ("wx", "wy", "wz"))
    return [n for n in system.structure.velocity_names if n == joint or n in dots]


def carried(one: System, other: System, new: dict[str, str], q: np.ndarray) -> np.ndarray:
    """Configurations of the one as such of the other."""
    place = {n: k for k, n in enumerate(one.coordinate_names)}
    back = {new[n]: n for n in one.coordinate_names}
    return q[..., [place[back[n]] for n in other.coordinate_names]]


def pin(m: Mechanism, name: str, parent: str, child: str, x: float, y: float) -> None:
    """A pin at a place of the drawing; all bodies have the frame of the ground there."""
    m.revolute(name, parent, child, at=(x, y), child_at=(x, y))


def scissor(stages: int) -> System:
    """A scissor lift whose names put the pins in the middle last."""
    m = Mechanism("scissor", dim=2)
    c = 0.8
    s = 0.6
    for k in range(stages):
        m.body(f"a{k}"), m.body(f"b{k}")
    pin(m, "A0", m.ground.name, "a0", 0.0, 0.0)
    m.prismatic("G", m.ground, m.body("slider"), at=(c, 0.0), child_at=(c, 0.0), axis=(1, 0))
    pin(m, "B0", "slider", "b0", c, 0.0)
    for k in range(stages):
        if k:
            pin(m, f"A{k}", f"b{k - 1}", f"a{k}", 0.0, k * s)
            pin(m, f"B{k}", f"a{k - 1}", f"b{k}", c, k * s)
        pin(m, f"X{k}", f"a{k}", f"b{k}", c / 2, (k + 0.5) * s)
    return m.build()


def row(cells: int) -> System:
    """Four-bars in a row, each on the rocker of the one before; all cells have the same numbers."""
    m = Mechanism("row", dim=2)
    base = m.ground.name
    for k in range(cells):
        for body in "abc":
            m.body(f"{body}{k}")
        m.revolute(f"A{k}", base, f"a{k}", at=(0.0, 0.0))
        m.revolute(f"B{k}", f"a{k}", f"b{k}", at=(0.0, 1.0))
        m.revolute(f"C{k}", f"b{k}", f"c{k}", at=(2.0, 0.0), child_at=(0.0, 1.0))
        m.revolute(f"D{k}", base, f"c{k}", at=(2.0, 0.0))
        base = f"c{k}"
    return m.build()


def tower(floors: int) -> System:
    """Floors on three legs each in space, every leg of two links with revolute, revolute and
    spherical joints.
    """
    m = Mechanism("tower")
    below = m.ground.name
    for k in range(floors):
        above = m.body(f"floor{k}").name
        for leg in range(3):
            angle = 2.0 * np.pi * leg / 3.0 + 0.1 * leg
            foot = (float(np.cos(angle)), float(np.sin(angle)), 0.0)
            for part in "uv":
                m.body(f"{part}{leg}_{k}")
            turned = {"rpy": (np.pi / 2.0, 0.0, angle)}
            m.revolute(f"F{leg}_{k}", below, f"u{leg}_{k}", at=foot, **turned)
            m.revolute(
                f"K{leg}_{k}",
                f"u{leg}_{k}",
                f"v{leg}_{k}",
                at=(0.3, 0.6, 0.0),
                child_at=(0.3, -0.6, 0.0),
            )
            m.spherical(
                f"S{leg}_{k}",
                f"v{leg}_{k}",
                above,
                child_at=(foot[0], foot[1], -0.05 * k),
                at=(0.0, 0.0, 0.0),
            )
        below = above
    return m.build()


def hunted(dim: int, bodies: int, loops: int, seed: int) -> System:
    """A random closed mechanism; its posture `closed` is where it is closed."""
    rng = np.random.default_rng([seed, bodies])
    kinds = (
        ["revolute", "prismatic", "revolute"]
        if dim == 2
        else ["revolute", "cylindrical", "spherical", "universal"]
    )
    shape = closed(
        rng,
        dim,
        bodies,
        [make_joint_type(kinds[int(rng.integers(len(kinds)))]) for _ in range(bodies + loops)],
    )
    system = shape.system()
    m = system.mechanism
    m.posture("closed", system.q_dict(shape.values(system)))
    return m.build()


LARGE: dict[str, Callable[[], System]] = {
    **{f"scissor of {n}": lambda n=n: scissor(n) for n in (4, 12, 40, 99)},
    **{f"row of {n}": lambda n=n: row(n) for n in (3, 10, 40, 75)},
    **{f"tower of {n}": lambda n=n: tower(n) for n in (2, 6, 20)},
    **{
        f"plane {n}": lambda n=n, k=k: hunted(2, n, k, 5)
        for n, k in ((9, 3), (20, 6), (40, 9), (90, 12), (250, 20))
    },
    **{
        f"space {n}": lambda n=n, k=k: hunted(3, n, k, 6)
        for n, k in ((9, 2), (20, 4), (40, 5), (90, 7), (250, 9))
    },
}
EXAMPLES = {**LARGE, **{name: lambda name=name: shipped()[name] for name in with_loops()}}


def facts(system: System, q: np.ndarray) -> tuple[object, ...]:
    m = system.mobility(q, local=False)
    return m.gruebler, m.rank_dof, m.redundant, m.idle, m.singular, m.kind, len(m.clusters)


def home(system: System) -> np.ndarray:
    start = system.q("closed") if "closed" in system.structure.posture_names else system.neutral
    found = system.assemble(start=start)
    assert found
    return found.q


def judged(name: str, rng: np.random.Generator, starts: int) -> None:
    one = EXAMPLES[name]()
    other, new = renamed(one, rng)
    names = {j: new[c] for j in one.joint_names for c in one.structure.coordinates_of_joint(j)[:1]}
    names = {
        j: n[: len(n) - len(one.structure.coordinates_of_joint(j)[0]) + len(j)]
        for j, n in names.items()
    }
    assert {names[c] for c in one.structure.closures} == {*other.structure.closures}
    q = home(one)
    tolerance = 1e-9
    if one.nq < 150:
        if one.mobility(
            q, local=False
        ).singular:  # roots merge there: rounding moves them by its square root
            tolerance = 1e-7
        assert facts(one, q) == facts(other, carried(one, other, new, q))
    at = one.configuration_space.integrate(
        q, rng.uniform(-NEAR, NEAR, (starts, one.nv)) / np.sqrt(one.nv)
    )
    want = one.assemble(start=at)
    got = other.assemble(start=carried(one, other, new, at))
    assert np.array_equal(want.success, got.success)
    # later starts are drawn at random, coordinate after coordinate
    good = want.success & (want.starts == 1)
    np.testing.assert_allclose(
        got.q[good], carried(one, other, new, want.q)[good], rtol=0, atol=tolerance
    )
    more = np.abs(got.iterations - want.iterations)[good]
    assert np.all(more <= np.maximum(1, 0.2 * want.iterations[good]))


@pytest.mark.parametrize("name", some(EXAMPLES, 5))
def test_names_and_orders_change_no_answer(name, hunt):
    judged(name, hunt.rng(), 4)


@pytest.mark.slow
def test_names_and_orders_change_no_answer_at_length(hunt):
    rng = hunt.rng()
    for name in EXAMPLES:
        for _ in range(hunt.cases(3)):
            judged(name, rng, 8)


@pytest.mark.parametrize("name", ["four_bar", "watt_six_bar", "three_rpr"])
def test_names_and_orders_change_no_set_of_solutions(name):
    one = kempe.load(name)
    other, new = renamed(one, np.random.default_rng(4))
    motors = [n for n in one.coordinate_names if one.structure.joints[n].actuated] or [
        one.coordinate_names[0]
    ]
    values = {n: one.q_dict(one.q("closed"))[n] for n in motors}
    want = one.assembly_modes(values)
    got = other.assembly_modes({new[k]: x for k, x in values.items()})
    assert len(want) == len(got) > 1 and want.complete == got.complete
    there = carried(one, other, new, want.q)
    for q in got.q:
        away = other.configuration_space.difference(there, np.broadcast_to(q, there.shape))
        away = np.abs(away - 2.0 * np.pi * np.round(away / (2.0 * np.pi)))
        assert away.max(axis=-1).min() < 1e-6
