"""Targets in the plane: x, y and an angle are a pose where the task says so."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe.errors import InputError


def three_links(dim: int = 2) -> kempe.System:
    """Three turns about parallel axes."""
    m = kempe.Mechanism("three links", dim=dim)
    before = m.ground
    for i, length in enumerate((0.0, 0.4, 0.3)):
        link = m.body(f"L{i}")
        m.revolute(
            f"J{i}", before, link, at=(length, 0.0, 0.0)[:dim], axis="z" if dim == 3 else None
        )
        before = link
    m.frame("tip", before, at=(0.2, 0.0, 0.0)[:dim])
    return m.build()


def pose_of(system: kempe.System, q: np.ndarray) -> np.ndarray:
    """x, y and the angle of the tip (..., 3), by sums of angles."""
    angle = np.cumsum(q, axis=-1)
    x = 0.4 * np.cos(angle[..., 0]) + 0.3 * np.cos(angle[..., 1]) + 0.2 * np.cos(angle[..., 2])
    y = 0.4 * np.sin(angle[..., 0]) + 0.3 * np.sin(angle[..., 1]) + 0.2 * np.sin(angle[..., 2])
    return np.stack([x, y, angle[..., 2]], axis=-1)


@pytest.mark.parametrize("shape", [(), (1,), (3,), (2, 3)])
def test_x_y_and_an_angle_are_a_pose(shape, hunt):
    """Of three rows, too, which are no planar pose."""
    system = three_links()
    q = hunt.rng().uniform(0.3, 1.2, (*shape, 3))
    target = pose_of(system, q)
    found = system.ik(target, "tip", task="pose")
    assert np.all(found.success)
    off = pose_of(system, found.q) - target
    assert np.abs(off[..., :2]).max() < 1e-8 and np.abs(np.sin(off[..., 2])).max() < 1e-8
    every = system.ik_all(target, "tip", task="pose")
    assert np.all(np.asarray(every.success))
    assert len(system.ik_all(target.reshape(-1, 3)[0], "tip", task="pose")) == 2
    assert np.allclose(system.fk(q, "tip"), system.fk(found.q, "tip"), atol=1e-8)


@pytest.mark.parametrize("verb", ["ik", "ik_all"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_position_is_no_pose(verb, dim):
    """Where an orientation is read, none is made up."""
    system = three_links(dim)
    for target in [[0.3, 0.4]] if dim == 2 else [[0.3, 0.4, 0.0]]:
        with pytest.raises(InputError, match="asks for an orientation") as error:
            getattr(system, verb)(target, "tip", task="pose")
        assert ("x, y and angle" in str(error.value)) == (dim == 2)
    with pytest.raises(InputError, match="asks for an orientation"):
        getattr(system, verb)(
            [0.3, 0.4] if dim == 2 else [0.3, 0.4, 0.0], "tip", task="orientation"
        )


def test_a_target_beyond_the_limit_of_a_slide_names_the_limit():
    """Lengths alone say nothing of an arm on a rail: its end is the reason, in `ik`, `ik_all` and
    of tasks.
    """
    m = kempe.Mechanism("rail")
    cart = m.body("cart")
    link = m.body("link")
    m.prismatic("rail", m.ground, cart, axis=(1, 0, 0), limits=(0.0, 1.0))
    m.revolute("turn", cart, link)
    m.frame("tip", link, at=(0.3, 0, 0))
    s = m.build()
    by_task = s.ik(kempe.tasks.Position("tip", [2.5, 0, 0]))
    for answer in (s.ik([2.5, 0, 0], "tip"), s.ik_all([2.5, 0.9, 0], "tip"), by_task):
        assert not answer and "by the lengths of the links and the limit of 'rail'" in answer.status
    panda = kempe.load("panda")
    assert "by the lengths of the links;" in panda.ik([3.0, 0, 0], "panda_hand_tcp").status


def test_numbers_of_a_pose_in_a_row_name_the_form_that_works():
    s = kempe.load("panda")
    place = [0.4, 0.0, 0.4]
    X = np.eye(4)
    X[:3, :3] = np.diag([1.0, -1.0, -1.0])
    X[:3, 3] = place
    with pytest.raises(InputError, match=r"'quat_xyzw': \[x, y, z, w\]"):
        s.ik([*place, 1, 0, 0, 0], "panda_hand_tcp")
    with pytest.raises(InputError, match=r"'rpy': \[roll, pitch, yaw\]"):
        s.ik([*place, np.pi, 0, 0], "panda_hand_tcp")
    for form in (
        {"at": place, "quat_xyzw": [1, 0, 0, 0]},
        {"at": place, "quat_wxyz": [0, 1, 0, 0]},
        {"at": place, "rpy": [np.pi, 0, 0]},
    ):
        answer = s.ik(form, "panda_hand_tcp")
        assert answer
        np.testing.assert_allclose(s.fk(answer.q, "panda_hand_tcp"), X, atol=1e-5)
