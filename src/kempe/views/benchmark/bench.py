"""What the sections of the benchmark share: which peers take part, the arm, and how progress is told."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

from kempe.errors import UnsupportedError
from kempe.views.benchmark import peers


class Bench:
    """One run: `versions` of the peers that take part, the arm for all, and `say` to tell of progress."""

    def __init__(self, wanted: list[str] | None = None, say: Callable[[str], None] = lambda text: None):
        self.versions = peers.installed(wanted)
        self.say = say

    @cached_property
    def arm(self) -> peers.Arm:
        """Panda's arm up to its hand."""
        import kempe

        file = peers.robot_file("panda.urdf")
        if file is None:
            raise UnsupportedError("the benchmark needs the package example-robot-data: pip install 'kempe[bench]'")
        return peers.arm_of(kempe.load(file), "panda_hand", file)
