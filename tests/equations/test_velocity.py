"""Rows A(q) v = b against finite differences of poses, and tangents of what holds positions against
its motions.
"""

from __future__ import annotations

import numpy as np
import pytest
from hunts import Hunt

from kempe import Mechanism
from kempe.constraints import NoSideslip, Rolls
from kempe.constraints.base import evaluate_number_fields
from kempe.equations.velocity import evaluate_velocity_rows, list_velocity_row_names
from kempe.spatial import Array, inverse
from kempe.system import System

TURNING = [
    "revolute",
    "prismatic",
    "helical",
    "cylindrical",
    "universal",
    "planar",
    "spherical",
    "free",
]
STEP = 1e-6
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
POSE = [*"xyz", *(i + j for i in "xyz" for j in "xyz")]


def twist_of(system: System, declared, q: Array, k: int) -> Array:
    """The twist (6,) of frame B against A, in axes of A at B's origin, under velocity k, by central
    differences.
    """
    ends = declared.frames(system.mechanism.parameters, system.dim)

    def pose(step: float) -> Array:
        A, B = (
            system.fk(system.configuration_space.integrate(q, step * np.eye(system.nv)[k]), n) @ X
            for n, X in zip((declared.parent, declared.child), ends, strict=True)
        )
        return inverse(A) @ B

    before = pose(-STEP)
    here = pose(0.0)
    after = pose(STEP)
    turn = (after[:3, :3] - before[:3, :3]) / (2 * STEP) @ here[:3, :3].T
    return np.array(
        [*(after[:3, 3] - before[:3, 3]) / (2 * STEP), turn[2, 1], turn[0, 2], turn[1, 0]]
    )


def rates_by_differences(system: System, q: Array) -> tuple[Array, Array]:
    """A and b from expressions evaluated by numpy, at poses of `fk` and their differences."""
    A = []
    b = []
    for declared in system.mechanism.constraints.values():
        made = evaluate_number_fields(declared.of, system.mechanism.parameters)
        ends = declared.frames(system.mechanism.parameters, system.dim)
        X, Y = (
            system.fk(q, n) @ E
            for n, E in zip((declared.parent, declared.child), ends, strict=True)
        )
        X = inverse(X) @ Y
        given = dict(zip(POSE, [*X[:3, 3], *X[:3, :3].ravel()], strict=True))
        given |= {
            n: float(getattr(made, n))
            for n in ("speed", "radius")
            if isinstance(getattr(made, n, None), float)
        }
        still = dict.fromkeys(TWIST, 0.0)
        for row in made.list_rows(system.dim):
            if row.velocity:
                tape, which = row.args
                value = tape.evaluate_outputs(given | still)[which]
                twists = [
                    dict(zip(TWIST, twist_of(system, declared, q, k), strict=True))
                    for k in range(system.nv)
                ]
                A.append([tape.evaluate_outputs(given | twist)[which] - value for twist in twists])
                b.append(-value)
    return np.array(A), np.array(b)


def random_tree(rng: np.random.Generator, dim: int) -> Mechanism:
    """A tree of any joints, with constraints of velocity between any two of its bodies, or one and
    the ground.
    """
    m = Mechanism("tree", dim=dim)
    bodies = []
    kinds = TURNING if dim == 3 else ["revolute", "prismatic", "planar", "free"]

    def place() -> dict:
        at = rng.normal(size=dim)
        return (
            {"at": at, "rpy": rng.normal(size=3)}
            if dim == 3
            else {"at": at, "angle": float(rng.normal())}
        )

    for k in range(rng.integers(1, 6)):
        on = bodies[rng.integers(len(bodies))] if bodies and rng.random() < 0.8 else m.ground
        bodies.append(m.body(f"B{k}"))
        kind = str(rng.choice(kinds))
        sliding = {"at": rng.normal(size=2), "axis": (1.0, 0.5)}
        m.joint(
            f"J{k}",
            kind,
            on,
            bodies[-1],
            **(sliding if dim == 2 and kind == "prismatic" else place()),
        )
    for k, body in enumerate(bodies):
        m.frame(f"F{k}", body, **place())
    m.frame("table", m.ground, **place())
    for k in range(rng.integers(1, 4)):
        i = rng.integers(len(bodies))
        j = rng.integers(-1, len(bodies))
        other = None if i == j else "table" if j < 0 else f"F{j}"
        if rng.random() < 0.5:
            m.constrain(NoSideslip(f"F{i}", other, speed=float(rng.normal())), f"C{k}")
        else:
            shape = str(rng.choice(["ball", "disc"]))
            spin = bool(rng.random() < 0.5)
            m.constrain(Rolls(f"F{i}", other, float(rng.uniform(0.1, 1)), shape, spin), f"C{k}")
    return m


