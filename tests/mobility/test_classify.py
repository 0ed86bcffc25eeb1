"""Which kind constraints of mechanisms are: literature, symbols, exact forms, what is one-sided,
bad input.
"""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest
import sympy
from hunts import Hunt, some
from pfaffian import SYSTEMS, Pfaffian, growth_by_symbols
from wheeled import KNOWN, close_by, on_plane, steered_car, trailers, two_axles

from kempe import Mechanism, constraints
from kempe.equations.closure_rows import evaluate_constraints
from kempe.equations.velocity import evaluate_velocity_rows, record_tangent_rows
from kempe.errors import InputError, UnsupportedError
from kempe.mobility.classify import EvaluationPoint, sample_reachable_point
from kempe.mobility.growth_vectors import compute_distribution
from kempe.spatial import Array
from kempe.system import System


def sliding(names: tuple[str, ...], rows: Any, b: Any = 0, time: bool = False) -> System:
    """Bodies on slides in turn along x, y and z, with rows of velocity over the slides."""
    m = Mechanism("slides")
    last = m.ground
    for i, name in enumerate(names):
        body = m.body(f"B{i}")
        m.joint(name, "prismatic", last, body, axis=np.eye(3)[i % 3])
        last = body
    m.velocity_equation("law", rows, names, b, time)
    return System(m)


# ---- the literature


@pytest.mark.parametrize("name", KNOWN)
def test_mechanisms_of_the_literature(name: str, hunt: Hunt) -> None:
    """Growth, degree, what is reached and the kind, at random configurations."""
    make, growth, positions = KNOWN[name]
    system = make()
    rng = hunt.rng()
    for _ in range(hunt.cases(2)):
        found = system.classify(close_by(system, rng), project=True)
        assert (found.growth, found.growth_around) == (growth, growth)
        assert (found.position_dof, found.velocity_dof) == (positions, growth[0])
        assert (found.reachable_dimension, found.degree) == (
            growth[-1],
            growth.index(growth[-1]) + 1,
        )
        assert found.integrals == positions - growth[-1]
        assert found.kind == ("integrable" if growth[0] == growth[-1] else "nonholonomic")
        if found.one_sided is None:  # a mobility counts what may be left as free
            assert found.velocity_dof == system.mobility(found.q, local=False).velocity_dof


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", some([n for n in KNOWN if n not in ("five trailers", "ball that may jump")], 3)
)
def test_reached_by_motions(name: str) -> None:
    """The dimension reached is the rank of the end of a motion by what is chosen on the way, by
    differences.

    Motions follow the velocities that the rows leave free by steps of Runge and Kutta, which shares
    nothing with brackets but the rows.
    """
    make, growth, _ = KNOWN[name]
    system = make()
    rng = np.random.default_rng(3)
    start = system.classify(close_by(system, rng), project=True).q
    wishes = rng.normal(size=(9, system.nv))
    changes = 1e-4 * np.eye(wishes.size).reshape(-1, *wishes.shape)
    ends = [end_of_motion(system, start, wishes + sign * changes) for sign in (-1, 1)]
    values = np.linalg.svd(system.configuration_space.difference(*ends) / 2e-4, compute_uv=False)
    least = values[growth[-1] - 1]
    assert least > 2e-5
    assert np.all(values[growth[-1] :] < 0.1 * least)


