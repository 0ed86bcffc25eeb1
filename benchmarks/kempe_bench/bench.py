"""What the sections of the benchmark share: which peers take part, the arm, and how progress is
reported.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import kempe
from kempe.description.urdf_writer import write_urdf
from kempe_bench import peers


class Bench:
    """One run: `versions` of the peers that take part, the arm for all, and `say` to tell of
    progress.

    `targets` of each robot are given to the numerical inverse model, where that is not left to the
    sections.
    """

    def __init__(
        self,
        wanted: list[str] | None = None,
        say: Callable[[str], None] = lambda text: None,
        targets: int | None = None,
    ):
        self.versions = peers.installed(wanted)
        self.say = say
        self.targets = targets

    @cached_property
    def _folder(self) -> tempfile.TemporaryDirectory[str]:
        return tempfile.TemporaryDirectory()

    @cached_property
    def arm(self) -> peers.Arm:
        """Panda's arm up to its hand: of example-robot-data, or the shipped one, written as URDF
        for the others.
        """
        file = peers.robot_file("panda.urdf")
        if file is None:
            file = Path(self._folder.name) / "panda.urdf"
            file.write_text(write_urdf(kempe.read("panda")), encoding="utf-8")
        return peers.arm_of(kempe.load(file), "panda_hand_tcp", file)
