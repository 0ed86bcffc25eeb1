"""`at_least` and `at_most`, alike for all kinds that measure one number: against that number
computed by hand.
"""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
import pytest
from hunts import some
from kinds_battery import EXAMPLES, RING, two_bodies
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

import kempe
from kempe import constraints as c
from kempe.constraints.base import Bounded
from kempe.constraints.kinds import Measured
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.errors import CallError, InputError

BOUNDED = [name for name in EXAMPLES if issubclass(c.KINDS[name], Bounded)]
KINDS = [name for name, kind in c.KINDS.items() if issubclass(kind, Measured) and name in EXAMPLES]
INSTEAD = {"on_sphere": "radius", "distance": "value"}


def bounded(name: str, dim: int, **bounds) -> c.Constraint:
    """The example of a kind with bounds in place of its value."""
    none = {INSTEAD[name]: None} if name in INSTEAD else {}
    return EXAMPLES[name](dim).demand(**none, **bounds)


def _angle(a, b):
    return math.atan2(np.linalg.norm(np.cross(a, b)), a @ b)


def _curve(p, dim):
    points = (
        np.vstack([RING[:, :dim], RING[:1, :dim]])
        if not np.allclose(RING[0], RING[-1])
        else RING[:, :dim].copy()
    )
    points[-1] = points[0]
    s = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    spline = CubicSpline(s, points, bc_type="periodic")
    off = lambda t: np.linalg.norm(spline(t) - p[:dim])  # noqa: E731
    grid = np.linspace(0.0, s[-1], 2001)
    best = grid[np.argmin([off(t) for t in grid])]
    return minimize_scalar(
        off, bounds=(best - 0.01, best + 0.01), method="bounded", options={"xatol": 1e-12}
    ).fun


def measured(name: str, dim: int, made, system, q) -> float:
    """The number that a kind measures, from poses alone."""
    eye = system.fk(q, "eye")
    tip = system.fk(q, "tip")
    X = np.linalg.inv(eye) @ tip if made.other == "eye" else tip
    flat = lambda x: np.pad(np.asarray(x, float), (0, 3 - len(x)))  # noqa: E731
    point = X[:3, 3] + X[:3, :3] @ flat(getattr(made, "point", np.zeros(3)))
    axis = X[:3, 0 if dim == 2 else 2]
    return {
        "position": lambda: np.linalg.norm(point - flat(made.target)),
        "relative_position": lambda: np.linalg.norm(point - flat(made.target)),
        "orientation": lambda: Rotation.from_matrix(
            np.asarray(made.target).T @ X[:3, :3]
        ).magnitude(),
        "pointing": lambda: _angle(axis, flat(made.direction)),
        "look_at": lambda: _angle(axis, flat(made.target) - X[:3, 3]),
        "on_line": lambda: (
            np.linalg.norm(np.cross(point - flat(made.origin), flat(made.direction)))
            / np.linalg.norm(made.direction)
        ),
        "on_plane": lambda: (
            (point - flat(made.origin)) @ flat(made.normal) / np.linalg.norm(made.normal)
        ),
        "on_sphere": lambda: np.linalg.norm(point - flat(made.center)),
        "distance": lambda: np.linalg.norm(point),
        "on_surface": lambda: point[0] ** 2 / 4.0 + point[1] ** 2 - 1.0,
        "on_curve": lambda: _curve(point, dim),
    }[name]()


@pytest.mark.parametrize("dim", some([2, 3], 3))
@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize(
    "bounds", [{"at_least": 0.4}, {"at_most": 0.3}, {"at_least": 0.3, "at_most": 0.35}], ids=str
)
def test_declared_and_as_tasks(name, dim, bounds, hunt):
    if name in INSTEAD and "at_most" not in bounds:
        bounds = {"at_least": 1.3}
    made = bounded(name, dim, **bounds)
    rng = hunt.rng()
    low = bounds.get("at_least", -math.inf)
    high = bounds.get("at_most", math.inf)
    m = two_bodies(dim)
    m.constrain(made, "it")
    assert read_toml(write_toml(m)) == m
    free = two_bodies(dim).build()
    held = m.build()
    assert held.mobility().dof == free.nv, "one-sided rows take no freedom"
    moved = 0
    # from where the kind holds without bounds, and from far away
    for k in range(max(hunt.cases(6), 2)):
        q = free.random(rng) if k % 2 else free.ik(EXAMPLES[name](dim), start=free.random(rng)).q
        q = free.configuration_space.integrate(
            q, rng.uniform(-1.0, 1.0, free.nv) * (6.0 if k % 2 else 0.05)
        )
        while k == 1 and high < math.inf and low <= measured(name, dim, made, free, q) <= high:
            q = free.configuration_space.integrate(q, rng.uniform(-1.0, 1.0, free.nv))
        before = measured(name, dim, made, free, q)
        for answer in (free.ik(made, start=q), held.assemble({}, q)):
            assert answer.success, answer.status
            assert low - 1e-6 <= measured(name, dim, made, free, answer.q) <= high + 1e-6
            if low <= before <= high:
                assert np.allclose(free.configuration_space.difference(q, answer.q), 0.0), (
                    "nothing has to move"
                )
            else:
                moved += 1
    assert moved, "the bounds mattered somewhere"