def end_of_motion(system: System, start: Array, wishes: Array, h: float = 0.1) -> Array:
    """Where motions (n, nq) end that follow in turn what is left of wished velocities (n, k, nv)."""
    q = np.broadcast_to(start, (len(wishes), system.nq))

    def slope(q: Array, wish: Array) -> Array:
        A = holding(system, q)
        return wish - np.einsum("nij,nj->ni", np.linalg.pinv(A, rcond=1e-6) @ A, wish)

    for wish in np.repeat(np.moveaxis(wishes, 1, 0), 8, axis=0):
        k1 = slope(q, wish)
        k2 = slope(system.configuration_space.integrate(q, 0.5 * h * k1), wish)
        k3 = slope(system.configuration_space.integrate(q, 0.5 * h * k2), wish)
        k4 = slope(system.configuration_space.integrate(q, h * k3), wish)
        q = system.configuration_space.integrate(q, h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return q


def holding(system: System, q: Array) -> Array:
    """Rows (n, m, nv) of velocities, and the change of what holds positions by differences."""
    steps = 1e-6 * np.eye(system.nv)
    moved = (
        np.reshape(system.configuration_space.integrate(q[:, None], sign * steps), (-1, system.nq))
        for sign in (1, -1)
    )
    more, less = (evaluate_constraints(system, x, False, True)[0] for x in moved)
    by_step = np.reshape((more - less) / 2e-6, (len(q), system.nv, -1))
    return np.concatenate(
        [evaluate_velocity_rows(system, q)[0], np.swapaxes(by_step, 1, 2)], axis=1
    )


@pytest.mark.parametrize(
    "name", some([n for n in SYSTEMS if n not in ("two trailers", "three trailers")], 3)
)
def test_equations_of_velocity_against_symbols(name: str, hunt: Hunt) -> None:
    """Systems of rows that are written, on slides: the growth of all brackets by sympy, at a random
    point.
    """
    given = SYSTEMS[name]
    rng = hunt.rng()
    system = sliding(given.names, given.text)
    q = rng.uniform(0.2, 1.2, size=len(given.names))
    found = system.classify(q)
    free = np.flatnonzero(compute_distribution(given.rows(), q).pivots < 0).tolist()
    growth = growth_by_symbols(given, q, free, len(found.growth or ()))
    assert found.growth == growth[: len(found.growth or ())]
    assert (found.kind == "integrable") == (len(set(growth)) == 1)


# ---- hunts


def polynomial(names: list[str], rng: np.random.Generator) -> str:
    """A polynomial of degree two with small whole coefficients."""
    a, b, c = rng.choice(names, size=3)
    return f"{rng.integers(-3, 4)}*{a} + {rng.integers(-1, 2)}*{b}*{c}"


@pytest.mark.parametrize("n", [3, 4, 5, pytest.param(6, marks=pytest.mark.slow)])
def test_random_rows_against_symbols(n: int, hunt: Hunt) -> None:
    """Random rows, mixed by a matrix of functions: growth by sympy from rows that are not mixed, at
    a random point.
    """
    rng = hunt.rng()
    names = [f"u{i}" for i in range(n)]
    for _ in range(hunt.cases(3)):
        m = int(rng.integers(1, n - 1))
        plain = [
            [polynomial(names, rng) for _ in range(n - m)]
            + ["1" if i == j else "0" for j in range(m)]
            for i in range(m)
        ]
        x, y = (sympy.Symbol(str(u)) for u in rng.choice(names, size=2))
        factors = [
            [2 + sympy.cos(x) if i == j else (y + i - j) / (3 * m) for j in range(m)]
            for i in range(m)
        ]
        mixed = sympy.Matrix(factors) * sympy.Matrix(
            [[sympy.sympify(e) for e in row] for row in plain]
        )
        q = rng.uniform(0.3, 1.0, size=n)
        found = sliding(tuple(names), [[str(e) for e in mixed.row(i)] for i in range(m)]).classify(
            q
        )
        steps = min(len(found.growth or ()), 4)
        growth = growth_by_symbols(
            Pfaffian(" ".join(names), tuple(map(tuple, plain))), q, list(range(n - m)), steps
        )
        assert (found.growth or ())[:steps] == growth


def exact_rows(names: list[str], m: int, rng: np.random.Generator) -> list[list[str]]:
    """Differentials of m random functions, mixed by a random matrix of functions."""
    symbols = sympy.symbols(names)
    rows = []
    for i in range(m):
        a, b, c, d = rng.choice(len(symbols), size=4)
        f = symbols[i] + rng.integers(1, 4) * symbols[a] * symbols[b] / 3
        f += sympy.sin(symbols[c]) / 2 + symbols[d] ** 2 * symbols[a] / 4
        rows.append([sympy.diff(f, s) for s in symbols])
    x, y = (symbols[i] for i in rng.choice(len(symbols), size=2))
    factors = [
        [(2 + sympy.cos(x * y) if i == j else (x - y * (i + j)) / 3) for j in range(m)]
        for i in range(m)
    ]
    mixed = sympy.Matrix(factors) * sympy.Matrix(rows)
    return [[str(mixed[i, j]) for j in range(len(symbols))] for i in range(m)]


def test_random_exact_forms_are_integrable(hunt: Hunt) -> None:
    """With integrating factors, and mixed: motions stay in leaves, of the dimension of the free
    velocities.
    """
    rng = hunt.rng()
    regular = 0
    for _ in range(hunt.cases(25)):
        n = int(rng.integers(2, 7))
        m = int(rng.integers(1, n))
        names = [f"u{i}" for i in range(n)]
        system = sliding(tuple(names), exact_rows(names, m, rng))
        q = rng.uniform(-0.6, 0.6, size=n)
        found = system.classify(q)
        if min(np.linalg.svd(evaluate_velocity_rows(system, q)[0], compute_uv=False)) < 1e-2:
            continue
        assert (found.kind, found.growth, found.integrals) == ("integrable", (n - m, n - m), m)
        assert found.constraints["law"].kind == "integrable"
        regular += 1
    assert regular >= 0.8 * hunt.cases(25) - 1


def test_exact_forms_beside_one_that_is_not(hunt: Hunt) -> None:
    """m exact forms and one that turns in what they leave: m functions keep their value, all else
    is reached.
    """
    rng = hunt.rng()
    regular = 0
    for _ in range(hunt.cases(15)):
        n = int(rng.integers(4, 7))
        m = int(rng.integers(1, n - 2))
        names = [f"u{i}" for i in range(n)]
        turns = [
            f"{x} + sin({x})" if i == n - 2 else "1" if i == n - 1 else "0"
            for i, x in zip(range(n), [*names[-1:], *names[:-1]], strict=True)
        ]
        free = names[: n - 1]
        rows = [[*row, "0"] for row in exact_rows(free, m, rng)]
        system = sliding(tuple(names), [*rows, turns])
        q = rng.uniform(-0.6, 0.6, size=n)
        if min(np.linalg.svd(evaluate_velocity_rows(system, q)[0], compute_uv=False)) < 1e-2:
            continue
        found = system.classify(q)
        assert found.kind == "nonholonomic"
        assert (found.reachable_around, found.integrals) == (n - m, m)
        regular += 1
    assert regular >= 0.8 * hunt.cases(15) - 1


# ---- alone and together


def test_each_alone_and_all_together() -> None:
    """dz = y dx is not integrable, dy = 0 is; together they are (z - y x keeps its value)."""
    m = Mechanism("slides")
    last = m.ground
    for i, name in enumerate("xyz"):
        body = m.body(f"B{i}")
        m.joint(name, "prismatic", last, body, axis=np.eye(3)[i])
        last = body
    m.velocity_equation("twisted", [["-y", 0, 1]], ("x", "y", "z"))
    m.velocity_equation("straight", [[0, 1, 0]], ("x", "y", "z"))
    found = System(m).classify({"x": 0.3, "y": 0.4, "z": 0.1})
    kinds = {n: (c.kind, c.growth, c.reaches) for n, c in found.constraints.items()}
    assert kinds == {"twisted": ("nonholonomic", (2, 3), 3), "straight": ("integrable", (2, 2), 2)}
    assert (found.kind, found.growth, found.integrals) == ("integrable", (1, 1), 2)


def test_two_axles_go_straight_ahead() -> None:
    """Each alone reaches everything, together one line."""
    found = two_axles().classify()
    assert [c.growth for c in found.constraints.values()] == [(2, 3), (2, 3)]
    assert "2 functions of position keep their values" in found.sentence


def test_wheels_on_one_axle_are_harmless() -> None:
    """The second wheel of an axle takes nothing: all numbers are those of the car with one."""
    one = trailers(2)
    two = trailers(2, second=True)
    q = close_by(one, np.random.default_rng(1))
    a = one.classify(q)
    b = two.classify(q)
    assert (a.growth, a.degree, a.velocity_dof, a.kind) == (
        b.growth,
        b.degree,
        b.velocity_dof,
        b.kind,
    )
    assert b.constraints["left wheel 0"].growth == b.constraints["wheel 0"].growth


@pytest.mark.parametrize(("axis", "growth"), [((1.0, 0.0), (1,)), ((0.0, 1.0), (0, 0))])
def test_a_wheel_that_never_moves_takes_nothing(axis, growth) -> None:
    """Of a slide along its heading a wheel takes nothing, across it all."""
    m = Mechanism("slide", dim=2)
    body = m.body("B")
    m.joint("S", "prismatic", m.ground, body, axis=axis)
    m.no_sideslip("wheel", body)
    found = System(m).classify()
    assert (found.velocity_dof, found.kind, found.growth) == (growth[0], "integrable", growth)
    assert found.constraints["wheel"].independent == 1 - growth[0]


def test_kinds_of_all_sorts_beside_each_other() -> None:
    """A rod is holonomic, a wheel nonholonomic, a contact unilateral; `data` is plain and says the
    same.
    """
    m = Mechanism("all", dim=2)
    car = m.body("car")
    mass = m.body("mass")
    m.joint("P", "planar", m.ground, car)
    m.joint("M", "planar", m.ground, mass)
    m.distance("rod", car, mass, 2.0)
    m.no_sideslip("wheel", car)
    m.contact("floor", mass)
    found = System(m).classify({"M.x": 1.2, "M.y": 1.6})
    kinds = {n: c.kind for n, c in found.constraints.items()}
    assert kinds == {"rod": "holonomic", "wheel": "nonholonomic", "floor": "unilateral"}
    assert (found.position_dof, found.velocity_dof, found.reachable_dimension) == (5, 4, 5)
    assert found.constraints["rod"].independent == 1
    data = json.loads(json.dumps(found.data(), allow_nan=False))
    assert data["constraints"]["wheel"]["kind"] == "nonholonomic" and data["growth"] == [4, 5]
    assert data["status"] in str(found) and found._repr_html_().count("<tr>") == str(found).count(
        "\n  "
    ) - sum(line.startswith(" " * 18) for line in str(found).splitlines())


def test_contact_is_closed_or_open() -> None:
    """A ball that may jump: rows of rolling count while it touches, and the report says whether it
    does.
    """
    system = on_plane(one_sided=True)
    touching, above = (system.classify({"F.z": z}) for z in (0.4, 0.9))
    assert touching.one_sided is not None and touching.one_sided.active == ("rolling",)
    assert above.one_sided is not None and above.one_sided.active == ()
    assert "while it touches" in touching.constraints["rolling"].sentence
    assert (
        "while it touches" not in on_plane().classify({"F.z": 0.4}).constraints["rolling"].sentence
    )


def test_only_contacts_are_unilateral() -> None:
    """A ball above the ground has all freedoms."""
    m = Mechanism("ball")
    ball = m.body("ball")
    m.joint("F", "free", m.ground, ball)
    m.contact("floor", ball, radius=0.1)
    found = System(m).classify({"F.z": 0.1})
    assert (found.kind, found.position_dof, found.velocity_dof) == ("unilateral", 6, 6)
    assert found.constraints["floor"].kind == "unilateral"
    assert "can only grow" in str(found)


def test_loops_alone_are_holonomic() -> None:
    """A four-bar has no rows of velocity."""
    found = steered_car(True)
    assert found.classify().constraints["C"].kind == "holonomic"
    assert found.mechanism.lock({"car.x": 0.0, "car.y": 0.0, "car.rz": 0.0}).build().nq == 4


# ---- time


def test_speed_along_the_axle_drifts() -> None:
    """A wheel dragged aside at constant speed: the freedoms, and what is reached in space and time,
    as symbols say.

    With the clock as a coordinate T, and speed u, the rows are sin(t) dx - cos(t) dy + u dT = 0.
    """
    m = Mechanism("car", dim=2)
    car = m.body("car")
    m.joint("P", "planar", m.ground, car)
    m.no_sideslip("wheel", car, speed=0.5)
    found = System(m).classify({"P.rz": 0.7})
    clock = Pfaffian("x y t T", (("sin(t)", "-cos(t)", "0", "1/2"),))
    q = np.array([0.0, 0.0, 0.7, 0.0])
    whole = growth_by_symbols(clock, q, [0, 2, 3], 2)
    assert found.growth == tuple(d - 1 for d in whole)
    assert (found.velocity_dof, found.reachable_dimension, found.kind) == (2, 3, "nonholonomic")


@pytest.mark.parametrize("b", ["sin(t)", "3*t^2", 2])
def test_prescribed_velocities_are_integrable(b: Any) -> None:
    """x' = b(t) is the rate of a function of x and t."""
    found = sliding(("x", "y"), [[1, 0]], b, time=True).classify(t=0.4)
    assert (found.kind, found.growth, found.integrals) == ("integrable", (1, 1), 1)


def test_rows_that_turn_with_time() -> None:
    """cos(t) dx + sin(t) dy = 0 is integrable at every moment, yet with the time that goes on it is
    not.
    """
    found = sliding(("x", "y"), [["cos(t)", "sin(t)"]], time=True).classify(t=0.4)
    whole = growth_by_symbols(
        Pfaffian("x y T", (("cos(T)", "sin(T)", "0"),)), np.array([0.1, 0.2, 0.4]), [1, 2], 2
    )
    assert found.growth == tuple(d - 1 for d in whole)
    assert found.kind == "nonholonomic"


def test_velocities_that_contradict_each_other() -> None:
    """x' = 0 and x' = 1: said, not computed with."""
    found = sliding(("x", "y"), [[1, 0], [1, 0]], [0, 1]).classify()
    assert "contradict each other" in found.sentence and found.growth is None


# ---- what cannot be decided in double precision


def test_long_trains_are_right_or_doubtful(hunt: Hunt) -> None:
    """Each trailer adds one dimension by brackets one letter longer: if that is not found it is not
    denied.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(8)):
        n = int(rng.integers(6, 12))
        system = trailers(n)
        found = system.classify(close_by(system, rng))
        assert found.kind == "nonholonomic"
        if found.reachable_dimension != n + 3:
            assert found.doubtful or found.degree is None
            assert "at least" in found.sentence or "beyond" in str(found)
        else:
            assert found.growth == tuple(range(2, n + 4))


# ---- singular places


def test_trailer_across() -> None:
    """The second trailer's car stands across: one more letter is needed, and said so."""
    system = trailers(2)
    found = system.classify({"H0": np.pi / 2, "H1": 0.2})
    assert (found.growth, found.growth_around) == ((2, 3, 4, 4, 5), (2, 3, 4, 5))
    assert found.singular and "q is singular" in str(found)


def test_leaf() -> None:
    """On the leaf z = 0 motions stay there though they reach everything from places around."""
    system = sliding(("x", "y", "z"), [["0", "-x*z", "1"]])
    found = system.classify({"x": 0.3, "y": 0.2, "z": 0.0})
    assert (found.growth, found.reachable_dimension, found.reachable_around) == ((2, 2), 2, 3)
    assert "motions reach 2 dimensions of 3" in found.sentence


def test_turn_and_place_do_not_matter(hunt: Hunt) -> None:
    """The same car elsewhere, turned otherwise."""
    system = trailers(2)
    rng = hunt.rng()
    inner = {"H0": 0.4, "H1": -0.7}
    found = [
        system.classify({**inner, "car.x": x, "car.y": y, "car.rz": z})
        for x, y, z in 3 * rng.normal(size=(3, 3))
    ]
    assert {(f.growth, f.degree, f.doubtful) for f in found} == {((2, 3, 4, 5), 4, False)}


# ---- bad input


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"q": [0.0, 0.0]}, "q has 2 coordinates; steered car needs 4"),
        ({"q": np.zeros((2, 4))}, "shape"),
        ({"q": [np.nan] * 4}, "finite"),
        ({"q": "home"}, "q"),
        ({"t": "noon"}, "t is 'noon'"),
        ({"t": [0.0, 1.0]}, "one number"),
        ({"q": {"steerin": 0.1}}, "did you mean 'steering'"),
        ({"rng": "x"}, "rng"),
    ],
)
def test_bad_input(arguments: dict, said: str) -> None:
    """Refused, with what is wrong."""
    with pytest.raises((InputError, KeyError), match=said):
        steered_car().classify(**arguments)


