"""Assembly modes of platforms on rods that spin: as many as six distances allow, by Newton's method
alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import kempe
from kempe import Mechanism, System
from kempe.assemble.idle_freedoms import find_idle_freedoms_at
from kempe.joints import make_joint_type
from kempe.spatial import exp_so3


def poses_of(
    base: np.ndarray, top: np.ndarray, lengths: np.ndarray, rng: np.random.Generator, n: int
) -> np.ndarray:
    """Poses (k, 3, 4), each once, that hold points (m, 3) of a platform at distances from others: n
    random starts.
    """
    size = float(np.abs(base).max() + lengths.max())
    R = exp_so3(rng.normal(size=(n, 3)) * 2.0)
    p = rng.uniform(-size, size, (n, 3))
    for _ in range(80):
        arms = np.einsum("nij,mj->nmi", R, top)
        d = arms + p[:, None] - base
        error = 0.5 * (np.sum(d * d, axis=-1) - lengths**2)
        # the platform turns about its own point, in the ground
        J = np.concatenate([d, np.cross(arms, d)], axis=-1)
        JT = np.swapaxes(J, 1, 2)
        damped = J @ JT + (1e-6 * np.abs(error).max(axis=1))[:, None, None] * np.eye(len(top))
        step = -(JT @ np.linalg.solve(damped, error[..., None]))[..., 0]
        step *= np.minimum(1.0, 0.7 * size / np.maximum(np.linalg.norm(step, axis=1), 1e-300))[
            :, None
        ]
        p = p + step[:, :3]
        R = exp_so3(step[:, 3:]) @ R
    good = np.abs(error).max(axis=1) < 1e-11 * size**2
    found: list[np.ndarray] = []
    for X in np.concatenate([R, p[..., None]], axis=2)[good]:
        if all(np.abs(X - other).max() > 1e-5 for other in found):
            found.append(X)
    return np.array(found)


def rods(system: System, q: np.ndarray, platform: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends (m, 3) of rods on what stands still and on the platform (in its axes), and their
    lengths, at q (nq,).
    """
    m = system.mechanism
    still = {}
    top = {}
    for joint in m.joints.values():
        X = joint.X_PF.evaluate_pose(m.parameters)
        if joint.parent == platform:
            top[joint.name[1:]] = X[:3, 3]
        elif joint.name[0] in "BU":
            still[joint.name[1:]] = (system.fk(q, joint.parent) @ X)[:3, 3]
    names = sorted(top)
    X = system.fk(q, platform)
    base, ends = (np.array([points[n] for n in names]) for points in (still, top))
    return base, ends, np.linalg.norm(base - ends @ X[:3, :3].T - X[:3, 3], axis=1)


def on_balls(name: str) -> Mechanism:
    """A shipped mechanism with balls in place of its universal joints."""
    m = kempe.load(name).mechanism
    ball = make_joint_type("spherical")
    m.joints |= {
        n: replace(j, type=ball) for n, j in m.joints.items() if j.type.type_name == "universal"
    }
    m.postures.clear()
    return m


def assert_all_found(system: System, known: dict[str, float], q: np.ndarray, count: int) -> None:
    modes = system.assembly_modes(known, limits=False)
    found = system.fk(modes.q, "platform")[:, :3]
    wanted = poses_of(*rods(system, q, "platform"), np.random.default_rng(0), 3000)
    assert len(found) == len(wanted) == count and not modes.freedoms.any() and not modes.complete
    apart = np.abs(found[:, None] - wanted[None]).max(axis=(2, 3))
    assert apart.min(axis=0).max() < 1e-6
    assert np.abs(system.loops.closure_error(modes.q)).max() < 1e-9
    assert "6 idle spins left out" in modes.status
    few = system.assembly_modes(known, limits=False, frame="platform")
    assert len(few) == count


@pytest.mark.slow
def test_dietmaiers_platform_on_balls_has_forty_poses():
    """Dietmaier, 1998: 40, not 40 times infinitely many, as its legs spin."""
    shipped = kempe.load("stewart_dietmaier")
    q = shipped.q("closed")
    system = on_balls("stewart_dietmaier").build()
    known = {n: v for n, v in shipped.q_dict(q).items() if n.startswith("leg")}
    at = system.assemble(known).q
    assert_all_found(system, known, at, 40)


@pytest.mark.slow
def test_a_delta_robot_on_balls_has_twelve_poses_for_its_arms():
    """Six distances: of the 12 two are translations, those of the same robot on universal joints."""
    system = kempe.load("delta_ss")
    other = kempe.load("delta_uu")
    q = system.q("closed")
    known = {n: system.q_dict(q)[n] for n in ("A1", "A2", "A3")}
    assert_all_found(system, known, q, 12)
    poses = system.fk(system.assembly_modes(known).q, "platform")
    level = poses[np.abs(poses[:, :3, :3] - np.eye(3)).max(axis=(1, 2)) < 1e-6]
    wanted = other.fk(other.assembly_modes(known, frame="platform").q, "platform")
    assert len(level) == len(wanted) == 2
    np.testing.assert_allclose(
        level[np.argsort(level[:, 2, 3])], wanted[np.argsort(wanted[:, 2, 3])], atol=1e-9
    )


def _hunt_platforms(hunt, cases: int) -> None:
    system = kempe.load("stewart_sps")
    rng = hunt.rng()
    for _ in range(hunt.cases(cases)):
        known = {f"leg{i}": float(x) for i, x in enumerate(rng.uniform(0.35, 0.5, 6), 1)}
        start = system.assemble(known)
        if start:
            count = len(poses_of(*rods(system, start.q, "platform"), rng, 2000))
            assert_all_found(system, known, start.q, count)


@pytest.mark.slow
def test_hunt_platforms_on_balls(hunt):
    """Other legs for the shipped platform: the modes are the poses that Newton's method finds."""
    _hunt_platforms(hunt, 3)


@pytest.mark.slow
def test_hunt_many_platforms_on_balls(hunt):
    _hunt_platforms(hunt, 12)


@pytest.mark.parametrize("name", ["rssr", "stewart_sps", "delta_ss", "four_bar", "five_bar"])
def test_modes_read_the_idle_freedoms_of_mobility(name):
    """The search for modes and `mobility` find the same, by the same steps."""
    system = kempe.load(name)
    q = system.assemble().q
    report = system.mobility(q, local=False)
    idle = find_idle_freedoms_at(system, q)
    assert idle == report.idle_freedoms
    assert all(
        np.array_equal(a.velocity, b.velocity)
        for a, b in zip(idle, report.idle_freedoms, strict=True)
    )
