"""What the coordinates of a packed chain do."""

from __future__ import annotations

from kempe import Mechanism
from kempe.inverse.chain.serial_chain import find_chain, find_motion_masks


def test_a_screw_turns_and_slides():
    """It is an angle, but whole turns do not bring it back."""
    m = Mechanism("arm")
    m.revolute("q1", m.ground, m.body("a"), at=(0, 0, 1))
    m.helical("h", "a", m.body("b"), pitch=0.1)
    m.prismatic("s", "b", m.body("c"), axis=(1, 0, 0))
    m.cylindrical("c", "c", m.body("d"))
    chain = find_chain(m.build(), "d")
    turns, slides = find_motion_masks(chain)
    assert turns.tolist() == [True, True, False, True, False] or turns.tolist() == [
        True,
        True,
        False,
        False,
        True,
    ]
    assert (turns & slides).tolist() == [False, True, False, False, False]
    assert (turns | slides).all()