def test_starts_that_are_not_closed() -> None:
    """Refused with the distance, or projected on request; rounding is no trouble."""
    system = on_plane()
    with pytest.raises(InputError, match=re.escape("0.3 away: project=True takes it")):
        system.classify(
            {"F.z": 0.7}
            | {n: float(n.endswith("qw")) for n in system.coordinate_names if n != "F.z"}
        )
    q = system.neutral.copy()
    q[2] = 0.7
    found = system.classify(q, project=True)
    assert found.moved == pytest.approx(0.3)
    assert found.q[2] == pytest.approx(0.4)
    assert "q is 0.3 away from what was given" in str(found)
    q[2] = 0.4 + 1e-9
    assert system.classify(q).growth == (3, 5)


def test_what_cannot_be_closed_is_refused() -> None:
    """No configuration at all."""
    m = Mechanism("far", dim=2)
    a = m.body("a")
    b = m.body("b")
    m.joint("A", "revolute", m.ground, a)
    m.joint("B", "revolute", a, b, at=(1.0, 0.0))
    m.distance("rod", m.ground, b, 5.0, child_at=(1.0, 0.0))
    m.no_sideslip("wheel", b)
    with pytest.raises(InputError, match="cannot be closed"):
        System(m).classify()


def test_functions_that_cannot_be_recorded_are_named() -> None:
    """Their series are needed."""
    m = Mechanism("bent", dim=2)
    body = m.body("B")
    m.joint("P", "planar", m.ground, body)
    m.equation("kink", lambda q: q["P.x"] if q["P.y"] > 0 else q["P.x"] * 2, of=("P.x", "P.y"))
    m.no_sideslip("wheel", body)
    with pytest.raises(UnsupportedError, match="'kink'"):
        System(m).classify()


