"""Motions of mechanisms whose rods spin: the same as with a universal joint in place of one ball of
each rod.
"""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hunts import part, some
from rods import Rods, engine, strut, tied
from world_mechanisms import World, axes_with, unit

import kempe
from kempe.assemble.idle_freedoms import find_spin_lock
from kempe.equations import closure_rows
from kempe.errors import UnsupportedError
from kempe.motion.path import Path

LEGS = tuple(f"leg{i}" for i in range(1, 7))


def rssr(draw: np.random.Generator, form: str, cut: str = "", planar: bool = False) -> kempe.System:
    """A rod between two arms on hinges, closed at neutral; `form` names the joints at its ends: S,
    A (angles), U.
    """
    flat = np.diag([1.0, 1.0, 0.0]) if planar else np.eye(3)
    p, b, c, d = (flat @ draw.uniform(-1, 1, 3) for _ in range(4))
    first, second = (np.eye(3)[2] if planar else unit(draw.normal(size=3)) for _ in range(2))
    x, y, _ = axes_with(c - b).T
    w = World("rssr")
    w.turn("ground", "crank", p, first, name="A")
    for kind, one, two, at in (("B", "crank", "rod", b), ("C", "rod", "rocker", c)):
        more = {"name": kind, "cut": kind in cut}
        if form["BC".index(kind)] == "U":
            w.cross(one, two, at, x, y, **more)
        else:
            w.ball(one, two, at, angles=form["BC".index(kind)] == "A", **more)
    w.turn("ground", "rocker", d, second, name="D")
    return w.build()


def of(path: Path, names=("A", "D")) -> np.ndarray:
    """The columns (n, k) of coordinates."""
    return path.q[:, [path.system.coordinate_names.index(n) for n in names]]


def events(path: Path, names=("A", "D")) -> np.ndarray:
    """Where coordinates turn back (k, 1 + 2 m): which, and cosines and sines of all named ones
    there, sorted.
    """
    number = [path.system.coordinate_names.index(n) for n in names]
    found = [
        (names.index(e.coordinate), *np.cos(e.q[number]), *np.sin(e.q[number]))
        for e in path.extremes
        if e.coordinate in names
    ]
    return np.array(sorted(found, key=lambda row: tuple(np.round(row, 5)))).reshape(
        -1, 1 + 2 * len(names)
    )


def assert_same(path: Path, other: Path) -> None:
    """The named coordinates take the same course, and what spins comes back with the others."""
    assert path.closed == other.closed and path.success == other.success and len(path) > 1
    np.testing.assert_allclose(events(path), events(other), atol=1e-6)
    assert np.abs(path.system.loops.closure_error(path.q)).max() < 1e-9
    if path.closed:
        np.testing.assert_allclose(
            of(path)[-1] - of(path)[0], of(other)[-1] - of(other)[0], atol=1e-9
        )
        balls = path.system.structure.layout.quaternion_v[:, None] + np.arange(3)
        assert (
            np.abs(path.system.configuration_space.difference(path.q[0], path.q[-1])[balls]).max(
                initial=0.0
            )
            < 1e-9
        )


def pair(seed, form: str, **options) -> tuple[kempe.System, kempe.System]:
    """A mechanism with a rod that spins, and the same with one that does not."""
    spins, rests = (rssr(np.random.default_rng(seed), f, **options) for f in (form, "SU"))
    return spins, rests


@pytest.mark.slow
@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("cut", some(["", "B", "C"], 3))
@pytest.mark.parametrize("form", ["SS", pytest.param("SA", marks=pytest.mark.slow)])
def test_a_rod_that_spins_moves_as_one_that_does_not(form, cut, planar):
    """In a plane the rod's line passes all directions of a half plane, its way back included."""
    spins, rests = pair(4, form, cut=cut, planar=planar)
    start = spins.neutral.copy()
    assert_same(spins.trace("A", start), rests.trace("A", rests.neutral.copy()))
    A = np.linspace(0.0, -0.3, 7)
    a = spins.drive({"A": A}, start=start)
    b = rests.drive({"A": A}, start=rests.neutral.copy())
    assert np.array_equal(a.held, b.held)
    np.testing.assert_allclose(a.values("D"), b.values("D"), atol=1e-9)


