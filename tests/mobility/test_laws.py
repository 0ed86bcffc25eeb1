"""Mobility, rank, redundancy and motions of mechanisms with equations: hand-computed freedoms, and
exact curves.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import kempe
from kempe import constraints as C
from kempe.equations.judge import judge_configurations
from kempe.errors import InputError, UnsupportedError


def chain(n: int, loop: bool = False) -> kempe.Mechanism:
    """A planar chain of n links of length 1 on hinges J1 ... Jn."""
    m = kempe.Mechanism("chain", dim=2)
    last = m.ground
    at = (0.0, 0.0)
    for k in range(1, n + 1):
        link = m.body(f"link{k}")
        m.revolute(f"J{k}", last, link, at=at)
        last = link
        at = (1.0, 0.0)
    m.frame("tip", last, at=(1.0, 0.0))
    return m


def fourbar() -> kempe.Mechanism:
    m = kempe.Mechanism("four-bar", dim=2)
    a, b, c = (m.body(n) for n in "abc")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1.0, 0.0))
    m.revolute("C", b, c, at=(3.0, 0.0))
    m.revolute("D", m.ground, c, at=(3.0, 0.0), child_at=(2.0, 0.0))
    return m


def spatial() -> kempe.Mechanism:
    """Six freedoms: three slides, then three hinges about x, y, z."""
    m = kempe.Mechanism("six")
    last = m.ground
    for k, (axis, kind) in enumerate((a, t) for t in ("prismatic", "revolute") for a in "xyz"):
        body = m.body(f"b{k}")
        m.joint(f"{'s' if kind == 'prismatic' else 'r'}{axis}", kind, last, body, axis=axis)
        last = body
    m.frame("hand", last, at=(0.3, 0.2, 0.1))
    return m


# name: mechanism, what is declared, configuration or None, Gruebler, rank freedoms, true freedoms,
# redundant
CASES = {
    "linear law": (chain(2), [C.Equation("J1 = 2*J2")], None, 1, 1, 1, 0),
    "two laws": (chain(3), [C.Equation(["J1 = 2*J2", "J3 = J1 + J2"])], None, 1, 1, 1, 0),
    "the same twice": (
        chain(2),
        [C.Equation("J1 = 2*J2"), C.Equation("3*J1 = 6*J2")],
        None,
        0,
        1,
        1,
        1,
    ),
    "the same, bent": (
        chain(2),
        [C.Equation("J1 = 2*J2"), C.Equation("J1^2 + J1 = 2*J2*(J1 + 1)")],
        [0.4, 0.2],
        0,
        1,
        1,
        1,
    ),
    "crossing lines": (chain(2), [C.Equation("J1*J2")], [0.0, 0.0], 1, 2, 1, 0),
    "crossing, beside": (chain(2), [C.Equation("J1*J2")], [0.5, 0.0], 1, 1, 1, 0),
    "a point only": (chain(2), [C.Equation("J1^2 + J2^2")], [0.0, 0.0], 1, 2, 0, 1),
    "ellipse": (chain(2), [C.OnSurface("tip", "(x/1.5)^2 + y^2 = 1")], None, 1, 1, 1, 0),
    "ellipse and law": (
        chain(3),
        [C.OnSurface("tip", "(x/1.5)^2 + y^2 = 1"), C.Equation("J1 = J3")],
        None,
        1,
        1,
        1,
        0,
    ),
    "surface": (spatial(), [C.OnSurface("hand", "x^2 + 2*y^2 + 3*z^2 = 1")], None, 5, 5, 5, 0),
    "surface and laws": (
        spatial(),
        [C.OnSurface("hand", "x*y = z + 0.2"), C.Equation(["rx = ry^2", "sx = sy"])],
        None,
        3,
        3,
        3,
        0,
    ),
    "plane as surface and kind": (
        spatial(),
        [C.OnSurface("hand", "z = 0.4"), C.OnPlane("hand", (0, 0, 0.4))],
        None,
        4,
        5,
        5,
        1,
    ),
    "four-bar held": (fourbar(), [C.Equation("A = 1.1")], None, 0, 0, 0, 0),
    "four-bar, its own angle sum": (fourbar(), [C.Equation("A + B + C = D")], None, 0, 1, 1, 1),
}


@pytest.mark.parametrize("case", CASES)
def test_freedoms(case: str):
    m, given, q, gruebler, rank, dof, redundant = CASES[case]
    m = m.copy()
    for k, constraint in enumerate(given):
        m.constrain(constraint, name=f"c{k}")
    found = m.build().mobility(q)
    assert found.closed, found.why_open
    assert (found.gruebler, found.rank_dof, found.dof) == (gruebler, rank, dof)
    assert found.redundant == redundant
    assert bool(redundant) == any(name.startswith("c") for name, _ in found.redundancy.stressed)


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e6])
def test_rank_does_not_depend_on_the_size_of_an_equation(factor: float):
    m = chain(3)
    m.equation("one", f"{factor}*(J1 - 2*J2)")
    m.equation("two", "sin(J3) = J1/5")
    m.equation("again", f"(J1 - 2*J2)/{factor}")
    found = m.build().mobility()
    assert (found.rank_dof, found.dof, found.redundant) == (1, 1, 1)


def test_contradictions_are_named_with_their_size():
    m = chain(2)
    m.equation("law", "J1 = 0.4")
    m.equation("other", "J1 = 0.5")
    found = m.build().mobility()
    assert (
        not found.closed
        and "constraint 'other' is off by 0.05" in found.why_open
        or "'law'" in found.why_open
    )
    assert found.residual == pytest.approx(np.hypot(0.05, 0.05), rel=1e-6)


def test_traced_and_driven():
    """J1 = 2 J2 on the arm: the tip runs on x = cos 2b + cos 3b, y = sin 2b + sin 3b."""
    m = chain(2)
    m.equation("law", "J1 = 2*J2")
    s = m.build()
    path = s.trace(driver="J2", start=[0.0, 0.0])
    np.testing.assert_allclose(path.q[:, 0], 2 * path.q[:, 1], atol=1e-9)
    driven = s.drive({"J2": 1.0}, start=[0.0, 0.0], times=np.linspace(0.0, 1.0, 5))
    np.testing.assert_allclose(driven.q[:, 0], 2 * driven.q[:, 1], atol=1e-9)


def test_modes():
    """J1 = sin J2 + J2/2 = 0.4 has one root; 1.2 sin J2 = 0.6 has two in a turn."""
    m = chain(2)
    m.equation("law", "J1 = 1.2*sin(J2)")
    modes = m.build().assembly_modes({"J1": 0.6})
    found = np.sort(np.mod(modes.q[:, 1], 2 * np.pi))
    np.testing.assert_allclose(found, [np.pi / 6, 5 * np.pi / 6], atol=1e-8)


@pytest.mark.parametrize(
    ("text", "certain", "said"),
    [
        ("J1 = 2*J2", True, "manifold"),
        ("J1 = J2^2", False, "how 'law' bends"),
    ],
)
def test_linear_laws_are_proven_and_bent_ones_are_not(text, certain, said):
    m = chain(2)
    m.equation("law", text)
    found = m.build().mobility()
    assert found.certain == certain and said in str(found)


def test_functions_without_series():
    m = chain(2)
    m.equation("law", lambda x: x["J1"] - 2 * x["J2"] if x["J1"] < 9 else 0.0, of=("J1", "J2"))
    s = m.build()
    assert s.mobility().dof == 1  # the rank suffices
    m.equation("again", "J1 = 2*J2")
    found = m.build().mobility()
    assert found.rank_dof == 1 and found.dof is None and found.redundant == 1
    assert "'law' is a Python function that cannot be recorded" in str(found)
    with pytest.raises(
        UnsupportedError, match="'law' is a Python function that cannot be recorded"
    ):
        from kempe.mobility.local_dimension import find_local_dimension

        find_local_dimension(s, np.zeros(2))


@pytest.mark.parametrize("count", [30, pytest.param(1000, marks=pytest.mark.slow)])
def test_random_laws_against_their_own_derivatives(hunt, count: int):
    """Laws A v + B sin v = c in 5 coordinates: freedoms are the nullity of A + B cos v at a random
    solution.
    """
    rng = hunt.rng()
    n = 5
    names = tuple(f"J{i}" for i in range(1, n + 1))
    for _ in range(hunt.cases(count)):
        k = int(rng.integers(1, 5))
        q = rng.normal(size=n)
        A, B = rng.normal(size=(2, k, n))
        if k > 1 and rng.random() < 0.5:  # a law that follows from the others
            A[-1], B[-1] = A[:-1].sum(axis=0), B[:-1].sum(axis=0)
        c = A @ q + B @ np.sin(q)

        def laws(x, A=A, B=B, c=c):
            v = np.array([x[name] for name in names])
            return list(A @ v + B @ np.sin(v) - c)

        m = chain(n)
        m.equation("laws", laws, of=names)
        found = m.build().mobility(q, local=False)
        assert found.rank_dof == n - np.linalg.matrix_rank(A + B * np.cos(q))
        assert found.gruebler == n - k


def cam(branching: bool = False) -> kempe.Mechanism:
    """A slide whose place is prescribed in time by the turn of a cam: y = 0.1 sin(A), A = 2 t."""
    m = kempe.Mechanism("cam", dim=2)
    m.revolute("A", m.ground, m.body("cam"))
    m.prismatic("y", m.ground, m.body("follower"), axis="y")
    law = (
        (lambda x, t: x["A"] - 2 * t if t > -9.0 else 0.0)
        if branching
        else lambda x, t: x["A"] - 2 * t
    )
    m.equation("motor", law, of=("A",), time=True)
    m.equation("cam", "y = sin(A)/10")
    return m


@pytest.mark.parametrize("branching", [False, True])
def test_equations_in_time(branching: bool):
    s = cam(branching).build()
    assert s.mobility().dof == 0
    for t in (0.0, 0.3, 1.2):
        found = s.assemble({"t": t}, start=[2 * t, 0.0])
        assert found.success
        np.testing.assert_allclose(found.q, [2 * t, 0.1 * np.sin(2 * t)], atol=1e-8)
    times = np.linspace(0.0, 2.0, 9)
    motion = s.drive({}, times=times, start=[0.0, 0.0])
    assert motion.success and motion.q.shape == (9, 2) and motion.system is s
    np.testing.assert_allclose(
        motion.q, np.stack([2 * times, 0.1 * np.sin(2 * times)], axis=1), atol=1e-8
    )


def test_time_is_no_input_of_a_motion():
    """One sample at time 0 was the answer to a hundred times given as an input."""
    with pytest.raises(InputError, match="'t' is the time and no input; give it by `times`"):
        cam().build().drive({"t": np.linspace(0.0, 2.0, 100)})


def test_time_and_inputs_together():
    m = kempe.Mechanism("two", dim=2)
    for name in "AB":
        m.revolute(name, m.ground, m.body(name.lower()))
    m.revolute("C", "b", m.body("c"))
    m.equation("law", "C = A*B + t^2", time=True)
    s = m.build()
    times = np.linspace(0.0, 1.0, 5)
    motion = s.drive({"A": lambda t: np.sin(t), "B": 0.5}, times=times, start=[0.0, 0.5, 0.0])
    np.testing.assert_allclose(motion.values("C"), np.sin(times) * 0.5 + times**2, atol=1e-8)


def test_many_times_are_for_drive():
    with pytest.raises(kempe.errors.InputError, match="drive"):
        cam().build().assemble({"t": np.array([0.0, 1.0])})


def blade() -> kempe.System:
    """A blade on ice whose heading is a law of time: rz = sin(2 t) / 2."""
    m = kempe.Mechanism("blade", dim=2)
    m.planar("p", m.ground, m.body("body"))
    m.no_sideslip("edge", "body")
    m.equation("turn", lambda x, t: x["p.rz"] - 0.5 * np.sin(2 * t), of=("p.rz",), time=True)
    return m.build()


@pytest.mark.slow
def test_time_and_rolling_together():
    """Against quadrature of the heading: x' = cos(rz), y' = sin(rz) at a forward speed of 1."""
    s = blade()
    r = s.simulate(3.0, inputs={"body.vx": 1.0})
    place = [quad(lambda t, f=f: f(0.5 * np.sin(2 * t)), 0.0, 3.0)[0] for f in (np.cos, np.sin)]
    np.testing.assert_allclose(r.q[-1], [*place, 0.5 * np.sin(6.0)], atol=1e-10)
    np.testing.assert_allclose(r.v[:, 2], np.cos(2 * r.t), atol=1e-9)
    assert r and r.judged and r.slip < 1e-12
    driven = s.drive({"p.x": r.q[:, 0]}, r.t, start=r.q[0])
    assert driven and driven.judged
    np.testing.assert_allclose(driven.q, r.q, atol=1e-5)
    with pytest.raises(UnsupportedError, match="inputs .none. leave 1 freedom"):
        s.simulate(1.0, inputs={})
    with pytest.raises(
        UnsupportedError, match="do not allow the input 'body.wz' = 3.*they allow 1"
    ):
        s.simulate(1.0, inputs={"body.vx": 1.0, "body.wz": 3.0})


def swaying(rng: np.random.Generator) -> tuple[kempe.System, tuple[float, ...]]:
    """Three hinges, one law in time that ties two of them: A + c sin(B) = a sin(w t + p)."""
    a = rng.uniform(0.1, 0.5)
    c = rng.uniform(-0.6, 0.6)
    w = rng.uniform(0.5, 4.0)
    p = rng.uniform(-3, 3)
    m = chain(3)
    m.equation("sway", f"J1 + {c!r}*sin(J2) = {a!r}*sin({w!r}*t + {p!r})", time=True)
    return m.build(), (float(a), float(c), float(w), float(p))


@pytest.mark.slow
def test_motions_follow_laws_in_time_and_the_judge_knows_the_time(hunt):
    """Against an integration of its own: J1' from the derivative of the law in time."""
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        s, (a, c, w, p) = swaying(rng)
        u, rate = rng.uniform(-1, 1, 2)
        q0 = np.array([a * np.sin(p), 0.0, 0.3])
        r = s.simulate(
            2.0,
            q0,
            inputs={"J2": u, "J3": lambda t, rate=rate: rate * np.cos(t)},
            budget=kempe.Budget(points=20),
        )
        dense = solve_ivp(
            lambda t, x, a=a, c=c, w=w, p=p, u=u: [
                a * w * np.cos(w * t + p) - c * np.cos(u * t) * u
            ],
            (0, 2),
            q0[:1],
            rtol=1e-12,
            atol=1e-12,
            t_eval=r.t,
        )
        np.testing.assert_allclose(r.q[:, 0], dense.y[0], atol=1e-9)
        np.testing.assert_allclose(
            r.q[:, 1:], np.stack([u * r.t, 0.3 + rate * np.sin(r.t)], axis=1), atol=1e-9
        )
        np.testing.assert_allclose(
            r.v[:, 0], a * w * np.cos(w * r.t + p) - c * np.cos(u * r.t) * u, atol=1e-8
        )
        assert r and r.judged, r.judged
        driven = s.drive({"J2": r.q[:, 1], "J3": r.q[:, 2]}, r.t, start=q0)
        assert driven and driven.judged
        np.testing.assert_allclose(driven.q, r.q, atol=1e-7)
        frozen = np.repeat(q0[None], len(r.t), axis=0)
        assert not judge_configurations(s, frozen, t=r.t), (
            "a motion that stands still misses the law"
        )
        t = rng.uniform(0.1, 2.0)
        there = s.assemble({"t": t}, start=q0)
        assert (
            there
            and there.judged
            and judge_configurations(s, there.q, t=t)
            and not judge_configurations(s, there.q + 0.1, t=t)
        )