@pytest.mark.parametrize("dim", [2, 3])
def test_rates_are_those_of_poses(dim: int, hunt: Hunt) -> None:
    """Random trees of all joints, random frames on them, random constraints between any two."""
    rng = hunt.rng()
    for _ in range(hunt.cases(25)):
        system = random_tree(rng, dim).build()
        q = system.random(rng)
        A, b = evaluate_velocity_rows(system, q)
        expected, right = rates_by_differences(system, q)
        assert A.shape == (len(list_velocity_row_names(system)), system.nv)
        scale = 1.0 + np.abs(expected).max()
        np.testing.assert_allclose(A, expected, atol=2e-8 * scale)
        np.testing.assert_allclose(b, right, atol=1e-12 * scale)


def car(trailers: int = 0) -> System:
    """A car whose rear wheels do not slip, with trailers."""
    m = Mechanism("car", dim=2)
    m.free("pose", m.ground, m.body("car"))
    m.no_sideslip("rear axle", "car")
    for k in range(trailers):
        m.revolute(
            f"hitch {k}",
            m.bodies["car" if not k else f"trailer {k - 1}"],
            m.body(f"trailer {k}"),
            child_at=(1.0, 0.0),
        )
        m.no_sideslip(f"axle {k}", f"trailer {k}")
    return m.build()


def test_rates_of_a_car() -> None:
    """No velocity across: -sin x' + cos y' = 0."""
    q = np.array([[0.3, 0.2, 0.7], [0.0, 0.0, 0.0]])
    A, b = evaluate_velocity_rows(car(), q)
    np.testing.assert_allclose(
        A[:, 0], np.stack([-np.sin(q[:, 2]), np.cos(q[:, 2]), 0 * q[:, 2]], axis=-1), atol=1e-15
    )
    np.testing.assert_array_equal(b, np.zeros((2, 1)))
    assert list_velocity_row_names(car()) == (("rear axle", "sideslip"),)


@pytest.mark.parametrize("shape", [(), (0,), (1,), (3, 5)])
def test_batches(shape: tuple[int, ...]) -> None:
    """Leading axes are those of q and of the time, together."""
    system = car(2)
    q = system.random(0, shape)
    A, b = evaluate_velocity_rows(system, q)
    assert (A.shape, b.shape) == ((*shape, 3, system.nv), (*shape, 3))
    for i in np.ndindex(*shape):
        np.testing.assert_array_equal(A[i], evaluate_velocity_rows(system, q[i])[0])
    assert evaluate_velocity_rows(system, q, np.zeros((2, *([1] * len(shape)))))[0].shape == (
        2,
        *shape,
        3,
        system.nv,
    )


def test_a_system_without_velocity_constraints_has_no_rows() -> None:
    """Not one row, whatever its size."""
    m = Mechanism("pendulum", dim=2)
    m.revolute("A", m.ground, m.body("rod"))
    A, b = evaluate_velocity_rows(m.build(), [0.3])
    assert (A.shape, b.shape, list_velocity_row_names(m.build())) == ((0, 1), (0,), ())