# ---- motions at random


@pytest.mark.parametrize("times", [1, 3])
def test_random_motions_keep_what_their_rows_hold(times: int) -> None:
    """A body on a ball joint and one that floats, with a rod and an axis: nothing is corrected, and
    all stays true.
    """
    m = Mechanism("hung")
    m.joint("S", "spherical", m.ground, m.body("a"), at=(0.1, 0.2, 0.3), rpy=(0.3, 0.2, 0.1))
    m.joint("F", "free", m.ground, m.body("b"))
    m.distance("rod", "a", "b", 0.7, at=(0.2, -0.1, 0.3), child_at=(0.1, 0.3, -0.2))
    m.frame("pin", "a", rpy=(0.4, 0.5, 0.6))
    m.constrain(constraints.Pointing("pin", (0.6, 0.0, 0.8)), "axis")
    system = m.build()
    q = system.assemble(start=system.random(4)).q
    rows = record_tangent_rows(system)
    rng = np.random.default_rng(times)
    place = EvaluationPoint(rows, q, 0.0, tuple(range(len(rows.names))), lambda q: q)
    for _ in range(times):
        place = sample_reachable_point(place, (), rng)
    assert (
        np.abs(evaluate_constraints(system, place.q)[0]).max() < 1e-9
        and np.abs(place.q - q).max() > 0.1
    )
    assert np.abs(system.fk(place.q, "a")[:3, :3] - system.fk(q, "a")[:3, :3]).max() > 0.1