def _hunt_rods(hunt, cases: int) -> None:
    rng = hunt.rng()
    for _ in range(hunt.cases(cases)):
        seed = int(rng.integers(2**32))
        spins, rests = pair(
            seed, "SS", planar=bool(rng.random() < 0.25), cut=str(rng.choice(["", "B", "C"]))
        )
        start = spins.neutral.copy()
        rod = spins.mobility(spins.neutral, local=False).idle_freedoms[0]
        start = spins.configuration_space.integrate(start, rng.uniform(-3, 3) * rod.velocity)
        assert_same(spins.trace("A", start), rests.trace("A", rests.neutral.copy()))


@pytest.mark.slow
def test_hunt_rods_that_spin(hunt):
    """Random linkages, a random spin of the rod at the start, cut anywhere."""
    _hunt_rods(hunt, 4)


@pytest.mark.slow
def test_hunt_many_rods_that_spin(hunt):
    _hunt_rods(hunt, 30)


SPINNING = (strut, tied, engine)


def assert_spun_is_the_same(unit, rng: np.random.Generator) -> bool:
    """What does not spin takes the same places from starts that differ by spins, driven by the
    chart's coordinates.

    Whether these have names, by which they can be driven: components of a rotation vector have
    none.
    """
    r = Rods(rng)
    unit(r, "ground")
    system = r.world.build()
    q = system.neutral.copy()
    report = system.mobility(system.neutral, local=False)
    chart = system.independent(q)
    assert (
        chart.dim == report.rank_dof
        and len(chart.idle) == report.idle == len(r.idle)
        and chart.useful
    )
    spun = q
    for f in report.idle_freedoms:
        spun = system.configuration_space.integrate(
            spun, rng.uniform(-1, 1) * f.velocity / np.linalg.norm(f.velocity)
        )
    t = np.linspace(0.0, 0.02, 3)
    values = system.q_dict(q)
    if not {*chart.useful} <= {*values}:
        return False
    inputs = {n: values[n] + t * (-1) ** i for i, n in enumerate(chart.useful)}
    spinning = {b for f in report.idle_freedoms for b in (*f.bodies, *f.links)}
    rest = [b for b in system.body_names[1:] if b not in spinning]
    starts = (system.assemble({n: values[n] for n in inputs}, near).q for near in (q, spun))
    motions = [system.drive(inputs, start=start) for start in starts]
    if all(motions):
        one, other = (system.fk(m.q, rest) for m in motions)
        np.testing.assert_allclose(one, other, atol=1e-8)
        assert max(np.abs(closure_rows.compute_residual(system, m.q)).max() for m in motions) < 1e-9
    return True


@pytest.mark.parametrize("unit", SPINNING, ids=lambda u: u.__name__)
def test_hunt_what_spins_in_other_ways(unit, hunt):
    """Telescopic legs, rods tied to rods, pistons that turn; balls as one joint or of hinges."""
    rng = hunt.rng()
    for _ in range(hunt.cases(4)):
        assert assert_spun_is_the_same(unit, rng)


@pytest.mark.slow
def test_hunt_many_things_that_spin(hunt):
    rng = hunt.rng()
    cases = hunt.cases(120)
    driven = sum(
        assert_spun_is_the_same(SPINNING[int(rng.integers(len(SPINNING)))], rng)
        for _ in range(cases)
    )
    assert driven > 0.9 * cases


