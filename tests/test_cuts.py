"""Wherever loops are cut: counts, ranks, success, sets of solutions and single answers are the
same.

Judged at each cut by what that system itself says of the answer: how far its loops are open, where
its bodies are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from closed_graphs import Closed, random_closed
from hunts import part, some
from shipped import with_loops

import kempe
from kempe import System
from kempe.equations.closure_rows import compute_jacobian, compute_residual
from kempe.model.own_tree import remove_cut_marks

CLOSED = with_loops()
FAR = 3.0
NEAR = 0.05
"""How far starts are from a closed configuration, in radians and metres."""
OPEN = 1e-8


def marked(system: System, cut: frozenset[str]) -> System:
    """The same mechanism with these joints marked, and no others."""
    m = system.mechanism
    m.joints |= {name: replace(joint, cut=name in cut) for name, joint in m.joints.items()}
    return m.build()


@cache
def cuts(name: str) -> tuple[System, ...]:
    """A shipped system without marks, then once for each joint that can be left out, which is."""
    plain = marked(kempe.load(name), frozenset())
    found = {plain.structure.closures: plain}
    for joint in plain.structure.joints:
        s = marked(plain, frozenset({joint}))
        if joint in s.structure.closures:
            found.setdefault(s.structure.closures, s)
    return tuple(found.values())


def starts(s: System, q: np.ndarray, size: float, n: int, rng: np.random.Generator) -> np.ndarray:
    return s.configuration_space.integrate(q, rng.uniform(-size, size, (n, s.nv)))


def driven(s: System) -> list[str]:
    """Coordinates of motors, or the first one."""
    names = [
        n for n in s.structure.velocity_names if s.structure.joints[n.partition(".")[0]].actuated
    ]
    return names or [s.structure.velocity_names[0]]


def same(got: np.ndarray, want: np.ndarray, tolerance: float = 0.0) -> None:
    np.testing.assert_allclose(got, want, rtol=0, atol=tolerance, equal_nan=True)


def few(systems: tuple[System, ...]) -> Iterator[System]:
    """Two cuts of a system: the first that is not its own choice, and the last."""
    yield from dict.fromkeys((systems[1], systems[-1]))


@pytest.mark.slow
def test_every_loop_can_be_cut_elsewhere():
    assert len(CLOSED) > 45
    for name in CLOSED:
        plain, *others = cuts(name)
        assert len(others) >= 2, name
        cut = len(plain.structure.closures)
        assert all(
            len(s.structure.closures) == cut and s.coordinate_names == plain.coordinate_names
            for s in others
        ), name


# ---- counts and ranks


def facts(s: System, q: np.ndarray) -> dict:
    m = s.mobility(q, local=False)
    return {
        "gruebler": (m.gruebler, m.gruebler_spatial),
        "rank": m.rank_dof,
        "generic": m.generic_rank_dof,
        "redundant": (m.redundant, m.redundant_here),
        "idle": m.idle,
        "singular": m.singular,
        "kind": m.kind,
        "control": str(m.control),
        "clusters": [(c.joints, c.gruebler, c.rank_dof, c.redundant) for c in m.clusters],
    }


def counted(plain: System, s: System) -> None:
    q = plain.q("closed")
    assert facts(s, q) == facts(plain, q)
    # the equations themselves, which differ, have as many freedoms
    ranks = [np.linalg.matrix_rank(compute_jacobian(x, q), 1e-7) for x in (plain, s)]
    assert ranks[0] == ranks[1] and len(compute_jacobian(plain, q)) == len(compute_jacobian(s, q))


@pytest.mark.parametrize("name", some(CLOSED, 3))
def test_counts_and_ranks(name):
    for s in few(cuts(name)):
        counted(cuts(name)[0], s)


@pytest.mark.slow
@pytest.mark.parametrize("name", part(CLOSED))
def test_counts_and_ranks_at_every_cut(name):
    for s in cuts(name)[1:]:
        counted(cuts(name)[0], s)


# ---- single answers


def assembled(plain: System, s: System, n: int, rng: np.random.Generator) -> None:
    """From near and from far: as closed, and the same; each judges the answer by its own tree."""
    home = plain.q("closed")
    known = driven(plain)[0]
    values = {known: plain.q_dict(home)[known]} if known in plain.coordinate_names else {}
    for size in (FAR, NEAR):
        at = starts(plain, home, size, n, rng)
        for nearest in (False, True):
            want, got = (
                x.assemble(values, start=at, prefer="nearest" if nearest else None)
                for x in (plain, s)
            )
            same(got.q, want.q)
            assert np.array_equal(got.success, want.success) and np.all(got.success)
            assert (
                np.abs(compute_residual(s, got.q)).max() < OPEN
                and np.abs(s.loops.closure_error(got.q)).max() < OPEN
            )
            for body in plain.body_names[1:]:
                same(s.fk(got.q, body), plain.fk(want.q, body), OPEN)


@pytest.mark.parametrize("name", some(CLOSED, 3))
def test_assemblies(name, hunt):
    for s in few(cuts(name)):
        assembled(cuts(name)[0], s, 8, hunt.rng())


@pytest.mark.slow
@pytest.mark.parametrize("name", part(CLOSED))
def test_assemblies_at_every_cut(name, hunt):
    for s in cuts(name)[1:]:
        assembled(cuts(name)[0], s, hunt.cases(40), hunt.rng())


@pytest.mark.parametrize("limits", [None, {"C": (-3.0, 3.0)}])
def test_what_a_start_says_of_the_joint_left_out_gives_way(limits):
    plain = marked(kempe.load("four_bar"), frozenset()).with_limits(limits)
    assert plain.structure.closures == ("C",)
    q = starts(plain, plain.q("closed"), 1.0, 50, np.random.default_rng(4))
    other = q.copy()
    other[:, 2] = -0.5 * q[:, 2]
    a, b = (plain.assemble({"A": 1.0}, start=x) for x in (q, other))
    assert a.success.all() and b.success.all()
    away = np.abs(plain.configuration_space.difference(a.q, b.q))
    turns = np.round(away / (2.0 * np.pi)) * 2.0 * np.pi
    assert (np.abs(away - turns).max() < 1e-9) == (limits is None)


# ---- inverse kinematics, steps, sets


def reached(plain: System, s: System, n: int, rng: np.random.Generator) -> None:
    """Targets within reach from near and from far, one out of reach, and a step."""
    frame = plain.body_names[-1]
    home = plain.q("closed")
    closed = plain.assemble(start=starts(plain, home, NEAR, n, rng)).q
    targets = plain.fk(closed, frame)
    away = targets + np.array([[0.0, 0, 0, 50.0], [0] * 4, [0] * 4, [0] * 4])
    for wanted, size in ((targets, NEAR), (targets, FAR), (away[:1], NEAR)):
        at = starts(plain, home, size, len(wanted), np.random.default_rng(int(rng.integers(2**32))))
        want, got = (x.ik(wanted, frame, at) for x in (plain, s))
        same(got.q, want.q)
        assert np.array_equal(got.success, want.success) and np.array_equal(got.code, want.code)
        assert size == FAR or wanted is not targets or np.all(got.success)
        assert np.abs(compute_residual(s, got.q[got.success])).max(initial=0.0) < 1e-6
    J = compute_jacobian(plain, closed[0])
    v = rng.normal(size=plain.nv)
    v -= np.linalg.pinv(J, 1e-9) @ (J @ v)
    twist = plain.jacobian(closed[0], frame) @ v
    want, got = (x.ik_step(closed[0], twist, frame, 0.01) for x in (plain, s))
    same(got.velocity, want.velocity, 1e-9)
    same(got.q, want.q, 1e-9)


@pytest.mark.parametrize("name", some(CLOSED, 3))
def test_inverse_kinematics(name, hunt):
    for s in few(cuts(name)):
        reached(cuts(name)[0], s, 2, hunt.rng())


@pytest.mark.slow
@pytest.mark.parametrize("name", part(CLOSED))
def test_inverse_kinematics_at_every_cut(name, hunt):
    for s in cuts(name)[1:]:
        reached(cuts(name)[0], s, 4, hunt.rng())


def sets(plain: System, s: System, n: int) -> None:
    home = plain.q("closed")
    values = {k: plain.q_dict(home)[k] for k in driven(plain) if k in plain.coordinate_names}
    want, got = (x.assembly_modes(values, budget=kempe.Budget(starts=n)) for x in (plain, s))
    same(got.q, want.q)
    assert (got.complete, got.branches, got.status, len(got)) == (
        want.complete,
        want.branches,
        want.status,
        len(want),
    )
    assert (
        np.array_equal(got.freedoms, want.freedoms)
        and np.abs(compute_residual(s, got.q)).max(initial=0.0) < 1e-6
    )


@pytest.mark.parametrize("name", some(CLOSED, 3))
def test_sets_of_solutions(name):
    sets(cuts(name)[0], cuts(name)[-1], 16)


@pytest.mark.slow
@pytest.mark.parametrize("name", part(CLOSED))
def test_sets_of_solutions_at_every_cut(name):
    for s in cuts(name)[1:]:
        sets(cuts(name)[0], s, 48)


# ---- motions


LONG = pytest.param("scissor", marks=pytest.mark.slow)


@pytest.mark.parametrize("name", some(["four_bar", "slider_crank", "bennett", LONG], 3))
def test_motions(name):
    plain, *others = cuts(name)
    home = plain.q("closed")
    driver = driven(plain)[0]
    values = plain.q_dict(home)[driver] + np.linspace(0.0, 1.0, 30)
    want = plain.trace(driver, home)
    driven_ = plain.drive({driver: values}, start=home)
    for s in few((plain, *others)):
        got = s.trace(driver, home)
        same(got.q, want.q)
        assert got.status == want.status and got.system is s
        same(s.drive({driver: values}, start=home).q, driven_.q)


# ---- mechanisms that nobody has seen


def hunted(shape: Closed, rng: np.random.Generator) -> None:
    """Marked anywhere, also at more joints than there are loops, or at one of several."""
    names = [link.name for link in shape.links]
    plain = shape.system()
    q = shape.values(plain)
    at = np.concatenate([starts(plain, q, size, 2, rng) for size in (FAR, NEAR)])
    known = {
        n: x
        for n, x in plain.q_dict(q).items()
        if n in plain.structure.velocity_names and rng.random() < 0.2
    }
    want = plain.assemble(known, start=at)
    for _ in range(2):
        s = shape.system(frozenset(n for n in names if rng.random() < 0.4))
        got = s.assemble(known, start=at)
        if remove_cut_marks(s).structure.closures != plain.structure.closures:
            # in its tree are joints that hold nothing
            left = {*plain.structure.closures} - {*s.structure.closures}
            assert any(
                link.kind.constraints(shape.dim) <= 0 for link in shape.links if link.name in left
            )
            continue
        same(got.q, want.q)
        assert np.array_equal(got.success, want.success)
        for good, answer in zip(got.success.tolist(), got.q, strict=True):
            assert not good or shape.open_by(s, answer) < 1e-8


def test_marks_anywhere(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        hunted(random_closed(rng), rng)


@pytest.mark.slow
def test_marks_anywhere_at_length(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(1000)):
        hunted(random_closed(rng), rng)