def test_a_driven_motion_that_is_held_is_judged_at_the_time_of_its_pose():
    """The slide is bounded: it follows sin(t) up to 0.5, and waits there."""
    m = kempe.Mechanism("stop", dim=2)
    m.prismatic("x", m.ground, m.body("b"), axis="x", limits=(-1.0, 0.5))
    m.equation("law", "x = sin(t)", time=True)
    motion = m.build().drive({}, np.linspace(0.0, 1.0, 11))
    assert motion.held[-1] and not motion.held[0]
    assert motion.judged, motion.judged


def test_functions_that_branch_are_judged_in_time():
    s = cam(branching=True).build()
    motion = s.drive({}, times=np.linspace(0.0, 1.0, 5), start=[0.0, 0.0])
    assert motion and motion.judged


def test_an_inequality_in_time_ends_a_motion_where_it_is_met():
    """A slide at a speed of 1 meets a wall at 2 + sin(8 t) / 2, which comes and goes within a step."""
    m = kempe.Mechanism("wall", dim=2)
    m.prismatic("x", m.ground, m.body("b"), axis="x")
    m.inequality("wall", "2 + sin(8*t)/2 - x", time=True)
    r = m.build().simulate(3.0, {"x": 0.0}, inputs={"x": 1.0})
    t = np.linspace(0, 3, 3_000_001)
    meets = t[np.argmax(2 + np.sin(8 * t) / 2 - t < 0)]
    assert (
        not r and r.t[-1] == pytest.approx(meets, abs=2e-6) and "'wall' meets its bound" in r.status
    )
    gap = 2 + np.sin(8 * r.t) / 2 - r.q[:, 0]
    assert gap.min() > -1e-9