@pytest.mark.parametrize("name", KINDS)
def test_bounds_from_target_to_target(name, hunt):
    s = two_bodies(3).build()
    most = np.linspace(0.2, 0.9, 5)
    answer = s.ik(bounded(name, 3, at_most=most), start=s.random(hunt.rng()))
    assert answer.success.shape == (5,) and answer.success.all()
    made = bounded(name, 3, at_most=1.0)
    for q, bound in zip(answer.q, most, strict=True):
        assert measured(name, 3, made, s, q) <= bound + 1e-6


@pytest.mark.parametrize("name", KINDS)
def test_bounds_that_leave_nothing(name):
    m = two_bodies(3)
    with pytest.raises(kempe.errors.KempeError, match="leave nothing"):
        m.constrain(bounded(name, 3, at_least=0.5, at_most=0.4), "it")
    if bounded(name, 3, at_most=1.0).measured not in ("height", "value"):
        with pytest.raises(kempe.errors.KempeError, match="bound"):
            m.constrain(bounded(name, 3, at_most=-0.1), "it")
    with pytest.raises(kempe.errors.KempeError, match="bound|finite|number"):
        m.constrain(bounded(name, 3, at_most=math.nan), "it")


@pytest.mark.parametrize("name", sorted(set(INSTEAD)))
def test_a_value_and_bounds(name):
    with pytest.raises(InputError, match=f"needs a {INSTEAD[name]}, or at_least or at_most"):
        two_bodies(3).build().ik(EXAMPLES[name](3).demand(at_most=1.0))


def branching(q):
    return 2.0 * q["Ja.x"] if q["Ja.x"] > 0.0 else q["Ja.x"]


NUMBERS = {
    "equation": (
        lambda **b: c.Equation("`Ja.x` - 2*`Jb.x`", **b),
        lambda s, q: q[0] - 2.0 * s.q_dict(q)["Jb.x"],
    ),
    "function of coordinates": (
        lambda **b: c.Equation(branching, of="Ja.x", **b),
        lambda s, q: q[0] + max(q[0], 0.0),
    ),
    "inequality": (lambda **b: c.Inequality("`Ja.x`^2", **b), lambda s, q: q[0] ** 2),
    "centre_of_mass": (
        lambda **b: c.CentreOfMass(axes="y", **b),
        lambda s, q: (s.fk(q, "a")[1, 3] + s.fk(q, "b")[1, 3]) / 2.0,
    ),
    "centre_of_points": (
        lambda **b: c.CentreOfPoints({"tip": 2.0, "eye": 1.0}, axes="x", **b),
        lambda s, q: (2.0 * s.fk(q, "tip")[0, 3] + s.fk(q, "eye")[0, 3]) / 3.0,
    ),
}
"""Kinds of the whole configuration with bounds, and the number that they measure."""


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize(
    "bounds", [{"at_least": 0.4}, {"at_most": 0.3}, {"at_least": 0.3, "at_most": 0.35}], ids=str
)
def test_expressions_and_centres_have_bounds(name, bounds, hunt):
    make, number = NUMBERS[name]
    made = make(**bounds)
    rng = hunt.rng()
    free = two_bodies(3).build()
    low = bounds.get("at_least", -math.inf)
    high = bounds.get("at_most", math.inf)
    solve = [lambda q: free.ik(made.demand(weight=None), start=q).q]
    if not name.startswith("centre"):
        m = two_bodies(3)
        m.constrain(made, "it")
        assert name.startswith("function") or read_toml(write_toml(m)) == m
        held = m.build()
        assert held.mobility().dof == free.nv
        solve.append(lambda q: held.assemble({}, q).q)
    slack = set()
    for _ in range(hunt.cases(20)):
        q = free.configuration_space.integrate(free.neutral, rng.uniform(-1.0, 1.0, free.nv))
        for f in solve:
            assert low - 1e-6 <= number(free, found := f(q)) <= high + 1e-6
            if low <= number(free, q) <= high:
                assert np.allclose(free.configuration_space.difference(q, found), 0.0), (
                    "nothing has to move"
                )
            slack.add(bool(low <= number(free, q) <= high))
    assert False in slack


