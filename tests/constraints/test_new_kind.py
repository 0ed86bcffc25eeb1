"""A new kind is one class: declared, given to ik, counted, closed, traced, classified, written,
drawn, explained.
"""

from __future__ import annotations

import numpy as np
import pytest
from linkages import two_bars
from on_ellipse import OnEllipse

import kempe
from kempe.mobility.classify import classify

A = 1.5
B = 1.0


@pytest.fixture(scope="module")
def mechanism() -> kempe.Mechanism:
    m = two_bars()
    m.parameter("half", A)
    m.constrain(OnEllipse("tip", "half", B), name="ellipse")
    return m


def off(q) -> np.ndarray:
    """How far the tip is off the ellipse, by trigonometry."""
    q = np.asarray(q)
    x = np.cos(q[..., 0]) + np.cos(q[..., 0] + q[..., 1])
    y = np.sin(q[..., 0]) + np.sin(q[..., 0] + q[..., 1])
    return (x / A) ** 2 + (y / B) ** 2 - 1.0


def test_counted(mechanism: kempe.Mechanism):
    m = mechanism.build().mobility()
    assert (m.gruebler, m.rank_dof, m.dof, m.redundant) == (1, 1, 1, 0)
    assert "1 equation" in str(m)
    assert abs(off(m.q)) < 1e-12


def test_closed(mechanism: kempe.Mechanism):
    s = mechanism.build()
    known = s.assemble({"A": 0.4})
    assert known.success and known.q[0] == 0.4 and abs(off(known.q)) < 1e-9
    modes = s.assembly_modes({"A": 0.4})
    b = np.linspace(-np.pi, np.pi, 4001)
    values = off(np.stack([np.full_like(b, 0.4), b], axis=-1))
    assert len(modes.q) == np.sum(np.sign(values[1:]) != np.sign(values[:-1]))


def test_traced(mechanism: kempe.Mechanism):
    s = mechanism.build()
    path = s.trace(driver="A", start=s.assemble({"A": 0.4}).q)
    assert path.closed and np.abs(off(path.q)).max() < 1e-9


def test_as_a_task_of_ik():
    s = two_bars().build()
    answer = s.ik([OnEllipse("tip", A, B), kempe.constraints.Posture({"A": 0.4}, weight=None)])
    assert answer.success and abs(off(answer.q)) < 1e-6
    batch = s.ik([OnEllipse("tip", np.array([1.2, 1.5, 1.8]), B)])
    x, y = s.fk(batch.q, "tip")[:, :2, 3].T
    assert batch.success.all()
    np.testing.assert_allclose((x / [1.2, 1.5, 1.8]) ** 2 + (y / B) ** 2, 1.0, atol=1e-6)


def test_refused_where_it_cannot_hold():
    answer = two_bars().build().ik([OnEllipse("tip", 3.0, 3.0)])
    assert not answer.success and "OnEllipse of 'tip'" in str(answer.status)


def test_classified(mechanism: kempe.Mechanism):
    found = classify(mechanism.build())
    assert found.constraints["ellipse"].kind == "holonomic" and found.position_dof == 1


def test_written_and_read(mechanism: kempe.Mechanism, tmp_path):
    path = mechanism.save(tmp_path / "arm.toml")
    again = kempe.read(path)
    assert again == mechanism
    s = again.build()
    assert abs(off(s.assemble({"A": 0.4}).q)) < 1e-9
    wider = s.with_parameters(half=1.7)
    q = wider.assemble({"A": 0.4}).q
    x, y = wider.fk(q, "tip")[:2, 3]
    assert abs((x / 1.7) ** 2 + y**2 - 1.0) < 1e-9


def test_drawn_and_explained(mechanism: kempe.Mechanism):
    s = mechanism.build()
    q = s.assemble({"A": 0.4}).q
    pytest.importorskip("matplotlib")
    assert "mark:ellipse" in {part.get_gid() for part in s.plot(q).findobj()}
    assert "ellipse" in str(s.assemble({"A": 0.4, "B": 0.0}).status)
