"""Configurations are sorted as comparing all of them with each other sorts them."""

from __future__ import annotations

import numpy as np
import pytest
from hunts import Hunt

import kempe
from kempe import Mechanism, System
from kempe.assemble.same_configuration import Clusters

TURN = 2.0 * np.pi


def geared() -> System:
    """Angles of several periods, a slide, and one angle that winds up."""
    m = Mechanism("geared")
    here = m.ground
    for k in range(5):
        m.revolute(f"q{k}", here, m.body(f"b{k}"), at=(0.3, 0.1, 0))
        here = f"b{k}"
    m.prismatic("s", here, m.body("slider"))
    m.couple("q1", {"q0": 1.5})
    m.couple("q4", {"q2": 1.0, "q3": 1.0})
    return m.build()


def balls() -> System:
    m = Mechanism("balls")
    m.spherical("S", m.ground, m.body("a"))
    m.joint("F", "free", "a", m.body("b"))
    m.spherical("T", "b", m.body("c"), at=(0.1, 0, 0), angles=True)
    return m.build()


SYSTEMS = {
    "geared": geared,
    "balls": balls,
    "rssr": lambda: kempe.load("rssr"),
    "jansen": lambda: kempe.load("jansen"),
}


def images(
    system: System, rng: np.random.Generator, q: np.ndarray, period: np.ndarray
) -> np.ndarray:
    """The same places of all bodies in other coordinates: after full turns, with quaternions of the
    other sign.
    """
    q = q + 0.0
    v = system.structure.layout.vector_v
    q[system.structure.layout.vector_q] += rng.integers(-2, 3, size=len(v)) * period[v]
    for i in system.structure.layout.quaternion_q:
        q[i : i + 4] *= rng.choice([-1.0, 1.0])
    return q


def one_by_one(clusters: Clusters, q: np.ndarray, tolerance: np.ndarray) -> list[int]:
    """The first of each cluster is compared with all that come later; cluster numbers in the order
    of their firsts.
    """
    firsts = []
    out = []
    for i in range(len(q)):
        apart = [float(clusters.compute_distances(q[[i]], q[[k]])[0]) for k in firsts]
        near = [n for n, d in enumerate(apart) if d <= max(tolerance[i], tolerance[firsts[n]])]
        if not near:
            firsts.append(i)
        out.append(min(near, key=lambda n: apart[n]) if near else len(firsts) - 1)
    return out


def check(hunt: Hunt, name: str, cases: int) -> None:
    rng = hunt.rng()
    system = SYSTEMS[name]()
    for _ in range(hunt.cases(cases)):
        frames = () if rng.random() < 0.6 else (system.body_names[-1],)
        clusters = Clusters(system, frames)
        places = system.random(rng, int(rng.integers(1, 12)))
        noise = 10.0 ** rng.uniform(-9, -7.3)
        chosen = places[rng.integers(len(places), size=40)]
        q = np.array([images(system, rng, x, clusters.metric.period) for x in chosen])
        q = system.configuration_space.integrate(
            q, rng.uniform(-1, 1, (40, system.nv)) * noise * clusters.metric.scale
        )
        tolerance = 10.0 ** rng.uniform(-6, -4, 40)
        batches = np.split(np.arange(40), np.sort(rng.integers(41, size=2)))
        found = np.concatenate(
            [clusters.add_configurations(q[b], tolerance[b]) for b in batches if len(b)]
        )
        assert found.tolist() == one_by_one(clusters, q, tolerance)
        assert sorted(i for m in clusters.members for i in m) == list(range(40))
        assert clusters.hits.tolist() == np.bincount(found).tolist()


@pytest.mark.parametrize("name", SYSTEMS)
def test_configurations_are_sorted_as_one_by_one(name, hunt):
    check(hunt, name, 5)


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_many_configurations_are_sorted_as_one_by_one(name, hunt):
    check(hunt, name, 100)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("size", [1e-8, 1e-3, 1.0])
def test_keys_differ_by_no_more_than_configurations(size, name, hunt):
    """Otherwise those that are one would not be compared."""
    rng = hunt.rng()
    system = SYSTEMS[name]()
    metric = Clusters(system).metric
    q = system.random(rng, 2000)
    to = system.configuration_space.integrate(
        q, rng.uniform(-1, 1, (len(q), system.nv)) * size * metric.scale
    )
    to = np.array([images(system, rng, x, metric.period) for x in to])
    apart = np.abs(metric.compute_keys(to) - metric.compute_keys(q))
    assert (apart <= metric.steepest * metric.compute_distances(to, q) + 1e-12).all()


def test_no_configurations_are_sorted_into_no_clusters():
    """With frames and without."""
    system = balls()
    for frames in ((), (system.body_names[-1],)):
        assert (
            len(Clusters(system, frames).add_configurations(np.empty((0, system.nq)), np.empty(0)))
            == 0
        )
