"""The benchmark's machinery: turns, ratios, goals, and that its checks judge rightly. No timing is
asserted.
"""

from __future__ import annotations

import itertools

import kempe_bench as benchmark
import numpy as np
import pytest
from kempe_bench import clearances, forward, inverse, peers, redundant, timing, trees
from kempe_bench.bench import Bench

import kempe
from kempe.cli import terminal
from kempe.errors import UnknownNameError


@pytest.fixture
def quick(monkeypatch):
    """Sizes at which a section takes a moment."""
    for module, name, value in (
        (timing, "ROUNDS", 2),
        (timing, "TURN", 1e-6),
        (forward, "BATCH", 50),
        (forward, "TRAJECTORY", 20),
        (forward, "LOOP", 20),
        (trees, "BATCH", 20),
        (trees, "LENGTHS", (2, 3, 5)),
        (trees, "PINOCCHIO_LONGEST", 3),
        (inverse, "TARGETS", 20),
        (inverse, "BATCH", 40),
        (inverse, "SLOW_TARGETS", 1),
        (redundant, "TARGETS", 10),
        (redundant, "BATCH", 20),
    ):
        monkeypatch.setattr(module, name, value)


@pytest.fixture(params=["example-robot-data", "shipped"])
def arm(request, monkeypatch):
    if request.param == "shipped":
        monkeypatch.setattr(peers, "robot_file", lambda name: None)
    elif peers.robot_file("panda.urdf") is None:
        pytest.skip("example-robot-data is not installed")
    bench = Bench([])
    yield bench.arm


def test_cases_take_turns(quick):
    order: list[str] = []
    timed = timing.cases(
        "x", {"order": order}, ("a", "order.append('a')"), ("b", "order.append('b')", 10)
    )
    rows = timing.measure(timed)
    assert [(r.library, r.call) for r in rows] == [("x", "a"), ("x", "b")] and all(
        r.value > 0 for r in rows
    )
    turns = "".join(name for name, _ in itertools.groupby(order))
    # one for finding the number of repetitions, then the rounds
    assert turns == "ab" + "ab" * timing.ROUNDS


def test_table():
    table = timing.Table(
        "T", "ns", [timing.Row("Kempe", "fk", 2.0, 1.5), timing.Row("pin", "fk, loop", 90.0)]
    )
    assert table.ratio("pin", "fk", "fk") == 45.0 and table.ratio("other", "", "fk") is None
    table.at_least("45 times", table.ratio("pin", "fk", "fk"), 45)
    table.at_most("1 ns", table.value("Kempe"), 1.0)
    table.at_most("not measured", table.value("other"), 1.0)
    assert [g.met for g in table.goals] == [True, False]
    assert table.best("Kempe") == 1.5 and table.best("pin") == 90.0
    page = table.markdown()
    assert "| pin | fk, loop | 90 | 90 | 45 |" in page and "- 1 ns: 2 (NOT MET)" in page


def test_a_table_is_shown_in_a_terminal(capsys):
    rows = [timing.Row("Kempe", "f(x[0])", 1.5), timing.Row("Other", "g", 3.0)]
    terminal.print_text(
        benchmark.shown(timing.Table("Poses [all]", "s", rows, remarks=["one run"]))
    )
    said = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert said[:2] == [["Poses", "[all]"], ["library", "call", "s", "ratio"]]
    assert said[2:5] == [["Kempe", "f(x[0])", "1.5", "1"], ["Other", "g", "3", "2"], ["one", "run"]]


def test_unknown_names():
    with pytest.raises(UnknownNameError):
        next(benchmark.benchmark(["btch"]))
    with pytest.raises(UnknownNameError):
        next(benchmark.benchmark(["batch"], ["pinn"]))


def test_arm_agrees_with_kempe_and_peers(arm):
    q = arm.random(20)
    want = arm.pose(q)
    assert len(arm.links) == 7
    np.testing.assert_allclose(arm.system.fk(q, arm.frame), want, atol=1e-13)
    pin = pytest.importorskip("pinocchio")
    model, data, frame = peers.pinocchio_arm(arm)
    for row, X in zip(q, want, strict=True):
        pin.forwardKinematics(model, data, row)
        np.testing.assert_allclose(
            pin.updateFramePlacement(model, data, frame).homogeneous, X, atol=1e-13
        )


def test_success_is_judged(arm):
    q = arm.random(4)
    targets = arm.pose(q)
    q[1, 0] += 1e-4  # misses
    targets[2, 0, 3] += 1e-5  # misses
    q[3, 0] = 7.0  # outside the limits
    assert inverse.reached(arm, q, targets).tolist() == [True, False, False, False]


@pytest.mark.parametrize("installed", [pytest.param(True, marks=pytest.mark.slow), False])
def test_sections_run(quick, monkeypatch, installed):
    if not installed:
        monkeypatch.setattr(peers, "robot_file", lambda name: None)
    wanted = [p for p in ("pin", "mujoco") if p in peers.installed()]
    sections = ["batch", "single", "tree", "threads", "growth", "files", "redundant", "inverse"]
    said: list[str] = []
    tables = list(benchmark.benchmark(sections, wanted, said.append))
    assert len(tables) == len(sections) - (peers.robot_file("talos_full_v2.urdf") is None)
    assert all(row.value >= 0 for table in tables for row in table.rows)
    assert tables[-1].value("Kempe", "20 calls: success") == 100.0
    page = benchmark.page(tables, wanted)
    assert page.count("\n## ") == len(tables) and f"kempe {kempe.__version__}" in page


def test_sections_of_clearances_run(monkeypatch):
    pytest.importorskip("coal")
    monkeypatch.setattr(clearances, "BATCH", 100)
    monkeypatch.setattr(clearances, "LOOP", 2)
    monkeypatch.setattr(clearances, "STEPS", 5)
    monkeypatch.setattr(clearances, "TARGETS", 2)
    monkeypatch.setattr(clearances, "PATIENCE", 2)
    sections = ["distances", "pushed", "obstacles"]
    apart, pushed, reached = benchmark.benchmark(sections, ["pin", "mink", "pin-pink"])
    assert apart.goals[-1].met, "coal measures other distances"
    assert pushed.value("Kempe", "cycles nearer") == 0.0
    assert reached.value("Kempe", "reached and clear") == 100.0