@pytest.mark.parametrize("name", [n for n in NUMBERS if not n.startswith("function")])
def test_bounds_of_numbers_from_target_to_target(name, hunt):
    (make, number) = NUMBERS[name]
    s = two_bodies(3).build()
    low = np.linspace(0.1, 0.8, 6)
    high = np.array([0.2, 0.3, 0.6, np.inf, np.inf, 0.9])
    answer = s.ik(make(at_least=low, at_most=high), start=s.random(hunt.rng()))
    assert answer.success.all()
    for q, a, b in zip(answer.q, low, high, strict=True):
        assert a - 1e-6 <= number(s, q) <= b + 1e-6
    with pytest.raises(InputError, match="0.5 and 0.4 leave nothing"):
        s.ik(make(at_least=0.5, at_most=0.4))
    with pytest.raises(InputError):
        s.ik(make(at_most=math.nan))


def test_bounds_of_each_of_several_values(hunt):
    s = two_bodies(3).build()
    most = np.array([[0.1, 0.2], [-0.3, 0.4], [0.5, -0.6]])
    made = c.Equation(["`Ja.x`", "`Ja.y`"], at_least=-1.0, at_most=most)
    q = s.ik(made, start=s.configuration_space.integrate(s.neutral, np.full(s.nv, 0.9))).q
    np.testing.assert_allclose(q[:, :2], most, atol=1e-6)
    assert c.Equation(["x", "y"], at_most=[1.0, 2.0]).sentence == "x, y are at most (1, 2)"
    for low, high, said in (
        (None, [1, 2, 3], "must be a number, or"),
        ([1, 2], [1, 0], "leave nothing"),
    ):
        with pytest.raises(InputError, match=said):
            s.ik(c.Equation(["`Ja.x`", "`Ja.y`"], at_least=low, at_most=high))


@pytest.mark.parametrize(
    "make",
    [
        lambda: c.Equation("A = 2", at_most=1.0),
        lambda: two_bodies(3).build().ik(c.CentreOfMass([0, 0, 0], at_most=1.0)),
        lambda: two_bodies(3).build().ik(c.CentreOfMass(at_most=1.0)),
        lambda: two_bodies(3).build().ik(c.CentreOfMass()),
    ],
)
def test_a_value_besides_bounds_or_none_at_all_is_refused(make):
    with pytest.raises(
        InputError,
        match="within bounds|needs a target, or at_least or at_most along one of its axes",
    ):
        make()


@pytest.mark.parametrize("name", BOUNDED)
def test_kinds_that_are_bounded_have_bounds(name):
    assert {"at_least", "at_most"} <= {f.name for f in fields(c.KINDS[name])}


@pytest.mark.parametrize("name", [n for n in EXAMPLES if n not in BOUNDED])
def test_every_other_kind_says_why_it_has_no_bounds(name):
    given = {f.name: getattr(EXAMPLES[name](3), f.name) for f in fields(c.KINDS[name]) if f.init}
    with pytest.raises(CallError, match="measures no single number|bounds|at least|never negative"):
        c.KINDS[name](**given, at_most=0.1)


def test_a_glass_that_must_not_spill():
    """The axis of a wrist stays within 0.3 rad of the vertical while the hand goes elsewhere."""
    arm = kempe.load("puma560")
    q = np.array([0.2, -0.6, 2.4, 0.3, 0.5, 0.1])
    X = arm.fk(q, "tool")
    upright = c.Pointing("tool", X[:3, 2], at_most=0.3)
    answer = arm.ik([c.Position("tool", X[:3, 3] + [0.1, -0.1, 0.05]), upright])
    assert answer.success and _angle(arm.fk(answer.q, "tool")[:3, 2], X[:3, 2]) <= 0.3 + 1e-9