@pytest.mark.slow
def test_names_of_bodies_and_joints_do_not_matter(tmp_path):
    """The file's own names, and others in another order."""
    system = kempe.load("rssr")
    file = system.mechanism.save(tmp_path / "rssr.toml")
    text = file.read_text()
    for old, new in (
        ("coupler", "zz"),
        ('"B"', '"Q9"'),
        ('"C"', '"A0"'),
        ("B.q", "Q9.q"),
        ("C.q", "A0.q"),
    ):
        text = text.replace(old, new)
    file.write_text(text)
    other = kempe.load(file)
    a, b = (s.trace("A") for s in (system, other))
    np.testing.assert_allclose(a.s[-1], b.s[-1], atol=1e-9)
    np.testing.assert_allclose(events(a), events(b), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("driver", part(["leg1", "leg2"]))
def test_a_platform_on_balls_moves_as_one_on_universal_joints(driver):
    """`stewart_sps` and `stewart` have the same geometry: five legs held, one driven, or all six
    driven.
    """
    ends = []
    places = []
    for name in ("stewart_sps", "stewart"):
        system = kempe.load(name)
        q = system.q("closed")
        legs = {n: system.q_dict(q)[n] for n in LEGS}
        t = np.linspace(0.0, 1.0, 6)
        motion = system.drive(
            {n: x + 0.03 * np.sin(t * (i + 2)) for i, (n, x) in enumerate(legs.items())}, start=q
        )
        assert motion.success
        places.append(system.fk(motion.q, "platform"))
        few = system.trace(
            driver,
            q,
            hold={n: x for n, x in legs.items() if n != driver},
            budget=kempe.Budget(points=70),
        )
        ends.append([e.value for e in few.turning_points])
    np.testing.assert_allclose(places[0], places[1], atol=1e-12)
    n = min(map(len, ends))
    assert n > 0
    np.testing.assert_allclose(np.sort(ends[0])[:n], np.sort(ends[1])[:n], atol=1e-8)


def test_a_delta_robot_on_balls_is_driven_as_one_on_universal_joints():
    poses = []
    for name in ("delta_ss", "delta_uu"):
        system = kempe.load(name)
        q = system.q("closed")
        t = np.linspace(0.0, 1.0, 8)
        motion = system.drive(
            {n: system.q_dict(q)[n] + 0.2 * t * (i - 1) for i, n in enumerate(("A1", "A2", "A3"))},
            start=q,
        )
        assert motion.success
        poses.append(system.fk(motion.q, "platform"))
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-11)


def test_a_spin_can_be_followed():
    """With the crank held the spin is the motion; a ball with angles can be held, which leaves one
    freedom.
    """
    system = kempe.load("rssr")
    path = system.trace(hold={"A": 1.2})
    assert path.closed and path.s[-1] > 1.0
    np.testing.assert_allclose(np.ptp(path.q[:, -1]), 0.0, atol=1e-9)
    spins, rests = pair(4, "SA")
    path = spins.trace(
        "A", spins.neutral.copy(), hold={"C.rz": 0.0}, budget=kempe.Budget(points=12)
    )
    assert find_spin_lock(path.track.equations) is None
    with pytest.raises(UnsupportedError, match="2 freedoms"):
        spins.trace("C.rx", spins.neutral.copy())


def test_a_spin_is_no_answer_to_what_cannot_move():
    """Two inputs for one useful freedom, and a driver whose motion is held."""
    system = kempe.load("rssr")
    q = system.q("closed")
    with pytest.raises(UnsupportedError, match="fewer freedoms than inputs: 'A', 'D'"):
        system.drive({"A": [q[0], q[0] + 0.1], "D": [q[-1], q[-1]]})
    path = system.trace("A", q, hold={"D": q[-1]})
    assert len(path) == 1 and "cannot move" in path.status


def test_directions_in_the_ground_stay_away_from_the_lines():
    path = kempe.load("rssr").trace("A")
    lock = find_spin_lock(path.track.equations)
    assert lock is not None and path.track.equations.follows_by_kernel
    away = np.linalg.norm(np.cross(lock.ground[0], lock.compute_lines(path.q)[:, 0]), axis=1)
    assert away.min() > 0.2


def test_paths_of_what_spins_are_pickled():
    path = kempe.load("rssr").trace("A")
    again = pickle.loads(pickle.dumps(path))
    np.testing.assert_array_equal(again.at(1.0), path.at(1.0))
    assert np.abs(path.system.loops.closure_error(path.resample(40).q)).max() < 1e-9


@pytest.mark.slow
def test_more_than_spins_is_still_refused():
    with pytest.raises(
        UnsupportedError, match="stewart_sps has 6 freedoms to first order here"
    ) as error:
        kempe.load("stewart_sps").trace("leg1")
    assert "these still move: 'leg2', 'leg3'" in str(error.value) and ".w" not in str(error.value)