def test_rows_that_lose_rank_at_one_place() -> None:
    """x dy = 0: at x = 0 nothing is forbidden, around y cannot change, so no field of velocities
    goes on smoothly.
    """
    system = sliding(("x", "y", "z"), [[0, "x", 0]])
    found = system.classify([0.0, 0.3, 0.1])
    assert (found.velocity_dof, found.growth, found.reachable_dimension) == (3, None, None)
    assert "lose rank at q" in str(found)
    assert system.classify([0.5, 0.3, 0.1]).growth == (2, 2)


def test_scales_of_coordinates_and_rows_do_not_change_the_kind_unless_it_is_doubtful(
    hunt: Hunt,
) -> None:
    """The contact form dz = y dx, its coordinates and its row scaled by powers of ten, at places
    far away.
    """
    rng = hunt.rng()
    plain = "nonholonomic, motions reach every configuration around"
    for _ in range(hunt.cases(60)):
        a, b, row, far = (10.0 ** rng.uniform([-6, -6, -6, 0], [6, 6, 6, 12])).tolist()
        rows = [[f"{-a * row!r}*y", 0, f"{b * row!r}"]]
        found = sliding(("x", "y", "z"), rows).classify([0.3, rng.choice([-1, 1]) * far, 0.2])
        assert found.doubtful or plain in found.status, (a, b, row, far, found.status)
        assert (
            not found.doubtful or "cannot be decided" in found.status or "doubtful" in found.status
        )
        law = found.constraints["law"]
        assert law.doubtful or law.kind == "nonholonomic"
        assert not law.doubtful or "cannot be decided" in law.sentence


