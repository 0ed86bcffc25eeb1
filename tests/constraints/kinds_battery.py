"""One example of each kind of constraint, and what holds for all of them: run for each, and without
some of them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kempe import Mechanism, System, tasks
from kempe import constraints as c
from kempe.constraints.base import list_position_rows
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.equations import closure_rows
from kempe.errors import DescriptionError

X = np.array(
    [[0.0, -1.0, 0.0, 0.3], [1.0, 0.0, 0.0, 0.1], [0.0, 0.0, 1.0, 0.2], [0.0, 0.0, 0.0, 1.0]]
)
RING = np.array(
    [[np.cos(t), 0.7 * np.sin(t), 0.2 * np.sin(2.0 * t)] for t in np.linspace(0.0, 2.0 * np.pi, 20)]
)
FLAT = np.array([[0.0, -1.0, 0.3], [1.0, 0.0, 0.1], [0.0, 0.0, 1.0]])

EXAMPLES: dict[str, Callable[[int], c.Constraint]] = {
    "pose": lambda dim: c.Pose("tip", X if dim == 3 else FLAT),
    "position": lambda dim: c.Position("tip", [0.3, 0.1, 0.2][:dim], point=[0.1, 0.0, 0.0][:dim]),
    "orientation": lambda dim: c.Orientation("tip", X[:3, :3], other="eye"),
    "pointing": lambda dim: c.Pointing("tip", [0.6, 0.8, 0.0][:dim]),
    "look_at": lambda dim: c.LookAt("tip", [2.0, 1.0, 3.0][:dim]),
    "on_line": lambda dim: c.OnLine(
        "tip", [0.1, 0.2, 0.0][:dim], [1.0, 1.0, 0.0][:dim], other="eye"
    ),
    "on_plane": lambda dim: c.OnPlane("tip", [0.1, 0.2, 0.0][:dim], [1.0, 1.0, 0.0][:dim]),
    "half_space": lambda dim: c.HalfSpace(
        "tip", [0.0, 0.0, 0.0][:dim], [0.0, 1.0, 0.0][:dim], margin=0.1
    ),
    "on_sphere": lambda dim: c.OnSphere("tip", [0.1, 0.2, 0.3][:dim], 0.7),
    "in_box": lambda dim: c.InBox("tip", [-1.0, -1.0, -1.0][:dim], [0.5, 0.5, 0.5][:dim]),
    "relative_pose": lambda dim: c.RelativePose("tip", "eye", X if dim == 3 else FLAT),
    "relative_position": lambda dim: c.RelativePosition("tip", "eye", [0.3, 0.1, 0.2][:dim]),
    "distance": lambda dim: c.Distance("tip", "eye", 0.9),
    "on_surface": lambda dim: c.OnSurface("tip", "x^2/4 + y^2 = 1", other="eye"),
    "on_curve": lambda dim: c.OnCurve("tip", RING[:, :dim], closed=True, other="eye"),
    "contact": lambda dim: c.Contact("tip", radius=0.1),
    "no_sideslip": lambda dim: c.NoSideslip("tip"),
    "rolls": lambda dim: c.Rolls("tip", radius=0.1),
    "posture": lambda dim: c.Posture({"Ja.x": 0.3}),
    "centre_of_mass": lambda dim: c.CentreOfMass([0.1, 0.2, 0.3][:dim]),
    "centre_of_points": lambda dim: c.CentreOfPoints(["tip", "eye"], [0.1, 0.2, 0.3][:dim]),
    "equation": lambda dim: c.Equation("`Ja.x` - 2*`Jb.x` = 0.1"),
    "inequality": lambda dim: c.Inequality("1 - `Ja.x`^2"),
    "velocity_equation": lambda dim: c.VelocityEquation(
        [["`Ja.y`", "0", "1"]], of=("Ja.x", "Ja.y", "Jb.x")
    ),
    "function": lambda dim: c.Function(lambda q: q[0] - 0.3),
}
"""An example of each kind, for a planar (2) and a spatial (3) system."""

TASKS_ONLY = {"posture", "centre_of_mass", "centre_of_points", "function"}
"""Kinds that no mechanism holds always: they are of the configuration, not of bodies."""


def two_bodies(dim: int) -> Mechanism:
    """Two free bodies with a frame each."""
    m = Mechanism("two", dim)
    for name, frame in (("a", "tip"), ("b", "eye")):
        m.free(f"J{name}", m.ground, m.body(name, mass=1.0))
        m.frame(
            frame, name, at=(0.2, 0.1), **({"angle": 0.3} if dim == 2 else {"rpy": (0.1, 0.2, 0.3)})
        )
    return m


def run(name: str, dim: int) -> None:
    """What holds for every kind: declared, counted, closed, differentiated, judged, requested,
    written and read.
    """
    made = EXAMPLES[name](dim)
    assert c.KINDS[name] is type(made) and made.kind == name and made.says and type(made).__doc__
    if any(r.velocity for r in made.list_rows(dim)):
        refused(lambda s: s.ik(made), two_bodies(dim).build(), "about velocities")
    else:
        requested(made, two_bodies(dim).build())
    m = two_bodies(dim)
    if name in TASKS_ONLY:
        refused(lambda x: x.constrain(made.demand(weight=None), "it"), m, "")
        assert not m.constraints
        return
    refused(lambda x: x.constrain(made.soft(), "it"), m, "weight is what ik reads")
    m.constrain(made, "it")
    again = read_toml(write_toml(m))
    assert again == m
    declared(made, m.build(), dim)


def refused(call: Callable[..., object], thing: object, said: str) -> None:
    try:
        call(thing)
    except (DescriptionError, ValueError) as error:
        assert said in str(error), error
        return
    raise AssertionError(f"was not refused: {said}")


def requested(made: c.Constraint, s: System) -> None:
    """Reached from random starts, and judged by the forward model; its Jacobian by differences."""
    q = s.random(3)
    answer = s.ik(made.demand(weight=None), start=q)
    assert answer.success, answer.status
    assert max(tasks.miss(s, made, answer.q)) < 1e-6
    J = tasks.jacobian(s, made, q)
    h = 1e-6
    ends = [
        tasks.error(s, made, s.configuration_space.integrate(q, x * np.eye(s.nv))) for x in (h, -h)
    ]
    np.testing.assert_allclose(J, ((ends[0] - ends[1]) / (2.0 * h)).T, atol=1e-6)


def declared(made: c.Constraint, s: System, dim: int) -> None:
    """Closed, with as many equations as its rows are, and their Jacobian by differences."""
    q = s.random(5)
    held = sum(r.count_equations(dim) for r in list_position_rows(made, dim))
    r = closure_rows.compute_residual(s, q)
    J = closure_rows.compute_jacobian(s, q)
    assert r.shape == (held,) or made.kind in ("pointing", "look_at")
    h = 1e-6
    ends = [
        closure_rows.compute_residual(s, s.configuration_space.integrate(q, x * np.eye(s.nv)))
        for x in (h, -h)
    ]
    np.testing.assert_allclose(J, ((ends[0] - ends[1]) / (2.0 * h)).T, atol=1e-6)
    closed = s.assemble(start=q)
    assert closed.success, closed.status
    if not any(row.velocity for row in made.list_rows(dim)):
        assert max(tasks.miss(s, made, closed.q)) < 1e-8
