"""Steps that the kernel of regular curves takes together, against single steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from motion_linkages import TURN, bennett, four_bar, jansen, linkage, slider_crank

import kempe
from kempe.arguments import call_until_interrupt
from kempe.equations import closure
from kempe.equations.closure import Closure
from kempe.equations.closure_rows import compute_residual
from kempe.motion import events
from kempe.motion.path import Path
from kempe.motion.trace import trace

SEEDS = 2


def rod_in_space(angles: bool, rng: np.random.Generator) -> kempe.System:
    """Crank and rocker in space joined by a rod with a universal and a spherical joint."""
    m = kempe.Mechanism("RUSR")
    crank = m.body("crank")
    rod = m.body("rod")
    rocker = m.body("rocker")
    rpy = np.array([0.5, 1.2, 0.0]) + 0.1 * rng.uniform(-1, 1, 3)
    m.revolute("A", m.ground, crank)
    m.revolute("D", m.ground, rocker, at=(2, 0, 0.5), rpy=tuple(rpy))
    m.universal("B", crank, rod, at=(0.5, 0, 0))
    m.spherical("C", rod, rocker, at=(2, 0, 0), child_at=(1, 0, 0), cut=True, angles=angles)
    return m.build()


def slot() -> kempe.System:
    """Crank whose pin slides in a link, where a one-sided constraint ends the motion."""
    m = kempe.Mechanism("slot", dim=2)
    m.revolute("A", m.ground, m.body("crank"))
    m.revolute("B", m.ground, m.body("link"), at=(0.5, 0))
    m.frame("pin", "crank", at=(0.3, 0))
    m.point_on_line("slot", "link", "pin", axis=(1, 0))
    m.constrain(kempe.constraints.InBox("pin", [0.1, -1], [0.75, 1], other="link"), "ends")
    return m.build()


def slides(law: str) -> kempe.System:
    """Two slides with a law between them."""
    m = kempe.Mechanism("slides", dim=2)
    m.prismatic("x", m.ground, m.body("a"), axis=(1.0, 0.0), limits=(-9.0, 9.0))
    m.prismatic("y", "a", m.body("b"), axis=(0.0, 1.0), limits=(-9.0, 9.0))
    m.equation("law", law, of=("x", "y"))
    return m.build()


def five_bar() -> kempe.System:
    """Two cranks on the ground, and two links, drawn where all coordinates are zero."""
    points = {"A": (0.0, 0.0), "B": (-0.5, 1.0), "C": (0.9, 1.8), "D": (2.2, 1.1), "E": (2.0, 0.0)}
    links = {"ground": "AE", "a": "AB", "b": "BC", "c": "CD", "d": "DE"}
    return linkage("five-bar", points, {k: tuple(v) for k, v in links.items()})


def trace_four_bar(rng: np.random.Generator) -> Path:
    a, b, c, d = np.array([1.0, 2.5, 2.0, 3.0]) + 0.3 * rng.uniform(-1, 1, 4)
    return trace(four_bar(a, b, c, d), "A", {"A": rng.uniform(0.4, 2.0)})


def trace_bennett(rng: np.random.Generator) -> Path:
    alpha = rng.uniform(0.5, 0.8)
    beta = alpha + rng.uniform(0.2, 0.5)
    system = bennett(1.0, math.sin(beta) / math.sin(alpha), alpha, beta)
    K = math.sin((beta + alpha) / 2) / math.sin((beta - alpha) / 2)
    second = 2 * math.atan(K / math.tan(0.5))
    return trace(system, "T1", [1.0, second, -1.0, -second])


TRACES: dict[str, Callable[[np.random.Generator], Path]] = {
    "four-bar": trace_four_bar,
    "bennett": trace_bennett,
    "rod with quaternion": lambda rng: trace(rod_in_space(False, rng), "D", {"A": 0.3}),
    "rod with angles": lambda rng: trace(rod_in_space(True, rng), "D", {"A": 0.3}),
    "jansen": lambda rng: trace(jansen(), "O", {"O": rng.uniform(0.0, TURN)}),
    "change points": lambda rng: trace(four_bar(1, 2, 1, 2), "A", {"A": 0.8, "D": 0.8}),
    "limits": lambda rng: trace(
        slider_crank(1, 2, 0.3, limits=(1.5, 2.8 + 0.1 * rng.uniform())), "A", [0.7, -0.8, 0.0, 2.7]
    ),
    "one-sided row": lambda rng: slot().trace(),
    "held crank": lambda rng: trace(
        five_bar(), "A", np.zeros(5), hold={"E": rng.uniform(-0.1, 0.1)}
    ),
    "law": lambda rng: trace(slides("x^2/4 + y^2 - 1"), start={"x": rng.uniform(0.2, 1.0)}),
    "backwards": lambda rng: trace(four_bar(1, 2.5, 2, 3), "A", {"A": 0.5}, toward={"A": -1.0}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TRACES)
def test_steps_that_are_taken_together_are_what_single_steps_give(name, monkeypatch):
    for seed in range(SEEDS):
        path = TRACES[name](np.random.default_rng(seed))
        with monkeypatch.context() as m:
            m.setattr(Closure, "follows_by_kernel", False)
            single = TRACES[name](np.random.default_rng(seed))
        assert len(path) == len(single) > 10
        np.testing.assert_allclose(path.q, single.q, rtol=0, atol=1e-10)
        np.testing.assert_allclose(path.s, single.s, rtol=1e-10)
        assert np.abs(compute_residual(path.system, path.q)).max() < 1e-12
        assert (path.closed, path.ends, path.status) == (single.closed, single.ends, single.status)
        for mine, theirs in (
            (path.extremes, single.extremes),
            (path.turning_points, single.turning_points),
            (path.singular_points, single.singular_points),
        ):
            # sorted, since at a symmetric point several coordinates turn back at once
            mine, theirs = (
                sorted((e.coordinate, e.kind, e.s) for e in each) for each in (mine, theirs)
            )
            assert [e[:2] for e in mine] == [e[:2] for e in theirs]
            np.testing.assert_allclose([e[2] for e in mine], [e[2] for e in theirs], atol=1e-7)


def count_calls(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> list[int]:
    """Count the calls of a function: each adds an entry to the list."""
    calls: list[int] = []
    function = getattr(owner, name)

    def call(*args: Any) -> Any:
        calls.append(1)
        return function(*args)

    monkeypatch.setattr(owner, name, call)
    return calls


def test_a_regular_branch_takes_few_calls_a_point(monkeypatch):
    kernel = count_calls(monkeypatch, closure.Closure, "follow_regular_curve")
    steps = count_calls(monkeypatch, events, "find_next_node")
    path = trace(four_bar(1, 2.5, 2, 3), "A", {"A": 0.5}, budget=kempe.Budget(step=0.02))
    assert path.closed and len(path) > 200
    walks = len(path) // events.STEPS + 1
    assert len(steps) <= walks + 2
    searches = 12 * len(path.extremes)  # roots between two points
    assert len(kernel) <= walks + 2 + searches


def test_the_walk_ends_inside_a_block_where_a_limit_is_hit(monkeypatch):
    """The points after it, which the kernel took already, are not in the path."""
    blocks = []
    whole = events.RegularWalk.take_steps

    def take_steps(*args):
        nodes, h = whole(*args)
        blocks.append([n.x for n in nodes])
        return nodes, h

    monkeypatch.setattr(events.RegularWalk, "take_steps", take_steps)
    path = trace(
        slider_crank(1, 2, 0.3, limits=(1.5, 2.9)),
        "A",
        [0.7, -0.8, 0.0, 2.7],
        ways="forward",
        budget=kempe.Budget(step=0.02),
    )
    assert not path.closed and "limit" in path.ends[1]
    S = path.values("S")
    assert S.min() > 1.5 - 1e-12 and S.max() < 2.9 + 1e-12
    end = min(abs(S[-1] - 1.5), abs(S[-1] - 2.9))
    assert end < 1e-12
    slide = path.system.names.index("S") if hasattr(path.system, "names") else 3
    beyond = [x for x in blocks[-1] if not 1.5 <= x[slide] <= 2.9]
    assert beyond and len(blocks[-1]) > len(beyond)


@pytest.mark.parametrize("look", [1, 6, 9, 12])
def test_the_time_is_up_between_two_blocks(looks, look):
    system = four_bar(1, 2.5, 2, 3)
    start = {"A": 0.5}
    options = {"ways": "forward", "budget": kempe.Budget(step=0.02, time_limit=math.inf)}
    whole = trace(system, "A", start, **options)
    looks(look)
    path = trace(system, "A", start, ways="forward", budget=kempe.Budget(step=0.02, time_limit=5.0))
    assert path.late and not path and "the time limit" in path.status
    np.testing.assert_array_equal(path.q, whole.q[: len(path)])
    assert len(path) < len(whole)


def test_an_interrupt_inside_a_block_keeps_the_points_before():
    def stop(points, length):
        if points >= 48:
            raise KeyboardInterrupt

    system = four_bar(1, 2.5, 2, 3)
    budget = kempe.Budget(step=0.02)
    whole = trace(system, "A", {"A": 0.5}, ways="forward", budget=budget)
    path = call_until_interrupt(
        trace,
        system,
        "A",
        {"A": 0.5},
        ways="forward",
        budget=kempe.Budget(step=0.02, progress=stop),
    )
    assert path.interrupted and not path and len(path) == 48
    np.testing.assert_array_equal(path.q, whole.q[:48])
    np.testing.assert_allclose(path.s, whole.s[:48], rtol=1e-14)


# ---- the kernel


def test_a_held_coordinate_rests_exactly():
    path = trace(five_bar(), "A", np.zeros(5), hold={"E": 0.1})
    E = path.values("E")
    assert len(path) > 50 and np.ptp(E) == 0.0


def test_a_step_to_where_the_equations_are_no_numbers_is_refused():
    system = slides("sqrt(1 - x^2) - y")
    equations = Closure(system)
    x = np.array([0.9, math.sqrt(0.19)])
    J = equations.compute_jacobian(x)[0]
    t = np.array([-J[1], J[0]]) / np.hypot(*J[:2])
    t *= np.sign(t[0])
    for h, least, most in ((1.0, 0, 0), (0.01, 1, 20)):
        points, tangents, lengths = equations.follow_regular_curve(x, t, h, h, 40)
        assert least <= len(points) == len(tangents) == len(lengths) <= 40
        assert not most or len(points) >= 1
        assert np.isfinite(points).all() and np.isfinite(tangents).all()
        assert (points[:, 0] <= 1.0).all()