def test_far_places_of_what_is_integrable_are_not_said_to_reach_more(hunt: Hunt) -> None:
    """The exact forms d(x^2 + c y) and d(x y z), scaled and far away: never more than functions of
    position allow.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        scale, far = (10.0 ** rng.uniform([-6, 0], [6, 9])).tolist()
        rows = (
            [[f"{2 * scale!r}*x", f"{scale!r}", 0]]
            if rng.random() < 0.5
            else [["y*z", "x*z", "x*y"]]
        )
        found = sliding(("x", "y", "z"), rows).classify(far * rng.uniform(0.5, 1.0, 3))
        assert found.reachable_dimension == 2 and "every configuration" not in found.status


@pytest.mark.parametrize("y", [1e7, 1e9, 1e12])
def test_a_contact_form_far_away_is_not_said_to_be_integrable(y: float) -> None:
    found = sliding(("x", "y", "z"), [["-y", 0, 1]]).classify([0.3, y, 0.2])
    assert found.doubtful and "integrable" not in found.status.replace(
        "whether it is integrable", ""
    )


def test_rows_in_other_units_are_the_same_rows_or_doubtful(hunt: Hunt) -> None:
    """Two contact forms over six slides, one row scaled by 1e-18 to 1e18: the same growth, or a
    word of doubt.
    """
    rng = hunt.rng()
    names = ("x", "y", "z", "u", "v", "w")
    for _ in range(hunt.cases(40)):
        a, b = (10.0 ** rng.uniform(-9, 9, 2)).tolist()
        rows = [[f"{-a!r}*y", 0, a, 0, 0, 0], [0, f"{b!r}*u", 0, f"{b!r}*v", 0, b]]
        found = sliding(names, rows).classify(rng.uniform(-1, 1, 6))
        plain = sliding(names, [["-y", 0, 1, 0, 0, 0], [0, "u", 0, "v", 0, 1]]).classify(found.q)
        same = (found.velocity_dof, found.growth, found.kind) == (
            plain.velocity_dof,
            plain.growth,
            plain.kind,
        )
        assert same or (found.doubtful and ("doubtful" in found.status or "beyond" in found.status))
