"""Sliders of a page: their groups, and how numbers on them are written."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.views.drawing.scene import number_links
from kempe.views.viewer.first_sight import map_links_above

if TYPE_CHECKING:
    from kempe.model.model import Model

MANY = 12
"""Sliders from which on they stand in groups, with a filter."""
STEPS = 2000
"""Places of a slider."""
PARTS = (1, 2, 3, 4, 6)
"""Parts of pi by which the end of an angle is named."""
SAME_ANGLE = 1e-5
"""How far an angle [rad] may be from the part of pi that names it: files round."""


class Slider(NamedTuple):
    """A coordinate that can be set: its unit "rad" or "m", its ends, and its value."""

    name: str
    unit: str
    low: float
    high: float
    value: float

    @property
    def digits(self) -> int:
        """Digits after the point that are shown."""
        wide = max(self.high - self.low, 1e-9)
        return max(0, -int(np.floor(np.log10(wide / STEPS))))

    @property
    def step(self) -> float:
        """Step of the slider: a power of ten, with at least `STEPS` steps."""
        return float(10.0 ** np.floor(np.log10(max(self.high - self.low, 1e-9) / STEPS)))

    @property
    def marks(self) -> tuple[tuple[float, str], ...]:
        """The ends with their texts."""
        return tuple((x, format_end(x, self.unit)) for x in (self.low, self.high))


def format_end(value: float, unit: str) -> str:
    """Format an end of a slider: an angle in radians as a part of pi if it is one."""
    for part in PARTS if unit == "rad" else ():
        count = round(part * value / np.pi)
        if count and abs(value - count * np.pi / part) < SAME_ANGLE:
            times = {1: "", -1: "-"}.get(count, str(count))
            return f"{times}π" + (f"/{part}" if part > 1 else "")
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def group_by_limb(system: Model, sliders: Sequence[Slider]) -> list[tuple[str, list[Slider]]]:
    """Group sliders by the limb that their joint moves: a part of the tree without forks.

    Each group has the words with which its names begin; joints that are alone are the last group.
    """
    number = number_links(system)
    above = map_links_above(system)
    children = np.bincount([*above.values()], minlength=len(number) + 1)
    joints = system.mechanism.joints
    groups = dict[int, list[Slider]]()
    for slider in sliders:
        parts = slider.name.split(".")
        heads = (".".join(parts[:k]) for k in range(len(parts), 0, -1))
        joint = next((joints[head] for head in heads if head in joints), None)
        link = 0 if joint is None else number[joint.child]
        while above.get(link) in above and children[above[link]] == 1:
            link = above[link]
        groups.setdefault(link, []).append(slider)
    alone = [group[0] for group in groups.values() if len(group) == 1]
    named = [(_name_group([s.name for s in g]), g) for g in groups.values() if len(g) > 1]
    return [*named, ("others", alone)] if alone else named


def _name_group(names: Sequence[str]) -> str:
    """Name a group by the words with which its names begin, without numbers."""
    words = [re.split(r"[\W_]+", name) for name in names]
    common = list[str]()
    for column in zip(*words, strict=False):
        if len({*column}) > 1 or column[0].isdigit():
            break
        common.append(column[0])
    return " ".join(common) or f"{names[0]}, ..."
